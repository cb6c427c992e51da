"""The command that corrects a tool path: path."""

from __future__ import annotations

import json
import re
import sys
from typing import TYPE_CHECKING, Any, Literal

import click

from metrosep.cli.options import (
    chain_of,
    file_options,
    json_option,
    name_values,
    phase,
    read_aloud,
    say,
    say_next,
)

if TYPE_CHECKING:
    from metrosep.controllers.gcode.corrections import PathCorrection
    from metrosep.controllers.gcode.lists import PointResult
    from metrosep.controllers.gcode.paths import PathResult


@click.command()
@click.argument("program", metavar="IN.nc")
@click.option(
    "--error",
    "errors",
    required=True,
    multiple=True,
    metavar="MAP",
    help="Error of the part, a file; with --machine its error terms, may be repeated.",
)
@click.option(
    "--machine",
    metavar="MACHINE",
    help="Correct IN, a program or list of positions of all axes, for the errors of a machine: a preset or TOML.",
)
@click.option("--pivot-height", metavar="LENGTH", help="With --machine five_axis.")
@click.option("--tool", metavar="X,Y,Z", help="With --machine: tool point in the last frame.")
@click.option(
    "--zero",
    "zeros",
    multiple=True,
    metavar="AXIS=PLACE",
    help="With --machine: machine position where an axis of IN reads 0; 0 if omitted.",
)
@click.option(
    "--max-step", metavar="ANGLE", help="With --machine: largest step of a rotary correction."
)
@click.option("-o", "--out", required=True, metavar="FILE", help="Corrected program to write.")
@click.option(
    "--centre",
    metavar="middle|X,Y",
    help='Spindle axis in the map: middle, or "1.2 mm, 0 mm"; its coordinates 0, 0 if omitted.',
)
@click.option(
    "--c-sense",
    type=click.Choice(["+1", "1", "-1"]),
    help="+1 (taken if omitted): the tool goes to larger polar angles of the map when C rises; -1: "
    "to smaller ones.",
)
@click.option("--c-zero", metavar="ANGLE", help='Polar angle of the map at C = 0: "90 deg".')
@click.option(
    "--nose",
    metavar="LENGTH",
    help="Nose radius of the tool, where IN is the path of its tip (lowest point, no imaginary corner) or centre: "
    'the error is taken where it touches --form. "0 mm": IN holds points of the surface.',
)
@click.option(
    "--form",
    metavar="FORM",
    help='With --nose: nominal form about the spindle axis, "sphere: R=50 mm" (a bowl; a dome: R=-50 mm).',
)
@click.option("--tolerance", metavar="LENGTH", help='Split blocks: "2 nm" from the chord at most.')
@click.option("--resolution", metavar="LENGTH", help='Finest step that is written: "0.1 nm".')
@click.option(
    "--decimals",
    type=int,
    metavar="N",
    help="Number of digits after the point, in place of --resolution.",
)
@click.option(
    "--path-unit", type=click.Choice(["mm", "inch"]), help="Unit of a program without G20 or G21."
)
@click.option(
    "--diameter/--radius",
    "diameter",
    default=None,
    help="Meaning of X words in a program without G7 or G8.",
)
@click.option(
    "--rotary-feed",
    type=click.Choice(["linear", "all"]),
    help="With --machine: F of G94 is along the linear axes while one moves, or along all axes.",
)
@click.option(
    "--c-rollover/--c-linear",
    "c_rollover",
    default=None,
    help="Where C changes by over 180 deg in a block: the shortest way, or along its numbers.",
)
@click.option(
    "--harmless-m",
    "harmless_m",
    type=int,
    multiple=True,
    metavar="N",
    help="M code of this machine that moves nothing and changes no coordinates; may be repeated.",
)
@click.option(
    "--g-system",
    "g_system",
    type=click.Choice(["A", "B", "C", "mill"]),
    help="G codes of the control: A, B or C of lathes, or a mill; what G90, G92, G94 mean.",
)
@click.option("--again", is_flag=True, help="IN holds a correction already: add this one to it.")
@click.option(
    "--outside", type=click.Choice(["refuse", "zero", "hold"]), help="Correction beyond the map."
)
@click.option("--stroke", metavar="LENGTH", help='Largest correction: "100 um" if omitted.')
@click.option(
    "--blocks-per-s",
    type=float,
    metavar="N",
    help="Largest number of blocks per second of the control.",
)
@click.option("--points", is_flag=True, help="IN is a list of points (CSV, PVT), not G-code.")
@click.option(
    "--column",
    "columns",
    multiple=True,
    metavar="X=NAME",
    help="With --points: column by name or number from 0; may be repeated.",
)
@click.option(
    "--column-unit",
    "units",
    multiple=True,
    metavar="X=UNIT",
    help="With --points: unit of a column that its header does not state.",
)
@file_options
@click.option("--force", is_flag=True, help="Replace FILE if it exists.")
@json_option
@click.pass_context
def path(
    context: click.Context,
    /,
    program: str,
    errors: tuple[str, ...],
    machine: str | None,
    out: str,
    reading: dict[str, Any],
    points: bool,
    force: bool,
    as_json: bool,
    **options: Any,
) -> int:
    """Write IN.nc with the error MAP of the part subtracted from Z, all other words as they are.

    MAP holds actual minus nominal, heights out of the material, over the part or along X; 'metrosep form
    part.x3p --form "sphere: R=50 mm" --residual error.x3p' makes one of a part that was measured with its
    form. Turn the sense of C once on the machine before you trust it: a wrong --c-sense mirrors the
    correction.

    With --machine every axis of IN is corrected for the error terms of --error, files as for
    'machine-tables' or a folder that 'calibrate' wrote. IN is a list of positions
    (X_mm,Y_mm,Z_mm,A_deg,C_deg), or a program in words of all axes (X Y Z A C), whose blocks --tolerance
    splits.

    Exit code 1: a correction above --stroke or a block faster than --blocks-per-s. 2: a wrong
    option, or an output that cannot be written. 4: a map or program that cannot be used, with line,
    reason and way out.
    """
    if context.obj is not None:
        context.obj["words"] = _words
    if any(ord(c) < 32 for c in out):
        raise click.UsageError("the name after -o holds a line break or another control character")
    _end_cleanly()
    own = {k: options.pop(k) for k in _OF_MACHINES}
    phase(f"reading {program}")
    if machine is not None:
        return _poses(program, out, machine, errors, own, options, force=force, as_json=as_json)
    for name, value in own.items():
        if value not in (None, ()):
            raise click.UsageError(f"--{name.replace('_', '-')} goes with --machine")
    if len(errors) != 1:
        raise click.UsageError("--error names one map of a part; several go with --machine")
    phase(f"reading {errors[0]}")
    made = _correction(errors[0], reading, options)
    phase(f"correcting {program}")
    result = (
        _points(program, out, made, options, force=force)
        if points
        else _program(program, out, made, options, force=force)
    )
    if as_json:
        click.echo(json.dumps(result.audit, sort_keys=True, allow_nan=False))
        return 0
    for message in result.messages:
        say(f"note: {_words(message)}")
    _print(result)
    say(f"wrote {result.target}")
    say(f"wrote {result.sidecar}")
    if not points:  # the error of the part that is cut with it goes on top
        say_next("path", result.target, "--error", "NEW.x3p", "--again", "-o", "NEXT.nc")
    return 0


