"""The session on disk: written beside the work, so that a slow disk stops nobody."""

from __future__ import annotations

import itertools
import threading
import time
from collections.abc import Callable
from pathlib import Path

from metrosep.core.atomic import atomic_write
from metrosep.core.errors import WriteError

__all__ = ["Keeper"]

_PATIENCE = 0.25
"""Seconds that an edit waits for the disk: most are kept before the page hears of them."""

_AGAIN = 5.0
"""Seconds after which what could not be kept is tried again."""

Write = Callable[[Path, bytes], object]


class Keeper:
    """Writes the latest text of a session in a thread of its own.

    Notes
    -----
    A file that another program wrote since it was read or written here is left alone: the text goes
    beside it (``.other-1``), and `notice` says so.
    """

    def __init__(
        self,
        write: Write = atomic_write,
        told: Callable[[], None] | None = None,
        again: float = _AGAIN,
    ) -> None:
        self.write, self.told, self.again = write, told, again
        self.saved_at: float | None = None
        self.problem = ""
        self.notice = ""
        self._changed = threading.Condition()
        self._wanted: dict[Path, tuple[str, bool]] = {}
        self._failed: dict[Path, tuple[str, bool, str]] = {}
        self._known: dict[Path, bytes | None] = {}
        self._beside: dict[Path, Path] = {}
        self._current: Path | None = None
        self._timer: threading.Timer | None = None
        self._works = False
        self._given_up = False
        self._heard: str | None = None

    def keep(self, path: Path, text: str, *, aside: bool = False) -> None:
        """Keep a text; an older one of the same file that still waits is left out."""
        with self._changed:
            self._current = path
            self._take_failed()
            self._wanted[path] = (text, aside or self._wanted.get(path, ("", False))[1])
            self._start()
            self._given_up, self._heard = not self.wait(_PATIENCE), None

    def retry(self) -> None:
        """Begin to write again what could not be kept."""
        with self._changed:
            self._take_failed()
            if self._wanted:
                self._start()

    def has_failed(self, path: Path) -> bool:
        """Return whether the latest text of a file is not on the disk since that failed."""
        return path in self._failed

    @property
    def is_waiting(self) -> bool:
        """Whether a text is not on the disk yet."""
        return self._works

    def wait(self, seconds: float | None = None) -> bool:
        """Wait until everything is kept, or could not be."""
        with self._changed:
            return self._changed.wait_for(lambda: not self._works, seconds)

    def begin(self, path: Path, held: bytes | None) -> None:
        """Begin anew, for another file: nothing of it was kept yet."""
        with self._changed:
            self.saved_at, self.problem, self.notice, self._current = None, "", "", path
            self._known[path] = held
            self._beside.pop(path, None)

    def close(self, seconds: float) -> bool:
        """Try a last time to keep what could not be."""
        self.retry()
        done = self.wait(seconds)
        with self._changed:
            if self._timer is not None:
                self._timer.cancel()
            self._timer = None
            return done and not self._failed

    def _take_failed(self) -> None:
        """Want again what failed, unless a newer text of the same file is wanted."""
        for path, (text, aside, _) in self._failed.items():
            newer, too = self._wanted.get(path, (text, False))
            self._wanted[path] = (newer, aside or too)
        self._failed.clear()

    def _start(self) -> None:
        if not self._works:
            self._works = True
            threading.Thread(target=self._work, daemon=True, name="keeper").start()

    def _try_again(self) -> None:
        """Try again after a while; who shows the problem hears if it is solved."""
        with self._changed:
            self._timer = None
            if self._failed:
                self._given_up, self._heard = True, self.problem
                self.retry()

    def _work(self) -> None:
        while (job := self._next()) is not None:
            path, text, aside = job
            problem, aside = self._written(path, text, aside=aside)
            with self._changed:
                if problem:
                    self._failed[path] = (text, aside, problem)
                else:
                    self._failed.pop(path, None)
                    if path == self._current:
                        self.saved_at = time.time()
                self.problem = next((words for *_, words in self._failed.values()), "")

    def _next(self) -> tuple[Path, str, bool] | None:
        """Return what is to be written next; at the end tell who stopped waiting."""
        with self._changed:
            if self._wanted:
                path = next(iter(self._wanted))
                return path, *self._wanted.pop(path)
            late = self._given_up and self._heard != self.problem
            self._given_up, self._works, self._heard = False, False, None
            if self._failed and self._timer is None:
                self._timer = threading.Timer(self.again, self._try_again)
                self._timer.daemon = True
                self._timer.start()
            self._changed.notify_all()
        if late and self.told is not None:
            self.told()
        return None

    def _written(self, path: Path, text: str, *, aside: bool) -> tuple[str, bool]:
        """Write a text; return why it could not be, and whether a file is still to be put aside."""
        content = text.encode("utf-8")
        try:
            if aside and path.exists():
                path.replace(_free(path, ".old", ".old."))
                self._known[path] = None
            aside = False
            target = self._own(path)
            target.parent.mkdir(parents=True, exist_ok=True)
            self.write(target, content)
            self._known[target] = content
        except (WriteError, OSError) as exc:
            return f"the session is not kept: {exc}", aside
        return "", False

    def _own(self, path: Path) -> Path:
        """Return where a text may be written: beside what another program wrote."""
        if path in self._beside:
            return self._beside[path]
        if path not in self._known or not path.exists() or path.read_bytes() == self._known[path]:
            return path
        other = _free(path, ".other-1", ".other-")
        self._beside[path] = other
        self.notice = (
            f"{path.name}: another metrosep works on this file and keeps its session there; this one is "
            f"kept in {other.name}"
        )
        return other


def _free(path: Path, first: str, further: str) -> Path:
    """Return a name beside a file that is not taken yet."""
    found = path.with_name(f"{path.name}{first}")
    start = 2 if first.startswith(further) else 1
    for number in itertools.count(start):
        if not found.exists():
            break
        found = path.with_name(f"{path.name}{further}{number}")
    return found
