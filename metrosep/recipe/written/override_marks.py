"""What a line of a recipe says of the override that made it: ``# set by -s step.2.degree=5``.

A line that is new says ``added`` in place of ``set``. So each line is still called by its number in
the file, and a result knows from the text alone what was overridden.
"""

from __future__ import annotations

import re
import tomllib
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from metrosep.core.errors import RecipeError

__all__ = [
    "Mark",
    "as_given",
    "holds_mark",
    "key_parts",
    "marks_after",
    "marks_of",
    "overrides_in",
    "parsed",
    "split_override",
    "toml_problem",
    "without_marks",
]

_MARK = re.compile(r"  # (set|added) by -s (.*?)(?=  # (?:set|added) by -s |$)")
_BEGIN = re.compile(r"  # (set|added) by -s")
_IN_RECORD = "#| "
"""Begins the lines of a recipe that another one builds on (`metrosep.recipe.written.extends`)."""
_PIECE = re.compile(r'"[^"]*"|\'[^\']*\'|[^."\']+')


@dataclass(frozen=True, slots=True)
class Mark:
    """What a line says of the override that made it."""

    line: int  # its number in the text, from 1
    is_added: bool  # whether the file has no such line
    given: str  # the override, as it was given


def split_override(given: str) -> tuple[str, str] | None:
    """Return key and value of an override.

    Examples
    --------
    >>> split_override('check."a=b".upper = 12 nm')
    ('check."a=b".upper', '12 nm')
    """
    found = re.match(r'((?:"[^"]*"|\'[^\']*\'|[^="\'])+)=(.*)', given, re.DOTALL)
    if found is None or not found[1].strip():
        return None
    return found[1].strip(), found[2].strip()


def key_parts(key: str) -> list[str] | None:
    """Return the parts of a dotted key; a part that holds a dot is written in quotes.

    Examples
    --------
    >>> key_parts('check."P-V 1.5".upper'), key_parts("step..degree")
    (['check', 'P-V 1.5', 'upper'], None)
    """
    pieces = _PIECE.findall(key)
    parts = [p[1:-1] if p[0] in "\"'" else p.strip() for p in pieces]
    return parts if all(parts) and ".".join(pieces) == key else None


def marks_after(comment: str, given: str) -> str:
    """Return the marks of a line that was changed: one for each key."""
    key = (split_override(given) or ("",))[0]
    kept, kind = [], "set"
    for found in _MARK.finditer(comment):
        if (split_override(found[2]) or ("",))[0] == key:
            kind = found[1]
        else:
            kept.append(found[0])
    return "".join([*kept, f"  # {kind} by -s {given}"])


def parsed(text: str) -> dict[str, Any] | None:
    """Return what TOML holds."""
    try:
        return tomllib.loads(text)
    except (ValueError, RecursionError):  # also numbers of thousands of digits
        return None


def toml_problem(error: Exception) -> str:
    """Return why `tomllib` could not read a text.

    Examples
    --------
    >>> toml_problem(RecursionError())
    'it is nested too deeply'
    """
    if isinstance(error, RecursionError):
        return "it is nested too deeply"
    if isinstance(error, tomllib.TOMLDecodeError):
        return str(error)
    return "a whole number has thousands of digits"


def holds_mark(given: str) -> bool:
    """Return whether an override holds the words that begin a mark, and could not be told from it.

    Examples
    --------
    >>> holds_mark("title=a  # set by -s title=b"), holds_mark("title=a # set by -s title=b")
    (True, False)
    """
    return _BEGIN.search(given) is not None


def without_marks(comment: str) -> str:
    """Return the comment of a line without marks."""
    return _MARK.sub("", comment)


def marks_of(text: str) -> list[Mark]:
    """Return the marks of a text."""
    return [
        Mark(i + 1, found[1] == "added", found[2])
        for i, line in enumerate(text.split("\n"))
        for found in _MARK.finditer(line.rstrip("\r"))
    ]


def as_given(error: RecipeError, file: str, text: str, problem: str) -> RecipeError:
    """Return the error of a line as a person finds it, who has the file and gave the overrides."""
    line = error.line
    marks = [] if line is None else marks_of(text)
    if line is None or not marks:
        return error
    given = " -s ".join(m.given for m in marks if m.line == line)
    if given:
        return RecipeError(f"{file}, -s {given}: {problem}", key=error.key)
    line -= sum(m.is_added and m.line < line for m in marks)
    return RecipeError(f"{file}:{line}: {problem}", key=error.key, line=line)


def overrides_in(text: str) -> tuple[str, ...]:
    """Return what was overridden in a recipe.

    Examples
    --------
    >>> overrides_in("metrosep = 1  # set by -s metrosep=1")
    ('metrosep=1',)
    >>> overrides_in("metrosep = 3  # set by -s metrosep=1")
    ()
    """
    lines = text.split("\n")
    found = [m.given for m in marks_of(text) if _holds(lines[m.line - 1], m.given)]
    return tuple(dict.fromkeys(found))


def _holds(line: str, given: str) -> bool:
    pair, data = split_override(given), parsed(line.removeprefix(_IN_RECORD))
    parts = None if pair is None else key_parts(pair[0])
    if pair is None or parts is None or not data:
        return False
    read = parsed(f"v = {pair[1]}")
    for start in range(len(parts)):
        held: Any = data
        for key in parts[start:]:
            held = held.get(key) if isinstance(held, Mapping) else None
        if held is not None:
            return held == pair[1] or (read is not None and held == read["v"])
    return any(isinstance(v, list) for v in data.values())  # steps in one line
