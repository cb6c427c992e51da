"""Circular tests from text: deviations over the angle, or a log of positions while the circle ran.

What a file may hold, its columns named or found by their names:

    angle, ccw, cw          deviation of the radius at places of the circle, for both senses
    angle, reading          one run after the other; the sense is that in which the angle runs
    x, y, reading           a log: commanded or actual positions, and the deviation of a bar's length
    x, y, length            the same with the whole length of the bar
    x, y                    a log of actual positions (grid encoder, or the encoders themselves)

Runs of one sense may stand in several files. Places of both senses that differ are brought onto one
grid: readings are averaged in equal cells of angle, and straight lines join the cells. Lines
``overrun`` of LinuxCNC's halsampler, where samples were lost, are left out and counted.
"""

from __future__ import annotations

import os
import re
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from metrosep.core import numbers
from metrosep.core._arrays import FloatArray
from metrosep.core.errors import DataError, FormatMismatchError, UnitError
from metrosep.core.provenance import Step
from metrosep.io._roles import pick, to_si
from metrosep.io.runs import columns_of
from metrosep.io.source import RawFile, open_file
from metrosep.io.text.table import Table, read_table

_WORDS: Mapping[str, tuple[str, ...]] = {
    "angle": ("angle", "winkel", "phi", "theta"),
    "ccw": ("ccw", "acw", "anticlockwise", "counterclockwise"),
    "cw": ("cw", "clockwise"),
    **{a: (a, f"{a}_pos", f"{a}_position", f"pos_{a}") for a in "xyz"},
    "reading": ("reading", "deviation", "radial deviation", "ballbar", "dr", "error"),
    "length": ("length", "radius", "bar length"),
}
"""Names of columns by what they are, without their unit, in small letters."""

_ROLES = tuple(r for r in _WORDS if r != "z")
_PLANES = ("XY", "YZ", "ZX", "XZ")
_FEWEST, _FEWEST_TURNING = 16, 3
"""Readings of a sense, and those about a reversal that are none."""

_CELLS = (72, 720)  # fewest and most of the common grid
_MOVING = 0.9  # of the median speed along the circle: slower samples start, stop or dwell
_SAME = 1e-3  # of the step between places: rounding of text
_LARGEST = 1e-2  # m, of a deviation


@dataclass(frozen=True, slots=True, eq=False)
class CircleLog:
    """Deviations of the radius over the angle of the place.

    Parameters
    ----------
    angle : ndarray, shape (n,), rad
        Places, common to both senses.
    ccw, cw : ndarray, shape (n,), m, or None
        Deviation for the angle rising and falling; None where that sense was not run.
    history : tuple of Step
        One step ``read`` for each file.
    messages : tuple of str
        What was done with the rows.
    """

    angle: FloatArray
    ccw: FloatArray | None
    cw: FloatArray | None
    history: tuple[Step, ...]
    messages: tuple[str, ...] = ()


def read_circle_log(
    paths: str | os.PathLike[str] | Iterable[str | os.PathLike[str]],
    *,
    radius: float,
    columns: Mapping[str, str] | None = None,
    plane: str = "XY",
    **layout: Any,
) -> CircleLog:
    """Return the runs of a circular test as `metrosep.machine.circle_test` takes them."""
    numbers.choice(plane, "plane", _PLANES)
    files = [paths] if isinstance(paths, str | os.PathLike) else list(paths)
    if not files:
        raise FormatMismatchError("no file of a circular test; name at least one")
    parts: list[list[Runs]] = []
    history: list[Step] = []
    said: list[str] = []
    for path in files:
        file = open_file(path)
        table, lost = _table(file, {k: v for k, v in layout.items() if v is not None})
        if lost:
            said.append(f"{file.name}: samples were lost at {lost} places (overrun)")
        said += [f"{file.name}: {w}" for w in table.warnings]
        named = _named(file, table, columns or {}, plane)
        parts.append(_part(file, table, named, radius, said))
        history += file.history("circle-log", dict(named))
    merged = _merged(parts, said)
    _refuse_large(merged, Path(files[0]).name)
    return CircleLog(*merged, tuple(history), tuple(dict.fromkeys(said)))


