"""The trial table: one lopsided bump, zero where it must be, and a verdict from one reading."""

import numpy as np
import pytest

from metrosep.compensation import CompensationTable
from metrosep.compensation.trial import trial_table
from metrosep.core.errors import DataError, SignCheckFailedError, TableError


def real(reference=0.0, reverse=False, n=31):
    p = np.linspace(0.0, 60e-3, n)
    c = 2e-6 * np.sin(p / 9e-3)
    return CompensationTable(p, c, c + 1e-7 if reverse else None, "X", "Z", reference)


def test_bump_in_one_third_only():
    trial = trial_table(real(), 4e-6)
    p, c = trial.table.positions, trial.table.forward
    assert trial.position == pytest.approx(44e-3, abs=2e-3)
    assert c.max() == 4e-6
    assert p[c.argmax()] == trial.position
    assert (c[p <= 40e-3] == 0.0).all()
    assert c[0] == c[-1] == 0.0
    assert (c >= 0.0).all()
    assert (c != 0.0).sum() >= 3
    # lopsided: the flank before the peak is steeper
    slopes = np.diff(c) / np.diff(p)
    assert slopes.max() > 2 * -slopes.min()


@pytest.mark.parametrize(
    ("reference", "third", "inside"),
    [
        (0.0, "auto", (40e-3, 60e-3)),
        (50e-3, "auto", (0.0, 20e-3)),
        (0.0, "middle", (20e-3, 40e-3)),
        (60e-3, "auto", (40e-3, 60e-3)),
    ],
)
def test_zero_at_reference_and_ends(reference, third, inside):
    trial = trial_table(real(reference), -3e-6, third=third)
    assert inside[0] < trial.position < inside[1]
    c = trial.table
    for place in (reference, *c.span):
        assert float(c.correction(place)[0]) == 0.0
    assert c.forward.min() == -3e-6


def test_slope_limit():
    # positions 2 mm apart: 3 um over 2 or 4 mm
    with pytest.raises(TableError, match="use at most"):
        trial_table(real(), 3e-6, slope_max=1e-4)
    trial = trial_table(real(), 3e-6, slope_max=1e-3)
    c = trial.table
    assert np.abs(np.diff(c.forward) / np.diff(c.positions)).max() <= 1e-3


def test_reverse_column_is_lower():
    trial = trial_table(real(reverse=True), 4e-6)
    assert trial.table.reverse == pytest.approx(0.3 * trial.table.forward, abs=1e-20)
    assert trial.amplitude_reverse == pytest.approx(1.2e-6, abs=1e-20)
    assert "0.3 of it" in trial.if_right
    assert trial_table(real(), 4e-6).table.reverse is None


def test_verdict():
    trial = trial_table(real(), 4e-6)
    assert trial.judge(3.9e-6, 0.1e-6) == "right"
    assert trial.judge(-4.2e-6, 0.1e-6) == "wrong"
    for nothing in (0.0, 1e-6, 13e-6, -0.3e-6):
        with pytest.raises(DataError, match="not active"):
            trial.judge(nothing, 0.1e-6)
    with pytest.raises(DataError, match="average more"):
        trial.judge(4e-6, 1e-6)
    with pytest.raises(DataError, match="finite"):
        trial.judge(float("nan"))


@pytest.mark.parametrize("sign", [1, -1])
def test_sentences_say_what_a_controller_shows(sign):
    """A controller that adds sign * c is judged from what its indicator shows."""
    trial = trial_table(real(), 4e-6)
    shown = sign * np.interp(trial.position, trial.table.positions, trial.table.forward)
    assert trial.judge(float(shown)) == ("right" if sign > 0 else "wrong")
    where = f"{trial.position * 1e3:.6g} mm"
    assert where in trial.instruction
    assert f"+4 µm at {where}" in trial.if_right or f"+4 um at {where}" in trial.if_right
    assert "-4 " in trial.if_wrong
    assert "mirrored" in trial.if_wrong


def test_dry_run_against_its_source_tells_the_sign():
    trial = trial_table(real(reverse=True), 4e-6)
    done = trial.table.verify(trial.table.source)
    assert done.after_pv < 1e-12
    with pytest.raises(SignCheckFailedError):
        trial.table.negated().verify(trial.table.source)


def test_real_corrections_and_hashes_are_not_in_it():
    trial = trial_table(real(), 4e-6)
    assert trial.table.source_sha256 == ()
    assert trial.table.history[0].name == "trial_table"


def test_bad_input_is_refused():
    for wrong in (0.0, float("nan"), float("inf")):
        with pytest.raises(DataError, match="amplitude"):
            trial_table(real(), wrong)
    with pytest.raises(DataError, match="third is one of auto"):
        trial_table(real(), 1e-6, third="second")
    with pytest.raises(DataError, match="slope_max"):
        trial_table(real(), 1e-6, slope_max=0.0)
    with pytest.raises(TableError, match="another third"):
        trial_table(real(30e-3), 1e-6, third="middle")
    with pytest.raises(TableError, match="no entry"):
        trial_table(real(n=2), 1e-6)


def shown(table, position, *, scale=1.0, mirrored=False, swapped=False):
    """What an indicator sees at a place, moving in + direction, from a controller that errs so."""
    p = table.positions
    at = p[0] + p[-1] - position if mirrored else position
    column = table.reverse if swapped else table.forward
    return scale * float(np.interp(at, p, column))


@pytest.mark.parametrize("third", ["first", "middle", "last", "auto"])
@pytest.mark.parametrize("sign", [1, -1])
@pytest.mark.parametrize(
    ("fault", "words"),
    [
        ({"swapped": True}, "columns are swapped"),
        ({"scale": 0.5}, "scaled by half"),
        ({"scale": 2.0}, "scaled by two"),
        ({"mirrored": True}, "mirrored"),
    ],
)
def test_each_fault_of_a_controller_is_told_from_a_sign(third, sign, fault, words):
    trial = trial_table(real(60e-3, reverse=True), 3e-6, third=third)
    reading = sign * shown(trial.table, trial.position, **fault)

    with pytest.raises(DataError, match=words) as caught:
        trial.judge(reading, 0.05e-6)
    assert ("sign is wrong" in str(caught.value)) == (sign < 0 and "mirrored" not in fault)


@pytest.mark.parametrize("third", ["first", "middle", "last"])
def test_a_mirrored_table_is_flat_at_the_peak_and_seen_at_its_mirror(third):
    trial = trial_table(real(), 2e-6, third=third)
    t = trial.table
    assert shown(t, trial.position, mirrored=True) == 0.0
    assert shown(t, trial.mirror) == 0.0
    assert trial.judge(shown(t, trial.position), at_mirror=shown(t, trial.mirror)) == "right"
    with pytest.raises(DataError, match="mirrored or shifted"):
        trial.judge(0.0, at_mirror=shown(t, trial.mirror, mirrored=True))
    with pytest.raises(DataError, match="at_mirror"):
        trial.judge(2e-6, at_mirror=float("nan"))


def test_few_entries_never_make_a_bump_that_is_its_own_mirror():
    five = real(n=5)  # one entry of the middle third: 30 mm, the middle itself
    with pytest.raises(TableError, match="another third"):
        trial_table(five, 1e-6, third="middle")
    assert trial_table(five, 1e-6).position == pytest.approx(45e-3, abs=1e-12)
    for reference in (0.0, 30e-3):
        with pytest.raises(TableError, match="more entries"):
            trial_table(real(reference, n=4), 1e-6)
