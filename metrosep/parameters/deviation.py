"""Form deviations by one function: straightness, flatness, roundness.

The reference is always stated. ISO 1101:2017 takes the minimum zone where a drawing says nothing;
many instruments print least squares without saying so, a value that is never smaller.
"""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np

from metrosep.core._arrays import FloatArray, IntArray
from metrosep.core.errors import (
    DataError,
    DegenerateFitError,
    InvalidSamplesError,
    TooFewSamplesError,
)
from metrosep.core.numbers import between, choice, flag, positive
from metrosep.core.profile import Profile
from metrosep.core.provenance import Step
from metrosep.core.quantity import Quantity
from metrosep.core.surface import Surface
from metrosep.core.units import format_ends, format_length
from metrosep.parameters.circle import CirclePoints, CircleSolution, best_circle
from metrosep.parameters.form_result import FormDeviation, Kind, Reference, Support, form_table
from metrosep.parameters.straightness import Optimum, optimum, straightness_deviation

_OPTIONS: dict[str, tuple[str, ...]] = {
    "straightness": ("normal",),
    "flatness": (),
    "roundness": ("exact", "radius", "upr", "upr_low"),
}


def form_deviation(
    obj: Profile | Surface,
    *,
    kind: Kind,
    reference: Reference = "MZ",
    normal: bool = False,
    exact: bool = False,
    radius: float | None = None,
    upr: float | None = None,
    upr_low: float | None = None,
) -> FormDeviation:
    """Return the straightness, flatness or roundness deviation of an object.

    Parameters
    ----------
    obj : Profile or Surface
        A profile for straightness (x in m) and roundness (x is the angle in rad, z larger
        outwards), a surface for flatness.
    kind : {"straightness", "flatness", "roundness"}
        What is evaluated.
    reference : {"MZ", "LS", "EP", "MC", "MI"}, optional
        Minimum zone and least squares for all; end points for straightness; minimum circumscribed
        and maximum inscribed circle for roundness.
    normal : bool, optional
        Straightness: measure at right angles to the line instead of along z.
    exact : bool, optional
        Roundness: true circles instead of limacons.
    radius : float, m, optional
        Roundness: radius that z is counted from.
    upr, upr_low : float, optional
        Roundness: cut-offs of a Gaussian filter of the closed trace, undulations per revolution.

    Returns
    -------
    FormDeviation
        ``value`` (STRt, FLTt or RONt in m), ``table``, ``reference_parameters``, ``residual``,
        ``support`` and ``bound``, which proves the reference.

    Raises
    ------
    DataError
        If the kind is unknown, the object or an option does not belong to it, an option is of the
        wrong type, or the reference does not exist for it.
    TooFewSamplesError
        If the valid samples do not exceed the freedoms of the reference.
    DegenerateFitError
        If pixels lie on one line, or a round trace has a gap of half a turn.
    InvalidSamplesError
        If the angle of a round trace spans more than one turn.
    NotConvergedError
        If a reference is not found.

    Notes
    -----
    Positive deviations point out of the material, of round traces outwards. NaN is excluded and
    counted. No filter is applied but that of `upr` and `upr_low`: filter before, and the history says so.
    With the filter a wave of n undulations keeps 2^-((n/upr)^2) of its amplitude, and with `upr_low`
    1 - 2^-((n/upr_low)^2): half of it at each cut-off. The usual ones are 15, 50, 150, 500 and 1500.

    References
    ----------
    .. [1] ISO 12780-1:2011, ISO 12781-1:2011, ISO 12181-1:2011, ISO 1101:2017, ISO 230-1:2012.

    Examples
    --------
    >>> x = [0.0, 1.0, 2.0, 3.0, 4.0]
    >>> result = form_deviation(Profile(x, [0, 2e-6, 1e-6, 3e-6, 0]), kind="straightness")
    >>> result
    FormDeviation(STRt = 3 um, MZ, proven by its support)
    """
    normal, exact = flag(normal, "normal"), flag(exact, "exact")
    options = {"normal": normal, "exact": exact, "radius": radius is not None}
    options |= {"upr": upr is not None, "upr_low": upr_low is not None}
    choice(kind, "the form", _OPTIONS)
    foreign = [name for name, given in options.items() if given and name not in _OPTIONS[kind]]
    if foreign:
        raise DataError(f"{kind} has no option {', '.join(foreign)}: leave it out")
    if kind == "flatness":
        if not isinstance(obj, Surface):
            raise DataError(f"flatness needs a Surface, got {type(obj).__name__}")
        return flatness_deviation(obj, reference=reference)
    if not isinstance(obj, Profile):
        raise DataError(f"{kind} needs a Profile, got {type(obj).__name__}: take a section first")
    if kind == "straightness":
        return straightness_deviation(obj, reference=reference, normal=normal)
    return roundness_deviation(
        obj, reference=reference, exact=exact, radius=radius, upr=upr, upr_low=upr_low
    )


