"""Readings round a circle: checked, and as harmonics ``sum_k Re(c_k exp(j k theta))`` and back.

The samples stand at ``theta_j = 2 pi j / N``; revolutions are whole. Harmonics go up to kmax < N/2,
so the sample at the Nyquist frequency, whose phase no reading tells, never enters.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from metrosep.core.errors import (
    DataError,
    InvalidSamplesError,
    TooFewSamplesError,
    UnitError,
)
from metrosep.core.profile import Profile
from metrosep.core.provenance import Step
from metrosep.core.recording import Recording
from metrosep.separation.null_space import Unobservable

__all__ = [
    "angle_tuple",
    "as_array",
    "centring",
    "check_kmax",
    "check_u_reading",
    "curve",
    "grid",
    "harmonics_of",
    "history_of",
    "names_of_k",
    "part_arrays",
    "revolutions",
    "turned",
]

FloatArray = NDArray[np.float64]
ComplexArray = NDArray[np.complex128]


def grid(n: int) -> FloatArray:
    """Return the angles in rad of n samples of one revolution."""
    return 2.0 * np.pi * np.arange(n) / n


def angle_tuple(angles: ArrayLike, *, least: int, what: str) -> tuple[float, ...]:
    """Return angles in rad as floats, refused when they look like degrees."""
    try:
        array = np.asarray(angles, dtype=np.float64)
    except (TypeError, ValueError) as exc:
        raise InvalidSamplesError(f"the {what} angles are not numbers; give rad") from exc
    if array.ndim != 1 or array.size < least:
        raise TooFewSamplesError(
            f"need >= {least} {what} angles in one row, got an array of shape {array.shape}"
        )
    if not np.isfinite(array).all():
        raise InvalidSamplesError(f"the {what} angles must be finite, got {array.tolist()} rad")
    if np.abs(array).max(initial=0.0) > 2.0 * np.pi * (1.0 + 1e-9):
        raise UnitError(
            f"the {what} angles reach {np.abs(array).max():.6g} rad, more than one turn; these "
            "look like degrees: give numpy.deg2rad(angles)"
        )
    return tuple(array.tolist())


def check_kmax(kmax: int) -> int:
    """Return kmax as int, at least 2."""
    if isinstance(kmax, bool) or int(kmax) != kmax or kmax < 2:
        raise DataError(f"kmax must be a whole number >= 2, got {kmax!r}")
    return int(kmax)


def check_u_reading(u_reading: float | None) -> float | None:
    """Return the standard deviation of one reading, refused if negative or not finite."""
    if u_reading is None:
        return None
    if not (math.isfinite(u_reading) and u_reading >= 0.0):
        raise DataError(f"u_reading must be a finite standard deviation in m, got {u_reading}")
    return float(u_reading)


def as_array(m: Any) -> Any:
    """Return the samples of a Recording, of Profiles or of anything like an array."""
    if isinstance(m, Recording):
        return np.stack(list(m.channels.values()))
    if isinstance(m, Sequence) and m and all(isinstance(item, Profile) for item in m):
        if len({len(item) for item in m}) > 1:
            raise InvalidSamplesError(
                f"the profiles have {[len(p) for p in m]} samples; all probes need the same"
            )
        return np.stack([item.z for item in m])
    return m


def history_of(m: Any) -> tuple[Step, ...]:
    """Return what happened to the readings before, as far as they tell it."""
    if isinstance(m, Recording):
        return m.history
    if isinstance(m, Sequence) and m and isinstance(m[0], Profile):
        return tuple(step for item in m for step in item.history)
    return ()


def revolutions(
    readings: Any, n: int, *, what: str, n_min: int
) -> tuple[FloatArray, list[str], int]:
    """Return readings as (n, M, N) without incomplete revolutions, messages, and how many left.

    A revolution in which any reading is missing is left out whole: an FFT would have to fill it.
    """
    try:
        array = np.asarray(readings, dtype=np.float64)
    except (TypeError, ValueError) as exc:
        raise InvalidSamplesError(
            f"the readings are not a regular array of numbers; need ({n}, N) or ({n}, M, N) in m"
        ) from exc
    if array.ndim not in (2, 3) or array.shape[0] != n:
        raise InvalidSamplesError(
            f"readings of {n} {what} need the shape ({n}, N) or ({n}, M revolutions, N samples), "
            f"got {array.shape}"
        )
    array = array[:, np.newaxis, :] if array.ndim == 2 else array
    if array.shape[2] < n_min or array.shape[1] == 0:
        raise TooFewSamplesError(
            f"need >= 1 revolution of >= {n_min} samples (kmax < N/2), got {array.shape[1]} of "
            f"{array.shape[2]}; sample finer or lower kmax"
        )
    if np.isinf(array).any():
        i, r, j = (int(v) for v in np.argwhere(np.isinf(array))[0])
        raise InvalidSamplesError(
            f"reading {j} of revolution {r} of {what} {i} is infinite; drop that revolution"
        )
    complete = ~np.isnan(array).any(axis=(0, 2))
    n_left_out = int(complete.size - complete.sum())
    if n_left_out == complete.size:
        raise InvalidSamplesError(
            "no revolution is complete: in each at least one reading is not measured (NaN); "
            "measure again, missing readings are not filled"
        )
    messages = []
    if n_left_out:
        messages.append(
            f"{n_left_out} of {complete.size} revolutions have readings that are not measured "
            "and were left out"
        )
        array = array[:, complete]
    return array, messages, n_left_out


def harmonics_of(samples: FloatArray, kmax: int) -> ComplexArray:
    """Return c_k, k = 0 ... kmax, along the last axis."""
    n = samples.shape[-1]
    c: ComplexArray = np.fft.rfft(samples, axis=-1)[..., : kmax + 1] * (2.0 / n)
    c[..., 0] *= 0.5
    return c


def curve(c: ComplexArray, n: int) -> FloatArray:
    """Return the sum of the harmonics that are known (not NaN) at n samples of a revolution."""
    half = np.where(np.isnan(c), 0.0, c) * (0.5 * n)
    half[..., 0] *= 2.0
    out: FloatArray = np.fft.irfft(half, n=n, axis=-1)
    return out


def turned(samples: FloatArray, angles: FloatArray) -> FloatArray:
    """Return ``samples(theta + angle)`` for each angle: exact for what is below Nyquist."""
    n = samples.shape[-1]
    c = np.fft.rfft(samples)
    k = np.arange(c.size)
    shift = np.exp(1j * k * angles[:, np.newaxis])
    if n % 2 == 0:
        shift[:, -1] = np.cos(0.5 * n * angles)
    out: FloatArray = np.fft.irfft(c * shift, n=n, axis=-1)
    return out


def part_arrays(
    known: Iterable[str], *given: Mapping[str, ArrayLike]
) -> tuple[dict[str, FloatArray], int]:
    """Return all parts as rows of one length, zero where not given."""
    names = tuple(known)
    found: dict[str, FloatArray] = {}
    for mapping in given:
        for name, values in mapping.items():
            if name not in names:
                raise DataError(f"there is no part {name!r}; there are {', '.join(names)}")
            array = np.asarray(values, dtype=np.float64)
            if array.ndim != 1 or array.size < 3:
                raise InvalidSamplesError(
                    f"the part {name!r} needs one row of >= 3 samples, got {array.shape}"
                )
            found[name] = array
    if not found:
        raise DataError("give at least one part to simulate; its length sets the samples")
    sizes = {name: values.size for name, values in found.items()}
    if len(set(sizes.values())) > 1:
        raise InvalidSamplesError(f"the parts have different numbers of samples: {sizes}")
    size = next(iter(sizes.values()))
    return {name: found.get(name, np.zeros(size)) for name in names}, size


def centring(part: str) -> Unobservable:
    """Return what every radial separation lacks: the mean and the eccentricity."""
    return Unobservable(
        part,
        "term",
        ("mean (k = 0)", "eccentricity (k = 1)"),
        "the mean is the zero of the probes; k = 1 is shared between the centring of the artefact "
        "and the motion, so both are left out",
    )


def names_of_k(ks: Sequence[int], *, most: int = 12) -> str:
    """Return harmonics as words for a message."""
    shown = ", ".join(str(k) for k in ks[:most])
    return shown + (f", ... ({len(ks)} in all)" if len(ks) > most else "")
