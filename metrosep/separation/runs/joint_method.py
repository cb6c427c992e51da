"""`JointSeparation`: the joint separator for runs that are read at the same positions.

``reading_r(x) = forward(x) or reverse(x) + slope (x - middle) + offset_r + artefact(x)``, and noise
in time. Error = actual - nominal; both curves have no line over the range.
"""

from __future__ import annotations

import math
from collections.abc import Hashable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, ClassVar

import numpy as np
from numpy.typing import ArrayLike, NDArray

from metrosep.core._arrays import FloatArray, as_float, frozen_float
from metrosep.core.blas import one_blas_thread
from metrosep.core.errors import (
    DataError,
    InvalidSamplesError,
    NotSeparableError,
    TooFewSamplesError,
)
from metrosep.core.numbers import real
from metrosep.core.provenance import Step, freeze_mapping
from metrosep.core.quantity import Quantity
from metrosep.core.runset import Run, RunSet
from metrosep.core.units import format_length
from metrosep.separation._readings import (
    as_numbers,
    checked_count,
    checked_sd,
    known_parts,
    part_of,
    plain,
    reduced,
    stated_u,
)
from metrosep.separation.contract import Separation, SeparationMethod, Unobservable
from metrosep.separation.runs.base import ErrorEstimate
from metrosep.separation.runs.entry import separate
from metrosep.separation.runs.options import metres

_WAYS = {"forward": 1, "reverse": -1}

_LINE = "the offset of each run is free, and the line is the alignment: slope holds it"
_TIED = (
    "what is tied to position at every feedrate is geometry here: form of the artefact, ball "
    "passage, cogging, a temperature that follows the position; a reversal tells the artefact"
)
_LOCKED = (
    "the feedrates move a vibration by less than the resolution of the fastest run: one that is "
    "locked to the start of the runs looks like the error; use feedrates further apart"
)
_ONE_FEED = (
    "at one feedrate a vibration locked to the start of the runs looks like the error at its "
    "wavelength; add runs at another feedrate"
)
_ARTEFACT = "it adds to the error at every feedrate alike; measure it by a reversal"
_OFFSET = (
    "zero of the sensor, mean of the error and lost motion share the level of a run; a fixed datum "
    "would tell them"
)
_TILT = (
    "a tilted artefact and a tilted axis read alike; measure the tilt against another reference"
)
_NOT_RUN = "no run goes this way; add runs in this direction"

_SAMPLES_PER_WAVE = 2.5
"""Shortest wavelength in pitches, as `separate_joint` has it."""

_MORE_THAN_STATED = 1.5
"""Scatter over the stated uncertainty from which it is told."""


