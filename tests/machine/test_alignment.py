"""Freedoms as maps, and projections off them: closed forms on the disc, motions of a part."""

import numpy as np
import pytest

from metrosep.core.errors import DataError, InvalidSamplesError, TooFewSamplesError
from metrosep.machine.alignment import (
    FREEDOMS,
    alignment_space,
    freedom_maps,
    removed_freedoms,
)

ROUNDING = 1e-12
"""Projections in float64 leave less than this share of a map."""

MESH = 2e-5
"""Midpoint rule on 200 radii: relative error of second moments is 1/(4 n^2), of fourth 1e-5."""


def disc(n_rho=200, n_azimuth=240, radius=2.0):
    rho = (np.arange(n_rho) + 0.5) / n_rho * radius
    azimuth = 2 * np.pi * np.arange(n_azimuth) / n_azimuth
    r, a = (v.ravel() for v in np.meshgrid(rho, azimuth, indexing="ij"))
    return r * np.cos(a), r * np.sin(a), r / r.sum()


def rms(values, w):
    return np.sqrt(np.sum(w * values**2))


def plain(names, x, y, w):
    zero = np.zeros_like(x)
    maps = freedom_maps(names, x=x, y=y, z=zero, slope_x=zero, slope_y=zero)
    return alignment_space(names, maps, w)


def test_words_expand_in_a_fixed_order_without_doubles():
    assert removed_freedoms("none") == ()
    assert removed_freedoms(("tilt", "piston")) == ("piston", "tilt_x", "tilt_y")
    assert removed_freedoms("plane+defocus") == ("piston", "tilt_x", "tilt_y", "defocus")
    assert removed_freedoms(["plane", "piston", "rotation_z"])[-1] == "rotation_z"
    assert len(removed_freedoms("rigid")) == 6
    assert removed_freedoms("Zernike 5") == ("piston", "tilt_x", "tilt_y", "noll4", "noll5")
    assert removed_freedoms("zernike: 2") == ("piston", "tilt_x")
    assert removed_freedoms("plane+mounting")[3:] == ("noll5", "noll6", "noll9", "noll10")


@pytest.mark.parametrize("bad", ["zernike 38", "zernike 0"])
def test_zernike_terms_end_at_37(bad):
    with pytest.raises(InvalidSamplesError, match="last Zernike term"):
        removed_freedoms(bad)


def test_eleven_zernike_terms_leave_the_closed_form_of_a_cone():
    """<r^2> = 1/2; the terms of r: 2/3, 2 sqrt(3) / 15 of 2 r^2 - 1, -2 sqrt(5) / 105 of 6 r^4 - 6 r^2 + 1."""
    x, y, w = disc(radius=1.0)
    names = removed_freedoms("zernike 11")
    zero = np.zeros_like(x)
    maps = freedom_maps(names, x=x, y=y, z=zero, slope_x=zero, slope_y=zero, reach=1.0)
    left = alignment_space(names, maps, w).remove(np.hypot(x, y))
    square = 1 / 2 - 4 / 9 - (2 * np.sqrt(3) / 15) ** 2 - (2 * np.sqrt(5) / 105) ** 2
    assert rms(left, w) == pytest.approx(np.sqrt(square), abs=MESH)


def test_a_chuck_of_three_jaws_is_trefoil_and_no_other_lobes_go_with_it():
    x, y, w = disc(radius=1.0)
    rho, azimuth = np.hypot(x, y), np.arctan2(y, x)
    names = removed_freedoms("mounting")
    zero = np.zeros_like(x)
    maps = freedom_maps(names, x=x, y=y, z=zero, slope_x=zero, slope_y=zero, reach=1.0)
    space = alignment_space(names, maps, w)
    jaws = rho**3 * np.cos(3 * azimuth + 0.4)
    assert rms(space.remove(jaws), w) < 1e-9
    four = rho**4 * np.cos(4 * azimuth)
    assert rms(space.remove(four), w) == pytest.approx(rms(four, w), abs=1e-9)


@pytest.mark.parametrize("bad", ["tip", ("piston", "dz"), 3, [None]])
def test_unknown_freedoms_are_refused(bad):
    with pytest.raises(DataError, match=r"alignment term|freedom|list"):
        removed_freedoms(bad)


def test_defocus_leaves_the_closed_form_of_a_paraboloid():
    x, y, w = disc()
    bowl = x**2 + y**2  # on a disc of radius R: mean R^2/2, standard deviation R^2/sqrt(12)

    left = plain(("piston",), x, y, w).remove(bowl)

    assert rms(left, w) == pytest.approx(4.0 / np.sqrt(12.0), abs=4.0 * MESH)


def test_plane_takes_slopes_and_their_amounts_are_exact():
    x, y, w = disc()
    space = plain(("piston", "tilt_x", "tilt_y"), x, y, w)
    maps = np.column_stack([3.0 + 2.0 * x - 5.0 * y, x**2 - y**2])

    assert np.abs(space.remove(maps)[:, 0]).max() < ROUNDING
    assert space.amounts(maps)[:, 0] == pytest.approx([3.0, 2.0, -5.0], abs=ROUNDING)
    assert rms(space.remove(maps)[:, 1], w) == pytest.approx(rms(maps[:, 1], w), abs=1e-9)


