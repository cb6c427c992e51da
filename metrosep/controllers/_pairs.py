"""A file and its sidecar: refused where they exist, written both or neither."""

from __future__ import annotations

import contextlib
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import BinaryIO

from metrosep.controllers.base import load_bytes, sidecar_path
from metrosep.core.atomic import atomic_stream, atomic_write
from metrosep.core.errors import WriteError

__all__ = ["paired_stream", "refuse_existing", "write_pair"]


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


@contextlib.contextmanager
def paired_stream(end: Path, text: Callable[[Path], str]) -> Iterator[BinaryIO]:
    """Give a binary file to write into; file and sidecar appear together or not at all.

    Parameters
    ----------
    end : Path
        The target.
    text : callable
        Called with the complete temporary file; returns what the sidecar says.

    Yields
    ------
    BinaryIO
        To be written.

    Raises
    ------
    WriteError
        If something cannot be written.

    Notes
    -----
    The sidecar is written first and put back if the file does not get its name. Between the two only
    a killed process can stop; the sidecar then holds the hash of another file.
    """
    beside = sidecar_path(end)
    before = load_bytes(beside) if beside.is_file() else None
    wrote = False

    def check(written: Path) -> None:
        nonlocal wrote
        said = text(written)
        wrote = True
        atomic_write(beside, said.encode("utf-8"))

    try:
        with atomic_stream(end, check=check) as out:
            yield out
    except BaseException:
        if wrote:
            with contextlib.suppress(WriteError, OSError):
                if before is None:
                    beside.unlink(missing_ok=True)
                else:
                    atomic_write(beside, before)
        raise


def write_pair(target: Path, data: bytes, sidecar: bytes) -> None:
    """Write a file and its sidecar; both appear, or what was there before stays.

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
    with paired_stream(target, lambda _written: sidecar.decode("utf-8")) as out:
        out.write(data)
