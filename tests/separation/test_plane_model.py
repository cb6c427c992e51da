"""XY plane of the paper's eq. 3: signs, uncertainty, gaps; the fit and its F test."""

import copy
import json
import math
import pickle

import numpy as np
import pytest
from scipy import stats

from metrosep.core.errors import (
    DataError,
    InvalidSamplesError,
    NotSeparableError,
    TooFewSamplesError,
    UnitError,
)
from metrosep.core.profile import Profile
from metrosep.core.provenance import Step
from metrosep.core.quantity import Quantity
from metrosep.core.surface import Surface
from metrosep.separation.planes.plane_fit import fit_plane_model
from metrosep.separation.planes.plane_model import plane_map

NM = 1e-9
MM = 1e-3
EXACT = 1e-18  # m, nine digits below a nanometre: rounding only


def bump(n, at, height):
    z = np.zeros(n)
    z[at] = height
    return z


# --- plane_map --------------------------------------------------------------------------------


def test_one_sided_bumps_land_where_they_belong():
    """x has 7 columns with a bump at column 1, y has 4 rows with one at row 3: no mirror, no swap."""
    x = Profile(np.arange(7) * MM, bump(7, 1, 5 * NM))
    y = Profile(10 * MM + np.arange(4) * 2 * MM, bump(4, 3, -2 * NM))

    plane = plane_map(x, y, dx=MM, dy=2 * MM)

    z = plane.surface.z
    assert z.shape == (4, 7)
    assert z[0, 1] == pytest.approx(5 * NM, abs=EXACT)
    assert z[3, 0] == pytest.approx(-2 * NM, abs=EXACT)
    assert z[3, 1] == pytest.approx(3 * NM, abs=EXACT)
    assert z[0, 6] == pytest.approx(0.0, abs=EXACT)
    assert plane.surface.origin == (0.0, 10 * MM)
    assert plane.y[-1] == pytest.approx(16 * MM, abs=1e-15)


@pytest.mark.parametrize(("alpha", "beta"), [(3e-6, 0.0), (0.0, 2e-6), (-3e-6, 2e-6)])
def test_alignment_lifts_towards_larger_coordinates(alpha, beta):
    """Eq. 3: + alpha y + beta x, zero at the start point of machining."""
    flat = Profile(np.linspace(0, 10 * MM, 11), np.zeros(11))

    z = plane_map(flat, flat, dx=MM, dy=MM, alpha=alpha, beta=beta).surface.z

    assert z[0, 0] == pytest.approx(0.0, abs=EXACT)
    assert z[10, 0] == pytest.approx(alpha * 10 * MM, abs=EXACT)
    assert z[0, 10] == pytest.approx(beta * 10 * MM, abs=EXACT)


def test_correction_is_minus_the_map():
    """Adding the map instead of its negative must make the plane worse."""
    x = Profile(np.arange(9) * MM, 100 * NM * np.sin(np.arange(9)))
    y = Profile(np.arange(5) * MM, 80 * NM * np.cos(2.0 * np.arange(5)))
    machine = y.z[:, None] + x.z

    z = plane_map(x, y, dx=MM, dy=MM).surface.z

    assert np.ptp(machine - z) < 1e-15
    assert np.ptp(machine + z) > 1.9 * np.ptp(machine)


def test_uncertainty_is_the_root_sum_of_squares():
    x = Profile(np.arange(5) * MM, np.zeros(5))
    y = Profile(np.arange(3) * MM, np.zeros(3))

    plane = plane_map(
        x,
        y,
        dx=MM,
        dy=MM,
        alpha=Quantity(1e-6, "rad", "test", u=2e-6),
        beta=Quantity(0.0, "rad", "test", u=1e-6),
        u_x=3 * NM,
        u_y=[4 * NM, 4 * NM, 4 * NM],
    )

    expected = math.sqrt(3**2 + 4**2 + (2 * 2) ** 2 + (4 * 1) ** 2) * NM
    assert plane.u.z[2, 4] == pytest.approx(expected, abs=EXACT)
    assert plane.u.z[0, 0] == pytest.approx(5 * NM, abs=EXACT)


