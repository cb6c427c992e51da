"""The work of `MultiprobeRoundness.separate`: harmonics, uncertainty, audit, messages."""

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
    centred,
    curve,
    grid,
    harmonics_of,
    names_of_k,
    referred_to_zero,
    revolutions,
)
from metrosep.separation._probe_geometry import ProbeGeometry
from metrosep.separation._probe_settings import PARTS
from metrosep.separation._readings import size_doubts
from metrosep.separation.contract import Separation
from metrosep.separation.null_space import suppressed_harmonics

if TYPE_CHECKING:
    from metrosep.separation.probes import MultiprobeRoundness

__all__ = ["separate_probes"]


_FEW_REVOLUTIONS = 5
"""Below this the uncertainty of a harmonic from revolutions has fewer than 8 degrees of freedom."""

_DISAGREE = 5.0
"""Excess of chi-square, in its standard deviations, at which the probes are said to disagree."""


_ROUNDING = 1e-12
"""Disagreement of this share of the readings is rounding."""


@dataclass(frozen=True, slots=True)
class _Noise:
    """Type A: of one reading, and of each harmonic of each part."""

    value: float
    u_value: float | None
    source: str
    harmonics: FloatArray

    @property
    def quantity(self) -> Quantity:
        return Quantity(
            self.value, "m", f"standard deviation of one reading; {self.source}", self.u_value, "s"
        )


def separate_probes(
    method: MultiprobeRoundness,
    geometry: ProbeGeometry,
    readings: ArrayLike,
    u_reading: float | None,
    start_angle: float,
    history: tuple[Step, ...],
) -> Separation:
    """Return the separation that the method's estimators make of the readings."""
    n = len(method.angles)
    given = revolutions(readings, n, what="probes", n_min=2 * method.kmax + 1)
    array = given.values
    messages = [*given.messages, *size_doubts(centred(array), method.name)]
    n_samples, n_turns = array.shape[2], array.shape[1]
    each = harmonics_of(array, method.kmax)
    mean = each.mean(axis=1)
    found = _parts(geometry, mean)
    misfit, freedom = _misfit(geometry, mean)
    noise = _noise(method, geometry, array, each, misfit, freedom, u_reading)
    terms = _type_b(method, geometry, mean, found, n_samples)
    curves = curve(found, n_samples)
    u_curves = np.sqrt(
        np.nansum(noise.harmonics**2, axis=1)[:, np.newaxis]
        + sum((square for square, _ in terms.values()), np.zeros((3, n_samples)))
    )
    if math.isnan(noise.value):
        u_curves[:] = np.nan
        messages.append(noise.source)
    u_harmonics = np.sqrt(noise.harmonics**2 + sum(square for _, square in terms.values()))
    null_space = method.null_space()
    ratio = _chi2_ratio(geometry, each, noise, misfit, freedom, n_samples)
    messages += _messages(method, null_space, noise, n_turns, ratio, freedom)
    audit: dict[str, Any] = {
        "angles_deg": np.rad2deg(method.angles).tolist(),
        "turn": method.turn,
        "kmax": method.kmax,
        "n_samples": n_samples,
        "n_revolutions": n_turns,
        "n_revolutions_left_out": given.n_left_out,
        "start_angle_deg": math.degrees(start_angle),
        "max_gain": method.max_gain,
        "gain": [float(g) if math.isfinite(g) else None for g in geometry.gain[0]],
        "suppressed": suppressed_harmonics(null_space),
        "removed": "k = 0 and k = 1 of every part, k > kmax",
        "noise_source": noise.source,
        "residual_chi2_ratio": ratio,
        "residual_freedom": freedom,
        **_eccentricity(method, mean),
        "type_b": {
            part: {
                f"{label} / m": float(math.sqrt(square[i].mean()))
                for label, (square, _) in terms.items()
            }
            for i, part in enumerate(PARTS)
        },
    }
    messages += _limacon_message(audit)
    return Separation(
        method.name,
        dict(zip(PARTS, curves, strict=True)),
        dict(zip(PARTS, u_curves, strict=True)),
        dict.fromkeys(PARTS, "m"),
        {"angle": start_angle + grid(n_samples)},
        null_space,
        noise.quantity,
        dict(zip(PARTS, referred_to_zero(found, start_angle), strict=True)),
        dict(zip(PARTS, np.where(np.isnan(found), np.nan, u_harmonics), strict=True)),
        audit,
        tuple(messages),
        (*history, Step(method.name, {"kmax": method.kmax, "angles_deg": audit["angles_deg"]})),
    )


