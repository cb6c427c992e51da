"""The separations that a recipe can ask for by name: what each reads, its keys, and its call.

Every entry is data (`Method`): the kind of its inputs, the keys of its step, and a function of the
toolbox that is loaded when it is used.
"""

from __future__ import annotations

import math
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from metrosep.core._arrays import FloatArray
from metrosep.core.errors import (
    DataError,
    FormatMismatchError,
    InvalidSamplesError,
    LimitError,
    NotSeparableError,
    TooFewSamplesError,
    UnitError,
)
from metrosep.core.inputs import Readings, RoleColumns
from metrosep.core.methods import METHODS
from metrosep.core.profile import Profile
from metrosep.core.provenance import Step
from metrosep.core.runset import Run, RunSet
from metrosep.recipe.key_values import typed_number
from metrosep.recipe.method import CURVES, MAPS, OP, Method, input_fields, toolbox
from metrosep.recipe.ops_lines import LINES
from metrosep.recipe.ops_machine import MACHINES
from metrosep.recipe.ops_planes import MAPS_OF, PLANES
from metrosep.recipe.ops_process import PROCESSES
from metrosep.recipe.ops_quality import QUALITY
from metrosep.recipe.plan import PLANS
from metrosep.recipe.schema import Field

__all__ = ["CURVES", "MAPS", "METHODS", "Method", "input_fields"]


# ---- steps of recipes for positioning tests: ISO 230-2, diagonals of ISO 230-6 -----------------

Positions = tuple[Any, Any, Any]
"""Targets, forward and backward: the arguments of `iso230_2`."""


def _positions(data: RoleColumns, rows: Any = slice(None)) -> Positions:
    values = data.values
    if "forward" in values:  # from a list of a positioning test
        both = [v if v.size else None for v in (values["forward"], values["backward"])]
        return values["target"], both[0], both[1]
    found: Positions = toolbox("positions_from_columns")(
        values["target"][rows],
        _words(values["direction"][rows]),
        values["readings"].T[rows],
    )
    return found


def _words(direction: Any) -> list[str]:
    return [str(d) for d in direction]


def _iso230_2(data: RoleColumns, options: Mapping[str, Any]) -> Any:
    unit = data.units.get("target", "m")
    if data.units.get("readings", unit) != unit:
        raise UnitError("targets and positions must both be lengths, or both angles")
    return toolbox("iso230_2")(*_positions(data), unit=unit, **options)


def _iso230_6(tables: Sequence[RoleColumns], options: Mapping[str, Any]) -> Any:
    """One file for each diagonal, or one file with a column that names the diagonal of each row."""
    rest = dict(options)
    names = rest.pop("names", None)
    first = tables[0]
    if "diagonal" in first.values:
        if len(tables) > 1 or names is not None:
            raise DataError(
                "a column of diagonals is for one file; leave names out and give that file alone"
            )
        marks = first.values["diagonal"]
        diagonals = {
            str(name): _positions(first, np.flatnonzero(marks == name))
            for name in dict.fromkeys(marks.tolist())
        }
    else:
        names = [t.name for t in tables] if names is None else names
        if len(names) != len(tables):
            raise DataError(
                f"{len(names)} names of diagonals for {len(tables)} files; give one for each file: "
                'names = ["ppp", "npp"]'
            )
        if len(set(names)) != len(names):
            raise DataError("a diagonal is named twice; give each file its own name")
        diagonals = {n: _positions(t) for n, t in zip(names, tables, strict=True)}
    if not diagonals:
        raise NotSeparableError("there is no diagonal in the files")
    return toolbox("iso230_6_diagonals")(diagonals, **rest)


_COMMON = {"confidence": Field("number"), "seed": Field("integer")}

POSITIONS: Mapping[str, Method] = {
    "iso230_2": Method(
        "positioning accuracy and repeatability of an axis, ISO 230-2",
        "table",
        (),
        {**OP, **_COMMON},
        _iso230_2,
        roles={"target": "position?", "direction": "label?", "readings": "position*?"},
    ),
    "iso230_6_diagonals": Method(
        "deviations along diagonals and squareness of the axes, ISO 230-6",
        "tables",
        (),
        {**OP, "names": Field("texts"), "size": Field("lengths"), **_COMMON},
        _iso230_6,
        roles={
            "target": "length?",
            "direction": "label?",
            "readings": "length*?",
            "diagonal": "label?",
        },
    ),
}


