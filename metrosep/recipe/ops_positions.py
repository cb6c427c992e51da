"""Steps of recipes for positioning tests: ISO 230-2, diagonals of ISO 230-6."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from metrosep.core.errors import DataError, NotSeparableError, UnitError
from metrosep.io.role_columns import RoleColumns
from metrosep.recipe.method import OP, Method, toolbox
from metrosep.recipe.schema import Field

__all__ = ["POSITIONS", "Positions"]

Positions = tuple[Any, Any, Any]
"""Targets, forward and backward: the arguments of `iso230_2`."""


def _positions(data: RoleColumns, rows: Any = slice(None)) -> Positions:
    values = data.values
    if "forward" in values:  # from a list of a positioning test
        both = [v if v.size else None for v in (values["forward"], values["backward"])]
        return values["target"], both[0], both[1]
    found: Positions = toolbox("positions_from_columns")(
        values["target"][rows],
        _words(values["direction"][rows]),
        values["readings"].T[rows],
    )
    return found


def _words(direction: Any) -> list[str]:
    return [str(d) for d in direction]


def _iso230_2(data: RoleColumns, options: Mapping[str, Any]) -> Any:
    unit = data.units.get("target", "m")
    if data.units.get("readings", unit) != unit:
        raise UnitError("targets and positions must both be lengths, or both angles")
    return toolbox("iso230_2")(*_positions(data), unit=unit, **options)


def _iso230_6(tables: Sequence[RoleColumns], options: Mapping[str, Any]) -> Any:
    """One file for each diagonal, or one file with a column that names the diagonal of each row."""
    rest = dict(options)
    names = rest.pop("names", None)
    first = tables[0]
    if "diagonal" in first.values:
        if len(tables) > 1 or names is not None:
            raise DataError(
                "a column of diagonals is for one file; leave names out and give that file alone"
            )
        marks = first.values["diagonal"]
        diagonals = {
            str(name): _positions(first, np.flatnonzero(marks == name))
            for name in dict.fromkeys(marks.tolist())
        }
    else:
        names = [t.name for t in tables] if names is None else names
        if len(names) != len(tables):
            raise DataError(
                f"{len(names)} names of diagonals for {len(tables)} files; give one for each file: "
                'names = ["ppp", "npp"]'
            )
        if len(set(names)) != len(names):
            raise DataError("a diagonal is named twice; give each file its own name")
        diagonals = {n: _positions(t) for n, t in zip(names, tables, strict=True)}
    if not diagonals:
        raise NotSeparableError("there is no diagonal in the files")
    return toolbox("iso230_6_diagonals")(diagonals, **rest)


_COMMON = {"confidence": Field("number"), "seed": Field("integer")}

POSITIONS: Mapping[str, Method] = {
    "iso230_2": Method(
        "positioning accuracy and repeatability of an axis, ISO 230-2",
        "table",
        (),
        {**OP, **_COMMON},
        _iso230_2,
        roles={"target": "position?", "direction": "label?", "readings": "position*?"},
    ),
    "iso230_6_diagonals": Method(
        "deviations along diagonals and squareness of the axes, ISO 230-6",
        "tables",
        (),
        {**OP, "names": Field("texts"), "size": Field("lengths"), **_COMMON},
        _iso230_6,
        roles={
            "target": "length?",
            "direction": "label?",
            "readings": "length*?",
            "diagonal": "label?",
        },
    ),
}
