"""The dry-run: before, after and wrong sign against closed forms; what it refuses."""

import json

import numpy as np
import pytest

from metrosep import Profile, Run, RunSet
from metrosep.compensation import CompensationTable, dry_run
from metrosep.errors import DataError, SignCheckFailedError, TableError

PM = 1e-12
A = 1e-6
L = 40e-3
X = np.linspace(0.0, L, 4001)
GRID = 1e-4
"""Relative: 2001 points hit the extremes of four periods, a sample more on one end changes the RMS."""
STEP = 3e-9
"""Lookup at p + c: 1 um times a slope of 6e-4, squared for the part that is left."""


def wave(x):
    return A * np.sin(2 * np.pi * x / 10e-3)


def table(correction, *, span=(0.0, L), compensates="Z", **fields):
    p = np.linspace(*span, 4001)
    return CompensationTable(
        p, correction(p), None, "X", compensates, 0.0, **{"removed": "offset"} | fields
    )


def runs(*errors, direction=1, offsets=None):
    offsets = offsets or [0.0] * len(errors)
    x = X[::direction]
    return [
        Run(x, e(x) + o, feed=0.1, run_id=f"{direction}{i}")
        for i, (e, o) in enumerate(zip(errors, offsets, strict=True))
    ]


@pytest.mark.parametrize("share", [1.0, 0.5, 0.9])
def test_numbers_are_those_of_a_sine(share):
    result = table(lambda p: -share * wave(p)).verify(Profile(X, wave(X)))

    for r in result.residuals:
        assert r.before_pv == pytest.approx(2 * A, rel=GRID, abs=0.0)
        assert r.before_rms == pytest.approx(A / np.sqrt(2), rel=1e-3, abs=0.0)
        assert r.after_pv == pytest.approx(2 * A * (1 - share), rel=GRID, abs=PM)
        assert r.after_rms == pytest.approx((1 - share) * A / np.sqrt(2), rel=1e-3, abs=PM)
        assert r.wrong_sign_pv == pytest.approx(2 * A * (1 + share), rel=GRID, abs=0.0)
        assert r.wrong_sign_rms == pytest.approx((1 + share) * A / np.sqrt(2), rel=1e-3, abs=0.0)
        assert r.u_after_rms is None
    assert result.passed


def test_on_axis_the_error_is_taken_where_the_axis_then_is():
    """c = -e leaves e e' (1 um, slope 6.3e-4, P-V 0.63 nm); the exact inverse leaves nothing."""
    plain = table(lambda p: -wave(p), compensates="X")

    left = plain.verify(Profile(X, wave(X))).after_pv
    exact = plain.exact_inverse().verify(Profile(X, wave(X))).after_pv

    assert left == pytest.approx(A * A * 2 * np.pi / 10e-3, rel=0.02, abs=0.0)
    assert exact < 0.02 * left


def test_both_directions_of_runs_are_judged_apart():
    def doubled(x):
        return 2 * wave(x)

    p = np.linspace(0.0, L, 4001)
    split = CompensationTable(p, -wave(p), -0.5 * doubled(p) / 2, "X", "Z", 0.0)

    result = split.verify(RunSet(runs(wave) + runs(doubled, direction=-1)), unknown="offset")

    by_direction = {r.direction: r for r in result.residuals}
    assert by_direction[1].after_pv == pytest.approx(0.0, abs=PM)
    assert by_direction[-1].before_pv == pytest.approx(4 * A, rel=GRID, abs=0.0)
    assert by_direction[-1].after_pv == pytest.approx(3 * A, rel=GRID, abs=0.0)
    assert result.after_pv == by_direction[-1].after_pv
    assert result.before_pv == pytest.approx(4 * A, rel=GRID, abs=0.0)
    assert result.wrong_sign_pv == pytest.approx(5 * A, rel=GRID, abs=0.0)


