"""The numbers of a session: parameters with uncertainty, limits, verdict."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

from metrosep.app.evaluations import Evaluations
from metrosep.app.messages import Answer, Cancel, Message, Tell, level_of, number_or_none, plain
from metrosep.app.sessions import Session, is_extreme, mark_of
from metrosep.core.errors import MetrosepError, RecipeError
from metrosep.recipe.pipeline import Stage
from metrosep.recipe.recipe import Recipe
from metrosep.recipe.result import Result
from metrosep.recipe.step_help import step_words

__all__ = ["metrics"]


def metrics(session: Session, message: Message, cancel: Cancel, tell: Tell) -> Answer:
    """Answer a request ``metrics``."""
    with session.lock:
        opened, document = session.need()
        recipe = document.recipe
    if isinstance(opened.material, Evaluations):
        return _measured(session, message, cancel)
    header: dict[str, Any] = {"hash": mark_of(opened, recipe)}
    if level_of(message) != "full":
        # a separation has no preview: its numbers come with the full pass
        nothing: dict[str, Any] = {
            "is_preview": True,
            "verdict": None,
            "rows": [],
            "messages": [],
            "stages": [],
        }
        return header | nothing, {}
    tell({"k": "progress", "text": "separating" if opened.kind == "runs" else "computing"})
    try:
        result: Result = opened.material.result(recipe, cancel)
    except RecipeError as exc:
        if not recipe.checks:
            raise
        # a limit that cannot be judged: the numbers are still shown
        plain_recipe = _without_checks(recipe)
        result = opened.material.result(plain_recipe, cancel)
        return header | _of_document(result, session) | {"refused": session.words(str(exc))}, {}
    return header | _of_document(result, session), {}


def _without_checks(recipe: Recipe) -> Recipe:
    return replace(recipe, checks=())


def _of_document(result: Result, session: Session) -> dict[str, Any]:
    entries = result.document["characteristics"]
    rows = [
        {
            "symbol": e["metric"],
            "value": number_or_none(e["value"]),
            "unit": e["unit"],
            "u": number_or_none(e.get("u")),
            "definition": e.get("definition") or e.get("name"),
            "waits": False,
        }
        for e in entries
    ]
    checks = [e for e in entries if e.get("verdict") is not None]
    header: dict[str, Any] = {
        "is_preview": False,
        "verdict": result.verdict,
        "rows": list({row["symbol"]: row for row in rows}.values()),
        "messages": [session.words(str(m)) for m in result.document["messages"]],
        "stages": [],
    }
    return header | ({"checks": plain(checks)} if checks else {})


def _measured(session: Session, message: Message, cancel: Cancel) -> Answer:
    from metrosep.recipe.pipeline_run import Measurement, judge_measurement

    # limits of the very recipe whose steps were carried out: an edit may come meanwhile
    outcome, recipe, mark = session.evaluated(level_of(message), cancel=cancel)
    measured = Measurement(outcome.source, outcome.stages)
    found = measured.found
    header: dict[str, Any] = {
        "hash": mark,
        "is_preview": outcome.is_preview,
        "verdict": None,
        "rows": [_row(k, q, preview=outcome.is_preview) for k, q in found.items()],
        "messages": list(dict.fromkeys(m for s in outcome.stages for m in _words(s))),
        "stages": [
            {"index": s.index, "seconds": s.seconds, "messages": _words(s)} for s in outcome.stages
        ],
    }
    if outcome.error is not None:
        header["failed"] = {"index": outcome.failed, "message": str(outcome.error)}
    elif not outcome.is_preview and recipe.checks:
        try:
            judged = judge_measurement(recipe, measured)
        except MetrosepError as exc:
            # a limit of what is not there: the numbers are still shown
            header["refused"] = str(exc)
        else:
            header["verdict"] = judged["verdict"]
            header["checks"] = plain(judged["characteristics"])
    return header, {}


def _words(stage: Stage) -> list[str]:
    """Return the messages of a step in the words of its recipe, as the command line has them."""
    return [step_words(m, stage.op) for m in stage.messages]


def _row(symbol: str, quantity: Any, *, preview: bool) -> dict[str, Any]:
    hidden = preview and is_extreme(symbol)
    return {
        "symbol": symbol,
        "value": None if hidden else number_or_none(quantity.value),
        "unit": quantity.unit,
        "u": None if hidden else number_or_none(quantity.u),
        "definition": quantity.definition,
        "waits": hidden,
    }
