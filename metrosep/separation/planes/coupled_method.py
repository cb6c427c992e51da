"""Error map of a plane from lines along x and lines along y, joined at their crossings.

Each line is read with an offset and (unless stated) a slope of its own, because the probe or the
straightedge is set anew: ``line_j(x) = e(x, y_j) + a_j + b_j x`` and ``line_i(y) = e(x_i, y) + c_i +
d_i y``. The error of the plane is the machine's, the straight lines are how the artefact was set each
time. Least squares over all readings gives the map; nothing couples x and y in advance, so the map may
hold what a sum of two axis errors cannot. Rows grow with y, columns with x.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any, ClassVar

import numpy as np
from numpy.typing import ArrayLike

from metrosep.core._arrays import FloatArray
from metrosep.core.blas import one_blas_thread
from metrosep.core.docs import described_by
from metrosep.core.errors import DataError, NotSeparableError, TooFewSamplesError
from metrosep.core.methods import RoleColumns
from metrosep.core.numbers import not_negative
from metrosep.core.options import Option, option
from metrosep.core.provenance import Step
from metrosep.core.surface import Surface
from metrosep.separation._readings import known_parts, real_numbers
from metrosep.separation.contract import (
    U_READING,
    History,
    Parts,
    RecordedMethod,
    Separation,
    Unobservable,
    settle,
)
from metrosep.separation.planes._grid_solution import (
    PLACE,
    TERMS,
    Joined,
    Repeats,
    Slopes,
    TableGrid,
    lays_of,
    moved_between,
    noise_of,
    refuse_unknown,
    repeats_of,
)
from metrosep.separation.planes.plane_fit import plane_steps


@dataclass(frozen=True, slots=True)
class CoupledGrid(RecordedMethod):
    """Lines in both directions on a grid of steps dx and dy.

    Readings (2, n_y, n_x) or (2, M, n_y, n_x) in m: lines along x (rows), lines along y (columns),
    NaN where no line was run. Part: ``error`` of the plane, (n_y, n_x) in m. The artefact counts as
    straight, and how it lies is not a part: simulated lines have offset and slope zero. `u_reading` is
    used where redundancy is missing.

    Parameters
    ----------
    dx, dy : float, m
        Steps of the grid.

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
        help="whether each line has a slope of its own, the lines of a direction share one, or the"
        " lines keep a common reference (a level, a flat that stays)",
    )
    repeats: Repeats = option(
        "relaid",
        kind="text",
        choices=("relaid", "passes"),
        help="relaid: the lines of each repeat were laid anew, with offsets and slopes of their "
        "own; passes: they stayed as they lay",
    )

    name = "coupled_grid"
    what = "error map of a plane from lines along x and lines along y"
    reads = "table"
    roles: ClassVar[Mapping[str, str]] = {
        **PLACE, "z": "length", "line": "label", "repeat": "label?",
    }  # fmt: skip
    arguments: ClassVar[Mapping[str, Option]] = U_READING
    truth_parts = ()
    error_parts = ("error",)

    @classmethod
    def from_inputs(cls, data: RoleColumns, options: Mapping[str, Any]) -> Separation:
        """Return the map that the lines along x and along y of a table make."""
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
        dx, dy = plane_steps(self.dx, self.dy)
        settle(self, dx=dx, dy=dy)
        refuse_unknown(self.slopes, self.repeats)

    def simulate(self, truth: Parts, errors: Parts) -> FloatArray:
        error = known_parts(self, truth, errors)["error"]
        if error.ndim != 2:
            raise DataError(f"{self.name}: the error must be a map (n_y, n_x), got {error.shape}")
        return np.stack([error, error])

    def null_space(self) -> tuple[Unobservable, ...]:
        return (unseen_terms(self.slopes),)

    def _solved(self, readings: ArrayLike, stated: float | None, history: History) -> Separation:
        both = np.asarray(real_numbers(readings, f"{self.name}: readings"), dtype=np.float64)
        if both.ndim not in (3, 4) or both.shape[0] != 2:
            raise DataError(
                f"{self.name} needs lines along x and lines along y as an array (2, n_y, n_x) or "
                f"(2, repeats, n_y, n_x), got {both.shape}"
            )
        how: dict[str, Any] = {"slopes": self.slopes, "repeats": self.repeats}
        found = coupled_grid(*both, dx=self.dx, dy=self.dy, u_reading=stated, **how)
        step = Step(self.name, {"dx_m": self.dx, "dy_m": self.dy, **how})
        return replace(found, history=(*history, step))