def test_remainder_has_no_part_of_any_freedom_and_twice_is_once():
    x, y, w = disc(40, 60)
    rng = np.random.default_rng(4)
    maps = freedom_maps(tuple(FREEDOMS), x=x, y=y, z=x * y, slope_x=y, slope_y=x, reach=2.0)
    space = alignment_space(tuple(FREEDOMS), maps, w)
    wild = rng.standard_normal((x.size, 3)) * [1.0, 1e-9, 1e6]

    once = space.remove(wild)

    assert np.abs((space.basis * w[:, None]).T @ once / np.std(wild, axis=0)).max() < ROUNDING
    assert np.abs((space.remove(once) - once) / np.std(wild, axis=0)).max() < ROUNDING


@pytest.mark.parametrize(
    ("name", "motion"),
    [
        ("piston", lambda x, y, z: (0, 0, 1)),
        ("shift_x", lambda x, y, z: (1, 0, 0)),
        ("shift_y", lambda x, y, z: (0, 1, 0)),
        ("rotation_x", lambda x, y, z: (0, -z, y)),
        ("rotation_y", lambda x, y, z: (z, 0, -x)),
        ("rotation_z", lambda x, y, z: (-y, x, 0)),
    ],
)
def test_rigid_freedoms_are_small_motions_of_the_part(name, motion):
    """Move every point of z = 0.3 x^2 + 0.1 x y^2 by a small motion: the gap above the old surface."""
    rng = np.random.default_rng(7)
    x, y = rng.uniform(-1, 1, (2, 50))

    def height(u, v):
        return 0.3 * u**2 + 0.1 * u * v**2

    z, gx, gy = height(x, y), 0.6 * x + 0.1 * y**2, 0.2 * x * y
    small = 1e-6
    ex, ey, ez = (small * np.asarray(e) for e in motion(x, y, z))
    gap = (z + ez - height(x + ex, y + ey)) / small

    column = freedom_maps((name,), x=x, y=y, z=z, slope_x=gx, slope_y=gy)[:, 0]

    assert np.abs(column - gap).max() < 5e-6  # second order of the motion
    assert np.abs(column).max() > 0.1


def test_freedoms_that_add_nothing_are_dropped_and_named():
    x, y, w = disc(20, 36)
    names = ("piston", "tilt_x", "tilt_y", "shift_x", "shift_y", "rotation_z")
    bowl = freedom_maps(names, x=x, y=y, z=x**2 + y**2, slope_x=2 * x, slope_y=2 * y)

    space = alignment_space(names, bowl, w, scales=[1, 1, 1, 1, 1, 4.0])

    assert space.used == ("piston", "tilt_x", "tilt_y")  # a shifted paraboloid is a tilted one
    assert space.dropped == ("shift_x", "shift_y", "rotation_z")


def test_arguments_stay_and_results_are_frozen():
    x, y, w = disc(4, 8)
    keep = w.copy()
    space = plain(("piston",), x, y, 7 * w)
    values = x.copy()
    space.remove(values)
    assert (values == x).all()
    assert (w == keep).all()
    assert space.weights.sum() == pytest.approx(1.0, abs=ROUNDING)
    with pytest.raises(ValueError, match="read-only"):
        space.basis[0, 0] = 1.0


def test_whole_numbers_are_taken():
    space = alignment_space(["piston"], np.ones((4, 1), dtype=int), [1, 1, 1, 1])
    assert space.remove(np.array([1, 2, 3, 4])).tolist() == [-1.5, -0.5, 0.5, 1.5]


def test_bad_input_is_refused():
    with pytest.raises(TooFewSamplesError, match="3 points"):
        alignment_space(["piston", "tilt_x", "tilt_y"], np.eye(3), np.ones(3))
    with pytest.raises(InvalidSamplesError, match="shape"):
        alignment_space(["piston"], np.ones((4, 2)), np.ones(4))
    with pytest.raises(InvalidSamplesError, match="NaN"):
        alignment_space(["piston"], [[1.0], [np.nan], [1.0]], np.ones(3))
    for weight in (0.0, -1.0, np.nan, np.inf):
        with pytest.raises(InvalidSamplesError, match="weights"):
            alignment_space(["piston"], np.ones((3, 1)), [1.0, weight, 1.0])
    space = alignment_space(["piston"], np.ones((3, 1)), np.ones(3))
    with pytest.raises(InvalidSamplesError, match="one row per point"):
        space.remove(np.ones(4))
    with pytest.raises(InvalidSamplesError, match="NaN"):
        space.remove([1.0, np.nan, 1.0])
    with pytest.raises(DataError, match="one of piston"):
        freedom_maps(["roll"], x=[0], y=[0], z=[0], slope_x=[0], slope_y=[0])
