"""Runs that metrosep wrote come back as runs by every door: nothing is lost, no unit is changed."""

import math
import shlex

import numpy as np
import pytest

import metrosep as ms
from metrosep.cli.main import main
from metrosep.io.check import check_file

pytestmark = pytest.mark.usefixtures("without_figures")

X = np.linspace(0.0, 0.01, 21)
Z = 1e-6 * np.sin(300.0 * X) + 1e-7 * X
GAPS = np.where(X > 0.0096, np.nan, Z)

SETS = {
    "one": [ms.Run(X, Z, feed=0.05)],
    "feeds": [ms.Run(X, Z, feed=0.05, run_id="a"), ms.Run(X[::-1], -Z, feed=0.01, run_id="b")],
    "one without a feed": [ms.Run(X, Z, feed=0.05), ms.Run(X, 2.0 * Z)],
    "one without a clock": [ms.Run(X, Z, t=X / 0.05), ms.Run(X, Z)],
    "same names": [ms.Run(X, Z, run_id="a"), ms.Run(X, 2.0 * Z, run_id="a")],
    "odd names": [ms.Run(X, GAPS, run_id='a,b"c'), ms.Run(X, Z, run_id="run 7")],
    "whole numbers": [ms.Run(X, k * Z, run_id=str(k)) for k in (10, 2, 1)],
}


@pytest.mark.parametrize("suffix", ["csv", "h5"])
@pytest.mark.parametrize("kind", SETS)
@pytest.mark.parametrize("door", [ms.read, ms.read_runs])
def test_a_set_of_runs_comes_back(tmp_path, suffix, kind, door):
    runs = ms.RunSet(SETS[kind])
    path = ms.write(runs, tmp_path / f"runs.{suffix}")

    back = door(path)

    assert isinstance(back, ms.RunSet)
    assert len(back) == len(runs)
    for old, new in zip(runs, back, strict=True):
        assert new.x.tolist() == old.x.tolist()
        np.testing.assert_array_equal(new.z, old.z)
        assert (new.t is None) == (old.t is None)
        assert new.t is None or new.t.tolist() == old.t.tolist()
        assert new.feed == old.feed
    assert not [f for f in check_file(path) if f.level == "error"]


def test_runs_of_an_axis_that_turns_keep_their_units(tmp_path):
    rows = [f"{k},{10 * i},{0.1 * i + k}" for k in range(3) for i in range(10)]
    source = tmp_path / "turns.csv"
    source.write_text("\n".join(["run,c_deg,z_arcsec", *rows]) + "\n")
    runs = ms.read_runs(source, x="c_deg", z="z_arcsec", run="run", angles=True)

    back = ms.read(ms.write(runs, tmp_path / "own.csv"))

    assert (back.metadata["unit"], back.metadata["z_unit"]) == ("rad", "rad")
    assert back[2].x.tolist() == runs[2].x.tolist()
    assert back[2].z.tolist() == runs[2].z.tolist()
    # 10 degrees and 2.1 arc seconds, by hand
    assert back[2].x[1] == pytest.approx(np.pi / 18.0, rel=0.0, abs=1e-15)
    assert back[2].z[1] == pytest.approx(2.1 / 3600.0 * np.pi / 180.0, rel=0.0, abs=1e-18)
    assert "read" in [s.name for s in back.history]


@pytest.mark.parametrize(
    "names",
    [
        ("#1", "#2", "ref"), ("#", "!!"), ("%1", "//2", "; 3"), ("7", "07"), ("1", "1.0"),
        ("1e3", "1000"), ("-", "--"), ("nan", "NaN", "N/A"), ("inf", "-inf"), ("#N/A", "bad"),
        ("2026-01-01", "2026-01-02", "ref"), ("5 mm", "6 mm", "x"), ("1", "2", "9999"),
        ("1.000", "990"), ("1;2;3", "4|5", "# 6,7,8"), ("0,5",), ("", "x"),
    ],
)  # fmt: skip
@pytest.mark.parametrize("door", [ms.read, ms.read_runs])
def test_a_name_of_a_run_is_a_name_whatever_it_looks_like(tmp_path, names, door):
    runs = ms.RunSet([ms.Run(X, (k + 1) * Z, run_id=n) for k, n in enumerate(names)])

    back = door(ms.write(runs, tmp_path / "runs.csv"))

    assert [r.run_id for r in back] == [n or "0" for n in names]
    assert [r.z.tolist() for r in back] == [r.z.tolist() for r in runs]
    assert back.metadata["warnings"] == ()
    assert back.metadata["files"][0]["lines"]["data"] == len(names) * X.size


