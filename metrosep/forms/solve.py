"""Levenberg-Marquardt in blocks, with analytic derivatives and columns of unit length.

The columns of the Jacobian are scaled to unit length, so that a fit in nanometres and one in
metres take the same steps. A map is reduced to its Gram matrix block by block; few points are
solved by orthogonal factors, which costs no digits. Tied parameters are named, never regularised
away.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from metrosep.core._arrays import FloatArray
from metrosep.core.errors import DegenerateFitError, NotConvergedError

__all__ = ["Normal", "Solution", "accumulate", "one_step", "scaled_gram", "solve"]

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
_ROUNDING = 16.0 * float(np.finfo(float).eps)
"""Of the largest height: what a noise-free fit ends at."""
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
    job = _Job(
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
class _Job:
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


def _descend(job: _Job, values: FloatArray, max_iterations: int, *, caution: float) -> Solution:
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
            f"the points hardly tell {' from '.join(tied(normal, job.names))}: hold one with "
            "fixed={...} or leave it out of free"
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


def _trial(job: _Job, values: FloatArray) -> tuple[FloatArray, Normal]:
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
            "cannot be found from them; hold it with fixed={...}"
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
            "changes nothing; hold one with fixed={...} or leave it out of free"
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
