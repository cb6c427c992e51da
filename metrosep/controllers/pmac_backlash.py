"""Turbo PMAC backlash compensation over position, ``DEFINE BLCOMP``.

While a motor's last commanded direction is negative, Ixx86 plus the value of the table is
subtracted from its commanded position. Besides a table of the forward correction (`pmac`), which
acts both ways, the reverse direction gets its own: the entry is the difference of the errors,
``round(16 (e_rev - e_fwd) / count)``. The table is zero at the zero of the motor by definition, so
the lost motion there is Ixx86, and the entries hold what is more or less than that. A file of this
kind holds the difference only: read back, its forward correction is zero.

References: Delta Tau, Turbo PMAC Software Reference, DEFINE BLCOMP, Ixx85 to Ixx87, I51; Turbo PMAC
User Manual, backlash compensation.
"""

from __future__ import annotations

import hashlib
import os
import re
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from metrosep.compensation.limits import Finding
from metrosep.compensation.measured import measured_error
from metrosep.compensation.table import CompensationTable
from metrosep.compensation.uniform import resampling_error
from metrosep.controllers._grids import enclosing_nodes, rolled_values, rolling_grid
from metrosep.controllers._plain_text import is_same, printable, resolved
from metrosep.controllers.base import (
    Dialect,
    DialectInfo,
    Encoded,
    Simulator,
    load_bytes,
    load_sidecar,
    looked_up,
    require_unchanged,
)
from metrosep.controllers.options import Option
from metrosep.controllers.pmac import (
    ACTIVATION,
    AGAIN,
    LARGEST,
    MOTORS,
    PMAC,
    SCALE,
    Program,
    entry_lines,
    length_facts,
    motor_facts,
    motor_range,
    motors_of,
    named_axes,
    read_program,
    refuse_turning,
    require_short_span,
    rounded_entries,
    signed,
)
from metrosep.core._arrays import FloatArray
from metrosep.core.errors import (
    CorruptFileError,
    LimitError,
    SignCheckFailedError,
    TableError,
)
from metrosep.core.units import format_length

__all__ = ["PMACBacklash"]


_DEFINE = re.compile(
    r"#(?P<motor>\d{1,2})\s*DEFINE\s+BLCOMP\s+(?P<entries>\d{1,6})\s*,\s*(?P<span>\d{1,15})",
    re.IGNORECASE,
)
_SIZE, _RATE = 86, 85
"""Ixx86: backlash at the zero of the motor; Ixx85: how fast it is taken up."""

_TOLD = ("source_sign", "motor_zero")
"""Options that are never guessed when a file is read."""

_POINTS = 2001
"""Positions at which the lost motion is judged."""

_CLOSE = 0.1
"""Difference of the table besides from the forward column, over its span, that is worth a word."""


