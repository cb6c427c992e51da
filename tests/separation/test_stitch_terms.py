"""Stitching's sums without written-out columns, and the pixels of a reference under interpolation."""

import math

import numpy as np
import pytest

from metrosep.separation.maps._stitch_grid import (
    layout_of,
    overlaps_of,
    pieces_of,
    without_own_plane,
)
from metrosep.separation.maps._stitch_models import plain_problem, with_polynomials
from metrosep.separation.maps._stitch_solve import (
    ReferenceSystem,
    Terms,
    inverse_of,
    normal_matrix,
)
from metrosep.separation.maps.stitching import stitch

ROUNDING = 1e-11
"""Sums of 1e3 products of numbers of size one."""


def layout(shapes, positions, turns=None):
    rng = np.random.default_rng(1)
    maps = [rng.standard_normal(s) for s in shapes]
    for z in maps:
        z[0, 0] = np.nan
    pieces = pieces_of(maps, np.array(positions, float), dx=1e-3, dy=1e-3, rotations=turns)
    return layout_of(pieces)


NOT_DETERMINED = 0.05
"""Share of a rough reference; pixels with an error above 0.02 in two trials are NaN."""

CASES = {
    "on pixels": ([(13, 17), (11, 19)], [(0, 0), (4e-3, 3e-3)], None),
    "between pixels": ([(13, 17), (13, 17)], [(0, 0), (4.3e-3, 2.6e-3)], None),
    "turned": ([(15, 15), (15, 15)], [(0, 0), (3e-3, 2e-3)], [0.0, 0.6]),
    "two columns": ([(12, 2), (12, 9)], [(0, 0), (1e-3, 2e-3)], None),
}


@pytest.mark.parametrize("case", CASES)
@pytest.mark.parametrize("degree", [1, 6])
def test_products_of_two_axes_are_the_columns(case, degree):
    """Every operation against columns written out from the positions of the pixels."""
    from numpy.polynomial.legendre import legval

    lay = layout(*CASES[case])
    overlaps = overlaps_of(lay)
    assert len(overlaps) == 1
    terms = with_polynomials(lay, overlaps, ("piston", "tilt", "power"), degree, line=False).terms
    scale = max(np.abs(lay.placed[0].x).max(), np.abs(lay.placed[0].y).max())

    def make(k, box):
        p = lay.placed[k]
        x, y = (np.broadcast_to(c, p.valid.shape)[box] for c in (p.x, p.y))
        h = max(np.abs(p.x).max(), np.abs(p.y).max())
        own = [np.ones_like(x), x / h, y / h, (x / h) ** 2 + (y / h) ** 2]
        shared = [
            legval(x / scale, np.eye(degree + 1)[n - b]) * legval(y / scale, np.eye(degree + 1)[b])
            for n in range(degree + 1)
            for b in range(n + 1)
        ]
        return np.stack(own + shared)

    plain, o, rng = Terms(make), overlaps[0], np.random.default_rng(2)
    weight = rng.random(lay.placed[0].valid[o.in_i].shape)
    n = make(0, o.in_i).shape[0]
    window, factors, block = (
        rng.random(lay.placed[1].valid.shape),
        rng.random((3, n)),
        rng.random((n, n)),
    )
    for name, arguments in (
        ("values", (1, o.in_j)),
        ("gram", (0, o.in_i, 1, o.in_j, weight)),
        ("project", (1, window)),
        ("project", (0, weight, o.in_i)),
        ("combine", (1, factors)),
        ("combine", (0, factors, o.in_i)),
        ("quadratic", (0, o.in_i, 1, o.in_j, block)),
    ):
        truth = getattr(plain, name)(*arguments)
        np.testing.assert_allclose(
            getattr(terms, name)(*arguments), truth, rtol=0.0, atol=ROUNDING * np.abs(truth).max()
        )


def test_plane_of_an_overlap():
    rng = np.random.default_rng(3)
    z, known = rng.standard_normal((9, 14)), rng.random((9, 14)) > 0.3
    y, x = np.nonzero(known)
    a = np.stack([np.ones(x.size), x, y], axis=1)
    truth = z[known] - a @ np.linalg.lstsq(a, z[known], rcond=None)[0]
    found = without_own_plane(np.where(known, z, np.nan), known)

    np.testing.assert_allclose(found[known], truth, rtol=0.0, atol=ROUNDING)
    assert (found[~known] == 0.0).all()


def nine(n, shifts_x, shifts_y, *, noise=0.0, seed=0, sd=5e-9):
    """A rough reference, a part that is a paraboloid: cubic interpolation has no error on it."""
    rng = np.random.default_rng(seed)
    y, x = np.mgrid[:n, :n].astype(float)
    disc = np.hypot(x - (n - 1) / 2, y - (n - 1) / 2) <= n / 2
    rough = sd * np.random.default_rng(100).standard_normal((n, n))
    maps, positions = [], [(a, b) for b in shifts_y for a in shifts_x]
    for px, py in positions:
        u, v = (x + px) / n, (y + py) / n
        z = 3e-8 * u**2 - 2e-8 * u * v + 1e-8 * v + rough + noise * rng.standard_normal((n, n))
        maps.append(np.where(disc, z + 2e-8 * rng.standard_normal() * u, np.nan))
    return maps, [(1e-3 * a, 1e-3 * b) for a, b in positions], rough


