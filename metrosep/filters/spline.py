"""Spline filter of profiles (ISO 16610-22) and surfaces (ISO 16610-62).

The mean line w minimises ``sum W (w - z)^2 + k^2 b sum (first difference of w)^2
+ k^4 (1 - b) sum (second difference of w)^2`` with ``k = 1 / (2 sin(pi dx / Lc))`` and the tension
b, here 0 unless asked for. W is 1 where z was measured and 0 elsewhere. Natural ends: the sums run
over whole differences only, so a straight line costs nothing. Closed: the last sample precedes
the first.

The normal equations have a condition number of order k^4 and lose every digit at 10 000 samples
per cut-off. The same solution with the bending ``m = k^2 D w`` as a second unknown has order k^2.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from metrosep.core._arrays import FloatArray
from metrosep.core.blas import one_blas_thread
from metrosep.core.docs import documented
from metrosep.core.errors import (
    DegenerateFitError,
    NotConvergedError,
)
from metrosep.core.numbers import between, choice, count
from metrosep.core.provenance import Step
from metrosep.filters import _arguments as arguments
from metrosep.filters._arguments import DOCS, FilterBand, Measured, Wavelength, Wavelengths

Smoother = Callable[[FloatArray], FloatArray]

_BLOCK = 256
"""Columns solved at once: 4096 rows of them stay within 16 MB."""

_STIFFEST = 1e6 / (2.0 * np.pi)
"""k at 10^6 samples per cut-off, where rounding has grown to 1e-6 of the heights."""

_GAP_TOLERANCE = 1e-10
"""Residual of the iteration over gaps relative to its start: far below any instrument's noise."""


@documented(**DOCS)
def spline(
    obj: Measured,
    *,
    cutoff: Wavelength = None,
    nesting_index: Wavelengths = None,
    band: FilterBand = "long",
    end: Literal["natural", "closed"] = "natural",
    tension: float = 0.0,
    fill: bool = False,
    refilter: bool = False,
    max_iterations: int = 1000,
) -> Measured:
    """Return the spline mean line or surface, or what it leaves.

    Parameters
    ----------
    $obj
    $cutoff
    band : {"long", "short"}, optional
        The mean line w, or z - w.
    end : {"natural", "closed"}, optional
        Free ends, or a closed line whose length is n steps; a surface is closed in both axes.
    tension : float, dimensionless, 0 <= tension <= 1, optional
        Share b of the first difference; at 1 the second one has no part.
    fill : bool, optional
        Also give the mean line (``band="long"``) in the gaps. Beyond the first and the last
        measured row, column or sample it stays NaN: nothing is extrapolated.
    $refilter
    max_iterations : int, optional
        Limit of the iteration that a surface or a closed profile with gaps needs.

    Returns
    -------
    Profile or Surface
        Same grid; NaN where not measured unless `fill`; no measured sample is lost. A profile of
        the short band is of kind R (of a W profile W).

    Raises
    ------
    DataError
        If the argument is of the wrong name for the object, the cut-off is outside its limits, an
        option is unknown, or the surface has no lateral step.
    $twice
    InvalidSamplesError
        If the cut-off is not positive and finite, or a closed profile repeats its first sample.
    $uniform
    TooFewSamplesError
        If fewer than 3 samples, rows or columns, or fewer than 4 pixels were measured.
    DegenerateFitError
        If the measured pixels do not determine ``1, x, y, xy``, or a profile has too many samples
        per cut-off for double precision.
    NotConvergedError
        If the iteration over gaps needs more than `max_iterations`.

    Notes
    -----
    Transmission of the mean line ``1 / (1 + b r^2 + (1 - b) r^4)``,
    ``r = sin(pi dx / L) / sin(pi dx / Lc)``: 1/2 at the cut-off for every b. The least-squares
    line (plane) is taken off before and put back after. With b = 0 that only saves digits; with
    b > 0 it also makes lines exact, which tension alone would flatten at the ends.

    Surfaces: lines along x, then along y, which is the tensor product of the two. With gaps, the
    measured pixels keep weight 1 and the missing ones 0 in that same product, and a conjugate
    gradient over the missing heights finds the solution; large gaps cost many passes.

    References
    ----------
    .. [1] ISO 16610-22:2015, linear profile filters: spline filters.
    .. [2] ISO 16610-62:2023, linear areal filters: spline filters.

    Examples
    --------
    >>> import numpy as np
    >>> from metrosep import Profile
    >>> x = np.arange(2001) * 0.5e-6
    >>> wave = Profile(x, 1e-6 * np.cos(2 * np.pi * x / 80e-6))
    >>> mean_line = spline(wave, cutoff=80e-6)
    >>> round(float(mean_line.z[960] / wave.z[960]), 6)
    0.5
    """
    arguments.check_object(obj)
    arguments.check_band(band)
    choice(end, "end", ("natural", "closed"))
    tension = between(tension, "tension", 0.0, 1.0)
    count(max_iterations, "max_iterations", least=0)
    arguments.check_single_filtering(obj, refilter, band=band)
    task = arguments.task_of(
        obj,
        cutoff,
        nesting_index,
        what="a spline filter",
        areal="an areal spline filter",
        minimum=(3, 4),
        closed=end == "closed",
    )
    low = task.place(_mean(task, end, tension, max_iterations), obj.z.shape)
    if not fill:
        low[np.isnan(obj.z)] = np.nan
    step = Step("spline", {**task.named, "band": band, "end": end, "tension": tension})
    return arguments.finish(obj, low, band=band, step=step)


