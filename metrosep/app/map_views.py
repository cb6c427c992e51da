"""`MapView`: the picture of a map in a window, as indices into a table of colours.

The picture is seen from above with x to the right and **y up**: row 0 is the *largest* y, as a
canvas draws it. Screen pixels are square in m. Index 0 is not measured, 1 to 255 are heights from
the low to the high end of the range.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Literal, TypeAlias

import numpy as np
from numpy.typing import NDArray

from metrosep.app.pyramid import MapPyramid, PyramidLevel
from metrosep.core._arrays import ByteArray, FloatArray
from metrosep.core.errors import DataError, MetrosepError, TooFewSamplesError
from metrosep.core.profile import Profile
from metrosep.core.readable import said_value
from metrosep.core.runset import RunSet
from metrosep.core.surface import Surface
from metrosep.separation.runs.base import ErrorEstimate
from metrosep.separation.runs.design import PreparedRun, prepare_runs
from metrosep.separation.runs.evidence import noise_peaks
from metrosep.spectral.autoregressive import fit_autoregressive

if TYPE_CHECKING:
    from metrosep.app.spectrum_views import SpectrumView
    from metrosep.app.view_tables import ProfileView, SectionView

Detail = Literal["drag", "idle", "full"]

_LONGEST_SIDE = {"drag": 512, "idle": 1024, "full": 4096}
"""Most screen pixels along a side at each level of the preview ladder."""

_STEPS = 254
"""Index 1 is the low end of the range, 255 the high end."""

_LIGHT = np.array([-0.5, 0.5, math.sqrt(0.5)])
"""Towards the light: from the upper left of the picture (x, y up), 45 degrees above it."""

_SHADED_SLOPE = 0.5
"""What the RMS slope of the picture is scaled to before it is shaded."""

_FLAT = 128
"""Brightness of a level pixel; 255 faces the light, 1 is turned away."""


@dataclass(frozen=True, slots=True, eq=False)
class MapView:
    """A picture of a map.

    Parameters
    ----------
    index : ndarray of uint8, shape (h, w)
        0 not measured or outside the map; 1 to 255 the height over `range`, clipped at its ends.
        Row 0 is the largest y.
    shade : ndarray of uint8, shape (h, w), or None
        Brightness 1 to 255, 128 where level; 0 where the slope is not known. None unless asked.
    range : tuple of (float, float) or None, m
        Heights of index 1 and 255; None where nothing was measured.
    window : tuple of (float, float, float, float), m
        Outer edges ``(x0, y0, x1, y1)`` of the picture.
    scale : float, m
        Side of a screen pixel.
    level : int
        Level of the pyramid that was drawn; 0 is the map itself.
    is_preview : bool
        Whether pixels of the map were averaged or omitted: not each one is on the screen.
    coverage : float, dimensionless
        Valid share of the pixels of the map in the window; 0 where the window misses the map.
    unit : str
        Of window and scale: ``"m"``, or ``"px"`` for a map without lateral calibration.
    """

    index: ByteArray
    shade: ByteArray | None
    range: tuple[float, float] | None
    window: tuple[float, float, float, float]
    scale: float
    level: int
    is_preview: bool
    coverage: float
    unit: str


def map_view(
    pyramid: MapPyramid,
    *,
    window: Sequence[float] | None = None,
    pixels: Sequence[int] = (512, 512),
    level: Detail = "idle",
    limits: Sequence[float] | None = None,
    shade: bool = False,
) -> MapView:
    """Return the picture of a window.

    Parameters
    ----------
    pyramid : MapPyramid
        Of the map.
    window : sequence of 4 floats, m, optional
        ``(x0, y0, x1, y1)`` to be seen, ``x0 < x1``, ``y0 < y1``; the whole map if omitted. It is
        widened about its centre on one axis so that screen pixels are square.
    pixels : sequence of 2 ints, optional
        Width and height of the canvas, 1 to 16384 each.
    level : {"drag", "idle", "full"}, optional
        The longer side is cut to 512, 1024 or 4096 screen pixels; the canvas stretches the rest.
    limits : sequence of 2 floats, m, optional
        Heights of index 1 and 255; the robust range of the whole map if omitted, so that colours
        stay when the window moves.
    shade : bool, optional
        Also compute the hill-shade.

    Returns
    -------
    MapView
        Index picture with its window, range and scale.

    Raises
    ------
    DataError
        If window, pixels, limits or level are not as above.

    Notes
    -----
    Each screen pixel shows the cell of the nearest pyramid level in which its centre lies; nothing
    is interpolated, so a step stays a step and a gap a gap. Cells with less than half of their
    pixels valid are not measured. The hill-shade is the cosine between the light, from the upper
    left at 45 degrees, and the normal of the surface, whose slopes are scaled to an RMS of 0.5 in
    the picture: it shows shape, not slope in rad.

    Examples
    --------
    >>> import numpy as np
    >>> from metrosep.app.pyramid import build_pyramid
    >>> from metrosep.core.surface import Surface
    >>> pyramid = build_pyramid(Surface([[0.0, 1.0], [np.nan, 2.0]], dx=1e-3, dy=1e-3))
    >>> map_view(pyramid, pixels=(2, 2), limits=(0.0, 2.0)).index.tolist()
    [[0, 255], [1, 128]]
    """
    width, height = _screen(pixels, level)
    box = pyramid.window if window is None else _checked_window(window)
    box, scale = _squared(box, width, height)
    chosen = pyramid.level_for(scale)
    cells = pyramid.levels[chosen]
    rows, columns = _cells_under(box, (height, width), pyramid, cells)
    z = _heights(cells, rows, columns)[::-1]
    heights = _checked_limits(limits) if limits is not None else pyramid.robust_range
    return MapView(
        index=_frozen(_indices(z, heights)),
        shade=_frozen(_shaded(cells, rows, columns)) if shade else None,
        range=heights,
        window=box,
        scale=scale,
        level=chosen,
        is_preview=scale > min(pyramid.step) * (1.0 + 1e-9),
        coverage=_coverage(cells, rows, columns),
        unit=pyramid.unit,
    )


def _screen(pixels: Sequence[int], level: str) -> tuple[int, int]:
    if level not in _LONGEST_SIDE:
        raise DataError(f'level must be "drag", "idle" or "full", got {said_value(level)}')
    sides: list[Any] = list(pixels)
    whole = [isinstance(n, int | np.integer) and not isinstance(n, bool) for n in sides]
    if len(sides) != 2 or not all(whole) or not all(1 <= n <= 16384 for n in sides):
        raise DataError(
            f"pixels must be two whole numbers from 1 to 16384, got {said_value(pixels)}"
        )
    shrink = min(1.0, _LONGEST_SIDE[level] / max(sides))
    width, height = (max(1, round(int(n) * shrink)) for n in sides)
    return width, height


def _numbers(values: Sequence[float], n: int, what: str) -> list[float]:
    try:
        numbers = [float(v) for v in values]
    except (TypeError, ValueError):
        numbers = []
    if len(numbers) != n or not all(math.isfinite(v) for v in numbers):
        raise DataError(f"{what} must be {n} finite numbers in m, got {said_value(values)}")
    return numbers


def _checked_window(window: Sequence[float]) -> tuple[float, float, float, float]:
    x0, y0, x1, y1 = _numbers(window, 4, "window")
    if not (x0 < x1 and y0 < y1):
        raise DataError(
            f"window is (x0, y0, x1, y1) with x0 < x1 and y0 < y1, got {(x0, y0, x1, y1)} m"
        )
    return x0, y0, x1, y1


def _checked_limits(limits: Sequence[float]) -> tuple[float, float]:
    low, high = _numbers(limits, 2, "limits")
    if not (low < high and math.isfinite(high - low)):
        raise DataError(f"limits run from the lower to the higher height, got {low} m to {high} m")
    return low, high


def _squared(
    box: tuple[float, float, float, float], width: int, height: int
) -> tuple[tuple[float, float, float, float], float]:
    """Widen a window about its centre to the shape of the screen."""
    x0, y0, x1, y1 = box
    scale = max((x1 - x0) / width, (y1 - y0) / height)
    x, y, half = (x0 + x1) / 2.0, (y0 + y1) / 2.0, scale / 2.0
    wide = (x - width * half, y - height * half, x + width * half, y + height * half)
    if not (scale > 0.0 and all(math.isfinite(v) for v in (scale, *wide))):
        raise DataError(f"window {box} m is too large or too small to be drawn")
    return wide, scale


def _cells_under(
    box: tuple[float, float, float, float],
    screen: tuple[int, int],
    pyramid: MapPyramid,
    cells: PyramidLevel,
) -> tuple[NDArray[np.intp], NDArray[np.intp]]:
    """Row of cells under each screen row (bottom first) and column; -1 outside the map."""
    found = []
    outline = pyramid.window
    for axis in (0, 1):
        low, high = box[1 - axis], box[3 - axis]
        n, size, step = screen[axis], pyramid.shape[axis], pyramid.step[axis]
        centre = low + (np.arange(n) + 0.5) * ((high - low) / n)
        pixel = np.floor((centre - outline[1 - axis]) / step)
        inside = (pixel >= 0) & (pixel < size)
        cell = np.where(inside, pixel, 0.0).astype(np.intp) // cells.factor[axis]
        found.append(np.where(inside, cell, -1))
    return found[0], found[1]


def _heights(cells: PyramidLevel, rows: NDArray[np.intp], columns: NDArray[np.intp]) -> FloatArray:
    z = cells.shown(np.maximum(rows, 0), np.maximum(columns, 0))
    z[rows < 0, :] = np.nan
    z[:, columns < 0] = np.nan
    return z


def _indices(z: FloatArray, heights: tuple[float, float] | None) -> ByteArray:
    """Return 1 + 254 (z - low) / (high - low), rounded and clipped; 0 for NaN."""
    valid = ~np.isnan(z)
    if heights is None:
        return np.zeros(z.shape, dtype=np.uint8)
    low, high = heights
    part = np.full(z.shape, 0.5)
    if high > low:  # a level map has no range: all of it gets the middle index
        part = np.clip((np.where(valid, z, low) - low) / (high - low), 0.0, 1.0)
    return np.where(valid, np.rint(1.0 + _STEPS * part), 0.0).astype(np.uint8)


def _shaded(cells: PyramidLevel, rows: NDArray[np.intp], columns: NDArray[np.intp]) -> ByteArray:
    """Return the brightness of a picture: that of the cells under it, not of its own pixels.

    Pixels that show one cell twice would have no slope there: a grid that is not on the part.
    """
    inside_y, inside_x = rows[rows >= 0], columns[columns >= 0]
    out = np.zeros((rows.size, columns.size), dtype=np.uint8)
    if inside_y.size == 0 or inside_x.size == 0:
        return out
    first_y, first_x = max(int(inside_y[0]) - 1, 0), max(int(inside_x[0]) - 1, 0)
    last_y = min(int(inside_y[-1]) + 2, cells.y.size)
    last_x = min(int(inside_x[-1]) + 2, cells.x.size)
    z = cells.shown(np.arange(first_y, last_y), np.arange(first_x, last_x))
    lit = _hill_shade(z[::-1])[::-1]
    picked = lit[np.maximum(rows - first_y, 0)][:, np.maximum(columns - first_x, 0)]
    shown = np.outer(rows >= 0, columns >= 0)
    return np.where(shown, picked, 0).astype(np.uint8)[::-1]


def _hill_shade(z: FloatArray) -> ByteArray:
    """Return the brightness of a picture whose row 0 is up; slopes by central differences."""
    slope_x, slope_y = np.full(z.shape, np.nan), np.full(z.shape, np.nan)
    slope_x[:, 1:-1] = (z[:, 2:] - z[:, :-2]) / 2.0
    slope_y[1:-1, :] = (z[:-2, :] - z[2:, :]) / 2.0
    known = ~(np.isnan(slope_x) | np.isnan(slope_y) | np.isnan(z))
    brightness = np.zeros(z.shape, dtype=np.uint8)
    if not known.any():
        return brightness
    sx, sy = slope_x[known], slope_y[known]
    top = max(float(np.abs(sx).max()), float(np.abs(sy).max()))
    if top > 0.0:
        sx, sy = sx / top, sy / top
        gain = _SHADED_SLOPE / math.sqrt(float(np.mean(sx * sx + sy * sy)))
        sx, sy = sx * gain, sy * gain
    cosine = (_LIGHT[2] - _LIGHT[0] * sx - _LIGHT[1] * sy) / np.sqrt(1.0 + sx * sx + sy * sy)
    level = _LIGHT[2]
    lit = np.where(
        cosine > level,
        _FLAT + (255 - _FLAT) * (cosine - level) / (1.0 - level),
        _FLAT * cosine / level,
    )
    brightness[known] = np.clip(np.rint(lit), 1.0, 255.0).astype(np.uint8)
    return brightness


def _coverage(cells: PyramidLevel, rows: NDArray[np.intp], columns: NDArray[np.intp]) -> float:
    """Return the valid share of the pixels in the block of cells that the picture touches."""
    rows, columns = rows[rows >= 0], columns[columns >= 0]
    if rows.size == 0 or columns.size == 0:
        return 0.0
    block = np.s_[rows[0] : rows[-1] + 1, columns[0] : columns[-1] + 1]
    if cells.count is None:
        z = cells.z[block]
        return float(np.count_nonzero(~np.isnan(z)) / z.size)
    n = int(cells.pixels_y[block[0]].sum()) * int(cells.pixels_x[block[1]].sum())
    return float(cells.count[block].sum() / n)


def _frozen(picture: ByteArray) -> ByteArray:
    picture.setflags(write=False)
    return picture


# ---- headers and arrays of the pictures of a map or profile, for the page and for notebooks alike ----

Arrays: TypeAlias = dict[str, NDArray[Any]]
Frame: TypeAlias = tuple[dict[str, Any], Arrays]
"""Header and arrays."""


def lateral_unit(obj: Surface | Profile) -> Literal["m", "px"]:
    """Return the unit of positions and wavelengths.

    Examples
    --------
    >>> lateral_unit(Surface([[0.0, 1e-9]])), lateral_unit(Surface([[0.0]], dx=1e-6, dy=1e-6))
    ('px', 'm')
    """
    if isinstance(obj, Profile):
        return obj.lateral_unit
    return "px" if None in (obj.dx, obj.dy) else "m"


def map_frame(view: MapView, extent: object, *, is_preview: bool = False) -> Frame:
    """Return the picture of a map."""
    header = {
        "range": view.range,
        "window": view.window,
        "scale": view.scale,
        "unit": view.unit,
        "coverage": view.coverage,
        "is_preview": is_preview or view.is_preview,
        "extent": extent,
    }
    shade = {} if view.shade is None else {"shade": view.shade}
    return header, {"index": view.index, **shade}


_RELIEF = (16, 1024)
"""Fewest and most points along a side of a relief."""


def relief_view(
    surface: Surface, *, side: Any = 512
) -> tuple[dict[str, Any], NDArray[np.float32]]:
    """Return heights about their mean, thinned so that no extreme is lost, and where they lie.

    The mean goes before the heights become float32: 50 um of piston would leave steps of 4 pm.
    """
    from metrosep.recipe.describe.charts import decimated, display_limits

    least, most = _RELIEF
    if isinstance(side, bool) or not isinstance(side, int) or not least <= side <= most:
        raise DataError(f"side is a whole number from {least} to {most}, got {said_value(side)}")
    valid = surface.z[~np.isnan(surface.z)]
    if valid.size < 2:
        raise DataError("there is nothing measured to show")
    mean = float(valid.mean())
    k = -(-max(surface.shape) // side)
    z = decimated(surface.z - mean, k)
    low, high, *_ = display_limits(z)
    known = surface.dx is not None and surface.dy is not None
    steps = (surface.dx or 1.0, surface.dy or 1.0) if known else (1.0, 1.0)
    first = surface.origin if known else (0.0, 0.0)
    header = {
        "step": [k * d for d in steps],
        "origin": [o + 0.5 * (k - 1) * d for o, d in zip(first, steps, strict=True)],
        "range": [float(np.nanmin(z)), float(np.nanmax(z))],
        "shown": [low, high],
        "mean": mean,
        "pv": float(np.ptp(valid)),
        "unit": "m" if known else "px",
    }
    return header, np.asarray(z, dtype=np.float32)


def section_frame(view: SectionView, *, is_preview: bool = False) -> Frame:
    """Return a section."""
    header = {
        "length": view.length,
        "pv": view.pv,
        "sq": view.sq,
        "share_valid": view.share_valid,
        "unit": view.unit,
        "heights": [[t, z] for t, z in view.heights.items()],
        "is_preview": is_preview,
    }
    return header, {"distance": view.distance, "low": view.low, "high": view.high}


def profile_arrays(view: ProfileView, before: str = "") -> Arrays:
    """Return the lines of a profile."""
    return {f"{before}x": view.x, f"{before}low": view.low, f"{before}high": view.high}


def spectrum_frame(
    view: SpectrumView, *, unit: Literal["m", "px"] = "m", is_preview: bool = False
) -> Frame:
    """Return amplitude against wavelength."""
    header = {
        "inside": view.inside,
        "outside": view.outside,
        "messages": list(view.messages),
        "unit": unit,
        "is_preview": is_preview,
    }
    arrays: Arrays = {
        "wavelength": view.wavelength,
        "amplitude": view.amplitude,
        "in_band": view.in_band,
    }
    return header, arrays


# ---- vibrations in repeated runs: a process in time, whose wavelength slides with the feedrate ----
# Geometry keeps its wavelength when the feedrate v changes; a vibration of frequency f keeps f, and
# lies at the wavelength v/f. A vibration is one that shows at the same frequency at every feedrate.

_ABOVE = 8.0
"""At every feedrate the density at a vibration stands this much above the median around it."""

_BROAD = 4.0
"""At every feedrate the mean density about a broad resonance stands this much above the median."""

_APART = 6.0
"""Resolution cells above which a broad resonance is not mistaken for a long wave of the geometry."""

_ORDERS = (4, 8, 16, 24, 32, 48)
"""Candidate orders of the noise model of the residuals, judged by AICc."""

_AROUND = 10.0
"""Resolution cells on either side from which that median is taken."""

_CELLS = 0.75
"""Resolution cells within which a peak of another feedrate is the same vibration."""

_LEAST_CYCLES = 2.0
"""Fewer cycles in the longest run are a bow, not a vibration."""

_PADDED = 8
"""Points of the spectra for each resolution cell."""

_LEAST_SAMPLES = 32
"""Unbroken samples of a run that are worth a spectrum."""

_MOST = 6
"""Vibrations that are shown, the clearest first."""

_SAME = 0.02
"""Frequencies within this share of each other, or one resolution cell, are one vibration."""

_WAYS = {"forward": 1, "reverse": -1}


@dataclass(frozen=True, slots=True)
class Vibration:
    """A vibration, and where it lies at each feedrate."""

    frequency: float  # the same at all feedrates
    feeds: tuple[float, ...]  # m/s: feedrates, slowest first
    # {"line", "residual"}: A line that the separation removed, or a resonance of what was left
    source: str

    @property
    def wavelengths(self) -> tuple[float, ...]:
        """Where it lies at each feedrate: v/f, m.

        Examples
        --------
        >>> Vibration(10.0, (0.08, 0.12), "line").wavelengths
        (0.008, 0.012)
        """
        return tuple(v / self.frequency for v in self.feeds)


def find_vibrations(
    runs: RunSet, estimate: ErrorEstimate, *, direction: int
) -> tuple[tuple[Vibration, ...], str]:
    """Return the vibrations that the runs of a direction show at every feedrate.

    Notes
    -----
    A resonance is a peak in time of what the separation leaves of the slowest runs that stands 8
    times above the median around it at *each* feedrate, and is a peak within 0.75 of a resolution
    cell at two of them at least; or, at high frequencies, a resonance of an autoregressive model
    (`noise_peaks`) about which the density is 4 times its median at each feedrate. Geometry that the method left does not: its frequency changes
    with the feedrate. With one feedrate the two cannot be distinguished, and no resonance is named.
    The periodograms have Hann windows; gaps are not bridged, the longest part is taken.
    """
    some = runs.select(direction=direction)
    lines = tuple(Vibration(f, some.feeds, "line") for f in _lines(estimate, direction))
    if len(some.feeds) < 2:
        why = "one feedrate only: a vibration cannot be distinguished from geometry"
        return (
            lines,
            why if some.feeds else "the runs have no feedrate: no vibration can be placed",
        )
    try:
        prepared = prepare_runs(some)
    except MetrosepError as exc:
        return lines, f"no vibration was looked for: {exc}"
    groups: dict[float, list[PreparedRun]] = {}
    for run in prepared:
        step = next((s for s in groups if abs(run.time_step / s - 1.0) < 1e-3), run.time_step)
        groups.setdefault(step, []).append(run)
    found: list[float] = []
    for step, members in groups.items():
        found += _common_peaks(_residuals(members, estimate, direction), step)
    cell = max(some.feeds) / (some.full_travel[1] - some.full_travel[0])
    known = [v.frequency for v in lines]
    kept: list[float] = []
    for f in found:
        if all(abs(f - g) > max(_SAME * f, cell) for g in (*known, *kept)):
            kept.append(f)
    return (*lines, *(Vibration(f, some.feeds, "residual") for f in sorted(kept))), ""


def _lines(estimate: ErrorEstimate, direction: int) -> list[float]:
    """Return the frequencies of the lines that the separation removed."""
    terms: Mapping[str, Any] = estimate.terms
    name = next(n for n, d in _WAYS.items() if d == direction)
    if name in terms:
        terms = terms[name]
    columns = (terms.get("lines") or {}).get("lines") or {}
    return sorted(float(f) for f in columns.get("frequency_hz") or ())


def _residuals(
    members: Sequence[PreparedRun], estimate: ErrorEstimate, direction: int
) -> list[tuple[float, FloatArray]]:
    """Return speed and longest unbroken residual of each run within the evaluation range."""
    found = []
    for run in members:
        inner = (run.x >= estimate.start) & (run.x <= estimate.stop)  # Kono's ends are not model
        x = run.x[inner]
        rest = run.z[inner] - estimate.evaluate(x, direction=direction)
        edges = np.flatnonzero(np.isnan(np.concatenate([[np.nan], rest, [np.nan]])))
        longest = int(np.argmax(np.diff(edges))) if edges.size > 1 else 0
        part = slice(edges[longest], edges[longest + 1] - 1)
        if part.stop - part.start >= _LEAST_SAMPLES:
            x, rest = x[part], rest[part]
            line = np.polyfit(x - x[0], rest, 1)
            found.append((abs(run.velocity), np.asarray(rest - np.polyval(line, x - x[0]))))
    return found


@dataclass(frozen=True, slots=True, eq=False)
class _FeedSpectrum:
    """Density over time of the residuals at one feedrate, over the density around it and over all."""

    frequency: FloatArray
    ratio: FloatArray
    level: FloatArray
    cell: float

    def peak_near(self, f: float) -> float | None:
        """Return the frequency of the peak within one resolution cell, if there is one."""
        near = np.flatnonzero(np.abs(self.frequency - f) <= _CELLS * self.cell)
        if near.size == 0 or near[0] == 0 or near[-1] == self.frequency.size - 1:
            return None
        k = int(near[np.argmax(self.ratio[near])])
        if self.ratio[k] < max(self.ratio[k - 1], self.ratio[k + 1]):
            return None  # the flank of a peak that lies elsewhere
        return float(self.frequency[k])

    def mean_level(self, f: float) -> float:
        """Return the mean density around a frequency over the median of all; 0 where there is none."""
        near = np.abs(self.frequency - f) <= 2.0 * _CELLS * self.cell
        return float(self.level[near].mean()) if near.any() else 0.0

    def at(self, f: float) -> float:
        """Return how much the density stands above what is around it."""
        return float(np.interp(f, self.frequency, self.ratio))


def _spectrum_of(records: Sequence[FloatArray], step: float) -> _FeedSpectrum:
    """Return the mean Hann periodogram of records on a common, fine grid."""
    longest = max(r.size for r in records)
    size = _PADDED * longest
    density = np.zeros(size // 2 + 1)
    for record in records:
        weight = np.hanning(record.size + 2)[1:-1]
        scaled = weight * record / np.sqrt((weight**2).sum())
        density += np.abs(np.fft.rfft(scaled, size)) ** 2 / len(records)
    cell = 1.0 / (min(r.size for r in records) * step)
    frequency = np.arange(density.size) / (size * step)
    around = max(1, round(_AROUND * cell * size * step))
    padded = np.pad(density, around, mode="reflect")[:: _PADDED // 2]
    width = 2 * (around // (_PADDED // 2)) + 1
    windows = np.lib.stride_tricks.sliding_window_view(padded, width)
    background = np.median(windows, axis=1)
    at = np.arange(background.size) * (_PADDED // 2)
    floor = np.interp(np.arange(density.size), at, background)
    least = max(float(density.max()) * 1e-12, 1e-300)
    level = density / max(float(np.median(density)), least)
    return _FeedSpectrum(frequency, density / np.maximum(floor, least), level, cell)


def _common_peaks(found: Sequence[tuple[float, FloatArray]], step: float) -> list[float]:
    """Return the frequencies at which the residuals of every feedrate stand out."""
    by_feed: list[tuple[float, list[FloatArray]]] = []
    for speed, record in sorted(found, key=lambda item: item[0]):
        if by_feed and speed <= by_feed[-1][0] * (1.0 + _SAME):
            by_feed[-1][1].append(record)
        else:
            by_feed.append((speed, [record]))
    if len(by_feed) < 2:
        return []
    spectra = [_spectrum_of(records, step) for _, records in by_feed]
    finest = spectra[0]  # the slowest runs last longest
    inner = np.flatnonzero(
        (finest.ratio[1:-1] >= finest.ratio[:-2]) & (finest.ratio[1:-1] > finest.ratio[2:])
    )
    kept: list[tuple[float, float]] = []
    for f in finest.frequency[inner + 1]:
        weakest = min(s.at(float(f)) for s in spectra)
        peaks = [p for s in spectra if (p := s.peak_near(float(f))) is not None]
        if f > _LEAST_CYCLES * finest.cell and weakest >= _ABOVE and len(peaks) >= 2:
            kept.append((weakest, float(f)))
    broad = _broad_peaks([record for _, record in found], spectra, step)
    return broad + [f for _, f in sorted(kept, reverse=True)[:_MOST]]


def _broad_peaks(
    records: Sequence[FloatArray], spectra: Sequence[_FeedSpectrum], step: float
) -> list[float]:
    """Return the resonances of a noise model that are well apart from the longest waves."""
    scale = max(float(np.abs(r).max()) for r in records)
    if not scale > 0.0:
        return []
    try:
        model, _, _ = fit_autoregressive(
            [r / scale for r in records], orders=_ORDERS, time_step=step
        )
    except TooFewSamplesError:
        return []  # too short for a model: the clear peaks remain
    coarsest = max(s.cell for s in spectra)
    return [
        f
        for f in noise_peaks(model)
        if f > _APART * coarsest and min(s.mean_level(f) for s in spectra) >= _BROAD
    ]
