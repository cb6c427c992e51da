"""Programs of turned freeforms: written, read back strictly, and cut from their bytes.

A file is written from a `TurningProgram` of the tip and a `LatheAxes`; before it gets its name it is
read back by a reader that knows the machine only, a virtual part is cut from what was read with the
interpolation that the control executes, and the part is compared. G1 is linear unless a spline word
of the control stands in the file. specs/cutting-path.md, section 9.
"""

from __future__ import annotations

import hashlib
import json
import math
import os
from collections.abc import Iterator
from dataclasses import dataclass
from itertools import chain
from pathlib import Path
from typing import Any, Literal, get_args

import numpy as np

from metrosep.controllers.base import paired_stream, sidecar_path
from metrosep.controllers.gcode.columns import require_hash
from metrosep.controllers.gcode.lathe import LatheAxes, rounding_error
from metrosep.controllers.gcode.turning_reader import MARK, read_program
from metrosep.core import numbers
from metrosep.core._arrays import FloatArray
from metrosep.core.errors import DataError, LimitError, TableError
from metrosep.core.units import format_length
from metrosep.forms.base import Form
from metrosep.process.cutting.course_errors import CoursePiece, course_pieces, worst_contacts
from metrosep.process.cutting.edge_errors import cusp_heights
from metrosep.process.cutting.programs import TurningProgram
from metrosep.process.cutting.virtual_part import (
    VirtualPart,
    touched_radii,
    touching_heights,
    virtual_cut,
)
from metrosep.process.nose import RoundNose
from metrosep.process.nose_checks import gouge_check
from metrosep.process.tips import Edge
from metrosep.process.tool_settings import ToolSetting

Kind = Literal["gcode", "pmac", "points"]
"""Blocks with G1; PVT blocks of a PMAC; a list of points as CSV."""

_APPROACH = 10.0
"""s: of the first block, which comes from wherever the tool stands."""
_SLACK = 0.2e-9
"""m: what a check may find beyond what is predicted."""
_PLACES, _SEED = 20_000, 2020
_MOST_LOOKS = 900_000
"""Looks along a program: blocks are looked at as often as that allows, but twice up to `_TWICE` blocks."""
_TWICE = 1_000_000
"""Blocks that are looked at where they begin and in their middle; of more than that, the middle only."""
_WHOLE_MS = 1e-9
_MARGIN = 0.02
"""Turns: by that the lean of the edge and rounding move the deciding moment."""
_GEOMETRY = (
    "the virtual part is geometry: burr, elastic recovery, edge radius, wear, vibration and blending "
    "of corners by the control are not in it"
)
_ROWS = 50_000
"""Points whose words are worked out at once."""
_ALL = slice(None)
_LONGEST = 200
"""Characters of a comment; some controls take 256 in a block."""
_SLOWEST = 0.1
"""mm or inch per minute along X, Y and Z: LinuxCNC's interpreter runs no block of G93 slower."""


@dataclass(frozen=True, slots=True, eq=False)
class ProgramCheck:
    """What the virtual part says of a file.

    Parameters
    ----------
    part : VirtualPart
        Cut from the bytes of the file.
    peak_to_valley : float, m
        Of its error, cusps included.
    cusp : float, m
        Largest height of the cusps of the feed; NaN where the feed does not come out even.
    form_error : float, m
        P-V of its error without cusps: at each place, what the same turns would leave if the edge touched
        the surface all along is taken off, no more than `cusp`; nothing where the nose does not fit.
    difference : float, m
        Largest difference from the part of the program that was to be written, at the places and at every
        point of the program; infinite where one of the two cuts a place and the other does not, NaN
        without such a program.
    rounding : float, m
        What the digits of the words may cost.
    interpolation : str
        What the control executes.
    messages : tuple of str
        What to know.
    planned : float, m, optional
        P-V of the part of the program that was to be written, cusps included; NaN without one.
    course : float, m, optional
        P-V of what the tip is off within every block that touches the region; neighbouring turns cut some of
        it away.
    gap : float, m, optional
        Largest way of the tip between two looks at it: a feature that is shorter may go unseen.
    """

    part: VirtualPart
    peak_to_valley: float
    cusp: float
    form_error: float
    difference: float
    rounding: float
    interpolation: str
    messages: tuple[str, ...] = ()
    planned: float = math.nan
    course: float = math.nan
    gap: float = math.nan

    @property
    def uncut(self) -> int:
        """Number of places that nothing cuts."""
        return int(np.isnan(self.part.error).sum())


