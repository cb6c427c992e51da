"""SINUMERIK encoder and spindle error compensation, ``$AA_ENC_COMP``.

The entry is added to the ACTUAL value of the axis, so a positive one drives the axis in negative
direction: the entry for an error e is +e, the opposite of most controllers.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from metrosep.compensation.area_errors import format_position, is_rotary
from metrosep.compensation.table import CompensationTable
from metrosep.controllers._along import AlongOption, along_axis, format_amount, format_span
from metrosep.controllers._even import even_table
from metrosep.controllers._notes import agreed
from metrosep.controllers._sinumerik_file import (
    Assignment,
    Grid,
    axis_letter,
    checked_modulo,
    checked_name,
    folded,
    grid_of,
    number_text,
    read_assignments,
    turning,
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

__all__ = ["SinumerikEnc"]


_NAME = "$AA_ENC_COMP"
_FACTS = ("STEP", "MIN", "MAX", "IS_MODULO")
_POSITION_DECIMALS = 12


class SinumerikEnc(Dialect):
    """Writer and reader of ``AX_EEC_INI``; see the module."""

    info = DialectInfo(
        id="sinumerik-enc",
        title="SINUMERIK encoder error compensation ($AA_ENC_COMP)",
        entry="+e, added to the actual value: a positive entry moves the axis in negative direction",
        units="mm, of a turning axis degrees (basic system metric)",
        max_points=None,
        outside="end values hold; with modulo=True it repeats",
        sign_status="documented explicitly in the compensation manual K3; not run",
        activation=(
            "save the memory, set MD38000 MM_ENC_COMP_MAX_POINTS to the number of entries or more",
            "basic system metric; set MD32700 ENC_COMP_ENABLE = 0 for the axis, load the file",
            "set MD32700 = 1, power on, reference the axis",
            "check in 'service axes' that the correction at a bump is the opposite of its error",
        ),
        sign="documented",
        spacing="uniform",
        directions="one",
        resolution="1 pm with 9 decimals; float64 inside",
        reference_rule="zero at the reference point, or the axis jumps when it is referenced",
        suffix=".INI",
        example={"machine_axis": "X1"},
        page="sinumerik",
    )

    options = (
        Option("machine_axis", "name of the machine axis, such as X1", "text", required=True),
        Option(
            "measuring_system",
            "0 for the first encoder of the axis, 1 for the second",
            "choice",
            default=0,
            choices=(0, 1),
        ),
        Option("channel", "number in CHANDATA", "integer", default=1, lowest=1),
        Option("modulo", "the table repeats, for an axis that turns on", "flag", default=False),
        Option("turns", "the axis turns: rad in the table, degrees here", "flag", default=False),
        Option("points_limit", "MD38000 of the axis; 200 on 808D and 828D", "integer", lowest=2),
        AlongOption(
            "reference_point", "machine position of the reference point", "length or angle"
        ),
        AlongOption(
            "spacing", "spacing of the entries, to resample", "length or angle", positive=True
        ),
        Option("decimals", "of an entry", "integer", default=9, lowest=1, highest=12),
    )

    def encode(self, table: CompensationTable, **options: Any) -> Encoded:
        """Return the text of a file."""
        o = {**{x.name: x.default for x in self.options}, **options}
        axis = checked_name(o["machine_axis"], "machine_axis")
        if not table.is_on_axis:
            raise TableError(
                f"ENC_COMP corrects an axis over its own position, this table is {table.axis} -> "
                f"{table.compensates}; write it as 'sinumerik-cec'"
            )
        if table.reverse is not None and not np.array_equal(table.reverse, table.forward):
            raise TableError(
                "ENC_COMP holds one value for both directions, this table has two: make it with "
                'direction="both" and put the lost motion into MD32450 BACKLASH, or write it as '
                "'sinumerik-cec', which has a table for each direction"
            )
        if is_rotary(table.axis) != o["turns"]:
            raise DataError(
                f"the axis of the table is {table.axis}, but turns={o['turns']}: a turning axis is "
                "written in degrees"
            )
        carried, error = even_table(table, along_axis(o["spacing"], table.axis, "spacing"))
        _require_zero(carried, o)
        n = carried.positions.size
        if o["points_limit"] is not None and n > o["points_limit"]:
            needed = (table.span[1] - table.span[0]) / (o["points_limit"] - 1)
            raise LimitError(
                f"{n} entries, the control holds {o['points_limit']} for this axis; use a spacing of "
                f"at least {format_span(table.axis, needed)} (spacing='...'), or raise MD38000"
            )
        unit = units(turns=o["turns"])
        words = [
            number_text(-c / unit, decimals=o["decimals"], at_least=1) for c in carried.forward
        ]
        if o["modulo"]:
            checked_modulo(words, carried.forward, carried.span, table.axis)
        back = -np.array(words, dtype=np.float64) * unit
        facts: dict[str, object] = {"turns": int(o["turns"])}
        if table.axis.isascii() and table.axis.isalnum():
            facts["axis"] = table.axis
        return Encoded(
            data=write_program(
                "AX_EEC_INI", o["channel"], (), _lines(words, carried, unit, axis, o), facts
            ),
            quantisation=float(np.abs(back - carried.forward).max()),
            notes={"MD38000_at_least": n},
            step=10.0 ** -o["decimals"] * unit,
            carried=carried,
            resampling_error=error,
        )

    def decode(self, data: bytes, path: Path, **options: Any) -> CompensationTable:
        """Return the table of a file."""
        return self._read(data, path, options)[0]

    def _read(
        self, data: bytes, path: Path, options: dict[str, Any]
    ) -> tuple[CompensationTable, bool]:
        assignments, noted = read_assignments(data, path)
        o = agreed(noted, self.options, {**sidecar_options(path, self.options), **options}, path)
        grid, name = _chosen(assignments, path, o)
        turns = turning(name, o.get("turns"), "turns=True or turns=False", path)
        unit = units(turns=turns)
        positions = grid.positions * unit
        fields = identity(path, first=float(positions[0]))
        if not load_sidecar(path).get("table"):
            letter = noted.get("axis", axis_letter(name, turns=turns, otherwise="X"))
            fields["axis"] = fields["compensates"] = letter
        if fields["axis"] != fields["compensates"]:
            raise CorruptFileError(
                path,
                f"it is said to correct {fields['compensates']} over {fields['axis']}, but the table "
                "corrects an axis over its own position",
                hint="use the sidecar that fits, or write the table again",
            )
        if is_rotary(fields["axis"]) != turns:
            raise DataError(
                f"{path}: turns={turns}, but the axis is said to be {fields['axis']}; leave turns out, "
                "or use the sidecar that fits"
            )
        table = CompensationTable(
            positions=positions,
            forward=0.0 - grid.entries * unit,
            reverse=None,
            is_exact_inverse=True,
            **fields,
        )
        return table, grid.modulo

    def lookup(self, data: bytes, path: Path, **options: Any) -> Simulator:
        """Return what the control makes of the file: linear, end values hold, or it repeats."""
        table, modulo = self._read(data, path, options)
        simulator = table_lookup(table)
        return folded(simulator, *table.span) if modulo else simulator


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
            "make the table with CompensationTable.from_error(..., reference=<reference point>), with "
            "the reference point among its positions (and a spacing= that keeps it one), or give "
            "reference_point="
        )


def _lines(
    words: list[str], table: CompensationTable, unit: float, axis: str, o: dict[str, Any]
) -> list[str]:
    system = o["measuring_system"]
    low, high = (v / unit for v in table.span)
    facts = {
        "STEP": (high - low) / (len(words) - 1),
        "MIN": low,
        "MAX": high,
    }
    return [
        *(f"{_NAME}[{system},{i},{axis}]={w}" for i, w in enumerate(words)),
        *(
            f"{_NAME}_{k}[{system},{axis}]={number_text(v, decimals=_POSITION_DECIMALS, at_least=1)}"
            for k, v in facts.items()
        ),
        f"{_NAME}_IS_MODULO[{system},{axis}]={int(o['modulo'])}",
    ]


def _chosen(assignments: list[Assignment], path: Path, o: dict[str, Any]) -> tuple[Grid, str]:
    """Return the one table of the file, or that of the axis and encoder that the user named."""
    values: dict[tuple[str, str], dict[int, Assignment]] = {}
    facts: dict[tuple[str, str], dict[str, Assignment]] = {}
    for a in assignments:
        kind = a.name.removeprefix(f"{_NAME}_")
        if a.name == _NAME and len(a.indices) == 3 and a.indices[1].isdigit():
            values.setdefault((a.indices[0], a.indices[2]), {})[int(a.indices[1])] = a
        elif a.name != _NAME and kind in _FACTS and len(a.indices) == 2:
            facts.setdefault((a.indices[0], a.indices[1]), {})[kind] = a
        else:
            raise CorruptFileError(
                path, f"line {a.line}: {a.name}[{','.join(a.indices)}] is no part of such a table"
            )
    keys = list(dict.fromkeys([*values, *facts]))
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
    key = wanted[0]
    grid = grid_of(
        values.get(key, {}), facts.get(key, {}), path, f"axis {key[1]} encoder {key[0]}"
    )
    return grid, key[1]
