"""SIOS nanomeasuring machine (NMM): scan description ``.dsc`` with its lines and their positions.

The file to read is the description. ``.dat`` beside it holds one row per point, the columns that the
description lists, line after line; ``.pos`` one row per line: where it began, and the environment.
A line is a profile of ``-Lz+Az`` over the motion along the line; ``channel="positions"`` is a recording
over the times that the description prints. See ``data_formats/nmm/SPEC.md``.
"""

from __future__ import annotations

import itertools
import re
from dataclasses import dataclass
from datetime import datetime
from typing import Any

import numpy as np

from metrosep.core._arrays import FloatArray
from metrosep.core.errors import CorruptFileError, FormatMismatchError, UnsupportedFeatureError
from metrosep.core.profile import Profile
from metrosep.core.recording import Recording
from metrosep.io.objects import make_profile, only_channels
from metrosep.io.registry import Match
from metrosep.io.source import MAX_PIXELS, RawFile, refuse_options
from metrosep.io.text.logger import (
    Channels,
    also_read,
    beside,
    first_lines,
    number_rows,
    text_lines,
)

__all__ = ["channels", "read", "sniff"]

FORMAT = "nmm"
_TITLE = "Scan procedure description file"
_RULE = "-" * 20
_COLUMN = re.compile(
    r"(\d{1,3}) : (\d\d)-(\w{3})-(\d{4}) (\d\d:\d\d:\d\d) : (.+?) : (\d{1,9}) : (.*)"
)
_POSITIONS = "positions"
_HEIGHT, _ALONG = "-lz+az", "xy vector"
_POS_COLUMNS = (
    ("X", "m"),
    ("Y", "m"),
    ("Z", "m"),
    ("air temperature x", "degC"),
    ("air temperature y", "degC"),
    ("air temperature z", "degC"),
    ("air pressure", "Pa"),
    ("relative humidity", "% RH"),
    ("sample temperature", "degC"),
)
"""Columns of ``.pos``; the last one is there only with a sensor at the sample."""

_MONTHS = {
    name: 1 + i
    for names in (
        "jan feb mar apr may jun jul aug sep oct nov dec",
        "jan feb mrz apr mai jun jul aug sep okt nov dez",
    )
    for i, name in enumerate(names.split())
}


def sniff(file: RawFile) -> Match:
    """Return how sure we are that a file is the description of an NMM scan."""
    lines = [line.strip() for line in itertools.islice(first_lines(file), 5) if line.strip()]
    is_scan = len(lines) > 1 and lines[0].startswith(_RULE) and lines[1] == _TITLE
    return Match.YES if is_scan else Match.NO


def channels(file: RawFile) -> tuple[str, ...]:
    """Return the scan lines and the positions."""
    return _names(_description(file))


def read(
    file: RawFile, *, channel: str | None = None, lateral_step: Any = None, unit: Any = None
) -> Profile | Recording:
    """Return a line of an NMM scan, or the positions and the environment of its lines."""
    refuse_options(file, "an NMM scan in metres", lateral_step=lateral_step, unit=unit)
    description = _description(file)
    names = _names(description)
    if channel is None and len(names) > 2:
        raise FormatMismatchError(
            f"{file.path}: holds {len(names) - 1} scan lines; choose one with channel='line 1' ... "
            f"channel='line {len(names) - 1}', or channel={_POSITIONS!r}"
        )
    chosen = only_channels(file, "NMM", channel, names)
    if chosen == _POSITIONS:
        return _positions(file, description)
    return _line(file, description, names.index(chosen))


@dataclass(frozen=True)
class _Scan:
    """Header by section, names of the columns, and count of points and time of each line."""

    header: dict[str, dict[str, str]]
    symbols: tuple[str, ...]
    counts: tuple[int, ...]
    times: tuple[str, ...]
    seconds: tuple[float, ...]


def _names(scan: _Scan) -> tuple[str, ...]:
    return (*(f"line {i}" for i in range(1, len(scan.counts) + 1)), _POSITIONS)


