"""Chart specifications of a result document: plain values from which a report draws.

Long curves keep the smallest and largest value of each cell, maps every k-th pixel; a chart says
what was left out. Values are SI, rounded to 6 digits: a chart is not a source of numbers.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from metrosep.core._arrays import FloatArray

__all__ = [
    "bar_chart",
    "curve",
    "curve_chart",
    "harmonic_chart",
    "map_chart",
    "panel",
    "plain",
    "thin",
]

_MOST_SAMPLES = 2000
_MOST_PIXELS = 80_000
_LARGEST_SIDE = 256


def plain(values: ArrayLike, *, digits: int = 6) -> Any:
    """Return numbers as nested lists for JSON."""
    array = np.asarray(values, dtype=np.float64)
    return _nested(_rounded(array, digits), np.isfinite(array))


def _nested(values: FloatArray, known: NDArray[np.bool_]) -> Any:
    if known.all():
        return values.tolist()
    if values.ndim > 1:
        return [_nested(v, k) for v, k in zip(values, known, strict=True)]
    found = values.astype(object)
    found[~known] = None
    return found.tolist()


_POWERS = np.array([float(f"1e{k}") for k in range(23)])
"""Exact: a whole number over one of them is the nearest float to that decimal number."""


def _rounded(array: FloatArray, digits: int) -> FloatArray:
    """Return values at so many significant digits; all at once, since maps have many."""
    size = np.abs(array)
    usual = (size > 0.0) & np.isfinite(size)
    decimals = np.zeros(array.shape)
    np.log10(size, out=decimals, where=usual)
    decimals = digits - 1 - np.floor(decimals)
    usual &= (decimals >= 0) & (decimals < _POWERS.size)
    power = _POWERS[np.where(usual, decimals, 0).astype(np.intp)]
    rounded = np.where(usual, np.rint(np.where(usual, array, 0.0) * power) / power, array)
    other = ~usual & (size > 0.0) & np.isfinite(array)
    rounded[other] = [float(f"{v:.{digits}g}") for v in array[other].tolist()]
    return rounded


def thin(x: FloatArray, curves: FloatArray, *, most: int = _MOST_SAMPLES) -> NDArray[np.intp]:
    """Return which samples to keep, so that no extreme of any curve is hidden."""
    if x.size <= most:
        return np.arange(x.size)
    keep: set[int] = {0, x.size - 1}
    for cell in np.array_split(np.arange(x.size), max(most // (2 * len(curves)), 1)):
        for values in curves[:, cell]:
            if np.isnan(values).any():
                keep.add(int(cell[int(np.argmax(np.isnan(values)))]))
            if not np.isnan(values).all():
                keep.add(int(cell[int(np.nanargmin(values))]))
                keep.add(int(cell[int(np.nanargmax(values))]))
    return np.array(sorted(keep))


def curve(
    label: str, x: ArrayLike, y: ArrayLike, *, u: ArrayLike | None = None, points: bool = False
) -> dict[str, Any]:
    """Return one curve of a panel."""
    positions, values = (np.asarray(v, dtype=np.float64) for v in (x, y))
    index = thin(positions, values[None, :])
    spread = None if u is None else np.asarray(u, dtype=np.float64)
    known = spread is not None and bool(np.isfinite(spread).any())
    return {
        "label": label,
        "x": plain(positions[index], digits=9),
        "y": plain(values[index]),
        "u": plain(spread[index]) if known and spread is not None else None,
        "points": points,
        "n": int(positions.size),
    }


def panel(title: str, unit: str, curves: Sequence[Mapping[str, Any]]) -> dict[str, Any]:
    """Return one panel of a chart."""
    return {"title": title, "unit": unit, "curves": list(curves)}


def curve_chart(
    title: str, x: tuple[str, str], panels: Sequence[Mapping[str, Any]], *, caption: str = ""
) -> dict[str, Any]:
    """Return a chart of curves, one panel above the other."""
    longest = max((c["n"] for p in panels for c in p["curves"]), default=0)
    words = caption
    if longest > _MOST_SAMPLES:
        words += (
            f" Of {longest} samples the smallest and largest of each cell are drawn: no extreme is "
            "hidden."
        )
    return {
        "kind": "curves",
        "title": title,
        "caption": words.strip(),
        "x": {"name": x[0], "unit": x[1]},
        "panels": list(panels),
    }


def harmonic_chart(
    title: str,
    k: ArrayLike,
    amplitude: ArrayLike,
    *,
    u: ArrayLike | None,
    suppressed: Sequence[int],
    unit: str,
    caption: str = "",
    k_name: str = "undulations per revolution k",
) -> dict[str, Any]:
    """Return a chart of amplitudes over undulations per revolution."""
    orders = np.asarray(k, dtype=np.intp)
    return {
        "kind": "harmonics",
        "title": title,
        "caption": caption,
        "k": orders.tolist(),
        "k_name": k_name,
        "amplitude": plain(amplitude),
        "u": None if u is None else plain(u),
        "suppressed": [int(i) for i in suppressed if i in orders],
        "unit": unit,
    }


def map_chart(
    title: str,
    maps: Mapping[str, FloatArray],
    *,
    dx: float | None,
    dy: float | None,
    unit: str,
    caption: str = "",
    origin: tuple[float, float] = (0.0, 0.0),
    pv: Mapping[str, float] | None = None,
) -> dict[str, Any]:
    """Return a chart of maps on one colour scale."""
    side = min(_LARGEST_SIDE, int(math.sqrt(_MOST_PIXELS / max(len(maps), 1))))
    step = max((-(-max(m.shape) // side) for m in maps.values()), default=1)
    words = caption
    if step > 1:
        words += f" Every pixel in {step} along x and y is drawn; P-V is that of all."
    return {
        "kind": "maps",
        "title": title,
        "caption": words.strip(),
        "parts": {name: plain(m[::step, ::step], digits=4) for name, m in maps.items()},
        "dx_m": None if dx is None else dx * step,
        "dy_m": None if dy is None else dy * step,
        "origin_m": [float(v) for v in origin],
        "step": step,
        "unit": unit,
        "pv": {**_whole_pv(maps), **{k: plain(v) for k, v in (pv or {}).items()}},
    }


def _whole_pv(maps: Mapping[str, FloatArray]) -> dict[str, float | None]:
    """Return the P-V of each map before it is thinned out; None where nothing is known."""
    found: dict[str, float | None] = {}
    for name, values in maps.items():
        array = np.asarray(values, dtype=np.float64)
        known = array[np.isfinite(array)]
        if array.ndim == 2:
            found[name] = plain(np.ptp(known)) if known.size else None
    return found


# ---- charts of bars in a result document: rankings, budgets, coefficients ----------------------


def bar_chart(
    title: str,
    labels: Sequence[str],
    series: Mapping[str, ArrayLike],
    *,
    unit: str,
    quantity: str,
    u: Mapping[str, ArrayLike] | None = None,
    stacked: bool = False,
    log: bool = False,
    caption: str = "",
) -> dict[str, Any]:
    """Return a chart of bars, one group for each label.

    Parameters
    ----------
    title : str
        Of the figure.
    labels : sequence of str
        Below the bars.
    series : mapping of str to array_like, shape (n_labels,)
        Values by name, SI; NaN draws nothing.
    unit : str
        SI unit; ``"1"`` for shares.
    quantity : str
        What the bars show.
    u : mapping of str to array_like, optional
        Standard uncertainty of each series.
    stacked : bool, optional
        One series on the other; else beside one another.
    log : bool, optional
        Whether the scale is logarithmic.
    caption : str, optional
        What it shows.

    Returns
    -------
    dict
        Of kind ``bars``.

    Raises
    ------
    ValueError
        If a series is not as long as the labels.
    """
    for name, values in {**series, **(u or {})}.items():
        if len(list(plain(values))) != len(labels):
            raise ValueError(f"{name} has not one value for each of the {len(labels)} labels")
    return {
        "kind": "bars",
        "title": title,
        "caption": caption,
        "labels": [str(v) for v in labels],
        "series": {name: plain(values) for name, values in series.items()},
        "u": {name: plain(values) for name, values in (u or {}).items()},
        "unit": unit,
        "quantity": quantity,
        "stacked": stacked,
        "log": log,
    }
