"""Steps of recipes with models of the process: tool setting, follow-up error, flexure, prediction."""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any, ClassVar

import numpy as np

from metrosep.core.errors import DataError
from metrosep.core.methods import Method, RoleColumns
from metrosep.core.options import Option
from metrosep.core.provenance import Step
from metrosep.core.recording import Recording
from metrosep.core.surface import Surface
from metrosep.core.units import column_unit, format_length
from metrosep.recipe.methods.axis_limits import LIMITS, TRAVEL, limits_of
from metrosep.recipe.methods.ops_machine import CENTRE, form_of, one_map

OF_PART = (
    "x and y of the spindle axis in the coordinates of the map of the part; 0, 0 if omitted, or the middle of a "
    "map without an origin"
)


SURFACE: Mapping[str, Option] = {
    "form": Option(
        "text",
        help='the nominal surface with all its parameters, "sine_grid: amplitude=50 nm, wavelength=100 um"',
    ),
    "form_map": Option(
        "file", help="instead of it a map of the surface, as designed or as measured"
    ),
    "form_centre": Option(
        "lengths",
        help="x and y of the spindle axis in the coordinates of that map; 0, 0 if omitted, or the middle of a map "
        "without an origin",
    ),
}


def surface_of(options: Mapping[str, Any]) -> tuple[Any, tuple[str, ...]]:
    """Return the surface to be cut: a form of its text, or of a map with a spline through its pixels; and notes."""
    given = [k for k in ("form", "form_map") if k in options]
    if len(given) != 1:
        raise DataError(
            "give the surface to be cut: either form, a formula with all its parameters, or form_map, a file with "
            f"its heights; got {' and '.join(given) or 'none'}"
        )
    centre = options.get("form_centre")
    if given == ["form"]:
        if centre is not None:
            raise DataError("form_centre is the axis on the map of a surface: give that, form_map")
        return form_of(options["form"]), ()
    if centre is not None and len(centre) != 2:
        raise DataError(f"form_centre is two lengths, got {len(centre)}")
    from metrosep.forms import GridForm
    from metrosep.forms.points import points_of

    surface = map_of(options["form_map"], "form_map")
    placed = points_of(surface, centre=centre, middle=True)
    x, y = (a - b for a, b in zip(surface.origin, placed.centre, strict=True))
    notes = tuple(n.replace("centre=", "form_centre") for n in placed.notes)
    return GridForm(replace(surface, origin=(x, y))), notes


class SettingFound(Method):
    """`tool_setting` by its name."""

    name: ClassVar[str] = "tool_setting"
    what: ClassVar[str] = (
        "errors of the tool setting (dx, dy, nose radius) that explain a turned part"
    )
    reads: ClassVar = "maps"
    readings: ClassVar[tuple[str, ...]] = ("map",)
    arguments: ClassVar[Mapping[str, Option]] = {
        "form": Option(
            "text",
            required=True,
            help='the nominal surface, "sine_grid: amplitude=50 nm, wavelength=100 um"',
        ),
        "free": Option(
            "texts",
            help="what is fitted, piston,dx,dy,dR (tilt_x, tilt_y, shift_x, shift_y, rotation too)",
        ),
        "nose_radius": Option("size", help="of the tool as programmed"),
        "centre": CENTRE,
        "region": Option("lengths", help='radii between which points are used, "20 um, 220 um"'),
        "noise": Option("size", help='standard uncertainty of one height, "1 nm"'),
    }

    @classmethod
    def from_inputs(cls, data: tuple[Surface, ...], options: Mapping[str, Any]) -> Any:
        """Return what the step makes."""
        from metrosep.process import identify_setting

        rest = dict(options)
        form = form_of(rest.pop("form"))
        for key in ("centre", "region"):
            if key in rest:
                if len(rest[key]) != 2:
                    raise DataError(f"{key} is two lengths, got {len(rest[key])}")
                rest[key] = tuple(rest[key])
        return identify_setting(one_map(data), form, **rest)


def _recording(data: RoleColumns, **channels: str) -> Recording:
    """Return columns as a recording; the channels keep the names of their roles."""
    values = {name: np.asarray(data.values[role]) for name, role in channels.items()}
    return Recording(np.asarray(data.values["time"]), values, history=data.history)


