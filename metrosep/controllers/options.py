"""What a dialect must be told of a machine: declared once, checked, listed and asked for by name."""

from __future__ import annotations

import contextlib
import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, fields, replace
from typing import TYPE_CHECKING, Any

import numpy as np

from metrosep.compensation.area_errors import is_rotary
from metrosep.compensation.limits import Limits
from metrosep.core import numbers
from metrosep.core._arrays import ONE_PLACE, is_turn_apart
from metrosep.core.errors import DataError, Example, LimitError, TableError, UnitError
from metrosep.core.readable import did_you_mean
from metrosep.core.units import format_length, parse_quantity

if TYPE_CHECKING:
    from metrosep.compensation.table import CompensationTable

LIMIT_NAMES = tuple(f.name for f in fields(Limits))

APART = {
    "compensates": (
        "output_axis", "corrected_axis", "compensated_axis", "target_joint", "target_motor", "axis_number",
    ),
    "axis": (
        "input_axis", "column_axis", "moving_axis", "source_joint", "source_motor", "master_number",
    ),
    "file": ("table_index",),
}  # fmt: skip
"""Options that name the corrected axis, the looked-up axis and the file to a control: not the same for two."""

LIMIT_DIMENSIONS = {
    "stroke": "length",
    "reversal_jump": "length",
    "travel_low": "length",
    "travel_high": "length",
    "soft_low": "length",
    "soft_high": "length",
    "feed": "speed",
    "velocity_share": "speed",
    "acceleration_share": "acceleration",
    "acceleration": "acceleration",
    "servo_period": "time",
}
"""Dimension of each field of `Limits` that has one."""


@dataclass(frozen=True, slots=True)
class Option:
    """One fact about a machine or a file that a dialect takes."""

    name: str  # keyword of `metrosep.controllers.write`; NAME of ``--machine NAME=VALUE``
    help: str  # what it is, for lists and refusals
    # "integer", "number", "text", "flag", "choice", "object" (taken as it is, for a calibration that
    # no text can give), or a dimension such as "length": then a number in SI or a text with its unit
    kind: str
    default: Any = None  # None where it may stay away
    required: bool = False  # refuse to write without it
    choices: tuple[Any, ...] = ()
    lowest: float | None = None  # range of numbers, both ends allowed
    highest: float | None = None
    positive: bool = False  # numbers must be above zero

    def checked(self, value: Any, controller: str) -> Any:
        """Return a value, of a user or a text from a command line, as the dialect takes it, in SI."""
        if value is None:
            return None
        what = f"{controller}: {self.name}={value!r}"
        if self.kind == "text":
            return _text(value, what)
        if self.kind == "object":
            return value
        if self.kind == "flag":
            return _flag(value, what)
        if self.kind == "choice":
            return _choice(value, self.choices, what)
        if self.kind == "integer":
            return self._in_range(_integer(value, what), what)
        return self._in_range(_number(value, self.kind, what), what)

    def in_axis(self, value: Any, axes: Mapping[str, str]) -> Any:
        """Return a checked value, which does not depend on the axes of the table."""
        del axes
        return value

    def _in_range(self, value: Any, what: str) -> Any:
        if self.positive and not value > 0:
            raise DataError(f"{what} must be above zero ({self.help})")
        low, high = self.lowest, self.highest
        if (low is not None and value < low) or (high is not None and value > high):
            bounds = f"{'' if low is None else low} ... {'' if high is None else high}"
            raise DataError(f"{what} must lie in {bounds} ({self.help})")
        return value


def whole(
    name: str, what: str, lowest: int | None = None, highest: int | None = None, **more: Any
) -> Option:
    """Return the option of a whole number in a range."""
    return Option(name, what, "integer", lowest=lowest, highest=highest, **more)


def pick(name: str, what: str, choices: tuple[Any, ...], **more: Any) -> Option:
    """Return the option of one of a few values."""
    return Option(name, what, "choice", choices=choices, **more)


def flag(name: str, what: str, *, default: bool = False) -> Option:
    """Return the option of what is true or false."""
    return Option(name, what, "flag", default=default)


ENTRY_SIGN = pick(
    "entry_sign",
    "sign of an entry for an error e = actual - nominal: 1 writes +e, -1 writes -e",
    (1, -1),
    default=1,
)


def unit_option(name: str, what: str) -> Option:
    """Return the option of a unit that entries count."""
    return Option(name, what, "length", required=True, lowest=1e-12, highest=1e-3)


def _text(value: Any, what: str) -> str:
    if not isinstance(value, str) or not value.strip() or not value.isprintable():
        raise DataError(f"{what} must be a printable text")
    return value.strip()


def _flag(value: Any, what: str) -> bool:
    words = {"true": True, "yes": True, "1": True, "false": False, "no": False, "0": False}
    if isinstance(value, str) and value.strip().lower() in words:
        return words[value.strip().lower()]
    if not isinstance(value, bool):
        raise DataError(f"{what} must be true or false")
    return value


def _choice(value: Any, choices: Sequence[Any], what: str) -> Any:
    for choice in choices:
        if not isinstance(value, bool) and (value == choice or str(value).strip() == str(choice)):
            return choice
    if all(c in (1, -1) for c in choices) and str(value).strip() in ("+", "+1", "-"):
        return -1 if str(value).strip() == "-" else 1
    raise DataError(f"{what} must be one of {', '.join(map(str, choices))}")