class PMACBacklash(Dialect):
    """Writer and reader of backlash tables; see the module."""

    info = DialectInfo(
        id="pmac-backlash",
        title="Turbo PMAC backlash compensation over position (DEFINE BLCOMP)",
        entry="subtracted while moving negative, in 1/16 count: round(16 (e_rev - e_fwd) / count), "
        "less Ixx86",
        units="1/16 count; span in counts",
        max_points=None,
        outside="rolls over: the position is taken modulo the span",
        sign_status="documented: subtracted in the negative direction (Software Reference)",
        activation=(
            (
                "load the forward corrections (DEFINE COMP) first: they cannot be defined any more "
                "once a BLCOMP table exists"
            ),
            *ACTIVATION,
            (
                "set Ixx85, the rate of taking up, above zero: with 0 nothing is taken up; and Ixx87, "
                "the reversal that is needed before it is"
            ),
        ),
        sign="documented",
        spacing="uniform",
        directions="two",
        resolution="1/16 count",
        reference_rule="zero at the zero of the motor, by definition; the lost motion there is Ixx86",
        suffix=".pmc",
        example={"count": "10 nm", "motor": 1},
        page="pmac",
    )

    options = (
        Option(
            "count", "length of one count of the motor", "length", required=True, positive=True
        ),
        Option("motor", "number of the motor; 1 if omitted", "integer", lowest=1, highest=MOTORS),
        signed("source_sign", "the"),
        Option(
            "motor_zero",
            "position of the axis where the motor reads zero",
            "length",
            default=0.0,
        ),
        Option(
            "comp",
            "file of the forward corrections that act besides (controller pmac), for the dry-run "
            "and for simulating both together",
            "text",
        ),
        Option(
            "forward_active",
            "the forward direction was compensated already while the runs were measured: only the "
            "lost motion is judged, without comp=",
            "flag",
            default=False,
        ),
        Option(
            "rate",
            "Ixx85, sixteenths of a count taken up per background cycle; set elsewhere if omitted",
            "integer",
            lowest=1,
            highest=LARGEST,
        ),
        Option("span", "length after which positions roll over", "length", positive=True),
        Option("spacing", "distance of the entries", "length", positive=True),
        Option(
            "long_span",
            "you listed a table of more than 8388607 counts back from the controller",
            "flag",
            default=False,
        ),
        Option("first", "for reading: lowest position of the travel", "length"),
        Option("last", "for reading: highest position of the travel", "length"),
    )

    def encode(self, table: CompensationTable, **options: Any) -> Encoded:
        """Return DELETE lines, the DEFINE line, entries, Ixx86 and I51=1; SAVE comes after the trial."""
        refuse_turning(table.axis, table.compensates)
        _check(table, options)
        count, s, motor = (
            float(options["count"]),
            int(options["source_sign"]),
            options["motor"] or 1,
        )
        lost = _lost_motion(table)
        x = (s * (table.positions - options["motor_zero"]))[::s]
        y = lost[::s]
        base = round(SCALE * float(np.interp(0.0, x, y)) / count)
        if not 0 <= base <= LARGEST:
            raise LimitError(
                f"e_rev - e_fwd at the zero of the motor is {format_length(base * count / SCALE)}; "
                f"Ixx86 holds 0 ... {LARGEST} sixteenths of a count: a lost motion is positive, so "
                "check which runs are forward, and whether one is compensated already"
            )
        grid = rolling_grid(
            x,
            span=options["span"],
            spacing=options["spacing"],
            count=count,
            axis=table.axis,
        )
        require_short_span(grid.counts, options["long_span"], table.axis)
        fixed = base * count / SCALE
        values = rolled_values(grid, x, y - fixed, 0.51 * count / SCALE)
        at = options["motor_zero"] + s * grid.positions
        entries = rounded_entries(values, count, lambda k: format_length(float(at[k])))
        nodes = enclosing_nodes(grid.step, float(x[0]), float(x[-1]))
        carried = replace(
            table,
            **_in_axis(nodes * grid.step, values[nodes % grid.n] + fixed, options),
            u=None,
        )
        alone = replace(table, **_both(lost, s))
        data = _text(table, options, motor, base, (grid.n, grid.counts), np.roll(entries, -1))
        return Encoded(
            data=data,
            quantisation=float(np.abs(entries * count / SCALE - values).max()),
            step=count / SCALE,
            carried=carried,
            resampling_error=resampling_error(alone, carried),
            findings=_doubts(table, options, lost),
            notes={
                "span_counts": grid.counts,
                "entries": grid.n,
                f"I{motor}{_SIZE}": base,
                "comp_sha256": _digest(options["comp"]),
            },
            verification=self._judged_alone(table, data, options),
        )

    def _judged_alone(
        self, table: CompensationTable, data: bytes, options: Mapping[str, Any]
    ) -> dict[str, Any] | None:
        """Return the difference of the directions before and after, and refuse if it grows."""
        if not options["forward_active"]:
            return None
        x = np.linspace(*table.span, _POINTS)
        known = {k: v for k, v in options.items() if v is not None}
        lookup = self.lookup(data, Path(os.devnull), **known)
        before, added = _measured_difference(table, x), lookup(x, -1) - lookup(x, 1)
        sizes = [float(np.abs(before + sign * added).max()) for sign in (0, 1, -1)]
        if not sizes[1] < sizes[0]:
            raise SignCheckFailedError(
                f"the dry-run does not shrink the lost motion: {format_length(sizes[0])} -> "
                f"{format_length(sizes[1])}, with the reversed sign {format_length(sizes[2])}; nothing "
                "was written"
            )
        names = ("before_m", "after_m", "wrong_sign_m")
        return {
            "definition": "largest absolute reverse minus forward",
            **dict(zip(names, sizes, strict=True)),
        }

    def decode(self, data: bytes, path: Path, **options: Any) -> CompensationTable:
        """Return the difference of the directions: zero while moving positive."""
        nodes, step, known, program = self._read(data, path, options)
        n = nodes.size - 1
        low, high = motor_range(known, n, step, path)
        j = np.arange(low, high + 1)
        columns = _in_axis(j * step, nodes[j % n], known)
        return CompensationTable(
            **columns,
            is_exact_inverse=True,
            **named_axes(path, program.facts, float(columns["positions"][0]), same_motor=True),
        )

    def lookup(self, data: bytes, path: Path, **options: Any) -> Simulator:
        """Return what PMAC adds in each direction, with the table besides if `comp` names one."""
        nodes, step, known, program = self._read(data, path, options)
        n = nodes.size - 1
        axis = named_axes(path, program.facts, 0.0, same_motor=True)["axis"]
        besides = None
        if known.get("comp") is not None:
            besides = _besides(known["comp"], {**known, "axis": axis}, _hash_of_comp(path))

        def added(position: ArrayLike, direction: ArrayLike = 1) -> FloatArray:
            (p,), d = looked_up((position,), direction)
            s = known["source_sign"]
            u = np.mod(s * (p - known["motor_zero"]) / step, n)
            subtracted = s * np.interp(u, np.arange(n + 1), nodes)
            own = np.where(s * d < 0, -subtracted, 0.0)
            return np.asarray(own if besides is None else own + besides(p, d))

        return added

    def _read(
        self, data: bytes, path: Path, options: Mapping[str, Any]
    ) -> tuple[FloatArray, float, dict[str, Any], Program]:
        """Return what is subtracted at nodes 0 ... n in m of the motor, spacing, options, file."""
        found = _DEFINE.search(data.decode("ascii", errors="replace"))
        motor = int(found["motor"]) if found else 0
        size = 100 * motor + _SIZE
        program = read_program(
            data,
            path,
            _DEFINE,
            lambda m: int(m["entries"]),
            (51, size, 100 * motor + _RATE),
        )
        known = motors_of(
            {"motor": motor}, resolved(options, program.facts, path, self.options, _TOLD), path
        )
        n, counts = program.entries.size, int(program.define["span"])
        if n == 0 or counts < n:
            raise CorruptFileError(
                path,
                f"{n} entries over {counts} counts are no table",
                field="DEFINE BLCOMP",
                hint=AGAIN,
            )
        if program.entries[-1] != 0:
            raise CorruptFileError(
                path,
                "the last entry stands at the roll-over, where the table is zero by definition: the "
                "axis would jump there",
                field="last entry",
                expected=0,
                found=int(program.entries[-1]),
                hint=AGAIN,
            )
        if program.settings.get(size, -1) not in range(LARGEST + 1):
            raise CorruptFileError(
                path,
                f"the file does not set I{size}, the lost motion at the zero of the motor",
                field=f"I{size}",
                expected=f"0 ... {LARGEST}",
                found=program.settings.get(size, "nothing"),
                hint=f"add a line I{size}= with the value of the controller",
            )
        if program.settings.get(100 * motor + _RATE) == 0:
            raise CorruptFileError(
                path,
                "the rate is 0: PMAC would take up nothing",
                field=f"I{100 * motor + _RATE}",
                hint=AGAIN,
            )
        sixteenths = np.concatenate([[0], program.entries]) + program.settings[size]
        return sixteenths * known["count"] / SCALE, counts * known["count"] / n, known, program


