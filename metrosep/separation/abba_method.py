"""`AbbaDrift`: two objects measured in the order A-B-B-A, and the drift between the readings.

``reading(t) = object(t) + level + rate t``. What is linear within a sequence drops out.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import ClassVar, Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray

from metrosep.core._arrays import FloatArray
from metrosep.core.errors import DataError, InvalidSamplesError
from metrosep.core.provenance import Step
from metrosep.core.quantity import Quantity
from metrosep.separation._checked_numbers import checked_count
from metrosep.separation._method_parts import known_parts, stated_u
from metrosep.separation._readings import NOISE_UNKNOWN, as_numbers
from metrosep.separation.alternation import DriftFreeDifference, abba
from metrosep.separation.contract import Separation, SeparationMethod
from metrosep.separation.null_space import Unobservable

__all__ = ["AbbaDrift"]


_IN_STEP = "what changes in step with the exchange of the objects looks like their difference"
_LEVEL = "the zero of drift and reading is arbitrary: only differences are free of it"
_CURVED = "drift that is not linear within a sequence reaches the difference: see quadratic_gain"


@dataclass(frozen=True, slots=True)
class AbbaDrift(SeparationMethod):
    """Sequences A-B-B-A of readings; each reading a number, a profile or a map.

    Parameters
    ----------
    n_sequences : int, optional
        How many, one after the other.
    order : {"ABBA", "BAAB"}, optional
        What was measured first.
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

    Examples
    --------
    >>> found = AbbaDrift().separate([[7.0], [3.1], [3.2], [7.3]])
    >>> found.difference.round(9).tolist(), found.drift_rate.round(9).tolist()
    ([4.0], [0.1])
    """

    n_sequences: int = 1
    order: Literal["ABBA", "BAAB"] = "ABBA"
    t: tuple[float, ...] | None = None

    name: ClassVar[str] = "abba"
    truth_parts: ClassVar[tuple[str, ...]] = ("difference",)
    error_parts: ClassVar[tuple[str, ...]] = ("drift_rate",)

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

    def simulate(
        self, truth: Mapping[str, ArrayLike], errors: Mapping[str, ArrayLike]
    ) -> FloatArray:
        """Return the readings of given parts, their mean level zero.

        Parameters
        ----------
        truth : mapping of str to array_like, shape (...)
            ``difference`` A - B.
        errors : mapping of str to array_like, shape (...)
            ``drift_rate``: change per second, per step where no times were given.

        Returns
        -------
        ndarray, shape (4 n_sequences, ...)
            In the order of time.

        Raises
        ------
        DataError
            If a part is unknown, none is given, or their shapes differ.
        """
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
        """Return what the sequence cannot tell.

        Returns
        -------
        tuple of Unobservable
            The level, changes in step with the exchange, and curved drift.
        """
        return (
            Unobservable("difference", "term", ("in step with A-B-B-A",), _IN_STEP),
            Unobservable("difference", "term", ("drift of higher degree",), _CURVED),
            Unobservable("drift_rate", "term", ("level",), _LEVEL),
        )

    def separate(
        self,
        readings: ArrayLike,
        *,
        u_reading: float | None = None,
        history: tuple[Step, ...] = (),
    ) -> Separation:
        """Return the difference and the drift.

        Parameters
        ----------
        readings : array_like, shape (4 n_sequences, ...), m
            In the order of time; NaN = not measured.
        u_reading : float, m, optional
            Standard uncertainty of one reading; the scatter of the sequences if omitted.
        history : tuple of Step, optional
            Where they came from.

        Returns
        -------
        Separation
            Parts ``difference`` and ``drift_rate``, shape (...).

        Raises
        ------
        DataError
            If `u_reading` is negative or no number.
        InvalidSamplesError
            If the readings are no numbers, infinite, not 4 for each sequence, or none was measured.

        Notes
        -----
        `abba` does the work. From sequences, u of the difference is their scatter at each point, as
        there; u of the rate takes the noise pooled over points. With `u_reading` s and n whole
        sequences of equal steps: ``s / sqrt(n)`` and ``s / sqrt(5 n)`` per step.
        """
        stated = stated_u(u_reading, "m")
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
    if stated is not None:
        return Quantity(stated, "m", "standard uncertainty of one reading, as stated", symbol="s")
    gain = np.sqrt((weights**2).sum(axis=1)).reshape(-1, *[1] * found.difference.ndim)
    rest = (found.each - found.difference) / gain
    count = (~np.isnan(found.each)).sum(axis=0)
    freedom = float(np.maximum(count - 1, 0).sum())
    if freedom < 1.0:
        text = "standard deviation of one reading; not known"
        return Quantity(math.nan, "m", text, symbol="s")
    value = math.sqrt(float(np.nansum(rest**2)) / freedom)
    text = f"standard deviation of one reading, from {found.each.shape[0]} sequences (type A)"
    return Quantity(value, "m", text, u=value / math.sqrt(2.0 * freedom), symbol="s")
