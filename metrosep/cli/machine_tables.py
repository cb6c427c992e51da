"""The command that makes tables of the errors of a whole machine: machine-tables."""

from __future__ import annotations

import json
import tempfile
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from metrosep.cli.error_files import terms_of
from metrosep.cli.options import (
    F,
    chain_of,
    force_option,
    json_option,
    lacking_facts,
    machine_options,
    missing_options,
    name_values,
    phase,
    preset_words,
    say,
    say_next,
    tool_option,
)

if TYPE_CHECKING:
    from metrosep.compensation.volumes import MachineVolume
    from metrosep.controllers.base import Prepared
    from metrosep.machine.chains import Chain

_MOST_BYTES = 2**26
_PICOMETRE = 1e-12
_VOLUME = (
    "no controller here holds corrections over three axes: take --format of one that holds tables of one "
    "axis, where the control adds them up (one file for each looked-up and corrected axis), or --format "
    "grid for a neutral list (x, y, z, cx, cy, cz)"
)


def _where(command: F) -> F:
    """Add the options that say where the axes and the tool are."""
    for option in (
        tool_option,
        click.option(
            "--span",
            "spans",
            multiple=True,
            metavar="AXIS=A..B",
            help='Travel of a looked-up axis, "X=0 mm..400 mm"; as far as its errors are known if omitted.',
        ),
        click.option(
            "--at",
            "places",
            multiple=True,
            metavar="AXIS=PLACE",
            help='Position of another axis: "Z=0 mm".',
        ),
    ):
        command = option(command)
    return command


@click.command("machine-tables")
@click.argument("machine")
@click.argument("errors", nargs=-1, required=True, metavar="ERRORS...")
@click.option(
    "--over", required=True, metavar="AXIS,...", help='Looked-up axes: "X", "X,Y", "X,Y,Z".'
)
@click.option(
    "--spacing",
    required=True,
    metavar="LENGTH",
    help='Distance of the entries, "10 mm"; or "X=10 mm,Y=5 mm".',
)
@click.option(
    "--corrects", metavar="AXIS,...", help="Axes to correct; all linear ones if omitted."
)
@click.option(
    "--reference", metavar="PLACE,...", help="Place of zero correction, of each axis in --over."
)
@_where
@machine_options
@click.option(
    "--format",
    "format_",
    default=None,
    metavar="NAME",
    help="Controller, or grid; csv or csv-map if omitted.",
)
@click.option(
    "--machine",
    "facts",
    multiple=True,
    metavar="NAME=VALUE",
    help="Machine setting or limit; x-z.NAME=VALUE for one file alone. May be repeated.",
)
@click.option(
    "--waive",
    multiple=True,
    metavar="CHECK",
    help="Ignore the named check. The result records it.",
)
@click.option("--sign-confirmed", is_flag=True, help="The sign was tried on this machine.")
@click.option("-o", "--out", required=True, metavar="FOLDER", help="Folder for the files.")
@force_option
@json_option
def machine_tables(
    machine: str, errors: tuple[str, ...], out: str, force: bool, as_json: bool, **options: Any
) -> int:
    """Write the tables that cancel the ERRORS of MACHINE at the tool point, one file for each axis.

    MACHINE is a preset or a TOML file, as for 'rank'. ERRORS are CSV files with a position and the terms
    of one axis (x_mm,EXX_um,EBX_urad), and TOML files with constants (B0Z = "2 urad") or results of
    'separate' (EZX = "folder/result.json"). Every file is judged by itself and all of them together, by
    the error of the tool point with what their controllers add. Three axes: one table for each looked-up
    and corrected axis, for controls that add tables up, or --format grid.

    Exit code 1: the error of the tool point does not shrink, or a table is refused. Nothing is written
    then.
    """
    from metrosep.controllers.registry import find

    chain = chain_of(machine, options)
    over = _names(options["over"], "--over", 3)
    holds = {1: "table", 2: "map", 3: "table"}[len(over)]
    name = options["format_"] or {1: "csv", 2: "csv-map", 3: "csv"}[len(over)]
    grid = name == "grid"
    if grid and len(over) != 3:
        raise click.UsageError(
            f"--format grid holds three axes, --over names {len(over)}: take csv or csv-map"
        )
    turning = [e.name for e in chain.elements if e.kind == "rotary" and e.name in over]
    if grid and turning:
        raise click.UsageError(
            f"--format grid is over three linear axes, and {turning[0]} turns: take tables, without --format"
        )
    if not grid and find(name).info.carries != holds:
        what = "a table of one axis" if holds == "table" else "a map over two axes"
        raise click.UsageError(
            f"--format {name} holds a {find(name).info.carries}, and {what} is needed over {', '.join(over)}"
            + (f"; {_VOLUME}" if len(over) == 3 else "")
        )
    kinds = chain.dimensions
    at = _places(options["places"], kinds)
    steps = _steps(over, kinds, options["spacing"])
    terms, known = terms_of(errors, kinds)
    corrects = (
        None if options["corrects"] is None else _names(options["corrects"], "--corrects", None)
    )
    lacking = {} if grid else _lacking(chain, name, over, corrects, terms.names, at, options)
    _require_said(chain, over, at, lacking, known, options)
    common: dict[str, Any] = {
        "over": over,
        "positions": _positions(steps, _spans(over, kinds, known, options)),
        "at": at,
        "corrects": corrects,
        "reference": _reference(options["reference"], over, kinds),
    }
    if options["tool"] is not None:
        common["tool"] = point_of(options["tool"])
    folder = Path(out)
    carry_out = _volume if len(over) == 3 else _tables
    phase(f"making the tables over {', '.join(over)}")
    found = carry_out(chain, terms, common, name, folder, options, force=force)
    if as_json:
        click.echo(json.dumps(found, sort_keys=True, allow_nan=False))
    else:  # what stays is read in another place, with the tables active
        own = preset_words(options)
        say_next("calibrate", machine, "NEW.csv", *own)
    return 0