@dataclass(frozen=True, slots=True, eq=False)
class WrittenProgram:
    """A file and what it was found to cut.

    Parameters
    ----------
    target, sidecar : Path
        The program, and what is known of it.
    check : ProgramCheck or None
        Of the bytes; None where the check was waived.
    messages : tuple of str
        What to know.
    """

    target: Path
    sidecar: Path
    check: ProgramCheck | None
    messages: tuple[str, ...]


def write_program(
    program: TurningProgram,
    path: str | os.PathLike[str],
    axes: LatheAxes,
    *,
    nose: RoundNose | None,
    form: Form,
    setting: ToolSetting | None = None,
    kind: Kind = "gcode",
    velocity_time: float | None = None,
    block_resolution: float = 1e-3,
    tolerance: float | None = None,
    cut_points: bool = False,
    verify: bool = True,
    overwrite: bool = False,
) -> WrittenProgram:
    """Write a program for a control, read it back and cut the part from it.

    Parameters
    ----------
    program : TurningProgram
        Of the tip.
    path : path
        File to write; a sidecar is written beside it.
    axes : LatheAxes
        What the words of the machine mean.
    nose : RoundNose or None
        The tool, for the check and the head; None where nobody knows it, for cut points only.
    form : Form
        The surface wanted.
    setting : ToolSetting, optional
        How far the tool stands off, where the program makes up for it: the part is cut with it.
    kind : {"gcode", "pmac", "points"}, optional
        Blocks with G1 (or the spline word of the control), PVT blocks of a PMAC, or a CSV of points with
        times, and velocities for PVT.
    velocity_time : float, s, optional
        Unit of time of the velocities of a PMAC (Ix90), needed for "pmac".
    block_resolution : float, s, optional
        Step of the time of a PMAC's PVT block: 1 ms unless its manual says finer.
    tolerance : float, m, optional
        Largest P-V of the part without cusps, by the check: refused where there is none.
    cut_points : bool, optional
        Whether a program of cut points is written, marked as such and not checked.
    verify : bool, optional
        Whether the part is cut from the file before it gets its name.
    overwrite : bool, optional
        Whether another file of that name is replaced (and kept as NAME.1).

    Returns
    -------
    WrittenProgram
        File, sidecar, check.

    Raises
    ------
    DataError
        If the program is one of cut points, the control would not execute its interpolation, a unit
        is missing, or a tolerance is given and nothing is cut that could hold it.
    LimitError
        If the part cut from the file misses the program or the tolerance, or a time cannot be written.
    TableError
        If the points that are read back are not as many as were to be written.
    WriteError
        If the file exists and is another one, cannot be written, or the disk does not hold it.

    Notes
    -----
    Blocks of G93 have an F word each. The first block comes from wherever the tool stands, in 10 s: bring
    the tool near by hand. Blending of corners by the control (G64) is not in the check: G61 is written.
    """
    _require_program(program, axes, kind, cut_points=cut_points)
    if nose is None and program.quantity == "tip":
        raise DataError("a program of the tip needs the nose of the tool that it was made for")
    target = Path(path)
    numbers.choice(kind, "kind", get_args(Kind))
    cutter = nose if verify and program.quantity == "tip" else None
    if tolerance is not None:
        tolerance = numbers.positive(tolerance, "tolerance", dimension="length")
        if cutter is None:
            raise DataError(
                "a tolerance is that of the part cut from the file, and none is cut with verify=False or of "
                "cut points: leave tolerance out"
            )
    if velocity_time is not None:
        velocity_time = numbers.positive(velocity_time, "velocity_time", dimension="time")
    if kind == "pmac":
        lines = _pmac(program, axes, velocity_time, block_resolution)
    else:
        lines = _gcode(program, axes) if kind == "gcode" else _points(program, axes)
    head = _head(program, axes, nose, form, kind, velocity_time)
    slow = _too_slow(program, axes) if kind == "gcode" else ()
    marks = {"gcode": "({})", "pmac": "// {}", "points": "# {}"}[kind]
    digest = hashlib.sha256()
    found: list[ProgramCheck] = []

    def said(written: Path) -> str:
        require_hash(written, digest.hexdigest())
        if cutter is not None:
            back = read_program(written, axes, velocity_time=velocity_time)
            if len(back) != len(program):
                raise TableError(
                    f"{len(back)} of {len(program)} points read back; this is a bug in metrosep"
                )
            made = check_program(back, cutter, form, axes=axes, planned=program, setting=setting)
            _require(made, tolerance)
            found.append(made)
        check = found[0] if found else None
        return _sidecar(program, axes, digest.hexdigest(), check, head, slow)

    with paired_stream(target, said, overwrite=overwrite) as out:
        for line in chain((marks.format(_plain(t)) for t in head), lines):
            data = line.encode("ascii") + b"\n"
            digest.update(data)
            out.write(data)
    messages = (*(found[0].messages if found else ()), *program.messages, *slow)
    return WrittenProgram(target, sidecar_path(target), found[0] if found else None, messages)


