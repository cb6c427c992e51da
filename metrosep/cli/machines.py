"""Commands for whole machines: errors from readings and temperatures, predicted readings, circular tests."""

from __future__ import annotations

import functools
import itertools
import json
import math
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from metrosep.cli.options import (
    chain_of,
    force_option,
    json_option,
    machine_options,
    name_values,
    option_words,
    phase,
    preset_words,
    say,
    say_next,
    typed_line,
)
from metrosep.cli.shortcut import list_of, listed, own_recipe, quoted

if TYPE_CHECKING:
    from metrosep.machine import Chain, CircleTest
    from metrosep.recipe.result import Result

_MOST_BYTES = 2**26
_OWN_FILES = ("result.json", "calibration.json", "thermal.json", "constants.toml")
"""Of an earlier call: a folder that holds one is not written into without --force."""

_A_SET = """\b
A SET, readings of an R-test:
  # instrument = "nest"
  # ball = "65 mm, -20 mm, 50 mm"
  # unknown = ["ball"]
  X_mm,Y_mm,Z_mm,A_deg,C_deg,reading_x_um,reading_y_um,reading_z_um
  65,-130,-20,-90,0,-26.1,-29.0,35.0
"""


@click.command(epilog=_A_SET)
@click.argument("machine")
@click.argument("sets", nargs=-1, metavar="SET...")
@click.option(
    "--candidate",
    "candidates",
    multiple=True,
    metavar="SET",
    help="Set-up that could be read next, a SET without readings: instead of terms, list by which of them the "
    "error of the tool point becomes known best.",
)
@click.option(
    "--degree",
    "degrees",
    multiple=True,
    metavar="AXIS=N",
    help='Highest order of the curves of an axis or a term, "X=5"; 3 (harmonics: 2) if omitted.',
)
@click.option(
    "--terms", metavar="TERM,...", help="Error terms that may be at work; all if omitted."
)
@click.option(
    "--home",
    "homes",
    multiple=True,
    metavar="AXIS=PLACE",
    help='Position where the errors of an axis are zero, "X=0 mm".',
)
@click.option("--all-readings", is_flag=True, help="Keep readings that contradict the others.")
@click.option(
    "--smallest",
    is_flag=True,
    help="Write undetermined terms too: the smallest that explain the readings.",
)
@machine_options
@click.option(
    "-o", "--out", metavar="DIR", help="Folder for the terms, calibration.json, report and result."
)
@click.option("--print-recipe", is_flag=True, help="Print the recipe of this call and stop.")
@force_option
@json_option
@click.pass_context
def calibrate(
    context: click.Context,
    /,
    machine: str,
    sets: tuple[str, ...],
    candidates: tuple[str, ...],
    out: str | None,
    force: bool,
    print_recipe: bool,
    as_json: bool,
    **options: Any,
) -> int:
    """Find the error terms of MACHINE from readings of instruments, one file for each set-up.

    MACHINE is a preset or a TOML file, as for 'rank'. A SET is text: its set-up in comment lines, then the
    positions of the axes (X_mm, A_deg) and the readings (reading_um, reading_x_um ...) in the order of time.

    Instruments: displacement (indicator, linear laser), angle (level, autocollimator), ballbar, nest (R-test,
    touch probe on a ball), length (tracker); docs/explanation/machine-calibration.md lists what each reads.
    Terms that the readings cannot distinguish are named. With -o the terms are written as 'machine-tables'
    takes them.
    """
    degrees = {k: _count(v, k) for k, v in name_values(options["degrees"], "--degree")}
    if candidates:
        kept = {
            "-o": out,
            "--print-recipe": print_recipe,
            "--force": force,
            "--home": options["homes"],
        }
        kept |= {"--all-readings": options["all_readings"], "--smallest": options["smallest"]}
        for name, given in kept.items():
            if given:
                raise click.UsageError(
                    f"--candidate lists set-ups and finds no terms: take {name} out"
                )
        return _planned(
            chain_of(machine, options), sets, candidates, degrees, options["terms"], as_json
        )
    if not sets:
        raise click.UsageError("Missing argument 'SET...': a file for each set-up that was read")
    lines = ["metrosep = 1", "", "[input]", f"files = {list_of(sets)}", "", "[[step]]"]
    lines += ['op = "calibrate"', f"machine = {quoted(machine)}"]
    if context.obj is not None:
        context.obj["words"] = functools.partial(option_words, keys=("pivot_height",))
    if options["radius"] is not None:
        lines.append(f"machine_radius = {quoted(options['radius'])}")
    if options["pivot_height"] is not None:
        lines.append(f"pivot_height = {quoted(options['pivot_height'])}")
    if options["terms"] is not None:
        lines.append(f"terms = {listed(options['terms'])}")
    if degrees:
        lines.append(f"degrees = {{ {', '.join(f'{k} = {v}' for k, v in degrees.items())} }}")
    homes = name_values(options["homes"], "--home")
    if homes:
        lines.append(f"home = {{ {', '.join(f'{k} = {quoted(v)}' for k, v in homes)} }}")
    lines += [f"{k} = true" for k in ("all_readings", "smallest") if options[k]]
    result = _run(context, lines, sets, out, print_recipe=print_recipe, force=force)
    if result is None:
        return 0
    if as_json:
        document = {**result.produced.found.to_dict(), "files": [str(f) for f in result.files]}
        click.echo(json.dumps(document, sort_keys=True, allow_nan=False))
        return 0
    click.echo(result.produced.found.report())
    for file in result.files:
        say(f"wrote {file}")
    if out is not None:
        found = [*result.produced.found.sets.values()]
        where, why = _where_it_was_read(chain_of(machine, options), out, found)
        line = [machine, out, *preset_words(options), *where]
        if not why:
            say_next("machine-tables", *line, "-o", "tables")
        else:
            typed = f", {typed_line('machine-tables', *line, '--tool', _EXAMPLE, '-o', 'tables')}"
            say(f"note: {why}{typed if where else ''}")
    return 0


