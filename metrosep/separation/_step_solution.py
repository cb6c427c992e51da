"""The work of `MultistepRoundness.separate`: estimators, drift, noise, audit."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike

from metrosep.core._arrays import ComplexArray, FloatArray
from metrosep.core.provenance import Step
from metrosep.core.quantity import Quantity
from metrosep.separation._circle import (
    Revolutions,
    centred,
    curve,
    grid,
    harmonics_of,
    names_of_k,
    referred_to_zero,
    revolutions,
)
from metrosep.separation._readings import size_doubts
from metrosep.separation.contract import Separation
from metrosep.separation.null_space import suppressed_harmonics

if TYPE_CHECKING:
    from metrosep.separation.steps import MultistepRoundness

__all__ = ["StepGeometry", "separate_steps", "step_geometry"]


_PARTS = ("artefact", "spindle")

_EXCESS = 5.0
"""Chi-square this many of its standard deviations too large is said."""

_ROUNDING = 1e-9
"""Differences of this share of the readings are no finding."""


@dataclass(frozen=True, slots=True)
class StepGeometry:
    """Estimators of R and S from the P positions, for k = 0 ... kmax."""

    rows: ComplexArray  # of complex, shape (2, kmax + 1, P): naN where not observable
    # shape (2, kmax + 1): noise of R and S over that of a reading's harmonic; inf where not
    # observable
    gain: FloatArray
    phase: ComplexArray  # of complex, shape (kmax + 1, P): ``exp(j k t alpha_p)``


def step_geometry(method: MultistepRoundness) -> StepGeometry:
    """Return the least-squares estimators of an arrangement of steps."""
    alpha = method.turn * np.array(method.angles)
    k = np.arange(method.kmax + 1)
    phase = np.exp(1j * np.outer(k, alpha))
    common = phase.mean(axis=1)
    seen = phase - common[:, np.newaxis]
    size2 = np.sum(np.abs(seen) ** 2, axis=1)
    hidden = size2 * method.max_gain**2 < 1.0
    hidden[0] = True
    hidden[1] |= method.eccentricity == "free"
    size2[hidden] = 1.0
    row_r = seen.conj() / size2[:, np.newaxis]
    rows = np.stack([row_r, 1.0 / alpha.size - common[:, np.newaxis] * row_r])
    rows[:, hidden] = np.nan
    gain = np.sqrt(np.sum(np.abs(rows) ** 2, axis=2))
    return StepGeometry(rows, np.where(np.isnan(gain), np.inf, gain), phase)


def separate_steps(
    method: MultistepRoundness,
    readings: ArrayLike,
    u_reading: float | None,
    start_angle: float,
    history: tuple[Step, ...],
) -> Separation:
    """Return the separation that the method's estimators make of the readings."""
    positions = len(method.angles)
    given = revolutions(readings, positions, what="index positions", n_min=2 * method.kmax + 1)
    messages = [*given.messages, *size_doubts(centred(given.values), method.name)]
    array, rate, u_rate = _without_drift(method, given)
    turns, n = array.shape[1:]
    geometry = step_geometry(method)
    each = harmonics_of(array, method.kmax)
    mean = each.mean(axis=1)
    found: ComplexArray = np.einsum("akp,pk->ak", geometry.rows, mean)
    rest = mean - geometry.phase.T * found[0] - found[1]
    noise, u_k, from_steps = _noise(geometry, each, rest, u_reading, n)
    term = None if from_steps else _index_term(method, geometry, found, n)
    square_curve, square_k = (0.0, 0.0) if term is None else term
    u_curve = np.zeros((2, n)) + np.sqrt(np.nansum(u_k**2, axis=1)[:, np.newaxis] + square_curve)
    if math.isnan(noise.value):
        u_curve[:] = np.nan
        messages.append(
            "the noise is not known from two positions and one revolution: give u_reading or more "
            "steps or repeated revolutions; no uncertainty is stated"
        )
    null_space = method.null_space()
    hidden = suppressed_harmonics(null_space)
    if hidden:
        messages.append(
            f"k={names_of_k(hidden)} {'is' if len(hidden) == 1 else 'are'} alike at all index "
            "positions: NaN in harmonics, absent from the curves"
        )
    if from_steps and method.u_index > 0.0:
        messages.append(
            "the index errors show in what the positions disagree by, so u_index is not added to it"
        )
    seen = np.isfinite(found[0])
    audit: dict[str, Any] = {
        "angles_deg": np.rad2deg(method.angles).tolist(),
        "turn": method.turn,
        "kmax": method.kmax,
        "n_samples": n,
        "n_revolutions": turns,
        "n_revolutions_left_out": given.n_left_out,
        "start_angle_deg": math.degrees(start_angle),
        "gain": [float(g) if math.isfinite(g) else None for g in geometry.gain[0]],
        "suppressed": hidden,
        "eccentricity": method.eccentricity,
        "removed": "k = 0 of both parts, k > kmax"
        + (", k = 1" if method.eccentricity == "free" else ""),
        "drift": method.drift,
        "drift_nm_per_revolution": rate * 1e9,
        "u_drift_nm_per_revolution": None if math.isnan(u_rate) else u_rate * 1e9,
        "residual_rms_nm": 1e9
        * math.sqrt(float(np.mean(np.sum(np.abs(rest[:, seen]) ** 2, axis=1)) / 2.0)),
        "noise_source": noise.definition,
        "type_b": {
            part: {} if term is None else {"index angles / m": math.sqrt(term[0][i].mean())}
            for i, part in enumerate(_PARTS)
        },
    }
    dof = positions * turns - 2
    messages += _drift_left(method, rate, u_rate, dof, u_curve[1]) + _wide_index(method)
    messages += _first_harmonic(method, rest, float(np.abs(mean).max()))
    return Separation(
        method.name,
        dict(zip(_PARTS, curve(found, n), strict=True)),
        dict(zip(_PARTS, u_curve, strict=True)),
        dict.fromkeys(_PARTS, "m"),
        {"angle": start_angle + grid(n)},
        null_space,
        noise,
        dict(zip(_PARTS, referred_to_zero(found, start_angle), strict=True)),
        dict(zip(_PARTS, np.sqrt(u_k**2 + square_k), strict=True)),
        audit,
        tuple(messages),
        (*history, Step(method.name, {"kmax": method.kmax, "angles_deg": audit["angles_deg"]})),
    )


