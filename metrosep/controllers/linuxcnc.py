"""LinuxCNC screw compensation, ``COMP_FILE_TYPE = 0``.

Each line is ``nominal forward reverse``: the position that is commanded and the positions that
the axis really reaches moving in + and - direction. The entry for an error e is therefore
``p + e``, and LinuxCNC adds ``nominal - entry`` = -e to the motor command. Confirmed by running the
controller (tests/acceptance/linuxcnc). The file holds bare triples and nothing else: LinuxCNC
stops at the first other line without a word. Of a joint that turns all three are degrees.
"""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

import numpy as np

from metrosep.compensation.area_errors import format_along, is_rotary
from metrosep.compensation.limits import Finding, Limits
from metrosep.compensation.table import CompensationTable
from metrosep.controllers._grammar import Line, Word, decoded, joined
from metrosep.controllers.base import (
    Dialect,
    DialectInfo,
    Encoded,
    identity,
    sidecar_options,
    sidecar_path,
)
from metrosep.controllers.options import TURN, pick
from metrosep.core.errors import CorruptFileError, DataError, LimitError, TableError

__all__ = ["MAX_POINTS", "LinuxCNC"]


MAX_POINTS = 256
"""Entries per joint (motion.h of LinuxCNC 2.9); the 257th is ignored with an error."""

_LINEAR = {"mm": (1e-3, "mm"), "inch": (25.4e-3, "inch")}
_ANGULAR = {
    "deg": (math.pi / 180.0, "degrees"),
    "rad": (1.0, "rad"),
    "grad": (math.pi / 200.0, "grad"),
}
"""Unit of a joint in SI, and its name, by the word of [TRAJ] in the INI file."""
_DECIMALS = 10
"""Decimals of a position: 0.1 pm, 2.6 pm of an inch, or 1.7e-12 rad; LinuxCNC keeps the trim itself as float32."""

_NUMBER = Word(r"[+-]?(?:\d+\.?\d*|\.\d+)(?:[eE][+-]?\d+)?", float, f"{{:.{_DECIMALS}f}}".format)
"""What C reads as a decimal number; Python's float would also take 1_0 and nan."""
_ROW = Line("{nominal} {forward} {reverse}", nominal=_NUMBER, forward=_NUMBER, reverse=_NUMBER)


