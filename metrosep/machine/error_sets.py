"""Error terms of a machine by name, with their uncertainties and correlations."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from metrosep.core import numbers
from metrosep.core._arrays import FloatArray
from metrosep.core.docs import described_by
from metrosep.core.errors import DataError, InvalidSamplesError
from metrosep.core.provenance import freeze_mapping
from metrosep.machine.elements import axis_of
from metrosep.machine.terms import (
    CallableTerm,
    ConstantTerm,
    ErrorTerm,
    TrialAmounts,
    as_term,
    check_amount,
    check_direction,
    direction_message,
    is_angle,
    positions_array,
    real_array,
    refuse_length,
)

_ROUNDING = 1e-9  # of the least eigenvalue of a correlation matrix


@dataclass(frozen=True, slots=True)
class ErrorSet:
    """Error terms by their ISO 230-1 names.

    Parameters
    ----------
    values : mapping of str to float, str, callable or ErrorTerm
        One entry per term: a number (m or rad) or a text with its unit (``"2 um"``), a function of
        the axis position, or an object with ``evaluate(x)`` and ``sd(x)``, such as what
        `metrosep.separation.separate` returns.
    u : mapping of str to float or str, m or rad, optional
        Standard uncertainty of numbers and functions; 0 where nothing is given.
    correlations : mapping of (str, str) to float, optional
        Correlation coefficients of pairs of terms, -1 to 1; 0 where nothing is given.
    direction : str or mapping of str to str, optional
        ``"mean"``, ``"forward"`` or ``"backward"`` for the estimates whose runs went both ways, for
        all of them or by name; see `as_term`.

    Attributes
    ----------
    terms : mapping of str to ErrorTerm
        The terms by name.
    messages : tuple of str
        What the user should know: which terms are the mean of two directions.

    Raises
    ------
    DataError
        A name follows no rule, an uncertainty, a correlation or a direction belongs to no term or is
        given twice, or the correlations contradict each other (no covariance has them); a value, an
        uncertainty or a correlation is not a finite real number, or out of range.
    UnitError
        A number is above 1 m or 1 rad, not an error of a machine (degrees as rad, um as m); a curve in m
        stands for an angle.

    Notes
    -----
    A correlation holds at equal states: that of two terms at their positions in the same `q`. What
    gives a compensation instead of an error is turned round.

    Examples
    --------
    >>> errors = ErrorSet({"EXX": 1e-6, "EYX": 0.0}, u={"EXX": 2e-7, "EYX": 1e-7},
    ...                   correlations={("EXX", "EYX"): 0.5})
    >>> errors.covariance().round(16).tolist()
    [[4e-14, 1e-14], [1e-14, 1e-14]]
    """

    values: Mapping[str, Any]
    u: Mapping[str, float | str] = field(default_factory=dict)
    correlations: Mapping[tuple[str, str], float] = field(default_factory=dict)
    direction: str | Mapping[str, str] = "mean"
    terms: Mapping[str, ErrorTerm] = field(init=False, repr=False)
    messages: tuple[str, ...] = field(init=False, repr=False, compare=False)

    def __post_init__(self) -> None:
        _refuse_no_mapping(self.values, "values are a mapping of term names to errors")
        _refuse_no_mapping(self.u, "u is a mapping of term names to standard uncertainties")
        _refuse_no_mapping(self.correlations, "correlations are a mapping of pairs of term names")
        ways: Mapping[str, str] = {}
        if isinstance(self.direction, Mapping):
            ways = freeze_mapping(self.direction)
            object.__setattr__(self, "direction", ways)
        else:
            check_direction(self.direction)
            ways = dict.fromkeys(self.values, self.direction)
        for key, names in (("u", self.u), ("direction", ways)):
            for name in names:
                if name not in self.values:
                    known = ", ".join(str(n) for n in self.values) or "none"
                    raise DataError(f"{key} of {name!r} belongs to no term; there are {known}")
        terms, messages, values, us = {}, [], dict(self.values), dict(self.u)
        for name, value in self.values.items():
            axis_of(name)
            way = ways.get(name, "mean")
            dimension = "angle" if is_angle(name) else "length"
            try:
                if isinstance(value, str):
                    values[name] = numbers.quantity(value, "its value", dimension)
                if name in us:
                    us[name] = numbers.quantity(us[name], "its u", dimension)
                terms[name] = self._term(name, values[name], us.get(name), way)
            except DataError as exc:
                raise type(exc)(f"error term {name!r}: {exc}") from None
            messages.append(direction_message(name, value, way))
        frozen: dict[str, Any] = {"values": values, "u": us, "correlations": self.correlations}
        for key, found in frozen.items():
            object.__setattr__(self, key, freeze_mapping(found))
        object.__setattr__(self, "terms", freeze_mapping(terms))
        object.__setattr__(self, "messages", tuple(m for m in messages if m is not None))
        self._check_correlations()

    def _term(self, name: str, value: Any, u: Any, direction: str) -> ErrorTerm:
        term = as_term(value, u=u, direction=direction)
        refuse_length(name, value)
        if isinstance(self.values, TrialAmounts):
            return term
        if isinstance(term, ConstantTerm):
            check_amount(name, np.array(term.value), "its value")
        if isinstance(term, ConstantTerm | CallableTerm):
            check_amount(name, np.array(term.u), "its u")
        return term

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the terms, in the order given."""
        return tuple(self.terms)

    def at(
        self, q: Mapping[str, ArrayLike], *, names: Iterable[str] | None = None
    ) -> dict[str, FloatArray]:
        """Return the value of every term at axis positions.

        Parameters
        ----------
        q : mapping of str to array_like, m or rad
            Axis positions.
        names : iterable of str, optional
            Terms wanted, in this order; all by default.

        Returns
        -------
        dict of str to ndarray, m or rad
            Shape of the axis position; ``()`` where the term is a constant.

        Raises
        ------
        DataError
            The position of an axis is missing, or lies outside a term's table.
        InvalidSamplesError
            A term is NaN or infinite at a position that is known, or a position is not a real
            number.
        LimitError
            A polynomial of `metrosep.process.run_polynomial` was not measured at a position.
        UnitError
            An amount is above 1 m or 1 rad, not an error of a machine.

        Notes
        -----
        NaN in a position gives NaN in the terms that depend on it.
        """
        _refuse_no_mapping(q, "positions are a mapping of axis names")
        wanted = self._known(names)
        return {name: _at(name, self.terms[name], "evaluate", q) for name in wanted}

    @described_by(at, errors=False)
    def u_at(self, q: Mapping[str, ArrayLike]) -> dict[str, FloatArray]:
        """Return the standard uncertainty of every term at axis positions.

        Returns
        -------
        dict of str to ndarray, m or rad
            Shape as in `at`.

        Raises
        ------
        DataError, LimitError
            As of `at`; an uncertainty is negative.
        """
        _refuse_no_mapping(q, "positions are a mapping of axis names")
        return {name: _at(name, term, "sd", q) for name, term in self.terms.items()}

    @described_by(at, errors=False)
    def correlation(self, names: Iterable[str] | None = None) -> FloatArray:
        """Return the correlation matrix of terms.

        Returns
        -------
        ndarray, shape (n, n), dimensionless
            Ones on the diagonal.

        Raises
        ------
        DataError
            A name is not a term of the set.
        """
        wanted = self._known(names)
        matrix = np.eye(len(wanted))
        for (one, two), r in self.correlations.items():
            if one in wanted and two in wanted:
                i, k = wanted.index(one), wanted.index(two)
                matrix[i, k] = matrix[k, i] = r
        return matrix

    @described_by(correlation, errors=False)
    def covariance(
        self, names: Iterable[str] | None = None, q: Mapping[str, ArrayLike] | None = None
    ) -> FloatArray:
        """Return the covariance of terms.

        Parameters
        ----------
        q : mapping of str to array_like, m or rad, optional
            Axis positions, where uncertainties depend on them.

        Returns
        -------
        ndarray, shape (n, n), or (..., n, n) with `q`, m^2, m rad, rad^2
            ``u_i u_k r_ik``.

        Raises
        ------
        DataError
            A name is not a term of the set, an uncertainty depends on the position and there is no `q`, or as
            of `u_at`.

        Examples
        --------
        >>> ErrorSet({"EXX": 0.0}, u={"EXX": 3e-7}).covariance().shape
        (1, 1)
        """
        wanted = self._known(names)
        r = self.correlation(wanted)
        if q is None:
            u = np.array([self._constant_u(name) for name in wanted])
        else:
            _refuse_no_mapping(q, "positions are a mapping of axis names")
            at = {name: _at(name, self.terms[name], "sd", q) for name in wanted}
            u = np.stack(np.broadcast_arrays(*at.values()), axis=-1) if at else np.zeros(0)
        result: FloatArray = u[..., :, None] * r * u[..., None, :]
        return result

    def _constant_u(self, name: str) -> float:
        term = self.terms[name]
        u = np.unique(np.asarray(getattr(term, "u", (0.0, 1.0)), dtype=np.float64))
        if u.size == 1 and getattr(term, "covariance", None) is None:
            return float(u[0])
        raise DataError(f"the uncertainty of {name!r} depends on the position; give q")

    def _known(self, names: Iterable[str] | None) -> tuple[str, ...]:
        given: Any = names
        if isinstance(given, str) or not (given is None or isinstance(given, Iterable)):
            raise DataError(f"names are a sequence of term names, got {given!r}")
        wanted = self.names if names is None else tuple(names)
        for name in wanted:
            if name not in self.terms:
                raise DataError(
                    f"{name!r} is not a term of the set; it has {', '.join(self.names)}"
                )
        return wanted

    def _check_correlations(self) -> None:
        seen = set()
        pairs: Mapping[Any, Any] = self.correlations
        for pair, given in pairs.items():
            if not isinstance(pair, tuple) or len(pair) != 2:
                raise DataError(
                    f"correlation {pair!r}: name a pair of two terms, such as ('EXX', 'EYX')"
                )
            if pair[0] == pair[1] or frozenset(pair) in seen:
                raise DataError(f"correlation {pair!r}: name each pair of two terms once")
            seen.add(frozenset(pair))
            self._known(pair)
            numbers.between(given, f"correlation of {pair}", -1.0, 1.0)
        involved = sorted({name for pair in self.correlations for name in pair})
        if involved:
            lowest = float(np.linalg.eigvalsh(self.correlation(involved)).min())
            if lowest < -_ROUNDING:
                raise DataError(
                    f"the correlations of {', '.join(involved)} contradict each other: their "
                    f"matrix has the eigenvalue {lowest:.3g}, no covariance has"
                )


