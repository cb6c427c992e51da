"""Buttons beside what went wrong: each is an edit of the recipe that was tried before it is offered.

An error carries what helps as data (`MetrosepError.hints`): a value is an edit, an example is a
question of the page.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from metrosep.app.documents import Edit, RecipeDocument
from metrosep.app.wire import field_words
from metrosep.core.errors import DataError, Example, MetrosepError, RecipeError
from metrosep.core.numbers import positive
from metrosep.core.units import format_length
from metrosep.io.source import declared_steps

_MOST = 3
"""Buttons under one message."""


def mends_of_step(
    document: RecipeDocument, index: int, error: MetrosepError
) -> list[dict[str, Any]]:
    """Return what may be done where a step cannot be run, what the error names first.

    Each is ``{label, edits}``; with ``ask`` (``{label, hint}``) the page asks for the value of the
    last edit.
    """
    steps = document.recipe.steps
    others = (k for k in range(len(steps)) if k != index)
    found = _offered(document, error.hints, [["step", k] for k in (index, *others)])
    if len(steps) > 1 and steps[index]["op"] != "separate":  # all numbers of runs are of this one
        skip = {"path": ["step", index, "enabled"], "new": False}
        found = found[: _MOST - 1]
        if _works(document, [skip]):
            found.append({"label": f"Skip step {index + 1}", "edits": [skip], "ask": None})
    return _with_old(document, found)


def mends_of_refusal(document: RecipeDocument, error: MetrosepError) -> list[dict[str, Any]]:
    """Return what may be done where steps and limits do not fit together, so that nothing is judged."""
    steps = document.recipe.steps
    table = error.table if isinstance(error, RecipeError) else None
    if table is not None and any(
        "intermediate" in hint for hint in error.hints
    ):  # it came too early
        k = table[1]
        stored = _old(document, ["step", k])
        moved = [
            {"path": ["step", k], "old": stored, "new": None},
            {"path": ["step", len(steps) - 1], "old": None, "new": stored},
        ]
        move = {"label": f"Move step {k + 1} to the end", "edits": moved, "ask": None}
        found = [move, *_offered(document, error.hints, [["step", k]])]
    else:
        found = []
        if table is not None and table[0] == "[[check]]":
            removed = {"path": ["check", table[1]], "new": None}
            remove = {"label": "Remove this limit", "edits": [removed], "ask": None}
            found = [*_offered(document, error.hints, [["check", table[1]]]), remove]
    return _with_old(document, [m for m in found if m["ask"] or _works(document, m["edits"])])


def mends_of_table(
    document: RecipeDocument, at: int, hints: Sequence[Mapping[str, Any]]
) -> list[dict[str, Any]]:
    """Return what may be done where a table is refused; nothing that touches its sign or a waiver."""
    table: list[str | int] = ["output", at]
    places = (table, [*table, "machine"])  # a key of the table, else a fact of its controller
    found = [m for m in _offered(document, hints, places) if not m["ask"]]
    return _with_old(document, found[:_MOST])


def mends_of_edit(
    document: RecipeDocument, edits: Sequence[Edit], error: MetrosepError
) -> list[dict[str, Any]]:
    """Return edits that go with one that was refused, so that both together are taken."""
    made = [{"path": list(e.path), "old": e.old, "new": e.new} for e in edits]
    named = [e.path[1] for e in edits if e.path[0] == "step" and len(e.path) > 1]
    steps = dict.fromkeys([*named, *range(len(document.recipe.steps) + 1)])
    found = _offered(document, error.hints, [["step", k] for k in steps], made)
    return _with_old(document, [m for m in found if not m["ask"]][:_MOST])


def scale(
    _session: Any, message: Mapping[str, Any], *_: Any
) -> tuple[dict[str, Any], dict[str, Any]]:
    """Answer a request ``scale``: the size of a pixel, as typed or of a known length over some px."""
    step, known = (str(message.get(k) or "").strip() for k in ("step", "known"))
    if bool(step) == bool(known):
        raise DataError(
            "give either the size of a pixel or the length of the section, one of the two"
        )
    if step:
        declared_steps(step)
        return {"lateral_step": step}, {}
    length = positive(known, "length of the section", dimension="length")
    pixels = positive(message.get("px"), "length of the section in px")
    return {"lateral_step": format_length(length / pixels, digits=9)}, {}


def _offered(
    document: RecipeDocument,
    hints: Sequence[Mapping[str, Any]],
    places: Sequence[Sequence[str | int]],
    made: Sequence[Mapping[str, Any]] = (),
) -> list[dict[str, Any]]:
    """Return a button for each hint, an edit at the first place, or of ``[input]``, where a recipe takes it."""
    found = []
    for hint in hints:
        for place in (*places, ["input"]):
            mend = _mend(hint, [[*place, k] for k in hint])
            whole = {**mend, "edits": [*made, *mend["edits"]]}
            changes = any(_old(document, e["path"]) != e["new"] for e in mend["edits"])
            if changes and _works(document, whole["edits"]):
                asked = [{**e, "new": None} if mend["ask"] else e for e in whole["edits"]]
                found.append({**whole, "edits": asked})
                break
    return found


def _mend(hint: Mapping[str, Any], places: Sequence[Sequence[Any]]) -> dict[str, Any]:
    edits = [{"path": [*p], "new": v} for p, v in zip(places, hint.values(), strict=True)]
    names = [field_words(k) for k in hint]
    (value, *_) = hint.values()
    if isinstance(value, Example):
        ask = {"label": names[0], "hint": f"such as {value}"}
        return {"label": f"Give the {names[0]}\u2026", "edits": edits, "ask": ask}
    if len(hint) == 1 and isinstance(value, bool):
        return {
            "label": f"Switch {names[0]} {'on' if value else 'off'}",
            "edits": edits,
            "ask": None,
        }
    said = ", ".join(f"{k} = {v}" for k, v in zip(names, hint.values(), strict=True))
    gone = [k for k, v in zip(names, hint.values(), strict=True) if v is None]
    label = f"Remove {', '.join(gone)}" if len(gone) == len(hint) else f"Set {said}"
    return {"label": label, "edits": edits, "ask": None}


def _works(document: RecipeDocument, edits: Sequence[Mapping[str, Any]]) -> bool:
    """Whether the recipe takes these edits; nothing of it is kept."""
    made = [
        Edit(tuple(e["path"]), e["old"] if "old" in e else _old(document, e["path"]), e["new"])
        for e in edits
    ]
    try:
        document.copy().edit(made)
    except MetrosepError:
        return False
    return True


def _with_old(
    document: RecipeDocument, mends: Sequence[Mapping[str, Any]]
) -> list[dict[str, Any]]:
    """Return those that change something, with what stands there now."""
    whole = [
        {**m, "edits": [{"old": _old(document, e["path"]), **e} for e in m["edits"]]}
        for m in mends
    ]
    return [m for m in whole if m["ask"] or any(e["old"] != e["new"] for e in m["edits"])]


def _old(document: RecipeDocument, path: Sequence[str | int]) -> Any:
    """Return what the recipe holds at a place, None where there is nothing."""
    import tomllib

    found: Any = tomllib.loads(document.text)
    for key in path:
        try:
            found = found[key]
        except (KeyError, IndexError, TypeError):
            return None
    return found
