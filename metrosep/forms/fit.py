"""Fit an ideal surface to a measurement: rigid-body freedoms and shape parameters together.

The deviation is measured minus ideal (error = actual - nominal). What is linear is solved at once;
the rest by Levenberg-Marquardt with analytic derivatives, for a large map first on 20 000 of its
points. Sources: any text on nonlinear least squares; Forbes 1991 (NPL DITC 140/89) on
least-squares best-fit geometric elements.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from metrosep.core._arrays import CheckedArray
from metrosep.core.blas import one_blas_thread
from metrosep.core.errors import DataError
from metrosep.core.profile import Profile
from metrosep.core.provenance import Step
from metrosep.core.surface import Surface
from metrosep.core.units import format_length
from metrosep.forms.base import Form
from metrosep.forms.fit_linear import Answer, solve_level, solve_linear, sum_of_squares
from metrosep.forms.freedoms import RIGID, Freedoms, choose_freedoms
from metrosep.forms.placement import Direction, Placement, Tilt
from metrosep.forms.points import Points, PointSet, points_of
from metrosep.forms.polynomial import Polynomial
from metrosep.forms.result import FitResult
from metrosep.forms.robust import Robust, robust_weights, spread
from metrosep.forms.solve import Block, Solution, scaled_gram, solve
from metrosep.forms.starts import best_shift, vertex
from metrosep.forms.warn import fit_warnings

__all__ = ["fit", "remove"]

FloatArray = NDArray[np.float64]

_SAMPLE = 20_000
"""Points that find the place before all points polish it."""
_WORTH_SAMPLING = 10
"""A map needs this many times the sample for the detour to pay."""
_ROBUST_ROUNDS = 50
_ROBUST_CHANGE = 1e-6
"""Of the spread: weights have settled when the heights move less."""


def fit(
    obj: Surface | Profile | PointSet,
    form: Form,
    *,
    free: Sequence[str] | None = None,
    fixed: Mapping[str, float] | None = None,
    robust: Robust | None = None,
    tilt: Tilt = "plane",
    direction: Direction = "vertical",
    centre: tuple[float, float] | None = None,
    start: Mapping[str, float] | None = None,
    max_iterations: int = 100,
) -> FitResult:
    """Return the form that leaves the smallest sum of squared deviations.

    Parameters
    ----------
    obj : Surface, Profile or PointSet
        Measurement; NaN is left out. A profile is the line y = 0 and need not be uniform.
    form : Form
        Ideal surface. Parameters that are None are found, and those named in `free`.
    free : sequence of str, optional
        Rigid-body freedoms ("piston", "tilt_x", "tilt_y", "shift_x", "shift_y", "rotation_z") and
        names of parameters. Piston and tilt if omitted; for a polynomial without coefficients
        only these.
    fixed : mapping of str to float, optional
        Freedoms and parameters held at a value, SI.
    robust : {"tukey", "huber"}, optional
        Weigh outliers down; least squares if omitted.
    tilt : {"plane", "rotation"}, optional
        Add a plane, or turn the form as a rigid body.
    direction : {"vertical", "normal"}, optional
        Of the deviation; "normal" is the distance to the form, to first order.
    centre : tuple of (float, float), optional, m
        Origin of the form in the coordinates of `obj`. If omitted: the coordinates as they are,
        but the middle of a map whose origin was not declared, for a form with a vertex.
    start : mapping of str to float, optional
        Where to begin, instead of the guess from the data.
    max_iterations : int, optional
        Of the nonlinear iteration.

    Returns
    -------
    FitResult
        ``.params``, ``.u``, ``.cov``, ``.residual``, ``.rms``, ``.report()``.

    Raises
    ------
    DataError
        If a name, an option or the object is not one that can be used.
    TooFewSamplesError
        If nothing was measured.
    DegenerateFitError
        If there are fewer points than freedoms, or the points cannot tell freedoms apart.
    NotConvergedError
        If the iteration does not settle.

    Notes
    -----
    O(n) in time, blocks of 32 000 points in memory. The covariance assumes independent deviations;
    with a robust rule it is that of the weighted points.

    Examples
    --------
    >>> import numpy as np
    >>> from metrosep import Profile
    >>> from metrosep.forms import Sphere, fit
    >>> x = np.linspace(-5e-3, 5e-3, 201)
    >>> found = fit(Profile(x, 1e-6 + 2e-4 * x + Sphere(R=50e-3)(x)), Sphere())
    >>> round(found.params["R"], 9), round(found.params["tilt_x"], 9)
    (0.05, 0.0002)
    """
    if not isinstance(form, Form):
        raise DataError(
            f"form must be a metrosep form such as Sphere(), got {type(form).__name__}"
        )
    _check_choice("tilt", tilt, ("plane", "rotation"))
    _check_choice("direction", direction, ("vertical", "normal"))
    if robust is not None:
        _check_choice("robust", robust, ("tukey", "huber"))
    if isinstance(obj, Profile) and isinstance(form, Polynomial):
        form = form.for_profile()
    points = points_of(obj, centre=centre, middle=form.has_centre)
    form, freedoms = choose_freedoms(
        form, free, dict(fixed or {}), is_profile=isinstance(obj, Profile)
    )
    started = dict(start or {})
    with one_blas_thread():
        answer = solve_linear(points, form, freedoms, robust) if not started else None
        if answer is None:
            begin = _begin(points, form, freedoms, started, tilt=tilt, direction=direction)
            answer = solve_level(points, begin, freedoms, robust)
        else:
            begin = Placement(form, {}, tilt, direction)
    if answer is not None:
        placed = replace(begin, form=answer.form, rigid=answer.rigid)
        return _result(obj, points, freedoms, placed, answer, robust)
    job = _Job(points, begin, freedoms)
    with one_blas_thread():
        solution = _solve(job, max_iterations)
        weights = None
        if robust is not None:
            solution, weights = _reweighted(job, solution, robust, max_iterations)
    placed = job.placed(solution.values)
    residual = _residual(points, placed)
    n, squares = sum_of_squares(residual)
    cov = _covariance(solution, freedoms.names, squares, n, weights)
    answer = Answer(placed.form, dict(placed.rigid), cov, residual, n, squares)
    return _result(
        obj, points, freedoms, placed, answer, robust, n_iterations=solution.n_iterations
    )


def remove(
    obj: Surface | Profile | PointSet, form: Form, **options: object
) -> Surface | Profile | PointSet:
    """Return what is left of a measurement after the best-fit form.

    Parameters
    ----------
    obj : Surface, Profile or PointSet
        Measurement.
    form : Form
        Ideal surface.
    **options : object
        Of `fit`.

    Returns
    -------
    Surface, Profile or PointSet
        Measured minus ideal, with the fit in its history.
    """
    return fit(obj, form, **options).residual  # type: ignore[arg-type]


def _check_choice(name: str, value: str, choices: tuple[str, ...]) -> None:
    if value not in choices:
        raise DataError(f"{name} must be one of {', '.join(choices)}, got {value!r}")


@dataclass(slots=True, eq=False)
class _Job:
    """A measurement, a place to begin, and what may move."""

    points: Points
    begin: Placement
    freedoms: Freedoms

    def vector(self) -> FloatArray:
        shape = self.begin.form.parameters
        rigid = [self.begin.get(n) for n in self.freedoms.rigid]
        return np.array([*rigid, *(shape[n] for n in self.freedoms.shape)], dtype=np.float64)

    def reach(self) -> FloatArray:
        """Largest sensible change of each freedom: the extent, a radian; a parameter has none."""
        extent = {"m": max(self.points.radius, np.finfo(float).tiny), "rad": 1.0}
        sizes = [np.inf if n == "piston" else extent[RIGID[n]] for n in self.freedoms.rigid]
        return np.array([*sizes, *(np.inf for _ in self.freedoms.shape)], dtype=np.float64)

    def linear(self) -> list[int]:
        """Where the freedoms stand in which the heights are linear (with a plane for the tilt)."""
        names = self.freedoms.names
        of_form = self.freedoms.shape if getattr(self.begin.form, "is_linear", False) else ()
        return [
            i for i, n in enumerate(names) if n in ("piston", "tilt_x", "tilt_y") or n in of_form
        ]

    def solve(
        self,
        values: FloatArray,
        max_iterations: int,
        *,
        sample: tuple[FloatArray, FloatArray, FloatArray] | None = None,
        weights: list[FloatArray] | None = None,
    ) -> Solution:
        def on_sample(p: FloatArray) -> Iterator[Block]:
            assert sample is not None  # noqa: S101
            yield self.placed(p).linearised(*sample, self.freedoms.rigid, self.freedoms.shape)

        return solve(
            on_sample if sample is not None else (lambda p: self.linearise(p, weights)),
            values,
            self.freedoms.names,
            height=self.points.largest,
            reach=self.reach(),
            linear=self.linear(),
            is_exact=self.begin.tilt == "plane" and self.begin.direction == "vertical",
            max_iterations=max_iterations,
        )

    def placed(self, values: FloatArray) -> Placement:
        n = len(self.freedoms.rigid)
        rigid = {**self.begin.rigid, **dict(zip(self.freedoms.rigid, values[:n], strict=True))}
        shape = dict(zip(self.freedoms.shape, (float(v) for v in values[n:]), strict=True))
        form = self.begin.form.with_parameters(**shape) if shape else self.begin.form
        return replace(self.begin, form=form, rigid={k: float(v) for k, v in rigid.items()})

    def linearise(
        self, values: FloatArray, weights: list[FloatArray] | None = None
    ) -> Iterator[Block]:
        placed = self.placed(values)
        for i, (x, y, z) in enumerate(self.points.valid_blocks()):
            if z.size == 0:
                continue
            r, J = placed.linearised(x, y, z, self.freedoms.rigid, self.freedoms.shape)
            if weights is None:
                yield r, J
            else:
                root = np.sqrt(weights[i])
                yield r * root, J * root

    def deviations(self, values: FloatArray) -> list[FloatArray]:
        placed = self.placed(values)
        return [
            placed.deviation(x, y, z) if z.size else np.empty(0)
            for x, y, z in self.points.valid_blocks()
        ]


def _begin(
    points: Points,
    form: Form,
    freedoms: Freedoms,
    start: dict[str, float],
    *,
    tilt: Tilt,
    direction: Direction,
) -> Placement:
    """Return the form with values for all parameters, at a place to start from."""
    stray = [k for k in start if k not in freedoms.names]
    if stray:
        raise DataError(
            f"start names {', '.join(stray)}, which is not free; free are: "
            f"{', '.join(freedoms.names) or 'none'}"
        )
    x, y, z = points.sample(_SAMPLE)
    rigid = dict(freedoms.held)
    given = {k: float(v) for k, v in start.items() if k not in RIGID}
    if given:
        form = form.with_parameters(**given)
    shifts = [n for n in ("shift_x", "shift_y") if n in freedoms.rigid]
    tilts = {"tilt_x", "tilt_y"} & set(freedoms.rigid)
    if shifts and form.has_centre and not tilts:
        rigid.update(
            {
                n: v
                for n, v in zip(("shift_x", "shift_y"), vertex(x, y, z), strict=True)
                if n in shifts
            }
        )
    if any(v is None for v in form.parameters.values()):
        form = form.start(x - rigid.get("shift_x", 0.0), y - rigid.get("shift_y", 0.0), z)
    if shifts and not form.has_centre and not set(shifts) & set(start) and _is_uniform(points):
        found = best_shift(form, points, free=("shift_x" in shifts, "shift_y" in shifts))
        rigid.update(
            {n: v for n, v in zip(("shift_x", "shift_y"), found, strict=True) if n in shifts}
        )
    if "piston" in freedoms.rigid and z.size:
        placed = Placement(form, rigid, tilt).deviation(x, y, z)
        inside = placed[~np.isnan(placed)]
        rigid["piston"] = float(np.median(inside)) if inside.size else float(np.median(z))
    rigid.update({k: float(v) for k, v in start.items() if k in RIGID})
    return Placement(form, rigid, tilt, direction)


def _is_uniform(points: Points) -> bool:
    steps = np.diff(points.x)
    return bool(
        not points.is_scattered and steps.size and np.ptp(steps) <= 1e-6 * abs(float(steps.mean()))
    )


def _solve(job: _Job, max_iterations: int) -> Solution:
    """Solve on a sample first where the map is large, then on all points."""
    values = job.vector()
    if values.size and job.points.n_valid > _WORTH_SAMPLING * _SAMPLE:
        values = job.solve(values, max_iterations, sample=job.points.sample(_SAMPLE)).values
    return job.solve(values, max_iterations)


def _reweighted(
    job: _Job, solution: Solution, rule: Robust, max_iterations: int
) -> tuple[Solution, list[FloatArray]]:
    """Iterate weights and fit; a few rounds of Huber first, whose answer does not depend on the start."""
    names = job.freedoms.names
    height = job.points.largest
    weights: list[FloatArray] = []
    for count in range(_ROBUST_ROUNDS):
        deviations = job.deviations(solution.values)
        scale = spread(np.concatenate(deviations))
        if scale <= 1e-15 * height:
            scale = 0.0
        now: Robust = "huber" if count < 5 else rule
        weights = [
            np.nan_to_num(robust_weights(d, scale, now) if scale else np.ones_like(d))
            for d in deviations
        ]
        if not names or scale == 0.0:
            break
        last = solution.values
        solution = job.solve(last, max_iterations, weights=weights)
        change = solution.values - last
        moved = float(change @ solution.normal.gram @ change) / solution.normal.n
        if count > 5 and moved <= (_ROBUST_CHANGE * scale) ** 2:
            break
    return solution, weights


def _result(
    obj: Surface | Profile | PointSet,
    points: Points,
    freedoms: Freedoms,
    placed: Placement,
    answer: Answer,
    robust: str | None,
    *,
    n_iterations: int = 0,
) -> FitResult:
    names, n, residual = freedoms.names, answer.n, answer.residual
    rms = float(np.sqrt(answer.squares / n))
    shape = {k: float(v) for k, v in placed.form.parameters.items() if v is not None}
    rigid = {k: placed.get(k) for k in RIGID if k in freedoms.rigid or k in freedoms.held}
    params = {**rigid, **shape}
    step = Step(
        f"fit {placed.form.name}",
        {
            "removed": ", ".join(names) or "nothing free",
            "tilt": placed.tilt,
            "direction": placed.direction,
            **({"robust": robust} if robust else {}),
            **{f"{k}": v for k, v in shape.items()},
        },
    )
    history = (*obj.history, step)
    left: Surface | Profile | PointSet
    if isinstance(obj, Profile):
        left = Profile(obj.x, residual[0], metadata=obj.metadata, history=history)
    elif isinstance(obj, PointSet):
        left = PointSet(obj.x, obj.y, residual[0], metadata=obj.metadata, history=history)
    else:
        left = Surface(
            residual.view(CheckedArray),
            obj.dx,
            obj.dy,
            origin=obj.origin,
            metadata=obj.metadata,
            history=history,
        )
    outside = points.n_valid - n
    notes = list(freedoms.notes)
    if robust is not None:
        good = spread(residual.ravel())
        notes.append(
            f"{robust} weights: the good points spread by {format_length(good)}, the RMS is that "
            "of all points"
        )
    if outside:
        notes.append(
            f"{outside} of {points.n_valid} valid points lie outside the domain of the "
            f"{placed.form.name} and are left out"
        )
    return FitResult(
        form=placed.form,
        params=params,
        names=names,
        cov=answer.cov,
        residual=left,
        rms=rms,
        n_points=n,
        centre=points.centre,
        placement=placed,
        units={**RIGID, **placed.form.units_of()},
        warnings=fit_warnings(points, placed, names, answer.cov, rms),
        notes=tuple(notes),
        n_iterations=n_iterations,
        robust=robust,
        source=obj,
    )


def _residual(points: Points, placed: Placement) -> FloatArray:
    residual = np.empty(points.z.shape)
    for rows, columns, x, y, z in points.blocks():
        residual[rows, columns] = placed.deviation(x, y, z)
    return residual


def _covariance(
    solution: Solution,
    names: Sequence[str],
    squares: float,
    n: int,
    weights: list[FloatArray] | None,
) -> FloatArray:
    """Return s^2 (J'J)^-1; NaN where there are no degrees of freedom."""
    normal = solution.normal
    p = len(names)
    if p == 0:
        return np.zeros((0, 0))
    gram, length = scaled_gram(normal, names)
    if weights is None:
        dof, squared = float(n - p), squares
    else:
        dof, squared = float(sum(w.sum() for w in weights)) - p, normal.squares
    if dof <= 0:
        return np.full((p, p), np.nan)
    return np.asarray(np.linalg.inv(gram) / np.outer(length, length) * (squared / dof))
