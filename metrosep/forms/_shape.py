"""What shapes with a few named parameters share: frozen fields, names checked, curvature guessed.

A subclass is a frozen dataclass whose parameters are fields named as in `units`. It writes
`_height`, `_slopes` and `_derivatives`; this class checks names and unknown values before.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from typing import Any, Self, cast

import numpy as np

from metrosep.core._arrays import FloatArray
from metrosep.core.errors import DataError
from metrosep.forms.base import Form


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
