"""Private: the acceptance statistic: does a correction improve the machine, and with what confidence.

Only what the MEASUREMENT cannot know is taken off, and off the measurement only: never off the
table. Equations of the specification of tables, section 1, with R runs m_k on K positions:

    a_k = m_k - P_N m_k                      known part of run k
    r_k(x) = a_k(x + kappa c) + c~(x)        what stays; c~ = c - mean c, c_0 = c(reference)
    D_k = <a_k^2> - <r_k^2> - c_0^2          improvement, linear in the readings: noise does not bias it
    g = -<a c~> / <c~^2>                     gain: share of the table that the readings confirm
    E = mean over j != k of <a_j a_k>        energy of what repeats
    q = sqrt(max(E - D, 0) / E)              RMS that stays over RMS that was, of what repeats
"""

from __future__ import annotations

import math
from collections.abc import Callable, Collection, Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise
from typing import TYPE_CHECKING, Any

import numpy as np

from metrosep.compensation.area_errors import LENGTHS, AxisUnits
from metrosep.compensation.limits import Stated
from metrosep.core._arrays import BoolArray, FloatArray
from metrosep.core.errors import InconclusiveTableError, PointlessTableError, SignCheckFailedError

ENOUGH = 0.7
"""Less than 30 % of the RMS goes above it: pointless."""

_CONFIDENCE, _STRICT = 0.99, 0.999
_NORMAL = 2.33
"""Quantile 0.99 of a slope whose standard uncertainty is stated."""

_STATED_FREEDOM = 30
"""Degrees of freedom of the standard uncertainty that an estimate carries."""

_PRIOR = 4
"""Degrees of freedom of the scatter inside the runs beside that between them (moderated variance)."""

_MEDIAN = 1.2533
"""Standard deviation of a median over that of a mean: sqrt(pi / 2)."""

_RISE, _RISE_NOISE = 1.05, 1.6
_SPIKE, _SPIKE_SHARE = 10.0, 0.05
_NOISY = 0.5
_FEWEST_RUNS = 3
"""Two slopes agree by chance in some percent of cases, as two disturbances do."""

ROUNDING = 1e-12
"""A picometre: a step of the table at a reversal below it is that of binary positions."""

_UNCHANGED = 1e-9
"""Change of a stated mean square, over it, that is rounding."""

_WINDOWS = 8
_FEWEST_LAGS = 4
"""Positions of a direction below which the scatter inside a run shows no correlation."""


@dataclass(frozen=True, slots=True, eq=False)
class Stack:
    """Runs and corrections at the compared positions; a pair of directions is one row."""

    x: FloatArray  # shape (K,), m and +1 or -1: position and direction of each sample
    way: FloatArray
    known: FloatArray  # shape (R, K), m: a_k, r_k, and r_k with the negated correction
    rest: FloatArray
    wrong: FloatArray
    applied: FloatArray  # shape (R, K), m: c~ of the table that each run is judged with
    zero: float  # m: c_0, the correction at the reference
    steps: FloatArray
    names: tuple[str, ...]  # of the runs
    # whether the slope is part of what is known; it then has an uncertainty of its own
    has_slope: bool
    is_left_out: bool = False  # whether each run is judged with the table that was made without it
    made_it: bool = False  # whether the table was made of these runs
    why: str = ""  # why it was not made again without each of them
    # whether there are no readings: the error is stated, with u = 0 or with `u_known`
    is_stated: bool = False
    u_known: float | None = None  # m^2: u of <a c~> of a stated error, where it has one
    u_slope: float | None = None  # rad: common to all runs of positioning
    # of a map, which is one run over an area: the compared nodes, shape (m, n), and what takes off
    # what its measurement cannot know
    nodes: BoolArray | None = None
    level: Callable[[FloatArray], FloatArray] | None = None
    units: AxisUnits = LENGTHS  # of places and amounts in texts
    is_list: bool = False  # whether the table is made of a list of targets, which is not separated

    @property
    def n_runs(self) -> int:
        """R."""
        return len(self.known)

    def negated(self) -> Stack:
        """Return the same with the sign of the table reversed."""
        return replace(
            self,
            rest=self.wrong,
            wrong=self.rest,
            applied=-self.applied,
            made_it=False,
            is_left_out=False,
            zero=-self.zero,
            steps=-self.steps,
        )

    @property
    def line(self) -> FloatArray:
        """Position over its RMS, mean zero: <l^2> = 1."""
        return np.asarray((self.x - self.x.mean()) / self.x.std())


