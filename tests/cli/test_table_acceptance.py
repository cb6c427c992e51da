"""No table leaves that would worsen the machine: judged from outside, on a machine written here.

The machine is a formula, its readings are text, and what the controller adds is looked up in the
bytes of the file as LinuxCNC's manual says: nominal minus column, linear between, held outside. No
reader, writer or simulator of ours has a say.
"""

import json
import re

import numpy as np
import pytest

COLUMNS = ("--x", "x_mm", "--z", "z_um", "--run", "run")
MEAN = ("--method", "mean", "--axis", "X", "--spacing", "2 mm")
LENGTH = 130.0
X = np.linspace(0.0, LENGTH, 521)


def pitch_um(x_mm):
    """Positioning error: 23 um/m and two waves."""
    return (
        23e-3 * x_mm
        + 0.9 * np.sin(2 * np.pi * x_mm / 37.0)
        + 0.3 * np.sin(2 * np.pi * x_mm / 20.0)
    )


def readings(path, error_um=pitch_um, *, n=5, seed=3, noise=0.03, drift=0.4e-3, spike=0.0, x=X):
    """Runs with noise, a slope of its own for each (temperature) and another zero."""
    rng = np.random.default_rng(seed)
    rows = ["x_mm,z_um,run"]
    for k in range(n):
        z = (
            error_um(x)
            + rng.normal(0, noise, x.size)
            + rng.normal(0, drift) * x
            + rng.normal(0, 2.0)
        )
        if k == 1:
            z[200:203] += spike
        rows += [f"{a:.6f},{b:.6f},{k}" for a, b in zip(x, z, strict=True)]
    path.write_text("\n".join(rows) + "\n")
    return path


def added_um(file, x_mm):
    """What LinuxCNC adds to a command."""
    nominal, column, _ = np.loadtxt(file).T
    return 1e3 * np.interp(x_mm, nominal, nominal - column)


MM = ("--machine", "linear_units=mm")
"""A compensation file of LinuxCNC has no unit."""


def comp(path, correction_um, places=None):
    """A file as the manual of LinuxCNC describes it, written by hand."""
    p = np.arange(0.0, LENGTH + 0.1, 2.0) if places is None else places
    column = p - 1e-3 * correction_um(p)
    path.write_text("".join(f"{a:.6f} {b:.9f} {b:.9f}\n" for a, b in zip(p, column, strict=True)))
    return path


def machine_um(file, error_um=pitch_um):
    """True error with a table: the axis stands at p + c, where its error is looked up; zero at 0."""
    c = added_um(file, X)
    return c + error_um(X + 1e-3 * c) - error_um(np.zeros(1))


def pv(values):
    return float(np.ptp(np.append(values, 0.0)))


def test_table_of_an_axis_on_itself_takes_its_slope_away(metrosep, tmp_path):
    runs, file = readings(tmp_path / "runs.csv"), tmp_path / "x.comp"

    code, _, err = metrosep(
        "separate", runs, *COLUMNS, *MEAN, "--compensates", "X", "--table", f"linuxcnc={file}"
    )

    assert code == 0, err
    assert pv(pitch_um(X)) > 3.0
    assert pv(machine_um(file)) < 0.12 * pv(pitch_um(X))  # slopes of five runs scatter by 0.4 um/m
    assert "X -> X (its own positioning)" in err
    assert "5 runs, each omitted once" in err
    assert "accepted" in err


def test_corrected_axis_is_asked_for_with_both_answers(metrosep, tmp_path):
    runs = readings(tmp_path / "runs.csv")
    table = ("--table", f"linuxcnc={tmp_path / 'x.comp'}")
    assert metrosep("separate", runs, *COLUMNS, *MEAN, "-o", tmp_path / "out")[0] == 0

    for call in (
        ("separate", runs, *COLUMNS, *MEAN, *table),
        ("table", tmp_path / "out", "-o", tmp_path / "x.comp"),
    ):
        code, _, err = metrosep(*call)
        assert code == 2
        assert "--compensates X" in err
        assert "--compensates Z" in err
    assert not (tmp_path / "x.comp").exists()


