"""Private helpers: arrays that cannot be changed, and checks on their content."""

from __future__ import annotations

import math
import re
from typing import Any, TypeGuard

import numpy as np
from numpy.typing import ArrayLike, NDArray

from metrosep.core.errors import InvalidSamplesError, OptionError, TooFewSamplesError
from metrosep.core.numbers import quantity
from metrosep.core.units import Pixels, parse_lateral

FloatArray = NDArray[np.float64]
ComplexArray = NDArray[np.complex128]
BoolArray = NDArray[np.bool_]
ByteArray = NDArray[np.uint8]
IntArray = NDArray[np.intp]


class CheckedArray(np.ndarray[Any, np.dtype[np.float64]]):
    """Numbers of a reader that nobody else holds, already found free of infinities."""


def frozen_float(values: ArrayLike, *, name: str, ndim: int, min_size: int = 1) -> FloatArray:
    """Return a private, non-writeable float64 copy; infinities are refused, NaN kept.

    An array that owns its memory and was made non-writeable is taken as it is. What a masked array
    masks is NaN.
    """
    if isinstance(values, CheckedArray) and values.flags.c_contiguous and values.ndim == ndim:
        checked: FloatArray = values.view(np.ndarray)
        checked.setflags(write=False)
        return checked
    try:
        array = values if is_frozen(values) else as_float(values)
    except (TypeError, ValueError) as exc:
        raise InvalidSamplesError(
            f"{name} must hold real numbers in SI, got {type(values).__name__}: {exc}"
        ) from None
    if array.ndim != ndim:
        raise InvalidSamplesError(f"{name} must have {ndim} dimension(s), got shape {array.shape}")
    if array.size < min_size:
        raise TooFewSamplesError(f"{name} needs at least {min_size} sample(s), got {array.size}")
    if np.isinf(np.fmin.reduce(array, axis=None)) or np.isinf(np.fmax.reduce(array, axis=None)):
        first = tuple(int(i) for i in np.argwhere(np.isinf(array))[0])
        raise InvalidSamplesError(
            f"{name} is infinite at index {first}; write NaN where nothing was measured"
        )
    array.setflags(write=False)
    return array


def as_float(values: Any) -> FloatArray:
    """Return a copy in float64, masked values as NaN; what holds no real numbers is a TypeError.

    Also where some rows of a list are masked, whose masks numpy itself would drop. Texts, times and
    truth values are refused, which numpy itself would take for numbers.
    """
    if isinstance(values, list | tuple) and any(isinstance(v, np.ma.MaskedArray) for v in values):
        values = np.ma.array(values)
    if np.iscomplexobj(values):
        raise TypeError("complex numbers; take their real part")
    given = np.asarray(values)
    if given.dtype.kind in "bSUmM":
        raise TypeError(f"elements of type {given.dtype.name}; give numbers")
    if given.dtype == object and any(isinstance(v, bool | str | bytes) for v in given.flat):
        raise TypeError("texts or truth values among them; give numbers")
    array: FloatArray = np.array(given, dtype=np.float64)
    if isinstance(values, np.ma.MaskedArray):
        array[np.ma.getmaskarray(values)] = np.nan
    return array


class Heights:
    """What every object with heights `z` says of those that were measured, nothing removed or filtered."""

    __slots__ = ()
    z: FloatArray

    @property
    def n_invalid(self) -> int:
        """Number of points that were not measured."""
        return int(np.count_nonzero(np.isnan(self.z)))

    def peak_to_valley(self) -> float:
        """Return the largest minus the smallest valid height, nothing removed or filtered.

        Returns
        -------
        float
            P-V in m; NaN when nothing is valid.
        """
        valid = self.z[~np.isnan(self.z)]
        return float(np.ptp(valid)) if valid.size else float("nan")

    def rms(self) -> float:
        """Return the root mean square of the valid heights about their mean.

        Returns
        -------
        float
            RMS in m; NaN when nothing is valid.
        """
        valid = self.z[~np.isnan(self.z)]
        return float(valid.std()) if valid.size else float("nan")

    def __array__(self, dtype: Any = None, copy: bool | None = None) -> FloatArray:
        """Return the heights: as they are, which cannot be written to, or a copy where one is asked for."""
        wanted = np.dtype(np.float64 if dtype is None else dtype)
        if wanted == self.z.dtype and not copy:
            return self.z
        if copy is False:
            raise ValueError(f"heights are float64: {wanted} needs a copy")
        return self.z.astype(wanted)


def is_frozen(values: ArrayLike) -> TypeGuard[FloatArray]:
    if not isinstance(values, np.ndarray) or values.dtype != np.float64:
        return False
    return values.base is None and values.flags.c_contiguous and not values.flags.writeable