# ---- flatness of a surface: minimum zone and least squares -------------------------------------
# The reference is a plane through the valid pixels; the deviation is measured along z and positive
# out of the material. Measured at right angles to the plane it is smaller by half the square of the
# slope, relative: level a strongly tilted part before. The minimum zone of a map of 1e6 pixels rests
# on four of them.

_FREEDOMS = 3
"""Height and two slopes."""

_BLOCK = 1 << 17
"""Pixels in a block of rows: 1 MB stays in the cache."""

_COLLINEAR = 1e-12
"""Smallest determinant of the position matrix, relative, of pixels that span a plane."""


def flatness_deviation(surface: Surface, *, reference: Reference = "MZ") -> FormDeviation:
    """Return the flatness deviation FLTt of a surface.

    The minimum zone is exact. It touches four points, 3 on one side and 1 on the other or 2 and 2,
    or fewer in special positions. Seen along z, the triangle holds the single point, or the two
    segments cross: with the weights of the support both sides have the same centre of gravity, and
    their mean heights differ by the width. No plane can bring the two closer together, so the
    support proves the zone. NaN is excluded and counted. No filter is applied. O(n).

    Source: ISO 12781-1:2011 (parameters), ISO 1101:2017 (default reference).

    Examples
    --------
    >>> saddle = Surface([[1e-6, 0.0], [0.0, 1e-6]], dx=1e-3, dy=1e-3)
    >>> zone = flatness_deviation(saddle)
    >>> round(zone.value * 1e6, 6), zone.support.sides.tolist(), zone.is_optimal
    (1.0, [1, 1, -1, -1], True)
    """
    choice(reference, "the reference of flatness", ("MZ", "LS"))
    grid = _Grid(surface)
    plane = grid.least_squares()
    bound = objective = math.nan
    local = grid.residual(plane)
    held: tuple[IntArray, IntArray, FloatArray]
    scale = float(np.fmax.reduce(np.abs(local), axis=None))
    if reference == "MZ" and scale > 0.0:
        found = _zone(grid, plane, scale)
        plane, bound = found.coefficients, found.bound
        local = grid.residual(plane)
        top, bottom = (float(f.reduce(local, axis=None)) for f in (np.fmax, np.fmin))
        plane[0] += 0.5 * (top + bottom)
        local -= 0.5 * (top + bottom)
        objective = top - bottom
        held = (found.indices, found.sides, found.weights)
    else:
        ends = np.array([np.nanargmax(local), np.nanargmin(local)], dtype=np.intp)
        held = (ends, np.array([1, -1], dtype=np.intp), np.array([1.0, 1.0]))
        if reference == "MZ":
            bound = objective = 0.0
    parameters = grid.parameters(plane, reference)
    step = Step("flatness", {"reference": reference, "width": "vertical"})
    return FormDeviation(
        kind="flatness",
        reference=reference,
        table=form_table(
            "flatness",
            reference,
            local[~np.isnan(local)],
            n_total=int(local.size),
            history=surface.history,
            settings={"width": "vertical"},
            notes=grid.notes(parameters),
        ),
        reference_parameters=parameters,
        residual=Surface(
            local,
            surface.dx,
            surface.dy,
            origin=surface.origin,
            metadata=surface.metadata,
            history=(*surface.history, step),
        ),
        support=grid.support(held),
        objective=objective,
        bound=bound,
    )


