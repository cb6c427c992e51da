"""Feature parameters of a map: significant peaks and pits after watershed and Wolf pruning.

A hill is the region from which all paths of steepest ascent, from pixel to pixel, end at the same
peak; its saddle is the highest point of its border. Wolf pruning takes the hill that stands lowest above its saddle,
joins it with the hill across that saddle, and goes on until every hill stands higher than the
threshold. Of two hills that meet the lower peak always goes, so the peaks that stay are those
whose height above the saddle that joins them to a higher one reaches the threshold; that needs
only the tree of highest saddles, which is the change tree.

A few missing pixels are not an edge: small holes are filled for the segmentation, and for it alone.
"""

from __future__ import annotations

import itertools
import math
from dataclasses import dataclass
from functools import cache, cached_property
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from metrosep.core._arrays import FloatArray, IntArray, frozen_float
from metrosep.core.blas import one_blas_thread
from metrosep.core.errors import DataError, InvalidSamplesError, TooFewSamplesError

_FIVE = 5

LARGEST_HOLE = 50
"""Pixels of a hole that is filled for the segmentation: metrology-2, 5.1 (a rule of this project)."""
LARGEST_GAP = 8
"""Samples of a gap of a profile that is filled likewise: a round hole of 50 pixels is as wide."""
_SOUND = 1e-6
"""Least over largest eigenvalue of a quadratic's equations: below, rounding and noise decide."""
_SIGMA = 2.0
"""Pixels, of the Gaussian weight around a filled pixel."""
_AMONG = 2.0 / 3.0
"""Of the window around a missing pixel at the border that must be measured: 20 % of dropouts leave
80 +- 4 %; beside the straight edge of a part half is measured, beside a round one less."""
_STRIP = 16
"""Rows that are looked at together."""
_NEAR, _FAR = 4, 8
"""Pixels around a filled one that its quadratic is fitted to; the second in the middle of a hole
as round as 50 pixels can be, where the first leaves too few."""


@dataclass(frozen=True, slots=True, eq=False)
class Peaks:
    """Significant peaks of a map, the highest first."""

    rows: IntArray  # shape (n,): pixels
    columns: IntArray
    heights: FloatArray  # shape (n,), m: as in the map
    # shape (n,), m: height above the saddle to a higher hill; above the lowest pixel of its region
    # for a peak that no saddle joins to a higher one: the highest of the map, or of an island in
    # holes
    prominences: FloatArray
    threshold: float  # m: least prominence that was asked for
    is_filled: NDArray[np.bool_]  # shape (n_y, n_x): pixels that were filled
    is_edge: NDArray[np.bool_]  # shape (n_y, n_x): border of the map or of a hole
    filled: FloatArray  # shape (n_y, n_x), m: heights with the filled pixels; -inf not measured
    # shape (n_y, n_x): hill of each pixel before pruning, 0 not measured; and what became of each: its
    # hill after pruning, which those have too whose peak is not given because it stands at an edge
    before: NDArray[np.int32]
    after: NDArray[np.int32]

    @property
    def hills(self) -> NDArray[np.int32]:
        """Hill of each pixel after pruning, 0 not measured, shape (n_y, n_x)."""
        return self.after.take(self.before)

    @property
    def n_hills(self) -> int:
        """Number of hills after pruning."""
        return int(self.after.max())

    @property
    def n_filled(self) -> int:
        """Number of pixels that were filled for the segmentation."""
        return int(np.count_nonzero(self.is_filled))

    @property
    def on_filled(self) -> NDArray[np.bool_]:
        """Whether each peak lies on a filled pixel, shape (n,)."""
        return np.asarray(self.is_filled[self.rows, self.columns])

    @property
    def beside_filled(self) -> NDArray[np.bool_]:
        """Whether each peak or one of its eight neighbours was filled, shape (n,)."""
        return np.asarray(np.any(_around(self.is_filled, self.rows, self.columns, 1), axis=1))

    def __len__(self) -> int:
        return int(self.heights.size)


