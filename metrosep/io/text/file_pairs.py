"""Measurements in two files of one name: DABAM mirror profiles and scans of the SIOS NMM."""

from __future__ import annotations

import itertools
import json
import math
import re
from dataclasses import dataclass
from datetime import datetime
from typing import Any

import numpy as np

from metrosep.core._arrays import FloatArray
from metrosep.core.errors import (
    CorruptFileError,
    FormatMismatchError,
    ReadError,
    UnsupportedFeatureError,
)
from metrosep.core.profile import Profile
from metrosep.core.provenance import Step
from metrosep.core.recording import Recording
from metrosep.io.declared import Match
from metrosep.io.objects import Request, make_profile, map_reader, only_channels
from metrosep.io.registry import BuiltIn, mismatch
from metrosep.io.source import MAX_PIXELS, RawFile, refuse_options
from metrosep.io.text.logger import (
    Channels,
    also_read,
    beside,
    first_lines,
    number_block,
    numbered_rows,
    text_lines,
)

# ---- DABAM, the open database of mirror profiles: columns in ``.dat``, their meaning in JSON beside it
# The file to read is the JSON (``.txt``); the columns lie in ``.dat`` of the same stem in the same
# folder. ``FILE_FORMAT`` says whether column Y1 holds slopes (1, rad) or heights (2, m). Slopes are
# never returned as heights: ``slope="integrate"`` sums them by the trapezoid rule,
# z[k] = z[k-1] + (s[k-1] + s[k]) / 2 * (x[k] - x[k-1]) with z[0] = 0. What that cannot know: the
# height of the first point (piston); an offset of the slopes becomes a tilt, and noise of the
# slopes grows like a random walk. See ``data_formats/dabam/SPEC.md``.

_DABAM = "dabam"
_MARKS = ('"FILE_FORMAT"', '"X1_FACTOR"', '"FILE_HEADER_LINES"')
_SUFFIXES = (".dat", ".DAT")
_MAX_JSON = 2**20
_MAX_COLUMNS = 1000
_SLOPES, _HEIGHTS = 1, 2
_KIND = {_SLOPES: "slope", _HEIGHTS: "height"}
_WORDS = (
    ("slope", re.compile("slope", re.IGNORECASE)),
    ("height", re.compile("hei[gt]", re.IGNORECASE)),
)
"""How titles name the quantity of a further column; the files write "Heigth" as well."""


def _dabam_sniff(file: RawFile) -> Match:
    """Return how sure we are that a file is the JSON of a DABAM profile."""
    top = next((line for line in first_lines(file) if line.strip()), "")
    if not top.lstrip().startswith("{") or file.size > _MAX_JSON:
        return Match.NO
    text = "\n".join(first_lines(file))
    return Match.YES if all(m in text for m in _MARKS) else Match.NO


def _dabam_channels(file: RawFile) -> tuple[str, ...]:
    """Return the columns ``Y1``, ``Y2`` ... that have a factor to SI."""
    return _channels(_header(file))


@map_reader(_DABAM, "DABAM", "a DABAM profile with its own factors", several=True, pixels=False)
def _dabam_read(asked: Request, *, slope: str | None = None) -> Profile:
    """Return a height profile of a DABAM entry."""
    file = asked.file
    if slope not in (None, "integrate"):
        raise ReadError(f"{file.path}: slope={slope!r} is unknown; use slope='integrate'")
    header = _header(file)
    name = asked.choose(_channels(header))
    column = int(name[1:])
    kind = _kind(file, header, column)
    data = beside(file, _SUFFIXES)
    x, values, n_columns = _columns(file, data, header, column)
    factor = {"X1_FACTOR": header["X1_FACTOR"], f"{name}_FACTOR": header[f"{name}_FACTOR"]}
    facts: dict[str, Any] = {
        "channel": name,
        "quantity_in_file": kind,
        "title_in_file": str(header.get(f"PLOT_TITLE_{name}") or ""),
        "factors_to_si": factor,
        "n_columns": n_columns,
        "data_file": data.name,
        "data_sha256": data.sha256,
    }
    steps = [also_read(data, channel=name)]
    if kind == "slope":
        refuse_options(
            file, "a profile of slopes over its own positions", lateral_step=asked.override
        )
        facts |= _of_slopes(file, name, values, x, integrate=slope == "integrate")
        values = _integrated(x, values)
        steps.append(Step("integrate_slopes", {"rule": "trapezoid", "null_space": "piston"}))
    elif slope is not None:
        refuse_options(file, f"a DABAM profile whose {name} holds heights", slope=slope)
    return asked.profile(x, values, header=header, steps=steps, **facts)


