"""Buttons beside what went wrong: each is an edit of the recipe that was tried before it is offered.

An error carries what helps as data (`MetrosepError.hints`). Else its message names the key, as a
recipe has it (``lateral_step = "... um" in [input]``): a word or a plain number is an edit; dots, and
a quantity with its unit, which is an example there, are a question of the page.
"""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping, Sequence
from typing import Any

from metrosep.app.documents import Edit, RecipeDocument
from metrosep.core.errors import DataError, MetrosepError, RecipeError
from metrosep.core.numbers import positive
from metrosep.core.units import format_length

__all__ = ["mends_of_edit", "mends_of_refusal", "mends_of_step", "mends_of_table", "scale"]

_KEY = re.compile(
    r'(?<![\w.\-"])([a-z_]\w*) = ("[^"]*"|\[[^\[\]]*\]|true|false|-?\d[\d.]*)(?: (in \[input\]))?'
)
_QUANTITY = re.compile(r'"[-+]?\d[\d.]*(?:e[-+]?\d+)? ?[^\s\d"][^\s"]*"')
_MOST = 3
"""Buttons under one message."""


def mends_of_step(
    document: RecipeDocument, index: int, error: MetrosepError | str
) -> list[dict[str, Any]]:
    """Return what may be done where a step cannot be run, what the error names first.

    Each is ``{label, edits}``; with ``ask`` (``{label, hint}``) the page asks for the value of the
    last edit.
    """
    place = ["step", index]
    found = [m for m in _named(error, place) if m["ask"] or _works(document, m["edits"])]
    steps = document.recipe.steps
    if len(steps) > 1 and steps[index]["op"] != "separate":  # all numbers of runs are of this one
        skip = {"path": [*place, "enabled"], "new": False}
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
        found = [
            {"label": f"Move step {k + 1} to the end", "edits": moved, "ask": None},
            *_named(error, ["step", k]),
        ]
    else:
        found = []
        if table is not None and table[0] == "[[check]]":
            removed = {"path": ["check", table[1]], "new": None}
            found = [{"label": "Remove this limit", "edits": [removed], "ask": None}]
    return _with_old(document, [m for m in found if _works(document, m["edits"])])


def mends_of_table(
    document: RecipeDocument, at: int, hints: Sequence[Mapping[str, Any]]
) -> list[dict[str, Any]]:
    """Return what may be done where a table is refused; nothing that touches its sign or a waiver."""
    found = []
    for hint in hints:
        keys = [(["output", at, k], ["output", at, "machine", k]) for k in hint]
        for places in zip(*keys, strict=True):  # a key of the table, else a fact of its controller
            mend = _mend(hint, places)
            if _works(document, mend["edits"]):
                found.append(mend)
                break
    return _with_old(document, found[:_MOST])


def mends_of_edit(
    document: RecipeDocument, edits: Sequence[Edit], error: MetrosepError | str
) -> list[dict[str, Any]]:
    """Return edits that go with one that was refused, so that both together are taken."""
    made = [{"path": list(e.path), "old": e.old, "new": e.new} for e in edits]
    found = []
    for place in _places(document, edits):
        for mend in _named(error, place):
            whole = {**mend, "edits": [*made, *mend["edits"]]}
            if not mend["ask"] and _works(document, whole["edits"]):
                found.append(whole)
    return _with_old(document, found[:_MOST])


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
        positive(step, "size of a pixel", dimension="length")
        return {"lateral_step": step}, {}
    length = positive(known, "length of the section", dimension="length")
    pixels = positive(message.get("px"), "length of the section in px")
    return {"lateral_step": format_length(length / pixels, digits=9)}, {}


def _places(document: RecipeDocument, edits: Sequence[Edit]) -> Iterator[list[str | int]]:
    """Give the steps that a refused edit may be about: those it names, then all."""
    named = [e.path[1] for e in edits if e.path[0] == "step" and len(e.path) > 1]
    for k in dict.fromkeys([*named, *range(len(document.recipe.steps) + 1)]):
        yield ["step", k]


def _mend(hint: Mapping[str, Any], places: Sequence[Sequence[Any]]) -> dict[str, Any]:
    edits = [{"path": [*p], "new": v} for p, v in zip(places, hint.values(), strict=True)]
    said = ", ".join(f"{k.replace('_', ' ')} = {_shown(v)}" for k, v in hint.items())
    gone = [k.replace("_", " ") for k, v in hint.items() if v is None]
    label = f"Remove {', '.join(gone)}" if len(gone) == len(hint) else f"Set {said}"
    return {"label": label, "edits": edits, "ask": None}


def _shown(value: Any) -> str:
    return str(value).lower() if isinstance(value, bool) else str(value)


def _named(error: MetrosepError | str, place: list[Any]) -> Iterator[dict[str, Any]]:
    """Give what an error carries, else the keys that its message names with a value or dots."""
    hints = getattr(error, "hints", ())
    if hints:
        yield from (_mend(hint, [[*place, k] for k in hint]) for hint in hints)
        return
    seen = set()
    for key, typed, in_input in _KEY.findall(str(error)):
        if key in seen:
            continue
        seen.add(key)
        where = ["input", key] if in_input else [*place, key]
        value = _value(typed)
        if "..." in typed or _QUANTITY.fullmatch(typed):
            example = typed.strip('"').replace("...", "3").strip()
            ask = {
                "label": key.replace("_", " "),
                "hint": "" if example == "3" else f"such as {example}",
            }
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
