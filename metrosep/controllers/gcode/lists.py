"""Lists of points (PVT, CSV) as carriers of a correction: Z' = Z + c(X, C), other columns as they are.

One row is one point. The columns are named, with units, in a header row such as
``t_s, X_mm, C_deg, Z_mm, VZ_mm_s``, or by number where there is no header. Sign and part
coordinates are those of `metrosep.controllers.gcode.corrections`.
"""

from __future__ import annotations

import hashlib
import math
import os
import re
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from metrosep.controllers.base import paired_stream, sidecar_path
from metrosep.controllers.gcode.columns import (
    check_files,
    mark_text,
    marked,
    open_program,
    pieces,
    require_hash,
    require_uncorrected,
    require_unmarked,
    sidecar_of,
    sidecar_text,
)
from metrosep.controllers.gcode.corrections import PathCorrection, as_path_correction
from metrosep.controllers.gcode.state import decimals_of, format_number
from metrosep.core import numbers
from metrosep.core._arrays import FloatArray
from metrosep.core.errors import (
    CorruptFileError,
    DataError,
    InvalidSamplesError,
    LimitError,
    TableError,
    UnitError,
)

PathLike = str | os.PathLike[str]

_LENGTHS = {"m": 1.0, "mm": 1e-3, "um": 1e-6, "nm": 1e-9, "inch": 25.4e-3, "in": 25.4e-3}
_ANGLES = {"rad": 1.0, "deg": math.pi / 180.0, "turn": 2.0 * math.pi, "rev": 2.0 * math.pi}
_TIMES = {"s": 1.0, "ms": 1e-3, "us": 1e-6, "min": 60.0}
_KINDS = {"X": _LENGTHS, "Z": _LENGTHS, "C": _ANGLES, "T": _TIMES, "VZ": {}}
_SIGNS = {"\xc2\xb0": "deg", "\xb0": "deg", "\xc2\xb5": "u", "\xb5": "u", "\xce\xbc": "u"}
"""Degree and micro signs, as UTF-8 and Latin-1 look when bytes are read as Latin-1."""

_MARK = "\xef\xbb\xbf"
_NAME = re.compile(r'\s*"?\s*([A-Za-z]+)\s*(?:[_ \[(]\s*([A-Za-z_/]+)\s*[\])]?)?\s*"?\s*')
_NUMBER = re.compile(r"[+-]?(?:\d+\.?\d*|\.\d+)(?:[eE][+-]?\d+)?")
_BLANKS = r"[ \t]+"
_STROKE = 100e-6
_MOST_DIGITS = 12
_LARGEST = 1e9


@dataclass(frozen=True, slots=True)
class PointResult:
    """What became of a list of points; lengths in m.

    Parameters
    ----------
    target, sidecar : Path
        The list and the JSON beside it.
    n_points, n_changed : int
        Rows with a point; rows whose Z (or speed of Z) changed.
    correction : tuple of (float, float), m
        Smallest and largest amount added.
    quantisation : float, m
        One unit of the last digit.
    read_back_error : float, m
        Largest deviation of the Z in the file, parsed back, from what was meant.
    messages : tuple of str
        For the person.
    audit : mapping
        All of it with units in the keys, as in the sidecar.
    """

    target: Path
    sidecar: Path
    n_points: int
    n_changed: int
    correction: tuple[float, float]
    quantisation: float
    read_back_error: float
    messages: tuple[str, ...]
    audit: Mapping[str, object]


@dataclass(frozen=True, slots=True)
class ListColumn:
    """Where the numbers of an axis stand, and their unit in SI."""

    index: int
    scale: float


@dataclass(slots=True)
class _Rows:
    """Rows of the whole list: fields are kept with their blanks, so that a join gives them back."""

    lines: list[str]
    row: list[int]
    values: dict[str, FloatArray]
    texts: dict[str, list[str]]
    half_x: float = 1.0


