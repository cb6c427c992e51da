"""Power spectral density of maps with an outline and holes, and of profiles with gaps.

The window falls to zero at the outline, whatever its shape: w = sin^2(pi d / 2 d_max), d the distance
to the outside. On a disc that is the cos^2 of the radius. Without a window a spectrum that falls like
f^-4 is wrong by up to a factor of twenty (metrology-2, 7.2). With it the lowest bands still take in some
of the waves longer than the part, 20 to 90 % too much for f^-4; so a spectrum that falls is taken from
the slopes, whose own spectrum falls by f^2 less, and divided by what the difference of two samples passes.

Holes are left out of the window where the spectrum falls no faster than 1/f: exact for a white one, which
no height drawn over a hole can be. Elsewhere their sharp edges would spread the long waves over all
others. Small ones are then closed by the harmonic function (Laplace's equation, the measured pixels
around as boundary), which takes power from short waves and puts some there; how much is seen where known
pixels are closed: what is taken is given back, what is put there is bounded. Large ones, which would lose
long waves as well, are left out of the window of the slopes, whose spectrum falls less. Of a spectrum that
falls only beyond the longest waves the frequencies are closed at which the edges would leak more than a
small share.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from metrosep.core._arrays import FloatArray
from metrosep.core.errors import DataError, InvalidSamplesError, TooFewSamplesError
from metrosep.core.numbers import between, choice
from metrosep.core.profile import Profile
from metrosep.core.provenance import Step
from metrosep.core.surface import Surface, lateral_steps
from metrosep.spectral.dft import instance_of
from metrosep.spectral.spectra import ArealPsd, Psd, RadialPsd

_PERIODS = 2.0
"""Of the width of the outline: the lowest frequency that is more than the window."""
_LOW, _LOW_LINE = 8.0, 32.0
"""Times the lowest frequency: up to there it is looked whether the spectrum falls. Of a line as far as a
map, one white profile in fourteen falls by chance: it has 2 and 6 independent values there."""
_SMALL = 50
"""Pixels of a hole that is closed where the spectrum falls: of holes of 7 x 7 pixels both ways are within
5 % of the truth for f^-2 to f^-4, of smaller ones the closed and of larger ones the open are nearer."""
_LEAK = 0.05
"""Of the density: where the edges of holes add more, they are closed; at f^-1 both ways differ by this."""
_NEAR, _NEAR_LINE = ((25, 1.5), (7, 4.0)), ((129, 1.5), (17, 4.0))
"""Frequencies along each axis, padded, over which a density is smoothed to see that, an eighth of all at
most; and how many times it must be what would be added to a white density. The logarithm of the mean of
about 80 independent ones scatters by 0.14, of 6 by 0.5: both are nearly three standard deviations."""
_SHIFTS, _SHIFTS_LINE = 3, 7
"""Of the holes, by which it is seen what closing them puts where: of the first three the largest counts, as one
scatters, and the median of all of what it takes; another closed line takes no time."""
_MOST_SCALED = 3.0
"""Times the shifted holes' share of the window's square that the real ones may have: near its end they show
next to nothing, and that many times over."""
_FALLS = 1.0
"""Exponent of 1/f from which the slopes are taken: at f^-1 both ways are within 5 % of the truth."""


@dataclass(frozen=True, slots=True, eq=False)
class MaskedPsd:
    """Spectrum of what lies inside an outline.

    Parameters
    ----------
    areal : ArealPsd or None
        Two-sided density of a map, padded to twice its size; None of a profile.
    one_sided : tuple of Psd
        One-sided density along x, and of a map along y: the areal one integrated over the other
        frequency.
    lengths : tuple of float, m
        Effective length of the window along each: a band of width df holds df times this many
        independent values.
    window_area : float, m^2 or m
        The same for the areal density (of a profile its length).
    lowest : tuple of float, 1/m
        Lowest frequency along each axis that can be trusted, 2 over the width of the outline.
    filled_share : float
        Share of the pixels inside the outline that were not measured.
    lost_share : float
        Share of the window's square on them: of a hole in the middle several times as much.
    left : tuple of ndarray
        Share of the density along each that is left at least: of a closed hole the waves shorter than a
        few widths lose up to four times its share of the window's square.
    added : tuple of ndarray, m^3
        Density along each that the holes may have put there: what closing as many known pixels does, or
        what the edges of the omitted ones leave.
    holes : {"omitted", "closed", "closed up to 50 pixels", "closed where their edges would leak"}
        What became of them; larger ones were omitted, and so were all at other frequencies.
    estimate : {"heights", "slopes"}
        What was transformed.
    reads_high : bool
        Whether the density of heights falls faster than 1/f and was taken from heights all the same:
        its lowest bands hold more than is there.
    """

    areal: ArealPsd | None
    one_sided: tuple[Psd, ...]
    lengths: tuple[float, ...]
    window_area: float
    lowest: tuple[float, ...]
    filled_share: float
    lost_share: float
    left: tuple[FloatArray, ...]
    added: tuple[FloatArray, ...]
    holes: str
    estimate: Literal["heights", "slopes"]
    reads_high: bool

    def radial(self) -> RadialPsd:
        """Return the mean over all directions.

        Returns
        -------
        RadialPsd
            In rings as wide as the frequency step of the map before padding; ``n_averaged`` counts
            independent values, of which the window leaves fewer than samples.

        Raises
        ------
        DataError
            If it is the spectrum of a profile.
        """
        if self.areal is None:
            raise DataError("the spectrum of a profile has one direction")
        radius = self.areal.radial_frequency().ravel()
        width = 2.0 * max(
            float(np.diff(f[:2])[0]) for f in (self.areal.frequency_x, self.areal.frequency_y)
        )
        ring = np.rint(radius / width).astype(np.intp)
        count = np.bincount(ring)
        full = np.flatnonzero(count)
        full = full[full > 0]
        area = count[full] * self.areal.cell
        independent = np.maximum(np.rint(0.5 * area * self.window_area), 1).astype(np.int64)
        return RadialPsd(
            np.bincount(ring, radius)[full] / count[full],
            np.bincount(ring, self.areal.density.ravel())[full] / count[full],
            np.asarray(area),
            independent,
            self.areal.history,
        )


def masked_psd(
    obj: Surface | Profile,
    *,
    detrend: Literal["mean", "plane", "quadratic"] = "plane",
    max_filled: float = 0.1,
    estimate: Literal["auto", "heights", "slopes"] = "auto",
) -> MaskedPsd:
    """Return the power spectral density of a map with an outline and holes, or a profile with gaps.

    Parameters
    ----------
    obj : Surface or Profile
        With its lateral steps; NaN = not measured.
    detrend : {"mean", "plane", "quadratic"}, optional
        What is taken off the measured heights first, by least squares.
    max_filled : float, optional
        Largest share of holes inside the outline, 0 to 1.
    estimate : {"auto", "heights", "slopes"}, optional
        What is transformed; "auto" takes the slopes where the density falls faster than 1/f from 2 to
        16 waves across (of a profile to 64), unless ``detrend="mean"`` keeps the plane in.

    Returns
    -------
    MaskedPsd
        Densities with what is known of them.

    Raises
    ------
    DataError
        If an option is out of range, slopes are asked with ``detrend="mean"``, or a step is not known.
    InvalidSamplesError
        If nothing was measured, or more than `max_filled` is missing.
    NotUniformError
        If the positions of a profile are not uniform.
    TooFewSamplesError
        If the outline is narrower than 8 pixels.

    Notes
    -----
    From heights ``C = dx dy |FFT(w z)|^2 / sum w^2`` with the mean of weights w removed, zeros outside,
    padded to twice the size. The sum of C over all frequencies times their cell is the weighted
    variance ``sum (w z)^2 / sum w^2``. From slopes ``C = (C_x + C_y) / (H_x + H_y)``, with C_x that of
    ``(z(x + dx) - z(x)) / dx`` and ``H_x = (2 sin(pi f_x dx) / dx)^2``; the sum is then the variance
    within the scatter, and zero frequency is zero. One-sided: ``PSD1(f) = 2 integral C(f, fy) dfy``. Independent values of
    a ring: ``(pi / 2) (f2^2 - f1^2) dx dy (sum w^2)^2 / sum w^4``.

    References
    ----------
    .. [1] J. M. Elson, J. M. Bennett, Appl. Opt. 34 (1995) 201 (one-dimensional form).

    Examples
    --------
    >>> rng = np.random.default_rng(1)
    >>> y, x = np.mgrid[-1:1:64j, -1:1:64j]
    >>> disc = np.where(x * x + y * y <= 1.0, rng.standard_normal((64, 64)), np.nan)
    >>> found = masked_psd(Surface(disc, 1e-6, 1e-6))
    >>> along_x, along_y = found.one_sided
    >>> bool(abs(along_x.variance() / along_y.variance() - 1.0) < 1e-2)  # each lacks its own mean
    True
    """
    instance_of(obj, (Surface, Profile), "a spectrum")
    choice(detrend, "detrend", ("mean", "plane", "quadratic"))
    choice(estimate, "estimate", ("auto", "heights", "slopes"))
    if estimate == "slopes" and detrend == "mean":
        raise (
            DataError(
                'estimate = "slopes" takes a plane off with the mean slope, and detrend = "mean" keeps it: '
                'say detrend = "plane", or estimate = "heights"'
            )
            .hinting(detrend="plane")
            .hinting(estimate="heights")
        )
    max_filled = between(max_filled, "max_filled", 0.0, 1.0)
    steps = _steps(obj)
    z = np.atleast_2d(np.asarray(obj.z, dtype=np.float64))
    measured = ~np.isnan(z)
    if not measured.any():
        raise InvalidSamplesError("nothing was measured: there is no spectrum")
    rows, columns = (np.flatnonzero(measured.any(axis=a)) for a in (1, 0))
    part = (slice(rows[0], rows[-1] + 1), slice(columns[0], columns[-1] + 1))
    z, measured = z[part], measured[part]
    is_map = isinstance(obj, Surface)
    widths = [n for n, wanted in zip(z.shape, (is_map, True), strict=True) if wanted]
    if min(widths) < 8:
        raise TooFewSamplesError(f"a spectrum needs 8 samples across, got {min(widths)}")
    outline = _outline(measured, is_map=is_map)
    n_filled = int(outline.sum()) - int(measured.sum())
    share = n_filled / int(outline.sum())
    if share > max_filled:
        raise InvalidSamplesError(
            f"{100 * share:.3g} % of the outline is missing, more than the {100 * max_filled:.3g} % that "
            "max_filled allows: holes would decide the spectrum; crop, or raise max_filled"
        )
    z = np.where(measured, z - _trend(z, measured, detrend, is_map=is_map), 0.0)
    whole = _window(outline, steps, is_map=is_map)
    w = whole * measured
    power = _of_heights(z, w, steps, is_map=is_map)
    falls = _falls(power, z.shape, steps)
    taken: Literal["heights", "slopes"] = "heights"
    known = outline
    leaks: NDArray[np.bool_] = np.full(power.shape, falls)
    closed, of_closed = z, power
    by_edges: _Spread | None = None
    if estimate == "slopes" or (estimate == "auto" and detrend != "mean" and falls):
        taken = "slopes"
        closed = _closed(z, outline, measured, steps)
        known = measured | _small(outline & ~measured)
        power, w = _of_slopes(closed, outline, known, steps, is_map=is_map)
        of_closed = power
        leaks[:] = True
    elif n_filled:
        closed = _closed(z, outline, measured, steps)
        of_closed = _of_heights(closed, whole, steps, is_map=is_map)
        if not falls:  # what closes holes may rise where nothing else does, and feign a leak
            rest = _by_edges(w, whole)
            by_edges = _spread(power, *rest)
            leaks = by_edges.leaks()
            leaks = leaks & _spread(of_closed, *rest).leaks() if leaks.any() else leaks
        power = np.where(leaks, of_closed, power)
    holes = "omitted" if not leaks.any() else "closed"
    if leaks.any() and not leaks.all():
        holes = "closed where their edges would leak"
    if taken == "slopes" and not known[outline].all():
        holes = f"closed up to {_SMALL} pixels"
    square = whole**2
    lost = 1.0 - float(square[measured].sum() / square.sum())
    facts = {
        "detrend": detrend,
        "filled_share": share,
        "lost_share": lost,
        "holes": holes,
        "window": "sin2 of the distance",
        "estimate": taken,
    }
    history = (*obj.history, Step("masked_psd", facts))
    raw = _spectrum(power, w * measured, steps, history, is_map=is_map)["one_sided"]
    filled = outline & known & ~measured
    shares = _shares(square, filled)
    wrong = np.zeros(power.shape)
    kept = np.ones(power.shape)
    if filled.any() and leaks.any():

        def density(heights: FloatArray, points: NDArray[np.bool_]) -> FloatArray:
            if taken == "slopes":
                return _of_slopes(heights, outline, points, steps, is_map=is_map)[0]
            return _of_heights(heights, whole, steps, is_map=is_map)

        errors = _errors(z, closed, outline, filled, measured, square, steps)
        for error, scale in errors[:_SHIFTS]:
            wrong = np.maximum(wrong, scale * density(error, outline))
        twice = [(density(closed + e, known), s) for e, s in errors if s <= _MOST_SCALED]
        f_y, f_x = _axes(power.shape, steps)
        least = _left(f_x, shares, steps, 1, is_map=is_map)[None, :]
        if is_map:
            least = np.maximum(_left(f_y, shares, steps, 0, is_map=True)[:, None], least)
        kept = np.where(leaks, np.maximum(_kept(of_closed, twice), least), 1.0)
        wrong = np.where(leaks, wrong if errors else power, 0.0) / kept
    found = _spectrum(power / kept, w * measured, steps, history, is_map=is_map)
    if taken == "slopes" and not known[outline].all():
        gain = _gain(power.shape, steps, is_map=is_map)
        of_slopes = power * gain
        wrong = wrong + _spread(of_slopes, *_by_edges(w * known, w)).added(of_slopes) / gain
    elif by_edges is not None:
        wrong = np.where(leaks, wrong, by_edges.added(power))
    added = _spectrum(wrong, w * measured, steps, history, is_map=is_map)["one_sided"]
    of_open = 1.0 - float(square[~known & outline].sum() / square.sum())
    left = []
    for axis, one, before in zip((1, 0) if is_map else (1,), found["one_sided"], raw, strict=True):
        least = of_open * _left(one.frequency, shares, steps, axis, is_map=is_map)
        bound = _mixed(np.minimum(1.0 - lost, least), 1.0 - lost, power, leaks, axis)
        more = one.density / np.where(
            before.density > 0.0, before.density, one.density + (one.density == 0.0)
        )
        left.append(np.minimum(1.0 - lost, bound * np.maximum(more, 1.0)))
    return MaskedPsd(
        **found,
        left=tuple(left),
        added=tuple(one.density for one in added),
        filled_share=share,
        lost_share=lost,
        holes=holes,
        estimate=taken,
        reads_high=falls and taken == "heights",
    )


def _steps(obj: Surface | Profile) -> tuple[float, float]:
    """Return the steps in y and x, 1 in y of a profile."""
    if isinstance(obj, Profile):
        return 1.0, obj.dx
    dx, dy = lateral_steps(obj, ", so it has no frequencies in 1/m")
    return dy, dx


def _outline(measured: NDArray[np.bool_], *, is_map: bool) -> NDArray[np.bool_]:
    """Return the measured pixels with all holes inside; the outside is 8-connected."""
    from scipy import ndimage

    if not is_map:
        return np.ones(measured.shape, dtype=bool)  # between its first and last sample
    return np.asarray(ndimage.binary_fill_holes(measured, structure=np.ones((3, 3), dtype=bool)))


def _trend(
    z: FloatArray, measured: NDArray[np.bool_], detrend: str, *, is_map: bool
) -> FloatArray:
    """Return the least-squares mean, plane (line) or quadratic of the measured pixels."""
    v, u = (np.linspace(-1.0, 1.0, n) if n > 1 else np.zeros(1) for n in z.shape)
    terms = [np.ones(z.shape)]
    if detrend != "mean":
        terms.append(np.broadcast_to(u, z.shape))
        terms += [np.broadcast_to(v[:, None], z.shape)] if is_map else []
    if detrend == "quadratic":
        terms.append(np.broadcast_to(u * u, z.shape))
        if is_map:
            terms += [np.broadcast_to((v * v)[:, None], z.shape), v[:, None] * u]
    basis = np.stack([t[measured] for t in terms])
    level = float(z[measured][0])
    c = np.linalg.lstsq(basis @ basis.T, basis @ (z[measured] - level), rcond=None)[0]
    trend = np.full(z.shape, level)
    for coefficient, term in zip(c, terms, strict=True):
        trend += coefficient * term
    return trend


def _small(hole: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """Return the pixels of holes of at most `_SMALL` pixels that touch, corners included."""
    from scipy import ndimage

    number, n = ndimage.label(hole, structure=np.ones((3, 3), dtype=bool))
    size = np.bincount(number.reshape(-1), minlength=n + 1)
    return np.asarray(hole & (size <= _SMALL)[number])


def _closed(
    z: FloatArray,
    outline: NDArray[np.bool_],
    measured: NDArray[np.bool_],
    steps: tuple[float, float],
) -> FloatArray:
    """Return the heights with holes closed by the harmonic function; zeros outside."""
    from scipy.sparse import coo_array, csc_array
    from scipy.sparse.linalg import spsolve

    hole = outline & ~measured
    out = np.where(measured, z, 0.0)
    n = int(hole.sum())
    if n == 0:
        return out
    number = np.full(z.shape, -1)
    number[hole] = np.arange(n)
    rows, columns = np.nonzero(hole)
    diagonal, right = np.zeros(n), np.zeros(n)
    entries: list[tuple[NDArray[np.intp], NDArray[np.intp], FloatArray]] = []
    for axis, step in enumerate(steps):
        for side in (-1, 1):
            y, x = rows + (side if axis == 0 else 0), columns + (side if axis == 1 else 0)
            there = (y >= 0) & (y < z.shape[0]) & (x >= 0) & (x < z.shape[1])
            there[there] = outline[y[there], x[there]]
            weight = 1.0 / step**2
            diagonal[there] += weight
            known = there.copy()
            known[there] = measured[y[there], x[there]]
            right[known] += weight * z[y[known], x[known]]
            other = there & ~known
            at = np.flatnonzero(other)
            entries.append((at, number[y[other], x[other]], np.full(at.size, -weight)))
    at, to, value = (np.concatenate(v) for v in zip(*entries, strict=True))
    every = np.arange(n)
    matrix = coo_array(
        (
            np.concatenate([value, diagonal]),
            (np.concatenate([at, every]), np.concatenate([to, every])),
        ),
        shape=(n, n),
    )
    out[hole] = spsolve(csc_array(matrix), right)
    return out


def _window(outline: NDArray[np.bool_], steps: tuple[float, float], *, is_map: bool) -> FloatArray:
    from scipy import ndimage

    padded = np.pad(outline, ((1, 1) if is_map else (0, 0), (1, 1)))
    distance = ndimage.distance_transform_edt(padded, sampling=steps)
    distance = distance[1:-1, 1:-1] if is_map else distance[:, 1:-1]
    return np.asarray(np.sin(0.5 * np.pi * distance / distance.max()) ** 2)


def _of_heights(
    z: FloatArray, w: FloatArray, steps: tuple[float, float], *, is_map: bool
) -> FloatArray:
    """Return the density of what a window holds at the frequencies of the FFT."""
    from scipy import fft

    z = z - float((w * z).sum() / w.sum())
    cell = math.prod(steps) if is_map else steps[1]
    shape = _padded(w.shape)
    half = fft.rfft2(w * z, shape)
    power = np.square(half.real) + np.square(half.imag)
    power *= cell / float((w * w).sum())
    return _both_sides(power, shape[1])


def _of_slopes(
    z: FloatArray,
    outline: NDArray[np.bool_],
    known: NDArray[np.bool_],
    steps: tuple[float, float],
    *,
    is_map: bool,
) -> tuple[FloatArray, FloatArray]:
    """Return the same from the differences of known neighbours, over what one passes, and the window."""
    axes = (0, 1) if is_map else (1,)

    def with_next(points: NDArray[np.bool_], axis: int) -> NDArray[np.bool_]:
        after = np.roll(points, -1, axis)
        np.moveaxis(after, axis, 0)[-1] = False
        return points & after

    inside = outline
    for axis in axes:
        inside = inside & with_next(outline, axis)
    if not inside.any():
        raise TooFewSamplesError("no pixel has a neighbour in x and in y: there are no slopes")
    power = np.zeros(_padded(z.shape))
    w = _window(inside, steps, is_map=is_map)
    for axis in axes:
        slope = (np.roll(z, -1, axis) - z) / steps[axis]
        power += _of_heights(slope, w * with_next(known, axis), steps, is_map=is_map)
    power[0, 0] = 0.0  # the mean has no slope
    power /= _gain(power.shape, steps, is_map=is_map)
    return power, w


def _gain(shape: tuple[int, ...], steps: tuple[float, float], *, is_map: bool) -> FloatArray:
    """Return what the slopes' density is over that of the heights; of the mean a number above 0."""
    from scipy import fft

    along = [
        (2.0 * np.sin(np.pi * fft.fftfreq(n)) / s) ** 2 for n, s in zip(shape, steps, strict=True)
    ]
    gain = along[0][:, None] * is_map + along[1]
    gain[0, 0] = 1.0  # of the mean, which has no slope
    return np.asarray(gain)


