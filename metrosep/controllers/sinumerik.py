"""SINUMERIK sag compensation, ``$AN_CEC``: one axis corrected over the position of another.

Two tables of one file hold the two directions of motion, or multiply to a map f(x) g(y). The
documents that could be read state no sign: the entry +e of the encoder compensation of the same
manual is a suggestion, and a table is written only after a trial on the machine.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from metrosep.compensation.area_errors import (
    format_along,
    format_amount,
    format_position,
    is_rotary,
)
from metrosep.compensation.limits import Finding
from metrosep.compensation.maps import CompensationMap
from metrosep.compensation.products import ProductTables, rank_one
from metrosep.compensation.table import CompensationTable
from metrosep.controllers._facts import agreed, read_table, settled
from metrosep.controllers._grammar import short
from metrosep.controllers._grids import (
    DRY_RUN,
    Repeating,
    even_map,
    even_table,
    folded,
    require_one_direction,
)
from metrosep.controllers._sinumerik_file import (
    CEC,
    ENC,
    Assignment,
    Grid,
    axis_letter,
    axis_names,
    check_count,
    check_turns,
    check_values,
    checked_modulo,
    checked_name,
    factors,
    opened,
    pair,
    read_assignments,
    require_same_axes,
    turning,
    units,
    write_program,
)
from metrosep.controllers.base import (
    Dialect,
    DialectInfo,
    Encoded,
    identity,
    load_sidecar,
    map_identity,
    table_lookup,
)
from metrosep.controllers.options import (
    ENTRY_SIGN,
    AlongOption,
    Option,
    along_axis,
    flag,
    pick,
    whole,
)
from metrosep.core._arrays import FloatArray
from metrosep.core.errors import (
    CorruptFileError,
    DataError,
    Example,
    LimitError,
    TableError,
    UnsupportedFeatureError,
)
from metrosep.core.units import format_length

_FACTOR_DECIMALS = 12
_SAME = 1e-12
"""Below a picometre nothing is left of a map."""

_DIGITS = 10.0
"""Last digits of the file by which a large constant may coarsen it anyway: a hundredth of a nanometre."""

_RESIDUAL = 0.1
"""Share of the map's span that a product of two tables may miss."""


_SHARED = (
    Option(
        "output_axis", "name of the corrected machine axis, such as AX3", "text", required=True
    ),
    whole("table_index", "index of the first table", 0, default=0),
    ENTRY_SIGN,
    whole("channel", "number in CHANDATA", 1, default=1),
    whole("points_limit", "MD18342 of a table; 200 on 828D", 2),
    AlongOption("value_limit", "MD32720, the most the control adds", positive=True),
    whole("decimals", "of an entry", 1, 12, default=9),
)

_ACTIVATION = (
    "set MD18342 MM_CEC_MAX_POINTS[t] to the number of entries or more (828D: 8 tables of 200)",
    "set MD32720 to twice the largest correction, so that no mistake can move the axis further",
    "basic system metric (MD32711); set MD32710 CEC_ENABLE = 0 for the output axis, load the file",
    "set SD41300 CEC_TABLE_ENABLE[t] = 1 for each table and MD32710 = 1, power on, reference",
    "dry-run: move the input axis and read the correction in 'service axes', sag compensation",
)


