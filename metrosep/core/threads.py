"""Blocks shared among threads: NumPy works without the lock of the interpreter.

BLAS itself stays at one thread (`metrosep.core.blas`): two threads that each work on blocks of
their own do not wait for one another, as the threads inside a small product do.
"""

from __future__ import annotations

import contextvars
import os
import threading
from collections.abc import Callable, Iterator, Sequence
from typing import TypeVar

__all__ = ["in_threads", "thread_count"]

Item = TypeVar("Item")

_MOST = 4
"""Memory is the limit long before the cores are."""


def thread_count() -> int:
    """Return how many threads share the blocks of one task.

    Returns
    -------
    int
        The cores that this process may use, at most 4; or what the environment variable
        METROSEP_THREADS says: a pool of processes sets it to 1.

    Examples
    --------
    >>> 1 <= thread_count() <= 4
    True
    """
    asked = os.environ.get("METROSEP_THREADS", "")
    if asked.isdecimal() and len(asked) < 4 and int(asked) > 0:
        return min(int(asked), _MOST)
    try:
        cores = len(os.sched_getaffinity(0))
    except AttributeError:  # not on Linux
        cores = os.cpu_count() or 1
    return min(cores, _MOST)


def in_threads(
    work: Callable[[Iterator[Item]], None], items: Sequence[Item], *, threads: int | None = None
) -> None:
    """Let several threads work through items, each taking the next one that is left.

    Parameters
    ----------
    work : callable
        Takes an iterator over items, and carries each of them out; called once in each thread, so
        that what it makes before the loop (scratch arrays, ``np.errstate``) is the thread's own.
        What it finds it must store under the item, so that the order does not matter.
    items : sequence
        All items.
    threads : int, optional
        Threads, this one among them; `thread_count` if omitted.

    Raises
    ------
    Exception
        What `work` raises, of the first thread that raised; the other threads stop at their next
        item.

    Examples
    --------
    >>> squares = [0] * 5
    >>> def work(numbers):
    ...     for n in numbers:
    ...         squares[n] = n * n
    >>> in_threads(work, range(5), threads=2)
    >>> squares
    [0, 1, 4, 9, 16]
    """
    n = min(thread_count() if threads is None else threads, len(items))
    if n < 2:
        work(iter(items))
        return
    left = iter(range(len(items)))  # an iterator of C hands out each number once
    failures: list[BaseException] = []

    def until_failure() -> Iterator[Item]:
        for number in left:
            if failures:
                return
            yield items[number]

    def guarded() -> None:
        try:
            work(until_failure())
        except BaseException as exc:  # raised again in the calling thread
            failures.append(exc)

    # each helper in a copy of the caller's context: np.errstate holds there too
    helpers = [
        threading.Thread(target=contextvars.copy_context().run, args=(guarded,), daemon=True)
        for _ in range(n - 1)
    ]
    for helper in helpers:
        helper.start()
    guarded()
    for helper in helpers:
        helper.join()
    if failures:
        raise failures[0]
