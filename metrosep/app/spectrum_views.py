"""Amplitude against wavelength, with a band that moves under the pointer.

The transform is made once for a profile; moving the limits only adds up the powers of the bins
between them. Amplitudes and powers are those of `metrosep.spectral.amplitude_spectrum`: periodic
Hann, corrected for its gain (amplitude) and its noise bandwidth (power).
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Literal

import numpy as np
from numpy.typing import NDArray

from metrosep.app.view_tables import checked_columns, find_holes
from metrosep.core._arrays import ByteArray, FloatArray
from metrosep.core.errors import DataError, InvalidSamplesError, TooFewSamplesError
from metrosep.core.profile import Profile
from metrosep.core.readable import said_value
from metrosep.core.runset import Run
from metrosep.core.units import format_length
from metrosep.separation.runs.base import ErrorEstimate
from metrosep.spectral.density import amplitude_spectrum
from metrosep.spectral.dft import Band
from metrosep.spectral.window import hann_weights, noise_bandwidth

if TYPE_CHECKING:
    from metrosep.parameters.psd_limits import PsdVerdict

_ON_LIMIT = 1e-9
"""Relative distance within which a wavelength lies on a limit of the band, and so inside."""

_LEAST_SAMPLES = 4
_REPEATABILITY_K = 2.0
"""The repeatability band is the amplitude plus and minus this many standard uncertainties."""

_MM, _NM = 1e-3, 1e-9
_NM2_MM = _NM * _NM * _MM
"""m^3 in nm^2 mm."""
_WAYS = {1: "forward", -1: "reverse"}


@dataclass(frozen=True, slots=True, eq=False)
class ProfileSpectrum:
    """The transform of a profile, kept while the limits move; made by `profile_spectrum`."""

    frequency: FloatArray  # shape (n // 2 + 1,), 1/m: from 0
    # shape (n // 2 + 1,), m: of the waves; at 0 what the window leaves of the mean
    amplitude: FloatArray
    # shape (n // 2 + 1,), m^2: share of each bin in the mean square; they add up to that of the
    # windowed heights
    power: FloatArray
    start: float  # m: part of the profile that was transformed
    stop: float
    n_samples: int  # its samples
    share_used: float  # dimensionless: its length over that of the profile
    messages: tuple[str, ...] = ()  # what was left out or resampled

    def band_rms(self, band: Band) -> tuple[float, float]:
        """Return the RMS of the waves in a band, and of all the rest."""
        first, last = self.bins(band)
        inside = float(self.power[first:last].sum())
        outside = float(self.power[:first].sum() + self.power[last:].sum())
        return math.sqrt(inside), math.sqrt(outside)

    def bins(self, band: Band) -> tuple[int, int]:
        """Return the bins of a band as a range ``first <= k < last``."""
        first, last = 1, self.frequency.size
        if band.longest is not None:
            first += int(
                np.searchsorted(self.frequency[1:] * band.longest, 1.0 - _ON_LIMIT, side="left")
            )
        if band.shortest is not None:
            last = 1 + int(
                np.searchsorted(self.frequency[1:] * band.shortest, 1.0 + _ON_LIMIT, side="right")
            )
        return first, max(first, last)


@dataclass(frozen=True, slots=True, eq=False)
class SpectrumView:
    """A spectrum as the screen shows it."""

    wavelength: FloatArray  # shape (n,), m: falling
    # shape (n,), m: of each wave; where a pixel column holds several, the greatest, at its own
    # wavelength
    amplitude: FloatArray
    in_band: ByteArray  # of uint8, shape (n,): 1 between the limits
    # m: RMS of the waves in the band, and of the rest, of all bins and not only those shown
    inside: float
    outside: float
    # of uint8, shape (n,), or None: 1 where a separation took the wave for repeatable
    selected: ByteArray | None = None
    # shape (n,), m, or None: repeatability band of a separation: amplitude -+ 2 standard
    # uncertainties, from 0 on; NaN where the uncertainty is not known
    low: FloatArray | None = None
    high: FloatArray | None = None
    messages: tuple[str, ...] = ()  # in plain words


def profile_spectrum(
    profile: Profile | Run,
    *,
    gaps: Literal["longest", "refuse"] = "longest",
    detrend: Literal["line", "mean"] | None = "line",
    unit: Literal["m", "px"] = "m",
) -> ProfileSpectrum:
    """Return the amplitudes and powers of the waves in a profile or section.

    Notes
    -----
    Nothing is filled: a gap ends the part, and so does a hole in the positions (`find_holes`).
    Uneven positions are resampled: as many samples at even steps, each on the straight line
    between its two neighbours, which damps waves of a few samples (a wave of 4 samples by up to
    30 %). That is done for the picture only.

    With the periodic Hann window a wave of amplitude A that divides the record reads A in its bin,
    and the powers of its three bins add up to A^2/2. The mean square that is split into inside and
    outside is weighted by the square of the window: what lies in the middle counts more than what
    lies at the ends. It is not the RMS of the profile.

    Examples
    --------
    >>> i = np.arange(4000)
    >>> wave = Profile(i * 1e-6, 50e-9 * np.cos(2 * np.pi * 40 * i / 4000))
    >>> spectrum = profile_spectrum(wave, detrend="mean")
    >>> [round(v * 1e9 * 2**0.5, 6) for v in spectrum.band_rms(Band(50e-6, 200e-6))]
    [50.0, 0.0]
    """
    if gaps not in ("longest", "refuse"):
        raise DataError(f'gaps must be "longest" or "refuse", got {said_value(gaps)}')
    if not isinstance(profile, Profile | Run):
        raise DataError(f"the spectrum is that of a Profile, got {type(profile).__name__}")
    if unit not in ("m", "px"):
        raise DataError(f'unit must be "m" or "px", got {said_value(unit)}')
    told = format_length if unit == "m" else _pixels
    whole = profile.to_profile() if isinstance(profile, Run) else profile
    if unit == "px":  # asked for by the pixel: frequencies are 1/px
        whole = Profile(whole.x, whole.z, history=whole.history)
    part, messages = _longest_part(whole, gaps, told)
    if len(part) < _LEAST_SAMPLES:
        raise TooFewSamplesError(
            f"the longest part without a gap has {len(part)} of {len(whole)} samples; a spectrum "
            f"needs {_LEAST_SAMPLES}"
        )
    if not part.is_uniform:
        part, said = _resampled(part, told)
        messages.append(said)
    lines = amplitude_spectrum(part, window="hann", detrend=detrend)
    n = len(part)
    power = lines.amplitude**2 / noise_bandwidth(hann_weights(n))
    power[1 : (n + 1) // 2] /= 2.0  # a wave is cut in two: frequencies above and below zero
    power.setflags(write=False)
    start, stop = float(part.x[0]), float(part.x[-1])
    return ProfileSpectrum(
        frequency=lines.frequency,
        amplitude=lines.amplitude,
        power=power,
        start=start,
        stop=stop,
        n_samples=n,
        share_used=(stop - start) / float(whole.x[-1] - whole.x[0]),
        messages=tuple(messages),
    )


def _pixels(value: float) -> str:
    return f"{value:.4g} px"


def _longest_part(
    profile: Profile, gaps: str, told: Callable[[float], str]
) -> tuple[Profile, list[str]]:
    """Return the longest stretch of x without NaN and without a hole."""
    valid = ~np.isnan(profile.z)
    holes = find_holes(profile.x)
    if valid.all() and not holes.size:
        return profile, []
    if gaps == "refuse":
        first = holes[0] if valid.all() else np.flatnonzero(~valid)[0]
        raise InvalidSamplesError(
            f"{int((~valid).sum())} of {len(profile)} samples were not measured and {holes.size} "
            f"steps are holes, the first at {told(float(profile.x[first]))}; a spectrum "
            "needs a part without gaps: crop to one, or let it take the longest"
        )
    starts_new = np.zeros(len(profile), dtype=np.bool_)
    starts_new[holes + 1] = True
    starts_new[1:] |= ~valid[:-1]
    index = np.flatnonzero(valid)
    if index.size == 0:
        raise TooFewSamplesError(f"none of the {len(profile)} samples was measured")
    first = np.flatnonzero(starts_new[index] | (np.arange(index.size) == 0))
    last = np.append(first[1:], index.size) - 1
    length = profile.x[index[last]] - profile.x[index[first]]
    k = int(np.argmax(length))
    a, b = int(index[first[k]]), int(index[last[k]])
    whole = float(profile.x[-1] - profile.x[0])
    share = f"{100.0 * float(length[k]) / whole:.1f} %" if whole > 0.0 else "all"
    said = (
        f"spectrum of the longest part without a gap: {told(float(profile.x[a]))} ... "
        f"{told(float(profile.x[b]))}, {share} of the length"
    )
    return Profile(profile.x[a : b + 1], profile.z[a : b + 1]), [said]


def _resampled(part: Profile, told: Callable[[float], str]) -> tuple[Profile, str]:
    steps = np.diff(part.x)
    x = np.linspace(part.x[0], part.x[-1], len(part))
    said = (
        f"positions are not even (steps {told(float(steps.min()))} ... "
        f"{told(float(steps.max()))}): resampled on straight lines every "
        f"{told(float(x[1] - x[0]))}; waves shorter than "
        f"{told(4.0 * float(steps.max()))} are damped"
    )
    return Profile(x, np.interp(x, part.x, part.z)), said


def spectrum_view(
    spectrum: ProfileSpectrum, *, band: Band | None = None, columns: int = 1000
) -> SpectrumView:
    """Return the spectrum of a profile for the screen.

    Examples
    --------
    >>> wave = Profile(np.arange(64.0), np.cos(2 * np.pi * np.arange(64.0) / 8))
    >>> view = spectrum_view(profile_spectrum(wave, detrend=None), band=Band(7.0, 10.0))
    >>> view.wavelength[view.amplitude.argmax()].item(), int(view.in_band.sum())
    (8.0, 3)
    """
    if not isinstance(spectrum, ProfileSpectrum):
        raise DataError(f"a transform is needed, got {type(spectrum).__name__}")
    limits = _checked_band(band)
    wide = checked_columns(columns)
    shown = _peaks(spectrum.frequency, spectrum.amplitude, wide)
    first, last = spectrum.bins(limits)
    inside, outside = spectrum.band_rms(limits)
    return SpectrumView(
        wavelength=_frozen(1.0 / spectrum.frequency[shown]),
        amplitude=_frozen(spectrum.amplitude[shown]),
        in_band=_flags((shown >= first) & (shown < last)),
        inside=inside,
        outside=outside,
        messages=spectrum.messages,
    )


def _peaks(frequency: FloatArray, amplitude: FloatArray, columns: int) -> NDArray[np.intp]:
    """Return the bin of the greatest amplitude in each column of a logarithmic axis."""
    k = np.arange(1, frequency.size)
    if k.size <= columns:
        return k
    edges = np.unique(np.ceil(np.geomspace(1.0, frequency.size, columns + 1)).astype(np.intp))
    first, last = edges[:-1], np.minimum(edges[1:], frequency.size)
    greatest = np.maximum.reduceat(amplitude, first)
    # the first bin of each column that reaches the greatest amplitude of its column
    reaches = np.flatnonzero(amplitude[1:] >= np.repeat(greatest, last - first)) + 1
    column = np.searchsorted(first, reaches, side="right") - 1
    return np.asarray(reaches[np.unique(column, return_index=True)[1]])


def estimate_view(
    estimate: ErrorEstimate, *, band: Band | None = None, direction: int | None = None
) -> SpectrumView:
    """Return the wavelengths of a separation for the screen.

    Notes
    -----
    A wave of amplitude A has the mean square A^2/2. The waves are orthogonal over the basis
    period, not over the evaluation range, so their RMS is not that of the estimate there.
    """
    if not isinstance(estimate, ErrorEstimate):
        raise DataError(f"an ErrorEstimate is needed, got {type(estimate).__name__}")
    limits = _checked_band(band)
    rows, messages = _rows(estimate, direction)
    table = estimate.spectrum_data
    columns = [np.asarray(table[k], dtype=np.float64)[rows] for k in _COLUMNS]
    wavelength, amplitude, sd = (
        v * unit for v, unit in zip(columns, (_MM, _NM, _NM), strict=True)
    )
    selected = np.asarray(table["selected"], dtype=np.bool_)[rows]
    order = np.argsort(-wavelength, kind="stable")
    wavelength, amplitude, sd = wavelength[order], amplitude[order], sd[order]
    selected = selected[order]
    within = np.ones(wavelength.size, dtype=np.bool_)
    if limits.shortest is not None:
        within &= wavelength >= limits.shortest * (1.0 - _ON_LIMIT)
    if limits.longest is not None:
        within &= wavelength <= limits.longest * (1.0 + _ON_LIMIT)
    squares = np.where(selected, amplitude**2 / 2.0, 0.0)
    known = not np.isnan(sd).all()
    return SpectrumView(
        wavelength=_frozen(wavelength),
        amplitude=_frozen(amplitude),
        in_band=_flags(within),
        inside=math.sqrt(float(squares[within].sum())),
        outside=math.sqrt(float(squares[~within].sum())),
        selected=_flags(selected),
        low=_frozen(np.maximum(amplitude - _REPEATABILITY_K * sd, 0.0)) if known else None,
        high=_frozen(amplitude + _REPEATABILITY_K * sd) if known else None,
        messages=messages,
    )


def density_frame(
    found: PsdVerdict, *, is_preview: bool = False
) -> tuple[dict[str, Any], dict[str, FloatArray]]:
    """Return a density with its limit and bands: wavelengths fall, densities in nm^2 mm.

    Of a limit of the RMS there is no density to draw, only its band.
    """
    f, density = found.spectrum.frequency[1:], found.spectrum.density[1:]
    limit, mean = np.full(f.size, np.nan), np.full(f.size, np.nan)
    low, high = found.bands[0].low, found.bands[-1].high
    inside = (f >= low * (1.0 - _ON_LIMIT)) & (f <= high * (1.0 + _ON_LIMIT))
    if found.limit.A is not None:
        limit[inside] = found.limit.A / f[inside] ** found.limit.B
        for band in found.bands:
            mean[inside & (f >= band.low * (1.0 - _ON_LIMIT))] = band.mean  # rising frequencies
    header = {
        "unit": "nm^2 mm",
        "limit": found.limit.text,
        "direction": found.direction,
        "verdict": found.verdict,
        "words": found.sentence,
        "is_preview": is_preview,
        "bands": [
            {"low": 1.0 / b.high, "high": 1.0 / b.low, "ratio": b.ratio, "verdict": b.verdict}
            for b in found.bands
        ],
    }
    arrays = {"density": density / _NM2_MM, "limit": limit / _NM2_MM, "mean": mean / _NM2_MM}
    return header, {"wavelength": 1.0 / f, **arrays}


_COLUMNS = ("wavelength_mm", "amplitude_nm", "sd_nm")


def _rows(
    estimate: ErrorEstimate, direction: int | None
) -> tuple[NDArray[np.bool_], tuple[str, ...]]:
    """Return the rows of the spectrum table of one direction."""
    table = estimate.spectrum_data
    n = len(table.get("wavelength_mm", ()))
    if n == 0:
        raise DataError(
            f'the method "{estimate.method}" tells no wavelengths apart: it has no spectrum'
        )
    ways = np.asarray(table.get("direction", [""] * n))
    if direction is not None and direction not in _WAYS:
        raise DataError(
            f"direction is +1 (forward), -1 (reverse) or nothing, got {said_value(direction)}"
        )
    if "direction" not in table:
        if direction is not None and direction not in estimate.directions:
            raise DataError(f"the estimate has no {_WAYS[direction]} direction of its own")
        return np.ones(n, dtype=np.bool_), ()
    messages = () if direction is not None else ("both directions were estimated: forward shown",)
    return np.asarray(ways == _WAYS[direction or 1]), messages


def _checked_band(band: Band | None) -> Band:
    if band is None:
        return Band()
    if not isinstance(band, Band):
        raise DataError(f"the limits are a Band of wavelengths, got {type(band).__name__}")
    return band


def _flags(values: NDArray[np.bool_]) -> ByteArray:
    flags = values.astype(np.uint8)
    flags.setflags(write=False)
    return flags


def _frozen(array: FloatArray) -> FloatArray:
    array.setflags(write=False)
    return array
