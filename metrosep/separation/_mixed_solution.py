"""The work of `OrthogonalMixed.separate`: transfer, harmonics, uncertainty, audit."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Literal

import numpy as np
from numpy.typing import ArrayLike

from metrosep.core._arrays import ComplexArray, FloatArray
from metrosep.core.provenance import Step
from metrosep.core.quantity import Quantity
from metrosep.separation._circle import (
    centred,
    check_kmax,
    curve,
    grid,
    harmonics_of,
    referred_to_zero,
    revolutions,
)
from metrosep.separation._readings import size_doubts
from metrosep.separation.contract import Separation

if TYPE_CHECKING:
    from metrosep.separation.mixed import OrthogonalMixed

__all__ = ["PARTS", "mixed_transfer", "separate_mixed"]


PARTS = ("artefact", "x")
_ACROSS = (
    "motion across the displacement probe (y) is not read by either probe; turn the set-up by 90 "
    "degrees for it"
)
_UNKNOWN = (
    "the noise is not known: give u_reading and u_slope, or repeated revolutions; no uncertainty "
    "is stated"
)

_LARGEST_SLOPE = 0.1
"""rad; no round part has a surface as steep, but urad given as rad do."""


def mixed_transfer(kmax: int, *, turn: Literal[1, -1] = 1) -> ComplexArray:
    """Return W_k of the orthogonal mixed method, ``1 + j k j^k``, for k = 0 ... kmax.

    Parameters
    ----------
    kmax : int
        Highest undulation per revolution, >= 2.
    turn : {1, -1}, optional
        -1 gives the complex conjugate.

    Returns
    -------
    ndarray of complex, shape (kmax + 1,)
        Zero at k = 1.

    Raises
    ------
    DataError
        If kmax is below 2.

    Examples
    --------
    >>> mixed_transfer(4)
    array([1.+0.j, 0.+0.j, 1.-2.j, 4.+0.j, 1.+4.j])
    """
    k = np.arange(check_kmax(kmax) + 1)
    quarter = np.array([1, 1j, -1, -1j])[k % 4]
    w: ComplexArray = 1.0 + 1j * k * quarter
    return w if turn == 1 else w.conj()


def separate_mixed(
    method: OrthogonalMixed,
    readings: ArrayLike,
    stated: float | None,
    start_angle: float,
    history: tuple[Step, ...],
) -> Separation:
    """Return the separation that displacement and slope give."""
    given = revolutions(readings, 2, what="probes", n_min=2 * method.kmax + 1)
    array = given.values
    messages = [*given.messages, *size_doubts(centred(array[:1]), method.name)]
    slope_span = float(np.ptp(centred(array[1])))
    if slope_span > _LARGEST_SLOPE:
        messages.append(f"the slopes span {slope_span:.3g} rad; are they in rad? 5 urad is 5e-6")
    turns, n = array.shape[1:]
    scale = np.array([1.0, method.radius])
    each = harmonics_of(array, method.kmax) * scale[:, np.newaxis, np.newaxis]
    rows = _rows(method)
    found = np.einsum("pik,ik->pk", rows, each.mean(axis=1))
    noise, u_k = _noise(method, array, each, rows, stated)
    terms = _type_b(method, rows, each.mean(axis=1), found, n)
    u_curve = np.sqrt(
        np.nansum(u_k**2, axis=1)[:, np.newaxis]
        + sum((square for square, _ in terms.values()), np.zeros((2, n)))
    )
    if math.isnan(noise.value):
        u_curve[:] = np.nan
        messages.append(_UNKNOWN)
    u_harmonics = np.sqrt(u_k**2 + sum(square for _, square in terms.values()))
    audit = {
        "kmax": method.kmax,
        "radius_mm": method.radius * 1e3,
        "turn": method.turn,
        "n_samples": n,
        "n_revolutions": turns,
        "n_revolutions_left_out": given.n_left_out,
        "start_angle_deg": math.degrees(start_angle),
        "transfer": [float(w) for w in np.abs(mixed_transfer(method.kmax))],
        "removed": "k = 0 and k = 1 of both parts, k > kmax",
        "not_read": _ACROSS,
        "noise_source": noise.definition,
        "type_b": {
            part: {f"{t} / m": float(math.sqrt(v[0][i].mean())) for t, v in terms.items()}
            for i, part in enumerate(PARTS)
        },
    }
    return Separation(
        method.name,
        dict(zip(PARTS, curve(found, n), strict=True)),
        dict(zip(PARTS, u_curve, strict=True)),
        dict.fromkeys(PARTS, "m"),
        {"angle": start_angle + grid(n)},
        method.null_space(),
        noise,
        dict(zip(PARTS, referred_to_zero(found, start_angle), strict=True)),
        dict(zip(PARTS, u_harmonics, strict=True)),
        audit,
        tuple(messages),
        (*history, Step(method.name, {"kmax": method.kmax, "radius_m": method.radius})),
    )


def _rows(method: OrthogonalMixed) -> ComplexArray:
    """Return (part, reading, k): R = (D + S)/W, X = D - R, with S the slope times radius."""
    w = mixed_transfer(method.kmax, turn=method.turn)
    w[:2] = 1.0
    rows = np.stack([np.stack([1.0 / w, 1.0 / w]), np.stack([1.0 - 1.0 / w, -1.0 / w])])
    rows[:, :, :2] = np.nan
    return rows


def _noise(
    method: OrthogonalMixed,
    array: FloatArray,
    each: ComplexArray,
    rows: ComplexArray,
    stated: float | None,
) -> tuple[Quantity, FloatArray]:
    turns, n = array.shape[1:]
    text, value, u_value = "standard deviation of one displacement reading; ", math.nan, None
    if stated is not None and method.u_slope is not None:
        sd = np.array([stated, method.radius * method.u_slope])
        variance = np.einsum("pik,i->pk", np.abs(rows) ** 2, sd**2) * 2.0 / (n * turns)
        value, text = stated, text + "as stated"
    elif turns > 1:
        about = each - each.mean(axis=1, keepdims=True)
        scatter = np.einsum("pik,imk->pmk", rows, about)
        variance = np.sum(np.abs(scatter) ** 2, axis=1) / (2.0 * (turns - 1) * turns)
        dof = (n - 3) * (turns - 1)
        value = math.sqrt(float(np.sum(centred(array[0] - array[0].mean(axis=0)) ** 2)) / dof)
        u_value = value / math.sqrt(2.0 * dof)
        text += f"type A from {turns} revolutions, asynchronous motion included"
    else:
        variance = np.full((2, method.kmax + 1), np.nan)
        text += "not known"
    return Quantity(value, "m", text, u_value, "s"), np.sqrt(variance)


def _type_b(
    method: OrthogonalMixed, rows: ComplexArray, mean: ComplexArray, found: ComplexArray, n: int
) -> dict[str, tuple[FloatArray, FloatArray]]:
    """Return variances of curves (2, N) and of harmonics (2, kmax + 1) of each term."""
    k = np.arange(method.kmax + 1)
    bent = -(k**2) * np.exp(0.5j * np.pi * method.turn * k) * found[0]
    across = 1j * found[1]
    out = {}
    for label, u, causes in (
        ("angle between the probes", method.u_angle, (bent, across)),
        ("radius", method.u_radius / method.radius, (mean[1],)),
    ):
        if u == 0.0:
            continue
        moved = np.stack([rows[:, 1] * cause * u for cause in causes], axis=1)
        out[label] = (
            np.sum(curve(moved, n) ** 2, axis=1),
            np.sum(np.abs(moved) ** 2, axis=1) / 2.0,
        )
    return out