Runs = tuple[FloatArray, FloatArray | None, FloatArray | None]


def _table(file: RawFile, layout: dict[str, Any]) -> tuple[Table, int]:
    """Return the columns of a file, and how many lines say that samples were lost."""
    lost = [
        i for i, line in enumerate(file.data.splitlines(), 1) if line.strip().lower() == b"overrun"
    ]
    if not lost:
        return columns_of(file, layout)[1], 0
    skip = ",".join(str(i) for i in lost)
    given = layout.get("skip_lines")
    layout = {**layout, "skip_lines": f"{given},{skip}" if given else skip}
    return read_table(file, **layout), len(lost)


def _named(file: RawFile, table: Table, given: Mapping[str, str], plane: str) -> dict[str, str]:
    """Return the column of each role: those that were named, else by their names; x and y are the plane's."""
    for role in given:
        if role not in _ROLES:
            raise FormatMismatchError(
                f"a circular test has no column {role!r}; there are {', '.join(_ROLES)}"
            )
    found = dict(given)
    taken = set(given.values())
    by_name: dict[str, list[str]] = {}
    for name in table.names:
        by_role = _role(name)
        if by_role is not None and name not in taken:
            by_name.setdefault(by_role, []).append(name)
    axes = {a: by_name.pop(a) for a in "xyz" if a in by_name}
    by_name = {r: names for r, names in by_name.items() if r not in given}
    turned = "angle" in {*given, *by_name}  # then the positions are not used
    of = zip("xy", "xy" if turned else plane.lower(), strict=True)
    wanted = {r: a for r, a in of if r not in given}
    if not turned and not axes.keys() >= set(wanted.values()):
        _refuse_axes(file, table, plane)
        wanted = {}
    by_name |= {r: axes[a] for r, a in wanted.items() if a in axes}
    said_values = any(r not in ("angle", "x", "y") for r in given)
    for role, names in by_name.items():
        if said_values and role in ("ccw", "cw", "reading", "length"):
            continue  # what holds the deviations was said
        if len(names) > 1:
            raise FormatMismatchError(
                f"{file.path}: {' and '.join(names)} may both be the {role}; name the right one: "
                f"{role} = {names[0]!r}"
            )
        found[role] = names[0]
    has = set(found)
    if not ({"angle"} <= has or {"x", "y"} <= has) or not (
        has & {"ccw", "cw", "reading", "length"} or {"x", "y"} <= has
    ):
        raise FormatMismatchError(
            f"{file.path} has no columns of a circular test: angle_deg with ccw_um and cw_um (or "
            f"reading_um), or x_mm and y_mm with reading_um; name them (its columns are "
            f"{', '.join(table.names)})"
        )
    return found


def _refuse_axes(file: RawFile, table: Table, plane: str) -> None:
    """Refuse positions of other axes than those of the plane; a table without two axes is no log."""
    own = "".join(a for a in "XYZ" if a.lower() in map(_role, table.names))
    if len(own) > 1:
        given = f"give plane={own!r}, or " if own in _PLANES and set(own) != set(plane) else ""
        raise FormatMismatchError(
            f"{file.path} holds positions of {' and '.join(own)}, and the plane is {plane}; {given}name the "
            "columns with x= and y="
        )


def _role(name: str) -> str | None:
    """Return what a column is by its name without unit: ``Radial deviation [um]`` is a reading."""
    text = name.strip().strip('"').lower()
    text = re.sub(r"[\s_]*[(\[].*[)\]]\s*$", "", text)
    text = re.sub(r"\s*/\s*\S+$", "", text)
    options = {text, re.sub(r"_[^_]*$", "", text)}
    return next((r for r, words in _WORDS.items() if options & set(words)), None)


