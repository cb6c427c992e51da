"""Tables that describe a kinematic chain: what a TOML file may hold, and what is wrong with it.

::

    name = "my lathe"
    [parameters]
    radius = "radius of the workpiece in m"     # a value must be given on loading
    [[element]]
    name = "X"
    branch = "tool"                             # or "workpiece"
    kind = "linear"                             # or "rotary", "fixed"
    direction = "-X"                            # or a unit vector
    location_mm = [12.5, 0, 0]                  # or location_m = ["radius", 0, 0]
    errors_of = "body"                          # or "tool": against the workpiece
    error_frame = "after"                       # or "before"; see Element
    measured_at_mm = [0, 0, 0]                  # where the errors were read
    travel_mm = [-50, 250]                      # or travel_deg; poses beyond it are refused
    errors = "XYZABC"                           # default: all of an axis that moves
    location_errors = { B0Z = { B = -1 } }      # or a list ["B0X"]: plain turns and offsets
"""

from __future__ import annotations

import errno
import math
import tomllib
from collections.abc import Mapping, Sequence
from os import PathLike
from typing import Any

from metrosep.core import numbers
from metrosep.core.atomic import MACHINE_BYTES, read_plain_text
from metrosep.core.errors import DataError, MetrosepError
from metrosep.machine.elements import DIRECTIONS, Element

_LENGTHS = {"m": 1.0, "mm": 1e-3, "um": 1e-6}
_ANGLES = {"rad": 1.0, "deg": math.pi / 180.0}
_TABLE_KEYS = ("name", "description", "parameters", "element")
_PLAIN_KEYS = ("name", "branch", "kind", "direction", "error_frame", "errors_of", "errors", "location_errors",
               "parked", "parallel_to")  # fmt: skip
_UNIT_KEYS = (
    {f"location_{u}": ("location", f) for u, f in _LENGTHS.items()}
    | {f"angle_{u}": ("angle", f) for u, f in _ANGLES.items()}
    | {f"measured_at_{u}": ("measured_at", f) for u, f in _LENGTHS.items()}
    | {f"travel_{u}": ("travel", f) for u, f in (_LENGTHS | _ANGLES).items()}
)


def toml_table(path: str | PathLike[str]) -> dict[str, Any]:
    """Return the content of a TOML file."""
    try:
        return tomllib.loads(read_plain_text(path, MACHINE_BYTES).removeprefix("\ufeff"))
    except OSError as exc:
        if exc.errno != errno.EILSEQ:
            raise
        raise DataError(f"{path}: {exc.strerror}") from None
    except tomllib.TOMLDecodeError as exc:
        raise DataError(f"{path} is not a TOML file: {exc}") from None
    except RecursionError:
        raise DataError(
            f"{path} is not a description of a chain: it is nested too deeply"
        ) from None


def chain_parts(
    table: Mapping[str, Any], parameters: Mapping[str, float], *, source: str = "chain"
) -> tuple[list[Element], str, str]:
    """Return the elements, the name and the description that a table holds."""
    _known(table, _TABLE_KEYS, source)
    for key in ("name", "description"):
        if not isinstance(table.get(key, ""), str):
            raise DataError(f"{source}: key {key!r} must be a text, got {str(table[key])[:60]}")
    values = _parameters(table.get("parameters", {}), parameters, source)
    rows = table.get("element", [])
    if not isinstance(rows, Sequence) or isinstance(rows, str) or not rows:
        raise DataError(f"{source}: no element; write one [[element]] table for each axis")
    elements = [_element(row, values, f"{source}, element {i}") for i, row in enumerate(rows, 1)]
    return elements, table.get("name", ""), table.get("description", "")


def _known(table: object, keys: Sequence[str], where: str) -> None:
    if not isinstance(table, Mapping):
        raise DataError(f"{where} must be a table of keys and values, got {table!r}")
    for key in table:
        if key not in keys:
            stem = str(key).partition("_")[0]
            units = [k for k in keys if k in _UNIT_KEYS and k.startswith(f"{stem}_")]
            hint = f"a unit belongs to the key: {', '.join(units)}" if units else ""
            raise DataError(
                f"{where}: unknown key {key!r}; {hint or 'known: ' + ', '.join(keys)} "
                "(docs/how-to/describe-a-machine.md has an example)"
            )


