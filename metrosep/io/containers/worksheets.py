"""Workbooks of roundness and roughness testers: Talyrond traces and Mitutoyo profiles."""

from __future__ import annotations

import math
import re
from contextlib import suppress
from typing import Any

import numpy as np

from metrosep.core._arrays import FloatArray
from metrosep.core.errors import FormatMismatchError, ReadError, UnitError
from metrosep.core.numbers import positive
from metrosep.core.profile import Profile
from metrosep.core.units import Unit, format_length, parse_quantity, parse_unit
from metrosep.io.archive import zip_members
from metrosep.io.containers.workbook import Cells, Workbook
from metrosep.io.declared import Match
from metrosep.io.objects import Request, map_reader
from metrosep.io.registry import BuiltIn, mismatch
from metrosep.io.source import RawFile, refuse_options

# ---- Talyrond roundness trace in a worksheet: angle in degrees, radial reading r, r cos, r sin
# Nothing but these four columns is in the file, so it is known by the two equations, which also say that
# the angle is in degrees. The reading is a deviation from a circle whose radius the file does not
# hold (its mean is zero); that radius and the unit are declared. See ``data_formats/talyrond/SPEC.md``.

_TALYROND = "talyrond"
_COLUMNS = "ABCD"
_CELL = re.compile(
    rb'<c r="([A-D])(\d{1,7})"(?: s="\d+")?>(?:<f[^>]*>[^<]*</f>|<f[^>]*/>)?<v>([^<]{1,40})</v></c>'
)
_N_SNIFF = 4
_SAME = 1e-6
"""Largest deviation of x and y from radius and angle, relative to the radius."""

_CLOSED = 1e-6
"""Largest deviation of span + step from a turn, relative, for a trace to count as closed."""


def _talyrond_sniff(file: RawFile) -> Match:
    """Return how sure we are that a file is a worksheet with a roundness trace."""
    members = zip_members(file, "xl/worksheets/sheet1.xml")
    if "xl/workbook.xml" not in members:
        return Match.NO
    try:
        book = Workbook(file)
        rows = [row for _, row in book.cells(book.names[0], _COLUMNS, stop=_N_SNIFF)]
    except ReadError:  # a cut workbook is still one, and `read` says what is wrong with it
        rows = _first_rows(members.get("xl/worksheets/sheet1.xml", b""))
    points = [[row.get(c) for c in _COLUMNS] for row in rows[:_N_SNIFF]]
    if len(points) < 2 or not all(isinstance(v, float) for row in points for v in row):
        return Match.NO
    return Match.YES if _is_polar(np.array(points, dtype=np.float64)) else Match.NO


def _first_rows(sheet: bytes) -> list[dict[str, float | str]]:
    """Return the cells with numbers at the start of a worksheet of which the rest may be lost."""
    rows: dict[int, dict[str, float | str]] = {}
    for column, number, text in _CELL.findall(sheet):
        with suppress(ValueError):
            rows.setdefault(int(number), {})[column.decode()] = float(text)
    return [row for _, row in sorted(rows.items())]


def _talyrond_channels(file: RawFile) -> tuple[str, ...]:
    """Return the data sets that can be read: the radial deviation."""
    return ("deviation",)


@map_reader(_TALYROND, "Talyrond", several=True, pixels=False, no_steps="a trace over angles")
def _talyrond_read(asked: Request, *, radius: float | str | None = None) -> Profile:
    """Return the radial deviation of a roundness trace over the length of arc."""
    file = asked.file
    asked.choose(_talyrond_channels(file))
    sheet, numbers = _numbers(file)
    degrees, values = numbers[:, 0], numbers[:, 1]
    factor = _unit(file, asked.unit, radius)
    values = values * factor.factor
    if np.isnan(degrees).any():
        raise file.corrupt("a point has no angle", field="column A")
    angles = np.deg2rad(degrees)
    length = _radius(file, radius, values)
    step = float(angles[-1] - angles[0]) / (angles.size - 1)
    turns = abs(step) * angles.size / math.tau
    return asked.profile(
        length * angles,
        values,
        header={"worksheet": sheet, "first_row": [float(v) for v in numbers[0]]},
        unit_in_file=None,
        unit_declared=factor.name,
        radius_declared_m=length,
        mean_deviation_m=float(np.nanmean(values)),
        angle_start_rad=float(min(angles[0], angles[-1])),
        angle_step_rad=abs(step),
        is_closed=abs(turns - 1.0) <= _CLOSED,
        height_direction="outwards from the axis",
    )


