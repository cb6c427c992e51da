"""What separations of repeated curves share: checks, means of repeats, removal of a basis.

Readings are arrays (n_readings, n_samples), or (n_readings, n_repeats, n_samples) where each was
repeated: passes of a slide, revolutions of a spindle.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from metrosep.core.errors import DataError, InvalidSamplesError, TooFewSamplesError
from metrosep.core.quantity import Quantity

FloatArray = NDArray[np.float64]
ComplexArray = NDArray[np.complex128]

NOISE_UNKNOWN = (
    "the noise of a reading is not known, so no uncertainty is stated: give repeats, or u_reading"
)


@dataclass(frozen=True, slots=True)
class Averaged:
    """Means of repeated readings.

    Parameters
    ----------
    mean : ndarray, shape (n_readings, n_samples)
        NaN where no repeat was measured.
    counts : ndarray, shape (n_readings, n_samples)
        How many repeats stand behind each mean.
    n_repeats : int
        Largest number of repeats.
    noise : Quantity
        Standard deviation of one reading; NaN where it is neither stated nor shown by repeats.
    """

    mean: FloatArray
    counts: FloatArray
    n_repeats: int
    noise: Quantity

    @property
    def messages(self) -> tuple[str, ...]:
        """What is to be said about the noise."""
        return (NOISE_UNKNOWN,) if math.isnan(self.noise.value) else ()


def checked_readings(
    readings: ArrayLike, *, names: Sequence[str], minimum: int, what: str
) -> FloatArray:
    """Return readings as (n_readings, n_repeats, n_samples), or refuse them.

    Parameters
    ----------
    readings : array_like, shape (n_readings, n_samples) or (n_readings, n_repeats, n_samples)
        NaN = not measured.
    names : sequence of str
        What each reading is called.
    minimum : int
        Samples that each must hold.
    what : str
        Name of the method for messages.

    Returns
    -------
    ndarray, shape (n_readings, n_repeats, n_samples)
        A copy in float64.

    Raises
    ------
    InvalidSamplesError
        If they are no numbers, infinite, of another shape, or nothing was measured.
    TooFewSamplesError
        If there are fewer than `minimum` samples.
    """
    try:
        array = np.array(readings, dtype=np.float64)
    except (TypeError, ValueError) as exc:
        raise InvalidSamplesError(
            f"{what} needs {len(names)} readings of equal length ({', '.join(names)}), got something "
            f"that is no array of numbers ({exc})"
        ) from None
    if array.ndim not in (2, 3) or array.shape[0] != len(names):
        raise InvalidSamplesError(
            f"{what} needs {len(names)} readings ({', '.join(names)}) as an array of shape "
            f"({len(names)}, n) or ({len(names)}, repeats, n), got {array.shape}"
        )
    if array.ndim == 2:
        array = array[:, None, :]
    if array.shape[2] < minimum or array.shape[1] < 1:
        raise TooFewSamplesError(
            f"{what} needs at least {minimum} samples in each reading, got {array.shape[2]}"
        )
    if np.isinf(array).any():
        i, r, j = (int(v) for v in np.argwhere(np.isinf(array))[0])
        raise InvalidSamplesError(
            f"{what}: {names[i]} is infinite at repeat {r}, sample {j}; mark what was not measured "
            "as NaN"
        )
    measured = ~np.isnan(array).all(axis=1)
    for name, row in zip(names, measured, strict=True):
        if row.sum() < minimum:
            raise TooFewSamplesError(
                f"{what}: {name} holds {int(row.sum())} measured samples, at least {minimum} are "
                "needed"
            )
    return array


def average_repeats(
    array: FloatArray, basis: FloatArray, *, u_reading: float | None, unit: str = "m"
) -> Averaged:
    """Return the means over repeats, and the noise of one reading.

    The noise is that of what remains when `basis` is removed from each repeat: an offset or an
    eccentricity that differs from repeat to repeat does not reach the result either.

    Parameters
    ----------
    array : ndarray, shape (n_readings, n_repeats, n_samples)
        Checked readings.
    basis : ndarray, shape (n_samples, p)
        Functions that are removed from the result.
    u_reading : float or None
        Stated standard uncertainty of one reading; it wins over the repeats.
    unit : str, optional
        Unit of the readings.

    Returns
    -------
    Averaged
        Means, counts, noise.

    Raises
    ------
    DataError
        If `u_reading` is negative or not finite.
    """
    counts = (~np.isnan(array)).sum(axis=1).astype(np.float64)
    total = np.where(np.isnan(array), 0.0, array).sum(axis=1)
    mean = np.where(counts > 0, total / np.maximum(counts, 1.0), np.nan)
    n_repeats = array.shape[1]
    if u_reading is not None:
        if not (math.isfinite(u_reading) and u_reading >= 0.0):
            raise DataError(
                f"u_reading is {u_reading}; it must be a standard uncertainty >= 0 in {unit}"
            )
        noise = Quantity(
            float(u_reading), unit, "standard uncertainty of one reading, as stated", symbol="s"
        )
    else:
        noise = _noise_of_repeats(array, mean, counts, basis, unit)
    return Averaged(mean, counts, n_repeats, noise)


def _noise_of_repeats(
    array: FloatArray, mean: FloatArray, counts: FloatArray, basis: FloatArray, unit: str
) -> Quantity:
    """Pool the scatter of all repeats about their means, the basis removed from each."""
    n_repeats, p = array.shape[1], basis.shape[1]
    squares, freedom = 0.0, 0.0
    if n_repeats > 1:
        for i in range(array.shape[0]):
            for repeat in array[i]:
                rest = without_basis(repeat - mean[i], basis)
                squares += float(np.nansum(rest**2))
            freedom += float(np.maximum(counts[i] - 1.0, 0.0).sum()) - p * (n_repeats - 1)
    if freedom < 1.0:
        return Quantity(math.nan, unit, "standard deviation of one reading; not known", symbol="s")
    value = math.sqrt(squares / freedom)
    text = f"standard deviation of one reading, pooled from {n_repeats} repeats (type A)"
    return Quantity(value, unit, text, u=value / math.sqrt(2.0 * freedom), symbol="s")


def without_basis(values: FloatArray, basis: FloatArray) -> FloatArray:
    """Return values minus their least-squares combination of the basis; NaN stay NaN.

    Parameters
    ----------
    values : ndarray, shape (n,)
        Curve.
    basis : ndarray, shape (n, p)
        What is removed.

    Returns
    -------
    ndarray, shape (n,)
        The rest.
    """
    valid = ~np.isnan(values)
    found = np.linalg.lstsq(basis[valid], values[valid], rcond=None)[0]
    return np.asarray(values - basis @ found)


def left_share(valid: NDArray[np.bool_], basis: FloatArray) -> FloatArray:
    """Return the share of a white variance that removing the basis leaves, sample by sample.

    Parameters
    ----------
    valid : ndarray of bool, shape (n,)
        Samples that take part.
    basis : ndarray, shape (n, p)
        What is removed.

    Returns
    -------
    ndarray, shape (n,)
        ``1 - leverage``; NaN where not valid.
    """
    share = np.full(valid.size, np.nan)
    q, _ = np.linalg.qr(basis[valid])
    share[valid] = np.maximum(1.0 - np.sum(q**2, axis=1), 0.0)
    return share


def low_harmonics(angle: FloatArray, highest: int = 1) -> FloatArray:
    """Return 1, cos and sin up to a harmonic as columns.

    Parameters
    ----------
    angle : ndarray, shape (n,), rad
        Where.
    highest : int, optional
        0 for the mean alone, 1 with the eccentricity.

    Returns
    -------
    ndarray, shape (n, 1 + 2 highest)
        Columns.
    """
    columns = [np.ones(angle.size)]
    for k in range(1, highest + 1):
        columns += [np.cos(k * angle), np.sin(k * angle)]
    return np.column_stack(columns)


def line_basis(x: FloatArray) -> FloatArray:
    """Return 1 and the centred, scaled position as columns.

    Parameters
    ----------
    x : ndarray, shape (n,), m
        Positions.

    Returns
    -------
    ndarray, shape (n, 2)
        Columns of order one.
    """
    half = max(float(np.ptp(x)) / 2.0, np.finfo(np.float64).tiny)
    return np.column_stack([np.ones(x.size), (x - (x.min() + x.max()) / 2.0) / half])


def harmonics_of(
    values: FloatArray, u: FloatArray, hidden: Sequence[int]
) -> tuple[ComplexArray, FloatArray]:
    """Return one-sided Fourier coefficients of a closed curve and their standard uncertainty.

    Parameters
    ----------
    values : ndarray, shape (n,)
        Curve on equal angles over one turn.
    u : ndarray, shape (n,)
        Standard uncertainty, independent from sample to sample.
    hidden : sequence of int
        Harmonics that are not observable; they become NaN.

    Returns
    -------
    coefficients : ndarray of complex, shape (K + 1,)
        ``c_k`` of ``sum Re(c_k exp(j k angle))``; all NaN where the curve has gaps.
    uncertainty : ndarray, shape (K + 1,)
        Of the real and of the imaginary part.
    """
    n = values.size
    top = (n - 1) // 2
    if np.isnan(values).any():
        return np.full(top + 1, np.nan + 1j * np.nan), np.full(top + 1, np.nan)
    coefficients = np.fft.rfft(values)[: top + 1] * (2.0 / n)
    coefficients[0] /= 2.0
    known = u[np.isfinite(u)]
    one = math.sqrt(float(np.mean(known**2)) * 2.0 / n) if known.size else math.nan
    spread = np.full(top + 1, one)
    spread[0] = one / math.sqrt(2.0)
    for k in hidden:
        if k <= top:
            coefficients[k], spread[k] = np.nan + 1j * np.nan, np.nan
    return coefficients, spread
