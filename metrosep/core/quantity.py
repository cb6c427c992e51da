"""A number that may leave the package: value, unit, definition and standard uncertainty."""

from __future__ import annotations

import math
import re
from dataclasses import dataclass, replace
from typing import Any

from metrosep.core.errors import DataError, UnitError
from metrosep.core.numbers import is_real, real
from metrosep.core.public import PublicObject, shortened
from metrosep.core.units import (
    PIXEL,
    Pixels,
    format_engineering,
    parse_lateral,
    parse_quantity,
    parse_unit,
)


@dataclass(frozen=True, slots=True, eq=False, repr=False)
class Quantity(PublicObject):
    """A value in SI with unit, definition and standard uncertainty.

    Parameters
    ----------
    value : float
        In SI; NaN where it could not be determined.
    unit : str
        SI unit, ``"1"`` for a pure number.
    definition : str
        What the number is, with standard and region where they apply.
    u : float or None, optional
        Standard uncertainty (GUM), same unit; ``None`` where it is not known.
    symbol : str, optional
        Symbol of the field, such as ``"PV"``.
    dof : float or None, optional
        Degrees of freedom of ``u``; ``None`` where they are not known or do not matter.
    u_source : str, optional
        What ``u`` rests on, where a verdict must say so: ``"fit residual"``.
    guard : float or None, optional
        Guard band at a limit that this source asks for, same unit; ``None`` where it is t_0.95 u.

    Raises
    ------
    DataError
        If ``u`` is negative.
    """

    value: float
    unit: str
    definition: str
    u: float | None = None
    symbol: str = ""
    dof: float | None = None
    u_source: str = ""
    guard: float | None = None

    def __post_init__(self) -> None:
        for key in ("value", "u"):
            given = getattr(self, key)
            if given is not None or key == "value":
                number = real(given, f"{key} of {self.definition}", finite=False)
                object.__setattr__(self, key, number)
        if self.u is not None and self.u < 0.0:
            raise DataError(
                f"the standard uncertainty of {self.definition} is {self.u}, below zero"
            )

    def __float__(self) -> float:
        """Return the value in SI."""
        return self.value

    def _sum(self, other: Any, sign: float, word: str) -> Any:
        if not isinstance(other, Quantity):
            return NotImplemented
        if other.unit != self.unit:
            raise UnitError(
                f"{self.definition} is in {self.unit} and {other.definition} in {other.unit}; "
                "only like quantities add"
            )
        u = None if self.u is None or other.u is None else math.hypot(self.u, other.u)
        words = f"({self.definition}) {word} ({other.definition}), independent"
        return Quantity(self.value + sign * other.value, self.unit, words, u)

    def __add__(self, other: Any) -> Any:
        """Return the sum of independent quantities: u added in squares (GUM 5.1.2)."""
        return self._sum(other, 1.0, "plus")

    def __sub__(self, other: Any) -> Any:
        """Return the difference of independent quantities: u added in squares (GUM 5.1.2)."""
        return self._sum(other, -1.0, "minus")

    def __mul__(self, other: Any) -> Any:
        """Return the quantity times a number; a product of quantities would have another unit."""
        if not is_real(other) or isinstance(other, Quantity):
            return NotImplemented
        factor = real(other, "a factor")
        u = None if self.u is None else abs(factor) * self.u
        return replace(self, value=factor * self.value, u=u, symbol="")

    __rmul__ = __mul__

    def __truediv__(self, other: Any) -> Any:
        """Return the quantity over a number."""
        if not is_real(other) or isinstance(other, Quantity):
            return NotImplemented
        divisor = real(other, "a divisor")
        if divisor == 0.0:
            raise DataError(f"{self.definition} cannot be divided by zero")
        return self * (1.0 / divisor)

    def __abs__(self) -> Quantity:
        return replace(self, value=abs(self.value), symbol="")

    def _other_side(self, other: Any) -> float:
        """Return the value that it is compared with, in its own unit."""
        if isinstance(other, str) and self.unit == PIXEL:
            limit = parse_lateral(other, name="the limit")
            if isinstance(limit, Pixels):
                return limit
        elif isinstance(other, str):
            return parse_quantity(other, dimension=parse_unit(self.unit).dimension)
        if is_real(other) and self.unit == "1":
            return real(other, "a limit", finite=False)
        if isinstance(other, Quantity) and other.unit == self.unit:
            return other.value
        what = (
            f"{other.definition} in {other.unit}" if isinstance(other, Quantity) else repr(other)
        )
        raise UnitError(
            f"{self.definition} in {self.unit} cannot be compared with {what}; compare it with a "
            "quantity of the same unit, or with a text with its unit"
        )

    def __lt__(self, other: Any) -> bool:
        """Return whether the value is smaller; u does not count, and NaN is neither smaller nor larger."""
        return self.value < self._other_side(other)

    def __le__(self, other: Any) -> bool:
        return self.value <= self._other_side(other)

    def __gt__(self, other: Any) -> bool:
        return self.value > self._other_side(other)

    def __ge__(self, other: Any) -> bool:
        return self.value >= self._other_side(other)

    def __neg__(self) -> Quantity:
        return replace(self, value=-self.value, symbol="")

    def __repr__(self) -> str:
        name = f"{self.symbol} = " if self.symbol else ""
        return shortened(f"Quantity({name}{self}: {self.definition})")

    def __format__(self, spec: str) -> str:
        """Return the line, padded as a text; digits are of its float, which is in SI."""
        # a precision would cut the unit
        if not re.fullmatch(r"(.?[<>^])?([1-9]\d*)?s?", spec, re.DOTALL):
            raise DataError(
                f"a quantity is written with its unit and cannot be formatted with {spec!r}; "
                f"format its value in {self.unit}: float(q)"
            )
        return format(str(self), spec)

    def __str__(self) -> str:
        text = format_engineering(self.value, self.unit)
        if self.u is not None and math.isfinite(self.u):
            text += f" (u = {format_engineering(self.u, self.unit, digits=2)})"
        return text

    def to_dict(self) -> dict[str, float | str | None]:
        """Return the fields as plain values; NaN becomes None.

        Returns
        -------
        dict
            Keys ``value``, ``unit``, ``u``, ``definition``, ``symbol``; ``dof`` and ``u_source``
            where they are known. An infinite value becomes None too.
        """
        source = {"u_source": self.u_source, "dof": self.dof} if self.u_source else {}
        return {
            "value": self.value if math.isfinite(self.value) else None,
            "unit": self.unit,
            "u": None if self.u is None or not math.isfinite(self.u) else self.u,
            "definition": self.definition,
            "symbol": self.symbol,
            **source,
        }