def _lacking(
    chain: Chain,
    controller: str,
    over: Sequence[str],
    corrects: Sequence[str] | None,
    names: Sequence[str],
    at: Mapping[str, float],
    options: Mapping[str, Any],
) -> dict[str, str]:
    """Return the facts of a controller that no option states: what names the corrected axis, of each file."""
    from metrosep.compensation._machine_errors import axes_moved
    from metrosep.controllers.options import APART

    found = lacking_facts(controller, options["facts"])
    axes = corrects or [e.name for e in chain.elements if e.kind == "linear" and not e.parked]
    if not found or len(over) > 2 or len(axes) < 2:
        return found
    tool = (0.0, 0.0, 0.0) if options["tool"] is None else point_of(options["tool"])
    moved = axes_moved(chain, names, axes, over=over, at=at, tool=tool)
    axes = [a for a in axes if a in moved] or axes
    each = {f"machine {name}=..." for name in APART["compensates"]}
    return {
        option.replace("machine ", f"machine {'-'.join((*over, axis)).lower()}.")
        if axis
        else option: text
        for option, text in found.items()
        for axis in (axes if option in each else ("",))
    }


def _require_said(
    chain: Chain,
    over: Sequence[str],
    at: Mapping[str, float],
    lacking: Mapping[str, str],
    known: Mapping[str, tuple[float, float]],
    options: Mapping[str, Any],
) -> None:
    """Refuse a call that leaves a travel, a place or a fact of the controller open, all at once."""
    kinds = chain.dimensions
    stated = {axis for axis, _ in name_values(options["spans"], "--span")}
    missing = [*lacking]
    unknown = [a for a in over if a in kinds and a not in stated and a not in known]
    missing += [f"span {_travel_of(axis, kinds)}" for axis in unknown]
    for e in sorted(chain.elements, key=lambda e: (e.kind == "rotary", e.name)):
        if e.kind != "fixed" and not e.parked and e.name not in (*over, *at):
            missing.append(f'at "{e.name}=0 {"deg" if e.kind == "rotary" else "mm"}"')
    if missing:
        why = f"no error of {' or '.join(unknown)} says how far it goes" if unknown else ""
        raise missing_options(missing, None, *dict.fromkeys(lacking.values()), why)


