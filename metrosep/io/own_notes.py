"""What metrosep writes of an object beside its numbers, in text that others ignore, and reads again.

One line for each fact that a later evaluation asks (which profile it is, by which cut-offs) and one
for each step of the history, so that a filtered profile stays one after CSV or X3P. A fact that is
damaged is refused, since without it the profile could be filtered twice; a damaged step is left
out with a warning. Facts are plain words, since spreadsheets quote and divide what holds commas.
"""

from __future__ import annotations

import json
import math
import re
from collections.abc import Callable, Iterable, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, field
from datetime import UTC, datetime
from typing import Any

import numpy as np

from metrosep._version import __version__
from metrosep.core.profile import Profile
from metrosep.core.provenance import Step, history_as_dicts
from metrosep.core.recording import Recording
from metrosep.core.runset import RunSet
from metrosep.core.surface import Surface
from metrosep.io.source import RawFile

_KINDS = ("P", "W", "R")
_CUTOFFS = ("lambda_c_m", "lambda_s_m", "lambda_f_m")
_COUNT = "n_sections"
_FACTS = ("profile_kind", *_CUTOFFS, _COUNT)
_EXPECTED = {"profile_kind": "P, W or R"}
_MOST_SECTIONS = 9999

_MARK = re.compile(r"metrosep \S+: SI units, empty or nan = not measured")
_FACT = re.compile(rf"({'|'.join(_FACTS)})\s*:(.*)")
_WORD = re.compile(rf"(?<!\S)({'|'.join(_FACTS)})\s*:\s*(\S+)")
_DECIMAL = re.compile(r"\d+(?:\.\d*)?(?:[eE][+-]?\d+)?")
_STEP = "history:"
_COMMENT = "metrosep history:"
_DEEPEST = 40
"""Values in a step lie at most this deep in each other; those that metrosep writes less than 10."""

_CHAIN = {"primary": "P", "roughness": "R", "waviness": "W"}
"""Steps of the filter chain, and what they make of a profile."""


@dataclass(frozen=True, slots=True)
class OwnNotes:
    """What a file that metrosep wrote says of its object."""

    # mapping of str to str, float or int: for the metadata: ``profile_kind``, cut-offs in m,
    # ``n_sections``
    facts: Mapping[str, Any] = field(default_factory=dict)
    history: tuple[Step, ...] = ()  # before this file was read
    warnings: tuple[str, ...] = ()  # what was left out


def header_lines(obj: Surface | Profile | Recording | RunSet) -> list[str]:
    """Return the lines above a table that metrosep writes, without a mark of comments."""
    steps = [f"{_STEP} {_one_step(step)}" for step in obj.history]
    first = f"metrosep {__version__}: SI units, empty or nan = not measured"
    return [first, *_fact_lines(obj), *steps]


def is_marked(comment: str) -> bool:
    """Return whether a comment is the line by which `header_notes` knows those of metrosep."""
    return _MARK.match(comment) is not None


def comment_text(obj: Surface | Profile) -> str:
    """Return the text of a field for comments."""
    return "\n".join([f"{_COMMENT} {encode_history(obj.history).decode()}", *_fact_lines(obj)])


def header_notes(file: RawFile, comments: Iterable[str]) -> OwnNotes:
    """Return what comments above a table say, if metrosep wrote them."""
    lines = [str(line).strip() for line in comments]
    start = next((i for i, line in enumerate(lines) if is_marked(line)), None)
    if start is None:
        return OwnNotes()
    facts: dict[str, Any] = {}
    history: list[Step] = []
    warnings: list[str] = []
    for line in lines[start + 1 :]:
        if line.startswith(_STEP):
            step = _steps(f"[{line.removeprefix(_STEP)}]")
            if step is None:
                warnings.append(_lost(line))
            else:
                history.extend(step)
        elif match := _FACT.fullmatch(line):
            warnings += _take_fact(file, match[1], match[2], facts)
    return _notes(facts, history, warnings)


def comment_notes(file: RawFile, comment: str) -> OwnNotes:
    """Return what a field for comments says, if metrosep wrote it."""
    _, mark, text = comment.partition(_COMMENT)
    if not mark:
        return OwnNotes()
    text = text.lstrip()
    try:
        end = json.JSONDecoder().raw_decode(text)[1]
    except (ValueError, RecursionError):
        end = 0
    history = _steps(text[:end])
    facts: dict[str, Any] = {}
    warnings = [] if history is not None else [_lost(f"{mark} {text}", "the history")]
    for found in _WORD.finditer(text, end):  # line ends may have become blanks on the way
        warnings += _take_fact(file, found[1], found[2], facts)
    return _notes(facts, history or (), warnings)


