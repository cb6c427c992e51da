"""Lengths along an axis: an angle where it turns, as an option that a person types and as text."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numpy as np

from metrosep.compensation.area_errors import is_rotary
from metrosep.controllers.options import Option
from metrosep.core.errors import DataError, UnitError
from metrosep.core.units import format_length, parse_quantity

__all__ = ["AlongOption", "along_axis", "format_amount", "format_span"]

_FARTHEST = 1e6
"""No axis is as long, in m or rad."""


@dataclass(frozen=True, slots=True)
class AlongOption(Option):
    """A length, or an angle of an axis that turns; which one is known only with the table."""

    def checked(self, value: Any, controller: str) -> Any:
        """Return the value as it is, if it is a number or a text with a unit of either kind."""
        if value is None:
            return None
        what = f"{controller}: {self.name}"
        try:
            along_axis(value, "X", what, positive=self.positive)
        except DataError:
            try:
                along_axis(value, "C", what, positive=self.positive)
            except DataError:
                raise DataError(
                    f"{what}={str(value)[:40]!r} must be a length such as '2 mm', or an angle such as "
                    f"'2 deg' of an axis that turns{', above zero' if self.positive else ''}"
                ) from None
        return value


def along_axis(value: Any, axis: str, name: str, *, positive: bool = True) -> float | None:
    """Return an option that is a length along an axis, or an angle where the axis turns.

    Examples
    --------
    >>> along_axis("20 mm", "X", "spacing"), round(along_axis("2 deg", "C", "spacing"), 6)
    (0.02, 0.034907)
    """
    if value is None:
        return None
    dimension = "angle" if is_rotary(axis) else "length"
    if isinstance(value, bool) or not isinstance(value, str | int | float | np.number):
        raise DataError(f"{name}={value!r} is not {dimension} along {axis}")
    try:
        number = parse_quantity(
            value if isinstance(value, str) else float(value), dimension=dimension, name=name
        )
    except (UnitError, OverflowError) as exc:
        turns = f"{axis} turns" if is_rotary(axis) else f"{axis} does not turn"
        raise DataError(f"{name}={str(value)[:40]!r}: {exc} ({turns})") from None
    if not abs(number) < _FARTHEST or (positive and not number > 0.0):
        raise DataError(
            f"{name}={str(value)[:40]!r} must be {'above zero' if positive else 'a position'}"
        )
    return number


def format_span(axis: str, value: float, *, digits: int = 4) -> str:
    """Return a distance along an axis as text with its unit.

    Examples
    --------
    >>> format_span("X", 5e-4), format_span("C", 0.03490658503988659)
    ('0.5 mm', '2 deg')
    """
    if is_rotary(axis):
        return f"{math.degrees(value):.{digits}g} deg"
    return f"{value * 1e3:.{digits}g} mm"


def format_amount(axis: str, value: float, *, digits: int = 4) -> str:
    """Return a small amount of an axis as text with its unit.

    Examples
    --------
    >>> format_amount("X", 2.5e-7), format_amount("C", 2.5e-7)
    ('250 nm', '0.25 urad')
    """
    if is_rotary(axis):
        return f"{value * 1e6:.{digits}g} urad"
    return format_length(value, digits=digits)
