"""What a batch leaves out of its input folder: told at the end, and in the index."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from typing import Any

from metrosep.batch.names import one_line_name, utf8_name

__all__ = ["CLOSED", "LeftOut", "sentences"]

CLOSED = "closed"
"""Folders that cannot be read: nobody knows what is in them, so that such a batch is no success."""

_SHOWN = 3


@dataclass(frozen=True, slots=True)
class LeftOut:
    """Files or folders that are left out for one reason.

    Parameters
    ----------
    what : str
        Which reason: "pattern", "links", `CLOSED`, "case", "odd" or "outputs".
    why : str
        The same as the end of a sentence about them.
    names : tuple of str
        Below the input folder, by name.
    """

    what: str
    why: str
    names: tuple[str, ...]

    def record(self) -> dict[str, Any]:
        """Return what the index says of them.

        Returns
        -------
        dict
            ``what``, ``why``, ``count``, ``names``; names in UTF-8.
        """
        names = [utf8_name(n) for n in self.names]
        return {"what": self.what, "why": self.why, "count": len(names), "names": names}


def sentences(records: Iterable[Mapping[str, Any]], place: str) -> list[str]:
    """Return what was left out as sentences.

    Examples
    --------
    >>> links = LeftOut("links", "are links to folders", ("again",))
    >>> sentences([links.record()], "the input folder")
    ['1 below the input folder are links to folders and are left out: again']
    """
    told = []
    for item in records:
        names, n = item["names"], item["count"]
        shown = ", ".join(one_line_name(name) for name in names[:_SHOWN])
        told.append(
            f"{n} below {place} {item['why']} and are left out: {shown}"
            + (" ..." if n > _SHOWN else "")
        )
    return told
