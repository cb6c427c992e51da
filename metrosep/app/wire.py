"""Frames between server and page: a header in JSON and arrays as they lie in memory.

See `docs/reference/workbench-protocol.md`: four bytes with the length of the header (unsigned,
little endian), the header in UTF-8 padded with blanks so that what follows starts at a multiple
of 8 bytes, then the arrays that `header["arrays"]` names, each padded with zeros to 8 bytes.

JSON knows no NaN: in the header it is null. In the arrays NaN stays NaN, as not measured.
"""

from __future__ import annotations

import json
import math
import re
from collections.abc import Callable, Iterable, Mapping
from pathlib import Path, PurePath
from typing import Any, TypeAlias, cast

import numpy as np
from numpy.typing import NDArray

from metrosep.app.evaluations import Level
from metrosep.core.errors import DataError
from metrosep.core.numbers import is_real
from metrosep.core.readable import said_value

_DTYPES = {name: np.dtype("<" + name) for name in ("u1", "i4", "f4", "f8")}
_ALIGNMENT = 8
_MOST_HEADER = 64 * 1024 * 1024
"""Longest header that is read; the arrays are what may be large."""


def pack(header: Mapping[str, Any], arrays: Mapping[str, NDArray[Any]] | None = None) -> bytes:
    """Return one frame.

    Notes
    -----
    The frame is made in one piece: beyond the arrays it takes their size once. Same input, same
    bytes.

    Examples
    --------
    >>> frame = pack({"id": 7, "ok": True}, {"low": np.array([1.0, np.nan])})
    >>> header, arrays = unpack(frame)
    >>> header["id"], arrays["low"].tolist()
    (7, [1.0, nan])
    """
    if "arrays" in header:
        raise DataError('the key "arrays" of a header is written by pack: leave it out')
    parts: list[NDArray[Any]] = []
    table = []
    for name, values in (arrays or {}).items():
        array = _on_the_wire(name, values)
        table.append({"name": name, "dtype": array.dtype.str[1:], "shape": list(array.shape)})
        parts.append(array)
    text = _json({**header, "arrays": table})
    text += b" " * (-(4 + len(text)) % _ALIGNMENT)
    pieces: list[bytes | memoryview] = [len(text).to_bytes(4, "little"), text]
    for array in parts:
        pieces += [array.reshape(-1).view(np.uint8).data, b"\0" * (-array.nbytes % _ALIGNMENT)]
    return b"".join(pieces)


def unpack(
    frame: bytes | bytearray | memoryview,
) -> tuple[dict[str, Any], dict[str, NDArray[Any]]]:
    """Return header and arrays of a frame.

    Notes
    -----
    The padding is checked too: a frame is either the one that was packed or refused. What comes
    after `unpack` is copied nowhere, so a hostile shape costs no memory.

    Examples
    --------
    >>> unpack(pack({"k": "saved"}))
    ({'k': 'saved'}, {})
    """
    try:
        data = memoryview(frame).cast("B")
    except TypeError as error:
        raise DataError(f"a frame is bytes, got {type(frame).__name__}: {error}") from None
    if data.nbytes < 8:
        raise DataError(f"a frame has at least 8 bytes, got {data.nbytes}")
    end = 4 + int.from_bytes(data[:4], "little")
    if end > data.nbytes or end > _MOST_HEADER:
        raise DataError(
            f"the frame says its header ends at byte {end}, but it has {data.nbytes} bytes: it was "
            "cut, or is not a frame"
        )
    if end % _ALIGNMENT:
        raise DataError(f"the header ends at byte {end}, which is not a multiple of {_ALIGNMENT}")
    header = _header(bytes(data[4:end]))
    arrays: dict[str, NDArray[Any]] = {}
    for k, entry in enumerate(header.pop("arrays")):
        name, dtype, shape = _entry(entry, k)
        if name in arrays:
            raise DataError(f"two arrays of the frame are named {name!r}")
        stop = end + math.prod(shape) * dtype.itemsize
        after = stop + -stop % _ALIGNMENT
        if after > data.nbytes:
            raise DataError(
                f"array {name!r} of shape {list(shape)} ends at byte {after}, but the frame has "
                f"{data.nbytes} bytes"
            )
        if any(data[stop:after]):
            raise DataError(f"the padding after array {name!r} is not zero")
        values = np.frombuffer(data[end:stop], dtype=dtype).reshape(shape)
        values.setflags(write=False)
        arrays[name] = values
        end = after
    if end != data.nbytes:
        raise DataError(f"{data.nbytes - end} bytes follow the last array of the frame")
    return header, arrays


