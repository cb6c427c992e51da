"""Steps about a program file and a stage, through recipe and command line, judged by the files.

Programs, parts and stages are those of the examples, which are made without the package.
"""

import importlib.util
import json
import re
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from metrosep.cli.main import main

pytestmark = pytest.mark.usefixtures("without_figures")  # no test here looks at one

EXAMPLES = Path(__file__).parents[2] / "examples"
CUT, STAGE = EXAMPLES / "cut_budget", EXAMPLES / "stage_hysteresis"
NM, UM, MM = 1e-9, 1e-6, 1e-3


def called(*words):
    """Exit code of a command line."""
    with pytest.raises(SystemExit) as ended:
        main(["-q", *map(str, words)])
    return ended.value.code or 0


def maker(folder):
    spec = importlib.util.spec_from_file_location(f"make_{folder.name}", folder / "make_data.py")
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def values(folder):
    """Metrics of a result by name."""
    document = json.loads((folder / "result.json").read_text())
    return {r["metric"]: r for r in document["characteristics"]}, document


def ran(tmp_path, name, change=lambda text: text, command="predict"):
    """Run a recipe of the examples that was changed, beside its data."""
    text = change((CUT / name).read_text())
    for file in ("part.nc", "edge.csv", "log.csv", "part.csv"):
        text = text.replace(f'"{file}"', f'"{CUT / file}"')
    (tmp_path / name).write_text(text)
    code = called(command, tmp_path / name, "-o", tmp_path / "out")
    return code, *values(tmp_path / "out")


@pytest.fixture(scope="module")
def budget(tmp_path_factory):
    folder = tmp_path_factory.mktemp("budget")
    return (*ran(folder, "budget.toml"), folder)


@pytest.fixture(scope="module")
def wrongly_set(tmp_path_factory):
    """The budget with the sign of the setting turned; its table of causes adds up as well."""
    folder = tmp_path_factory.mktemp("wrongly_set")
    turned = ran(folder, "budget.toml", lambda t: t.replace('dx = "1.5 um"', 'dx = "-1.5 um"'))
    return (*turned, folder)


@pytest.mark.slow
def test_the_part_shows_what_is_in_it_and_not_the_log_of_another_day(budget):
    code, found, document, _ = budget
    assert code == 0
    for name, there in (("program", 1), ("tool", 1), ("tool setting", 1), ("follow-up", 0)):
        amount, u = (found[f"shown.{name}"][k] for k in ("value", "u"))
        assert abs(amount - there) <= 3 * u
        assert u < 0.03
    assert found["explained"]["value"] > 0.99
    assert found["left"]["value"] == pytest.approx(1 * NM, abs=0.1 * NM)  # the noise of the map
    assert any("least-squares circle was taken off" in m for m in document["messages"])


def test_the_table_of_causes_adds_up_to_the_full_cut(wrongly_set):
    *_, folder = wrongly_set
    table = pd.read_csv(folder / "out" / "causes.csv", comment="#")
    names = ["program_m", "tool_m", "tool_setting_m", "follow-up_m"]
    whole = table[names].sum(axis=1) - table["sum_m"]
    assert float(np.abs(whole).max()) < 1e-13


def test_a_wrong_sign_of_the_setting_is_not_shown(wrongly_set):
    is_not_shown(wrongly_set, "tool setting")


@pytest.mark.slow
def test_a_wrong_sign_of_the_edge_is_not_shown(tmp_path):
    is_not_shown(
        ran(tmp_path, "budget.toml", lambda t: t.replace('"outwards"', '"inwards"')), "tool"
    )


def is_not_shown(done, name):
    code, found, *_ = done
    assert code == 0
    amount, u = (found[f"shown.{name}"][k] for k in ("value", "u"))
    assert abs(amount - 1) > 6 * u
    assert found["left"]["value"] > 2 * NM


