"""What is said about a table, in the keys of the output that asks for it.

The library names its arguments, ``direction='both'``; a recipe has ``direction = "both"``, and facts of
the controller in ``machine``.
"""

from __future__ import annotations

import re
from collections.abc import Iterator
from contextlib import contextmanager

from metrosep.core.errors import MetrosepError
from metrosep.core.readable import NUMBER

ARGUMENT = re.compile(r"(?<![\w.\-\"'])([a-z_]+)=(?!=)('[^']*'|\"[^\"]*\"|[-+]?[\w.]*\w)?")

_WAIVED = re.compile(r"say waive='([^']*)'")
"""A way out that is a key of the output whose file was refused."""


def waived(message: str) -> str:
    """Return a message with the waiver that it asks for as the key of an output."""

    def listed(found: re.Match[str]) -> str:
        return "write waive = [" + ", ".join(f'"{c}"' for c in found[1].split(", ")) + "] there"

    return _WAIVED.sub(listed, message)


def table_words(message: str, controller: str) -> str:
    """Return a message about a table with its arguments as keys of the output and of its machine.

    Examples
    --------
    >>> table_words("use direction='both', or give capacity=300", "isg-plane")
    'use direction = "both", or give capacity = 300 in machine'
    """
    from metrosep.controllers.options import LIMIT_NAMES
    from metrosep.controllers.registry import find

    facts = {*LIMIT_NAMES, *(o.name for o in find(controller).options)}

    def key(found: re.Match[str]) -> str:
        name, value = found.groups()
        if re.search(r"\w\([^()]*$", found.string[: found.start()]):  # a call of Python
            return found.group()
        if value is None:
            return name
        typed = value.strip("'\"")
        typed = typed.lower() if typed in ("True", "False") else typed
        plain = re.fullmatch(rf"true|false|{NUMBER}", typed) and typed == value.lower()
        where = " in machine" if name in facts else ""
        return f"{name} = {typed}{where}" if plain else f'{name} = "{typed}"{where}'

    return ARGUMENT.sub(key, waived(message))


@contextmanager
def in_table_words(controller: str) -> Iterator[None]:
    """Let errors about a table name keys of its output."""
    try:
        yield
    except MetrosepError as exc:
        exc.args = (table_words(str(exc), controller), *exc.args[1:])
        raise
