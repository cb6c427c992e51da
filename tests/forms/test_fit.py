"""The fit: planted freedoms come back with their signs, their uncertainty, and their ties."""

import tracemalloc

import numpy as np
import pytest

import metrosep as ms
from metrosep.core.errors import (
    DataError,
    DegenerateFitError,
    NotConvergedError,
    TooFewSamplesError,
)
from metrosep.forms.base import Form
from metrosep.forms.conic import Conic, Plane, Sphere
from metrosep.forms.fit import fit, remove
from metrosep.forms.points import PointSet
from metrosep.forms.polynomial import Polynomial
from metrosep.forms.sine_grid import SineGrid
from metrosep.forms.zernike import Zernike

EXACT = 1e-8
"""Relative, of a noise-free fit: acceptance row Z06."""
FM = 1e-15
"""m: a noise-free residual of millimetre sag is float64 rounding."""
PM = 1e-12
"""m."""

RIGID = ("piston", "tilt_x", "tilt_y")


def grid(n=81, half=10e-3):
    x = np.linspace(-half, half, n)
    return (*np.meshgrid(x, x * 0.8), x[1] - x[0], 0.8 * (x[1] - x[0]))


def centred(z, dx, dy):
    rows, columns = z.shape
    return ms.Surface(z, dx, dy, origin=(-dx * (columns - 1) / 2, -dy * (rows - 1) / 2))


def disc(step=0.2e-3):
    """Grid G12 of the acceptance table."""
    x = step * np.arange(-50, 51)
    X, Y = np.meshgrid(x, x)
    inside = X**2 + Y**2 <= 100e-6 * (1 + 1e-12)
    return X, Y, inside, step


# ---- truth -------------------------------------------------------------------------------------


@pytest.mark.parametrize("origin", [(-10e-3, -10e-3), (0.0, 0.0)])
def test_conic_comes_back(origin):
    """Acceptance Z06, with the origin declared and not."""
    X, Y, inside, step = disc()
    c, k = 1 / 50e-3, -1.2
    r2 = X**2 + Y**2
    z = np.where(inside, c * r2 / (1 + np.sqrt(1 - (1 + k) * c * c * r2)), np.nan)

    found = fit(ms.Surface(z, step, step, origin=origin), Conic())

    np.testing.assert_allclose(found.params["R"], 50e-3, rtol=EXACT, atol=0)
    np.testing.assert_allclose(found.params["k"], -1.2, rtol=EXACT, atol=0)
    assert found.rms < FM
    assert found.n_points == inside.sum()


def test_plane_is_that_of_textbook_least_squares(rng):
    X, Y, dx, dy = grid()
    z = 3e-6 + 2e-4 * X - 1e-4 * Y + 1e-8 * rng.standard_normal(X.shape)
    z[3:9, 5:30] = np.nan
    good = ~np.isnan(z)
    design = np.column_stack([np.ones(good.sum()), X[good], Y[good]])
    truth, rss = np.linalg.lstsq(design, z[good], rcond=None)[:2]

    found = fit(centred(z, dx, dy), Plane())

    np.testing.assert_allclose([found.params[n] for n in RIGID], truth, rtol=1e-10, atol=0)
    cov = np.linalg.inv(design.T @ design) * rss[0] / (good.sum() - 3)
    np.testing.assert_allclose(found.cov_white, cov, rtol=1e-8, atol=1e-30)
    assert found.dof == good.sum() - 3


def test_level_sine_grid_of_the_table():
    """Acceptance A11: Sq 49.9994 nm after the least-squares plane, not 50."""
    i = np.arange(500)
    wave = 0.05e-6 * np.cos(2 * np.pi * i / 100)
    X, Y = np.meshgrid(i * 1e-6, i * 1e-6)
    z = wave[None, :] + wave[:, None] + 2e-4 * X + 1e-4 * Y + 3e-6

    left = remove(ms.Surface(z, 1e-6, 1e-6), Plane())

    np.testing.assert_allclose(left.rms(), 49.9994e-9, rtol=1e-5, atol=0)


PLANTED = {
    "piston": 2e-6,
    "tilt_x": 1e-3,
    "tilt_y": -2e-3,
    "shift_x": 0.3e-3,
    "shift_y": -0.1e-3,
    "rotation_z": 0.05,
}


class Saddle(Form):
    """A surface without any symmetry, so that all six freedoms are seen."""

    name = "saddle"
    units = {}  # noqa: RUF012

    parameters = property(lambda self: {})

    def with_parameters(self, **values):
        assert not values
        return self

    def height(self, x, y):
        return 3.0 * x * x - 2.0 * y * y + 90.0 * x**3 + 40.0 * x * y * y + x * y

    def slopes(self, x, y):
        return 6.0 * x + 270.0 * x * x + 40.0 * y * y + y, -4.0 * y + 80.0 * x * y + x

    def derivatives(self, x, y, names):
        raise AssertionError("no parameter is free")


def test_each_freedom_has_its_sign_when_a_plane_is_the_tilt():
    """Planted by hand: turned counter-clockwise, then moved by +s, then raised by a plane."""
    X, Y, dx, dy = grid()
    c, s = np.cos(0.05), np.sin(0.05)
    u, v = X - PLANTED["shift_x"], Y - PLANTED["shift_y"]
    z = Saddle().height(c * u + s * v, c * v - s * u) + 2e-6 + 1e-3 * X - 2e-3 * Y

    found = fit(centred(z, dx, dy), Saddle(), free=tuple(PLANTED))

    for name, value in PLANTED.items():
        np.testing.assert_allclose(found.params[name], value, rtol=1e-7, atol=0, err_msg=name)
    assert found.rms < 10 * FM