def test_offset_of_a_run_is_no_error():
    result = table(lambda p: -wave(p)).verify(
        RunSet(runs(wave, wave, offsets=[5e-6, -9e-6])), unknown="offset"
    )

    assert result.before_pv == pytest.approx(2 * A, rel=GRID, abs=0.0)
    assert result.after_pv == pytest.approx(0.0, abs=10 * PM)


def test_line_of_alignment_is_taken_off_the_readings_and_never_off_the_table():
    """Straightness against an artefact that lies askew by 4 um; then a table that is askew."""
    level = wave(X) - np.polyval(np.polyfit(X, wave(X), 1), X)
    askew = RunSet([Run(X, wave(X) + slope * X, feed=0.1) for slope in (1e-4, 0.0, 3e-4)])
    right = CompensationTable(X, -level, None, "X", "Z", 0.0)

    assert right.verify(askew).after_pv < 1e-3 * A  # the line of 401 positions and of 4001
    assert right.verify(askew).unknown == "line"
    with pytest.raises(SignCheckFailedError, match="does not shrink"):
        CompensationTable(X, -level + 1e-4 * X, None, "X", "Z", 0.0).verify(askew)


def test_line_of_an_axis_along_itself_is_error():
    tilted = RunSet([Run(X, wave(X) + 1e-4 * X, feed=0.1)] * 3)

    found = table(lambda p: -wave(p), compensates="X").verify(tilted)

    assert found.grade == "pointless"
    assert found.after_pv == pytest.approx(1e-4 * L, rel=1e-3, abs=0.0)


@pytest.mark.parametrize("compensates", ["X", "Z"])
def test_flipped_table_is_refused_and_the_sign_is_named(compensates):
    right = table(lambda p: -wave(p), compensates=compensates)
    against = RunSet(runs(wave, wave, wave) + runs(wave, wave, wave, direction=-1))

    right.verify(against)
    with pytest.raises(SignCheckFailedError, match=r"reversed sign would shrink it.*nothing"):
        right.negated().verify(against)


def test_flipped_reverse_column_alone_is_refused():
    p = np.linspace(0.0, L, 401)
    half = CompensationTable(p, -wave(p), wave(p), "X", "Z", 0.0)

    with pytest.raises(SignCheckFailedError, match="reverse direction gets worse"):
        half.verify(RunSet(runs(wave) + runs(wave, direction=-1)))


def test_foreign_table_is_refused_and_no_sign_helps():
    foreign = table(lambda p: A * np.sin(2 * np.pi * p / 8e-3))

    with pytest.raises(SignCheckFailedError, match="neither sign shrinks it"):
        foreign.verify(Profile(X, wave(X)))


def test_table_of_the_mirrored_axis_is_refused(lopsided):
    x = np.linspace(0.0, 50e-3, 2001)
    mirrored = CompensationTable(x, -lopsided(x[::-1]), None, "X", "Z", 0.0)

    with pytest.raises(SignCheckFailedError, match="would fit mirrored"):
        mirrored.verify(Profile(x, lopsided(x)))


def test_zero_table_is_pointless():
    found = table(np.zeros_like).verify(Profile(X, wave(X)))

    assert (found.grade, found.passed) == ("pointless", False)


def test_no_overlap_is_refused_with_both_ranges():
    with pytest.raises(TableError, match=r"100 mm \.\.\. 140 mm.*0 m \.\.\. 40 mm.*overlap"):
        table(lambda p: -wave(p), span=(0.1, 0.14)).verify(Profile(X, wave(X)))


@pytest.mark.parametrize("span", [(10e-3, 80e-3), (-30e-3, 40e-3)])
def test_table_that_was_half_measured_is_refused(span):
    with pytest.raises(SignCheckFailedError, match=r"the table covers .* the measurement .*%"):
        table(lambda p: -wave(p), span=span).verify(Profile(X, wave(X)))


