"""Values of the keys of a step as a person writes them: with unit, four digits, from SI.

The kind of a key (`metrosep.recipe.schema.Field`) tells its dimension, so that what is stored in SI
is printed as ``20 mm``, ``0.1 deg`` or ``4800 mm/min``, and an example of a key bears its unit.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any

from metrosep.core.options import KINDS
from metrosep.core.units import format_length
from metrosep.recipe.schema import Field

__all__ = ["DIMENSIONS", "placeholder", "shown", "typed_number"]

DIMENSIONS: Mapping[str, str] = {
    name: kind.dimension for name, kind in KINDS.items() if kind.dimension is not None
}
"""What the kinds of keys measure; kinds without a dimension are left out."""

_DEGREE = math.pi / 180.0
_STEPS = {
    "angle": ((_DEGREE, "deg"), (1e-6, "urad"), (1e-9, "nrad")),
    "time": ((3600.0, "h"), (60.0, "min"), (1.0, "s"), (1e-3, "ms"), (1e-6, "us")),
    "frequency": ((1e6, "MHz"), (1e3, "kHz"), (1.0, "Hz")),
    "speed": ((1.0 / 6e4, "mm/min"),),
}
_LEAST = {"deg": 0.02, "h": 2.0, "min": 2.0, "MHz": 1.0, "kHz": 1.0}
"""Below so much of a unit the next smaller one is taken."""


def typed_number(value: float, dimension: str, *, digits: int = 4) -> str:
    """Return a number in SI with the unit in which a person would type it.

    Examples
    --------
    >>> typed_number(0.02, "length"), typed_number(0.08, "speed")
    ('20 mm', '4800 mm/min')
    >>> typed_number(0.0, "length"), typed_number(5e-8, "angle"), typed_number(3600.0, "time")
    ('0 nm', '50 nrad', '60 min')
    """
    if dimension == "length":
        return "0 nm" if value == 0.0 else format_length(value, digits=digits)
    steps = _STEPS[dimension]
    size = abs(value)
    factor, unit = steps[-1]
    if value == 0.0:
        factor, unit = steps[0] if dimension != "time" else (1.0, "s")
    else:
        for each in steps:
            if size >= _LEAST.get(each[1], 1.0) * each[0] * (1.0 - 1e-9):
                factor, unit = each
                break
    return f"{_digits(value / factor, digits)} {unit}"


def _digits(value: float, digits: int) -> str:
    """Return significant digits, whole numbers in full: no exponent for a number of common size."""
    if abs(value) >= 10.0**digits and abs(value) < 1e7:
        return f"{value:.0f}"
    return f"{value:.{digits}g}"


def shown(value: Any, field: Field, *, unit: str = "") -> str:
    """Return the value of a key as a person reads it.

    Examples
    --------
    >>> shown([0.02], Field("lengths")), shown(0.0349, Field("angle")), shown(True, Field("flag"))
    ('20 mm', '2 deg', 'yes')
    """
    if value is None:
        return "–"
    if isinstance(value, Mapping):
        return ", ".join(f"{k} {shown(v, field, unit=unit)}" for k, v in value.items())
    if isinstance(value, list | tuple):
        inner = [shown(v, field, unit=unit) for v in value]
        nested = any(isinstance(v, list | tuple) for v in value)
        return ", ".join(f"({i})" if nested else i for i in inner)
    if isinstance(value, bool):
        return "yes" if value else "no"
    if isinstance(value, int | float) and not (field.kind == "waves" and isinstance(value, int)):
        dimension = {"m": "length", "rad": "angle"}.get(unit) or DIMENSIONS.get(field.kind)
        if dimension == "length" and value == 0.0 and field.kind != "uncertainty":
            return "0 mm"
        if dimension is not None:
            return typed_number(float(value), dimension)
        return str(value) if isinstance(value, int) else _digits(value, 4)
    return str(value)


def placeholder(key: str, field: Field) -> str:
    """Return what stands for the value of a key in an advice: dots, and the unit that it takes.

    Examples
    --------
    >>> placeholder("u_reading", Field("uncertainty")), placeholder("angles", Field("angles"))
    ('... nm', '... deg, ... deg')
    """
    units = {"length": "mm", "angle": "deg", "time": "s", "speed": "mm/min", "frequency": "Hz"}
    small = {"length": "nm", "angle": "urad"}
    dimension = DIMENSIONS.get(field.kind)
    if field.kind == "uncertainty" or (key.startswith(("u_", "zero", "sd"))):
        unit = small.get(str(dimension), units.get(str(dimension), ""))
    else:
        unit = units.get(str(dimension), "")
    one = f"... {unit}".strip()
    if field.kind == "flag":
        return "true"
    return (
        f"{one}, {one}"
        if KINDS[field.kind].is_list and field.kind != "waves" and dimension is not None
        else one
    )
