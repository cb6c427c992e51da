"""The files that the page may open: folders and files below the opened folders, recent ones, small pictures.

Nothing is written but the list of recent files, in the user's folder of state. What a link points to
outside the opened folders is not listed; what is no plain file is not looked into.
"""

from __future__ import annotations

import json
import os
import stat
from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from metrosep.app.documents import Places
from metrosep.app.opening import state_folder
from metrosep.app.sessions import Session
from metrosep.app.wire import Answer, Cancel, Message, Tell
from metrosep.core._thumbnails import map_thumbnail, profile_thumbnail
from metrosep.core.atomic import atomic_write
from metrosep.core.errors import DataError, MetrosepError, ReadError
from metrosep.core.profile import Profile
from metrosep.core.readable import said_value
from metrosep.core.surface import Surface

_PAGE, _MOST = 200, 2000
"""Rows that are sent at once; of a folder at most."""
_RECENT = 20
_LARGEST_PICTURE = 300_000_000
"""Bytes of a file that is read for a small picture."""
_OTHER = {".toml": "recipe", ".json": "result", ".html": "report", ".pdf": "report"}
"""Kinds of what is no measurement, by the end of its name."""


@dataclass(frozen=True, slots=True)
class _Entry:
    path: Path
    is_folder: bool
    size: int  # bytes
    seconds: float  # since 1970: when it was changed last


def listing(session: Session, message: Message, cancel: Cancel, tell: Tell) -> Answer:
    """Answer a request ``list``: a part of a folder, folders first, with what the files are."""
    places = session.places
    text, first = str(message.get("text") or "").casefold(), message.get("from") or 0
    if isinstance(first, bool) or not isinstance(first, int) or first < 0:
        raise DataError(f"from is the number of a row, got {said_value(first)}")
    folder = _folder(session, message.get("path"))
    found = sorted(
        (e for e in _entries(places, folder) if text in e.path.name.casefold()),
        key=lambda e: (not e.is_folder, e.path.name.casefold()),
    )
    rows = []
    for entry in found[first : min(first + _PAGE, _MOST)]:
        if cancel():
            break
        kind = "folder" if entry.is_folder else _kind_of(entry.path)
        if not _can_be_named(entry.path):
            kind = ""
        rows.append({**_row(entry), "kind": kind})
    is_root = folder in places.roots
    return {
        "path": str(folder),
        "up": None if is_root else str(folder.parent),
        "roots": [str(root) for root in places.roots if not places.is_upload(root)],
        "rows": rows,
        "total": len(found),
        "shown": min(len(found), _MOST),
        "recent": [p for p in _recent() if all(places.inside(one) for one in p)],
    }, {}


def thumbnail(session: Session, message: Message, cancel: Cancel, tell: Tell) -> Answer:
    """Answer a request ``thumbnail``: a small PNG of a map or profile, read as `metrosep info` would."""
    from metrosep.io.read import read_one

    path = session.places.readable(str(message.get("path") or ""))
    size = path.stat().st_size
    if size > _LARGEST_PICTURE:
        raise ReadError(
            f"{path.name}: has {size / 1e6:.0f} MB, too many for a small picture; open it"
        )
    obj = read_one(path)
    if isinstance(obj, Surface):
        picture, _ = map_thumbnail(obj.z, obj.dx, obj.dy)
        words = f"map, {obj.shape[1]} × {obj.shape[0]}"
    elif isinstance(obj, Profile):
        picture, words = profile_thumbnail(obj.x, obj.z), f"profile, {len(obj)} samples"
    else:
        return {"words": type(obj).__name__.lower()}, {}
    return {"words": words}, {"png": np.frombuffer(picture, dtype=np.uint8)}


def latest(session: Session, message: Message, cancel: Cancel, tell: Tell) -> Answer:
    """Answer a request ``latest``: the file that is open as it stands now, or the newest like it beside it."""
    opened, _ = session.need()
    if len(opened.files) != 1:
        raise DataError("one file of a map or profile can be followed; this is a set, or a method")
    file = opened.files[0]
    if message.get("of") == "folder":
        entries = [e for e in _entries(session.places, file.parent) if not e.is_folder]
        found = [e for e in entries if e.path.suffix.lower() == file.suffix.lower()]
    else:
        found = _followed(session.places, file)
    found = [e for e in found if _can_be_named(e.path)]
    if not found:
        return {"path": None}, {}
    newest = max(found, key=lambda e: (e.seconds, e.path.name))
    facts, read = newest.path.stat(), opened.stamps
    stamp = f"{newest.path} {facts.st_size} {facts.st_mtime_ns}"
    is_open = bool(read) and stamp == f"{read[0].file} {read[0].size} {read[0].mtime_ns}"
    return {"path": str(newest.path), "stamp": stamp, "is_open": is_open}, {}


