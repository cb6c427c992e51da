"""What numbers of a text mean: which column is what, marks of thousands, markers, several runs.

Truth: what a person reads off the file; closed forms. Every hint that a message prints is carried
out by the command that prints it.
"""

import re
import shlex

import numpy as np
import pytest

import metrosep as ms
from metrosep.cli.main import main
from metrosep.core.errors import UnitError
from metrosep.io.check import check_file
from metrosep.io.stream import open_stream

UM, MM = 1e-6, 1e-3


def table(*rows):
    return "\n".join(rows) + "\n"


def wave(n=60):
    return [(0.1 * i, round(2.0 * np.sin(0.7 * i) + 0.3 * np.cos(2.1 * i), 4)) for i in range(n)]


# Which column is what


@pytest.mark.parametrize(
    ("x_name", "z_name"),
    [
        ("x_mm", "z_um"),
        ("Weg [mm]", "Abweichung [µm]"),
        ("déplacement (mm)", "écart (µm)"),
        ("posizione in mm", "lettura in um"),
        ("distancia / mm", "altura / um"),
        ("位置[mm]", "误差[um]"),
        ("変位量 (mm)", "真直度 (um)"),
        ("pos_mm", "b_um"),
        ("a_mm", "probe 2_um"),
    ],
)
@pytest.mark.parametrize("order", [1, -1])
def test_columns_are_taken_by_their_names_in_any_order(put, x_name, z_name, order):
    rows = [(x_name, z_name), *((f"{a:.1f}", f"{b}") for a, b in wave())]

    profile = ms.read(put(table(*(";".join(r[::order]) for r in rows))))

    np.testing.assert_allclose(profile.x, [a * MM for a, _ in wave()], rtol=1e-14)
    np.testing.assert_allclose(profile.z, [b * UM for _, b in wave()], rtol=1e-14)


def test_columns_without_telling_names_by_what_is_monotonic(put):
    rows = [f"{b},{a:.1f}" for a, b in wave()]

    profile = ms.read(put(table("q_um,p_mm", *rows)))

    np.testing.assert_allclose(profile.x, [a * MM for a, _ in wave()], rtol=1e-14)
    assert "'p_mm' was taken as the position" in profile.metadata["warnings"][0]


@pytest.mark.parametrize("reading", ["displacement_um", "distance_um", "travel_um"])
def test_a_reading_called_displacement_is_no_position_beside_one_that_is_called_so(put, reading):
    """A sensor that rises all the way (100 um per mm) names its reading as a position may be named."""
    rows = [f"{100 * 0.5 * i:.3f},{0.5 * i:.1f}" for i in range(40)]

    found = ms.read(put(table(f"{reading},position_mm", *rows)))

    assert found.x.tolist() == pytest.approx([0.5e-3 * i for i in range(40)], rel=1e-12, abs=1e-15)
    assert float(np.ptp(found.z)) == pytest.approx(1950 * UM, rel=1e-12, abs=1e-15)


def test_two_columns_that_both_rise_are_said_to_be_assumed(put):
    profile = ms.read(put(table("q_um,p_mm", *(f"{i},{2 * i}" for i in range(9)))))

    assert profile.x[-1] == pytest.approx(8 * UM, rel=1e-14, abs=0.0)
    (said,) = profile.metadata["warnings"]
    assert "x='p_mm', z='q_um'" in said


def test_a_position_that_does_not_rise_beside_a_height_that_does_is_asked_for(put):
    """On a lathe the axis may be called z and the deviation x."""
    path = put(table("z_mm,x_um", *(f"{a:.1f},{b}" for a, b in wave())))

    with pytest.raises(ms.errors.FormatMismatchError) as caught:
        ms.read(path)

    assert "x='z_mm', z='x_um'" in str(caught.value)
    assert ms.read(path, x="z_mm", z="x_um").x[-1] == pytest.approx(5.9 * MM, rel=1e-12, abs=0.0)


def test_a_sensor_in_volts_is_the_height_wherever_it_stands(put):
    path = put(table("A1_V,travelled_mm", *(f"{b},{a:.1f}" for a, b in wave())))

    assert ms.read(path, scale="2 um/V").z[3] == pytest.approx(
        wave()[3][1] * 2 * UM, rel=1e-12, abs=0.0
    )


def test_a_torque_is_never_taken_as_a_height(put):
    path = put(table("x_mm,M_Nm", *(f"{a:.1f},{b}" for a, b in wave())))

    for options in ({}, {"unit": "um"}, {"x": "x_mm", "z": "M_Nm"}):
        with pytest.raises(ms.errors.MetrosepError, match=r"torque|declares its own unit"):
            ms.read(path, **options)
    with pytest.raises(ms.errors.UnitError, match="torque"):
        ms.read_runs(path, x="x_mm", z="M_Nm")


