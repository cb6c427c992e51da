"""Uncertainty of a plane on maps of a few rows and thousands of columns, where blocks may not join the rows."""

import numpy as np
import pytest
from scipy.ndimage import gaussian_filter

from metrosep import Surface
from metrosep.forms import PointSet, Polynomial, fit

STEP, NM = 1e-5, 1e-9


@pytest.mark.parametrize("rows", [2, 3, 8, 20])
@pytest.mark.parametrize("turned", [False, True])
def test_a_map_of_a_few_rows_has_the_u_of_its_white_noise(rows, turned):
    shape = (3000, rows) if turned else (rows, 3000)
    z = NM * np.random.default_rng(5).standard_normal(shape)
    found = fit(Surface(z, STEP, STEP), "plane")
    # of white noise: sigma / sqrt(N) over the standard deviation of the positions
    for key, n in (("tilt_x", shape[1]), ("tilt_y", shape[0])):
        white = NM / np.sqrt(z.size) / (STEP * np.sqrt((n * n - 1) / 12.0))
        assert (
            0.8 * white < found.u[key] < 2.5 * white
        )  # of some seeds more: a long spectrum may be likely
        assert abs(found.params[key]) < 4.0 * found.u[key]
    assert found.u["piston"] > 0.8 * NM / np.sqrt(z.size)


def test_a_tilt_across_a_narrow_map_of_texture_lies_within_its_uncertainty():
    """Truth: texture of a pixel has no tilt; of 40 maps 38.2 are within U, 33 and less in 0.3 % of draws."""
    held = 0
    for seed in range(40):
        noise = np.random.default_rng([31, seed]).standard_normal((46, 340))
        z = 10 * NM * gaussian_filter(noise, 1.0)[20:-20, 20:-20]
        found = fit(Surface(z, STEP, STEP), "plane")
        held += abs(found.params["tilt_y"]) <= found.coverage_factor * found.u["tilt_y"]
    assert held >= 34


@pytest.mark.parametrize(
    ("as_points", "s"),
    [(False, 2.0), (False, 5.0), pytest.param(True, 2.0, marks=pytest.mark.slow), (True, 5.0)],
)
def test_u_of_a_narrow_map_is_not_wider_than_its_correlation_asks_for(s, as_points):
    """C of Gaussian correlation is known, and with it the scatter of both tilts of 8 by 96 pixels.

    U was 1.9 times as wide for s = 2 pixels and 5 times for s = 5: of two estimates the larger counted,
    since the waves of one were all longer than the strip is wide.
    """
    x, y = (v.ravel() for v in np.meshgrid(np.arange(96.0), np.arange(8.0)))
    J = np.stack([np.ones(x.size), STEP * (x - x.mean()), STEP * (y - y.mean())])
    square = np.subtract.outer(x, x) ** 2 + np.subtract.outer(y, y) ** 2
    solve = np.linalg.solve(J @ J.T, J)
    scatter = 10 * NM * np.sqrt(np.diag(solve @ np.exp(-square / (4 * s * s)) @ solve.T))[1:]
    wide, held = [], []
    for seed in range(24):
        noise = np.random.default_rng([37, seed]).standard_normal((88, 176))
        smooth = gaussian_filter(noise, s, truncate=8.0)[40:-40, 40:-40]
        z = 10 * NM * 2 * np.sqrt(np.pi) * s * smooth  # of unit variance in front of 10 nm
        points = PointSet(STEP * x, STEP * y, z.ravel())
        found = fit(points if as_points else Surface(z, STEP, STEP), "plane")
        U = found.coverage_factor * np.array([found.u["tilt_x"], found.u["tilt_y"]])
        if np.isnan(U).any():  # fewer independent cells than a plane needs
            continue
        off = np.abs([found.params["tilt_x"], found.params["tilt_y"]])
        wide.append(U / (2 * scatter))
        held.append(off <= U)
    assert len(held) >= 12
    assert np.mean(held) >= 0.88
    assert 0.75 < np.median(wide) < 1.4