class SinumerikCec(Repeating):
    """Writer and reader of a table for one axis over another, or over itself; see the module."""

    info = DialectInfo(
        id="sinumerik-cec",
        title="SINUMERIK sag compensation ($AN_CEC)",
        entry="+e with entry_sign=1, suggested by the encoder compensation; -e with entry_sign=-1",
        units="mm, of a turning axis degrees (basic system metric)",
        outside="end values hold; with modulo=True it repeats",
        sign_status="not stated in the pages of the compensation manual that could be read",
        activation=_ACTIVATION,
        sign="unconfirmed",
        spacing="uniform",
        directions="two",
        resolution="1 pm with 9 decimals; float64 inside",
        reference_rule="none; zero at the zero of the output axis avoids a step when it is switched on",
        suffix=".INI",
        example={"input_axis": "AX1", "output_axis": "AX3"},
        page="sinumerik",
    )

    options = (
        Option(
            "input_axis",
            "name of the machine axis that is looked up, such as AX1",
            "text",
            required=True,
        ),
        *_SHARED,
        flag("modulo", "the table repeats, for an axis that turns on"),
        flag("input_turns", "the input axis turns: degrees"),
        flag("output_turns", "the output axis turns: degrees"),
        AlongOption("spacing", "spacing of the entries, to resample", positive=True),
    )

    def encode(self, table: CompensationTable, **options: Any) -> Encoded:
        """Return the text of a file; two tables where the directions differ."""
        o = self.filled(options)
        names = [checked_name(o[k], k) for k in ("input_axis", "output_axis")]
        alike = names[0] == names[1] if table.is_on_axis else names[0].upper() == names[1].upper()
        if table.is_on_axis != alike:  # the control does not tell AX1 from ax1
            raise DataError(
                f"the table is {table.axis} -> {table.compensates}, but input_axis={names[0]} and "
                f"output_axis={names[1]}"
            )
        for axis, key in ((table.axis, "input_turns"), (table.compensates, "output_turns")):
            check_turns(axis, key, o[key])
        carried, error = even_table(table, along_axis(o["spacing"], table.axis, "spacing"))
        most = along_axis(o["value_limit"], table.compensates, "value_limit")
        check_count(carried.positions, o, table.axis)
        columns = [carried.forward]
        if carried.reverse is not None and not np.array_equal(carried.reverse, carried.forward):
            columns.append(carried.reverse)
        unit = units(turns=o["output_turns"])
        lines: list[str] = []
        rounding = 0.0
        for k, column in enumerate(columns):
            check_values(column, carried.positions, most, table.axis, table.compensates)
            words = _words(o["entry_sign"] * -column / unit, o["decimals"])
            if o["modulo"]:
                checked_modulo(words, column, carried.span, table.axis)
            back = -o["entry_sign"] * np.array(words, dtype=np.float64) * unit
            rounding = max(rounding, float(np.abs(back - column).max()))
            direction = 0 if len(columns) == 1 else 1 - 2 * k
            span = [v / units(turns=o["input_turns"]) for v in carried.span]
            lines += CEC.lines(
                (o["table_index"] + k,), words, span, INPUT_AXIS=names[0], OUTPUT_AXIS=names[1],
                DIRECTION=direction, MULT_BY_TABLE=0, IS_MODULO=int(o["modulo"]),
            )  # fmt: skip
        told = _facts(
            o,
            (table.axis, table.compensates),
            input_turns=int(o["input_turns"]),
            output_turns=int(o["output_turns"]),
        )
        return Encoded(
            data=write_program("NC_CEC_INI", o["channel"], _comments(o), lines, told),
            quantisation=rounding,
            notes={"MD18342_at_least": carried.positions.size, "tables": len(columns)},
            step=10.0 ** -o["decimals"] * unit,
            carried=carried,
            resampling_error=error,
        )

    def _read(
        self, data: bytes, path: Path, options: Mapping[str, Any]
    ) -> tuple[CompensationTable, bool]:
        tables, o, noted = opened(data, path, self.options, options)
        first, second = pair(tables, path, o)
        for name in ("input_axis", "output_axis"):
            agreed(path, name, {"the file": getattr(first, name), "you": o.get(name)})
        own = first.input_axis == first.output_axis
        turns_in, turns_out = (
            turning(
                getattr(first, f"{k}_axis"),
                o.get(f"{k}_turns", o.get(f"{other}_turns") if own else None),
                f"{k}_turns",
                path,
            )
            for k, other in (("input", "output"), ("output", "input"))
        )
        unit = -o["entry_sign"] * units(turns=turns_out)
        columns = {t.direction: 0.0 + t.grid.entries * unit for t in (first, second) if t}
        forward = columns.get(0, columns.get(1))
        reverse = None if 0 in columns else columns.get(-1)
        if forward is None:
            forward = np.zeros(first.grid.entries.size)
        elif reverse is None and 0 not in columns:
            reverse = np.zeros(first.grid.entries.size)
        positions = first.grid.positions * units(turns=turns_in)
        fields = identity(path)
        if not load_sidecar(path).get("table"):
            machine = (first.input_axis, first.output_axis)
            names = axis_names(noted, machine, (turns_in, turns_out), ("X", "Z"))
            fields |= dict(zip(("axis", "compensates"), names, strict=True))
        named = (fields["axis"], fields["compensates"])
        require_same_axes(named, (first.input_axis, first.output_axis), path)
        check_turns(named[0], "input_turns", turns_in)
        check_turns(named[1], "output_turns", turns_out)
        table = read_table(positions, forward, reverse, **fields)
        return table, first.grid.modulo