class FollowUpOfLog(Method):
    """`follow_up` by its name."""

    name: ClassVar[str] = "follow_up"
    what: ClassVar[str] = "follow-up error of an axis from its log, and what it depends on"
    reads: ClassVar = "table"
    roles: ClassVar[Mapping[str, str]] = {
        "time": "time",
        "command": "length?",
        "actual": "length?",
        "error": "length?",
        "rho": "length?",
        "theta": "angle?",
    }
    arguments: ClassVar[Mapping[str, Option]] = {
        "terms": Option(
            "texts",
            help="what the error may depend on, velocity,acceleration,jerk (position, friction too)",
        ),
        "delay": Option("time", help='known lag of the logger, removed first, "1 ms"'),
        "estimate_delay": Option("flag", help="true: the lag of the logger is found from the log"),
        "window": Option("integer", help="samples over which velocity and acceleration are found"),
        "error_sign": Option(
            "text", choices=("actual-command", "command-actual"), help="what the logged error is"
        ),
        "spiral": Option("lengths", help='start radius and feed per turn, "500 um, 2 um"'),
        "rpm": Option("any", help="turns of the spindle per minute, 20"),
    }

    @classmethod
    def from_inputs(cls, data: RoleColumns, options: Mapping[str, Any]) -> Any:
        """Return what the step makes."""
        from metrosep.process import follow_up

        rest = dict(options)
        given = [r for r in ("command", "actual", "error", "rho", "theta") if r in data.values]
        spiral = rest.pop("spiral", None)
        rpm = rest.pop("rpm", None)
        if (spiral is None) != (rpm is None):
            raise DataError(
                "a spiral needs its start radius and feed, and the spindle speed: spiral = "
                '["500 um", "2 um"] and rpm = 20'
            )
        if spiral is not None:
            if len(spiral) != 2:
                raise DataError(f"spiral is two lengths, start radius and feed, got {len(spiral)}")
            rest["spiral"] = (spiral[0], spiral[1], 2.0 * np.pi * _turns_per_minute(rpm) / 60.0)
        delay = rest.pop("delay", None)
        if delay is not None:
            rest["delay"] = delay
        if rest.pop("estimate_delay", False):
            if delay is not None:
                raise DataError("delay is stated and estimate_delay is true; give one of them")
            rest["delay"] = "estimate"
        if "error_sign" in rest and "error" not in given:
            raise DataError(
                'error_sign says what a logged error is; name its column: error = "fe_nm" (from command '
                "and actual the sign is known)"
            )
        log = _recording(data, **{name: name for name in given})
        if "error" in given:
            rest["error"] = "error"
        return follow_up(log, **rest)


STAGE: Mapping[str, str] = {"voltage": "any", "displacement": "length", "time": "time?"}
"""Columns of the log of a stage."""


def stage_log(data: RoleColumns) -> Recording:
    """Return the log of a stage; samples are in order of time where no time is given."""
    time = data.values.get("time", np.arange(float(data.values["displacement"].size)))
    values = {n: data.values[n] for n in ("voltage", "displacement")}
    return Recording(time, values, history=data.history)


class FlexureCalibrated(Method):
    """`flexure_calibration` by its name."""

    name: ClassVar[str] = "flexure_calibration"
    what: ClassVar[str] = (
        "displacement of a flexure stage over its voltage: sensitivity, hysteresis, inverse"
    )
    reads: ClassVar = "table"
    roles: ClassVar[Mapping[str, str]] = STAGE
    arguments: ClassVar[Mapping[str, Option]] = {
        "line": Option(
            "text",
            choices=("least-squares", "end-point"),
            help="line from which the linearity counts",
        ),
        "resolution": Option("uncertainty", help="of the sensor"),
    }

    @classmethod
    def from_inputs(cls, data: RoleColumns, options: Mapping[str, Any]) -> Any:
        """Return what the step makes."""
        from metrosep.process import flexure_calibration

        return flexure_calibration(stage_log(data), **dict(options))