@pytest.mark.parametrize("kind", ["profile", "run"])
def test_part_that_was_not_measured_is_no_proof(kind):
    z = np.where(X < 15e-3, np.nan, wave(X))
    against = Profile(X, z) if kind == "profile" else RunSet([Run(X, z, feed=0.1)])

    with pytest.raises(SignCheckFailedError, match=r"15 mm .* 40 mm of it \(62.5 %\)"):
        table(lambda p: -wave(p)).verify(against)


def test_hole_in_the_readings_is_named():
    z = np.where((X > 20e-3) & (X < 25e-3), np.nan, wave(X))
    against = RunSet([Run(X, z, feed=0.1, run_id=f"r{i}") for i in range(3)])

    with pytest.raises(
        SignCheckFailedError, match=r"'r0' was not measured between 20 mm and 25 mm"
    ):
        table(lambda p: -wave(p), compensates="X").verify(against)


def holed(x, z, low=21e-3, high=26e-3):
    """Readings over a crest of the wave are lost: a straight line there would be 1 um off."""
    return np.where((x > low) & (x < high), np.nan, z)


@pytest.mark.parametrize("direction", [1, -1])
def test_hole_in_one_run_that_the_others_cover_is_judged_by_them(direction):
    x, offsets = X[::direction], 1e-6 * np.arange(5)
    against = RunSet(
        Run(x, (holed(x, wave(x)) if i == 3 else wave(x)) + o, feed=0.1, run_id=f"r{i}")
        for i, o in enumerate(offsets)
    )
    right = table(lambda p: -wave(p)).verify(against, unknown="offset")

    assert right.passed
    with pytest.raises(SignCheckFailedError):
        table(wave).verify(against, unknown="offset")
    (r,) = right.residuals
    assert r.before_rms == pytest.approx(A / np.sqrt(2), rel=GRID, abs=0.0)
    assert r.after_rms < STEP
    assert r.run_after_rms < STEP
    said = [f.problem for f in right.findings]
    assert any(
        "'r3' was not measured between 21 mm and 26 mm" in s and "4 runs" in s for s in said
    )


@pytest.mark.parametrize(("holes", "witnesses"), [(2, 3), (3, 2)])
def test_hole_that_fewer_than_three_runs_cover_is_refused(holes, witnesses):
    against = RunSet(
        Run(X, holed(X, wave(X)) if i < holes else wave(X), feed=0.1, run_id=f"r{i}")
        for i in range(5)
    )
    right, flipped = table(lambda p: -wave(p)), table(wave)

    if witnesses < 3:
        with pytest.raises(SignCheckFailedError, match=r"'r0' was not measured between"):
            right.verify(against)
    else:
        said = [f.problem for f in right.verify(against).findings]
        assert any("'r0' was not measured" in s and "by the 3 runs that were" in s for s in said)
        with pytest.raises(SignCheckFailedError, match="does not shrink"):
            flipped.verify(against)


@pytest.mark.parametrize("holes", [1, 4, 6])
def test_runs_with_a_hole_are_no_witnesses_there(holes):
    """Disturbances that live inside the hole: n runs of which m show them scatter as m runs do."""
    n, low, high = 9, 21e-3, 26e-3
    size = np.random.default_rng(3).normal(scale=0.2 * A, size=n)
    size[:holes] = 0.0  # whatever they would have shown was not read
    inside = np.clip(np.sin(np.pi * (X - low) / (high - low)), 0.0, None) * (
        np.abs(X - 23.5e-3) < 2.5e-3
    )
    against = RunSet(
        Run(
            X,
            (holed(X, wave(X)) if i < holes else wave(X)) + s * inside,
            feed=0.1,
            run_id=f"r{i}",
        )
        for i, s in enumerate(size)
    )
    result = table(lambda p: -wave(p)).verify(against, unknown="offset")
    (r,) = result.residuals

    seen = size[holes:]
    rms = np.sqrt(np.mean((inside - inside.mean()) ** 2))
    assert r.after_rms == pytest.approx(abs(seen.mean()) * rms, rel=GRID, abs=STEP)
    u = seen.std(ddof=1) / np.sqrt(seen.size) * rms
    assert r.u_after_rms == pytest.approx(u, rel=0.02, abs=0.0)


