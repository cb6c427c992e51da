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

from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from metrosep.compensation.area_errors import bilinear, format_along, format_amount, is_rotary
from metrosep.compensation.limits import Finding
from metrosep.compensation.maps import CompensationMap
from metrosep.controllers._facts import printable, settled
from metrosep.controllers._grammar import damaged
from metrosep.controllers._grids import (
    RollingGrid,
    enclosing_nodes,
    holds_zero,
    rolled_weights,
    rolling_grid,
)
from metrosep.controllers.base import (
    Dialect,
    Encoded,
    Simulator,
    map_identity,
    one_way,
)
from metrosep.controllers.options import (
    AlongOption,
    Option,
    chosen,
    flag,
    in_axes,
    is_angle,
    pick,
)
from metrosep.controllers.pmac import (
    LONG_SPAN,
    PMAC,
    SCALE,
    Program,
    define_line,
    motor,
    motor_range,
    motors_of,
    program_text,
    read_program,
    refuse_ends,
    require_short_span,
    rolls_over,
    rounded_entries,
    signed,
    turn_of,
    turning_names,
)
from metrosep.core._arrays import FloatArray
from metrosep.core.errors import TableError

_FINEST = 200
"""Intervals of an axis that are chosen without asking, where positions are not uniform."""

_STATED = ("x_count", "y_count", "x_sign", "y_sign", "target_sign", "x_zero", "y_zero")
"""Options that are never guessed when a file is read."""

_DEFINE = define_line(
    "#{owner}~DEFINE COMP {rows}.{columns},#{x}{d},[#{y}{e},][#{target},]{row_span},{column_span}"
)
_FACTS = (
    "count", *(f"{n}_{k}" for n in "xy" for k in ("count", "zero", "first", "last")), "x_sign", "y_sign",
    "target_sign", "x_motor", "y_motor", "target_motor",
)  # fmt: skip
"""What a file says of its machine."""


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


def _side_options(name: str, which: str, number: int) -> tuple[Option, ...]:
    return (
        motor(f"{name}_motor", f"motor of the {which} axis of the map; {number} if omitted"),
        _along(
            name,
            "count",
            f"length of one count of the {which} axis, or its angle; as count if omitted",
        ),
        signed(f"{name}_sign", f"the {which}"),
        replace(_along(name, "zero", f"where the {which} axis's motor reads zero"), default=0.0),
        _along(name, "span", f"roll-over length of the {which} axis; one turn if it turns"),
        _along(name, "spacing", f"distance of nodes of the {which} axis"),
        _along(name, "first", f"for reading: lowest position of the {which} axis"),
        _along(name, "last", f"for reading: highest position of the {which} axis"),
    )


def _along(name: str, what: str, text: str) -> AlongOption:
    """Return an option along one of the two axes that are looked up."""
    positive = what in ("count", "span", "spacing")
    return AlongOption(f"{name}_{what}", text, positive=positive, of=name)