@pytest.mark.parametrize("name", ["x [Mm]", "x_Mm", "x (NM)"])
def test_a_column_in_megametres_is_no_column_in_millimetres(put, name):
    path = put(table(f"{name};z_um", *(f"{a:.1f};{b}" for a, b in wave())))

    for options in ({}, {"unit": "mm"}):
        with pytest.raises(ms.errors.UnitError, match=r"'(Mm|NM)' is"):
            ms.read(path, **options)


# Marks of thousands


@pytest.mark.parametrize(
    ("separator", "quote", "numbers"),
    [
        ("\t", "", ["1,234", "2,468", "3,702", "4,936", "6,170"]),
        (";", '"', ["-1,234", "2,468", "3,702", "4,936", "6,170"]),
    ],
)
def test_numbers_that_may_be_in_groups_of_thousands_are_asked_for(put, separator, quote, numbers):
    rows = [f"{i}{separator}{quote}{z}{quote}" for i, z in enumerate(numbers)]
    path = put(table(f"x_mm{separator}z_um", *rows))
    mark = "," if any("," in n for n in numbers) else "."
    whole = [float(n.replace(mark, "")) for n in numbers]

    for door in (ms.read, lambda p: ms.read_runs(p, x="x_mm", z="z_um"), streamed):
        with pytest.raises(ms.errors.ReadError, match=r"thousands="):
            door(path)
    decimal = {",": ".", ".": ","}[mark]
    found = ms.read(path, thousands=mark, decimal=decimal)
    assert found.z.tolist() == pytest.approx([v * UM for v in whole], rel=1e-14, abs=0.0)


@pytest.mark.parametrize(
    ("numbers", "values"),
    [
        (["0,123", "1,500", "2,500"], [0.123, 1.5, 2.5]),
        (["1234,567", "1,500", "2,250"], [1234.567, 1.5, 2.25]),
        (["1,500", "2,25", "3,125"], [1.5, 2.25, 3.125]),
    ],
)
def test_a_number_that_shows_the_decimal_mark_decides_for_all(put, numbers, values):
    profile = ms.read(put(table("x_mm;z_um", *(f"{i};{z}" for i, z in enumerate(numbers)))))

    assert profile.z.tolist() == pytest.approx([v * UM for v in values], rel=1e-14, abs=0.0)


def streamed(path, **options):
    with open_stream(path, **options) as stream:
        return list(stream.chunks(50))


# Numbers that mean "not measured"


@pytest.mark.parametrize(
    "marker",
    ["-9999", "99999.99", "1e99", "-999", "32767", "-32768", "3.4028235e38", "9.91E37", "65535"],
)
@pytest.mark.parametrize("share", [1, 7])
def test_a_marker_is_named_and_becomes_nan_when_it_is_declared(put, marker, share):
    rows = wave(200)
    at = [40] if share == 1 else list(range(40, 200, 7))
    lines = [f"{a:.1f},{marker if i in at else b}" for i, (a, b) in enumerate(rows)]
    path = put(table("x_mm,z_um", *lines))

    doors = (ms.read, lambda p, **o: ms.read_runs(p, x="x_mm", z="z_um", **o), streamed)
    for door in doors:
        with pytest.raises(ms.errors.AmbiguousFormatError, match=r"line 42\)") as caught:
            door(path)
        hint = re.search(r"missing='([^']*)'", str(caught.value)).group(1)
        door(path, missing=hint)
    z = ms.read(path, missing=hint).z
    assert np.flatnonzero(np.isnan(z)).tolist() == at
    assert float(np.nanmax(np.abs(z))) < 3 * UM
    assert np.isfinite(ms.read(path, missing="none").z).all()


def test_one_marker_far_down_a_long_file_of_coarse_numbers_is_found(put):
    lines = [f"{0.001 * i:.3f},{round(np.sin(i), 3)}" for i in range(60_000)]
    lines[59_000] = "59.000,-9999"
    path = put(table("x_mm,z_um", *lines))

    for door in (ms.read, streamed):
        with pytest.raises(ms.errors.AmbiguousFormatError, match=r"line 59002\)"):
            door(path)


def test_two_markers_on_both_sides_are_both_named(put):
    lines = [f"{a:.1f},{b}" for a, b in wave(100)]
    lines[20], lines[50] = "2.0,9999", "5.0,-9999"
    path = put(table("x_mm,z_um", *lines))

    with pytest.raises(ms.errors.AmbiguousFormatError, match="holds 9999 "):
        ms.read(path)
    with pytest.raises(ms.errors.AmbiguousFormatError, match="holds -9999 "):
        _without(path, "9999")
    assert np.isnan(ms.read(path, missing="9999,-9999").z).sum() == 2


