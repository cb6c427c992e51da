"""What every form can do: height, gradient, and the derivative by each of its parameters.

A form is an ideal surface ``z = f(x, y)``, z up out of the material, SI, with its own origin at
its vertex or centre. It is frozen: `with_parameters` returns another one. A parameter given as
None is not known yet, and a fit determines it. Outside the domain of a form (beyond the equator of
a sphere) heights and derivatives are NaN. A profile is the line ``y = 0``.
"""

from __future__ import annotations

import dataclasses
import math
from abc import ABC, abstractmethod
from collections.abc import Mapping, Sequence
from typing import Any, Self, cast

import numpy as np
from numpy.typing import ArrayLike

from metrosep.core._arrays import FloatArray
from metrosep.core.errors import DataError
from metrosep.core.numbers import real

__all__ = ["Form"]


class Form(ABC):
    """An ideal surface.

    Attributes
    ----------
    name : str
        Word for messages and history, such as ``"conic"``.
    units : mapping of str to str
        SI unit of each parameter, in their order.
    has_centre : bool
        Whether the form has a vertex or centre, which a fit puts in the middle of what was
        measured, on a map that declares no origin; periodic forms and polynomials have none.
    is_everywhere : bool
        Whether the form has a height at every point, so that no valid point is left out.
    is_linear : bool
        Whether the heights are linear in all parameters.
    radii : tuple of str
        Parameters that are radii of curvature. A fit looks for 1/R, which is zero for a flat and
        has no pole there.
    weak : tuple of str
        Parameters that move no height of a flat part. A fit holds one that is not known to 1 (a
        conic constant) or to 1 rad.
    """

    name: str = "form"
    units: Mapping[str, str] = {}
    has_centre: bool = True
    is_everywhere: bool = False
    is_linear: bool = False
    radii: tuple[str, ...] = ()
    weak: tuple[str, ...] = ()

    @property
    @abstractmethod
    def parameters(self) -> dict[str, float | None]:
        """Shape parameters by name, SI; None where not known yet."""

    @property
    def spanned(self) -> frozenset[str]:
        """Rigid-body freedoms that the parameters already hold."""
        return frozenset()

    @property
    def period(self) -> tuple[float, float] | None:
        """Period along x and y, m; None for a form that does not repeat."""
        return None

    @abstractmethod
    def with_parameters(self, **values: float) -> Form:
        """Return the form with other values of some parameters.

        Parameters
        ----------
        **values : float
            By name, SI.
        """

    @abstractmethod
    def height(self, x: FloatArray, y: FloatArray) -> FloatArray:
        """Return z at points of equal shape, float64; NaN outside the domain.

        Parameters
        ----------
        x, y : ndarray, m
            Positions in the form's frame.
        """

    @abstractmethod
    def slopes(self, x: FloatArray, y: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return dz/dx and dz/dy at points of equal shape.

        Parameters
        ----------
        x, y : ndarray, m
            Positions in the form's frame.
        """

    @abstractmethod
    def derivatives(self, x: FloatArray, y: FloatArray, names: Sequence[str]) -> list[FloatArray]:
        """Return dz/dp for each named parameter.

        Parameters
        ----------
        x, y : ndarray, m
            Positions in the form's frame, of equal shape.
        names : sequence of str
            Of parameters.
        """

    def expansion(
        self, x: FloatArray, y: FloatArray, names: Sequence[str], *, slopes: bool
    ) -> tuple[FloatArray, tuple[FloatArray, FloatArray] | None, list[FloatArray]]:
        """Return heights, slopes and derivatives at once; a form may share work between them.

        Parameters
        ----------
        x, y : ndarray, m
            Positions in the form's frame, of equal shape.
        names : sequence of str
            Of parameters.
        slopes : bool
            Whether slopes are wanted.

        Returns
        -------
        height : ndarray, m
            As `height`.
        slopes : tuple of ndarray or None
            As `slopes`.
        derivatives : list of ndarray
            As `derivatives`.
        """
        return (
            self.height(x, y),
            self.slopes(x, y) if slopes else None,
            self.derivatives(x, y, names) if names else [],
        )

    def units_of(self) -> dict[str, str]:
        """Return the unit of each parameter; those of the class unless they depend on the form."""
        units = self.units
        return {k: units[k] for k in self.parameters}

    def start(self, x: FloatArray, y: FloatArray, z: FloatArray) -> Form:
        """Return the form with values for its unknown parameters, good enough to start a fit.

        Parameters
        ----------
        x, y, z : ndarray, shape (n,), m
            Valid points, x and y from the assumed centre; no NaN.

        Returns
        -------
        Form
            Without unknown parameters.

        Raises
        ------
        DataError
            If a parameter is unknown and the form has no rule to guess it.
        """
        unknown = [k for k, v in self.parameters.items() if v is None]
        if unknown:
            raise DataError(
                f"{self.name} has no value for {', '.join(unknown)} and no rule to guess one; "
                "give a starting value"
            )
        return self

    def __call__(self, x: ArrayLike, y: ArrayLike = 0.0) -> FloatArray:
        """Return z at points that broadcast; NaN outside the domain."""
        xs, ys, shape = self._points(x, y)
        return self.height(xs, ys).reshape(shape)

    def gradient(self, x: ArrayLike, y: ArrayLike = 0.0) -> tuple[FloatArray, FloatArray]:
        """Return dz/dx and dz/dy at points that broadcast; NaN outside the domain.

        Parameters
        ----------
        x, y : array_like, m
            Positions in the form's frame.

        Returns
        -------
        tuple of ndarray
            Slopes, dimensionless.

        Raises
        ------
        DataError
            If a parameter is not known yet.
        """
        xs, ys, shape = self._points(x, y)
        along_x, along_y = self.slopes(xs, ys)
        return along_x.reshape(shape), along_y.reshape(shape)

    def _points(
        self, x: ArrayLike, y: ArrayLike
    ) -> tuple[FloatArray, FloatArray, tuple[int, ...]]:
        unknown = [k for k, v in self.parameters.items() if v is None]
        if unknown:
            raise DataError(
                f"{self.name} has no value for {', '.join(unknown)} yet: give one, or fit it"
            )
        xs, ys = np.broadcast_arrays(
            np.asarray(x, dtype=np.float64), np.asarray(y, dtype=np.float64)
        )
        return np.atleast_1d(xs.copy()), np.atleast_1d(ys.copy()), xs.shape

    def __repr__(self) -> str:
        inside = ", ".join(
            f"{k}={'?' if v is None else format(v, '.6g')}" for k, v in self.parameters.items()
        )
        return f"{type(self).__name__}({inside})"


def checked(
    value: float | str | None, name: str, *, zero: bool = True, dimension: str | None = None
) -> float | None:
    """Return a parameter as a finite float, or None.

    Parameters
    ----------
    value : float or None
        As given.
    name : str
        For the message.
    zero : bool, optional
        Whether zero is allowed.
    dimension : str, optional
        Where a text with a unit of it is taken, too.

    Returns
    -------
    float or None
        The value.

    Raises
    ------
    DataError
        If it is no number, not finite, or zero where that is not allowed.
    """
    if value is None:
        return None
    number = real(value, name, dimension=dimension, finite=False)
    if not math.isfinite(number) or (number == 0.0 and not zero):
        raise DataError(f"{name} must be finite{'' if zero else ' and not zero'}, got {value}")
    return number


# ---- what shapes with a few named parameters share: frozen fields, names checked, curvature guessed ----
# A subclass is a frozen dataclass whose parameters are fields named as in `units`. It writes
# `_height`, `_slopes` and `_derivatives`; this class checks names and unknown values before.


class Shape(Form):
    """A form whose parameters are fields of a frozen dataclass."""

    @property
    def parameters(self) -> dict[str, float | None]:
        """Shape parameters by name, SI; None where not known yet."""
        return {name: getattr(self, name) for name in self.units}

    def with_parameters(self, **values: float) -> Self:
        """Return the form with other values of some parameters.

        Parameters
        ----------
        **values : float
            By name, SI.

        Returns
        -------
        Form
            Another one; this one stays as it is.

        Raises
        ------
        DataError
            If a name is unknown or a value is not allowed.
        """
        self._check_names(values)
        return cast(Self, dataclasses.replace(cast(Any, self), **values))

    def height(self, x: FloatArray, y: FloatArray) -> FloatArray:
        """Return z at points of equal shape, float64; NaN outside the domain.

        Parameters
        ----------
        x, y : ndarray, m
            Positions in the form's frame.

        Returns
        -------
        ndarray, m
            Heights.

        Raises
        ------
        DataError
            If a parameter is not known yet.
        """
        return self._height(x, y)

    def slopes(self, x: FloatArray, y: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return dz/dx and dz/dy at points of equal shape; NaN where there is none.

        Parameters
        ----------
        x, y : ndarray, m
            Positions in the form's frame.

        Returns
        -------
        tuple of ndarray
            Slopes, dimensionless.

        Raises
        ------
        DataError
            If a parameter is not known yet.
        """
        return self._slopes(x, y)

    def derivatives(self, x: FloatArray, y: FloatArray, names: Sequence[str]) -> list[FloatArray]:
        """Return dz/dp for each named parameter; NaN where there is none.

        Parameters
        ----------
        x, y : ndarray, m
            Positions in the form's frame, of equal shape.
        names : sequence of str
            Of parameters.

        Returns
        -------
        list of ndarray
            In the order of the names, m per unit of the parameter.

        Raises
        ------
        DataError
            If a name is unknown or a parameter is not known yet.
        """
        self._check_names(names)
        return self._derivatives(x, y, names)

    def _height(self, x: FloatArray, y: FloatArray) -> FloatArray:
        raise NotImplementedError

    def _slopes(self, x: FloatArray, y: FloatArray) -> tuple[FloatArray, FloatArray]:
        raise NotImplementedError

    def _derivatives(self, x: FloatArray, y: FloatArray, names: Sequence[str]) -> list[FloatArray]:
        raise NotImplementedError

    def _check_names(self, names: Any) -> None:
        strange = [n for n in names if n not in self.parameters]
        if strange:
            have = ", ".join(self.parameters) or "none"
            raise DataError(
                f"{self.name} has no parameter {', '.join(map(str, strange))}; there are: {have}"
            )

    def _known(self, *names: str) -> list[float]:
        values = [self.parameters[n] for n in names]
        unknown = [n for n, v in zip(names, values, strict=True) if v is None]
        if unknown:
            raise DataError(
                f"{self.name} has no value for {', '.join(unknown)} yet: give one, or fit it"
            )
        return [float(v) for v in values if v is not None]

    def _set(self, **values: object) -> None:
        for name, value in values.items():
            object.__setattr__(self, name, value)


def root(square: FloatArray) -> FloatArray:
    """Return the square root in place, NaN where negative, without a warning."""
    outside = square < 0.0
    if outside.any():
        square[outside] = np.nan
    return np.sqrt(square, out=square)


def positive_root(square: FloatArray) -> FloatArray:
    """Return the square root in place, NaN where not positive: what a derivative divides by."""
    outside = square <= 0.0
    if outside.any():
        square[outside] = np.nan
    return np.sqrt(square, out=square)
