"""How much memory there is, and how much the inputs of a unit will want."""

from __future__ import annotations

import os
import zipfile
from collections.abc import Sequence
from pathlib import Path

__all__ = ["FACTOR", "available_bytes", "wanted_bytes"]

FACTOR = 6
"""Bytes of memory for each byte of input: the map, its mask, a copy in work, spectra of it."""


def available_bytes() -> int | None:
    """Return the memory that may still be taken."""
    found = [n for n in (_of_system(), _of_group()) if n is not None]
    return min(found) if found else None


def wanted_bytes(files: Sequence[str]) -> int:
    """Return how much memory the files of a unit are expected to want."""
    return FACTOR * sum(max(os.stat(f).st_size, _unpacked(f)) for f in files)  # noqa: PTH116


def _unpacked(file: str) -> int:
    if not file.lower().endswith((".x3p", ".zip", ".al3d", ".plux", ".sur.gz", ".npz")):
        return 0
    try:
        with zipfile.ZipFile(file) as archive:
            return sum(entry.file_size for entry in archive.infolist())
    except (OSError, ValueError, NotImplementedError, zipfile.BadZipFile):
        return 0  # the reader will say what is wrong with it


def _of_system() -> int | None:
    try:
        for line in Path("/proc/meminfo").read_text(encoding="ascii").splitlines():
            if line.startswith("MemAvailable:"):
                return int(line.split()[1]) * 1024
    except (OSError, ValueError, IndexError):
        pass
    try:
        return os.sysconf("SC_AVPHYS_PAGES") * os.sysconf("SC_PAGE_SIZE")
    except (AttributeError, OSError, ValueError):
        return _of_windows()


def _of_windows() -> int | None:
    if os.name != "nt":
        return None
    import ctypes

    class Status(ctypes.Structure):
        _fields_ = (
            ("length", ctypes.c_ulong),
            ("load", ctypes.c_ulong),
            *((f"n{i}", ctypes.c_ulonglong) for i in range(7)),
        )

    status = Status()
    status.length = ctypes.sizeof(status)
    kernel = getattr(ctypes, "windll").kernel32  # noqa: B009  # not there on other systems
    return int(status.n1) if kernel.GlobalMemoryStatusEx(ctypes.byref(status)) else None


def _of_group() -> int | None:
    group = Path("/sys/fs/cgroup")
    try:
        most = (group / "memory.max").read_text(encoding="ascii").strip()
        used = (group / "memory.current").read_text(encoding="ascii").strip()
        return None if most == "max" else max(0, int(most) - int(used))
    except (OSError, ValueError):
        return None
