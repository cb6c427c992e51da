"""What a wavefront error does to the image: Strehl ratio, point spread and modulation transfer.

All by the Fourier transform of the pupil function ``A exp(2 pi i W / wavelength)`` (Fraunhofer),
normalised to what the same pupil gives without error. Sources: Goodman, Introduction to Fourier
Optics, chapter 6; Born & Wolf 9.1 for the approximation of Marechal.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from metrosep.core._arrays import FloatArray
from metrosep.core.errors import DataError, TooFewSamplesError

__all__ = ["ModulationTransfer", "PointSpread", "marechal", "point_spread", "strehl_ratio"]

_LEAST_PAD = 2
"""Below it the autocorrelation of the pupil wraps around."""

_WHOLE_STEP = 0.5
"""Waves from pixel to pixel beyond which the phase is not sampled."""


@dataclass(frozen=True, slots=True, eq=False)
class PointSpread:
    """Point spread function over the angle in image space.

    Parameters
    ----------
    angle_x, angle_y : ndarray, shape (n_x,) and (n_y,), rad
        Directions from the axis; times the focal length they are positions in the image.
    intensity : ndarray, shape (n_y, n_x)
        1 at the peak of the same pupil without error.
    wavelength : float, m
        Of the light.
    diameter : float, m
        Of the pupil, across its measured part.
    """

    angle_x: FloatArray
    angle_y: FloatArray
    intensity: FloatArray
    wavelength: float
    diameter: float

    @property
    def strehl(self) -> float:
        """Intensity on the axis."""
        row, column = (n // 2 for n in self.intensity.shape)
        return float(self.intensity[row, column])

    @property
    def peak(self) -> tuple[float, float, float]:
        """Largest intensity, and where it is: angles in x and y, rad."""
        row, column = np.unravel_index(int(self.intensity.argmax()), self.intensity.shape)
        return (
            float(self.intensity[row, column]),
            float(self.angle_x[column]),
            float(self.angle_y[row]),
        )

    def modulation_transfer(self) -> ModulationTransfer:
        """Return the modulation transfer function, the spectrum of the point spread.

        Returns
        -------
        ModulationTransfer
            Along x and along y.
        """
        spectrum = np.abs(np.fft.fft2(np.fft.ifftshift(self.intensity)))
        spectrum /= spectrum[0, 0]
        n_y, n_x = self.intensity.shape
        fx = np.fft.rfftfreq(n_x, float(self.angle_x[1] - self.angle_x[0]))
        fy = np.fft.rfftfreq(n_y, float(self.angle_y[1] - self.angle_y[0]))
        return ModulationTransfer(
            _frozen(fx),
            _frozen(spectrum[0, : fx.size]),
            _frozen(fy),
            _frozen(spectrum[: fy.size, 0]),
            self.diameter / self.wavelength,
        )


@dataclass(frozen=True, slots=True, eq=False)
class ModulationTransfer:
    """Modulation transfer function along both axes.

    Parameters
    ----------
    frequency_x : ndarray, 1/rad
        Cycles per radian; over the focal length they are lines per metre of the image.
    along_x : ndarray
        Contrast of lines across x, 1 at frequency 0.
    frequency_y : ndarray, 1/rad
        Of `along_y`.
    along_y : ndarray
        Contrast of lines across y.
    cutoff : float, 1/rad
        Diameter over wavelength: no contrast beyond it.
    """

    frequency_x: FloatArray
    along_x: FloatArray
    frequency_y: FloatArray
    along_y: FloatArray
    cutoff: float

    def ideal(self, frequency: ArrayLike) -> FloatArray:
        """Return the contrast of a full circular pupil without error.

        Parameters
        ----------
        frequency : array_like, 1/rad
            Where.

        Returns
        -------
        ndarray
            ``(2 / pi) (arccos v - v sqrt(1 - v^2))``, v = frequency / cutoff; 0 beyond.
        """
        v = np.clip(np.abs(np.asarray(frequency, dtype=np.float64)) / self.cutoff, 0.0, 1.0)
        out: FloatArray = 2.0 / np.pi * (np.arccos(v) - v * np.sqrt(1.0 - v * v))
        return out


def point_spread(
    opd: ArrayLike,
    dx: float,
    dy: float,
    *,
    wavelength: float,
    amplitude: ArrayLike | None = None,
    pad: int = 4,
) -> PointSpread:
    """Return the point spread function of a pupil.

    Parameters
    ----------
    opd : array_like, shape (n_y, n_x), m
        Optical path difference; NaN outside the pupil or where it is not known.
    dx, dy : float, m
        Steps of the grid.
    wavelength : float, m
        Of the light.
    amplitude : array_like, shape (n_y, n_x), optional
        Transmission of the amplitude, 0 to 1; 1 in the pupil if omitted.
    pad : int, optional
        The pupil is laid into a field this many times as large, >= 2.

    Returns
    -------
    PointSpread
        Directions and intensity.

    Raises
    ------
    DataError
        If a number is not one that can be used, or shapes differ.
    TooFewSamplesError
        If the phase turns by more than half a wave from pixel to pixel, or nothing is known.

    Notes
    -----
    Parts of the pupil that were not measured count as dark: the image is that of the measured part.
    """
    _positive(wavelength=wavelength, dx=dx, dy=dy)
    if int(pad) != pad or pad < _LEAST_PAD:
        raise DataError(f"pad must be a whole number from {_LEAST_PAD} on, got {pad}")
    path = np.asarray(opd, dtype=np.float64)
    if path.ndim != 2:
        raise DataError(f"opd must be a map, got shape {path.shape}")
    light = np.ones(path.shape) if amplitude is None else np.asarray(amplitude, dtype=np.float64)
    if light.shape != path.shape or not ((light >= 0.0) & (light <= 1.0)).all():
        raise DataError("amplitude must have the shape of opd and lie between 0 and 1")
    light = np.where(np.isnan(path), 0.0, light)
    total = float(light.sum())
    if total <= 0.0:
        raise TooFewSamplesError("the pupil is dark: no point of the wavefront is known")
    waves = np.where(light > 0.0, path, 0.0) / wavelength
    _check_sampling(np.where(light > 0.0, waves, np.nan))
    n_y, n_x = (int(pad) * n for n in path.shape)
    field = np.zeros((n_y, n_x), dtype=np.complex128)
    field[: path.shape[0], : path.shape[1]] = light * np.exp(2j * np.pi * waves)
    spread = np.abs(np.fft.fftshift(np.fft.fft2(field))) ** 2 / total**2
    lit = np.argwhere(light > 0.0)
    spans = (np.ptp(lit, axis=0) + 1) * (dy, dx)
    return PointSpread(
        _frozen(np.fft.fftshift(np.fft.fftfreq(n_x, dx)) * wavelength),
        _frozen(np.fft.fftshift(np.fft.fftfreq(n_y, dy)) * wavelength),
        _frozen(spread),
        float(wavelength),
        float(spans.max()),
    )


def strehl_ratio(opd: ArrayLike, weights: ArrayLike, *, wavelength: float) -> float:
    """Return the intensity on the axis against that without error.

    Parameters
    ----------
    opd : array_like, m
        Optical path difference; NaN has no part.
    weights : array_like
        Area of each point, of the shape of opd.
    wavelength : float, m
        Of the light.

    Returns
    -------
    float
        ``|<exp(2 pi i W / wavelength)>|^2``, 0 to 1.

    Raises
    ------
    DataError
        If the wavelength is not positive.
    TooFewSamplesError
        If nothing is known.
    """
    _positive(wavelength=wavelength)
    path, area = np.asarray(opd, dtype=np.float64), np.asarray(weights, dtype=np.float64)
    good = ~np.isnan(path) & (area > 0.0)
    if not good.any():
        raise TooFewSamplesError("no point of the wavefront is known")
    phase = np.exp(2j * np.pi * path[good] / wavelength)
    return float(abs((area[good] * phase).sum() / area[good].sum()) ** 2)


def marechal(rms: float, *, wavelength: float) -> float:
    """Return the Strehl ratio of a small error: ``exp(-(2 pi rms / wavelength)^2)``.

    Parameters
    ----------
    rms : float, m
        Of the wavefront about its mean.
    wavelength : float, m
        Of the light.

    Returns
    -------
    float
        Within 0.02 of the exact ratio down to about 0.5.

    Raises
    ------
    DataError
        If the wavelength is not positive, or the rms is negative.

    Examples
    --------
    >>> round(marechal(633e-9 / 14, wavelength=633e-9), 3)
    0.818
    """
    _positive(wavelength=wavelength)
    if not rms >= 0.0:
        raise DataError(f"rms must not be negative, got {rms}")
    return float(np.exp(-((2.0 * np.pi * rms / wavelength) ** 2)))


def _check_sampling(waves: FloatArray) -> None:
    for axis, name in ((0, "y"), (1, "x")):
        if waves.shape[axis] < 2:
            continue
        steps = np.abs(np.diff(waves, axis=axis))
        known = steps[~np.isnan(steps)]
        if known.size and float(known.max()) > _WHOLE_STEP:
            raise TooFewSamplesError(
                f"the wavefront changes by {float(known.max()):.2f} waves from pixel to pixel along "
                f"{name}: sample it more finely, or remove tilt and defocus first"
            )


def _positive(**values: float) -> None:
    for name, value in values.items():
        if not (np.isfinite(value) and value > 0.0):
            raise DataError(f"{name} must be positive and finite, in m, got {value}")


def _frozen(values: ArrayLike) -> FloatArray:
    array: FloatArray = np.ascontiguousarray(values, dtype=np.float64)
    array.setflags(write=False)
    return array
