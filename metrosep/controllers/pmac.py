"""Turbo PMAC position compensation, ``DEFINE COMP`` over one motor.

The correction is added to the target motor's desired position, in 1/16 count of that motor; the
entry for an error e is therefore ``round(-16 e / count)``. The first entry stands one spacing from
the zero of the source motor, where the correction is zero by definition; the last one stands at
the span, which rolls over onto that zero. A negative position is read at the top of the table.

References: Delta Tau, Turbo PMAC Software Reference, DEFINE COMP (one-dimensional), I51; PMAC User
Manual, leadscrew compensation (range, roll-over). Grammar and numbers only.
"""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from metrosep.compensation.limits import Finding
from metrosep.compensation.table import CompensationTable
from metrosep.compensation.uniform import resampling_error
from metrosep.controllers._lookups import one_way
from metrosep.controllers._plain_text import agreed, printable, resolved
from metrosep.controllers._pmac_text import (
    ACTIVATION,
    AGAIN,
    MOTORS,
    SCALE,
    Program,
    entry_lines,
    length_facts,
    motor_facts,
    motors_of,
    named_axes,
    read_program,
    refuse_turning,
    require_short_span,
    rounded_entries,
    signed,
)
from metrosep.controllers._uniform import (
    RollingGrid,
    enclosing_nodes,
    rolled_values,
    rolling_grid,
)
from metrosep.controllers.base import Dialect, DialectInfo, Encoded, Simulator
from metrosep.controllers.options import Option
from metrosep.core._arrays import FloatArray
from metrosep.core.errors import CorruptFileError, TableError
from metrosep.core.units import format_length

__all__ = ["PMAC", "motor_range"]


_TOLD = ("source_sign", "motor_zero")
"""Options that are never guessed when a file is read."""

_DEFINE = re.compile(
    r"#(?P<owner>\d{1,2})\s*DEFINE\s+COMP\s+(?P<entries>\d{1,6})\s*,\s*"
    r"(?:#(?P<source>\d{1,2})(?P<desired>D?)\s*,\s*)?(?:#(?P<target>\d{1,2})\s*,\s*)?(?P<span>\d{1,15})",
    re.IGNORECASE,
)


def require_one_way(table: CompensationTable) -> None:
    """Refuse a table with two directions."""
    if table.reverse is not None and float(np.abs(table.reverse - table.forward).max()) >= 1e-12:
        raise TableError(
            "DEFINE COMP holds one correction for both directions, this table has two; make it with "
            "direction='forward' and write the one with both as controller='pmac-backlash' besides, "
            "or with direction='both'"
        )


def motor_range(options: Mapping[str, Any], n: int, step: float, path: Path) -> tuple[int, int]:
    """Return the first and last node that a file speaks of, negative below the zero of the motor."""
    first, last = options["first"], options["last"]
    if first is None or last is None:
        return 0, n
    ends = sorted(options["source_sign"] * (p - options["motor_zero"]) for p in (first, last))
    if max(ends[1], 0.0) - min(ends[0], 0.0) > (n + 0.5) * step:
        raise CorruptFileError(
            path,
            "the positions it is made for do not fit its span",
            field="first, last",
            expected=f"at most {format_length(n * step)} with the zero of the motor",
            found=f"{format_length(first)} ... {format_length(last)}",
            hint=AGAIN,
        )
    nodes = enclosing_nodes(step, ends[0], ends[1])
    return int(nodes[0]), int(nodes[-1])


