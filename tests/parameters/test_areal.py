"""Areal parameters against the closed forms of the sine grid and of known distributions."""

import math
from fractions import Fraction

import numpy as np
import pytest

from metrosep import Profile, Surface
from metrosep.core.errors import DataError, InvalidSamplesError
from metrosep.core.provenance import Step
from metrosep.parameters.areal import (
    areal_parameters,
    is_form_removed,
)
from metrosep.parameters.areal_heights import height_statistics
from metrosep.parameters.autocorrelation import autocorrelation, texture_direction
from metrosep.parameters.material_ratio import abbott_curve

UM, NM = 1e-6, 1e-9
EXACT = 1e-12
"""Sums of a quarter of a million terms in double precision."""
PRINTED = 1e-9
"""References with ten digits."""
ZERO = 1e-9
"""Skewness that is zero by symmetry."""
STATED = 1e-6
"""References of row A12, seven digits."""
SLOPE, AREA = 2e-3, 3e-3
"""Rows A04 and A05."""
CORE = 5e-3
"""Row A07: core line of a sampled distribution."""
STEPS = 1e-4
"""The curve of n samples stands half a sample off the continuous one."""

HEIGHTS = ["Sq", "Ssk", "Sku", "Sp", "Sv", "Sz", "Sa"]
RATIOS = {"Ssk", "Sku", "Str", "Std", "Sdq", "Sdr", "Smrk1", "Smrk2"}


def sine_grid(amplitude=0.05 * UM, n=500, step=UM):
    c = amplitude * np.cos(2 * np.pi * np.arange(n) * step / (100 * UM))
    return Surface(c[:, None] + c[None, :], step, step)


def exact_sq_ku(integers):
    """Return Sq^2, the third and the fourth central moment of integers, as fractions."""
    values = [Fraction(int(v)) for v in integers.ravel()]
    mean = sum(values) / len(values)
    return [sum((v - mean) ** p for v in values) / len(values) for p in (2, 3, 4)]


def random_map(rng, shape=(90, 120)):
    from scipy.ndimage import gaussian_filter

    z = gaussian_filter(rng.normal(size=shape), (2.0, 4.0))
    return Surface((np.exp(2 * z) - 1) * 100 * NM, 2 * UM, 3 * UM)


def same(a, b, factors=None, rel=1e-9):
    assert set(a) == set(b)
    for symbol, quantity in a.items():
        factor = 1.0 if factors is None else factors(symbol)
        assert b[symbol].value == pytest.approx(quantity.value * factor, rel=rel, abs=0.0), symbol


def test_heights_of_the_sine_grid():
    table = areal_parameters(sine_grid(), names=HEIGHTS)
    assert list(table) == HEIGHTS
    assert table["Sa"].value == pytest.approx(40.52180942 * NM, rel=1e-8, abs=0.0)
    assert table["Sq"].value == pytest.approx(50 * NM, rel=PRINTED, abs=0.0)
    assert table["Sz"].value == pytest.approx(200 * NM, rel=PRINTED, abs=0.0)
    assert table["Ssk"].value == pytest.approx(0.0, abs=ZERO)
    assert table["Sku"].value == pytest.approx(2.25, abs=ZERO)
    assert table["Sp"].unit == "m"


def test_slopes_core_and_correlation_of_the_sine_grid():
    deep = areal_parameters(sine_grid(10 * UM), names=["Sdq", "Sdr"])
    assert deep["Sdq"].value == pytest.approx(0.6283185, rel=SLOPE, abs=0.0)
    assert deep["Sdr"].value == pytest.approx(0.1780102, rel=AREA, abs=0.0)
    table = areal_parameters(sine_grid())
    assert table["Sk"].value == pytest.approx(2.393377 * 50 * NM, rel=CORE, abs=0.0)
    assert table["Smr1"].value == pytest.approx(0.14344, rel=CORE, abs=0.0)
    assert table["Smr2"].value == pytest.approx(0.85656, rel=CORE, abs=0.0)
    assert table["Sal"].value == pytest.approx(30.823 * UM, rel=5e-2, abs=0.0)
    assert table["Str"].value == pytest.approx(0.87462, rel=3e-2, abs=0.0)
    assert table["S10z"].value == pytest.approx(200 * NM, rel=PRINTED, abs=0.0)
    assert table["Spc"].value == pytest.approx(
        50 * NM * (2 * math.pi / (100 * UM)) ** 2, rel=1e-3, abs=0.0
    )
    # Peaks at 100, 200, 300, 400 um in x and in y; those at the edge are not known to be peaks.
    assert table["Spd"].value == pytest.approx(16 / (500 * UM) ** 2, rel=EXACT, abs=0.0)
    assert "crossed or isotropic" in table.unavailable["Std"]


