"""Evidence of repeatability: statistics against their definitions and against noise."""

import json

import numpy as np
import pytest
from scipy.stats import f as f_distribution

from metrosep import Run, RunSet
from metrosep.errors import DataError, NotSeparableError
from metrosep.separation import ErrorEstimate, machine_axis, separate as separate_runs
from metrosep.separation.runs.evidence import (
    _held_by_all,
    evidence_columns,
    evidence_table,
    noise_peaks,
    said_lag,
)
from metrosep.spectral.autoregressive import AutoregressiveModel

SHORTEST = 1.5e-3
"""The shortest wave of the simulated axis is 3.3 mm; the harmonics below cost most of the time of a joint estimate."""


def separate(runs, **options):
    """Separate; a joint estimate goes down to SHORTEST unless the test says otherwise."""
    if options.get("method", "joint") == "joint":
        options = {"shortest": SHORTEST} | options
    return separate_runs(runs, **options)


ROUNDING = 1e-9


def runs_of(make, *, feeds=(0.08, 0.12, 0.16), n=3, seed=0, travel=50e-3):
    """Runs whose readings are make(rng, x, t, v), 1 kHz."""
    rng = np.random.default_rng(seed)
    out = []
    for v in feeds:
        for _ in range(n):
            t = np.arange(int(travel / v * 1000) + 1) * 1e-3
            out.append(Run(v * t, make(rng, v * t, t, v), t=t, feed=v))
    return RunSet(out)


def noise(rng, x, t, v):
    return 1e-8 * rng.standard_normal(x.size)


def test_statistics_follow_their_definitions():
    rng = np.random.default_rng(1)
    z = rng.standard_normal((6, 5)) + 1j * rng.standard_normal((6, 5)) + 0.5
    columns = evidence_columns(z, np.repeat([0, 1, 2], 2), np.ones(5, dtype=bool), rate=0.05)

    for k in range(5):
        total = sum(
            (z[i, k] * np.conj(z[j, k])).real for i in range(6) for j in range(6) if i != j
        )
        g2 = total / 30
        s = np.var(z[:, k].real, ddof=1) + np.var(z[:, k].imag, ddof=1)
        f = 6 * abs(z[:, k].mean()) ** 2 / s
        p = f_distribution.sf(f, 2, 10)
        for name, value, unit in (("g2_nm2", g2, 1e18), ("s_nm2", s, 1e18), ("f", f, 1)):
            assert columns[name][k] / unit == pytest.approx(value, abs=ROUNDING)
        assert columns["p"][k] == pytest.approx(p, abs=ROUNDING)


def test_p_is_uniform_and_coherence_keeps_its_level_in_noise():
    rng = np.random.default_rng(2)
    z = rng.standard_normal((9, 20000)) + 1j * rng.standard_normal((9, 20000))
    columns = evidence_columns(z, np.repeat([0, 1, 2], 3), np.ones(20000, dtype=bool), rate=0.05)

    p = np.array(columns["p"])
    for level in (0.01, 0.05, 0.5):  # three binomial standard deviations
        assert np.mean(p < level) == pytest.approx(
            level, abs=3 * np.sqrt(level * (1 - level) / 20000)
        )
    above = np.mean(np.array(columns["coherence"]) > columns["coherence_null"][0])
    assert above == pytest.approx(0.05, abs=0.005)
    assert np.mean(columns["g2_nm2"]) / 1e18 == pytest.approx(0.0, abs=0.01)


def test_a_wave_of_the_geometry_is_selected_with_its_amplitude():
    def wave(rng, x, t, v):
        return noise(rng, x, t, v) + 1e-7 * np.cos(2 * np.pi * x / 5e-3)

    table = evidence_table(runs_of(wave)).to_frame()
    row = table.iloc[9]

    assert row["wavelength_mm"] == pytest.approx(5.0, abs=0.05)
    assert row["selected"]
    assert row["amplitude_nm"] == pytest.approx(100.0, rel=0.05, abs=0.0)
    assert row["coherence"] > row["coherence_null"]


def test_a_vibration_locked_to_the_start_is_no_evidence():
    """24 Hz in every run from its start: 3.3, 5 and 6.7 mm; one feed alone would believe it."""

    def locked(rng, x, t, v):
        return noise(rng, x, t, v) + 1e-7 * np.sin(2 * np.pi * 24 * t)

    table = evidence_table(runs_of(locked)).to_frame()
    near = [round(50 / w) - 1 for w in (10 / 3, 5, 20 / 3)]

    assert not table["selected"].iloc[near].any()


