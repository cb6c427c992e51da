"""``metrosep machine-tables``: the files against the tool-point error of a plain chain, computed here.

The machine is bed - X - Y - Z - tool. Its error is written as displacements and turns with their levers,
E = sum over the axes of d + theta x r, where r leads from the slide to the tool: no product of matrices,
no code of the library. A table is looked up as its format says: straight lines between the entries.
"""

import json

import numpy as np
import pytest

UM, MM = 1e-6, 1e-3
MACHINE = (
    'name = "stack"\n'
    + "".join(
        f'[[element]]\nname = "{a}"\nbranch = "tool"\nkind = "linear"\ndirection = "+{a}"\n'
        for a in "XYZ"
    )
    + '[[element]]\nname = "table"\nbranch = "workpiece"\nkind = "fixed"\n'
)
TRAVEL = {"X": 400.0, "Y": 300.0, "Z": 200.0}
TOOL = np.array([12.0, -7.0, -80.0])
FEWER = 0.04
"""8 places of each axis in place of 16: the variance of a straight line is 1.6 % too small, not 0.4 %."""
ROUNDING_UM = 2e-3
"""Products of errors (20 um times 40 urad) and a slope of the errors between nodes, far below 2 nm."""


def motions(axis, q):
    """Six error motions of an axis in um and urad, no two alike; q in mm."""
    k = "XYZ".index(axis)
    d = np.stack(
        [
            (3 + k) * np.sin(q / (60 + 9 * k)) + 0.011 * (k + 1) * q,
            (2 - k) * np.cos(q / (71 - 4 * k)) + 0.004 * q,
            1.5 * np.sin(q / 45 + k) - 0.007 * q,
        ],
        axis=-1,
    )
    turns = np.stack(
        [
            4 * np.sin(q / (90 + k)),
            (7 - 2 * k) * np.cos(q / 80),
            -5 * np.sin(q / (65 + 3 * k) + 0.4),
        ],
        axis=-1,
    )
    return d, turns  # fmt: skip


def error_um(x, y, z):
    """Tool-point error in um for positions in mm that broadcast."""
    x, y, z = np.broadcast_arrays(x, y, z)
    levers = {
        "X": np.stack([0 * x, y, z], -1) + TOOL, "Y": np.stack([0 * x, 0 * y, z], -1) + TOOL,
        "Z": np.zeros((*x.shape, 3)) + TOOL,
    }  # fmt: skip
    total = np.zeros((*x.shape, 3))
    for axis, q in zip("XYZ", (x, y, z), strict=True):
        d, turns = motions(axis, q)
        total += d + np.cross(turns, levers[axis]) * 1e-3  # urad mm are nm
    return total


@pytest.fixture
def stack(tmp_path, monkeypatch):
    """A folder with the machine and the errors of its axes, every 2 mm."""
    monkeypatch.chdir(tmp_path)
    (tmp_path / "stack.toml").write_text(MACHINE)
    for axis, travel in TRAVEL.items():
        q = np.arange(0.0, travel + 1, 2.0)
        names = [f"E{d}{axis}_{'um' if d in 'XYZ' else 'urad'}" for d in "XYZABC"]
        rows = [",".join([f"{axis.lower()}_mm", *names])]
        rows += [
            ",".join(f"{v:.12g}" for v in row) for row in np.column_stack([q, *motions(axis, q)])
        ]
        (tmp_path / f"{axis.lower()}.csv").write_text("\n".join(rows) + "\n")
    return tmp_path


CALL = ("machine-tables", "stack.toml", "x.csv", "y.csv", "z.csv", "--tool", "12 mm,-7 mm,-80 mm")


def rms(v):
    return float(np.sqrt((v**2).sum(axis=-1).mean()))


def columns(path):
    return np.loadtxt(path, delimiter=",", skiprows=1, unpack=True)


def test_tables_of_one_axis_shrink_the_error_of_the_tool_point(metrosep, stack):
    at = (40.0, 30.0)
    code, printed, err = metrosep(
        *CALL,
        "--over",
        "X",
        "--at",
        "Y=40 mm",
        "--at",
        "Z=30 mm",
        "--spacing",
        "2 mm",
        "-o",
        "out",
        "--json",
    )

    assert code == 0, err
    assert sorted(p.name for p in (stack / "out").iterdir()) == sorted(
        f"x-{a}.csv{s}" for a in "xyz" for s in ("", ".json")
    )
    x = np.linspace(0.0, 400.0, 641)
    c = [np.interp(x, *columns(stack / "out" / f"x-{a}.csv")[:2]) for a in "xyz"]
    zero = error_um(0.0, *at)
    before = error_um(x, *at) - zero
    after = (
        error_um(x + c[0] * 1e-3, at[0] + c[1] * 1e-3, at[1] + c[2] * 1e-3)
        + np.stack(c, -1)
        - zero
    )
    wrong = error_um(x, *at) - np.stack(c, -1) - zero
    assert np.abs(after).max() < 5 * ROUNDING_UM  # 2 mm chords of waves of 45 mm: 1.7 nm
    assert rms(wrong) > 1.9 * rms(before)
    found = json.loads(printed)
    assert found["before_rms_m"] / UM == pytest.approx(
        rms(before), rel=2e-2, abs=0.0
    )  # other places
    assert found["after_rms_m"] / UM < 5 * ROUNDING_UM
    for axis in "xyz":
        sidecar = json.loads((stack / "out" / f"x-{axis}.csv.json").read_text())
        assert sidecar["together"]["after_rms_m"] == found["after_rms_m"]
        assert sidecar["table"]["axis"] == "X"
        assert sidecar["table"]["compensates"] == axis.upper()


def test_a_controller_with_columns_gets_one_file_for_the_looked_up_axis(metrosep, stack):
    place = ("--over", "X", "--at", "Y=40 mm", "--at", "Z=30 mm", "--spacing", "4 mm")
    code, _, err = metrosep(
        *CALL, *place, "--format", "heidenhain", "--machine", "resolution=10 nm",
        "--sign-confirmed", "-o", "out",
    )  # fmt: skip
    assert code == 0, err
    assert sorted(p.name for p in (stack / "out").iterdir()) == ["x.com", "x.com.json"]
    lines = (stack / "out" / "x.com").read_text().splitlines()
    assert lines[1].split() == ["NR", "AXISPOS", "BACKLASH", "X", "Y", "Z"]
    rows = np.array([[float(v) for v in line.split()[1:]] for line in lines[2:-1]])
    wanted = error_um(rows[:, 0], 40.0, 30.0) - error_um(0.0, 40.0, 30.0)
    # entries are errors in mm of 10 nm; that of X itself is looked up where X then stands
    assert np.abs(rows[:, 1:] * 1e3 - wanted).max() < 0.005 + 5 * ROUNDING_UM
    assert "switches off a table" not in err


