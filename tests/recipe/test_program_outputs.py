"""A recipe that ends in a program file: the door a user takes, judged by the bytes."""

import json
import re

import numpy as np
import pytest

import metrosep as ms
from metrosep.cli.main import main
from metrosep.core.errors import DataError, LimitError, MetrosepError
from metrosep.recipe import Recipe

pytestmark = pytest.mark.usefixtures("without_figures")  # no test here looks at one

STEP = """metrosep = 1
[[step]]
op = "predict"
form = "expression: 9*x**2+14*y**2+3*x*y+6e-3*x+2e-6*sin(2*pi*y/9e-4)"
radius = "1.4 mm"
core = "1.1 mm"
feed = "10 um"
rpm = 60
sense = "clockwise"
nose_radius = "0.6 mm"
rake = "-20 deg"
interpolation = "linear"
angle_step = "2 deg"
"""
OUTPUT = """
[[output]]
kind = "program"
path = "part.nc"
c_positive = "workpiece ccw"
inverse_time = "1/min"
"""

RING = STEP.replace('core = "1.1 mm"', 'core = "1.34 mm"')
"""A few turns only."""


def run(text, folder):
    return Recipe.parse(text, folder=folder).run(out=folder / "out")


def test_a_file_appears_with_what_its_part_is(tmp_path):
    result = run(STEP + OUTPUT, tmp_path)
    text = (tmp_path / "out" / "part.nc").read_text()
    words = re.findall(r"^(?:G1 )?X([\d.]+) C([-\d.]+) Z([-\d.]+) F", text, re.MULTILINE)
    X, C, Z = np.array(words, dtype=float).T
    # the part turns counter-clockwise with C: the place under a tool on +X lies at -C
    phi = -np.radians(C)
    tip = ms.process.tip_path(
        result.produced.form, X * 1e-3, phi, sense="clockwise", nose=result.produced.nose
    )
    assert np.abs(tip.z - Z * 1e-3).max() < 0.15e-9
    assert (np.diff(phi) < 0).all()
    said = json.loads((tmp_path / "out" / "part.nc.json").read_text())["virtual_part"]
    assert said["file_against_program_nm"] <= said["digits_may_cost_nm"] + 0.2
    assert any(
        "part.nc: the part cut from the file is off by" in m for m in result.document["messages"]
    )
    assert {f.name for f in result.files} >= {"part.nc", "part.nc.json", "result.json"}


@pytest.mark.parametrize(
    ("old", "new", "error", "match"),
    [
        ('c_positive = "workpiece ccw"\n', "", MetrosepError, "c_positive"),
        ('"workpiece ccw"', '"ccw"', MetrosepError, "c_positive"),
        ('inverse_time = "1/min"\n', "", DataError, "G93 is three different things"),
        ('interpolation = "linear"', 'interpolation = "spline"', DataError, "G1 is a line"),
        ('inverse_time = "1/min"\n', 'inverse_time = "1/min"\ntolerance = "1 nm"\n', LimitError, "nothing was written"),
        ('sense = "clockwise"\n', "", DataError, "cuts differently both ways"),
        ('nose_radius = "0.6 mm"\nrake = "-20 deg"\n', "", MetrosepError, "no program to write"),
        ('rpm = 60\n', 'rpm = 60\nclearance = "0.5 deg"\n', LimitError, "flank rubs"),
    ],
)  # fmt: skip
def test_what_is_missing_is_refused_and_nothing_is_written(tmp_path, old, new, error, match):
    assert old in RING + OUTPUT
    with pytest.raises(error, match=match):
        run((RING + OUTPUT).replace(old, new, 1), tmp_path)
    assert not (tmp_path / "out" / "part.nc").exists()


def test_both_axes_follow_where_it_is_asked(tmp_path):
    made = run((RING + OUTPUT).replace("rpm = 60\n", 'rpm = 60\nservo = "XZ"\n'), tmp_path)
    rho = np.hypot(made.produced.program.X, 0)
    assert np.abs(np.diff(rho, 2)).max() > 1e-9  # X is no straight line


@pytest.mark.parametrize("servo", ["Z", "XZ"])
def test_a_plan_names_the_limit_that_binds_and_rejects_what_exceeds_it(tmp_path, servo):
    """The tip follows 2.5 um at 60 rpm: 0.3 mm/s of Z are enough, 0.03 mm/s are not."""
    for limit, verdict in (("3 mm/s", "accept"), ("0.03 mm/s", "reject")):
        words = f'rpm = 60\nservo = "{servo}"\nz_limits = ["{limit}"]\n'
        text = RING.replace("rpm = 60\n", words).replace(
            'angle_step = "2 deg"', 'tolerance = "50 nm"'
        )
        made = Recipe.parse(text, folder=tmp_path).run(out=tmp_path / verdict)
        assert made.verdict == verdict
        found = json.loads((tmp_path / verdict / "result.json").read_text())
        assert "velocity of Z" in json.dumps(found)


