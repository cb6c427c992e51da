"""Which step, check or output the key of an override means: by name, metric, op, kind or number.

A word that fits several is refused, whatever it is to each of them: none of them comes first.
"""

from __future__ import annotations

import difflib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from metrosep.core.errors import RecipeError
from metrosep.recipe.written.override_marks import key_parts, split_override

__all__ = ["NAMED_BY", "Override", "near", "number_of"]

NAMED_BY: Mapping[str, tuple[str, ...]] = {
    "step": ("op",),
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
    proposed = near(rest[0], [name for each in labels for name in each.values()])
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


def near(word: str, known: Sequence[str]) -> str:
    """Return the question whether another word was meant."""
    found = difflib.get_close_matches(word, known, n=1) if len(word) <= _LONGEST else []
    return f' Did you mean "{found[0]}"?' if found else ""