def test_sine_grid_with_a_hole():
    surface = sine_grid()
    z = np.array(surface.z)
    z[100:150, 200:300] = np.nan
    table = areal_parameters(Surface(z, UM, UM))
    assert table["Sq"].value == pytest.approx(49.9999958 * NM, rel=STATED, abs=0.0)
    assert table["Sa"].value == pytest.approx(40.5222053 * NM, rel=STATED, abs=0.0)
    assert table["Sz"].value == pytest.approx(200 * NM, rel=STATED, abs=0.0)
    assert (table.context.n_valid, table.context.n_total) == (245_000, 250_000)
    assert table["Sdr"].value == pytest.approx(4.934787e-6, rel=AREA, abs=0.0)
    off = table["Sdq"].value / (math.pi * 1e-3) - 1
    assert off == pytest.approx(-2e-8, abs=5e-9)  # as sdq.md prints it


def test_moments_of_integers_are_exact(rng):
    k = rng.integers(-40, 90, size=(40, 50))
    second, third, fourth = (float(m) for m in exact_sq_ku(k))
    s = height_statistics(k)
    assert s.Sq**2 == pytest.approx(second, rel=EXACT, abs=0.0)
    assert s.Ssk == pytest.approx(third / second**1.5, rel=EXACT, abs=0.0)
    assert s.Sku == pytest.approx(fourth / second**2, rel=EXACT, abs=0.0)
    assert s.Sa == pytest.approx(np.abs(k - k.mean()).mean(), rel=EXACT, abs=0.0)
    assert s.Sp + s.Sv == pytest.approx(s.Sz, rel=EXACT, abs=0.0)


def test_nanometres_on_an_offset_of_a_million_metres(rng):
    # Multiples of 2^-30 m are exact at 10^6 m, so nothing may be lost.
    k = rng.integers(-40, 90, size=(300, 300)) * 2.0**-30
    k[5:9, 7] = np.nan
    near, far = height_statistics(k), height_statistics(k + 1e6)
    for name in HEIGHTS:
        assert getattr(far, name) == pytest.approx(getattr(near, name), rel=EXACT, abs=0.0), name


def test_blocks_and_holes_give_the_numbers_of_the_plain_formulas(rng):
    z = rng.gamma(2.0, size=(300, 400))
    z[rng.random(z.shape) < 0.05] = np.nan
    s = height_statistics(z)
    d = z[~np.isnan(z)] - z[~np.isnan(z)].mean()
    assert s.n_valid == d.size
    assert s.Sq == pytest.approx(d.std(), rel=EXACT, abs=0.0)
    assert s.Ssk == pytest.approx((d**3).mean() / d.std() ** 3, rel=1e-10, abs=0.0)
    assert s.Sku == pytest.approx((d**4).mean() / d.std() ** 4, rel=1e-10, abs=0.0)
    assert s.Sp == pytest.approx(d.max(), rel=EXACT, abs=0.0)
    assert s.Sv == pytest.approx(-d.min(), rel=EXACT, abs=0.0)


def test_volumes_of_a_uniform_distribution():
    # Heights 0 to 1: Smc(q) = 1 - q, so Vm(p) = p^2 / 2 and Vv(p) = (1 - p)^2 / 2.
    curve = abbott_curve((np.arange(100_000) + 0.5) / 100_000)
    for p in (0.0, 0.1, 0.37, 0.8, 1.0):
        assert curve.material_volume(p) == pytest.approx(p**2 / 2, abs=STEPS)
        assert curve.void_volume(p) == pytest.approx((1 - p) ** 2 / 2, abs=STEPS)
        assert curve.void_volume(p) - curve.material_volume(p) == pytest.approx(
            curve.height(p) - 0.5, abs=EXACT
        )
    surface = Surface(((np.arange(100_000) + 0.5) / 100_000).reshape(250, 400), UM, UM)
    v = areal_parameters(surface, names=["Vmp", "Vmc", "Vvc", "Vvv"])
    assert [q.value for q in v.values()] == pytest.approx([0.005, 0.315, 0.385, 0.02], abs=STEPS)
    with pytest.raises(DataError, match="fraction"):
        curve.material_volume(10.0)