def test_the_command_says_what_the_part_is(tmp_path, capsys):
    (tmp_path / "job.toml").write_text(RING + OUTPUT)
    with pytest.raises(SystemExit) as end:
        main(["predict", str(tmp_path / "job.toml"), "-o", str(tmp_path / "made")])
    assert end.value.code == 0
    said = capsys.readouterr()
    assert "the part cut from the file is off by" in said.out + said.err
    assert (tmp_path / "made" / "part.nc").exists()


@pytest.mark.slow
def test_the_example_makes_up_for_the_tool_as_it_stands(repository, tmp_path):
    """Judged with the tool that nobody told the recipe: the part of the second program is better."""
    import runpy

    from metrosep.controllers import LatheAxes, read_program
    from metrosep.process import virtual_cut

    folder = repository / "examples" / "cut_path"
    truth = runpy.run_path(str(folder / "make_part.py"))
    ms.Recipe.load(folder / "again.toml").run(out=tmp_path / "again")
    axes = LatheAxes("tool ccw", inverse_time="s", spline_word="CSPLINE")
    again = read_program(tmp_path / "again" / "again.mpf", axes)
    rng = np.random.default_rng(4)
    rho, theta = rng.uniform(0.7e-3, 2.9e-3, 3000), rng.uniform(-3.1, 3.1, 3000)
    x, y = rho * np.cos(theta), rho * np.sin(theta)
    first, second = (
        virtual_cut(p, truth["NOSE"], x, y, form=truth["FORM"], setting=truth["TRUTH"])
        for p in (truth["program"](), again)
    )
    assert first.peak_to_valley > 30e-9
    assert second.peak_to_valley < 12e-9  # cusps of 6 nm


def test_a_program_that_cannot_be_written_is_refused_before_it_is_to_be_written(tmp_path):
    """The page runs a recipe without a folder: it must not accept what `metrosep run` refuses."""
    refused = (RING + OUTPUT).replace('path = "part.nc"', 'path = "part.nc"\ntolerance = "1 nm"')
    with pytest.raises(LimitError, match="nothing was written") as found:
        Recipe.parse(refused, folder=tmp_path).run(None)
    assert str(found.value).startswith("part.nc")  # the folder in which it was tried is of no use
    assert list(tmp_path.iterdir()) == []


def test_a_log_of_both_axes_moves_both_in_the_file(tmp_path):
    """60 rpm: X ends 0.8 um too far out at azimuth 0 and the tool goes round clockwise; the file takes it off."""
    t = np.arange(0.0, 30.5, 0.01)
    x = 1400.0 - 10.0 * t
    ex, z = 0.8 * np.cos(2 * np.pi * t), recipe_heights(x * 1e-6, -2 * np.pi * t) * 1e6
    rows = [
        f"{a:.3f},{b:.6f},{b + c:.6f},{d:.7f},{d + 0.01:.7f}"
        for a, b, c, d in zip(t, x, ex, z, strict=True)
    ]
    (tmp_path / "log.csv").write_text("t_s,x_um,xa_um,z_um,za_um\n" + "\n".join(rows) + "\n")
    log = (
        'follow_up = "log.csv"\nlog_command = "z_um"\nlog_actual = "za_um"\n'
        'log_x_command = "x_um"\nlog_x_actual = "xa_um"\n'
    )
    both = STEP.replace("rpm = 60\n", 'rpm = 60\nservo = "XZ"\n')
    words = {}
    for name, text in (("plain", both), ("both", both + log)):
        made = run(text + OUTPUT, tmp_path / name if name == "plain" else tmp_path)
        folder = tmp_path / name if name == "plain" else tmp_path
        found = re.findall(
            r"^(?:G1 )?X([\d.]+) C([-\d.]+) Z([-\d.]+) F",
            (folder / "out" / "part.nc").read_text(),
            re.MULTILINE,
        )
        words[name] = np.array(found, dtype=float).T
    change = words["both"] - words["plain"]
    azimuth = -np.radians(words["plain"][1])
    # the log begins at the rim; before it the words take what it says there
    inside = slice(3 + 270 + 10, -400)  # a turn and a half of 180 blocks
    assert np.abs(change[0] * 1e3 + 0.8 * np.cos(azimuth))[inside].max() < 5e-3  # um
    assert np.abs(change[2] * 1e3 + 0.01)[inside].max() < 2e-4
    assert "follow-up of X" in json.dumps(made.document)
    # X follows nothing with servo Z, and says so; one column of X is not enough
    made = run(STEP + log, tmp_path)
    assert any("NOT corrected for what X does" in m for m in made.document["messages"])
    with pytest.raises(DataError, match="give both"):
        run(STEP + log.replace('log_x_actual = "xa_um"\n', ""), tmp_path)