def test_one_run_proves_nothing_and_its_waiver_has_a_name(metrosep, tmp_path):
    runs, file = readings(tmp_path / "runs.csv", n=1), tmp_path / "x.comp"
    call = ("separate", runs, *COLUMNS, *MEAN, "--compensates", "X", "--table", f"linuxcnc={file}")

    code, _, err = metrosep(*call)
    assert code == 3
    assert "one run made the table" in err
    assert not file.exists()

    code, _, err = metrosep(*call, "--waive", "single", "--waive", "inconclusive")
    assert code == 0, err
    assert "accepted with --waive single" in err


def test_noise_alone_makes_no_table(metrosep, tmp_path):
    """Runs that share nothing: a table of their mean would only add noise."""
    runs = readings(tmp_path / "runs.csv", lambda x: 0.0 * x, noise=0.5, drift=0.0)
    file = tmp_path / "x.comp"

    code, _, _ = metrosep(
        "separate", runs, *COLUMNS, *MEAN, "--compensates", "X", "--table", f"linuxcnc={file}"
    )

    assert code in (1, 3)
    assert not file.exists()


def test_spike_of_one_run_is_named_and_stays_out_of_the_table(metrosep, tmp_path):
    runs, file = readings(tmp_path / "runs.csv", spike=25.0), tmp_path / "x.comp"

    code, _, err = metrosep(
        "separate", runs, *COLUMNS, *MEAN, "--compensates", "X", "--table", f"linuxcnc={file}"
    )

    assert code == 1
    assert re.search(r"run '1' has a spike of 2[45]\.?\d* um at 50", err)
    assert not file.exists()


def spoilt(kind):
    def right(p):
        return -(pitch_um(p) - pitch_um(0.0))

    return {
        "right": right,
        "wrong sign": lambda p: -right(p),
        "1000 times too small": lambda p: 1e-3 * right(p),
        "gain 2.4": lambda p: 2.4 * right(p),
        "tilt of 1 mm": lambda p: right(p) + 1000.0 * p / LENGTH,
        "tilt of 6 um": lambda p: right(p) - 6.0 * p / LENGTH,
        "offset of 30 um": lambda p: right(p) + 30.0,
        "line left out": lambda p: right(p) + 23e-3 * p,
        "read 60 mm late": lambda p: right(np.clip(p - 60.0, 0.0, None)),
        "mirrored": lambda p: right(LENGTH - p) - right(LENGTH),
        "another axis": lambda p: 1.5 * np.sin(2 * np.pi * p / 55.0),
    }[kind]


@pytest.mark.parametrize(
    ("kind", "expected"),
    [
        ("right", 0),
        ("wrong sign", 1),
        ("1000 times too small", 1),
        ("gain 2.4", 1),
        ("tilt of 1 mm", 1),
        ("tilt of 6 um", 1),
        ("offset of 30 um", 1),
        ("line left out", 1),
        ("read 60 mm late", 1),
        ("mirrored", 1),
        ("another axis", 1),
    ],
)
def test_file_from_elsewhere_passes_only_if_the_machine_is_better_with_it(
    metrosep, tmp_path, kind, expected
):
    runs = readings(tmp_path / "runs.csv", seed=11)
    file = comp(tmp_path / "x.comp", spoilt(kind))

    code, out, err = metrosep("verify", file, "--against", runs, *COLUMNS, *MM, "--json")

    assert code == expected, err
    found = json.loads(out)
    left = machine_um(file)
    before = pitch_um(X)
    rms = [float(np.sqrt(np.mean((v - v.mean()) ** 2) + v[0] ** 2)) for v in (before, left)]
    # the true machine, which no reader of ours has seen: mean squares with and without the table
    assert found["improvement_m2"] * 1e12 == pytest.approx(
        rms[0] ** 2 - rms[1] ** 2, abs=0.12 * rms[0] ** 2 + 0.02 * rms[1] ** 2
    )
    assert (found["grade"] == "accepted") == (expected == 0)
    if expected == 0:
        assert pv(left) < 0.05 * pv(before)
    assert ("reversed sign" in err) == (kind == "wrong sign")