def without_smooth(z, *, order=2):
    y, x = (np.arange(n) / n - 0.5 for n in z.shape)
    y, x = np.meshgrid(y, x, indexing="ij")
    ok = np.isfinite(z)
    basis = np.stack([x**a * y**b for a in range(order + 1) for b in range(order + 1 - a)], axis=2)
    out = np.full(z.shape, np.nan)
    out[ok] = z[ok] - basis[ok] @ np.linalg.lstsq(basis[ok], z[ok], rcond=None)[0]
    return out


@pytest.mark.parametrize(
    ("shifts_x", "shifts_y"),
    [([0, 11.3, 27.8], [0, 12.6, 29.4]), ([0, 7.3, 16.8], [0, 8.6, 17.4])],
)
def test_reference_between_pixels_comes_back_at_the_rim_too(shifts_x, shifts_y):
    """Some pixels are reached by negative weights only: unknowns like all others, or NaN."""
    maps, positions, rough = nine(40, shifts_x, shifts_y)
    result = stitch(maps, positions, dx=1e-3, dy=1e-3, reference="fit", draws=0)
    error = np.abs(without_smooth(result.reference - rough))

    assert np.isfinite(error).sum() > 0.88 * np.isfinite(maps[0]).sum()
    assert np.nanmedian(error) < 1e-3 * 5e-9
    assert np.nanmax(error) < NOT_DETERMINED * 5e-9
    assert np.nanmax(np.abs(without_smooth(np.array(result.surface)))) < NOT_DETERMINED * 5e-9


def test_equations_of_the_pixels_are_those_of_the_whole_matrix():
    """Surface, freedoms and reference as unknowns of one dense matrix; the Schur complement of it."""
    rng = np.random.default_rng(4)
    n = 9
    positions = [(0, 0), (2e-3, 1.4e-3), (4.5e-3, 3e-3)]
    lay = layout([(n, n)] * 3, positions)
    overlaps = overlaps_of(lay)
    problem = plain_problem(lay, overlaps, ("piston", "tilt"), line=False)
    inverse = inverse_of(normal_matrix(problem))
    rows = []
    for k, p in enumerate(lay.placed):
        forward = np.stack([p.forward(e.reshape(n, n)).ravel() for e in np.eye(n * n)], axis=1)
        surface = np.zeros((p.valid.size, problem.weight.size))
        index = np.arange(problem.weight.size).reshape(problem.weight.shape)[p.rows, p.columns]
        surface[np.arange(p.valid.size), index.ravel()] = 1.0
        own = np.zeros((p.valid.size, 9))
        x, y = (np.broadcast_to(c, p.valid.shape).ravel() for c in (p.x, p.y))
        own[:, 3 * k : 3 * k + 3] = np.stack([np.ones_like(x), 1e3 * x, 1e3 * y], axis=1)
        use = p.valid.ravel()
        rows.append(math.sqrt(p.weight) * np.concatenate([forward, surface, own], axis=1)[use])
    whole = np.concatenate(rows)
    reference, rest = whole[:, : n * n], whole[:, n * n :]
    left = reference - rest @ (np.linalg.pinv(rest, rcond=1e-10) @ reference)
    for kept in (True, False):
        system = ReferenceSystem(problem, inverse, (n, n))
        if not kept:
            system.coupling = None
        r = np.where(system.free, rng.standard_normal((n, n)), 0.0)
        truth = np.where(system.free, (reference.T @ (left @ r.ravel())).reshape(n, n), 0.0)
        np.testing.assert_allclose(system.apply(r), truth, rtol=0.0, atol=1e-10)


@pytest.mark.slow
def test_u_of_a_reference_between_pixels():
    """Errors of trials against u from draws, at the rim as well."""
    sd, squares, n = 1e-9, 0.0, 40
    for seed in range(40):
        maps, positions, rough = nine(n, [0, 7.3, 16.8], [0, 8.6, 17.4], noise=sd, seed=seed)
        draws = 48 if seed == 0 else 0
        result = stitch(
            maps, positions, dx=1e-3, dy=1e-3, reference="fit", draws=draws, u_reading=sd
        )
        if draws:
            u, given = result.u["reference"], np.isfinite(result.reference)
        error = without_smooth(np.where(given, result.reference - rough, np.nan))
        squares = squares + error**2 / 40
    ratio = np.sqrt(squares / u**2)[given]

    assert given.sum() > 0.88 * np.isfinite(maps[0]).sum()
    assert math.sqrt(np.mean(ratio**2)) == pytest.approx(1.0, rel=0.0, abs=0.1)
    assert np.percentile(ratio, 99) < 1.6
