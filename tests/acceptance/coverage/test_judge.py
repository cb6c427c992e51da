"""The judge is judged: estimates of known worth get the verdict that they deserve."""

import math
from dataclasses import replace

import numpy as np
import pytest
from acceptance.coverage import judge
from acceptance.coverage.judge import (
    RowResult,
    Score,
    drawn_covers,
    expected_worst,
    failures,
    gaussian,
    judge_row,
    line_remover,
    markdown,
    mean_of_runs,
    score_set,
    without_line,
)
from acceptance.coverage.machine import Machine, simulate
from acceptance.coverage.rows import ROWS, Row

KNOWN = 5e-9
"""sd in m of the estimates made here."""


class Guess:
    """Truth of the set and an error of known covariance: waves of 60 to 2 mm."""

    def __init__(self, measured, rng, *, band=1.0, size=1.0, offset=3e-7, slope=1e-5, message=""):
        self.truth = measured.truths[1]
        self.k = 2 * math.pi * np.arange(1, 31) / 60e-3
        self.each = KNOWN / math.sqrt(self.k.size)
        self.a, self.b = size * self.each * rng.standard_normal((2, self.k.size))
        self.band, self.offset, self.slope = band, offset, slope
        self.messages, self.lag = (message,) if message else (), 0.0

    def evaluate(self, x):
        wave = np.cos(np.outer(x, self.k)) @ self.a + np.sin(np.outer(x, self.k)) @ self.b
        return self.truth(x * 1e3) * 1e-9 + wave + self.offset + self.slope * x

    def covariance(self, x):
        waves = self._waves_without_line(x)
        return waves @ waves.T

    def sd(self, x):
        return np.sqrt(np.square(self._waves_without_line(x)).sum(axis=1))

    def _waves_without_line(self, x):
        angle = np.outer(x, self.k)
        waves = self.each * self.band * np.hstack([np.cos(angle), np.sin(angle)])
        return line_remover(x) @ waves


def guesses(monkeypatch, name="base", sets=60, **options):
    """Score `sets` guesses without running a separator."""
    made = {}

    def simulated(machine, seed):
        made["now"] = simulate(replace(machine, modes=()), seed)
        return made["now"]

    monkeypatch.setattr(judge, "simulate", simulated)

    def estimator(runs, judged_mm):
        return Guess(made["now"], np.random.default_rng([made["now"].seed, 77]), **options)

    scores = [score_set(estimator, ROWS[name], 3000 + i, rival=False) for i in range(sets)]
    return RowResult(name, scores)


def test_an_exact_band_passes_and_offset_and_line_do_not_count(monkeypatch):
    result = guesses(monkeypatch)
    found = result.summary()

    assert failures(result) == []
    # 60 sets of about 45 free numbers each: sd of the mean cover is below 0.01
    assert found["cover"] == pytest.approx(0.954, abs=0.025)
    assert found["ratio"] == pytest.approx(1.0, abs=0.06)
    assert found["sd_nm"] == pytest.approx(5.0, rel=0.1, abs=0.0)
    assert found["expected_worst_5"] - 0.05 <= found["worst"]
    assert found["sd_mismatch"] < 1e-9


@pytest.mark.parametrize(
    ("options", "word"),
    [
        ({"band": 0.6}, "mean cover"),
        ({"band": 0.6}, "RMS sd over RMS error 0.6"),
        ({"band": 1.8}, "RMS sd over RMS error 1.7"),
        ({"message": "readings lag the position by 0.98 ms (u 0.12 ms)"}, "false lag message"),
        (
            {"message": "a wave of 5.2 mm, 120 nm, has another phase in each run"},
            "false slip in 60 of 60",
        ),
    ],
)
def test_a_wrong_band_and_a_false_message_fail_with_their_number(monkeypatch, options, word):
    bad = " | ".join(failures(guesses(monkeypatch, **options)))

    assert word in bad


