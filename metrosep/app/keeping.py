"""The session on disk: written beside the work, so that a slow disk stops nobody."""

from __future__ import annotations

import contextlib
import threading
import time
from collections.abc import Callable
from pathlib import Path

from metrosep.core.atomic import atomic_write
from metrosep.core.errors import WriteError

__all__ = ["Keeper"]

_PATIENCE = 0.25
"""Seconds that an edit waits for the disk: most are kept before the page hears of them."""

Write = Callable[[Path, bytes], object]


class Keeper:
    """Writes the latest text of a session in a thread of its own.

    Parameters
    ----------
    write : callable, optional
        ``write(path, content)``, whole or not at all; raises `WriteError`.
    told : callable, optional
        Called from that thread when a text was kept late, or could not be kept.
    """

    def __init__(
        self, write: Write = atomic_write, told: Callable[[], None] | None = None
    ) -> None:
        self.write, self.told = write, told
        self.saved_at: float | None = None
        self.problem = ""
        self._changed = threading.Condition()
        self._wanted: dict[Path, tuple[str, bool]] = {}
        self._works = False
        self._given_up = False

    def keep(self, path: Path, text: str, *, aside: bool = False) -> None:
        """Keep a text; an older one of the same file that still waits is left out.

        Parameters
        ----------
        path : Path
            File.
        text : str
            Its content.
        aside : bool, optional
            Whether a file that is there is put aside first (``.old``).
        """
        with self._changed:
            self._wanted[path] = (text, aside or self._wanted.get(path, ("", False))[1])
            if not self._works:
                self._works = True
                threading.Thread(target=self._work, daemon=True, name="keeper").start()
            self._given_up = not self.wait(_PATIENCE)

    @property
    def is_waiting(self) -> bool:
        """Whether a text is not on the disk yet."""
        return self._works

    def wait(self, seconds: float | None = None) -> bool:
        """Wait until everything is kept, or could not be.

        Parameters
        ----------
        seconds : float, optional
            At most; without end if omitted.

        Returns
        -------
        bool
            Whether nothing waits any more.
        """
        with self._changed:
            return self._changed.wait_for(lambda: not self._works, seconds)

    def forget(self) -> None:
        """Begin anew, for another file: nothing of it was kept yet."""
        with self._changed:
            self.saved_at, self.problem = None, ""

    def _work(self) -> None:
        while (job := self._next()) is not None:
            path, text, aside = job
            problem = self._written(path, text, aside=aside)
            with self._changed:
                self.problem = problem
                if not problem:
                    self.saved_at = time.time()

    def _next(self) -> tuple[Path, str, bool] | None:
        """Return what is to be written next; at the end tell who stopped waiting."""
        with self._changed:
            if self._wanted:
                path = next(iter(self._wanted))
                return path, *self._wanted.pop(path)
            late, self._given_up, self._works = self._given_up, False, False
            self._changed.notify_all()
        if late and self.told is not None:
            self.told()
        return None

    def _written(self, path: Path, text: str, *, aside: bool) -> str:
        """Write a text; return why it could not be written."""
        try:
            if aside:
                with contextlib.suppress(FileNotFoundError):
                    path.replace(path.with_name(f"{path.name}.old"))
            self.write(path, text.encode("utf-8"))
        except (WriteError, OSError) as exc:
            return f"the session is not kept: {exc}"
        return ""