def _parts(geometry: ProbeGeometry, spectra: ComplexArray) -> ComplexArray:
    """Return (3, ..., kmax + 1) from (n, ..., kmax + 1)."""
    out: ComplexArray = np.einsum("pkn,n...k->p...k", geometry.rows, spectra)
    return out


def _rest(geometry: ProbeGeometry, spectra: ComplexArray) -> ComplexArray:
    """Return the whitened rest (k, ..., n) of spectra (n, ..., k) that no parts explain."""
    known = geometry.freedom > 0
    out: ComplexArray = np.einsum(
        "kij,jl,l...k->k...i", geometry.residual[known], geometry.whitener, spectra[..., known]
    )
    return out


def _misfit(geometry: ProbeGeometry, mean: ComplexArray) -> tuple[float, int]:
    """Return sum of squares of the whitened rest of the mean, and its real degrees of freedom."""
    rest = _rest(geometry, mean)
    return float(np.sum(np.abs(rest) ** 2)), 2 * int(geometry.freedom.sum())


def _noise(
    method: MultiprobeRoundness,
    geometry: ProbeGeometry,
    array: FloatArray,
    each: ComplexArray,
    misfit: float,
    freedom: int,
    u_reading: float | None,
) -> _Noise:
    """Return the noise: stated, else scatter of revolutions, else disagreement of the probes."""
    n, n_turns, n_samples = array.shape
    gain = np.where(np.isinf(geometry.gain), np.nan, geometry.gain)
    white = gain * math.sqrt(2.0 / (n_samples * n_turns))
    if u_reading is not None:
        return _Noise(u_reading, None, "as stated (u_reading)", white * u_reading)
    if method.cov is not None:
        size = math.sqrt(float(np.trace(np.array(method.cov))) / n)
        return _Noise(size, None, "as stated (cov, root mean square)", white * size)
    if n_turns > 1:
        about = centred(array - array.mean(axis=1, keepdims=True))
        dof = n * (n_samples - 3) * (n_turns - 1)
        size = math.sqrt(float(np.sum(about**2)) / dof)
        scatter = _parts(geometry, each - each.mean(axis=1, keepdims=True))
        variance = np.sum(np.abs(scatter) ** 2, axis=1) / (2.0 * (n_turns - 1) * n_turns)
        source = f"type A from {n_turns} revolutions, asynchronous motion included"
        return _Noise(size, size / math.sqrt(2.0 * dof), source, np.sqrt(variance))
    if freedom > 0:
        size = math.sqrt(misfit / freedom * n_samples / 2.0)
        source = f"type A from what {n} probes disagree by, {freedom} degrees of freedom"
        return _Noise(size, size / math.sqrt(2.0 * freedom), source, white * size)
    source = (
        "the noise of a reading is not known (three probes, one revolution): give u_reading, cov, "
        "repeated revolutions or a fourth probe; no uncertainty is stated"
    )
    return _Noise(math.nan, None, source, white * math.nan)