_OF_MACHINES = ("pivot_height", "tool", "zeros", "max_step", "rotary_feed")
_OF_PARTS = (
    "centre", "c_sense", "c_zero", "decimals", "c_rollover", "g_system", "outside",
    "blocks_per_s", "columns", "nose", "form",
)  # fmt: skip
_OF_PROGRAMS = ("tolerance", "path_unit", "harmless_m", "diameter", "rotary_feed")


def _poses(
    source: str,
    out: str,
    machine: str,
    errors: tuple[str, ...],
    own: dict[str, Any],
    options: dict[str, Any],
    *,
    force: bool,
    as_json: bool,
) -> int:
    """Correct a list of machine positions, or a program, for the errors of the machine."""
    from metrosep.cli.error_files import terms_of
    from metrosep.cli.machine_tables import point_of
    from metrosep.controllers.gcode.machine_programs import is_program, rewrite_machine_program
    from metrosep.controllers.gcode.poses import rewrite_poses
    from metrosep.core.numbers import quantity
    from metrosep.core.units import format_length

    for name in _OF_PARTS:
        if options[name] not in (None, ()):
            raise click.UsageError(
                f"--{name.replace('_', '-')} does not go with --machine; leave it out"
            )
    blocks = is_program(source)
    for name in ("units",) if blocks else _OF_PROGRAMS:
        if {**options, **own}[name] not in (None, ()):
            option = "column-unit" if blocks else name.replace("_", "-")
            what = "a program of G-code" if blocks else "a list of positions"
            raise click.UsageError(f"--{option} does not go with {source}, which is {what}")
    chain = chain_of(machine, {"radius": None, "pivot_height": own["pivot_height"]})
    kinds = chain.dimensions
    given: dict[str, Any] = _lengths(options, ("resolution", "stroke"))
    if own["tool"] is not None:
        given["tool"] = point_of(own["tool"])
    if own["max_step"] is not None:
        given["max_step"] = quantity(own["max_step"], "--max-step", "angle")
    if blocks:
        given |= _lengths(options, ("tolerance",))
        given |= {"unit": options["path_unit"]}
        given |= {k: options[k] for k in ("harmless_m", "diameter")}
        given["rotary_feed"] = own["rotary_feed"]
    else:
        given["units"] = dict(name_values(options["units"], "--column-unit"))
    rewrite = rewrite_machine_program if blocks else rewrite_poses
    found = rewrite(
        source,
        out,
        chain,
        terms_of(errors, kinds)[0],
        zero={
            a: quantity(v, f"--zero {a}", kinds.get(a, "length"))
            for a, v in name_values(own["zeros"], "--zero")
        },
        again=options["again"],
        overwrite=force,
        **given,
    )
    if as_json:
        click.echo(json.dumps(found.audit, sort_keys=True, allow_nan=False))
        return 0
    for message in found.messages:
        say(f"note: {_words(message)}")
    added = f", {found.audit['n_added']} blocks added" if blocks else ""
    what = "blocks of" if blocks else "of"
    say(f"{found.n_changed} {what} {found.n_points} positions changed{added}")
    say(
        f"error of the tool point, by the file: RMS {format_length(found.before, digits=4)} -> "
        f"{format_length(found.after, digits=4)}; of the tool axis {found.turn_before * 1e6:.4g} -> "
        f"{found.turn_after * 1e6:.4g} urad"
    )
    say(f"wrote {found.target}")
    say(f"wrote {found.sidecar}")
    return 0


