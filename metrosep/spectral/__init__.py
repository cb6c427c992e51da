"""Windows, transforms on exact wavelengths, and autoregressive noise models; arrays in, arrays out."""

from __future__ import annotations

from metrosep.spectral.autoregressive import AutoregressiveModel, fit_autoregressive, whiten
from metrosep.spectral.dft import fourier_basis, fourier_coefficients, fourier_sum
from metrosep.spectral.psd import pooled_periodogram
from metrosep.spectral.streaming import BinnedMean, StreamedPsd
from metrosep.spectral.window import kono_weights, tukey_weights

__all__ = [
    "AutoregressiveModel",
    "BinnedMean",
    "StreamedPsd",
    "fit_autoregressive",
    "fourier_basis",
    "fourier_coefficients",
    "fourier_sum",
    "kono_weights",
    "pooled_periodogram",
    "tukey_weights",
    "whiten",
]
