"""Limits of the axes as a recipe states them: texts whose units say what is limited."""

from __future__ import annotations

import re
from collections.abc import Mapping
from typing import Any

import numpy as np

from metrosep.core.errors import DataError, UnitError
from metrosep.core.options import Option
from metrosep.core.units import Unit, parse_quantity, parse_unit, unit_dimension

_PER = re.compile(r"(.*)/\s*([^\W\d]+)(?:\^?([23]))?")
_LIMITED = {None: "velocity", "2": "acceleration", "3": "jerk"}
_AS_ONE = {"speed": "velocity", "acceleration": "acceleration", "frequency": "velocity"}
_HELP = 'what {} can do, by the unit: "20 mm/s", "0.5 m/s2", "100 m/s3"'
LIMITS: Mapping[str, Option] = {
    "x_limits": Option("texts", help=_HELP.format("X")),
    "c_limits": Option("texts", help=_HELP.format("C").replace("mm", "deg").replace(" m", " rad")),
    "z_limits": Option("texts", help=_HELP.format("Z")),
}
TRAVEL: Mapping[str, Option] = {
    "x_travel": Option(
        "lengths", help='least and largest radius that the tip can go to, "0 mm, 60 mm"'
    ),
    "z_travel": Option(
        "lengths",
        help='least and largest height that the tip can go to, 0 where the form is 0, "-5 mm, 20 mm"',
    ),
}


def limits_of(options: Mapping[str, Any]) -> dict[str, Any]:
    """Return the `AxisLimits` of X, C and Z that a step states."""
    return {
        axis: _limits_of(options[f"{axis.lower()}_limits"], axis)
        for axis in ("X", "C", "Z")
        if f"{axis.lower()}_limits" in options
    }


def _limits_of(texts: tuple[str, ...], axis: str) -> Any:
    """Return the `AxisLimits` of texts whose units say what they limit."""
    from metrosep.process import AxisLimits

    found: dict[str, float] = {}
    key = f"{axis.lower()}_limits"
    for text in texts:
        name, turns, value = _limit_of(text, key)
        if turns != (axis == "C"):
            raise DataError(
                f"{key} has {text!r}: {axis} {'turns' if axis == 'C' else 'moves along'}"
            )
        if name in found:
            raise DataError(f"{key} states the {name} twice")
        found[name] = value
    return AxisLimits(**found)


def _limit_of(text: str, key: str) -> tuple[str, bool, float]:
    """Return what a text limits, whether it is of an axis that turns, and the limit in SI."""
    plain = text.strip().replace("²", "2").replace("³", "3")
    whole = unit_dimension(plain) or ""
    if whole in _AS_ONE:
        value = parse_quantity(plain, dimension=whole, name=key)
        turns = whole == "frequency"
        return _AS_ONE[whole], turns, 2.0 * np.pi * value if turns else value
    match = _PER.fullmatch(plain)
    time = _unit_of(match[2]) if match else None
    size = _unit_of(re.sub(r"^[-+.\d\s]*(?:[eE][-+]?\d+)?", "", match[1])) if match else None
    if (
        match is None
        or time is None
        or size is None
        or time.dimension != "time"
        or size.dimension not in ("length", "angle")
        or (match[3] and time.name != "s")
    ):
        raise DataError(
            f'{key} has {text!r}; write limits as "20 mm/s", "0.5 m/s2", "100 m/s3"; of C as "360 deg/s"'
        )
    value = parse_quantity(match[1], dimension=size.dimension, name=key)
    return _LIMITED[match[3]], size.dimension == "angle", value / time.factor


def _unit_of(text: str) -> Unit | None:
    """Return the unit that a text names, None where it names none."""
    try:
        return parse_unit(text)
    except UnitError:
        return None