@pytest.mark.parametrize("name", ["A ", " A", "a\nb", "a\rb", "a\u2028b", "a\tb", "\ud800"])
def test_a_name_that_would_not_come_back_is_refused_on_writing(tmp_path, name):
    runs = ms.RunSet([ms.Run(X, Z, run_id="A"), ms.Run(X, 2.0 * Z, run_id=name)])

    with pytest.raises(ms.errors.WriteError, match="does not come back from text"):
        ms.write(runs, tmp_path / "runs.csv")
    assert not (tmp_path / "runs.csv").exists()


@pytest.mark.parametrize("feed", ["0.02", ""])
def test_a_feed_that_changes_within_a_run_is_refused_by_its_line(tmp_path, feed):
    path = ms.write(ms.RunSet([ms.Run(X, Z, feed=0.05, run_id="a")]), tmp_path / "runs.csv")
    lines = path.read_text().splitlines()
    at = lines.index("run,feed_m_s,t_s,x_m,z_m") + 8
    lines[at] = lines[at].replace(",0.05,", f",{feed},")
    path.write_text("\n".join(lines) + "\n")

    with pytest.raises(ms.errors.ReadError, match=rf"feed changes within run 'a'.*line {at + 1}"):
        ms.read(path)


def test_several_files_of_an_axis_that_turns_keep_their_units_and_warnings(tmp_path):
    turning = ms.RunSet([ms.Run(X, Z, run_id="a")], metadata={"unit": "rad", "z_unit": "rad"})
    paths = [ms.write(turning, tmp_path / f"{k}.csv") for k in range(2)]
    paths[1].write_text(paths[1].read_text().rstrip("\n"))  # no line end: a warning

    back = ms.read_runs(paths)

    assert (back.metadata["unit"], back.metadata["z_unit"]) == ("rad", "rad")
    assert "no line end" in back.metadata["warnings"][0]
    assert [f["file"] for f in back.metadata["files"]] == ["0.csv", "1.csv"]
    plain = ms.write(ms.RunSet([ms.Run(X, Z)]), tmp_path / "m.csv")
    with pytest.raises(ms.errors.UnitError, match="one kind at a time"):
        ms.read_runs([*paths, plain])


@pytest.mark.parametrize("suffix", ["csv", "h5"])
def test_the_call_that_check_prints_separates_them(tmp_path, suffix, capsys):
    rng = np.random.default_rng(5)
    parts = [ms.Run(X, Z + 1e-9 * rng.normal(size=21), feed=0.05, run_id=f"r{k}") for k in (1, 2)]
    path = ms.write(ms.RunSet(parts), tmp_path / f"own.{suffix}")
    (note,) = check_file(path)
    call = note.fix.partition("metrosep separate ")[2].split()

    with pytest.raises(SystemExit) as stop:
        main(["separate", *call, "--method", "mean", "-o", str(tmp_path / "out")])

    assert stop.value.code in (0, 3), capsys.readouterr().err


def test_a_table_that_only_looks_like_it_is_read_as_any_other(tmp_path):
    path = tmp_path / "runs.csv"
    path.write_text("run,x_m,z_m\n" + "".join(f"7,{i},{0.1 * i}\n" for i in range(9)))

    assert not isinstance(ms.read(path, x="x_m", z="z_m"), ms.RunSet)
    (run,) = ms.read_runs(path)  # by the names of its columns
    assert run.run_id == "7"
    assert run.z == pytest.approx(0.1 * np.arange(9), rel=0.0, abs=1e-15)  # the digits of the file


