"""Parts of a simulation whose shapes differ from part to part; a stated uncertainty."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import ArrayLike

from metrosep.core._arrays import FloatArray
from metrosep.core.errors import DataError
from metrosep.separation._checked_numbers import checked_number

if TYPE_CHECKING:
    from metrosep.separation.contract import SeparationMethod


def known_parts(
    method: SeparationMethod, truth: Mapping[str, ArrayLike], errors: Mapping[str, ArrayLike]
) -> dict[str, FloatArray]:
    """Return the parts that were given, as arrays."""
    found = {}
    for given, known, kind in (
        (truth, method.truth_parts, "truth"),
        (errors, method.error_parts, "error"),
    ):
        for name, values in given.items():
            if name not in known:
                has = ", ".join(known) or "none"
                raise DataError(f"{method.name} has no {kind} part {name!r}; it has {has}")
            try:
                found[name] = np.array(values, dtype=np.float64)
            except (TypeError, ValueError) as exc:
                raise DataError(
                    f"{method.name}: the part {name!r} is no array of numbers: {exc}"
                ) from None
    if not found:
        every = ", ".join((*method.truth_parts, *method.error_parts))
        raise DataError(f"{method.name}: no part is given to simulate; it has {every}")
    return found


def part_of(
    parts: Mapping[str, FloatArray], name: str, shape: tuple[int, ...], what: str
) -> FloatArray:
    """Return one part of a stated shape, zeros where it was not given."""
    if name not in parts:
        return np.zeros(shape)
    if parts[name].shape != shape:
        raise DataError(
            f"{what}: the part {name!r} must have the shape {shape}, got {parts[name].shape}"
        )
    return parts[name]


def stated_u(u_reading: float | None, unit: str, name: str = "u_reading") -> float | None:
    """Return a stated standard uncertainty of one reading, or None."""
    if u_reading is None:
        return None
    value = checked_number(u_reading, name, f"a standard uncertainty >= 0 in {unit}")
    if value < 0.0:
        raise DataError(f"{name} is {value}; it must be a standard uncertainty >= 0 in {unit}")
    return value
