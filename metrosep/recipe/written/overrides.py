"""``-s key=value``: keys of a recipe given beside it, checked by the same grammar.

The key is the path that a reader of the recipe would say: ``title``, ``input.unit``,
``batch.pattern``, ``step.form.robust`` (the only step of that op) or ``step.2.robust``,
``check.roughness.upper`` (by name, by metric or by number), ``output.report.formats``. The value is
read as TOML where that gives what the key takes, else as a text. What is run and recorded is the
recipe with these values in its text (`metrosep.recipe.written.overrides`).
"""

from __future__ import annotations

import json
import math
import re
import tomllib
import unicodedata
from collections.abc import Iterator, Mapping, Sequence
from copy import deepcopy
from dataclasses import dataclass
from datetime import date, time
from pathlib import Path
from typing import Any

from metrosep.core.errors import DataError, RecipeError
from metrosep.core.options import checked
from metrosep.core.readable import did_you_mean
from metrosep.recipe.pipeline import MEASURING
from metrosep.recipe.schema import BATCH, Field
from metrosep.recipe.steps import (
    CHECK,
    INPUT,
    MEASURING_INPUT,
    METHOD_CHECK,
    METHOD_OUTPUTS,
    OUTPUTS,
    STEPS,
)
from metrosep.recipe.written.extends import (
    Layers,
    holds_mark,
    key_parts,
    layers_of,
    marks_after,
    overrides_in,
    parsed,
    split_override,
    texts_of,
    toml_problem,
    with_texts,
    without_marks,
)

Fields = Mapping[str, Field]

_TOPS = ("title", "input", "step", "section", "check", "output", "batch")
_COLUMN: Fields = {name: Field("text") for name in ("column", "unit", "scale")}
_RANGE: Fields = {name: Field("size") for name in ("shortest", "longest")}
_ANY = Field("any")
_NOT_IN_A_LINE = ("Cc", "Cs", "Zl", "Zp")
"""Kinds of characters that a comment cannot hold, or that break a line."""
_DEEPEST = 16
"""Tables and lists in one another, and parts of a key."""
_BITS = 63
"""Of a whole number, beside its sign: what every reader of TOML takes."""


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
            f'unknown key "{top}"; what can be set: {", ".join(_TOPS)}.{did_you_mean(top, _TOPS)}'
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
    if top == "section":
        from metrosep.recipe.map_sections import SECTIONS

        return SECTIONS.get(item.get("kind", ""))
    if top == "output":
        return (OUTPUTS if plain else METHOD_OUTPUTS).get(item.get("kind", ""))
    op = str(item.get("op"))
    if op in MEASURING:
        return {"op": Field("text"), **MEASURING[op].all_keys}
    return METHODS[op].fields if op in METHODS else STEPS.get(op)


def input_fields_of(op: Any) -> Mapping[str, Field] | None:
    """Return the keys that ``[input]`` has."""
    from metrosep.core.methods import METHODS
    from metrosep.recipe.schema import input_fields

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
            f'unknown key "{key}" in {what}; known: {known}.{did_you_mean(key, list(fields))}'
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


# ---- which step, check or output the key of an override means: by name, metric, op, kind or number ----
# A word that fits several is refused, whatever it is to each of them: none of them comes first.

NAMED_BY: Mapping[str, tuple[str, ...]] = {
    "step": ("op",),
    "section": ("name", "kind"),
    "check": ("name", "metric"),
    "output": ("kind",),
}
_LONGEST = 200
"""Letters of an override that a message repeats."""
_MOST_DIGITS = 6
"""Of a number; no recipe has so many steps."""


@dataclass(frozen=True, slots=True)
class Override:
    """One override as it was given, and its two sides."""

    given: str  # all of it, and what stands before and behind the equals sign
    key: str
    raw: str

    def error(self, problem: str) -> RecipeError:
        """Return the error for a problem with it."""
        return RecipeError(f"-s {_short(self.given)}: {problem}", key=_short(self.key))


Set = tuple[Override, tuple[str | int, ...], Field, Any]
"""An override, where it goes, what that takes, and the value."""


def _short(text: str) -> str:
    return text if len(text) <= _LONGEST else f"{text[:_LONGEST]}..."