def told(folder, kind):
    """Write four runs as metrosep does, or as a person with a spreadsheet; the last has no feed."""
    rng = np.random.default_rng(7)
    parts = [
        ms.Run(X, Z + 1e-9 * rng.normal(size=21), feed=f, run_id=f"r{k}")
        for k, f in enumerate((0.05, 0.05, 0.01, None))
    ]
    path = folder / f"runs.{kind}"
    if kind != "txt":
        return ms.write(ms.RunSet(parts), path)
    rows = [
        f"{r.run_id};{x * 1e3!r};{z * 1e6!r};{'' if r.feed is None else r.feed * 6e4}".replace(
            ".", ","
        )
        for r in parts
        for x, z in zip(r.x.tolist(), r.z.tolist(), strict=True)
    ]
    path.write_text("\n".join(["Lauf;Weg [mm];Abweichung [\u00b5m];Vorschub [mm/min]", *rows, ""]))
    return path


@pytest.mark.parametrize("kind", ["csv", "h5", "txt"])
def test_runs_that_tell_their_columns_need_no_options_at_any_verb(tmp_path, kind, capsys):
    path = told(tmp_path, kind)
    recipe = tmp_path / "r.toml"
    recipe.write_text(
        f'metrosep = 1\n[input]\nfiles = ["{path.name}"]\n[[step]]\nop = "separate"\nmethod = "mean"\n'
    )
    table = tmp_path / "x.comp"
    own = [
        "--machine",
        "cross_axis=hal",
        "--machine",
        "travel_low=0 mm",
        "--machine",
        "travel_high=10 mm",
    ]
    calls = [
        ["separate", path, "--method", "mean", "-o", tmp_path / "a"],
        ["run", recipe, "-o", tmp_path / "b"],
        [
            "table",
            path,
            "--method",
            "mean",
            "--format",
            "linuxcnc",
            "--compensates",
            "Z",
            *own,
            "-o",
            table,
        ],
        ["verify", table, "--against", path, *own[:2]],
    ]

    for call in calls:
        with pytest.raises(SystemExit) as stop:
            main([str(w) for w in call])
        assert stop.value.code == 0, capsys.readouterr().err
    back = ms.read_runs(path)
    assert [r.feed and round(r.feed, 12) for r in back] == [0.05, 0.05, 0.01, None]
    assert [r.run_id for r in back] == ["r0", "r1", "r2", "r3"]


def test_what_is_given_beside_columns_that_are_told_is_used(tmp_path):
    path = told(tmp_path, "txt")
    with pytest.raises(ms.errors.DataError, match=r"600 mm/min.*3000 mm/min"):
        ms.read_runs(told(tmp_path, "csv"), feed="600 mm/min")  # against its clock
    assert [r.feed for r in ms.read_runs(path, feed="600 mm/min")] == [0.01] * 4

    rows = path.read_text().replace("Abweichung [\u00b5m]", "Taster [V]")
    path.write_text(rows)
    with pytest.raises(ms.errors.ReadError, match="scale='SENSITIVITY'"):
        ms.read_runs(path)
    volts = float(rows.splitlines()[4].split(";")[2].replace(",", "."))
    found = ms.read_runs(path, scale="-2 um/V")[0].z[3]
    assert found == pytest.approx(-2e-6 * volts, rel=0.0, abs=1e-18)


def code_of(*words):
    with pytest.raises(SystemExit) as caught:
        main(list(words))
    return caught.value.code


