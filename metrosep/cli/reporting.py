"""The command that makes reports again: report."""

from __future__ import annotations

import json
import os
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, cast

import click

from metrosep.cli.options import json_option, name_values, phase, report_option, say
from metrosep.core.readable import did_you_mean

if TYPE_CHECKING:
    from metrosep.report.comparison import Comparison, Row

_FORBIDDEN = '<>:"/\\|?*'
"""In file names of Windows."""

_MANY = 8
"""Results with files of their own from which all processors share the work, without --workers."""


@click.command()
@click.argument("results", metavar="RESULT...", nargs=-1, required=True)
@click.option(
    "--format",
    "formats",
    default="html",
    show_default=True,
    metavar="NAME,...",
    help="Formats of the reports: html, pdf, xlsx, csv, parquet, dfq, dcc, qif.",
)
@click.option("-o", "--out", required=True, metavar="DIR", help="Folder for the reports.")
@report_option
@click.option(
    "--template", metavar="FILE", help="TOML file with logo, colours and fonts of the laboratory."
)
@click.option(
    "--issue",
    is_flag=True,
    help="Issue the report of one RESULT; issue.json in DIR keeps its number.",
)
@click.option("--number", metavar="TEXT", help="Number of the report that is issued.")
@click.option("--date", metavar="DATE", help="Date of issue, 2026-03-05 or today.")
@click.option("--released", metavar="NAME", help="Person who releases the report.")
@click.option(
    "--dcc-schema",
    metavar="DIR",
    help="Folder with the published schemas, against which dcc and qif are checked.",
)
@click.option(
    "--pdf-engine",
    type=click.Choice(["typst", "matplotlib"]),
    default="typst",
    show_default=True,
    help="matplotlib: plainer pages, without bars and attachment.",
)
@click.option(
    "--pdf-standard",
    type=click.Choice(["a-2b", "a-3b"]),
    help="PDF/A for archives; a-2b cannot hold the result as an attachment.",
)
@click.option(
    "--workers",
    type=click.IntRange(min=1),
    metavar="N",
    help="Number of reports at once. Default: one for few results, one for each processor for many.",
)
@click.pass_context
def report(
    context: click.Context,
    results: tuple[str, ...],
    formats: str,
    out: str,
    fields: tuple[str, ...],
    template: str | None,
    issue: bool,
    number: str | None,
    date: str | None,
    released: str | None,
    dcc_schema: str | None,
    pdf_engine: str,
    pdf_standard: str | None,
    workers: int | None,
) -> int:
    """Make the reports of RESULT again: result.json, its folder, or a folder with many below it.

    Where the folder has the index.json of a batch, its rows decide which results count; the others
    are reported. Nothing is computed and no input is touched; the same result gives the same bytes. Several
    results give one file each, but one results.csv and one results.parquet for all; --workers
    changes the time, not the bytes. Exit code 4: a result was unreadable, the others are done.

    A report is a draft until it is issued: --issue --number N --date 2026-03-05 --released "NAME"
    fills these in and refuses a number that was issued for other bytes.
    """
    if pdf_standard is not None and pdf_engine == "matplotlib":
        raise click.UsageError("--pdf-standard needs --pdf-engine typst; leave one of them out")
    writers = _writers(formats, pdf_engine, pdf_standard, dcc_schema)
    change = _change_of(
        fields, template, issue, {"number": number, "date": date, "released": released}
    )
    quiet = bool((context.obj or {}).get("quiet"))
    files = _files(results, quiet=quiet)
    if issue and len(files) != 1:
        raise click.UsageError(
            f"--issue takes one result, got {len(files)}; each report has a number of its own"
        )
    folder = _folder(out)
    names = _names(files)
    if issue:
        from metrosep.report.issuing import Register

        with Register.held(folder):
            change = _issued(files[0], folder, change)
            name = _file_name(change.register.issued[-1])
            _require_reports(
                RenderTask(files[0], name, folder, writers, alone=True, change=change)
            )
            # before the reports: a number is never free again by a full disk
            place = change.register.write(folder)
        names = [name]
        if not quiet:
            say(f"issued   {place}")
    tasks = [
        RenderTask(file, name, folder, writers, alone=len(files) == 1, change=change)
        for file, name in zip(files, names, strict=True)
    ]
    if workers is None:  # what is one file for all is done sooner than a worker starts
        n_own = len(files) if writers.keys() - TOGETHER else 0
        workers = (os.cpu_count() or 1) if n_own >= _MANY else 1
    documents, unread = [], 0
    for i, outcome in enumerate(_outcomes(tasks, workers), start=1):
        phase(f"{i} of {len(tasks)} reports")
        for target in () if quiet else outcome.written:
            say(f"report   {target}")
        if outcome.missing:
            raise click.ClickException(outcome.missing)
        if outcome.unread:
            say(f"error: {' '.join(outcome.unread.split())}")
            unread += 1
        elif outcome.document is not None:
            documents.append(outcome.document)
    if documents:
        _write_together(documents, folder, writers, quiet=quiet)
    return 4 if unread else 0