@dataclass(frozen=True, slots=True)
class JointSeparation(SeparationMethod):
    """Runs of one axis at several feedrates, triggered by position.

    Parameters
    ----------
    x : tuple of float, m
        Positions of the readings, rising, the same for all runs; they are the evaluation range.
    feeds : tuple of float, m/s
        Of each run, > 0.
    directions : tuple of {"forward", "reverse"}, optional
        Of each run; all forward if omitted.
    shortest : float, m, optional
        Shortest wavelength of the model; chosen by evidence if omitted.
    min_feeds : int, optional
        Feedrates that each direction needs; 1 accepts that random vibration is only averaged.

    Raises
    ------
    NotSeparableError
        If a direction has fewer feedrates than `min_feeds`.
    InvalidSamplesError
        If the positions do not rise, or a feed is not positive.
    TooFewSamplesError
        If there are fewer than three positions.
    UnitError
        If `shortest` cannot be meant in m.
    DataError
        If there are no runs, or a direction is unknown or not stated for each run.

    Examples
    --------
    >>> import numpy as np
    >>> x = np.linspace(0.0, 30e-3, 121)
    >>> method = JointSeparation(tuple(x.tolist()), (0.05, 0.08, 0.05, 0.08))
    >>> wave = 2e-7 * np.cos(2 * np.pi * x / 7.5e-3)
    >>> noise = 2e-9 * np.random.default_rng(1).standard_normal((4, x.size))
    >>> found = method.separate(method.simulate({"slope": 1e-5}, {"forward": wave}) + noise)
    >>> bool(np.std(found.forward - wave) < 10e-9), bool(np.isnan(found.artefact).all())
    (True, True)
    """

    x: tuple[float, ...]
    feeds: tuple[float, ...]
    directions: tuple[str, ...] | None = None
    shortest: float | None = None
    min_feeds: int = 2

    name: ClassVar[str] = "joint"
    truth_parts: ClassVar[tuple[str, ...]] = ("artefact", "slope", "offset")
    error_parts: ClassVar[tuple[str, ...]] = ("forward", "reverse")

    def __post_init__(self) -> None:
        at = frozen_float(self.x, name="x", ndim=1, min_size=3)
        if not (np.diff(at) > 0.0).all():
            raise InvalidSamplesError(
                f"{self.name}: the positions must be finite and rising, whatever the direction of "
                "the runs; reverse rows are given in the same order"
            )
        frozen_float(self.feeds, name="feeds", ndim=1, min_size=1)
        metres(self.shortest, "shortest")
        least = checked_count(self.min_feeds, "min_feeds")
        ways = self._ways()
        if len(ways) != len(self.feeds) or not set(ways) <= set(_WAYS):
            raise DataError(
                f"{self.name}: directions are 'forward' or 'reverse', one for each of the "
                f"{len(self.feeds)} feeds, got {self.directions!r}"
            )
        runs = self._runs(np.zeros((len(self.feeds), len(self.x))))
        for way, sign in self._measured().items():
            feeds = runs.select(direction=sign).feeds
            if len(feeds) < least:
                raise NotSeparableError(
                    f"{self.name}: the {way} runs have {len(feeds)} feedrate{'' if len(feeds) == 1 else 's'}, {least} are needed:"
                    " a vibration and an error of the same wavelength look alike at one feedrate; "
                    "add runs at another, or accept averaging with min_feeds=1"
                )

    def _ways(self) -> tuple[str, ...]:
        return ("forward",) * len(self.feeds) if self.directions is None else self.directions

    def _measured(self) -> dict[str, int]:
        return {way: sign for way, sign in _WAYS.items() if way in self._ways()}

    def _runs(self, readings: FloatArray) -> RunSet:
        x = np.array(self.x, dtype=np.float64)
        runs = []
        for i, (row, feed, way) in enumerate(zip(readings, self.feeds, self._ways(), strict=True)):
            if not (math.isfinite(feed) and feed > 0.0):
                raise InvalidSamplesError(
                    f"{self.name}: the feed of run {i} is {feed} m/s; it must be positive and finite"
                )
            step = _WAYS[way]
            at, z = x[::step], row[::step]
            runs.append(Run(at, z, t=np.abs(at - at[0]) / feed, feed=feed, run_id=f"{i}"))
        return RunSet(runs)

    def simulate(
        self, truth: Mapping[str, ArrayLike], errors: Mapping[str, ArrayLike]
    ) -> FloatArray:
        """Return the readings of given parts.

        Parameters
        ----------
        truth : mapping of str to array_like
            ``artefact``, shape (n_x,), m: its form; ``slope``, scalar, rad: its alignment, zero in
            the middle of the range; ``offset``, shape (n_runs,), m: level of each run.
        errors : mapping of str to array_like, shape (n_x,), m
            ``forward`` and ``reverse``: the error at the positions, by direction of travel.

        Returns
        -------
        ndarray, shape (n_runs, n_x), m
            Readings in the order of the positions, whatever the direction.

        Raises
        ------
        DataError
            If a part is unknown, none is given, of another shape, or of a direction without runs.
        """
        parts = known_parts(self, truth, errors)
        x = np.array(self.x, dtype=np.float64)
        curves = {way: part_of(parts, way, x.shape, self.name) for way in _WAYS}
        for way in set(_WAYS) - set(self._measured()):
            if np.isfinite(curves[way]).all() and curves[way].any():
                raise DataError(f"{self.name}: no run goes {way}, so its error is not measured")
        artefact = part_of(parts, "artefact", x.shape, self.name)
        offset = part_of(parts, "offset", (len(self.feeds),), self.name)
        tilt = part_of(parts, "slope", (), self.name) * (x - 0.5 * (x[0] + x[-1]))
        moved = np.array([curves[way] for way in self._ways()])
        return np.asarray(moved + artefact + tilt + offset[:, np.newaxis])

    def null_space(self) -> tuple[Unobservable, ...]:
        """Return what runs at these feedrates cannot tell.

        Returns
        -------
        tuple of Unobservable
            Offset and line, what is tied to position, wavelengths at which a locked vibration is
            not told from the error, wavelengths too short for the pitch, the artefact, the offsets,
            and a direction without runs.
        """
        found = []
        for way in _WAYS:
            if way not in self._measured():
                found.append(Unobservable(way, "term", ("all of it",), _NOT_RUN))
                continue
            found += [
                Unobservable(way, "polynomial", (0, 1), _LINE),
                Unobservable(way, "term", ("tied to position",), _TIED),
                *self._wavelengths(way),
            ]
        return (
            *found,
            Unobservable("artefact", "term", ("all of it",), _ARTEFACT),
            Unobservable("offset", "term", ("all of it",), _OFFSET),
            Unobservable("slope", "term", ("tilt of the artefact",), _TILT),
        )

    def _wavelengths(self, way: str) -> tuple[Unobservable, Unobservable]:
        feeds = [f for f, w in zip(self.feeds, self._ways(), strict=True) if w == way]
        travel = self.x[-1] - self.x[0]
        pitch = travel / (len(self.x) - 1)
        runs = self._runs(np.zeros((len(self.feeds), len(self.x))))
        several = len(runs.select(direction=_WAYS[way]).feeds) > 1
        blind = travel * (1.0 - min(feeds) / max(feeds)) if several else 0.0
        locked = (
            Unobservable(way, "wavelength", (f"{format_length(blind)} and longer",), _LOCKED)
            if blind > 0.0
            else Unobservable(way, "wavelength", ("every wavelength",), _ONE_FEED)
        )
        floor = _SAMPLES_PER_WAVE * pitch if self.shortest is None else self.shortest
        short = Unobservable(
            way,
            "wavelength",
            (f"shorter than {format_length(floor)}",),
            "not in the model: the pitch of the readings or `shortest` bounds it; without evidence "
            "it ends at longer ones, see shortest_wavelength_mm in the audit",
        )
        return locked, short

    def separate(
        self,
        readings: ArrayLike,
        *,
        u_reading: float | None = None,
        history: tuple[Step, ...] = (),
    ) -> Separation:
        """Return the error of each direction and the alignment.

        Parameters
        ----------
        readings : array_like, shape (n_runs, n_x), m
            Rows in the order of the feeds, columns in that of the positions; NaN = not measured.
        u_reading : float, m, optional
            Standard uncertainty of one reading. It replaces nothing: the noise model of the fit
            gives u. A scatter well beyond it is reported.
        history : tuple of Step, optional
            Where they came from.

        Returns
        -------
        Separation
            Parts ``forward``, ``reverse`` (n_x,) without their line, NaN where no run of that
            direction was measured; ``slope``, the mean of the directions; ``artefact`` and
            ``offset``, NaN. The lost motion, which the offsets hide, is in the audit only.

        Raises
        ------
        DataError
            If `u_reading` is negative or no number.
        InvalidSamplesError
            If the readings are not numbers, infinite, or of another shape.
        NotUniformError, TooFewSamplesError
            If the positions are too uneven, or a run has fewer than 32 readings.
        UnitError
            If `shortest` is not a wavelength that the positions can show.

        Notes
        -----
        ``separate(runs, method="joint")`` does the work; it also takes runs sampled in time, which
        have positions of their own, and has the options for drift, lines, lag and probes. The
        noise is the RMS of the residuals over ``n - p`` readings, p the effective parameters; u of
        the parts holds its correlation in time, so is not that of white noise.
        """
        stated = stated_u(u_reading, "m")
        array = self._checked(readings)
        x = np.array(self.x, dtype=np.float64)
        estimate = separate(
            self._runs(array),
            start=float(x[0]),
            length=float(x[-1] - x[0]),
            shortest=self.shortest,
            min_feeds=self.min_feeds,
        )
        blank = np.full(x.size, np.nan)
        offset = np.full(len(self.feeds), np.nan)
        slope = estimate.slope
        parts = {"artefact": blank, "offset": offset, "slope": np.array(slope.value)}
        u = {"artefact": blank, "offset": offset}
        u["slope"] = np.array(math.nan if slope.u is None else slope.u)
        for way, sign in _WAYS.items():
            seen = ~np.isnan(array[[w == way for w in self._ways()]]).all(axis=0)
            known = seen & (way in self._measured())
            parts[way] = np.where(known, estimate.evaluate(x, direction=sign), np.nan)
            u[way] = np.where(known, estimate.sd(x, direction=sign), np.nan)
        noise = _noise(estimate, int((~np.isnan(array)).sum()))
        return Separation(
            self.name,
            parts,
            u,
            {**dict.fromkeys(parts, "m"), "slope": "rad"},
            {"x": x},
            self.null_space(),
            noise=noise,
            audit=_audit(estimate, stated),
            messages=(*estimate.messages, *_doubts(noise, stated)),
            history=(*history, *estimate.history),
        )

    def _like_readings(self, model: FloatArray, readings: FloatArray) -> FloatArray:
        """Return the model as it is: repeats are further runs."""
        return model

    def _checked(self, readings: ArrayLike) -> FloatArray:
        array = as_numbers(readings, f"{self.name} needs readings as numbers")
        shape = (len(self.feeds), len(self.x))
        if array.shape != shape:
            raise InvalidSamplesError(
                f"{self.name}: there are {shape[0]} runs and {shape[1]} positions; the readings "
                f"need the shape {shape}, got {array.shape}"
            )
        if np.isinf(array).any():
            run, i = np.argwhere(np.isinf(array))[0]
            raise InvalidSamplesError(
                f"{self.name}: reading {i} of run {run} is infinite; what was not measured is NaN"
            )
        return array


