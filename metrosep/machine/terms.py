"""Error terms as functions of their axis position, each with its standard uncertainty.

Whatever has ``evaluate(x)`` and ``sd(x)`` is an error term: the classes here, and what
`metrosep.separation.separate` returns. Values are ``actual - nominal`` in m or rad, positions are
the axis positions `q` of the chain in m or rad. `ErrorSet` (`metrosep.machine.error_sets`) gathers
terms by their ISO 230-1 names.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any, Protocol, runtime_checkable

import numpy as np
from numpy.typing import ArrayLike

from metrosep.core import numbers
from metrosep.core._arrays import FloatArray, as_float, frozen_float
from metrosep.core.errors import DataError, InvalidSamplesError, UnitError

_ROUNDING = 1e-9  # of the span of a table; a position beyond its end by this is on the end


@runtime_checkable
class ErrorTerm(Protocol):
    """Anything with a value and a standard uncertainty at positions of its axis."""

    def evaluate(self, x: Any, /) -> Any:
        """Return the error at positions x."""

    def sd(self, x: Any, /) -> Any:
        """Return its standard uncertainty at positions x."""


class _OfPosition:
    """An error over the position of an axis; its classes say `_at` positions that were checked."""

    __slots__ = ()
    u: Any

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
            A position lies outside a table.
        InvalidSamplesError
            A position is not a real number, or a function returns none, or another shape than that of
            its argument, or a number.
        """
        return self._at(real_array(x, "position of an error term"))

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
            A position lies outside a table.
        """
        return self._sd(x)

    def _at(self, x: FloatArray) -> FloatArray:
        raise NotImplementedError

    def _sd(self, x: ArrayLike) -> FloatArray:
        return np.full(np.shape(x), self.u)

    def _set(self, **values: Any) -> None:
        for key, value in values.items():
            object.__setattr__(self, key, value)


@dataclass(frozen=True, slots=True)
class ConstantTerm(_OfPosition):
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
        self._set(value=numbers.real(self.value, "value of a constant term"), u=_u(self.u))

    def _at(self, x: FloatArray) -> FloatArray:
        return np.full(x.shape, self.value)


@dataclass(frozen=True, slots=True)
class PolynomialTerm(_OfPosition):
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
        self._set(coefficients=finite_vector(self.coefficients, "coefficients"), u=_u(self.u))
        if self.covariance is None:
            return
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
        self._set(covariance=matrix)

    def _at(self, x: FloatArray) -> FloatArray:
        return np.asarray(np.polynomial.polynomial.polyval(x, np.asarray(self.coefficients)))

    def _sd(self, x: ArrayLike) -> FloatArray:
        positions = real_array(x, "position of an error term")
        if self.covariance is None:
            return np.full(positions.shape, self.u)
        powers = positions[..., None] ** np.arange(len(self.coefficients))
        variance = np.einsum("...i,ij,...j->...", powers, np.asarray(self.covariance), powers)
        return np.asarray(np.sqrt(self.u**2 + np.maximum(variance, 0.0)))


@dataclass(frozen=True, slots=True)
class FourierTerm(_OfPosition):
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
        keys = ("amplitudes", "wavelengths", "phases")
        self._set(**{key: finite_vector(getattr(self, key), key) for key in keys})
        sizes = (len(self.amplitudes), len(self.wavelengths), len(self.phases))
        if len(set(sizes)) > 1:
            raise InvalidSamplesError(
                f"amplitudes, wavelengths and phases must be equally long, got {sizes}"
            )
        if min(self.wavelengths) <= 0.0:
            raise InvalidSamplesError(f"wavelengths must be positive, got {min(self.wavelengths)}")
        mean = numbers.real(self.mean, "mean of a Fourier term")
        self._set(
            mean=mean, origin=numbers.real(self.origin, "origin of a Fourier term"), u=_u(self.u)
        )

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

    def _at(self, x: FloatArray) -> FloatArray:
        value = np.full(x.shape, self.mean)
        for a, length, phase in zip(self.amplitudes, self.wavelengths, self.phases, strict=True):
            value += a * np.cos(2.0 * np.pi / length * (x - self.origin) + phase)
        return value


@dataclass(frozen=True, slots=True)
class TableTerm(_OfPosition):
    """Table of an error over the axis position, straight lines between its points.

    Parameters
    ----------
    positions : sequence of float, shape (n,), m or rad
        Strictly rising.
    values : sequence of float, shape (n,), m or rad
        Error at the positions.
    u : float or sequence of float, shape (n,), m or rad
        Standard uncertainty of the values.
    period : float, m or rad, optional
        Of an axis that turns: positions are looked up modulo the turn, which the table must span with
        equal values at both ends.

    Raises
    ------
    InvalidSamplesError
        Fewer than two points, a table with a period that does not close, unequal lengths, NaN or infinite entries, positions that do not rise,
        or u < 0.

    Notes
    -----
    Nothing is extrapolated: without a period a position outside the table raises; 1e-9 of its span beyond an end is
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
    period: float | None = None

    def __post_init__(self) -> None:
        for key in ("positions", "values"):
            self._set(**{key: finite_vector(getattr(self, key), f"table {key}")})
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
        self._set(u=us)
        if self.period is None:
            return
        turn = numbers.positive(self.period, "period of a table")
        self._set(period=turn)
        span = self.positions[-1] - self.positions[0]
        if abs(span - turn) > _ROUNDING * turn or not closes(self.values):
            raise InvalidSamplesError(
                f"a table with a period must span it ({turn:.9g}) and end as it begins; it spans {span:.9g} and "
                f"goes from {self.values[0]:.4g} to {self.values[-1]:.4g}"
            )

    def _at(self, x: FloatArray) -> FloatArray:
        return self._interpolated(x, self.values)

    def _sd(self, x: ArrayLike) -> FloatArray:
        us: Any = self.u
        return self._interpolated(real_array(x, "position of an error term"), us)

    def _interpolated(self, asked: FloatArray, values: Sequence[float]) -> FloatArray:
        low, high = self.positions[0], self.positions[-1]
        margin = _ROUNDING * (high - low)
        if self.period is not None:
            asked = np.where(
                (asked < low) | (asked > high), low + np.mod(asked - low, self.period), asked
            )
        outside = asked[(asked < low - margin) | (asked > high + margin)]
        if outside.size:
            raise DataError(
                f"position {float(outside.flat[0]):.9g} lies outside the error table "
                f"({low:.9g} to {high:.9g}); extend the table, nothing is extrapolated"
            )
        return np.asarray(np.interp(asked, self.positions, values))


