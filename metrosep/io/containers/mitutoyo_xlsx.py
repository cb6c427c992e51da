"""Mitutoyo surface roughness tester, ``.xlsx``: worksheets ``Certificate`` and ``DATA``.

In ``DATA`` column A holds the printed results (``Ra     3.308  µm``), B the settings, E the positions in
mm and F the heights of the evaluated profile. The unit of the heights is that of the printed
results. See ``data_formats/mitutoyo-xlsx/SPEC.md``.
"""

from __future__ import annotations

import re
from typing import Any

import numpy as np

from metrosep.core._arrays import FloatArray
from metrosep.core.errors import CorruptFileError, FormatMismatchError, UnitError
from metrosep.core.profile import Profile
from metrosep.core.units import Unit, format_length, parse_quantity, parse_unit
from metrosep.io.containers.workbook import Cells, Workbook, zip_members
from metrosep.io.objects import make_profile, only_channels
from metrosep.io.registry import Match
from metrosep.io.source import RawFile, lateral_steps, refuse_options

__all__ = ["channels", "read", "sniff"]

FORMAT = "mitutoyo-xlsx"
_SHEETS = ("Certificate", "DATA")
_X, _Z = "E", "F"
_RESULT = re.compile(r"([RPW][aqzptvc])\s+-?[\d.]+\s+(\S+)\s*")
_KIND = re.compile(r"CUV\s+(\S+)")
_CUTOFFS = {"CUT": "lambda_c_m", "LS": "lambda_s_m"}
_OFF = frozenset({"NONE", "OFF", "NO"})
_COUNT = re.compile(r"[1-9]\d{0,3}")


def sniff(file: RawFile) -> Match:
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


def channels(file: RawFile) -> tuple[str, ...]:
    """Return the data sets that can be read: the profile."""
    return ("profile",)


def read(
    file: RawFile, *, channel: str | None = None, lateral_step: Any = None, unit: Any = None
) -> Profile:
    """Return the evaluated profile of a Mitutoyo workbook."""
    only_channels(file, "Mitutoyo", channel, channels(file))
    override = lateral_steps(lateral_step)
    book = Workbook(file)
    if not set(_SHEETS) <= set(book.names):
        raise FormatMismatchError(
            f"{file.path}: is no Mitutoyo workbook: expected worksheets Certificate and DATA, found "
            f"{', '.join(book.names)[:80]}; leave out format= to have it recognised"
        )
    rows = book.cells("DATA", ("A", "B", _X, _Z))
    results = [str(cells["A"]).strip() for _, cells in rows if "A" in cells]
    settings = [str(cells["B"]).strip() for _, cells in rows if "B" in cells]
    units = _units(file, results, unit)
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
    return make_profile(
        file,
        FORMAT,
        positions,
        z * units[1].factor,
        header={"results": results, "settings": settings, "certificate": certificate},
        override=override[0] if override else None,
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
        raise CorruptFileError(
            file.path, "worksheet DATA holds no profile", expected=f"columns {_X} and {_Z}"
        )
    for number, cells in points:
        for column, value in ((_X, cells.get(_X)), (_Z, cells.get(_Z, 0.0))):
            if not isinstance(value, float):
                raise CorruptFileError(
                    file.path,
                    "a cell of worksheet DATA is no number",
                    field=f"{column}{number}",
                    expected="a number",
                    found=repr(value)[:40],
                )
    x = np.array([cells[_X] for _, cells in points], dtype=np.float64)
    z = np.array([cells.get(_Z, np.nan) for _, cells in points], dtype=np.float64)
    return x, z