def _noise(estimate: ErrorEstimate, n_readings: int) -> Quantity:
    audits = [estimate.audit] if len(estimate.directions) == 1 else list(estimate.audit.values())
    free = n_readings - sum(float(a["effective_parameters"]) for a in audits)
    value = estimate.residual_rms * math.sqrt(n_readings / free) if free > 0.0 else math.nan
    text = "standard deviation of one reading about the estimate, vibration included (type A)"
    return Quantity(value, "m", text, symbol="s")


def _audit(estimate: ErrorEstimate, stated: float | None) -> dict[str, Any]:
    audit: dict[str, Any] = plain(estimate.audit)
    audit["residual_rms_nm"] = estimate.residual_rms * 1e9
    if stated is not None:
        audit["u_reading_stated_nm"] = stated * 1e9
    if estimate.lost_motion is not None:
        audit["lost_motion_nm"] = estimate.lost_motion.value * 1e9
        if estimate.lost_motion.u is not None:
            audit["u_lost_motion_nm"] = estimate.lost_motion.u * 1e9
    return audit


def _doubts(noise: Quantity, stated: float | None) -> tuple[str, ...]:
    if stated is None or not noise.value > _MORE_THAN_STATED * stated:
        return ()
    told = (
        f"the readings scatter by {format_length(noise.value)} about the estimate, u_reading says "
        f"{format_length(stated)}: there is vibration, or u_reading holds too little"
    )
    return (told,)


