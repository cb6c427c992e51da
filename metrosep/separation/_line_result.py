"""From checked readings of probes in a row to a `Separation`: noise, zero, null space, messages."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from metrosep.core._arrays import FloatArray
from metrosep.core.errors import DataError
from metrosep.core.provenance import Step
from metrosep.core.quantity import Quantity
from metrosep.separation._line_angle import check_angle
from metrosep.separation._line_coverage import check_overlap, check_steps
from metrosep.separation._line_found import Found, solve
from metrosep.separation._line_messages import (
    lost_samples,
    noise_messages,
    null_space_messages,
    passes_per_position,
    reading_messages,
)
from metrosep.separation._line_null_space import null_space_of
from metrosep.separation._line_probes import Row, positions
from metrosep.separation._line_problem import Problem, check_size, checked_sensor, problem_of
from metrosep.separation._line_request import Request, Zero, number
from metrosep.separation._line_stations import pooled_noise
from metrosep.separation.contract import Separation

__all__ = ["Request", "Zero", "evaluate"]


def evaluate(
    request: Request,
    readings: FloatArray,
    *,
    x: ArrayLike | None,
    u_reading: float | None,
    pitch: ArrayLike | None = None,
    u_pitch: float | None = None,
    history: tuple[Step, ...] = (),
) -> Separation:
    """Return the separation of checked readings, shape (n_probes, R, n)."""
    row, n = request.row, readings.shape[2]
    check_size(n + row.span, request.name)
    at = positions(x, row.step, n, request.name)
    if request.method == "sequential":
        check_steps(row, at, request.name)
    check_overlap(row, at, request.name)
    if request.method == "sequential" and pitch is not None:
        raise DataError(
            f"{request.name}: sums of readings have no place for a pitch sensor; use "
            "method='least_squares', 'generalised' or 'combined' with pitch"
        )
    noise = _stated_noise(readings, row, u_reading)
    sensor = checked_sensor(pitch, u_pitch, n)
    clean = readings if request.zero is None else _without_zero(readings, row, request.zero.value)
    problem = problem_of(row, at, clean, sensor, noise.value)
    if sensor is not None:
        check_angle(request.name, row, at, clean, sensor)
    seen = sensor is not None or row.zero_known or not row.pitch
    degree = 1 if seen else 2
    found = solve(problem, method=request.method, smoothing=request.smoothing, degree=degree)
    if math.isnan(noise.value) and found.freedom > 0:
        noise = _noise_of_rest(found, problem.stations.most)
    scale = noise.value / math.sqrt(problem.stations.most)
    parts, u = _scaled(found, scale, with_pitch=row.pitch or sensor is not None)
    if row.pitch:
        _add_zero(parts, u, request, found, scale, problem)
    gap = lost_samples(parts["artefact"], found)
    null_space = null_space_of(row, degree, pitch_part=sensor is None) + gap
    messages = [
        *noise_messages(found, noise, scale, request.method),
        *reading_messages(readings, problem),
        *null_space_messages(request, null_space, at, degree, found, parts["artefact"]),
    ]
    return Separation(
        request.name,
        parts,
        u,
        {k: "rad" if k == "pitch" else "m" for k in parts},
        {"x": problem.grid, "carriage_x": at},
        null_space,
        noise=noise,
        audit=_audit(request, problem, found, readings, degree),
        messages=tuple(messages),
        history=(*history, Step(request.name, {"method": request.method})),
    )


def _stated_noise(readings: FloatArray, row: Row, u_reading: float | None) -> Quantity:
    """Return the noise of one reading, stated or from the passes; NaN if neither."""
    if u_reading is not None:
        value = number(u_reading, "u_reading")
        if not (math.isfinite(value) and value >= 0.0):
            raise DataError(
                f"u_reading is {u_reading}; it must be a standard uncertainty >= 0 in m"
            )
        text = "standard uncertainty of one reading, as stated"
        return Quantity(value, "m", text, symbol="s")
    o = np.array(row.offsets)
    nuisance = np.column_stack([np.ones(o.size), o]) if row.pitch else np.ones((o.size, 1))
    value, freedom = pooled_noise(readings, nuisance)
    if math.isnan(value):
        text = "standard deviation of one reading; not known"
        return Quantity(math.nan, "m", text, symbol="s")
    text = (
        f"standard deviation of one reading, pooled from {readings.shape[1]} repeats, straightness "
        "and pitch of each repeat removed (type A)"
    )
    return Quantity(value, "m", text, u=value / math.sqrt(2.0 * freedom), symbol="s")


def _noise_of_rest(found: Found, most: int) -> Quantity:
    """Return the noise of one reading from what least squares leaves of redundant rows."""
    one = math.sqrt(found.rest_least / found.freedom * most)
    text = f"standard deviation of one reading, from {found.freedom} redundant rows (type A)"
    return Quantity(one, "m", text, u=one / math.sqrt(2.0 * found.freedom), symbol="s")


def _without_zero(readings: FloatArray, row: Row, zero: float) -> FloatArray:
    """Return readings minus the smallest zeros that have this difference."""
    w = row.weights
    return np.asarray(readings - (w * zero / (w @ w))[:, None, None])


def _scaled(
    found: Found, scale: float, *, with_pitch: bool
) -> tuple[dict[str, FloatArray], dict[str, FloatArray]]:
    named = {"artefact": found.artefact, "straightness": found.straightness}
    if with_pitch:
        named["pitch"] = found.pitch
    parts = {k: v for k, (v, _) in named.items()}
    return parts, {
        k: np.where(np.isnan(parts[k]), np.nan, w * scale) for k, (_, w) in named.items()
    }


def _add_zero(
    parts: dict[str, FloatArray],
    u: dict[str, FloatArray],
    request: Request,
    found: Found,
    scale: float,
    problem: Problem,
) -> None:
    """Add the zero difference as a part, and the parabola of its uncertainty where it was given."""
    row, n = request.row, len(request.row.offsets)
    if n == 3:
        w = np.append(row.weights, np.zeros(problem.n_sensors - n))
        if request.zero is not None:
            parts["zero"], u["zero"] = np.array(request.zero.value), np.array(request.zero.u)
        else:
            parts["zero"], u["zero"] = _zero_difference(found, w, scale)
    if request.zero is None or request.zero.u == 0.0:
        return
    d1 = row.offsets[1] - row.offsets[0]
    q = request.zero.u / (d1 * (row.offsets[2] - row.offsets[0]))
    known = ~np.isnan(parts["artefact"])
    centre = float(np.mean(problem.grid[known]))
    square = (problem.grid - centre) ** 2
    t = problem.x - centre
    o = np.array(row.offsets)
    a = np.linalg.lstsq(np.column_stack([np.ones(n), o]), o**2, rcond=None)[0]
    bent = {
        "artefact": square - float(np.mean(square[known])),
        "straightness": -(t**2) - a[0] + float(np.mean(square[known])),
        "pitch": -2.0 * t - a[1],
    }
    for name, curve in bent.items():
        u[name] = np.sqrt(u[name] ** 2 + (q * curve) ** 2)


def _zero_difference(found: Found, w: FloatArray, scale: float) -> tuple[FloatArray, FloatArray]:
    """Return the zero difference and its uncertainty; NaN where a hidden artefact changes it."""
    hidden = np.abs(w @ found.zeros_hidden).max(initial=0.0)
    if not found.zeros_cov.any() or hidden > 1e-6 * np.abs(w).max():
        return np.array(np.nan), np.array(np.nan)
    spread = math.sqrt(max(float(w @ found.zeros_cov @ w), 0.0))
    return np.array(w @ found.zeros), np.array(spread * scale)


def _audit(
    request: Request, problem: Problem, found: Found, readings: FloatArray, degree: int
) -> dict[str, Any]:
    row = request.row
    o = np.array(row.offsets)
    audit: dict[str, Any] = {
        "method": request.method,
        "offsets_mm": (o * 1e3).tolist(),
        "step_mm": row.step * 1e3,
        "n_positions": int(problem.x.size),
        "n_positions_used": int(found.used.stop - found.used.start),
        "n_repeats": int(readings.shape[1]),
        "passes_per_position": passes_per_position(problem),
        "n_artefact": int(problem.grid.size),
        "degrees_of_freedom": int(found.freedom),
        "removed": "least squares: "
        + ("offset, line" if degree < 2 else "offset, line, parabola"),
    }
    if request.method in ("generalised", "combined"):
        audit["smoothing"] = request.smoothing
    if row.shifts is None:
        audit["interpolation"] = "spline of degree 5"
    if row.pitch:
        length = float(np.ptp(problem.grid))
        audit["sag_of_zero_error"] = float(length**2 / (4.0 * (o[1] - o[0]) * (o[2] - o[0])))
    if request.zero is not None:
        audit["zero_nm"], audit["u_zero_nm"] = request.zero.value * 1e9, request.zero.u * 1e9
    if problem.n_sensors > o.size:
        audit["pitch_sensor"] = True
    return audit
