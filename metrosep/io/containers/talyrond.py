"""Talyrond roundness trace in a worksheet: angle in degrees, radial reading r, r cos, r sin.

Nothing but these four columns is in the file, so it is known by the two equations, which also say that
the angle is in degrees. The reading is a deviation from a circle whose radius the file does not
hold (its mean is zero); that radius and the unit are declared. See ``data_formats/talyrond/SPEC.md``.
"""

from __future__ import annotations

import math
import re
from contextlib import suppress
from typing import Any

import numpy as np

from metrosep.core._arrays import FloatArray
from metrosep.core.errors import CorruptFileError, FormatMismatchError, ReadError, UnitError
from metrosep.core.profile import Profile
from metrosep.core.units import Unit, format_length, parse_quantity, parse_unit
from metrosep.io.containers.workbook import Workbook, zip_members
from metrosep.io.objects import make_profile, only_channels
from metrosep.io.registry import Match
from metrosep.io.source import RawFile, refuse_options

__all__ = ["channels", "read", "sniff"]

FORMAT = "talyrond"
_COLUMNS = "ABCD"
_CELL = re.compile(
    rb'<c r="([A-D])(\d{1,7})"(?: s="\d+")?>(?:<f[^>]*>[^<]*</f>|<f[^>]*/>)?<v>([^<]{1,40})</v></c>'
)
_N_SNIFF = 4
_SAME = 1e-6
"""Largest deviation of x and y from radius and angle, relative to the radius."""

_CLOSED = 1e-6
"""Largest deviation of span + step from a turn, relative, for a trace to count as closed."""


def sniff(file: RawFile) -> Match:
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


def channels(file: RawFile) -> tuple[str, ...]:
    """Return the data sets that can be read: the radial deviation."""
    return ("deviation",)


def read(
    file: RawFile,
    *,
    channel: str | None = None,
    lateral_step: Any = None,
    unit: Any = None,
    radius: float | str | None = None,
) -> Profile:
    """Return the radial deviation of a roundness trace over the length of arc."""
    refuse_options(file, "a trace over angles", lateral_step=lateral_step)
    only_channels(file, "Talyrond", channel, channels(file))
    sheet, numbers = _numbers(file)
    degrees, values = numbers[:, 0], numbers[:, 1]
    factor = _unit(file, unit)
    values = values * factor.factor
    if np.isnan(degrees).any():
        raise CorruptFileError(file.path, "a point has no angle", field="column A")
    angles = np.deg2rad(degrees)
    length = _radius(file, radius, values)
    step = float(angles[-1] - angles[0]) / (angles.size - 1)
    turns = abs(step) * angles.size / math.tau
    return make_profile(
        file,
        FORMAT,
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
        raise CorruptFileError(file.path, f"worksheet {sheet} holds no trace", expected="2 rows")
    table = np.full((len(rows), 4), np.nan)
    for k, (number, cells) in enumerate(rows):
        for j, column in enumerate(_COLUMNS):
            value = cells.get(column, math.nan)
            if not isinstance(value, float):
                raise CorruptFileError(
                    file.path,
                    "a cell is no number",
                    field=f"{column}{number}",
                    expected="a number",
                    found=repr(value)[:40],
                )
            table[k, j] = value
    whole = table[np.isfinite(table).all(axis=1)]
    if len(whole) == 0 or not _is_polar(whole):
        raise FormatMismatchError(
            f"{file.path}: worksheet {sheet} is no roundness trace: expected angle in degrees, r, "
            "r cos(angle) and r sin(angle) in columns A to D; export other tables as CSV"
        )
    return sheet, table


def _unit(file: RawFile, declared: Any) -> Unit:
    if declared is None:
        raise UnitError(
            f"{file.path}: does not state the unit of its deviations; declare it, such as unit='um'"
        )
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
    length = parse_quantity(radius, dimension="length", name="radius")
    if not length > 0.0:
        raise ReadError(f"{file.path}: the radius is {length} m; it must be positive")
    return length
