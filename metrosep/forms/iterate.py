"""The iterative part of `fit`: where it begins, a sample first, robust weights, covariance."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from metrosep.core._arrays import FloatArray
from metrosep.core.errors import DataError, DegenerateFitError, NotConvergedError
from metrosep.forms._correlated import estimated
from metrosep.forms._curvature import curvature_of, radius_of
from metrosep.forms.base import Form
from metrosep.forms.fit_linear import Answer, solve_level, solve_linear, sum_of_squares
from metrosep.forms.freedoms import RIGID, Freedoms, known_values
from metrosep.forms.linear import LinearForm
from metrosep.forms.placement import Direction, Placement, Tilt
from metrosep.forms.points import SAMPLE, Points
from metrosep.forms.robust import (
    Robust,
    Weigh,
    robust_fit,
    robust_variance,
    spread,
    trimmed_start,
)
from metrosep.forms.solve import Normal, Solution, accumulate, one_step, scaled_gram, solve
from metrosep.forms.starts import best_shift, vertex

__all__ = ["find"]

_START = 4000
"""Points that a first guess is made of."""
_KEPT_PROMISE = 1e-2
"""Of the variance of a point."""
_WORTH_SAMPLING = 10
"""A map needs this many times the sample for the detour to pay."""

Sample = tuple[FloatArray, FloatArray, FloatArray]


@dataclass(slots=True, eq=False)
class _Job:
    """A measurement, a place to begin, and what may move."""

    points: Points
    begin: Placement
    freedoms: Freedoms
    sample: Sample

    def vector(self) -> FloatArray:
        """Where to begin; a radius stands as its curvature, here and in all that is solved for."""
        shape, radii = self.begin.form.parameters, self.begin.form.radii
        rigid = [self.begin.get(n) for n in self.freedoms.rigid]
        found = [float(shape[n] or 0.0) for n in self.freedoms.shape]
        bent = [
            curvature_of(v) if n in radii else v
            for n, v in zip(self.freedoms.shape, found, strict=True)
        ]
        return np.array([*rigid, *bent], dtype=np.float64)

    def reach(self) -> FloatArray:
        """Largest sensible change of each freedom: the extent, a radian; a parameter has none."""
        extent = {"m": max(self.points.radius, np.finfo(float).tiny), "rad": 1.0}
        sizes = [np.inf if n == "piston" else extent[RIGID[n]] for n in self.freedoms.rigid]
        return np.array([*sizes, *(np.inf for _ in self.freedoms.shape)], dtype=np.float64)

    def linear(self) -> list[int]:
        """Where the freedoms stand in which the heights are linear (with a plane for the tilt)."""
        names = self.freedoms.names
        of_form = self.freedoms.shape if self.begin.form.is_linear else ()
        return [
            i for i, n in enumerate(names) if n in ("piston", "tilt_x", "tilt_y") or n in of_form
        ]

    def solve(
        self,
        values: FloatArray,
        max_iterations: int,
        *,
        sample: Sample | None = None,
        weights: list[FloatArray] | None = None,
    ) -> Solution:
        return solve(
            lambda p: self.linearise(p, weights, sample=sample),
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
        radii = self.begin.form.radii
        shape = {
            name: radius_of(float(v)) if name in radii else float(v)
            for name, v in zip(self.freedoms.shape, values[n:], strict=True)
        }
        form = self.begin.form.with_parameters(**shape) if shape else self.begin.form
        return replace(self.begin, form=form, rigid={k: float(v) for k, v in rigid.items()})

    def blocks(self, sample: Sample | None) -> Iterator[Sample]:
        return self.points.valid_blocks() if sample is None else iter((sample,))

    def linearise(
        self,
        values: FloatArray,
        weights: list[FloatArray] | None = None,
        *,
        sample: Sample | None = None,
    ) -> Iterator[FloatArray]:
        placed = self.placed(values)
        for i, (x, y, z) in enumerate(self.blocks(sample)):
            if z.size == 0:
                continue
            block = placed.linearised(x, y, z, self.freedoms.rigid, self.freedoms.shape)
            yield block if weights is None else block * np.sqrt(weights[i])

    def deviations(self, values: FloatArray, *, sample: Sample | None = None) -> list[FloatArray]:
        placed = self.placed(values)
        return [
            placed.deviation(x, y, z) if z.size else np.empty(0) for x, y, z in self.blocks(sample)
        ]


_ROUNDING = 16.0 * float(np.finfo(float).eps)
"""Of the largest height, as in `solve`."""
_RIM = (
    "the heights ask for a stronger curvature than a form through all points can have: the fit "
    "stopped where the form ends at the rim of the data; check the units of height and position"
)
_CERTAIN = 0.3
"""Of the allowed uncertainty: a weak parameter that even wholly correlated deviations leave better
known is not looked at again."""


def find(
    points: Points,
    form: Form,
    freedoms: Freedoms,
    start: Mapping[str, float],
    robust: Robust | None,
    *,
    tilt: Tilt,
    direction: Direction,
    max_iterations: int,
) -> tuple[Answer, Placement, int, Freedoms]:
    """Return what was found, where the form sits, the steps that it took, and what was free."""
    if not start and direction == "vertical":
        answer = solve_linear(points, form, freedoms, robust)
        if answer is not None:
            return answer, Placement(answer.form, {}, tilt), 0, freedoms
    sample = points.sample()
    begin = _begin(points, form, freedoms, start, sample, tilt=tilt, direction=direction)
    answer = solve_level(points, begin, freedoms, robust)
    if answer is not None:
        return answer, replace(begin, rigid=answer.rigid), 0, freedoms
    job = _Job(points, begin, freedoms, sample)
    if set(form.weak) & set(freedoms.shape):
        job = _without_the_undetermined(job, form, start, max_iterations)
    try:
        answer, placed, n_iterations = _iterate(job, robust, max_iterations)
    except (NotConvergedError, DegenerateFitError):
        weak = [n for n in job.freedoms.shape if n in form.weak]
        if not weak or points.n_valid < len(job.freedoms.names):
            raise
        at = _where_held(weak, form, start, begin.form)
        job = _held(job, form, start, at, dict.fromkeys(weak, np.inf))
        answer, placed, n_iterations = _iterate(job, robust, max_iterations)
    return answer, placed, n_iterations, job.freedoms


def _where_held(
    names: Sequence[str], given: Form, start: Mapping[str, float], begun: Form
) -> dict[str, float]:
    """Return where weak parameters are held: the start's, the drawing's, k = 0, the guessed angle."""
    asked = {**given.parameters, **known_values(start, given, "start")}
    guessed = {n: 0.0 if n.startswith("k") else begun.parameters[n] for n in names}
    return {n: float((guessed if asked[n] is None else asked)[n] or 0.0) for n in names}


def _held(
    job: _Job,
    form: Form,
    start: Mapping[str, float],
    at: Mapping[str, float],
    u: Mapping[str, float],
) -> _Job:
    """Return the job begun anew with some parameters held at a value, and a warning for each."""
    units = job.begin.form.units_of()

    def short(value: float, name: str) -> str:
        number = f"{value:.2g}" if np.isfinite(value) else "unlimited"
        return number if units[name] == "1" else f"{number} {units[name]}"

    warnings = tuple(
        f"{n} is not determined by this map (u = {short(u[n], n)}): held at {short(v, n)}"
        for n, v in at.items()
    )
    freedoms = replace(
        job.freedoms,
        shape=tuple(n for n in job.freedoms.shape if n not in at),
        warnings=(*job.freedoms.warnings, *warnings),
    )
    rest = {k: v for k, v in known_values(start, form, "start").items() if k not in at}
    begin = _begin(
        job.points,
        form.with_parameters(**at),
        freedoms,
        rest,
        job.sample,
        tilt=job.begin.tilt,
        direction=job.begin.direction,
    )
    return _Job(job.points, begin, freedoms, job.sample)


def _without_the_undetermined(
    job: _Job, given: Form, start: Mapping[str, float], max_iterations: int
) -> _Job:
    """Return the job with those weak parameters held that the points do not know to 1.

    All weak ones are held first, k at the drawing's value, the start's or 0. At that answer the
    linearised fit says how well each would be known, the worst is held, and so on.
    """
    weak = [n for n in given.weak if n in job.freedoms.shape]
    at = _where_held(weak, given, start, job.begin.form)
    held = _held(job, given, start, at, dict.fromkeys(weak, np.inf))
    try:
        solution = held.solve(held.vector(), max_iterations, sample=job.sample)
        values = solution.values
        if not solution.is_at_rim and _is_determined(job, held.placed(values), weak):
            return job
        if job.points.n_valid > job.sample[2].size:
            values = _solve(held, max_iterations)[0].values
    except (NotConvergedError, DegenerateFitError):
        return job  # a part so curved that the held form does not reach its rim
    if solution.is_at_rim:  # where slopes are infinite, nothing linearised is true
        return held
    placed, open_, doubtful = held.placed(values), job.freedoms, dict[str, float]()
    while weak:
        u = _linearised_u(job.points, placed, open_)
        if len(weak) > 1 and np.isinf([u[n] for n in weak]).all():  # one may hide the other
            for n in weak:
                rest = tuple(k for k in open_.shape if k == n or k not in weak)
                u[n] = _linearised_u(job.points, placed, replace(open_, shape=rest))[n]
        worst = max(weak, key=lambda n: u[n])
        if not u[worst] > 1.0:
            break
        doubtful[worst] = u[worst]
        weak.remove(worst)
        open_ = replace(open_, shape=tuple(n for n in open_.shape if n != worst))
    if not doubtful:
        return job
    begun = _held(job, given, start, {n: at[n] for n in doubtful}, doubtful)
    return begun if weak else replace(begun, begin=placed)  # that is solved already


def _is_determined(job: _Job, placed: Placement, weak: Sequence[str]) -> bool:
    """Whether no correlation of the deviations could leave a weak parameter unknown."""
    at = replace(job, begin=placed)
    normal = accumulate(at.linearise(at.vector(), sample=job.sample), len(job.freedoms.names))
    try:
        cov = _covariance(normal, job.freedoms.names, 1.0)
    except (DegenerateFitError, np.linalg.LinAlgError):
        return False
    left = normal.squares - float(normal.gradient @ cov @ normal.gradient)
    left = max(left, normal.n * (_ROUNDING * job.points.largest) ** 2)
    largest = np.sqrt(np.maximum(np.diag(cov), 0.0) * max(left, 0.0))  # u if all were one pixel
    names = job.freedoms.names
    known = [largest[names.index(n)] <= _CERTAIN for n in weak]
    return bool(np.isfinite(cov).all() and (np.diag(cov) > 0.0).all() and all(known))


def _linearised_u(points: Points, placed: Placement, freedoms: Freedoms) -> dict[str, float]:
    """Return the standard uncertainty of each parameter at a place, infinite where nothing moves."""
    p = len(freedoms.names)
    found = estimated(
        points,
        lambda x, y, z: placed.linearised(x, y, z, freedoms.rigid, freedoms.shape),
        points.over_blocks(placed.deviation),
        p,
    )
    u = np.sqrt(np.diag(found.cov))
    return dict(zip(freedoms.names, np.where(np.isnan(u), np.inf, u).tolist(), strict=True))


def _iterate(
    job: _Job, robust: Robust | None, max_iterations: int
) -> tuple[Answer, Placement, int]:
    names = job.freedoms.names
    solution, residual = _solve(job, max_iterations)
    if solution.is_at_rim:
        job.freedoms = replace(job.freedoms, warnings=(*job.freedoms.warnings, _RIM))
    normal, scale = solution.normal, 0.0
    if robust is not None:
        solution, scale = _robust(job, solution, robust, max_iterations)
        normal, residual = accumulate(job.linearise(solution.values), len(names)), None
    placed = job.placed(solution.values)
    if residual is None:
        residual = job.points.over_blocks(placed.deviation)
    n, squares = sum_of_squares(residual)
    variance = squares / max(n - len(names), 1)
    if robust is not None:
        variance = robust_variance(residual.ravel(), scale, robust, len(names))
    cov = _covariance(normal, names, variance)
    answer = Answer(placed.form, dict(placed.rigid), cov, residual, n, squares)
    return answer, placed, solution.n_iterations


def _begin(
    points: Points,
    form: Form,
    freedoms: Freedoms,
    start: Mapping[str, float],
    sample: Sample,
    *,
    tilt: Tilt,
    direction: Direction,
) -> Placement:
    """Return the form with values for all parameters, at a place to start from."""
    start = known_values(start, form, "start")
    stray = [k for k in start if k not in freedoms.names]
    if stray:
        raise DataError(
            f"start names {', '.join(stray)}, which is not free; free are: "
            f"{', '.join(freedoms.names) or 'none'}"
        )
    thin = max(1, sample[2].size // _START)
    x, y, z = (v[::thin] for v in sample)
    is_line = points.y.size == 1 and not points.is_scattered
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
    if any(v is None for v in form.parameters.values()) or isinstance(form, LinearForm):
        form = form.start(x - rigid.get("shift_x", 0.0), y - rigid.get("shift_y", 0.0), z)
    if shifts and not form.has_centre and not set(shifts) & set(start) and points.is_uniform:
        found = best_shift(form, points, free=("shift_x" in shifts, "shift_y" in shifts))
        rigid.update(
            {n: v for n, v in zip(("shift_x", "shift_y"), found, strict=True) if n in shifts}
        )
    if "piston" in freedoms.rigid and z.size:
        placed = Placement(form, rigid, tilt).deviation(x, y, z)
        inside = placed[~np.isnan(placed)]
        rigid["piston"] = float(np.median(inside)) if inside.size else float(np.median(z))
    rigid.update({k: float(v) for k, v in start.items() if k in RIGID})
    return Placement(form, rigid, tilt, direction, is_line=is_line)


def _solve(job: _Job, max_iterations: int) -> tuple[Solution, FloatArray | None]:
    """Solve on a sample first where the map is large, then on all points.

    From the answer of the sample one step is enough where it leaves the squares that it promised,
    to a share of the variance that moves no parameter by a hundredth of its uncertainty. The
    residual that proves it comes along.
    """
    values = job.vector()
    if not values.size or job.points.n_valid <= _WORTH_SAMPLING * SAMPLE:
        return job.solve(values, max_iterations), None
    values = job.solve(values, max_iterations, sample=job.sample).values
    solution, promised = one_step(
        job.linearise, values, job.freedoms.names, height=job.points.largest, reach=job.reach()
    )
    residual = job.points.over_blocks(job.placed(solution.values).deviation)
    n, squares = sum_of_squares(residual)
    if n == solution.normal.n and abs(squares - promised) <= _KEPT_PROMISE * squares / n:
        return solution, residual
    return job.solve(solution.values, max_iterations), None


def _robust(
    job: _Job, solution: Solution, rule: Robust, max_iterations: int
) -> tuple[Solution, float]:
    """Return the MM-estimate and its spread: trimmed start, spread held, weights repeated; twice.

    A large map is settled on its sample first.
    """
    names = job.freedoms.names
    if not names:
        return solution, 0.0
    block = next(iter(job.linearise(solution.values, sample=job.sample)))
    block = block[:, ~np.isnan(block).any(axis=0)]
    values = solution.values + trimmed_start(block[:-1], block[-1])
    if not np.isfinite(accumulate(job.linearise(values, sample=job.sample), len(names)).squares):
        values = solution.values
    is_large = job.points.n_valid > _WORTH_SAMPLING * SAMPLE
    solution, scale = replace(solution, values=values), 0.0
    for sample in (job.sample, None) if is_large else (None,):
        solution, scale = _reweighted(job, solution, rule, max_iterations, sample)
    return solution, scale


def _reweighted(
    job: _Job, start: Solution, rule: Robust, max_iterations: int, sample: Sample | None
) -> tuple[Solution, float]:
    """Return the solution whose weights have settled, and the spread of the good points."""

    def spread_of(last: Solution) -> float:
        return spread(np.concatenate(job.deviations(last.values, sample=sample)))

    def refit(last: Solution, weigh: Weigh) -> tuple[Solution, float]:
        weights = [weigh(d) for d in job.deviations(last.values, sample=sample)]
        solution = job.solve(last.values, max_iterations, sample=sample, weights=weights)
        change = solution.values - last.values
        moved = float(change @ solution.normal.gram @ change) / solution.normal.n
        return solution, float(np.sqrt(max(moved, 0.0)))

    return robust_fit(
        start,
        spread_of,
        refit,
        rule,
        largest=job.points.largest,
        name=job.begin.form.name,
    )


def _covariance(normal: Normal, names: Sequence[str], variance: float) -> FloatArray:
    """Return variance (J'J)^-1; NaN where there are no degrees of freedom."""
    p = len(names)
    if p == 0:
        return np.zeros((0, 0))
    if normal.n <= p:
        return np.full((p, p), np.nan)
    gram, length = scaled_gram(normal, names)
    return np.asarray(np.linalg.inv(gram) / np.outer(length, length) * variance)