def test_each_freedom_has_its_sign_when_the_form_is_turned():
    """Points of the form are turned by Rodrigues' formula and found again on the grid by Newton."""
    X, Y, dx, dy = grid(41)
    normal = np.array([-1e-3, 2e-3, 1.0])
    normal /= np.linalg.norm(normal)
    axis = np.cross([0.0, 0.0, 1.0], normal)
    K = np.array([[0, -axis[2], axis[1]], [axis[2], 0, -axis[0]], [-axis[1], axis[0], 0]])
    lean = np.eye(3) + K + K @ K / (1.0 + normal[2])
    c, s = np.cos(0.05), np.sin(0.05)
    R = lean @ np.array([[c, -s, 0], [s, c, 0], [0, 0, 1]])
    shift = np.array([PLANTED["shift_x"], PLANTED["shift_y"], PLANTED["piston"]])
    target = np.stack([X.ravel(), Y.ravel()])
    u = target.copy()
    for _ in range(20):  # find (u, v) of the form that lands on the grid
        p = R @ np.vstack([u, Saddle().height(*u)]) + shift[:, None]
        u = u - (p[:2] - target)
    z = p[2].reshape(X.shape)

    found = fit(centred(z, dx, dy), Saddle(), free=tuple(PLANTED), tilt="rotation")

    for name, value in PLANTED.items():
        np.testing.assert_allclose(found.params[name], value, rtol=1e-6, atol=0, err_msg=name)
    assert found.rms < 100 * FM
    np.testing.assert_allclose(found.evaluate(X, Y), z, rtol=0, atol=PM)


def test_turned_sphere_has_its_centre_where_geometry_puts_it():
    """A sphere that touches the tilted base plane at the origin has its centre at R n."""
    X, Y, dx, dy = grid()
    tx, ty, radius = 0.02, -0.01, 50e-3
    n = np.array([-tx, -ty, 1.0]) / np.sqrt(1 + tx**2 + ty**2)
    cx, cy, cz = radius * n
    z = cz - np.sqrt(radius**2 - (X - cx) ** 2 - (Y - cy) ** 2)

    found = fit(centred(z, dx, dy), Sphere(R=radius), free=("tilt_x", "tilt_y"), tilt="rotation")

    np.testing.assert_allclose(found.params["tilt_x"], tx, rtol=EXACT, atol=0)
    np.testing.assert_allclose(found.params["tilt_y"], ty, rtol=EXACT, atol=0)


def test_profile_need_not_be_uniform_and_keeps_its_coordinates(rng):
    x = np.sort(rng.uniform(20e-3, 30e-3, 300))
    z = Sphere(R=-80e-3)(x - 24e-3) + 5e-6

    found = fit(ms.Profile(x, z), Sphere(), free=("piston", "shift_x"))

    np.testing.assert_allclose(found.params["R"], -80e-3, rtol=EXACT, atol=0)
    np.testing.assert_allclose(found.params["shift_x"], 24e-3, rtol=EXACT, atol=0)
    np.testing.assert_allclose(found.params["piston"], 5e-6, rtol=1e-6, atol=0)


def test_scattered_points_in_any_order_and_twice(rng):
    x, y = rng.uniform(-10e-3, 10e-3, (2, 200))
    z = Sphere(R=70e-3)(x - 1e-3, y + 2e-3) + 4e-6
    z[7] = np.nan
    points = PointSet(np.append(x, x[3]), np.append(y, y[3]), np.append(z, z[3]))

    found = fit(points, Sphere(), free=("piston", "shift_x", "shift_y"))

    np.testing.assert_allclose(found.params["R"], 70e-3, rtol=EXACT, atol=0)
    np.testing.assert_allclose(found.params["shift_x"], 1e-3, rtol=EXACT, atol=0)
    np.testing.assert_allclose(found.params["shift_y"], -2e-3, rtol=EXACT, atol=0)
    assert found.n_points == 200
    assert isinstance(found.residual, PointSet)
    assert found.lmfit().success


def test_normal_deviation_is_the_distance_to_the_sphere():
    """A sphere of radius R + d is d away from one of R with the same centre, everywhere."""
    X, Y, dx, dy = grid()
    radius, d = 30e-3, 1e-7
    z = radius - np.sqrt((radius + d) ** 2 - X**2 - Y**2)  # same centre at z = R

    found = fit(
        centred(z, dx, dy), Sphere(R=radius), free=(), fixed={"piston": 0.0}, direction="normal"
    )

    np.testing.assert_allclose(found.residual.z, -d, rtol=1e-9, atol=0)


@pytest.mark.parametrize("form", [Plane(), Polynomial(1)])
@pytest.mark.parametrize("obj", ["map", "profile"])
def test_normal_deviation_from_a_steep_plane(form, obj, rng):
    """Total least squares: the smallest singular value is the root of the sum of squares."""
    x = np.linspace(-1e-3, 1e-3, 41)
    X, Y = np.meshgrid(x, x)
    noise = 1e-9 * rng.standard_normal(X.shape)
    if obj == "map":
        data = ms.Surface(0.5 * X + noise, 5e-5, 5e-5, origin=(x[0], x[0]))
        points = np.stack([X.ravel(), Y.ravel(), data.z.ravel()])
    else:
        data = ms.Profile(x, 0.5 * x + noise[0])
        points = np.stack([x, data.z])
    smallest = np.linalg.svd(points - points.mean(axis=1, keepdims=True))[1][-1]

    found = fit(data, form, direction="normal")

    np.testing.assert_allclose(found.rms, smallest / np.sqrt(points.shape[1]), rtol=1e-6, atol=0)
    assert found.to_dict()["direction"] == "normal"