class PMAC(Dialect):
    """Writer and reader of tables over one motor; see the module."""

    info = DialectInfo(
        id="pmac",
        title="Turbo PMAC position compensation (DEFINE COMP)",
        entry="correction added to the target motor in 1/16 count: round(-16 e / count)",
        units="1/16 count of the target motor; span in counts of the source motor",
        max_points=None,
        outside="rolls over: the position is taken modulo the span",
        sign_status="documented: added to the target's desired position (Software Reference)",
        activation=ACTIVATION,
        sign="documented",
        spacing="uniform",
        directions="one",
        resolution="1/16 count of the target motor",
        reference_rule="zero at the zero of the source motor, by definition",
        suffix=".pmc",
        example={"count": "10 nm", "source_motor": 1, "target_motor": 1},
        page="pmac",
    )

    options = (
        Option(
            "count",
            "length of one count of the target motor",
            "length",
            required=True,
            positive=True,
        ),
        Option(
            "source_count",
            "length of one count of the source motor; as count if omitted",
            "length",
            positive=True,
        ),
        Option(
            "source_motor",
            "number of the motor whose position is looked up; 1 if omitted",
            "integer",
            lowest=1,
            highest=MOTORS,
        ),
        Option(
            "target_motor",
            "number of the motor that is corrected; the source if omitted and "
            "the table corrects its own axis",
            "integer",
            lowest=1,
            highest=MOTORS,
        ),
        Option(
            "owner",
            "motor the table belongs to; the target if omitted",
            "integer",
            lowest=1,
            highest=MOTORS,
        ),
        Option(
            "desired", "look up the desired position (D), not the actual one", "flag", default=True
        ),
        signed("source_sign", "the source"),
        Option(
            "target_sign",
            "-1 if the counts of the target motor fall where its axis rises; as "
            "source_sign on one axis",
            "choice",
            choices=(1, -1),
        ),
        Option(
            "motor_zero",
            "position of the axis where the source motor reads zero",
            "length",
            default=0.0,
        ),
        Option(
            "span",
            "length after which positions roll over; chosen with a margin if omitted",
            "length",
            positive=True,
        ),
        Option(
            "spacing",
            "distance of the entries; that of the table if omitted",
            "length",
            positive=True,
        ),
        Option(
            "long_span",
            "you listed a table of more than 8388607 counts back from the controller",
            "flag",
            default=False,
        ),
        Option(
            "first",
            "for reading a file that does not say: lowest position of its travel",
            "length",
        ),
        Option(
            "last",
            "for reading a file that does not say: highest position of its travel",
            "length",
        ),
    )

    def encode(self, table: CompensationTable, **options: Any) -> Encoded:
        """Return DELETE lines, the DEFINE line, entries and I51=1; SAVE comes after the trial."""
        refuse_turning(table.axis, table.compensates)
        require_one_way(table)
        given = _checked_motors(table, options)
        count, s, t = given["count"], given["source_sign"], given["target_sign"]
        x = s * (table.positions - given["motor_zero"])
        y = t * table.forward
        x, y = (x, y) if s > 0 else (x[::-1], y[::-1])
        grid = rolling_grid(
            x,
            span=given["span"],
            spacing=given["spacing"],
            count=given["source_count"],
            axis=table.axis,
        )
        require_short_span(grid.counts, given["long_span"], table.axis)
        values = rolled_values(grid, x, y, 0.5 * count / SCALE)
        at = given["motor_zero"] + s * grid.positions
        entries = rounded_entries(values, count, lambda k: format_length(float(at[k])))
        nodes = enclosing_nodes(grid.step, float(x[0]), float(x[-1]))
        carried = replace(
            table,
            **_in_axis(nodes * grid.step, values[nodes % grid.n], given),
            reverse=None,
            u=None,
        )
        text = self._text(table, given, grid, np.roll(entries, -1))
        return Encoded(
            data=text.encode("ascii"),
            quantisation=float(np.abs(entries * count / SCALE - values).max()),
            step=count / SCALE,
            carried=carried,
            resampling_error=resampling_error(table, carried),
            findings=_doubts(options, given),
            notes={"span_counts": grid.counts, "entries": grid.n, "spacing_m": grid.step},
        )

    def _text(
        self,
        table: CompensationTable,
        given: Mapping[str, Any],
        grid: RollingGrid,
        entries: NDArray[np.int64],
    ) -> str:
        source, target, owner = given["source_motor"], given["target_motor"], given["owner"]
        axis, other = printable(table.axis, "axis"), printable(table.compensates, "axis")
        low, high = table.span
        lines = [
            (
                f"; metrosep: {axis} (#{source}) corrects {other} (#{target}); entries are added to "
                f"#{target}, -16 error / count"
            ),
            f"; axis = {axis}",
            f"; compensates = {other}",
            *length_facts(
                count=given["count"],
                source_count=given["source_count"],
                motor_zero=given["motor_zero"],
                first=low,
                last=high,
            ),
            f"; source_sign = {given['source_sign']}",
            f"; target_sign = {given['target_sign']}",
            *motor_facts(given, "source_motor", "target_motor", "owner"),
            "DELETE GATHER",
            f"#{owner} DELETE COMP",
            (
                f"#{owner} DEFINE COMP {grid.n},#{source}{'D' if given['desired'] else ''},#{target},"
                f"{grid.counts}"
            ),
            *entry_lines(entries.tolist()),
            "I51=1",
        ]
        return "\n".join(lines) + "\n"

    def decode(self, data: bytes, path: Path, **options: Any) -> CompensationTable:
        """Return the table over the travel it was made for."""
        nodes, step, known, program = self._read(data, path, options)
        n = nodes.size - 1
        low, high = motor_range(known, n, step, path)
        j = np.arange(low, high + 1)
        columns = _in_axis(j * step, nodes[j % n], known)
        return CompensationTable(
            **columns,
            reverse=None,
            is_exact_inverse=True,
            **named_axes(
                path,
                program.facts,
                float(columns["positions"][0]),
                same_motor=known["source_motor"] == known["target_motor"],
            ),
        )

    def lookup(self, data: bytes, path: Path, **options: Any) -> Simulator:
        """Return what PMAC adds: linear between the entries, rolled over, one value both ways."""
        nodes, step, known, _ = self._read(data, path, options)
        n = nodes.size - 1

        def at(position: FloatArray) -> FloatArray:
            motor = known["source_sign"] * (position - known["motor_zero"])
            u = np.mod(motor / step, n)
            return np.asarray(known["target_sign"] * np.interp(u, np.arange(n + 1), nodes))

        return one_way(at)

    def facts(self, data: bytes, path: Path, **options: Any) -> dict[str, Any]:
        """Return what a file says of its machine."""
        _, _, known, program = self._read(data, path, options)
        same = known["source_motor"] == known["target_motor"]
        return {**known, **named_axes(path, program.facts, 0.0, same_motor=same)}

    def _read(
        self, data: bytes, path: Path, options: Mapping[str, Any]
    ) -> tuple[FloatArray, float, dict[str, Any], Program]:
        """Return corrections of the motor at nodes 0 ... n in m, the spacing, options, the file."""
        program = read_program(data, path, _DEFINE, lambda m: int(m["entries"]))
        define, owner = program.define, int(program.define["owner"])
        motors = {k: int(define[k] or owner) for k in ("source", "target")}
        same = motors["source"] == motors["target"]
        told = _TOLD if same else (*_TOLD, "source_count", "target_sign")
        known = motors_of(
            {**{f"{k}_motor": v for k, v in motors.items()}, "owner": owner},
            resolved(options, program.facts, path, self.options, told),
            path,
        )
        if same:
            for name, own in (("source_count", "count"), ("target_sign", "source_sign")):
                known[name] = agreed(
                    name,
                    {f"{own} of the one motor": known[own], "the file or user": known[name]},
                    path,
                )
        n, counts = program.entries.size, int(program.define["span"])
        if n == 0 or counts < n:
            raise CorruptFileError(
                path,
                f"{n} entries over {counts} counts are no table",
                field="DEFINE COMP",
                hint=AGAIN,
            )
        if program.entries[-1] != 0:
            raise CorruptFileError(
                path,
                "the last entry stands at the roll-over, where the correction is zero by definition: "
                "the axis would jump there",
                field="last entry",
                expected=0,
                found=int(program.entries[-1]),
                hint=AGAIN,
            )
        nodes = np.concatenate([[0.0], program.entries * known["count"] / SCALE])
        return nodes, counts * known["source_count"] / n, known, program


