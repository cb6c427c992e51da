"""`Method`: what a separation that recipes know by name reads, its keys, and its call."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Any, Literal

from metrosep.recipe.schema import LAYOUT, Field

__all__ = [
    "CURVES",
    "LAYOUT",
    "MAPS",
    "OP",
    "TABLE",
    "U_READING",
    "Method",
    "Reads",
    "as_rows",
    "input_fields",
    "toolbox",
]

Reads = Literal["curves", "table", "tables", "maps", "results", "nothing"]

OP = {"op": Field("text", required=True)}
U_READING = {"u_reading": Field("uncertainty")}
CURVES = {
    "files": Field("texts"),
    "readings": Field("texts", required=True),
    "x": Field("text"),
    "angle": Field("text"),
    "repeat": Field("text"),
    "scale": Field("text"),
    **LAYOUT,
}
MAPS = {
    "files": Field("texts"),
    "channel": Field("text"),
    "unit": Field("text"),
    "lateral_step": Field("size"),
}
TABLE = {"files": Field("texts"), **LAYOUT}


@dataclass(frozen=True, slots=True)
class Method:
    """One separation that recipes and the command line know."""

    what: str  # what it separates, for the list of methods
    # {"curves", "table", "tables", "maps", "results", "nothing"}: columns over positions; columns
    # by their role, of all files together or file by file; maps; documents of results; nothing
    # where the keys of the step say all
    reads: Reads
    # what the readings are, in their order; empty where their number is free
    readings: tuple[str, ...]
    fields: Mapping[str, Field]  # mapping of str to Field: keys of its step
    # ``from_inputs(inputs, options)``: inputs are `Readings`, `RoleColumns`, a tuple of them, a tuple of
    # `Surface`, or `StoredResults`
    from_inputs: Callable[[Any, Mapping[str, Any]], Any]
    # {"length", "angle"}: what the readings of curves are
    dimension: Literal["length", "angle"] = "length"
    # mapping of str to str: further columns of ``[input]`` and their dimension: ``"time"``,
    # ``"angle"``, ``"position"`` (a length or an angle), ``"any"``, ``"label"``; a ``*`` after it:
    # several columns; a ``?`` after it: may be left out
    roles: Mapping[str, str] = field(default_factory=dict)
    accepts: tuple[str, ...] = ("Surface",)  # objects that files of maps may hold
    spare: int = 0  # how many further readings of curves may follow the named ones
    # {"any", "x", "angle"}: which position curves may have
    over: Literal["any", "x", "angle"] = "any"


def input_fields(method: Any) -> Mapping[str, Field]:
    """Return the keys of ``[input]`` for a method."""
    if method.reads == "maps":
        return MAPS
    if method.reads == "results":
        return {"files": Field("texts")}
    if method.reads == "nothing":
        return {}
    roles = {
        name: Field("texts" if "*" in kind else "text", required="?" not in kind)
        for name, kind in method.roles.items()
    }
    if method.reads == "curves":
        other = {"x": "angle", "angle": "x"}.get(method.over)
        return {k: f for k, f in {**CURVES, **roles}.items() if k != other}
    return {**TABLE, **roles}


def toolbox(name: str) -> Callable[..., Any]:
    """Return a function of the toolbox, loaded when it is called."""

    def call(*arguments: Any, **options: Any) -> Any:
        import metrosep.separation as public

        return getattr(public, name)(*arguments, **options)

    return call


def as_rows(values: Any) -> Any:
    """Return readings without the axis of repeats where there is one repeat only."""
    return values[:, 0] if values.shape[1] == 1 else values