@pytest.mark.parametrize("direction", [1, -1])
@pytest.mark.parametrize("holes", [1, 4])
@pytest.mark.parametrize("n", [101, 401, 4001])
def test_wrong_entries_in_a_hole_are_seen_by_the_runs_that_were_measured_there(
    n, holes, direction
):
    """A bump of 400 nm in the table: its RMS about its mean is what must be left."""
    x, bump = np.linspace(0.0, L, n), 0.4e-6
    wrong = np.where((x > 20e-3) & (x < 26.6e-3), bump, 0.0)
    against = RunSet(
        Run(
            x[::direction],
            (holed(x, wave(x), 18e-3, 28e-3) if i < holes else wave(x))[::direction],
            feed=0.1,
            run_id=f"r{i}",
        )
        for i in range(9)
    )
    made = CompensationTable(x, -wave(x) + wrong, None, "X", "Z", 0.0, removed="offset")

    (r,) = made.verify(against, unknown="offset").residuals

    assert r.direction == direction
    assert r.after_rms == pytest.approx(wrong.std(), rel=0.02, abs=0.0)
    assert r.after_pv == pytest.approx(bump, rel=0.02, abs=0.0)


def test_many_holes_do_not_take_forever():
    """Seven of nine runs lost a place of their own: shapes must not be asked for again and again."""
    lost = [holed(X, wave(X), 4e-3 * i, 4e-3 * i + 3e-3) for i in range(1, 8)]
    against = RunSet(
        Run(X, z, feed=0.1, run_id=str(i)) for i, z in enumerate([*lost, *[wave(X)] * 2])
    )

    (r,) = table(lambda p: -wave(p)).verify(against, unknown="offset").residuals

    assert r.after_rms < STEP


