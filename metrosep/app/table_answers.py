"""Answers about a controller's table: which controllers there are, its preview, and its file."""

from __future__ import annotations

import re
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from metrosep.app.controller_lists import described_controllers, machine_facts
from metrosep.app.documents import Edit, RecipeDocument
from metrosep.app.messages import Answer, Cancel, Message, Tell
from metrosep.app.opening import Opened
from metrosep.app.separations import Separations
from metrosep.app.sessions import Session, mark_of
from metrosep.app.table_views import view_table
from metrosep.app.table_writing import make_trial, trial_words, write_file, write_trial
from metrosep.app.wanted_tables import Wanted
from metrosep.controllers.registry import find, names
from metrosep.controllers.safety import CHECKS
from metrosep.core.errors import DataError, MetrosepError, RecipeError
from metrosep.core.runset import RunSet
from metrosep.recipe.pipeline import CancelledError
from metrosep.recipe.preflight import machine_limits, output_name
from metrosep.recipe.recipe import Recipe
from metrosep.separation.base import ErrorEstimate

__all__ = ["controllers", "table"]

_ENTRIES = 100
"""About as many has the first table that the page suggests."""


def controllers(session: Session, message: Message, cancel: Cancel, tell: Tell) -> Answer:
    """Answer a request ``controllers``."""
    return {
        "controllers": described_controllers(),
        "machine": machine_facts(),
        "checks": dict(CHECKS),
    }, {}


def table(session: Session, message: Message, cancel: Cancel, tell: Tell) -> Answer:
    """Answer a request ``table``: the preview of a table, or its file."""
    opened, document = session.need()
    material = opened.material
    if not isinstance(material, Separations):
        raise DataError(
            f"a table over one axis is made of separated runs; what is open is a {opened.kind}"
        )
    _require_same(opened, document, message)
    stored = document.recipe
    found = _tables(stored)
    draft = message.get("draft")
    if not found and not isinstance(draft, Mapping):
        if message.get("write") is not None:
            raise DataError("the recipe has no table; add one first")
        return {"n_tables": 0, "suggested": _suggested(stored, material.runs(stored))}, {}
    recipe, refused = _with_draft(document, found, message)
    if refused is not None:
        return {"n_tables": len(found), "refused": refused}, {}
    wanted = _wanted(recipe, _number(message, len(_tables(recipe))))
    tell({"k": "progress", "text": "separating"})
    estimate, runs = material.estimate(stored, cancel), material.runs(stored)
    if cancel():
        raise CancelledError("stopped before the table was made")
    if message.get("write") is not None:
        if isinstance(draft, Mapping):
            raise DataError("a draft is not written; put it into the recipe first")
        return _written(session, message, wanted, estimate, runs), {}
    view = view_table(wanted, estimate, runs)
    header = {
        "n_tables": len(found),
        "name": wanted.output["path"],
        **view.header,
        **_trial_texts(message, wanted, estimate, runs),
    }
    return header, view.arrays


# ---- which table -----------------------------------------------------------------------------


def _require_same(opened: Opened, document: RecipeDocument, message: Message) -> None:
    shown = message.get("hash")
    if shown is not None and shown != mark_of(opened, document.recipe):
        raise DataError("the recipe has changed since what is shown; look at the new table first")


def _tables(recipe: Recipe) -> list[int]:
    """Return which of the outputs are tables."""
    return [i for i, o in enumerate(recipe.outputs) if o["kind"] == "table"]


def _number(message: Message, n: int) -> int:
    number = message.get("output", 0)
    if isinstance(number, bool) or not isinstance(number, int) or not 0 <= number < n:
        raise DataError(f"output is the number of a table, 0 to {n - 1}; got {number!r}")
    return number


def _with_draft(
    document: RecipeDocument, found: list[int], message: Message
) -> tuple[Recipe, dict[str, Any] | None]:
    """Return the recipe with a draft in the place of a table, or why it would be none."""
    draft = message.get("draft")
    if draft is None:
        return document.recipe, None
    if not isinstance(draft, Mapping):
        raise DataError(f"draft is an output of a recipe, got {draft!r}")
    at, old = len(document.recipe.outputs), None
    if found:
        at = found[_number(message, len(found))]
        old = _stored(document, at)
    trial = document.anew()
    try:
        trial.edit([Edit(("output", at), old, dict(draft))])
    except RecipeError as exc:
        missing = _missing(draft)
        words = {"message": str(exc), "check": "", "checks": [], "waivable": False}
        return document.recipe, {**words, "option": missing}
    return trial.recipe, None