def test_limits_of_axes_are_those_of_the_words(tmp_path):
    rows = re.findall(r"X([\d.]+) C([-\d.]+) Z([-\d.]+) F([\d.]+)", (CUT / "part.nc").read_text())
    X, C, Z, F = np.array(rows, dtype=float).T
    minutes = 1 / F[1:]  # G93 in 1/min
    speeds = {k: np.abs(np.diff(v)) / minutes / 60 for k, v in (("X", X), ("C", C), ("Z", Z))}

    code, found, document = ran(tmp_path, "motion.toml")

    assert code == 0
    assert found["Z.velocity"]["value"] == pytest.approx(speeds["Z"].max() * MM, rel=1e-9, abs=0)
    assert found["C.velocity"]["value"] == pytest.approx(np.radians(speeds["C"].max()), rel=1e-9, abs=0)  # fmt: skip
    rpm = 60 * min(720 / speeds["C"].max(), 0.5 / speeds["Z"].max(), 10 / speeds["X"].max())
    assert found["rpm_max"]["value"] == pytest.approx(rpm, rel=1e-4, abs=0)
    slow = lambda t: t.replace('"0.5 mm/s"', '"3 mm/min"')  # noqa: E731
    _, found, document = ran(tmp_path, "motion.toml", slow)
    assert found["rpm_max"]["value"] == pytest.approx(60 * 0.05 / speeds["Z"].max(), rel=1e-4, abs=0)  # fmt: skip
    assert any("velocity of Z is" in m and "would keep it" in m for m in document["messages"])


@pytest.mark.parametrize(
    ("axis", "text", "limit"),
    [
        ("z", "100 um/s", 1e-4),
        ("z", "100 µm/s", 1e-4),
        ("z", "6 mm/min", 1e-4),
        ("c", "30 rpm", np.pi),
        ("c", "30 1/min", np.pi),
        ("c", "3 rad/s", 3.0),
        ("c", "180 deg/s", np.pi),
    ],
)
def test_a_limit_that_is_exceeded_is_rejected_in_any_unit(tmp_path, axis, text, limit):
    name = {"z": 'z_limits = ["0.5 mm/s"]', "c": 'c_limits = ["720 deg/s"]'}[axis]
    code, found, document = ran(
        tmp_path, "motion.toml", lambda t: t.replace(name, f'{axis}_limits = ["{text}"]')
    )
    assert (code, document["verdict"]) == (1, "reject")
    share = found[f"{axis.upper()}.velocity"]["value"] / limit
    assert share > 1
    assert found["rpm_share"]["value"] == pytest.approx(share, rel=1e-9, abs=0)
    assert found["rpm_share"]["verdict"] == "reject"


@pytest.mark.parametrize("text", ["m/s2", "m/s^2", "m/s²"])
def test_acceleration_and_jerk_of_a_spline_are_judged(tmp_path, text):
    def spline(recipe):
        recipe = recipe.replace('"part.nc"', '"points.csv"\njoined_by = "spline"')
        recipe = re.sub(r"(inverse_time|block_time|[xc]_limits).*", "", recipe)
        return recipe.replace('["0.5 mm/s"]', f'["20 mm/s", "1 um/s3", "1e-9 {text}"]')

    turn = np.arange(0.0, 3.0, 1.0 / 90.0)
    rows = [
        f"{a:.9f},{1.5 - 0.01 * a:.6f},{360 * a:.4f},{0.001 * np.sin(12 * a):.9f}" for a in turn
    ]
    head = ["# quantity tip", "t_s,X_mm,C_deg,Z_mm"]
    (tmp_path / "points.csv").write_text("\n".join([*head, *rows, ""]))
    code, found, document = ran(tmp_path, "motion.toml", spline)
    assert code == 1
    exceeded = " ".join(document["messages"])
    assert "acceleration of Z is" in exceeded
    assert "jerk of Z is" in exceeded
    assert found["rpm_max"]["value"] < 60


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ('["20 deg/s"]', "Z moves along"),
        ('["1 m/s2", "2 m/s^2"]', "states the acceleration twice"),
        ('["1-2 mm/s"]', "unknown unit '-2 mm'"),
        ('["1.2.3 mm/s"]', "unknown unit '.3 mm'"),
        ('["1e400 mm/s"]', "is not finite"),
        ('["1e400 mm/s3"]', "is not finite"),
        ('["mm/s"]', "is not a number"),
        ('["60 rpm"]', "Z moves along"),
        (
            '["20 mm/s", "0.000001 m/s2"]',
            "acceleration of Z cannot be judged: lines meet in corners",
        ),
        ('["1 m/s³"]', "jerk of Z cannot be judged"),
    ],
)
def test_limits_that_say_nothing_are_refused(tmp_path, capsys, text, said):
    old = 'z_limits = ["0.5 mm/s"]'
    (tmp_path / "m.toml").write_text(
        (CUT / "motion.toml").read_text().replace(old, f"z_limits = {text}").replace("part.nc", str(CUT / "part.nc"))
    )  # fmt: skip
    assert called("predict", tmp_path / "m.toml") in (2, 4)
    assert said in capsys.readouterr().err


