"""Files that the user asks for: the recipe, its result."""

from __future__ import annotations

import glob
import os
import threading
import tomllib
from collections.abc import Callable, Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any
from weakref import WeakKeyDictionary

import numpy as np

from metrosep.app.documents import Edit, RecipeDocument, refuse_open, refuse_other_result
from metrosep.app.evaluations import Evaluations
from metrosep.app.opening import Opened
from metrosep.app.separations import MethodResults
from metrosep.app.sessions import Session, mark_of
from metrosep.app.wire import Answer, Cancel, Message, Tell, number_or_none, plain, text_of
from metrosep.core.errors import DataError, ReadError, UnsupportedFeatureError
from metrosep.core.methods import METHODS
from metrosep.core.readable import said_value
from metrosep.recipe.pipeline import CancelledError
from metrosep.recipe.recipe import Recipe
from metrosep.recipe.result import Result


def export(session: Session, message: Message, cancel: Cancel, tell: Tell) -> Answer:
    """Answer a request ``export``."""
    opened, document = session.need()
    what, path = message.get("what"), text_of(message, "path")
    if what == "recipe":
        target = session.target(path, recipe=True)
        if target.suffix.lower() != ".toml":  # onto a measurement, it would be gone
            raise DataError(
                f"{target.name}: the name of a recipe ends in .toml; choose another name"
            )
        if target.exists() and not message.get("overwrite"):
            raise DataError(f"{target.name}: exists already; choose another name or overwrite it")
        lasting = not any(session.places.is_upload(f) for f in opened.files)
        moved = _moved(session, document, target.parent) if lasting else document
        moved.save(target)
        document.rename(target.name)
        session.saved(target)
        return {"files": [str(target)], "session": session.state()}, {}
    if what == "result":
        target = session.target(path)
        refuse_other_result(target)
        for name in _outputs(document):
            refuse_open(target / name, opened)
        inputs = None if document.recipe.reads_nothing else list(opened.files)
        result = document.recipe.run(
            inputs, out=target, progress=lambda text: tell({"k": "progress", "text": text})
        )
        return {"files": [str(f) for f in result.files], "verdict": result.verdict}, {}
    raise UnsupportedFeatureError(
        f"export of {said_value(what)} is not in this version: recipe or result; a table is exported by 'table'"
    )


def _outputs(document: RecipeDocument) -> list[str]:
    """Return the names that a result writes besides its own."""
    named = [str(o["path"]) for o in document.recipe.outputs if o.get("path")]
    return [n for n in named if n != "-"]


def _moved(session: Session, document: RecipeDocument, folder: Path) -> RecipeDocument:
    """Return a recipe that names the files it reads as they are seen from another folder.

    Names within one opened folder are relative, so that all may be moved together; others are whole.
    """
    here, there = Path(os.path.realpath(document.folder)), Path(os.path.realpath(folder))
    if here == there:
        return document
    data = tomllib.loads(document.text)
    if "extends" in data:
        raise DataError(
            f"the recipe builds on {data['extends']} beside it; save it in the same folder ({here})"
        )
    way = _way(session, here, there)
    edits = []
    found = document.recipe.input.get("files")
    if found is not None:
        files = [f for name in found for f in _patterns(here, way, name)]
        edits.append(Edit(("input", "files"), data.get("input", {}).get("files"), files))
    for i, step in enumerate(data.get("step", [])):
        for key in _file_keys(step["op"]) & set(step):
            if not Path(step[key]).is_absolute() and (here / step[key]).is_file():
                new = (way / step[key]).as_posix()
                edits.append(Edit(("step", i, key), step[key], new))
    made = RecipeDocument(document.text, there, document.name, document.admits)
    if edits:
        made.edit(edits)
    return made


def _way(session: Session, here: Path, there: Path) -> Path:
    """Return the folder of the files as it is seen from another one."""
    for root in session.places.roots:
        if here.is_relative_to(root) and there.is_relative_to(root):
            return Path(os.path.relpath(here, there))
    return here


def _patterns(here: Path, way: Path, name: str) -> list[str]:
    """Return a name of ``[input] files`` from another folder; a whole path holds no pattern."""
    if Path(name).is_absolute():
        return [name]
    if way.is_absolute():
        return sorted(f.as_posix() for f in here.glob(name) if f.is_file())
    return [f"{glob.escape(way.as_posix())}/{name}"]


def _file_keys(op: str) -> set[str]:
    """Return the keys of a step that name a file beside the recipe."""
    method = METHODS.get(op)
    return set() if method is None else {k for k, f in method.fields.items() if f.kind == "file"}


# ---- the report of the present result: shown in the page, and written where the user says ------