def _without_drift(
    method: MultistepRoundness, given: Revolutions
) -> tuple[FloatArray, float, float]:
    """Return readings without linear drift, the drift per revolution and its uncertainty.

    Revolutions keep their number when another is left out: time went on.
    """
    positions, _, n = given.values.shape
    between = float(given.n_given if method.step_revolutions is None else method.step_revolutions)
    start = between * np.arange(positions)[:, np.newaxis] + given.kept
    level = given.values.mean(axis=2)
    time, about = start - start.mean(), level - level.mean()
    size2 = float(np.sum(time**2))
    rate = float(np.sum(time * about)) / size2
    dof = level.size - 2
    square = float(np.sum((about - rate * time) ** 2))
    u_rate = math.sqrt(square / dof / size2) if dof > 0 else math.nan
    if method.drift == "none":
        return given.values, rate, u_rate
    drift = rate * (start[:, :, np.newaxis] + np.arange(n) / n)
    return given.values - drift, rate, u_rate


def _drift_left(
    method: MultistepRoundness, rate: float, u_rate: float, dof: int, u_spindle: FloatArray
) -> list[str]:
    """Say so where a drift that is not taken off stands out and matters to the spindle."""
    if method.drift == "linear" or dof < 1:
        return []
    # Student's t has long tails where few levels stand behind the line
    limit = _EXCESS * (1.0 + (3.0 / dof) ** 2)
    matters = float(np.sqrt(np.mean(u_spindle**2)))
    if not abs(rate) > limit * u_rate or abs(rate) <= matters:
        return []
    text = (
        f"the level drifts by {rate * 1e9:.3g} nm per revolution (u {u_rate * 1e9:.2g} nm), which "
        "is a step of that height in the spindle at the start of the revolution: give "
        "drift='linear' if the steps followed each other in time"
    )
    return [text]


