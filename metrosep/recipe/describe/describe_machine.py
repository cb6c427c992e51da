"""Rankings, identified error terms and wavefronts in a result document."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Any

import numpy as np

from metrosep.core.quantity import Quantity
from metrosep.core.readable import typed_number
from metrosep.core.surface import Surface
from metrosep.core.units import format_length
from metrosep.recipe.describe.charts import bar_chart, map_chart
from metrosep.recipe.describe.description import Description, quantity

_MOST_TERMS = 30
_MOST_MAPS = 6
_PIXELS = 161


def sensitivity_of(produced: Any, inputs: Any = None) -> Description:
    """Return what a document holds of a `SensitivityTable`."""
    what = "wavefront" if produced.response == "wavefront" else "form"
    removed = ", ".join(produced.removed) or "nothing"
    words = f"root of the expected mean square of the {what} error"
    found: dict[str, Quantity] = {
        "expected_sq": quantity(
            produced.expected_sq, "m", f"{words}; removed: {removed}", symbol="Sq expected"
        ),
        "expected_sq_raw": quantity(
            produced.expected_sq_raw, "m", f"{words}; nothing removed", symbol="Sq expected, raw"
        ),
    }
    for name in produced.order:
        item = produced[name]
        found[f"sq.{name}"] = quantity(item.value, "m", item.definition, symbol=f"Sq {name}")
    frame = produced.to_frame().reset_index()
    tables = {"": {str(k): frame[k].tolist() for k in frame.columns}}
    if what == "wavefront":
        frame = produced.zernike().reset_index()
        tables["zernike"] = {str(k): frame[k].tolist() for k in frame.columns}
    groups = [", ".join(g) for g in produced.groups]
    messages = [f"{g}: one part cannot distinguish these terms" for g in groups]
    messages += [
        f"without {' + '.join(n for s in steps for n in s.names)} the expected Sq is "
        f"{1e9 * steps[-1].sq:.4g} nm"
        for steps in (produced.pareto()[1 : k + 1] for k in (1, 2, 3))
        if steps
        and produced.visible
        and all(s.sq > 0.0 for s in steps[:-1])  # else nothing is left to take
    ]
    messages += [
        f"{', '.join(names)}: not visible on this part ({why}), so omitted from the list"
        for why, names in produced.hidden.items()
    ]
    messages += _height_shifts(produced)
    document = {"groups": [list(g) for g in produced.groups], "ranking": produced.to_dict()}
    charts = (_ranking(produced, what, removed), *_term_maps(produced, what))
    return Description(
        found,
        charts,
        tables,
        document=document,
        audit=dict(produced.audit),
        messages=tuple(dict.fromkeys(messages)),
        unlisted=frozenset(f"sq.{n}" for names in produced.hidden.values() for n in names),
    )


_CONSTANT = 1e-6
"""P-V of a map over its largest value, below which it is one height."""


def _height_shifts(produced: Any) -> list[str]:
    """Return which leading terms only move the whole part along z, where a wavefront is ranked."""
    if produced.response != "wavefront" or "defocus" in produced.removed:
        return []
    leading = [n for n in produced.order[:_LEADING] if produced[n].value > 0.0]
    maker = replace(produced.maker, response="form", direction="vertical", wavefront=None)
    form = maker.make()
    shifts = []
    for name in leading:
        column = form[:, maker.terms.index(name)]
        if np.ptp(column) <= _CONSTANT * np.abs(column).max(initial=0.0) and column.any():
            shifts.append(name)
    if not shifts:
        return []
    words = (
        f"{', '.join(shifts)} only move the whole part along z and leave its form as it is: their "
        "wavefront error is that of a vertex off the fixed reference plane, which setting the part "
        "up in height takes away. Compensate them only if that height is not adjusted; remove "
        'defocus too to rank without most of it: removed="plane+defocus"'
    )
    return [words]


_LEADING = 5


_SPREAD = 20.0
"""Largest over the median ranked bar, beyond which the scale is logarithmic."""


def _ranking(produced: Any, what: str, removed: str) -> dict[str, Any]:
    seen = produced.visible
    shown = list(seen or produced.order)[:_MOST_TERMS]
    at = [produced.names.index(n) for n in shown]
    raw, ranked = produced.sq_raw[at], produced.sq[at]
    positive = ranked[ranked > 0.0]
    wide = positive.size > 0 and max(raw.max(), ranked.max()) > _SPREAD * np.median(positive)
    series = {"nothing removed": raw, f"without {removed}": ranked}
    if wide:  # a logarithmic scale has no place for zero
        series = {k: np.where(v > 0.0, v, np.nan) for k, v in series.items()}
    lost = len(produced.order) - len(seen)
    caption = (
        "Each error term at its magnitude, the others zero. Only what is left after the "
        "alignment is a ranking of the machine."
    )
    if lost and seen:
        caption += f" {lost} terms that no longer show are omitted."
    if wide:
        caption += " Logarithmic scale."
    return bar_chart(
        f"Sq of the {what} error by each term alone",
        shown,
        series,
        unit="m",
        quantity="Sq",
        log=wide,
        caption=caption,
    )


def _term_maps(produced: Any, what: str) -> tuple[dict[str, Any], ...]:
    shown = list(produced.visible[:_MOST_MAPS])
    if not shown:
        return ()
    maps = produced.unit_maps()
    maker = produced.maker
    rho, azimuth = maker.mesh.rho, maker.mesh.azimuth
    parts, step = {}, 0.0
    pv: dict[str, float] = {}
    for name in shown:
        i = produced.names.index(name)
        whole = maps[..., i] * produced.magnitudes[i]
        pv[name] = float(np.ptp(whole[np.isfinite(whole)]))
        z, step = _on_squares(rho, azimuth, whole)
        parts[name] = z
    return (
        map_chart(
            f"{what.capitalize()} error by the terms of largest Sq",
            parts,
            dx=step,
            dy=step,
            unit="m",
            origin=(-0.5 * step * (_PIXELS - 1),) * 2,
            caption="Each term at its magnitude, after the alignment; nearest points of the mesh. "
            "P-V is that of the whole mesh.",
            pv=pv,
        ),
    )


def _on_squares(rho: Any, azimuth: Any, z: Any) -> tuple[Any, float]:
    """Return a map on rings as pixels, each the nearest point of the mesh; NaN outside."""
    radii, angles = np.unique(np.ravel(rho)), np.unique(np.ravel(azimuth))
    reach = float(radii[-1])
    axis = np.linspace(-reach, reach, _PIXELS)
    x, y = np.meshgrid(axis, axis)
    r = np.hypot(x, y)
    turn = np.mod(np.arctan2(y, x) - angles[0], 2.0 * np.pi)
    ring = np.clip(np.searchsorted(radii, r) - 1, 0, max(radii.size - 2, 0))  # below the pixel
    beyond = np.minimum(ring + 1, radii.size - 1)
    ring = np.where(np.abs(radii[beyond] - r) < np.abs(radii[ring] - r), beyond, ring)
    spoke = np.rint(turn / (2.0 * np.pi) * angles.size).astype(int) % angles.size
    out = np.where((r <= reach) & (r >= radii[0]), z[ring, spoke], np.nan)
    return out, float(axis[1] - axis[0])


def identification_of(produced: Any, inputs: Any = None) -> Description:
    """Return what a document holds of an `Identification`."""
    found: dict[str, Quantity] = {}
    tables: dict[str, list[Any]] = {"term": [], "value_si": [], "u_si": [], "unit": []}
    for name, value, u, unit in zip(
        produced.names, produced.values, produced.u, produced.units, strict=True
    ):
        for key, item in zip(tables, (name, float(value), float(u), unit), strict=True):
            tables[key].append(item)
        if math.isfinite(value):
            found[name] = quantity(value, unit, f"error term {name} that explains the part", u=u)
    found |= _groups(produced)
    found["sq_before"] = quantity(
        produced.sq_before, "m", "Sq of the measured form error, aligned"
    )
    found["sq_after"] = quantity(produced.sq_after, "m", "Sq of what the terms leave unexplained")
    found["predicted_sq"] = quantity(
        produced.predicted_sq, "m", "Sq to expect when the terms found are compensated"
    )
    more = {"groups": _if_alone(produced)} if produced.groups else {}
    maps: dict[str, Surface] = {}
    charts: tuple[dict[str, Any], ...] = ()
    if isinstance(produced.residual, Surface):
        maps = {"residual": produced.residual}
        charts = (
            map_chart(
                "What the error terms leave",
                {"residual": produced.residual.z},
                dx=produced.residual.dx,
                dy=produced.residual.dy,
                unit="m",
                origin=produced.residual.origin,
                caption="Measured minus the part that the machine with these errors cuts.",
            ),
        )
    return Description(
        found,
        charts,
        {"": tables, **more},
        maps,
        audit=dict(produced.audit),
        messages=_correction(produced),
    )


def _correction(produced: Any) -> tuple[str, ...]:
    """Return what to type into the machine for the terms that were told apart."""
    known = [
        f"{name} {_signed(-float(value), unit)}"
        for name, value, unit in zip(produced.names, produced.values, produced.units, strict=True)
        if math.isfinite(value)
    ]
    words = []
    if known:
        words.append(
            f"correction: {', '.join(known)} (the negative of each error; it acts where the error "
            "stands in the chain of the machine)"
        )
    if produced.groups:
        words.append(
            "of the terms that hang together correct one alone, by the negative of its value if it "
            "alone is at work: each makes up for the common effect on this part"
        )
    return tuple(words)


def _signed(value: float, unit: str) -> str:
    """Return a length or an angle with its sign, in a unit that is read easily."""
    size = abs(value)
    text = format_length(size, digits=5) if unit == "m" else typed_number(size, "angle", digits=5)
    return f"{'-' if value < 0.0 else '+'}{text}"


def _if_alone(produced: Any) -> dict[str, list[Any]]:
    """Return the groups as a table: each member if it alone is at work."""
    units = dict(zip(produced.names, produced.units, strict=True))
    rows: dict[str, list[Any]] = {
        k: [] for k in ("group", "common_sq_m", "term", "if_alone_si", "u_si", "unit")
    }
    for group in produced.groups:
        for name, (value, u) in group.equivalents.items():
            row = ("+".join(group.names), abs(group.sq), name, value, u, units[name])
            for column, item in zip(rows.values(), row, strict=True):
                column.append(item)
    return rows


def _groups(produced: Any) -> dict[str, Quantity]:
    """Return what is known of terms that hang together: their size, and each if it were alone."""
    units = dict(zip(produced.names, produced.units, strict=True))
    found = {}
    for group in produced.groups:
        label = "+".join(group.names)
        words = f"Sq that {', '.join(group.names)} have in common: one part cannot tell them apart"
        found[label] = quantity(abs(group.sq), "m", words, u=group.u)
        for name, (value, u) in group.equivalents.items():
            found[f"{label}.{name}"] = quantity(
                value,
                units[name],
                f"{name} if it alone of {', '.join(group.names)} is at work",
                u=u,
            )
    return found


def wavefront_of(produced: Any, inputs: Any = None) -> Description:
    """Return what a document holds of a wavefront."""
    rest, table = produced.rest, produced.table
    removed = ", ".join(rest.removed) or "nothing"
    kind = "reflected" if rest.mode == "reflect" else f"refracted (n = {rest.n:g})"
    found = {
        "rms": quantity(rest.rms, "m", f"RMS of the {kind} wavefront; removed: {removed}"),
        "pv": quantity(
            rest.peak_to_valley, "m", f"P-V of the {kind} wavefront; removed: {removed}"
        ),
    }
    if produced.wavelength is not None:
        found["strehl"] = quantity(
            rest.strehl(produced.wavelength, removed=()),
            "1",
            f"Strehl ratio at {1e9 * produced.wavelength:g} nm; removed: {removed}",
        )
    frame = table.to_frame()
    for name, label in zip(frame["term"], frame["name"], strict=True):
        found[name] = quantity(
            table[name], "m", f"Zernike {name} ({table.order}), {label}", u=table.u[name]
        )
    where = [i for i, (n, _) in enumerate(table.nm) if n > 0]
    charts: list[dict[str, Any]] = []
    if where:
        charts.append(
            bar_chart(
                "Zernike terms of the wavefront",
                [str(frame["term"][i]) for i in where],
                {"": table.values()[where]},
                unit="m",
                quantity="coefficient",
                caption="Without piston; nothing removed before. Normalised to rms but for Fringe.",
            )
        )
    maps: dict[str, Surface] = {}
    if rest.steps is not None:
        maps = {"wavefront": rest.to_surface()}
        charts.insert(
            0,
            map_chart(
                "Wavefront",
                {"path difference": rest.opd},
                dx=rest.steps[0],
                dy=rest.steps[1],
                unit="m",
                origin=(float(rest.x[0, 0]), float(rest.y[0, 0])),
                caption=f"Positive where the material is high. Removed: {removed}.",
            ),
        )
    columns = {str(k): frame[k].tolist() for k in frame.columns}
    return Description(found, tuple(charts), {"": columns}, maps, audit=dict(produced.front.audit))
