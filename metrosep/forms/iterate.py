"""The iterative part of `fit`: where it begins, a sample first, robust weights, covariance."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from metrosep.core._arrays import FloatArray
from metrosep.core.errors import DataError, DegenerateFitError, NotConvergedError
from metrosep.forms._correlated import estimated
from metrosep.forms.base import RIGID, Direction, Form, Freedoms, Placement, Tilt, known_values
from metrosep.forms.conic import curvature_of, radius_of
from metrosep.forms.linear import (
    Answer,
    LinearForm,
    Robust,
    Weigh,
    robust_fit,
    robust_variance,
    solve_linear,
    spread,
    sum_of_squares,
    trimmed_start,
)
from metrosep.forms.points import SAMPLE, Points
from metrosep.forms.polynomial import solve_level

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
    placed, open_, undetermined = held.placed(values), job.freedoms, dict[str, float]()
    while weak:
        u = _linearised_u(job.points, placed, open_)
        if len(weak) > 1 and np.isinf([u[n] for n in weak]).all():  # one may hide the other
            for n in weak:
                rest = tuple(k for k in open_.shape if k == n or k not in weak)
                u[n] = _linearised_u(job.points, placed, replace(open_, shape=rest))[n]
        worst = max(weak, key=lambda n: u[n])
        if not u[worst] > 1.0:
            break
        undetermined[worst] = u[worst]
        weak.remove(worst)
        open_ = replace(open_, shape=tuple(n for n in open_.shape if n != worst))
    if not undetermined:
        return job
    begun = _held(job, given, start, {n: at[n] for n in undetermined}, undetermined)
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


# ---- levenberg-Marquardt in blocks, with analytic derivatives and columns of unit length -------
# The columns of the Jacobian are scaled to unit length, so that a fit in nanometres and one in
# metres take the same steps. A map is reduced to its Gram matrix block by block; few points are
# solved by orthogonal factors, which costs no digits. Tied parameters are named, never regularised
# away.

Linearise = Callable[[FloatArray], Iterable[FloatArray]]
"""From a vector of parameters to blocks of derivatives and deviations, shape (p + 1, n), weighted."""

_DEGENERATE = 1e-13
"""Smallest eigenvalue of the scaled Gram matrix that still determines a direction: 1000 eps."""
_NEARLY_TIED = 1e-8
"""Below it, the direction is named where a fit does not settle: correlation above 0.99999999."""
_STEP_SHARE, _STEP_SHARE_LARGE, _LARGE = 1e-10, 1e-6, 200_000
"""Steps whose effect on the heights is below this share of the residual end the iteration; they are
taken. With few points the residual may be large and the convergence linear; on a large map, which
starts from the answer of a sample, what is left after the last step is smaller by the square."""
_LEAST_DAMPING, _MAX_DAMPING = 1e-12, 1e12
_DAMPING_OF_TIES = 1e-9
_NO_HEIGHT = 1e-60
"""m: a map of zeros has no largest height to compare with."""
_STALLED = 5
"""Steps that lower the residual by less than a millionth together."""
_PARALLEL = 0.99
"""Minus the cosine between two steps that go to and fro."""
_CAUTION = (0.0, 1e-2, 10.0)
"""Damping at the start of each attempt: a careful one begins where a bold one did not arrive."""
"""Relative to columns of unit length. Small at first: nearly tied freedoms leave a long, bent
valley, which a strong damping walks in tiny steps."""


@dataclass(slots=True, eq=False)
class Normal:
    """What the blocks of one linearisation add up to."""

    gram: FloatArray  # shape (p, p): sum of J J'
    gradient: FloatArray  # shape (p,): sum of J r
    squares: float = 0.0  # sum of r^2
    n: int = 0  # points inside the domain
    n_outside: int = 0  # points where the form is not defined
    negligible: FloatArray | None = None  # shape (p,): derivatives up to this size are rounding

    @property
    def works(self) -> NDArray[np.bool_]:
        """Whether each parameter moves the heights by more than rounding, shape (p,)."""
        rms = np.sqrt(np.diag(self.gram) / max(self.n, 1))
        return np.asarray(rms > (0.0 if self.negligible is None else self.negligible))

    @property
    def mean_square(self) -> float:
        """Mean of r^2."""
        return self.squares / self.n if self.n else np.inf


@dataclass(slots=True, eq=False)
class Solution:
    """Where the iteration ended."""

    values: FloatArray  # shape (p,): parameters
    normal: Normal  # at these values
    n_iterations: int  # accepted steps
    trace: list[float] = field(default_factory=list)  # root mean square after each
    # whether the last steps were refused since they take points out of the form's domain
    is_at_rim: bool = False


def accumulate(blocks: Iterable[FloatArray], p: int) -> Normal:
    """Return the sums over blocks of derivatives and deviations."""
    total, n, n_outside = np.zeros((p + 1, p + 1)), 0, 0
    with np.errstate(over="ignore", invalid="ignore"):  # a wild trial: refused for its sum
        for block in blocks:
            inside, part = block, block @ block.T
            if np.isnan(part).any():
                inside = block[:, ~np.isnan(block).any(axis=0)]
                part = inside @ inside.T
            total += part
            n += inside.shape[1]
            n_outside += block.shape[1] - inside.shape[1]
    return Normal(total[:p, :p], total[:p, p], float(total[p, p]), n, n_outside)


def solve(
    linearise: Linearise,
    start: FloatArray,
    names: Sequence[str],
    *,
    height: float,
    reach: FloatArray | None = None,
    linear: Sequence[int] = (),
    is_exact: bool = True,
    max_iterations: int = 100,
) -> Solution:
    """Return the parameters of least squares."""
    job = _SolveJob(
        linearise,
        tuple(names),
        height,
        np.zeros(start.size) if reach is None else _ROUNDING * height / reach,
        np.asarray(linear, dtype=np.intp),
        is_exact,
    )
    begin = start.astype(np.float64)
    failure: NotConvergedError | DegenerateFitError | None = None
    at_rim: Solution | None = None
    for caution in _CAUTION:
        try:
            found = _descend(job, begin, max_iterations, caution=caution)
        except (NotConvergedError, DegenerateFitError) as error:
            failure = failure or error
        else:
            if not found.is_at_rim:
                return found
            at_rim = at_rim or found
    if at_rim is not None:
        return at_rim
    assert failure is not None  # noqa: S101
    raise failure


def one_step(
    linearise: Linearise,
    start: FloatArray,
    names: Sequence[str],
    *,
    height: float,
    reach: FloatArray,
) -> tuple[Solution, float]:
    """Return one undamped step from a start that is nearly there, and the squares it must leave."""
    normal = accumulate(linearise(start), start.size)
    normal.negligible = _ROUNDING * height / reach
    _enough(normal, start.size, names)
    _determined(normal, names)
    step, _ = _step(normal, 0.0, names)
    left = normal.squares - float(normal.gradient @ step)
    return Solution(start + step, normal, 1), left


@dataclass(frozen=True, slots=True, eq=False)
class _SolveJob:
    """What stays the same on the way down."""

    linearise: Linearise
    names: tuple[str, ...]
    height: float
    negligible: FloatArray
    linear: NDArray[np.intp]
    is_exact: bool

    def sums(self, values: FloatArray) -> Normal:
        normal = accumulate(self.linearise(values), values.size)
        normal.negligible = self.negligible
        return normal


def _descend(
    job: _SolveJob, values: FloatArray, max_iterations: int, *, caution: float
) -> Solution:
    """Walk down; `caution` is the damping at the start: a far start may be thrown onto a plateau."""
    normal = job.sums(values)
    _enough(normal, values.size, job.names)
    trace = [float(np.sqrt(normal.mean_square))]
    damping, accepted, effect = caution, 0, np.inf
    least = max(_LEAST_DAMPING, 1e-6 * caution)
    last: FloatArray | None = None
    is_at_rim = False
    for _ in range(max_iterations):
        step, effect = _step(normal, damping, job.names)
        rms = float(np.sqrt(normal.mean_square))
        least_effect = _STEP_SHARE if normal.n < _LARGE else _STEP_SHARE_LARGE
        if effect <= max(
            least_effect * rms, _ROUNDING * job.height, _resolution(normal, values), _NO_HEIGHT
        ):
            if damping > 0.0:  # the step is small because it was held back
                damping = 0.0
                continue
            _determined(normal, job.names)
            return Solution(values + step, normal, accepted, trace)
        scaled = step * np.sqrt(np.diag(normal.gram))
        share = 1.0 if last is None else _share(scaled, last)
        moved, trial = _trial(job, values + share * step)
        if share < 1.0 and not _is_better(trial, normal, job.height):
            share = 1.0
            moved, trial = _trial(job, values + step)
        if _is_better(trial, normal, job.height):
            last = scaled if share == 1.0 else None
            values, normal = moved, trial
            accepted += 1
            trace.append(float(np.sqrt(normal.mean_square)))
            damping = damping / (10.0 if caution else 100.0) if damping > least else 0.0
        else:
            damping = max(damping * 10.0, least)
            is_at_rim = trial.n < normal.n
            if damping > _MAX_DAMPING:
                break
    if is_at_rim and len(trace) > _STALLED and trace[-1] > (1.0 - 1e-6) * trace[-_STALLED]:
        return Solution(values, normal, accepted, trace, is_at_rim=True)
    advice = "give a start closer to the answer, or free fewer parameters"
    if float(np.linalg.eigvalsh(scaled_gram(normal, job.names)[0])[0]) < _NEARLY_TIED:
        advice = (
            f"these points cannot distinguish {' and '.join(tied(normal, job.names))} well: hold one of them at a "
            "value, or do not free it"
        )
    raise NotConvergedError(
        f"the fit of {', '.join(job.names)} did not settle in {max_iterations} steps (RMS "
        f"{trace[-1]:.3g} m, last step still moves the form by {effect:.3g} m RMS); {advice}"
    )


def _share(step: FloatArray, last: FloatArray) -> float:
    """Return the share of a step to take, 1 unless it takes back part of the step before.

    Where the residual is large and bends with a parameter (the angle of a cylinder on a saddle),
    steps go to and fro, each rho < 0 times the one before; their sum is step / (1 - rho).
    """
    before, along = float(last @ last), float(step @ last)
    if not -along > _PARALLEL * np.sqrt(before * float(step @ step)):
        return 1.0
    return 1.0 / (1.0 - along / before)


def _resolution(normal: Normal, values: FloatArray) -> float:
    """Return how far the last digits of the parameters move the heights (root mean square)."""
    moves = np.finfo(float).eps * np.abs(values) * np.sqrt(np.diag(normal.gram) / normal.n)
    return 4.0 * float(np.sqrt(moves @ moves))


def _is_better(trial: Normal, normal: Normal, height: float) -> bool:
    """Whether a trial lowers the residual, keeps the points and still feels every parameter.

    Heights are rounded, and with them the mean of r^2, by twice the rounding times r: where the
    sag is a million times the residual, the last steps lower it by less.
    """
    rounding = 2.0 * _ROUNDING * height * float(np.sqrt(normal.mean_square))
    # From a start that holds all points none is lost; where some lie outside, a few may change.
    fewest = 0.95 * normal.n if normal.n_outside else normal.n
    return bool(
        trial.n >= fewest
        and trial.mean_square <= normal.mean_square * (1.0 + 1e-12) + rounding
        and trial.works.all()
    )


def _trial(job: _SolveJob, values: FloatArray) -> tuple[FloatArray, Normal]:
    """Return the sums at trial values, with the linear parameters solved for them."""
    normal, linear = job.sums(values), job.linear
    if linear.size == 0 or linear.size == values.size or not np.isfinite(normal.squares):
        return values, normal
    part = normal.gram[np.ix_(linear, linear)]
    if normal.n < linear.size or not _is_sound(part):
        return values, normal
    change = np.linalg.solve(part, normal.gradient[linear])
    moved = values.copy()
    moved[linear] += change
    if not job.is_exact:
        return moved, job.sums(moved)
    squares = normal.squares - float(normal.gradient[linear] @ change)
    if squares < 1e-6 * normal.squares:  # the difference has lost its digits
        return moved, job.sums(moved)
    normal.gradient -= normal.gram[:, linear] @ change
    normal.squares = squares
    return moved, normal


def _is_sound(part: FloatArray) -> bool:
    """Whether a block of the Gram matrix can be solved."""
    length = np.sqrt(np.diag(part))
    return bool((length > 0.0).all() and np.linalg.cond(part / np.outer(length, length)) < 1e12)


def _enough(normal: Normal, p: int, names: Sequence[str]) -> None:
    if normal.n < max(p, 1):
        outside = f" ({normal.n_outside} lie outside its domain)" if normal.n_outside else ""
        raise DegenerateFitError(
            f"{p} free parameters ({', '.join(names)}) need at least {max(p, 1)} points, got "
            f"{normal.n}{outside}"
        )


def scaled_gram(normal: Normal, names: Sequence[str]) -> tuple[FloatArray, FloatArray]:
    """Return the Gram matrix with unit diagonal, and the lengths it was divided by."""
    length = np.sqrt(np.diag(normal.gram))
    largest = float(length.max(initial=0.0))
    idle = [name for name, works in zip(names, normal.works, strict=True) if not works]
    if idle or not np.isfinite(largest):
        raise DegenerateFitError(
            f"{', '.join(idle) or ', '.join(names)} changes nothing at the measured points, so it "
            "cannot be found from them; hold it at a value"
        )
    return normal.gram / np.outer(length, length), length


def tied(normal: Normal, names: Sequence[str]) -> list[str]:
    """Return the parameters of the least determined direction, the strongest first."""
    gram, _ = scaled_gram(normal, names)
    vector = np.abs(np.linalg.eigh(gram)[1][:, 0])
    order = np.argsort(-vector)
    return [names[i] for i in order if vector[i] > 0.1 * vector[order[0]]]


def _determined(normal: Normal, names: Sequence[str]) -> None:
    """Raise where the answer leaves a direction open; on the way there it may be so."""
    if names and float(np.linalg.eigvalsh(scaled_gram(normal, names)[0])[0]) < _DEGENERATE:
        raise DegenerateFitError(
            f"the points cannot tell {' from '.join(tied(normal, names))}: moving them together "
            "changes nothing; hold one at a value, or do not free it"
        )


def _step(normal: Normal, damping: float, names: Sequence[str]) -> tuple[FloatArray, float]:
    """Return the step, and the root mean square by which it moves the heights."""
    if not names:
        return np.zeros(0), 0.0
    gram, length = scaled_gram(normal, names)
    if float(np.linalg.eigvalsh(gram)[0]) < _DEGENERATE:
        damping = max(damping, _DAMPING_OF_TIES)
    scaled = np.linalg.solve(gram + damping * np.eye(len(names)), normal.gradient / length)
    squared = float(scaled @ gram @ scaled) / normal.n
    effect = float(np.sqrt(max(squared, 0.0)))
    return scaled / length, effect


# ---- where a fit begins: vertex of the best quadric, or the shift at which the form matches best ----

_MAX_LAGS = 512
"""Points per side of the map that is correlated."""


def vertex(x: FloatArray, y: FloatArray, z: FloatArray) -> tuple[float, float]:
    """Return where the least-squares quadric is level, or (0, 0) where that is far outside."""
    half = max(float(np.abs(x).max()), float(np.abs(y).max()), np.finfo(float).tiny)
    u, v = x / half, y / half
    columns = [np.ones_like(u), u, u * u]
    is_line = float(np.ptp(y)) == 0.0
    if not is_line:
        columns = [np.ones_like(u), u, v, u * u, u * v, v * v]
    if z.size < len(columns):
        return 0.0, 0.0
    c = np.linalg.lstsq(np.column_stack(columns), z - z.mean(), rcond=None)[0]
    hessian = (
        np.array([[2.0 * c[2]]]) if is_line else np.array([[2.0 * c[3], c[4]], [c[4], 2.0 * c[5]]])
    )
    slope = c[1:2] if is_line else c[1:3]
    if abs(np.linalg.det(hessian)) < 1e-12 * float(np.abs(hessian).max(initial=0.0)) ** len(slope):
        return 0.0, 0.0
    place = -np.linalg.solve(hessian, slope)
    if not np.isfinite(place).all() or float(np.abs(place).max()) > 1.0:
        return 0.0, 0.0
    return float(place[0] * half), 0.0 if is_line else float(place[1] * half)


def best_shift(form: Form, points: Points, *, free: tuple[bool, bool]) -> tuple[float, float]:
    """Return the shift of the form, in whole samples, that leaves the smallest sum of squares.

    The sum of squares for every shift comes from three correlations by FFT; the piston is taken
    out for each. A large map is thinned to 512 points per side first.
    """
    z, x, y = _thinned(points)
    period_x, period_y = form.period or (None, None)
    lags_x = _lags(x, period=period_x, allowed=free[0])
    lags_y = _lags(y, period=period_y, allowed=free[1])
    step_x, step_y = _starts_step(x), _starts_step(y)
    wide_x = x[0] + step_x * np.arange(-lags_x, x.size + lags_x)
    wide_y = y[0] + step_y * np.arange(-lags_y, y.size + lags_y)
    h = form.height(*np.meshgrid(wide_x, wide_y))
    defined = ~np.isnan(h)
    h = np.where(defined, h - h[defined].mean(), 0.0) if defined.any() else np.zeros_like(h)
    valid = ~np.isnan(z)
    data = np.where(valid, z - z[valid].mean(), 0.0)
    mask = valid.astype(np.float64)
    n = np.maximum(_slide(mask, defined.astype(np.float64)), 1.0)
    zh, mh, mhh = _slide(data, h), _slide(mask, h), _slide(mask, h * h)
    zz, mz = _slide(data * data, defined * 1.0), _slide(data, defined * 1.0)
    squares = zz - 2.0 * zh + mhh - (mz - mh) ** 2 / n
    mean = np.where(n > 0.25 * mask.sum(), squares / n, np.inf)
    row, column = np.unravel_index(int(np.argmin(mean)), mean.shape)
    return float((lags_x - column) * step_x), float((lags_y - row) * step_y)


def _starts_step(axis: FloatArray) -> float:
    return float((axis[-1] - axis[0]) / (axis.size - 1)) if axis.size > 1 else 0.0


def _lags(axis: FloatArray, *, period: float | None, allowed: bool) -> int:
    if not allowed or axis.size < 2:
        return 0
    half = axis.size // 2
    return half if period is None else min(half, int(np.ceil(0.5 * period / _starts_step(axis))))


def _thinned(points: Points) -> tuple[FloatArray, FloatArray, FloatArray]:
    limit = _MAX_LAGS if points.y.size > 1 else _MAX_LAGS**2
    step_x, step_y = (max(1, -(-axis.size // limit)) for axis in (points.x, points.y))
    return points.z[::step_y, ::step_x], points.x[::step_x], points.y[::step_y]


def _slide(small: FloatArray, large: FloatArray) -> FloatArray:
    """Return the sums of `small` times `large` at every place where it fits into it."""
    shape = large.shape
    spectrum = np.conj(np.fft.rfft2(small, shape)) * np.fft.rfft2(large)
    full = np.fft.irfft2(spectrum, shape)
    rows, columns = (big - little + 1 for big, little in zip(shape, small.shape, strict=True))
    return np.asarray(full[:rows, :columns])
