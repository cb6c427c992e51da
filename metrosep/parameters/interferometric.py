"""Parameters of interferometric form maps: PV, RMS, PVr, PVq, PV20.

All are of the valid pixels as they are, after whatever removal is in the history. RMS is about the
mean, so piston never counts. PV is made by two pixels and grows with their number; PVr, PVq and
PV20 are robust replacements, each another number with another name.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from metrosep.core._arrays import FloatArray
from metrosep.core.errors import DataError, TooFewSamplesError
from metrosep.core.surface import Surface
from metrosep.parameters.areal import is_form_removed
from metrosep.parameters.areal_heights import HeightStatistics, height_statistics
from metrosep.parameters.table import Context, ParameterTable, Row, chosen_rows, evaluated
from metrosep.spectral.dft import instance_of

_EDITION = "ISO 14999-4:2015"

_TERMS = 36
"""Fringe Zernike terms of PVr."""

_ROUND = 0.9
"""Least share of its smallest circle that a convex outline fills to count as a disc."""

_FULL = 0.75
"""Share of the disc that was measured, below which a note says so."""

_SHARE = 0.999
"""Share of the pixels inside the quantile range PVq."""

_TEN = 10
_BLOCK = 16_384


def interferometric_parameters(
    surface: Surface, *, names: Sequence[str] | None = None
) -> ParameterTable:
    """Return PV, RMS and the robust peak-to-valley values of a map.

    Parameters
    ----------
    surface : Surface
        After the stated removal (piston, tilt, power, asphere). Nothing is removed here.
    names : sequence of str, optional
        Of PV, RMS, PVr, PVq, PV20; all by default. What is not asked is not computed.

    Returns
    -------
    ParameterTable
        In m. What cannot be given is listed in ``unavailable`` with the reason: PVr needs a disc
        and lateral steps.

    Raises
    ------
    DataError
        If a name is unknown, an argument is of the wrong type, a height is beyond 1e60 m, or
        their range is below 1e-60 m and not zero.
    InvalidSamplesError
        If no pixel is valid.

    Notes
    -----
    NaN is omitted and never filled; ``context.n_valid`` belongs to each PV.

    References
    ----------
    .. [1] ISO 14999-4:2015 and ISO 10110-5:2015 (recalled, not checked): PV, RMS.
    .. [2] Evans 2008, Robust estimation of PV for optical surface specification and testing,
       Optical Fabrication and Testing, OWA4 (recalled): PVr.

    Examples
    --------
    >>> import numpy as np
    >>> c = 50e-9 * np.cos(2 * np.pi * np.arange(500) / 100)
    >>> grid = Surface(c[:, None] + c[None, :] + 1e-3, dx=1e-6, dy=1e-6)
    >>> table = interferometric_parameters(grid, names=["PV", "RMS"])
    >>> [f"{q.value * 1e9:.4f} nm" for q in table.values()]
    ['200.0000 nm', '50.0000 nm']
    """
    instance_of(surface, Surface, "a table of interferometric parameters")
    rows = chosen_rows(_ROWS, names, "an interferometric parameter")
    work = _Work(surface)
    n_valid = work.heights.n_valid
    notes: list[str] = []
    if not is_form_removed(surface.history):
        notes.append("No form removal is in the history: tilt and power of the map are in PV.")
    quantities, unavailable = evaluated(rows, work)
    notes.extend(work.notes)
    context = Context(
        edition=_EDITION,
        n_valid=n_valid,
        n_total=surface.z.size,
        history=surface.history,
        settings={"zernike_terms": _TERMS, "zernike_order": "fringe", "quantile_share": _SHARE},
        notes=tuple(notes),
    )
    return ParameterTable(quantities, context, unavailable=unavailable)


def robust_peak_to_valley(surface: Surface) -> float:
    """Return PVr: the P-V of a 36-term Zernike fit plus three times the RMS of what it leaves.

    Parameters
    ----------
    surface : Surface
        Map of a disc, with lateral steps.

    Returns
    -------
    float
        PVr in m.

    Raises
    ------
    DataError
        If it is not a surface, a lateral step is not calibrated, the heights are out of range, or the outline of the valid pixels is not a disc.
    InvalidSamplesError
        If no pixel is valid.
    TooFewSamplesError
        If fewer pixels are valid than there are terms.
    DegenerateFitError
        If the valid pixels do not determine the terms.

    Notes
    -----
    Fringe terms 1 to 36 on the smallest circle around the centres of the valid pixels; P-V of the
    fit over the valid pixels. The convex outline must fill 90 % of that circle (a square fills
    64 %, an octagon 90 %): on other parts the terms are not those of the definition, and PVr can
    be larger than PV. Nothing is clipped. One pass for the fit and one for its values.

    References
    ----------
    .. [1] Evans 2008, OWA4 (recalled).

    Examples
    --------
    >>> import numpy as np
    >>> y, x = np.mgrid[-1:1:101j, -1:1:101j]
    >>> r2 = x**2 + y**2
    >>> power = Surface(np.where(r2 <= 1, 1e-7 * (2 * r2 - 1), np.nan), dx=1e-3, dy=1e-3)
    >>> f"{robust_peak_to_valley(power):.4g}"
    '2e-07'
    """
    instance_of(surface, Surface, "PVr")
    return _Work(surface).pv_of_fit_and_residual()


@dataclass(frozen=True)
class _Work:
    """What the parameters share."""

    surface: Surface

    @cached_property
    def notes(self) -> list[str]:
        return []

    @cached_property
    def heights(self) -> HeightStatistics:
        return height_statistics(self.surface.z)

    @cached_property
    def valid(self) -> FloatArray:
        z = self.surface.z
        valid: FloatArray = z[z == z]
        return valid

    def quantile_range(self) -> float:
        tail = 0.5 * (1.0 - _SHARE)
        low, high = np.quantile(self.valid - self.heights.mean, [tail, 1.0 - tail])
        return float(high - low)

    def ten_and_ten(self) -> float:
        z = self.valid - self.heights.mean
        if z.size < 2 * _TEN:
            raise TooFewSamplesError(f"PV20 needs 20 valid pixels, got {z.size}")
        z.partition([_TEN - 1, z.size - _TEN])
        return float(z[-_TEN:].mean() - z[:_TEN].mean())

    def pv_of_fit_and_residual(self) -> float:
        from metrosep.forms.zernike import fringe_to_nm
        from metrosep.forms.zernike_fit import fit_zernike_grid

        x0, y0, radius, share = _disc(self.surface)
        n_y, n_x = self.surface.shape
        dx, dy = float(self.surface.dx or 0.0), float(self.surface.dy or 0.0)
        x: FloatArray = np.arange(n_x, dtype=np.float64) * dx - x0
        y: FloatArray = np.arange(n_y, dtype=np.float64) * dy - y0
        nm = tuple(fringe_to_nm(j) for j in range(1, _TERMS + 1))
        centred = self.surface.z - self.heights.mean
        coefficients = fit_zernike_grid(centred, x, y, nm, radius=radius)[0]
        if share < _FULL:
            self.notes.append(
                f"Only {100 * share:.0f} % of the disc was measured; the fit of PVr is free in the "
                "holes, but only its values at valid pixels count."
            )
        return _peak_to_valley_and_rest(centred, x / radius, y / radius, nm, coefficients)


def _peak_to_valley_and_rest(
    z: FloatArray,
    u: FloatArray,
    v: FloatArray,
    nm: Sequence[tuple[int, int]],
    coefficients: FloatArray,
) -> float:
    """Return the P-V of the fit at the valid pixels plus three times the RMS of the residual."""
    from metrosep.forms.zernike_fit import zernike_values

    low, high, squares, count = math.inf, -math.inf, [], 0
    rows = max(1, _BLOCK // u.size)
    for start in range(0, v.size, rows):
        block = z[start : start + rows]
        row, column = np.nonzero(block == block)
        if row.size == 0:
            continue
        fitted = coefficients @ zernike_values(u[column], v[start + row], nm)
        rest = block[row, column] - fitted
        low, high = min(low, float(fitted.min())), max(high, float(fitted.max()))
        squares.append(float(rest @ rest))
        count += rest.size
    return high - low + 3.0 * math.sqrt(math.fsum(squares) / count)


def _disc(surface: Surface) -> tuple[float, float, float, float]:
    """Return centre and radius of the smallest circle in m, and the share of it that was measured."""
    if surface.dx is None or surface.dy is None:
        raise DataError(
            "a lateral step is not calibrated, so nobody knows whether the aperture is a disc; "
            "give it when reading the file (lateral_step=) or with Surface(z, dx, dy)"
        )
    corners, area = _hull(surface.z == surface.z, surface.dx, surface.dy)
    x0, y0, radius = smallest_circle(corners)
    # Pixels have a size: half a pixel belongs to the outline all around.
    full = math.pi * (radius + 0.25 * (surface.dx + surface.dy)) ** 2
    if area < _ROUND * full:
        raise DataError(
            f"the aperture is not a disc: its outline fills {100 * area / full:.0f} % of the "
            "smallest circle around it. PVr is defined on a disc: mask the map to one, or use PVq "
            "or PV20"
        )
    n_valid = int(np.count_nonzero(surface.z == surface.z))
    return x0, y0, radius, n_valid * surface.dx * surface.dy / full


def _hull(valid: NDArray[np.bool_], dx: float, dy: float) -> tuple[FloatArray, float]:
    """Return the outermost pixel centres, and the area of the convex outline of whole pixels."""
    from scipy.spatial import ConvexHull

    rows = np.nonzero(valid.any(axis=1))[0]
    first = np.argmax(valid[rows], axis=1)
    last = valid.shape[1] - 1 - np.argmax(valid[rows, ::-1], axis=1)
    if min(np.ptp(rows), last.max() - first.min()) < 2:
        raise TooFewSamplesError("PVr needs a disc of pixels, got a line or a point")
    ends = np.concatenate([np.stack([first, rows], 1), np.stack([last, rows], 1)]) * [dx, dy]
    half = np.array([[-dx, -dy], [-dx, dy], [dx, -dy], [dx, dy]]) / 2
    area = ConvexHull((ends[:, None, :] + half[None, :, :]).reshape(-1, 2)).volume
    return np.unique(ends, axis=0), float(area)


def smallest_circle(points: FloatArray) -> tuple[float, float, float]:
    """Return centre and radius of the smallest circle around points.

    The farthest point joins the two or three that carry the circle until none is outside; the
    radius grows each time, so it ends.
    """
    middle = 0.5 * (points.min(axis=0) + points.max(axis=0))
    scale = float(np.ptp(points))
    support = [int(np.argmax(np.hypot(*(points - middle).T)))]
    centre, radius = points[support[0]], 0.0
    while True:
        distance = np.hypot(*(points - centre).T)
        farthest = int(np.argmax(distance))
        if distance[farthest] <= radius + 1e-12 * scale:
            return float(centre[0]), float(centre[1]), float(distance[farthest])
        trial = [*support, farthest]
        found = []
        for k in (2, 3):
            for chosen in itertools.combinations(trial, k):
                circle = _circle_through(points[list(chosen)])
                if circle is None:
                    continue
                c, r = circle
                if (np.hypot(*(points[trial] - c).T) <= r + 1e-12 * scale).all():
                    found.append((r, chosen, c))
        radius, chosen, centre = min(found, key=lambda f: f[0])
        support = list(chosen)


def _circle_through(p: FloatArray) -> tuple[FloatArray, float] | None:
    """Return the circle over two points as a diameter, or through three."""
    if len(p) == 2:
        return 0.5 * (p[0] + p[1]), 0.5 * float(np.hypot(*(p[1] - p[0])))
    a, b = p[1] - p[0], p[2] - p[0]
    double = 2.0 * float(a[0] * b[1] - a[1] * b[0])
    if abs(double) <= 1e-14 * float((a @ a) + (b @ b)):
        return None
    offset = np.array([b[1] * (a @ a) - a[1] * (b @ b), a[0] * (b @ b) - b[0] * (a @ a)]) / double
    return p[0] + offset, float(np.hypot(*offset))


_ROWS = (
    Row("PV", "m", "largest minus smallest valid height", "heights.Sz"),
    Row("RMS", "m", "root mean square of the valid heights about their mean", "heights.Sq"),
    Row(
        "PVr",
        "m",
        "P-V of a 36-term Fringe Zernike fit + 3 RMS of its residual, on the smallest circle "
        "around the valid pixels",
        _Work.pv_of_fit_and_residual,
    ),
    Row(
        "PVq",
        "m",
        "range of the middle 99.9 % of the valid heights (quantiles 0.05 % and 99.95 %)",
        _Work.quantile_range,
    ),
    Row(
        "PV20", "m", "mean of the 10 highest minus mean of the 10 lowest pixels", _Work.ten_and_ten
    ),
)
