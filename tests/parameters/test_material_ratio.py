"""Abbott curve and core height: closed forms, invariances, refusals."""

import numpy as np
import pytest

from metrosep.core.errors import (
    DataError,
    DegenerateFitError,
    InvalidSamplesError,
    TooFewSamplesError,
)
from metrosep.parameters.material_ratio import (
    abbott_curve,
    core_height,
    material_height,
    material_ratio,
)

CLOSED = 5e-3  # relative; acceptance row P06
COUNT = 1.01  # samples; a ratio is a count of samples, the closed form a real number
ROUNDING = 1e-9  # relative; two orders of summation


@pytest.fixture
def polygon():
    """G5: core 1 - 2m from 10 % to 80 %, triangles above and below; 20 000 heights, falling."""
    m = (np.arange(20_000) + 0.5) / 20_000
    return np.interp(m, [0, 0.1, 0.8, 1], [2.8, 0.8, -0.6, -3.6]) * 1e-6


@pytest.fixture
def rough(rng):
    return np.exp(0.4 * rng.standard_normal(4000)) * 1e-6


@pytest.mark.parametrize("line", ["lsq", "secant"])
def test_core_of_a_piecewise_linear_curve_is_closed(polygon, rng, line):
    core = core_height(abbott_curve(rng.permutation(polygon)).heights, line=line)

    assert core.k == pytest.approx(2e-6, rel=CLOSED, abs=0.0)
    assert core.pk == pytest.approx(1.8e-6, rel=CLOSED, abs=0.0)
    assert core.vk == pytest.approx(2.6e-6, rel=CLOSED, abs=0.0)
    assert core.mr1 == pytest.approx(0.09, abs=COUNT / polygon.size)
    assert core.mr2 == pytest.approx(0.826667, abs=COUNT / polygon.size)
    assert core.pkx == pytest.approx(1.8e-6, rel=CLOSED, abs=0.0)
    assert core.vkx == pytest.approx(2.6e-6, rel=CLOSED, abs=0.0)
    assert core.a1 == pytest.approx(0.09 * 1.8e-6 / 2, rel=CLOSED, abs=0.0)
    assert core.a2 == pytest.approx((1 - 0.826667) * 2.6e-6 / 2, rel=CLOSED, abs=0.0)


def test_lines_differ_where_the_window_is_curved():
    m = (np.arange(20_000) + 0.5) / 20_000
    falling = -((m - 0.5) ** 3) * 1e-6  # window 0.3 to 0.7

    secant, lsq = core_height(falling, line="secant"), core_height(falling, line="lsq")

    assert secant.k == pytest.approx(0.2**2 * 1e-6, rel=CLOSED, abs=0.0)  # h^2
    assert lsq.k == pytest.approx(0.6 * 0.2**2 * 1e-6, rel=CLOSED, abs=0.0)  # 3/5 h^2
    assert secant.start == pytest.approx(0.3, abs=0.002)


def test_first_of_equal_windows_counts():
    sine = np.sort(np.cos(2 * np.pi * (np.arange(20_000) + 0.5) / 20_000))[::-1]

    core = core_height(sine, line="secant")

    assert core.start == pytest.approx(0.0, abs=COUNT / 20_000)  # not 60 to 100 %
    assert core.k == pytest.approx((1 - np.cos(0.4 * np.pi)) / 0.4, rel=CLOSED, abs=0.0)
    assert core.mr2 < 1.0


def test_window_is_forty_percent_where_samples_do_not_divide():
    core = core_height(np.arange(33.0)[::-1], line="secant")

    assert core.k == pytest.approx(33.0, rel=ROUNDING, abs=0.0)  # slope 1 per sample, 33 samples
    assert core.upper == pytest.approx(
        32.5, rel=ROUNDING, abs=0.0
    )  # half a sample above the highest
    assert core.lower == pytest.approx(-0.5, rel=ROUNDING, abs=0.0)
    assert core_height(np.arange(33.0)[::-1]).k == pytest.approx(33.0, rel=ROUNDING, abs=0.0)


def test_plateau_has_no_core_height_but_peaks():
    step = np.concatenate([np.ones(100), np.zeros(900)])

    core = core_height(step)

    assert core.k == pytest.approx(0.0, abs=1e-12)
    assert core.mr1 == pytest.approx(0.1, rel=1e-9, abs=0.0)
    assert core.pk == pytest.approx(
        2.0, rel=1e-9, abs=0.0
    )  # triangle with the area of the rectangle
    assert (core.mr2, core.vk, core.a2) == (1.0, 0.0, 0.0)


@pytest.mark.parametrize("line", ["lsq", "secant"])
@pytest.mark.parametrize("scale", [1e-9, 1e-3, 1.0, 1e6])
def test_unit_does_not_matter(rough, scale, line):
    one = core_height(abbott_curve(rough).heights, line=line)
    other = core_height(abbott_curve(rough * scale).heights, line=line)

    for name in ("k", "pk", "vk", "pkx", "vkx", "a1", "a2"):
        assert getattr(other, name) == pytest.approx(
            scale * getattr(one, name), rel=ROUNDING, abs=0.0
        )
    assert (other.mr1, other.mr2) == (one.mr1, one.mr2)


