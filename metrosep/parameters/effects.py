"""Effects that a Monte Carlo draws once per measurement: scale, drift, nonlinearity, or your own.

Noise differs from point to point; an effect is one unknown number that acts on all points.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from metrosep.core._arrays import FloatArray
from metrosep.core.errors import DataError
from metrosep.parameters.budget import Contribution, Distribution

__all__ = ["Effect", "drift_effect", "nonlinearity_effect", "scale_effect"]


@dataclass(frozen=True, slots=True, eq=False)
class Effect:
    """An unknown number of zero mean and what it does to the heights.

    Parameters
    ----------
    line : Contribution
        Name, size and distribution of the number; its sensitivity is not used.
    change : callable
        From the heights, shape (n_y, n_x) or (n,), NaN kept, to the change per unit of the
        number, same shape. The change is linear in the number.

    Examples
    --------
    >>> tilt = Effect(Contribution("tilt", 1e-9), lambda z: np.linspace(-0.5, 0.5, z.size))
    """

    line: Contribution
    change: Callable[[FloatArray], FloatArray]

    def draw(self, rng: np.random.Generator, size: int) -> FloatArray:
        """Return draws of the number.

        Parameters
        ----------
        rng : numpy.random.Generator
            Used draw by draw.
        size : int
            How many.

        Returns
        -------
        ndarray, shape (size,)
            From the distribution of the line, by inversion.
        """
        from scipy.special import ndtri, stdtrit

        line = self.line
        chance = np.maximum(rng.random(size), np.finfo(float).tiny)
        if line.distribution == "normal":
            unit = ndtri(chance) if math.isinf(line.dof) else stdtrit(line.dof, chance)
            return np.asarray(unit * line.u_input)
        width = line.u_input * _HALF_WIDTH[line.distribution]
        if line.distribution == "rectangular":
            return np.asarray(width * (2.0 * chance - 1.0))
        if line.distribution == "arcsine":
            return np.asarray(-width * np.cos(np.pi * chance))
        low = chance < 0.5
        root = np.sqrt(2.0 * np.where(low, chance, 1.0 - chance))
        return np.asarray(width * np.where(low, root - 1.0, 1.0 - root))


_HALF_WIDTH: dict[Distribution, float] = {
    "rectangular": math.sqrt(3.0),
    "arcsine": math.sqrt(2.0),
    "triangular": math.sqrt(6.0),
}


def scale_effect(u_relative: float, *, distribution: Distribution = "normal") -> Effect:
    """Return a common error of the z scale.

    Parameters
    ----------
    u_relative : float
        Standard uncertainty (normal) or half-width of the scale factor, 100 ppm = 1e-4.
    distribution : {"normal", "rectangular", "triangular", "arcsine"}, optional
        Of the factor.

    Returns
    -------
    Effect
        z grows by k z.

    Raises
    ------
    DataError
        If the number is negative or not finite, or the distribution is not known.

    Notes
    -----
    P-V, Ra, Rq are homogeneous of degree 1: this adds u_relative times their value.
    """
    return Effect(Contribution("z scale", u_relative, distribution), lambda z: z)


def drift_effect(
    value: float, *, distribution: Distribution = "rectangular", axis: int = 0
) -> Effect:
    """Return a thermal drift that grows linearly along the scan.

    Parameters
    ----------
    value : float, m
        Half-width (or standard uncertainty, if normal) of the drift from first to last row or
        sample.
    distribution : {"normal", "rectangular", "triangular", "arcsine"}, optional
        Of the drift.
    axis : int, optional
        Axis of the array along which time runs.

    Returns
    -------
    Effect
        A ramp of zero mean. It vanishes where a line or plane is removed in the evaluation.

    Raises
    ------
    DataError
        If the number is negative or not finite, or the distribution is not known.
    """

    def ramp(z: FloatArray) -> FloatArray:
        if not -z.ndim <= axis < z.ndim:
            raise DataError(f"drift along axis {axis} of heights with {z.ndim} axes")
        n = z.shape[axis]
        shape = [1] * z.ndim
        shape[axis] = n
        line = np.linspace(-0.5, 0.5, n).reshape(shape)
        return np.asarray(np.broadcast_to(line, z.shape))

    return Effect(Contribution("drift", value, distribution), ramp)


def nonlinearity_effect(value: float, *, distribution: Distribution = "rectangular") -> Effect:
    """Return the quadratic error of a sensor over the range of the heights.

    Parameters
    ----------
    value : float, m
        Half-width (or standard uncertainty, if normal) of the error at the ends of the range
        relative to its middle, such as the gap^2 term of a capacitance probe.
    distribution : {"normal", "rectangular", "triangular", "arcsine"}, optional
        Of the error.

    Returns
    -------
    Effect
        z grows by q t^2, where t runs from -1 to 1 over the valid heights.

    Raises
    ------
    DataError
        If the number is negative or not finite, or the distribution is not known.
    """

    def square(z: FloatArray) -> FloatArray:
        low, high = float(np.nanmin(z)), float(np.nanmax(z))
        half = 0.5 * (high - low)
        if half == 0.0:
            return np.zeros(z.shape)
        t = (z - 0.5 * (high + low)) / half
        return np.asarray(t * t)

    return Effect(Contribution("sensor nonlinearity", value, distribution), square)
