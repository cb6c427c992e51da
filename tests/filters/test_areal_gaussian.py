"""Areal Gaussian filter: closed forms, a regression written out here, invariances, bad input."""

from __future__ import annotations

import math

import numpy as np
import pytest

from metrosep.core.errors import DataError, InvalidSamplesError, TooFewSamplesError
from metrosep.core.profile import Profile
from metrosep.core.surface import Surface
from metrosep.filters.gaussian import gaussian, gaussian_support
from metrosep.spectral.dft import Band

UM = 1e-6
ROUNDING = 2e-14
"""Relative to the largest height: some tens of operations of 2e-16 each."""

SAMPLED = 3e-9
"""6 steps per index: sampling the weights adds exp(-2 (pi sd (1 - dx / L))^2) = 1.5e-9."""

SPLIT = 1e-10
"""The split into two Gaussians is exact to 1e-12 and gaps magnify it by 1 / support."""


def _written_out(z: np.ndarray, cutoffs: tuple[float, float], order: int) -> np.ndarray:
    """Local regression at every pixel by its normal equations: sums over all pixels; cutoffs as (y, x)."""
    a = math.sqrt(math.log(2.0) / math.pi)
    valid = ~np.isnan(z)
    # distance from each place, a row, to each pixel of an axis, a column
    v, u = (
        (np.arange(n) - np.arange(n)[:, None]) / c for n, c in zip(z.shape, cutoffs, strict=True)
    )
    of_y, of_x = np.exp(-math.pi * (v / a) ** 2), np.exp(-math.pi * (u / a) ** 2)

    def moment(p: int, q: int, of: np.ndarray) -> np.ndarray:
        return (of_y * v**p) @ of @ (of_x * u**q).T

    powers = [(0, 0), (0, 1), (1, 0)][: 2 * order + 1]
    gram = [[moment(p + r, q + s, valid) for r, s in powers] for p, q in powers]
    right = [[moment(p, q, np.nan_to_num(z))] for p, q in powers]
    whole, side = (np.moveaxis(np.array(m), (0, 1), (2, 3)) for m in (gram, right))
    return np.linalg.solve(whole, side)[..., 0, 0]


def _written_out_at(
    z: np.ndarray, cutoff: float, order: int, places: list[tuple[int, int]]
) -> np.ndarray:
    """Local regression at some pixels; cutoff in pixels."""
    a = math.sqrt(math.log(2.0) / math.pi)
    y, x = np.nonzero(~np.isnan(z))
    heights, out = z[y, x], []
    for i, j in places:
        v, u = (y - i) / cutoff, (x - j) / cutoff
        root = np.sqrt(np.exp(-math.pi * (u * u + v * v) / a**2))
        design = np.column_stack([np.ones(u.size), u, v])[:, : 2 * order + 1]
        out.append(np.linalg.lstsq(design * root[:, None], heights * root, rcond=None)[0][0])
    return np.array(out)


def _holed(shape: tuple[int, int], seed: int) -> np.ndarray:
    rng = np.random.default_rng(seed)
    z = rng.normal(size=shape)
    z[10:22, 15:40] = np.nan
    z[rng.random(shape) < 0.05] = np.nan
    return z