def _mean(task: arguments.Task, end: str, tension: float, max_iterations: int) -> FloatArray:
    """Return the mean line everywhere, also where nothing was measured."""
    z = task.z
    missing = np.isnan(z)
    trend = np.full(z.shape, np.nanmean(z)) if end == "closed" else _linear(z)
    rest = np.where(missing, 0.0, z - trend)
    stiffness = [
        1.0 / (2.0 * np.sin(np.pi * s / w))
        for s, w in zip(task.steps, task.wavelengths, strict=True)
    ]
    with one_blas_thread():
        if z.ndim == 1 and end == "natural":
            weights = (~missing).astype(np.float64)
            return trend + _natural_smoother(z.size, stiffness[0], tension, weights)(rest)
        make = _closed_smoother if end == "closed" else _natural_smoother
        smoothers = [make(n, k, tension) for n, k in zip(z.shape, stiffness, strict=True)]

        def smooth(values: FloatArray) -> FloatArray:
            """Filter along each axis in turn."""
            result = smoothers[-1](values.T).T if values.ndim == 2 else values
            return smoothers[0](result)

        if missing.any():
            if end == "natural":
                _require_bilinear(missing)
            rest = _with_gaps(rest, missing, smooth, max_iterations)
        return trend + smooth(rest)


def _with_gaps(
    z: FloatArray, missing: NDArray[np.bool_], smooth: Smoother, max_iterations: int
) -> FloatArray:
    """Return z with heights in the gaps that the filter leaves as they are.

    ``(W + S^-1 - I) w = W z`` is ``w = S (W z + (I - W) w)``: the missing heights g solve
    ``(I - S_gg) g = (S W z)_g``, symmetric and positive definite.
    """

    def spread(gap: FloatArray) -> FloatArray:
        full = np.zeros_like(z)
        full[missing] = gap
        return full

    residual = smooth(z)[missing]
    gap = np.zeros_like(residual)
    direction = residual.copy()
    power = float(residual @ residual)
    target = power * _GAP_TOLERANCE**2
    for _ in range(max_iterations):
        if power <= target:
            break
        image = direction - smooth(spread(direction))[missing]
        length = power / float(direction @ image)
        gap += length * direction
        residual -= length * image
        former, power = power, float(residual @ residual)
        direction = residual + (power / former) * direction
    if power > target:
        raise NotConvergedError(
            "the spline over the gaps did not settle in "
            f"{arguments.counted(max_iterations, 'iteration')}: gaps of "
            f"{arguments.counted(int(missing.sum()), 'sample')} are large for this cut-off; crop "
            "them, use the Gaussian filter, or raise max_iterations"
        )
    return z + spread(gap)


