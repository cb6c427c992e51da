"""The simulator against closed forms: who judges others is judged first."""

import math
from dataclasses import replace

import numpy as np
import pytest
from acceptance.coverage.machine import (
    Machine,
    Mode,
    corpus_folder,
    low_passed,
    mirror_profile,
    oscillator,
    simulate,
)
from acceptance.coverage.rows import ROWS
from scipy.signal import welch

SILENT = Machine(modes=(), white_nm=0.0, offset_nm=0.0, waves=((7.0, 100.0),))
FM = 1e-6
"""In nm: rounding of values of some hundred nm in double precision, and of the spline."""


def runs_of(machine, seed=5):
    return simulate(machine, seed)


@pytest.mark.parametrize(
    "mode", [Mode(150.0, 0.02, 200.0), Mode(3.0, 0.5, 100.0), Mode(12.0, 0.03, 70.0)]
)
def test_the_oscillator_has_its_variance_and_autocovariance(mode):
    """r(T) = s^2 e^(-D w T) (cos w1 T + D/sqrt(1-D^2) sin w1 T), w1 = w sqrt(1-D^2)."""
    step, n = 1e-3, 2**19
    z = oscillator(np.random.default_rng(1), mode, step, n)
    w = 2 * math.pi * mode.hz
    d = math.sqrt(1 - mode.damping**2)
    # number of independent values: duration over the correlation time 1/(D w); 4 sd
    tolerance = 4 * math.sqrt(2.0 / (n * step * mode.damping * w))
    for lag in (0, 1, 3, 7, 40):
        at = lag * step
        wanted = math.exp(-mode.damping * w * at) * (
            math.cos(w * d * at) + mode.damping / d * math.sin(w * d * at)
        )
        found = np.mean(z[: n - lag] * z[lag:]) / mode.rms_nm**2
        assert abs(found - wanted) < tolerance


def test_the_oscillator_has_the_spectrum_of_a_driven_mass():
    """S(f) = s^2 (2 D / pi f0) / ((1-u^2)^2 + (2 D u)^2) 2, u = f/f0, one-sided."""
    mode, rate = Mode(20.0, 0.1, 50.0), 4000.0
    z = oscillator(np.random.default_rng(2), mode, 1 / rate, 2**19)
    f, s = welch(z, rate, nperseg=2**15)
    u = f / mode.hz
    shape = 1.0 / ((1 - u**2) ** 2 + (2 * mode.damping * u) ** 2)
    wanted = mode.rms_nm**2 * 4 * mode.damping / (math.pi * mode.hz) * shape
    for low, high in ((2, 10), (10, 18), (18, 22), (22, 40), (40, 200)):
        where = (f > low) & (f < high)
        # 127 half-overlapping segments of a Hann window, many lines each: 5 % is more than 4 sd
        assert s[where].sum() / wanted[where].sum() == pytest.approx(
            1.0, abs=0.1 if high < 30 else 0.05
        )


def test_the_first_value_is_as_large_as_the_others():
    """No start from rest: the table runs for long before the record begins."""
    mode = Mode(3.0, 0.5, 100.0)
    first = [oscillator(np.random.default_rng(i), mode, 1e-3, 5)[0] for i in range(2000)]
    assert np.std(first) == pytest.approx(100.0, abs=4 * 100 / math.sqrt(2 * 2000))


@pytest.mark.parametrize("way", [1, -1])
def test_a_late_reading_shows_the_error_of_the_place_that_it_has_left(way):
    """z(x) = g(x - v d), v signed: on the way back the place is at greater x."""
    machine = replace(SILENT, delay_s=1e-3, both_ways=True)
    made = runs_of(machine)
    for run in made.runs:
        if run.direction == way:
            v = way * run.feed_mm_s
            seen = made.truths[way](run.x_mm - v * 1e-3)
            assert np.abs(run.z_nm - seen).max() < FM
            early = made.truths[way](run.x_mm + v * 1e-3)
            assert np.abs(run.z_nm - early).max() > 10.0  # 100 nm, 7 mm, 0.32 mm: 28 nm


