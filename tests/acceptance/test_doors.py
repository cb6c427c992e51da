"""One engine: the same input gives the same bytes at every door, and the same numbers at `measure`.

Ten inputs that are made here, six that are measured and four that are separated, go through the
command ``run``, Python, ``batch``, the workbench, and the command of their own.
"""

import json
import shutil

import numpy as np
import pytest

import metrosep as ms
from metrosep.app.documents import Places
from metrosep.app.export_answers import export
from metrosep.app.sessions import Session
from metrosep.cli.main import main
from metrosep.recipe import Recipe

pytestmark = pytest.mark.usefixtures("without_figures")  # no test here looks at one

COLUMNS = '[input]\nx = "x_mm"\nz = "z_um"\nfeed = "feed_mm_min"\nrun = "run"\n'
TABLE = (
    '[[output]]\nkind = "table"\ncontroller = "{kind}"\naxis = "X"\ncompensates = "{c}"\n'
    'spacing = "1.5 mm"\npath = "x.comp"\n'
)


def surface(seed, form=0.0, hole=False):
    y, x = np.mgrid[0:48, 0:56] * 20e-6
    z = 3e-4 * x - 1e-4 * y + form * (x**2 + y**2) + 40e-9 * np.sin(2 * np.pi * x / 200e-6)
    z += np.random.default_rng(seed).normal(0.0, 3e-9, z.shape)
    if hole:
        z[10:14, 20:30] = np.nan
    return ms.Surface(z, 20e-6, 20e-6)


def profile(seed, tilt):
    x = np.arange(4000) * 1e-6
    z = tilt * x + 80e-9 * np.cos(2 * np.pi * x / 100e-6 + 0.3)
    return ms.Profile(x, z + np.random.default_rng(seed).normal(0.0, 2e-9, x.size))


MEASURED = {
    "map, plane off": (surface(1), ["--form", "plane", "--params", "PV,Sq,Sa"]),
    "map with a hole, sphere off, limit": (
        surface(2, form=20.0, hole=True),
        ["--form", "sphere", "--params", "Sq", "--upper", "Sq=60 nm", "--U", "Sq=1 nm"],
    ),
    "map, filtered": (
        surface(3),
        ["--form", "plane", "--lambda-s", "60 um", "--lambda-c", "0.4 mm", "--params", "Sq,Sdq"],
    ),
    "map, share refused": (
        surface(4),
        ["--params", "Sdr", "--upper", "Sdr=0.000001 %", "--U", "Sdr=0"],
    ),
    "profile, all": (profile(5, 1e-4), ["--form", "plane"]),
    "profile, roughness": (
        profile(6, 0.0),
        ["--form", "plane", "--lambda-c", "0.8 mm", "--sections", "3", "--kind", "R"],
    ),
}


def call(*words):
    with pytest.raises(SystemExit) as end:
        main([str(w) for w in words])
    return end.value.code


def by_every_door(folder, recipe, data):
    """Return the bytes of result.json and of a table, door by door."""
    out = {name: folder / name for name in ("run", "python", "batch", "page")}
    call("run", recipe, data, "-o", out["run"])
    Recipe.load(recipe).run(data, out=out["python"])
    call("batch", recipe, data.parent, "-o", out["batch"], "--scheduler", "serial")
    session = Session(Places([folder]))
    session.open(str(recipe))
    export(session, {"what": "result", "path": str(out["page"])}, lambda: False, lambda _: None)
    (inside,) = {p.parent for p in out["batch"].rglob("result.json")}
    found = {}
    for name, place in {**out, "batch": inside}.items():
        found[name] = {p.name: p.read_bytes() for p in place.iterdir() if p.suffix != ".html"}
    document = json.loads(found["batch"]["result.json"])
    del document["unit"]  # which input of the batch it was: the one thing that a batch adds
    text = json.dumps(document, sort_keys=True, separators=(",", ":")) + "\n"
    found["batch"]["result.json"] = text.encode()
    return found


def assert_same(doors):
    first = doors["run"]
    for name, files in doors.items():
        both = files.keys() & first.keys()
        assert "result.json" in both, name
        for file in both:
            assert files[file] == first[file], f"{name}: {file}"


