"""HDF5 files opened with care: the library runs in a process of its own, and no claim is believed.

`open_hdf5` gives a `Hdf5File` whose tree (groups, datasets, attributes) is plain Python. The values
of a contiguous dataset are read straight from the file; packed ones come from the worker process.
Links out of the file and soft links are not followed.
"""

from __future__ import annotations

import atexit
import json
import os
import subprocess
import sys
import threading
from collections.abc import Iterator, Mapping
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import IO, Any
from weakref import WeakKeyDictionary

import numpy as np
from numpy.typing import NDArray

from metrosep.core.errors import (
    CorruptFileError,
    FormatMismatchError,
    ReadError,
    UnsupportedFeatureError,
)
from metrosep.io.objects import check_area
from metrosep.io.source import HDF5_MAGIC, MAX_PIXELS, RawFile, has_hdf5_magic

_MAX_RATIO = 250
"""Largest ratio of claimed to stored bytes; noise of an instrument never compresses so far."""

_PATIENCE = 0.8
"""Seconds of computing for the tree; more only for what a file of that size takes to read."""

_PER_SECOND = 1.0 if sys.platform == "win32" else 10.0
"""Seconds of waiting for one of computing, which the process itself limits (not on Windows)."""

_LONGEST_PATIENCE = 60.0
"""Seconds for the process to start on a busy computer, and for the tree of a large file."""

_SLOWEST_TREE = 2e6
"""Bytes per second of a file that is all tree and no numbers."""

_SLOWEST_DISK = 2e7
"""Bytes per second that reading is given at least."""


def look_into(file: RawFile) -> Hdf5File | None:
    """Return the tree of a file to recognise it by, ``None`` where it is not an HDF5 or is damaged."""
    if not has_hdf5_magic(file):
        return None
    try:
        with open_hdf5(file) as handle:
            return handle
    except ReadError:
        return None


class _Worker:
    """The process that runs the HDF5 library; started when needed, replaced when it died."""

    def __init__(self) -> None:
        self._process: subprocess.Popen[bytes] | None = None
        self._owner = 0
        self._lock = threading.Lock()
        self.generation = 0
        """Grows with every process: what an earlier one had open is lost."""
        atexit.register(self.stop)

    def _start(self) -> None:
        if self._process is not None and self._process.poll() is not None:
            self.stop()
        if self._process is None:
            script = Path(__file__).with_name("hdf5_worker.py")
            self._process = subprocess.Popen(  # noqa: S603  (our own script)
                [sys.executable, "-P", str(script)],  # -P: never import from the working folder
                stdin=subprocess.PIPE,
                stdout=subprocess.PIPE,
                stderr=subprocess.DEVNULL,
            )
            self.generation += 1
            self._ask({"close": 0}, b"", _LONGEST_PATIENCE)  # wait until it is there

    def is_still(self, generation: int) -> bool:
        """Return whether the process that had this number is alive."""
        if self._process is None or self._owner != os.getpid():
            return False
        return generation == self.generation and self._process.poll() is None

    def stop(self) -> None:
        """End the process."""
        process, self._process = self._process, None
        if process is None:
            return
        if self._owner == os.getpid():
            process.kill()
        for stream in (process.stdin, process.stdout):
            with suppress(OSError):
                if stream is not None:
                    stream.close()
        if self._owner == os.getpid():
            process.wait()
        else:
            process.poll()

    def ask(self, request: Mapping[str, Any], content: bytes, patience: float) -> dict[str, Any]:
        """Return the answer, with its bytes under ``"content"``; ``{"died": ...}`` if it crashed."""
        if self._owner != os.getpid():  # a forked copy must not talk to its parent's worker
            self.stop()
            self._owner, self._lock = os.getpid(), threading.Lock()
        with self._lock:
            self._start()
            return self._ask(request, content, patience)

    def _ask(self, request: Mapping[str, Any], content: bytes, patience: float) -> dict[str, Any]:
        process = self._process
        if process is None or process.stdin is None or process.stdout is None:
            return {"died": True}
        late = threading.Timer(patience * _PER_SECOND, process.kill)
        late.start()
        try:
            process.stdin.write(json.dumps({**request, "seconds": patience}).encode() + b"\n")
            process.stdin.write(content)
            process.stdin.flush()
            line = process.stdout.readline()
            answer: dict[str, Any] = json.loads(line) if line.endswith(b"\n") else {"died": True}
            if answer.get("bytes"):
                answer["content"] = _exactly(process.stdout, answer["bytes"])
        except (OSError, ValueError):
            answer = {"died": True}
        finally:
            late.cancel()
        if "died" in answer:
            self.stop()
        return answer


