"""Steps of recipes about a program file: its error budget on the cut surface, what its axes must do.

And the hysteresis of the stage that drives a fast tool: identified from loops, inverted for a course.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import Any, ClassVar

import numpy as np

from metrosep.controllers.gcode.lathe import LatheAxes
from metrosep.core.errors import DataError
from metrosep.core.methods import Method, RoleColumns
from metrosep.core.options import Option, options_of
from metrosep.core.units import format_length, parse_quantity
from metrosep.recipe.methods.axis_limits import LIMITS, limits_of
from metrosep.recipe.methods.ops_machine import MACHINE, errors_of, machine_of
from metrosep.recipe.methods.ops_process import (
    NO_EDGE,
    OF_PART,
    SETTING,
    STAGE,
    SURFACE,
    JobPredicted,
    centre_of,
    columns_in_units,
    edge_of_file,
    map_of,
    stage_log,
    surface_of,
)

_AXES = options_of(LatheAxes)
_PROGRAM: Mapping[str, Option] = {
    "program": Option(
        "file", required=True, help="program of the tip: G-code, PVT or a list of points"
    ),
    **_AXES,
    "velocity_time": Option("time", help="unit of time of a PMAC's velocities (Ix90)"),
    "joined_by": Option(
        "text",
        choices=("linear", "spline"),
        help="what the control makes of a list of points whose head does not say",
    ),
}
_EDGE = ("edge", "edge_rises")
_TOOL = ("nose_radius", "rake", "window", "radius_in", "yaw")
_PIXELS = 61


def _program_of(options: Mapping[str, Any]) -> tuple[Any, LatheAxes]:
    """Return the program of a file, and the axes of the machine."""
    from metrosep.controllers.gcode.turning_reader import read_program

    axes = LatheAxes(**{k: v for k, v in options.items() if k in _AXES})
    words = {
        "interpolation": options.get("joined_by"),
        "velocity_time": options.get("velocity_time"),
    }
    return read_program(options["program"], axes, **words), axes


# ---- budget on the cut surface ----------------------------------------------------------------------


@dataclass(frozen=True, slots=True)
class CutBudgetFound:
    """The budget of a program file, and what a measured part shows of it."""

    budget: Any  # CutBudget
    x: Any  # m, places
    y: Any
    pixel: float  # m, of the places where they are a grid; 0 where they are those of a part
    shown: Any = None  # CauseFit
    said: tuple[str, ...] = ()

    @property
    def messages(self) -> tuple[str, ...]:
        """What to know."""
        return (*self.said, *self.budget.messages, *(self.shown.messages if self.shown else ()))


class CutBudgeted(Method):
    """`cut_budget` by its name."""

    name: ClassVar[str] = "cut_budget"
    what: ClassVar[str] = (
        "error of the part that a program file cuts, cause by cause, and which of them a part shows"
    )
    reads: ClassVar = "nothing"
    arguments: ClassVar[Mapping[str, Option]] = {
        **_PROGRAM,
        **{n: JobPredicted.arguments[n] for n in (*SURFACE, *_TOOL, *_EDGE, *SETTING)},
        "log": Option(
            "file",
            help="what the axes did beside their command: columns t_s, X_um (of the radius, as the axis "
            "points), C_deg, Z_um (or other units), actual minus commanded",
        ),
        **{n: Option(o.kind, choices=o.choices, help=o.help) for n, o in MACHINE.items()},
        "errors": Option(
            "table",
            help='terms of that machine, each a cause, { EZC = "table ezc.csv", EYX = "0.3 um", u_EYX = "50 nm" }',
        ),
        "part": Option("file", help="map of a part that was cut with the program"),
        "centre": Option("lengths", help=OF_PART),
    }

    @classmethod
    def from_inputs(cls, data: Any, options: Mapping[str, Any]) -> CutBudgetFound:
        """Return what the step makes."""
        from metrosep.process import RoundNose, ToolSetting, cut_budget
        from metrosep.process.cutting.measured_parts import drawn_points, fit_causes
        from metrosep.process.cutting.virtual_part import touched_radii

        if "nose_radius" not in options:
            raise DataError("a part is cut by a tool: give its nose_radius")
        program, axes = _program_of(options)
        words = {k: options[k] for k in _TOOL if k in options and k != "nose_radius"}
        nose = RoundNose(options["nose_radius"], **words)
        actual = None
        said = program.messages
        if "edge_rises" in options and "edge" not in options:
            raise DataError(NO_EDGE)
        if "edge" in options:
            profile = edge_of_file(options["edge"], options.get("edge_rises"))
            actual, said = replace(nose, edge=profile), (*said, *profile.messages)
        setting = {k: options[k] for k in SETTING if k in options}
        form, notes = surface_of(options)
        said = (*said, *notes)
        low, high = touched_radii(program, nose, form)
        pixel, z, centre = 0.0, None, centre_of(options)
        if "part" in options:
            x, y, z, notes = drawn_points(
                map_of(options["part"], "part"), (low, high), 1500, 0, centre
            )
            said = (*said, *notes)
        else:
            pixel = 2.0 * high / (_PIXELS - 1)
            axis = np.linspace(-high, high, _PIXELS)
            x, y = np.meshgrid(axis, axis)
        rho = np.hypot(x, y)
        inside = (rho >= low) & (rho <= high) & np.isfinite(form(x, y))
        x, y = x[inside], y[inside]
        deviation = {"follow-up": _deviation(options["log"], axes)} if "log" in options else {}
        moved, notes = _machine(options, program, axes)
        deviation |= moved
        said = (*said, *notes)
        budget = cut_budget(
            program, nose, x, y,
            form=form,
            actual=actual,
            setting=ToolSetting(**setting) if setting else None,
            deviation=deviation,
        )  # fmt: skip
        shown = None
        if z is not None:
            z = z[inside]
            shown = fit_causes(budget, z - form(x, y), x, y)
            if not shown.shows("program"):
                said = (*said, _OTHER_PROGRAM)
            if not shown.is_plausible:
                said = (*said, *_other_orientation(shown.residual, form, x, y, z))
        return CutBudgetFound(budget, x, y, pixel, shown, said)


def _machine(
    options: Mapping[str, Any], program: Any, axes: LatheAxes
) -> tuple[dict[str, Any], tuple[str, ...]]:
    """Return what error terms of a machine do to the tip, by their names, and how names were read."""
    from metrosep.machine import ErrorSet
    from metrosep.machine.ranking import curve_text
    from metrosep.process import machine_deviations

    rest = {k: options[k] for k in (*MACHINE, "errors") if k in options}
    if "machine" not in rest:
        if rest:
            raise DataError(f"{min(rest)} belongs to a machine: give it, machine")
        return {}, ()
    chain = machine_of(rest, float(program.X.max()))
    for name, value in rest.get("errors", {}).items():
        if isinstance(value, str) and curve_text(value):
            raise DataError(
                f"{name} = {value!r} is a wave whose phase nobody knows: it ranks terms, and cuts no part that "
                f'could be compared; give the curve, {name} = "table {name.lower()}.csv"'
            )
    named = rest.get("errors", {})
    rest["errors"] = {k: v for k, v in named.items() if not k.startswith("u_")}
    us = {k.removeprefix("u_"): v for k, v in named.items() if k.startswith("u_")}
    errors, notes = errors_of(chain, rest)
    way = -1.0 if axes.tool_side == "-X" else 1.0
    positions = {"X": way * program.X, "Z": program.Z, "C": axes.c_of(program.azimuth)}
    return machine_deviations(program, chain, ErrorSet(errors, u=us), positions=positions), notes


_OTHER_PROGRAM = (
    "the part does not show what this file makes of the form, which every part cut with it does: look at "
    "c_positive, tool_side and c_zero (a wrong way of C reads a mirrored part), at the form, and whether the "
    "part was cut with this file"
)
_ORIENTATIONS = {
    "mirrored in x": (-1.0, 1.0),
    "mirrored in y": (1.0, -1.0),
    "turned by 180 degrees": (-1.0, -1.0),
}
_FAR_LESS = 0.5
"""Of the RMS that is left: another orientation that is nearer to the form than that is named."""


def _other_orientation(left: float, form: Any, x: Any, y: Any, z: Any) -> tuple[str, ...]:
    """Return what to say where a mirrored or turned map is nearer to the form than causes explain."""
    plane = np.column_stack([np.ones(x.size), x, y])
    off = {}
    for words, (a, b) in _ORIENTATIONS.items():
        error = z - form(a * x, b * y)
        if np.isfinite(error).all():
            error = error - plane @ np.linalg.lstsq(plane, error, rcond=None)[0]
            off[words] = float(np.sqrt(np.mean(error**2)))
    best = min(off.values(), default=left)
    if best > _FAR_LESS * left:
        return ()
    # two of them that differ by a tilt only are equally good
    ways = " or ".join(w for w, v in off.items() if _FAR_LESS * v <= best)
    text = (
        f"{ways}, the map would be off the form by {format_length(best)} RMS, and as it is the causes leave "
        f"{format_length(left)}: look at the orientation in which it was measured or exported"
    )
    return (text,)


def _deviation(path: str, axes: LatheAxes) -> Any:
    """Return what the axes did beside their command, of a file."""
    from metrosep.process import PathDeviation

    found = columns_in_units(path, "t_s", "X_um", "C_deg", "Z_um")
    outward = -1.0 if axes.tool_side == "-X" else 1.0
    return PathDeviation(found["t"], outward * found["X"], axes.way * found["C"], found["Z"])


# ---- what the axes must do --------------------------------------------------------------------------


class AxesMoved(Method):
    """`axis_motion` by its name."""

    name: ClassVar[str] = "axis_motion"
    what: ClassVar[str] = "velocity, acceleration and jerk that a program file asks of X, C and Z"
    reads: ClassVar = "nothing"
    arguments: ClassVar[Mapping[str, Option]] = {
        **_PROGRAM,
        **LIMITS,
        "block_time": Option("time", help='that the controller needs for a block, "2 ms"'),
    }

    @classmethod
    def from_inputs(cls, data: Any, options: Mapping[str, Any]) -> Any:
        """Return what the step makes."""
        from metrosep.process import axis_motion

        program, _ = _program_of(options)
        found = axis_motion(program, limits_of(options), block_time=options.get("block_time", 0.0))
        return replace(found, messages=(*program.messages, *found.messages))


# ---- hysteresis of the stage ------------------------------------------------------------------------


@dataclass(frozen=True, slots=True)
class HysteresisFound:
    """A stage as its loops tell it, and the voltages of a course."""

    fit: Any  # HysteresisFit
    drives: Any = None  # DriveResiduals
    wanted: Any = None  # m, course
    said: tuple[str, ...] = field(default=())

    @property
    def messages(self) -> tuple[str, ...]:
        """What to know."""
        return (*self.said, *self.fit.messages, *(self.drives.messages if self.drives else ()))


class HysteresisIdentified(Method):
    """`hysteresis` by its name."""

    name: ClassVar[str] = "hysteresis"
    what: ClassVar[str] = (
        "hysteresis of a stage from its loops, and the voltages that make up for it"
    )
    reads: ClassVar = "table"
    roles: ClassVar[Mapping[str, str]] = STAGE
    arguments: ClassVar[Mapping[str, Option]] = {
        "threshold_spacing": Option(
            "number", help="between thresholds, V; a fortieth of the range if omitted"
        ),
        "course": Option(
            "file",
            help="displacements to be driven, in order of time: column displacement_um (or another unit)",
        ),
        "history": Option(
            "texts",
            help="voltages that the stage has seen before the course, from never driven on, within the range of "
            "the loops: 0,10,0 (V, or with a unit); none for a stage never driven",
        ),
    }

    @classmethod
    def from_inputs(cls, data: RoleColumns, options: Mapping[str, Any]) -> HysteresisFound:
        """Return what the step makes."""
        from metrosep.process import PrandtlIshlinskii, compare_drives, flexure_calibration

        log = stage_log(data)
        fit = PrandtlIshlinskii.identify(log, spacing=options.get("threshold_spacing"))
        if "course" not in options:
            if "history" in options:
                raise DataError("history belongs to a course: give the file of displacements")
            return HysteresisFound(fit)
        if "history" not in options:
            raise DataError(
                "the voltages of a course depend on what the stage has seen before: give history, such as "
                '"0,10,0" for a conditioning cycle, or "none" for a stage never driven'
            )
        wanted = columns_in_units(options["course"], "displacement_um")["displacement"]
        history = _voltages(options["history"], data.values["voltage"])
        drives = compare_drives(wanted, fit.model, flexure_calibration(log), history=history)
        off = fit.rms if np.isnan(fit.worst_left_out) else fit.worst_left_out
        said = (
            "what is left on the course is by the model, which the inverse undoes; the model itself is off by "
            f"{format_length(off)} on {'its loops (RMS)' if off == fit.rms else 'the loop that was not used'}: expect that"
        )
        return HysteresisFound(fit, drives, wanted, (said,))


_BEYOND = 0.01
"""Of the range of the loops: by so much a logged voltage differs from the one that was set."""


def _voltages(texts: tuple[str, ...], loops: Any) -> tuple[float, ...]:
    """Return voltages that were typed, within the range of the loops."""
    each = [t.strip() for text in texts for t in text.split(",")]
    if each == ["none"]:
        return ()
    found = tuple(
        parse_quantity(t if t[-1:].isalpha() else f"{t} V", dimension="voltage", name="history")
        for t in each
    )
    low, high = float(np.nanmin(loops)), float(np.nanmax(loops))
    allowed = _BEYOND * (high - low)
    for text, value in zip(each, found, strict=True):
        if not low - allowed <= value <= high + allowed:
            raise DataError(
                f"history has {text} (in V if no unit is given), and the loops go from {low:.4g} V to {high:.4g} V: "
                "the model does not know the stage beyond; give voltages within, or loops of the entire range"
            )
    return found
