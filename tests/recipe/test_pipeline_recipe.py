"""Recipes that measure one map or profile: checks with file and line, documents, the command line."""

import json

import numpy as np
import pytest

import metrosep as ms
from metrosep.cli.main import main
from metrosep.core.errors import FitError, InvalidSamplesError, ReadError, RecipeError
from metrosep.recipe.pipeline_run import Measurement, measure_object

NM = 1e-9
LAST_DIGITS = 4e-15
"""Relative: sums of BLAS depend on where an array begins in memory, in the last digits."""
HEAD = 'metrosep = 1\n[input]\nfiles = ["part.h5"]\n'
STEPS = """
[[step]]
op = "mask"
aperture = { shape = "circle", diameter = "4 mm" }

[[step]]
op = "form"
form = "sphere"
free = ["R", "piston", "shift_x", "shift_y"]

[[step]]
op = "parameters"
names = ["Sq", "PV"]
intermediate = true

[[step]]
op = "filter"
cutoff = "0.5 mm"

[[step]]
op = "parameters"
names = ["Sq"]
"""


@pytest.fixture
def part(tmp_path):
    """Sphere of 50 mm with noise; the vertex is off the middle, differently in x and y."""
    rng = np.random.default_rng(11)
    y, x = np.mgrid[:90, :100] * 50e-6
    z = 50e-3 - np.sqrt(50e-3**2 - (x - 2.6e-3) ** 2 - (y - 2.1e-3) ** 2)
    z += 3 * NM * rng.standard_normal(z.shape)
    z[:4] = np.nan
    ms.write(ms.Surface(z, 50e-6, 50e-6), tmp_path / "part.h5")
    return tmp_path


@pytest.fixture
def sine(tmp_path):
    x = np.arange(8000) * 0.5e-6
    ms.write(
        ms.Profile(x, 50 * NM * np.cos(2 * np.pi * x / 100e-6) + 1e-4 * x), tmp_path / "part.h5"
    )
    return tmp_path


def recipe(folder, text, name="part.toml"):
    (folder / name).write_text(text, encoding="utf-8")
    return ms.Recipe.load(folder / name)


def check(metric, **keys):
    lines = [f"{k} = {json.dumps(v)}" for k, v in keys.items()]
    return "\n".join(["\n[[check]]", f'metric = "{metric}"', *lines]) + "\n"


def test_the_document_holds_what_was_found_judged_and_done(part):
    text = HEAD + STEPS + check("R", lower="49.9 mm", upper="50.1 mm", U="from fit")
    text += check("Sq#2", upper="0.1 nm", U="0.02 nm", name="waviness")
    result = recipe(part, text).run(out=part / "out")

    found = {c["metric"]: c for c in result.document["characteristics"]}
    assert result.verdict == "reject"
    assert found["R"]["verdict"] == "accept"
    assert 2.0 < found["R"]["U"] / found["R"]["u"] < 2.6  # Student's t
    assert found["R"]["u_source"] == "fit residual"
    assert found["Sq#2"]["u_source"] == "stated"
    assert found["Sq"]["value"] == pytest.approx(3 * NM, abs=0.1 * NM)
    assert found["Sq#2"]["name"] == "waviness"
    # sum of squared Gaussian weights: 1 / (2 (a Lc)^2) in pixels; more at the rim
    smooth = 3 * NM / np.sqrt(2.0) / (0.4697 * 10)
    assert found["Sq#2"]["value"] == pytest.approx(smooth, abs=0.12 * NM)
    names = [s["step"] for s in result.document["provenance"]]
    assert names == ["read", "mask", "fit sphere", "parameters", "gaussian", "parameters"]
    assert result.document["inputs"][0]["name"] == "part.h5"
    assert [s["op"] for s in result.document["separation"]["steps"]] == [
        "mask",
        "form",
        "parameters",
        "filter",
        "parameters",
    ]
    assert isinstance(result.produced, Measurement)
    assert (part / "out" / "result.json").is_file()
    shown = [c["kind"] for c in result.document["separation"]["charts"]]
    assert shown == ["maps", "maps", "maps", "curves", "curves"]


def test_the_same_input_gives_the_same_bytes(part):
    text = HEAD + STEPS.replace('["Sq", "PV"]', '["PV"]').replace('["Sq"]', '["PV"]')
    first = recipe(part, text).run(out=part / "a")
    second = recipe(part, text).run(out=part / "b")
    assert first.to_json() == second.to_json()
    assert (part / "a/result.json").read_bytes() == first.to_json()


