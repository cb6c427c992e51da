"""Tool paths as carriers of a correction: the same program with Z (and X) corrected point by point.

Z' = Z + c(X, C) at every block, every other word byte for byte as it was. Nothing is written
before the whole program was rewritten, parsed back and compared; a program that cannot be corrected
from its text is refused with line, reason and way out.

Sign: error e = actual - nominal, correction c = -e, added to the commanded Z. Rapid moves are
corrected too: the same position must mean the same Z, or the tool would step where cutting begins.
"""

from __future__ import annotations

import json
import math
import os
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from metrosep.controllers.base import sidecar_path
from metrosep.controllers.gcode.columns import (
    Outside,
    Settings,
    check_files,
    mark_text,
    open_program,
    require_uncorrected,
    sidecar_of,
    write_stream,
)
from metrosep.controllers.gcode.corrections import PathCorrection, as_path_correction
from metrosep.controllers.gcode.rewrite import Rewriter
from metrosep.controllers.gcode.state import MM, ModalState, checked_system, scale_of_unit
from metrosep.core import numbers
from metrosep.core.errors import DataError, MetrosepError
from metrosep.core.units import format_ends, format_length

PathLike = str | os.PathLike[str]

_STROKE = 100e-6
_BEND = 0.1
_STEEP = 1e-3
"""Slope of a correction beyond which it is no longer metrology (as in `limits`)."""

_FEED = 0.01


@dataclass(frozen=True, slots=True)
class PathResult:
    """What became of a path; lengths in m.

    Parameters
    ----------
    target, sidecar : Path
        The program and the JSON beside it.
    n_blocks, n_moves : int
        Lines of the original; those that move X, C or Z.
    n_changed, n_inserted, n_added : int
        Blocks with another Z or X; words that were inserted; blocks added by splitting.
    correction : tuple of (float, float), m
        Smallest and largest amount added to Z.
    pv, rms : float, m
        Peak to valley of the correction along the path, and root mean square about its mean.
    quantisation : float, m
        One unit of the last digit that is written.
    residual : float, m
        Peak to valley of what rounding leaves of the correction at the points.
    chord_error : float, m
        Largest deviation of the correction between points from the straight line that was seen;
        moves are looked at every half pixel (0.05 mm where nothing says how fast the correction
        bends) and every 5 degrees of C, on two grids.
    read_back_error : float, m
        Largest deviation of the Z in the file, parsed back, from what was meant.
    shortest_block : float, s
        Time of the fastest block; infinite where it is not known.
    first_line, last_line : int
        Of the blocks that change; 0 if none does.
    sha256_source, sha256_target : str
        Of the two programs.
    messages : tuple of str
        For the person.
    audit : mapping
        All of it with units in the keys, as it stands in the sidecar.
    """

    target: Path
    sidecar: Path
    n_blocks: int
    n_moves: int
    n_changed: int
    n_inserted: int
    n_added: int
    correction: tuple[float, float]
    pv: float
    rms: float
    quantisation: float
    residual: float
    chord_error: float
    read_back_error: float
    shortest_block: float
    first_line: int
    last_line: int
    sha256_source: str
    sha256_target: str
    messages: tuple[str, ...]
    audit: dict[str, Any]

    def __repr__(self) -> str:
        return (
            f"PathResult({self.n_blocks} blocks, {self.n_changed} changed, {self.n_inserted} words "
            f"inserted, {self.n_added} blocks added, correction {format_ends(self.correction[0], self.correction[1])}"
            f", last digit {format_length(self.quantisation)})"
        )


