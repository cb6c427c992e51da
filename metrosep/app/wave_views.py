"""Amplitude against wavelength of repeated runs, and what decides which wavelength repeats.

Amplitudes are those of waves of the error ``actual - nominal`` in m. Geometry shows at the same
wavelength at every feedrate, a vibration at v/f.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np

from metrosep.app.spectrum_views import SpectrumView, estimate_view
from metrosep.core._arrays import FloatArray
from metrosep.core.runset import RunSet
from metrosep.core.units import format_length
from metrosep.separation.runs.base import ErrorEstimate
from metrosep.separation.runs.spectra import feed_spectra_columns, n_wavelengths

__all__ = [
    "EstimateWaves",
    "FeedWaves",
    "Statistic",
    "Threshold",
    "adjusted_p",
    "at_wavelength",
    "estimate_waves",
    "feed_waves",
]


_MM, _NM = 1e-3, 1e-9
_WAYS = {1: "forward", -1: "reverse"}

_QUICK = 1e8
"""Samples times wavelengths that are summed for a picture before the separation: about two seconds."""

_SMALLEST_Q = 1e-5
"""Adjusted chances below are shown as this: the logarithmic axis ends somewhere."""


@dataclass(frozen=True, slots=True, eq=False)
class FeedWaves:
    """Amplitude against wavelength of the mean run of each feedrate."""

    feeds: tuple[float | None, ...]  # m/s: slowest first; None where the runs do not say it
    wavelength: FloatArray  # shape (K,), m: falling, the same for all
    amplitude: FloatArray  # shape (n_feeds, K), m: of each feedrate
    part: str  # from which part of the travel, in plain words


def feed_waves(
    runs: RunSet, *, direction: int, estimate: ErrorEstimate | None = None
) -> FeedWaves:
    """Return amplitude against wavelength, one line for each feedrate."""
    some = runs.select(direction=direction)
    data: Mapping[str, Sequence[Any]]
    if estimate is None:
        low, high = some.common_travel
        if sum(len(r) for r in some) * n_wavelengths(some, high - low) > _QUICK:
            part = "they come with the separation: the runs have many samples"
            return FeedWaves((), np.zeros(0), np.zeros((0, 0)), part)
        data = feed_spectra_columns(some)
    else:
        data = _of_direction(estimate.feed_spectra_data, direction)
    feed = np.asarray(data["feed_mm_min"], dtype=np.float64)
    n = int((feed == feed[0]).sum()) if feed.size and not np.isnan(feed[0]) else feed.size
    low, high = some.common_travel
    part = (
        f"{format_length(low)} ... {format_length(high)}, the travel that all runs share, tapered"
    )
    if not n:
        part = "no run is without a gap over the common travel: a Fourier sum cannot bridge it"
        return FeedWaves((), np.zeros(0), np.zeros((0, 0)), part)
    speeds = tuple(None if math.isnan(v) else float(v) / 6e4 for v in feed[::n])
    wavelength = _frozen(np.asarray(data["wavelength_mm"], dtype=np.float64)[:n] * _MM)
    amplitude = np.asarray(data["amplitude_nm"], dtype=np.float64).reshape(-1, n) * _NM
    return FeedWaves(speeds, wavelength, _frozen(amplitude), part)


def at_wavelength(waves: FeedWaves, feed: int, wavelength: float) -> float | None:
    """Return the amplitude of the line of a feedrate at any wavelength.

    Examples
    --------
    >>> line = FeedWaves((0.1,), np.array([4e-3, 1e-3]), np.array([[8e-9, 2e-9]]), "")
    >>> round(at_wavelength(line, 0, 2e-3) * 1e9, 9), at_wavelength(line, 0, 5e-3)
    (4.0, None)
    """
    x, y = waves.wavelength, waves.amplitude[feed]
    if x.size < 2 or not x[-1] <= wavelength <= x[0] or not (y > 0.0).all():
        return None
    place = np.log(wavelength)
    return float(np.exp(np.interp(place, np.log(x[::-1]), np.log(y[::-1]))))


@dataclass(frozen=True, slots=True)
class Threshold:
    """A threshold of the separation that can be moved."""

    key: Literal["sigma_t", "p_t", "false_discovery_rate"]  # of the step ``separate``
    value: float  # as it was used, SI
    unit: str  # ``"m"``, ``"m2"``, ``"m3"`` or ``"1"``
    keeps: Literal["below", "above"]  # {"below", "above"}: which side of it passes


@dataclass(frozen=True, slots=True, eq=False)
class Statistic:
    """What a threshold is compared with, for each wavelength."""

    name: str  # for the axis, in plain words
    values: FloatArray  # shape (K,): naN where not known
    threshold: Threshold  # its threshold
    least: float = 0.0  # smaller values are shown as this


@dataclass(frozen=True, slots=True, eq=False)
class EstimateWaves:
    """The wavelengths of a separation with the evidence for each."""

    # wavelength (falling), amplitude, selected, band of -+ 2 standard uncertainties
    view: SpectrumView
    sd: FloatArray  # shape (K,), m: standard uncertainty of each amplitude; NaN where not known
    reasons: tuple[str, ...]  # why each wavelength is selected or not
    # what the method decides by; none where the method has no threshold
    statistics: tuple[Statistic, ...]
    shortest: float | None  # m: shortest wavelength of the model
    shortest_by: str  # who chose it
    m: int | None  # highest harmonic that Kono's method keeps
    # whether the thresholds choose; not where ``shortest`` is set by hand in Kono's method
    in_use: bool
    words: str  # what this is, in a sentence


def estimate_waves(estimate: ErrorEstimate, *, direction: int) -> EstimateWaves:
    """Return the wavelengths of a separation of one direction, with the evidence for each.

    Notes
    -----
    Joint: a wavelength is selected where its chance ``p``, adjusted for the number of wavelengths
    after Benjamini and Hochberg, does not exceed ``false_discovery_rate``. Kono: where the
    standard deviation over the feedrates lies below ``sigma_t`` and the mean above ``p_t``; with
    the rule "shortest" all longer wavelengths too.
    """
    view = estimate_view(estimate, direction=direction)
    data = _of_direction(estimate.spectrum_data, direction)
    order = np.argsort(-np.asarray(data["wavelength_mm"], dtype=np.float64), kind="stable")
    audit = estimate.audit.get(_WAYS[direction], estimate.audit)
    column = {
        k: np.asarray(v, dtype=np.float64)[order]
        for k, v in data.items()
        if k in ("sd_nm", "p", "sigma_si", "mean_power_si")
    }
    reasons = tuple(str(data["reason"][i]) for i in order)
    sd = _frozen(column["sd_nm"] * _NM)
    if estimate.method == "kono":
        by_hand = audit["wavelength_chosen_by"] == "user"
        m = int(audit["m"])
        shortest = float(audit["selected_wavelength_mm"]) * _MM
        words = f"m = {m} waves in {audit['modelling_length_mm']:.6g} mm"
        words += (
            ", set by hand: the thresholds are not in use"
            if by_hand
            else f"; shortest wavelength that repeats {format_length(shortest)}"
        )
        chosen = "set by hand" if by_hand else f"the thresholds, rule {audit['rule']}"
        return EstimateWaves(
            view, sd, reasons, _of_kono(column, audit), shortest, chosen, m, not by_hand, words
        )
    shortest = float(audit["shortest_wavelength_mm"]) * _MM
    by_hand = audit["shortest_wavelength_chosen_by"] == "user"
    rate = Threshold("false_discovery_rate", float(audit["false_discovery_rate"]), "1", "below")
    q = _frozen(np.maximum(adjusted_p(column["p"]), _SMALLEST_Q))
    n_selected = int(view.selected.sum()) if view.selected is not None else 0
    return EstimateWaves(
        view,
        sd,
        reasons,
        (Statistic("chance of such a wave in noise alone, adjusted", q, rate, _SMALLEST_Q),),
        shortest,
        "set by hand" if by_hand else "the evidence",
        None,
        True,
        f"{n_selected} of {len(reasons)} wavelengths repeat; the model goes down to "
        f"{format_length(shortest)}",
    )


def _of_kono(column: Mapping[str, FloatArray], audit: Mapping[str, Any]) -> tuple[Statistic, ...]:
    unit = str(audit["sigma_t_unit"])
    sigma = Threshold("sigma_t", float(audit["sigma_t_si"]), unit, "below")
    mean = Threshold("p_t", float(audit["p_t_si"]), str(audit["p_t_unit"]), "above")
    what = "standard deviation over mean" if unit == "1" else "standard deviation"
    return (
        Statistic(f"{what} over the feedrates", _frozen(column["sigma_si"]), sigma),
        Statistic("mean over the feedrates", _frozen(column["mean_power_si"]), mean),
    )


def adjusted_p(p: FloatArray) -> FloatArray:
    """Return chances adjusted after Benjamini and Hochberg.

    References
    ----------
    .. [1] Benjamini and Hochberg 1995; Yekutieli and Benjamini 1999, eq. 3.

    Examples
    --------
    >>> adjusted_p(np.array([0.01, 0.9, 0.02])).round(6).tolist()
    [0.03, 0.9, 0.03]
    """
    n = p.size
    order = np.argsort(p, kind="stable")
    stepped = p[order] * n / np.arange(1, n + 1)
    adjusted = np.minimum(np.minimum.accumulate(stepped[::-1])[::-1], 1.0)
    out = np.empty(n)
    out[order] = adjusted
    return out


def _of_direction(data: Mapping[str, Sequence[Any]], direction: int) -> dict[str, list[Any]]:
    """Return the rows of a table that belong to a direction."""
    if "direction" not in data:
        return {k: list(v) for k, v in data.items()}
    mine = [i for i, way in enumerate(data["direction"]) if way == _WAYS[direction]]
    return {k: [v[i] for i in mine] for k, v in data.items() if k != "direction"}


def _frozen(array: FloatArray) -> FloatArray:
    array.setflags(write=False)
    return array