def test_a_step_that_is_off_is_as_if_it_were_not_there(part):
    without = STEPS.replace(
        'op = "mask"\naperture = { shape = "circle", diameter = "4 mm" }\n', ""
    )
    without = without.replace("[[step]]\n\n", "")
    off = STEPS.replace('op = "mask"', 'op = "mask"\nenabled = false')
    a = recipe(part, HEAD + without).run().document
    b = recipe(part, HEAD + off).run().document
    assert a["characteristics"] == b["characteristics"]
    assert a["provenance"] == b["provenance"]
    assert b["separation"]["steps"][0]["enabled"] is False


def test_outputs_are_written(part):
    text = HEAD + STEPS + '\n[[output]]\nkind = "report"\n[[output]]\nkind = "parts"\n'
    result = recipe(part, text).run(out=part / "out")
    names = {f.name for f in result.files}
    assert names == {"parts-left.h5", "report.html", "result.json"}
    left = ms.read(part / "out/parts-left.h5")
    np.testing.assert_array_equal(left.z, result.produced.obj.z)
    page = (part / "out/report.html").read_text("utf-8")
    assert "What is left after mask, form, filter" in page
    assert "removed" in page


def test_a_profile_and_its_roughness(sine):
    text = HEAD + '[[step]]\nop = "form"\nform = "plane"\n[[step]]\nop = "filter"\n'
    text += 'lambda_c = "0.8 mm"\n[[step]]\nop = "parameters"\nnames = ["Rq", "Rt"]\n'
    text += check("Rq", upper="40 nm", U="1 nm") + '[[output]]\nkind = "parts"\n'
    result = recipe(sine, text).run(out=sine / "out")
    found = {c["metric"]: c["value"] for c in result.document["characteristics"]}
    kept = 1 - 2.0 ** -((0.8e-3 / 100e-6) ** 2)
    assert found["Rq"] == pytest.approx(50 * NM / np.sqrt(2) * kept, abs=0.05 * NM)
    assert found["tilt_x"] == pytest.approx(1e-4, abs=1e-8)
    assert result.verdict == "accept"
    rows = (sine / "out/parts.csv").read_text("utf-8").splitlines()
    assert rows[0] == "x_mm,z_nm"
    assert len(rows) == 8001


def test_a_limit_in_the_spelling_of_the_other_edition(sine):
    text = HEAD + '[[step]]\nop = "filter"\nlambda_c = "0.8 mm"\n[[step]]\nop = "parameters"\n'
    text += 'names = ["Rsm"]\n' + check("RSm", upper="0.11 mm", lower="0.09 mm", U="1 um")
    result = recipe(sine, text).run()
    assert result.verdict == "accept"
    assert [c["metric"] for c in result.document["characteristics"]] == ["Rsm"]


def test_a_limit_on_what_was_not_asked(sine):
    text = HEAD + '[[step]]\nop = "filter"\nlambda_c = "0.8 mm"\n[[step]]\nop = "parameters"\n'
    text += 'names = ["Rmr1"]\n' + check("Rk", upper="1 um", U="1 nm")
    with pytest.raises(RecipeError, match=r'part.toml:12: metric = "Rk" is made by no step'):
        recipe(sine, text).run()


BAD = [
    ('[[step]]\nop = "mask"\naperture = { shape = "circle", diamter = "1 mm" }\n', 6, "diameter"),
    ('[[step]]\nop = "mask"\naperture = { shape = "circle" }\n', 6, "needs diameter"),
    ('[[step]]\nop = "mask"\n', 4, 'needs the key "aperture"'),
    ('[[step]]\nop = "form"\nform = "cone"\n', 6, "no form 'cone'"),
    ('[[step]]\nop = "form"\nform = "sphere"\nfix = { R = 5 }\n', 7, "unit"),
    ('[[step]]\nop = "filter"\ncutoff = 25\n', 6, "unit"),
    ('[[step]]\nop = "filter"\ncutof = "25 um"\n', 6, 'Did you mean "cutoff"'),
    ('[[step]]\nop = "filter"\ncutoff = "25 um"\nlambda_s = "1 um"\n', 6, "lambda_s"),
    ('[[step]]\nop = "outliers"\nwindow = 4\n', 6, "odd"),
    ('[[step]]\nop = "parameters"\nenabled = "no"\n', 6, "true or false"),
    ('[[step]]\nop = "parameters"\nenabled = false\n', 6, "switched off"),
    ('[[step]]\nop = "parameters"\n[[step]]\nop = "separate"\n', 7, "recipe of its own"),
    ('[[step]]\nop = "sharpen"\n', 5, "op = one of"),
]


