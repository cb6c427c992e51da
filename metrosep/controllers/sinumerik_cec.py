"""SINUMERIK sag compensation, ``$AN_CEC``: one axis corrected over the position of another.

Two tables of one file hold the two directions of motion, or multiply to a map f(x) g(y). The
documents that could be read state no sign: the entry +e of the encoder compensation of the same
manual is a suggestion, and a table is written only after a trial on the machine.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from metrosep.compensation.area_errors import is_rotary
from metrosep.compensation.limits import Finding
from metrosep.compensation.maps import CompensationMap
from metrosep.compensation.products import ProductTables, rank_one
from metrosep.compensation.table import CompensationTable
from metrosep.controllers._cec_file import (
    CecTable,
    check_count,
    check_turns,
    check_values,
    read_tables,
    table_lines,
)
from metrosep.controllers._even import even_map, even_table, map_identity
from metrosep.controllers._sinumerik_file import (
    check_modulo,
    checked_name,
    folded,
    number_text,
    read_assignments,
    units,
    write_program,
)
from metrosep.controllers.base import (
    Dialect,
    DialectInfo,
    Encoded,
    Simulator,
    identity,
    load_sidecar,
    sidecar_options,
    table_lookup,
)
from metrosep.controllers.options import Option
from metrosep.core.errors import (
    CorruptFileError,
    DataError,
    LimitError,
    TableError,
    UnsupportedFeatureError,
)
from metrosep.core.units import format_length

__all__ = ["SinumerikCec", "SinumerikCecProduct"]

FloatArray = NDArray[np.float64]

_FACTOR_DECIMALS = 12
_SAME = 1e-12
"""Below a picometre nothing is left of a map."""

_RESIDUAL = 0.1
"""Share of the map's span that a product of two tables may miss."""

_DRY_RUN = "sign not documented: dry-run on the machine first"
_NOTE = "metrosep: entry_sign="

_SIGN = Option(
    "entry_sign",
    "sign of an entry for an error e = actual - nominal: 1 writes +e, -1 writes -e",
    "choice",
    default=1,
    choices=(1, -1),
)
_SHARED = (
    Option(
        "output_axis", "name of the corrected machine axis, such as AX3", "text", required=True
    ),
    Option("table_index", "index of the first table", "integer", default=0, lowest=0),
    _SIGN,
    Option("channel", "number in CHANDATA", "integer", default=1, lowest=1),
    Option("points_limit", "MD18342 of a table; 200 on 828D", "integer", lowest=2),
    Option("value_limit", "MD32720, the most the control adds", "length", positive=True),
    Option("decimals", "of an entry", "integer", default=9, lowest=1, highest=12),
)

_ACTIVATION = (
    "set MD18342 MM_CEC_MAX_POINTS[t] to the number of entries or more (828D: 8 tables of 200)",
    "set MD32720 to twice the largest correction, so that no mistake can move the axis further",
    "basic system metric (MD32711); set MD32710 CEC_ENABLE = 0 for the output axis, load the file",
    "set SD41300 CEC_TABLE_ENABLE[t] = 1 for each table and MD32710 = 1, power on, reference",
    "dry-run: move the input axis and read the correction in 'service axes', sag compensation",
)


