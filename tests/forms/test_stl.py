"""Mesh of triangles as a form: planes, pyramids, the upper of two sides, a lens in facets."""

import numpy as np
import pytest

from metrosep.core.errors import DataError, InvalidSamplesError, TooFewSamplesError
from metrosep.forms.conic import Sphere
from metrosep.forms.stl import MeshForm, from_triangles

ROUNDING = 1e-14


def meshed(x, y, z):
    """Two triangles for each cell of a grid, numbered in no particular order."""
    p = np.stack([x, y, z], axis=-1)
    a, b, c, d = p[:-1, :-1], p[:-1, 1:], p[1:, :-1], p[1:, 1:]
    lower, upper = np.stack([a, b, c], axis=-2), np.stack([d, c, b], axis=-2)
    triangles = np.concatenate([lower.reshape(-1, 3, 3), upper.reshape(-1, 3, 3)])
    return triangles[np.random.default_rng(5).permutation(len(triangles))]


@pytest.fixture
def nodes():
    return np.meshgrid(np.linspace(-10e-3, 10e-3, 41), np.linspace(-6e-3, 7e-3, 27))


@pytest.fixture
def inside(rng):
    return rng.uniform(-10e-3, 10e-3, 500), rng.uniform(-6e-3, 7e-3, 500)


def test_a_tilted_plane_is_exact(nodes, inside):
    x, y = nodes
    form = from_triangles(meshed(x, y, 0.3 * x - 0.2 * y + 1e-3))

    z, (gx, gy) = form(*inside), form.gradient(*inside)

    np.testing.assert_allclose(z, 0.3 * inside[0] - 0.2 * inside[1] + 1e-3, rtol=0, atol=1e-17)
    np.testing.assert_allclose(gx, 0.3, rtol=1e-11, atol=0)
    np.testing.assert_allclose(gy, -0.2, rtol=1e-11, atol=0)


def test_corners_and_edges_belong_to_the_mesh(nodes):
    x, y = nodes
    z = np.sin(1e3 * x) * 1e-6 + 1e-3 * y
    form = from_triangles(meshed(x, y, z))

    np.testing.assert_allclose(form(x, y), z, rtol=0, atol=1e-18)
    middle = form((x[:, 1:] + x[:, :-1]) / 2, (y[:, 1:] + y[:, :-1]) / 2)
    np.testing.assert_allclose(middle, (z[:, 1:] + z[:, :-1]) / 2, rtol=0, atol=1e-18)


def test_interpolation_and_slopes_of_one_facet(rng):
    """Height and slopes from the normal of the plane through three points."""
    corners = rng.normal(size=(3, 3))
    normal = np.cross(corners[1] - corners[0], corners[2] - corners[0])
    form = from_triangles([corners])
    x, y = corners[:, :2].mean(axis=0)

    assert form(x, y).item() == pytest.approx(corners[:, 2].mean(), rel=ROUNDING, abs=0.0)
    gx, gy = form.gradient(x, y)
    assert gx.item() == pytest.approx(-normal[0] / normal[2], rel=1e-12, abs=0.0)
    assert gy.item() == pytest.approx(-normal[1] / normal[2], rel=1e-12, abs=0.0)


def test_order_of_corners_does_not_matter(nodes, inside):
    triangles = meshed(*nodes, nodes[0] ** 2)

    turned = from_triangles(triangles[:, ::-1])

    np.testing.assert_allclose(turned(*inside), from_triangles(triangles)(*inside), atol=1e-18)


def test_the_upper_side_counts(nodes, inside):
    """A closed body: bottom at 0, top at 1 mm + x / 10, upright walls."""
    x, y = nodes
    bottom, top = meshed(x, y, 0 * x), meshed(x, y, 1e-3 + 0.1 * x)
    wall = np.array([[[-10e-3, -6e-3, 0], [10e-3, -6e-3, 0], [0, -6e-3, 2e-3]]])

    form = from_triangles(np.concatenate([top, wall, bottom]))

    np.testing.assert_allclose(form(*inside), 1e-3 + 0.1 * inside[0], rtol=0, atol=1e-17)
    np.testing.assert_allclose(form.gradient(*inside)[0], 0.1, rtol=1e-11)


