"""Mitaka MLP point-autofocus instrument, CSV: points x, y, z along lines, such as a tool edge.

The points of a line lie on a contour in a plane: the third coordinate is the stepping axis. One
of the two others is taken as position, the other as height, in the order of the columns; ``x=`` and
``z=`` say otherwise. A contour may turn back (noise on a steep flank, an undercut); a height over
such a position is not unique and is refused, unless ``x="path"`` or ``overhang="drop"`` says what to
do. Counts in the header are hints only. See ``data_formats/mitaka-mlp/SPEC.md``.
"""

from __future__ import annotations

import itertools
import re
from dataclasses import dataclass
from typing import Any

import numpy as np

from metrosep.core._arrays import FloatArray
from metrosep.core.errors import FormatMismatchError, ReadError
from metrosep.core.profile import Profile
from metrosep.core.surface import Surface
from metrosep.core.text_options import ROW_ORDERS
from metrosep.io.declared import Match
from metrosep.io.objects import make_profile, make_surface, only_channels
from metrosep.io.registry import mismatch
from metrosep.io.source import RawFile, refuse_options
from metrosep.io.text.logger import first_lines, number_block, numbered_rows, text_lines

FORMAT = "mitaka-mlp"
_CONSTANT = 1e-6
"""Span in m below which a coordinate counts as the stepping axis: noise of the stage."""

_CLEAR = 10.0
"""The other coordinates must span at least this many times more."""

_GRID = 1e-3
"""Largest deviation of a point from a grid, relative to the step."""


def sniff(file: RawFile) -> Match:
    """Return how sure we are that a file is an MLP file."""
    return Match.YES if is_mlp(file) else Match.NO


def channels(file: RawFile) -> tuple[str, ...]:
    """Return the lines of points."""
    return _names(read_points(file))


def read(
    file: RawFile,
    *,
    channel: str | None = None,
    lateral_step: Any = None,
    unit: Any = None,
    x: str | None = None,
    z: str | None = None,
    overhang: str | None = None,
) -> Profile | Surface:
    """Return a line of points as a profile, or lines on a regular grid as a surface."""
    refuse_options(file, "an MLP list of points in mm", lateral_step=lateral_step, unit=unit)
    for option, value, legal in (
        ("x", x, (*AXES, "path")),
        ("z", z, AXES),
        ("overhang", overhang, ("drop",)),
    ):
        if value is not None and value not in legal:
            raise ReadError(
                f"{file.path}: {option}={value!r} is unknown; use {' or '.join(legal)}"
            )
    points = read_points(file)
    names = _names(points)
    if channel is None and len(names) > 1:
        return _surface(file, points, x, z)
    number = names.index(only_channels(file, "MLP", channel, names))
    start, stop = points.bounds[number : number + 2]
    xyz = points.xyz[start:stop]
    columns = _columns(file, xyz, points.stepping, x, z)
    facts: dict[str, Any] = {"line": number + 1, "n_lines": len(names), **_mean_step(columns, xyz)}
    position = _position(xyz, columns["x"])
    height = xyz[:, AXES.index(columns["z"])]
    warnings = list(points.warnings)
    keep = _forward(position)
    if not keep.all():
        if overhang is None:
            raise _turns_back(file, columns["x"], keep, points.first_line + start)
        position, height = position[keep], height[keep]
        warnings.append(f"{int((~keep).sum())} points that turn back were omitted as asked")
        facts["n_dropped"] = int((~keep).sum())
    return make_profile(
        file,
        FORMAT,
        position,
        height,
        header=points.header,
        warnings=warnings,
        columns=columns,
        unit_in_file="mm",
        overhang=overhang,
        **facts,
    )


def _names(points: Points) -> tuple[str, ...]:
    return tuple(f"line {i}" for i in range(1, len(points.bounds)))


def _columns(
    file: RawFile, xyz: FloatArray, stepping: str | None, x: str | None, z: str | None
) -> dict[str, str]:
    """Return the columns of position and height, and the stepping axis where there is one."""
    spans = np.ptp(xyz, axis=0)
    order = np.argsort(spans)
    clear = spans[order[0]] <= _CONSTANT and spans[order[1]] >= _CLEAR * spans[order[0]]
    constant = stepping or (AXES[int(order[0])] if clear else None)
    free = [a for a in AXES if a not in (constant, x, z)]
    if (x is None or z is None) and constant is None:
        raise FormatMismatchError(
            f"{file.path}: no coordinate is constant along the line (spans "
            f"{', '.join(f'{a} {s:.3g} m' for a, s in zip(AXES, spans, strict=True))}); say which is "
            "what with x= and z="
        )
    chosen = {"x": x or free[0], "z": z or free[-1]}
    if chosen["x"] == chosen["z"]:
        raise FormatMismatchError(
            f"{file.path}: position and height cannot both be {chosen['x']}; give x= and z="
        )
    if constant is not None and constant not in chosen.values():
        chosen["stepping"] = constant
    return chosen


