"""LinuxCNC: a table across axes as a chain of HAL's ``lincurve`` components.

A lincurve interpolates at most 16 points and is constant outside them. A longer table f is cut into
pieces that share their end points; every piece but the first starts at zero, so that at any position
the pieces before it have run to their ends, those behind it are still zero, and the sum is f. The
sum is added to the motor command of the corrected joint and taken out of its feedback again.
Of an axis that turns the numbers are degrees, and the first comment of the file says so.
Confirmed by running the controller (tests/acceptance/linuxcnc).
"""

from __future__ import annotations

import itertools
import math
import re
from pathlib import Path
from typing import Any

import numpy as np

from metrosep.compensation.area_errors import is_rotary
from metrosep.compensation.table import CompensationTable
from metrosep.controllers._lincurve_chain import (
    DECIMALS,
    MAX_CURVES,
    MAX_POINTS,
    POINTS_PER_CURVE,
    THREAD,
    UNIT,
    Chain,
    cut,
    hal_lines,
    parsed,
)
from metrosep.controllers._lookups import one_way
from metrosep.controllers.base import (
    Dialect,
    DialectInfo,
    Encoded,
    Simulator,
    identity,
    sidecar_path,
)
from metrosep.controllers.options import Option
from metrosep.core._arrays import FloatArray
from metrosep.core.errors import CorruptFileError, DataError, LimitError, TableError

__all__ = ["MAX_CURVES", "MAX_POINTS", "POINTS_PER_CURVE", "LinuxCNCLincurve"]


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
        max_points=MAX_POINTS,
        outside="constant beyond both ends",
        sign_status="confirmed by running LinuxCNC 2.9",
        activation=(
            "take out of your HAL files the addf lines of motion-command-handler and motion-controller",
            "take out the nets of the corrected joint's motor-pos-cmd and motor-pos-fb",
            "put HALFILE = <name of the file> into [HAL], after the file that loads motmod and encoders",
            "add the functions that write the drives to the thread after this file",
            "connect signal comp-drive to the drive and comp-encoder to the encoder of that joint",
            "HAL loads lincurve and sum2 once: if you use them elsewhere, put all names into one line",
            "the TYPE of a joint that turns must be ANGULAR: its numbers are degrees",
            "restart LinuxCNC, move the looked-up axis, read pin comp-cmd.in1: the correction in mm",
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
        Option(
            "source_joint",
            "number of the joint whose position is looked up",
            "integer",
            required=True,
            lowest=0,
            highest=15,
        ),
        Option(
            "target_joint",
            "number of the joint that is corrected",
            "integer",
            required=True,
            lowest=0,
            highest=15,
        ),
        Option("thread", "name of the servo thread in HAL", "text", default="servo-thread"),
    )

    def encode(
        self,
        table: CompensationTable,
        *,
        source_joint: int = 0,
        target_joint: int = 0,
        thread: str = "servo-thread",
        **options: Any,
    ) -> Encoded:
        """Return HAL commands."""
        _check_table(table, source_joint, target_joint)
        if not THREAD.fullmatch(thread):
            raise DataError(f"linuxcnc-lincurve: thread={thread!r} is no name of a thread in HAL")
        (unit, name), (unit_c, name_c) = _unit(table.axis), _unit(table.compensates)
        x = [round(v / unit * UNIT) for v in table.positions.tolist()]
        y = [round(v / unit_c * UNIT) for v in table.forward.tolist()]
        if any(b <= a for a, b in itertools.pairwise(x)):
            raise TableError(f"positions closer than 1e-{DECIMALS} {name} cannot be written")
        chain = Chain(cut(x, y), source_joint, target_joint, thread)
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
                "signals": {"comp-drive": "to the drive", "comp-encoder": "from the encoder"},
            },
        )

    def decode(self, data: bytes, path: Path, **options: Any) -> CompensationTable:
        """Return the table, refusing wiring that is not the one that was proven.

        Notes
        -----
        Without the comment that names the axes and without a sidecar nothing tells degrees: the numbers are
        taken as millimetres, and the axes are called after their joints.
        """
        chain = parsed(data, path)
        for name, found in (
            ("source_joint", chain.source),
            ("target_joint", chain.target),
            ("thread", chain.thread),
        ):
            if options.get(name) is not None and options[name] != found:
                raise DataError(f"{path}: {name} is {found} in the file, not {options[name]}")
        knots = chain.knots()
        axes = _axes(data, chain, path)
        unit, unit_c = _unit(axes["axis"])[0], _unit(axes["compensates"])[0]
        positions = [float(x) * unit for x, _ in knots]
        return CompensationTable(
            positions=np.array(positions),
            forward=np.array([float(y) * unit_c for _, y in knots]),
            reverse=None,
            is_exact_inverse=True,
            **{**identity(path, first=positions[0]), **axes},
        )

    def lookup(self, data: bytes, path: Path, **options: Any) -> Simulator:
        """Return the sum of the clamped curves, as HAL's sum2 adds them."""
        table = self.decode(data, path, **options)
        unit, unit_c = _unit(table.axis)[0], _unit(table.compensates)[0]
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
        raise TableError(
            "a lincurve knows no direction, this table has a column for each: make it with "
            "direction='both', or write controller='linuxcnc' with cross_axis='hal', which has two"
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
    unit, name = _unit(table.axis)
    if n > MAX_POINTS:
        raise LimitError(
            f"{n} points, {MAX_CURVES} lincurves take {MAX_POINTS}; use a spacing of at least "
            f"{(table.span[1] - table.span[0]) / (MAX_POINTS - 1) / unit:.4g} {name}"
        )


def _unit(axis: str) -> tuple[float, str]:
    """Return the unit of an axis in SI, and its name."""
    return (_DEGREE, "degrees") if is_rotary(axis) else (_MM, "mm")


def _comment(table: CompensationTable, source: int, target: int) -> str:
    ends = [
        f"{axis} (joint {joint}{', degrees' if is_rotary(axis) else ''})"
        for axis, joint in ((table.axis, source), (table.compensates, target))
    ]
    return f"# metrosep: {ends[0]} -> {ends[1]}, {table.positions.size} points"


def _axes(data: bytes, chain: Chain, path: Path) -> dict[str, str]:
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
            raise CorruptFileError(
                path,
                "file and sidecar contradict each other on what is in degrees",
                expected=" -> ".join(names),
                found=repr(match[0][:80]) if match else "no comment that names the axes",
                hint="write the table again",
            )
    return {"axis": names[0], "compensates": names[1]}
