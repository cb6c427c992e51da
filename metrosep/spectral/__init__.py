"""Windows, spectra, transforms on exact wavelengths, and autoregressive noise models."""

from __future__ import annotations

from typing import TYPE_CHECKING

from metrosep.core._lazy import lazy_names
from metrosep.spectral.autoregressive import AutoregressiveModel, fit_autoregressive, whiten
from metrosep.spectral.density import (
    amplitude_spectrum,
    areal_psd,
    band_rms,
    pooled_periodogram,
    profile_psd,
    radial_psd,
)
from metrosep.spectral.dft import Band, fourier_basis, fourier_coefficients, fourier_sum
from metrosep.spectral.spectra import AmplitudeSpectrum, ArealPsd, Psd, RadialPsd
from metrosep.spectral.streaming import BinnedMean, StreamedPsd
from metrosep.spectral.window import (
    coherent_gain,
    hann_weights,
    kono_weights,
    noise_bandwidth,
    taper_weights,
    tukey_weights,
)

if TYPE_CHECKING:
    from metrosep.spectral.masked import MaskedPsd as MaskedPsd, masked_psd as masked_psd

__all__ = [
    "AmplitudeSpectrum",
    "ArealPsd",
    "AutoregressiveModel",
    "Band",
    "BinnedMean",
    "MaskedPsd",
    "Psd",
    "RadialPsd",
    "StreamedPsd",
    "amplitude_spectrum",
    "areal_psd",
    "band_rms",
    "coherent_gain",
    "fit_autoregressive",
    "fourier_basis",
    "fourier_coefficients",
    "fourier_sum",
    "hann_weights",
    "kono_weights",
    "masked_psd",
    "noise_bandwidth",
    "pooled_periodogram",
    "profile_psd",
    "radial_psd",
    "taper_weights",
    "tukey_weights",
    "whiten",
]

__getattr__ = lazy_names(__name__, {"masked": ["MaskedPsd", "masked_psd"]})
