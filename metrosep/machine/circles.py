"""Circular tests after ISO 230-4: what a circle in both senses says of two axes.

A ballbar (or a grid encoder) gives the radius at places on a circle. With a the angle of the place
from the first axis towards the second, R the radius, F the feed and s = +1 for that sense, -1 for the
other, the deviation of the radius is (machines.md, eq. 19)

    r = c + cx cos a + cy sin a + R/2 (s1 - s2) cos 2a - R Q sin a cos a
        - b1/2 cos a sign(v1) - b2/2 sin a sign(v2) + s F (T1 - T2) sin a cos a

c: mean deviation of the radius; Q: squareness, the turn of the second axis against the first; b: lost
motion, the axis stands short by half of it in the sense of travel; T: delay of an axis. With one
sense alone squareness and servo mismatch are one column. Names of the deviations: ISO 230-4; their
formulas are from memory of the standard.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from metrosep.core import numbers
from metrosep.core._arrays import FloatArray
from metrosep.core.errors import DataError, InvalidSamplesError, TooFewSamplesError, UnitError
from metrosep.core.provenance import freeze_mapping
from metrosep.core.quantity import Quantity
from metrosep.core.units import format_length
from metrosep.machine._drift_noise import Fit, Gls, Stream
from metrosep.machine.terms import positions_array

_PLANES = {"XY": ("C0Y", 1.0), "YZ": ("A0Z", 1.0), "ZX": ("B0Z", -1.0), "XZ": ("B0Z", -1.0)}
"""Squareness that the turn of the second axis is, and its sign (ISO 230-1: Y against X, Z against both)."""

_MASK = math.radians(1.0)
"""Around a reversal: there the reading jumps by the lost motion, and a spike stands."""

_SPIKE = math.radians(12.0)
"""Within it after a reversal the residual is searched for a spike."""

_DECAYS = np.radians(np.geomspace(0.3, 6.0, 9))
_FEWEST = 16
_LARGEST = 1e-2
"""m: a deviation of the radius above it was typed in um or mm."""


@dataclass(frozen=True, slots=True)
class Reversal:
    """Spike behind a change of sense of one axis.

    Parameters
    ----------
    axis : str
        The axis that turns back.
    angle : float, rad
        Place on the circle.
    sense : {"ccw", "cw"}
        Of the run.
    height : Quantity, m
        At the reversal; NaN where too little was measured behind it.
    decay : float, rad
        Travel round the circle in which it falls to 1/e.
    """

    axis: str
    angle: float
    sense: str
    height: Quantity
    decay: float


@dataclass(frozen=True, slots=True, eq=False, repr=False)
class CircleTest:
    """What a circular test says, each number with its standard uncertainty.

    Parameters
    ----------
    plane : str
        The two axes, first and second.
    G : mapping of str to Quantity, m
        Circular deviation ``ccw`` and ``cw``: largest minus smallest radius about the least-squares
        centre of that run.
    G_bidirectional : Quantity, m
        The same over both runs, about their common least-squares centre.
    F : mapping of str to Quantity, m
        Radial deviation ``max`` and ``min`` from the programmed radius, about the common centre.
    D : Quantity, m
        Mean bidirectional radial deviation.
    centre : tuple of (Quantity, Quantity), m
        Common least-squares centre.
    squareness : Quantity, rad
        C0Y, A0Z or B0Z of the plane; NaN with one sense alone.
    lost_motion : mapping of str to Quantity, m
        By axis.
    servo_mismatch : Quantity, s
        Delay of the first axis minus that of the second; NaN with one sense alone.
    scale_mismatch : Quantity, dimensionless
        Scale error of the first axis minus that of the second.
    squareness_and_mismatch : Quantity, m
        ``-R Q + s F (T1 - T2)`` of a single sense; NaN where both were run.
    reversals : tuple of Reversal
        Spikes behind the changes of sense.
    angle : ndarray, shape (n,), rad
        Places.
    measured, residual : mapping of str to ndarray, shape (n,), m
        By sense: readings about the common centre, and what the model leaves of them.
    noise : Quantity, m
        Standard deviation of one reading.
    messages : tuple of str
        What was omitted and what was not determined.
    audit : mapping
        Settings and noise, units in the keys.
    """

    plane: str
    G: Mapping[str, Quantity]
    G_bidirectional: Quantity
    F: Mapping[str, Quantity]
    D: Quantity
    centre: tuple[Quantity, Quantity]
    squareness: Quantity
    lost_motion: Mapping[str, Quantity]
    servo_mismatch: Quantity
    scale_mismatch: Quantity
    squareness_and_mismatch: Quantity
    reversals: tuple[Reversal, ...]
    angle: FloatArray
    measured: Mapping[str, FloatArray]
    residual: Mapping[str, FloatArray]
    noise: Quantity
    messages: tuple[str, ...] = ()
    audit: Mapping[str, Any] = field(default_factory=dict)

    @property
    def quantities(self) -> dict[str, Quantity]:
        """All numbers by their names."""
        found = {f"G_{sense}": v for sense, v in self.G.items()}
        found |= {"G_bidirectional": self.G_bidirectional}
        found |= {"F_max": self.F["max"], "F_min": self.F["min"], "D": self.D}
        found |= {"centre_1": self.centre[0], "centre_2": self.centre[1]}
        found |= {self.squareness.symbol: self.squareness, "servo_mismatch": self.servo_mismatch}
        if math.isfinite(self.squareness_and_mismatch.value):
            found["squareness_and_mismatch"] = self.squareness_and_mismatch
        found |= {f"lost_motion_{a}": v for a, v in self.lost_motion.items()}
        return found | {"scale_mismatch": self.scale_mismatch, "noise": self.noise}

    def to_dict(self) -> dict[str, Any]:
        """Return plain values, units in the keys or beside the values.

        Returns
        -------
        dict
            Keys ``plane``, ``quantities``, ``reversals``, ``messages``, ``audit``.
        """
        spikes = [
            {
                "axis": r.axis,
                "angle_deg": math.degrees(r.angle),
                "sense": r.sense,
                "height": r.height.to_dict(),
                "decay_deg": math.degrees(r.decay),
            }
            for r in self.reversals
        ]
        return {
            "plane": self.plane,
            "quantities": {n: q.to_dict() for n, q in self.quantities.items()},
            "reversals": spikes,
            "messages": list(self.messages),
            "audit": dict(self.audit),
        }

    def report(self) -> str:
        """Return the result as text, one line for each number and message.

        Returns
        -------
        str
            For people.
        """
        lines = [f"{name:24s} {q}" for name, q in self.quantities.items()]
        return "\n".join([*lines, *self.messages])

    def __repr__(self) -> str:
        return (
            f"CircleTest({self.plane}, {self.squareness.symbol} = {self.squareness}, G = {self.G})"
        )


def circle_test(
    angle: ArrayLike,
    ccw: ArrayLike | None,
    cw: ArrayLike | None = None,
    *,
    radius: float | str,
    feed: float | str,
    plane: str = "XY",
    calibrated: bool = True,
) -> CircleTest:
    """Evaluate a circular test after ISO 230-4.

    Parameters
    ----------
    angle : array_like, shape (n,), rad
        Angle of the place on the circle, from the first axis of the plane towards the second, the
        same for both senses.
    ccw, cw : array_like, shape (n,), m, or None
        Deviation of the radius at these places, run with rising and with falling angle. One may be
        None.
    radius : float or str, m
        Programmed radius.
    feed : float or str, m/s
        Feed along the circle, ``"1000 mm/min"``.
    plane : {"XY", "YZ", "ZX", "XZ"}, optional
        First and second axis.
    calibrated : bool, optional
        Whether the length of the bar is known. If not, D and F contain the error of its length.

    Returns
    -------
    CircleTest
        The deviations of the standard, and the errors of the two axes.

    Raises
    ------
    DataError
        Neither sense is given, the plane is unknown, or half of the circle or less was measured.
    InvalidSamplesError
        Angles and readings are not of one length, or an angle is not a finite number.
    TooFewSamplesError
        A run has fewer than 16 readings away from the reversals.
    UnitError
        Readings above 10 mm, or angles that run over more than 20 rad: they are in other units.

    Notes
    -----
    Readings within 1 degree of a reversal are omitted from the fit, and spikes behind the reversals
    (height, decay) are fitted to what is left and taken off before the fit is repeated. The
    uncertainty comes from white noise and drift that the readings themselves show (restricted
    likelihood, eq. 17 of [1]_). NaN is omitted. G, F and D are those of the readings, spikes
    included; their u is that of two readings (G), one (F).

    References
    ----------
    .. [1] machines.md, section 6; ISO 230-4:2022.

    Examples
    --------
    >>> a = np.radians(np.arange(0.5, 360.0))
    >>> test = circle_test(a, -3e-6 * np.sin(2 * a), -3e-6 * np.sin(2 * a), radius=0.15, feed=0.0167)
    >>> round(test.squareness.value * 1e6, 6)
    40.0
    """
    R = numbers.positive(radius, "radius", dimension="length")
    F = numbers.positive(feed, "feed", dimension="speed")
    numbers.choice(plane, "plane", _PLANES)
    a = positions_array(angle, "angle")
    if a.ndim != 1 or not np.isfinite(a).all():
        raise InvalidSamplesError("angle must be one list of finite numbers")
    if a.size and np.ptp(a) > 20.0:
        raise UnitError(f"angles run over {np.ptp(a):.4g}; they are in rad, 360 deg are 6.283")
    runs = {s: r for s, r in (("ccw", ccw), ("cw", cw)) if r is not None}
    if not runs:
        raise DataError("a circular test needs readings of one sense at least: ccw, cw or both")
    read = {sense: _readings(values, sense, a) for sense, values in runs.items()}
    order = {s: np.argsort(a if s == "ccw" else -a, kind="stable") for s in read}
    spikes: list[Reversal] = []
    off = {s: np.zeros(a.size) for s in read}
    fit, model = _fitted(a, read, off, order, R, F)
    for _ in range(2):
        spikes = _spikes(a, {s: r - model[s] for s, r in read.items()}, plane, fit)
        off = {s: _spike_heights(a, [k for k in spikes if k.sense == s], s) for s in read}
        if not any(np.any(v) for v in off.values()):
            break
        fit, model = _fitted(a, read, off, order, R, F)
    return _result(a, read, model, fit, spikes, (R, F, plane, calibrated))


_NAMES = ("c", "cx", "cy", "scale", "Q", "b1", "b2", "T")


def _readings(values: ArrayLike, sense: str, a: FloatArray) -> FloatArray:
    r = positions_array(values, f"readings {sense}")
    if r.shape != a.shape:
        raise InvalidSamplesError(
            f"readings {sense} have shape {r.shape} for {a.size} angles; give one for each angle, NaN for a gap"
        )
    if np.any(np.isinf(r)):
        raise InvalidSamplesError(f"readings {sense} hold infinite values; write NaN for a gap")
    valid = np.isfinite(r) & (_from_reversal(a) > _MASK)
    if np.count_nonzero(valid) < _FEWEST:
        raise TooFewSamplesError(
            f"run {sense} has {np.count_nonzero(valid)} readings away from the reversals; "
            f"{_FEWEST} are needed"
        )
    if np.nanmax(np.abs(r)) > _LARGEST:
        raise UnitError(
            f"readings {sense} reach {np.nanmax(np.abs(r)):.4g} m; they are deviations of the radius "
            "in m, 3 um are 3e-6"
        )
    parts = np.unique(np.floor(np.mod(a[valid], 2.0 * np.pi) / (np.pi / 4.0)))
    if parts.size < 5:
        raise DataError(
            f"run {sense} covers {parts.size} of 8 parts of the circle; more than half is needed to "
            "tell the centre from the errors"
        )
    return r


def _from_reversal(a: FloatArray) -> FloatArray:
    """Return the distance to the nearest reversal, rad; either sense has them at the quarter turns."""
    return np.abs(np.mod(a + np.pi / 4.0, np.pi / 2.0) - np.pi / 4.0)


def _columns(a: FloatArray, sense: str, R: float, F: float) -> FloatArray:
    """Return the columns of eq. 19 for a run, shape (n, 8)."""
    s = 1.0 if sense == "ccw" else -1.0
    c, n = np.cos(a), np.sin(a)
    v1, v2 = np.sign(-s * n), np.sign(s * c)
    both = n * c
    return np.column_stack(
        [
            np.ones(a.size), c, n, 0.5 * R * np.cos(2.0 * a), -R * both,
            -0.5 * c * v1, -0.5 * n * v2, s * F * both,
        ]
    )  # fmt: skip


def _fitted(
    a: FloatArray,
    read: Mapping[str, FloatArray],
    off: Mapping[str, FloatArray],
    order: Mapping[str, Any],
    R: float,
    F: float,
) -> tuple[Fit, dict[str, FloatArray]]:
    """Return the fit, and what it says of the readings, by sense."""
    design = {s: _columns(a, s, R, F) for s in read}
    if len(read) == 1:  # Q and T are one column: it stands in the place of Q, in m
        design = {s: np.delete(d, 7, axis=1) / _sizes_single(R) for s, d in design.items()}
    X, y, streams, at = [], [], [], 0
    for k, (sense, r) in enumerate(read.items()):
        good = np.isfinite(r) & (_from_reversal(a) > _MASK)
        rows = order[sense][good[order[sense]]]
        X.append(design[sense][rows])
        y.append((r - off[sense])[rows])
        index = np.flatnonzero(good[order[sense]]).astype(np.float64)
        streams.append(Stream(np.arange(at, at + rows.size), index, k))
        at += rows.size
    whole = np.concatenate(X)
    sizes = np.linalg.norm(whole, axis=0)
    fit = Gls(whole / sizes, np.concatenate(y), streams, [None] * len(read)).best()
    beta, cov = fit.beta / sizes, fit.cov / np.outer(sizes, sizes)
    found = Fit(beta, cov, fit.a, fit.tau, fit.scales, fit.judged)
    return found, {s: design[s] @ beta for s in read}


def _sizes_single(R: float) -> FloatArray:
    return np.array([1.0, 1.0, 1.0, 1.0, -R, 1.0, 1.0])


def _behind(a: FloatArray, angle: float, sense: str) -> FloatArray:
    """Return how far behind a reversal places stand in the sense of travel, 0 to 2 pi."""
    return np.mod((a - angle) * (1.0 if sense == "ccw" else -1.0), 2.0 * np.pi)


def _spikes(
    a: FloatArray, residual: Mapping[str, FloatArray], plane: str, fit: Fit
) -> list[Reversal]:
    """Return a decaying spike behind each reversal of each run."""
    found = []
    for k, (sense, r) in enumerate(residual.items()):
        u = float(fit.scales[k])
        for quarter in range(4):
            angle = 0.5 * np.pi * quarter
            axis = plane[0] if quarter % 2 == 0 else plane[1]
            behind = _behind(a, angle, sense)
            near = (behind < _SPIKE) & np.isfinite(r)
            what = f"spike of {axis} behind its reversal at {90 * quarter} deg, {sense}"
            if np.count_nonzero(near) < 4:
                found.append(Reversal(axis, angle, sense, Quantity(math.nan, "m", what), math.nan))
                continue
            shapes = np.exp(-behind[near][:, None] / _DECAYS)
            # neighbours hang together by the drift: generalised least squares of each shape
            place = np.argsort(np.argsort(behind[near])).astype(np.float64)
            V = np.eye(place.size) + fit.a**2 * np.exp(
                -np.abs(place[:, None] - place) / max(fit.tau, 1e-9)
            )
            solved = np.linalg.solve(V, np.column_stack([shapes, r[near]]))
            squares = np.sum(shapes * solved[:, :-1], axis=0)
            heights = shapes.T @ solved[:, -1] / squares
            best = int(np.argmax(heights**2 * squares))
            height = Quantity(float(heights[best]), "m", what, u / math.sqrt(squares[best]))
            found.append(Reversal(axis, angle, sense, height, float(_DECAYS[best])))
    return found


def _spike_heights(a: FloatArray, spikes: list[Reversal], sense: str) -> FloatArray:
    """Return the spikes that stand out of the noise, at the places; the others are zero."""
    total = np.zeros(a.size)
    for spike in spikes:
        h = spike.height
        # the best of nine decays at one of eight reversals: chance reaches 3.5 u once in 100 tests
        if math.isfinite(h.value) and h.u is not None and abs(h.value) > 4.0 * h.u:
            total += h.value * np.exp(-_behind(a, spike.angle, sense) / spike.decay)
    return total


def _result(
    a: FloatArray,
    read: Mapping[str, FloatArray],
    model: Mapping[str, FloatArray],
    fit: Fit,
    spikes: list[Reversal],
    how: tuple[float, float, str, bool],
) -> CircleTest:
    R, F, plane, calibrated = how
    both = len(read) == 2
    u = np.sqrt(np.diag(fit.cov))
    value = dict(zip(_NAMES if both else _NAMES[:7], zip(fit.beta, u, strict=True), strict=True))
    noise = float(np.sqrt(np.mean(fit.scales**2) * (1.0 + fit.a**2)))

    def quantity(name: str, unit: str, text: str, symbol: str = "", sign: float = 1.0) -> Quantity:
        best, spread = value[name]
        return Quantity(sign * float(best), unit, text, float(spread), symbol)

    name, sign = _PLANES[plane]
    one, two = plane[0], plane[1]
    about = f"circular test of radius {format_length(R)} in {plane}"
    square_text = f"squareness of {two} to {one}, {about}"
    servo_text = f"delay of {one} minus delay of {two}, {about}"
    sum_text = f"-R {name} + s F (T{one} - T{two}) of a single sense, {about}"
    nothing = Quantity(math.nan, "m", sum_text)
    within = f"readings within {math.degrees(_MASK):g} deg of a reversal are not in the fit"
    messages = [f"{within}; G, F and D are about the least-squares centre"]
    if both:
        square = quantity("Q", "rad", square_text, name, sign)
        servo = quantity("T", "s", servo_text)
        joint = nothing
    else:
        square = Quantity(math.nan, "rad", square_text, None, name)
        servo = Quantity(math.nan, "s", servo_text)
        joint = quantity("Q", "m", sum_text)
        messages.append(
            f"one sense alone: squareness and servo mismatch are one sum, {joint}; run the other sense "
            "to tell them apart"
        )
    if not calibrated:
        messages.append("the bar is not calibrated: D and F contain the error of its length")
    centre = np.array([value["cx"][0], value["cy"][0]])
    away = np.column_stack([np.cos(a), np.sin(a)])
    measured = {s: r - away @ centre for s, r in read.items()}
    G = {}
    columns = np.column_stack([np.ones(a.size), away])
    for sense, r in read.items():
        good = np.isfinite(r)
        # where a run has a gap its own centre would follow the gap: the model stands there
        own = np.linalg.lstsq(columns, np.where(good, r, model[sense]), rcond=None)[0]
        radii = r[good] - away[good] @ own[1:]
        text = f"circular deviation {sense} about its least-squares centre, {about}"
        G[sense] = Quantity(float(np.ptp(radii)), "m", text, math.sqrt(2.0) * noise, f"G({sense})")
    everything = np.concatenate([m[np.isfinite(m)] for m in measured.values()])
    high, low = float(everything.max()), float(everything.min())
    text = f"bidirectional circular deviation about the common least-squares centre, {about}"
    G_both = Quantity(
        high - low if both else math.nan,
        "m",
        text,
        math.sqrt(2.0) * noise if both else None,
        "G(b)",
    )
    radial = f"radial deviation from the programmed radius about the common centre, {about}"
    lack = [s for s, r in read.items() if np.isnan(r).any()]
    if lack:
        gone = sum(int(np.isnan(r).sum()) for r in read.values())
        messages.append(
            f"{gone} readings are NaN and were omitted ({', '.join(lack)}); G and F do not see what lies there"
        )
    if not fit.judged:
        messages.append("too few readings to judge drift: u is that of independent readings")
    tall = [k for k in spikes if k.height.u is not None and abs(k.height.value) > 4.0 * k.height.u]
    messages += [
        f"{k.axis} reverses at {math.degrees(k.angle):.0f} deg ({k.sense}) with a spike of {k.height}, "
        f"gone after {3.0 * math.degrees(k.decay):.2g} deg"
        for k in tall
    ]
    taken = {s: _spike_heights(a, [k for k in spikes if k.sense == s], s) for s in read}
    return CircleTest(
        plane=plane,
        G=freeze_mapping(G),
        G_bidirectional=G_both,
        F=freeze_mapping(
            {
                "max": Quantity(high, "m", f"largest {radial}", noise, "Fmax"),
                "min": Quantity(low, "m", f"smallest {radial}", noise, "Fmin"),
            }
        ),
        D=Quantity(
            float(value["c"][0]) if both else math.nan,
            "m",
            f"mean bidirectional radial deviation, {about}",
            float(value["c"][1]) if both else None,
            "D",
        ),
        centre=(
            quantity("cx", "m", f"least-squares centre along {one}, {about}"),
            quantity("cy", "m", f"least-squares centre along {two}, {about}"),
        ),
        squareness=square,
        lost_motion=freeze_mapping(
            {
                one: quantity("b1", "m", f"lost motion of {one}, {about}"),
                two: quantity("b2", "m", f"lost motion of {two}, {about}"),
            }
        ),
        servo_mismatch=servo,
        scale_mismatch=quantity("scale", "1", f"scale of {one} minus scale of {two}, {about}"),
        squareness_and_mismatch=joint,
        reversals=tuple(spikes),
        angle=a,
        measured=freeze_mapping(measured),
        residual=freeze_mapping({s: r - model[s] - taken[s] for s, r in read.items()}),
        noise=Quantity(noise, "m", f"standard deviation of one reading, {about}"),
        messages=tuple(messages),
        audit=freeze_mapping(
            {
                "radius_mm": R * 1e3,
                "feed_mm_min": F * 6e4,
                "mask_deg": math.degrees(_MASK),
                "drift_to_white": fit.a,
                "drift_readings": fit.tau,
                "n": {s: int(np.isfinite(r).sum()) for s, r in read.items()},
            }
        ),
    )
