"""Sections of an evaluation length, and which parameter looks at which of them.

ISO 4287:1997 evaluates most parameters in each section (sampling length) and gives their mean;
ISO 21920-2:2021 evaluates most over the whole evaluation length and keeps sections for p, v and z.
Sections have equal length in x; where the samples do not divide, they differ by one sample.
Each counts alike in a mean, so one with less than half of its samples valid stops the mean.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from itertools import pairwise
from typing import Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray

from metrosep.core._arrays import FloatArray
from metrosep.core.errors import DataError, InvalidSamplesError, TooFewSamplesError
from metrosep.core.numbers import count, positive, without_rounding
from metrosep.core.profile import Profile
from metrosep.core.units import Pixels, format_length
from metrosep.filters._arguments import SHORTFALL
from metrosep.parameters.table import check_range

_MIN_SECTION = 2
"""Fewest samples in a section."""

MIN_VALID_SHARE = 0.5
"""Least share of valid samples of one section among several: with fewer it is not a full section."""

_ROUNDING = 1e-9
"""Relative, of a length: the mean step of a profile is rounded."""


def section_slices(n: int, sections: int) -> tuple[slice, ...]:
    """Return the slices of equal sections of n samples at a uniform step.

    Examples
    --------
    >>> section_slices(10, 3)
    (slice(0, 3, None), slice(3, 7, None), slice(7, 10, None))
    """
    n_sections = count(sections, "sections")
    if n < _MIN_SECTION * n_sections:
        raise TooFewSamplesError(
            f"{n_sections} section(s) need {_MIN_SECTION * n_sections} samples or more, got {n}; use "
            "fewer sections"
        )
    edges = [(2 * k * n + n_sections) // (2 * n_sections) for k in range(n_sections + 1)]
    return tuple(slice(a, b) for a, b in pairwise(edges))


def sections_that_fit(profile: Profile, cutoff: float) -> int:
    """Return how many sections of one cut-off a profile holds, at least 1.

    Examples
    --------
    >>> sections_that_fit(Profile(np.arange(8001) * 0.5e-6, np.zeros(8001)), 0.8e-3)
    5
    """
    kept = trim(profile.z)
    return sections_in((kept.stop - kept.start) * profile.dx, cutoff)


def sections_in(length: float, cutoff: float) -> int:
    """Return how many sections of one cut-off a length holds, at least 1.

    Examples
    --------
    >>> sections_in(9.996e-3, 2.5e-3), sections_in(3.995e-3, 0.8e-3), sections_in(3.9e-3, 0.8e-3)
    (4, 5, 4)
    """
    cutoff = positive(cutoff, "the cut-off", dimension="length")
    return max(1, int(length / cutoff * (1.0 + _ROUNDING) + SHORTFALL))


def trim(z: FloatArray) -> slice:
    """Return the slice from the first to the last valid sample."""
    valid = np.flatnonzero(~np.isnan(z))
    if valid.size < _MIN_SECTION:
        raise TooFewSamplesError(
            f"profile parameters need 2 valid samples or more, got {valid.size} of {z.size}"
        )
    return slice(int(valid[0]), int(valid[-1]) + 1)


@dataclass(frozen=True, slots=True, eq=False)
class Evaluation:
    """A trace with its sections, centred as asked."""

    x: FloatArray  # shape (n,), m: positions, uniform
    whole: FloatArray  # shape (n,), m: heights over the evaluation length; NaN where not measured
    parts: tuple[FloatArray, ...]  # of ndarray, m: heights of each section
    slices: tuple[slice, ...]  # of slice: where the sections lie
    step: float  # in the unit of x
    unit: Literal["m", "px"]  # of x and step
    by_section: bool  # true for ISO 4287:1997: field parameters are means of section values
    amplitude: Amplitudes  # of the whole evaluation length
    # of the sections; empty where one of several sections is valid in less than half
    section_amplitudes: tuple[Amplitudes, ...]

    @classmethod
    def of(cls, profile: Profile, *, sections: int, by_section: bool, centre: bool) -> Evaluation:
        """Return the evaluation of a profile: missing ends cut off, sections formed, centred."""
        kept = trim(profile.z)
        x, z = profile.x[kept], profile.z[kept]
        check_range(float(np.nanmin(z)), float(np.nanmax(z)))
        slices = section_slices(z.size, sections)
        whole = z - np.nanmean(z) if centre else z
        parts = tuple(
            _section(z if by_section else whole, s, centre and by_section) for s in slices
        )
        counts = [int(np.count_nonzero(~np.isnan(p))) for p in parts]
        full = all(_is_full(c, p.size, len(parts)) for c, p in zip(counts, parts, strict=True))
        return cls(
            x=x,
            whole=whole,
            parts=parts,
            slices=slices,
            step=profile.step,
            unit=profile.lateral_unit,
            by_section=by_section,
            amplitude=amplitudes(whole),
            section_amplitudes=tuple(amplitudes(p) for p in parts) if full else (),
        )

    @property
    def dx(self) -> float:
        """Step, m; refused where x counts pixels."""
        if self.unit != "m":
            raise DataError("x of the profile counts pixels; give the map its lateral_step")
        return self.step

    def said(self, along: float) -> str:
        """Return a length along x with its unit."""
        return format_length(along if self.unit == "m" else Pixels(along))

    @property
    def positions(self) -> tuple[FloatArray, ...]:
        """Positions of the samples of each section, m."""
        return tuple(self.x[s] for s in self.slices)

    @property
    def section_lengths(self) -> NDArray[np.float64]:
        """Length of each section, samples times step, in the unit of x."""
        return np.array([p.size for p in self.parts]) * self.step

    @property
    def valid_counts(self) -> tuple[int, ...]:
        """Number of valid samples of each section."""
        return tuple(int(np.count_nonzero(~np.isnan(p))) for p in self.parts)

    @property
    def window(self) -> int:
        """Samples of one section length: the window of `largest_height` in 2021."""
        return max(round(self.whole.size / len(self.parts)), 1)

    @property
    def largest_height(self) -> float:
        """Largest height in a window of one section length that slides, m."""
        from scipy.ndimage import maximum_filter1d, minimum_filter1d

        n, z = self.window, self.whole
        valid = ~np.isnan(z)
        inside = slice(n // 2, n // 2 + z.size - n + 1)  # the middles of the complete windows
        highest = maximum_filter1d(np.where(valid, z, -np.inf), n)[inside]
        lowest = minimum_filter1d(np.where(valid, z, np.inf), n)[inside]
        so_far = np.concatenate([[0], np.cumsum(valid)])
        full = _is_full(so_far[n:] - so_far[:-n], n, len(self.parts))
        if not full.any():
            raise TooFewSamplesError(
                f"no window of {n} samples, one section length, holds {n / 2:g} valid ones; use fewer "
                "sections or crop the profile"
            )
        return float((highest - lowest)[full].max())

    def check_sections(self) -> None:
        """Refuse sections of which one has too few valid samples to count as a full one."""
        if self.section_amplitudes:
            return
        for k, (n_valid, part) in enumerate(zip(self.valid_counts, self.parts, strict=True)):
            if not _is_full(n_valid, part.size, len(self.parts)):
                raise TooFewSamplesError(
                    f"section {k + 1} of {len(self.parts)} holds {n_valid or 'no'} valid sample"
                    f"{'s' if n_valid > 1 else ''} of {part.size}, less than half; use fewer "
                    "sections or crop the profile"
                )

    def section_values(self, of: Callable[[Amplitudes], float | None]) -> list[float]:
        """Return an amplitude parameter of each section."""
        self.check_sections()
        values: list[float] = []
        for k, amplitude in enumerate(self.section_amplitudes):
            value = of(amplitude)
            if value is None:
                raise DataError(f"zero height: all samples of section {k + 1} are equal")
            values.append(value)
        return values

    def field(self, of: Callable[[Amplitudes], float | None]) -> float:
        """Return an amplitude parameter: mean of the sections (1997) or of the whole (2021)."""
        if self.by_section:
            return float(np.mean(self.section_values(of)))
        value = of(self.amplitude)
        if value is None:
            raise DataError("zero height: all samples are equal")
        return value


def _is_full(n_valid: int | NDArray[np.int_], n: int, sections: int) -> NDArray[np.bool_]:
    """Return whether a section, or each of several windows, has enough valid samples."""
    least = 1 if sections == 1 else max(MIN_VALID_SHARE * n, 1)
    return np.asarray(n_valid) >= least


def _section(z: FloatArray, s: slice, centre: bool) -> FloatArray:
    part = z[s]
    if not centre or np.isnan(part).all():
        return part
    centred: FloatArray = part - np.nanmean(part)
    return centred


# ---- amplitude parameters of a row of heights: a, q, sk, ku, p, v ------------------------------
# Heights count from the mean line of the filter, z = 0, out of the material; nothing is centred
# here. NaN = not measured and does not count. Kurtosis is 3 for a Gaussian distribution, not the
# excess.


@dataclass(frozen=True, slots=True)
class Amplitudes:
    """Height statistics about z = 0."""

    a: float  # m: arithmetic mean and root mean square height
    q: float
    sk: float | None  # skewness and kurtosis; None where all heights are equal (zero height)
    ku: float | None
    p: float  # m: highest peak above and deepest valley below z = 0 (positive downwards)
    v: float

    @property
    def z(self) -> float:
        """Peak height plus valley depth in m."""
        return self.p + self.v


def amplitudes(heights: ArrayLike) -> Amplitudes:
    """Return the amplitude parameters of heights.

    ``a = mean|z|``, ``q = sqrt(mean z^2)``, ``sk = mean (z/q)^3``, ``ku = mean (z/q)^4``,
    ``p = max z``, ``v = -min z``. No division by n - 1.

    Source: ISO 4287:1997, 4.1.1, 4.1.2, 4.2.1 to 4.2.4 (recalled).

    Examples
    --------
    >>> found = amplitudes([1e-6, -1e-6, 1e-6, -1e-6])
    >>> found.a, found.sk, found.ku
    (1e-06, 0.0, 1.0)
    """
    z = np.asarray(heights, dtype=np.float64)
    z = z[~np.isnan(z)]
    if z.size == 0:
        raise TooFewSamplesError("no height was measured, so there are no amplitude parameters")
    p, v = float(z.max()), -float(z.min())
    if not (np.isfinite(p) and np.isfinite(v)):
        raise InvalidSamplesError("a height is infinite; mark samples out of range as NaN")
    scale = max(abs(p), abs(v))
    if scale == 0.0 or p + v == 0.0:
        return Amplitudes(a=scale, q=scale, sk=None, ku=None, p=p, v=v)
    unit = z / scale
    square = unit * unit
    mean_square = float(square.mean())
    ku = float((square * square).mean()) / mean_square**2
    return Amplitudes(
        a=scale * float(np.abs(unit).mean()),
        q=scale * mean_square**0.5,
        # the mean of |z|^3 is at most q^3 ku^(3/4)
        sk=without_rounding(float((square * unit).mean()) / mean_square**1.5, ku**0.75),
        ku=ku,
        p=p,
        v=v,
    )