def _gain(result: Surface, source: Surface) -> float:
    n_y, n_x = source.shape
    middle = (slice(n_y // 4, 3 * n_y // 4), slice(n_x // 4, 3 * n_x // 4))
    a, b = result.z[middle].ravel(), source.z[middle].ravel()
    return float(a @ b / (b @ b))


def test_transmission_of_a_crossed_cosine() -> None:
    """Acceptance F05, ISO 16610-61: 1/4 where both wavelengths are the nesting index."""
    x = np.arange(480) * UM
    wave = np.cos(2 * np.pi * x / (80 * UM))
    s = Surface(np.outer(wave, wave), UM, UM)

    assert _gain(gaussian(s, nesting_index=80 * UM), s) == pytest.approx(0.25, abs=1e-3)


@pytest.mark.parametrize("steps", [(1.0, 1.0), (0.5, 2.0), (8.0, 0.7)])
def test_transmission_with_pixels_that_are_not_square(steps: tuple[float, float]) -> None:
    """2^-(Lc^2 (1 / Lx^2 + 1 / Ly^2)), with wide and narrow Gaussians (in pixels) along x, y."""
    dx, dy = steps
    x = np.arange(int(600 / dx)) * dx
    y = np.arange(int(600 / dy)) * dy
    z = np.outer(np.cos(2 * np.pi * y / 120.0), np.cos(2 * np.pi * x / 60.0))
    s = Surface(z, dx * UM, dy * UM)
    gain = 2.0 ** -(50.0**2 * (1 / 60.0**2 + 1 / 120.0**2))

    low = gaussian(s, nesting_index=50 * UM)

    inner = (slice(int(70 / dy), -int(70 / dy)), slice(int(70 / dx), -int(70 / dx)))
    assert np.abs(low.z - gain * z)[inner].max() < SAMPLED


def test_a_pair_of_indices_is_x_then_y() -> None:
    x = np.arange(400) * UM
    wave = np.cos(2 * np.pi * x / (80 * UM))
    along_x = Surface(np.tile(wave, (400, 1)), UM, UM)
    along_y = Surface(np.tile(wave[:, None], (1, 400)), UM, UM)
    pair = (80 * UM, 20 * UM)

    assert _gain(gaussian(along_x, nesting_index=pair), along_x) == pytest.approx(0.5, abs=1e-3)
    assert _gain(gaussian(along_y, nesting_index=pair), along_y) == pytest.approx(
        2.0 ** -(1 / 16), abs=1e-3
    )


@pytest.mark.parametrize("cutoffs", [(3.0, 4.0), (14.0, 9.0), (40.0, 14.0), (40.0, 60.0)])
@pytest.mark.parametrize("order", [0, 1])
def test_agrees_with_the_regression_written_out(cutoffs: tuple[float, float], order: int) -> None:
    """Indices (y, x) in pixels, such that no, one and both axes are split."""
    z = _holed((42, 61), seed=1)
    s = Surface(z, 1.5 * UM, 1.0 * UM)
    index = (cutoffs[1] * 1.5 * UM, cutoffs[0] * UM)
    end = "moment" if order else "renormalise"

    low = gaussian(s, nesting_index=index, end=end, min_support=0.02).z

    truth = _written_out(z, cutoffs, order)
    assert np.array_equal(np.isnan(low), np.isnan(z))
    assert np.nanmax(np.abs(low - truth)) < SPLIT


@pytest.mark.parametrize("order", [0, 1])
@pytest.mark.parametrize("cutoff", [4.0, 30.0])
def test_many_single_gaps_over_several_stripes_agree_with_the_regression(
    order: int, cutoff: float
) -> None:
    """Stripes of 32 and 96 rows, the last of them short; 40 % gaps, ends of rows, whole rows."""
    rng = np.random.default_rng(12)
    z = rng.normal(size=(150, 131)) + 5.0
    z[rng.random(z.shape) < 0.4] = np.nan
    z[70:73] = z[-1, -1] = z[40, 0] = np.nan
    z[0, 0] = z[149, 60] = z[60, 130] = 5.0  # the whole array is inside
    end = "moment" if order else "renormalise"

    low = gaussian(
        Surface(z, UM, UM), nesting_index=cutoff * UM, end=end, min_support=1e-3, fill=True
    ).z

    corners = [(0, 0), (0, 130), (149, 0), (149, 130), (71, 60), (95, 95), (96, 96), (31, 32)]
    places = corners + [tuple(p) for p in rng.integers(0, 131, (40, 2)).tolist()]
    expected = _written_out_at(z, cutoff, order, places)
    found = np.array([low[p] for p in places])
    assert np.abs(found - expected).max() < SPLIT * np.nanmax(np.abs(z))
    kept = gaussian(Surface(z, UM, UM), nesting_index=cutoff * UM, end=end, min_support=1e-3).z
    assert np.array_equal(kept, np.where(np.isnan(z), np.nan, low), equal_nan=True)


@pytest.mark.parametrize("index", [4.0, 30.0])
def test_tilted_plane_is_exact_at_edges_and_beside_gaps(index: float) -> None:
    y, x = np.mgrid[:130, :170] * UM
    z = 1e-4 + 1e-3 * x - 2e-3 * y
    s = Surface(np.where(np.isnan(_holed(z.shape, seed=2)), np.nan, z), UM, UM)

    low = gaussian(s, nesting_index=index * UM)

    assert np.array_equal(np.isnan(low.z), np.isnan(s.z))
    assert np.nanmax(np.abs(low.z - z)) <= ROUNDING * np.abs(z).max()


def test_fill_continues_a_plane_into_gaps_only_where_there_is_support() -> None:
    y, x = np.mgrid[:120, :120] * UM
    plane = 1e-3 * x - 2e-3 * y
    z = plane.copy()
    z[20:26, 20:26] = np.nan
    z[50:110, 50:110] = np.nan
    s = Surface(z, UM, UM)
    low = gaussian(s, nesting_index=30 * UM, fill=True)
    support = gaussian_support(s, nesting_index=30 * UM)

    assert np.isfinite(low.z[20:26, 20:26]).all()
    assert np.array_equal(np.isnan(low.z), support.z < 0.1)
    assert np.isnan(low.z[80, 80])
    assert np.nanmax(np.abs(low.z - plane)) <= ROUNDING * np.abs(plane).max()


def test_ridge_equals_the_profile_filter() -> None:
    z = np.random.default_rng(3).normal(size=200)
    ridge = gaussian(Surface(np.tile(z, (90, 1)), UM, UM), nesting_index=50 * UM)
    line = gaussian(Profile(np.arange(200) * UM, z), cutoff=50 * UM)

    assert np.abs(ridge.z - line.z).max() < SPLIT


def test_one_measured_row_is_filtered_along_itself() -> None:
    """Nothing fixes the slope across it: order 0 there, no noise is blown up."""
    z = np.full((60, 200), np.nan)
    z[30] = 1.0
    z[30, ::2] = 3.0
    z[20, 5] = z[40, 5] = np.nan
    z[0, 0] = z[59, 199] = z[59, 0] = 2.0
    low = gaussian(Surface(z, UM, UM), nesting_index=20 * UM, min_support=0.01).z[30]

    assert np.abs(low[30:-30] - 2.0).max() < 1e-6


def test_transpose_and_mirror() -> None:
    z = _holed((80, 130), seed=4)
    s = Surface(z, 1.0 * UM, 2.0 * UM)
    low = gaussian(s, nesting_index=(30 * UM, 20 * UM)).z
    turned = gaussian(Surface(z.T, 2.0 * UM, 1.0 * UM), nesting_index=(20 * UM, 30 * UM)).z.T
    mirrored = gaussian(
        Surface(z[::-1, ::-1], 1.0 * UM, 2.0 * UM), nesting_index=(30 * UM, 20 * UM)
    )

    assert np.nanmax(np.abs(low - turned)) < SPLIT
    assert np.nanmax(np.abs(low - mirrored.z[::-1, ::-1])) < SPLIT


@pytest.mark.parametrize("scale", [1e-9, 1e-3, 1e3])
def test_units(scale: float) -> None:
    z = _holed((60, 70), seed=5)
    low = gaussian(Surface(z, 1.0, 1.0), nesting_index=20.0).z
    scaled = gaussian(Surface(z * scale, scale, scale), nesting_index=20.0 * scale).z / scale

    assert np.nanmax(np.abs(scaled - low)) < SPLIT


def test_rows_that_were_not_measured_equal_cropped_rows() -> None:
    z = _holed((60, 70), seed=6)
    padded = np.full((75, 90), np.nan)
    padded[9:69, 4:74] = z
    s = Surface(padded, UM, UM, origin=(1.0, 2.0))
    low = gaussian(s, nesting_index=20 * UM, fill=True)
    inside = gaussian(Surface(z, UM, UM), nesting_index=20 * UM, fill=True)

    assert low.origin == (1.0, 2.0)
    assert np.array_equal(low.z[9:69, 4:74], inside.z, equal_nan=True)
    assert np.isnan(low.z[:9]).all()
    assert np.isnan(low.z[:, 74:]).all()


def test_cut_moves_the_origin() -> None:
    y, x = np.mgrid[:100, :140]
    s = Surface(1e-3 * UM * (x + 3.0 * y), 1.0 * UM, 2.0 * UM, origin=(5 * UM, 7 * UM))
    low = gaussian(s, nesting_index=(30 * UM, 40 * UM), end="cut")

    assert low.shape == (100 - 2 * 20, 140 - 2 * 30)
    assert low.origin == pytest.approx((35 * UM, 47 * UM), rel=1e-12, abs=0.0)
    assert np.abs(low.z - s.z[20:-20, 30:-30]).max() <= ROUNDING * np.abs(s.z).max()


def test_support_at_edge_and_corner() -> None:
    s = Surface(np.zeros((260, 260)), UM, UM)
    support = gaussian_support(s, nesting_index=80 * UM)
    sd = math.sqrt(math.log(2.0)) / (math.pi * math.sqrt(2.0)) * 80.0
    edge = 0.5 + 0.5 / (sd * math.sqrt(2.0 * math.pi))

    assert support.metadata["quantity"] == "support"
    assert float(support.z[0, 130]) == pytest.approx(edge, abs=1e-6)
    assert float(support.z[0, 0]) == pytest.approx(edge**2, abs=1e-6)
    assert float(support.z[130, 130]) == pytest.approx(1.0, abs=SPLIT)


def test_band_long_and_short() -> None:
    s = Surface(_holed((100, 100), seed=7), UM, UM, metadata={"part": "7"})
    low = gaussian(s, nesting_index=30 * UM)
    high = gaussian(s, nesting_index=30 * UM, band="short")
    band = gaussian(s, band=Band(5 * UM, 30 * UM))
    steps = gaussian(gaussian(s, nesting_index=5 * UM), nesting_index=30 * UM, band="short")

    assert np.nanmax(np.abs(low.z + high.z - s.z)) < ROUNDING
    assert np.array_equal(band.z, steps.z, equal_nan=True)
    assert [h.name for h in band.history] == ["gaussian", "gaussian"]
    assert band.history[1].parameters["nesting_index_x_m"] == 30 * UM
    assert band.metadata["part"] == "7"


def test_nesting_index_of_the_whole_side_is_taken() -> None:
    """ISO 25178-3 sets the L-filter to the side of the square."""
    s = Surface(np.random.default_rng(8).normal(size=(50, 50)), 5 * UM, 5 * UM)

    assert np.isfinite(gaussian(s, nesting_index=250 * UM).z).all()


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"cutoff": 20 * UM}, "takes nesting_index="),
        ({}, "needs nesting_index="),
        ({"nesting_index": (20 * UM,)}, "pair"),
        ({"nesting_index": 2 * UM}, "sampling limit"),
        ({"nesting_index": 61 * UM}, "longer than"),
        ({"nesting_index": 20 * UM, "end": "closed"}, "closed profiles"),
        ({"nesting_index": 20 * UM, "upr": 15}, "closed profiles"),
        ({"nesting_index": 40 * UM, "end": "cut"}, "leaves 0 samples"),
    ],
)
def test_bad_options(options: dict[str, object], message: str) -> None:
    s = Surface(np.zeros((60, 70)), UM, UM)
    with pytest.raises(DataError, match=message):
        gaussian(s, **options)


def test_bad_surfaces() -> None:
    with pytest.raises(DataError, match="no lateral step dx and dy"):
        gaussian(Surface(np.zeros((60, 60))), nesting_index=20 * UM)
    with pytest.raises(TooFewSamplesError):
        gaussian(Surface(np.full((60, 60), np.nan), UM, UM), nesting_index=20 * UM)
    with pytest.raises(InvalidSamplesError):
        gaussian(Surface(np.zeros((60, 60)), UM, UM), nesting_index=float("inf"))
    with pytest.raises(TooFewSamplesError):
        gaussian(Surface([[1.0]], UM, UM), nesting_index=20 * UM)