def test_normal_fit_is_the_orthogonal_least_squares_of_scipy():
    """Profile of a conic, a circle fitted: centre and radius by geometric distances."""
    from scipy.optimize import least_squares

    x = np.linspace(-3e-3, 3e-3, 61)
    z = Conic(R=8e-3, k=-2.0)(x)

    def distances(p):
        return 1e6 * (p[1] - np.hypot(x, z - p[0] - p[1]))

    truth = least_squares(distances, [0.0, 8e-3], x_scale=[1e-6, 1e-3], xtol=1e-15, ftol=1e-15)

    found = fit(ms.Profile(x, z), Sphere(), free=("piston",), direction="normal")

    np.testing.assert_allclose(found.params["R"], truth.x[1], rtol=1e-7, atol=0)
    np.testing.assert_allclose(found.residual.z * 1e6, distances(truth.x), rtol=0, atol=1e-6)


def test_normal_fit_of_a_turned_form_and_large_residuals():
    x, y = np.linspace(-3e-3, 4e-3, 31), np.linspace(-2e-3, 3.5e-3, 23)
    X, Y = np.meshgrid(x, y)
    z = Conic(R=8e-3, k=-0.5)(X, Y)

    found = fit(
        PointSet(X.ravel(), Y.ravel(), z.ravel()),
        Sphere(R=8e-3),
        tilt="rotation",
        direction="normal",
    )

    centre = found.params["piston"] * np.array([0, 0, 1.0])
    t = np.array([-found.params["tilt_x"], -found.params["tilt_y"], 1.0])
    centre += 8e-3 * t / np.linalg.norm(t)
    from_centre = np.sqrt((X - centre[0]) ** 2 + (Y - centre[1]) ** 2 + (z - centre[2]) ** 2)
    np.testing.assert_allclose(found.residual.z, (8e-3 - from_centre).ravel(), rtol=0, atol=PM)


@pytest.mark.parametrize("seed", range(5))
@pytest.mark.parametrize("far", [0.3, 5.0])
def test_coordinates_far_from_zero(far, seed):
    X, Y = np.meshgrid(far + np.arange(61) * 5e-5, np.arange(41) * 7e-5)
    noise = 1e-10 * np.random.default_rng(seed).standard_normal(X.shape)
    z = Sphere(R=0.05)(X - far - 1.4e-3, Y - 1.6e-3) + noise

    found = fit(
        PointSet(X.ravel(), Y.ravel(), z.ravel()),
        Sphere(),
        free=("piston", "shift_x", "shift_y"),
    )

    assert abs(found.params["shift_x"] - far - 1.4e-3) < 6 * found.u["shift_x"] + 1e-15 * far
    np.testing.assert_allclose(found.rms, 1e-10, rtol=0.1, atol=0)


# ---- linear forms: no iteration ----------------------------------------------------------------


def test_polynomial_of_a_profile_far_from_its_origin():
    """NIST StRD Wampler1, and the same 1 m away: the residual keeps its digits."""
    x = np.arange(21.0)
    z = sum(x**k for k in range(6))

    found = fit(ms.Profile(x, z), Polynomial(5))

    assert list(found.params) == ["c0", "c1", "c2", "c3", "c4", "c5"]
    np.testing.assert_allclose(list(found.params.values()), 1.0, rtol=0, atol=1e-8)
    far = ms.Profile(1.0 + 1e-3 * x, 1e-9 * z)
    assert fit(far, Polynomial(5)).rms < 1e-16  # positions near 1 m are rounded to 1e-16 m


def test_polynomial_of_a_map_is_that_of_dense_least_squares(rng):
    X, Y, dx, dy = grid(41)
    z = 1e-3 * X + 3.0 * X * Y - 50.0 * Y**3 + 1e-8 * rng.standard_normal(X.shape)
    z[4:9, 20:25] = np.nan
    good = ~np.isnan(z)
    powers = [(i, j) for i in range(4) for j in range(4 - i)]
    design = np.column_stack([(X[good] / 1e-2) ** i * (Y[good] / 1e-2) ** j for i, j in powers])
    truth, rss, *_ = np.linalg.lstsq(design, z[good], rcond=None)
    cov = np.linalg.inv(design.T @ design) * rss[0] / (good.sum() - len(powers))

    found = fit(centred(z, dx, dy), Polynomial(3))

    for k, (i, j) in enumerate(powers):
        name, scale = f"c_{i}_{j}", 1e-2 ** (i + j)
        np.testing.assert_allclose(found.params[name] * scale, truth[k], rtol=1e-9, atol=1e-19)
        np.testing.assert_allclose(
            found.u_white[name] * scale, np.sqrt(cov[k, k]), rtol=1e-7, atol=0
        )
    np.testing.assert_allclose(found.rms, np.sqrt(rss[0] / good.sum()), rtol=1e-9, atol=0)
    assert "piston" not in found.params


