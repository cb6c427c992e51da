"""The catalogue of profile parameters: symbols in both editions, unit, reach and rule.

A row says over what a parameter reaches: "field" parameters are means of section values in 1997
and over the whole evaluation length in 2021.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from typing import Any, Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray

from metrosep.core._arrays import FloatArray
from metrosep.core.errors import DataError, InvalidSamplesError, TooFewSamplesError
from metrosep.core.numbers import choice, not_negative, positive
from metrosep.filters._arguments import ProfileKind
from metrosep.parameters.autocorrelation import dominant_wavelength
from metrosep.parameters.material_ratio import (
    PEAK,
    VALLEY,
    AbbottCurve,
    CoreHeight,
    CoreLine,
    ProbabilityLines,
    abbott_curve,
    core_height,
    probability_lines,
)
from metrosep.parameters.sections import Evaluation
from metrosep.parameters.table import Row
from metrosep.parameters.watershed import LARGEST_GAP, Ground, Peaks, ground_of, peaks_of

Edition = Literal["ISO 21920-2:2021", "ISO 4287:1997", "ASME B46.1"]

OLD: Edition = "ISO 4287:1997"
NEW: Edition = "ISO 21920-2:2021"
ASME: Edition = "ASME B46.1"

_EDITIONS: dict[str, Edition] = {
    "iso4287:1997": OLD,
    "iso4287": OLD,
    "iso21920-2:2021": NEW,
    "iso21920-2": NEW,
    "iso21920:2021": NEW,
    "asmeb46.1": ASME,
    "asmeb46.1:2019": ASME,
}

HEIGHT_THRESHOLD = 0.1
"""Portions below this share of Rz (1997), of Rp or Rv (2021) do not count for RSm and Rc."""

PRUNING = 0.05
"""Of Rz: peaks and pits that stand less above their saddle are pruned (Wolf)."""

SPACING_THRESHOLD = 0.01
"""Portions shorter than this share of a section do not count (1997 only)."""


def named_edition(edition: str) -> Edition:
    """Return the edition that a text names, spaces and case aside."""
    found = _EDITIONS.get("".join(str(edition).lower().split()))
    if found is None:
        raise DataError(f'edition is "{NEW}", "{OLD}" or "{ASME}", got {edition!r}')
    return found


class Work:
    """An evaluation with what several parameters share, worked out when first needed."""

    def __init__(self, evaluation: Evaluation, line: CoreLine) -> None:
        self.evaluation = evaluation
        self._line = line

    @cached_property
    def curve(self) -> AbbottCurve:
        return abbott_curve(self.evaluation.whole)

    @cached_property
    def core(self) -> CoreHeight:
        return core_height(self.curve.heights, line=self._line)

    @cached_property
    def probability(self) -> ProbabilityLines:
        return probability_lines(self.curve)

    @cached_property
    def ground(self) -> Ground:
        """Return the whole with its small gaps filled, for what is segmented alone."""
        return ground_of(self.evaluation.whole[None, :], largest_hole=LARGEST_GAP)

    @cached_property
    def elements(self) -> list[ProfileElements]:
        """Elements of each section (1997), or of the whole in both directions (2021); none empty."""
        return _elements(self.evaluation, self.filled)

    @cached_property
    def filled(self) -> FloatArray:
        """Return the heights with small gaps filled, NaN in longer ones."""
        z = self.ground.filled[0]
        return np.where(z == -np.inf, np.nan, z)

    @property
    def lateral(self) -> Work:
        """Return itself for what is a length along x; refused where x counts pixels."""
        _ = self.evaluation.dx
        return self

    @cached_property
    def peaks(self) -> Points:
        return self._points(1.0)

    @cached_property
    def pits(self) -> Points:
        return self._points(-1.0)

    def _points(self, side: float) -> Points:
        e = self.evaluation
        threshold = PRUNING * float(np.mean(e.section_values(lambda a: a.z)))
        ground = self.ground if side > 0.0 else self.ground.turned_over()
        return Points(side * e.whole, peaks_of(ground, threshold=threshold), e.step)

    def highest(self, ranks: slice, share: float) -> float:
        """Return the mean over the sections of hills and dales of these ranks."""
        e = self.evaluation
        least = share * float(np.mean(e.section_values(lambda a: a.z)))
        parts = _as_sections(e, self.filled)
        return float(np.mean([mean_of_highest(z, ranks, least) for z in parts]))

    def gradient(self, of: Callable[[Any], float]) -> float:
        e = self.evaluation
        if e.by_section:
            e.check_sections()
        traces = e.parts if e.by_section else (e.whole,)
        return float(np.mean([of(valid_gradient(z, dx=e.dx)) for z in traces]))


def _elements(e: Evaluation, z: FloatArray) -> list[ProfileElements]:
    found = _elements_of_sections(e, z) if e.by_section else [_elements_both_ways(e, z)]
    for k, elements in enumerate(found):
        if len(elements) == 0:
            where = f"section {k + 1} of {len(found)}" if e.by_section else "the evaluation length"
            raise TooFewSamplesError(
                f"{where} holds no complete profile element (three crossings of z = 0 between "
                "portions above the thresholds); use longer sections"
            )
    return found


def _elements_of_sections(e: Evaluation, z: FloatArray) -> list[ProfileElements]:
    heights = e.section_values(lambda a: a.z)
    return [
        profile_elements(
            x, part, min_height=HEIGHT_THRESHOLD * h, min_width=SPACING_THRESHOLD * float(width)
        )
        for x, part, h, width in zip(
            e.positions, _as_sections(e, z), heights, e.section_lengths, strict=True
        )
    ]


def _as_sections(e: Evaluation, z: FloatArray) -> list[FloatArray]:
    """Return heights over the evaluation length as its sections, which may be centred one by one."""
    if not np.isnan(e.whole).any():
        return list(e.parts)
    return [
        np.asarray(z[at] - np.nanmean(e.whole[at] - part))
        for at, part in zip(e.slices, e.parts, strict=True)
    ]


def _elements_both_ways(e: Evaluation, z: FloatArray) -> ProfileElements:
    """Return the elements of the whole and of its mirror image, thresholds of Rp and Rv."""
    # a profile on one side of z = 0 has a negative Rp or Rv, and no crossing
    limits = {
        "min_height": HEIGHT_THRESHOLD * max(float(np.mean(e.section_values(lambda a: a.p))), 0.0),
        "min_depth": HEIGHT_THRESHOLD * max(float(np.mean(e.section_values(lambda a: a.v))), 0.0),
    }
    one = profile_elements(e.x, z, pairs="both", **limits)
    other = profile_elements(-e.x[::-1], z[::-1], pairs="both", **limits)
    return ProfileElements(
        np.concatenate([one.start, -(other.start + other.spacing)]),
        np.concatenate([one.spacing, other.spacing]),
        np.concatenate([one.height, other.height]),
    )


def _mean_of_elements(work: Work, of: Callable[[ProfileElements], float]) -> float:
    return float(np.mean([of(e) for e in work.elements]))


@dataclass(frozen=True, slots=True)
class ProfileRow:
    """One parameter in both editions; symbols without kind, None where the edition lacks it."""

    old: str | None
    new: str | None
    unit: str
    what: str
    reach: Literal["field", "sections", "whole", "largest"]
    clause: str
    evaluate: Callable[[Work], float] | str
    asme: str | None = ""  # as in 2021 where empty

    def row(self, kind: ProfileKind, edition: Edition, e: Evaluation) -> Row:
        return Row(self.symbol(kind, edition), self.unit, self.text(edition, e), self.evaluate)

    def name(self, edition: Edition) -> str | None:
        """Return the symbol without kind, None where the edition lacks it."""
        if edition == ASME:
            return self.asme if self.asme != "" else self.new
        return self.old if edition == OLD else self.new

    def symbol(self, kind: ProfileKind, edition: Edition) -> str:
        name = self.name(edition)
        if name in ("Mr1", "Mr2", "A1", "A2") and kind == "R":
            return name
        return f"{kind}{name}"

    def text(self, edition: Edition, e: Evaluation) -> str:
        n = len(e.parts)
        by_section = self.reach == "sections" or (self.reach == "field" and e.by_section)
        if self.reach == "largest" and n > 1:
            over = (
                f"largest of {n} sections"
                if self.old is not None
                else (
                    f"largest in a window of one section length, {e.said(e.window * e.step)}, that "
                    "slides over the evaluation length"
                )
            )
        elif by_section and n > 1:
            over = f"mean of {n} sections"
        else:
            over = "over the evaluation length"
        source = self.clause if edition == OLD or self.new in ("zJIS", "3z") else edition
        alias = f"; {self.new or self.old} of ISO" if edition == ASME and self.asme else ""
        return f"{self.what}, {over} ({source}, recalled{alias})"


ROWS = (
    ProfileRow("a", "a", "m", "arithmetic mean height", "field", "ISO 4287:1997, 4.2.1",
         lambda w: w.evaluation.field(lambda h: h.a)),
    ProfileRow("q", "q", "m", "root mean square height", "field", "ISO 4287:1997, 4.2.2",
         lambda w: w.evaluation.field(lambda h: h.q)),
    ProfileRow("sk", "sk", "1", "skewness", "field", "ISO 4287:1997, 4.2.3",
         lambda w: w.evaluation.field(lambda h: h.sk)),
    ProfileRow("ku", "ku", "1", "kurtosis, 3 for Gauss", "field", "ISO 4287:1997, 4.2.4",
         lambda w: w.evaluation.field(lambda h: h.ku)),
    ProfileRow("p", "p", "m", "highest peak", "sections", "ISO 4287:1997, 4.1.1",
         lambda w: float(np.mean(w.evaluation.section_values(lambda h: h.p))), "pm"),
    ProfileRow("v", "v", "m", "deepest valley", "sections", "ISO 4287:1997, 4.1.2",
         lambda w: float(np.mean(w.evaluation.section_values(lambda h: h.v))), "vm"),
    ProfileRow("z", "z", "m", "highest peak plus deepest valley", "sections", "ISO 4287:1997, 4.1.3",
         lambda w: float(np.mean(w.evaluation.section_values(lambda h: h.z)))),
    ProfileRow("z1max", None, "m", "highest peak plus deepest valley", "largest", "ISO 4288:1996",
         lambda w: max(w.evaluation.section_values(lambda h: h.z)), "max"),
    ProfileRow(None, "zx", "m", "highest peak plus deepest valley", "largest", "",
         "evaluation.largest_height", None),
    ProfileRow(None, "pt", "m", "highest peak", "whole", "", "evaluation.amplitude.p", "p"),
    ProfileRow(None, "vt", "m", "deepest valley", "whole", "", "evaluation.amplitude.v", "v"),
    ProfileRow("t", "t", "m", "highest minus lowest sample", "whole", "ISO 4287:1997, 4.1.5",
         "evaluation.amplitude.z"),
    ProfileRow("c", "c", "m", "mean height of the profile elements", "field", "ISO 4287:1997, 4.1.4",
         lambda w: _mean_of_elements(w, lambda e: e.mean_height)),
    ProfileRow("Sm", "sm", "m", "mean width of the profile elements", "field", "ISO 4287:1997, 4.3.1",
         lambda w: _mean_of_elements(w.lateral, lambda e: e.mean_spacing)),
    ProfileRow("dq", "dq", "1", "root mean square gradient, 7-point", "field", "ISO 4287:1997, 4.4.1",
         lambda w: w.gradient(lambda g: float(np.sqrt(np.mean(g * g))))),
    ProfileRow(None, "da", "1", "mean absolute gradient, 7-point", "field", "",
         lambda w: w.gradient(lambda g: float(np.mean(np.abs(g))))),
    ProfileRow(None, "dt", "1", "largest absolute gradient, 7-point", "field", "",
         lambda w: w.gradient(lambda g: float(np.max(np.abs(g))))),
    ProfileRow(None, "dl", "m", "developed length", "whole", "",
         lambda w: developed_length(w.evaluation.whole, w.evaluation.dx)[0]),
    ProfileRow(None, "dr", "1", "developed length ratio, as a number (1 is 100 %)", "whole", "",
         lambda w: developed_length(w.evaluation.whole, w.evaluation.dx)[1]),
    ProfileRow(None, "sal", "m", "shortest lag at which the autocorrelation falls to 0.2", "whole", "",
         lambda w: autocorrelation_length(w.evaluation.whole, w.evaluation.dx)),
    ProfileRow(None, "sw", "m", "wavelength of the largest magnitude of the Fourier transform", "whole",
         "", lambda w: dominant_wavelength(w.evaluation.whole[None, :], w.evaluation.dx)),
    ProfileRow("k", "k", "m", "core height", "whole", "ISO 13565-2:1996", "core.k"),
    ProfileRow("pk", "pk", "m", "reduced peak height", "whole", "ISO 13565-2:1996",
         "core.pk"),
    ProfileRow("vk", "vk", "m", "reduced valley depth", "whole", "ISO 13565-2:1996",
         "core.vk"),
    ProfileRow("Mr1", "mrk1", "1", "material ratio at the top of the core", "whole",
         "ISO 13565-2:1996", "core.mr1"),
    ProfileRow("Mr2", "mrk2", "1", "material ratio at the bottom of the core", "whole",
         "ISO 13565-2:1996", "core.mr2"),
    ProfileRow(None, "pkx", "m", "height of the peaks above the core", "whole", "",
         "core.pkx"),
    ProfileRow(None, "vkx", "m", "depth of the valleys below the core", "whole", "",
         "core.vkx"),
    ProfileRow("A1", "ak1", "m", "peak area per unit of material ratio", "whole",
         "ISO 13565-2:1996", "core.a1"),
    ProfileRow("A2", "ak2", "m", "valley area per unit of material ratio", "whole",
         "ISO 13565-2:1996", "core.a2"),
    ProfileRow("pq", "pq", "m", "slope of the plateau on the material probability curve", "whole",
         "ISO 13565-3:1998", "probability.pq"),
    ProfileRow("vq", "vq", "m", "slope of the valleys on the material probability curve", "whole",
         "ISO 13565-3:1998", "probability.vq"),
    ProfileRow("mq", "mq", "1", "material ratio where plateau and valleys meet", "whole",
         "ISO 13565-3:1998", "probability.mq"),
    ProfileRow(None, "vmp", "m", "peak material volume per area, Vm(10 %)", "whole", "",
         lambda w: w.curve.material_volume(PEAK)),
    ProfileRow(None, "vmc", "m", "core material volume per area, Vm(80 %) - Vm(10 %)", "whole", "",
         lambda w: w.curve.material_volume(VALLEY) - w.curve.material_volume(PEAK)),
    ProfileRow(None, "vvc", "m", "core void volume per area, Vv(10 %) - Vv(80 %)", "whole", "",
         lambda w: w.curve.void_volume(PEAK) - w.curve.void_volume(VALLEY)),
    ProfileRow(None, "vvv", "m", "valley void volume per area, Vv(80 %)", "whole", "",
         lambda w: w.curve.void_volume(VALLEY)),
    ProfileRow(None, "pd", "1/m", "density of significant peaks", "whole", "", "lateral.peaks.density"),
    ProfileRow(None, "vd", "1/m", "density of significant pits", "whole", "", "lateral.pits.density"),
    ProfileRow(None, "mpc", "1/m", "mean curvature of the significant peaks", "whole", "",
         "lateral.peaks.curvature"),
    ProfileRow(None, "mvc", "1/m", "mean curvature of the significant pits, positive", "whole", "",
         "lateral.pits.curvature"),
    ProfileRow(None, "5p", "m", "mean height of the five highest significant peaks", "whole", "",
         "peaks.five"),
    ProfileRow(None, "5v", "m", "mean depth of the five deepest significant pits", "whole", "",
         "pits.five"),
    ProfileRow(None, "10z", "m", "ten-point height, 5p + 5v", "whole", "",
         lambda w: w.peaks.five + w.pits.five),
    ProfileRow("zJIS", "zJIS", "m", "mean of the five highest hills plus the five deepest dales",
         "sections", "JIS B 0601:2001", lambda w: w.highest(slice(0, 5), HEIGHT_THRESHOLD)),
    ProfileRow("3z", "3z", "m", "third highest hill plus third deepest dale", "sections",
         "a factory standard", lambda w: w.highest(slice(2, 3), 0.0)),
)  # fmt: skip


# ---- hybrid parameters: local gradient of a profile by the 7-point formula ---------------------
# The formula is exact for polynomials up to degree 6. It needs three valid neighbours on both
# sides; where one is missing there is no gradient, and nothing is filled.

_STENCIL = 7


def local_gradient(heights: ArrayLike, *, dx: float) -> FloatArray:
    """Return dz/dx at the samples with three valid neighbours on both sides.

    Source: ISO 4287:1997, 3.2.6 (recalled).

    Examples
    --------
    >>> local_gradient([0, 1, 2, 3, 4, 5, 6], dx=2.0)[3]
    np.float64(0.5)
    """
    z = np.asarray(heights, dtype=np.float64)
    dx = positive(dx, "the step dx", dimension="length")
    if z.ndim != 1 or np.isinf(z).any():
        raise InvalidSamplesError("heights for a gradient must be one row without infinite values")
    gradient = np.full(z.size, np.nan)
    if z.size >= _STENCIL:
        near = 45.0 * (z[4:-2] - z[2:-4])
        far = -9.0 * (z[5:-1] - z[1:-5]) + (z[6:] - z[:-6])
        complete = ~np.isnan(z[3:-3])
        gradient[3:-3] = np.where(complete, (near + far) / (60.0 * dx), np.nan)
    return gradient


def root_mean_square_gradient(heights: ArrayLike, *, dx: float) -> float:
    """Return dq, the root mean square of the local gradient.

    Source: ISO 4287:1997, 4.4.1 (recalled).

    Examples
    --------
    >>> root_mean_square_gradient([0, 1, 2, 3, 4, 5, 6], dx=2.0)
    0.5
    """
    return float(np.sqrt(np.mean(valid_gradient(heights, dx=dx) ** 2)))


def valid_gradient(heights: ArrayLike, *, dx: float) -> FloatArray:
    """Return the local gradients that exist."""
    gradient = local_gradient(heights, dx=dx)
    found: FloatArray = gradient[~np.isnan(gradient)]
    if found.size == 0:
        raise TooFewSamplesError(
            f"the gradient needs {_STENCIL} consecutive valid samples and there are none; use a "
            "longer profile or a smaller step"
        )
    return found


# ---- profile elements: crossing-the-line segmentation with height and spacing discrimination ----
# A profile element is a portion above the mean line and the neighbouring portion below it. Portions
# that are too low (or too short) do not count: they join their neighbours. Positions of crossings
# are interpolated between samples. A gap of missing samples ends an element; nothing is bridged.
# Heights are out of the material, the mean line is z = 0.

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
       from crossing to next but one; what touches an end or a gap is incomplete and omitted.
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
    min_height = not_negative(min_height, "min_height", dimension="length")
    depth = not_negative(depth, "min_depth", dimension="length")
    min_width = not_negative(min_width, "min_width", dimension="length")
    choice(pairs, "pairs", ("first", "both"))
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


# ---- spatial and feature parameters: sal, sw, dl, pd, mpc, 5p, zJIS, 3z and their kin -----------
# On bare heights at a uniform step, NaN = not measured. Gaps of at most LARGEST_GAP are filled where
# peaks, pits and elements are looked for, and only there.

_THRESHOLD = 0.2
"""Of the autocorrelation (default of ISO 21920-3 and ISO 25178-3)."""
_LEAST_PAIRS = 0.1
"""Fewest pairs at a lag as a share of the valid samples."""
FIVE = 5
_REACH = 3
"""Samples on each side of the 7-point derivatives."""
_SECOND = np.array([2.0, -27.0, 270.0, -490.0, 270.0, -27.0, 2.0]) / 180.0
_FIRST = np.array([-1.0, 9.0, -45.0, 0.0, 45.0, -9.0, 1.0]) / 60.0


def autocorrelation_length(z: FloatArray, dx: float) -> float:
    """Return al, the shortest lag at which the autocorrelation has fallen to 0.2, m.

    Products are counted over their pairs, about the mean; linear between lags (ISO 21920-2:2021,
    4.3, recalled).
    """
    from scipy import fft

    good = ~np.isnan(z)
    n = int(good.sum())
    d = np.where(good, z - np.nanmean(z), 0.0)
    scale = float(np.abs(d).max())
    if scale == 0.0:
        raise DataError("zero height: all samples are equal")
    size = fft.next_fast_len(2 * z.size, real=True)
    sums, pairs = (
        fft.irfft(np.square(np.abs(fft.rfft(v, size))), size)[: z.size // 2 + 1]
        for v in (d / scale, good.astype(np.float64))
    )
    enough = pairs > _LEAST_PAIRS * n
    acf = np.where(enough, sums / np.maximum(pairs, 1.0), np.nan)
    acf = acf / acf[0]
    below = np.flatnonzero(~(acf > _THRESHOLD))
    if below.size and np.isnan(acf[below[0]]):
        raise DataError(
            f"the autocorrelation is not known at a lag of {below[0]} samples, where it has not fallen to 0.2: "
            f"fewer than {100 * _LEAST_PAIRS:g} % of the samples have another one so far away"
        )
    if below.size == 0:
        raise DataError(
            "the autocorrelation is still above 0.2 at half the profile: the profile is too short "
            "for its texture, or form or waviness was not removed"
        )
    k = int(below[0])
    return float((k - (_THRESHOLD - acf[k]) / (acf[k - 1] - acf[k])) * dx)


def developed_length(z: FloatArray, dx: float) -> tuple[float, float]:
    """Return dl, the sum of sqrt(dx^2 + dz^2) over neighbours, and dr.

    Where one of the two is missing stands the mean of those that were measured, so that dr = dl / le - 1.
    """
    step = np.diff(z)
    step = step[~np.isnan(step)] / dx
    if step.size == 0:
        raise TooFewSamplesError("no two neighbouring samples were measured")
    # sqrt(1 + s^2) - 1 without cancellation for slopes of 1e-9
    excess = float(np.mean(step * step / (1.0 + np.sqrt(1.0 + step * step))))
    return (z.size - 1) * dx * (1.0 + excess), excess


# ---- peaks and pits after watershed and Wolf pruning, over the evaluation length ------------------


@dataclass(frozen=True, slots=True, eq=False)
class Points:
    """Significant peaks, or pits of a profile turned over."""

    z: FloatArray  # heights as evaluated, peaks upwards
    found: Peaks
    dx: float

    def __len__(self) -> int:
        return len(self.found)

    @property
    def density(self) -> float:
        """Number over the length that was measured or filled, 1/m."""
        measured = int(np.count_nonzero(self.found.filled > -np.inf))
        return len(self) / (measured * self.dx)

    @property
    def five(self) -> float:
        """Mean height of the five highest, or of all where there are fewer, m."""
        if len(self) == 0:
            raise TooFewSamplesError("no significant peak or pit inside the evaluation length")
        return float(np.mean(self.found.heights[:FIVE]))

    @property
    def curvature(self) -> float:
        """Mean curvature, positive, 1/m: 7-point z'' / (1 + z'^2)^1.5 with the sign turned."""
        at = self.found.columns
        at = at[(at >= _REACH) & (at < self.z.size - _REACH)]
        around = self.z[at[:, None] + np.arange(-_REACH, _REACH + 1)]
        around = around[~np.isnan(around).any(axis=1)]
        if around.size == 0:
            raise TooFewSamplesError(
                "no significant peak or pit has three measured samples on both sides"
            )
        slope, bend = around @ _FIRST / self.dx, around @ _SECOND / self.dx**2
        return float(np.mean(-bend / (1.0 + slope**2) ** 1.5))


# ---- RzJIS and R3z: highest portions of each section ----------------------------------------------


def mean_of_highest(z: FloatArray, ranks: slice, least: float) -> float:
    """Return the mean of the hills of these ranks plus that of the dales, between crossings of 0.

    Hills and dales lower than `least` do not count. Ranks from 0, the highest first.
    """
    sides = []
    for side, name in ((z, "hills"), (-z, "dales")):
        heights = _hills(side)
        heights = np.sort(heights[heights >= least])[::-1]
        if heights.size < ranks.stop:
            raise TooFewSamplesError(
                f"a section holds {heights.size} {name}, {ranks.stop} are needed; use longer sections"
            )
        sides.append(float(np.mean(heights[ranks])))
    return sides[0] + sides[1]


def _hills(z: FloatArray) -> FloatArray:
    """Return the extreme of each run of samples above zero."""
    up = np.concatenate([[False], np.nan_to_num(z, nan=-1.0) > 0.0, [False]])
    edges = np.flatnonzero(np.diff(up.astype(np.int8))).reshape(-1, 2)
    return np.array([z[a:b].max() for a, b in edges])
