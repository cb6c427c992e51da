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

CoreLine = Literal["lsq", "secant"]

PEAK, VALLEY = 0.10, 0.80
"""Material ratios that divide peak, core and valley in volumes (defaults of ISO 25178-3)."""

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

    def material_volume(self, p: float) -> float:
        """Return the material volume Vm(p) above the height at a material ratio.

        Parameters
        ----------
        p : float
            Material ratio, 0 to 1.

        Returns
        -------
        float
            Per unit of area (or length), m: the mean of max(z - mc(p), 0) over the samples.

        Raises
        ------
        DataError
            If `p` is outside 0 to 1.

        References
        ----------
        .. [1] ISO 25178-2:2021, 4.5.6 (number recalled, not checked).

        Examples
        --------
        >>> f"{abbott_curve(np.linspace(0, 1e-6, 10001)).material_volume(0.5):.4g}"
        '1.25e-07'
        """
        cut, above = self._cut(p)
        return float(np.add.reduce(self.heights[:above] - cut)) / self.heights.size

    def void_volume(self, p: float) -> float:
        """Return the void volume Vv(p) below the height at a material ratio.

        Parameters
        ----------
        p : float
            Material ratio, 0 to 1.

        Returns
        -------
        float
            Per unit of area (or length), m: the mean of max(mc(p) - z, 0) over the samples.

        Raises
        ------
        DataError
            If `p` is outside 0 to 1.

        Notes
        -----
        Vv(p) - Vm(p) = mc(p) - mean(z).

        References
        ----------
        .. [1] ISO 25178-2:2021, 4.5.7 (number recalled, not checked).
        """
        cut, above = self._cut(p)
        return float(np.add.reduce(cut - self.heights[above:])) / self.heights.size

    def _cut(self, p: float) -> tuple[float, int]:
        """Return the height of the cut and the number of samples above it."""
        cut = self.height(p)
        z = self.heights
        return cut, int(z.size - np.searchsorted(z[::-1], cut, side="right"))


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
        Heights; NaN are omitted.

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


# ---- material probability curve: pq, vq, mq of a surface made by two processes (ISO 13565-3) ----
# Against s, the normal deviate of the ratio, Gaussian heights are a straight line whose slope is
# their standard deviation. Plateau honing gives two lines: the plateau at high s, valleys at low s.

_LEAST_OF_PROBABILITY = 100
"""Heights: with fewer the outer tenth is a handful."""
_DEVIATE = 3.0
"""Range of s that is looked at, both sides."""
_POINTS = 2000
_NEAR, _OUTER = 0.10, 0.02
"""Shares of the points of a side that are left out of the second fit: at the knee and outside."""
_LEAST_SIDE, _LEAST_CHANGE = 0.05, 0.20
"""Share of the points on a side, and relative difference of the slopes, below which there is one
process only."""


@dataclass(frozen=True, slots=True)
class ProbabilityLines:
    """The two lines of a material probability curve.

    Parameters
    ----------
    pq, vq : float, m
        Slope of the plateau and of the valleys, per standard deviation: their own Rq.
    mq : float
        Material ratio where the lines meet, 0 to 1.
    """

    pq: float
    vq: float
    mq: float


def probability_lines(curve: AbbottCurve) -> ProbabilityLines:
    """Return the two lines of the material probability curve.

    Parameters
    ----------
    curve : AbbottCurve
        Of one map or profile.

    Returns
    -------
    ProbabilityLines
        Slopes and the ratio where they meet.

    Raises
    ------
    TooFewSamplesError
        If there are fewer than 100 heights.
    DegenerateFitError
        If the curve shows one process only: the valleys are not at least 20 % steeper than the
        plateau, or one of them has less than 5 % of the points.

    Notes
    -----
    Heights at 2000 equally spaced s within +-3 (where there are samples); two lines that meet at s0
    by least squares, for the s0 that leaves the least; then once more without the tenth of each side
    next to s0 and its outer 2 %. ISO 13565-3 fits a conic and bisects its asymptotes instead
    (recalled): results differ where the knee is wide.

    References
    ----------
    .. [1] ISO 13565-3:1998, ISO 21920-2:2021 (recalled, not checked).

    Examples
    --------
    >>> from scipy.special import ndtri
    >>> s = ndtri((np.arange(20000) + 0.5) / 20000)
    >>> found = probability_lines(abbott_curve(np.minimum(0.2e-6 * s, 1.3e-6 * s + 1.1e-6)))
    >>> f"{found.pq * 1e6:.3f} {found.vq * 1e6:.3f} {found.mq:.3f}"
    '0.200 1.300 0.841'
    """
    from scipy.special import ndtr, ndtri

    n = curve.heights.size
    if n < _LEAST_OF_PROBABILITY:
        raise TooFewSamplesError(
            f"a material probability curve needs {_LEAST_OF_PROBABILITY} heights or more, got {n}"
        )
    reach = min(_DEVIATE, float(-ndtri(0.5 / n)))
    s = np.linspace(-reach, reach, _POINTS)
    place = np.clip(n * ndtr(-s) - 0.5, 0.0, n - 1.0)  # of the middle of each height's share
    before = np.minimum(place.astype(np.intp), n - 2)
    c = curve.heights[before]
    c = c + (place - before) * (curve.heights[before + 1] - c)
    spread = float(c[-1] - c[0])
    if not spread > 0.0:
        raise DegenerateFitError("all heights are equal: there is no material probability curve")
    c = c / spread
    knee = _best_knee(s, c)
    left, right = (s < knee).sum(), (s >= knee).sum()
    low, high = np.flatnonzero(s < knee), np.flatnonzero(s >= knee)
    kept = np.concatenate(
        [
            low[round(_OUTER * left) : left - round(_NEAR * left)],
            high[round(_NEAR * right) : right - round(_OUTER * right)],
        ]
    )
    knee = _best_knee(s[kept], c[kept])
    (_, plateau, valley), _ = _two_lines(s[kept], c[kept], knee)
    share = float((s < knee).mean())
    if not (
        valley >= (1.0 + _LEAST_CHANGE) * plateau and _LEAST_SIDE <= share <= 1.0 - _LEAST_SIDE
    ):
        raise DegenerateFitError(
            "the material probability curve shows one process only: no knee below which it is "
            f"{100 * _LEAST_CHANGE:g} % steeper than above"
        )
    return ProbabilityLines(plateau * spread, valley * spread, float(ndtr(-knee)))


def _two_lines(
    s: FloatArray, c: FloatArray, knee: float
) -> tuple[tuple[float, float, float], float]:
    """Return height at the knee, slope above and below it, and what two lines leave, squared."""
    above, below = np.maximum(s - knee, 0.0), np.minimum(s - knee, 0.0)
    basis = np.stack([np.ones_like(s), above, below])
    gram = basis @ basis.T
    x = np.linalg.solve(gram, basis @ c)
    rest = c - x @ basis
    return (float(x[0]), float(x[1]), float(x[2])), float(rest @ rest)


def _best_knee(s: FloatArray, c: FloatArray) -> float:
    """Return where two lines meet that leave the least."""
    low, high = float(s[round(0.02 * s.size)]), float(s[-round(0.02 * s.size) - 1])
    best, step = 0.5 * (low + high), (high - low) / 100
    for trials in (np.arange(-50, 51), np.arange(-10, 11) / 10, np.arange(-10, 11) / 100):
        inside = [float(t) for t in best + step * trials if low <= t <= high]
        best = min(inside, key=lambda t: _two_lines(s, c, t)[1])
    return best
