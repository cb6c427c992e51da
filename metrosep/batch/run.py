"""`run_batch`: one recipe over a folder of thousands of files."""

from __future__ import annotations

import contextlib
import os
import time
from collections import Counter
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import replace
from datetime import UTC, datetime
from pathlib import Path
from typing import Any, Protocol

from metrosep.batch import units
from metrosep.batch.index import (
    STATUSES,
    BatchReport,
    build_index,
    exit_code,
    format_error,
    write_index,
)
from metrosep.batch.loop import Stop, executor, parse_scheduler, work_through
from metrosep.batch.units import (
    Found,
    Identity,
    Unit,
    files_read,
    find_units,
    one_line_name,
    record_source,
    require_own_source,
    title_notes,
)
from metrosep.batch.work import DISK_FULL, Task, earlier_row, input_hash
from metrosep.core.atomic import take_lock
from metrosep.core.errors import DataError, MetrosepError, ReadError, RecipeError, WriteError
from metrosep.core.numbers import positive
from metrosep.recipe.outputs import recipe_hash
from metrosep.recipe.parts import order_notes
from metrosep.recipe.preflight import guard_notes
from metrosep.recipe.recipe import Recipe
from metrosep.recipe.schema import INDEX_FORMATS

PathLike = str | os.PathLike[str]
Tell = Callable[[dict[str, Any]], None]
_AHEAD = 2
"""Units handed out for each worker: one in work, one that waits, so that none is idle."""
_OF_CLUSTER = 64
"""Units handed out at least to a cluster, whose number of workers may change."""


def run_batch(
    recipe: Recipe | PathLike,
    folder: PathLike,
    *,
    out: PathLike,
    workers: int | None = None,
    scheduler: str = "processes",
    resume: bool = True,
    fresh: bool = False,
    fail_fast: bool = False,
    dry_run: bool = False,
    watch: float | None = None,
    tell: Tell | None = None,
    cancel: Callable[[], bool] | None = None,
) -> BatchReport:
    """Run a recipe on every unit of a folder.

    Parameters
    ----------
    recipe : Recipe, str or path
        What to do.
    folder : str or path
        With the inputs, subfolders too.
    out : str or path
        Output folder: ``<key>/<hash8>/result.json`` for each unit, ``index.json``, ``index.csv``.
    workers : int, optional
        How many work at once; as many as there are processors if omitted.
    scheduler : str, optional
        "processes", "threads", "serial", "dask" or "dask=tcp://HOST:PORT".
    resume : bool, optional
        Keep what an earlier run finished: same input bytes, same meaning of the recipe, same minor
        version.
    fresh : bool, optional
        Do all again; the opposite of `resume`.
    fail_fast : bool, optional
        Begin nothing more after the first unit that fails; also ``[batch] on_error = "stop"``.
    dry_run : bool, optional
        Only say what would be done.
    watch : float, s, optional
        Look for new files so often until stopped.
    tell : callable, optional
        Given a dict after each unit: ``done``, ``total``, ``unit``, ``status``, ``reason``,
        ``seconds``, ``eta_s``, ``skipped``.
    cancel : callable, optional
        Asked often; true stops as Ctrl-C does.

    Returns
    -------
    BatchReport
        A row for each unit that was finished.

    Raises
    ------
    DataError
        If the scheduler or the number of workers is not possible.
    ReadError
        If the folder is none, is itself the output folder of a batch, or no file of it is of the
        recipe.
    RecipeError
        If the recipe is wrong, wants an index in a format that is not installed, or reads no
        inputs; also where that shows only when it is carried
        out and no unit has a result by then: the batch stops, instead of failing every file.
    WriteError
        If the output folder cannot be written, holds the results of another input folder, another
        batch works in it, or the disk is full: what is done is kept.
    ClusterError
        If Dask is not installed or the cluster cannot be reached.

    Notes
    -----
    A unit is done when its result.json is there; that comes last, by one rename. So the batch may
    be killed at any moment: the next run finds what is done and goes on.

    Examples
    --------
    >>> import tempfile
    >>> folder = Path(tempfile.mkdtemp())
    >>> (folder / "in").mkdir()
    >>> text = '''metrosep = 1
    ... [input]
    ... files = ["*.csv"]
    ... unit = "um"
    ... [[step]]
    ... op = "parameters"
    ... names = ["Pt"]
    ... '''
    >>> lines = "".join(f"{i * 0.01},{i % 5}" + chr(10) for i in range(200))
    >>> _ = (folder / "in" / "a.csv").write_text("x [mm],z [um]" + chr(10) + lines)
    >>> report = run_batch(Recipe.parse(text), folder / "in", out=folder / "qa", scheduler="serial")
    >>> report.counts["total"], report.exit_code
    (1, 0)
    """
    loaded = recipe if isinstance(recipe, Recipe) else Recipe.load(recipe)
    kind, address = parse_scheduler(scheduler)
    wrong = format_error(loaded)
    if wrong is not None:
        raise wrong
    count = _workers(workers)
    if watch is not None:
        watch = positive(watch, "watch", dimension="time", why="seconds between two looks")
    source, target = Path(folder), Path(os.path.abspath(out))  # noqa: PTH100
    if target.resolve() == source.resolve():
        raise WriteError(
            f"{out}: is the input folder itself; results would be taken for inputs; choose another"
        )
    found = find_units(loaded, source, out=target)
    if not found.units and watch is None:
        raise ReadError(_nothing(loaded, source, found))
    first = (
        *require_own_source(target, source),
        *guard_notes(loaded),
        *_one_number(loaded, found),
    )
    task = Task(
        text=loaded.text,
        name=loaded.name,
        folder=str(loaded.folder.resolve()),
        recipe_hash=recipe_hash(loaded),
        out=str(target),
        workers=1 if kind == "serial" or address is not None else count,
        resume=resume and not fresh,
        stated=loaded.typed or None,
    )
    if dry_run:
        return _rehearse(task, replace(found, messages=(*found.messages, *first)), tell)
    stop = Stop(cancel)
    strict = fail_fast or loaded.batch_options.get("on_error") == "stop"
    batch = _Batch(loaded, task, stop, tell, found, strict=strict)
    with locked(target), stop.at_signals():
        record_source(target, source)
        count = count if watch is not None else min(count, len(found.units))
        with executor(scheduler, count) as make:
            width = {"serial": 1, "dask": max(_OF_CLUSTER, _AHEAD * count)}.get(
                kind, _AHEAD * count
            )
            rounds = new_units(
                loaded, source, target, every=watch, stop=stop, first=found, rows=batch.rows,
                look=batch.look,
            )  # fmt: skip
            for units in rounds:
                batch.work(units, lambda u: work_through(task, u, make, width=width, stop=stop))
                if watch is not None:
                    told_index(loaded, task, batch)
    return finished_report(loaded, task, batch, first)


