"""Units as they come: those of a folder once, or of a hot folder until the batch is stopped."""

from __future__ import annotations

import os
import time
from collections.abc import Iterator
from pathlib import Path

from metrosep.batch.loop import Stop
from metrosep.batch.units import Found, Unit, find_units
from metrosep.recipe.recipe import Recipe

__all__ = ["new_units"]

_NAP_SECONDS = 0.1


def new_units(
    recipe: Recipe, folder: Path, out: Path, *, every: float | None, stop: Stop, first: Found
) -> Iterator[tuple[Unit, ...]]:
    """Yield units that are new or changed, again and again.

    Parameters
    ----------
    recipe : Recipe
        Which says what a unit is.
    folder, out : Path
        Input folder, and the output folder that is no input.
    every : float or None, s
        Time between two looks; None: one look.
    stop : Stop
        Ends it.
    first : Found
        What was found at the start.

    Yields
    ------
    tuple of Unit
        Of one look. In a hot folder a unit counts when size and time of its files were the same
        at two looks: what is still being written waits.
    """
    if every is None:
        yield first.units
        return
    seen: dict[str, object] = {}
    taken: dict[str, object] = {}
    while not stop:
        ready = []
        for unit in find_units(recipe, folder, out=out).units:
            state = _state(unit)
            if state is not None and seen.get(unit.name) == state != taken.get(unit.name):
                ready.append(unit)
                taken[unit.name] = state
            seen[unit.name] = state
        if ready:
            yield tuple(ready)
        _sleep(every, stop)


def _state(unit: Unit) -> object:
    try:
        found = [os.stat(f) for f in unit.files]  # noqa: PTH116
    except OSError:
        return None
    return tuple((f, s.st_size, s.st_mtime_ns) for f, s in zip(unit.files, found, strict=True))


def _sleep(seconds: float, stop: Stop) -> None:
    end = time.monotonic() + seconds
    while not stop and (left := end - time.monotonic()) > 0.0:
        time.sleep(min(_NAP_SECONDS, left))
