"""Reads that stay inside some folders: a link that leads out of them is refused at every opening.

A path is checked when it is named; what lies there may be another file a minute later. So each opening
is checked again, by an audit hook that hears what Python opens or lists, whoever asks for it. A path that
lies in the folders, or passes a link in them, and ends outside is refused; other paths (libraries, fonts,
what a caller named outside) are not looked at.

What it does not see: a link that is laid in the instant between this check and the opening by the system;
a file that a library opens without Python (`opening` says it for HDF5, again in the process that opens);
a hard link, which is no way out but the file itself; a thread that was not started with `carried`; a name
beside an open folder (``dir_fd``) on a system without ``/proc/self/fd``.
"""

from __future__ import annotations

import contextlib
import os
import sys
import threading
from collections.abc import Callable, Iterator, Sequence
from contextvars import ContextVar
from pathlib import Path

from metrosep.core.errors import ReadError

_EVENTS = frozenset({"open", "os.listdir", "os.scandir"})
_ROOTS: ContextVar[tuple[str, ...]] = ContextVar("roots", default=())
_OWN = tuple({os.path.realpath(p) for p in (sys.prefix, sys.base_prefix)} | {sys.prefix})
"""Where Python and its packages lie: a package may be links to a store of its installer."""

_HELD = "/proc/self/fd"
_MOST_LINKS = 40
"""Links of a path beyond which Linux refuses it."""

_installing = threading.Lock()
_is_installed = False


@contextlib.contextmanager
def reading_inside(roots: Sequence[str | Path]) -> Iterator[None]:
    """Refuse here to read through links out of folders, whole paths without links; outer ones hold too."""
    _listen()
    token = _ROOTS.set((*_ROOTS.get(), *(os.fspath(root) for root in roots)))
    try:
        yield
    finally:
        _ROOTS.reset(token)


def keep_inside(roots: Sequence[str | Path]) -> None:
    """Do so for good: for the thread or process that works on behalf of another."""
    if roots:
        _listen()
    _ROOTS.set(tuple(os.fspath(root) for root in roots))


def carried(function: Callable[..., None]) -> Callable[..., None]:
    """Return a function for a thread of its own, which stays inside the folders that hold here."""
    roots = _ROOTS.get()

    def within(*args: object) -> None:
        keep_inside(roots)
        function(*args)

    return within


def _listen() -> None:
    """Add the hook, once: it cannot be removed."""
    global _is_installed  # noqa: PLW0603
    with _installing:
        if not _is_installed:
            sys.addaudithook(_heard)
            _is_installed = True


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
    named = os.fsdecode(path)
    _require_inside(named, roots)
    if event == "open" and args[1] is None and not os.path.isabs(named):  # noqa: PTH117
        for folder in _open_folders():  # `os.open` does not say beside which it is
            _require_inside(f"{folder}/{named}", roots)


def _open_folders() -> list[str]:
    """Return what this process has open, where the system lists it."""
    try:
        return [f"{_HELD}/{number}" for number in os.listdir(_HELD)]  # noqa: PTH208
    except OSError:
        return []


def _require_inside(named: str, roots: Sequence[str]) -> None:
    """Refuse a path that lies in the folders, or passes a link in them, and ends outside."""
    whole = os.path.abspath(named)  # noqa: PTH100  # `..` goes first, as in a shell
    if _is_below(whole, _OWN):
        return
    links, real = _way(named)
    if _is_below(real, roots):
        return
    if any(_is_below(p, roots) and not _is_below(p, _OWN) for p in (whole, *links)):
        raise ReadError(
            f"{Path(whole).name}: leads out of the folders that were opened, by a link; put a copy in its "
            "place, or open the folder that it leads to as well (in the workbench with --folder)"
        )


def _way(named: str) -> tuple[list[str], str]:
    """Return the links that a path passes as the system walks it, and where it ends."""
    if os.name == "nt":
        return [], os.path.realpath(named)
    links: list[str] = []
    at = "/" if named.startswith("/") else os.getcwd()  # noqa: PTH109
    rest = named.split("/")[::-1]
    while rest:
        part = rest.pop()
        if part == "..":
            at = os.path.dirname(at)  # noqa: PTH120
        elif part not in ("", "."):
            place = os.path.join(at, part)  # noqa: PTH118
            try:
                target = os.readlink(place)  # noqa: PTH115
            except (OSError, ValueError):  # not a link
                at = place
                continue
            links.append(place)
            if len(links) > _MOST_LINKS:
                break  # a ring: the system does not open it
            at = "/" if target.startswith("/") else at
            rest += target.split("/")[::-1]
    return links, at


def _is_below(path: str, roots: Sequence[str]) -> bool:
    return any(path == r or path.startswith(r.rstrip(os.sep) + os.sep) for r in roots)
