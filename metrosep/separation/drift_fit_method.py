"""`DriftFit`: quantities measured again and again, and the drift, from one least-squares fit.

``reading_i = value[label_i] + drift(t_i)``; the drift is zero at the reference time.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import ClassVar

import numpy as np
from numpy.typing import ArrayLike

from metrosep.core._arrays import FloatArray
from metrosep.core.errors import InvalidSamplesError
from metrosep.core.provenance import Step
from metrosep.core.quantity import Quantity
from metrosep.separation._method_parts import known_parts, part_of, stated_u
from metrosep.separation._readings import NOISE_UNKNOWN, as_numbers
from metrosep.separation.contract import Separation, SeparationMethod
from metrosep.separation.joint_fit import JointDrift, joint_drift
from metrosep.separation.null_space import Unobservable

__all__ = ["DriftFit"]


_LEVEL = "drift and quantities share their zero: drift is counted from the reference time"
_FOLLOWS = "what changes in step with the labels looks like the quantities"


@dataclass(frozen=True, slots=True)
class DriftFit(SeparationMethod):
    """Readings at stated times of quantities with stated names.

    Parameters
    ----------
    t : tuple of float, s
        Times, rising.
    labels : tuple of str
        What was measured at each; ``tuple("ABBA")``.
    degree : int, optional
        Of the polynomial drift, 0 to 8.
    n_pieces : int, optional
        Cubic spline of so many pieces instead.
    reference : float, s, optional
        Where the drift is zero; the first time if omitted.

    Raises
    ------
    DataError
        If degree, pieces or reference are out of range.
    InvalidSamplesError
        If times do not rise, or there is not one label for each.
    NotSeparableError
        If drift and quantities cannot be told apart at these times and labels.
    TooFewSamplesError
        If there are fewer readings than unknowns.

    Examples
    --------
    >>> found = DriftFit((0.0, 1.0, 2.0, 3.0), tuple("ABBA")).separate([[7.0], [3.1], [3.2], [7.3]])
    >>> found.values.round(9).tolist(), found.drift.round(9).ravel().tolist()
    ([[7.0], [3.0]], [0.0, 0.1, 0.2, 0.3])
    """

    t: tuple[float, ...]
    labels: tuple[str, ...]
    degree: int = 1
    n_pieces: int | None = None
    reference: float | None = None

    name: ClassVar[str] = "joint_drift"
    truth_parts: ClassVar[tuple[str, ...]] = ("values",)
    error_parts: ClassVar[tuple[str, ...]] = ("drift",)

    def __post_init__(self) -> None:
        self._fit(np.zeros((len(self.t), 1)), None)

    def _fit(self, readings: FloatArray, sd: float | None) -> JointDrift:
        return joint_drift(
            self.t,
            readings,
            self.labels,
            degree=self.degree,
            n_pieces=self.n_pieces,
            reference=self.reference,
            sd=sd,
        )

    def simulate(
        self, truth: Mapping[str, ArrayLike], errors: Mapping[str, ArrayLike]
    ) -> FloatArray:
        """Return the readings of given parts.

        Parameters
        ----------
        truth : mapping of str to array_like, shape (n_labels, ...)
            ``values`` in the order in which the labels first occur.
        errors : mapping of str to array_like, shape (n_times, ...)
            ``drift`` at each time.

        Returns
        -------
        ndarray, shape (n_times, ...)
            Readings.

        Raises
        ------
        DataError
            If a part is unknown, none is given, or of another shape.
        """
        parts = known_parts(self, truth, errors)
        known = list(dict.fromkeys(self.labels))
        points = next(iter(parts.values())).shape[1:]
        values = part_of(parts, "values", (len(known), *points), self.name)
        drift = part_of(parts, "drift", (len(self.t), *points), self.name)
        return values[[known.index(label) for label in self.labels]] + drift

    def null_space(self) -> tuple[Unobservable, ...]:
        """Return what the fit cannot tell.

        Returns
        -------
        tuple of Unobservable
            The common level, and drift that follows the labels.
        """
        return (
            Unobservable("values", "term", ("in step with the labels",), _FOLLOWS),
            Unobservable("drift", "term", ("level",), _LEVEL),
        )

    def separate(
        self,
        readings: ArrayLike,
        *,
        u_reading: float | None = None,
        history: tuple[Step, ...] = (),
    ) -> Separation:
        """Return the quantities and the drift.

        Parameters
        ----------
        readings : array_like, shape (n_times, ...), m
            One reading (number, profile, map) for each time; NaN = not measured.
        u_reading : float, m, optional
            Standard uncertainty of one reading; the residuals at each point if omitted.
        history : tuple of Step, optional
            Where they came from.

        Returns
        -------
        Separation
            Parts ``values`` (n_labels, ...) at the reference time and ``drift`` (n_times, ...).

        Raises
        ------
        DataError
            If `u_reading` is negative or no number.
        InvalidSamplesError
            If the readings are no numbers, infinite, or not one for each time.
        TooFewSamplesError
            If no point has enough readings.

        Notes
        -----
        `joint_drift` does the work and has the covariance that differences need: all values share
        the drift. The noise is pooled over the points, u is that of each point.
        """
        stated = stated_u(u_reading, "m")
        array = as_numbers(readings, f"{self.name} needs readings as numbers")
        if array.ndim < 2 or array.shape[0] != len(self.t) or 0 in array.shape:
            raise InvalidSamplesError(
                f"{self.name}: there are {len(self.t)} times; the readings need the shape "
                f"({len(self.t)}, points), got {array.shape}"
            )
        fit = self._fit(array, stated)
        noise = _noise(fit, stated)
        messages = [m for m in fit.messages if "sd=" not in m]
        if math.isnan(noise.value):
            messages.append(NOISE_UNKNOWN)
        return Separation(
            self.name,
            {"values": fit.values, "drift": fit.drift},
            {"values": fit.u, "drift": fit.u_drift},
            {"values": "m", "drift": "m"},
            {"time": fit.t},
            self.null_space(),
            noise=noise,
            audit={**fit.audit, "labels": [str(label) for label in fit.labels]},
            messages=tuple(messages),
            history=(*history, Step(self.name, {"model": fit.audit["model"]})),
        )

    def _like_readings(self, model: FloatArray, readings: FloatArray) -> FloatArray:
        """Return the model as it is: repeats are further times."""
        return model


def _noise(fit: JointDrift, stated: float | None) -> Quantity:
    if stated is not None:
        return Quantity(stated, "m", "standard uncertainty of one reading, as stated", symbol="s")
    known = fit.sd[np.isfinite(fit.sd)]
    if not known.size:
        text = "standard deviation of one reading; not known"
        return Quantity(math.nan, "m", text, symbol="s")
    value = math.sqrt(float(np.mean(known**2)))
    freedom = fit.audit["n_readings"] - fit.audit["n_unknowns"]
    text = "standard deviation of one reading, from the residuals (type A)"
    u = value / math.sqrt(2.0 * freedom * known.size)
    return Quantity(value, "m", text, u=u, symbol="s")