def test_a_low_pass_sensor_reads_a_wave_smaller_and_late():
    """H = 1/(1 + i w tau), w = 2 pi v / wavelength: amplitude and phase at each feed."""
    machine = replace(SILENT, low_pass_hz=50.0)
    made = runs_of(machine)
    tau = 1 / (2 * math.pi * 50.0)
    for run in made.runs[::3]:
        w = 2 * math.pi * run.feed_mm_s / 7.0
        angle = w * run.t_s
        design = np.column_stack([np.cos(angle), np.sin(angle), np.ones_like(angle)])
        a, b, _ = np.linalg.lstsq(design, run.z_nm, rcond=None)[0]
        c, d, _ = np.linalg.lstsq(design, made.truths[1](run.x_mm), rcond=None)[0]
        ratio = (a - 1j * b) / (c - 1j * d)
        # straight between fine steps of 0.05 ms: (w h)^2/12 = 5e-6
        assert abs(ratio - 1 / (1 + 1j * w * tau)) < 2e-5


def test_a_ramp_leaves_a_first_order_sensor_late_by_its_time_constant():
    t = np.arange(4000) * 1e-4
    y = low_passed(3.0 * t, 1e-4, 20.0)
    assert y[-1] == pytest.approx(3.0 * (t[-1] - 1 / (2 * math.pi * 20.0)), abs=1e-12)


def test_vibration_passes_the_sensor_that_it_shakes():
    machine = replace(SILENT, waves=(), low_pass_hz=50.0, modes=(Mode(150.0, 0.02, 200.0),))
    z = np.concatenate([r.z_nm for i in range(20) for r in runs_of(machine, i).runs])
    # 1/sqrt(1 + 9) of it; 180 runs of 0.47 s, correlation time 0.05 s: 4 sd are 10 %
    assert np.std(z) == pytest.approx(200 / math.sqrt(10), rel=0.1, abs=0.0)
    behind = replace(machine, filters_vibration=False)
    z = np.concatenate([r.z_nm for i in range(20) for r in runs_of(behind, i).runs])
    assert np.std(z) == pytest.approx(200.0, rel=0.1, abs=0.0)


@pytest.mark.parametrize(("p", "rms"), [(2.0, 150.0), (3.0, 90.0)])
def test_a_rough_truth_falls_as_stated(p, rms):
    """Slope of log power density between waves of 12 and 1 mm, 16 truths, Hann window."""
    machine = replace(SILENT, waves=(), slope_of_psd=p, rough_rms_nm=rms)
    x = np.arange(0.0, 56.0, 0.05)
    total = 0.0
    for seed in range(16):
        g = runs_of(machine, seed).truths[1](x)
        line = g - np.polynomial.Polynomial.fit(x, g, 1)(x)
        assert np.std(line) == pytest.approx(rms, rel=2e-3, abs=0.0)  # another grid
        f, s = welch(line, 20.0, nperseg=x.size)
        total = total + s
    where = (f > 1 / 12) & (f < 1.0)
    slope = np.polyfit(np.log(f[where]), np.log(total[where]), 1, w=np.sqrt(f[where]))[0]
    assert slope == pytest.approx(-p, abs=0.2)


def test_a_wave_that_slips_has_its_amplitude_and_no_common_phase():
    machine = replace(SILENT, waves=(), slip=((8.0, 120.0),), repeats=30)
    phases = []
    for run in runs_of(machine).runs:
        angle = 2 * math.pi * run.x_mm / 8.0
        design = np.column_stack([np.cos(angle), np.sin(angle)])
        a, b = np.linalg.lstsq(design, run.z_nm, rcond=None)[0]
        assert math.hypot(a, b) == pytest.approx(120.0, abs=FM)
        phases.append(math.atan2(b, a))
    assert abs(np.mean(np.exp(1j * np.array(phases)))) < 0.3  # 90 phases: 1/sqrt(90) is 0.1


@pytest.mark.parametrize(("scatter", "mean", "sd"), [(0.3, 1.0, 0.3), (math.inf, 0.886, 0.463)])
def test_a_wave_that_slips_may_have_another_size_in_each_run(scatter, mean, sd):
    """Normal numbers of cosine and sine have a size of Rayleigh: sqrt(pi)/2 and sqrt(1 - pi/4)."""
    machine = replace(
        SILENT, waves=(), slip=((8.0, 120.0),), slip_scatter=scatter, repeats=100, travel_mm=56.0
    )
    sizes = np.array([np.std(run.z_nm) * math.sqrt(2.0) for run in runs_of(machine).runs]) / 120.0
    # of 300 runs, four sd; 56 mm are seven waves
    assert sizes.mean() == pytest.approx(mean, abs=4.0 * sd / math.sqrt(300) + 0.01)
    assert sizes.std() == pytest.approx(sd, abs=4.0 * sd / math.sqrt(600) + 0.01)


