"""Parameters by name, evaluated on many drawings at once: rows of valid heights."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from metrosep.core._arrays import FloatArray
from metrosep.core.errors import DataError, TooFewSamplesError
from metrosep.core.profile import Profile
from metrosep.core.quantity import Quantity
from metrosep.core.surface import Surface

Evaluate = str | Callable[[Profile | Surface], float | Quantity]

PEAK_TO_VALLEY = frozenset({"PV", "Pt", "Rt", "Wt", "Sz"})
MEAN_SQUARE = frozenset({"RMS", "Pq", "Rq", "Wq", "Sq"})
MEAN_ABSOLUTE = frozenset({"Pa", "Ra", "Wa", "Sa"})
PEAK = frozenset({"Sp"})
VALLEY = frozenset({"Sv"})
NORMALISED = frozenset({"Psk", "Rsk", "Wsk", "Ssk", "Pku", "Rku", "Wku", "Sku"})
NAMES = PEAK_TO_VALLEY | MEAN_SQUARE | MEAN_ABSOLUTE | PEAK | VALLEY | NORMALISED | {"mean"}
EXTREMES = PEAK_TO_VALLEY | PEAK | VALLEY


def check_name(name: str) -> str:
    """Return a known name."""
    if name not in NAMES:
        raise DataError(
            f"{name!r} is not one of {', '.join(sorted(NAMES))}; give a function of the object "
            "for any other parameter"
        )
    return name


def is_centred(name: str, centre: bool | None) -> bool:
    """Return whether the mean is removed: areal and RMS always, profile families on request."""
    if centre is None:
        return name[0] == "S" or name == "RMS"
    return centre


def rows(name: str, block: FloatArray, *, centred: bool) -> FloatArray:
    """Return the parameter of each row of complete heights; the block may be overwritten."""
    if name in PEAK_TO_VALLEY:
        return np.asarray(block.max(axis=1) - block.min(axis=1))
    mean: FloatArray = block.mean(axis=1)
    if name == "mean":
        return mean
    if name in PEAK:
        return np.asarray(block.max(axis=1) - (mean if centred else 0.0))
    if name in VALLEY:
        return np.asarray((mean if centred else 0.0) - block.min(axis=1))
    if centred:
        block -= mean[:, None]
    if name in MEAN_ABSOLUTE:
        return np.asarray(np.abs(block, out=block).mean(axis=1))
    return _moments(name, block)


def _moments(name: str, block: FloatArray) -> FloatArray:
    # Heights of 1e-9 m have fourth powers of 1e-36: scaled first, nothing underflows.
    scale = np.abs(block).max(axis=1)
    scale[scale == 0.0] = 1.0
    block /= scale[:, None]
    squares = np.square(block)
    q = np.sqrt(squares.mean(axis=1))
    if name in MEAN_SQUARE:
        return np.asarray(q * scale)
    if (q == 0.0).any():
        raise DataError(f"{name} of constant heights is not defined")
    if name.endswith("sk"):
        return np.asarray((squares * block).mean(axis=1) / q**3)
    return np.asarray(np.square(squares).mean(axis=1) / q**4)


def valid_heights(obj: Profile | Surface) -> tuple[FloatArray, NDArray[np.bool_]]:
    """Return the valid heights in a row, and the mask."""
    mask = ~np.isnan(obj.z)
    if int(mask.sum()) < 2:
        raise TooFewSamplesError(f"{int(mask.sum())} valid height(s), at least 2 are needed")
    return obj.z[mask], mask


def with_heights(obj: Profile | Surface, z: FloatArray) -> Profile | Surface:
    """Return the object with other heights."""
    if isinstance(obj, Profile):
        return Profile(obj.x, z, metadata=obj.metadata, history=obj.history)
    return Surface(
        z, obj.dx, obj.dy, origin=obj.origin, metadata=obj.metadata, history=obj.history
    )


def value_of(evaluate: Evaluate, obj: Profile | Surface, *, centre: bool | None = None) -> float:
    """Return the parameter of one object as a finite number."""
    if isinstance(evaluate, str):
        name = check_name(evaluate)
        z, _ = valid_heights(obj)
        value = float(rows(name, z[None, :].copy(), centred=is_centred(name, centre))[0])
    else:
        result = evaluate(obj)
        value = float(result.value if isinstance(result, Quantity) else result)
    if not np.isfinite(value):
        raise DataError(
            "the evaluation gave NaN or an infinite value; it needs an answer for each drawing"
        )
    return value
