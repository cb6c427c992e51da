"""Lists of machine positions, corrected for the errors of the machine: every axis, by its column.

A row is a pose: the commands of all axes. What is written makes the machine with its errors go where
the nominal row goes, in position and, where axes of rotation can, in orientation
(`metrosep.machine.correct_path`). The file is read back and put through the machine before it is
kept: c = -e is right there, or nothing is written.
"""

from __future__ import annotations

import math
import os
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike

from metrosep.controllers.base import sidecar_path
from metrosep.controllers.gcode.columns import mark_text
from metrosep.controllers.gcode.lists import (
    ListColumn,
    digits_of,
    edited,
    layout,
    lines_of,
    named_columns,
    reread,
    rows_of,
    unit_scale,
    with_mark,
    write_list,
)
from metrosep.controllers.gcode.state import format_number
from metrosep.core import numbers
from metrosep.core._arrays import FloatArray
from metrosep.core.errors import DataError, LimitError, SignCheckFailedError
from metrosep.core.units import format_length

if TYPE_CHECKING:
    from metrosep.machine.chains import Chain, Errors

_LARGEST_TURN = 10e-3
"""rad: no error of an axis of rotation that still works needs a larger correction."""

_AT_ONCE = 20_000

STEP_ANGLE = 1e-9
"""rad: finest step of an angle that is written, 1 nm at a metre."""


@dataclass(frozen=True, slots=True)
class PosesResult:
    """What became of a list of poses.

    Parameters
    ----------
    target, sidecar : Path
        The list and the JSON beside it.
    n_points, n_changed : int
        Rows with a pose; rows in which a command changed.
    before, after : float, m
        RMS error of the tool point by the list as it was, and by the bytes that were written.
    turn_before, turn_after : float, rad
        RMS angle between the actual and the nominal tool axis.
    correction : mapping of str to tuple of (float, float), m or rad
        Smallest and largest amount added, by axis.
    messages : tuple of str
        For the person.
    audit : mapping
        All of it with units in the keys, as in the sidecar.
    """

    target: Path
    sidecar: Path
    n_points: int
    n_changed: int
    before: float
    after: float
    turn_before: float
    turn_after: float
    correction: Mapping[str, tuple[float, float]]
    messages: tuple[str, ...]
    audit: Mapping[str, object]


