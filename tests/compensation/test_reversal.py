"""Lost motion in the dry-run: P-V and RMS are blind to it, its sign is proven apart."""

import dataclasses
import json

import numpy as np
import pytest

from metrosep import Profile, Run, RunSet
from metrosep.compensation import CompensationTable
from metrosep.errors import DataError, SignCheckFailedError

X = np.linspace(0.0, 50e-3, 1001)
P = np.linspace(0.0, 50e-3, 101)
LOST = 0.7e-6
NM = 1e-9
"""0.5 mm between entries and e e' leave a fraction of a nanometre in the mean."""


def runs(error, lost=LOST, *, offsets=((0.0, 0.0), (0.0, 0.0))):
    """Two runs in each direction; the reverse ones lie `lost` higher."""
    forward, reverse = offsets
    return RunSet(
        [Run(X, error(X) + o, feed=0.1) for o in forward]
        + [Run(X[::-1], (error(X) + lost + o)[::-1], feed=0.1) for o in reverse]
    )


def made(error, lost=LOST):
    return CompensationTable.from_error(
        error, reverse=lambda x: error(x) + lost, positions=P, axis="X"
    )


def shifted(table, by):
    """The same table, its reverse column shifted."""
    return dataclasses.replace(table, reverse=table.forward + by)


@pytest.mark.parametrize("lost", [LOST, -LOST])
def test_right_sign_removes_it(lopsided, lost):
    found = made(lopsided, lost).verify(runs(lopsided, lost)).lost_motion

    assert found.before == pytest.approx(lost, abs=NM)
    assert found.after == pytest.approx(0.0, abs=NM)
    assert found.wrong_sign == pytest.approx(2 * lost, abs=NM)
    assert found.step == pytest.approx(-lost, abs=NM)


@pytest.mark.parametrize("lost", [LOST, -LOST])
def test_wrong_sign_is_refused_though_both_shapes_shrink(lopsided, lost):
    wrong = shifted(made(lopsided, lost), lost)

    with pytest.raises(SignCheckFailedError, match=r"lost motion .*larger"):
        wrong.verify(runs(lopsided, lost))


def test_too_much_of_the_right_sign_is_refused(lopsided):
    with pytest.raises(SignCheckFailedError, match="lost motion"):
        shifted(made(lopsided), -2.5 * LOST).verify(runs(lopsided))


def test_table_that_leaves_it_alone_passes_and_says_so(lopsided):
    found = CompensationTable.from_error(lopsided, positions=P, axis="X").verify(runs(lopsided))

    assert found.passed
    assert found.lost_motion.step == 0.0
    assert found.lost_motion.after == pytest.approx(LOST, abs=NM)


def test_sensor_set_to_zero_between_runs_does_not_know_it(lopsided):
    """Offsets scatter by 5 um: with that said, 0.7 um more or less is not held against the table."""
    scattered = runs(lopsided, offsets=((0.0, 5e-6), (-5e-6, 1e-6)))

    found = made(lopsided).verify(scattered, unknown="offsets")

    assert found.lost_motion is None
    assert found.unknown == "offsets"


def test_profile_for_both_directions_does_not_know_it(lopsided):
    assert made(lopsided).verify(Profile(X, lopsided(X))).lost_motion is None


def test_estimate_knows_it(both_ways_estimate):
    table = CompensationTable.from_error(both_ways_estimate, positions="1 mm", axis="X")

    found = table.verify(both_ways_estimate).lost_motion

    assert found.before == pytest.approx(0.4e-6, abs=20e-9)
    assert abs(found.after) < 0.05 * found.before
    with pytest.raises(SignCheckFailedError, match="lost motion"):
        shifted(table, 0.4e-6).verify(both_ways_estimate)


def test_measured_runs_of_the_simulator_know_it(both_ways_verified):
    found = both_ways_verified.lost_motion

    assert abs(found.after) < 0.05 * abs(found.before)


def test_direction_that_was_not_run_is_named(lopsided):
    forward = runs(lopsided).select(direction=1)

    assert made(lopsided).verify(forward).to_dict()["not_verified"] == ["reverse"]
    one_column = CompensationTable.from_error(lopsided, positions=P, axis="X")
    assert one_column.verify(forward).to_dict()["not_verified"] == []


def test_function_is_a_measurement_over_the_table(lopsided):
    table = CompensationTable.from_error(lopsided, positions=P, axis="X")

    found = table.verify(lopsided)

    assert found.span == table.span
    assert found.after_pv < 0.02 * found.before_pv
    with pytest.raises(SignCheckFailedError, match="reversed sign"):
        table.negated().verify(lopsided)