def rewrite_points(
    source: PathLike,
    target: PathLike,
    correction: object,
    *,
    columns: Mapping[str, int | str] | None = None,
    units: Mapping[str, str] | None = None,
    separator: str | None = None,
    diameter: bool = False,
    resolution: float = 1e-9,
    decimals: int | None = None,
    stroke: float = _STROKE,
    c_sense: int | None = None,
    c_zero: float | None = None,
    again: bool = False,
    overwrite: bool = False,
) -> PointResult:
    r"""Write a list of points with its Z corrected, all other columns byte for byte as they were.

    Parameters
    ----------
    source, target : str or path
        The list and the corrected one; a sidecar ``<target>.json`` appears beside it.
    correction : PathCorrection, CompensationTable, map with ``correction(x, y)``, or callable
        As in `metrosep.controllers.gcode.paths.rewrite_path`.
    columns : mapping of {"X", "C", "Z", "T", "VZ"} to int or str, optional
        Columns by number from 0 or by name in the header; by their names X, C, Z if omitted. C may
        be missing where the correction does not depend on it. With "VZ", the speed of Z of a PVT
        list, "T" (time since the start) is needed, and the speed gets dc/dt; columns of these names in
        the header are taken if both are there.
    units : mapping of str to str, optional
        Units of the columns, where the header does not state them: ``{"X": "mm", "C": "deg", "Z":
        "mm"}``.
    diameter : bool, optional
        Whether X is a diameter: it is halved for the lookup and stays as it is.
    separator : str, optional
        Between columns; a tab, semicolon, comma or white space, as found in the first row.
    resolution : float, m, optional
        Finest step that is written.
    decimals : int, optional
        Digits after the point of Z instead; never fewer than a row has.
    stroke : float, m, optional
        Largest correction.
    c_sense, c_zero : int and float (rad), optional
        For a map with ``correction(x, y)`` only.
    again : bool, optional
        Correct a list that holds a correction already, for what was measured on a part cut with it.
    overwrite : bool, optional
        Replace an existing file.

    Returns
    -------
    PointResult
        Counts, amounts, messages.

    Raises
    ------
    UnitError
        If a unit is missing, unknown, of the wrong kind, or another one than the header states.
    DataError
        If a column is missing or there twice, an argument of the wrong kind, the correction moves X
        too, or the list holds a correction already.
    CorruptFileError
        If a row has another number of columns than the header or the rows before it, or no number
        where one is needed.
    InvalidSamplesError
        If a point lies beyond the map or where it was not measured.
    LimitError
        If a correction exceeds `stroke`.
    ReadError
        If the list cannot be read.
    TableError
        If what was written does not read back as meant.
    WriteError
        If the target exists, is the source, or cannot be written.

    Notes
    -----
    A point is a row of its own: no value is carried from row to row. dc/dt is taken by central
    differences over the rows, one-sided at the ends. The list is held in memory, some 200 bytes a row.

    Examples
    --------
    >>> import tempfile
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     path = Path(folder) / "a.csv"
    ...     _ = path.write_text("X_mm,C_deg,Z_mm,note\n10.0, 90,1.5,keep\n")
    ...     found = rewrite_points(path, path.with_name("b.csv"), lambda x, c: 1e-6 * np.sin(c))
    ...     print(found.target.read_text())
    X_mm,C_deg,Z_mm,note
    10.0, 90,1.501000,keep
    <BLANKLINE>
    """
    resolution, stroke = (
        numbers.positive(v, name, dimension="length")
        for v, name in ((resolution, "resolution"), (stroke, "stroke"))
    )
    digits = 0 if decimals is None else numbers.count(decimals, "decimals", least=0)
    if decimals is not None and not 1 <= digits <= _MOST_DIGITS:
        raise DataError(f"decimals is {decimals}; 1 to 12 digits can be written")
    made = as_path_correction(correction, c_sense=c_sense, c_zero=c_zero)
    if made.x is not None:
        raise DataError(
            "the correction moves X and Z together, along the normal, and lists get Z alone; make it "
            "without move_x"
        )
    start, end = Path(source), Path(target)
    lines = lines_of(start, end, again=again, overwrite=overwrite)
    head, sep = layout(lines, start, separator)
    found = _columns(lines, head, sep, columns or {}, units or {}, start, needs_c=made.needs_c)
    rows = rows_of(lines, head, sep, found, start)
    rows.half_x = 0.5 if diameter else 1.0
    if made.nose is not None:
        x, c, z = (
            rows.values[a] * found[a].scale if a in found else np.zeros(len(rows.row))
            for a in ("X", "C", "Z")
        )
        places = np.column_stack([x * rows.half_x, c, z, np.zeros(x.size)])
        made.nose.require(places, start, held=stroke if again else 0.0)
    dz = _correction(made, rows, found, stroke, start)
    scale = found["Z"].scale
    wanted = digits or max(1, math.ceil(-math.log10(resolution / scale) - 1e-9))
    changed = _written(rows, found, dz, wanted, sep)
    back = reread(rows, head, sep, found, end)
    step = 10.0**-wanted * scale
    left = np.abs((back.values["Z"] - rows.values["Z"]) * scale - dz)
    if left.size and (left > 0.5 * step * (1 + 1e-6) + 1e-14).any():
        raise TableError("Z does not read back as meant; this is a bug in metrosep")
    final, mark = with_mark(rows, mark_text(("Z",), made.audit), changed)
    messages = [] if changed else ["no point changed: less than half of the last digit"]
    if "VZ" not in found:
        messages.append("no column of speed is changed; a PVT list needs columns T and VZ")
    if changed and mark is None:
        messages.append(
            "the list has no comment line, so it bears no mark of its correction: only the sidecar says "
            "that it is corrected; keep both together"
        )
    audit = {
        "correction": dict(made.audit),
        "sign": "correction c = -e is added to the commanded Z; e = actual - nominal",
        "mark": mark,
        "columns": {k: v.index for k, v in found.items()},
        "x_is_diameter": diameter,
        "n_points": int(dz.size),
        "n_changed": changed,
        "correction_min_m": float(dz.min()),
        "correction_max_m": float(dz.max()),
        "quantisation_m": step,
        "read_back_error_m": float(left.max()),
        "messages": messages,
    }
    return PointResult(
        target=end,
        sidecar=sidecar_path(end),
        n_points=int(dz.size),
        n_changed=changed,
        correction=(float(dz.min()), float(dz.max())),
        quantisation=step,
        read_back_error=float(left.max()),
        messages=tuple(messages),
        audit=write_list(start, end, lines, final, audit, overwrite=overwrite),
    )


