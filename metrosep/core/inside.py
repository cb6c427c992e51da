"""Reads that stay inside some folders: a link that leads out of them is refused at every opening.

A path is checked when it is named; what lies there may be another file a minute later. So each opening
is checked again, by an audit hook that hears all that Python opens or lists, whoever asks for it. A path
within the folders whose links lead out of them is refused; other paths (libraries, fonts, what a caller
named outside) are not looked at.
"""

from __future__ import annotations

import contextlib
import os
import sys
import threading
from collections.abc import Iterator, Sequence
from contextvars import ContextVar
from pathlib import Path

from metrosep.core.errors import ReadError

__all__ = ["inside_of", "keep_inside", "opening", "reading_inside"]

_EVENTS = frozenset({"open", "os.listdir", "os.scandir"})
_ROOTS: ContextVar[tuple[str, ...]] = ContextVar("roots", default=())
_OWN = tuple({os.path.realpath(p) for p in (sys.prefix, sys.base_prefix)} | {sys.prefix})
"""Where Python and its packages lie: a package may be links to a store of its installer."""

_installing = threading.Lock()
_is_installed = False


@contextlib.contextmanager
def reading_inside(roots: Sequence[str | Path]) -> Iterator[None]:
    """Refuse in this thread to read through links out of folders, which are whole paths without links."""
    keep_inside(roots)
    token = _ROOTS.set(tuple(os.fspath(root) for root in roots))
    try:
        yield
    finally:
        _ROOTS.reset(token)


def keep_inside(roots: Sequence[str | Path]) -> None:
    """Do so for good: for the thread or process that works on behalf of another."""
    global _is_installed  # noqa: PLW0603  # a hook cannot be removed: it is added once
    with _installing:
        if not _is_installed and roots:
            sys.addaudithook(_heard)
            _is_installed = True
    _ROOTS.set(tuple(os.fspath(root) for root in roots))


def inside_of() -> tuple[str, ...]:
    """Return the folders that hold for this thread, for those that work on its behalf."""
    return _ROOTS.get()


def opening(path: str | os.PathLike[str]) -> None:
    """Say that a file is opened by somebody whom Python does not hear: another process."""
    sys.audit("open", os.fspath(path), "rb", 0)


def _heard(event: str, args: tuple[object, ...]) -> None:
    if event not in _EVENTS or not (roots := _ROOTS.get()) or not args:
        return
    path = args[0]
    if not isinstance(path, str | bytes | os.PathLike):
        return  # a number: what was opened before
    named = os.path.abspath(os.fsdecode(path))  # noqa: PTH100  # `..` goes first, as in a shell
    if not _is_below(named, roots) or _is_below(named, _OWN):
        return
    real = os.path.realpath(named)
    name = Path(named).name
    if not _is_below(real, roots):
        raise ReadError(
            f"{name}: leads out of the folders that were opened, by a link; add the folder that it "
            "leads to with --folder, or put a copy in its place"
        )


def _is_below(path: str, roots: Sequence[str]) -> bool:
    return any(path == r or path.startswith(r.rstrip(os.sep) + os.sep) for r in roots)