class SinumerikCec(Dialect):
    """Writer and reader of a table for one axis over another, or over itself; see the module."""

    info = DialectInfo(
        id="sinumerik-cec",
        title="SINUMERIK sag compensation ($AN_CEC)",
        entry="+e with entry_sign=1, suggested by the encoder compensation; -e with entry_sign=-1",
        units="mm, of a turning axis degrees (basic system metric)",
        max_points=None,
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
            "input_axis", "name of the machine axis that is looked up, AX1", "text", required=True
        ),
        *_SHARED,
        Option("modulo", "the table repeats, for an axis that turns on", "flag", default=False),
        Option("input_turns", "the input axis turns: degrees", "flag", default=False),
        Option("output_turns", "the output axis turns: degrees", "flag", default=False),
        Option("spacing", "spacing of the entries, to resample", "length", positive=True),
    )

    def encode(self, table: CompensationTable, **options: Any) -> Encoded:
        """Return the text of a file; two tables where the directions differ.

        Parameters
        ----------
        table : CompensationTable
            Corrections.
        **options
            Every option, checked.

        Returns
        -------
        Encoded
            ASCII, LF.

        Raises
        ------
        TableError
            If the spacing is not uniform and none is given, or a repeating table has a step.
        LimitError
            If there are too many entries, or a correction is above `value_limit`.
        DataError
            If axes or `input_turns` and `output_turns` contradict the table.
        """
        o = {**{x.name: x.default for x in self.options}, **options}
        names = [checked_name(o[k], k) for k in ("input_axis", "output_axis")]
        if table.is_on_axis != (names[0] == names[1]):
            raise DataError(
                f"the table is {table.axis} -> {table.compensates}, but input_axis={names[0]} and "
                f"output_axis={names[1]}"
            )
        for axis, key in ((table.axis, "input_turns"), (table.compensates, "output_turns")):
            check_turns(axis, key, o[key])
        carried, error = even_table(table, o["spacing"])
        check_count(carried.positions, o, table.axis)
        columns = [carried.forward]
        if carried.reverse is not None and not np.array_equal(carried.reverse, carried.forward):
            columns.append(carried.reverse)
        unit = units(turns=o["output_turns"])
        lines: list[str] = []
        rounding = 0.0
        for k, column in enumerate(columns):
            check_values(column, carried.positions, o, table.axis)
            if o["modulo"]:
                check_modulo(float(column[0]), float(column[-1]), "the table")
            words = _words(o["entry_sign"] * -column / unit, o["decimals"])
            back = -o["entry_sign"] * np.array(words, dtype=np.float64) * unit
            rounding = max(rounding, float(np.abs(back - column).max()))
            direction = 0 if len(columns) == 1 else 1 - 2 * k
            span = [v / units(turns=o["input_turns"]) for v in carried.span]
            facts = {"DIRECTION": direction, "MULT_BY_TABLE": 0, "IS_MODULO": int(o["modulo"])}
            lines += table_lines(o["table_index"] + k, words, span, (names[0], names[1]), facts)
        return Encoded(
            data=write_program(
                "NC_CEC_INI", o["channel"], _comments(o, (table.axis, table.compensates)), lines
            ),
            quantisation=rounding,
            notes={"MD18342_at_least": carried.positions.size, "tables": len(columns)},
            step=10.0 ** -o["decimals"] * unit,
            carried=carried,
            resampling_error=error,
        )

    def decode(self, data: bytes, path: Path, **options: Any) -> CompensationTable:
        """Return the table of a file, or the two of both directions as one.

        Parameters
        ----------
        data : bytes
            Content.
        path : Path
            Its name.
        **options
            Options that the user gave; `entry_sign` is taken from metrosep's comment or the sidecar
            where it is not given, `table_index` chooses among several tables.

        Returns
        -------
        CompensationTable
            Corrections ``c = -entry_sign * entry``; zero in a direction for which there is none.

        Raises
        ------
        CorruptFileError
            If a line does not fit the format, or entries are missing.
        UnsupportedFeatureError
            If there are several tables and none is chosen, or they multiply.
        DataError
            If the sign is told by nothing, or options contradict the file.
        """
        return self._read(data, path, options)[0]

    def lookup(self, data: bytes, path: Path, **options: Any) -> Simulator:
        """Return what the control makes of the file: linear, end values hold, or it repeats.

        Parameters
        ----------
        data : bytes
            Content.
        path : Path
            Its name.
        **options
            As for `decode`.

        Returns
        -------
        callable
            ``(position, direction=1)`` to the correction in m or rad.

        Raises
        ------
        CorruptFileError, UnsupportedFeatureError, DataError
            As for `decode`.
        """
        table, modulo = self._read(data, path, options)
        simulator = table_lookup(table)
        return folded(simulator, *table.span) if modulo else simulator

    def _read(
        self, data: bytes, path: Path, options: Mapping[str, Any]
    ) -> tuple[CompensationTable, bool]:
        tables, o = _opened(data, path, self.options, options, self.info.id)
        first, second = _pair(tables, path, o)
        for name in ("input_axis", "output_axis"):
            if o.get(name, getattr(first, name)) != getattr(first, name):
                raise DataError(f"{path}: you say {name}={o[name]}, it is {getattr(first, name)}")
        unit = -o["entry_sign"] * units(turns=o.get("output_turns", False))
        columns = {t.direction: 0.0 + t.grid.entries * unit for t in (first, second) if t}
        forward = columns.get(0, columns.get(1))
        reverse = None if 0 in columns else columns.get(-1)
        if forward is None:
            forward = np.zeros(first.grid.entries.size)
        elif reverse is None and 0 not in columns:
            reverse = np.zeros(first.grid.entries.size)
        positions = first.grid.positions * units(turns=o.get("input_turns", False))
        fields = identity(path, first=float(positions[0]))
        if not load_sidecar(path):
            same = first.input_axis == first.output_axis
            names = o.get("axes", ())
            names = names if len(names) == 2 else ("X", "X" if same else "Z")
            fields |= {"axis": names[0], "compensates": names[1]}
        table = CompensationTable(
            positions=positions, forward=forward, reverse=reverse, is_exact_inverse=True, **fields
        )
        return table, first.grid.modulo