class PMACPlane(Dialect):
    """Writer and reader of tables over two motors; see the module."""

    info = replace(
        PMAC.info,
        id="pmac-plane",
        title="Turbo PMAC position compensation over two motors (DEFINE COMP rows.columns)",
        units="1/16 count of the target motor; spans in counts of the source motors",
        outside="rolls over: each position is taken modulo its span",
        carries="map",
        reference_rule="zero where both source motors read zero, by definition",
        example={"count": "10 nm", "x_motor": 1, "y_motor": 2, "target_motor": 3},
    )

    options = (
        AlongOption("count", "length of one count of the target motor, or its angle", required=True, positive=True, of="compensates"),
        motor("target_motor", "motor that is corrected; 3 if omitted, or the source that it is"),
        motor("owner", "motor the table belongs to; the target if omitted"),
        flag("desired", "look up desired positions (D), not actual ones", default=True),
        pick("target_sign", "-1 if the counts of the target motor fall where its axis rises", (1, -1)),
        LONG_SPAN,
        *_side_options("x", "first", 1),
        *_side_options("y", "second", 2),
    )  # fmt: skip

    def encode(self, table: CompensationMap, **options: Any) -> Encoded:
        """Return DELETE lines, the DEFINE line, the entries row by row and I51=1; SAVE comes after the trial."""
        letters = _letters(table.axes, table.compensates)
        given = _checked(table, in_axes(self.options, options, letters))
        count, sign = given["count"], given["target_sign"]
        sides = _sides(table.axes, given)
        x, y, values = _in_motors(table, sides, sign)
        grids = tuple(
            rolling_grid(
                knots, span=turn_of(side.axis, given[f"{n}_span"], float(np.ptp([*knots, 0.0])), side.count),
                spacing=given[f"{n}_spacing"], count=side.count, finest=_FINEST, axis=side.axis,
            )
            for n, side, knots in zip("xy", sides, (x, y), strict=True)
        )  # fmt: skip
        for grid, side in zip(grids, sides, strict=True):
            require_short_span(grid.counts, given["long_span"], side.axis)
        nodes = _node_values(
            grids, x, y, values, 0.5 * count / SCALE, (*table.axes, table.compensates)
        )
        at = [s.to_axis(g.positions) for s, g in zip(sides, grids, strict=True)]

        def place(k: int) -> str:
            row, column = divmod(k, grids[0].n)
            here = [
                format_along(axis, float(p[i]))
                for axis, p, i in zip(table.axes, at, (column, row), strict=True)
            ]
            return f"{table.axes[0]} {here[0]}, {table.axes[1]} {here[1]}"

        entries = rounded_entries(nodes.ravel(), count, place, table.compensates).reshape(
            nodes.shape
        )
        carried = _carried(table, grids, sides, nodes, (x, y), sign)
        return Encoded(
            data=_text(table, given, sides, grids, entries, turning_names(self.options, letters)),
            quantisation=float(np.abs(entries * count / SCALE - nodes).max()),
            step=count / SCALE,
            carried=carried,
            resampling_error=_difference(table, carried),
            findings=(
                *_warnings(options),
                *rolls_over(zip(table.axes, (g.counts for g in grids), strict=True)),
            ),
            options=chosen(self.options, given),
            notes={
                "span_counts": [g.counts for g in grids],
                "columns": grids[0].n,
                "rows": grids[1].n,
            },
        )

    def decode(self, data: bytes, path: Path, **options: Any) -> CompensationMap:
        """Return the map over the travel it was made for."""
        nodes, steps, known, program = self._read(data, path, options)
        axes = _named(path, program.facts, _letters_in_file(path, program.facts, options))
        sides = _sides(axes["axes"], known)
        positions, picked = [], []
        for name, side, step, n in zip("xy", sides, steps, nodes.shape[::-1], strict=True):
            ends = {
                "first": known[f"{name}_first"],
                "last": known[f"{name}_last"],
                "source_sign": side.sign,
                "motor_zero": side.zero,
            }
            low, high = motor_range(ends, n - 1, step, path, side.axis)
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
            data,
            path,
            _DEFINE,
            lambda words: int((words["rows"] + 1) * (words["columns"] + 1) - 1),
        )
        define = program.define
        lines = {f"{k}_motor": define[k] or define["owner"] for k in ("x", "y", "target")}
        lines["owner"] = define["owner"]
        axes = _letters_in_file(path, program.facts, options)
        given = settled(self.options, options, path, file=program.facts, needed=_STATED, axes=axes)
        known = _filled(motors_of(lines, given, path))
        rows, columns = define["rows"], define["columns"]
        spans = define["row_span"], define["column_span"]
        if rows < 1 or columns < 1 or spans[0] < columns or spans[1] < rows:
            raise damaged(
                path,
                f"{rows} rows and {columns} columns over {spans[1]} and {spans[0]} counts are not a table",
                field="DEFINE COMP",
            )
        entries = np.concatenate([[0], program.entries]).reshape(rows + 1, columns + 1)
        if (entries[:, 0] != entries[:, -1]).any() or (entries[0] != entries[-1]).any():
            raise damaged(
                path,
                "the last column or row differs from the first: they are one place by roll-over, the "
                "axis would jump there",
                field="last column and row",
                expected="those of column 0 and row 0",
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
    turning: list[str],
) -> bytes:
    axes = [printable(a, "axis") for a in (*table.axes, table.compensates)]
    names = dict(zip(("x_axis", "y_axis", "compensates"), axes, strict=True))
    closed = np.pad(entries, ((0, 1), (0, 1)), mode="wrap")
    facts = {n: given[n] for n in _FACTS}
    for name, span in zip("xy", table.span, strict=True):
        facts |= {f"{name}_first": span[0], f"{name}_last": span[1]}
    motors = {"x": sides[0].motor, "y": sides[1].motor, "target": given["target_motor"]}
    sizes = {"rows": grids[1].n, "columns": grids[0].n}
    spans = {"row_span": grids[0].counts, "column_span": grids[1].counts}
    desired = dict.fromkeys("de", "D" if given["desired"] else "")
    return program_text(
        f"{axes[0]} (#{motors['x']}) and {axes[1]} (#{motors['y']}) correct {axes[2]} "
        f"(#{motors['target']}); entries are added to it, -16 error / count",
        names,
        facts,
        _DEFINE,
        {"owner": given["owner"], **motors, **sizes, **spans, **desired},
        [closed[0, 1:], *closed[1:]],
        turning=turning,
    )


