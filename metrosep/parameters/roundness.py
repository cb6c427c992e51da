"""Roundness of a trace: least squares, minimum zone, circumscribed and inscribed circle.

The trace is a profile of z (radius, or radial deviation from any nominal) over the angle x in rad;
larger z is farther out, so a peak of a shaft is positive. By default a circle is a limacon,
``R + a cos x + b sin x``: what roundness testers compute, exact for small eccentricity, and needing
no radius. ``exact=True`` takes true circles and needs the radius.
"""

from __future__ import annotations

import math

import numpy as np

from metrosep.core._arrays import FloatArray, IntArray
from metrosep.core.errors import (
    DataError,
    DegenerateFitError,
    InvalidSamplesError,
    TooFewSamplesError,
)
from metrosep.core.profile import Profile
from metrosep.core.provenance import Step
from metrosep.core.quantity import Quantity
from metrosep.core.units import format_length
from metrosep.parameters._flags import true_or_false
from metrosep.parameters.circle import CirclePoints, CircleSolution, best_circle
from metrosep.parameters.form_result import FormDeviation, Reference, Support, form_table

__all__ = ["roundness_deviation"]


_FREEDOMS = 3
"""Centre and radius."""

_TURN = 2.0 * math.pi

_OVER = 1e-3
"""Part of a step by which a trace may pass a full turn, and by which its end is its start."""

_PARTIAL = math.pi / 6.0
"""Gap from which a trace is called partial, where its other steps are smaller."""


def roundness_deviation(
    profile: Profile,
    *,
    reference: Reference = "MZ",
    exact: bool = False,
    radius: float | None = None,
) -> FormDeviation:
    """Return the roundness deviation RONt of a trace.

    Notes
    -----
    Supports: MZ two points outside and two inside, alternating in angle; MC and MI three points
    not within half a turn, or two opposite ones. Limacons are solved exactly and proven. For exact
    circles the proof is global for MC, and local (against small moves of the centre) for MZ and
    MI, whose problems are not convex. A limacon of eccentricity e differs from its circle by
    e^2/(2 R) peak to valley. Where two opposite points hold the circumscribed or inscribed limacon,
    its centre is free across them; it is put where true circles of a centred part have it: at the
    smallest (MC) or largest (MI) offset from the least-squares centre. A last sample one turn after the first is the same place: each of the
    two has half the weight in least squares. NaN is excluded and counted. No filter is applied.

    References
    ----------
    .. [1] ISO 12181-1:2011 (parameters), ISO 1101:2017 (default reference).

    Examples
    --------
    >>> import numpy as np
    >>> angle = np.arange(12) * np.pi / 6
    >>> oval = Profile(angle, 1e-6 * np.cos(2 * angle) + 5e-6 * np.cos(angle))
    >>> result = roundness_deviation(oval)
    >>> round(result.value * 1e6, 6), round(result.reference_parameters["a"].value * 1e6, 6)
    (2.0, 5.0)
    """
    if reference not in ("MZ", "LS", "MC", "MI"):
        raise DataError(f"roundness has the references MZ, LS, MC and MI, not {reference!r}")
    exact = true_or_false(exact, "exact")
    valid = np.flatnonzero(~np.isnan(profile.z))
    x, z = profile.x[valid], profile.z[valid]
    gap, closed = _check_angles(x, len(profile))
    base, datum = _datum(z, radius, exact)
    weight = np.ones(valid.size)
    if closed:
        weight[[0, -1]] = 0.5
    circle = best_circle(CirclePoints(x, z - base, weight, datum), reference, exact=exact)
    offset = base + (radius or 0.0)
    model = "exact circle" if exact else "limacon"
    return FormDeviation(
        kind="roundness",
        reference=reference,
        table=form_table(
            "roundness",
            reference,
            circle.local,
            weights=weight,
            n_total=len(profile),
            history=profile.history,
            settings={"model": model, **({} if radius is None else {"radius_m": radius})},
            notes=_notes(x, gap, closed, circle, exact, datum),
        ),
        reference_parameters=_parameters(circle, offset, reference, radius is None),
        residual=_residual(profile, valid, circle.local, reference, model),
        support=_support(valid, x, z, circle),
        objective=circle.found.objective if circle.found else math.nan,
        bound=circle.found.bound if circle.found else math.nan,
    )


