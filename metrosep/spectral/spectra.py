"""What the spectra of profiles and surfaces are returned as; `density` computes them."""

from __future__ import annotations

from dataclasses import dataclass, fields
from typing import Any, cast

import numpy as np
from numpy.typing import NDArray

from metrosep.core._arrays import FloatArray
from metrosep.core.provenance import Step


class _Spectrum:
    """What all spectra share: arrays that cannot be written to, and a unit of the density."""

    __slots__ = ()
    _unit = "m^4"

    def __post_init__(self) -> None:
        for field in fields(cast(Any, self)):
            value = getattr(self, field.name)
            if isinstance(value, np.ndarray):
                value.setflags(write=False)

    @property
    def unit(self) -> str:
        """Unit of the density."""
        return self._unit


@dataclass(frozen=True, slots=True, eq=False)
class Psd(_Spectrum):
    """One-sided power spectral density of a profile.

    Parameters
    ----------
    frequency : ndarray, shape (n // 2 + 1,), 1/m
        From 0 in steps of ``1 / (n dx)``.
    density : ndarray, shape (n // 2 + 1,), m^3
        Its sum times the step is the mean square of the windowed heights over that of the window.
    history : tuple of Step, optional
        Of the profile, and this step.
    """

    frequency: FloatArray
    density: FloatArray
    history: tuple[Step, ...] = ()

    _unit = "m^3"

    def variance(self) -> float:
        """Return the sum over all frequencies but zero times their step.

        Returns
        -------
        float, m^2
            The variance of the heights, if there is no window.
        """
        return float(self.density[1:].sum() * self.frequency[1])


@dataclass(frozen=True, slots=True, eq=False)
class ArealPsd(_Spectrum):
    """Two-sided power spectral density of a surface.

    Parameters
    ----------
    frequency_x : ndarray, shape (n_x,), 1/m
        Ascending; 0 at ``n_x // 2``.
    frequency_y : ndarray, shape (n_y,), 1/m
        Ascending; 0 at ``n_y // 2``.
    density : ndarray, shape (n_y, n_x), m^4
        Its sum times both steps is the mean square of the windowed heights over that of the
        window.
    history : tuple of Step, optional
        Of the surface, and this step.
    """

    frequency_x: FloatArray
    frequency_y: FloatArray
    density: FloatArray
    history: tuple[Step, ...] = ()

    @property
    def cell(self) -> float:
        """Area of one sample of the spectrum, 1/m^2."""
        return float(
            (self.frequency_x[1] - self.frequency_x[0])
            * (self.frequency_y[1] - self.frequency_y[0])
        )

    def radial_frequency(self) -> FloatArray:
        """Return the distance of each sample from zero frequency.

        Returns
        -------
        ndarray, shape (n_y, n_x), 1/m
            ``sqrt(fx^2 + fy^2)``.
        """
        return np.asarray(np.hypot(self.frequency_x, self.frequency_y[:, np.newaxis]))

    def variance(self) -> float:
        """Return the sum over all frequencies but zero times their cell.

        Returns
        -------
        float, m^2
            The variance of the heights, if there is no window.
        """
        centre = self.density[self.frequency_y.size // 2, self.frequency_x.size // 2]
        return float((self.density.sum() - centre) * self.cell)


@dataclass(frozen=True, slots=True, eq=False)
class RadialPsd(_Spectrum):
    """Areal density averaged over all directions.

    Parameters
    ----------
    frequency : ndarray, shape (n,), 1/m
        Mean radial frequency of each ring, ascending, without zero.
    density : ndarray, shape (n,), m^4
        Mean over the ring.
    area : ndarray, shape (n,), 1/m^2
        Area that the ring's samples stand for: ``2 pi f df`` inside the Nyquist circle up to the
        grid, less in the corners outside it.
    n_averaged : ndarray of int, shape (n,)
        Independent samples in the ring; the relative uncertainty of its density is
        ``1 / sqrt(n_averaged)`` for a random surface.
    history : tuple of Step, optional
        Of the surface, and this step.
    """

    frequency: FloatArray
    density: FloatArray
    area: FloatArray
    n_averaged: NDArray[np.int64]
    history: tuple[Step, ...] = ()

    @property
    def u(self) -> FloatArray:
        """Standard uncertainty of the density of a random surface, m^4."""
        return np.asarray(self.density / np.sqrt(self.n_averaged))

    def variance(self) -> float:
        """Return the sum of density times area.

        Returns
        -------
        float, m^2
            Exactly that of the areal density.
        """
        return float(self.density @ self.area)


@dataclass(frozen=True, slots=True, eq=False)
class AmplitudeSpectrum(_Spectrum):
    """Amplitudes of the waves in a profile.

    Parameters
    ----------
    frequency : ndarray, shape (n // 2 + 1,), 1/m
        From 0 in steps of ``1 / (n dx)``.
    amplitude : ndarray, shape (n // 2 + 1,), m
        Of ``A cos(2 pi f (x - x0) + phase)``; at 0 the mean.
    phase : ndarray, shape (n // 2 + 1,), rad
        At the first sample x0.
    history : tuple of Step, optional
        Of the profile, and this step.
    """

    frequency: FloatArray
    amplitude: FloatArray
    phase: FloatArray
    history: tuple[Step, ...] = ()

    _unit = "m"
