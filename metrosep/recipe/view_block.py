"""The table ``[view]``: what the workbench shows of a measurement. Runs and results know nothing of it."""

from __future__ import annotations

import re

from metrosep.recipe.schema import blanked_texts

__all__ = ["without_view_block"]

_HEADER = re.compile(r"\s*\[\s*(?:view|\"view\"|'view')\s*\]\s*(?:#.*)?$")


def without_view_block(text: str) -> str:
    r"""Return the text of a recipe without its table ``[view]``; all else stays as it is written.

    Parameters
    ----------
    text : str
        TOML.

    Returns
    -------
    str
        The same text where there is no such table.

    Examples
    --------
    >>> without_view_block('metrosep = 1\n\n[view]\ntab = "report"\n')
    'metrosep = 1\n'
    """
    lines = text.splitlines(keepends=True)
    plain = blanked_texts(text).splitlines()
    first = next((i for i, line in enumerate(plain) if _HEADER.match(line)), None)
    if first is None:
        return text
    after = next(
        (i for i in range(first + 1, len(plain)) if plain[i].lstrip().startswith("[")), len(plain)
    )
    before = "".join(lines[:first])
    if after == len(plain):
        return before.rstrip("\n") + "\n"
    return before + "".join(lines[after:])
