"""Text formats that a ``format.toml`` describes: a new logger needs no Python.

``reader = "layout"`` and a ``[layout]`` table say by which lines the text is recognised, where its
table begins, how it is written and what each column is. Everything else (checks of every field,
units, objects) is that of plain column text. The keys are those of `LAYOUT_KEYS` and
`COLUMN_KEYS`; a key that is not one of them is refused by name.
"""

from __future__ import annotations

import itertools
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from metrosep.core.errors import FormatMismatchError, ReadError, UnitError
from metrosep.core.profile import Profile
from metrosep.core.recording import Recording
from metrosep.core.surface import Surface
from metrosep.core.units import (
    Unit,
    parse_quantity,
    parse_sensitivity,
    parse_unit,
)
from metrosep.io.declared import LAYOUT_LINES, Match
from metrosep.io.source import RawFile, refuse_options
from metrosep.io.text.encoding import decode
from metrosep.io.text.logger import first_lines
from metrosep.io.text.measurement import measurement
from metrosep.io.text.table import Column, Table, read_table

LAYOUT_KEYS = {
    "recognise": "texts that begin lines of the head, in this order; all must be there",
    "table_after": "text that begins the line after which the table stands",
    "header_lines": "number of lines before the table, instead of table_after",
    "separator": "tab, comma, semicolon or space",
    "decimal": ". or ,",
    "encoding": "such as utf-8 or latin-1; found from the content if omitted",
    "comment": "start of lines to leave out",
    "key_separator": "splits the lines of the head into key and value",
    "sampling_rate": "such as '2 kHz', for text without a column of time",
    "sampling_rate_key": "key of the head that holds it",
    "sampling_interval_key": "key of the head that holds the time between samples",
    "columns": "what each column is",
}
"""Keys of ``[layout]`` and what they mean."""

COLUMN_KEYS = {
    "name": "what the channel is called",
    "unit": "unit of the numbers, where the text does not say it or says it oddly",
    "role": "time, x, y, z, channel or ignore",
    "sensitivity": "of a sensor whose column is a voltage, such as '2.5 um/V'; its sign is kept",
}
"""Keys of ``[[layout.columns]]`` and what they mean."""

_ROLES = ("time", "x", "y", "z", "channel", "ignore")
_KINDS = {int: "whole number", list: "list", str: "text"}


@dataclass(frozen=True, slots=True)
class _ColumnLayout:
    """One column: name, unit, role and factor to SI where a sensitivity is declared."""

    name: str
    unit: Unit | None
    role: str
    sensitivity: float | None

    def apply(self, file: RawFile, column: Column) -> Column:
        """Return the column of a table under its name, in its unit."""
        unit = self.unit or column.unit
        if self.unit is not None and column.unit is not None and self.unit != column.unit:
            raise FormatMismatchError(
                f"{file.path}: column {column.name!r} is in {column.unit.name} by its header, but the "
                f"description of {self.name!r} says {self.unit.name}; correct one of them"
            )
        if self.sensitivity is None or column.values is None:
            return Column(self.name, unit, column.values, column.labels)
        unit = unit or parse_unit("V")
        if unit.dimension != "voltage":
            raise UnitError(
                f"{file.path}: column {self.name!r} has a sensitivity, but is in {unit.name}, not in volts; "
                "leave the sensitivity out of the description"
            )
        values = column.values * (unit.factor * self.sensitivity)
        return Column(self.name, parse_unit("m"), values, None)


