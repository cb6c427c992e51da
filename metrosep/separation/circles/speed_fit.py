"""`SpeedFit`: a polynomial in speed through one value of spindle tests, with confidence and peaks."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from metrosep.core._arrays import FloatArray
from metrosep.core.errors import DataError, DegenerateFitError, TooFewSamplesError
from metrosep.core.quantity import Quantity
from metrosep.core.units import format_engineering
from metrosep.separation._methods import StoredResult

__all__ = ["SpeedFit", "fit_values"]


_PEAK = 4.0
"""Residual in its standard deviations from which a speed is called a peak."""


@dataclass(frozen=True, slots=True, eq=False, repr=False)
class SpeedFit(StoredResult):
    """Polynomial in speed through one value; frozen.

    Parameters
    ----------
    symbol : str
        Which value of the table.
    values, u : ndarray, shape (n,), m or rad
        The value at each speed and its standard uncertainty (NaN where not known).
    powers : tuple of int
        Powers of the speed.
    coefficients : ndarray, shape (p,), unit per (rev/s)^power
        Of the powers.
    covariance : ndarray, shape (p, p)
        Of the coefficients, scaled by the residuals where these exceed the uncertainties.
    residual : ndarray, shape (n,), m or rad
        Value minus fit.
    degrees : int
        Degrees of freedom of the residuals.
    chi_squared : float
        Sum of squared residuals over their uncertainties; NaN where these are not known.
    p_fit : float
        Probability of a larger one if the polynomial is right; NaN where not known.
    peaks : tuple of float, rev/s
        Speeds whose value lies above the fit through the others by more than 4 standard
        deviations.
    unit : str
        Of the values.
    """

    symbol: str
    values: FloatArray
    u: FloatArray
    powers: tuple[int, ...]
    coefficients: FloatArray
    covariance: FloatArray
    residual: FloatArray
    degrees: int
    chi_squared: float
    p_fit: float
    peaks: tuple[float, ...]
    unit: str

    def __str__(self) -> str:
        terms = [self.coefficient(p) for p in self.powers]
        text = " + ".join(
            format_engineering(q.value, self.unit)
            if p == 0
            else f"({q.value:.4g} \u00b1 {q.u:.2g}) {self.unit} n^{p}"
            for p, q in zip(self.powers, terms, strict=True)
        )
        fit = "" if math.isnan(self.p_fit) else f", p of the fit {self.p_fit:.2g}"
        return f"{text}{fit}"

    def __repr__(self) -> str:
        return f"SpeedFit({self.symbol}, {self.values.size} values: {self})"

    def evaluate(self, speed: ArrayLike) -> FloatArray:
        """Return the fit.

        Parameters
        ----------
        speed : array_like, rev/s
            Where.

        Returns
        -------
        ndarray
            Of the shape of `speed`, in the unit of the values.
        """
        return _basis(np.asarray(speed, dtype=np.float64), self.powers) @ self.coefficients

    def half_width(self, speed: ArrayLike, *, confidence: float = 0.95) -> FloatArray:
        """Return the half width of the confidence interval of the fit.

        Parameters
        ----------
        speed : array_like, rev/s
            Where.
        confidence : float, 0 to 1, optional
            Two-sided.

        Returns
        -------
        ndarray
            Of the shape of `speed`; pointwise, Student's t.

        Raises
        ------
        DataError
            If the confidence does not lie between 0 and 1.
        """
        if not 0.0 < confidence < 1.0:
            raise DataError(f"confidence must lie between 0 and 1, got {confidence}")
        from scipy.special import stdtrit

        rows = _basis(np.asarray(speed, dtype=np.float64), self.powers)
        variance = np.einsum("...i,ij,...j->...", rows, self.covariance, rows)
        factor = float(stdtrit(self.degrees, 0.5 + 0.5 * confidence))
        return np.asarray(factor * np.sqrt(variance))

    def coefficient(self, power: int) -> Quantity:
        """Return one coefficient with its uncertainty.

        Parameters
        ----------
        power : int
            Power of the speed.

        Returns
        -------
        Quantity
            In the unit of the values times s^power.

        Raises
        ------
        DataError
            If the power is not in the fit.
        """
        if power not in self.powers:
            raise DataError(f"power {power} is not among {self.powers}")
        i = self.powers.index(power)
        unit = self.unit if power == 0 else f"{self.unit} s^{power}"
        return Quantity(
            float(self.coefficients[i]),
            unit,
            f"coefficient of speed^{power} (rev/s) of the {self.symbol} value",
            u=math.sqrt(float(self.covariance[i, i])),
            symbol=f"c{power}",
        )


def _basis(speed: FloatArray, powers: tuple[int, ...]) -> FloatArray:
    return np.stack([speed**p for p in powers], axis=-1)


def fit_values(
    name: str,
    speed: FloatArray,
    values: FloatArray,
    u: FloatArray,
    powers: tuple[int, ...],
    unit: str,
) -> SpeedFit:
    """Return the weighted least-squares polynomial through values of one kind.

    Parameters
    ----------
    name : str
        Symbol of the value.
    speed : ndarray, shape (n,), rev/s
        Rising.
    values, u : ndarray, shape (n,), m or rad
        Values and standard uncertainties; equal weights unless all u are positive.
    powers : tuple of int
        Of the speed.
    unit : str
        Of the values.

    Returns
    -------
    SpeedFit
        Coefficients, covariance, lack of fit, peaks.

    Raises
    ------
    TooFewSamplesError
        If there are not more values than powers.
    DegenerateFitError
        If there are fewer different speeds than powers.
    """
    degrees = values.size - len(powers)
    if degrees < 1:
        raise TooFewSamplesError(
            f"{values.size} recordings for {len(powers)} powers: need at least {len(powers) + 1}"
        )
    if np.unique(speed).size < len(powers):
        raise DegenerateFitError(
            f"{np.unique(speed).size} different speeds do not determine {len(powers)} powers"
        )
    known = bool((u > 0.0).all())
    weight = 1.0 / u if known else np.ones(values.size)
    scale = max(float(speed.max()), np.finfo(float).tiny) ** np.array(powers, dtype=np.float64)
    rows = weight[:, None] * _basis(speed, powers) / scale
    inverse = np.asarray(np.linalg.pinv(rows.T @ rows), dtype=np.float64)
    coefficients = inverse @ (rows.T @ (weight * values))
    rest: FloatArray = weight * values - rows @ coefficients
    rounding = 1e3 * float(np.finfo(float).eps) * float(np.abs(weight * values).max())
    squares = float(rest @ rest)
    factor = squares / degrees
    if known:
        factor = max(factor, 1.0)
    floor = max(1.0, rounding) if known else rounding
    peaks = _peaks(speed, rows, rest, inverse, degrees, floor=floor)
    p_fit = math.nan
    if known:
        from scipy.special import chdtrc

        p_fit = float(chdtrc(degrees, squares))
    for array in (values, u):
        array.setflags(write=False)
    return SpeedFit(
        symbol=name,
        values=values,
        u=u,
        powers=powers,
        coefficients=coefficients / scale,
        covariance=factor * inverse / np.outer(scale, scale),
        residual=rest / weight,
        degrees=degrees,
        chi_squared=squares if known else math.nan,
        p_fit=p_fit,
        peaks=peaks,
        unit=unit,
    )


def _peaks(
    speed: FloatArray,
    rows: FloatArray,
    rest: FloatArray,
    inverse: FloatArray,
    degrees: int,
    *,
    floor: float,
) -> tuple[float, ...]:
    """Return speeds whose residual, studentised without themselves, is beyond the limit.

    `floor` is the least standard deviation of a weighted residual.
    """
    if degrees < 3:
        return ()
    lever = np.einsum("ij,jk,ik->i", rows, inverse, rows)
    free = np.maximum(1.0 - lever, 1e-12)
    others = np.maximum(float(rest @ rest) - rest**2 / free, 0.0) / (degrees - 1)
    sd = np.maximum(np.sqrt(others), max(floor, np.finfo(float).tiny))
    return tuple(float(s) for s in speed[rest > _PEAK * sd * np.sqrt(free)])