# ------------------------------------------------------------------------------------------------

# ---- the step of a dual servo: straightness runs to polynomial, drive table, before and after ----

_MOST_VOLTAGES = 10_001


@dataclass(frozen=True, slots=True)
class DualServoResult:
    """What a dual servo needs to compensate a slide, and what it gained."""

    runs: tuple[Profile, ...]  # straightness runs
    polynomial: Any  # through all runs
    lines: Any  # straightness of their mean about three lines, alignment apart
    calibration: Any  # or float: of the stage; the sensitivity in m/V if no sweep was given
    table: Any  # voltages, checked against every limit
    static: Any = None  # following error at rest without and with the stage
    parts: Any = None  # roughness and profile height of a part before and after
    beside: tuple[Step, ...] = ()  # of the files beside the runs
    assumed: tuple[str, ...] = ()  # what was not stated

    @property
    def messages(self) -> tuple[str, ...]:
        """What to know."""
        found = [*self.polynomial.messages, *self.lines.messages]
        found += [f"the drive table does not keep a limit: {v}" for v in self.table.violations]
        for item in (self.calibration, self.static, self.parts):
            found += getattr(item, "messages", ())
        return tuple(dict.fromkeys((*found, *self.assumed)))


def _dual_servo(data: Readings, options: Mapping[str, Any]) -> DualServoResult:
    from metrosep.process import drive_table, run_polynomial, straightness_lines

    if data.position is None or data.position_unit != "m":
        raise DataError(
            "straightness runs need their positions along the slide: name the column x"
        )
    rest = dict(options)
    _check_together(rest)
    runs = tuple(
        Profile(data.position, z, history=data.history) for reading in data.values for z in reading
    )
    quantity = rest["quantity"]
    degree = rest.get("degree", "f-test")
    polynomial = run_polynomial(
        runs, quantity=quantity, degree=degree, max_degree=rest.get("max_degree", 6)
    )
    with np.errstate(invalid="ignore"):
        mean = np.mean([r.z for r in runs], axis=0)
    lines = straightness_lines(
        Profile(data.position, mean), against=rest.get("against", "spindle face (assumed)")
    )
    calibration, history = _calibration(rest)
    low, high = polynomial.domain
    step = rest.get("table_step", (high - low) / 400.0)
    count = round((high - low) / step) + 1
    if not 2 <= count <= _MOST_VOLTAGES:
        raise DataError(
            f"table_step gives {count} voltages over {1e3 * (high - low):.6g} mm; 2 to "
            f"{_MOST_VOLTAGES} can be written"
        )
    x = np.linspace(low, high, count)
    table = drive_table(
        x,
        polynomial.evaluate(x),
        quantity=quantity,
        calibration=calibration,
        offset=rest.get("offset", 0.0),
        limits=_limits(rest.get("limits", _LIMITS)),
        travel=rest.get("travel", math.inf),
        speed=rest.get("speed"),
        slew=rest.get("slew", math.inf),
        bits=rest.get("bits"),
        strict=False,
    )
    if table.violations and rest.get("strict", True):
        raise LimitError(_refusal(table.violations, calibration, rest))
    assumed: tuple[str, ...] = ()
    if "limits" not in rest:
        assumed = ("limits of 0 and 10 V are assumed; state those of the amplifier (limits)",)
    static, more = _static(rest)
    parts, last = _parts(rest)
    return DualServoResult(
        runs,
        polynomial,
        lines,
        calibration,
        table,
        static,
        parts,
        (*history, *more, *last),
        assumed,
    )


_LIMITS = (0.0, 10.0)
"""Of the amplifier in V, where none are stated."""


def _refusal(violations: tuple[str, ...], calibration: Any, rest: Mapping[str, Any]) -> str:
    """Return why a table is not written, and what helps."""
    words = (
        f"no voltages are given, the drive table does not keep a limit: {'; '.join(violations)}"
    )
    if "offset" not in rest:
        words += (
            ". No offset is stated, so the stage rests at 0; where the error changes its sign, or "
            "lies on the other side, state where it rests, within its travel: "
            'offset="2 um"'
        )
    if "limits" not in rest:
        words += ". The limits of 0 and 10 V are assumed; state those of the amplifier (limits)"
    return f"{words}. To look at such a table all the same: strict=false"


