"""What machines log item by item: MTConnect adapters and agents, and values of an OPC UA historian.

Every item has its own irregular times. The recording has the union of them with NaN where an item did
not report; ``channel=`` gives one item with its own times. No clock is invented, nothing is held. See
``data_formats/mtconnect/SPEC.md`` and ``data_formats/opcua/SPEC.md``.
"""

from __future__ import annotations

import csv
import re
from collections import Counter
from dataclasses import dataclass, field
from datetime import UTC, datetime
from typing import Any

import numpy as np

from metrosep.core.errors import CorruptFileError, ReadNameError
from metrosep.core.recording import Recording
from metrosep.io.declared import Match
from metrosep.io.registry import BuiltIn, demand, mismatch, sniffer
from metrosep.io.source import RawFile, refuse_options
from metrosep.io.text.dialect import header_unit
from metrosep.io.text.logger import Channels, text_lines

_STAMP = re.compile(
    r"(\d{4}-\d\d-\d\d)[T ](\d\d:\d\d:\d\d)(?:[.,](\d{1,9}))?\s*(Z|[+-]\d\d:?\d\d)?"
)

_YEARS = (1970, 2200)
"""Years of a log; nanoseconds in 64 bits end in 2262."""


@dataclass
class _Items:
    """Values of each item over its stamps in ns, and what was left out."""

    file: RawFile
    values: dict[str, dict[int, float]] = field(default_factory=dict)
    texts: Counter[str] = field(default_factory=Counter)  # values that are no numbers, by item
    twice: int = 0
    bad: int = 0  # values whose quality is not good
    zone: str = ""
    unit: str = ""  # of all values, as a header names it

    def add(self, name: str, at: int, text: str, *, missing: bool = False) -> None:
        """Add a value of an item; a word that is no number is counted."""
        try:
            number = float("nan") if missing else float(text)
        except ValueError:
            self.texts[name] += 1
            return
        item = self.values.setdefault(name, {})
        self.twice += at in item
        item[at] = number

    def time(self, text: str, line: int) -> int:
        """Return a stamp in ns from 1970, in the zone of the file."""
        found = _STAMP.fullmatch(text.strip())
        try:
            if found is None:
                raise ValueError  # noqa: TRY301  (the same refusal as a day that does not exist)
            moment = datetime.fromisoformat(f"{found[1]}T{found[2]}+00:00")
            if not _YEARS[0] <= moment.year < _YEARS[1]:
                raise ValueError  # noqa: TRY301
        except ValueError:
            raise self.file.corrupt(
                "a stamp is not a date and a clock",
                field=f"line {line}" if line else None,
                expected="2026-03-05T14:07:09.12Z",
                found=repr(text[:40]),
            ) from None
        zone = found[4] or "none"
        if self.zone not in ("", zone):
            raise self.file.corrupt(
                "stamps have different zones", field=f"line {line}", expected=self.zone, found=zone
            )
        self.zone = zone
        return int(moment.timestamp()) * 10**9 + int((found[3] or "").ljust(9, "0"))

    def recording(self, format_id: str, channel: str | None, unit: Any, header: Any) -> Recording:
        """Return the items as a recording that begins with the earliest of them."""
        items = {n: v for n, v in self.values.items() if any(x == x for x in v.values())}
        if channel is not None and channel not in items:
            raise ReadNameError(
                f"{self.file.path}: has no item {channel!r} of numbers; there is {', '.join([*items][:20])}"
            )
        if not items:
            raise self.file.corrupt(
                "no item holds a number", found=f"{len(self.texts)} items of texts"
            )
        first = min(min(v) for v in items.values())
        data = Channels(self.file)
        for name, item in items.items():
            stamps = np.array(sorted(item), dtype=np.int64)
            t = np.asarray((stamps - first) * 1e-9, dtype=np.float64)
            data.add(name, t, np.array([item[s] for s in stamps.tolist()]), self.unit)
        warnings = []
        if self.texts:
            shown = ", ".join(f"{n} ({k})" for n, k in self.texts.most_common(8))
            warnings.append(f"values that are not numbers were omitted: {shown}")
        if self.twice:
            warnings.append(
                f"{self.twice} values have the stamp of another one of their item: the last is kept"
            )
        if self.bad:
            warnings.append(f"{self.bad} values are not good by their quality: NaN")
        start = datetime.fromtimestamp(first // 10**9, tz=UTC)
        return data.recording(
            format_id,
            header,
            channel=channel,
            unit=unit,
            union=channel is None,
            warnings=tuple(warnings),
            start=f"{start:%Y-%m-%dT%H:%M:%S}.{first % 10**9:09d}",
            zone=self.zone,
        )


# ---- MTConnect: lines ``stamp|item|value|item|value`` of an adapter, or the streams of an agent ------

_MTCONNECT = "mtconnect"
_UNAVAILABLE = "UNAVAILABLE"
_CONDITION_FIELDS = 6
"""Stamp, item, level, code, severity and qualifier (and a text): a condition, no value."""

_LEVELS = ("NORMAL", "WARNING", "FAULT", _UNAVAILABLE)


def _mtconnect_sniff(file: RawFile) -> Match:
    """Return how sure we are: XML is of an agent if it has the element, wherever it lies."""
    found = sniffer(_MTCONNECT)(file)
    is_xml = file.head.lstrip(b"\xef\xbb\xbf \r\n").startswith(b"<")
    return Match.NO if is_xml and b"<MTConnectStreams" not in file.data else found


def _mtconnect_items(file: RawFile) -> _Items:
    if not _mtconnect_sniff(file):
        raise mismatch(file, _MTCONNECT)
    items = _Items(file)
    if file.head.lstrip(b"\xef\xbb\xbf \r\n").startswith(b"<"):
        _add_streams(file, items)
        return items
    for number, line in enumerate(text_lines(file), start=1):
        if not line.strip() or line.startswith("*"):  # commands between adapter and agent
            continue
        stamp, *fields = line.split("|")
        at = items.time(stamp, number)
        if len(fields) >= _CONDITION_FIELDS - 1 and fields[1].upper() in _LEVELS:
            items.texts[fields[0]] += 1
            continue
        if len(fields) % 2:
            raise file.corrupt(
                "an item has no value",
                field=f"line {number}",
                expected="pairs",
                found=repr(line[:40]),
            )
        for name, value in zip(fields[::2], fields[1::2], strict=True):
            text = value.strip()
            items.add(name.strip(), at, text, missing=text.upper() == _UNAVAILABLE)
    return items


def _add_streams(file: RawFile, items: _Items) -> None:
    """Add the samples of an agent's answer."""
    from xml.etree.ElementTree import ParseError

    from defusedxml import DefusedXmlException
    from defusedxml.ElementTree import fromstring

    try:
        root = fromstring(file.data, forbid_dtd=True)
    except (ParseError, DefusedXmlException, ValueError, LookupError) as exc:
        raise file.corrupt(f"is not well-formed XML ({str(exc)[:80]})") from None
    for samples in (e for e in root.iter() if e.tag.rpartition("}")[2] == "Samples"):
        for sample in samples:
            name = sample.get("dataItemId") or sample.get("name") or ""
            text = (sample.text or "").strip()
            at = items.time(sample.get("timestamp") or "", 0)
            items.add(name, at, text, missing=text == _UNAVAILABLE)


# ---- OPC UA: one row for each value, with its quality ------------------------------------------------

_OPCUA = "opcua"
_TIME = ("timestamp", "sourcetimestamp", "servertimestamp", "time", "datetime")
_VALUE = ("value",)
_QUALITY = ("quality", "status", "statuscode")
_ITEM = ("item", "tag", "tagname", "node", "nodeid", "name")
_GOOD = ("good", "192", "0", "0x00000000", "0x0")


def _opcua_items(file: RawFile) -> _Items:
    demand(file, _OPCUA)
    items = _Items(file)
    lines = text_lines(file)
    separator = max(",;\t", key=lines[0].count)
    rows = csv.reader(lines, delimiter=separator)

    def unreadable(exc: csv.Error) -> CorruptFileError:
        return file.corrupt(f"a row cannot be read ({exc})", field=f"line {rows.line_num}")

    try:
        named = [header_unit(n) for n in next(rows)]
        names = [re.sub(r"[\s_\-]", "", n).lower() for n, _ in named]
    except csv.Error as exc:
        raise unreadable(exc) from None

    def place(known: tuple[str, ...]) -> int | None:
        return next((names.index(n) for n in known if n in names), None)

    time, value, quality, item = (place(k) for k in (_TIME, _VALUE, _QUALITY, _ITEM))
    if time is None or value is None or quality is None:
        raise file.corrupt("lacks a column", field="line 1", expected="timestamp, value, quality")
    items.unit = "" if (own := named[value][1]) is None else own.name
    try:
        for row in rows:
            if not any(row):
                continue
            if len(row) != len(names):
                raise file.corrupt(
                    "a row has another number of fields",
                    field=f"line {rows.line_num}",
                    expected=len(names),
                    found=len(row),
                )
            good = row[quality].strip().lower() in _GOOD
            items.bad += not good
            name = row[item].strip() if item is not None else "value"
            text = row[value].strip()
            if separator != ",":
                text = text.replace(",", ".")
            items.add(name, items.time(row[time], rows.line_num), text, missing=not good)
    except csv.Error as exc:
        raise unreadable(exc) from None
    return items


def _built(format_id: str, title: str, sniff: Any, collect: Any) -> BuiltIn:
    """Return the reader of a log."""

    def channels(file: RawFile) -> tuple[str, ...]:
        """Return the items."""
        return tuple(collect(file).values)

    def read(
        file: RawFile, *, channel: str | None = None, lateral_step: Any = None, unit: Any = None
    ) -> Recording:
        """Return the items of a log, each over its own times."""
        refuse_options(file, title, lateral_step=lateral_step)
        items = collect(file)
        header = {
            "items": {n: len(v) for n, v in items.values.items()},
            "texts": dict(items.texts),
        }
        recording: Recording = items.recording(format_id, channel, unit, header)
        return recording

    return BuiltIn(sniff, channels, read)


mtconnect = _built(_MTCONNECT, "an MTConnect log", _mtconnect_sniff, _mtconnect_items)
opcua = _built(_OPCUA, "a log of an OPC UA historian", sniffer(_OPCUA), _opcua_items)
