"""Linear Gaussian filters of profiles (ISO 16610-21), surfaces (-61) and closed profiles.

Weighting function ``s(x) = exp(-pi (x / (a Lc))^2) / (a Lc)``, ``a = sqrt(ln 2 / pi) = 0.4697``:
a wave of length L keeps ``2^-(Lc / L)^2`` of its amplitude in the mean line, half of it at the
cut-off; a crossed wave of a surface keeps ``2^-(Lc^2 (1 / Lx^2 + 1 / Ly^2))``.

At ends and beside samples that were not measured the weighting function is incomplete. The
moment criterion of ISO 16610-28 (order 1: a local straight line or plane) keeps tilts there, the
renormalised weights (order 0) only constants: they bend a trend by 0.148 slope Lc at the end.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np

from metrosep.core._arrays import FloatArray
from metrosep.core.docs import documented
from metrosep.core.errors import DataError, TooFewSamplesError
from metrosep.core.numbers import between, choice, positive, real
from metrosep.core.profile import Profile
from metrosep.core.provenance import Step
from metrosep.core.surface import Surface
from metrosep.core.units import format_length
from metrosep.filters import _areal as areal, _arguments as arguments
from metrosep.filters._areal import (
    COMPLETE,
    SINGULAR,
    half_width,
    lattice_sum,
    standard_deviation,
)
from metrosep.filters._arguments import DOCS, FilterBand, Measured, Wavelength, Wavelengths
from metrosep.spectral.dft import Band

# ---- private: what the Gaussian filter is asked to do, checked and in samples ------------------

End = Literal["moment", "renormalise", "closed", "cut"]

ENDS = ("moment", "renormalise", "closed", "cut")


@dataclass(frozen=True, slots=True)
class GaussianTask(arguments.Task):
    """The task of a Gaussian filter; all of a closed profile lies inside."""

    @property
    def sds(self) -> tuple[float, ...]:
        """Standard deviations in samples."""
        return tuple(
            standard_deviation(c, s) for c, s in zip(self.wavelengths, self.steps, strict=True)
        )

    def cut(self) -> tuple[slice, ...]:
        """Return `inside` without one cut-off at each end."""
        kept = []
        for part, step, cutoff in zip(self.inside, self.steps, self.wavelengths, strict=True):
            n_lost = math.ceil(cutoff / step * (1.0 - arguments.ON_LIMIT))
            n_left = part.stop - part.start - 2 * n_lost
            if n_left < 2:
                raise TooFewSamplesError(
                    f'end="cut" takes one cut-off {format_length(cutoff)} off each end of '
                    f"{format_length((part.stop - part.start) * step)} and leaves "
                    f"{arguments.counted(max(n_left, 0), 'sample')}: measure longer, or use "
                    'end="moment"'
                ).hinting(end="moment")
            kept.append(slice(part.start + n_lost, part.stop - n_lost))
        return tuple(kept)


def gaussian_task(
    obj: Profile | Surface,
    *,
    cutoff: arguments.Wavelength,
    nesting_index: arguments.Wavelengths,
    upr: float | None,
    end: str,
) -> GaussianTask:
    """Return the task of one object, or say what is wrong with it."""
    choice(end, "end", ENDS)
    arguments.check_object(obj)
    closed = end == "closed"
    if isinstance(obj, Surface) and (upr is not None or closed):
        raise DataError(
            'upr= and end="closed" are for closed profiles; a surface has ends, use "moment"'
        )
    if isinstance(obj, Profile) and upr is not None:
        cutoff = _cutoff_of_upr(obj, upr, cutoff, end)
    task = arguments.task_of(
        obj,
        cutoff,
        nesting_index,
        what="a Gaussian filter",
        areal="an areal Gaussian filter",
        minimum=(1 if closed else 2, 3),
        closed=closed,
        name="cutoff" if upr is None else "the cut-off",
    )
    return GaussianTask(task.z, task.inside, task.steps, task.wavelengths)


def _cutoff_of_upr(profile: Profile, upr: float, cutoff: arguments.Wavelength, end: str) -> float:
    """Return the wavelength of a cut-off in undulations per revolution."""
    if end != "closed":
        raise DataError('upr= counts undulations of a closed profile: say end="closed"')
    if cutoff is not None:
        raise DataError("give cutoff= or upr=, not both")
    number = real(upr, "upr", what="a number of undulations per revolution")
    if number < 1.0:
        raise DataError(f"upr must be at least 1 undulation per revolution, got {upr}")
    return profile.dx * len(profile) / number


@documented(**DOCS)
def gaussian(
    obj: Measured,
    *,
    cutoff: Wavelength = None,
    nesting_index: Wavelengths = None,
    upr: float | None = None,
    band: FilterBand | Band = "long",
    end: End = "moment",
    min_support: float = 0.1,
    fill: bool = False,
    refilter: bool = False,
) -> Measured:
    """Return the Gaussian mean line or surface, what it leaves, or a band of wavelengths.

    Parameters
    ----------
    $obj
    $cutoff
    upr : float, undulations per revolution, >= 1
        Cut-off of a closed profile instead of `cutoff`; 15, 50, 150 are usual.
    band : {"long", "short"} or Band, optional
        The mean line; z minus the mean line; or an S-filter at ``band.shortest`` followed by
        an L-filter at ``band.longest`` (then no cut-off is given; an open side is not filtered).
    end : {"moment", "renormalise", "closed", "cut"}, optional
        Local line or plane (order 1); weights brought to sum 1 (order 0); a closed profile of
        period ``n dx``; or order 1 with one cut-off discarded at each end.
    min_support : float, 0 to 1, optional
        Share of the weighting function that must lie on measured samples; below it the result
        is NaN.
    fill : bool, optional
        Also give the mean line in gaps, inside the range that was measured.
    $refilter

    Returns
    -------
    Profile or Surface
        Same grid (less the ends that were cut); NaN where not measured, unless `fill`, or where
        support is low, which the history counts as ``n_unsupported``. The short band of a profile
        is of kind R (of a W profile W); the long band keeps its kind.

    Raises
    ------
    DataError
        If the cut-off has the wrong name for the object or lies outside its limits, options
        contradict each other, the surface has no lateral step, or the band is open on both sides.
    $twice
    InvalidSamplesError
        If the cut-off is not positive and finite, or a closed profile repeats its first sample.
    $uniform
    TooFewSamplesError
        If nothing was measured, too little for a line or plane, cutting the ends leaves nothing,
        or no sample reaches `min_support`.

    Notes
    -----
    The window reaches 1.3 cut-offs, so that 3e-12 of the weight is missing. Rows and columns at
    the rim without any valid sample are ignored, also by `fill`. Inside gaps the extrapolated
    line is better than the mean down to a support of about 0.1, hence the default. A closed
    profile with gaps is renormalised. Its x may be an angle or an arc, which nobody can tell from
    the numbers: n dx is taken as one revolution, so x over half a turn or two gives another
    cut-off than `upr` says. Cost: O(n log n) for profiles, O(n) for surfaces.

    References
    ----------
    .. [1] ISO 16610-21:2011, 4.1-4.2 and closed profiles.
    .. [2] ISO 16610-28:2016, end effects, moment criterion.
    .. [3] ISO 16610-61:2015, linear areal filters: Gaussian.

    Examples
    --------
    >>> import numpy as np
    >>> x = np.arange(2001) * 0.5e-6
    >>> wave = Profile(x, 1e-6 * np.cos(2 * np.pi * x / 80e-6))
    >>> mean_line = gaussian(wave, cutoff=80e-6)
    >>> round(float(mean_line.z[960] / wave.z[960]), 6)
    0.5
    """
    if isinstance(band, Band):
        if cutoff is not None or nesting_index is not None or upr is not None:
            raise DataError(
                "a Band holds the cut-offs itself: leave out cutoff, nesting_index, upr"
            )
        return _band(obj, band, end, min_support, fill, refilter)
    return _filtered(
        obj,
        cutoff=cutoff,
        nesting_index=nesting_index,
        upr=upr,
        band=band,
        end=end,
        min_support=min_support,
        fill=fill,
        refilter=refilter,
    )


@documented(**DOCS)
def gaussian_support(
    obj: Measured,
    *,
    cutoff: Wavelength = None,
    nesting_index: Wavelengths = None,
    upr: float | None = None,
    end: End = "moment",
) -> Measured:
    """Return the share of the weighting function that lies on measured samples, 0 to 1.

    Parameters
    ----------
    $obj
    $cutoff
    upr : float, undulations per revolution, >= 1
        Cut-off of a closed profile instead of `cutoff`.
    end : {"moment", "renormalise", "closed", "cut"}, optional
        As for the filter; beyond open ends nothing was measured.

    Returns
    -------
    Profile or Surface
        Its z is the share, dimensionless, without NaN; ``metadata["quantity"]`` is ``"support"``.

    Raises
    ------
    DataError
        If the cut-off has the wrong name for the object or lies outside its limits, options
        contradict each other, or the surface has no lateral step.
    InvalidSamplesError
        If the cut-off is not positive and finite, or a closed profile repeats its first sample.
    $uniform
    TooFewSamplesError
        If nothing was measured, or cutting the ends leaves nothing.

    Examples
    --------
    >>> import numpy as np
    >>> flat = Profile(np.arange(101) * 1e-6, np.zeros(101))
    >>> gaussian_support(flat, cutoff=20e-6).z[[0, 50]].round(3).tolist()
    [0.553, 1.0]
    """
    task = gaussian_task(obj, cutoff=cutoff, nesting_index=nesting_index, upr=upr, end=end)
    kept = task.cut() if end == "cut" else tuple(slice(0, n) for n in obj.z.shape)
    if end == "closed":
        share = closed_support(obj.z, obj.z.size * task.steps[0] / task.wavelengths[0])
    elif isinstance(obj, Profile):
        share = profile_support(obj.z, task.sds[0])
    else:
        share = areal.areal_support(obj.z, (task.sds[0], task.sds[1]))
    step = Step("gaussian_support", {**task.named, "end": end})
    history = (*obj.history, step)
    metadata = {"quantity": "support"}
    share = share[kept]
    if isinstance(obj, Profile):
        return Profile(obj.x[kept], share, metadata=metadata, history=history)  # type: ignore[return-value]
    return Surface(  # type: ignore[return-value]
        share,
        obj.dx,
        obj.dy,
        origin=arguments.cut_origin(obj, kept),
        metadata=metadata,
        history=history,
    )


def _filtered(
    obj: Measured,
    *,
    cutoff: Wavelength = None,
    nesting_index: Wavelengths = None,
    upr: float | None = None,
    band: FilterBand,
    end: End,
    min_support: float,
    fill: bool,
    refilter: bool,
) -> Measured:
    """Return the long or the short side of one filter."""
    arguments.check_object(obj)
    arguments.check_band(band)
    between(positive(min_support, "min_support"), "min_support", 0.0, 1.0)
    arguments.check_single_filtering(obj, refilter, band=band)
    task = gaussian_task(obj, cutoff=cutoff, nesting_index=nesting_index, upr=upr, end=end)
    kept = task.cut() if end == "cut" else tuple(slice(0, n) for n in obj.z.shape)
    low = _mean(obj.z, task, end, min_support, fill)
    if end == "cut":
        low = low[kept].copy()
    lost = np.isnan(low)
    if lost.all():
        raise TooFewSamplesError(
            f"no sample has {min_support:g} of the weighting function on measured samples: "
            "lower min_support, or use a shorter cut-off"
        )
    if lost.any():
        lost &= ~np.isnan(obj.z[kept])
    if band == "short":
        np.subtract(obj.z[kept], low, out=low)
    low.setflags(write=False)  # so that the object takes it without a copy
    step = Step(
        "gaussian",
        {
            **task.named,
            "band": band,
            "end": end,
            "min_support": min_support,
            "fill": fill,
            "n_unsupported": int(np.count_nonzero(lost)),
        },
    )
    return arguments.like(obj, low, step=step, short=band == "short", kept=kept)


def _band(
    obj: Measured,
    band: Band,
    end: End,
    min_support: float,
    fill: bool,
    refilter: bool,
) -> Measured:
    """Return the object after its S-filter and its L-filter."""
    if band.shortest is None and band.longest is None:
        raise DataError("the band is open on both sides: nothing is to be filtered")
    name = "nesting_index" if obj.z.ndim == 2 else "cutoff"
    options: dict[str, Any] = {
        "end": end,
        "min_support": min_support,
        "fill": fill,
        "refilter": refilter,
    }
    if band.shortest is not None:
        options[name] = band.shortest
        obj = _filtered(obj, band="long", **options)
    if band.longest is not None:
        options[name] = band.longest
        obj = _filtered(obj, band="short", **options)
    return obj


def _mean(
    z: FloatArray, task: GaussianTask, end: End, min_support: float, fill: bool
) -> FloatArray:
    """Return the mean line or surface on the whole grid, NaN outside what was measured."""
    if end == "closed":
        harmonic = z.size * task.steps[0] / task.wavelengths[0]
        return closed_gaussian(z, harmonic, min_support=min_support, fill=fill)
    part = z[task.inside]
    order = 0 if end == "renormalise" else 1
    if z.ndim == 1:
        low = profile_gaussian(part, task.sds[0], order=order, min_support=min_support, fill=fill)
    else:
        low = areal.areal_gaussian(
            part, (task.sds[0], task.sds[1]), order=order, min_support=min_support, fill=fill
        )
    if part.shape == z.shape:
        return low
    whole = np.full(z.shape, np.nan)
    whole[task.inside] = low
    return whole


# ---- private: Gaussian of a profile with gaps, open (local regression) and closed (circular) ----
# Open: with weights p = s(x_j - x) over the valid samples j, S_k = sum p u^k and T_k = sum p u^k z,
# u = x_j - x, the line through the neighbourhood has at x the height
# ``(S_2 T_0 - S_1 T_1) / (S_2 S_0 - S_1^2)`` (moment criterion of order 1, ISO 16610-28);
# order 0 gives ``T_0 / S_0``. All sums are convolutions by padded real transforms.
#
# Closed: each harmonic k of the turn is multiplied by ``2^-(k / k_c)^2`` (ISO 16610-21).
#
# A line (order 0 and closed: a constant) is taken out first and put back, so that tilt and offset
# cost no digits.

_MIN_BLOCK = 8192
"""Shortest transform of a long profile, in samples."""

_BATCH = 65536
"""Samples that are transformed together."""

_TINY = 1e-30
"""Smallest weight that is divided by; such samples are reported as without support."""


def profile_gaussian(
    z: FloatArray, sd: float, *, order: int, min_support: float, fill: bool
) -> FloatArray:
    """Return the mean line of an open profile; `sd` in samples.

    NaN where the support share is below `min_support` and, without `fill`, where `z` is.
    """
    line = _reference_line(z, order)
    valid = ~np.isnan(z)
    t = np.where(valid, z - line, 0.0)
    reach = half_width(sd)
    if valid.all() and z.size > 4 * reach:
        low = _correlate(t, sd, (0,))[0]
        for end in (slice(0, 2 * reach), slice(z.size - 2 * reach, z.size)):
            piece, share = _regression(np.ones(2 * reach), t[end], sd, order)
            inner = slice(0, reach) if end.start == 0 else slice(reach, 2 * reach)
            low[end][inner] = np.where(share >= min_support, piece, np.nan)[inner]
        return np.asarray(low + line)
    low, share = _regression(valid.astype(np.float64), t, sd, order)
    low += line
    low[share < min_support] = np.nan
    if not fill:
        low[~valid] = np.nan
    return low


def profile_support(z: FloatArray, sd: float) -> FloatArray:
    """Return the share of the weight that lies on valid samples, 0 to 1."""
    share = _correlate((~np.isnan(z)).astype(np.float64), sd, (0,))[0]
    return np.asarray(np.clip(share, 0.0, 1.0))


def closed_gaussian(
    z: FloatArray, harmonic: float, *, min_support: float, fill: bool
) -> FloatArray:
    """Return the mean line of a closed profile; half of harmonic number `harmonic` passes."""
    valid = ~np.isnan(z)
    offset = float(z[valid][0])
    low = _circular(np.where(valid, z - offset, 0.0), harmonic)
    if not valid.all():
        share = _circular(valid.astype(np.float64), harmonic)
        low /= np.maximum(share, _TINY)
        low[share < min_support] = np.nan
        if not fill:
            low[~valid] = np.nan
    return np.asarray(low + offset)


def closed_support(z: FloatArray, harmonic: float) -> FloatArray:
    """Return the share of the weight that lies on valid samples of a closed profile."""
    share = _circular((~np.isnan(z)).astype(np.float64), harmonic)
    return np.asarray(np.clip(share, 0.0, 1.0))


def _reference_line(z: FloatArray, order: int) -> FloatArray:
    index = np.flatnonzero(~np.isnan(z))
    level = float(z[index[0]])
    if order == 0:
        return np.full(z.size, level)
    u = index - index.mean()
    heights = z[index] - level
    spread = float(u @ u)
    slope = float(u @ heights) / spread if spread > 0.0 else 0.0
    middle = level + float(heights.mean())
    return np.asarray(middle + slope * (np.arange(z.size) - index.mean()))


def _regression(
    w: FloatArray, t: FloatArray, sd: float, order: int
) -> tuple[FloatArray, FloatArray]:
    """Return the local regression of t under the validity w, and the support share."""
    if order == 0:
        share = _correlate(w, sd, (0,))[0]
        return _correlate(t, sd, (0,))[0] / np.maximum(share, _TINY), share
    s0, s1, s2 = _correlate(w, sd, (0, 1, 2))
    t0, t1 = _correlate(t, sd, (0, 1))
    determinant = s2 * s0 - s1 * s1
    top = s2 * t0 - s1 * t1
    whole = s0 > COMPLETE
    plain = whole | (determinant <= SINGULAR * s0 * s0)
    np.copyto(top, t0, where=plain)
    np.copyto(determinant, np.maximum(s0, _TINY), where=plain)
    return top / determinant, s0


def _correlate(values: FloatArray, sd: float, moments: tuple[int, ...]) -> list[FloatArray]:
    """Return the sums of s(u) v^k values(x + u) over u, for each k, with v = u / sd.

    Overlapping blocks are transformed, a few at a time, so that they stay in the cache.
    """
    from scipy.fft import irfft, next_fast_len, rfft

    n = values.size
    reach = min(half_width(sd), n - 1)
    length = int(next_fast_len(min(n + 2 * reach, max(_MIN_BLOCK, 8 * reach)), real=True))
    step = length - 2 * reach
    n_blocks = -(-n // step)
    padded = np.zeros(n_blocks * step + 2 * reach)
    padded[reach : reach + n] = values
    blocks = np.lib.stride_tricks.sliding_window_view(padded, length)[::step]
    kernels = [rfft(k) for k in _kernels(sd, reach, length, moments)]
    sums = [np.empty((n_blocks, step)) for _ in moments]
    batch = max(1, _BATCH // length)
    for start in range(0, n_blocks, batch):
        spectra = rfft(blocks[start : start + batch], axis=1)
        for total, kernel in zip(sums, kernels, strict=True):
            part = irfft(spectra * kernel, length, axis=1)
            total[start : start + batch] = part[:, reach : reach + step]
    return [total.ravel()[:n] for total in sums]


def _kernels(sd: float, reach: int, length: int, moments: tuple[int, ...]) -> list[FloatArray]:
    u = np.arange(-reach, reach + 1)
    v = u / sd
    weights = np.exp(-0.5 * v * v) / lattice_sum(sd)
    kernels = []
    for k in moments:
        kernel = np.zeros(length)
        kernel[-u] = weights * v**k  # a correlation is the convolution with the mirrored kernel
        kernels.append(kernel)
    return kernels


def _circular(values: FloatArray, harmonic: float) -> FloatArray:
    from scipy.fft import irfft, rfft

    order = np.arange(values.size // 2 + 1) / harmonic
    return np.asarray(irfft(rfft(values) * np.exp2(-order * order), values.size))