_OWN = r"(?<![\w/\\.-])([a-z]\w*)"
"""A key that is not a part of the name of a file."""
_SWITCH = re.compile(
    rf"\b(?:write|set|state|give|say) {_OWN} = (true|false)\b(?!\.\w)(?: here| there)?"
)
_PAIR = re.compile(
    rf"{_OWN} ?= ?(?:\"([^\"]*)\"|'([^']*)'|(-?\d[\w.+-]*|(?:true|false)\b)(?![/\\]|\.\w))"
    r"(?: in \[\w+\]| here\b| there\b)?"
)
_AMOUNT = re.compile(r"[+-]?\.?\d")
"""What begins as a number with its unit does; a word that was typed stays quoted."""
_NAMED = re.compile(rf"{_OWN}=(?=[\s,;)]|\.(?!\w)|$)")
_MACHINE = re.compile(r": write machine = \{[^{}]*\}")
"""Facts of a controller that are missing: the page has a field for each."""
_BAND = re.compile(r"\blambda_(?=[a-z]\b)")
_SUFFIX = re.compile(r"\.[A-Za-z]")
_TURNS = re.compile("[\u202a-\u202e\u2066-\u2069]")
"""What turns the direction of letters: in the name of a file it would turn the sentence."""
_KEPT = 0xF0000
"""First letter for private use: each stands for a name of a file until the sentence is made."""
_MARKS = f"[{chr(_KEPT)}-{chr(0x10FFFF)}]"
_LINE = re.compile(
    r"(?:\A(?:[A-Za-z]:)?[^\n:(]*\.toml|"
    rf"(?<![^ (])[^\s:(]*(?:\.toml|{_MARKS})):\d+: "
)
_HEAD = rf"\A(?:[A-Za-z]:)?[^\n:;]*\.[A-Za-z]\w{{0,7}}(?=: )|{_MARKS}"
"""The name of a file before what is said of it."""
_QUOTED = r"(?<![\w=])(?<!= )(?:'[^'\n]*=[^'\n]*'|\"[^\"\n]*=[^\"\n]*\")(?!\w)"
"""What a message quotes, such as the name of a column; the value of a key follows its equals sign."""


def page_words(message: str, names: Iterable[object] = ()) -> str:
    """Return a message without the grammar of recipes and Python: the page has fields, not keys.

    Names of files stay as they are: those given, and the one that the message begins with; so does what is
    quoted.

    Examples
    --------
    >>> page_words('r.toml:9: give the middle = "... mm" of the groove, or write lateral_step = "3 um" in [input]')
    'give the middle of the groove, or write lateral step 3 um'
    >>> page_words("put that step first, or write intermediate = true here")
    'put that step first, or switch intermediate on'
    >>> page_words("gain=2.toml: exists already; write n = 3")
    'gain=2.toml: exists already; write n = 3'
    >>> page_words('r.toml:4: a = "abc": a point has x and y')
    'a “abc”: a point has x and y'
    """

    def switched(found: re.Match[str]) -> str:
        return f"switch {field_words(found[1])} {'on' if found[2] == 'true' else 'off'}"

    def pair(found: re.Match[str]) -> str:
        value = next(v for v in found.groups()[1:] if v is not None)
        if found[4] and _SUFFIX.search(value):
            return found[0]  # the name of a file
        if found[4]:
            return f"{field_words(found[1])} = {value}"
        if "..." in value:
            return field_words(found[1])
        return f"{field_words(found[1])} {value if _AMOUNT.match(value) else f'“{value}”'}"

    kept: list[str] = []

    def keep(found: re.Match[str]) -> str:
        kept.append(found[0])
        return chr(_KEPT + len(kept) - 1)

    known = {_TURNS.sub("\ufffd", t) for n in names for t in (str(n), PurePath(str(n)).name)}
    longest = sorted(filter(None, known), key=len, reverse=True)
    files = "|".join([*(rf"(?<!\w){re.escape(n)}(?!\w)" for n in longest), _HEAD, _QUOTED])
    text = re.sub(files, keep, _TURNS.sub("\ufffd", message))
    text = _SWITCH.sub(switched, _LINE.sub("", _MACHINE.sub("", text)))
    text = _NAMED.sub(lambda m: field_words(m[1]), _PAIR.sub(pair, text))
    return re.sub(_MARKS, lambda m: kept[ord(m[0]) - _KEPT], _BAND.sub("\u03bb", text))