@dataclass(frozen=True, slots=True)
class JobResult:
    """A predicted turning job."""

    plan: Any  # where the number of blocks was sought
    prediction: Any  # budget and maps
    measured: float | None  # m: P-V of the part as cut
    program: Any  # heights that make up for what is known
    path: Any  # the program's points
    # how well the tool must be set to add no more than the tolerance of the program
    allowed: Any = None
    beside: tuple[Step, ...] = ()  # of the log of the dry run
    doubts: tuple[str, ...] = ()  # why the program is not corrected by that log
    form: Any = None  # the surface wanted
    nose: Any = None  # of the tool that cuts; None where nobody gave it
    setting: Any = None  # of that tool
    found: tuple[str, ...] = ()  # what a measured part says of the tool
    motion: Any = None  # what the axes must do, where their limits are given

    @property
    def messages(self) -> tuple[str, ...]:
        """What to know."""
        plan = () if self.plan is None else self.plan.points.messages
        program = () if self.program is None else self.program.messages
        edge = getattr(self.nose, "edge", None)
        taken = () if edge is None else edge.messages
        unshaped = ", ".join(self.prediction.budget.without_map)
        sums = (
            (f"{unshaped} is known as a P-V only: the maps cannot be added",) if unshaped else ()
        )
        return tuple(
            dict.fromkeys(
                (
                    *self.doubts,
                    *taken,
                    *self.found,
                    *plan,
                    *self.prediction.messages,
                    *sums,
                    *program,
                )
            )
        )