def _part(
    file: RawFile, table: Table, named: Mapping[str, str], radius: float, said: list[str]
) -> list[Runs]:
    """Return the runs of one file."""

    def column(role: str) -> FloatArray | None:
        if role not in named:
            return None
        found, unit = pick(file, table, named[role], role=role)
        dimension = "angle" if role == "angle" else "length"
        return to_si(file, found, unit, dimension=dimension, role=role)

    angle, x, y, ccw, cw, reading, length = (
        column(r) for r in ("angle", "x", "y", "ccw", "cw", "reading", "length")
    )
    if angle is not None and (ccw is not None or cw is not None):
        return [(angle, ccw, cw)]
    if length is not None and reading is None:
        reading = length - radius
    if angle is None and x is not None and y is not None:
        angle, own = _round(file, x, y, radius)
        moving = _moving(angle)
        if not moving.all():
            said.append(
                f"{file.name}: {int((~moving).sum())} samples in which the circle did not run at its "
                "speed are omitted"
            )
        reading = own if reading is None else reading
        return _senses(file, angle, np.where(moving, reading, np.nan))
    if angle is None or reading is None:
        raise FormatMismatchError(
            f"{file.path}: the deviation of the radius is missing; name it with reading, ccw or cw"
        )
    known = np.isfinite(angle)
    whole = np.full(angle.shape, np.nan)
    whole[known] = np.unwrap(angle[known])
    lost = int(np.count_nonzero(~(known & np.isfinite(reading))))
    if lost:
        said.append(f"{file.name}: {lost} rows without an angle or a reading are left aside")
    return _senses(file, whole, reading)


def _round(
    file: RawFile, x: FloatArray, y: FloatArray, radius: float
) -> tuple[FloatArray, FloatArray]:
    """Return the angle along the circle and the deviation of its radius, about its own centre."""
    known = np.isfinite(x) & np.isfinite(y)
    columns = np.column_stack([x[known], y[known], np.ones(int(known.sum()))])
    # x^2 + y^2 = 2 cx x + 2 cy y + const
    middle = columns.mean(axis=0) * [1.0, 1.0, 0.0]
    own = columns - middle
    found = np.linalg.lstsq(own, np.sum(own[:, :2] ** 2, axis=1), rcond=None)[0]
    cx, cy = 0.5 * found[:2] + middle[:2]
    away = np.hypot(x - cx, y - cy) - radius
    size = float(np.nanmedian(away)) + radius
    if abs(size - radius) > 0.01 * radius:
        raise DataError(
            f"{file.path}: the positions run on a circle of {size * 1e3:.4g} mm, the programmed radius is "
            f"{radius * 1e3:.4g} mm; check the radius and the unit of the positions"
        )
    angle = np.full(x.shape, np.nan)
    angle[known] = np.unwrap(np.arctan2(y[known] - cy, x[known] - cx))
    return angle, away


