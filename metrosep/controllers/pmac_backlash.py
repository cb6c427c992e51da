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
from collections.abc import Iterator, Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from metrosep.compensation.area_errors import format_amount
from metrosep.compensation.limits import Finding
from metrosep.compensation.measured import measured_error
from metrosep.compensation.table import CompensationTable
from metrosep.compensation.uniform import resampling_error
from metrosep.controllers._facts import is_same, printable, settled
from metrosep.controllers._grammar import damaged
from metrosep.controllers.base import (
    Encoded,
    Simulator,
    load_bytes,
    load_sidecar,
    looked_up,
    require_unchanged,
)
from metrosep.controllers.options import (
    AlongOption,
    Option,
    axes_of,
    chosen,
    closed,
    flag,
    in_axes,
    is_one_turn,
    whole,
)
from metrosep.controllers.pmac import (
    ACTIVATION,
    GRID,
    LARGEST,
    PMAC,
    SCALE,
    OneMotor,
    Program,
    axes_in_file,
    define_line,
    filled,
    motor,
    motors_of,
    named_axes,
    program_text,
    read_program,
    refuse_ends,
    rolled_size,
    rolls_over,
    signed,
    turning_names,
)
from metrosep.core._arrays import FloatArray
from metrosep.core.errors import CorruptFileError, LimitError, SignCheckFailedError, TableError

_DEFINE = define_line("#{owner}~DEFINE BLCOMP {entries},{span}")
_FACTS = ("count", "motor_zero", "first", "last", "source_sign", "motor")
"""What a file says of its machine."""

_SIZE, _RATE = 86, 85
"""Ixx86: backlash at the zero of the motor; Ixx85: how fast it is taken up."""

_STATED = ("source_sign", "motor_zero")
"""Options that are never guessed when a file is read."""

_POINTS = 2001
"""Positions at which the lost motion is judged."""

_CLOSE = 0.1
"""Difference of the table besides from the forward column, over its span, that is worth a word."""