class JobPredicted(Method):
    """`predict` by its name."""

    name: ClassVar[str] = "predict"
    what: ClassVar[str] = "form error of a turned freeform before it is cut, cause by cause"
    reads: ClassVar = "nothing"
    arguments: ClassVar[Mapping[str, Option]] = {
        **SURFACE,
        "radius": Option(
            "size", required=True, help='of the part, from its axis to the rim, "20 mm"'
        ),
        "feed": Option("size", required=True, help='towards the centre per turn, "2 um"'),
        "rpm": Option("any", required=True, help="turns of the spindle per minute, 20"),
        "block_time": Option("time", help='that the controller needs for a block, "2 ms"'),
        "core": Option("size", help='radius about the axis that is not judged, "4 um"'),
        "sense": Option(
            "text",
            choices=("counterclockwise", "clockwise"),
            help="in which the part turns, seen from the tool",
        ),
        "tolerance": Option("size", help='P-V that the points of the program may add, "1 nm"'),
        "angle_step": Option("angle", help="constant angle between the points of the program"),
        "length_step": Option(
            "size", help="constant arc length between the points of the program"
        ),
        "distribution": Option(
            "text",
            choices=("CA", "CAL"),
            help="points at constant angle (CA) or constant arc length (CAL)",
        ),
        "interpolation": Option(
            "text",
            choices=("linear", "spline", "pvt"),
            help="how the controller goes from point to point",
        ),
        "lead_in": Option(
            "integer",
            help="points before the rim; by default as many as cut the part up to its rim",
        ),
        "dx": Option(
            "length", help='tool further from the spindle axis than programmed, "-0.25 um"'
        ),
        "dy": Option(
            "length", help='tool off the axis towards growing azimuth of the part, "0.1 um"'
        ),
        "dR": Option("length", help='nose radius larger than programmed, "10 um"'),
        "u_dx": Option("uncertainty", help="standard uncertainty of dx"),
        "u_dy": Option("uncertainty", help="standard uncertainty of dy"),
        "u_dR": Option("uncertainty", help="standard uncertainty of dR"),
        "nose_radius": Option(
            "size",
            help='of the tool, "0.5 mm": the program is then a path of the tip; without it, points of the surface',
        ),
        "rake": Option(
            "angle",
            help='of the face in which the nose radius is measured, "-30 deg"; needs sense',
        ),
        "window": Option(
            "angle", help='angle of the nose that is sharp, symmetric about the tip, "60 deg"'
        ),
        "radius_in": Option(
            "text",
            choices=("face", "projection"),
            help="whether nose_radius is that in the rake face or of the view along the cut, as certified",
        ),
        "yaw": Option("angle", help="turn of the rake face about z, counter-clockwise from +z"),
        "edge": Option(
            "file",
            help="measured waviness of the edge, which a path made here makes up for: columns psi_deg from the tip, "
            "deviation_nm outward",
        ),
        "edge_rises": Option(
            "text",
            choices=("outwards", "inwards"),
            help="where psi of that file grows to: away from the spindle axis or towards it",
        ),
        "clearance": Option("angle", help="angle between flank and cut surface"),
        "flank": Option(
            "text", choices=("conical", "cylindrical"), help="how the clearance is ground"
        ),
        "servo": Option(
            "text",
            choices=("Z", "XZ"),
            help="what follows the surface: Z alone, or X and Z so that contacts lie on the spiral",
        ),
        "part": Option(
            "file",
            help="map of the part as cut with the nominal path: it tells dx, dy, dR, and the program makes up "
            "for them",
        ),
        "centre": Option("lengths", help=OF_PART),
        "part_free": Option(
            "texts", help="what that map tells, dx,dy,dR (yaw, rake too); piston and tilt always"
        ),
        "follow_up": Option("file", help="file with the log of the dry run of this part"),
        "log_time": Option("text", help="column of the log, t_s if omitted"),
        "log_command": Option("text", help="column of the log, command_um if omitted"),
        "log_actual": Option("text", help="column of the log, actual_um if omitted"),
        "log_x_command": Option(
            "text",
            help="column of that log with the command of X, the radius, and log_x_actual with where it was: with "
            "servo = XZ the program makes up for X too",
        ),
        "log_x_actual": Option("text", help="column of that log with the radius that was reached"),
        "follow_up_pv": Option(
            "uncertainty", help='P-V of the follow-up error, where there is no log, "5 nm"'
        ),
        "gain": Option("number", help="share of a known error that the program makes up for, 1"),
        "removed": Option(
            "text",
            help="freedoms that an alignment takes out of the predicted form, names with commas",
        ),
        "measured": Option("uncertainty", help='P-V of the part as cut, to compare, "8 nm"'),
        **LIMITS,
        **TRAVEL,
    }

    @classmethod
    def from_inputs(cls, data: Any, options: Mapping[str, Any]) -> JobResult:
        """Return what the step makes."""
        from metrosep.process import ToolSetting, TurningJob

        rest = {**options, "rpm": _turns_per_minute(options["rpm"])}
        _check_predict(rest)
        form, found = surface_of(rest)
        job = TurningJob(
            form,
            rest["radius"],
            rest["feed"],
            rpm=rest["rpm"],
            block_time=rest.get("block_time", 0.0),
            core=rest.get("core", 0.0),
            sense=rest.get("sense"),
            nose=_nose(rest),
            **{k: rest[k] for k in TRAVEL if k in rest},
        )
        tool = None
        setting = {k: rest[k] for k in SETTING if k in rest}
        if setting:
            tool = ToolSetting(**setting)
        if "part" in rest:
            job, tool, told = _told_by_part(job, rest, tool)
            found = (*found, *told)
        plan, path = _path(job, rest)
        log, log_x = _logged(rest, job)
        removed = tuple(v.strip() for v in rest.get("removed", "").split(",") if v.strip())
        servo = rest.get("servo", "Z")
        prediction = job.predict(
            path, tool=tool, follow_up=log, follow_up_x=log_x, removed=removed, servo=servo
        )
        known = None if isinstance(log, float) else log
        doubts: tuple[str, ...] = ()
        if known is not None and (doubt := _other_surface(job, rest)):
            doubts, known, log_x = (doubt,), None, None
        if log_x is not None and servo != "XZ":
            doubts, log_x = (*doubts, _X_STAYS), None
        program = None
        if tool is not None or known is not None or job.nose is not None:
            gain = float(rest.get("gain", 1.0))
            program = job.compensated(
                path, tool=tool, follow_up=known, follow_up_x=log_x, gain=gain, servo=servo
            )
            _clears(job, rest)
        motion = None
        limits, course = limits_of(rest), program
        if program is None and (limits or any(k in rest for k in TRAVEL)):
            course = job.program(path, cut_points=True)
        if limits and course is not None:
            from metrosep.process import axis_motion

            motion = axis_motion(course, limits, block_time=job.block_time)
        history = getattr(log, "history", ())
        return JobResult(
            plan,
            prediction,
            rest.get("measured"),
            program,
            path,
            _allowed(job, plan),
            history,
            doubts,
            job.form,
            job.nose,
            tool,
            found,
            motion,
        )


