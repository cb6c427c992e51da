"""Files that others name: read whole only if they are plain files of a size that was agreed on.

A recipe may come from a stranger. What it names could be a pipe, on which reading waits for ever,
or a device that never ends; so a file is opened without waiting and looked at before it is read.
"""

from __future__ import annotations

import errno
import os
import stat
from pathlib import Path

__all__ = ["MACHINE_BYTES", "RECIPE_BYTES", "read_plain", "read_plain_text", "require_plain"]

RECIPE_BYTES = 2**20
"""Largest recipe."""

MACHINE_BYTES = 2**24
"""Largest description of a machine."""


def read_plain(path: str | os.PathLike[str], limit: int) -> bytes:
    """Return the content of a plain file."""
    flags = os.O_RDONLY | getattr(os, "O_NONBLOCK", 0) | getattr(os, "O_BINARY", 0)
    with os.fdopen(os.open(path, flags), "rb") as handle:  # a pipe opens at once, without a writer
        _require(os.fstat(handle.fileno()), path, limit)
        content = handle.read(limit + 1)
    if len(content) > limit:  # files of /proc state no size
        raise _too_large(path, limit)
    return content


def read_plain_text(path: str | os.PathLike[str], limit: int) -> str:
    r"""Return the text of a plain file in UTF-8, with ``\n`` as line ends."""
    return read_plain(path, limit).decode("utf-8").replace("\r\n", "\n").replace("\r", "\n")


def require_plain(path: Path, limit: int | None = None) -> None:
    """Refuse a path that is not a plain file, without opening it; one of no file at all passes."""
    try:
        found = path.stat()
    except (FileNotFoundError, NotADirectoryError):
        return
    _require(found, path, limit)


def _require(found: os.stat_result, path: str | os.PathLike[str], limit: int | None) -> None:
    if stat.S_ISDIR(found.st_mode):
        raise IsADirectoryError(errno.EISDIR, "it is a folder", str(path))
    if not stat.S_ISREG(found.st_mode):
        raise OSError(errno.EINVAL, "it is a device or a pipe, not a file", str(path))
    if limit is not None and found.st_size > limit:
        raise _too_large(path, limit)


def _too_large(path: str | os.PathLike[str], limit: int) -> OSError:
    return OSError(errno.EFBIG, f"it is larger than {limit} bytes", str(path))
