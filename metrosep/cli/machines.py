"""Commands for whole machines: calibrate them from readings, predict readings, circular tests."""

from __future__ import annotations

import json
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from metrosep.cli.options import (
    chain_of,
    force_option,
    json_option,
    machine_options,
    name_values,
    say,
)

if TYPE_CHECKING:
    from metrosep.machine import Calibration, Chain, CircleTest

__all__ = ["calibrate", "circle", "read"]


@click.command()
@click.argument("machine")
@click.argument("sets", nargs=-1, required=True, metavar="SET...")
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
    help='Where errors of an axis are zero, "X=0 mm".',
)
@click.option(
    "--all-readings", is_flag=True, help="Refuse no reading that contradicts the others."
)
@click.option(
    "--smallest",
    is_flag=True,
    help="Write terms that are not determined too: the smallest that explain the readings.",
)
@machine_options
@click.option("-o", "--out", metavar="DIR", help="Folder for the terms and calibration.json.")
@force_option
@json_option
def calibrate(
    machine: str,
    sets: tuple[str, ...],
    out: str | None,
    force: bool,
    as_json: bool,
    **options: Any,
) -> int:
    """Find the error terms of MACHINE from readings of instruments, one file for each set-up.

    MACHINE is a preset or a TOML file, as for 'rank'. A SET is text: its set-up in comment lines
    (# instrument = "nest"), then the positions of the axes (X_mm, A_deg) and the readings (reading_um,
    reading_x_um ...) in the order of time. What the readings cannot tell apart is named. With -o the
    terms are written as 'machine-tables' takes them.
    """
    from metrosep.io.reading_sets import read_reading_set
    from metrosep.machine import calibrate as found_by

    chain = chain_of(machine, options)
    degrees = {k: _count(v, k) for k, v in name_values(options["degrees"], "--degree")}
    terms = None if options["terms"] is None else _listed(options["terms"])
    found = found_by(
        chain,
        [read_reading_set(file, chain) for file in sets],
        degrees=degrees or None,
        terms=terms,
        home=_homes(chain, options["homes"]),
        robust=not options["all_readings"],
    )
    files = (
        _terms_written(found, Path(out), smallest=options["smallest"], force=force) if out else []
    )
    if as_json:
        document = {**found.to_dict(), "files": [str(f) for f in files]}
        click.echo(json.dumps(document, sort_keys=True, allow_nan=False))
        return 0
    click.echo(found.report())
    for file in files:
        say(f"wrote {file}")
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

    from metrosep.cli.machine_tables import terms_of
    from metrosep.io.reading_sets import read_reading_set

    chain = chain_of(machine, options)
    given = read_reading_set(file, chain, needs_readings=False)
    kinds = {e.name: "angle" if e.kind == "rotary" else "length" for e in chain.elements}
    terms, _ = terms_of(errors, kinds)
    found = chain.read(given.instrument, given.q, terms, tool=given.tool, exact=exact)
    rows = np.atleast_2d(found.T).T * 1e6
    left = np.asarray(given.values) * 1e6 - rows
    unit = "urad" if given.instrument.is_angle else "um"
    has_readings = bool(np.any(np.nan_to_num(np.asarray(given.values))))
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
@click.argument("file")
@click.option("--radius", required=True, metavar="LENGTH", help='Programmed radius, "150 mm".')
@click.option(
    "--feed", required=True, metavar="SPEED", help='Feedrate along the circle, "1000 mm/min".'
)
@click.option(
    "--angle",
    default="angle_deg",
    show_default=True,
    metavar="COLUMN",
    help="Column of the angle.",
)
@click.option("--ccw", metavar="COLUMN", help="Deviation of the radius, angle rising.")
@click.option("--cw", metavar="COLUMN", help="The same, angle falling.")
@click.option(
    "--plane",
    type=click.Choice(["XY", "YZ", "ZX", "XZ"]),
    default="XY",
    show_default=True,
    help="First and second axis; the angle runs from the first to the second.",
)
@click.option("--uncalibrated", is_flag=True, help="The length of the bar is not known.")
@click.option("--figure", metavar="FILE", help="Polar picture of both runs, PNG or SVG.")
@json_option
def circle(file: str, figure: str | None, as_json: bool, **options: Any) -> int:
    """Evaluate a circular test (ballbar) after ISO 230-4: G, F, D, and what causes them.

    FILE holds a column with the angle of the place and one or two with the deviation of the radius,
    such as angle_deg,ccw_um,cw_um. Both senses are needed to tell squareness from servo mismatch.
    """
    from metrosep.io.readings import read_readings
    from metrosep.machine import circle_test

    named = {s: options[s] for s in ("ccw", "cw") if options[s] is not None}
    if not named:
        named = _senses(file)
    given = read_readings(file, readings=list(named.values()), angle=options["angle"])
    places: Any = given.position
    runs = {s: given.values[i, 0] for i, s in enumerate(named)}
    test = circle_test(
        places,
        runs.get("ccw"),
        runs.get("cw"),
        radius=options["radius"],
        feed=options["feed"],
        plane=options["plane"],
        calibrated=not options["uncalibrated"],
    )
    if figure is not None:
        _draw(test, figure)
    if as_json:
        click.echo(json.dumps(test.to_dict(), sort_keys=True, allow_nan=False))
        return 0
    click.echo(test.report())
    for text in given.warnings:
        say(f"note: {text}")
    if figure is not None:
        say(f"wrote {figure}")
    return 0


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