def closes(values: Sequence[float]) -> bool:
    """Return whether a table ends as it begins, to a millionth of what it goes up and down."""
    return abs(values[-1] - values[0]) <= 1e-6 * float(np.ptp(values))


@dataclass(frozen=True, slots=True)
class CallableTerm(_OfPosition):
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
        self._set(u=_u(self.u))

    def _at(self, x: FloatArray) -> FloatArray:
        value = real_array(self.function(x), "what an error function returned")
        if value.shape not in (x.shape, ()):
            raise InvalidSamplesError(
                f"an error function returned shape {value.shape} for {x.shape} positions"
            )
        return np.broadcast_to(value, x.shape).copy()


@dataclass(frozen=True, slots=True)
class SumTerm(_OfPosition):
    """Sum of independent errors, such as that of a cold machine and what its heat adds.

    Parameters
    ----------
    parts : sequence of ErrorTerm
        What is added; their uncertainties are taken as independent.

    Raises
    ------
    DataError
        There is no part, or one is not an error term.

    Examples
    --------
    >>> SumTerm((ConstantTerm(1e-6, u=3e-7), ConstantTerm(2e-6, u=4e-7))).sd(0.0).round(12).item()
    5e-07
    """

    parts: Sequence[ErrorTerm]

    def __post_init__(self) -> None:
        parts = tuple(self.parts)
        if not parts or not all(isinstance(p, ErrorTerm) for p in parts):
            raise DataError("a sum of errors needs terms with evaluate(x) and sd(x)")
        self._set(parts=parts)

    def _at(self, x: FloatArray) -> FloatArray:
        return np.asarray(sum(np.asarray(p.evaluate(x)) for p in self.parts))

    def _sd(self, x: ArrayLike) -> FloatArray:
        return np.asarray(np.sqrt(sum(np.asarray(p.sd(x)) ** 2 for p in self.parts)))


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
        The value or `u` is not a finite real number.

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


