"""Dry-run of maps: closed forms, every way to mirror or exchange it, what was not measured."""

import dataclasses

import numpy as np
import pytest

from metrosep import Surface
from metrosep.compensation.area_errors import ErrorMap
from metrosep.compensation.map_verify import dry_run_map
from metrosep.compensation.maps import CompensationMap
from metrosep.errors import DataError, SignCheckFailedError, TableError

ROUND = 1e-18
"""Rounding of 1 um over 40 000 places, with a margin."""
GRID = 2e-2
"""A mean over 201 places an axis, both ends counted, against the integral."""
SPAN = ((0.0, 1.0), (0.0, 1.0))


def twisted(x, y):
    return 1e-6 * (x - 0.5) * (y - 0.5)


def verified(share, error=twisted, against=None, **options):
    options = {"span": SPAN, "axes": ("X", "Y"), "compensates": "Z"} | options
    return dry_run_map(lambda x, y: -share * error(x, y), against or error, **options)


@pytest.mark.parametrize("share", [1.0, 0.5, 0.9])
def test_numbers_are_those_of_a_twist(share):
    """(x - 1/2)(y - 1/2) over the unit square: P-V 1/2, RMS 1/12."""
    result = verified(share)
    rms = 1e-6 / 12
    assert result.before_pv == pytest.approx(0.5e-6, abs=ROUND)
    assert result.after_pv == pytest.approx(0.5e-6 * (1 - share), abs=ROUND)
    assert result.wrong_sign_pv == pytest.approx(0.5e-6 * (1 + share), abs=ROUND)
    assert result.before_rms == pytest.approx(rms, rel=GRID, abs=0.0)
    assert result.after_rms == pytest.approx(rms * (1 - share), rel=GRID, abs=ROUND)
    assert result.wrong_sign_rms == pytest.approx(rms * (1 + share), rel=GRID, abs=0.0)
    assert result.passed
    assert result.coverage == 1.0
    assert result.to_dict()["n_compared"] == 201 * 201


def test_wrong_sign_is_refused_and_says_so():
    table = CompensationMap.from_error(twisted, x=np.linspace(0, 1, 5), y=np.linspace(0, 1, 4))
    assert table.verify().passed
    assert table.verify(twisted).after_pv < ROUND
    with pytest.raises(SignCheckFailedError, match="the reversed sign would shrink it") as caught:
        table.negated().verify(twisted)
    assert "500 nm -> 1 um" in str(caught.value)


def lopsided(x, y):
    return 2e-6 * np.exp(-(((x - 0.7) / 0.2) ** 2) - ((y - 0.2) / 0.15) ** 2)


@pytest.mark.parametrize("turned", ["mirror x", "mirror y", "exchange"])
def test_a_map_that_lies_wrongly_is_refused(turned):
    grid = np.linspace(0, 1, 41)
    wrong = {
        "mirror x": lambda x, y: lopsided(1 - x, y),
        "mirror y": lambda x, y: lopsided(x, 1 - y),
        "exchange": lambda x, y: lopsided(y, x),
    }[turned]
    table = CompensationMap.from_error(wrong, x=grid, y=grid)
    with pytest.raises(SignCheckFailedError, match="neither sign"):
        table.verify(lopsided)


def test_rms_that_shrinks_is_not_enough():
    """A map with one wild node: the RMS over the whole gets smaller, the P-V larger."""
    grid = np.linspace(0, 1, 41)
    good = CompensationMap.from_error(twisted, x=grid, y=grid)
    values = good.values.copy()
    values[20, 20] += 2e-6
    spoilt = CompensationMap(grid, grid, values)
    with pytest.raises(SignCheckFailedError, match="outlier"):
        spoilt.verify(twisted)


def test_offset_is_no_error_and_a_plane_only_where_levelled():
    grid = np.linspace(0, 1, 11)
    shifted = lambda x, y: twisted(x, y) + 9e-6  # noqa: E731
    tilted = lambda x, y: twisted(x, y) + 3e-6 * x - 5e-6 * y  # noqa: E731
    of_offset = CompensationMap.from_error(twisted, x=grid, y=grid)
    of_plane = CompensationMap.from_error(twisted, x=grid, y=grid, removed="plane")

    assert of_offset.verify(shifted).after_pv < 1e3 * ROUND
    assert of_plane.verify(tilted).after_pv < 1e3 * ROUND
    assert of_offset.verify(tilted).after_pv == pytest.approx(8e-6, abs=1e3 * ROUND)


