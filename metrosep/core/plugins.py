"""What other packages add: their entry points, looked up once for each state of the path."""

from __future__ import annotations

import functools
import sys
from collections.abc import Callable
from importlib import metadata
from typing import Any


def entries(group: str) -> dict[str, Any]:
    """Return the entry points of a group by name."""
    return dict(_entries(metadata.entry_points, group, tuple(sys.path)))


@functools.lru_cache(maxsize=16)
def _entries(
    look: Callable[..., Any], group: str, _path: tuple[str, ...]
) -> tuple[tuple[str, Any], ...]:
    """Return names and entry points; looking them up costs 10 ms, as much as a small file."""
    return tuple(sorted(((e.name, e) for e in look(group=group)), key=lambda pair: pair[0]))
