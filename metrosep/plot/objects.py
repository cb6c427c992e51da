"""The picture of each public object, as its method ``plot`` draws it: units on the axes, limits from the data."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from inspect import signature
from typing import TYPE_CHECKING, Any

import numpy as np

from metrosep.compensation.area_errors import is_rotary
from metrosep.core._arrays import FloatArray
from metrosep.core.errors import DataError, OptionError
from metrosep.core.numbers import choice, quantity
from metrosep.core.readable import readable_unit, typeset
from metrosep.core.units import parse_unit
from metrosep.plot.maps import draw_map
from metrosep.plot.style import (
    BAND_FACTOR,
    COLOURS,
    DASHED,
    DIMENSIONS,
    axes_or_new,
    draw_band,
    house_style,
    stated_unit,
)
from metrosep.recipe.describe.charts import decimated, display_limits, thin

if TYPE_CHECKING:
    from matplotlib.axes import Axes

    from metrosep.core.surface import Surface

_SIDE = 512
"""Pixels of a map along its longer side."""


def draw_object(
    obj: Any,
    ax: Axes | str | None = None,
    *,
    unit: str | None = None,
    vmin: float | str | None = None,
    vmax: float | str | None = None,
    **options: Any,
) -> Any:
    """Draw a public object and return the axes."""
    found = next(
        (_PICTURES[c.__name__] for c in type(obj).__mro__ if c.__name__ in _PICTURES), None
    )
    if found is None:
        raise DataError(
            f"{type(obj).__name__} has no picture; its values are in to_frame or its fields"
        )
    name = type(obj).__name__
    taken = [p.name for p in signature(found).parameters.values() if p.kind is p.KEYWORD_ONLY]
    if isinstance(ax, str):  # error.plot("spectrum")
        if "kind" not in taken:
            raise OptionError(f"a {name} has one picture; plot does not take {ax!r}")
        ax, options = None, {"kind": ax, **options}
    stray = [k for k in options if k not in taken]
    if stray:
        known = ", ".join(["ax", "unit", "vmin", "vmax", *taken])
        raise OptionError(f"plot of a {name} does not take {', '.join(stray)}; it takes {known}")
    scale = _Scale(unit, vmin, vmax)
    with house_style():
        return found(obj, ax, scale, **options)


class _Scale:
    """Unit and ends of the values, as a caller states them."""

    def __init__(
        self, unit: str | None, low: float | str | None, high: float | str | None
    ) -> None:
        self.unit, self.low, self.high = unit, low, high

    @property
    def stated(self) -> list[str]:
        """Names of what a caller states."""
        given = {"unit": self.unit, "vmin": self.low, "vmax": self.high}
        return [k for k, v in given.items() if v is not None]

    def refuse(self, what: str) -> None:
        """Refuse what a caller states of a picture that has its own scale."""
        if self.stated:
            told = ", ".join(self.stated)
            raise OptionError(f"{what} has its own scale: plot does not take {told}")

    def base(self, units: Mapping[str, str], way: str) -> str:
        """Return the one SI unit of several values by name; refuse a stated scale where there is none."""
        found = {*units.values()}
        one = found.pop() if len(found) == 1 else ""
        if self.stated and one not in DIMENSIONS:
            held = ", ".join(f"{k} ({v or 'no unit'})" for k, v in units.items())
            raise OptionError(
                f"{held} share no unit that a scale could have: plot does not take "
                f"{', '.join(self.stated)}; {way}"
            )
        return one

    def of(self, largest: float, base: str) -> tuple[str, float]:
        """Return the unit and its factor."""
        if self.unit is not None:
            return stated_unit(self.unit, base)
        name, factor = readable_unit([largest], base)
        return typeset(name), factor

    def ends(self, low: float, high: float, base: str) -> tuple[float, float]:
        """Return the ends in SI."""
        kind = DIMENSIONS.get(base, "length")
        a = low if self.low is None else quantity(self.low, "vmin", kind)
        b = high if self.high is None else quantity(self.high, "vmax", kind)
        if not a < b and (self.low is not None or self.high is not None):
            raise DataError(f"vmin = {a:.6g} must be less than vmax = {b:.6g}")
        return a, b

    def limit(self, axes: Axes, factor: float, base: str) -> None:
        """Set the ends of the ordinate where a caller stated them."""
        if self.low is not None or self.high is not None:
            low, high = axes.get_ylim()
            a, b = self.ends(low * factor, high * factor, base)
            axes.set_ylim(a / factor, b / factor)

    def limit_drawn(self, axes: Axes, label: str, base: str) -> None:
        """Set the ends of an ordinate whose label ends in its unit."""
        self.limit(axes, _factor_of(label), base)


def _factor_of(label: str) -> float:
    """Return the value in SI of the unit in which a label ends."""
    return parse_unit(label.rpartition(" / ")[2].replace("µ", "u")).factor


def _surface(
    obj: Surface, ax: Axes | None, scale: _Scale, *, signed: bool = False, title: str = ""
) -> Axes:
    z = obj.z
    known = z[np.isfinite(z)]
    mean = 0.0 if signed or not known.size else float(known.mean())
    low, high, below, above = display_limits(z - mean)
    if signed and known.size:
        high = max(abs(low), abs(high))
        low = -high
    given = scale.low is not None or scale.high is not None
    if given:
        mean = 0.0
    low, high = scale.ends(low, high, "m") if known.size else (0.0, 1.0)
    name, factor = scale.of(max(abs(low), abs(high)), "m")
    k = max(1, -(-max(obj.shape) // _SIDE))
    dx, dy = (None if d is None else d * k for d in (obj.dx, obj.dy))
    first = tuple(
        o + 0.5 * (k - 1) * (d or 0.0) for o, d in zip(obj.origin, (obj.dx, obj.dy), strict=True)
    )
    axes = axes_or_new(ax, size=(5.2, 4.2))
    shown = decimated(z - mean, k) / factor
    image = draw_map(
        axes, shown, dx, dy, (first[0], first[1]), (low / factor, high / factor), signed=signed
    )
    outside = "both" if below and above else "min" if below else "max" if above else "neither"
    bar = axes.figure.colorbar(image, ax=axes, extend="both" if given else outside)
    bar.set_label(f"height / {name}" + (" (mean subtracted)" if mean else ""))
    if title:
        axes.set_title(title, loc="left", fontsize=9.5)
    return axes


def _line(
    axes: Axes, x: FloatArray, z: FloatArray, scale: _Scale, unit: str, **style: Any
) -> tuple[str, float]:
    """Draw a curve over position, its extremes kept; return the unit and factor of the ordinate."""
    known = z[np.isfinite(z)]
    name, factor = scale.of(float(np.abs(known).max()) if known.size else 0.0, unit)
    keep = thin(x, z[None, :])
    axes.plot(x[keep] * 1e3, z[keep] / factor, **style)
    return name, factor


def _profile(obj: Any, ax: Axes | None, scale: _Scale) -> Axes:
    axes = axes_or_new(ax)
    name, factor = _line(axes, obj.x, obj.z, scale, "m", color=COLOURS["estimate"], linewidth=1.0)
    axes.set(xlabel="x / mm", ylabel=f"height / {name}")
    scale.limit(axes, factor, "m")
    return axes


def _recording(obj: Any, ax: Axes | None, scale: _Scale, *, channel: str | None = None) -> Axes:
    names = [channel] if channel is not None else [*obj.channels]
    base = scale.base({n: obj.units.get(n, "") for n in names}, "draw one with channel=")
    axes = axes_or_new(ax)
    known = [np.abs(obj[n][np.isfinite(obj[n])]) for n in names]
    largest = max((float(k.max()) for k in known if k.size), default=0.0)
    unit, factor = scale.of(largest, base) if base in DIMENSIONS else (base or "SI", 1.0)
    for name in names:
        z = obj[name]
        keep = thin(obj.t, z[None, :])
        axes.plot(obj.t[keep], z[keep] / factor, linewidth=0.9, label=name)
    axes.set(xlabel="time / s", ylabel=f"reading / {unit}")
    scale.limit(axes, factor, base)
    axes.legend()
    return axes


def _runs(obj: Any, ax: Axes | None, scale: _Scale) -> Axes:
    axes = axes_or_new(ax)
    several = [*obj] if hasattr(obj, "common_travel") else [obj]
    level = [r.z - np.nanmean(r.z) for r in several]
    largest = max(
        (float(np.nanmax(np.abs(z))) for z in level if np.isfinite(z).any()), default=0.0
    )
    base = str(getattr(obj, "metadata", {}).get("z_unit", "m"))
    name, factor = scale.of(largest, base)
    fixed = _Scale(name.replace("µ", "u"), scale.low, scale.high)
    for run, z in zip(several, level, strict=True):
        order = np.argsort(run.x)
        style = {"linestyle": "-" if run.direction > 0 else DASHED, "linewidth": 0.8}
        _line(axes, run.x[order], z[order], fixed, base, label=run.run_id or "run", **style)
    axes.set(xlabel="position / mm", ylabel=f"reading / {name} (mean subtracted)")
    scale.limit(axes, factor, base)
    axes.legend(ncols=2, fontsize=7.5)
    return axes


def _estimate(obj: Any, ax: Axes | None, scale: _Scale, *, kind: str = "error") -> Axes:
    if choice(kind, "the picture of an estimate", ("error", "spectrum", "psd")) != "error":
        from metrosep.plot.spectra import residual_psd, spectrum

        scale.refuse(f"the {'spectrum' if kind == 'spectrum' else 'PSD'} of an estimate")
        return (spectrum if kind == "spectrum" else residual_psd)(obj, ax)
    axes = axes_or_new(ax)
    x = np.linspace(obj.start, obj.stop, 601)
    curves = {d: (obj.evaluate(x, direction=d), obj.sd(x, direction=d)) for d in obj.directions}
    largest = max(float(np.nanmax(np.abs(e))) for e, _ in curves.values())
    name, factor = scale.of(largest, "m")
    for d, (e, sd) in curves.items():
        colour = COLOURS["estimate" if d > 0 else "reverse"]
        way = "forward" if d > 0 else "reverse"
        if np.isfinite(sd).any():
            draw_band(axes, x * 1e3, e / factor, BAND_FACTOR * sd / factor, colour)
        axes.plot(x * 1e3, e / factor, color=colour, label=f"{way} ± {BAND_FACTOR:.0f} u")
    axes.axhline(0.0, color=COLOURS["line"], linewidth=0.7)
    axes.set(xlabel="position / mm", ylabel=f"error (actual − nominal) / {name}")
    scale.limit(axes, factor, "m")
    axes.legend()
    return axes


def _parts(obj: Any, ax: Axes | None, scale: _Scale) -> Any:
    from metrosep.plot.maps import separation_maps
    from metrosep.plot.summary import parts_plot

    maps = {k: v for k, v in obj.parts.items() if v.ndim >= 2}
    if maps:
        _refuse_axes(ax, "maps of a separation")
        dx, dy = (obj.audit.get(k) for k in ("dx_m", "dy_m"))
        unit = obj.units[next(iter(maps))]
        base = scale.base({k: obj.units[k] for k in maps}, "draw the maps of .parts")
        limits = None
        if scale.low is not None or scale.high is not None:
            largest = max(float(np.nanmax(np.abs(v), initial=0.0)) for v in maps.values())
            limits = scale.ends(-largest, largest, base)
        return separation_maps(maps, dx=dx, dy=dy, unit=unit, shown_in=scale.unit, limits=limits)
    base = scale.base({k: obj.units[k] for k in obj.parts}, "draw the curves of .parts")
    drawn: Any = parts_plot(obj, ax, unit=scale.unit)
    for axes in (drawn.axes if ax is None else [drawn]) if scale.stated else ():
        scale.limit_drawn(axes, axes.get_ylabel(), base)
    return drawn


def _table(obj: Any, ax: Axes | None, scale: _Scale) -> Any:
    from metrosep.plot.summary import table_plot

    axes = table_plot({"table": obj.to_dict()}, ax, unit=scale.unit)
    scale.limit_drawn(axes, axes.get_ylabel(), "rad" if is_rotary(obj.compensates) else "m")
    return axes


def _of_map(obj: Any, ax: Axes | None, scale: _Scale) -> Axes:
    axes = axes_or_new(ax, size=(5.2, 4.2))
    values = np.asarray(obj.values)
    largest = float(np.nanmax(np.abs(values), initial=0.0))
    name, factor = scale.of(largest, "m")
    low, high = scale.ends(-largest, largest, "m")
    image = axes.pcolormesh(
        obj.x * 1e3, obj.y * 1e3, values / factor, cmap="RdBu_r", vmin=low / factor,
        vmax=high / factor, shading="nearest",
    )  # fmt: skip
    axes.figure.colorbar(image, ax=axes).set_label(f"correction of {obj.compensates} / {name}")
    axes.set(xlabel=f"{obj.axes[0]} / mm", ylabel=f"{obj.axes[1]} / mm")
    return axes


def _parameters(obj: Any, ax: Axes | None, scale: _Scale) -> Axes:
    """Draw the lengths of a table as bars with ± 2 u; others have another unit and are left out."""
    axes = axes_or_new(ax)
    shown = [(s, q) for s, q in obj.items() if q.unit == "m" and np.isfinite(q.value)]
    if not shown:
        raise DataError("this table holds no lengths to draw; use to_frame")
    name, factor = scale.of(max(abs(q.value) for _, q in shown), "m")
    heights = [q.value / factor for _, q in shown]
    spread = [0.0 if q.u is None else BAND_FACTOR * q.u / factor for _, q in shown]
    places = np.arange(len(shown))
    axes.bar(places, heights, yerr=spread if any(spread) else None, color=COLOURS["estimate"])
    axes.set_xticks(places, [s for s, _ in shown], rotation=45 if len(shown) > 8 else 0)
    axes.set_ylabel(f"value / {name}")
    scale.limit(axes, factor, "m")
    return axes


def _fit(obj: Any, ax: Axes | None, scale: _Scale) -> Any:
    kind = type(obj.residual).__name__
    if kind == "Surface":
        return _surface(
            obj.residual, ax, scale, signed=True, title=f"residual of the {obj.form.name}"
        )
    if kind == "Profile":
        return _profile(obj.residual, ax, scale)
    raise DataError("the residual of this fit is a set of points; use .residual")


def _deviation(obj: Any, ax: Axes | None, scale: _Scale) -> Any:
    if type(obj.residual).__name__ == "Surface":
        return _surface(obj.residual, ax, scale, signed=True, title=f"deviation, {obj.kind}")
    return _profile(obj.residual, ax, scale)


def _positioning(obj: Any, ax: Axes | None, scale: _Scale) -> Axes:
    from metrosep.plot.charts import positioning_chart

    scale.refuse("the picture of a positioning test shows both directions, and")
    return positioning_chart(obj, ax)


def _sensitivity(obj: Any, ax: Axes | None, scale: _Scale) -> Any:
    from metrosep.plot.sensitivity_chart import sensitivity_bars

    axes = sensitivity_bars(obj, ax, unit=scale.unit)
    if scale.low is not None or scale.high is not None:
        factor = _factor_of(axes.get_xlabel())
        low, high = axes.get_xlim()
        a, b = scale.ends(low * factor, high * factor, "m")
        if not a > 0.0:
            raise DataError(
                f"vmin = {a:.6g} must be above zero: the bars have a logarithmic scale"
            )
        axes.set_xlim(a / factor, b / factor)
    return axes


def _wavefront(obj: Any, ax: Axes | None, scale: _Scale) -> Any:
    from metrosep.plot.wavefront_chart import wavefront_map

    largest = float(np.nanmax(np.abs(obj.opd), initial=0.0))
    low, high = scale.ends(-largest, largest, "m")
    axes = wavefront_map(obj, ax=ax, unit=scale.unit)
    if scale.low is not None or scale.high is not None:
        mesh: Any = axes.collections[-1]
        factor = _factor_of(mesh.colorbar.ax.get_ylabel())
        mesh.set_clim(low / factor, high / factor)
    return axes


def _spiral(obj: Any, ax: Axes | None, scale: _Scale) -> Axes:
    """Draw the points of a program as the part is seen from above, and its rim."""
    scale.refuse("the picture of a path shows places x and y in mm, and")
    axes = axes_or_new(ax, size=(4.6, 4.4))
    rows = obj.to_frame()
    axes.plot(
        rows["x_mm"], rows["y_mm"], ".", color=COLOURS["estimate"], markersize=1.5,
        rasterized=len(rows) > _SIDE**2 // 8,
    )  # fmt: skip
    around = np.linspace(0.0, 2.0 * np.pi, 361)
    rim = obj.radius * 1e3
    axes.plot(rim * np.cos(around), rim * np.sin(around), color=COLOURS["line"], linewidth=0.7)
    axes.set(xlabel="x / mm", ylabel="y / mm", aspect="equal")
    return axes


def _setting(obj: Any, ax: Axes | None, scale: _Scale) -> Axes:
    """Draw the factors of a tool setting as bars with ± 2 u."""
    axes = axes_or_new(ax)
    names = ("dx", "dy", "dR")
    held = np.array([getattr(obj, n) for n in names])
    u = np.array([getattr(obj, f"u_{n}") or 0.0 for n in names])
    spread = BAND_FACTOR * np.where(np.isfinite(u), u, 0.0)
    name, factor = scale.of(float((np.abs(held) + spread).max()), "m")
    axes.bar(range(3), held / factor, yerr=spread / factor, color=COLOURS["estimate"])
    axes.axhline(0.0, color=COLOURS["line"], linewidth=0.7)
    axes.set_xticks(range(3), list(names))
    axes.set_ylabel(f"error of the setting ± {BAND_FACTOR:.0f} u / {name}")
    scale.limit(axes, factor, "m")
    return axes


def _batch(obj: Any, ax: Axes | None, scale: _Scale) -> Axes:
    """Draw how many units have which status."""
    scale.refuse("the picture of a batch counts units by status, and")
    axes = axes_or_new(ax)
    outside = ("total", "skipped")
    counts = {k: n for k, n in obj.counts.items() if n and k not in outside}
    if not counts:
        raise DataError("this batch has no units: nothing to draw")
    axes.barh([*counts][::-1], [*counts.values()][::-1], color=COLOURS["estimate"])
    axes.set(xlabel="units / 1", ylabel="status / 1", title=obj.summary())
    return axes


def _result(obj: Any, ax: Axes | None, scale: _Scale) -> Any:
    """Draw the figure of the first page of a report."""
    scale.refuse("the picture of a result is that of the first page of its report, and")
    from metrosep.plot.summary import charts_of, drawable

    document = getattr(obj, "document", obj)
    found = drawable(document)
    maps = [f"chart_{i}" for i, c in enumerate(charts_of(document), 1) if c.get("kind") == "maps"]
    name = next((n for n in ("before_after", *maps[-1:], *found) if n in found), None)
    if name is None:
        raise DataError("this result holds nothing to draw")
    if "ax" in signature(found[name]).parameters:
        return found[name](document, ax)
    _refuse_axes(ax, "the picture of this result")
    return found[name](document)


def _refuse_axes(ax: Axes | None, what: str) -> None:
    """Refuse axes for a picture that is a figure of its own."""
    if ax is not None:
        raise OptionError(f"{what} has panels of its own; call plot without ax")


_PICTURES: Mapping[str, Callable[..., Any]] = {
    "Surface": _surface,
    "Profile": _profile,
    "Recording": _recording,
    "Run": _runs,
    "RunSet": _runs,
    "ErrorEstimate": _estimate,
    "Separation": _parts,
    "CompensationTable": _table,
    "CompensationMap": _of_map,
    "ParameterTable": _parameters,
    "FitResult": _fit,
    "FormDeviation": _deviation,
    "PositioningTest": _positioning,
    "SensitivityTable": _sensitivity,
    "Wavefront": _wavefront,
    "SpiralPath": _spiral,
    "ToolSetting": _setting,
    "BatchReport": _batch,
    "Result": _result,
}