def _without(path, marker):
    """Read a file in which one marker was blanked by hand."""
    other = path.with_name("other.csv")
    other.write_text(path.read_text().replace(f",{marker}", ","))
    return ms.read(other)


def test_any_value_that_repeats_far_away_is_reported(put):
    lines = [f"{a:.1f},{b if i % 9 else 700.25}" for i, (a, b) in enumerate(wave(90))]

    found = check_file(put(table("x_mm,z_um", *lines)))

    assert any("holds 700.25 in 10 row(s)" in f.problem for f in found)


@pytest.mark.parametrize("command", ["measure {} --params Pa", "info {}", "check {}"])
def test_a_value_that_stands_twice_far_away_is_reported_with_a_hint_that_works(
    put, capsys, command
):
    """-999.25, the null of well logs: 40 um and +-2 um of signal otherwise."""
    lines = [f"{0.5 * i:.1f},{40 + 2 * np.sin(0.1 * i):.4f}" for i in range(120)]
    lines[7], lines[90] = "3.5,-999.25", "45.0,-999.25"
    path = put(table("x_mm,z_um", *lines))
    typed = command.format(path).split()

    assert code_of(*typed) == 0
    said = "".join(capsys.readouterr())
    assert "holds -999.25 in 2 row(s) (first: line 9)" in said
    (hint, _) = re.findall(r'--set "(missing=[^"]+)"', said)
    assert code_of(*typed, "--set", hint) == 0
    assert "-999.25" not in "".join(capsys.readouterr()).replace(hint, "")


@pytest.mark.parametrize("kind", range(8))
def test_no_signal_is_taken_for_a_marker(put, kind):
    rng = np.random.default_rng(kind)
    n = 400
    white = rng.standard_normal(n)
    signal = [
        white, np.cumsum(white), np.sin(np.arange(n) / 9.0), np.sign(white) + 0.01 * white,
        np.round(white, 1), rng.standard_t(2, n), np.where(np.arange(n) == 77, 40.0, white),
        np.clip(white, -1.0, 1.0) + 9999.0,
    ][kind]  # fmt: skip
    lines = [f"{0.1 * i:.1f},{v:.6g}" for i, v in enumerate(signal.tolist())]

    assert ms.read(put(table("x_mm,z_um", *lines))).metadata["warnings"] == ()


# Rows that look like something else


def test_an_error_cell_at_the_begin_of_a_row_is_no_comment(put):
    lines = [f"{b};{0.1 * i:.1f}" for i, (_, b) in enumerate(wave())]
    lines[30] = "#N/A;3.0"
    lines[40] = ";4.0"

    profile = ms.read(put(table("z_um;x_mm", *lines)))

    assert len(profile) == 60
    assert np.flatnonzero(np.isnan(profile.z)).tolist() == [30, 40]


def test_a_number_cut_within_its_digits_is_said_where_it_can_be(put):
    text = table("x_mm,z_um", *(f"{a:.1f},{b}" for a, b in wave()))[:-3]

    (said,) = ms.read(put(text)).metadata["warnings"]

    assert "line 61, the last one, has no line end" in said


def test_lines_are_set_aside_by_their_number_and_listed(put):
    lines = [f"{a:.1f},{b}" for a, b in wave()]
    lines[10:12] = ["1.0,broken,7", "1.1,1..2"]

    profile = ms.read(put(table("x_mm,z_um", *lines)), skip_lines="12-13")

    assert len(profile) == 58
    listed = profile.metadata["lines"]["listed"]["set aside"]
    assert listed == {"numbers": "12-13", "texts": ("1.0,broken,7", "1.1,1..2")}


def test_a_line_without_a_sample_is_said_where_time_is_counted_by_rows(put):
    lines = [f"{b}" for _, b in wave()]
    lines.insert(30, "")
    path = put(table("gap_um", *lines))

    (said,) = ms.read(path, sampling_rate="1 kHz").metadata["warnings"]

    assert "line 32 stands between the rows and holds no sample" in said


def test_a_row_of_separators_is_left_out_and_named(put):
    lines = [f"{a:.1f},{b}" for a, b in wave()]
    del lines[20]
    kept = ms.read(put(table("x_mm,z_um", *lines), "kept.csv"))
    lines.insert(20, ",")
    path = put(table("x_mm,z_um", *lines))

    profile, (run,) = ms.read(path), ms.read_runs(path, x="x_mm", z="z_um")

    assert profile.x.tolist() == kept.x.tolist()
    assert run.z.tolist() == kept.z.tolist()
    assert "line 22 holds no value" in " ".join(profile.metadata["warnings"])
    with pytest.raises(ms.errors.MetrosepError, match="line 22"):
        ms.read_runs(path, x="x_mm", z="z_um", sampling_rate="1 kHz")


