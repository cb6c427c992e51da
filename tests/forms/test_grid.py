"""Height map as a form: polynomials are exact, missing pixels end the domain and leak nowhere."""

import numpy as np
import pytest

from metrosep.core.errors import DataError, DegenerateFitError, TooFewSamplesError
from metrosep.core.surface import Surface
from metrosep.forms.conic import Conic
from metrosep.forms.stl import GridForm

DX, DY = 1e-3, 2e-3
ORIGIN = (-10e-3, 5e-3)
ROUNDING = 1e-14
"""Of the size of the map; solving for spline coefficients costs a digit."""


def cubic(x, y):
    """A polynomial of third degree in x and in y, asymmetric, in m over 20 mm."""
    u, v = x / 10e-3, y / 10e-3
    return 1e-6 * (1 + u - 2 * v + 0.5 * u * u * v - u**3 + 0.3 * v**3 * u**2)


def cubic_slopes(x, y):
    u, v = x / 10e-3, y / 10e-3
    return (
        1e-4 * (1 + u * v - 3 * u * u + 0.6 * v**3 * u),
        1e-4 * (-2 + 0.5 * u * u + 0.9 * v * v * u * u),
    )


@pytest.fixture
def nodes():
    return np.meshgrid(ORIGIN[0] + DX * np.arange(21), ORIGIN[1] + DY * np.arange(9))


@pytest.fixture
def surface(nodes):
    return Surface(cubic(*nodes), dx=DX, dy=DY, origin=ORIGIN)


@pytest.fixture
def inside(rng):
    return rng.uniform(-10e-3, 10e-3, 300), rng.uniform(5e-3, 21e-3, 300)


def test_cubic_polynomials_are_exact(surface, inside):
    form = GridForm(surface)
    size = surface.peak_to_valley()

    gx, gy = form.gradient(*inside)

    assert np.abs(form(*inside) - cubic(*inside)).max() < ROUNDING * size
    assert np.abs(gx - cubic_slopes(*inside)[0]).max() < 10 * ROUNDING * size / DX
    assert np.abs(gy - cubic_slopes(*inside)[1]).max() < 10 * ROUNDING * size / DX


def test_map_comes_back_at_its_pixels(surface, nodes):
    assert np.abs(GridForm(surface)(*nodes) - surface.z).max() < 1e-20


def test_gradient_is_the_derivative_of_the_height(rng):
    """Fourth-order differences of a rough map, where the gradient is that of the spline."""
    form = GridForm(Surface(rng.normal(size=(9, 11)), dx=1.0, dy=1.0))
    x, y, h = rng.uniform(1.1, 8.9, 200), rng.uniform(1.1, 6.9, 200), 1e-3
    away = (np.abs(x - np.round(x)) > 2 * h) & (np.abs(y - np.round(y)) > 2 * h)  # of knots
    x, y = x[away], y[away]

    gx, gy = form.gradient(x, y)

    for slope, ex, ey in ((gx, h, 0.0), (gy, 0.0, h)):
        near = form(x + ex, y + ey) - form(x - ex, y - ey)
        far = form(x + 2 * ex, y + 2 * ey) - form(x - 2 * ex, y - 2 * ey)
        np.testing.assert_allclose(slope, (8 * near - far) / (12 * h), rtol=0.0, atol=1e-11)


def test_outside_the_map_is_nan(surface):
    form = GridForm(surface)

    z = form([-10e-3, -10.1e-3, 10e-3, 10.1e-3, 0.0, 0.0], [5e-3] * 4 + [4.9e-3, 21.1e-3])

    assert np.isnan(z).tolist() == [False, True, False, True, True, True]
    assert np.isnan(form(np.nan, 6e-3)).all()


def test_missing_pixels_end_the_domain(surface):
    z = surface.z.copy()
    z[4, 10] = np.nan  # at x = 0, y = 13 mm
    form = GridForm(Surface(z, dx=DX, dy=DY, origin=ORIGIN))

    found = form(
        [0.0, 0.5e-3, 1e-3, 1.5e-3, 0.5e-3, 0.5e-3], [13e-3, 13e-3, 13e-3, 13e-3, 14e-3, 15e-3]
    )

    assert np.isnan(found).tolist() == [True, True, False, False, True, False]
    assert np.isnan(form.gradient(0.0, 13e-3)).all()


def test_map_with_missing_pixels_is_exact_for_parabolas(inside, nodes):
    """Fill of any other kind would ring into the valid cells."""
    z = 1e-3 * nodes[0] ** 2 - 2e-3 * nodes[1] ** 2 + 3e-3 * nodes[0] * nodes[1]
    holes = z.copy()
    holes[2:5, 7:9] = np.nan
    holes[:, 18:] = np.nan
    holes[0, 0] = np.nan

    found = GridForm(Surface(holes, dx=DX, dy=DY, origin=ORIGIN))(*inside)

    expected = GridForm(Surface(z, dx=DX, dy=DY, origin=ORIGIN))(*inside)
    valid = ~np.isnan(found)
    assert 100 < valid.sum() < 300
    assert np.abs(found - expected)[valid].max() < 1e-9 * np.ptp(z)