def position(value: Any, name: str) -> tuple[float, float]:
    """Return a position (x, y) in m of two lengths, each a number in m or a text with its unit."""
    x, y = (quantity(v, k, "length") for k, v in _pair(value, name).items())
    return x, y


def place(value: Any, name: str) -> tuple[float, float]:
    """Return a position on a map in m or, where its texts are in px, in its pixels."""
    x, y = (lateral(v, k) for k, v in _pair(value, name).items())
    return x, y


def lateral(value: Any, name: str) -> float:
    """Return a place or size on a map in m or, of a text in px, in pixels."""
    if isinstance(value, str):
        return parse_lateral(value, name=name)
    return value if isinstance(value, Pixels) else quantity(value, name, "length")


def _pair(value: Any, name: str) -> dict[str, Any]:
    """Return x and y of a pair, by their names."""
    pair = () if isinstance(value, str | bytes) or not hasattr(value, "__len__") else tuple(value)
    if len(pair) != 2:
        raise OptionError(f"{name} must be two positions (x, y) in m, got {value!r}")
    return {f"{k} of {name}": v for k, v in zip("xy", pair, strict=True)}


ONE_PLACE = math.radians(1e-6)
"""Angles so near to each other are one place: decimals of degrees explain that they differ."""


def is_turn_apart(low: float, high: float) -> bool:
    """Whether two angles are one place, one turn apart."""
    return abs(high - low - math.tau) <= ONE_PLACE


def is_turn(angle: FloatArray) -> bool:
    """Whether angles go once around: the next step would be back at the first."""
    step = np.ptp(angle) / max(angle.size - 1, 1)
    return bool(abs(np.ptp(angle) + step - 2.0 * np.pi) < 1.5 * step)


def way(values: FloatArray) -> int:
    """Return 1 where values rise throughout, -1 where they fall, else 0: also for fewer than two, or NaN."""
    if values.size < 2:
        return 0
    rises = bool(values[1] > values[0])
    for start in range(0, values.size - 1, _STEPS):
        part = values[start : start + _STEPS + 1]
        before, behind = part[:-1], part[1:]
        if not (behind > before if rises else behind < before).all():
            return 0
    return 1 if rises else -1


_STEPS = 2**16
"""Steps that are looked at together, so that no array as long as the values is made."""


def same_length(**arrays: NDArray[Any]) -> None:
    """Refuse arrays of unequal length, naming them."""
    sizes = {name: a.size for name, a in arrays.items()}
    if len(set(sizes.values())) > 1:
        text = ", ".join(f"{n} has {s}" for n, s in sizes.items())
        raise InvalidSamplesError(f"arrays must be equally long: {text}")


# ---- which of many p-values are beyond chance --------------------------------------------------


def benjamini_hochberg(p_values: FloatArray, *, rate: float) -> NDArray[np.bool_]:
    """Return which hypotheses are rejected at a false discovery rate.

    Source: Benjamini and Hochberg 1995.

    Examples
    --------
    >>> import numpy as np
    >>> benjamini_hochberg(np.array([0.001, 0.2, 0.03, 0.9]), rate=0.05).tolist()
    [True, False, False, False]
    """
    order = np.argsort(p_values)
    n = p_values.size
    passed = np.flatnonzero(p_values[order] <= rate * np.arange(1, n + 1) / n)
    rejected = np.zeros(n, dtype=bool)
    if passed.size:
        rejected[order[: passed[-1] + 1]] = True
    return rejected


# ---- the order of names as people count: ``run2`` stands before ``run10`` ----------------------


def by_number(name: str) -> list[tuple[int, int, str]]:
    """Return a key that sorts names with the numbers in them by their value.

    Examples
    --------
    >>> sorted(["run10", "run2", "run", "b1"], key=by_number)
    ['b1', 'run', 'run2', 'run10']
    """
    pieces = re.split(r"(\d+)", name)
    return [(1, int(p), "") if p.isdecimal() else (0, 0, p) for p in pieces]


def comb(measured: BoolArray) -> tuple[int, int]:
    """Return the step of the coarsest comb that holds all that was measured, in samples, and its first one.

    Of eleven places that lie anywhere all are on one comb once in a thousand times (2^-10); fewer show none.

    Examples
    --------
    >>> comb(np.arange(40) % 3 == 1)
    (3, 1)
    """
    at = np.flatnonzero(measured)
    step = int(np.gcd.reduce(np.diff(at))) if at.size > 10 else 1
    return (step, int(at[0]) % step) if step > 1 else (1, 0)