def test_shift_moves_the_line_only(rough):
    one = core_height(abbott_curve(rough).heights)
    other = core_height(abbott_curve(rough + 5e-6).heights)

    assert other.k == pytest.approx(one.k, rel=ROUNDING, abs=0.0)
    assert other.upper == pytest.approx(one.upper + 5e-6, rel=ROUNDING, abs=0.0)
    assert other.mr1 == one.mr1


def test_flip_swaps_peaks_and_valleys(rough):
    one = core_height(abbott_curve(rough).heights)
    other = core_height(abbott_curve(-rough).heights)

    assert other.k == pytest.approx(one.k, rel=ROUNDING, abs=0.0)
    assert other.pk == pytest.approx(one.vk, rel=ROUNDING, abs=0.0)
    assert other.vk == pytest.approx(one.pk, rel=ROUNDING, abs=0.0)
    assert other.mr1 == pytest.approx(1 - one.mr2, abs=ROUNDING)


def test_missing_heights_do_not_count(rough):
    holed = np.insert(rough, [3, 100, 4000], np.nan)

    assert np.array_equal(abbott_curve(holed).heights, abbott_curve(rough).heights)


def test_input_is_not_changed(rough):
    before = rough.copy()

    core_height(abbott_curve(rough).heights)

    assert np.array_equal(rough, before)


def test_ratio_counts_samples_at_or_above():
    z = [0.0, 1.0, 2.0, 3.0]

    assert material_ratio(z, 2.0) == 0.5
    assert material_ratio(z, 2.0 + 1e-9) == 0.25
    assert material_ratio(z, 0.5, reference="peak") == 0.25
    assert material_ratio(z, -1.0) == 1.0
    assert material_ratio(z, 4.0) == 0.0
    assert abbott_curve(z).ratios.tolist() == [0.25, 0.5, 0.75, 1.0]


@pytest.mark.parametrize("unit", [1e-9, 1e-6, 1e-3, 1.0])
def test_a_level_that_is_a_sample_counts_in_every_unit(unit):
    z = np.arange(10) * unit

    assert [material_ratio(z, k * unit, reference="peak") for k in range(10)] == [
        pytest.approx((k + 1) / 10, rel=1e-9, abs=0.0) for k in range(10)
    ]


def test_height_is_the_inverse_of_ratio(rough):
    curve = abbott_curve(rough)

    for p in (0.02, 0.25, 0.5, 0.9, 0.999):
        assert curve.ratio(curve.height(p)) == pytest.approx(p, abs=COUNT / rough.size)
    assert curve.height(0.0) == rough.max()
    assert curve.height(1.0) == rough.min()


def test_height_difference_of_a_line():
    z = np.linspace(0, 1e-6, 10_001)

    assert abbott_curve(z).height_difference(0.2, 0.7) == pytest.approx(0.5e-6, rel=1e-3, abs=0.0)


def test_one_height_has_a_curve():
    curve = abbott_curve([2e-6])

    assert (curve.height(0.5), curve.ratio(1e-6), curve.total_height) == (2e-6, 1.0, 0.0)


def test_integers_are_taken():
    assert core_height(np.arange(100, dtype=np.int16)[::-1]).k == pytest.approx(
        100.0, rel=1e-9, abs=0.0
    )


@pytest.mark.parametrize("p", [-0.01, 1.01, float("nan")])
def test_ratio_outside_the_curve_raises(p):
    with pytest.raises(DataError, match="fraction from 0 to 1"):
        material_height([0.0, 1.0], p)


def test_ratios_out_of_order_raise():
    with pytest.raises(DataError, match="must rise"):
        abbott_curve([0.0, 1.0]).height_difference(0.5, 0.5)


def test_unknown_options_raise(polygon):
    with pytest.raises(DataError, match="lsq"):
        core_height(polygon, line="tangent")
    with pytest.raises(DataError, match="peak"):
        material_ratio([0.0, 1.0], 0.0, reference="valley")
    with pytest.raises(DataError, match="finite"):
        material_ratio([0.0, 1.0], float("nan"))


@pytest.mark.parametrize("z", [[], [np.nan, np.nan]])
def test_nothing_measured_raises(z):
    with pytest.raises(TooFewSamplesError, match="no height"):
        abbott_curve(z)


@pytest.mark.parametrize("bad", [np.inf, -np.inf])
def test_infinite_height_raises(bad):
    with pytest.raises(InvalidSamplesError, match="infinite"):
        abbott_curve([0.0, bad])


def test_constant_has_no_core():
    with pytest.raises(DegenerateFitError, match="zero height"):
        core_height(np.ones(100))


def test_bad_rows_for_the_core_raise():
    with pytest.raises(TooFewSamplesError, match="5 or more"):
        core_height([3.0, 2.0, 1.0, 0.0])
    with pytest.raises(InvalidSamplesError, match="must fall"):
        core_height([1.0, 2.0, 3.0, 4.0, 5.0])
    with pytest.raises(InvalidSamplesError, match="finite"):
        core_height([5.0, 4.0, np.nan, 2.0, 1.0])
