"""Turbo PMAC position compensation over two motors, ``DEFINE COMP rows.columns``.

The correction is added to the target motor, in 1/16 count of it: ``round(-16 e / count)``. The
first motor of the line (the "row motor") runs along a row, from column to column; the second one
(the "column motor") runs from row to row. The spacing of the columns is therefore the row motor's
span over the number of columns, and the other way round. Here the row motor is the first axis of
the map (x, its columns), the column motor the second (y, its rows). Row 0 starts at column 1,
because the correction at both zeros is zero by definition; every other row starts at column 0.

Reference: Delta Tau, Turbo PMAC Software Reference, DEFINE COMP (two-dimensional).
"""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from metrosep.compensation.area_errors import bilinear
from metrosep.compensation.limits import Finding
from metrosep.compensation.maps import CompensationMap
from metrosep.controllers._grids import (
    RollingGrid,
    enclosing_nodes,
    holds_zero,
    rolled_weights,
    rolling_grid,
)
from metrosep.controllers._plain_text import printable, resolved
from metrosep.controllers.base import (
    Dialect,
    DialectInfo,
    Encoded,
    Simulator,
    load_sidecar,
    one_way,
)
from metrosep.controllers.options import Option
from metrosep.controllers.pmac import (
    ACTIVATION,
    AGAIN,
    MOTORS,
    SCALE,
    Program,
    entry_lines,
    length_facts,
    motor_facts,
    motor_range,
    motors_of,
    read_program,
    refuse_turning,
    require_short_span,
    rounded_entries,
    signed,
)
from metrosep.core._arrays import FloatArray
from metrosep.core.errors import CorruptFileError, DataError, TableError
from metrosep.core.units import format_length

__all__ = ["PMACPlane"]


_FINEST = 200
"""Intervals of an axis that are chosen without asking, where positions are not uniform."""

_TOLD = ("x_count", "y_count", "x_sign", "y_sign", "target_sign", "x_zero", "y_zero")
"""Options that are never guessed when a file is read."""

_DEFINE = re.compile(
    r"#(?P<owner>\d{1,2})\s*DEFINE\s+COMP\s+(?P<rows>\d{1,6})\.(?P<columns>\d{1,6})\s*,\s*"
    r"#(?P<x>\d{1,2})D?\s*,\s*(?:#(?P<y>\d{1,2})D?\s*,\s*)?(?:#(?P<target>\d{1,2})\s*,\s*)?"
    r"(?P<row_span>\d{1,15})\s*,\s*(?P<column_span>\d{1,15})",
    re.IGNORECASE,
)


@dataclass(frozen=True, slots=True)
class _Side:
    """One of the two source motors, with its options under the names of one motor."""

    axis: str
    motor: int
    count: float
    sign: int
    zero: float

    def to_motor(self, position: FloatArray) -> FloatArray:
        return np.asarray(self.sign * (position - self.zero))

    def to_axis(self, motor: NDArray[Any]) -> FloatArray:
        return np.asarray(self.zero + self.sign * motor)


def _side_options(name: str, which: str, motor: int) -> tuple[Option, ...]:
    return (
        Option(
            f"{name}_motor",
            f"motor of the {which} axis of the map; {motor} if omitted",
            "integer",
            lowest=1,
            highest=MOTORS,
        ),
        Option(
            f"{name}_count",
            f"length of one count of the {which} axis; as count if omitted",
            "length",
            positive=True,
        ),
        signed(f"{name}_sign", f"the {which}"),
        Option(
            f"{name}_zero", f"where the {which} axis's motor reads zero", "length", default=0.0
        ),
        Option(f"{name}_span", f"roll-over length of the {which} axis", "length", positive=True),
        Option(
            f"{name}_spacing", f"distance of nodes of the {which} axis", "length", positive=True
        ),
        Option(f"{name}_first", f"for reading: lowest position of the {which} axis", "length"),
        Option(f"{name}_last", f"for reading: highest position of the {which} axis", "length"),
    )