class _Batch:
    """Rows so far, and what is told of them."""

    def __init__(
        self,
        recipe: Recipe,
        task: Task,
        stop: Stop,
        tell: Tell | None,
        found: Found,
        *,
        strict: bool,
    ) -> None:
        self.recipe, self.task, self.stop, self.strict = recipe, task, stop, strict
        self._tell = tell
        self.rows: dict[str, dict[str, Any]] = {}
        self.found = found
        self.names: set[str] = {u.name for u in found.units}
        self.changed: set[str] = set()
        self.began = time.perf_counter()
        self._worked = 0
        self.wrong: str | None = None

    def look(self, found: Found, changed: frozenset[str] = frozenset()) -> bool:
        """Note what is there now; return whether units are gone.

        The results of units that are gone or changed stay on the disk, where the index finds them.
        """
        names = {u.name for u in found.units}
        gone = self.names - names
        for name in gone | changed:
            self.rows.pop(name, None)
        self.found, self.names, self.changed = found, names, set(changed)
        return bool(gone)

    @property
    def total(self) -> int:
        """Units that were found."""
        return len(self.names)

    @property
    def seconds(self) -> float:
        """Since the batch began."""
        return time.perf_counter() - self.began

    @property
    def open(self) -> int:
        """Units that were found and not finished."""
        return len(self.names - self.rows.keys())

    def work(
        self,
        units: tuple[Unit, ...],
        rows_of: Callable[[Iterator[Unit]], Iterator[dict[str, Any]]],
    ) -> None:
        """Take units through, and keep their rows."""
        self.names.update(u.name for u in units)
        by_name = {u.name: u for u in units}
        changed = self.recipe.batch_options.get("order") == "file_time"
        for made in rows_of(iter(units)):
            row = dict(made)
            if row["status"] == DISK_FULL:
                self.stop.because(DISK_FULL)
                continue
            unit = by_name[row["unit"]]
            row["groups"] = dict(unit.groups)  # of this pattern, whatever a mark of before says
            row |= {"file_time": file_time(unit)} if changed else {}
            self.rows[row["unit"]] = row
            self.changed.discard(row["unit"])
            self._report(row)
            if row.get("error") == RecipeError.__name__ and all(
                "error" in r for r in self.rows.values()
            ):
                self.wrong = row["reason"]
                self.stop.because(f"stopped: {row['reason']}")
            if self.strict and row["status"] in ("failed", "refused"):
                self.stop.because(
                    f"stopped at the first unit that failed ({one_line_name(row['unit'])})"
                )
        if self.wrong is not None:
            raise RecipeError(self.wrong)
        if self.stop.reason == DISK_FULL:
            raise WriteError(
                f"{self.task.out}: the disk is full; {len(self.rows)} of {self.total} units are done and "
                "kept: make room, then start the same batch again"
            )

    def _report(self, row: Mapping[str, Any]) -> None:
        self._worked += not row["skipped"]
        if self._tell is None:
            return
        left = self.open
        eta = left * self.seconds / self._worked if self._worked else None
        event = {k: row[k] for k in ("unit", "status", "reason", "seconds", "skipped")}
        self._tell({"done": len(self.rows), "total": self.total, **event, "eta_s": eta})


