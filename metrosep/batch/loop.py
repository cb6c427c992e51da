"""The loop that keeps workers busy, and loses no unit when one of them dies."""

from __future__ import annotations

import contextlib
import multiprocessing
import os
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
    ProcessPoolExecutor,
    ThreadPoolExecutor,
    wait,
)
from contextlib import contextmanager
from multiprocessing import connection
from typing import Any

from metrosep.batch.units import Unit
from metrosep.batch.work import Task, WorkerDiedError, do_unit, record_failure
from metrosep.core.errors import DataError
from metrosep.core.inside import inside_of, keep_inside

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


# ---- where units are worked on: processes, threads, this thread, or a Dask cluster -------------
# All are `concurrent.futures.Executor`; nothing else of metrosep knows Dask. No numpy here: a new
# worker imports this module first, and only then may libraries count their threads.

SCHEDULERS = ("processes", "threads", "serial", "dask")
_THREADS = (
    "OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS", "MKL_NUM_THREADS", "VECLIB_MAXIMUM_THREADS",
    "NUMEXPR_NUM_THREADS",
)  # fmt: skip
_CONNECT_SECONDS = 10


class ClusterError(DataError):
    """The cluster is not installed, cannot be reached or was lost."""


class _Serial(Executor):
    """Work in the thread that asks for it."""

    def submit(self, fn: Callable[..., Any], /, *args: Any, **kwargs: Any) -> Future[Any]:
        future: Future[Any] = Future()
        try:
            future.set_result(fn(*args, **kwargs))
        except Exception as exc:  # as every executor does
            future.set_exception(exc)
        return future


def parse_scheduler(scheduler: str) -> tuple[str, str | None]:
    """Return kind and address of a scheduler.

    Examples
    --------
    >>> parse_scheduler("dask=tcp://qa-server:8786")
    ('dask', 'tcp://qa-server:8786')
    """
    kind, equals, address = scheduler.partition("=")
    if kind not in SCHEDULERS or (equals and (kind != "dask" or not address)):
        raise DataError(
            f"scheduler {scheduler!r} is not known; there are {', '.join(SCHEDULERS)}, and "
            "dask=tcp://HOST:PORT for a cluster that runs already"
        )
    return kind, address or None


@contextmanager
def executor(scheduler: str, workers: int) -> Iterator[Callable[[], Executor]]:
    """Give what makes an executor; it may be called again when one broke.

    Notes
    -----
    The callable raises DataError where worker processes cannot even start.
    """
    with contextlib.ExitStack() as stack:
        kind, address = parse_scheduler(scheduler)
        client = _dask_client(address, workers, stack) if kind == "dask" else None
        made: list[Executor] = []

        def make() -> Executor:
            while made:
                _shut(made.pop(), wait=False)
            made.append(make_executor(kind, workers, client))
            if kind == "processes":
                _require_ready(made[-1])
            return made[-1]

        try:
            yield make
        finally:
            for item in made:
                _shut(item, wait=True)


def _require_ready(pool: Executor) -> None:
    """Refuse to go on where a worker process dies before it has anything to do."""
    try:
        pool.submit(os.getpid).result()
    except BrokenExecutor:
        raise DataError(
            "worker processes cannot start; in a script of your own put the call under "
            "'if __name__ == \"__main__\":', since each worker reads the script once more; "
            "or use scheduler='threads'"
        ) from None


def _shut(pool: Executor, *, wait: bool) -> None:
    if isinstance(pool, ProcessPoolExecutor | ThreadPoolExecutor):
        pool.shutdown(wait=wait, cancel_futures=True)
    else:
        pool.shutdown(wait=wait)


def make_executor(kind: str, workers: int, client: Any = None) -> Executor:
    """Return one executor."""
    if kind == "serial":
        return _Serial()
    if kind == "threads":
        return ThreadPoolExecutor(
            workers, "metrosep-batch", initializer=keep_inside, initargs=(inside_of(),)
        )
    if kind == "dask":
        return client.get_executor(pure=False, retries=0)  # type: ignore[no-any-return]
    context = multiprocessing.get_context("spawn")
    workers = min(workers, 61) if os.name == "nt" else workers  # as many as Windows waits for
    return ProcessPoolExecutor(
        workers, mp_context=context, initializer=_begin_worker, initargs=(inside_of(),)
    )


def is_broken(error: BaseException | None) -> bool:
    """Return whether an error says that the worker died, not that the work failed."""
    if error is None:
        return False
    lost = ("KilledWorker", "CommClosedError")
    return isinstance(error, BrokenExecutor) or type(error).__name__ in lost


def _begin_worker(roots: tuple[str, ...]) -> None:
    """Set a new process up: one BLAS thread, no Ctrl-C of its own, an end with its parent."""
    keep_inside(roots)
    for name in _THREADS:
        os.environ[name] = "1"
    with contextlib.suppress(ValueError):  # not the main thread
        signal.signal(signal.SIGINT, signal.SIG_IGN)
    parent = multiprocessing.parent_process()
    if parent is not None:
        threading.Thread(target=_end_with, args=(parent.sentinel,), daemon=True).start()
    import metrosep.batch.work  # noqa: F401  # so that the first unit is not the slow one


def _end_with(sentinel: Any) -> None:
    """End this process when its parent is gone, lest it waits for work for ever."""
    connection.wait([sentinel])
    os._exit(1)


def _dask_client(address: str | None, workers: int, stack: contextlib.ExitStack) -> Any:
    try:
        import distributed
    except ImportError:
        raise ClusterError(
            "scheduler dask: the packages dask and distributed are not installed; install "
            "metrosep[cluster], or use --scheduler processes"
        ) from None
    cluster_of: Any = distributed.LocalCluster
    client_of: Any = distributed.Client
    if address is None:
        cluster = stack.enter_context(
            cluster_of(
                n_workers=workers, threads_per_worker=1, processes=True, dashboard_address=None
            )
        )
        return stack.enter_context(client_of(cluster))
    try:
        client = stack.enter_context(client_of(address, timeout=_CONNECT_SECONDS))
    except (OSError, ValueError, TimeoutError) as exc:
        raise ClusterError(
            f"scheduler dask: no cluster answers at {address} within {_CONNECT_SECONDS} s "
            f"({type(exc).__name__}); check that dask scheduler runs there and that the address is "
            "written tcp://HOST:PORT"
        ) from None
    if not client.scheduler_info().get("workers"):
        raise ClusterError(
            f"scheduler dask: the cluster at {address} has no workers; start some with "
            f"'dask worker {address}' on machines that see the same folders"
        )
    return client
