"""One unit of a batch, carried out by a worker: read, measure, judge, write, mark as done."""

from __future__ import annotations

import contextlib
import hashlib
import os
import secrets
import shutil
import time
from collections.abc import Mapping
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from typing import TYPE_CHECKING, Any

from metrosep._version import __version__
from metrosep.batch import marks, memory
from metrosep.batch.failures import (
    ChangedError,
    as_reason,
    exit_code_of,
    is_disk_full,
    worth_another_try,
)
from metrosep.batch.marks import FAILED, RESULT, Identity, unit_record
from metrosep.batch.names import is_utf8
from metrosep.batch.rows import row_of
from metrosep.batch.titles import former_title
from metrosep.batch.units import Unit, files_read
from metrosep.core.blas import one_thread
from metrosep.core.errors import MetrosepError, ReadError, RecipeError, WriteError

if TYPE_CHECKING:
    from metrosep.recipe.recipe import Recipe

__all__ = ["DISK_FULL", "Task", "do_unit", "earlier_row", "input_hash", "record_failure"]

DISK_FULL = "disk full"
"""Status of a row that stops the whole batch."""

STAGE = ".metrosep-"


@dataclass(frozen=True, slots=True)
class Task:
    """What a worker needs to know; small, so that sending it costs nothing."""

    text: str  # of the recipe, as `Recipe.parse` takes them
    name: str
    folder: str
    recipe_hash: str  # what the recipe must come to; another one was changed meanwhile
    out: str  # output folder
    workers: int  # how many share the memory
    resume: bool = True  # whether what is done stays


def do_unit(task: Task, unit: Unit) -> dict[str, Any]:
    """Carry out the recipe on one unit; the outcome is on the disk when this returns.

    Notes
    -----
    Nothing is raised: whatever fails is a row. result.json comes last, by one rename, so a unit
    that has it is done.
    """
    began = time.perf_counter()
    identity = Identity("", task.recipe_hash, marks.short_version(), unit.name)
    try:
        before = _stamps(unit)
        identity = Identity(input_hash(unit), task.recipe_hash, marks.short_version(), unit.name)
        done = earlier_row(task, unit, identity)
        if done is not None:
            return {**done, "seconds": time.perf_counter() - began, "skipped": True}
        _require_utf8(unit)
        refusal = _memory_refusal(task, unit)
        if refusal is not None:
            row = record_failure(task, unit, refusal, status="refused", identity=identity)
        else:
            with one_thread():
                row = _carry_out(task, unit, identity, before)
    except Exception as exc:  # every failure of a unit becomes its row
        row = record_failure(task, unit, exc, identity=identity)
    return {**row, "seconds": time.perf_counter() - began, "skipped": False}


def record_failure(
    task: Task,
    unit: Unit,
    error: BaseException,
    *,
    status: str = "failed",
    identity: Identity | None = None,
) -> dict[str, Any]:
    """Write failed.json of a unit and return its row."""
    if identity is None:
        with contextlib.suppress(OSError, MetrosepError):
            identity = Identity(
                input_hash(unit), task.recipe_hash, marks.short_version(), unit.name
            )
    identity = identity or Identity("", task.recipe_hash, marks.short_version(), unit.name)
    folder = identity.folder(Path(task.out), unit)
    document = marks.failed_document(
        unit_record(unit, identity),
        status=status,
        code=exit_code_of(error),
        kind=type(error).__name__,
        reason=as_reason(error, unit),
        again=status == "refused" or worth_another_try(error),
    )
    row = row_of(document, _link(folder, task, FAILED))
    if is_disk_full(error):
        return {**row, "status": DISK_FULL}
    try:
        marks.write_mark(folder, FAILED, document)
    except (WriteError, OSError) as exc:
        if is_disk_full(exc):
            return {**row, "status": DISK_FULL}
        reason = f"{row['reason']} (and failed.json cannot be written: {exc})"
        return {**row, "reason": reason, "link": None}
    return row


def input_hash(unit: Unit) -> str:
    """Return the SHA-256 of a unit's input."""
    hashes = []
    files = files_read(unit)
    for file in files:
        with open(file, "rb") as handle:  # noqa: PTH123
            hashes.append(hashlib.file_digest(handle, "sha256").hexdigest())
    if files == (unit.target,):
        return hashes[0]
    names = [os.path.relpath(f, unit.target) for f in files]
    lines = "".join(f"{n}\0{h}\n" for n, h in zip(names, hashes, strict=True))
    return hashlib.sha256(lines.encode("utf-8", "surrogateescape")).hexdigest()


def earlier_row(task: Task, unit: Unit, identity: Identity) -> dict[str, Any] | None:
    """Return the row of what an earlier run finished."""
    if not task.resume:
        return None
    folder = identity.folder(Path(task.out), unit)
    for name in (RESULT, FAILED):
        found = marks.read_mark(folder, name)
        if found is None or found["unit"].get("hash") != identity.digest:
            continue
        if name == FAILED and (found.get("again", True) or found.get("metrosep") != __version__):
            continue
        return {**row_of(found, _link(folder, task, name)), **former_title(found, task.text)}
    return None