def _workers(workers: int | None) -> int:
    if workers is None:
        count: int | None = os.cpu_count()
        if hasattr(os, "sched_getaffinity"):  # a process may be held to fewer
            count = len(os.sched_getaffinity(0))
        return count or 1
    if type(workers) is not int or workers < 1:
        raise DataError(f"workers = {workers!r}: a whole number from 1 is needed")
    return workers


def _nothing(recipe: Recipe, folder: Path, found: Found) -> str:
    files = ", ".join(recipe.input.get("files", ()))
    text = f"{folder}: no file" + (f" matches {files}" if files else " of a known format")
    if found.left_out:
        text += f" and the pattern of [batch] ({len(found.left_out)} do not fit the pattern)"
    if found.closed:
        text += f"; {len(found.closed)} folder(s) in it cannot be read"
    if found.outputs:
        text += f"; {len(found.outputs)} output folder(s) of batches in it do not count"
    named = [p for p in recipe.input.get("files") or () if not any(c in p for c in "*?[")]
    hint = ""
    if named:  # such as the one of a recipe that --print-recipe printed
        every = f'"*{Path(named[0]).suffix}"'
        hint = f"; for all files of one kind write files = [{every}], or say -s 'input.files=[{every}]'"
    return f"{text}; check the folder, and 'files' of [input] in {recipe.name}{hint}"


def _rehearse(task: Task, found: Found, tell: Tell | None) -> BatchReport:
    """Return what a batch would do; nothing is written."""
    began = time.perf_counter()
    rows: list[dict[str, Any]] = []
    for unit in found.units:
        row: dict[str, Any] = {"unit": unit.name, "key": unit.key, "reason": None}
        try:
            identity = Identity(
                input_hash(unit), task.recipe_hash, units.short_version(), unit.name
            )
        except OSError as exc:
            row |= {"status": "unreadable", "reason": str(exc.strerror or exc), "link": None}
        else:
            place = identity.folder(Path(task.out), unit)
            done = earlier_row(task, unit, identity)
            link = (place / units.RESULT).relative_to(task.out).as_posix()
            row |= {"status": "to do" if done is None else "done before", "link": link}
            row |= {k: v for k, v in (done or {}).items() if k == "former_title"}
        rows.append({**row, "skipped": row["status"] == "done before", "seconds": 0.0})
        if tell is not None:
            event = {k: row[k] for k in ("unit", "status", "reason")}
            done_by_now = {"done": len(rows), "total": len(found.units), "seconds": 0.0}
            tell({**done_by_now, **event, "eta_s": None, "skipped": rows[-1]["skipped"]})
    n = Counter(r["status"] for r in rows)
    counts = {
        "total": len(rows),
        "skipped": n["done before"],
        "open": len(rows) - n["done before"],
    }
    messages = (*found.messages, *title_notes(rows))
    report = BatchReport(tuple(rows), counts, time.perf_counter() - began, 0, messages)
    return replace(report, stopped="a dry run: nothing was written")