def test_many_runs_at_one_feed_do_not_decide():
    def locked(rng, x, t, v):
        return noise(rng, x, t, v) + 1e-7 * np.sin(2 * np.pi * 24 * t)

    many = list(runs_of(locked, feeds=(0.12,), n=10))
    lopsided = RunSet([*many, *runs_of(locked, feeds=(0.08,), n=1, seed=1)])
    result = evidence_table(lopsided)

    assert not result.to_frame()["selected"].iloc[9]
    assert result.audit["n_runs_left_out"] == 9
    assert "omitted" in " ".join(result.messages)


def test_wavelengths_at_which_the_feeds_do_not_tell_are_blank():
    """Spread 0.08 m/s; a mode 8 Hz wide is not told apart above 10 mm."""
    table = evidence_table(runs_of(noise), bandwidth=8.0).to_frame()
    blind = table["wavelength_mm"] >= 10.0 - 1e-6

    assert (table["reason"][blind] == "not separable by repeatability").all()
    assert table.loc[blind, ["p", "q", "coherence", "wiener_gain"]].isna().all(axis=None)
    assert not table["selected"][blind].any()
    assert table.loc[~blind, "p"].notna().all()


@pytest.mark.slow
def test_noise_selects_at_the_stated_rate():
    n = sum(
        int(evidence_table(runs_of(noise, seed=s)).to_frame()["selected"].any()) for s in range(60)
    )

    assert n <= 8  # 3 expected at 5 %, 8 is three standard deviations


def test_one_feed_is_refused():
    with pytest.raises(NotSeparableError, match=">= 2 feedrates"):
        evidence_table(runs_of(noise, feeds=(0.12,)))


@pytest.mark.parametrize(
    "options", [{"false_discovery_rate": 5}, {"bandwidth": -1.0}, {"shortest": 5.0}]
)
def test_options_that_cannot_be_meant_are_refused(options):
    with pytest.raises(DataError):
        evidence_table(runs_of(noise), **options)


def test_both_directions_at_once_are_refused():
    runs = runs_of(noise)
    mixed = RunSet([*runs, *(Run(r.x[::-1], r.z, t=r.t, feed=r.feed) for r in runs)])

    with pytest.raises(DataError, match="both ways"):
        evidence_table(mixed)


def test_the_joint_estimate_holds_the_evidence_and_stores_it():
    axis = machine_axis(seed=1)
    estimate = separate(axis.runs, start=0.0, length=45e-3)
    table = evidence_table(axis.runs, start=0.0, length=45e-3)

    assert estimate.evidence.equals(table.to_frame())
    assert estimate.audit["evidence"] == table.audit
    stored = estimate.to_dict()
    back = ErrorEstimate.from_dict(json.loads(json.dumps(stored, allow_nan=False)))
    assert back.evidence.equals(estimate.evidence)
    del stored["evidence"], stored["audit"]["evidence"]
    assert ErrorEstimate.from_dict(stored).evidence.empty


@pytest.mark.parametrize(
    ("runs", "options", "told"),
    [
        (runs_of(noise, feeds=(0.12,)), {"min_feeds": 1}, "fewer than 2 feedrates"),
        (runs_of(noise, n=1), {}, "fewer than 2 runs at a feedrate"),
    ],
)
def test_too_few_runs_leave_the_evidence_empty_with_a_reason(runs, options, told):
    estimate = separate(runs, **options)

    assert estimate.evidence.empty
    assert estimate.audit["evidence"] == {"not_taken": told}
    assert "evidence" not in estimate.to_dict()


def test_a_wide_gap_leaves_the_evidence_empty_with_a_reason():
    runs = list(runs_of(noise))
    z = runs[0].z.copy()
    z[200:300] = np.nan
    estimate = separate(RunSet([Run(runs[0].x, z, t=runs[0].t, feed=runs[0].feed), *runs[1:]]))

    assert estimate.evidence.empty
    assert "not measured" in estimate.audit["evidence"]["not_taken"]


def test_evidence_of_one_direction_never_stands_for_both():
    estimate = separate(machine_axis(seed=3, directions=(1, -1), n_repeats=2).runs)

    assert estimate.evidence.empty or set(estimate.evidence["direction"]) == {
        "forward",
        "reverse",
    }


