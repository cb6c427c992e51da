"""``-s key=value``: keys of a recipe given beside it, checked by the same grammar.

The key is the path that a reader of the recipe would say: ``title``, ``input.unit``,
``batch.pattern``, ``step.form.robust`` (the only step of that op) or ``step.2.robust``,
``check.roughness.upper`` (by name, by metric or by number), ``output.report.formats``. The value is
read as TOML where that gives what the key takes, else as a text. What is run and recorded is the
recipe with these values in its text (`metrosep.recipe.written.override_text`).
"""

from __future__ import annotations

import math
import tomllib
import unicodedata
from collections.abc import Mapping, Sequence
from copy import deepcopy
from pathlib import Path
from typing import Any

from metrosep.core.errors import DataError, RecipeError
from metrosep.core.options import checked
from metrosep.recipe.schema import BATCH, Field
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
from metrosep.recipe.written.extends import Layers, layers_of, texts_of, with_texts
from metrosep.recipe.written.override_items import NAMED_BY, Override, near, number_of
from metrosep.recipe.written.override_marks import (
    holds_mark,
    key_parts,
    overrides_in,
    split_override,
    toml_problem,
)
from metrosep.recipe.written.override_text import put, with_value

__all__ = ["input_fields_of", "with_overrides"]

Fields = Mapping[str, Field]

_TOPS = ("title", "input", "step", "check", "output", "batch")
_COLUMN: Fields = {name: Field("text") for name in ("column", "unit", "scale")}
_RANGE: Fields = {name: Field("size") for name in ("shortest", "longest")}
_ANY = Field("any")
_NOT_IN_A_LINE = ("Cc", "Cs", "Zl", "Zp")
"""Kinds of characters that a comment cannot hold, or that break a line."""
_DEEPEST = 16
"""Tables and lists in one another, and parts of a key."""
_BITS = 63
"""Of a whole number, beside its sign: what every reader of TOML takes."""

Set = tuple[Override, tuple[str | int, ...], Field, Any]
"""An override, where it goes, what that takes, and the value."""