_STEPS = 10
"""Of the first table that is proposed, along its travel; up to three times as many to make its zero a node."""

_EXAMPLE = "0 mm,0 mm,-150 mm"
_ARM = 0.1
"""m: whether an error acts at all, where the tool point is elsewhere."""


def _where_it_was_read(chain: Chain, out: str, sets: Sequence[Any]) -> tuple[list[str], str]:
    """Return the options of tables over axes along which the errors change, those that were read first.

    The axes that turn and have errors come first, then the linear ones. Where no table takes anything off at the
    places and tool points that were read, the second is why; there are options still where a longer tool would.
    """
    import numpy as np

    from metrosep.cli.error_files import terms_of
    from metrosep.compensation.from_machine import moves_somewhere
    from metrosep.machine.elements import term_unit

    kinds = chain.dimensions
    terms, known = terms_of((out,), kinds)
    if not terms.values:
        return [], (
            "the readings determine no term, so there is nothing for a table: read more set-ups, or name the terms "
            "that are at work with --terms"
        )

    def typed(value: float, axis: str) -> str:
        return (
            f"{math.degrees(value):.6g} deg" if kinds[axis] == "angle" else f"{1e3 * value:.6g} mm"
        )

    moving = [e for e in chain.elements if e.kind != "fixed" and not e.parked]
    names = [e.name for e in sorted(moving, key=lambda e: (e.kind == "rotary", e.name))]
    stood = {a: _stood([s.q for s in sets], a) for a in names}
    span = {e.name: known.get(e.name) or _range_read(e, stood[e.name]) for e in moving}
    ends = {a: known.get(a) or (float(v[0]), float(v[-1])) for a, v in stood.items()}
    read = [a for a in names if any(str(term).endswith(a) for term in terms.values)]
    usual = [a for a in read if kinds[a] == "angle"][:2] or (read or names)[:1]
    turning = [a for a in names if kinds[a] == "angle"][:2]
    moved = [a for a in names if a in known or stood[a].size > 1]
    tried = [over for over in (usual, turning, *([a] for a in moved)) if over]
    steps = {a: _steps_through_zero(*span[a]) for a in names}
    # first where the others are nearest to their zero, then at the ends of what was read
    places = [{a: min(max(0.0, ends[a][0]), ends[a][1]) for a in names}]
    places += [p for k in (0, 1) if (p := {a: ends[a][k] for a in names}) not in places]
    tools = dict.fromkeys(
        ((0.0, 0.0, 0.0), *(tuple(map(float, t)) for s in sets for t in _rows(s.tool)))
    )
    arms = [tuple(_ARM * v for v in row) for row in np.eye(3)]
    for tool, place, over in itertools.product((*tools, *arms), places, tried):
        positions = {a: np.linspace(*span[a], steps[a] + 1) for a in over}
        at = {a: v for a, v in place.items() if a not in over}
        if moves_somewhere(chain, terms, positions, at, tool):
            break
    else:
        return [], (
            "no table is needed: over each axis these errors shift the tool point by the same everywhere, which is "
            "an offset of the axes in the control"
        )
    spacing = [f"{a}={typed((span[a][1] - span[a][0]) / steps[a], a)}" for a in over]
    words = ["--over", ",".join(over), "--spacing", ",".join(spacing)]
    for axis in (a for a in over if a not in known):
        low, high = span[axis]
        words += ["--span", f"{axis}={typed(low, axis)}..{typed(high, axis)}"]
    for axis, value in at.items():
        words += ["--at", f"{axis}={typed(value, axis)}"]
    if tool not in tools:
        angles = [str(t) for t in terms.values if term_unit(chain, str(t)) == "rad"]
        return words, (
            "at the places and the tool points that were read no table takes anything off; "
            f"{', '.join(angles)} acts through the arm from the axis to the tool point: state where the axes and "
            "the tool are in the work"
        )
    if any(tool):
        words += ["--tool", ",".join(f"{1e3 * v:.6g} mm" for v in tool)]
    return words, ""