def rewrite_path(
    source: PathLike,
    target: PathLike,
    correction: object,
    *,
    axes: tuple[str, ...] = ("Z",),
    decimals: int | None = None,
    resolution: float = 1e-9,
    tolerance: float | None = None,
    unit: str | None = None,
    diameter: bool | None = None,
    outside: Outside = "refuse",
    c_sense: int | None = None,
    c_zero: float | None = None,
    c_rollover: bool | None = None,
    stroke: float = _STROKE,
    blocks_per_s: float | None = None,
    harmless_m: Iterable[int] = (),
    g_system: str | None = None,
    again: bool = False,
    overwrite: bool = False,
) -> PathResult:
    r"""Write a program with its Z (and X) corrected, all other words as they were.

    Parameters
    ----------
    source, target : str or path
        The program and the corrected one; a sidecar ``<target>.json`` appears beside it.
    correction : PathCorrection, CompensationTable, map with ``correction(x, y)``, or callable
        What is added to Z: a callable is c(X, C) in m from X (radius) in m and C in rad. A
        measured error goes through `metrosep.controllers.gcode.corrections.error_correction`.
    axes : {("Z",), ("Z", "X")}, optional
        Words that may change.
    decimals : int, optional
        Digits after the point of changed words; from `resolution` if omitted.
    resolution : float, m, optional
        Finest step that is to be written, when `decimals` is omitted; the words of the path keep
        the digits that they have beyond it.
    tolerance : float, m, optional
        Feed moves are split where the correction bends further from its chord; None leaves the
        blocks as they are.
    unit : {"mm", "inch"}, optional
        Where the program states neither G20 nor G21.
    diameter : bool, optional
        Whether X words are diameters; from G7 and G8 if omitted, else radii.
    outside : {"refuse", "zero", "hold"}, optional
        Positions beyond the map: refused, not corrected, or with the value at the edge.
    c_sense, c_zero : int and float (rad), optional
        For a map with ``correction(x, y)`` only: sense of C on the part (1 if omitted), and polar
        angle at C = 0.
    c_rollover : bool, optional
        What C does where its word changes by more than half a turn in one block: True for the
        shortest way over the roll-over, False along the numbers. Without it such blocks are not
        split.
    stroke : float, m, optional
        Largest correction.
    blocks_per_s : float, 1/s, optional
        Most blocks per second that the controller takes.
    harmless_m : iterable of int, optional
        M codes of this machine that neither move an axis nor change the coordinates; others than
        the usual ones are refused.
    g_system : {"A", "B", "mill"}, optional
        What G90, G92, G94, G98 and G99 mean: A and B are systems of G codes of Fanuc lathes. Without
        it a block with G90, G92 or G94 that may be a turning cycle of system A is refused.
    again : bool, optional
        Correct a program that holds a correction already, for what was measured on a part cut with it.
    overwrite : bool, optional
        Replace an existing file.

    Returns
    -------
    PathResult
        Counts, amounts, hashes, messages.

    Raises
    ------
    UnsupportedFeatureError
        If the program holds what cannot be corrected from its text, with line and way out.
    CorruptFileError
        If it is not G-code.
    ReadError
        If it cannot be read.
    InvalidSamplesError
        If the path leaves the map or crosses what was not measured.
    LimitError
        If a correction exceeds `stroke`, a block is faster than `blocks_per_s`, or `tolerance` is
        not met by the largest number of parts.
    DataError
        If an argument is of the wrong kind or contradicts the correction, `decimals` would cut digits
        of the path, or the program holds a correction already.
    UnitError
        If `unit` is unknown.
    TableError
        If what was written does not read back as meant.
    WriteError
        If the target exists, is the source, or cannot be written.

    Notes
    -----
    The corrected program bears a comment METROSEP CORRECTED, by which it is known under any name.
    Memory does not grow with the program. A block with X or C but no Z gets a Z word where the
    rounded Z differs from the one in force. Blocks before X (and C, where it matters) are known
    are left alone if they are rapid. Subprograms, variables, arcs, cycles, and changes of offset
    within the path are refused: see the page on tool paths.

    Examples
    --------
    >>> import tempfile
    >>> import numpy as np
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     path = Path(folder) / "a.nc"
    ...     _ = path.write_text("G21 G90\nG0 X10.0 C0.0 Z1.0\nG1 C90.0 F100\nM30\n")
    ...     found = rewrite_path(path, path.with_name("b.nc"), lambda x, c: 2e-6 * np.sin(c))
    ...     print(found.target.read_text())
    (METROSEP CORRECTED Z 1f2a97461d3f)
    G21 G90
    G0 X10.0 C0.0 Z1.0
    G1 C90.0 Z1.002000 F100
    M30
    <BLANKLINE>
    """
    settings = _checked(
        Settings(axes, decimals, resolution, tolerance, outside, stroke, blocks_per_s, c_rollover)
    )
    made = as_path_correction(correction, c_sense=c_sense, c_zero=c_zero)
    state = ModalState(
        scale=scale_of_unit(unit),
        diameter=diameter,
        stated_diameter=diameter is not None,
        harmless_m=frozenset(int(m) for m in harmless_m),
        g_system=checked_system(g_system),
        stated_absolute=g_system == "A",
    )
    start, end = Path(source), Path(target)
    check_files(start, end, overwrite=overwrite)
    if not again:
        require_uncorrected(start)
    rewriter = Rewriter(made, settings, state)
    with open_program(start) as stream:
        return _stream(rewriter, stream, start, end, made, again=again, overwrite=overwrite)


