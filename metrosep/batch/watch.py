"""Units as they come: those of a folder once, or of a hot folder until the batch is stopped."""

from __future__ import annotations

import contextlib
import os
import time
from collections.abc import Callable, Iterator, Mapping
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

from metrosep.batch.companions import files_read
from metrosep.batch.loop import Stop
from metrosep.batch.units import Found, Unit, find_units
from metrosep.core.errors import ReadError
from metrosep.recipe.recipe import Recipe

__all__ = ["file_time", "new_units"]

_NAP_SECONDS = 0.1
_MOST_LOOKS = 64


def new_units(
    recipe: Recipe,
    folder: Path,
    out: Path,
    *,
    every: float | None,
    stop: Stop,
    first: Found,
    rows: Mapping[str, Mapping[str, Any]] | None = None,
    look: Callable[[Found, frozenset[str]], bool] | None = None,
) -> Iterator[tuple[Unit, ...]]:
    """Yield units that are new or changed, again and again."""
    if every is None:
        yield first.units
        return
    seen: dict[str, object] = {}
    taken: dict[str, object] = {}
    handed: dict[str, object] = {}
    patience = _Patience({} if rows is None else rows)
    while not stop:
        ready = []
        found = find_units(recipe, folder, out=out)
        states = {unit.name: _state(unit) for unit in found.units}
        gone = look is not None and look(found, _changed(states, handed))
        for unit in found.units:
            state = states[unit.name]
            if unit.name in taken and patience.is_over(unit.name):
                del taken[unit.name]
            if state is not None and seen.get(unit.name) == state != taken.get(unit.name):
                ready.append(unit)
                taken[unit.name] = handed[unit.name] = state
            seen[unit.name] = state
        if ready or gone:
            yield tuple(ready)
        _sleep(every, stop)
    with contextlib.suppress(ReadError):  # a folder that went at the end: what was found stays
        found = find_units(recipe, folder, out=out)
        if look is not None:
            look(found, _changed({u.name: _state(u) for u in found.units}, handed))


def _changed(states: Mapping[str, object], handed: Mapping[str, object]) -> frozenset[str]:
    """Return the units whose files are not those any more that were handed out."""
    return frozenset(n for n, s in states.items() if n in handed and handed[n] != s)


def file_time(unit: Unit) -> str | None:
    """Return when the first of the files of a unit was changed for the last time."""
    try:
        first = min(os.stat(f).st_mtime for f in unit.files)  # noqa: PTH116
    except OSError:
        return None
    return datetime.fromtimestamp(first, UTC).isoformat()


class _Patience:
    """Looks until a unit that failed for a reason from outside is tried once more."""

    def __init__(self, rows: Mapping[str, Mapping[str, Any]]) -> None:
        self._rows = rows
        self._tries: dict[str, int] = {}
        self._looks: dict[str, int] = {}

    def is_over(self, name: str) -> bool:
        """Count one look."""
        if not self._rows.get(name, {}).get("again"):
            self._tries.pop(name, None)
            self._looks.pop(name, None)
            return False
        tries = self._tries.setdefault(name, 0)
        self._looks[name] = self._looks.get(name, 0) + 1
        if self._looks[name] < min(2**tries, _MOST_LOOKS):
            return False
        self._tries[name], self._looks[name] = tries + 1, 0
        return True


def _state(unit: Unit) -> object:
    try:
        files = files_read(unit)
        found = [os.stat(f) for f in files]  # noqa: PTH116
    except OSError:
        return None
    return tuple((f, s.st_size, s.st_mtime_ns) for f, s in zip(files, found, strict=True))


def _sleep(seconds: float, stop: Stop) -> None:
    end = time.monotonic() + seconds
    while not stop and (left := end - time.monotonic()) > 0.0:
        time.sleep(min(_NAP_SECONDS, left))