@pytest.mark.parametrize("mark", [",", "."])
def test_990_beside_1000_with_a_mark_shows_that_it_is_one_of_groups(put, mark):
    numbers = ["985", "990", "995", f"1{mark}000", f"1{mark}005", f"1{mark}010"]
    path = put(table("x_mm;z_um", *(f"{i};{z}" for i, z in enumerate(numbers))))

    profile = ms.read(path)

    expected = [v * UM for v in (985, 990, 995, 1000, 1005, 1010)]
    assert profile.z.tolist() == pytest.approx(expected, rel=1e-14, abs=0.0)
    (said,) = profile.metadata["warnings"]
    assert f"decimal='{mark}'" in said


def test_a_comma_among_decimal_points_of_its_own_column_is_refused(put):
    rows = ["0;7.5", "1;7.25", "2;7,123", "3;7.75", "4;7.5"]
    with pytest.raises(ms.errors.ReadError, match="line 4"):
        ms.read(put(table("x_mm;z_um", *rows)))


@pytest.mark.parametrize("row", [",0.5", "nan,0.5"])
def test_a_row_without_a_position_is_named_by_its_line(put, row):
    lines = [f"{a:.1f},{b}" for a, b in wave()]
    lines[20] = row

    for door in (ms.read, lambda p: ms.read_runs(p, x="x_mm", z="z_um")):
        with pytest.raises(ms.errors.MetrosepError, match="line 22"):
            door(put(table("x_mm,z_um", *lines)))


@pytest.mark.parametrize("at", [3, 200, 999, 90_000])
def test_one_separator_too_many_loses_no_row_wherever_it_stands(put, at):
    n = max(1000, at + 10)
    lines = [f"{0.001 * i:.3f},{np.sin(i):.4f}" for i in range(n)]
    lines[at] += ","
    path = put(table("t_s,z_um", *lines))

    whole = ms.read(path)
    (found,) = [np.concatenate([c["z_um"] for c in streamed(path)])]

    assert len(whole) == found.size == n
    assert f"first: line {at + 2}" in " ".join(whole.metadata["warnings"])
    assert any(f"line {at + 2}" in f.problem for f in check_file(path))


# Several runs in one file


def runs_table(*, run=True, time=False, n_runs=4, n=50):
    rows = ["".join(["run," * run, "t_s," * time, "pos_mm,gap_um"])]
    for r in range(n_runs):
        for i in range(n):
            z = np.sin(0.9 * i) + 0.01 * r
            rows.append(f"{f'{r},' * run}{f'{1e-3 * i:.3f},' * time}{0.5 * i:.2f},{z:.5f}")
    return table(*rows)


@pytest.mark.parametrize("run", [True, False])
@pytest.mark.parametrize("time", [True, False])
def test_a_valid_file_of_several_runs_is_no_error(put, capsys, run, time):
    path = put(runs_table(run=run, time=time))

    findings = check_file(path)

    assert code_of("check", str(path)) == 0
    assert "error" not in capsys.readouterr().out
    assert [f.level for f in findings] == ["note"]
    apart = "distinguished by column 'run'" if run else "begin at lines 2, 52, 102, 152"
    assert apart in findings[0].problem
    if run:
        found = ms.read(path)
    else:
        with pytest.raises(ms.errors.FormatMismatchError, match="holds 4 runs") as caught:
            ms.read(path)
        call = re.search(r"metrosep\.(read_runs\(.*?\)), or", str(caught.value)).group(1)
        found = eval(call, {"read_runs": ms.read_runs})  # noqa: S307  the call that the message gives
    assert (found[0].t is not None) == time
    assert [len(r) for r in found] == [50] * 4
    np.testing.assert_allclose(found[0].x, 0.5e-3 * np.arange(50), rtol=1e-12)


def code_of(*words):
    with pytest.raises(SystemExit) as caught:
        main(list(words))
    return caught.value.code or 0


# Hints