class SinumerikCecProduct(Dialect):
    """Writer and reader of a map as a product of two tables; see the module."""

    info = replace(
        SinumerikCec.info,
        id="sinumerik-cec-product",
        title="SINUMERIK sag compensation over two axes, f(x) g(y) ($AN_CEC_MULT_BY_TABLE)",
        entry="first table +e with entry_sign=1, -e with -1; second a factor with peak 1 mm; multiplied",
        units="mm, positions of a turning axis degrees (basic system metric)",
        outside="end values hold",
        sign_status="not stated in the pages of the compensation manual that could be read; nor whether the "
        "second table acts by itself too",
        activation=(
            *_ACTIVATION[:3],
            "enable the second table alone (SD41300): its correction must read 0, else do not go on",
            *_ACTIVATION[3:],
        ),
        carries="map",
        directions="one",
        reference_rule="none; what the product leaves at the map's reference is in the sidecar",
        example={"first_input_axis": "AX1", "second_input_axis": "AX2", "output_axis": "AX3"},
    )

    options = (
        Option(
            "first_input_axis", "machine axis of the map's columns, AX1", "text", required=True
        ),
        Option("second_input_axis", "machine axis of its rows, AX2", "text", required=True),
        *_SHARED,
        flag(
            "accept_residual",
            "write although the product misses more than a tenth of the map's span",
        ),
        flag(
            "keep_zero",
            "let the product add no constant to the map: more of it stays, the zero moves less",
        ),
        AlongOption("first_spacing", "spacing of the columns, to resample", positive=True),
        AlongOption("second_spacing", "spacing of the rows, to resample", positive=True),
        pick(
            "turning",
            "to read files that do not tell: which input axes turn",
            ("none", "1", "2", "12"),
        ),
    )

    def encode(self, table: CompensationMap, **options: Any) -> Encoded:
        """Return the text of a file of two tables."""
        o = self.filled(options)
        names = [
            checked_name(o[k], k) for k in ("first_input_axis", "second_input_axis", "output_axis")
        ]
        own = [a == table.compensates for a in table.axes]
        if [n == names[2] for n in names[:2]] != own or names[0] == names[1]:
            raise DataError(
                f"the map is {table.axes[0]}, {table.axes[1]} -> {table.compensates}, but the axes of "
                f"the control are {names[0]}, {names[1]} -> {names[2]}"
            )
        if is_rotary(table.compensates):
            raise TableError(f"{table.compensates} turns: a map corrects a linear axis")
        if o["turning"] not in (None, _turning(table)):
            raise DataError(
                f"turning={o['turning']}, but by the axes of the map it is {_turning(table)}"
            )
        keys = ("first_spacing", "second_spacing")
        spacings = {k: along_axis(o[k], a, k) for k, a in zip(keys, table.axes, strict=True)}
        even, error = even_map(table, spacings, keys)
        product = rank_one(even, keep_zero=bool(o["keep_zero"]))
        missed = _missed(product, o)
        _require_fine(product, 10.0 ** -o["decimals"] * units(turns=False))
        carried = product.as_map()
        for positions, axis in ((even.x, even.axes[0]), (even.y, even.axes[1])):
            check_count(positions, o, axis)
        most = along_axis(o["value_limit"], even.compensates, "value_limit")
        places = np.tile(even.x, even.y.size)
        check_values(carried.values.ravel(), places, most, even.axes[0], even.compensates)
        unit = units(turns=False)
        first = _words(-o["entry_sign"] * product.first.forward / unit, o["decimals"])
        second = _words(product.second.forward, _FACTOR_DECIMALS)
        f, g = (np.array(w, dtype=np.float64) for w in (first, second))
        back = -o["entry_sign"] * unit * f * g[:, None]
        t = o["table_index"]
        lines: list[str] = []
        for k, (words, positions) in enumerate(((first, even.x), (second, even.y))):
            scale = units(turns=is_rotary(even.axes[k]))
            span = [float(positions[0]) / scale, float(positions[-1]) / scale]
            lines += CEC.lines(
                (t + k,), words, span, INPUT_AXIS=names[k], OUTPUT_AXIS=names[2], DIRECTION=0,
                MULT_BY_TABLE=0 if k else t + 2, IS_MODULO=0,
            )  # fmt: skip
        told = _facts(o, (*even.axes, even.compensates), turning=_turning(even))
        return Encoded(
            data=write_program("NC_CEC_INI", o["channel"], _comments(o), lines, told),
            quantisation=float(np.abs(back - carried.values).max()),
            notes={
                "tables": 2,
                "residual_max_m": missed,
                "residual_pv_m": product.residual_pv,
                "residual_rms_m": product.residual_rms,
                "residual_share": product.share,
                "at_reference_m": product.at_reference,
                "constant_m": product.constant,
                "convention": product.convention,
            },
            step=10.0 ** -o["decimals"] * unit,
            carried=carried,
            resampling_error=error,
            findings=_findings(product, missed),
        )

    def decode(self, data: bytes, path: Path, **options: Any) -> CompensationMap:
        """Return the map of a file of two tables that multiply."""
        tables, o, noted = opened(data, path, self.options, options)
        first, second = factors(tables, path)
        found = (first.input_axis, second.input_axis, first.output_axis)
        keys = ("first_input_axis", "second_input_axis", "output_axis")
        for name, value in zip(keys, found, strict=True):
            agreed(path, name, {"the file": value, "you": o.get(name)})
        told = o.get("turning")
        turns = [
            turning(t.input_axis, None if told is None else str(k) in told, "turning", path)
            for k, t in ((1, first), (2, second))
        ]
        x, y = (
            t.grid.positions * units(turns=k) for t, k in zip((first, second), turns, strict=True)
        )
        names = axis_names(noted, found, (*turns, False), ("X", "Y", "Z"))
        fields = map_identity(
            path, axes=(names[0], names[1]), compensates=names[2], first=(float(x[0]), float(y[0]))
        )
        require_same_axes((*fields["axes"], fields["compensates"]), found, path)
        for axis, turned in zip(fields["axes"], turns, strict=True):
            check_turns(axis, "turning", turned)
        unit = -o["entry_sign"] * units(turns=False)
        return CompensationMap(
            x=x,
            y=y,
            values=0.0 + unit * first.grid.entries * second.grid.entries[:, None],
            is_exact_inverse=True,
            **fields,
        )


