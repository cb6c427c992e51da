"""The polynomial of a joint separation is that of the estimate, with its covariance.

The readings are made here with numpy; what the covariance says is worked out from the numbers of
result.json with numpy alone, in powers of the position, where the package works in Legendre's.
"""

import json

import numpy as np
import pytest

from metrosep.cli.main import main
from metrosep.recipe import Recipe

pytestmark = pytest.mark.usefixtures("without_figures")  # no test here looks at one

UM = 1e-6
TILT = 20e-6
"""Of the artefact, rad; positive: the readings grow with x."""

OF_DRAWS = 4.0 / np.sqrt(2.0 * 4000)
"""A standard deviation of 4000 draws is known to this share, at four of its sigmas."""

MODES = 0.05
"""Share of u that is common to neighbours only and is left out of the draws below: a polynomial sees little of it."""

RECIPE = """metrosep = 1
[input]
x = { column = "x_mm", unit = "mm" }
z = { column = "z_um", unit = "um" }
feed = { column = "feed_mm_min", unit = "mm/min" }
run = "run"
[[step]]
op = "separate"
shortest = "6 mm"
start = "0 mm"
length = "40 mm"
[[step]]
op = "polynomial"
quantity = "error"
"""


def curved_um(x_mm):
    """Neither even nor odd about the middle, no line in it that matters: 0 ... 50 mm."""
    u = (x_mm - 20.0) / 20.0
    return 1.0 * u**3 + 0.4 * u**2


def write_runs(path, seed=1, tilt=TILT, samples=260, noise=0.05):
    """Two runs at each of three feeds with vibration of 11 Hz and noise; offsets of their own."""
    rng = np.random.default_rng(seed)
    rows = ["x_mm,z_um,feed_mm_min,run"]
    for number, feed in enumerate((1800, 1800, 3000, 3000, 4700, 4700)):
        x = np.linspace(0.0, 50.0, samples)
        t = x / (feed / 60.0)
        z = curved_um(x) + tilt * 1e3 * x + rng.normal(0.0, 3.0)
        z = (
            z
            + 0.1 * np.sin(2 * np.pi * 11.0 * t + rng.uniform(0, 7))
            + rng.normal(0, noise, x.size)
        )
        rows += [f"{a:.6f},{b:.6f},{feed},{number}" for a, b in zip(x, z, strict=True)]
    path.write_text("\n".join(rows) + "\n")
    return path


@pytest.fixture(scope="module")
def runs(tmp_path_factory):
    return write_runs(tmp_path_factory.mktemp("poly") / "runs.csv")


def of_recipe(runs, more="degree = 3\n", text=RECIPE):
    return Recipe.parse(text + more).run(runs).document


def drawn_powers(document, degree, draws=4000):
    """Powers of x in SI fitted by lstsq to draws of the stored curve, (degree + 1, draws)."""
    part = next(iter(document["estimate"]["directions"].values()))
    stored = part["covariance"]
    low, high = stored["travel_m"]
    nodes = np.linspace(low, high, len(stored["steps"]))
    modes = np.array(stored["steps"]) * np.array(stored["scale_m"])
    x = np.linspace(0.0, 40e-3, 801)
    at = np.array([np.interp(x, nodes, m) for m in modes.T]).T
    error = at @ np.random.default_rng(7).normal(size=(at.shape[1], draws))
    powers = np.vander(x / 40e-3, degree + 1, increasing=True)
    fitted = np.linalg.lstsq(powers, error, rcond=None)[0]
    return fitted / (40e-3 ** np.arange(degree + 1))[:, None]


def test_u_of_the_coefficients_is_that_of_draws_of_the_stored_estimate(runs):
    document = of_recipe(runs)
    fit = document["polynomial"]

    assert fit["covariance_from"] == "covariance of the estimate"
    expected = drawn_powers(document, 3).std(axis=1)
    np.testing.assert_allclose(fit["u_coefficients_si"], expected, rtol=OF_DRAWS + MODES)


def test_the_artefacts_tilt_is_not_in_the_polynomial_and_that_is_said(runs):
    document = of_recipe(runs)
    fit = document["polynomial"]

    x = np.linspace(0.0, 40.0, 4001)
    truth = curved_um(x)
    truth = (truth - np.polyval(np.polyfit(x, truth, 1), x)) * UM
    found = np.polyval(fit["coefficients_si"][::-1], x * 1e-3)
    assert np.abs(found - truth).max() < 4.0 * fit["u_greatest_m"] < 0.1 * UM
    assert fit["removed"] == "line"
    (said,) = [m for m in document["messages"] if "without its line" in m]
    assert "on_axis = true" in said


