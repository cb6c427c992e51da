"""Chart specifications of a result document: plain values from which a report draws.

Long curves keep the smallest and largest value of each cell, maps the mean of each block of pixels, or the
pixel of it that stands out; a chart says what was left out. Values are SI, rounded to 6 digits: a chart is not a source of numbers.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from metrosep.core._arrays import FloatArray
from metrosep.core.readable import value_text

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


# ---- maps: limits from the data, and fewer pixels without losing one that stands out ---------------

_SHARE, _CLIP = 0.001, 2.0
"""Share of heights at each end that a scale leaves out, where the range is larger than so many times the rest."""
_OUTSTANDING = 6.0
"""Robust standard deviations beyond which one pixel is drawn in place of the mean of its block."""


def display_limits(values: FloatArray) -> tuple[float, float, int, int]:
    """Return lower and upper limit of a scale, and how many values lie below and above; NaN without values.

    Minimum and maximum, or the 0.1 % and 99.9 % quantiles where the range is more than twice theirs.

    Examples
    --------
    >>> display_limits(np.array([0.0, 1.0, 2.0])), display_limits(np.r_[np.arange(5000.0), 1e6])[2:]
    ((0.0, 2.0, 0, 0), (5, 5))
    """
    known = values[np.isfinite(values)]
    if known.size == 0:
        return math.nan, math.nan, 0, 0
    low, high = float(known.min()), float(known.max())
    q_low, q_high = _ends(known)
    if high - low <= _CLIP * (q_high - q_low) or q_high <= q_low:
        return low, high, 0, 0
    return q_low, q_high, int((known < q_low).sum()), int((known > q_high).sum())


def _ends(known: FloatArray) -> tuple[float, float]:
    """Return the quantiles at both ends, by partial sorting and linear interpolation."""
    place = _SHARE * (known.size - 1)
    i = int(place)
    last = known.size - 1
    at = sorted({i, min(i + 1, last), max(last - i - 1, 0), last - i})
    parted = np.partition(known, at)
    f = place - i
    low = (1.0 - f) * parted[i] + f * parted[min(i + 1, last)]
    high = (1.0 - f) * parted[last - i] + f * parted[max(last - i - 1, 0)]
    return float(low), float(high)


def decimated(z: FloatArray, k: int) -> FloatArray:
    """Return one value for each block of k x k pixels: the mean of the valid ones, or the pixel that stands out.

    Block mean m, farthest pixel e, s = 1.4826 median |r - median r| of all residuals r = z - m: e is
    drawn where |e - m| > 6 s; NaN where fewer than half of the pixels are valid and none stands out.

    Examples
    --------
    >>> z = np.zeros((4, 4)); z[2, 1] = 9.0
    >>> decimated(z, 2).tolist()
    [[0.0, 0.0], [9.0, 0.0]]
    """
    if k <= 1:
        return z
    n_y, n_x = z.shape
    rows, columns = -(-n_y // k), -(-n_x // k)
    padded = np.full((rows * k, columns * k), np.nan)
    padded[:n_y, :n_x] = z
    # blocks along the last axis: (rows, columns, k * k)
    blocks = padded.reshape(rows, k, columns, k).swapaxes(1, 2).reshape(rows, columns, k * k)
    valid = np.isfinite(blocks)
    n = valid.sum(axis=2)
    with np.errstate(invalid="ignore", divide="ignore"):
        mean = np.where(valid, blocks, 0.0).sum(axis=2) / n
    away = np.where(valid, blocks - mean[..., None], 0.0)
    far = np.abs(away).argmax(axis=2)[..., None]
    extreme = np.take_along_axis(blocks, far, axis=2)[..., 0]
    largest = np.abs(np.take_along_axis(away, far, axis=2)[..., 0])
    rest = away[valid]
    middle = float(np.median(rest)) if rest.size else 0.0
    s = 1.4826 * float(np.median(np.abs(rest - middle))) if rest.size else 0.0
    stands_out = (largest > _OUTSTANDING * s) & (n > 0)
    # pixels of a block that the map has: fewer at its rim
    whole = np.outer(_lengths(n_y, k), _lengths(n_x, k))
    few = 2 * n < whole
    made: FloatArray = np.where(stands_out, extreme, np.where(few, np.nan, mean))
    return made


def _lengths(n: int, k: int) -> NDArray[np.intp]:
    """Return how many of n pixels each block of k holds."""
    edges = np.minimum(np.arange(0, n + k, k), n)
    return np.diff(edges[: -(-n // k) + 1])


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


def panel(
    title: str, unit: str, curves: Sequence[Mapping[str, Any]], *, quantity: str = ""
) -> dict[str, Any]:
    """Return one panel of a chart; the quantity stands at its axis before the unit."""
    named = {"quantity": quantity} if quantity else {}
    return {"title": title, "unit": unit, "curves": list(curves), **named}


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
    measured: bool = False,
    magnitude: bool = False,
    quantity: str = "value",
    side: int | None = None,
) -> dict[str, Any]:
    """Return a chart of maps on one colour scale; `measured`: zero has no meaning, so the mean is subtracted.

    `magnitude`: values have no sign, so the scale is not symmetric about zero.
    """
    signed = not (measured or magnitude)
    side = side or min(_LARGEST_SIDE, int(math.sqrt(_MOST_PIXELS / max(len(maps), 1))))
    step = max((-(-max(m.shape[:2]) // side) for m in maps.values()), default=1)
    whole = {name: np.asarray(m, dtype=np.float64) for name, m in maps.items()}
    known = [m[np.isfinite(m)] for m in whole.values()]
    every = known[0] if len(known) == 1 else np.concatenate([np.empty(0), *known])
    mean = float(every.mean()) if measured and every.size else 0.0
    low, high, below, above = display_limits(every - mean)
    words = caption
    dust = 64 * np.finfo(np.float64).eps * np.abs(every).max(initial=0.0)  # of a pairwise sum
    if measured and abs(mean) > dust:
        words += f" Mean {value_text(mean, unit)} subtracted."
    if below or above:
        words += f" {below} pixels below, {above} above the scale."
    if step > 1:
        words += f" Drawn at 1/{step} of the resolution, pixels that stand out kept; P-V is of all pixels."
    if signed and every.size:  # a sign is seen at once: symmetric about zero
        high = max(abs(low), abs(high))
        low = -high
    return {
        "kind": "maps",
        "title": title,
        "caption": words.strip(),
        "parts": {name: plain(_fewer(m - mean, step), digits=4) for name, m in whole.items()},
        "dx_m": None if dx is None else dx * step,
        "dy_m": None if dy is None else dy * step,
        "origin_m": _first(origin, dx, dy, step),
        "step": step,
        "unit": unit,
        "quantity": quantity,
        "pv": {**_whole_pv(maps), **{k: plain(v) for k, v in (pv or {}).items()}},
        "limits": [plain(low), plain(high)] if every.size else None,
        "outside": [below, above],
        "signed": signed,
    }


def _fewer(z: FloatArray, step: int) -> FloatArray:
    return decimated(z, step) if z.ndim == 2 else z[::step, ::step]


def _first(
    origin: tuple[float, float], dx: float | None, dy: float | None, step: int
) -> list[float]:
    """Return the middle of the first block of pixels."""
    steps = (dx or 0.0, dy or 0.0)
    return [float(v) + 0.5 * (step - 1) * d for v, d in zip(origin, steps, strict=True)]


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
    """Return a chart of bars, one group for each label."""
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
