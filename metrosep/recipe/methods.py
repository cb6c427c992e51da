"""The separations that a recipe can ask for by name: what each reads, its keys, and its call.

Every entry is data: the kind of its inputs, the keys of its step, and a function that is loaded
when it is used.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Literal

from metrosep.recipe.schema import Field

if TYPE_CHECKING:
    from metrosep.core.surface import Surface
    from metrosep.io.readings import Readings

__all__ = ["CURVES", "MAPS", "METHODS", "Method", "input_fields"]

Reads = Literal["curves", "maps"]

_OP = {"op": Field("text", required=True)}
_U_READING = {"u_reading": Field("uncertainty")}
_LAYOUT = {
    "separator": Field("text"),
    "decimal": Field("text"),
    "encoding": Field("text"),
}

CURVES = {
    "files": Field("texts"),
    "readings": Field("texts", required=True),
    "x": Field("text"),
    "angle": Field("text"),
    "repeat": Field("text"),
    "scale": Field("text"),
    **_LAYOUT,
}
MAPS = {
    "files": Field("texts"),
    "channel": Field("text"),
    "unit": Field("text"),
    "lateral_step": Field("size"),
}


@dataclass(frozen=True, slots=True)
class Method:
    """One separation that recipes and the command line know.

    Parameters
    ----------
    what : str
        What it separates, for the list of methods.
    reads : {"curves", "maps"}
        Columns over positions, or maps.
    names : tuple of str
        What the readings are, in their order; empty where their number is free.
    fields : mapping of str to Field
        Keys of its step.
    call : callable
        ``call(inputs, options)``: inputs are `Readings` or a list of `Surface`.
    dimension : {"length", "angle"}, optional
        What the readings of curves are.
    """

    what: str
    reads: Reads
    names: tuple[str, ...]
    fields: Mapping[str, Field]
    call: Callable[[Any, Mapping[str, Any]], Any]
    dimension: Literal["length", "angle"] = "length"


def input_fields(method: Method) -> Mapping[str, Field]:
    """Return the keys of ``[input]`` for a method.

    Parameters
    ----------
    method : Method
        The method.

    Returns
    -------
    mapping of str to Field
        Allowed keys.
    """
    return CURVES if method.reads == "curves" else MAPS


def _require_turn(data: Readings) -> None:
    from metrosep.core.errors import FormatMismatchError
    from metrosep.separation._inputs import require_turn

    if data.position is None:
        raise FormatMismatchError(
            'the angle of each sample is needed: name its column, angle = "angle_deg"'
        )
    require_turn(data.position)


def _over_turn(name: str) -> Callable[[Readings, Mapping[str, Any]], Any]:
    """Return the call of a method of readings over one revolution."""

    def call(data: Readings, options: Mapping[str, Any]) -> Any:
        import metrosep.separation as toolbox

        _require_turn(data)
        return getattr(toolbox, name)(*data.values, **options)

    return call


def _straightedge(data: Readings, options: Mapping[str, Any]) -> Any:
    from metrosep.separation import straightedge_reversal

    return straightedge_reversal(*data.values, x=data.position, **options)


def _face(data: Readings, options: Mapping[str, Any]) -> Any:
    from metrosep.separation import face_reversal

    _require_turn(data)
    f1, f2, axial, *second = data.values
    rest = {k: v for k, v in options.items() if k != "radius"}
    axial2 = second[0] if second else None
    return face_reversal(f1, f2, axial, options["radius"], axial2=axial2, **rest)


def _maps(name: str) -> Callable[[Sequence[Surface], Mapping[str, Any]], Any]:
    """Return the call of a method that takes a list of maps and options."""

    def call(surfaces: Sequence[Surface], options: Mapping[str, Any]) -> Any:
        import metrosep.separation as toolbox

        return getattr(toolbox, name)(list(surfaces), **options)

    return call


METHODS: Mapping[str, Method] = {
    "donaldson": Method(
        "roundness of an artefact and radial error motion of a spindle, by reversal",
        "curves",
        ("m1", "m2"),
        {**_OP, **_U_READING, "u_index": Field("angle")},
        _over_turn("donaldson"),
    ),
    "straightedge_reversal": Method(
        "form of a straightedge and straightness of a slide, by reversal",
        "curves",
        ("m1", "m2"),
        {**_OP, **_U_READING, "u_registration": Field("uncertainty")},
        _straightedge,
    ),
    "face_reversal": Method(
        "flatness of a plate, axial and tilt error motion of a spindle, by reversal",
        "curves",
        ("F1", "F2", "A"),
        {**_OP, **_U_READING, "radius": Field("size", required=True)},
        _face,
    ),
}