def _mean_step(columns: dict[str, str], xyz: FloatArray) -> dict[str, float]:
    if "stepping" not in columns:
        return {}
    return {"stepping_position_m": float(xyz[:, AXES.index(columns["stepping"])].mean())}


def _position(xyz: FloatArray, axis: str) -> FloatArray:
    """Return a coordinate of the points of a line, or the length of the path along it."""
    if axis != "path":
        return np.asarray(xyz[:, AXES.index(axis)])
    lengths = np.sqrt((np.diff(xyz, axis=0) ** 2).sum(axis=1))
    return np.concatenate([[0.0], np.cumsum(lengths)])


def _forward(position: FloatArray) -> Any:
    """Return which points lie beyond all points before them, in the direction of the line."""
    way = position if position[-1] >= position[0] else -position
    before = np.concatenate([[-np.inf], np.maximum.accumulate(way)[:-1]])
    return way > before


def _turns_back(file: RawFile, axis: str, keep: Any, first_line: int) -> FormatMismatchError:
    line = first_line + int(np.flatnonzero(~keep)[0])
    return FormatMismatchError(
        f"{file.path}: {int((~keep).sum())} points turn back in {axis} (the first near line {line}), so "
        "a height over it is not unique; pass x='path' for heights over the length of the path, or "
        "overhang='drop' to leave those points out"
    )


def _surface(file: RawFile, points: Points, x: str | None, z: str | None) -> Surface:
    """Return the lines as a map where all of them have the same, equidistant positions."""
    n = len(points.bounds) - 1
    columns = _columns(file, points.xyz[: points.bounds[1]], points.stepping, x, z)
    lines = [points.xyz[a:b] for a, b in itertools.pairwise(points.bounds)]
    grid = _grid(lines, columns)
    if grid is None:
        turn = sum(not _forward(_position(line, columns["x"])).all() for line in lines)
        also = f"; {turn} of them turn back in {columns['x']} and take x='path' or overhang='drop' with it"
        raise FormatMismatchError(
            f"{file.path}: holds {n} lines that make no map (their positions are not the same or not "
            f"equidistant); choose one with channel='line 1' ... channel='line {n}'{also if turn else ''}"
        )
    heights, steps, origin = grid
    return make_surface(
        file,
        FORMAT,
        heights,
        steps,
        row_order=ROW_ORDERS[0],
        header=points.header,
        origin=origin,
        warnings=points.warnings,
        columns=columns,
        unit_in_file="mm",
        n_lines=n,
    )


def _grid(
    lines: list[FloatArray], columns: dict[str, str]
) -> tuple[FloatArray, tuple[float, float], tuple[float, float]] | None:
    """Return heights, steps and origin, rows and columns rising; None where there is no grid."""
    if "stepping" not in columns or len({len(line) for line in lines}) > 1 or len(lines[0]) < 2:
        return None
    i, j, k = (AXES.index(columns[c]) for c in ("x", "stepping", "z"))
    cube = np.array([line[np.argsort(line[:, i])] for line in lines])
    cube = cube[np.argsort(cube[:, 0, j])]
    x, y = cube[0, :, i], cube[:, 0, j]
    dx, dy = (float(p[-1] - p[0]) / (p.size - 1) for p in (x, y))
    fits = (
        np.abs(cube[:, :, i] - x[0] - dx * np.arange(x.size)).max() <= _GRID * dx
        and np.abs(cube[:, :, j] - y[0] - dy * np.arange(y.size)[:, np.newaxis]).max()
        <= _GRID * dy
    )
    return (cube[:, :, k], (dx, dy), (float(x[0]), float(y[0]))) if fits and dx * dy > 0 else None


# ---- points of a Mitaka MLP file: two versions of the header, the rows, and where its lines begin ----
# All numbers of the header are hints: they give warnings, never an error, and are never used to cut
# or pad.

AXES = ("X", "Y", "Z")
"""Names of the columns."""

_MM = 1e-3
_TITLE = "X,Y,Z"
_OLD, _NEW = re.compile(r"3D_\d{3},(\d{1,4})\s*"), re.compile(r"MLP-\d+ 3D CSV\s*")
_MARKS = ("AF gain,", "AF sensor,")
_MAX_HEADER = 200


