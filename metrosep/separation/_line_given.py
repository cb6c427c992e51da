"""Arguments of the public functions for probes in a row, as people call them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from metrosep.core._arrays import FloatArray, as_float
from metrosep.core.errors import DataError, InvalidSamplesError
from metrosep.core.profile import Profile
from metrosep.core.provenance import Step
from metrosep.core.units import format_length
from metrosep.separation._line_probes import positions, uniform_step
from metrosep.separation._line_request import number
from metrosep.separation.contract import Separation


@dataclass(frozen=True, slots=True, eq=False)
class Given:
    """Readings with their positions."""

    readings: FloatArray  # shape (n_probes, n) or (n_probes, R, n), m: of all probes
    x: FloatArray | None  # m: positions of the carriage
    step: float  # m: between the samples of the artefact
    history: tuple[Step, ...]  # of profiles
    messages: tuple[str, ...]  # what was assumed

    def told(self, result: Separation) -> Separation:
        """Return a result that says what was assumed."""
        if not self.messages:
            return result
        return replace(result, messages=(*self.messages, *result.messages))


def split_call(m: Any, more: Sequence[Any], distance: Any, n_probes: int, what: str) -> Any:
    """Return readings and distance of a call with one array, or with one array for each probe."""
    if distance is None and more:
        more, distance = more[:-1], more[-1]
    right = f"call {what}(m, distance, step=...) with m of shape ({n_probes}, n)"
    if distance is None or isinstance(distance, Profile) or np.ma.size(distance) > 3:
        raise DataError(f"{what}: the distance between the probes in m is missing; {right}")
    if not more:
        return m, distance
    if len(more) != n_probes - 1:
        raise DataError(f"{what}: {1 + len(more)} readings for {n_probes} probes; {right}")
    return [m, *more], distance


def given_readings(
    m: Any, x: ArrayLike | None, step: float | None, what: str, *, distance: Any = None
) -> Given:
    """Return readings, positions and step of arrays or profiles."""
    history: tuple[Step, ...] = ()
    if isinstance(m, (list, tuple)) and any(isinstance(p, Profile) for p in m):
        m, x, history = _of_profiles(m, x, what)
    readings = _array(m, what)
    n = readings.shape[-1]
    spacing = None if step is None else number(step, f"{what}: step")
    if x is not None:
        at = positions(as_float(x), None, n, what)
        return Given(readings, at, spacing or uniform_step(at, what), history, ())
    messages: tuple[str, ...] = ()
    if spacing is None:
        spacing = _one_distance(distance)
        if spacing is None:
            raise DataError(f"{what} needs the positions x or the step between them, in m")
        text = (
            "the step is not given and taken as the distance of the probes, "
            f"{format_length(spacing)}: give x or step if the carriage moves otherwise"
        )
        messages = (text,)
    return Given(readings, None, spacing, history, messages)


def _one_distance(distance: Any) -> float | None:
    """Return the one distance of the probes; None where there are two or none."""
    try:
        values = np.unique(np.asarray(distance, dtype=np.float64))
    except (TypeError, ValueError):
        return None
    usable = values.size == 1 and np.isfinite(values[0]) and values[0] > 0.0
    return float(values[0]) if usable else None


def _array(m: Any, what: str) -> FloatArray:
    try:
        readings = as_float(m)
    except (TypeError, ValueError) as exc:
        raise InvalidSamplesError(
            f"{what}: readings must be an array of numbers, one row for each probe, all of one length "
            f"({exc})"
        ) from None
    if readings.ndim < 2:
        raise InvalidSamplesError(
            f"{what}: got one row of {readings.size} numbers; give the raw readings of all probes as "
            "m = [m1, m2, ...], not their differences: straightness and pitch need them"
        )
    return readings


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
