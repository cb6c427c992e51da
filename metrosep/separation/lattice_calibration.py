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
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from metrosep.core.blas import one_blas_thread
from metrosep.core.errors import DataError, NotSeparableError, UnitError
from metrosep.core.quantity import Quantity
from metrosep.separation.contract import Separation
from metrosep.separation.null_space import Unobservable

__all__ = ["GridView", "grid_calibration"]

FloatArray = NDArray[np.float64]
BoolArray = NDArray[np.bool_]

_RANK = 1e-10
"""Eigenvalues of the normal matrix below this share of the largest are null."""

_MOST_SITES = 31 * 31

_TERMS = ("translation x", "translation y", "rotation", "scale")

_NAMED = {"initial": (0, (0, 0)), "rotated": (1, (0, 0)), "shifted": (0, (1, 0))}


@dataclass(frozen=True, slots=True, eq=False)
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


def grid_calibration(
    views: Mapping[str, ArrayLike] | Sequence[GridView],
    *,
    pitch: float,
    u_reading: float | None = None,
) -> Separation:
    """Return the errors of a stage and of a grid plate from views of the plate.

    Parameters
    ----------
    views : mapping of str to array_like, or sequence of GridView
        Readings under the names ``initial``, ``rotated`` (a quarter turn from x to y) and
        ``shifted`` (one pitch along +x), or views with turns and shifts of their own.
    pitch : float, m
        Pitch of the lattice.
    u_reading : float, m, optional
        Standard uncertainty of one reading as it is believed; a message tells if the residuals
        exceed it.

    Returns
    -------
    Separation
        Parts ``stage`` and ``plate``, (n_y, n_x, 2), with their translation, rotation and scale
        removed by least squares; NaN where a site or mark is not determined.

    Raises
    ------
    DataError
        If shapes differ, a turn or shift is not whole, or the lattice is too large or too small.
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
    covariance of the fit with the noise of its residuals; it grows slowly with the lattice.

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
    parsed = _views(views)
    size = _checked(parsed, pitch)
    _needs(parsed)
    with one_blas_thread():
        fit = _Lattice(parsed, size)
    dof = fit.n_readings - fit.rank
    sigma = math.sqrt(fit.squares / dof) if dof > 0 else math.nan
    text = "standard deviation of one reading"
    noise = (
        Quantity(sigma, "m", f"{text}, from the views", u=sigma / math.sqrt(2 * dof), symbol="s")
        if dof > 0
        else Quantity(math.nan, "m", f"{text}; not known", symbol="s")
    )
    if dof <= 0 and u_reading is not None:
        sigma = float(u_reading)
        noise = Quantity(sigma, "m", f"{text}, as stated", symbol="s")
    n_y, n_x = size
    reason = "placements are free, and no length enters: a long stage on a short plate reads alike"
    return Separation(
        "grid_calibration",
        {"stage": fit.parts[0], "plate": fit.parts[1]},
        {"stage": fit.uncertainty(0, sigma), "plate": fit.uncertainty(1, sigma)},
        {"stage": "m", "plate": "m"},
        {"x": _centred(n_x, pitch), "y": _centred(n_y, pitch)},
        tuple(Unobservable(part, "term", _TERMS, reason) for part in ("stage", "plate"))
        + fit.unseen(),
        noise,
        audit={
            "placements": [[v.turns, v.shift[0], v.shift[1]] for v, _ in parsed],
            "pitch_mm": float(pitch) * 1e3,
            "n_readings": fit.n_readings,
            "degrees_of_freedom": dof,
            "null_space_dimension": fit.null_dimension,
            "removed_from_both_parts": list(_TERMS),
            "scale_ppm": math.nan,
            "sum_of_scales_ppm": fit.sum_of_scales / float(pitch) * 1e6,
            "residual_rms_nm": math.sqrt(fit.squares / fit.n_readings) * 1e9,
        },
        messages=_messages(fit, sigma, u_reading, float(pitch)),
    )  # fmt: skip


def _centred(n: int, pitch: float) -> FloatArray:
    return np.asarray((np.arange(n) - (n - 1) / 2) * pitch, dtype=np.float64)


def _messages(
    fit: _Lattice, sigma: float, u_reading: float | None, pitch: float
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
    if math.isnan(sigma):
        out.append("no redundancy and no u_reading: the uncertainty is not known (NaN)")
    elif u_reading is not None and sigma > 1.5 * u_reading:
        out.append(
            f"the residuals scatter by {sigma * 1e9:.3g} nm, more than the stated "
            f"{u_reading * 1e9:.3g} nm: the plate bends with its placement, a turn or a shift is "
            "not what it was said to be, or the stage drifts"
        )
    return tuple(out)


def _views(
    views: Mapping[str, ArrayLike] | Sequence[GridView],
) -> list[tuple[GridView, FloatArray]]:
    if isinstance(views, Mapping):
        unknown = [name for name in views if name not in _NAMED]
        if unknown:
            raise DataError(
                f"views are named {', '.join(_NAMED)}, got {unknown}; use GridView for others"
            )
        views = [GridView(r, _NAMED[n][0], _NAMED[n][1]) for n, r in views.items()]
    out = []
    for i, view in enumerate(views, start=1):
        if not isinstance(view, GridView):
            raise DataError(f"view {i} is a {type(view).__name__}; give GridView objects")
        try:
            values = np.array(view.readings, dtype=np.float64)
        except (TypeError, ValueError) as exc:
            raise DataError(f"view {i}: readings must be numbers in m: {exc}") from None
        values = values[np.newaxis] if values.ndim == 3 else values
        if values.ndim != 4 or values.shape[-1] != 2 or np.isinf(values).any():
            raise DataError(
                f"view {i}: readings must have the shape (n_y, n_x, 2), x and y component, finite "
                f"or NaN; got {values.shape}"
            )
        if any(int(k) != k for k in (view.turns, *view.shift)):
            raise DataError(
                f"view {i}: turns and shifts are whole numbers of 90 degrees and pitches"
            )
        out.append((view, values))
    return out


def _checked(views: list[tuple[GridView, FloatArray]], pitch: float) -> tuple[int, int]:
    if not (math.isfinite(pitch) and pitch > 0.0):
        raise DataError(f"pitch is {pitch} m; it must be positive and finite")
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


def _needs(views: list[tuple[GridView, FloatArray]]) -> None:
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


class _Lattice:
    """Joint least squares; unknowns: stage (site, component), plate (mark, component), placements."""

    def __init__(self, views: list[tuple[GridView, FloatArray]], size: tuple[int, int]) -> None:
        self.size = size
        n = size[0] * size[1]
        blocks = [_rows(i, v, r, size, len(views)) for i, (v, r) in enumerate(views)]
        design = np.concatenate([b[0] for b in blocks])
        mean = np.concatenate([b[1] for b in blocks])
        weight = np.concatenate([b[2] for b in blocks])
        pure = np.concatenate([b[3] for b in blocks])
        keep = np.ones(4 * n, dtype=bool)
        while True:
            seen = np.abs(design[:, : 4 * n]).sum(axis=0) > 0
            keep &= seen
            use = np.abs(design[:, : 4 * n][:, ~keep]).sum(axis=1) == 0
            columns = np.concatenate([keep, np.ones(3 * len(views), dtype=bool)])
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
            design, mean, weight, pure = design[use], mean[use], weight[use], pure[use]
        self._finish(a, mean[use], weight[use], inverse, functions, keep, float(pure[use].sum()))
        self.n_readings = int(weight[use].sum())
        self.rank = int(values.size)
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

    def uncertainty(self, part: int, sigma: float) -> FloatArray:
        """Return the standard uncertainty of the stage (0) or the plate (1)."""
        return np.asarray(sigma * self.u[part], dtype=np.float64)

    def unseen(self) -> tuple[Unobservable, ...]:
        """Return sites and marks that are not determined."""
        names = ("stage", "plate")
        return tuple(
            Unobservable(part, "samples", (lost,), "not read in enough views: NaN")
            for part, lost in zip(names, self.lost, strict=True)
            if lost
        )


def _rows(
    index: int, view: GridView, readings: FloatArray, size: tuple[int, int], n_views: int
) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:
    """Design rows, mean readings, counts and sums of squares of the repeats of one view."""
    n_y, n_x = size
    n = n_y * n_x
    count = (~np.isnan(readings)).sum(axis=0)
    cos, sin = ((1, 0), (0, 1), (-1, 0), (0, -1))[view.turns % 4]
    turn = np.array([[cos, -sin], [sin, cos]])
    rows, values, weights, pure = [], [], [], []
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
                    f"view {index + 1} has a reading at row {j}, column {i}, where its turn "
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
            got = got[~np.isnan(got)]
            rows.append(line)
            values.append(got.mean())
            weights.append(float(got.size))
            pure.append(float(np.sum((got - got.mean()) ** 2)))
    if not rows:
        raise DataError(f"view {index + 1} holds no readings")
    return np.array(rows), np.array(values), np.array(weights), np.array(pure)


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