TITLES = table("x_mm,z_um", "By hand and in spring", *(f"{a:.1f},{b}" for a, b in wave()))
ROWS = [f"{a:.1f},{b}" for a, b in wave()]
HINTED = {
    "title": TITLES,
    "text inside": table("x_mm,z_um", *ROWS[:30], "pause, new part", *ROWS[30:]),
    "field lost": table("x_mm,z_um", *ROWS[:30], "2.95", *ROWS[30:]),
    "odd word": table("x_mm,z_um", *ROWS[:30], "2.95,broken", *ROWS[30:]),
    "odd quote": table("x_mm,z_um", *ROWS[:30], '2.95,1"', *ROWS[30:]),
    "marker": table("x_mm,z_um", *ROWS[:30], "2.95,-9999", *ROWS[30:]),
    "cut": table("x_mm,z_um", *ROWS) + "6.0",
}
COMMANDS = {
    "info": "info {}",
    "check": "check {}",
    "measure": "measure {} --params Pa",
    "convert": "convert {} {}.out.csv --force",
    "form": "form {}",
    "separate": "separate {} --x x_mm --z z_um --feed '90 mm/min' --method mean",
    "verify": "verify TABLE --against {} --x x_mm --z z_um --feed '90 mm/min'",
}


@pytest.fixture(scope="module")
def comp(tmp_path_factory):
    x = np.linspace(0.0, 6e-3, 61)
    table_ = ms.compensation.CompensationTable.from_error(
        ms.Profile(x, 1e-6 * np.sin(900 * x)),
        positions=np.linspace(0.0, 5.5e-3, 12),
        axis="X",
        compensates="X",
    )
    path = tmp_path_factory.mktemp("table") / "x.csv"
    ms.controllers.write(table_, path, controller="csv", sign_confirmed=True)
    return path


@pytest.mark.parametrize("command", COMMANDS)
@pytest.mark.parametrize("damage", HINTED)
def test_every_hint_works_in_the_command_that_prints_it(put, capsys, request, command, damage):
    path = put(HINTED[damage])
    words = COMMANDS[command].replace("TABLE", "{table}")
    given = {"table": request.getfixturevalue("comp")} if command == "verify" else {}
    typed = shlex.split(words.format(path, path, **given))

    assert code_of(*typed) in (1, 2, 4)
    said = "".join(capsys.readouterr())
    hints = re.findall(
        r'--set "[^"]+"|--(?:skip-\w+|missing|thousands|decimal) "?[^\s;,"]+"?', said
    )
    assert hints, said
    for hint in hints:
        code = code_of(*typed, *shlex.split(hint))
        out = "".join(capsys.readouterr())
        assert code in (0, 1, 3) or "not uniform" in out, (hint, out)  # a row less is a gap
        assert "Usage" not in out
        assert not re.search(r", line \d+ ?[,(]", out)


def test_many_lines_above_a_table_are_kept_at_every_door(put):
    prose = [f"remark {i}: nothing, of interest; here" for i in range(50)]
    path = put(table(*prose, "t_s,z_um", *ROWS))

    whole = ms.read(path)

    assert len(whole) == 60
    assert whole.metadata["lines"]["listed"]["preamble"]["texts"] == tuple(prose)
    assert sum(len(c["z_um"]) for c in streamed(path)) == 60
    assert sum(len(c["z_um"]) for c in streamed(path, skip_rows=50)) == 60
    (found,) = check_file(path)
    assert found.level == "note"
    assert "60 of 111 lines are rows; omitted were preamble: 50 (line 1-50)" in found.problem


@pytest.mark.parametrize("run", [True, False])
@pytest.mark.parametrize("command", ["info", "check", "measure", "convert", "form"])
def test_the_call_that_separates_runs_works_as_it_is_printed(put, capsys, command, run):
    path = put(runs_table(run=run))
    code_of(*shlex.split(COMMANDS[command].format(path, path)))
    said = "".join(capsys.readouterr())
    call = re.search(r"separate them with: metrosep (separate .*)", said)
    if call is None:
        assert command == "info" or (command == "convert" and run)  # it takes runs by itself
        return

    code_of(*shlex.split(call.group(1)), "--feed", "90 mm/min", "--method", "mean")
    assert "error mean, " in capsys.readouterr().err


@pytest.mark.parametrize(
    ("names", "factor"),
    [("Soll [mm];Ist [mm]", 1.0), ("target_mm;position_mm", 1.0), ("nominal_mm;actual_um", 1e3)],
)
def test_an_actual_position_is_no_height(tmp_path, names, factor):
    """A list of nominal and actual positions gave a profile of 14 mm in height, without a word."""
    rows = [(-3.0 + 0.25 * i, -3.0 + 0.25 * i + 1e-3 * (i % 5)) for i in range(57)]
    text = "\n".join(f"{a:.3f};{b * factor:.6f}" for a, b in rows)
    (tmp_path / "list.csv").write_text(f"{names}\n{text}\n", "utf-8")

    with pytest.raises(
        ms.errors.FormatMismatchError, match="looks like the actual position"
    ) as told:
        ms.read(tmp_path / "list.csv")

    x, z = re.search(r"give x='(.*?)', z='(.*?)' if", str(told.value)).groups()
    assert np.ptp(ms.read(tmp_path / "list.csv", x=x, z=z).z) > 0.0139


