"""The order of names as people count: ``run2`` stands before ``run10``."""

from __future__ import annotations

import re

__all__ = ["by_number"]


def by_number(name: str) -> list[tuple[int, int, str]]:
    """Return a key that sorts names with the numbers in them by their value.

    Examples
    --------
    >>> sorted(["run10", "run2", "run", "b1"], key=by_number)
    ['b1', 'run', 'run2', 'run10']
    """
    pieces = re.split(r"(\d+)", name)
    return [(1, int(p), "") if p.isdecimal() else (0, 0, p) for p in pieces]
