"""One batch at a time in an output folder."""

from __future__ import annotations

import contextlib
import os
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from metrosep.core.errors import WriteError

__all__ = ["locked"]

_NAME = ".metrosep-batch.lock"


@contextmanager
def locked(out: Path) -> Iterator[None]:
    """Hold an output folder; made if needed."""
    try:
        out.mkdir(parents=True, exist_ok=True)
        handle = os.open(out / _NAME, os.O_RDWR | os.O_CREAT, 0o666)
    except OSError as exc:
        raise WriteError(
            f"{out}: the output folder cannot be written ({exc.strerror or exc}); choose another "
            "with -o"
        ) from None
    try:
        if not _take(handle):
            raise WriteError(
                f"{out}: another batch works in this folder; wait for its end, or choose another "
                "folder with -o"
            )
        yield
    finally:
        os.close(handle)


def _take(handle: int) -> bool:
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
