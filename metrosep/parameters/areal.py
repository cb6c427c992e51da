"""Areal parameters of a map after ISO 25178-2:2021, in one table.

The map is taken as it is: form removed and filtered by others. Heights count from the mean of the
valid pixels; nothing else is removed. Only what is asked is computed, and what several parameters
share (moments, sorted heights, slopes, autocorrelation, peaks) is computed once.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from metrosep.core._arrays import FloatArray, frozen_float
from metrosep.core.errors import DataError, InvalidSamplesError, TooFewSamplesError
from metrosep.core.provenance import Step
from metrosep.core.surface import Surface
from metrosep.parameters.areal_heights import HeightStatistics, height_statistics
from metrosep.parameters.autocorrelation import (
    Autocorrelation,
    CentralLobe,
    autocorrelation,
    central_lobe,
    texture_direction,
)
from metrosep.parameters.material_ratio import (
    AbbottCurve,
    CoreHeight,
    CoreLine,
    abbott_curve,
    core_height,
)
from metrosep.parameters.table import Context, ParameterTable, Row, chosen_rows, evaluated
from metrosep.parameters.watershed import (
    LARGEST_HOLE,
    Peaks,
    five_point_height,
    mean_peak_curvature,
    significant_peaks,
)
from metrosep.spectral.dft import instance_of, real_number

__all__ = ["EDITION", "ArealParameterTable", "areal_parameters", "is_form_removed"]

EDITION = "ISO 25178-2:2021"
"""Whose definitions the table follows."""

_ALIASES = {"Smrk1": "Smr1", "Smrk2": "Smr2"}
"""Symbols of 2021 that stand in the table under the older ones."""

_FEATURES = {"S5p", "S5v", "S10z", "Spd", "Spc"}
"""Parameters of peaks and pits, from the segmentation."""

_CONSTANT = "all valid heights are equal, so Sq is zero and the ratio is not defined"


class ArealParameterTable(ParameterTable):
    """Areal parameters; Smrk1 and Smrk2 find Smr1 and Smr2.

    Parameters
    ----------
    quantities : sequence of Quantity
        Each with its symbol.
    context : Context
        Edition, filter chain, valid share, settings.
    unavailable : mapping of str to str, optional
        Symbols that could not be evaluated, each with the reason and what to do.

    Examples
    --------
    >>> from metrosep.core.quantity import Quantity
    >>> table = ArealParameterTable([Quantity(0.1, "1", "material ratio", symbol="Smr1")],
    ...                             Context(EDITION, n_valid=4, n_total=4))
    >>> table["Smrk1"].value, "Smrk1" in table, list(table)
    (0.1, True, ['Smr1'])
    """

    __slots__ = ()

    def own_symbol(self, symbol: str) -> str:
        return _ALIASES.get(symbol, symbol)


def areal_parameters(
    surface: Surface,
    *,
    names: Sequence[str] | None = None,
    line: CoreLine = "lsq",
    pruning: float = 0.05,
) -> ArealParameterTable:
    """Return the areal parameters of a map.

    Parameters
    ----------
    surface : Surface
        Form removed and filtered as the specification asks. Nothing is filtered here.
    names : sequence of str, optional
        Symbols wanted; all by default. What is not asked is not computed. Smrk1 and Smrk2 find
        Smr1 and Smr2, here and in the table.
    line : {"lsq", "secant"}, optional
        Core line of the Sk family.
    pruning : float, optional
        Wolf pruning of peaks and pits as a share of Sz, 0 to below 1.

    Returns
    -------
    ArealParameterTable
        In SI and in the order of the standard: ratios are numbers from 0 to 1 and not per cent
        (Sdr, Str, Smr1, Smr2), angles are in rad, volumes in m^3/m^2 = m. What cannot be given is
        listed in ``unavailable`` with the reason.

    Raises
    ------
    DataError
        If a name or the line is unknown, `pruning` is not a share, an argument is of the wrong
        type, a height is beyond 1e60 m, or their range is below 1e-60 m and not zero.
    InvalidSamplesError
        If no pixel is valid.

    Notes
    -----
    About the mean of the valid pixels, each with the same weight. NaN is never filled. Without
    lateral steps the heights, the core family and the volumes still come. The most costly are
    S10z, Spd, Spc (watershed), then Sal, Str, Std (FFT), then the core family (one sort).

    References
    ----------
    .. [1] ISO 25178-2:2021 and the defaults of ISO 25178-3:2012 (clauses recalled, not checked).

    Examples
    --------
    >>> import numpy as np
    >>> c = 50e-9 * np.cos(2 * np.pi * np.arange(500) / 100)
    >>> grid = Surface(c[:, None] + c[None, :], dx=1e-6, dy=1e-6)
    >>> table = areal_parameters(grid, names=["Sa", "Sq", "Sz"])
    >>> [f"{q.value * 1e9:.4f} nm" for q in table.values()]
    ['50.0000 nm', '200.0000 nm', '40.5218 nm']
    """
    instance_of(surface, Surface, "a table of areal parameters")
    rows = chosen_rows(_ROWS, names, "an areal parameter", _ALIASES)
    if line not in ("lsq", "secant"):
        raise DataError(f'line is "lsq" or "secant", got {line!r}')
    if not 0.0 <= real_number(pruning, "pruning", "a share of Sz") < 1.0:
        raise DataError(f"pruning is a share of Sz from 0 to below 1, got {pruning}")
    work = _Work(surface, line, pruning)
    n_valid = work.heights.n_valid
    quantities, unavailable = evaluated(rows, work)
    given = {row.symbol for row in rows}
    settings: dict[str, Any] = {"dx_m": surface.dx, "dy_m": surface.dy}
    if given & {"Sk", "Spk", "Svk", "Smr1", "Smr2"}:
        settings["line"] = line
    if given & _FEATURES:
        settings["pruning"] = pruning
    context = Context(
        edition=EDITION,
        n_valid=n_valid,
        n_total=surface.z.size,
        history=surface.history,
        settings=settings,
        notes=(*_notes(surface), *_filled_notes(work, given)),
    )
    return ArealParameterTable(quantities, context, unavailable=unavailable)


def is_form_removed(history: Sequence[Step]) -> bool:
    """Return whether a form removal or an L-filter is in a history."""
    return any(s.name.startswith("fit ") or s.parameters.get("band") == "short" for s in history)


def _notes(surface: Surface) -> tuple[str, ...]:
    if is_form_removed(surface.history):
        return ()
    return (
        "No form removal is in the history: tilt, form and waviness of the map are in the numbers.",
    )


@dataclass(frozen=True)
class _Work:
    """What the parameters share, each evaluated when first asked."""

    surface: Surface
    line: CoreLine
    pruning: float

    @cached_property
    def heights(self) -> HeightStatistics:
        return height_statistics(self.surface.z)

    @cached_property
    def centred(self) -> NDArray[np.float64]:
        return self.surface.z - self.heights.mean

    @cached_property
    def steps(self) -> tuple[float, float]:
        dx, dy = self.surface.dx, self.surface.dy
        if dx is None or dy is None:
            missing = " and ".join(n for n, v in (("dx", dx), ("dy", dy)) if v is None)
            raise DataError(
                f"the lateral step {missing} is not calibrated; give it when reading the file "
                "(lateral_step=) or with Surface(z, dx, dy)"
            )
        return dx, dy

    @cached_property
    def gradients(self) -> GradientStatistics:
        return gradient_statistics(self.surface.z, *self.steps)

    @cached_property
    def acf(self) -> Autocorrelation:
        return autocorrelation(self.surface.z, *self.steps)

    @cached_property
    def lobe(self) -> CentralLobe:
        return central_lobe(self.acf)

    @cached_property
    def curve(self) -> AbbottCurve:
        return abbott_curve(self.centred)

    @cached_property
    def core(self) -> CoreHeight:
        return core_height(self.curve.heights, line=self.line)

    @cached_property
    def volumes(self) -> Volumes:
        return volumes(self.curve)

    @cached_property
    def peaks(self) -> Peaks:
        return significant_peaks(self.centred, pruning=self.pruning)

    @cached_property
    def pits(self) -> Peaks:
        return significant_peaks(-self.centred, pruning=self.pruning)


def _given(value: float | None, reason: str) -> float:
    if value is None:
        raise DataError(reason)
    return value


def _aspect_ratio(work: _Work) -> float:
    return _given(
        work.lobe.aspect_ratio,
        "the autocorrelation does not fall to 0.2 within half the map in its longest direction; "
        "map a larger area, or remove form and waviness",
    )


def _peak_density(work: _Work) -> float:
    dx, dy = work.steps
    n = work.heights.n_valid + work.peaks.n_filled
    return len(work.peaks) / (n * dx * dy)


def _filled_notes(work: _Work, given: set[str]) -> list[str]:
    """Return how many pixels were filled for the segmentation, and which numbers feel it."""
    missing = work.surface.z.size - work.heights.n_valid
    if not given & _FEATURES or not missing or work.heights.Sz == 0.0:
        return []
    notes = []
    found = work.pits if given & _FEATURES == {"S5v"} else work.peaks
    if found.n_filled:
        notes.append(
            f"{found.n_filled} of {missing} missing pixels lie in holes of at most {LARGEST_HOLE} "
            "pixels and were filled to find peaks and pits; heights, Sz and all other parameters "
            "are those of measured pixels"
        )
    if missing > found.n_filled:
        notes.append(
            f"{missing - found.n_filled} missing pixels lie in larger holes or outside: peaks and "
            "pits beside them are not counted"
        )
    for symbol, what in (("S5p", "peaks"), ("S5v", "pits")):
        if given & {symbol, "S10z"}:
            n = int((work.peaks if symbol == "S5p" else work.pits).on_filled[:5].sum())
            if n:
                notes.append(f"{symbol}: {n} of its 5 {what} lie on filled pixels")
    if "Spc" in given and (n := int(work.peaks.beside_filled.sum())):
        notes.append(
            f"Spc: {n} of {len(work.peaks)} peaks lie on or beside a filled pixel and are left out"
        )
    return notes


_ROWS = (
    Row("Sq", "m", "root mean square height about the mean", lambda w: w.heights.Sq),
    Row("Ssk", "1", "skewness of the heights", lambda w: _given(w.heights.Ssk, _CONSTANT)),
    Row(
        "Sku",
        "1",
        "kurtosis of the heights, 3 for Gaussian ones",
        lambda w: _given(w.heights.Sku, _CONSTANT),
    ),
    Row("Sp", "m", "highest peak above the mean", lambda w: w.heights.Sp),
    Row("Sv", "m", "deepest pit below the mean, positive", lambda w: w.heights.Sv),
    Row("Sz", "m", "maximum height Sp + Sv", lambda w: w.heights.Sz),
    Row("Sa", "m", "arithmetic mean height about the mean", lambda w: w.heights.Sa),
    Row(
        "Sal",
        "m",
        "autocorrelation length, shortest distance of the decay to 0.2",
        lambda w: w.lobe.shortest,
    ),
    Row(
        "Str",
        "1",
        "texture aspect ratio, shortest over longest distance of the decay to 0.2",
        _aspect_ratio,
    ),
    Row(
        "Std",
        "rad",
        "direction of the largest angular spectrum, from +x to +y, 0 to pi; the lay is at right "
        "angles to it",
        lambda w: texture_direction(w.acf),
    ),
    Row("Sdq", "1", "root mean square gradient", lambda w: w.gradients.Sdq),
    Row(
        "Sdr",
        "1",
        "developed interfacial area ratio, as a number (1 is 100 %)",
        lambda w: w.gradients.Sdr,
    ),
    Row("Sk", "m", "core height", lambda w: w.core.k),
    Row("Spk", "m", "reduced peak height", lambda w: w.core.pk),
    Row("Svk", "m", "reduced dale height", lambda w: w.core.vk),
    Row(
        "Smr1",
        "1",
        "material ratio at the top of the core, 0 to 1 (Smrk1 of 2021)",
        lambda w: w.core.mr1,
    ),
    Row(
        "Smr2",
        "1",
        "material ratio at the bottom of the core, 0 to 1 (Smrk2 of 2021)",
        lambda w: w.core.mr2,
    ),
    Row("Vmp", "m", "peak material volume per area, Vm(10 %)", lambda w: w.volumes.Vmp),
    Row("Vmc", "m", "core material volume per area, Vm(80 %) - Vm(10 %)", lambda w: w.volumes.Vmc),
    Row("Vvc", "m", "core void volume per area, Vv(10 %) - Vv(80 %)", lambda w: w.volumes.Vvc),
    Row("Vvv", "m", "dale void volume per area, Vv(80 %)", lambda w: w.volumes.Vvv),
    Row(
        "Sxp",
        "m",
        "peak extreme height Smc(2.5 %) - Smc(50 %)",
        lambda w: w.curve.height_difference(0.025, 0.5),
    ),
    Row(
        "S5p",
        "m",
        "mean height of the five highest significant peaks",
        lambda w: five_point_height(w.peaks, 0.0),
    ),
    Row(
        "S5v",
        "m",
        "mean depth of the five deepest significant pits, positive",
        lambda w: five_point_height(w.pits, 0.0),
    ),
    Row(
        "S10z",
        "m",
        "ten-point height S5p + S5v",
        lambda w: five_point_height(w.peaks, 0.0) + five_point_height(w.pits, 0.0),
    ),
    Row("Spd", "1/m^2", "density of significant peaks", _peak_density),
    Row(
        "Spc",
        "1/m",
        "mean curvature of the significant peaks",
        lambda w: mean_peak_curvature(w.surface.z, w.peaks, *w.steps),
    ),
)


# ---- hybrid parameters of a map: root mean square gradient Sdq and developed area ratio Sdr ----
# Both come from the same two slopes at each pixel. A slope is taken from the widest symmetric
# stencil whose pixels are all valid: seven points, else five, else three; at an edge or beside a
# hole it is one-sided with three points, else two. All but the last are exact for parabolas. A
# pixel that was not measured, or has no valid neighbour in x and in y, has no slope and is left out,
# so a hole adds no slope of its own.

_REACH = 3
"""Half-width of the widest stencil, in pixels."""

_BLOCK = 32_768
"""Pixels a block, so that the slopes of a block stay in the cache."""

_LADDER: tuple[tuple[tuple[int, float], ...], ...] = (
    ((2, -1 / 12), (1, 8 / 12), (-1, -8 / 12), (-2, 1 / 12)),
    ((1, 0.5), (-1, -0.5)),
    ((0, -1.5), (1, 2.0), (2, -0.5)),
    ((0, 1.5), (-1, -2.0), (-2, 0.5)),
    ((0, -1.0), (1, 1.0)),
    ((0, 1.0), (-1, -1.0)),
)
"""Stencils (offset, weight) in the order of preference where seven points are not there."""


@dataclass(frozen=True, slots=True)
class GradientStatistics:
    """Mean slopes of a map."""

    n_used: int  # measured pixels that have a slope in x and in y
    Sdq: float  # root mean square gradient, dimensionless (tangent of an angle)
    Sdr: float  # developed area over projected area, less one; a ratio, not per cent


def gradient_statistics(z: ArrayLike, dx: float, dy: float) -> GradientStatistics:
    """Return the root mean square gradient and the developed area ratio.

    Notes
    -----
    Sdq^2 = mean(zx^2 + zy^2), Sdr = mean(sqrt(1 + zx^2 + zy^2) - 1) over the pixels that have
    both slopes. Each pixel stands for the area dx dy around it. The standard leaves the numerical
    derivative open; see the page on Sdq for what other choices give.

    References
    ----------
    .. [1] ISO 25178-2:2021, hybrid parameters (clause 4.4; number recalled, not checked).

    Examples
    --------
    >>> g = gradient_statistics([[0.0, 3e-6], [4e-6, 7e-6]], dx=1e-6, dy=1e-6)
    >>> f"{g.Sdq:.3f}"
    '5.000'
    """
    count, squares, excess = 0, [], []
    for slope_x, slope_y in _slope_blocks(_checked(z, dx, dy), dx, dy):
        s2 = slope_x * slope_x
        s2 += slope_y * slope_y
        used = s2 == s2
        if not used.all():
            s2 = s2[used]
        count += s2.size
        squares.append(float(np.add.reduce(s2, axis=None)))
        # sqrt(1 + s) - 1 without cancellation for slopes of 1e-9.
        s2 /= 1.0 + np.sqrt(1.0 + s2)
        excess.append(float(np.add.reduce(s2, axis=None)))
    if count == 0:
        raise InvalidSamplesError(
            "no pixel has a valid neighbour in x and in y: slopes cannot be formed; the map is too "
            "sparse for Sdq and Sdr"
        )
    return GradientStatistics(
        count, math.sqrt(math.fsum(squares) / count), math.fsum(excess) / count
    )


def surface_slopes(z: ArrayLike, dx: float, dy: float) -> tuple[FloatArray, FloatArray]:
    """Return the slopes dz/dx and dz/dy at the pixels."""
    blocks = list(_slope_blocks(_checked(z, dx, dy), dx, dy))
    return np.concatenate([b[0] for b in blocks]), np.concatenate([b[1] for b in blocks])


def _checked(z: ArrayLike, dx: float, dy: float) -> FloatArray:
    for name, step in (("dx", dx), ("dy", dy)):
        if not (math.isfinite(step) and step > 0.0):
            raise InvalidSamplesError(f"{name} is {step} m; a lateral step must be positive")
    heights = frozen_float(z, name="z", ndim=2)
    if min(heights.shape) < 2:
        raise TooFewSamplesError(
            f"a slope needs at least 2 x 2 pixels, got {heights.shape[0]} x {heights.shape[1]}"
        )
    return heights


def _slope_blocks(z: FloatArray, dx: float, dy: float) -> Iterator[tuple[FloatArray, FloatArray]]:
    """Give the slopes of some rows at a time; beyond the map stands NaN, like a hole."""
    n_y, n_x = z.shape
    rows = max(1, _BLOCK // n_x)
    for start in range(0, n_y, rows):
        stop = min(start + rows, n_y)
        first, last = max(start - _REACH, 0), min(stop + _REACH, n_y)
        tile = np.full((stop - start + 2 * _REACH, n_x + 2 * _REACH), np.nan)
        row = first - (start - _REACH)
        tile[row : row + last - first, _REACH:-_REACH] = z[first:last]
        yield _slope(tile, 1, dx), _slope(tile, 0, dy)


def _slope(tile: FloatArray, axis: int, step: float) -> FloatArray:
    """Return the slope along an axis at the inner pixels of a padded tile."""
    inner = slice(_REACH, -_REACH)

    def shifted(offset: int) -> FloatArray:
        along = slice(_REACH + offset, tile.shape[axis] - _REACH + offset)
        part: FloatArray = tile[(along, inner) if axis == 0 else (inner, along)]
        return part

    slope = shifted(1) - shifted(-1)
    slope *= 45.0
    wider = shifted(2) - shifted(-2)
    wider *= 9.0
    slope -= wider
    slope += shifted(3)
    slope -= shifted(-3)
    slope /= 60.0
    _fill_from_ladder(slope, tile, tile.strides[axis] // tile.itemsize)
    slope /= step
    return slope


def _fill_from_ladder(slope: FloatArray, tile: FloatArray, stride: int) -> None:
    """Replace, in place, slopes that seven points could not give."""
    width = tile.shape[1]
    inner = slice(_REACH, -_REACH)
    # Seven points do not use the pixel itself, which may be the one that was not measured.
    np.copyto(slope, np.nan, where=np.isnan(tile[inner, inner]))
    missing_y, missing_x = np.nonzero(np.isnan(slope))
    index = (missing_y + _REACH) * width + missing_x + _REACH
    heights = tile.reshape(-1)
    measured = ~np.isnan(heights[index])
    index, missing_y, missing_x = index[measured], missing_y[measured], missing_x[measured]
    for stencil in _LADDER:
        if index.size == 0:
            return
        value = np.zeros(index.size)
        for offset, weight in stencil:
            value += weight * heights[index + offset * stride]
        found = ~np.isnan(value)
        slope[missing_y[found], missing_x[found]] = value[found]
        index, missing_y, missing_x = index[~found], missing_y[~found], missing_x[~found]


# ---- material and void volumes of a map from its material ratio curve: Vm(p), Vv(p), Vmp to Vvv ----
# A volume is per unit of area, m^3/m^2 = m. At the material ratio p the surface is cut at the height
# Smc(p): the material above the cut is Vm(p), the void below the cut is Vv(p).

_PEAK = 0.10
_VALLEY = 0.80
"""Material ratios that divide peak, core and dale (defaults of ISO 25178-3)."""


@dataclass(frozen=True, slots=True)
class Volumes:
    """Volume parameters at the ratios 10 % and 80 %, in m^3/m^2."""

    Vmp: float  # m: peak material volume, Vm(10 %)
    Vmc: float  # m: core material volume, Vm(80 %) - Vm(10 %)
    Vvc: float  # m: core void volume, Vv(10 %) - Vv(80 %)
    Vvv: float  # m: dale void volume, Vv(80 %)


def material_volume(curve: AbbottCurve, p: float) -> float:
    """Return the material volume Vm(p) above the height at a material ratio.

    Notes
    -----
    Vm(p) = integral from 0 to p of Smc(q) - Smc(p) over q, here as the mean of
    max(z - Smc(p), 0) over the pixels.

    References
    ----------
    .. [1] ISO 25178-2:2021, 4.5.6 (number recalled, not checked).

    Examples
    --------
    >>> from metrosep.parameters.material_ratio import abbott_curve
    >>> import numpy as np
    >>> f"{material_volume(abbott_curve(np.linspace(0, 1e-6, 10001)), 0.5):.4g}"
    '1.25e-07'
    """
    cut, above = _cut(curve, p)
    return float(np.add.reduce(curve.heights[:above] - cut)) / curve.heights.size


def void_volume(curve: AbbottCurve, p: float) -> float:
    """Return the void volume Vv(p) below the height at a material ratio.

    Notes
    -----
    Vv(p) = integral from p to 1 of Smc(p) - Smc(q) over q, here as the mean of
    max(Smc(p) - z, 0) over the pixels. Vv(p) - Vm(p) = Smc(p) - mean(z).

    References
    ----------
    .. [1] ISO 25178-2:2021, 4.5.7 (number recalled, not checked).
    """
    cut, above = _cut(curve, p)
    return float(np.add.reduce(cut - curve.heights[above:])) / curve.heights.size


def volumes(curve: AbbottCurve, *, peak: float = _PEAK, valley: float = _VALLEY) -> Volumes:
    """Return the four volume parameters.

    References
    ----------
    .. [1] ISO 25178-2:2021, 4.5.6 and 4.5.7; ratios of ISO 25178-3 (recalled, not checked).

    Examples
    --------
    >>> from metrosep.parameters.material_ratio import abbott_curve
    >>> import numpy as np
    >>> v = volumes(abbott_curve(np.linspace(0, 1e-6, 100001)))
    >>> f"{v.Vmp:.3g} {v.Vmc:.3g} {v.Vvc:.3g} {v.Vvv:.3g}"
    '5e-09 3.15e-07 3.85e-07 2e-08'
    """
    if not peak < valley:
        raise DataError(f"the ratios must rise, peak < valley; got {peak} and {valley}")
    peak_material, dale_void = material_volume(curve, peak), void_volume(curve, valley)
    return Volumes(
        Vmp=peak_material,
        Vmc=material_volume(curve, valley) - peak_material,
        Vvc=void_volume(curve, peak) - dale_void,
        Vvv=dale_void,
    )


def _cut(curve: AbbottCurve, p: float) -> tuple[float, int]:
    """Return the height of the cut and the number of pixels above it."""
    cut = curve.height(p)
    heights = curve.heights
    return cut, int(heights.size - np.searchsorted(heights[::-1], cut, side="right"))
