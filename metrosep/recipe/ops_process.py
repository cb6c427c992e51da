"""Steps of recipes with models of the process: tool setting, follow-up error, flexure, prediction."""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from metrosep.core.errors import DataError
from metrosep.core.inputs import RoleColumns
from metrosep.core.provenance import Step
from metrosep.core.recording import Recording
from metrosep.core.surface import Surface
from metrosep.core.units import format_length
from metrosep.recipe.method import OP, Method
from metrosep.recipe.ops_machine import form_of
from metrosep.recipe.schema import Field

__all__ = ["PROCESSES", "JobResult"]


def _tool_setting(maps: tuple[Surface, ...], options: Mapping[str, Any]) -> Any:
    from metrosep.process import identify_setting

    rest = dict(options)
    form = form_of(rest.pop("form"))
    for key in ("centre", "region"):
        if key in rest:
            if len(rest[key]) != 2:
                raise DataError(f"{key} is two lengths, got {len(rest[key])}")
            rest[key] = tuple(rest[key])
    if len(maps) != 1:
        raise DataError(f"one map is needed, got {len(maps)}; take them one by one")
    return identify_setting(maps[0], form, **rest)


def _recording(data: RoleColumns, **channels: str) -> Recording:
    """Return columns as a recording; the channels keep the names of their roles."""
    values = {name: np.asarray(data.values[role]) for name, role in channels.items()}
    return Recording(np.asarray(data.values["time"]), values, history=data.history)


def _follow_up(data: RoleColumns, options: Mapping[str, Any]) -> Any:
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


def _flexure(data: RoleColumns, options: Mapping[str, Any]) -> Any:
    from metrosep.process import flexure_calibration

    n = data.values["displacement"].size
    time = data.values.get("time", np.arange(float(n)))
    log = Recording(
        time,
        {"voltage": data.values["voltage"], "displacement": data.values["displacement"]},
        history=data.history,
    )
    return flexure_calibration(log, **dict(options))


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

    @property
    def messages(self) -> tuple[str, ...]:
        """What to know."""
        plan = () if self.plan is None else self.plan.points.messages
        program = () if self.program is None else self.program.messages
        unshaped = ", ".join(self.prediction.budget.without_map)
        sums = (
            (f"{unshaped} is known as a P-V only: the maps cannot be added",) if unshaped else ()
        )
        return tuple(
            dict.fromkeys((*self.doubts, *plan, *self.prediction.messages, *sums, *program))
        )


def _predict(_: Any, options: Mapping[str, Any]) -> JobResult:
    from metrosep.process import ToolSetting, TurningJob

    rest = {**options, "rpm": _turns_per_minute(options["rpm"])}
    _check_predict(rest)
    job = TurningJob(
        form_of(rest["form"]),
        rest["radius"],
        rest["feed"],
        rpm=rest["rpm"],
        block_time=rest.get("block_time", 0.0),
        core=rest.get("core", 0.0),
        sense=rest.get("sense"),
        nose=_nose(rest),
    )
    plan, path = _path(job, rest)
    tool = None
    setting = {k: rest[k] for k in ("dx", "dy", "dR", "u_dx", "u_dy", "u_dR") if k in rest}
    if setting:
        tool = ToolSetting(**setting)
    log = _logged(rest, job)
    removed = tuple(v.strip() for v in rest.get("removed", "").split(",") if v.strip())
    prediction = job.predict(path, tool=tool, follow_up=log, removed=removed)
    known = None if isinstance(log, float) else log
    doubts: tuple[str, ...] = ()
    if known is not None and (doubt := _other_surface(job, rest)):
        doubts, known = (doubt,), None
    program = None
    if tool is not None or known is not None or job.nose is not None:
        gain = float(rest.get("gain", 1.0))
        program = job.compensated(path, tool=tool, follow_up=known, gain=gain)
    history = getattr(log, "history", ())
    return JobResult(
        plan, prediction, rest.get("measured"), program, path, _allowed(job, plan), history, doubts
    )


def _nose(rest: Mapping[str, Any]) -> Any:
    """Return the nose of the tool, or None where its radius is not given."""
    from metrosep.process import RoundNose

    if "nose_radius" not in rest:
        if also := [k for k in ("rake", "window") if k in rest]:
            raise DataError(f"{also[0]} belongs to a nose; give its radius: nose_radius")
        return None
    return RoundNose(rest["nose_radius"], rest.get("rake", 0.0), window=rest.get("window"))


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
    return f"{why}. The program is NOT corrected by the log, and its map in the budget is doubtful"