def test_one_bad_set_in_many_is_seen_by_the_expected_worst(monkeypatch):
    """Its mean cover and ratio would pass."""
    result = guesses(monkeypatch)
    bad = guesses(monkeypatch, sets=1, size=3.0).scores[0]
    bad.drawn = result.scores[0].drawn
    mixed = RowResult("base", [*result.scores[1:], bad])

    assert any("worst set" in text for text in failures(mixed))
    assert not any("mean cover" in text for text in failures(mixed))


def test_a_refusal_and_a_missing_end_are_told(monkeypatch):
    result = guesses(monkeypatch, sets=3)
    result.scores[0].refused = "InvalidSamplesError: travels differ"
    result.scores[1].unseen = 0.2
    text = " | ".join(failures(result))

    assert "refused in 1 sets: InvalidSamplesError" in text
    assert "no estimate on 10.0% of the judged range" in text
    assert "FAIL" in markdown(result)
    everything = RowResult("base", [Score(1, refused="DataError: nothing")])
    assert "refused in all 1 sets" in failures(everything)[0]
    assert "FAIL" in markdown(everything)


def test_a_fault_of_the_harness_is_no_refusal():
    def broken(runs, judged_mm):
        raise ZeroDivisionError

    with pytest.raises(ZeroDivisionError):
        score_set(broken, ROWS["none"], 1)


def test_draws_of_few_waves_scatter_more_than_draws_of_many():
    """The expected worst knows how few numbers an error is made of."""
    x = np.linspace(0.0, 1.0, 200)
    rng = np.random.default_rng(3)

    def covers(waves):
        away = x[:, None] - x[None, :]
        full = sum(np.cos(2 * math.pi * k * away) for k in range(1, waves + 1)) / waves
        return [list(drawn_covers(full, rng)) for _ in range(24)]

    few, many = (expected_worst(covers(n), rng)[0] for n in (1, 40))
    # one wave of amplitude A ~ Rayleigh, sd 1: the whole range within 2 sd or much of it not
    assert few < 0.6
    assert 0.85 < many < 0.94
    single = np.mean(covers(1))
    assert single == pytest.approx(0.954, abs=0.02)


def test_the_rival_halves_a_wave_of_its_cut_off_and_keeps_a_line():
    x = np.arange(0.0, 60.0, 0.05)
    inside = (x > 20) & (x < 40)
    wave = np.cos(2 * math.pi * x / 4.0)
    got = gaussian(x, wave, 4.0)

    assert np.ptp(got[inside]) == pytest.approx(1.0, abs=2e-3)
    assert np.abs(gaussian(x, 3.0 + 2.0 * x, 4.0) - 3.0 - 2.0 * x).max() < 1e-9
    assert gaussian(x, wave, 0.0) is wave


def test_the_rival_averages_the_runs_without_their_offsets():
    quiet = Machine(modes=(), white_nm=0.0, waves=((7.0, 100.0),), unequal_mm=3.0)
    made = simulate(quiet, 3)
    x, z = mean_of_runs(made.runs)
    away = without_line(x, z - made.truths[1](x))

    assert x[0] == pytest.approx(0.0, abs=1e-9)
    # linear interpolation between readings 0.16 mm apart: 100 (2 pi 0.16/7)^2/8 = 0.26 nm
    assert np.nanmax(np.abs(away)) < 0.8


def test_a_row_over_seeds_uses_each_once():
    class Flat(Guess):
        def __init__(self):
            self.messages, self.lag = (), 0.0

        def evaluate(self, x):
            return 0.0 * x

        def sd(self, x):
            return 1e-9 + 0.0 * x

        def covariance(self, x):
            return 1e-18 * np.eye(x.size)

    result = judge_row("none", lambda runs, judged: Flat(), sets=3, seed=50)

    assert [s.seed for s in result.scores] == [50, 51, 52]
    found = result.summary()
    assert found["error_nm"] < 1e-9
    assert found["cover"] == 1.0
    assert failures(result) == []
    assert isinstance(ROWS["none"], Row)
