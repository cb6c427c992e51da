"""Error terms as functions of their axis position, each with its standard uncertainty.

Whatever has ``evaluate(x)`` and ``sd(x)`` is an error term: the classes here, and what
`metrosep.separation.separate` returns. Values are ``actual - nominal`` in m or rad, positions are
the axis positions `q` of the chain in m or rad. `ErrorSet` (`metrosep.machine.error_sets`) gathers
terms by their ISO 230-1 names.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any, Protocol, runtime_checkable

import numpy as np
from numpy.typing import ArrayLike

from metrosep.core._arrays import FloatArray, frozen_float
from metrosep.core.errors import DataError, InvalidSamplesError
from metrosep.machine._mesh import (
    finite_number,
    finite_vector,
    real_array,
    standard_uncertainty,
)
from metrosep.machine._term_sources import check_direction, error_of, refuse_no_term, series_of

__all__ = [
    "CallableTerm",
    "ConstantTerm",
    "ErrorTerm",
    "FourierTerm",
    "PolynomialTerm",
    "TableTerm",
    "as_term",
]

_ROUNDING = 1e-9  # of the span of a table; a position beyond its end by this is on the end


@runtime_checkable
class ErrorTerm(Protocol):
    """Anything with a value and a standard uncertainty at positions of its axis."""

    def evaluate(self, x: Any, /) -> Any:
        """Return the error at positions x."""

    def sd(self, x: Any, /) -> Any:
        """Return its standard uncertainty at positions x."""


@dataclass(frozen=True, slots=True)
class ConstantTerm:
    """Error that is the same at every position.

    Parameters
    ----------
    value : float, m or rad
        The error.
    u : float, m or rad, >= 0
        Its standard uncertainty; 0 takes the value as exact.

    Raises
    ------
    InvalidSamplesError
        A number is not finite, or u < 0.

    Examples
    --------
    >>> ConstantTerm(1e-6, u=1e-7).evaluate([0.0, 0.1]).tolist()
    [1e-06, 1e-06]
    """

    value: float
    u: float = 0.0

    def __post_init__(self) -> None:
        object.__setattr__(self, "value", finite_number(self.value, "value of a constant term"))
        object.__setattr__(self, "u", standard_uncertainty(self.u))

    def evaluate(self, x: ArrayLike) -> FloatArray:
        """Return the error at positions of the axis.

        Parameters
        ----------
        x : array_like, m or rad
            Axis positions.

        Returns
        -------
        ndarray, shape of x, m or rad
            Actual minus nominal.
        """
        return np.full(np.shape(x), self.value)

    def sd(self, x: ArrayLike) -> FloatArray:
        """Return the standard uncertainty at positions of the axis.

        Parameters
        ----------
        x : array_like, m or rad
            Axis positions.

        Returns
        -------
        ndarray, shape of x, m or rad
            One standard deviation.
        """
        return np.full(np.shape(x), self.u)


@dataclass(frozen=True, slots=True)
class PolynomialTerm:
    """Polynomial of the axis position, ``sum c_k x^k``.

    Parameters
    ----------
    coefficients : sequence of float, shape (n,), m/m^k or rad/m^k
        From the constant up.
    u : float, m or rad
        Standard uncertainty at every position.
    covariance : array_like, shape (n, n), optional
        Covariance of the coefficients, added to u^2.

    Raises
    ------
    InvalidSamplesError
        A number is not finite, u < 0, or the covariance is not (n, n), symmetric or non-negative.

    Examples
    --------
    >>> PolynomialTerm([0.0, 1e-5]).evaluate([0.0, 0.5]).tolist()
    [0.0, 5e-06]
    """

    coefficients: Sequence[float]
    u: float = 0.0
    covariance: ArrayLike | None = None

    def __post_init__(self) -> None:
        object.__setattr__(self, "coefficients", finite_vector(self.coefficients, "coefficients"))
        object.__setattr__(self, "u", standard_uncertainty(self.u))
        if self.covariance is not None:
            n = len(self.coefficients)
            matrix = frozen_float(self.covariance, name="covariance of coefficients", ndim=2)
            if matrix.shape != (n, n) or not np.isfinite(matrix).all():
                raise InvalidSamplesError(
                    f"the covariance of {n} coefficients must be finite and ({n}, {n}), "
                    f"got shape {matrix.shape}"
                )
            scale = float(np.abs(matrix).max())
            lowest = float(np.linalg.eigvalsh(0.5 * (matrix + matrix.T)).min())
            if np.abs(matrix - matrix.T).max() > 1e-9 * scale or lowest < -1e-9 * scale:
                raise InvalidSamplesError(
                    "the covariance of the coefficients must be symmetric without negative "
                    f"eigenvalues; its least one is {lowest:.3g}"
                )
            object.__setattr__(self, "covariance", matrix)

    def evaluate(self, x: ArrayLike) -> FloatArray:
        """Return the error at positions of the axis.

        Parameters
        ----------
        x : array_like, m or rad
            Axis positions.

        Returns
        -------
        ndarray, shape of x, m or rad
            Actual minus nominal.
        """
        value: FloatArray = np.polynomial.polynomial.polyval(
            real_array(x, "position of an error term"), np.asarray(self.coefficients)
        )
        return value

    def sd(self, x: ArrayLike) -> FloatArray:
        """Return the standard uncertainty at positions of the axis.

        Parameters
        ----------
        x : array_like, m or rad
            Axis positions.

        Returns
        -------
        ndarray, shape of x, m or rad
            One standard deviation.
        """
        positions = real_array(x, "position of an error term")
        if self.covariance is None:
            return np.full(positions.shape, self.u)
        powers = positions[..., None] ** np.arange(len(self.coefficients))
        variance = np.einsum("...i,ij,...j->...", powers, np.asarray(self.covariance), powers)
        result: FloatArray = np.sqrt(self.u**2 + np.maximum(variance, 0.0))
        return result


@dataclass(frozen=True, slots=True)
class FourierTerm:
    """Fourier series of the axis position, ``mean + sum a_k cos(2 pi (x - origin) / L_k + phi_k)``.

    Parameters
    ----------
    amplitudes : sequence of float, shape (n,), m or rad
        Peak amplitudes.
    wavelengths : sequence of float, shape (n,), m or rad, > 0
        Of a rotary axis: 2 pi / k for k undulations per revolution.
    phases : sequence of float, shape (n,), rad
        At the origin.
    mean : float, m or rad
        Constant part.
    u : float, m or rad
        Standard uncertainty at every position.
    origin : float, m or rad
        Position at which the phases hold. The spectrum of an estimate has them at its ``start``:
        `from_estimate` takes that over.

    Raises
    ------
    InvalidSamplesError
        Unequal lengths, a number that is not finite, a wavelength <= 0, or u < 0.

    Notes
    -----
    A series goes on beyond the travel that was measured; a table or an estimate refuses to.

    Examples
    --------
    >>> FourierTerm([1e-6], [0.01], [0.0]).evaluate([0.0, 0.005]).tolist()
    [1e-06, -1e-06]
    """

    amplitudes: Sequence[float]
    wavelengths: Sequence[float]
    phases: Sequence[float]
    mean: float = 0.0
    u: float = 0.0
    origin: float = 0.0

    def __post_init__(self) -> None:
        for key in ("amplitudes", "wavelengths", "phases"):
            object.__setattr__(self, key, finite_vector(getattr(self, key), key))
        sizes = (len(self.amplitudes), len(self.wavelengths), len(self.phases))
        if len(set(sizes)) > 1:
            raise InvalidSamplesError(
                f"amplitudes, wavelengths and phases must be equally long, got {sizes}"
            )
        if min(self.wavelengths) <= 0.0:
            raise InvalidSamplesError(f"wavelengths must be positive, got {min(self.wavelengths)}")
        for key in ("mean", "origin"):
            value = finite_number(getattr(self, key), f"{key} of a Fourier term")
            object.__setattr__(self, key, value)
        object.__setattr__(self, "u", standard_uncertainty(self.u))

    @classmethod
    def from_estimate(
        cls, estimate: Any, *, direction: str = "mean", u: float | None = None
    ) -> FourierTerm:
        """Return the series of the selected wavelengths of an estimate.

        Parameters
        ----------
        estimate : ErrorEstimate
            What `metrosep.separation.separate` returns by the methods "joint" and "kono".
        direction : {"mean", "forward", "backward"}, optional
            Of an estimate with two directions; as for `as_term`.
        u : float, m, optional
            Standard uncertainty at every position. By default the RMS over the evaluation range of
            the estimate's own and of what the series lacks of the estimate.

        Returns
        -------
        FourierTerm
            Phases at ``estimate.start``, which becomes the origin.

        Raises
        ------
        DataError
            The object has no spectrum with selected wavelengths or no uncertainty, or the direction
            is unknown or was not run.
        InvalidSamplesError
            `u` is negative or no finite number.

        Notes
        -----
        The estimate has a least-squares line removed over its evaluation range, the series has not:
        they agree but for a line, which is alignment. ``mean`` makes their means over the range
        equal. The estimate itself is a term, too: take it where the travel is not left.

        Examples
        --------
        >>> from types import SimpleNamespace
        >>> spectrum = {"wavelength_mm": [10.0, 5.0], "amplitude_nm": [800.0, 2.0],
        ...             "phase_rad": [0.5, 0.0], "selected": [True, False]}
        >>> estimate = SimpleNamespace(spectrum=spectrum, start=0.02, stop=0.06,
        ...     evaluate=lambda x: 8e-7 * np.cos(200 * np.pi * (x - 0.02) + 0.5),
        ...     sd=lambda x: np.full(x.shape, 1e-9))
        >>> term = FourierTerm.from_estimate(estimate)
        >>> term.origin, term.wavelengths
        (0.02, (0.01,))
        """
        return cls(**series_of(estimate, direction, u))

    def evaluate(self, x: ArrayLike) -> FloatArray:
        """Return the error at positions of the axis.

        Parameters
        ----------
        x : array_like, m or rad
            Axis positions.

        Returns
        -------
        ndarray, shape of x, m or rad
            Actual minus nominal.
        """
        positions = real_array(x, "position of an error term")
        value = np.full(positions.shape, self.mean)
        for a, length, phase in zip(self.amplitudes, self.wavelengths, self.phases, strict=True):
            value += a * np.cos(2.0 * np.pi / length * (positions - self.origin) + phase)
        return value

    def sd(self, x: ArrayLike) -> FloatArray:
        """Return the standard uncertainty at positions of the axis.

        Parameters
        ----------
        x : array_like, m or rad
            Axis positions.

        Returns
        -------
        ndarray, shape of x, m or rad
            One standard deviation.
        """
        return np.full(np.shape(x), self.u)


@dataclass(frozen=True, slots=True)
class TableTerm:
    """Table of an error over the axis position, straight lines between its points.

    Parameters
    ----------
    positions : sequence of float, shape (n,), m or rad
        Strictly rising.
    values : sequence of float, shape (n,), m or rad
        Error at the positions.
    u : float or sequence of float, shape (n,), m or rad
        Standard uncertainty of the values.

    Raises
    ------
    InvalidSamplesError
        Fewer than two points, unequal lengths, NaN or infinite entries, positions that do not rise,
        or u < 0.

    Notes
    -----
    Nothing is extrapolated: a position outside the table raises; 1e-9 of its span beyond an end is
    rounding (``3 * 0.1`` against 0.3) and takes the value of the end. The uncertainty between two points
    is interpolated too, as if their errors were fully correlated: it is the upper bound.

    Examples
    --------
    >>> TableTerm([0.0, 0.1], [0.0, 2e-6]).evaluate(0.05).item()
    1e-06
    """

    positions: Sequence[float]
    values: Sequence[float]
    u: float | Sequence[float] = 0.0

    def __post_init__(self) -> None:
        for key in ("positions", "values"):
            object.__setattr__(self, key, finite_vector(getattr(self, key), f"table {key}"))
        n = len(self.positions)
        if n < 2 or len(self.values) != n:
            raise InvalidSamplesError(
                f"a table needs two or more positions and as many values, got {n} and "
                f"{len(self.values)}"
            )
        steps = np.diff(self.positions)
        if steps.min() <= 0.0:
            i = int(np.argmin(steps))
            raise InvalidSamplesError(
                f"positions of a table must rise, got {self.positions[i]} then "
                f"{self.positions[i + 1]}"
            )
        given: Any = (self.u,) * n if np.ndim(self.u) == 0 else self.u
        us = finite_vector(given, "table uncertainty")
        if len(us) != n or min(us) < 0.0:
            raise InvalidSamplesError(
                f"u must be {n} numbers >= 0, got {len(us)}, least {min(us)}"
            )
        object.__setattr__(self, "u", us)

    def evaluate(self, x: ArrayLike) -> FloatArray:
        """Return the error at positions of the axis.

        Parameters
        ----------
        x : array_like, m or rad
            Axis positions.

        Returns
        -------
        ndarray, shape of x, m or rad
            Actual minus nominal.

        Raises
        ------
        DataError
            A position lies outside the table.
        """
        return self._interpolated(x, self.values)

    def sd(self, x: ArrayLike) -> FloatArray:
        """Return the standard uncertainty at positions of the axis.

        Parameters
        ----------
        x : array_like, m or rad
            Axis positions.

        Returns
        -------
        ndarray, shape of x, m or rad
            One standard deviation.

        Raises
        ------
        DataError
            A position lies outside the table.
        """
        return self._interpolated(x, self.u)  # type: ignore[arg-type]

    def _interpolated(self, x: ArrayLike, values: Sequence[float]) -> FloatArray:
        asked = real_array(x, "position of an error term")
        low, high = self.positions[0], self.positions[-1]
        margin = _ROUNDING * (high - low)
        outside = asked[(asked < low - margin) | (asked > high + margin)]
        if outside.size:
            raise DataError(
                f"position {float(outside.flat[0]):.9g} lies outside the error table "
                f"({low:.9g} to {high:.9g}); extend the table, nothing is extrapolated"
            )
        result: FloatArray = np.interp(asked, self.positions, values)
        return result


@dataclass(frozen=True, slots=True)
class CallableTerm:
    """Error that a function of the axis position gives.

    Parameters
    ----------
    function : callable
        Takes an array of positions (m or rad), returns as many errors (m or rad).
    u : float, m or rad
        Standard uncertainty at every position.

    Raises
    ------
    DataError
        `function` cannot be called.
    InvalidSamplesError
        u is negative or not finite.

    Examples
    --------
    >>> CallableTerm(lambda x: x / 1024).evaluate([1.0]).tolist()
    [0.0009765625]
    """

    function: Callable[[FloatArray], ArrayLike]
    u: float = 0.0

    def __post_init__(self) -> None:
        if not callable(self.function):
            raise DataError(f"a callable term needs a function, got {self.function!r}")
        object.__setattr__(self, "u", standard_uncertainty(self.u))

    def evaluate(self, x: ArrayLike) -> FloatArray:
        """Return the error at positions of the axis.

        Parameters
        ----------
        x : array_like, m or rad
            Axis positions.

        Returns
        -------
        ndarray, shape of x, m or rad
            Actual minus nominal.

        Raises
        ------
        InvalidSamplesError
            The function returns no real numbers, or another shape than that of its argument, or a
            number.
        """
        positions = real_array(x, "position of an error term")
        value = real_array(self.function(positions), "what an error function returned")
        if value.shape not in (positions.shape, ()):
            raise InvalidSamplesError(
                f"an error function returned shape {value.shape} for {positions.shape} positions"
            )
        return np.broadcast_to(value, positions.shape).copy()

    def sd(self, x: ArrayLike) -> FloatArray:
        """Return the standard uncertainty at positions of the axis.

        Parameters
        ----------
        x : array_like, m or rad
            Axis positions.

        Returns
        -------
        ndarray, shape of x, m or rad
            One standard deviation.
        """
        return np.full(np.shape(x), self.u)


def as_term(value: object, *, u: float | None = None, direction: str = "mean") -> ErrorTerm:
    """Return an error term for a number, a function, or what is a term already.

    Parameters
    ----------
    value : float, callable or ErrorTerm
        What to take; an estimate of `metrosep.separation.separate` is a term.
    u : float, m or rad, optional
        Standard uncertainty of a number or a function; a term brings its own.
    direction : {"mean", "forward", "backward"}, optional
        Of an estimate whose runs went both ways. What has no direction is the same in all three.

    Returns
    -------
    ErrorTerm
        Object with ``evaluate(x)`` and ``sd(x)``.

    Raises
    ------
    DataError
        The value is neither, or `u` is given for a term that has its own; the direction is unknown
        or was not run.
    InvalidSamplesError
        The value or `u` is no finite real number.

    Notes
    -----
    An object that gives a compensation (``quantity = "compensation"``, as polynomials of metrosep
    may) is turned round: the term is the error, ``-compensation``.

    "forward" and "backward" are the curves of the estimate, each about its own line. Their offset,
    the lost motion, is added to "backward" where its uncertainty is known: forward is the
    reference, as in a compensation table. "mean" is the mean of the two curves without it.

    Examples
    --------
    >>> as_term(2e-6, u=1e-7)
    ConstantTerm(value=2e-06, u=1e-07)
    """
    check_direction(direction)
    refuse_no_term(value)
    if isinstance(value, ErrorTerm):
        if u is not None:
            raise DataError(f"{type(value).__name__} has an uncertainty of its own; leave u out")
        term: ErrorTerm = error_of(value, direction)
        return term
    if callable(value):
        return CallableTerm(value, u=0.0 if u is None else u)
    if np.ndim(value) == 0 and not isinstance(value, str | None):  # type: ignore[arg-type]
        return ConstantTerm(value, u=0.0 if u is None else u)  # type: ignore[arg-type]
    raise DataError(
        f"an error term is a number, a function of the position, or has evaluate(x) and sd(x); "
        f"got {type(value).__name__}; give points of a table as TableTerm(positions, values)"
    )