EDGE = """metrosep = 1
[[step]]
op = "predict"
form = "expression: 9*x**2+14*y**2+3*x*y+6e-3*x"
radius = "1.5 mm"
core = "1.35 mm"
feed = "10 um"
rpm = 60
sense = "clockwise"
nose_radius = "0.6 mm"
edge = "edge.csv"
edge_rises = "{rises}"
interpolation = "linear"
angle_step = "1 deg"
[[output]]
kind = "program"
verify = false
path = "p.nc"
c_positive = "workpiece ccw"
inverse_time = "1/min"
"""


@pytest.mark.parametrize(
    ("rises", "right"),
    [("outwards", True), pytest.param("inwards", False, marks=pytest.mark.slow)],
)
def test_a_program_makes_up_for_a_measured_edge(tmp_path, rises, right):
    """The file is cut by the example's own envelope with the wavy edge, the circle taken off as a maker would."""
    make = maker(CUT)
    make.DX = make.DR = 0.0
    psi = np.radians(np.linspace(-15.0, 15.0, 301))
    circle = np.stack([np.ones_like(psi), np.sin(psi), np.cos(psi)], axis=1)
    raw = make.waviness(psi)
    wave = raw - circle @ np.linalg.lstsq(circle, raw, rcond=None)[0]
    make.waviness = lambda at: np.interp(at, psi, wave)
    rows = [f"{np.degrees(p):.6f},{1e9 * d:.6f}" for p, d in zip(psi, wave, strict=True)]
    (tmp_path / "edge.csv").write_text("\n".join(["psi_deg,deviation_nm", *rows, ""]))
    (tmp_path / "e.toml").write_text(EDGE.format(rises=rises))

    assert called("predict", tmp_path / "e.toml", "-o", tmp_path / "out") == 0

    _, document = values(tmp_path / "out")
    assert any("least-squares circle was taken off" in m for m in document["messages"])

    words = re.findall(r"X([\d.]+) C([-\d.]+) Z([-\d.]+)", (tmp_path / "out" / "p.nc").read_text())
    X, C, Z = np.array(words, dtype=float).T
    rng = np.random.default_rng(1)
    rho, theta = rng.uniform(1.38e-3, 1.47e-3, 1500), rng.uniform(-np.pi, np.pi, 1500)
    left = make.cut(X * MM, -np.radians(C), Z * MM, rho, theta)
    left -= make.surface(rho * np.cos(theta), rho * np.sin(theta))
    # nothing is cut too deep but by chords; a wrong edge digs 15 nm
    assert left.min() > -2.5 * NM if right else left.min() < -10 * NM