def _description(file: RawFile) -> _Scan:
    if sniff(file) is Match.NO:
        raise FormatMismatchError(
            f"{file.path}: is no NMM scan description: expected {_TITLE!r}; pass the .dsc, not the .dat "
            "or .pos"
        )
    header: dict[str, dict[str, str]] = {}
    section = ""
    blocks: list[list[tuple[int, re.Match[str]]]] = []
    for number, line in enumerate(text_lines(file), start=1):
        text = line.strip()
        if text.startswith(_RULE):
            blocks.append([])
        elif match := _COLUMN.fullmatch(text):
            blocks[-1].append((number, match))
        elif re.match(r"\d\. ", text):
            section = text
        elif text:
            key, _, value = text.partition(":")
            header.setdefault(section, {})[key.strip()] = value.strip()
    lines = [block for block in blocks if block]
    if not lines:
        raise CorruptFileError(
            file.path,
            "the description lists no columns",
            expected="0 : date : symbol : count : title",
        )
    symbols = tuple(m[6].strip() for _, m in lines[0])
    for block in lines:
        number = block[0][0]
        same = (
            tuple(m[6].strip() for _, m in block) == symbols and len({m[7] for _, m in block}) == 1
        )
        if not same or [int(m[1]) for _, m in block] != list(range(len(symbols))):
            raise CorruptFileError(
                file.path,
                "the lists of columns contradict each other",
                field=f"line {number}",
                expected=f"columns 0 to {len(symbols) - 1} of one length",
            )
    return _Scan(
        header,
        symbols,
        tuple(int(block[0][1][7]) for block in lines),
        tuple(f"{m[2]}-{m[3]}-{m[4]} {m[5]}" for m in (block[0][1] for block in lines)),
        _seconds(file, [block[0] for block in lines]),
    )


def _seconds(file: RawFile, firsts: list[tuple[int, re.Match[str]]]) -> tuple[float, ...]:
    """Return the printed times in s from the first one."""
    moments = []
    for number, match in firsts:
        try:
            month = _MONTHS[match[3].lower()]
            hours = datetime.strptime(match[5], "%H:%M:%S")
            moments.append(hours.replace(year=int(match[4]), month=month, day=int(match[2])))
        except (KeyError, ValueError):
            raise CorruptFileError(
                file.path,
                "a time is not usable",
                field=f"line {number}",
                expected="day-month-year time",
                found=repr(f"{match[2]}-{match[3]}-{match[4]} {match[5]}"),
            ) from None
    return tuple((m - moments[0]).total_seconds() for m in moments)


def _line(file: RawFile, scan: _Scan, index: int) -> Profile:
    where = {s.lower(): i for i, s in enumerate(scan.symbols)}
    if _HEIGHT not in where or _ALONG not in where:
        raise UnsupportedFeatureError(
            f"{file.path}: a line needs the columns '-Lz+Az' and 'XY vector', the scan has "
            f"{', '.join(scan.symbols)}; save them in the scan procedure"
        )
    total = sum(scan.counts)
    if total * len(scan.symbols) > MAX_PIXELS:
        raise UnsupportedFeatureError(
            f"{file.path}: claims {total} points of {len(scan.symbols)} columns, more than {MAX_PIXELS}"
        )
    data = beside(file, (".dat", ".DAT"))
    table = _table(file, data, total, (len(scan.symbols),))
    start = sum(scan.counts[:index])
    rows = table[start : start + scan.counts[index]]
    x, z = rows[:, where[_ALONG]], rows[:, where[_HEIGHT]]
    if np.isnan(x).any():
        raise CorruptFileError(file.path, f"a point of {data.name} has no position")
    profile = make_profile(
        file,
        FORMAT,
        x,
        z,
        header=scan.header,
        line=index + 1,
        n_lines=len(scan.counts),
        time_in_file=scan.times[index],
        columns=list(scan.symbols),
        data_file=data.name,
        data_sha256=data.sha256,
    )
    return Profile(
        profile.x,
        profile.z,
        metadata=profile.metadata,
        history=(*profile.history, also_read(data)),
    )


def _table(file: RawFile, data: RawFile, n_rows: int, widths: tuple[int, ...]) -> FloatArray:
    """Return the numbers of the other file, refused unless it has the size that was declared."""
    _, rows = number_rows(file, data)
    table = np.array(rows)
    for name, expected, found in (
        ("rows", (n_rows,), table.shape[0]),
        ("columns", widths, table.shape[1]),
    ):
        if found not in expected:
            raise CorruptFileError(
                file.path,
                f"{data.name} does not fit the description",
                field=name,
                expected=" or ".join(map(str, expected)),
                found=found,
                hint="copy both files of one scan into the folder; an interrupted scan is not read",
            )
    return table


def _positions(file: RawFile, scan: _Scan) -> Recording:
    data = beside(file, (".pos", ".POS"))
    n = len(_POS_COLUMNS)
    table = _table(file, data, len(scan.counts), (n - 1, n))
    recording = Channels(file)
    t = np.array(scan.seconds)
    for (name, unit), values in zip(_POS_COLUMNS, table.T, strict=False):
        recording.add(name, t, values, unit)
    result = recording.recording(
        FORMAT,
        scan.header,
        time_of_first_line=scan.times[0],
        n_lines=len(scan.counts),
        data_file=data.name,
        data_sha256=data.sha256,
    )
    return Recording(
        result.t,
        result.channels,
        units=result.units,
        metadata=result.metadata,
        history=(*result.history, also_read(data)),
    )
