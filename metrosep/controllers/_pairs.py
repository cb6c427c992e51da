"""A file and its sidecar: refused where they exist, written both or neither."""

from __future__ import annotations

import contextlib
from pathlib import Path

from metrosep.controllers.base import load_bytes, sidecar_path
from metrosep.core.atomic import atomic_write
from metrosep.core.errors import WriteError

__all__ = ["refuse_existing", "write_pair"]


def refuse_existing(target: Path) -> None:
    """Refuse if a file or its sidecar is there already.

    Parameters
    ----------
    target : Path
        The file.

    Raises
    ------
    WriteError
        If one exists, or the folder cannot be looked into.
    """
    for path in (target, sidecar_path(target)):
        try:
            exists = path.exists()
        except OSError as exc:
            raise WriteError(
                f"{path}: cannot be written ({exc.strerror or exc}); choose another name or folder"
            ) from None
        if exists:
            raise WriteError(
                f"{path}: exists already and a machine may be using it; choose another name or say "
                "overwrite"
            )


def write_pair(target: Path, data: bytes, sidecar: bytes) -> None:
    """Write a file and its sidecar; if the file fails, the sidecar is what it was before.

    Parameters
    ----------
    target : Path
        The file.
    data, sidecar : bytes
        Their content.

    Raises
    ------
    WriteError
        If one cannot be written.
    """
    beside = sidecar_path(target)
    before = load_bytes(beside) if beside.is_file() else None
    atomic_write(beside, sidecar)
    try:
        atomic_write(target, data)
    except WriteError:
        beside.unlink(missing_ok=True)
        if before is not None:
            with contextlib.suppress(WriteError):
                atomic_write(beside, before)
        raise