def rewrite_poses(
    source: str | os.PathLike[str],
    target: str | os.PathLike[str],
    chain: Chain,
    errors: Errors,
    *,
    tool: ArrayLike = (0.0, 0.0, 0.0),
    tool_axis: ArrayLike = (0.0, 0.0, 1.0),
    zero: Mapping[str, float] | None = None,
    units: Mapping[str, str] | None = None,
    resolution: float = 1e-9,
    max_step: float | None = None,
    stroke: float = 100e-6,
    again: bool = False,
    overwrite: bool = False,
) -> PosesResult:
    r"""Write a list of machine positions with the errors of the machine taken off.

    Parameters
    ----------
    source, target : str or path
        The list, with a header that names the axes and their units (``X_mm,Y_mm,Z_mm,A_deg,C_deg``),
        and the corrected one; a sidecar ``<target>.json`` appears beside it.
    chain : Chain
        The machine.
    errors : ErrorSet or mapping of str to float, callable or ErrorTerm
        Its errors, actual minus nominal.
    tool : array_like, shape (3,), m, optional
        Tool point in the frame of the tool.
    tool_axis : array_like, shape (3,), optional
        Axis of the tool in its frame.
    zero : mapping of str to float, m or rad, optional
        Machine position at which an axis of the list reads zero; 0 if omitted.
    units : mapping of str to str, optional
        Unit of a column, where the header does not state it.
    resolution : float, m, optional
        Finest step of a length that is written; of an angle 1 nrad.
    max_step : float, rad, optional
        Largest change of the correction of an axis of rotation from row to row.
    stroke : float, m, optional
        Largest correction of a linear axis.
    again : bool, optional
        Correct a list that holds a correction already.
    overwrite : bool, optional
        Replace an existing file.

    Returns
    -------
    PosesResult
        Errors before and after, amounts, messages.

    Raises
    ------
    DataError
        An axis of the machine has no column, or the list holds a correction already.
    UnitError
        A unit is missing or of the wrong kind.
    CorruptFileError
        A row has another number of columns, or no number where one is needed.
    LimitError
        A correction exceeds `stroke`, or 10 mrad of an axis of rotation.
    SignCheckFailedError
        By the bytes that would be written the error does not shrink.
    WriteError
        The target exists, is the source, or cannot be written.

    Notes
    -----
    Rows are poses where a controller stops or passes; between them it interpolates the axes, and a
    coarse list keeps the curvature of the errors between its rows.

    Examples
    --------
    >>> import tempfile
    >>> from metrosep.machine import presets
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     path = Path(folder) / "a.csv"
    ...     _ = path.write_text("X_mm,Y_mm,Z_mm,F\n100,20,0,500\n200,20,0,500\n")
    ...     found = rewrite_poses(
    ...         path, path.with_name("b.csv"), presets("mill_xyz"), {"EXX": lambda x: 1e-5 * x})
    ...     print(found.target.read_text())
    X_mm,Y_mm,Z_mm,F
    99.999000,20,0,500
    199.998000,20,0,500
    <BLANKLINE>
    """
    from metrosep.machine.inverse import correct_path

    resolution = numbers.positive(resolution, "resolution", dimension="length")
    limit = numbers.positive(stroke, "stroke", dimension="length")
    start, end = Path(source), Path(target)
    lines = lines_of(start, end, again=again, overwrite=overwrite)
    head, sep = layout(lines, start, None)
    columns = _axes_of(lines, head, sep, chain, units or {}, start)
    rows = rows_of(lines, head, sep, columns, start)
    offset = offsets_of(zero or {}, columns, chain)
    nominal = _positions(rows.values, columns, offset)
    found = correct_path(chain, errors, nominal, tool=tool, tool_axis=tool_axis, max_step=max_step)
    linear = {e.name for e in chain.elements if e.kind == "linear"}
    for axis, amounts in found.correction.items():
        refuse_large(axis, amounts, limit if axis in linear else None, rows.row, f"{start}: ")
    changed = 0
    for i, number in enumerate(rows.row):
        edits = []
        for axis, column in columns.items():
            step = resolution if axis in linear else STEP_ANGLE
            own = rows.texts[axis][i]
            digits = max(1, math.ceil(-math.log10(step / column.scale) - 1e-9), digits_of(own))
            amount = float(found.correction[axis][i]) / column.scale
            if abs(amount) > 0.5 * 10.0**-digits:
                value = rows.values[axis][i] + amount
                edits.append((column.index, format_number(value, digits)))
        if edits:
            changed += 1
            rows.lines[number] = edited(rows.lines[number], sep, edits)
    actual = _positions(reread(rows, head, sep, columns, end).values, columns, offset)
    judge = Judge(chain, errors, tool, tool_axis)
    judge.take(nominal, actual)
    sizes = judge.sizes(changed, str(end))
    audit = audit_of(chain, errors, tool, offset)
    final, mark = with_mark(rows, mark_text(tuple(columns), audit), changed)
    ranges = {a: (float(c.min()), float(c.max())) for a, c in found.correction.items()}
    messages = [*chain.messages, *found.messages]
    if not changed:
        messages.append("no row changed: less than half of the last digit")
    elif mark is None:
        messages.append(
            "the list has no comment line, so it bears no mark of its correction: keep the sidecar "
            "with it"
        )
    sidecar = {
        "correction": audit,
        "sign": "the actual pose of the machine with its errors is the nominal one; c = -e",
        "mark": mark,
        "columns": {a: c.index for a, c in columns.items()},
        "n_points": len(rows.row),
        "n_changed": changed,
        "correction_si": {a: list(v) for a, v in ranges.items()},
        **sizes,
        "messages": messages,
    }
    return PosesResult(
        target=end,
        sidecar=sidecar_path(end),
        n_points=len(rows.row),
        n_changed=changed,
        before=sizes["before_rms_m"],
        after=sizes["after_rms_m"],
        turn_before=sizes["turn_before_rms_rad"],
        turn_after=sizes["turn_after_rms_rad"],
        correction=ranges,
        messages=tuple(messages),
        audit=write_list(start, end, lines, final, sidecar, overwrite=overwrite),
    )


def _axes_of(
    lines: list[str],
    head: int | None,
    sep: str,
    chain: Chain,
    units: Mapping[str, str],
    path: Path,
) -> dict[str, ListColumn]:
    """Return the column of each axis that moves; all must be there, each with its unit."""
    kinds = {e.name: e for e in chain.elements if e.kind != "fixed" and not e.parked}
    for unknown in units.keys() - kinds.keys():
        raise DataError(f"there is no axis {unknown!r}; the machine has {', '.join(kinds)}")
    if head is None:
        raise DataError(
            f"{path}: has no header; it must name the axes and their units, such as "
            f"{','.join(f'{a}_{_unit(e)}' for a, e in kinds.items())}"
        )
    names, stated, twice = named_columns(lines[head], sep)
    found = {}
    for axis, element in kinds.items():
        listed = twice.get(axis.upper(), [])
        if len(listed) != 1:
            what = (
                f"has {axis} twice ({', '.join(listed)})" if listed else f"has no column of {axis}"
            )
            raise DataError(
                f"{path}: {what}; a list of positions (not a program) has one column for each axis of "
                f"the machine, such as {axis}_{_unit(element)}"
            )
        index = names[axis.upper()]
        unit = units.get(axis, "") or stated.get(str(index), "")
        kind = "angle" if element.kind == "rotary" else "length"
        found[axis] = ListColumn(index, unit_scale(axis, unit, kind, path))
    return found


