r"""Private to separation: the posterior of the geometry, and the learning of its spectrum.

All of it works on one matrix and one vector per run (`RunEquations`), which one pass over the
samples makes; a spectrum, a wave, a sensor or a slip costs no further pass. Coordinates: line,
K cosines, K sines, extra terms. Equation numbers are those of separation-2.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from metrosep.core._arrays import BoolArray, FloatArray, IntArray
from metrosep.core.errors import DegenerateFitError
from metrosep.separation.runs.geometry import (
    LINE_SD,
    Extension,
    Sensor,
    Spectrum,
    filtered,
    seen_through,
)
from metrosep.separation.runs.noise import level_spread
from metrosep.separation.runs.slip import what_repeats

DONE = 0.03
"""A learning ends when no knot of ln s^2, or logarithm of a variance, moves by more."""

_CAP = 4.0
"""Largest (a^2 + b^2)/s^2 of one harmonic for a broad part that must not swallow a line."""

_FREE = 100.0
"""Variance over the learnt one with which a wave that slips is hardly held: its runs count once."""

PLACED = (np.zeros(1), np.ones(1))
"""Variances of a lag, and their chances, where no run is displaced."""

SHIFT_SHARE = 0.25
"""Prior standard deviation of a correction of a wavenumber, over one per travel."""


@dataclass(frozen=True, slots=True, eq=False)
class RunEquations:
    """Normal equations of one run, its offset eliminated (eq. 5)."""

    gram: FloatArray  # shape (N, N)
    right: FloatArray  # shape (N,)
    level: FloatArray  # shape (N,): A'o / o'o
    level_right: float  # o'y / o'o
    level_information: float  # o'o
    velocity: float
    feed: int  # number of the feedrate
    length: float  # m: travelled over the readings
    group: int = 0  # number of the noise model


_SAME_VELOCITY = 1e-4
"""Relative difference up to which runs are seen through one sensor: of a phase, even of the shortest
wave and 1 ms, 0.0005 rad."""


def _of_one_velocity(runs: Sequence[RunEquations]) -> list[list[RunEquations]]:
    groups: list[list[RunEquations]] = []
    for run in sorted(runs, key=lambda r: r.velocity):
        first = groups[-1][0].velocity if groups else math.inf
        if abs(run.velocity - first) <= _SAME_VELOCITY * abs(run.velocity):
            groups[-1].append(run)
        else:
            groups.append([run])
    return groups


def _sum(runs: Sequence[RunEquations]) -> RunEquations:
    """Return the sum of matrices and vectors, with the mean velocity."""
    gram, right = runs[0].gram.copy(), runs[0].right.copy()
    for run in runs[1:]:
        gram += run.gram
        right += run.right
    velocity = float(np.mean([r.velocity for r in runs]))
    return replace(runs[0], gram=gram, right=right, velocity=velocity)


_Equations = tuple[FloatArray, FloatArray, IntArray, list[FloatArray]]


def _same(asked: _Equations, solved: _Equations | None) -> bool:
    """Return whether matrix, prior, coordinates in use and columns of the waves are the same."""
    return (
        solved is not None
        and asked[0] is solved[0]
        and np.array_equal(asked[1], solved[1])
        and np.array_equal(asked[2], solved[2])
        and len(asked[3]) == len(solved[3])
        and all(a is b for a, b in zip(asked[3], solved[3], strict=True))
    )


def _check_factor(info: int) -> None:
    """Refuse equations whose matrix has no Cholesky factor."""
    if info != 0:
        raise DegenerateFitError(
            "the runs do not determine the model: two runs or wavelengths are "
            "indistinguishable; ask for longer wavelengths (shortest=) or add runs"
        )


_BLOCK = 48
"""Rows of a triangle that are inverted at once; that of the library takes half as long again."""


def _inverse(lower: FloatArray) -> FloatArray:
    """Return the inverse of a lower triangle, in its place: block columns, the last one first."""
    from scipy.linalg.lapack import dtrtri

    n = len(lower)
    for first in reversed(range(0, n, _BLOCK)):
        below = first + _BLOCK
        own = slice(first, below)
        corner = dtrtri(lower[own, own], lower=1)[0]
        side = lower[below:, own] @ corner
        for row in range(below, n, 2 * _BLOCK):  # of a triangle only what is not zero
            end = row + 2 * _BLOCK
            lower[row:end, own] = -lower[row:end, below:end] @ side[: end - below]
        lower[own, own] = corner
    return lower


def _factored(matrix: FloatArray) -> tuple[FloatArray, float]:
    """Return the inverse of the lower Cholesky factor of a matrix, in whose place it is, and ln det."""
    from scipy.linalg.lapack import dpotrf

    factor, info = dpotrf(matrix.T, lower=1, clean=1, overwrite_a=1)
    _check_factor(info)
    logs = 2.0 * float(np.log(np.diag(factor)).sum())
    return _inverse(factor), logs


@dataclass(slots=True, eq=False)
class Wave:
    """One wave of free wavelength: its columns, its variance, and what its wavelength may do."""

    wavenumber: float  # 1/m
    columns: FloatArray  # shape (1 + 2 K, 2 or 3): cosine, sine, change with the wavenumber
    variance: float  # tau^2
    given: bool = False  # stated by the user: a start value


@dataclass(slots=True, eq=False)
class Slip:
    """A wave that is tied to the position and has another phase in each run."""

    wavenumber: float  # 1/m
    columns: FloatArray  # shape (1 + 2 K, 2): cosine, sine
    variance: float  # Lambda, of the cosine and the sine of one run


@dataclass(slots=True, eq=False)
class Posterior:
    """Solution of one model; its columns are some coordinates, then those of the waves."""

    mean: FloatArray  # shape (n,), of the columns in use
    used: IntArray  # coordinates in use
    waves: FloatArray  # shape (N, m): columns of what slips and repeats, then of the waves
    root: FloatArray  # shape (n, n): covariance = root @ root.T
    evidence: float  # ln evidence, but for a term that does not depend on the prior
    _spread: FloatArray | None = None
    _full_root: FloatArray | None = None
    _covariance: FloatArray | None = None

    @property
    def theta(self) -> FloatArray:
        """Mean in the coordinates of the run equations."""
        return self.expanded(self.mean)

    def expanded(self, values: FloatArray) -> FloatArray:
        """Return values of the columns, shape (n,) or (n, k), in all coordinates."""
        out = np.zeros((self.waves.shape[0], *values.shape[1:]))
        out[self.used] = values[: self.used.size]
        if self.waves.shape[1]:
            out += self.waves @ values[self.used.size :]
        return out

    def along(self, columns: FloatArray) -> FloatArray:
        """Return what columns of the coordinates, shape (N,) or (N, k), are on those in use."""
        own = columns[self.used]
        return np.concatenate([own, self.waves.T @ columns]) if self.waves.shape[1] else own

    def seen_by(self, columns: FloatArray) -> FloatArray:
        """Return root' times what columns of the coordinates, shape (N, k), are on those in use."""
        from scipy.linalg.blas import dtrmm

        own = self.along(columns)
        # the root is the transpose of a lower triangle
        return np.asarray(dtrmm(1.0, self.root.T, own.T, side=1, lower=1, trans_a=1).T)

    @property
    def full_root(self) -> FloatArray:
        """Root of the covariance in all coordinates, shape (N, n)."""
        if self._full_root is None:
            self._full_root = self.expanded(self.root)
        return self._full_root

    @property
    def spread(self) -> FloatArray:
        """Variances of the columns in use."""
        if self._spread is None:
            self._spread = np.einsum("ij,ij->i", self.root, self.root)
        return self._spread

    def covariance(self) -> FloatArray:
        """Return the covariance in the coordinates of the run equations."""
        if self._covariance is None:
            self._covariance = self.full_root @ self.full_root.T
        return self._covariance

    def draws(self, n: int, seed: int) -> FloatArray:
        """Return draws whose mean is the mean, shape (N, n)."""
        free = np.random.default_rng(seed).standard_normal((self.mean.size, n))
        free = (free - free.mean(axis=1, keepdims=True)) * math.sqrt(n / (n - 1.0))
        return self.expanded(self.mean[:, None] + self.root @ free)