def lines_of(start: Path, end: Path, *, again: bool, overwrite: bool) -> list[str]:
    """Return the lines of a list; refuse one that is corrected already, and a target in the way."""
    check_files(start, end, overwrite=overwrite)
    if not again:
        require_uncorrected(start)
    with open_program(start) as stream:
        lines = [line for piece in pieces(stream, start, mark=True) for line in piece]
    if not again:
        require_unmarked(lines, start)
    return lines


def reread(
    rows: _Rows, head: int | None, sep: str, columns: Mapping[str, ListColumn], path: Path
) -> _Rows:
    """Return the rows as they are read from the bytes that would be written."""
    data = "".join(rows.lines).encode("latin-1")
    written = [part.decode("latin-1") for part in data.splitlines(keepends=True)]
    return rows_of(written, head, sep, columns, path)


def with_mark(rows: _Rows, text: str, changed: int) -> tuple[list[str], str | None]:
    """Return the lines with the mark of their correction, and the mark; None where it has no place."""
    final = marked(rows.lines, text, is_list=True) if changed else rows.lines
    return final, text if len(final) > len(rows.lines) else None


def write_list(
    start: Path,
    end: Path,
    lines: list[str],
    final: list[str],
    audit: Mapping[str, object],
    *,
    overwrite: bool,
) -> dict[str, object]:
    """Write a corrected list with its sidecar, which is returned."""
    data = "".join(final).encode("latin-1")
    source = "".join(lines).encode("latin-1")
    digests = [hashlib.sha256(v).hexdigest() for v in (source, data)]
    sidecar = sidecar_of("points", start, digests, audit)

    def said(written: Path) -> str:
        require_hash(written, digests[1])
        return sidecar_text(sidecar)

    with paired_stream(end, said, overwrite=overwrite) as out:
        out.write(data)
    return sidecar


def _is_comment(line: str) -> bool:
    return not line.strip() or line.lstrip()[0] in "#%;"


def layout(lines: list[str], path: Path, separator: str | None) -> tuple[int | None, str]:
    """Return the header's line, None if there is none, and the expression between columns."""
    first = next((i for i, line in enumerate(lines) if not _is_comment(line)), None)
    if first is None:
        raise _no_point(path)
    text = _bare(lines[first])
    if separator is None:
        separator = next((s for s in ("\t", ";", ",") if s in text), " ")
    pattern = _BLANKS if not separator.strip() and separator != "\t" else re.escape(separator)
    fields = _fields(text, pattern)
    header = not any(_NUMBER.fullmatch(f.strip()) for f in fields)
    return (first if header else None), pattern


def _no_point(path: Path) -> DataError:
    return DataError(
        f"{path}: holds no point; a list has a header such as X_mm,C_deg,Z_mm and a row of numbers for "
        "each point"
    )


def _bare(line: str) -> str:
    """Return a line without byte order mark and line end, and where blanks separate without theirs."""
    return line.removeprefix(_MARK).rstrip("\r\n")


def _fields(line: str, sep: str) -> list[str]:
    """Return the fields of a line; an empty first or last one counts unless blanks separate."""
    text = _bare(line)
    return re.split(sep, text.strip() if sep == _BLANKS else text)


