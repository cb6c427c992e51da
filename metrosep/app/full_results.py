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
    """Return what the recipe of a session makes of the full data; nothing is written.

    Parameters
    ----------
    session : Session
        What the page works on.
    cancel : callable
        Asked between steps; true stops.
    tell : callable
        Told what is being done.

    Returns
    -------
    Result
        With the document that ``metrosep run`` writes.

    Raises
    ------
    DataError
        If nothing is open.
    CancelledError
        If `cancel` says so.
    MetrosepError
        Of a step or a check, as the command line says it.
    """
    opened, document = session.need()
    return result_of(opened, document.recipe, cancel, tell)


def result_of(opened: Opened, recipe: Recipe, cancel: Cancel, tell: Tell) -> Result:
    """Return what a recipe makes of what was opened.

    Parameters
    ----------
    opened : Opened
        Files and what they hold.
    recipe : Recipe
        Of their kind.
    cancel, tell : callable
        See `full_result`.

    Returns
    -------
    Result
        With the document that ``metrosep run`` writes.

    Raises
    ------
    CancelledError
        If `cancel` says so.
    MetrosepError
        Of a step or a check.
    """
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
    """Return what was made of a measurement by a recipe, made once and forgotten with it.

    Parameters
    ----------
    material : object
        What the recipe works on; not kept alive.
    what : str
        Tells results, reports and such apart.
    text : str
        Of the recipe.
    make : callable
        Makes it.
    most : int, optional
        How many of this kind are kept.

    Returns
    -------
    object
        What `make` returned; its errors are raised and not kept.
    """
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