class LinuxCNC(Dialect):
    """Writer and reader of type-0 files; see the module."""

    info = DialectInfo(
        id="linuxcnc",
        title="LinuxCNC screw compensation, type 0",
        entry="position actually reached: p + e, so that nominal - entry = -e is added",
        units="machine units of the configuration (mm, or linear_units=inch); of a joint that turns "
        "degrees, or angular_units",
        max_points=MAX_POINTS,
        outside="constant beyond both ends",
        sign_status="confirmed by running LinuxCNC 2.9",
        activation=(
            "copy the file beside the INI file",
            "in [JOINT_n] of the axis set COMP_FILE_TYPE = 0 and COMP_FILE = <name of the file>",
            "its TYPE must be the joint_type of the table: LINEAR (mm) or ANGULAR (degrees)",
            "BACKLASH of that joint is ignored from now on: the reverse column holds lost motion",
            "restart LinuxCNC, home, move, and read the applied correction in joint.n.backlash-filt",
        ),
        sign="confirmed",
        resolution="0.1 pm (float32 inside LinuxCNC)",
        reference_rule="zero where the joint counter is zero; the table acts before homing too",
        proof="LinuxCNC 2.9 itself, headless",
        suffix=".comp",
        page="linuxcnc",
    )

    options = (
        pick(
            "cross_axis",
            "a table that corrects another axis than it looks up is refused, or routed in HAL",
            ("refuse", "hal"),
            default="refuse",
        ),
        pick(
            "joint_type",
            "TYPE of the joint in the INI file; a table of A, B or C needs angular: degrees",
            ("linear", "angular"),
            default="linear",
        ),
        pick(
            "linear_units",
            "[TRAJ]LINEAR_UNITS of the INI file: all numbers of a linear joint are in it",
            tuple(_LINEAR),
            default="mm",
        ),
        pick(
            "angular_units",
            "[TRAJ]ANGULAR_UNITS of the INI file: all numbers of an angular joint are in it",
            tuple(_ANGULAR),
            default="deg",
        ),
    )

    def encode(
        self,
        table: CompensationTable,
        *,
        cross_axis: str = "refuse",
        joint_type: str = "linear",
        linear_units: str = "mm",
        angular_units: str = "deg",
        **options: Any,
    ) -> Encoded:
        """Return bare triples."""
        if not table.is_on_axis and cross_axis != "hal":
            raise TableError(
                f"a LinuxCNC compensation file corrects its own joint, this table is {table.axis} -> "
                f"{table.compensates}: loaded as it is it would move {table.axis}; say "
                "cross_axis='hal' to carry it through the joint of "
                f"{table.axis} and route it to {table.compensates} in HAL, or write controller='csv'"
            )
        _check_type(table, joint_type)
        unit, name = _unit(joint_type, linear_units, angular_units)
        n = table.positions.size
        if n > MAX_POINTS:
            raise LimitError(
                f"{n} points, LinuxCNC takes {MAX_POINTS} per joint; use a spacing of at least "
                f"{(table.span[1] - table.span[0]) / (MAX_POINTS - 1) / unit:.4g} {name}"
            )
        reverse = table.forward if table.reverse is None else table.reverse
        columns = np.column_stack(
            [table.positions, table.positions - table.forward, table.positions - reverse]
        )
        printed = [
            _ROW.write(nominal=p, forward=f, reverse=r) for p, f, r in (columns / unit).tolist()
        ]
        back = np.array([row.split() for row in printed], dtype=np.float64) * unit
        if (np.diff(back[:, 0]) <= 0).any():
            raise TableError(f"positions closer than 1e-{_DECIMALS} {name} cannot be written")
        trims = back[:, :1] - back[:, 1:]
        wanted = np.column_stack([table.forward, reverse])
        return Encoded(
            data=joined(printed),
            quantisation=float(np.abs(trims - wanted).max()),
            notes={
                "ini": [
                    f"TYPE = {joint_type.upper()}",
                    f"[TRAJ]ANGULAR_UNITS = {angular_units}"
                    if joint_type == "angular"
                    else f"[TRAJ]LINEAR_UNITS = {linear_units}",
                    "COMP_FILE_TYPE = 0",
                    "COMP_FILE = <this file>",
                ],
                **({} if table.is_on_axis else {"hal_routing": _routing(table)}),
            },
        )

    def doubts(self, table: CompensationTable, limits: Limits) -> list[Finding]:
        """Return that a table of one turn or more holds its ends, unless the travel is stated."""
        low, high = table.span
        stated = limits.travel_low is not None and limits.travel_high is not None
        if not is_rotary(table.axis) or high - low < TURN - 1e-9 or stated:
            return []
        return [
            Finding(
                "error",
                f"the table covers {format_along(table.axis, low)} ... {format_along(table.axis, high)}, and "
                "LinuxCNC knows no modulo: the joint of a wrapped axis counts on, and beyond its ends the "
                "table holds their values",
                "state the travel within the table (travel_low= and travel_high=, such as '0 deg' and "
                "'360 deg'), where the joint cannot leave it",
                "coverage",
            )
        ]

    def decode(self, data: bytes, path: Path, **options: Any) -> CompensationTable:
        """Return the table, refusing whatever LinuxCNC would silently drop."""
        rows = [
            _triple(line, number, path)
            for number, line in enumerate(
                decoded(data, path, "LinuxCNC compensation file").splitlines(), start=1
            )
        ]
        table = np.array(rows)
        falling = np.flatnonzero(np.diff(table[:, 0]) <= 0)
        if falling.size:
            raise CorruptFileError(
                path,
                f"line {int(falling[0]) + 2}: the nominal position does not rise; LinuxCNC would drop "
                "this line and use the rest",
                hint="sort the lines",
            )
        if len(rows) > MAX_POINTS:
            raise LimitError(
                f"{path}: {len(rows)} lines, LinuxCNC uses the first {MAX_POINTS} and ignores the rest"
            )
        if len(rows) < 2:
            raise CorruptFileError(path, "a table needs at least 2 lines", found=len(rows))
        known = {
            **{o.name: o.default for o in self.options},
            **sidecar_options(path, self.options),
            **options,
        }
        joint_type = known["joint_type"]
        if (
            joint_type == "linear"
            and "linear_units" not in options
            and not sidecar_path(path).is_file()
        ):
            raise DataError(
                f"{path}: the file has no sidecar, and its numbers no unit; give linear_units=mm or "
                "linear_units=inch, [TRAJ]LINEAR_UNITS of the INI file (joint_type=angular for an axis that "
                "turns) as a keyword, or --machine linear_units=mm on the command line"
            )
        unit, _ = _unit(joint_type, known["linear_units"], known["angular_units"])
        forward, reverse = (table[:, 0] - table[:, 1]) * unit, (table[:, 0] - table[:, 2]) * unit
        return CompensationTable(
            positions=table[:, 0] * unit,
            forward=forward,
            reverse=None if np.array_equal(forward, reverse) else reverse,
            is_exact_inverse=True,
            **_axes(path, joint_type, first=float(table[0, 0] * unit)),
        )


