"""A form that the user writes as a formula."""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass
from typing import Self

import numpy as np

from metrosep.core._arrays import FloatArray
from metrosep.core.errors import DataError
from metrosep.forms._formula import (
    CONSTANTS,
    FUNCTION_NAMES,
    Dual,
    Tree,
    Value,
    evaluate,
    names_in,
    parse,
)
from metrosep.forms._shape import Shape
from metrosep.forms.base import checked
from metrosep.forms.freedoms import RIGID

__all__ = ["Expression"]


_COORDINATES = ("x", "y", "r", "theta")
_RESERVED = {*_COORDINATES, *CONSTANTS, *FUNCTION_NAMES, *RIGID}


@dataclass(frozen=True, init=False, repr=False)
class Expression(Shape):
    """A form ``z = f(x, y)`` given as text, with named parameters.

    Parameters
    ----------
    text : str
        Formula in ``x``, ``y``, ``r = sqrt(x^2 + y^2)``, ``theta = atan2(y, x)``, ``pi`` and the
        parameters, with ``+ - * / **``, brackets and the functions sin, cos, tan, arcsin, arccos,
        arctan, sinh, cosh, tanh, exp, log, log10, sqrt, abs. At most 2000 characters.
    units : mapping of str to str, optional
        SI units of parameters, for reports; "" where not given.
    has_centre : bool, optional
        Whether x and y count from the middle of what was measured, on a map that declares no
        origin.
    **parameters : float or None
        Values by name, SI; None where not known: a fit then needs a starting value.

    Raises
    ------
    DataError
        If the text is not such a formula, names something else, or does not hold a parameter; if a
        parameter has a reserved name or is not finite.

    Notes
    -----
    The text is parsed, never run. Gradient and parameter derivatives are exact: each part of the
    formula carries its own (forward-mode differentiation). A point where the formula has no finite
    value is outside the domain, NaN. The slopes of r and theta at the centre, where they have
    none, count as 0, which is right for every smooth form such as ``r**3`` and ``r**2 * cos(2 *
    theta)``.

    Examples
    --------
    >>> form = Expression("a*x**2 + b*sin(2*pi*y/L)", a=1.0, b=1e-7, L=1e-3)
    >>> form(2e-3, 0.0).item()
    4e-06
    >>> form.parameters
    {'a': 1.0, 'b': 1e-07, 'L': 0.001}
    """

    text: str
    values: tuple[tuple[str, float | None], ...]
    unit_pairs: tuple[tuple[str, str], ...]
    has_centre: bool
    tree: Tree

    name = "expression"

    def __init__(
        self,
        text: str,
        /,
        *,
        units: Mapping[str, str] | None = None,
        has_centre: bool = True,
        **parameters: float | None,
    ) -> None:
        reserved = sorted(_RESERVED & parameters.keys())
        if reserved:
            raise DataError(
                f"{', '.join(reserved)} cannot name a parameter: a formula or a fit uses it itself"
            )
        tree = parse(text, (*_COORDINATES, *parameters))
        idle = [n for n in parameters if n not in names_in(tree)]
        if idle:
            raise DataError(f"the formula does not hold the parameter {', '.join(idle)}")
        strange = sorted((units or {}).keys() - parameters.keys())
        if strange:
            raise DataError(f"units names {', '.join(strange)}, which is no parameter")
        unit_of = {n: (units or {}).get(n, "") for n in parameters}
        self._set(
            text=text,
            values=tuple((n, checked(v, n)) for n, v in parameters.items()),
            unit_pairs=tuple(unit_of.items()),
            units=unit_of,
            has_centre=bool(has_centre),
            tree=tree,
        )

    @property
    def parameters(self) -> dict[str, float | None]:
        """Parameters by name, SI; None where not known yet."""
        return dict(self.values)

    def with_parameters(self, **values: float) -> Self:
        """Return the form with other values of some parameters.

        Parameters
        ----------
        **values : float
            By name, SI.

        Returns
        -------
        Expression
            Another one with the same formula.

        Raises
        ------
        DataError
            If a name is unknown or a value is not finite.
        """
        self._check_names(values)
        now = self.parameters | values
        return type(self)(self.text, units=self.units, has_centre=self.has_centre, **now)

    def __repr__(self) -> str:
        inside = super().__repr__().partition("(")[2]
        return f"Expression({self.text!r}, {inside}".replace(", )", ")")

    def _evaluate(
        self, x: FloatArray, y: FloatArray, by: Collection[str]
    ) -> tuple[FloatArray, dict[str, FloatArray]]:
        """Return heights and their derivatives by coordinates or parameters."""
        numbers = self._known(*self.parameters)
        names: dict[str, Dual] = {
            n: (np.float64(v), {n: 1.0} if n in by else {})
            for n, v in zip(self.parameters, numbers, strict=True)
        }
        used = names_in(self.tree)
        names["x"] = (x, {"x": 1.0} if "x" in by else {})
        names["y"] = (y, {"y": 1.0} if "y" in by else {})
        if used & {"r", "theta"}:
            names |= _polar(x, y, with_slopes="x" in by)
        with np.errstate(all="ignore"):
            value, slopes = evaluate(self.tree, names)
            found = {n: _finite(slopes.get(n, 0.0), x, value) for n in by}
            return _finite(value, x, value), found

    def _height(self, x: FloatArray, y: FloatArray) -> FloatArray:
        return self._evaluate(x, y, ())[0]

    def _slopes(self, x: FloatArray, y: FloatArray) -> tuple[FloatArray, FloatArray]:
        found = self._evaluate(x, y, ("x", "y"))[1]
        return found["x"], found["y"]

    def _derivatives(self, x: FloatArray, y: FloatArray, names: Sequence[str]) -> list[FloatArray]:
        found = self._evaluate(x, y, tuple(names))[1]
        return [found[n] for n in names]


def _polar(x: FloatArray, y: FloatArray, *, with_slopes: bool) -> dict[str, Dual]:
    r, theta = np.hypot(x, y), np.arctan2(y, x)
    if not with_slopes:
        return {"r": (r, {}), "theta": (theta, {})}
    safe = np.where(r == 0.0, 1.0, r)
    c, s = x / safe, y / safe
    return {"r": (r, {"x": c, "y": s}), "theta": (theta, {"x": -s / safe, "y": c / safe})}


def _finite(value: Value, x: FloatArray, height: Value) -> FloatArray:
    """Return a full array, NaN where the value or the height is not finite."""
    full = np.array(np.broadcast_to(np.asarray(value, dtype=np.float64), x.shape))
    full[~(np.isfinite(full) & np.isfinite(height) & np.isfinite(x))] = np.nan
    return full