# ---- the end of a batch: its index on the disk, and the report ---------------------------------

_APART = {
    "other_recipe": "of another recipe, or of this one before it was changed",
    "other_version": "of another version of metrosep",
    "former_content": "of former contents of files that changed",
    "gone": "of files that are gone",
    "unreadable": "of files that cannot be read now",
}


class Progress(Protocol):
    """What the end needs to know of a batch."""

    rows: dict[str, dict[str, Any]]
    names: set[str]
    changed: set[str]
    found: Found
    stop: Stop

    @property
    def total(self) -> int:
        """Units that were found."""

    @property
    def seconds(self) -> float:
        """Since the batch began."""

    @property
    def open(self) -> int:
        """Units that were found and not finished."""


def finished_report(
    recipe: Recipe, task: Task, batch: Progress, more: tuple[str, ...] = ()
) -> BatchReport:
    """Write the index and return the report."""
    document, messages = told_index(recipe, task, batch)
    rows = tuple(batch.rows[name] for name in sorted(batch.rows))
    counts = Counter(r["status"] for r in rows)
    return BatchReport(
        rows=rows,
        counts={
            "total": batch.total,
            **{s: counts.get(s, 0) for s in STATUSES},
            "skipped": sum(r["skipped"] for r in rows),
            "open": batch.open,
        },
        seconds=batch.seconds,
        exit_code=130
        if batch.stop.interrupted
        else exit_code(list(rows), closed=bool(batch.found.closed)),
        messages=(*batch.found.messages, *more, *messages, *title_notes(rows)),
        out=Path(task.out),
        stopped=batch.stop.reason,
        document=document,
    )


def told_index(
    recipe: Recipe, task: Task, batch: Progress
) -> tuple[dict[str, Any], tuple[str, ...]]:
    """Write the index in each format that the recipe wants, JSON always."""
    rows = batch.rows
    present: dict[str, str | None] = dict.fromkeys(batch.names)
    present |= dict.fromkeys(batch.changed, "")  # no result is of what is there now
    document = build_index(
        recipe,
        task.out,
        recipe_hash=task.recipe_hash,
        present={**present, **{r["unit"]: r["hash"] for r in rows.values()}},
        known=rows,
        waiting=batch.names - rows.keys(),
        left_out=batch.found.apart,
    )
    wanted = dict.fromkeys(("json", *(recipe.batch_options.get("index") or INDEX_FORMATS)))
    lost = []
    for name in wanted:
        try:
            write_index(document, Path(task.out) / f"index.{name}", name)
        # a table that Excel holds, a writer with a fault: no verdict is lost
        except Exception as exc:
            if name == "json":
                raise
            kind = "" if isinstance(exc, MetrosepError) else f"{type(exc).__name__}: "
            lost.append(f"index.{name} was not written: {kind}{' '.join(str(exc).split())}")
    return document, (*lost, *_messages(document))


def _one_number(recipe: Recipe, found: Found) -> tuple[str, ...]:
    """Return that the reports of several units would have one number."""
    number = {**recipe.report, **recipe.typed}.get("number", "")
    if not number or "{" in number or len(found.units) < 2:
        return ()
    return (
        (
            f'[report] number = "{number}" is the same for {len(found.units)} units, and a report is known '
            f'by its number; put a part of the name into it: "{number}-{{file}}"'
        ),
    )


def _messages(document: Mapping[str, Any]) -> Iterator[str]:
    for kind, n in document["apart"].items():
        if n:
            yield f"{n} result(s) in the output folder are kept apart and not counted: {_APART[kind]}"
    yield from order_notes(document)
    names = {
        c.get(k)
        for r in document["rows"]
        for c in r["characteristics"]
        for k in ("name", "metric", "symbol")
    }
    for name in document["trend"]:
        if names and name not in names:
            shown = ", ".join(sorted(n for n in names if n)[:8])
            yield f'trend "{name}": no result has a characteristic of this name; there are {shown}'