def _header(file: RawFile) -> dict[str, Any]:
    """Return the JSON, refused unless the keys that say how to read the columns are usable."""
    if _dabam_sniff(file) is Match.NO:
        raise mismatch(file, _DABAM)
    try:
        header = json.loads("\n".join(text_lines(file)))
    except (ValueError, RecursionError) as exc:
        reason = f"the JSON is damaged ({str(exc)[:80]})"
        raise file.corrupt(reason, hint="copy the .txt again") from None
    if not isinstance(header, dict):
        raise file.corrupt("the JSON is not an object", expected="{...}")
    if str(header.get("FILE_FORMAT")) not in {str(k) for k in _KIND}:
        raise UnsupportedFeatureError(
            f"{file.path}: FILE_FORMAT is {str(header.get('FILE_FORMAT'))[:20]}; metrosep reads 1 "
            "(slopes) and 2 (heights)"
        )
    n = header.get("FILE_HEADER_LINES")
    if not isinstance(n, int) or isinstance(n, bool) or n < 0:
        raise _wrong(file, "FILE_HEADER_LINES", "a count of lines", n)
    for key in ("X1_FACTOR", *(f"{c}_FACTOR" for c in _channels(header))):
        value = header.get(key)
        usable = isinstance(value, (int, float)) and not isinstance(value, bool)
        if not usable or not 1e-15 <= abs(value or 0) <= 1e3:
            raise _wrong(file, key, "a factor to SI of 1e-15 to 1000", value)
    if not _channels(header):
        raise _wrong(file, "Y1_FACTOR", "a factor to SI", None)
    return header


def _wrong(file: RawFile, key: str, expected: str, found: object) -> CorruptFileError:
    return file.corrupt(
        "the description of the columns is not usable",
        field=key,
        expected=expected,
        found=repr(found)[:40],
    )


def _channels(header: dict[str, Any]) -> tuple[str, ...]:
    names = (f"Y{i}" for i in range(1, _MAX_COLUMNS))
    return tuple(n for n in names if f"{n}_FACTOR" in header)


def _kind(file: RawFile, header: dict[str, Any], column: int) -> str:
    """Return what a column holds: Y1 by FILE_FORMAT, the others by their title."""
    if column == 1:
        return _KIND[int(header["FILE_FORMAT"])]
    title = str(header.get(f"PLOT_TITLE_Y{column}") or "")
    found = [word for word, pattern in _WORDS if pattern.search(title)]
    if len(found) != 1:
        raise UnsupportedFeatureError(
            f"{file.path}: nothing says whether Y{column} holds slopes or heights (its title is "
            f"{title[:40]!r}, FILE_FORMAT describes Y1 only); name it in PLOT_TITLE_Y{column}"
        )
    return found[0]


def _columns(
    file: RawFile, data: RawFile, header: dict[str, Any], column: int
) -> tuple[FloatArray, FloatArray, int]:
    """Return positions in m and one column in SI, and how many columns of values there are."""
    skip = header["FILE_HEADER_LINES"]
    rows = numbered_rows(text_lines(data)[skip:], skip + 1)
    lines = [line for line, _ in rows]
    table = number_block(file, rows, where=f" in {data.name}")
    if len(rows) < 2:
        raise file.corrupt(
            f"there is one row in {data.name}", field=f"line {lines[0]}", expected=2
        )
    if column >= table.shape[1]:
        raise file.corrupt(
            f"there is no column Y{column} in {data.name}",
            expected=f"{column + 1} columns",
            found=table.shape[1],
            hint="check FILE_HEADER_LINES, or copy both files again",
        )
    x = table[:, 0]
    if np.isnan(x).any():
        line = lines[int(np.flatnonzero(np.isnan(x))[0])]
        raise file.corrupt(f"a point of {data.name} has no position", field=f"line {line}")
    factors = header["X1_FACTOR"], header[f"Y{column}_FACTOR"]
    return x * factors[0], table[:, column] * factors[1], table.shape[1] - 1


def _of_slopes(
    file: RawFile, name: str, slopes: FloatArray, x: FloatArray, *, integrate: bool
) -> dict[str, Any]:
    """Return facts on slopes; refuse them as heights, or with gaps that no sum can bridge."""
    valid = slopes[~np.isnan(slopes)]
    pv, rms = (float(np.ptp(valid)), float(valid.std())) if valid.size else (math.nan, math.nan)
    if not integrate:
        raise UnsupportedFeatureError(
            f"{file.path}: {name} holds slopes (P-V {pv * 1e6:.7g} urad, RMS {rms * 1e6:.7g} urad), not "
            "heights; pass slope='integrate' for heights by the trapezoid rule (their piston stays "
            "unknown)"
        )
    if valid.size < slopes.size:
        raise UnsupportedFeatureError(
            f"{file.path}: {slopes.size - valid.size} slopes of {name} were not measured; heights beyond "
            "a gap cannot be joined: cut the columns at the gap"
        )
    step = float(np.abs(np.diff(x)).mean())
    return {
        "slope_pv_rad": pv,
        "slope_rms_rad": rms,
        "slope_mean_rad": float(valid.mean()),
        "end_height_noise_m_per_rad": step * math.sqrt(slopes.size - 1),
    }