def significant_peaks(
    z: ArrayLike,
    *,
    pruning: float = 0.05,
    largest_hole: int = LARGEST_HOLE,
    threshold: float | None = None,
) -> Peaks:
    """Return the peaks that stand a share of the total height, or a threshold, above their saddle.

    A map of one row is a profile.

    Neighbours are the eight pixels around one. A flat top is one peak, at the pixel nearest its
    middle. A hole of at most `largest_hole` pixels is filled by a quadratic through the measured
    pixels around each of its pixels: a dropout on a summit does not remove the hill. Where such a
    hole touches the border of the map, only pixels two thirds of whose surroundings were
    measured are filled. Sz, and with it the threshold, is that of the measured pixels.
    At the edge of the map or of a hole the highest pixel may be no more than the flank of
    a hill outside: it takes part in the pruning, but is not given as a peak. So the number of
    peaks over the area is not biased by the length of the edge. What joins an island that holes
    surround to the rest was not measured. Its highest peak counts by its height above the lowest
    pixel of the island, which is Sz for a map in one piece: there it always stays, as in Wolf
    pruning. The standard knows no islands. O(n log n).

    Source: ISO 25178-2:2021, clause 5; pruning 5 % from ISO 25178-3 (recalled, not checked).

    Examples
    --------
    >>> import numpy as np
    >>> c = np.cos(2 * np.pi * (np.arange(100) - 12) / 25)
    >>> len(significant_peaks(c[:, None] + c[None, :]))
    16
    """
    ground = ground_of(z, largest_hole=largest_hole)
    return peaks_of(ground, pruning=pruning, threshold=threshold)


@dataclass(frozen=True, eq=False)
class Ground:
    """A map that is ready to be segmented: its small holes are filled."""

    # shape (n_y, n_x), m: heights with the filled pixels, -inf where nothing was measured; as given
    filled: FloatArray
    heights: FloatArray
    is_filled: NDArray[np.bool_]  # shape (n_y, n_x): pixels that were filled
    is_edge: NDArray[np.bool_]  # shape (n_y, n_x): border of the map or of a hole; see `_at_edge`

    upright: Ground | None = None  # what this is upside down

    def turned_over(self) -> Ground:
        """Return the ground upside down: its peaks are the pits."""
        filled = np.negative(self.filled)
        filled[filled == math.inf] = -math.inf
        return Ground(filled, -self.heights, self.is_filled, self.is_edge, self)

    @cached_property
    def rings(self) -> tuple[NDArray[np.uint8], NDArray[np.uint8]]:
        """Bits of the ring around each pixel that are higher, and not lower; of a pixel not measured none."""
        if self.upright is None:
            return _rings(self.filled)
        known = _known_ring(self.filled > -math.inf)
        higher, not_lower = self.upright.rings
        return known & ~not_lower, known & ~higher


def ground_of(z: ArrayLike, *, largest_hole: int = LARGEST_HOLE) -> Ground:
    """Return a map with its holes of at most `largest_hole` pixels filled; see `significant_peaks`."""
    if isinstance(largest_hole, bool) or int(largest_hole) != largest_hole or largest_hole < 0:
        raise DataError(f"largest_hole is a whole number of pixels from 0, got {largest_hole!r}")
    heights = frozen_float(z, name="z", ndim=2)
    measured = heights == heights
    if not measured.any():
        raise InvalidSamplesError("no pixel is valid: there are no peaks")
    is_filled = _small_holes(measured, int(largest_hole))
    filled = _with_filled(heights, is_filled) if is_filled.any() else heights
    known = measured | is_filled
    return Ground(np.where(known, filled, -math.inf), heights, is_filled, _at_edge(known))