def test_zernike_terms_come_back_on_a_map_without_origin():
    x = np.linspace(-1, 1, 101)
    X, Y = np.meshgrid(x, x)
    rho2 = X**2 + Y**2
    z = np.where(rho2 <= 1, 3e-7 * (2 * rho2 - 1) - 1e-7 * (X**2 - Y**2) + 2e-6, np.nan)

    found = fit(ms.Surface(z, 1e-4, 1e-4), Zernike(9, "fringe", radius=5e-3))

    np.testing.assert_allclose(found.params["Z1"], 2e-6, rtol=1e-10, atol=0)
    np.testing.assert_allclose(found.params["Z4"], 3e-7, rtol=1e-10, atol=0)
    np.testing.assert_allclose(found.params["Z5"], -1e-7, rtol=1e-10, atol=0)
    assert found.rms < 1e-18


def test_explicit_piston_of_a_polynomial_is_its_own():
    X, _, dx, dy = grid(21)

    found = fit(centred(1e-6 + 1e-3 * X, dx, dy), Polynomial(2), free=RIGID)

    assert "piston" in found.notes[0]
    np.testing.assert_allclose(found.params["c_0_0"], 1e-6, rtol=1e-9, atol=0)


@pytest.mark.parametrize("what", ["map", "profile", "points"])
def test_robust_polynomial_is_not_moved_by_dust(what, rng):
    X, Y, dx, dy = grid(41)
    truth = 5.0 * X**2 + 1e-3 * Y
    noise = 1e-9 * rng.standard_normal(X.shape)
    dust = np.where(rng.random(X.shape) < 0.1, rng.uniform(1e-7, 3e-6, X.shape), 0.0)
    z = truth + noise + dust
    if what == "map":
        obj = centred(z, dx, dy)
    elif what == "profile":
        obj, truth = ms.Profile(X[20], z[20] - truth[20] + 5.0 * X[20] ** 2), 5.0 * X[20] ** 2
    else:
        obj, truth = PointSet(X.ravel(), Y.ravel(), z.ravel()), truth.ravel()

    found = fit(obj, Polynomial(2), robust="tukey")

    ideal = obj.z - found.residual.z
    assert np.abs(ideal - truth).max() < 2e-9


# ---- uncertainty ---------------------------------------------------------------------------------


@pytest.mark.slow
def test_covariance_is_the_scatter_of_repeated_fits():
    X, Y, dx, dy = grid(31)
    truth = Conic(R=40e-3, k=-0.5)(X, Y)
    results = []
    for seed in range(200):
        noise = 2e-9 * np.random.default_rng(seed).standard_normal(X.shape)
        results.append(fit(centred(truth + noise, dx, dy), Conic(k=-0.5)))
    values = np.array([[r.params[n] for n in r.names] for r in results])
    stated = np.mean([[r.u[n] for n in r.names] for r in results], axis=0)

    # The standard deviation of 200 draws is known to 5 %: four times that. A map of 31 pixels does not
    # exclude all that rises towards low frequencies, so u is up to a third above the scatter of white noise.
    larger = stated / values.std(axis=0, ddof=1)
    assert np.all((larger > 0.8) & (larger < 1.35)), larger
    np.testing.assert_allclose(
        np.corrcoef(values.T), np.mean([r.correlations for r in results], axis=0), rtol=0, atol=0.2
    )


def test_u_of_a_long_profile_needs_little_memory(rng):
    """A bin for every square of a lag, of which most are empty, was 0.6 GB and seconds."""
    x = np.arange(4000) * 1e-6
    found = fit(ms.Profile(x, 1e-9 * rng.standard_normal(x.size)), Plane())
    tracemalloc.start()
    try:
        assert 0.0 < found.u["piston"] < 1e-9
        peak = tracemalloc.get_traced_memory()[1]
    finally:
        tracemalloc.stop()

    assert peak < 100e6  # bytes


def test_robust_fit_is_not_moved_by_dust(rng):
    X, Y, dx, dy = grid()
    noise = 1e-9 * rng.standard_normal(X.shape)
    z = Sphere(R=60e-3)(X, Y) + 1e-6 + noise
    dust = rng.random(X.shape) < 0.1
    clean = fit(centred(np.where(dust, np.nan, z), dx, dy), Sphere())
    z = np.where(dust, z + rng.uniform(0.1e-6, 3e-6, X.shape), z)

    plain = fit(centred(z, dx, dy), Sphere())
    for rule in ("tukey", "huber"):
        found = fit(centred(z, dx, dy), Sphere(), robust=rule)

        assert abs(plain.params["piston"] - 1e-6) > 100e-9
        assert abs(found.params["piston"] - 1e-6) < (0.1e-9 if rule == "tukey" else 1e-9)
        assert 0.8 < found.u["R"] / clean.u["R"] < 2.5 if rule == "tukey" else True
        assert found.robust == rule


@pytest.mark.parametrize(
    ("form", "rule", "share"),
    [
        pytest.param(Plane(), "tukey", 0.0, marks=pytest.mark.slow),
        pytest.param(Plane(), "tukey", 0.2, marks=pytest.mark.slow),
        pytest.param(Plane(), "huber", 0.1, marks=pytest.mark.slow),
        pytest.param(Polynomial(1), "tukey", 0.1, marks=pytest.mark.slow),
        pytest.param(Polynomial(1), "huber", 0.0, marks=pytest.mark.slow),
    ],
)
def test_uncertainty_of_a_robust_fit_is_its_scatter(form, rule, share):
    X, _, dx, dy = grid(15)
    values, stated = [], []
    for seed in range(120):
        rng = np.random.default_rng(seed)
        z = 10e-9 * rng.standard_normal(X.shape) + 1e-6 * (rng.random(X.shape) < share)
        found = fit(centred(z, dx, dy), form, robust=rule)
        name = "piston" if "piston" in found.params else "c_0_0"
        values.append(found.params[name])
        stated.append(found.u[name])

    # the standard deviation of 120 draws is known to 6.5 %: four times that
    np.testing.assert_allclose(np.std(values) / np.mean(stated), 1.0, rtol=0, atol=0.26)


