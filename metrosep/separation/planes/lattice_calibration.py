"""2-D self-calibration: errors of a stage and of a grid plate from views of the same plate.

``reading(site) = nominal + plate(mark) + stage(site) + placement``: the plate is measured as placed,
turned by quarter turns, and shifted by whole pitches; every placement has an unknown translation
and rotation. Both errors are unknown. Least squares on the lattice, whose null space is computed
from the design. The stage error is what the stage adds to a reading (indication minus true
position): the correction to add to its readings is the negative. Arrays are (n_y, n_x, 2), last
axis x and y component; rows grow with y, columns with x; quarter turns count from x to y.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, ClassVar

import numpy as np
from numpy.typing import ArrayLike

from metrosep.core._arrays import BoolArray, FloatArray
from metrosep.core.blas import one_blas_thread
from metrosep.core.docs import described_by
from metrosep.core.errors import DataError, NotSeparableError, UnitError
from metrosep.core.methods import RoleColumns
from metrosep.core.numbers import not_negative, positive
from metrosep.core.options import Option, option
from metrosep.core.provenance import Step
from metrosep.separation._readings import known_parts, part_of, real_numbers
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
    Repeats,
    TableGrid,
    moved_between,
    noise_of,
    refuse_unknown,
    repeats_of,
    same_points,
    shares_of_passes,
)

_TERMS = ("translation x", "translation y", "rotation", "scale")


_MOST_SITES = 31 * 31

_NAMED = {"initial": (0, (0, 0)), "rotated": (1, (0, 0)), "shifted": (0, (1, 0))}


@dataclass(frozen=True, slots=True, eq=False, repr=False)
class GridView:
    """Readings of a grid plate in one placement.

    Parameters
    ----------
    readings : array_like, shape (n_y, n_x, 2) or (n_repeats, n_y, n_x, 2), m
        Reading minus nominal position of the mark at each site of the stage, x and y component
        along the axes of the stage; NaN where no mark is or was read.
    turns : int, optional
        Quarter turns of the plate about the centre of the lattice, from x towards y.
    shift : tuple of (int, int), pitches, optional
        Shift of the plate along x and y of the stage, after the turn.
    """

    readings: ArrayLike
    turns: int = 0
    shift: tuple[int, int] = (0, 0)

    def __repr__(self) -> str:
        return f"GridView({np.shape(self.readings)}, turns={self.turns}, shift={self.shift})"


Placement = tuple[int, tuple[int, int]]

_INITIAL_ROTATED_SHIFTED: tuple[Placement, ...] = ((0, (0, 0)), (1, (0, 0)), (0, (1, 0)))


@dataclass(frozen=True, slots=True)
class GridCalibration(RecordedMethod):
    """Views of a grid plate on a stage.

    Readings (n_views, n_y, n_x, 2) or (n_views, M, n_y, n_x, 2) in m: reading minus nominal position
    along the axes of the stage, NaN where no mark is or was read. Parts (n_y, n_x, 2) in m: ``stage``,
    what the stage adds at each site, and ``plate``, the error of each mark along the axes of the
    plate. `u_reading` is what the noise is believed to be. Simulated views are placed without translation and rotation. Readings larger than half the
    pitch are refused with a UnitError.

    Parameters
    ----------
    placements : tuple of (int, (int, int)), optional
        Quarter turns from x to y, and the shift along x and y in pitches after it, of each view:
        as placed, turned once, and shifted by one pitch along x if omitted.

    Raises
    ------
    DataError
        If the pitch is not positive, a turn or a shift is not a whole number, or
        `repeats` is unknown.

    Examples
    --------
    >>> method = GridCalibration(1e-2)
    >>> plate = np.zeros((3, 3, 2))
    >>> plate[0, 0] = (1e-9, 0.0)
    >>> views = method.simulate({"plate": plate}, {})
    >>> (views[1, 0, 2] * 1e9).tolist(), bool(np.isnan(views[2, :, 0]).all())
    ([0.0, 1.0], True)
    """

    pitch: float = option(
        kind="size", required=False, help="of the grid; the step of the table if omitted"
    )
    placements: tuple[Placement, ...] = _INITIAL_ROTATED_SHIFTED
    repeats: Repeats = option(
        "relaid",
        kind="text",
        choices=("relaid", "passes"),
        help="relaid: the plate was placed anew for each repeat of a view, with a translation and "
        "rotation of its own; passes: it stayed where it lay",
    )

    name = "grid_calibration"
    what = "errors of a stage and of a grid plate from views of the plate"
    reads = "table"
    roles: ClassVar[Mapping[str, str]] = {
        **PLACE, "ex": "length", "ey": "length", "view": "label", "repeat": "label?",
    }  # fmt: skip
    arguments: ClassVar[Mapping[str, Option]] = {
        **U_READING,
        "turns": Option(
            "integers", help="quarter turns of the plate in each view, in their order"
        ),
        "shifts": Option("pairs", help="pitches by which the plate was shifted in each view"),
    }
    truth_parts = ("plate",)
    error_parts = ("stage",)

    @classmethod
    def from_inputs(cls, data: RoleColumns, options: Mapping[str, Any]) -> Separation:
        """Return the calibration from views; others than the three named ones have turns and shifts."""
        rest, grid, marks = dict(options), TableGrid(data), data.values["view"]
        pitch = rest.pop("pitch", grid.dx)
        names = list(dict.fromkeys(marks.tolist()))
        turns, shifts = rest.pop("turns", None), rest.pop("shifts", None)
        views: dict[str, FloatArray] = {}
        for name in names:
            repeats = []
            for what, rows in repeats_of(data):
                chosen = rows & (marks == name)
                if chosen.any():
                    where = f"{what}, view {name}"
                    pair = [grid.filled(data.values[e], chosen, where) for e in ("ex", "ey")]
                    repeats.append(np.stack(pair, axis=-1))
            views[name] = repeats[0] if len(repeats) == 1 else np.array(repeats)
        if turns is None and shifts is None:
            return grid_calibration(views, pitch=pitch, **rest)
        turns = turns or (0,) * len(names)
        shifts = shifts or ((0, 0),) * len(names)
        if not len(turns) == len(shifts) == len(names):
            raise DataError(
                f"turns and shifts need one entry for each view ({', '.join(names)}), in their order"
            )
        each = zip(views.values(), turns, shifts, strict=True)
        return grid_calibration([GridView(v, t, s) for v, t, s in each], pitch=pitch, **rest)

    def __post_init__(self) -> None:
        settle(self, pitch=positive(self.pitch, "pitch", dimension="length"))
        refuse_unknown("free", self.repeats)
        for i, placement in enumerate(self.placements, start=1):
            try:
                turns, shift = placement
            except (TypeError, ValueError):
                raise DataError(
                    f"placement {i} is {placement!r}; give (turns, (shift x, shift y))"
                ) from None
            checked_placement(GridView((), turns, shift), i)

    def simulate(self, truth: Parts, errors: Parts) -> FloatArray:
        parts = known_parts(self, truth, errors)
        shape = next(iter(parts.values())).shape
        if len(shape) != 3 or shape[2] != 2:
            raise DataError(f"{self.name}: parts have the shape (n_y, n_x, 2), got {shape}")
        odd = any(turns % 2 for turns, _ in self.placements)
        if odd and (shape[0] - shape[1]) % 2:
            raise DataError(
                f"{self.name}: a lattice of {shape[0]} x {shape[1]} does not fall onto itself when "
                "turned by a quarter; take rows and columns that are both even or both odd"
            )
        plate, stage = (part_of(parts, n, shape, self.name) for n in ("plate", "stage"))
        return np.stack([stage + _on_stage(plate, *p) for p in self.placements])

    def null_space(self) -> tuple[Unobservable, ...]:
        return unseen_terms()

    def _solved(self, readings: ArrayLike, stated: float | None, history: History) -> Separation:
        views = np.asarray(real_numbers(readings, f"{self.name}: readings"), dtype=np.float64)
        count = len(self.placements)
        if views.ndim not in (4, 5) or views.shape[0] != count or views.shape[-1] != 2:
            raise DataError(
                f"{self.name} has {count} placements: the readings need the shape ({count}, n_y, n_x, "
                f"2) or ({count}, repeats, n_y, n_x, 2), got {views.shape}"
            )
        given = [GridView(v, *p) for v, p in zip(views, self.placements, strict=True)]
        found = grid_calibration(given, pitch=self.pitch, repeats=self.repeats, u_reading=stated)
        step = Step(self.name, {"pitch_m": self.pitch, "repeats": self.repeats})
        return replace(found, history=(*history, step))


@described_by(GridCalibration, GridCalibration.separate)
def grid_calibration(
    views: Mapping[str, ArrayLike] | Sequence[GridView],
    *,
    pitch: float,
    repeats: Repeats = "relaid",
    u_reading: float | None = None,
) -> Separation:
    """Return the errors of a stage and of a grid plate from views of the plate.

    Parameters
    ----------
    views : mapping of str to array_like, or sequence of GridView
        Readings under the names ``initial``, ``rotated`` (a quarter turn from x to y) and
        ``shifted`` (one pitch along +x), or views with turns and shifts of their own.
    u_reading : float, m, optional
        Standard uncertainty of one reading as it is believed; a message says if the residuals
        exceed it.

    Returns
    -------
    Separation
        Parts ``stage`` and ``plate``, (n_y, n_x, 2), with their translation, rotation and scale
        removed by least squares; NaN where a site or mark is not determined.

    Raises
    ------
    NotSeparableError
        If the views lack a quarter turn or a translation, or leave more undetermined than
        translation, rotation and scale; the message names what is missing.
    UnitError
        If the readings are larger than the pitch: they must be deviations in m.

    Notes
    -----
    Null space: translation and rotation of each part (the placements are free), and the scale: a
    stage that reads too long on a plate that is too short gives the same readings in every view.
    No length enters, so none comes out; calibrate one distance of the plate. u is from the
    covariance of the fit with the noise of its residuals; it grows slowly with the lattice. Where
    all repeats of a view read the same marks, both kinds of `repeats` give the same parts; a plate
    that was placed anew and is said to have stayed makes noise of its placements.

    References
    ----------
    .. [1] J. Ye, M. Takac, C. N. Berglund, G. Owen, R. F. Pease, Precision Eng. 20 (1997).
    .. [2] M. R. Raugh, Precision Eng. 7 (1985).

    Examples
    --------
    >>> rng = np.random.default_rng(1)
    >>> stage = 1e-7 * rng.standard_normal((5, 5, 2))
    >>> shifted = stage.copy()
    >>> shifted[:, 0] = np.nan  # perfect plate, moved one pitch along x
    >>> found = grid_calibration(
    ...     {"initial": stage, "rotated": stage, "shifted": shifted}, pitch=1e-2)
    >>> bool(abs(found.plate).max() < 1e-15)
    True
    """
    refuse_unknown("free", repeats)
    step = positive(pitch, "pitch", dimension="length")
    stated = u_reading
    if stated is not None:
        stated = not_negative(stated, "u_reading", dimension="length")
    parsed = parsed_views(views)
    size = checked_size(parsed, step)
    refuse_inseparable(parsed)
    with one_blas_thread():
        fit = Lattice(parsed, size, repeats == "relaid")
        other = better_turns(parsed, size, fit.sigma, repeats == "relaid")
    dof = fit.n_readings - fit.rank
    noise = noise_of(fit.squares, dof, stated, "views")
    sigma = noise.value
    n_y, n_x = size
    return Separation(
        "grid_calibration",
        {"stage": fit.parts[0], "plate": fit.parts[1]},
        {"stage": sigma * fit.u[0], "plate": sigma * fit.u[1]},
        {"stage": "m", "plate": "m"},
        {"x": _centred(n_x, step), "y": _centred(n_y, step)},
        unseen_terms() + fit.unseen(),
        noise,
        audit={
            "placements": [[v.turns, v.shift[0], v.shift[1]] for v, _ in parsed],
            "pitch_mm": step * 1e3,
            "repeats": repeats,
            "n_readings": fit.n_readings,
            "degrees_of_freedom": dof,
            "null_space_dimension": fit.null_dimension,
            "removed_from_both_parts": list(_TERMS),
            "scale_ppm": None,
            "sum_of_scales_ppm": fit.sum_of_scales / step * 1e6,
            "residual_rms_nm": math.sqrt(fit.squares / fit.n_readings) * 1e9,
        },
        messages=_messages(fit, sigma, stated, step, parsed, other),
    )  # fmt: skip


def _on_stage(plate: FloatArray, turns: int, shift: tuple[int, int]) -> FloatArray:
    """Return what the marks of a turned and shifted plate add at the sites of the stage."""
    n_y, n_x = plate.shape[:2]
    turn = _quarter_turns(turns)
    middle = np.array([(n_x - 1) / 2, (n_y - 1) / 2])
    rows, columns = np.mgrid[:n_y, :n_x]
    sites = np.stack([columns, rows], axis=-1) - middle - np.array(shift)
    marks = np.rint(sites @ turn + middle).astype(np.intp)  # turn transposed, times the site
    on_plate = ((marks >= 0) & (marks < np.array([n_x, n_y]))).all(axis=-1)
    seen = np.full(plate.shape, np.nan)
    seen[on_plate] = plate[marks[on_plate][:, 1], marks[on_plate][:, 0]] @ turn.T
    return seen


def unseen_terms() -> tuple[Unobservable, ...]:
    """Return what no set of views determines."""
    reason = "placements are free, and no length enters: a long stage on a short plate reads alike"
    return tuple(Unobservable(part, "term", _TERMS, reason) for part in ("stage", "plate"))


def _centred(n: int, pitch: float) -> FloatArray:
    return np.asarray((np.arange(n) - (n - 1) / 2) * pitch, dtype=np.float64)


def _messages(
    fit: Lattice,
    sigma: float,
    u_reading: float | None,
    pitch: float,
    views: list[tuple[GridView, FloatArray]],
    other: tuple[list[int], float] | None,
) -> tuple[str, ...]:
    total = fit.sum_of_scales / pitch * 1e6
    scale = (
        f"the scale of stage and plate is not recoverable, only their sum ({total:.4g} ppm): "
        "calibrate one distance of the plate"
    )
    out = [scale]
    for part, lost in zip(("stage sites", "plate marks"), fit.lost, strict=True):
        if lost:
            out.append(f"{lost} {part} are not determined by these views: NaN")
    dof = fit.n_readings - fit.rank
    if moved_between(fit.squares, dof, *fit.moved):
        out.append(
            "repeats of a view differ by translation and rotation by more than their noise: the plate "
            "was placed anew between them; give repeats = 'relaid', as stated noise and u are too large"
        )
    if math.isnan(sigma):
        out.append("no redundancy and no u_reading: the uncertainty is not known (NaN)")
    elif u_reading is not None and sigma > 1.5 * u_reading:
        out.append(
            f"the residuals scatter by {sigma * 1e9:.3g} nm, more than the stated "
            f"{u_reading * 1e9:.3g} nm: the plate bends with its placement, a turn or a shift is "
            "not what it was said to be, or the stage drifts"
        )
    if other is not None:
        named = " and ".join(
            f"view {i} turned by {-90 * views[i - 1][0].turns:+d} degrees instead of "
            f"{90 * views[i - 1][0].turns:+d}"
            for i in other[0]
        )
        out.append(
            f"the residuals of {sigma * 1e9:.3g} nm fall to {other[1] * 1e9:.3g} nm with {named}: "
            "check the sense of the turn (positive from x towards y); as stated, the result is wrong"
        )
    return tuple(out)


# ---- private helper: least squares of stage, plate and placements on a lattice, with its null space ----

_RANK = 1e-10
"""Eigenvalues of the normal matrix below this share of the largest are null."""

_SUSPECT = 0.02
"""Residual over readings from which another sense of the turns is tried."""

_BETTER = 0.5
"""Residual with the other sense over the residual as stated, below which it is reported."""


class Lattice:
    """Joint least squares; unknowns: stage (site, component), plate (mark, component), placements."""

    def __init__(
        self, views: list[tuple[GridView, FloatArray]], size: tuple[int, int], relaid: bool = False
    ) -> None:
        self.size = size
        n = size[0] * size[1]
        lays = [(i, v, z) for i, (v, r) in enumerate(views) for z in _lays(r, relaid)]
        blocks = [_rows(i, k, v, r, size, len(lays)) for k, (i, v, r) in enumerate(lays)]
        design = np.concatenate([b[0] for b in blocks])
        mean = np.concatenate([b[1] for b in blocks])
        weight = np.concatenate([b[2] for b in blocks])
        owner = np.repeat(np.arange(len(lays)), [b[1].size for b in blocks])
        about = [b[3] for b in blocks]
        keep = np.ones(4 * n, dtype=bool)
        while True:
            seen = np.abs(design[:, : 4 * n]).sum(axis=0) > 0
            keep &= seen
            use = np.abs(design[:, : 4 * n][:, ~keep]).sum(axis=1) == 0
            columns = np.concatenate([keep, np.ones(3 * len(lays), dtype=bool)])
            a = design[np.ix_(use, columns)]
            inverse, null, values = _pseudo_inverse(a, weight[use])
            functions = _removed(size, keep)
            stray = _stray(null[: int(keep.sum())], functions)
            if not stray.any():
                break
            if stray.mean() > 0.25 or keep.mean() < 0.5:
                raise NotSeparableError(
                    f"these views leave {null.shape[1]} patterns undetermined, not only "
                    "translation, rotation and scale: a view turned by 90 degrees and one shifted "
                    "by one pitch, both with most marks read, are needed"
                )
            keep[np.flatnonzero(keep)[stray]] = False
            about = [rows[use[owner == k]] for k, rows in enumerate(about)]
            design, mean, weight, owner = design[use], mean[use], weight[use], owner[use]
        placed = [design[use & (owner == k)][:, 4 * n + 3 * k :][:, :3] for k in range(len(lays))]
        about = [rows[use[owner == k]] for k, rows in enumerate(about)]
        shares = [shares_of_passes(r.T, p) for r, p in zip(about, placed, strict=True)]
        total = sum(float(np.nansum(rows**2)) for rows in about)
        share, rank = sum(p[1] for p in shares), sum(p[2] for p in shares)
        pure = total - share if relaid else total
        self._finish(a, mean[use], weight[use], inverse, functions, keep, max(pure, 0.0))
        self.n_readings = int(weight[use].sum())
        self.rank = int(values.size) + (rank if relaid else 0)
        self.moved = (0.0, 0) if relaid else (share, rank)
        self.null_dimension = int(null.shape[1])

    def _finish(
        self,
        a: FloatArray,
        mean: FloatArray,
        weight: FloatArray,
        inverse: FloatArray,
        functions: list[FloatArray],
        keep: BoolArray,
        pure: float,
    ) -> None:
        n = self.size[0] * self.size[1]
        solution = inverse @ (a.T @ (weight * mean))
        solution = solution + inverse @ (a.T @ (weight * (mean - a @ solution)))
        left = mean - a @ solution
        self.squares = float(weight @ left**2) + pure
        self.parts: list[FloatArray] = []
        self.u: list[FloatArray] = []
        self.lost: list[int] = []
        self.sum_of_scales = 0.0
        start = 0
        for part, q in enumerate(functions):
            own = keep[2 * n * part : 2 * n * (part + 1)]
            stop = start + int(own.sum())
            values = solution[start:stop]
            covariance = inverse[start:stop, start:stop]
            half = covariance - q @ (q.T @ covariance)
            variance = np.diag(half) - np.einsum("ij,ij->i", half @ q, q)
            full, u = np.full(2 * n, np.nan), np.full(2 * n, np.nan)
            full[own] = values - q @ (q.T @ values)
            u[own] = np.sqrt(np.maximum(variance, 0.0))
            scale = _radial(self.size)[own]
            other = np.column_stack([_rigid(self.size)[own], scale])
            self.sum_of_scales += float(np.linalg.lstsq(other, values, rcond=None)[0][3])
            shape = (*self.size, 2)
            self.parts.append(full.reshape(shape))
            self.u.append(u.reshape(shape))
            self.lost.append(int(np.isnan(full.reshape(shape)).any(axis=-1).sum()))
            start = stop

    @property
    def sigma(self) -> float:
        """Standard deviation of one reading from the residuals; NaN without redundancy."""
        dof = self.n_readings - self.rank
        return math.sqrt(self.squares / dof) if dof > 0 else math.nan

    def unseen(self) -> tuple[Unobservable, ...]:
        """Return sites and marks that are not determined."""
        names = ("stage", "plate")
        return tuple(
            Unobservable(part, "samples", (lost,), "not read in enough views: NaN")
            for part, lost in zip(names, self.lost, strict=True)
            if lost
        )


def _lays(readings: FloatArray, relaid: bool) -> list[FloatArray]:
    """Return what shares a placement; repeats placed anew that read the same marks go together."""
    return (same_points(readings) if relaid else []) or [readings]


def _rows(
    number: int,
    index: int,
    view: GridView,
    readings: FloatArray,
    size: tuple[int, int],
    n_views: int,
) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:
    """Design rows, mean readings, counts and the repeats about their mean of one placement."""
    n_y, n_x = size
    n = n_y * n_x
    count = (~np.isnan(readings)).sum(axis=0)
    turn = _quarter_turns(view.turns)
    rows, values, weights, about = [], [], [], []
    for j, i in np.ndindex(n_y, n_x):
        site = np.array([i - (n_x - 1) / 2, j - (n_y - 1) / 2])
        mark = turn.T @ (site - np.array(view.shift))
        column, row = mark[0] + (n_x - 1) / 2, mark[1] + (n_y - 1) / 2
        on_plate = -0.1 < column < n_x - 0.9 and -0.1 < row < n_y - 0.9
        for c in range(2):
            if not count[j, i, c]:
                continue
            if not on_plate:
                raise DataError(
                    f"view {number + 1} has a reading at row {j}, column {i}, where its turn "
                    f"({view.turns}) and shift {view.shift} put no mark; write NaN there, or "
                    "check the sign of the shift"
                )
            line = np.zeros(4 * n + 3 * n_views)
            line[2 * (j * n_x + i) + c] = 1.0
            first = 2 * n + 2 * (round(row) * n_x + round(column))
            line[first : first + 2] = turn[c]
            line[4 * n + 3 * index + c] = 1.0
            line[4 * n + 3 * index + 2] = (-site[1], site[0])[c] / max(size)
            got = readings[:, j, i, c]
            values.append(float(np.nanmean(got)))
            weights.append(float(count[j, i, c]))
            about.append(got - values[-1])
            rows.append(line)
    if not rows:
        raise DataError(f"view {number + 1} holds no readings")
    return np.array(rows), np.array(values), np.array(weights), np.array(about)


def _quarter_turns(n: int) -> FloatArray:
    cos, sin = ((1, 0), (0, 1), (-1, 0), (0, -1))[n % 4]
    return np.array([[cos, -sin], [sin, cos]], dtype=np.float64)


def _pseudo_inverse(
    a: FloatArray, weight: FloatArray
) -> tuple[FloatArray, FloatArray, FloatArray]:
    values, vectors = np.linalg.eigh(a.T @ (weight[:, np.newaxis] * a))
    null = values < _RANK * values[-1]
    kept = vectors[:, ~null]
    return (kept / values[~null]) @ kept.T, vectors[:, null], values[~null]


def _radial(size: tuple[int, int]) -> FloatArray:
    n_y, n_x = size
    j, i = np.mgrid[:n_y, :n_x]
    return np.stack([i - (n_x - 1) / 2, j - (n_y - 1) / 2], axis=-1).reshape(-1).astype(np.float64)


def _rigid(size: tuple[int, int]) -> FloatArray:
    site = _radial(size).reshape(-1, 2)
    turned = np.stack([-site[:, 1], site[:, 0]], axis=-1).reshape(-1)
    along_x = np.tile([1.0, 0.0], site.shape[0])
    return np.asarray(np.column_stack([along_x, 1.0 - along_x, turned]), dtype=np.float64)


def _removed(size: tuple[int, int], keep: BoolArray) -> list[FloatArray]:
    """Orthonormal translation, rotation and scale of stage and plate on what is determined."""
    n = size[0] * size[1]
    basis = np.column_stack([_rigid(size), _radial(size)])
    return [np.linalg.qr(basis[keep[2 * n * k : 2 * n * (k + 1)]])[0] for k in range(2)]


def _stray(null: FloatArray, functions: list[FloatArray]) -> BoolArray:
    """Which unknowns a null vector moves by more than translation, rotation and scale."""
    split = functions[0].shape[0]
    rest = [
        part - q @ (q.T @ part)
        for part, q in zip((null[:split], null[split:]), functions, strict=True)
    ]
    moved: BoolArray = np.abs(np.concatenate(rest)).max(axis=1, initial=0.0) > 1e-5
    return moved


def better_turns(
    views: list[tuple[GridView, FloatArray]],
    size: tuple[int, int],
    sigma: float,
    relaid: bool = False,
) -> tuple[list[int], float] | None:
    """Return numbers of the views that fit clearly better turned the other way, and the residual.

    None where the residuals are small against the readings, or no other sense fits better.
    """
    odd = [i for i, (v, _) in enumerate(views) if v.turns % 2]
    size_of_readings = max(float(np.nanstd(r)) for _, r in views)
    if not sigma > _SUSPECT * size_of_readings:
        return None
    best: tuple[list[int], float] | None = None
    for other in [odd, *([i] for i in odd if len(odd) > 1)]:
        turned = [
            (GridView(v.readings, -v.turns, v.shift), r) if i in other else (v, r)
            for i, (v, r) in enumerate(views)
        ]
        try:
            found = Lattice(turned, size, relaid).sigma
        except (DataError, NotSeparableError):
            continue
        if found < _BETTER * sigma and (best is None or found < best[1]):
            best = ([i + 1 for i in other], found)
    return best


# ---- the checks on views of a grid plate --------------------------------------------------------


def parsed_views(
    views: Mapping[str, ArrayLike] | Sequence[GridView],
) -> list[tuple[GridView, FloatArray]]:
    """Return the views with their readings of shape (repeats, n_y, n_x, 2)."""
    if isinstance(views, Mapping):
        unknown = [name for name in views if name not in _NAMED]
        if unknown:
            raise DataError(
                f"views are named {', '.join(_NAMED)}, got {unknown}; use GridView for others"
            )
        views = [GridView(r, _NAMED[n][0], _NAMED[n][1]) for n, r in views.items()]
    out = []
    items: list[Any] = list(views)
    for i, view in enumerate(items, start=1):
        if not isinstance(view, GridView):
            raise DataError(f"view {i} is a {type(view).__name__}; give GridView objects")
        values = np.array(real_numbers(view.readings, f"view {i}: readings"), dtype=np.float64)
        values = values[np.newaxis] if values.ndim == 3 else values
        if values.ndim != 4 or values.shape[-1] != 2 or np.isinf(values).any():
            raise DataError(
                f"view {i}: readings must have the shape (n_y, n_x, 2), x and y component, finite "
                f"or NaN; got {values.shape}"
            )
        turns, shift = checked_placement(view, i)
        out.append((GridView(view.readings, turns, shift), values))
    return out


def checked_placement(view: GridView, number: int) -> tuple[int, tuple[int, int]]:
    """Return turns and shift as whole numbers."""
    whole: list[int] = []
    given: list[Any] = []
    try:
        given = [view.turns, *view.shift]
        whole = [int(k) for k in given]
    except (TypeError, ValueError, OverflowError):
        whole = []
    if len(whole) != 3 or whole != given:
        raise DataError(
            f"view {number}: turns is a whole number of 90 degrees and shift a pair of whole "
            f"pitches (x, y), such as (1, 0); got turns={view.turns!r}, shift={view.shift!r}"
        )
    return whole[0], (whole[1], whole[2])


def checked_size(views: list[tuple[GridView, FloatArray]], pitch: float) -> tuple[int, int]:
    """Return the rows and columns that all views share."""
    shapes = {values.shape[1:3] for _, values in views}
    if len(shapes) > 1:
        raise DataError(f"the views differ in shape: {sorted(shapes)}; use NaN where no mark is")
    if not shapes:
        raise NotSeparableError("there is no view; give initial, rotated and shifted")
    n_y, n_x = shapes.pop()
    if min(n_x, n_y) < 3 or n_x * n_y > _MOST_SITES:
        raise DataError(f"the lattice is {n_y} x {n_x}; it must have 3 x 3 to 961 sites")
    if (n_x - n_y) % 2 and any(v.turns % 2 for v, _ in views):
        raise DataError(
            f"a lattice of {n_y} x {n_x} does not fall onto itself when turned about its centre; "
            "use numbers of rows and columns that are both even or both odd"
        )
    for i, (_, values) in enumerate(views, start=1):
        known = np.abs(values[~np.isnan(values)])
        if known.size and known.max() > 0.5 * pitch:
            raise UnitError(
                f"view {i}: a reading of {known.max():.4g} m exceeds half the pitch of {pitch:.4g} "
                "m; give reading minus nominal position, in m"
            )
    return n_y, n_x


def refuse_inseparable(views: list[tuple[GridView, FloatArray]]) -> None:
    """Refuse views that cannot tell the stage from the plate."""
    turns = {(v.turns - views[0][0].turns) % 4 for v, _ in views}
    placements = {(v.turns % 4, v.shift) for v, _ in views}
    missing = []
    if not turns & {1, 3}:
        missing.append("a view turned by 90 degrees")
    one_each = len(placements) < 3 and len(placements) == len({t for t, _ in placements})
    if one_each or len({s for _, s in placements}) == 1:
        missing.append("a view shifted by one pitch")
    if missing:
        raise NotSeparableError(
            f"these views cannot tell the stage from the plate: {' and '.join(missing)} is missing"
        )
