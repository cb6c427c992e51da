"""Values of the keys of a step as a person writes them: with unit, four digits, from SI.

The kind of a key (`metrosep.recipe.schema.Field`) tells its dimension, so that what is stored in SI
is printed as ``20 mm``, ``0.1 deg`` or ``4800 mm/min``, and an example of a key bears its unit.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from metrosep.core.options import KINDS
from metrosep.core.readable import digits_of, typed_number
from metrosep.core.units import SURROUNDINGS, TYPICAL
from metrosep.recipe.schema import Field

__all__ = ["DIMENSIONS", "placeholder", "shown"]

DIMENSIONS: Mapping[str, str] = {
    name: kind.dimension for name, kind in KINDS.items() if kind.dimension is not None
}
"""What the kinds of keys measure; kinds without a dimension are left out."""


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
        return str(value) if isinstance(value, int) else digits_of(value)
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
    if dimension in SURROUNDINGS:
        unit = TYPICAL[dimension].split()[-1]
    one = f"... {unit}".strip()
    if field.kind == "flag":
        return "true"
    return (
        f"{one}, {one}"
        if KINDS[field.kind].is_list and field.kind != "waves" and dimension is not None
        else one
    )
