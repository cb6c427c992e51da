"""``-s key=value``: keys of a recipe given beside it, checked by the same grammar.

The key is the path that a reader of the recipe would say: ``title``, ``input.unit``,
``batch.pattern``, ``step.form.robust`` (the only step of that op) or ``step.2.robust``,
``check.roughness.upper`` (by name, by metric or by number), ``output.report.formats``. The value is
read as TOML where that gives what the key takes, else as a text. What is run and recorded is the
recipe with these values in its text (`metrosep.recipe.override_text`).
"""

from __future__ import annotations

import difflib
import tomllib
import unicodedata
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from metrosep.core.errors import RecipeError, UnitError
from metrosep.recipe.batch_keys import BATCH
from metrosep.recipe.extends import layers_of, texts_of, with_texts
from metrosep.recipe.kinds import KINDS
from metrosep.recipe.override_marks import key_parts, split_override
from metrosep.recipe.override_text import with_value
from metrosep.recipe.pipeline_keys import Key
from metrosep.recipe.schema import Field
from metrosep.recipe.steps import (
    CHECK,
    INPUT,
    MEASURING,
    MEASURING_INPUT,
    METHOD_CHECK,
    METHOD_OUTPUTS,
    OUTPUTS,
    STEPS,
)

__all__ = ["input_fields_of", "with_overrides"]

Fields = Mapping[str, Field | Key]

_TOPS = ("title", "input", "step", "check", "output", "batch")
_NAMED_BY = {"step": ("op",), "check": ("name", "metric"), "output": ("kind",)}
_COLUMN: Fields = {name: Field("text") for name in ("column", "unit", "scale")}
_RANGE: Fields = {name: Field("size") for name in ("shortest", "longest")}
_ANY = Field("any")
_NOT_IN_A_LINE = ("Cc", "Cs", "Zl", "Zp")
"""Kinds of characters that a comment cannot hold, or that break a line."""


@dataclass(frozen=True, slots=True)
class _Override:
    """One override as it was given, and its two sides."""

    given: str
    key: str
    raw: str

    def error(self, problem: str) -> RecipeError:
        return RecipeError(f"-s {self.given}: {problem}", key=self.key)


def with_overrides(text: str, name: str, folder: Path, overrides: Sequence[str]) -> str:
    """Return the text of a recipe with other values.

    Parameters
    ----------
    text : str
        TOML of the recipe.
    name : str
        Its name, for messages.
    folder : Path
        Where names of recipes that it builds on start.
    overrides : sequence of str
        Each ``key=value``.

    Returns
    -------
    str
        TOML that needs no other file: what it builds on stands behind it, as it is recorded.

    Raises
    ------
    RecipeError
        If an override has no ``=``, names a key, step, check or output that is not there, or one
        that another override names too; if the text is not TOML.

    Examples
    --------
    >>> text = '''metrosep = 1
    ... [input]
    ... [[step]]
    ... op = "parameters"
    ... names = ["Sa"]  # of the drawing
    ... '''
    >>> made = with_overrides(text, "r.toml", Path("."), ["step.parameters.names=Sq"])
    >>> print(made.splitlines()[4])
    names = "Sq"  # of the drawing  # set by -s step.parameters.names=Sq
    """
    layers = layers_of(text, name, folder)
    found: list[tuple[_Override, tuple[str | int, ...], Any]] = []
    for given in overrides:
        override = _split(given)
        path, field = _resolved(override, layers.data)
        for other, its, _ in found:
            if path[: len(its)] == its or its[: len(path)] == path:
                raise override.error(f"-s {other.given} sets it too; leave one of them out")
        found.append((override, path, _typed(override.raw, field)))
    texts = texts_of(layers.text)
    for override, path, value in found:
        k = _holder(texts, path)
        made = with_value(texts[k], path, value, override.given)
        if made is None:
            raise override.error(
                f"{name} writes this in a way that cannot be changed line by line; edit it there"
            )
        texts[k] = made
    return with_texts(layers.text, texts)


def _split(given: str) -> _Override:
    pair = split_override(given)
    if pair is None:
        raise RecipeError(
            f"-s {given}: write KEY=VALUE, such as step.form.robust=tukey, step.2.degree=5 or "
            'check.Sa.upper="12 nm"'
        )
    override = _Override(given.strip(), *pair)
    if any(unicodedata.category(c) in _NOT_IN_A_LINE and c != "\t" for c in given):
        raise _Override(repr(given), *pair).error("a line break or the like cannot stand here")
    return override


def _resolved(override: _Override, data: Mapping[str, Any]) -> tuple[tuple[str | int, ...], Field]:
    """Return where in the recipe the value goes, and of which kind it is."""
    parts = key_parts(override.key)
    if parts is None:
        raise override.error("a part of the key is empty; write it such as step.2.degree=5")
    top, rest = parts[0], parts[1:]
    if top not in _TOPS:
        raise override.error(
            f'unknown key "{top}"; what can be set: {", ".join(_TOPS)}.{_near(top, _TOPS)}'
        )
    if top == "title":
        if rest:
            raise override.error("title is a text; there is no key in it")
        return ("title",), Field("text")
    path: tuple[str | int, ...] = (top,)
    if top in _NAMED_BY:
        number = _number(override, top, rest, data)
        item, rest, path = data[top][number], rest[1:], (top, number)
        what = f"{top} {number + 1}"
        label = next((str(item[k]) for k in _NAMED_BY[top] if k in item), "")
        what += f" ({label})" if label else ""
        fields = _item_fields(top, item, data)
    else:
        item, what = data.get(top, {}), f"[{top}]"
        fields = BATCH if top == "batch" else input_fields_of(_first_op(data))
    if not rest:
        known = f": {', '.join(fields)}" if fields else ""
        raise override.error(f"this is all of {what}; name one of its keys{known}")
    return (*path, *rest), _field(override, rest, fields, item, what)


