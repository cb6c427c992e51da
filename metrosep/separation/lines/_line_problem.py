"""Readings of probes in a row, and of a pitch sensor, as one checked problem."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from metrosep.core._arrays import FloatArray, as_float
from metrosep.core.errors import (
    DataError,
    InvalidSamplesError,
    NotUniformError,
    OptionError,
    TooFewSamplesError,
    UnitError,
)
from metrosep.core.numbers import positive, real
from metrosep.core.profile import Profile
from metrosep.core.provenance import Step
from metrosep.core.quantity import Quantity
from metrosep.core.units import format_length
from metrosep.separation.contract import Separation, Unobservable

if TYPE_CHECKING:
    from scipy.sparse import csr_array

MAX_ANGLE = 0.02
"""A pitch above 20 mrad is not a straightness error of a carriage: it was given in another unit."""


class Sensor(NamedTuple):
    """Independent readings of the pitch of the carriage."""

    values: FloatArray  # shape (n,), rad: positive where the leading end raises the reading
    u: float  # rad: standard uncertainty of one value


@dataclass(frozen=True, slots=True, eq=False)
class Problem:
    """All that an estimator works on."""

    row: Row  # probes
    x: FloatArray  # m: carriage positions and artefact positions
    grid: FloatArray
    stations: Stations  # readings taken together; the pitch sensor is the last one if there is one
    nuisance: FloatArray  # shape (n_sensors, p): how the carriage reaches each sensor
    zeros: FloatArray  # shape (n_sensors, q): how each unknown zero reaches each sensor

    @property
    def n_probes(self) -> int:
        """Probes without the pitch sensor."""
        return len(self.row.offsets)

    @property
    def n_sensors(self) -> int:
        """Probes, and the pitch sensor."""
        return int(self.nuisance.shape[0])


def checked_sensor(pitch: ArrayLike | None, u_pitch: float | None, n: int) -> Sensor | None:
    """Return the pitch sensor, or refuse it."""
    if pitch is None:
        if u_pitch is not None:
            raise DataError("u_pitch is given without pitch readings")
        return None
    try:
        values = as_float(pitch)
    except (TypeError, ValueError):
        raise DataError("pitch must be numbers in rad") from None
    if values.shape != (n,):
        raise DataError(f"pitch has the shape {values.shape}, one angle for each of {n} positions")
    if np.isinf(values).any() or np.isnan(values).all():
        raise DataError("pitch must be finite; mark what was not measured as NaN")
    if float(np.nanmax(values) - np.nanmin(values)) > MAX_ANGLE:
        raise UnitError(
            f"pitch varies by {np.nanmax(values) - np.nanmin(values):.4g} rad; it is given in rad, "
            "not in arc seconds, degrees or urad"
        )
    if u_pitch is None:
        raise DataError("pitch readings need their standard uncertainty u_pitch in rad")
    return Sensor(values, positive(u_pitch, "u_pitch", dimension="angle"))


def problem_of(
    row: Row, x: FloatArray, readings: FloatArray, sensor: Sensor | None, noise: float
) -> Problem:
    """Return the problem with its nuisance, zeros and weights; noise is that of one reading, m."""
    o = np.array(row.offsets)
    n_probes = o.size
    stations = stations_of(readings)
    nuisance = np.column_stack([np.ones(n_probes), o]) if row.pitch else np.ones((n_probes, 1))
    lines = nuisance if sensor is None else np.column_stack([np.ones(n_probes), o])
    zeros = np.empty((n_probes, 0)) if row.zero_known else _without_lines(lines)
    if sensor is not None:
        if not noise > 0.0:
            raise DataError(
                "probes and pitch sensor are weighted by their uncertainties: give u_reading in m, "
                "above zero, or repeats"
            )
        nuisance = np.vstack([np.column_stack([np.ones(n_probes), o]), [0.0, 1.0]])
        zeros = np.block(
            [[zeros, np.zeros((n_probes, 1))], [np.zeros((1, zeros.shape[1])), np.ones((1, 1))]]
        )
        relative = sensor.u / noise * math.sqrt(stations.most)
        stations = with_angle(stations, sensor.values, relative)
    return Problem(row, x, grid_of(row, x), stations, nuisance, zeros)


def _without_lines(lines: FloatArray) -> FloatArray:
    """Return orthonormal zeros that no offset or pitch of the carriage could be."""
    left, _, _ = np.linalg.svd(lines, full_matrices=True)
    return np.asarray(left[:, lines.shape[1] :])


def longest_run(whole: NDArray[np.bool_]) -> slice:
    """Return the longest run of true values; an empty slice where there is none."""
    edges = np.diff(np.concatenate([[0], whole.astype(np.int8), [0]]))
    first, last = np.flatnonzero(edges == 1), np.flatnonzero(edges == -1)
    if first.size == 0:
        return slice(0, 0)
    best = int(np.argmax(last - first))
    return slice(int(first[best]), int(last[best]))


def check_size(n: int, what: str) -> None:
    """Refuse designs whose covariance would not fit into memory."""
    if n > MAX_POSITIONS:
        raise DataError(
            f"{what}: {n} positions; the exact covariance takes up to {MAX_POSITIONS}: average or "
            "thin the readings, or cut the travel into parts that overlap"
        )


# ---- passes of probes in a row, sorted so that no mean mixes the carriage of different passes ----
# Each pass has its own straightness and pitch. A mean over passes is free of them only if all its
# probes were read in the same passes. So the passes of each position are sorted by which probes they
# hold: one station is a position, a set of probes, and the mean over the passes that hold this set.


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


# ---- names of the estimators ------------------------------------------------------------------

METHODS = ("sequential", "generalised", "combined", "least_squares")

_SPELLINGS = {
    "generalized": "generalised",
    "least-squares": "least_squares",
    "ls": "least_squares",
}


def method_named(name: Any, known: tuple[str, ...], what: str) -> str:
    """Return the name of an estimator, spelt in one way."""
    word = name.lower() if isinstance(name, str) else ""
    word = _SPELLINGS.get(word, word)
    if word not in known:
        raise OptionError(f"{what} has no method {name!r}; it has {', '.join(known)}")
    return word


# ---- arguments of the public functions for probes in a row, as people call them ----------------


@dataclass(frozen=True, slots=True, eq=False)
class Given:
    """Readings with their positions."""

    readings: FloatArray  # shape (n_probes, n) or (n_probes, R, n), m: of all probes
    x: FloatArray | None  # m: positions of the carriage
    step: float  # m: between the samples of the artefact
    history: tuple[Step, ...]  # of profiles
    messages: tuple[str, ...]  # what was assumed

    def separated(
        self,
        method: Any,
        u_reading: float | None,
        pitch: ArrayLike | None,
        u_pitch: float | None,
    ) -> Separation:
        """Return what a method makes of them, with what was assumed."""
        found: Separation = method.separate(
            self.readings,
            u_reading=u_reading,
            x=self.x,
            pitch=pitch,
            u_pitch=u_pitch,
            history=self.history,
        )
        return replace(found, messages=(*self.messages, *found.messages))


def split_call(m: Any, more: Sequence[Any], distance: Any, n_probes: int, what: str) -> Any:
    """Return readings and distance of a call with one array, or with one array for each probe."""
    if distance is None and more:
        more, distance = more[:-1], more[-1]
    right = f"call {what}(m, distance, step=...) with m of shape ({n_probes}, n)"
    if distance is None or isinstance(distance, Profile) or np.ma.size(distance) > 3:
        raise DataError(f"{what}: the distance between the probes in m is missing; {right}")
    if not more:
        return m, distance
    if len(more) != n_probes - 1:
        raise DataError(f"{what}: {1 + len(more)} readings for {n_probes} probes; {right}")
    return [m, *more], distance


def given_readings(
    m: Any, x: ArrayLike | None, step: float | None, what: str, *, distance: Any = None
) -> Given:
    """Return readings, positions and step of arrays or profiles."""
    history: tuple[Step, ...] = ()
    if isinstance(m, (list, tuple)) and any(isinstance(p, Profile) for p in m):
        m, x, history = _of_profiles(m, x, what)
    readings = _array(m, what)
    n = readings.shape[-1]
    spacing = (
        None if step is None else real(step, f"{what}: step", dimension="length", finite=False)
    )
    if x is not None:
        at = positions(as_float(x), None, n, what)
        return Given(readings, at, spacing or uniform_step(at, what), history, ())
    messages: tuple[str, ...] = ()
    if spacing is None:
        apart = None if distance is None else distances(distance)
        if apart is None or apart[0] != apart[1]:
            raise DataError(f"{what} needs the positions x or the step between them, in m")
        spacing = apart[0]
        text = (
            "the step is not given and taken as the distance of the probes, "
            f"{format_length(spacing)}: give x or step if the carriage moves otherwise"
        )
        messages = (text,)
    return Given(readings, None, spacing, history, messages)


def distances(distance: float | tuple[float, float]) -> tuple[float, float]:
    """Return both distances of three probes, which may be one."""
    several = isinstance(distance, (tuple, list, np.ndarray)) and np.ndim(distance) > 0
    values = np.ravel(distance).tolist() if several else [distance]
    if len(values) not in (1, 2):
        raise DataError(f"distance is one length in m above zero, or two, got {distance}")
    both = [positive(v, "distance", dimension="length") for v in values]
    return both[0], both[-1]


@dataclass(frozen=True, slots=True)
class ZeroCalibration:
    """Zero difference of three probes and how it was found.

    Parameters
    ----------
    zero : float, m
        ``e1 - (1 + r) e2 + r e3``, r the ratio of the distances.
    u : float, m
        Standard uncertainty.
    distance : tuple of (float, float), m
        Distances of the probes for which it holds.
    source : str
        ``"reversal"``, ``"flat"`` or ``"pitch"``.
    audit : mapping, optional
        What went in.
    messages : tuple of str, optional
        What the user should know.
    """

    zero: float
    u: float
    distance: tuple[float, float]
    source: str
    audit: Mapping[str, Any] = field(default_factory=dict)
    messages: tuple[str, ...] = ()

    @property
    def quantity(self) -> Quantity:
        """Value with unit and uncertainty."""
        text = f"zero difference e1 - (1 + r) e2 + r e3 of three probes, from {self.source}"
        return Quantity(self.zero, "m", text, u=self.u, symbol="delta")

    def zero_for(self, distance: float | tuple[float, float]) -> float:
        """Return the zero difference if it belongs to these distances.

        Parameters
        ----------
        distance : float or tuple of (float, float), m
            Of the probes in use.

        Returns
        -------
        float, m
            `zero`.

        Raises
        ------
        DataError
            If the probes were calibrated at another ratio of distances.
        """
        d1, d2 = distances(distance)
        ratio, own = d1 / d2, self.distance[0] / self.distance[1]
        if abs(ratio / own - 1.0) > 1e-3:
            raise DataError(
                f"the zero was calibrated for probe distances in the ratio {own:.6g}, these are in "
                f"the ratio {ratio:.6g}: the difference weighs the probes otherwise; calibrate again"
            )
        return self.zero


def _array(m: Any, what: str) -> FloatArray:
    try:
        readings = as_float(m)
    except (TypeError, ValueError) as exc:
        raise InvalidSamplesError(
            f"{what}: readings must be an array of numbers, one row for each probe, all of one length "
            f"({exc})"
        ) from None
    if readings.ndim < 2:
        raise InvalidSamplesError(
            f"{what}: got one row of {readings.size} numbers; give the raw readings of all probes as "
            "m = [m1, m2, ...], not their differences: straightness and pitch need them"
        )
    return readings


def _of_profiles(
    m: Sequence[Any], x: ArrayLike | None, what: str
) -> tuple[FloatArray, FloatArray, tuple[Step, ...]]:
    if not all(isinstance(p, Profile) for p in m) or x is not None:
        raise DataError(
            f"{what}: give all probes as profiles over the carriage positions, without x, or all as "
            "arrays"
        )
    for p in m:
        p.require_metres()
    first = m[0]
    for i, p in enumerate(m[1:], start=2):
        if len(p) != len(first) or np.abs(p.x - first.x).max() > 1e-6 * float(np.ptp(first.x)):
            raise DataError(
                f"{what}: probe {i} was read at other positions than probe 1; all profiles must be "
                "given over the position of the carriage"
            )
    return np.array([p.z for p in m]), first.x, tuple(s for p in m for s in p.history)


# ---- what probes in a row cannot see, and how much they see of a wave --------------------------

LINE = (
    "offset and line are the alignment of artefact and probes to the carriage; measure them "
    "against another reference"
)
PARABOLA = (
    "the zero error of the middle probe bends the artefact into a parabola; give zero with "
    "u_zero, zero_cal from a reversal or a known flat, or the readings of a pitch sensor"
)


def hidden_wavelengths(row: Row) -> tuple[float, ...]:
    """Return the wavelengths of at least two steps that no combination of the probes sees, m."""
    o = np.array(row.offsets) - row.offsets[0]
    found: set[float] = set()
    for d in np.diff(o):
        for n in range(1, int(d / (2.0 * row.step) * (1.0 + 1e-9)) + 1):
            wavelength = float(d) / n
            phase = np.exp(2j * np.pi * o / wavelength)
            if np.abs(phase - 1.0).max() < 1e-6:
                found.add(float(f"{wavelength:.9g}"))
    return tuple(sorted(found, reverse=True))


def transfer_of(
    offsets: tuple[float, ...], nuisance: FloatArray, wavelengths: FloatArray
) -> FloatArray:
    """Return the length of what is left of a unit wave when the carriage has cancelled."""
    left, size, _ = np.linalg.svd(nuisance, full_matrices=True)
    rank = int((size > 1e-12 * size.max()).sum())
    with np.errstate(divide="ignore"):
        phase = np.exp(2j * np.pi * np.array(offsets)[:, None] / wavelengths[None, :])
    return np.asarray(np.linalg.norm(left[:, rank:].T @ phase, axis=0))


def null_space_of(row: Row, degree: int, *, pitch_part: bool) -> tuple[Unobservable, ...]:
    """Return what whole readings of these probes do not determine."""
    reason = LINE if degree < 2 else f"{LINE}; {PARABOLA}"
    items = [
        Unobservable(
            p, "polynomial", tuple(range(degree + 1)), reason, as_it_lies=p == "straightness"
        )
        for p in (
            "artefact",
            "straightness",
        )  # the line that was taken off the one is in the other
    ]
    if row.pitch:
        items.append(Unobservable("pitch", "polynomial", tuple(range(degree)), reason))
    elif pitch_part:
        text = (
            "two probes cannot tell pitch from form: the sum of pitch times distance is in the "
            "artefact; use three probes or read the pitch with an angle sensor"
        )
        items.append(Unobservable("pitch", "term", ("pitch",), text))
    waves = hidden_wavelengths(row)
    if waves:
        text = (
            "all probes see these waves in the same phase; change the distances so that they have "
            "no large common measure, or measure a second time with another distance"
        )
        items.append(Unobservable("artefact", "wavelength", waves, text))
    if has_end_waves(row):
        text = (
            "each position gives one equation, so as many shapes as the probes span steps stay free: "
            "waves that die away from the ends; overlap the ends, add a probe, or use "
            "method='generalised', which takes the smoothest"
        )
        items.append(Unobservable("artefact", "term", ("end waves",), text))
    return tuple(items)


def has_end_waves(row: Row) -> bool:
    """Return whether shapes other than lines and waves of the distances escape these probes."""
    order = 2 if row.pitch else 1
    return len(row.offsets) == order + 1 and row.span > order * row.grid_period


# ---- which samples of an artefact the probes of a row read, and whether they read any of them twice ----


def needed_travel(row: Row) -> float:
    """Return the travel below which no place of the artefact is read by two probes that count, m.

    As many probes as the carriage needs must each overlap with its neighbour, of more one pair.
    """
    gaps = np.diff(row.offsets)
    least = len(row.offsets) == (3 if row.pitch else 2)
    return float(gaps.max() if least else gaps.min()) * (1.0 - GRID_RTOL)


def check_overlap(row: Row, x: FloatArray, what: str) -> None:
    """Refuse probes farther apart than the carriage travels: no place is read twice."""
    travel, needed = float(x[-1] - x[0]), needed_travel(row)
    if travel >= needed:
        return
    needed /= 1.0 - GRID_RTOL
    raise UnitError(
        f"{what}: the carriage travels {format_length(travel)}, but the probes are "
        f"{format_length(needed)} apart: no place of the artefact is read by both, so nothing is "
        "separated; distances and positions are given in m, or travel farther"
    )


def check_steps(row: Row, x: FloatArray, what: str) -> None:
    """Refuse positions that are not one step of the sums apart."""
    worst = float(np.abs(np.diff(x) - row.step).max(initial=0.0))
    if worst > 2.0 * GRID_RTOL * row.step:
        raise NotUniformError(
            f"{what}: the positions x differ by up to {format_length(worst)} from steps of "
            f"{format_length(row.step)}, and 'sequential' sums are over equal steps; leave out step, "
            "or use method='least_squares'"
        )


def probe_places(row: Row, x: FloatArray, grid: FloatArray) -> list[FloatArray]:
    """Return where each probe reads: on the grid itself where steps are equal and offsets whole."""
    even = np.abs(np.diff(x) - row.step).max() <= 2.0 * GRID_RTOL * row.step
    if row.shifts is not None and even:
        return [grid[k : k + x.size] for k in row.shifts]
    return [x + o for o in row.offsets]


def read_samples(
    rows: Rows, places: list[FloatArray], at: NDArray[np.intp], grid: FloatArray, step: float
) -> NDArray[np.bool_]:
    """Return which samples lie less than a step from a reading that takes part in a row.

    A sample a whole step away from every reading lies between samples that were read: what an
    estimator makes of it is a guess.
    """
    touched = rows.touched
    here = [np.empty(0)] + [p[at[touched[s]]] for s, p in enumerate(places)]
    index = (np.concatenate(here) - grid[0]) / step
    read = np.zeros(grid.size, dtype=bool)
    low = np.floor(index + GRID_RTOL)
    exact = np.abs(index - low) <= 2.0 * GRID_RTOL
    for sample in (low, low[~exact] + 1.0):
        read[np.clip(sample, 0, grid.size - 1).astype(np.intp)] = True
    return read


# ---- probes in a row: geometry, checks, and the rows in which the carriage cancels -----------

GRID_RTOL = 1e-3
"""Steps of a slide scatter: an offset within this share of a step is a multiple of it, and so are
positions within it equidistant."""

RATIO_RTOL = 1e-6
"""The ratios of offsets must be whole within this share of a step. Between distances that differ a
tilt of the artefact reads like a zero error: 10 and 10.01 mm under 100 urad are 1 nm."""

MAX_POSITIONS = 4000
"""The full covariance is a dense matrix; more positions than this are refused."""


@dataclass(frozen=True, slots=True)
class Row:
    """Probes in a row."""

    offsets: tuple[float, ...]  # m: where the probes sit along the carriage, rising
    # m: spacing of the artefact grid and, unless positions are given, of the carriage positions
    step: float
    pitch: bool  # whether the pitch of the carriage is a free unknown at each position
    zero_known: bool = False  # whether the readings are already without the zeros of the probes

    @property
    def shifts(self) -> tuple[int, ...] | None:
        """Offsets from the first probe in steps; None where one is not a multiple of the step."""
        ratio = (np.array(self.offsets) - self.offsets[0]) / self.step
        whole = np.round(ratio)
        if np.abs(ratio - whole).max() > GRID_RTOL or whole[-1] < 1.0:
            return None
        if np.abs(ratio - whole * (ratio[-1] / whole[-1])).max() > RATIO_RTOL:
            return None
        return tuple(int(v) for v in whole)

    @property
    def span(self) -> int:
        """Steps of the artefact grid that the row of probes covers, rounded up."""
        ratio = (self.offsets[-1] - self.offsets[0]) / self.step
        return math.ceil(ratio - GRID_RTOL)

    @property
    def grid_period(self) -> int:
        """Largest number of steps that divides all spacings; 0 where they are not multiples."""
        shifts = self.shifts
        return 0 if shifts is None else math.gcd(*shifts)

    @property
    def weights(self) -> FloatArray:
        """Return the combination of readings that cancels the carriage, normalised to spec form.

        For two probes ``m2 - m1``, for three ``m1 - (1 + d1/d2) m2 + (d1/d2) m3``.
        """
        o = np.array(self.offsets)
        if not self.pitch:
            return np.array([-1.0, 1.0])
        r = float(o[1] - o[0]) / float(o[2] - o[1])
        return np.array([1.0, -(1.0 + r), r])


def checked_row(
    offsets: ArrayLike, step: float | None, *, what: str, pitch: bool, zero_known: bool = False
) -> Row:
    """Return the row of probes, or refuse it."""
    try:
        o = np.array(offsets, dtype=np.float64).ravel()
    except (TypeError, ValueError):
        raise DataError(f"{what}: the distances of the probes must be numbers in m") from None
    if o.size < 2 or not np.isfinite(o).all() or (np.diff(o) <= 0.0).any():
        raise DataError(
            f"{what}: probes must sit at rising, finite offsets in m (distances above zero), got "
            f"{o.tolist()}; order the readings from the trailing to the leading probe (rising x)"
        )
    step = positive(step, f"{what}: the step between carriage positions", dimension="length")
    if float(np.ptp(o)) > 100.0:
        raise UnitError(
            f"{what}: the probes span {float(np.ptp(o)):g} m; distances are given in m, not in mm"
        )
    if float(np.ptp(o)) < step * (1.0 - GRID_RTOL):
        raise DataError(
            f"{what}: the probes span {format_length(float(np.ptp(o)))}, less than the step of "
            f"{format_length(step)}: no place is read by two probes; move in steps of at most "
            "the distance of the probes"
        )
    return Row(tuple(o.tolist()), step, pitch, zero_known)


def positions(x: ArrayLike | None, step: float | None, n: int, what: str) -> FloatArray:
    """Return n rising carriage positions, of equal steps where only the step is known."""
    if x is None:
        if step is None:
            raise DataError(f"{what} needs the positions x or the step between them, in m")
        return np.arange(n, dtype=np.float64) * float(step)
    try:
        at = np.array(x, dtype=np.float64)
    except (TypeError, ValueError):
        raise InvalidSamplesError(f"{what}: positions x must be numbers in m") from None
    if at.shape != (n,):
        raise InvalidSamplesError(f"{what}: {at.size} positions x for {n} readings of each probe")
    if not np.isfinite(at).all() or (np.diff(at) <= 0.0).any():
        raise InvalidSamplesError(
            f"{what}: positions x must be finite and rise; for a run in -x turn round x and all "
            "readings together"
        )
    return at


def uniform_step(x: FloatArray, what: str) -> float:
    """Return the one step of positions, or refuse them."""
    if x.size < 2:
        raise TooFewSamplesError(f"{what} needs at least 2 positions, got {x.size}")
    step = float(x[-1] - x[0]) / (x.size - 1)
    worst = float(np.abs(np.diff(x) - step).max())
    if worst > GRID_RTOL * step:
        raise NotUniformError(
            f"{what}: the steps between positions differ by up to {format_length(worst)} from "
            f"{format_length(step)}; use method='least_squares' with a step, or resample"
        )
    return step


def grid_of(row: Row, x: FloatArray) -> FloatArray:
    """Return the positions of the artefact that the probes reach, a multiple of steps apart."""
    start = x[0] + row.offsets[0]
    reach = float(x[-1] - x[0] + row.offsets[-1] - row.offsets[0]) / row.step
    return np.asarray(start + row.step * np.arange(math.ceil(reach - 1e-3) + 1))


def interpolation(grid: FloatArray, at: FloatArray) -> csr_array:
    """Return the matrix that takes values on a uniform grid to values at other positions.

    Exact selection where the positions lie on the grid, else the interpolating spline of degree
    5 (of the highest degree that few samples allow).
    """
    from scipy.interpolate import make_interp_spline
    from scipy.sparse import csr_array

    step = (grid[-1] - grid[0]) / (grid.size - 1)
    index = (at - grid[0]) / step
    near = np.round(index).astype(np.intp)
    if np.abs(index - near).max() <= RATIO_RTOL:
        ones = np.ones(at.size)
        return csr_array((ones, (np.arange(at.size), near)), shape=(at.size, grid.size))
    degree = max(d for d in (1, 3, 5) if d < grid.size)
    spline = make_interp_spline(np.arange(grid.size), np.eye(grid.size), k=degree)
    dense = np.array(spline(np.clip(index, 0.0, grid.size - 1.0)))
    dense[np.abs(dense) < 1e-15] = 0.0
    return csr_array(dense)


@dataclass(frozen=True, slots=True, eq=False)
class Rows:
    """Whitened combinations of readings in which the carriage has cancelled."""

    # sparse array, shape (n_rows, n_sensors n_stations): orthonormal rows; readings in units of
    # their standard deviations go in
    weights: Any
    # shape (n_sensors, n_stations): standard deviations that whitened them, relative to that of a
    # probe
    sd: FloatArray

    def of(self, readings: FloatArray) -> FloatArray:
        """Return the combinations of readings, shape (n_sensors, n_stations)."""
        clean = np.where(np.isnan(readings), 0.0, readings) / self.sd
        return np.asarray(self.weights @ clean.ravel())

    @property
    def touched(self) -> NDArray[np.bool_]:
        """Which reading takes part in a row, shape (n_sensors, n_stations)."""
        columns = np.zeros(self.sd.size, dtype=bool)
        columns[self.weights.indices[self.weights.data != 0.0]] = True
        return columns.reshape(self.sd.shape)


def rows_without_carriage(valid: NDArray[np.bool_], nuisance: FloatArray, sd: FloatArray) -> Rows:
    """Return the combinations of the valid readings at each station that do not see the carriage."""
    from scipy.sparse import csr_array

    n_sensors, n = valid.shape
    kind, group = kinds_of(valid, sd)
    found = [complement(nuisance, sd[:, i], valid[:, i]) for i in kind]
    count = np.array([q.shape[0] for q in found], dtype=np.intp)[group] if n else np.empty(0, int)
    first = np.concatenate([[0], np.cumsum(count)]).astype(np.intp)
    r_index: list[NDArray[np.intp]] = []
    c_index: list[NDArray[np.intp]] = []
    data: list[FloatArray] = []
    for g, q in enumerate(found):
        at = np.flatnonzero(group == g)
        for k in range(q.shape[0]):
            for s in np.flatnonzero(q[k]):
                r_index.append(first[at] + k)
                c_index.append(s * n + at)
                data.append(np.full(at.size, q[k, s]))
    shape = (int(first[-1]), n_sensors * n)
    if not data:
        return Rows(csr_array(shape), sd)
    parts = (np.concatenate(data), (np.concatenate(r_index), np.concatenate(c_index)))
    return Rows(csr_array(parts, shape=shape), sd)


def kinds_of(
    valid: NDArray[np.bool_], sd: FloatArray
) -> tuple[NDArray[np.intp], NDArray[np.intp]]:
    """Return one station of each kind (same sensors, same weights), and the kind of each."""
    both = np.vstack([valid, np.where(valid, sd, 0.0)]).T
    _, kind, group = np.unique(both, axis=0, return_index=True, return_inverse=True)
    return kind, group.ravel()


def complement(nuisance: FloatArray, sd: FloatArray, used: NDArray[np.bool_]) -> FloatArray:
    """Return orthonormal rows over the sensors in use that are orthogonal to the nuisance."""
    n = nuisance.shape[0]
    if not used.any():
        return np.empty((0, n))
    scaled = nuisance[used] / sd[used, None]
    left, size, _ = np.linalg.svd(scaled, full_matrices=True)
    rank = int((size > 1e-12 * max(float(size.max()), 1e-300)).sum())
    out = np.zeros((int(used.sum()) - rank, n))
    out[:, used] = left[:, rank:].T
    return out