def _fact_lines(obj: Surface | Profile | Recording | RunSet) -> list[str]:
    found = obj.metadata if isinstance(obj, Profile) else {}
    texts = {name: _fact_text(name, found.get(name)) for name in _FACTS}
    return [f"{name}: {text}" for name, text in texts.items() if text]


def _fact_text(name: str, value: Any) -> str:
    """Return a fact as text, empty for what is none."""
    if name == "profile_kind":
        return str(value) if value in _KINDS else ""
    if isinstance(value, bool) or not isinstance(value, (int, float)):
        return ""
    text = repr(int(value) if isinstance(value, int) else float(value))
    return text if _fact_value(name, text) is not None else ""


def _fact_value(name: str, text: str) -> str | float | int | None:
    """Return the fact of a text, None for what is none."""
    if name == "profile_kind":
        return text if text in _KINDS else None
    if len(text) > 40 or not _DECIMAL.fullmatch(text):
        return None
    if name == _COUNT:
        return int(text) if text.isdecimal() and 1 <= int(text) <= _MOST_SECTIONS else None
    number = float(text)
    return number if 0.0 < number < math.inf else None


def _take_fact(file: RawFile, name: str, text: str, facts: dict[str, Any]) -> list[str]:
    """Add a fact; return a warning for one that decides nothing, and refuse other damage."""
    text = text.strip().rstrip(',;\t "')
    value = _fact_value(name, text)
    if value is not None and name not in facts:
        facts[name] = value
        return []
    if name == _COUNT:
        return [f"{name} of the file, {text[:40]!r}, is damaged or is given twice: omitted"]
    twice = name in facts
    raise file.corrupt(
        f"what metrosep noted of the object {'is given twice' if twice else 'is damaged'}",
        field=name,
        expected="one line" if twice else _EXPECTED.get(name, "a positive length in m"),
        found=None if twice else repr(text)[:40],
        hint="correct that line, or remove it if it is not known",
    )


def _notes(facts: dict[str, Any], history: Sequence[Step], warnings: Sequence[str]) -> OwnNotes:
    return OwnNotes({**_facts_of(history), **facts}, tuple(history), tuple(warnings))


def _facts_of(history: Sequence[Step]) -> dict[str, Any]:
    """Return the facts that follow from the steps, for files that lack lines of facts."""
    facts: dict[str, Any] = {}
    for step in history:
        if step.name in _CHAIN:
            facts["profile_kind"] = _CHAIN[step.name]
            cutoffs = {n: _fact_text(n, step.parameters.get(n)) for n in _CUTOFFS}
            facts |= {n: float(text) for n, text in cutoffs.items() if text}
        elif step.parameters.get("band") == "short" and facts.get("profile_kind") != "W":
            facts["profile_kind"] = "R"
    return facts


def _one_step(step: Step) -> str:
    return encode_history((step,)).decode()[1:-1]


def _steps(text: str) -> tuple[Step, ...] | None:
    """Return the steps of a JSON list, None for anything else."""
    try:
        if not isinstance(entries := json.loads(text), list) or _depth(entries) > _DEEPEST:
            return None
        if not all(isinstance(entry["step"], str) and entry["step"] for entry in entries):
            return None
        return decode_history(text.encode())
    except (ValueError, KeyError, TypeError, AttributeError, RecursionError):
        return None


def _depth(value: Any) -> int:
    """Return how deep values lie in each other; without recursion, since a stranger wrote them."""
    depth, level = 0, [value]
    while level and depth <= _DEEPEST:
        depth += 1
        inside = [list(v.values()) if isinstance(v, dict) else v for v in level]
        level = [child for v in inside if isinstance(v, list) for child in v]
    return depth


def _lost(line: str, what: str = "a step of the history") -> str:
    shown = line if len(line) <= 60 else line[:60] + " ..."
    return (
        f"{what} is damaged and was omitted, so what was removed or filtered may not be known: "
        f"{shown!r}"
    )


# ---- history and metadata as JSON that gives the same Python values back -----------------------
# Tuples, NaN and infinities are marked, since JSON has none; whatever else JSON lacks becomes text.

_TUPLE, _NUMBER = "__tuple__", "__number__"


