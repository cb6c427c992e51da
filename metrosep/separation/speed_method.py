"""`SpeedGrowth`: values of spindle tests at several speeds: what stays at rest, what grows.

``reading_i = at_rest + growth(n_i)`` with ``growth(n) = sum_p c_p n^p`` over the powers p > 0.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import ClassVar, Literal

import numpy as np
from numpy.typing import ArrayLike

from metrosep.core._arrays import FloatArray
from metrosep.core.errors import DataError, InvalidSamplesError, TooFewSamplesError
from metrosep.core.provenance import Step
from metrosep.core.quantity import Quantity
from metrosep.separation._method_parts import known_parts, part_of, stated_u
from metrosep.separation._readings import as_numbers
from metrosep.separation.contract import Separation, SeparationMethod
from metrosep.separation.null_space import Unobservable
from metrosep.separation.speed_fit import SpeedFit, fit_values
from metrosep.separation.speed_sweep import fit_speed_sweep

__all__ = ["SpeedGrowth"]


_LEVEL = "what is the same at every speed is counted as at_rest: growth is zero at standstill"
_ARTEFACT = "the form of the artefact is the same at every speed; take it out by a reversal"
_LAW = "a law of other powers, or a resonance, is shared out over the powers of the fit"
_NO_LEVEL = "the powers have no 0: nothing is taken to stay at rest; add 0 to the powers"

_DOUBT = 0.01
"""p of the lack of fit below which it is told, as `fit_speed_sweep` does."""


@dataclass(frozen=True, slots=True)
class SpeedGrowth(SeparationMethod):
    """Values at stated speeds, as a polynomial in speed.

    Parameters
    ----------
    speeds : tuple of float, rev/s
        Of each recording, in any order; repeats allowed.
    powers : tuple of int, optional
        Of the speed; (0, 2) is a constant and unbalance.
    unit : {"m", "rad"}, optional
        Of the readings.

    Raises
    ------
    TooFewSamplesError
        If there are not more recordings than powers.
    InvalidSamplesError
        If speeds are NaN or negative.
    DegenerateFitError
        If there are fewer different speeds than powers.
    UnitError
        If a speed is beyond 2000 rev/s: it was given in rev/min.
    DataError
        If the powers are not whole numbers from 0, each once, or the unit is another one.

    Examples
    --------
    >>> method = SpeedGrowth((10.0, 20.0, 30.0, 40.0))
    >>> readings = method.simulate({"at_rest": [2e-8]}, {"growth": [[1e-9], [4e-9], [9e-9], [16e-9]]})
    >>> found = method.separate(readings)
    >>> (found.at_rest * 1e9).round(6).tolist(), (found.growth * 1e9).round(6).ravel().tolist()
    ([20.0], [1.0, 4.0, 9.0, 16.0])
    """

    speeds: tuple[float, ...]
    powers: tuple[int, ...] = (0, 2)
    unit: Literal["m", "rad"] = "m"

    name: ClassVar[str] = "speed_sweep"
    truth_parts: ClassVar[tuple[str, ...]] = ("at_rest",)
    error_parts: ClassVar[tuple[str, ...]] = ("growth",)

    def __post_init__(self) -> None:
        if self.unit not in ("m", "rad"):
            raise DataError(f"{self.name}: unit is 'm' or 'rad', got {self.unit!r}")
        fit_speed_sweep(self.speeds, {"none": np.zeros(np.size(self.speeds))}, powers=self.powers)

    def simulate(
        self, truth: Mapping[str, ArrayLike], errors: Mapping[str, ArrayLike]
    ) -> FloatArray:
        """Return the readings of given parts.

        Parameters
        ----------
        truth : mapping of str to array_like, shape (n_values,), m or rad
            ``at_rest`` of each value.
        errors : mapping of str to array_like, shape (n_speeds, n_values), m or rad
            ``growth`` at each speed.

        Returns
        -------
        ndarray, shape (n_speeds, n_values), m or rad
            Readings.

        Raises
        ------
        DataError
            If a part is unknown, none is given, or of another shape.
        """
        parts = known_parts(self, truth, errors)
        points = parts["at_rest"].shape if "at_rest" in parts else parts["growth"].shape[1:]
        growth = part_of(parts, "growth", (len(self.speeds), *points), self.name)
        return np.asarray(part_of(parts, "at_rest", points, self.name) + growth)

    def null_space(self) -> tuple[Unobservable, ...]:
        """Return what values against speed cannot tell.

        Returns
        -------
        tuple of Unobservable
            The level of the growth, the form of the artefact, and laws of other powers.
        """
        found = [
            Unobservable("growth", "term", ("level",), _LEVEL),
            Unobservable("growth", "term", ("other powers",), _LAW),
            Unobservable("at_rest", "term", ("form of the artefact",), _ARTEFACT),
        ]
        if 0 not in self.powers:
            found.append(Unobservable("at_rest", "term", ("all of it",), _NO_LEVEL))
        return tuple(found)

    def separate(
        self,
        readings: ArrayLike,
        *,
        u_reading: float | None = None,
        history: tuple[Step, ...] = (),
    ) -> Separation:
        """Return what stays at rest and what grows with the speed.

        Parameters
        ----------
        readings : array_like, shape (n_speeds, n_values), m or rad
            One row for each speed, one column for each value: synchronous, asynchronous, or the
            cosine and the sine of one order with their signs. NaN = not measured.
        u_reading : float, m or rad, optional
            Standard uncertainty of one reading; the residuals of each value if omitted.
        history : tuple of Step, optional
            Where they came from.

        Returns
        -------
        Separation
            Parts ``at_rest`` (n_values,) and ``growth`` (n_speeds, n_values), zero at standstill.
            Values with fewer readings or speeds than the powers need are NaN; so is the growth
            where nothing was measured, and `at_rest` where the powers have no 0.

        Raises
        ------
        DataError
            If `u_reading` is negative or no number.
        InvalidSamplesError
            If the readings are no numbers, infinite, or not one row for each speed.
        TooFewSamplesError
            If no value has enough readings.

        Notes
        -----
        `fit_speed_sweep` has the same fit (`fit_values`) with confidence intervals, critical
        speeds and weights of each recording; it refuses negative widths, which are allowed here
        because components have signs. With `u_reading` the covariance is widened where the
        residuals exceed it, never narrowed. The noise is pooled over the values, u is that of each.
        """
        stated = stated_u(u_reading, self.unit)
        array = self._checked(readings)
        fits = self._fits(array, math.nan if stated is None else stated)
        if not any(fits):
            raise TooFewSamplesError(
                f"{self.name}: no value has readings at enough speeds: {len(self.powers)} powers "
                f"need {len(self.powers) + 1} readings at {len(self.powers)} speeds"
            )
        at_rest, growth, u_rest, u_growth = self._parts(array, fits)
        return Separation(
            self.name,
            {"at_rest": at_rest, "growth": growth},
            {"at_rest": u_rest, "growth": u_growth},
            {"at_rest": self.unit, "growth": self.unit},
            {"speed": np.array(self.speeds, dtype=np.float64)},
            self.null_space(),
            noise=self._noise([f for f in fits if f], stated),
            audit=self._audit(fits),
            messages=tuple(_said(fits)),
            history=(*history, Step(self.name, {"powers": list(self.powers)})),
        )

    def _like_readings(self, model: FloatArray, readings: FloatArray) -> FloatArray:
        """Return the model as it is: repeats are further speeds."""
        return model

    def _checked(self, readings: ArrayLike) -> FloatArray:
        array = as_numbers(readings, f"{self.name} needs readings as numbers")
        if array.ndim != 2 or array.shape[0] != len(self.speeds) or 0 in array.shape:
            raise InvalidSamplesError(
                f"{self.name}: there are {len(self.speeds)} speeds; the readings need the shape "
                f"({len(self.speeds)}, values), got {array.shape}"
            )
        if np.isinf(array).any():
            row, column = np.argwhere(np.isinf(array))[0]
            raise InvalidSamplesError(
                f"{self.name}: the reading of value {column} at {self.speeds[row]:.6g} rev/s is "
                "infinite; what was not measured is NaN"
            )
        return array

    def _fits(self, array: FloatArray, u: float) -> list[SpeedFit | None]:
        speeds = np.array(self.speeds, dtype=np.float64)
        order = np.argsort(speeds, kind="stable")
        fits: list[SpeedFit | None] = []
        for k, column in enumerate(array.T):
            used = order[~np.isnan(column[order])]
            enough = used.size > len(self.powers)
            enough = enough and np.unique(speeds[used]).size >= len(self.powers)
            values, sd = column[used], np.full(used.size, u)
            name = f"value {k}"
            fits.append(
                fit_values(name, speeds[used], values, sd, tuple(self.powers), self.unit)
                if enough
                else None
            )
        return fits

    def _parts(
        self, array: FloatArray, fits: list[SpeedFit | None]
    ) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:
        speeds = np.array(self.speeds, dtype=np.float64)
        growing = np.array([p > 0 for p in self.powers])
        powers = np.array(self.powers, dtype=np.float64)[growing]
        basis = speeds[:, np.newaxis] ** powers
        at_rest, u_rest = np.full((2, array.shape[1]), np.nan)
        growth, u_growth = np.full((2, *array.shape), np.nan)
        for k, fit in enumerate(fits):
            if fit is None:
                continue
            block = fit.covariance[np.ix_(growing, growing)]
            variance = np.einsum("ij,jk,ik->i", basis, block, basis)
            measured = ~np.isnan(array[:, k])
            growth[measured, k] = (basis @ fit.coefficients[growing])[measured]
            u_growth[measured, k] = np.sqrt(np.maximum(variance, 0.0))[measured]
            if not growing.all():
                zero = int(np.argmin(growing))
                at_rest[k] = fit.coefficients[zero]
                u_rest[k] = math.sqrt(max(float(fit.covariance[zero, zero]), 0.0))
        return at_rest, growth, u_rest, u_growth

    def _noise(self, fits: list[SpeedFit], stated: float | None) -> Quantity:
        if stated is not None:
            text = "standard uncertainty of one reading, as stated"
            return Quantity(stated, self.unit, text, symbol="s")
        degrees = sum(f.degrees for f in fits)
        value = math.sqrt(sum(float(f.residual @ f.residual) for f in fits) / degrees)
        text = "standard deviation of one reading, from the residuals (type A)"
        return Quantity(value, self.unit, text, u=value / math.sqrt(2.0 * degrees), symbol="s")

    def _audit(self, fits: list[SpeedFit | None]) -> dict[str, object]:
        def of(power: int, *, spread: bool) -> list[float | None]:
            terms = [None if f is None else f.coefficient(power) for f in fits]
            return [None if q is None else (q.u if spread else q.value) for q in terms]

        audit: dict[str, object] = {
            "n_recordings": len(self.speeds),
            "powers": list(self.powers),
            "degrees_of_freedom": [None if f is None else f.degrees for f in fits],
            "p_fit": [None if f is None or math.isnan(f.p_fit) else f.p_fit for f in fits],
            "peaks_rev_per_s": [[] if f is None else list(f.peaks) for f in fits],
        }
        for power in self.powers:
            unit = self.unit if power == 0 else f"{self.unit}_s{power}"
            audit[f"c{power}_{unit}"] = of(power, spread=False)
            audit[f"u_c{power}_{unit}"] = of(power, spread=True)
        return audit


def _said(fits: list[SpeedFit | None]) -> list[str]:
    said = []
    for k, fit in enumerate(fits):
        if fit is None:
            said.append(f"value {k} has readings at too few speeds: it is NaN")
            continue
        if fit.p_fit < _DOUBT:
            said.append(
                f"the polynomial does not describe value {k} (p = {fit.p_fit:.1g}): a resonance, "
                "or u_reading holds too little; u was widened"
            )
        if fit.peaks:
            at = ", ".join(f"{s:.4g}" for s in fit.peaks)
            said.append(f"value {k} stands out at {at} rev/s: a resonance is not in the powers")
    return said
