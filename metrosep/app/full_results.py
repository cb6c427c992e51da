"""The result of the present recipe on the full data, made once, whatever is open."""

from __future__ import annotations

import threading
from collections.abc import Callable
from typing import Any
from weakref import WeakKeyDictionary

from metrosep.app.evaluations import Evaluations
from metrosep.app.messages import Cancel, Tell
from metrosep.app.opening import Opened
from metrosep.app.sessions import Session
from metrosep.recipe.recipe import Recipe
from metrosep.recipe.result import Result

__all__ = ["full_result", "made_of", "result_of"]

_MOST = 4
"""Results and reports of one measurement that are remembered: undo shows them at once."""

_KEPT: WeakKeyDictionary[Any, dict[str, dict[str, Any]]] = WeakKeyDictionary()
_LOCK = threading.RLock()


def full_result(session: Session, cancel: Cancel, tell: Tell) -> Result:
    """Return what the recipe of a session makes of the full data; nothing is written."""
    opened, document = session.need()
    return result_of(opened, document.recipe, cancel, tell)


def result_of(opened: Opened, recipe: Recipe, cancel: Cancel, tell: Tell) -> Result:
    """Return what a recipe makes of what was opened."""
    material = opened.material
    if not isinstance(material, Evaluations):
        tell({"k": "progress", "words": "computing"})
        return material.result(recipe, cancel)

    def make() -> Result:
        from metrosep.recipe.pipeline_run import Measurement, measured_result, step_error

        outcome = material.outcome(
            recipe.steps,
            "full",
            cancel=cancel,
            tell=lambda text: tell({"k": "progress", "words": text}),
        )
        if outcome.error is not None and outcome.failed is not None:
            raise step_error(outcome.error, recipe, outcome.failed) from None
        return measured_result(recipe, Measurement(outcome.source, outcome.stages))

    found: Result = made_of(material, "result", recipe.recorded["text"], make)
    return found


def made_of(
    material: Any, what: str, text: str, make: Callable[[], Any], *, most: int = _MOST
) -> Any:
    """Return what was made of a measurement by a recipe, made once and forgotten with it."""
    with _LOCK:
        kept = _KEPT.setdefault(material, {}).setdefault(what, {})
        if text in kept:
            kept[text] = kept.pop(text)  # the latest stand last
            return kept[text]
    made = make()
    with _LOCK:
        kept[text] = made
        while len(kept) > most:
            kept.pop(next(iter(kept)))
    return made