def _u(value: Any) -> float:
    return numbers.not_negative(value, "standard uncertainty of a term")


# ---- what other parts of metrosep return, read as an error: sign, direction, unit ---------------
# All by what an object has, not by its class: separation and machine do not import one another.

DIRECTIONS = {"mean": None, "forward": 1, "backward": -1, "reverse": -1}
_COLUMN = {1: "forward", -1: "reverse"}
_POINTS = 501  # at which a series and its estimate are compared
_NM, _MM = 1e-9, 1e-3


@dataclass(frozen=True, slots=True)
class SourceTerm:
    """Error of an object that itself gives a compensation, or one curve for each direction."""

    source: Any
    method: str = "evaluate"
    sign: float = 1.0
    direction: int | None = None
    offset: float = 0.0
    u_offset: float = 0.0

    def evaluate(self, x: ArrayLike) -> FloatArray:
        """Return the error at positions."""
        return self.sign * self._of(self.method, x) + self.offset

    def sd(self, x: ArrayLike) -> FloatArray:
        """Return its standard uncertainty at positions."""
        sd = self._of("sd", x)
        return sd if self.u_offset == 0.0 else np.hypot(sd, self.u_offset)

    def _of(self, method: str, x: ArrayLike) -> FloatArray:
        asked = real_array(x, "position of an error term")
        options = {} if self.direction is None else {"direction": self.direction}
        values = getattr(self.source, method)(np.atleast_1d(asked).ravel(), **options)
        return np.array(values, dtype=np.float64).reshape(asked.shape)


def error_of(value: Any, direction: str) -> Any:
    """Return an object with evaluate and sd as an error of one direction; itself where it is one."""
    way = check_direction(direction)
    quantity = getattr(value, "quantity", "error")
    if quantity == "compensation":
        if callable(getattr(value, "error", None)):
            return SourceTerm(value, method="error")
        return SourceTerm(value, sign=-1.0)
    if quantity != "error":
        raise DataError(
            f"{type(value).__name__} gives quantity = {quantity!r}; a term is an 'error' "
            "(actual - nominal), a 'compensation' is turned round"
        )
    there = _directions(value)
    if way is None or not there:
        return value
    if way not in there:
        raise DataError(
            f"direction = {direction!r}, but {type(value).__name__} comes from "
            f"{'backward' if way > 0 else 'forward'} runs only; leave direction out, or measure the other one too"
        )
    lost = _lost_motion(value) if way < 0 else None
    offset, u_offset = (0.0, 0.0) if lost is None else lost
    return SourceTerm(value, direction=way, offset=offset, u_offset=u_offset)


def check_direction(direction: Any) -> int | None:
    """Return 1, -1 or None for the mean."""
    if not isinstance(direction, str) or direction not in DIRECTIONS:
        raise DataError(f"direction is one of mean, forward, backward, got {direction!r}")
    return DIRECTIONS[direction]


def direction_message(name: str, value: Any, direction: str) -> str | None:
    """Return what to tell of a term that was estimated in two directions, None if nothing."""
    way = check_direction(direction)
    if set(_directions(value)) != {-1, 1}:
        return None
    lost = _lost_motion(value)
    if way is None:
        size = "not known" if lost is None else f"{lost[0] * 1e6:.4g} um"
        return (
            f"{name} is the mean of the forward and the backward runs; what differs between them "
            f"is not in it (lost motion {size}): direction = 'forward' or 'backward' takes one"
        )
    if way < 0 and lost is None:
        return (
            f"{name} is that of the backward runs about their own level: their lost motion is not "
            "known"
        )
    return None


