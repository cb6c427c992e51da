"""Steps of recipes for planes from tables: a row holds x, y and what was read there."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from metrosep.core._arrays import FloatArray
from metrosep.core.errors import DataError, InvalidSamplesError, NotUniformError
from metrosep.io.role_columns import RoleColumns
from metrosep.recipe.method import OP, U_READING, Method, toolbox
from metrosep.recipe.schema import Field

__all__ = ["PLANES"]


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