@dataclass(frozen=True, slots=True)
class Improvement:
    """D with its standard uncertainty, in m^2, and the quantiles that go with it."""

    value: float
    u: float
    t: float
    strict: float
    # of one run of positioning whose u(slope) is not stated: what is left of D without its slope
    shape: float | None = None
    shared: float = 0.0  # m^2: share of t u that all runs have in common (temperature, scale)

    @property
    def is_worse(self) -> bool:
        """Whether the machine is worse with the table, with 99 % confidence."""
        # the slope of one run may be that of its temperature: it alone refuses nothing
        most = self.value if self.shape is None else max(self.value, self.shape)
        return most + self.t * self.u < 0.0


@dataclass(frozen=True, slots=True)
class Reason:
    """Why a table is not accepted: the grade it gives, the check that waives it, the sentence."""

    grade: str
    check: str
    text: str


@dataclass(frozen=True, slots=True)
class Judgement:
    """What `judge` found; lengths in m, improvements in m^2."""

    improvement: Improvement
    gain: float
    u_gain: float
    energy: float
    rest: float
    pv_before: float
    pv_after: float
    pv_after_plain: float
    pv_noise: float
    reasons: tuple[Reason, ...]
    warnings: tuple[str, ...]

    @property
    def is_reversed(self) -> bool:
        """Whether the readings confirm the negated table, with 99.9 % confidence."""
        return self.gain + self.improvement.strict * self.u_gain < 0.0


def judge(stack: Stack) -> Judgement:
    """Return improvement, gain, rest and P-V of a table, and every reason not to accept it."""
    a, c = stack.known, stack.applied
    energy_c = float((c**2).mean())
    improved = _improvement(stack, np.ones(stack.x.size, dtype=bool))
    gain = -float((a * c).mean()) / energy_c if energy_c > 0.0 else 0.0
    energy = _energy(stack, gain)
    u_gain = improved.u / (2.0 * energy_c) if energy_c > 0.0 else math.inf
    rest = math.sqrt(max(energy - improved.value, 0.0) / energy) if energy > 0.0 else math.inf
    pv = _peaks(stack, gain)
    reasons = [
        *_refusals(stack, improved, pv),
        *_uncertain(stack, improved, energy, rest, pv),
        *_pointless(energy, rest, energy_c),
    ]
    return Judgement(
        improved, gain, u_gain, energy, rest,
        pv.before, pv.after, pv.plain, pv.noise, tuple(reasons),
        () if improved.is_worse or stack.nodes is not None else tuple(_regions(stack)),
    )  # fmt: skip


def _energy(stack: Stack, gain: float) -> float:
    """Return (7): products of different runs carry no noise; of one run, what its rest leaves."""
    a, n = stack.known, stack.n_runs
    if n == 1:
        noise = 0.0 if stack.is_stated else float((_rest_of_one(stack, gain) ** 2).mean())
        return max(float((a**2).mean()) - noise, 0.0)
    total = a.sum(axis=0)
    return max(float((total**2).mean() - (a**2).mean(axis=1).sum()) / (n * (n - 1)), 0.0)


def _rest_of_one(stack: Stack, gain: float | None = None) -> FloatArray:
    """Return a + g c~ without what the measurement cannot know (its mean: a has no line left)."""
    a, c = stack.known[0], stack.applied[0]
    if gain is None:
        size = float((c**2).mean())
        gain = -float((a * c).mean()) / size if size > 0.0 else 0.0
    rest = a + gain * c
    if stack.level is not None:
        return stack.level(rest)[None]
    if not stack.has_slope and not stack.is_stated:
        line = stack.line
        rest = rest - line * float((rest * line).mean())
    return np.asarray(rest - rest.mean())[None]