@pytest.mark.parametrize("part", [(0.0, 8.0), (60.0, 130.0)])
def test_table_that_was_not_measured_along_its_length_is_refused(metrosep, tmp_path, part):
    runs = readings(tmp_path / "runs.csv", x=np.linspace(*part, 301))
    file = comp(tmp_path / "x.comp", spoilt("right"))

    code, _, err = metrosep("verify", file, "--against", runs, *COLUMNS, *MM)

    assert code == 1
    assert "measure the whole table" in err


def test_table_shorter_than_the_travel_is_refused_where_it_is_held(metrosep, tmp_path):
    """The correction of the last entry is held beyond it, where the error comes back."""

    def error(x):
        return 3.0 * np.sin(np.pi * x / LENGTH)

    runs = readings(tmp_path / "runs.csv", error, drift=0.0)
    places = np.arange(0.0, 66.0, 5.0)
    file = comp(tmp_path / "x.comp", lambda p: -error(p), places)

    code, _, err = metrosep("verify", file, "--against", runs, *COLUMNS, *MM)

    assert code == 1
    assert "beyond the table" in err


def test_runs_that_made_a_table_are_left_out_one_by_one_when_it_is_verified(metrosep, tmp_path):
    runs, file = readings(tmp_path / "runs.csv"), tmp_path / "x.comp"
    made = ("separate", runs, *COLUMNS, *MEAN, "--compensates", "X", "--table", f"linuxcnc={file}")
    assert metrosep(*made)[0] == 0
    other = readings(tmp_path / "other.csv", seed=8)

    own = metrosep("verify", file, "--against", runs, *COLUMNS)
    foreign = metrosep("verify", file, "--against", other, *COLUMNS)

    assert own[0] == foreign[0] == 0
    assert "each omitted once" in own[2]
    assert "omitted" not in foreign[2]


def test_second_iteration_on_a_wrong_signed_table_brings_the_true_error_down(tmp_path):
    """With c_old = +e/2 active the machine shows c_old(p) + e(p + c_old(p)); both orders are tried."""
    from metrosep import Run, RunSet, controllers
    from metrosep.compensation import CompensationTable, combine_tables
    from metrosep.errors import SignCheckFailedError
    from metrosep.separation import separate

    p = np.arange(0.0, LENGTH + 0.1, 2.0) * 1e-3
    old = CompensationTable(p, 0.5e-6 * (pitch_um(p * 1e3) - pitch_um(0.0)), None, "X", "X", 0.0)
    x, rng = X * 1e-3, np.random.default_rng(1)
    seen = old.correction(x) + 1e-6 * pitch_um(1e3 * (x + old.correction(x)))
    runs = RunSet([Run(x, seen + rng.normal(0, 2e-8, x.size), feed=0.1) for _ in range(4)])
    new = CompensationTable.from_error(separate(runs, method="mean"), positions=p, axis="X")

    file = tmp_path / "x.comp"
    controllers.write(combine_tables(old, new), file, "linuxcnc")

    assert pv(machine_um(file)) < 0.06 * pv(pitch_um(X))
    line = np.polyval(np.polyfit(p, new.forward, 1), p)
    levelled = CompensationTable(p, new.forward - line + line[0], None, "X", "X", 0.0)
    raw = RunSet([Run(x, 1e-6 * pitch_um(X) + rng.normal(0, 2e-8, x.size)) for _ in range(4)])
    with pytest.raises(SignCheckFailedError, match="does not shrink"):
        combine_tables(old, levelled).verify(raw)


