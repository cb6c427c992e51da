"""`plan_feedrates`: at which feeds to run an axis so that every wavelength becomes well known.

A geometric error of wavelength L read at feed v is a tone of v / L; a vibration keeps its
frequency. A feed that puts a wave onto a vibration learns nothing about that wave, so the plan
maximises the information on the worst wavelength. Units are SI; columns and messages carry theirs.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from metrosep.core._arrays import FloatArray
from metrosep.core.errors import DataError, NotSeparableError, TooFewSamplesError
from metrosep.separation.noise_density import TimeDensity, time_density
from metrosep.separation.planner_checks import (
    LONG_WAVE,
    checked_feeds,
    checked_wavelengths,
    positive,
)
from metrosep.separation.planner_model import finite_variance, run_information
from metrosep.separation.planner_result import FeedPlan
from metrosep.separation.planner_search import Limits, best_feeds
from metrosep.separation.planner_words import collisions, peaks, plain_messages

__all__ = ["plan_feedrates", "predicted_sd"]


_WAVES_IN_TRAVEL = 2.0
"""Travel of a run over the longest wavelength where the user gives no length: with fewer than two
waves the offset of the run and the wave are hard to tell apart."""

_LEAST_RATIO = 1.1
"""Closer feeds see a resonance of a few per cent damping at the same wavelength."""


def plan_feedrates(
    psd: Any,
    wavelengths: ArrayLike | tuple[float, float],
    v_min: float,
    v_max: float,
    n_runs: int,
    *,
    length: float | None = None,
    settle_distance: float = 0.0,
    max_time: float | None = None,
    min_ratio: float = _LEAST_RATIO,
    fixed: ArrayLike = (),
    psd_feed: float | None = None,
) -> FeedPlan:
    """Return the feeds that make the least known of the wavelengths known best.

    Parameters
    ----------
    psd : DataFrame, (f, S), callable or Psd
        One-sided density of the disturbance over time: ``estimate.residual_psd``; samples in Hz
        and m^2/Hz; a function S(f); or a `Psd` computed over time (or over position, with
        `psd_feed`).
    wavelengths : array_like, shape (k,), or (shortest, longest), m
        Waves that matter. A tuple of two is the limits of a range, of which 121 are taken.
    v_min, v_max : float, m/s
        Range of feeds of the machine.
    n_runs : int
        Number of runs to plan.
    length : float, m, optional
        Travel of each run; twice the longest wavelength if omitted.
    settle_distance : float, m, optional
        Part of it that is lost while the axis settles.
    max_time : float, s, optional
        Limit on the sum of length / feed of the new runs.
    min_ratio : float, > 1, optional
        Two feeds are equal or at least this ratio apart.
    fixed : array_like, m/s, optional
        Feeds of runs that were already done.
    psd_feed : float, m/s, optional
        Feed at which the profile of a `Psd` over position was recorded.

    Returns
    -------
    FeedPlan
        ``feeds``, ``sd``, ``information``, ``audit``, ``messages``.

    Raises
    ------
    DataError
        If a speed, wavelength or length is not positive and finite, no wave fits the travel, or
        no plan keeps the limits.
    InvalidSamplesError
        If the density is not above zero everywhere.
    NotSeparableError
        If the range allows only one feed, or the density is known at none of the frequencies of
        some wavelength.
    TooFewSamplesError
        If the plan, with the runs already done, has fewer than two runs.
    UnitError
        If speeds, wavelengths or the density cannot be in SI.

    Notes
    -----
    Maximises ``min_k J_k`` with at least two different feeds: a logarithmic grid of candidates,
    starts from the relaxed linear programme, exchange of runs, then continuous refinement.
    Deterministic. ``audit["efficiency"]`` is the smallest information over the bound of the
    relaxed problem, which no plan can exceed. Slow runs last longer and know more per run, so
    without `max_time` the plan leans to `v_min`. Null space: the offset and slope of a run, waves
    longer than the travel, and disturbances that are the same function of position in all runs.

    References
    ----------
    .. [1] A. Kono et al., Int. J. Mach. Tools Manuf. 48 (2008): several feeds tell geometry from
       vibration.
    .. [2] S. M. Kay, Fundamentals of Statistical Signal Processing, 1993, ch. 3: information in
       coloured noise.

    Examples
    --------
    >>> def floor(f):  # 1 nm^2/Hz and an isolator at 12 Hz
    ...     return 1e-18 + 6e-15 / (1 + ((f - 12) / 0.25) ** 2)
    >>> plan = plan_feedrates(floor, [10e-3, 5e-3, 4e-3], 0.08, 0.16, 6, length=56e-3)
    >>> len(set(plan.feeds)) >= 2
    True
    >>> bool(min(abs(plan.feeds / 10e-3 - 12.0)) > 1.0)
    True
    """
    density = time_density(psd, feed=psd_feed)
    waves, travel, usable, audit = _travel(wavelengths, length, settle_distance)
    limits, done = _limits(v_min, v_max, travel, max_time, min_ratio, fixed)
    n = _runs(n_runs, done)
    _reachable(density, waves, limits, done)

    def information(feeds: FloatArray) -> FloatArray:
        return run_information(density, feeds, waves, usable)

    feeds, bound = best_feeds(information, n, limits, done)
    if not feeds.size:
        raise DataError(
            f"no {n} runs of {travel * 1e3:.4g} mm keep the limits: at {v_max * 6e4:.0f} mm/min "
            f"they last {n * travel / v_max:.4g} s, allowed are {limits.max_time:.4g} s with two "
            f"different feeds at least {min_ratio:.4g} apart; allow more time or fewer runs"
        )
    plan = _predict(density, waves, feeds, done, usable, audit, limits)
    audit = {
        **plan.audit,
        "v_min_mm_per_min": float(v_min) * 6e4,
        "v_max_mm_per_min": float(v_max) * 6e4,
        "min_ratio": float(min_ratio),
        "max_time_s": None if max_time is None else float(max_time),
        "criterion": "largest smallest information over the wavelengths",
        "efficiency": float(plan.information.min() / bound),
    }
    return FeedPlan(
        plan.feeds, waves, plan.information, plan.columns, density, done, audit, plan.messages
    )


def predicted_sd(
    psd: Any,
    feeds: ArrayLike,
    wavelengths: ArrayLike | tuple[float, float],
    length: float | None = None,
    *,
    settle_distance: float = 0.0,
    psd_feed: float | None = None,
) -> FeedPlan:
    """Return what runs at given feeds tell about each wavelength.

    Parameters
    ----------
    psd : DataFrame, (f, S), callable or Psd
        As for `plan_feedrates`.
    feeds : array_like, shape (n_runs,), m/s
        One entry for each run.
    wavelengths : array_like, shape (k,), or (shortest, longest), m
        As for `plan_feedrates`.
    length : float, m, optional
        Travel of each run; twice the longest wavelength if omitted.
    settle_distance : float, m, optional
        Part of it that is lost while the axis settles.
    psd_feed : float, m/s, optional
        As for `plan_feedrates`.

    Returns
    -------
    FeedPlan
        ``sd``, ``information``, ``messages``; `feeds` as given, sorted.

    Raises
    ------
    DataError
        If a speed, wavelength or length is not positive and finite.
    InvalidSamplesError
        If the density is not above zero everywhere.
    TooFewSamplesError
        If there is no feed.
    UnitError
        If speeds, wavelengths or the density cannot be in SI.

    Examples
    --------
    >>> white = predicted_sd(lambda f: 4e-18 + 0 * f, [0.1, 0.1], [5e-3, 10e-3, 25e-3], 50e-3)
    >>> (white.information / 1e17).round(9).tolist()  # 2 runs x 0.5 s / 4 nm^2/Hz
    [2.5, 2.5, 2.5]
    """
    density = time_density(psd, feed=psd_feed)
    waves, _, usable, audit = _travel(wavelengths, length, settle_distance)
    speeds = np.sort(checked_feeds(feeds, "feeds"))
    if not speeds.size:
        raise TooFewSamplesError("feeds is empty; give the feed of each run in m/s")
    return _predict(density, waves, speeds, np.empty(0), usable, audit, None)


def _travel(
    wavelengths: ArrayLike, length: float | None, settle_distance: float
) -> tuple[FloatArray, float, float, dict[str, Any]]:
    """Wavelengths, travel of a run, the usable part of it, and what to say about them."""
    waves, is_range = checked_wavelengths(wavelengths, travel_is_known=length is not None)
    longest = float(waves.max())
    lost = positive(settle_distance, "settle_distance", "m", zero=True)
    if length is None:
        travel = _WAVES_IN_TRAVEL * longest + lost
        chosen = f"{_WAVES_IN_TRAVEL:.0f} x the longest wavelength"
    else:
        travel, chosen = positive(length, "length", "m"), "user"
    usable = travel - lost
    if usable < longest * (1.0 - 1e-9):
        raise DataError(
            f"a run of {travel * 1e3:.4g} mm of which {lost * 1e3:.4g} mm are lost holds less than "
            f"one wave of {longest * 1e3:.4g} mm; run longer or plan for shorter waves"
        )
    audit = {
        "length_mm": travel * 1e3,
        "length_chosen_by": chosen,
        "settle_distance_mm": lost * 1e3,
        "n_wavelengths": int(waves.size),
        "wavelengths_chosen_by": "logarithmic grid over the range" if is_range else "user",
    }
    return waves, travel, usable, audit


def _limits(
    v_min: float,
    v_max: float,
    travel: float,
    max_time: float | None,
    min_ratio: float,
    fixed: ArrayLike,
) -> tuple[Limits, FloatArray]:
    pair = checked_feeds([v_min, v_max], "v_min and v_max")
    if pair.size != 2:
        raise DataError("v_min and v_max must be one speed each, in m/s")
    low, high = pair
    done = np.sort(checked_feeds(fixed, "fixed"))
    ratio = positive(min_ratio, "min_ratio", "1")
    if not ratio > 1.0:
        raise DataError(f"min_ratio is {min_ratio}; feeds must differ by a ratio above 1, as 1.1")
    if high < low:
        raise DataError(f"v_max = {high:.6g} m/s is below v_min = {low:.6g} m/s; swap them")
    distinct = max(high, *done, 0.0) / min(low, *done, math.inf)
    if distinct < ratio * (1.0 - 1e-12):
        raise NotSeparableError(
            f"feeds from {low * 6e4:.0f} to {high * 6e4:.0f} mm/min allow no two feeds a ratio of "
            f"{ratio:.4g} apart, and one feed cannot tell vibration from geometry; widen the range "
            "or lower min_ratio"
        )
    time = math.inf if max_time is None else positive(max_time, "max_time", "s")
    return Limits(float(low), float(high), ratio, travel, time), done


def _runs(n_runs: int, fixed: FloatArray) -> int:
    try:
        is_whole = not isinstance(n_runs, bool) and int(n_runs) == n_runs
    except (TypeError, ValueError, OverflowError):
        is_whole = False
    if not is_whole:
        raise DataError(f"n_runs is {n_runs!r}; it must be a whole number of runs")
    if n_runs < 1 or n_runs + fixed.size < 2:
        raise TooFewSamplesError(
            f"n_runs is {n_runs} with {fixed.size} run(s) already done; a plan needs at least two "
            "runs at different feeds"
        )
    return int(n_runs)


def _reachable(density: TimeDensity, waves: FloatArray, limits: Limits, fixed: FloatArray) -> None:
    slowest = min(limits.v_min, *fixed, math.inf)
    lost = waves[slowest / waves > density.highest]
    if lost.size:
        raise NotSeparableError(
            f"the density is known up to {density.highest:.4g} Hz, but a wave of "
            f"{lost.min() * 1e3:.4g} mm is read at {slowest / lost.min():.4g} Hz even at "
            f"{slowest * 6e4:.0f} mm/min; plan for longer waves, allow slower feeds or sample "
            "faster (feeds are m/s, wavelengths m)"
        )


def _predict(
    density: TimeDensity,
    waves: FloatArray,
    feeds: FloatArray,
    fixed: FloatArray,
    usable: float,
    audit: Mapping[str, Any],
    limits: Limits | None,
) -> FeedPlan:
    every = np.sort(np.concatenate([feeds, fixed]))
    information = run_information(density, every, waves, usable).sum(axis=0)
    long_record = np.divide(
        1.0, np.sqrt(information), out=np.full(waves.shape, np.nan), where=information > 0.0
    )
    sd = np.sqrt(finite_variance(density, every, waves, usable))
    is_exact = bool(np.isfinite(sd[information > 0.0]).all())
    low, high = (
        (limits.v_min, limits.v_max) if limits else (float(every.min()), float(every.max()))
    )
    naive = {
        "one_feed": np.full(every.size, 0.5 * (low + high)),
        "even_feeds": np.linspace(low, high, every.size),
    }
    columns = {
        "wavelength_mm": waves * 1e3,
        "sd_nm": (sd if is_exact else long_record) * 1e9,
        "sd_long_record_nm": long_record * 1e9,
    }
    for name, plan in naive.items():
        exact = np.sqrt(finite_variance(density, plan, waves, usable))
        j = run_information(density, plan, waves, usable).sum(axis=0)
        rough = np.divide(1.0, np.sqrt(j), out=np.full(j.shape, np.nan), where=j > 0.0)
        columns[f"sd_{name}_nm"] = (exact if is_exact else rough) * 1e9
    found = collisions(density, peaks(density, every, waves), every, waves, usable, limits)
    details = {
        **audit,
        "feeds_mm_per_min": [float(v) * 6e4 for v in feeds],
        "fixed_feeds_mm_per_min": [float(v) * 6e4 for v in fixed],
        "time_s": float(np.sum(audit["length_mm"] * 1e-3 / feeds)),
        "density_from": density.source,
        "density_known_from_hz": density.lowest,
        "density_known_to_hz": density.highest,
        "sd_by": "generalised least squares over the finite record, offset of each run free"
        if is_exact
        else "long-record formula 1 / sqrt(J)",
        "one_feed_mm_per_min": float(naive["one_feed"][0]) * 6e4,
    }
    messages = plain_messages(found, density, every, waves, is_exact, information)
    if waves.max() > LONG_WAVE:
        hint = (
            f"the longest wave is {waves.max():.4g} m on a travel of "
            f"{audit['length_mm'] * 1e-3:.4g} m: both are in m (1 mm is 0.001)"
        )
        messages = (hint, *messages)
    return FeedPlan(
        np.array(feeds), waves, information, columns, density, fixed, details, messages
    )