def _rows(tool: Any) -> Any:
    """Return the tool points of a set-up as rows."""
    import numpy as np

    return np.reshape(np.asarray(tool, dtype=np.float64), (-1, 3))


def _stood(poses: Sequence[Mapping[str, Any]], axis: str) -> Any:
    """Return the places at which an axis stood, rising; 0 of one that none of the set-ups names."""
    import numpy as np

    listed = [np.ravel(np.asarray(q[axis])) for q in poses if axis in q]
    return np.unique(np.round(np.concatenate(listed), 9)) if listed else np.zeros(1)


def _range_read(element: Any, at: Any) -> tuple[float, float]:
    """Return the range in which an axis stood, a whole turn within its travel where its places go round."""
    low, high = float(at[0]), float(at[-1])
    turn = 2.0 * math.pi
    lowest, highest = (-math.inf, math.inf) if element.travel is None else element.travel
    wanted = [(low, high)] if high > low else []
    if element.kind == "rotary" and (
        high == low or (high - low) * at.size / (at.size - 1) > turn - 1e-6
    ):
        wanted = [(0.0, turn), (low, low + turn), (high - turn, high), *wanted]
    elif not wanted:
        wanted = [(0.0, 0.4)]
    inside = [s for s in wanted if lowest - 1e-9 <= s[0] and s[1] <= highest + 1e-9]
    return inside[0] if inside else (float(lowest), float(highest))


def _steps_through_zero(low: float, high: float) -> int:
    """Return how many equal steps a table has that make 0 a node, where it lies within."""
    counts = range(_STEPS, 3 * _STEPS + 1)
    nodes = ((n, -low * n / (high - low)) for n in counts)
    whole = [n for n, k in nodes if abs(k - round(k)) < 1e-6]
    return whole[0] if low < 0.0 < high and whole else _STEPS


_PLACES = 5
"""Of each axis, in the volume for which set-ups are planned."""