def _number(override: _Override, top: str, rest: Sequence[str], data: Mapping[str, Any]) -> int:
    """Return which step, check or output is meant, from 0."""
    items = data.get(top, [])
    items = items if isinstance(items, list) else []
    names = [
        [str(i[k]) for k in _NAMED_BY[top] if k in i] if isinstance(i, dict) else [] for i in items
    ]
    shown = [f"{n + 1} {own[0]}" if own else str(n + 1) for n, own in enumerate(names)]
    there = f"the recipe has {', '.join(shown)}" if items else f"the recipe has no {top}"
    if not rest:
        raise override.error(f"say which {top}, by its number or name; {there}")
    wanted = rest[0]
    for level in range(len(_NAMED_BY[top])):
        found = [n for n, own in enumerate(names) if wanted in own[level : level + 1]]
        if len(found) > 1:
            numbers = " or ".join(f"{top}.{n + 1}" for n in found)
            raise override.error(f"{top} {wanted} is ambiguous; {there}; write {numbers}")
        if found:
            return found[0]
    if wanted.isdecimal() and 1 <= int(wanted) <= len(items):
        return int(wanted) - 1
    near = _near(wanted, [name for own in names for name in own])
    raise override.error(
        f"there is no {top} {wanted}; {there}; -s changes what is there and adds no {top}.{near}"
    )


def _first_op(data: Mapping[str, Any]) -> Any:
    steps = data.get("step")
    first = steps[0] if isinstance(steps, list) and steps else None
    return first.get("op") if isinstance(first, dict) else None


def _item_fields(top: str, item: Any, data: Mapping[str, Any]) -> Fields | None:
    """Return the keys of a step, check or output; None where that is not known."""
    from metrosep.recipe.methods import METHODS

    if not isinstance(item, dict):
        return None
    first = _first_op(data)
    plain = first in STEPS and first not in MEASURING
    if top == "check":
        return CHECK if plain else METHOD_CHECK
    if top == "output":
        return (OUTPUTS if plain else METHOD_OUTPUTS).get(item.get("kind", ""))
    op = str(item.get("op"))
    if op in MEASURING:
        return {"op": Field("text"), **MEASURING[op].all_keys}
    return METHODS[op].fields if op in METHODS else STEPS.get(op)


def input_fields_of(op: Any) -> Mapping[str, Field] | None:
    """Return the keys that ``[input]`` has.

    Parameters
    ----------
    op : object
        Of the first step.

    Returns
    -------
    mapping of str to Field or None
        None where there is no such step.
    """
    from metrosep.recipe.methods import METHODS, input_fields

    if not isinstance(op, str):
        return None
    if op in METHODS:
        return input_fields(METHODS[op])
    if op in MEASURING:
        return MEASURING_INPUT
    return INPUT if op in STEPS else None


def _field(
    override: _Override, rest: Sequence[str], fields: Fields | None, held: Any, what: str
) -> Field:
    """Return the kind of a key, tables inside tables followed; of any kind where that is free."""
    key = rest[0]
    if fields is not None and key not in fields:
        known = ", ".join(fields)
        raise override.error(
            f'unknown key "{key}" in {what}; known: {known}.{_near(key, list(fields))}'
        )
    found = _ANY if fields is None else fields[key]
    field = found.field if isinstance(found, Key) else found
    if len(rest) == 1:
        return field
    inner: Fields | None = {"column": _COLUMN, "range": _RANGE}.get(field.kind)
    if isinstance(found, Key) and found.inner:
        inner = found.inner
    own = held.get(key) if isinstance(held, Mapping) else None
    if inner is None and field.kind not in ("table", "any"):
        raise override.error(f"{key} of {what} is no table; there is no key in it")
    if own is not None and not isinstance(own, dict):
        raise override.error(
            f"{key} of {what} is {own!r} in the recipe, no table; give all of it: "
            f"-s '{override.key.rpartition('.')[0]}={{ {rest[-1]} = ... }}'"
        )
    return _field(override, rest[1:], inner, own, f"{key} of {what}")


def _typed(raw: str, field: Field) -> Any:
    """Return the value as TOML if the key takes that, else as a text if it takes a text."""
    try:
        read = tomllib.loads(f"v = {raw}")
        given = [read["v"], raw] if len(read) == 1 else [raw]
    except tomllib.TOMLDecodeError:
        given = [raw]
    return next((v for v in given if _suits(v, field)), given[0])


def _suits(value: Any, field: Field) -> bool:
    if field.choices and (value not in field.choices or isinstance(value, bool)):
        return False
    try:
        KINDS[field.kind](value)
    except (TypeError, ValueError, UnitError):
        return False
    return True


def _holder(texts: Sequence[str], path: Sequence[str | int]) -> int:
    """Return which text holds what is changed: the nearest one, 0, where none does."""
    each = [tomllib.loads(t) for t in texts]
    top = str(path[0])
    if top in ("input", "batch"):
        deep = (n for n, d in enumerate(each) if path[1] in (d.get(top) or {}))
        if (found := next(deep, None)) is not None:
            return found
    return next((n for n, d in enumerate(each) if top in d), 0)


def _near(word: str, known: Sequence[str]) -> str:
    found = difflib.get_close_matches(word, known, n=1)
    return f' Did you mean "{found[0]}"?' if found else ""