# ---- one batch at a time in an output folder ---------------------------------------------------

_NAME = ".metrosep-batch.lock"


@contextmanager
def locked(out: Path) -> Iterator[None]:
    """Hold an output folder; made if needed."""
    try:
        out.mkdir(parents=True, exist_ok=True)
        handle = os.open(out / _NAME, os.O_RDWR | os.O_CREAT, 0o666)
    except OSError as exc:
        raise WriteError(
            f"{out}: the output folder cannot be written ({exc.strerror or exc}); choose another "
            "with -o",
            exc,
        ) from None
    try:
        if not take_lock(handle):
            raise WriteError(
                f"{out}: another batch works in this folder; wait for its end, or choose another "
                "folder with -o"
            )
        yield
    finally:
        os.close(handle)


# ---- units as they come: those of a folder once, or of a hot folder until the batch is stopped ----

_NAP_SECONDS = 0.1
_MOST_LOOKS = 64


def new_units(
    recipe: Recipe,
    folder: Path,
    out: Path,
    *,
    every: float | None,
    stop: Stop,
    first: Found,
    rows: Mapping[str, Mapping[str, Any]] | None = None,
    look: Callable[[Found, frozenset[str]], bool] | None = None,
) -> Iterator[tuple[Unit, ...]]:
    """Yield units that are new or changed, again and again."""
    if every is None:
        yield first.units
        return
    seen: dict[str, object] = {}
    taken: dict[str, object] = {}
    handed: dict[str, object] = {}
    patience = _Patience({} if rows is None else rows)
    while not stop:
        ready = []
        found = find_units(recipe, folder, out=out)
        states = {unit.name: _state(unit) for unit in found.units}
        gone = look is not None and look(found, _changed(states, handed))
        for unit in found.units:
            state = states[unit.name]
            if unit.name in taken and patience.is_over(unit.name):
                del taken[unit.name]
            if state is not None and seen.get(unit.name) == state != taken.get(unit.name):
                ready.append(unit)
                taken[unit.name] = handed[unit.name] = state
            seen[unit.name] = state
        if ready or gone:
            yield tuple(ready)
        _sleep(every, stop)
    with contextlib.suppress(ReadError):  # a folder that went at the end: what was found stays
        found = find_units(recipe, folder, out=out)
        if look is not None:
            look(found, _changed({u.name: _state(u) for u in found.units}, handed))


def _changed(states: Mapping[str, object], handed: Mapping[str, object]) -> frozenset[str]:
    """Return the units whose files are not those any more that were handed out."""
    return frozenset(n for n, s in states.items() if n in handed and handed[n] != s)


def file_time(unit: Unit) -> str | None:
    """Return when the first of the files of a unit was changed for the last time."""
    try:
        first = min(os.stat(f).st_mtime for f in unit.files)  # noqa: PTH116
    except OSError:
        return None
    return datetime.fromtimestamp(first, UTC).isoformat()


class _Patience:
    """Looks until a unit that failed for a reason from outside is tried once more."""

    def __init__(self, rows: Mapping[str, Mapping[str, Any]]) -> None:
        self._rows = rows
        self._tries: dict[str, int] = {}
        self._looks: dict[str, int] = {}

    def is_over(self, name: str) -> bool:
        """Count one look."""
        if not self._rows.get(name, {}).get("again"):
            self._tries.pop(name, None)
            self._looks.pop(name, None)
            return False
        tries = self._tries.setdefault(name, 0)
        self._looks[name] = self._looks.get(name, 0) + 1
        if self._looks[name] < min(2**tries, _MOST_LOOKS):
            return False
        self._tries[name], self._looks[name] = tries + 1, 0
        return True


def _state(unit: Unit) -> object:
    try:
        files = files_read(unit)
        found = [os.stat(f) for f in files]  # noqa: PTH116
    except OSError:
        return None
    return tuple((f, s.st_size, s.st_mtime_ns) for f, s in zip(files, found, strict=True))


def _sleep(seconds: float, stop: Stop) -> None:
    end = time.monotonic() + seconds
    while not stop and (left := end - time.monotonic()) > 0.0:
        time.sleep(min(_NAP_SECONDS, left))
