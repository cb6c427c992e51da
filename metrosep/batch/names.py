"""Names of files as they may stand in results, in an index and on a terminal."""

from __future__ import annotations

import os
import re
from pathlib import PurePath
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from metrosep.batch.units import Unit

__all__ = ["is_utf8", "one_line_name", "safe_name", "utf8_name"]

_LONGEST = 80
_RESERVED = {"con", "prn", "aux", "nul", *(f"{d}{n}" for d in ("com", "lpt") for n in range(10))}


def safe_name(text: str) -> str:
    """Return a text as the name of one folder that cannot lead elsewhere.

    Examples
    --------
    >>> safe_name("../../etc/passwd"), safe_name("part 7"), safe_name("")
    ('_.._etc_passwd', 'part_7', '_')
    """
    name = re.sub(r"[^\w.-]", "_", text)[:_LONGEST].lstrip(".").rstrip(".")
    if not name or name.split(".")[0].casefold() in _RESERVED or name[:6].casefold() == "index.":
        name = f"_{name}"
    return name


def utf8_name(name: str) -> str:
    r"""Return the name of a file as text that every format can hold.

    Examples
    --------
    >>> print(utf8_name("lens_\udcff.x3p"), utf8_name("übung.x3p"))
    lens_\xff.x3p übung.x3p
    """
    try:
        name.encode("utf-8")
    except UnicodeEncodeError:
        raw = name.encode("utf-8", "surrogateescape" if os.name != "nt" else "backslashreplace")
        return raw.decode("utf-8", "backslashreplace")
    return name


def is_utf8(unit: Unit) -> bool:
    """Return whether the names below the input folder that lead to a unit can be written."""
    depth = 0 if unit.name == "." else unit.name.count("/") + 1
    names = PurePath(unit.target).parts[-depth:] if depth else ()
    own = (*names, *(PurePath(f).name for f in unit.files))
    return all(utf8_name(n) == n for n in own)


def one_line_name(text: str) -> str:
    r"""Return a text for one line of a terminal.

    Examples
    --------
    >>> print(one_line_name("part\n7 [31m ü.x3p"), one_line_name("a\x1b"))
    part\n7 [31m ü.x3p a\x1b
    """
    return "".join(
        c if c.isprintable() or c == "\u00a0" else c.encode("unicode_escape").decode("ascii")
        for c in text
    )