def with_overrides(text: str, name: str, folder: Path, overrides: Sequence[str]) -> str:
    """Return the text of a recipe with other values.

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
    found: list[Set] = []
    for given in overrides:
        override = _split(given)
        path, field = _resolved(override, layers.data, name)
        for other, its, _, _ in found:
            if path[: len(its)] == its or its[: len(path)] == path:
                raise override.error(f"-s {other.given} sets it too; leave one of them out")
        found.append((override, path, field, _typed(override, field)))
    texts = texts_of(layers.text)
    here: list[tuple[int, str]] = []
    for override, path, field, value in found:
        k = _holder(texts, path)
        here += [(k, value)] if field.kind == "file" and isinstance(value, str) else []
        made = with_value(texts[k], path, value, override.given)
        if made is None:
            raise override.error(
                f"{name} writes this in a way that cannot be changed line by line; edit it there"
            )
        texts[k] = made
    made = with_texts(layers.text, texts, here)
    _require_meant(made, name, folder, layers, found)
    return made


def _require_meant(
    text: str, name: str, folder: Path, before: Layers, found: Sequence[Set]
) -> None:
    """Refuse a text that does not say what was given, all of it and nothing else."""
    wanted, listed = deepcopy(dict(before.data)), overrides_in(text)
    for override, path, _, value in found:
        put(wanted, path, value)
        if override.given not in listed:
            raise override.error(f"it would not be listed as an override; edit {name} instead")
    data = layers_of(text, name, folder).data
    if data == wanted:
        return
    pairs = list(zip(data.get("step", ()), wanted.get("step", ()), strict=True))
    for override, path, field, value in found:
        moved = (t[k] for s, t in pairs for k in t if s.get(k) == value != t[k])
        seen = next(moved, None) if field.kind == "file" else None
        if seen is not None:
            base = before.bases[_holder(texts_of(text), path) - 1][0]
            raise override.error(
                f"{base} names the file {value} of its own folder elsewhere, and the record could "
                f"not tell the two apart; write ./{value} for the one in the folder of {name}, {seen} "
                "for the other"
            )
    raise found[0][0].error(f"{name} writes this in a way that cannot be changed; edit it there")


def _split(given: str) -> Override:
    pair = split_override(given)
    if pair is None:
        raise RecipeError(
            f"-s {given}: write KEY=VALUE, such as step.form.robust=tukey, step.2.degree=5 or "
            'check.Sa.upper="12 nm"'
        )
    override = Override(given.strip(), *pair)
    if any(unicodedata.category(c) in _NOT_IN_A_LINE and c != "\t" for c in given):
        raise Override(repr(given), *pair).error("a line break or the like cannot stand here")
    if holds_mark(given):
        raise override.error(
            'two blanks and "# set by -s" or "# added by -s" mark an override in a recipe, and cannot '
            "stand in one; write one blank before #"
        )
    return override


def _resolved(
    override: Override, data: Mapping[str, Any], file: str
) -> tuple[tuple[str | int, ...], Field]:
    """Return where in the recipe the value goes, and of which kind it is."""
    parts = key_parts(override.key)
    if parts is None:
        raise override.error("a part of the key is empty; write it such as step.2.degree=5")
    if len(parts) > _DEEPEST:
        raise override.error(f"the key has {len(parts)} parts; no key of a recipe is so deep")
    top, rest = parts[0], parts[1:]
    if top not in _TOPS:
        raise override.error(
            f'unknown key "{top}"; what can be set: {", ".join(_TOPS)}.{near(top, _TOPS)}'
        )
    if top == "title":
        if rest:
            raise override.error("title is a text; there is no key in it")
        return ("title",), Field("text")
    path: tuple[str | int, ...] = (top,)
    if top in NAMED_BY:
        number = number_of(override, top, rest, data, file)
        item, rest, path = data[top][number], rest[1:], (top, number)
        what = f"{top} {number + 1}"
        label = next((str(item[k]) for k in NAMED_BY[top] if k in item), "")
        what += f" ({label})" if label else ""
        fields = _item_fields(top, item, data)
    else:
        item, what = data.get(top, {}), f"[{top}]"
        fields = BATCH if top == "batch" else input_fields_of(_first_op(data))
    if not rest:
        known = f": {', '.join(fields)}" if fields else ""
        raise override.error(f"this is all of {what}; name one of its keys{known}")
    return (*path, *rest), _field(override, rest, fields, item, what)


def _first_op(data: Mapping[str, Any]) -> Any:
    steps = data.get("step")
    first = steps[0] if isinstance(steps, list) and steps else None
    return first.get("op") if isinstance(first, dict) else None


def _item_fields(top: str, item: Any, data: Mapping[str, Any]) -> Fields | None:
    """Return the keys of a step, check or output; None where that is not known."""
    from metrosep.core.methods import METHODS

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
    """Return the keys that ``[input]`` has."""
    from metrosep.core.methods import METHODS
    from metrosep.recipe.method import input_fields

    if not isinstance(op, str):
        return None
    if op in METHODS:
        return input_fields(METHODS[op])
    if op in MEASURING:
        return MEASURING_INPUT
    return INPUT if op in STEPS else None


def _field(
    override: Override, rest: Sequence[str], fields: Fields | None, held: Any, what: str
) -> Field:
    """Return the kind of a key, tables inside tables followed; of any kind where that is free."""
    key = rest[0]
    if fields is not None and key not in fields:
        known = ", ".join(fields)
        raise override.error(
            f'unknown key "{key}" in {what}; known: {known}.{near(key, list(fields))}'
        )
    found = _ANY if fields is None else fields[key]
    field = found
    if len(rest) == 1:
        return field
    inner: Fields | None = {"column": _COLUMN, "range": _RANGE}.get(field.kind)
    if found.inner:
        inner = found.inner
    own = held.get(key) if isinstance(held, Mapping) else None
    if inner is None and field.kind not in ("table", "any"):
        raise override.error(f"{key} of {what} is not a table; there is no key in it")
    if own is not None and not isinstance(own, dict):
        raise override.error(
            f"{key} of {what} is {own!r} in the recipe, no table; give all of it: "
            f"-s '{override.key.rpartition('.')[0]}={{ {rest[-1]} = ... }}'"
        )
    return _field(override, rest[1:], inner, own, f"{key} of {what}")


def _typed(override: Override, field: Field) -> Any:
    """Return the value as TOML if the key takes that, else as a text if it takes a text."""
    raw = override.raw
    try:
        read = tomllib.loads(f"v = {raw}")
        given = [read["v"], raw] if len(read) == 1 else [raw]
    except tomllib.TOMLDecodeError:
        given = [raw]
    except (ValueError, RecursionError) as exc:
        why = toml_problem(exc)
        raise override.error(f"the value cannot be read: {why}; a text goes in quotes") from None
    value = next((v for v in given if _suits(v, field)), given[0])
    problem = _beyond(value)
    if problem is not None:
        raise override.error(f"the value cannot be read: {problem}; a text goes in quotes")
    return value


def _beyond(value: Any, depth: int = 0) -> str | None:
    """Return why a value cannot be kept as it is."""
    if depth > _DEEPEST:
        return "it is nested too deeply"
    if isinstance(value, int) and value.bit_length() > _BITS:
        return f"a whole number cannot have more than {_BITS + 1} bits"
    if isinstance(value, float) and math.isnan(value):
        return "nan is not a number"
    inner = value.values() if isinstance(value, Mapping) else value
    each = inner if isinstance(value, Mapping | list) else ()
    return next((p for v in each if (p := _beyond(v, depth + 1)) is not None), None)


def _suits(value: Any, field: Field) -> bool:
    try:
        checked(field, value, "value", bare=False)
    except (DataError, OverflowError):
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