@pytest.mark.parametrize("case", MEASURED)
def test_what_is_measured_is_the_same_at_every_door(tmp_path, capsys, case):
    obj, words = MEASURED[case]
    inbox = tmp_path / "inbox"
    inbox.mkdir()
    data = inbox / "part.h5"
    ms.write(obj, data)
    capsys.readouterr()
    assert call("measure", data, *words, "--print-recipe") == 0
    recipe = inbox / "recipe.toml"
    printed_recipe = capsys.readouterr().out
    recipe.write_text(printed_recipe.replace(json.dumps(str(data)), json.dumps(data.name)))
    code = call("measure", data, *words, "--json")
    printed = json.loads(capsys.readouterr().out)

    doors = by_every_door(tmp_path, recipe, data)

    assert_same(doors)
    document = json.loads(doors["run"]["result.json"])
    values = {c["symbol"]: c["value"] for c in document["characteristics"]}
    assert {s: p["value"] for s, p in printed["parameters"].items()}.items() <= values.items()
    assert printed["verdict"] == document["verdict"]
    assert code == {None: 0, "accept": 0, "reject": 1, "inconclusive": 3}[document["verdict"]]


def runs(path, *, seed, ways, travel, third=False):
    rng = np.random.default_rng(seed)
    rows = ["x_mm,z_um,feed_mm_min,run"]
    number = 0
    for feed in (310, 470, 730)[: 3 if third else 2]:
        for way in ways:
            x = np.linspace(0.0, travel, 601)[::way]
            z = 1.9 * np.sin(2 * np.pi * x / 31.0 + 0.4) + 0.6 * np.cos(2 * np.pi * x / 13.0)
            z += (0.8 if way < 0 else 0.0) + rng.normal(0, 0.02, x.size)
            rows += [f"{a:.6f},{b:.6f},{feed},{number}" for a, b in zip(x, z, strict=True)]
            number += 1
    path.write_text("\n".join(rows) + "\n")


SEPARATED = {
    "both ways, mean": ((1, -1, 1, -1), 60.0, "mean", "X"),
    "one way, joint": ((1, 1, 1), 60.0, "joint", "Z"),
    "one way, mean": ((1, 1, 1), 45.0, "mean", "Z"),
    "one way, kono": ((1, 1, 1), 90.0, "kono", "Z"),
}


@pytest.mark.parametrize("case", SEPARATED)
def test_what_is_separated_is_the_same_at_every_door(tmp_path, case):
    ways, travel, method, compensates = SEPARATED[case]
    kind = "linuxcnc" if compensates == "X" else "csv"
    inbox = tmp_path / "inbox"
    inbox.mkdir()
    data = inbox / "runs.csv"
    runs(data, seed=len(case), ways=ways, travel=travel, third=method == "kono")
    recipe = inbox / "recipe.toml"
    step = f'[[step]]\nop = "separate"\nmethod = "{method}"\n'
    how = ("--method", method)
    if method == "joint":  # far below the waves; its folds cost a tenth
        step, how = step + 'shortest = "3 mm"\n', (*how, "--shortest", "3 mm")
    recipe.write_text(
        "metrosep = 1\n"
        + COLUMNS.replace("[input]", '[input]\nfiles = ["runs.csv"]')
        + step
        + TABLE.format(c=compensates, kind=kind)
    )

    doors = by_every_door(tmp_path, recipe, data)
    columns = ("--x", "x_mm", "--z", "z_um", "--feed", "feed_mm_min", "--run", "run")
    axes = ("--axis", "X", "--compensates", compensates, "--spacing", "1.5 mm")
    table = ("--table", f"{kind}={tmp_path / 'own' / 'x.comp'}", *axes)
    (tmp_path / "own").mkdir()
    call("separate", data, *how, *columns, *table)
    shutil.copytree(tmp_path / "run", tmp_path / "result")
    call("table", tmp_path / "result", "-o", tmp_path / "own" / "y.comp", "--format", kind, *axes)

    assert_same(doors)
    for own in ("x.comp", "y.comp"):
        assert (tmp_path / "own" / own).read_bytes() == doors["run"]["x.comp"], own


# ---- the commands that have a recipe of their own: form, rank, predict, verify -------------------

PREDICTED = """metrosep = 1
[[step]]
op = "predict"
form = "sine_grid: amplitude=50 nm, wavelength=100 um"
radius = "0.5 mm"
feed = "5 um"
rpm = 30
tolerance = "20 nm"
"""


def by_page(folder, recipe):
    """Return result.json as the workbench writes it, of a recipe that reads nothing."""
    session = Session(Places([folder]))
    session.open(str(recipe))
    target = folder / "page"
    export(session, {"what": "result", "path": str(target)}, lambda: False, lambda _: None)
    return (target / "result.json").read_bytes()


def without_recipe(content):
    """Return a document without the name and text of its recipe, which a command makes."""
    document = json.loads(content)
    del document["recipe"]
    return document