def _require_reports(task: RenderTask) -> None:
    """Make the reports where nobody sees them, so that no number is issued for what cannot be made."""
    from tempfile import TemporaryDirectory

    with TemporaryDirectory(prefix="metrosep-") as name:
        made = rendered(replace(task, folder=Path(name)))
    if made.missing or made.unread:
        raise click.ClickException(f"{made.missing or made.unread}; the number was not issued")


def _change_of(
    fields: tuple[str, ...], template: str | None, issue: bool, given: Mapping[str, str | None]
) -> Change:
    """Return what the command states of the reports beside their results; all is checked here."""
    from metrosep.core.errors import DataError
    from metrosep.recipe.look import read_look
    from metrosep.recipe.report_fields import checked_report, typed_fields

    stray = next((k for k, v in given.items() if v is not None and not issue), None)
    if stray is not None:
        raise click.UsageError(f"--{stray} goes with --issue; add it")
    typed = typed_fields(fields)
    if given["number"] is not None:
        typed["number"] = given["number"]
    if given["date"] is not None:
        day = given["date"]
        typed["issued"] = _today() if day == "today" else day
    if given["released"] is not None:
        typed.setdefault("persons", {})["released"] = given["released"]
    try:
        checked = checked_report(typed, "--report")
    except DataError as exc:
        raise click.UsageError(str(exc)) from None
    look = {} if template is None else read_look(Path(template))
    return Change(checked, look)


def _today() -> str:
    """Return the date of today; it is written out before anything else is done with it."""
    import datetime as dt

    return dt.datetime.now().astimezone().date().isoformat()


def _issued(file: Path, folder: Path, change: Change) -> Change:
    """Return the change with the register of issued numbers, or refuse to issue."""
    from metrosep.core.provenance import hash_bytes
    from metrosep.recipe.report_fields import missing_fields
    from metrosep.recipe.result import load_document
    from metrosep.report.issuing import Register

    document = change.of(load_document(file))
    missing = missing_fields(document.get("report") or {})
    if missing:
        names = {"number": "--number", "issued": "--date", "persons.released": "--released"}
        shown = ", ".join(names.get(k, f'--report "{k}=..."') for k in missing)
        raise click.UsageError(
            f"the report cannot be issued: {shown} missing; nothing was written"
        )
    register = Register.load(folder)
    register = register.with_issue(document["report"], hash_bytes(file.read_bytes()))
    new = register.issued[-1]
    for row in register.issued[:-1]:
        if _file_name(row) == _file_name(new):
            raise click.UsageError(
                f"--number {new['number']}: its files would have the names of report {row['number']}, issued "
                f"on {row.get('date')}; give a number that differs in letters or digits"
            )
    return replace(change, register=register)


def _file_name(issued: Mapping[str, Any]) -> str:
    """Return the name of the files of an issued report: its number, so that none replaces another."""
    revision = f"_rev{issued['revision']}" if issued["revision"] else ""
    return _plain_name(f"{issued['number']}{revision}")


