"""Verdicts on parameters of a fitted form: none rests on an uncertainty that nobody chose."""

import json

import numpy as np
import pytest

import metrosep as ms
from metrosep.cli.main import main
from metrosep.core.errors import RecipeError
from metrosep.report import render_html

STEP, SIDE, BLUR = 10e-6, 72, 5

RECIPE = """
metrosep = 1
title = "radius"
[input]
[[step]]
op = "form"
form = "sphere"
[[check]]
metric = "R"
"""


def command(*words):
    """Return the exit code of the command line."""
    with pytest.raises(SystemExit) as ended:
        main([str(w) for w in words])
    return ended.value.code


def part(path, R, seed):
    """A sphere with 5 nm of texture that hangs together over five pixels."""
    rng = np.random.default_rng(seed)
    t = np.arange(-4 * BLUR, 4 * BLUR + 1)
    kernel = np.exp(-0.5 * (t / BLUR) ** 2)
    kernel /= np.sqrt(np.sum(kernel**2))
    noise = rng.standard_normal((SIDE + 8 * BLUR,) * 2)
    for axis in (0, 1):
        noise = np.apply_along_axis(np.convolve, axis, noise, kernel, mode="valid")
    x = STEP * (np.arange(SIDE) - (SIDE - 1) / 2)
    r2 = x[:, None] ** 2 + x[None, :] ** 2
    z = r2 / R / (1 + np.sqrt(1 - r2 / R**2)) + 5e-9 * noise
    return ms.write(ms.Surface(z, STEP, STEP, origin=(x[0], x[0])), path)


def accepted(tmp_path, keys):
    """How many of 40 parts, each a hair above its upper limit of 100 mm, are accepted."""
    recipe = ms.Recipe.parse(RECIPE + keys, name="r.toml")
    count = 0
    for seed in range(40):
        file = part(tmp_path / "part.h5", 100.001e-3, seed)
        count += recipe.run(file).verdict == "accept"
        file.unlink()
    return count


def test_bad_parts_are_not_accepted_where_nobody_states_an_uncertainty(tmp_path):
    assert accepted(tmp_path, 'upper = "100 mm"\n') == 0


def test_with_the_uncertainty_of_the_fit_five_per_cent_of_bad_parts_pass(tmp_path):
    """5 % of 40 are 2; more than 6 come in 3 of 1000 such sets."""
    assert accepted(tmp_path, 'upper = "100 mm"\nU = "from fit"\n') <= 6


def test_a_good_part_passes_with_the_uncertainty_of_the_fit_and_says_what_it_rests_on(tmp_path):
    recipe = ms.Recipe.parse(
        RECIPE + 'lower = "90 mm"\nupper = "110 mm"\nU = "from fit"\n', name="r.toml"
    )

    result = recipe.run(part(tmp_path / "part.h5", 100e-3, 3))

    entry = next(c for c in result.document["characteristics"] if c["metric"] == "R")
    assert result.verdict == "accept"
    assert entry["u_source"] == "fit residual"
    assert "scale, reference and repeatability are not in it" in entry["u_note"]
    assert entry["U"] > 2.0 * entry["u"]
    found = ms.forms.fit(ms.read(tmp_path / "part.h5"), ms.forms.form_from_text("sphere"))
    # a radius is judged by its curvature
    assert entry["guard_factor"] * found.coverage_factor * found.u["c"] == pytest.approx(
        found.guard["c"], rel=1e-9, abs=0.0
    )


def test_the_command_line_says_what_to_write(tmp_path, capsys):
    (tmp_path / "r.toml").write_text(RECIPE + 'upper = "200 mm"\n', encoding="utf-8")
    file = part(tmp_path / "part.h5", 100e-3, 3)
    out = tmp_path / "out"

    code = command("run", tmp_path / "r.toml", file, "-o", out)

    assert code == 3
    assert 'U = "from fit"' in capsys.readouterr().err
    entries = json.loads((out / "result.json").read_text())["characteristics"]
    entry = next(c for c in entries if c["metric"] == "R")
    assert (entry["verdict"], entry["U"]) == ("inconclusive", None)
    # what is printed works where it is written
    text = RECIPE + 'upper = "200 mm"\nU = "from fit"\n'
    (tmp_path / "r.toml").write_text(text, encoding="utf-8")
    assert command("run", tmp_path / "r.toml", file, "-o", tmp_path / "again") == 0


