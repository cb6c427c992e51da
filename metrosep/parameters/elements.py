"""Profile elements: crossing-the-line segmentation with height and spacing discrimination.

A profile element is a portion above the mean line and the neighbouring portion below it. Portions
that are too low (or too short) do not count: they join their neighbours. Positions of crossings
are interpolated between samples. A gap of missing samples ends an element; nothing is bridged.
Heights are out of the material, the mean line is z = 0.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray

from metrosep.core._arrays import FloatArray
from metrosep.core.errors import DataError, InvalidSamplesError

__all__ = ["ElementPairs", "ProfileElements", "profile_elements"]

ElementPairs = Literal["first", "both"]


@dataclass(frozen=True, slots=True, eq=False)
class ProfileElements:
    """The elements of a profile, in the order of x.

    Parameters
    ----------
    start : ndarray, shape (n,), m
        Position where each element begins: a crossing of the mean line.
    spacing : ndarray, shape (n,), m
        Width of each element, Xs.
    height : ndarray, shape (n,), m
        Peak height plus valley depth of each element, Zt.
    """

    start: FloatArray
    spacing: FloatArray
    height: FloatArray

    def __len__(self) -> int:
        return int(self.start.size)

    @property
    def mean_spacing(self) -> float:
        """RSm in m; NaN when there is no element."""
        return float(self.spacing.mean()) if len(self) else float("nan")

    @property
    def mean_height(self) -> float:
        """Rc in m; NaN when there is no element."""
        return float(self.height.mean()) if len(self) else float("nan")


@dataclass(frozen=True, slots=True, eq=False)
class _Portions:
    """Runs of one sign between the ends of a gapless trace."""

    left: FloatArray
    right: FloatArray
    extreme: FloatArray


def profile_elements(
    x: ArrayLike,
    z: ArrayLike,
    *,
    min_height: float,
    min_depth: float | None = None,
    min_width: float = 0.0,
    pairs: ElementPairs = "first",
) -> ProfileElements:
    """Return the profile elements of heights about z = 0.

    Parameters
    ----------
    x : array_like, shape (n,), m
        Positions, rising.
    z : array_like, shape (n,), m
        Heights about the mean line; NaN where not measured.
    min_height : float, m, >= 0
        Peaks lower than this do not count.
    min_depth : float, m, >= 0, optional
        Valleys less deep do not count; the same as `min_height` by default.
    min_width : float, m, >= 0, optional
        Portions narrower than this do not count.
    pairs : {"first", "both"}, optional
        "first" (1997): pairs of portions from the first crossing that survives, up or down.
        "both" (2021): each two neighbouring portions, a hill and the next dale or a dale and the
        next hill.

    Returns
    -------
    ProfileElements
        Possibly empty.

    Raises
    ------
    InvalidSamplesError
        If the arrays differ in shape or a position is not finite and rising.
    DataError
        If a threshold is negative or not finite, or `pairs` is unknown.

    Notes
    -----
    1. Crossings: linear between neighbours of opposite sign; a run of exact zeros between them
       crosses in its middle. 2. Portions below a threshold are dropped, and neighbours of one
       sign joined; the crossing that counts is the one next to the later portion. 3. Elements run
       from crossing to next but one; what touches an end or a gap is incomplete and left out.
       A portion that an end cuts below a threshold gives no crossing either with "first"; with
       "both" it joins nothing, and its neighbour keeps its own crossing. O(n).

    A dropped portion joins the one before it, so widths depend on the direction of x. ISO 21920-2
    looks in both: its Rsm and Rc are means over the elements of the profile and of its mirror image.

    References
    ----------
    .. [1] ISO 4287:1997, 3.2.7 and 4.3.1 (recalled); ISO 21920-2:2021 as Mahr describes it in
       public (MarSurf, surface parameters): both directions, 10 % of Rp and of Rv.

    Examples
    --------
    >>> import numpy as np
    >>> i = np.arange(400)
    >>> e = profile_elements(i * 1e-6, np.cos(2 * np.pi * i / 100), min_height=0.2)
    >>> len(e), round(e.mean_spacing * 1e6, 6)
    (3, 100.0)
    """
    xs, zs = np.asarray(x, dtype=np.float64), np.asarray(z, dtype=np.float64)
    if xs.ndim != 1 or xs.shape != zs.shape:
        raise InvalidSamplesError(
            f"x and z must be rows of one length, got {xs.shape}, {zs.shape}"
        )
    if not (np.isfinite(xs).all() and (np.diff(xs) > 0).all()):
        raise InvalidSamplesError("positions x must be finite and rise")
    depth = min_height if min_depth is None else min_depth
    for name, limit in (
        ("min_height", min_height),
        ("min_depth", depth),
        ("min_width", min_width),
    ):
        if not (np.isfinite(limit) and limit >= 0.0):
            raise DataError(f"{name} must be finite and not negative, got {limit}")
    if pairs not in ("first", "both"):
        raise DataError(f'pairs is "first" or "both", got {pairs!r}')
    found = [
        _elements_of_run(_portions(xs[run], zs[run]), min_height, depth, min_width, pairs)
        for run in _runs(~np.isnan(zs))
    ]
    joined = np.concatenate(found, axis=1) if found else np.empty((3, 0))
    return ProfileElements(start=joined[0], spacing=joined[1], height=joined[2])


def _runs(valid: NDArray[np.bool_]) -> list[slice]:
    """Return the slices of consecutive valid samples."""
    edges = np.flatnonzero(np.diff(np.concatenate([[False], valid, [False]]).astype(np.int8)))
    return [slice(int(a), int(b)) for a, b in edges.reshape(-1, 2)]


def _portions(x: FloatArray, z: FloatArray) -> _Portions:
    sign = np.sign(z)
    at = np.flatnonzero(sign)
    if at.size == 0:
        return _Portions(*(np.empty(0) for _ in range(3)))
    change = np.flatnonzero(sign[at[1:]] != sign[at[:-1]])
    before, after = at[change], at[change + 1]
    crossing = _crossings(x, z, before, after)
    first = np.concatenate([[0], after])
    peaks, valleys = np.maximum.reduceat(z, first), np.minimum.reduceat(z, first)
    return _Portions(
        left=np.concatenate([x[:1], crossing]),
        right=np.concatenate([crossing, x[-1:]]),
        extreme=np.where(peaks > -valleys, peaks, valleys),
    )


def _crossings(
    x: FloatArray, z: FloatArray, before: NDArray[np.intp], after: NDArray[np.intp]
) -> FloatArray:
    """Return where z passes 0 between samples `before` and `after`; only zeros lie between."""
    share = z[before] / (z[before] - z[after])
    linear = x[before] + share * (x[after] - x[before])
    middle = 0.5 * (x[np.minimum(before + 1, x.size - 1)] + x[after - 1])
    found: FloatArray = np.where(after - before > 1, middle, linear)
    return found


def _elements_of_run(
    p: _Portions, min_height: float, min_depth: float, min_width: float, pairs: ElementPairs
) -> FloatArray:
    """Return rows start, spacing, height of the complete elements of one run."""
    size = np.where(p.extreme > 0, min_height, min_depth)
    keep = np.flatnonzero((np.abs(p.extreme) >= size) & (p.right - p.left >= min_width))
    if keep.size < 2:
        return np.empty((3, 0))
    up = p.extreme[keep] > 0
    first = np.concatenate([[0], np.flatnonzero(up[1:] != up[:-1]) + 1])
    extreme = np.maximum.reduceat(np.abs(p.extreme[keep]), first)
    # merged portion k runs from left[k] to left[k + 1]; what was dropped belongs to the one before
    left = p.left[keep[first]]
    last = p.extreme.size - 1
    ends_low = pairs == "both" and keep[-1] < last
    edges = np.append(left, p.left[last]) if ends_low else left
    begin = 1 if pairs == "first" or keep[0] == 0 else 0
    at = np.arange(begin, edges.size - 2, 2 if pairs == "first" else 1)
    return np.stack([edges[at], edges[at + 2] - edges[at], extreme[at] + extreme[at + 1]])
