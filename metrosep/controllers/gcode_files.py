"""Corrected programs and lists on the disk: never twice corrected, never without their own sidecar."""

from __future__ import annotations

import contextlib
import hashlib
import json
from pathlib import Path

from metrosep.controllers._pairs import refuse_existing
from metrosep.controllers.base import load_bytes, sidecar_path
from metrosep.core.errors import DataError, WriteError

__all__ = ["SCHEMAS", "check_files", "require_hash", "require_uncorrected"]

SCHEMAS = ("metrosep.path/1", "metrosep.points/1")
"""Of the sidecars of corrected programs and lists."""


def check_files(start: Path, end: Path, *, overwrite: bool) -> None:
    """Refuse a target that is the source, or exists.

    Parameters
    ----------
    start, end : Path
        What is read, and what is to be written.
    overwrite : bool
        Whether an existing file may be replaced.

    Raises
    ------
    WriteError
        If it must not be written.
    """
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


def require_uncorrected(path: Path) -> None:
    """Refuse a program or list that has a correction in it already.

    Parameters
    ----------
    path : Path
        The source.

    Raises
    ------
    DataError
        If a sidecar beside it says that it was corrected.
    """
    beside = sidecar_path(path)
    if not beside.is_file():
        return
    try:
        found = json.loads(load_bytes(beside))
    except (ValueError, RecursionError):
        return
    if not isinstance(found, dict) or found.get("schema") not in SCHEMAS:
        return
    with contextlib.suppress(OSError):
        own = hashlib.sha256(path.read_bytes()).hexdigest() == found.get("file_sha256")
        raise DataError(
            f"{path}: holds a correction already"
            + ("" if own else " (changed since, or of a run that was cut off)")
            + f", as {beside.name} beside it says; a second one would be added to it: take the original "
            f"({found.get('source', 'unknown')}), or say again if what was measured is a part cut with it"
        )


def require_hash(path: Path, wanted: str) -> None:
    """Refuse a file that the disk does not hold as it was written.

    Parameters
    ----------
    path : Path
        The file.
    wanted : str
        SHA-256 of what was written.

    Raises
    ------
    WriteError
        If it differs.
    """
    digest = hashlib.sha256()
    with path.open("rb") as stream:
        while piece := stream.read(1 << 20):
            digest.update(piece)
    if digest.hexdigest() != wanted:
        raise WriteError(f"{path}: the disk does not hold what was written; nothing was kept")