def _outcomes(tasks: Sequence[RenderTask], workers: int) -> Iterator[Rendered]:
    """Do them, and give what became of each in their order."""
    from concurrent.futures import BrokenExecutor

    from metrosep.batch.loop import executor

    workers = min(workers, len(tasks))
    with executor("processes" if workers > 1 else "serial", workers) as make:
        try:
            yield from make().map(rendered, tasks)
        except BrokenExecutor:
            raise click.ClickException(
                "a worker process died, perhaps for want of memory; use --workers 1"
            ) from None


def _write_together(
    documents: Sequence[Mapping[str, Any]], folder: Path, kinds: Iterable[str], *, quiet: bool
) -> None:
    """Write the long forms: one file of a kind for all results."""
    from metrosep.core.atomic import atomic_write
    from metrosep.core.errors import UnsupportedFeatureError
    from metrosep.report.csv_long import render_csv
    from metrosep.report.parquet import render_parquet

    for kind in (k for k in kinds if k in TOGETHER):
        target = folder / f"results.{kind}"
        try:
            data = (
                render_parquet(documents) if kind == "parquet" else render_csv(documents).encode()
            )
        except UnsupportedFeatureError as exc:
            raise click.ClickException(str(exc)) from None
        atomic_write(target, data)
        if not quiet:
            say(f"report   {target}")


def _writers(
    formats: str, pdf_engine: str, pdf_standard: str | None, schemas: str | None
) -> dict[str, Writer]:
    from functools import partial

    from metrosep.recipe.preflight import report_formats
    from metrosep.report.schemas import schema_in

    known = report_formats()
    wanted = list(dict.fromkeys(f.strip().lower() for f in formats.split(",") if f.strip()))
    unknown = [name for name in wanted if name not in known]
    near = did_you_mean(unknown[0], known) if unknown else ""
    if unknown or not wanted:
        raise click.UsageError(
            f"Unknown report format {unknown[0] if unknown else formats!r}. Available: "
            f"{', '.join(sorted(known))}.{near}"
        )
    writers: dict[str, Writer] = {name: known[name].load() for name in wanted}
    if "pdf" in writers and pdf_engine == "matplotlib":
        from metrosep.report.typeset import write_plain_pdf

        writers["pdf"] = write_plain_pdf
    elif "pdf" in writers and pdf_standard is not None:
        from metrosep.report.typeset import write_pdf

        writers["pdf"] = partial(write_pdf, standard=pdf_standard)
    if schemas is not None and not {"dcc", "qif"} & writers.keys():
        raise click.UsageError(
            "--dcc-schema checks --format dcc or qif; add one of them, or leave it out"
        )
    for name in ("dcc", "qif"):
        if schemas is not None and name in writers:
            schema_in(Path(schemas), name)  # before any report is made
            writers[name] = partial(cast(Callable[..., Any], writers[name]), schemas=schemas)
    return writers


def _files(results: Sequence[str], *, quiet: bool) -> list[Path]:
    """Return the result files that are meant, each once."""
    found: list[Path] = []
    for name in results:
        path = Path(name)
        if path.is_dir() and not (path / "result.json").exists():
            below = sorted(path.rglob("result.json"))
            if not below:
                raise click.UsageError(
                    f"{name} holds no result.json, nor does a folder below it; give the folder that "
                    "'metrosep run -o' or 'metrosep batch -o' wrote"
                )
            found += _of_index(path, below, quiet=quiet)
        else:
            found.append(path / "result.json" if path.is_dir() else path)
    return list({f.resolve(): f for f in found}.values())