def _column(table: CompensationTable, direction: int) -> FloatArray:
    return table.correction(table.positions, direction)


def _lost_motion(table: CompensationTable) -> FloatArray:
    """Return e_rev - e_fwd, which is c_fwd - c_rev."""
    return np.asarray(_column(table, 1) - _column(table, -1))


def _measured_difference(table: CompensationTable, x: FloatArray) -> FloatArray:
    """Return reverse minus forward of the runs that the table was made of, else of the table."""
    if table.source is not None:
        measured = measured_error(table.source, table.span)
        if measured.knows_lost_motion:
            rev, fwd = (
                np.mean([row.curves[d](x) for row in measured.rows], axis=0) for d in (-1, 1)
            )
            return np.asarray(rev - fwd)
    return np.asarray(table.correction(x, 1) - table.correction(x, -1))


def _both(lost: FloatArray, sign: int) -> dict[str, Any]:
    """Return columns with the lost motion in the direction in which the motor moves negative."""
    zero = np.zeros(lost.size)
    return {"forward": zero, "reverse": -lost} if sign > 0 else {"forward": lost, "reverse": zero}


def _in_axis(motor: NDArray[Any], lost: NDArray[Any], known: Mapping[str, Any]) -> dict[str, Any]:
    """Return positions and columns of the axis, from positions of the motor."""
    s = known["source_sign"]
    return {
        "positions": (known["motor_zero"] + s * motor)[::s],
        **_both(np.asarray(lost[::s] + 0.0), s),
    }


