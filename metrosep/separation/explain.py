"""What a separation wants the user to know, in plain words.

Each function returns sentences with a number, a unit and, where something can be done, what to
do. Nothing here changes a result.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any, Literal

import numpy as np

from metrosep.core._arrays import FloatArray
from metrosep.core.runset import RunSet
from metrosep.separation.solver import LAG_CHI2, Solution
from metrosep.spectral.autoregressive import AutoregressiveModel

__all__ = [
    "explain_band",
    "explain_disturbances",
    "explain_lag",
    "explain_resolution",
    "noise_peaks",
]


_PEAK_RATIO = 6.0
"""A resonance stands this much above the median of the noise model's spectrum around it."""

_PEAK_SHARE = 0.02
"""Least share of the noise variance in a resonance that is worth a sentence."""

_MM_PER_MIN = 6e4
"""mm/min in one m/s."""


_CLOSE_FEEDS = 0.2
"""Feeds that spread less than this, relative, are worth a sentence."""


def _close_feeds(feeds: tuple[float, ...], travel: float) -> list[str]:
    """Say which wavelengths feeds that hardly differ cannot tell from a vibration."""
    if len(feeds) < 2 or feeds[0] <= (1.0 - _CLOSE_FEEDS) * feeds[-1]:
        return []
    spread = 1.0 - feeds[0] / feeds[-1]
    slower, faster = 0.5 * feeds[0] * _MM_PER_MIN, 2.0 * feeds[-1] * _MM_PER_MIN
    sentence = (
        f"the feedrates differ by {spread * 100:.2g} % only: at wavelengths above "
        f"{spread * travel * 1e3:.2g} mm a vibration cannot be told from geometry; add runs at "
        f"{slower:.0f} or {faster:.0f} mm/min"
    )
    return [sentence]


def noise_peaks(model: AutoregressiveModel, *, n_max: int = 4) -> list[float]:
    """Return the frequencies of the strongest resonances of a noise model."""
    if model.order < 2:
        return []
    nyquist = 0.5 / model.time_step
    frequency = np.linspace(0.0, nyquist, 4097)[1:-1]
    density = model.psd(frequency)
    step = frequency[1] - frequency[0]
    inner = np.flatnonzero((density[1:-1] > density[:-2]) & (density[1:-1] >= density[2:])) + 1
    background = float(np.median(density))
    found: list[tuple[float, float]] = []
    for i in inner:
        if density[i] < _PEAK_RATIO * background:
            continue
        above = density > density[i] / 10.0
        left = i - int(np.argmin(above[i::-1])) if not above[: i + 1].all() else 0
        right = i + int(np.argmin(above[i:])) if not above[i:].all() else density.size
        share = float(density[left:right].sum() * step)
        if share > _PEAK_SHARE * float(density.sum() * step):
            found.append((share, float(frequency[i])))
    return [f for _, f in sorted(found, reverse=True)[:n_max]]


def explain_disturbances(
    solution: Solution, runs: RunSet, spectrum: Mapping[str, list[Any]]
) -> tuple[str, ...]:
    """Name vibrations that fall onto a wavelength of the geometry at some feedrate."""
    low, high = runs.full_travel
    travel = high - low
    waves = [
        w * 1e-3 for w, s in zip(spectrum["wavelength_mm"], spectrum["selected"], strict=True) if s
    ]
    sentences = []
    found = sorted({round(f, 1) for m in solution.noise for f in noise_peaks(m)})
    cell = max(runs.feeds) / travel  # noise models of two sampling rates see the same vibration
    for i, frequency in enumerate(found):
        if i and frequency - found[i - 1] < 0.25 * cell:
            continue
        hit = _collisions(frequency, runs.feeds, waves, travel)
        if hit:
            sentences.append(_collision_sentence(frequency, hit, runs.feeds, waves, travel))
    return tuple(sentences)


def _collisions(
    frequency: float, feeds: tuple[float, ...], waves: list[float], travel: float
) -> list[float]:
    """Return the feeds at which the vibration lies within one resolution cell of a wavelength."""
    return [
        v
        for v in feeds
        if any(abs(frequency / v - 1.0 / w) * travel < 1.0 for w in waves if w < travel)
    ]


def _collision_sentence(
    frequency: float,
    hit: list[float],
    feeds: tuple[float, ...],
    waves: list[float],
    travel: float,
) -> str:
    maps = ", ".join(f"{v / frequency * 1e3:.1f} mm at {v * _MM_PER_MIN:.0f} mm/min" for v in hit)
    clean = [v for v in feeds if v not in hit]
    sentence = f"{frequency:.1f} Hz disturbance maps onto {maps}"
    if len(clean) >= 2:
        others = " and ".join(f"{v * _MM_PER_MIN:.0f}" for v in clean)
        return f"{sentence}; the runs at {others} mm/min tell it from the geometry"
    better = _better_feed(frequency, feeds, waves, travel)
    if better is None:
        return f"{sentence}; no other feedrate in this range avoids it: remove the disturbance"
    return f"{sentence}; add a run at {better * _MM_PER_MIN:.0f}"