def test_a_narrow_map_that_lies_askew_has_the_u_of_one_along_x():
    """Truth: texture has no tilt. Of 30 strips at 45 degrees 28.6 are within U, 24 and less in 0.3 % of draws."""
    strip = 12.0
    y, x = np.mgrid[-100:101, -100:101].astype(float)
    along, across = (x + y) / np.sqrt(2.0), (y - x) / np.sqrt(2.0)
    there = (np.abs(across) < strip / 2) & (np.abs(along) < 100)
    held = 0
    for seed in range(30):
        noise = np.random.default_rng([32, seed]).standard_normal(x.shape)
        z = np.where(there, 10 * NM * gaussian_filter(noise, 2.0), np.nan)
        found = fit(Surface(z, STEP, STEP), "plane")
        off = found.params["tilt_y"] - found.params["tilt_x"]  # across the strip, times sqrt(2)
        i, j = (list(found.params).index(k) for k in ("tilt_x", "tilt_y"))
        u = np.sqrt(found.cov[i, i] + found.cov[j, j] - 2.0 * found.cov[i, j])
        held += abs(off) <= found.coverage_factor * u
    assert held >= 25


def walk(seed=4):
    """A walk of heights, which hang together: of this one a row has too few independent values for u."""
    return np.cumsum(np.random.default_rng(seed).normal(size=300)) * NM


@pytest.mark.parametrize("seed", [3, 4])
def test_one_column_has_the_u_of_one_row(seed):
    z = walk(seed)
    row, column = (fit(Surface(v, STEP, STEP), "plane") for v in (z[None], z[:, None]))
    assert column.params["tilt_y"] == pytest.approx(row.params["tilt_x"], rel=1e-9, abs=0.0)
    assert column.u["tilt_y"] == pytest.approx(row.u["tilt_x"], rel=1e-9, abs=0.0, nan_ok=True)
    assert column.u["piston"] == pytest.approx(row.u["piston"], rel=1e-9, abs=0.0, nan_ok=True)


@pytest.mark.parametrize("robust", [None, "tukey"])
@pytest.mark.parametrize("basis", ["power", "legendre", "chebyshev"])
def test_one_column_has_the_polynomial_of_one_row(basis, robust):
    """Truth: numpy's polynomial of the heights, of which some are missing."""
    z = walk(3)
    z[40:55] = np.nan
    row, column = (
        fit(Surface(v, STEP, STEP, origin=(STEP, STEP)), Polynomial(3, basis=basis), robust=robust)
        for v in (z[None], z[:, None])
    )
    rest = column.residual.z[:, 0]
    assert np.nanmax(np.abs(rest - row.residual.z[0])) < 1e-6 * NM
    assert [*column.params.values()] == pytest.approx([*row.params.values()], rel=1e-6, abs=0.0)
    assert all("_0_" in name for name in column.params)  # of y alone
    assert [*column.u.values()] == pytest.approx([*row.u.values()], rel=1e-6, abs=0.0)
    if robust is None:
        t, good = np.arange(300.0), ~np.isnan(z)
        truth = np.polynomial.Polynomial.fit(t[good], z[good], 3)
        assert np.nanmax(np.abs(rest - (z - truth(t)))) < 1e-6 * NM


@pytest.mark.parametrize("turned", [False, True])
@pytest.mark.parametrize(
    ("along", "across", "says"), [(10, 2, True), (20, 1, True), (2, 20, False), (2, 4, False)]
)
def test_a_lay_along_a_narrow_map_is_said_to_be_beyond_u(along, across, says, turned):
    """8 rows of 64 pixels, where U of a plane holds 0.6 to 0.9 of the errors: a turning lay along the strip."""
    number = 0
    for seed in range(6):
        noise = np.random.default_rng([41, seed]).standard_normal((108, 164))
        z = 10 * NM * gaussian_filter(noise, (across, along))[50:-50, 50:-50]
        z[3, 20:24] = np.nan
        steps = (2 * STEP, STEP)  # of a camera with pixels of 20 by 10 um
        found = fit(Surface(z.T if turned else z, *(steps[::-1] if turned else steps)), "plane")
        said = [w for w in found.warnings if "run along this narrow map" in w]
        assert not said or said[0] in found.report()
        number += bool(said)
        if np.isnan(found.u["tilt_x"]):  # too few cells, which is said
            assert not said
            number += says
    assert number == 6 * says