class PMACPlane(Dialect):
    """Writer and reader of tables over two motors; see the module."""

    info = DialectInfo(
        id="pmac-plane",
        title="Turbo PMAC position compensation over two motors (DEFINE COMP rows.columns)",
        entry="correction added to the target motor in 1/16 count: round(-16 e / count)",
        units="1/16 count of the target motor; spans in counts of the source motors",
        max_points=None,
        outside="rolls over: each position is taken modulo its span",
        sign_status="documented: added to the target's desired position (Software Reference)",
        activation=ACTIVATION,
        sign="documented",
        carries="map",
        spacing="uniform",
        directions="one",
        resolution="1/16 count of the target motor",
        reference_rule="zero where both source motors read zero, by definition",
        suffix=".pmc",
        example={"count": "10 nm", "x_motor": 1, "y_motor": 2, "target_motor": 3},
        page="pmac",
    )

    options = (
        Option(
            "count", "length of one count of the target motor", "length", required=True,
            positive=True,
        ),
        Option(
            "target_motor", "motor that is corrected; 3 if omitted, or the source that it is",
            "integer", lowest=1, highest=MOTORS,
        ),
        Option(
            "owner", "motor the table belongs to; the target if omitted", "integer", lowest=1,
            highest=MOTORS,
        ),
        Option("desired", "look up desired positions (D), not actual ones", "flag", default=True),
        Option(
            "target_sign", "-1 if the counts of the target motor fall where its axis rises",
            "choice", choices=(1, -1),
        ),
        Option(
            "long_span", "you listed a table of more than 8388607 counts back from the controller",
            "flag", default=False,
        ),
        *_side_options("x", "first", 1),
        *_side_options("y", "second", 2),
    )  # fmt: skip

    def encode(self, table: CompensationMap, **options: Any) -> Encoded:
        """Return DELETE lines, the DEFINE line, the entries row by row and I51=1; SAVE comes after the trial."""
        given = _checked(table, options)
        count, sign = given["count"], given["target_sign"]
        sides = _sides(table.axes, given)
        x, y, values = _in_motors(table, sides, sign)
        grids = tuple(
            rolling_grid(
                knots, span=given[f"{n}_span"], spacing=given[f"{n}_spacing"], count=side.count, finest=_FINEST,
                axis=side.axis,
            )
            for n, side, knots in zip("xy", sides, (x, y), strict=True)
        )  # fmt: skip
        for grid, side in zip(grids, sides, strict=True):
            require_short_span(grid.counts, given["long_span"], side.axis)
        nodes = _node_values(grids, x, y, values, 0.5 * count / SCALE)
        at = [s.to_axis(g.positions) for s, g in zip(sides, grids, strict=True)]

        def place(k: int) -> str:
            row, column = divmod(k, grids[0].n)
            here = format_length(float(at[0][column])), format_length(float(at[1][row]))
            return f"{table.axes[0]} {here[0]}, {table.axes[1]} {here[1]}"

        entries = rounded_entries(nodes.ravel(), count, place).reshape(nodes.shape)
        carried = _carried(table, grids, sides, nodes, (x, y), sign)
        return Encoded(
            data=_text(table, given, sides, grids, entries).encode("ascii"),
            quantisation=float(np.abs(entries * count / SCALE - nodes).max()),
            step=count / SCALE,
            carried=carried,
            resampling_error=_difference(table, carried),
            findings=_doubts(options),
            notes={
                "span_counts": [g.counts for g in grids],
                "columns": grids[0].n,
                "rows": grids[1].n,
            },
        )

    def decode(self, data: bytes, path: Path, **options: Any) -> CompensationMap:
        """Return the map over the travel it was made for."""
        nodes, steps, known, program = self._read(data, path, options)
        axes = _named(path, program.facts)
        sides = _sides(axes["axes"], known)
        positions, picked = [], []
        for name, side, step, n in zip("xy", sides, steps, nodes.shape[::-1], strict=True):
            ends = {
                "first": known[f"{name}_first"],
                "last": known[f"{name}_last"],
                "source_sign": side.sign,
                "motor_zero": side.zero,
            }
            low, high = motor_range(ends, n - 1, step, path)
            j = np.arange(low, high + 1)[:: side.sign]
            positions.append(side.to_axis(j * step))
            picked.append(j % (n - 1))
        values = known["target_sign"] * nodes[np.ix_(picked[1], picked[0])] + 0.0
        return CompensationMap(positions[0], positions[1], values, is_exact_inverse=True, **axes)

    def lookup(self, data: bytes, path: Path, **options: Any) -> Simulator:
        """Return what PMAC adds: bilinear between the entries, rolled over, one value both ways."""
        nodes, steps, known, _ = self._read(data, path, options)
        sides = _sides(("X", "Y"), known)
        rows, columns = nodes.shape

        def at(x: FloatArray, y: FloatArray) -> FloatArray:
            u = np.mod(sides[0].to_motor(x) / steps[0], columns - 1)
            v = np.mod(sides[1].to_motor(y) / steps[1], rows - 1)
            found = bilinear(np.arange(float(columns)), np.arange(float(rows)), nodes, u, v)
            return np.asarray(known["target_sign"] * found).reshape(x.shape)

        return one_way(at, 2)

    def _read(
        self, data: bytes, path: Path, options: Mapping[str, Any]
    ) -> tuple[FloatArray, tuple[float, float], dict[str, Any], Program]:
        """Return nodes (rows + 1, columns + 1) in m of the motor, spacings, options, the file."""
        program = read_program(
            data, path, _DEFINE, lambda m: (int(m["rows"]) + 1) * (int(m["columns"]) + 1) - 1
        )
        motors = {f"{k}_motor": program.define[k] for k in ("x", "y", "target")}
        lines = {k: int(v or program.define["owner"]) for k, v in motors.items()}
        lines["owner"] = int(program.define["owner"])
        told = resolved(options, program.facts, path, self.options, _TOLD)
        known = _filled(motors_of(lines, told, path))
        rows, columns = int(program.define["rows"]), int(program.define["columns"])
        spans = int(program.define["row_span"]), int(program.define["column_span"])
        if rows < 1 or columns < 1 or spans[0] < columns or spans[1] < rows:
            raise CorruptFileError(
                path,
                f"{rows} rows and {columns} columns over {spans[1]} and {spans[0]} counts are no table",
                field="DEFINE COMP",
                hint=AGAIN,
            )
        entries = np.concatenate([[0], program.entries]).reshape(rows + 1, columns + 1)
        if (entries[:, 0] != entries[:, -1]).any() or (entries[0] != entries[-1]).any():
            raise CorruptFileError(
                path,
                "the last column or row differs from the first: they are one place by roll-over, the "
                "axis would jump there",
                field="last column and row",
                expected="those of column 0 and row 0",
                hint=AGAIN,
            )
        steps = (
            spans[0] * known["x_count"] / columns,  # columns lie along the row motor
            spans[1] * known["y_count"] / rows,
        )
        return entries * known["count"] / SCALE, steps, known, program