@click.command()
@click.argument("machine")
@click.argument("errors", nargs=-1, required=True, metavar="ERRORS...")
@click.option(
    "--tolerance",
    required=True,
    metavar="LENGTH",
    help='What may stay between the nodes in each direction, "0.2 um".',
)
@click.option(
    "--over", metavar="AXIS,...", help="Three looked-up axes; the linear ones if omitted."
)
@_where
@click.option(
    "--verify",
    "proof",
    metavar="SET",
    help="Readings taken with the corrections active, a file as for 'calibrate'.",
)
@machine_options
@click.option("-o", "--out", metavar="FOLDER", help="Folder for the grid (x, y, z, cx, cy, cz).")
@force_option
@json_option
def volume(
    machine: str,
    errors: tuple[str, ...],
    out: str | None,
    force: bool,
    as_json: bool,
    **options: Any,
) -> int:
    """Volumetric error of MACHINE over its travel, and the coarsest grid that corrects it.

    MACHINE and ERRORS are as for 'machine-tables'; a folder that 'calibrate' wrote stands for its
    files. The grid is judged at places off its nodes, and at other tool points; with --verify also
    by readings that were taken on the machine with it.

    Exit code 1: the error does not shrink; nothing is written.
    """
    from metrosep.compensation.from_machine import volume_from_machine
    from metrosep.compensation.volumes import volume_positions
    from metrosep.core.errors import DataError
    from metrosep.core.numbers import quantity

    chain = chain_of(machine, options)
    kinds = chain.dimensions
    terms, known = terms_of(errors, kinds)
    linear = sorted(e.name for e in chain.elements if e.kind == "linear" and not e.parked)
    over = _names(options["over"] or ",".join(linear), "--over", 3)
    if len(over) != 3 or not set(over) <= set(linear):
        raise click.UsageError(
            f"--over names three linear axes; {machine} has {', '.join(linear)}"
        )
    if out is not None and options["proof"] is not None:
        raise click.UsageError("--verify judges corrections that are active already: leave -o out")
    readings = None
    if options["proof"] is not None:
        from metrosep.io.reading_sets import read_reading_set

        readings = read_reading_set(options["proof"], chain)
    at = _places(options["places"], kinds)
    _require_said(chain, over, at, {}, known, options)
    place: dict[str, Any] = {}
    if options["tool"] is not None:
        place["tool"] = point_of(options["tool"])
    allowed = quantity(options["tolerance"], "--tolerance", "length")
    phase("choosing the nodes of the grid")
    positions = volume_positions(
        chain,
        terms,
        spans=_spans(over, kinds, known, options),
        tolerance=allowed,
        at=at,
        **place,
    )
    made = volume_from_machine(chain, terms, over=over, positions=positions, at=at, **place)
    phase("applying the grid to the volume")
    if out is None:
        ready, judged = None, made.verify(readings=readings)
    else:
        ready, judged = _judged_grid(made, Path(out), force=force)
    stays = judged["after_max_component_m"]
    if stays > allowed + _PICOMETRE:
        raise DataError(
            f"the grid would leave {_size(stays)} in one direction, more than --tolerance: errors change "
            "within its cells; write one with machine-tables --format grid and a --spacing of your own"
        )
    found: dict[str, Any] = {"verification": judged}
    if ready is None:
        _print_volume(judged, made.messages)
    else:
        found |= _grid_written(made, ready, judged, {"waive": ()})
    nodes = {a: int(p.size) for a, p in positions.items()}
    found["nodes"] = nodes
    click.echo(
        json.dumps(found, sort_keys=True, allow_nan=False)
        if as_json
        else "nodes: " + ", ".join(f"{a} {n}" for a, n in nodes.items())
    )
    return 0


def _print_volume(judged: Mapping[str, Any], messages: Sequence[str]) -> None:
    """Say what a grid leaves."""
    from metrosep.core.units import format_length

    for text in (*messages, *_about_volume(judged)):
        say(f"note: {text}")
    before, after = (_size(judged[k], 4) for k in ("before_rms_m", "after_rms_m"))
    say(
        f"error of the tool point, {judged['places']} places off the nodes: RMS {before} -> {after}"
    )
    if "readings" in judged:
        read = judged["readings"]
        sizes = [
            format_length(read[k], digits=4)
            for k in ("rms_m", "predicted_rms_m", "without_rms_m", "wrong_sign_rms_m")
        ]
        say(
            f"readings of {read['name']}: RMS {sizes[0]} with the corrections active; the model says "
            f"{sizes[1]}, without them {sizes[2]}, with the sign reversed {sizes[3]}"
        )