def test_unknown_uncertainty_is_nan_and_said():
    x = Profile(np.arange(5) * MM, np.zeros(5))

    plane = plane_map(x, x, dx=MM, dy=MM, u_x=1 * NM)

    assert np.isnan(plane.u.z).all()
    assert any("give u_y" in m for m in plane.messages)


def test_gap_stays_a_gap():
    z = np.array([0.0, 1.0, np.nan, 3.0, 4.0]) * NM
    x = Profile(np.arange(5) * MM, z)
    y = Profile([0.0, MM], [0.0, 0.0])

    plane = plane_map(x, y, dx=0.5 * MM, dy=MM, u_x=NM, u_y=NM)

    assert np.flatnonzero(np.isnan(plane.surface.z[0])).tolist() == [3, 4, 5]
    assert np.flatnonzero(np.isnan(plane.u.z[0])).tolist() == [3, 4, 5]
    assert any("NaN" in m for m in plane.messages)


def test_estimates_bring_their_own_uncertainty():
    from metrosep.separation import machine_axis, separate

    axis = machine_axis(seed=11, length=45 * MM)
    estimate = separate(axis.runs, method="mean", start=0.0, length=45 * MM)

    plane = plane_map(estimate, estimate, dx=5 * MM, dy=5 * MM)

    e = estimate.evaluate(plane.x)
    assert plane.surface.z[2, 5] == pytest.approx(e[2] + e[5], abs=EXACT)
    sd = estimate.sd(plane.x)
    assert plane.u.z[2, 5] == pytest.approx(math.hypot(sd[2], sd[5]), abs=EXACT)
    assert sum("artefact together" in m for m in plane.messages) == 2


@pytest.mark.parametrize(
    ("change", "error", "match"),
    [
        ({"alpha": 0.5}, UnitError, "rad"),
        ({"alpha": math.nan}, DataError, "finite"),
        ({"beta": Quantity(1.0, "m", "test")}, UnitError, "in m"),
        ({"dx": 1.0}, DataError, "1 mm is 0.001"),
        ({"dx": -1.0}, DataError, "positive"),
        ({"along_x": np.zeros(5)}, DataError, "along_x"),
        ({"along_x": Profile([0.0], [0.0])}, TooFewSamplesError, "two"),
        ({"u_x": [1.0, 2.0]}, InvalidSamplesError, "each of the 5"),
        ({"u_x": -1.0}, InvalidSamplesError, ">= 0"),
    ],
)
def test_plane_map_refuses(change, error, match):
    line = Profile(np.arange(5) * MM, np.zeros(5))
    arguments = {"along_x": line, "along_y": line, "dx": MM, "dy": MM}

    with pytest.raises(error, match=match):
        plane_map(**{**arguments, **change})


# --- fit_plane_model --------------------------------------------------------------------------


def without_line(x, z):
    return z - np.polyval(np.polyfit(x, z, 1), x)


def sum_model(seed, n_y=9, n_x=13):
    rng = np.random.default_rng(seed)
    x, y = 2 * MM * np.arange(n_x), 50 * MM + 3 * MM * np.arange(n_y)
    f = without_line(x, 100 * NM * rng.standard_normal(n_x))
    g = without_line(y, 60 * NM * rng.standard_normal(n_y))
    alpha, beta = 3e-6, -5e-6
    z = 7e-6 + f + g[:, None] + alpha * (y[:, None] - y.mean()) + beta * (x - x.mean())
    return x, y, f, g, alpha, beta, z


def test_noise_free_parts_are_exact_and_keep_their_sign():
    x, y, f, g, alpha, beta, z = sum_model(1)

    fit = fit_plane_model(z, dx=2 * MM, dy=3 * MM, origin=(x[0], y[0]), u_reading=NM)

    assert np.max(np.abs(fit.along_x.z - f)) < 1e-9 * np.ptp(f)
    assert np.max(np.abs(fit.along_y.z - g)) < 1e-9 * np.ptp(g)
    assert fit.alpha.value == pytest.approx(alpha, rel=1e-9, abs=0.0)
    assert fit.beta.value == pytest.approx(beta, rel=1e-9, abs=0.0)
    assert np.max(np.abs(fit.model.z - z)) < 1e-15
    assert fit.interaction.share < 1e-12
    assert fit.along_y.x == pytest.approx(y, abs=1e-15)


