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
    with pytest.raises(SignCheckFailedError, match=r"covers 50 % of the area"):
        table.verify(measured)
    result = verified(1.0, against=measured)
    assert result.span == ((0.5, 1.0), (0.0, 1.0))
    assert result.coverage == pytest.approx(0.5, abs=1e-12)
    assert result.grade == "refused"
    with pytest.raises(SignCheckFailedError, match=r"covers 50 % of the area.*waive='coverage'"):
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


# ---- one map, and a second one ---------------------------------------------------------------------

NODES = np.linspace(0.0, 0.2, 31)


def bed(x, y):
    """A shape that no mirror, exchange or sign leaves as it is; P-V about 4 um."""
    return 2e-6 * np.sin(x / 0.05) * (0.4 + y / 0.2) ** 2 - 1e-6 * np.cos(y / 0.03)


def measured_map(rng, noise=5e-8, error=bed):
    x, y = np.meshgrid(NODES, NODES)
    return ErrorMap(NODES, NODES, error(x, y) + rng.normal(0.0, noise, x.shape) + 3e-6)


def problems(result):
    return [f.problem for f in result.findings]


def test_map_that_made_the_corrections_is_told_from_a_second_one():
    rng = np.random.default_rng(2)
    first, second = measured_map(rng), measured_map(rng)
    table = CompensationMap.from_error(first, x=NODES, y=NODES)

    own, other = table.verify(), table.verify(second)

    assert own.grade == other.grade == "accepted"
    assert problems(own) == ["one map: what repeats is not known"]
    assert problems(other) == []
    assert own.judgement.improvement.u == 0.0
    assert other.judgement.improvement.u > 0.0
    assert "judged against the map that made it" in own.sentences[0]
    assert "judged against a second map" in other.sentences[0]


def test_numbers_of_a_second_map_are_those_of_one_run_over_an_area():
    """D, g, E and q by their definition, with the plane off the measurement only."""
    rng = np.random.default_rng(3)
    table = CompensationMap.from_error(measured_map(rng), x=NODES, y=NODES, removed="plane")
    second = measured_map(rng, error=lambda x, y: bed(x, y) + 4e-5 * x - 3e-5 * y)

    found = table.verify(second)

    x, y = (v.ravel() for v in np.meshgrid(NODES, NODES))
    basis = np.linalg.qr(np.stack([np.ones_like(x), x, y], axis=-1))[0]
    a = second.values.ravel() - basis @ (basis.T @ second.values.ravel())
    c = table.values.ravel() - table.values.mean()
    gain = -np.mean(a * c) / np.mean(c**2)
    improvement = np.mean(a**2) - np.mean((a + c) ** 2) - table.correction(0.0, 0.0).item() ** 2
    left = a + gain * c
    left = left - basis @ (basis.T @ left)
    energy = np.mean(a**2) - np.mean(left**2)
    assert found.judgement.improvement.value == pytest.approx(improvement, rel=1e-9, abs=0.0)
    assert found.gain == pytest.approx(gain, rel=1e-9, abs=0.0)
    assert found.judgement.energy == pytest.approx(energy, rel=1e-9, abs=0.0)
    expected = np.sqrt(max(energy - improvement, 0.0) / energy)
    assert found.rest == pytest.approx(expected, rel=1e-6, abs=0.0)


@pytest.mark.parametrize("smooth", [0, 3])
def test_uncertainty_of_a_map_agrees_with_repeating_the_measurement(smooth):
    """D of 300 second maps scatters as each of them says, also where its noise is correlated."""
    from scipy.ndimage import uniform_filter

    rng = np.random.default_rng(4)
    table = CompensationMap.from_error(bed, x=NODES, y=NODES)
    x, y = np.meshgrid(NODES, NODES)
    values, told = [], []
    for _ in range(300):
        noise = rng.normal(0.0, 4e-7, x.shape)
        if smooth:
            noise = smooth * uniform_filter(noise, smooth, mode="wrap")
        found = table.verify(ErrorMap(NODES, NODES, bed(x, y) + noise)).judgement.improvement
        values.append(found.value)
        told.append(found.u)

    # lags fade over a quarter of the nodes, so what correlates over some of them is told too small
    assert np.sqrt(np.mean(np.square(told))) == pytest.approx(np.std(values), rel=0.25, abs=0.0)


def test_noise_of_one_map_is_no_table():
    """A map of noise alone, and a second one that shares nothing with it."""
    rng = np.random.default_rng(6)
    table = CompensationMap.from_error(
        measured_map(rng, 1e-6, lambda x, y: 0.0 * x * y), x=NODES, y=NODES
    )

    assert table.verify().passed  # one map cannot know, and says so
    with pytest.raises(SignCheckFailedError, match="the error is larger"):
        table.verify(measured_map(rng, 1e-6, lambda x, y: 0.0 * x * y))


@pytest.mark.parametrize("share", [-1.0, -0.3])
def test_sign_of_a_map_is_accused_only_if_the_negated_map_would_be_accepted(share):
    rng = np.random.default_rng(7)
    table = CompensationMap.from_error(bed, x=NODES, y=NODES)
    wrong = dataclasses.replace(table, values=share * table.values)

    with pytest.raises(SignCheckFailedError) as caught:
        wrong.verify(measured_map(rng))

    assert ("the sign of the measurement or of the map is wrong" in str(caught.value)) == (
        share == -1.0
    )


def test_round_part_of_a_second_map_is_a_part_of_the_area():
    rng = np.random.default_rng(8)
    table = CompensationMap.from_error(bed, x=NODES, y=NODES)
    second = measured_map(rng)
    x, y = np.meshgrid(NODES, NODES)
    values = np.where(np.hypot(x - 0.1, y - 0.1) <= 0.1, second.values, np.nan)

    with pytest.raises(SignCheckFailedError, match=r"covers 7\d(\.\d)? % of the area"):
        table.verify(ErrorMap(NODES, NODES, values))


@pytest.mark.parametrize(("missing", "warned"), [(0, False), (2, True)])
def test_missing_rows_of_a_second_map_are_a_warning_below_a_twentieth(missing, warned):
    fine = np.linspace(0.0, 0.2, 61)
    table = CompensationMap.from_error(bed, x=fine, y=fine)
    values = bed(*np.meshgrid(fine, fine))
    values[:missing, :] = np.nan
    values[30, 1] = np.nan

    found = table.verify(ErrorMap(fine, fine, values))

    lost = 61 * missing + 1
    assert found.grade == "accepted"
    assert found.n_not_measured == lost
    assert found.coverage == pytest.approx(1 - lost / 61**2, abs=1e-12)
    assert any("not proven" in p for p in problems(found)) == warned