def _wide_index(method: MultistepRoundness) -> list[str]:
    """Say so where the uncertainty of the positions is no small angle for the highest undulation."""
    if method.kmax * method.u_index <= 1.0:
        return []
    text = (
        f"u_index of {math.degrees(method.u_index):.3g} deg is no small angle for k above "
        f"{int(1.0 / method.u_index)}, where its share of u is too small a guess; was it in rad?"
    )
    return [text]


def _noise(
    geometry: StepGeometry,
    each: ComplexArray,
    rest: ComplexArray,
    u_reading: float | None,
    n: int,
) -> tuple[Quantity, FloatArray, bool]:
    """Return noise of one reading, u of harmonics, and whether it came from the steps."""
    positions, turns = each.shape[:2]
    gain = np.where(np.isinf(geometry.gain), np.nan, geometry.gain)
    text = "standard deviation of one reading; "
    if u_reading is not None:
        u_k = gain * u_reading * math.sqrt(2.0 / (n * turns))
        return Quantity(u_reading, "m", text + "as stated", None, "s"), u_k, False
    seen = np.isfinite(rest[0])
    if positions > 2:
        per_k = np.sum(np.abs(rest) ** 2, axis=0) / (2.0 * (positions - 2))
        dof = 2 * (positions - 2) * int(seen.sum())
        value = math.sqrt(float(per_k[seen].mean()) * n * turns / 2.0)
        text += (
            f"type A from what {positions} positions disagree by, spindle not repeating included"
        )
        return (
            Quantity(value, "m", text, value / math.sqrt(2.0 * dof), "s"),
            gain * np.sqrt(per_k),
            True,
        )
    if turns > 1:
        about = each - each.mean(axis=1, keepdims=True)
        per_k = np.sum(np.abs(about) ** 2, axis=(0, 1)) / (2.0 * positions * (turns - 1))
        dof = 2 * positions * (turns - 1) * int(seen.sum())
        value = math.sqrt(float(per_k[seen].mean()) * n / 2.0)
        text += f"type A from {turns} revolutions"
        u_k = gain * np.sqrt(per_k / turns)
        return Quantity(value, "m", text, value / math.sqrt(2.0 * dof), "s"), u_k, False
    return Quantity(math.nan, "m", text + "not known", None, "s"), gain * math.nan, False


def _index_term(
    method: MultistepRoundness, geometry: StepGeometry, found: ComplexArray, n: int
) -> tuple[FloatArray, FloatArray] | None:
    """Return variances of curves (2, N) and harmonics (2, kmax + 1) from independent index errors."""
    if method.u_index == 0.0:
        return None
    k = np.arange(method.kmax + 1)
    shown = 1j * method.turn * k * geometry.phase.T * found[0] * method.u_index
    moved = geometry.rows.transpose(0, 2, 1) * shown
    return np.sum(curve(moved, n) ** 2, axis=1), np.sum(np.abs(moved) ** 2, axis=1) / 2.0


def _first_harmonic(method: MultistepRoundness, rest: ComplexArray, size: float) -> list[str]:
    """Say so where k = 1 disagrees far more between steps than the other undulations do."""
    positions = rest.shape[0]
    if method.eccentricity == "free" or positions < 4 or method.kmax < 6:
        return []
    power = np.sum(np.abs(rest) ** 2, axis=0)
    others = power[2:][np.isfinite(power[2:])]
    level = float(np.median(others)) if others.size else math.nan
    limit = 1.0 + _EXCESS * math.sqrt(1.0 / (positions - 2)) * 2.0
    if not power[1] > max(limit * level, (_ROUNDING * size) ** 2):
        return []
    text = (
        "k = 1 differs from step to step far more than other undulations: if the artefact was "
        "centred anew, give eccentricity='free'"
    )
    return [text]