def test_gaps_do_not_change_a_noise_free_answer():
    x, _, f, _, alpha, _, z = sum_model(2)
    z[np.random.default_rng(3).random(z.shape) < 0.3] = np.nan
    z[:, 4] = np.nan

    fit = fit_plane_model(z, dx=2 * MM, dy=3 * MM, u_reading=NM)

    used = np.delete(np.arange(x.size), 4)
    lined = without_line(x[used], (f - 5e-6 * x)[used])  # its line is that of the used columns
    assert np.max(np.abs(fit.along_x.z[used] - lined)) < 1e-9 * np.ptp(f)
    assert np.isnan(fit.along_x.z[4])
    assert np.isnan(fit.u_x.z[4])
    assert np.isnan(fit.model.z[:, 4]).all()
    assert fit.alpha.value == pytest.approx(alpha, rel=1e-9, abs=0.0)
    assert any("1 columns" in m for m in fit.messages)


def test_lines_on_a_grid_are_enough():
    """Three lines along x and two along y, everything else not measured."""
    _, _, f, g, _, _, z = sum_model(4)
    keep = np.zeros(z.shape, bool)
    keep[[0, 4, 8], :] = True
    keep[:, [2, 10]] = True

    fit = fit_plane_model(np.where(keep, z, np.nan), dx=2 * MM, dy=3 * MM, u_reading=NM)

    assert np.max(np.abs(fit.along_x.z - f)) < 1e-9 * np.ptp(f)
    assert np.max(np.abs(fit.along_y.z - g)) < 1e-9 * np.ptp(g)


def test_uncertainty_agrees_with_monte_carlo():
    """400 trials: sd within 3.5 %, three times that allowed."""
    _, _, f, g, alpha, _, z = sum_model(5)
    rng = np.random.default_rng(6)
    mask = rng.random(z.shape) < 0.2
    rest = []
    for _ in range(400):
        noisy = np.where(mask, np.nan, z + 10 * NM * rng.standard_normal(z.shape))
        fit = fit_plane_model(noisy, dx=2 * MM, dy=3 * MM, u_reading=10 * NM)
        rest.append([fit.along_x.z[3] - f[3], fit.along_y.z[1] - g[1], fit.alpha.value - alpha])

    drawn = np.std(rest, axis=0)
    stated = [fit.u_x.z[3], fit.u_y.z[1], fit.alpha.u]
    assert drawn == pytest.approx(stated, rel=0.11, abs=0.0)


@pytest.mark.slow
def test_f_test_keeps_its_level_without_coupling():
    """300 planes without coupling: p is uniform, for repeats and for single maps."""
    *_, z = sum_model(7)
    rng = np.random.default_rng(8)
    p_repeats, p_single = [], []
    for _ in range(300):
        noise = 10 * NM * rng.standard_normal((2, *z.shape))
        p_repeats.append(fit_plane_model(z + noise, dx=MM, dy=MM).interaction.p)
        p_single.append(fit_plane_model(z + noise[0], dx=MM, dy=MM).interaction.p)

    assert stats.kstest(p_repeats, "uniform").pvalue > 0.01
    assert stats.kstest(p_single, "uniform").pvalue > 0.01


def twist(z):
    n_y, n_x = z.shape
    return np.outer(np.linspace(-1, 1, n_y), np.linspace(-1, 1, n_x))


