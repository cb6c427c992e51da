"""Public objects as tables (pandas) and as labelled arrays (xarray), each kind in one function.

Column names end in their units as a person reads them (mm, nm); labelled arrays are in SI.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any

import numpy as np

from metrosep.core._arrays import FloatArray
from metrosep.core.errors import DataError, UnsupportedFeatureError
from metrosep.core.profile import Profile
from metrosep.core.quantity import Quantity
from metrosep.core.recording import Recording
from metrosep.core.runset import Run, RunSet
from metrosep.core.surface import Surface

_MM, _NM = 1e3, 1e9


def to_frame(obj: Any) -> Any:
    """Return a data frame in long form."""
    import pandas as pd

    make = _of(obj, _FRAMES)
    if make is None:
        raise DataError(f"{type(obj).__name__} is not a table; there is no to_frame of it")
    return pd.DataFrame(make(obj))


def to_xarray(obj: Any) -> Any:
    """Return a DataArray or a Dataset in SI."""
    try:
        import xarray as xr
    except ImportError:
        raise UnsupportedFeatureError(
            'to_xarray needs xarray, which is not installed; install it: pip install "metrosep[xarray]"'
        ) from None
    make = _of(obj, _LABELLED)
    if make is None:
        raise DataError(f"{type(obj).__name__} has no axes for xarray; use to_frame or its fields")
    return make(xr, obj)


def _of(obj: Any, table: Mapping[str, Callable[..., Any]]) -> Callable[..., Any] | None:
    """Return the function for the class of an object, or of one of its bases."""
    return next((table[c.__name__] for c in type(obj).__mro__ if c.__name__ in table), None)


def _axes(surface: Surface) -> tuple[Any, Any, str]:
    """Return x and y and their unit: m, or pixels where a step is not known."""
    n_y, n_x = surface.shape
    if surface.dx is None or surface.dy is None:
        return np.arange(n_x, dtype=float), np.arange(n_y, dtype=float), "pixel"
    x0, y0 = surface.origin
    return x0 + surface.dx * np.arange(n_x), y0 + surface.dy * np.arange(n_y), "m"


# ---- tables ---------------------------------------------------------------------------------------


def _surface(s: Surface) -> dict[str, Any]:
    x, y, unit = _axes(s)
    columns, rows = np.meshgrid(x, y)
    name, factor = ("mm", _MM) if unit == "m" else ("pixel", 1.0)
    return {f"x_{name}": columns.ravel() * factor, f"y_{name}": rows.ravel() * factor,
            "z_nm": s.z.ravel() * _NM}  # fmt: skip


def _recording(r: Recording) -> dict[str, Any]:
    names = {k: f"{k}_{r.units[k]}" if k in r.units else k for k in r.channels}
    return {"t_s": r.t, **{names[k]: v for k, v in r.channels.items()}}


def _run(run: Run) -> dict[str, Any]:
    n = run.x.size
    feed = np.nan if run.feed is None else run.feed * 6e4
    t = np.full(n, np.nan) if run.t is None else run.t
    way = "forward" if run.direction > 0 else "reverse"
    return {"run": [run.run_id] * n, "direction": [way] * n, "feed_mm_min": np.full(n, feed),
            "t_s": t, "x_mm": run.x * _MM, "z_nm": run.z * _NM}  # fmt: skip


def _joined(parts: list[dict[str, Any]]) -> dict[str, Any]:
    keys = parts[0] if parts else {}
    return {k: np.concatenate([np.asarray(p[k]) for p in parts]) for k in keys}


def _runs(runs: RunSet) -> dict[str, Any]:
    return _joined([_run(r) for r in runs])


def _quantity(q: Quantity) -> dict[str, Any]:
    u = np.nan if q.u is None else q.u
    return {"symbol": [q.symbol], "value": [q.value], "u": [u], "unit": [q.unit],
            "definition": [q.definition]}  # fmt: skip


_POINTS = 601
_WAYS = {1: "forward", -1: "reverse"}


def _curves(e: Any) -> tuple[FloatArray, list[tuple[str, FloatArray, FloatArray]]]:
    x = np.linspace(e.start, e.stop, _POINTS)
    return x, [(_WAYS[d], e.evaluate(x, direction=d), e.sd(x, direction=d)) for d in e.directions]


def _estimate(e: Any) -> dict[str, Any]:
    x, curves = _curves(e)
    return _joined(
        [
            {"x_mm": x * _MM, "error_nm": v * _NM, "u_nm": u * _NM, "direction": [way] * x.size}
            for way, v, u in curves
        ]
    )


def _table(t: Any) -> dict[str, Any]:
    place = ("deg", 180.0 / np.pi) if _turns(t.axis) else ("mm", _MM)
    amount = ("urad", 1e6) if _turns(t.compensates) else ("nm", _NM)
    reverse = t.forward if t.reverse is None else t.reverse
    return {f"position_{place[0]}": t.positions * place[1],
            f"forward_{amount[0]}": t.forward * amount[1],
            f"reverse_{amount[0]}": reverse * amount[1]}  # fmt: skip


def _turns(axis: str) -> bool:
    from metrosep.compensation.area_errors import is_rotary

    return is_rotary(axis)


def _map(m: Any) -> dict[str, Any]:
    columns, rows = np.meshgrid(m.x, m.y)
    return {"x_mm": columns.ravel() * _MM, "y_mm": rows.ravel() * _MM,
            "correction_nm": np.asarray(m.values).ravel() * _NM}  # fmt: skip


def _wavefront(w: Any) -> dict[str, Any]:
    return {"x_mm": np.ravel(w.x) * _MM, "y_mm": np.ravel(w.y) * _MM, "opd_nm": np.ravel(w.opd) * _NM,
            "weight": np.ravel(w.weights)}  # fmt: skip


def _fields(obj: Any) -> dict[str, Any]:
    """Return the numbers and texts of a small object as one row a field."""
    from metrosep.core.public import state_of

    held = [(k, v) for k, v in state_of(obj) if isinstance(v, int | float | str | Quantity)]
    known = [
        (k, v.value, v.u, v.unit) if isinstance(v, Quantity) else (k, v, None, "") for k, v in held
    ]
    names = ("field", "value", "u", "unit")
    return {n: [row[i] for row in known] for i, n in enumerate(names)}


def _points(path: Any) -> dict[str, Any]:
    """Return the arrays of an object that are as long as its longest one."""
    from metrosep.core.public import state_of

    arrays = {k: v for k, v in state_of(path) if isinstance(v, np.ndarray) and v.ndim == 1}
    longest = max((v.size for v in arrays.values()), default=0)
    found = {k: v for k, v in arrays.items() if v.size == longest}
    return found or _fields(path)


def _spiral(path: Any) -> dict[str, Any]:
    """Return the points of a spiral program, lead-in first, without a form."""
    u, _ = path.stations()
    theta = 2.0 * np.pi * path.turns - u
    rho, azimuth = u * (path.feed / (2.0 * np.pi)), path.azimuth_of(theta)
    return {"theta_deg": np.degrees(theta), "rho_mm": rho * _MM, "x_mm": rho * np.cos(azimuth) * _MM,
            "y_mm": rho * np.sin(azimuth) * _MM}  # fmt: skip


def _result(r: Any) -> list[dict[str, Any]]:
    keys = ("name", "metric", "value", "unit", "u", "U", "k", "lower", "upper", "verdict")
    return [{k: c.get(k) for k in keys} for c in r.document.get("characteristics") or []]


def _batch(report: Any) -> list[dict[str, Any]]:
    return [{"unit": row["unit"], "status": row["status"], **{c["name"]: c["value"] for c in row["characteristics"]}}
            for row in report.rows]  # fmt: skip


_FRAMES: Mapping[str, Callable[[Any], Any]] = {
    "Surface": _surface,
    "Profile": lambda p: {"x_mm": p.x * _MM, "z_nm": p.z * _NM},
    "Recording": _recording,
    "Run": _run,
    "RunSet": _runs,
    "Quantity": _quantity,
    "ErrorEstimate": _estimate,
    "CompensationTable": _table,
    "CompensationMap": _map,
    "FormDeviation": lambda d: d.table.to_frame(),
    "Wavefront": _wavefront,
    "SpiralPath": _spiral,
    "ToolSetting": _fields,
    "Result": _result,
    "BatchReport": _batch,
}


# ---- labelled arrays --------------------------------------------------------------------------------


def _labelled_surface(xr: Any, s: Surface) -> Any:
    x, y, unit = _axes(s)
    coordinates = {"y": ("y", y, {"units": unit}), "x": ("x", x, {"units": unit})}
    return xr.DataArray(s.z, coordinates, ("y", "x"), name="z", attrs={"units": "m"})


def _labelled_profile(xr: Any, p: Profile) -> Any:
    return xr.DataArray(
        p.z, {"x": ("x", p.x, {"units": "m"})}, ("x",), name="z", attrs={"units": "m"}
    )


def _labelled_recording(xr: Any, r: Recording) -> Any:
    data = {k: ("t", v, {"units": r.units.get(k, "")}) for k, v in r.channels.items()}
    return xr.Dataset(data, {"t": ("t", r.t, {"units": "s"})})


def _labelled_runs(xr: Any, runs: Any) -> Any:
    several = [runs] if isinstance(runs, Run) else [*runs]
    columns = _joined(
        [{"run": np.full(r.x.size, i), "x": r.x, "z": r.z} for i, r in enumerate(several)]
    )
    names = [r.run_id for r in several]
    return xr.Dataset(
        {"x": ("sample", columns["x"], {"units": "m"}), "z": ("sample", columns["z"], {"units": "m"}),
         "run": ("sample", columns["run"])},
        attrs={"runs": names},
    )  # fmt: skip


def _labelled_estimate(xr: Any, e: Any) -> Any:
    x, curves = _curves(e)
    stacked = [np.stack([c[i] for c in curves]) for i in (1, 2)]
    place = ("direction", "x")
    return xr.Dataset(
        {"error": (place, stacked[0], {"units": "m"}), "u": (place, stacked[1], {"units": "m"})},
        {"direction": [c[0] for c in curves], "x": ("x", x, {"units": "m"})},
    )


def _labelled_separation(xr: Any, s: Any) -> Any:
    data: dict[str, Any] = {}
    for part, values in s.parts.items():
        axes = next((k for k, v in s.coordinates.items() if v.shape == values.shape), None)
        places = (
            (axes,)
            if axes and values.ndim == 1
            else tuple(f"{part}_{i}" for i in range(values.ndim))
        )
        data[part] = (places, values, {"units": s.units[part]})
        data[f"u_{part}"] = (places, s.u[part], {"units": s.units[part]})
    used = {p for places, *_ in data.values() for p in places}
    return xr.Dataset(
        data, {k: (k, v) for k, v in s.coordinates.items() if k in used and v.ndim == 1}
    )


def _labelled_table(xr: Any, t: Any) -> Any:
    reverse = t.forward if t.reverse is None else t.reverse
    amount = {"units": "rad" if _turns(t.compensates) else "m"}
    data = {"forward": ("position", t.forward, amount), "reverse": ("position", reverse, amount)}
    place = {"units": "rad" if _turns(t.axis) else "m"}
    return xr.Dataset(data, {"position": ("position", t.positions, place)})


def _labelled_map(xr: Any, m: Any) -> Any:
    coordinates = {"y": ("y", m.y, {"units": "m"}), "x": ("x", m.x, {"units": "m"})}
    return xr.DataArray(m.values, coordinates, ("y", "x"), name="correction", attrs={"units": "m"})


def _labelled_wavefront(xr: Any, w: Any) -> Any:
    places = ("y", "x") if np.ndim(w.opd) == 2 else ("point",)
    data: dict[str, Any] = {"opd": (places, np.asarray(w.opd), {"units": "m"})}
    data |= {f"{k}_m": (places, np.asarray(getattr(w, k))) for k in "xy"}
    return xr.Dataset(data)


def _labelled_fit(xr: Any, fit: Any) -> Any:
    return to_xarray(fit.residual)


_LABELLED: Mapping[str, Callable[[Any, Any], Any]] = {
    "Surface": _labelled_surface,
    "Profile": _labelled_profile,
    "Recording": _labelled_recording,
    "Run": _labelled_runs,
    "RunSet": _labelled_runs,
    "ErrorEstimate": _labelled_estimate,
    "Separation": _labelled_separation,
    "CompensationTable": _labelled_table,
    "CompensationMap": _labelled_map,
    "Wavefront": _labelled_wavefront,
    "FitResult": _labelled_fit,
}
