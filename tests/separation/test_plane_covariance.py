"""Plane and squareness take the covariance of what they are made of; draws are made with numpy alone."""

from dataclasses import replace

import numpy as np
import pytest
from contracts.estimates import DRAWS, LENGTH, NM, OF_DRAWS, X, an_estimate, some_covariance, waves

from metrosep.core.errors import DataError, InvalidSamplesError
from metrosep.core.profile import Profile
from metrosep.core.quantity import Quantity
from metrosep.separation import plane_map, squareness_from_diagonals
from metrosep.separation.covariance import CovarianceModes

pytestmark = pytest.mark.usefixtures("separations_once")

MM, UM = 1e-3, 1e-6
STEP = 1.5 * MM
LEFT_OUT = 0.6 * NM
"""Stored modes lack 1e-4 of the variance: of a difference of errors of 40 nm sqrt(2e-4) of that."""
NODES = 0.03
"""Share that the straight lines between the 241 nodes of a covariance cost, where waves are long."""


def alike(x):
    """Columns of an error nearly the same everywhere, m."""
    return 40 * NM * np.column_stack([np.ones(x.size), 0.1 * np.cos(7 * x / LENGTH)])


def opposite(x):
    """Of one with opposite signs at the two ends."""
    return 40 * NM * np.column_stack([np.tanh((x - 21e-3) / 2e-3), 0.1 * np.sin(7 * x / LENGTH)])


def many(x):
    return waves(x) @ np.linalg.cholesky(some_covariance(24) + 1e-24 * np.eye(24))


def estimate_of(columns, error):
    values = columns(X)
    u = np.sqrt((values**2).sum(axis=1))
    return an_estimate(u, CovarianceModes.of(X, values), error)


def drawn(columns, x, seed):
    values = columns(x)
    return values @ np.random.default_rng(seed).normal(size=(values.shape[1], DRAWS))


def bump(x, place, height):
    """An error with its extreme at a place."""
    return height * np.exp(-(((x - place) / 6e-3) ** 2))


def plane_of(along_x, along_y, **options):
    ex = estimate_of(along_x, bump(X, 6e-3, 900 * NM) - bump(X, 36e-3, 500 * NM))
    ey = estimate_of(along_y, bump(X, 30e-3, 300 * NM) - bump(X, 12e-3, 700 * NM))
    return plane_map(ex, ey, dx=STEP, dy=STEP, **options)


@pytest.mark.parametrize("along_x", [alike, opposite, many])
@pytest.mark.parametrize("along_y", [alike, opposite])
def test_u_of_the_difference_from_the_reference_is_that_of_draws(along_x, along_y):
    tilt = {
        "alpha": Quantity(0.0, "rad", "stated", u=1e-6),
        "beta": Quantity(0.0, "rad", "stated", u=0.5e-6),
    }
    plane = plane_of(along_x, along_y, reference=(9 * MM, 30 * MM), **tilt)
    x = y = np.arange(31) * STEP
    rng = np.random.default_rng(11)
    one = drawn(along_x, x, 1) + rng.normal(0, 0.5e-6, DRAWS) * (x - 9 * MM)[:, None]
    two = drawn(along_y, y, 2) + rng.normal(0, 1e-6, DRAWS) * (y - 30 * MM)[:, None]
    one, two = one - one[6], two - two[20]
    expected = np.hypot(one.std(axis=1)[None, :], two.std(axis=1)[:, None])

    np.testing.assert_allclose(plane.u.z, expected, rtol=OF_DRAWS + NODES, atol=2 * LEFT_OUT)
    assert plane.u.z[20, 6] == 0.0
    assert plane.surface.z[20, 6] == 0.0


def test_the_difference_of_two_places_keeps_its_sign():
    """The map is the error minus that at the reference: at the peak of x it is higher than at its valley."""
    free, zero = plane_of(many, many), plane_of(many, many, reference=(36 * MM, 12 * MM))

    away = free.surface.z - free.surface.z[8, 24]
    np.testing.assert_allclose(zero.surface.z, away, rtol=0.0, atol=1e-18)
    assert zero.surface.z[20, 4] > 2 * UM * 0.9


@pytest.mark.parametrize(
    ("along_x", "along_y", "share"),
    [(alike, alike, (0.0, 0.2)), (opposite, opposite, (1.3, 1.45)), (many, many, (0.5, 1.5))],
)
def test_u_of_the_peak_to_valley_is_that_of_draws(along_x, along_y, share):
    """`share`: of u over what independent extremes would give."""
    plane = plane_of(along_x, along_y)
    high, low = (np.unravel_index(f(plane.surface.z), (31, 31)) for f in (np.argmax, np.argmin))
    x = np.arange(31) * STEP
    one, two = drawn(along_x, x, 1), drawn(along_y, x, 2)
    error = (one[high[1]] + two[high[0]]) - (one[low[1]] + two[low[0]])

    assert plane.pv.u == pytest.approx(error.std(), rel=OF_DRAWS + NODES, abs=2 * LEFT_OUT)
    independent = np.hypot(plane.u.z[high], plane.u.z[low])
    assert share[0] < plane.pv.u / independent < share[1]
    assert plane.pv.value == np.ptp(plane.surface.z)