# ---- one or two axes ----------------------------------------------------------------------------


def _tables(
    chain: Chain, terms: Any, common: dict[str, Any], name: str, folder: Path, options: dict[str, Any],
    *, force: bool,
) -> dict[str, Any]:  # fmt: skip
    """Make, judge and write a table or map for each corrected axis."""
    from metrosep.compensation._machine_errors import rms_of_vectors
    from metrosep.compensation.from_machine import axis_error, tables_over

    over, positions, reference = (common.pop(k) for k in ("over", "positions", "reference"))
    made = tables_over(chain, terms, over, positions, reference, **common)
    wanted = {(made.over, axis): (table, *axis_error(made, axis)) for axis, table in made.items()}
    ready, lookups = _prepared(wanted, name, folder, options, force=force)
    where = made.between()
    before, after = (
        rms_of_vectors(
            made.residual(where, sign=sign, corrections={a: f for (_, a), f in lookups.items()})
        )
        for sign in (0, 1)
    )
    return _written(ready, before, after, made.messages, "nodes and between", options)


# ---- three axes ---------------------------------------------------------------------------------


def _volume(
    chain: Chain, terms: Any, common: dict[str, Any], name: str, folder: Path, options: dict[str, Any],
    *, force: bool,
) -> dict[str, Any]:  # fmt: skip
    """Write corrections over three axes: as tables to be added up, or as a neutral grid."""
    from metrosep.compensation.from_machine import axis_error, tables_over, volume_from_machine

    made = volume_from_machine(chain, terms, **common)
    if name == "grid":
        ready, judged = _judged_grid(made, folder, force=force)
        return {**_grid_written(made, ready, judged, options), "verification": judged}
    wanted: dict[tuple[tuple[str, ...], str], tuple[Any, Any, float, float]] = {}
    for (looked, axis), table in made.parts.items():
        place = dict(zip(made.over, common["reference"] or _zero(made), strict=True))
        alone = tables_over(
            chain, terms, (looked,), table.positions, place[looked], corrects=made.source.names,
            at={**common["at"], **{a: v for a, v in place.items() if a != looked}},
            **({"tool": common["tool"]} if "tool" in common else {}),
        )  # fmt: skip
        wanted[(looked,), axis] = (table, *axis_error(alone, axis))
    ready_tables, lookups = _prepared(wanted, name, folder, options, force=force)
    by_pair = {(k[0], a): f for (k, a), f in lookups.items()}
    judged = made.added_up(lookups=by_pair)
    sizes = judged["before_rms_m"], judged["after_rms_m"]
    messages = (*made.messages, *_about_tables(judged, made.over))
    found = _written(ready_tables, *sizes, messages, "places off the nodes", options)
    return {**found, "verification": judged}


_WORTH_A_GRID = 1.5
"""Times the RMS that a grid on the same nodes leaves: from here on tables added up are named as the limit."""
_NAMED = 0.2
"""Of the largest: smaller shares of what tables leave are not named."""


def _about_tables(judged: Mapping[str, Any], over: Sequence[str]) -> list[str]:
    """Return what tables of one axis each cannot hold, and what would."""
    before, after, grid = (judged[k] for k in ("before_rms_m", "after_rms_m", "grid_rms_m"))
    if after < _WORTH_A_GRID * grid + _PICOMETRE:
        return []
    largest = max(judged["by_term"].values(), default=0.0)
    named = [f"{n} {_size(v)}" for n, v in judged["by_term"].items() if v > _NAMED * largest]
    why = (
        f" They hold no error that depends on two axes at once, an angle on the lever that another axis "
        f"changes (RMS of each: {', '.join(named)})."
        if named
        else ""
    )
    text = (
        f"tables of one axis each, added up, leave {_size(after)} of {_size(before)} RMS, {before / after:.1f} "
        f"times less, and up to {_size(judged['after_max_m'])}.{why} No tables of one axis leave less than "
        f"{_size(judged['least_rms_m'])}, whatever their values. A grid over {', '.join(over)} on the same nodes leaves "
        f"{_size(grid)}: --format grid"
    )
    return [text]


