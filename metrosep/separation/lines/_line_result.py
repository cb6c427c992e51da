"""From checked readings of probes in a row to a `Separation`: noise, zero, null space, messages."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from metrosep.core._arrays import FloatArray
from metrosep.core.errors import DataError, NotSeparableError, UnitError
from metrosep.core.provenance import Step
from metrosep.core.quantity import Quantity
from metrosep.core.units import format_length
from metrosep.separation._readings import NOISE_UNKNOWN
from metrosep.separation.contract import Separation, Unobservable
from metrosep.separation.lines._line_found import Found, solve
from metrosep.separation.lines._line_probes import Row, positions
from metrosep.separation.lines._line_problem import (
    PARABOLA,
    Problem,
    Request,
    Sensor,
    Zero,
    check_overlap,
    check_size,
    check_steps,
    checked_sensor,
    has_end_waves,
    null_space_of,
    number,
    pooled_noise,
    problem_of,
)

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


# ---- whether an angle sensor on the carriage tells of the pitch that the probes see ------------

OPPOSITE = -0.8
"""A correlation below this between the pitch sensor and the pitch of the probes is a sign error."""

ALIKE = 0.8
"""Above this correlation the ratio of both is that of their units."""

SIGNIFICANT = 4.0
"""The pitch must exceed its uncertainty by this factor before it is judged."""

RATIO = (0.3, 3.0)
"""Outside this ratio of the sensor to the probes a unit or a distance is wrong."""


def check_angle(what: str, row: Row, x: FloatArray, readings: FloatArray, sensor: Sensor) -> None:
    """Refuse a sensor that runs opposite to the pitch of the probes, or in another unit."""
    seen = _pitch_of(row, x, readings)
    both = ~np.isnan(seen) & ~np.isnan(sensor.values)
    if both.sum() < 5:
        return
    line = np.polynomial.legendre.legvander(np.linspace(-1.0, 1.0, x.size)[both], 1)
    probes, angle = (
        v[both] - line @ np.linalg.lstsq(line, v[both], rcond=None)[0]
        for v in (seen, sensor.values)
    )
    sizes = float(np.linalg.norm(probes)), float(np.linalg.norm(angle))
    if not (sizes[0] > 0.0 and float(np.std(angle)) > SIGNIFICANT * sensor.u):
        return
    alike, ratio = float(probes @ angle) / (sizes[0] * sizes[1]), sizes[1] / sizes[0]
    if ratio > RATIO[1] or (row.pitch and ratio < RATIO[0] and alike > ALIKE):
        raise UnitError(
            f"{what}: the pitch readings vary {ratio:.3g} times as much as the probes see it; give "
            "pitch in rad, readings and distances in m, and the sensor on the same carriage"
        )
    if row.pitch and alike < OPPOSITE:
        raise NotSeparableError(
            f"{what}: the pitch readings run opposite to the pitch that the probes see "
            f"(correlation {alike:.2f}): positive is where the leading probe (larger x) reads "
            "more; pass -pitch"
        )


def _pitch_of(row: Row, x: FloatArray, readings: FloatArray) -> FloatArray:
    """Return the pitch that the probes see; of two probes the slope between them, form and all."""
    if not row.pitch:
        count = (~np.isnan(readings[1] - readings[0])).sum(axis=0)
        total = np.nansum(readings[1] - readings[0], axis=0)
        distance = row.offsets[1] - row.offsets[0]
        return np.where(count > 0, total / np.maximum(count, 1) / distance, np.nan)
    free = replace(row, zero_known=False)
    problem = problem_of(free, x, readings, None, 0.0)
    return solve(problem, method="least_squares", smoothing=0.0, degree=2).pitch[0]


# ---- what a result of probes in a row says in plain words: gaps, counts, units, null space -----

LARGE_RANGE = 10e-3
"""Readings of a straightness probe that span more, m, were hardly given in m."""


def lost_samples(artefact: FloatArray, found: Found) -> tuple[Unobservable, ...]:
    """Return the samples that are NaN, with the reason."""
    lost = np.flatnonzero(np.isnan(artefact))
    if lost.size == 0:
        return ()
    reasons = []
    if lost.size > found.n_unread:
        reasons.append(
            "readings that were not measured cut the chain, and offset and line of its pieces are "
            "not connected: the longest piece is returned; measure the gap again"
        )
    if found.n_unread:
        reasons.append(
            "no probe read these samples together with the others: take a step as coarse as the "
            "positions, or measure there"
        )
    return (Unobservable("artefact", "samples", tuple(int(i) for i in lost), "; ".join(reasons)),)


def passes_per_position(problem: Problem) -> list[int]:
    """Return the least and the largest number of passes that a position rests on."""
    whole = problem.stations.valid[: problem.n_probes].all(axis=0)
    count = np.zeros(problem.x.size, dtype=np.intp)
    count[problem.stations.at[whole]] = problem.stations.count[whole]
    return [int(count.min()), int(count.max())]


def noise_messages(found: Found, noise: Quantity, scale: float, method: str) -> list[str]:
    """Return what is to be said about the noise, and a misfit of redundant rows."""
    if math.isnan(noise.value):
        return [NOISE_UNKNOWN]
    if found.freedom <= 0 or scale == 0.0:
        return []
    ratio = math.sqrt(found.rest / found.freedom) / scale
    if ratio <= 1.0 + 2.0 / math.sqrt(2.0 * found.freedom):
        return []
    return [
        f"the redundant rows scatter {ratio:.3g} times more than the noise of a reading says "
        f"({found.freedom} degrees of freedom): a probe drifts, a distance or sign is wrong"
        + ("" if method == "least_squares" else ", or the smoothing is too strong")
    ]


def reading_messages(readings: FloatArray, problem: Problem) -> list[str]:
    """Return doubts about the unit, and what became of passes that lack a reading."""
    out = []
    span = float(np.nanmax(readings) - np.nanmin(readings))
    if span > LARGE_RANGE:
        out.append(
            f"the readings span {span:.3g} m; they are taken in m: 5 um is 5e-6. Check the unit"
        )
    low, high = passes_per_position(problem)
    missing = np.isnan(readings)
    if readings.shape[1] > 1 and missing.any():
        torn = int((missing.any(axis=0) & ~missing.all(axis=0)).sum())
        text = f"the positions rest on {low} to {high} passes, and u follows these counts"
        if torn:
            text += (
                f"; in {torn} cases a pass is missing a probe: as each pass has its own straightness and "
                "pitch, the rest of that pass counts there only where it is free of them"
            )
        out.append(text)
    if problem.stations.n_lost_angles:
        out.append(
            f"at {problem.stations.n_lost_angles} positions the angle was left out: it is the mean of "
            "all passes, and a pass lacks a probe there"
        )
    return out


def null_space_messages(
    request: Request,
    null_space: tuple[Unobservable, ...],
    x: FloatArray,
    degree: int,
    found: Found,
    artefact: FloatArray,
) -> list[str]:
    """Return what these probes do not see."""
    out = []
    row = request.row
    if degree == 2:
        o = row.offsets
        length = float(x[-1] - x[0]) + o[-1] - o[0]
        sag = length**2 / (4.0 * (o[1] - o[0]) * (o[2] - o[0]))
        keep = "pass zero=0.0 to keep the parabola, " if request.name == "three_point" else ""
        out.append(
            "the parabola is not known and left out: a zero error of 1 nm would be a sag of "
            f"{format_length(sag * 1e-9)} over {format_length(length)}; {keep}{PARABOLA}"
        )
    for item in null_space:
        if item.kind == "wavelength":
            named = ", ".join(format_length(float(w)) for w in item.indices[:4])
            more = " ..." if len(item.indices) > 4 else ""
            out.append(f"the wavelengths {named}{more} are suppressed by these probe distances")
    if has_end_waves(row) and request.method == "least_squares":
        out.append(
            "waves that die away from the ends are not determined by these distances and removed by "
            "least squares: the ends are doubtful; method='generalised' takes the smoothest curve"
        )
    lost = int(np.isnan(artefact).sum())
    if found.n_unread:
        out.append(f"{found.n_unread} samples were read by no probe in a usable row and are NaN")
    if lost > found.n_unread:
        out.append(f"{lost - found.n_unread} samples are not connected with the rest and left NaN")
    return out
