"""One BLAS thread around blocked code: two that spin cost more than they give on small products."""

from __future__ import annotations

import os
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from contextvars import ContextVar
from functools import cache
from typing import Any

_ALONE: ContextVar[bool] = ContextVar("metrosep_one_thread", default=False)


@cache
def _controller() -> Any:
    from threadpoolctl import ThreadpoolController

    return ThreadpoolController()


class _Limit:
    """The limit of this process: set by the first block that wants it, lifted by the last."""

    def __init__(self) -> None:
        self.lock = threading.Lock()
        self.users = 0
        self.limiter: Any = None

    def take(self) -> None:
        with self.lock:
            if self.users == 0:
                self.limiter = _controller().limit(limits=1, user_api="blas")
            self.users += 1

    def leave(self) -> None:
        with self.lock:
            self.users -= 1
            if self.users == 0:
                self.limiter.restore_original_limits()
                self.limiter = None


_LIMIT = _Limit()


@contextmanager
def one_blas_thread() -> Iterator[None]:
    """Limit BLAS to one thread for the length of a ``with`` block.

    The libraries are looked up once per process (some milliseconds), so this costs microseconds.

    Examples
    --------
    >>> with one_blas_thread():
    ...     pass
    """
    _LIMIT.take()
    try:
        yield
    finally:
        _LIMIT.leave()


@contextmanager
def one_thread() -> Iterator[None]:
    """Keep all work of a ``with`` block in the thread that does it, BLAS and our own pools.

    For workers of a batch: the processors are shared out among them already.

    Examples
    --------
    >>> with one_thread():
    ...     threads(4)
    1
    """
    token = _ALONE.set(True)
    try:
        with one_blas_thread():
            yield
    finally:
        _ALONE.reset(token)


def threads(most: int) -> int:
    """Return how many threads a function may open."""
    return 1 if _ALONE.get() else max(1, min(most, os.cpu_count() or 1))