def _judged_grid(
    made: MachineVolume, folder: Path, *, force: bool
) -> tuple[Prepared, dict[str, Any]]:
    """Return the file of a grid, and what its bytes leave of the error."""
    ready = _grid(made, folder, force=force)
    return ready, replace(made, corrections=_of_grid(ready.data, made)).judged()


def _grid_written(
    made: MachineVolume, ready: Prepared, judged: Mapping[str, Any], options: dict[str, Any]
) -> dict[str, Any]:
    """Write a grid that was judged."""
    sizes = judged["before_rms_m"], judged["after_rms_m"]
    messages = (*made.messages, *_about_volume(judged))
    where = f"{judged['places']} places off the nodes, by the file"
    return _written([ready], *sizes, messages, where, options)


def _about_volume(judged: Mapping[str, Any]) -> list[str]:
    """Return what a verification of a volume says besides its RMS."""
    from metrosep.core.units import format_length

    bound = max(judged["bound_m"])
    proof = "" if "readings" in judged else ": readings of another kind prove the signs (--verify)"
    said = [
        (
            f"largest error that stays {_size(judged['after_max_m'])}; by the spacing at most "
            f"{_size(bound)} in each direction; judged against {judged['against']}{proof}"
        )
    ]
    worst = max((t["after_per_metre"] or 0.0 for t in judged["other_tools"]), default=0.0)
    if worst * 1e-3 > _PICOMETRE:
        said.append(
            f"the corrections hold for the stated tool point: another leaves up to "
            f"{format_length(worst * 1e-3, digits=2)} RMS more for each mm that it stands beside it"
        )
    return said


def _size(length: float, digits: int = 3) -> str:
    """Return a length for people; what rounding leaves is below a picometre."""
    from metrosep.core.units import format_length

    return "below 1 pm" if length < _PICOMETRE else format_length(length, digits=digits)


def _of_grid(data: bytes, made: MachineVolume) -> dict[str, Any]:
    """Return the corrections that the bytes of a grid hold, by axis."""
    import numpy as np

    head, *rows = data.decode("ascii").splitlines()
    names = head.split(",")
    values = np.array([[float(v) for v in row.split(",")] for row in rows])
    order = np.lexsort(values[:, : len(made.over)].T)
    shape = tuple(p.size for p in made.positions[::-1])
    return {
        axis: values[order, names.index(f"c{axis.lower()}_um")].reshape(shape) * 1e-6
        for axis in made.corrections
    }


def _zero(made: MachineVolume) -> tuple[float, ...]:
    """Return the reference that was chosen."""
    first = next(iter(made.parts))[1]
    return tuple(
        made.parts[a, first].reference
        if (a, first) in made.parts
        else next(t.reference for (k, _), t in made.parts.items() if k == a)
        for a in made.over
    )


def _grid(made: MachineVolume, folder: Path, *, force: bool) -> Prepared:
    """Return the neutral grid, the first axis fastest, and its sidecar."""
    import hashlib

    from metrosep._version import __version__
    from metrosep.controllers.base import Prepared

    axes = made.over
    head = [f"{a.lower()}_mm" for a in axes] + [f"c{a.lower()}_um" for a in made.corrections]
    rows = [",".join(head)]
    sizes = [p.size for p in made.positions]
    for k in range(sizes[2]):
        for j in range(sizes[1]):
            for i in range(sizes[0]):
                place = (made.positions[0][i], made.positions[1][j], made.positions[2][k])
                c = [values[k, j, i] for values in made.corrections.values()]
                rows.append(
                    ",".join([*(f"{v * 1e3:.9f}" for v in place), *(f"{v * 1e6:.9f}" for v in c)])
                )
    data = ("\n".join(rows) + "\n").encode("ascii")
    sidecar = {
        "schema": "metrosep.grid/1",
        "metrosep": __version__,
        "entry": "correction c = -e that is added to the command of the axis at that place",
        "units": "positions in mm, corrections in um",
        "file_sha256": hashlib.sha256(data).hexdigest(),
        "axes": list(axes),
        "corrects": list(made.corrections),
        "shape": sizes,
        "reference_m": list(_zero(made)),
        "at_si": dict(made.source.at),
        "chain": made.source.chain.name,
        **made.source.facts,
    }
    name = "-".join(axes).lower() + "-grid.csv"
    text = json.dumps(sidecar, indent=1, sort_keys=True, allow_nan=False) + "\n"
    return Prepared(folder / name, data, text.encode("utf-8"), None, force)