def _stream(
    rewriter: Rewriter,
    stream: Any,
    start: Path,
    end: Path,
    made: PathCorrection,
    *,
    again: bool,
    overwrite: bool,
) -> PathResult:
    """Rewrite piece by piece, and return what became of it."""
    result: list[PathResult] = []

    def finish() -> tuple[list[str], bool]:
        if rewriter.tally.moves == 0:
            raise DataError(
                f"{start}: holds no move of X, C or Z (G0 or G1 with such a word); is this the program?"
            )
        rewriter.finish()
        if made.nose is not None and rewriter.places is not None:
            held = rewriter.settings.stroke if again else 0.0
            made.nose.require(rewriter.places.rows, start, held=held)
        return [], bool(rewriter.tally.changed or rewriter.tally.added)

    def said(hashes: list[str]) -> Mapping[str, Any]:
        result.append(_result(rewriter, start, end, made, hashes))
        return result[0].audit

    try:
        write_stream(
            stream, start, end, rewriter.rewrite, finish, said,
            mark=mark_text(rewriter.settings.axes, made.audit), again=again, overwrite=overwrite,
        )  # fmt: skip
    except MetrosepError as error:
        if str(error).startswith("line "):
            raise named_error(error, start) from None
        raise
    return result[0]


def named_error(error: MetrosepError, path: Path) -> MetrosepError:
    """Return the same error with the file before its line."""
    named = type(error).__new__(type(error))
    named.__dict__.update(error.__dict__)
    named.args = (f"{path}: {error}",)
    return named


def _checked(given: Settings) -> Settings:
    """Return settings in SI, and refuse what they cannot be."""
    axes, decimals = tuple(a.upper() for a in given.axes), given.decimals
    if sorted(axes) not in (["Z"], ["X", "Z"]):
        raise DataError(f"axes are {axes}; they are ('Z',) or ('Z', 'X')")
    numbers.choice(given.outside, "outside", ("refuse", "zero", "hold"))
    digits = None if decimals is None else numbers.count(decimals, "decimals", least=0)
    if digits is not None and not 1 <= digits <= 9:
        raise DataError(f"decimals is {decimals}; 1 to 9 digits can be written")
    if given.c_rollover is not None:
        numbers.flag(given.c_rollover, "c_rollover")
    kinds = dict.fromkeys(("resolution", "stroke", "tolerance"), "length")
    checked: dict[str, Any] = {
        name: numbers.positive(value, name, dimension=kind)
        for name, kind in {**kinds, "blocks_per_s": "frequency"}.items()
        if (value := getattr(given, name)) is not None or name in ("resolution", "stroke")
    }
    if checked["resolution"] < 1e-12:
        raise DataError(
            f"resolution is {checked['resolution']} m; no controller resolves less than 1e-12 m"
        )
    if given.tolerance is not None and "X" in axes:
        raise DataError("blocks are split for Z only; leave out tolerance, or give axes=('Z',)")
    return replace(given, axes=axes, decimals=digits, **checked)