def _require_program(
    program: TurningProgram, axes: LatheAxes, kind: str, *, cut_points: bool
) -> None:
    """Refuse what the control would not execute as planned."""
    if not isinstance(program, TurningProgram):
        raise DataError(f"the program must be a TurningProgram, got {type(program).__name__}")
    if not isinstance(axes, LatheAxes):
        raise DataError(f"axes must be LatheAxes, got {type(axes).__name__}")
    if program.quantity != "tip" and not cut_points:
        raise DataError(
            "this is a program of cut points, points of the surface: a tool with a nose that is sent "
            "there cuts too deep. Make a tip path with the nose of the tool, or say cut_points=True"
        )
    if kind == "gcode" and program.interpolation == "pvt":
        raise DataError('G-code has no velocities: write PVT as kind="pmac" or kind="points"')
    if kind == "gcode" and program.interpolation == "spline" and not axes.spline_word:
        raise DataError(
            "the program is planned for a spline, and G1 is a line: plan with interpolation="
            '"linear", name the word of the control (spline_word="CSPLINE"), or write kind="points"'
        )
    if kind == "gcode" and program.interpolation == "linear" and axes.spline_word:
        raise DataError(
            f"the program is planned for lines, and {axes.spline_word} would join its points by a spline: "
            'plan with interpolation="spline"'
        )
    if kind == "pmac" and program.interpolation != "pvt":
        raise DataError(
            f'PVT blocks need velocities; the program is {program.interpolation}: plan with "pvt"'
        )