@pytest.mark.parametrize("height", [0.1e-6, 1e-6])
@pytest.mark.parametrize("form", [Plane(), Polynomial(1)])
def test_a_third_of_the_points_on_a_step_does_not_win(height, form):
    X, _, dx, dy = grid(23)
    wrong = 0
    for seed in range(10):
        rng = np.random.default_rng(seed)
        z = 10e-9 * rng.standard_normal(X.shape) + height * (rng.random(X.shape) < 0.33)
        found = fit(centred(z, dx, dy), form, robust="tukey")
        name = "piston" if "piston" in found.params else "c_0_0"
        wrong += abs(found.params[name]) > 4e-9

    assert wrong == 0


def test_robust_zernike_of_a_wrong_form_settles(rng):
    """Structure that no term holds is not noise, but it must not keep the weights from settling."""
    X, Y, dx, dy = grid(31, half=3e-3)
    z = Conic(R=8e-3, k=-0.5)(X, Y) + 10e-9 * rng.standard_normal(X.shape)

    found = fit(centred(z, dx, dy), Zernike(10), robust="tukey")

    assert found.robust == "tukey"


def test_robust_fit_of_exact_data_with_one_spike_is_exact():
    x = np.linspace(-1e-3, 1e-3, 101)
    z = 3e-6 + 1e-3 * x
    z[30] += 1e-3

    found = fit(ms.Profile(x, z), Plane(), robust="tukey")

    np.testing.assert_allclose(found.params["piston"], 3e-6, rtol=0, atol=PM)
    np.testing.assert_allclose(found.params["tilt_x"], 1e-3, rtol=1e-6, atol=0)


def test_lmfit_agrees(rng):
    x = np.linspace(-4e-3, 5e-3, 120)
    z = Conic(R=20e-3, k=0.7)(x - 0.2e-3) + 1e-6 + 1e-9 * rng.standard_normal(x.size)
    found = fit(ms.Profile(x, z), Conic(), free=("piston", "shift_x"))

    second = found.lmfit()

    for name in found.names:
        assert abs(second.params[name].value - found.params[name]) < 0.01 * found.u[name]
        np.testing.assert_allclose(
            second.params[name].stderr, found.u_white[name], rtol=0.02, atol=0
        )


# ---- starts and ties -----------------------------------------------------------------------------


@pytest.mark.parametrize("shift", [0.4, 37.0, -45.0])
def test_grid_is_found_wherever_it_lies(shift):
    x = np.arange(300) * 1e-6
    X, Y = np.meshgrid(x, x)
    form = SineGrid(amplitude=50e-9, wavelength=100e-6)
    z = form(X - shift * 1e-6, Y - 20e-6) + 1e-6
    z[50:80, 100:140] = np.nan

    found = fit(ms.Surface(z, 1e-6, 1e-6), form, free=("piston", "shift_x", "shift_y"))

    period = 100e-6
    off = [(found.params["shift_x"] - shift * 1e-6), (found.params["shift_y"] - 20e-6)]
    np.testing.assert_allclose(
        [o - period * round(o / period) for o in off], 0, rtol=0, atol=1e-11
    )
    assert sum("whole periods" in w for w in found.warnings) == 2


def test_shift_and_tilt_of_a_sphere_are_said_to_hang_together(rng):
    X, Y, dx, dy = grid()
    z = Sphere(R=500e-3)(X, Y) + 1e-9 * rng.standard_normal(X.shape)

    found = fit(centred(z, dx, dy), Sphere(R=500e-3), free=(*RIGID, "shift_x"))

    assert any("shift_x and tilt_x" in w or "tilt_x and shift_x" in w for w in found.warnings)


def test_freedom_without_effect_is_named():
    X, Y, dx, dy = grid()

    with pytest.raises(DegenerateFitError, match="rotation_z changes nothing"):
        fit(
            centred(Sphere(R=50e-3)(X, Y), dx, dy),
            Sphere(R=50e-3),
            free=("piston", "rotation_z"),
        )


def test_plane_cannot_tell_its_shift():
    X, _, dx, dy = grid()

    with pytest.raises(DegenerateFitError, match="shift_x"):
        fit(centred(1e-3 * X, dx, dy), Plane(), free=(*RIGID, "shift_x"))


def test_tilted_lens_is_told_about_rotation():
    X, Y, dx, dy = grid()
    z = Sphere(R=50e-3)(X, Y) + 2e-3 * X

    found = fit(centred(z, dx, dy), Sphere(R=50e-3))

    assert any("tilt='rotation'" in w for w in found.warnings)


# ---- invariances ---------------------------------------------------------------------------------


@pytest.mark.parametrize("scale", [1e-6, 1e-3, 1e3])
def test_a_fit_in_other_units_is_the_same_fit(scale, rng):
    X, Y, dx, dy = grid(41)
    z = Conic(R=50e-3, k=-1.2)(X - 1e-4, Y) + 1e-8 * rng.standard_normal(X.shape)
    free = ("piston", "shift_x", "shift_y", "R", "k")
    one = fit(centred(z, dx, dy), Conic(), free=free)

    other = fit(centred(z * scale, dx * scale, dy * scale), Conic(), free=free)

    for name in one.names:
        factor = 1.0 if name == "k" else scale
        np.testing.assert_allclose(
            other.params[name], one.params[name] * factor, rtol=1e-6, atol=0
        )
        np.testing.assert_allclose(other.u[name], one.u[name] * factor, rtol=1e-6, atol=0)