@pytest.mark.parametrize("case", ["map, plane off", "map with a hole, sphere off, limit"])
def test_a_fitted_form_is_the_same_at_form_measure_and_run(tmp_path, capsys, case):
    obj, words = MEASURED[case]
    data = tmp_path / "part.h5"
    ms.write(obj, data)
    name = words[words.index("--form") + 1]
    capsys.readouterr()
    assert call("form", data, "--form", name, "--json", "--residual", tmp_path / "left.h5") == 0
    by_form = json.loads(capsys.readouterr().out)
    recipe = Recipe.parse(
        f'metrosep = 1\n[input]\n[[step]]\nop = "form"\nform = "{name}"\n[[step]]\nop = "parameters"\n'
        'names = ["PV", "RMS"]\n'
    )
    result = recipe.run(data)
    found = {c["metric"]: c for c in result.document["characteristics"]}
    call("measure", data, "--form", name, "--params", "PV,RMS", "--json")
    by_measure = json.loads(capsys.readouterr().out)["parameters"]

    assert by_form["pv_nm"] == found["PV"]["value"] * 1e9 == by_measure["PV"]["value"] * 1e9
    assert by_form["rms_nm"] == found["residual.rms"]["value"] * 1e9
    left = ms.read(tmp_path / "left.h5").z
    np.testing.assert_array_equal(left, result.produced.obj.z)


def test_what_is_ranked_is_the_same_at_every_door(tmp_path, capsys):
    words = (
        "rank", "fts_lathe", "--form", "toric: Rb=265 mm, Rd=132.5 mm", "--radius", "10 mm",
        "--all-lengths", "1 um", "--all-angles", "0.2 arcsec",
    )  # fmt: skip
    assert call(*words, "--print-recipe") == 0
    recipe = tmp_path / "rank.toml"
    recipe.write_text(capsys.readouterr().out)
    (tmp_path / "own").mkdir()
    assert call(*words, "-o", tmp_path / "own") == 0
    assert call("run", recipe, "-o", tmp_path / "run") == 0
    by_run = (tmp_path / "run" / "result.json").read_bytes()
    Recipe.load(recipe).run(out=tmp_path / "python")

    assert (tmp_path / "python" / "result.json").read_bytes() == by_run
    assert by_page(tmp_path, recipe) == by_run
    own = (tmp_path / "own" / "result.json").read_bytes()
    assert without_recipe(own) == without_recipe(by_run)
    by_name = ms.separation.separate(
        None, method="rank", machine="fts_lathe", form="toric: Rb=265 mm, Rd=132.5 mm",
        radius="10 mm", all_lengths="1 um", all_angles="0.2 arcsec",
    )  # fmt: skip
    assert by_name.report() == Recipe.load(recipe).run().produced.report()


def test_what_is_predicted_is_the_same_at_every_door(tmp_path):
    recipe = tmp_path / "job.toml"
    recipe.write_text(PREDICTED)
    assert call("predict", recipe, "-o", tmp_path / "own") == 0
    assert call("run", recipe, "-o", tmp_path / "run") == 0
    by_run = (tmp_path / "run" / "result.json").read_bytes()
    Recipe.load(recipe).run(out=tmp_path / "python")

    assert (tmp_path / "python" / "result.json").read_bytes() == by_run
    assert by_page(tmp_path, recipe) == by_run
    own = (tmp_path / "own" / "result.json").read_bytes()
    assert without_recipe(own) == without_recipe(by_run)


@pytest.mark.parametrize("compensates", ["X", "Z"])
def test_a_table_is_judged_the_same_where_it_is_made_and_by_verify(tmp_path, capsys, compensates):
    data = tmp_path / "runs.csv"
    runs(data, seed=5, ways=(1, -1, 1, -1), travel=60.0)
    recipe = tmp_path / "recipe.toml"
    recipe.write_text(
        "metrosep = 1\n" + COLUMNS + '[[step]]\nop = "separate"\nmethod = "mean"\n'
        + TABLE.format(c=compensates, kind="csv")
    )  # fmt: skip
    made = Recipe.load(recipe).run(data, out=tmp_path / "out").document["table"]["verification"]
    capsys.readouterr()
    columns = ("--x", "x_mm", "--z", "z_um", "--feed", "feed_mm_min", "--run", "run")
    assert call("verify", tmp_path / "out" / "x.comp", "--against", data, *columns, "--json") == 0
    again = json.loads(capsys.readouterr().out)

    assert again["residuals"] == made["residuals"]
    assert again["sentences"] == made["sentences"]