def test_along_the_axis_itself_the_slope_is_part_of_the_polynomial(runs):
    """With the sign of the tilt: readings that grow with x have a positive coefficient."""
    across = of_recipe(runs)["polynomial"]
    document = of_recipe(runs, "degree = 3\non_axis = true\n")
    along = document["polynomial"]

    x = np.linspace(0.0, 40.0, 4001)
    line = np.polyfit(x * 1e-3, curved_um(x) * UM, 1)[0]
    change = along["coefficients_si"][1] - across["coefficients_si"][1]
    slope = document["estimate"]["slope"]["value"]
    assert change == pytest.approx(slope, rel=1e-9, abs=0.0)
    u = document["estimate"]["slope"]["u"]
    assert slope == pytest.approx(TILT + line, abs=4.0 * u)
    wider = np.hypot(across["u_coefficients_si"][1], u)
    assert along["u_coefficients_si"][1] == pytest.approx(wider, rel=1e-6, abs=0.0)
    assert along["removed"] == "offset"
    assert not any("without its line" in m for m in document["messages"])


def test_a_table_of_the_axis_along_itself_says_that_the_slope_belongs_to_it(runs):
    table = (
        '[[output]]\nkind = "table"\ncontroller = "csv"\naxis = "X"\ncompensates = "X"\n'
        'spacing = "1 mm"\npath = "x.csv"\nmachine = { travel_low = "0 mm", travel_high = "40 mm" }\n'
    )
    assert of_recipe(runs, "degree = 3\n" + table)["polynomial"]["removed"] == "offset"
    across = table.replace('compensates = "X"', 'compensates = "Z"')
    assert of_recipe(runs, "degree = 3\n" + across)["polynomial"]["removed"] == "line"


def test_a_compensation_is_minus_the_error(runs):
    error = of_recipe(runs, "degree = 3\non_axis = true\n")["polynomial"]
    other = RECIPE.replace('"error"', '"compensation"')
    minus = of_recipe(runs, "degree = 3\non_axis = true\n", other)["polynomial"]

    np.testing.assert_array_equal(minus["coefficients_si"], -np.array(error["coefficients_si"]))
    np.testing.assert_array_equal(minus["u_coefficients_si"], error["u_coefficients_si"])


def test_the_command_line_gives_the_same_polynomial(runs, tmp_path, capsys):
    words = ["separate", runs, "--x", "x_mm", "--z", "z_um", "--feed", "feed_mm_min", "--run", "run",
             "--shortest", "6 mm", "--start", "0 mm", "--length", "40 mm", "--poly", "3",
             "-o", tmp_path / "out"]  # fmt: skip
    with pytest.raises(SystemExit) as stop:
        main([str(w) for w in words])
    assert stop.value.code == 0
    said = capsys.readouterr().err

    stored = json.loads((tmp_path / "out" / "result.json").read_text())["polynomial"]
    assert stored == of_recipe(runs)["polynomial"]
    assert "from the covariance of the estimate" in said
    assert "mean removed" not in said


@pytest.mark.parametrize("method", ["mean", "kono"])
def test_other_methods_fit_the_runs_as_before(runs, method):
    text = RECIPE.replace('op = "separate"', f'op = "separate"\nmethod = "{method}"')
    text = text.replace('shortest = "6 mm"\n', "")
    fit = of_recipe(runs, "degree = 3\n", text)["polynomial"]

    assert fit["covariance_from"] == "scatter of 6 runs"
    assert fit["removed"] == "offset"


def test_auto_takes_the_degree_that_the_error_has(runs, tmp_path):
    """A cubic: no term above is more than its uncertainty tells, and none below is enough."""
    sets = [runs, *(write_runs(tmp_path / f"{seed}.csv", seed=seed) for seed in (2, 3))]
    fits = [of_recipe(path, 'degree = "auto"\n')["polynomial"] for path in sets]

    # a needless term has q^2 > 2 v in one of six draws: one of five above a cubic in half of them
    assert all(fit["degree"] >= 3 for fit in fits)
    assert 3 <= np.median([fit["degree"] for fit in fits]) <= 5
    assert "Cp" in fits[0]["degree_chosen_by"]
    assert of_recipe(runs, 'degree = "f-test"\n')["polynomial"]["degree"] == 3