def test_round_aperture_of_a_conic():
    """A lens of R = 50 mm on a square map at 0.25 mm: the rim is as good as the middle."""
    form = Conic(R=50e-3, k=-1.2)
    g = np.linspace(-10e-3, 10e-3, 81)
    x, y = np.meshgrid(g, g)
    z = np.where(np.hypot(x, y) <= 9.9e-3, form(x, y), np.nan)
    grid = GridForm(Surface(z, dx=0.25e-3, dy=0.25e-3, origin=(-10e-3, -10e-3)))
    p, q = np.meshgrid(np.linspace(-9e-3, 9e-3, 97), np.linspace(-9e-3, 9e-3, 89))

    error = grid(p, q) - form(p, q)

    assert np.isfinite(error[np.hypot(p, q) < 9.5e-3]).all()
    assert np.nanmax(np.abs(error)) < 1e-10  # m; third differences of the 1 mm sag are 0.7 nm


def test_scale_is_a_factor(surface, inside):
    form = GridForm(surface)
    half = form.with_parameters(scale=0.5)

    np.testing.assert_array_equal(half(*inside), 0.5 * form(*inside))
    np.testing.assert_array_equal(half.derivatives(*inside, ["scale"])[0], form(*inside))
    assert half.spline is form.spline
    assert form.scale == 1.0


@pytest.mark.parametrize("unit", [1e-9, 1e-3, 1e3])
def test_unit_of_length_does_not_matter(surface, inside, unit):
    scaled = Surface(
        unit * surface.z, dx=unit * DX, dy=unit * DY, origin=(unit * ORIGIN[0], unit * ORIGIN[1])
    )

    z = GridForm(scaled)(unit * inside[0], unit * inside[1]) / unit

    np.testing.assert_allclose(z, GridForm(surface)(*inside), rtol=1e-11, atol=1e-18)


def test_transposed_map_exchanges_the_axes(surface, inside):
    other = GridForm(Surface(surface.z.T, dx=DY, dy=DX, origin=ORIGIN[::-1]))
    x, y = inside

    np.testing.assert_allclose(other(y, x), GridForm(surface)(x, y), rtol=1e-12, atol=1e-18)
    np.testing.assert_allclose(
        other.gradient(y, x)[1], GridForm(surface).gradient(x, y)[0], rtol=1e-10, atol=1e-13
    )


def test_start_finds_the_scale(surface, inside):
    x, y = inside
    z = -3.0 * cubic(x, y) + 1e-3 + 2e-3 * x - 1e-3 * y

    form = GridForm(surface, scale=None).start(x, y, z)

    assert form.scale == pytest.approx(
        -3.0, rel=1e-6, abs=0.0
    )  # over a tilt that is 10 times larger


def test_start_on_a_plane_or_off_the_map(nodes, inside):
    flat = GridForm(Surface(1e-3 * nodes[0], dx=DX, dy=DY, origin=ORIGIN), scale=None)

    with pytest.raises(DegenerateFitError, match="is a plane"):
        flat.start(*inside, inside[0])
    with pytest.raises(TooFewSamplesError, match="0 points lie on the nominal map"):
        flat.start(inside[0] + 1.0, inside[1], inside[0])


def test_constant_map():
    form = GridForm(Surface(np.full((5, 5), 2e-6), dx=1.0, dy=1.0))

    assert form(1.3, 2.7).item() == pytest.approx(2e-6, rel=1e-14, abs=0.0)
    assert form.gradient(1.3, 2.7)[0].item() == pytest.approx(0.0, abs=1e-15)


def test_bad_maps_raise():
    z = np.zeros((5, 5))

    with pytest.raises(DataError, match="made of a Surface"):
        GridForm(z)
    with pytest.raises(DataError, match="no lateral calibration"):
        GridForm(Surface(z, dx=1e-3))
    with pytest.raises(TooFewSamplesError, match="3 x 5 pixels"):
        GridForm(Surface(z[:3], dx=1.0, dy=1.0))
    with pytest.raises(TooFewSamplesError, match="0 cells"):
        GridForm(Surface(np.full((5, 5), np.nan), dx=1.0, dy=1.0))
    with pytest.raises(DataError, match="scale must be finite"):
        GridForm(Surface(z, dx=1.0, dy=1.0), scale=np.inf)
    with pytest.raises(DataError, match="no parameter zoom"):
        GridForm(Surface(z, dx=1.0, dy=1.0)).with_parameters(zoom=1.0)
    with pytest.raises(DataError, match="no value for scale"):
        GridForm(Surface(z, dx=1.0, dy=1.0), scale=None)(1.0, 1.0)
