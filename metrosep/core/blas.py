"""One BLAS thread around blocked code: two that spin cost more than they give on small products."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from functools import cache
from typing import Any

__all__ = ["one_blas_thread"]


@cache
def _controller() -> Any:
    from threadpoolctl import ThreadpoolController

    return ThreadpoolController()


@contextmanager
def one_blas_thread() -> Iterator[None]:
    """Limit BLAS to one thread for the length of a ``with`` block.

    Yields
    ------
    None
        The former limit returns at the end.

    Notes
    -----
    The libraries are looked up once per process (some milliseconds), so this costs microseconds.

    Examples
    --------
    >>> with one_blas_thread():
    ...     pass
    """
    with _controller().limit(limits=1, user_api="blas"):
        yield