def _require_utf8(unit: Unit) -> None:
    if not is_utf8(unit):
        raise ReadError(f"{unit.name}: the name is not UTF-8; rename the file")


def _memory_refusal(task: Task, unit: Unit) -> MemoryError | None:
    free = memory.available_bytes()
    wanted = memory.wanted_bytes(files_read(unit))
    share = None if free is None else free // task.workers
    if share is None or wanted <= share:
        return None
    return _TooLargeError(
        f"{unit.name}: its input wants about {wanted / 1e9:.3g} GB of memory, and each of "
        f"{task.workers} worker(s) has {share / 1e9:.3g} GB; use fewer workers (--workers 1) or a "
        "larger machine"
    )


class _TooLargeError(MetrosepError, MemoryError):
    """A unit that was not begun since it would not fit."""


def _carry_out(
    task: Task, unit: Unit, identity: Identity, before: Mapping[str, tuple[int, int]]
) -> dict[str, Any]:
    from metrosep.recipe.outputs import table_names
    from metrosep.recipe.reading_words import in_recipe_words
    from metrosep.recipe.run import run_recipe

    recipe = _recipe(task.text, task.name, task.folder, task.recipe_hash)
    folder = identity.folder(Path(task.out), unit)
    folder.mkdir(parents=True, exist_ok=True)
    for stale in folder.glob(f"{STAGE}*"):  # of a worker that was killed
        shutil.rmtree(stale, ignore_errors=True)
    stage = folder / f"{STAGE}{secrets.token_hex(6)}"
    stage.mkdir()
    try:
        inside = stage if recipe.outputs else None
        told = {"unit": unit_record(unit, identity)}  # in the reports too: made again, same bytes
        with in_recipe_words(recipe):
            done = run_recipe(
                recipe, unit.target, out=inside, progress=None, with_result=False, more=told
            )
        document = done.document
        _require_unchanged(unit, before, identity, document)
        _keep_tables(stage, folder, table_names(recipe), fresh=not task.resume)
        (folder / RESULT).unlink(missing_ok=True)
        for file in sorted(stage.iterdir()):
            file.replace(folder / file.name)
        marks.write_mark(folder, RESULT, document)
    finally:
        shutil.rmtree(stage, ignore_errors=True)
    (folder / FAILED).unlink(missing_ok=True)
    return row_of(document, _link(folder, task, RESULT))


def _keep_tables(stage: Path, folder: Path, names: list[str], *, fresh: bool) -> None:
    """Keep tables that are replaced because all is done again; otherwise refuse to replace them."""
    from metrosep.recipe.outputs import keep_replaced

    try:
        keep_replaced(stage, folder, names, overwrite=fresh)
    except WriteError as exc:
        exc.args = (str(exc).replace("say overwrite", "do all again (--fresh)"),)
        raise


@lru_cache(maxsize=4)
def _recipe(text: str, name: str, folder: str, expected: str) -> Recipe:
    """Return the recipe, made once in each worker."""
    from metrosep.recipe.outputs import recipe_hash
    from metrosep.recipe.recipe import Recipe

    recipe = Recipe.parse(text, name=name, folder=folder)
    if recipe_hash(recipe) != expected:
        raise RecipeError(
            f"{name}: a file that it names changed during the batch; start the batch again"
        )
    return recipe


def _stamps(unit: Unit) -> dict[str, tuple[int, int]]:
    stamps = {}
    for file in files_read(unit):
        found = os.stat(file)  # noqa: PTH116
        stamps[file] = (found.st_size, found.st_mtime_ns)
    return stamps


def _require_unchanged(
    unit: Unit,
    before: Mapping[str, tuple[int, int]],
    identity: Identity,
    document: Mapping[str, Any],
) -> None:
    try:
        after = _stamps(unit)
    except OSError as exc:
        raise ChangedError(
            f"{unit.name}: vanished while it was read ({exc.strerror or exc}); copy it again"
        ) from None
    grown = [f for f in sorted({**before, **after}) if after.get(f) != before.get(f)]
    name = Path(unit.target).name  # a reader may turn to a file beside it, which has another hash
    read = {i.get("sha256") for i in document.get("inputs", ()) if i.get("name") == name} - {None}
    single = tuple(before) == (unit.target,)
    if grown or (single and read and identity.input_hash not in read):
        name = Path(grown[0]).name if grown else name
        raise ChangedError(
            f"{unit.name}: {name} changed while it was read; wait until the instrument has written "
            "it, then resume"
        )


def _link(folder: Path, task: Task, name: str) -> str:
    return (folder / name).relative_to(task.out).as_posix()