@pytest.mark.parametrize("axis", ["X", "Y"])
def test_on_axis_the_error_is_taken_where_the_axis_then_is(axis):
    """c = -e of e = a s leaves -a^2 s; the exact inverse nothing."""
    a = 1e-3
    error = (lambda x, y: a * x) if axis == "X" else (lambda x, y: a * y)
    grid = np.linspace(0, 1, 5)
    options = {"x": grid, "y": grid, "compensates": axis}
    plain = CompensationMap.from_error(error, exact=False, **options).verify(error)
    exact = CompensationMap.from_error(error, **options).verify(error)
    assert plain.after_pv == pytest.approx(a * a, rel=1e-9, abs=0.0)
    assert exact.after_pv < 1e-12


def test_what_was_not_measured_is_counted_and_not_compared():
    grid = np.linspace(0, 1, 21)
    x, y = np.meshgrid(grid, grid)
    z = twisted(x, y)
    z[5, 7] = np.nan
    z[:, 20] = np.nan
    table = CompensationMap.from_error(twisted, x=grid, y=grid)
    result = table.verify(Surface(z, dx=0.05, dy=0.05))
    assert result.n_not_measured == 22
    assert result.n_compared == 441 - 22
    assert result.coverage == pytest.approx(419 / 441, abs=1e-12)
    assert result.after_pv < ROUND


def test_a_map_of_which_a_part_was_measured_is_refused_until_that_is_waived():
    grid = np.linspace(0, 1, 21)
    table = CompensationMap.from_error(twisted, x=grid, y=grid)
    part = np.linspace(0.5, 1.5, 11)
    x, y = np.meshgrid(part, grid)
    measured = ErrorMap(part, grid, twisted(x, y))
    with pytest.raises(SignCheckFailedError, match=r"spans 50 % of the map"):
        table.verify(measured)
    result = verified(1.0, against=measured)
    assert result.span == ((0.5, 1.0), (0.0, 1.0))
    assert result.coverage == pytest.approx(0.5, abs=1e-12)
    assert result.grade == "refused"
    with pytest.raises(SignCheckFailedError, match=r"spans 50 % of the map.*waive='coverage'"):
        result.require("map")
    result.require("map", waived=("coverage",))


def test_ring_of_zeros_is_not_compared():
    grid = np.linspace(0.2, 0.4, 3)
    table = CompensationMap.from_error(
        lambda x, y: 1e-6 * (1 + x * y), x=grid, y=grid, border="zero"
    )
    result = table.verify(lambda x, y: 1e-6 * (1 + x * y))
    assert result.span == ((0.2, 0.4), (0.2, 0.4))
    assert result.after_pv < ROUND


def test_nothing_to_compare_is_refused():
    grid = np.linspace(0, 1, 5)
    table = CompensationMap.from_error(twisted, x=grid, y=grid)
    away = ErrorMap(grid + 5, grid, np.zeros((5, 5)))
    with pytest.raises(TableError, match="do not overlap"):
        table.verify(away)
    with pytest.raises(DataError, match="0 of 25"):
        table.verify(ErrorMap(grid, grid, np.full((5, 5), np.nan)))
    with pytest.raises(DataError, match="does not say where"):
        table.verify(np.zeros((5, 5)))
    with pytest.raises(TableError, match="no source"):
        CompensationMap(grid, grid, np.zeros((5, 5))).verify()


def test_a_map_of_zeros_proves_nothing():
    grid = np.linspace(0, 1, 5)
    assert CompensationMap(grid, grid, np.zeros((5, 5))).verify(twisted).grade == "pointless"


def test_a_map_that_moves_the_zero_of_the_machine_is_refused():
    flat = CompensationMap(np.linspace(0, 1, 5), np.linspace(0, 1, 4), np.full((4, 5), 3e-6))

    with pytest.raises(
        SignCheckFailedError, match="moves the zero of the machine by 3 um"
    ) as caught:
        flat.verify(twisted)
    assert "mirrored" not in str(caught.value)


def test_a_map_that_is_askew_is_refused_though_the_measurement_does_not_know_its_plane():
    """4 um of tilt in the corrections; only the measured plane may be taken off."""
    grid = np.linspace(0.0, 1.0, 41)
    x = np.meshgrid(grid, grid)[0]

    def error(x, y):
        return 0.5e-6 * np.sin(6 * np.pi * x) * np.cos(4 * np.pi * y)

    right = CompensationMap.from_error(error, x=grid, y=grid)
    tilted = dataclasses.replace(right, values=right.values + 4e-6 * x, removed="plane")

    assert right.verify(error).passed
    with pytest.raises(SignCheckFailedError, match="does not shrink"):
        tilted.verify(error)