def test_maps_of_two_axes_shrink_the_error_of_the_tool_point(metrosep, stack):
    code, _, err = metrosep(
        *CALL, "--over", "X,Y", "--at", "Z=30 mm", "--spacing", "X=20 mm,Y=10 mm", "-o", "out",
        "--corrects", "Z,X",
    )  # fmt: skip

    assert code == 0, err
    assert sorted(p.name for p in (stack / "out").glob("*.csv")) == ["x-y-x.csv", "x-y-z.csv"]
    x, y, cz = columns(stack / "out" / "x-y-z.csv")
    cx = columns(stack / "out" / "x-y-x.csv")[2]
    assert np.unique(x).size == 21
    assert np.unique(y).size == 31
    left = error_um(x + cx * 1e-3, y, 30.0 + cz * 1e-3) - error_um(0.0, 0.0, 30.0)
    assert np.abs(left[:, 0] + cx).max() < ROUNDING_UM
    assert np.abs(left[:, 2] + cz).max() < ROUNDING_UM
    assert np.abs(left[:, 1]).max() > 1.0  # Y is not corrected, and it is said
    assert "workpiece Y" in err


OTHER_PLACES = 0.04
"""The RMS over 2000 places differs from that over 2000 others by this share, three sigma."""


def places(seed, n=2000):
    """Return random places of the travel in mm: no node, and not those of the program."""
    rng = np.random.default_rng(seed)
    return [rng.uniform(0.0, t, n) for t in TRAVEL.values()]


def trilinear(file, at):
    """Return what the rows of a grid add at places, um: eight corners, weighted by hand."""
    x, y, z, *c = columns(file)
    nodes = [np.unique(v) for v in (x, y, z)]
    cells = [
        np.clip(np.searchsorted(n, v) - 1, 0, n.size - 2) for n, v in zip(nodes, at, strict=True)
    ]
    parts = [(v - n[i]) / (n[i + 1] - n[i]) for n, v, i in zip(nodes, at, cells, strict=True)]
    rows = {p: i for i, p in enumerate(zip(x, y, z, strict=True))}
    total = np.zeros((at[0].size, 3))
    for corner in np.ndindex(2, 2, 2):
        weight = np.prod([f if k else 1.0 - f for k, f in zip(corner, parts, strict=True)], axis=0)
        keys = zip(*(n[i + k] for n, i, k in zip(nodes, cells, corner, strict=True)), strict=True)
        index = [rows[key] for key in keys]
        total += weight[:, None] * np.stack([v[index] for v in c], -1)
    return total


def test_a_volume_keeps_its_tolerance_at_places_that_are_no_nodes(metrosep, stack):
    call = ("volume", *CALL[1:], "--tolerance", "100 nm", "-o", "out", "--json")
    code, printed, err = metrosep(*call)
    assert code == 0, err
    found = json.loads(printed)
    at = places(7)
    c = trilinear(stack / "out" / "x-y-z-grid.csv", at)
    zero = error_um(0.0, 0.0, 0.0)
    moved = [q + v * 1e-3 for q, v in zip(at, c.T, strict=True)]
    left = error_um(*moved) + c - zero
    before = error_um(*at) - zero
    assert np.abs(left).max() < 0.1 + ROUNDING_UM
    assert np.abs(left).max() > 0.01  # the coarsest grid, not any
    assert rms(before) > 10.0 * rms(left)
    judged = found["verification"]
    assert judged["before_rms_m"] / UM == pytest.approx(rms(before), rel=OTHER_PLACES, abs=0.0)
    assert judged["after_rms_m"] / UM == pytest.approx(rms(left), rel=OTHER_PLACES, abs=0.0)
    assert judged["wrong_sign_rms_m"] == pytest.approx(
        2 * judged["before_rms_m"], rel=0.01, abs=0.0
    )
    # 50 mm beside the tool in X: the angle errors of X, Y, Z at the place turn it
    turns = sum(motions(a, q)[1] - motions(a, 0.0)[1] for a, q in zip("XYZ", at, strict=True))
    own = np.cross(turns, np.array([50.0, 0.0, 0.0])) * 1e-3
    other = judged["other_tools"][0]
    assert other["after_rms_m"] / UM == pytest.approx(rms(own + left), rel=OTHER_PLACES, abs=0.0)
    assert "for each mm" in err
    assert found["nodes"]["X"] > 5


def test_errors_that_shift_the_tool_alike_everywhere_are_no_errors_that_do_not_move_it(
    metrosep, stack
):
    """Over X, Y, Z the lines of A and C are one shift; an error ECZ without an arm moves nothing."""
    spans = [
        w for s in ("X=-90 mm..90 mm", "Y=-90 mm..90 mm", "Z=0 mm..90 mm") for w in ("--span", s)
    ]
    (stack / "lines.toml").write_text('Y0A = "9.3 um"\nX0C = "5.8 um"\n')
    (stack / "turn.toml").write_text('ECZ = "5 urad"\n')
    still = ("--at", "A=0 deg", "--at", "C=0 deg", "--pivot-height", "80 mm")
    call = ("--tolerance", "0.2 um", *spans, "-o", "out")
    code, _, err = metrosep("volume", "five_axis", "lines.toml", *call, *still)
    assert code == 2
    # the table carries the work: a line that stands at +5.8 um takes the work there, the tool misses it by -5.8 um
    assert "the same everywhere (in the workpiece X -5.8 um, Y -9.3 um)" in err
    code, _, err = metrosep("volume", "mill_xyz", "turn.toml", *call)
    assert code == 2
    assert "do not move the tool point" in err
    assert "--tool" in err
    code, _, err = metrosep("volume", "mill_xyz", "turn.toml", *call, "--tool", "0 mm,50 mm,0 mm")
    # 5 urad about Z on an arm of 50 mm in Y: -0.25 um in X
    assert "in the workpiece X -250 nm)" in err
    assert not (stack / "out").exists()