@pytest.mark.parametrize("suffix", ["h5", "csv"])
def test_own_runs_are_converted_and_separated_without_options(tmp_path, suffix, capsys):
    x = np.linspace(0.0, 9e-3, 60)
    z = 1e-6 * np.sin(2e3 * x)
    runs = ms.RunSet([ms.Run(x, z + 1e-9 * k, feed=1e-3 * (1 + k % 2)) for k in range(4)])
    path = ms.write(runs, tmp_path / f"runs.{suffix}")
    other = tmp_path / ("other.csv" if suffix == "h5" else "other.h5")

    assert code_of("convert", str(path), str(other)) == 0
    back = ms.read_runs(other)
    assert code_of("check", str(path)) == 0
    call = capsys.readouterr().out.split("separate them with: metrosep ")[1].splitlines()[0]
    assert shlex.split(call) == ["separate", str(path)]
    assert code_of(*shlex.split(call), "--method", "mean") == 0

    for one, two in zip(runs, back, strict=True):
        np.testing.assert_array_equal(one.x, two.x)
        np.testing.assert_array_equal(one.z, two.z)
        assert one.feed == two.feed


def test_channels_of_a_recording_keep_their_names_however_often_it_is_converted(tmp_path):
    first = tmp_path / "probe.csv"
    first.write_text("t [s],probe [um],feed_mm_min\n0,1,60\n0.1,2,120\n0.2,4,60\n")

    for name in ("a.csv", "b.csv"):
        assert code_of("convert", str(first), str(tmp_path / name)) == 0
        first = tmp_path / name

    lines = [s for s in first.read_text().splitlines() if not s.startswith("#")]
    assert lines[0] == "t_s,probe [m],feed [m/s]"
    np.testing.assert_allclose(
        ms.read(first).channels["probe [m]"], [1e-6, 2e-6, 4e-6], rtol=0, atol=1e-18
    )


def test_runs_over_an_angle_are_sent_to_a_table(tmp_path):
    degrees = np.arange(0.0, 360.0, 5.0)
    rows = [
        f"{k},{a:g},{3 * np.sin(np.radians(a)) + 0.01 * k:.4f}" for k in range(4) for a in degrees
    ]
    path = tmp_path / "turning.csv"
    path.write_text("run,x_deg,z_arcsec\n" + "\n".join(rows) + "\n")

    (note,) = check_file(path)
    call = note.fix.split("with: metrosep ")[1]

    assert note.level == "note"
    words = [
        {"SPACING": "15 deg", "FILE": str(tmp_path / "t.csv")}.get(w, w) for w in shlex.split(call)
    ]
    assert code_of(*words, "--format", "csv") == 0


def _said(capsys, *words):
    with pytest.raises(SystemExit) as stop:
        main([str(w) for w in words])
    said = capsys.readouterr()
    return stop.value.code or 0, said.out + said.err


TURNS = "run,{},error_arcsec\n" + "".join(
    f"{run},{k},{0.25 * k - 1.5 + 0.125 * run}\n" for run in (1, 2) for k in range(361)
)


def test_runs_over_an_angle_are_converted_and_not_taken_for_lengths(tmp_path, capsys):
    source, target = tmp_path / "turns.csv", tmp_path / "back.csv"
    source.write_text(TURNS.format("position_deg"))
    assert _said(capsys, "convert", source, target)[0] == 0

    back = ms.read(target)
    assert back.metadata["unit"] == "rad"
    assert back[1].x[90] == pytest.approx(math.pi / 2, abs=1e-15)
    assert back[1].z[2] == pytest.approx(-0.75 * math.pi / 648_000, abs=1e-20)
    code, said = _said(capsys, "separate", target, "--method", "mean", "-o", tmp_path / "o")
    assert code != 0
    assert "is an angle" in said


def test_the_call_for_runs_over_c_makes_their_table(tmp_path, capsys):
    source = tmp_path / "turns.csv"
    source.write_text(TURNS.format("c_deg"))
    for command in (["check", source], ["convert", source, tmp_path / "back.csv"]):
        said = _said(capsys, *command)[1]
        assert "metrosep separate" not in said
        call = said[said.index("metrosep table ") :].splitlines()[0]
        assert "--x c_deg" in call
        words = shlex.split(call.replace("SPACING", "'30 deg'"))[1:-1]
        said = _said(capsys, *words, tmp_path / "c.csv")[1]
        assert "the table covers 0 deg ... 360 deg" in said  # the travel is left to be stated