def _senses(file: str) -> dict[str, str]:
    """Return the columns that are called ccw or cw."""
    from metrosep.io.source import open_file
    from metrosep.io.text.table import read_table

    names = read_table(open_file(file)).names
    found = {
        s: n for s in ("ccw", "cw") for n in names if n == s or n.startswith((f"{s}_", f"{s} "))
    }
    if not found:
        raise click.UsageError(
            f"{file} has no column ccw_um or cw_um; name the deviations of the radius with --ccw and --cw "
            f"(its columns are {', '.join(names)})"
        )
    return found


def _listed(text: str) -> tuple[str, ...]:
    return tuple(v.strip() for v in text.split(",") if v.strip())


def _count(text: str, key: str) -> int:
    if not text.strip().isdecimal():
        raise click.UsageError(f"--degree {key}={text}: a whole number is needed")
    return int(text)


def _homes(chain: Chain, texts: tuple[str, ...]) -> dict[str, float]:
    from metrosep.core.numbers import quantity

    kinds = {e.name: "angle" if e.kind == "rotary" else "length" for e in chain.elements}
    return {
        axis: quantity(place, f"--home {axis}", kinds.get(axis, "length"))
        for axis, place in name_values(texts, "--home")
    }


def _terms_written(found: Calibration, folder: Path, *, smallest: bool, force: bool) -> list[Path]:
    """Write the terms: curves of each axis as CSV, constants as TOML, all of it as JSON."""
    import numpy as np

    from metrosep.core.atomic import atomic_write
    from metrosep.core.errors import WriteError
    from metrosep.machine._bases import UnseenTerm
    from metrosep.machine.elements import axis_of, term_unit
    from metrosep.machine.terms import ConstantTerm

    terms = found.fitted if smallest else found.errors
    known = {n: t for n, t in terms.items() if not isinstance(t, UnseenTerm)}
    rotary = {e.name for e in found.chain.elements if e.kind == "rotary"}
    texts: dict[str, str] = {}
    constants = []
    for name, term in known.items():
        if isinstance(term, ConstantTerm):
            scale, unit = (1e6, "urad" if term_unit(found.chain, name) == "rad" else "um")
            constants.append(f'{name} = "{term.value * scale:.6f} {unit}"')
    if constants:
        texts["constants.toml"] = "\n".join(constants) + "\n"
    for axis in found.chain.axes:
        curves = [
            n for n, t in known.items() if axis_of(n) == axis and not isinstance(t, ConstantTerm)
        ]
        if not curves:
            continue
        bases = [found.bases[n] for n in curves]
        low, high = min(b.low for b in bases), max(b.high for b in bases)
        if any(b.kind == "fourier" for b in bases):
            low, high = 0.0, 2.0 * np.pi
        x = np.linspace(low, high, 361 if axis in rotary else 101)
        columns = [np.degrees(x) if axis in rotary else x * 1e3]
        head = [f"{axis.lower()}_{'deg' if axis in rotary else 'mm'}"]
        for name in curves:
            head.append(f"{name}_{'urad' if term_unit(found.chain, name) == 'rad' else 'um'}")
            columns.append(np.asarray(known[name].evaluate(x)) * 1e6)
        rows = [",".join(f"{v:.9f}" for v in row) for row in np.column_stack(columns)]
        texts[f"{axis}.csv"] = "\n".join([",".join(head), *rows]) + "\n"
    document = json.dumps(found.to_dict(), indent=1, sort_keys=True, allow_nan=False)
    texts["calibration.json"] = document + "\n"
    standing = [folder / n for n in texts if (folder / n).exists()]
    if standing and not force:
        raise WriteError(
            f"{standing[0]} exists; give --force to replace the files of a calibration"
        )
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as exc:
        raise WriteError(
            f"{folder}: the folder cannot be made ({exc.strerror}); choose another one"
        ) from None
    for name, text in texts.items():
        atomic_write(folder / name, text.encode("utf-8"))
    return [folder / n for n in texts]
