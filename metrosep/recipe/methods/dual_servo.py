"""The step of a dual servo: straightness runs to polynomial, drive table, before and after."""

from __future__ import annotations

import math
import re
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np

from metrosep.core.errors import (
    DataError,
    FormatMismatchError,
    LimitError,
)
from metrosep.core.methods import Method, Readings
from metrosep.core.options import Option
from metrosep.core.profile import Profile
from metrosep.core.provenance import Step

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


class DualServo(Method):
    """`dual_servo` by its name."""

    name: ClassVar[str] = "dual_servo"
    what: ClassVar[str] = (
        "straightness runs of a slide to a polynomial and the voltages of a flexure stage"
    )
    reads: ClassVar = "curves"
    over: ClassVar = "x"
    arguments: ClassVar[Mapping[str, Option]] = {
        "quantity": Option(
            "text",
            choices=("error", "compensation"),
            required=True,
            help="what the runs are: error is actual - nominal; compensation is added to the command",
        ),
        "degree": Option(
            "degree",
            help="of the polynomial through all runs; f-test adds degrees while they help",
        ),
        "max_degree": Option("integer", help="highest degree that the search tries"),
        "against": Option("text", help="what the straightness is measured against, a text"),
        "calibration": Option(
            "file", help="file with a sweep of the stage: voltage and displacement"
        ),
        "voltage": Option("text", help="column of that file, voltage_V"),
        "displacement": Option("text", help="column of that file, displacement_um"),
        "sensitivity": Option("text", help='of the stage, where there is no sweep, "1.66 um/V"'),
        "offset": Option("length", help='where the stage rests, within its travel, "2 um"'),
        "limits": Option("any", help="voltages of the amplifier, 0,10"),
        "strict": Option(
            "flag", help="true: a table beyond a limit is refused; false: it is written"
        ),
        "travel": Option("size", help='of the stage, from 0, "5 um"'),
        "table_step": Option(
            "size", help="between the positions of the voltages; a 400th of the travel if omitted"
        ),
        "speed": Option("speed", help="of the slide, which tells how fast the voltage changes"),
        "slew": Option("number", help="fastest change of the amplifier in V/s, 100"),
        "bits": Option("integer", help="of the converter that gives the voltages"),
        "at_rest": Option(
            "file", help="file with the following error at rest: t_s, without_nm, with_nm"
        ),
        "resolution": Option(
            "uncertainty", help="of the sensor that reads the following error at rest"
        ),
        "before": Option("file", help="file with a profile of the part before"),
        "after": Option("file", help="file with a profile of the part after"),
        "lambda_c": Option("size", help="cut-off of the roughness of both profiles"),
        "lambda_s": Option("size", help="shortest wavelength of both profiles that counts"),
        "form": Option(
            "text", choices=("none", "line"), help="line: a line is taken off both profiles first"
        ),
    }

    @classmethod
    def from_inputs(cls, data: Readings, options: Mapping[str, Any]) -> DualServoResult:
        """Return what the step makes."""
        from metrosep.process import drive_table, run_polynomial, straightness_lines

        if data.position is None or data.position_unit != "m":
            raise DataError(
                "straightness runs need their positions along the slide: name the column x"
            )
        rest = dict(options)
        _check_together(rest)
        runs = tuple(
            Profile(data.position, z, history=data.history)
            for reading in data.values
            for z in reading
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
            raise DataError(
                f"{lost[0]} belongs to {other}, which is not given; give it too, or leave {lost[0]} out"
            )
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
        raise DataError(f"limits: {value!r} is not a voltage; give 0 V,10 V")
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
    from metrosep.io.role_columns import Role, read_roles

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
    from metrosep.io.read import read_one as read
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