def test_nan_rows_are_as_if_cropped(rng):
    X, Y, dx, dy = grid(41)
    z = Conic(R=50e-3, k=-1.2)(X, Y) + 1e-8 * rng.standard_normal(X.shape)
    z[30:] = np.nan
    whole = centred(z, dx, dy)
    part = ms.Surface(z[:30], dx, dy, origin=whole.origin)

    a, b = fit(whole, Conic()), fit(part, Conic())

    for name in a.names:
        np.testing.assert_allclose(a.params[name], b.params[name], rtol=1e-9, atol=1e-18)


def test_sample_and_all_points_give_one_answer(rng):
    """A map of more than 200 000 points starts on 20 000 of them and must not show it."""
    X, Y, dx, dy = grid(480)
    z = Conic(R=50e-3, k=-1.2)(X, Y) + 1e-9 * rng.standard_normal(X.shape)
    design = [np.ones(X.size), X.ravel(), Y.ravel()]
    found = fit(centred(z, dx, dy), Conic(R=50e-3, k=-1.2))

    left = z - Conic(R=50e-3, k=-1.2)(X, Y)
    truth = np.linalg.lstsq(np.column_stack(design), left.ravel(), rcond=None)[0]

    np.testing.assert_allclose([found.params[n] for n in RIGID], truth, rtol=1e-6, atol=1e-16)


# ---- what is recorded ----------------------------------------------------------------------------


def test_result_says_what_it_is(rng):
    X, Y, dx, dy = grid(21)
    z = Sphere(R=50e-3)(X, Y) + 1e-9 * rng.standard_normal(X.shape)
    surface = centred(z, dx, dy)

    found = fit(surface, Sphere(), fixed={"tilt_y": 0.0}, free=("piston", "tilt_x"))

    assert found.names == ("piston", "tilt_x", "R")
    assert found.residual.history[-1].name == "fit sphere"
    assert found.residual.origin == surface.origin
    frame = found.to_frame()
    assert frame.loc["R", "unit"] == "m"
    assert not frame.loc["tilt_y", "free"]
    text = found.report()
    assert "RMS" in text
    assert "held" in text
    plain = found.to_dict()
    assert plain["parameters"]["R"]["free"]
    np.testing.assert_allclose(found.evaluate(X, Y) + found.residual.z, z, rtol=0, atol=FM)


# ---- bad input -----------------------------------------------------------------------------------


def flat(n=5):
    return ms.Surface(np.zeros((n, n)), 1e-6, 1e-6)


@pytest.mark.parametrize(
    ("options", "error", "match"),
    [
        ({"free": ("wobble",)}, DataError, "no freedom 'wobble'"),
        ({"free": ("piston", "piston")}, DataError, "twice"),
        ({"free": ("piston",), "fixed": {"piston": 0.0}}, DataError, "free and fixed"),
        ({"fixed": {"tilt_x": np.nan}}, DataError, "finite"),
        ({"tilt": "wedge"}, DataError, "tilt is one of"),
        ({"robust": "median"}, DataError, "robust is one of"),
        ({"direction": "up"}, DataError, "direction"),
        ({"start": {"shift_x": 0.0}}, DataError, "not free"),
        ({"start": [1]}, DataError, "maps names"),
        ({"start": {"piston": np.inf}}, DataError, "start"),
        ({"fixed": "R"}, DataError, "maps names"),
        ({"fixed": {"piston": "five"}}, DataError, "number with a unit"),
        ({"fixed": {"piston": None}}, DataError, "number in SI"),
        ({"fixed": {"dz": 0.0, "piston": 0.0}}, DataError, "twice"),
        ({"free": 5}, DataError, "list of names"),
        ({"centre": (np.nan, 0.0)}, DataError, "centre"),
        ({"centre": 3}, DataError, "centre"),
        ({"centre": (0.0,)}, DataError, "centre"),
    ],
)
def test_wrong_options_are_named(options, error, match):
    with pytest.raises(error, match=match):
        fit(flat(), Plane(), **options)


def test_what_is_fixed_is_not_free_by_default():
    found = fit(flat(), Plane(), fixed={"tilt_y": 0.0})

    assert found.names == ("piston", "tilt_x")


def test_aliases_start_too():
    found = fit(flat(), Plane(), start={"dz": 1e-6})

    assert found.params["piston"] == 0.0


def test_all_terms_may_be_started_or_fixed():
    values = dict.fromkeys(("Z0", "Z1", "Z2"), 0.0)

    assert fit(flat(), Zernike(3), start=values).rms < 1e-20
    assert fit(flat(), Zernike(3), fixed=values).names == ("piston", "tilt_x", "tilt_y")


def test_legendre_coefficients_without_a_domain_mean_nothing():
    with pytest.raises(DataError, match="domain"):
        fit(
            flat(),
            Polynomial(1, basis="legendre"),
            fixed={"L_0_0": 0.0, "L_1_0": 0.0, "L_0_1": 0.0},
        )