def peaks_of(ground: Ground, *, pruning: float = 0.05, threshold: float | None = None) -> Peaks:
    """Return the significant peaks of a ground; see `significant_peaks`."""
    if not 0.0 <= pruning < 1.0:
        raise DataError(f"pruning is a share of Sz from 0 to below 1, got {pruning}")
    heights, filled = ground.heights, ground.filled
    highest, lowest = float(np.nanmax(heights)), float(np.nanmin(heights))
    if highest == lowest:
        raise InvalidSamplesError("all heights are equal: there are no peaks")
    if threshold is None:
        threshold = pruning * (highest - lowest)
    measured = filled > -math.inf
    labels, tops, complete = _hills(filled, measured, ground.is_edge)
    prominences, hill = _prominences(
        *_saddles(ground, labels, tops.size), filled.reshape(-1)[tops], threshold
    )
    _limit_to_region(prominences, filled, measured, tops)
    # A flat shoulder ends its own paths, at no height above the saddle to the hill behind it.
    kept = np.nonzero((prominences >= threshold) & (prominences > 0.0) & complete)[0]
    kept = kept[np.argsort(-filled.reshape(-1)[tops[kept]], kind="stable")]
    rows, columns = np.divmod(tops[kept], heights.shape[1])
    return Peaks(
        rows,
        columns,
        filled[rows, columns],
        prominences[kept],
        threshold,
        ground.is_filled,
        ground.is_edge,
        filled,
        labels,
        np.append(np.int32(0), hill),
    )


def _small_holes(measured: NDArray[np.bool_], largest: int) -> NDArray[np.bool_]:
    """Return the pixels of the 8-connected holes up to a size.

    Of a hole at the border only those are given that lie among measured pixels: a dropout does, the
    outside of a round part does not.
    """
    from scipy import ndimage

    if measured.all():
        return np.zeros(measured.shape, dtype=bool)
    holes, n = ndimage.label(~measured, structure=np.ones((3, 3), dtype=bool))
    small = np.bincount(holes.reshape(-1), minlength=n + 1) <= largest
    small[0] = False
    at_border = np.zeros(n + 1, dtype=bool)
    ends = (holes[:, 0], holes[:, -1])
    for side in (holes[0], holes[-1], *ends) if measured.shape[0] > 1 else ends:
        at_border[side] = True
    wanted = small[holes]
    if (small & at_border).any():
        rows, columns = np.nonzero(wanted & at_border[holes])
        around = _around(
            np.pad(measured, _NEAR, mode="symmetric"), rows + _NEAR, columns + _NEAR, _NEAR
        )
        wanted[rows, columns] = around.mean(axis=1) > _AMONG
    return np.asarray(wanted)


def _with_filled(heights: FloatArray, wanted: NDArray[np.bool_]) -> FloatArray:
    """Return the heights with the wanted pixels filled, each from the measured ones around it."""
    out = heights.copy()
    margin = (_FAR if heights.shape[0] > 1 else 0, _FAR)
    wide = np.pad(heights, [(m, m) for m in margin], constant_values=np.nan)
    rows, columns = np.nonzero(wanted)
    for start in range(0, rows.size, 4096):  # windows of 4096 pixels are 10 MB
        some = slice(start, start + 4096)
        at = (rows[some] + margin[0]) * wide.shape[1] + columns[some] + margin[1]
        out[rows[some], columns[some]] = _quadratic(wide, at, _NEAR)
    rows, columns = np.nonzero(wanted & np.isnan(out))  # in the middle of a round hole
    if rows.size:
        at = (rows + margin[0]) * wide.shape[1] + columns + margin[1]
        out[rows, columns] = _quadratic(wide, at, _FAR)
    return out