def test_volumes_and_extreme_height_of_gaussian_heights():
    # Normal scores: Smc(p) = quantile; Vm(p) = phi(c) - c p for standard normal heights.
    from scipy.stats import norm

    n = 400 * 500
    z = norm.isf((np.arange(n) + 0.5) / n).reshape(400, 500) * UM
    table = areal_parameters(Surface(z), names=["Vmp", "Vmc", "Vvc", "Vvv", "Sxp", "Sku", "Sa"])

    def vm(p):
        return norm.pdf(norm.isf(p)) - norm.isf(p) * p

    def vv(p):
        return vm(p) + norm.isf(p)

    expected = [vm(0.1), vm(0.8) - vm(0.1), vv(0.1) - vv(0.8), vv(0.8)]
    found = [table[s].value / UM for s in ("Vmp", "Vmc", "Vvc", "Vvv")]
    assert found == pytest.approx(expected, abs=STEPS)
    assert table["Sxp"].value == pytest.approx(norm.isf(0.025) * UM, rel=STEPS, abs=0.0)
    assert table["Sa"].value == pytest.approx(math.sqrt(2 / math.pi) * UM, rel=STEPS, abs=0.0)
    assert table["Sku"].value == pytest.approx(3.0, rel=1e-3, abs=0.0)


def test_five_segment_distribution_has_its_core():
    m = (np.arange(20_000) + 0.5) / 20_000
    z = np.interp(m, [0, 0.1, 0.8, 1], [2.8, 0.8, -0.6, -3.6]).reshape(100, 200) * UM
    for line in ("lsq", "secant"):
        t = areal_parameters(Surface(z), names=["Sk", "Spk", "Svk", "Smr1", "Smr2"], line=line)
        found = [t[s].value for s in ("Sk", "Spk", "Svk", "Smr1", "Smr2")]
        expected = [2.0 * UM, 1.8 * UM, 2.6 * UM, 0.09, 0.826667]
        assert found == pytest.approx(expected, rel=CORE, abs=0.0)
        assert t.context.settings["line"] == line


@pytest.mark.parametrize("unit", [1e-6, 1e3])
def test_scaling_heights_and_steps_together_is_a_change_of_unit(rng, unit):
    a = random_map(rng)
    b = Surface(a.z * unit, a.dx * unit, a.dy * unit)

    def factor(symbol):
        if symbol in RATIOS:
            return 1.0
        powers = {
            "Spd": -2,
            "Svd": -2,
            "Spc": -1,
            "Svc": -1,
            "Sha": 2,
            "Sda": 2,
            "Shv": 3,
            "Sdv": 3,
        }
        return unit ** powers.get(symbol, 1)

    same(areal_parameters(a), areal_parameters(b), factor, rel=1e-6)


def test_flip_exchanges_peaks_and_pits(rng):
    a = random_map(rng)
    up, down = areal_parameters(a), areal_parameters(Surface(-a.z, a.dx, a.dy))
    for one, other in (("Sp", "Sv"), ("Sv", "Sp"), ("S5p", "S5v"), ("S5v", "S5p"), ("Spk", "Svk")):
        assert down[one].value == pytest.approx(up[other].value, rel=1e-9, abs=0.0)
    assert up["Ssk"].value > 0.2
    assert down["Ssk"].value == pytest.approx(-up["Ssk"].value, rel=1e-9, abs=0.0)
    assert down["Smr1"].value == pytest.approx(1 - up["Smr2"].value, rel=1e-3, abs=0.0)
    for symbol in ("Sa", "Sq", "Sz", "Sku", "Sdq", "Sdr", "Sal", "Str", "Std", "Sk", "S10z"):
        assert down[symbol].value == pytest.approx(up[symbol].value, rel=1e-6, abs=0.0), symbol


def test_transposing_with_the_steps_changes_only_the_direction(rng):
    a = random_map(rng)
    straight, turned = areal_parameters(a), areal_parameters(Surface(a.z.T, a.dy, a.dx))
    for symbol in set(straight) - {"Std"}:
        assert turned[symbol].value == pytest.approx(straight[symbol].value, rel=1e-6, abs=0.0), (
            symbol
        )
    total = straight["Std"].value + turned["Std"].value
    assert math.remainder(total - math.pi / 2, math.pi) == pytest.approx(0.0, abs=1e-6)


def test_offset_and_nan_rows_change_nothing(rng):
    a = random_map(rng)
    z = np.full((99, 120), np.nan)
    z[4:94] = a.z + 1e-3
    same(areal_parameters(a), areal_parameters(Surface(z, a.dx, a.dy)), rel=1e-6)