# ---- files --------------------------------------------------------------------------------------


def _prepared(
    wanted: Mapping[tuple[tuple[str, ...], str], tuple[Any, Any, float, float]],
    name: str,
    folder: Path,
    options: dict[str, Any],
    *,
    force: bool,
) -> tuple[list[Prepared], dict[tuple[tuple[str, ...], str], Callable[..., Any]]]:
    """Return the files, each after its own checks, and what their controller adds by their bytes."""
    from metrosep.compensation.from_machine import ZERO
    from metrosep.controllers.files import prepare, simulate
    from metrosep.controllers.options import missing_facts, split_machine
    from metrosep.controllers.registry import find
    from metrosep.core.errors import WriteError
    from metrosep.core.units import format_length

    dialect = find(name)
    given = name_values(options["facts"], "--machine")
    stems = {(over, axis): "-".join((*over, axis)).lower() for over, axis in wanted}
    for fact, _ in given:
        stem, dot, _ = fact.rpartition(".")
        if dot and stem.lower() not in stems.values():
            raise click.UsageError(
                f"--machine {fact}: there is no file {stem}; there are {', '.join(stems.values())}"
            )
    facts_of = {
        key: {
            k.replace("-", "_"): v
            for (own, _, k), v in sorted(
                ((k.rpartition("."), v) for k, v in given), key=lambda named: bool(named[0][0])
            )
            if own.lower() in ("", stem)
        }
        for key, stem in stems.items()
    }
    asked = {  # of the files that are written
        f"machine {stems[key]}.{o.name}=...": f"{o.name}: {o.help}"
        for key, (_, _, size, _) in wanted.items()
        if size >= ZERO
        for o in missing_facts(facts_of[key], dialect.options)
    }
    if asked:
        raise missing_options([*asked], None, *dict.fromkeys(asked.values()))
    ready: list[Prepared] = []
    lookups: dict[tuple[tuple[str, ...], str], Callable[..., Any]] = {}
    stated: dict[str, dict[str, Any]] = {}
    with tempfile.TemporaryDirectory(prefix="metrosep-machine-") as temporary:
        for key, (table, error, size, _) in wanted.items():
            place = folder / f"{stems[key]}{dialect.info.suffix}"
            named = f"{key[1]} over {', '.join(key[0])}"
            # what the corrections of other axes add to it, second order, is judged with all files together
            if size < ZERO:
                if place.exists():
                    raise WriteError(
                        f"{place}: is a table of an earlier call, and {named} needs no correction now; "
                        "remove it, or choose another folder with -o"
                    )
                idle = [fact for fact, _ in given if fact.lower().startswith(f"{stems[key]}.")]
                say(
                    f"note: {named} needs no correction and gets no file"
                    + (f"; {', '.join(idle)} has no use" if idle else "")
                )
                continue
            if table.stroke < ZERO:
                raise click.UsageError(
                    f"{named}: the error of {format_length(size, digits=3)} P-V is nothing at every node, "
                    "so the table holds none of it; give other positions or a finer spacing"
                )
            facts: dict[str, Any] = facts_of[key]
            stated[stems[key]] = {
                "axis": key[0],
                "compensates": key[1],
                "file": stems[key],
                **facts,
            }
            _require_apart(dialect, stated)
            prepared = prepare(
                table,
                place,
                name,
                verified_against=error,
                waive=options["waive"],
                sign_confirmed=options["sign_confirmed"],
                overwrite=force,
                **facts,
            )
            prepared.write(Path(temporary))
            own_options, _ = split_machine(facts, dialect.options, name)
            lookups[key] = simulate(Path(temporary) / prepared.target.name, name, **own_options)
            ready.append(prepared)
    if not ready:
        raise click.UsageError(_no_table(wanted))
    return _in_one_file(dialect, ready, lookups, folder), lookups