def _integer(value: Any, what: str) -> int:
    """Return a whole number, of a text of digits, too."""
    try:
        whole = int(value) if isinstance(value, str) or value == int(value) else value
        return numbers.count(value if isinstance(value, bool) else whole, what, least=-(2**63))
    except (TypeError, ValueError, OverflowError):
        raise DataError(f"{what} must be a whole number") from None


def _number(value: Any, kind: str, what: str) -> float:
    """Return a finite number in SI; a plain number may be a text."""
    if kind != "number":
        try:
            return numbers.quantity(value, what.split("=", maxsplit=1)[0], kind)
        except UnitError as exc:
            raise DataError(str(exc)) from None
    try:
        return numbers.real(float(value) if isinstance(value, str) else value, what)
    except (DataError, ValueError):
        raise DataError(f"{what} must be a finite number") from None


def split_machine(
    machine: Mapping[str, Any], known: Sequence[Option], controller: str
) -> tuple[dict[str, Any], dict[str, Any]]:
    """Return what of a machine is for the dialect, and what is a limit."""
    own = {o.name for o in known}
    limits = {k: v for k, v in machine.items() if k in LIMIT_NAMES and k not in own}
    options = {k: v for k, v in machine.items() if k in own}
    unknown = [k for k in machine if k not in own and k not in limits]
    if unknown:
        raise DataError(
            f"unknown machine limit {unknown[0]!r}; known: {', '.join(LIMIT_NAMES)}; options of "
            f"{controller}: {', '.join(sorted(own)) or 'none'}.{did_you_mean(unknown[0], [*LIMIT_NAMES, *own])}"
        )
    return options, limits


def missing_facts(given: Mapping[str, Any], known: Sequence[Option]) -> list[Option]:
    """Return what a dialect needs and is not given."""
    return [o for o in known if o.required and given.get(o.name) is None]


def checked_options(
    given: Mapping[str, Any], known: Sequence[Option], controller: str, *, partial: bool = False
) -> dict[str, Any]:
    """Return every option of a dialect, checked, with defaults."""
    split_machine(given, known, controller)
    missing = missing_facts(given, known)
    if missing and not partial:
        asked = "; ".join(f"{o.name}= ({o.help})" for o in missing)
        raise DataError(f"{controller} cannot be written without {asked}").hinting(
            **{o.name: Example("...") for o in missing}
        )
    result = {}
    for option in known:
        value = given.get(option.name)
        if value is None:
            if partial:
                continue
            value = option.default
        result[option.name] = option.checked(value, controller)
    return result


_LOOKED_UP = ("travel_low", "travel_high", "soft_low", "soft_high")
_CORRECTED = ("stroke", "reversal_jump")
"""Limits along the looked-up and along the corrected axis: angles where it turns."""


def checked_limits(
    given: Mapping[str, Any], controller: str, axes: tuple[str, str] | None = None
) -> dict[str, Any]:
    """Return limits of a machine in SI, for a table over one axis that corrects another or itself.

    Without axes an angle stays a text, for it is not known whether the axis turns.
    """
    result = {}
    for name, value in given.items():
        kind = LIMIT_DIMENSIONS.get(name, "integer")
        which = 0 if name in _LOOKED_UP else 1 if name in _CORRECTED else None
        if which is not None and axes is None and is_angle(value):
            result[name] = value
            continue
        if which is not None and axes is not None and is_rotary(axes[which]):
            kind = "angle"
        result[name] = Option(name, "limit of the machine", kind).checked(value, controller)
    return result


# ---- lengths along an axis, as an option that a person types and as text ----

_FARTHEST = 1e6
"""No axis is as long, in m or rad."""


@dataclass(frozen=True, slots=True)
class AlongOption(Option):
    """A length, or an angle of an axis that turns; which one is known only with the table."""

    kind: str = "length or angle"
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
        for axis in ("X", "C"):
            with contextlib.suppress(DataError):
                along_axis(value, axis, what, positive=self.positive)
                return value
        raise DataError(
            f"{what}={str(value)[:40]!r} must be a length such as '2 mm', or an angle such as "
            f"'2 deg' of an axis that turns{', above zero' if self.positive else ''}"
        )


INCREMENT = AlongOption(
    "increment",
    "least input increment, unit of the interval; 1 um if omitted",
    positive=True,
    lowest=1e-9,
    highest=1e-3,
)
INTERVAL = AlongOption(
    "interval", "spacing of the points; that of the table if omitted", positive=True, highest=100.0
)
"""Options of several families."""


def unit_along(name: str, what: str, *, of: str = "axis") -> AlongOption:
    """Return the option of a unit that entries count, a length or an angle."""
    return AlongOption(name, what, required=True, positive=True, lowest=1e-12, highest=1e-3, of=of)  # fmt: skip


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


# ---- tables of one turn ----

TURN = 2.0 * math.pi
"""One turn, rad."""


def is_one_turn(table: CompensationTable) -> bool:
    """Return whether a table of an axis that turns covers one turn."""
    return is_rotary(table.axis) and is_turn_apart(*table.span)


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
    if first is not None and abs(low - first) > ONE_PLACE:
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