def _nose(rest: Mapping[str, Any]) -> Any:
    """Return the nose of the tool, or None where its radius is not given."""
    from metrosep.process import RoundNose

    if "nose_radius" not in rest:
        if also := [k for k in _OF_NOSE if k in rest]:
            raise DataError(f"{also[0]} belongs to a nose; give its radius: nose_radius")
        return None
    nose = RoundNose(rest["nose_radius"], **{k: rest[k] for k in _NOSE if k in rest})
    if "edge" not in rest:
        if "edge_rises" in rest:
            raise DataError(NO_EDGE)
        return nose
    return replace(nose, edge=edge_of_file(rest["edge"], rest.get("edge_rises")))


NO_EDGE = "edge_rises belongs to the file of a certificate: give it, edge"


def centre_of(options: Mapping[str, Any]) -> tuple[float, float] | None:
    """Return where the spindle axis is on the map of a part, None where that is not given."""
    if "centre" not in options:
        return None
    if "part" not in options:
        raise DataError("centre is the axis on the map of a part: give that, part")
    if len(options["centre"]) != 2:
        raise DataError(f"centre is two lengths, got {len(options['centre'])}")
    return (options["centre"][0], options["centre"][1])


def columns_in_units(path: str, *usual: str) -> dict[str, Any]:
    """Return columns of a file in SI by their bare names, each in the unit that its header states."""
    from metrosep.io.role_columns import Role, read_roles
    from metrosep.io.runs import columns_of
    from metrosep.io.source import open_file

    _, table, _ = columns_of(open_file(path), {})
    roles = {}
    for header in usual:
        name, unit = column_unit(header)
        same = [n for n in table.names if column_unit(n)[0].lower() == name.lower()]
        if len(same) > 1:
            raise DataError(
                f"{path}: {' and '.join(same)} are the same column in two units: keep one of them"
            )
        roles[name] = Role(same[0] if same else header, unit.dimension if unit else "any")
    return dict(read_roles([path], roles).values)


def edge_of_file(path: str, rises: str | None) -> Any:
    """Return the `EdgeProfile` of a file of a certificate, its circle taken off."""
    from metrosep.process import EdgeProfile

    if rises is None:
        raise DataError(
            'edge_rises says where psi grows to: "outwards" (away from the spindle axis) or "inwards"; plots '
            "run from left to right on the rake face, which is either"
        )
    found = columns_in_units(path, "psi_deg", "deviation_nm")
    return EdgeProfile.from_certificate(found["psi"], found["deviation"], rises=rises)  # type: ignore[arg-type]  # checked there


SETTING = ("dx", "dy", "dR", "u_dx", "u_dy", "u_dR")
_NOSE = ("rake", "window", "clearance", "flank", "yaw", "radius_in")
_LOG_OF_X = {"command": "log_x_command", "actual": "log_x_actual"}
"""Channels of X and the keys that name their columns."""
_OF_NOSE = (*_NOSE, "edge", "edge_rises", "servo", "part", "centre")
"""Keys that mean something with a nose only."""


def _clears(job: Any, rest: Mapping[str, Any]) -> None:
    """Refuse a flank that rubs, where its clearance is known."""
    from metrosep.process import clearance_check

    if "clearance" in rest:
        travel = "falling" if job.sense == "clockwise" else "growing"
        way: Any = travel if job.sense is not None else "both"
        clearance_check(job.form, job.nose, travel=way, region=(job.core, job.radius)).require()


def map_of(path: str, key: str) -> Surface:
    """Return the map that a file holds."""
    from metrosep.io.read import read

    found = read(path)
    if not isinstance(found, Surface):
        raise DataError(
            f"{key}: {path} holds a {type(found).__name__}, and a map is needed: give the map of the part around "
            "the axis (heights over x and y), not one section"
        )
    return found