def test_a_volume_without_a_folder_writes_nothing_and_says_what_stays(metrosep, stack):
    before = sorted(stack.iterdir())
    code, printed, err = metrosep("volume", *CALL[1:], "--tolerance", "1 um")
    assert code == 0, err
    assert "nodes: X" in printed
    assert "off the nodes" in err
    assert sorted(stack.iterdir()) == before


def test_a_wave_as_long_as_a_step_is_seen(metrosep, stack):
    """10 mm over 320 mm are 32 whole waves: zero at every node of 33, 17, 9 ..."""
    x = np.arange(0.0, 320.1, 1.25)
    rows = [f"{a:.4f},{5.0 * np.sin(2 * np.pi * a / 10.0):.6f}" for a in x]
    (stack / "wave.csv").write_text("x_mm,EXX_um\n" + "\n".join(rows) + "\n")
    spans = ("--span", "Y=0 mm..100 mm", "--span", "Z=0 mm..100 mm")
    call = ("volume", "stack.toml", "wave.csv", *spans, "-o", "out", "--json")
    code, _, err = metrosep(*call, "--tolerance", "0.2 um")
    assert code != 0
    assert "more than 129 nodes" in err
    assert not (stack / "out").exists()
    code, _, err = metrosep(*call, "--tolerance", "20 um")  # two nodes correct nothing of it
    assert code == 1
    assert "do not shrink the error" in err


def nest_file(stack, sense):
    """Write what a nest of three probes reads on the machine with the grid active; sense -1: its mirror."""
    at = places(11, 60)
    c = trilinear(stack / "out" / "x-y-z-grid.csv", at)
    moved = [q + v * 1e-3 for q, v in zip(at, c.T, strict=True)]
    noise = 0.005 * np.random.default_rng(2).normal(size=c.shape)
    read = sense * error_um(*moved) + c + noise + [3.0, -2.0, 7.0]  # its zero is not known
    rows = [
        '# instrument = "nest"', '# tool = "12 mm, -7 mm, -80 mm"', '# unknown = ["nest"]',
        '# name = "ball on the table"', "X_mm,Y_mm,Z_mm,reading_x_um,reading_y_um,reading_z_um",
    ]  # fmt: skip
    rows += [",".join(f"{v:.6f}" for v in row) for row in np.column_stack([*at, read])]
    (stack / "nest.csv").write_text("\n".join(rows) + "\n")
    return read


def test_readings_with_the_grid_active_prove_its_signs_or_refuse_it(metrosep, stack):
    call = ("volume", *CALL[1:], "--tolerance", "100 nm")
    assert metrosep(*call, "-o", "out")[0] == 0
    read = nest_file(stack, 1)
    code, printed, err = metrosep(*call, "--verify", "nest.csv", "--json")
    assert code == 0, err
    judged = json.loads(printed)["verification"]
    left = (read - read.mean(axis=0)).std(axis=0)
    assert judged["against"] == "readings of ball on the table"
    assert judged["readings"]["rms_m"] / UM == pytest.approx(np.sqrt((left**2).mean()), abs=1e-6)
    assert judged["readings"]["predicted_rms_m"] < judged["readings"]["rms_m"]
    assert judged["readings"]["without_rms_m"] > 50 * judged["readings"]["rms_m"]
    nest_file(stack, -1)  # a machine whose errors have the other sign
    code, _, err = metrosep(*call, "--verify", "nest.csv")
    assert code == 1
    assert "they do not correct this machine" in err


@pytest.mark.parametrize(
    ("call", "message"),
    [
        (("--tolerance", "1"), "unit"),
        (("--tolerance", "-1 um"), "positive"),
        (("--tolerance", "1 pm"), "more than 129"),
        (("--tolerance", "1 um", "--over", "X,Y"), "three linear axes"),
        (("--tolerance", "1 um", "--span", "X=0 mm..0 mm"), "travel must rise"),
    ],
)
def test_wrong_volumes_are_refused_in_one_sentence(metrosep, stack, call, message):
    code, _, err = metrosep("volume", *CALL[1:], *call)
    assert code in (2, 4), err
    assert message in err
    assert "Traceback" not in err


def test_three_axes_become_tables_to_be_added_up(metrosep, stack):
    code, printed, err = metrosep(
        *CALL, "--over", "X,Y,Z", "--spacing", "20 mm", "-o", "out", "--json"
    )

    assert code == 0, err
    files = sorted(p.stem for p in (stack / "out").glob("*.csv"))
    assert files == sorted(f"{a}-{b}" for a in "xyz" for b in "xyz")
    x, y, z = places(1)
    c = [
        sum(
            np.interp(q, *columns(stack / "out" / f"{a}-{b}.csv")[:2])
            for a, q in zip("xyz", (x, y, z), strict=True)
        )
        for b in "xyz"
    ]
    zero = error_um(0.0, 0.0, 0.0)
    before = error_um(x, y, z) - zero
    after = (
        error_um(*(q + v * 1e-3 for q, v in zip((x, y, z), c, strict=True)))
        + np.stack(c, -1)
        - zero
    )
    found = json.loads(printed)
    assert found["before_rms_m"] / UM == pytest.approx(rms(before), rel=OTHER_PLACES, abs=0.0)
    assert found["after_rms_m"] / UM == pytest.approx(rms(after), rel=OTHER_PLACES, abs=0.0)
    assert rms(after) < 0.9 * rms(before)  # what the levers of two axes at once make is left
    judged = found["verification"]
    # at the reference the lever is that of the tool alone: X turns over (y, z), Y over z, Z over nothing;
    # what an axis turns there already is in the tables of the others
    turns = {
        a: (motions(a, q)[1] - motions(a, 0.0)[1]) * 1e-3
        for a, q in zip("XY", (x, y), strict=True)
    }
    of_two = {
        f"E{d}{a}": rms(np.cross(t * (np.arange(3) == k), lever))
        for a, t, lever in (
            ("X", turns["X"], np.stack([0 * x, y, z], -1)),
            ("Y", turns["Y"], np.stack([0 * x, 0 * x, z], -1)),
        )
        for k, d in enumerate("ABC")
    }
    said = judged["by_term"]
    assert said.keys() == {n for n, v in of_two.items() if v > 0.0}
    for name, value in said.items():
        assert value / UM == pytest.approx(of_two[name], rel=OTHER_PLACES, abs=0.0)
    # additive functions by least squares with a column for each place of each axis
    grid = [(np.arange(8) + 0.5) * TRAVEL[a] / 8 for a in "XYZ"]
    x, y, z = (v.ravel() for v in np.meshgrid(*grid, indexing="ij"))
    columns_of = [(v[:, None] == g).astype(float) for v, g in zip((x, y, z), grid, strict=True)]
    A, E = np.hstack(columns_of), error_um(x, y, z)
    least = rms(E - A @ np.linalg.lstsq(A, E, rcond=None)[0])
    assert 1e-3 * UM < judged["grid_rms_m"] < 0.2 * judged["least_rms_m"]
    assert judged["least_rms_m"] / UM == pytest.approx(least, rel=FEWER, abs=0.0)
    assert judged["least_rms_m"] < judged["after_rms_m"]
    first, size = max(said.items(), key=lambda item: item[1])
    assert f"(RMS of each: {first} {size / UM:.3g} um" in err
    assert "A grid over X, Y, Z on the same nodes leaves" in err


