"""The catalogue of profile parameters: symbols in both editions, unit, reach and rule.

A row says over what a parameter reaches: "field" parameters are means of section values in 1997
and over the whole evaluation length in 2021.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np
from numpy.typing import ArrayLike

from metrosep.core._arrays import FloatArray
from metrosep.core.errors import DataError, InvalidSamplesError, TooFewSamplesError
from metrosep.core.units import format_length
from metrosep.filters.kind import ProfileKind
from metrosep.parameters._rows import Row
from metrosep.parameters.elements import ProfileElements, profile_elements
from metrosep.parameters.material_ratio import CoreHeight, CoreLine, abbott_curve, core_height
from metrosep.parameters.sections import Evaluation

__all__ = [
    "HEIGHT_THRESHOLD",
    "NEW",
    "OLD",
    "ROWS",
    "SPACING_THRESHOLD",
    "Edition",
    "ProfileRow",
    "Work",
    "named_edition",
]

Edition = Literal["ISO 21920-2:2021", "ISO 4287:1997"]

OLD: Edition = "ISO 4287:1997"
NEW: Edition = "ISO 21920-2:2021"

_EDITIONS: dict[str, Edition] = {
    "iso4287:1997": OLD,
    "iso4287": OLD,
    "iso21920-2:2021": NEW,
    "iso21920-2": NEW,
    "iso21920:2021": NEW,
}

HEIGHT_THRESHOLD = 0.1
"""Portions below this share of Rz (1997), of Rp or Rv (2021) do not count for RSm and Rc."""

SPACING_THRESHOLD = 0.01
"""Portions shorter than this share of a section do not count (1997 only)."""


def named_edition(edition: str) -> Edition:
    """Return the edition that a text names, spaces and case aside."""
    found = _EDITIONS.get("".join(str(edition).lower().split()))
    if found is None:
        raise DataError(f'edition is "{NEW}" or "{OLD}", got {edition!r}')
    return found


class Work:
    """An evaluation with what several parameters share, worked out when first needed."""

    def __init__(self, evaluation: Evaluation, line: CoreLine) -> None:
        self.evaluation = evaluation
        self._line = line
        self._core: CoreHeight | None = None
        self._elements: list[ProfileElements] | None = None

    @property
    def core(self) -> CoreHeight:
        if self._core is None:
            curve = abbott_curve(self.evaluation.whole)
            self._core = core_height(curve.heights, line=self._line)
        return self._core

    @property
    def elements(self) -> list[ProfileElements]:
        """Elements of each section (1997), or of the whole in both directions (2021); none empty."""
        if self._elements is None:
            self._elements = _elements(self.evaluation)
        return self._elements

    def gradient(self, of: Callable[[Any], float]) -> float:
        e = self.evaluation
        if e.by_section:
            e.check_sections()
        traces = e.parts if e.by_section else (e.whole,)
        return float(np.mean([of(valid_gradient(z, dx=e.dx)) for z in traces]))


def _elements(e: Evaluation) -> list[ProfileElements]:
    found = _elements_of_sections(e) if e.by_section else [_elements_both_ways(e)]
    for k, elements in enumerate(found):
        if len(elements) == 0:
            where = f"section {k + 1} of {len(found)}" if e.by_section else "the evaluation length"
            raise TooFewSamplesError(
                f"{where} holds no complete profile element (three crossings of z = 0 between "
                "portions above the thresholds); use longer sections"
            )
    return found


def _elements_of_sections(e: Evaluation) -> list[ProfileElements]:
    heights = e.section_values(lambda a: a.z)
    return [
        profile_elements(
            x, z, min_height=HEIGHT_THRESHOLD * h, min_width=SPACING_THRESHOLD * float(width)
        )
        for x, z, h, width in zip(e.positions, e.parts, heights, e.section_lengths, strict=True)
    ]


def _elements_both_ways(e: Evaluation) -> ProfileElements:
    """Return the elements of the whole and of its mirror image, thresholds of Rp and Rv."""
    # a profile on one side of z = 0 has a negative Rp or Rv, and no crossing
    limits = {
        "min_height": HEIGHT_THRESHOLD * max(float(np.mean(e.section_values(lambda a: a.p))), 0.0),
        "min_depth": HEIGHT_THRESHOLD * max(float(np.mean(e.section_values(lambda a: a.v))), 0.0),
    }
    one = profile_elements(e.x, e.whole, pairs="both", **limits)
    other = profile_elements(-e.x[::-1], e.whole[::-1], pairs="both", **limits)
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
    evaluate: Callable[[Work], float]

    def row(self, kind: ProfileKind, edition: Edition, e: Evaluation) -> Row:
        return Row(self.symbol(kind, edition), self.unit, self.text(edition, e), self.evaluate)

    def symbol(self, kind: ProfileKind, edition: Edition) -> str:
        name = self.old if edition == OLD else self.new
        if name in ("Mr1", "Mr2", "A1", "A2") and kind == "R":
            return name
        return f"{kind}{name}"

    def text(self, edition: Edition, e: Evaluation) -> str:
        n = len(e.parts)
        by_section = self.reach == "sections" or (self.reach == "field" and e.by_section)
        if self.reach == "largest" and n > 1:
            over = (
                f"largest of {n} sections"
                if e.by_section
                else (
                    f"largest in a window of one section length, {format_length(e.window * e.dx)}, that "
                    "slides over the evaluation length"
                )
            )
        elif by_section and n > 1:
            over = f"mean of {n} sections"
        else:
            over = "over the evaluation length"
        source = self.clause if edition == OLD else edition
        return f"{self.what}, {over} ({source}, recalled)"


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
         lambda w: float(np.mean(w.evaluation.section_values(lambda h: h.p)))),
    ProfileRow("v", "v", "m", "deepest valley", "sections", "ISO 4287:1997, 4.1.2",
         lambda w: float(np.mean(w.evaluation.section_values(lambda h: h.v)))),
    ProfileRow("z", "z", "m", "highest peak plus deepest valley", "sections", "ISO 4287:1997, 4.1.3",
         lambda w: float(np.mean(w.evaluation.section_values(lambda h: h.z)))),
    ProfileRow("z1max", "zx", "m", "highest peak plus deepest valley", "largest", "ISO 4288:1996",
         lambda w: w.evaluation.largest_height),
    ProfileRow("t", "t", "m", "highest minus lowest sample", "whole", "ISO 4287:1997, 4.1.5",
         lambda w: w.evaluation.amplitude.z),
    ProfileRow("c", "c", "m", "mean height of the profile elements", "field", "ISO 4287:1997, 4.1.4",
         lambda w: _mean_of_elements(w, lambda e: e.mean_height)),
    ProfileRow("Sm", "sm", "m", "mean width of the profile elements", "field", "ISO 4287:1997, 4.3.1",
         lambda w: _mean_of_elements(w, lambda e: e.mean_spacing)),
    ProfileRow("dq", "dq", "1", "root mean square gradient, 7-point", "field", "ISO 4287:1997, 4.4.1",
         lambda w: w.gradient(lambda g: float(np.sqrt(np.mean(g * g))))),
    ProfileRow(None, "da", "1", "mean absolute gradient, 7-point", "field", "",
         lambda w: w.gradient(lambda g: float(np.mean(np.abs(g))))),
    ProfileRow("k", "k", "m", "core height", "whole", "ISO 13565-2:1996", lambda w: w.core.k),
    ProfileRow("pk", "pk", "m", "reduced peak height", "whole", "ISO 13565-2:1996",
         lambda w: w.core.pk),
    ProfileRow("vk", "vk", "m", "reduced valley depth", "whole", "ISO 13565-2:1996",
         lambda w: w.core.vk),
    ProfileRow("Mr1", "mrk1", "1", "material ratio at the top of the core", "whole",
         "ISO 13565-2:1996", lambda w: w.core.mr1),
    ProfileRow("Mr2", "mrk2", "1", "material ratio at the bottom of the core", "whole",
         "ISO 13565-2:1996", lambda w: w.core.mr2),
    ProfileRow(None, "pkx", "m", "height of the peaks above the core", "whole", "",
         lambda w: w.core.pkx),
    ProfileRow(None, "vkx", "m", "depth of the valleys below the core", "whole", "",
         lambda w: w.core.vkx),
    ProfileRow("A1", "ak1", "m", "peak area per unit of material ratio", "whole",
         "ISO 13565-2:1996", lambda w: w.core.a1),
    ProfileRow("A2", "ak2", "m", "valley area per unit of material ratio", "whole",
         "ISO 13565-2:1996", lambda w: w.core.a2),
)  # fmt: skip


# ---- hybrid parameters: local gradient of a profile by the 7-point formula ---------------------
# The formula is exact for polynomials up to degree 6. It needs three valid neighbours on both
# sides; where one is missing there is no gradient, and nothing is filled.

_STENCIL = 7


def local_gradient(heights: ArrayLike, *, dx: float) -> FloatArray:
    """Return dz/dx at the samples with three valid neighbours on both sides.

    References
    ----------
    .. [1] ISO 4287:1997, 3.2.6 (recalled).

    Examples
    --------
    >>> local_gradient([0, 1, 2, 3, 4, 5, 6], dx=2.0)[3]
    np.float64(0.5)
    """
    z = np.asarray(heights, dtype=np.float64)
    if not (np.isfinite(dx) and dx > 0.0):
        raise DataError(f"the step dx must be finite and positive, got {dx}")
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

    References
    ----------
    .. [1] ISO 4287:1997, 4.4.1 (recalled).

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