def test_a_run_that_was_left_out_makes_no_table_and_judges_none(metrosep, tmp_path):
    runs, file = readings(tmp_path / "runs.csv", n=6), tmp_path / "x.comp"
    head, *rows = runs.read_text().splitlines()
    spoilt = [
        f"{x},{1e3 * float(z):.6f},{run}" if run == "4" else f"{x},{z},{run}"
        for x, z, run in (row.split(",") for row in rows)
    ]
    runs.write_text("\n".join([head, *spoilt]) + "\n")
    call = ("separate", runs, *COLUMNS, *MEAN, "--compensates", "X", "--table", f"linuxcnc={file}")

    refused, _, why = metrosep(*call)
    code, _, err = metrosep(*call, "--exclude", "4")

    assert refused == 4
    assert "run 4 reads" in why
    assert "--exclude 4" in why
    assert code == 0, err
    assert "judged on 5 runs, each omitted once" in err
    assert pv(machine_um(file)) < 0.12 * pv(pitch_um(X))


def test_terminal_and_json_name_axes_span_entries_slope_and_zero(metrosep, tmp_path):
    """1.12 of the specification, for a table that is written and for the file that is verified."""
    runs, file = readings(tmp_path / "runs.csv", n=4), tmp_path / "x.comp"
    slope = (
        np.polyfit(np.arange(0.0, 131.0, 2.0), -pitch_um(np.arange(0.0, 131.0, 2.0)), 1)[0] * 1e3
    )

    made = metrosep(
        "separate", runs, *COLUMNS, *MEAN, "--compensates", "X", "--table", f"linuxcnc={file}"
    )
    text = metrosep("verify", file, "--against", runs, *COLUMNS)
    document = metrosep("verify", file, "--against", runs, *COLUMNS, "--json")

    assert made[0] == text[0] == document[0] == 0, made[2]
    found = json.loads(document[1])
    sidecar = json.loads((tmp_path / "x.comp.json").read_text())
    for headline in (
        next(line for line in made[2].splitlines() if "X -> X" in line).removeprefix("table "),
        next(line for line in text[2].splitlines() if "X -> X" in line).removeprefix("table "),
        found["headline"],
        sidecar["table"]["headline"],
    ):
        said = re.fullmatch(
            r"X -> X \(its own positioning\), 0 \.\.\. 130 mm, 66 entries, slope (\S+) um/m kept, zero at "
            r"0 mm",
            headline,
        )
        # slopes of four runs scatter by 0.4 um/m: their mean by 0.2
        assert float(said[1]) == pytest.approx(slope, abs=0.8)
    for sentence in found["sentences"]:
        assert sentence in text[2]
        assert sentence in made[2]
    assert found["sentences"] == sidecar["verification"]["sentences"]
    assert re.search(
        r"judged on 4 runs, each omitted once, 0 \.\.\. 130 mm; off the readings: one constant",
        found["sentences"][0],
    )
    assert re.search(
        r"RMS that repeats \S+ [nu]m -> \S+ [nu]m, P-V .* \(noise alone .*\), gain 1\.?\d* \+- ",
        found["sentences"][1],
    )
    # four runs at one feed
    assert any("disturbance of fixed wavelength" in w for w in found["warnings"])
    for warning in found["warnings"]:
        assert f"warning: {file}: {warning}" in text[2]


def test_mistake_is_named_at_the_terminal_and_in_json(metrosep, tmp_path):
    runs = readings(tmp_path / "runs.csv", seed=11)
    file = comp(tmp_path / "x.comp", spoilt("1000 times too small"))

    code, out, err = metrosep("verify", file, "--against", runs, *MM, *COLUMNS, "--json")

    assert code == 1
    said = "it is 1000 times too small (a unit: mm and um, or um and nm)"
    assert said in err
    assert json.loads(out)["diagnosis"] == said


