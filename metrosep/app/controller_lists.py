"""The dialects as plain values, from which a form is made: options, limits, how the sign is known."""

from __future__ import annotations

from typing import Any

from metrosep.app.messages import plain
from metrosep.compensation.limits import Limits
from metrosep.controllers.base import Dialect, DialectInfo
from metrosep.controllers.options import LIMIT_DIMENSIONS, Option
from metrosep.controllers.registry import find, names
from metrosep.core.units import format_engineering

__all__ = ["described_controller", "described_controllers", "machine_facts", "sign_words"]

_SIGN = {
    "confirmed": "The sign was confirmed by a run of the controller itself, or by definition",
    "documented": "The sign is documented by the maker",
    "stated": "The sign follows a fact that you state",
    "unconfirmed": "The sign is NOT documented: try it on the machine first",
}
_UNITS = {
    "length": ("m", "10 um"),
    "length or angle": ("m", "1 mm"),
    "angle": ("rad", "90 deg"),
    "speed": ("m/s", "60 mm/min"),
    "acceleration": ("m/s^2", "0.1 m/s^2"),
    "time": ("s", "1 ms"),
    "frequency": ("Hz", "50 Hz"),
    "voltage": ("V", "10 V"),
}
"""SI unit of a kind of option, and what a person may write."""

_MACHINE = {
    "stroke": "largest correction that the actuator can do",
    "feed": "largest feed of the looked-up axis",
    "velocity_share": "speed of the corrected axis that the correction may use",
    "acceleration_share": "acceleration of the corrected axis that the correction may use",
    "reversal_jump": "largest step of the correction at a reversal",
    "acceleration": "MAX_ACCELERATION of the joint (LinuxCNC), for its dead zone",
    "servo_period": "servo period (LinuxCNC), for its dead zone",
    "travel_low": "lowest commanded position, which the table must cover",
    "travel_high": "highest commanded position, which the table must cover",
    "soft_low": "lower software limit of the corrected axis",
    "soft_high": "upper software limit of the corrected axis",
    "max_points": "most entries that the controller takes, where it is not the usual number",
}


def described_controllers() -> list[dict[str, Any]]:
    """Return every dialect, in the order in which they are listed.

    Examples
    --------
    >>> described_controllers()[0]["id"]
    'linuxcnc'
    """
    return [described_controller(find(name)) for name in names()]


def described_controller(dialect: Dialect) -> dict[str, Any]:
    """Return what a form needs to know of a dialect."""
    info = dialect.info
    of_one_axis = info.carries != "map"
    return {
        "id": info.id,
        "title": info.title,
        "carries": info.carries,
        "fits": of_one_axis,
        "why": "" if of_one_axis else "holds maps over two axes, not the error of one axis",
        "suffix": info.suffix,
        "page": info.page,
        "options": [_described(option) for option in dialect.options],
        "limits": _limits(info),
        "sign": {
            "status": info.sign,
            "words": sign_words(info),
            "needs_trial": info.sign == "unconfirmed",
        },
        "notes": _notes(info),
    }


def sign_words(info: DialectInfo) -> str:
    """Return one sentence on the sign of a dialect."""
    return (
        f"The correction = \u2212error is ADDED to the command. An entry holds: {info.entry}. "
        f"{_SIGN[info.sign]} ({info.sign_status})."
    )


def machine_facts() -> list[dict[str, Any]]:
    """Return the limits that every machine may have, as options of a form."""
    fields = [name for name in Limits.__dataclass_fields__ if name in _MACHINE]
    return [
        _described(Option(name, _MACHINE[name], LIMIT_DIMENSIONS.get(name, "integer")))
        for name in fields
    ]


def _described(option: Option) -> dict[str, Any]:
    return {
        "name": option.name,
        "kind": option.kind,
        "choices": plain(list(option.choices)),
        "default": plain(option.default),
        "usual": _usual(option),
        "help": option.help,
        "required": option.required,
        "unit": _UNITS.get(option.kind, ("", ""))[1],
        "low": plain(option.lowest),
        "high": plain(option.highest),
    }


def _usual(option: Option) -> str:
    """Return the default as a person writes it."""
    if option.default is None:
        return ""
    if option.kind in _UNITS and isinstance(option.default, int | float):
        return format_engineering(float(option.default), _UNITS[option.kind][0])
    return str(option.default)


def _limits(info: DialectInfo) -> list[str]:
    said = [
        f"at most {info.max_points} entries"
        if info.max_points
        else "entries: as many as you like",
        "any spacing of the entries" if info.spacing == "free" else "entries evenly spaced",
        "forward and reverse may differ"
        if info.directions == "two"
        else "one column for both directions",
        f"outside the table: {info.outside}",
    ]
    if info.resolution:
        said.append(f"smallest step of an entry: {info.resolution}")
    if info.reference_rule:
        said.append(f"reference: {info.reference_rule}")
    return said


def _notes(info: DialectInfo) -> list[str]:
    return [f"units in the file: {info.units}", f"proof: {info.proof}", *info.activation]