def test_planted_coupling_is_found_with_its_size():
    *_, z = sum_model(9)
    rng = np.random.default_rng(10)
    coupled = 30 * NM * twist(z)
    maps = z + coupled + 5 * NM * rng.standard_normal((3, *z.shape))

    fit = fit_plane_model(maps, dx=2 * MM, dy=3 * MM)

    assert fit.interaction.p < 1e-6
    assert fit.interaction.rms == pytest.approx(coupled.std(), rel=0.1, abs=0.0)
    assert any("2-D table" in m for m in fit.messages)
    assert fit.residual.z[0, 0] > 15 * NM  # sign of the twist: high where both are low
    assert fit.residual.z[0, -1] < -15 * NM


def test_single_map_finds_smooth_coupling_and_says_its_limit():
    *_, z = sum_model(11)
    rng = np.random.default_rng(12)

    fit = fit_plane_model(
        z + 15 * NM * twist(z) + 5 * NM * rng.standard_normal(z.shape), dx=MM, dy=MM
    )

    assert fit.interaction.p < 1e-4
    assert fit.noise.value == pytest.approx(5 * NM, rel=0.25, abs=0.0)
    assert any("measure the plane twice" in m for m in fit.messages)


def test_repeats_with_zeros_of_their_own_are_noticed():
    *_, z = sum_model(14)
    rng = np.random.default_rng(15)
    maps = z + 5 * NM * rng.standard_normal((3, *z.shape))
    moved = maps + np.array([0.0, 100 * NM, 200 * NM])[:, None, None]

    assert not any("zero" in m for m in fit_plane_model(maps, dx=MM, dy=MM).messages)
    assert any("take the mean off" in m for m in fit_plane_model(moved, dx=MM, dy=MM).messages)


def test_repeats_with_tilts_of_their_own_are_noticed():
    """Three repeats; noise alone raises no alarm in 60 draws."""
    *_, z = sum_model(16)
    ramp = (
        np.linspace(-1.0, 1.0, z.shape[0])[:, None] * np.array([-20.0, 0.0, 20.0])[:, None, None]
    )

    for seed in range(60):
        maps = z + 5 * NM * np.random.default_rng(seed).standard_normal((3, *z.shape))
        assert not any("tilt" in m for m in fit_plane_model(maps, dx=MM, dy=MM).messages)
    maps[1, 2, 3:] = np.nan
    told = fit_plane_model(maps + NM * ramp, dx=MM, dy=MM).messages
    assert sum("differ in tilt" in m for m in told) == 1
    assert "40" in told[-1] or "39" in told[-1] or "41" in told[-1]
    assert not any("tilt" in m for m in fit_plane_model(maps + NM, dx=MM, dy=MM).messages)


def test_disconnected_groups_are_refused():
    z = np.full((6, 6), np.nan)
    z[:3, :3] = 0.0
    z[3:, 3:] = 1e-6

    with pytest.raises(NotSeparableError, match="2 groups"):
        fit_plane_model(z, dx=MM, dy=MM, u_reading=NM)


@pytest.mark.parametrize(
    ("maps", "options", "error", "match"),
    [
        (np.zeros((5, 5)), {}, DataError, "dx and dy"),
        (np.zeros(5), {"dx": MM, "dy": MM}, DataError, "shape"),
        (np.zeros((2, 5)), {"dx": MM, "dy": MM}, TooFewSamplesError, "3"),
        (np.full((5, 5), np.nan), {"dx": MM, "dy": MM}, TooFewSamplesError, "0 measured rows"),
        (np.zeros((3, 3)), {"dx": MM, "dy": MM}, TooFewSamplesError, "repeats or u_reading"),
        (np.full((5, 5), np.inf), {"dx": MM, "dy": MM}, DataError, "infinite"),
        (np.zeros((5, 5)), {"dx": MM, "dy": MM, "u_reading": -1.0}, DataError, "u_reading"),
        (Surface(np.zeros((5, 5)), MM, MM), {"dx": MM}, DataError, "own steps"),
        (
            [Surface(np.zeros((5, 5)), MM, MM), Surface(np.zeros((4, 5)), MM, MM)],
            {},
            DataError,
            "differ",
        ),
    ],
)
def test_fit_refuses(maps, options, error, match):
    with pytest.raises(error, match=match):
        fit_plane_model(maps, **options)