def named_columns(
    header: str, sep: str
) -> tuple[dict[str, int], dict[str, str], dict[str, list[str]]]:
    """Return columns by name and by letter, their units by number, and the fields of each letter."""
    names: dict[str, int] = {}
    stated: dict[str, str] = {}
    twice: dict[str, list[str]] = {}
    for index, field in enumerate(_fields(header, sep) if header else ()):
        plain = field
        for sign, word in _SIGNS.items():
            plain = plain.replace(sign, word)
        match = _NAME.fullmatch(plain)
        names[field.strip().strip('"')] = index
        if match is not None:
            letter = match.group(1).upper()
            names.setdefault(letter, index)
            twice.setdefault(letter, []).append(field.strip())
            stated[str(index)] = (match.group(2) or "").replace("_", "/")
    return names, stated, twice


def _columns(
    lines: list[str],
    head: int | None,
    sep: str,
    columns: Mapping[str, int | str],
    units: Mapping[str, str],
    path: Path,
    *,
    needs_c: bool,
) -> dict[str, ListColumn]:
    names, stated, twice = named_columns("" if head is None else lines[head], sep)
    found: dict[str, ListColumn] = {}
    for unknown in {*columns, *units} - _KINDS.keys():
        raise DataError(f"there is no column {unknown!r} to name; there are {', '.join(_KINDS)}")
    timed = "T" in columns or "VZ" in columns or {"T", "VZ"} <= names.keys()
    speeds = ("T", "VZ") if timed else ()
    for letter in ("X", "Z", *(["C"] if needs_c or "C" in columns else []), *speeds):
        given = columns.get(letter, names.get(letter) if letter not in columns else None)
        if letter not in columns and len(twice.get(letter, ())) > 1:
            raise DataError(
                f"{path}: the header has {letter} twice ({', '.join(twice[letter])}); say which one with "
                "columns="
            )
        where: int | None = names.get(given) if isinstance(given, str) else given
        if where is None:
            if letter in speeds and letter not in columns:
                continue
            raise DataError(
                f"{path}: no column {given or letter!r}; there are {', '.join(names) or 'no names'}; "
                "say columns= by number or name"
            )
        header = stated.get(str(where), "")
        unit = units.get(letter) or header
        if header in _KINDS[letter] and _scale(letter, unit, path) != _KINDS[letter][header]:
            raise UnitError(
                f"{path}: the header says {header} for column {letter}, units= says {unit}; which one "
                "is right?"
            )
        found[letter] = ListColumn(int(where), _scale(letter, unit, path))
    places = [column.index for column in found.values()]
    if len(set(places)) < len(places):
        raise DataError(
            f"{path}: two of {', '.join(found)} are the same column; name each its own"
        )
    if ("VZ" in found) != ("T" in found):
        raise DataError(
            f"{path}: the speed of Z needs the time and the other way round; name T and VZ"
        )
    return found


def unit_scale(letter: str, unit: str, kind: str, path: Path) -> float:
    """Return the unit of the column of an axis in SI; it must be stated, and of the right kind."""
    allowed = _ANGLES if kind == "angle" else _LENGTHS
    if unit not in allowed:
        raise UnitError(
            f"{path}: the unit of column {letter} is {unit or 'not stated'!r}; state it in the header "
            f"({letter}_{'deg' if kind == 'angle' else 'mm'}) or with units= ({', '.join(allowed)})"
        )
    return allowed[unit]


def _scale(letter: str, unit: str, path: Path) -> float:
    if letter == "VZ":
        length, _, time = unit.partition("/")
        if length in _LENGTHS and time in _TIMES:
            return _LENGTHS[length] / _TIMES[time]
    elif unit in _KINDS[letter]:
        return _KINDS[letter][unit]
    allowed = ", ".join(_KINDS[letter]) or "such as mm/s or mm/min"
    raise UnitError(
        f"{path}: the unit of column {letter} is {unit or 'not stated'!r}; state it in the header "
        f"({letter}_mm) or with units= ({allowed})"
    )


def digits_of(text: str) -> int:
    """Return the digits after the point of a number; 0 with an exponent."""
    return 0 if "e" in text.lower() else decimals_of(text)


