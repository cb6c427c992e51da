"""What requests and answers of the workbench are made of."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any, TypeAlias, cast

import numpy as np
from numpy.typing import NDArray

from metrosep.app.evaluations import Level
from metrosep.core.errors import DataError

__all__ = [
    "Answer",
    "Arrays",
    "Cancel",
    "Message",
    "Tell",
    "level_of",
    "number_or_none",
    "plain",
    "text_of",
]

Arrays: TypeAlias = dict[str, NDArray[Any]]
Answer: TypeAlias = tuple[dict[str, Any], Arrays]
Message: TypeAlias = Mapping[str, Any]
Cancel: TypeAlias = Callable[[], bool]
Tell: TypeAlias = Callable[[Mapping[str, Any]], None]
"""Sends news to the page: what is being done, before the answer."""


def level_of(message: Message) -> Level:
    """Return the size of the data that a request wants."""
    level = message.get("level", "idle")
    if level not in ("drag", "idle", "full"):
        raise DataError(f"level is drag, idle or full, got {level!r}")
    return cast(Level, level)


def text_of(message: Message, name: str) -> str:
    """Return a text of a request."""
    value = message.get(name)
    if not isinstance(value, str) or not value:
        raise DataError(f"{name} is a text, got {value!r}")
    return value


def number_or_none(value: float | None) -> float | None:
    """Return a number as JSON knows it."""
    return None if value is None or not np.isfinite(value) else float(value)


def plain(value: Any) -> Any:
    """Return nested values as JSON knows them."""
    if isinstance(value, Mapping):
        return {str(k): plain(v) for k, v in value.items()}
    if isinstance(value, list | tuple):
        return [plain(v) for v in value]
    if isinstance(value, np.generic):
        value = value.item()
    if isinstance(value, float) and not np.isfinite(value):
        return None
    return str(value) if isinstance(value, Path) else value
