"""Private helpers of `iso230_7`: the table of values with uncertainties, and the warnings."""

from __future__ import annotations

import math

import numpy as np

from metrosep.core._arrays import FloatArray
from metrosep.core.provenance import Step
from metrosep.core.quantity import Quantity
from metrosep.core.units import format_engineering
from metrosep.parameters.table import Context, ParameterTable
from metrosep.separation._spindle_noise import (
    NoiseEffect,
    Spectrum,
    u_of_range,
    u_of_sd,
    u_of_total,
)
from metrosep.separation._spindle_steps import Circles, Trend

__all__ = ["motion_messages", "motion_table"]


_EDITION = "ISO 230-7:2015"
_CENTRES = {
    "LSC": "least-squares centre",
    "MZC": "minimum-zone centre",
    "MIC": "centre of the maximum inscribed circle",
    "MCC": "centre of the minimum circumscribed circle",
    "PC": "mean level",
}
_USUAL_REVOLUTIONS = 20
_BIAS = 0.01
"""Share of the synchronous value from which noise in it is told."""

_CORRELATED = 0.3
_ROUNDING = 1e-9
"""Scatter over total motion below which it is rounding, no finding."""

_ROUNDING_READ = 1e-3
"""The same for offset and eccentricity of the readings, which were removed: 1e-12 of them."""

_FAR = 1e-3
"""Motion in m beyond which the unit is doubted."""


def motion_table(
    *,
    direction: str,
    center: str,
    motion: FloatArray,
    curve: FloatArray,
    spread: FloatArray,
    sd: FloatArray,
    spectrum: Spectrum,
    effect: NoiseEffect,
    circles: Circles | None,
    kmax: int | None,
    history: tuple[Step, ...],
) -> ParameterTable:
    """Return all values with unit, definition and standard uncertainty."""
    unit = "rad" if direction == "tilt" else "m"
    m, n = motion.shape
    name = f"{direction} error motion"
    about = f"about the {_CENTRES[center]}"
    band = "" if kmax is None else f", harmonics up to {kmax}"
    value = float(curve.max() - curve.min())
    pooled = math.sqrt(float((sd * sd).mean()))
    u_pooled = u_of_sd(spectrum)
    largest = float(spread.max())
    rows = [
        (
            "synchronous",
            value,
            effect.sd,
            f"synchronous {name}: peak-to-valley width of the mean of {m} turns {about}{band}",
        ),
        (
            "asynchronous",
            largest,
            u_of_range(largest, pooled),
            f"asynchronous {name}: largest range of {m} revolutions at one angle",
        ),
        (
            "total",
            float(motion.max() - motion.min()),
            u_of_total(motion, spectrum),
            f"total {name}: width of all readings of {m} revolutions {about}",
        ),
        (
            "asynchronous_sd",
            pooled,
            u_pooled,
            "standard deviation over revolutions (ddof 1), root mean square over the angles",
        ),
        (
            "asynchronous_4s",
            4.0 * pooled,
            4.0 * u_pooled,
            "4 standard deviations over revolutions; does not grow with their number",
        ),
        (
            "synchronous_corrected",
            max(value - effect.bias, 0.0),
            effect.sd,
            "synchronous value less the mean effect of noise on it",
        ),
        (
            "noise_floor",
            effect.floor,
            None,
            f"synchronous value that the scatter alone gives with {m} revolutions",
        ),
        *_once_rows(direction, curve, spectrum, effect, circles),
    ]
    return ParameterTable(
        [Quantity(v, unit, text, u=u, symbol=s) for s, v, u, text in rows],
        Context(
            edition=_EDITION,
            n_valid=m * n,
            n_total=m * n,
            history=history,
            settings={"direction": direction, "center": center, "revolutions": m, "kmax": kmax},
            notes=("u holds the scatter between revolutions, not the form of the artefact",),
        ),
    )


def _once_rows(
    direction: str,
    curve: FloatArray,
    spectrum: Spectrum,
    effect: NoiseEffect,
    circles: Circles | None,
) -> list[tuple[str, float, float | None, str]]:
    """Return what becomes of k = 1."""
    once = float(np.abs(spectrum.mean[1]))
    u = math.sqrt(0.5 * float(spectrum.power[1]) / spectrum.n_revolutions)
    if circles is not None:
        once, u = circles.size[1], circles.u[1]
    if direction in ("radial", "tilt"):
        what = "eccentricity" if direction == "radial" else "inclination"
        how = "removed" if circles is None else "constant in a rotating sensitive direction"
        symbol = "eccentricity" if direction == "radial" else "artefact_tilt"
        return [(symbol, once, u, f"amplitude of k=1, {what} of the artefact: {how}")]
    lines = np.fft.rfft(curve)
    lines[1] = 0.0
    rest = np.fft.irfft(lines, curve.size)
    return [
        ("fundamental", 2.0 * once, 2.0 * u, f"fundamental {direction} motion: twice k=1, kept"),
        (
            "residual_synchronous",
            float(rest.max() - rest.min()),
            effect.sd,
            f"residual synchronous {direction} motion: peak to valley without k=1",
        ),
    ]


