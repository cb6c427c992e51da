"""The grammar of recipes: which keys exist, of which kind, and where a wrong one stands.

TOML, ``metrosep = 1``. Quantities are strings with units; an unknown key names its line, what is
known there and the nearest spelling.
"""

from __future__ import annotations

import difflib
import re
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, Literal

from metrosep.core.errors import RecipeError, UnitError
from metrosep.core.text_options import TEXT_OPTIONS
from metrosep.recipe.kinds import KINDS

__all__ = ["LAYOUT", "Field", "Place", "blanked_texts", "checked_table"]

Kind = Literal[
    "text",
    "flag",
    "number",
    "integer",
    "length",
    "size",
    "uncertainty",
    "time",
    "frequency",
    "speed",
    "column",
    "texts",
    "any",
    "lag",
    "degree",
    "spacing",
    "table",
    "angle",
    "angles",
    "lengths",
    "numbers",
    "limit",
    "expanded",
    "integers",
    "times",
    "speeds",
    "windows",
    "frequencies",
    "range",
    "places",
    "pairs",
    "waves",
    "file",
]


@dataclass(frozen=True, slots=True)
class Place:
    """Where a table stands in a recipe, for messages.

    Parameters
    ----------
    file : str
        Name of the recipe.
    text : str
        Its whole text.
    header : str
        Header such as ``[input]`` or ``[[step]]``; empty for the top.
    number : int
        Which of the equal headers, from 0.
    """

    file: str
    text: str
    header: str = ""
    number: int = 0

    def line_of(self, key: str | None) -> int | None:
        """Return the line of a key of this table, or of its header, from 1.

        Parameters
        ----------
        key : str or None
            The key; the header if None or not found.

        Returns
        -------
        int or None
            Line number.
        """
        lines = blanked_texts(self.text).splitlines()
        first, header = self._first_line(lines)
        if first is None:
            return None
        for i in range(first, len(lines)) if key is not None else ():
            stripped = lines[i].strip()
            if i >= first + header and stripped.startswith("["):
                break
            if re.match(rf"[\"']?{re.escape(str(key))}[\"']?\s*[=.]", stripped):
                return i + 1
        return first + 1 if header else None

    def _first_line(self, lines: list[str]) -> tuple[int | None, int]:
        """Index of the first line of this table, and 1 if that line is its header."""
        if not self.header:
            return 0, 0
        count = -1
        for i, line in enumerate(lines):
            if "".join(line.split("#")[0].split()) == self.header:
                count += 1
                if count == self.number:
                    return i, 1
        return None, 0

    def error(self, problem: str, key: str | None = None) -> RecipeError:
        """Return the error for a problem at a key, with file and line.

        Parameters
        ----------
        problem : str
            What is wrong and what would be right.
        key : str, optional
            The key.

        Returns
        -------
        RecipeError
            To be raised.
        """
        line = self.line_of(key)
        where = self.file if line is None else f"{self.file}:{line}"
        return RecipeError(f"{where}: {problem}", key=key, line=line)


@dataclass(frozen=True, slots=True)
class Field:
    """One key of a table."""

    kind: Kind  # kind of value
    required: bool = False  # whether it must be there
    choices: tuple[str | int, ...] = ()  # or int: allowed values; any if empty


LAYOUT = {n: Field("integer" if n == "skip_rows" else "text") for n in TEXT_OPTIONS}
"""Keys of ``[input]`` that say how a text is written."""


def checked_table(
    data: Mapping[str, Any], fields: Mapping[str, Field], place: Place, *, what: str
) -> dict[str, Any]:
    """Return a table with its values in SI, or refuse it."""
    for key in data:
        if key not in fields:
            near = difflib.get_close_matches(key, list(fields), n=1)
            hint = f' Did you mean "{near[0]}"?' if near else ""
            raise place.error(
                f'unknown key "{key}" in {what}; known: {", ".join(fields)}.{hint}', key
            )
    for key, field in fields.items():
        if field.required and key not in data:
            raise place.error(f'{what} needs the key "{key}"')
    return {key: _value(value, fields[key], place, key) for key, value in data.items()}


def _value(value: Any, field: Field, place: Place, key: str) -> Any:
    if field.choices and (value not in field.choices or isinstance(value, bool)):
        near = difflib.get_close_matches(str(value), [str(c) for c in field.choices], n=1)
        hint = f' Did you mean "{near[0]}"?' if near else ""
        known = ", ".join(str(c) for c in field.choices)
        raise place.error(f"{key} = {value!r} is not one of {known}.{hint}", key)
    try:
        return KINDS[field.kind](value)
    except (TypeError, ValueError, OverflowError, UnitError) as exc:
        raise place.error(f"{key} = {value!r}: {exc}", key) from None


def blanked_texts(text: str) -> str:
    """Return TOML with its texts of several lines blanked, line by line, so that no key hides there."""
    return re.sub(
        r'"""[\s\S]*?"""|\'\'\'[\s\S]*?\'\'\'',
        lambda found: '""' + "\n" * found.group().count("\n"),
        text,
    )
