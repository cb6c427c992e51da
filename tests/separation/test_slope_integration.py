"""Heights from slopes: rules in closed form, noise as random walk, real mirrors."""

import json
import math

import numpy as np
import pytest

from metrosep.core.errors import MetrosepError, NotUniformError, UnitError
from metrosep.separation.lines.slope_integration import integrate_slopes, slope_transfer

RULES = ("trapezoid", "simpson", "spline", "fourier", "feet")
STEP = 2e-3

MC_RTOL = 0.1
"""RMS of 500 trials of a random walk scatters by 3 %."""


def level(values, degree=1):
    t = np.linspace(-1.0, 1.0, values.size)
    return values - np.polyval(np.polyfit(t, values, degree), t)


@pytest.mark.parametrize("method", RULES)
def test_a_ramp_of_slope_is_a_parabola_the_right_way_up(method):
    """s = c x rises: the edge is hollow, its ends are high. A flipped sign shows."""
    x = STEP * np.arange(51)
    if method == "feet":
        z = 0.5 * np.append(x, x[-1] + STEP) ** 2 * 1e-4
        s = np.diff(z) / STEP
    else:
        z, s = 0.5 * x**2 * 1e-4, x * 1e-4

    result = integrate_slopes(s, x, method=method)

    np.testing.assert_allclose(result.height, level(z), rtol=0, atol=1e-9 * np.ptp(z))
    assert result.height[0] > 0 > result.height[25]


@pytest.mark.parametrize("method", ["simpson", "spline", "fourier"])
def test_cubic_slopes_are_exact(method):
    """Simpson's intermediate nodes are exact for parabolas of slope, the others for cubics."""
    x = np.linspace(0, 1, 41)
    power = 2 if method == "simpson" else 3
    result = integrate_slopes(0.1 * x**power, x, method=method)

    expected = level(0.1 * x ** (power + 1) / (power + 1))
    np.testing.assert_allclose(result.height, expected, rtol=0, atol=1e-12)


@pytest.mark.parametrize("method", RULES)
@pytest.mark.parametrize("samples", [40.0, 12.0, 5.0])
def test_transfer_is_what_integration_does(method, samples):
    """A long record of one wave: amplitude found over amplitude given, away from the ends."""
    n = 1200
    x = STEP * np.arange(n)
    k = 2 * np.pi / (samples * STEP)
    s = 1e-5 * np.cos(k * x)
    if method == "feet":
        s = 1e-5 * (np.sin(k * (x + STEP)) - np.sin(k * x)) / (k * STEP)

    found = integrate_slopes(s, x, method=method).height[:n]

    inside = slice(200, 1000)
    design = np.column_stack([np.sin(k * x), np.cos(k * x), np.ones(n), x])[inside]
    fit = np.linalg.lstsq(design, found[inside], rcond=None)[0]
    expected = slope_transfer([samples * STEP], STEP, method=method)[0]
    assert fit[0] / (1e-5 / k) == pytest.approx(expected, abs=3e-3)


def test_transfer_closed_forms():
    w = 2 * np.pi / 8.0
    found = {m: slope_transfer([8.0], 1.0, method=m)[0] for m in RULES}
    assert found["trapezoid"] == pytest.approx(w / 2 / math.tan(w / 2), abs=1e-14)
    even = w / 3 * (2 + math.cos(w)) / math.sin(w)
    odd = even * math.cos(w) + w * math.sin(w) / 2
    assert found["simpson"] == pytest.approx((even + odd) / 2, abs=1e-14)
    assert found["fourier"] == found["feet"] == 1.0
    averaged = slope_transfer([8.0], 1.0, method="fourier", aperture=3.0)[0]
    assert averaged == pytest.approx(math.sin(np.pi * 3 / 8) / (np.pi * 3 / 8), abs=1e-14)


@pytest.mark.parametrize("n", [20, 300])
def test_uncertainty_of_sums_has_its_closed_form(n):
    """Random walk without its line at N = n + 1 places: RMS^2 = s^2 h^2 (N^2 - 4)/(15 N)."""
    result = integrate_slopes(np.zeros(n), STEP * np.arange(n), method="feet", u_slope=1e-7)
    points = n + 1
    expected = (1e-7 * STEP) ** 2 * (points**2 - 4) / (15.0 * points)
    assert np.mean(result.u["height"] ** 2) == pytest.approx(expected, rel=1e-9, abs=0.0)