_TOGETHER = (
    (("voltage", "displacement"), "calibration"),
    (("resolution",), "at_rest"),
    (("lambda_s", "form"), "before"),
)
"""Keys that say nothing without another one."""


def _check_together(rest: Mapping[str, Any]) -> None:
    """Refuse keys that would be read by nobody."""
    for keys, other in _TOGETHER:
        lost = [k for k in keys if k in rest]
        if lost and other not in rest:
            raise DataError(f"{lost[0]} belongs to {other}, which is not given")
    if "max_degree" in rest and isinstance(rest.get("degree"), int):
        raise DataError(
            f"max_degree bounds a search, but degree = {rest['degree']} is stated; give one of them"
        )


def _limits(values: Any) -> tuple[float, float]:
    """Return two voltages: numbers in V, or texts such as ``0 V``; a text may hold both."""
    given = values.split(",") if isinstance(values, str) else values
    if not isinstance(given, list | tuple) or len(given) != 2:
        count = len(given) if isinstance(given, list | tuple) else 1
        raise DataError(f"limits is two voltages, got {count}: limits=0,10")
    low, high = (_volts(v) for v in given)
    return low, high


def _volts(value: Any) -> float:
    text = re.sub(r"\s*V$", "", str(value).strip())
    try:
        volts = math.nan if isinstance(value, bool) else float(text)
    except ValueError:
        volts = math.nan
    if not math.isfinite(volts):
        raise DataError(f"limits: {value!r} is no voltage; give 0 V,10 V")
    return volts


def _sensitivity(text: str) -> float:
    """Return a sensitivity in m/V of ``1.66 um/V``, or of the displacement for 1 V."""
    from metrosep.core.units import parse_quantity

    bare = re.sub(r"\s*/\s*V$", "", text.strip())
    value = parse_quantity(bare, dimension="length", name="sensitivity")
    if not value > 0.0:
        raise DataError(f"sensitivity is {text}; it must be more than zero")
    return value


def _calibration(rest: Mapping[str, Any]) -> tuple[Any, tuple[Step, ...]]:
    """Return the calibration of the stage: of a sweep, or the sensitivity."""
    from metrosep.core.recording import Recording
    from metrosep.process import flexure_calibration

    if ("calibration" in rest) == ("sensitivity" in rest):
        raise DataError(
            'give either calibration = "sweep.csv" (columns voltage_V and displacement_um) or '
            'sensitivity = "1.66 um/V"'
        )
    if "sensitivity" in rest:
        return _sensitivity(rest["sensitivity"]), ()
    try:
        data = _columns(
            rest["calibration"],
            voltage=(rest.get("voltage", "voltage_V"), "any"),
            displacement=(rest.get("displacement", "displacement_um"), "length"),
        )
    except FormatMismatchError as error:
        lost = [k for k in ("voltage", "displacement") if k not in rest]
        if not lost:
            raise
        names = " and ".join(f'{k}="..."' for k in lost)
        raise FormatMismatchError(f"{error}; name the columns of the sweep: {names}") from None
    n = data.values["voltage"].size
    log = Recording(
        np.arange(float(n)),
        {k: np.asarray(data.values[k]) for k in ("voltage", "displacement")},
        history=data.history,
    )
    return flexure_calibration(log), data.history


def _columns(file: Any, **roles: tuple[str, str]) -> Any:
    from metrosep.io.runs import Role, read_roles

    return read_roles([file], {k: Role(column, kind) for k, (column, kind) in roles.items()})


def _static(rest: Mapping[str, Any]) -> tuple[Any, tuple[Step, ...]]:
    """Return the comparison of the following error at rest, where its file is named."""
    if "at_rest" not in rest:
        return None, ()
    from metrosep.process import compare_static

    data = _columns(
        rest["at_rest"],
        time=("t_s", "time"),
        before=("without_nm", "length"),
        after=("with_nm", "length"),
    )
    t = np.asarray(data.values["time"])
    step = float(t[-1] - t[0]) / max(t.size - 1, 1)
    if not step > 0.0 or float(np.abs(np.diff(t) - step).max()) > 1e-3 * step:
        raise DataError(f"{rest['at_rest']}: the time must grow by equal steps")
    found = compare_static(
        data.values["before"],
        data.values["after"],
        step=step,
        resolution=rest.get("resolution", 0.0),
    )
    return found, data.history