def test_wrong_objects_are_named():
    with pytest.raises(DataError, match="Surface, a Profile or a PointSet"):
        fit(np.zeros((3, 3)), Plane())
    with pytest.raises(DataError, match="plan"):
        fit(flat(), "plan")
    with pytest.raises(DataError, match="calibration"):
        fit(ms.Surface(np.zeros((3, 3))), Plane())
    with pytest.raises(DataError, match="all points have the same y, so there is no"):
        fit(ms.Profile([0, 1e-3, 2e-3], [0, 0, 0]), Plane(), free=("tilt_y",))


def test_nothing_measured_and_too_little_measured():
    with pytest.raises(TooFewSamplesError, match="no sample"):
        fit(ms.Surface(np.full((3, 3), np.nan), 1e-6, 1e-6), Plane())
    one = np.full((3, 3), np.nan)
    one[1, 1] = 1e-9
    with pytest.raises(DegenerateFitError, match="at least 3 points"):
        fit(ms.Surface(one, 1e-6, 1e-6), Plane())
    row = np.full((5, 5), np.nan)
    row[2] = 0.0
    with pytest.raises(DegenerateFitError, match="tilt_y"):
        fit(ms.Surface(row, 1e-6, 1e-6), Plane())


def test_as_many_points_as_freedoms_have_no_uncertainty():
    z = np.full((2, 2), 0.0)
    z[0, 1], z[1, 1] = 1e-9, np.nan

    found = fit(ms.Surface(z, 1e-6, 1e-6), Plane())

    assert found.dof == 0
    assert all(np.isnan(v) for v in found.u.values())
    assert found.to_dict()["parameters"]["piston"]["u"] is None


def test_points_beyond_the_sphere_are_counted():
    X, Y, dx, dy = grid()
    z = Sphere(R=11e-3)(X, Y)
    z[np.isnan(z)] = 0.0

    found = fit(centred(z, dx, dy), Sphere(R=11e-3), free=("piston",))

    outside = int((X**2 + Y**2 > 121e-6).sum())
    assert outside > 0
    assert f"{outside} of" in found.notes[0]
    assert found.n_points == X.size - outside


def test_integers_are_heights_too():
    found = fit(ms.Profile([0, 1, 2, 3], [1, 2, 3, 5]), Plane())

    np.testing.assert_allclose(found.params["tilt_x"], 1.3, rtol=1e-12, atol=0)


def test_too_few_iterations_are_an_error():
    X, Y, dx, dy = grid(31)
    z = Conic(R=20e-3, k=-4.0)(X - 1e-3, Y)

    with pytest.raises(NotConvergedError, match="did not settle"):
        fit(
            centred(z, dx, dy),
            Conic(R=200e-3, k=3.0),
            free=("piston", "shift_x", "R", "k"),
            start={"R": 200e-3, "k": 3.0},
            max_iterations=1,
        )


# ---- where the form is centred, and what is free, if nothing is said ---------------------------


def fringe(X, Y, terms=(4, 7, 9), coefficients=(300e-9, -50e-9, 100e-9)):
    return Zernike(terms, "fringe", coefficients=coefficients, radius=10e-3)(X, Y)


@pytest.mark.parametrize("form", [Sphere(), Conic(k=-1.2), Zernike(9, "fringe"), Polynomial(4)])
@pytest.mark.parametrize(
    "margin", [((0, 0), (40, 0)), ((13, 0), (0, 0)), ((7, 2), (1, 30))], ids=["left", "low", "all"]
)
def test_a_margin_of_nan_changes_nothing(form, margin):
    X, Y, inside, step = disc()
    z = np.where(inside, Sphere(R=70e-3)(X, Y) + 1e-4 * X + 20e-9 * np.sin(900.0 * X + Y), np.nan)
    cropped = fit(ms.Surface(z, step, step), form)

    padded = fit(ms.Surface(np.pad(z, margin, constant_values=np.nan), step, step), form)

    (low, high), (left, right) = margin
    ny, nx = padded.residual.shape
    same = padded.residual.z[low : ny - high, left : nx - right]
    assert np.nanmax(np.abs(same - cropped.residual.z)) < FM
    if form.has_centre:
        expected = cropped.centre[0] + left * step, cropped.centre[1] + low * step
        assert padded.centre == pytest.approx(expected, abs=1e-12)
        told = [n for n in padded.notes if "middle of what was measured" in n]
        assert len(told) == 1
        assert not any("middle of what" in n for n in cropped.notes)
        for name, value in cropped.params.items():
            assert padded.params[name] == pytest.approx(value, rel=EXACT, abs=FM)


def test_a_declared_origin_or_centre_is_not_moved_by_a_margin():
    X, Y, inside, step = disc()
    z = np.where(inside, fringe(X, Y), np.nan)[:, 30:]  # an edge is missing
    known = centred(np.pad(z, ((0, 0), (30, 0)), constant_values=np.nan), step, step)

    for found in (
        fit(known, Zernike(9, "fringe", radius=10e-3)),
        fit(
            ms.Surface(z, step, step),
            Zernike(9, "fringe", radius=10e-3),
            centre=(20 * step, 50 * step),
        ),
    ):
        assert found.params["Z7"] == pytest.approx(-50e-9, abs=FM)
        assert found.params["Z4"] == pytest.approx(300e-9, abs=FM)
        assert not found.notes