def test_run_that_is_mostly_holes_is_refused():
    x = X[::10]
    z = np.where(np.isin(np.arange(x.size) // 50, (1, 2, 3, 5, 6)), np.nan, wave(x))
    against = RunSet(Run(x, z if i == 0 else wave(x), feed=0.1, run_id=f"r{i}") for i in range(5))

    with pytest.raises(SignCheckFailedError, match=r"'r0' was not measured between"):
        table(lambda p: -wave(p)).verify(against)


def test_nothing_measured_is_refused():
    with pytest.raises(DataError, match="no valid sample"):
        table(lambda p: -wave(p)).verify(Profile(X, np.full(X.size, np.nan)))


def test_mean_of_the_runs_is_judged_and_single_runs_reported():
    """A disturbance of opposite phase in two runs vanishes from the mean, not from the runs."""

    def shaken(sign):
        return lambda x: wave(x) + sign * 0.3 * A * np.cos(2 * np.pi * x / 2e-3)

    (r,) = (
        table(lambda p: -wave(p))
        .verify(RunSet(runs(shaken(1), shaken(-1))), unknown="offset")
        .residuals
    )

    assert r.n_runs == 2
    assert r.after_rms == pytest.approx(0.0, abs=PM)
    assert r.run_after_rms == pytest.approx(0.3 * A / np.sqrt(2), rel=1e-2, abs=0.0)
    assert r.run_before_rms == pytest.approx(np.hypot(1, 0.3) * A / np.sqrt(2), rel=1e-2, abs=0.0)


def test_uncertainty_is_the_scatter_of_the_runs():
    """Runs that leave 0.1, 0.2 and 0.3 of a sine: u = s / sqrt(3) of their RMS."""

    def left(share):
        return lambda x: (1 + share) * wave(x)

    (r,) = (
        table(lambda p: -wave(p))
        .verify(RunSet(runs(*map(left, (0.1, 0.2, 0.3)))), unknown="offset")
        .residuals
    )

    rms = np.array([0.1, 0.2, 0.3]) * A / np.sqrt(2)
    assert r.after_rms == pytest.approx(rms.mean(), rel=1e-3, abs=0.0)
    assert r.u_after_rms == pytest.approx(rms.std(ddof=1) / np.sqrt(3), rel=1e-3, abs=0.0)


@pytest.mark.parametrize("shake", [20e-9, pytest.param(100e-9, marks=pytest.mark.slow)])
def test_uncertainty_agrees_with_repeating_the_measurement(rng, shake):
    """What repeats is 50 nm RMS; each of 5 runs adds ten waves of random size."""
    x, k = X[::4], np.arange(1, 11)[:, None]
    waves = np.vstack([np.cos(2 * np.pi * k * x / L), np.sin(2 * np.pi * k * x / L)])
    seen, told = [], []
    for _ in range(150):
        extra = rng.normal(0, shake / np.sqrt(10), (5, 20)) @ waves
        left = 50e-9 * np.sqrt(2) * np.sin(2 * np.pi * x / 5e-3)
        set_of = RunSet(Run(x, wave(x) + left + z, feed=0.1) for z in extra)
        (r,) = table(lambda p: -wave(p)).verify(set_of).residuals
        seen.append(r.after_rms)
        told.append(r.u_after_rms)

    # 150 repetitions tell a standard deviation to 6 %, five runs each of them to some more
    assert np.sqrt(np.mean(np.square(told))) == pytest.approx(np.std(seen), rel=0.3, abs=0.0)


def test_estimate_is_judged_in_both_directions(both_ways_estimate, both_ways_table):
    result = both_ways_table.verify(both_ways_estimate)

    assert [r.direction for r in result.residuals] == [1, -1]
    assert result.unknown == "offset"
    assert result.after_pv < 0.02 * result.before_pv
    assert result.wrong_sign_pv == pytest.approx(2 * result.before_pv, rel=0.01, abs=0.0)


def test_estimate_proves_itself_on_other_runs(both_ways, both_ways_table, both_ways_verified):
    assert both_ways_verified.after_rms < 0.02 * both_ways_verified.before_rms
    with pytest.raises(SignCheckFailedError, match="reversed sign"):
        both_ways_table.negated().verify(both_ways.runs)


def test_the_line_of_a_verification_has_its_grade_and_numbers():
    result = dry_run(
        lambda p, _: -0.5 * wave(p), Profile(X, wave(X)), span=(0.0, L), on_axis=False
    )

    line = repr(result)

    assert len(line) <= 100
    assert line.startswith(f"Verification({result.grade}, RMS that repeats ")
    assert line.endswith(f"gain {result.gain:.4g}, the stated error)")


def test_scaling_scales_every_number():
    small = dry_run(
        lambda p, _: -0.5 * wave(p), Profile(X, wave(X)), span=(0.0, L), on_axis=False
    ).residuals[0]
    large = dry_run(
        lambda p, _: -500 * wave(p / 1e3),
        Profile(X * 1e3, 1e3 * wave(X)),
        span=(0.0, 1e3 * L),
        on_axis=False,
    ).residuals[0]

    assert large.after_pv == pytest.approx(1e3 * small.after_pv, rel=1e-6, abs=0.0)
    assert large.wrong_sign_rms == pytest.approx(1e3 * small.wrong_sign_rms, rel=1e-6, abs=0.0)


def test_plain_values_are_json_with_units():
    result = table(lambda p: -0.5 * wave(p)).verify(Profile(X, wave(X)))

    back = json.loads(json.dumps(result.to_dict(), allow_nan=False))

    assert back["passed"] is True
    assert [r["direction"] for r in back["residuals"]] == ["forward", "reverse"]
    assert back["residuals"][0]["after_pv_m"] == pytest.approx(A, rel=GRID, abs=0.0)
    assert back["residuals"][0]["u_after_rms_m"] is None
