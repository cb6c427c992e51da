"""The process that touches HDF5 files: run by `metrosep.io.containers.hdf5_file`, never imported by a reader.

The HDF5 library crashes on some damaged files (a single flipped bit in the type of an attribute is
enough). So it runs in a process of its own, which answers over its standard streams: one line of
JSON, then raw bytes. When it dies the caller gets one sentence instead of dying too.

Requests: ``{"open": path | null, "bytes": n}`` and n bytes of content; ``{"read": name,
"handle": k, "start": i, "stop": j}``; ``{"close": k}``; each with ``"seconds"`` of
computing that it may take; end of input ends it. It never writes a file and follows no link.
"""

from __future__ import annotations

import importlib
import io
import json
import math
import os
import signal
import sys
from collections.abc import Mapping
from contextlib import suppress
from pathlib import Path
from typing import IO, Any

import h5py
import numpy as np

resource: Any = None if sys.platform == "win32" else importlib.import_module("resource")

MAX_OBJECTS = 100_000
MAX_DEPTH = 16
MAX_ATTRIBUTE = 256
MAX_ROWS = 10_000
SPARE = 2**28

_ERRORS = (
    OSError,
    KeyError,
    RuntimeError,
    ValueError,
    TypeError,
    AttributeError,
    SystemError,
    OverflowError,
    MemoryError,
    RecursionError,
)


def main() -> None:
    """Answer requests until the input ends."""
    answers = os.fdopen(os.dup(sys.stdout.fileno()), "wb")
    requests = sys.stdin.buffer
    handles: dict[int, Any] = {}
    for number, line in enumerate(requests, start=1):
        request = json.loads(line)
        content = b""
        if hasattr(signal, "setitimer"):  # not on Windows; it ends the process, also within C
            signal.setitimer(signal.ITIMER_PROF, request["seconds"])
        try:
            if "open" in request:
                handles[number] = _open(request, requests)
                answer = {"tree": _tree(handles[number]), "handle": number}
            elif "close" in request:
                if request["close"] in handles:
                    handles.pop(request["close"]).close()
                answer = {}
            else:
                content = _slice(handles[request["handle"]][request["read"]], request)
                answer = {"bytes": len(content)}
        except _ERRORS as exc:
            answer = {"error": " ".join(str(exc).split())[:160] or type(exc).__name__}
            # left open, a good copy over the damaged file would still be damaged
            if number in handles:
                with suppress(*_ERRORS):
                    handles.pop(number).close()
        answers.write(json.dumps(answer, allow_nan=True).encode() + b"\n")
        answers.write(content)
        answers.flush()


def _open(request: Mapping[str, Any], requests: IO[bytes]) -> Any:
    if request["open"] is not None:
        _may_grow(0)
        _require_own(request["open"])
        opened = h5py.File(request["open"], "r")
        _require_own(request["open"])
        return opened
    data = requests.read(request["bytes"])
    _may_grow(2 * len(data))
    return h5py.File(io.BytesIO(data), "r")


def _require_own(path: str) -> None:
    """Refuse a path that the reader gave without links and that passes one by now."""
    if os.path.realpath(path) != path:
        raise OSError("it became a link to another file while it was opened")


def _may_grow(n_bytes: int) -> None:
    """Let the process take so much memory more, and `SPARE`: a claim must not exhaust it."""
    pages = Path("/proc/self/statm")
    if resource is None or not pages.exists():
        return
    now = int(pages.read_text().split()[0]) * resource.getpagesize()
    _, hard = resource.getrlimit(resource.RLIMIT_AS)
    wanted = now + n_bytes + SPARE
    if hard == resource.RLIM_INFINITY or wanted <= hard:
        resource.setrlimit(resource.RLIMIT_AS, (wanted, hard))


def _tree(root: Any) -> dict[str, Any]:
    """Return groups and datasets by path, each with its attributes."""
    tree: dict[str, Any] = {"groups": {}, "datasets": {}}
    seen: set[Any] = set()
    waiting = [(root, "", 0)]
    while waiting:
        group, path, depth = waiting.pop(0)
        address = h5py.h5o.get_info(group.id).addr
        if address in seen:
            continue
        seen.add(address)
        if depth > MAX_DEPTH or len(seen) + len(tree["datasets"]) > MAX_OBJECTS:
            raise ValueError(f"the tree is deeper or larger than expected at {path!r}")
        tree["groups"][path or "/"] = _attributes(group)
        for name in group:
            if not isinstance(group.get(name, getlink=True), h5py.HardLink):
                continue
            item = group[name]
            where = f"{path}/{name}"
            if isinstance(item, h5py.Dataset):
                tree["datasets"][where] = _described(item)
            elif isinstance(item, h5py.Group):
                waiting.append((item, where, depth + 1))
    return tree


def _described(dataset: Any) -> dict[str, Any]:
    plain = dataset.dtype.kind in "iufb" and not dataset.dtype.hasobject
    outside = bool(dataset.external) or bool(dataset.is_virtual)
    size = int(dataset.size or 0)
    filters = dataset.id.get_create_plist().get_nfilters()
    found: dict[str, Any] = {
        "shape": None if dataset.shape is None else [int(n) for n in dataset.shape],
        "dtype": dataset.dtype.str if plain else "",
        "attributes": _attributes(dataset),
        "stored": int(dataset.id.get_storage_size()),
        "packed": dataset.chunks is not None and filters > 0,
        "outside": outside,
        "offset": None,
        "rows": None,
    }
    if plain and dataset.chunks is None and not outside:
        found["offset"] = dataset.id.get_offset()
    if not plain and not outside and size <= MAX_ROWS:
        values = dataset[()]
        found["rows"] = [_plain(v) for v in np.atleast_1d(values).ravel()]
    return found


def _slice(dataset: Any, request: Mapping[str, Any]) -> bytes:
    start, stop = request["start"], request["stop"]
    rest = math.prod(dataset.shape[1:]) * dataset.dtype.itemsize
    _may_grow(3 * rest * ((stop - start) if dataset.shape else 1))
    values = np.ascontiguousarray(dataset[start:stop] if dataset.shape else dataset[()])
    return values.tobytes()


def _attributes(item: Any) -> dict[str, Any]:
    return {str(name): _plain(item.attrs[name]) for name in item.attrs}


def _plain(value: Any) -> Any:
    """Return a value that JSON carries: text for bytes, a scalar for an array of one."""
    if isinstance(value, bytes):
        return value.split(b"\0")[0].decode("utf-8", "replace").strip()
    if isinstance(value, np.void):
        if value.dtype.names:
            return {str(n): _plain(value[n]) for n in value.dtype.names}
        return f"<{value.nbytes} bytes>"
    if isinstance(value, np.generic):
        return _plain(value.item())
    if isinstance(value, np.ndarray):
        if value.size == 1:
            return _plain(value.ravel()[0])
        if value.size > MAX_ATTRIBUTE:
            return f"<{value.size} values of {value.dtype}>"
        return [_plain(v) for v in value.ravel()]
    if isinstance(value, str):
        return value.encode("utf-8", "replace").decode().split("\0")[0]
    if value is None or isinstance(value, (bool, int, float)):
        return value
    if isinstance(value, (tuple, list)):
        return [_plain(v) for v in value]
    return f"<{type(value).__name__}>"


if __name__ == "__main__":
    main()