def _told_by_part(
    job: Any, rest: Mapping[str, Any], tool: Any
) -> tuple[Any, Any, tuple[str, ...]]:
    """Return the job with the tool that a measured part tells of, its setting, and what was found."""
    from metrosep.process import identify_edge

    if tool is not None:
        raise DataError("part tells the setting of the tool: leave dx, dy and dR out, or part")
    measured = map_of(rest["part"], "part")
    free = tuple(rest.get("part_free", ("dx", "dy", "dR")))
    fit = identify_edge(
        measured,
        job.form,
        nose=job.nose,
        sense=job.sense,
        free=("piston", "tilt_x", "tilt_y", *free),
        centre=centre_of(rest),
        region=(max(job.core, 0.02 * job.radius) + job.feed, job.radius - job.feed),
    )
    texts = []
    for name in free:
        value, u = fit.values[name], fit.u[name]
        if name in ("yaw", "rake"):
            texts.append(f"{name} {np.degrees(value):.4g} deg, u {np.degrees(u):.2g} deg")
        else:
            texts.append(f"{name} {format_length(value)}, u {format_length(u)}")
    text = (
        f"the measured part tells: {'; '.join(texts)}. They explain {100 * fit.explained:.3g} % of its "
        f"variance; {format_length(fit.residual)} RMS is left, cusps and noise included"
    )
    return replace(job, nose=fit.nose), fit.setting, (text, *fit.messages)


_ALIKE = 0.2
"""RMS of the log's command minus the surface on the spiral, over the RMS of the surface. A nose that
is made up for, a filter or a start some degrees off stay below; another surface gives 1 or more."""


def _other_surface(job: Any, rest: Mapping[str, Any]) -> str:
    """Return why the command of a log is not the surface of the job; empty where it is."""
    data = _log_columns(rest)
    t, command = (np.asarray(data.values[k]) for k in ("time", "command"))
    turn = 2.0 * np.pi * job.rpm / 60.0 * (t - t[0])
    rho = job.radius - job.feed * turn / (2.0 * np.pi)
    azimuth = -turn if job.sense == "clockwise" else turn
    nominal = job.form.height(rho * np.cos(azimuth), rho * np.sin(azimuth))
    on_part = (rho >= 0.0) & np.isfinite(nominal) & np.isfinite(command)
    if not on_part.any():
        return ""
    surface = nominal[on_part] - nominal[on_part].mean()
    order = command[on_part] - command[on_part].mean()
    size = float(np.sqrt(np.mean(surface**2)))
    off, turned = (float(np.sqrt(np.mean((order + s * surface) ** 2))) for s in (-1.0, 1.0))
    if off <= _ALIKE * size:
        return ""
    if turned <= _ALIKE * size:
        why = (
            "the command of the log runs against the surface: its Z points into the material, and "
            "its follow-up error has the other sign; log it with Z out of the material"
        )
    else:
        why = (
            "the command of the log is not this surface along the spiral (RMS of the difference "
            f"{format_length(off)}, of the surface {format_length(size)}): the log is of another "
            "part, does not begin at the rim at azimuth 0, or has another speed or sense"
        )
    return (
        f"{why}. The program is NOT corrected by the log, and its map in the budget is uncertain"
    )


def _check_predict(rest: Mapping[str, Any]) -> None:
    """Refuse keys that say nothing together, and a setting that cuts nothing."""
    if not rest["rpm"] > 0.0:
        raise DataError(f"rpm must be above zero, got {rest['rpm']:g}")
    if abs(rest.get("dy", 0.0)) >= rest["radius"]:
        raise DataError(
            f"dy = {format_length(rest['dy'])}: nothing nearer than that to the spindle axis is cut, "
            f"and the part ends at {format_length(rest['radius'])}"
        )
    log = [k for k in ("log_time", "log_command", "log_actual", *_LOG_OF_X.values()) if k in rest]
    if log and "follow_up" not in rest:
        raise DataError(f"{log[0]} names a column of a log; give its file: follow_up")
    if "gain" in rest and not any(k in rest for k in (*SETTING, "follow_up")):
        raise DataError(
            "gain is the share of a known error that the program makes up for; give the tool setting "
            "(dx, dy, dR) or the log of the dry run (follow_up)"
        )