def _of_index(path: Path, below: list[Path], *, quiet: bool) -> list[Path]:
    """Return the results that the index of a batch counts, all of them where there is none."""
    from metrosep.core.errors import CorruptFileError, DataError
    from metrosep.report.index import link_of, require_index

    index = path / "index.json"
    if not index.is_file():
        return below
    again = "run the batch again, or give the folder of one result"
    try:
        rows = require_index(json.loads(index.read_bytes()))
    except (OSError, ValueError, DataError) as exc:
        raise CorruptFileError(
            index, f"it is not the index of a batch: {exc}", hint=again
        ) from None
    links = [str(r["link"]) if link_of(r.get("link")) else "" for r in rows]
    counted = [path / n for n in links if n.rpartition("/")[2] == "result.json"]
    if not counted:
        raise CorruptFileError(index, "no row of it has a result", hint=again)
    others = len({*below} - {*counted})
    failed = [r.get("unit") for r, n in zip(rows, links, strict=True) if path / n not in counted]
    if others and not quiet:
        say(
            f"note: {others} result(s) below {path} are not of its index.json (another recipe, former "
            "contents, files that are gone) and are omitted; give their own folders to include them"
        )
    if failed and not quiet:
        named = ", ".join(map(str, failed[:5])) + (
            f" and {len(failed) - 5} more" if len(failed) > 5 else ""
        )
        say(f"note: no report of {named}: by {index} these failed or were not begun")
    return counted


def _folder(out: str) -> Path:
    from metrosep.core.errors import WriteError

    folder = Path(out)
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as exc:
        raise WriteError(
            f"{out}: cannot be made a folder ({exc.strerror or exc}); choose another", exc
        ) from None
    return folder


def _plain_name(name: str) -> str:
    return "".join("_" if c in _FORBIDDEN or ord(c) < 32 else c for c in name)


def _names(files: Sequence[Path]) -> list[str]:
    """Return a name for each report: of the folder below the common one, so that none is twice."""
    if len(files) == 1:
        return ["report"]
    places = [f.resolve() for f in files]
    common = Path(os.path.commonpath([str(p.parent) for p in places]))
    names: list[str] = []
    for place in places:
        parts = [*place.parent.relative_to(common).parts]
        parts += [] if place.name == "result.json" else [place.stem]
        name = "_".join(parts) or "report"
        name = _plain_name(name)
        number, unique = 1, name
        while unique.lower() in (n.lower() for n in names):
            number += 1
            unique = f"{name}_{number}"
        names.append(unique)
    return names


# ---- the reports of one result, in this process or in a worker of `metrosep report` ------------

TOGETHER = frozenset({"csv", "parquet"})
"""Formats that hold all results in one file."""

Writer = Callable[[Mapping[str, Any], Path], Any]


@dataclass(frozen=True, slots=True)
class Change:
    """What a command states of a report, in place of what its result holds."""

    fields: Mapping[str, Any] = field(default_factory=dict)
    look: Mapping[str, Any] = field(default_factory=dict)
    register: Any = None  # of issued numbers

    def of(self, document: Mapping[str, Any]) -> dict[str, Any]:
        """Return the document with the fields that were typed, the origin of each with it."""
        from metrosep.recipe.report_fields import stated_report

        if not self.fields and not self.look:
            return dict(document)
        held = dict(document.get("report") or {})
        origin, look = held.pop("origin", {}), held.pop("look", {})
        made = stated_report(held, (), typed=self.fields)
        made["origin"] = {**made.get("origin", {}), **{
            k: v for k, v in origin.items() if made.get("origin", {}).get(k) == "recipe"
        }}  # fmt: skip
        look = dict(self.look or look)
        return {**document, "report": {**made, **({"look": look} if look else {})}}


@dataclass(frozen=True, slots=True)
class RenderTask:
    """The reports of one result."""

    file: Path  # the result
    name: str  # of the reports, without ending
    folder: Path  # for the reports
    writers: Mapping[str, Writer]  # mapping of str to callable: by format
    alone: bool  # whether it is the only result, so that the long forms are its own too
    change: Change = field(default_factory=Change)  # what the command states of it


@dataclass(frozen=True, slots=True)
class Rendered:
    """What became of it."""

    written: tuple[Path, ...] = ()  # the reports
    # mapping: the result, where the caller writes it into a file with others
    document: Mapping[str, Any] | None = None
    unread: str = ""  # why the result could not be read, if it could not
    missing: str = ""  # what is not installed or cannot be written at all, if so