@pytest.mark.parametrize(("steps", "line", "match"), BAD)
def test_mistakes_are_named_with_their_line_before_anything_is_read(steps, line, match):
    with pytest.raises(RecipeError, match=match) as caught:
        ms.Recipe.parse(HEAD + steps, name="part.toml")
    assert str(caught.value).startswith(f"part.toml:{line}: ")


def test_the_separation_of_runs_takes_no_step_that_measures():
    text = 'metrosep = 1\n[input]\nx = "x_mm"\nz = "z_um"\n[[step]]\nop = "separate"\n'
    with pytest.raises(RecipeError, match=r"part.toml:8: .*recipe of its own"):
        ms.Recipe.parse(text + '[[step]]\nop = "form"\nform = "plane"\n', name="part.toml")


@pytest.mark.parametrize(
    ("step", "line", "match"),
    [
        ('op = "filter"\nlambda_c = "0.8 mm"\nprofile = "W"\n', 7, "profiles"),
        ('op = "filter"\ncutoff = "1 nm"\n', 6, "nesting|cutoff"),
        ('op = "parameters"\nnames = ["Ra"]\n', 6, "no parameter 'Ra'"),
        ('op = "parameters"\nkind = "R"\n', 6, "profiles"),
        ('op = "form"\nform = "plane"\nfree = ["R"]\n', 7, "R"),
    ],
)
def test_what_does_not_apply_to_a_map_is_refused_with_its_line(part, step, line, match):
    with pytest.raises(RecipeError, match=match) as caught:
        recipe(part, HEAD + "[[step]]\n" + step).run(out=part / "out")
    assert str(caught.value).startswith(f"part.toml:{line}: step 1 (")
    assert not (part / "out").exists()


def test_a_rectangle_on_a_profile_is_refused_with_its_line(sine):
    step = '[[step]]\nop = "mask"\naperture = { shape = "rectangle", width = "1 mm", height = "1 mm" }\n'
    with pytest.raises(RecipeError, match=r"part.toml:6: step 1 .mask.: .* on a profile"):
        recipe(sine, HEAD + step).run()
    text = HEAD + '[[step]]\nop = "parameters"\nnames = ["Sa"]\n'
    with pytest.raises(RecipeError, match=r"part.toml:6: step 1 .parameters.: .*'Sa'"):
        recipe(sine, text).run()


def test_errors_of_the_data_keep_their_kind_and_get_the_place(part):
    empty = ms.Surface(np.full((9, 9), np.nan), 1e-6, 1e-6)
    with pytest.raises(InvalidSamplesError, match=r"part.toml:5: step 1 \(parameters\)"):
        measure_object(recipe(part, HEAD + '[[step]]\nop = "parameters"\n'), empty)
    ms.write(ms.Surface(np.arange(6.0).reshape(2, 3), 1e-6, 1e-6), part / "part.h5")
    text = HEAD + '[[step]]\nop = "form"\nform = "polynomial: degree=5"\n'
    with pytest.raises(FitError, match=r"part.toml:5: step 1 \(form\)"):
        recipe(part, text).run()


def test_a_check_of_what_was_not_measured(part):
    with pytest.raises(RecipeError, match='metric = "Sz" is made by no step; did you mean "Sq"'):
        recipe(part, HEAD + STEPS + check("Sz", upper="1 nm", U="1 nm")).run()
    found = recipe(part, HEAD + STEPS + check("PV", upper="1 nm")).run()
    (pv,) = [c for c in found.document["characteristics"] if c["metric"] == "PV"]
    assert (pv["verdict"], pv["u_source"], pv["U"]) == ("inconclusive", "not stated", None)
    assert "state it: U" in pv["reason"]


def test_one_file_at_a_time(part):
    (part / "other.h5").write_bytes((part / "part.h5").read_bytes())
    loaded = recipe(part, HEAD + STEPS)
    with pytest.raises(RecipeError, match="one file at a time, got 2"):
        loaded.run([part / "part.h5", part / "other.h5"])
    with pytest.raises(ReadError, match="no file matches"):
        recipe(part, HEAD.replace("part.h5", "*.sdf") + STEPS).run()