@pytest.mark.parametrize("against", [[1.0, 2.0], None, 3, "runs.csv"])
def test_something_else_is_refused(lopsided, against):
    with pytest.raises(DataError, match=r"dry-run against a .*pass a RunSet"):
        made(lopsided).verify(against)


def test_uncertainty_of_pv_is_the_scatter_between_its_two_places(lopsided):
    """Runs that differ by a scale s: P-V of each is s times P-V, exactly."""
    scales = np.array([0.9, 1.0, 1.1])
    several = RunSet([Run(X, s * lopsided(X), feed=0.1) for s in scales])
    table = CompensationTable.from_error(lopsided, positions=P, axis="X")

    (found,) = table.verify(several).residuals

    u = scales.std(ddof=1) / np.sqrt(3)
    assert found.u_before_pv == pytest.approx(u * np.ptp(lopsided(X)), rel=1e-3, abs=0.0)
    assert found.u_before_rms == pytest.approx(u * lopsided(X).std(), rel=1e-2, abs=0.0)
    assert found.u_after_pv > 0


def test_plain_values_are_json(lopsided):
    found = json.loads(
        json.dumps(made(lopsided).verify(runs(lopsided)).to_dict(), allow_nan=False)
    )

    assert found["lost_motion"]["before_m"] == pytest.approx(LOST, abs=NM)
    assert found["lost_motion"]["passed"] is True


def test_lost_motion_of_unknown_uncertainty_stays_out_of_the_table():
    """One run each way: 2 um between them may be drift; the table must not hold it."""
    from metrosep.separation import machine_axis, separate

    single = machine_axis(
        seed=4, directions=(1, -1), n_repeats=1, feeds=(0.1,), lost_motion=2e-6, disturbance="none"
    )
    several = machine_axis(
        seed=4, directions=(1, -1), n_repeats=3, feeds=(0.1,), lost_motion=2e-6, disturbance="none"
    )
    jumps = []
    for axis in (single, several):
        estimate = separate(axis.runs, method="mean", start=0.0, length=45e-3)
        table = CompensationTable.from_error(estimate, positions="1 mm", axis="X")
        jumps.append(float(np.median(table.reverse - table.forward)))

    assert abs(jumps[0]) < 0.2e-6
    assert abs(jumps[1] + 2e-6) < 0.2e-6


@pytest.mark.parametrize("lost", [LOST, -LOST])
def test_two_runs_each_way_are_judged_with_the_lost_motion_that_the_table_has(lopsided, lost):
    """Without one pair a single run is left each way: it does not show the lost motion by itself."""
    from metrosep.separation import separate

    rng = np.random.default_rng(3)
    measured = RunSet(
        [
            Run(run.x, run.z + 10 * NM * (rng.standard_normal() + rng.standard_normal(run.x.size)),
                feed=0.1, run_id=str(i))
            for i, run in enumerate(runs(lopsided, lost))
        ]
    )  # fmt: skip
    estimate = separate(measured, method="mean")
    table = CompensationTable.from_error(estimate, positions="1 mm", axis="X")
    found = table.verify(measured).lost_motion

    assert found.step == pytest.approx(-lost, abs=30 * NM)  # what stands in the columns
    assert found.before == pytest.approx(lost, abs=30 * NM)
    assert found.after == pytest.approx(0.0, abs=30 * NM)
    assert found.passed


def test_two_runs_each_way_still_refuse_a_lost_motion_of_the_wrong_sign(lopsided):
    from metrosep.separation import separate

    measured = runs(lopsided, offsets=((0.0, 5 * NM), (0.0, -5 * NM)))
    estimate = separate(measured, method="mean")
    table = CompensationTable.from_error(estimate, positions="1 mm", axis="X")
    wrong = shifted(table, float(np.mean(table.forward - table.reverse)))
    with pytest.raises(
        SignCheckFailedError, match=r"lost motion .*larger, its step is (69|70)\d(\.\d)? nm"
    ):
        wrong.verify(measured)


def test_two_cycles_of_a_list_are_judged_with_the_two_columns_that_the_table_has():
    from metrosep.separation.positions.pitch import pitch_errors_of

    rng, x = np.random.default_rng(2), np.linspace(0.0, 0.5, 21)
    error = 2e-6 * np.sin(12.0 * x)
    cycles = RunSet(
        [
            Run(x[::d], (error + LOST * (d < 0) + 5 * NM * rng.standard_normal(21))[::d], run_id=f"{k}{d}")
            for k in range(2)
            for d in (1, -1)
        ]
    )  # fmt: skip
    table = CompensationTable.from_error(pitch_errors_of(cycles), axis="X")
    found = table.verify(cycles).lost_motion

    assert table.reverse is not None
    assert found.step == pytest.approx(-LOST, abs=10 * NM)
    assert found.after == pytest.approx(0.0, abs=10 * NM)