def _pair(
    tables: Mapping[int, CecTable], path: Path, options: Mapping[str, Any]
) -> tuple[CecTable, CecTable | None]:
    """Return the chosen table, and that of the other direction."""
    if any(t.multiplied_by for t in tables.values()):
        raise UnsupportedFeatureError(
            f"{path}: tables multiply (MULT_BY_TABLE): read it as 'sinumerik-cec-product'"
        )
    index = options.get("table_index", min(tables))
    if index not in tables:
        raise DataError(f"{path}: no table {index}; there are {', '.join(map(str, tables))}")
    first = tables[index]
    others = [
        t
        for t in tables.values()
        if t.index != index
        and (t.input_axis, t.output_axis) == (first.input_axis, first.output_axis)
        and (t.direction == -first.direction or not t.direction or not first.direction)
    ]
    if len(tables) > 1 + len(others) and "table_index" not in options:
        raise UnsupportedFeatureError(
            f"{path}: it holds the tables {', '.join(map(str, tables))}; choose with table_index="
        )
    if not others:
        return first, None
    same = len(others) == 1 and first.direction and others[0].direction
    if not same or not np.array_equal(others[0].grid.positions, first.grid.positions):
        raise UnsupportedFeatureError(
            f"{path}: the tables {first.index} and {others[0].index} act on the same axes and add up, "
            "or stand at other positions: metrosep reads one for each direction"
        )
    if others[0].grid.modulo != first.grid.modulo:
        raise UnsupportedFeatureError(f"{path}: only one of two directions repeats")
    return first, others[0]


