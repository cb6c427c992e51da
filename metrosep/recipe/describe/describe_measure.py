"""A measurement in a result document: quantities, charts, what each step did."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from metrosep.core.profile import Profile
from metrosep.core.readable import readable_unit
from metrosep.core.surface import Surface
from metrosep.core.units import format_length
from metrosep.recipe.describe.charts import curve, curve_chart, map_chart, panel, plain
from metrosep.recipe.describe.description import Description
from metrosep.recipe.pipeline_mask import Measured, middle_of

if TYPE_CHECKING:
    from metrosep.recipe.pipeline import Stage
    from metrosep.recipe.pipeline_run import Measurement

__all__ = ["measurement_of"]


_PIXELS = 50_000
"""Of all maps of a document: it stays below a megabyte."""
_BINS = 80
_LOOKING = ("parameters", "psd", "step_height", "surface_profile", "line_profile")
"""Steps that leave the map or profile as it is."""


def measurement_of(produced: Measurement, inputs: Any = None) -> Description:
    """Return what a document holds of a `Measurement`."""
    before, last = _before_form(produced), produced.obj
    if isinstance(last, Surface):
        shown = [before, *_maps_left(produced)]
        side = int(np.sqrt(_PIXELS / len(shown)))
        charts = [*(_map(*pair, side=side) for pair in shown), *_sections(last)]
        maps, tables = {"left": last}, {}
    else:
        charts, maps = [_profiles(produced, *before)], {}
        tables = {"": {"x_mm": last.x * 1e3, "z_nm": last.z * 1e9}}
    charts += [_spectrum(s.detail) for s in produced.stages if s.enabled and s.op == "psd"]
    charts += _histogram(last)
    return Description(
        produced.found,
        tuple(charts),
        tables,
        maps,
        document={"steps": [_stage(s) for s in produced.stages]},
        audit={f"step {s.index + 1}, {s.op}": _words(s) for s in produced.stages},
        messages=produced.messages,
        profiles={"left": last} if isinstance(last, Profile) else {},
    )


def _before_form(measured: Measurement) -> tuple[str, Measured]:
    """Return what the first form was fitted to, or what was read."""
    obj = measured.source
    for stage in measured.stages:
        if stage.enabled and stage.op == "form":
            return "Before the form was removed", obj
        obj = stage.obj
    return "As measured", measured.source


def _maps_left(measured: Measurement) -> list[tuple[str, Measured]]:
    """Return what the last form leaves, and what is left at the end where that is another map."""
    shown: list[tuple[str, Measured]] = []
    done = [s for s in measured.stages if s.enabled and s.op not in _LOOKING]
    forms = [s for s in done if s.op == "form"]
    if forms and done[-1] is not forms[-1]:
        shown.append(("What the form leaves", forms[-1].obj))
    if done:
        shown.append((f"What is left after {', '.join(s.op for s in done)}", measured.obj))
    return shown


def _map(title: str, obj: Measured, *, side: int) -> dict[str, Any]:
    """Return the chart of one map on a scale of its own."""
    assert isinstance(obj, Surface)  # noqa: S101  # as what is left
    k = max(1, -(-max(obj.shape) // side))
    words = f"{obj.n_invalid} of {obj.z.size} pixels not measured or taken out: grey."
    if k > 1:
        words += f" Every pixel in {k} along x and y is drawn; P-V is that of all."
    return map_chart(
        title,
        {"": obj.z[::k, ::k]},
        dx=None if obj.dx is None else obj.dx * k,
        dy=None if obj.dy is None else obj.dy * k,
        unit="m",
        caption=words,
        origin=obj.origin,
        pv={"": obj.peak_to_valley()},
    )


def _sections(surface: Surface) -> list[dict[str, Any]]:
    """Return row and column through the middle of what is left."""
    if surface.dx is None or surface.dy is None or surface.n_invalid == surface.z.size:
        return []
    x0, y0 = middle_of(surface)
    row = int(np.clip(round((y0 - surface.origin[1]) / surface.dy), 0, surface.shape[0] - 1))
    column = int(np.clip(round((x0 - surface.origin[0]) / surface.dx), 0, surface.shape[1] - 1))
    x = surface.origin[0] + surface.dx * np.arange(surface.shape[1])
    y = surface.origin[1] + surface.dy * np.arange(surface.shape[0])
    panels = [
        panel(
            f"along x at y = {format_length(float(y[row]))}",
            "m",
            [curve("", x, surface.z[row])],
        ),
        panel(
            f"along y at x = {format_length(float(x[column]))}",
            "m",
            [curve("", y, surface.z[:, column])],
        ),
    ]
    words = "Through the middle of what is left. Gaps are gaps."
    return [curve_chart("Sections", ("position", "m"), panels, caption=words)]


def _profiles(measured: Measurement, title: str, before: Measured) -> dict[str, Any]:
    last = measured.obj
    assert isinstance(before, Profile)  # noqa: S101
    assert isinstance(last, Profile)  # noqa: S101
    panels = [panel(title.lower(), "m", [curve("", before.x, before.z)])]
    changed = [s.op for s in measured.stages if s.enabled and s.op not in _LOOKING]
    if changed:
        panels.append(panel(f"after {', '.join(changed)}", "m", [curve("", last.x, last.z)]))
    return curve_chart("Profile", ("position", "m"), panels, caption="Gaps are gaps.")


def _spectrum(found: Any) -> dict[str, Any]:
    """Return the spectrum of the worse direction with its limit, band by band, both logarithmic."""
    f, density = found.spectrum.frequency[1:], found.spectrum.density[1:]
    keep = (density > 0.0) & (f >= 0.3 * found.bands[0].low) & (f <= 3.0 * found.bands[-1].high)
    unit = 1e-21  # nm^2 mm in m^3
    curves = [curve("measured", 1e-3 * f[keep], np.log10(density[keep] / unit))]
    if found.limit.A is not None:
        middles = [np.sqrt(b.low * b.high) for b in found.bands]
        ends = np.array([found.bands[0].low, *middles, found.bands[-1].high])
        limit = found.limit.A / ends**found.limit.B
        curves.append(curve("limit", 1e-3 * ends, np.log10(limit / unit)))
        failing = [
            (m, b.mean) for m, b in zip(middles, found.bands, strict=True) if b.verdict != "accept"
        ]
        if failing:
            at, mean = np.array(failing).T
            curves.append(
                curve("bands not accepted", 1e-3 * at, np.log10(mean / unit), points=True)
            )
    words = f"{found.sentence}. Lines along {found.direction}; limit: {found.limit.text}."
    chart = curve_chart(
        "Power spectral density",
        ("frequency in 1/mm", "1"),
        [panel("log10 of the density in nm^2 mm", "1", curves)],
        caption=words,
    )
    chart["x"]["log"] = True
    return chart


def _histogram(obj: Measured) -> list[dict[str, Any]]:
    """Return the distribution of heights, beside the normal one of the same spread."""
    known = obj.z[~np.isnan(obj.z)]
    if known.size < 2 or not np.ptp(known) > 0.0:
        return []
    counts, edges = np.histogram(known, bins=_BINS)
    middles = 0.5 * (edges[1:] + edges[:-1])
    width, mean, sd = edges[1] - edges[0], float(known.mean()), float(known.std())
    normal = np.exp(-0.5 * ((middles - mean) / sd) ** 2) * width / (sd * np.sqrt(2.0 * np.pi))
    share = counts / known.size
    unit, factor = readable_unit([float(middles[0]), float(middles[-1])], "m")
    words = f"{known.size} heights in {_BINS} classes of {format_length(float(width))}."
    curves = [
        curve("share of heights", middles / factor, share),
        curve("normal distribution of the same spread", middles / factor, normal),
    ]
    return [
        curve_chart(
            "Distribution of heights",
            (f"height / {unit}", "1"),
            [panel("", "1", curves)],
            caption=words,
        )
    ]


def _stage(stage: Stage) -> dict[str, Any]:
    """Return a step as plain values; no time, so that the same input gives the same bytes."""
    return {
        "index": stage.index,
        "op": stage.op,
        "enabled": stage.enabled,
        "found": {k: q.to_dict() for k, q in stage.found.items()},
        "messages": list(stage.messages),
        "audit": dict(stage.audit),
    }


def _words(stage: Stage) -> str:
    """Return in a few words what a step did."""
    audit = stage.audit
    if not stage.enabled:
        return "switched off"
    if stage.op in ("mask", "outliers"):
        return f"{audit['taken_out']} heights taken out, {audit['left']} left"
    if stage.op == "form":
        free = ", ".join(k for k, v in audit["parameters"].items() if v["free"])
        return (
            f"{audit['form']} fitted to {audit['n_points']} points ({free}); RMS "
            f"{format_length(audit['rms_m'])} and P-V {format_length(plain(audit['pv_m']))} left"
        )
    if stage.op == "filter":
        return f"{audit['left']} heights left"
    if stage.op == "psd":
        return f"{len(audit['bands'])} bands of lines along {audit['direction']} compared"
    if stage.op == "step_height":
        return (
            f"type {audit['type']}, {audit['n_used']} samples, RMS {format_length(audit['rms_m'])}"
        )
    if stage.op in ("surface_profile", "line_profile"):
        return f"{audit['n_points']} points against the nominal {audit['form']}, {audit['association']}"
    editions = dict.fromkeys(e["edition"] for e in audit["evaluations"])
    return f"{len(stage.found)} values after {'; '.join(editions)}"