def _improvement(stack: Stack, where: BoolArray) -> Improvement:
    """Return (5) and (9) to (15) over a part of the samples; a, c~ and l stay those of the whole."""
    a, c, n = stack.known, stack.applied, stack.n_runs
    value = float(
        ((a[:, where] ** 2).mean(axis=1) - (stack.rest[:, where] ** 2).mean(axis=1)).mean()
        - stack.zero**2
    )
    if stack.is_stated:
        value = 0.0 if abs(value) <= _UNCHANGED * float((a**2).mean()) else value
        t = float(_quantile(_STATED_FREEDOM, _CONFIDENCE))
        strict = float(_quantile(_STATED_FREEDOM, _STRICT))
        return Improvement(value, 2.0 * (stack.u_known or 0.0), t, strict)
    scatter = (a - a.mean(axis=0)) * math.sqrt(n / (n - 1)) if n > 1 else _rest_of_one(stack)
    mean_c, u_slope, u_common, shape = c.mean(axis=0), 0.0, 0.0, None
    if stack.has_slope:
        # Runs of one axis differ first of all by a slope (temperature): it is judged apart (14b).
        # A temperature or scale that is wrong is wrong in every run: no number of them shows it.
        line = stack.line
        slopes = (a * line).mean(axis=1)
        share = 2.0 * abs(float((mean_c * line)[where].mean()))
        u_slope = share * float(slopes.std(ddof=1)) / math.sqrt(n) if n > 1 else 0.0
        u_common = share * float(stack.x.std()) * (stack.u_slope or 0.0)
        a, c, mean_c, scatter = (
            v - np.multiply.outer((v * line).mean(axis=-1), line) for v in (a, c, mean_c, scatter)
        )
    products = (a[:, where] * c[:, where]).mean(axis=1)
    changes = -2.0 * products - (c[:, where] ** 2).mean(axis=1)
    if stack.has_slope and n == 1 and stack.u_slope is None:
        shape = float(changes[0]) - stack.zero**2
    if stack.nodes is None:
        inside = _inside(scatter, mean_c, stack.way, where)
    else:
        inside = _inside_area(scatter[0], mean_c, stack.nodes)
    between = float(products.var(ddof=1)) if n > 1 else 0.0
    if _fewest(stack, where) < _FEWEST_LAGS and n >= _FEWEST_RUNS:
        variance, freedom = between, n - 1
    else:
        variance = (_PRIOR * inside + (n - 1) * between) / (n - 1 + _PRIOR)
        freedom = n - 1 + _PRIOR
    u = 2.0 * math.sqrt(variance / n)
    if stack.is_left_out:
        u = math.sqrt(2.0) * max(u, float(changes.std(ddof=1)) / math.sqrt(n))
        u_slope *= math.sqrt(2.0)
        freedom = n - 1
    t = float(_quantile(freedom, _CONFIDENCE))
    u += (_slope_quantile(n) * u_slope + _NORMAL * u_common) / t
    strict = float(_quantile(freedom, _STRICT))
    return Improvement(value, u, t, strict, shape, _NORMAL * u_common)


def _fewest(stack: Stack, where: BoolArray) -> int:
    """Return the compared positions of the direction that has fewest."""
    return min(int((where & (stack.way == d)).sum()) for d in np.unique(stack.way[where]))


def _quantile(freedom: float, probability: float) -> float:
    """Return the quantile of Student's t."""
    from scipy.special import stdtrit

    return float(stdtrit(freedom, probability))


def _slope_quantile(n_runs: int) -> float:
    return _quantile(n_runs - 1, _CONFIDENCE) if n_runs > 1 else _NORMAL


