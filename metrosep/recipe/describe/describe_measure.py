"""A measurement in a result document: quantities, charts, what each step did."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from metrosep.core._arrays import FloatArray
from metrosep.core.profile import Profile
from metrosep.core.readable import readable_unit
from metrosep.core.surface import Surface
from metrosep.core.units import format_length, with_px
from metrosep.recipe.describe.charts import (
    curve,
    curve_chart,
    display_limits,
    map_chart,
    panel,
    plain,
)
from metrosep.recipe.describe.description import Description
from metrosep.recipe.pipeline_checks import EVALUATING
from metrosep.recipe.pipeline_mask import Measured, middle_of

if TYPE_CHECKING:
    from metrosep.recipe.map_sections import MapSection
    from metrosep.recipe.pipeline import Stage
    from metrosep.recipe.pipeline_run import Measurement

_SIDE, _SIDE_BEFORE = 512, 128
"""Pixels along the longer side of the map that was judged, which is printed from the document (up to 3 MB),
and of those before."""
_BINS = (40, 200)
"""Fewest and most classes of a histogram."""
_BEYOND = 0.05
"""Of the range of a histogram that leaves heights out, added at each side."""

_GAPS = "Gaps in a curve were not measured."


def measurement_of(produced: Measurement, inputs: Any = None) -> Description:
    """Return what a document holds of a `Measurement`."""
    before, last = _before_form(produced), produced.obj
    if isinstance(last, Surface):
        shown = [before, *_maps_left(produced)]
        charts = [_map(*pair, measured=i == 0) for i, pair in enumerate(shown[:-1])]
        charts.append(_map(*shown[-1], measured=len(shown) == 1, side=_SIDE))
        charts += _sections(last)
        charts += [_drawn(s) for s in produced.sections if s.profile is not None]
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
        document={
            "steps": [_stage(s) for s in produced.stages],
            **(
                {"sections": [_section(s) for s in produced.sections]} if produced.sections else {}
            ),
        },
        audit={
            **{f"step {s.index + 1}, {s.op}": _words(s) for s in produced.stages},
            **{f"section {s.name}": f"{s.kind}, {len(s.found)} values" for s in produced.sections},
        },
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
    done = [s for s in measured.stages if s.enabled and s.op not in EVALUATING]
    forms = [s for s in done if s.op == "form"]
    if forms and done[-1] is not forms[-1]:
        shown.append(("What the form leaves", forms[-1].obj))
    if done:
        shown.append((f"What is left after {', '.join(s.op for s in done)}", measured.obj))
    return shown


def _map(title: str, obj: Measured, *, measured: bool, side: int = _SIDE_BEFORE) -> dict[str, Any]:
    """Return the chart of one map on a scale of its own; `measured`: nothing was removed yet."""
    assert isinstance(obj, Surface)  # noqa: S101  # as what is left
    return map_chart(
        title,
        {"": obj.z},
        dx=obj.dx,
        dy=obj.dy,
        unit="m",
        caption=f"{obj.n_invalid} of {obj.z.size} pixels not measured or removed: grey.",
        origin=obj.origin,
        pv={"": obj.peak_to_valley()},
        measured=measured,
        quantity="height",
        side=side,
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
            quantity="height",
        ),
        panel(
            f"along y at x = {format_length(float(x[column]))}",
            "m",
            [curve("", y, surface.z[:, column])],
            quantity="height",
        ),
    ]
    where = "the middle of what is left"
    found = _standing_out(surface)
    if found is not None:
        i, j = found
        for name, at, curve_of in (
            (f"along x at y = {format_length(float(y[i]))}", i, curve("", x, surface.z[i])),
            (f"along y at x = {format_length(float(x[j]))}", j, curve("", y, surface.z[:, j])),
        ):
            if at not in (row, column):
                panels.append(
                    panel(
                        f"{name}, through the farthest pixel", "m", [curve_of], quantity="height"
                    )
                )
        where = "the middle and through the pixel farthest from the mean"
    words = f"Through {where}. {_GAPS}"
    return [curve_chart("Sections", ("position", "m"), panels, caption=words)]


def _drawn(section: MapSection) -> dict[str, Any]:
    """Return the chart of a section that the recipe asks for."""
    profile = section.profile
    assert profile is not None  # noqa: S101
    along = "arc from +x to +y" if section.kind == "circle" else "distance from a"
    lines = [panel("", "m", [curve("", profile.x, profile.z)], quantity="height")]
    title = f"Section {section.name}"
    return curve_chart(title, (along, profile.lateral_unit), lines, caption=_GAPS)


def _section(section: MapSection) -> dict[str, Any]:
    """Return a section as plain values, SI."""
    return {
        **{k: list(v) if isinstance(v, tuple) else v for k, v in with_px(section.keys).items()},
        "found": {k: q.to_dict() for k, q in section.found.items()},
        "messages": list(section.messages),
    }


def _standing_out(surface: Surface) -> tuple[int, int] | None:
    """Return the pixel farthest from the mean, where it lies beyond the limits of the map."""
    away = surface.z - np.nanmean(surface.z)
    low, high, below, above = display_limits(away)
    if not below and not above:
        return None
    i, j = np.unravel_index(int(np.nanargmax(np.abs(away))), away.shape)
    return (int(i), int(j)) if not low <= away[i, j] <= high else None


def _profiles(measured: Measurement, title: str, before: Measured) -> dict[str, Any]:
    last = measured.obj
    assert isinstance(before, Profile)  # noqa: S101
    assert isinstance(last, Profile)  # noqa: S101
    panels = [panel(title.lower(), "m", [curve("", before.x, before.z)], quantity="height")]
    changed = [s.op for s in measured.stages if s.enabled and s.op not in EVALUATING]
    if changed:
        panels.append(
            panel(
                f"after {', '.join(changed)}", "m", [curve("", last.x, last.z)], quantity="height"
            )
        )
    return curve_chart("Profile", ("position", "m"), panels, caption=_GAPS)


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
    words = f"{found.sentence}. Lines along {found.direction}."
    chart = curve_chart(
        "Power spectral density",
        ("frequency in 1/mm", "1"),
        [panel("log10 of the density in nm^2 mm", "1", curves)],
        caption=words,
    )
    chart["x"]["log"] = True
    return chart


def _histogram(obj: Measured) -> list[dict[str, Any]]:
    """Return the distribution of heights with the normal one of the same spread, and the material ratio."""
    known = obj.z[~np.isnan(obj.z)]
    if known.size < 2 or not np.ptp(known) > 0.0:
        return []
    mean = float(known.mean())
    edges = height_classes(known - mean)
    low, high = float(edges[0]), float(edges[-1])
    heights = known - mean
    inside = heights[(heights >= low) & (heights <= high)]
    counts, _ = np.histogram(inside, bins=edges)
    middles, width = 0.5 * (edges[1:] + edges[:-1]), float(edges[1] - edges[0])
    centre, sd = float(inside.mean()), float(inside.std())
    normal = np.exp(-0.5 * ((middles - centre) / sd) ** 2) * width / (sd * np.sqrt(2.0 * np.pi))
    unit, factor = readable_unit([low, high], "m")
    below, above = int((heights < low).sum()), int((heights > high).sum())
    words = f"{known.size} heights about their mean in {counts.size} classes of {format_length(width)}."
    if below or above:
        words += f" {below} height{'' if below == 1 else 's'} below, {above} above the picture."
    words += " Material ratio: share of heights above."
    ordered = np.sort(heights)
    share = 1.0 - np.searchsorted(ordered, edges, side="left") / ordered.size
    curves = [
        {**curve("share of heights", middles / factor, counts / known.size), "classes": True},
        curve("normal distribution of the same spread", middles / factor, normal),
    ]
    panels = [
        panel("", "1", curves, quantity="share"),
        panel("material ratio", "1", [curve("", edges / factor, share)], quantity="share above"),
    ]
    name = (f"height / {unit}", "1")
    return [curve_chart("Distribution of heights", name, panels, caption=words)]


def height_classes(heights: FloatArray) -> FloatArray:
    """Return the edges of the classes: 2 IQR n^(-1/3) wide (Freedman and Diaconis), 40 to 200 of them."""
    low, high, below, above = display_limits(heights)
    if below or above:
        spare = _BEYOND * (high - low)
        low, high = low - spare, high + spare
    q1, q3 = np.quantile(heights, (0.25, 0.75))
    width = 2.0 * float(q3 - q1) * heights.size ** (-1.0 / 3.0)
    n = int(np.ceil((high - low) / width)) if width > 0.0 else _BINS[1]
    edges: FloatArray = np.linspace(low, high, min(max(n, _BINS[0]), _BINS[1]) + 1)
    return edges


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
        return f"{audit['taken_out']} heights removed, {audit['left']} left"
    if stage.op == "form":
        free = ", ".join(k for k, v in audit["parameters"].items() if v["free"])
        over = "over pixels" if "over" in audit else free
        return (
            f"{audit['form']} fitted to {audit['n_points']} points ({over}); RMS "
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