def as_error_set(errors: ErrorSet | Mapping[str, Any]) -> ErrorSet:
    """Return an error set for a plain mapping of names to values.

    Parameters
    ----------
    errors : ErrorSet or mapping of str to float, callable or ErrorTerm
        A set passes as it is; numbers of a mapping are taken as exact.

    Returns
    -------
    ErrorSet
        The set.

    Raises
    ------
    DataError
        The values are not a mapping, or as of `ErrorSet`.

    Examples
    --------
    >>> as_error_set({"EXX": 1e-6}).names
    ('EXX',)
    """
    if isinstance(errors, ErrorSet):
        return errors
    _refuse_no_mapping(errors, "errors are a mapping of term names")
    return ErrorSet(errors)


def _refuse_no_mapping(value: object, what: str) -> None:
    if not isinstance(value, Mapping):
        raise DataError(f"{what}, got {type(value).__name__}")


def _at(name: str, term: ErrorTerm, what: str, q: Mapping[str, ArrayLike]) -> FloatArray:
    """Return ``evaluate`` or ``sd`` of a term at its axis, NaN where the position is NaN."""
    axis = axis_of(name)
    function = getattr(term, what)
    if isinstance(term, ConstantTerm):
        return real_array(function(0.0), name)
    if axis is None or axis not in q:
        raise DataError(
            f"error term {name!r} is a function of a position, but "
            + (f"q holds no axis {axis!r}" if axis else "a location error is a constant")
        )
    x = positions_array(q[axis], f"position of axis {axis!r}")
    asked = np.atleast_1d(x)[np.isfinite(np.atleast_1d(x))]
    try:
        found = function(asked)
    except DataError as exc:
        raise type(exc)(f"{name} over {axis}: {exc}") from None
    values = real_array(found, f"what error term {name!r} returned")
    if values.shape != asked.shape:
        raise InvalidSamplesError(
            f"error term {name!r} returned shape {values.shape} for {asked.size} positions"
        )
    if not np.isfinite(values).all():
        bad = float(asked[~np.isfinite(values)][0])
        raise InvalidSamplesError(f"error term {name!r} is not known at {axis} = {bad:.9g}")
    if what == "sd" and asked.size and values.min() < 0.0:
        raise InvalidSamplesError(f"standard uncertainty of {name!r} is negative: {values.min()}")
    check_amount(name, values, f"{'u' if what == 'sd' else 'the value'} of error term {name!r}")
    result = np.full(x.shape, np.nan)
    result[np.isfinite(x)] = values
    return result
