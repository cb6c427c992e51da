"""LinuxCNC screw compensation, ``COMP_FILE_TYPE = 0``.

Each line is ``nominal forward reverse``: the position that is commanded and the positions that
the axis really reaches moving in + and - direction. The entry for an error e is therefore
``p + e``, and LinuxCNC adds ``nominal - entry`` = -e to the motor command. Confirmed by running the
controller (tests/acceptance/linuxcnc). The file holds bare triples and nothing else: LinuxCNC
stops at the first other line without a word. Of a joint that turns all three are degrees.
"""

from __future__ import annotations

import itertools
import math
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from decimal import Decimal
from pathlib import Path
from typing import Any

import numpy as np

from metrosep.compensation.area_errors import format_along, is_rotary
from metrosep.compensation.limits import Finding, Limits
from metrosep.compensation.table import CompensationTable
from metrosep.controllers._facts import agreed, read_table
from metrosep.controllers._grammar import (
    Line,
    Word,
    code_rows,
    damaged,
    decoded,
    joined,
    require_rising,
)
from metrosep.controllers.base import (
    Dialect,
    DialectInfo,
    Encoded,
    Simulator,
    identity,
    one_way,
    sidecar_options,
    sidecar_path,
)
from metrosep.controllers.options import TURN, Option, pick, whole
from metrosep.core._arrays import FloatArray
from metrosep.core.errors import CorruptFileError, DataError, Example, LimitError, TableError

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

    def encode(self, table: CompensationTable, **options: Any) -> Encoded:
        """Return bare triples."""
        o = self.filled(options)
        joint_type, angular = o["joint_type"], o["joint_type"] == "angular"
        _refuse_two_units(table)
        if not table.is_on_axis and o["cross_axis"] != "hal":
            raise TableError(
                f"a LinuxCNC compensation file corrects its own joint, this table is {table.axis} -> "
                f"{table.compensates}: loaded as it is it would move {table.axis}; say "
                "cross_axis='hal' to carry it through the joint of "
                f"{table.axis} and route it to {table.compensates} in HAL, or write controller='csv'"
            ).hinting(cross_axis=Example("hal"))
        _check_type(table, joint_type)
        unit, name = _unit(o)
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
                    f"[TRAJ]ANGULAR_UNITS = {o['angular_units']}"
                    if angular
                    else f"[TRAJ]LINEAR_UNITS = {o['linear_units']}",
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
            Finding.error(
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
        hint = "LinuxCNC would drop this line and use the rest; sort the lines"
        require_rising(table[:, 0], path, "line", hint)
        if len(rows) > MAX_POINTS:
            raise LimitError(
                f"{path}: {len(rows)} lines, LinuxCNC uses the first {MAX_POINTS} and ignores the rest"
            )
        if len(rows) < 2:
            raise CorruptFileError(path, "a table needs at least 2 lines", found=len(rows))
        known = self.filled({**sidecar_options(path, self.options), **options})
        joint_type = known["joint_type"]
        if (
            joint_type == "linear"
            and "linear_units" not in options
            and not sidecar_path(path).is_file()
        ):
            raise (
                DataError(
                    f"{path}: the file has no sidecar, and its numbers no unit; give linear_units=mm or "
                    "linear_units=inch, [TRAJ]LINEAR_UNITS of the INI file (give joint_type=angular for an "
                    "axis that turns)"
                )
                .hinting(linear_units=Example("mm"))
                .hinting(linear_units=Example("inch"))
                .hinting(joint_type=Example("angular"))
            )
        unit, _ = _unit(known)
        forward, reverse = (table[:, 0] - table[:, 1]) * unit, (table[:, 0] - table[:, 2]) * unit
        return read_table(
            table[:, 0] * unit,
            forward,
            None if np.array_equal(forward, reverse) else reverse,
            **_axes(path, joint_type),
        )


def _unit(o: Mapping[str, Any]) -> tuple[float, str]:
    """Return the unit of a joint in SI, and its name."""
    angular = o["joint_type"] == "angular"
    return _ANGULAR[o["angular_units"]] if angular else _LINEAR[o["linear_units"]]


def _refuse_two_units(table: CompensationTable) -> None:
    """Refuse a table with positions in degrees and corrections in mm, or the other way round."""
    turns = [a for a in (table.axis, table.compensates) if is_rotary(a)]
    if turns and not table.is_on_axis:
        raise TableError(
            f"the table is {table.axis} -> {table.compensates}, and {turns[0]} turns: a compensation "
            "file has one unit for positions and corrections; write controller='linuxcnc-lincurve' "
            "(one direction), which has one for each"
        )


def _check_type(table: CompensationTable, joint_type: str) -> None:
    """Refuse degrees for a joint in mm, and the other way round."""
    turns = [a for a in (table.axis, table.compensates) if is_rotary(a)]
    if bool(turns) != (joint_type == "angular"):
        wanted = "angular" if turns else "linear"
        raise DataError(
            f"the axis of the table is {table.axis}, but joint_type={joint_type!r}: LinuxCNC counts a "
            f"{wanted} joint in {'degrees' if turns else 'mm or inch'}; say joint_type={wanted!r}, and set TYPE = "
            f"{wanted.upper()} in its [JOINT_n]"
        ).hinting(joint_type=wanted)


def _axes(path: Path, joint_type: str) -> dict[str, Any]:
    """Return what the sidecar says; without one an angular joint is that of C."""
    known = identity(path)
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


# ---- a table across axes as a chain of lincurves of HAL -----------------------------------------
# LinuxCNC: a table across axes as a chain of HAL's ``lincurve`` components.
#
# A lincurve interpolates at most 16 points and is constant outside them. A longer table f is cut into
# pieces that share their end points; every piece but the first starts at zero, so that at any position
# the pieces before it have run to their ends, those behind it are still zero, and the sum is f. The
# sum is added to the motor command of the corrected joint and taken out of its feedback again.
# Of an axis that turns the numbers are degrees, and the first comment of the file says so.
# Confirmed by running the controller (tests/acceptance/linuxcnc).

# ---- text of a chain of lincurves in HAL: cut a table into curves, write the commands, read them back ----
# The reader takes no other wiring than the one that was proven on the controller: it makes the commands
# again from the numbers that it found, and refuses a file in which any word differs.

POINTS_PER_CURVE = 16
"""Points of one lincurve."""
MAX_CURVES = 64
"""Personalities that LinuxCNC 2.9 takes for one component; the 65th keeps it from loading."""
CHAIN_POINTS = MAX_CURVES * (POINTS_PER_CURVE - 1) + 1
"""Neighbouring curves share a point."""

UNIT = 10**_DECIMALS
"""Units in which entries are whole numbers, per millimetre."""

_PLAIN_NUMBER = re.compile(r"[+-]?(\d{1,12}(\.\d{0,30})?|\.\d{1,30})")
THREAD = re.compile(r"[A-Za-z][A-Za-z0-9_.-]{0,39}")
"""Name of a thread in HAL."""

Curve = tuple[tuple[Decimal, Decimal], ...]


@dataclass(frozen=True, slots=True)
class Chain:
    """What the file says."""

    # of tuple of (Decimal, Decimal), mm: points of each lincurve; degrees of an axis that turns
    curves: tuple[Curve, ...]
    source: int  # joints that are looked up and corrected
    target: int
    thread: str  # servo thread
    prefix: str  # of the names in HAL: "comp" in files of old, of which two cannot be loaded

    @staticmethod
    def prefix_of(source: int, target: int) -> str:
        """Return what the names of a file begin with, so that it can stand beside others."""
        return f"comp-{source:x}-{target:x}"  # a line of HAL holds 1023 characters

    def knots(self) -> list[tuple[Decimal, Decimal]]:
        """Return the points of the sum of the curves, mm."""
        found = list(self.curves[0])
        for curve in self.curves[1:]:
            before = found[-1][1]
            found += [(x, before + y) for x, y in curve[1:]]
        return found


def cut(x: Sequence[int], y: Sequence[int]) -> tuple[Curve, ...]:
    """Return the curves: the first as it is, every other one from the zero at its first point."""
    step = POINTS_PER_CURVE - 1
    curves = []
    for start in range(0, len(x) - 1, step):
        stop = min(start + step, len(x) - 1)
        zero = y[start] if start else 0
        points = range(start, stop + 1)
        curves.append(tuple((Decimal(x[i]) / UNIT, Decimal(y[i] - zero) / UNIT) for i in points))
    return tuple(curves)


def hal_lines(chain: Chain) -> list[str]:
    """Return the file without its comments: values, order in the thread, wiring."""
    n, p = len(chain.curves), chain.prefix
    added = f"{p}-sum" if p == "comp" else f"{p}-s"
    curves = [f"{p}-{i}" for i in range(n)]
    sums = [f"{added}-{i}" for i in range(1, n)]
    sizes = ",".join(str(len(c)) for c in chain.curves)
    order = [f"{p}-fb", "motion-command-handler", "motion-controller", *curves, *sums, f"{p}-cmd"]
    value = f"{sums[-1]}.out" if sums else f"{curves[0]}.out"
    lines = [
        f"loadrt lincurve names={','.join(curves)} personality={sizes}",
        f"loadrt sum2 names={','.join([*sums, f'{p}-cmd', f'{p}-fb'])}",
        f"setp {p}-fb.gain1 -1",
    ]
    for name, curve in zip(curves, chain.curves, strict=True):
        for i, (x, y) in enumerate(curve):
            lines.append(f"setp {name}.x-val-{i:02d} {_printed(x)}")
            lines.append(f"setp {name}.y-val-{i:02d} {_printed(y)}")
    lines += [f"addf {name} {chain.thread}" for name in order]
    lines.append(f"net {p}-position joint.{chain.source}.pos-cmd")
    lines += [f"net {p}-position {name}.in" for name in curves]
    for i in range(1, n):
        before = f"{curves[0]}.out" if i == 1 else f"{added}-{i - 1}.out"
        lines.append(f"net {p}-below-{i} {before} {added}-{i}.in0")
        lines.append(f"net {p}-piece-{i} {p}-{i}.out {added}-{i}.in1")
    return [
        *lines,
        f"net {p}-value {value} {p}-cmd.in1 {p}-fb.in1",
        f"net {p}-motor joint.{chain.target}.motor-pos-cmd {p}-cmd.in0",
        f"net {p}-drive {p}-cmd.out",
        f"net {p}-encoder {p}-fb.in0",
        f"net {p}-feedback {p}-fb.out joint.{chain.target}.motor-pos-fb",
    ]


def _printed(value: Decimal) -> str:
    return f"{value:.{_DECIMALS}f}"


def parsed(data: bytes, path: Path) -> Chain:
    """Return what the file says; the wiring must be, word for word, that of `hal_lines`."""
    rows = _rows(data, path)
    name = r"comp(?:-[\da-f]-[\da-f])?"
    joint = rf"net {name}-position joint\.(\d{{1,2}})\.pos-cmd"
    source = int(_found(rows, joint, path, "net comp-position joint.N.pos-cmd"))
    motor = rf"net {name}-motor joint\.(\d{{1,2}})\.motor-pos-cmd {name}-cmd\.in0"
    target = int(_found(rows, motor, path, "net comp-motor joint.N.motor-pos-cmd comp-cmd.in0"))
    loaded = rf"loadrt lincurve names=({name})-0(?:,\S+)? personality=\S+"
    prefix = _found(rows, loaded, path, "loadrt lincurve names=comp-0,... personality=...")
    if prefix != "comp":
        prefix = Chain.prefix_of(source, target)
    thread = _found(rows, rf"addf {name}-fb ({THREAD.pattern})", path, "addf comp-fb THREAD")
    chain = Chain(_curves(rows, prefix, path), source, target, thread, prefix)
    wanted = hal_lines(chain)
    for (number, text), line in zip(rows, wanted, strict=False):
        if _plain(text) != _plain(line):
            raise _damaged(path, number, text, line)
    if len(rows) != len(wanted):
        number, text = rows[len(wanted)] if len(rows) > len(wanted) else (rows[-1][0] + 1, "")
        raise _damaged(path, number, text, wanted[len(rows)] if len(rows) < len(wanted) else "")
    return chain


def _plain(line: str) -> list[str]:
    """Return the words of a line, numbers in one spelling."""
    words = line.split()
    if words[0] == "setp" and len(words) == 3 and _PLAIN_NUMBER.fullmatch(words[2]):
        words[2] = _printed(Decimal(words[2]))
    return words


def _damaged(path: Path, number: int, found: str, wanted: str) -> CorruptFileError:
    return CorruptFileError(
        path,
        f"line {number} is not that of a lincurve chain",
        expected=repr(wanted[:80]) if wanted else "the end",
        found=repr(found[:80]) if found else "the end",
        hint="write the table again; only comments may be changed in this file",
    )


def _rows(data: bytes, path: Path) -> list[tuple[int, str]]:
    """Return the lines that are neither blank nor comments, each with its number."""
    hint = "this is not a HAL file of metrosep, or it was converted; LinuxCNC wants ASCII and LF"
    text = decoded(data, path, "HAL file of metrosep")
    if "\\" in text:
        line = text[: text.index("\\")].count("\n") + 1
        raise CorruptFileError(
            path,
            f"line {line} holds a backslash: HAL joins that line with the next, comments too",
            hint="take it out, or write the table again",
        )
    if not text.endswith("\n") or not text.replace("\n", " ").isprintable():
        raise CorruptFileError(path, "cut in a line, or with control characters", hint=hint)
    rows, _ = code_rows(text.split("\n"), "#")
    if not rows:
        raise CorruptFileError(path, "no HAL command in it", hint=hint)
    return rows


def _found(rows: Sequence[tuple[int, str]], pattern: str, path: Path, shown: str) -> str:
    for _, line in rows:
        match = re.fullmatch(pattern, " ".join(line.split()))
        if match:
            return match[1]
    raise damaged(
        path,
        "a line of the wiring is missing or its prefix is not comp or comp-N-N",
        expected=shown,
    )


def _curves(rows: Sequence[tuple[int, str]], prefix: str, path: Path) -> tuple[Curve, ...]:
    """Return the points of the curves in their order, checked to be a chain."""
    loaded = r"loadrt lincurve names=\S+ personality=(\d{1,2}(?:,\d{1,2})*)"
    sizes = _found(rows, loaded, path, "loadrt lincurve names=... personality=16,16,...")
    counts = [int(s) for s in sizes.split(",")]
    if len(counts) > MAX_CURVES or not all(2 <= c <= POINTS_PER_CURVE for c in counts):
        raise damaged(
            path,
            "LinuxCNC would not load these curves or change them",
            field="personality",
            expected=f"at most {MAX_CURVES} numbers from 2 to {POINTS_PER_CURVE}",
            found=sizes[:80],
        )
    values: dict[str, tuple[int, Decimal]] = {}
    for number, line in rows:
        words = line.split()
        if words[0] != "setp" or len(words) != 3 or "-val-" not in words[1]:
            continue
        if not _PLAIN_NUMBER.fullmatch(words[2]) or words[1] in values:
            raise _damaged(path, number, line, f"setp {words[1]} <a number, once>")
        values[words[1]] = number, Decimal(words[2])

    def value(name: str) -> Decimal:
        if name not in values:
            raise damaged(path, f"{name} is not set: it would be 0")
        return values[name][1]

    curves = tuple(
        tuple(
            (value(f"{prefix}-{k}.x-val-{i:02d}"), value(f"{prefix}-{k}.y-val-{i:02d}"))
            for i in range(count)
        )
        for k, count in enumerate(counts)
    )
    _check_chain(curves, values, prefix, path)
    return curves


def _check_chain(
    curves: Sequence[Curve], values: dict[str, tuple[int, Decimal]], prefix: str, path: Path
) -> None:
    for k, curve in enumerate(curves):
        for i in range(1, len(curve)):
            if curve[i][0] <= curve[i - 1][0]:
                line = values[f"{prefix}-{k}.x-val-{i:02d}"][0]
                raise damaged(path, f"line {line}: the position does not rise")
        if k and (curve[0][0] != curves[k - 1][-1][0] or curve[0][1] != 0):
            line = values[f"{prefix}-{k}.x-val-00"][0]
            raise damaged(
                path,
                f"line {line}: curve {prefix}-{k} does not start at zero where {prefix}-{k - 1} ends",
            )


# ------------------------------------------------------------------------------------------------

_MM = 1e-3
_DEGREE = math.pi / 180.0

_NAME = re.compile(r"[!-'*-\[\]-~]{1,40}( [!-'*-\[\]-~]{1,40}){0,3}")
"""A name that a comment of HAL holds as it is: printable ASCII, without backslash and parentheses."""
_COMMENT = re.compile(
    r"# metrosep: (.+?) \(joint \d+(, degrees)?\) -> (.+?) \(joint \d+(, degrees)?\), \d+ points"
)


class LinuxCNCLincurve(Dialect):
    """Writer and reader of HAL files with chained lincurves; see the module."""

    info = DialectInfo(
        id="linuxcnc-lincurve",
        title="LinuxCNC table across axes, chained lincurves in HAL",
        entry="correction added to the motor command: -e; of curve 2 and on, less its first point",
        units="mm (machine units of the configuration); of an axis that turns degrees",
        max_points=CHAIN_POINTS,
        outside="constant beyond both ends",
        sign_status="confirmed by running LinuxCNC 2.9",
        activation=(
            "take out of your HAL files the addf lines of motion-command-handler and motion-controller",
            "take out the nets of the corrected joint's motor-pos-cmd and motor-pos-fb",
            "put HALFILE = <name of the file> into [HAL], after the file that loads motmod and encoders",
            "add the functions that write the drives to the thread after this file",
            "connect signal comp-S-T-drive to the drive and comp-S-T-encoder to the encoder of joint T (S: looked up)",
            "HAL loads lincurve and sum2 once: if you use them elsewhere too, or have two such files, set TWOPASS = ON",
            "of two such files motion-command-handler and motion-controller are added once, behind both comp-S-T-fb",
            "the TYPE of a joint that turns must be ANGULAR: its numbers are degrees",
            "restart LinuxCNC, move the looked-up axis, read pin comp-S-T-cmd.in1: the correction in mm",
        ),
        sign="confirmed",
        directions="one",
        resolution="0.1 pm (double inside HAL)",
        reference_rule="zero where the looked-up joint is zero; it acts before homing too",
        proof="LinuxCNC 2.9 itself, headless",
        suffix=".hal",
        example={"source_joint": 0, "target_joint": 2},
        page="linuxcnc",
    )

    options = (
        whole(
            "source_joint", "number of the joint whose position is looked up", 0, 15, required=True
        ),
        whole("target_joint", "number of the joint that is corrected", 0, 15, required=True),
        Option("thread", "name of the servo thread in HAL", "text", default="servo-thread"),
    )

    def encode(self, table: CompensationTable, **options: Any) -> Encoded:
        """Return HAL commands."""
        o = self.filled(options)
        source_joint, target_joint, thread = (o[n.name] for n in self.options)
        _check_table(table, source_joint, target_joint)
        if not THREAD.fullmatch(thread):
            raise DataError(
                f"linuxcnc-lincurve: thread={thread!r} is not a name of a thread in HAL"
            )
        (unit, name), (unit_c, name_c) = _unit_along(table.axis), _unit_along(table.compensates)
        x = [round(v / unit * UNIT) for v in table.positions.tolist()]
        y = [round(v / unit_c * UNIT) for v in table.forward.tolist()]
        if any(b <= a for a, b in itertools.pairwise(x)):
            raise TableError(f"positions closer than 1e-{_DECIMALS} {name} cannot be written")
        chain = Chain(
            cut(x, y), source_joint, target_joint, thread,
            Chain.prefix_of(source_joint, target_joint),
        )  # fmt: skip
        carried = [float(v) * unit_c for _, v in chain.knots()]
        lines = [
            _comment(table, source_joint, target_joint),
            f"# adds the correction -e ({name_c}) to the motor command and takes it out of the feedback",
            *hal_lines(chain),
        ]
        return Encoded(
            data=("\n".join(lines) + "\n").encode("ascii", "replace"),
            quantisation=float(np.abs(np.array(carried) - table.forward).max()),
            notes={
                "hal_file": "[HAL] HALFILE = <this file>, in place of the addf lines of motmod",
                "signals": {
                    f"{chain.prefix}-drive": "to the drive",
                    f"{chain.prefix}-encoder": "from the encoder",
                },
            },
        )

    def decode(self, data: bytes, path: Path, **options: Any) -> CompensationTable:
        """Return the table, refusing wiring that is not the one that was proven.

        Notes
        -----
        Without the comment that names the axes and without a sidecar nothing states degrees: the numbers are
        taken as millimetres, and the axes are called after their joints.
        """
        chain = parsed(data, path)
        stated = (chain.source, chain.target, chain.thread)
        for option, found in zip(self.options, stated, strict=True):
            agreed(path, option.name, {"the file": found, "you": options.get(option.name)})
        knots = chain.knots()
        axes = _chain_axes(data, chain, path)
        unit, unit_c = _unit_along(axes["axis"])[0], _unit_along(axes["compensates"])[0]
        positions = [float(x) * unit for x, _ in knots]
        return read_table(
            np.array(positions),
            np.array([float(y) * unit_c for _, y in knots]),
            **{**identity(path), **axes},
        )

    def lookup(self, data: bytes, path: Path, **options: Any) -> Simulator:
        """Return the sum of the clamped curves, as HAL's sum2 adds them."""
        table = self.decode(data, path, **options)
        unit, unit_c = _unit_along(table.axis)[0], _unit_along(table.compensates)[0]
        curves = [np.array(c, dtype=np.float64).T for c in parsed(data, path).curves]

        def along(p: FloatArray) -> FloatArray:
            parts = [np.interp(p / unit, x, y) for x, y in curves]
            total = parts[0]
            for part in parts[1:]:
                total = total + part
            return np.asarray(total * unit_c)

        return one_way(along)


def _check_table(table: CompensationTable, source: int, target: int) -> None:
    if table.reverse is not None:
        raise (
            TableError(
                "a lincurve knows no direction, this table has a column for each: make it with "
                "direction='both', or write controller='linuxcnc' with cross_axis='hal', which has two"
            )
            .hinting(direction="both")
            .hinting(cross_axis=Example("hal"))
        )
    if table.is_on_axis != (source == target):
        raise TableError(
            f"the table is {table.axis} -> {table.compensates}, the joints are {source} -> {target}: "
            "one of the two is wrong"
        )
    for axis in (table.axis, table.compensates):
        if not _NAME.fullmatch(axis):
            raise TableError(
                f"the axis name {axis!r} cannot stand in a comment of HAL: use printable ASCII without "
                "backslash and parentheses, such as 'X'"
            )
    n = table.positions.size
    unit, name = _unit_along(table.axis)
    if n > CHAIN_POINTS:
        raise LimitError(
            f"{n} points, {MAX_CURVES} lincurves take {CHAIN_POINTS}; use a spacing of at least "
            f"{(table.span[1] - table.span[0]) / (CHAIN_POINTS - 1) / unit:.4g} {name}"
        )


def _unit_along(axis: str) -> tuple[float, str]:
    """Return the unit of an axis in SI, and its name."""
    return (_DEGREE, "degrees") if is_rotary(axis) else (_MM, "mm")


def _comment(table: CompensationTable, source: int, target: int) -> str:
    ends = [
        f"{axis} (joint {joint}{', degrees' if is_rotary(axis) else ''})"
        for axis, joint in ((table.axis, source), (table.compensates, target))
    ]
    return f"# metrosep: {ends[0]} -> {ends[1]}, {table.positions.size} points"


def _chain_axes(data: bytes, chain: Chain, path: Path) -> dict[str, str]:
    """Return the names in the sidecar, in a comment of the file, or those of the joints."""
    lines = {line.strip() for line in data.decode("ascii").split("\n")}
    found = [m for m in map(_COMMENT.fullmatch, sorted(lines)) if m]
    if len(found) > 1:
        raise CorruptFileError(
            path,
            f"{len(found)} comments that name the axes contradict each other",
            found=repr([m[0][:60] for m in found[:2]]),
            hint="keep the one that was written",
        )
    match = found[0] if found else None
    names = (match[1], match[3]) if match else (f"joint {chain.source}", f"joint {chain.target}")
    said = tuple(map(is_rotary, names))
    if match and said != (match[2] is not None, match[4] is not None):
        raise CorruptFileError(
            path,
            "a comment does not say of every axis that turns, and of no other, that it is in degrees",
            found=repr(match[0][:80]),
            hint="write the table again; earlier versions wrote thousandths of a radian",
        )
    if sidecar_path(path).is_file():
        known = identity(path, first=0.0)
        names = known["axis"], known["compensates"]
        if tuple(map(is_rotary, names)) != said:
            raise damaged(
                path,
                "file and sidecar contradict each other on what is in degrees",
                expected=" -> ".join(names),
                found=repr(match[0][:80]) if match else "no comment that names the axes",
            )
    return {"axis": names[0], "compensates": names[1]}
