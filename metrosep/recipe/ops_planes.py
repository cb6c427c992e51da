"""Steps of recipes for planes from tables: a row holds x, y and what was read there."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from metrosep.core._arrays import FloatArray
from metrosep.core.errors import (
    DataError,
    InvalidSamplesError,
    NotUniformError,
    TooFewSamplesError,
)
from metrosep.core.inputs import RoleColumns
from metrosep.recipe.method import OP, U_READING, Method, toolbox
from metrosep.recipe.schema import Field

__all__ = ["MAPS_OF", "PLANES"]

_SAME = 1e-3
"""Positions of one grid line may differ by this share of the step: rounding of text."""


def _axis(values: FloatArray, name: str) -> tuple[FloatArray, NDArray[np.intp], float]:
    """Return the grid lines of a column of positions, the line of each row, and the step."""
    if np.isnan(values).any():
        raise InvalidSamplesError(f"a row has no {name}; drop it")
    rising = np.sort(values)
    gaps = np.diff(rising)
    largest = float(gaps.max()) if gaps.size else 0.0
    starts = np.concatenate([[True], gaps > 0.5 * largest])
    lines = rising[starts]
    if largest == 0.0 or lines.size < 2:
        raise InvalidSamplesError(f"all rows have the same {name}; a plane needs several")
    step = float(lines[-1] - lines[0]) / (lines.size - 1)
    index = np.rint((values - lines[0]) / step).astype(np.intp)
    if float(np.abs(lines[0] + step * index - values).max()) > _SAME * step:
        raise NotUniformError(
            f"the values of {name} do not lie on equal steps of {step * 1e3:.6g} mm; measure on a "
            "regular grid"
        )
    return lines[0] + step * np.arange(lines.size), index, step


class _Grid:
    """The regular grid on which the rows of a table lie."""

    def __init__(self, data: RoleColumns) -> None:
        self.x, self.column, self.dx = _axis(data.values["x"], "x")
        self.y, self.row, self.dy = _axis(data.values["y"], "y")

    @property
    def steps(self) -> dict[str, float]:
        return {"dx": self.dx, "dy": self.dy}

    def filled(self, values: FloatArray, rows: NDArray[np.bool_], what: str) -> FloatArray:
        """Return (n_y, n_x), NaN where no row stands."""
        row, column = self.row[rows], self.column[rows]
        flat = row * self.x.size + column
        if np.unique(flat).size != flat.size:
            raise InvalidSamplesError(
                f"{what}: a point stands twice; name the column that numbers repeats, "
                'repeat = "repeat"'
            )
        out = np.full((self.y.size, self.x.size), np.nan)
        out[row, column] = values[rows]
        return out


def _repeats(data: RoleColumns) -> list[tuple[str, NDArray[np.bool_]]]:
    marks = data.values.get("repeat")
    if marks is None:
        return [("the table", np.ones(data.values["x"].size, dtype=bool))]
    return [(f"repeat {m}", marks == m) for m in dict.fromkeys(marks.tolist())]


def _plane(data: RoleColumns, options: Mapping[str, Any]) -> Any:
    rest, grid = dict(options), _Grid(data)
    own = rest.pop("zero", "shared") == "own"
    maps = [grid.filled(data.values["z"], rows, what) for what, rows in _repeats(data)]
    if own:
        maps = [m - np.nanmean(m) for m in maps]
    corner = (float(grid.x[0]), float(grid.y[0]))
    fit = toolbox("fit_plane_model")
    return fit(np.array(maps), origin=corner, **grid.steps, **rest)


def _lines(data: RoleColumns, options: Mapping[str, Any]) -> Any:
    grid, marks = _Grid(data), data.values["line"]
    unknown = sorted(set(marks.tolist()) - {"x", "y"})
    if unknown:
        raise DataError(f'a line runs along "x" or "y", the column of lines says {unknown[0]!r}')
    both = []
    for way in ("x", "y"):
        each = [
            grid.filled(data.values["z"], rows & (marks == way), f"{what}, lines along {way}")
            for what, rows in _repeats(data)
        ]
        both.append(each[0] if len(each) == 1 else np.array(each))
    return toolbox("coupled_grid")(*both, **grid.steps, **options)


def _lattice(data: RoleColumns, options: Mapping[str, Any]) -> Any:
    """Calibrate from views of a plate; others than the three named ones have turns and shifts."""
    rest, grid, marks = dict(options), _Grid(data), data.values["view"]
    pitch = rest.pop("pitch", grid.dx)
    names = list(dict.fromkeys(marks.tolist()))
    turns, shifts = rest.pop("turns", None), rest.pop("shifts", None)
    views: dict[str, FloatArray] = {}
    for name in names:
        repeats = []
        for what, rows in _repeats(data):
            chosen = rows & (marks == name)
            if chosen.any():
                where = f"{what}, view {name}"
                pair = [grid.filled(data.values[e], chosen, where) for e in ("ex", "ey")]
                repeats.append(np.stack(pair, axis=-1))
        views[name] = repeats[0] if len(repeats) == 1 else np.array(repeats)
    calibrate = toolbox("grid_calibration")
    if turns is None and shifts is None:
        return calibrate(views, pitch=pitch, **rest)
    turns = turns or (0,) * len(names)
    shifts = shifts or ((0, 0),) * len(names)
    if not len(turns) == len(shifts) == len(names):
        raise DataError(
            f"turns and shifts need one entry for each view ({', '.join(names)}), in their order"
        )
    view = toolbox("GridView")
    placed = [view(v, t, s) for v, t, s in zip(views.values(), turns, shifts, strict=True)]
    return calibrate(placed, pitch=pitch, **rest)


_PLACE = {"x": "length", "y": "length"}
_REPEATS = {"repeats": Field("text", choices=("relaid", "passes"))}

PLANES: Mapping[str, Method] = {
    "fit_plane_model": Method(
        "errors of the two axes of a measured plane, their alignment and their coupling",
        "table",
        (),
        {**OP, **U_READING, "zero": Field("text", choices=("shared", "own"))},
        _plane,
        roles={**_PLACE, "z": "length", "repeat": "label?"},
    ),
    "coupled_grid": Method(
        "error map of a plane from lines along x and lines along y",
        "table",
        (),
        {
            **OP,
            **U_READING,
            "slopes": Field("text", choices=("free", "common", "none")),
            **_REPEATS,
        },
        _lines,
        roles={**_PLACE, "z": "length", "line": "label", "repeat": "label?"},
    ),
    "grid_calibration": Method(
        "errors of a stage and of a grid plate from views of the plate",
        "table",
        (),
        {
            **OP,
            **U_READING,
            "pitch": Field("size"),
            "turns": Field("integers"),
            "shifts": Field("pairs"),
            **_REPEATS,
        },
        _lattice,
        roles={**_PLACE, "ex": "length", "ey": "length", "view": "label", "repeat": "label?"},
    ),
}


# ---- steps of recipes for maps: flats, turned parts, spheres, sub-apertures --------------------

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
    from metrosep.separation.maps.lateral_shifts import shift_rotation

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
