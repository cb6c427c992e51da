"""A recipe judges the surface that it shows, and checks only what one of its steps makes."""

import numpy as np
import pytest

import metrosep as ms
from metrosep.forms.catalogue import form_from_text
from metrosep.recipe.pipeline_checks import makes_metric

RECIPE = """metrosep = 1
[input]
files = ["part.x3p"]
[[step]]
op = "form"
form = "plane"
[[step]]
op = "parameters"
names = ["{names}"]
{more}[[step]]
op = "{last}"
{keys}
[[check]]
metric = "{metric}"
upper = "1 mm"
U = "1 nm"
"""
KEYS = {
    "filter": 'lambda_c = "20 um"',
    "mask": 'aperture = {{ shape = "circle", diameter = "30 um" }}',
    "outliers": "threshold = 5.0",
    "form": 'form = "sphere"',
    "parameters": 'names = ["Sq"]',
}


@pytest.fixture
def folder(tmp_path):
    y, x = np.mgrid[:40, :40]
    z = 1e-8 * np.sin(x / 3.0) + 1e-12 * (x**2 + y**2) + 1e-7 * (x == y) * (x == 20)
    ms.write(ms.Surface(z, 1e-6, 1e-6), tmp_path / "part.x3p")
    return tmp_path


@pytest.fixture
def check(command_line, folder):
    def run(text, command=("check", "r.toml")):
        (folder / "r.toml").write_text(text)
        return command_line(folder, *command)

    return run


def text_of(last="parameters", *, names="Sa", metric="Sa", more=""):
    keys = KEYS[last].replace("{{", "{").replace("}}", "}")
    return RECIPE.format(names=names, last=last, keys=keys, metric=metric, more=more)


@pytest.mark.parametrize("last", ["filter", "mask", "outliers", "form"])
@pytest.mark.parametrize(
    "command", [("check", "r.toml"), ("run", "r.toml", "part.x3p", "-o", "o")]
)
def test_a_step_that_changes_the_map_behind_its_evaluation_is_refused(
    folder, check, last, command
):
    done = check(text_of(last), command)

    assert done.returncode == 2
    assert "r.toml:8" in done.stderr + done.stdout  # the evaluation
    assert "line 11" in done.stderr + done.stdout  # the step behind it
    assert not (folder / "o").exists()


@pytest.mark.parametrize("last", ["filter", "mask", "outliers", "form"])
def test_an_evaluation_that_says_it_is_intermediate_is_carried_out_and_named(folder, check, last):
    text = text_of(last, more="intermediate = true\n")

    assert check(text).returncode == 0
    (folder / "r.toml").write_text(text)
    result = ms.Recipe.load(folder / "r.toml").run(folder / "part.x3p")
    assert any("intermediate" in m and "Sa" in m for m in result.document["messages"])


EVALUATIONS = {
    "psd": ('limit = "rms = 10 nm from 4 um to 20 um"', "PSD"),
    "step_height": ('width = "8 um"\nmiddle = "20 um"', "d, h"),
    "surface_profile": ('form = "sphere: R=50 mm"', "t"),
}


@pytest.mark.parametrize("op", EVALUATIONS)
def test_each_evaluation_comes_last_or_says_that_it_is_intermediate(folder, check, op):
    keys, metrics = EVALUATIONS[op]
    head = f'metrosep = 1\n[input]\nfiles = ["part.x3p"]\n[[step]]\nop = "{op}"\n{keys}\n'
    last = '[[step]]\nop = "filter"\nlambda_c = "20 um"\n'

    assert check(head).returncode == 0
    behind = check(head + '[[step]]\nop = "parameters"\nnames = ["Sa"]\n')
    assert behind.returncode == 0  # a second evaluation changes nothing
    refused = check(head + last)
    assert refused.returncode == 2
    assert "r.toml:5" in refused.stderr + refused.stdout
    (folder / "r.toml").write_text(head + "intermediate = true\n" + last)
    done = ms.Recipe.load(folder / "r.toml").run(folder / "part.x3p")
    assert any(f"intermediate: {metrics} are of" in m for m in done.document["messages"])


def test_several_evaluations_of_one_map_need_no_word(check):
    assert check(text_of("parameters")).returncode == 0


def test_a_later_step_that_is_switched_off_changes_nothing(check):
    text = text_of("filter").replace('op = "filter"', 'op = "filter"\nenabled = false')

    assert check(text).returncode == 0


@pytest.mark.parametrize(
    ("names", "metric", "said"),
    [
        ("Sa", "Sdx", "did you mean"),
        ("Sa", "Sku", "made by no step"),
        ("Sa", "thing", "made by no step"),
        ("Sa", "residual.pvr", "residual.pv"),
        ("Sa", "R", "made by no step"),  # of a sphere, and this is a plane
        ("Sa", "Sa#2", "1 time only"),
        ("all", "FLTt", "made by no step"),
    ],
)
def test_check_refuses_a_metric_that_no_step_makes(check, names, metric, said):
    done = check(text_of(names=names, metric=metric))

    assert done.returncode == 2
    assert "r.toml:14" in done.stderr + done.stdout
    assert said in done.stderr + done.stdout


@pytest.mark.parametrize(
    ("names", "metric"),
    [
        ("Sa", "Sa"), ("Sa", "Sq"), ("all", "Sdq"), ("Rsm", "RSm"), ("Smr1", "Smrk1"),
        ("Sa", "residual.rms"), ("Sq", "Sq#2"), ("FLTt", "FLTt"),
    ],
)  # fmt: skip
def test_metrics_that_a_step_makes_pass_in_either_spelling(names, metric):
    steps = [
        {"op": "form", "form": "plane"},
        {"op": "parameters", "names": [names]},
        {"op": "parameters", "names": ["Sq"]},
    ]

    assert makes_metric(steps, metric) is None


@pytest.mark.parametrize(
    "text",
    [
        "plane",
        "sphere",
        "cylinder",
        "conic",
        "asphere",
        "zernike",
        "polynomial: degree=3",
        "toric",
    ],
)
def test_every_parameter_that_a_form_finds_may_be_checked(text):
    try:
        form_from_text(text)
    except ms.errors.DataError:
        pytest.skip(f"{text} needs numbers")
    y, x = np.mgrid[-20:21, -20:21] * 1e-5
    obj = ms.Surface((x**2 + 2 * y**2) / 0.1 + 1e-3 * x, 1e-5, 1e-5)
    from metrosep.recipe.pipeline import run_step

    found = run_step(obj, {"op": "form", "form": text}).found

    assert [makes_metric([{"op": "form", "form": text}], name) for name in found] == [None] * len(
        found
    )