def _head(
    program: TurningProgram,
    axes: LatheAxes,
    nose: RoundNose | None,
    form: Form,
    kind: str,
    velocity_time: float | None,
) -> list[str]:
    """Return the lines of the head, without marks of a comment."""
    tool = "tool not known"
    if nose is not None:
        rake = math.degrees(nose.rake)
        tool = f"tool radius {1e3 * nose.radius:.9g} mm in {nose.radius_in}, rake {rake:.9g} deg"
        if nose.clearance is not None:
            tool += f", clearance {math.degrees(nose.clearance):.9g} deg"
    c_way = "rises" if (program.sense == "counterclockwise") == (axes.way > 0.0) else "falls"
    points = hashlib.sha256()
    for column in (program.X, program.azimuth, program.Z, program.t):
        points.update(np.ascontiguousarray(column).data)
    lines = [
        MARK,
        f"quantity {program.quantity}",
        f"interpolation {program.interpolation}",
        tool,
        f"surface {form!r}"[:_LONGEST],
        *axes.describe(),
        f"tool goes round the part {program.sense} seen from +Z, C {c_way}",
        "the part must run into the rake face: look which way the spindle turns",
        f"{len(program)} points, {program.turns:.6g} turns at {program.rpm:.6g} rpm",
        f"{program.duration / 60.0:.6g} min",
        f"points sha256 {points.hexdigest()[:16]}",
    ]
    if kind == "gcode":
        what = {"1/min": "1/min", "s": "seconds of the block", "1/s": "1/s"}
        lines.append(
            f"F of G93 is {what[axes.require_inverse_time()]}"
            if axes.feed == "G93"
            else f"F of {axes.feed} is {'degrees of C' if 'deg' in axes.feed else axes.unit + ' along X and Z'}"
            " per minute, one for each block: the time of blocks is rounded by it"
        )
    if kind == "pmac" and velocity_time is not None:
        lines.append(
            f"PVT time ms, velocities per {1e3 * velocity_time:.9g} ms (Ix90), axes in {axes.unit} and deg"
        )
    return lines


def _plain(text: str) -> str:
    """Return a text that may stand in any comment: ASCII without brackets."""
    ascii_ = text.encode("ascii", "replace").decode("ascii")
    return ascii_.replace("(", "[").replace(")", "]").replace("\n", " ")


