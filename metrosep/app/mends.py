"""Buttons beside what went wrong: each is an edit of the recipe that was tried before it is offered.

A message of the library names the key that helps, as a recipe has it (``lateral_step = "... um" in
[input]``). What it names with a value is an edit; dots are a question of the page.
"""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping, Sequence
from typing import Any

from metrosep.app.documents import Edit, RecipeDocument
from metrosep.core.errors import MetrosepError, RecipeError

__all__ = ["mends_of_edit", "mends_of_refusal", "mends_of_step"]

_KEY = re.compile(
    r'(?<![\w.\-"])([a-z_]\w*) = ("[^"]*"|\[[^\[\]]*\]|true|false|-?\d[\d.]*)(?: (in \[input\]))?'
)
_ORDER = re.compile(r"\bstep (\d+) evaluates what step \d+ ")
_MOST = 3
"""Buttons under one message."""


def mends_of_step(document: RecipeDocument, index: int, message: str) -> list[dict[str, Any]]:
    """Return what may be done where a step cannot be carried out, what the message names first.

    Each is ``{label, edits}``; with ``ask`` (``{label, hint}``) the page asks for the value of the
    last edit.
    """
    place = ["step", index]
    found = [m for m in _named(message, place) if m["ask"] or _works(document, m["edits"])]
    if len(document.recipe.steps) > 1:
        skip = {"path": [*place, "enabled"], "new": False}
        found = [
            *found[: _MOST - 1],
            {"label": f"Skip step {index + 1}", "edits": [skip], "ask": None},
        ]
    return _with_old(document, [m for m in found if m["ask"] or _works(document, m["edits"])])


def mends_of_refusal(document: RecipeDocument, error: MetrosepError) -> list[dict[str, Any]]:
    """Return what may be done where steps and limits do not fit together, so that nothing is judged."""
    steps = document.recipe.steps
    order = _ORDER.search(str(error))
    if order is not None:
        k = int(order[1]) - 1
        stored = _old(document, ["step", k])
        moved = [
            {"path": ["step", k], "old": stored, "new": None},
            {"path": ["step", len(steps) - 1], "old": None, "new": stored},
        ]
        found = [
            {"label": f"Move step {k + 1} to the end", "edits": moved, "ask": None},
            *(m for m in _named(str(error), ["step", k])),
        ]
    else:
        line = error.line if isinstance(error, RecipeError) else None
        k = "\n".join(document.text.splitlines()[: line or 0]).count("[[check]]") - 1
        removed = {"path": ["check", k], "new": None}
        found = [] if k < 0 else [{"label": "Remove this limit", "edits": [removed], "ask": None}]
    return _with_old(document, [m for m in found if _works(document, m["edits"])])


def mends_of_edit(
    document: RecipeDocument, edits: Sequence[Edit], message: str
) -> list[dict[str, Any]]:
    """Return edits that go with one that was refused, so that both together are taken."""
    made = [{"path": list(e.path), "old": e.old, "new": e.new} for e in edits]
    found = []
    for place in _places(document, edits):
        for mend in _named(message, place):
            whole = {**mend, "edits": [*made, *mend["edits"]]}
            if not mend["ask"] and _works(document, whole["edits"]):
                found.append(whole)
    return _with_old(document, found[:_MOST])


def _places(document: RecipeDocument, edits: Sequence[Edit]) -> Iterator[list[str | int]]:
    """Give the steps that a refused edit may be about: those it names, then all."""
    named = [e.path[1] for e in edits if e.path[0] == "step" and len(e.path) > 1]
    for k in dict.fromkeys([*named, *range(len(document.recipe.steps) + 1)]):
        yield ["step", k]


def _named(message: str, place: list[Any]) -> Iterator[dict[str, Any]]:
    """Give the keys that a message names with a value or dots."""
    seen = set()
    for key, typed, in_input in _KEY.findall(message):
        if key in seen:
            continue
        seen.add(key)
        where = ["input", key] if in_input else [*place, key]
        value = _value(typed)
        if "..." in typed:
            unit = typed.strip('"').replace("...", "").strip()
            ask = {"label": key.replace("_", " "), "hint": f"such as 3 {unit}" if unit else ""}
            label, edit = f"Give the {ask['label']}\u2026", {"path": where, "new": None}
            yield {"label": label, "edits": [edit], "ask": ask}
        elif value is not None:
            edit = {"path": where, "new": value}
            yield {"label": f"Set {key} = {typed.strip(chr(34))}", "edits": [edit], "ask": None}


def _value(typed: str) -> Any:
    """Return a value as a recipe holds it; None where it is a stand-in."""
    import tomllib

    try:
        return tomllib.loads(f"x = {typed}")["x"]
    except tomllib.TOMLDecodeError:
        return None


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
    return [
        {**m, "edits": [{"old": _old(document, e["path"]), **e} for e in m["edits"]]}
        for m in mends
    ]


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