def test_white_noise_offset_drift_steps_limit_gaps_and_clock_are_as_stated():
    base = replace(SILENT, waves=())
    z = np.concatenate([r.z_nm for r in runs_of(replace(base, white_nm=20.0, repeats=30)).runs])
    assert np.std(z) == pytest.approx(20.0, rel=4 / math.sqrt(2 * z.size), abs=0.0)
    offsets = [r.z_nm.mean() for r in runs_of(replace(base, offset_nm=50.0, repeats=300)).runs]
    assert np.std(offsets) == pytest.approx(50.0, rel=4 / math.sqrt(2 * 900), abs=0.0)
    rates = [
        (r.z_nm[-1] - r.z_nm[0]) / r.t_s[-1]
        for r in runs_of(replace(base, drift_nm_s=100.0, repeats=300)).runs
    ]
    assert np.std(rates) == pytest.approx(100.0, rel=4 / math.sqrt(2 * 900), abs=0.0)
    steps = runs_of(replace(SILENT, quantum_nm=40.0)).runs[0].z_nm / 40.0
    assert np.abs(steps - np.round(steps)).max() < FM
    assert np.abs(runs_of(replace(SILENT, limit_nm=70.0)).runs[0].z_nm).max() == 70.0
    gaps = [np.isnan(r.z_nm).sum() for r in runs_of(replace(SILENT, gap_samples=40)).runs]
    assert gaps == [0, 40, 0] * 3
    jittered = runs_of(replace(SILENT, clock_jitter=0.3)).runs[0]
    away = jittered.t_s - np.arange(jittered.t_s.size) * 1e-3
    assert 0.28e-3 < np.abs(away).max() < 0.3e-3
    assert np.abs(jittered.z_nm - runs_of(SILENT).runs[0].z_nm).max() < FM


def test_displaced_runs_read_the_same_at_other_places():
    still, moved = (
        runs_of(replace(SILENT, repeats=300, displaced_mm=mm)).runs for mm in (0.0, 0.1)
    )
    off = [b.x_mm - a.x_mm for a, b in zip(still, moved, strict=True)]
    assert max(np.ptp(d) for d in off) < 1e-9
    assert np.std([d[0] for d in off]) == pytest.approx(0.1, rel=4 / math.sqrt(2 * 900), abs=0.0)
    assert all((a.z_nm == b.z_nm).all() for a, b in zip(still, moved, strict=True))


def test_places_times_and_travels():
    for name, row in ROWS.items():
        machine = row.machine
        if machine.mirror and not corpus_folder().is_dir():
            continue
        made = runs_of(machine)
        assert len(made.runs) == machine.runs_per_direction() * (2 if machine.both_ways else 1)
        for run in made.runs:
            v = run.direction * run.feed_mm_s
            ideal = np.arange(run.x_mm.size) / machine.rate_hz
            assert np.abs(run.x_mm - run.x_mm[0] - v * ideal).max() < 1e-9, name
            over = 0.0 if run.direction > 0 else run.feed_mm_s / machine.rate_hz
            off = 6.0 * machine.displaced_mm
            assert run.x_mm.min() > -1e-9 - over - off
            assert run.x_mm.max() < machine.travel_mm + 1e-9 + off
            if not machine.unequal_mm:
                assert np.ptp(run.x_mm) > machine.travel_mm - run.feed_mm_s / machine.rate_hz


def test_one_integer_makes_a_set():
    for name in ("base", "1/f2", "LP 50 Hz", "unequal 12 mm"):
        first, again = (simulate(ROWS[name].machine, 11) for _ in range(2))
        other = simulate(ROWS[name].machine, 12)
        for a, b, c in zip(first.runs, again.runs, other.runs, strict=True):
            assert (a.z_nm == b.z_nm).all()
            assert a.z_nm.shape != c.z_nm.shape or (a.z_nm != c.z_nm).all()


@pytest.mark.parametrize(
    ("name", "length", "points"), [("071", 968.4, 9230), ("010", 88.7, 435), ("001", 150, 1201)]
)
def test_the_mirrors_are_those_of_the_corpus(corpus, name, length, points):
    """Lengths and point counts as MANIFEST.tsv has them, times the factor on the places."""
    x, z = mirror_profile(name)
    assert x[-1] == pytest.approx(length, abs=0.2)
    assert x.size == points
    assert np.isfinite(z).all()
    assert (np.diff(x) > 0).all()