def test_without_lateral_steps_the_heights_still_come(rng):
    z = random_map(rng).z
    table = areal_parameters(Surface(z, dx=UM))
    lateral = {"Sal", "Str", "Std", "Ssw", "Sdq", "Sdr", "Spd", "Spc", "Svd", "Svc"}
    lateral |= {"Sha", "Sda", "Shv", "Sdv"}
    one_process = {"Spq", "Svq", "Smq"}
    assert set(table.unavailable) - one_process == lateral
    assert "dy is not calibrated" in table.unavailable["Sdr"]
    assert {"Sq", "Sk", "Vvv", "Sxp", "S10z"} <= set(table)
    with pytest.raises(DataError, match="Sal cannot be given"):
        table["Sal"]


def test_constant_and_single_pixel_maps():
    for z in (np.full((12, 12), 0.1), [[3]]):
        table = areal_parameters(Surface(z, UM, UM))
        assert [table[s].value for s in ("Sa", "Sq", "Sp", "Sv", "Sz")] == [0.0] * 5
        assert {"Ssk", "Sku", "Sk", "Str", "S10z"} <= set(table.unavailable)


def test_only_what_is_asked_is_computed_and_names_are_checked(monkeypatch):
    from metrosep.parameters import areal

    def never(*_):
        raise AssertionError("not asked for")

    monkeypatch.setattr(areal, "abbott_curve", never)
    monkeypatch.setattr(areal, "autocorrelation", never)
    monkeypatch.setattr(areal, "peaks_of", never)
    assert list(areal_parameters(sine_grid(n=50), names=("Sdq", "Sa"))) == ["Sa", "Sdq"]
    with pytest.raises(DataError, match=r"Ra \(nearest: Sa.*not offered as an areal parameter"):
        areal_parameters(sine_grid(n=50), names=["Sa", "Ra"])
    with pytest.raises(DataError, match="sequence"):
        areal_parameters(sine_grid(n=50), names="Sa")
    with pytest.raises(DataError, match="line is"):
        areal_parameters(sine_grid(n=50), line="chord")
    with pytest.raises(DataError, match="pruning"):
        areal_parameters(sine_grid(n=50), pruning=5)


def test_bad_heights_are_named():
    with pytest.raises(InvalidSamplesError, match="none of the 6 pixels"):
        areal_parameters(Surface(np.full((2, 3), np.nan)))
    with pytest.raises(InvalidSamplesError, match="infinite"):
        height_statistics([[1.0, np.inf], [-np.inf, 0.0]])
    with pytest.raises(InvalidSamplesError, match="dimension"):
        height_statistics([1.0, 2.0])


def test_note_until_a_form_was_removed():
    z = sine_grid(n=50).z
    raw = areal_parameters(Surface(z), names=["Sq"])
    assert "No form removal" in raw.context.notes[0]
    step = Step("fit plane", {"removed": "piston, tilt_x, tilt_y"})
    assert areal_parameters(Surface(z, history=(step,)), names=["Sq"]).context.notes == ()
    assert is_form_removed((Step("gaussian", {"band": "short"}),))
    assert not is_form_removed((Step("read"), Step("gaussian", {"band": "long"})))


def test_sine_grid_on_a_tilt_after_the_plane():
    from metrosep.forms.conic import Plane
    from metrosep.forms.fit import fit

    y, x = np.mgrid[:500, :500] * UM
    tilted = Surface(sine_grid().z + 2e-4 * x + 1e-4 * y + 3 * UM, UM, UM)
    assert areal_parameters(tilted, names=["Sq"])["Sq"].value == pytest.approx(
        59.386 * NM, rel=1e-5, abs=0.0
    )
    residual = fit(tilted, Plane()).residual
    table = areal_parameters(residual, names=["Sq"])
    assert table["Sq"].value == pytest.approx(49.9994 * NM, rel=1e-5, abs=0.0)
    assert table.context.notes == ()


def test_a_map_that_is_mostly_empty():
    # Whole blocks of pixels are NaN; no warning may come out of them.
    z = np.full((500, 400), np.nan)
    z[250:270, 100:120] = sine_grid(n=20).z
    inner, whole = (height_statistics(m) for m in (z[250:270, 100:120], z))
    assert whole.n_valid == 400
    for name in HEIGHTS:
        assert getattr(whole, name) == pytest.approx(getattr(inner, name), rel=EXACT, abs=0.0), (
            name
        )


OLD = "ISO 25178-2:2012"