def test_three_axes_become_a_neutral_grid(metrosep, stack):
    call = (*CALL, "--over", "X,Y,Z", "--spacing", "50 mm", "--format", "grid", "-o", "out")
    code, _, err = metrosep(*call)

    assert code == 0, err
    file = stack / "out" / "x-y-z-grid.csv"
    assert file.read_text().splitlines()[0] == "x_mm,y_mm,z_mm,cx_um,cy_um,cz_um"
    x, y, z, *c = columns(file)
    assert x.size == 9 * 7 * 5
    moved = [q + v * 1e-3 for q, v in zip((x, y, z), c, strict=True)]
    left = error_um(*moved) + np.stack(c, -1) - error_um(0.0, 0.0, 0.0)
    assert np.abs(left).max() < ROUNDING_UM
    assert rms(error_um(x, y, z) - error_um(0.0, 0.0, 0.0)) > 1.0

    held = {p: p.read_bytes() for p in (stack / "out").iterdir()}
    assert metrosep(*call)[0] == 0  # the same bytes
    coarse = tuple("100 mm" if w == "50 mm" else w for w in call)
    code, _, err = metrosep(*coarse)
    assert code == 2
    assert "--force" in err
    assert {p: p.read_bytes() for p in (stack / "out").iterdir()} == held
    assert metrosep(*coarse, "--force")[0] == 0
    assert (stack / "out" / "x-y-z-grid.csv.1").read_bytes() == held[file]


def test_constants_and_results_are_read_from_toml(metrosep, stack):
    """The squareness of Y to X of 25 urad moves the tool by -x of it: y 300 mm are 7.5 um."""
    (stack / "more.toml").write_text('EXX = "3 um"\nEYX = "run/result.json"\n')
    rng = np.random.default_rng(1)
    rows = ["x_mm,y_um,run"]
    for run in range(4):
        x = np.linspace(0.0, 400.0, 201)
        y = 2.0 * np.sin(x / 40.0) + rng.normal(0, 0.01, x.size)
        rows += [f"{a:.4f},{b:.6f},{run}" for a, b in zip(x, y, strict=True)]
    (stack / "runs.csv").write_text("\n".join(rows) + "\n")
    call = (
        "separate",
        "runs.csv",
        "--x",
        "x_mm",
        "--z",
        "y_um",
        "--run",
        "run",
        "--method",
        "mean",
    )
    assert metrosep(*call, "-o", "run")[0] == 0

    code, _, err = metrosep(
        "machine-tables", "stack.toml", "more.toml", "--over", "X", "--spacing", "5 mm", "-o", "out",
        "--at", "Y=0 mm", "--at", "Z=0 mm",
    )  # fmt: skip

    assert code == 0, err
    assert [p.name for p in (stack / "out").glob("*.csv")] == ["x-y.csv"]  # a constant is no table
    x, c = columns(stack / "out" / "x-y.csv")[:2]
    wave = 2.0 * np.sin(x / 40.0)
    line = np.polyval(np.polyfit(x, wave, 1), x)
    wanted = -(wave - line) + (wave - line)[0]
    assert np.abs(c - wanted).max() < 0.05  # mean of 4 runs of 10 nm, at the reference and here


@pytest.mark.parametrize(
    ("words", "code", "said"),
    [
        (("--over", "X,Y,Z", "--spacing", "20 mm", "--format", "csv-map"), 2, "--format grid"),
        (("--over", "X,Y,Z", "--spacing", "20 mm", "--format", "aerotech"), 2, "adds them up"),
        (("--over", "X,Y", "--spacing", "20 mm", "--format", "csv", "--at", "Z=0 mm"), 2, "a map over two axes"),
        (("--over", "X", "--spacing", "20 mm", "--format", "grid"), 2, "three axes"),
        (("--over", "Q", "--spacing", "20 mm"), 2, "'Q'"),
        (("--over", "X", "--spacing", "20"), 2, "no unit"),
        (("--over", "X", "--spacing", "20 mm", "--at", "Z=0 mm"), 2, "--at"),
        (("--over", "X", "--spacing", "20 mm", "--at", "Y=0 mm", "--at", "Z=-30 mm"), 2, "outside"),
        (("--over", "X", "--spacing", "20 mm", "--at", "Z=3 deg"), 2, "--at Z"),
        (("--over", "X", "--spacing", "20 mm", "--machine", "x-w.count=1 nm", "--at", "Y=0 mm", "--at", "Z=0 mm"), 2, "x-w"),
        (("--over", "X", "--spacing", "20 mm", "--at", "Y=0 mm", "--at", "Z=0 mm", "--span", "X=0 mm..900 mm"), 2, "outside"),
        (("--over", "X", "--spacing", "200 mm", "--at", "Y=0 mm", "--at", "Z=0 mm"), 1, "x-"),
    ],
)  # fmt: skip
def test_refusals_leave_nothing(metrosep, stack, words, code, said):
    before = sorted(p.name for p in stack.iterdir())

    found, _, err = metrosep(*CALL, *words, "-o", "out")

    assert found == code, err
    assert said in err
    assert [line[:7] for line in err.splitlines()].count("error: ") == 1
    assert sorted(p.name for p in stack.iterdir()) == before


