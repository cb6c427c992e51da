"""The keys of a recipe, table by table."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from functools import cached_property

from metrosep.core.limits import COVERAGE, RULES
from metrosep.core.methods import METHODS
from metrosep.core.options import options_of
from metrosep.core.text_options import ROW_ORDERS
from metrosep.recipe.methods.plan import PLAN
from metrosep.recipe.pipeline import MEASURING
from metrosep.recipe.schema import LAYOUT, Field
from metrosep.separation.positions.expansion import Expansion
from metrosep.separation.positions.laser_options import READ_AS, SETUP
from metrosep.separation.positions.pitch import REFERENCE_DIRECTIONS
from metrosep.separation.runs.options import RUN_OPTIONS

TOP = {
    "metrosep": Field("integer", required=True),
    "title": Field("text"),
    "extends": Field("text"),
    "input": Field("table"),
    "step": Field("any", required=True),
    "section": Field("any"),
    "check": Field("any"),
    "output": Field("any"),
    "batch": Field("table"),
    "view": Field("table"),
    "report": Field("table"),
    "operator": Field("table"),
}

OPERATOR = {
    "reasons": Field("texts", help="why a part may fail, for the operator to choose from"),
}

INPUT = {
    "files": Field("texts"),
    "x": Field("column"),
    "z": Field("column"),
    "feed": Field("column"),
    "run": Field("text"),
    "direction": Field("text"),
    "time": Field("column"),
    "sampling_rate": Field("frequency"),
    "scale": Field("text"),
    **LAYOUT,
}

MEASURING_INPUT = {
    "files": Field("texts"),
    "unit": Field("text"),
    "lateral_step": Field("steps"),
    "row_order": Field("text", choices=ROW_ORDERS),
    "channel": Field("text"),
    "format": Field("text"),
    "x": Field("column"),
    "z": Field("column"),
    "scale": Field("text"),
    **LAYOUT,
}

STEPS = {
    "separate": {
        "op": Field("text", required=True),
        **RUN_OPTIONS,
    },
    "polynomial": {
        "op": Field("text", required=True),
        "degree": Field(
            "degree",
            help="degree of the polynomial; auto takes that of least AICc",
            default="auto",
        ),
        "max_degree": Field("integer", help="highest degree that auto tries, up to 12", default=6),
        "quantity": Field(
            "text",
            required=True,
            choices=("error", "compensation"),
            help="error is actual - nominal; compensation is minus the error, what is added to the command",
        ),
        "on_axis": Field(
            "flag",
            help="true where the error is along the axis itself, so that the slope of a joint estimate is part of it; as the tables of the recipe say if omitted",
        ),
    },
    "plan_feedrates": PLAN,
    "laser_setup": {"op": Field("text", required=True), "values": READ_AS, **SETUP},
    **{name: op.fields for name, op in MEASURING.items()},
}

WHAT = {
    "separate": "error of an axis from repeated runs (joint, kono, mean)",
    "polynomial": "polynomial of the error or the compensation over position, after separate",
    "plan_feedrates": "feedrates for the next runs from the disturbance, after separate",
    "laser_setup": "runs read by a laser, corrected before separate: air, dead path, cosine, heat",
    **{name: op.what for name, op in MEASURING.items()},
}


class _Steps(Mapping[str, Mapping[str, Field]]):
    """The keys of every step; a method is loaded when it is asked for."""

    def __getitem__(self, op: str) -> Mapping[str, Field]:
        return STEPS[op] if op in STEPS else METHODS[op].fields

    def __contains__(self, op: object) -> bool:
        return op in STEPS or op in METHODS

    def __iter__(self) -> Iterator[str]:
        yield from STEPS
        yield from METHODS

    def __len__(self) -> int:
        return len(STEPS) + len(METHODS)


ALL_STEPS = _Steps()

METRICS = {
    "pv": "P-V of the separated error over the evaluation range",
    "residual_rms": "RMS of the readings about the separated error",
    "after_pv": "P-V of the mean run after the table (dry-run)",
    "after_rms": "RMS of the mean run after the table (dry-run)",
}

_OF_U = {
    "k": Field("number", help="coverage factor of a stated U", default=2.0, low=1.0),
    "p": Field("share", help="coverage probability of a stated U", default=COVERAGE),
    "U_from": Field(
        "text",
        help='origin of U: stated, repeats, "budget: FILE", "certificate: NO"; or fit',
        default="stated",
    ),
}

CHECK = {
    "name": Field("text"),
    "metric": Field("text", required=True, choices=tuple(METRICS)),
    "upper": Field("length"),
    "lower": Field("length"),
    "U": Field("uncertainty"),
    **_OF_U,
    "guard_factor": Field("number"),
}

OUTPUTS = {
    "table": {
        "kind": Field("text", required=True),
        "controller": Field("text", required=True),
        "axis": Field("text", required=True),
        "compensates": Field("text"),
        "spacing": Field("spacing", required=True),
        "direction": Field("text", choices=("auto", "both", "split", "forward", "reverse")),
        "reference": Field("position", help="where the correction is zero"),
        "reference_direction": Field(
            "text",
            choices=tuple(REFERENCE_DIRECTIONS),
            help="direction in which the reference is reached; forward if omitted",
        ),
        **options_of(Expansion),
        "active": Field(
            "file", help="table that was active during the measurement, or none; both are written"
        ),
        "path": Field("text", required=True),
        "machine": Field("table"),
        "degree": Field("integer"),
        "waive": Field("texts"),
        "sign_confirmed": Field("flag"),
    },
    "report": {
        "kind": Field("text", required=True),
        "formats": Field("texts"),
        "path": Field("text"),
    },
    "parts": {"kind": Field("text", required=True), "path": Field("text")},
}

METHOD_CHECK = {
    "name": Field("text"),
    "metric": Field("text", required=True),
    "upper": Field("limit"),
    "lower": Field("limit"),
    "U": Field("expanded"),
    **_OF_U,
    "guard_factor": Field("number"),
    "rule": Field("text", choices=RULES),
    "sequential": Field("flag"),
}

PROGRAM_FILE: Mapping[str, Field] = {
    "kind": Field("text", required=True),
    "path": Field("text", required=True),
    "format": Field(
        "text",
        choices=("gcode", "pmac", "points"),
        help="blocks with G1 (or the spline word), PVT blocks of a PMAC, or a CSV of points",
    ),
}
PROGRAM_PROOF: Mapping[str, Field] = {
    "velocity_time": Field("time", help="unit of time of a PMAC's velocities (Ix90)"),
    "tolerance": Field(
        "size", help="largest P-V of the part cut from the file, without the cusps of the feed"
    ),
    "verify": Field(
        "flag", help="false: the part is not cut from the file before it gets its name"
    ),
    "cut_points": Field(
        "flag", help="true: points of the surface are written, for whoever offsets them elsewhere"
    ),
    "overwrite": Field("flag", help="true: another file of that name is replaced"),
}


class _ProgramKeys(Mapping[str, Field]):
    """Keys of an output of kind "program"; those of the machine are loaded when one is asked for."""

    @cached_property
    def _known(self) -> dict[str, Field]:
        from metrosep.controllers.gcode.lathe import LatheAxes

        return {**PROGRAM_FILE, **options_of(LatheAxes), **PROGRAM_PROOF}

    def __getitem__(self, key: str) -> Field:
        return self._known[key]

    def __iter__(self) -> Iterator[str]:
        return iter(self._known)

    def __len__(self) -> int:
        return len(self._known)


_PROGRAM: Mapping[str, Field] = _ProgramKeys()


METHOD_OUTPUTS = {
    "table": {**OUTPUTS["table"], "spacing": Field("spacing")},  # a list of targets has its own
    "parts": OUTPUTS["parts"],
    "report": OUTPUTS["report"],
    "program": _PROGRAM,
}
