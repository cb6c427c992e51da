"""Material ratio (Abbott-Firestone) curve and the core height family k, pk, vk, mr1, mr2.

Everything works on bare heights, so profiles (Rk, ISO 13565-2, ISO 21920-2) and surfaces (Sk,
ISO 25178-2) share it. The curve is exact: the sorted samples themselves, no histogram. Ratios are
fractions 0 to 1. Heights are out of the material; NaN = not measured and does not count.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import ArrayLike

from metrosep.core._arrays import FloatArray
from metrosep.core.errors import (
    DataError,
    DegenerateFitError,
    InvalidSamplesError,
    TooFewSamplesError,
)
from metrosep.core.numbers import choice, quantity

__all__ = [
    "AbbottCurve",
    "CoreHeight",
    "CoreLine",
    "abbott_curve",
    "core_height",
    "material_height",
    "material_ratio",
]

CoreLine = Literal["lsq", "secant"]

_WINDOW = 0.4
"""Width of the window of smallest slope, as a material ratio (ISO 13565-2)."""

_TIE = 1e-12
"""Heights closer than this share of the total height are one height: rounding, not texture."""

_MIN_SAMPLES = 5
"""Fewest samples for a core line: the 40 % window then holds three."""


@dataclass(frozen=True, slots=True, eq=False)
class AbbottCurve:
    """Heights in falling order with their material ratios; a step function.

    Parameters
    ----------
    heights : ndarray, shape (n,), m
        Valid samples, largest first.
    """

    heights: FloatArray

    @property
    def ratios(self) -> FloatArray:
        """Material ratio at each height, the share of samples at or above it, shape (n,)."""
        n = self.heights.size
        return np.arange(1, n + 1, dtype=np.float64) / n

    @property
    def total_height(self) -> float:
        """Largest minus smallest height in m."""
        return float(self.heights[0] - self.heights[-1])

    def ratio(self, c: float, *, reference: Literal["mean", "peak"] = "mean") -> float:
        """Return the material ratio mr(c), the share of samples at or above a height.

        Parameters
        ----------
        c : float, m
            With ``reference="mean"`` the height itself (0 is the mean line of the filter); with
            ``"peak"`` the depth below the highest sample, >= 0.
        reference : {"mean", "peak"}, optional
            What `c` counts from.

        Returns
        -------
        float
            0 to 1.

        Raises
        ------
        DataError
            If `c` is not finite or `reference` is unknown.

        Notes
        -----
        Samples within 1e-12 of the total height below the level count, so that rounding of units
        does not.
        """
        c = quantity(c, "a height for the material ratio", "length")
        choice(reference, "reference", ("mean", "peak"))
        level = c if reference == "mean" else float(self.heights[0]) - c
        level -= _TIE * self.total_height
        below = int(np.searchsorted(self.heights[::-1], level, side="left"))
        return (self.heights.size - below) / self.heights.size

    def height(self, p: float) -> float:
        """Return the height mc(p) at a material ratio, the inverse of `ratio`.

        Parameters
        ----------
        p : float
            Material ratio, 0 to 1.

        Returns
        -------
        float
            Height in m, on the same zero as the samples.

        Raises
        ------
        DataError
            If `p` is outside 0 to 1.

        Notes
        -----
        Sample i (from 0, falling) stands for the ratios i/n to (i+1)/n; between the middles of
        these ranges the curve is linear, beyond the outer ones constant.
        """
        if not 0.0 <= p <= 1.0:
            raise DataError(f"a material ratio is a fraction from 0 to 1, got {p}")
        n = self.heights.size
        position = min(max(p * n - 0.5, 0.0), n - 1.0)
        i = min(int(position), n - 2) if n > 1 else 0
        share = position - i
        return float(self.heights[i] * (1.0 - share) + self.heights[min(i + 1, n - 1)] * share)

    def height_difference(self, p: float, q: float) -> float:
        """Return dc(p, q) = mc(p) - mc(q), the height between two material ratios.

        Parameters
        ----------
        p, q : float
            Material ratios, 0 <= p < q <= 1.

        Returns
        -------
        float
            Difference in m, >= 0.

        Raises
        ------
        DataError
            If the ratios are outside 0 to 1 or not in order.
        """
        if not p < q:
            raise DataError(f"material ratios must rise, p < q; got p = {p}, q = {q}")
        return self.height(p) - self.height(q)


@dataclass(frozen=True, slots=True)
class CoreHeight:
    """Core height k, reduced peak and valley heights and their material ratios.

    Parameters
    ----------
    k, pk, vk : float, m
        Core height, reduced peak height, reduced valley (dale) depth.
    mr1, mr2 : float
        Material ratios at the upper and the lower end of the core, 0 to 1.
    pkx, vkx : float, m
        Whole height of the peaks above and of the valleys below the core.
    a1, a2 : float, m
        Area of peaks and of valleys per unit of ratio; times 100 it is "um %" for m -> um.
    upper, lower : float, m
        Heights of the core line at ratios 0 and 1.
    start : float
        Ratio at which the window of smallest slope begins.
    line : {"lsq", "secant"}
        How the line was drawn through that window.
    """

    k: float
    pk: float
    vk: float
    mr1: float
    mr2: float
    pkx: float
    vkx: float
    a1: float
    a2: float
    upper: float
    lower: float
    start: float
    line: CoreLine


def abbott_curve(heights: ArrayLike) -> AbbottCurve:
    """Return the material ratio curve of heights: one sort, exact.

    Parameters
    ----------
    heights : array_like, any shape, m
        Heights; NaN are left out.

    Returns
    -------
    AbbottCurve
        Valid heights in falling order.

    Raises
    ------
    TooFewSamplesError
        If no height is valid.
    InvalidSamplesError
        If a height is infinite.

    Notes
    -----
    O(n log n) in time; one copy of the heights.

    Examples
    --------
    >>> curve = abbott_curve([0.0, 1e-6, 2e-6, 3e-6])
    >>> curve.ratio(2e-6), curve.height(0.5)
    (0.5, 1.5e-06)
    """
    z = np.array(heights, dtype=np.float64).ravel()
    z.sort()  # NaN go to the end
    z = z[: np.searchsorted(z, np.nan)] if z.size and np.isnan(z[-1]) else z
    if z.size == 0:
        raise TooFewSamplesError("no height was measured, so there is no material ratio curve")
    if not (np.isfinite(z[0]) and np.isfinite(z[-1])):
        raise InvalidSamplesError("a height is infinite; mark samples out of range as NaN")
    return AbbottCurve(z[::-1])


def material_ratio(
    heights: ArrayLike, c: float, *, reference: Literal["mean", "peak"] = "mean"
) -> float:
    """Return the material ratio mr(c) of heights.

    Examples
    --------
    >>> material_ratio([0.0, 1e-6, 2e-6, 3e-6], 1e-6, reference="peak")
    0.5
    """
    return abbott_curve(heights).ratio(c, reference=reference)


def material_height(heights: ArrayLike, p: float) -> float:
    """Return the height mc(p) at a material ratio.

    Examples
    --------
    >>> material_height([0.0, 1e-6, 2e-6, 3e-6], 0.5)
    1.5e-06
    """
    return abbott_curve(heights).height(p)


def core_height(heights_sorted_desc: ArrayLike, *, line: CoreLine = "lsq") -> CoreHeight:
    """Return the core height k and its family from heights in falling order.

    Parameters
    ----------
    heights_sorted_desc : array_like, shape (n,), m
        Heights, largest first, no NaN; `AbbottCurve.heights` is meant.
    line : {"lsq", "secant"}, optional
        Line through the 40 % window of smallest secant slope: least squares on its ordinates, or
        the secant itself (as Mitutoyo instruments do).

    Returns
    -------
    CoreHeight
        Heights in m, ratios as fractions.

    Raises
    ------
    TooFewSamplesError
        If there are fewer than 5 heights.
    InvalidSamplesError
        If a height is not finite or the order is not falling.
    DegenerateFitError
        If all heights are equal: there is no core.
    DataError
        If `line` is unknown.

    Notes
    -----
    The first window counts when several have the smallest slope, to 1e-12 of the total height.
    ``a1 = mean(max(z - upper, 0))`` and ``pk = 2 a1 / mr1``: the triangle of equal area; valleys
    alike. A core line that passes above every peak gives ``pk = mr1 = 0``. No NaN, O(n).

    References
    ----------
    .. [1] ISO 13565-2:1996, clause 4 (recalled); ISO 21920-2:2021, ISO 25178-2:2021.

    Examples
    --------
    >>> import numpy as np
    >>> m = (np.arange(20000) + 0.5) / 20000
    >>> z = np.interp(m, [0, 0.1, 0.8, 1], [2.8e-6, 0.8e-6, -0.6e-6, -3.6e-6])
    >>> core = core_height(z)
    >>> f"{core.k:.4g} {core.pk:.4g} {core.mr1:.2f} {core.mr2:.2f}"
    '2e-06 1.8e-06 0.09 0.83'
    """
    z = _falling(heights_sorted_desc)
    total = float(z[0] - z[-1])
    if not total > 0.0:
        raise DegenerateFitError("all heights are equal, so there is no core: zero height")
    tie = _TIE * total
    start, upper, lower = _core_line(z, line, tie)
    n = z.size
    n_above = n - int(np.searchsorted(z[::-1], upper + tie, side="right"))
    n_below = int(np.searchsorted(z[::-1], lower - tie, side="left"))
    a1 = float((z[:n_above] - upper).sum()) / n
    a2 = float((lower - z[n - n_below :]).sum()) / n
    mr1, mr2 = n_above / n, 1.0 - n_below / n
    return CoreHeight(
        k=upper - lower,
        pk=2.0 * a1 / mr1 if n_above else 0.0,
        vk=2.0 * a2 * n / n_below if n_below else 0.0,
        mr1=mr1,
        mr2=mr2,
        pkx=max(float(z[0]) - upper, 0.0),
        vkx=max(lower - float(z[-1]), 0.0),
        a1=a1,
        a2=a2,
        upper=upper,
        lower=lower,
        start=start,
        line=line,
    )


def _falling(heights: ArrayLike) -> FloatArray:
    z = np.asarray(heights, dtype=np.float64)
    if z.ndim != 1 or z.size < _MIN_SAMPLES:
        raise TooFewSamplesError(
            f"a core line needs {_MIN_SAMPLES} or more heights in one row, got shape {z.shape}"
        )
    if not np.isfinite(z.sum()):
        raise InvalidSamplesError("heights for the core line must be finite; leave NaN out")
    if (z[1:] > z[:-1]).any():
        raise InvalidSamplesError("heights must fall; pass abbott_curve(z).heights")
    return z


def _core_line(z: FloatArray, line: CoreLine, tie: float) -> tuple[float, float, float]:
    """Return start ratio of the window and the heights of its line at ratios 0 and 1."""
    choice(line, "line", ("lsq", "secant"))
    n = z.size
    width = _WINDOW * n
    whole = int(width)
    rest = width - whole
    n_windows = n - whole - (1 if rest else 0)
    drop = z[:n_windows] - z[whole : whole + n_windows]
    if rest:
        drop += rest * (z[whole : whole + n_windows] - z[whole + 1 : whole + 1 + n_windows])
    first = int(np.argmax(drop <= drop.min() + tie))
    if line == "secant":
        slope = -float(drop[first]) / _WINDOW
        at_zero = float(z[first]) - slope * (first + 0.5) / n
    else:
        window = z[first : first + whole + 1]
        p = (np.arange(window.size) - (window.size - 1) / 2) / n
        slope = float(p @ (window - window.mean()) / (p @ p))
        at_zero = float(window.mean()) - slope * (first + 0.5 + (window.size - 1) / 2) / n
    return (first + 0.5) / n, at_zero, at_zero + slope