def _text(
    table: CompensationMap,
    given: Mapping[str, Any],
    sides: tuple[_Side, ...],
    grids: tuple[RollingGrid, ...],
    entries: NDArray[np.int64],
) -> str:
    names = [printable(a, "axis") for a in (*table.axes, table.compensates)]
    closed = np.pad(entries, ((0, 1), (0, 1)), mode="wrap")
    d = "D" if given["desired"] else ""
    facts = {"count": given["count"]}
    for name, side, (low, high) in zip("xy", sides, table.span, strict=True):
        facts |= {
            f"{name}_count": side.count,
            f"{name}_zero": side.zero,
            f"{name}_first": low,
            f"{name}_last": high,
        }
    lines = [
        (
            f"; metrosep: {names[0]} (#{sides[0].motor}) and {names[1]} (#{sides[1].motor}) correct "
            f"{names[2]} (#{given['target_motor']}); entries are added to it, -16 error / count"
        ),
        f"; x_axis = {names[0]}",
        f"; y_axis = {names[1]}",
        f"; compensates = {names[2]}",
        *length_facts(**facts),
        f"; x_sign = {sides[0].sign}",
        f"; y_sign = {sides[1].sign}",
        f"; target_sign = {given['target_sign']}",
        *motor_facts(given, "x_motor", "y_motor", "target_motor"),
        "DELETE GATHER",
        f"#{given['owner']} DELETE COMP",
        (
            f"#{given['owner']} DEFINE COMP {grids[1].n}.{grids[0].n},#{sides[0].motor}{d},"
            f"#{sides[1].motor}{d},#{given['target_motor']},{grids[0].counts},{grids[1].counts}"
        ),
        *entry_lines(closed[0, 1:].tolist()),
        *(line for row in closed[1:] for line in entry_lines(row.tolist())),
        "I51=1",
    ]
    return "\n".join(lines) + "\n"