def test_voltages_of_a_course_drive_a_stage_with_a_memory(tmp_path):
    stage = maker(STAGE)
    assert called("run", STAGE / "stage.toml", "-o", tmp_path) == 0
    table = pd.read_csv(tmp_path / "stage-course.csv", comment="#")
    found, document = values(tmp_path)

    cycle = stage.through([0, 10, 0], 0.1)
    for way, low, high in (("prandtl_ishlinskii", 0.0, 0.012), ("mean_curve", 0.15, 0.25)):
        driven = stage.stage(np.append(cycle, table[f"{way}_V"]))[cycle.size :]
        off = np.abs(driven - 1e6 * table["displacement_m"]).max()
        assert low <= off <= high  # um
    assert found["mean_curve.left"]["value"] == pytest.approx(209 * NM, abs=3 * NM)
    assert any("the model itself is off by" in m for m in document["messages"])


def test_a_course_without_history_is_refused(capsys):
    words = ["--method", "hysteresis", "--column", "voltage=voltage_V", "--column", "displacement=displacement_um"]  # fmt: skip
    course = ["--set", f"course={STAGE / 'course.csv'}"]
    assert called("separate", STAGE / "loops.csv", *words, *course) in (2, 4)
    assert "depend on what the stage has seen before" in capsys.readouterr().err
    with_history = [*course, "--set", "history=none"]
    assert called("separate", STAGE / "loops.csv", *words, *with_history) == 0


def moved(tmp_path, change):
    """The part of the example with its places changed, and the recipe's change for it."""
    table = pd.read_csv(CUT / "part.csv")
    table["x_mm"], table["y_mm"] = change(table["x_mm"], table["y_mm"])
    table.to_csv(tmp_path / "moved.csv", index=False, float_format="%.3f")
    return lambda text: text.replace('"part.csv"', '"moved.csv"').replace('log = "log.csv"', "")


def test_a_part_whose_map_begins_in_a_corner_needs_its_centre(tmp_path, capsys):
    part = moved(tmp_path, lambda x, y: (x + 1.5, y + 1.7))
    text = part((CUT / "budget.toml").read_text())
    for file in ("part.nc", "edge.csv", "log.csv"):
        text = text.replace(f'"{file}"', f'"{CUT / file}"')
    (tmp_path / "b.toml").write_text(text)
    assert called("predict", tmp_path / "b.toml") in (2, 4)
    error = capsys.readouterr().err
    assert "degrees in the ring that the program cuts about the axis, x = 0 m" in error

    given = '"moved.csv"\ncentre = ["1.5 mm", "1.7 mm"]'
    code, found, document = ran(
        tmp_path, "budget.toml", lambda t: part(t).replace('"moved.csv"', given)
    )
    assert code == 0
    assert found["left"]["value"] == pytest.approx(1 * NM, abs=0.1 * NM)
    assert not any("where 1 is all of it" in m for m in document["messages"])
    # x and y of the centre are not exchanged, and a wrong centre is reported
    wrong = '"moved.csv"\ncentre = ["1.7 mm", "1.5 mm"]'
    _, found, document = ran(
        tmp_path, "budget.toml", lambda t: part(t).replace('"moved.csv"', wrong)
    )
    assert found["left"]["value"] > 5 * NM
    assert any("where 1 is all of it and 0 none" in m for m in document["messages"])


@pytest.mark.parametrize(
    ("axis", "way"), [("x", (-1, 1)), pytest.param("y", (1, -1), marks=pytest.mark.slow)]
)
def test_a_mirrored_map_is_named(tmp_path, axis, way):
    part = moved(tmp_path, lambda x, y: (way[0] * x, way[1] * y))
    code, found, document = ran(tmp_path, "budget.toml", part)
    assert code == 0
    assert found["left"]["value"] > 100 * NM
    # the mirrors of this form differ by a tilt only, which a map has anyway
    said = [m for m in document["messages"] if "the map would be off the form by 2" in m]
    assert f"mirrored in {axis}" in said[0]
    assert "turned" not in said[0]


def test_edge_rises_without_an_edge_is_refused(tmp_path, capsys):
    text = re.sub(r"(?m)^(edge|log|part) = .*$", "", (CUT / "budget.toml").read_text())
    (tmp_path / "b.toml").write_text(text.replace('"part.nc"', f'"{CUT / "part.nc"}"'))
    assert called("predict", tmp_path / "b.toml") in (2, 4)
    assert "give it, edge" in capsys.readouterr().err
    (tmp_path / "e.toml").write_text(re.sub(r"(?m)^edge = .*$", "", EDGE).format(rises="inwards"))
    assert called("predict", tmp_path / "e.toml") in (2, 4)
    assert "give it, edge" in capsys.readouterr().err