def test_a_marker_within_the_reach_of_the_heights_is_told_where_it_repeats(tmp_path):
    """Heights of +-4200 nm and -9999 three times: 0.7 spreads away, too near to be refused."""
    heights = [round(4200 * np.sin(0.3 * i), 1) for i in range(60)]
    for i in (0, 1, 59):
        heights[i] = -9999.0
    rows = "\n".join(f"{0.25 * i:.2f};{h}" for i, h in enumerate(heights))
    (tmp_path / "a.csv").write_text(f"x_mm;z_nm\n{rows}\n", "ascii")

    (warning,) = ms.read(tmp_path / "a.csv").metadata["warnings"]
    assert "-9999 in 3 row(s) (first: line 2)" in warning
    assert np.isnan(ms.read(tmp_path / "a.csv", missing="-9999").z).sum() == 3


def test_rows_without_a_position_are_named_so_that_one_call_leaves_all_of_them_out(tmp_path):
    rows = [f"{0.5 * i:.1f};{i % 7}" for i in range(30)]
    rows[5] = rows[17] = rows[22] = ";3"
    (tmp_path / "a.csv").write_text("x_mm;z_um\n" + "\n".join(rows) + "\n", "ascii")

    with pytest.raises(ms.errors.FormatMismatchError, match="NaN in 3 row") as told:
        ms.read(tmp_path / "a.csv")

    given = re.search(r"skip_lines='(.*?)'", str(told.value))[1]
    assert len(ms.read(tmp_path / "a.csv", skip_lines=given)) == 27


@pytest.mark.parametrize("command", ["check {}", "measure {} --params Pa", "convert {} {}.h5"])
def test_a_unit_that_no_column_declares_is_given_as_the_hints_say(put, capsys, command):
    """Two columns without names: one hint after the other names a column and its unit."""
    path = put(table(*(f"{a:.1f} {b}" for a, b in wave())))
    typed = shlex.split(command.format(path, path))
    for _ in range(2):
        assert code_of(*typed) in (2, 4)
        said = "".join(capsys.readouterr())
        typed += shlex.split(re.search(r'--set "[xz]=column\d:um"', said).group())

    assert code_of(*typed) == 0


def test_capitals_in_a_row_of_units_are_told_as_those_in_a_header_are(put):
    path = put(table("x,z", "MM,UM", *(f"{a:.1f},{b}" for a, b in wave())))

    warnings = ms.read(path).metadata["warnings"]

    assert [w.partition(";")[0] for w in warnings] == [
        "column 'x': MM was read as mm",
        "column 'z': UM was read as um",
    ]


def test_a_long_file_that_ends_within_a_row_says_so_in_chunks_too(tmp_path):
    path = tmp_path / "log.csv"
    rows = "".join(f"{0.001 * i:.3f},{np.sin(0.01 * i):.6f}\n" for i in range(3000))
    path.write_text("t_s,gap_um\n" + rows + "3.000,-0.98", "ascii")

    with open_stream(path) as stream:
        n = sum(chunk["gap_um"].size for chunk in stream.chunks(700))

    assert n == 3001
    assert "line 3002, the last one, has no line end" in stream.warnings[-1]


@pytest.mark.parametrize("missing", ["-9999", [-9999]])
@pytest.mark.parametrize("field", ["-9999 um", "-9999", "-9999.0 um"])
def test_a_marker_counts_in_the_unit_of_the_field_too(put, missing, field):
    """A reading of -9999 um among some of 0.1 um: not measured, not 10 mm deep."""
    heights = [field if i in (2, 5) else f"0.{i} um" for i in range(12)]
    path = put(table("x;z", *(f"{i} mm;{h}" for i, h in enumerate(heights))))

    profile = ms.read(path, missing=missing)

    assert np.flatnonzero(np.isnan(profile.z)).tolist() == [2, 5]
    assert float(np.nanmin(profile.z)) == 0.0
    assert profile.z[7] == pytest.approx(0.7 * UM, rel=1e-12, abs=1e-18)


def test_a_channel_whose_unit_is_not_known_is_not_dropped_in_silence(put):
    rows = [f"{0.1 * i:.1f};0.{i};{i}.5 N;{'ok' if i % 3 else 'idle'}" for i in range(8)]

    recording = ms.read(put(table("t_s;z_um;force;state", *rows)))

    assert list(recording.channels) == ["z_um"]
    (warning,) = recording.metadata["warnings"]
    assert "column 'force' holds texts such as '0.5 N'" in warning
    plain = put(table("t_s;z_um;force [N]", *(r.partition(" N")[0] for r in rows)))
    assert ms.read(plain).channels["force [N]"].tolist() == [i + 0.5 for i in range(8)]