def remember(session: Session) -> None:
    """Put what is open first into the list of recent files; nothing depends on it."""
    opened, _ = session.need()
    if session.places.is_upload(opened.home):
        return
    paths = (
        [str(opened.home)]
        if opened.kind == "method" or not opened.files
        else [str(f) for f in opened.files]
    )
    rest = [p for p in _recent() if p != paths]
    with suppress(OSError, MetrosepError):
        file = _list()
        file.parent.mkdir(parents=True, exist_ok=True)
        text = json.dumps([paths, *rest][:_RECENT], indent=1)
        atomic_write(file, text.encode())


def _list() -> Path:
    return state_folder().parent / "recent.json"


def _recent() -> list[list[str]]:
    """Return the files of the last openings, each a list; what is damaged counts as empty."""
    try:
        found = json.loads(_list().read_text(encoding="utf-8"))
    except (OSError, ValueError):
        return []
    if not isinstance(found, list):
        return []
    good = [p for p in found if isinstance(p, list) and p and all(isinstance(v, str) for v in p)]
    return [p for p in good if all(Path(v).is_file() for v in p)][:_RECENT]


def _folder(session: Session, path: Any) -> Path:
    """Return a folder inside the opened ones; where none is named, that of what is open."""
    places = session.places
    if not path:
        home = None if session.opened is None else session.opened.home.parent
        inside = home is not None and places.inside(str(home)) and not places.is_upload(home)
        path = str(home) if inside else _last_folder(places)
    found = places.inside(str(path))
    if found is None:
        words = ", ".join(map(str, places.roots)) or "none"
        raise ReadError(
            f"{path}: lies outside the folders that were opened ({words}); add its folder with --folder, "
            "or drop the file onto the page"
        )
    if not found.is_dir():
        raise ReadError(f"{path}: is not a folder")
    return found


def _last_folder(places: Places) -> str:
    """Return the folder that was opened last of those that may be; else the first of them."""
    last = (str(Path(p[0]).parent) for p in _recent())
    first = [str(root) for root in places.roots]
    return next((f for f in (*(f for f in last if places.inside(f)), *first)), "")


def _entries(places: Places, folder: Path) -> Sequence[_Entry]:
    """Return plain files and folders, links followed first; hidden ones and what cannot be read are left out."""
    found = []
    try:
        with os.scandir(folder) as names:
            for one in names:
                if one.name.startswith("."):
                    continue
                with suppress(OSError):
                    path = Path(one.path)
                    if one.is_symlink() and places.inside(str(path)) is None:
                        continue
                    facts = path.stat()
                    if stat.S_ISDIR(facts.st_mode) or stat.S_ISREG(facts.st_mode):
                        is_folder = stat.S_ISDIR(facts.st_mode)
                        found.append(_Entry(path, is_folder, facts.st_size, facts.st_mtime))
    except OSError as exc:
        raise ReadError(f"{folder}: cannot be read ({exc.strerror})", exc) from None
    return found


def _followed(places: Places, file: Path) -> list[_Entry]:
    """Return the entry of one file, its folder unread; none where it is gone or leads outside."""
    with suppress(OSError):
        facts = file.stat()
        if places.inside(str(file)) is not None and stat.S_ISREG(facts.st_mode):
            return [_Entry(file, is_folder=False, size=facts.st_size, seconds=facts.st_mtime)]
    return []


def _can_be_named(path: Path) -> bool:
    """Return whether a path is text: a name that is not in UTF-8 cannot come back from the page."""
    try:
        str(path).encode("utf-8")
    except UnicodeEncodeError:
        return False
    return True


def _row(entry: _Entry) -> dict[str, Any]:
    name, path = (
        text.encode("utf-8", "backslashreplace").decode("utf-8").replace("\\udc", "\\x")
        if not _can_be_named(entry.path)
        else text
        for text in (entry.path.name, str(entry.path))
    )
    return {
        "name": name,
        "path": path,
        "is_folder": entry.is_folder,
        "size": entry.size,
        "changed": entry.seconds,
    }


def _kind_of(path: Path) -> str:
    """Return the format of a file by its content; "" where no reader knows it."""
    from metrosep.io.registry import identify

    if path.suffix.lower() in _OTHER:
        return _OTHER[path.suffix.lower()]
    try:
        return str(identify(path).id)
    except (MetrosepError, OSError):
        return ""
