"""Files that appear whole or not at all: write beside the target, flush, rename.

A controller that finds half a compensation table loads half a table. Every layer that writes a
result therefore builds its bytes first and hands them to `atomic_write`, or, where they are too
many to hold, writes them piece by piece into an `atomic_stream`.
"""

from __future__ import annotations

import contextlib
import errno
import glob
import hashlib
import os
import platform
import secrets
import stat
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import BinaryIO

from metrosep.core.errors import WriteError


def atomic_write(path: str | os.PathLike[str], data: bytes) -> Path:
    """Write bytes to a file that appears whole or not at all.

    The bytes go to a temporary file in the same folder, are flushed to the disk (fsync) and
    renamed over the target, which POSIX and Windows both do in one step. A killed process leaves its
    temporary file; the next write to the same target removes it (POSIX).
    """
    with _beside(path) as (temporary, target):
        _write_then_rename(temporary, target, data)
        return target


@contextlib.contextmanager
def atomic_stream(
    path: str | os.PathLike[str], *, check: Callable[[Path], None] | None = None
) -> Iterator[BinaryIO]:
    r"""Give a binary file to write into; the target appears only when the block ends well.

    As `atomic_write`: a temporary file in the same folder, fsync, one rename. Memory does not grow
    with the file.

    Examples
    --------
    >>> import tempfile
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     target = Path(folder) / "path.nc"
    ...     with atomic_stream(target) as stream:
    ...         _ = stream.write(b"G1 X1\n")
    ...         before = target.exists()
    ...     (before, target.read_bytes())
    (False, b'G1 X1\n')
    """
    with _beside(path) as (temporary, target):
        try:
            with os.fdopen(_create(temporary, target, os.O_RDWR), "w+b") as stream:
                yield stream
                stream.flush()
                os.fsync(stream.fileno())
            if check is not None:
                check(temporary)
            temporary.replace(target)
        except BaseException:
            with contextlib.suppress(OSError):
                temporary.unlink()
            raise


@contextlib.contextmanager
def _beside(path: str | os.PathLike[str]) -> Iterator[tuple[Path, Path]]:
    """Give a name for a temporary file and the target; troubles of the system become WriteError."""
    target = Path(path)
    try:
        target = target.resolve()
        _check_folder(target)
        for found in left_behind(target.parent, target.name):
            with contextlib.suppress(OSError):
                found.unlink()
        yield target.with_name(own_name(target.name)), target
    except WriteError:
        raise
    except OSError as exc:
        reason = exc.strerror or str(exc)
        raise WriteError(
            f"{path}: cannot be written ({reason}); choose a folder that you may write to and that "
            "has room, or free the file if another program holds it",
            exc,
            str(path),
        ) from None


def own_name(beginning: str) -> str:
    """Return a name of this process for what is not whole yet, which `left_behind` finds once it is gone."""
    return f"{_of_host(beginning)}{os.getpid():x}-{secrets.token_hex(4)}.tmp"


def left_behind(folder: Path, beginning: str) -> Iterator[Path]:
    """Give what killed processes of this machine left under an `own_name` (POSIX)."""
    if os.name != "posix":  # elsewhere asking for a process may end it
        return
    prefix = _of_host(beginning)
    for found in folder.glob(glob.escape(prefix) + "*-*.tmp"):
        with contextlib.suppress(ValueError, OSError):
            number = int(found.name[len(prefix) :].split("-")[0], 16)
            try:
                os.kill(number, 0)
            except ProcessLookupError:
                yield found


def _of_host(beginning: str) -> str:
    """Return how names of this machine begin."""
    host = hashlib.sha256(platform.node().encode()).hexdigest()[:6]
    return f".{beginning[:100]}.{host}-"


def _check_folder(target: Path) -> None:
    if target.is_dir():
        cause = IsADirectoryError(errno.EISDIR, os.strerror(errno.EISDIR), str(target))
        raise WriteError(f"{target}: is a folder; give the name of a file in it", cause)
    if not target.parent.is_dir():
        raise WriteError(
            f"{target}: the folder {target.parent} does not exist; create it first or choose another",
            FileNotFoundError(errno.ENOENT, os.strerror(errno.ENOENT), str(target)),
        )


def _write_then_rename(temporary: Path, target: Path, data: bytes) -> None:
    handle = _create(temporary, target, os.O_WRONLY)
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


def _create(temporary: Path, target: Path, how: int) -> int:
    """Return the handle of a new file with the permissions of the one it will replace."""
    mode = target.stat().st_mode & 0o777 if target.exists() else 0o666
    return os.open(temporary, how | os.O_CREAT | os.O_EXCL | getattr(os, "O_BINARY", 0), mode)


def take_lock(handle: int) -> bool:
    """Take the lock of an open file until it is closed; return False where another process has it."""
    if os.name == "nt":
        import msvcrt

        with contextlib.suppress(OSError):
            msvcrt.locking(handle, msvcrt.LK_NBLCK, 1)  # type: ignore[attr-defined,unused-ignore]
            return True
        return False
    import fcntl

    try:
        fcntl.flock(handle, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except BlockingIOError:
        return False
    except OSError:  # a file system without locks: nobody can be asked
        return True
    return True


# ---- files that others name: read whole only if they are plain files of a size that was agreed on ----
# A recipe may come from a stranger. What it names could be a pipe, on which reading waits for ever,
# or a device that never ends; so a file is opened without waiting and looked at before it is read.

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
    r"""Return the text of a plain file in UTF-8, with ``\n`` as line ends; OSError names a line that is not."""
    content = read_plain(path, limit)
    try:
        return content.decode("utf-8").replace("\r\n", "\n").replace("\r", "\n")
    except UnicodeDecodeError as exc:
        line = content.count(b"\n", 0, exc.start) + 1
        said = f"line {line} is not UTF-8; save the file in the encoding UTF-8"
        raise OSError(errno.EILSEQ, said, str(path)) from None


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