def report(session: Session, message: Message, cancel: Cancel, tell: Tell) -> Answer:
    """Answer a request ``report``."""
    from metrosep.recipe.preflight import report_formats

    opened, document = session.need()
    writers = report_formats()
    target, name = None, str(message.get("format") or "html")
    if "write" in message:
        target = session.target(text_of(message, "write"))
        if name not in writers:
            raise DataError(
                f"there is no report format {name!r}; there are {', '.join(sorted(writers))}"
            )
        if target.is_dir():
            raise DataError(f"{target.name}: is a folder; name a file in it")
        if target.exists() and not message.get("overwrite"):
            raise DataError(f"{target.name}: exists already; choose another name or overwrite it")
    recipe = document.recipe
    result = result_of(opened, recipe, cancel, tell)
    header: dict[str, Any] = {
        "formats": sorted(writers, key=lambda f: (f != "html", f)),
        "verdict": result.verdict,
        "title": result.document["title"],
        "hash": mark_of(opened, recipe),
    }
    if cancel():
        raise CancelledError("stopped before the report was made")
    tell({"k": "progress", "words": "making the report"})
    if target is not None:
        writers[name].load()(dict(result.document), target)
        return {**header, "files": [str(target)]}, {}

    def make() -> bytes:
        from metrosep.report import render_html

        return render_html(result.document).encode("utf-8")

    page = made_of(opened.material, "report", _told(opened, recipe), make)
    return header, {"html": np.frombuffer(page, dtype=np.uint8)}


# ---- the result of the present recipe on the full data, made once, whatever is open ------------

_MOST = 4
"""Results and reports of one measurement that are remembered: undo shows them at once."""

_KEPT: WeakKeyDictionary[Any, dict[str, dict[str, Any]]] = WeakKeyDictionary()
_LOCK = threading.RLock()


def full_result(session: Session, cancel: Cancel, tell: Tell) -> Result:
    """Return what the recipe of a session makes of the full data; nothing is written."""
    opened, document = session.need()
    return result_of(opened, document.recipe, cancel, tell)


def result_of(opened: Opened, recipe: Recipe, cancel: Cancel, tell: Tell) -> Result:
    """Return what a recipe makes of what was opened, as `metrosep run` has it."""
    from metrosep.recipe.report_fields import report_of

    found = _numbers_of(opened, recipe, cancel, tell)
    material = opened.material
    if isinstance(material, MethodResults):  # a run of its own, with all that a report states
        return found
    source = material.obj if isinstance(material, Evaluations) else material.runs(recipe)
    stated = report_of(recipe, opened.files, found.document, source.metadata)
    return replace(found, document={**found.document, **stated})


def _numbers_of(opened: Opened, recipe: Recipe, cancel: Cancel, tell: Tell) -> Result:
    """Return what follows from the data and the steps: it is made once, whatever a report states."""
    material = opened.material
    if not isinstance(material, Evaluations):
        tell({"k": "progress", "words": "computing"})
        return material.result(recipe, cancel)

    def make() -> Result:
        from metrosep.recipe.pipeline_run import Measurement, measured_result, step_error

        outcome = material.outcome(
            recipe.steps,
            "full",
            cancel=cancel,
            tell=lambda text: tell({"k": "progress", "words": text}),
        )
        if outcome.error is not None and outcome.failed is not None:
            raise step_error(outcome.error, recipe, outcome.failed) from None
        return measured_result(recipe, Measurement(outcome.source, outcome.stages))

    found: Result = made_of(material, "result", recipe.recorded["text"], make)
    return found


def _told(opened: Opened, recipe: Recipe) -> str:
    """Return what a page follows from: the recipe, its [report] and the head that lies beside the file."""
    from metrosep.recipe.report_fields import report_hash

    return f"{recipe.recorded['text']}\0{report_hash(recipe, opened.files)}"


def made_of(
    material: Any, what: str, text: str, make: Callable[[], Any], *, most: int = _MOST
) -> Any:
    """Return what was made of a measurement by a recipe, made once and forgotten with it."""
    with _LOCK:
        kept = _KEPT.setdefault(material, {}).setdefault(what, {})
        if text in kept:
            kept[text] = kept.pop(text)  # the latest stand last
            return kept[text]
    made = make()
    with _LOCK:
        kept[text] = made
        while len(kept) > most:
            kept.pop(next(iter(kept)))
    return made


# ---- the recipe on every file of a folder: progress, and the index of the batch ----------------

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
    session.places.require_own(Path(p, n) for p, _, names in os.walk(folder) for n in names)
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
        raise DataError(f"pattern is of names of files, such as *.sdf; got {said_value(given)}")
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