def _check_angles(x: FloatArray, n_total: int) -> tuple[float, bool]:
    """Return the largest gap between neighbours and whether the last sample repeats the first."""
    if x.size <= _FREEDOMS:
        raise TooFewSamplesError(
            f"roundness needs 4 valid samples, got {x.size} of {n_total}: three points always "
            "lie on a circle; measure more points"
        )
    span = float(x[-1] - x[0])
    steps = np.diff(x)
    slack = _OVER * float(np.median(steps))
    if span > _TURN + slack:
        raise InvalidSamplesError(
            f"the angle x spans {span:.6g} rad, {span / _TURN:.4g} turns; roundness is evaluated "
            "over one turn in rad: convert degrees, or crop or average the turns"
        )
    gap = max(float(steps.max()), _TURN - span)
    if gap >= math.pi * (1.0 - 1e-9):
        raise DegenerateFitError(
            f"the valid samples leave a gap of {math.degrees(gap):.4g} degrees: half a turn or "
            "less does not hold a circle; measure more of the turn (x must be the angle in rad, "
            "not a length of arc)"
        )
    return gap, span >= _TURN - slack


def _datum(z: FloatArray, radius: float | None, exact: bool) -> tuple[float, float | None]:
    """Return what to subtract from z, and the radius of that datum where it is known."""
    mean = float(z.mean())
    if radius is not None:
        if not (math.isfinite(radius) and radius > 0.0):
            raise DataError(f"radius must be finite and positive, got {radius} m")
        if abs(mean) > 0.5 * radius or radius + float(z.min()) <= 0.0:
            raise DataError(
                f"z is {format_length(mean)} on average, not a small deviation from the radius "
                f"{format_length(radius)}: leave radius out if z is the radius itself"
            )
        return mean, radius + mean
    if not exact:
        return mean, None
    if float(z.min()) <= 0.0 or float(np.ptp(z)) > 0.5 * mean:
        raise DataError(
            f"z from {format_length(float(z.min()))} to {format_length(float(z.max()))} is not the "
            "radius of a round part: an exact circle needs radius="
        )
    return mean, mean


def _parameters(
    circle: CircleSolution, offset: float, reference: str, from_z: bool
) -> dict[str, Quantity]:
    name = {"LS": "LSCI", "MZ": "MZCI", "MC": "MCCI", "MI": "MICI"}[reference]
    counted = ", counted like z" if from_z else ""
    return {
        "a": Quantity(circle.centre[0], "m", f"centre of the {name} along angle 0"),
        "b": Quantity(circle.centre[1], "m", f"centre of the {name} along angle pi/2"),
        "radius": Quantity(
            offset + circle.deviation,
            "m",
            f"{'mean radius of the two circles' if reference == 'MZ' else 'radius'} of the "
            f"{name}{counted}",
        ),
    }


def _support(valid: IntArray, x: FloatArray, z: FloatArray, circle: CircleSolution) -> Support:
    found = circle.found
    if found is not None:
        at, sides, weights = found.indices, found.sides, found.weights
    else:
        at = np.array([circle.local.argmax(), circle.local.argmin()], dtype=np.intp)
        sides, weights = np.array([1, -1], dtype=np.intp), np.array([1.0, 1.0])
    return Support(valid[at], x[at], z[at], sides, weights)


def _residual(
    profile: Profile, valid: IntArray, local: FloatArray, reference: str, model: str
) -> Profile:
    z = np.full(len(profile), np.nan)
    z[valid] = local
    step = Step("roundness", {"reference": reference, "model": model})
    return Profile(profile.x, z, metadata=profile.metadata, history=(*profile.history, step))


def _notes(
    x: FloatArray,
    gap: float,
    closed: bool,
    circle: CircleSolution,
    exact: bool,
    datum: float | None,
) -> list[str]:
    notes = []
    e = math.hypot(*circle.centre)
    if exact:
        notes.append("exact circles in the plane")
    elif datum is None:
        notes.append(
            f"limacon of eccentricity {format_length(e)}: right while e^2/(2 R) is negligible"
        )
    else:
        second = format_length(e * e / (2.0 * datum))
        notes.append(f"limacon: e^2/(2 R) = {second} peak to valley from an exact circle")
    found = circle.found
    if found is not None and found.indices.size == 2 and abs(int(found.sides.sum())) == 2:
        which = "smallest" if found.sides[0] > 0 else "largest"
        notes.append(
            "the circle rests on two opposite points: across them its centre was taken at the "
            f"{which} offset possible"
        )
    steps = np.diff(x)
    if gap > _PARTIAL and gap > 1.5 * float(np.median(steps)):
        notes.append(
            f"partial trace: {math.degrees(_TURN - gap):.4g} degrees measured, nothing is known "
            "of the rest"
        )
    if closed:
        notes.append("the last sample is one turn after the first: half the weight each in LS")
    return notes