def rendered(task: RenderTask) -> Rendered:
    """Write the reports of one result; what is wrong with it is reported with its name."""
    from metrosep.core.errors import (
        CorruptFileError,
        DataError,
        ReadError,
        RecipeError,
        UnsupportedFeatureError,
    )
    from metrosep.recipe.preflight import report_name
    from metrosep.recipe.result import load_document
    from metrosep.report.csv_long import long_rows

    try:
        document = task.change.of(load_document(task.file))
    except ReadError as exc:
        return Rendered(unread=str(exc))
    written: list[Path] = []
    missing: list[str] = []
    shared = None
    for kind, write in task.writers.items():
        target = task.folder / report_name(kind, task.name)
        try:
            if kind in TOGETHER and not task.alone:
                list(long_rows([document]))  # written by the caller; what is damaged is told here
                shared = document
                continue
            write(document, target)
        except (RecipeError, UnsupportedFeatureError) as exc:
            missing.append(str(exc))
            continue
        except (DataError, AttributeError, KeyError, TypeError, ValueError) as exc:
            told = CorruptFileError(
                task.file, f"no {kind} can be made of it: {exc}", hint="run the recipe again"
            )
            return Rendered(tuple(written), unread=str(told))
        written.append(target)
    return Rendered(tuple(written), shared, missing="; ".join(missing))


# ---- the command that compares two results, recipes or tables: diff ----------------------------

_MOST_LINES = 8


@click.command()
@click.argument("a", metavar="A")
@click.argument("b", metavar="B")
@click.option(
    "--tolerance",
    "tolerances",
    multiple=True,
    metavar="NAME=VALUE",
    help='Allowed difference of a value, "PV=5 nm"; "PV=U": its expanded uncertainty; "*=U": of '
    "all. May be repeated.",
)
@json_option
def diff(a: str, b: str, tolerances: tuple[str, ...], as_json: bool) -> int:
    """Compare A and B: two results (result.json or their folders), recipes (.toml) or tables.

    A folder of a batch stands for the one result below it. A difference is B minus A. Values are compared with the uncertainty of their difference, tables
    entry by entry at the same positions. Exit code 0: equal within the tolerances; 1: different; 2:
    usage; 4: unreadable.
    """
    from metrosep.core.errors import DataError, ReadError

    allowed: dict[str, float | str] = dict(name_values(tolerances, "--tolerance"))
    phase(f"reading {a} and {b}")
    (kind, one), (kind_b, two) = _load(a), _load(b)
    if kind != kind_b:
        raise click.UsageError(f"{a} is a {kind} and {b} is a {kind_b}; give two of one kind")
    if kind == "recipe" and allowed:
        raise click.UsageError("--tolerance is for values; recipes are compared key by key")
    phase(f"comparing {a} and {b}")
    try:
        found = _compared(kind, one, two, allowed, (a, b))
    except DataError as exc:
        if "is damaged" in str(exc):
            raise ReadError(str(exc)) from None
        raise
    if as_json:
        click.echo(json.dumps(found.to_dict(), sort_keys=True, allow_nan=False))
    else:
        _print(found)
    return 0 if found.equal else 1


def _load(name: str) -> tuple[str, Any]:
    """Return what a file is, and its content."""
    from metrosep.controllers.base import load_sidecar, require_unchanged, sidecar_path
    from metrosep.core.errors import ReadError
    from metrosep.recipe.result import load_document
    from metrosep.report.comparison import TABLE_SCHEMA

    path = Path(name)
    if path.suffix.lower() == ".toml":
        return "recipe", _text(path)
    if not path.is_dir() and sidecar_path(path).is_file():
        require_unchanged(path, _bytes(path))
        return "table", load_sidecar(path)
    if path.suffix.lower() == ".json" and path.is_file():
        content = _json(path)
        if isinstance(content, dict) and content.get("schema") == TABLE_SCHEMA:
            return "table", content
    elif path.is_file():
        raise ReadError(
            f"{name} is not a result.json, no recipe (.toml), and no table with its {path.name}.json "
            "beside it; give one of these"
        )
    return "result", load_document(_with_result(path) if path.is_dir() else path)


