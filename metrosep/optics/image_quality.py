"""What a wavefront error does to the image: Strehl ratio, point spread and modulation transfer.

All by the Fourier transform of the pupil function ``A exp(2 pi i L / wavelength)`` (Fraunhofer),
normalised to what the same pupil gives without error. L is the lag of the wave: a longer path is
positive, and light goes to where the lag grows. A mirror leads where it is high, so its L is the
negative of `Wavefront.opd`. Sources: Goodman, Introduction to Fourier Optics, sections 3.10 and 6;
Born & Wolf 9.1 for the approximation of Marechal.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from metrosep.core._arrays import FloatArray
from metrosep.core.errors import DataError, InvalidSamplesError, TooFewSamplesError
from metrosep.core.numbers import count, not_negative, positive
from metrosep.optics.rays import freeze_fields, real_array, wavelength_of

_LEAST_PAD = 2
"""Below it the autocorrelation of the pupil wraps around."""

_WHOLE_STEP = 0.5
"""Waves from pixel to pixel beyond which the phase is not sampled."""

_MOST_POINTS = 2**27
"""Of the padded field: 2 GiB of complex numbers."""

_SMALL = 30.0
"""Phase error in rad beyond which the ratio of Marechal is 0 in double precision."""


@dataclass(frozen=True, slots=True, eq=False)
class PointSpread:
    """Point spread function over the angle in image space.

    Parameters
    ----------
    angle_x, angle_y : ndarray, shape (n_x,) and (n_y,), rad
        Directions of the light from the axis, as sines; times the focal length they are positions
        in the image. Positive where the light goes towards positive x and y of the pupil.
    intensity : ndarray, shape (n_y, n_x)
        1 at the peak of the same pupil without error.
    wavelength : float, m
        Of the light.
    diameter : float, m
        Of the pupil, across its measured part.
    index : float, optional
        Refractive index of the medium behind the pupil; wavelengths are those of vacuum.
    """

    angle_x: FloatArray
    angle_y: FloatArray
    intensity: FloatArray
    wavelength: float
    diameter: float
    index: float = 1.0

    def __post_init__(self) -> None:
        freeze_fields(self, "angle_x", "angle_y", "intensity")

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
        fx = _frequencies(n_x, self.angle_x)
        fy = _frequencies(n_y, self.angle_y)
        return ModulationTransfer(
            fx,
            spectrum[0, : fx.size],
            fy,
            spectrum[: fy.size, 0],
            self.diameter * self.index / self.wavelength,
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
        Largest diameter over wavelength: no contrast beyond it.
    """

    frequency_x: FloatArray
    along_x: FloatArray
    frequency_y: FloatArray
    along_y: FloatArray
    cutoff: float

    def __post_init__(self) -> None:
        freeze_fields(self, "frequency_x", "along_x", "frequency_y", "along_y")

    def ideal(self, frequency: ArrayLike) -> FloatArray:
        """Return the contrast of a full circular pupil without error.

        Parameters
        ----------
        frequency : array_like, 1/rad
            Where.

        Returns
        -------
        ndarray
            ``(2 / pi) (arccos v - v sqrt(1 - v^2))``, v = frequency / cutoff; 0 beyond, NaN where
            the frequency is.

        Raises
        ------
        InvalidSamplesError
            If a frequency is infinite or no real number.
        """
        v = np.clip(np.abs(real_array(frequency, "frequency", "1/rad")) / self.cutoff, 0.0, 1.0)
        out: FloatArray = 2.0 / np.pi * (np.arccos(v) - v * np.sqrt(1.0 - v * v))
        return out


def point_spread(
    opd: ArrayLike,
    dx: float,
    dy: float,
    *,
    wavelength: float | str,
    amplitude: ArrayLike | None = None,
    pad: int = 4,
    index: float = 1.0,
) -> PointSpread:
    """Return the point spread function of a pupil.

    Parameters
    ----------
    opd : array_like, shape (n_y, n_x), m
        Lag of the wave: positive where its path is longer. NaN outside the pupil or where it is not
        known. Of a mirror it is the negative of `Wavefront.opd`, as `Wavefront.point_spread` knows.
    dx, dy : float, m
        Steps of the grid, x along the columns.
    wavelength : float (m) or str with unit
        Of the light in vacuum, from 1e-8 to 1e-2.
    amplitude : array_like, shape (n_y, n_x), optional
        Transmission of the amplitude, 0 to 1; 1 in the pupil if omitted.
    pad : int, optional
        The pupil is laid into a field this many times as large, >= 2.
    index : float, optional
        Refractive index of the medium behind the pupil: within it angles are smaller.

    Returns
    -------
    PointSpread
        Directions and intensity.

    Raises
    ------
    DataError
        If a number is not one that can be used, or the field would not fit into memory.
    InvalidSamplesError
        If opd or amplitude is not a map of finite real numbers, or their shapes differ.
    TooFewSamplesError
        If the phase turns by more than half a wave from pixel to pixel, or nothing is known.

    Notes
    -----
    Parts of the pupil that were not measured count as dark: the image is that of the measured part.
    With lag L, ``|sum A exp(2 pi i (L - x u - y v) / wavelength)|^2`` at the direction (u, v): a lag
    ``s x`` puts the image at u = s [1]_.

    References
    ----------
    .. [1] Goodman, Introduction to Fourier Optics, 2nd ed., section 3.10 (angular spectrum).

    Examples
    --------
    >>> import numpy as np
    >>> lag = 2e-4 * 1e-4 * np.arange(32.0) * np.ones((32, 1))  # grows by 0.2 mm per m along x
    >>> spread = point_spread(lag, 1e-4, 1e-4, wavelength=640e-9)
    >>> round(spread.peak[1] * 1e3, 6)  # mrad
    0.2
    """
    light_of = wavelength_of(wavelength)
    step_x, step_y = positive(dx, "dx", dimension="length"), positive(dy, "dy", dimension="length")
    times = count(pad, "pad", least=_LEAST_PAD)
    behind = positive(index, "index")
    path = real_array(opd, "opd")
    if path.ndim != 2 or path.size == 0:
        raise InvalidSamplesError(f"opd must be a map (rows y, columns x), got shape {path.shape}")
    light = _light(path, amplitude)
    total = float(light.sum())
    if total <= 0.0:
        raise TooFewSamplesError("the pupil is dark: no point of the wavefront is known")
    n_y, n_x = (times * n for n in path.shape)
    if n_y * n_x > _MOST_POINTS:
        raise DataError(
            f"a field of {n_y} x {n_x} points is beyond {_MOST_POINTS} points: use a smaller pad or "
            "a coarser grid"
        )
    waves = np.where(light > 0.0, path, 0.0) / light_of
    _check_sampling(np.where(light > 0.0, waves, np.nan))
    field = np.zeros((n_y, n_x), dtype=np.complex128)
    field[: path.shape[0], : path.shape[1]] = light * np.exp(2j * np.pi * waves)
    spread = np.abs(np.fft.fftshift(np.fft.fft2(field))) ** 2 / total**2
    lit = np.argwhere(light > 0.0)
    spans = (np.ptp(lit, axis=0) + 1) * (step_y, step_x)
    return PointSpread(
        np.fft.fftshift(np.fft.fftfreq(n_x, step_x)) * (light_of / behind),
        np.fft.fftshift(np.fft.fftfreq(n_y, step_y)) * (light_of / behind),
        spread,
        light_of,
        float(spans.max()),
        behind,
    )