def test_files_that_together_make_the_volume_worse_are_refused(metrosep, stack):
    """A turn b of X moves the tool by b (z + 10 mm): a table made at z = 0 is of no use at -200 mm.

    Over z = -200 ... 0 mm the mean of (z + 10)^2 is 11433 mm^2; b z, which the table leaves, has 13333; made at
    z = -100 mm it leaves b (z + 100 mm), 3333.
    """
    rows = [f"{x},{20 * np.sin(x / 50):.9g}" for x in range(0, 401, 5)]
    (stack / "b.csv").write_text("\n".join(["x_mm,EBX_urad", *rows]) + "\n")
    before = sorted(p.name for p in stack.iterdir())
    call = (
        "machine-tables", "stack.toml", "b.csv", "--over", "X,Y,Z", "--tool", "0 mm,0 mm,10 mm",
        "--span", "Y=0 mm..20 mm", "--span", "Z=-200 mm..0 mm", "--spacing", "10 mm", "-o", "out",
    )  # fmt: skip

    code, _, err = metrosep(*call)

    assert code == 1
    assert "together do not shrink the error of the tool point" in err
    assert sorted(p.name for p in stack.iterdir()) == before
    other = ("table", *call[2:], "--reference", "0 mm,0 mm,-100 mm", "--from-machine", call[1])
    assert metrosep(*other)[0] == 0  # b (z + 100 mm) is left


# ---- lists of positions, corrected by the machine ---------------------------------------------------


def pose_list(stack, n=200, seed=3):
    """Write a list of positions as a post-processor does: comments, a feed, numbers with few digits."""
    at = [np.round(v, 3) for v in places(seed, n)]
    rows = ["# part 17, roughing", "X_mm;Y_mm;Z_mm;F;note"]
    rows += [
        f"{x:.3f}; {y:.3f};{z:.3f};500;{'in' if i % 2 else 'cut'}"
        for i, (x, y, z) in enumerate(zip(*at, strict=True))
    ]
    (stack / "part.csv").write_text("\n".join(rows) + "\n")
    return at, rows


def path_call(*more):
    return ("path", "part.csv", "--machine", "stack.toml", "--tool", "12 mm,-7 mm,-80 mm",
            *(w for f in ("x.csv", "y.csv", "z.csv") for w in ("--error", f)), "-o", "right.csv", *more)  # fmt: skip


def test_a_list_of_positions_goes_where_it_should_on_the_machine_with_errors(metrosep, stack):
    at, given = pose_list(stack)
    code, printed, err = metrosep(*path_call("--json"))
    assert code == 0, err
    lines = (stack / "right.csv").read_text().splitlines()
    assert [v for v in lines if v.startswith("# METROSEP CORRECTED")]
    rows = [v.split(";") for v in lines if v[0] not in "#X"]
    assert [r[3:] for r in rows] == [v.split(";")[3:] for v in given[2:]]  # the rest as it was
    q = np.array([[float(v) for v in r[:3]] for r in rows]).T
    wanted = np.stack(at, -1)
    left = (q.T - wanted) * 1e3 + error_um(*q)
    before = error_um(*at)
    assert rms(before) > 5.0
    assert np.abs(left).max() < ROUNDING_UM + 0.5e-3  # half of the last digit, 1 nm
    found = json.loads(printed)
    assert found["before_rms_m"] / UM == pytest.approx(rms(before), abs=ROUNDING_UM)
    assert found["after_rms_m"] < ROUNDING_UM * UM

    # a second time on its own result: refused, and nothing is touched
    code, _, err = metrosep(
        *(w if w != "part.csv" else "right.csv" for w in path_call()[:-1]), "c.csv"
    )
    assert code in (2, 4)
    assert "holds a correction already" in err
    assert not (stack / "c.csv").exists()


def test_the_zero_of_the_list_is_a_place_of_the_machine(metrosep, stack):
    pose_list(stack)
    code, _, err = metrosep(*path_call("--zero", "X=-40 mm", "--zero", "Z=0.01 m"))
    # the list runs from 0 to 400 mm in X, which is -40 to 360 in the machine: the errors begin at 0
    assert code != 0
    assert "EXX over X" in err
    assert "outside the error table" in err
    rows = ["X_mm,Y_mm,Z_mm", "150,100,50"]
    (stack / "part.csv").write_text("\n".join(rows) + "\n")
    code, _, err = metrosep(*path_call("--zero", "X=-40 mm", "--zero", "Z=0.01 m"))
    assert code == 0, err
    q = [float(v) for v in (stack / "right.csv").read_text().splitlines()[1].split(",")]
    e = error_um(110.0, 100.0, 60.0)
    assert (np.array(q) - [150.0, 100.0, 50.0]) * 1e3 == pytest.approx(-e, abs=0.05)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("X_mm,Y_mm\n1,2\n", "no column of Z"),
        ("X_mm,Y_mm,Z\n1,2,3\n", "the unit of column Z"),
        ("X_mm,Y_mm,Z_deg\n1,2,3\n", "the unit of column Z"),
        ("X_mm,Y_mm,Z_mm,Z_mm\n1,2,3,4\n", "has Z twice"),
        ("1,2,3\n", "has no header"),
        ("X_mm,Y_mm,Z_mm\n1,2,nan\n", "line 2"),
        ("X_mm,Y_mm,Z_mm\n1,2\n", "line 2"),
        ("X_mm,Y_mm,Z_mm\n", "no point"),
    ],
)
def test_a_list_that_cannot_be_corrected_is_refused(metrosep, stack, text, message):
    (stack / "part.csv").write_text(text)
    code, _, err = metrosep(*path_call())
    assert code in (2, 4)
    assert message in err
    assert not (stack / "right.csv").exists()


def test_a_correction_that_no_axis_of_rotation_needs_is_refused(metrosep, stack):
    (stack / "a.toml").write_text('EAA = "0.009 rad"\nECC = "0.009 rad"\n')
    (stack / "part.csv").write_text("X_mm,Y_mm,Z_mm,A_deg,C_deg\n100,50,30,-30,90\n")
    (stack / "b.toml").write_text('EAA = "40 urad"\nECC = "0.009 rad"\nB0C = "0.009 rad"\n')
    common = ("path", "part.csv", "--machine", "five_axis", "--pivot-height", "80 mm")
    code, _, err = metrosep(*common, "--error", "b.toml", "-o", "no.csv", "--stroke", "20 mm")
    assert code == 1
    assert "the correction of C is" in err
    assert not (stack / "no.csv").exists()