def _missed(product: ProductTables, o: Mapping[str, Any]) -> float:
    missed = float(np.abs(product.residual).max())
    span = float(np.ptp(product.map.values))
    if missed > _RESIDUAL * span and not o["accept_residual"]:
        raise LimitError(
            f"the map is not a product of two tables: f(x) g(y) misses it by up to "
            f"{format_length(missed, digits=3)}, its corrections span {format_length(span, digits=3)}; "
            "write a table over one axis, choose a control that holds maps, or accept it with "
            "accept_residual=True"
        ).hinting(accept_residual=Example("True"))
    return missed


def _require_fine(product: ProductTables, step: float) -> None:
    """Refuse a large constant: a step of the file then weighs more than what it saves."""
    weight = float(np.abs(product.first.forward).max() / np.abs(product.map.values).max())
    if product.constant != 0.0 and step * weight > max(0.1 * product.residual_rms, _DIGITS * step):
        raise LimitError(
            f"the product needs the constant {format_length(product.constant, digits=3)}, which is "
            f"{weight:.3g} times the largest correction: the last digit of the file then counts for more "
            "than the constant saves; the map is rather a sum of two tables: write one table over each "
            "axis, give more decimals=, or say keep_zero=True"
        ).hinting(keep_zero=True)


def _findings(product: ProductTables, missed: float) -> tuple[Finding, ...]:
    shown = [missed > _SAME, abs(product.at_reference) > _SAME]
    return tuple(
        Finding.warning(message, "see the residual in the sidecar", "product")
        for message, show in zip(product.messages, shown, strict=False)
        if show
    )