def _parts(rest: Mapping[str, Any]) -> tuple[Any, tuple[Step, ...]]:
    """Return Ra and Pt before and after, where both profiles are named."""
    named = [k for k in ("before", "after", "lambda_c") if k in rest]
    if not named:
        return None, ()
    if len(named) < 3:
        raise DataError(
            "before and after are two profiles of the part, evaluated with one cut-off lambda_c; "
            f"only {', '.join(named)} is given"
        )
    from metrosep.io.read import read
    from metrosep.process import before_after

    profiles = []
    for key in ("before", "after"):
        found = read(rest[key])
        if not isinstance(found, Profile):
            raise DataError(
                f"{rest[key]}: {key} must hold a profile, not a {type(found).__name__}"
            )
        profiles.append(found)
    result = before_after(
        *profiles,
        lambda_c=rest["lambda_c"],
        lambda_s=rest.get("lambda_s"),
        form=rest.get("form", "line"),
    )
    return result, tuple(s for p in profiles for s in p.history)


DUAL_SERVO: Mapping[str, Method] = {
    "dual_servo": Method(
        "straightness runs of a slide to a polynomial and the voltages of a flexure stage",
        "curves",
        (),
        {
            **OP,
            "quantity": Field("text", choices=("error", "compensation"), required=True),
            "degree": Field("degree"),
            "max_degree": Field("integer"),
            "against": Field("text"),
            "calibration": Field("file"),
            "voltage": Field("text"),
            "displacement": Field("text"),
            "sensitivity": Field("text"),
            "offset": Field("length"),
            "limits": Field("any"),
            "strict": Field("flag"),
            "travel": Field("size"),
            "table_step": Field("size"),
            "speed": Field("speed"),
            "slew": Field("number"),
            "bits": Field("integer"),
            "at_rest": Field("file"),
            "resolution": Field("uncertainty"),
            "before": Field("file"),
            "after": Field("file"),
            "lambda_c": Field("size"),
            "lambda_s": Field("size"),
            "form": Field("text", choices=("none", "line")),
        },
        _dual_servo,
        over="x",
    ),
}


# ------------------------------------------------------------------------------------------------

# ---- steps of recipes around a separation: check and choose probes, evidence, fiducials, sweeps ----

_SAME_FEED = 1e-6
"""Feeds of one run may differ by this relative share: rounding of text."""


def _evidence(data: RoleColumns, options: Mapping[str, Any]) -> Any:
    rest = dict(options)
    way = rest.pop("direction", None)
    runs = _runs(data)
    if way is not None:
        runs = runs.select(direction=1 if way == "forward" else -1)
    return toolbox("evidence_table")(runs, **rest)


def _runs(data: RoleColumns) -> RunSet:
    """Return the runs of a table, told apart by the column of runs, in the order of the rows."""
    values = data.values
    found = []
    for name in dict.fromkeys(values["run"].tolist()):
        rows = values["run"] == name
        feed = values["feed"][rows]
        if not np.isfinite(feed).all() or float(np.ptp(feed)) > _SAME_FEED * abs(float(feed[0])):
            raise InvalidSamplesError(
                f"run {name}: its rows have different feedrates, or none; a run has one"
            )
        time = values["time"][rows] if "time" in values else None
        found.append(
            Run(
                values["x"][rows],
                values["z"][rows],
                t=time,
                feed=abs(float(feed[0])),
                run_id=str(name),
            )
        )
    return RunSet(found)


def _fiducials(data: RoleColumns, options: Mapping[str, Any]) -> Any:
    """Register marked points; a row holds one of them in both maps."""
    pairs = [
        np.column_stack([data.values[f"x_{which}"], data.values[f"y_{which}"]])
        for which in ("fixed", "moved")
    ]
    seen = np.isfinite(pairs[0]).all(axis=1) & np.isfinite(pairs[1]).all(axis=1)
    if not seen.all():
        row = int(np.flatnonzero(~seen)[0]) + 1
        raise InvalidSamplesError(
            f"point {row} of {seen.size} lacks a coordinate in one of the maps; drop the row"
        )
    if seen.size < 2:
        raise TooFewSamplesError(f"two points or more are needed, got {seen.size}")
    return toolbox("register_points")(*pairs)