@pytest.mark.parametrize(("old", "new"), [("Smr1", "Smrk1"), ("Smr2", "Smrk2")])
@pytest.mark.parametrize("edition", ["ISO 25178-2:2021", OLD])
def test_symbols_of_the_other_edition_are_found(rng, old, new, edition):
    surface = Surface(rng.normal(size=(60, 60)) * NM, UM, UM)
    own = old if edition == OLD else new
    table = areal_parameters(surface, edition=edition)

    assert table.context.edition == edition
    assert own in list(table)
    assert old in table
    assert new in table
    assert table[new] is table[old]
    for asked in (old, new):
        one = areal_parameters(surface, names=[asked], edition=edition)
        assert list(one) == [own]
        assert one[asked].value == table[own].value
        assert "line" in one.context.settings
        assert table.with_uncertainties({asked: 0.01})[own].u == 0.01


def test_2012_has_no_symbol_of_2021_and_the_same_values(rng):
    surface = Surface(rng.normal(size=(60, 60)) * NM, UM, UM)
    new, old = areal_parameters(surface), areal_parameters(surface, edition=OLD)
    gone = set(new) - set(old)
    assert gone == {"Ssw", "Svd", "Svc", "Sak1", "Sak2", "Spkx", "Svkx", "Smrk1", "Smrk2"}
    assert all(old[s].value == new[s].value for s in set(old) - {"Std"})
    with pytest.raises(DataError, match=r"Svd .*an areal parameter of ISO 25178-2:2012"):
        areal_parameters(surface, names=["Svd"], edition=OLD)
    with pytest.raises(DataError, match="edition is"):
        areal_parameters(surface, edition="ISO 4287:1997")


def test_direction_of_amplitudes_and_of_powers():
    """Seven waves of 0.33 along y have more amplitude, one of 1 along x has more power."""
    y, x = np.mgrid[:400, :400] * 2 * np.pi
    more = sum(np.cos(y / n + n) for n in (8, 9, 10, 11.5, 13, 15, 18))
    z = np.cos(x / 14) + 0.33 * more
    surface = Surface(z * NM, UM, UM)
    amplitude = texture_direction(autocorrelation(surface.z, UM, UM), of="amplitude")
    power = areal_parameters(surface, names=["Std"])["Std"].value
    degree = np.pi / 180
    assert amplitude == pytest.approx(np.pi / 2, abs=degree)
    assert min(power, np.pi - power) < degree


def test_alias_of_what_cannot_be_given_says_why():
    with pytest.raises(DataError, match="Smrk1 cannot be given"):
        areal_parameters(Surface(np.zeros((9, 9)), UM, UM))["Smr1"]
    with pytest.raises(KeyError, match="Smrk3"):
        areal_parameters(Surface(np.eye(9), UM, UM))["Smrk3"]


@pytest.mark.parametrize("obj", [Profile(np.arange(9.0), np.zeros(9)), np.zeros((9, 9)), None])
def test_what_is_no_surface_is_refused(obj):
    with pytest.raises(DataError, match=f"needs a Surface, got {type(obj).__name__}"):
        areal_parameters(obj)


@pytest.mark.parametrize(
    "options", [{"names": [1]}, {"names": 1}, {"pruning": "a"}, {"pruning": None}]
)
def test_options_of_the_wrong_type_are_refused(options):
    with pytest.raises(DataError, match=next(iter(options))):
        areal_parameters(Surface(np.eye(9), UM, UM), **options)


@pytest.mark.parametrize("gap", [False, True])
@pytest.mark.parametrize("size", [1e-207, 1e-100, 1e100, 1e153, 1e300])
def test_heights_beyond_any_instrument_are_refused(rng, size, gap):
    z = rng.normal(size=(60, 60))
    if gap:
        z[5] = np.nan
    with pytest.raises(DataError, match=r"range of the heights|heights reach"):
        areal_parameters(Surface(z * size, UM, UM))


@pytest.mark.parametrize("size", [1e-50, 1e50])
def test_heights_within_the_limits_are_taken(rng, size):
    z = rng.normal(size=(60, 60))
    one = areal_parameters(Surface(z, UM, UM), names=["Sku", "Sq"])
    other = areal_parameters(Surface(z * size, UM, UM), names=["Sku", "Sq"])

    assert other["Sku"].value == pytest.approx(one["Sku"].value, rel=1e-9, abs=0.0)
    assert other["Sq"].value == pytest.approx(size * one["Sq"].value, rel=1e-9, abs=0.0)