# ---- drift and the repeated quantities from one least-squares fit ------------------------------
# ``r_i = q[label_i] + d(t_i) + noise``; d is a polynomial or a cubic spline that is zero at the
# reference time, so q is the quantity as it would have been read then.

_WORST_CONDITION = 1e8


@dataclass(frozen=True, slots=True, eq=False, repr=False)
class JointDrift:
    """Quantities free of drift, and the drift.

    Parameters
    ----------
    labels : tuple
        Names of the quantities, in the order in which they first occur.
    values : ndarray, shape (labels, ...)
        Quantity at the reference time; NaN where it was never measured.
    u : ndarray, shape (labels, ...)
        Standard uncertainty of `values`.
    covariance : ndarray, shape (labels, labels)
        Of `values` for noise of unit standard deviation; differences need it, since all values
        share the drift. NaN for a label that was never measured. Where the gaps differ from point
        to point: that of readings without gaps.
    t : ndarray, shape (n,), s
        Times of the readings.
    drift : ndarray, shape (n, ...)
        Drift at `t`, zero at the reference time.
    u_drift : ndarray, shape (n, ...)
        Its standard uncertainty.
    residual : ndarray, shape (n, ...)
        Reading minus fit, NaN where not measured.
    sd : ndarray, shape (...)
        Standard deviation of one reading: from the residuals, else the one given, else NaN.
    reference : float, s
        Where the drift is zero.
    audit : mapping
        Model, counts, degrees of freedom.
    messages : tuple of str
        What the user should know.
    covariances : ndarray, shape (patterns, labels, labels), optional
        `covariance` of each pattern of gaps that occurs; without it `covariance` holds everywhere.
    pattern : ndarray of int, shape (...), optional
        Which of `covariances` holds at each point.
    """

    labels: tuple[Hashable, ...]
    values: FloatArray
    u: FloatArray
    covariance: FloatArray
    t: FloatArray
    drift: FloatArray
    u_drift: FloatArray
    residual: FloatArray
    sd: FloatArray
    reference: float
    audit: Mapping[str, Any] = field(default_factory=dict)
    messages: tuple[str, ...] = ()
    covariances: FloatArray | None = None
    pattern: NDArray[np.intp] | None = None

    def difference(self, first: Hashable, second: Hashable) -> tuple[FloatArray, FloatArray]:
        """Return one quantity minus another with its standard uncertainty.

        Parameters
        ----------
        first, second : hashable
            Labels.

        Returns
        -------
        tuple of (ndarray, ndarray), shape (...)
            Difference and u; the common drift is in u.

        Raises
        ------
        DataError
            If a label does not occur.
        """
        try:
            i, j = self.labels.index(first), self.labels.index(second)
        except ValueError:
            raise DataError(
                f"labels are {', '.join(map(str, self.labels))}, not {first!r} and {second!r}"
            ) from None
        c = self.covariance[None] if self.covariances is None else self.covariances
        variance = np.maximum(c[:, i, i] + c[:, j, j] - 2.0 * c[:, i, j], 0.0)
        root = np.sqrt(variance)[0 if self.pattern is None else self.pattern]
        return self.values[i] - self.values[j], np.asarray(self.sd * root)

    def to_dict(self) -> dict[str, Any]:
        """Return plain values for JSON, SI, NaN as None.

        Returns
        -------
        dict
            ``values``, ``u`` and ``differences`` (against the first label, each with ``value`` and
            ``u``) by label, ``t``, ``drift``, ``u_drift``, ``residual``, ``sd``, ``reference``,
            ``covariance``, ``audit``, ``messages``.
        """
        names = [str(label) for label in self.labels]
        differences = {}
        for label in self.labels[1:]:
            value, u = self.difference(label, self.labels[0])
            differences[f"{label}-{self.labels[0]}"] = {"value": value, "u": u}
        found: dict[str, Any] = plain(
            {
                "labels": names,
                "values": dict(zip(names, self.values, strict=True)),
                "u": dict(zip(names, self.u, strict=True)),
                "differences": differences,
                "t": self.t,
                "drift": self.drift,
                "u_drift": self.u_drift,
                "residual": self.residual,
                "sd": self.sd,
                "reference": self.reference,
                "covariance": self.covariance,
                "audit": self.audit,
                "messages": self.messages,
            }
        )
        return found

    def __reduce__(self) -> tuple[Any, ...]:
        return reduced(self)

    def __repr__(self) -> str:
        return (
            f"JointDrift({len(self.labels)} quantities, {self.t.size} readings, "
            f"{self.audit.get('model')})"
        )