def _unit(joint_type: str, linear_units: str, angular_units: str) -> tuple[float, str]:
    """Return the unit of a joint in SI, and its name."""
    return _ANGULAR[angular_units] if joint_type == "angular" else _LINEAR[linear_units]


def _check_type(table: CompensationTable, joint_type: str) -> None:
    """Refuse degrees for a joint in mm, and the other way round."""
    turns = [a for a in (table.axis, table.compensates) if is_rotary(a)]
    if turns and not table.is_on_axis:
        raise TableError(
            f"the table is {table.axis} -> {table.compensates}, and {turns[0]} turns: a compensation "
            "file has one unit for positions and corrections; write controller='linuxcnc-lincurve' "
            "(one direction), which has one for each"
        )
    if bool(turns) != (joint_type == "angular"):
        wanted = "angular" if turns else "linear"
        raise DataError(
            f"the axis of the table is {table.axis}, but joint_type={joint_type!r}: LinuxCNC counts a "
            f"{wanted} joint in {'degrees' if turns else 'mm or inch'}; say joint_type={wanted!r}, and set TYPE = "
            f"{wanted.upper()} in its [JOINT_n]"
        )


def _axes(path: Path, joint_type: str, *, first: float) -> dict[str, Any]:
    """Return what the sidecar says; without one an angular joint is that of C."""
    known = identity(path, first=first)
    if not sidecar_path(path).is_file():
        return (
            {**known, **dict.fromkeys(("axis", "compensates"), "C")}
            if joint_type == "angular"
            else known
        )
    if is_rotary(known["axis"]) != (joint_type == "angular"):
        raise DataError(
            f"{path}: its sidecar says axis {known['axis']}, but joint_type={joint_type!r}: one of the "
            "two is wrong"
        )
    return known


def _routing(table: CompensationTable) -> list[str]:
    """HAL lines that take the correction from the looked-up joint to the corrected one.

    With the table on joint a, its pin backlash-filt is c (motor-pos-cmd - pos-cmd also holds the
    offset that homing finds). Drive a gets its motor command less c, so it does not move by c;
    drive b gets c on top, and neither feedback shows it: those are corrected before the motion
    controller runs, with the c of the period that moved the drives.
    """
    a, b = table.axis, table.compensates
    return [
        f"# joint.A is the joint of {a} (with this COMP_FILE), joint.B that of {b}; these lines",
        "# replace your addf lines of motmod and the nets of both joints' motor pins. HAL loads",
        "# sum2 once: if you use it already, put your names and these into one line.",
        "loadrt sum2 names=comp-fb-a,comp-fb-b,comp-cmd-a,comp-cmd-b",
        "setp comp-fb-b.gain1 -1",
        "setp comp-cmd-a.gain1 -1",
        "# order in the thread: first the functions that read the encoders",
        "addf comp-fb-a servo-thread",
        "addf comp-fb-b servo-thread",
        "addf motion-command-handler servo-thread",
        "addf motion-controller servo-thread",
        "addf comp-cmd-a servo-thread",
        "addf comp-cmd-b servo-thread",
        "# and after these the functions that write the drives",
        "net comp-value joint.A.backlash-filt => comp-cmd-a.in1 comp-cmd-b.in1",
        "net comp-value => comp-fb-a.in1 comp-fb-b.in1",
        "net a-motor-cmd joint.A.motor-pos-cmd => comp-cmd-a.in0",
        f"net a-drive comp-cmd-a.out   # to the drive of {a}",
        "net b-motor-cmd joint.B.motor-pos-cmd => comp-cmd-b.in0",
        f"net b-drive comp-cmd-b.out   # to the drive of {b}",
        f"net a-fb comp-fb-a.in0   # from the encoder of {a}",
        "net a-motor-fb comp-fb-a.out => joint.A.motor-pos-fb",
        f"net b-fb comp-fb-b.in0   # from the encoder of {b}",
        "net b-motor-fb comp-fb-b.out => joint.B.motor-pos-fb",
    ]


def _triple(line: str, number: int, path: Path) -> list[float]:
    found = _ROW.read(" ".join(line.split()))
    if found is None or not np.isfinite([*found.values()]).all():
        raise CorruptFileError(
            path,
            f"line {number} is not three numbers but {line[:60]!r}; LinuxCNC would stop reading here "
            "without a word",
            hint="write nothing but 'nominal forward reverse' lines: no header, comma or blank line",
        )
    return [*found.values()]