def _allowed(job: Any, plan: Any) -> Any:
    """Return the tolerances of the setting that match the one of the program, if there is one."""
    from metrosep.process import setting_tolerance

    if plan is None:
        return None
    inner = max(job.core, 0.01 * job.radius)
    return setting_tolerance(job.form, plan.points.tolerance, region=(inner, job.radius))


def _path(job: Any, rest: Mapping[str, Any]) -> tuple[Any, Any]:
    """Return the plan of a tolerance, or the path of a step."""
    common = {k: rest[k] for k in ("distribution", "interpolation", "lead_in") if k in rest}
    follows = {"servo": rest["servo"]} if "servo" in rest else {}
    steps = [k for k in ("tolerance", "angle_step", "length_step") if k in rest]
    if len(steps) != 1:
        raise DataError(
            "give one of tolerance, angle_step (constant angle) and length_step (constant arc "
            f"length); got {', '.join(steps) or 'none'}"
        )
    if "tolerance" in rest:
        plan = job.plan(rest["tolerance"], **common, **follows)
        return plan, plan.path
    usual = "CA" if "angle_step" in rest else "CAL"
    if common.setdefault("distribution", usual) != usual:
        raise DataError(f"{steps[0]} belongs to the distribution {usual}")
    return None, job.path(step=rest[steps[0]], **common, **follows)


_X_STAYS = 'the program is NOT corrected for what X does: with servo = "Z" X follows nothing; take servo = "XZ"'


def _logged(rest: Mapping[str, Any], job: Any) -> tuple[Any, Any]:
    """Return the follow-up errors of Z and X: of a log file, or a P-V (of Z), or None."""
    if "follow_up" in rest and "follow_up_pv" in rest:
        raise DataError(
            "give the log of the dry run (follow_up) or its P-V (follow_up_pv), not both"
        )
    if "follow_up_pv" in rest:
        return float(rest["follow_up_pv"]), None
    if "follow_up" not in rest:
        return None, None
    given = [k for k in _LOG_OF_X.values() if k in rest]
    if len(given) == 1:
        raise DataError(
            f"{given[0]} is one of two columns of X: give both, {' and '.join(_LOG_OF_X.values())}"
        )
    from metrosep.process import FollowUpMap, follow_up

    data = _log_columns(rest)
    speed, sense = 2.0 * np.pi * job.rpm / 60.0, job.sense or "counterclockwise"
    log = _recording(data, command="command", actual="actual")
    found = follow_up(log, spiral=(job.radius, job.feed, speed), spiral_sense=sense)
    if not given:
        return found, None
    # an error of X has no motion that explains it, for X may go in evenly: the places are all
    t, command, actual = (np.asarray(data.values[k]) for k in ("time", "x_command", "x_actual"))
    angle = speed * (t - t[0])
    rho, turn = (
        job.radius - job.feed * angle / (2.0 * np.pi),
        -1.0 if sense == "clockwise" else 1.0,
    )
    return found, FollowUpMap(rho, turn * angle, actual - command, data.history)


def _log_columns(rest: Mapping[str, Any]) -> RoleColumns:
    """Return time, command and actual position of the log of a dry run, those of X if they are named."""
    from metrosep.io.role_columns import Role, read_roles

    roles = {
        name: Role(rest.get(f"log_{name}", usual), kind)
        for name, usual, kind in (
            ("time", "t_s", "time"),
            ("command", "command_um", "length"),
            ("actual", "actual_um", "length"),
        )
    }
    roles |= {
        f"x_{k}": Role(rest[name], "length") for k, name in _LOG_OF_X.items() if name in rest
    }
    return read_roles([rest["follow_up"]], roles)


def _turns_per_minute(value: Any) -> float:
    """Return a spindle speed in turns per minute: a number, or a text such as ``30 rpm``."""
    text = re.sub(r"\s*(rpm|1/min|/min)$", "", str(value).strip())
    try:
        turns = np.nan if isinstance(value, bool) else float(text)
    except ValueError:
        turns = np.nan
    if not np.isfinite(turns):
        raise DataError(f"rpm = {value!r} is not a number of turns per minute; give rpm = 20")
    return turns