def _type_b(
    method: MultiprobeRoundness,
    geometry: ProbeGeometry,
    mean: ComplexArray,
    found: ComplexArray,
    n_samples: int,
) -> dict[str, tuple[FloatArray, FloatArray]]:
    """Return variances of curves (3, N) and of harmonics (3, kmax + 1) for each named term.

    A wrong angle of probe i changes its reading by ``d_i`` per rad, a wrong sensitivity by the
    reading itself; the estimator's row of that probe carries it into the parts.
    """
    phi = np.array(method.angles)[:, np.newaxis]
    k = np.arange(method.kmax + 1)
    r, x, y = found
    turning = 1j * method.turn * k * np.exp(1j * method.turn * k * phi)
    d = turning * r - np.sin(phi) * x + np.cos(phi) * y
    out = {}
    for label, per_unit, u in (
        ("probe angles", d, method.u_angles),
        ("probe sensitivities", mean, method.u_sensitivity),
    ):
        if not any(u):
            continue
        moved = geometry.rows.transpose(0, 2, 1) * (per_unit * np.array(u)[:, np.newaxis])
        out[label] = (
            np.sum(curve(moved, n_samples) ** 2, axis=1),
            np.sum(np.abs(moved) ** 2, axis=1) / 2.0,
        )
    return out


def _chi2_ratio(
    geometry: ProbeGeometry,
    each: ComplexArray,
    noise: _Noise,
    misfit: float,
    freedom: int,
    n_samples: int,
) -> float | None:
    """Return what the probes disagree by, squared, over what the noise explains.

    Revolutions tell the noise of the disagreement itself: motion and drift of the level that
    differ from revolution to revolution do not hide it.
    """
    n_turns = each.shape[1]
    if freedom == 0 or math.isnan(noise.value):
        return None
    if noise.source.startswith("as stated") or n_turns == 1:
        explained = noise.value**2 * 2.0 / (n_samples * n_turns)
    else:
        scatter = _rest(geometry, each - each.mean(axis=1, keepdims=True))
        explained = float(np.sum(np.abs(scatter) ** 2)) / (freedom * (n_turns - 1) * n_turns)
    floor = (_ROUNDING * float(np.abs(each).max())) ** 2
    explained = max(explained, floor)
    return misfit / freedom / explained if explained > 0.0 else None


def _eccentricity(method: MultiprobeRoundness, mean: ComplexArray) -> dict[str, float | None]:
    """Return the run-out that turns with the part, and what only motion can have made, at k = 1."""
    phi = np.array(method.angles)
    basis = np.exp(1j * method.turn * np.outer(phi, [1.0, -1.0]))
    with_part, against = np.abs(np.linalg.lstsq(basis, mean[:, 1], rcond=None)[0])
    second = None if method.radius is None else float(with_part**2 / (4.0 * method.radius)) * 1e9
    return {
        "eccentricity_um": float(with_part) * 1e6,
        "motion_against_k1_um": float(against) * 1e6,
        "eccentric_circle_k2_nm": second,
    }


def _limacon_message(audit: dict[str, Any]) -> list[str]:
    second = audit["eccentric_circle_k2_nm"]
    if second is None or second < 0.1:
        return []
    text = (
        f"the eccentricity of {audit['eccentricity_um']:.3g} um by itself makes a second "
        f"undulation of {second:.3g} nm amplitude in artefact k = 2; centre better or allow for it"
    )
    return [text]


def _messages(
    method: MultiprobeRoundness,
    null_space: Any,
    noise: _Noise,
    n_turns: int,
    ratio: float | None,
    freedom: int,
) -> list[str]:
    out = []
    hidden = suppressed_harmonics(null_space)
    if hidden:
        out.append(
            f"k={names_of_k(hidden)} {'is' if len(hidden) == 1 else 'are'} suppressed by these "
            "probe angles: NaN in harmonics, absent from the curves"
        )
    if "revolutions" in noise.source and 1 < n_turns < _FEW_REVOLUTIONS:
        out.append(
            f"u of single harmonics comes from {n_turns} revolutions only "
            f"({2 * (n_turns - 1)} degrees of freedom each)"
        )
    spread = 2.0 / max(freedom, 1) * (1.0 + (1.0 / (n_turns - 1) if n_turns > 1 else 0.0))
    if ratio is not None and ratio > 1.0 + _DISAGREE * math.sqrt(spread):
        out.append(
            f"the probes disagree {math.sqrt(ratio):.3g} times more than their noise explains: "
            "an angle, a sensitivity or the turn is wrong; check_probes names the suspect"
        )
    return out