def _better_feed(
    frequency: float, feeds: tuple[float, ...], waves: list[float], travel: float
) -> float | None:
    """Return the round feed, in and a little around the range, farthest from any collision."""
    near, far = 0.6 * min(feeds) * _MM_PER_MIN, 1.4 * max(feeds) * _MM_PER_MIN
    step = 10.0 ** math.floor(math.log10(max(near, 1e-6)))
    best: tuple[float, float] | None = None
    for value in np.arange(math.ceil(near / step) * step, far, step):
        feed = float(value) / _MM_PER_MIN
        if any(abs(feed / v - 1.0) < 0.1 for v in feeds):
            continue
        distance = min(abs(frequency / feed - 1.0 / w) * travel for w in waves)
        if distance > 2.0 and (best is None or distance > best[0]):
            best = (distance, feed)
    return None if best is None else best[1]


def explain_lag(
    solution: Solution, *, mode: Literal["stated", "auto", "fit"], n_selected: int = 1
) -> tuple[str, ...]:
    """Say what the fitted lag is and whether the data determine it."""
    value, sd = solution.lag * 1e3, solution.lag_sd * 1e3
    test = solution.lag_test
    if mode == "auto":
        if test is None or not test.fitted:
            return ()
        return (
            (
                f"readings lag the position by {value:.3g} ms (u {sd:.2g} ms): found by lag='auto' and "
                'corrected; lag=0.0 (command line: --lag "0 ms") leaves it in'
            ),
        )
    if mode == "stated":
        if test is None or test.lag**2 <= LAG_CHI2 * test.u**2:
            return ()
        return (
            (
                f"readings lag the position by {value + test.lag * 1e3:.3g} ms (u {test.u * 1e3:.2g} ms), "
                f"{value:.3g} ms was stated: not corrected, and the uncertainty does not hold it; "
                "lag='auto' (command line: --lag auto) corrects it"
            ),
        )
    if sd > 2.0 or n_selected == 0:
        return (
            (
                f"the lag is not determined by these runs ({value:.2f} ms, sd {sd:.2f} ms): the error has "
                "too little short-wave content; state the lag instead"
            ),
        )
    return (f"readings lag the position by {value:.3f} ms (sd {sd:.3f} ms)",)


_PRIOR_RATIO = 3.0
"""The band is mostly that of the prior where it is so many times what the noise leaves."""

_SLOW_SHARE = 0.15
"""Share of the noise below the lowest frequency that a run can show, from which it is named."""


def explain_band(solution: Solution, *, band: float, plain: float) -> tuple[str, ...]:
    """Say where the uncertainty is known not to be that of 95 %: prior, or noise slower than runs."""
    sentences = []
    if band > _PRIOR_RATIO * plain:
        sentences.append(
            f"the uncertainty, {band * 1e9:.2g} nm, is {band / plain:.2g} times what the noise of these "
            f"readings leaves ({plain * 1e9:.2g} nm): it comes from the prior, and is an upper bound"
        )
    longest = max(r.size * m.time_step for r, m in _with_models(solution))
    lowest = 2.0 / longest
    shares = []
    for model in solution.noise:
        frequency = np.linspace(0.0, 0.5 / model.time_step, 8193)[1:]
        density = model.psd(frequency)
        shares.append(float(density[frequency < lowest].sum() / density.sum()))
    if max(shares) > _SLOW_SHARE:
        sentences.append(
            f"{100 * max(shares):.0f} % of the noise lies below {lowest:.2g} Hz, too slow for a run to show: "
            "the uncertainty rests on an extrapolation and may be too small by half; take longer or "
            "slower runs"
        )
    return tuple(sentences)


def _with_models(solution: Solution) -> list[tuple[FloatArray, AutoregressiveModel]]:
    """Pair each residual with the noise model of the slowest sampling, enough for its duration."""
    slowest = max(solution.noise, key=lambda m: m.time_step)
    return [(r, slowest) for r in solution.residuals]


def explain_resolution(
    solution: Solution, *, limit: str, travel: float, runs: RunSet, n_selected: int
) -> tuple[str, ...]:
    """Say when the shortest wavelength was bounded by something other than evidence."""
    sentences = []
    considered = solution.amplitude.size
    below = f"wavelengths below {solution.period / considered * 1e3:.3g} mm were not considered"
    if limit == "cost":
        evidence = solution.n_harmonics > 0.9 * considered
        although = " although there is evidence down to this limit" if evidence else ""
        sentences.append(f"{below}{although}; state shortest= to go further")
    if limit == "data":
        sentences.append(
            f"{below}, although shortest= asks for them: the runs have too few samples for so many "
            "wavelengths; add runs or sample faster"
        )
    sentences += _close_feeds(runs.feeds, travel)
    if len(runs.feeds) == 1:
        sentences.append(
            f"one feedrate only ({runs.feeds[0] * _MM_PER_MIN:.0f} mm/min): a vibration that starts "
            "in phase with the run cannot be told from geometry; add runs at another feedrate"
        )
    if n_selected == 0:
        sentences.append(
            f"no wavelength up to the travel of {travel * 1e3:.4g} mm repeats beyond chance: there is "
            "nothing to compensate that these runs could show"
        )
    return tuple(sentences)