def test_one_run_that_did_not_make_a_table_is_judged_in_full(metrosep, tmp_path):
    """1.10; one run of pitch does not show its slope, one of straightness needs none."""
    runs = readings(tmp_path / "runs.csv", n=1)
    right, wrong = (comp(tmp_path / f"{k[:5]}.comp", spoilt(k)) for k in ("right", "wrong sign"))

    code, _, err = metrosep("verify", right, "--against", runs, *MM, *COLUMNS)
    assert code == 3
    assert "one run of positioning does not show its slope" in err
    assert metrosep("verify", wrong, "--against", runs, *MM, *COLUMNS)[0] == 1


def bed_um(x_mm, y_mm):
    return 2.0 * np.sin(x_mm / 20.0) * (0.5 + y_mm / 60.0) ** 2


def written_map(path, seed, error_um=bed_um, noise_um=0.05):
    """A measured map of 41 x 31 nodes every 2 mm, with a zero of its own."""
    import metrosep as ms

    x, y = np.meshgrid(2.0 * np.arange(41), 2.0 * np.arange(31))
    z = error_um(x, y) + np.random.default_rng(seed).normal(0.0, noise_um, x.shape) + seed
    ms.write(ms.Surface(1e-6 * z, dx=2e-3, dy=2e-3), path)
    return path


def test_map_is_judged_by_the_map_that_made_it_and_by_a_second_one(metrosep, tmp_path):
    first, second = (written_map(tmp_path / f"{k}.x3p", k) for k in (1, 2))
    file = tmp_path / "bed.csv"

    made = metrosep("table", first, "--format", "csv-map", "--spacing", "2 mm", "-o", file)
    own = metrosep("verify", file, "--format", "csv-map", "--against", first, "--json")
    other = metrosep("verify", file, "--format", "csv-map", "--against", second)

    assert made[0] == own[0] == other[0] == 0, made[2] + own[2] + other[2]
    headline = (
        "X, Y -> Z, X = 0 mm ... 80 mm x Y = 0 mm ... 60 mm, 41 x 31 entries, plane kept, zero at X = 0 mm, "
        "Y = 0 mm"
    )
    assert f"table {headline}" in made[2]
    assert f"table {headline}" in other[2]
    assert "one map: what repeats is not known" in made[2]
    assert "judged against a second map, " in other[2]
    assert "one map" not in other[2]
    found = json.loads(own[1])
    assert found["headline"] == headline
    assert found["warnings"] == ["one map: what repeats is not known"]
    assert found["against_kind"] == "made"


@pytest.mark.parametrize(
    ("error_um", "code"),
    [
        (bed_um, 0),
        (lambda x, y: -bed_um(x, y), 1),
        (lambda x, y: bed_um(80.0 - x, y), 3),  # a third of it is right, by chance
        (lambda x, y: bed_um(4 * y / 3, 0.75 * x), 1),
        (lambda x, y: 5.0 * bed_um(x, y), 1),
        (lambda x, y: 0.0 * x, 1),
    ],
    ids=["same", "sign", "mirrored", "exchanged", "a fifth", "nothing left"],
)
def test_map_passes_only_if_a_second_one_shows_that_it_helps(metrosep, tmp_path, error_um, code):
    first, second = (
        written_map(tmp_path / "1.x3p", 1),
        written_map(tmp_path / "2.x3p", 2, error_um),
    )
    file = tmp_path / "bed.csv"
    assert metrosep("table", first, "--format", "csv-map", "--spacing", "2 mm", "-o", file)[0] == 0

    found = metrosep("verify", file, "--format", "csv-map", "--against", second)

    assert found[0] == code, found[2]
    accused = "the sign of the measurement or of the map is wrong" in found[2]
    assert accused == (error_um(20.0, 60.0) == -bed_um(20.0, 60.0))