@pytest.mark.parametrize("radius", [10e-3, None])
@pytest.mark.parametrize("robust", [None, "tukey"])
def test_terms_without_piston_and_tilt_are_fitted_beside_them(radius, robust):
    X, Y, _, step = disc()
    z = np.where(np.hypot(X, Y) < 10.01e-3, fringe(X, Y), np.nan) + 1e-6 + 2e-5 * X - 1e-5 * Y

    found = fit(centred(z, step, step), Zernike((4, 7, 9), "fringe", radius=radius), robust=robust)

    planted = {"piston": 1e-6, "tilt_x": 2e-5, "tilt_y": -1e-5}
    planted |= {"Z4": 300e-9, "Z7": -50e-9, "Z9": 100e-9}
    assert found.params == pytest.approx(planted, rel=EXACT, abs=FM)
    assert not found.warnings


def test_terms_that_hold_the_piston_have_no_other_freedom():
    X, _, inside, step = disc()
    z = np.where(inside, 1e-6 + 2e-5 * X, np.nan)

    assert fit(centred(z, step, step), Zernike(1)).names == ("Z0",)
    assert fit(centred(z, step, step), Polynomial(0)).names == ("c_0_0",)


# ---- a sag that is millions of residuals high --------------------------------------------------


@pytest.mark.parametrize("robust", ["tukey", "huber", None])
@pytest.mark.parametrize("noise", [1e-9, 1e-10, 1e-11])
@pytest.mark.parametrize("form", [Sphere(), Conic(), Conic(R=50e-3, k=-0.7)], ids=repr)
def test_the_last_steps_are_taken_where_rounding_hides_their_gain(form, noise, robust):
    x = np.linspace(-6e-3, 6e-3, 61)
    X, Y = np.meshgrid(x, x)
    truth = Sphere(R=50e-3) if isinstance(form, Sphere) else Conic(R=50e-3, k=-0.7)
    for seed in range(3):
        z = truth(X - 1e-4, Y + 2e-4) + noise * np.random.default_rng(seed).normal(size=X.shape)

        found = fit(
            centred(z, x[1] - x[0], x[1] - x[0]),
            form,
            free=("piston", "shift_x", "shift_y"),
            robust=robust,
        )

        planted = {"shift_x": 1e-4, "shift_y": -2e-4, "R": 50e-3, "k": -0.7}
        for name in found.names:
            off = found.params[name] - planted.get(name, 0.0)
            assert abs(off) < 5.0 * found.u[name], name
        assert found.rms == pytest.approx(noise, rel=0.05, abs=0.0)


@pytest.mark.parametrize("radius", [5.0, 10.0])
def test_shift_and_tilt_of_a_shallow_sphere_are_named(radius):
    x = np.linspace(-6e-3, 6e-3, 61)
    X, Y = np.meshgrid(x, x)
    z = Sphere(R=radius)(X, Y) + 1e-9 * np.random.default_rng(3).normal(size=X.shape)

    with pytest.raises(
        (DegenerateFitError, NotConvergedError), match=r"shift_x (from|and) tilt_x"
    ):
        fit(
            centred(z, x[1] - x[0], x[1] - x[0]),
            Sphere(),
            free=("piston", "tilt_x", "shift_x"),
        )


def test_what_is_held_may_be_a_text_with_its_unit():
    x = np.linspace(-5e-3, 5e-3, 101)
    line = ms.Profile(x, 1e-6 + Sphere(R=50e-3)(x))
    text = fit(line, Sphere(), fixed={"R": "50 mm"}, centre=("0 mm", 0.0))

    assert text.params == fit(line, Sphere(), fixed={"R": 50e-3}, centre=(0.0, 0.0)).params


@pytest.mark.parametrize("value", [True, "50", b"51", "50 kg"])
@pytest.mark.parametrize("option", ["fixed", "start"])
def test_a_radius_that_is_no_number_is_never_metres(option, value):
    """A "50" of a text field meant mm, and True is not a radius: both were held as 50 m and 1 m."""
    map_ = ms.Surface(np.zeros((20, 20)), 1e-6, 1e-6)

    with pytest.raises(DataError, match=r"\['R'\]|unknown unit 'kg'"):
        fit(map_, Sphere(), **{option: {"R": value}})
    with pytest.raises(DataError, match=r"centre|unknown unit 'kg'"):
        fit(map_, Sphere(), centre=(value, 0.0))


@pytest.mark.parametrize("height", [0.0, 1e-6, 3e-7, -1e-3])
@pytest.mark.parametrize("shape", [(50, 60), (64, 64), (41, 37)])
@pytest.mark.parametrize("form", ["conic", "toric"])
def test_a_constant_map_has_an_infinite_radius(height, shape, form):
    found = fit(ms.Surface(np.full(shape, height), 1e-4, 1e-4), form)
    radii = [n for n in found.names if n.startswith("R")]
    assert radii
    for name in radii:
        line = next(t for t in found.report().splitlines() if t.split()[0] == name)
        assert line.split()[1:] == ["infinite", "a", "flat:", "see", f"c{name[1:]}", "for", "u"]
        assert found.params[f"c{name[1:]}"] == 0.0
        assert found.to_dict()["parameters"][name]["value"] is None
        assert f"<th style='text-align:left;padding-right:1em'>{name}</th><td>infinite<" in (
            found._repr_html_()
        )


@pytest.mark.parametrize("sign", [1, -1])
def test_a_sag_above_the_last_digit_is_a_radius(sign):
    x, y, dx, dy = grid(41)
    R = sign * 1e9  # m: 41 fm of sag on 100 nm, where the last digit is 1e-23 m
    found = fit(centred(1e-7 + (x * x + y * y) / (2.0 * R), dx, dy), "sphere")
    assert found.params["R"] == pytest.approx(R, abs=1e-6 * abs(R))
