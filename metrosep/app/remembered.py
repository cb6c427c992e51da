"""What was made of the latest objects, so that it is not made again for the next picture."""

from __future__ import annotations

import json
import threading
from collections.abc import Callable, Mapping
from typing import Any, Generic, TypeVar

__all__ = ["Remembered", "text_key"]

Made = TypeVar("Made")


class Remembered(Generic[Made]):
    """A function of objects that keeps its latest results."""

    def __init__(self, make: Callable[..., Made], most: int = 9) -> None:
        self._make, self._most = make, most
        self._kept: dict[int, tuple[Any, Made]] = {}
        self._lock = threading.Lock()

    def of(self, obj: Any, *rest: Any) -> Made:
        """Return what is made of an object, made once.

        Examples
        --------
        >>> calls = []
        >>> lengths = Remembered(lambda text: calls.append(text) or len(text))
        >>> word = "step"
        >>> lengths.of(word), lengths.of(word), calls
        (4, 4, ['step'])
        """
        with self._lock:
            if id(obj) not in self._kept:
                if len(self._kept) >= self._most:
                    self._kept.clear()
                self._kept[id(obj)] = (obj, self._make(obj, *rest))
            return self._kept[id(obj)][1]

    def clear(self) -> None:
        """Forget everything."""
        with self._lock:
            self._kept.clear()


def text_key(value: Any) -> str:
    """Return what tells values of a recipe apart, as text.

    Examples
    --------
    >>> text_key({"op": "crop", "x": (0.0, 1.0)}) == text_key({"x": [0.0, 1.0], "op": "crop"})
    True
    """
    return json.dumps(_plain(value), sort_keys=True, default=str)


def _plain(value: Any) -> Any:
    if isinstance(value, Mapping):
        return {str(k): _plain(v) for k, v in value.items()}
    return [_plain(v) for v in value] if isinstance(value, list | tuple) else value
