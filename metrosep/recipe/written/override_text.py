"""A key of a recipe changed in its text: comments, order and the numbers of the lines stay.

The changed line ends with what was given (`metrosep.recipe.written.override_marks`), so that the text says
what was run and why it differs from the file.
"""

from __future__ import annotations

import json
import re
from collections.abc import Iterator, Mapping, Sequence
from copy import deepcopy
from datetime import date, time
from typing import Any

from metrosep.recipe.written.override_marks import marks_after, parsed, without_marks

__all__ = ["put", "toml_text", "with_value"]

Path = Sequence[str | int]

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


def with_value(text: str, path: Path, value: Any, given: str) -> str | None:
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


def put(data: Any, path: Path, value: Any) -> int:
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
    lines: list[str], path: Path, wanted: Any, there: int, given: str
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


def _changed(lines: list[str], path: Path, value: Any, given: str) -> Iterator[list[str]]:
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


def _tails(path: Path) -> Iterator[list[str]]:
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


def _at(data: Any, path: Path) -> Any:
    for key in path:
        data = data[key]
    return deepcopy(data)