def _check_predict(rest: Mapping[str, Any]) -> None:
    """Refuse keys that say nothing together, and a setting that cuts nothing."""
    if not rest["rpm"] > 0.0:
        raise DataError(f"rpm must be above zero, got {rest['rpm']:g}")
    if abs(rest.get("dy", 0.0)) >= rest["radius"]:
        raise DataError(
            f"dy = {format_length(rest['dy'])}: nothing nearer than that to the spindle axis is cut, "
            f"and the part ends at {format_length(rest['radius'])}"
        )
    log = [k for k in ("log_time", "log_command", "log_actual") if k in rest]
    if log and "follow_up" not in rest:
        raise DataError(f"{log[0]} names a column of a log; give its file: follow_up")
    known = ("dx", "dy", "dR", "u_dx", "u_dy", "u_dR", "follow_up")
    if "gain" in rest and not any(k in rest for k in known):
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
    steps = [k for k in ("tolerance", "angle_step", "length_step") if k in rest]
    if len(steps) != 1:
        raise DataError(
            "give one of tolerance, angle_step (constant angle) and length_step (constant arc "
            f"length); got {', '.join(steps) or 'none'}"
        )
    if "tolerance" in rest:
        plan = job.plan(rest["tolerance"], **common)
        return plan, plan.path
    usual = "CA" if "angle_step" in rest else "CAL"
    if common.setdefault("distribution", usual) != usual:
        raise DataError(f"{steps[0]} belongs to the distribution {usual}")
    return None, job.path(step=rest[steps[0]], **common)


def _logged(rest: Mapping[str, Any], job: Any) -> Any:
    """Return the follow-up error: of a log file, or a P-V, or None."""
    if "follow_up" in rest and "follow_up_pv" in rest:
        raise DataError(
            "give the log of the dry run (follow_up) or its P-V (follow_up_pv), not both"
        )
    if "follow_up_pv" in rest:
        return float(rest["follow_up_pv"])
    if "follow_up" not in rest:
        return None
    from metrosep.process import follow_up

    data = _log_columns(rest)
    turn = -1.0 if job.sense == "clockwise" else 1.0
    speed = 2.0 * np.pi * job.rpm / 60.0
    log = _recording(data, command="command", actual="actual")
    found = follow_up(log, spiral=(job.radius, job.feed, speed))
    if turn < 0.0 and found.map is not None:
        from metrosep.process import FollowUpMap

        return FollowUpMap(found.map.rho, -found.map.theta, found.map.z, found.map.history)
    return found


def _log_columns(rest: Mapping[str, Any]) -> RoleColumns:
    """Return time, command and actual position of the log of a dry run."""
    from metrosep.io.runs import Role, read_roles

    roles = {
        name: Role(rest.get(f"log_{name}", usual), kind)
        for name, usual, kind in (
            ("time", "t_s", "time"),
            ("command", "command_um", "length"),
            ("actual", "actual_um", "length"),
        )
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
        raise DataError(f"rpm = {value!r} is no number of turns per minute; give rpm = 20")
    return turns


PROCESSES: Mapping[str, Method] = {
    "tool_setting": Method(
        "errors of the tool setting (dx, dy, nose radius) that explain a turned part",
        "maps",
        ("map",),
        {
            **OP,
            "form": Field("text", required=True),
            "free": Field("texts"),
            "nose_radius": Field("size"),
            "centre": Field("lengths"),
            "region": Field("lengths"),
            "noise": Field("size"),
        },
        _tool_setting,
    ),
    "follow_up": Method(
        "follow-up error of an axis from its log, and what it depends on",
        "table",
        (),
        {
            **OP,
            "terms": Field("texts"),
            "delay": Field("time"),
            "estimate_delay": Field("flag"),
            "window": Field("integer"),
            "error_sign": Field("text", choices=("actual-command", "command-actual")),
            "spiral": Field("lengths"),
            "rpm": Field("any"),
        },
        _follow_up,
        roles={
            "time": "time",
            "command": "length?",
            "actual": "length?",
            "error": "length?",
            "rho": "length?",
            "theta": "angle?",
        },
    ),
    "flexure_calibration": Method(
        "displacement of a flexure stage over its voltage: sensitivity, hysteresis, inverse",
        "table",
        (),
        {
            **OP,
            "line": Field("text", choices=("least-squares", "end-point")),
            "resolution": Field("uncertainty"),
        },
        _flexure,
        roles={"voltage": "any", "displacement": "length", "time": "time?"},
    ),
    "predict": Method(
        "form error of a turned freeform before it is cut, cause by cause",
        "nothing",
        (),
        {
            **OP,
            "form": Field("text", required=True),
            "radius": Field("size", required=True),
            "feed": Field("size", required=True),
            "rpm": Field("any", required=True),
            "block_time": Field("time"),
            "core": Field("size"),
            "sense": Field("text", choices=("counterclockwise", "clockwise")),
            "tolerance": Field("size"),
            "angle_step": Field("angle"),
            "length_step": Field("size"),
            "distribution": Field("text", choices=("CA", "CAL")),
            "interpolation": Field("text", choices=("linear", "spline")),
            "lead_in": Field("integer"),
            "dx": Field("length"),
            "dy": Field("length"),
            "dR": Field("length"),
            "u_dx": Field("uncertainty"),
            "u_dy": Field("uncertainty"),
            "u_dR": Field("uncertainty"),
            "nose_radius": Field("size"),
            "rake": Field("angle"),
            "window": Field("angle"),
            "follow_up": Field("file"),
            "log_time": Field("text"),
            "log_command": Field("text"),
            "log_actual": Field("text"),
            "follow_up_pv": Field("uncertainty"),
            "gain": Field("number"),
            "removed": Field("text"),
            "measured": Field("uncertainty"),
        },
        _predict,
    ),
}
