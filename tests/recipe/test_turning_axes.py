"""Recipes of axes that turn give the tables of the command line; angles are taken where it turns only."""

import json

import numpy as np
import pytest

from metrosep.app.documents import Places
from metrosep.app.export_answers import export
from metrosep.app.sessions import Session
from metrosep.cli.main import main
from metrosep.errors import MetrosepError, RecipeError
from metrosep.recipe import Recipe

pytestmark = pytest.mark.usefixtures("without_figures")  # no test here looks at one

STEP = 5
"""deg between the entries."""


def error_arcsec(deg, way=1):
    """Of the axis: odd, so that a mirrored angle shows, and larger than what is lost at a reversal."""
    a = np.radians(deg)
    return 9.0 * np.sin(a + 0.4) + 4.0 * np.cos(2.0 * a) + (1.5 if way < 0 else 0.0)


def runs_file(folder, *, reads="arcsec", over="deg"):
    rng = np.random.default_rng(7)
    rows = [f"run,c_{over},z_{reads}"]
    for k in range(8):
        way = (1, -1)[k % 2]
        at = np.linspace(-2.0, 362.0, 1400)[::way]
        z = error_arcsec(at, way) + rng.normal(0.0, 2.0) + rng.normal(0.0, 0.05, at.size)
        rows += [f"{k},{a:.9f},{v:.5f}" for a, v in zip(at, z, strict=True)]
    (folder / "c.csv").write_text("\n".join(rows) + "\n")
    return folder / "c.csv"


def list_file(folder):
    rows = ["target_deg,direction,run1_deg,run2_deg,run3_deg"]
    rng = np.random.default_rng(4)
    for way, name in ((1, "forward"), (-1, "reverse")):
        for at in np.arange(0, 361, 15)[::way]:
            reached = at + (error_arcsec(at, way) + rng.normal(0.0, 0.05, 3)) / 3600.0
            rows.append(f"{at},{name}," + ",".join(f"{r:.9f}" for r in reached))
    (folder / "list.csv").write_text("\n".join(rows) + "\n")
    return folder / "list.csv"


RUNS = """metrosep = 1
[input]
files = ["c.csv"]
x = "c_{over}"
z = "z_{reads}"
run = "run"
[[step]]
op = "separate"
{step}
[[output]]
kind = "table"
controller = "csv"
axis = "C"
compensates = "{to}"
spacing = "{spacing}"
path = "c.out"
{more}
"""
LIST = """metrosep = 1
[input]
files = ["list.csv"]
target = "target_deg"
direction = "direction"
readings = ["run1_deg", "run2_deg", "run3_deg"]
[[step]]
op = "iso230_2"
[[output]]
kind = "table"
controller = "csv"
axis = "{axis}"
spacing = "{spacing}"
reference = "{reference}"
compensates = "{axis}"
path = "c.out"
"""


def of_runs(step='method = "mean"', to="C", spacing="5 deg", reads="arcsec", over="deg", more=""):
    return RUNS.format(step=step, to=to, spacing=spacing, reads=reads, over=over, more=more)


def call(*words):
    with pytest.raises(SystemExit) as end:
        main([str(w) for w in words])
    return end.value.code


def pair(folder):
    return (folder / "c.out").read_bytes(), json.loads((folder / "c.out.json").read_text())


def test_runs_over_an_angle_give_the_same_table_at_every_door(tmp_path):
    inbox = tmp_path / "inbox"
    inbox.mkdir()
    data = runs_file(inbox)
    recipe = inbox / "recipe.toml"
    recipe.write_text(of_runs(more='reference = "30 deg"\n[[output]]\nkind = "report"'))
    columns = ("--x", "c_deg", "--z", "z_arcsec", "--run", "run")
    shape = ("--axis", "C", "--compensates", "C", "--spacing", "5 deg", "--reference", "30 deg")
    places = {
        n: tmp_path / n for n in ("run", "python", "batch", "page", "own", "result", "beside")
    }
    (tmp_path / "own").mkdir()
    (tmp_path / "beside").mkdir()

    assert call("run", recipe, data, "-o", places["run"]) == 0
    Recipe.load(recipe).run(data, out=places["python"])
    assert call("batch", recipe, inbox, "-o", places["batch"], "--scheduler", "serial") == 0
    session = Session(Places([tmp_path]))
    session.open(str(recipe))
    export(session, {"what": "result", "path": str(places["page"])}, lambda: 0, lambda _: None)
    assert (
        call("table", data, *columns, *shape, "--format", "csv", "-o", places["own"] / "c.out")
        == 0
    )
    (tmp_path / "result").mkdir()
    again = ("table", places["run"], *shape, "--format", "csv", "-o", places["result"] / "c.out")
    assert call(*again) == 0
    words = "axis=C,compensates=C,spacing=5 deg,reference=30 deg"
    table = ("--table", f"csv={places['beside'] / 'c.out'},{words}")
    assert call("separate", data, "--method", "mean", *columns, *table) == 0

    (places["batch"],) = {p.parent for p in places["batch"].rglob("c.out")}
    first, sidecar = pair(places["run"])
    for name, place in places.items():
        made = place / "c.out"
        assert made.read_bytes() == first, name
        assert json.loads((place / "c.out.json").read_text()) == sidecar, name
    rows = np.genfromtxt(places["run"] / "c.out", delimiter=",", comments="#", skip_header=0)
    rows = rows[np.isfinite(rows[:, 0])]
    at = np.arange(0, 361, STEP)
    assert np.degrees(rows[:, 0]) == pytest.approx(at, rel=0, abs=1e-6)
    urad = np.radians(1.0 / 3600.0) * 1e6
    wanted = -(error_arcsec(at) - error_arcsec(30.0)) * urad
    assert np.abs(rows[:, 1] - wanted).max() < 0.3 * urad  # means of cells of noise 0.05 arcsec
    assert (places["run"] / "report.html").stat().st_size > 1000
    assert call("verify", places["run"] / "c.out", "--against", data, *columns) == 0


