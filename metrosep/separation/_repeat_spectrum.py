"""Which wavelengths repeat: an F test of the complex amplitudes of all repeats."""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from metrosep.core._arrays import FloatArray

FALSE_DISCOVERIES = 0.05
_MOST_LINES = 60


def repeating_lines(
    stack: FloatArray, x: FloatArray, *, closed: bool, calibrated: bool = True
) -> tuple[list[dict[str, Any]], list[str]]:
    """Return the wavelengths that repeat, strongest first."""
    from scipy.stats import f as f_distribution

    steps = np.diff(x)
    if np.isnan(stack).any():
        return [], ["no wavelengths were tested: there are gaps"]
    if np.abs(steps - steps.mean()).max() > 1e-3 * abs(float(steps.mean())):
        return [], ["no wavelengths were tested: the steps are not uniform"]
    m, n = stack.shape
    window = np.ones(n) if closed else np.hanning(n + 2)[1:-1]
    z = 2.0 / window.sum() * np.fft.rfft(stack * window, axis=1)
    first = 2  # 0 and 1 are the alignment, or leak from it
    orders = np.arange(first, (n - 1) // 2)
    z = z[:, first : (n - 1) // 2]
    mean = z.mean(axis=0)
    scatter = (np.abs(z - mean) ** 2).sum(axis=0) / (m - 1)
    floor = 1e-24 * float(np.max(np.abs(mean) ** 2, initial=0.0)) + np.finfo(float).tiny
    ratio = m * np.abs(mean) ** 2 / np.maximum(scatter, floor)
    p = f_distribution.sf(ratio, 2, 2 * (m - 1))
    order = np.argsort(p)
    passed = np.flatnonzero(p[order] <= FALSE_DISCOVERIES * (1 + np.arange(p.size)) / p.size)
    chosen = order[: passed[-1] + 1] if passed.size else order[:0]
    chosen = chosen[np.argsort(-np.abs(mean[chosen]))]
    length = abs(float(n * steps.mean()))
    lines = []
    for k in chosen[:_MOST_LINES]:
        name: dict[str, Any] = {"wavelength_um": 1e6 * length / int(orders[k])}
        if closed:
            name = {"upr": int(orders[k])}
        elif not calibrated:
            name = {"wavelength_samples": length / int(orders[k])}
        u = math.sqrt(float(scatter[k]) / (2.0 * m))
        lines.append(
            {**name, "amplitude_nm": 1e9 * float(abs(mean[k])), "u_nm": 1e9 * u, "p": float(p[k])}
        )
    more = chosen.size - len(lines)
    return lines, [f"{more} further wavelengths repeat"] if more else []