def test_a_marker_in_a_column_that_is_not_asked_for_blocks_no_other(put):
    """A counter or a status may end at 999; the same column asked for is refused."""
    rows = [f"{i / 10},{(7 * i) % 5}.5,{9999 if i == 20 else i % 4}" for i in range(40)]
    path = put("x_mm,z_um,status\n" + "\n".join(rows) + "\n")

    found = ms.read(path, x="x_mm", z="z_um")

    assert found.z[21] == pytest.approx(2.5e-6, rel=1e-12, abs=0.0)  # rounded in one product
    assert any("holds 9999 in 1 row" in w for w in found.metadata["warnings"])
    assert len(ms.read_runs(path, x="x_mm", z="z_um")[0].z) == len(rows)
    for options in ({}, {"x": "x_mm", "z": "status:um"}):
        with pytest.raises(ms.errors.AmbiguousFormatError, match="line 22"):
            ms.read(path, **options)
    with open_stream(path, channels=["z_um"]) as stream:
        assert sum(c["z_um"].size for c in stream.chunks(16)) == len(rows)
    with open_stream(path) as stream, pytest.raises(ms.errors.ReadError, match="holds 9999"):
        list(stream.chunks(16))


LISTED = "Target (mm),Run 1 (µm),Run 2 (µm)\n0.00,1.5,2.5\n0.25,-1.0,2.0\n0.50,4.0,0.5\n"


def test_a_list_of_units_that_agrees_with_the_names_is_no_contradiction(put):
    """The word in front shifts the list: its mm stands above a column in um."""
    path = put("Explore 4\nMachine,Lathe\nUnits,mm,µm\n\n" + LISTED)

    profile = ms.read(path, x="Target (mm)", z="Run 1 (µm)")

    assert [float(v) for v in profile.x] == pytest.approx(
        [0.0, 0.25e-3, 0.5e-3], rel=1e-15, abs=0.0
    )
    assert [float(v) for v in profile.z] == pytest.approx(
        [1.5e-6, -1e-6, 4e-6], rel=1e-15, abs=0.0
    )


@pytest.mark.parametrize(
    ("units", "names", "said"),
    [
        ("Units,mm,nm", LISTED, "lists mm, nm, and .* 'Run 1 .* in um"),
        ("Units,in,µm", LISTED, "lists in, um, and .* 'Target .* in mm"),
        ("Einheit,mm,µm", LISTED.replace(" (mm)", "").replace(" (µm)", ""), "'Run 1' without"),
    ],
)
def test_a_list_of_units_that_does_not_agree_is_refused_with_both(put, units, names, said):
    with pytest.raises(ms.errors.FormatMismatchError, match=rf"line 2 .*{said}.*skip_lines='2'"):
        ms.read(put(f"Explore 4\n{units}\n\n{names}"), x="Target:mm", z="Run 1:um")


def test_units_under_their_columns_count_one_by_one(put):
    rows = "No,Target,Run 1\n1,0.00,1.5\n2,0.25,-1.0\n3,0.50,4.0\n"

    profile = ms.read(put("Units,mm,µm\n" + rows), x="Target", z="Run 1")

    assert profile.x[-1] == pytest.approx(0.5e-3, rel=1e-15, abs=0.0)
    with pytest.raises(ms.errors.FormatMismatchError, match="in nm by its name, but in um"):
        ms.read(put("Units,mm,µm\n" + rows.replace("Run 1", "Run 1 (nm)")), x="Target", z="Run 1")


def test_degrees_of_a_temperature_are_no_angle_and_seconds_of_an_angle_no_clock(tmp_path):
    """Grad and Sekunden stand for two units each; the name of the column tells which is not meant."""
    file = tmp_path / "t.csv"
    rows = "".join(f"{0.1 * i:.1f};{i % 7};{20 + 0.01 * i:.2f}\n" for i in range(30))
    file.write_text("Zeit_s;Weg_um;Temperatur [Grad]\n" + rows, encoding="utf-8")
    read = ms.read(file)
    assert read.channels["Temperatur [Grad]"][0] == 20.0
    assert "rad" not in read.units.values()
    file.write_text(
        "Position [mm];Winkel [Sekunden]\n" + "".join(f"{i};{2 * i + i % 3}\n" for i in range(30)),
        encoding="utf-8",
    )
    with pytest.raises(UnitError, match="Sekunden"):
        ms.read(file)


