"""Private to plot: amplitudes in proportional bands, and the vibrations that slide through them."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from metrosep.core._arrays import FloatArray
from metrosep.plot.style import values

__all__ = ["BANDS_PER_OCTAVE", "cell_edges", "in_bands", "lines_of_residual", "shared_lines"]


BANDS_PER_OCTAVE = 12
_MAX_LINES = 3

_PROMINENCE = 0.35
"""Decades of amplitude by which a vibration stands above the valleys beside it."""

_STANDS_OUT = 3.0
"""A vibration found from runs alone is this much above the median of two octaves about it."""

_APART = 0.3
"""Vibrations closer than this, relative, are one."""


def cell_edges(centres: FloatArray) -> FloatArray:
    """Edges half the way between logarithms of rising centres."""
    log = np.log(centres)
    if log.size == 1:
        return np.asarray(np.exp(log[0] + np.array([-0.1, 0.1])))
    inner = (log[1:] + log[:-1]) / 2.0
    first, last = [2.0 * log[0] - inner[0]], [2.0 * log[-1] - inner[-1]]
    return np.asarray(np.exp(np.concatenate([first, inner, last])))


def in_bands(wavelength: FloatArray, amplitude: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Edges of bands of 1/12 octave, and the amplitude in each."""
    edges = cell_edges(wavelength)
    n = max(int(np.ceil(np.log2(edges[-1] / edges[0]) * BANDS_PER_OCTAVE)), 1)
    bands = np.geomspace(edges[0], edges[-1], n + 1)
    owner = np.clip(np.searchsorted(bands, wavelength) - 1, 0, n - 1)
    nearest = np.searchsorted(edges, np.sqrt(bands[1:] * bands[:-1])) - 1
    held = np.bincount(owner, minlength=n) > 0
    rows = [
        np.where(held, np.sqrt(np.bincount(owner, row**2, minlength=n)), row[nearest])
        for row in amplitude
    ]
    return bands, np.array(rows)


def lines_of_residual(psd: Mapping[str, Any]) -> list[float]:
    """Strongest peaks of the noise model, or of the PSD where there is no model."""
    frequency = values(psd["frequency_hz"])
    model = values(psd.get("model_nm2_per_hz"))
    density = model if np.isfinite(model).any() else values(psd["psd_nm2_per_hz"])
    keep = (frequency > 0.0) & np.isfinite(density) & (density > 0.0)
    # in proportional bands a peak holds its density times its frequency
    return _peaks(frequency[keep], np.sqrt(density[keep] * frequency[keep]))


def shared_lines(feeds: FloatArray, bands: FloatArray, power: FloatArray) -> list[float]:
    """Frequencies at which every feedrate has more than the others have at that wavelength."""
    from scipy.ndimage import median_filter

    centre = np.sqrt(bands[1:] * bands[:-1])
    speed = feeds / 60.0  # mm/s
    low, high = 4.0 * speed[-1] / bands[-1], speed[0] / bands[0]
    if high <= 2.0 * low:
        return []
    frequency = np.geomspace(low, high, int(np.log2(high / low) * 2 * BANDS_PER_OCTAVE))
    excess = power - power.min(axis=0)  # what is the same at every feedrate is geometry
    excess = np.where(excess > 0.5 * power, excess, 0.0)
    padded = np.pad(excess, ((0, 0), (1, 1)), mode="edge")
    wide = np.maximum(np.maximum(padded[:, :-2], padded[:, 1:-1]), padded[:, 2:])
    rows = [np.interp(v / frequency, centre, row) for v, row in zip(speed, wide, strict=True)]
    common = np.min(rows, axis=0)
    level = np.min(
        [np.interp(v / frequency, centre, row) for v, row in zip(speed, power, strict=True)],
        axis=0,
    )
    around = median_filter(level, size=4 * BANDS_PER_OCTAVE + 1, mode="nearest")
    found = []
    for f in _peaks(frequency, np.where(common > _STANDS_OUT * around, common, 0.0)):
        fine = f * np.linspace(0.9, 1.1, 81)
        sums = [np.interp(v / fine, centre, row) for v, row in zip(speed, excess, strict=True)]
        found.append(float(fine[np.sum(sums, axis=0).argmax()]))
    return found


def _peaks(frequency: FloatArray, amplitude: FloatArray) -> list[float]:
    from scipy.signal import find_peaks

    if frequency.size < 3 or not amplitude.max() > 0.0:
        return []
    at, _ = find_peaks(
        np.log10(np.maximum(amplitude, 1e-6 * amplitude.max())),
        prominence=_PROMINENCE,
        plateau_size=1,
    )
    found: list[float] = []
    for i in sorted(at, key=lambda i: -amplitude[i]):
        if len(found) < _MAX_LINES and all(abs(np.log(frequency[i] / f)) > _APART for f in found):
            found.append(float(frequency[i]))
    return sorted(found)