def _no_table(wanted: Mapping[tuple[tuple[str, ...], str], tuple[Any, Any, float, float]]) -> str:
    """Return why no axis needs a table: nothing moves the tool point, or it is moved alike everywhere."""
    from metrosep.compensation.from_machine import ZERO
    from metrosep.core.units import format_length

    shifts = {axis: off for (_, axis), (_, _, _, off) in wanted.items() if abs(off) >= ZERO}
    if not shifts:
        return (
            "no axis needs a correction here: the ERRORS do not move the tool point where --at and --tool put "
            "it (the end of the tool branch if omitted); an angle acts through an arm, so state those of the work"
        )
    over = ", ".join(dict.fromkeys(a for looked, _ in wanted for a in looked))
    sizes = ", ".join(f"{a} {format_length(off, digits=4)}" for a, off in sorted(shifts.items()))
    return (
        f"no axis needs a table over {over}: along it the ERRORS shift the tool point by the same everywhere "
        f"(error {sizes}), and a table is zero at its reference; enter minus that as an offset of "
        f"{', '.join(sorted(shifts))} in the control, or name another axis with --over"
    )


def _require_apart(dialect: Any, files: Mapping[str, Mapping[str, Any]]) -> None:
    """Refuse files for one control that name one axis for two, or that replace each other there."""
    from metrosep.controllers.options import APART

    *before, last = files
    for role, names in APART.items():
        for option in (o for o in dialect.options if o.name in names):
            own = _as_read(option, files[last], dialect.info.id)
            for stem in before:
                there = _as_read(option, files[stem], dialect.info.id)
                if own == there is not None and files[stem][role] != files[last][role]:
                    raise click.UsageError(
                        f"{stem} and {last} have the same {option.name}, {own}: the control would take one for "
                        f"the other ({option.help}); state it of each, --machine {last}.{option.name}=..."
                    )


def _as_read(option: Any, facts: Mapping[str, Any], controller: str) -> Any:
    """Return a fact as the control reads it: 00 is 0, and names are the same in capitals or not."""
    value = option.checked(facts.get(option.name, option.default), controller)
    return value.upper() if isinstance(value, str) else value


def _in_one_file(dialect: Any, ready: list[Prepared], keys: Iterable[Any], folder: Path) -> Any:
    """Return the files, those over one axis as columns of one where only one can be active."""
    from metrosep.controllers.active import in_columns

    if not dialect.has_columns:
        return ready
    by_axis: dict[str, list[Prepared]] = {}
    for (over, _), prepared in zip(keys, ready, strict=True):
        by_axis.setdefault("-".join(over).lower(), []).append(prepared)
    return [
        in_columns(dialect, parts, folder / f"{name}{dialect.info.suffix}")
        if len(parts) > 1
        else parts[0]
        for name, parts in by_axis.items()
    ]


def _written(
    ready: Sequence[Prepared],
    before: float,
    after: float,
    messages: Sequence[str],
    where: str,
    options: dict[str, Any],
) -> dict[str, Any]:
    """Judge all files together, then write them; the judgement stands in each sidecar."""
    from metrosep.cli.tables import print_table
    from metrosep.controllers.base import sidecar_path
    from metrosep.core.errors import SignCheckFailedError, WriteError

    together = {
        "files": [p.target.name for p in ready],
        "where": where,
        "before_rms_m": before,
        "after_rms_m": after,
        "messages": list(messages),
    }
    for text in messages:
        say(f"note: {text}")
    sizes = f"RMS {_size(before, 4)} -> {_size(after, 4)}"
    if not after < before and "dry-run" not in options["waive"]:
        raise SignCheckFailedError(
            f"{ready[0].target.parent}: the files together do not shrink the error of the tool point, {sizes}; "
            "nothing was written; the tables belong to other errors, another place, or facts of the machine "
            "that are not so"
        )
    full = []
    for prepared in ready:
        sidecar = {**json.loads(prepared.sidecar), "together": together}
        text = json.dumps(sidecar, indent=1, sort_keys=True, allow_nan=False) + "\n"
        full.append((replace(prepared, sidecar=text.encode("utf-8")), sidecar))
    for prepared, _ in full:
        prepared.require_free()
    folder = ready[0].target.parent
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as exc:
        raise WriteError(
            f"{folder}: the folder cannot be made ({exc.strerror or exc})", exc
        ) from None
    files = []
    for prepared, sidecar in full:
        prepared.write()
        print_table(str(prepared.target), sidecar)
        files += [str(prepared.target), str(sidecar_path(prepared.target))]
    say(f"error of the tool point, {where}: {sizes}")
    for file in files:
        say(f"wrote {file}")
    return {**together, "files": files}