def _quadratic(wide: FloatArray, at: IntArray, reach: int) -> FloatArray:
    """Return the weighted quadratic of the pixels within `reach` at each place of a flat map; NaN if too few.

    Without the six coefficients being determined (fewer pixels, or all on two lines) the near
    window gives NaN and the far one the solution of least norm.
    """
    dy, dx = (v.reshape(-1) for v in np.mgrid[-reach : reach + 1, -reach : reach + 1])
    is_map = wide.shape[0] > 1
    disc = dx * dx + dy * dy <= (reach * reach if is_map else np.where(dy, -1, reach * reach))
    dy, dx = dy[disc], dx[disc]
    weight = np.exp(-0.5 * (dx * dx + dy * dy) / _SIGMA**2)
    u, v = dx / reach, dy / reach
    terms = np.stack([np.ones_like(u), u, u * u, *((v, u * v, v * v) if is_map else ())], axis=1)
    z = wide.reshape(-1).take(at[:, None] + (dy * wide.shape[1] + dx))
    w = np.where(z == z, weight, 0.0)
    lowest = np.where(w > 0.0, z, math.inf).min(axis=1)
    highest = np.where(w > 0.0, z, -math.inf).max(axis=1)
    z[np.isnan(z)] = 0.0
    n = (w > 0.0).sum(axis=1)
    middle = z.sum(axis=1) / np.maximum(n, 1)
    squares = (terms[:, :, None] * terms[:, None, :]).reshape(dx.size, -1)
    with one_blas_thread():
        gram = (w @ squares).reshape(-1, terms.shape[1], terms.shape[1])
        right = (w * (z - middle[:, None])) @ terms
    constant, least = _constant_term(gram, right)
    sound = least > _SOUND * np.trace(gram, axis1=1, axis2=2)
    unsure = np.flatnonzero(~sound)  # a bound: the smallest eigenvalue itself decides
    values = np.linalg.eigvalsh(gram[unsure])
    sound[unsure] = values[:, 0] > _SOUND * values[:, -1]
    level = middle.copy()
    level[sound] += constant[sound]
    rest = np.nonzero(~sound)[0]
    if reach == _NEAR:
        level[rest] = np.nan
    else:
        for i in rest:
            level[i] += np.linalg.lstsq(gram[i], right[i], rcond=1e-6)[0][0]
    if is_map:
        return np.asarray(level)
    # with two sides only a quadratic swings in a gap: no height is made up that none of them has
    return np.asarray(np.where(n > 0, np.clip(level, lowest, highest), level))


