"""What a result document holds of any result: quantities, tables, maps and charts.

One function for every kind of result of the toolbox. The kinds are told apart by their class name,
so that no module of the toolbox is loaded before it is used.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any

import numpy as np

from metrosep.core.errors import DataError
from metrosep.core.quantity import Quantity
from metrosep.recipe.describe.charts import bar_chart, curve, curve_chart, map_chart, panel, plain
from metrosep.recipe.describe.describe_cutting import (
    axis_motion_of,
    cut_budget_of,
    hysteresis_of,
)
from metrosep.recipe.describe.describe_machine import (
    identification_of,
    sensitivity_of,
    wavefront_of,
)
from metrosep.recipe.describe.describe_process import (
    calibration_of,
    dual_servo_of,
    follow_up_of,
    prediction_of,
    setting_of,
)
from metrosep.recipe.describe.describe_tests import (
    diagonals_of,
    laser_of,
    positions_of,
    separation_of,
    spindle_of,
    straightness_of,
    turned_of,
    zero_of,
)
from metrosep.recipe.describe.description import Description, extremes, named, quantity
from metrosep.recipe.methods.ops_geometry import geometry_of
from metrosep.recipe.methods.plan import feed_plan_of

# ---- gauge studies and series of parts in a result document ------------------------------------

_PARTS = ("repeatability", "reproducibility", "interaction", "gauge", "parts", "total")


def gauge_of(produced: Any, inputs: Any = None) -> Description:
    """Return what a document holds of a `GaugeStudy`."""
    found = {name: getattr(produced, name) for name in _PARTS}
    shares = produced.shares()
    for name, share in shares.items():
        found[f"{name}.share"] = quantity(
            share, "1", f"{name} over the total standard deviation", symbol=f"{name} share"
        )
    found["distinct_categories"] = quantity(
        produced.distinct_categories,
        "1",
        "groups of parts that the gauge tells apart, whole part of sqrt(2) parts / gauge",
        symbol="ndc",
    )
    if produced.tolerance is not None:
        found["share_of_tolerance"] = quantity(
            produced.share_of_tolerance,
            "1",
            "six standard deviations of the gauge over the width of the tolerance",
            symbol="6 GRR / T",
        )
    known = ["repeatability", "reproducibility", "gauge", "parts", "total"]
    chart = bar_chart(
        "Gauge study",
        known,
        {"standard deviation": [getattr(produced, n).value for n in known]},
        u={"standard deviation": [getattr(produced, n).u or 0.0 for n in known]},
        unit=produced.total.unit,
        quantity="standard deviation",
        caption="Gauge: repeatability and reproducibility together. Squares add up, lengths do not. "
        "Whiskers: one standard uncertainty.",
    )
    rows = produced.to_dict()["rows"]
    unit = produced.total.unit
    columns = {
        "source": [r["source"] for r in rows],
        f"sum_of_squares_{unit}2": [r["squares"] for r in rows],
        "dof": [r["dof"] for r in rows],
        f"mean_square_{unit}2": [r["mean_square"] for r in rows],
        "f": [r["f"] for r in rows],
        "p": [r["p"] for r in rows],
    }
    audit = {
        "n_parts": produced.n_parts,
        "n_conditions": produced.n_conditions,
        "n_trials": produced.n_trials,
        "pooled": produced.pooled,
        "coverage": produced.coverage,
    }
    document = {
        "anova": {k: v if k == "source" else plain(v, digits=12) for k, v in columns.items()},
        f"interval_{unit}": {k: list(v) for k, v in produced.interval.items()},
    }
    return Description(found, (chart,), {"anova": columns}, document=document, audit=audit)


def series_of(produced: Any, inputs: Any = None) -> Description:
    """Return what a document holds of a `PartSeries`."""
    found = {
        f"drift.{t.name}": quantity(
            t.drift,
            t.unit,
            f"drift of {t.name} from the first to the last part"
            + (", beyond chance" if t.drifts else ", not beyond chance")
            + (": the same in all parts to within rounding" if t.constant else ""),
            u=t.u_drift,
            symbol=f"drift {t.name}",
        )
        for t in produced.terms
    }
    found["drifting"] = quantity(
        len(produced.drifting), "1", "terms whose drift is beyond chance", symbol="drifting terms"
    )
    found["correlated"] = quantity(
        len(produced.correlated), "1", "pairs of terms beyond chance", symbol="correlated pairs"
    )
    terms = produced.terms
    columns: dict[str, Any] = {
        "term": [t.name for t in terms],
        "unit": [t.unit for t in terms],
        "mean": [t.mean for t in terms],
        "lower_control_limit": [t.lower for t in terms],
        "upper_control_limit": [t.upper for t in terms],
        "drift": [t.drift for t in terms],
        "u_drift": [t.u_drift for t in terms],
        "p": [t.p for t in terms],
        "drifts": [t.drifts for t in terms],
        "n_beyond": [len(t.beyond) for t in terms],
    }
    chart = {
        "kind": "part_series",
        "title": "Series of parts",
        "caption": "Drift of each term in its standard uncertainties, values of the surest with "
        "control limits, and the correlation of the terms without their drifts.",
        **produced.to_dict(),
    }
    return Description(
        found,
        (chart,),
        {"": columns},
        document={
            "correlated": [list(c) for c in produced.correlated],
            "same": [list(s) for s in produced.same],
        },
        audit={"n_parts": produced.n_parts, "false_discovery_rate": produced.rate},
    )


# ------------------------------------------------------------------------------------------------

# ---- maps of planes in a result document: quantities, files and charts -------------------------


def plane_map_of(produced: Any, inputs: Any = None) -> Description:
    """Return what a document holds of a `PlaneMap`."""
    surface, u = produced.surface, produced.u
    found = extremes("plane", surface.z, u.z, "m")
    if produced.pv is not None:
        found["plane.pv"] = produced.pv
    found |= {"alpha": produced.alpha, "beta": produced.beta}
    charts = [_chart("Error of the plane", {"error": surface.z}, surface)]
    if np.isfinite(u.z).any():
        charts.append(_chart("Standard uncertainty of the plane", {"u": u.z}, surface))
    return Description(found, tuple(charts), maps={"error": surface, "u": u}, audit=produced.audit)


def _chart(title: str, maps: dict[str, Any], like: Any) -> dict[str, Any]:
    words = "Error = actual − nominal; the correction is its negative. Rows grow with y."
    return map_chart(
        title, maps, dx=like.dx, dy=like.dy, unit="m", caption=words, origin=like.origin
    )


def surfaces_of(produced: Any, inputs: Any = None) -> Description:
    """Return what a document holds of a `PlaneFit`."""
    found: dict[str, Quantity] = {}
    panels, tables = [], {}
    for name in ("x", "y"):
        line, u = getattr(produced, f"along_{name}"), getattr(produced, f"u_{name}")
        found |= extremes(f"along_{name}", line.z, u.z, "m")
        panels.append(panel(f"error along {name} ± 2 u", "m", [curve("", line.x, line.z, u=u.z)]))
        key = "" if name == "x" else name
        tables[key] = {f"{name}_m": line.x, "error_m": line.z, "u_error_m": u.z}
    test = produced.interaction
    found |= {"alpha": produced.alpha, "beta": produced.beta}
    found["coupling"] = quantity(test.rms, "m", "RMS of what is neither f(x) nor g(y), noise off")
    found["coupling_p"] = quantity(test.p, "1", "probability of more coupling from noise alone")
    maps = {"model": produced.model, "residual": produced.residual}
    charts = (
        curve_chart("Errors of the two axes", ("position", "m"), panels),
        _chart("Sum model and what it leaves", {k: m.z for k, m in maps.items()}, produced.model),
    )
    return Description(found, charts, tables, maps, audit=produced.audit)


def registration_of(produced: Any, inputs: Any = None) -> Description:
    """Return what a document holds of a `Registration`."""
    u = np.sqrt(np.maximum(np.diag(produced.cov), 0.0))
    words = "of the second map against the first, about the centre"
    found = {
        "shift_x": quantity(produced.shift_x, "m", f"shift along x {words}", u=u[0]),
        "shift_y": quantity(produced.shift_y, "m", f"shift along y {words}", u=u[1]),
        "angle": quantity(produced.angle, "rad", f"turn {words}, counter-clockwise", u=u[2]),
        "rms": quantity(produced.rms, "m", "RMS of what is left of the difference"),
    }
    return Description(found, audit=produced.audit)


# ------------------------------------------------------------------------------------------------

# ---- drift, differences and dependences in a result document: quantities, tables, charts -------


def drift_test_of(produced: Any, inputs: Any = None) -> Description:
    """Return what a document holds of a `DriftTest`."""
    several = len(produced.windows) > 1
    found: dict[str, Quantity] = {}
    for i in range(len(produced.windows)):
        tail = f".{i + 1}" if several else ""
        for name, ranges in produced.ranges.items():
            found[f"{name}.range{tail}"] = ranges[i]
        found[f"combined{tail}"] = produced.combined[i]
    found |= {f"{name}.worst": q for name, q in produced.worst.items()}
    found = named(found)
    frame = produced.to_frame()
    chart = curve_chart(
        "Drift over time",
        ("time", "s"),
        [
            panel(name, found_unit, [curve("", produced.t, values - _first(values))])
            for name, values in produced.channels.items()
            for found_unit in (produced.ranges[name][0].unit,)
        ],
        caption="Each channel from its first reading. Filter: none.",
    )
    columns = {str(name): frame[name].to_numpy() for name in frame.columns}
    return Description(found, (chart,), {"": columns}, audit=produced.audit)


def _first(values: Any) -> float:
    known = values[np.isfinite(values)]
    return float(known[0]) if known.size else 0.0


def difference_of(produced: Any, inputs: Any = None) -> Description:
    """Return what a document holds of a `DriftFreeDifference`."""
    value, u = np.asarray(produced.difference), np.asarray(produced.u)
    text = "A minus B, free of offset and linear drift; mean over the sequences"
    if value.ndim == 0:
        found = {
            "difference": quantity(value, "m", text, u=u, symbol="A − B"),
            "drift_rate": _rate(produced),
        }
        each = np.atleast_1d(produced.each)
        number = np.arange(1.0, each.size + 1.0)
        rows = [curve("", number, each, points=True)]
        chart = curve_chart(
            "A minus B", ("sequence", "1"), [panel("A − B of each sequence", "m", rows)]
        )
        return Description(
            found, (chart,), {"": {"sequence": number, "difference_m": each}}, audit=produced.audit
        )
    x, name, unit = _abscissa(inputs, value.shape[-1])
    found = extremes("difference", value, u, "m")
    chart = curve_chart(
        "A minus B", (name, unit), [panel("A − B, ± 2 u", "m", [curve("", x, value, u=u)])]
    )
    suffix = "" if unit == "1" else f"_{unit}"
    columns = {f"{name}{suffix}": x, "difference_m": value, "u_difference_m": u}
    return Description(found, (chart,), {"": columns}, audit=produced.audit)


def _rate(produced: Any) -> Quantity:
    """Return the drift per second, or per step where no times were given."""
    timed = produced.audit.get("times") == "given"
    text = "linear drift within the sequences, mean over them"
    return quantity(produced.drift_rate, "m/s" if timed else "m/step", text)


def _abscissa(inputs: Any, n: int) -> tuple[Any, str, str]:
    """Return positions of curves with name and unit; sample numbers where none are known."""
    position = getattr(inputs, "position", None)
    if position is None or position.size != n:
        return np.arange(float(n)), "sample", "1"
    unit = getattr(inputs, "position_unit", "m")
    return position, "angle" if unit == "rad" else "position", unit


def joint_drift_of(produced: Any, inputs: Any = None) -> Description:
    """Return what a document holds of a `JointDrift`."""
    found: dict[str, Quantity] = {}
    labels = produced.labels
    pairs = {(b, labels[0]): produced.difference(b, labels[0]) for b in labels[1:]}
    single = produced.values.ndim == 1
    for i, label in enumerate(labels):
        value, u = produced.values[i], produced.u[i]
        text = f"{label} as it would have been read at the reference time"
        found |= (
            {str(label): quantity(value, "m", text, u=u, symbol=str(label))}
            if single
            else extremes(str(label), value, u, "m")
        )
    for (b, a), (value, u) in pairs.items():
        name = f"{b}-{a}"
        text = f"{b} minus {a}, free of drift"
        found |= (
            {name: quantity(value, "m", text, u=u, symbol=f"{b} − {a}")}
            if single
            else extremes(name, value, np.broadcast_to(u, value.shape), "m")
        )
    if single:
        rows = [curve("", produced.t, produced.drift, u=produced.u_drift)]
        chart = curve_chart(
            "Drift between the readings",
            ("time", "s"),
            [
                panel("drift ± 2 u, zero at the reference time", "m", rows),
                panel(
                    "readings minus fit",
                    "m",
                    [curve("", produced.t, produced.residual, points=True)],
                ),
            ],
        )
        columns = {
            "t_s": produced.t,
            "drift_m": produced.drift,
            "u_drift_m": produced.u_drift,
            "residual_m": produced.residual,
        }
    else:
        chart, columns = _drift_curves(produced, inputs)
    return Description(found, (chart,), {"": columns}, audit=produced.audit)


def _drift_curves(produced: Any, inputs: Any) -> tuple[dict[str, Any], dict[str, Any]]:
    x, name, unit = _abscissa(inputs, produced.values.shape[-1])
    suffix = "" if unit == "1" else f"_{unit}"
    columns: dict[str, Any] = {f"{name}{suffix}": x}
    panels = []
    for label, value, u in zip(produced.labels, produced.values, produced.u, strict=True):
        panels.append(panel(f"{label} ± 2 u", "m", [curve("", x, value, u=u)]))
        columns |= {f"{label}_m": value, f"u_{label}_m": u}
    return curve_chart("Quantities free of drift", (name, unit), panels), columns


def dependence_of(produced: Any, inputs: Any = None) -> Description:
    """Return what a document holds of a `Dependence`."""
    v = produced.variable
    order = np.argsort(v)
    line = np.linspace(float(np.nanmin(v)), float(np.nanmax(v)), 101)
    name = str(produced.audit.get("variable", "variable"))
    curves = [
        curve(
            f"fit, {100.0 * produced.confidence:g} %",
            line,
            produced.evaluate(line),
            u=produced.half_width(line) / 2.0,
        ),
        curve("readings", v[order], produced.values[order], points=True),
    ]
    chart = curve_chart("Readings and fit", (name, "1"), [panel("", "m", curves)])
    columns = {
        name.replace(" ", "_"): v,
        "value_m": produced.values,
        "residual_m": produced.residual,
    }
    return Description(
        dict(produced.coefficients),
        (chart,),
        {"": columns},
        document={"intervals": {k: list(i) for k, i in produced.intervals.items()}},
        audit=produced.audit,
    )


# ------------------------------------------------------------------------------------------------

# ---- checks, choices and evidence in a result document: quantities, tables, charts -------------


def probe_check_of(produced: Any, inputs: Any = None) -> Description:
    """Return what a document holds of a `ProbeCheck`."""
    text = "chi-square of what the probes disagree by, over its expectation without a fault"
    found = {
        "p": quantity(
            produced.p, "1", "probability that noise alone disagrees as much", u=0.0, symbol="p"
        ),
        "disagreement": quantity(produced.chi2 / produced.freedom, "1", text),
    }
    named = produced.named
    if named is not None and named.fault != "turn":
        unit = "rad" if named.fault == "angle" else "1"
        key = f"probe_{named.probe}.{named.fault}"
        words = "true minus stated angle" if unit == "rad" else "relative excess of sensitivity"
        text = f"{words} of probe {named.probe}, counted from 0"
        found[key] = quantity(named.size, unit, text, u=named.u)
    k = np.arange(produced.chi2_per_k.size)
    chart = curve_chart(
        "Disagreement of the probes",
        ("undulations per revolution k", "1"),
        [panel("chi-square over freedom", "1", [curve("", k, produced.chi2_per_k, points=True)])],
        caption="1 is noise alone; an undulation far above it shows where the probes disagree.",
    )
    tables = {
        "": {"k": k, "chi2_per_freedom": produced.chi2_per_k},
        "suspects": {
            "probe": [s.probe for s in produced.suspects],
            "fault": [s.fault for s in produced.suspects],
            "angle_deg": [_only(s, "angle", math.degrees(s.size)) for s in produced.suspects],
            "sensitivity_excess": [_only(s, "sensitivity", s.size) for s in produced.suspects],
            "chi2": [s.chi2 for s in produced.suspects],
        },
    }
    return Description(
        found,
        (chart,),
        tables,
        document={"agrees": bool(produced.agrees), "finding": produced.message},
        audit={"chi2": produced.chi2, "freedom": produced.freedom},
        messages=(produced.message,),
    )


def _only(suspect: Any, fault: str, size: float) -> float:
    return size if suspect.fault == fault else math.nan


def probe_angles_of(produced: Any, inputs: Any = None) -> Description:
    """Return what a document holds of a `ProbeAngles`."""
    found: dict[str, Quantity] = {
        f"probe_{i}": quantity(
            a, "rad", f"angle of probe {i}, counted from 0", symbol=f"probe {i}"
        )
        for i, a in enumerate(produced.angles)
    }
    rms = "root mean square over k = 2 ... kmax of the noise gain of a harmonic"
    found |= {
        "gain": quantity(produced.gain, "1", rms, u=0.0),
        "worst_gain": quantity(
            produced.worst_gain, "1", f"noise gain at its worst, k = {produced.worst_k}", u=0.0
        ),
        "robust_gain": quantity(produced.robust_gain, "1", f"{rms}, angles missed", u=0.0),
    }
    k = np.arange(produced.gain_per_k.size)
    gain = np.where(np.isfinite(produced.gain_per_k), produced.gain_per_k, np.nan)
    chart = curve_chart(
        "Noise gain of the chosen angles",
        ("undulations per revolution k", "1"),
        [panel("noise gain", "1", [curve("", k, gain, points=True)])],
        caption="Standard deviation of a harmonic of the artefact over that of one reading. An "
        "undulation without a point is not seen.",
    )
    degrees = np.degrees(produced.angles)
    listed = ", ".join(f"{a:.5g}" for a in degrees)
    return Description(
        found,
        (chart,),
        {"": {"k": k, "gain": produced.gain_per_k}},
        document={
            "angles_deg": plain(degrees, digits=9),
            "not_seen": [int(i) for i in k[np.isnan(gain)]],
        },
        audit=dict(produced.settings),
        messages=(f"the probes stand at {listed} deg, in the order of the readings",),
    )


def evidence_of(produced: Any, inputs: Any = None) -> Description:
    """Return what a document holds of an `EvidenceTable`."""
    columns = produced.columns
    wave = np.asarray(columns["wavelength_mm"], dtype=np.float64) * 1e-3
    chosen = np.asarray(columns["selected"], dtype=bool)
    blind = np.isnan(np.asarray(columns["p"], dtype=np.float64))
    rate = 100.0 * float(produced.audit["false_discovery_rate"])
    found = {
        "n_selected": quantity(
            np.count_nonzero(chosen),
            "1",
            f"wavelengths that repeat at all feedrates; about {rate:g} % of them by chance",
        ),
        "n_blind": quantity(
            np.count_nonzero(blind), "1", "wavelengths that these feedrates cannot judge"
        ),
    }
    if chosen.any():
        text = "shortest wavelength that repeats at all feedrates"
        found["shortest"] = quantity(wave[chosen].min(), "m", text)
    amplitude = np.asarray(columns["amplitude_nm"], dtype=np.float64) * 1e-9
    coherence = np.asarray(columns["coherence"], dtype=np.float64)
    null = np.asarray(columns["coherence_null"], dtype=np.float64)
    panels = [
        panel(
            "coherence between feedrates",
            "1",
            [curve("", wave, coherence), curve("noise passes this in 5 %", wave, null)],
        ),
        panel(
            "amplitude of the mean run",
            "m",
            [
                curve("all", wave, amplitude),
                curve("repeats", wave, np.where(chosen, amplitude, np.nan), points=True),
            ],
        ),
    ]
    chart = curve_chart("Evidence by wavelength", ("wavelength", "m"), panels)
    chart["x"]["log"] = True
    return Description(found, (chart,), {"": columns}, audit=produced.audit)


def speed_sweep_of(produced: Any, inputs: Any = None) -> Description:
    """Return what a document holds of a `SpeedSweep`."""
    found: dict[str, Quantity] = {}
    columns: dict[str, Any] = {"speed_Hz": produced.speed}
    panels = []
    line = np.linspace(float(produced.speed[0]), float(produced.speed[-1]), 101)
    for name, fit in produced.fits.items():
        found |= {f"{name}.c{p}": fit.coefficient(p) for p in fit.powers}
        found |= {
            f"{name}.peak{'' if i == 0 else f'.{i + 1}'}": quantity(
                s, "Hz", f"speed at which {name} stands out, in rev/s"
            )
            for i, s in enumerate(fit.peaks)
        }
        half = fit.half_width(line) / 2.0
        curves = [
            curve("fit, 95 %", line, fit.evaluate(line), u=half),
            curve("tests", produced.speed, fit.values, points=True),
        ]
        panels.append(panel(name, fit.unit, curves))
        columns |= {
            f"{name}_{fit.unit}": fit.values,
            f"u_{name}_{fit.unit}": fit.u,
            f"residual_{name}_{fit.unit}": fit.residual,
        }
    chart = curve_chart("Spindle over speed", ("speed / (rev/s)", "1"), panels)
    critical: Mapping[int, float] = produced.critical
    document = {"critical_rev_per_s": {str(k): v for k, v in critical.items()}}
    return Description(
        named(found), (chart,), {"": columns}, document=document, audit=produced.audit
    )


# ------------------------------------------------------------------------------------------------


def _of_readings(name: str) -> Any:
    """Return what describes readings of a machine; its module, and the machine, load when it is asked."""

    def described(produced: Any, inputs: Any = None) -> Description:
        from metrosep.recipe.describe import describe_readings

        found: Description = getattr(describe_readings, name)(produced, inputs)
        return found

    return described


_KINDS: Mapping[str, Any] = {
    "Separation": separation_of,
    "PositioningTest": positions_of,
    "TurnedError": turned_of,
    "LaserReadings": laser_of,
    "SpindleMotion": spindle_of,
    "MotionStraightness": straightness_of,
    "DriftTest": drift_test_of,
    "DriftFreeDifference": difference_of,
    "JointDrift": joint_drift_of,
    "Dependence": dependence_of,
    "DiagonalTest": diagonals_of,
    "ZeroCalibration": zero_of,
    "PlaneMap": plane_map_of,
    "PlaneFit": surfaces_of,
    "FeedPlan": feed_plan_of,
    "Registration": registration_of,
    "ProbeCheck": probe_check_of,
    "ProbeAngles": probe_angles_of,
    "EvidenceTable": evidence_of,
    "SpeedSweep": speed_sweep_of,
    "SensitivityTable": sensitivity_of,
    "Identification": identification_of,
    "MachineCalibration": _of_readings("machine_calibration_of"),
    "PartCurves": _of_readings("part_curves_of"),
    "CircleRun": _of_readings("circle_of"),
    "ThermalResult": _of_readings("thermal_of"),
    "WavefrontResult": wavefront_of,
    "SettingFit": setting_of,
    "FollowUp": follow_up_of,
    "FlexureCalibration": calibration_of,
    "JobResult": prediction_of,
    "CutBudgetFound": cut_budget_of,
    "AxisMotion": axis_motion_of,
    "HysteresisFound": hysteresis_of,
    "DualServoResult": dual_servo_of,
    "GaugeStudy": gauge_of,
    "PartSeries": series_of,
    "MeasuredGeometry": geometry_of,
}


def describe(produced: Any, inputs: Any = None) -> Description:
    """Return what a document holds of a result."""
    kind = type(produced).__name__
    if kind not in _KINDS:
        raise DataError(f"a {kind} cannot be put into a result document")
    described: Description = _KINDS[kind](produced, inputs)
    return described
