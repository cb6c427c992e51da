"""The numbers of a session: parameters with uncertainty, limits, verdict."""

from __future__ import annotations

import math
import re
import tomllib
from collections.abc import Mapping
from dataclasses import replace
from typing import Any

from metrosep.app.evaluations import Evaluations, Outcome
from metrosep.app.separations import MethodResults, Separations, without_tables
from metrosep.app.sessions import Session, is_extreme, mark_of
from metrosep.app.wire import (
    Answer,
    Cancel,
    Message,
    Tell,
    level_of,
    number_or_none,
    plain,
)
from metrosep.core.errors import DataError, MetrosepError
from metrosep.recipe.pipeline import CancelledError, Stage, usual_names
from metrosep.recipe.recipe import Recipe
from metrosep.recipe.result import Result


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
    result, refused = as_far_as_it_goes(opened.material, recipe, cancel)
    header |= _of_document(result, session)
    return header | ({"refused": session.words(str(refused))} if refused is not None else {}), {}


def as_far_as_it_goes(
    material: Separations | MethodResults, recipe: Recipe, cancel: Cancel
) -> tuple[Result, MetrosepError | None]:
    """Return the numbers of a recipe, and why a limit cannot be judged or a table is refused.

    With a limit or a table that is refused nothing is judged: a verdict is of the whole recipe.
    """
    try:
        return material.result(recipe, cancel), None
    except CancelledError:
        raise
    except MetrosepError as exc:
        refused = exc
    unjudged, bare = replace(recipe, checks=()), replace(without_tables(recipe), checks=())
    for less in [unjudged] * bool(recipe.checks) + [bare] * (bare.outputs != recipe.outputs):
        try:
            return material.result(less, cancel), refused
        except CancelledError:
            raise
        except MetrosepError:
            continue  # the first reason is what the page shows
    raise refused


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
    from metrosep.recipe.pipeline_run import Measurement, judge_measurement, with_sections
    from metrosep.recipe.preflight import require_limits

    # limits of the very recipe whose steps were carried out: an edit may come meanwhile
    outcome, recipe, mark = session.evaluated(level_of(message), cancel=cancel)
    measured = Measurement(outcome.source, outcome.stages)
    lost: list[MetrosepError] = []
    if outcome.error is None and not outcome.is_preview:
        measured = with_sections(recipe, measured, lost=lost)
    # the numbers of the steps and of the other sections are still shown
    refused = "\n".join(session.words(str(exc), ()) for exc in lost)
    found = measured.found
    header: dict[str, Any] = {
        "hash": mark,
        "is_preview": outcome.is_preview,
        "verdict": None,
        "rows": [_row(k, q, preview=outcome.is_preview) for k, q in found.items()],
        "messages": list(
            dict.fromkeys(
                [
                    *(m for s in outcome.stages for m in _words(session, s)),
                    *(m for s in measured.sections for m in s.messages),
                ]
            )
        ),
        "stages": [
            {
                "index": s.index,
                "seconds": s.seconds,
                "messages": _words(session, s),
                "centre": s.audit.get("centre_m", s.audit.get("centre_px")),
            }
            for s in outcome.stages
        ],
    }
    if outcome.error is not None:
        header["failed"] = session.failure(outcome)
        header["rows"] += _lost(recipe, outcome, {row["symbol"] for row in header["rows"]})
    elif refused:
        header["refused"] = refused
    elif not outcome.is_preview:
        try:
            require_limits(recipe)  # what `metrosep run` refuses is not judged here
            judged = judge_measurement(recipe, measured) if recipe.checks else None
        except MetrosepError as exc:
            # a limit of what is not there: the numbers are still shown
            header["refused"] = session.words(str(exc), ())
            header["mends"] = session.mends(exc)
        else:
            if judged is not None:
                header["verdict"] = judged["verdict"]
                header["checks"] = plain(judged["characteristics"])
    return header, {}


def _lost(recipe: Recipe, outcome: Outcome, there: set[str]) -> list[dict[str, Any]]:
    """Return rows without a value for the parameters of the steps behind the one that failed."""
    failed = outcome.failed or 0
    steps = [
        s for s in recipe.steps[failed:] if s["op"] == "parameters" and s.get("enabled", True)
    ]
    names = [n for s in steps for n in s.get("names") or usual_names(outcome.after(-1))]
    why = f"not evaluated, as step {failed + 1} failed"
    empty = {"value": None, "unit": "1", "u": None, "definition": why, "waits": False}
    return [{"symbol": n, **empty} for n in dict.fromkeys(names) if n not in there | {"all"}]


def _words(session: Session, stage: Stage) -> list[str]:
    """Return the messages of a step in the words of its recipe, as the command line has them."""
    return [session.words(m, [stage.op]) for m in stage.messages]


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


# ---- the ranking of the error terms of a machine, as the page draws it -------------------------

_MOTION = re.compile(r"E([XYZABC])([A-Za-z][A-Za-z0-9_]*)")
_PLACE = re.compile(r"E?([XYZABC])0([A-Za-z][A-Za-z0-9_]*)")
_ABOUT = {"A": "X", "B": "Y", "C": "Z"}
_ROTARY = "ABC"