def joint_drift(
    t: ArrayLike,
    readings: ArrayLike,
    labels: Sequence[Hashable] | None = None,
    *,
    degree: int = 1,
    n_pieces: int | None = None,
    reference: float | None = None,
    sd: float | None = None,
) -> JointDrift:
    """Return repeated quantities and the drift between them by least squares.

    Parameters
    ----------
    t : array_like, shape (n,), s
        Times, strictly increasing.
    readings : array_like, shape (n, ...)
        Scalars, profiles or maps; each point has its own drift. NaN where not measured.
    labels : sequence, shape (n,), optional
        What was measured at each time, such as ``"ABBA"``; one and the same if omitted.
    degree : int, optional
        Of the polynomial drift, 0 to 8; not used with `n_pieces`.
    n_pieces : int, optional
        Cubic spline drift with so many equal pieces, instead of the polynomial.
    reference : float, s, optional
        Time at which the drift is zero; the first reading if omitted.
    sd : float, optional
        Standard deviation of one reading. Without it, from the residuals.

    Returns
    -------
    JointDrift
        ``values``, ``u``, ``drift``, ``u_drift``, ``residual``, ``difference(a, b)``.

    Raises
    ------
    NotSeparableError
        If drift and quantities cannot be distinguished at these times and labels.
    TooFewSamplesError
        If there are fewer readings than unknowns.
    InvalidSamplesError
        If times do not increase, lengths differ, readings are not numbers or infinite, or labels
        are not names.
    DataError
        If degree, n_pieces, reference or sd is not a number or out of range.

    Notes
    -----
    Ordinary least squares: for white normal noise it attains the Cramer-Rao bound. A-B-B-A at equal
    steps with degree 1 gives `abba`. Null space: the level, which is why d is zero at the
    reference; changes that follow the labels. Gaps: each point is fitted to what was measured there.

    References
    ----------
    .. [1] ISO 230-3:2020 (drift); Gauss-Markov theorem.

    Examples
    --------
    >>> fit = joint_drift([0.0, 1.0, 2.0, 3.0], [7.0, 3.1, 3.2, 7.3], "ABBA")
    >>> round(float(fit.difference("A", "B")[0]), 9)
    4.0
    """
    times = _checked_times(t)
    table = _checked_readings(readings)
    names = _checked_labels(labels, times.size)
    if not table.ndim or table.shape[0] != times.size or len(names) != times.size:
        raise InvalidSamplesError(
            f"t has {times.size} times, readings shape {table.shape}, labels {len(names)}: one "
            "reading and one label for each time"
        )
    if np.isinf(table).any():
        raise InvalidSamplesError("a reading is infinite; write NaN where nothing was measured")
    sd = checked_sd(sd)
    zero = float(times[0]) if reference is None else real(reference, "reference", dimension="time")
    drift_design, model = _drift_design(times, zero, degree, n_pieces)
    known = tuple(dict.fromkeys(names))
    which = np.array([[name == k for k in known] for name in names], dtype=np.float64)
    design = np.hstack([which, drift_design])
    flat = table.reshape(times.size, -1)
    with one_blas_thread():
        parts = _solve(design, flat, len(known), sd)
    shape = table.shape[1:]
    return JointDrift(
        labels=known,
        values=parts["values"].reshape(len(known), *shape),
        u=parts["u"].reshape(len(known), *shape),
        covariance=(
            parts["covariances"][0]
            if parts["covariances"].shape[0] == 1
            else np.linalg.pinv(design.T @ design)[: len(known), : len(known)]
        ),
        t=times,
        drift=parts["drift"].reshape(table.shape),
        u_drift=parts["u_drift"].reshape(table.shape),
        residual=parts["residual"].reshape(table.shape),
        sd=parts["sd"].reshape(shape),
        reference=zero,
        audit=freeze_mapping(
            {
                "model": model,
                "n_readings": int(times.size),
                "n_unknowns": int(design.shape[1]),
                "reference_s": zero,
                "n_not_measured": int(np.count_nonzero(np.isnan(table))),
                "sd": "given" if sd is not None else "residuals",
            }
        ),
        messages=_messages(table, design, sd, parts),
        covariances=parts["covariances"],
        pattern=parts["pattern"].astype(np.intp).reshape(shape),
    )


