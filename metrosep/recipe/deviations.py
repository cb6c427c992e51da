"""Positioning tests whose table holds deviations in place of the positions that were reached.

Many measuring programs write ``actual - target``; the evaluation takes positions. A table that is
taken for the other kind gives a nonsensical result or none, so the data decide whether what was
said about them can be true.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import Any

import numpy as np

from metrosep.core._arrays import FloatArray
from metrosep.core.errors import InvalidSamplesError
from metrosep.io.role_columns import RoleColumns
from metrosep.recipe.key_values import typed_number
from metrosep.recipe.method import Method
from metrosep.recipe.schema import Field

__all__ = ["as_positions", "with_values"]


_VALUES = ("position", "deviation")
_SMALL, _LARGE = 0.1, 0.5
"""Readings that span less of the targets than the first are deviations, more than the second are
positions: an axis that is wrong by a tenth of its travel is broken, not measured."""


def with_values(method: Method) -> Method:
    """Return a method of positioning tests with the key ``values``."""

    def call(inputs: Any, options: Mapping[str, Any]) -> Any:
        rest = dict(options)
        kind = rest.pop("values", "position")
        if isinstance(inputs, tuple):
            return method.call(tuple(as_positions(i, kind) for i in inputs), rest)
        return method.call(as_positions(inputs, kind), rest)

    fields = {**method.fields, "values": Field("text", choices=_VALUES)}
    return replace(method, fields=fields, call=call)


def as_positions(data: RoleColumns, values: str) -> RoleColumns:
    """Return the readings of a positioning test as positions reached.

    Notes
    -----
    NaN stays NaN. Without a range of targets nothing is judged; the evaluation refuses that.
    """
    target = np.asarray(data.values["target"], dtype=np.float64)
    found = {k: data.values[k] for k in ("readings", "forward", "backward") if k in data.values}
    angle = data.units.get("target") == "rad"
    for name, readings in found.items():
        _require_kind(target, np.asarray(readings, dtype=np.float64), values, name, angle=angle)
    if values == "position":
        return data
    reached: dict[str, Any] = {}
    for name, readings in found.items():
        column = target if name == "readings" else target[:, None]  # a row a run, a row a target
        reached[name] = readings + column if readings.size else readings
    return replace(data, values={**data.values, **reached})


def _require_kind(
    target: FloatArray, readings: FloatArray, values: str, name: str, *, angle: bool
) -> None:
    span, reach = _range(target), _range(readings)
    if span == 0.0 or not np.isfinite(readings).any():
        return
    dimension = "angle" if angle else "length"
    sizes = (
        f"they span {typed_number(reach, dimension)} where the targets span "
        f"{typed_number(span, dimension)}"
    )
    if values == "position" and reach < _SMALL * span:
        raise InvalidSamplesError(
            f"the {name} look like deviations, not like positions reached: {sizes}; if they are "
            'actual minus target, say values = "deviation", else name the columns of positions'
        )
    if values == "deviation" and reach > _LARGE * span:
        raise InvalidSamplesError(
            f"the {name} look like positions reached, not like deviations: {sizes}; leave "
            'values = "deviation" out'
        )


def _range(values: FloatArray) -> float:
    known = values[np.isfinite(values)]
    return float(known.max() - known.min()) if known.size else 0.0