def term_words(term: str) -> str:
    """Return what an error term is, in words.

    Examples
    --------
    >>> term_words("EYX"), term_words("ECC"), term_words("B0Z")
    ('straightness of X in Y', 'positioning of C', 'squareness of Z, angle about Y')
    >>> term_words("EXC"), term_words("EAC"), term_words("EXFTS")
    ('radial motion of C in X', 'tilt of C about X', 'motion of FTS in X')
    """
    if (found := _PLACE.fullmatch(term)) is not None:
        direction, axis = found.groups()
        if direction in _ABOUT:
            return f"squareness of {axis}, angle about {_ABOUT[direction]}"
        return f"place of {axis} in {direction}"
    if (found := _MOTION.fullmatch(term)) is None:
        return ""
    direction, axis = found.groups()
    letter = axis.rstrip("0123456789")
    if direction == letter:
        return f"positioning of {axis}"
    if letter in _ROTARY:
        own = _ABOUT[letter]
        if direction in _ABOUT:
            return f"tilt of {axis} about {_ABOUT[direction]}"
        kind = "axial" if direction == own else "radial"
        return f"{kind} motion of {axis} in {direction}"
    if direction in _ABOUT:
        about = _ABOUT[direction]
        if letter not in "XYZ":
            return f"rotation of {axis} about {about}"
        return f"roll of {axis}" if about == letter else f"rotation of {axis} about {about}"
    return (
        f"straightness of {axis} in {direction}"
        if letter in "XYZ"
        else f"motion of {axis} in {direction}"
    )


def ranking(session: Session, message: Message, cancel: Cancel, tell: Tell) -> Answer:
    """Answer a request ``ranking``."""
    opened, document = session.need()
    recipe = document.recipe
    op = recipe.steps[0]["op"]
    if op != "rank" or not isinstance(opened.material, MethodResults):
        raise DataError(f"there is a ranking of recipes of op rank only, this one is {op}")
    tell({"k": "progress", "words": "ranking"})
    result = opened.material.result(recipe, cancel)
    step = tomllib.loads(document.text)["step"][0]
    return plain(_header(result.produced, step, result.document)), {}


def _header(table: Any, step: Mapping[str, Any], document: Mapping[str, Any]) -> dict[str, Any]:
    written = _written(table.names, step)
    group = {n: g for g in table.groups for n in g}
    numbers = {n: k for k, g in enumerate(table.groups, start=1) for n in g}

    def row(name: str) -> dict[str, Any]:
        i = table.names.index(name)
        key, stored = written[name]
        return {
            "term": name,
            "words": term_words(name),
            "size": table.size_text(name) if stored is None else str(stored),
            "unit": table.units[i],
            "magnitude": float(table.magnitudes[i]),
            "rms": float(table.sq[i]),
            "pv": float(table.pv[i]),
            "rms_raw": float(table.sq_raw[i]),
            "pv_raw": float(table.pv_raw[i]),
            "share": float(table.shares[i]),
            "group": numbers.get(name, 0),
            "alike": [n for n in group.get(name, ()) if n != name],
            "path": ["step", 0, "errors", key],
            "stored": _own(step, key),
        }

    rows = [row(n) for n in table.visible]
    return {
        "rows": rows,
        "cumulative": _running([r["share"] for r in rows]),
        "hidden": [
            {**row(name), "why": why} for why, names in table.hidden.items() for name in names
        ],
        "groups": [list(g) for g in table.groups],
        "left": _left(table),
        "total": {
            "rms": table.expected_sq,
            "rms_raw": table.expected_sq_raw,
            "U": _stated(document, "expected_sq"),
        },
        "response": table.response,
        "responses": ["form", "wavefront"],
        "removed": list(table.removed),
        "distribution": table.distribution,
        "threshold": table.threshold,
        "messages": list(document["messages"]),
    }


def _left(table: Any) -> list[dict[str, Any]]:
    """Return what is left after compensating one term or group after the other, of those seen."""
    found: list[dict[str, Any]] = [{"names": [], "rms": table.expected_sq}]
    for step in table.pareto()[1:]:
        names = [n for n in step.names if n in table.visible]
        if names:
            found.append({"names": names, "rms": step.sq})
    return found if len(found) > 1 else []


def _written(names: tuple[str, ...], step: Mapping[str, Any]) -> dict[str, tuple[str, Any]]:
    """Return under which key each term stands in the recipe, and what says its size there."""
    from metrosep.core.errors import DataError as Unknown
    from metrosep.machine import from_paper
    from metrosep.machine.terms import is_angle

    errors = step.get("errors") or {}
    found: dict[str, tuple[str, Any]] = {}
    for key, value in errors.items():
        name = key
        if key not in names:
            try:
                name = from_paper(key)
            except Unknown:
                continue
        found[name] = (key, value)
    for name in names:
        if name not in found:
            found[name] = (name, step.get("all_angles" if is_angle(name) else "all_lengths"))
    return found


def _own(step: Mapping[str, Any], key: str) -> Any:
    """Return what an edit of the size of one term replaces: None where it has no size of its own."""
    return (step.get("errors") or {}).get(key)


def _running(shares: list[float]) -> list[float]:
    """Return what the first terms, taken together, have of the expected mean square."""
    total, found = 0.0, []
    for share in shares:
        total += share
        found.append(total if math.isfinite(total) else math.nan)
    return found


def _stated(document: Mapping[str, Any], metric: str) -> float | None:
    """Return U of a value, where a check states it."""
    for entry in document["characteristics"]:
        if entry["metric"] == metric and entry.get("U") is not None:
            return float(entry["U"])
    return None