def _planned(
    chain: Chain,
    done: tuple[str, ...],
    candidates: tuple[str, ...],
    degrees: Mapping[str, int],
    terms: str | None,
    as_json: bool,
) -> int:
    """Print the candidates in the order in which each adds most, over the box and the tools of all sets."""
    import numpy as np

    from metrosep.core.units import format_length
    from metrosep.io.reading_sets import read_reading_set
    from metrosep.machine import plan_calibration

    possible = [read_reading_set(f, chain, needs_readings=False) for f in candidates]
    have = [read_reading_set(f, chain) for f in done]
    every = [*possible, *have]
    box = {
        a: np.linspace(
            min(np.min(s.q[a]) for s in every), max(np.max(s.q[a]) for s in every), _PLACES
        )
        for a in every[0].q
    }
    grid = np.meshgrid(*box.values(), indexing="ij")
    tools = sorted({tuple(map(float, np.ravel(s.tool)[:3])) for s in every})
    found = plan_calibration(
        chain,
        possible,
        volume={a: g.ravel() for a, g in zip(box, grid, strict=True)},
        tools=tools,
        degrees=degrees or None,
        terms=None if terms is None else [t.strip() for t in terms.split(",") if t.strip()],
        done=have,
    )
    if as_json:
        listed = [{"set": name, "u_rms_m": u} for name, u in found]
        click.echo(json.dumps({"plan": listed}, allow_nan=False))
        return 0
    for i, (name, u) in enumerate(found, 1):
        click.echo(f"{i}  {name:24s} u of the error {format_length(u)} RMS once it is read too")
    say(
        f"over {_PLACES} places of each axis, {', '.join(box)}, between the ends that the sets reach, and "
        f"{len(tools)} tool points; white noise, u of the sets or 0.1 um"
    )
    return 0


@click.command()
@click.argument("machine")
@click.argument("file", metavar="SET")
@click.argument("errors", nargs=-1, required=True, metavar="ERRORS...")
@click.option("--exact", is_flag=True, help="True rotations and lengths, not first order.")
@machine_options
@json_option
def read(
    machine: str, file: str, errors: tuple[str, ...], exact: bool, as_json: bool, **options: Any
) -> int:
    """Print what the instrument of SET reads on MACHINE with given ERRORS, place by place.

    ERRORS are files as for 'machine-tables', such as those that 'calibrate' writes. Where SET holds
    readings, what is left of them is printed beside.
    """
    import numpy as np

    from metrosep.cli.error_files import terms_of
    from metrosep.io.reading_sets import read_reading_set

    chain = chain_of(machine, options)
    given = read_reading_set(file, chain, needs_readings=False)
    kinds = chain.dimensions
    terms, _ = terms_of(errors, kinds)
    found = chain.read(given.instrument, given.q, terms, tool=given.tool, exact=exact)
    rows = np.atleast_2d(found.T).T * 1e6
    left = np.asarray(given.values) * 1e6 - rows
    unit = "urad" if given.instrument.is_angle else "um"
    has_readings = bool(np.any(np.nan_to_num(np.asarray(given.values))))
    if has_readings and given.unknown:
        say(
            f"note: what is left still holds what {file} calls unknown ({', '.join(given.unknown)}); 'metrosep calibrate' "
            "finds that with the terms, and its report shows the residuals without it"
        )
    if as_json:
        document = {f"reading_{unit}": rows.tolist()}
        if has_readings:
            document[f"left_{unit}"] = [
                [None if np.isnan(v) else v for v in r] for r in left.tolist()
            ]
        click.echo(json.dumps(document, allow_nan=False))
        return 0
    names = ["reading"] if rows.shape[1] == 1 else [f"reading_{d}" for d in "xyz"]
    more = [n.replace("reading", "left") for n in names] if has_readings else []
    click.echo(",".join(f"{n}_{unit}" for n in (*names, *more)))
    for row, rest in zip(rows, left, strict=True):
        values = (*row, *rest) if has_readings else tuple(row)
        click.echo(",".join("" if np.isnan(v) else f"{v:.6f}" for v in values))
    return 0


