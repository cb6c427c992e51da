"""Private to separation: waves of any wavelength that repeat, and waves that differ from run to run.

A wave whose length does not divide the travel is smeared over many harmonics; as one wave it costs
two numbers. It is taken where the score exceeds chance over all wavelengths that were looked at,
where the evidence pays for it, and where the runs agree on it.

Balls that slip in a nut shake the table at fixed wavelengths, but with another phase in each run:
that is neither geometry nor noise in time. Where the runs differ on a harmonic at every feedrate such
a wave, of any wavelength, is taken; its variance Lambda is learnt. Equation numbers: separation-2.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from metrosep.core._arrays import FloatArray, IntArray, benjamini_hochberg
from metrosep.separation.runs.geometry import HELD_SHARE, filtered
from metrosep.separation.runs.posterior import DONE, Answer, Model, Slip, Wave
from metrosep.separation.runs.system import System

FALSE_ALARM = 0.01
"""Chance that one search finds a wave where there is none."""

FALSE_DISCOVERY = 0.01
"""Accepted share of harmonics called slipping that are not."""

_REPEATS = 1e-3
"""A wave of which the runs agree by chance with more than this probability is not taken."""

_MOST = 12
"""Most waves: more lines than this are a broad part."""


@dataclass(frozen=True, slots=True)
class FoundWave:
    """A wave of the geometry: wavelength and amplitude with their standard uncertainties."""

    wavelength: float  # m
    u_wavelength: float
    cosine: float  # dimensionless, from the start of the travel
    sine: float
    u_amplitude: float
    p_repeats: float  # chance of such agreement of the runs without a wave; NaN below 3 runs

    def in_units(self, scale: float) -> FoundWave:
        """Return the wave with its amplitude in m."""
        return replace(
            self,
            cosine=self.cosine * scale,
            sine=self.sine * scale,
            u_amplitude=self.u_amplitude * scale,
        )


@dataclass(frozen=True, slots=True)
class SlippingWave:
    """A wave with another phase in each run, and what the estimate holds of that wavelength."""

    wavelength: float  # m
    sd: float  # m: of the cosine of one run
    amplitude: float  # m: of the estimate, and the standard uncertainty of its cosine
    u_amplitude: float


def search(model: Model, given: Sequence[float] = ()) -> None:
    """Add waves while one passes the score test (eq. 12); the spectrum is learnt with a cap."""
    ext = model.extension
    least, most = 1.0 / ext.travel, HELD_SHARE * ext.n / ext.period
    if most <= least:
        return
    grid, columns = ext.scan()
    n_looked = 1.25 * ext.travel * most
    limit = 2.0 * math.log(max(n_looked, 2.0) / FALSE_ALARM)
    model.learn(6, above=1.0, cap=True)
    for length in given:
        near = [w for w in model.waves if abs(w.wavenumber - 1.0 / length) * ext.travel < 0.5]
        if least <= 1.0 / length <= most and not near:
            _add(model, 1.0 / length)
    held = model.total[0][:, : len(columns)] @ columns
    while len(model.waves) < _MOST:
        scores = _scores(model, columns, held)
        for wave in model.waves:  # a wave beside one that is there is the same wave
            scores[np.abs(grid - wave.wavenumber) * ext.travel < 0.5] = 0.0
        best = int(np.argmax(scores))
        if scores[best] <= limit:
            break
        _add(model, float(grid[best]))


def _scores(model: Model, columns: FloatArray, held: FloatArray) -> FloatArray:
    """Return T of every pair of columns W (eq. 12); `held` is G W."""
    post = model.solve()
    n = len(columns)
    gram, right = model.total
    q = (columns.T @ (right - gram @ post.theta)[:n]).reshape(-1, 2)
    seen = post.seen_by(held)
    aa, bb, ab = (
        np.einsum("ij,ij->j", columns[:, i::2], held[:n, j::2])
        - np.einsum("ij,ij->j", seen[:, i::2], seen[:, j::2])
        for i, j in ((0, 0), (1, 1), (0, 1))
    )
    det = aa * bb - ab**2
    safe = det > 1e-9 * aa * bb
    top = bb * q[:, 0] ** 2 - 2.0 * ab * q[:, 0] * q[:, 1] + aa * q[:, 1] ** 2
    return np.where(safe, top / np.where(safe, det, 1.0), 0.0)


def _add(model: Model, wavenumber: float) -> None:
    """Add a wave and move it to its best wavelength."""
    model.waves.append(Wave(wavenumber, model.extension.wave(wavenumber), 1.0))
    model.learn(2, cap=True)
    for _ in range(4):
        if refine(model, model.waves[-1]) < 0.02 / model.extension.travel:
            break
    model.learn(3, cap=True)


def refine(model: Model, wave: Wave) -> float:
    """Give a wave the derivative with its wavenumber, and take the step; return the step."""
    ext = model.extension
    at = model.waves.index(wave)
    if model.post is None or wave.columns.shape[1] == 2:
        post = model.solve()
        pair = post.mean[model.wave_parts()[at]][:2]
        own = ext.wave(wave.wavenumber)
        wave.columns = np.column_stack([own, ext.wave_change(wave.wavenumber, pair)])
    post = model.solve()
    part = model.wave_parts()[at]
    limit = 0.25 / ext.travel
    step = float(np.clip(post.mean[part][2], -limit, limit))
    low, high = 0.8 / ext.travel, 0.95 * ext.n / ext.period
    wave.wavenumber = float(np.clip(wave.wavenumber + step, low, high))
    own = ext.wave(wave.wavenumber)
    wave.columns = own
    pair = model.solve().mean[model.wave_parts()[at]][:2]
    wave.columns = np.column_stack([own, ext.wave_change(wave.wavenumber, pair)])
    model.solve()
    return abs(step)


def remove_weak(model: Model) -> None:
    """Take waves out that the evidence does not pay for, or on which the runs do not agree."""
    ext = model.extension
    price = math.log(max(1.25 * ext.travel * HELD_SHARE * ext.n / ext.period, 2.0))
    model.learn(8, above=2.0)
    while model.waves:
        full = (model.spectrum.phi.copy(), list(model.waves))
        evidence = _evidence(model)
        falls = []
        for i in range(len(full[1])):
            model.waves = full[1][:i] + full[1][i + 1 :]
            model.spectrum.phi = full[0].copy()
            model.learn(4, above=0.5)
            falls.append((evidence - _evidence(model), i, model.spectrum.phi.copy()))
        model.spectrum.phi, model.waves = full
        model.solve()
        least, i, phi = min(falls, key=lambda f: f[0])
        unsteady = [j for j, p in enumerate(agreement(model)) if p > _REPEATS]
        if unsteady:
            i = unsteady[0]
            phi = next(f[2] for f in falls if f[1] == i)
        elif least > price:
            return
        model.waves = full[1][:i] + full[1][i + 1 :]
        model.spectrum.phi = phi
        model.solve()


def _evidence(model: Model) -> float:
    assert model.post is not None  # noqa: S101  (after a solution)
    return model.log_evidence(model.post)


def agreement(model: Model) -> list[float]:
    """Return the chance that the runs agree on each wave without one; 0 below 3 runs (eq. 13)."""
    from scipy.stats import f as f_distribution

    assert model.post is not None  # noqa: S101  (after a solution)
    runs = model.seen
    if len(runs) < 3:
        return [0.0] * len(model.waves)
    out = []
    theta = model.post.theta
    for wave, part in zip(model.waves, model.wave_parts(), strict=True):
        w = np.zeros((theta.size, 2))
        w[: wave.columns.shape[0]] = wave.columns[:, :2]
        without = theta.copy()
        without[: wave.columns.shape[0]] -= wave.columns @ model.post.mean[part]
        own = [w.T @ r.gram @ w for r in runs]
        found = [
            np.linalg.solve(
                i + 1e-12 * np.trace(i) * np.eye(2), w.T @ (r.right - r.gram @ without)
            )
            for i, r in zip(own, runs, strict=True)
        ]
        whole = sum(own)
        mean = np.linalg.solve(whole, sum(i @ z for i, z in zip(own, found, strict=True)))
        within = sum(
            float((z - mean) @ i @ (z - mean)) for i, z in zip(own, found, strict=True)
        ) / (2.0 * (len(runs) - 1))
        ratio = 0.5 * float(mean @ whole @ mean) / max(1.0, within)
        out.append(float(f_distribution.sf(ratio, 2, 2 * (len(runs) - 1))))
    return out


def found_waves(model: Model) -> list[FoundWave]:
    """Return the waves that are in the model, longest first."""
    assert model.post is not None  # noqa: S101  (after a solution)
    rows = []
    spread = model.post.spread
    chances = agreement(model)
    for wave, part, p in zip(model.waves, model.wave_parts(), chances, strict=True):
        a, b = model.post.mean[part][:2]
        shift = model.post.mean[part][2] if wave.columns.shape[1] > 2 else 0.0
        own = wave.wavenumber + float(shift)
        u = math.sqrt(float(spread[part][2])) if wave.columns.shape[1] > 2 else math.nan
        amplitude = max(math.hypot(a, b), 1e-300)
        u_amplitude = math.hypot(
            a / amplitude * math.sqrt(spread[part][0]), b / amplitude * math.sqrt(spread[part][1])
        )
        rows.append(
            FoundWave(
                1.0 / own,
                u / own**2,
                float(a),
                float(b),
                u_amplitude,
                p if len(model.runs) >= 3 else math.nan,
            )
        )
    return sorted(rows, key=lambda w: -w.wavelength)


# ---- waves tied to the position that have another phase in each run ----------------------------

_MOST_SLIP = 6
"""Most waves that slip: more than these are a run that differs."""

_NEAR = np.arange(-10, 11) / 10.0
"""Steps, in one over the period and then in a tenth of it, at which a wave that slips is placed."""


def find_slip(model: Model) -> bool:
    """Add waves while there are harmonics on which the runs differ at every feedrate; tell whether any."""
    before = len(model.slip)
    while (most := _slips_most(model)) is not None:
        _add_slip(model, *most)
    return len(model.slip) > before


def taken_for_noise(system: System, model: Model) -> float | None:
    """Return the wavenumber on which the runs differ most by what no other feedrate shows, or None.

    A noise model resolves a wave that slips as one line at each feedrate, and `find_slip`, which holds
    it against that noise, does not see it. But a vibration has its frequency at every feedrate: so
    each run is held against the noise of the runs of the other feedrates.
    """
    noise = system.noise_and_of_others()
    waves = np.arange(1, model.extension.n + 1) / model.extension.period
    louder = [
        mine.density(abs(run.velocity) * waves) / theirs.density(abs(run.velocity) * waves)
        for run, (mine, theirs) in zip(model.runs, noise, strict=True)
    ]
    most = _slips_most(model, np.array(louder), min(n.degrees for _, n in noise))
    return None if most is None else most[0]


def _slips_most(
    model: Model, louder: FloatArray | None = None, degrees: float = math.inf
) -> tuple[float, float] | None:
    """Return wavenumber and variance of the harmonic on which the runs differ most, None if on none."""
    feeds = sorted({r.feed for r in model.runs})
    if len(model.runs) < 3 or len(feeds) < 2 or len(model.slip) >= _MOST_SLIP:
        return None
    k = np.flatnonzero(model.harmonics())
    p, spread = p_values(
        model,
        k,
        feeds,
        1.0 if louder is None else louder[:, k],
        degrees,
        within=louder is not None,
    )
    found = benjamini_hochberg(p, rate=FALSE_DISCOVERY)
    if not found.any():
        return None
    best = int(np.lexsort((-spread, np.where(found, p, np.inf)))[0])
    return float(k[best] + 1.0) / model.extension.period, float(max(spread[best], 1e-8))


def seed_slip(model: Model, wavenumber: float) -> None:
    """Add a wave that slips near a wavenumber, and learn by how much."""
    _add_slip(model, wavenumber, float(model.spectrum.variance.max()))


def _add_slip(model: Model, wavenumber: float, variance: float) -> None:
    """Add a wave that slips where the runs differ most, and learn its variance."""
    period = model.extension.period
    for step in (1.0, 0.1):
        near = np.maximum(wavenumber + step * _NEAR / period, 1.0 / period)
        wavenumber = float(near[np.argmax(_differing(model, model.extension.wave(near)))])
    model.slip.append(Slip(wavenumber, model.extension.wave(wavenumber), variance))
    model.apply()
    learn_slip(model, 8)


def place_slip(model: Model) -> None:
    """Move the waves that slip, one by one, to where the runs differ most beside the others."""
    for slip in list(model.slip):
        model.slip.remove(slip)
        model.apply()
        model.solve()
        _add_slip(model, slip.wavenumber, slip.variance)


def _differing(model: Model, columns: FloatArray) -> FloatArray:
    """Return by how much less the squared innovations would be with each pair free in every run."""
    assert model.post is not None  # noqa: S101  (after a solution)
    n, out = len(columns), 0.0
    for run in model.seen:
        q = (columns.T @ (run.right - run.gram @ model.post.theta)[:n]).reshape(-1, 2)
        held = run.gram[:n, :n] @ columns
        aa, bb, ab = (
            np.einsum("ij,ij->j", columns[:, i::2], held[:, j::2])
            for i, j in ((0, 0), (1, 1), (0, 1))
        )
        det = np.maximum(aa * bb - ab**2, 1e-12 * aa * bb + 1e-300)
        out += (bb * q[:, 0] ** 2 - 2.0 * ab * q[:, 0] * q[:, 1] + aa * q[:, 1] ** 2) / det
    return np.asarray(out)


def p_values(
    model: Model,
    k: IntArray,
    feeds: list[int],
    louder: FloatArray | float = 1.0,
    degrees: float = math.inf,
    *,
    within: bool = False,
) -> tuple[FloatArray, FloatArray]:
    """Return for each harmonic the largest p value with one feedrate omitted, and the variance.

    S = sum |q_r|^2, q_r = (h_r - G_r m)_k, over its expectation E = sum tr(G_r - G_r C G_r)_kk is
    chi-square over its degrees of freedom f = 2 (R - R_f)(R - 1)/R. Against a noise that is less, each
    run by a factor `louder` on each harmonic, and known with some degrees of freedom, it is F.
    `within` takes the scatter about the mean of each feedrate: a lag, or a displaced feedrate, has no part in it.
    """
    from scipy.stats import chi2, f as f_distribution

    assert model.post is not None  # noqa: S101  (after a solution)
    i, j = 1 + k, 1 + model.extension.n + k
    theta, n = model.post.theta, len(model.runs)
    root = model.post.full_root
    squares, expected, spread = np.zeros((n, k.size)), np.zeros((n, k.size)), np.zeros(k.size)
    rests = np.zeros((n, 2, k.size))
    for row, mean, pair, run in zip(squares, expected, rests, model.seen, strict=True):
        rest = run.right - run.gram @ theta
        aa, bb, ab = run.gram[i, i], run.gram[j, j], run.gram[i, j]
        row[:] = rest[i] ** 2 + rest[j] ** 2
        pair[:] = rest[i], rest[j]
        held = run.gram[np.concatenate([i, j])] @ root
        known = np.einsum("ij,ij->i", held, held)
        mean[:] = np.maximum(aa + bb - known[: k.size] - known[k.size :], 1e-12 * (aa + bb))
        det = np.maximum(aa * bb - ab**2, 1e-12 * aa * bb + 1e-300)
        a, b = (bb * rest[i] - ab * rest[j]) / det, (aa * rest[j] - ab * rest[i]) / det
        spread += 0.5 * (a**2 + b**2 - (aa + bb) / det) / n
    of = np.array([r.feed for r in model.runs])
    if within:
        for feed in feeds:
            mine = of == feed
            away = rests[mine] - rests[mine].mean(axis=0)
            squares[mine] = away[:, 0] ** 2 + away[:, 1] ** 2
            expected[mine] *= 1.0 - 1.0 / mine.sum()
    squares *= louder
    p = []
    for feed in feeds:
        kept = of != feed
        freedom = 2.0 * kept.sum() * (n - 1.0) / n
        if within:
            freedom = 2.0 * (kept.sum() - np.unique(of[kept]).size)
            if freedom <= 0.0:
                return np.ones(k.size), spread
        ratio = squares[kept].sum(axis=0) / expected[kept].sum(axis=0)
        p.append(
            chi2.sf(freedom * ratio, freedom)
            if math.isinf(degrees)
            else f_distribution.sf(ratio, freedom, degrees)
        )
    return np.max(p, axis=0), spread


def learn_slip(model: Model, rounds: int) -> None:
    """Learn the variances among the runs and the spectrum in turn (expectation-maximisation)."""
    for _ in range(rounds if model.slip else 0):
        model.learn(2)
        assert model.post is not None  # noqa: S101  (after a solution)
        columns, own = model.slipping()
        total = np.zeros(len(own))
        for run in model.runs:
            h = model.sensor.response(model.extension.wavenumbers, run.velocity)
            held = columns.T @ run.gram
            inverse = np.linalg.inv(held @ columns + own)
            d = inverse @ (columns.T @ run.right - held @ filtered(model.post.theta, h))
            doubt = inverse @ (held @ model.post.full_root)
            total += d**2 + np.diag(inverse) + np.sum(doubt**2, axis=1)
        before = np.array([s.variance for s in model.slip])
        pairs = total.reshape(-1, 2).sum(axis=1) / (2.0 * len(model.runs))
        for slip, variance in zip(model.slip, pairs, strict=True):
            slip.variance = max(float(variance), 1e-10)
        model.apply()
        if np.abs(np.log(pairs / before)).max() < DONE:
            break
    model.solve()


def slipping_waves(model: Model, answer: Answer, scale: float) -> list[SlippingWave]:
    """Return the waves that slip, longest first; `scale` is that of the readings, m."""
    ext, out = model.extension, []
    n = 1 + 2 * ext.n
    for slip in sorted(model.slip, key=lambda s: s.wavenumber):
        phase = 2.0 * math.pi * slip.wavenumber * (ext.grid - ext.origin)
        beside = [np.cos(phase), np.sin(phase), np.ones_like(phase), ext.line(ext.grid)]
        own = np.linalg.pinv(np.column_stack(beside))[:2] @ ext.basis(ext.grid)
        amplitude = float(np.hypot(*(own @ answer.mean[:n])))
        u = math.sqrt(0.5 * float(np.trace(own @ answer.covariance[:n, :n] @ own.T)))
        sizes = (scale * v for v in (math.sqrt(slip.variance), amplitude, u))
        out.append(SlippingWave(1.0 / slip.wavenumber, *sizes))
    return out
