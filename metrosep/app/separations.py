"""What a recipe makes of repeated runs, or of the readings of another method, each part made once.

The readings are read again only where ``[input]`` changed, and separated again only where the step
that separates changed: a new limit or table costs nothing of it.
"""

from __future__ import annotations

import threading
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

from metrosep.app.remembered import text_key
from metrosep.core.errors import DataError
from metrosep.core.runset import RunSet
from metrosep.recipe.pipeline import CancelledError
from metrosep.recipe.recipe import Recipe
from metrosep.recipe.result import Result
from metrosep.recipe.run import read_inputs, separate_inputs, separated_result
from metrosep.separation.base import ErrorEstimate

__all__ = ["MethodResults", "Separations"]

_MOST = 8
"""Separations that are remembered: undo and redo show them at once."""

Cancel = Callable[[], bool]


class _Latest:
    """The latest results of a function, by a text that tells them apart."""

    def __init__(self) -> None:
        self._kept: dict[str, Any] = {}
        self._lock = threading.Lock()

    def of(self, key: str, make: Callable[[], Any], cancel: Cancel | None = None) -> Any:
        """Return what was made for a key, or make it; one at a time."""
        with self._lock:
            if key in self._kept:
                self._kept[key] = self._kept.pop(key)  # the latest stand last
                return self._kept[key]
            if cancel is not None and cancel():
                raise CancelledError("stopped before it began")
            made = make()
            self._kept[key] = made
            while len(self._kept) > _MOST:
                self._kept.pop(next(iter(self._kept)))
            return made


class Separations:
    """Repeated runs and what the step ``separate`` makes of them."""

    def __init__(
        self,
        files: Sequence[Path],
        read: Callable[[Recipe, list[Path]], RunSet] = read_inputs,
    ) -> None:
        self.files = list(files)
        self._read = read
        self._runs, self._estimates, self._results = _Latest(), _Latest(), _Latest()

    def runs(self, recipe: Recipe) -> RunSet:
        """Return the readings."""
        found: RunSet = self._runs.of(
            _input_key(recipe), lambda: self._read(recipe, list(self.files))
        )
        return found

    def estimate(self, recipe: Recipe, cancel: Cancel | None = None) -> ErrorEstimate:
        """Return the separated error."""
        runs = self.runs(recipe)
        step = next(s for s in recipe.steps if s["op"] == "separate")
        key = _input_key(recipe) + text_key(step)
        found: ErrorEstimate = self._estimates.of(
            key, lambda: separate_inputs(recipe, runs), cancel
        )
        return found

    def result(self, recipe: Recipe, cancel: Cancel | None = None) -> Result:
        """Return everything that the recipe makes of the runs; nothing is written."""
        estimate, runs = self.estimate(recipe, cancel), self.runs(recipe)
        found: Result = self._results.of(
            _shown(recipe), lambda: separated_result(recipe, runs, estimate)
        )
        return found


class MethodResults:
    """What a recipe with one of the named methods makes of its readings."""

    def __init__(self, files: Sequence[Path]) -> None:
        self.files = list(files)
        self._results = _Latest()

    def result(self, recipe: Recipe, cancel: Cancel | None = None) -> Result:
        """Return everything that the recipe makes of the readings; nothing is written."""
        if not recipe.is_method or recipe.is_pipeline:
            raise DataError(f"{recipe.name}: is no recipe of a named method")
        files = None if recipe.reads_nothing else self.files
        found: Result = self._results.of(_shown(recipe), lambda: recipe.run(files), cancel)
        return found


def _shown(recipe: Recipe) -> str:
    """Return what tells results apart: another view of a recipe gives no other numbers.

    With the limits, which may have been left out of what the text says.
    """
    return f"{recipe.name}\0{recipe.recorded['text']}\0{text_key(recipe.checks)}"


def _input_key(recipe: Recipe) -> str:
    return text_key({k: v for k, v in recipe.input.items() if k != "files"})
