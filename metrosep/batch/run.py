"""`run_batch`: one recipe over a folder of thousands of files."""

from __future__ import annotations

import os
import time
from collections import Counter
from collections.abc import Callable, Iterator, Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

from metrosep.batch import marks
from metrosep.batch.executors import executor, parse_scheduler
from metrosep.batch.finish import finished_report, told_index
from metrosep.batch.index import format_error
from metrosep.batch.lock import locked
from metrosep.batch.loop import Stop, work_through
from metrosep.batch.marks import Identity
from metrosep.batch.names import one_line_name
from metrosep.batch.output_folders import record_source, require_own_source
from metrosep.batch.report import BatchReport
from metrosep.batch.titles import title_notes
from metrosep.batch.units import Found, Unit, find_units
from metrosep.batch.watch import file_time, new_units
from metrosep.batch.work import DISK_FULL, Task, earlier_row, input_hash
from metrosep.core.errors import DataError, ReadError, RecipeError, WriteError
from metrosep.recipe.guard_room import guard_notes
from metrosep.recipe.hashing import recipe_hash
from metrosep.recipe.recipe import Recipe

__all__ = ["run_batch"]

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
    """Carry out a recipe on every unit of a folder.

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
    if watch is not None and not watch > 0.0:
        raise DataError(f"watch = {watch!r}: seconds between two looks are needed, such as 5")
    source, target = Path(folder), Path(os.path.abspath(out))  # noqa: PTH100
    if target.resolve() == source.resolve():
        raise WriteError(
            f"{out}: is the input folder itself; results would be taken for inputs; choose another"
        )
    found = find_units(loaded, source, out=target)
    if not found.units and watch is None:
        raise ReadError(_nothing(loaded, source, found))
    first = (*require_own_source(target, source), *guard_notes(loaded))
    task = Task(
        text=loaded.text,
        name=loaded.name,
        folder=str(loaded.folder.resolve()),
        recipe_hash=recipe_hash(loaded),
        out=str(target),
        workers=1 if kind == "serial" or address is not None else count,
        resume=resume and not fresh,
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
    return f"{text}; check the folder, and 'files' of [input] in {recipe.name}"


def _rehearse(task: Task, found: Found, tell: Tell | None) -> BatchReport:
    """Return what a batch would do; nothing is written."""
    began = time.perf_counter()
    rows: list[dict[str, Any]] = []
    for unit in found.units:
        row: dict[str, Any] = {"unit": unit.name, "key": unit.key, "reason": None}
        try:
            identity = Identity(
                input_hash(unit), task.recipe_hash, marks.short_version(), unit.name
            )
        except OSError as exc:
            row |= {"status": "unreadable", "reason": str(exc.strerror or exc), "link": None}
        else:
            place = identity.folder(Path(task.out), unit)
            done = earlier_row(task, unit, identity)
            link = (place / marks.RESULT).relative_to(task.out).as_posix()
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