def _exactly(stream: IO[bytes], n: int) -> bytearray:
    data = bytearray(n)
    view = memoryview(data)
    done = 0
    while done < n:
        part = stream.read(min(n - done, 2**20))
        if not part:
            raise OSError("the worker stopped")
        view[done : done + len(part)] = part
        done += len(part)
    return data


_WORKER = _Worker()

_TREES: WeakKeyDictionary[RawFile, dict[str, Any]] = WeakKeyDictionary()
"""Trees of files that were looked into: four formats ask for the tree before one reads it."""


class Hdf5File:
    """The tree of an open HDF5 file as plain Python, and its numbers on demand."""

    def __init__(self, file: RawFile) -> None:
        self._file = file
        self._generation, self._handle = -1, 0
        if file not in _TREES:
            _TREES[file] = self._open()
        tree = _TREES[file]
        self.groups: dict[str, dict[str, Any]] = tree["groups"]
        self._datasets: dict[str, dict[str, Any]] = tree["datasets"]

    def _open(self) -> dict[str, Any]:
        """Open the file in the process and return its tree; reading what is packed needs it open."""
        given = self._file.in_memory
        content = self._file.data if given else b""
        path = None if given else str(self._file.path.resolve())
        patience = min(_PATIENCE + self._file.size / _SLOWEST_TREE, _LONGEST_PATIENCE)
        if not given:
            from metrosep.core.inside import opening

            opening(self._file.path)
        answer = _WORKER.ask({"open": path, "bytes": len(content)}, content, patience)
        if "tree" not in answer:
            raise _damaged(self._file, "the file", answer)
        self._generation, self._handle = _WORKER.generation, answer["handle"]
        return dict(answer["tree"])

    def close(self) -> None:
        """Let the process forget the file."""
        if _WORKER.is_still(self._generation):
            _WORKER.ask({"close": self._handle}, b"", _PATIENCE)

    @property
    def datasets(self) -> tuple[str, ...]:
        """Paths of all datasets, in the order of the file."""
        return tuple(self._datasets)

    def __contains__(self, name: str) -> bool:
        return name in self._datasets or name in self.groups

    def attributes(self, name: str) -> dict[str, Any]:
        """Return the attributes of a group or dataset."""
        if name in self.groups:
            return self.groups[name]
        return dict(self._described(name)["attributes"])

    def shape(self, name: str) -> tuple[int, ...]:
        """Return the shape of a dataset."""
        return tuple(self._described(name)["shape"] or ())

    def is_numeric(self, name: str) -> bool:
        """Return whether a dataset holds numbers."""
        return bool(self._described(name)["dtype"])

    def rows(self, name: str) -> list[Any]:
        """Return the values of a small dataset of text or records as plain Python."""
        rows = self._described(name)["rows"]
        if rows is None:
            raise UnsupportedFeatureError(
                f"{self._file.path}: {name!r} is not a short list of texts"
            )
        return list(rows)

    def read(
        self,
        name: str,
        *,
        start: int = 0,
        stop: int | None = None,
        max_pixels: int | None = None,
    ) -> NDArray[Any]:
        """Return the numbers of a dataset, or a part along its first axis."""
        found = self._described(name)
        shape = tuple(found["shape"] or ())
        first = shape[0] if shape else 1
        stop = first if stop is None else min(stop, first)
        part = (max(stop - start, 0), *shape[1:]) if shape else ()
        self._refuse_claim(name, found, part, max_pixels)
        dtype = np.dtype(found["dtype"])
        count = int(np.prod(part, dtype=np.int64)) if part else 1
        if found["offset"] is not None:
            row = dtype.itemsize * int(np.prod(shape[1:], dtype=np.int64))
            return self._direct(name, found["offset"] + start * row, dtype, part)
        if not _WORKER.is_still(self._generation):  # not yet open, or the process died meanwhile
            self._open()
        request = {"read": name, "handle": self._handle, "start": start, "stop": stop}
        patience = _PATIENCE + count * dtype.itemsize / _SLOWEST_DISK
        answer = _WORKER.ask(request, b"", patience)
        if "content" not in answer or len(answer["content"]) != count * dtype.itemsize:
            raise _damaged(self._file, f"dataset {name!r}", answer)
        return np.frombuffer(answer["content"], dtype=dtype).reshape(part)

    def read_map(self, name: str, max_pixels: int | None) -> NDArray[Any]:
        """Return the numbers of a dataset that must be a map."""
        shape = self.shape(name)
        if len(shape) != 2:
            raise self._file.corrupt(
                "a map has two dimensions", field=name, expected="2", found=len(shape)
            )
        check_area(self._file, shape[1], shape[0], max_pixels=max_pixels)
        return self.read(name, max_pixels=max_pixels)

    def _direct(
        self, name: str, offset: int, dtype: np.dtype[Any], shape: tuple[int, ...]
    ) -> NDArray[Any]:
        """Return numbers read straight from the file into the memory that they will stay in."""
        values: NDArray[Any] = np.empty(shape, dtype=dtype)
        with self._file.stream() as stream:
            stream.seek(offset)
            n_bytes = stream.readinto(values.reshape(-1).view(np.uint8).data)
        if n_bytes != values.nbytes:
            raise self._file.corrupt(
                "a dataset lies beyond the end of the file",
                field=name,
                offset=offset,
                expected=f"{values.nbytes} bytes",
                found=f"{n_bytes} bytes",
            )
        values.setflags(write=False)
        return values

    def _described(self, name: str) -> dict[str, Any]:
        if name not in self._datasets:
            raise self._file.corrupt(
                "a dataset is missing",
                field=name,
                found=", ".join(list(self._datasets)[:8]) or "none",
            )
        return self._datasets[name]

    def _refuse_claim(
        self, name: str, found: Mapping[str, Any], part: tuple[int, ...], max_pixels: int | None
    ) -> None:
        """Refuse a dataset that leads out of the file or claims more than it stores."""
        if found["outside"]:
            raise UnsupportedFeatureError(
                f"{self._file.path}: dataset {name!r} lies in another file, which is not opened; copy it "
                "into this one"
            )
        if not found["dtype"] or found["shape"] is None:
            raise UnsupportedFeatureError(
                f"{self._file.path}: dataset {name!r} does not hold plain numbers"
            )
        item = np.dtype(found["dtype"]).itemsize
        claimed = item * _product(found["shape"])
        if claimed < 1:
            raise self._file.corrupt("a dataset is empty", field=name)
        limit = max_pixels or MAX_PIXELS
        if _product(part) > limit:
            raise UnsupportedFeatureError(
                f"{self._file.path}: dataset {name!r} claims {_product(part)} values, more than {limit}; "
                "pass max_pixels= if that is true"
            )
        stored, packed = int(found["stored"]), bool(found["packed"])
        allowed = stored * (_MAX_RATIO if packed else 1)
        trusted = packed and stored > 0 and max_pixels is not None
        if (stored > self._file.size or claimed > allowed) and not trusted:
            raise self._file.corrupt(
                "a dataset claims more than is stored",
                field=name,
                expected=f"{claimed} bytes",
                found=f"{stored} bytes",
            )


def _product(shape: Any) -> int:
    total = 1
    for n in shape:
        total *= int(n)
    return total


@contextmanager
def open_hdf5(file: RawFile) -> Iterator[Hdf5File]:
    """Open an HDF5 file for reading."""
    if not has_hdf5_magic(file):
        raise FormatMismatchError(
            f"{file.path}: is not an HDF5 file: expected {HDF5_MAGIC[:4]!r} at offset 0, found {file.head[:4]!r}"
        )
    handle = Hdf5File(file)
    try:
        yield handle
    finally:
        handle.close()


def _damaged(file: RawFile, what: str, answer: Mapping[str, Any]) -> CorruptFileError:
    reason = answer.get("error", "the HDF5 library crashed or hung on it")
    return file.corrupt(f"{what} cannot be read as HDF5 ({reason})")