@described_by(CoupledGrid, CoupledGrid.separate)
def coupled_grid(
    x_lines: Surface | ArrayLike,
    y_lines: Surface | ArrayLike,
    *,
    dx: float | None = None,
    dy: float | None = None,
    slopes: Slopes = "free",
    repeats: Repeats = "relaid",
    u_reading: float | None = None,
) -> Separation:
    """Return the error map that lines in both directions agree on.

    Parameters
    ----------
    x_lines : Surface or array_like, shape (n_y, n_x) or (n_repeats, n_y, n_x), m
        Readings of lines along x, one a row; rows without a line are NaN.
    y_lines : Surface or array_like, same shape, m
        Readings of lines along y, one a column; columns without a line are NaN.
    dx, dy : float, m, optional
        Steps of the grid, for plain arrays.
    u_reading : float, m, optional
        Standard uncertainty of one reading, where redundancy is missing.

    Returns
    -------
    Separation
        Part ``error`` (n_y, n_x) with ``u``; the null space is removed by least squares.

    Raises
    ------
    NotSeparableError
        If one direction has no lines, or the crossings do not join them.
    TooFewSamplesError
        If a direction has fewer than two lines.

    Notes
    -----
    Null space: what every x line and every y line can take as its own offset and slope. With free
    slopes ``1, x, y, xy``: the twist of the plane is lost, although both directions are measured.
    With a common slope ``1, x, y``; with a fixed reference ``1``. Points on a line that crosses
    others less than twice are NaN. u is that of the map without these terms.

    Examples
    --------
    >>> rng = np.random.default_rng(1)
    >>> e = 1e-9 * rng.standard_normal((5, 6))
    >>> rows = e + 1e-6 * rng.standard_normal((5, 1))
    >>> columns = e + 1e-6 * rng.standard_normal((1, 6))
    >>> found = coupled_grid(rows, columns, dx=1e-3, dy=1e-3, slopes="none")
    >>> bool(abs(found.error - (e - e.mean())).max() < 1e-18)
    True
    """
    refuse_unknown(slopes, repeats)
    if u_reading is not None:
        u_reading = not_negative(u_reading, "u_reading", dimension="length")
    sets, x, y, history = _sets(x_lines, y_lines, dx, dy)
    counts = np.stack([(~np.isnan(s)).sum(axis=0) for s in sets])
    n_lines = (int(counts[0].any(axis=1).sum()), int(counts[1].any(axis=0).sum()))
    for n, axis, other in ((n_lines[0], "x", "y"), (n_lines[1], "y", "x")):
        if n == 0:
            raise NotSeparableError(
                f"there is no line along {axis}: lines along {other} alone leave their offsets and "
                f"slopes against each other open; add at least two lines along {axis}"
            )
        if n < 2:
            raise TooFewSamplesError(
                f"there is one line along {axis}; two or more are needed to join the others"
            )
    with one_blas_thread():
        solved = Joined(lays_of(sets, repeats == "relaid"), x, y, slopes)
    noise = noise_of(solved.squares, solved.dof, u_reading, "crossings")
    sigma = noise.value
    shape = counts.shape[1:]
    error, u = np.full(shape, np.nan), np.full(shape, np.nan)
    error[solved.used] = solved.error
    u[solved.used] = sigma * np.sqrt(solved.variance)
    lost = int((counts.any(axis=0) & ~solved.used).sum())
    null = [unseen_terms(slopes)]
    messages = [f"removed from the map because no line can see it: {', '.join(TERMS[slopes])}"]
    if lost:
        null.append(
            Unobservable("error", "samples", (lost,), "on lines that cross too few others: NaN")
        )
        messages.append(f"{lost} points lie on lines that cross too few others: NaN")
    messages += _moved(solved)
    if math.isnan(sigma):
        messages.append("no redundancy and no u_reading: the uncertainty is not known (NaN)")
    return Separation(
        "coupled_grid",
        {"error": error},
        {"error": u},
        {"error": "m"},
        {"x": x, "y": y},
        tuple(null),
        noise,
        audit={
            "n_lines_along_x": n_lines[0],
            "n_lines_along_y": n_lines[1],
            "n_readings": int(counts.sum()),
            "n_crossings": int((counts.min(axis=0) > 0).sum()),
            "slopes": slopes,
            "repeats": repeats,
            "degrees_of_freedom": solved.dof,
            "residual_rms_nm": solved.residual_rms * 1e9,
            "removed": list(TERMS[slopes]),
        },
        messages=tuple(messages),
        history=history,
    )