def test_outside_and_holes_are_nan(nodes):
    x, y = nodes
    triangles = meshed(x, y, 0 * x)
    centre = triangles[:, :, :2].mean(axis=1)
    ring = triangles[np.hypot(*centre.T) > 2e-3]

    form = from_triangles(ring)

    z = form([0.0, 5e-3, 10.1e-3, np.nan], [0.0, 5e-3, 0.0, 0.0])
    assert np.isnan(z).tolist() == [True, False, True, True]
    assert np.isnan(form.gradient(0.0, 0.0)).all()


def test_lens_in_facets_sags_below_it(nodes, inside):
    """Chords of a concave sphere lie above it, by up to the square of the diagonal / 8R."""
    x, y = nodes
    form = Sphere(R=100e-3)

    error = from_triangles(meshed(x, y, form(x, y)))(*inside) - form(*inside)

    assert error.min() > -1e-17
    assert 0.4 * 0.5e-6 / 0.8 < error.max() < 1.1 * 0.5e-6 / 0.8  # (0.5 mm)^2 * 2 / (8 * 0.1 m)


def test_fan_with_many_facets_in_a_corner():
    """All facets meet in one point: the search grid must not grow without bound."""
    t = np.linspace(0, 2 * np.pi, 2001)
    rim = np.stack([np.cos(t), np.sin(t), np.ones_like(t)], axis=1)
    fan = np.stack([np.zeros_like(rim[1:]), rim[:-1], rim[1:]], axis=1)

    form = from_triangles(fan)

    assert form.members.size <= 32 * len(fan)
    for angle in (0.1, 2.0, 5.5):
        z = form(0.5 * np.cos(angle), 0.5 * np.sin(angle)).item()
        assert z == pytest.approx(
            0.5, rel=2e-6, abs=0.0
        )  # a cone; chords of its rim are 1e-6 inside
    assert form(0.0, 0.0).item() == pytest.approx(0.0, abs=1e-9)


@pytest.mark.parametrize("unit", [1e-9, 1e-3, 1e3])
def test_unit_of_length_does_not_matter(nodes, inside, unit):
    triangles = meshed(*nodes, nodes[0] ** 2 + nodes[1])

    scaled = from_triangles(unit * triangles)

    np.testing.assert_allclose(
        scaled(unit * inside[0], unit * inside[1]) / unit,
        from_triangles(triangles)(*inside),
        rtol=1e-11,
        atol=1e-17,
    )


def test_it_has_no_parameters(nodes):
    form = from_triangles(meshed(*nodes, nodes[0]))

    assert isinstance(form, MeshForm)
    assert form.parameters == {}
    assert form.derivatives(np.zeros(2), np.zeros(2), []) == []
    assert not form.has_centre
    assert form.start(np.zeros(3), np.zeros(3), np.zeros(3)) is form
    assert from_triangles([[[0, 0, 0], [1, 0, 0], [0, 1, 7]]])(0, 1).item() == 7.0


def test_bad_meshes_raise():
    one = np.array([[[0.0, 0, 0], [1, 0, 0], [0, 1, 0]]])

    with pytest.raises(DataError, match=r"shape \(n, 3, 3\)"):
        from_triangles(one[0])
    with pytest.raises(TooFewSamplesError, match="no triangle"):
        from_triangles(one[:0])
    with pytest.raises(TooFewSamplesError, match="stand upright"):
        from_triangles(one[:, :, [0, 2, 1]])
    with pytest.raises(TooFewSamplesError, match="have no area"):
        from_triangles(np.ones((4, 3, 3)))
    for value in (np.nan, np.inf):
        bad = np.concatenate([one, one])
        bad[1, 2, 2] = value
        with pytest.raises(InvalidSamplesError, match="triangle 1 has a coordinate"):
            from_triangles(bad)