def recipe_heights(rho, phi):
    """Return the form of `STEP` along a course."""
    x, y = rho * np.cos(phi), rho * np.sin(phi)
    return 9 * x**2 + 14 * y**2 + 3 * x * y + 6e-3 * x + 2e-6 * np.sin(2 * np.pi * y / 9e-4)


def words_of(file):
    """X and Z of the blocks of a file, m."""
    found = re.findall(r"X([-\d.]+) C[-\d.]+ Z([-\d.]+)", file.read_text())
    return np.array(found, dtype=float).T * 1e-3


@pytest.mark.parametrize("servo", ["Z", "XZ"])
def test_a_path_beyond_the_travel_names_axis_block_and_by_how_much(tmp_path, capsys, servo):
    step = RING.replace("rpm = 60\n", f'rpm = 60\nservo = "{servo}"\n') + OUTPUT
    run(step, tmp_path)
    X, Z = words_of(tmp_path / "out" / "part.nc")
    last = X.size - 1
    for axis, values in (("x", X), ("z", Z)):
        low, high = values.min(), values.max()
        for ends, off, at in (
            ((low - 1e-6, high + 1e-6), None, None),
            ((low - 1e-6, high - 7e-6), "7 um above", int(np.argmax(values))),
            ((low + 7e-6, high + 1e-6), "7 um below", int(np.argmin(values))),
        ):
            line = (
                f'{axis}_travel = ["{float(ends[0]) * 1e3!r} mm", "{float(ends[1]) * 1e6!r} um"]\n'
            )
            (tmp_path / "job.toml").write_text(step.replace("rpm = 60\n", f"rpm = 60\n{line}"))
            with pytest.raises(SystemExit) as end:
                main(["predict", str(tmp_path / "job.toml"), "-o", str(tmp_path / f"{axis}{off}")])
            said = re.sub(r"\s+", " ", capsys.readouterr().err)
            if off is None:
                assert end.value.code == 0
                continue
            assert end.value.code != 0
            size, block = re.search(rf"{axis.upper()} goes ([\d.]+) um {off[5:]} its travel .* in block (\d+)", said).groups()  # fmt: skip
            assert float(size) == pytest.approx(
                7.0, abs=0.01
            )  # digits of the file, and of the text
            assert int(block) in (at - 1, at, min(at, last - 1))
            assert not (tmp_path / f"{axis}{off}").exists()


@pytest.mark.parametrize(
    ("line", "match"),
    [
        ('x_travel = ["2 mm", "1 mm"]', "give the least place first"),
        ('x_travel = ["2 mm"]', "two lengths"),
        ("z_travel = [1, 2]", "unit"),
        ('z_travel = ["nan mm", "2 mm"]', "finite|number"),
    ],
)
def test_a_travel_that_is_none_is_refused(tmp_path, line, match):
    with pytest.raises(MetrosepError, match=match):
        run(RING.replace("rpm = 60\n", f"rpm = 60\n{line}\n"), tmp_path)


def test_a_travel_holds_for_points_of_the_surface_too(tmp_path):
    points = RING.replace('nose_radius = "0.6 mm"\nrake = "-20 deg"\n', "")
    with pytest.raises(LimitError, match=r"Z goes .* above its travel"):
        run(points.replace("rpm = 60\n", 'rpm = 60\nz_travel = ["-1 mm", "10 um"]\n'), tmp_path)


def test_another_program_is_not_replaced_unless_the_output_says_so(tmp_path, capsys):
    def called(text, *words):
        (tmp_path / "job.toml").write_text(text)
        with pytest.raises(SystemExit) as end:
            main([*words, str(tmp_path / "job.toml"), "-o", str(tmp_path / "out")])
        return end.value.code, " ".join(capsys.readouterr().err.split())

    file, beside = tmp_path / "out" / "part.nc", tmp_path / "out" / "part.nc.json"
    assert called(RING + OUTPUT, "predict")[0] == 0
    first, said = file.read_bytes(), beside.read_bytes()
    result = (tmp_path / "out" / "result.json").read_bytes()
    assert called(RING + OUTPUT, "predict")[0] == 0  # the same program again
    assert not (tmp_path / "out" / "part.nc.1").exists()
    other = (RING + OUTPUT).replace("rpm = 60", "rpm = 50")
    code, err = called(other, "predict")
    assert code != 0
    assert "part.nc: is another program" in err
    assert "overwrite = true" in err
    assert file.read_bytes() == first
    assert beside.read_bytes() == said
    assert (tmp_path / "out" / "result.json").read_bytes() == result
    assert called(f"{other}overwrite = true\n", "predict")[0] == 0
    assert file.read_bytes() != first
    assert (tmp_path / "out" / "part.nc.1").read_bytes() == first
    assert (tmp_path / "out" / "part.nc.1.json").read_bytes() == said
    file.write_text("( of somebody else )\n")  # a sidecar that does not belong to it
    assert called(other, "predict")[0] != 0
    assert file.read_text() == "( of somebody else )\n"
    assert called(other, "run", "--force")[0] == 0
    assert (tmp_path / "out" / "part.nc.2").read_text() == "( of somebody else )\n"