class PMACBacklash(OneMotor):
    """Writer and reader of backlash tables; see the module."""

    info = replace(
        PMAC.info,
        id="pmac-backlash",
        title="Turbo PMAC backlash compensation over position (DEFINE BLCOMP)",
        entry="subtracted while moving negative, in 1/16 count: round(16 (e_rev - e_fwd) / count), "
        "less Ixx86",
        units="1/16 count; span in counts",
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
        directions="two",
        resolution="1/16 count",
        reference_rule="zero at the zero of the motor, by definition; the lost motion there is Ixx86",
        example={"count": "10 nm", "motor": 1},
    )

    options = (
        AlongOption(
            "count", "length of one count of the motor, or its angle", required=True, positive=True
        ),
        motor("motor", "number of the motor; 1 if omitted"),
        signed("source_sign", "the"),
        AlongOption("motor_zero", "position of the axis where the motor reads zero", default=0.0),
        Option(
            "comp",
            "file of the forward corrections that act besides (controller pmac), for the dry-run "
            "and for simulating both together",
            "text",
        ),
        flag(
            "forward_active",
            "the forward direction was compensated already while the runs were measured: only the "
            "lost motion is judged, without comp=",
        ),
        whole(
            "rate",
            "Ixx85, sixteenths of a count taken up per background cycle; set elsewhere if omitted",
            1,
            LARGEST,
        ),
        *GRID,
    )

    def encode(self, table: CompensationTable, **options: Any) -> Encoded:
        """Return DELETE lines, the DEFINE line, entries, Ixx86 and I51=1; SAVE comes after the trial."""
        options = in_axes(self.options, options, axes_of(table))
        _check(table, options)
        if is_one_turn(table):
            table = closed(table, options["count"] / SCALE)
        count, owner = float(options["count"]), options["motor"] or 1
        lost = _lost_motion(table)
        x, y = (v[:: options["source_sign"]] for v in (table.positions, lost))
        x = options["source_sign"] * (x - options["motor_zero"])
        base = round(SCALE * float(np.interp(0.0, x, y)) / count)
        if not 0 <= base <= LARGEST:
            raise LimitError(
                "e_rev - e_fwd at the zero of the motor is "
                f"{format_amount(table.axis, base * count / SCALE)}; "
                f"Ixx86 holds 0 ... {LARGEST} sixteenths of a count: a lost motion is positive, so "
                "check which runs are forward, and whether one is compensated already"
            )
        fixed = base * count / SCALE
        made = filled(table, lost - fixed, options, tolerance=0.51)
        columns = self._in_axis(made.motor, made.values + fixed, options)
        carried = replace(table, **columns, u=None)
        alone = replace(table, **_both(lost, options["source_sign"]))
        axis = printable(table.axis, "axis")
        size, rate = 100 * owner + _SIZE, 100 * owner + _RATE
        facts = {n: options[n] for n in _FACTS} | dict(
            zip(("first", "last"), table.span, strict=True)
        )
        data = program_text(
            f"lost motion of {axis} (#{owner}); entries and I{size} are subtracted while the motor moves "
            "negative, 16 (e_rev - e_fwd) / count",
            {"axis": axis, "compensates": axis},
            {**facts, "motor": owner},
            _DEFINE,
            {"owner": owner, "entries": made.grid.n, "span": made.grid.counts},
            [made.entries],
            turning=turning_names(self.options, axes_of(table)),
            sets={size: base, rate: options["rate"]},
        )
        return Encoded(
            data=data,
            quantisation=made.rounding,
            step=count / SCALE,
            carried=carried,
            resampling_error=resampling_error(alone, carried),
            findings=(
                *_warnings(table, options, lost),
                *rolls_over([(table.axis, made.grid.counts)]),
            ),
            options=chosen(self.options, options),
            notes={
                "span_counts": made.grid.counts,
                "entries": made.grid.n,
                f"I{size}": base,
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
                "the dry-run does not shrink the lost motion: "
                f"{format_amount(table.axis, sizes[0])} -> {format_amount(table.axis, sizes[1])}, with the "
                f"reversed sign {format_amount(table.axis, sizes[2])}; nothing was written"
            )
        names = ("before_m", "after_m", "wrong_sign_m")
        return {
            "definition": "largest absolute reverse minus forward",
            **dict(zip(names, sizes, strict=True)),
        }

    def lookup(self, data: bytes, path: Path, **options: Any) -> Simulator:
        """Return what PMAC adds in each direction, with the table besides if `comp` names one."""
        nodes, step, known, program = self._read(data, path, options)
        n = nodes.size - 1
        axis = named_axes(path, program, 0.0, known["axes"])["axis"]
        besides = None
        if known.get("comp") is not None:
            besides = _besides(
                known["comp"], {**known, "axis": axis}, load_sidecar(path).get("comp_sha256")
            )

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
        program = read_program(
            data, path, _DEFINE, lambda words: int(words["entries"]),
            lambda owner: (51, 100 * owner + _SIZE, 100 * owner + _RATE),
        )  # fmt: skip
        owner = program.define["owner"]
        size, rate = 100 * owner + _SIZE, 100 * owner + _RATE
        axes = axes_in_file(path, program.facts, options, same=True)
        known = motors_of(
            {"motor": owner},
            settled(self.options, options, path, file=program.facts, needed=_STATED, axes=axes),
            path,
        )
        known["axes"] = axes
        n, counts = rolled_size(program, path)
        if program.settings.get(size, -1) not in range(LARGEST + 1):
            raise CorruptFileError(
                path,
                f"the file does not set I{size}, the lost motion at the zero of the motor",
                field=f"I{size}",
                expected=f"0 ... {LARGEST}",
                found=program.settings.get(size, "nothing"),
                hint=f"add a line I{size}= with the value of the controller",
            )
        if program.settings.get(rate) == 0:
            raise damaged(path, "the rate is 0: PMAC would take up nothing", field=f"I{rate}")
        sixteenths = np.concatenate([[0], program.entries]) + program.settings[size]
        return sixteenths * known["count"] / SCALE, counts * known["count"] / n, known, program

    def _in_axis(
        self, motor: NDArray[Any], values: FloatArray, known: Mapping[str, Any]
    ) -> dict[str, Any]:
        """Return positions and columns of the axis, from positions of the motor."""
        s = known["source_sign"]
        positions = (known["motor_zero"] + s * motor)[::s]
        return {"positions": positions, **_both(np.asarray(values[::s] + 0.0), s)}


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
        ).hinting(direction="split")
    if options["forward_active"] and options["comp"] is not None:
        raise TableError(
            "forward_active= says that the forward corrections acted while the runs were measured, "
            "comp= names forward corrections that are new: say one of them"
        )
    refuse_ends(options, dict(zip(("first", "last"), table.span, strict=True)), table.axis)


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


def _warnings(
    table: CompensationTable, options: Mapping[str, Any], lost: FloatArray
) -> Iterator[Finding]:
    besides = None
    if options["comp"] is not None:
        besides = _besides(options["comp"], {**options, "axis": table.axis})
    if besides is None and not options["forward_active"]:
        yield Finding.warning(
            "this file alone leaves the error of one direction as it is",
            "write the forward corrections as controller='pmac' and name their file in comp=: "
            "the dry-run is then of both together",
            "comp",
        )
    elif besides is not None:
        way = 1 if options["source_sign"] > 0 else -1
        apart = float(np.abs(besides(table.positions) - _column(table, way)).max())
        if apart > _CLOSE * float(np.ptp(table.forward)):
            yield Finding.warning(
                f"the table in comp= differs from the corrections of the direction in which the "
                f"motor moves positive by up to {format_amount(table.axis, apart, digits=3)}",
                "make that table with direction='forward' ('reverse' where source_sign is -1)",
                "comp",
            )
    if (lost < -0.5 * options["count"] / SCALE).any():
        yield Finding.warning(
            f"e_rev - e_fwd falls to {format_amount(table.axis, float(lost.min()), digits=3)}: a lost motion is "
            "not negative",
            "check which runs are forward, and whether backlash is compensated already",
            "comp",
        )
