"""Readings that known parts produce on probes in a row, and the inputs of the public functions."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from metrosep.core.errors import DataError, InvalidSamplesError
from metrosep.core.profile import Profile
from metrosep.core.provenance import Step
from metrosep.separation._line_probes import Row, interpolation, positions, uniform_step

FloatArray = NDArray[np.float64]

METHODS = ("sequential", "generalised", "combined", "least_squares")

_SPELLINGS = {
    "generalized": "generalised",
    "least-squares": "least_squares",
    "ls": "least_squares",
}


def method_named(name: str, known: Sequence[str], what: str) -> str:
    """Return the name of an estimator, spelt in one way."""
    word = _SPELLINGS.get(name, name)
    if word not in known:
        raise DataError(f"{what} has no method {name!r}; it has {', '.join(known)}")
    return word


def checked_smoothing(value: float, what: str) -> float:
    """Return the weight of the penalty, or refuse it."""
    if not (np.isfinite(value) and value > 0.0):
        raise DataError(f"{what}: smoothing is {value}; it must be above zero")
    return float(value)


def simulated(
    row: Row,
    truth: Mapping[str, ArrayLike],
    errors: Mapping[str, ArrayLike],
    *,
    truth_parts: Sequence[str],
    error_parts: Sequence[str],
    what: str,
) -> FloatArray:
    """Return the readings of parts: artefact (m,), straightness, pitch (n,), zero (scalar)."""
    for given, known, kind in ((truth, truth_parts, "truth"), (errors, error_parts, "error")):
        for name in given:
            if name not in known:
                raise DataError(f"{what} has no {kind} part {name!r}; it has {', '.join(known)}")
    parts = {k: np.asarray(v, dtype=np.float64) for k, v in {**truth, **errors}.items()}
    n = _n_positions(row, parts, what)
    o = np.array(row.offsets)
    readings = np.zeros((o.size, n))
    if "artefact" in parts:
        grid = (o[0] + row.step * np.arange(n + row.span)).astype(np.float64)
        at = [interpolation(grid, row.step * np.arange(n) + v) for v in o]
        readings += np.array([p @ parts["artefact"] for p in at])
    zero = np.zeros(n)
    readings += parts.get("straightness", zero) + o[:, None] * parts.get("pitch", zero)
    if "zero" in parts and np.isfinite(parts["zero"]).all():
        w = row.weights
        readings += (w * float(parts["zero"]) / (w @ w))[:, None]
    return readings


def _n_positions(row: Row, parts: Mapping[str, FloatArray], what: str) -> int:
    counts = {k: v.size for k, v in parts.items() if k in ("straightness", "pitch")}
    if "artefact" in parts:
        counts["artefact"] = parts["artefact"].size - row.span
    if len(set(counts.values())) != 1 or min(counts.values()) < 2:
        sizes = ", ".join(f"{k} {v.size}" for k, v in parts.items()) or "none is given"
        raise DataError(
            f"{what}: for n >= 2 carriage positions straightness and pitch have n values, the artefact "
            f"n + {row.span}; got {sizes}"
        )
    return next(iter(counts.values()))


def given_readings(
    m: Any, x: ArrayLike | None, step: float | None, what: str
) -> tuple[Any, FloatArray | None, float, tuple[Step, ...]]:
    """Return readings, positions, step and history of arrays or profiles."""
    history: tuple[Step, ...] = ()
    if isinstance(m, (list, tuple)) and any(isinstance(p, Profile) for p in m):
        m, x, history = _of_profiles(m, x, what)
    try:
        n = np.asarray(m, dtype=np.float64).shape[-1]
    except (TypeError, ValueError, IndexError):
        raise InvalidSamplesError(
            f"{what}: readings must be an array of numbers, one row for each probe, all of one length"
        ) from None
    if x is None:
        positions(None, step, n, what)
        assert step is not None  # noqa: S101  (positions has refused it)
        return m, None, float(step), history
    at = positions(x, None, n, what)
    return m, at, uniform_step(at, what) if step is None else float(step), history


def _of_profiles(
    m: Sequence[Any], x: ArrayLike | None, what: str
) -> tuple[FloatArray, FloatArray, tuple[Step, ...]]:
    if not all(isinstance(p, Profile) for p in m) or x is not None:
        raise DataError(
            f"{what}: give all probes as profiles over the carriage positions, without x, or all as "
            "arrays"
        )
    first = m[0]
    for i, p in enumerate(m[1:], start=2):
        if len(p) != len(first) or np.abs(p.x - first.x).max() > 1e-6 * float(np.ptp(first.x)):
            raise DataError(
                f"{what}: probe {i} was read at other positions than probe 1; all profiles must be "
                "given over the position of the carriage"
            )
    return np.array([p.z for p in m]), first.x, tuple(s for p in m for s in p.history)