def _check(table: CompensationTable, options: Mapping[str, Any]) -> None:
    if not table.is_on_axis:
        raise TableError(
            f"a backlash table corrects its own axis, this one is {table.axis} -> "
            f"{table.compensates}; make it with one direction (direction='both') for controller='pmac'"
        )
    if table.reverse is None:
        raise TableError(
            "a backlash table needs forward and reverse corrections, this table has one for both; "
            "make it with direction='split', or write controller='pmac'"
        )
    if options["forward_active"] and options["comp"] is not None:
        raise TableError(
            "forward_active= says that the forward corrections acted while the runs were measured, "
            "comp= names forward corrections that are new: say one of them"
        )
    low, high = table.span
    for name, end in (("first", low), ("last", high)):
        if options[name] is not None and options[name] != end:
            raise TableError(f"{name}= is for reading; the table ends at {format_length(end)}")


def _text(
    table: CompensationTable,
    options: Mapping[str, Any],
    motor: int,
    base: int,
    size: tuple[int, int],
    entries: NDArray[np.int64],
) -> bytes:
    axis = printable(table.axis, "axis")
    low, high = table.span
    rate = [] if options["rate"] is None else [f"I{motor}{_RATE}={options['rate']}"]
    lines = [
        (
            f"; metrosep: lost motion of {axis} (#{motor}); entries and I{motor}{_SIZE} are subtracted "
            "while the motor moves negative, 16 (e_rev - e_fwd) / count"
        ),
        f"; axis = {axis}",
        f"; compensates = {axis}",
        *length_facts(
            count=options["count"], motor_zero=options["motor_zero"], first=low, last=high
        ),
        f"; source_sign = {options['source_sign']}",
        *motor_facts({"motor": motor}, "motor"),
        "DELETE GATHER",
        f"#{motor} DELETE BLCOMP",
        f"#{motor} DEFINE BLCOMP {size[0]},{size[1]}",
        *entry_lines(entries.tolist()),
        f"I{motor}{_SIZE}={base}",
        *rate,
        "I51=1",
    ]
    return ("\n".join(lines) + "\n").encode("ascii")


def _besides(name: str, known: Mapping[str, Any], written_with: object = None) -> Simulator:
    """Return the lookup of the forward corrections, which must be those of this very motor."""
    path = Path(name)
    data = load_bytes(path)
    require_unchanged(path, data)
    if written_with is not None and written_with != hashlib.sha256(data).hexdigest():
        raise CorruptFileError(
            path, "it is not the table that the backlash table was written with", field="comp",
            hint="write the backlash table again, with comp= of the file that is in use",
        )  # fmt: skip
    other = PMAC().facts(data, path)
    motor = known["motor"] or 1
    wanted = {
        "owner": motor,
        "source_motor": motor,
        "target_motor": motor,
        "axis": known["axis"],
        "source_sign": known["source_sign"],
        "motor_zero": known["motor_zero"],
        "count": known["count"],
    }
    for key, value in wanted.items():
        if not is_same(value, other[key], exact=key == "count"):
            raise TableError(
                f"comp={name}: its {key} is {other[key]}, that of the backlash table is {value} (SI units); "
                "it is the table of another motor or axis: name the file of the forward corrections of "
                f"{known['axis']} itself, motor #{motor}"
            )
    return PMAC().lookup(data, path)


def _digest(name: str | None) -> str | None:
    return None if name is None else hashlib.sha256(load_bytes(Path(name))).hexdigest()


def _hash_of_comp(path: Path) -> object:
    return load_sidecar(path).get("comp_sha256")


def _doubts(
    table: CompensationTable, options: Mapping[str, Any], lost: FloatArray
) -> tuple[Finding, ...]:
    found = []
    besides = None
    if options["comp"] is not None:
        besides = _besides(options["comp"], {**options, "axis": table.axis})
    if besides is None and not options["forward_active"]:
        found.append(
            Finding(
                "warning",
                "this file alone leaves the error of one direction as it is",
                "write the forward corrections as controller='pmac' and name their file in comp=: "
                "the dry-run is then of both together",
                "comp",
            )
        )
    elif besides is not None:
        way = 1 if options["source_sign"] > 0 else -1
        apart = float(np.abs(besides(table.positions) - _column(table, way)).max())
        if apart > _CLOSE * float(np.ptp(table.forward)):
            found.append(
                Finding(
                    "warning",
                    f"the table in comp= differs from the corrections of the direction in which the "
                    f"motor moves positive by up to {format_length(apart, digits=3)}",
                    "make that table with direction='forward' ('reverse' where source_sign is -1)",
                    "comp",
                )
            )
    if (lost < -0.5 * options["count"] / SCALE).any():
        found.append(
            Finding(
                "warning",
                f"e_rev - e_fwd falls to {format_length(float(lost.min()), digits=3)}: a lost motion is "
                "not negative",
                "check which runs are forward, and whether backlash is compensated already",
                "comp",
            )
        )
    return tuple(found)