def field_words(key: str) -> str:
    """Return what the page calls a key."""
    return key.replace("lambda_", "\u03bb").replace("_", " ")


def error_header(
    message: str, *, code: int, request: int | None = None, k: str | None = None, ask: Any = None
) -> dict[str, Any]:
    """Return the header of an answer that failed.

    Examples
    --------
    >>> error_header("no such file", code=3, request=7, k="open")["error"]
    {'code': 3, 'message': 'no such file'}
    """
    error: dict[str, Any] = {"code": int(code), "message": str(message)}
    if ask is not None:
        error["ask"] = ask
    named = {key: value for key, value in (("id", request), ("k", k)) if value is not None}
    return {**named, "ok": False, "error": error}


def _on_the_wire(name: object, values: object) -> NDArray[Any]:
    if not isinstance(name, str) or not name:
        raise DataError(f"the name of an array must be a text, got {name!r}")
    if not isinstance(values, np.ndarray) or isinstance(values, np.ma.MaskedArray):
        raise DataError(f"array {name!r} must be a plain ndarray, got {type(values).__name__}")
    array = values.astype(np.uint8) if values.dtype == np.bool_ else values
    code = array.dtype.newbyteorder("<").str[1:]
    if code not in _DTYPES:
        raise DataError(
            f"array {name!r} has dtype {values.dtype}; a frame carries u1, i4, f4 and f8: convert "
            "it, and see whether it fits"
        )
    return np.asarray(array, dtype=_DTYPES[code], order="C")


def _json(header: Mapping[str, Any]) -> bytes:
    try:
        text = json.dumps(_plain(header, "header"), allow_nan=False, ensure_ascii=False)
        return text.encode("utf-8")
    except (ValueError, TypeError, RecursionError) as error:
        if isinstance(error, DataError):
            raise
        raise DataError(f"the header cannot be written as JSON: {error}") from None


def _plain(value: Any, where: str) -> Any:
    """Return plain values: NaN as None, numpy scalars and tuples as what JSON knows."""
    if isinstance(value, np.generic):
        value = value.item()
    if value is None or isinstance(value, str | bool | int):
        return value
    if isinstance(value, float):
        if math.isinf(value):
            raise DataError(f"{where} is infinite, which JSON cannot say")
        return None if math.isnan(value) else value
    if isinstance(value, Mapping):
        for key in value:
            if not isinstance(key, str):
                raise DataError(f"{where} has the key {key!r}; keys must be text")
        return {key: _plain(v, f"{where}.{key}") for key, v in value.items()}
    if isinstance(value, list | tuple):
        return [_plain(v, f"{where}[{i}]") for i, v in enumerate(value)]
    raise DataError(f"{where} is a {type(value).__name__}, which JSON cannot say")


def _refuse_constant(name: str) -> Any:
    raise DataError(f"the header says {name}, which is not JSON; not measured is null")


def _finite(text: str) -> float:
    value = float(text)
    if math.isinf(value):
        raise DataError(f"the header says {text}, which is beyond what a number can hold")
    return value