@click.command()
@click.argument("files", nargs=-1, required=True, metavar="FILE...")
@click.option("--radius", required=True, metavar="LENGTH", help='Programmed radius, "150 mm".')
@click.option(
    "--feed", required=True, metavar="SPEED", help='Feedrate along the circle, "1000 mm/min".'
)
@click.option("--angle", metavar="COLUMN", help="Column of the angle of the place.")
@click.option(
    "--ccw", metavar="COLUMN", help="Column of the deviation of the radius, angle rising."
)
@click.option(
    "--cw", metavar="COLUMN", help="Column of the deviation of the radius, angle falling."
)
@click.option(
    "--x",
    metavar="COLUMN",
    help="Column of a log with the position of the first axis of the plane.",
)
@click.option(
    "--y", metavar="COLUMN", help="Column of a log with the position of the second axis."
)
@click.option(
    "--reading", metavar="COLUMN", help="Deviation of the radius, both senses one after the other."
)
@click.option("--length", metavar="COLUMN", help="The same as the whole length of the bar.")
@click.option(
    "--plane",
    type=click.Choice(["XY", "YZ", "ZX", "XZ"]),
    default="XY",
    show_default=True,
    help="First and second axis; the angle runs from the first to the second.",
)
@click.option("--uncalibrated", is_flag=True, help="The length of the bar is not known.")
@click.option("--figure", metavar="FILE", help="Polar picture of both runs, PNG or SVG.")
@click.option("-o", "--out", metavar="DIR", help="Folder for report, table and result.json.")
@click.option("--print-recipe", is_flag=True, help="Print the recipe of this call and stop.")
@force_option
@json_option
@click.pass_context
def circle(
    context: click.Context,
    /,
    files: tuple[str, ...],
    figure: str | None,
    out: str | None,
    print_recipe: bool,
    force: bool,
    as_json: bool,
    **options: Any,
) -> int:
    """Evaluate a circular test (ballbar) after ISO 230-4: G, F, D, and their causes.

    FILE holds a column with the angle of the place and one or two with the deviation of the radius,
    such as angle_deg,ccw_um,cw_um; or a log of positions x_mm,y_mm with the reading of a bar, or alone.
    Columns are found by their names where no option names them; "2:mm" is the second of a log without
    header (LinuxCNC's halsampler). Both senses are needed to distinguish squareness from servo mismatch.
    """
    lines = ["metrosep = 1", "", "[input]", f"files = {list_of(files)}"]
    columns = ("angle", "ccw", "cw", "x", "y", "reading", "length")
    lines += [f"{k} = {quoted(options[k])}" for k in columns if options[k] is not None]
    lines += ["", "[[step]]", 'op = "circle"']
    lines += [f"{k} = {quoted(options[k])}" for k in ("radius", "feed", "plane")]
    lines += ["uncalibrated = true"] if options["uncalibrated"] else []
    result = _run(context, lines, files, out, print_recipe=print_recipe, force=force)
    if result is None:
        return 0
    test = result.produced.test
    if figure is not None:
        _draw(test, figure)
    if as_json:
        document = {**test.to_dict(), "files": [str(f) for f in result.files]}
        click.echo(json.dumps(document, sort_keys=True, allow_nan=False))
        return 0
    click.echo(test.report())
    for text in result.produced.notes:
        say(f"note: {text}")
    for file in (*result.files, *([figure] if figure is not None else [])):
        say(f"wrote {file}")
    return 0


