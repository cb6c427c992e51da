"""Spatial parameters of a map from its autocorrelation: Sal, Str and Std.

The autocorrelation at a lag is the mean product of the pairs of valid pixels that far apart, over
the mean square. It is divided by the number of pairs at that lag, not by the number of pixels, so
it does not fall only because the map ends or has holes; nothing is filled. Lags reach to half the
map in each direction. The function is even, so half a plane of lags holds all of it.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray

from metrosep.core._arrays import FloatArray, frozen_float
from metrosep.core.errors import DataError, InvalidSamplesError, TooFewSamplesError
from metrosep.core.numbers import positive
from metrosep.core.units import format_length

_MIN_SIZE = 8
"""Fewest rows and columns: lags to four pixels."""

_ANGLE_STEP = math.radians(0.25)
"""Width of a bin of the angular spectrum."""

_ANGLE_SMOOTHING = math.radians(2.0)
"""Standard deviation of the smoothing of the angular spectrum: a wave of 15 periods on the map has
directions this far apart."""

_RIVAL = 0.9
"""Second maximum over the first above which no direction dominates."""

_RAY_STEP = 0.5
"""Pixels between the places where a line from lag zero is compared with the threshold."""

_MIN_PAIRS = 0.1
"""Fewest pairs at a lag as a share of the valid pixels; half lags of a complete map have 0.25."""


@dataclass(frozen=True, slots=True, eq=False)
class Autocorrelation:
    """Autocorrelation of a map at the lags of its grid."""

    # shape (m_y + 1, 2 m_x + 1): 1 at lag zero, ``values[0, m_x]``; rows are lags 0 to m_y in y,
    # columns -m_x to m_x in x. NaN at lags with too few pairs
    values: FloatArray
    dx: float  # m: lateral steps
    dy: float

    @property
    def m_x(self) -> int:
        """Largest lag in x, pixels."""
        return int(self.values.shape[1] // 2)

    @property
    def m_y(self) -> int:
        """Largest lag in y, pixels."""
        return int(self.values.shape[0] - 1)


@dataclass(frozen=True, slots=True)
class CentralLobe:
    """How far from lag zero the autocorrelation falls to the threshold."""

    shortest: float  # m: sal, the shortest distance over all directions
    # m: the longest one; None if the lobe reaches the largest lag, so that it is not known
    longest: float | None
    direction_shortest: float  # rad: where they are, counter-clockwise from +x to +y, 0 to pi
    direction_longest: float | None

    @property
    def aspect_ratio(self) -> float | None:
        """Str, shortest over longest, 0 to 1; None where the longest is not known."""
        return None if self.longest is None else self.shortest / self.longest


def autocorrelation(z: ArrayLike, dx: float, dy: float) -> Autocorrelation:
    """Return the autocorrelation of the valid pixels about their mean.

    With d = z - mean and m = 1 where valid, 0 elsewhere (d = 0 there):
    acf(t) = [sum d(x) d(x + t) / sum m(x) m(x + t)] / [sum d^2 / sum m], both sums by FFT with
    zeros behind the map, so that nothing wraps round. Lags with fewer pairs than a tenth of the
    valid pixels are NaN. O(n log n).

    Source: ISO 25178-2:2021, autocorrelation function (the standard shifts a limited area; the
       count of pairs is this package's estimate of it).

    Examples
    --------
    >>> import numpy as np
    >>> x = np.arange(200)
    >>> acf = autocorrelation(np.tile(np.cos(2 * np.pi * x / 20), (50, 1)), 1e-6, 1e-6)
    >>> f"{acf.values[0, acf.m_x + 20]:.3f} {acf.values[7, acf.m_x - 10]:.3f}"
    '1.000 -1.000'
    """
    heights = _cropped(frozen_float(z, name="z", ndim=2))
    _check_map(heights, dx, dy)
    measured = heights == heights
    n = int(np.count_nonzero(measured))
    complete = n == heights.size
    n_y, n_x = heights.shape
    sums = _half_plane_sums(_centred(heights, measured, n))
    if complete:
        pairs = np.outer(
            n_y - np.arange(n_y // 2 + 1), n_x - np.abs(np.arange(-(n_x // 2), n_x // 2 + 1))
        ).astype(np.float64)
    else:
        pairs = np.rint(_half_plane_sums(measured.astype(np.float64)))
        pairs[pairs < _MIN_PAIRS * n] = np.nan
    sums /= pairs
    sums /= sums[0, n_x // 2]
    return Autocorrelation(sums, dx, dy)


def _cropped(heights: FloatArray) -> FloatArray:
    """Return the map without the empty rows and columns around it: they hold no lag."""
    measured = heights == heights
    rows, columns = (np.nonzero(measured.any(axis=a))[0] for a in (1, 0))
    if rows.size == 0:
        raise InvalidSamplesError("no pixel is valid: there is nothing to correlate")
    return heights[rows[0] : rows[-1] + 1, columns[0] : columns[-1] + 1]


def _centred(heights: FloatArray, measured: NDArray[np.bool_], n: int) -> FloatArray:
    """Return the heights about their mean over the largest of them, zero where not measured.

    The second mean takes off what rounding left of the first.
    """
    d = np.where(measured, heights, 0.0)
    low = float(np.min(heights, where=measured, initial=np.inf))
    high = float(np.max(heights, where=measured, initial=-np.inf))
    if low == high:
        raise DataError("all heights are equal: there is no texture to correlate")
    for _ in range(2):
        mean = float(np.add.reduce(d, axis=None)) / n
        np.subtract(d, mean, out=d, where=measured)
    d /= high - low
    return d


def _check_map(heights: FloatArray, dx: float, dy: float) -> None:
    for name, step in (("dx", dx), ("dy", dy)):
        positive(step, name, dimension="length")
    if min(heights.shape) < _MIN_SIZE:
        raise TooFewSamplesError(
            f"an autocorrelation needs at least {_MIN_SIZE} x {_MIN_SIZE} pixels, got "
            f"{heights.shape[0]} x {heights.shape[1]}"
        )


def _half_plane_sums(d: FloatArray) -> FloatArray:
    """Return sum d(x) d(x + t) for lags 0 to n_y / 2 in y and -n_x / 2 to n_x / 2 in x."""
    from scipy import fft

    n_y, n_x = d.shape
    m_y, m_x = n_y // 2, n_x // 2
    shape = (fft.next_fast_len(n_y + m_y, real=True), fft.next_fast_len(n_x + m_x, real=True))
    # Rows of zeros are not transformed, and of the lags in y only those that are wanted.
    spectrum = fft.fft(fft.rfft(d, shape[1]), shape[0], axis=0, overwrite_x=True)
    power = spectrum.real**2
    power += spectrum.imag**2
    lags = fft.irfft(fft.ifft(power, axis=0)[: m_y + 1], shape[1], overwrite_x=True)
    return np.concatenate([lags[:, -m_x:], lags[:, : m_x + 1]], axis=1)


def central_lobe(acf: Autocorrelation, *, threshold: float = 0.2) -> CentralLobe:
    """Return how far the central lobe of an autocorrelation reaches, shortest and longest.

    A lag belongs to the lobe if the straight line from lag zero to it stays at or above the
    threshold. Its nearest end is looked for on every grid line between two lags, one inside and one
    below the threshold, its farthest on straight lines from lag zero; the two are then found with a
    cubic interpolation along their direction. If the lobe reaches the edge of the lags, its
    shortest distance is given only where it is shorter than any lag of that edge, and the longest
    not where that edge is in sight of lag zero.

    Source: ISO 25178-2:2021, 4.3.2 (Sal) and 4.3.3 (Str); threshold 0.2 from ISO 25178-3 (clause
       numbers recalled, not checked).
    """
    from scipy import ndimage

    if not 0.0 < threshold < 1.0:
        raise DataError(
            f"the threshold of the autocorrelation is between 0 and 1, got {threshold}"
        )
    values = np.nan_to_num(acf.values, nan=-1.0)
    labels, _ = ndimage.label(values >= threshold, structure=np.ones((3, 3), dtype=bool))
    lobe = labels == labels[0, acf.m_x]
    edge = _distance_of_open_edge(acf, lobe)
    ends = _ends(acf, values, lobe, threshold)
    distances = np.hypot(ends[:, 0] * acf.dx, ends[:, 1] * acf.dy)
    order = np.argsort(distances, kind="stable")
    if not order.size or distances[order[0]] > edge:
        if (edge < min(acf.m_x * acf.dx, acf.m_y * acf.dy)) and np.isnan(acf.values).any():
            raise DataError(
                f"the autocorrelation is not known beyond {format_length(edge)}, where it is still above "
                f"{threshold:g}: fewer than {100 * _MIN_PAIRS:g} % of the pixels have another one a lag "
                "further; pixels are missing in a pattern, or the part is narrow"
            )
        raise DataError(
            f"the autocorrelation is still above {threshold:g} at the largest lag, half the map: "
            "the map is too small for its texture, or form or waviness was not removed"
        )
    shortest, towards = _polished(acf, values, ends[order[0]], threshold, sign=1.0)
    end = _farthest_in_sight(acf, lobe, threshold)
    if end is None:
        return CentralLobe(shortest, None, towards, None)
    longest, along = _polished(acf, values, end, threshold, sign=-1.0)
    return CentralLobe(shortest, max(longest, shortest), towards, along)


def _distance_of_open_edge(acf: Autocorrelation, lobe: NDArray[np.bool_]) -> float:
    """Return the distance of the nearest lag of the lobe beyond which nothing is known; inf if none."""
    from scipy import ndimage

    unknown = np.isnan(np.pad(acf.values, ((0, 1), (1, 1)), constant_values=np.nan))
    beside = ndimage.binary_dilation(unknown)[:-1, 1:-1] & lobe
    rows, columns = np.nonzero(beside)
    if rows.size == 0:
        return math.inf
    return float(np.hypot((columns - acf.m_x) * acf.dx, rows * acf.dy).min())


def _ends(
    acf: Autocorrelation, values: FloatArray, lobe: NDArray[np.bool_], threshold: float
) -> FloatArray:
    """Return where grid lines leave the lobe, shape (n, 2), x and y in pixels from lag zero."""
    found: list[FloatArray] = []
    for along_y, along_x in ((0, 1), (0, -1), (1, 0), (-1, 0)):
        here = tuple(slice(max(0, -a), min(0, -a) or None) for a in (along_y, along_x))
        there = tuple(slice(max(0, a), min(0, a) or None) for a in (along_y, along_x))
        below = (values[there] < threshold) & ~np.isnan(acf.values[there])
        rows, columns = np.nonzero(lobe[here] & below)
        inside = values[here][rows, columns]
        share = (inside - threshold) / (inside - values[there][rows, columns])
        x = columns + here[1].start - acf.m_x + along_x * share
        y = rows + here[0].start + along_y * share
        found.append(np.stack([x, y], axis=1))
    return np.concatenate(found)


def _farthest_in_sight(
    acf: Autocorrelation, lobe: NDArray[np.bool_], threshold: float
) -> FloatArray | None:
    """Return the farthest end of the lobe that lag zero sees, x and y in pixels; None if not known.

    Straight lines from lag zero, half a pixel apart at the farthest lag of the lobe, each up to where
    the bilinear autocorrelation falls below the threshold. It is not known where one of them is still
    above it at the last lag.
    """
    from scipy import ndimage

    rows, columns = np.nonzero(lobe)
    reach = float(np.hypot(columns - acf.m_x, rows).max()) + 2.0
    angles = np.linspace(0.0, math.pi, math.ceil(2.0 * math.pi * reach), endpoint=False)
    directions = np.stack([np.sin(angles), np.cos(angles)])
    before = np.ones(angles.size)
    best, end = 0.0, np.zeros(2)
    for r in np.arange(_RAY_STEP, reach + 2.0, _RAY_STEP):
        y, x = r * directions
        value = ndimage.map_coordinates(
            acf.values, [y, acf.m_x + x], order=1, mode="constant", cval=np.nan
        )
        if np.isnan(value).any():
            return None
        falls = value < threshold
        if falls.any():
            share = (before[falls] - threshold) / (before[falls] - value[falls])
            ends = (r - _RAY_STEP * (1.0 - share)) * directions[:, falls]
            distances = np.hypot(ends[0] * acf.dy, ends[1] * acf.dx)
            k = int(np.argmax(distances))
            if distances[k] > best:
                best, end = float(distances[k]), ends[::-1, k]
        directions, before = directions[:, ~falls], value[~falls]
        if not before.size:
            break
    return end


def _polished(
    acf: Autocorrelation, values: FloatArray, end: FloatArray, threshold: float, *, sign: float
) -> tuple[float, float]:
    """Return distance in m and direction of an end of the lobe, by a cubic through its surroundings.

    `sign` is 1 for the shortest distance and -1 for the longest: directions within a pixel on
    either side are tried as well.
    """
    from scipy import optimize

    length, angle = math.hypot(float(end[0]), float(end[1])), math.atan2(end[1], end[0])
    excess = _cubic_around(acf, values, end, threshold)

    def distance(a: float) -> float:
        c, s = math.cos(a), math.sin(a)
        root = length if a == angle else math.nan
        if excess is not None:
            # The next lobe may begin within a pixel or two: the first crossing is the end.
            t = np.linspace(max(length - 1.5, 0.0), length + 1.5, 31)
            above = excess(t * c, t * s) > 0.0
            first = int(np.argmin(above))
            if above[0] and not above[first]:
                root = optimize.brentq(
                    lambda t: excess(t * c, t * s)[0], t[first - 1], t[first], xtol=1e-9
                )
        return float(root) * math.hypot(c * acf.dx, s * acf.dy)

    here = distance(angle)
    reach = 1.0 / max(length, 1.0)
    trials = [(here, angle)]
    if excess is not None:
        # A direction without an end loses; it is finite, as the search draws parabolas.
        worst = max(sign, 0.0) * (length + 2.0) * math.hypot(acf.dx, acf.dy)
        found = optimize.minimize_scalar(
            lambda a: float(np.nan_to_num(sign * distance(a), nan=worst)),
            bounds=(angle - reach, angle + reach),
            method="bounded",
            options={"xatol": 1e-3 * reach},
        )
        trials.append((distance(float(found.x)), float(found.x)))
    best, a = min((t for t in trials if not math.isnan(t[0])), key=lambda t: sign * t[0])
    return best, _half_turn(math.atan2(math.sin(a) * acf.dy, math.cos(a) * acf.dx))


def _half_turn(angle: float) -> float:
    """Return an angle modulo pi, 0 <= angle < pi also after rounding."""
    turned = angle % math.pi
    return turned if turned < math.pi else 0.0


def _cubic_around(
    acf: Autocorrelation, values: FloatArray, end: FloatArray, threshold: float
) -> Callable[[FloatArray | float, FloatArray | float], FloatArray] | None:
    """Return the autocorrelation less the threshold near an end, x and y in pixels from lag zero."""
    from scipy import ndimage

    reach = 8
    x0, y0 = round(float(end[0])) - reach, round(float(end[1])) - reach
    ys, xs = np.mgrid[y0 : y0 + 2 * reach + 1, x0 : x0 + 2 * reach + 1]
    # The half plane and, for lags below zero in y, its mirror image.
    ys, xs = np.where(ys < 0, -ys, ys), np.where(ys < 0, -xs, xs)
    if int(ys.max()) > acf.m_y or int(np.abs(xs).max()) > acf.m_x:
        return None
    cubic = ndimage.spline_filter(values[ys, xs + acf.m_x], order=3)

    def excess(x: FloatArray | float, y: FloatArray | float) -> FloatArray:
        at = np.stack([np.atleast_1d(y) - y0, np.atleast_1d(x) - x0])
        found: FloatArray = ndimage.map_coordinates(cubic, at, order=3, prefilter=False)
        return found - threshold

    return excess


def dominant_wavelength(z: ArrayLike, dx: float, dy: float = 1.0) -> float:
    """Return Ssw (Rsw of one row): the wavelength of the largest magnitude of the Fourier transform.

    The mean is removed, there is no window, and the zero frequency is omitted. Pixels that were
    not measured count as the mean: a hole has no height of its own.

    Source: ISO 25178-2:2021, ISO 21920-2:2021, 4.3 (recalled, not checked).
    """
    from scipy import fft

    heights = _cropped(np.asarray(z, dtype=np.float64))
    measured = heights == heights
    d = _centred(heights, measured, int(np.count_nonzero(measured)))
    magnitude = np.abs(fft.rfft2(d, overwrite_x=True))
    magnitude[0, 0] = 0.0
    row, column = np.unravel_index(int(np.argmax(magnitude)), magnitude.shape)
    f_y = fft.fftfreq(heights.shape[0], dy)[row]
    f_x = fft.rfftfreq(heights.shape[1], dx)[column]
    return 1.0 / math.hypot(float(f_x), float(f_y))


def texture_direction(
    acf: Autocorrelation, *, of: Literal["amplitude", "power"] = "power"
) -> float:
    """Return the direction Std in which the angular spectrum is largest.

    The power spectrum is the Fourier transform of the autocorrelation under a Hann window, so a
    map with holes has one too. Its amplitude or power is summed in sectors of 0.25 deg inside the largest
    circle of frequencies that both axes have, and smoothed over the angle by a Gaussian of 2 deg.

    Source: ISO 25178-2:2012, 4.2.3, takes the power (recalled); whether 2021, 4.3.4, takes the amplitude
       could not be checked.
    """
    angles, spectrum = _angular_spectrum(acf, of)
    best = int(np.argmax(spectrum))
    n = angles.size
    before, after = spectrum[best - 1], spectrum[(best + 1) % n]
    bend = before - 2.0 * spectrum[best] + after
    shift = 0.5 * (before - after) / bend if bend < 0.0 else 0.0
    rivals = (spectrum >= np.roll(spectrum, 1)) & (spectrum > np.roll(spectrum, -1))
    away = np.abs((np.arange(n) - best + n // 2) % n - n // 2) > round(
        2.0 * _ANGLE_SMOOTHING / _ANGLE_STEP
    )
    second = float(np.max(spectrum, where=rivals & away, initial=0.0))
    if second >= _RIVAL * spectrum[best]:
        rival = float(np.degrees(angles[int(np.argmax(np.where(rivals & away, spectrum, -1.0)))]))
        raise DataError(
            f"no direction dominates: the angular spectrum at {rival:.0f} deg has "
            f"{100 * second / spectrum[best]:.0f} % of its maximum at "
            f"{math.degrees(angles[best]):.0f} deg; the texture is crossed or isotropic"
        )
    return _half_turn(float(angles[best]) + float(shift) * _ANGLE_STEP)


def _angular_spectrum(acf: Autocorrelation, of: str) -> tuple[FloatArray, FloatArray]:
    """Return angles and the amplitude or power in each direction, smoothed over the angle."""
    from scipy import fft, ndimage

    m_y, m_x = acf.m_y, acf.m_x
    shape = (2 * m_y + 2, 2 * m_x + 2)
    wrapped = np.zeros(shape)
    lags_y, lags_x = np.arange(m_y + 1), np.arange(-m_x, m_x + 1)
    window = np.outer(
        np.cos(0.5 * np.pi * lags_y / (m_y + 1)) ** 2,
        np.cos(0.5 * np.pi * lags_x / (m_x + 1)) ** 2,
    )
    half = np.nan_to_num(acf.values) * window
    wrapped[np.ix_(lags_y, lags_x)] = half
    wrapped[np.ix_(-lags_y[1:], -lags_x)] = half[1:]
    power = fft.rfft2(wrapped).real
    if of == "amplitude":
        power = np.sqrt(np.maximum(power, 0.0))  # noise of the estimate may be below zero
    f_y = fft.fftfreq(shape[0], acf.dy)[:, None]
    f_x = fft.rfftfreq(shape[1], acf.dx)[None, :]
    inside = f_x**2 + f_y**2 < min(0.5 / acf.dx, 0.5 / acf.dy) ** 2
    inside[0, 0] = False
    # A column f_x = 0 holds both f and -f, every other one stands for its mirror image too.
    power[:, 1:] *= 2.0
    n = round(math.pi / _ANGLE_STEP)
    sector = np.rint(np.arctan2(f_y, f_x)[inside] / _ANGLE_STEP).astype(np.intp) % n
    spectrum = np.bincount(sector, weights=power[inside], minlength=n)
    smooth = ndimage.gaussian_filter1d(spectrum, _ANGLE_SMOOTHING / _ANGLE_STEP, mode="wrap")
    angles: FloatArray = np.arange(n, dtype=np.float64) * _ANGLE_STEP
    return angles, np.asarray(smooth, dtype=np.float64)
