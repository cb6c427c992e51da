"""Axes that turn: lengths along an axis that are angles there, and tables that close over one turn.

Inside, positions and corrections of an axis that turns are in rad. An option that is a length of the
looked-up or the corrected axis takes an angle where that axis turns, and refuses the other kind.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from metrosep.compensation.area_errors import format_along, format_amount, format_span, is_rotary
from metrosep.compensation.table import CompensationTable
from metrosep.controllers.base import identity, load_sidecar
from metrosep.controllers.options import Option
from metrosep.core.errors import CorruptFileError, DataError, LimitError, TableError, UnitError
from metrosep.core.units import format_length, parse_quantity

__all__ = [
    "INCREMENT",
    "INTERVAL",
    "TURN",
    "AlongOption",
    "along_axis",
    "axes_of",
    "chosen",
    "closed",
    "format_along",
    "format_amount",
    "format_span",
    "in_axes",
    "is_angle",
    "is_one_turn",
    "letter_in_file",
    "require_turn",
    "require_whole_turn",
    "unit_along",
]

# ---- lengths along an axis, as an option that a person types and as text ----

_FARTHEST = 1e6
"""No axis is as long, in m or rad."""


@dataclass(frozen=True, slots=True)
class AlongOption(Option):
    """A length, or an angle of an axis that turns; which one is known only with the table."""

    of: str = "axis"  # axis of the table that it lies along: "axis" or "compensates"

    def in_axis(self, value: Any, axes: Mapping[str, str]) -> Any:
        """Return the value in m, or in rad where the axis turns."""
        number = along_axis(value, axes[self.of], self.name, positive=self.positive)
        return None if number is None else self._in_range(number, f"{self.name}={value!r}")

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


INCREMENT = AlongOption(
    "increment",
    "least input increment, unit of the interval; 1 um if omitted",
    "length or angle",
    positive=True,
    lowest=1e-9,
    highest=1e-3,
)
INTERVAL = AlongOption(
    "interval",
    "spacing of the points; that of the table if omitted",
    "length or angle",
    positive=True,
    highest=100.0,
)
"""Options of several families."""


def unit_along(name: str, what: str, *, of: str = "axis") -> AlongOption:
    """Return the option of a unit that entries count, a length or an angle."""
    return AlongOption(
        name, what, "length or angle", required=True, positive=True, lowest=1e-12, highest=1e-3,
        of=of,
    )  # fmt: skip


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


def axes_of(table: Any) -> dict[str, str]:
    """Return the looked-up and the corrected axis of a table, by the names that options use."""
    return {"axis": table.axis, "compensates": table.compensates}


def in_axes(
    known: Iterable[Option], options: Mapping[str, Any], axes: Mapping[str, str]
) -> dict[str, Any]:
    """Return options with lengths along an axis in m, or in rad where it turns."""
    by_name = {o.name: o for o in known}
    return {n: by_name[n].in_axis(v, axes) if n in by_name else v for n, v in options.items()}


def chosen(known: Iterable[Option], options: Mapping[str, Any]) -> dict[str, Any]:
    """Return the options along an axis in SI, as a sidecar keeps them."""
    names = [o.name for o in known if isinstance(o, AlongOption)]
    return {n: options[n] for n in names if options.get(n) is not None}


def is_angle(value: Any) -> bool:
    """Return whether a value that a person typed is an angle with its unit."""
    if not isinstance(value, str):
        return False
    try:
        along_axis(value, "C", "", positive=False)
    except DataError:
        return False
    return True


def letter_in_file(
    path: Path, turns: bool | None, options: Mapping[str, Any], otherwise: str = "X"
) -> str:
    """Return an axis that a file does not name: of its sidecar, its unit, or the units that a person types."""
    if load_sidecar(path).get("table"):
        axis = str(identity(path, first=0.0)["axis"])
        if turns is not None and is_rotary(axis) != turns:
            raise CorruptFileError(
                path,
                f"the file is one of {'degrees' if turns else 'mm'}, its sidecar says axis {axis}",
                hint="use the sidecar that fits, or write the table again",
            )
        return axis
    if turns is None:
        turns = any(map(is_angle, options.values()))
    return "C" if turns else otherwise


# ---- tables of one turn ----

TURN = 2.0 * math.pi
"""One turn, rad."""
_CLOSED = math.radians(1e-6)
"""Deviation from one turn that decimals of degrees explain."""


def is_one_turn(table: CompensationTable) -> bool:
    """Return whether a table of an axis that turns covers one turn."""
    low, high = table.span
    return is_rotary(table.axis) and abs(high - low - TURN) <= _CLOSED


def require_turn(
    table: CompensationTable, step: float, *, first: float | None = None
) -> CompensationTable:
    """Return a modulo table with its ends made equal, and refuse one that is not closed over one turn."""
    if not is_rotary(table.axis):
        raise TableError(f"modulo=True is for an axis that turns; {table.axis} is linear")
    low, high = table.span
    if not is_one_turn(table):
        raise TableError(
            f"modulo=True needs a table over one turn, this one covers {math.degrees(low):.9g} ... "
            f"{math.degrees(high):.9g} deg; append the position 360 deg after the first one, with the "
            "first one's correction"
        )
    if first is not None and abs(low - first) > _CLOSED:
        raise TableError(
            f"the table of one turn must begin at {math.degrees(first):.9g} deg here and begins at "
            f"{math.degrees(low):.9g} deg; make it from there on over 360 deg"
        )
    return closed(table, step)


def closed(table: CompensationTable, step: float) -> CompensationTable:
    """Return a table of one turn with both ends equal, and refuse one whose error does not come back.

    `step` is that of an entry, in the unit of the corrections: a net step would act at every turn.
    """
    for way, column in (("forward", table.forward), ("reverse", table.reverse)):
        if column is None:
            continue
        u = 0.0 if table.u is None else float(table.u[-1])
        net = abs(float(column[-1] - column[0]))
        if round(column[0] / step) != round(column[-1] / step) or net > max(2.0 * u, step):
            amount = (
                f"{math.degrees(net) * 3600:.4g} arcsec"
                if is_rotary(table.compensates)
                else format_length(net)
            )
            raise TableError(
                f"the {way} correction differs by {amount} between the "
                "first position and one turn later: the step would act at every turn; the values at "
                "0 and 360 deg must be the same"
            )
    reverse = table.reverse
    return replace(
        table,
        forward=np.append(table.forward[:-1], table.forward[0]),
        reverse=None if reverse is None else np.append(reverse[:-1], reverse[0]),
    )


def require_whole_turn(interval: float | None, title: str) -> None:
    """Refuse an interval that does not divide a turn."""
    if interval is None:
        return
    parts = TURN / interval
    if abs(parts - round(parts)) > 1e-6 or round(parts) < 1:
        raise LimitError(
            f"{title}: one turn is {parts:.9g} intervals of {math.degrees(interval):.9g} deg; a table of "
            "one turn needs a whole number of them"
        )