def _node_values(
    grids: tuple[RollingGrid, ...],
    x: FloatArray,
    y: FloatArray,
    values: FloatArray,
    step: float,
    axes: tuple[str, str, str],
) -> FloatArray:
    """Return the map of the motors at the nodes, rows 0 ... r - 1, columns 0 ... c - 1."""
    for axis, grid, knots, lines in zip(axes, grids, (x, y), (values.T, values), strict=False):
        closed = knots[0] + grid.span <= knots[-1] + 1e-6 * grid.step
        net = float(np.abs(lines[-1] - lines[0]).max())
        if closed and net > step:
            raise TableError(
                f"the travel fills the span of {format_along(axis, grid.span)}, so its ends are one place, "
                f"but the corrections differ there by {format_amount(axes[2], net)}; "
                + ("make them the same" if is_rotary(axis) else "give a longer span")
            )
    if holds_zero(x) and holds_zero(y):
        there = float(np.ravel(bilinear(x, y, values, 0.0, 0.0))[0])
        if abs(there) > step:
            raise TableError(
                f"where both motors read zero the value must be 0 by definition of the format, the "
                f"map has {format_amount(axes[2], there)}; make it with its reference there "
                "(reference=), or state where the motors read zero "
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
    for name, axis in zip("xy", table.axes, strict=True):
        if options[f"{name}_count"] is None and is_rotary(axis) != is_rotary(table.compensates):
            raise TableError(
                f"one of {axis} and {table.compensates} turns and the other does not: state {name}_count= "
                f"too, the {'angle' if is_rotary(axis) else 'length'} of one count of the motor of {axis}"
            )
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
    for name, span in zip("xy", table.span, strict=True):
        ends = dict(zip((f"{name}_first", f"{name}_last"), span, strict=True))
        refuse_ends(given, ends, table.axes["xy".index(name)])
    return given


def _warnings(options: Mapping[str, Any]) -> tuple[Finding, ...]:
    missing = [n for n in ("x_motor", "y_motor", "target_motor") if options[n] is None]
    if not missing:
        return ()
    return (
        Finding.warning(
f"{', '.join(missing)} not given: motors 1, 2 and 3 were assumed",
            "say which motors they are", "motors",
        ),
    )  # fmt: skip


def _letters(axes: tuple[str, str], compensates: str) -> dict[str, str]:
    """Return the axes of a map by the names that options use."""
    return {"x": axes[0], "y": axes[1], "compensates": compensates}


def _letters_in_file(
    path: Path, facts: Mapping[str, str], options: Mapping[str, Any]
) -> dict[str, str]:
    """Return the axes of comments or sidecar, else letters that turn where an option is an angle."""
    if {*_NAMES} <= {*facts}:
        return _letters((facts["x_axis"], facts["y_axis"]), facts["compensates"])
    found = {}
    for name, linear, turning in (("x", "X", "A"), ("y", "Y", "B"), ("compensates", "Z", "C")):
        mine = (
            ("count",)
            if name == "compensates"
            else [k for k in options if k.startswith(f"{name}_")]
        )
        found[name] = turning if any(is_angle(options.get(k)) for k in mine) else linear
    known = map_identity(
        path, axes=(found["x"], found["y"]), compensates=found["compensates"], first=(0.0, 0.0)
    )
    return _letters(known["axes"], known["compensates"])


_NAMES = ("x_axis", "y_axis", "compensates")
"""Comments that name the axes."""


def _named(path: Path, facts: Mapping[str, str], letters: Mapping[str, str]) -> dict[str, Any]:
    """Return axes, compensated axis, reference and what is not in the map."""
    stated = {n: facts[n] for n in _NAMES if n in facts}
    if stated and len(stated) < len(_NAMES):
        missing = next(n for n in _NAMES if n not in stated)
        raise damaged(path, f"the comment that names {missing} is missing")
    x, y, compensates = letters.values()
    known = map_identity(path, axes=(x, y), compensates=compensates, first=(0.0, 0.0))
    found = (*known["axes"], known["compensates"])
    if stated and found != (x, y, compensates):
        raise damaged(
            path,
            "comments and sidecar name other axes",
            expected=", ".join(stated.values()),
            found=f"{', '.join(known['axes'])}, {known['compensates']}",
        )
    return known