def test_five_axes_get_the_sign_of_each_error(metrosep, stack):
    """The errors of this preset are those that an instrument at the tool reads against the part.

    It reads 8 um above the part at C = 90 deg: the tool must go down by it. A turns 40 urad too far:
    its command is 40 urad less.
    """
    (stack / "c.csv").write_text("c_deg,EZC_um\n-10,0\n0,0\n90,8\n180,2\n370,2\n")
    (stack / "a.toml").write_text('EAA = "40 urad"\n')
    (stack / "part.csv").write_text("X_mm,Y_mm,Z_mm,A_deg,C_deg\n100,50,30,0,90\n")
    common = ("path", "part.csv", "--machine", "five_axis", "--pivot-height", "80 mm")
    code, _, err = metrosep(*common, "--error", "c.csv", "-o", "one.csv")
    assert code == 0, err
    row = [float(v) for v in (stack / "one.csv").read_text().splitlines()[1].split(",")]
    assert row == pytest.approx([100.0, 50.0, 29.992, 0.0, 90.0], abs=1e-6)
    (stack / "part.csv").write_text("X_mm,Y_mm,Z_mm,A_deg,C_deg\n100,50,30,-30,90\n")
    code, _, err = metrosep(*common, "--error", "a.toml", "-o", "two.csv")
    assert code == 0, err
    row = [float(v) for v in (stack / "two.csv").read_text().splitlines()[1].split(",")]
    assert row[:3] == pytest.approx([100.0, 50.0, 30.0], abs=1e-6)
    assert np.radians(row[3] + 30.0) * 1e6 == pytest.approx(-40.0, abs=1e-2)


def test_a_program_with_rotary_words_is_corrected_and_split(metrosep, stack):
    """X runs 10 um too far at X = 100 mm; 10 um before, by the slope of 1e-4, 1 nm less."""
    (stack / "x.csv").write_text("x_mm,EXX_um\n0,0\n100,10\n200,0\n")
    (stack / "part.nc").write_text("G21 G90\nG0 X0 Y50. Z30. A-30. C90.\nG1 X200. F500\n")
    common = ("path", "part.nc", "--machine", "five_axis", "--pivot-height", "80 mm")
    code, out, err = metrosep(
        *common, "--error", "x.csv", "--tolerance", "10 nm", "-o", "one.nc", "--json"
    )
    assert code == 0, err
    assert json.loads(out)["n_added"] == 1
    assert (stack / "one.nc").read_text().splitlines()[-2:] == ["G1 X99.990001 F500", "X200."]
    code, _, err = metrosep(*common, "--error", "x.csv", "-o", "two.nc", "--column-unit", "X=mm")
    assert code == 2
    assert "--column-unit does not go with part.nc, which is a program" in err
    (stack / "part.csv").write_text("X_mm,Y_mm,Z_mm,A_deg,C_deg\n100,50,30,-30,90\n")
    common = ("path", "part.csv", "--machine", "five_axis", "--pivot-height", "80 mm")
    code, _, err = metrosep(*common, "--error", "x.csv", "--tolerance", "10 nm", "-o", "c.csv")
    assert code == 2
    assert "--tolerance does not go with part.csv, which is a list of positions" in err


def test_the_folder_of_a_calibration_stands_for_its_own_terms_alone(metrosep, stack):
    """`calibrate` writes residuals beside its terms, and an older run may have left terms of other axes."""
    x = np.linspace(0.0, 400.0, 41)
    wanted = 6.0 * np.sin(x / 90.0)
    rows = ['# instrument = "displacement"', "# direction = [1, 0, 0]", '# unknown = ["offset"]',
            "X_mm,Y_mm,Z_mm,reading_um"]  # fmt: skip
    rows += [f"{a:.4f},0,0,{e:.6f}" for a, e in zip(x, wanted, strict=True)]
    (stack / "laser.csv").write_text("\n".join(rows) + "\n")
    code, _, err = metrosep(
        "calibrate", "stack.toml", "laser.csv", "--terms", "EXX", "--degree", "X=9", "-o", "cal"
    )
    assert code == 0, err
    assert (stack / "cal" / "parts-residuals.csv").exists()
    (stack / "cal" / "Y.csv").write_text("y_mm,EYY_um\n0,0\n300,500\n")  # of a former calibration
    (stack / "part.csv").write_text("X_mm,Y_mm,Z_mm\n150,100,50\n")
    code, _, err = metrosep(
        "path", "part.csv", "--machine", "stack.toml", "--error", "cal", "-o", "right.csv"
    )
    assert code == 0, err
    q = [float(v) for v in (stack / "right.csv").read_text().splitlines()[1].split(",")]
    e = 6.0 * np.sin(150.0 / 90.0)  # zero at home
    assert (q[0] - 150.0) * 1e3 == pytest.approx(-e, abs=0.02)
    assert q[1:] == [100.0, 50.0]
    (stack / "cal" / "X.csv").unlink()
    code, _, err = metrosep(
        "path", "part.csv", "--machine", "stack.toml", "--error", "cal", "-o", "again.csv"
    )
    assert code in (2, 4)
    assert "X.csv: the calibration names it" in err


@pytest.mark.parametrize("tilt", ["0 deg", "30 deg"])
def test_an_axis_that_only_rounding_and_the_other_corrections_move_gets_no_file(
    metrosep, tmp_path, monkeypatch, tilt
):
    """ECY and the correction of X make a second-order error of Y of some pm: nothing that a table is for."""
    monkeypatch.chdir(tmp_path)
    y = np.arange(-200.0, 201.0, 20.0)
    rows = [f"{v:g},{3 * np.sin(v / 50):.4f},{5 * np.sin(v / 70):.4f}" for v in y]
    (tmp_path / "y.csv").write_text("\n".join(["y_mm,EXY_um,ECY_urad", *rows, ""]))
    at = [w for a in ("X=0 mm", "Z=0 mm", f"A={tilt}", "C=40 deg") for w in ("--at", a)]

    code, printed, err = metrosep(
        "machine-tables", "five_axis", "y.csv", "--pivot-height", "80 mm", "--over", "Y", *at,
        "--spacing", "20 mm", "-o", "out", "--json",
    )  # fmt: skip

    assert code == 0, err
    assert sorted(p.name for p in (tmp_path / "out").iterdir()) == ["y-x.csv", "y-x.csv.json"]
    assert "Y over Y needs no correction and gets no file" in err
    assert json.loads(printed)["after_rms_m"] < 1e-3 * json.loads(printed)["before_rms_m"]
    place, correction = columns(tmp_path / "out" / "y-x.csv")[:2]
    # ECY turns the tool about the reference of Y, so X is what EXY says; the correction is its negative
    assert np.abs(correction + 3 * np.sin(place / 50)).max() < 2e-3


