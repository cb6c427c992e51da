"""`Description`: a result as plain values, tables and maps, whatever kind it is."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from metrosep.core._arrays import FloatArray
from metrosep.core.profile import Profile
from metrosep.core.quantity import Quantity
from metrosep.core.surface import Surface


@dataclass(frozen=True, slots=True)
class Description:
    """What a document, a check and an output take from a result."""

    # mapping of str to Quantity: by metric: what checks name
    quantities: Mapping[str, Quantity] = field(default_factory=dict)
    charts: tuple[dict[str, Any], ...] = ()  # of dict: from `metrosep.recipe.describe.charts`
    # mapping of str to mapping: columns with unit suffix; the name of each table is put after that
    # of the file, empty for the main one
    tables: Mapping[str, Mapping[str, Any]] = field(default_factory=dict)
    # mapping of str to Surface: parts that are maps
    maps: Mapping[str, Surface] = field(default_factory=dict)
    # mapping: what the document holds beside: of a separation everything that reads it again
    document: Mapping[str, Any] = field(default_factory=dict)
    audit: Mapping[str, Any] = field(default_factory=dict)  # mapping: what was done
    # what the user should know, of results that hold no ``messages`` themselves
    messages: tuple[str, ...] = ()
    # frozenset of str: metrics that the document lists only where a check names them
    unlisted: frozenset[str] = frozenset()
    # mapping of str to Profile: parts that are profiles, for files that hold one; `tables` holds
    # their samples too
    profiles: Mapping[str, Profile] = field(default_factory=dict)
    # mapping of str to str: text files by name, which an output of parts writes as they are
    files: Mapping[str, str] = field(default_factory=dict)
    # tuple of mapping: limits that the step itself states, in the keys of [[check]]
    checks: tuple[Mapping[str, Any], ...] = ()


def quantity(
    value: Any, unit: str, definition: str, *, u: Any = None, symbol: str = ""
) -> Quantity:
    """Return a quantity, its uncertainty None where it is not known."""
    spread = None if u is None or not math.isfinite(float(u)) else float(u)
    is_count = isinstance(value, int) and not isinstance(value, bool)
    return Quantity(value if is_count else float(value), unit, definition, u=spread, symbol=symbol)


def extremes(
    name: str,
    values: FloatArray,
    u: FloatArray,
    unit: str,
    covariance: FloatArray | None = None,
) -> dict[str, Quantity]:
    """Return P-V and RMS of a separated curve or map; of a curve perhaps with its covariance."""
    known = np.isfinite(values)
    if not known.any():
        return {}
    flat, flat_u = values[known], u[known]
    high, low = int(np.argmax(flat)), int(np.argmin(flat))
    text = name.replace("_", " ")
    square, how = flat_u[high] ** 2 + flat_u[low] ** 2, "of the two extremes as if independent"
    if covariance is not None:
        square -= 2.0 * covariance[known][:, known][high, low]
        how = "with the covariance of the two extremes"
    return {
        f"{name}.pv": quantity(
            flat[high] - flat[low],
            unit,
            f"P-V of the separated {text}; u {how}",
            u=math.sqrt(square) if not square <= 0.0 else 0.0,
            symbol=f"PV {text}",
        ),
        f"{name}.rms": quantity(
            math.sqrt(float(np.mean((flat - flat.mean()) ** 2))),
            unit,
            f"RMS of the separated {text} about its mean",
            symbol=f"RMS {text}",
        ),
    }


def named(found: Mapping[str, Quantity]) -> dict[str, Quantity]:
    """Return quantities whose symbol is their metric, where the same symbol stands several times."""
    return {key: replace(q, symbol=key) for key, q in found.items()}