def _node_values(
    grids: tuple[RollingGrid, ...], x: FloatArray, y: FloatArray, values: FloatArray, step: float
) -> FloatArray:
    """Return the map of the motors at the nodes, rows 0 ... r - 1, columns 0 ... c - 1."""
    for grid, knots, lines in ((grids[0], x, values.T), (grids[1], y, values)):
        closed = knots[0] + grid.span <= knots[-1] + 1e-6 * grid.step
        if closed and float(np.abs(lines[-1] - lines[0]).max()) > step:
            raise TableError(
                f"the travel fills the span of {format_length(grid.span)}, so its ends are one place, "
                "but the corrections differ there; give a longer span"
            )
    if holds_zero(x) and holds_zero(y):
        there = float(np.ravel(bilinear(x, y, values, 0.0, 0.0))[0])
        if abs(there) > step:
            raise TableError(
                f"where both motors read zero the value must be 0 by definition of the format, the "
                f"map has {format_length(there)}; make it with its reference there "
                "(CompensationMap.from_error(reference=...)), or state where the motors read zero "
                "(x_zero=, y_zero=)"
            )
    nodes = rolled_weights(grids[1], y) @ values @ rolled_weights(grids[0], x).T
    nodes[0, 0] = 0.0
    return np.asarray(nodes)


def _carried(
    table: CompensationMap,
    grids: tuple[RollingGrid, ...],
    sides: tuple[_Side, ...],
    nodes: FloatArray,
    knots: tuple[FloatArray, FloatArray],
    sign: int,
) -> CompensationMap:
    jx, jy = (
        enclosing_nodes(g.step, float(k[0]), float(k[-1]))[:: s.sign]
        for g, s, k in zip(grids, sides, knots, strict=True)
    )
    return replace(
        table,
        x=sides[0].to_axis(jx * grids[0].step),
        y=sides[1].to_axis(jy * grids[1].step),
        values=sign * nodes[np.ix_(jy % grids[1].n, jx % grids[0].n)] + 0.0,
        u=None,
    )


def _difference(a: CompensationMap, b: CompensationMap) -> float:
    """Return the largest difference over the first map: at a node of either, both are bilinear."""
    x, y = (np.union1d(p, q[(q > p[0]) & (q < p[-1])]) for p, q in ((a.x, b.x), (a.y, b.y)))
    one, other = (m.correction(x[None, :], y[:, None]) for m in (a, b))
    return float(np.abs(one - other).max())


def _in_motors(
    table: CompensationMap, sides: tuple[_Side, ...], sign: int
) -> tuple[FloatArray, FloatArray, FloatArray]:
    x, y = sides[0].to_motor(table.x), sides[1].to_motor(table.y)
    values = sign * table.values
    return x[:: sides[0].sign], y[:: sides[1].sign], values[:: sides[1].sign, :: sides[0].sign]


def _sides(axes: tuple[str, str], known: Mapping[str, Any]) -> tuple[_Side, _Side]:
    first, second = (
        _Side(
            axis, known[f"{n}_motor"], known[f"{n}_count"], known[f"{n}_sign"], known[f"{n}_zero"]
        )
        for n, axis in zip("xy", axes, strict=True)
    )
    return first, second