@pytest.mark.parametrize("zero_known", [False, True])
def test_long_records_have_the_same_uncertainty(monkeypatch, zero_known):
    """The closed form for long records against every slope tried alone."""
    x = np.cumsum(np.random.default_rng(9).uniform(0.5, 1.5, 120)) * STEP
    for method in ("trapezoid", "spline"):
        options = {"method": method, "u_slope": 1e-7, "zero_known": zero_known}
        unit = np.eye(120)
        alone = (
            np.sqrt(sum(integrate_slopes(0.1 * e, x, **options).height ** 2 for e in unit)) * 1e-6
        )
        monkeypatch.setattr("metrosep.separation.lines.slope_integration.LONG", 10)
        found = integrate_slopes(np.zeros(120), x, **options).u["height"]
        monkeypatch.undo()
        tolerance = 1e-9 if method == "trapezoid" else 0.1
        np.testing.assert_allclose(found, alone, rtol=tolerance, atol=0)


@pytest.mark.slow
def test_trapezoid_noise_grows_like_a_random_walk():
    """Known zero, mean removed: variance of the end-to-end height is s^2 h^2 (n - 3/2)."""
    rng = np.random.default_rng(2)
    n = 40
    ends = []
    for _ in range(1500):
        z = integrate_slopes(
            1e-7 * rng.standard_normal(n), STEP * np.arange(n), method="trapezoid", zero_known=True
        ).height
        ends.append(z[-1] - z[0])
    expected = 1e-7 * STEP * math.sqrt(n - 1.5)
    assert np.std(ends) == pytest.approx(expected, rel=0.05, abs=0.0)


@pytest.mark.parametrize("method", RULES)
def test_uncertainty_is_the_scatter(method):
    rng = np.random.default_rng(3)
    x = STEP * np.arange(50)
    results = [
        integrate_slopes(1e-7 * rng.standard_normal(50), x, method=method, u_slope=1e-7)
        for _ in range(500)
    ]
    scatter = np.std([r.height for r in results], axis=0, ddof=1)
    np.testing.assert_allclose(results[0].u["height"], scatter, rtol=2 * MC_RTOL, atol=0)


def test_repeats_show_the_noise_whatever_the_zero_does():
    rng = np.random.default_rng(4)
    x = STEP * np.arange(80)
    s = 1e-5 * np.sin(40 * x) + rng.normal(0, 1e-4, (12, 1)) + 2e-7 * rng.standard_normal((12, 80))

    result = integrate_slopes(s, x)

    assert result.noise.value == pytest.approx(2e-7, rel=0.1, abs=0.0)
    one = integrate_slopes(s[0], x, u_slope=result.noise.value)
    np.testing.assert_allclose(
        result.u["height"] * math.sqrt(12), one.u["height"], rtol=1e-9, atol=0
    )


def test_zero_of_the_sensor_is_a_line():
    x = STEP * np.arange(60)
    s = 1e-5 * np.cos(30 * x)

    free = integrate_slopes(s + 3e-5, x)
    np.testing.assert_allclose(free.height, integrate_slopes(s, x).height, rtol=0, atol=1e-18)
    assert free.null_space[0].indices == (0, 1)

    known = integrate_slopes(s + 3e-5, x, zero_known=True)
    assert known.null_space[0].indices == (0,)
    line = np.polyfit(x, known.height - free.height, 1)
    assert line[0] == pytest.approx(
        3e-5 + np.polyfit(x, 1e-5 * np.sin(30 * x) / 30, 1)[0], rel=1e-3, abs=0.0
    )


def test_unknown_noise_is_said_not_zero():
    result = integrate_slopes(np.zeros(9), np.arange(9.0))
    assert np.isnan(result.u["height"]).all()
    assert any("u_slope" in text for text in result.messages)


def test_a_gap_leaves_the_longest_piece():
    x = STEP * np.arange(60)
    s = 1e-5 * np.cos(30 * x)
    s[12] = np.nan

    result = integrate_slopes(s, x)

    assert np.isnan(result.height[:13]).all()
    np.testing.assert_allclose(
        result.height[13:], integrate_slopes(s[13:], x[13:]).height, rtol=0, atol=1e-18
    )
    assert next(i for i in result.null_space if i.kind == "samples").indices == tuple(range(13))
    assert np.isnan(s[12])


def test_uneven_positions():
    rng = np.random.default_rng(5)
    x = np.cumsum(rng.uniform(0.5, 1.5, 300)) * STEP
    k = 2 * np.pi / (30 * STEP)
    expected = level_over(x, 1e-5 * np.sin(k * x) / k)
    for method, share in (("trapezoid", 0.02), ("spline", 1e-3)):
        found = integrate_slopes(1e-5 * np.cos(k * x), x, method=method).height
        assert np.std(found - expected) < share * np.std(expected)
    with pytest.raises(NotUniformError, match="equal steps"):
        integrate_slopes(np.zeros(300), x, method="simpson")


def level_over(x, z):
    return z - np.polyval(np.polyfit(x, z, 1), x)


