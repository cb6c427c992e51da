"""The loop that keeps workers busy, and loses no unit when one of them dies."""

from __future__ import annotations

import contextlib
import signal
import threading
from collections import deque
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import (
    FIRST_COMPLETED,
    BrokenExecutor,
    CancelledError,
    Executor,
    Future,
    wait,
)
from typing import Any

from metrosep.batch.executors import ClusterError, is_broken
from metrosep.batch.failures import WorkerDiedError
from metrosep.batch.units import Unit
from metrosep.batch.work import Task, do_unit, record_failure

__all__ = ["Stop", "WorkerDiedError", "work_through"]

_LOOK_SECONDS = 0.2


class Stop:
    """Whether the batch shall end early, and why."""

    def __init__(self, cancel: Callable[[], bool] | None = None) -> None:
        self._cancel = cancel
        self.reason: str | None = None
        self.interrupted = False

    def __bool__(self) -> bool:
        """Whether nothing new is to be begun."""
        if self.reason is None and self._cancel is not None and self._cancel():
            self.interrupted = True
            self.reason = "cancelled; what is done is kept, resume goes on from here"
        return self.reason is not None

    def because(self, reason: str) -> None:
        """Stop; the first reason counts."""
        self.reason = self.reason or reason

    @contextlib.contextmanager
    def at_signals(self) -> Iterator[None]:
        """Let Ctrl-C and SIGTERM stop the batch cleanly; a second one skips the index."""

        def heard(number: int, _frame: Any) -> None:
            if self.interrupted:
                raise KeyboardInterrupt
            self.interrupted = True
            self.because("interrupted; what is done is kept, resume goes on from here")

        if threading.current_thread() is not threading.main_thread():
            yield
            return
        before = {
            n: signal.getsignal(n)
            for n in (signal.SIGINT, signal.SIGTERM)
            if signal.getsignal(n) is not signal.SIG_IGN
        }
        try:
            for number in before:
                signal.signal(number, heard)
            yield
        finally:
            for number, handler in before.items():
                signal.signal(number, handler if handler is not None else signal.SIG_DFL)


def work_through(
    task: Task, units: Iterable[Unit], make: Callable[[], Executor], *, width: int, stop: Stop
) -> Iterator[dict[str, Any]]:
    """Yield the row of each unit as it is finished.

    Notes
    -----
    When a worker dies, every unit that was handed out is a suspect: each is tried once more, alone.
    Who kills a worker alone is a failed unit; the others lost nothing.
    """
    loop = _Loop(task, make, width)
    waiting = iter(units)
    while True:
        if not stop:
            loop.fill(waiting)
        if not loop.running:
            if stop or not loop.suspects:
                return
            continue
        yield from loop.finished()


class _Loop:
    """Units that are handed out, and those that a dying worker left."""

    def __init__(self, task: Task, make: Callable[[], Executor], width: int) -> None:
        self.task, self.make, self.width = task, make, width
        self.pool = make()
        self.running: dict[Future[dict[str, Any]], Unit] = {}
        self.suspects: deque[Unit] = deque()
        self.alone: Unit | None = None

    def fill(self, waiting: Iterator[Unit]) -> None:
        """Hand units out: as many as fit, or one suspect alone."""
        if self.alone is not None:
            return
        if self.suspects:
            if not self.running:
                self.alone = self.suspects.popleft()
                self._hand_out(self.alone)
            return
        while len(self.running) < self.width:
            unit = next(waiting, None)
            if unit is None or not self._hand_out(unit):
                return

    def _hand_out(self, unit: Unit) -> bool:
        try:
            self.running[self.pool.submit(do_unit, self.task, unit)] = unit
        except BrokenExecutor:
            if not self.running:
                self.pool = self.make()
            self.suspects.append(unit)
            self.alone = None
            return False
        return True

    def finished(self) -> Iterator[dict[str, Any]]:
        """Yield the rows of what is finished by now."""
        done, _ = wait(self.running, timeout=_LOOK_SECONDS, return_when=FIRST_COMPLETED)
        if any(isinstance(_error(f), BrokenExecutor) for f in done):
            done, _ = wait(self.running)  # the pool is lost: all of them end now
        broken = False
        for future in done:
            unit, error = self.running.pop(future), _error(future)
            if not is_broken(error):
                row = future.result() if error is None else self._failed(unit, error)
            else:
                broken = broken or isinstance(error, BrokenExecutor)
                if unit is not self.alone:
                    self.suspects.append(unit)
                    continue
                row = self._failed(
                    unit,
                    WorkerDiedError(
                        f"{unit.name}: the worker died twice on it (killed, or out of "
                        "memory); resume with fewer workers (--workers 1)"
                    ),
                )
            if unit is self.alone:
                self.alone = None
            yield row
        if broken:
            self.pool = self.make()

    def _failed(self, unit: Unit, error: BaseException) -> dict[str, Any]:
        row = record_failure(self.task, unit, error)
        return {**row, "seconds": 0.0, "skipped": False}


def _error(future: Future[Any]) -> BaseException | None:
    try:
        return None if not future.done() else future.exception()
    except CancelledError:  # nobody here cancels what is begun
        raise ClusterError(
            "the cluster was lost in mid-run; what is done is kept: start the same batch again when "
            "the cluster is back, or with --scheduler processes"
        ) from None