class SinumerikCecProduct(Dialect):
    """Writer and reader of a map as a product of two tables; see the module."""

    info = DialectInfo(
        id="sinumerik-cec-product",
        title="SINUMERIK sag compensation over two axes, f(x) g(y) ($AN_CEC_MULT_BY_TABLE)",
        entry="first table +e with entry_sign=1, -e with -1; second a factor with peak 1 mm; multiplied",
        units="mm, positions of a turning axis degrees (basic system metric)",
        max_points=None,
        outside="end values hold",
        sign_status=(
            "not stated in the pages of the compensation manual that could be read; nor whether the "
            "second table acts by itself too"
        ),
        activation=(
            *_ACTIVATION[:3],
            "enable the second table alone (SD41300): its correction must read 0, else do not go on",
            *_ACTIVATION[3:],
        ),
        sign="unconfirmed",
        carries="map",
        spacing="uniform",
        directions="one",
        resolution="1 pm with 9 decimals; float64 inside",
        reference_rule="none; what the product leaves at the map's reference is in the sidecar",
        suffix=".INI",
        example={"first_input_axis": "AX1", "second_input_axis": "AX2", "output_axis": "AX3"},
        page="sinumerik",
    )

    options = (
        Option(
            "first_input_axis", "machine axis of the map's columns, AX1", "text", required=True
        ),
        Option("second_input_axis", "machine axis of its rows, AX2", "text", required=True),
        *_SHARED,
        Option(
            "accept_residual",
            "write although the product misses more than a tenth of the map's span",
            "flag",
            default=False,
        ),
        Option("first_spacing", "spacing of the columns, to resample", "length", positive=True),
        Option("second_spacing", "spacing of the rows, to resample", "length", positive=True),
    )

    def encode(self, table: CompensationMap, **options: Any) -> Encoded:
        """Return the text of a file of two tables.

        Parameters
        ----------
        table : CompensationMap
            Corrections.
        **options
            Every option, checked.

        Returns
        -------
        Encoded
            ASCII, LF; `notes` tell the residual of the product.

        Raises
        ------
        LimitError
            If the product misses more than a tenth of the map's span and `accept_residual` is not
            said, there are too many entries, or a correction is above `value_limit`.
        TableError
            If the spacing is not uniform and none is given, the corrected axis turns, or the map is
            zero everywhere.
        DataError
            If an axis has no proper name, or axes contradict the map.
        """
        o = {**{x.name: x.default for x in self.options}, **options}
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
        even, error = even_map(
            table,
            (o["first_spacing"], o["second_spacing"]),
            ("first_spacing", "second_spacing"),
        )
        product = rank_one(even)
        missed = _missed(product, o)
        carried = product.as_map()
        for positions, axis in ((even.x, even.axes[0]), (even.y, even.axes[1])):
            check_count(positions, o, axis)
        check_values(carried.values.ravel(), np.tile(even.x, even.y.size), o, even.axes[0])
        unit = units(turns=False)
        first = _words(-o["entry_sign"] * product.first.forward / unit, o["decimals"])
        second = _words(product.second.forward, _FACTOR_DECIMALS)
        f, g = (np.array(w, dtype=np.float64) for w in (first, second))
        back = -o["entry_sign"] * unit * f * g[:, None]
        t = o["table_index"]
        lines: list[str] = []
        for k, (words, positions) in enumerate(((first, even.x), (second, even.y))):
            scale = units(turns=is_rotary(even.axes[k]))
            facts = {"DIRECTION": 0, "MULT_BY_TABLE": 0 if k else t + 2, "IS_MODULO": 0}
            span = [float(positions[0]) / scale, float(positions[-1]) / scale]
            lines += table_lines(t + k, words, span, (names[k], names[2]), facts)
        return Encoded(
            data=write_program(
                "NC_CEC_INI",
                o["channel"],
                _comments(o, (*even.axes, even.compensates), _turning(even)),
                lines,
            ),
            quantisation=float(np.abs(back - carried.values).max()),
            notes={
                "tables": 2,
                "residual_max_m": missed,
                "residual_pv_m": product.residual_pv,
                "residual_rms_m": product.residual_rms,
                "residual_share": product.share,
                "at_reference_m": product.at_reference,
                "convention": product.convention,
            },
            step=10.0 ** -o["decimals"] * unit,
            carried=carried,
            resampling_error=error,
            findings=_findings(product, missed),
        )

    def decode(self, data: bytes, path: Path, **options: Any) -> CompensationMap:
        """Return the map of a file of two tables that multiply.

        Parameters
        ----------
        data : bytes
            Content.
        path : Path
            Its name.
        **options
            Options that the user gave; `entry_sign` is taken from metrosep's comment or the sidecar
            where it is not given.

        Returns
        -------
        CompensationMap
            Corrections at the nodes of both tables.

        Raises
        ------
        CorruptFileError
            If a line does not fit the format, or a table that is named is not there.
        UnsupportedFeatureError
            If there are other tables too, or they repeat or depend on the direction.
        DataError
            If the sign is told by nothing, or options contradict the file.
        """
        tables, o = _opened(data, path, self.options, options, self.info.id)
        first, second = _factors(tables, path)
        found = (first.input_axis, second.input_axis, first.output_axis)
        keys = ("first_input_axis", "second_input_axis", "output_axis")
        for name, value in zip(keys, found, strict=True):
            if o.get(name, value) != value:
                raise DataError(f"{path}: you say {name}={o[name]}, it is {value}")
        turning = o.get("turning", "")
        noted = o.get("axes", ())
        noted = noted if len(noted) == 3 else ("X", "Y", "Z")
        x, y = (
            t.grid.positions * units(turns=str(k) in turning) for k, t in ((1, first), (2, second))
        )
        unit = -o["entry_sign"] * units(turns=False)
        return CompensationMap(
            x=x,
            y=y,
            values=0.0 + unit * first.grid.entries * second.grid.entries[:, None],
            is_exact_inverse=True,
            **map_identity(
                path,
                axes=(noted[0], noted[1]),
                compensates=noted[2],
                first=(float(x[0]), float(y[0])),
            ),
        )


