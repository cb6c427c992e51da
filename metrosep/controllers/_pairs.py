"""A file and its sidecar: never replaced unasked, written both or neither, the old pair kept."""

from __future__ import annotations

import contextlib
import filecmp
import os
import shutil
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from itertools import count
from pathlib import Path
from typing import Any, BinaryIO

from metrosep.controllers.base import load_bytes, sidecar_path
from metrosep.core.atomic import atomic_stream, atomic_write
from metrosep.core.errors import WriteError

__all__ = ["Prepared", "paired_stream", "refuse_existing", "write_pair"]


def refuse_existing(target: Path) -> None:
    """Refuse if a file or its sidecar is there already."""
    for path in (target, sidecar_path(target)):
        if _exists(path):
            raise WriteError(
                f"{path}: exists already and a machine may be using it; choose another name or say "
                "overwrite"
            )


def is_written(target: Path, data: bytes, sidecar: bytes, *, overwrite: bool) -> bool:
    """Return whether just these bytes are there; other ones are refused without `overwrite`."""
    pair = ((target, data), (sidecar_path(target), sidecar))
    if all(_exists(p) and p.is_file() and load_bytes(p) == wanted for p, wanted in pair):
        return True
    if not overwrite:
        refuse_existing(target)
    return False


def _exists(path: Path) -> bool:
    try:
        return path.exists()
    except OSError as exc:
        raise WriteError(
            f"{path}: cannot be written ({exc.strerror or exc}); choose another name or folder"
        ) from None


def keep_old(target: Path) -> list[Path]:
    """Keep a file and its sidecar beside them as NAME.1, NAME.1.json, or the next free number."""
    pair = [p for p in (target, sidecar_path(target)) if p.is_file()]
    if not pair:
        return []
    names = (target.with_name(f"{target.name}.{k}") for k in count(1))
    name = next(n for n in names if not (_exists(n) or _exists(sidecar_path(n))))
    kept = []
    for old in pair:
        new = name if old == target else sidecar_path(name)
        try:
            try:
                os.link(old, new)
            except OSError:  # a disk without links
                shutil.copy2(old, new)
        except OSError as exc:
            raise WriteError(
                f"{new}: the old file cannot be kept there ({exc.strerror or exc}); choose another "
                "name or folder"
            ) from None
        kept.append(new)
    return kept


@contextlib.contextmanager
def paired_stream(
    end: Path, text: Callable[[Path], str], *, overwrite: bool
) -> Iterator[BinaryIO]:
    """Give a binary file to write into; file and sidecar appear together or not at all.

    The same bytes stay; others are refused, or with `overwrite` kept under another name (`keep_old`).

    Notes
    -----
    The sidecar is written first and put back if the file does not get its name. Between the two only
    a killed process can stop; the sidecar then holds the hash of another file.
    """
    beside = sidecar_path(end)
    before = load_bytes(beside) if beside.is_file() else None
    wrote = False
    kept: list[Path] = []

    def check(written: Path) -> None:
        nonlocal wrote
        said = text(written)
        if _is_same(end, written) and before == said.encode("utf-8"):
            return
        if not overwrite:
            refuse_existing(end)
        kept.extend(keep_old(end))
        wrote = True
        atomic_write(beside, said.encode("utf-8"))

    try:
        with atomic_stream(end, check=check) as out:
            yield out
    except BaseException:
        for file in kept:
            file.unlink(missing_ok=True)
        if wrote:
            with contextlib.suppress(WriteError, OSError):
                if before is None:
                    beside.unlink(missing_ok=True)
                else:
                    atomic_write(beside, before)
        raise


def _is_same(one: Path, other: Path) -> bool:
    """Return whether two files are there and hold the same bytes."""
    return one.is_file() and filecmp.cmp(one, other, shallow=False)


def write_pair(target: Path, data: bytes, sidecar: bytes, *, overwrite: bool) -> None:
    """Write a file and its sidecar; both appear, or what was there before stays."""
    said = sidecar.decode("utf-8")
    with paired_stream(target, lambda _written: said, overwrite=overwrite) as out:
        out.write(data)


@dataclass(frozen=True, slots=True)
class Prepared:
    """A table that passed its checks, ready to be written: bytes, sidecar and dry-run."""

    target: Path
    data: bytes
    sidecar: bytes
    verification: Any
    overwrite: bool

    def require_free(self) -> bool:
        """Return whether these bytes are there; refuse other ones that may not be replaced."""
        return is_written(self.target, self.data, self.sidecar, overwrite=self.overwrite)

    def write(self, stage: Path | None = None) -> None:
        """Write file and sidecar, into `stage` if given; replace other bytes only if that was said."""
        if self.require_free() and stage is None:
            return
        place = self.target if stage is None else stage / self.target.name
        write_pair(place, self.data, self.sidecar, overwrite=self.overwrite)