def straightness_of_y(tmp_path, name, of_y):
    y = np.arange(-200.0, 200.5, 1.0)
    rows = [f"{v:g},{5 * np.sin(v / 50):.6f},{of_y(v):.6f}" for v in y]
    (tmp_path / name).write_text("\n".join(["y_mm,EXY_um,EYY_um", *rows, ""]))


TABLES_OVER_Y = (
    "--over", "Y", "--at", "X=0 mm", "--at", "Z=0 mm", "--at", "A=0 deg", "--at", "C=0 deg",
    "--pivot-height", "80 mm", "--spacing", "20 mm", "-o", "out",
)  # fmt: skip


def test_the_table_of_an_earlier_call_is_not_left_where_no_correction_is_needed(
    metrosep, tmp_path, monkeypatch
):
    monkeypatch.chdir(tmp_path)
    straightness_of_y(tmp_path, "before.csv", lambda v: 4 * np.sin(v / 60))
    straightness_of_y(tmp_path, "after.csv", lambda v: 0.0)
    code, _, err = metrosep("machine-tables", "five_axis", "before.csv", *TABLES_OVER_Y)
    assert code == 0, err
    old = (tmp_path / "out" / "y-y.csv").read_bytes()

    code, _, err = metrosep("machine-tables", "five_axis", "after.csv", *TABLES_OVER_Y, "--force")

    assert code == 2
    assert "y-y.csv: is a table of an earlier call" in err
    assert (tmp_path / "out" / "y-y.csv").read_bytes() == old


def test_a_wave_as_long_as_the_spacing_is_not_called_nothing(metrosep, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    straightness_of_y(tmp_path, "wave.csv", lambda v: 5 * np.sin(2 * np.pi * v / 20))

    code, _, err = metrosep("machine-tables", "five_axis", "wave.csv", *TABLES_OVER_Y)

    assert code == 2
    assert "Y over Y: the error of 10 um P-V is nothing at every node" in err.replace("\n", " ")
    assert not (tmp_path / "out").exists()


# ---- several files for one control -------------------------------------------------------------------

CEC = (
    "--over", "X", "--spacing", "50 mm", "--at", "Y=0 mm", "--at", "Z=0 mm", "--format", "sinumerik-cec",
    "--machine", "input_axis=AX1", "--sign-confirmed", "-o", "out",
)  # fmt: skip
EACH = ("--machine", "x-x.output_axis=AX1", "--machine", "x-y.output_axis=AX2", "--machine", "x-z.output_axis=AX3")  # fmt: skip
APART = ("--machine", "x-y.table_index=1", "--machine", "x-z.table_index=2")


def test_what_each_file_of_a_control_needs_is_asked_for_by_its_name(metrosep, stack):
    code, _, err = metrosep(*CALL, *CEC)
    assert code == 2
    for name in "xyz":
        assert f"'--machine x-{name}.output_axis=...'" in err


@pytest.mark.parametrize(
    ("terms", "over", "asked"),
    [
        ("x_mm,EXX_um,EYX_um\n0,0,0\n200,1,2\n", "X", "xy"),
        ("x_mm,ECX_urad\n0,0\n200,4\n", "X", "x"),  # d = theta x r, r = (0, 5, 9) mm
        ("y_mm,EAY_urad\n0,0\n200,4\n", "Y", "yz"),
        ("y_mm,EBY_urad\n0,0\n200,4\n", "Y", "x"),
    ],
)
def test_an_axis_that_the_errors_cannot_move_is_not_asked_for(metrosep, stack, terms, over, asked):
    (stack / "e.csv").write_text(terms)
    other = "Y" if over == "X" else "X"
    words = ("--tool", "0 mm,5 mm,9 mm", "--over", over, "--spacing", "50 mm", "--at", f"{other}=0 mm", *CEC[6:])  # fmt: skip
    code, _, err = metrosep("machine-tables", "stack.toml", "e.csv", *words)
    assert code == 2
    for axis in "xyz":
        assert (f"{over.lower()}-{axis}.output_axis" in err) == (axis in asked)


def test_the_axes_that_are_asked_for_are_those_that_get_a_file(metrosep, stack):
    (stack / "two.csv").write_text("x_mm,EXX_um,EYX_um\n0,0,0\n200,1,0.5\n400,3,-1\n")
    code, _, err = metrosep(
        "machine-tables",
        "stack.toml",
        "two.csv",
        *CEC,
        *EACH[:4],
        "--machine",
        "x-y.table_index=1",
    )
    assert code == 0, err
    assert sorted(f.name for f in (stack / "out").glob("*.INI")) == ["x-x.INI", "x-y.INI"]


@pytest.mark.parametrize(
    ("facts", "said"),
    [
        (("--machine", "output_axis=AX1"), "--machine x-y.output_axis=..."),
        (
            EACH[:2],
            "'--machine x-y.output_axis=...' and '--machine x-z.output_axis=...'; output_axis: ",
        ),
        (EACH, "--machine x-y.table_index=..."),
        (
            (*EACH[:2], "--machine", "x-y.output_axis=ax1", *EACH[4:], *APART),
            "--machine x-y.output_axis=...",
        ),
        ((*EACH, "--machine", "x-y.table_index=00", *APART[2:]), "--machine x-y.table_index=..."),
        ((*EACH, *APART, "--machine", "x-y.table_index=3"), "x-y.table_index is given twice"),
    ],
)
def test_files_that_a_control_would_take_for_one_another_are_refused(metrosep, stack, facts, said):
    """All three correcting AX1, or each replacing table 0 as it is loaded: every file alone would be right; two with no axis named."""
    code, _, err = metrosep(*CALL, *CEC, *facts)
    assert code == 2
    assert said in err
    assert not (stack / "out").exists()


def test_files_that_a_control_can_hold_side_by_side_are_written(metrosep, stack):
    code, _, err = metrosep(*CALL, *CEC, *EACH, *APART)
    assert code == 0, err
    named = {}
    for name in "xyz":
        text = (stack / "out" / f"x-{name}.INI").read_text()
        named[name] = {
            line.partition("[")[2][0] for line in text.splitlines() if line.startswith("$AN_CEC[")
        }
        assert f"AX{'xyz'.index(name) + 1}" in text
    assert named == {"x": {"0"}, "y": {"1"}, "z": {"2"}}
    assert err.splitlines()[-1].startswith("next: metrosep calibrate stack.toml")


TRUNNION = ("table", "c.toml", "--from-machine", "five_axis", "--over", "A", "--spacing", "30 deg")
THERE = ("--span", "A=-90 deg..30 deg", "--at", "X=65 mm", "--at", "Y=-20 mm", "--at", "Z=130 mm", "--at", "C=0 deg")  # fmt: skip


@pytest.mark.parametrize(
    ("more", "said"),
    [
        (("--pivot-height", "80 mm"), (
            '--span "A=0 deg..360 deg"', '--at "X=0 mm"', '--at "Y=0 mm"', '--at "Z=0 mm"', '--at "C=0 deg"',
        )),
        (("--pivot-height", "80 mm", *THERE, "--format", "linuxcnc"), ("--format linuxcnc-lincurve",)),
        (("--pivot-height", "80 mm", *THERE, "--format", "sinumerik-cec", "--sign-confirmed", *(
            w for f in ("input_axis=AX4", "a-x.output_axis=AX1", "a-y.output_axis=AX2", "a-z.output_axis=AX3")
            for w in ("--machine", f)
        )), ('--machine "input_turns=True"',)),
    ],
)  # fmt: skip
def test_the_four_places_and_the_turning_axis_are_asked_for_in_words_of_the_command(
    metrosep, tmp_path, monkeypatch, more, said
):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "c.toml").write_text('Y0A = "7 um"\nB0C = "-20 urad"\n')
    code, _, err = metrosep(*TRUNNION, *more, "-o", "out")
    assert code == 2
    for text in said:
        assert text in err
    assert "controller=" not in err
    assert list(tmp_path.iterdir()) == [tmp_path / "c.toml"]