def number_of(
    override: Override, top: str, rest: Sequence[str], data: Mapping[str, Any], file: str
) -> int:
    """Return which step, check or output is meant."""
    items = data.get(top, [])
    items = items if isinstance(items, list) else []
    labels = [
        {k: str(i[k]) for k in NAMED_BY[top] if k in i} if isinstance(i, dict) else {}
        for i in items
    ]
    own = [next(iter(each.values()), "") for each in labels]
    shown = [f"{n + 1} {_shown(name)}".strip() for n, name in enumerate(own)]
    there = f"the recipe has {', '.join(shown)}" if items else f"the recipe has no {top}"
    if not rest:
        raise override.error(f"say which {top}, by its number or name; {there}")
    found = _meanings(rest[0], labels)
    if len(found) > 1:
        what = _listed([f"the {kind} of {top} {n + 1}" for n, kind in found.items()], "and")
        way = _way(top, list(found), labels, file)
        raise override.error(f"{top} {_short(rest[0])} is ambiguous; it is {what}; {way}")
    if found:
        return next(iter(found))
    proposed = did_you_mean(rest[0], [name for each in labels for name in each.values()])
    raise override.error(
        f"there is no {top} {_short(rest[0])}; {there}; -s changes what is there and adds no {top}."
        f"{proposed}"
    )


def _meanings(word: str, labels: Sequence[Mapping[str, str]]) -> dict[int, str]:
    """Return what a word is to each item that it fits: its name, metric, op, kind or number."""
    found = {
        n: next(kind for kind, label in each.items() if label == word)
        for n, each in enumerate(labels)
        if word in each.values()
    }
    if word.isascii() and word.isdecimal() and len(word) <= _MOST_DIGITS:
        number = int(word) - 1
        if 0 <= number < len(labels):
            found.setdefault(number, "number")
    return dict(sorted(found.items()))


def _way(top: str, fitting: Sequence[int], labels: Sequence[Mapping[str, str]], file: str) -> str:
    """Return how to write each of the items that one word fits."""
    ways = {n: _spelling(top, n, labels) for n in fitting}
    known = [way for way in ways.values() if way is not None]
    stuck = [f"{top} {n + 1}" for n, way in ways.items() if way is None]
    if not stuck:
        return f"write {_listed(known, 'or')}"
    other = "another name" if len(stuck) == 1 else "other names"
    rename = f"give {_listed(stuck, 'and')} {other} in {file}"
    each = [f"{way} for {top} {n + 1}" for n, way in ways.items() if way is not None]
    return f"write {_listed(each, 'or')}, and {rename}" if each else rename


def _spelling(top: str, number: int, labels: Sequence[Mapping[str, str]]) -> str | None:
    """Return a key that means this item alone; None where there is none."""
    for word in (str(number + 1), *labels[number].values()):
        for quote in ("", '"', "'"):
            key = f"{top}.{quote}{word}{quote}"
            pair = split_override(f"{key}.x=1")
            alone = list(_meanings(word, labels)) == [number]
            if alone and pair is not None and key_parts(pair[0]) == [top, word, "x"]:
                return key
    return None


def _shown(name: str) -> str:
    return f'"{name}"' if name.isdecimal() else name


def _listed(texts: Sequence[str], word: str) -> str:
    """Return texts as a sentence lists them: ``a, b or c``."""
    return f" {word} ".join([t for t in (", ".join(texts[:-1]), texts[-1]) if t])


# ---- a key of a recipe changed in its text: comments, order and the numbers of the lines stay ----
# The changed line ends with what was given (`metrosep.recipe.written.extends`), so that the text says
# what was run and why it differs from the file.

Keys = Sequence[str | int]

_BARE = re.compile(r"[A-Za-z0-9_-]+")
_PROBE = "\0 the value of an override"
"""Stands for the new value while its place is looked for; no recipe holds it."""


def toml_text(value: Any) -> str:
    """Return a value as TOML writes it, in one line."""
    if isinstance(value, bool):
        return "true" if value else "false"
    if isinstance(value, str):
        return json.dumps(value, ensure_ascii=False).replace("\x7f", "\\u007f")
    if isinstance(value, Mapping):
        pairs = ", ".join(f"{_key_text(k)} = {toml_text(v)}" for k, v in value.items())
        return f"{{ {pairs} }}" if pairs else "{}"
    if isinstance(value, list | tuple):
        return f"[{', '.join(map(toml_text, value))}]"
    return value.isoformat() if isinstance(value, date | time) else repr(value)