def _moving(angle: FloatArray) -> Any:
    """Return which samples run at the speed of the circle, over a 360th of a turn about each."""
    speed = np.abs(np.gradient(angle))
    usual = float(np.nanmedian(speed[speed > 0.0])) if np.any(speed > 0.0) else 0.0
    if usual == 0.0:
        raise DataError("the positions of the log do not move along a circle")
    width = max(int(np.radians(1.0) / usual), 1)
    smooth = np.convolve(np.nan_to_num(speed), np.ones(width) / width, mode="same")
    moving = smooth >= _MOVING * float(np.median(smooth[smooth > 0.5 * usual]))
    moving[: width // 2] = moving[moving.size - width // 2 :] = False
    return moving


def _senses(file: RawFile, angle: FloatArray, reading: FloatArray) -> list[Runs]:
    """Return the rows with the angle rising and falling as runs of their own."""
    step = np.gradient(np.interp(np.arange(angle.size), np.flatnonzero(np.isfinite(angle)),
                                 angle[np.isfinite(angle)]))  # fmt: skip
    known = np.isfinite(angle) & np.isfinite(reading)
    found: list[Runs] = []
    for sign in (1.0, -1.0):
        rows = known & (sign * step > 0.0)
        n = int(rows.sum())
        if _FEWEST_TURNING < n < _FEWEST:
            raise DataError(
                f"{file.path}: {n} readings run with the angle {'rising' if sign > 0 else 'falling'}; a sense "
                f"needs {_FEWEST}: take more, or leave that sense out of the file"
            )
        if n >= _FEWEST:
            place = np.mod(angle[rows], 2.0 * np.pi)
            order = np.argsort(place, kind="stable")
            values = reading[rows][order]
            found.append(
                (place[order], values, None) if sign > 0 else (place[order], None, values)
            )
    if not found:
        raise DataError(
            f"{file.path}: no run round the circle was found; the angle must rise or fall"
        )
    return found


def _merged(parts: Sequence[list[Runs]], said: list[str]) -> Runs:
    """Return both senses over common places."""
    runs = [run for part in parts for run in part]
    if len(runs) == 1 and runs[0][0].size <= 2 * _CELLS[1]:
        return runs[0]
    senses: dict[str, list[tuple[FloatArray, FloatArray]]] = {"ccw": [], "cw": []}
    for angle, ccw, cw in runs:
        for name, values in (("ccw", ccw), ("cw", cw)):
            if values is not None:
                senses[name].append((np.mod(angle, 2.0 * np.pi), values))
    single = [v[0] for v in senses.values() if len(v) == 1]
    if len(single) == 2 and all(len(v) == 1 for v in senses.values()):
        (a, first), (b, second) = single
        one, two = np.argsort(a, kind="stable"), np.argsort(b, kind="stable")
        if a.size == b.size and np.abs(a[one] - b[two]).max() < _SAME * 2.0 * np.pi / a.size:
            return a[one], first[one], second[two]
    gathered = {
        n: (np.concatenate([p[0] for p in v]), np.concatenate([p[1] for p in v]))
        for n, v in senses.items()
        if v
    }
    fewest = min(int(np.isfinite(v).sum()) for _, v in gathered.values())
    n = int(np.clip(fewest // 2, *_CELLS))
    said.append(f"the rows of each sense are averaged in {n} equal cells of angle")
    grid: FloatArray = np.asarray((np.arange(n) + 0.5) * (2.0 * np.pi / n), dtype=np.float64)
    onto = {name: _onto(grid, *v) for name, v in gathered.items()}
    return grid, onto.get("ccw"), onto.get("cw")


def _onto(grid: FloatArray, angle: FloatArray, values: FloatArray) -> FloatArray:
    """Return cell means of readings, carried to the middle of each cell along straight lines."""
    known = np.isfinite(values) & np.isfinite(angle)
    angle, values = np.mod(angle[known], 2.0 * np.pi), values[known]
    n = grid.size
    cell = np.minimum((angle * (n / (2.0 * np.pi))).astype(int), n - 1)
    count = np.bincount(cell, minlength=n)
    there = count > 0
    mean_a = np.bincount(cell, weights=angle, minlength=n)[there] / count[there]
    mean_r = np.bincount(cell, weights=values, minlength=n)[there] / count[there]
    out = np.interp(grid, mean_a, mean_r, period=2.0 * np.pi)
    out[~there] = np.nan
    return np.asarray(out)


def _refuse_large(runs: Runs, name: str) -> None:
    for values in runs[1:]:
        if values is not None and np.nanmax(np.abs(values), initial=0.0) > _LARGEST:
            raise UnitError(
                f"{name}: deviations of the radius reach {np.nanmax(np.abs(values)) * 1e3:.4g} mm; check their "
                "unit, or name the column as length where it holds the whole length of the bar"
            )