ROW_NUMBERS = [
    "No.", "Row #", "#", "N", "Sample", "line", "ID", "Nr.", "lfd. Nr.", "Zeile", "Messpunkt", "Pos.-Nr.",
    "N°", "n° de ligne", "Num.", "Numéro", "Ligne", "N.", "n. riga", "Riga", "N. punto", "Núm.", "n.º", "Fila",
    "序号", "编号", "行号", "番号", "行番号", "No．", "連番", "№", "№ п/п", "Номер",
]  # fmt: skip


@pytest.mark.parametrize("name", ROW_NUMBERS)
def test_a_column_that_numbers_the_rows_is_not_measured(put, name):
    rows = [f"{k + 1};{0.5 * k};{k % 5}.25" for k in range(20)]
    of_places = ms.read(put("\n".join([f"{name};x_mm;z_um", *rows]) + "\n"))
    of_times = ms.read(put("\n".join([f"{name};t_s;probe_um", *rows]) + "\n"))

    assert of_places.x.tolist() == [0.5e-3 * k for k in range(20)]
    assert of_places.z.tolist() == [float(f"{k % 5}.25") * 1e-6 for k in range(20)]
    assert list(of_times.channels) == ["probe_um"]


def test_row_numbers_that_jump_say_where_rows_may_be_missing(put):
    rows = [f"{k + 1 + (k > 11)};{0.5 * k};{k % 5}.25" for k in range(20)]
    read = ms.read(put("\n".join(["N°;t_s;probe_um", *rows]) + "\n"))

    assert list(read.channels) == ["probe_um"]
    assert any("line 14" in w and "from 12 to 14" in w for w in read.metadata["warnings"])


@pytest.mark.parametrize(
    "column",
    [[2 * k for k in range(20)], [k // 2 for k in range(20)], [0.5 * k for k in range(20)]],
)
def test_a_column_with_the_name_of_a_number_that_counts_no_rows_stays(put, column):
    rows = [f"{n};{0.5 * k};{k % 5}.25" for k, n in enumerate(column)]
    read = ms.read(put("\n".join(["N;t_s;probe_um", *rows]) + "\n"))

    assert read.channels["N"].tolist() == column


@pytest.mark.parametrize("unit", [None, "um"])
@pytest.mark.parametrize(
    "name",
    ["probe_counts", "z [counts]", "Taster (Impulse)", "z_inc", "z.counts", "z-counts", "zCounts",
     "z_ticks", "z_digits", "z (LSB)"],
)  # fmt: skip
def test_counts_are_not_offered_as_micrometres(put, name, unit):
    path = put(f"x_mm;{name}\n" + "".join(f"{k};{k * k % 7}\n" for k in range(9)))

    with pytest.raises(ms.errors.UnitError, match="holds counts") as refused:
        ms.read(path, unit=unit)
    assert "unit=" not in str(refused.value)
    assert "'um'" not in str(refused.value)


def test_one_unit_for_all_is_not_that_of_counts(put):
    """Whoever knows that a count is 1 um says so of that column."""
    rows = "".join(f"{k};{k};{k * k % 7}\n" for k in range(9))
    both = put(f"x_counts;load_N;z_counts\n{rows}")
    for unit in ("um", "mm"):
        with pytest.raises(ms.errors.UnitError, match="holds counts"):
            ms.read(both, x="x_counts", z="z_counts", unit=unit)
    named = ms.read(both, x="x_counts:mm", z="z_counts:um")
    assert (named.x[-1], named.z[3]) == pytest.approx((8e-3, 2e-6), abs=1e-15)
    with pytest.raises(ms.errors.UnitError, match="counts, which are not in um"):
        open_stream(put(f"x_counts;kCounts;z_counts\n{rows}"), unit="um")
    with open_stream(put(f"x;zinc;z_counts\n{rows}"), unit="um") as stream:
        assert [u and u.name for u in stream.units.values()] == ["um", "um", None]


@pytest.mark.parametrize(
    "numbers",
    [[*range(20), *range(22, 30), *range(33, 40, 3)], [*range(20), 19, *range(20, 30)],
     [10 * k for k in range(30)]],
    ids=["many gaps", "a step back", "every tenth"],
)  # fmt: skip
def test_numbers_of_rows_are_no_positions_in_the_message_about_a_step(put, numbers):
    path = put("n,z_um\n" + "".join(f"{n},{k % 7}.5\n" for k, n in enumerate(numbers)))
    with pytest.raises(ms.errors.FormatMismatchError, match="'n' seems to number") as refused:
        ms.read(path, lateral_step="1 um")
    assert "z='z_um'" in str(refused.value)
    profile = ms.read(path, lateral_step="1 um", z="z_um")
    assert profile.x[-1] == pytest.approx((len(numbers) - 1) * 1e-6, abs=1e-15)