def _end_cleanly() -> None:
    """Let SIGTERM end the command as an error does, so that nothing half-written stays."""
    import signal
    import threading

    if threading.current_thread() is threading.main_thread():
        signal.signal(signal.SIGTERM, lambda *_: sys.exit(143))


def _words(message: str) -> str:
    """Return a message with arguments written as options of the command."""
    from metrosep.cli.errors import as_options, flags_of

    for old, new in (
        ("unit='mm' (or 'inch')", "path_unit='mm' (or inch)"),
        ("diameter=True or diameter=False", "--diameter or --radius"),
        ("diameter=True", "--diameter"),
        ("rotary_feed='linear'", "--rotary-feed linear"),
        ("; 'all' if F", "; all if F"),
        ("give diameter= as", "give --diameter or --radius as"),
        ("centre=(x, y) in m", '--centre "X, Y"'),
        (
            "c_rollover=True (shortest way) or c_rollover=False",
            "--c-rollover (shortest way) or --c-linear",
        ),
        ("say c_rollover", "say --c-rollover or --c-linear"),
        ("or say again if", "or say --again if"),
        ("g_system='mill' (or 'B')", "--g-system mill (or B)"),
        ("units= says", "--column-unit says"),
        ("with units= (", "with --column-unit COLUMN=UNIT ("),
        ("columns=", "--column"),
        ("give a tolerance to split", "give a --tolerance to split"),
    ):
        message = message.replace(old, new)
    message = re.sub(r"harmless_m=\[(\d+)\]", r"--harmless-m \1", message)
    own = ("unit", "columns", "units")
    return as_options(message, {n: f for n, f in flags_of(path).items() if n not in own})