def test_probes_on_the_same_pass_are_not_counted_twice():
    runs = runs_of(noise)
    twice = RunSet([*runs, *runs])
    alone = separate(runs)
    both = separate(twice, probes=["a"] * len(runs) + ["b"] * len(runs))

    assert both.evidence.equals(alone.evidence)


def test_the_spectrum_says_where_repeatability_cannot_tell():
    """50 mm, feeds 4800 to 9600: above 25 mm no feed moves a vibration by a cell."""

    def waves(rng, x, t, v):
        shape = 3e-7 * np.cos(2 * np.pi * x / 31e-3) + 2e-7 * np.cos(2 * np.pi * x / 10e-3)
        return noise(rng, x, t, v) + shape

    spectrum = separate(runs_of(waves)).spectrum
    chosen = spectrum[spectrum["selected"]]
    long = chosen["wavelength_mm"] >= 25.0

    assert long.any()
    assert (~long).any()
    assert chosen["reason"][long].str.contains("not separable by repeatability").all()
    assert (chosen["reason"][~long] == "repeats at all feedrates").all()
    assert not spectrum["reason"][~spectrum["selected"]].str.contains("not separable").any()


@pytest.mark.parametrize("seed", [5, 15, 101])
def test_a_strong_wave_off_the_grid_of_the_travel_is_not_called_missing_from_the_estimate(seed):
    """2.7 and 6.6 waves in 367 mm leak into every harmonic of the travel; nothing is left out."""

    def error(rng, x, t, v):
        hum = 0.3e-6 * np.sin(2 * np.pi * 7.3 * t + rng.uniform(0, 2 * np.pi))
        waves = 3.6e-6 * np.sin(2 * np.pi * x / 0.1369 + 0.7) + 2e-6 * np.cos(
            2 * np.pi * x / 0.0559
        )
        bow = 21e-6 * (x / 0.37 - 0.5) ** 2
        return waves + bow + hum + 0.16e-6 * rng.standard_normal(x.size)

    rng = np.random.default_rng(seed)
    runs = []
    for v in (0.015, 0.0367, 0.0867):
        for _ in range(2):
            t = np.arange(int(0.37 / v * 20)) / 20
            runs.append(Run(v * t, error(rng, v * t, t, v), t=t, feed=v))

    messages = separate(RunSet(runs), shortest=None).messages

    assert not [m for m in messages if "repeat a wave" in m]


def test_a_negative_lag_is_said_as_readings_that_lead():
    assert said_lag(1.25) == "lag the position by 1.25 ms"
    assert said_lag(-2.2068) == "lead the position by 2.21 ms"


@pytest.mark.parametrize(
    ("poles", "resonances"),
    [
        (((60.0, 0.99), (200.0, 0.99)), (60.0, 200.0)),
        # 6.3 at 111 Hz on the way to 15.5 at 150 Hz: it falls by less than a factor of 2 between them
        (((150.0, 0.98), (110.0, 0.96)), (150.0,)),
    ],
)
def test_a_bump_on_the_flank_of_a_resonance_is_not_another(poles, resonances):
    polynomial = np.ones(1)
    for hz, radius in poles:
        own = [1.0, -2.0 * radius * np.cos(2.0 * np.pi * hz * 1e-3), radius**2]
        polynomial = np.convolve(polynomial, own)

    found = noise_peaks(AutoregressiveModel(-polynomial[1:], 1.0, 1e-3))

    assert sorted(found) == pytest.approx(resonances, abs=1.0)


@pytest.mark.parametrize("of_one", [False, True])
def test_a_vibration_whose_frequency_differs_between_runs_is_of_all(of_one):
    """One per cent of 10 Hz is ten cells of a run of 100 s: at one frequency the nearest run had all the power."""
    rng = np.random.default_rng(11)
    t = 1e-3 * np.arange(100_000)
    said = []
    for _ in range(10):
        records = [1e-9 * rng.standard_normal(t.size) for _ in range(8)]
        for i in range(1 if of_one else 8):
            hz = 10.0 + 0.1 * rng.standard_normal()
            records[i] += 20e-9 * np.sin(2.0 * np.pi * hz * t + rng.uniform(0.0, 6.0))
        said.append(_held_by_all((9.7, 10.3), records, 1e-3))

    assert said == [not of_one] * 10
