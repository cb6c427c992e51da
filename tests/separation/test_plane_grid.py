"""Coupled grid: lines of both directions joined at their crossings."""

import numpy as np
import pytest

from metrosep.core.errors import DataError, NotSeparableError, TooFewSamplesError
from metrosep.core.surface import Surface
from metrosep.separation.planes.coupled_method import coupled_grid

NM = 1e-9
MM = 1e-3
TERMS = {"free": 4, "common": 3, "none": 1}


def lines(seed, slopes, shape=(7, 9), noise=0.0, repeats=None):
    """A random map and readings of lines along x (rows) and along y (columns)."""
    rng = np.random.default_rng(seed)
    e = 50 * NM * rng.standard_normal(shape)
    x, y = 2 * MM * np.arange(shape[1]), 3 * MM * np.arange(shape[0])
    rows = e + 1e-6 * rng.standard_normal((shape[0], 1))
    columns = e + 1e-6 * rng.standard_normal((1, shape[1]))
    if slopes == "free":
        rows = rows + 1e-4 * rng.standard_normal((shape[0], 1)) * x
        columns = columns + 1e-4 * rng.standard_normal((1, shape[1])) * y[:, None]
    if slopes == "common":
        rows, columns = rows + 2e-4 * x, columns - 1e-4 * y[:, None]
    size = shape if repeats is None else (repeats, *shape)
    return (
        e,
        rows + noise * rng.standard_normal(size),
        columns + noise * rng.standard_normal(size),
    )


def without_terms(e, slopes, mask=None):
    n_y, n_x = e.shape
    v, u = np.mgrid[-1 : 1 : n_y * 1j, -1 : 1 : n_x * 1j]
    basis = np.stack([np.ones_like(u), u, v, u * v], axis=-1)[..., : TERMS[slopes]]
    use = np.ones(e.shape, bool) if mask is None else mask
    return e - basis @ np.linalg.lstsq(basis[use], e[use], rcond=None)[0]


@pytest.mark.parametrize("slopes", ["free", "common", "none"])
def test_noise_free_map_is_exact_but_for_the_null_space(slopes):
    e, rows, columns = lines(1, slopes)

    found = coupled_grid(rows, columns, dx=2 * MM, dy=3 * MM, slopes=slopes)

    rest = found.error - without_terms(e, slopes)
    assert np.max(np.abs(rest)) < 1e-9 * np.ptp(e)
    assert len(found.null_space[0].indices) == TERMS[slopes]


@pytest.mark.parametrize("slopes", ["free", "common", "none"])
def test_null_space_is_what_brute_force_says(slopes):
    """Rank of the full design (map and lines) written out reading by reading."""
    n_y, n_x = 4, 5
    n_map = n_y * n_x
    per_line = {"free": n_y * 2 + n_x * 2, "common": n_y + n_x + 2, "none": n_y + n_x}[slopes]
    design = []
    for j in range(n_y):
        for i in range(n_x):
            for along in "xy":
                row = np.zeros(n_map + per_line)
                row[j * n_x + i] = 1.0
                first = n_map if along == "x" else n_map + n_y
                line, at = (j, i) if along == "x" else (i, j)
                row[first + line] = 1.0
                if slopes == "free":
                    row[n_map + n_y + n_x + (line if along == "x" else n_y + line)] = at
                if slopes == "common":
                    row[n_map + n_y + n_x + (0 if along == "x" else 1)] = at
                design.append(row)
    _, s, vt = np.linalg.svd(np.array(design))
    null = vt[int((s > 1e-9 * s[0]).sum()) :, :n_map]

    assert np.linalg.matrix_rank(null, tol=1e-9) == TERMS[slopes]
    for shape in null:
        assert np.max(np.abs(without_terms(shape.reshape(n_y, n_x), slopes))) < 1e-12


def test_twist_is_lost_with_free_slopes_and_kept_with_a_common_one():
    n = 6
    v, u = np.mgrid[-1 : 1 : n * 1j, -1 : 1 : n * 1j]
    twist = 100 * NM * u * v

    free = coupled_grid(twist, twist, dx=MM, dy=MM, slopes="free")
    common = coupled_grid(twist, twist, dx=MM, dy=MM, slopes="common")

    assert np.max(np.abs(free.error)) < 1e-15
    assert "twist xy" in free.null_space[0].indices
    assert common.error[0, 0] == pytest.approx(100 * NM, abs=1e-15)
    assert common.error[0, -1] == pytest.approx(-100 * NM, abs=1e-15)


def test_planted_corner_keeps_place_and_sign():
    e = np.zeros((8, 10))
    e[1, 8] = 90 * NM

    found = coupled_grid(e, e, dx=MM, dy=MM)

    assert np.unravel_index(np.argmax(found.error), e.shape) == (1, 8)
    assert np.max(np.abs(e - found.error)) < 0.3 * 90 * NM
    assert np.max(np.abs(e + found.error)) > 90 * NM


