"""Straightness of a profile: minimum zone, least squares, end points.

The reference is a line through the valid samples; the deviation is positive out of the material.
By default it is measured along z, as machines and straightedges do; ``normal=True`` measures it at
right angles to the line, as ISO 12780 words it. Both differ by the square of half the slope.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from metrosep.core._arrays import FloatArray
from metrosep.core.errors import DataError, TooFewSamplesError
from metrosep.core.profile import Profile
from metrosep.core.provenance import Step
from metrosep.core.quantity import Quantity
from metrosep.parameters._flags import true_or_false
from metrosep.parameters.chebyshev_line import least_squares_line, minimum_zone_line
from metrosep.parameters.form_result import FormDeviation, Reference, Support, form_table

__all__ = ["straightness_deviation"]


_FREEDOMS = 2
"""Slope and intercept."""

_UNEVEN = 1e-3
"""Spread of the steps, relative, from which least squares over samples is worth a note."""


def straightness_deviation(
    profile: Profile, *, reference: Reference = "MZ", normal: bool = False
) -> FormDeviation:
    """Return the straightness deviation STRt of a profile.

    Notes
    -----
    The minimum zone is exact: it touches two points on one side and, between them, one on the
    other. Least squares weights every sample equally. NaN is excluded and counted. No filter is
    applied. O(n).

    References
    ----------
    .. [1] ISO 12780-1:2011 (parameters), ISO 1101:2017 (default reference).
    .. [2] ISO 230-1:2012 (end-point line).

    Examples
    --------
    >>> profile = Profile([0.0, 0.1, 0.2, 0.3], [0.0, 2e-6, 1e-6, 0.0])
    >>> zone = straightness_deviation(profile)
    >>> round(zone.value * 1e6, 6), zone.support.indices.tolist(), zone.is_optimal
    (2.0, [0, 3, 1], True)
    """
    normal = true_or_false(normal, "normal")
    valid = np.flatnonzero(~np.isnan(profile.z))
    if valid.size <= _FREEDOMS:
        raise TooFewSamplesError(
            f"straightness needs 3 valid samples, got {valid.size} of {len(profile)}: two points "
            "always lie on a line; measure more points"
        )
    x, z = profile.x[valid], profile.z[valid]
    width = math.nan
    held = None
    if reference == "MZ":
        zone = minimum_zone_line(x, z, normal=normal)
        slope, height, centre, width = zone.slope, zone.height, zone.centre, zone.width
        held = (zone.indices, zone.sides, zone.weights)
    elif reference == "LS":
        slope, height, centre = least_squares_line(x, z)
        if normal:
            slope, height, centre = _total_least_squares(x, z)
    elif reference == "EP":
        slope, height, centre = float(z[-1] - z[0]) / float(x[-1] - x[0]), float(z[0]), float(x[0])
    else:
        raise DataError(f"straightness has the references MZ, LS and EP, not {reference!r}")
    tilt = 1.0 / math.sqrt(1.0 + slope * slope) if normal else 1.0
    local = tilt * (z - (height + slope * (x - centre)))
    if reference == "EP":
        local[0] = local[-1] = 0.0
    if held is None:
        ends = np.array([local.argmax(), local.argmin()])
        held = (ends, np.array([1, -1]), np.array([1.0, 1.0]))
    at, sides, weights = held
    return FormDeviation(
        kind="straightness",
        reference=reference,
        table=form_table(
            "straightness",
            reference,
            local,
            n_total=len(profile),
            history=profile.history,
            settings={"width": "normal" if normal else "vertical"},
            notes=_notes(profile, x, slope, reference, normal),
        ),
        reference_parameters=_line(slope, height - slope * centre, reference),
        residual=_residual(profile, valid, local, reference, normal),
        support=Support(valid[at], x[at], z[at], sides, weights),
        objective=float(np.ptp(local)) if reference == "MZ" else math.nan,
        bound=width,
    )


def _total_least_squares(
    x: NDArray[np.float64], z: NDArray[np.float64]
) -> tuple[float, float, float]:
    """Return slope, height and position of the middle of the line of least normal deviations."""
    centre, height = float(x.mean()), float(z.mean())
    scale = float(x[-1] - x[0])
    u, w = (x - centre) / scale, (z - height) / scale
    difference, both = float(u @ u - w @ w), 2.0 * float(u @ w)
    length = math.hypot(difference, both)
    # tan of half the angle, from the side that loses no digits
    slope = both / (difference + length) if difference > 0.0 else (length - difference) / both
    return slope, height, centre


def _line(slope: float, intercept: float, reference: str) -> dict[str, Quantity]:
    return {
        "slope": Quantity(slope, "1", f"slope dz/dx of the {reference} line"),
        "intercept": Quantity(intercept, "m", f"height of the {reference} line at x = 0"),
    }


def _residual(
    profile: Profile, valid: NDArray[np.intp], local: FloatArray, reference: str, normal: bool
) -> Profile:
    z = np.full(len(profile), np.nan)
    z[valid] = local
    step = Step(
        "straightness", {"reference": reference, "width": "normal" if normal else "vertical"}
    )
    return Profile(profile.x, z, metadata=profile.metadata, history=(*profile.history, step))


def _notes(
    profile: Profile, x: FloatArray, slope: float, reference: str, normal: bool
) -> list[str]:
    notes = []
    if reference == "EP" and (x[0] != profile.x[0] or x[-1] != profile.x[-1]):
        notes.append("the profile does not end where it was measured: first and last valid sample")
    if normal:
        notes.append("deviations at right angles to the line")
    else:
        notes.append(
            f"deviations along z; at right angles to the line they are {_relative(slope):.2g} "
            "smaller, relative"
        )
    steps = np.diff(x)
    mean = float(x[-1] - x[0]) / steps.size
    if reference != "EP" and float(np.abs(steps - mean).max()) > _UNEVEN * mean:
        which = "the line and STRq weight" if reference == "LS" else "STRq weights"
        notes.append(f"positions are not uniform: {which} every sample equally")
    return notes


def _relative(slope: float) -> float:
    """Return 1 - cos(atan(slope)) without cancellation."""
    root = math.sqrt(1.0 + slope * slope)
    return slope * slope / (root * (1.0 + root))
