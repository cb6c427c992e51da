"""The recipe on every file of a folder: progress, and the index of the batch."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from metrosep.app.documents import Edit, RecipeDocument
from metrosep.app.messages import Answer, Cancel, Message, Tell, number_or_none, plain, text_of
from metrosep.app.sessions import Session
from metrosep.core.errors import DataError, ReadError
from metrosep.recipe.recipe import Recipe

__all__ = ["run_folder"]

_SHOWN = (
    "unit", "key", "status", "verdict", "reason", "link", "skipped", "seconds", "characteristics",
)  # fmt: skip


def run_folder(session: Session, message: Message, cancel: Cancel, tell: Tell) -> Answer:
    """Answer a request ``run_folder``."""
    from metrosep.batch import run_batch

    opened, document = session.need()
    if not opened.files:
        raise DataError("this recipe reads no input: there is no folder to run it on")
    folder = _folder(session, text_of(message, "folder"))
    out = session.places.writable(text_of(message, "out"))
    # a set of runs in several files is a folder; a file that holds all its runs is a unit by itself
    each = "folder" if opened.kind == "runs" and len(opened.files) > 1 else "file"
    recipe = recipe_of_folder(document, _pattern(message, opened.files[0]), each)
    workers = message.get("workers")
    if workers is not None and (isinstance(workers, bool) or not isinstance(workers, int)):
        raise DataError(f"workers = {workers!r}: a whole number from 1 is needed")
    report = run_batch(
        recipe,
        folder,
        out=out,
        workers=workers,
        scheduler=str(message.get("scheduler") or "processes"),
        fresh=message.get("fresh") is True,
        dry_run=message.get("dry_run") is True,
        tell=lambda event: tell({"k": "progress", "batch": plain(event)}),
        cancel=cancel,
    )
    return {
        "rows": [_row(row) for row in report.rows],
        "counts": dict(report.counts),
        "summary": report.summary(),
        "messages": list(report.messages),
        "stopped": report.stopped,
        "exit_code": report.exit_code,
        "each": each,
        "folder": str(folder),
        "out": str(out),
        "files": [] if report.out is None else sorted(str(f) for f in out.glob("index.*")),
    }, {}


def recipe_of_folder(document: RecipeDocument, pattern: str, each: str = "file") -> Recipe:
    """Return the recipe of a session for all files of a pattern; the session keeps its own."""
    made = document.anew()
    files = list(document.recipe.input.get("files", ()))
    held = document.recipe.batch_options.get("each")
    edits = [Edit(("input", "files"), files or None, [pattern])]
    if held != each:
        edits.append(Edit(("batch", "each"), held, each))
    made.edit(edits)
    return made.recipe


def _pattern(message: Message, file: Path) -> str:
    given = message.get("pattern")
    if given in (None, ""):
        return f"*{file.suffix}" if file.suffix else "*"
    if not isinstance(given, str) or "/" in given or "\\" in given:
        raise DataError(f"pattern is of names of files, such as *.sdf; got {given!r}")
    return given


def _folder(session: Session, path: str) -> Path:
    found = session.places.inside(path)
    if found is None:
        raise ReadError(
            f"{path}: lies outside the folders that were opened; start metrosep with --folder"
        )
    if not found.is_dir():
        raise ReadError(f"{path}: there is no such folder")
    return found


def _row(row: Mapping[str, Any]) -> dict[str, Any]:
    shown: dict[str, Any] = {k: plain(row[k]) for k in _SHOWN if k in row}
    shown["seconds"] = number_or_none(row.get("seconds"))
    return shown
