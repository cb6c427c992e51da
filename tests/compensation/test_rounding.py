"""Integers of controllers: half a step, no drift, and ranges with the way out."""

import numpy as np
import pytest

from metrosep.compensation.limits import Finding, require_findings
from metrosep.compensation.rounding import (
    round_entries,
    round_increments,
)
from metrosep.core.errors import DataError, InvalidSamplesError, LimitError, TooFewSamplesError

ROUNDING = 1e-20  # m


def test_entries_are_off_by_half_a_unit_at_most():
    c = np.random.default_rng(2).normal(0, 1e-6, 300)
    rounded = round_entries(c, 0.625e-9)
    assert rounded.entries == pytest.approx(c / 0.625e-9, abs=0.5 + 1e-9)
    assert np.abs(rounded.entries * 0.625e-9 - c).max() == pytest.approx(
        rounded.error, abs=ROUNDING
    )
    assert rounded.error <= 0.5 * 0.625e-9 * (1 + 1e-9)
    assert rounded.findings == ()


def test_pmac_sixteenths_of_a_count():
    # example of the specification, section 3.1: 10 nm a count, e in um
    e = np.array([0.5, 0.8, 0.6, 0.2, -0.2, -0.4, -0.2, 0.0]) * 1e-6
    assert round_entries(-e, 10e-9 / 16).entries.tolist() == [
        -800, -1280, -960, -320, 320, 640, 320, 0,
    ]  # fmt: skip


@pytest.mark.parametrize("slope", [0.4, -0.4, 0.5, 1.3, 0.01])
def test_the_running_sum_does_not_drift(slope):
    c = slope * 1e-6 * np.arange(1000) + 0.2e-6
    rounded = round_increments(c, 1e-6)
    total = np.cumsum(np.r_[round(0.2), rounded.entries]) * 1e-6
    assert np.abs(total - c).max() <= 0.5e-6 * (1 + 1e-9)
    assert rounded.values == pytest.approx(total, abs=ROUNDING * 1e6)
    naive = np.cumsum(np.r_[0, np.rint(np.diff(c) / 1e-6)]) * 1e-6
    if slope != 0.5:  # 999 rounding errors of one interval add up
        drift = 999 * abs(slope - round(slope)) * 1e-6
        assert np.abs(naive - (c - c[0])).max() == pytest.approx(drift, abs=1e-12)


def test_magnification_makes_steps_larger():
    c = np.linspace(0, 400e-6, 5)
    fine = round_increments(c, 1e-6)
    assert fine.entries.tolist() == [100] * 4
    coarse = round_increments(c + 0.3e-6, 1e-6, 4)
    assert coarse.step == pytest.approx(4e-6, abs=ROUNDING)
    assert coarse.entries.tolist() == [25] * 4
    assert coarse.error == pytest.approx(0.3e-6, abs=1e-15)


def test_out_of_range_names_the_first_interval_and_the_way_out():
    c = np.array([0, 100, 350, 400, 200]) * 1e-6
    rounded = round_increments(c, 1e-6, positions=np.arange(5) * 10e-3)
    (finding,) = rounded.findings
    assert finding.level == "error"
    assert "interval 1 from 10 to 20 mm needs an increment of 250" in finding.problem
    assert "2 of 4" in finding.problem
    assert "magnification of 2" in finding.fix
    # and that magnification is indeed enough
    assert round_increments(c, 1e-6, 2).findings == ()
    with pytest.raises(LimitError, match="interval 1"):
        require_findings(rounded.findings)
    assert require_findings(rounded.findings, waive=True) == rounded.findings
    # nothing was cut to the range
    assert rounded.entries.tolist() == [100, 250, 50, -200]


def test_range_is_not_symmetric():
    assert round_increments([0, -128e-6], 1e-6).findings == ()
    (finding,) = round_increments([0, 128e-6], 1e-6).findings
    assert "128" in finding.problem
    (finding,) = round_increments(np.array([0, 9, 30]) * 1e-6, 1e-6, limits=(-7, 7)).findings
    assert "magnification of 3" in finding.fix
    assert round_increments(np.array([0, 9, 30]) * 1e-6, 1e-6, 3, (-7, 7)).findings == ()


def test_int_range_of_entries():
    (finding,) = round_entries([0, 3.0], 1e-9, limits=(-(2**31), 2**31 - 1)).findings
    assert "entry 1 is 3000000000" in finding.problem