def mapped(tmp_path, name, centre=(0.0, 0.0), hole=None):
    """Write the form of `STEP` as a map of 25 um whose axis is at a place; a hole is x, y, radius on the part."""
    axis = np.arange(-70, 71) * 25e-6
    x, y = np.meshgrid(axis, axis)
    z = recipe_heights(np.hypot(x, y), np.arctan2(y, x))
    if hole is not None:
        z[np.hypot(x - hole[0], y - hole[1]) < hole[2]] = np.nan
    origin = (axis[0] + centre[0], axis[0] + centre[1])
    ms.write(ms.Surface(z, dx=25e-6, dy=25e-6, origin=origin), tmp_path / name)
    return re.sub('form = "[^"]*"', f'form_map = "{name}"', RING).replace('rake = "-20 deg"\n', "")


@pytest.mark.parametrize(("centre", "line"), [((0, 0), ""), ((3e-3, -1e-3), 'form_centre = ["3 mm", "-1 mm"]\n')])  # fmt: skip
def test_a_map_is_cut_as_the_surface_it_was_made_of(tmp_path, centre, line):
    """The words of the file against the lowest tips over the formula, by points of the edge in numpy."""
    step = mapped(tmp_path, "wanted.x3p", centre)
    run(step.replace("rpm = 60\n", f"rpm = 60\n{line}") + OUTPUT, tmp_path)
    text = (tmp_path / "out" / "part.nc").read_text()
    found = re.findall(r"X([\d.]+) C([-\d.]+) Z([-\d.]+)", text)
    X, C, Z = np.array(found[::7], dtype=float).T
    psi = np.linspace(-0.15, 0.15, 2401)
    along = X[:, None] * 1e-3 + 0.6e-3 * np.sin(psi)
    gap = recipe_heights(along, -np.radians(C)[:, None]) - 0.6e-3 * (1 - np.cos(psi))
    k = np.argmax(gap, axis=1)
    row = np.arange(k.size)
    before, top, after = gap[row, k - 1], gap[row, k], gap[row, k + 1]
    tip = top + (after - before) ** 2 / (8 * (2 * top - before - after))
    assert np.abs(Z * 1e-3 - tip).max() < 1e-9  # a spline through waves of 0.9 mm in 36 pixels


def test_a_hole_in_a_map_is_not_air_unless_the_path_ends_before_it(tmp_path):
    on_part, inside, outside = (1.35e-3, -0.25e-3, 0.06e-3), (0.3e-3, 0.4e-3, 0.2e-3), (1.68e-3, 0, 0.09e-3)  # fmt: skip
    for hole in (inside, outside):  # within the core; a bay of the border
        step = mapped(tmp_path, "wanted.x3p", hole=hole)
        run(step + OUTPUT + "overwrite = true\n", tmp_path)
    step = mapped(tmp_path, "wanted.x3p", hole=on_part)
    with pytest.raises(MetrosepError, match=r"hole of \d+ pixels .* is not air") as found:
        run(step + OUTPUT, tmp_path)
    rho, azimuth = re.search(r"rho = ([\d.]+) mm, azimuth ([\d.]+) degrees", str(found.value)).groups()  # fmt: skip
    off = float(rho) * 1e-3 * np.exp(1j * np.radians(float(azimuth))) - complex(*on_part[:2])
    assert abs(off) < on_part[2]


@pytest.mark.parametrize(
    ("change", "match"),
    [
        (lambda s: s.replace("rpm", 'form = "plane"\nrpm'), "got form and form_map"),
        (lambda s: re.sub("form_map.*", "", s), "got none"),
        (lambda s: s.replace("rpm", 'form_centre = ["1 mm"]\nrpm'), "two lengths"),
        (lambda s: RING.replace("rpm", 'form_centre = ["1 mm", "0 mm"]\nrpm'), "give that, form_map"),
        (lambda s: s.replace("wanted.x3p", "wanted.csv"), "a map is needed"),
    ],
)  # fmt: skip
def test_a_surface_is_given_once(tmp_path, change, match):
    (tmp_path / "wanted.csv").write_text(
        "x_mm,z_um\n" + "".join(f"{k},{k * k}\n" for k in range(9))
    )
    with pytest.raises(MetrosepError, match=match):
        run(change(mapped(tmp_path, "wanted.x3p")) + OUTPUT, tmp_path)
