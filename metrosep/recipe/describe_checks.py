"""Checks, choices and evidence in a result document: quantities, tables, charts."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any

import numpy as np

from metrosep.core.quantity import Quantity
from metrosep.recipe.charts import curve, curve_chart, panel, plain
from metrosep.recipe.description import Description, named, quantity

__all__ = ["evidence_of", "probe_angles_of", "probe_check_of", "speed_sweep_of"]


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