def refuse_length(name: str, value: Any) -> None:
    """Refuse a curve in m as an angular term."""
    if not is_angle(name):
        return
    unit = None
    if callable(getattr(value, "peak_to_valley", None)):
        unit = getattr(value.peak_to_valley(), "unit", None)
    elif hasattr(value, "domain") and hasattr(value, "quantity"):
        unit = "m"  # polynomials of metrosep give a length over a length
    if unit == "m":
        raise UnitError(
            f"{type(value).__name__} is in m, and error term {name!r} is an angle in rad; if its "
            "readings were angles, give its method evaluate as a function"
        )


def refuse_no_term(value: Any) -> None:
    """Refuse what can be called, but gives no error over the position of one axis."""
    from metrosep.forms.base import Form

    if isinstance(value, type):
        raise DataError(
            f"an error term is an object, got the class {value.__name__}; write "
            f"{value.__name__}(...) with its values"
        )
    owner = getattr(value, "__self__", None)
    if getattr(owner, "quantity", "error") == "compensation" and value != getattr(
        owner, "error", None
    ):
        raise DataError(
            f"{value.__name__} of a {type(owner).__name__} gives the compensation, the negative of "
            "the error; give the object itself as the term"
        )
    if isinstance(value, Form):
        raise DataError(
            f"{type(value).__name__} is the form of a surface z(x, y), no error over the position "
            "of one axis; write a PolynomialTerm or a function of the position"
        )


def series_of(estimate: Any, direction: str, u: float | None) -> dict[str, Any]:
    """Return what a Fourier term needs from the spectrum of an estimate."""
    try:
        spectrum = estimate.spectrum
        start, stop = float(estimate.start), float(estimate.stop)
        columns = list(spectrum)
        chosen = np.array(spectrum["selected"], dtype=bool)
        table = {
            "amplitudes": np.array(spectrum["amplitude_nm"], dtype=np.float64) * _NM,
            "wavelengths": np.array(spectrum["wavelength_mm"], dtype=np.float64) * _MM,
            "phases": np.array(spectrum["phase_rad"], dtype=np.float64),
        }
    except (AttributeError, KeyError, TypeError) as exc:
        raise DataError(
            "a Fourier term is made of an estimate with spectrum, start and stop, as `separate` "
            f"returns it; got {type(estimate).__name__} ({exc})"
        ) from None
    way = check_direction(direction)
    term = error_of(estimate, direction)
    if "direction" in columns:
        names = np.array(spectrum["direction"], dtype=str)
        if way is None:
            table["amplitudes"] = table["amplitudes"] / np.unique(names).size
        else:
            chosen &= names == _COLUMN[way]
    if not chosen.any():
        raise DataError(
            "the estimate has no selected wavelength; take the estimate itself as the term "
            "(method 'mean' has no spectrum)"
        )
    parts = {name: tuple(values[chosen].tolist()) for name, values in table.items()}
    x = np.linspace(start, stop, _POINTS)
    turns = 2.0 * np.pi * np.divide.outer(x - start, parts["wavelengths"]) + parts["phases"]
    rest = np.asarray(term.evaluate(x)) - np.cos(turns) @ np.array(parts["amplitudes"])
    known = ~np.isnan(rest)
    mean = float(rest[known].mean()) if known.any() else 0.0
    if u is None:
        u = _left_out(x[known], rest[known], np.asarray(term.sd(x))[known])
    return {**parts, "mean": mean, "u": u, "origin": start}


def _left_out(x: FloatArray, rest: FloatArray, sd: FloatArray) -> float:
    """Return the RMS of the estimate's uncertainty and of what the series lacks beside a line."""
    sd = sd[~np.isnan(sd)]
    if not sd.size or x.size < 3:
        raise DataError("the estimate has no standard uncertainty; give u")
    along = np.linspace(-1.0, 1.0, x.size)
    rest = rest - np.polyval(np.polyfit(along, rest, 1), along)
    return float(np.sqrt(np.mean(sd**2) + np.mean(rest**2)))


