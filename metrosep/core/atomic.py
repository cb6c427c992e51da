"""Files that appear whole or not at all: write beside the target, flush, rename.

A controller that finds half a compensation table loads half a table. Every layer that writes a
result therefore builds its bytes first and hands them to `atomic_write`.
"""

from __future__ import annotations

import contextlib
import os
import secrets
from pathlib import Path

from metrosep.core.errors import WriteError

__all__ = ["atomic_write"]


def atomic_write(path: str | os.PathLike[str], data: bytes) -> Path:
    """Write bytes to a file that appears whole or not at all.

    Parameters
    ----------
    path : str or path
        The file; its folder must exist. A file of that name is replaced only when the new one is
        complete; a symbolic link is followed.
    data : bytes
        The whole content.

    Returns
    -------
    Path
        The file that was written.

    Raises
    ------
    WriteError
        If the folder does not exist or cannot be written, the name is a folder, or the disk is
        full; nothing half-written is left behind.

    Notes
    -----
    The bytes go to a temporary file in the same folder, are flushed to the disk (fsync) and
    renamed over the target, which POSIX and Windows both do in one step.
    """
    target = Path(path)
    try:
        target = target.resolve()
        _check_folder(target)
        temporary = target.with_name(f".{target.name[:100]}.{secrets.token_hex(6)}.tmp")
        _write_then_rename(temporary, target, data)
    except OSError as exc:
        reason = exc.strerror or str(exc)
        raise WriteError(
            f"{path}: cannot be written ({reason}); choose a folder that you may write to and that "
            "has room, or free the file if another program holds it"
        ) from None
    return target


def _check_folder(target: Path) -> None:
    if target.is_dir():
        raise WriteError(f"{target}: is a folder; give the name of a file in it")
    if not target.parent.is_dir():
        raise WriteError(
            f"{target}: the folder {target.parent} does not exist; create it first or choose another"
        )


def _write_then_rename(temporary: Path, target: Path, data: bytes) -> None:
    mode = target.stat().st_mode & 0o777 if target.exists() else 0o666
    handle = os.open(
        temporary, os.O_WRONLY | os.O_CREAT | os.O_EXCL | getattr(os, "O_BINARY", 0), mode
    )
    try:
        with os.fdopen(handle, "wb") as stream:
            stream.write(data)
            stream.flush()
            os.fsync(stream.fileno())
        temporary.replace(target)
    except BaseException:
        with contextlib.suppress(OSError):
            temporary.unlink()
        raise