def _checked_readings(readings: ArrayLike) -> FloatArray:
    try:
        return as_float(readings)
    except (TypeError, ValueError) as exc:
        raise InvalidSamplesError(
            f"readings must be numbers, or arrays of one shape, one for each time: {exc}"
        ) from None


def _checked_labels(labels: Sequence[Hashable] | None, n: int) -> list[Hashable]:
    if labels is None:
        return ["all"] * n
    try:
        names = list(labels)
        hash(tuple(names))
    except TypeError:
        raise InvalidSamplesError(
            "labels must be one name for each time, such as 'ABBA' or a list of names, got "
            f"{labels!r}"
        ) from None
    return names


def _checked_times(t: ArrayLike) -> FloatArray:
    times = frozen_float(t, name="t", ndim=1, min_size=2)
    if np.isnan(times).any() or (np.diff(times) <= 0.0).any():
        raise InvalidSamplesError("t must be finite and strictly increasing, in seconds")
    return times


def _drift_design(
    times: FloatArray, zero: float, degree: int, n_pieces: int | None
) -> tuple[FloatArray, str]:
    """Return columns of the drift, each zero at the reference time."""
    if not times[0] <= zero <= times[-1]:
        raise DataError(
            f"reference = {zero:g} s lies outside the readings, {times[0]:g} to {times[-1]:g} s"
        )
    both = np.append(times, zero)
    span = float(times[-1] - times[0])
    if n_pieces is None:
        degree = checked_count(degree, "degree")
        if degree > 8:
            raise DataError(f"degree of the drift is 0 to 8, got {degree}; use n_pieces for more")
        s = 2.0 * (both - times[0]) / span - 1.0
        columns = np.polynomial.legendre.legvander(s, degree)[:, 1:]
        name = f"polynomial of degree {degree}"
    else:
        from scipy.interpolate import BSpline

        n_pieces = checked_count(n_pieces, "n_pieces", low=1)
        inner = np.linspace(times[0], times[-1], n_pieces + 1)
        knots = np.concatenate([[times[0]] * 3, inner, [times[-1]] * 3])
        # The splines sum to one: without the first they hold no constant.
        columns = BSpline.design_matrix(both, knots, 3).toarray()[:, 1:]
        name = f"cubic spline of {n_pieces} pieces"
    return np.asarray(columns[:-1] - columns[-1]), name


