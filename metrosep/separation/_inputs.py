"""Parts and readings as callers give them: mappings, arrays or profiles."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from metrosep.core._arrays import FloatArray
from metrosep.core.errors import DataError, InvalidSamplesError
from metrosep.core.profile import Profile
from metrosep.core.provenance import Step
from metrosep.separation._readings import as_numbers


def given_parts(
    method: str,
    truth: Mapping[str, ArrayLike],
    errors: Mapping[str, ArrayLike],
    *,
    truth_parts: Sequence[str],
    error_parts: Sequence[str],
) -> dict[str, FloatArray]:
    """Return all parts of a simulation, zeros where one is missing."""
    for given, known, kind in ((truth, truth_parts, "truth"), (errors, error_parts, "error")):
        for name in given:
            if name not in known:
                raise DataError(f"{method} has no {kind} part {name!r}; it has {', '.join(known)}")
    found = {k: np.asarray(v, dtype=np.float64) for k, v in {**truth, **errors}.items()}
    shapes = {v.shape for v in found.values()}
    if len(shapes) != 1:
        problem = "none is given" if not shapes else f"the shapes are {sorted(shapes)}"
        raise DataError(f"{method}: parts of one shape are needed to simulate, {problem}")
    zero = np.zeros(shapes.pop())
    return {k: found.get(k, zero) for k in (*truth_parts, *error_parts)}


def curves(
    items: Sequence[ArrayLike | Profile], *, what: str, axis: str
) -> tuple[list[Any], FloatArray | None, tuple[Step, ...]]:
    """Return readings as arrays, with the positions and the history that profiles carry."""
    profiles = [item for item in items if isinstance(item, Profile)]
    if not profiles:
        return list(items), None, ()
    if len(profiles) != len(items):
        raise DataError(f"{what}: give all readings as profiles, or all as arrays, not mixed")
    first = profiles[0]
    step = abs(float(np.ptp(first.x))) / max(len(first) - 1, 1)
    for i, other in enumerate(profiles[1:], start=2):
        if len(other) != len(first):
            raise DataError(
                f"{what}: reading {i} has {len(other)} samples, the first has {len(first)}; "
                "resample both onto the same positions"
            )
        shift = float(np.max(np.abs(other.x - first.x)))
        if shift > 1e-6 * step:
            raise DataError(
                f"{what}: the {axis} positions of reading {i} differ from the first by up to "
                f"{shift:.6g} {'rad' if axis == 'angle' else 'm'}; both must be given over the "
                "positions of the artefact (a reversal turns it by half a revolution)"
            )
    history = tuple(step for p in profiles for step in p.history)
    return [p.z for p in profiles], first.x, history


def stacked(readings: Sequence[ArrayLike], what: str) -> FloatArray:
    """Return curves, each perhaps repeated, as one array; missing repeats are NaN."""
    arrays = [as_numbers(r, f"{what} needs readings as numbers") for r in readings]
    shapes = [a.shape for a in arrays]
    if any(len(s) not in (1, 2) for s in shapes) or len({s[-1] for s in shapes}) != 1:
        raise DataError(
            f"{what}: readings must be curves of equal length, got the shapes "
            f"{', '.join(str(s) for s in shapes)}; resample them onto the same positions"
        )
    most = max(a.shape[0] if a.ndim == 2 else 1 for a in arrays)
    out = np.full((len(arrays), most, shapes[0][-1]), np.nan)
    for i, a in enumerate(arrays):
        rows = np.atleast_2d(a)
        out[i, : rows.shape[0]] = rows
    return out


def first_angle(positions: FloatArray | None, angle: ArrayLike | None, n: int, what: str) -> float:
    """Return the angle of the first sample of readings over one turn."""
    if positions is not None and angle is not None:
        raise DataError(f"{what}: profiles bring their angles, leave out angle")
    if positions is None and angle is None:
        return 0.0
    angles = positions if positions is not None else as_angles(angle, what)
    if angles.size != n:
        raise DataError(f"{what}: there are {angles.size} angles for {n} samples")
    require_turn(angles)
    return float(angles[0])


def as_angles(angle: ArrayLike | None, what: str) -> FloatArray:
    """Return angles as an array."""
    try:
        angles = np.array(angle, dtype=np.float64)
    except (TypeError, ValueError) as exc:
        raise InvalidSamplesError(f"{what}: the angles are no numbers ({exc})") from None
    if angles.ndim != 1 or not np.isfinite(angles).all():
        raise InvalidSamplesError(f"{what}: the angles must be one row of finite numbers, in rad")
    return angles


def require_turn(angle: FloatArray) -> None:
    """Refuse angles that are not equally spaced over one revolution."""
    n = angle.size
    step = 2.0 * np.pi / n
    apart = np.abs(angle - angle[0] - step * np.arange(n))
    if np.max(apart) > _ROUNDED * step:
        hint = _angle_hint(angle)
        raise InvalidSamplesError(
            f"the angles must be equally spaced over one revolution, {n} steps of "
            f"{np.degrees(step):.6g} deg; {hint}"
        )


def _angle_hint(angle: FloatArray) -> str:
    """Return what is probably the matter with angles that do not close one turn."""
    n = angle.size
    forward = float(np.median(np.diff(angle))) if n > 1 else 0.0
    if forward < 0.0:
        return "they fall: turn the samples round, or give the angle of the other sense"
    if np.max(np.abs(angle - angle[0] - 360.0 / n * np.arange(n))) < _ROUNDED * 360.0 / n:
        return "these look like degrees, rad are needed"
    turns = round(n * forward / (2.0 * np.pi))
    if turns > 1:
        return (
            f"they run through {turns} revolutions: tell them apart (repeat, a column that numbers "
            "them), or give an array (revolutions, samples)"
        )
    return "resample them; the last sample is not the first one again"


_ROUNDED = 0.01
"""Angles may lie this share of a step beside the grid: they were rounded in a text."""
