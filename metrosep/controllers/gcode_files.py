"""Corrected programs and lists on the disk: never twice corrected, never without their own sidecar."""

from __future__ import annotations

import contextlib
import hashlib
import json
import re
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from metrosep.controllers._pairs import refuse_existing
from metrosep.controllers.base import load_bytes, sidecar_path
from metrosep.core.errors import DataError, ReadError, WriteError

__all__ = [
    "SCHEMAS",
    "check_files",
    "require_hash",
    "require_uncorrected",
    "require_unmarked",
]

SCHEMAS = ("metrosep.path/1", "metrosep.points/1")
"""Of the sidecars of corrected programs and lists."""

_MARK = re.compile(r"METROSEP\s+CORRECTED[^()\r\n]*", re.IGNORECASE)
_HEAD = re.compile(r"\s*(?:%.*|(?:[O:]\d+).*)?\s*", re.IGNORECASE)
"""Of lines before the mark: blank, the % of a tape, the number of the program."""
_CALLED = re.compile(
    r"\b(?:CYCLE832|COMPCAD|COMPCURV|COMPON|COMPOF|COMPSURF|SOFT|BRISK)\b\s*(?:\([^()]*\))?",
    re.IGNORECASE,
)
"""What only controls have whose comments begin with a semicolon."""
_OF_LISTS = "#%;"
_LARGEST_SIDECAR = 10**6


def check_files(start: Path, end: Path, *, overwrite: bool) -> None:
    """Refuse a target that is the source, or exists."""
    try:
        same = end.exists() and start.exists() and end.samefile(start)
    except OSError as exc:
        raise WriteError(
            f"{end}: cannot be written ({exc.strerror or exc}); choose another name or folder"
        ) from None
    if same or start.resolve() == end.resolve() or start.resolve() == sidecar_path(end).resolve():
        raise WriteError(
            f"{end}: is the source itself; a correction must not be added twice, so give another name"
        )
    if not overwrite:
        refuse_existing(end)


def mark_text(axes: Sequence[str], audit: Mapping[str, Any]) -> str:
    """Return the text by which a corrected file is known, whatever its name."""
    content = json.dumps([*axes, dict(audit)], sort_keys=True, default=str)
    digest = hashlib.sha256(content.encode("utf-8")).hexdigest()[:12]
    return f"METROSEP CORRECTED {' '.join(axes)} {digest}"


def marked(lines: Sequence[str], text: str, *, is_list: bool = False) -> list[str]:
    """Return the first lines of a file with the mark as a comment of its own form.

    In a program it follows the number of the program. A list without comments stays as it is: not
    every reader of lists takes them.
    """
    if not lines:
        return []
    end = re.search(r"[\r\n]*$", lines[0])[0] or "\n"  # type: ignore[index]
    if is_list:
        first = next((i for i, v in enumerate(lines) if v.lstrip()[:1] in (*_OF_LISTS,)), None)
        if first is None:
            return list(lines)
        made = f"{lines[first].lstrip()[0]} {text}{end}"
        return [*lines[: first + 1], made, *lines[first + 1 :]]
    at = next((i for i, v in enumerate(lines) if not _HEAD.fullmatch(v)), len(lines))
    whole = "".join(lines)
    semicolon = (";" in whole or _CALLED.search(whole)) and "(" not in _CALLED.sub("", whole)
    made = (f";{text}" if semicolon else f"({text})") + end
    before = list(lines[:at])
    if before and not before[-1].endswith(("\r", "\n")):
        before[-1] += end
    return [*before, made, *lines[at:]]


def require_unmarked(lines: Sequence[str], path: Path) -> None:
    """Refuse lines of a program or list that bear the mark of a correction."""
    found = _MARK.search("".join(lines))
    if found is not None:
        raise DataError(
            f"{path}: holds a correction already, as its comment {found[0].strip()!r} says; a second one "
            "would be added to it: take the original, or say again if what was measured is a part cut "
            "with it"
        )


def require_uncorrected(path: Path) -> None:
    """Refuse a program or list that has a correction in it already, by the sidecars of its folder."""
    beside = sidecar_path(path)
    found = _said(beside)
    if found is not None:
        with contextlib.suppress(OSError):
            own = hashlib.sha256(path.read_bytes()).hexdigest() == found.get("file_sha256")
            why = "" if own else " (changed since, or of a run that was cut off)"
            raise _corrected(path, beside, found, why)
    others = {} if not path.is_file() else _sidecars(path.parent)
    if others:
        digest = hashlib.sha256(path.read_bytes()).hexdigest()
        for other, said in others.items():
            if said.get("file_sha256") == digest != said.get("source_sha256"):
                raise _corrected(path, other, said, " (the same bytes under another name)")


def _corrected(path: Path, beside: Path, found: Mapping[str, Any], why: str) -> DataError:
    return DataError(
        f"{path}: holds a correction already{why}, as {beside.name} beside it says; a second one would be "
        f"added to it: take the original ({found.get('source', 'unknown')}), or say again if what was "
        "measured is a part cut with it"
    )


def _sidecars(folder: Path) -> dict[Path, dict[str, Any]]:
    """Return the sidecars of corrected files in a folder."""
    found = {f: _said(f) for f in sorted(folder.glob("*.json"))}
    return {f: said for f, said in found.items() if said is not None}


def _said(beside: Path) -> dict[str, Any] | None:
    """Return what a sidecar of a corrected file says; None if it is none."""
    try:
        if not beside.is_file() or beside.stat().st_size > _LARGEST_SIDECAR:
            return None
        found = json.loads(load_bytes(beside))
    except (ValueError, RecursionError, OSError, ReadError):
        return None
    return found if isinstance(found, dict) and found.get("schema") in SCHEMAS else None


def require_hash(path: Path, wanted: str) -> None:
    """Refuse a file that the disk does not hold as it was written."""
    digest = hashlib.sha256()
    with path.open("rb") as stream:
        while piece := stream.read(1 << 20):
            digest.update(piece)
    if digest.hexdigest() != wanted:
        raise WriteError(f"{path}: the disk does not hold what was written; nothing was kept")
