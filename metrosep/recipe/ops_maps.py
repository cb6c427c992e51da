"""Steps of recipes for maps: flats, turned parts, spheres, sub-apertures."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import Any

from metrosep.core.errors import DataError, TooFewSamplesError
from metrosep.recipe.method import OP, U_READING, Method, toolbox
from metrosep.recipe.schema import Field

__all__ = ["MAPS_OF"]

_REMOVED = {"removed": Field("texts")}
_ANGLES = {"angles": Field("angles", required=True)}


def _lists(options: Mapping[str, Any]) -> dict[str, Any]:
    """Return options with lists as the tuples that the toolbox takes."""
    return {k: tuple(v) if isinstance(v, list) else v for k, v in options.items()}


def _stack(name: str, *given: str) -> Callable[[Sequence[Any], Mapping[str, Any]], Any]:
    """Return the call of a method of a list of maps, some options by position."""

    def call(surfaces: Sequence[Any], options: Mapping[str, Any]) -> Any:
        rest = _lists(options)
        first = [rest.pop(key) for key in given]
        return toolbox(name)(list(surfaces), *first, **rest)

    return call


def _three_flat(surfaces: Sequence[Any], options: Mapping[str, Any]) -> Any:
    rest = _lists(options)
    ab, ac, bc, *turned = surfaces
    angles = rest.pop("angles", ())
    if len(angles) != len(turned):
        raise DataError(
            f"{len(turned)} file(s) follow AB, AC, BC, but angles has {len(angles)}; give the turn "
            'of each further reading: angles = ["90 deg"]'
        )
    return toolbox("three_flat")(ab, ac, bc, turned, angles, **rest)


def _three_positions(surfaces: Sequence[Any], options: Mapping[str, Any]) -> Any:
    if len(surfaces) != 3:
        raise TooFewSamplesError(
            f"three maps are needed (confocal, confocal turned by 180 degrees, cat's eye), got "
            f"{len(surfaces)}"
        )
    return toolbox("three_positions")(*surfaces, **_lists(options))


def _shift_rotation(surfaces: Sequence[Any], options: Mapping[str, Any]) -> Any:
    from metrosep.separation.lateral_shifts import shift_rotation

    rest = _lists(options)
    u_power = rest.pop("u_power", 0.0)
    if "power" in rest:
        rest["power"] = (rest["power"], u_power)
    angles, shifts = rest.pop("angles"), rest.pop("shifts")
    return shift_rotation(list(surfaces), angles, shifts, **rest)


def _register(surfaces: Sequence[Any], options: Mapping[str, Any]) -> Any:
    if len(surfaces) != 2:
        raise TooFewSamplesError(f"two maps are registered, got {len(surfaces)} files")
    rest = dict(options)
    start = tuple(rest.pop(key, 0.0) for key in ("shift_x", "shift_y", "angle"))
    return toolbox("register_maps")(*surfaces, start=start, **rest)


def _stitch(surfaces: Sequence[Any], options: Mapping[str, Any]) -> Any:
    """Stitch; the first file is the known reference where ``reference = "first"``."""
    rest, maps = _lists(options), list(surfaces)
    if rest.get("reference") == "first":
        rest["reference"] = maps.pop(0)
    return toolbox("stitch")(maps, **rest)


MAPS_OF: Mapping[str, Method] = {
    "three_flat": Method(
        "absolute flatness of three flats; files AB, AC, BC, then those with a flat turned",
        "maps",
        ("AB", "AC", "BC"),
        {
            **OP,
            **U_READING,
            **_REMOVED,
            "angles": Field("angles"),
            "pairs": Field("texts"),
            "turned": Field("text", choices=("first", "second")),
            "flip": Field("text", choices=("x", "y")),
            "method": Field("text", choices=("auto", "pixel", "zernike", "iterative")),
            "terms": Field("integer"),
            "order": Field("text", choices=("ansi", "noll", "fringe")),
            "radius": Field("size"),
            "u_registration": Field("uncertainty"),
        },
        _three_flat,
    ),
    "rotation_average": Method(
        "part and instrument from maps of the part in several rotations; a file an angle",
        "maps",
        (),
        {
            **OP,
            **U_READING,
            **_REMOVED,
            **_ANGLES,
            "u_registration": Field("uncertainty"),
            "u_angle": Field("angle"),
        },
        _stack("rotation_average", "angles"),
    ),
    "shift_rotation": Method(
        "part and instrument from maps of the part shifted and turned",
        "maps",
        (),
        {
            **OP,
            **U_READING,
            **_ANGLES,
            "shifts": Field("places", required=True),
            "terms": Field("integer"),
            "power": Field("length"),
            "u_power": Field("uncertainty"),
        },
        _shift_rotation,
    ),
    "repeatable_maps": Method(
        "what repeats in several maps of one thing, and what does not",
        "maps",
        (),
        {**OP, **U_READING, "align": Field("text", choices=("line", "piston", "none"))},
        _stack("repeatable"),
    ),
    "register_maps": Method(
        "shift and turn of a second map against a first one of the same surface",
        "maps",
        ("fixed", "moved"),
        {
            **OP,
            **U_READING,
            "shift_x": Field("length"),
            "shift_y": Field("length"),
            "angle": Field("angle"),
            "rotation": Field("flag"),
        },
        _register,
    ),
    "ball_average": Method(
        "error of an instrument from maps of many patches of a ball",
        "maps",
        (),
        {**OP, **_REMOVED, "correlated": Field("flag")},
        _stack("ball_average"),
    ),
    "three_positions": Method(
        "form of a sphere and error of the interferometer from three positions",
        "maps",
        ("confocal", "confocal_180", "cats_eye"),
        {**OP, **U_READING, **_REMOVED},
        _three_positions,
    ),
    "stitch": Method(
        "one surface or profile from overlapping sub-apertures, with or without the reference",
        "maps",
        (),
        {
            **OP,
            **U_READING,
            "positions": Field("places"),
            "rotations": Field("angles"),
            "freedoms": Field("texts"),
            "reference": Field("text", choices=("none", "fit", "first")),
            "reference_degree": Field("integer"),
            "ambiguous": Field("text", choices=("remove", "surface")),
            "registration": Field("text", choices=("trust", "fit")),
            "draws": Field("integer"),
        },
        _stitch,
        accepts=("Surface", "Profile"),
    ),
}
