"""Differences of two objects measured in turn, so that drift cancels: A-B-B-A.

The reading is ``r(t) = object + drift(t)``; the result is A - B.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, ClassVar, Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray

from metrosep.core._arrays import FloatArray, as_float
from metrosep.core.errors import DataError, InvalidSamplesError, NotSeparableError
from metrosep.core.methods import Readings
from metrosep.core.options import Option, option
from metrosep.core.provenance import Step
from metrosep.core.quantity import Quantity
from metrosep.separation._readings import (
    NOISE_UNKNOWN,
    as_numbers,
    checked_count,
    checked_sd,
    known_parts,
)
from metrosep.separation.contract import (
    History,
    Parts,
    RecordedMethod,
    Separation,
    StoredResult,
    Unobservable,
    pooled,
)


@dataclass(frozen=True, slots=True, eq=False, repr=False)
class DriftFreeDifference(StoredResult):
    """A minus B of one or more A-B-B-A sequences.

    Parameters
    ----------
    difference : ndarray, shape (...)
        Mean over the sequences; NaN where a reading is missing in all of them.
    u : ndarray, shape (...)
        Standard uncertainty; NaN where nothing tells it.
    each : ndarray, shape (sequences, ...)
        Result of each sequence.
    drift_rate : ndarray, shape (...)
        Mean change per step (per second where times were given).
    weights : ndarray, shape (4,)
        Of the readings in one sequence; 1/2, -1/2, -1/2, 1/2 for equal steps.
    quadratic_gain : float
        What one unit of a quadratic drift ``c t^2`` adds to the difference: 2 dt^2 for equal steps
        dt (in steps where no times were given).
    audit : mapping
        Plain values.
    messages : tuple of str
        What the user should know.
    """

    difference: FloatArray
    u: FloatArray
    each: FloatArray
    drift_rate: FloatArray
    weights: FloatArray
    quadratic_gain: float
    audit: Mapping[str, Any] = field(default_factory=dict)
    messages: tuple[str, ...] = ()

    def __repr__(self) -> str:
        shape = (
            f"shape {self.difference.shape}" if self.difference.ndim else f"{self.difference:.6g}"
        )
        return f"DriftFreeDifference({shape}, {self.each.shape[0]} sequence(s))"


def abba(
    readings: ArrayLike | Sequence[ArrayLike],
    *,
    order: str = "ABBA",
    t: ArrayLike | None = None,
    sd: float | None = None,
) -> DriftFreeDifference:
    """Return A minus B from readings in the order A-B-B-A, free of linear drift.

    Parameters
    ----------
    readings : array_like, shape (4 s, ...)
        Scalars, profiles or maps in the order of time, s sequences one after the other. NaN where
        not measured.
    t : array_like, shape (4 s,), s, optional
        Times. Without them the steps are equal; with them the weights are such that linear drift
        cancels for any steps.
    sd : float, optional
        Standard deviation of one reading, unit of the readings: for the uncertainty of a single
        sequence. With two and more sequences their scatter is used.

    Returns
    -------
    DriftFreeDifference
        ``difference``, ``u``, ``each``, ``quadratic_gain``.

    Raises
    ------
    InvalidSamplesError
        If the number of readings is not a multiple of 4, shapes differ, times do not increase, or a
        reading is infinite or nothing was measured.
    NotSeparableError
        If the times leave drift and difference one quantity.
    DataError
        If `order` is not known or `sd` is not a number or negative.

    Notes
    -----
    ``A - B = (A1 + A2 - B1 - B2) / 2``: offset and linear drift cancel; a quadratic one, ``c t^2``,
    leaves ``2 c dt^2`` (positive: the outer readings are A). Noise: sd for one sequence.
    Null space: whatever changes in step with the exchange A-B-B-A.

    References
    ----------
    .. [1] ABBA weighing (substitution) cycle; formula derived.

    Examples
    --------
    >>> result = abba([7.0, 3.1, 3.2, 7.3])  # drift 0.1 per step
    >>> round(float(result.difference), 12), round(result.quadratic_gain, 12)
    (4.0, 2.0)
    """
    if order not in ("ABBA", "BAAB"):
        raise DataError(f"order is 'ABBA' or 'BAAB', got {order!r}")
    sd = checked_sd(sd)
    stack = _stack(readings)
    n_sequences = stack.shape[0] // 4
    times = _times(t, stack.shape[0])
    sign = np.array([1.0, -1.0, -1.0, 1.0]) * (1.0 if order == "ABBA" else -1.0)
    by_sequence = times.reshape(n_sequences, 4)
    weights = np.array([_weights(ts, sign) for ts in by_sequence])
    rates = np.array([_rate_weights(ts, sign) for ts in by_sequence])
    grouped = stack.reshape(n_sequences, 4, *stack.shape[1:])
    each = np.einsum("sj,sj...->s...", weights, grouped)
    rate = np.einsum("sj,sj...->s...", rates, grouped)
    centred = by_sequence - by_sequence.mean(axis=1, keepdims=True)
    return DriftFreeDifference(
        difference=_mean(each),
        u=_uncertainty(each, weights, sd),
        each=each,
        drift_rate=_mean(rate),
        weights=weights[0],
        quadratic_gain=float(np.mean(np.sum(weights * centred**2, axis=1))),
        audit={
            "order": order,
            "n_sequences": n_sequences,
            "times": "given" if t is not None else "equal steps",
        },
        messages=_messages(each, sd),
    )


def _stack(readings: ArrayLike | Sequence[ArrayLike]) -> FloatArray:
    try:
        stack = as_float(readings)
    except (TypeError, ValueError) as exc:
        raise InvalidSamplesError(
            f"readings must be arrays of one shape, one after the other: {exc}"
        ) from None
    if stack.ndim == 0 or stack.shape[0] == 0 or stack.shape[0] % 4:
        count = stack.shape[0] if stack.ndim else 1
        raise InvalidSamplesError(
            f"readings come in fours (A, B, B, A), got {count}; leave out an unfinished sequence"
        )
    if np.isinf(stack).any():
        raise InvalidSamplesError("a reading is infinite; write NaN where nothing was measured")
    if np.isnan(stack).all():
        raise InvalidSamplesError("no reading was measured: all are NaN")
    return stack


def _times(t: ArrayLike | None, count: int) -> FloatArray:
    if t is None:
        return np.arange(count, dtype=np.float64)
    try:
        times = as_float(t)
    except (TypeError, ValueError) as exc:
        raise InvalidSamplesError(f"t must be times in seconds: {exc}") from None
    if times.shape != (count,):
        raise InvalidSamplesError(f"t has shape {times.shape} for {count} readings")
    if not np.isfinite(times).all() or (np.diff(times) <= 0.0).any():
        raise InvalidSamplesError("t must be finite and strictly increasing, in seconds")
    return times


def _design(times: FloatArray, sign: FloatArray) -> FloatArray:
    """Offset, drift and half the difference; scaled so that times of any size do."""
    span = float(times[-1] - times[0])
    design = np.column_stack([np.ones(4), (times - times.mean()) / span, sign / 2.0])
    if np.linalg.cond(design) > 1e6:
        raise NotSeparableError(
            "at these times drift and difference look the same; keep the steps of A-B-B-A similar"
        )
    return design


def _weights(times: FloatArray, sign: FloatArray) -> FloatArray:
    return np.asarray(np.linalg.pinv(_design(times, sign))[2])


def _rate_weights(times: FloatArray, sign: FloatArray) -> FloatArray:
    return np.asarray(np.linalg.pinv(_design(times, sign))[1] / float(times[-1] - times[0]))


def _mean(values: FloatArray) -> FloatArray:
    count = np.count_nonzero(~np.isnan(values), axis=0)
    total = np.asarray(np.nansum(values, axis=0))
    return np.asarray(np.where(count > 0, total / np.maximum(count, 1), np.nan))


def _uncertainty(each: FloatArray, weights: FloatArray, sd: float | None) -> FloatArray:
    count = np.count_nonzero(~np.isnan(each), axis=0)
    if each.shape[0] > 1:
        squares = np.nansum((each - _mean(each)) ** 2, axis=0)
        degrees = np.maximum(count - 1, 1) * np.maximum(count, 1)
        return np.asarray(np.where(count > 1, np.sqrt(squares / degrees), np.nan))
    if sd is None:
        return np.full(each.shape[1:], np.nan)
    one = sd * float(np.sqrt(np.sum(weights[0] ** 2)))
    return np.asarray(np.where(count > 0, one, np.nan))


def _messages(each: FloatArray, sd: float | None) -> tuple[str, ...]:
    said = []
    if each.shape[0] == 1 and sd is None:
        said.append("one sequence and no sd=: there is no uncertainty; repeat the sequence")
    missing = int(np.count_nonzero(np.isnan(each)))
    if missing:
        said.append(
            f"{missing} of {each.size} differences lack a reading: NaN, omitted from the mean"
        )
    said.append("a drift that is not linear within a sequence remains: see quadratic_gain")
    return tuple(said)


# ---- `AbbaDrift`: two objects measured in the order A-B-B-A, and the drift between the readings ----
# ``reading(t) = object(t) + level + rate t``. What is linear within a sequence drops out.

_IN_STEP = "what changes in step with the exchange of the objects looks like their difference"
_LEVEL = "the zero of drift and reading is arbitrary: only differences are free of it"
_CURVED = "drift that is not linear within a sequence reaches the difference: see quadratic_gain"


def in_time(data: Readings) -> tuple[FloatArray, FloatArray | None]:
    """Return readings in the order of time, and times where there is a column of them.

    A column of time means that the rows follow each other in time, one number each; without it
    the columns do, each a curve over x.
    """
    if "time" not in data.extra:
        return data.values[:, 0], None
    if len(data.values) != 1 or data.values.shape[1] != 1:
        raise InvalidSamplesError(
            f"with a column of time there is one column of readings, got {len(data.values)}; for "
            'curves leave time out and give times = ["0 s", ...] in the step'
        )
    return data.values[0, 0], data.extra["time"][0]


@dataclass(frozen=True, slots=True)
class AbbaDrift(RecordedMethod):
    """Sequences A-B-B-A of readings; each reading a number, a profile or a map.

    Parameters
    ----------
    n_sequences : int, optional
        How many, one after the other.
    t : tuple of float, s, optional
        Times of all readings; equal steps if omitted.

    Raises
    ------
    DataError
        If the number is not at least 1 or the order unknown.
    InvalidSamplesError
        If the times are not finite and rising, or not 4 for each sequence.
    NotSeparableError
        If at these times drift and difference look the same.

    Notes
    -----
    Readings (4 n_sequences, ...) in m, in the order of time. Parts: ``difference`` A - B, and
    ``drift_rate``, change per second, per step where no times are given. `abba` does the work. From
    sequences, u of the difference is their scatter at each point, as there; u of the rate takes the
    noise pooled over points. With `u_reading` s and n whole sequences of equal steps:
    ``s / sqrt(n)`` and ``s / sqrt(5 n)`` per step.

    Examples
    --------
    >>> found = AbbaDrift().separate([[7.0], [3.1], [3.2], [7.3]])
    >>> found.difference.round(9).tolist(), found.drift_rate.round(9).tolist()
    ([4.0], [0.1])
    """

    n_sequences: int = 1
    order: Literal["ABBA", "BAAB"] = option(
        "ABBA", kind="text", choices=("ABBA", "BAAB"), help="order in which A and B were measured"
    )
    t: tuple[float, ...] | None = None

    name = "abba"
    what = "A minus B without drift; rows (with time) or columns in the order A B B A"
    roles: ClassVar[Mapping[str, str]] = {"time": "time?"}
    arguments: ClassVar[Mapping[str, Option]] = {
        "times": Option("times", help="of the columns; equal steps if omitted"),
        "sd": Option("uncertainty", help="standard deviation of one reading"),
    }
    truth_parts = ("difference",)
    error_parts = ("drift_rate",)

    @classmethod
    def from_inputs(cls, data: Readings, options: Mapping[str, Any]) -> DriftFreeDifference:
        """Return A minus B of rows or columns that follow each other in time."""
        rest = dict(options)
        readings, t = in_time(data)
        times = rest.pop("times", None)
        return abba(readings, t=times if t is None else t, **rest)

    def __post_init__(self) -> None:
        object.__setattr__(
            self, "n_sequences", checked_count(self.n_sequences, "n_sequences", low=1)
        )
        self._weights()

    @property
    def _times(self) -> FloatArray:
        return np.arange(4.0 * self.n_sequences) if self.t is None else np.array(self.t)

    def _weights(self) -> tuple[FloatArray, FloatArray]:
        """Return what each reading weighs in the difference and the rate of its own sequence."""
        unit = abba(np.tile(np.eye(4), (self.n_sequences, 1)), order=self.order, t=self.t)
        times = self._times.reshape(-1, 4)
        rates = [abba(np.eye(4), order=self.order, t=t).drift_rate for t in times]
        return unit.each, np.stack(rates)

    def simulate(self, truth: Parts, errors: Parts) -> FloatArray:
        parts = known_parts(self, truth, errors)
        shapes = {v.shape for v in parts.values()}
        if len(shapes) != 1:
            raise DataError(f"{self.name}: difference and drift_rate differ in shape: {shapes}")
        zero = np.zeros(shapes.pop())
        half = np.array([0.5, -0.5, -0.5, 0.5]) * (1.0 if self.order == "ABBA" else -1.0)
        sign = np.tile(half, self.n_sequences)
        t = self._times - self._times.mean()
        return np.asarray(
            np.multiply.outer(sign, parts.get("difference", zero))
            + np.multiply.outer(t, parts.get("drift_rate", zero))
        )

    def null_space(self) -> tuple[Unobservable, ...]:
        return (
            Unobservable("difference", "term", ("in step with A-B-B-A",), _IN_STEP),
            Unobservable("difference", "term", ("drift of higher degree",), _CURVED),
            Unobservable("drift_rate", "term", ("level",), _LEVEL),
        )

    def _solved(self, readings: ArrayLike, stated: float | None, history: History) -> Separation:
        array = as_numbers(readings, f"{self.name} needs readings as numbers")
        if array.ndim < 2 or array.shape[0] != 4 * self.n_sequences:
            raise InvalidSamplesError(
                f"{self.name}: {self.n_sequences} sequences hold {4 * self.n_sequences} readings, "
                f"as an array ({4 * self.n_sequences}, points), got the shape {array.shape}"
            )
        found = abba(array, order=self.order, t=self.t)
        weights, rates = self._weights()
        noise = _noise(found, weights, stated)
        counted = ~np.isnan(found.each)
        u_rate = noise.value * _root(rates, counted)
        u = found.u if stated is None else stated * _root(weights, counted)
        messages = [m for m in found.messages if "sd=" not in m]
        if math.isnan(noise.value):
            messages.append(NOISE_UNKNOWN)
        return Separation(
            self.name,
            {"difference": found.difference, "drift_rate": found.drift_rate},
            {"difference": u, "drift_rate": u_rate},
            {"difference": "m", "drift_rate": "m/step" if self.t is None else "m/s"},
            {},
            self.null_space(),
            noise=noise,
            audit={**found.audit, "quadratic_gain": found.quadratic_gain},
            messages=tuple(messages),
            history=(*history, Step(self.name, {"order": self.order})),
        )

    def _like_readings(self, model: FloatArray, readings: FloatArray) -> FloatArray:
        """Return the model as it is: repeats are further sequences."""
        return model


def _root(weights: FloatArray, counted: NDArray[np.bool_]) -> FloatArray:
    """Return sqrt of the sum of squared weights of the mean over the sequences that count."""
    squares = np.tensordot((weights**2).sum(axis=1), counted.astype(np.float64), axes=1)
    count = counted.sum(axis=0)
    return np.asarray(np.where(count > 0, np.sqrt(squares) / np.maximum(count, 1), np.nan))


def _noise(found: DriftFreeDifference, weights: FloatArray, stated: float | None) -> Quantity:
    gain = np.sqrt((weights**2).sum(axis=1)).reshape(-1, *[1] * found.difference.ndim)
    rest = (found.each - found.difference) / gain
    count = (~np.isnan(found.each)).sum(axis=0)
    freedom = float(np.maximum(count - 1, 0).sum())
    text = f"standard deviation of one reading, from {found.each.shape[0]} sequences (type A)"
    return pooled(float(np.nansum(rest**2)), freedom, stated, text)
