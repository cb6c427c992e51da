"""Why a unit failed, in one sentence, and with which exit code ``run`` would have ended."""

from __future__ import annotations

import errno
import os
from collections.abc import Iterator

from metrosep.batch.names import one_line_name
from metrosep.batch.units import Unit
from metrosep.core import errors, exit_codes

__all__ = [
    "ChangedError",
    "WorkerDiedError",
    "as_reason",
    "exit_code_of",
    "is_disk_full",
    "worth_another_try",
]


class ChangedError(errors.ReadError):
    """An input vanished, grew or was replaced while it was read."""


class WorkerDiedError(errors.MetrosepError, RuntimeError):
    """A worker process ended while it worked on a unit alone."""


_MORE: exit_codes.Codes = ((WorkerDiedError, 4), (OSError, 4), (MemoryError, 4))
"""Besides those of every command: a batch goes on, and such an input is a row that cannot be used."""


def exit_code_of(error: BaseException) -> int:
    """Return the exit code that ``run`` ends with for an error."""
    return exit_codes.exit_code_of(error, _MORE)


def is_disk_full(error: BaseException) -> bool:
    """Return whether an error comes from a disk or a quota that is full."""
    full = (errno.ENOSPC, errno.EDQUOT) if hasattr(errno, "EDQUOT") else (errno.ENOSPC,)
    return any(isinstance(e, OSError) and e.errno in full for e in _chain(error))


def worth_another_try(error: BaseException) -> bool:
    """Return whether the same bytes may pass when the batch is resumed."""
    outside = (
        ChangedError, WorkerDiedError, errors.WriteError, errors.UnsupportedFeatureError, MemoryError,
    )  # fmt: skip
    if isinstance(error, outside) or not isinstance(error, errors.MetrosepError):
        return True
    return any(isinstance(e, OSError | MemoryError) for e in _chain(error)) or _no_formats()


def _no_formats() -> bool:
    """Return whether this installation cannot tell what a file is, whatever its content."""
    from metrosep.io.registry import formats

    try:
        formats()
    except errors.ReadError:
        return True
    return False


def as_reason(error: BaseException, unit: Unit) -> str:
    """Return an error as one sentence without machine paths."""
    if isinstance(error, errors.MetrosepError):
        text = str(error)
    elif isinstance(error, MemoryError):
        text = f"{unit.name}: the memory did not suffice; use fewer workers"
    elif isinstance(error, OSError):
        text = (
            f"{unit.name}: cannot be read ({error.strerror or error}); check that it is there, that "
            "you may read it and that no other program holds it"
        )
    else:
        text = f"internal error ({type(error).__name__}: {error}); this is a bug in metrosep: report it"
    shown = one_line_name(unit.name)
    text = text.replace(unit.name, shown)
    for file in sorted({*unit.files, unit.target}, key=len, reverse=True):
        tail = file.removeprefix(unit.target).lstrip("/\\")
        base = "" if unit.name == "." else shown
        text = text.replace(file, "/".join(p for p in (base, tail) if p) or ".")
    if unit.files == (unit.target,):  # a file beside it, such as the second one of a pair
        here = unit.name.rpartition("/")[0]
        place = os.path.join(os.path.dirname(unit.target), "")  # noqa: PTH118, PTH120
        text = text.replace(place, f"{here}/" if here else "") if len(place) > 1 else text
    return " ".join(text.split())


def _chain(error: BaseException) -> Iterator[BaseException]:
    seen: set[int] = set()
    link: BaseException | None = error
    while link is not None and id(link) not in seen:
        seen.add(id(link))
        yield link
        link = link.__cause__ or link.__context__