def _correction(file: str, reading: dict[str, Any], options: dict[str, Any]) -> PathCorrection:
    from metrosep.controllers.gcode.corrections import error_correction
    from metrosep.core.errors import DataError
    from metrosep.core.profile import Profile
    from metrosep.core.surface import Surface
    from metrosep.core.units import parse_quantity
    from metrosep.recipe.methods.ops_machine import form_of

    measured = read_aloud(file, reading)
    if not isinstance(measured, Surface | Profile):
        raise DataError(
            f"{file}: holds a {type(measured).__name__}; the error of a part is a map or a profile"
        )
    sense, zero = options["c_sense"], options["c_zero"]
    if isinstance(measured, Surface) and sense is None:
        say(
            "note: --c-sense is not given, +1 is taken: the tool goes to larger polar angles of the map "
            "when C rises. If C turns the part the other way, the correction is mirrored: try it on the "
            "machine, then state it"
        )
    nose = _lengths(options, ("nose",)).get("nose")
    if options["form"] is not None and not nose:
        raise click.UsageError("--form goes with --nose, the radius of the tool that touches it")
    if nose and options["form"] is None:
        raise click.UsageError(
            "Missing option '--form'; where the nose touches depends on the slope of the part, such as --form \"sphere: R=50 mm\"."
        )
    if nose is None:
        say(
            "note: --nose is not given: the error is taken at the X of each block, as for points of the surface; "
            "for the path of the tip or centre of a round nose give --nose and --form"
        )
    return error_correction(
        measured,
        nose=nose or 0.0,
        form=None if options["form"] is None else form_of(options["form"]),
        c_sense=int(sense or 1),
        c_zero=0.0 if zero is None else parse_quantity(zero, dimension="angle", name="--c-zero"),
        centre=_centre(options["centre"]),
    )


def _centre(text: str | None) -> tuple[float, float] | Literal["middle"]:
    from metrosep.core.units import parse_quantity

    if text is None:
        return (0.0, 0.0)
    if text == "middle":
        return "middle"
    parts = text.split(",")
    if len(parts) != 2:
        raise click.UsageError('--centre is middle, or two lengths: "1.2 mm, 0 mm"')
    x, y = (parse_quantity(p.strip(), dimension="length", name="--centre") for p in parts)
    return x, y


def _lengths(options: dict[str, Any], names: tuple[str, ...]) -> dict[str, Any]:
    from metrosep.core.units import parse_quantity

    return {
        name: parse_quantity(options[name], dimension="length", name=f"--{name}")
        for name in names
        if options[name] is not None
    }


def _program(
    program: str, out: str, made: PathCorrection, options: dict[str, Any], *, force: bool
) -> PathResult:
    from metrosep.controllers.gcode.paths import rewrite_path

    if options["columns"] or options["units"]:
        raise click.UsageError("--column and --column-unit need --points")
    given = {
        "decimals": options["decimals"],
        "unit": options["path_unit"],
        "diameter": options["diameter"],
        "outside": options["outside"],
        "blocks_per_s": options["blocks_per_s"],
        "c_rollover": options["c_rollover"],
        "harmless_m": options["harmless_m"] or None,
        "g_system": options["g_system"],
        "again": options["again"] or None,
    }
    lengths = _lengths(options, ("tolerance", "resolution", "stroke"))
    plain: dict[str, Any] = {k: v for k, v in given.items() if v is not None}
    return rewrite_path(program, out, made, overwrite=force, **lengths, **plain)


def _points(
    program: str, out: str, made: PathCorrection, options: dict[str, Any], *, force: bool
) -> PointResult:
    from metrosep.controllers.gcode.lists import rewrite_points

    for name in (
        "tolerance",
        "path_unit",
        "outside",
        "blocks_per_s",
        "c_rollover",
        "harmless_m",
        "g_system",
    ):
        if options[name] not in (None, ()):
            raise click.UsageError(
                f"--{name.replace('_', '-')} is for programs, not for --points; leave it out"
            )
    columns = {
        name.upper(): int(value) if value.isdecimal() else value
        for name, value in name_values(options["columns"], "--column")
    }
    units = {k.upper(): v for k, v in name_values(options["units"], "--column-unit")}
    lengths = _lengths(options, ("resolution", "stroke"))
    return rewrite_points(
        program,
        out,
        made,
        columns=columns,
        units=units,
        decimals=options["decimals"],
        diameter=bool(options["diameter"]),
        again=options["again"],
        overwrite=force,
        **lengths,
    )


def _print(result: PathResult | PointResult) -> None:
    from metrosep.core.units import format_ends, format_length

    low, high = result.correction
    audit = result.audit
    total = audit.get("n_blocks", audit.get("n_points"))
    kind = "blocks" if "n_blocks" in audit else "points"
    say(f"{result.n_changed} of {total} {kind} changed, correction {format_ends(low, high)}")
    if audit.get("n_inserted") or audit.get("n_added"):
        counts = ((audit["n_inserted"], "word"), (audit["n_added"], "block"))
        words, blocks = (f"{n} {what}{'' if n == 1 else 's'}" for n, what in counts)
        say(f"{words} inserted, {blocks} added")
    say(
        f"last digit {format_length(result.quantisation)}, read back to "
        f"{format_length(result.read_back_error, digits=2)}"
    )