def _unit(element: Any) -> str:
    return "deg" if element.kind == "rotary" else "mm"


def offsets_of(zero: Mapping[str, float], axes: Iterable[str], chain: Chain) -> dict[str, float]:
    """Return where each axis of a file has its zero in the machine."""
    kinds, axes = chain.dimensions, list(axes)
    for unknown in zero.keys() - set(axes):
        raise DataError(f"zero names {unknown!r}; the axes are {', '.join(axes)}")
    return {a: numbers.quantity(zero.get(a, 0.0), f"zero of {a}", kinds[a]) for a in axes}


def refuse_large(
    axis: str, amounts: FloatArray, stroke: float | None, rows: Sequence[int], where: str
) -> None:
    """Refuse a correction beyond the stroke, or (None) one of an axis of rotation that no working axis needs."""
    i = int(np.argmax(np.abs(amounts)))
    found, limit = float(abs(amounts[i])), _LARGEST_TURN if stroke is None else stroke
    if found <= limit:
        return
    shown, most, advice = (
        (
            f"{math.degrees(found):.3g} deg",
            f"{math.degrees(limit):.3g} deg",
            "are the angle errors in another unit, or does the path pass close to the singular pose?",
        )
        if stroke is None
        else (
            format_length(found),
            format_length(limit),
            "are the errors in another unit? give stroke= for larger ones",
        )
    )
    raise LimitError(
        f"{where}line {rows[i] + 1}: the correction of {axis} is {shown}, the limit is {most}; {advice}"
    )


def audit_of(
    chain: Chain, errors: Errors, tool: ArrayLike, offset: Mapping[str, float]
) -> dict[str, Any]:
    """Return for what a file was corrected."""
    return {
        "kind": "machine",
        "chain": chain.name,
        "terms": sorted(str(n) for n in _names(errors)),
        "tool_m": [float(v) for v in np.ravel(np.asarray(tool, dtype=np.float64))],
        "zero_si": {a: float(v) for a, v in offset.items()},
    }


def _positions(
    values: Mapping[str, FloatArray],
    columns: Mapping[str, ListColumn],
    offset: Mapping[str, float],
) -> dict[str, FloatArray]:
    return {a: values[a] * c.scale + offset[a] for a, c in columns.items()}


class Judge:
    """The error of the tool point and of its axis, by nominal and by written commands taken part by part."""

    def __init__(
        self, chain: Chain, errors: Errors, tool: ArrayLike, tool_axis: ArrayLike
    ) -> None:
        axis = np.asarray(tool_axis, dtype=np.float64)
        self.chain, self.errors, self.tool = chain, errors, tool
        self.axis = axis / np.linalg.norm(axis)
        self.n, self.squares = 0, np.zeros(4)  # place and direction, before and after

    def take(self, nominal: Mapping[str, FloatArray], written: Mapping[str, FloatArray]) -> None:
        """Add poses."""
        n = max(np.size(v) for v in nominal.values())
        self.n += n
        for i in range(0, n, _AT_ONCE):
            some, done = (
                {a: np.broadcast_to(v, (n,))[i : i + _AT_ONCE] for a, v in q.items()}
                for q in (nominal, written)
            )
            goal = self.chain.transform(some, tool=self.tool)
            for k, commands in enumerate((some, done)):
                actual = self.chain.transform(commands, self.errors, tool=self.tool, exact=True)
                self.squares[k] += np.sum((actual[..., :3, 3] - goal[..., :3, 3]) ** 2)
                off = (actual[..., :3, :3] - goal[..., :3, :3]) @ self.axis
                self.squares[2 + k] += np.sum(off**2)

    def sizes(self, changed: int, name: str) -> dict[str, float]:
        """Return the RMS of each; refuse commands that do not shrink it."""
        keys = ("before_rms_m", "after_rms_m", "turn_before_rms_rad", "turn_after_rms_rad")
        sizes = dict(zip(keys, np.sqrt(self.squares / self.n).tolist(), strict=True))
        least = sizes["turn_before_rms_rad"] + 10.0 * STEP_ANGLE
        turned_away = sizes["turn_after_rms_rad"] > least
        if changed and (turned_away or not sizes["after_rms_m"] < sizes["before_rms_m"]):
            raise SignCheckFailedError(
                f"{name}: the file would not shrink the error of the tool point, RMS "
                f"{format_length(sizes['before_rms_m'])} -> {format_length(sizes['after_rms_m'])}, of its axis "
                f"{sizes['turn_before_rms_rad']:.3g} -> {sizes['turn_after_rms_rad']:.3g} rad; nothing was "
                "written"
            )
        return sizes


def _names(errors: Any) -> tuple[str, ...]:
    from metrosep.machine.error_sets import as_error_set

    return tuple(as_error_set(errors).names)
