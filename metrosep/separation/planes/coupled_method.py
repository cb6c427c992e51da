"""`CoupledGrid`: lines along x and lines along y of one plane, joined at their crossings.

``line_j(x) = e(x, y_j) + a_j + b_j x`` and ``line_i(y) = e(x_i, y) + c_i + d_i y``: the error of the
plane is the machine's, the straight lines are how the artefact (or the probe) was set each time.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any, ClassVar

import numpy as np
from numpy.typing import ArrayLike

from metrosep.core._arrays import FloatArray
from metrosep.core.errors import DataError
from metrosep.core.inputs import RoleColumns
from metrosep.core.options import Option, option
from metrosep.core.provenance import Step
from metrosep.separation._readings import known_parts, real_numbers
from metrosep.separation.contract import U_READING, Separation, SeparationMethod, Unobservable
from metrosep.separation.planes._grid_solution import Repeats, Slopes, refuse_unknown
from metrosep.separation.planes._table_grid import PLACE, TableGrid, repeats_of
from metrosep.separation.planes.plane_fit import plane_steps
from metrosep.separation.planes.plane_grid import coupled_grid, unseen_terms

__all__ = ["CoupledGrid"]


@dataclass(frozen=True, slots=True)
class CoupledGrid(SeparationMethod):
    """Lines in both directions on a grid of steps dx and dy.

    Parameters
    ----------
    dx, dy : float, m
        Steps of the grid.
    slopes : {"free", "common", "none"}, optional
        What each line is set anew in: see `coupled_grid`.
    repeats : {"relaid", "passes"}, optional
        Whether each repeat was laid anew, or passes over lines that stayed.

    Raises
    ------
    DataError
        If a step is not positive or `slopes` or `repeats` is unknown.

    Examples
    --------
    >>> method = CoupledGrid(1e-3, 1e-3, slopes="none")
    >>> readings = method.simulate({}, {"error": [[3e-9, -1e-9, -2e-9], [1e-9, -3e-9, 2e-9]]})
    >>> found = method.separate(readings + [[[5e-9], [2e-9]], [[0.0], [0.0]]])
    >>> (found.error * 1e9).round(6).tolist()
    [[3.0, -1.0, -2.0], [1.0, -3.0, 2.0]]
    """

    dx: float
    dy: float
    slopes: Slopes = option(
        "free",
        kind="text",
        choices=("free", "common", "none"),
        help="whether each line has a slope of its own, all have one, or none has any",
    )
    repeats: Repeats = option(
        "relaid",
        kind="text",
        choices=("relaid", "passes"),
        help="relaid: the straightedge was laid anew for each repeat; passes: it stayed",
    )

    name: ClassVar[str] = "coupled_grid"
    what: ClassVar[str] = "error map of a plane from lines along x and lines along y"
    reads: ClassVar = "table"
    roles: ClassVar[Mapping[str, str]] = {
        **PLACE, "z": "length", "line": "label", "repeat": "label?",
    }  # fmt: skip
    arguments: ClassVar[Mapping[str, Option]] = U_READING
    truth_parts: ClassVar[tuple[str, ...]] = ()
    error_parts: ClassVar[tuple[str, ...]] = ("error",)

    @classmethod
    def from_inputs(cls, data: RoleColumns, options: Mapping[str, Any]) -> Separation:
        """Return the map that the lines along x and along y of a table make."""
        from metrosep.separation.planes.plane_grid import coupled_grid

        grid, marks = TableGrid(data), data.values["line"]
        unknown = sorted(set(marks.tolist()) - {"x", "y"})
        if unknown:
            raise DataError(
                f'a line runs along "x" or "y", the column of lines says {unknown[0]!r}'
            )
        both = []
        for way in ("x", "y"):
            each = [
                grid.filled(data.values["z"], rows & (marks == way), f"{what}, lines along {way}")
                for what, rows in repeats_of(data)
            ]
            both.append(each[0] if len(each) == 1 else np.array(each))
        x_lines, y_lines = both
        return coupled_grid(x_lines, y_lines, **grid.steps, **options)

    def __post_init__(self) -> None:
        plane_steps(self.dx, self.dy)
        refuse_unknown(self.slopes, self.repeats)

    def simulate(
        self, truth: Mapping[str, ArrayLike], errors: Mapping[str, ArrayLike]
    ) -> FloatArray:
        """Return the lines along x and along y of a given plane, all set with offset and slope zero.

        Parameters
        ----------
        truth : mapping
            Empty: the artefact counts as straight, and how it lies is no part.
        errors : mapping of str to array_like, shape (n_y, n_x), m
            ``error`` of the plane.

        Returns
        -------
        ndarray, shape (2, n_y, n_x), m
            Lines along x (rows), lines along y (columns).

        Raises
        ------
        DataError
            If a part is unknown, none is given, or it is no map.
        """
        error = known_parts(self, truth, errors)["error"]
        if error.ndim != 2:
            raise DataError(f"{self.name}: the error must be a map (n_y, n_x), got {error.shape}")
        return np.stack([error, error])

    def null_space(self) -> tuple[Unobservable, ...]:
        """Return what every line can take as its own offset and slope.

        Returns
        -------
        tuple of Unobservable
            Piston; tilts and twist with slopes of their own.
        """
        return (unseen_terms(self.slopes),)

    def separate(
        self,
        readings: ArrayLike,
        *,
        u_reading: float | None = None,
        history: tuple[Step, ...] = (),
    ) -> Separation:
        """Return the error of the plane.

        Parameters
        ----------
        readings : array_like, shape (2, n_y, n_x) or (2, M, n_y, n_x), m
            Lines along x and lines along y; NaN where no line was run.
        u_reading : float, m, optional
            Standard uncertainty of one reading, where redundancy is missing.
        history : tuple of Step, optional
            Where they came from.

        Returns
        -------
        Separation
            Part ``error`` (n_y, n_x); `coupled_grid` does the work.

        Raises
        ------
        DataError
            If the shape is another, or `u_reading` is not usable.
        InvalidSamplesError
            If the readings are no real numbers.
        NotSeparableError
            If one direction has no lines, or the crossings do not join them.
        TooFewSamplesError
            If a direction has fewer than two lines.
        """
        both = np.asarray(real_numbers(readings, f"{self.name}: readings"), dtype=np.float64)
        if both.ndim not in (3, 4) or both.shape[0] != 2:
            raise DataError(
                f"{self.name} needs lines along x and lines along y as an array (2, n_y, n_x) or "
                f"(2, repeats, n_y, n_x), got {both.shape}"
            )
        found = coupled_grid(
            both[0],
            both[1],
            dx=self.dx,
            dy=self.dy,
            slopes=self.slopes,
            repeats=self.repeats,
            u_reading=u_reading,
        )
        how = {"slopes": self.slopes, "repeats": self.repeats}
        step = Step(self.name, {"dx_m": self.dx, "dy_m": self.dy, **how})
        return replace(found, history=(*history, step))