@dataclass(frozen=True)
class Points:
    """Points of a file, where each line begins, and what the header says."""

    header: dict[str, list[str]]  # fields of each header line by its first one
    xyz: FloatArray  # shape (n, 3), m: columns X, Y, Z
    bounds: list[int]  # first point of each line, and the number of points
    stepping: str | None  # the stepping axis, where the header names it
    first_line: int  # line of the first point in the file, from 1
    warnings: list[str]  # what is odd about the file


def is_mlp(file: RawFile) -> bool:
    """Return whether a file has the first line of either version, and the lines on the autofocus."""
    lines = list(itertools.islice(first_lines(file), _MAX_HEADER))
    known = bool(lines) and (_OLD.fullmatch(lines[0]) or _NEW.fullmatch(lines[0]))
    return bool(known) and all(any(line.startswith(m) for line in lines) for m in _MARKS)


def read_points(file: RawFile) -> Points:
    """Return the points of an MLP file."""
    lines = text_lines(file)
    if not is_mlp(file):
        raise mismatch(file, FORMAT)
    title = next((i for i, s in enumerate(lines[:_MAX_HEADER]) if s.strip() == _TITLE), None)
    if title is None:
        raise file.corrupt("the header has no end", expected=f"a line {_TITLE}")
    header: dict[str, list[str]] = {}
    for line in filter(str.strip, lines[:title]):
        key, *values = (f.strip() for f in line.split(","))
        header[key] = values
    xyz = _numbers(file, lines, title + 1)
    warnings = []
    old = _OLD.fullmatch(lines[0])
    if old and int(old[1]) != title + 1:
        warnings.append(f"the header declares {old[1]} lines and has {title + 1}")
    declared, pitch, stepping = _declared(header)
    if declared and declared != len(xyz):
        warnings.append(
            f"the header declares {declared} points and the file holds {len(xyz)}; all were read"
        )
    for axis in AXES:
        high, low = (_value(header, f"{word} in {axis} direction", 0) for word in ("Max.", "Min."))
        if high < low:
            warnings.append(f"Max. in {axis} direction is less than Min. in {axis} direction")
    bounds = _bounds(xyz, pitch * _MM, stepping)
    return Points(header, xyz, bounds, stepping, title + 2, warnings)


def _numbers(file: RawFile, lines: list[str], start: int) -> FloatArray:
    rows = numbered_rows(lines[start:], start + 1)
    if len(rows) < 2:
        raise file.corrupt("has no points", field=f"line {start + 1}", expected="2 rows or more")
    xyz = number_block(file, rows, names=AXES, separator=",")
    if np.isnan(xyz).any():
        line = rows[int(np.flatnonzero(np.isnan(xyz).any(axis=1))[0])][0]
        raise file.corrupt("a coordinate is missing", field=f"line {line}")
    return xyz * _MM


def _value(header: dict[str, list[str]], key: str, index: int) -> float:
    """Return a number of the header, NaN where there is none: all of them are hints."""
    try:
        return float(header[key][index])
    except (KeyError, IndexError, ValueError):
        return float("nan")


def _declared(header: dict[str, list[str]]) -> tuple[int, float, str | None]:
    """Return count of points, stepping pitch in mm (0: one line) and stepping axis, if stated."""
    if "Axis" in header:
        n, m = _value(header, "Number of data", 0), _value(header, "Number of data", 1)
        pitch = _value(header, "Pitch", 1)
        axis = header["Axis"][1] if len(header["Axis"]) > 1 else ""
        stepping = axis if axis in AXES else None
    else:
        n, m = (_value(header, f"Number of points in {a} direction", 0) for a in "XY")
        pitch, stepping = _value(header, "Pitch", 3), None
    whole = np.isfinite(n * m) and 0 < n * m < 2**40
    several = m > 1 and np.isfinite(pitch) and pitch > 0
    return (int(n * m) if whole else 0), (float(pitch) if several else 0.0), stepping


def _bounds(xyz: FloatArray, pitch: float, stepping: str | None) -> list[int]:
    """Return where lines begin: the stepping coordinate moves by more than half its pitch."""
    if pitch == 0.0:
        return [0, len(xyz)]
    moves = np.abs(np.diff(xyz, axis=0))
    column = int(np.median(moves, axis=0).argmin()) if stepping is None else AXES.index(stepping)
    cuts = np.flatnonzero(moves[:, column] > 0.5 * pitch) + 1
    return [0, *(int(c) for c in cuts), len(xyz)]