def _solve(
    design: FloatArray, flat: FloatArray, n_labels: int, sd: float | None
) -> dict[str, FloatArray]:
    """Fit every column of readings to the rows that were measured."""
    n, p = design.shape
    points = flat.shape[1]
    out = {
        "values": np.full((n_labels, points), np.nan),
        "u": np.full((n_labels, points), np.nan),
        "drift": np.full((n, points), np.nan),
        "u_drift": np.full((n, points), np.nan),
        "residual": np.full((n, points), np.nan),
        "sd": np.full(points, np.nan),
    }
    valid = ~np.isnan(flat)
    if valid.all():
        patterns, member = np.ones((1, n), dtype=bool), np.zeros(points, dtype=np.intp)
    else:
        patterns, member = np.unique(valid.T, axis=0, return_inverse=True)
    out["pattern"] = np.asarray(member.ravel(), dtype=np.float64)
    out["covariances"] = np.full((patterns.shape[0], n_labels, n_labels), np.nan)
    solved = False
    for k, rows in enumerate(patterns):
        mine = np.flatnonzero(member.ravel() == k)
        seen = np.append(design[rows, :n_labels].any(axis=0), np.ones(p - n_labels, dtype=bool))
        part = design[np.ix_(rows, seen)]
        problem = _problem(part)
        if problem:
            if patterns.shape[0] == 1:
                raise problem
            continue
        solved = True
        inverse = np.linalg.pinv(part)
        found = inverse @ flat[np.ix_(rows, mine)]
        residual = flat[np.ix_(rows, mine)] - part @ found
        freedom = part.shape[0] - part.shape[1]
        spread = np.full(mine.size, np.nan if sd is None else sd)
        if sd is None and freedom > 0:
            spread = np.sqrt(np.einsum("ij,ij->j", residual, residual) / freedom)
        root = np.sqrt(np.einsum("ij,ij->i", inverse, inverse))
        n_seen = int(seen[:n_labels].sum())
        known = np.flatnonzero(seen[:n_labels])
        out["covariances"][k][np.ix_(known, known)] = inverse[:n_seen] @ inverse[:n_seen].T
        out["values"][np.ix_(seen[:n_labels], mine)] = found[:n_seen]
        out["u"][np.ix_(seen[:n_labels], mine)] = root[:n_seen, None] * spread
        out["drift"][:, mine] = design[:, n_labels:] @ found[n_seen:]
        lever = np.sqrt(((design[:, n_labels:] @ inverse[n_seen:]) ** 2).sum(axis=1))
        out["u_drift"][:, mine] = lever[:, None] * spread
        out["residual"][np.ix_(rows, mine)] = residual
        out["sd"][mine] = spread
    if not solved:
        raise TooFewSamplesError("at no point are there enough readings for drift and quantities")
    return out


