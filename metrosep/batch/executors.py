"""Where units are worked on: processes, threads, this thread, or a Dask cluster.

All are `concurrent.futures.Executor`; nothing else of metrosep knows Dask. No numpy here: a new
worker imports this module first, and only then may libraries count their threads.
"""

from __future__ import annotations

import contextlib
import multiprocessing
import os
import signal
import threading
from collections.abc import Callable, Iterator
from concurrent.futures import (
    BrokenExecutor,
    Executor,
    Future,
    ProcessPoolExecutor,
    ThreadPoolExecutor,
)
from contextlib import contextmanager
from multiprocessing import connection
from typing import Any

from metrosep.core.errors import DataError

__all__ = [
    "SCHEDULERS",
    "ClusterError",
    "executor",
    "is_broken",
    "make_executor",
    "parse_scheduler",
]

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
        return ThreadPoolExecutor(workers, thread_name_prefix="metrosep-batch")
    if kind == "dask":
        return client.get_executor(pure=False, retries=0)  # type: ignore[no-any-return]
    context = multiprocessing.get_context("spawn")
    workers = min(workers, 61) if os.name == "nt" else workers  # as many as Windows waits for
    return ProcessPoolExecutor(workers, mp_context=context, initializer=_begin_worker)


def is_broken(error: BaseException | None) -> bool:
    """Return whether an error says that the worker died, not that the work failed."""
    if error is None:
        return False
    lost = ("KilledWorker", "CommClosedError")
    return isinstance(error, BrokenExecutor) or type(error).__name__ in lost


def _begin_worker() -> None:
    """Set a new process up: one BLAS thread, no Ctrl-C of its own, an end with its parent."""
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