def _words(
    program: TurningProgram, axes: LatheAxes, part: slice = _ALL
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return X, C in degrees and Z in the units of the file."""
    c = np.degrees(axes.c_of(program.azimuth[part]))
    if axes.c_wraps:
        c = np.mod(np.round(c, axes.c_decimals), 360.0)
    columns = (
        (program.X[part] / axes.x_scale, axes.x_decimals), (c, axes.c_decimals),
        (program.Z[part] / axes.z_scale, axes.z_decimals),
    )  # fmt: skip
    x, c, z = (np.round(v, digits) + 0.0 for v, digits in columns)  # no minus zero
    return x, c, z


def _pieces(n: int) -> Iterator[slice]:
    """Yield parts of n points, each with the last point of the one before."""
    for first in range(0, n - 1, _ROWS):
        yield slice(first, min(first + _ROWS, n - 1) + 1)


def _in_rows(*columns: FloatArray) -> Iterator[tuple[float, ...]]:
    """Yield rows of columns, some ten thousand at a time."""
    for first in range(0, columns[0].size, _ROWS):
        yield from zip(*(c[first : first + _ROWS].tolist() for c in columns), strict=True)


def _gcode(program: TurningProgram, axes: LatheAxes) -> Iterator[str]:
    low, high = 1.0, 0.0
    for part in _pieces(len(program)):
        feeds = _feeds(program, axes, part)
        low = min(low, float(feeds[feeds > 0.0].min(initial=1.0)))
        high = max(high, float(feeds.max()))
    # nine digits, and never an exponent: a control reads its E as another word
    plain = low >= 1e-4 and high < 1e9
    digits = "9g" if plain else f"{max(0, 8 - math.floor(math.log10(low)))}f"
    yield "G90 " + ("G21" if axes.unit == "mm" else "G20")
    yield ("G93" if axes.feed == "G93" else "G94") + " G61"
    shape = f"X{{:.{axes.x_decimals}f}} C{{:.{axes.c_decimals}f}} Z{{:.{axes.z_decimals}f}} F{{:.{digits}}}"
    for part in _pieces(len(program)):
        rows = _in_rows(*_words(program, axes, part), _feeds(program, axes, part))
        row = next(rows)
        if part.start == 0:
            yield "G1 " + shape.format(*row)
            if axes.spline_word:
                yield f"{axes.spline_word} BAUTO EAUTO"
        for row in rows:
            yield shape.format(*row)
    yield "M30"


def _feeds(program: TurningProgram, axes: LatheAxes, part: slice) -> FloatArray:
    """Return the F words of points; that of the first is one of the approach."""
    times = np.diff(program.t[part], prepend=program.t[part.start] - _APPROACH)
    if axes.feed == "G93":
        unit = axes.require_inverse_time()
        return np.asarray({"1/min": 60.0 / times, "s": times, "1/s": 1.0 / times}[unit])
    if axes.feed == "G94":
        way = _way(program, axes, part)
        if (way == 0.0).any():
            at = part.start + int(np.argmax(way == 0.0)) + 1
            raise LimitError(
                f"block {at} moves neither X nor Z by a last digit: G94 has no speed for it; write G93, or "
                "more digits"
            )
        way = way / axes.z_scale
    else:
        way = np.degrees(np.abs(np.diff(program.azimuth[part])))
    # to the first point: a millimetre or a degree in a second, whatever the unit of the words is
    first = 60.0 if axes.feed != "G94" else 60.0 * 1e-3 / axes.z_scale
    return np.append(first, way / times[1:] * 60.0)


def _way(program: TurningProgram, axes: LatheAxes, part: slice) -> FloatArray:
    """Return how far words go along X and Z from point to point, m."""
    x, _, z = _words(program, axes, part)
    return np.hypot(np.diff(x * axes.x_scale), np.diff(z * axes.z_scale))


def _too_slow(program: TurningProgram, axes: LatheAxes) -> tuple[str, ...]:
    """Return a message on blocks of G93 that LinuxCNC would run faster than they say."""
    if axes.feed != "G93" or axes.inverse_time != "1/min":
        return ()
    count, slowest = 0, math.inf
    for part in _pieces(len(program)):
        way = _way(program, axes, part) / axes.z_scale
        rate = way / np.diff(program.t[part]) * 60.0
        slow = (way > 0.0) & (rate < _SLOWEST)  # a block of C alone counts in degrees
        count += int(slow.sum())
        slowest = min(slowest, float(rate[slow].min(initial=math.inf)))
    if not count:
        return ()
    said = (
        f"{count} of {len(program) - 1} blocks move X and Z slower than {_SLOWEST} {axes.unit}/min: "
        f"LinuxCNC runs no block of G93 slower, and C would turn up to {_SLOWEST / slowest:.3g} "
        'times too fast there; write feed = "G94" for it'
    )
    return (said,)


def _pmac(
    program: TurningProgram, axes: LatheAxes, velocity_time: float | None, resolution: float
) -> Iterator[str]:
    if velocity_time is None:
        raise DataError(
            "velocities of a PMAC are per Ix90: give velocity_time, such as 1.0 (s) for Ix90 = 1000"
        )
    step = numbers.positive(resolution, "block_resolution", dimension="time")
    times = np.diff(program.t)
    counts = np.rint(times / step)
    off = np.abs(times - counts * step)
    if (off > _WHOLE_MS * np.maximum(times, step)).any() or (counts < 1).any():
        at = int(np.argmax(off))
        raise LimitError(
            f"block {at + 1} lasts {1e3 * times[at]:.9g} ms, which is not a whole number of "
            f"{1e3 * step:.9g} ms: a PMAC would round it, by {100 * off[at] / times[at]:.2g} %. Choose points "
            "per turn and rpm so that blocks are whole, or state the finer block_resolution of a Turbo or "
            "Power PMAC"
        )
    x, c, z = _words(program, axes)
    assert program.velocities is not None  # noqa: S101  # PVT programs have them
    vx, va, vz = program.velocities
    vx, vc, vz = (
        v * velocity_time
        for v in (vx / axes.x_scale, np.degrees(axes.way * va), vz / axes.z_scale)
    )
    yield "ABS"
    shape = (
        f"X{{:.{axes.x_decimals}f}}:{{:.{axes.x_decimals + 3}f}} "
        f"C{{:.{axes.c_decimals}f}}:{{:.{axes.c_decimals + 3}f}} "
        f"Z{{:.{axes.z_decimals}f}}:{{:.{axes.z_decimals + 3}f}}"
    )
    all_ms = np.append(_APPROACH * 1e3, counts * step * 1e3)
    last = math.nan
    for ms, *row in _in_rows(all_ms, x, vx, c, vc, z, vz):
        if ms != last:
            yield f"PVT{ms:.9g}"
            last = ms
        yield shape.format(*row)


def _points(program: TurningProgram, axes: LatheAxes) -> Iterator[str]:
    x, c, z = _words(program, axes)
    t = program.t - program.t[0]
    u = axes.unit
    if program.velocities is None or program.interpolation != "pvt":
        yield f"t_s,X_{u},C_deg,Z_{u}"
        shape = (
            f"{{:.9f}},{{:.{axes.x_decimals}f}},{{:.{axes.c_decimals}f}},{{:.{axes.z_decimals}f}}"
        )
        columns = [t, x, c, z]
    else:
        vx, va, vz = program.velocities
        yield f"t_s,X_{u},VX_{u}_s,C_deg,VC_deg_s,Z_{u},VZ_{u}_s"
        digits = (axes.x_decimals, axes.c_decimals, axes.z_decimals)
        shape = "{:.9f}" + "".join(f",{{:.{d}f}},{{:.{d + 3}f}}" for d in digits)
        columns = [t, x, vx / axes.x_scale, c, np.degrees(axes.way * va), z, vz / axes.z_scale]
    for row in _in_rows(*columns):
        yield shape.format(*row)


def _sidecar(
    program: TurningProgram,
    axes: LatheAxes,
    digest: str,
    check: ProgramCheck | None,
    head: list[str],
    slow: tuple[str, ...],
) -> str:
    found: dict[str, Any] = {
        "schema": "metrosep turning program 1",
        "file_sha256": digest,
        "head": head,
        "axes": axes.to_dict(),
        "audit": {k: v for k, v in program.audit.items() if isinstance(v, str | int | float)},
        "messages": [*program.messages, *slow],
    }
    if check is not None:
        nm = {
            "pv_nm": check.peak_to_valley,
            "cusp_nm": check.cusp,
            "without_cusps_nm": check.form_error,
            "tip_in_every_block_nm": check.course,
            "tip_looked_at_every_nm": check.gap,
            "file_against_program_nm": check.difference,
            "digits_may_cost_nm": check.rounding,
        }
        found["virtual_part"] = {
            **{k: None if math.isnan(v) else round(1e9 * v, 4) for k, v in nm.items()},
            "interpolation": check.interpolation,
            "places": int(check.part.z.size),
            "messages": list(check.messages),
        }
    return json.dumps(found, indent=1, sort_keys=True) + "\n"


def _require(check: ProgramCheck, tolerance: float | None) -> None:
    """Refuse a file whose part is not that of the program, or misses the tolerance."""
    # what the first and last turn decide neither of the two cuts, and the check says so
    if check.uncut and check.difference == math.inf:
        raise LimitError(
            f"the file cuts nothing at {check.uncut} of {check.part.error.size} places of the part, not all of "
            "which the program leaves uncut; nothing was written"
        )
    # without a tolerance nobody said what digits may cost: never more than the part has without them
    digits = check.rounding if tolerance is not None else min(check.rounding, check.planned)
    if check.difference == math.inf:
        raise LimitError(
            "the file cuts places of the part that the program leaves uncut; nothing was written"
        )
    if not check.difference <= digits + _SLACK:
        raise LimitError(
            f"the part cut from the file differs from that of the program by "
            f"{format_length(check.difference)}, and its digits explain {format_length(check.rounding)} "
            f"(the program itself leaves {format_length(check.planned)} P-V): the control executes "
            f"{check.interpolation}; nothing was written: write more digits, or give the tolerance of the part"
        )
    if tolerance is not None and not check.form_error <= tolerance + _SLACK:
        raise LimitError(
            f"the part cut from the file is off by {format_length(check.form_error)} P-V without cusps, the "
            f"tolerance is {format_length(tolerance)}; nothing was written: take more points, more digits or "
            "another interpolation"
        )


def check_program(
    program: TurningProgram,
    nose: RoundNose,
    form: Form,
    *,
    axes: LatheAxes | None = None,
    planned: TurningProgram | None = None,
    setting: ToolSetting | None = None,
    region: tuple[float, float] | None = None,
    places: int = _PLACES,
    seed: int = _SEED,
) -> ProgramCheck:
    """Return what a program, as it was read from a file, leaves of a part.

    Parameters
    ----------
    program : TurningProgram
        Such as `read_program` returns.
    nose : RoundNose
        The tool.
    form : Form
        The surface wanted.
    axes : LatheAxes, optional
        For what the digits may cost; without, nothing is allowed for them.
    planned : TurningProgram, optional
        The program that was to be written, to compare with.
    setting : ToolSetting, optional
        How far the tool stands off.
    region : tuple of (float, float), m, optional
        Inner and outer radius of the places; where the tool touches between its first and its last turns
        if omitted.
    places : int, optional
        How many, at random over the area; beside them the contacts of the blocks that are furthest off.
    seed : int, optional
        Of the places.

    Returns
    -------
    ProgramCheck
        Part, P-V, cusps, difference.

    Raises
    ------
    DataError
        If the program is one of cut points, or cuts nothing of the region.

    Notes
    -----
    The tip is compared with the lowest that cuts nothing within every block, and the part is cut where it
    is furthest off. Looks are as dense along the turns as the feed is across, but no more than 900,000 in
    all; two a block (its beginning and its middle) up to a million blocks, one in the middle beyond: a feature
    shorter than `ProgramCheck.gap`, or narrower than the feed, may go unseen. With `planned`
    every point is compared, acting at its contact.
    """
    low, high = region or touched_radii(program, nose, form)
    n = numbers.count(places, "places", least=100)
    rng = np.random.default_rng(numbers.count(seed, "seed", least=0))
    rho = np.sqrt(rng.uniform(low * low, high * high, n))
    theta = rng.uniform(-math.pi, math.pi, n)
    course = _Course(program, planned, form, Edge.of(nose, program.sense, setting), (low, high))
    rho, theta = np.append(rho, course.rho), np.append(theta, course.theta)
    x, y = rho * np.cos(theta), rho * np.sin(theta)
    defined = np.isfinite(form(x, y))
    x, y = x[defined], y[defined]
    part = virtual_cut(program, nose, x, y, form=form, setting=setting)
    cut = np.isfinite(part.error)
    every = format_length(course.gap, digits=2)
    unseen = f"the tip is looked at every {every} along the turns or closer: a shorter bump may go unseen"
    said = [_GEOMETRY, unseen, *course.messages]
    cusp, left = math.nan, part.error[cut]
    if program.feed > 0.0:
        high_ = cusp_heights(
            form, x[cut], y[cut], nose=nose, feed=program.feed, sense=program.sense
        )
        # the formula is that of tips a feed apart; where X follows too they are not
        azimuth = np.interp(part.t[cut], program.t, program.azimuth)
        high_ = high_ * (program.advance_at(azimuth) / program.feed) ** 2
        if np.isfinite(high_).any():
            cusp = float(np.nanmax(high_))
            # place by place: a tip that is off where cusps are low is seen; no more than the feed leaves
            if gouge_check(form, nose, region=(low, high)).ok:
                touching = touching_heights(program, nose, part, form, setting)[cut]
                cusps = np.minimum(touching - form(x[cut], y[cut]), cusp)
                left = left - np.where(np.isfinite(cusps), cusps, 0.0)
            else:
                said.append(
                    "the nose does not fit the surface everywhere: what it leaves there is no cusp, and no cusps "
                    "were taken off"
                )
    difference = planned_pv = math.nan
    if planned is not None:
        wanted = virtual_cut(planned, nose, x, y, form=form, setting=setting)
        apart = np.abs(wanted.z - part.z)
        # a place that is cut in one of them only is as far apart as can be; within two turns of an end the
        # other may be decided by a turn that has no neighbour, and rounding chooses between them
        turn = np.where(np.isnan(part.z), wanted.turn, part.turn)
        inner = np.minimum(turn, planned.turns - turn) > 2.0 + _MARGIN
        judged = np.where(np.isnan(apart), np.where(inner, math.inf, 0.0), apart)
        difference = float(max(judged.max(initial=0.0), course.difference))
        planned_pv = wanted.peak_to_valley
    digits = 0.0 if axes is None else rounding_error(axes, form, high)
    return ProgramCheck(
        part, part.peak_to_valley, cusp, float(np.ptp(left)), difference, digits, program.interpolation,
        (*part.messages, *said), planned_pv, course.peak_to_valley, course.gap,
    )  # fmt: skip


class _Course:
    """Every block of a program: the contacts of those furthest off, and how far its points are from a plan."""

    def __init__(
        self,
        program: TurningProgram,
        planned: TurningProgram | None,
        form: Form,
        edge: Edge,
        region: tuple[float, float],
    ) -> None:
        self._program = program
        self._planned = planned if planned is not None and len(planned) == len(program) else None
        # a list whose C is wrapped begins within one turn, wherever the plan does
        turn, apart = 2.0 * math.pi, program.azimuth[0] - (planned or program).azimuth[0]
        self._whole = turn * round(float(apart) / turn)
        self.difference = 0.0
        # along the turns as dense as they are across; even, for a point is wrong where it is, and lines are
        # furthest off in the middle of a block
        longest = max(_longest(program, part) for part in _pieces(len(program)))
        wanted = longest / program.feed if program.feed > 0.0 else 1.0
        most = max(2 if len(program) <= _TWICE else 1, _MOST_LOOKS // len(program))
        looks = int(min(max(4.0, math.ceil(wanted)), most))
        looks -= looks % 2 if looks > 1 else 0
        self.gap = longest / looks
        shares = np.arange(looks) / looks if looks > 1 else np.array([0.5])
        pieces = course_pieces(program, form, edge, shares)
        found = worst_contacts(map(self._compared, pieces), region)
        self.rho, self.theta = found.rho, found.theta
        self.peak_to_valley = found.ends[1] - found.ends[0]
        self.messages: tuple[str, ...] = ()
        if self.peak_to_valley > _SLACK:
            at = " and ".join(
                f"{format_length(abs(off))} too {'high' if off > 0.0 else 'low'} from point {block} on (X = "
                f"{format_length(float(program.X[block]))}, azimuth "
                f"{math.degrees(float(program.azimuth[block])) % 360.0:.5g} degrees)"
                for off, block in zip(found.ends, found.blocks, strict=True)
            )
            self.messages = (f"the tip is furthest off: {at}",)

    def _compared(self, piece: CoursePiece) -> CoursePiece:
        """Return a piece; note what its points are off those of the plan, at their contacts."""
        if self._planned is not None:
            for at in (piece.block, piece.block + 1):  # both ends of each block
                eX, ea, eZ = (
                    getattr(self._program, n)[at] - getattr(self._planned, n)[at]
                    for n in ("X", "azimuth", "Z")
                )
                off = eZ - piece.along_x * eX - piece.by_azimuth * (ea - self._whole)
                self.difference = max(self.difference, float(np.fmax.reduce(np.abs(off))))
        return piece


def _longest(program: TurningProgram, part: slice) -> float:
    """Return the largest way over the part from point to point, m."""
    X, turned = program.X[part], np.diff(program.azimuth[part])
    reach = np.maximum(np.abs(X[1:]), np.abs(X[:-1]))
    return float(np.hypot(np.diff(X), reach * turned).max())