def _inside(scatter: FloatArray, c: FloatArray, way: FloatArray, where: BoolArray) -> float:
    """Return (12): the variance of <d c~> from the autocovariance inside the runs, by direction."""
    total = 0.0
    for direction in np.unique(way[where]):
        part = where & (way == direction)
        n = int(part.sum())
        lags = max(2, n // 4)
        weight = np.maximum(1.0 - np.arange(n) / lags, 0.0)
        covariance = _lagged(scatter[:, part]).mean(axis=0) / n * weight
        products = _lagged(c[part])
        first = float(covariance[0] * products[0])
        total += max(first + 2.0 * float((covariance[1:] * products[1:]).sum()), first)
    return total / int(where.sum()) ** 2


def _inside_area(scatter: FloatArray, c: FloatArray, nodes: BoolArray) -> float:
    """Return (12) of a map: lags along both axes, to a quarter of the nodes of each."""
    size = [1 << (2 * n - 1).bit_length() for n in nodes.shape]

    def lagged(values: FloatArray) -> FloatArray:
        grid = np.zeros(nodes.shape)
        grid[nodes] = values
        return np.asarray(np.fft.irfft2(np.abs(np.fft.rfft2(grid, size)) ** 2, size))

    fading = []
    for n, long in zip(nodes.shape, size, strict=True):
        lag = np.minimum(np.arange(long), long - np.arange(long))  # negative lags stand at the end
        fading.append(np.maximum(1.0 - lag / max(2, n // 4), 0.0))
    products = lagged(scatter) / c.size * lagged(c)
    total = float((products * np.multiply.outer(*fading)).sum())
    return max(total, float(products[0, 0])) / c.size**2


def _lagged(values: FloatArray) -> FloatArray:
    """Return sum_i v(i) v(i + j) for j = 0 ... n - 1, along the last axis."""
    n = values.shape[-1]
    size = 1 << (2 * n - 1).bit_length()
    spectrum = np.fft.rfft(values, size)
    return np.asarray(np.fft.irfft(np.abs(spectrum) ** 2, size)[..., :n])


def centre(runs: FloatArray) -> FloatArray:
    """Return the median over runs from three on, their mean below."""
    over = np.median(runs, axis=0) if len(runs) >= _FEWEST_RUNS else runs.mean(axis=0)
    return np.asarray(over)


@dataclass(frozen=True, slots=True)
class _Peaks:
    before: float
    after: float
    plain: float
    noise: float
    contrast: float


def _peaks(stack: Stack, gain: float) -> _Peaks:
    """Return P-V before and after (1.6), and that of the noise alone (16), (17)."""
    n, middle = stack.n_runs, centre(stack.rest)
    level = middle
    if stack.has_slope and not stack.is_stated:
        line = stack.line
        slope = float((middle * line).mean())
        chance = abs(slope) if n == 1 and stack.u_slope is None else _slope_chance(stack)
        level = middle - math.copysign(min(abs(slope), chance), slope) * line
    if stack.is_stated:
        noise = contrast = 0.0
    elif n == 1:
        noise = contrast = float(np.ptp(_rest_of_one(stack, gain)))
    else:
        contrast = _contrast(stack)
        noise = contrast * (_MEDIAN if n >= _FEWEST_RUNS else 1.0) / math.sqrt(n)
        noise *= math.sqrt(1.0 + (1.0 / (n - 1) if stack.is_left_out else 0.0))
    return _Peaks(
        float(np.ptp(centre(stack.known))),
        pv_with_zero(level, stack.zero),
        pv_with_zero(middle, stack.zero),
        noise,
        contrast,
    )


def pv_with_zero(rest: FloatArray, zero: float) -> float:
    """P-V of what stays with the zero that the table moves: the value 0 belongs to the set then."""
    return float(np.ptp(rest) if zero == 0.0 else np.ptp(np.append(rest + zero, 0.0)))


def _slope_chance(stack: Stack) -> float:
    """Return the slope (RMS over the travel, m) that chance explains."""
    n = stack.n_runs
    if n == 1:
        return _NORMAL * float(stack.x.std()) * (stack.u_slope or 0.0)
    slopes = (stack.known * stack.line).mean(axis=1)
    factor = math.sqrt(2.0) if stack.is_left_out else 1.0
    return _MEDIAN * _slope_quantile(n) * float(slopes.std(ddof=1)) / math.sqrt(n) * factor


def _noise(stack: Stack) -> tuple[FloatArray, float]:
    """Return z_k = a_k - centre and its robust standard deviation."""
    n = stack.n_runs
    z = stack.known - centre(stack.known)
    return z, 1.4826 * float(np.median(np.abs(z))) * math.sqrt(n / (n - 1))


def _contrast(stack: Stack) -> float:
    """Return (16): the median P-V of Helmert contrasts of the runs, each of the noise of one run."""
    z, s = _noise(stack)
    n = stack.n_runs
    if stack.made_it:  # a spike of these runs stands in the table: it must not raise the floor too
        z = np.clip(z, -4.0 * s, 4.0 * s)
    found = []
    for j in range(1, n):
        h = np.r_[np.ones(j), -float(j), np.zeros(n - j - 1)] / math.sqrt(j * (j + 1))
        found.append(float(np.ptp(h @ z)))
    return float(np.median(found))


def rising(before: float, after: float, noise: float = 0.0) -> bool:
    """Return whether a P-V rises beyond noise (18); P-V need not shrink: small ones are noise."""
    return after > _RISE * before and after > _RISE_NOISE * noise


def _rms(stack: Stack, square: float) -> str:
    return stack.units.amount(math.sqrt(max(square, 0.0)))


def _refusals(stack: Stack, improved: Improvement, pv: _Peaks) -> list[Reason]:
    found = []
    before = float((stack.known**2).mean())
    after = float((stack.rest**2).mean()) + stack.zero**2
    if improved.is_worse:
        moved = (
            ""
            if stack.zero == 0.0
            else f", the zero of the machine moves by {stack.units.amount(stack.zero)}"
        )
        found.append(
            f"the error is larger with the table than without it: RMS {_rms(stack, before)} -> "
            f"{_rms(stack, after)}{moved}"
        )
    if rising(pv.before, pv.after, pv.noise):
        found.append(
            f"the P-V rises from {stack.units.amount(pv.before)} to {stack.units.amount(pv.after)}, noise alone "
            f"{stack.units.amount(pv.noise)}: somewhere the table adds what is not there"
        )
    found += _directions(stack)
    return [Reason("refused", "dry-run", text) for text in found] + _spike(stack, pv)


def _directions(stack: Stack) -> Iterator[str]:
    """Return the directions that get worse, and lost motion that grows (21)."""
    ways = [d for d in (1.0, -1.0) if (stack.way == d).any()]
    if len(ways) < 2:
        return
    for d in ways:
        if _improvement(stack, stack.way == d).is_worse:
            name = "forward" if d > 0 else "reverse"
            yield f"the {name} direction gets worse"
    step, change, margin = lost_motion_change(stack)
    if abs(step) > ROUNDING and change + margin < 0.0:
        yield (
            f"the table makes the lost motion (reverse minus forward) larger, its step is {stack.units.amount(step)}: "
            "check the sign of the reverse column"
        )


def lost_motion_change(stack: Stack) -> tuple[float, float, float]:
    """Return the step h of the table, D_B of (21) in m^2 and its margin t u."""
    ahead, back = stack.way > 0, stack.way < 0
    b = stack.known[:, back].mean(axis=1) - stack.known[:, ahead].mean(axis=1)
    h = stack.steps
    change = float((-2.0 * b * h - h**2).mean())
    n, step = b.size, float(h.mean())
    if stack.is_stated or n < 2:
        return step, change, 0.0
    u = 2.0 * abs(step) * float(b.std(ddof=1)) / math.sqrt(n)
    return step, change, float(_quantile(n - 1, _CONFIDENCE)) * u


def _spike(stack: Stack, pv: _Peaks) -> list[Reason]:
    """Return (19): a reading that one run alone has, and that the table holds the n-th part of."""
    n = stack.n_runs
    if n < _FEWEST_RUNS or not stack.made_it:
        return []
    z, s = _noise(stack)
    size = np.abs(z)
    high = (size > _SPIKE * s) & (size / n > _SPIKE_SHARE * pv.before)
    if not high.any():
        return []
    k, i = np.unravel_index(int(np.argmax(np.where(high, size, 0.0))), size.shape)
    return [
        Reason(
            "refused",
            "spike",
            f"run {stack.names[int(k)]} has a spike of {stack.units.amount(float(z[k, i]))} at "
            f"{stack.units.place(float(stack.x[i]), digits=6)} that no other run has, which puts "
            f"{stack.units.amount(float(size[k, i]) / n)} into the table of the mean: "
            + (
                "leave that cycle out"
                if stack.is_list
                else "leave the run out, or separate with robust=true"
            ),
        )
    ]


def _uncertain(
    stack: Stack, improved: Improvement, energy: float, rest: float, pv: _Peaks
) -> list[Reason]:
    d, margin, n = improved.value, improved.t * improved.u, stack.n_runs
    found: list[tuple[str, str]] = []

    def add(text: str, check: str = "inconclusive") -> None:
        found.append((check, text))

    if stack.made_it and n < _FEWEST_RUNS and not stack.is_stated:
        many = "one run" if n == 1 else f"{n} runs"
        add(
            f"{many} made the table and no other shows it: what repeats is not known; take at least "
            f"{_FEWEST_RUNS} runs (5 are better), or verify against runs that did not make it",
            "single" if n == 1 else "inconclusive",
        )
    elif stack.made_it and not stack.is_left_out and not stack.is_stated:
        add(
            "the runs made the table, and it cannot be made again without each of them"
            f"{f' ({stack.why})' if stack.why else ''}: verify against runs that did not make it"
        )
    if energy == 0.0 or not stack.applied.any():
        return [Reason("inconclusive", check, text) for check, text in found]
    positions = _fewest(stack, np.ones(stack.x.size, dtype=bool))
    if positions < _FEWEST_LAGS and n < _FEWEST_RUNS and not stack.is_stated:
        add(
            f"{positions} positions show no scatter inside a run: compare at {_FEWEST_LAGS} or more, or "
            f"measure {_FEWEST_RUNS} runs"
        )
    if d - margin <= 0.0 and not (stack.is_stated and d == margin == 0.0):
        way = (
            "its slope may be that of the temperature, which is not known well enough, and more runs do "
            "not show it: measure the temperature better (u_temperature, u_expansion)"
            if 0.0 < d <= improved.shared
            else f"about {math.ceil(n * ((margin - improved.shared) / (d - improved.shared)) ** 2)} runs "
            "would show it"
            if d > improved.shared
            else f"noise hides errors below {_rms(stack, margin)}"
        )
        add(f"the readings do not show that the table helps: {way}")
    elif rest > ENOUGH and math.sqrt(max(energy - d - margin, 0.0) / energy) <= ENOUGH:
        add(
            "the readings do not show whether the table removes 30 % of the RMS: measure more runs"
        )
    if n == 1 and not stack.is_stated:
        whole = float((stack.known**2).mean())
        cautious = math.sqrt(max(1.0 - d / whole, 0.0)) if whole > 0.0 else math.inf
        if rest <= ENOUGH < cautious:
            what = "run" if stack.nodes is None else "map"
            add(
                f"one {what} does not show whether what stays is noise or error: measure more {what}s"
            )
        if stack.has_slope and stack.u_slope is None:
            add(
                "one run of positioning does not show its slope, and its uncertainty is not stated: "
                "measure more runs"
            )
    if stack.is_left_out and pv.contrast / math.sqrt(n) > _NOISY * pv.before:
        add(
            f"the table would hold more noise than error: P-V of the noise in the mean "
            f"{stack.units.amount(pv.contrast / math.sqrt(n))}, of the error {stack.units.amount(pv.before)}; measure more runs"
        )
    return [Reason("inconclusive", check, text) for check, text in found]


def _pointless(energy: float, rest: float, energy_c: float) -> list[Reason]:
    if energy == 0.0 or energy_c == 0.0:
        what = "no error repeats" if energy == 0.0 else "all corrections are zero or equal"
        return [Reason("pointless", "pointless", f"{what}: there is nothing to correct")]
    if rest <= ENOUGH:
        return []
    return [
        Reason(
            "pointless",
            "pointless",
            f"{100.0 * min(rest, 9.99):.3g} % of the RMS that repeats would stay: less than 30 % goes",
        )
    ]


def _regions(stack: Stack) -> Iterator[str]:
    """Return the windows, eight over the span, that get worse with 99.9 % confidence."""
    edges = np.linspace(float(stack.x.min()), float(stack.x.max()), _WINDOWS + 1)
    for low, high in pairwise(edges):
        where = (stack.x >= low) & (stack.x <= high)
        if int(where.sum()) < _FEWEST_LAGS:
            continue
        part = _improvement(stack, where)
        if part.value + part.strict * part.u < 0.0:
            before = float((stack.known[:, where] ** 2).mean())
            after = float((stack.rest[:, where] ** 2).mean()) + stack.zero**2
            yield (
                f"between {stack.units.place(float(low))} and {stack.units.place(float(high))} the table makes it "
                "worse: RMS "
                f"{_rms(stack, before)} -> {_rms(stack, after)}"
            )


def outside_is_worse(stack: Stack) -> tuple[str, bool]:
    """Return what gets worse where the runs reach beyond the table, and whether by more than 5 %."""
    if not _improvement(stack, np.ones(stack.x.size, dtype=bool)).is_worse:
        return "", False
    before = float((stack.known**2).mean())
    after = float((stack.rest**2).mean()) + stack.zero**2
    return f"RMS {_rms(stack, before)} -> {_rms(stack, after)}", after > _RISE**2 * before


def graded(reasons: Sequence[Reason]) -> str:
    """Return the grade that reasons leave: the gravest first."""
    grades = {r.grade for r in reasons}
    return next((g for g in ("refused", "inconclusive", "pointless") if g in grades), "accepted")


class Judged(Stated):
    """What a dry-run found of a table or a map: the reasons not to accept it, and the grade they give."""

    __slots__ = ()

    judgement: Judgement

    if TYPE_CHECKING:  # a field of one class, a property of the other

        @property
        def reasons(self) -> tuple[Reason, ...]: ...

    @property
    def gain(self) -> float:
        """Share of the corrections that the readings confirm: 1 right, 0 nothing, below 0 the wrong way."""
        return self.judgement.gain

    @property
    def rest(self) -> float:
        """RMS that stays over RMS that was, of what repeats; infinite where there was no error."""
        return self.judgement.rest

    @property
    def grade(self) -> str:
        """``"accepted"``, ``"pointless"``, ``"inconclusive"`` (of tables) or ``"refused"``."""
        return graded(self.reasons)

    @property
    def passed(self) -> bool:
        """Whether the grade is accepted: the machine is better with the corrections than without."""
        return not self.reasons

    def _verdict(self) -> dict[str, Any]:
        """Return grade and reasons as plain values."""
        reasons = [{"grade": r.grade, "check": r.check, "text": r.text} for r in self.reasons]
        return {"grade": self.grade, "passed": self.passed, "reasons": reasons}

    def _graded_text(self) -> str:
        """Return the grade with its reasons."""
        why = "; ".join(r.text for r in self.reasons if r.grade == self.grade)
        return f"{self.grade}: {why}" if why else self.grade

    def require(
        self, what: str, *, waived: Collection[str] = (), only_refused: bool = False
    ) -> None:
        """Refuse what is not accepted.

        Parameters
        ----------
        what : str
            Name of the table or map for the message.
        waived : collection of str, optional
            Checks whose refusal the user accepts: "coverage", "spike", "single", "inconclusive",
            "pointless". What makes the machine worse cannot be waived.
        only_refused : bool, optional
            Whether the other grades pass.

        Raises
        ------
        SignCheckFailedError
            If it is refused.
        InconclusiveTableError
            If the readings do not show that it helps.
        PointlessTableError
            If less than 30 % of the RMS goes.
        """
        left = [r for r in self.reasons if r.check not in waived or r.check == "dry-run"]
        grade = graded(left)
        if grade == "accepted" or (only_refused and grade != "refused"):
            return
        raise _REFUSALS[grade](f"{what}: {self._refusal(grade, left)}")

    def _refusal(self, grade: str, left: list[Reason]) -> str:
        """Return the sentence of a refusal."""
        raise NotImplementedError


_REFUSALS = {
    "refused": SignCheckFailedError,
    "inconclusive": InconclusiveTableError,
    "pointless": PointlessTableError,
}
