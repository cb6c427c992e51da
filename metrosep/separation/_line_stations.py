"""Passes of probes in a row, sorted so that no mean mixes the carriage of different passes.

Each pass has its own straightness and pitch. A mean over passes is free of them only if all its
probes were read in the same passes. So the passes of each position are sorted by which probes they
hold: one station is a position, a set of probes, and the mean over the passes that hold this set.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from metrosep.core._arrays import FloatArray
from metrosep.separation._line_probes import complement


@dataclass(frozen=True, slots=True, eq=False)
class Stations:
    """Means of readings that were taken together."""

    # shape (n_sensors, n_stations): means; NaN where a sensor does not belong to the station
    values: FloatArray
    # shape (n_sensors, n_stations): their standard deviations relative to the mean of `most`
    # readings of a probe
    sd: FloatArray
    at: NDArray[np.intp]  # shape (n_stations,): which position of the carriage
    count: NDArray[np.intp]  # shape (n_stations,): how many passes
    most: int  # passes at the position that has most of them
    # positions at which the angle was left out because a pass misses a probe
    n_lost_angles: int = 0

    @property
    def valid(self) -> NDArray[np.bool_]:
        """Which sensor belongs to which station."""
        return ~np.isnan(self.values)

    def within(self, piece: slice) -> Stations:
        """Return the stations of a run of positions, counted from its first."""
        inside = (self.at >= piece.start) & (self.at < piece.stop)
        return Stations(
            self.values[:, inside],
            self.sd[:, inside],
            self.at[inside] - piece.start,
            self.count[inside],
            self.most,
        )

    def whole(self, n_probes: int, n: int) -> NDArray[np.bool_]:
        """Return at which of n positions all probes were read together."""
        out = np.zeros(n, dtype=bool)
        out[self.at[self.valid[:n_probes].all(axis=0)]] = True
        return out


def stations_of(readings: FloatArray) -> Stations:
    """Return the stations of readings, shape (n_probes, R, n)."""
    n_probes, _, n = readings.shape
    valid = ~np.isnan(readings)
    code = _codes(valid)
    clean = np.where(valid, readings, 0.0)
    patterns = [int(p) for p in np.unique(code) if p]
    values, at, count = [np.empty((n_probes, 0))], [np.empty(0, int)], [np.empty(0, int)]
    for pattern in patterns:
        passes = code == pattern
        number = passes.sum(axis=0)
        here = np.flatnonzero(number)
        mean = (clean * passes).sum(axis=1)[:, here] / number[here]
        used = np.array([pattern >> s & 1 for s in range(n_probes)], dtype=bool)
        values.append(np.where(used[:, None], mean, np.nan))
        at.append(here)
        count.append(number[here])
    place, counts = np.concatenate(at), np.concatenate(count)
    order = np.argsort(place, kind="stable")
    most = int(np.bincount(place, counts, minlength=n).max(initial=1.0))
    sd = np.broadcast_to(np.sqrt(most / counts[order]), (n_probes, order.size)).copy()
    return Stations(
        np.concatenate(values, axis=1)[:, order], sd, place[order], counts[order], most
    )


def with_angle(stations: Stations, angle: FloatArray, sd: float) -> Stations:
    """Return stations with an angle sensor that reads the mean pitch of all passes of a position."""
    shared = np.bincount(stations.at, minlength=angle.size)[stations.at] > 1
    values = np.where(shared, np.nan, angle[stations.at])
    lost = np.unique(stations.at[shared & ~np.isnan(angle[stations.at])]).size
    return Stations(
        np.vstack([stations.values, values]),
        np.vstack([stations.sd, np.full(values.size, sd)]),
        stations.at,
        stations.count,
        stations.most,
        lost,
    )


def pooled_noise(readings: FloatArray, nuisance: FloatArray) -> tuple[float, float]:
    """Return the standard deviation of one reading from passes, and its degrees of freedom.

    Straightness and pitch may differ from pass to pass: only what is left without them counts,
    among the passes that hold the same probes at a position.
    """
    n_probes = readings.shape[0]
    valid = ~np.isnan(readings)
    code = _codes(valid)
    clean = np.where(valid, readings, 0.0)
    squares, freedom = 0.0, 0.0
    for pattern in (int(p) for p in np.unique(code) if p):
        used = np.array([pattern >> s & 1 for s in range(n_probes)], dtype=bool)
        rows = complement(nuisance, np.ones(n_probes), used)
        passes = code == pattern
        y = np.tensordot(rows, clean, axes=1) * passes
        count = passes.sum(axis=0)
        mean = y.sum(axis=1) / np.maximum(count, 1)
        squares += float((((y - mean[:, None, :]) * passes) ** 2).sum())
        freedom += float(rows.shape[0] * np.maximum(count - 1, 0).sum())
    return (math.sqrt(squares / freedom), freedom) if freedom >= 1.0 else (math.nan, 0.0)


def _codes(valid: NDArray[np.bool_]) -> NDArray[np.int64]:
    """Return which probes each pass holds at each position as a number, shape (R, n)."""
    weights = (1 << np.arange(valid.shape[0])).astype(np.int64)
    return np.asarray(np.tensordot(weights, valid.astype(np.int64), axes=1))
