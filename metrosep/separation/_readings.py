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

from metrosep.core._arrays import ComplexArray, FloatArray, as_float
from metrosep.core.errors import (
    DataError,
    InvalidSamplesError,
    NotSeparableError,
    TooFewSamplesError,
)
from metrosep.core.quantity import Quantity
from metrosep.spectral._checks import real_number

NOISE_UNKNOWN = (
    "the noise of a reading is not known, so no uncertainty is stated: give repeats, or u_reading"
)


@dataclass(frozen=True, slots=True)
class Averaged:
    """Means of repeated readings."""

    mean: FloatArray  # shape (n_readings, n_samples): naN where no repeat was measured
    counts: FloatArray  # shape (n_readings, n_samples): how many repeats stand behind each mean
    n_repeats: int  # largest number of repeats
    # standard deviation of one reading; NaN where it is neither stated nor shown by repeats
    noise: Quantity

    @property
    def messages(self) -> tuple[str, ...]:
        """What is to be said about the noise."""
        return (NOISE_UNKNOWN,) if math.isnan(self.noise.value) else ()


def as_numbers(values: ArrayLike, needs: str) -> FloatArray:
    """Return a copy in float64; what a masked array masks is NaN."""
    try:
        return as_float(values)
    except (TypeError, ValueError) as exc:
        raise InvalidSamplesError(f"{needs}, got no array of numbers ({exc})") from None


def size_doubts(array: FloatArray, what: str) -> tuple[str, ...]:
    """Say it where readings in m are so large that another unit was meant."""
    known = array[~np.isnan(array)]
    span = float(np.ptp(known)) if known.size else 0.0
    if span <= _LARGEST:
        return ()
    text = f"{what}: the readings span {span:.3g} m; are they in m? 5 um is 5e-6"
    return (text,)


_LARGEST = 0.1
"""No displacement sensor of these methods reads over 0.1 m."""


def checked_readings(
    readings: ArrayLike, *, names: Sequence[str], minimum: int, what: str
) -> FloatArray:
    """Return readings as (n_readings, n_repeats, n_samples), or refuse them."""
    array = as_numbers(
        readings, f"{what} needs {len(names)} readings of equal length ({', '.join(names)})"
    )
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
    for name, repeats in zip(names, array, strict=True):
        n_measured = int((~np.isnan(repeats)).any(axis=0).sum())
        if n_measured < minimum:
            raise TooFewSamplesError(
                f"{what}: {name} holds {n_measured} measured samples, at least {minimum} are needed"
            )
    return array


def average_repeats(
    array: FloatArray, basis: FloatArray, *, u_reading: float | None, unit: str = "m"
) -> Averaged:
    """Return the means over repeats, and the noise of one reading.

    The noise is that of what remains when `basis` is removed from each repeat: an offset or an
    eccentricity that differs from repeat to repeat does not reach the result either.
    """
    counts = (~np.isnan(array)).sum(axis=1).astype(np.float64)
    mean = np.stack([_mean_curve(rows, n, basis) for rows, n in zip(array, counts, strict=True)])
    n_repeats = array.shape[1]
    if u_reading is not None:
        stated = real_number(u_reading, "u_reading", f"a standard uncertainty in {unit}")
        if not (math.isfinite(stated) and stated >= 0.0):
            raise DataError(
                f"u_reading is {stated}; it must be a standard uncertainty >= 0 in {unit}"
            )
        noise = Quantity(
            stated, unit, "standard uncertainty of one reading, as stated", symbol="s"
        )
    else:
        noise = _noise_of_repeats(array, mean, basis, unit)
    return Averaged(mean, counts, n_repeats, noise)


def _mean_curve(repeats: FloatArray, counts: FloatArray, basis: FloatArray) -> FloatArray:
    """Return the mean of repeats; each may have its own share of the basis.

    Where every sample has all repeats, that is the plain mean. With gaps the plain mean would jump
    between levels, so the shares are fitted first: ``z_r(x) = f(x) + basis(x) c_r``.
    """
    valid = ~np.isnan(repeats)
    used = valid.any(axis=1)
    own = np.where(valid, repeats, 0.0)
    if not valid[used].all() and used.sum() > 1:
        own = own - valid * own_shares(own, valid, counts, basis)
    return np.where(counts > 0, own.sum(axis=0) / np.maximum(counts, 1.0), np.nan)


def own_shares(
    own: FloatArray, valid: NDArray[np.bool_], counts: FloatArray, basis: FloatArray
) -> FloatArray:
    """Return basis(x) c_r by least squares, the curve f eliminated; their mean is not determined."""
    n_repeats, p = own.shape[0], basis.shape[1]
    weight = valid / np.maximum(counts, 1.0)
    normal = np.zeros((n_repeats, p, n_repeats, p))
    for i in range(p):
        for j in range(p):
            product = basis[:, i] * basis[:, j]
            normal[:, i, :, j] = np.diag(valid @ product) - (valid * product) @ weight.T
    apart = valid * (own - own.sum(axis=0) / np.maximum(counts, 1.0))
    size = n_repeats * p
    right = (apart @ basis).ravel()
    found = np.linalg.lstsq(normal.reshape(size, size), right, rcond=1e-12)[0]
    return np.asarray(found.reshape(n_repeats, p) @ basis.T)