def _comments(o: Mapping[str, Any]) -> list[str]:
    return [f"entry = {'+' if o['entry_sign'] > 0 else '-'}e, {DRY_RUN}"]


def _facts(o: Mapping[str, Any], axes: Sequence[str], **more: object) -> dict[str, object]:
    facts: dict[str, object] = {"entry_sign": o["entry_sign"], **more}
    if all(a.isascii() and a.isalnum() for a in axes):
        facts["axes"] = ",".join(axes)
    return facts


def _turning(corrections: CompensationMap) -> str:
    found = "".join(str(k) for k, a in enumerate(corrections.axes, start=1) if is_rotary(a))
    return found or "none"


def _words(values: FloatArray, decimals: int) -> list[str]:
    return [short(float(v), decimals) for v in values]


# ---- SINUMERIK encoder and spindle error compensation, ``$AA_ENC_COMP`` ------------------------
# The entry is added to the ACTUAL value of the axis, so a positive one drives the axis in negative
# direction: the entry for an error e is +e, the opposite of most controllers.


class SinumerikEnc(Repeating):
    """Writer and reader of ``AX_EEC_INI``; see the module."""

    info = replace(
        SinumerikCec.info,
        id="sinumerik-enc",
        title="SINUMERIK encoder error compensation ($AA_ENC_COMP)",
        entry="+e, added to the actual value: a positive entry moves the axis in negative direction",
        sign_status="documented explicitly in the compensation manual K3; not run",
        activation=(
            "save the memory, set MD38000 MM_ENC_COMP_MAX_POINTS to the number of entries or more",
            "basic system metric; set MD32700 ENC_COMP_ENABLE = 0 for the axis, load the file",
            "set MD32700 = 1, power on, reference the axis",
            "check in 'service axes' that the correction at a bump is the opposite of its error",
        ),
        directions="one",
        reference_rule="zero at the reference point, or the axis jumps when it is referenced",
        example={"machine_axis": "X1"},
        sign="documented",
    )

    needs_zero = True

    options = (
        Option("machine_axis", "name of the machine axis, such as X1", "text", required=True),
        pick(
            "measuring_system",
            "0 for the first encoder of the axis, 1 for the second",
            (0, 1),
            default=0,
        ),
        whole("channel", "number in CHANDATA", 1, default=1),
        flag("modulo", "the table repeats, for an axis that turns on"),
        flag("turns", "the axis turns: rad in the table, degrees here"),
        whole("points_limit", "MD38000 of the axis; 200 on 808D and 828D", 2),
        AlongOption("reference_point", "machine position of the reference point"),
        AlongOption("spacing", "spacing of the entries, to resample", positive=True),
        whole("decimals", "of an entry", 1, 12, default=9),
    )

    def encode(self, table: CompensationTable, **options: Any) -> Encoded:
        o = self.filled(options)
        axis = checked_name(o["machine_axis"], "machine_axis")
        if not table.is_on_axis:
            raise TableError(
                f"ENC_COMP corrects an axis over its own position, this table is {table.axis} -> "
                f"{table.compensates}; write it as 'sinumerik-cec'"
            )
        table = require_one_direction(
            table,
            "ENC_COMP",
            "into MD32450 BACKLASH, or write controller='sinumerik-cec', which has a table for each",
        )
        if is_rotary(table.axis) != o["turns"]:
            raise DataError(
                f"the axis of the table is {table.axis}, but turns={o['turns']}: a turning axis is "
                "written in degrees"
            )
        carried, error = even_table(table, along_axis(o["spacing"], table.axis, "spacing"))
        _require_zero(carried, o)
        check_count(carried.positions, o, table.axis, "MD38000")
        unit = units(turns=o["turns"])
        words = [short(-c / unit, o["decimals"], at_least=1) for c in carried.forward]
        if o["modulo"]:
            checked_modulo(words, carried.forward, carried.span, table.axis)
        back = -np.array(words, dtype=np.float64) * unit
        span = [v / unit for v in carried.span]
        key = (o["measuring_system"], axis)
        lines = ENC.lines(key, words, span, IS_MODULO=int(o["modulo"]))
        facts: dict[str, object] = {"turns": int(o["turns"])}
        if table.axis.isascii() and table.axis.isalnum():
            facts["axis"] = table.axis
        return Encoded(
            data=write_program("AX_EEC_INI", o["channel"], (), lines, facts),
            quantisation=float(np.abs(back - carried.forward).max()),
            notes={"MD38000_at_least": carried.positions.size},
            step=10.0 ** -o["decimals"] * unit,
            carried=carried,
            resampling_error=error,
        )

    def _read(
        self, data: bytes, path: Path, options: dict[str, Any]
    ) -> tuple[CompensationTable, bool]:
        assignments, noted = read_assignments(data, path)
        o = settled(self.options, options, path, file=noted, partial=True)
        grid, name = _chosen(assignments, path, o)
        turns = turning(name, o.get("turns"), "turns", path)
        unit = units(turns=turns)
        positions = grid.positions * unit
        fields = identity(path)
        if not load_sidecar(path).get("table"):
            letter = noted.get("axis", axis_letter(name, turns=turns, otherwise="X"))
            fields["axis"] = fields["compensates"] = letter
        if fields["axis"] != fields["compensates"]:
            raise CorruptFileError(
                path,
                f"its sidecar states that it corrects {fields['compensates']} over {fields['axis']}, but the table "
                "corrects an axis over its own position",
                hint="use the sidecar that fits, or write the table again",
            )
        if is_rotary(fields["axis"]) != turns:
            raise DataError(
                f"{path}: turns={turns}, but the axis is stated as {fields['axis']}; leave turns out, "
                "or use the sidecar that fits"
            )
        table = read_table(positions, 0.0 - grid.entries * unit, **fields)
        return table, grid.modulo


