"""Tool settings, follow-up errors, calibrations, predictions and dual servos in a result document."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import replace
from typing import Any

import numpy as np

from metrosep.core.quantity import Quantity
from metrosep.core.surface import Surface
from metrosep.core.units import format_length
from metrosep.recipe.describe.charts import bar_chart, curve, curve_chart, map_chart, panel
from metrosep.recipe.describe.describe_cutting import axis_motion_of
from metrosep.recipe.describe.description import Description, quantity

_PIXELS = 91


def setting_of(produced: Any, inputs: Any = None) -> Description:
    """Return what a document holds of a `SettingFit`."""
    found = {
        k: _as_angle(q) if k.startswith("tilt") else q for k, q in produced.quantities.items()
    }
    found["rms"] = quantity(
        produced.rms, "m", "RMS of the residual: what remains with the setting compensated"
    )
    maps: dict[str, Surface] = {}
    charts: tuple[dict[str, Any], ...] = ()
    left = produced.residual
    if isinstance(left, Surface):
        maps = {"residual": left}
        charts = (
            map_chart(
                "What the tool setting leaves",
                {"residual": left.z},
                dx=left.dx,
                dy=left.dy,
                unit="m",
                origin=left.origin,
                caption="Measured minus the part that a tool with this setting cuts.",
            ),
        )
    columns = {
        "freedom": list(found),
        "value_si": [q.value for q in found.values()],
        "u_si": [np.nan if q.u is None else q.u for q in found.values()],
        "unit": [q.unit for q in found.values()],
    }
    return Description(
        found,
        charts,
        {"": columns},
        maps,
        audit=dict(produced.audit),
        messages=_setting_correction(produced),
    )


def _as_angle(item: Quantity) -> Quantity:
    """Return a slope as the small angle that it is, so that it bears a unit."""
    return replace(item, unit="rad") if item.unit == "1" else item


def _setting_correction(produced: Any) -> tuple[str, ...]:
    """Return what to type into the machine for what was found."""
    moves = [
        f"{name} {_signed(-produced.values[name])}"
        for name in ("dx", "dy")
        if math.isfinite(produced.u.get(name, math.inf))
    ]
    words = []
    if moves:
        text = (
            f"correction: {', '.join(moves)} (move the tool by this, the negative of the error; "
        )
        text += "dx away from the spindle axis"
        if "dy" in produced.values:
            text += (
                ", dy towards growing azimuth of the workpiece: where the spindle counts its angle "
                "the other way, turn the sign of dy"
            )
        words.append(text + ")")
    if math.isfinite(produced.u.get("dR", math.inf)):
        words.append(
            f"correction: enter a nose radius that is {_signed(produced.values['dR'])} larger"
        )
    return tuple(words)


def _signed(value: float) -> str:
    """Return a length with its sign, five digits."""
    return f"{'-' if value < 0.0 else '+'}{format_length(abs(value), digits=5)}"


def follow_up_of(produced: Any, inputs: Any = None) -> Description:
    """Return what a document holds of a `FollowUp`."""
    found: dict[str, Quantity] = {
        **produced.quantities,
        **produced.coefficients,
        "r2": quantity(produced.r2, "1", "share of the variance that the motion explains"),
        "delay": replace(
            produced.delay,
            definition="lag of actual behind the command, from the shift that fits best; cv is the "
            "same lag from the regression, with the other sign",
        ),
    }
    if "cv" in found:
        found["cv"] = replace(
            found["cv"],
            definition=f"{found['cv'].definition}: minus the lag, beside the other terms",
        )
    if "noise" in found:
        found["noise_of_command"] = replace(
            found.pop("noise"),
            definition="noise of the commanded position, not of the sensor",
            symbol="noise of the command",
        )
    for name, share in produced.shares.items():
        found[f"{name}.pv"] = replace(share.pv, symbol=f"PV {name}")
        found[f"{name}.share"] = quantity(
            share.share, "1", f"share of the variance of the error that goes with {name}"
        )
    t = produced.t
    explained = produced.error - produced.residual
    charts = (
        curve_chart(
            "Follow-up error",
            ("time", "s"),
            [
                panel(
                    "actual − command",
                    "m",
                    [
                        curve("error", t, produced.error),
                        curve("explained by the motion", t, explained),
                    ],
                ),
                panel("residual", "m", [curve("", t, produced.residual)]),
            ],
            caption="Positive out of the material.",
        ),
        bar_chart(
            "P-V of what each term explains",
            list(produced.shares),
            {"": [s.pv.value for s in produced.shares.values()]},
            unit="m",
            quantity="P-V",
        ),
    )
    columns: dict[str, Any] = {
        "t_s": t,
        "error_m": produced.error,
        "velocity_m_per_s": produced.velocity,
        "acceleration_m_per_s2": produced.acceleration,
        "residual_m": produced.residual,
    }
    tables: dict[str, Any] = {"": columns}
    if produced.map is not None:
        tables["map"] = {
            "rho_m": produced.map.rho,
            "azimuth_rad": produced.map.theta,
            "error_m": produced.map.z,
        }
    return Description(found, charts, tables, audit=dict(produced.audit))


def calibration_of(produced: Any, inputs: Any = None) -> Description:
    """Return what a document holds of a `FlexureCalibration`."""
    return Description(
        dict(produced.quantities),
        _calibration_charts(produced),
        {
            "": {
                "voltage_V": produced.voltage,
                "up_m": produced.up,
                "down_m": produced.down,
                "mean_m": produced.mean,
                "scatter_m": produced.scatter,
            }
        },
        audit=dict(produced.audit),
    )


def _calibration_charts(produced: Any) -> tuple[dict[str, Any], ...]:
    v = produced.voltage
    line = produced.intercept + produced.sensitivity * v
    up, down = (
        curve(name, v, values - line)
        for name, values in (("voltage rising", produced.up), ("voltage falling", produced.down))
    )
    return (
        curve_chart(
            "Calibration of the stage",
            ("voltage / V", "1"),
            [
                panel("displacement", "m", [curve("mean of both directions", v, produced.mean)]),
                panel("deviation from the line", "m", [up, down]),
            ],
        ),
    )


def prediction_of(produced: Any, inputs: Any = None) -> Description:
    """Return what a document holds of a predicted job."""
    from metrosep.process.predictions import pv_quantities

    prediction = produced.prediction
    budget = prediction.budget
    found = pv_quantities(budget)
    audit = dict(prediction.audit)
    if produced.measured is not None:
        found["measured"] = quantity(produced.measured, "m", "P-V of the part as cut, as stated")
    found["time"] = quantity(60.0 * audit["minutes"], "s", "time of one pass")
    found["n_blocks"] = quantity(audit["n_blocks"], "1", "blocks of the program")
    found |= _allowed(produced.allowed)
    audit |= _files(produced.beside)
    tables: dict[str, Any] = {}
    frame = budget.to_frame(measured=produced.measured)
    tables["budget"] = {str(k): frame[k].tolist() for k in frame.columns}
    charts = [_budget_bars(produced, found), *_cause_maps(produced, found)]
    if produced.program is not None:
        frame = produced.program.to_frame()
        tables["program"] = {str(k): frame[k].tolist() for k in frame.columns}
        for name, left in produced.program.residual_pv.items():
            found[f"residual.{name}"] = quantity(
                left, "m", f"P-V that one standard uncertainty of the setting leaves ({name})"
            )
    checks: tuple[Mapping[str, Any], ...] = ()
    said: tuple[str, ...] = ()
    if produced.motion is not None:
        motion = axis_motion_of(produced.motion)
        found |= motion.quantities
        tables["axes"], checks, said = motion.tables[""], motion.checks, motion.messages
    return Description(
        found,
        tuple(charts),
        tables,
        audit=audit,
        checks=checks,
        messages=said,
    )


def _files(steps: Any) -> dict[str, str]:
    """Return the files that a step named itself, with their SHA-256."""
    read = [s.parameters for s in steps if s.name == "read"]
    return {
        f"file {p['file']}": f"SHA-256 {p['sha256']}"
        for p in read
        if "file" in p and "sha256" in p
    }


def _allowed(tolerance: Any) -> dict[str, Quantity]:
    """Return the largest errors of the setting, each alone, that cost no more than the program."""
    if tolerance is None:
        return {}
    words = f"largest error alone that gives {1e9 * tolerance.wanted:g} nm P-V over the part"
    return {
        f"allowed.{name}": quantity(value, "m", f"{name}: {words}")
        for name, value in tolerance.alone.items()
        if math.isfinite(value)
    }


def _budget_bars(produced: Any, found: dict[str, Quantity]) -> dict[str, Any]:
    budget = produced.prediction.budget
    names = [c.name for c in budget.contributions]
    ways = list(budget.totals())
    labels = [*names, *ways, *(["measured"] if produced.measured is not None else [])]
    keys = [*(f"{n}.pv" for n in names), *labels[len(names) :]]
    u = [found[k].u for k in keys]
    return bar_chart(
        "Error budget: causes, then totals",
        labels,
        {"": [found[k].value for k in keys]},
        unit="m",
        quantity="P-V",
        u={"": [np.nan if v is None else v for v in u]},
        caption="Bars ± 2 u where it is known. The pointwise sum of the maps is the true total.",
    )


def _cause_maps(produced: Any, found: dict[str, Quantity]) -> list[dict[str, Any]]:
    """Return the maps of the causes as pixels: the sample nearest to each."""
    from scipy.spatial import cKDTree

    prediction = produced.prediction
    maps = prediction.maps
    if not maps:
        return []
    reach = float(np.nanmax(prediction.rho))
    axis = np.linspace(-reach, reach, _PIXELS)
    x, y = np.meshgrid(axis, axis)
    places = np.column_stack([prediction.x, prediction.y])
    thin = slice(None, None, max(1, places.shape[0] // 200_000))
    # beyond the bound no sample is looked for: of a ring the pixels in its middle took the longest
    near = cKDTree(places[thin]).query(
        np.column_stack([x.ravel(), y.ravel()]), distance_upper_bound=3.0 * reach / _PIXELS
    )
    nearest = np.asarray(near[1]).reshape(x.shape)
    seen = (np.hypot(x, y) <= reach) & np.isfinite(np.asarray(near[0]).reshape(x.shape))
    shown = {}
    for name, z in {**maps, "sum": prediction.total}.items():
        shown[name] = np.full(x.shape, np.nan)
        shown[name][seen] = z[thin][nearest[seen]]
    step = float(axis[1] - axis[0])
    whole = {name: found[f"{name}.pv"].value for name in maps if f"{name}.pv" in found}
    if "pointwise" in found:
        whole["sum"] = found["pointwise"].value
    return [
        map_chart(
            "Form error by cause, and their sum",
            shown,
            dx=step,
            dy=step,
            unit="m",
            origin=(float(axis[0]), float(axis[0])),
            caption="Error = actual − nominal, out of the material; the sample nearest to each pixel. "
            "P-V is that of all samples.",
            pv=whole,
        )
    ]


def dual_servo_of(produced: Any, inputs: Any = None) -> Description:
    """Return what a document holds of a dual servo."""
    polynomial, lines, table = produced.polynomial, produced.lines, produced.table
    found: dict[str, Quantity] = {"total": lines.total}
    for name in lines.straightness:
        found[f"straightness.{name}"] = lines.straightness[name]
        found[f"slope.{name}"] = _as_angle(lines.slope[name])
    units = [
        "m" if k == 0 else "m/m" if k == 1 else f"m^{1 - k}" for k in range(polynomial.degree + 1)
    ]
    for k, unit in enumerate(units):
        found[f"c{k}"] = quantity(
            polynomial.coefficients[k],
            unit,
            f"coefficient of x^{k} of the {polynomial.quantity}, x in m; u between runs",
            u=polynomial.u[k],
        )
    found["repeatability"] = quantity(
        polynomial.repeatability, "m", "standard deviation between runs, drift lines removed"
    )
    found["voltage_min"] = quantity(
        float(table.voltage.min()), "V", "smallest voltage of the table"
    )
    found["voltage_max"] = quantity(
        float(table.voltage.max()), "V", "largest voltage of the table"
    )
    found["violations"] = quantity(
        len(table.violations), "1", "limits that the table does not keep"
    )
    if hasattr(produced.calibration, "quantities"):
        found |= {
            f"stage.{k}": replace(q, symbol=f"stage {k}")
            for k, q in produced.calibration.quantities.items()
        }
    found |= _gains(produced)
    text = horner(polynomial)
    tables = {
        "": {
            "x_m": table.x,
            "displacement_m": table.displacement,
            "voltage_V": table.voltage,
        },
        "polynomial": _coefficients(polynomial),
    }
    charts = _dual_charts(produced)
    audit = {
        **_files(produced.beside),
        **dict(polynomial.audit),
        **dict(lines.audit),
        **dict(table.audit),
        "polynomial": text,
    }
    return Description(found, charts, tables, document={"polynomial_text": text}, audit=audit)


def _coefficients(polynomial: Any) -> dict[str, Any]:
    """Return the compensation of the stage as coefficients for x in mm, result in um."""
    sign = -1.0 if polynomial.quantity == "error" else 1.0
    power = np.arange(polynomial.degree + 1)
    scale = 1e6 * 1e-3**power
    return {
        "power": power.tolist(),
        "compensation_um_per_mm_power": sign * scale * polynomial.coefficients,
        "u": scale * polynomial.u,
    }


def horner(polynomial: Any) -> str:
    """Return what the stage must do as a formula for a controller: x in mm, result in um."""
    sign = -1.0 if polynomial.quantity == "error" else 1.0
    scaled = [sign * float(c) * 1e6 * 1e-3**k for k, c in enumerate(polynomial.coefficients)]
    text = f"{scaled[-1]:.9g}"
    for value in reversed(scaled[:-1]):
        text = f"{value:.9g} + x*({text})"
    low, high = (1e3 * v for v in polynomial.domain)
    return (
        f"compensation_um = {text}   with x in mm, {low:.6g} <= x <= {high:.6g}; hold the end values "
        "outside"
    )


def _gains(produced: Any) -> dict[str, Quantity]:
    found: dict[str, Quantity] = {}
    if produced.static is not None:
        found["at_rest.ratio"] = produced.static.ratio
        found["at_rest.ratio_db"] = produced.static.ratio_db
        for name in ("before", "after"):
            for key, item in getattr(produced.static, name).items():
                found[f"at_rest.{name}.{key}"] = replace(item, symbol=f"{key} at rest, {name}")
    if produced.parts is not None:
        for name in ("before", "after"):
            for key, item in getattr(produced.parts, name).items():
                found[f"{name}.{key}"] = replace(item, symbol=f"{key} {name}")
        for key, ratio in produced.parts.ratio.items():
            found[f"ratio.{key}"] = quantity(ratio, "1", f"{key} before over {key} after")
    return found


def _voltage_curves(table: Any) -> list[dict[str, Any]]:
    """Return the voltages, and the limits where the table comes near or breaks them."""
    ends = [float(table.x[0]), float(table.x[-1])]
    curves = [curve("voltage", table.x, table.voltage)]
    for word, limit in zip(("lower", "upper"), table.audit["limits_V"], strict=True):
        curves.append(curve(f"limit, {word}: {limit:g} V", ends, [limit, limit]))
    return curves


def _dual_charts(produced: Any) -> tuple[dict[str, Any], ...]:
    polynomial, table = produced.polynomial, produced.table
    low, high = polynomial.domain
    x = np.linspace(low, high, 401)
    runs = [curve(f"run {k + 1}", r.x, r.z) for k, r in enumerate(produced.runs[:6])]
    rest = [
        curve(f"run {k + 1}", r.x[inside], r.z[inside] - polynomial.evaluate(r.x[inside]))
        for k, r in enumerate(produced.runs[:6])
        for inside in [(r.x >= low) & (r.x <= high)]
    ]
    charts = [
        curve_chart(
            f"Straightness runs ({polynomial.quantity}) and their polynomial",
            ("position", "m"),
            [
                panel(
                    "runs and polynomial ± 2 u",
                    "m",
                    [*runs, curve("polynomial", x, polynomial.evaluate(x), u=polynomial.sd(x))],
                ),
                panel("runs minus polynomial", "m", rest),
            ],
        ),
        curve_chart(
            "Drive table",
            ("position", "m"),
            [
                panel("voltage", "V", _voltage_curves(table)),
                panel("displacement of the stage", "m", [curve("", table.x, table.displacement)]),
            ],
        ),
    ]
    if hasattr(produced.calibration, "quantities"):
        charts += _calibration_charts(produced.calibration)
    if produced.static is not None:
        s = produced.static
        charts.append(
            curve_chart(
                "Following error at rest",
                ("time", "s"),
                [
                    panel("without the stage", "m", [curve("", s.t_before, s.error_before)]),
                    panel("with the stage", "m", [curve("", s.t_after, s.error_after)]),
                ],
            )
        )
    if produced.parts is not None:
        names = ("before compensation", "after compensation")
        charts.append(
            curve_chart(
                "The part before and after",
                ("position", "m"),
                [
                    panel(name, "m", [curve("", p.x, p.z)])
                    for name, p in zip(names, produced.parts.profiles, strict=True)
                ],
            )
        )
    return tuple(charts)