CHECKS: Mapping[str, Method] = {
    "evidence_table": Method(
        "how surely each wavelength of an error repeats over runs of several feedrates",
        "table",
        (),
        {
            **OP,
            "direction": Field("text", choices=("forward", "reverse")),
            "start": Field("length"),
            "length": Field("size"),
            "shortest": Field("size"),
            "bandwidth": Field("frequency"),
            "false_discovery_rate": Field("number"),
        },
        _evidence,
        roles={"x": "length", "z": "length", "feed": "speed", "run": "label", "time": "time?"},
    ),
    "register_points": Method(
        "shift and turn of one map against another from points that are marked in both",
        "table",
        (),
        {**OP},
        _fiducials,
        roles={"x_fixed": "length", "y_fixed": "length", "x_moved": "length", "y_moved": "length"},
    ),
}


# ------------------------------------------------------------------------------------------------

# ---- positioning tests whose table holds deviations in place of the positions that were reached ----
# Many measuring programs write ``actual - target``; the evaluation takes positions. A table that is
# taken for the other kind gives a nonsensical result or none, so the data decide whether what was
# said about them can be true.

_VALUES = ("position", "deviation")
_SMALL, _LARGE = 0.1, 0.5
"""Readings that span less of the targets than the first are deviations, more than the second are
positions: an axis that is wrong by a tenth of its travel is broken, not measured."""


def with_values(method: Method) -> Method:
    """Return a method of positioning tests with the key ``values``."""

    def call(inputs: Any, options: Mapping[str, Any]) -> Any:
        rest = dict(options)
        kind = rest.pop("values", "position")
        if isinstance(inputs, tuple):
            return method.from_inputs(tuple(as_positions(i, kind) for i in inputs), rest)
        return method.from_inputs(as_positions(inputs, kind), rest)

    fields = {**method.fields, "values": Field("text", choices=_VALUES)}
    return replace(method, fields=fields, from_inputs=call)


def as_positions(data: RoleColumns, values: str) -> RoleColumns:
    """Return the readings of a positioning test as positions reached.

    Notes
    -----
    NaN stays NaN. Without a range of targets nothing is judged; the evaluation refuses that.
    """
    target = np.asarray(data.values["target"], dtype=np.float64)
    found = {k: data.values[k] for k in ("readings", "forward", "backward") if k in data.values}
    angle = data.units.get("target") == "rad"
    for name, readings in found.items():
        _require_kind(target, np.asarray(readings, dtype=np.float64), values, name, angle=angle)
    if values == "position":
        return data
    reached: dict[str, Any] = {}
    for name, readings in found.items():
        column = target if name == "readings" else target[:, None]  # a row a run, a row a target
        reached[name] = readings + column if readings.size else readings
    return replace(data, values={**data.values, **reached})


def _require_kind(
    target: FloatArray, readings: FloatArray, values: str, name: str, *, angle: bool
) -> None:
    span, reach = _range(target), _range(readings)
    if span == 0.0 or not np.isfinite(readings).any():
        return
    dimension = "angle" if angle else "length"
    sizes = (
        f"they span {typed_number(reach, dimension)} where the targets span "
        f"{typed_number(span, dimension)}"
    )
    if values == "position" and reach < _SMALL * span:
        raise InvalidSamplesError(
            f"the {name} look like deviations, not like positions reached: {sizes}; if they are "
            'actual minus target, say values = "deviation", else name the columns of positions'
        )
    if values == "deviation" and reach > _LARGE * span:
        raise InvalidSamplesError(
            f"the {name} look like positions reached, not like deviations: {sizes}; leave "
            'values = "deviation" out'
        )


def _range(values: FloatArray) -> float:
    known = values[np.isfinite(values)]
    return float(known.max() - known.min()) if known.size else 0.0


# ------------------------------------------------------------------------------------------------

OLD: Mapping[str, Method] = {
    **LINES,
    **{name: with_values(method) for name, method in POSITIONS.items()},
    **MAPS_OF,
    **PLANES,
    **PLANS,
    **CHECKS,
    **MACHINES,
    **PROCESSES,
    **DUAL_SERVO,
    **QUALITY,
}