class LayoutReader:
    """Reader of one text format."""

    def __init__(
        self, format_id: str, title: str, layout: Mapping[str, Any], where: object
    ) -> None:
        self._id, self._title, self._where = format_id, title, where
        self._layout = dict(layout)
        self._refuse_unknown("layout", self._layout, LAYOUT_KEYS)
        marks = self._layout.get("recognise")
        texts = isinstance(marks, list) and all(isinstance(m, str) and m.strip() for m in marks)
        if not marks or not texts:
            raise ReadError(
                f"{where}: [layout] recognise must list texts that begin lines of the head, such as "
                'recognise = ["ACME logger"]'
            )
        self._marks: tuple[str, ...] = tuple(marks)
        if ("table_after" in layout) == ("header_lines" in layout):
            raise ReadError(f"{where}: [layout] needs one of table_after and header_lines")
        self._columns = tuple(self._column(c) for c in self._layout.get("columns", ()))
        self._check()

    def _check(self) -> None:
        """Refuse a description whose parts are missing, doubled or of the wrong kind."""
        if not self._columns:
            raise ReadError(f"{self._where}: [[layout.columns]] is missing; describe each column")
        names = [c.name for c in self._columns if c.role != "ignore"]
        roles = [c.role for c in self._columns if c.role not in ("channel", "ignore")]
        for what, items in (("name", names), ("role", roles)):
            twice = [i for i in items if items.count(i) > 1]
            if twice:
                raise ReadError(
                    f"{self._where}: two columns have the {what} {twice[0]!r}; give each its own"
                )
        for key, value in self._layout.items():
            kind = {"header_lines": int, "recognise": list, "columns": list}.get(key, str)
            if not isinstance(value, kind) or isinstance(value, bool):
                raise ReadError(
                    f"{self._where}: [layout] {key} must be a {_KINDS[kind]}, found {value!r}"
                )
        for key in ("sampling_rate_key", "sampling_interval_key"):
            if key in self._layout and not self._layout.get("key_separator"):
                raise ReadError(f"{self._where}: [layout] {key} needs key_separator")
        if (
            "sampling_rate" in self._layout
            and not _si(self._layout["sampling_rate"], "frequency") > 0
        ):
            raise ReadError(
                f"{self._where}: [layout] sampling_rate must be a frequency such as '2 kHz', found "
                f"{self._layout['sampling_rate']!r}"
            )

    def _refuse_unknown(
        self, table: str, given: Mapping[str, Any], known: Mapping[str, str]
    ) -> None:
        unknown = [key for key in given if key not in known]
        if unknown:
            raise ReadError(
                f"{self._where}: [{table}] has no key {unknown[0]!r}; the keys are {', '.join(known)}"
            )

    def _column(self, entry: Mapping[str, Any]) -> _ColumnLayout:
        self._refuse_unknown("[layout.columns]", entry, COLUMN_KEYS)
        role = str(entry.get("role", "channel"))
        if "name" not in entry or role not in _ROLES:
            raise ReadError(
                f"{self._where}: a column needs a name and a role of {', '.join(_ROLES)}; found {dict(entry)}"
            )
        try:
            unit = parse_unit(str(entry["unit"])) if "unit" in entry else None
            factor = (
                parse_sensitivity(str(entry["sensitivity"])) if "sensitivity" in entry else None
            )
        except UnitError as exc:
            raise ReadError(f"{self._where}: column {entry['name']!r}: {exc}") from None
        return _ColumnLayout(str(entry["name"]), unit, role, factor)

    def sniff(self, file: RawFile) -> Match:
        """Return how sure the reader is."""
        lines = first_lines(file, self._layout.get("encoding"))
        first, *others = self._marks
        if not any(s.lstrip().startswith(first) for s in itertools.islice(lines, LAYOUT_LINES)):
            return Match.NO
        found = all(any(line.lstrip().startswith(m) for line in lines) for m in others)
        return Match.YES if found else Match.NO

    def channels(self, file: RawFile) -> tuple[str, ...]:
        """Return the columns that are channels."""
        return tuple(c.name for c in self._columns if c.role == "channel") or ("height",)

    def read(
        self,
        file: RawFile,
        *,
        channel: str | None = None,
        lateral_step: Any = None,
        unit: Any = None,
        sampling_rate: float | str | None = None,
        scale: float | str | None = None,
    ) -> Surface | Profile | Recording:
        """Return the measurement."""
        head, skip = self._head(file)
        table = read_table(
            file,
            separator=self._layout.get("separator"),
            decimal=self._layout.get("decimal"),
            encoding=self._layout.get("encoding"),
            comment=self._layout.get("comment"),
            skip_rows=skip,
        )
        fields = self._fields(head)
        table = self._described(file, table, head, fields)
        role = {c.role: c.name for c in self._columns if c.role not in ("channel", "ignore")}
        timed = "time" in role or "z" not in role
        if "time" in role and sampling_rate is not None:
            refuse_options(
                file, f"{self._title} with a column of time", sampling_rate=sampling_rate
            )
        rate = (
            self._rate(file, fields, table.header["decimal"])
            if sampling_rate is None
            else sampling_rate
        )
        return measurement(
            file,
            table,
            self._id,
            channel=channel,
            lateral_step=lateral_step,
            unit=unit,
            x=role.get("x"),
            y=role.get("y"),
            z=role.get("z"),
            time=role.get("time"),
            sampling_rate=rate if timed and "time" not in role else None,
            scale=scale,
        )

    def _head(self, file: RawFile) -> tuple[list[str], int]:
        """Return the lines before the table, and how many they are."""
        text, _ = decode(file.data, file.path, self._layout.get("encoding"))
        lines = text.split("\n")
        if "header_lines" in self._layout:
            n = int(self._layout["header_lines"])
            return lines[:n], n
        mark = str(self._layout["table_after"])
        for i, line in enumerate(lines):
            if line.lstrip().startswith(mark):
                return lines[: i + 1], i + 1
        raise FormatMismatchError(
            f"{file.path}: is not a {self._title}: no line begins with {mark!r}; leave out format= to have "
            "it recognised"
        )

    def _fields(self, head: Sequence[str]) -> dict[str, str]:
        mark = self._layout.get("key_separator")
        if mark is None:
            return {}
        pairs = (line.partition(str(mark)) for line in head if str(mark) in line)
        return {key.strip(): value.strip() for key, _, value in pairs}

    def _described(
        self, file: RawFile, table: Table, head: Sequence[str], fields: Mapping[str, str]
    ) -> Table:
        if len(table.columns) != len(self._columns):
            raise file.corrupt(
                f"the table is not that of {self._title}",
                field="columns",
                expected=f"{len(self._columns)} columns",
                found=str(len(table.columns)),
                hint=f"correct the description {self._where}, or export the file again",
            )
        pairs = zip(self._columns, table.columns, strict=True)
        columns = tuple(own.apply(file, c) for own, c in pairs if own.role != "ignore")
        header = {**table.header, "head": tuple(head), **fields}
        return replace(table, columns=columns, header=header)

    def _rate(
        self, file: RawFile, fields: Mapping[str, str], table_decimal: str
    ) -> float | str | None:
        if "sampling_rate" in self._layout:
            return str(self._layout["sampling_rate"])
        for key, dimension in (
            ("sampling_rate_key", "frequency"),
            ("sampling_interval_key", "time"),
        ):
            wanted = self._layout.get(key)
            if wanted is None:
                continue
            found = [k for k in fields if _bare_key(k) == _bare_key(str(wanted))]
            if len(found) > 1:
                raise file.corrupt(
                    "the head says twice how fast it was sampled",
                    field=str(wanted),
                    found=" and ".join(found),
                )
            name = found[0] if found else None
            value = float("nan")
            if name is not None:
                mark = str(self._layout.get("decimal", table_decimal))
                value = _si(f"{fields[name]} {_bracketed(name)}", dimension, mark)
            if not (np.isfinite(value) and value > 0.0):
                raise file.corrupt(
                    "the head does not say how fast it was sampled",
                    field=str(wanted),
                    expected=f"a positive {dimension} with its unit",
                    found=repr(fields[name]) if name else "nothing",
                    hint="give sampling_rate=",
                )
            return value if dimension == "frequency" else 1.0 / value
        return None


def _bracketed(name: str) -> str:
    match = re.search(r"[\[(]\s*([^\])]+?)\s*[\])]", name)
    return match.group(1) if match else ""


def _bare_key(name: str) -> str:
    return re.sub(r"[\[(].*", "", name).strip().casefold()


def _si(text: str, dimension: str, decimal: str = ".") -> float:
    """Return a number with its unit in SI, NaN where it is none or has the other decimal mark."""
    number = text.strip()
    if decimal == ",":
        number = number.replace(".", "?").replace(",", ".")
    try:
        return parse_quantity(number, dimension=dimension)
    except UnitError:
        return float("nan")