def _is_polar(points: FloatArray) -> bool:
    """Whether columns are angle in degrees, r, r cos(angle), r sin(angle)."""
    if not np.isfinite(points).all() or np.abs(points[:, 0]).max() > 1e4:
        return False
    angles, radii = np.deg2rad(points[:, 0]), points[:, 1]
    x, y = radii * np.cos(angles), radii * np.sin(angles)
    largest = np.abs(radii).max()
    with np.errstate(over="ignore"):  # numbers of a damaged file may be near the largest
        error = max(np.abs(points[:, 2] - x).max(), np.abs(points[:, 3] - y).max())
    return bool(largest > 0.0 and error <= _SAME * largest)


def _numbers(file: RawFile) -> tuple[str, FloatArray]:
    """Return the name of the first worksheet and its columns, checked against each other."""
    book = Workbook(file)
    sheet = book.names[0]
    rows = book.cells(sheet, _COLUMNS)
    if len(rows) < 2:
        raise file.corrupt(f"worksheet {sheet} holds no trace", expected="2 rows")
    table = _table(file, rows, _COLUMNS, gaps=_COLUMNS)
    whole = table[np.isfinite(table).all(axis=1)]
    if len(whole) == 0 or not _is_polar(whole):
        raise mismatch(file, _TALYROND, f"other numbers in worksheet {sheet}")
    return sheet, table


def _unit(file: RawFile, declared: Any, radius: float | str | None) -> Unit:
    if declared is None:
        what, such = "", "declare it, such as unit='um'"
        if radius is None:
            what, such = ", nor the radius of the part", "declare unit='um' and radius='25 mm'"
        raise UnitError(f"{file.path}: does not state the unit of its deviations{what}; {such}")
    return parse_unit(str(declared), dimension="length")


def _radius(file: RawFile, radius: float | str | None, values: FloatArray) -> float:
    """Return the radius of the part in m."""
    if radius is None:
        valid = values[np.isfinite(values)]
        raise FormatMismatchError(
            f"{file.path}: holds {values.size} radial deviations over angles (mean "
            f"{format_length(float(valid.mean()))}, P-V {format_length(float(np.ptp(valid)))}) and no "
            "radius of the part; declare it, such as radius='25 mm'"
        )
    return positive(radius, "radius", dimension="length")


talyrond = BuiltIn(_talyrond_sniff, _talyrond_channels, _talyrond_read)


# ---- mitutoyo surface roughness tester, ``.xlsx``: worksheets ``Certificate`` and ``DATA`` -----
# In ``DATA`` column A holds the printed results (``Ra     3.308  µm``), B the settings, E the positions in
# mm and F the heights of the evaluated profile. The unit of the heights is that of the printed
# results. See ``data_formats/mitutoyo-xlsx/SPEC.md``.

_MITUTOYO_XLSX = "mitutoyo-xlsx"
_SHEETS = ("Certificate", "DATA")
_X, _Z = "E", "F"
_RESULT = re.compile(r"([RPW][aqzptvc])\s+-?[\d.]+\s+(\S+)\s*")
_KIND = re.compile(r"CUV\s+(\S+)")
_CUTOFFS = {"CUT": "lambda_c_m", "LS": "lambda_s_m"}
_OFF = frozenset({"NONE", "OFF", "NO"})
_COUNT = re.compile(r"[1-9]\d{0,3}")


def _mitutoyo_xlsx_sniff(file: RawFile) -> Match:
    """Return how sure we are that a file is a workbook of a Mitutoyo tester."""
    members = zip_members(file, "xl/workbook.xml", "docProps/app.xml")
    if members.get("xl/workbook.xml") == b"":
        return Match.MAYBE  # a locked or damaged workbook: `read` says what is wrong with it
    listed = b"".join(members.values())
    both = all(
        re.search(rb"""name=["']%s["']|<vt:lpstr>%s<""" % ((s.encode(),) * 2), listed)
        for s in _SHEETS
    )
    return Match.YES if both else Match.NO


def _mitutoyo_xlsx_channels(file: RawFile) -> tuple[str, ...]:
    """Return the data sets that can be read: the profile."""
    return ("profile",)