@click.command()
@click.argument("files", nargs=-1, required=True, metavar="FILE...")
@click.option("--time", "time_", metavar="COLUMN", help="Time: t_s.")
@click.option(
    "--temperature",
    "temperatures",
    metavar="COLUMN,...",
    help="Temperatures by sensor: nose_degC,column_degC.",
)
@click.option("--reading", metavar="COLUMN,...", help="Displacements: EXX_um,EZZ_um.")
@click.option("--tilt", metavar="COLUMN,...", help="Angles: EBX_urad.")
@click.option(
    "--term",
    "terms",
    multiple=True,
    metavar="READING=TERM",
    help='Which error a reading is: "EZ0C=EZZ", "near=EXX at 50 mm"; may be repeated.',
)
@click.option("--lags", metavar="TIME,...", help='Time constants to try: "10 min,1 h".')
@click.option(
    "--blocks",
    type=int,
    metavar="N",
    help="Number of blocks of time; each is predicted from the others.",
)
@click.option("--most", type=int, metavar="N", help="Largest number of sensors of a reading.")
@click.option(
    "--reference",
    "references",
    multiple=True,
    metavar="SENSOR=TEMPERATURE",
    help='Where errors are zero, "nose=20 degC"; the beginning of the record if omitted.',
)
@click.option(
    "--at",
    "stated",
    multiple=True,
    metavar="SENSOR=TEMPERATURE",
    help='Print and write the errors at settled temperatures, "nose=31 degC"; may be repeated.',
)
@click.option(
    "--history",
    metavar="FILE",
    help="FILE... is thermal.json of such a call: the errors at the end of this log of temperatures.",
)
@click.option(
    "-o", "--out", metavar="DIR", help="Folder for thermal.json, the errors, report and result."
)
@click.option("--print-recipe", is_flag=True, help="Print the recipe of this call and stop.")
@force_option
@json_option
@click.pass_context
def thermal(
    context: click.Context,
    /,
    files: tuple[str, ...],
    out: str | None,
    force: bool,
    print_recipe: bool,
    as_json: bool,
    **options: Any,
) -> int:
    """Errors of a machine as functions of temperatures, from a record of both (ISO 230-3).

    FILE holds time, temperatures and readings of a nest or of probes. Which sensors matter, and how far
    the machine lags behind them, is decided by predicting blocks of time from the others. With --at the
    errors at stated temperatures are written as 'machine-tables' and 'read' take them. A FILE that is
    the thermal.json of an earlier call is used as it is, with --at or --history.
    """
    if len(files) == 1 and files[0].endswith(".json"):
        return _thermal_again(files[0], out, options, force=force, as_json=as_json)
    if options["history"] is not None:
        raise click.UsageError("--history needs the thermal.json of an earlier call as FILE")
    lines = ["metrosep = 1", "", "[input]", f"files = {list_of(files)}"]
    roles = {"temperatures": "temperatures", "readings": "reading", "tilts": "tilt"}
    for option, given in (
        ("--time", options["time_"]),
        ("--temperature", options["temperatures"]),
    ):
        if given is None:
            raise click.UsageError(f"Missing option '{option}'.")
    lines.append(f"time = {quoted(options['time_'])}")
    lines += [f"{k} = {listed(options[v])}" for k, v in roles.items() if options[v]]
    lines += ["", "[[step]]", 'op = "thermal"']
    for key in ("terms", "reference", "at"):
        option = {"terms": "--term", "reference": "--reference", "at": "--at"}[key]
        given = {"terms": "terms", "reference": "references", "at": "stated"}[key]
        pairs = name_values(options[given], option)
        if pairs:
            inner = ", ".join(f"{quoted(k)} = {quoted(v)}" for k, v in pairs)
            lines.append(f"{key} = {{ {inner} }}")
    if options["lags"]:
        lines.append(f"lags = {listed(options['lags'])}")
    lines += [f"{k} = {options[k]}" for k in ("blocks", "most") if options[k] is not None]
    result = _run(context, lines, files, out, print_recipe=print_recipe, force=force)
    if result is None:
        return 0
    if as_json:
        document = {
            **result.produced.fit.to_dict(),
            "errors": _values_of(result.produced.errors),
            "files": [str(f) for f in result.files],
        }
        click.echo(json.dumps(document, sort_keys=True, allow_nan=False))
        return 0
    click.echo(result.produced.fit.report())
    _print_errors(result.produced.errors)
    for file in result.files:
        say(f"wrote {file}")
    return 0


def _thermal_again(
    file: str, out: str | None, options: dict[str, Any], *, force: bool, as_json: bool
) -> int:
    """Print and write the errors of a stored fit at stated temperatures, or at the end of a log."""
    from metrosep.core.atomic import read_plain
    from metrosep.core.errors import DataError, ReadError
    from metrosep.core.numbers import quantity
    from metrosep.machine import ThermalFit

    try:
        document = json.loads(read_plain(Path(file), _MOST_BYTES).decode("utf-8"))
    except OSError as exc:
        raise ReadError(f"{file}: cannot be read ({exc.strerror or exc})") from None
    except ValueError as exc:
        raise DataError(
            f"{file} is not the thermal.json that 'metrosep thermal -o' writes ({exc})"
        ) from None
    fit = ThermalFit.from_dict(document if isinstance(document, dict) else {})
    pairs = name_values(options["stated"], "--at")
    if bool(pairs) == (options["history"] is not None):
        raise click.UsageError(
            f"{file} is a stored fit: give the temperatures with --at, or a log of them with --history"
        )
    if pairs:
        at = {k: quantity(v, f"--at {k}", "temperature") for k, v in pairs}
        errors = fit.errors(at)
    else:
        errors = fit.errors(*_history(options))
    written = _errors_written(errors, Path(out), force=force) if out is not None else []
    if as_json:
        found = {"errors": _values_of(errors), "files": [str(f) for f in written]}
        click.echo(json.dumps(found, sort_keys=True, allow_nan=False))
        return 0
    _print_errors(errors)
    for path in written:
        say(f"wrote {path}")
    return 0