def test_headline_plane_is_the_same_sum():
    """The headline example adds the axes by hand: rows are x lines there; the map agrees with it."""
    rng = np.random.default_rng(13)
    x, y = np.arange(0, 46) * MM, np.arange(0, 71) * MM
    e_x, e_y = (100 * NM * np.cumsum(rng.standard_normal(a.size)) / 5 for a in (x, y))
    by_hand = e_x[:, None] + e_y

    z = plane_map(Profile(x, e_x), Profile(y, e_y), dx=MM, dy=MM).surface.z

    assert np.max(np.abs(z.T - by_hand)) < 1e-15


# -- hostile review ------------------------------------------------------------------------------

AXIS = Profile([0.0, 1e-3, 2e-3], [0.0, 3e-9, 0.0])


def _fits():
    z = 1e-9 * np.random.default_rng(1).standard_normal((3, 6, 8))
    z[:, 2, 3] = np.nan
    step = Step("read", {"file": "a.csv"})
    x = Profile(AXIS.x, AXIS.z, history=(step,))
    gap = Profile(AXIS.x, [0.0, np.nan, 1e-9])
    return (
        plane_map(
            x, AXIS, dx=1e-3, dy=1e-3, u_x=1e-9, alpha=Quantity(1e-6, "rad", "tilt", u=1e-7)
        ),
        plane_map(gap, AXIS, dx=1e-3, dy=1e-3),
        fit_plane_model(z, dx=1e-3, dy=1e-3),
        fit_plane_model([Surface(m, 1e-3, 1e-3, history=(step,)) for m in z]),
        fit_plane_model(z[0], dx=1e-3, dy=1e-3, u_reading=1e-9),
    )


def test_results_are_plain_short_and_copied():
    for result in _fits():
        name = type(result).__name__
        json.dumps(result.to_dict(), allow_nan=False)
        assert repr(result).startswith(f"{name}(")
        assert "P-V" in repr(result)
        assert len(repr(result)) < 250
        assert "<table" in result._repr_html_()
        for again in (
            copy.copy(result),
            copy.deepcopy(result),
            pickle.loads(pickle.dumps(result)),  # noqa: S301
        ):
            assert again.to_dict() == result.to_dict()
            assert again.audit == result.audit
            surface = again.surface if name == "PlaneMap" else again.model
            assert type(surface) is Surface
            with pytest.raises(ValueError, match="read-only"):
                surface.z[0, 0] = 1.0
            with pytest.raises(TypeError):
                again.audit["a"] = 1


@pytest.mark.parametrize(
    ("options", "match"),
    [
        ({"dx": "2 V"}, "a length is needed"),
        ({"dy": None}, "dx and dy"),
        ({"dx": np.nan}, "positive"),
        ({"alpha": "1 V"}, "an angle is needed|a angle is needed"),
        ({"origin": 0.0}, "two finite numbers"),
        ({"u_x": "a"}, "u_x must be real numbers"),
        ({"u_x": 1e-9 + 1j}, "complex"),
    ],
)
def test_map_refuses_what_is_typed_wrong(options, match):
    with pytest.raises(DataError, match=match):
        plane_map(AXIS, AXIS, **{"dx": 1e-3, "dy": 1e-3, **options})


@pytest.mark.parametrize(
    ("maps", "options", "match"),
    [
        (np.zeros((5, 6)), {"dx": "2 V"}, "a length is needed"),
        (np.zeros((5, 6)), {"origin": "a"}, "two finite numbers"),
        (np.zeros((5, 6)), {"u_reading": "a"}, "u_reading 'a' is not a number"),
        (np.zeros((5, 6)) + 1j, {}, "complex"),
        ([[1.0, 2.0], [3.0]], {}, "real numbers"),
    ],
)
def test_fit_refuses_what_is_typed_wrong(maps, options, match):
    with pytest.raises(DataError, match=match):
        fit_plane_model(maps, **{"dx": 1e-3, "dy": 1e-3, **options})
