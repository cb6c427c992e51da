"""Files that the user asks for: the recipe, its result."""

from __future__ import annotations

import glob
import os
import tomllib
from pathlib import Path

from metrosep.app.documents import Edit, RecipeDocument, refuse_open, refuse_other_result
from metrosep.app.messages import Answer, Cancel, Message, Tell, text_of
from metrosep.app.sessions import Session
from metrosep.core.errors import DataError, UnsupportedFeatureError
from metrosep.core.methods import METHODS

__all__ = ["export"]


def export(session: Session, message: Message, cancel: Cancel, tell: Tell) -> Answer:
    """Answer a request ``export``."""
    opened, document = session.need()
    what, path = message.get("what"), text_of(message, "path")
    if what == "recipe":
        target = session.target(path, recipe=True)
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
        f"export of {what!r} is not in this version: recipe or result; a table is exported by 'table'"
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
    made = RecipeDocument(document.text, there, document.name)
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