def _problem(design: FloatArray) -> Exception | None:
    n, p = design.shape
    if n < p:
        return TooFewSamplesError(
            f"{n} readings for {p} unknowns; repeat the quantities or lower the order of the drift"
        )
    scale = np.maximum(np.sqrt((design**2).sum(axis=0)), np.finfo(float).tiny)
    if np.linalg.cond(design / scale) > _WORST_CONDITION:
        return NotSeparableError(
            "drift and quantities cannot be distinguished: return to a quantity that was measured "
            "before (A-B-B-A), or lower the order of the drift"
        )
    return None


def _messages(
    table: FloatArray, design: FloatArray, sd: float | None, parts: Mapping[str, FloatArray]
) -> tuple[str, ...]:
    said = []
    found = ~np.isnan(parts["values"]).all(axis=0)
    alone = int(np.count_nonzero(found & np.isnan(parts["sd"])))
    if sd is None and design.shape[0] == design.shape[1]:
        said.append("no redundancy and no sd=: there is no uncertainty; add a reading")
    elif alone:
        said.append(f"{alone} point(s) have no redundancy left by the gaps: no uncertainty there")
    missing = int(np.count_nonzero(np.isnan(table)))
    if missing:
        said.append(f"{missing} of {table.size} readings were not measured: omitted")
    lost = int(np.count_nonzero(np.isnan(parts["values"]).any(axis=0)))
    if lost:
        said.append(f"{lost} point(s) have too few readings for a quantity: NaN")
    return tuple(said)