def _key_text(key: str) -> str:
    return key if _BARE.fullmatch(key) else toml_text(key)


def with_value(text: str, path: Keys, value: Any, given: str) -> str | None:
    """Return the text of a recipe with one value changed or added.

    Notes
    -----
    A line may be changed if the text then says what it said, the value apart: each candidate is
    read again. A value of several lines becomes one line, and empty ones keep the numbers.

    Examples
    --------
    >>> print(with_value("metrosep = 1  # version", ["metrosep"], 2, "metrosep=2"))
    metrosep = 2  # version  # set by -s metrosep=2
    """
    text = text.replace("\r\n", "\n")
    wanted = parsed(text)
    if wanted is None:
        return None
    missing = put(wanted, path, _PROBE)
    for made in _candidates(text.split("\n"), path, wanted, missing, given):
        if parsed("\n".join(made)) == wanted:
            return "\n".join(made).replace(toml_text(_PROBE), toml_text(value))
    return None


def put(data: Any, path: Keys, value: Any) -> int:
    """Put a value into parsed TOML."""
    holder, there = data, 0
    for key in path[:-1]:
        if isinstance(key, int) or key in holder:
            there += 1
        holder = holder[key] if isinstance(key, int) else holder.setdefault(key, {})
    there += there == len(path) - 1 and path[-1] in holder
    holder[path[-1]] = value
    return there


def _candidates(
    lines: list[str], path: Keys, wanted: Any, there: int, given: str
) -> Iterator[list[str]]:
    """Yield texts that may say what is wanted: the likeliest first."""
    for depth in range(there, 0, -1):  # the value, or an inline table that holds it
        if isinstance(path[depth - 1], str):
            yield from _changed(lines, path[:depth], _at(wanted, path[:depth]), given)
    if there == len(path):
        return
    new = path[: there + 1]
    value = _at(wanted, new)
    mark = f"  # added by -s {given}"
    if there == 0 and isinstance(value, dict):
        pairs = [f"{_key_text(k)} = {toml_text(v)}{mark}" for k, v in value.items()]
        end = [] if lines[-1] else [""]
        before = lines if lines[-1] else lines[:-1]
        yield [*before, "", f"[{_key_text(str(new[0]))}]", *pairs, *end]
    for tail in _tails(new):
        pair = f"{'.'.join(map(_key_text, tail))} = {toml_text(value)}{mark}"
        for i in range(len(lines), 0, -1):
            if lines[i - 1].strip() and not lines[i - 1].lstrip().startswith("#"):
                yield [*lines[:i], pair, *lines[i:]]


def _changed(lines: list[str], path: Keys, value: Any, given: str) -> Iterator[list[str]]:
    for tail in _tails(path):
        keys = r"\s*\.\s*".join(f"[\"']?{re.escape(k)}[\"']?" for k in tail)
        pair = re.compile(rf"\s*{keys}\s*=\s*")
        for i, line in enumerate(lines):
            found = pair.match(line)
            last = None if found is None else _last_line(lines, i)
            if found is None or last is None:
                continue
            rest = _comment(line) if last == i else ""
            marks = marks_after(rest, given)
            new = f"{found[0].rstrip()} {toml_text(value)}{without_marks(rest)}{marks}"
            yield [*lines[:i], new, *[""] * (last - i), *lines[last + 1 :]]


def _tails(path: Keys) -> Iterator[list[str]]:
    """Yield the ends of a path that a line may begin with: ``R``, then ``fix.R``."""
    for start in range(len(path) - 1, -1, -1):
        if isinstance(path[start], int):
            return
        yield [str(k) for k in path[start:]]


def _last_line(lines: list[str], first: int) -> int | None:
    """Index of the line where a value ends."""
    for last in range(first, len(lines)):
        if parsed("\n".join(lines[first : last + 1])) is not None:
            return last
    return None


def _comment(line: str) -> str:
    """Return the comment of a pair with the spaces before it; empty where there is none."""
    whole = parsed(line)
    for found in re.finditer(r"\s*#", line):
        if parsed(line[: found.start()]) == whole:
            return line[found.start() :].rstrip()
    return ""


def _at(data: Any, path: Keys) -> Any:
    for key in path:
        data = data[key]
    return deepcopy(data)