def log_of(tmp_path, rows):
    (tmp_path / "own.csv").write_text("\n".join([*rows, ""]))

    def change(text):
        text = re.sub(r"(?m)^(edge|edge_rises|part|dx|dR) = .*$", "", text)
        return text.replace('"log.csv"', '"own.csv"')

    return change


def test_a_log_has_its_units_in_the_names_of_its_columns(tmp_path):
    table = pd.read_csv(CUT / "log.csv")
    rows = [
        f"{1e3 * t:.4f},{1e-3 * x + 2e-5:.9f},{np.radians(c):.9f},{1e3 * z:.4f}"
        for t, x, c, z in table.to_numpy()
    ]
    code, found, _ = ran(
        tmp_path, "budget.toml", log_of(tmp_path, ["t_ms,x_mm,C_rad,Z_nm", *rows])
    )
    assert code == 0
    same = [f"{t:.7f},{x + 0.02:.6f},{c:.6f},{z:.7f}" for t, x, c, z in table.to_numpy()]
    _, usual, _ = ran(tmp_path, "budget.toml", log_of(tmp_path, ["t_s,X_um,C_deg,Z_um", *same]))
    value = usual["follow-up.pv"]["value"]
    assert value > 20 * NM
    assert found["follow-up.pv"]["value"] == pytest.approx(value, rel=1e-6, abs=0)


@pytest.mark.parametrize(
    ("rows", "said"),
    [
        (["t_s,X_um,C_deg,Z_um", "1000,0,0,0", "2000,0,0,0"], "the log runs from 1000 s to 2000 s, the program from 0 s to "),
        (["t_s,X_um,C_deg,Z_um", "-1,0,0,0", "20,0,0,0"], "the log covers 4"),
        (["t_s,X_um,X_mm,C_deg,Z_um", "-1,0,0,0,0", "99,0,0,0,0"], "X_um and X_mm are the same column"),
        (["t_s,C_deg,Z_um", "-1,0,0", "99,0,0"], "no X column 'X_um'"),
    ],
)  # fmt: skip
def test_a_log_that_cannot_be_used_is_refused(tmp_path, capsys, rows, said):
    text = log_of(tmp_path, rows)((CUT / "budget.toml").read_text())
    (tmp_path / "b.toml").write_text(text.replace('"part.nc"', f'"{CUT / "part.nc"}"'))
    assert called("predict", tmp_path / "b.toml") in (2, 4)
    assert said in capsys.readouterr().err


LOOPS = ["--method", "hysteresis", "--column", "voltage=voltage_V", "--column", "displacement=displacement_um"]  # fmt: skip


@pytest.mark.parametrize("history", ["0,10000,0", "0,11,0", "-0.5", "0,11000 mV,0", "0,ten,0", "nan"])  # fmt: skip
def test_a_history_beyond_the_loops_is_refused(capsys, history):
    words = [*LOOPS, "--set", f"course={STAGE / 'course.csv'}", "--set", f"history={history}"]
    assert called("separate", STAGE / "loops.csv", *words) in (2, 4)
    error = capsys.readouterr().err
    assert "the loops go from 0 V to 10 V" in error or "not a number with a unit" in error


def test_history_and_course_in_other_units(tmp_path):
    course = pd.read_csv(STAGE / "course.csv")["displacement_um"]
    rows = [f"{1e3 * v:.4f}" for v in course]
    (tmp_path / "nm.csv").write_text("\n".join(["displacement_nm", *rows, ""]))
    made = []
    for file, history in ((STAGE / "course.csv", "0,10,0"), (tmp_path / "nm.csv", "0 V,10000 mV,0")):  # fmt: skip
        words = [*LOOPS, "--set", f"course={file}", "--set", f"history={history}"]
        out = tmp_path / str(len(made))
        assert called("separate", STAGE / "loops.csv", *words, "-o", out) == 0
        found, _ = values(out)
        made.append(found["mean_curve.left"]["value"])
    assert made[0] == pytest.approx(made[1], rel=1e-9, abs=0)