def _once(pairs: list[tuple[str, Any]]) -> dict[str, Any]:
    found = dict(pairs)
    if len(found) < len(pairs):
        raise DataError("a key occurs twice in the header of a frame")
    return found


def _header(text: bytes) -> dict[str, Any]:
    try:
        header = json.loads(
            text.decode("utf-8"),
            parse_constant=_refuse_constant,
            parse_float=_finite,
            object_pairs_hook=_once,
        )
    except (ValueError, RecursionError) as error:
        if isinstance(error, DataError):
            raise
        raise DataError(f"the header of the frame is not JSON in UTF-8: {error}") from None
    if not isinstance(header, dict):
        raise DataError(f"the header of a frame is an object, got {type(header).__name__}")
    if not isinstance(header.get("arrays"), list):
        raise DataError('the header of a frame lacks its list "arrays"')
    return header


def _entry(entry: object, k: int) -> tuple[str, np.dtype[Any], tuple[int, ...]]:
    where = f"arrays[{k}] of the header"
    if not isinstance(entry, dict) or set(entry) != {"name", "dtype", "shape"}:
        raise DataError(f"{where} must have name, dtype and shape, got {entry!r}")
    name, dtype, shape = entry["name"], entry["dtype"], entry["shape"]
    if not isinstance(name, str) or not name:
        raise DataError(f"{where}: the name must be a text, got {name!r}")
    if not isinstance(dtype, str) or dtype not in _DTYPES:
        raise DataError(f"{where}: dtype must be u1, i4, f4 or f8, got {dtype!r}")
    whole = isinstance(shape, list) and all(type(n) is int and 0 <= n < 2**31 for n in shape)
    if not whole or len(shape) > 8 or math.prod(n for n in shape if n) >= 2**48:
        raise DataError(
            f"{where}: shape must be a list of up to 8 whole numbers of reasonable size, got "
            f"{str(shape)[:80]}"
        )
    return name, _DTYPES[dtype], tuple(shape)


# ---- what requests and answers of the workbench are made of ------------------------------------

Arrays: TypeAlias = dict[str, NDArray[Any]]
Answer: TypeAlias = tuple[dict[str, Any], Arrays]
Message: TypeAlias = Mapping[str, Any]
Cancel: TypeAlias = Callable[[], bool]
Tell: TypeAlias = Callable[[Mapping[str, Any]], None]
"""Sends news to the page: what is being done, before the answer."""


def level_of(message: Message) -> Level:
    """Return the size of the data that a request wants."""
    level = message.get("level", "idle")
    if level not in ("drag", "idle", "full"):
        raise DataError(f"level is drag, idle or full, got {level!r}")
    return cast(Level, level)


def text_of(message: Message, name: str) -> str:
    """Return a text of a request."""
    value = message.get(name)
    if not isinstance(value, str) or not value:
        raise DataError(f"{name} is a text, got {said_value(value)}")
    return value


def number_of(message: Message, name: str) -> float:
    """Return a number of a request."""
    value = message.get(name)
    if not is_real(value):
        raise DataError(
            f"the request {message.get('k')} needs the number {name}, got {said_value(value)}"
        )
    return float(value)  # type: ignore[arg-type]


def point_of(message: Message, name: str) -> tuple[float, float]:
    """Return a point of a request."""
    value = message.get(name)
    if not isinstance(value, list | tuple) or len(value) != 2 or not all(map(is_real, value)):
        raise DataError(
            f"the request {message.get('k')} needs the point {name} as [x, y], got {said_value(value)}"
        )
    return float(value[0]), float(value[1])


def number_or_none(value: float | None) -> float | None:
    """Return a number as JSON knows it."""
    return None if value is None or not np.isfinite(value) else float(value)


def plain(value: Any) -> Any:
    """Return nested values as JSON knows them."""
    if isinstance(value, Mapping):
        return {str(k): plain(v) for k, v in value.items()}
    if isinstance(value, list | tuple):
        return [plain(v) for v in value]
    if isinstance(value, np.generic):
        value = value.item()
    if isinstance(value, float) and not np.isfinite(value):
        return None
    return str(value) if isinstance(value, Path) else value
