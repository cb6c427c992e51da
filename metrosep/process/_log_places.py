"""Private: where on the spiral the samples of a log of the dry run belong.

The radius falls by one feed a turn: it tells on which turn a sample lies, and no more, since a
radius read to 0.1 um leaves 18 degrees at a feed of 2 um. The angle within the turn is the azimuth.
``travelled`` is the angle since the rim, as `SpiralPath.theta`.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from metrosep.core._arrays import FloatArray
from metrosep.core.errors import DataError, TooFewSamplesError
from metrosep.core.units import format_length
from metrosep.process._motion import FollowUp, FollowUpMap
from metrosep.process.path_points import SpiralPath

_TURN = 2.0 * math.pi
_ASTRAY = 0.5
"""rad: a log whose azimuth leaves the programmed spiral by more belongs to another program."""
_NOTED = 0.03
"""rad: a systematic difference between azimuth and radius worth a message."""
_SURE = 2.0
"""rad, below half a turn: radii that close to the spiral tell the turn each for itself."""
_VAGUE = 0.25 * _TURN
"""rad RMS: radii that scatter by more than a quarter of the feed do not tell the turn."""
_STEPS = 2.5
"""Steps of the log that are bridged; a longer stretch without a sample is a hole."""
_BRIDGED = _TURN / 8.0
"""rad: the longest hole, or late start, over which a correction is carried on."""
_BLOCK = 128
_EDGE = 1e-6
"""rad: positions that close to an end of the log lie in it."""


@dataclass(frozen=True, slots=True)
class PlacedLog:
    """Samples of a log along the spiral, and the holes between them."""

    travelled: FloatArray  # shape (n,), rad: since the rim, growing
    z: FloatArray  # shape (n,), m: error; no NaN
    is_hole: NDArray[np.bool_]  # shape (n - 1,): intervals much longer than those around them
    step: float  # rad: median interval

    @property
    def holes(self) -> list[tuple[float, float]]:
        """Where each hole begins and ends, rad."""
        found = np.flatnonzero(self.is_hole)
        return [(float(self.travelled[i]), float(self.travelled[i + 1])) for i in found]


def placed_log(log: FollowUp | FollowUpMap, spiral: SpiralPath, messages: list[str]) -> PlacedLog:
    """Return the samples of a log that lie on the part, in the order of the spiral."""
    places = log.map if isinstance(log, FollowUp) else log
    if places is None:
        raise DataError(
            "the log has no places on the part: it needs channels of radius and azimuth, or "
            "follow_up(..., spiral=(start radius, feed, spindle speed))"
        )
    near = (places.rho <= spiral.radius + 0.5 * spiral.feed) & (places.rho >= 0.0)
    at = np.flatnonzero(near & ~np.isnan(places.theta))
    measured = ~np.isnan(places.z[at])
    if int(measured.sum()) < 2:
        raise TooFewSamplesError("the log has no samples with a place on the part")
    by_radius = (spiral.radius - places.rho[at]) * (_TURN / spiral.feed)
    travelled = _travelled(at, by_radius, spiral.travelled_to(places.theta[at]))
    _check(by_radius - travelled, spiral.feed, messages)
    where, which = np.unique(travelled[measured], return_inverse=True)
    if where.size < 2:
        raise TooFewSamplesError("all samples of the log lie at the same place of the part")
    z = np.bincount(which, weights=places.z[at][measured]) / np.bincount(which)
    steps = np.diff(where)
    parts = np.array_split(steps, max(1, steps.size // _BLOCK))
    usual = np.concatenate([np.full(p.size, np.median(p)) for p in parts])
    return PlacedLog(where, z, steps > _STEPS * usual, float(np.median(steps)))


def _travelled(at: NDArray[np.intp], by_radius: FloatArray, turned: FloatArray) -> FloatArray:
    """Return the angle travelled: the azimuth, with the turn that the radius tells."""
    off = np.exp(1j * (by_radius - turned))
    mean = float(np.angle(off.sum()))
    rest = np.angle(off * np.exp(-1j * mean))
    if float(np.abs(rest).max()) < _SURE:
        return turned + _TURN * np.round((by_radius - turned - mean) / _TURN)
    # Radii alone do not tell: count on from sample to sample, and let each run have one turn.
    small = np.angle(np.exp(1j * np.diff(turned)))
    jump = np.diff(by_radius) - small
    noise = 1.4826 * float(np.median(np.abs(jump - np.median(jump))))
    breaks = (np.abs(jump) > max(math.pi, 6.0 * noise)) | (np.diff(at) > 1)
    counted = turned[0] + np.concatenate([[0.0], np.cumsum(small)])
    starts = np.concatenate([[0], np.flatnonzero(breaks) + 1, [turned.size]])
    turns = np.empty(turned.size)
    for first, last in zip(starts[:-1].tolist(), starts[1:].tolist(), strict=True):
        missing = np.median(by_radius[first:last] - counted[first:last] - mean)
        turns[first:last] = np.round(missing / _TURN)
    out: FloatArray = counted + _TURN * turns
    return out


def _check(off: FloatArray, feed: float, messages: list[str]) -> None:
    """Refuse a log of another spiral, or one whose turns cannot be told; `off`: radius - azimuth."""
    noise = float(np.sqrt(0.5 * np.mean(np.square(np.diff(off)))))
    if noise > _VAGUE:
        raise DataError(
            f"the radii of the log scatter by {format_length(noise * feed / _TURN)} (RMS) about "
            f"the spiral, more than a quarter of the feed of {format_length(feed)}: they do not "
            "tell on which turn a sample lies; place the log with follow_up(..., spiral=(start "
            "radius, feed, spindle speed))"
        )
    n_blocks = max(1, min(64, off.size // 8))
    worst = max(abs(float(np.median(b))) for b in np.array_split(off, n_blocks))
    if worst > _ASTRAY:
        raise DataError(
            f"the log leaves the programmed spiral by up to {np.degrees(min(worst, math.pi)):.1f} "
            "deg of azimuth; check its start radius, feed, speed and the sense of rotation"
        )
    mean = float(np.median(off))
    if abs(mean) > _NOTED:
        messages.append(
            f"radii and azimuths of the log disagree by {np.degrees(abs(mean)):.1f} deg throughout "
            f"({format_length(abs(mean) * feed / _TURN)} of radius); the azimuths are believed, "
            "and if it is their zero that is off, the error is turned by as much: check the zero of "
            "the spindle angle, and the start radius"
        )


def on_spiral(
    log: FollowUp | FollowUpMap, spiral: SpiralPath, rho: FloatArray, messages: list[str]
) -> FloatArray:
    """Return a logged error at radii of the spiral; NaN in holes and where the log does not reach."""
    placed = placed_log(log, spiral, messages)
    at = (spiral.radius - rho) * (_TURN / spiral.feed)
    first, last = placed.travelled[0], placed.travelled[-1]
    z = np.interp(at, placed.travelled, placed.z)
    z[(at < first - _EDGE) | (at > last + _EDGE)] = np.nan
    if placed.is_hole.any():
        i = np.searchsorted(placed.travelled, at, side="right") - 1
        i = np.clip(i, 0, placed.is_hole.size - 1)
        inside = (at > placed.travelled[i] + _EDGE) & (at < placed.travelled[i + 1] - _EDGE)
        z[placed.is_hole[i] & inside] = np.nan
        begin, end = max(placed.holes, key=lambda h: h[1] - h[0])
        radii = (max(0.0, spiral.radius - spiral.feed * t / _TURN) for t in (begin, end))
        messages.append(
            f"the log has {len(placed.holes)} hole(s) longer than {_STEPS:g} of its steps, the longest "
            f"{(end - begin) / _TURN:.3g} turns at rho = {' to '.join(map(format_length, radii))}; its "
            "error is not known there"
        )
    if placed.step > 0.1:
        messages.append(
            f"the log has a sample every {np.degrees(placed.step):.1f} deg only; between them its "
            "error is taken on straight lines"
        )
    covered = float(np.mean(~np.isnan(z)))
    if covered < 0.999:
        messages.append(f"the log covers {100.0 * covered:.1f} % of the path")
    out: FloatArray = z
    return out


def held_on_points(
    log: FollowUp | FollowUpMap, spiral: SpiralPath, rho: FloatArray, messages: list[str]
) -> FloatArray:
    """Return a logged error at all points of a program, lead-in included, without a step.

    The lead-in and a short stretch at either end take the value of the log's end; short holes are
    bridged by straight lines; longer ones are refused.
    """
    placed = placed_log(log, spiral, messages)
    at = (spiral.radius - rho) * (_TURN / spiral.feed)
    first, last = float(placed.travelled[0]), float(placed.travelled[-1])
    longest = max((b - a for a, b in placed.holes if b > 0.0 and a < at[-1]), default=0.0)
    missing = {
        "starts {} after the rim": (first, _BRIDGED),
        "ends {} before the last point": (float(at[-1]) - last, _TURN),
        "has a hole of {}": (longest, _BRIDGED),
    }
    for words, (length, allowed) in missing.items():
        if length > max(allowed, _STEPS * placed.step):
            raise DataError(
                f"the log {words.format(f'{length / _TURN:.3g} turns')}: a correction that begins "
                "or ends there makes a step of the whole follow-up error; log the whole dry run, "
                "or end the path (core) with the log"
            )
    if placed.is_hole.any():
        messages.append(
            f"{len(placed.holes)} hole(s) of the log, up to {np.degrees(longest):.1f} deg, are "
            "bridged by straight lines"
        )
    beyond = int(((at < first - _EDGE) | (at > last + _EDGE)).sum())
    if beyond:
        messages.append(
            f"{beyond} of {at.size} points lie before or beyond the log (lead-in, ends) and take "
            "its first or last value"
        )
    return np.interp(at, placed.travelled, placed.z)