@pytest.mark.parametrize(
    ("over", "other", "same", "shown"),
    [("C", "A=0 deg", "X0C = 9 um, Y0C = -4 um", "Y0A"), ("A,C", "", "X0C = 9 um", "Y0C")],
)
def test_what_a_turning_axis_needs_in_the_kinematics_is_said(
    metrosep, tmp_path, monkeypatch, over, other, same, shown
):
    """The line of C aside of where it should be: at every C the same; Y0C turns with A, so tables over A hold it."""
    monkeypatch.chdir(tmp_path)
    (tmp_path / "c.toml").write_text('X0C = "9 um"\nY0C = "-4 um"\n')
    (tmp_path / "C.csv").write_text(
        "C_deg,EZC_um\n"
        + "".join(f"{c},{3 * np.sin(np.radians(c)):.4f}\n" for c in range(0, 361, 10))
    )
    spans = {"A": "A=-90 deg..30 deg", "C": "C=0 deg..360 deg"}
    where = [w for a in over.split(",") for w in ("--span", spans[a])]
    where += [w for p in ("X=0 mm", "Y=0 mm", "Z=0 mm", other) if p for w in ("--at", p)]
    code, _, err = metrosep(
        "machine-tables", "five_axis", "c.toml", "C.csv", "--pivot-height", "80 mm", "--over", over,
        "--spacing", "10 deg", *where, "-o", "out",
    )  # fmt: skip
    assert code == 0, err
    (said,) = [v for v in err.splitlines() if "the tables hold none of it" in v]
    assert said.startswith(f"note: {same}: ")
    assert shown not in said
    assert "axis C in its kinematics" in said
    moving = [v for v in err.splitlines() if "whose zero stands still in the machine" in v]
    assert [v.partition(":")[2].split(":")[0] for v in moving] == (
        [" Y0C = -4 um"] if other == "" else []
    )


def test_a_preset_lacks_its_size_in_the_same_breath_as_other_options(
    metrosep, tmp_path, monkeypatch
):
    monkeypatch.chdir(tmp_path)
    code, _, err = metrosep("table", "c.toml", "--from-machine", "five_axis", "-o", "out")
    assert code == 2
    for option in ("'--over'", "'--spacing'", "'--pivot-height'"):
        assert option in err


def test_the_way_from_a_calibration_to_tables_of_a_trunnion_ends_in_the_right_corrections(
    metrosep, tmp_path, monkeypatch
):
    """The lines of A and C as bodies, with matrices written here: the corrections follow the displaced part."""
    monkeypatch.chdir(tmp_path)
    (tmp_path / "c.toml").write_text(
        'Y0A = "7 um"\nZ0A = "-5 um"\nB0A = "12 urad"\nC0A = "-9 urad"\n'
        'X0C = "-8 um"\nY0C = "-4 um"\nA0C = "14 urad"\nB0C = "-20 urad"\n'
    )
    code, _, err = metrosep(*TRUNNION, "--pivot-height", "80 mm", *THERE, "-o", "out")
    assert code == 0, err

    def body(turn, shift):
        a, b, c = turn
        made = np.eye(4)
        made[:3, :3] = [[1, -c, b], [c, 1, -a], [-b, a, 1]]
        made[:3, 3] = shift
        return made

    def pose(a, size):
        tilted = np.eye(4)
        tilted[1:3, 1:3] = [
            [np.cos(a), np.sin(a)],
            [-np.sin(a), np.cos(a)],
        ]  # the table turns by -a
        cradle = body(size * np.array([0, 12, -9]), size * np.array([0, 7, -5]))
        table = body(size * np.array([14, -20, 0]), size * np.array([-8, -4, 0]) + [0, 0, 0.08])
        return cradle @ tilted @ table

    tool = np.array([0.065, -0.02, 0.13, 1.0])
    moved = lambda a: ((pose(a, 1e-6) - pose(a, 0.0)) @ np.linalg.solve(pose(a, 0.0), tool))[:3]  # noqa: E731
    for k, axis in enumerate("xyz"):
        rows = (tmp_path / "out" / f"a-{axis}.csv").read_text().splitlines()[1:]
        found = np.array([[float(v) for v in row.split(",")[:2]] for row in rows])
        wanted = [(moved(a)[k] - moved(0.0)[k]) / UM for a in found[:, 0]]
        assert np.ptp(wanted) > 1.0
        assert np.abs(found[:, 1] - wanted).max() < ROUNDING_UM