@pytest.mark.parametrize(
    ("slope", "x", "options", "words"),
    [
        (np.zeros(9), np.arange(9.0), {"method": "euler"}, "no method"),
        (np.zeros(9), np.arange(8.0), {}, "position"),
        (np.zeros(9), -np.arange(9.0), {}, "rise"),
        (np.zeros(3), np.arange(3.0), {}, "4 slopes"),
        (np.full(9, np.nan), np.arange(9.0), {}, "4 slopes"),
        (np.full(9, np.inf), np.arange(9.0), {}, "infinite"),
        (["a"] * 9, np.arange(9.0), {}, "numbers"),
        (np.zeros(9), np.arange(9.0), {"u_slope": -1.0}, "u_slope"),
        (np.zeros((2, 3, 9)), np.arange(9.0), {}, "shape"),
    ],
)
def test_bad_input_is_refused_in_words(slope, x, options, words):
    with pytest.raises(MetrosepError, match=words):
        integrate_slopes(slope, x, **options)


def test_microradians_are_noticed():
    with pytest.raises(UnitError, match="urad"):
        integrate_slopes(30.0 * np.sin(np.arange(50.0)), np.arange(50.0))


@pytest.mark.parametrize(("wavelength", "step"), [(1.0, 1.0), (8.0, 0.0), (np.nan, 1.0)])
def test_waves_that_are_not_sampled_are_refused(wavelength, step):
    with pytest.raises(MetrosepError):
        slope_transfer([wavelength], step)


def test_real_mirror_heights_come_back_from_their_slopes(corpus):
    """DABAM 10: heights of a real mirror, differentiated with feet and by central differences."""
    entry = next(
        (
            p
            for p in sorted((corpus / "dabam").glob("*.txt"))
            if json.loads(p.read_text())["FILE_FORMAT"] == 2
        ),
        None,
    )
    if entry is None:
        pytest.skip("no height entry in the corpus")
    z, x = columns(entry)
    step = np.mean(np.diff(x))
    feet = integrate_slopes(np.diff(z) / step, x[:-1], method="feet").height
    np.testing.assert_allclose(feet, level(z), rtol=0, atol=1e-6 * np.ptp(z))


def test_rules_agree_on_real_slopes_within_their_transfer(corpus):
    """DABAM slopes: rules differ by less than the spectrum above their 1 % wavelength explains."""
    for entry in sorted((corpus / "dabam").glob("*.txt")):
        if json.loads(entry.read_text())["FILE_FORMAT"] != 1:
            continue
        s, x = columns(entry)
        uniform = np.ptp(np.diff(x)) < 1e-3 * np.mean(np.diff(x))
        trapezoid, spline = (
            integrate_slopes(s, x, method=m, u_slope=1e-7) for m in ("trapezoid", "spline")
        )
        rest = np.std(trapezoid.height - spline.height)
        assert rest < 0.02 * np.std(spline.height), entry.name
        # independent bound: trapezoid error is h^2 s''/12 summed, at most the range of h^2 s'/12
        bound = np.ptp(np.gradient(s, x)) * np.mean(np.diff(x)) ** 2 / 12.0
        assert rest < bound, entry.name
        if uniform:
            fourier = integrate_slopes(s, x, method="fourier")
            assert np.std(fourier.height - spline.height) < bound, entry.name


def columns(entry):
    """Columns of a DABAM entry in SI, read here without the library."""
    header = json.loads(entry.read_text())
    rows = np.loadtxt(entry.with_suffix(".dat"), skiprows=header["FILE_HEADER_LINES"])
    x, y = rows[:, 0] * header["X1_FACTOR"], rows[:, 1] * header["Y1_FACTOR"]
    order = np.argsort(x)
    keep = np.concatenate([[True], np.diff(x[order]) > 0])
    return y[order][keep], x[order][keep]


def test_masked_slopes_are_not_measured():
    s = np.sin(np.arange(30.0)) * 1e-6
    s[20] = 0.3
    masked = integrate_slopes(np.ma.masked_greater(s, 0.1), np.arange(30.0))
    s[20] = np.nan
    np.testing.assert_array_equal(masked.height, integrate_slopes(s, np.arange(30.0)).height)


def test_names_and_types_of_options():
    s, x = 1e-6 * np.sin(np.arange(30.0)), np.arange(30.0)
    assert integrate_slopes(s, x, method="Spline").audit["method"] == "spline"
    assert slope_transfer([9.0], 1.0, method="Spline") == slope_transfer([9.0], 1.0)
    for given in ({"method": None}, {"u_slope": "1"}):
        with pytest.raises(MetrosepError):
            integrate_slopes(s, x, **given)
    with pytest.raises(MetrosepError, match="step"):
        slope_transfer([9.0], None)