def _factors(tables: Mapping[int, CecTable], path: Path) -> tuple[CecTable, CecTable]:
    """Return the table that is multiplied, and the one it is multiplied by."""
    linked = [t for t in tables.values() if t.multiplied_by]
    if len(linked) != 1 or len(tables) != 2:
        raise UnsupportedFeatureError(
            f"{path}: it holds {len(tables)} tables of which {len(linked)} multiply; metrosep reads two "
            "tables, one multiplied by the other"
        )
    first = linked[0]
    other = first.multiplied_by - 1
    if other not in tables or other == first.index:
        raise CorruptFileError(
            path,
            f"table {first.index} is multiplied by table index {other}, which is not in the file",
            field="MULT_BY_TABLE",
        )
    second = tables[other]
    plain = not (first.direction or second.direction or first.grid.modulo or second.grid.modulo)
    if not plain or second.output_axis != first.output_axis:
        raise UnsupportedFeatureError(
            f"{path}: tables that multiply and repeat, depend on the direction or differ in the "
            "output axis are not read"
        )
    return first, second


def _missed(product: ProductTables, o: Mapping[str, Any]) -> float:
    missed = float(np.abs(product.residual).max())
    span = float(np.ptp(product.map.values))
    if missed > _RESIDUAL * span and not o["accept_residual"]:
        raise LimitError(
            f"the map is no product of two tables: f(x) g(y) misses it by up to "
            f"{format_length(missed, digits=3)}, its corrections span {format_length(span, digits=3)}; "
            "write a table over one axis, choose a control that holds maps, or accept it with "
            "accept_residual=True"
        )
    return missed


def _findings(product: ProductTables, missed: float) -> tuple[Finding, ...]:
    shown = [missed > _SAME, abs(product.at_reference) > _SAME]
    return tuple(
        Finding("warning", message, "see the residual in the sidecar", "product")
        for message, show in zip(product.messages, shown, strict=False)
        if show
    )


def _comments(o: Mapping[str, Any], axes: Sequence[str], turning: str = "") -> list[str]:
    sign = "+" if o["entry_sign"] > 0 else "-"
    more = f" turning={turning}" if turning else ""
    if all(a.isascii() and a.isalnum() for a in axes):
        more += f" axes={','.join(axes)}"
    return [f"entry = {sign}e, {_DRY_RUN}", f"{_NOTE}{o['entry_sign']}{more}"]


def _turning(corrections: CompensationMap) -> str:
    return "".join(str(k) for k, a in enumerate(corrections.axes, start=1) if is_rotary(a))


def _words(values: FloatArray, decimals: int) -> list[str]:
    return [number_text(float(v), decimals=decimals) for v in values]


def _opened(
    data: bytes,
    path: Path,
    known: tuple[Option, ...],
    options: Mapping[str, Any],
    controller: str,
) -> tuple[dict[int, CecTable], dict[str, Any]]:
    """Return the tables of a file by index, and what is known about them."""
    assignments, comments = read_assignments(data, path)
    noted: dict[str, Any] = {}
    for comment in comments:
        if comment.startswith(_NOTE):
            words = dict(w.partition("=")[::2] for w in comment.split()[1:])
            noted["entry_sign"] = _SIGN.checked(words["entry_sign"], "comment in the file")
            noted["turning"] = words.get("turning", "")
            noted["axes"] = tuple(words["axes"].split(",")) if "axes" in words else ()
    o = {**noted, **sidecar_options(path, known), **options}
    if "entry_sign" not in o:
        raise DataError(
            f"{path}: neither the file nor a sidecar tells the sign of its entries; give entry_sign=1 "
            f"(entry = +e) or -1 to read it as {controller}"
        )
    return read_tables(assignments, path), o
