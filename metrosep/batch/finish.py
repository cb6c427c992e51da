"""The end of a batch: its index on the disk, and the report."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any, Protocol

from metrosep.batch.index import build_index, write_index
from metrosep.batch.loop import Stop
from metrosep.batch.report import BatchReport
from metrosep.batch.rows import STATUSES, exit_code
from metrosep.batch.titles import title_notes
from metrosep.batch.units import Found
from metrosep.batch.work import Task
from metrosep.core.errors import MetrosepError
from metrosep.recipe.part_order import order_notes
from metrosep.recipe.recipe import Recipe

__all__ = ["Progress", "finished_report", "told_index"]

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
    wanted = dict.fromkeys(("json", *(recipe.batch_options.get("index") or ("csv",))))
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