def _in_axis(
    motor: NDArray[Any], values: NDArray[Any], known: Mapping[str, Any]
) -> dict[str, Any]:
    """Return positions and corrections of the axes, from those of the motors."""
    positions = known["motor_zero"] + known["source_sign"] * motor
    forward = known["target_sign"] * values + 0.0
    if known["source_sign"] < 0:
        positions, forward = positions[::-1], forward[::-1]
    return {"positions": positions, "forward": forward}


def _checked_motors(table: CompensationTable, options: Mapping[str, Any]) -> dict[str, Any]:
    """Return the options with what follows from others filled in; refuse contradictions."""
    given = dict(options)
    given["source_motor"] = given["source_motor"] or 1
    if given["target_motor"] is None:
        if not table.is_on_axis:
            raise TableError(
                f"this table corrects {table.compensates} over {table.axis}: say which motor is "
                f"{table.compensates} (target_motor=)"
            )
        given["target_motor"] = given["source_motor"]
    given["owner"] = given["owner"] or given["target_motor"]
    same = given["source_motor"] == given["target_motor"]
    if same != table.is_on_axis:
        raise TableError(
            f"this table corrects {table.compensates} over {table.axis}, but the source is motor "
            f"#{given['source_motor']} and the target #{given['target_motor']}; a motor moves one axis"
        )
    given["source_count"] = given["source_count"] or given["count"]
    if given["target_sign"] is None:
        given["target_sign"] = given["source_sign"] if same else 1
    if same and (
        given["source_count"] != given["count"] or given["target_sign"] != given["source_sign"]
    ):
        raise TableError(
            f"source and target are both motor #{given['source_motor']}: its count and its sign are "
            "one; leave source_count and target_sign away"
        )
    low, high = table.span
    for name, end in (("first", low), ("last", high)):
        if given[name] is not None and given[name] != end:
            raise TableError(
                f"{name}= is for reading; the table itself ends at {format_length(end)}"
            )
    return given


def _doubts(options: Mapping[str, Any], given: Mapping[str, Any]) -> tuple[Finding, ...]:
    found = []
    if options["source_motor"] is None:
        found.append(
            Finding("warning", "motor #1 was taken as the source", "say source_motor=", "motors")
        )
    if given["source_motor"] == given["target_motor"] and not given["desired"]:
        found.append(
            Finding(
                "warning",
                "a motor that is corrected over its own actual position follows its own noise",
                "look up the desired position (desired=True)",
                "desired",
            )
        )
    return tuple(found)