def unseen_terms(slopes: Slopes) -> Unobservable:
    """Return what every line can take as its own offset and slope."""
    reason = (
        "each line has an offset and a slope of its own"
        if slopes == "free"
        else "the reference of the lines is not known"
    )
    return Unobservable("error", "term", TERMS[slopes], reason)


def _moved(solved: Joined) -> list[str]:
    """Say if passes of one lay differ by line terms by more than the rest of the noise."""
    share, terms = solved.moved
    if not moved_between(solved.squares, solved.dof, share, terms):
        return []
    kept = math.sqrt(max(solved.squares - share, 0.0) / (solved.dof - terms)) * 1e9
    text = (
        "passes over one line differ by offset and slope by more than the rest of their noise "
        f"({kept:.3g} nm): the lines were laid anew between the repeats; give repeats = 'relaid', as "
        "stated noise and u are too large"
    )
    return [text]


def _sets(
    x_lines: Surface | ArrayLike, y_lines: Surface | ArrayLike, dx: float | None, dy: float | None
) -> tuple[list[FloatArray], FloatArray, FloatArray, tuple[Step, ...]]:
    origin = (0.0, 0.0)
    history: tuple[Step, ...] = ()
    arrays = []
    surfaces = [s for s in (x_lines, y_lines) if isinstance(s, Surface)]
    if len(surfaces) == 1 or (surfaces and (dx is not None or dy is not None)):
        raise DataError("give both sets of lines as surfaces without dx and dy, or both as arrays")
    if surfaces:
        first, second = surfaces
        if (first.dx, first.dy, first.origin) != (second.dx, second.dy, second.origin):
            raise DataError("the two sets of lines lie on different grids; resample one of them")
        dx, dy, origin = first.dx, first.dy, first.origin
        history = (*first.history, *second.history)
    for item, axis in ((x_lines, "x"), (y_lines, "y")):
        numbers = item.z if isinstance(item, Surface) else real_numbers(item, f"{axis}_lines")
        values = np.array(numbers, dtype=np.float64)
        values = values[np.newaxis] if values.ndim == 2 else values
        if values.ndim != 3 or min(values.shape[1:]) < 2 or np.isinf(values).any():
            raise DataError(
                f"{axis}_lines must have the shape (n_y, n_x) or (repeats, n_y, n_x), at least "
                f"2 x 2 and finite or NaN; got {values.shape}"
            )
        arrays.append(values)
    if arrays[0].shape[1:] != arrays[1].shape[1:]:
        raise DataError(
            f"x_lines and y_lines must lie on one grid, got {arrays[0].shape[1:]} and "
            f"{arrays[1].shape[1:]}; write NaN where a line was not run"
        )
    step_x, step_y = plane_steps(dx, dy)
    n_y, n_x = arrays[0].shape[1:]
    x = np.asarray(origin[0] + step_x * np.arange(n_x), dtype=np.float64)
    y = np.asarray(origin[1] + step_y * np.arange(n_y), dtype=np.float64)
    return arrays, x, y, history
