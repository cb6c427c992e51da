"""A band of wavelengths taken out with sharp edges, on profiles and surfaces with gaps.

The two Gaussian filters of a band overlap: of a band whose ends are a factor of 1.7 apart they leave
half in the middle. Here the waves of the band are fitted to what was measured and subtracted.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from metrosep.core._arrays import FloatArray
from metrosep.core.docs import documented
from metrosep.core.errors import DataError, TooFewSamplesError
from metrosep.core.numbers import positive
from metrosep.core.provenance import Step
from metrosep.core.surface import Surface
from metrosep.core.units import format_length
from metrosep.filters import _arguments as arguments
from metrosep.filters._arguments import DOCS, Measured

_PASSES = 4
"""Times that the waves of the band are looked for in what is left: the page has the table."""

_BRIDGED = 4
"""Samples on each side of a gap that are filled: gaps of twice as many are bridged. The page has the table."""

_INSIDE, _OUTSIDE = 1.0, 6.0
"""Resolution cells 1/L beyond the band that are taken too, and from which 95 % of a wave stays."""

_LONGEST = 0.25
"""Of the shorter side: four waves and more are distinguished from a parabola, of which 5 % is left."""

_PADDED = 1.25
"""Length of the transform over that of the data: what leaves one end does not come in at the other."""


class BandEdges(NamedTuple):
    """What a band stop does to waves, by their length.

    Parameters
    ----------
    shortest, longest : float, m
        Less than 5 % of the amplitude of each wave from the one to the other is left, over the whole.
    shorter, longer : float, m
        95 % and more stays of waves shorter than the one, and longer than the other; inf where none
        is so long within what was measured. Where samples are missing less may stay, most of all of
        the shorter ones if the band holds nearly all other waves.
    """

    shortest: float
    longest: float
    shorter: float
    longer: float


@documented(**DOCS)
def band_stop(obj: Measured, *, shortest: float | str, longest: float | str) -> Measured:
    """Return a profile or surface without the waves between two lengths.

    Parameters
    ----------
    $obj
    shortest, longest : float (m) or str with unit
        Ends of the band; both are in it. `longest` is at most a quarter of the shortest side
        that was measured, `shortest` more than two steps.

    Returns
    -------
    Profile or Surface
        Same grid, NaN where not measured. Less than 5 % of the amplitude of each wave in the band is
        left, over the whole, and 95 % and more of each wave beyond the edges that `band_edges` gives;
        between them a part. Within about a wavelength of the ends of the data up to three quarters of
        the amplitude may be left. A parabola (of a surface with its tilts and twist) stays.

    Raises
    ------
    DataError
        If the band is not a band, is longer than a quarter of what was measured or shorter than two steps,
        or the surface has no lateral step.
    $uniform
    TooFewSamplesError
        If nothing was measured.

    Notes
    -----
    With D what fills the gaps between the samples that were measured and B the waves of the band on a grid 1.25 times as long,
    ``b <- b + B D (z - p - b)``, four times from zero, is Landweber's iteration for the waves of the
    band that fit z best beside the parabola p of z - b; z - D b is returned. B has sharp edges: a step or a spike rings in what is left,
    as its own waves in the band are gone. Remove form and spikes before. Cost: eight Fourier transforms.

    Examples
    --------
    >>> import numpy as np
    >>> from metrosep import Profile
    >>> x = np.arange(4000) * 1e-6
    >>> mark, part = 20e-9 * np.sin(2 * np.pi * x / 50e-6), 50e-9 * np.sin(2 * np.pi * x / 200e-6)
    >>> left = band_stop(Profile(x, mark + part), shortest="40 um", longest="60 um")
    >>> bool(np.std(left.z - part) < 0.05 * np.std(mark) + 0.02 * np.std(part))
    True
    """
    short, long, steps = _checked(obj, shortest, longest)
    z = np.atleast_2d(obj.z)
    valid = ~np.isnan(z)
    if not valid.any():
        raise TooFewSamplesError("nothing was measured: there are no waves to remove")
    found = (z - _waves(z, valid, steps, short, long)).reshape(obj.z.shape)
    facts = {"shortest_m": short, "longest_m": long}
    return arguments.like(obj, found, step=Step("band stop", facts), short=False)


def band_edges(obj: Measured, *, shortest: float | str, longest: float | str) -> BandEdges:
    """Return which waves `band_stop` takes out, and which it leaves.

    Parameters
    ----------
    obj : Profile or Surface
        What is filtered; its size alone matters.
    shortest, longest : float (m) or str with unit
        Ends of the band.

    Returns
    -------
    BandEdges
        By wavelength, m.

    Raises
    ------
    DataError
        As by `band_stop`.

    Examples
    --------
    >>> import numpy as np
    >>> from metrosep import Profile
    >>> line = Profile(np.arange(1000) * 1e-6, np.zeros(1000))
    >>> edges = band_edges(line, shortest="20 um", longest="50 um")
    >>> [round(1e6 * v, 2) for v in edges]
    [20.0, 50.0, 17.86, 71.43]
    """
    short, long, steps = _checked(obj, shortest, longest)
    cells = _OUTSIDE / _length(np.atleast_2d(obj.z).shape, steps)
    low = 1.0 / long - cells
    return BandEdges(
        short, long, 1.0 / (1.0 / short + cells), 1.0 / low if low > 0.0 else math.inf
    )


def _checked(
    obj: Measured, shortest: float | str, longest: float | str
) -> tuple[float, float, tuple[float, float]]:
    """Return the ends of a band and the steps along y and x, m."""
    if isinstance(obj, Surface):
        steps = arguments.surface_steps(obj)  # dy, dx
    else:
        steps = (math.inf, obj.dx)
    short = positive(shortest, "shortest", dimension="length")
    long = positive(longest, "longest", dimension="length")
    if not short < long:
        raise DataError(
            f"shortest = {format_length(short)} must be shorter than longest = {format_length(long)}"
        )
    z = np.atleast_2d(obj.z)
    most, least = _LONGEST * _length(z.shape, steps), 2.0 * max(s for s in steps if s < math.inf)
    if long > most * (1.0 + 1e-9):
        raise DataError(
            f"longest = {format_length(long)} is more than a quarter of what was measured, "
            f"{format_length(most)}: such waves cannot be distinguished from the form; remove a form"
        )
    if short <= least:
        raise DataError(
            f"shortest = {format_length(short)} does not exceed two steps, {format_length(least)}: "
            "shorter waves are not in the data; is the unit m?"
        )
    return short, long, steps


def _length(shape: tuple[int, ...], steps: tuple[float, float]) -> float:
    """Return the shorter side that was measured, m."""
    return min(n * s for n, s in zip(shape, steps, strict=True) if n > 1 and s < math.inf)


def _parabola(z: FloatArray, valid: NDArray[np.bool_]) -> FloatArray:
    """Return the polynomial of second degree through what was measured, on the whole grid."""
    v, u = (np.linspace(-1.0, 1.0, n) if n > 1 else np.zeros(1) for n in z.shape)
    powers = [(i, j) for i in range(3) for j in range(3 - i) if z.shape[0] > 1 or i == 0]
    # normal equations of products of powers: six by six, whatever the size of the map
    weight = valid.astype(np.float64)
    known = np.where(valid, z, 0.0)
    mean = known.sum() / weight.sum()
    known = np.where(valid, z - mean, 0.0)
    a = np.array(
        [[float(v ** (i + k) @ weight @ u ** (j + m)) for k, m in powers] for i, j in powers]
    )
    b = np.array([float(v**i @ known @ u**j) for i, j in powers])
    c = np.linalg.lstsq(a, b, rcond=None)[0]
    fitted = sum(q * np.outer(v**i, u**j) for q, (i, j) in zip(c, powers, strict=True))
    return np.asarray(mean + fitted)


def _bridged(rest: FloatArray, valid: NDArray[np.bool_]) -> FloatArray:
    """Return heights with gaps of up to 2 `_BRIDGED` samples filled from both sides, the middle of others 0.

    A long wave that is 0 in many gaps has short waves too, which would be taken from it.
    """
    from scipy import ndimage

    for _ in range(_BRIDGED):
        if valid.all():
            break
        near, total = valid.astype(np.float64), rest
        for axis in (0, 1):
            near, total = (
                ndimage.correlate1d(v, (0.25, 0.5, 0.25), axis=axis, mode="constant")
                for v in (near, total)
            )
        reached = ~valid & (near > 0.0)
        rest = np.where(reached, total / np.where(reached, near, 1.0), rest)
        valid = valid | reached
    return rest


def _waves(
    z: FloatArray, valid: NDArray[np.bool_], steps: tuple[float, float], short: float, long: float
) -> FloatArray:
    """Return the waves of a band."""
    from scipy import fft

    rows, columns = z.shape
    big = [fft.next_fast_len(math.ceil(_PADDED * n), real=True) if n > 1 else 1 for n in z.shape]
    fy = fft.fftfreq(big[0], steps[0] if rows > 1 else 1.0)[:, np.newaxis]
    f = np.hypot(fy, fft.rfftfreq(big[1], steps[1]))
    cell = _INSIDE / _length(z.shape, steps)
    band = (f >= 1.0 / long - cell) & (f <= 1.0 / short + cell) & (f > 0.0)
    taken, whole = np.zeros(z.shape), np.zeros(big)
    for _ in range(_PASSES):
        rest = z - taken
        rest = np.where(valid, rest - _parabola(rest, valid), 0.0)
        whole[:rows, :columns] = _bridged(rest, valid)
        found = fft.irfft2(fft.rfft2(whole) * band, s=big)
        taken += found[:rows, :columns]
    return taken