def encode_mapping(values: Mapping[str, Any]) -> bytes:
    """Return a mapping as UTF-8 JSON with sorted keys."""
    return json.dumps(_encode(values), sort_keys=True, allow_nan=False).encode()


def decode_mapping(data: bytes) -> dict[str, Any]:
    """Return the mapping of `encode_mapping`."""
    found = _decode(json.loads(data))
    if not isinstance(found, dict):
        raise ValueError("a mapping was expected")  # noqa: TRY004  (one error for the reader)
    return found


def encode_history(history: tuple[Step, ...]) -> bytes:
    """Return a history as UTF-8 JSON."""
    return json.dumps(_encode(history_as_dicts(history)), sort_keys=True, allow_nan=False).encode()


def decode_history(data: bytes) -> tuple[Step, ...]:
    """Return the history of `encode_history`."""
    entries = _decode(json.loads(data))
    return tuple(Step(str(e["step"]), e["parameters"], str(e["version"])) for e in entries)


def _encode(value: Any) -> Any:
    if isinstance(value, Mapping):
        return {str(k): _encode(v) for k, v in value.items()}
    if isinstance(value, tuple):
        return {_TUPLE: [_encode(v) for v in value]}
    if isinstance(value, list):
        return [_encode(v) for v in value]
    if isinstance(value, np.ndarray):
        return _encode(value.tolist())
    if isinstance(value, np.generic):
        return _encode(value.item())
    if isinstance(value, float) and not math.isfinite(value):
        return {_NUMBER: repr(value)}
    if value is None or isinstance(value, (bool, int, float, str)):
        return value
    return str(value)


def _decode(value: Any) -> Any:
    if isinstance(value, list):
        return [_decode(v) for v in value]
    if not isinstance(value, dict):
        return value
    if value.keys() == {_TUPLE}:
        return tuple(_decode(v) for v in value[_TUPLE])
    if value.keys() == {_NUMBER}:
        return float(value[_NUMBER])
    return {k: _decode(v) for k, v in value.items()}


# ---- when something was measured, as its file says; a clock of this computer is never asked ----

Header = Mapping[str, Any]

_FIRST, _LAST = 1980, 2199
"""Years outside are not dates of measuring: writers without a clock put 1970 or zeros."""


def measured_at(metadata: Mapping[str, Any]) -> str | None:
    """Return the date and time of measuring that the file of a map or profile states.

    Examples
    --------
    >>> measured_at({"format": "sdf", "header": {"CreateDate": "030120261215"}})
    '2026-01-03T12:15:00'
    >>> measured_at({"format": "sdf", "header": {"CreateDate": "010119700000"}}) is None
    True
    """
    header = metadata.get("header")
    read = _READ.get(str(metadata.get("format")))
    found: datetime | None = None
    with suppress(ValueError, TypeError, KeyError, OverflowError, OSError, AttributeError):
        if "measured_at" in metadata:
            found = datetime.fromisoformat(str(metadata["measured_at"]))
        elif read is not None and isinstance(header, Mapping):
            found = read(header)
    if found is None or not _FIRST <= found.year <= _LAST:
        return None
    return found.isoformat()


def moment_of(text: str) -> datetime:
    """Return a text of `measured_at` as a time that can be compared with others.

    Examples
    --------
    >>> moment_of("2026-01-03T13:00:00+01:00") == moment_of("2026-01-03T12:00:00")
    True
    """
    found = datetime.fromisoformat(text)
    return found if found.tzinfo is None else found.astimezone(UTC).replace(tzinfo=None)


def _unix(key: str) -> Callable[[Header], datetime]:
    return lambda header: datetime.fromtimestamp(int(header[key]), UTC)


def _sdf(header: Header) -> datetime:
    """Day, month, year, hour and minute as twelve digits (EUNA 15178)."""
    return datetime.strptime(str(header["CreateDate"]).strip(), "%d%m%Y%H%M")


def _x3p(header: Header) -> datetime:
    return datetime.fromisoformat(str(header["Record2/Date"]).strip())


def _digital_surf(header: Header) -> datetime:
    year, month, day, hour, minute, second = (
        int(header[k]) for k in ("year", "month", "day", "hour", "minute", "second")
    )
    return datetime(year, month, day, hour, minute, second)


_READ: Mapping[str, Callable[[Header], datetime]] = {
    "sdf": _sdf,
    "x3p": _x3p,
    "digital-surf": _digital_surf,
    "metropro": _unix("time_stamp"),
    "zygo-xyz": _unix("time_stamp"),
    "plu": _unix("unix_time"),
}