def rows_of(
    lines: list[str], head: int | None, sep: str, columns: Mapping[str, ListColumn], path: Path
) -> _Rows:
    """Return the lines of a list with the numbers of its columns."""
    out = _Rows(list(lines), [], {}, {letter: [] for letter in columns})
    values: dict[str, list[float]] = {letter: [] for letter in columns}
    width = 0 if head is None else len(_fields(lines[head], sep))
    for number, line in enumerate(lines):
        if number == head or _is_comment(line):
            continue
        fields = _fields(line, sep)
        width = width or len(fields)
        if len(fields) != width:
            raise CorruptFileError(
                path,
                f"line {number + 1} has {len(fields)} columns, "
                + ("those before" if head is None else "the header")
                + f" {width}",
            )
        out.row.append(number)
        for letter, column in columns.items():
            text = fields[column.index].strip() if 0 <= column.index < width else ""
            if not _NUMBER.fullmatch(text):
                raise CorruptFileError(
                    path, f"line {number + 1}: {text!r} in column {letter} is not a number"
                )
            value = float(text)
            digits = digits_of(text)
            if abs(value) > _LARGEST or digits > 3 * _MOST_DIGITS:
                raise CorruptFileError(
                    path,
                    f"line {number + 1}: {text[:40]!r} in column {letter}: beyond the travel of any machine; check the number and its unit",
                )
            values[letter].append(value)
            out.texts[letter].append(text)
    if not out.row:
        raise _no_point(path)
    out.values = {letter: np.array(v) for letter, v in values.items()}
    return out


def _correction(
    made: PathCorrection, rows: _Rows, columns: Mapping[str, ListColumn], stroke: float, path: Path
) -> FloatArray:
    x = rows.values["X"] * columns["X"].scale * rows.half_x
    c = rows.values["C"] * columns["C"].scale if "C" in columns else np.zeros(x.size)
    dz = np.asarray(made.z(x, c), dtype=np.float64)
    if dz.shape != x.shape:
        raise DataError(
            f"the correction returned shape {dz.shape} for {x.shape} positions; it must return one value "
            "for each"
        )
    for bad, why in (
        (np.isnan(dz), "the map was not measured (NaN); measure it there or shorten the list"),
        (np.isinf(dz), "is beyond the map; measure a larger area or shorten the list"),
    ):
        if bad.any():
            i = int(np.flatnonzero(bad)[0])
            raise InvalidSamplesError(
                f"{path}: line {rows.row[i] + 1}: at X = {x[i] * 1e3:.6g} mm, C = "
                f"{math.degrees(c[i]):.6g} deg {why}"
            )
    large = np.abs(dz) > stroke
    if large.any():
        i = int(np.flatnonzero(large)[0])
        raise LimitError(
            f"{path}: line {rows.row[i] + 1}: the correction is {dz[i] * 1e6:.6g} um, the limit is "
            f"{stroke * 1e6:.6g} um; is the map in another unit? give stroke= for larger ones"
        )
    return dz


def _written(
    rows: _Rows, columns: Mapping[str, ListColumn], dz: FloatArray, decimals: int, sep: str
) -> int:
    """Change the fields; returns how many rows did."""
    z = rows.values["Z"] + dz / columns["Z"].scale
    speed = _speeds(rows, columns, dz)
    changed = 0
    for i, number in enumerate(rows.row):
        digits = max(decimals, digits_of(rows.texts["Z"][i]))
        edits = []
        if abs(dz[i]) / columns["Z"].scale > 0.5 * 10.0**-digits:
            edits.append((columns["Z"].index, format_number(z[i], digits)))
        if speed is not None and speed[i] != rows.values["VZ"][i]:
            edits.append((columns["VZ"].index, format_number(speed[i], digits)))
        if edits:
            changed += 1
            rows.lines[number] = edited(rows.lines[number], sep, edits)
    return changed


def _speeds(rows: _Rows, columns: Mapping[str, ListColumn], dz: FloatArray) -> FloatArray | None:
    if "VZ" not in columns:
        return None
    time = rows.values["T"] * columns["T"].scale
    if time.size < 2 or (np.diff(time) <= 0.0).any():
        raise InvalidSamplesError("the times of the list do not rise, so it has no speeds")
    rise = np.asarray(np.gradient(dz, time))
    return np.asarray(rows.values["VZ"] + rise / columns["VZ"].scale)


def edited(line: str, sep: str, edits: list[tuple[int, str]]) -> str:
    """Return a line with numbers of some columns replaced, blanks around them kept."""
    text = line.rstrip("\r\n")
    lead = 0
    if sep == _BLANKS:
        text = text.rstrip()
        lead = len(line) - len(line.lstrip())
    spans = []
    at = lead
    for match in re.finditer(sep, text[lead:]):
        spans.append((at, lead + match.start()))
        at = lead + match.end()
    spans.append((at, len(text)))
    for index, number in sorted(edits, reverse=True):
        a, b = spans[index]
        old = line[a:b]
        kept = len(old) - len(old.lstrip())
        line = line[: a + kept] + number + line[a + len(old.rstrip()) :]
    return line