def _directions(value: Any) -> tuple[int, ...]:
    """Return the directions of the runs, -1 and 1; empty where they were not distinguished."""
    there = getattr(value, "directions", ())
    return tuple(d for d in there if d in (-1, 1)) if isinstance(there, tuple) else ()


def _lost_motion(value: Any) -> tuple[float, float] | None:
    """Return the offset of the backward runs against the forward ones, and its u.

    None where its uncertainty is not known (one run in a direction): that of single runs may as
    well be drift of the sensor. Compensation tables leave it out by the same rule.
    """
    lost = getattr(value, "lost_motion", None)
    if lost is None or lost.u is None or not math.isfinite(lost.value):
        return None
    return float(lost.value), float(lost.u)


# ---- numbers that a person typed or measured: numpy takes True for 1, "0.01" for 0.01, None for NaN --

LARGEST = {"m": 1.0, "rad": 1.0}
"""Amounts of error terms above these are other units: um as m, degrees as rad. Units themselves pass."""

_HINTS = {
    "m": "lengths are in m, 5 um are 5e-6",
    "rad": "angles are in rad, 0.5 degrees are 0.00873 and 1 arc second 4.85e-6",
}


class TrialAmounts(dict[str, float]):
    """Amounts that a fit tries, by term: on its way they may be larger than those of a machine."""


def real_array(values: Any, name: str) -> FloatArray:
    """Return real numbers as a new float64 array, NaN and infinities kept."""
    _refuse_no_numbers(values, name)
    try:
        array = as_float(values)
    except (TypeError, ValueError) as exc:
        raise InvalidSamplesError(f"{name} must be real numbers in SI: {exc}") from None
    return array


def positions_array(values: Any, name: str) -> FloatArray:
    """Return real numbers as a new float64 array, NaN kept; infinities are refused."""
    array = real_array(values, name)
    if np.isinf(array).any():
        first = tuple(int(i) for i in np.argwhere(np.isinf(array))[0])
        where = f" at index {first}" if first else ""
        raise InvalidSamplesError(f"{name} is infinite{where}")
    return array


def finite_vector(values: Sequence[float], name: str) -> tuple[float, ...]:
    """Return finite real numbers of one dimension as a tuple."""
    _refuse_no_numbers(values, name)
    array = frozen_float(values, name=name, ndim=1)
    if np.isnan(array).any():
        raise InvalidSamplesError(
            f"{name} hold NaN at index {int(np.argmax(np.isnan(array)))}; leave out what was not "
            "measured"
        )
    return tuple(array.tolist())


def is_angle(term: str) -> bool:
    """Return whether the ISO 230-1 name is that of an angle: EAX, ECC, B0Z."""
    return term.removeprefix("E")[:1] in ("A", "B", "C")


def check_amount(term: str, values: FloatArray, what: str) -> None:
    """Refuse amounts of a term that only another unit explains."""
    unit = "rad" if is_angle(term) else "m"
    largest = float(np.abs(values).max(initial=0.0))
    if largest > LARGEST[unit]:
        raise UnitError(
            f"{what} is {largest:.6g} {unit}; above {LARGEST[unit]:g} {unit} it is not an error of a "
            f"machine: {_HINTS[unit]}"
        )


def _refuse_no_numbers(values: Any, name: str) -> None:
    """Refuse what numpy would take for numbers; complex ones are left to `as_float`."""
    try:
        kind = np.asarray(values).dtype.kind
    except ValueError as exc:
        raise InvalidSamplesError(f"{name} must be real numbers in SI: {exc}") from None
    mixed = isinstance(values, list | tuple) and any(
        isinstance(v, bool | np.bool_) for v in values
    )
    if kind not in "iufc" or mixed:
        raise InvalidSamplesError(
            f"{name} must be real numbers in SI, got {str(values)[:40]!r} of type "
            f"{type(values).__name__}; write NaN where nothing was measured"
        )
