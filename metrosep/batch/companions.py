"""Files that a reader opens beside the one that is named: a change of one is a change of the unit."""

from __future__ import annotations

import functools
import os
from pathlib import Path

from metrosep.batch.units import Unit
from metrosep.io.registry import FOLDERS_VARIABLE, formats

__all__ = ["files_read"]


def files_read(unit: Unit) -> tuple[str, ...]:
    """Return every file that a result of a unit may depend on.

    Notes
    -----
    All suffixes of all formats with ``sidecars`` count together. So one file too many may be taken,
    which costs a repetition; one too few would keep a verdict on other data.
    """
    family = _family(os.environ.get(FOLDERS_VARIABLE, ""))
    files = dict.fromkeys(unit.files)
    seen = {_same(Path(f)) for f in files}
    for name in unit.files:
        file = Path(name)
        if file.suffix.lower() not in family:
            continue
        for suffix in family:
            for beside in (file.with_suffix(suffix), file.with_suffix(suffix.upper())):
                if beside.is_file() and _same(beside) not in seen:
                    seen.add(_same(beside))
                    files[str(beside)] = None
    return tuple(files)


def _same(file: Path) -> object:
    """Return what two names of one file share, on a disk that ignores case."""
    try:
        found = file.stat()
    except OSError:
        return str(file)
    return (found.st_dev, found.st_ino) if found.st_ino else str(file)


@functools.lru_cache(maxsize=4)
def _family(_folders: str) -> tuple[str, ...]:
    found = set()
    for described in formats():
        sidecars = described.facts.get("sidecars", ())
        if sidecars:
            found |= {s.lower() for s in (*sidecars, *described.suffixes)}
    return tuple(sorted(found))