class _Grid:
    """The valid pixels in coordinates -1 ... 1, row by row."""

    def __init__(self, surface: Surface) -> None:
        self.surface = surface
        self.z = surface.z
        rows, columns = surface.shape
        self.valid = ~np.isnan(self.z)
        self.n_valid = int(self.valid.sum())
        if self.n_valid <= _FREEDOMS:
            raise TooFewSamplesError(
                f"flatness needs 4 valid pixels, got {self.n_valid} of {self.z.size}: three "
                "points always lie on a plane; measure more points"
            )
        self.half = (max(0.5 * (columns - 1), 0.5), max(0.5 * (rows - 1), 0.5))
        self.t = np.arange(columns) / self.half[0] - (1.0 if columns > 1 else 0.0)
        self.s = np.arange(rows) / self.half[1] - (1.0 if rows > 1 else 0.0)
        self.has_gaps = self.n_valid < self.z.size
        self.rows_in_block = max(1, _BLOCK // max(columns, 1))

    def least_squares(self) -> FloatArray:
        """Return height and slopes of the least-squares plane by moments of whole rows."""
        weight = self.valid.astype(np.float64) if self.has_gaps else np.ones(self.z.shape)
        z = np.where(self.valid, self.z, 0.0) if self.has_gaps else self.z
        in_row, in_column = weight.sum(axis=1), weight.sum(axis=0)
        t, s, n = self.t, self.s, float(self.n_valid)
        middle = (float(in_column @ t) / n, float(in_row @ s) / n)
        dt, ds = t - middle[0], s - middle[1]
        tt, ss = float(in_column @ dt**2), float(in_row @ ds**2)
        ts = float(ds @ (weight @ dt))
        determinant = tt * ss - ts * ts
        if determinant <= _COLLINEAR * n * n:
            raise DegenerateFitError(
                f"all {self.n_valid} valid pixels lie on one line: they do not define a plane; "
                "measure an area, or take a profile and its straightness"
            )
        mean = float(z.sum()) / n
        z0 = weight * (z - mean) if self.has_gaps else z - mean
        zt, zs = float(z0.sum(axis=0) @ dt), float(z0.sum(axis=1) @ ds)
        b = (ss * zt - ts * zs) / determinant
        c = (tt * zs - ts * zt) / determinant
        return np.array([mean - b * middle[0] - c * middle[1], b, c])

    def residual(self, plane: FloatArray) -> FloatArray:
        """Return z minus the plane, NaN where not measured."""
        return self._part(plane, slice(None))

    def _part(self, plane: FloatArray, rows: slice) -> FloatArray:
        left: FloatArray = self.z[rows] - (plane[0] + plane[2] * self.s[rows])[:, None]
        left -= plane[1] * self.t
        return left

    def extremes(self, plane: FloatArray) -> IntArray:
        """Return flat indices of the highest and lowest pixels, of each block of rows."""
        rows, columns = self.z.shape
        found: list[int] = []
        for start in range(0, rows, self.rows_in_block):
            part = slice(start, min(start + self.rows_in_block, rows))
            left = self._part(plane, part)
            if self.has_gaps:
                if not self.valid[part].any():
                    continue
                ends = (int(np.nanargmax(left)), int(np.nanargmin(left)))
            else:
                ends = (int(left.argmax()), int(left.argmin()))
            found += [start * columns + k for k in ends]
        return np.array(found, dtype=np.intp)

    def basis(self, indices: IntArray) -> tuple[FloatArray, FloatArray]:
        """Return the rows (1, t, s) and the heights of some pixels."""
        j, i = np.unravel_index(indices, self.z.shape)
        return np.column_stack([np.ones(indices.size), self.t[i], self.s[j]]), self.z[j, i]

    def parameters(self, plane: FloatArray, reference: str) -> dict[str, Quantity]:
        """Return slopes and intercept at x = y = 0, or at pixel 0 where not calibrated."""
        values, slopes = float(plane[0]), {}
        axes = zip(
            "xy", (self.surface.dx, self.surface.dy), self.surface.origin, self.half, strict=True
        )
        for k, (axis, step, origin, half) in enumerate(axes, start=1):
            per_pixel = float(plane[k]) / half
            first = -1.0 if self.z.shape[2 - k] > 1 else 0.0
            values += float(plane[k]) * first
            if step is None:
                text = f"slope of the {reference} plane along {axis} per pixel, not calibrated"
                slopes[f"slope_{axis}"] = Quantity(per_pixel, "m", text)
                continue
            text = f"slope dz/d{axis} of the {reference} plane"
            slopes[f"slope_{axis}"] = Quantity(per_pixel / step, "1", text)
            values -= per_pixel / step * origin
        text = f"height of the {reference} plane at x = y = 0 (pixel 0 where not calibrated)"
        return {**slopes, "intercept": Quantity(values, "m", text)}

    def notes(self, parameters: dict[str, Quantity]) -> list[str]:
        """Return what the direction of the deviations means."""
        slopes = [q for k, q in parameters.items() if k.startswith("slope")]
        if any(q.unit != "1" for q in slopes):
            return ["lateral steps are not calibrated: deviations along z, slopes per pixel"]
        square = sum(q.value**2 for q in slopes)
        root = math.sqrt(1.0 + square)
        relative = square / (root * (1.0 + root))
        where = "deviations along z; at right angles to the plane they are"
        return [f"{where} {relative:.2g} smaller, relative"]

    def support(self, held: tuple[IntArray, IntArray, FloatArray]) -> Support:
        """Return the support with rows, columns and positions."""
        at, sides, weights = held
        j, i = np.unravel_index(at, self.z.shape)
        step_x, step_y = self.surface.dx, self.surface.dy
        x = i.astype(np.float64) if step_x is None else self.surface.origin[0] + step_x * i
        y = j.astype(np.float64) if step_y is None else self.surface.origin[1] + step_y * j
        return Support(
            np.column_stack([j, i]), np.column_stack([x, y]), self.z[j, i], sides, weights
        )


def _zone(grid: _Grid, plane: FloatArray, scale: float) -> Optimum:
    """Return the minimum zone, started from the extremes of the least-squares residual."""
    flat = np.flatnonzero(grid.valid.ravel()) if grid.has_gaps else np.arange(grid.z.size)
    spread = np.unique(np.linspace(0, flat.size - 1, min(flat.size, 20)).astype(np.intp))
    seed = np.concatenate([grid.extremes(plane), flat[spread]])
    return optimum(grid.basis, grid.extremes, seed, mode="zone", start=plane, scale=scale)


# ---- roundness of a trace: least squares, minimum zone, circumscribed and inscribed circle -----
# The trace is a profile of z (radius, or radial deviation from any nominal) over the angle x in rad;
# larger z is farther out, so a peak of a shaft is positive. By default a circle is a limacon,
# ``R + a cos x + b sin x``: what roundness testers compute, exact for small eccentricity, and needing
# no radius. ``exact=True`` takes true circles and needs the radius.

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
    upr: float | None = None,
    upr_low: float | None = None,
) -> FormDeviation:
    """Return the roundness deviation RONt of a trace.

    Supports: MZ two points outside and two inside, alternating in angle; MC and MI three points
    not within half a turn, or two opposite ones. Limacons are solved exactly and proven. For exact
    circles the proof is global for MC, and local (against small moves of the centre) for MZ and
    MI, whose problems are not convex. A limacon of eccentricity e differs from its circle by
    e^2/(2 R) peak to valley. Where two opposite points hold the circumscribed or inscribed limacon,
    its centre is free across them; it is put where true circles of a centred part have it: at the
    smallest (MC) or largest (MI) offset from the least-squares centre. A last sample one turn after the first is the same place: each of the
    two has half the weight in least squares. NaN is excluded and counted. `upr`, `upr_low`: cut-offs of a
    Gaussian filter of what the least-squares circle leaves, so that the centre stays.

    Source: ISO 12181-1:2011 (parameters), ISO 12181-2:2011 (filter, recalled), ISO 1101:2017 (reference).

    Examples
    --------
    >>> import numpy as np
    >>> angle = np.arange(12) * np.pi / 6
    >>> oval = Profile(angle, 1e-6 * np.cos(2 * angle) + 5e-6 * np.cos(angle))
    >>> result = roundness_deviation(oval)
    >>> round(result.value * 1e6, 6), round(result.reference_parameters["a"].value * 1e6, 6)
    (2.0, 5.0)
    """
    choice(reference, "the reference of roundness", ("MZ", "LS", "MC", "MI"))
    exact = flag(exact, "exact")
    valid = np.flatnonzero(~np.isnan(profile.z))
    x, z = profile.x[valid], profile.z[valid]
    gap, closed = _check_angles(x, len(profile))
    base, datum = _datum(z, radius, exact)
    weight = np.ones(valid.size)
    if closed:
        weight[[0, -1]] = 0.5
    filtered = ""
    if upr is not None or upr_low is not None:
        points = CirclePoints(x, z - base, weight, datum)
        local = best_circle(points, "LS", exact=exact).local
        kept, filtered = _filtered(x, local, closed, upr, upr_low)
        z = z - local + kept
    circle = best_circle(CirclePoints(x, z - base, weight, datum), reference, exact=exact)
    a, b = circle.centre
    if a * a + b * b <= _ROUNDING**2 * x.size * (z @ z):
        circle = replace(circle, centre=(0.0, 0.0))  # what the readings do not hold
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
            settings={
                "model": model,
                **({} if radius is None else {"radius_m": radius}),
                **({"filter": filtered} if filtered else {}),
            },
            notes=[
                *([filtered] if filtered else []),
                *_notes(x, gap, closed, circle, exact, datum),
            ],
        ),
        reference_parameters=_parameters(circle, offset, reference, radius is None),
        residual=_residual(profile, valid, circle.local, reference, model),
        support=_support(valid, x, z, circle),
        objective=circle.found.objective if circle.found else math.nan,
        bound=circle.found.bound if circle.found else math.nan,
    )


