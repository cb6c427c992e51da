"""Vibrations in repeated runs: a process in time, whose wavelength slides with the feedrate.

Geometry keeps its wavelength when the feedrate v changes; a vibration of frequency f keeps f, and
lies at the wavelength v/f. A vibration is one that shows at the same frequency at every feedrate.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from metrosep.core._arrays import FloatArray
from metrosep.core.errors import MetrosepError, TooFewSamplesError
from metrosep.core.runset import RunSet
from metrosep.separation.base import ErrorEstimate
from metrosep.separation.design import PreparedRun, prepare_runs
from metrosep.separation.explain import noise_peaks
from metrosep.spectral.autoregressive import fit_autoregressive

__all__ = ["Vibration", "find_vibrations"]


_ABOVE = 8.0
"""At every feedrate the density at a vibration stands this much above the median around it."""

_BROAD = 4.0
"""At every feedrate the mean density about a broad resonance stands this much above the median."""

_APART = 6.0
"""Resolution cells above which a broad resonance is not mistaken for a long wave of the geometry."""

_ORDERS = (4, 8, 16, 24, 32, 48)
"""Candidate orders of the noise model of the residuals, judged by AICc."""

_AROUND = 10.0
"""Resolution cells on either side from which that median is taken."""

_CELLS = 0.75
"""Resolution cells within which a peak of another feedrate is the same vibration."""

_LEAST_CYCLES = 2.0
"""Fewer cycles in the longest run are a bow, not a vibration."""

_PADDED = 8
"""Points of the spectra for each resolution cell."""

_LEAST_SAMPLES = 32
"""Unbroken samples of a run that are worth a spectrum."""

_MOST = 6
"""Vibrations that are shown, the clearest first."""

_SAME = 0.02
"""Frequencies within this share of each other, or one resolution cell, are one vibration."""

_WAYS = {"forward": 1, "reverse": -1}


@dataclass(frozen=True, slots=True)
class Vibration:
    """A vibration, and where it lies at each feedrate."""

    frequency: float  # the same at all feedrates
    feeds: tuple[float, ...]  # m/s: feedrates, slowest first
    # {"line", "residual"}: A line that the separation removed, or a resonance of what was left
    source: str

    @property
    def wavelengths(self) -> tuple[float, ...]:
        """Where it lies at each feedrate: v/f, m.

        Examples
        --------
        >>> Vibration(10.0, (0.08, 0.12), "line").wavelengths
        (0.008, 0.012)
        """
        return tuple(v / self.frequency for v in self.feeds)


def find_vibrations(
    runs: RunSet, estimate: ErrorEstimate, *, direction: int
) -> tuple[tuple[Vibration, ...], str]:
    """Return the vibrations that the runs of a direction show at every feedrate.

    Notes
    -----
    A resonance is a peak in time of what the separation leaves of the slowest runs that stands 8
    times above the median around it at *each* feedrate, and is a peak within 0.75 of a resolution
    cell at two of them at least; or, at high frequencies, a resonance of an autoregressive model
    (`noise_peaks`) about which the density is 4 times its median at each feedrate. Geometry that the method left does not: its frequency changes
    with the feedrate. With one feedrate the two cannot be told apart, and no resonance is named.
    The periodograms have Hann windows; gaps are not bridged, the longest part is taken.
    """
    some = runs.select(direction=direction)
    lines = tuple(Vibration(f, some.feeds, "line") for f in _lines(estimate, direction))
    if len(some.feeds) < 2:
        why = "one feedrate only: a vibration cannot be told from geometry"
        return (
            lines,
            why if some.feeds else "the runs have no feedrate: no vibration can be placed",
        )
    try:
        prepared = prepare_runs(some)
    except MetrosepError as exc:
        return lines, f"no vibration was looked for: {exc}"
    groups: dict[float, list[PreparedRun]] = {}
    for run in prepared:
        step = next((s for s in groups if abs(run.time_step / s - 1.0) < 1e-3), run.time_step)
        groups.setdefault(step, []).append(run)
    found: list[float] = []
    for step, members in groups.items():
        found += _common_peaks(_residuals(members, estimate, direction), step)
    cell = max(some.feeds) / (some.full_travel[1] - some.full_travel[0])
    known = [v.frequency for v in lines]
    kept: list[float] = []
    for f in found:
        if all(abs(f - g) > max(_SAME * f, cell) for g in (*known, *kept)):
            kept.append(f)
    return (*lines, *(Vibration(f, some.feeds, "residual") for f in sorted(kept))), ""


def _lines(estimate: ErrorEstimate, direction: int) -> list[float]:
    """Return the frequencies of the lines that the separation removed."""
    terms: Mapping[str, Any] = estimate.terms
    name = next(n for n, d in _WAYS.items() if d == direction)
    if name in terms:
        terms = terms[name]
    columns = (terms.get("lines") or {}).get("lines") or {}
    return sorted(float(f) for f in columns.get("frequency_hz") or ())


def _residuals(
    members: Sequence[PreparedRun], estimate: ErrorEstimate, direction: int
) -> list[tuple[float, FloatArray]]:
    """Return speed and longest unbroken residual of each run within the evaluation range."""
    found = []
    for run in members:
        inner = (run.x >= estimate.start) & (run.x <= estimate.stop)  # Kono's ends are no model
        x = run.x[inner]
        rest = run.z[inner] - estimate.evaluate(x, direction=direction)
        edges = np.flatnonzero(np.isnan(np.concatenate([[np.nan], rest, [np.nan]])))
        longest = int(np.argmax(np.diff(edges))) if edges.size > 1 else 0
        part = slice(edges[longest], edges[longest + 1] - 1)
        if part.stop - part.start >= _LEAST_SAMPLES:
            x, rest = x[part], rest[part]
            line = np.polyfit(x - x[0], rest, 1)
            found.append((abs(run.velocity), np.asarray(rest - np.polyval(line, x - x[0]))))
    return found


@dataclass(frozen=True, slots=True, eq=False)
class _FeedSpectrum:
    """Density over time of the residuals at one feedrate, over the density around it and over all."""

    frequency: FloatArray
    ratio: FloatArray
    level: FloatArray
    cell: float

    def peak_near(self, f: float) -> float | None:
        """Return the frequency of the peak within one resolution cell, if there is one."""
        near = np.flatnonzero(np.abs(self.frequency - f) <= _CELLS * self.cell)
        if near.size == 0 or near[0] == 0 or near[-1] == self.frequency.size - 1:
            return None
        k = int(near[np.argmax(self.ratio[near])])
        if self.ratio[k] < max(self.ratio[k - 1], self.ratio[k + 1]):
            return None  # the flank of a peak that lies elsewhere
        return float(self.frequency[k])

    def mean_level(self, f: float) -> float:
        """Return the mean density around a frequency over the median of all; 0 where there is none."""
        near = np.abs(self.frequency - f) <= 2.0 * _CELLS * self.cell
        return float(self.level[near].mean()) if near.any() else 0.0

    def at(self, f: float) -> float:
        """Return how much the density stands above what is around it."""
        return float(np.interp(f, self.frequency, self.ratio))


def _spectrum_of(records: Sequence[FloatArray], step: float) -> _FeedSpectrum:
    """Return the mean Hann periodogram of records on a common, fine grid."""
    longest = max(r.size for r in records)
    size = _PADDED * longest
    density = np.zeros(size // 2 + 1)
    for record in records:
        weight = np.hanning(record.size + 2)[1:-1]
        scaled = weight * record / np.sqrt((weight**2).sum())
        density += np.abs(np.fft.rfft(scaled, size)) ** 2 / len(records)
    cell = 1.0 / (min(r.size for r in records) * step)
    frequency = np.arange(density.size) / (size * step)
    around = max(1, round(_AROUND * cell * size * step))
    padded = np.pad(density, around, mode="reflect")[:: _PADDED // 2]
    width = 2 * (around // (_PADDED // 2)) + 1
    windows = np.lib.stride_tricks.sliding_window_view(padded, width)
    background = np.median(windows, axis=1)
    at = np.arange(background.size) * (_PADDED // 2)
    floor = np.interp(np.arange(density.size), at, background)
    least = max(float(density.max()) * 1e-12, 1e-300)
    level = density / max(float(np.median(density)), least)
    return _FeedSpectrum(frequency, density / np.maximum(floor, least), level, cell)


def _common_peaks(found: Sequence[tuple[float, FloatArray]], step: float) -> list[float]:
    """Return the frequencies at which the residuals of every feedrate stand out."""
    by_feed: list[tuple[float, list[FloatArray]]] = []
    for speed, record in sorted(found, key=lambda item: item[0]):
        if by_feed and speed <= by_feed[-1][0] * (1.0 + _SAME):
            by_feed[-1][1].append(record)
        else:
            by_feed.append((speed, [record]))
    if len(by_feed) < 2:
        return []
    spectra = [_spectrum_of(records, step) for _, records in by_feed]
    finest = spectra[0]  # the slowest runs last longest
    inner = np.flatnonzero(
        (finest.ratio[1:-1] >= finest.ratio[:-2]) & (finest.ratio[1:-1] > finest.ratio[2:])
    )
    kept: list[tuple[float, float]] = []
    for f in finest.frequency[inner + 1]:
        weakest = min(s.at(float(f)) for s in spectra)
        peaks = [p for s in spectra if (p := s.peak_near(float(f))) is not None]
        if f > _LEAST_CYCLES * finest.cell and weakest >= _ABOVE and len(peaks) >= 2:
            kept.append((weakest, float(f)))
    broad = _broad_peaks([record for _, record in found], spectra, step)
    return broad + [f for _, f in sorted(kept, reverse=True)[:_MOST]]


def _broad_peaks(
    records: Sequence[FloatArray], spectra: Sequence[_FeedSpectrum], step: float
) -> list[float]:
    """Return the resonances of a noise model that are well apart from the longest waves."""
    scale = max(float(np.abs(r).max()) for r in records)
    if not scale > 0.0:
        return []
    try:
        model, _, _ = fit_autoregressive(
            [r / scale for r in records], orders=_ORDERS, time_step=step
        )
    except TooFewSamplesError:
        return []  # too short for a model: the clear peaks remain
    coarsest = max(s.cell for s in spectra)
    return [
        f
        for f in noise_peaks(model)
        if f > _APART * coarsest and min(s.mean_level(f) for s in spectra) >= _BROAD
    ]