def _natural_smoother(
    n: int, k: float, tension: float, weights: FloatArray | None = None
) -> Smoother:
    """Return the solver of the weighted spline with free ends along axis 0.

    Unknowns alternate: ``w_0, m_0, w_1, m_1, ...`` with ``m_i = a (w_(i-1) - 2 w_i + w_(i+1))``,
    ``a = sqrt(1 - b) k^2``, and ``W w + b k^2 P w + a D' m = W z``. Three diagonals on each side.
    """
    from scipy.linalg import lapack

    if k > _STIFFEST:
        raise DegenerateFitError(
            f"{2.0 * np.pi * k:.3g} samples per cut-off are more than the spline can solve in "
            "double precision: thin the data out first"
        )
    w = np.ones(n) if weights is None else weights
    band = np.zeros((10, 2 * n))
    diagonal = 6  # three rows of storage above it for the pivots, three for the matrix
    band[diagonal, 0::2] = w
    band[diagonal, 1::2] = -1.0
    bending = np.sqrt(1.0 - tension) * k**2
    inner = 2 * np.arange(1, n - 1) + 1
    for offset, value in ((-3, 1.0), (-1, -2.0), (1, 1.0)):
        band[diagonal - offset, inner + offset] = bending * value
        band[diagonal + offset, inner] = bending * value
    if tension > 0.0:
        pull = tension * k**2
        band[diagonal, 0::2] += pull * np.r_[1.0, np.full(n - 2, 2.0), 1.0]
        band[diagonal + 2, 0 : 2 * n - 2 : 2] -= pull
        band[diagonal - 2, 2 : 2 * n : 2] -= pull
    factors, pivots, _ = lapack.dgbtrf(band, 3, 3)

    def smooth(z: FloatArray) -> FloatArray:
        columns = z.reshape(n, -1)
        result = np.empty_like(columns)
        for start in range(0, columns.shape[1], _BLOCK):
            part = slice(start, start + _BLOCK)
            right = np.zeros((2 * n, columns[:, part].shape[1]), order="F")
            right[0::2] = w[:, np.newaxis] * columns[:, part]
            solution, _ = lapack.dgbtrs(factors, 3, 3, right, pivots, overwrite_b=1)
            result[:, part] = solution[0::2]
        return result.reshape(z.shape)

    return smooth


def _closed_smoother(n: int, k: float, tension: float) -> Smoother:
    """Return the filter of a closed line along axis 0: exact, the matrix is circulant."""
    from scipy import fft

    ratio = (2.0 * k * np.sin(np.pi * np.arange(n // 2 + 1) / n)) ** 2
    gain = 1.0 / (1.0 + tension * ratio + (1.0 - tension) * ratio**2)

    def smooth(z: FloatArray) -> FloatArray:
        shaped = gain if z.ndim == 1 else gain[:, np.newaxis]
        return np.asarray(fft.irfft(fft.rfft(z, axis=0) * shaped, n, axis=0))

    return smooth


def _linear(z: FloatArray) -> FloatArray:
    """Return the least-squares line or plane of the measured heights, everywhere."""
    axes = [np.linspace(-1.0, 1.0, n) for n in z.shape]
    grids = [np.ones(z.shape), *np.meshgrid(*axes, indexing="ij")]
    valid = ~np.isnan(z)
    offset = float(z[valid].mean())
    basis = np.stack([g[valid] for g in grids])
    gram = basis @ basis.T
    coefficients = np.linalg.lstsq(gram, basis @ (z[valid] - offset), rcond=None)[0]
    trend = np.full(z.shape, offset)
    for c, g in zip(coefficients, grids, strict=True):
        trend += c * g
    return trend


def _require_bilinear(missing: NDArray[np.bool_]) -> None:
    """Refuse pixels on which 1, x, y, xy are dependent: bending alone leaves them free."""
    rows, columns = np.nonzero(~missing)
    u = 2.0 * columns / (missing.shape[1] - 1) - 1.0
    v = 2.0 * rows / (missing.shape[0] - 1) - 1.0
    basis = np.stack([np.ones(u.size), u, v, u * v])
    if np.linalg.matrix_rank(basis @ basis.T, tol=1e-12 * u.size) < 4:
        raise DegenerateFitError(
            "the measured pixels do not determine the spline surface: they lie on one line or "
            "cross; measure pixels in at least 2 rows and 2 columns, or use the Gaussian filter"
        )