def _stored(document: RecipeDocument, at: int) -> Any:
    import tomllib

    return tomllib.loads(document.text)["output"][at]


def _missing(draft: Mapping[str, Any]) -> str | None:
    """Return the first required option that a draft does not state."""
    name, machine = draft.get("controller"), draft.get("machine", {})
    if name not in names() or not isinstance(machine, Mapping):
        return None
    asked = (o.name for o in find(str(name)).options if o.required and machine.get(o.name) is None)
    return next(asked, None)


def _wanted(recipe: Recipe, number: int) -> Wanted:
    at = _tables(recipe)[number]
    output, place = recipe.outputs[at], recipe.place("[[output]]", at)
    steps = (s for s in recipe.steps if s["op"] == "polynomial")
    degree = next((s.get("degree", "aicc") for s in steps), "aicc")
    name = output_name(output["path"], place)
    return Wanted({**output, "path": name}, machine_limits(output, place), degree)


# ---- a table to begin with -------------------------------------------------------------------


def _suggested(recipe: Recipe, runs: RunSet) -> dict[str, Any]:
    """Return an output that can be added to a recipe without a table."""
    span = max(float(run.x.max()) for run in runs) - min(float(run.x.min()) for run in runs)
    axis = _axis_of(recipe.input.get("x")) or "X"
    compensates = _axis_of(recipe.input.get("z"))
    return {
        "kind": "table",
        "controller": "csv",
        "axis": axis,
        # which axis is corrected is never assumed: the form asks where no column says it
        **({} if compensates is None else {"compensates": compensates}),
        "spacing": _near(span / _ENTRIES),
        "path": f"{axis.lower()}-{(compensates or axis).lower()}.csv",
    }


def _axis_of(column: Any) -> str | None:
    """Return the axis that the name of a column tells: ``x_mm`` is X."""
    name = column.get("column", "") if isinstance(column, Mapping) else column
    found = re.match(r"([XYZABCUVW])[0-9]?(?![A-Za-z])", str(name).strip().upper())
    return found.group(1) if found else None


def _near(length: float) -> str:
    """Return 1, 2 or 5 with zeros, not above a length, as text.

    Examples
    --------
    >>> _near(0.45e-3), _near(1.7e-5)
    ('0.2 mm', '10 um')
    """
    micrometres = length * 1e6
    power = -3
    while 10.0 ** (power + 1) <= micrometres * (1 + 1e-9):
        power += 1
    digit = next(d for d in (5, 2, 1) if d == 1 or d * 10.0**power <= micrometres * (1 + 1e-9))
    size = digit * 10.0**power
    return f"{size / 1000:g} mm" if size >= 100 else f"{size:g} um"


# ---- files -----------------------------------------------------------------------------------


def _trial_texts(
    message: Message, wanted: Wanted, estimate: ErrorEstimate, runs: RunSet
) -> dict[str, Any]:
    """Return what a trial with a bump of a height would tell to do; nothing is written."""
    if message.get("trial") is None:
        return {}
    try:
        return {"trial": trial_words(make_trial(wanted, estimate, runs, message["trial"]))}
    except MetrosepError as exc:
        return {"trial": {"refused": str(exc)}}


def _written(
    session: Session,
    message: Message,
    wanted: Wanted,
    estimate: ErrorEstimate,
    runs: RunSet,
) -> dict[str, Any]:
    given = message["write"]
    if not isinstance(given, str):
        raise DataError(f"write is the path of a file, got {given!r}")
    target: Path = session.target(given)
    overwrite = message.get("overwrite") is True
    if message.get("trial") is not None:
        trial = make_trial(wanted, estimate, runs, message["trial"])
        return write_trial(wanted, trial, target, overwrite=overwrite)
    return write_file(wanted, estimate, runs, target, overwrite=overwrite)