def strehl_ratio(opd: ArrayLike, weights: ArrayLike, *, wavelength: float | str) -> float:
    """Return the intensity on the axis against that without error.

    Parameters
    ----------
    opd : array_like, m
        Optical path difference, of either sign; NaN has no part.
    weights : array_like
        Area of each point, of the shape of opd, not negative.
    wavelength : float (m) or str with unit
        Of the light, from 1e-8 to 1e-2.

    Returns
    -------
    float
        ``|<exp(2 pi i W / wavelength)>|^2``, 0 to 1.

    Raises
    ------
    DataError
        If the wavelength is not one of light.
    InvalidSamplesError
        If an array does not hold finite real numbers, a weight is negative or NaN, or shapes differ.
    TooFewSamplesError
        If nothing is known.

    Examples
    --------
    >>> round(strehl_ratio([0.0, 100e-9], [1.0, 1.0], wavelength=600e-9), 6)  # cos^2(pi / 6)
    0.75
    """
    light = wavelength_of(wavelength)
    path, area = real_array(opd, "opd"), real_array(weights, "weights", "any unit of area")
    if path.shape != area.shape:
        raise InvalidSamplesError(
            f"opd and weights must have one shape, got {path.shape} and {area.shape}"
        )
    if not (area >= 0.0).all():
        place = tuple(int(i) for i in np.argwhere(~(area >= 0.0))[0])
        raise InvalidSamplesError(
            f"weights are areas, 0 or more and never NaN; got {area[place]} at index {place}"
        )
    good = ~np.isnan(path) & (area > 0.0)
    if not good.any():
        raise TooFewSamplesError("no point of the wavefront is known")
    phase = np.exp(2j * np.pi * path[good] / light)
    share = area[good] / float(area[good].max())  # of areas whose sum may overflow
    return float(abs((share * phase).sum() / share.sum()) ** 2)


def marechal(rms: float, *, wavelength: float | str) -> float:
    """Return the Strehl ratio of a small error: ``exp(-(2 pi rms / wavelength)^2)``.

    Parameters
    ----------
    rms : float, m
        Of the wavefront about its mean.
    wavelength : float (m) or str with unit
        Of the light, from 1e-8 to 1e-2.

    Returns
    -------
    float
        Within 0.02 of the exact ratio down to about 0.6; for defocus 0.027 too high at 0.5.

    Raises
    ------
    DataError
        If the wavelength is not one of light, or the rms is negative or no finite number.

    Examples
    --------
    >>> round(marechal(633e-9 / 14, wavelength=633e-9), 3)
    0.818
    """
    light, size = wavelength_of(wavelength), not_negative(rms, "rms", dimension="length")
    phase = min(2.0 * np.pi * size / light, _SMALL)
    return float(np.exp(-(phase**2))) if phase < _SMALL else 0.0


def _frequencies(n: int, angle: FloatArray) -> FloatArray:
    return np.asarray(np.fft.rfftfreq(n, float(angle[1] - angle[0])), dtype=np.float64)


def _light(path: FloatArray, amplitude: ArrayLike | None) -> FloatArray:
    """Return the amplitude in the pupil, 0 where the path is not known."""
    if amplitude is None:
        return (~np.isnan(path)).astype(np.float64)
    light = real_array(amplitude, "amplitude", "parts of 1")
    known = ~np.isnan(path)
    if light.shape != path.shape or not ((light[known] >= 0.0) & (light[known] <= 1.0)).all():
        raise InvalidSamplesError(
            f"amplitude must have the shape of opd, {path.shape}, and lie between 0 and 1 wherever "
            "opd is known"
        )
    out: FloatArray = np.where(known, light, 0.0)
    return out


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