def _with_result(folder: Path) -> Path:
    """Return the folder of a result: this one, or the only one of a batch below it."""
    from metrosep.core.errors import ReadError

    if (folder / "result.json").is_file():
        return folder
    found = _below(folder, "result.json")
    if len(found) == 1:
        return found[0]
    if found:
        shown = ", ".join(f.relative_to(folder).as_posix() for f in found[:_MOST_LINES])
        more = f" and {len(found) - _MOST_LINES} more" if len(found) > _MOST_LINES else ""
        raise click.UsageError(
            f"{folder} holds {len(found)} results; give one of its folders: {shown}{more}"
        )
    failed = _below(folder, "failed.json")
    reason = _json(failed[0] / "failed.json") if len(failed) == 1 else None
    if isinstance(reason, dict) and reason.get("reason"):
        raise ReadError(f"{folder} holds no result, since its unit failed: {reason['reason']}")
    return folder


def _below(folder: Path, name: str) -> list[Path]:
    """Return the folders of a file one or two below: a batch writes <key>/<8 digits>/result.json."""
    found = [f.parent for pattern in (f"*/{name}", f"*/*/{name}") for f in folder.glob(pattern)]
    return sorted(f for f in found if not any(p.startswith(".") for p in f.parts[-2:]))


def _bytes(path: Path) -> bytes:
    from metrosep.core.atomic import RECIPE_BYTES, read_plain
    from metrosep.core.errors import ReadError

    try:
        return read_plain(path, RECIPE_BYTES)
    except OSError as exc:
        raise ReadError(
            f"{path}: cannot be read ({exc.strerror or exc}); check the name"
        ) from None


def _text(path: Path) -> str:
    from metrosep.core.errors import CorruptFileError

    try:
        return _bytes(path).decode("utf-8")
    except UnicodeDecodeError as exc:
        raise CorruptFileError(
            path, "not UTF-8", offset=exc.start, hint="save the recipe as UTF-8"
        ) from None


def _json(path: Path) -> Any:
    from metrosep.core.errors import CorruptFileError

    try:
        return json.loads(_bytes(path))
    except (ValueError, RecursionError) as exc:
        raise CorruptFileError(path, f"not JSON ({exc})", hint="write it again") from None


def _compared(
    kind: str, a: Any, b: Any, allowed: dict[str, float | str], names: tuple[str, str]
) -> Comparison:
    if kind == "recipe":
        from metrosep.report.compare import compare_recipes

        return compare_recipes(a, b, names=names)
    if kind == "table":
        from metrosep.report.comparison import compare_tables

        return compare_tables(a, b, tolerances=allowed)
    from metrosep.report.compare import compare_documents

    return compare_documents(a, b, tolerances=allowed)


def _print(found: Comparison) -> None:
    for row in found.rows:
        click.echo(_line(row))
    for title, lines in (
        ("recipe", found.recipe),
        ("input", found.inputs),
        ("version", found.versions),
        ("beside", found.other),
    ):
        shown = lines[:_MOST_LINES] if title == "beside" else lines
        for line in shown:
            click.echo(f"{title}: {_printable(line)}")
        if len(shown) < len(lines):
            click.echo(
                f"{title}: and {len(lines) - len(shown)} further places (--json lists them)"
            )
    for message in found.messages:
        say(f"note: {message}")
    say("equal within the tolerances" if found.equal else "different")


def _printable(text: str) -> str:
    """Return a text of a document without what would move the cursor of a terminal."""
    return "".join(c if c.isprintable() else "?" for c in text)


def _line(row: Row) -> str:
    """Return a row in one line: mark, values, difference with its uncertainty, reason."""
    from metrosep.core.readable import value_text

    parts = [f"{'=' if row.equal else '!'} {row.metric}"]
    if (row.value_a, row.value_b) != (None, None):
        parts.append(" -> ".join(value_text(v, row.unit) for v in (row.value_a, row.value_b)))
    if row.difference is not None:
        text = f"difference {value_text(row.difference, row.unit)}"
        if row.U is not None:
            text += (
                f" (U = {value_text(row.U, row.unit)}, {'above' if row.exceeds else 'within'} it)"
            )
        parts.append(text)
    if row.tolerance is not None:
        parts.append(f"tolerance {value_text(row.tolerance, row.unit)}")
    if row.message:
        parts.append(row.message)
    return _printable("; ".join(parts))
