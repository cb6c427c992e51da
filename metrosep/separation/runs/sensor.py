"""Private to separation: delay and time constant of the reading, tested in every fit.

A late reading shows the error of the place x - v l. What is found is neither switched on nor off:
the solutions with and without it are averaged by their probabilities, since a lag just below any
threshold would be in the estimate and not in its band. A machine that has a lag has one of a Cauchy
distribution of half width `LAG_PRIOR`: a lag that is hardly known is drawn to none, a long one that
is seen stays as it is. Equation numbers: separation-2.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np

from metrosep.core._arrays import FloatArray
from metrosep.separation.runs.geometry import Sensor, filtered
from metrosep.separation.runs.posterior import PLACED, Answer, Model

LAG_CHI2 = 12.0
"""Square of a lag over its uncertainty from which it is named: 5 in 10,000 by chance."""

LAG_PRIOR = 1e-3
"""Half width in s of the distribution of lags, Cauchy's: half of the machines that have one have less.
A normal one of this width takes a lag of 9 ms that is seen for as unlikely as none."""

_STEPS = 3

_SHARES = (0.0, 0.25, 0.5, 0.75, 1.0, 1.25)
"""Time constants over the lag that are averaged over: from a pure delay to more than first order."""

_SCAN = np.arange(-50e-3, 51e-3, 2e-3)
_SCANNED = 40
"""Lags in s that are looked at where a lag is to be found in any case, and harmonics used for it."""


@dataclass(frozen=True, slots=True, eq=False)
class LagScore:
    """Score and information of a change of lag and spread at a solution (eq. 14)."""

    score: FloatArray  # shape (2,): at the mean
    information: FloatArray  # shape (2, 2)
    change: FloatArray  # shape (N, 2): minus the change of the solution with each
    trace: FloatArray  # shape (2,): what the spread about the mean takes from the score
    displaced: float = 0.0  # s^2: variance of the lag because the runs are displaced
    prior: float = 0.0  # s: half width of the distribution of the lag before; 0: any

    @property
    def lag(self) -> float:
        """Step of the lag alone, s."""
        return float(self.score[0] / self.information[0, 0])

    @property
    def own(self) -> float:
        """Variance of the lag with the runs where they are, s^2."""
        return 1.0 / float(self.information[0, 0])

    @property
    def u(self) -> float:
        """Standard uncertainty of the lag, s."""
        return math.sqrt(self.own + self.displaced)

    def hidden(self, lag: float) -> bool:
        """Return whether nothing is known of a lag, beside one that is corrected already."""
        return self.u > LAG_PRIOR and (lag + self.lag) ** 2 <= LAG_CHI2 * self.u**2

    @property
    def gradient(self) -> FloatArray:
        """Derivative of ln evidence with lag and spread, the spectrum held; shape (2,)."""
        return self.score - self.trace

    def step(self, lag: float) -> FloatArray:
        """Return the step of lag and spread from a lag; its prior and displaced runs are counted."""
        step = np.linalg.solve(self.information, self.gradient)
        spread = np.linalg.inv(self.information)
        variance = float(spread[0, 0]) + self.displaced
        back = likely_lag(lag + float(step[0]), variance, self.prior)[0] - lag - float(step[0])
        return np.asarray(step + back * (spread[:, 0] + [self.displaced, 0.0]) / variance)

    def along(self, direction: FloatArray) -> tuple[float, float, FloatArray]:
        """Return step and own variance of a lag with which both move so, and minus the change with it."""
        information = float(direction @ self.information @ direction)
        return (
            float(direction @ self.gradient) / information,
            1.0 / information,
            self.change @ direction,
        )


_REACH, _POINTS = 8.0, 401
"""Standard uncertainties about a lag that is read, and places there, over which its mean is taken."""


def likely_lag(read: float, variance: float, prior: float) -> tuple[float, float]:
    """Return mean and variance of a lag that is read, drawn from a Cauchy distribution; 0: as read."""
    if not prior:
        return read, variance
    at = read + math.sqrt(variance) * np.linspace(-_REACH, _REACH, _POINTS)
    weight = np.exp(-0.5 * (at - read) ** 2 / variance) / (prior**2 + at**2)
    weight /= weight.sum()
    mean = float(weight @ at)
    return mean, float(weight @ (at - mean) ** 2)


def lag_score(model: Model) -> LagScore | None:
    """Return score and information of the lag (eqs. 14, 20); None where one feedrate shows nothing."""
    assert model.post is not None  # noqa: S101  (after a solution)
    theta, n = model.post.theta, model.extension.n
    score, own, trace = np.zeros(2), np.zeros((2, 2)), np.zeros(2)
    cross = np.zeros((theta.size, 2))
    covariance = model.post.covariance()
    a, b = slice(1, 1 + n), slice(1 + n, 1 + 2 * n)
    for run in model.by_speed:
        columns = np.zeros((theta.size, 2))
        # E[D(theta)'(h - G theta)] is its value at the mean less tr(D C G); D is 2 by 2 for each k.
        pairs = {
            (i, j): np.einsum("kj,kj->k", covariance[rows], run.gram[others])
            for i, rows in enumerate((a, b))
            for j, others in enumerate((a, b))
        }
        for j, factor in enumerate(
            model.sensor.log_changes(model.extension.wavenumbers, run.velocity)
        ):
            moved = filtered(theta, factor)
            columns[1 : 1 + 2 * n, j] = moved[1 : 1 + 2 * n]
            trace[j] += float(factor.real @ (pairs[0, 0] + pairs[1, 1]))
            trace[j] += float(factor.imag @ (pairs[1, 0] - pairs[0, 1]))
        along = run.gram @ columns
        score += columns.T @ (run.right - run.gram @ theta)
        own += columns.T @ along
        cross += along
    root = model.post.full_root
    held = root.T @ cross
    information = own - held.T @ held
    if information[0, 0] <= 1e-9 * own[0, 0] or not own[0, 0] > 0.0:
        return None
    # The split into delay and time constant may not be seen at all.
    information[1, 1] = max(information[1, 1], 1e-12 * own[1, 1])
    return LagScore(score, information, root @ held, trace, model.lag_variance, model.lag_prior)


def lag_steps(model: Model, *, sure: bool = False) -> None:
    """Correct lag and spread by Gauss-Newton steps, the spectrum learnt between them (eq. 21)."""
    at = lag_score(model)
    if at is None or (at.hidden(model.sensor.lag) and not sure):
        return
    for i in range(_STEPS):
        at = lag_score(model) if i else at
        if at is None:
            return
        step = at.step(model.sensor.lag)
        spread = model.sensor.spread + float(step[1])
        if spread < 0.0:
            # on the boundary the lag moves by its own row, given that the spread becomes 0
            moved = -model.sensor.spread
            lag = float((at.gradient[0] - at.information[0, 1] * moved) / at.information[0, 0])
            spread = 0.0
        else:
            lag = float(step[0])
        lag = float(np.clip(lag, -20.0 * LAG_PRIOR, 20.0 * LAG_PRIOR))
        before = model.sensor
        model.sensor = Sensor(before.lag + lag, spread)
        model.apply()
        model.learn(2)
        if abs(lag) < 0.02 * at.u and abs(math.sqrt(spread) - math.sqrt(before.spread)) < 1e-5:
            return


def better_split(model: Model) -> None:
    """Try the other end of the split into delay and time constant: each may be a top of its own."""
    found, at = model.state(), lag_score(model)
    if at is None or model.sensor.lag**2 < LAG_CHI2 * at.u**2:
        return
    evidence = model.log_evidence(model.solve())
    lag = model.sensor.lag
    delay_only = model.sensor.spread < 0.25 * lag**2
    model.sensor = Sensor(lag, lag**2 if delay_only else 0.0)
    model.apply()
    model.learn(2)
    lag_steps(model, sure=True)
    if model.log_evidence(model.solve()) < evidence:
        model.back_to(found)
        model.solve()


def scan_lag(model: Model) -> None:
    """Start from the lag of greatest evidence within +-50 ms: a long one is beyond any small step."""
    start, kept = model.state(), model.kept
    model.kept = min(kept, _SCANNED)  # long waves have one top each
    best = (-math.inf, start[0])
    for lag in _SCAN:
        model.sensor = Sensor(float(lag), 0.0)
        model.apply()
        best = max(best, (model.log_evidence(model.solve()), model.sensor), key=lambda b: b[0])
    model.kept = kept
    model.back_to((best[1], *start[1:]))
    model.learn(3, above=0.5)


def chance_of_lag(
    lag: float,
    own: float,
    gain: float = math.inf,
    displaced: tuple[FloatArray, FloatArray] = PLACED,
) -> float:
    """Return the probability of a lag, Cauchy's of half width LAG_PRIOR, against none, as likely before.

    `own` is the variance of the lag that is read with the runs where they are, s^2. `gain` is by how
    much ln evidence is greater with it; where the evidence is a parabola it is lag^2 / (2 u^2), which
    it is not allowed to exceed. Where the runs lie apart by a size that is not known well, the variance
    u^2 has as many values as that size, each with its chance.
    """
    variances, chances = displaced
    alone = own + variances
    none = -0.5 * np.log(2.0 * math.pi * alone) - np.minimum(gain, 0.5 * lag**2 / alone)
    odds = _log_mean(chances, _log_of_some(lag, alone)) - _log_mean(chances, none)
    return 1.0 / (1.0 + math.exp(min(-odds, 700.0)))


def _log_of_some(lag: float, variance: FloatArray | float) -> FloatArray:
    """Return ln of the density of a lag that is read, in 1/s, where there is one."""
    from scipy.special import voigt_profile

    u = np.sqrt(variance)
    return np.asarray(np.log(voigt_profile(lag / LAG_PRIOR, u / LAG_PRIOR, 1.0) / LAG_PRIOR))


def _log_mean(chances: FloatArray, logs: FloatArray) -> float:
    top = float(logs.max())
    return top + math.log(float(chances @ np.exp(logs - top)))


@dataclass(frozen=True, slots=True, eq=False)
class Split:
    """Solution with one share of the time constant in the lag."""

    weight: float
    lag: float  # s: mean and its variance in s^2, the prior counted
    variance: float
    read: float  # s: as read, and its variance in s^2 with the runs where they are, for this share
    own: float
    gain: float  # of ln evidence from the lag to the one that is read
    answer: Answer  # its covariance with what the lag leaves open (eq. 23)


def splits(model: Model) -> list[Split]:
    """Return solutions along the split of the lag into delay and time constant, and their chances.

    With the share of the time constant the best lag moves, and where short waves are strong the
    evidence is not a parabola along that line: so it is not one top with a covariance, but a mean over
    shares that are as likely before. The model is left at the likeliest.
    """
    top = lag_score(model)
    sure = top is not None and model.sensor.lag**2 > LAG_CHI2 * top.u**2
    start, parts, states = model.state(), [], []
    for share in _SHARES if sure else _SHARES[::2]:
        model.back_to(start)
        _settle(model, share)
        answer, lag = model.answer(), model.sensor.lag
        part = Split(answer.evidence, lag, math.inf, lag, math.inf, 0.0, answer)
        at = lag_score(model)
        if at is not None:
            step, own, change = at.along(_held(lag, share))
            whole, read = own + at.displaced, lag + step
            _, variance = likely_lag(read, whole, at.prior)
            more = np.outer(change, change) * variance
            gain = 0.5 * step**2 / own
            weight = answer.evidence + gain + 0.5 * math.log(whole)
            if at.prior:
                weight += float(_log_of_some(read, whole))
            answer = replace(answer, covariance=answer.covariance + more)
            part = Split(weight, lag, variance, read, own, gain, answer)
        parts.append(part)
        states.append(model.state())
    logs = np.array([p.weight for p in parts])
    chances = np.exp(logs - logs.max())
    chances /= chances.sum()
    model.back_to(states[int(np.argmax(chances))])
    model.solve()
    return [replace(p, weight=float(c)) for c, p in zip(chances, parts, strict=True)]


def _held(lag: float, share: float) -> FloatArray:
    """Return how lag and spread move together where the time constant is a share of the lag."""
    return np.array([1.0, 2.0 * share**2 * lag])


def _settle(model: Model, share: float) -> None:
    """Give the sensor a share of time constant and find the lag that goes with it."""
    lag = model.sensor.lag
    for i in range(1 + _STEPS):
        model.sensor = Sensor(lag, (share * lag) ** 2)
        model.apply()
        model.learn(1 if i else 2)
        at = lag_score(model)
        if at is None or i == _STEPS:
            return
        read, own, _ = at.along(_held(lag, share))
        mean, variance = likely_lag(lag + read, own + at.displaced, at.prior)
        step = mean - lag
        if step**2 < 0.05**2 * variance:
            return
        lag += float(np.clip(step, -LAG_PRIOR, LAG_PRIOR))