def _messages(rewriter: Rewriter) -> tuple[str, ...]:
    tally, state = rewriter.tally, rewriter.state
    found = [f"line {line}: {text}" for text, line in state.messages.items()]
    if not state.stated_absolute:
        found.append("G90 is not stated; words are taken as absolute")
    if not state.stated_scale:
        found.append("the program states no unit; it is the one that was given")
    if state.diameter is None:
        found.append(
            "X is taken as a radius, nothing says otherwise; lathes may need diameter=True"
        )
    if tally.unplaced:
        found.append(
            f"{tally.unplaced} rapid moves before the position was known are left as they were"
        )
    if tally.outside:
        found.append(
            f"{tally.outside} moves lie beyond the map: "
            + ("not corrected" if rewriter.settings.outside == "zero" else "value at its edge")
        )
    if tally.border > tally.step:
        way = (
            "" if tally.border_way == 0.0 else f" over {format_length(tally.border_way, digits=3)}"
        )
        found.append(
            f"line {tally.border_line}: outside='zero' makes a step of "
            f"{format_length(tally.border, digits=3)}{way} at the border of the map"
            + (
                ", steeper than 1 um per mm: the tool marks the part there; use outside='hold' or a map "
                "that runs out to zero"
                if tally.border > _STEEP * tally.border_way
                else ""
            )
        )
    span = tally.high - tally.low
    if tally.chord > max(_BEND * span, tally.step) and rewriter.settings.tolerance is None:
        found.append(
            f"between points the correction bends up to {format_length(tally.chord, digits=2)} from its "
            "chords; give a tolerance to split the blocks there"
        )
    if tally.step > _BEND * span > 0.0:
        found.append("the last digit is coarser than 1/10 of the correction; give more decimals")
    if tally.feed_change > _FEED:
        found.append(
            f"line {tally.feed_line}: with C moving in G94 the path becomes {100 * tally.feed_change:.2g} "
            "% longer or shorter and F is not changed, so C runs faster or slower; write the path in "
            "inverse time (G93)"
        )
    if rewriter.settings.blocks_per_s is not None and tally.per_turn:
        found.append("blocks per second are not known in feed per turn (G95)")
    if not tally.changed:
        found.append("no block changed: the correction is smaller than half of the last digit")
    return tuple(found)


def _result(
    rewriter: Rewriter, start: Path, end: Path, made: PathCorrection, hashes: list[str]
) -> PathResult:
    tally, state = rewriter.tally, rewriter.state
    n = tally.moves - tally.unplaced
    low, high = (tally.low, tally.high) if n else (0.0, 0.0)
    rms = math.sqrt(max(0.0, tally.squares / n - (tally.total / n) ** 2)) if n else 0.0
    residual = max(0.0, tally.after_high - tally.after_low) if n else 0.0
    messages = _messages(rewriter)
    shortest = None if math.isinf(tally.shortest) else tally.shortest
    audit = {
        "correction": dict(made.audit),
        "sign": "correction c = -e is added to the commanded Z; e = actual - nominal",
        "lookup": "at the uncorrected position of each block; rapid moves too",
        "axes": list(rewriter.settings.axes),
        "mark": mark_text(rewriter.settings.axes, made.audit) if tally.changed else None,
        "g_system": state.g_system,
        "unit": "mm" if state.scale == MM else "inch",
        "x_is_diameter": bool(state.diameter),
        "outside": rewriter.settings.outside,
        "n_blocks": tally.blocks,
        "n_moves": tally.moves,
        "n_changed": tally.changed,
        "n_inserted": tally.inserted,
        "n_added": tally.added,
        "n_beyond_map": tally.outside,
        "n_not_placed": tally.unplaced,
        "first_line": tally.first,
        "last_line": tally.last,
        "correction_min_m": low,
        "correction_max_m": high,
        "correction_pv_m": high - low,
        "correction_rms_m": rms,
        "stroke_limit_m": rewriter.settings.stroke,
        "quantisation_m": tally.step,
        "residual_pv_m": residual,
        "tolerance_m": rewriter.settings.tolerance,
        "chord_error_m": tally.chord,
        "chord_looked_at": "every half pixel (0.05 mm without a map) and 5 deg of C at most",
        "c_rollover": rewriter.settings.c_rollover,
        "read_back_error_m": tally.read_back,
        "shortest_block_s": shortest,
        "shortest_block_line": tally.shortest_line,
        "messages": list(messages),
    }
    return PathResult(
        target=end,
        sidecar=sidecar_path(end),
        **{
            n: getattr(tally, n[2:])
            for n in ("n_blocks", "n_moves", "n_changed", "n_inserted", "n_added")
        },
        correction=(float(low), float(high)),
        pv=float(high - low),
        rms=rms,
        quantisation=tally.step,
        residual=residual,
        chord_error=tally.chord,
        read_back_error=tally.read_back,
        shortest_block=tally.shortest,
        first_line=tally.first,
        last_line=tally.last,
        sha256_source=hashes[0],
        sha256_target=hashes[1],
        messages=messages,
        audit=sidecar_of("path", start, hashes, json.loads(json.dumps(audit, default=float))),
    )
