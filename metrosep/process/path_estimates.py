"""Closed forms for planning: what interpolation makes of a sine along the path.

The error of lines or of a C2 cubic spline through equidistant points of a sine is itself known in
closed form, far from the ends. It plans a count of points before anything is simulated.
"""

from __future__ import annotations

import math
from typing import get_args

from metrosep.core.errors import DataError
from metrosep.process.arc_lengths import arc_length, checked_positive
from metrosep.process.interpolation import Interpolation

__all__ = ["estimated_points", "sine_path_error", "sine_path_step"]

_TURN = 2.0 * math.pi


def sine_path_error(
    amplitude: float, wavelength: float, step: float, *, interpolation: Interpolation
) -> float:
    """Return the peak-to-valley error of an interpolated sine far from the ends.

    Parameters
    ----------
    amplitude : float, m
        Half the height of the sine, > 0.
    wavelength : float, m
        Along the path, > 0.
    step : float, m
        Between points, > 0 and at most half a wavelength.
    interpolation : {"linear", "spline"}
        What the controller does.

    Returns
    -------
    float
        P-V, m: as much above as below, over all phases.

    Raises
    ------
    DataError
        If a number is not positive, the step above half a wavelength, or the word not known.

    Notes
    -----
    With ``w = 2 pi step / wavelength`` the error in the middle of an interval is ``A (1 - cos
    (w/2))`` for lines and ``A (1 - (23 cos(w/2) + cos(3w/2)) / (8 (2 + cos w)))`` for the cardinal
    spline; for small w ``A w^2 / 8`` and ``A w^4 / 384``. Errors of both signs occur: twice that.
    A grid of two sines of equal amplitude has the same bound in every direction of the path: the
    curvature along the tangent t is ``A k^2 (t_x^2 sin + t_y^2 cos)``, at most ``A k^2``.

    Examples
    --------
    >>> round(1e9 * sine_path_error(50e-9, 100e-6, 17.45e-6, interpolation="linear"), 2)
    14.65
    """
    A, L, h = (
        checked_positive(v, n)
        for v, n in ((amplitude, "amplitude"), (wavelength, "wavelength"), (step, "step"))
    )
    if interpolation not in get_args(Interpolation):
        raise DataError(f"interpolation must be linear or spline, got {interpolation!r}")
    if h > 0.5 * L:
        raise DataError(
            f"a step of {h:.6g} m is above half the wavelength of {L:.6g} m: the points do not "
            "show the sine; make the step smaller"
        )
    half = math.pi * h / L
    if interpolation == "linear":
        return 4.0 * A * math.sin(0.5 * half) ** 2
    # With c = cos(w/2) the spline's error is A (1 - c)^2 (2 - c) / (2 (1 + 2 c^2)).
    rest = 2.0 * math.sin(0.5 * half) ** 2
    c = 1.0 - rest
    return A * rest * rest * (2.0 - c) / (1.0 + 2.0 * c * c)


def sine_path_step(
    amplitude: float, wavelength: float, tolerance: float, *, interpolation: Interpolation
) -> float:
    """Return the step at which the error of an interpolated sine is the tolerance.

    Parameters
    ----------
    amplitude, wavelength : float, m
        As of `sine_path_error`.
    tolerance : float, m
        P-V, > 0.
    interpolation : {"linear", "spline"}
        What the controller does.

    Returns
    -------
    float
        Arc step, m, at most half a wavelength.

    Raises
    ------
    DataError
        As of `sine_path_error`.

    Examples
    --------
    >>> step = sine_path_step(50e-9, 100e-6, 1e-9, interpolation="linear")
    >>> round(step * 1e6, 2)
    4.51
    """
    tolerance = checked_positive(tolerance, "tolerance")
    high = 0.5 * checked_positive(wavelength, "wavelength")
    if sine_path_error(amplitude, wavelength, high, interpolation=interpolation) <= tolerance:
        return high
    low = 0.0
    for _ in range(60):
        middle = 0.5 * (low + high)
        error = sine_path_error(amplitude, wavelength, middle, interpolation=interpolation)
        low, high = (middle, high) if error <= tolerance else (low, middle)
    return low


def estimated_points(
    amplitude: float,
    wavelength: float,
    radius: float,
    feed: float,
    tolerance: float,
    *,
    distribution: str = "CA",
    interpolation: Interpolation = "spline",
) -> int:
    """Return the count of points that a sine or a grid of two needs, without a simulation.

    Parameters
    ----------
    amplitude, wavelength : float, m
        Of the sine.
    radius, feed : float, m
        Of the spiral.
    tolerance : float, m
        P-V, > 0.
    distribution : {"CA", "CAL"}, optional
        With CA the step at the rim counts, with CAL the one step.
    interpolation : {"linear", "spline"}, optional
        What the controller does.

    Returns
    -------
    int
        Intervals.

    Raises
    ------
    DataError
        If a number is not positive or a word not known.

    Notes
    -----
    Left out: the free end of a spline, and with CAL the turns near the centre, where points are
    too few whatever the count: their error rules the whole map. `points_for_tolerance` has both.

    Examples
    --------
    >>> estimated_points(50e-9, 100e-6, 500e-6, 2e-6, 1e-9, interpolation="linear")
    174327
    """
    step = sine_path_step(amplitude, wavelength, tolerance, interpolation=interpolation)
    whole = _TURN * checked_positive(radius, "radius") / checked_positive(feed, "feed")
    if distribution not in ("CA", "CAL"):
        raise DataError(f"distribution must be CA or CAL, got {distribution!r}")
    length = whole * radius if distribution == "CA" else float(arc_length(whole, feed))
    return math.ceil(length / step)