def _noise_of_repeats(
    array: FloatArray, mean: FloatArray, basis: FloatArray, unit: str
) -> Quantity:
    """Pool the scatter of all repeats about their means, the basis removed from each."""
    n_repeats, p = array.shape[1], basis.shape[1]
    squares, freedom = 0.0, 0.0
    for i in range(array.shape[0]):
        taken = [r for r in array[i] if (~np.isnan(r)).sum() > p]
        if len(taken) < 2:
            continue
        for repeat in taken:
            squares += float(np.nansum(without_basis(repeat - mean[i], basis) ** 2))
        counts = (~np.isnan(np.stack(taken))).sum(axis=0)
        freedom += float(np.maximum(counts - 1, 0).sum()) - p * (len(taken) - 1)
    if freedom < 1.0:
        return Quantity(math.nan, unit, "standard deviation of one reading; not known", symbol="s")
    value = math.sqrt(squares / freedom)
    text = f"standard deviation of one reading, pooled from {n_repeats} repeats (type A)"
    return Quantity(value, unit, text, u=value / math.sqrt(2.0 * freedom), symbol="s")


def without_basis(values: FloatArray, basis: FloatArray) -> FloatArray:
    """Return values minus their least-squares combination of the basis; NaN stay NaN."""
    valid = ~np.isnan(values)
    found = np.linalg.lstsq(basis[valid], values[valid], rcond=None)[0]
    return np.asarray(values - basis @ found)


def require_common(valid: NDArray[np.bool_], basis: FloatArray, what: str) -> None:
    """Refuse set-ups that have too few samples in common."""
    n, p = int(valid.sum()), basis.shape[1]
    if n <= p + 1:
        raise NotSeparableError(
            f"{what}: only {n} of {valid.size} samples were measured in every set-up, more than "
            f"{p + 1} are needed: the gaps do not overlap, measure the missing part again"
        )


def left_share(valid: NDArray[np.bool_], basis: FloatArray) -> FloatArray:
    """Return the share of a white variance that removing the basis leaves, sample by sample."""
    share = np.full(valid.size, np.nan)
    q, _ = np.linalg.qr(basis[valid])
    share[valid] = np.maximum(1.0 - np.sum(q**2, axis=1), 0.0)
    return share


def low_harmonics(angle: FloatArray, highest: int = 1) -> FloatArray:
    """Return 1, cos and sin up to a harmonic as columns."""
    columns = [np.ones(angle.size)]
    for k in range(1, highest + 1):
        columns += [np.cos(k * angle), np.sin(k * angle)]
    return np.column_stack(columns)


def line_basis(x: FloatArray) -> FloatArray:
    """Return 1 and the centred, scaled position as columns."""
    half = max(float(np.ptp(x)) / 2.0, np.finfo(np.float64).tiny)
    return np.column_stack([np.ones(x.size), (x - (x.min() + x.max()) / 2.0) / half])


def harmonics_of(
    values: FloatArray, *, start: float = 0.0, hidden: Sequence[int] = ()
) -> ComplexArray:
    """Return one-sided Fourier coefficients of a closed curve."""
    n = values.shape[-1]
    top = (n - 1) // 2
    gaps = np.isnan(values).any(axis=-1)
    coefficients = np.fft.rfft(np.where(np.isnan(values), 0.0, values))[..., : top + 1] * (2.0 / n)
    coefficients[..., 0] /= 2.0
    coefficients = coefficients * np.exp(-1j * start * np.arange(top + 1))
    coefficients[gaps] = complex(np.nan, np.nan)
    coefficients[..., [k for k in hidden if k <= top]] = complex(np.nan, np.nan)
    return np.asarray(coefficients)


def gap_message(values: FloatArray) -> tuple[str, ...]:
    """Say why a curve has no harmonics."""
    n = int(np.isnan(values).sum())
    if n == 0:
        return ()
    text = (
        f"{n} of {values.size} angles were not measured in every set-up: the curves keep the gap, "
        "and the harmonics, which need the whole turn, are not determined"
    )
    return (text,)


def harmonics_u(array: FloatArray, weights: FloatArray, noise: float) -> FloatArray:
    """Return the standard uncertainty of the coefficients of a weighted sum of mean readings.

    Motion that does not repeat is not white over the angle, so the scatter of the repeats is taken
    harmonic by harmonic; without repeats the noise of a reading is white.
    """
    n = array.shape[2]
    top = (n - 1) // 2
    white = np.full(top + 1, noise * math.sqrt(2.0 / n))
    white[0] = noise / math.sqrt(n)
    variance = np.zeros(top + 1)
    for repeats, weight in zip(array, weights, strict=True):
        whole = repeats[~np.isnan(repeats).any(axis=1)]
        if weight == 0.0:
            continue
        if len(whole) >= _ENOUGH:
            c = harmonics_of(whole)
            own = (np.var(c.real, axis=0, ddof=1) + np.var(c.imag, axis=0, ddof=1)) / 2.0
            own[0] *= 2.0  # the mean is real
            variance += weight**2 * own / len(whole)
        else:
            held = max(int((~np.isnan(repeats).all(axis=1)).sum()), 1)
            variance += weight**2 * white**2 / held
    return np.sqrt(variance)


_ENOUGH = 4
"""Repeats from which the scatter of one harmonic is better known than that of white noise."""
