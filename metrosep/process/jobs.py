"""`TurningJob`: a freeform to be turned, from the number of blocks to the corrected program.

Everything is evaluated at the same points of the spiral, so that the maps of the causes add. Errors
are actual minus nominal along z, out of the material. After slow-tool-servo, sections 2 to 4.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any, get_args

import numpy as np

from metrosep.core import numbers
from metrosep.core._arrays import FloatArray
from metrosep.core.docs import described_by
from metrosep.core.errors import DataError, LimitError, MetrosepError
from metrosep.core.provenance import freeze_mapping
from metrosep.core.units import format_length
from metrosep.forms.base import Form
from metrosep.process._log_places import held_on_points, on_spiral
from metrosep.process._motion import FollowUp, FollowUpMap
from metrosep.process._plain import frozen, length
from metrosep.process._setting_equations import FACTORS, height_errors, polar_slopes
from metrosep.process.cutting.edge_errors import Servo
from metrosep.process.cutting.programs import TurningProgram
from metrosep.process.cutting.servos import contact_path
from metrosep.process.feedforward import corrected_path, left_over
from metrosep.process.interpolation import Interpolation, knot_slopes
from metrosep.process.machining_times import MachiningTime, machining_time
from metrosep.process.nose import RoundNose
from metrosep.process.nose_checks import gouge_check
from metrosep.process.path_points import (
    Distribution,
    PathPoints,
    PointPlan,
    Sense,
    SpiralPath,
    checked_core,
    checked_options,
    checked_radius,
    points_for_tolerance,
)
from metrosep.process.predictions import Contribution, ErrorBudget, Prediction
from metrosep.process.tips import Edge, TipSurface, tip_heights, tips
from metrosep.process.tool_settings import ToolSetting

__all__ = ["JobPlan", "TurningJob"]

_LEAD_IN = 3
_MOST_PLANS = 5
"""Searches with a tighter tolerance until the tip path, which is more curved, holds it too."""
_USUAL_NOSE = 0.5e-3
"""m: the nose for which a message says what a program of cut points does."""
_OF_THE_JOB = {
    name: f"{name} is that of the job: leave it out, or make another TurningJob"
    for name in ("radius", "feed", "core", "sense")
}


@dataclass(frozen=True, slots=True, eq=False)
class JobPlan:
    """A block program that holds a tolerance, and how long it runs.

    Parameters
    ----------
    points : PointPlan
        Search for the number of blocks.
    time : MachiningTime
        Of one pass.
    """

    points: PointPlan
    time: MachiningTime

    @property
    def path(self) -> SpiralPath:
        """Points and interpolation."""
        return self.points.path

    @property
    def n_points(self) -> int:
        """Blocks on the part."""
        return self.points.n_points

    @property
    def minutes(self) -> float:
        """Time of one pass in minutes."""
        return self.time.seconds / 60.0


@dataclass(frozen=True, slots=True)
class TurningJob:
    """A freeform that is turned by a slow tool servo along a spiral.

    Parameters
    ----------
    form : Form
        The surface wanted, the spindle axis at its origin.
    radius : float, m
        Of the workpiece.
    feed : float, m
        Advance per revolution.
    rpm : float, 1/min
        Spindle speed.
    block_time : float, s, optional
        Shortest time of a block in the controller.
    core : float, m, optional
        Radius at which the path ends.
    sense : {"counterclockwise", "clockwise"}, optional
        How the tool goes round the part, seen from above; counterclockwise where it makes no
        difference, to be given for a nose with rake.
    nose : RoundNose, optional
        Of the tool. With it programs are tip paths; without it they are cut points, points of the
        surface, and say so.

    Raises
    ------
    DataError
        If the form is none, a number is not positive and finite, the core not below the radius, the
        sense not known, or the nose none.
    UnitError
        If the radius is above 5 m.

    Examples
    --------
    >>> from metrosep.forms import SineGrid
    >>> job = TurningJob(SineGrid(amplitude=50e-9, wavelength=100e-6), 200e-6, 4e-6, rpm=20)
    >>> plan = job.plan(5e-9)
    >>> prediction = job.predict(plan, tool=ToolSetting(dx=0.25e-6))
    >>> list(prediction.maps)
    ['tool setting', 'program']
    """

    form: Form
    radius: float
    feed: float
    rpm: float
    block_time: float = 0.0
    core: float = 0.0
    sense: Sense | None = None
    nose: RoundNose | None = None

    def __post_init__(self) -> None:
        if not isinstance(self.form, Form):
            raise DataError(
                f"the form must be a metrosep form such as SineGrid(...), got "
                f"{type(self.form).__name__}"
            )
        object.__setattr__(self, "radius", checked_radius(self.radius))
        object.__setattr__(self, "feed", length(self.feed, "feed"))
        object.__setattr__(self, "rpm", numbers.positive(self.rpm, "rpm"))
        block = numbers.not_negative(self.block_time, "block_time", dimension="time")
        object.__setattr__(self, "block_time", block)
        object.__setattr__(self, "core", checked_core(self.core, self.radius))
        if self.nose is not None:
            Edge.of(self.nose, self.sense)
        if self.sense is not None:
            numbers.choice(self.sense, "sense", get_args(Sense))

    @property
    def _way(self) -> Sense:
        return self.sense or "counterclockwise"

    @property
    def _surface(self) -> Form | TipSurface:
        """What the program is a sample of: the heights of the tip, without a nose the form."""
        if self.nose is None:
            return self.form
        return TipSurface(self.form, Edge.of(self.nose, self.sense))

    def _no_tip_path(self, rho: FloatArray, azimuth: FloatArray) -> str:
        """Return what a program of cut points does to a part, first order."""
        _, slope, _ = polar_slopes(self.form, rho, azimuth)
        deep = _USUAL_NOSE * float(np.nanmax(np.hypot(1.0, slope) - 1.0))
        return (
            "cut points: these are points of the surface, no tip path. Run as a tip path, a round "
            f"nose of {format_length(_USUAL_NOSE)} cuts up to about {format_length(deep)} too deep, "
            "which no budget here counts; give the nose of the tool (nose_radius in a recipe, "
            "TurningJob(..., nose=RoundNose(...)) in Python), or offset the points for it elsewhere"
        )

    def path(
        self,
        *,
        step: float,
        distribution: Distribution = "CA",
        interpolation: Interpolation = "spline",
        lead_in: int = _LEAD_IN,
        **options: Any,
    ) -> SpiralPath:
        """Return a path with a step that is given.

        Parameters
        ----------
        step : float, rad or m
            Between points.
        distribution : {"CA", "CAL"}, optional
            Constant angle or arc length.
        interpolation : {"linear", "spline"}, optional
            What the controller does.
        lead_in : int, optional
            Points before the rim.
        **options : object
            Of `SpiralPath`.

        Returns
        -------
        SpiralPath
            Of this workpiece and feed.

        Raises
        ------
        DataError
            If an argument is not one that can be used.
        UnitError
            If the step is too wide to be in rad or m.
        TooFewSamplesError
            If no interval fits.
        """
        checked_options(options, taken=_OF_THE_JOB)
        words: Any = {"distribution": distribution, "interpolation": interpolation, **options}
        own: Any = {"core": self.core, "sense": self._way}
        return SpiralPath(self.radius, self.feed, step=step, lead_in=lead_in, **own, **words)

    @described_by(points_for_tolerance, errors=False)
    def plan(
        self,
        tolerance: float,
        *,
        distribution: Distribution = "CA",
        interpolation: Interpolation = "spline",
        annulus: tuple[float | None, float | None] | None = None,
        lead_in: int = _LEAD_IN,
        **options: Any,
    ) -> JobPlan:
        """Return the fewest blocks whose interpolation error holds a tolerance.

        Parameters
        ----------
        annulus : tuple of (float or None, float or None), m, optional
            Region that counts; the whole part if omitted.
        lead_in : int, optional
            Points before the rim, so that the free end of the spline is not on the part.
        **options : object
            Of `points_for_tolerance`.

        Returns
        -------
        JobPlan
            Path, number of blocks, minutes.

        Raises
        ------
        LimitError, DataError
            As of `points_for_tolerance`.
        """
        for name in options:
            if name in _OF_THE_JOB:
                raise DataError(_OF_THE_JOB[name])
        tolerance = length(tolerance, "tolerance")
        wanted, reached = tolerance, math.nan
        options |= {"distribution": distribution, "interpolation": interpolation}
        for _ in range(_MOST_PLANS):
            found = points_for_tolerance(
                self.form, self.radius, self.feed, wanted, annulus=annulus, lead_in=lead_in,
                core=self.core, sense=self._way, **options,
            )  # fmt: skip
            if self.nose is None:
                return JobPlan(found, self.time(found.path))
            error = found.path.error_map(self._surface)
            reached = error.peak_to_valley(annulus=annulus, azimuth=options.get("azimuth"))
            if reached <= tolerance:
                said = "the search is that of cut points, the P-V that of the tip path"
                messages = (*found.messages, said)
                tip = replace(
                    found, peak_to_valley=reached, tolerance=tolerance, messages=messages
                )
                return JobPlan(tip, self.time(tip.path))
            wanted *= 0.98 * tolerance / reached
        raise LimitError(
            f"no number of blocks was found whose tip path holds {tolerance:.6g} m P-V; the last leaves "
            f"{reached:.6g} m: take a smaller nose or a larger tolerance"
        )

    def time(self, path: SpiralPath | JobPlan) -> MachiningTime:
        """Return the time of one pass.

        Parameters
        ----------
        path : SpiralPath or JobPlan
            Its blocks and turns.

        Returns
        -------
        MachiningTime
            Spindle or controller, whichever is slower.

        Raises
        ------
        DataError
            If the path is of another job, or none.
        """
        path = self._own(path)
        turns = path.turns - self.core / self.feed  # an uncut core takes no time
        return machining_time(
            path.n_points, turns, spindle_speed=self.rpm / 60.0, block_time=self.block_time
        )

    def predict(
        self,
        path: SpiralPath | JobPlan,
        *,
        tool: ToolSetting | None = None,
        follow_up: FollowUp | FollowUpMap | float | None = None,
        others: Sequence[Contribution] = (),
        removed: Sequence[str] = (),
        sub_points: int = 10,
    ) -> Prediction:
        """Return the form error that the part will have, cause by cause.

        Parameters
        ----------
        path : SpiralPath or JobPlan
            The program.
        tool : ToolSetting, optional
            Errors of the setting; its uncertainties go into the budget as modes: the change of the
            error with dx, dy and dR, drawn with their covariance.
        follow_up : FollowUp, FollowUpMap or float, optional
            A log of the dry run with places on the part, or a P-V in m.
        others : sequence of Contribution, optional
            Further causes, maps at the points of this prediction or P-Vs.
        removed : sequence of {"piston", "tilt"}, optional
            Taken off each map by least squares over the area, as an evaluation does.
        sub_points : int, optional
            Samples between two points of the program.

        Returns
        -------
        Prediction
            Budget and maps.

        Raises
        ------
        DataError
            If the path is of another job, the log is of another spiral, does not tell its turns or has no
            sample on the part, or an argument is not one that can be used.
        NotConvergedError
            If dR exceeds what the curvature of the surface allows.
        LimitError
            If there are too many points or samples to work on.

        Notes
        -----
        A log is placed by the turn that its radius tells and by its azimuth. Between its samples
        lie straight lines; a stretch of more than 2.5 steps without a sample is a hole, NaN there.
        With a nose the interpolation error is that of the tip path, at the place of the tip. Cusps
        are not in the budget.
        """
        spiral = self._own(path)
        _check_causes(tool, follow_up, float_too=True)
        if not isinstance(others, list | tuple):
            raise DataError(f"others must be a list of contributions, got {type(others).__name__}")
        removed = checked_removed(removed)
        error = spiral.error_map(self._surface, sub_points=sub_points)
        rho, azimuth, weights = error.rho, error.theta, error.area
        messages = [] if self.nose else [self._no_tip_path(rho, azimuth)]
        messages += error.messages
        if self.nose is not None:
            fits = gouge_check(self.form, self.nose, region=(self.core, self.radius))
            messages += fits.messages if fits.ok else (f"not in the budget: {fits.messages[0]}",)
            if self.nose.rake and tool is not None:
                messages.append(
                    "the map of the tool setting is that of a nose without rake; this one has "
                    f"{math.degrees(self.nose.rake):.4g} degrees, which changes most what dR does"
                )
        causes: list[Contribution] = []
        if tool is not None:
            causes.append(setting_cause(self.form, tool, rho, azimuth, weights, removed, messages))
        causes.append(cause_of("program", error.z, rho, azimuth, weights, removed))
        if isinstance(follow_up, FollowUp | FollowUpMap):
            z = on_spiral(follow_up, spiral, rho, messages)
            causes.append(cause_of("follow-up", z, rho, azimuth, weights, removed))
        elif follow_up is not None:
            causes.append(Contribution("follow-up", follow_up))
        causes += list(others)
        budget = ErrorBudget(causes, weights=weights)
        messages += budget.messages
        audit = {
            "radius_um": 1e6 * self.radius,
            "feed_um": 1e6 * self.feed,
            "n_blocks": spiral.n_points,
            "distribution": spiral.distribution,
            "interpolation": spiral.interpolation,
            "minutes": self.time(spiral).seconds / 60.0,
            "removed": list(removed),
            "n_samples": int(rho.size),
            **self._tool(),
        }
        return Prediction(budget, rho, azimuth, removed, tuple(messages), freeze_mapping(audit))

    @described_by(predict, errors=False)
    def program(
        self, path: SpiralPath | JobPlan, *, servo: Servo = "Z", cut_points: bool = False
    ) -> TurningProgram:
        """Return the program of the tip in time.

        Parameters
        ----------
        servo : {"Z", "XZ"}, optional
            What follows the surface: Z alone, X going in by the feed in every turn; or X and Z, so that
            the contact lies on the spiral.
        cut_points : bool, optional
            Whether a job without a nose may give its points of the surface, marked as such.

        Returns
        -------
        TurningProgram
            Places of the tip (or cut points), times, velocities for PVT.

        Raises
        ------
        DataError
            If the job has no nose and cut points are not asked for, or the path is of another job.
        LimitError
            If the nose gouges, the surface touches it beyond its window, or with "XZ" the tip would
            pass beyond the spindle axis.

        Notes
        -----
        The spindle turns evenly, at the speed of the job or as fast as the block time allows. The
        velocity of Z follows from the slopes at the contact, not from differences.

        References
        ----------
        .. [1] specs/cutting-path.md, equations (4) to (6).
        """
        spiral = self._own(path)
        numbers.choice(servo, "servo", get_args(Servo))
        if self.nose is None:
            return self._surface_program(spiral, cut_points=cut_points)
        fits = gouge_check(self.form, self.nose, region=(self.core, self.radius))
        fits.require()
        edge = Edge.of(self.nose, self.sense)
        X, azimuth, t, speed = self._course(spiral)
        rates = spiral.interpolation == "pvt"
        if servo == "XZ":
            X, azimuth, Z, said = contact_path(self.form, X, azimuth, edge)
            velocities = None
        else:
            Z, slopes, said = tip_heights(self.form, X, azimuth, edge, rates=rates)
            velocities = None if slopes is None else self._rates(spiral, speed, slopes)
            if spiral.knots == "least-squares":
                Z = spiral.points(self._surface).z
        if rates and velocities is None:
            # the contacts wander by no closed form: the velocities of the C2 spline, right to h^4
            velocities = np.stack([knot_slopes(t, v) for v in (X, azimuth, Z)])
        audit = {"n_points": int(X.size), "servo": servo, **self._tool()}
        return TurningProgram(
            frozen(X), frozen(azimuth), frozen(Z), t, "tip", spiral.interpolation,
            None if velocities is None else frozen(velocities), None, spiral.lead_in, {},
            (*fits.messages, *said), freeze_mapping(audit),
        )  # fmt: skip

    def _surface_program(self, spiral: SpiralPath, *, cut_points: bool) -> TurningProgram:
        """Return the program of a job without a nose, or refuse it."""
        X, azimuth, t, _ = self._course(spiral)
        said = self._no_tip_path(X, azimuth)
        if not cut_points:
            raise DataError(f"{said}; or say cut_points=True")
        if spiral.interpolation == "pvt":
            raise DataError("a PVT program is one of the tip: give the nose of the tool")
        Z = spiral.points(self._surface).z
        return TurningProgram(
            frozen(X), frozen(azimuth), Z, t, "cut points", spiral.interpolation,
            lead_in=spiral.lead_in, messages=(said,), audit=freeze_mapping(self._tool()),
        )  # fmt: skip

    def _course(self, spiral: SpiralPath) -> tuple[FloatArray, FloatArray, FloatArray, float]:
        """Return radius, azimuth and time of the points, and the spindle speed in rad/s."""
        u = spiral.angles()
        X = u * (self.feed / (2.0 * math.pi))
        theta = np.subtract(2.0 * math.pi * spiral.turns, u, out=u)
        speed = 2.0 * math.pi * self.rpm / 60.0
        if self.block_time:
            speed = min(speed, float(np.diff(theta).min()) / self.block_time)
        azimuth = spiral.azimuth_of(theta)
        theta -= theta[0]
        theta /= speed
        return X, azimuth, frozen(theta), speed

    def _rates(self, spiral: SpiralPath, speed: float, slopes: FloatArray) -> FloatArray:
        """Return velocities of X, azimuth and Z by dZ/dX and dZ/dphi of the tip, equation (6)."""
        vX, vC = -self.feed * speed / (2.0 * math.pi), spiral.way * speed
        flat = np.ones(slopes.shape[1])
        return np.stack([vX * flat, vC * flat, slopes[0] * vX + slopes[1] * vC])

    @described_by(predict, errors=False)
    def compensated(
        self,
        path: SpiralPath | JobPlan,
        *,
        tool: ToolSetting | None = None,
        follow_up: FollowUp | FollowUpMap | None = None,
        gain: float = 1.0,
    ) -> TurningProgram:
        """Return the program that makes up for the nose, its setting and a logged follow-up error.

        Parameters
        ----------
        tool : ToolSetting, optional
            What the errors of the setting are.
        follow_up : FollowUp or FollowUpMap, optional
            Log of the dry run with places on the part; its negative is added.
        gain : float, optional
            Share of the follow-up error that is taken, above 0 and at most 1.

        Returns
        -------
        TurningProgram
            Points with nominal and commanded height: of the tip (``quantity == "tip"``) if the job
            has a nose, else of the surface (``"cut points"``), which the first message says.

        Raises
        ------
        DataError
            If there is nothing to make up for, an argument cannot be used, the path is of another job, or
            the log is of another spiral, starts late, has a long hole or no sample on the part.
        NotConvergedError
            If the setting cannot be inverted.
        LimitError
            If there are too many points to work on, the nose gouges, or the surface touches it beyond its
            window.

        Notes
        -----
        A tip path is that of `tip_path` for the nose as it is set: R + dR, its tip off by dx and dy.
        The correction must not begin or end with a step, which the spline would carry on as a wave.
        The lead-in, and up to an eighth of a turn before the log begins (a turn at the centre),
        take the value of its end; holes up to an eighth of a turn are bridged. Longer ones are
        refused.
        """
        if tool is None and follow_up is None and self.nose is None:
            raise DataError(
                "give the tool setting or the follow-up error that is to be made up for, or the job a "
                "nose"
            )
        _check_causes(tool, follow_up, float_too=False)
        gain = numbers.positive(numbers.between(gain, "gain", 0.0, 1.0), "gain")
        spiral = self._own(path)
        points = spiral.points(self._surface)
        if self.nose is None:
            change, residual, messages = self._cut_points(points, tool)
            slopes = None
        else:
            change, residual, messages, slopes = self._tips(points, self.nose, tool)
        z = points.z + change
        audit: dict[str, Any] = {"n_points": len(points), "gain": gain, **self._tool()}
        if tool is not None:
            audit |= {f"{n}_um": getattr(tool, n) * 1e6 for n in ("dx", "dy", "dR")}
        added = np.zeros(0)
        if follow_up is not None:
            added = -gain * held_on_points(follow_up, spiral, points.rho, messages)
            z += added
        X, azimuth, t, speed = self._course(spiral)
        joined: Interpolation = spiral.interpolation
        velocities = None
        if joined == "pvt":
            if slopes is None:
                raise DataError("a PVT program is one of the tip: give the nose of the tool")
            found = self._rates(spiral, speed, slopes)
            if added.size:  # a log knows its points only
                found[2] += knot_slopes(t, added)
            velocities = frozen(found)
        return TurningProgram(
            frozen(X), frozen(azimuth), frozen(z), t, "cut points" if self.nose is None else "tip",
            joined, velocities, points.z, points.lead_in, freeze_mapping(residual),
            tuple(messages), freeze_mapping(audit),
        )  # fmt: skip

    def _cut_points(
        self, points: PathPoints, tool: ToolSetting | None
    ) -> tuple[FloatArray, dict[str, float], list[str]]:
        """Return what the setting changes of the points of the surface, residual and messages."""
        said = [self._no_tip_path(points.rho, points.azimuth)]
        if tool is None:
            return np.zeros(len(points)), {}, said
        found = corrected_path(self.form, tool, points.rho, points.azimuth)
        said += [f"tool setting: {m}" for m in tool.messages]
        return found.change, dict(found.residual_pv), [*said, *found.messages]

    def _tips(
        self, points: PathPoints, nose: RoundNose, tool: ToolSetting | None
    ) -> tuple[FloatArray, dict[str, float], list[str], FloatArray]:
        """Return what the setting changes of the tips, residual, messages, dZ/dX and dZ/dphi; refuse a gouge."""
        fits = gouge_check(self.form, nose, region=(self.core, self.radius))
        fits.require()
        nominal = Edge.of(nose, self.sense)
        edge = nominal if tool is None else Edge.of(nose, self.sense, tool)
        made = tips(self.form, points.rho, points.azimuth, edge, strict=True)
        said = [*fits.messages, *made.messages]
        on_part = points.rho <= self.radius
        starts = float(made.rho[on_part][0])
        if starts < self.radius - self.feed:
            said.append(
                f"the first tip on the path touches the part at rho = {format_length(starts)} only: "
                f"outside it nothing is cut; begin {format_length(self.radius - starts)} further out, "
                "with a larger radius"
            )
        turn = edge.by_azimuth(points.rho, made.psi, made.along_x, made.along_y)
        slopes = np.stack([made.along_x, turn])
        if tool is None:
            return np.zeros(len(points)), {}, said, slopes
        plain = tips(self.form, points.rho, points.azimuth, nominal, strict=True)
        _, residual, unknown = left_over(tool, edge.by_setting(made), np.abs(made.rho))
        said += [f"tool setting: {m}" for m in tool.messages]
        return made.z - plain.z, residual, [*said, *unknown], slopes

    def _tool(self) -> dict[str, Any]:
        """Return what an audit says of the nose."""
        if self.nose is None:
            return {"quantity": "cut points"}
        found = {"quantity": "tip", "nose_radius_mm": self.nose.radius * 1e3, "sense": self._way}
        return found | {"rake_deg": math.degrees(self.nose.rake)}

    def _own(self, path: SpiralPath | JobPlan) -> SpiralPath:
        spiral = path.path if isinstance(path, JobPlan) else path
        if not isinstance(spiral, SpiralPath):
            raise DataError(f"the path must be a SpiralPath or a plan, got {type(path).__name__}")
        for name in ("radius", "feed", "core", "sense"):
            theirs, ours = (
                getattr(spiral, name),
                self._way if name == "sense" else getattr(self, name),
            )
            if theirs != ours:
                if name != "sense":
                    theirs, ours = f"{theirs:.6g} m", f"{ours:.6g} m"
                raise DataError(f"the path has the {name} {theirs}, the job has {ours}")
        return spiral


def _check_causes(tool: object, follow_up: object, *, float_too: bool) -> None:
    """Raise DataError for a cause of another kind."""
    if tool is not None and not isinstance(tool, ToolSetting):
        raise DataError(
            f"tool must be a ToolSetting such as ToolSetting(dx=1e-6), got {type(tool).__name__}"
        )
    if follow_up is None or isinstance(follow_up, FollowUp | FollowUpMap):
        return
    if not float_too:
        raise DataError(
            "follow_up must be a log placed on the part, from follow_up(...): a "
            f"{type(follow_up).__name__} has no shape that could be made up for"
        )
    if not isinstance(follow_up, str) and not numbers.is_real(follow_up):
        raise DataError(
            "follow_up must be a log placed on the part, from follow_up(...), or a P-V in m, got "
            f"{type(follow_up).__name__}"
        )


# ---- private helpers: the causes of form error at the samples of a spiral ----------------------

_NAME = "tool setting"
_STEP = {"dx": 1e-8, "dy": 1e-8, "dR": 1e-6}
"""m: at which the effect of a factor that is not determined is looked for."""
_NO_EFFECT = 1e-9
"""Of height for a factor, m/m: rounding of a form that does not show it."""
_BENT, _TINY = 0.5, 1e-11
"""What is not linear within one u, as a share of what is and in m, above which a message says so."""


def setting_cause(
    form: Form,
    tool: ToolSetting,
    rho: FloatArray,
    azimuth: FloatArray,
    weights: FloatArray,
    removed: tuple[str, ...],
    messages: list[str],
) -> Contribution:
    """Return the error of the setting with what its uncertainty can do; NaN in the uncut core."""
    messages += [f"{_NAME}: {m}" for m in tool.messages]
    cut = rho > abs(tool.dy) * (1.0 + 1e-9) + 1e-12
    x, y = rho[cut] * np.cos(azimuth[cut]), rho[cut] * np.sin(azimuth[cut])
    z = np.full(rho.shape, np.nan)
    z[cut] = tool.error(form, x, y)
    if tool.dy and not cut.all():
        messages.append(
            f"{int((~cut).sum())} samples within |dy| of the spindle axis are not cut and have "
            "no error"
        )
    elif not cut.all():
        messages.append(
            f"the {_NAME} has no error on the spindle axis: no azimuth is defined there"
        )
    maps, cov = _modes(form, tool, (x, y), z[cut], messages)
    modes = np.full((len(maps), rho.size), np.nan)
    for mode, values in zip(modes, maps, strict=True):
        mode[cut] = values
    if removed:
        basis = _basis(rho, azimuth, removed)
        z = _without(z, basis, weights)
        for mode in modes:
            mode[:] = _without(mode, basis, weights)
    if cov is None or not cov.size:
        return Contribution(_NAME, map=z, u=None if cov is None else 0.0)
    return Contribution(_NAME, map=z, modes=modes, cov=cov)


def _modes(
    form: Form,
    tool: ToolSetting,
    at: tuple[FloatArray, FloatArray],
    z: FloatArray,
    messages: list[str],
) -> tuple[list[FloatArray], FloatArray | None]:
    """Return the change of the error with each uncertain factor, and their covariance."""
    cov = tool.covariance
    if cov is None:
        unknown = [n for n in FACTORS if getattr(tool, n) and getattr(tool, f"u_{n}") is None]
        messages.append(
            f"the uncertainty of {', '.join(unknown) or 'the setting'} is not known: the P-V of "
            f"the {_NAME} has no u"
        )
        return [], None
    maps: list[FloatArray] = []
    used: list[int] = []
    bent = linear = 0.0
    for i, name in enumerate(FACTORS):
        u = math.sqrt(float(cov[i, i]))
        if u == 0.0:
            continue
        step = u if math.isfinite(u) else _STEP[name]
        try:
            ahead, behind = (
                height_errors(form, *at, _off_by(tool, i, way * step), exact=True)
                for way in (1.0, -1.0)
            )
        except MetrosepError as error:
            messages.append(f"the P-V of the {_NAME} has no u: with {name} one u off, {error}")
            return [], None
        half = 0.5 * (ahead - behind)
        if np.isnan(half).all():
            messages.append(
                f"the P-V of the {_NAME} has no u: with {name} one u off nothing is cut"
            )
            return [], None
        if math.isinf(u):
            if float(np.nanmax(np.abs(half))) > _NO_EFFECT * step:
                messages.append(
                    f"{name} is not determined (its u is infinite): the P-V of the {_NAME} has no u"
                )
                return [], None
            messages.append(
                f"{name} is not determined, and of no effect on this form to first order: it is "
                "not counted"
            )
            continue
        bent += _extent(0.5 * (ahead + behind) - z)
        linear += _extent(half)
        maps.append(half / step)
        used.append(i)
    if bent > max(_BENT * linear, _TINY):
        messages.append(
            f"the error of the {_NAME} is not linear within its uncertainty: u and expected P-V, "
            "of first order, are too small"
        )
    if not used:
        return [], None if np.isinf(np.diag(cov)).any() else np.empty((0, 0))
    square = cov[np.ix_(used, used)]
    return maps, np.where(np.isfinite(square), square, 0.0)


def _off_by(tool: ToolSetting, factor: int, change: float) -> tuple[float, float, float]:
    """Return a setting with one factor changed."""
    dx, dy, dR = (v + (change if k == factor else 0.0) for k, v in enumerate(tool.values.tolist()))
    return dx, dy, dR


def _extent(values: FloatArray) -> float:
    return float(np.nanmax(values) - np.nanmin(values))


def cause_of(
    name: str,
    z: FloatArray,
    rho: FloatArray,
    azimuth: FloatArray,
    weights: FloatArray,
    removed: tuple[str, ...],
) -> Contribution:
    """Return a contribution without the removed freedoms."""
    if removed:
        z = _without(z, _basis(rho, azimuth, removed), weights)
    return Contribution(name, map=z)


def _basis(rho: FloatArray, azimuth: FloatArray, removed: tuple[str, ...]) -> FloatArray:
    columns = [np.ones_like(rho)] if "piston" in removed else []
    if "tilt" in removed:
        scale = float(rho.max())
        columns += [rho * np.cos(azimuth) / scale, rho * np.sin(azimuth) / scale]
    return np.stack(columns)


def _without(z: FloatArray, basis: FloatArray, weights: FloatArray) -> FloatArray:
    """Return a map without what a basis explains of it, by least squares over the area."""
    good = ~np.isnan(z)
    weighted = basis[:, good] * weights[good]
    normal = weighted @ basis[:, good].T
    found, *_ = np.linalg.lstsq(normal, weighted @ z[good], rcond=None)
    return np.asarray(z - found @ basis, dtype=np.float64)


def checked_removed(removed: Sequence[str]) -> tuple[str, ...]:
    """Return the names of what is removed."""
    if not isinstance(removed, str | list | tuple | set | frozenset):
        raise DataError(f'removed must be of "piston" and "tilt", got {removed!r}')
    names = (removed,) if isinstance(removed, str) else tuple(removed)
    return tuple(numbers.choice(n, "removed", ("piston", "tilt")) for n in names)