def motion_messages(
    *,
    direction: str,
    table: ParameterTable,
    spectrum: Spectrum,
    effect: NoiseEffect,
    correlation: float,
    trend: Trend | None,
    circles: Circles | None,
    kmax: int | None,
    artefact_radius: float | None,
    noise_gain: float,
) -> list[str]:
    """Return the warnings, one sentence each."""
    m = spectrum.n_revolutions
    value = table["synchronous"].value
    unit = table["synchronous"].unit
    said = [f"asynchronous is the largest range of {m} revolutions and grows with their number"]
    if m < _USUAL_REVOLUTIONS:
        said.append(
            f"{m} revolutions: ISO 230-7 asks for {_USUAL_REVOLUTIONS} or more, and the "
            "asynchronous value is too small for comparison"
        )
    if unit == "m" and value > _FAR:
        said.append(
            f"the synchronous motion is {value:.3g} m: signals must be in metres (1e-6 times "
            "micrometres)"
        )
    said += _noise_messages(value, unit, effect, spectrum, kmax)
    rounding = _is_rounding(table, spectrum)
    if m >= 5 and correlation > _CORRELATED and not rounding:
        said.append(
            f"successive revolutions deviate alike (correlation {correlation:.2f}): a slow motion "
            "or a drift; the uncertainties, made for independent revolutions, are too small"
        )
    if not rounding:
        said += _drift_messages(trend, table, m)
    said += _circle_messages(direction, table, circles, artefact_radius)
    if direction == "face":
        said.append(
            "k=1 of face motion holds the squareness of the plate: quote residual_synchronous, or "
            "separate them by face_reversal"
        )
    if math.isnan(noise_gain):
        said.append("cubic interpolation lowers broadband scatter: asynchronous values are low")
    return said


def _is_rounding(table: ParameterTable, spectrum: Spectrum) -> bool:
    """Whether the revolutions differ by no more than the rounding of their numbers."""
    scale = max(table["total"].value, _ROUNDING_READ * float(np.abs(spectrum.mean).max()))
    return table["asynchronous"].value <= _ROUNDING * scale


def _noise_messages(
    value: float, unit: str, effect: NoiseEffect, spectrum: Spectrum, kmax: int | None
) -> list[str]:
    said = []
    if not spectrum.significant.any():
        said.append(
            "no harmonic repeats: the synchronous value is noise, about "
            f"{format_engineering(effect.floor, unit)} for this scatter"
        )
    elif effect.bias > _BIAS * value:
        said.append(
            f"noise adds about {format_engineering(effect.bias, unit)} to the synchronous value: "
            "synchronous_corrected is without it; kmax= or more revolutions lower it"
        )
    if kmax is not None:
        beyond = np.flatnonzero(spectrum.significant[kmax + 1 :]) + kmax + 1
        strong = [int(k) for k in beyond if abs(spectrum.mean[k]) > _BIAS * value]
        if strong:
            named = ", ".join(str(k) for k in strong[:8])
            said.append(f"harmonics that repeat are left out by kmax={kmax}: k={named}")
    return said


def _drift_messages(trend: Trend | None, table: ParameterTable, m: int) -> list[str]:
    if trend is None or math.isnan(trend.u):
        return []
    rise = abs(trend.slope) * (m - 1)
    if abs(trend.slope) < 4.0 * trend.u or rise < 0.1 * table["asynchronous"].value:
        return []
    unit = table["total"].unit
    text = (
        f"the readings drift by {format_engineering(rise, unit)} over the record: it is in the "
        "asynchronous and total values; drift='linear' removes a straight line"
    )
    return [text]


def _circle_messages(
    direction: str, table: ParameterTable, circles: Circles | None, artefact_radius: float | None
) -> list[str]:
    said = []
    value = table["synchronous"].value
    if artefact_radius is not None and direction == "radial":
        size = table["eccentricity"].value
        false = size**2 / (4.0 * artefact_radius)
        if false > _BIAS * value:
            said.append(
                f"an eccentricity of {format_engineering(size, 'm')} on this radius gives a false "
                f"k=2 of {format_engineering(false, 'm')}: centre the artefact better"
            )
    if circles is not None and circles.size[2] > max(5.0 * circles.u[2], _BIAS * value):
        said.append(
            "the axis also circles forward twice per revolution by "
            f"{format_engineering(circles.size[2], table['total'].unit)}: in a rotating sensitive "
            "direction that is k=1 and is removed with the zeros of the sensors"
        )
    return said
