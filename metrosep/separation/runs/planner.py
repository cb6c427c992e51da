"""`plan_feedrates`: at which feeds to run an axis so that every wavelength becomes well known.

A geometric error of wavelength L read at feed v is a tone of v / L; a vibration keeps its
frequency. A feed that puts a wave onto a vibration learns nothing about that wave, so the plan
maximises the information on the worst of all wavelengths, up to the travel. Units are SI; columns and messages carry theirs.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike

from metrosep.core._arrays import FloatArray
from metrosep.core.errors import DataError, NotSeparableError, TooFewSamplesError
from metrosep.core.numbers import count, quantity
from metrosep.core.profile import html_table
from metrosep.core.provenance import freeze_mapping
from metrosep.separation._readings import (
    LONG_WAVE,
    checked_feeds,
    checked_wavelengths,
    plain,
    positive,
    reduced,
)
from metrosep.separation.runs.planner_search import (
    Comparison,
    Limits,
    best_feeds,
    compared,
    finite_variance,
    geometric_feeds,
    run_information,
)
from metrosep.separation.runs.solver import TimeDensity, time_density

if TYPE_CHECKING:
    import pandas as pd

_WAVES_IN_TRAVEL = 2.0
"""Travel of a run over the longest wavelength where the user gives no length: with fewer than two
waves the offset of the run and the wave are hard to tell apart."""

_LEAST_RATIO = 1.1
"""Closer feeds see a resonance of a few per cent damping at the same wavelength."""

_ALL_WAVES = 200
"""Logarithmic steps from the shortest wave to the travel: nobody lists all waves that an axis has."""

_LISTED, _WORSE = 3.0, 1.5
"""How much more information a listed wave may ask for; and by how much the worst sd of all waves may
then exceed that of feeds in geometric progression."""


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
        Waves that matter: each is to have 3 times the information of any other wave from the
        shortest to the travel. A tuple of two is the limits of a range, in which none is preferred.
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
        If the range allows only one feed, the density is known at none of the frequencies of
        some wavelength, or the worst sd of the plan is above 1.5 times that of geometric feeds.
    TooFewSamplesError
        If the plan, with the runs already done, has fewer than two runs.
    UnitError
        If speeds, wavelengths or the density cannot be in SI.

    Notes
    -----
    Maximises ``min_k J_k`` over 200 wavelengths from the shortest to the travel, a third of J where
    a wave is listed, with at least two different feeds: a logarithmic grid of candidates, starts
    from the relaxed linear programme and from equal ratios, exchange of runs, then continuous
    refinement. Deterministic. The last message says what becomes worse than with as many feeds in
    geometric progression, which spread any vibration over as many wavelengths as there are feeds. ``audit["efficiency"]`` is the smallest information over the bound of the
    relaxed problem, which no plan can exceed. Slow runs last longer and know more per run, so
    without `max_time` the plan leans to `v_min`, but no feeds within the ratio that tells a vibration of
    half the travel apart hold more than half of the time and one run. Null space: the offset and slope of a run, waves
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

    every = np.geomspace(waves.min(), usable, _ALL_WAVES)
    reference = geometric_feeds(n, limits)
    listed = np.empty(0) if audit["wavelengths_chosen_by"] != "user" else waves
    weight = _LISTED

    def searched(within: Limits) -> tuple[FloatArray, float, Comparison]:
        found, share = _search(density, every, listed, weight, usable, n, within, done)
        return found, share, compared(density, found, reference, done, every, usable)

    feeds, efficiency, judged = searched(limits)
    if listed.size and judged.worst > _WORSE * judged.reference_worst:
        weight = _WORSE**2  # with equal ratios allowed, no wave can be so much worse then
        feeds, efficiency, judged = searched(limits)
    window = _window(float(waves.max()), usable, limits, done)
    price = ""
    if not replace(limits, window=window).spread(feeds, done):
        price = _CROWDED.format(limits.ratio)
        for share in (1.0, 0.5, 0.25):  # the time may leave the fast end only
            spread = replace(limits, window=max(window**share, limits.ratio))
            try:
                found = searched(spread)
            except DataError:
                continue
            price = _price(spread.window, judged, found[2], all_of_it=share == 1.0)
            feeds, efficiency, judged = found
            break
    if judged.worst > _WORSE * judged.reference_worst:
        raise NotSeparableError(
            f"the best plan within the limits has an sd of {judged.text()}, more than "
            f"{_WORSE} times as much: allow a smaller min_ratio, more runs or a wider range of feeds"
        )
    plan = _predict(density, waves, feeds, done, usable, audit, limits)
    audit = {
        **plan.audit,
        "v_min_mm_per_min": limits.v_min * 6e4,
        "v_max_mm_per_min": limits.v_max * 6e4,
        "min_ratio": limits.ratio,
        "max_time_s": None if max_time is None else limits.max_time,
        "criterion": "largest smallest information over all wavelengths up to the travel",
        "weight_of_listed_waves": weight if listed.size else 1.0,
        "efficiency": efficiency,
        **judged.audit(),
    }
    messages = (*plan.messages, *filter(None, [price]), *judged.messages())
    return FeedPlan(
        plan.feeds, waves, plan.information, plan.columns, density, done, audit, messages
    )


_CROWDED = (
    "more than half of the time goes to feeds within a ratio of {:.3g}, as the limits allow nothing "
    "else: a vibration that the density does not hold can spoil most of what is known of a wave"
)


def _window(longest: float, usable: float, limits: Limits, done: FloatArray) -> float:
    """Return the ratio of feeds at which a vibration of the longest wave moves by one wave in the travel.

    Runs within it see a vibration that nobody knows as the same wave. Waves that nobody listed count up
    to half the travel; the range of feeds may be less.
    """
    longest = max(longest, usable / _WAVES_IN_TRAVEL)
    feeds = [limits.v_min, limits.v_max, *done]
    wanted = 1.0 / (1.0 - min(longest / usable, _SPREADABLE))
    return float(min(max(wanted, limits.ratio), max(feeds) / min(feeds)))


def _price(window: float, crowded: Comparison, judged: Comparison, *, all_of_it: bool) -> str:
    """Say what spreading the feeds costs."""
    grown = judged.sd / crowded.sd
    i = int(np.argmax(np.where(np.isfinite(grown), grown, 0.0)))
    return (
        f"no ratio of {window:.3g} of the feeds holds more than half of the time and one run, so that a "
        "vibration which the density does not hold cannot spoil all that is known of a wave; this costs "
        f"most at {judged.waves[i] * 1e3:.3g} mm: {judged.sd[i] * 1e9:.3g} nm instead of "
        f"{crowded.sd[i] * 1e9:.3g} nm"
        + ("" if all_of_it else "; the limits allow no wider spread")
    )


def _search(
    density: TimeDensity,
    every: FloatArray,
    listed: FloatArray,
    weight: float,
    usable: float,
    n: int,
    limits: Limits,
    done: FloatArray,
) -> tuple[FloatArray, float]:
    """Return the best feeds, and their smallest weighted information over the bound on any plan."""
    both = np.concatenate([every, listed])
    share = np.concatenate([np.ones(every.size), np.full(listed.size, 1.0 / weight)])

    def information(feeds: FloatArray) -> FloatArray:
        weighted: FloatArray = run_information(density, feeds, both, usable) * share
        return weighted

    feeds, bound = best_feeds(information, n, limits, done)
    if not feeds.size:
        raise DataError(
            f"no {n} runs of {limits.length * 1e3:.4g} mm keep the limits: at "
            f"{limits.v_max * 6e4:.0f} mm/min they last {n * limits.length / limits.v_max:.4g} s, "
            f"allowed are {limits.max_time:.4g} s with two different feeds at least "
            f"{limits.ratio:.4g} apart; allow more time or fewer runs"
        )
    return feeds, float(information(np.concatenate([feeds, done])).sum(axis=0).min() / bound)


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
    plan = _predict(density, waves, speeds, np.empty(0), usable, audit, None)
    every = np.geomspace(waves.min(), usable, _ALL_WAVES)
    reference = np.geomspace(speeds[0], speeds[-1], speeds.size)
    judged = compared(density, speeds, reference, np.empty(0), every, usable)
    more: tuple[str, ...] = ()
    if judged.worst > _WORSE * judged.reference_worst:
        more = (f"the worst wave of these feeds has an sd of {judged.text()}",)
    return replace(plan, audit={**plan.audit, **judged.audit()}, messages=(*plan.messages, *more))


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
    speeds = [quantity(v, n, "speed") for v, n in ((v_min, "v_min"), (v_max, "v_max"))]
    low, high = checked_feeds(speeds, "v_min and v_max")
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
    n = count(n_runs, "n_runs")
    if n + fixed.size < 2:
        raise TooFewSamplesError(
            f"n_runs is {n} with {fixed.size} run(s) already done; a plan needs at least two runs at "
            "different feeds"
        )
    return n


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
        "geometric_feeds": np.geomspace(low, high, every.size),
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
    longest = usable if limits else float(waves.max())
    messages = plain_messages(found, density, every, waves, usable, longest, is_exact, information)
    if waves.max() > LONG_WAVE:
        hint = (
            f"the longest wave is {waves.max():.4g} m on a travel of "
            f"{audit['length_mm'] * 1e-3:.4g} m: both are in m (1 mm is 0.001)"
        )
        messages = (hint, *messages)
    return FeedPlan(
        np.array(feeds), waves, information, columns, density, fixed, details, messages
    )


# ---- what a plan says in plain words: which disturbance falls onto which wavelength at which feed ----

_PEAK_FACTOR = 4.0
"""A peak stands this much above the median density within an octave to each side."""

_OWN_SHARE = 0.5
"""A wave counts as covered where the other feeds give at least this share of what an average feed
would give at that wavelength."""

_SPREADABLE = 0.9
"""Longest wave over the travel up to which a ratio of feeds tells it from such a vibration: 10."""

_MOST_PEAKS = 6
_LINES = 8001


@dataclass(frozen=True, slots=True)
class Collision:
    """A disturbance that falls onto a planned wavelength."""

    frequency: float  # of the disturbance
    wavelength: float  # m: where it falls
    feed: float  # m/s: at this speed
    remedy: float  # m/s: A feed that sees this wave best
    covered: bool  # whether runs at other feeds of the plan know this wave


def peaks(density: TimeDensity, feeds: FloatArray, waves: FloatArray) -> FloatArray:
    """Return the frequencies of the strongest disturbances that can fall onto a wave."""
    low = float(feeds.min() / waves.max()) / 2.0
    high = min(2.0 * float(feeds.max() / waves.min()), density.highest)
    if high <= low:
        return np.empty(0)
    f = np.geomspace(low, high, _LINES)
    s = density(f)
    top = np.flatnonzero((s[1:-1] > s[:-2]) & (s[1:-1] >= s[2:])) + 1
    octave = max(int(_LINES * np.log(2.0) / np.log(high / low)), 1)
    rise = np.array([s[i] / np.median(s[max(i - octave, 0) : i + octave + 1]) for i in top])
    strong = top[rise > _PEAK_FACTOR] if top.size else top
    strongest = strong[np.argsort(-s[strong], kind="stable")][:_MOST_PEAKS]
    return np.sort(f[strongest])


def collisions(
    density: TimeDensity,
    frequencies: FloatArray,
    feeds: FloatArray,
    waves: FloatArray,
    length: float,
    limits: Limits | None,
) -> list[Collision]:
    """Return which disturbance falls onto which of the planned wavelengths."""
    low, high = (
        (limits.v_min, limits.v_max)
        if limits is not None
        else (float(feeds.min()) / 2, float(feeds.max()) * 2)
    )
    out = []
    for f in frequencies:
        for v in np.unique(feeds):
            wave = _planned(v / f, waves, length)
            if wave is None:
                continue
            at = np.array([wave])
            own = feeds == v
            others = run_information(density, feeds[~own], at, length).sum() if (~own).any() else 0
            options = np.geomspace(low, high, 401)
            offered = run_information(density, options, at, length)[:, 0]
            remedy = _round_feed(float(_quiet(options, offered, float(v))), low, high)
            wanted = np.median(offered) * feeds.size / np.unique(feeds).size
            out.append(
                Collision(float(f), wave, float(v), remedy, bool(others >= _OWN_SHARE * wanted))
            )
    return out


def _planned(wave: float, waves: FloatArray, length: float) -> float | None:
    """Return the planned wavelength that a disturbance at this one spoils, if there is one.

    A wave in a record of this length is told from another one that differs by one wave in it.
    """
    nearest = float(waves[np.argmin(np.abs(1.0 / waves - 1.0 / wave))])
    return nearest if abs(length / nearest - length / wave) <= 0.5 else None


def _quiet(options: FloatArray, offered: FloatArray, feed: float) -> float:
    """Next slower feed that knows the wave as well as a typical one, else the next faster."""
    good = offered >= 0.8 * np.median(offered)
    good &= np.abs(np.log(options / feed)) > np.log(1.1)
    slower = good & (options < feed)
    usable = slower if slower.any() else good
    if not usable.any():
        return float(options[np.argmax(offered)])
    nearest = np.argmin(np.where(usable, np.abs(np.log(options / feed)), np.inf))
    return float(options[nearest])


def _round_feed(feed: float, low: float, high: float) -> float:
    """Round to 100 mm/min (10, 1 for slow feeds) without leaving the range."""
    for step in (100.0, 10.0, 1.0):
        rounded = round(feed * 6e4 / step) * step / 6e4
        if low <= rounded <= high and abs(rounded / feed - 1.0) < 0.03:
            return rounded
    return feed


def plain_messages(
    found: list[Collision],
    density: TimeDensity,
    feeds: FloatArray,
    waves: FloatArray,
    usable: float,
    longest: float,
    is_exact: bool,
    information: FloatArray,
) -> tuple[str, ...]:
    """Return the messages of a plan."""
    out = []
    slow, fast, wave = float(feeds.min()), float(feeds.max()), float(waves.max())
    # Between these feeds a vibration of this wavelength moves by one wave in the travel of the
    # fastest run, its resolution: (v2 - v1) / wave = v2 / L.
    blind = usable * (1.0 - slow / fast)
    if slow < fast and wave > blind * (1.0 + 1e-9):
        ratio = math.ceil(20.0 / (1.0 - min(wave / usable, _SPREADABLE))) / 20.0
        out.append(
            f"the feeds of {slow * 6e4:.0f} to {fast * 6e4:.0f} mm/min are so close that waves longer "
            f"than {blind * 1e3:.3g} mm repeat like a vibration that starts with each run: there the "
            "prediction holds only for vibration that is random from run to run"
            + (f"; min_ratio={ratio:.4g} spreads them" if wave <= _SPREADABLE * usable else "")
        )
    for c in found:
        text = (
            f"{c.frequency:.1f} Hz disturbance maps onto {c.wavelength * 1e3:.1f} mm at "
            f"{c.feed * 6e4:.0f} mm/min"
        )
        if c.covered:
            out.append(f"{text}; the runs at the other feeds tell them apart")
        else:
            out.append(f"{text}; add a run at {c.remedy * 6e4:.0f}")
    if np.unique(feeds).size < 2:
        out.append(
            f"all runs are at {feeds[0] * 6e4:.0f} mm/min: one feed cannot tell vibration from "
            "geometry; the prediction holds only for vibration that is random from run to run"
        )
    beyond = feeds[:, np.newaxis] / waves > density.highest
    if beyond.any():
        out.append(
            f"the density is not known above {density.highest:.4g} Hz: {int(beyond.sum())} of "
            f"{beyond.size} pairs of run and wavelength count as no information"
        )
    if (information <= 0.0).any():
        unknown = waves[information <= 0.0]
        out.append(
            f"nothing is known about waves of {unknown.min() * 1e3:.4g} to "
            f"{unknown.max() * 1e3:.4g} mm at these feeds: their sd is NaN"
        )
    slowest = float(feeds.min()) / longest
    if slowest < density.lowest:
        out.append(
            f"the density was not measured below {density.lowest:.4g} Hz; its value there is taken "
            f"down to {slowest:.4g} Hz ({longest * 1e3:.4g} mm at {feeds.min() * 6e4:.0f} "
            "mm/min)"
        )
    if not is_exact:
        out.append(
            "the travel holds more than 300 of the shortest waves: sd is the long-record formula, "
            "which is too large at narrow resonances"
        )
    return tuple(out)


# ---- `FeedPlan`: feeds of a set of runs, and the sd they promise for each wavelength -----------


@dataclass(frozen=True, slots=True, eq=False, repr=False)
class FeedPlan:
    """Feeds of a set of runs and what they will tell about each wavelength.

    Parameters
    ----------
    feeds : ndarray, shape (n_runs,), m/s
        One entry for each run, rising; may repeat.
    wavelengths : ndarray, shape (k,), m
        Waves that were planned for.
    information : ndarray, shape (k,), 1/m^2
        ``J = sum_r (L_r / v_r) / S(v_r / wavelength)``, runs already done included; 0 where S
        is not known.
    columns : mapping of str to ndarray
        Columns of `sd`.
    density : TimeDensity
        Disturbance S(f).
    fixed : ndarray, m/s
        Runs already done.
    audit : mapping
        Settings and scores, keys with unit suffixes.
    messages : tuple of str
        What the user should know, in plain words.
    """

    feeds: FloatArray
    wavelengths: FloatArray
    information: FloatArray
    columns: Mapping[str, FloatArray]
    density: TimeDensity
    fixed: FloatArray
    audit: Mapping[str, Any] = field(default_factory=dict)
    messages: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        for array in (self.feeds, self.wavelengths, self.information, *self.columns.values()):
            array.setflags(write=False)
        object.__setattr__(self, "columns", freeze_mapping(self.columns))
        object.__setattr__(self, "audit", freeze_mapping(self.audit))

    @property
    def sd(self) -> pd.DataFrame:
        """Predicted standard deviation of the amplitude coefficients, one row a wavelength.

        ``sd_nm`` is exact for records of this length; ``sd_long_record_nm`` is ``1 / sqrt(J)``;
        ``sd_one_feed_nm`` and ``sd_geometric_feeds_nm`` are ``sd_nm`` of as many runs all at the
        middle feed, and in geometric progression over the range.
        """
        import pandas as pd

        return pd.DataFrame({k: np.array(v) for k, v in self.columns.items()})

    def __reduce__(self) -> tuple[Any, ...]:
        return reduced(self)

    def to_dict(self) -> dict[str, Any]:
        """Return plain values for JSON, NaN as None.

        Returns
        -------
        dict
            ``feeds``, ``wavelengths``, ``information``, ``fixed`` in SI, ``sd`` by column with
            unit suffixes, ``density`` (its source), ``audit``, ``messages``.
        """
        names = ("feeds", "wavelengths", "information", "fixed")
        return {
            **{name: plain(getattr(self, name)) for name in names},
            "sd": plain(self.columns),
            "density": self.density.source,
            "audit": plain(self.audit),
            "messages": list(self.messages),
        }

    def _repr_html_(self) -> str:
        """Return a small table for notebooks."""
        rows = {
            f"{w * 1e3:.4g} mm": f"sd {sd:.3g} nm" if np.isfinite(sd) else "sd not known"
            for w, sd in zip(self.wavelengths[:20], self.columns["sd_nm"][:20], strict=True)
        }
        rows.update({f"message {i + 1}": m for i, m in enumerate(self.messages)})
        return html_table(repr(self), rows)

    def __repr__(self) -> str:
        feeds = ", ".join(
            f"{n} x {v * 6e4:.0f}"
            for v, n in zip(*np.unique(self.feeds, return_counts=True), strict=True)
        )
        sd = self.columns["sd_nm"]
        known = sd[np.isfinite(sd)]
        worst = f"largest sd {known.max():.3g} nm" if known.size else "no sd known"
        return f"FeedPlan({feeds} mm/min, {worst})"