def test_keys_of_input_reach_the_reader(part):
    text = HEAD + 'lateral_step = "100 um"\n[[step]]\nop = "parameters"\nnames = ["Sq"]\n'
    assert recipe(part, text).run().produced.source.dx == pytest.approx(100e-6, abs=1e-15)


# the command line


@pytest.fixture
def metrosep(capsys):
    def call(*words):
        with pytest.raises(SystemExit) as stop:
            main([str(w) for w in words])
        out = capsys.readouterr()
        return stop.value.code, out.out, out.err

    return call


@pytest.mark.parametrize(("limit", "code"), [("10 nm", 0), ("1 nm", 1), ("3 nm", 3)])
def test_the_exit_code_is_the_verdict(metrosep, part, limit, code):
    recipe(part, HEAD + STEPS + check("Sq", upper=limit, U="0.5 nm"))
    found, _, err = metrosep("run", part / "part.toml", "-o", part / "out")
    assert found == code
    assert "Sq: " in err
    assert found == metrosep("run", part / "part.toml", "-o", part / "out", "--json")[0]


def test_a_wrong_step_is_one_line_and_code_2(metrosep, part):
    (part / "part.toml").write_text(HEAD + '[[step]]\nop = "filter"\nkind = "gauss"\n', "utf-8")
    code, _, err = metrosep("run", part / "part.toml", "-o", part / "out")
    assert code == 2
    assert "part.toml:6" in err
    assert err.count("error") == 1


CALLS = [
    ("map", ["--form", "sphere", "--params", "Sq,PV,FLTt"]),
    ("map", ["--form", "plane", "--lambda-s", "0.2 mm", "--lambda-c", "1 mm"]),
    ("map", ["--params", "Sk", "--line", "secant"]),
    ("profile", ["--form", "plane", "--lambda-c", "0.8 mm", "--lambda-s", "2.5 um"]),
    ("profile", ["--lambda-c", "0.8 mm", "--kind", "W", "--params", "Wq,STRt", "--reference", "LS"]),
    ("profile", ["--edition", "iso 4287:1997", "--kind", "R", "--sections", "4", "--centre"]),
    ("profile", ["--lambda-c", "0.8 mm", "--end", "cut", "--sections", "2", "--upper", "Rq=1 um",
                 "--U", "Rq=1 nm", "--guard-factor", "0.8"]),
]  # fmt: skip


@pytest.mark.parametrize(("kind", "words"), CALLS)
def test_measure_and_the_recipe_that_it_prints_agree(metrosep, request, kind, words):
    folder = request.getfixturevalue("part" if kind == "map" else "sine")
    file = folder / "part.h5"
    code, out, _ = metrosep("measure", file, *words, "--json")
    direct = {k: v["value"] for k, v in json.loads(out)["parameters"].items()}

    _, printed, _ = metrosep("measure", file, *words, "--print-recipe")
    (folder / "printed.toml").write_text(printed, encoding="utf-8")
    result = ms.Recipe.load(folder / "printed.toml").run()

    found = {c["metric"]: c["value"] for c in result.document["characteristics"]}
    assert direct
    assert set(direct) <= set(found)
    for symbol, value in direct.items():
        assert found[symbol] == pytest.approx(value, abs=LAST_DIGITS * abs(value)), symbol
    assert {None: 0, "accept": 0, "reject": 1}[result.verdict] == code


def test_measure_writes_a_report(metrosep, part):
    words = ("--form", "sphere", "--params", "Sq", "--upper", "Sq=1 nm", "--U", "Sq=0.1 nm")
    code, out, err = metrosep("measure", part / "part.h5", *words, "-o", part / "out")
    assert code == 1
    assert "Sq" in out
    assert (part / "out/report.html").is_file()
    assert json.loads((part / "out/result.json").read_text("utf-8"))["verdict"] == "reject"
    assert "report" in err
    two = metrosep("measure", part / "part.h5", part / "part.h5", "-o", part / "out")
    assert two[0] == 2
    assert "one FILE" in two[2]


@pytest.mark.parametrize("name", ["mask", "outliers", "form", "filter", "parameters"])
def test_ops_explains_the_steps(metrosep, name):
    code, out, _ = metrosep("ops", name)
    assert code == 0
    assert "a map or a profile" in out
    rows = json.loads(metrosep("ops", "--json")[1])
    assert name in {row["op"] for row in rows}