def _history(options: dict[str, Any]) -> tuple[dict[str, Any], Any]:
    """Return temperatures by sensor, and times, of a log."""
    from metrosep.io.role_columns import Role, read_roles

    if options["time_"] is None or options["temperatures"] is None:
        raise click.UsageError("--history needs --time and --temperature to name its columns")
    columns: Any = list(_listed(options["temperatures"]))
    log = read_roles(
        options["history"],
        {
            "time": Role(options["time_"], "time"),
            "temperatures": Role(columns, "temperature"),
        },
    )
    names = log.columns["temperatures"]
    return dict(zip(names, log.values["temperatures"], strict=True)), log.values["time"]


def _values_of(errors: Any) -> dict[str, Any] | None:
    """Return values of errors for JSON, units beside them."""
    from metrosep.machine.terms import TableTerm, is_angle

    if errors is None:
        return None
    found = {}
    for name, term in errors.terms.items():
        table = isinstance(term, TableTerm)
        found[name] = {
            "unit": "rad" if is_angle(name) else "m",
            "value": list(term.values) if table else term.value,
            "u": list(term.u) if table else term.u,
            **({"positions": list(term.positions)} if table else {}),
        }
    return found


def _print_errors(errors: Any) -> None:
    from metrosep.core.units import format_engineering

    for name, found in (_values_of(errors) or {}).items():
        places = found.get("positions", [None])
        values, us = (v if isinstance(v, list) else [v] for v in (found["value"], found["u"]))
        for place, value, u in zip(places, values, us, strict=True):
            where = "" if place is None else f" at {place * 1e3:g} mm"
            size = format_engineering(value, found["unit"])
            spread = format_engineering(u, found["unit"], digits=2)
            click.echo(f"{name:8s} {size}{where} (u = {spread})")


def _errors_written(errors: Any, folder: Path, *, force: bool) -> list[Path]:
    from metrosep.core.atomic import atomic_write
    from metrosep.io.term_files import table_texts

    texts = table_texts(errors.terms)
    _refuse_standing(folder, list(texts), force=force)
    folder.mkdir(parents=True, exist_ok=True)
    for name, text in texts.items():
        atomic_write(folder / name, text.encode("utf-8"))
    return [folder / n for n in texts]


def _refuse_standing(folder: Path, names: list[str], *, force: bool) -> None:
    from metrosep.core.errors import WriteError

    standing = [folder / n for n in names if (folder / n).exists()]
    if standing and not force:
        raise WriteError(f"{standing[0]} exists; give --force to replace the files of {folder}")


def _run(
    context: click.Context,
    lines: list[str],
    files: tuple[str, ...],
    out: str | None,
    *,
    print_recipe: bool,
    force: bool,
) -> Result | None:
    """Carry out the recipe of a call; None where it was only printed."""
    if out is not None and not print_recipe:
        _refuse_standing(Path(out), list(_OWN_FILES), force=force)
    report = out is not None or print_recipe
    recipe = own_recipe(context, lines, report=report, print_recipe=print_recipe)
    return None if recipe is None else recipe.run(list(files), out=out, progress=phase)


def _draw(test: CircleTest, file: str) -> None:
    """Write the polar picture; the suffix says in which format."""
    import io

    from metrosep.core.atomic import atomic_write
    from metrosep.plot.polar import circle_chart
    from metrosep.plot.style import new_figure

    kind = Path(file).suffix.lower().lstrip(".")
    if kind not in ("png", "svg"):
        raise click.UsageError(
            f"--figure {file}: PNG or SVG is written, by the suffix of the name"
        )
    data = io.BytesIO()
    drawn = new_figure((6.4, 6.9))
    circle_chart(test, drawn.add_subplot())
    drawn.savefig(data, format=kind, metadata={"Date": None} if kind == "svg" else None)
    atomic_write(file, data.getvalue())


def _listed(text: str) -> tuple[str, ...]:
    return tuple(v.strip() for v in text.split(",") if v.strip())


def _count(text: str, key: str) -> int:
    if not text.strip().isdecimal():
        raise click.UsageError(f"--degree {key}={text}: a whole number is needed")
    return int(text)
