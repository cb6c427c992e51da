"""What a file does not say and the user must: its unit, or which of its columns is what."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from metrosep.app.first_lines import ask_for, first_lines, text_options
from metrosep.core.errors import DataError, MetrosepError, ReadError, UnknownFormatError
from metrosep.core.runset import RunSet
from metrosep.core.text_options import ROW_ORDERS

ONE_FEED = (
    "the runs do not tell two feedrates apart: the session begins with the mean of the runs, which only "
    "averages vibration; give a column of feed or of time, or runs at another feedrate, and choose joint"
)
"""Said where repeated runs begin with the mean."""

_LENGTHS = ("nm", "um", "mm", "m", "in")

_SHOWN = 8
"""Names of columns that a message about a matrix lists."""

_MAP = {
    "unit": "Unit of the heights, where the table is a map",
    "lateral_step": "Lateral step of the map, such as 3 um, or 2 um x 3 um (along x, along y); with a map leave the columns empty",
}
_LABELS = {
    "x": "Position",
    "x_unit": "Unit of the position, where its name does not say it",
    "z": "Reading or height (+: towards + of the compensated axis)",
    "z_unit": "Unit of the reading, where its name does not say it",
    "feed": "Feedrate: a column, or a value such as 7200 mm/min; empty where there is none",
    "run": "Column that tells the runs apart; empty where each file is one run",
    "time": "Time; empty where there is none",
    "scale": "Sensitivity where the reading is a voltage, such as 2.5 um/V",
}
_TRACE = {
    "angle": "Roundness trace: its angle; with a trace leave position and reading empty",
    "angle_unit": "Unit of the angle, where its name does not say it",
    "radius": "Roundness trace: radius, or deviation from a circle",
    "radius_unit": "Unit of the radius, where its name does not say it",
    "height": "Height of each trace, where the table holds several; empty where it is one",
}
_ROLES = {"x": "position", "z": "height", "feed": "feed", "run": "run", "time": "time"}
"""Roles that the names of columns tell, as every reader of text knows them."""

_ANGLES, _HEIGHTS = ("angle", "winkel", "phi", "theta"), ("height", "höhe", "z")
"""Names of the columns of a roundness trace."""

_FEWEST = 2

_RUNS = {"feed", "run", "direction"}
"""Options that make a set of runs of a single file."""


class Ask(DataError):  # noqa: N818
    """The file does not say something that the user must."""

    def __init__(
        self,
        message: str,
        name: str,
        path: str,
        fields: Sequence[Mapping[str, Any]] = (),
        sample: Mapping[str, Any] | None = None,
    ) -> None:
        super().__init__(message)
        self.name, self.path, self.fields = name, path, tuple(dict(f) for f in fields)
        self.sample = dict(sample or {})  # first lines, columns and what is left out


def holds_columns(
    file: Path, fewest: int = _FEWEST, given: Mapping[str, Any] | None = None
) -> bool:
    """Return whether a file holds several columns of numbers, of text or of a recording."""
    try:
        return len(_numbers(file, given or {})) >= fewest
    except MetrosepError:
        return False


def are_runs(files: Sequence[Path], given: Mapping[str, Any]) -> bool:
    """Return whether what is to be opened is a set of repeated runs, not a map or profile."""
    if len(files) > 1 or _RUNS & set(given):
        return True
    return "x" in given and "z" in given and _is_recording(files[0], given)


def fewest_feeds(runs: RunSet) -> int:
    """Return how many feedrates the runs have in the direction that has fewest."""
    return min(len(runs.select(direction=way).feeds) for way in runs.directions)


def _is_recording(file: Path, given: Mapping[str, Any]) -> bool:
    """Whether a file that is not a text holds channels over time."""
    from metrosep.io.runs import columns_of
    from metrosep.io.source import open_file

    try:
        return "separator" not in columns_of(open_file(file), text_options(given))[1].header
    except MetrosepError:
        return False


def ask_channel(file: Path, given: Mapping[str, Any], why: MetrosepError) -> Ask | None:
    """Return the question which of its data sets a file is opened with."""
    from metrosep.io.read import channels

    if "channel=" not in str(why) or "channel" in given:
        return None
    try:
        names = channels(file)
    except MetrosepError:
        return None
    if not names:
        return None
    words = str(why).partition(";")[0]
    field = {
        "name": "channel",
        "label": "Data set of the file to work on",
        "value": names[0],
        "choices": list(names),
        "hint": "",
    }
    return Ask(words, "channel", str(file), [field])


def ask_rows(file: Path, given: Mapping[str, Any], why: MetrosepError) -> Ask | None:
    """Return the question which row of a map is on top; nothing is proposed, since a guess would be taken."""
    if "row_order=" not in str(why) or "row_order" in given:
        return None
    return Ask(str(why).partition(";")[0], "row_order", str(file), [_rows_field(given)])


def _rows_field(given: Mapping[str, Any]) -> dict[str, Any]:
    return {
        "name": "row_order",
        "label": "Order of the rows in the file: compare the map with the picture of the instrument",
        "value": str(given.get("row_order", "")),
        "choices": list(ROW_ORDERS),
        "hint": ROW_ORDERS[1],
    }


def ask_columns(files: Sequence[Path], given: Mapping[str, Any], why: str) -> Ask:
    """Return the question which column is what, with guesses that the user confirms."""
    columns = _numbers(files[0], given)
    given = _asked_again(given, [name for name, _ in columns])
    if len(columns) < _FEWEST:
        raise ReadError(
            f"{files[0].name}: holds {len(columns)} column of numbers; a run needs a position and a "
            "reading"
        )
    names = [name for name, _ in columns]
    guessed: dict[str, str] = {}
    for role in ("time", "feed", "x", "z", "run"):
        guessed[role] = _guess(role, columns, taken=set(guessed.values()))
    if len(names) == _FEWEST and not guessed["x"] and not guessed["z"]:
        guessed["x"], guessed["z"] = names
    roles = [role for role in _LABELS if _is_asked(role, columns, several=len(files) > 1)]
    labels = {role: _LABELS[role] for role in roles}
    trace = _trace_of(files[0], columns)
    if trace:
        runs = {} if "angle_unit" in trace else labels  # what its numbers prove is no set of runs
        labels = {k: v for k, v in _TRACE.items() if _is_asked(k, columns, several=True)} | runs
        if not {"time", "feed", "run"} & {k for k, v in guessed.items() if v}:
            guessed = trace  # a table of one or more turns, nothing that tells runs apart
    fields = [
        {
            "name": role,
            "label": label,
            "value": str(given.get(role, guessed.get(role, ""))),
            "choices": _choices(role, names),
            "hint": f"such as {_choices(role, names)[1]}" if role.endswith("_unit") else "",
        }
        for role, label in labels.items()
    ]
    sample = first_lines(files[0], given)
    if trace:
        why = f"{why}; is it a roundness trace"
        message = f"{why}, or which column is what? {files[0].name} holds {', '.join(names)}"
        return Ask(message, "columns", str(files[0]), fields, sample)
    if len(files) == 1 and _may_be_map(files[0], given):
        fields = [*_map_fields(given), *fields]
        few = ", ".join([*names[:_SHOWN], *(["..."] if len(names) > _SHOWN else [])])
        message = f"{why}; is it a map, or which column is what? {files[0].name} holds {few}"
        return Ask(message, "columns", str(files[0]), fields, sample)
    message = f"{why}; which column is what? {files[0].name} holds {', '.join(names)}"
    return Ask(message, "columns", str(files[0]), fields, sample)


def ask_text(file: Path, given: Mapping[str, Any], why: MetrosepError) -> Ask | None:
    """Return the question that a refused text leaves: a sheet, lines to leave out, a decimal mark ..."""
    fields = ask_for(str(why), given)
    if not fields or isinstance(why, UnknownFormatError):
        return None
    if any(f["name"] == "sheet" for f in fields):
        from metrosep.io.containers.sheets import sheets_of
        from metrosep.io.source import open_file

        names = list(sheets_of(open_file(file)))
        fields = [f | {"choices": names, "hint": ""} for f in fields if f["name"] == "sheet"]
        sample: dict[str, Any] = {}
    else:
        sample = first_lines(file, given, str(why))
        if not sample:
            return None  # no text at all: no answer would help
    words = str(why).partition("; ")[0]
    return Ask(words, fields[0]["name"], str(file), fields, sample)


def _trace_of(file: Path, columns: Sequence[tuple[str, str | None]]) -> dict[str, str]:
    """Return the columns of a roundness trace, as far as their units and names tell them; empty of other tables."""
    from metrosep.io.registry import find
    from metrosep.io.source import open_file

    names = [name for name, _ in columns]
    try:
        if find(open_file(file)).id == "talyrond":
            return {"angle": names[0], "angle_unit": "deg", "radius": names[1]}
    except MetrosepError:
        pass
    turning = [
        name
        for name, dimension in columns
        if dimension == "angle" or (dimension is None and _bare(name).lower() in _ANGLES)
    ]
    heights = [n for n in names if _bare(n).lower() in _HEIGHTS]
    lengths = [n for n, d in columns if d in ("length", None) and n not in (*turning, *heights)]
    if len(turning) != 1 or not lengths:
        return {}
    return {"angle": turning[0], "radius": lengths[0], "height": (heights or [""])[0]}


def _map_fields(given: Mapping[str, Any]) -> list[dict[str, Any]]:
    choices = {"unit": list(_LENGTHS), "lateral_step": []}
    fields = [
        {
            "name": name,
            "label": label,
            "value": str(given.get(name, "")),
            "choices": choices[name],
            "hint": "such as um" if name == "unit" else "such as 3 um, or 2 um x 3 um",
        }
        for name, label in _MAP.items()
    ]
    return [*fields, _rows_field(given)]


def _may_be_map(file: Path, given: Mapping[str, Any]) -> bool:
    """Whether a text holds nothing but numbers without names: a matrix of heights."""
    from metrosep.io.runs import columns_of
    from metrosep.io.source import open_file
    from metrosep.io.text.matrices import is_matrix

    _, table, _ = columns_of(open_file(file), text_options(given))
    return "separator" in table.header and is_matrix(table)


def answered(given: Mapping[str, Any]) -> dict[str, Any]:
    """Return answers as ``[input]`` of a recipe has them.

    Examples
    --------
    >>> answered({"x": "pos", "x_unit": "mm", "z": "gap_um", "z_unit": "", "feed": ""})
    {'x': {'column': 'pos', 'unit': 'mm'}, 'z': 'gap_um'}
    """
    plain = {k: v for k, v in given.items() if v not in (None, "")}
    if str(plain.get("skip_rows", "")).isdecimal():
        plain["skip_rows"] = int(plain["skip_rows"])
    for role in ("x", "z"):
        unit = plain.pop(f"{role}_unit", None)
        if unit is None:
            continue
        if not isinstance(plain.get(role), str):
            raise DataError(f"{role}_unit = {unit!r} needs the column {role}; name it")
        plain[role] = {"column": plain[role], "unit": unit}
    for role in ("angle", "radius"):
        unit = plain.pop(f"{role}_unit", None)
        if unit is not None and role in plain:
            plain[role] = f"{plain[role]}:{unit}"
    return plain


def _asked_again(given: Mapping[str, Any], names: Sequence[str]) -> dict[str, Any]:
    """Return what `answered` made, in the fields of the question: each unit has its own."""
    fields: dict[str, Any] = {}
    for role, value in given.items():
        if isinstance(value, Mapping):
            parts = value.get("column", ""), value.get("unit", "")
        elif isinstance(value, tuple):  # as a reader takes it
            parts = value
        elif role in ("angle", "radius") and value not in names and ":" in value:
            parts = value.rpartition(":")[::2]
        else:
            fields[role] = value
            continue
        if role in ("x", "z", "angle", "radius"):
            fields[role], fields[f"{role}_unit"] = parts
    return fields


def _is_asked(role: str, columns: Sequence[tuple[str, str | None]], *, several: bool) -> bool:
    """Whether a question makes sense: only of what the columns can answer."""
    if role.endswith("_unit"):
        return any(dimension is None for _, dimension in columns)
    if role in _TRACE:
        return role != "height" or len(columns) > _FEWEST
    if role == "scale":
        return any(dimension in (None, "voltage") for _, dimension in columns)
    return role in ("x", "z") or len(columns) > _FEWEST or (several and role == "feed")


def _choices(role: str, names: list[str]) -> list[str]:
    if role == "angle_unit":
        return ["rad", "deg"]
    if role.endswith("_unit"):
        return list(_LENGTHS)
    return [] if role == "scale" else names


def _numbers(file: Path, given: Mapping[str, Any]) -> list[tuple[str, str | None]]:
    """Return name and dimension of the columns of numbers."""
    from metrosep.io.runs import columns_of
    from metrosep.io.source import open_file

    _, table, _ = columns_of(open_file(file), text_options(given))
    return [(c.name, None if c.unit is None else c.unit.dimension) for c in table.numbers]


_DIMENSIONS = {"x": ("length",), "z": ("length", "voltage"), "feed": ("speed",), "time": ("time",)}


def _guess(role: str, columns: Sequence[tuple[str, str | None]], *, taken: set[str]) -> str:
    """Return the column that is likely meant: by its unit first, then by its name."""
    free = [(name, dimension) for name, dimension in columns if name not in taken]
    named = _named(role, free)
    if role == "x" and not named:  # runs of Y or Z have their axis as position, beside a reading
        readings = set(_named("z", free))
        axes = [name for name, _ in free if re.fullmatch("[yz]", _bare(name), re.IGNORECASE)]
        named = [name for name in axes if readings - {name}]
    if role == "run":
        return named[0] if named else ""
    fits = [name for name, dimension in free if dimension in _DIMENSIONS[role]]
    both = [name for name in named if name in fits]
    # F without a unit may be a force
    unsaid = [n for n in named if dict(free)[n] is None and not (role == "feed" and len(n) == 1)]
    if role in ("x", "z"):  # its unit alone makes a column neither: it may be the other
        other = _named("z" if role == "x" else "x", free)
        fits = [name for name in fits if name not in other]
    return (both or unsaid or fits or [""])[0]


def _named(role: str, columns: Sequence[tuple[str, str | None]]) -> list[str]:
    from metrosep.io._roles import role_of

    return [name for name, _ in columns if role_of(name) == _ROLES[role]]


def _bare(name: str) -> str:
    """Return a name without its unit: ``x_mm`` is x, ``feed_mm_min`` is feed."""
    return re.sub(r"[_ ]*[\[(_].*$", "", name.strip()) or name.strip()