def test_the_document_of_a_plane_states_that_u(tmp_path):
    from metrosep.recipe.describe.described import plane_map_of

    plane = plane_of(opposite, alike)

    assert plane_map_of(plane).quantities["plane.pv"].u == plane.pv.u


def test_extremes_in_one_row_share_the_error_across():
    """Of y nothing is in the difference of two points of a row, however large its u."""
    flat = Profile(X, np.zeros(X.size))
    ex = estimate_of(many, bump(X, 6e-3, 900 * NM) - bump(X, 36e-3, 500 * NM))
    plane = plane_map(ex, flat, dx=STEP, dy=STEP, u_y=500 * NM)

    assert plane.pv.u == ex.u_of_difference([6 * MM], 36 * MM)[0]


@pytest.mark.parametrize(
    ("reference", "said"),
    [((9.2 * MM, 0.0), "x = 9.2 mm is not on the grid.*take 9 mm"),
     ((0.0, 99 * MM), "y = 99 mm is not on the grid"),
     ((0.0, float("nan")), "origin must be two finite numbers")],
)  # fmt: skip
def test_a_reference_off_the_grid_is_refused(reference, said):
    with pytest.raises(DataError, match=said):
        plane_of(many, many, reference=reference)


# ---- squareness ---------------------------------------------------------------------------------

SIZE = (0.5, 0.4, 0.3)
D = float(np.linalg.norm(SIZE))
BODY = ("ppp", "npp", "pnp", "nnp")
FACES = ("pp0", "np0")
FORMULA = {  # ISO 230-6: D / (4 X Y) and the signs of the four, written out by hand
    "xy": D / (4 * 0.5 * 0.4) * np.array([1, -1, -1, 1]),
    "xz": D / (4 * 0.5 * 0.3) * np.array([1, -1, 1, -1]),
    "yz": D / (4 * 0.4 * 0.3) * np.array([1, 1, -1, -1]),
}
COMMON = 1.0 * UM**2 * np.ones((4, 4)) + 0.01 * UM**2 * np.eye(4)
AGAINST = UM**2 * (np.eye(4) + 0.9 * np.outer([1, -1, -1, 1], [1, -1, -1, 1]))


@pytest.mark.parametrize("whole", [COMMON, AGAINST], ids=["common", "opposite"])
def test_u_of_the_angles_is_that_of_draws_of_the_lengths(whole):
    lengths = np.array([2.0, -1.0, -1.7, 2.5]) * UM
    found = squareness_from_diagonals(
        dict(zip(BODY, lengths, strict=True)), SIZE, covariance=whole
    )
    errors = np.linalg.cholesky(whole) @ np.random.default_rng(1).normal(size=(4, DRAWS))

    for pair, row in FORMULA.items():
        assert found.angles[pair].value == pytest.approx(row @ lengths, rel=1e-9, abs=0.0)
        spread = (row @ errors).std()
        assert found.angles[pair].u == pytest.approx(spread, rel=OF_DRAWS, abs=0.0)


def test_the_diagonal_alone_is_clearly_wrong_in_both_ways():
    lengths = dict.fromkeys(BODY, 1.0 * UM)
    for whole, low, high in ((COMMON, 0.0, 0.15), (AGAINST, 1.4, 3.0)):
        u = dict(zip(BODY, np.sqrt(np.diag(whole)), strict=True))
        own = squareness_from_diagonals(lengths, SIZE, covariance=whole).angles["xy"].u
        independent = squareness_from_diagonals(lengths, SIZE, u=u).angles["xy"].u
        assert low < own / independent < high


def test_an_error_common_to_all_is_in_no_angle_and_a_singular_covariance_is_taken():
    lengths = dict.fromkeys(BODY, 1.0 * UM)
    found = squareness_from_diagonals(lengths, SIZE, covariance=np.full((4, 4), UM**2))

    assert max(q.u for q in found.angles.values()) < 1e-6 * UM