def _filled(options: Mapping[str, Any]) -> dict[str, Any]:
    """Return options with what follows from others."""
    given = dict(options)
    given["x_motor"], given["y_motor"] = given["x_motor"] or 1, given["y_motor"] or 2
    for name in ("x_count", "y_count"):
        given[name] = given[name] or given["count"]
    if given["target_sign"] is None:
        own = {given["x_motor"]: "x_sign", given["y_motor"]: "y_sign"}.get(given["target_motor"])
        given["target_sign"] = 1 if own is None else given[own]
    return given


def _checked(table: CompensationMap, options: Mapping[str, Any]) -> dict[str, Any]:
    """Return the options with what follows from axes and others filled in; refuse contradictions."""
    refuse_turning(*table.axes, table.compensates)
    own = {table.axes[0]: "x", table.axes[1]: "y"}.get(table.compensates)
    motors = {"x": options["x_motor"] or 1, "y": options["y_motor"] or 2}
    expected = 3 if own is None else motors[own]
    given = _filled({**options, "target_motor": options["target_motor"] or expected})
    if given["x_motor"] == given["y_motor"]:
        raise TableError(f"both axes of the map are motor #{given['x_motor']}; state y_motor=")
    sources = (given["x_motor"], given["y_motor"])
    if (own is None and given["target_motor"] in sources) or (
        own is not None and given["target_motor"] != expected
    ):
        raise TableError(
            f"this map corrects {table.compensates} over {table.axes[0]} and {table.axes[1]}, but the "
            f"sources are motors #{sources[0]} and #{sources[1]} and the target #"
            f"{given['target_motor']}; a motor moves one axis"
        )
    if own is not None and (
        given[f"{own}_count"] != given["count"] or given[f"{own}_sign"] != given["target_sign"]
    ):
        raise TableError(
            f"motor #{expected} is source and target: its count and its sign are one; leave "
            f"{own}_count and target_sign away"
        )
    given["owner"] = given["owner"] or given["target_motor"]
    for name, (low, high) in zip("xy", table.span, strict=True):
        for key, end in ((f"{name}_first", low), (f"{name}_last", high)):
            if given[key] is not None and given[key] != end:
                raise TableError(f"{key}= is for reading; the map ends at {format_length(end)}")
    return given


def _doubts(options: Mapping[str, Any]) -> tuple[Finding, ...]:
    missing = [n for n in ("x_motor", "y_motor", "target_motor") if options[n] is None]
    if not missing:
        return ()
    return (
        Finding(
            "warning", f"{', '.join(missing)} not given: motors 1, 2 and 3 were assumed",
            "say which motors they are", "motors",
        ),
    )  # fmt: skip


def _named(path: Path, facts: Mapping[str, str]) -> dict[str, Any]:
    """Return axes, compensated axis, reference and what is not in the map."""
    names = ("x_axis", "y_axis", "compensates")
    told = {n: facts[n] for n in names if n in facts}
    beside = load_sidecar(path).get("table", {})
    if told and len(told) < len(names):
        missing = next(n for n in names if n not in told)
        raise CorruptFileError(path, f"the comment that names {missing} is missing", hint=AGAIN)
    if not isinstance(beside, dict) or "axes" not in beside:
        found = {"x_axis": "X", "y_axis": "Y", "compensates": "Z", **told}
        return {"axes": (found["x_axis"], found["y_axis"]), "compensates": found["compensates"]}
    stated: dict[str, Any]
    try:
        stated = {
            "axes": tuple(str(a) for a in beside["axes"]),
            "compensates": str(beside["compensates"]),
            "reference": tuple(float(r) for r in beside["reference_si"]),
            "removed": "plane" if beside.get("not_in_map") == "plane" else "offset",
        }
    except (KeyError, TypeError, ValueError) as exc:
        raise DataError(f"{path}: its sidecar does not describe a map ({exc!r})") from None
    if told and (*stated["axes"], stated["compensates"]) != tuple(told.values()):
        raise CorruptFileError(
            path,
            "comments and sidecar name other axes",
            expected=", ".join(told.values()),
            found=f"{', '.join(stated['axes'])}, {stated['compensates']}",
            hint=AGAIN,
        )
    return stated
