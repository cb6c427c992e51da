r"""Generalised least squares of all runs together: spatial Fourier basis, noise correlated in time.

Model, for reading i of run r with signed velocity v_r:

.. math:: z_r(t_i) = c_r + s\,x + \sum_k a_k \cos + b_k \sin (2 \pi k \tilde x / L_x) + n_r(t_i),
          \quad \tilde x = x_{enc} - v_r \tau

with :math:`L_x` 1.25 times the travel (the error need not be periodic over the travel), n an
autoregressive process in time that all runs of one sampling interval share, and the prior of
`metrosep.separation.shrinkage` on the pairs (a_k, b_k). Geometry is what sits at the same place
whatever the feedrate; noise is what sits at the same frequency.

Options add drift, lines, a part that grows with the feedrate, gains of probes and weights
(`metrosep.separation.terms`, `unknowns`, `weights`); without them nothing of this changes.

Everything here is dimensionless: heights over their RMS, positions over half the travel.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Literal

import numpy as np

from metrosep.core.blas import one_blas_thread
from metrosep.separation._joint_probe_test import ProbeDifference, probe_differences
from metrosep.separation._joint_solution import (
    LagTest,
    Solution,
    considered_amplitudes,
    make_solution,
)
from metrosep.separation._solver_state import INNER, SolverState, first_state, iterate
from metrosep.separation._solver_terms import (
    choose_waves,
    find_lines,
    fit_unknowns,
    place_lines,
    state_terms,
    wanted_unknowns,
)
from metrosep.separation.design import PreparedRun
from metrosep.separation.feed_test import lag_score, square_of_feed_score
from metrosep.separation.options import JointOptions
from metrosep.separation.shrinkage import PriorWeights
from metrosep.separation.system import System
from metrosep.separation.terms import Terms

__all__ = ["Solution", "solve_joint"]

LAG_CHI2 = 12.0
"""Square of a lag over its uncertainty from which it is named and fitted: 5 in 10,000 by chance."""

LAG_PRIOR = 1e-3
"""Standard deviation in s of the lag of a machine that has one."""

AR_ORDERS = (1, 2, 4, 6, 8, 12, 16, 24, 32, 48)
"""Candidate orders of the noise model."""

_FIRST_INNER = 6

_WHITE_ROUNDS = 5
"""Rounds in which the noise is taken for white and its size is learnt."""


def _chosen_harmonics(weights: PriorWeights) -> int:
    """Return the number of harmonics of greatest evidence, with a margin of a tenth."""
    evidence = np.cumsum(weights.log_bayes_factor)
    best = int(np.argmax(evidence)) + 1 if evidence.max() > 0.0 else 1
    return min(max(best + max(2, best // 10), 8), evidence.size)


def _white_rounds(system: System, state: SolverState) -> None:
    """Learn how large the noise is before a model learns its colour.

    The first variance is a guess of half the spread of the readings. Where the noise is far below
    it, geometry is damped at first, and a model of high order would take what is left of it for
    noise of that colour: errors of tens of nm beside an uncertainty ten times too small.
    """
    for _ in range(_WHITE_ROUNDS):
        system.update_noise(state.freedom, (0,))
        iterate(system, state, _FIRST_INNER, learn_from=0)


def solve_joint(
    runs: Sequence[PreparedRun],
    *,
    origin: float,
    period: float,
    n_harmonics: int,
    choose_shortest: bool,
    lag: float,
    lag_mode: Literal["stated", "auto", "fit"],
    orders: Sequence[int] = AR_ORDERS,
    options: JointOptions | None = None,
    several_feeds: bool = True,
) -> Solution:
    """Estimate geometry, noise and prior from all runs together."""
    options = options or JointOptions()
    with one_blas_thread():
        terms = Terms(
            runs,
            drift=options.drift,
            locked=options.line_phase == "locked",
            several_feeds=several_feeds,
        )
        system = System(
            runs,
            origin=origin,
            period=period,
            n_harmonics=n_harmonics,
            terms=terms,
            robust=options.robust,
        )
        system.lag = lag
        state_terms(system, options)
        state = first_state(n_harmonics)
        iterate(system, state, _FIRST_INNER, learn_from=3)
        while system.mark_again():  # before a noise model can take what is wrong for noise
            state = first_state(n_harmonics)
            iterate(system, state, _FIRST_INNER, learn_from=3)
        if options.lines and options.lines != "auto":
            place_lines(system, options.lines)
            iterate(system, state, _FIRST_INNER, learn_from=3)
        if several_feeds:
            _white_rounds(system, state)
        system.update_noise(state.freedom, orders)
        iterate(system, state, INNER, learn_from=0)
        found = find_lines(system, state, options, orders)
        choose_waves(system, state, options, orders)
        considered = considered_amplitudes(system, state)
        if choose_shortest:
            _drop_short(system, state)
        for _ in range(4 if options.robust else 2):
            system.update_noise(state.freedom, orders)
            iterate(system, state, INNER, learn_from=0)
        lag_test = None
        if several_feeds and lag_mode != "fit" and options.following != "waves":
            lag_test = _tested_lag(system, state, correct=lag_mode == "auto")
        fit_lag = lag_mode == "fit" or (lag_test is not None and lag_test.fitted)
        fit_unknowns(system, state, wanted_unknowns(system, options, fit_lag), orders)
        if lag_test is not None and lag_mode == "auto" and not lag_test.fitted:
            _average_over_lag(system, state, lag_test)
        assert state.covariance is not None  # noqa: S101  (set by iterate)
        test = None
        if options.following in ("scale", "waves"):
            test = square_of_feed_score(system, state.covariance, kind=options.following)
        differences: tuple[ProbeDifference, ...] = ()
        if options.probe_gain == "equal":
            differences = probe_differences(system, state.covariance)
        return make_solution(system, state, considered, found, test, differences, lag_test)


def _tested_lag(system: System, state: SolverState, *, correct: bool) -> LagTest | None:
    """Return what the readings say of a lag beside the one at hand."""
    assert state.covariance is not None  # noqa: S101  (set by iterate)
    found = lag_score(system, state.covariance)
    if found is None:
        return None
    lag, u, _ = found
    sure = lag**2 > LAG_CHI2 * u**2 and u < LAG_PRIOR
    return LagTest(lag, u, _chance_of_lag(lag, u), fitted=correct and sure)


def _chance_of_lag(lag: float, u: float) -> float:
    """Return the probability of a lag N(0, LAG_PRIOR^2) against none, both as likely before."""
    both = u**2 + LAG_PRIOR**2
    odds = 0.5 * np.log(u**2 / both) + 0.5 * lag**2 * LAG_PRIOR**2 / (u**2 * both)
    return float(1.0 / (1.0 + np.exp(-odds)))


def _average_over_lag(system: System, state: SolverState, test: LagTest) -> None:
    """Take the mean of the solutions without and with the lag, weighted by their probabilities.

    A threshold would leave a lag just below it in the estimate and out of its uncertainty. The
    solution with the lag is the present one plus lag times its change, so the mean moves by
    p lag and its variance grows by p/I + p (1 - p) lag^2 along that change.
    """
    assert state.covariance is not None  # noqa: S101  (set by iterate)
    found = lag_score(system, state.covariance)
    if found is None or test.u > LAG_PRIOR:  # then nothing is known of a lag
        return
    lag, u, change = found
    p = _chance_of_lag(lag, u)
    system.solution = system.solution + p * lag * change
    variance = p * u**2 + p * (1.0 - p) * lag**2
    state.covariance = state.covariance + variance * np.outer(change, change)


def _drop_short(system: System, state: SolverState) -> None:
    kept = _chosen_harmonics(state.weights)
    system.truncate(kept)
    state.prior.truncate(kept)
    state.weights = PriorWeights(
        state.weights.tau2[:kept],
        state.weights.log_bayes_factor[:kept],
        (
            state.weights.spread[0][:kept],
            state.weights.spread[1][:kept],
            state.weights.spread[2][:kept],
        ),
    )
