"""The regular grid on which the rows of a table lie: a row holds x, y and what was read there."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from metrosep.core._arrays import FloatArray
from metrosep.core.errors import InvalidSamplesError, NotUniformError
from metrosep.core.inputs import RoleColumns

__all__ = ["PLACE", "TableGrid", "repeats_of"]

PLACE = {"x": "length", "y": "length"}
"""Columns of every such table."""

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


class TableGrid:
    """The regular grid on which the rows of a table lie."""

    def __init__(self, data: RoleColumns) -> None:
        self.x, self.column, self.dx = _axis(data.values["x"], "x")
        self.y, self.row, self.dy = _axis(data.values["y"], "y")

    @property
    def steps(self) -> dict[str, Any]:
        return {"dx": self.dx, "dy": self.dy}

    def filled(self, values: FloatArray, rows: NDArray[np.bool_], what: str) -> FloatArray:
        """Return (n_y, n_x), NaN where no row stands."""
        row, column = self.row[rows], self.column[rows]
        flat = row * self.x.size + column
        if np.unique(flat).size != flat.size:
            raise InvalidSamplesError(
                f"{what}: a point occurs twice; name the column that numbers repeats, "
                'repeat = "repeat"'
            )
        out = np.full((self.y.size, self.x.size), np.nan)
        out[row, column] = values[rows]
        return out


def repeats_of(data: RoleColumns) -> list[tuple[str, NDArray[np.bool_]]]:
    marks = data.values.get("repeat")
    if marks is None:
        return [("the table", np.ones(data.values["x"].size, dtype=bool))]
    return [(f"repeat {m}", marks == m) for m in dict.fromkeys(marks.tolist())]
