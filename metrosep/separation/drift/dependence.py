"""Drift against temperature and error motion against speed: coefficients with intervals."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, ClassVar

import numpy as np
from numpy.typing import ArrayLike, NDArray

from metrosep.core._arrays import FloatArray, as_float, frozen_float, same_length
from metrosep.core.docs import described_by
from metrosep.core.errors import (
    DataError,
    DegenerateFitError,
    InvalidSamplesError,
    TooFewSamplesError,
)
from metrosep.core.numbers import real
from metrosep.core.options import Option
from metrosep.core.quantity import Quantity
from metrosep.separation.contract import NamedMethod, StoredResult


@dataclass(frozen=True, slots=True, eq=False, repr=False)
class Dependence(StoredResult):
    """A sum of powers fitted to readings, with intervals.

    Parameters
    ----------
    powers : tuple of int
        Powers of the variable in the model.
    coefficients : mapping of str to Quantity
        ``"c0"``, ``"c1"``, ... by power: SI, with standard uncertainty.
    intervals : mapping of str to tuple of (float, float)
        Interval of each coefficient at `confidence`.
    covariance : ndarray, shape (p, p)
        Of the coefficients in the order of `powers`.
    confidence : float
        Of the intervals.
    freedom : float
        Degrees of freedom behind the intervals; infinite where u was given.
    variable, values : ndarray, shape (n,)
        What was fitted.
    residual : ndarray, shape (n,)
        Readings minus fit; NaN where not measured.
    audit : mapping
        Model and counts.
    messages : tuple of str
        What the user should know.
    """

    powers: tuple[int, ...]
    coefficients: Mapping[str, Quantity]
    intervals: Mapping[str, tuple[float, float]]
    covariance: FloatArray
    confidence: float
    freedom: float
    variable: FloatArray
    values: FloatArray
    residual: FloatArray
    audit: Mapping[str, Any] = field(default_factory=dict)
    messages: tuple[str, ...] = ()

    def evaluate(self, variable: ArrayLike) -> FloatArray:
        """Return the fit.

        Parameters
        ----------
        variable : array_like, shape (k,)
            Speed or temperature, as in the fit.

        Returns
        -------
        ndarray, shape (k,)
            NaN outside the range that was measured: it is not extrapolated.
        """
        v, basis = self._basis(variable)
        c = np.array([self.coefficients[f"c{p}"].value for p in self.powers])
        return np.where(self._inside(v), basis @ c, np.nan)

    @described_by(evaluate)
    def half_width(self, variable: ArrayLike) -> FloatArray:
        """Return half the width of the interval of the fitted curve.

        Returns
        -------
        ndarray, shape (k,)
            At `confidence`, pointwise; NaN outside the range that was measured.
        """
        v, basis = self._basis(variable)
        u = np.sqrt(np.maximum(np.einsum("ij,jk,ik->i", basis, self.covariance, basis), 0.0))
        return np.where(self._inside(v), _coverage(self.confidence, self.freedom) * u, np.nan)

    def _basis(self, variable: ArrayLike) -> tuple[FloatArray, FloatArray]:
        v = frozen_float(variable, name="variable", ndim=1)
        return v, np.column_stack([v**p for p in self.powers])

    def _inside(self, v: FloatArray) -> NDArray[np.bool_]:
        low, high = float(np.nanmin(self.variable)), float(np.nanmax(self.variable))
        return np.asarray((v >= low) & (v <= high))

    def __repr__(self) -> str:
        return f"Dependence({', '.join(f'{k} {q}' for k, q in self.coefficients.items())})"


def speed_dependence(
    speed: ArrayLike,
    amplitude: ArrayLike,
    *,
    u: ArrayLike | float | None = None,
    powers: Sequence[int] = (0, 2),
    confidence: float = 0.95,
) -> Dependence:
    """Return how an amplitude of error motion grows with speed.

    Parameters
    ----------
    speed : array_like, shape (n,), 1/s (or rad/s, m/s)
        Spindle speed or feedrate, >= 0.
    amplitude : array_like, shape (n,), m
        Synchronous amplitude (or another value of the error motion) at each speed; NaN where not
        measured.
    u : array_like, shape (n,), or float, m, optional
        Standard uncertainty of each amplitude. Without it the scatter about the fit tells it.

    Returns
    -------
    Dependence
        ``coefficients["c0"]`` (at rest), ``["c2"]``, ...; ``intervals``; ``evaluate(speed)``,
        ``half_width(speed)``.

    Raises
    ------
    InvalidSamplesError
        If a speed is NaN or negative, lengths differ, or u is not a positive number.
    TooFewSamplesError
        If there are no more amplitudes than powers (with u: fewer).
    DegenerateFitError
        If the speeds do not tell the powers apart.
    DataError
        If powers are not whole numbers, repeat or are negative, or confidence is out of range.

    Notes
    -----
    Weighted least squares, intervals by Student's t. An amplitude is positive, so below about twice
    its u noise lifts it (Rice); resonances are not power law: look at the residuals. Not
    extrapolated.

    References
    ----------
    .. [1] ISO 230-7:2015, speed dependence of error motion; JCGM 100:2008.

    Examples
    --------
    >>> fit = speed_dependence([10.0, 20.0, 30.0, 40.0], [11e-9, 14e-9, 19e-9, 26e-9])
    >>> round(fit.coefficients["c0"].value * 1e9, 6), round(fit.coefficients["c2"].value * 1e12, 6)
    (10.0, 10.0)
    """
    v = frozen_float(speed, name="speed", ndim=1)
    if np.isnan(v).any() or (v < 0.0).any():
        raise InvalidSamplesError("a speed is NaN or negative; pass its magnitude")
    return _fit(v, amplitude, u, _powers(powers), confidence, "speed", correlated=False)


def drift_against_temperature(
    temperature: ArrayLike,
    displacement: ArrayLike,
    *,
    u: ArrayLike | float | None = None,
    confidence: float = 0.95,
) -> Dependence:
    """Return the drift per kelvin with its interval.

    Parameters
    ----------
    temperature : array_like, shape (n,), K (or degrees Celsius)
        Readings in the order of time, with those of the displacement; NaN where not measured.
    displacement : array_like, shape (n,), m
        Readings; NaN where not measured.
    u : array_like, shape (n,), or float, m, optional
        Standard uncertainty of each displacement, independent from one to the next. Without it,
        the residuals tell it, and their correlation in time widens the interval.

    Returns
    -------
    Dependence
        ``coefficients["c1"]`` in m/K with u, ``intervals["c1"]``; ``["c0"]`` at temperature 0.

    Raises
    ------
    InvalidSamplesError
        If lengths differ, nothing remains, or u is not positive.
    TooFewSamplesError
        If there are fewer than 3 readings.
    DegenerateFitError
        If the temperature did not change.
    DataError
        If confidence is out of range.

    Notes
    -----
    Straight line by least squares. Neighbouring residuals of a drift are alike: with the
    correlation rho of neighbours, n readings count as ``n (1 - rho) / (1 + rho)``. A displacement
    that lags behind the temperature shows as a loop; the coefficient is then too small.

    References
    ----------
    .. [1] ISO 230-3:2020; JCGM 100:2008, H.3.

    Examples
    --------
    >>> fit = drift_against_temperature([20.0, 20.5, 21.0, 21.5], [0.0, 1e-6, 2e-6, 3e-6])
    >>> round(fit.coefficients["c1"].value * 1e6, 9)
    2.0
    """
    t = frozen_float(temperature, name="temperature", ndim=1)
    return _fit(t, displacement, u, (0, 1), confidence, "temperature", correlated=u is None)


def _fit(
    variable: FloatArray,
    values: ArrayLike,
    u: ArrayLike | float | None,
    powers: tuple[int, ...],
    confidence: float,
    name: str,
    *,
    correlated: bool,
) -> Dependence:
    y = frozen_float(values, name="readings", ndim=1)
    same_length(**{name: variable, "readings": y})
    _check_model(powers, confidence)
    valid = ~np.isnan(y) & ~np.isnan(variable)
    n, p = int(valid.sum()), len(powers)
    if n < p + (u is None):
        raise TooFewSamplesError(
            f"{p} coefficients need {p + (u is None)} readings, got {n} valid; measure at more values "
            f"of {name}"
        )
    sd = _weights(u, y.size)[valid]
    scale = max(float(np.abs(variable[valid]).max()), np.finfo(float).tiny)
    centre = float(variable[valid].mean()) if powers == (0, 1) else 0.0
    basis = np.column_stack([((variable[valid] - centre) / scale) ** k for k in powers])
    if np.linalg.cond(basis / np.maximum(np.linalg.norm(basis, axis=0), 1e-300)) > 1e8:
        raise DegenerateFitError(
            f"the values of {name} do not tell the powers {powers} apart; spread them wider"
        )
    inverse = np.linalg.pinv(basis / sd[:, None])
    found = inverse @ (y[valid] / sd)
    rest = y[valid] - basis @ found
    covariance = inverse @ inverse.T
    freedom = math.inf
    said: list[str] = []
    if u is None:
        freedom = float(n - p)
        covariance = covariance * float(rest @ rest) / freedom
        if correlated:
            covariance, freedom, said = _widened(covariance, rest, freedom, p)
    back = np.diag([scale**-k for k in powers])
    if powers == (0, 1):
        back[0, 1] = -centre / scale
    found, covariance = back @ found, back @ covariance @ back.T
    residual = np.full(y.size, np.nan)
    residual[valid] = rest
    return _result(
        powers, found, covariance, confidence, freedom, variable, y, residual, name, said
    )


def _powers(powers: Any) -> tuple[int, ...]:
    several = isinstance(powers, Sequence | np.ndarray) and not isinstance(powers, str)
    if not several or any(not isinstance(p, int | np.integer) for p in powers):
        raise DataError(f"powers must be whole numbers, such as (0, 2), got {powers!r}")
    return tuple(int(p) for p in powers)


def _check_model(powers: tuple[int, ...], confidence: float) -> None:
    if not powers or len(set(powers)) < len(powers) or min(powers) < 0:
        raise DataError(f"powers must be different and not negative, got {powers}")
    if not 0.5 <= real(confidence, "confidence", what="a number, 0.95 for 95 %") < 1.0:
        raise DataError(f"confidence must lie in 0.5 to 1 (0.95 is usual), got {confidence}")


def _weights(u: ArrayLike | float | None, n: int) -> FloatArray:
    if u is None:
        return np.ones(n)
    try:
        given = as_float(u)
    except (TypeError, ValueError):
        raise InvalidSamplesError(
            f"u must be one number or one for each reading, in m, got {u!r}"
        ) from None
    sd = np.array(np.broadcast_to(given, (n,)) if np.size(u) in (1, n) else [])
    if sd.size != n:
        raise InvalidSamplesError(f"u has {np.size(u)} values for {n} readings")
    if not (np.isfinite(sd).all() and (sd > 0.0).all()):
        raise InvalidSamplesError("u must be finite and positive")
    return sd


def _widened(
    covariance: FloatArray, rest: FloatArray, freedom: float, p: int
) -> tuple[FloatArray, float, list[str]]:
    """Return covariance and freedom for residuals that are alike from one to the next."""
    power = float(rest @ rest)
    if power == 0.0 or rest.size < 8:
        return covariance, freedom, []
    rho = min(max(float(rest[1:] @ rest[:-1]) / power, 0.0), 0.99)
    # The estimate is too small by about (1 + 4 rho) / n (Kendall).
    rho = (
        min(rho + (1.0 + 4.0 * rho) / rest.size, 0.99) if rho > 2.0 / math.sqrt(rest.size) else 0.0
    )
    if rho == 0.0:
        return covariance, freedom, []
    factor = (1.0 + rho) / (1.0 - rho)
    effective = max(rest.size / factor - p, 1.0)
    text = (
        f"neighbouring residuals are alike (correlation {rho:.2f}): the {rest.size} readings count as "
        f"{rest.size / factor:.0f}"
    )
    return covariance * factor, effective, [text]


def _coverage(confidence: float, freedom: float) -> float:
    from scipy.stats import norm, t

    q = 0.5 + confidence / 2.0
    return float(norm.ppf(q) if math.isinf(freedom) else t.ppf(q, freedom))


def _result(
    powers: tuple[int, ...],
    found: FloatArray,
    covariance: FloatArray,
    confidence: float,
    freedom: float,
    variable: FloatArray,
    y: FloatArray,
    residual: FloatArray,
    name: str,
    said: list[str],
) -> Dependence:
    k = _coverage(confidence, freedom)
    per = {"speed": "1/s", "temperature": "K"}[name]
    coefficients, intervals = {}, {}
    for i, power in enumerate(powers):
        u = math.sqrt(max(float(covariance[i, i]), 0.0))
        unit = "m" if power == 0 else f"m/({per})^{power}" if power > 1 else f"m/({per})"
        text = f"coefficient of {name} to the power {power}"
        coefficients[f"c{power}"] = Quantity(float(found[i]), unit, text, u, f"c{power}")
        intervals[f"c{power}"] = (float(found[i]) - k * u, float(found[i]) + k * u)
    missing = int(np.isnan(residual).sum())
    if missing:
        said = [*said, f"{missing} of {y.size} readings were not measured: omitted"]
    return Dependence(
        powers=powers,
        coefficients=coefficients,
        intervals=intervals,
        covariance=covariance,
        confidence=confidence,
        freedom=freedom,
        variable=variable,
        values=y,
        residual=residual,
        audit={
            "variable": name,
            "powers": list(powers),
            "n": int(y.size) - missing,
            "freedom": freedom,
        },
        messages=tuple(said),
    )


# ---- allan deviation: how long averaging pays before drift takes over --------------------------


_CONFIDENCE = Option("number", help="of the intervals, 0.95 is 95 %")


class OverSpeed(NamedMethod):
    """`speed_dependence` by its name."""

    name = "speed_dependence"
    what = "how an amplitude of error motion grows with speed"
    reads = "table"
    roles: ClassVar[Mapping[str, str]] = {"speed": "any", "amplitude": "length", "u": "length?"}
    arguments: ClassVar[Mapping[str, Option]] = {
        "powers": Option(
            "integers",
            help="powers of speed: (0, 2) is a geometric part and one that grows as a centrifugal "
            "force",
        ),
        "confidence": _CONFIDENCE,
    }


class OverTemperature(NamedMethod):
    """`drift_against_temperature` by its name."""

    name = "drift_against_temperature"
    what = "how a displacement follows a temperature"
    reads = "table"
    roles: ClassVar[Mapping[str, str]] = {
        "temperature": "any", "displacement": "length", "u": "length?",
    }  # fmt: skip
    arguments: ClassVar[Mapping[str, Option]] = {"confidence": _CONFIDENCE}


def allan_deviation(
    t: ArrayLike, z: ArrayLike, *, n_times: int = 30
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return averaging times, overlapping Allan deviation of a reading, and its uncertainty.

    Parameters
    ----------
    t : array_like, shape (n,), s
        Equally spaced times, n >= 4.
    z : array_like, shape (n,)
        Readings without gaps.
    n_times : int, optional
        About how many averaging times, spread over the logarithm.

    Returns
    -------
    tuple of (ndarray, ndarray, ndarray)
        tau in s; deviation in the unit of z; standard uncertainty (about ``dev / sqrt(2 n / m)``
        with n / m independent averages).

    Raises
    ------
    InvalidSamplesError
        If times are not equally spaced, lengths differ, or a reading is missing.
    TooFewSamplesError
        If there are fewer than 4 readings.

    Notes
    -----
    ``dev(tau)^2 = mean (zbar(t + tau) - zbar(t))^2 / 2`` with means over tau. White noise falls as
    ``sd sqrt(dt / tau)``; a linear drift rises as ``rate tau / sqrt 2``. The minimum is the longest
    averaging that pays.

    References
    ----------
    .. [1] D. W. Allan, Proc. IEEE 54 (1966) 221, two-sample variance.

    Examples
    --------
    >>> import numpy as np
    >>> tau, dev, _ = allan_deviation(np.arange(64.0), 1e-9 * np.arange(64.0))
    >>> bool(abs(dev[0] - 1e-9 / 2**0.5) < 1e-20)
    True
    """
    times = frozen_float(t, name="t", ndim=1)
    values = frozen_float(z, name="z", ndim=1)
    if times.size != values.size:
        raise InvalidSamplesError(f"t has {times.size} times, z has {values.size} readings")
    n = times.size
    if n < 4:
        raise TooFewSamplesError(f"an Allan deviation needs 4 readings, got {n}")
    if np.isnan(values).any():
        raise InvalidSamplesError(
            f"{int(np.isnan(values).sum())} readings are NaN: evaluate a stretch without gaps"
        )
    steps = np.diff(times)
    dt = float(times[-1] - times[0]) / (n - 1)
    if not (steps > 0.0).all() or float(np.abs(steps - dt).max()) > 1e-3 * dt:
        raise InvalidSamplesError("times are not equally spaced; resample the readings first")
    m = np.unique(np.round(np.geomspace(1, n // 3, max(int(n_times), 1))).astype(np.intp))
    total = np.concatenate([[0.0], np.cumsum(values - values.mean())])
    deviation = np.empty(m.size)
    for i, k in enumerate(m):
        means = (total[k:] - total[:-k]) / k
        second = means[k:] - means[:-k]
        deviation[i] = math.sqrt(float(second @ second) / second.size / 2.0)
    independent = np.maximum(n / m - 1.0, 1.0)
    return np.asarray(m * dt, dtype=np.float64), deviation, deviation / np.sqrt(2.0 * independent)