@pytest.mark.parametrize(
    ("limits", "R", "verdict"),
    [
        ('lower = "50 mm"', 100e-3, "accept"),
        ('lower = "150 mm"', 100e-3, "reject"),
        ('upper = "-50 mm"', -100e-3, "accept"),
        ('upper = "-150 mm"', -100e-3, "reject"),
        ('lower = "-150 mm"\nupper = "-50 mm"', -100e-3, "accept"),
        ('lower = "10 m"', 1e6, "inconclusive"),
    ],
)
def test_a_radius_is_judged_by_its_curvature(tmp_path, limits, R, verdict):
    """A flat is within R >= 10 m on one side only: its sign cannot be known."""
    recipe = ms.Recipe.parse(f'{RECIPE}{limits}\nU = "from fit"\n', name="r.toml")

    assert recipe.run(part(tmp_path / "part.h5", R, 1)).verdict == verdict


def test_limits_of_a_radius_on_both_sides_of_zero_are_refused(tmp_path):
    text = RECIPE + 'lower = "-1 m"\nupper = "1 m"\nU = "from fit"\n'
    recipe = ms.Recipe.parse(text, name="r.toml")

    with pytest.raises(RecipeError, match="judge the curvature c"):
        recipe.run(part(tmp_path / "part.h5", 100e-3, 1))


def test_both_ways_to_ask_for_the_uncertainty_of_the_fit_are_one(tmp_path):
    """U_from = "fit" needs no U, judges, and says on the page how U was found."""
    limits = 'lower = "90 mm"\nupper = "110 mm"\n'
    file = part(tmp_path / "part.h5", 100e-3, 3)
    found = []
    for key in ('U = "from fit"\n', 'U_from = "fit"\n'):
        (tmp_path / "r.toml").write_text(RECIPE + limits + key, encoding="utf-8")
        out = tmp_path / key.split()[0]
        assert command("run", tmp_path / "r.toml", file, "-o", out) == 0
        document = json.loads((out / "result.json").read_text())
        found.append(next(c for c in document["characteristics"] if c["metric"] == "R"))
    assert found[0] == found[1]
    assert (found[1]["verdict"], found[1]["u_source"]) == ("accept", "fit residual")
    page = render_html(document)
    assert f"k = {found[1]['k']:.2f}, coverage probability 95.45" in page.replace("\xa0", " ")


@pytest.mark.parametrize("key", ["k = 3.0", 'p = "99 %"'])
def test_a_factor_of_no_stated_uncertainty_is_refused(tmp_path, key):
    text = f'{RECIPE}upper = "200 mm"\nU_from = "fit"\n{key}\n'
    with pytest.raises(RecipeError, match=f"{key[0]} belongs to a stated U"):
        ms.Recipe.parse(text, name="r.toml")


@pytest.mark.parametrize(
    ("key", "says"),
    [
        ("k = 1.0", r"p = 95.45 % with k = 1.*68.27 % there; state p"),
        ('k = 2.0\np = "99 %"', r"p = 99.00 % with k = 2.*95.45 % there"),
        ("k = 3.0", "99.73 % of a normal distribution.*State p"),
        ('k = 1.0\np = "68.27 %"', None),
        ('k = 3.0\np = "99.73 %"', None),
        ("k = 2.0", None),
        ("k = 2.28", None),  # 10 degrees of freedom
    ],
)
def test_a_share_that_no_distribution_covers_is_refused(key, says):
    text = f'{RECIPE}upper = "200 mm"\nU = "1 um"\n{key}\n'
    if says is None:
        assert ms.Recipe.parse(text, name="r.toml")
        return
    with pytest.raises(RecipeError, match=says):
        ms.Recipe.parse(text, name="r.toml")


@pytest.mark.parametrize("origin", ["budget: b.toml", "certificate: PTB 4711", "stated"])
def test_an_origin_of_a_u_that_is_not_there_is_refused(origin):
    """The verdict would rest on the u of the fit, under the name of a certificate."""
    with pytest.raises(RecipeError, match="none is stated: write U"):
        ms.Recipe.parse(f'{RECIPE}upper = "200 mm"\nU_from = "{origin}"\n', name="r.toml")


def test_from_fit_belongs_to_fits(tmp_path):
    text = RECIPE.replace('"R"', '"residual.rms"') + 'upper = "1 um"\nU = "from fit"\n'
    recipe = ms.Recipe.parse(text, name="r.toml")

    with pytest.raises(RecipeError, match="state U"):
        recipe.run(part(tmp_path / "part.h5", 100e-3, 1))
