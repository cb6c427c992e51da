"""The table ``[view]``: what the workbench shows of a measurement. Runs and results know nothing of it."""

from __future__ import annotations

import re
import tomllib
from typing import Any

from metrosep.recipe.schema import blanked_texts
from metrosep.recipe.written.extends import before_record

__all__ = ["without_view_block"]

_HEADER = re.compile(r"\s*\[\s*(?:view|\"view\"|'view')\s*\]\s*(?:#.*)?$")


def without_view_block(text: str) -> str:
    r"""Return the text of a recipe without its table ``[view]``; all else stays as it is written.

    The record of what it builds on stays too.

    Examples
    --------
    >>> without_view_block('metrosep = 1\n\n[view]\ntab = "report"\n')
    'metrosep = 1\n'
    """
    end = before_record(text)
    return _without(text[:end]) + text[end:]


def _without(text: str) -> str:
    lines = text.splitlines(keepends=True)
    plain = blanked_texts(text).splitlines()
    first = next((i for i, line in enumerate(plain) if _HEADER.match(line)), None)
    if first is None:
        return text
    held = tomllib.loads(text)
    held.pop("view")
    for after in range(first + 1, len(plain) + 1):
        # the next header may be a line of an array: the rest must say what it said
        if after < len(plain) and not plain[after].lstrip().startswith("["):
            continue
        made = "".join(lines[:first] + lines[after:])
        if _says(made, held):
            break
    else:
        return text
    before = "".join(lines[:first])
    if after == len(plain):
        return before.rstrip("\n") + "\n"
    return before + "".join(lines[after:])


def _says(text: str, held: dict[str, Any]) -> bool:
    """Whether a text is TOML with this content."""
    try:
        return tomllib.loads(text) == held
    except tomllib.TOMLDecodeError:
        return False