@map_reader(_MITUTOYO_XLSX, "Mitutoyo", several=True, pixels=False)
def _mitutoyo_xlsx_read(asked: Request) -> Profile:
    """Return the evaluated profile of a Mitutoyo workbook."""
    file = asked.file
    asked.choose(_mitutoyo_xlsx_channels(file))
    book = Workbook(file)
    if not set(_SHEETS) <= set(book.names):
        raise mismatch(file, _MITUTOYO_XLSX, ", ".join(book.names)[:80])
    rows = book.cells("DATA", ("A", "B", _X, _Z))
    results = [str(cells["A"]).strip() for _, cells in rows if "A" in cells]
    settings = [str(cells["B"]).strip() for _, cells in rows if "B" in cells]
    units = _units(file, results, asked.unit)
    x, z = _columns(file, rows)
    certificate = {
        f"{column}{number}": value
        for number, cells in book.cells("Certificate")
        for column, value in cells.items()
    }
    kinds = [m[1] for s in settings if (m := _KIND.fullmatch(s))]
    positions = x * units[0].factor
    applied, warnings = _applied(settings) if kinds[:1] == ["R"] else ({}, [])
    warnings += _misfit(applied, positions)
    return asked.profile(
        positions,
        z * units[1].factor,
        header={"results": results, "settings": settings, "certificate": certificate},
        warnings=warnings,
        units_in_file=(units[0].name, units[1].name),
        profile_kind=kinds[0] if kinds else None,
        **applied,
    )


def _applied(settings: list[str]) -> tuple[dict[str, Any], list[str]]:
    """Return cut-offs and number of sections by their keys, and what was not understood."""
    found: dict[str, Any] = {}
    warnings = []
    for setting in settings:
        name, _, text = setting.partition(" ")
        text = text.strip()
        if name in _CUTOFFS and text.upper() not in _OFF:
            length = _length(text)
            if length is not None:
                found.setdefault(_CUTOFFS[name], length)
                continue
        elif name == "N" and _COUNT.fullmatch(text):
            found.setdefault("n_sections", int(text))
            continue
        elif name != "N":
            continue
        warnings.append(f"the setting {setting[:40]!r} is not understood and was not taken")
    return found, warnings


def _length(text: str) -> float | None:
    try:
        length = parse_quantity(text, dimension="length")
    except UnitError:
        return None
    return length if length > 0.0 else None


def _misfit(applied: dict[str, Any], x: FloatArray) -> list[str]:
    """Return a warning where cut-off and number of sections are not those of the profile."""
    if not {"lambda_c_m", "n_sections"} <= set(applied):
        return []
    n, cutoff = applied["n_sections"], applied["lambda_c_m"]
    step = abs(float(x[-1] - x[0])) / (x.size - 1)
    if abs(n * cutoff - x.size * step) <= n * step:  # a section holds whole steps
        return []
    length = format_length(x.size * step)
    return [f"N {n} sections of CUT {format_length(cutoff)} are not the {length} of the profile"]


def _units(file: RawFile, results: list[str], declared: Any) -> tuple[Unit, Unit]:
    """Return the units of positions and heights: metric when a result is printed in um."""
    printed = {m[2] for r in results if (m := _RESULT.fullmatch(r))}
    try:
        found = {parse_unit(p, dimension="length").name for p in printed}
    except UnitError:
        found = set()
    if found == {"um"}:
        refuse_options(file, "a Mitutoyo profile with results in um", unit=declared)
        return parse_unit("mm"), parse_unit("um")
    if declared is None or isinstance(declared, str) or len(tuple(declared)) != 2:
        raise UnitError(
            f"{file.path}: the printed results show no unit of the heights ({', '.join(printed) or 'none'}"
            "); declare positions and heights, such as unit=('mm', 'um')"
        )
    first, second = (parse_unit(str(u), dimension="length") for u in declared)
    return first, second


def _columns(file: RawFile, rows: Cells) -> tuple[Any, Any]:
    """Return positions and heights as in the file; an empty height is not measured."""
    points = [(number, cells) for number, cells in rows if _X in cells or _Z in cells]
    if len(points) < 2:
        raise file.corrupt("worksheet DATA holds no profile", expected=f"columns {_X} and {_Z}")
    x, z = _table(file, points, _X + _Z, gaps=_Z).T
    return x, z


def _table(file: RawFile, rows: Cells, columns: str, *, gaps: str) -> FloatArray:
    """Return cells as numbers, NaN for an empty one of a column in which gaps are allowed."""
    table = np.empty((len(rows), len(columns)))
    for k, (number, cells) in enumerate(rows):
        for j, column in enumerate(columns):
            value = cells.get(column, math.nan if column in gaps else None)
            if not isinstance(value, float):
                raise file.corrupt(
                    "a cell is not a number",
                    field=f"{column}{number}",
                    expected="a number",
                    found=repr(value)[:40],
                )
            table[k, j] = value
    return table


mitutoyo_xlsx = BuiltIn(_mitutoyo_xlsx_sniff, _mitutoyo_xlsx_channels, _mitutoyo_xlsx_read)
