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
import re
from collections.abc import Iterator
from dataclasses import dataclass
from itertools import chain
from pathlib import Path
from typing import Any, Literal, get_args

import numpy as np

from metrosep.controllers.base import paired_stream, sidecar_path
from metrosep.controllers.gcode.columns import require_hash
from metrosep.controllers.gcode.lathe import LatheAxes, rounding_error
from metrosep.core import numbers
from metrosep.core._arrays import FloatArray
from metrosep.core.errors import CorruptFileError, DataError, LimitError, ReadError, TableError
from metrosep.core.units import format_length
from metrosep.forms.base import Form
from metrosep.process._plain import frozen
from metrosep.process.cutting.edge_errors import cusp_heights
from metrosep.process.cutting.programs import Quantity, TurningProgram
from metrosep.process.cutting.virtual_part import VirtualPart, virtual_cut
from metrosep.process.nose import RoundNose
from metrosep.process.tips import Edge, tips
from metrosep.process.tool_settings import ToolSetting

__all__ = ["ProgramCheck", "WrittenProgram", "check_program", "read_program", "write_program"]

Kind = Literal["gcode", "pmac", "points"]
"""Blocks with G1; PVT blocks of a PMAC; a list of points as CSV."""

_MARK = "METROSEP TURNING PROGRAM"
_APPROACH = 10.0
"""s: of the first block, which comes from wherever the tool stands."""
_SLACK = 0.2e-9
"""m: what a check may find beyond what is predicted."""
_PLACES, _SEED = 20_000, 2020
_WHOLE_MS = 1e-9
_AROUND = 90
"""Tips of a turn that tell how far its contacts reach."""
_ROWS = 50_000
_LONGEST = 200
"""Characters of a comment; some controls take 256 in a block."""


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
    difference : float, m
        Largest difference from the part of the program that was to be written; NaN without one.
    rounding : float, m
        What the digits of the words may cost.
    interpolation : str
        What the control executes.
    messages : tuple of str
        What to know.
    """

    part: VirtualPart
    peak_to_valley: float
    cusp: float
    difference: float
    rounding: float
    interpolation: str
    messages: tuple[str, ...] = ()

    @property
    def form_error(self) -> float:
        """P-V without the cusps, m."""
        return self.peak_to_valley - (0.0 if math.isnan(self.cusp) else self.cusp)


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
        return _sidecar(program, axes, digest.hexdigest(), check, head)

    with paired_stream(target, said, overwrite=overwrite) as out:
        for line in chain((marks.format(_plain(t)) for t in head), lines):
            data = line.encode("ascii") + b"\n"
            digest.update(data)
            out.write(data)
    messages = (*(found[0].messages if found else ()), *program.messages)
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
        points.update(column.tobytes())
    lines = [
        _MARK,
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


def _words(program: TurningProgram, axes: LatheAxes) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return X, C in degrees and Z in the units of the file."""
    c = np.degrees(axes.c_of(program.azimuth))
    if axes.c_wraps:
        c = np.mod(np.round(c, axes.c_decimals), 360.0)
    columns = (
        (program.X / axes.x_scale, axes.x_decimals), (c, axes.c_decimals),
        (program.Z / axes.z_scale, axes.z_decimals),
    )  # fmt: skip
    x, c, z = (np.round(v, digits) + 0.0 for v, digits in columns)  # no minus zero
    return x, c, z


def _in_rows(*columns: FloatArray) -> Iterator[tuple[float, ...]]:
    """Yield rows of columns, some ten thousand at a time."""
    for first in range(0, columns[0].size, _ROWS):
        yield from zip(*(c[first : first + _ROWS].tolist() for c in columns), strict=True)


