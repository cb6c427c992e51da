"""From checked readings of probes in a row to a `Separation`: noise, zero, null space, messages."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from metrosep.core.errors import DataError, NotSeparableError
from metrosep.core.provenance import Step
from metrosep.core.quantity import Quantity
from metrosep.core.units import format_length
from metrosep.separation._line_found import Found, solve
from metrosep.separation._line_null_space import PARABOLA, has_end_waves, null_space_of
from metrosep.separation._line_probes import Row, positions
from metrosep.separation._line_problem import (
    Problem,
    Sensor,
    check_size,
    checked_sensor,
    pooled_noise,
    problem_of,
)
from metrosep.separation._readings import NOISE_UNKNOWN
from metrosep.separation.contract import Separation
from metrosep.separation.null_space import Unobservable

FloatArray = NDArray[np.float64]

OPPOSITE = -0.8
"""A correlation below this between the pitch sensor and the pitch of the probes is a sign error."""

SIGNIFICANT = 4.0
"""The pitch must exceed its uncertainty by this factor before its sign is judged."""


@dataclass(frozen=True, slots=True)
class Zero:
    """A known zero difference of three probes and its standard uncertainty, m."""

    value: float
    u: float


@dataclass(frozen=True, slots=True)
class Request:
    """What is to be evaluated and how.

    Parameters
    ----------
    name : str
        Of the method, for messages.
    row : Row
        Probes.
    method : str
        Estimator.
    smoothing : float
        Weight of the penalty of the generalised estimator.
    zero : Zero or None
        Known zero difference.
    """

    name: str
    row: Row
    method: str
    smoothing: float
    zero: Zero | None = None


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
    """Return the separation of checked readings, shape (n_probes, R, n).

    Raises
    ------
    DataError
        If the noise, the pitch or the method do not fit.
    """
    row, n = request.row, readings.shape[2]
    check_size(n + row.span, request.name)
    at = positions(x, row.step, n, request.name)
    if request.method == "sequential" and pitch is not None:
        raise DataError(
            f"{request.name}: sums of readings have no place for a pitch sensor; use "
            "method='least_squares', 'generalised' or 'combined' with pitch"
        )
    noise, u_mean = _stated_noise(readings, row, u_reading)
    sensor = checked_sensor(pitch, u_pitch, n)
    clean = readings if request.zero is None else _without_zero(readings, row, request.zero.value)
    problem = problem_of(row, at, clean, sensor, u_mean)
    if sensor is not None:
        _check_sign(request, at, clean, sensor)
    seen = sensor is not None or row.zero_known or not row.pitch
    degree = 1 if seen else 2
    found = solve(problem, method=request.method, smoothing=request.smoothing, degree=degree)
    messages: list[str] = []
    if math.isnan(noise.value) and found.freedom > 0 and request.method == "least_squares":
        one = math.sqrt(found.rest / found.freedom * readings.shape[1])
        text = f"standard deviation of one reading, from {found.freedom} redundant rows (type A)"
        noise = Quantity(one, "m", text, u=one / math.sqrt(2.0 * found.freedom), symbol="s")
        u_mean = one / math.sqrt(readings.shape[1])
    elif u_mean is not None and u_mean > 0.0 and found.freedom > 0:
        messages += _misfit(found, u_mean, request.method)
    if math.isnan(noise.value):
        messages.append(NOISE_UNKNOWN)
    scale = math.nan if u_mean is None else u_mean
    parts, u = _scaled(found, scale, with_pitch=row.pitch or sensor is not None)
    if row.pitch:
        _add_zero(parts, u, request, found, scale, problem)
    gap = _gaps(parts, problem, found)
    null_space = null_space_of(row, degree, pitch_part=sensor is None) + gap
    messages += _messages(request, null_space, at, degree, gap)
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


def _stated_noise(
    readings: FloatArray, row: Row, u_reading: float | None
) -> tuple[Quantity, float | None]:
    """Return the noise of one reading and the uncertainty of the mean over the repeats."""
    counts = (~np.isnan(readings)).sum(axis=1)
    repeats = float(np.mean(counts[counts > 0]))
    if u_reading is not None:
        if not (math.isfinite(u_reading) and u_reading >= 0.0):
            raise DataError(
                f"u_reading is {u_reading}; it must be a standard uncertainty >= 0 in m"
            )
        text = "standard uncertainty of one reading, as stated"
        return Quantity(float(u_reading), "m", text, symbol="s"), u_reading / math.sqrt(repeats)
    o = np.array(row.offsets)
    nuisance = np.column_stack([np.ones(o.size), o]) if row.pitch else np.ones((o.size, 1))
    value, freedom = pooled_noise(readings, nuisance)
    if math.isnan(value):
        text = "standard deviation of one reading; not known"
        return Quantity(math.nan, "m", text, symbol="s"), None
    text = (
        f"standard deviation of one reading, pooled from {readings.shape[1]} repeats, straightness "
        "and pitch of each repeat removed (type A)"
    )
    u = value / math.sqrt(2.0 * freedom)
    return Quantity(value, "m", text, u=u, symbol="s"), value / math.sqrt(repeats)


def _without_zero(readings: FloatArray, row: Row, zero: float) -> FloatArray:
    """Return readings minus the smallest zeros that have this difference."""
    w = row.weights
    return np.asarray(readings - (w * zero / (w @ w))[:, None, None])


def _check_sign(request: Request, x: FloatArray, readings: FloatArray, sensor: Sensor) -> None:
    """Refuse a pitch sensor that runs opposite to the pitch that the probes see."""
    if not request.row.pitch:
        return
    row = replace(request.row, zero_known=False)
    alone = solve(
        problem_of(row, x, readings, None, None), method="least_squares", smoothing=0.0, degree=2
    )
    both = ~np.isnan(alone.pitch[0]) & ~np.isnan(sensor.values)
    if both.sum() < 5:
        return
    line = np.polynomial.legendre.legvander(np.linspace(-1.0, 1.0, x.size)[both], 1)
    seen, stated = (
        v[both] - line @ np.linalg.lstsq(line, v[both], rcond=None)[0]
        for v in (alone.pitch[0], sensor.values)
    )
    size = float(np.linalg.norm(seen) * np.linalg.norm(stated))
    strong = float(np.std(stated)) > SIGNIFICANT * sensor.u
    if size > 0.0 and strong and float(seen @ stated) < OPPOSITE * size:
        raise NotSeparableError(
            f"{request.name}: the pitch readings run opposite to the pitch that the probes see "
            f"(correlation {float(seen @ stated) / size:.2f}): positive is where the leading probe "
            "(larger x) reads more; pass -pitch"
        )


def _misfit(found: Found, u_mean: float, method: str) -> list[str]:
    ratio = math.sqrt(found.rest / found.freedom) / u_mean
    limit = 1.0 + 2.0 / math.sqrt(2.0 * found.freedom)
    if ratio <= limit:
        return []
    return [
        f"the redundant rows scatter {ratio:.3g} times more than the stated uncertainties say "
        f"({found.freedom} degrees of freedom): a probe drifts, a distance or sign is wrong"
        + ("" if method == "least_squares" else ", or the smoothing is too strong")
    ]


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
        w = np.append(row.weights, np.zeros(problem.sd.size - n))
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


def _gaps(
    parts: Mapping[str, FloatArray], problem: Problem, found: Found
) -> tuple[Unobservable, ...]:
    lost = np.flatnonzero(np.isnan(parts["artefact"]))
    if lost.size == 0:
        return ()
    text = (
        "readings that were not measured cut the chain, and offset and line of its pieces are not "
        "connected: the longest piece is returned; measure the gap again"
    )
    return (Unobservable("artefact", "samples", tuple(int(i) for i in lost), text),)


def _messages(
    request: Request,
    null_space: tuple[Unobservable, ...],
    x: FloatArray,
    degree: int,
    gap: tuple[Unobservable, ...],
) -> list[str]:
    out = []
    row = request.row
    if degree == 2:
        o = row.offsets
        length = float(x[-1] - x[0]) + o[-1] - o[0]
        sag = length**2 / (4.0 * (o[1] - o[0]) * (o[2] - o[0]))
        out.append(
            "the parabola is not known and left out: a zero error of 1 nm would be a sag of "
            f"{format_length(sag * 1e-9)} over {format_length(length)}; {PARABOLA}"
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
    if gap:
        out.append(f"{len(gap[0].indices)} samples are not connected with the rest and left NaN")
    return out


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
        audit["sag_of_zero_error"] = length**2 / (4.0 * (o[1] - o[0]) * (o[2] - o[0]))
    if request.zero is not None:
        audit["zero_nm"], audit["u_zero_nm"] = request.zero.value * 1e9, request.zero.u * 1e9
    if problem.sd.size > o.size:
        audit["pitch_sensor"] = True
    return audit