def test_few_lines_with_free_ends():
    """Three lines along x at all columns, four along y at all rows; the rest was not measured."""
    e, rows, columns = lines(2, "free", shape=(9, 11))
    keep_rows, keep_columns = [0, 4, 8], [0, 3, 7, 10]
    rows[np.setdiff1d(np.arange(9), keep_rows)] = np.nan
    columns[:, np.setdiff1d(np.arange(11), keep_columns)] = np.nan

    found = coupled_grid(rows, columns, dx=2 * MM, dy=3 * MM)

    measured = ~np.isnan(rows) | ~np.isnan(columns)
    assert np.array_equal(np.isfinite(found.error), measured)
    rest = (found.error - without_terms(e, "free", measured))[measured]
    assert np.max(np.abs(rest)) < 1e-9 * np.ptp(e)


def test_line_that_crosses_once_is_nan():
    e, rows, columns = lines(3, "free", shape=(6, 6))
    rows[5, 1:] = np.nan  # one point left of the last line along x
    columns[5, :] = np.nan
    rows[5, 3] = 1e-6  # and one that nothing crosses

    found = coupled_grid(rows, columns, dx=2 * MM, dy=3 * MM)

    assert np.isnan(found.error[5, 3])
    assert np.isnan(found.u["error"][5, 3])
    assert any("NaN" in m for m in found.messages)
    measured = np.isfinite(found.error)
    rest = (found.error - without_terms(e, "free", measured))[measured]
    assert np.max(np.abs(rest)) < 1e-9 * np.ptp(e)


@pytest.mark.slow
def test_uncertainty_agrees_with_monte_carlo():
    """500 trials: an sd is known to 3.2 %; three times that and a little for the worst of three."""
    rest = []
    for seed in range(500):
        e, rows, columns = lines(100 + seed, "free", noise=10 * NM)
        rows[3, 2:4] = np.nan
        columns[:, 5] = np.nan
        found = coupled_grid(rows, columns, dx=2 * MM, dy=3 * MM, u_reading=10 * NM)
        off = found.error - without_terms(e, "free")
        rest.append([off[0, 0], off[3, 2], off[4, 5], found.noise.value])
        u = found.u["error"] / found.noise.value

    rest = np.array(rest)
    drawn = rest[:, :3].std(axis=0)
    assert drawn == pytest.approx(10 * NM * u[[0, 3, 4], [0, 2, 5]], rel=0.11, abs=0.0)
    assert np.sqrt(np.mean(rest[:, 3] ** 2)) == pytest.approx(10 * NM, rel=0.02, abs=0.0)


def test_repeats_shrink_u_by_the_root():
    _, one_x, one_y = lines(7, "free", noise=10 * NM, repeats=4)
    _, all_x, all_y = lines(7, "free", noise=10 * NM, repeats=64)

    few = coupled_grid(one_x, one_y, dx=2 * MM, dy=3 * MM)
    many = coupled_grid(all_x, all_y, dx=2 * MM, dy=3 * MM)

    ratio = few.u["error"].mean() / many.u["error"].mean()
    assert ratio == pytest.approx(4.0, rel=0.1, abs=0.0)  # both noises estimated


def test_surfaces_are_accepted():
    e, rows, columns = lines(8, "free")

    found = coupled_grid(Surface(rows, 2 * MM, 3 * MM), Surface(columns, 2 * MM, 3 * MM))

    assert np.max(np.abs(found.error - without_terms(e, "free"))) < 1e-9 * np.ptp(e)
    assert found.coordinates["y"][-1] == pytest.approx(18 * MM, abs=1e-15)


NANS = np.full((5, 5), np.nan)
ONE_LINE = NANS.copy()
ONE_LINE[2] = 0.0
LEFT, RIGHT = NANS.copy(), NANS.copy()
LEFT[:, :2] = 0.0
RIGHT[:, 3:] = 0.0


@pytest.mark.parametrize(
    ("rows", "columns", "options", "error", "match"),
    [
        (np.zeros((5, 5)), NANS, {}, NotSeparableError, "no line along y"),
        (NANS, np.zeros((5, 5)), {}, NotSeparableError, "no line along x"),
        (ONE_LINE, np.zeros((5, 5)), {}, TooFewSamplesError, "one line along x"),
        (LEFT, RIGHT, {}, NotSeparableError, "do not join"),
        (np.zeros((5, 5)), np.zeros((4, 5)), {}, DataError, "one grid"),
        (np.zeros((5, 5)), np.zeros((5, 5)), {"dx": None}, DataError, "positive steps"),
        (np.zeros((5, 5)), np.zeros((5, 5)), {"slopes": "some"}, DataError, "slopes"),
        (np.zeros(5), np.zeros(5), {}, DataError, "shape"),
    ],
)
def test_refuses(rows, columns, options, error, match):
    with pytest.raises(error, match=match):
        coupled_grid(rows, columns, **{"dx": MM, "dy": MM, **options})


@pytest.mark.parametrize(
    ("lines", "options", "match"),
    [
        (np.zeros((5, 6)), {"dx": "2 V"}, "a length is needed"),
        (np.zeros((5, 6)), {"u_reading": "a"}, "u_reading 'a' is not a number"),
        (np.zeros((5, 6)), {"u_reading": -1e-9}, "u_reading"),
        (np.zeros((5, 6)) + 1j, {}, "complex"),
        ([[1.0, 2.0], [3.0]], {}, "x_lines must be real numbers"),
    ],
)
def test_refuses_what_is_typed_wrong(lines, options, match):
    with pytest.raises(DataError, match=match):
        coupled_grid(lines, np.zeros((5, 6)), **{"dx": 1e-3, "dy": 1e-3, **options})
