"""What a dialect must be told of a machine: declared once, checked, listed and asked for by name."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, fields
from typing import Any

from metrosep.compensation.area_errors import is_rotary
from metrosep.compensation.limits import Limits
from metrosep.core import numbers
from metrosep.core.errors import DataError, UnitError

__all__ = [
    "ENTRY_SIGN",
    "LIMIT_DIMENSIONS",
    "LIMIT_NAMES",
    "Option",
    "checked_limits",
    "checked_options",
    "split_machine",
]

LIMIT_NAMES = tuple(f.name for f in fields(Limits))

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


ENTRY_SIGN = Option(
    "entry_sign",
    "sign of an entry for an error e = actual - nominal: 1 writes +e, -1 writes -e",
    "choice",
    default=1,
    choices=(1, -1),
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
            raise DataError(f"{what}: {exc}") from None
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
            f"{controller}: {', '.join(sorted(own)) or 'none'}"
        )
    return options, limits


def checked_options(
    given: Mapping[str, Any], known: Sequence[Option], controller: str, *, partial: bool = False
) -> dict[str, Any]:
    """Return every option of a dialect, checked, with defaults."""
    split_machine(given, known, controller)
    missing = [o for o in known if o.required and given.get(o.name) is None]
    if missing and not partial:
        asked = "; ".join(f"{o.name}= ({o.help})" for o in missing)
        raise DataError(
            f"{controller} cannot be written without {asked}; give it as a keyword, or with "
            f"--machine {missing[0].name}=... on the command line"
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


def _is_angle(value: Any) -> bool:
    try:
        return isinstance(value, str) and math.isfinite(numbers.quantity(value, "limit", "angle"))
    except UnitError:
        return False


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
        if which is not None and axes is None and _is_angle(value):
            result[name] = value
            continue
        if which is not None and axes is not None and is_rotary(axes[which]):
            kind = "angle"
        result[name] = Option(name, "limit of the machine", kind).checked(value, controller)
    return result
