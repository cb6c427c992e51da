"""Where results may be written: never onto what is open, never from files that changed meanwhile."""

from __future__ import annotations

import hashlib
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from metrosep.core.errors import MetrosepError, ReadError, WriteError

__all__ = [
    "Stamp",
    "refuse_changed",
    "refuse_open",
    "refuse_other_result",
    "stamps_of",
    "with_digests",
]


@dataclass(frozen=True, slots=True)
class Stamp:
    """What tells that a file is the one that was opened."""

    file: Path  # the file
    size: int  # bytes
    mtime_ns: int  # nanoseconds: when it was written
    sha256: str = ""  # digest of what was read; empty where it is not known


def stamps_of(files: Iterable[Path]) -> tuple[Stamp, ...]:
    """Return what tells files from later ones of their names; taken before they are read."""
    made = []
    for file in files:
        try:
            found = file.stat()
        except OSError as exc:
            raise ReadError(f"{file.name}: cannot be read ({exc.strerror or exc})") from None
        made.append(Stamp(file, found.st_size, found.st_mtime_ns))
    return tuple(made)


def with_digests(stamps: Sequence[Stamp], obj: Any) -> tuple[Stamp, ...]:
    """Return stamps with the digest that the history of what was read from a file states."""
    read = [s for s in getattr(obj, "history", ()) if s.name == "read"]
    if len(stamps) != 1 or len(read) != 1:
        return tuple(stamps)
    one, known = stamps[0], read[0].parameters
    if known.get("file") != one.file.name or not known.get("sha256"):
        return tuple(stamps)
    return (Stamp(one.file, one.size, one.mtime_ns, str(known["sha256"])),)


def refuse_changed(stamps: Iterable[Stamp]) -> None:
    """Refuse to write what was made of files that are others now.

    Notes
    -----
    Where the digest is known it decides: a copy with the same content is the same file.
    """
    for stamp in stamps:
        try:
            found = stamp.file.stat()
            same = (found.st_size, found.st_mtime_ns) == (stamp.size, stamp.mtime_ns)
            if stamp.sha256:
                with stamp.file.open("rb") as file:
                    same = hashlib.file_digest(file, "sha256").hexdigest() == stamp.sha256
        except OSError:
            same = False
        if not same:
            raise WriteError(f"{stamp.file.name} changed since it was opened; open it again")


def refuse_open(target: Path, opened: Any, *, recipe: bool = False) -> None:
    """Refuse to write onto what is open: its files, its recipe, its session."""
    if target in opened.files or any(_same(target, f) for f in opened.files):
        raise WriteError(
            f"{target.name}: is the measurement that is open, and stays as it is; choose another name"
        )
    if _same(target, opened.kept):
        raise WriteError(
            f"{target.name}: is the session that is kept for what is open; choose another name"
        )
    if not _same(target, opened.home):
        return
    if not recipe:
        raise WriteError(f"{target.name}: is the recipe that is open; choose another name")
    if opened.base and hashlib.sha256(target.read_bytes()).hexdigest() != opened.base:
        raise WriteError(
            f"{target.name} changed since it was opened; choose another name, or open it again"
        )


def _same(target: Path, other: Path) -> bool:
    """Whether two names are of one file, be it by a link."""
    if target == other:
        return True
    try:
        return target.samefile(other)
    except OSError:
        return False


def refuse_other_result(folder: Path) -> None:
    """Refuse a folder whose result.json is not of metrosep: it would be replaced."""
    from metrosep.recipe.preflight import RESULT_NAME
    from metrosep.recipe.result import load_document

    there = folder / RESULT_NAME
    if not there.exists():
        return
    try:
        load_document(there)
    except MetrosepError:
        raise WriteError(
            f"{folder.name}: holds a {RESULT_NAME} that is not of metrosep, and it would be replaced; "
            "choose another folder"
        ) from None