def test_steps_above_a_tenth_of_the_span_are_an_error():
    ok = np.linspace(-0.5e-6, 0.5e-6, 11)
    assert round_entries(ok, 0.1e-6).findings == ()
    (finding,) = round_entries(ok, 0.11e-6).findings
    assert finding.level == "error"
    assert "fewer than 10 steps" in finding.problem
    (finding,) = round_increments(ok, 0.01e-6, 11).findings
    assert "fewer than 10 steps" in finding.problem
    with pytest.raises(LimitError, match="110 nm"):
        require_findings(round_entries(ok, 0.11e-6).findings)


def test_nothing_to_correct_is_not_too_coarse():
    assert round_entries([0.0, 0.0], 1e-6).findings == ()
    assert round_increments([0, 0], 1e-6).entries.tolist() == [0]


def test_warnings_pass():
    warning = (Finding("warning", "a", "b"),)
    assert require_findings(warning) == warning


def test_negated_curve_gives_negated_entries():
    c = np.random.default_rng(5).normal(0, 20e-6, 99)
    one, other = round_increments(c, 1e-6), round_increments(-c, 1e-6)
    assert (one.entries == -other.entries).all()
    assert not one.entries.flags.writeable
    assert one.audit["step_nm"] == pytest.approx(1000, abs=1e-9)


@pytest.mark.parametrize("call", [round_entries, round_increments])
def test_bad_input_is_refused(call):
    with pytest.raises(DataError, match="positive"):
        call([0.0, 1e-6], 0.0)
    with pytest.raises(DataError, match="positive"):
        call([0.0, 1e-6], float("nan"))
    with pytest.raises(InvalidSamplesError, match="value 1 is nan"):
        call([0.0, np.nan], 1e-6)
    with pytest.raises(InvalidSamplesError, match="check the units"):
        call([0.0, 1e9], 1e-9)
    with pytest.raises(TooFewSamplesError, match="at least"):
        call([], 1e-6)
    with pytest.raises(InvalidSamplesError, match="shape"):
        call([[0.0, 1.0]], 1e-6)
    with pytest.raises(InvalidSamplesError, match="value 1 is nan"):
        call(np.ma.masked_equal([0.0, 2.0, 1.0], 2.0), 1e-6)
    with pytest.raises(InvalidSamplesError, match="real numbers"):
        call([1j, 2.0], 1e-6)
    with pytest.raises(DataError, match="the unit of an entry '1' has no unit"):
        call([0.0, 1e-6], "1")
    with pytest.raises(DataError, match="smallest, largest"):
        call([0.0, 1e-6], 1e-7, limits=(5, -5))


def test_bad_magnification_and_positions():
    for wrong in (0, 1.5, -2, True, "2", float("nan")):
        with pytest.raises(DataError, match="whole number"):
            round_increments([0.0, 1e-6], 1e-7, wrong)
    with pytest.raises(TooFewSamplesError, match="at least 2 sample"):
        round_increments([0.0], 1e-6)
    with pytest.raises(DataError, match="1 positions"):
        round_increments([0.0, 1.0], 1e-6, positions=[0.0])


def test_the_worst_is_the_one_that_is_out_of_range():
    """-128 is allowed, +128 is not, and they are as large."""
    (finding,) = round_increments([0, -128e-6, 0], 1e-6).findings

    assert "interval 1 needs an increment of 128" in finding.problem
    assert "the worst is 128" in finding.problem
    assert "magnification of 2" in finding.fix
    assert round_increments([0, -128e-6, 0], 1e-6, 2).findings == ()


@pytest.mark.parametrize("seed", range(40))
def test_the_magnification_that_is_named_is_enough_and_the_smallest(seed):
    rng = np.random.default_rng(seed)
    c = rng.normal(0, 30e-6, 50)
    limits = [(-7, 7), (-128, 127), (-3, 9)][seed % 3]
    now = int(rng.integers(1, 4))
    found = [f for f in round_increments(c, 0.1e-6, now, limits).findings if "needs" in f.problem]
    if not found:
        return
    named = int(found[0].fix.split("magnification of ")[1].split()[0])

    def in_range(magnification):
        more = round_increments(c, 0.1e-6, magnification, limits).findings
        return not any("needs" in f.problem for f in more)

    assert in_range(named)
    # one of the next smaller may do by luck of rounding, half of it never
    assert not in_range(max(now, named // 2))


def test_no_magnification_is_named_where_none_would_do():
    (finding,) = round_increments([0, 50e-6], 1e-6, limits=(-5, 0)).findings

    assert "a larger magnification" in finding.fix
