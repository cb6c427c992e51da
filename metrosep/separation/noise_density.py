"""One-sided density S(f) of the disturbance over time, from whatever the user has of it.

``S`` is in m^2/Hz and one-sided: it integrates over f > 0 to the variance. Between two measured
frequencies it is interpolated linearly. Below the first one its value is held, because every
estimate of S ends at about one over the record length while long waves lie below it; above the
last one S is not known and is NaN.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from typing import Any

import numpy as np

from metrosep.core._arrays import FloatArray
from metrosep.core.errors import DataError, InvalidSamplesError, TooFewSamplesError, UnitError
from metrosep.separation._real_numbers import real_numbers
from metrosep.separation.planner_checks import positive
from metrosep.spectral.spectra import Psd

__all__ = ["TimeDensity", "time_density"]


_LARGEST_RMS = 1e-4
"""m; a machine axis that shakes by more than 0.1 mm RMS is a mistake of units."""

_BAND = (1.0, 1e3)
"""Hz; a formula is integrated over it."""

_LINES = 4096


@dataclass(frozen=True, slots=True, eq=False)
class TimeDensity:
    """One-sided density of the disturbance over time.

    Parameters
    ----------
    function : callable
        S(f) for an array of frequencies in Hz, in m^2/Hz.
    lowest, highest : float, Hz
        Where it is known: 0 and infinity for a formula.
    source : str
        Where it came from, for the audit.
    """

    function: Callable[[FloatArray], Any]
    lowest: float
    highest: float
    source: str

    def __call__(self, frequency: FloatArray) -> FloatArray:
        """Return S at frequencies, held below the first known one, NaN above the last."""
        f = np.asarray(frequency, dtype=np.float64)
        known = f <= self.highest * (1.0 + 1e-12)
        out = np.full(f.shape, np.nan)
        at = np.clip(f[known], self.lowest, self.highest)
        try:
            values = real_numbers(self.function(at), "S(f)")
            out[known] = np.broadcast_to(np.asarray(values, dtype=np.float64), at.shape)
        except Exception as exc:
            raise InvalidSamplesError(
                f"S(f) must return one real density for each of {at.size} frequencies: "
                f"{type(exc).__name__}: {exc}"
            ) from exc
        bad = known & ~(np.isfinite(out) & (out > 0.0))
        if bad.any():
            raise InvalidSamplesError(
                f"the density of the disturbance is {out[bad][0]:.4g} m^2/Hz at "
                f"{f[bad][0]:.6g} Hz; it must be finite and above zero: add the noise of the "
                "sensor, no reading is free of it"
            )
        return out


def time_density(psd: Any, *, feed: float | None = None) -> TimeDensity:
    """Return the density of the disturbance over time from any of its usual forms.

    Parameters
    ----------
    psd : TimeDensity, Psd, DataFrame, tuple of arrays or callable
        A table with the columns ``frequency_hz`` and ``psd_nm2_per_hz`` as
        ``ErrorEstimate.residual_psd`` gives it; ``(f, S)`` in Hz and m^2/Hz; a function S(f); or
        a `Psd`, whose frequencies are Hz where it was computed over time.
    feed : float, m/s, optional
        For a `Psd` over position only: the feedrate at which that profile was recorded. Its
        waves per metre become ``f = feed * frequency`` and its density ``density / feed``.

    Returns
    -------
    TimeDensity
        Callable S(f).

    Raises
    ------
    DataError
        If it is none of these, or `feed` comes with something else than a `Psd`.
    InvalidSamplesError
        If frequencies do not rise, or a density is not finite and above zero.
    TooFewSamplesError
        If fewer than two frequencies above zero are given.
    UnitError
        If the density integrates to more than 0.1 mm RMS (a formula: over 1 Hz to 1 kHz).

    Notes
    -----
    The zero frequency is the mean, not a disturbance, and is left out. The column
    ``psd_nm2_per_hz`` is the measured density, not the model beside it.

    Examples
    --------
    >>> density = time_density(([1.0, 100.0], [1e-16, 3e-16]))
    >>> (density(np.array([0.5, 50.5, 200.0])) * 1e16).tolist()
    [1.0, 2.0, nan]
    """
    if isinstance(psd, TimeDensity):
        return psd
    if isinstance(psd, Psd):
        speed = 1.0 if feed is None else _positive_feed(feed)
        text = "Psd over time" if feed is None else f"Psd over position at {feed:.6g} m/s"
        return _sampled(psd.frequency * speed, psd.density / speed, text)
    if feed is not None:
        raise DataError("psd_feed is for a Psd over position only; leave it out")
    if callable(psd):
        formula = TimeDensity(psd, 0.0, math.inf, "function S(f)")
        f = np.geomspace(*_BAND, _LINES)
        _refuse_shaking(f, formula(f), " over 1 Hz to 1 kHz")
        return formula
    columns = getattr(psd, "columns", None)
    if columns is not None or isinstance(psd, dict):
        names = list(psd if columns is None else columns)
        if not {"frequency_hz", "psd_nm2_per_hz"} <= set(names):
            raise DataError(
                "the table of the density needs the columns frequency_hz and psd_nm2_per_hz, got "
                f"{names}"
            )
        density = np.asarray(psd["psd_nm2_per_hz"], dtype=np.float64) * 1e-18
        return _sampled(psd["frequency_hz"], density, "table psd_nm2_per_hz")
    if isinstance(psd, (tuple, list)) and len(psd) == 2:
        return _sampled(psd[0], psd[1], "samples (f, S)")
    raise DataError(
        "psd must be a table with frequency_hz and psd_nm2_per_hz, a tuple (f_Hz, S_m2_per_Hz), a "
        f"Psd or a function S(f), got {type(psd).__name__}"
    )


def _positive_feed(feed: float) -> float:
    return positive(feed, "psd_feed", "m/s")


def _sampled(frequency: Any, density: Any, source: str) -> TimeDensity:
    f = np.array(real_numbers(frequency, "the frequency"), dtype=np.float64)
    s = np.array(real_numbers(density, "the density"), dtype=np.float64)
    if f.ndim != 1 or f.shape != s.shape:
        raise InvalidSamplesError(
            f"frequency and density must be equally long lists, got shapes {f.shape} and {s.shape}"
        )
    if f.size and f[0] == 0.0:
        f, s = f[1:], s[1:]
    if f.size < 2:
        raise TooFewSamplesError(
            f"a density needs at least 2 frequencies above zero, got {f.size}; a result of "
            "method='mean' or 'kono' may have none: use method='joint'"
        )
    if not np.isfinite(f).all() or f[0] < 0.0 or not (np.diff(f) > 0.0).all():
        raise InvalidSamplesError("the frequencies of a density must be finite, >= 0 and rising")
    bad = ~(np.isfinite(s) & (s > 0.0))
    if bad.any():
        raise InvalidSamplesError(
            f"the density is {s[bad][0]:.4g} at {f[bad][0]:.6g} Hz; it must be finite and above "
            "zero at every frequency but zero"
        )
    _refuse_shaking(f, s, "")
    return TimeDensity(partial(_between, f, s), float(f[0]), float(f[-1]), source)


def _between(f: FloatArray, s: FloatArray, at: FloatArray) -> FloatArray:
    return np.interp(at, f, s)


def _refuse_shaking(f: FloatArray, s: FloatArray, where: str) -> None:
    rms = math.sqrt(float(np.sum(np.diff(f) * (s[1:] + s[:-1]) / 2.0)))
    if rms > _LARGEST_RMS:
        raise UnitError(
            f"the density integrates to {rms:.3g} m RMS{where}, more than any machine shakes; give "
            "m^2/Hz (1 um^2/Hz is 1e-12 m^2/Hz, 1 nm^2/Hz is 1e-18)"
        )