def test_the_order_of_the_covariance_is_that_of_the_lengths_whatever_their_names():
    """nnp is the same line as ppn: only the first length is unsure."""
    whole = np.diag([4.0, 0.0, 0.0, 0.0]) * UM**2
    lengths = {"ppn": UM, "ppp": 2 * UM, "pnp": 0.0, "npp": 0.0}
    found = squareness_from_diagonals(lengths, SIZE, covariance=whole)

    assert found.a_xy == pytest.approx(FORMULA["xy"] @ [2 * UM, 0, 0, UM], rel=1e-9, abs=0.0)
    assert found.angles["xy"].u == pytest.approx(FORMULA["xy"][3] * 2 * UM, rel=1e-6, abs=0.0)


def test_redundant_diagonals_are_weighed_with_their_covariance():
    """Body diagonals and both of a face: the estimate of least variance, as draws show."""
    names = (*BODY, *FACES)
    common = np.outer([1, 1, 1, 1, 0, 0], [1, 1, 1, 1, 0, 0])
    whole = UM**2 * (25.0 * common + np.diag([0.01, 0.01, 0.01, 0.01, 4.0, 4.0]))
    found = squareness_from_diagonals(dict.fromkeys(names, 0.0), SIZE, covariance=whole)
    alone = FORMULA["xy"] @ (0.01 * UM**2 * np.eye(4)) @ FORMULA["xy"]
    face = np.hypot(*[np.hypot(0.5, 0.4) / (2 * 0.5 * 0.4) * 2 * UM] * 2)
    # both determine a_xy: the weights are those of their variances
    assert found.angles["xy"].u == pytest.approx(
        (1 / alone + 1 / face**2) ** -0.5, rel=0.05, abs=0.0
    )


def test_quantities_and_estimates_bring_their_own_u():
    lengths = {name: Quantity(1.0 * UM, "m", "length error", u=0.2 * UM) for name in BODY}
    stated = squareness_from_diagonals(dict.fromkeys(BODY, 1.0 * UM), SIZE, u=0.2 * UM)
    assert squareness_from_diagonals(lengths, SIZE).angles["xy"].u == stated.angles["xy"].u

    lacking = {**lengths, "ppp": 1.0 * UM}
    found = squareness_from_diagonals(lacking, SIZE)
    assert found.angles["xy"].u is None
    assert any("no standard uncertainty" in m for m in found.messages)


def test_an_estimate_along_a_diagonal_is_the_difference_of_its_ends():
    """Errors of opposite sign at both ends: twice, where the diagonal of its covariance says sqrt 2."""
    side = LENGTH / np.sqrt(3.0)
    estimate = estimate_of(opposite, bump(X, LENGTH, 600 * NM))
    estimate = replace(estimate, slope=replace(estimate.slope, value=3e-6, u=1e-7))
    lengths = {"ppp": estimate, **dict.fromkeys(BODY[1:], Quantity(0.0, "m", "length", u=0.0))}
    found = squareness_from_diagonals(lengths, (side,) * 3)

    factor = LENGTH / (4 * side**2)
    assert found.a_xy == pytest.approx(factor * (600 * NM + 3e-6 * LENGTH), rel=1e-3, abs=0.0)
    ends = drawn(opposite, np.array([0.0, LENGTH]), 5)
    spread = np.hypot((ends[1] - ends[0]).std(), 1e-7 * LENGTH)
    assert found.angles["xy"].u == pytest.approx(factor * spread, rel=OF_DRAWS + NODES, abs=0.0)
    independent = factor * np.hypot(*estimate.sd([0.0, LENGTH]))
    assert found.angles["xy"].u > 1.35 * independent

    with pytest.raises(
        DataError, match=r"ppp reaches over 45 mm, the diagonal over .*start, length"
    ):
        squareness_from_diagonals(lengths, (side, side, 2 * side))


@pytest.mark.parametrize(
    ("whole", "said"),
    [(np.eye(3), r"shape \(4, 4\).*ppp, npp, pnp, nnp.*got shape \(3, 3\)"),
     (np.full((4, 4), np.nan), "finite array"),
     (np.triu(np.ones((4, 4))), "not symmetric"),
     (np.eye(4) - 2 * np.eye(4)[::-1], "not symmetric with variances >= 0")],
)  # fmt: skip
def test_what_is_not_a_covariance_is_refused(whole, said):
    with pytest.raises(DataError, match=said):
        squareness_from_diagonals(dict.fromkeys(BODY, 0.0), SIZE, covariance=whole)


def test_u_and_covariance_at_once_and_text_are_refused():
    lengths = dict.fromkeys(BODY, 0.0)
    with pytest.raises(DataError, match="give one of them"):
        squareness_from_diagonals(lengths, SIZE, u=1e-7, covariance=np.eye(4))
    with pytest.raises((DataError, InvalidSamplesError)):
        squareness_from_diagonals(lengths, SIZE, covariance="1 um")