def _filtered(
    x: FloatArray, local: FloatArray, closed: bool, upr: float | None, upr_low: float | None
) -> tuple[FloatArray, str]:
    """Return the band of a closed trace between two cut-offs, and which filter that was."""
    from metrosep.filters.gaussian import gaussian

    n = x.size - closed
    steps = np.diff(np.append(x[:n], x[0] + _TURN))
    if np.abs(steps - _TURN / n).max() > _UNEQUAL * _TURN / n:
        raise InvalidSamplesError(
            f"a filter in undulations per revolution needs readings at equal angles over a whole turn; the steps "
            f"are {math.degrees(steps.min()):.6g} to {math.degrees(steps.max()):.6g} deg: fill what was not "
            "measured, or leave upr and upr_low out"
        )
    for value, name in ((upr, "upr"), (upr_low, "upr_low")):
        if value is not None:
            between(
                value,
                name,
                1.0,
                (n - 1) / 2.0,
                why=f"{n} readings hold waves up to {(n - 1) // 2}",
            )
    if upr is not None and upr_low is not None and not upr_low < upr:
        raise DataError(f"upr_low = {upr_low:g} must be smaller than upr = {upr:g}")
    one = local[:n].copy()
    if closed:  # one place that was read twice, as in least squares
        one[0] = 0.5 * (local[0] + local[-1])
    trace = Profile(_TURN / n * np.arange(n), one)

    def slow(cutoff: float) -> FloatArray:
        return np.asarray(gaussian(trace, upr=cutoff, end="closed").z)

    kept = trace.z if upr is None else slow(upr)
    if upr_low is not None:
        kept = kept - slow(upr_low)
    ends = f"{'1' if upr_low is None else f'{upr_low:g}'} to {f'{(n - 1) // 2}' if upr is None else f'{upr:g}'}"
    return np.append(
        kept, kept[:1]
    ) if closed else kept, f"Gaussian filter, {ends} UPR (ISO 12181-2)"


_UNEQUAL = 1e-3
"""Part of a step by which angles may be rounded before a filter."""


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


_ROUNDING = float(np.finfo(np.float64).eps)
"""Of a number: a centre is not seen below that of n readings, n times this times their RMS."""


def _datum(z: FloatArray, radius: float | None, exact: bool) -> tuple[float, float | None]:
    """Return what to subtract from z, and the radius of that datum where it is known."""
    mean = float(z.mean())
    if radius is not None:
        radius = positive(radius, "radius", dimension="length")
        if abs(mean) > 0.5 * radius or radius + float(z.min()) <= 0.0:
            raise DataError(
                f"z is {format_length(mean)} on average, not a small deviation from the radius "
                f"{format_length(radius)}: leave radius= out if z is the radius itself"
            )
        return mean, radius + mean
    if not exact:
        return mean, None
    if float(z.min()) <= 0.0 or float(np.ptp(z)) > 0.5 * mean:
        raise DataError(
            f"z from {format_ends(float(z.min()), float(z.max()), between=' to ')} is not the "
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
