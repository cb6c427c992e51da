"""`TurningJob`: a freeform to be turned, from the number of blocks to the corrected program.

Everything is evaluated at the same points of the spiral, so that the maps of the causes add. Errors
are actual minus nominal along z, out of the material. After slow-tool-servo, sections 2 to 4.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, fields
from typing import Any, get_args

import numpy as np

from metrosep.core import numbers
from metrosep.core._arrays import FloatArray
from metrosep.core.docs import described_by
from metrosep.core.errors import DataError, LimitError
from metrosep.core.provenance import freeze_mapping
from metrosep.core.units import format_length
from metrosep.forms.base import Form
from metrosep.process._job_causes import cause_of, check_causes, checked_removed, setting_cause
from metrosep.process._log_places import held_on_points, on_spiral
from metrosep.process._motion import FollowUp, FollowUpMap
from metrosep.process._plain import frozen, length
from metrosep.process._setting_equations import polar_gradient
from metrosep.process.cutting.course_errors import course_error, lead_in_dip, on_the_cut
from metrosep.process.cutting.edge_errors import Servo
from metrosep.process.cutting.motion import AxisLimits, AxisMotion, axis_motion
from metrosep.process.cutting.programs import TurningProgram
from metrosep.process.cutting.reach import checked_travel, require_no_hole, require_travel
from metrosep.process.cutting.rim import fits_in_ring, led_in, outside_the_rim, rim_said
from metrosep.process.cutting.servos import contact_path, refuse_fitted
from metrosep.process.feedforward import corrected_path, left_over
from metrosep.process.interpolation import Interpolation, knot_slopes
from metrosep.process.machining_times import MachiningTime, machining_time
from metrosep.process.nose import RoundNose
from metrosep.process.path_errors import PathErrorMap, course_of
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

_LEAD_IN = 3
_PARTS = 10
"""Moments within a block at which a plan or a prediction looks."""
_MOST_COUNTS, _NEARLY = 14, 0.98
"""Counts that are tried on the cut surface; a count that leaves more than that of the tolerance is near enough."""
_MOST_BLOCKS = 1_000_000
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
    motion : AxisMotion, optional
        What the axes must do at the speed of the job, where limits were given.
    """

    points: PointPlan
    time: MachiningTime
    motion: AxisMotion | None = None

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

    @property
    def rpm_max(self) -> float:
        """Spindle speed that all limits of the axes allow, 1/min; infinite where none was given."""
        return math.inf if self.motion is None else self.motion.rpm_max


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
    x_travel, z_travel : tuple of (float, float), m, optional
        What the machine reaches: least and largest radius of the tip, and least and largest height, 0 where
        the form is 0. A program that leaves them, at a point or between two, is refused.

    Raises
    ------
    DataError
        If the form is none, a number is not positive and finite, the core not below the radius, the
        sense not known, the nose none, or a travel does not begin before it ends.
    InvalidSamplesError
        If the form is a map with a hole between core and rim.
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
    x_travel: tuple[float, float] | None = None
    z_travel: tuple[float, float] | None = None

    def __post_init__(self) -> None:
        if not isinstance(self.form, Form):
            raise DataError(
                f"the form must be a metrosep form such as SineGrid(...), got {type(self.form).__name__}"
            )
        object.__setattr__(self, "radius", checked_radius(self.radius))
        object.__setattr__(self, "feed", length(self.feed, "feed"))
        object.__setattr__(self, "rpm", numbers.positive(self.rpm, "rpm"))
        block = numbers.not_negative(self.block_time, "block_time", dimension="time")
        object.__setattr__(self, "block_time", block)
        object.__setattr__(self, "core", checked_core(self.core, self.radius))
        require_no_hole(self.form, self.core, self.radius)
        if self.nose is not None:
            Edge.of(self.nose, self.sense)
        if self.sense is not None:
            numbers.choice(self.sense, "sense", get_args(Sense))
        for name in ("x_travel", "z_travel"):
            object.__setattr__(self, name, checked_travel(getattr(self, name), name))

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
        slope, _ = polar_gradient(self.form, rho, azimuth)
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
        lead_in: int | None = None,
        servo: Servo = "Z",
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
            Points before the rim; by default as many as a nose needs to cut the part up to its rim, see
            `before_the_rim`, and 3 without one.
        servo : {"Z", "XZ"}, optional
            What will follow the surface, as of `program`.
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
        made = SpiralPath(self.radius, self.feed, step=step, lead_in=lead_in or 0, **own, **words)
        return made if lead_in is not None else self._led_in(made, servo)

    def before_the_rim(self, servo: Servo = "Z", tool: ToolSetting | None = None) -> float:
        """Return how far outside the rim the tip must begin, so that the part is cut up to its rim.

        Parameters
        ----------
        servo : {"Z", "XZ"}, optional
            What follows the surface, as of `program`.
        tool : ToolSetting, optional
            Errors of the setting that the program makes up for; a path is made without, and a program for a tool
            that stands further in than half a feed says how many points it lacks.

        Returns
        -------
        float, m
            What the contact of the nose lies inside the tip at the rim, at the azimuth where that is most,
            and one feed and a half: for the first turn, and so that it decides no place of the part; 0
            without a nose and on a bowl whose contact lies that far outside the tip.

        Raises
        ------
        InvalidSamplesError
            If the form has no height at a place of the rim, or with servo "XZ" of where contacts begin.

        Examples
        --------
        >>> from metrosep.forms import Sphere
        >>> job = TurningJob(Sphere(R=-35e-3), 8e-3, 10e-6, rpm=60, nose=RoundNose(0.6e-3))
        >>> round(job.before_the_rim() * 1e6, 2)  # 0.6 mm times 8/35, and 15 um
        152.14
        """
        numbers.choice(servo, "servo", get_args(Servo))
        if self.nose is None:
            return 0.0
        return outside_the_rim(
            self.form, self.radius, self.feed, Edge.of(self.nose, self._way, tool), servo
        )

    def _led_in(
        self, spiral: SpiralPath, servo: Servo, tool: ToolSetting | None = None
    ) -> SpiralPath:
        """Return the path with the points before the rim that the nose, and the end of a spline, need."""
        edge = Edge.of(self.nose, self._way, tool) if self.nose and servo == "Z" else None
        return led_in(spiral, self.before_the_rim(servo, tool), self.form, edge)

    @described_by(points_for_tolerance, errors=False)
    def plan(
        self,
        tolerance: float,
        *,
        distribution: Distribution = "CA",
        interpolation: Interpolation = "spline",
        annulus: tuple[float | None, float | None] | None = None,
        lead_in: int | None = None,
        servo: Servo = "Z",
        limits: Mapping[str, AxisLimits] | None = None,
        **options: Any,
    ) -> JobPlan:
        """Return the fewest blocks whose interpolation error holds a tolerance, with a nose on the surface it cuts.

        Parameters
        ----------
        annulus : tuple of (float or None, float or None), m, optional
            Region that counts; the whole part if omitted.
        lead_in : int, optional
            Points before the rim, so that the free end of the spline is not on the part; by default as of `path`.
        servo : {"Z", "XZ"}, optional
            What follows the surface, as of `program`: with "XZ" the error is that of X, azimuth and Z together.
        limits : mapping of str to AxisLimits, optional
            Of X, C and Z: the plan then says how fast the spindle may turn, see `axis_motion`.
        **options : object
            Of `points_for_tolerance`.

        Returns
        -------
        JobPlan
            Path, number of blocks, minutes, motion of the axes.

        Raises
        ------
        LimitError, DataError
            As of `points_for_tolerance`, `program` and `axis_motion`.
        """
        numbers.choice(servo, "servo", get_args(Servo))
        for name in options:
            if name in _OF_THE_JOB:
                raise DataError(_OF_THE_JOB[name])
        tolerance = length(tolerance, "tolerance")
        options |= {"distribution": distribution, "interpolation": interpolation}
        found = points_for_tolerance(
            self.form, self.radius, self.feed, tolerance, annulus=annulus,
            lead_in=_LEAD_IN if lead_in is None else lead_in,
            core=self.core, sense=self._way, **options,
        )  # fmt: skip
        if servo == "XZ":
            self._require_nose_for_xz()
        if self.nose is not None:
            if servo == "XZ" and options.get("azimuth") is not None:
                raise DataError('with servo "XZ" a plan is over an area: leave azimuth out')
            region = {"annulus": annulus, "azimuth": options.get("azimuth")}
            free = lead_in is None
            found = self._on_the_cut(found, tolerance, servo, region, options, free=free)
        motion = None
        if limits is not None:
            program = self.program(found.path, servo=servo, cut_points=self.nose is None)
            motion = axis_motion(program, limits, block_time=self.block_time)
        return JobPlan(found, self.time(found.path), motion)

    def _require_nose_for_xz(self) -> None:
        if self.nose is None:
            raise DataError(
                'servo "XZ" puts the contacts of a nose on the spiral: give the nose of the tool'
            )

    def _on_the_cut(
        self,
        start: PointPlan,
        tolerance: float,
        servo: Servo,
        region: Mapping[str, Any],
        options: Mapping[str, Any],
        *,
        free: bool,
    ) -> PointPlan:
        """Return the plan whose count holds on the surface that the nose cuts, sought from one for cut points."""
        assert self.nose is not None  # noqa: S101  # a plan on the cut is one of a nose
        edge = Edge.of(self.nose, self._way)
        power = 2.0 if start.path.interpolation == "linear" else 4.0
        parts, most = options.get("sub_points", _PARTS), options.get("max_points", _MOST_BLOCKS)
        tried: dict[int, float] = {}
        lead_binds: dict[int, bool] = {}
        fewest = int(start.tried.min())
        # over: the largest that fails; under: the smallest that holds
        n, over, under = start.n_points, 0, 0
        for _ in range(_MOST_COUNTS):
            spiral = self._counted(start.path, n)
            path = self._error_map(self._led_in(spiral, servo) if free else spiral, servo, parts)
            made = on_the_cut(path, self.form, edge, servo, tolerance)
            error = made.peak_to_valley(**region)
            dip = lead_in_dip(
                self.program(path.path, servo=servo),
                self.form,
                edge,
                parts,
                region["annulus"] or (0.0, self.radius),
            )
            # the free end of the spline digs before the rim into what the nose touches inside it
            dug = max(error, float(made.z.max()) - dip)
            lead_binds[n] = dug > error
            tried[n] = error = dug
            over, under = (over, n) if error <= tolerance else (max(over, n), under)
            if under == n and error > _NEARLY * tolerance:
                break
            if under and under - max(over, fewest - 1) <= max(1, under // 500):
                break
            # errors fall with a power of the count; never back beyond what was tried
            n = math.ceil(n * (error / (0.995 * tolerance)) ** (1.0 / power))
            if under:
                n = min(max(n, over + 1, fewest), under - 1)
            elif n <= over:
                n = math.ceil(1.05 * over)
            if n > most:
                break
        if not under:
            raise LimitError(
                f"no number of blocks up to {most} was found that holds {tolerance:.6g} m P-V on the surface that "
                f"the nose cuts; {over} leave {tried[over]:.6g} m: take a larger tolerance"
            )
        counts = np.array(sorted(tried), dtype=np.int64)
        above = [tried[k] for k in counts[counts > under].tolist()]
        said = (
            "the P-V is that of the surface that is cut, without cusps: the tip between the points as the control "
            "joins them, less what the turns on either side cut away"
        )
        if lead_binds[under]:
            said += (
                "; the blocks before the rim ask for this count, as the nose touches the part from there: with more "
                "lead_in the free end lies further out, and fewer points a turn may do"
            )
        spiral = self._counted(start.path, under)
        return PointPlan(
            under, self._led_in(spiral, servo) if free else spiral, tried[under], tolerance, counts,
            np.array([tried[k] for k in counts.tolist()]), max(above, default=0.0) <= tolerance,
            (*start.path.messages, said),
        )  # fmt: skip

    def _counted(self, spiral: SpiralPath, n: int) -> SpiralPath:
        """Return the path with another count of blocks."""
        own = {
            f.name: getattr(spiral, f.name)
            for f in fields(SpiralPath)
            if f.init and f.name not in ("radius", "feed", "step", "n_points")
        }
        return SpiralPath.with_points(self.radius, self.feed, n, **own)

    def _error_map(self, spiral: SpiralPath, servo: Servo, parts: int) -> PathErrorMap:
        """Return the error between the points of a path, as the servo follows them."""
        if servo == "Z":
            return spiral.error_map(self._surface, sub_points=parts)
        self._require_nose_for_xz()
        assert self.nose is not None  # noqa: S101  # just seen
        program = self.program(spiral, servo=servo)
        z = course_error(
            program, self.form, Edge.of(self.nose, self.sense), parts, first=spiral.lead_in
        )
        return PathErrorMap(frozen(z), spiral, self.form, parts, course_of(spiral, self.form))

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
        follow_up_x: FollowUp | FollowUpMap | None = None,
        others: Sequence[Contribution] = (),
        removed: Sequence[str] = (),
        sub_points: int = _PARTS,
        servo: Servo = "Z",
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
        follow_up_x : FollowUp or FollowUpMap, optional
            The same of X, positive outwards: it acts as minus the slope along X times it.
        others : sequence of Contribution, optional
            Further causes, maps at the points of this prediction or P-Vs.
        removed : sequence of {"piston", "tilt"}, optional
            Taken off each map by least squares over the area, as an evaluation does.
        sub_points : int, optional
            Samples between two points of the program.
        servo : {"Z", "XZ"}, optional
            What follows the surface, as of `program`.

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
        With a nose the interpolation error is that of the tip path, at the place of the tip; with servo
        "XZ" at the place of the contact. Cusps are not in the budget.
        """
        spiral = self._own(path)
        check_causes(tool, follow_up, float_too=True)
        check_causes(None, follow_up_x, float_too=False)
        if not isinstance(others, list | tuple):
            raise DataError(f"others must be a list of contributions, got {type(others).__name__}")
        removed = checked_removed(removed)
        numbers.choice(servo, "servo", get_args(Servo))
        error = self._error_map(spiral, servo, sub_points)
        rho, azimuth, weights = error.rho, error.theta, error.area
        messages = [] if self.nose else [self._no_tip_path(rho, azimuth)]
        messages += error.messages
        if self.nose is not None:
            fits = fits_in_ring(self.form, self.nose, self.sense, self.core, self.radius)
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
        if follow_up_x is not None:
            off = on_spiral(follow_up_x, spiral, rho, messages)
            # dZ/dX of the tip is the slope at its contact; with XZ the samples are contacts
            surface = self.form if servo == "XZ" else self._surface
            gx, gy = surface.gradient(rho * np.cos(azimuth), rho * np.sin(azimuth))
            z = -(np.cos(azimuth) * gx + np.sin(azimuth) * gy) * off
            causes.append(cause_of("follow-up of X", z, rho, azimuth, weights, removed))
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
            If the nose gouges, the surface touches it beyond its window, the tip leaves the travel of the
            machine, or with "XZ" it would pass beyond the spindle axis.

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
            return self._reached(self._surface_program(spiral, cut_points=cut_points))
        fits = fits_in_ring(self.form, self.nose, self.sense, self.core, self.radius)
        fits.require()
        edge = Edge.of(self.nose, self.sense)
        X, azimuth, t, speed = self._course(spiral)
        rates = spiral.interpolation == "pvt"
        if servo == "XZ":
            refuse_fitted(spiral)
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
        if servo == "Z":
            turn = slice(0, int(np.count_nonzero(X[0] - X <= 1.01 * self.feed)))
            begins = tips(self.form, X[turn], azimuth[turn], edge, strict=False)
            said = (
                *said,
                *rim_said(spiral, X[turn], begins.rho, lambda: self._led_in(spiral, "Z").lead_in),
            )
        program = TurningProgram(
            frozen(X), frozen(azimuth), frozen(Z), t, "tip", spiral.interpolation,
            None if velocities is None else frozen(velocities), None, spiral.lead_in, {},
            (*fits.messages, *said), freeze_mapping(audit),
        )  # fmt: skip
        return self._reached(program)

    def _reached(self, program: TurningProgram) -> TurningProgram:
        require_travel(program, self.x_travel, self.z_travel)
        return program

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
        follow_up_x: FollowUp | FollowUpMap | None = None,
        gain: float = 1.0,
        servo: Servo = "Z",
    ) -> TurningProgram:
        """Return the program that makes up for the nose, its setting and a logged follow-up error.

        Parameters
        ----------
        tool : ToolSetting, optional
            What the errors of the setting are.
        follow_up : FollowUp or FollowUpMap, optional
            Log of the dry run with places on the part; its negative is added to Z.
        follow_up_x : FollowUp or FollowUpMap, optional
            The same of X, positive outwards; with servo "XZ" only, for X follows nothing otherwise.
        gain : float, optional
            Share of the follow-up error that is taken, above 0 and at most 1.
        servo : {"Z", "XZ"}, optional
            What follows the surface, as of `program`: with "XZ" the contacts of the tool as it is set lie on
            the spiral, and X makes up for it too.

        Returns
        -------
        TurningProgram
            Points with nominal and commanded height: of the tip (``quantity == "tip"``) if the job
            has a nose, else of the surface (``"cut points"``), which the first message says.

        Raises
        ------
        DataError
            If there is nothing to make up for, an argument cannot be used, the path is of another job, a log of
            X is given and X follows nothing, or the log is of another spiral, starts late, has a long hole or no sample on the part.
        NotConvergedError
            If the setting cannot be inverted.
        LimitError
            If there are too many points to work on, the nose gouges, the surface touches it beyond its
            window, or the tip leaves the travel of the machine.

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
        check_causes(tool, follow_up, float_too=False)
        check_causes(None, follow_up_x, float_too=False)
        gain = numbers.positive(numbers.between(gain, "gain", 0.0, 1.0), "gain")
        spiral = self._own(path)
        numbers.choice(servo, "servo", get_args(Servo))
        if servo == "XZ":
            return self._compensated_both(spiral, tool, follow_up, follow_up_x, gain)
        if follow_up_x is not None:
            raise DataError(
                'a log of X is made up for by X, and with servo "Z" X follows nothing: take servo "XZ", or leave '
                "follow_up_x out"
            )
        points = spiral.points(self._surface)
        if self.nose is None:
            change, residual, messages = self._cut_points(points, tool)
            slopes = None
        else:
            change, residual, messages, slopes = self._tips(spiral, points, self.nose, tool)
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
        program = TurningProgram(
            frozen(X), frozen(azimuth), frozen(z), t, "cut points" if self.nose is None else "tip",
            joined, velocities, points.z, points.lead_in, freeze_mapping(residual),
            tuple(messages), freeze_mapping(audit),
        )  # fmt: skip
        return self._reached(program)

    def _compensated_both(
        self,
        spiral: SpiralPath,
        tool: ToolSetting | None,
        follow_up: FollowUp | FollowUpMap | None,
        follow_up_x: FollowUp | FollowUpMap | None,
        gain: float,
    ) -> TurningProgram:
        """Return the program of X and Z whose contacts, of the tool as it is set, lie on the spiral."""
        self._require_nose_for_xz()
        assert self.nose is not None  # noqa: S101  # just seen
        refuse_fitted(spiral)
        nominal = self.program(spiral, servo="XZ")
        places = self._course(spiral)[0]
        X, azimuth, Z, said = nominal.X, nominal.azimuth, nominal.Z, [*nominal.messages]
        residual: dict[str, float] = {}
        audit: dict[str, Any] = {"n_points": X.size, "gain": gain, "servo": "XZ", **self._tool()}
        if tool is not None:
            edge = Edge.of(self.nose, self.sense, tool)
            theta = self._course(spiral)[1]
            X, azimuth, Z, _ = contact_path(self.form, places, theta, edge)
            made = tips(self.form, X, azimuth, edge, strict=True)
            _, residual, unknown = left_over(tool, edge.by_setting(made), np.abs(made.rho))
            said += [*(f"tool setting: {m}" for m in tool.messages), *unknown]
            audit |= {f"{n}_um": getattr(tool, n) * 1e6 for n in ("dx", "dy", "dR")}
        if follow_up is not None:
            Z = Z - gain * held_on_points(follow_up, spiral, places, said)
        if follow_up_x is not None:
            X = X - gain * held_on_points(follow_up_x, spiral, places, said)
        rates = None
        if spiral.interpolation == "pvt":
            rates = frozen(np.stack([knot_slopes(nominal.t, v) for v in (X, azimuth, Z)]))
        program = TurningProgram(
            frozen(X), frozen(azimuth), frozen(Z), nominal.t, "tip", spiral.interpolation, rates,
            nominal.Z, spiral.lead_in, freeze_mapping(residual), tuple(said), freeze_mapping(audit),
        )  # fmt: skip
        return self._reached(program)

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
        self,
        spiral: SpiralPath,
        points: PathPoints,
        nose: RoundNose,
        tool: ToolSetting | None,
    ) -> tuple[FloatArray, dict[str, float], list[str], FloatArray]:
        """Return what the setting changes of the tips, residual, messages, dZ/dX and dZ/dphi; refuse a gouge."""
        fits = fits_in_ring(self.form, nose, self.sense, self.core, self.radius)
        fits.require()
        nominal = Edge.of(nose, self.sense)
        edge = nominal if tool is None else Edge.of(nose, self.sense, tool)
        made = tips(self.form, points.rho, points.azimuth, edge, strict=True)
        said = [*fits.messages, *made.messages]
        said += rim_said(
            spiral, points.rho, made.rho, lambda: self._led_in(spiral, "Z", tool).lead_in
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