def _gcode(program: TurningProgram, axes: LatheAxes) -> Iterator[str]:
    x, c, z = _words(program, axes)
    times = np.diff(program.t, prepend=program.t[0] - _APPROACH)
    if axes.feed == "G93":
        unit = axes.require_inverse_time()
        feeds = {"1/min": 60.0 / times, "s": times, "1/s": 1.0 / times}[unit]
    elif axes.feed == "G94":
        rounded = x * axes.x_scale, z * axes.z_scale
        way = np.hypot(*(np.diff(v, prepend=v[0]) for v in rounded))
        if (way[1:] == 0.0).any():
            at = int(np.argmax(way[1:] == 0.0)) + 1
            raise LimitError(
                f"block {at} moves neither X nor Z by a last digit: G94 has no speed for it; write G93, or "
                "more digits"
            )
        feeds = way / axes.z_scale / times * 60.0
    else:
        feeds = (
            np.degrees(np.abs(np.diff(program.azimuth, prepend=program.azimuth[0]))) / times * 60.0
        )
    # to the first point: a millimetre or a degree in a second, whatever the unit of the words is
    if axes.feed != "G93":
        feeds[0] = 60.0 if axes.feed != "G94" else 60.0 * 1e-3 / axes.z_scale
    # nine digits, and never an exponent: a control reads its E as another word
    small = feeds[feeds > 0.0].min(initial=1.0)
    plain = small >= 1e-4 and feeds.max() < 1e9
    digits = "9g" if plain else f"{max(0, 8 - math.floor(math.log10(small)))}f"
    yield "G90 " + ("G21" if axes.unit == "mm" else "G20")
    yield ("G93" if axes.feed == "G93" else "G94") + " G61"
    shape = f"X{{:.{axes.x_decimals}f}} C{{:.{axes.c_decimals}f}} Z{{:.{axes.z_decimals}f}} F{{:.{digits}}}"
    rows = _in_rows(x, c, z, feeds)
    yield "G1 " + shape.format(*next(rows))
    if axes.spline_word:
        yield f"{axes.spline_word} BAUTO EAUTO"
    for row in rows:
        yield shape.format(*row)
    yield "M30"


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
) -> str:
    found: dict[str, Any] = {
        "schema": "metrosep turning program 1",
        "file_sha256": digest,
        "head": head,
        "axes": axes.to_dict(),
        "audit": {k: v for k, v in program.audit.items() if isinstance(v, str | int | float)},
        "messages": list(program.messages),
    }
    if check is not None:
        nm = {
            "pv_nm": check.peak_to_valley,
            "cusp_nm": check.cusp,
            "without_cusps_nm": check.form_error,
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
    if check.difference > check.rounding + _SLACK:
        raise LimitError(
            f"the part cut from the file differs from that of the program by "
            f"{format_length(check.difference)}, and its digits explain {format_length(check.rounding)}: "
            f"the control executes {check.interpolation}; nothing was written"
        )
    if tolerance is None:
        return
    if check.form_error > tolerance + _SLACK:
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
        How many, at random over the area.
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
    """
    low, high = region or _touched(program, nose, form)
    n = numbers.count(places, "places", least=100)
    rng = np.random.default_rng(numbers.count(seed, "seed", least=0))
    rho = np.sqrt(rng.uniform(low * low, high * high, n))
    theta = rng.uniform(-math.pi, math.pi, n)
    x, y = rho * np.cos(theta), rho * np.sin(theta)
    defined = np.isfinite(form(x, y))
    x, y = x[defined], y[defined]
    part = virtual_cut(program, nose, x, y, form=form, setting=setting)
    cut = np.isfinite(part.error)
    cusp = math.nan
    if program.feed > 0.0:
        high_ = cusp_heights(
            form, x[cut], y[cut], nose=nose, feed=program.feed, sense=program.sense
        )
        cusp = float(np.nanmax(high_)) if np.isfinite(high_).any() else math.nan
    difference = math.nan
    if planned is not None:
        wanted = virtual_cut(planned, nose, x, y, form=form, setting=setting)
        difference = float(np.nanmax(np.abs(wanted.z - part.z)))
    digits = 0.0 if axes is None else rounding_error(axes, form, high)
    said = (
        "the virtual part is geometry: burr, elastic recovery, edge radius, wear, vibration and blending "
        "of corners by the control are not in it"
    )
    return ProgramCheck(
        part, part.peak_to_valley, cusp, difference, digits, program.interpolation,
        (*part.messages, said),
    )  # fmt: skip


def _touched(program: TurningProgram, nose: RoundNose, form: Form) -> tuple[float, float]:
    """Return the radii between which contacts of every azimuth lie, one turn off each end."""
    turn = 2.0 * math.pi
    gone = np.abs(program.azimuth - program.azimuth[0])
    ends = []
    for low, high in ((turn, 2.0 * turn), (gone[-1] - 2.0 * turn, gone[-1] - turn)):
        on = np.flatnonzero((gone >= low) & (gone <= high))
        on = on if on.size else np.arange(len(program))
        on = on[:: max(1, on.size // _AROUND)]
        made = tips(
            form, program.X[on], program.azimuth[on], Edge.of(nose, program.sense), strict=False
        )
        known = np.abs(made.rho[np.isfinite(made.rho)])
        if not known.size:
            raise DataError("the tool touches nothing of the form at an end of the program")
        ends.append((float(known.min()), float(known.max())))
    (a, b), (c, d) = ends
    # the inner end counts from its furthest contact, the outer one to its nearest
    low, high = (d, a) if a + b > c + d else (b, c)
    return (low, high) if low < high else (min(a, c), max(b, d))


# ---- the reader: it knows the machine, and nothing of what was meant --------------------------------

_NUMBER = r"[+-]?(?:[0-9]+\.?[0-9]*|\.[0-9]+)"
_PLAIN = re.compile(
    rf"(?:N[0-9]+ ?)?X({_NUMBER}) ?C({_NUMBER}) ?Z({_NUMBER})(?: ?F({_NUMBER}))?\s*"
)
_PVT = re.compile(
    rf"X({_NUMBER}):({_NUMBER}) C({_NUMBER}):({_NUMBER}) Z({_NUMBER}):({_NUMBER})\s*"
)
_TOKEN = re.compile(rf"\s*(?:([A-Z]+)({_NUMBER})?|(%))")
_SPLINES = {"CSPLINE": "spline"}
_QUIET = {"BAUTO", "EAUTO", "G61", "G40", "G49", "G17", "G18", "M3", "M4", "M5", "M30", "M2"}


def read_program(
    path: str | os.PathLike[str],
    axes: LatheAxes,
    *,
    quantity: Quantity | None = None,
    interpolation: Literal["linear", "spline"] | None = None,
    velocity_time: float | None = None,
) -> TurningProgram:
    """Return the program of a file as a machine would run it.

    Parameters
    ----------
    path : path
        G-code with X, C and Z words, PVT blocks of a PMAC, or a CSV of points.
    axes : LatheAxes
        What the words of the machine mean: sign and zero of C, radius or diameter, units.
    quantity : {"tip", "cut points"}, optional
        What the points are; by default what the head of the file says.
    interpolation : {"linear", "spline"}, optional
        What the control makes of a list of points, where the file does not say; G1 is always a line.
    velocity_time : float, s, optional
        Unit of time of a PMAC's velocities (Ix90).

    Returns
    -------
    TurningProgram
        With times from the F words, PVT times or the list.

    Raises
    ------
    DataError
        If a word or unit is not known, F is missing under G93, C turns back, or nothing says what the
        points are; with the line.
    CorruptFileError
        If a block is damaged.
    ReadError
        If the file cannot be read.

    Notes
    -----
    Strict: a word that is not understood is refused. G1 and rapid moves are lines, whatever a head says;
    ``CSPLINE`` of SINUMERIK is read as the C2 spline over the time of the blocks with free ends (BAUTO,
    EAUTO): over what a control really runs its spline parameter is its own affair.
    """
    place = Path(path)
    try:
        text = place.read_text(encoding="ascii")
    except UnicodeDecodeError as exc:
        raise CorruptFileError(
            place, f"byte {exc.start} is not ASCII", hint="is this a program?"
        ) from None
    except OSError as exc:
        raise ReadError(f"{place}: cannot be read ({exc.strerror or exc})") from None
    if not isinstance(axes, LatheAxes):
        raise DataError(f"axes must be LatheAxes, got {type(axes).__name__}")
    said = re.search(r"^[(#/ ]*quantity (tip|cut points)\b", text, re.MULTILINE)
    found = quantity or (said[1] if said else None)
    if found is None:
        raise DataError(
            f"{place}: nothing says whether these are places of the tip or points of the surface: give "
            'quantity="tip" or quantity="cut points"'
        )
    numbers.choice(found, "quantity", get_args(Quantity))
    lines = text.splitlines()
    first = next((s for s in (line.strip() for line in lines) if s and s[0] not in "#(/;%"), "")
    if first.startswith("t_s,"):
        return _read_points(place, lines, axes, found, interpolation)
    if first in ("ABS", "abs") or first.startswith("PVT"):
        return _read_pmac(place, lines, axes, found, velocity_time)
    if interpolation == "spline":
        raise DataError(
            f"{place}: G1 is a line; a spline needs the word of the control in the file, such as CSPLINE"
        )
    return _read_gcode(place, lines, axes, found)


def _refused(place: Path, line: int, what: str) -> DataError:
    return DataError(f"{place}, line {line}: {what}")


def _read_gcode(place: Path, lines: list[str], axes: LatheAxes, quantity: Any) -> TurningProgram:
    columns: dict[str, list[float]] = {"X": [], "C": [], "Z": [], "F": []}
    at: list[bool] = []
    mode, unit, splined, started, ended = "", "", False, False, False
    last: dict[str, str] = {}
    for number, line in enumerate(lines, 1):
        plain = _PLAIN.fullmatch(line) if started and not ended else None
        if plain is not None:
            words = dict(zip("XCZF", plain.groups(), strict=True))
        else:
            bare = re.sub(r"\([^()]*\)|;.*", " ", line).strip()
            if not bare:
                continue
            if ended:
                raise _refused(place, number, "words after the end of the program (M30)")
            words = {}
            pos = 0
            while pos < len(bare):
                token = _TOKEN.match(bare, pos)
                if token is None or token.end() == pos:
                    raise CorruptFileError(
                        place, f"line {number}: {bare[pos:]!r} is not a word of a program"
                    )
                pos = token.end()
                letters, value = token[1], token[2]
                if token[3] or letters == "N":
                    continue
                code = (
                    f"{letters}{float(value):g}"
                    if value and letters in "GM"
                    else letters + (value or "")
                )
                if letters in ("X", "C", "Z", "F") and value is not None:
                    if letters in words:
                        raise _refused(place, number, f"{letters} is there twice")
                    words[letters] = value
                elif code in ("G93", "G94"):
                    if at and mode not in ("", code):
                        raise _refused(
                            place,
                            number,
                            f"{code} after blocks under {mode}; a path has one way to tell time",
                        )
                    mode = code
                elif code in ("G20", "G21"):
                    unit = "inch" if code == "G20" else "mm"
                elif code in ("G0", "G1", "G90"):
                    started = started or code != "G90"
                    splined = splined and code == "G90"
                elif code in _SPLINES:
                    splined = True
                elif code not in _QUIET:
                    raise _refused(
                        place, number, f"{code} is not understood; a strict reader stops here"
                    )
                ended = ended or code in ("M30", "M2")
            if not words:
                continue
            if not started:
                raise _refused(place, number, "axis words before G1: nothing says how to move")
        if unit and unit != axes.unit:
            raise _refused(place, number, f"the program is in {unit}, the machine in {axes.unit}")
        if mode == "G93" and words.get("F") is None:
            raise _refused(place, number, "a block under G93 has no F word; each needs its own")
        if not mode:
            raise _refused(
                place, number, "neither G93 nor G94 is in force: nothing says how long it lasts"
            )
        words = {k: v for k, v in words.items() if v is not None}
        last |= words
        if missing := [k for k in "XCZF" if k not in last]:
            raise _refused(place, number, f"{', '.join(missing)} is not known yet")
        for letter, column in columns.items():
            column.append(float(last[letter]))
        at.append(splined)
    x, c, z, f = (np.array(v) for v in columns.values())
    if x.size < 2:
        raise DataError(f"{place}: holds {x.size} blocks that move; a path needs more")
    joined = set(at[1:])
    if len(joined) > 1:
        raise DataError(
            f"{place}: lines and splines follow one another; one path has one interpolation"
        )
    X, azimuth, Z = _places(axes, x, c, z)
    times = _times(place, axes, mode, f, X, Z, azimuth)
    return TurningProgram(
        X, azimuth, Z, frozen(np.concatenate([[0.0], np.cumsum(times)])), quantity,
        "spline" if True in joined else "linear",
    )  # fmt: skip


def _places(
    axes: LatheAxes, x: FloatArray, c: FloatArray, z: FloatArray
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return radius, azimuth on the part and height of words."""
    if axes.c_wraps:
        c = np.unwrap(c, period=360.0)
    return (
        frozen(x * axes.x_scale),
        frozen(axes.azimuth_of(np.radians(c))),
        frozen(z * axes.z_scale),
    )


def _times(
    place: Path,
    axes: LatheAxes,
    mode: str,
    f: FloatArray,
    X: FloatArray,
    Z: FloatArray,
    azimuth: FloatArray,
) -> FloatArray:
    """Return how long each block after the first lasts, s."""
    feed = f[1:]
    if not (feed > 0.0).all():
        at = int(np.argmax(~(feed > 0.0))) + 1
        raise DataError(f"{place}: F of block {at} is {f[at]:g}; it must be above zero")
    if mode == "G93":
        unit = axes.require_inverse_time()
        return np.asarray({"1/min": 60.0 / feed, "s": feed, "1/s": 1.0 / feed}[unit])
    if axes.feed == "G94 deg":
        return np.asarray(np.degrees(np.abs(np.diff(azimuth))) / feed * 60.0)
    way = np.hypot(np.diff(X), np.diff(Z)) / axes.z_scale
    if (way == 0.0).any():
        at = int(np.argmax(way == 0.0)) + 1
        raise DataError(
            f"{place}: block {at} moves neither X nor Z: under G94 nothing here says how long it lasts"
        )
    return np.asarray(way / feed * 60.0)


def _read_pmac(
    place: Path, lines: list[str], axes: LatheAxes, quantity: Any, velocity_time: float | None
) -> TurningProgram:
    if velocity_time is None:
        raise DataError(
            f"{place}: velocities of a PMAC are per Ix90: give velocity_time, 1.0 (s) for Ix90 = 1000"
        )
    per = numbers.positive(velocity_time, "velocity_time", dimension="time")
    rows, times, ms = [], [], math.nan
    for number, line in enumerate(lines, 1):
        found = _PVT.fullmatch(line)
        if found is not None:
            rows.append([float(v) for v in found.groups()])
            times.append(ms)
            continue
        bare = re.sub(r"(//|;).*", "", line).strip()
        if not bare or bare == "ABS":
            continue
        mode = re.fullmatch(rf"PVT({_NUMBER})", bare)
        if mode is None:
            raise _refused(
                place, number, f"{bare!r} is not understood; a strict reader stops here"
            )
        ms = float(mode[1])
    if len(rows) < 2:
        raise DataError(f"{place}: holds {len(rows)} PVT blocks; a path needs more")
    if np.isnan(times).any():
        raise DataError(f"{place}: a block stands before PVT states its time")
    x, vx, c, vc, z, vz = np.array(rows).T
    X, azimuth, Z = _places(axes, x, c, z)
    velocities = np.stack([vx * axes.x_scale, axes.way * np.radians(vc), vz * axes.z_scale]) / per
    t = np.concatenate([[0.0], np.cumsum(np.array(times[1:]) * 1e-3)])
    return TurningProgram(X, azimuth, Z, frozen(t), quantity, "pvt", frozen(velocities))


def _read_points(
    place: Path, lines: list[str], axes: LatheAxes, quantity: Any, interpolation: str | None
) -> TurningProgram:
    body = [(n, s.strip()) for n, s in enumerate(lines, 1) if s.strip() and s.strip()[0] != "#"]
    names = body[0][1].split(",")
    u = axes.unit
    plain = ["t_s", f"X_{u}", "C_deg", f"Z_{u}"]
    fast = ["t_s", f"X_{u}", f"VX_{u}_s", "C_deg", "VC_deg_s", f"Z_{u}", f"VZ_{u}_s"]
    if names not in (plain, fast):
        raise _refused(
            place,
            body[0][0],
            f"columns {','.join(names)}; known are {','.join(plain)} and {','.join(fast)}",
        )
    rows = []
    for number, line in body[1:]:
        fields = line.split(",")
        try:
            row = [float(v) for v in fields]
        except ValueError:
            raise CorruptFileError(
                place, f"line {number}: {line!r} holds a field that is not a number"
            ) from None
        if len(row) != len(names) or not np.isfinite(row).all():
            raise CorruptFileError(
                place, f"line {number}: {len(names)} numbers are needed, got {line!r}"
            )
        rows.append(row)
    if len(rows) < 2:
        raise DataError(f"{place}: holds {len(rows)} points; a path needs more")
    table = np.array(rows).T
    if names == fast:
        t, x, vx, c, vc, z, vz = table
        velocities = np.stack([vx * axes.x_scale, axes.way * np.radians(vc), vz * axes.z_scale])
        X, azimuth, Z = _places(axes, x, c, z)
        return TurningProgram(X, azimuth, Z, frozen(t), quantity, "pvt", frozen(velocities))
    t, x, c, z = table
    head = re.search(r"^# interpolation (linear|spline)\b", "\n".join(lines), re.MULTILINE)
    joined = interpolation or (head[1] if head else None)
    if joined is None:
        raise DataError(
            f"{place}: a list of points does not say how the control joins them: give "
            'interpolation="linear" or "spline"'
        )
    X, azimuth, Z = _places(axes, x, c, z)
    return TurningProgram(X, azimuth, Z, frozen(t), quantity, joined)  # type: ignore[arg-type]  # checked there
