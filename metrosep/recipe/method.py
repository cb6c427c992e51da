"""The keys of ``[input]`` for each method that has a name."""

from __future__ import annotations

from collections.abc import Mapping

from metrosep.core.methods import Method
from metrosep.recipe.schema import LAYOUT, Field

__all__ = ["CURVES", "MAPS", "input_fields"]

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


def input_fields(method: type[Method]) -> Mapping[str, Field]:
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