def _falls(power: FloatArray, shape: tuple[int, ...], steps: tuple[float, float]) -> bool:
    """Return whether a density falls faster than 1/f where few waves fit across the outline.

    By the means over the lower and the upper half, in octaves, of the frequencies up to `_LOW` (of
    a line `_LOW_LINE`) times the lowest.
    """
    sides = [(n, s) for n, s in zip(shape, steps, strict=True) if n > 1]
    lowest = _PERIODS / min(n * s for n, s in sides)
    low = _LOW if len(sides) > 1 else _LOW_LINE
    highest = min(low * lowest, *(0.5 / s for _, s in sides))
    if highest < 2.0 * lowest:
        return False  # too few samples to see it
    axes = _axes(power.shape, steps)
    near = [np.flatnonzero(f < highest) for f in axes]
    f = np.hypot(axes[0][near[0]][:, None], axes[1][near[1]])
    power = power[np.ix_(*near)]
    middle = math.sqrt(lowest * highest)
    lower = float(power[(f >= lowest) & (f < middle)].mean())
    upper = float(power[(f >= middle) & (f < highest)].mean())
    return bool(lower > upper * (highest / middle) ** _FALLS)


@dataclass(frozen=True, slots=True, eq=False)
class _Spread:
    """What holes that are left out of the window do to a density.

    `every` comes to each frequency, `spread` is its mean nearby and `moved` what a white density would get,
    both for each of `_NEAR`; q stays of a wave.
    """

    q: float
    every: FloatArray
    spread: list[FloatArray]
    moved: list[FloatArray]
    more: list[float]

    def leaks(self) -> NDArray[np.bool_]:
        """Return at which frequencies more than `_LEAK` of the density is added."""
        found = np.zeros(self.every.shape, dtype=bool)
        for spread, moved, more in zip(self.spread, self.moved, self.more, strict=True):
            least = max(1.0 + _LEAK / (1.0 - self.q), more) if self.q < 1.0 else np.inf
            found |= spread > least * moved
        return found

    def added(self, power: FloatArray) -> FloatArray:
        """Return the most that comes to each frequency of a density from others.

        It is known no better than as many independent values as the density has, with their weights: of a
        few long waves it may be 1 / chi2 of one value, at 5 %.
        """
        from scipy.special import gammaincinv

        most = np.zeros(power.shape)
        for spread, moved in zip(self.spread, self.moved, strict=True):
            np.maximum(most, np.maximum(self.every, spread) - moved, out=most)
        n = float(power.sum()) ** 2 / float(np.square(power).sum())
        n = max(1.0, n / 2.0 ** sum(v > 1 for v in power.shape))  # padded to twice the size
        return np.asarray(most * (n / float(gammaincinv(n, 0.05))))


