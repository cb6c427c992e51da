"""Windows, spectra, transforms on exact wavelengths, and autoregressive noise models."""

from __future__ import annotations

from typing import TYPE_CHECKING

from metrosep.core._lazy import lazy_package

if TYPE_CHECKING:
    from metrosep.spectral.autoregressive import (
        AutoregressiveModel as AutoregressiveModel,
        fit_autoregressive as fit_autoregressive,
        whiten as whiten,
    )
    from metrosep.spectral.density import (
        amplitude_spectrum as amplitude_spectrum,
        areal_psd as areal_psd,
        band_rms as band_rms,
        pooled_periodogram as pooled_periodogram,
        profile_psd as profile_psd,
        radial_psd as radial_psd,
    )
    from metrosep.spectral.dft import (
        Band as Band,
        fourier_basis as fourier_basis,
        fourier_coefficients as fourier_coefficients,
        fourier_sum as fourier_sum,
    )
    from metrosep.spectral.masked import MaskedPsd as MaskedPsd, masked_psd as masked_psd
    from metrosep.spectral.spectra import (
        AmplitudeSpectrum as AmplitudeSpectrum,
        ArealPsd as ArealPsd,
        Psd as Psd,
        RadialPsd as RadialPsd,
    )
    from metrosep.spectral.streaming import BinnedMean as BinnedMean, StreamedPsd as StreamedPsd
    from metrosep.spectral.window import (
        coherent_gain as coherent_gain,
        hann_weights as hann_weights,
        kono_weights as kono_weights,
        noise_bandwidth as noise_bandwidth,
        taper_weights as taper_weights,
        tukey_weights as tukey_weights,
    )

__getattr__, __dir__ = lazy_package(__name__)
