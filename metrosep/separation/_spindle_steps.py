"""Private helpers of `iso230_7`: sensed motion, drift, centre, harmonics."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from metrosep.core._arrays import FloatArray
from metrosep.parameters.circle import CirclePoints, best_circle
from metrosep.separation._spindle_input import Readings
from metrosep.separation._spindle_noise import Spectrum
from metrosep.separation.spindle_result import SpindleHarmonics

__all__ = [
    "Circles",
    "Trend",
    "centre_of",
    "circles_of",
    "harmonics_of",
    "kept_harmonics",
    "limited",
    "sensed_motion",
    "trend_of",
    "width_about",
]


_REFERENCES = {"MZC": "MZ", "MIC": "MI", "MCC": "MC"}


def sensed_motion(
    readings: Readings, direction: str, sensitive: str, distance: float | None
) -> FloatArray:
    """Return the motion in the sensitive direction, shape (m, n)."""
    channels = readings.table
    if direction == "tilt":
        half = channels.shape[0] // 2
        channels = (channels[:half] - channels[half:]) / (distance or math.nan)
    if sensitive == "fixed":
        return np.asarray(channels[0])
    # r = X cos t + Y sin t
    return np.asarray(channels[0] * np.cos(readings.angle) + channels[1] * np.sin(readings.angle))


@dataclass(frozen=True, slots=True, eq=False)
class Trend:
    """Straight line over the record: rise per revolution, its standard uncertainty, the line."""

    slope: float
    u: float
    line: FloatArray


def trend_of(raw: FloatArray, readings: Readings) -> Trend:
    """Return the drift, from differences between revolutions at the same angle only.

    Within a revolution a drift looks like a saw tooth of the synchronous motion, so the line is
    evaluated at the place of each sample in time.
    """
    m, n = raw.shape
    place = readings.rotation * (np.arange(n) - readings.start) % n / n
    turns = readings.revolutions.astype(np.float64)
    turns = turns - turns.mean()
    level = raw.mean(axis=1)
    spread = float(turns @ turns)
    slope = float(turns @ level) / spread
    rest = level - level.mean() - slope * turns
    u = math.sqrt(float(rest @ rest) / (m - 2) / spread) if m > 2 else math.nan
    line = slope * (turns[:, None] + place - place.mean())
    return Trend(slope, u, line)


@dataclass(frozen=True, slots=True)
class Circles:
    """Circles of X + iY = sum c_m exp(i m t): m = 0, 1, 2 and their standard uncertainties."""

    size: tuple[float, float, float]
    u: tuple[float, float, float]

    def to_audit(self) -> dict[str, Any]:
        """Return plain values."""
        names = ("sensor_offset", "forward_once", "forward_twice")
        return dict(zip(names, self.size, strict=True))


def circles_of(readings: Readings, distance: float | None) -> Circles:
    """Return the circles that vanish or become k = 1 in a rotating sensitive direction."""
    channels = readings.table
    if channels.shape[0] == 4:
        channels = (channels[:2] - channels[2:]) / (distance or math.nan)
    plane = channels[0] + 1j * channels[1]
    size, u = [], []
    for m in (0, 1, 2):
        each = (plane * np.exp(-1j * m * readings.angle)).mean(axis=1)
        mean = complex(each.mean())
        power = float((np.abs(each - mean) ** 2).sum()) / (each.size - 1)
        size.append(abs(mean))
        u.append(math.sqrt(0.5 * power / each.size))
    return Circles((size[0], size[1], size[2]), (u[0], u[1], u[2]))


def kept_harmonics(spectrum: Spectrum, kmax: int | None, *, centred: bool) -> NDArray[np.bool_]:
    """Return which harmonics are in the synchronous motion."""
    k = np.arange(spectrum.mean.size)
    kept: NDArray[np.bool_] = k >= (2 if centred else 1)
    return kept if kmax is None else kept & (k <= kmax)


def limited(curve: FloatArray, kmax: int) -> FloatArray:
    """Return a curve without harmonics above `kmax`."""
    lines = np.fft.rfft(curve)
    lines[kmax + 1 :] = 0.0
    return np.fft.irfft(lines, curve.size)


def centre_of(
    angle: FloatArray, curve: FloatArray, center: str
) -> tuple[tuple[float, float], float]:
    """Return the centre (a, b) and the mean level of a curve."""
    level = float(curve.mean())
    if center == "PC":
        return (0.0, 0.0), level
    flat = curve - level
    share = 2.0 / angle.size
    a, b = share * float(flat @ np.cos(angle)), share * float(flat @ np.sin(angle))
    if center == "LSC":
        return (a, b), level
    # the circle is sought from the least-squares centre: its size does not matter to the limacon
    flat = flat - a * np.cos(angle) - b * np.sin(angle)
    more = _circle(angle, flat, center)
    return (a + more[0], b + more[1]), level


def _circle(angle: FloatArray, flat: FloatArray, center: str) -> tuple[float, float]:
    if not np.ptp(flat) > 0.0:
        return 0.0, 0.0
    turned = angle - angle[0]
    points = CirclePoints(turned, flat, np.ones(angle.size))
    a, b = best_circle(points, _REFERENCES[center]).centre
    c, s = math.cos(float(angle[0])), math.sin(float(angle[0]))
    return a * c - b * s, a * s + b * c


def width_about(angle: FloatArray, center: str) -> Callable[[FloatArray], float]:
    """Return the function that gives the width of a curve about the centre.

    For "LSC" the curve must hold no k = 1.
    """
    if center in ("LSC", "PC"):
        return lambda curve: float(curve.max() - curve.min())

    def width(curve: FloatArray) -> float:
        a, b = _circle(angle, curve, center)
        flat = curve - a * np.cos(angle) - b * np.sin(angle)
        return float(flat.max() - flat.min())

    return width


def harmonics_of(spectrum: Spectrum, *, centred: bool) -> SpindleHarmonics:
    """Return the harmonics k = 1 .. n // 2."""
    mean, power = spectrum.mean[1:], spectrum.power[1:]
    arrays = (
        np.arange(1, mean.size + 1),
        np.abs(mean),
        -np.angle(mean),
        np.sqrt(0.5 * power / spectrum.n_revolutions),
        np.sqrt(power),
        spectrum.significant[1:],
    )
    for array in arrays:
        array.setflags(write=False)
    return SpindleHarmonics(*arrays, removed=(1,) if centred else ())
