"""Output folders of batches: how one is told from a folder of inputs, and whose results it holds."""

from __future__ import annotations

import json
import os
import re
from pathlib import Path

from metrosep.core.atomic import atomic_write
from metrosep.core.errors import WriteError

__all__ = ["count_files", "is_output_folder", "record_source", "require_own_source"]

_LOCK, _SOURCE = ".metrosep-batch.lock", ".metrosep-batch.source"
_SCHEMA = b'"metrosep.index/1"'
_ENDS = 1 << 16
"""Bytes at both ends of an index.json that are looked at; the schema stands near one of them."""


def is_output_folder(folder: Path) -> bool:
    """Return whether a batch wrote a folder."""
    if any((folder / name).is_file() for name in (_LOCK, _SOURCE)):
        return True
    return _has_index(folder / "index.json") or _is_of_unit(folder)


def _has_index(file: Path) -> bool:
    try:
        with file.open("rb") as handle:
            size = os.fstat(handle.fileno()).st_size
            found = handle.read(_ENDS)
            if size > _ENDS:
                handle.seek(max(_ENDS, size - _ENDS))
                found += handle.read(_ENDS)
    except OSError:
        return False
    return _SCHEMA in found


def _is_of_unit(folder: Path) -> bool:
    from metrosep.batch.marks import FAILED, RESULT, read_mark

    if re.fullmatch("[0-9a-f]{8}", folder.name) is None:
        return False
    marks = (read_mark(folder, name) for name in (RESULT, FAILED))
    return any(str(m["unit"].get("hash")).startswith(folder.name) for m in marks if m is not None)


def count_files(folder: Path) -> int:
    """Return how many files lie in a folder and below, hidden ones left out."""
    return sum(not name.startswith(".") for _, _, files in os.walk(folder) for name in files)


def require_own_source(out: Path, source: Path) -> tuple[str, ...]:
    """Refuse an output folder that holds the results of another input folder.

    Notes
    -----
    The record stands in a hidden file of the output folder and leads from there, so that both may be
    moved together. Neither a result nor the index holds it.
    """
    record = out / _SOURCE
    if not record.is_file():
        return ()
    try:
        before = out.resolve() / json.loads(record.read_bytes())["inputs"]
    except (OSError, ValueError, KeyError, TypeError):
        raise WriteError(
            f"{record}: is damaged; it says which input folder the results are of: if it is {source}, "
            "delete this file, otherwise choose another output folder with -o"
        ) from None
    before = Path(os.path.normpath(before))
    if not os.path.isdir(before):  # noqa: PTH112  # False also where one may not look
        told = (
            f"the input folder of before, {before}, is not there any more; results of files that are "
            f"not in {source} are kept apart"
        )
        return (told,)
    if before.samefile(source):
        return ()
    raise WriteError(
        f"{out}: holds the results of another input folder, {before}, and has one index; give each "
        "input folder its own output folder (-o), or give the folder that holds both as the input"
    )


def record_source(out: Path, source: Path) -> None:
    """Note whose results an output folder holds."""
    there, here = source.resolve(), out.resolve()
    try:
        way = os.path.relpath(there, here)
    except ValueError:  # another drive
        way = str(there)
    text = json.dumps({"inputs": Path(way).as_posix()}) + "\n"
    target = out / _SOURCE
    if not target.is_file() or target.read_bytes() != text.encode("ascii"):
        atomic_write(target, text.encode("ascii"))