# ---- options ------------------------------------------------------------------------------------


def _names(text: str, option: str, most: int | None) -> tuple[str, ...]:
    names = tuple(n.strip() for n in text.split(","))
    if not all(names) or len(set(names)) < len(names) or (most is not None and len(names) > most):
        limit = "" if most is None else f", at most {most}"
        raise click.UsageError(
            f"{option} names axes, each once{limit}, such as X,Y; found {text!r}"
        )
    return names


def _place(text: str, axis: str, kinds: Mapping[str, str], option: str) -> float:
    from metrosep.core.errors import UnitError
    from metrosep.core.units import parse_quantity

    if axis not in kinds:
        raise click.UsageError(
            f"{option}: the machine has no axis {axis!r}; it has {', '.join(kinds)}"
        )
    try:
        return float(parse_quantity(text.strip(), dimension=kinds[axis], name=option))
    except UnitError as exc:
        raise click.UsageError(f"{option}: {exc}") from None


def _places(texts: tuple[str, ...], kinds: Mapping[str, str]) -> dict[str, float]:
    return {axis: _place(v, axis, kinds, f"--at {axis}") for axis, v in name_values(texts, "--at")}


def _reference(
    text: str | None, over: tuple[str, ...], kinds: Mapping[str, str]
) -> tuple[float, ...] | None:
    if text is None:
        return None
    parts = text.split(",")
    if len(parts) != len(over):
        raise click.UsageError(
            f"--reference has {len(parts)} places for the {len(over)} axes of --over"
        )
    return tuple(_place(p, a, kinds, "--reference") for p, a in zip(parts, over, strict=True))


def point_of(text: str) -> tuple[float, ...]:
    """Return a tool point that was typed, m."""
    from metrosep.core.units import parse_quantity

    parts = text.split(",")
    if len(parts) != 3:
        raise click.UsageError('--tool is three lengths, "0 mm,0 mm,-80 mm"')
    return tuple(parse_quantity(p.strip(), dimension="length", name="--tool") for p in parts)


def _steps(over: Sequence[str], kinds: Mapping[str, str], text: str) -> dict[str, float]:
    """Return the wanted spacing along each looked-up axis."""
    each = dict(name_values(tuple(text.split(",")), "--spacing")) if "=" in text else {}
    found = {}
    for axis in over:
        if axis not in kinds:
            raise click.UsageError(
                f"--over: the machine has no axis {axis!r}; it has {', '.join(kinds)}"
            )
        found[axis] = _place(each.get(axis, text), axis, kinds, f"--spacing of {axis}")
        if not found[axis] > 0:
            raise click.UsageError(f"{axis}: the spacing must be above zero")
    return found


def _positions(
    steps: Mapping[str, float], spans: Mapping[str, tuple[float, float]]
) -> dict[str, Any]:
    """Return the nodes of each looked-up axis: as near to the spacing as whole steps allow."""
    import numpy as np

    return {
        axis: np.linspace(low, high, max(2, round((high - low) / steps[axis]) + 1))
        for axis, (low, high) in spans.items()
    }


def _spans(
    over: tuple[str, ...],
    kinds: Mapping[str, str],
    known: Mapping[str, tuple[float, float]],
    options: dict[str, Any],
) -> dict[str, tuple[float, float]]:
    """Return the travel of each looked-up axis: as stated, or as far as its errors are known."""
    stated: dict[str, tuple[float, float]] = {}
    for axis, text in name_values(options["spans"], "--span"):
        begin, dots, end = text.partition("..")
        if not dots:
            raise click.UsageError(f"--span {axis} is two places, {_travel_of(axis, kinds)}")
        stated[axis] = (
            _place(begin, axis, kinds, f"--span {axis}"),
            _place(end, axis, kinds, f"--span {axis}"),
        )
    found = {}
    for axis in over:
        low, high = stated[axis] if axis in stated else known[axis]
        if not high > low:
            raise click.UsageError(f"{axis}: the travel must rise")
        found[axis] = (low, high)
    return found


def _travel_of(axis: str, kinds: Mapping[str, str]) -> str:
    """Return how the travel of an axis is typed."""
    return f'"{axis}=0 deg..360 deg"' if kinds.get(axis) == "angle" else f'"{axis}=0 mm..400 mm"'