@pytest.mark.parametrize("spacing", ["15 deg", "0.2617993877991494 rad", "900 arcmin"])
def test_a_list_of_a_rotary_table_takes_spacing_and_reference_as_angles(tmp_path, spacing):
    data = list_file(tmp_path)
    (tmp_path / "r.toml").write_text(LIST.format(axis="C", spacing=spacing, reference="30 deg"))
    Recipe.load(tmp_path / "r.toml").run(data, out=tmp_path / "out")
    shape = ("--axis", "C", "--spacing", spacing, "--reference", "30 deg", "--format", "csv")
    columns = ("--target", "target_deg", "--direction", "direction", "--readings", "run1_deg,run2_deg,run3_deg")  # fmt: skip
    assert call("table", data, *columns, *shape, "-o", tmp_path / "own.out") == 0
    assert (tmp_path / "own.out").read_bytes() == (tmp_path / "out" / "c.out").read_bytes()


@pytest.mark.parametrize(
    ("axis", "spacing", "reference", "line", "said"),
    [
        ("C", "15 mm", "30 deg", 13, "angle"),
        ("C", "15 deg", "30 mm", 14, "reference is a length, but the position of C is an angle"),
        ("X", "15 deg", "30 mm", 13, "length"),
        ("X", "15 mm", "30 deg", 14, "reference is an angle, but the position of X is a length"),
        ("X", "-15 mm", "30 mm", 13, "positive"),
        ("X", "15 furlong", "30 mm", 13, "furlong"),
        ("X", "15 mm", "thirty", 14, "thirty"),
    ],
)
def test_a_position_of_the_other_kind_is_refused_with_its_line(
    axis, spacing, reference, line, said
):
    with pytest.raises(RecipeError, match=said) as caught:
        Recipe.parse(LIST.format(axis=axis, spacing=spacing, reference=reference))
    assert caught.value.line == line


@pytest.mark.parametrize(
    ("step", "more", "said"),
    [
        ('method = "joint"', "", "over an angle the runs are averaged"),
        ('method = "mean"\nshortest = "2 mm"', "", "over an angle the runs are averaged"),
        (
            'method = "mean"\n[[step]]\nop = "polynomial"\nquantity = "error"',
            "",
            "polynomial is of runs along a length",
        ),
        ('method = "mean"', '[[check]]\nmetric = "pv"\nupper = "3 arcsec"', None),
    ],
)
def test_what_only_runs_along_a_length_have_is_refused(step, more, said):
    text = of_runs(step, more=more)
    if said is None:
        assert Recipe.parse(text).checks[0]["upper"].dimension == "rad"
    else:
        with pytest.raises(RecipeError, match=said):
            Recipe.parse(text)


def test_a_limit_of_the_mean_error_is_an_angle(tmp_path):
    data = runs_file(tmp_path)
    check = '[[check]]\nmetric = "forward.pv"\nupper = "{}"\nU = "1 arcsec"\n'
    for upper, verdict in (("40 arcsec", "accept"), ("10 arcsec", "reject")):
        recipe = Recipe.parse(of_runs(more=check.format(upper)))
        assert recipe.run(data).verdict == verdict
    with pytest.raises(MetrosepError, match=r"upper is a length, but forward.pv is an angle"):
        Recipe.parse(of_runs(more=check.format("3 um"))).run(data)


def test_run_out_over_an_angle_and_lengths_where_angles_are_needed(tmp_path):
    data = runs_file(tmp_path, reads="um")
    made = Recipe.parse(of_runs(to="Z", reads="um")).run(data, out=tmp_path / "out")
    assert made.document["table"]["compensates"] == "Z"
    assert "forward_m" in made.document["table"]
    with pytest.raises(MetrosepError, match="the readings are lengths"):
        Recipe.parse(of_runs(reads="um")).run(data)
    data = runs_file(tmp_path, reads="um", over="mm")
    with pytest.raises(MetrosepError, match="C turns, and the runs are lengths over lengths"):
        Recipe.parse(of_runs(to="Z", reads="um", over="mm")).run(data)
