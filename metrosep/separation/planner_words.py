"""What a plan says in plain words: which disturbance falls onto which wavelength at which feed."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from metrosep.core._arrays import FloatArray
from metrosep.separation.noise_density import TimeDensity
from metrosep.separation.planner_model import run_information
from metrosep.separation.planner_search import Limits

__all__ = ["Collision", "collisions", "peaks", "plain_messages"]


_PEAK_FACTOR = 4.0
"""A peak stands this much above the median density within an octave to each side."""

_OWN_SHARE = 0.5
"""A wave counts as covered where the other feeds give at least this share of what an average feed
would give at that wavelength."""

_MOST_PEAKS = 6
_LINES = 8001


@dataclass(frozen=True, slots=True)
class Collision:
    """A disturbance that falls onto a planned wavelength."""

    frequency: float  # of the disturbance
    wavelength: float  # m: where it falls
    feed: float  # m/s: at this speed
    remedy: float  # m/s: A feed that sees this wave best
    covered: bool  # whether runs at other feeds of the plan know this wave


def peaks(density: TimeDensity, feeds: FloatArray, waves: FloatArray) -> FloatArray:
    """Return the frequencies of the strongest disturbances that can fall onto a wave."""
    low = float(feeds.min() / waves.max()) / 2.0
    high = min(2.0 * float(feeds.max() / waves.min()), density.highest)
    if high <= low:
        return np.empty(0)
    f = np.geomspace(low, high, _LINES)
    s = density(f)
    top = np.flatnonzero((s[1:-1] > s[:-2]) & (s[1:-1] >= s[2:])) + 1
    octave = max(int(_LINES * np.log(2.0) / np.log(high / low)), 1)
    rise = np.array([s[i] / np.median(s[max(i - octave, 0) : i + octave + 1]) for i in top])
    strong = top[rise > _PEAK_FACTOR] if top.size else top
    strongest = strong[np.argsort(-s[strong], kind="stable")][:_MOST_PEAKS]
    return np.sort(f[strongest])


def collisions(
    density: TimeDensity,
    frequencies: FloatArray,
    feeds: FloatArray,
    waves: FloatArray,
    length: float,
    limits: Limits | None,
) -> list[Collision]:
    """Return which disturbance falls onto which of the planned wavelengths."""
    low, high = (
        (limits.v_min, limits.v_max)
        if limits is not None
        else (float(feeds.min()) / 2, float(feeds.max()) * 2)
    )
    out = []
    for f in frequencies:
        for v in np.unique(feeds):
            wave = _planned(v / f, waves, length)
            if wave is None:
                continue
            at = np.array([wave])
            own = feeds == v
            others = run_information(density, feeds[~own], at, length).sum() if (~own).any() else 0
            options = np.geomspace(low, high, 401)
            offered = run_information(density, options, at, length)[:, 0]
            remedy = _round_feed(float(_quiet(options, offered, float(v))), low, high)
            wanted = np.median(offered) * feeds.size / np.unique(feeds).size
            out.append(
                Collision(float(f), wave, float(v), remedy, bool(others >= _OWN_SHARE * wanted))
            )
    return out


def _planned(wave: float, waves: FloatArray, length: float) -> float | None:
    """Return the planned wavelength that a disturbance at this one spoils, if there is one.

    A wave in a record of this length is told from another one that differs by one wave in it.
    """
    nearest = float(waves[np.argmin(np.abs(1.0 / waves - 1.0 / wave))])
    return nearest if abs(length / nearest - length / wave) <= 0.5 else None


def _quiet(options: FloatArray, offered: FloatArray, feed: float) -> float:
    """Next slower feed that knows the wave as well as a typical one, else the next faster."""
    good = offered >= 0.8 * np.median(offered)
    good &= np.abs(np.log(options / feed)) > np.log(1.1)
    slower = good & (options < feed)
    usable = slower if slower.any() else good
    if not usable.any():
        return float(options[np.argmax(offered)])
    nearest = np.argmin(np.where(usable, np.abs(np.log(options / feed)), np.inf))
    return float(options[nearest])


def _round_feed(feed: float, low: float, high: float) -> float:
    """Round to 100 mm/min (10, 1 for slow feeds) without leaving the range."""
    for step in (100.0, 10.0, 1.0):
        rounded = round(feed * 6e4 / step) * step / 6e4
        if low <= rounded <= high and abs(rounded / feed - 1.0) < 0.03:
            return rounded
    return feed


def plain_messages(
    found: list[Collision],
    density: TimeDensity,
    feeds: FloatArray,
    waves: FloatArray,
    is_exact: bool,
    information: FloatArray,
) -> tuple[str, ...]:
    """Return the messages of a plan."""
    out = []
    for c in found:
        text = (
            f"{c.frequency:.1f} Hz disturbance maps onto {c.wavelength * 1e3:.1f} mm at "
            f"{c.feed * 6e4:.0f} mm/min"
        )
        if c.covered:
            out.append(f"{text}; the runs at the other feeds tell them apart")
        else:
            out.append(f"{text}; add a run at {c.remedy * 6e4:.0f}")
    if np.unique(feeds).size < 2:
        out.append(
            f"all runs are at {feeds[0] * 6e4:.0f} mm/min: one feed cannot tell vibration from "
            "geometry; the prediction holds only for vibration that is random from run to run"
        )
    beyond = feeds[:, np.newaxis] / waves > density.highest
    if beyond.any():
        out.append(
            f"the density is not known above {density.highest:.4g} Hz: {int(beyond.sum())} of "
            f"{beyond.size} pairs of run and wavelength count as no information"
        )
    if (information <= 0.0).any():
        unknown = waves[information <= 0.0]
        out.append(
            f"nothing is known about waves of {unknown.min() * 1e3:.4g} to "
            f"{unknown.max() * 1e3:.4g} mm at these feeds: their sd is NaN"
        )
    slowest = float(feeds.min() / waves.max())
    if slowest < density.lowest:
        out.append(
            f"the density was not measured below {density.lowest:.4g} Hz; its value there is taken "
            f"down to {slowest:.4g} Hz ({waves.max() * 1e3:.4g} mm at {feeds.min() * 6e4:.0f} "
            "mm/min)"
        )
    if not is_exact:
        out.append(
            "the travel holds more than 300 of the shortest waves: sd is the long-record formula, "
            "which is too large at narrow resonances"
        )
    return tuple(out)