@pytest.fixture
def spindle(tmp_path):
    """The part of the example once more, on a spindle that rises and falls as it turns, and its curve."""
    rise = lambda c: 12e-9 * np.cos(2 * c + 0.4) + 8e-9 * np.sin(3 * c)  # noqa: E731
    table = pd.read_csv(CUT / "part.csv")
    # C turns the workpiece: the tool meets the azimuth -C; a part that rises is cut deeper
    table["z_nm"] -= rise(-np.arctan2(table["y_mm"], table["x_mm"])) / NM
    table.to_csv(tmp_path / "spindle.csv", index=False)
    c = np.linspace(0.0, 360.0, 721)
    pd.DataFrame({"c_deg": c, "EZC_nm": rise(np.radians(c)) / NM}).to_csv(
        tmp_path / "ezc.csv", index=False
    )
    return tmp_path


@pytest.mark.parametrize(
    ("part", "there"), [("spindle.csv", 1), pytest.param("part.csv", 0, marks=pytest.mark.slow)]
)
def test_a_part_shows_a_term_of_the_machine_or_not(spindle, part, there):
    def on_lathe(text):
        text = text.replace('"part.csv"', f'"{spindle / part}"' if there else '"part.csv"')
        words = f'machine = "sts_lathe"\nerrors = {{ EZC = "table {spindle / "ezc.csv"}" }}\n'
        return text.replace("[[output]]", words + "\n[[output]]", 1)

    code, found, _ = ran(spindle, "budget.toml", on_lathe)
    assert code == 0
    amount, u = (found["shown.EZC"][k] for k in ("value", "u"))
    assert abs(amount - there) <= 3 * u
    assert u < 0.05
    assert found["EZC.pv"]["value"] == pytest.approx(36 * NM, abs=6 * NM)


@pytest.mark.parametrize(
    ("words", "said"),
    [
        ('errors = { EZC = "10 nm" }', "errors belongs to a machine: give it, machine"),
        (
            'machine = "sts_lathe"\nerrors = { EZC = "2 upr 50 nm" }',
            "whose phase nobody knows: it ranks terms",
        ),
        (
            'machine = "five_axis"\npivot_height = "80 mm"\nerrors = { EZC = "50 nm" }',
            "opposite ways: c_positive",
        ),
        ('machine = "mill_xyz"\nerrors = { EZX = "50 nm" }', "has no axis C: it turns nothing"),
        (
            'machine = "sts_lathe"\nerrors = { EZX = "5 nm", u_EYX = "1 nm" }',
            "u of 'EYX' belongs to no term",
        ),
    ],
)
def test_a_machine_that_does_not_fit_the_program_is_refused(tmp_path, capsys, words, said):
    text = (CUT / "budget.toml").read_text().replace("[[output]]", f"{words}\n\n[[output]]", 1)
    for file in ("part.nc", "edge.csv", "log.csv", "part.csv"):
        text = text.replace(f'"{file}"', f'"{CUT / file}"')
    (tmp_path / "budget.toml").write_text(text)
    assert called("predict", tmp_path / "budget.toml", "-o", tmp_path / "out") == 2
    assert said in capsys.readouterr().err
    assert not (tmp_path / "out").exists()


def test_a_wrong_way_of_c_is_named(tmp_path, budget):
    """The file is read as a mirrored part: its own map is not on the part that was measured."""
    _, found, document = ran(
        tmp_path, "budget.toml", lambda t: t.replace("workpiece ccw", "tool ccw")
    )
    assert abs(found["shown.program"]["value"]) < 0.1
    assert any("a wrong way of C reads a mirrored part" in m for m in document["messages"])
    assert not any("a wrong way of C" in m for m in budget[2]["messages"])