@dataclass(slots=True, eq=False)
class Model:
    """What is learnt: spectrum, waves, sensor, slip; and the equations that it is learnt from."""

    extension: Extension
    spectrum: Spectrum
    line_sd: float = LINE_SD
    n_extra: int = 0
    extra_precision: FloatArray = field(default_factory=lambda: np.empty(0))
    waves: list[Wave] = field(default_factory=list)
    sensor: Sensor = field(default_factory=Sensor)
    slip: list[Slip] = field(default_factory=list)
    slip_is_geometry: bool = True  # what slips may repeat as well (eq. 24)
    kept: int = 0  # harmonics in use; all K in the last solution
    runs: list[RunEquations] = field(default_factory=list)  # as read
    # sums over the runs of one velocity, as read; then as seen, and the sum of all
    speeds: list[tuple[list[RunEquations], RunEquations]] = field(default_factory=list)
    _by_speed: list[RunEquations] | None = None
    _total: tuple[FloatArray, FloatArray] | None = None
    post: Posterior | None = None
    # s^2: variances of a lag because the runs are displaced, each by its own; and their chances
    lag_variances: tuple[FloatArray, FloatArray] = PLACED
    places: tuple[FloatArray, FloatArray] = (
        PLACED  # m: by which the runs scatter, and their chances
    )
    lag_prior: float = 0.0  # s: half width of the distribution of the lag before; 0: any lag
    _seen: list[RunEquations] | None = None
    # the equations of which `post` is the solution
    _solved: _Equations | None = None
    # the last matrix and columns of the waves, and the columns in all coordinates with their product
    _waves_last: tuple[_Equations | None, tuple[FloatArray, FloatArray]] = (
        None,
        (np.empty((0, 0)),) * 2,
    )
    # the last equations of the coordinates in use, and the inverse of their factor with ln det
    _factored_last: tuple[_Equations | None, tuple[FloatArray, float]] = (
        None,
        (np.empty((0, 0)), 0.0),
    )
    # of the noise models of a sum of all runs, which is the first
    _roots: tuple[FloatArray, list[FloatArray]] = field(default_factory=lambda: (np.empty(0), []))

    def __post_init__(self) -> None:
        self.kept = self.extension.n

    @property
    def lag_variance(self) -> float:
        """Variance of a lag because the runs are displaced, s^2."""
        variances, chances = self.lag_variances
        return float(chances @ variances)

    # ---- equations -------------------------------------------------------------------------

    def take(self, runs: Sequence[RunEquations]) -> None:
        """Take the equations of a new pass."""
        self.runs = list(runs)
        self.speeds = [(group, _sum(group)) for group in _of_one_velocity(self.runs)]
        self.apply()

    def apply(self) -> None:
        """Eliminate slip and apply the sensor anew (eqs. 6, 7), where the sums are asked for next."""
        self._seen = self._by_speed = self._total = None

    @property
    def by_speed(self) -> list[RunEquations]:
        """Sums over the runs of one velocity as seen: a sensor turns them alike, so their sum once."""
        if self._by_speed is None:
            self._by_speed = [self._as_seen(group, whole) for group, whole in self.speeds]
        return self._by_speed

    @property
    def total(self) -> tuple[FloatArray, FloatArray]:
        """Matrix and vector of all runs, as seen."""
        if self._total is None:
            whole = _sum(self.by_speed)
            self._total = whole.gram, whole.right
        return self._total

    @property
    def seen(self) -> list[RunEquations]:
        """Equations of every run for the geometry: slip eliminated, sensor applied."""
        if self._seen is None:
            self._seen = [self._as_seen([run], run) for run in self.runs]
        return self._seen

    def _as_seen(self, runs: Sequence[RunEquations], whole: RunEquations) -> RunEquations:
        """Return the sum of the equations of runs of one velocity for the geometry."""
        from scipy.linalg.lapack import dpotrf, dtrtrs

        gram, right = whole.gram, whole.right
        if self.slip:
            columns, own = self.slipping()
            parts = []
            for run in runs:
                held = columns.T @ run.gram
                factor, info = dpotrf(held @ columns + own, lower=1)
                _check_factor(info)
                side = np.column_stack([held, columns.T @ run.right])
                parts.append(dtrtrs(factor, side, lower=1)[0])
            half = np.concatenate(parts)
            gram = gram - half[:, :-1].T @ half[:, :-1]
            right = right - half[:, :-1].T @ half[:, -1]
        if self.sensor != Sensor():
            h = np.conj(self.sensor.response(self.extension.wavenumbers, whole.velocity))
            gram = seen_through(gram, h)
            right = filtered(right, h)
        return replace(whole, gram=gram, right=right)

    def slipping(self) -> tuple[FloatArray, FloatArray]:
        """Return the columns of what slips, shape (N, m), and the prior precision of one run's, (m, m)."""
        own = np.repeat([1.0 / s.variance for s in self.slip], 2)
        return self._expanded([s.columns for s in self.slip]), np.diag(own)

    def state(self) -> tuple[Sensor, FloatArray, tuple[float, ...]]:
        """Return sensor, spectrum and strength of the waves, for `back_to`."""
        return self.sensor, self.spectrum.phi.copy(), tuple(w.variance for w in self.waves)

    def back_to(self, state: tuple[Sensor, FloatArray, tuple[float, ...]]) -> None:
        """Take a state again; the next solution is that of it."""
        self.sensor, self.spectrum.phi = state[0], state[1].copy()
        for wave, variance in zip(self.waves, state[2], strict=True):
            wave.variance = variance
        self.apply()

    # ---- solution --------------------------------------------------------------------------

    def _columns(self) -> list[FloatArray]:
        """Return the columns of what slips and repeats, then those of the waves."""
        return [s.columns for s in self._repeating()] + [w.columns for w in self.waves]

    def _repeating(self) -> list[Slip]:
        return self.slip if self.slip_is_geometry else []

    def _expanded(self, columns: list[FloatArray]) -> FloatArray:
        """Return columns of the basis side by side in all coordinates."""
        size = 1 + 2 * self.extension.n
        return np.vstack(
            [
                np.hstack([np.empty((size, 0)), *columns]),
                np.zeros((self.n_extra, sum(c.shape[1] for c in columns))),
            ]
        )

    def harmonics(self) -> BoolArray:
        """Return which harmonics are in use."""
        return np.asarray(np.arange(self.extension.n) < self.kept)

    def used(self) -> IntArray:
        """Return the coordinates in use: line, kept harmonics, extra."""
        on = self.harmonics()
        ones = np.concatenate([[True], on, on, np.ones(self.n_extra, dtype=bool)])
        return np.flatnonzero(ones)

    def precision(self) -> FloatArray:
        """Return the prior precision of the columns in use."""
        on = self.harmonics()
        waves = 1.0 / self.spectrum.variance[on]
        shift = (self.extension.travel / SHIFT_SHARE) ** 2
        own = [np.full(2, 1.0 / s.variance) for s in self._repeating()]
        own += [
            np.concatenate([np.full(2, 1.0 / w.variance), np.full(w.columns.shape[1] - 2, shift)])
            for w in self.waves
        ]
        return np.concatenate([[self.line_sd**-2], waves, waves, self.extra_precision, *own])

    def solve(self) -> Posterior:
        """Solve for the coefficients (eq. 8), unless the last solution is of the same equations."""
        asked = (self.total[0], self.precision(), self.used(), self._columns())
        if self.post is None or not _same(asked, self._solved):
            self.post = self._solution(*self.total, *asked[1:3])
            self._solved = asked
        return self.post

    def solution(self, gram: FloatArray, right: FloatArray) -> Posterior:
        """Return the posterior of some equations under the prior at hand (eq. 8)."""
        return self._solution(gram, right, self.precision(), self.used())

    def _solution(
        self, gram: FloatArray, right: FloatArray, precision: FloatArray, used: IntArray
    ) -> Posterior:
        """Return the posterior of equations under a prior, of coordinates in use and waves."""
        n = used.size
        inverse, logs = self._of_coordinates(gram, precision[:n], used)
        waves, half = self._of_waves(gram)
        side = right[used]
        if waves.shape[1]:
            across = inverse @ half[used]
            own = waves.T @ half - across.T @ across
            own.ravel()[:: len(own) + 1] += precision[n:]
            corner, more = _factored(own)
            base, inverse = inverse, np.zeros((precision.size,) * 2, order="F")
            inverse[:n, :n] = base
            inverse[n:, :n] = -(corner @ across.T) @ base
            inverse[n:, n:] = corner
            logs += more
            side = np.concatenate([side, waves.T @ right])
        root = inverse.T
        mean = root @ (root.T @ side)
        evidence = 0.5 * (float(side @ mean) - logs + float(np.log(precision).sum()))
        return Posterior(mean, used, waves, root, evidence)

    def _of_coordinates(
        self, gram: FloatArray, precision: FloatArray, used: IntArray
    ) -> tuple[FloatArray, float]:
        """Return what `_factored` does of the coordinates in use, which have no part in the waves."""
        asked: _Equations = (gram, precision, used, [])
        if not _same(asked, self._factored_last[0]):
            whole = used.size == len(gram)
            matrix = gram.copy() if whole else gram.take(used, axis=0).take(used, axis=1)
            # A Cholesky factor is as exact without its rows and columns being scaled to one size.
            matrix.ravel()[:: used.size + 1] += precision
            self._factored_last = asked, _factored(matrix)
        return self._factored_last[1]

    def _of_waves(self, gram: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return the columns of the waves, and a matrix times these, kept while both stay the same."""
        asked = (gram, np.empty(0), np.empty(0, dtype=int), self._columns())
        if not _same(asked, self._waves_last[0]):
            waves = self._expanded(asked[3])
            self._waves_last = asked, (waves, gram @ waves)
        return self._waves_last[1]

    # ---- learning --------------------------------------------------------------------------

    def learn(self, most: int, *, above: float = 0.0, cap: bool = False) -> None:
        """Learn spectrum and strength of the waves (eq. 10), from above where asked."""
        # Below the posterior variance the information vanishes and phi cannot climb: so from above.
        self.spectrum.phi = self.spectrum.phi + above
        for _ in range(most):
            post = self.solve()
            score, information = self.scores(post, cap=cap)
            change = self.spectrum.step(score, information)
            self._learn_waves(post)
            if change < DONE:
                break
        self.solve()

    def scores(self, post: Posterior, *, cap: bool = False) -> tuple[FloatArray, FloatArray]:
        """Return gradient and Fisher information of ln s_k^2, summed over each pair (eq. 10)."""
        on = self.harmonics()
        n, used = self.extension.n, int(on.sum())
        variance = self.spectrum.variance
        spread = post.spread
        score, information = np.zeros(n), np.zeros(n)
        power = np.zeros(n)
        for first in (1, 1 + used):
            part = slice(first, first + used)
            gamma = 1.0 - spread[part] / variance[on]
            power[on] += post.mean[part] ** 2 / variance[on]
            score[on] -= 0.5 * gamma
            information[on] += 0.5 * gamma**2
        if cap:
            power = np.minimum(power, _CAP)
        return score + 0.5 * power, information

    def _learn_waves(self, post: Posterior) -> None:
        spread = post.spread
        at = post.mean.size - sum(w.columns.shape[1] for w in self.waves)
        for wave in self.waves:
            pair = slice(at, at + 2)
            wave.variance = max(0.5 * float(np.sum(post.mean[pair] ** 2 + spread[pair])), 1e-12)
            at += wave.columns.shape[1]

    def wave_parts(self) -> list[slice]:
        """Return where the columns of each wave are among those in use."""
        assert self.post is not None  # noqa: S101  (after a solution)
        at = self.post.mean.size - sum(w.columns.shape[1] for w in self.waves)
        parts = []
        for wave in self.waves:
            parts.append(slice(at, at + wave.columns.shape[1]))
            at += wave.columns.shape[1]
        return parts

    def drop_short(self) -> None:
        """Leave out, while learning only, the harmonics that add nothing (3.5)."""
        post = self.solve()
        variance, n = self.spectrum.variance, self.extension.n
        spread = float(np.sum(post.full_root[1 : 1 + 2 * n] ** 2))
        tail = np.cumsum(variance[::-1])[::-1]
        gram = np.diag(self.total[0])
        own = 0.5 * (gram[1 : n + 1] + gram[n + 1 : 2 * n + 1])
        needed = (tail > 0.003 * spread / 2.0) & (variance * own > 0.02)
        self.kept = max(int(np.flatnonzero(needed).max(initial=0)) + 1, 8)

    def log_evidence(self, post: Posterior) -> float:
        """Return ln evidence with the prior of the spectrum, but for a constant."""
        phi = self.spectrum.phi
        prior = self.spectrum.pull @ phi - 0.5 * phi @ self.spectrum.precision @ phi
        return post.evidence + float(prior)

    def covariance(self, post: Posterior, louder: Sequence[FloatArray] = ()) -> FloatArray:
        """Return the covariance with what is not known of the noise in each octave, shape (N, N)."""
        # The error of the solution is C A'n, and A'n has the covariance G = R'R: noise that is
        # greater by some factors F^2 gives R'F^2 R. R is the symmetric root, whose rows stay at their
        # wavelengths and have no part in what no reading shows; F G F would widen that as well.
        whole = post.covariance()
        out = whole.copy()
        for root in louder or self._louder():
            half = root @ whole
            out += half.T @ half
        return np.asarray(out)

    def _louder(self) -> list[FloatArray]:
        """Return (F^2 - 1)^1/2 R for each noise model."""
        if self._roots[0] is not self.total[0]:
            roots = []
            for gram, length in self._by_noise():
                cycles = length * np.arange(1, self.extension.n + 1) / self.extension.period
                more = level_spread(np.asarray(cycles), len(self.runs)) - 1.0
                louder = np.concatenate([more[:1], more, more, np.zeros(self.n_extra)])
                scale = np.sqrt(np.maximum(np.diag(gram), 1e-300))
                values, vectors = np.linalg.eigh(gram / np.outer(scale, scale))
                root = (vectors * np.sqrt(np.maximum(values, 0.0))) @ vectors.T * scale
                roots.append(np.sqrt(louder)[:, None] * root)
            self._roots = self.total[0], roots
        return self._roots[1]

    def _by_noise(self) -> list[tuple[FloatArray, float]]:
        """Return the matrix of the runs of each noise model, as seen, and the length of their travels."""
        groups = sorted({r.group for r in self.runs})
        own = [[i for i, r in enumerate(self.runs) if r.group == g] for g in groups]
        lengths = [sum(self.runs[i].length for i in at) for at in own]
        if len(groups) == 1:
            return [(self.total[0], lengths[0])]
        return [
            (_sum([self.seen[i] for i in at]).gram, n) for at, n in zip(own, lengths, strict=True)
        ]

    def spread_of_spectrum(self, post: Posterior) -> FloatArray:
        """Return J (F + prior)^-1/2, what the learnt spectrum adds to the covariance (eq. 16)."""
        on = self.harmonics()
        used = int(on.sum())
        _, information = self.scores(post)
        precision = self.spectrum.information(information)
        variance = self.spectrum.variance[on]
        weighted = np.zeros((post.mean.size, self.spectrum.phi.size))
        for first in (1, 1 + used):
            part = slice(first, first + used)
            # dM/dphi = - diag(B s^-2), so dm/dphi = C diag(B s^-2) m
            weighted[part] = self.spectrum.hats[on] * (post.mean[part] / variance)[:, None]
        change = post.expanded(post.root @ (post.root.T @ weighted))
        return np.asarray(change @ np.linalg.cholesky(np.linalg.inv(precision)))

    def answer(self) -> Answer:
        """Return the solution with what noise and spectrum leave open (eq. 16)."""
        if self.slip and self.slip_is_geometry:
            return self._answer_beside_slip()
        post = self.solve()
        return self._answer(post, post.theta, self.covariance(post), self.log_evidence(post))

    def _answer(
        self, post: Posterior, mean: FloatArray, plain: FloatArray, evidence: float
    ) -> Answer:
        """Return an answer with what the learnt spectrum leaves open."""
        change = self.spread_of_spectrum(post)
        # Twice: a spectrum that is learnt of the readings leaves them, on average, a variance that is
        # too small by the same again (Prasad, Rao 1990).
        return Answer(mean, plain + 2.0 * change @ change.T, plain, evidence)

    def _answer_beside_slip(self) -> Answer:
        """Return the answer where waves slip, with what repeats of these (`what_repeats`).

        The geometry is solved with these waves free in each run, and is then known but for u = B theta,
        what of it looks like them. They show z = u + c, and c repeats beside the spectrum.
        """
        found = [s.variance for s in self.slip]
        for slip in self.slip:
            slip.variance *= _FREE
        self.slip_is_geometry = False
        self.apply()
        post = self.solve()
        plain = self.covariance(post)
        columns, own = self.slipping()
        pairs, noise, alike = self._pairs(post, columns, own)
        seen = alike @ post.full_root
        known = seen @ seen.T
        inside = (
            post.full_root @ np.linalg.solve(known, seen).T
        )  # the change of the geometry with u
        n, parts = len(own), np.hstack([inside, columns])
        mean, spread = np.zeros(2 * n), np.zeros((2 * n, 2 * n))
        evidence = self.log_evidence(post)
        for first in range(0, n, 2):
            pair = [first, first + 1]
            angle = 2.0 * math.pi * self.slip[first // 2].wavenumber
            part = what_repeats(
                pairs[:, pair],
                noise[:, first // 2],
                0.5 * float(np.trace(known[np.ix_(pair, pair)])),
                (angle * self.places[0], self.places[1]),
            )
            at = [*pair, n + first, n + first + 1]
            mean[at], spread[np.ix_(at, at)] = part.mean, part.covariance
            evidence += part.evidence
        plain += parts @ spread @ parts.T - inside @ known @ inside.T
        out = self._answer(post, post.theta + parts @ mean, plain, evidence)
        self.slip_is_geometry = True
        for slip, variance in zip(self.slip, found, strict=True):
            slip.variance = variance
        self.apply()
        self.solve()
        return out

    def _pairs(
        self, post: Posterior, columns: FloatArray, own: FloatArray
    ) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Return what runs show of waves that slip beside a solution, (R, m), its variance, (R, m/2), and B.

        All of it as it was before the sensor. B theta, (m, N), is what geometry has of these waves.
        """
        turned, held, rests = [], [], []
        for run in self.runs:
            h = self.sensor.response(self.extension.wavenumbers, run.velocity)
            side = columns.T @ run.gram
            held.append(filtered(side.T, np.conj(h)).T)
            turned.append(held[-1] @ columns + own)
            rests.append(columns.T @ run.right - held[-1] @ post.theta)
        alike = np.asarray(np.linalg.solve(sum(turned), sum(held)), dtype=np.float64)
        pairs, noise = [], []
        for run, turn, side, rest in zip(self.runs, turned, held, rests, strict=True):
            back = np.linalg.inv(turn)
            apart = (back @ side - alike) @ post.full_root
            squares = np.diag(
                back @ (columns.T @ run.gram @ columns + own) @ back.T + apart @ apart.T
            )
            pairs.append(back @ rest)
            noise.append(0.5 * (squares[::2] + squares[1::2]))
        return np.array(pairs), np.array(noise), alike


@dataclass(frozen=True, slots=True, eq=False)
class Answer:
    """Mean and covariance in the coordinates of the equations, the band's parts apart."""

    mean: FloatArray
    covariance: FloatArray
    plain: FloatArray  # without what the learnt spectrum leaves open
    evidence: float = math.nan  # ln, but for a constant


def averaged(
    weights: Sequence[float] | FloatArray,
    means: Sequence[FloatArray],
    covariances: Sequence[FloatArray],
) -> tuple[FloatArray, FloatArray]:
    """Return mean and covariance of solutions of some chances, their sum 1 (eq. 22)."""
    w = np.asarray(weights)
    mean = w @ np.asarray(means)
    apart = (means - mean) * np.sqrt(w)[:, None]
    within = sum(p * c for p, c in zip(w, covariances, strict=True))
    return mean, np.asarray(within + apart.T @ apart)