def _constant_term(gram: FloatArray, right: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return the first unknown of many small symmetric systems, and a bound below their least eigenvalue.

    Elimination from the last unknown upwards, for all systems at once. With the determinant D, which is
    the product of the pivots, and the trace T of n unknowns the least eigenvalue is at least
    D ((n - 1) / T)^(n - 1). NaN where a pivot is 0.
    """
    n = right.shape[1]
    a, b = np.moveaxis(gram, 0, -1).copy(), right.T.copy()
    trace = np.einsum("iik->k", a)
    with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
        determinant = np.ones_like(trace)
        for j in range(n - 1, 0, -1):
            determinant *= np.maximum(a[j, j], 0.0)
            for i in range(j):
                factor = a[j, i] / a[j, j]
                a[i, : i + 1] -= factor * a[j, : i + 1]
                b[i] -= factor * b[j]
        determinant *= np.maximum(a[0, 0], 0.0)
        least = determinant * ((n - 1) / trace) ** (n - 1)
        return b[0] / a[0, 0], np.nan_to_num(least)


def _hills(
    filled: FloatArray, measured: NDArray[np.bool_], is_edge: NDArray[np.bool_]
) -> tuple[NDArray[np.int32], IntArray, NDArray[np.bool_]]:
    """Return the hill of each pixel (from 1; 0 not measured), and of each peak: index and inside.

    The index is that of the flat map. Inside means that all pixels around the peak were measured.
    """
    target = _steepest_ascent(filled)
    ends = target == np.arange(filled.size).reshape(filled.shape)
    summits = ends & measured
    index = np.flatnonzero(summits)
    of, n = _flat_tops(summits, index)
    ways = target.reshape(-1)
    further = ways.take(ways)
    at = np.flatnonzero(further != ways)
    while at.size:  # each step doubles the way; the others have arrived
        ways = further
        further = ways.copy()
        here = ways.take(at)
        there = ways.take(here)
        further[at] = there
        at = at[there != here]
    markers = np.zeros(filled.size, dtype=np.int32)
    markers[index] = of + 1
    labels = markers.take(ways).reshape(filled.shape)
    labels[~measured] = 0
    # Of a flat top: the pixel nearest its middle.
    rows, columns = np.divmod(index, filled.shape[1])
    size = np.bincount(of, minlength=n)
    middle_y = np.bincount(of, rows, minlength=n) / size
    middle_x = np.bincount(of, columns, minlength=n) / size
    off = (rows - middle_y[of]) ** 2 + (columns - middle_x[of]) ** 2
    order = np.lexsort((off, of))
    first = np.searchsorted(of[order], np.arange(n))
    open_ = np.bincount(of, is_edge.reshape(-1)[index], minlength=n) > 0
    return labels, index[order[first]], ~open_


def _flat_tops(summits: NDArray[np.bool_], index: IntArray) -> tuple[IntArray, int]:
    """Return the number of the top that each summit pixel belongs to, from 0, and how many tops there are."""
    from scipy import ndimage

    touch = (summits[1:] & summits[:-1]).any() or (summits[:, 1:] & summits[:, :-1]).any()
    touch = touch or (summits[1:, 1:] & summits[:-1, :-1]).any()
    if not touch and not (summits[1:, :-1] & summits[:-1, 1:]).any():
        return np.arange(index.size), index.size
    markers, n = ndimage.label(summits, structure=np.ones((3, 3), dtype=bool))
    return markers.reshape(-1)[index].astype(np.intp) - 1, n


def _at_edge(measured: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """Return the pixels at the border of the map (of a row: its ends) or beside one not measured."""
    is_map = measured.shape[0] > 1
    inside = measured.copy()
    if not measured.all():
        for axis in (1, 0) if is_map else (1,):  # three in a row, along both axes
            line = np.moveaxis(inside, axis, 0)
            before = line.copy()
            line[1:] &= before[:-1]
            line[:-1] &= before[1:]
    inside[:, 0] = inside[:, -1] = False
    if is_map:
        inside[0] = inside[-1] = False
    return ~inside


def _steepest_ascent(filled: FloatArray) -> NDArray[np.int64]:
    """Return the flat index of the highest of the nine pixels around each, itself on a tie."""
    n_y, n_x = filled.shape
    padded = np.pad(filled, 1, constant_values=-math.inf)
    target = np.arange(filled.size).reshape(filled.shape)
    ways = [(dy, dx) for dy, dx in itertools.product((-1, 0, 1), repeat=2) if (dy, dx) != (0, 0)]
    step = np.array([0, *(dy * n_x + dx for dy, dx in ways)])
    for start in range(0, n_y, _STRIP):  # strips that stay in the cache
        stop = min(start + _STRIP, n_y)
        best = filled[start:stop].copy()
        way = np.zeros(best.shape, dtype=np.uint8)
        for number, (dy, dx) in enumerate(ways, start=1):
            neighbour = padded[1 + dy + start : 1 + dy + stop, 1 + dx : 1 + dx + n_x]
            # The largest number is the last that was higher than all before it.
            np.maximum(way, (neighbour > best) * np.uint8(number), out=way)
            np.maximum(best, neighbour, out=best)
        target[start:stop] += step[way]
    return target


def _prominences(
    key: IntArray, saddle: FloatArray, tops: FloatArray, threshold: float
) -> tuple[FloatArray, NDArray[np.int32]]:
    """Return the height of each peak above the saddle to a higher one, and its hill after pruning.

    Hills count from 1. A hill that is pruned goes to the one across its saddle, with all that it took
    before: what joined it stands still less above its own saddle.
    """
    n = tops.size
    a, b = np.divmod(key, n)  # the hills that touch; later those that stand for them
    prominence, name = np.full(n, math.inf), np.arange(n)
    pruned: list[IntArray] = []
    while saddle.size:
        # Across its own highest saddle a hill ends if what it meets there is higher: nothing joined
        # it before, and the other side can only be higher yet.
        highest = np.full(tops.size, -math.inf)
        for side in (a, b):
            np.maximum.at(highest, side, saddle)
        own = np.full(tops.size, np.iinfo(np.int64).max)  # of equal saddles that of the least key
        sides = []
        for side, far in ((a, b), (b, a)):
            at = np.flatnonzero(saddle == highest.take(side))
            sides.append((side.take(at), far.take(at), key.take(at)))
            np.minimum.at(own, sides[-1][0], sides[-1][2])
        other = np.full(tops.size, -1)
        for side, far, of in sides:
            mine = np.flatnonzero(of == own.take(side))
            other[side.take(mine)] = far.take(mine)
        joined = np.flatnonzero(other >= 0)
        into = other[joined]
        ends = (tops[joined] < tops[into]) | ((tops[joined] == tops[into]) & (joined > into))
        joined, into = joined[ends], into[ends]
        height = tops[joined] - highest[joined]
        prominence[name[joined]] = height
        low = (height < threshold) | (height <= 0.0)
        pruned.append(own[joined[low]])
        stands = np.arange(tops.size)
        stands[joined] = into
        while not np.array_equal(further := stands[stands], stands):
            stands = further
        a, b = stands.take(a), stands.take(b)
        left = np.flatnonzero(a != b)
        a, b, saddle, key = a.take(left), b.take(left), saddle.take(left), key.take(left)
        still = np.zeros(tops.size, dtype=bool)  # hills are counted anew: few of them are left
        still[a] = still[b] = True
        number = np.cumsum(still) - 1
        a, b, tops, name = number.take(a), number.take(b), tops[still], name[still]
    pairs = np.concatenate(pruned) if pruned else np.empty(0, dtype=np.intp)
    return prominence, _joined(*np.divmod(pairs, n), n)


def _joined(a: IntArray, b: IntArray, n: int) -> NDArray[np.int32]:
    """Return the number, from 1, of the group that each of n hills belongs to."""
    from scipy.sparse import coo_array
    from scipy.sparse.csgraph import connected_components

    joined = coo_array((np.ones(a.size, dtype=np.int8), (a, b)), shape=(n, n))
    return np.asarray(connected_components(joined, directed=False)[1] + 1, dtype=np.int32)


def _limit_to_region(
    prominence: FloatArray, filled: FloatArray, measured: NDArray[np.bool_], tops: IntArray
) -> None:
    """Give peaks without a higher neighbour, in place, their height over their region's lowest."""
    from scipy import ndimage

    alone = np.nonzero(np.isinf(prominence))[0]
    if alone.size == 1:  # a map in one piece
        prominence[alone] = filled.reshape(-1)[tops[alone]] - filled[measured].min()
        return
    regions, n = ndimage.label(measured, structure=np.ones((3, 3), dtype=bool))
    lowest = np.asarray(ndimage.minimum(filled, regions, np.arange(1, n + 1)))
    at = tops[alone]
    prominence[alone] = filled.reshape(-1)[at] - lowest[regions.reshape(-1)[at] - 1]


def _saddles(ground: Ground, labels: NDArray[np.int32], n: int) -> tuple[IntArray, FloatArray]:
    """Return where hills touch: n times the lower number, from 0, plus the higher one; and heights.

    A pixel joins its hill to those of the higher pixels around it, at its own height. Where all of
    these touch one another, they are joined higher up already, and nothing that is joined twice ends
    at the lower saddle: only pixels count around which the higher ones fall apart, or of which a
    neighbour is as high. A pair may occur more than once.
    """
    fall_apart = _parts_of_a_ring() > 1
    keys: list[IntArray] = []
    levels: list[FloatArray] = []
    higher, not_lower = (v.reshape(-1) for v in ground.rings)
    flat, heights, width = labels.reshape(-1), ground.filled.reshape(-1), labels.shape[1]
    strip = _STRIP * width  # pixels that stay in the cache
    for start in range(0, flat.size, strip):
        part = slice(start, start + strip)
        here = np.flatnonzero(fall_apart[higher[part]] | (higher[part] != not_lower[part]))
        here += start
        wanted, own, level = not_lower.take(here), flat.take(here), heights.take(here)
        before = own  # the hill of the ring's last pixel, its own where that does not count
        for bit, (dy, dx) in enumerate(_RING):
            # beyond the map is nothing that is not lower
            hill = flat.take(here + (dy * width + dx), mode="clip")
            hill = np.where(wanted & np.uint8(1 << bit), hill, own)
            at = np.flatnonzero((hill != own) & (hill != before))
            a, b = own.take(at).astype(np.intp), hill.take(at).astype(np.intp)
            keys.append((np.minimum(a, b) - 1) * n + np.maximum(a, b) - 1)
            levels.append(level.take(at))
            before = hill
    return np.concatenate(keys), np.concatenate(levels)


def _rings(filled: FloatArray) -> tuple[NDArray[np.uint8], NDArray[np.uint8]]:
    """Return what `Ground.rings` does, from the heights."""
    n_y, n_x = filled.shape
    padded = np.pad(filled, 1, constant_values=-math.inf)
    higher, not_lower = (np.zeros(filled.shape, dtype=np.uint8) for _ in range(2))
    for start in range(0, n_y, _STRIP):  # strips that stay in the cache
        stop = min(start + _STRIP, n_y)
        middle = filled[start:stop]
        for bit, (dy, dx) in enumerate(_RING):
            neighbour = padded[1 + dy + start : 1 + dy + stop, 1 + dx : 1 + dx + n_x]
            higher[start:stop] |= (neighbour > middle).view(np.uint8) << np.uint8(bit)
            not_lower[start:stop] |= (neighbour >= middle).view(np.uint8) << np.uint8(bit)
        for bits in (higher, not_lower):
            bits[start:stop][middle == -math.inf] = 0
    return higher, not_lower


def _known_ring(measured: NDArray[np.bool_]) -> NDArray[np.uint8]:
    """Return bits of the ring around each measured pixel that were measured."""
    n_y, n_x = measured.shape
    padded = np.pad(measured.view(np.uint8), 1)
    known = np.zeros(measured.shape, dtype=np.uint8)
    for bit, (dy, dx) in enumerate(_RING):
        known |= padded[1 + dy : 1 + dy + n_y, 1 + dx : 1 + dx + n_x] << np.uint8(bit)
    known[~measured] = 0
    return known


_RING = ((-1, 0), (-1, 1), (0, 1), (1, 1), (1, 0), (1, -1), (0, -1), (-1, -1))
"""Steps (y, x) to the eight neighbours, around the pixel; the even ones share a side with it."""


@cache
def _parts_of_a_ring() -> NDArray[np.uint8]:
    """Return, for each set of pixels of the ring, how many parts do not touch one another."""
    parts = np.zeros(256, dtype=np.uint8)
    for bits in range(256):
        left = {k for k in range(8) if bits >> k & 1}
        while left:
            parts[bits] += 1
            reached = {left.pop()}
            while reached:  # pixels of two sides meet in a corner
                near = {
                    (k + d) % 8 for k in reached for d in ((-1, 1) if k % 2 else (-2, -1, 1, 2))
                }
                reached = near & left
                left -= reached
    return parts


def five_point_height(peaks: Peaks, mean: float) -> float:
    """Return S5p, the mean height of the five highest significant peaks above the mean.

    Source: ISO 25178-2:2021, clause 5.8 (S5p, S5v, S10z; recalled, not checked).
    """
    if len(peaks) < _FIVE:
        raise TooFewSamplesError(
            f"the mean is that of five significant peaks or pits, and the map has {len(peaks) or 'none'}; "
            "map a larger area, or prune less"
        )
    return float(np.mean(peaks.heights[:_FIVE] - mean))


def mean_peak_curvature(
    z: ArrayLike, peaks: Peaks, dx: float, dy: float, *, reach: int = 1
) -> float:
    """Return Spc, the mean of the principal curvatures over the significant peaks.

    -(d2z/dx2 + d2z/dy2) / 2 of the least-squares quadratic through the pixels within `reach` of the
    peak: 3 x 3, or 5 x 5 where noise of single pixels matters. Peaks with a filled or missing pixel
    among them are omitted. A noisy pixel is a sharp peak: filter first.

    Source: ISO 25178-2:2021, clause 5.8 (Spc; recalled, not checked).
    """
    if len(peaks) == 0:
        raise TooFewSamplesError("no significant peak inside the map, so no curvature")
    heights = np.asarray(z, dtype=np.float64)
    if peaks.n_filled:
        heights = np.where(peaks.is_filled, np.nan, heights)
    n_y, n_x = heights.shape
    y, x = peaks.rows, peaks.columns
    inside = (y >= reach) & (y < n_y - reach) & (x >= reach) & (x < n_x - reach)
    # On a square window t^2 less its mean is at right angles to all other terms of the quadratic.
    t = np.arange(-reach, reach + 1)
    square = t * t - np.mean(t * t)
    bend = 2.0 * square / (square @ square * t.size)
    flat, at = heights.reshape(-1), y[inside] * n_x + x[inside]
    top, both = flat[at], np.zeros(at.size)
    for i, j in itertools.product(range(t.size), repeat=2):
        both += (flat[at + (t[i] * n_x + t[j])] - top) * (bend[j] / dx**2 + bend[i] / dy**2)
    both = both[~np.isnan(both)]
    if both.size == 0:
        raise TooFewSamplesError(
            f"each of the {len(peaks)} significant peaks lies on or beside a missing pixel, so no "
            "curvature was measured"
        )
    return float(np.mean(-0.5 * both))


def _around(values: NDArray[Any], rows: IntArray, columns: IntArray, reach: int) -> NDArray[Any]:
    """Return the values of the square window around each pixel, shape (n, (2 reach + 1)^2)."""
    steps = np.arange(-reach, reach + 1)
    y = rows[:, None, None] + steps[:, None]
    x = columns[:, None, None] + steps
    return np.asarray(values[y, x].reshape(rows.size, steps.size**2))


@dataclass(frozen=True, slots=True)
class Hills:
    """Area and volume of closed hills at a height, means over the hills that reach it."""

    n_closed: int
    n_open: int
    mean_area: float  # m^2
    mean_volume: float  # m^3, above the height


def closed_hills(peaks: Peaks, height: float, dx: float, dy: float) -> Hills:
    """Return the mean area and volume of the closed hills above a height.

    A hill is all pixels that the segmentation gives to one peak after pruning, at or above the
    height; it is closed where none of these is at the border of the map or of a hole that was not
    filled. Hills that meet above the height are told apart by their labels.

    Source: ISO 25178-2:2021 (Sha, Shv; recalled); "closed" is read as no contact with the border
       at this height.
    """
    high = np.flatnonzero(peaks.filled >= height)
    edge = peaks.is_edge.reshape(-1)
    size = peaks.n_hills + 1
    label = peaks.after.take(peaks.before.take(high))
    z = peaks.filled.take(high)
    area = np.bincount(label, minlength=size)
    volume = np.bincount(label, z - height, minlength=size)
    touches = np.bincount(label, edge[high], minlength=size) > 0
    reaching = area > 0
    closed = reaching & ~touches
    n = int(closed.sum())
    if n == 0:
        raise TooFewSamplesError(
            "no hill or dale is closed at this height: each one touches the border of the map or of "
            "a hole; map a larger area or choose another ratio"
        )
    cell = dx * dy
    return Hills(
        n,
        int(reaching.sum()) - n,
        float(area[closed].mean()) * cell,
        float(volume[closed].mean()) * cell,
    )
