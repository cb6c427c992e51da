"""Power spectral density of profiles and surfaces; every one sums to the variance.

Heights in m, frequencies in 1/m (waves per metre): a profile's density has the unit m^3, an areal
one m^4. Densities are divided by the mean square of the window, so white noise keeps its level;
amplitudes by its mean, so a wave on a bin keeps its amplitude. The zero frequency stands in the
arrays but not in any RMS: it is the mean, not roughness.

Sources: Harris 1978 for the windows; Parseval's theorem for everything else.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from metrosep.core._arrays import FloatArray
from metrosep.core.docs import documented
from metrosep.core.errors import DataError, InvalidSamplesError, TooFewSamplesError
from metrosep.core.numbers import choice
from metrosep.core.profile import Profile
from metrosep.core.provenance import Step
from metrosep.core.surface import Surface, lateral_steps
from metrosep.spectral.dft import Band, instance_of
from metrosep.spectral.spectra import AmplitudeSpectrum, ArealPsd, Psd, RadialPsd
from metrosep.spectral.streaming import StreamedPsd
from metrosep.spectral.window import hann_weights, taper_weights

Window = Literal["none", "hann"] | float

_DOCS = {
    "profile": """
        profile : Profile
            Uniform and complete, at least 4 samples.
        window : {"none", "hann"} or float, optional
            Periodic Hann, or the fraction 0 ... 1 of a periodic cosine taper.
        detrend : {"mean", "line"} or None, optional
            What is taken off before the window.
        """,
    "profile_raises": """
        DataError
            If an option is unknown, or it is not a profile.
        InvalidSamplesError
            If a sample was not measured.
        NotUniformError
            If the positions are not uniform.
        TooFewSamplesError
            If there are fewer than 4 samples.
        """,
    "surface": """
        surface : Surface
            Complete, at least 4 x 4, with both lateral steps.
        window : {"none", "hann"} or float, optional
            Periodic Hann, or the fraction 0 ... 1 of a periodic cosine taper, along both axes.
        detrend : {"mean", "plane"} or None, optional
            What is taken off before the window.
        """,
    "surface_raises": """
        DataError
            If an option is unknown, it is not a surface, or the surface has no lateral step.
        InvalidSamplesError
            If a pixel was not measured.
        TooFewSamplesError
            If there are fewer than 4 rows or columns.
        """,
}

_ON_LIMIT = 1e-9
"""A wavelength this close to the limit of a band, relative, lies on it and belongs to it."""


@documented(**_DOCS)
def profile_psd(
    profile: Profile,
    *,
    window: Window = "none",
    detrend: Literal["mean", "line"] | None = "mean",
) -> Psd:
    """Return the one-sided power spectral density of a profile.

    Parameters
    ----------
    $profile

    Returns
    -------
    Psd
        Periodogram; no segments are averaged.

    Raises
    ------
    $profile_raises

    Notes
    -----
    ``c |sum w z exp(-2 pi i f x)|^2 dx / sum w^2``, c = 2 but 1 at zero and at the Nyquist
    frequency. With ``detrend="line"`` it integrates to the variance about the line.

    Examples
    --------
    >>> import numpy as np
    >>> z = np.random.default_rng(1).standard_normal(1000)
    >>> psd = profile_psd(Profile(np.arange(1000) * 1e-6, z))
    >>> round(psd.variance() / float(z.var()), 12)
    1.0
    """
    z, weights = _prepared_profile(profile, window, detrend)
    n, dx = z.size, profile.dx
    power = np.abs(np.fft.rfft(z * weights)) ** 2
    power[1 : (n + 1) // 2] *= 2.0
    density = power * (dx / float(weights @ weights))
    step = Step("profile_psd", {"window": window, "detrend": detrend})
    return Psd(_frequencies(n, dx), density, (*profile.history, step))


@documented(**_DOCS)
def amplitude_spectrum(
    profile: Profile,
    *,
    window: Window = "hann",
    detrend: Literal["mean", "line"] | None = "mean",
) -> AmplitudeSpectrum:
    """Return the amplitudes of the waves in a profile, corrected for the gain of the window.

    Parameters
    ----------
    $profile

    Returns
    -------
    AmplitudeSpectrum
        Amplitude and phase of each frequency.

    Raises
    ------
    $profile_raises

    Notes
    -----
    A wave whose wavelength divides the record is exact; with Hann its two neighbours read half of
    it. Between two bins the peak reads down to 15 % less with Hann, 36 % less without a window.

    Examples
    --------
    >>> import numpy as np
    >>> i = np.arange(4000)
    >>> wave = Profile(i * 1e-6, 50e-9 * np.cos(2 * np.pi * 40 * i / 4000 + 0.3))
    >>> (amplitude_spectrum(wave).amplitude[38:43] * 1e9).round(6).tolist()
    [0.0, 25.0, 50.0, 25.0, 0.0]
    """
    z, weights = _prepared_profile(profile, window, detrend)
    n = z.size
    line = np.fft.rfft(z * weights) / weights.sum()
    amplitude = np.abs(line)
    amplitude[1 : (n + 1) // 2] *= 2.0
    step = Step("amplitude_spectrum", {"window": window, "detrend": detrend})
    return AmplitudeSpectrum(
        _frequencies(n, profile.dx), amplitude, np.angle(line), (*profile.history, step)
    )


@documented(**_DOCS)
def areal_psd(
    surface: Surface,
    *,
    window: Window = "none",
    detrend: Literal["mean", "plane"] | None = "mean",
) -> ArealPsd:
    """Return the two-sided power spectral density of a surface.

    Parameters
    ----------
    $surface

    Returns
    -------
    ArealPsd
        Over fx and fy.

    Raises
    ------
    $surface_raises

    Examples
    --------
    >>> import numpy as np
    >>> z = np.random.default_rng(1).standard_normal((40, 50))
    >>> psd = areal_psd(Surface(z, 1e-6, 2e-6))
    >>> round(psd.variance() / float(z.var()), 12)
    1.0
    """
    from scipy import fft

    instance_of(surface, Surface, "an areal spectrum")
    dx, dy = lateral_steps(surface, ", so it has no frequencies in 1/m")
    z = _complete(surface.z, "surface", "pixels", 4)
    z = _detrended(z, detrend, "plane")
    w_y, w_x = (_weights(n, window) for n in z.shape)
    z = z * w_x * w_y[:, np.newaxis]
    power = np.abs(fft.fft2(z)) ** 2
    scale = dx * dy / float((w_x @ w_x) * (w_y @ w_y))
    f_y, f_x = (fft.fftshift(fft.fftfreq(n, s)) for n, s in zip(z.shape, (dy, dx), strict=True))
    step = Step("areal_psd", {"window": window, "detrend": detrend})
    return ArealPsd(f_x, f_y, fft.fftshift(power) * scale, (*surface.history, step))


@documented(**_DOCS)
def radial_psd(
    surface: Surface,
    *,
    window: Window = "none",
    detrend: Literal["mean", "plane"] | None = "mean",
) -> RadialPsd:
    """Return the areal power spectral density averaged over all directions.

    Parameters
    ----------
    $surface

    Returns
    -------
    RadialPsd
        In rings as wide as the larger of the two frequency steps.

    Raises
    ------
    $surface_raises

    Notes
    -----
    ``sum(density * area)`` is the variance exactly. The textbook ``sum(density * 2 pi f df)``
    is it only up to the count of samples per ring, and too large beyond the Nyquist circle.

    Examples
    --------
    >>> import numpy as np
    >>> z = np.random.default_rng(1).standard_normal((40, 50))
    >>> round(radial_psd(Surface(z, 1e-6, 2e-6)).variance() / float(z.var()), 12)
    1.0
    """
    areal = areal_psd(surface, window=window, detrend=detrend)
    width = max(float(np.diff(f[:2])[0]) for f in (areal.frequency_x, areal.frequency_y))
    radius = areal.radial_frequency().ravel()
    used = radius > 0.0
    ring = np.maximum(np.rint(radius[used] / width).astype(np.intp), 1)
    count = np.bincount(ring)
    full = np.flatnonzero(count)
    count = count[full]
    step = Step("radial_psd", {"window": window, "detrend": detrend})
    return RadialPsd(
        np.bincount(ring, radius[used])[full] / count,
        np.bincount(ring, areal.density.ravel()[used])[full] / count,
        np.asarray(count * areal.cell, dtype=np.float64),
        np.asarray((count + 1) // 2, dtype=np.int64),  # f and -f are one
        (*surface.history, step),
    )


def band_rms(psd: Psd | ArealPsd | RadialPsd, band: Band) -> float:
    """Return the RMS height of the waves in a band.

    Parameters
    ----------
    psd : Psd, ArealPsd or RadialPsd
        A density.
    band : Band
        Wavelengths, both limits included; an open side has no limit.

    Returns
    -------
    float, m
        Root of the sum over the frequencies in the band; for a surface their distance from zero
        counts.

    Raises
    ------
    DataError
        If no frequency of the density lies in the band.

    Notes
    -----
    Zero frequency is in no band. A radial density puts a whole ring in or out by its mean
    frequency; use the areal one where the limit must be sharp.

    Examples
    --------
    >>> import numpy as np
    >>> x = np.arange(1000) * 1e-6
    >>> z = np.cos(2 * np.pi * x / 10e-6) + 3 * np.cos(2 * np.pi * x / 100e-6)
    >>> psd = profile_psd(Profile(x, z))
    >>> [round(band_rms(psd, b) * 2**0.5, 9) for b in (Band(longest=50e-6), Band(shortest=50e-6))]
    [1.0, 3.0]
    """
    if isinstance(psd, ArealPsd):
        inside = _in_band(psd.radial_frequency(), band)
        total = float(psd.density[inside].sum() * psd.cell)
    elif isinstance(psd, RadialPsd):
        inside = _in_band(psd.frequency, band)
        total = float(psd.density[inside] @ psd.area[inside])
    else:
        inside = _in_band(psd.frequency, band)
        total = float(psd.density[inside].sum() * psd.frequency[1])
    return math.sqrt(total)


def _in_band(frequency: FloatArray, band: Band) -> NDArray[np.bool_]:
    inside = frequency > 0.0
    if band.shortest is not None:
        inside &= frequency * band.shortest <= 1.0 + _ON_LIMIT
    if band.longest is not None:
        inside &= frequency * band.longest >= 1.0 - _ON_LIMIT
    if not inside.any():
        f = frequency[frequency > 0.0]
        raise DataError(
            f"no wave of the data lies in {band!r}: their wavelengths run from {1 / f.max():.3g} m "
            f"to {1 / f.min():.3g} m; is the unit m?"
        )
    return inside


def _prepared_profile(
    profile: Profile, window: Window, detrend: str | None
) -> tuple[FloatArray, FloatArray]:
    instance_of(profile, Profile, "the spectrum of a profile")
    z = _complete(profile.z, "profile", "samples", 4)
    _ = profile.dx  # refuses positions that are not uniform
    return _detrended(z, detrend, "line"), _weights(z.size, window)


def _complete(z: FloatArray, what: str, of: str, minimum: int) -> FloatArray:
    if min(z.shape) < minimum:
        raise TooFewSamplesError(
            f"a spectrum needs at least {minimum} samples in each axis, got shape {z.shape}"
        )
    missing = int(np.isnan(z).sum())
    if missing:
        raise InvalidSamplesError(
            f"{missing} of {z.size} {of} of the {what} were not measured; a spectrum needs all of "
            "them: crop to a complete part, or fill the gaps yourself (say by a filter with "
            "fill=True); spectra of gapped data (Lomb) are not offered"
        )
    return z


def _detrended(z: FloatArray, detrend: str | None, trend: str) -> FloatArray:
    """Return z less its mean, or less its least-squares line or plane: orthogonal on a full grid."""
    if detrend is None:
        return z
    choice(detrend, "detrend", ("mean", trend))
    result = z - z.mean()
    if detrend == trend:
        for axis, n in enumerate(z.shape):
            t = np.linspace(-1.0, 1.0, n)
            if z.ndim == 2 and axis == 0:
                t = t[:, np.newaxis]
            square = float((t * t).sum()) * (z.size / n)
            result = result - float((result * t).sum()) / square * t
    return np.asarray(result)


def _weights(n: int, window: object) -> FloatArray:
    if window == "none":
        return np.ones(n)
    if window == "hann":
        return hann_weights(n)
    if isinstance(window, int | float):
        return taper_weights(n, float(window))
    raise DataError(
        f'window must be "none", "hann" or a tapered fraction of 0 ... 1, got {window!r}'
    )


def _frequencies(n: int, dx: float) -> FloatArray:
    return np.asarray(np.arange(n // 2 + 1) / (n * dx))


# ---- power spectral density of short records, pooled over runs; it integrates to the variance ----


def pooled_periodogram(
    records: Sequence[FloatArray], *, time_step: float, n_fft: int | None = None
) -> tuple[FloatArray, FloatArray]:
    """Return the one-sided PSD averaged over the half-overlapping Hann segments of all records.

    Parameters
    ----------
    records : sequence of ndarray, shape (n_r,)
        Same sampling interval; segments that hold a NaN are omitted. The mean of each segment
        is removed.
    time_step : float, s
        Sampling interval.
    n_fft : int, optional
        Segment length; the shortest record, at most 1024, if omitted.

    Returns
    -------
    frequency : ndarray, shape (n_fft // 2,), Hz
        Without zero.
    density : ndarray, shape (n_fft // 2,)
        Squared unit of the data per Hz.

    Raises
    ------
    TooFewSamplesError
        If no complete segment of at least 16 samples exists.

    Notes
    -----
    For white noise of variance s^2 the expected integral over frequency is s^2, less the share
    of the removed mean.
    """
    shortest = min((r.size for r in records), default=0)
    size = n_fft or min(shortest, 1024)
    if size < 16:
        raise TooFewSamplesError(f"a spectrum needs records of >= 16 samples, got {size}")
    spectrum = StreamedPsd(time_step, size)
    for record in records:
        spectrum.new_record()
        spectrum.add(record)
    if spectrum.n_segments == 0:
        raise TooFewSamplesError(
            f"no unbroken segment of {size} samples; the records have too many gaps"
        )
    return spectrum.frequency, spectrum.density