def _integrated(x: FloatArray, slopes: FloatArray) -> FloatArray:
    heights = np.zeros(x.size)
    np.cumsum(0.5 * (slopes[1:] + slopes[:-1]) * np.diff(x), out=heights[1:])
    return heights


dabam = BuiltIn(_dabam_sniff, _dabam_channels, _dabam_read)


# ---- SIOS nanomeasuring machine (NMM): scan description ``.dsc`` with its lines and their positions ----
# The file to read is the description. ``.dat`` beside it holds one row per point, the columns that the
# description lists, line after line; ``.pos`` one row per line: where it began, and the environment.
# A line is a profile of ``-Lz+Az`` over the motion along the line; ``channel="positions"`` is a recording
# over the times that the description prints. See ``data_formats/nmm/SPEC.md``.

_NMM = "nmm"
_TITLE = "Scan procedure description file"
_RULE = "-" * 20
_COLUMN = re.compile(
    r"(\d{1,3}) : (\d\d)-(\w{3})-(\d{4}) (\d\d:\d\d:\d\d) : (.+?) : (\d{1,9}) : (.*)"
)
_POSITIONS = "positions"
_LINES = (".dat", ".DAT")
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


def _nmm_sniff(file: RawFile) -> Match:
    """Return how sure we are that a file is the description of an NMM scan."""
    lines = [line.strip() for line in itertools.islice(first_lines(file), 5) if line.strip()]
    is_scan = len(lines) > 1 and lines[0].startswith(_RULE) and lines[1] == _TITLE
    return Match.YES if is_scan else Match.NO


def _nmm_channels(file: RawFile) -> tuple[str, ...]:
    """Return the scan lines and the positions."""
    return _names(_description(file))


def _nmm_read(
    file: RawFile, *, channel: str | None = None, lateral_step: Any = None, unit: Any = None
) -> Profile | Recording:
    """Return a line of an NMM scan, or the positions and the environment of its lines."""
    refuse_options(file, "an NMM scan in metres", lateral_step=lateral_step, unit=unit)
    description = _description(file)
    names = _names(description)
    if channel is None and len(names) > 2:
        n, data = len(names) - 1, file.path.with_suffix(".dat")
        advice = (
            f"choose one with channel='line 1' ... channel='line {n}', or channel={_POSITIONS!r}"
        )
        if not any(data.with_suffix(s).is_file() for s in _LINES):
            advice = (
                f"give channel={_POSITIONS!r} for their positions; for the lines themselves put {data.name}, which "
                "does not lie beside it, into the same folder"
            )
        raise FormatMismatchError(f"{file.path}: holds {n} scan lines; {advice}")
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
    if _nmm_sniff(file) is Match.NO:
        raise mismatch(file, _NMM)
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
        raise file.corrupt(
            "the description lists no columns", expected="0 : date : symbol : count : title"
        )
    symbols = tuple(m[6].strip() for _, m in lines[0])
    for block in lines:
        number = block[0][0]
        same = (
            tuple(m[6].strip() for _, m in block) == symbols and len({m[7] for _, m in block}) == 1
        )
        if not same or [int(m[1]) for _, m in block] != list(range(len(symbols))):
            raise file.corrupt(
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
            raise file.corrupt(
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
    data = beside(file, _LINES)
    table = _table(file, data, total, (len(scan.symbols),))
    start = sum(scan.counts[:index])
    rows = table[start : start + scan.counts[index]]
    x, z = rows[:, where[_ALONG]], rows[:, where[_HEIGHT]]
    if np.isnan(x).any():
        raise file.corrupt(f"a point of {data.name} has no position")
    return make_profile(
        file,
        _NMM,
        x,
        z,
        header=scan.header,
        line=index + 1,
        n_lines=len(scan.counts),
        time_in_file=scan.times[index],
        columns=list(scan.symbols),
        data_file=data.name,
        data_sha256=data.sha256,
        steps=[also_read(data)],
    )


def _table(file: RawFile, data: RawFile, n_rows: int, widths: tuple[int, ...]) -> FloatArray:
    """Return the numbers of the other file, refused unless it has the size that was declared."""
    table = number_block(file, numbered_rows(text_lines(data)), where=f" in {data.name}")
    for name, expected, found in (
        ("rows", (n_rows,), table.shape[0]),
        ("columns", widths, table.shape[1]),
    ):
        if found not in expected:
            raise file.corrupt(
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
    return recording.recording(
        _NMM,
        scan.header,
        time_of_first_line=scan.times[0],
        n_lines=len(scan.counts),
        data_file=data.name,
        data_sha256=data.sha256,
        steps=[also_read(data)],
    )


nmm = BuiltIn(_nmm_sniff, _nmm_channels, _nmm_read)