def _require_zero(table: CompensationTable, o: dict[str, Any]) -> None:
    """Refuse entries, as the file carries them, that are not zero at the reference point."""
    told = along_axis(o["reference_point"], table.axis, "reference_point", positive=False)
    place = table.reference if told is None else told
    lookup = table_lookup(table)
    there = float((folded(lookup, *table.span) if o["modulo"] else lookup)(place))
    if abs(there) > 0.5 * 10.0 ** -o["decimals"] * units(turns=o["turns"]):
        raise TableError(
            f"the correction at the reference point {format_position(table.axis, place)} is "
            f"{format_amount(table.axis, there)} in the file: the axis would jump by it when it is referenced; "
            f"make the table with reference='{format_along(table.axis, place, digits=9)}' (and a spacing= of the "
            "file, if there is one, that keeps it an entry), or say where the axis is referenced "
            "(reference_point=)"
        )


def _chosen(assignments: list[Assignment], path: Path, o: dict[str, Any]) -> tuple[Grid, str]:
    """Return the one table of the file, or that of the axis and encoder that the user named."""
    keys = ENC.tables(assignments, path)
    bad = [k for k in keys if k[0] not in ("0", "1")]
    if bad:
        raise CorruptFileError(path, f"encoder {bad[0][0]} of axis {bad[0][1]}: there are 0 and 1")
    wanted = [
        k
        for k in keys
        if o.get("machine_axis", k[1]) == k[1] and str(o.get("measuring_system", k[0])) == k[0]
    ]
    names = ", ".join(f"{axis} encoder {system}" for system, axis in keys) or "none"
    if not wanted:
        raise DataError(f"{path}: it holds no table of that axis and encoder; there are {names}")
    if len(wanted) > 1:
        raise UnsupportedFeatureError(
            f"{path}: it holds several tables ({names}); choose with machine_axis= and "
            "measuring_system="
        )
    system, axis = wanted[0]
    return ENC.grid(keys[wanted[0]], f"axis {axis} encoder {system}", path)[0], axis