def _parameters(declared: Any, given: Mapping[str, float], source: str) -> dict[str, float]:
    if not isinstance(declared, Mapping):
        raise DataError(
            f"{source}: parameters is a table of names and what they mean, such as "
            f'[parameters] and radius = "radius in m"; got {declared!r}'
        )
    for name in given:
        if name not in declared:
            known = ", ".join(declared) or "none"
            raise DataError(f"{source}: there is no parameter {name!r}; it has {known}")
    for name, meaning in declared.items():
        if name not in given:
            raise DataError(f"{source}: parameter {name!r} is missing ({meaning})")
    return {n: numbers.real(v, f"{source}: parameter {n!r}") for n, v in given.items()}


def _element(row: Mapping[str, Any], values: Mapping[str, float], where: str) -> Element:
    _known(row, (*_PLAIN_KEYS, *_UNIT_KEYS), where)
    where = f"{where} ({row.get('name', 'without a name')})"
    for key in ("name", "branch", "kind"):
        if not isinstance(row.get(key), str):
            raise DataError(f"{where}: key {key!r} must be a text, got {row.get(key)!r}")
    if row["kind"] != "fixed" and "direction" not in row:
        raise DataError(f"{where}: key 'direction' is missing")
    numbers.flag(row.get("parked", False), f"{where}: parked")
    options = {k: v for k, v in row.items() if k in _PLAIN_KEYS}
    if "direction" in row:
        options["direction"] = _direction(row["direction"], where)
    if "location_errors" in row:
        options["location_errors"] = _location_errors(row["location_errors"], where)
    for key, (target, factor) in _UNIT_KEYS.items():
        if key in row:
            angle = key.rpartition("_")[2] in _ANGLES
            if target == "travel" and angle != (row["kind"] == "rotary"):
                of = "an angle" if row["kind"] == "rotary" else "a length"
                raise DataError(f"{where}: the travel of this axis is {of}, got {key!r}")
            if target in options:
                raise DataError(f"{where}: {target} is given twice, once as {key!r}")
            options[target] = _scaled(row[key], factor, values, f"{where}, {key}")
    try:
        return Element(**options)
    except (MetrosepError, TypeError) as exc:
        kind = type(exc) if isinstance(exc, MetrosepError) else DataError
        raise kind(f"{where}: {exc}") from None


def _direction(value: Any, where: str) -> Any:
    """Return a vector for "+X", "-Z" or "Y"; vectors pass."""
    if not isinstance(value, str):
        return value
    letter = value.lstrip("+-")
    if len(value) > 2 or letter not in ("X", "Y", "Z"):
        raise DataError(f"{where}: direction {value!r} is none of +X -X +Y -Y +Z -Z, nor a vector")
    sign = -1.0 if value[0] == "-" else 1.0
    return tuple(sign if axis == letter else 0.0 for axis in "XYZ")


def _location_errors(value: Any, where: str) -> dict[str, tuple[float, ...]]:
    """Return displacements by term name, from a list of names or a table of weights."""
    if isinstance(value, Mapping):
        table = dict(value)
    elif isinstance(value, list | tuple) and all(isinstance(name, str) for name in value):
        table = {name: {name.removeprefix("E")[:1]: 1.0} for name in value}
        if len(table) < len(value):
            raise DataError(f"{where}: location_errors name a term twice: {', '.join(value)}")
    else:
        raise DataError(
            f"{where}: location_errors are a list of names such as ['C0Y', 'B0Z'] or a table of "
            f"displacements, got {str(value)[:60]}"
        )
    lines = {}
    for name, weights in table.items():
        _known(weights, tuple(DIRECTIONS), f"{where}, location_errors {name}")
        lines[name] = tuple(_scaled(weights.get(d, 0.0), 1.0, {}, where) for d in DIRECTIONS)
    return lines


def _scaled(value: Any, factor: float, values: Mapping[str, float], where: str) -> Any:
    """Return numbers times the unit's factor; a text stands for a parameter, which is SI."""
    if isinstance(value, Sequence) and not isinstance(value, str):
        for v in value:
            if isinstance(v, Sequence) and not isinstance(v, str):
                raise DataError(f"{where}: a list in a list is not a number")
        return tuple(_scaled(v, factor, values, where) for v in value)
    if isinstance(value, str):
        sign, name = (-1.0, value[1:]) if value.startswith("-") else (1.0, value)
        if name not in values:
            known = ", ".join(values) or "none"
            raise DataError(f"{where}: {value!r} is not a parameter; the chain has {known}")
        if factor != 1.0:
            raise DataError(f"{where}: the parameter {name!r} is SI; use the key without a prefix")
        return sign * values[name]
    return numbers.real(value, where, finite=False) * factor