def _by_edges(w: FloatArray, whole: FloatArray) -> tuple[FloatArray, float]:
    """Return what holes do to the autocorrelation beyond a factor, by lag, and this factor.

    The autocorrelation of the window with holes over that of the whole one turns the lags of a density
    into those that are read. Its mean q is what stays of every wave; the rest of it spreads.
    """
    from scipy import fft

    shape = _padded(w.shape)
    open_, full = (
        fft.irfft2(np.square(np.abs(fft.rfft2(v, shape))), shape) / float((v * v).sum())
        for v in (w, whole)
    )
    q = float((w.sum() / whole.sum()) ** 2 * (whole**2).sum() / (w * w).sum())
    seen = full > 1e-6
    return np.where(seen, open_ / np.where(seen, full, 1.0) - q, 0.0), q


def _spread(power: FloatArray, rest: FloatArray, q: float) -> _Spread:
    """Return what an autocorrelation of `_by_edges` does to a density."""
    from scipy import fft, ndimage

    n_y, n_x = power.shape
    lags = fft.irfft2(power[:, : n_x // 2 + 1], power.shape)
    every = _both_sides(fft.rfft2(lags * rest).real, n_x)
    # the mean of the logarithm of chi-square with 2 degrees of freedom; one strong wave hides no floor
    level = np.log(np.maximum(power, np.finfo(float).tiny)) + np.euler_gamma
    # below the lowest frequency the trend was taken off: what is just above it stands there
    low = 2 * int(_PERIODS)
    y, x = (np.arange(-2 * low, 2 * low + 1) if n > 4 * low else np.arange(n) for n in (n_y, n_x))
    waves = np.hypot(y[:, None], x)
    near_0 = level[np.ix_(y, x)]
    near_0[waves < low] = near_0[(waves >= low) & (waves < 2 * low)].mean()
    level[np.ix_(y, x)] = near_0
    spread, moved, more = [], [], []
    for wide, times in _NEAR if min(power.shape) > 1 else _NEAR_LINE:
        sizes = [max(1, min(wide, n // 8)) for n in power.shape]
        near = np.exp(ndimage.uniform_filter(level, sizes, mode="wrap"))
        moved.append((1.0 - q) * near)
        # a wide hole spreads to few only
        spread.append(ndimage.uniform_filter(every, sizes, mode="wrap"))
        more.append(times)
    return _Spread(q, every, spread, moved, more)


def _axes(shape: tuple[int, ...], steps: tuple[float, float]) -> list[FloatArray]:
    """Return the frequencies of a density along y and x, without sign."""
    from scipy import fft

    return [np.abs(fft.fftfreq(n, s)) for n, s in zip(shape, steps, strict=True)]


def _both_sides(half: FloatArray, n: int) -> FloatArray:
    """Return a density at all n frequencies along the last axis from those that a real transform gives."""
    after = half[:, 1 : (n + 1) // 2][:, ::-1]
    return np.concatenate([half, np.roll(after[::-1], 1, axis=0)], axis=1)


def _errors(
    z: FloatArray,
    closed: FloatArray,
    outline: NDArray[np.bool_],
    filled: NDArray[np.bool_],
    measured: NDArray[np.bool_],
    square: FloatArray,
    steps: tuple[float, float],
) -> list[tuple[FloatArray, float]]:
    """Return what is wrong where holes of the same shape elsewhere are closed, and the weight of the real ones.

    Elsewhere are the shifts by quarters of a map, by sixteenths of a profile, that put most of the window's
    square on known pixels, the best first.
    """
    from scipy import ndimage

    n_y, n_x = z.shape
    around = ndimage.generate_binary_structure(2, 1) if n_y > 1 else np.ones((1, 3), dtype=bool)
    free = measured & ndimage.binary_erosion(
        outline, around
    )  # what is closed has known neighbours
    parts = 4 if n_y > 1 else 16
    shifts = {(j * n_y // 4, i * n_x // parts) for j in range(4) for i in range(parts)} - {(0, 0)}
    weights = {s: float(square[np.roll(filled, s, (0, 1)) & free].sum()) for s in shifts}
    best = sorted((s for s in shifts if weights[s] > 0.0), key=lambda s: (-weights[s], s))
    found = []
    for shift in best[: _SHIFTS if n_y > 1 else _SHIFTS_LINE]:
        moved = np.roll(filled, shift, (0, 1)) & free
        error = _closed(closed, outline, outline & ~moved, steps) - closed
        found.append((error, float(square[filled].sum()) / weights[shift]))
    return found


def _kept(power: FloatArray, twice: list[tuple[FloatArray, float]]) -> FloatArray:
    """Return the share of a density that closing holes leaves, at most 1: what closing again leaves of it.

    `twice` holds the densities with known pixels closed as well, and the weight of the real holes over theirs.
    The logarithm of a density has the same bias whatever its level, so that the mean of its change nearby is
    that of the share, however steeply the density falls. The median over the shifts is taken: one of them may
    lie on a step or a spike, which the real holes do not.
    """
    from scipy import ndimage

    if not twice:
        return np.ones(power.shape)
    tiny = np.finfo(float).tiny
    level = np.log(np.maximum(power, tiny))
    wide = (_NEAR if min(power.shape) > 1 else _NEAR_LINE)[0][0]
    sizes = [max(1, min(wide, n // 8)) for n in power.shape]
    near = [
        scale * ndimage.uniform_filter(np.log(np.maximum(again, tiny)) - level, sizes, mode="wrap")
        for again, scale in twice
    ]
    return np.asarray(np.exp(np.minimum(np.median(near, axis=0), 0.0)))


def _shares(square: FloatArray, closed: NDArray[np.bool_]) -> list[FloatArray]:
    """Return what closed holes of 0, 1, 2, ... samples along y, and along x, have of the window's square."""
    from scipy import ndimage

    number, n_holes = ndimage.label(closed, structure=np.ones((3, 3), dtype=bool))
    weight = ndimage.sum_labels(square, number, np.arange(1, n_holes + 1)) / square.sum()
    parts = ndimage.find_objects(number)
    sizes = np.array([[s.stop - s.start for s in p] for p in parts], dtype=np.intp).reshape(-1, 2)
    return [np.asarray(np.bincount(own, weight), dtype=np.float64) for own in sizes.T]


def _left(
    f: FloatArray,
    shares: list[FloatArray],
    steps: tuple[float, float],
    axis: int,
    *,
    is_map: bool,
) -> FloatArray:
    """Return the least share of the density along an axis that closed holes leave, by `_shares`.

    Of a wave with s of the window's square on holes, in which the harmonic function holds c of it,
    (1 - s (1 - c))^2 is left. In a single sample of a line c = cos(2 pi f dx), which is -1 where the
    waves are shortest; a hole of n samples has c >= cos(pi f (n + 1) dx), and >= -1 / n. On a map c is
    the mean over both directions by 1 / step^2, and the other one may hold -1.
    """
    sides = [float(is_map) / steps[0] ** 2, 1.0 / steps[1] ** 2]
    along = sides[axis] / sum(sides)
    gone = np.zeros(f.size)
    for n in np.flatnonzero(shares[axis]):
        c = along * np.cos(np.pi * np.minimum(1.0, f * (n + 1) * steps[axis])) - (1.0 - along)
        gone += shares[axis][n] * (1.0 - (np.maximum(c, -1.0 / n) if along == 1.0 else c))
    return np.asarray(np.maximum(1.0 - gone, 0.0) ** 2)


def _mixed(
    closed: FloatArray, open_: float, power: FloatArray, leaks: NDArray[np.bool_], axis: int
) -> FloatArray:
    """Return the share that is left along an axis, from those where holes are closed and where they are not."""
    tiny = np.finfo(float).tiny
    read, every = (
        v.sum(axis=1 - axis)[: closed.size] for v in (np.where(leaks, power, 0.0), power)
    )
    part = read / np.maximum(every, tiny)
    return np.asarray(1.0 / (part / np.maximum(closed, tiny) + (1.0 - part) / max(open_, tiny)))


def _padded(shape: tuple[int, ...]) -> tuple[int, ...]:
    return tuple(2 * n if n > 1 else 1 for n in shape)


def _spectrum(
    power: FloatArray,
    w: FloatArray,
    steps: tuple[float, float],
    history: tuple[Step, ...],
    *,
    is_map: bool,
) -> dict[str, Any]:
    """Return densities, and what the window over the measured pixels says of them."""
    from scipy import fft

    squares = w * w
    cell = math.prod(steps) if is_map else steps[1]
    lengths, lowest, one_sided = [], [], []
    areal = None
    shape = power.shape
    for axis in (1, 0) if is_map else (1,):
        step, n = steps[axis], shape[axis]
        other = steps[1 - axis] * shape[1 - axis] if is_map else 1.0
        density = power.sum(axis=1 - axis)[: n // 2 + 1] / other
        density[1 : (n + 1) // 2] *= 2.0
        one_sided.append(Psd(np.arange(n // 2 + 1) / (n * step), density, history))
        along = squares.sum(axis=1 - axis)
        lengths.append(step * float(along.sum() ** 2 / (along**2).sum()))
        lowest.append(_PERIODS / (w.shape[axis] * step))
    if is_map:
        f_y, f_x = (fft.fftshift(fft.fftfreq(n, s)) for n, s in zip(shape, steps, strict=True))
        areal = ArealPsd(f_x, f_y, fft.fftshift(power), history)
    return {
        "areal": areal,
        "one_sided": tuple(one_sided),
        "lengths": tuple(lengths),
        "window_area": cell * float(squares.sum()) ** 2 / float((squares**2).sum()),
        "lowest": tuple(lowest),
    }
