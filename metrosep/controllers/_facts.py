"""Facts about a file: in its comments, in its sidecar and from the user; all that state one must agree.

metrosep's own comment is ``metrosep: key=value key=value check=digits``. The checksum covers the facts
and every line that is not a comment, with blanks counting as one, so that a lost, doubled or exchanged
row and a number that was cut are found where no sidecar is left. A file of others has no such comment,
and nothing is checked. Other formats hold a comment line ``name = value`` for each fact.
"""

from __future__ import annotations

import os
import re
import zlib
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from metrosep.compensation.area_errors import is_rotary
from metrosep.compensation.table import CompensationTable
from metrosep.controllers.base import identity, load_sidecar, sidecar_options
from metrosep.controllers.options import Option, is_angle
from metrosep.core._arrays import FloatArray
from metrosep.core.errors import CorruptFileError, DataError, TableError

_MARK = "metrosep: "
_CHECK = "check"
_FACT = re.compile(r"(\w+) = (.+)")

_ROUNDED = 1e-12
"""Share by which two decimals of one number differ through binary."""
_FEMTOMETRE = 1e-15
"""Positions in comments are rounded to it."""


def settled(
    known: Iterable[Option],
    given: Mapping[str, Any],
    path: Path,
    *,
    file: Mapping[str, Any] | None = None,
    needed: Sequence[str] = (),
    partial: bool = False,
    axes: Mapping[str, str] | None = None,
) -> dict[str, Any]:
    """Return the options that file, sidecar and user state, each once; with defaults unless `partial`.

    Those of `needed` are never guessed; a text in `file` is checked as the option would be. Lengths
    along an axis are angles where that of `axes` turns.
    """
    options = {o.name: o for o in known}
    beside = sidecar_options(path, tuple(options.values()))
    found: dict[str, Any] = {}
    for name, option in options.items():
        sources = {
            "the file": _of_file(option, (file or {}).get(name), path),
            "its sidecar": None if option.kind == "object" else beside.get(name),
            "you": given.get(name),
        }
        if axes is not None:
            sources = {who: option.in_axis(v, axes) for who, v in sources.items()}
        value = agreed(path, name, sources)
        if value is None and (name in needed or (option.required and not partial)):
            forms = " or ".join(f"{name}={c}" for c in option.choices) or f"{name}="
            raise DataError(
                f"{path}: neither the file nor a sidecar states {name} ({option.help}); give {forms}"
            )
        if value is not None or not partial:
            found[name] = option.default if value is None else value
    return found


def _of_file(option: Option, value: Any, path: Path) -> Any:
    """Return a value of the file; the text of a comment is checked by its option."""
    if not isinstance(value, str) or option.kind == "text":
        return value
    try:
        return option.checked(value, "its comment")
    except DataError as exc:
        raise CorruptFileError(
            path, str(exc), field=option.name, expected=option.help, found=value[:60],
            hint="the comment was edited: write the table again",
        ) from None  # fmt: skip


def agreed(path: Path, name: str, sources: Mapping[str, Any]) -> Any:
    """Return the one value that all who state it state, None if nobody does."""
    stated = [(who, value) for who, value in sources.items() if value is not None]
    for who, value in stated[1:]:
        if not is_same(stated[0][1], value, exact="count" in name):
            raise DataError(
                f"{path}: {stated[0][0]} says {name}={stated[0][1]!r}, {who} "
                f"{'say' if who == 'you' else 'says'} {name}={value!r}"
                f"{' (SI units)' if isinstance(value, float) else ''}; one is wrong: leave the option "
                "out, or take the file that fits"
            )
    return stated[0][1] if stated else None


def is_same(a: Any, b: Any, *, exact: bool) -> bool:
    """Return whether two values of an option are one, but for the rounding of decimals.

    Examples
    --------
    >>> is_same(0.3, 0.1 + 0.2, exact=True), is_same(1, -1, exact=False)
    (True, False)
    """
    if isinstance(a, float) and isinstance(b, float | int) and not isinstance(b, bool):
        return abs(a - b) <= max(_ROUNDED * abs(a), 0.0 if exact else _FEMTOMETRE)
    return bool(a == b)


def is_described(path: Path) -> bool:
    """Return whether all options of a file are known, so that those not named have their defaults."""
    return path == Path(os.devnull) or bool(load_sidecar(path))


# ---- axes ---------------------------------------------------------------------------------------


def named_axes(fields: dict[str, Any], axes: tuple[str, str], path: Path) -> dict[str, Any]:
    """Return the fields of a table whose file names its axes, and refuse another sidecar."""
    if load_sidecar(path).get("table"):
        said = (fields["axis"], fields["compensates"])
        agreed(path, "the axes", {"the file": axes, "its sidecar": said})
    return {**fields, "axis": axes[0], "compensates": axes[1]}


def own_axis(fields: dict[str, Any], path: Path) -> dict[str, Any]:
    """Return the axes of a file that shifts the axis it looks up, and refuse a sidecar with two."""
    if fields["compensates"] != fields["axis"]:
        raise CorruptFileError(
            path,
            f"its sidecar says {fields['axis']} -> {fields['compensates']}, but this format shifts the "
            "axis that it looks up",
            hint="do not load it; write the table for a controller that corrects another axis",
        )
    return fields


def letter_in_file(
    path: Path, turns: bool | None, options: Mapping[str, Any], otherwise: str = "X"
) -> str:
    """Return an axis that a file does not name: of its sidecar, its unit, or the units that a person types."""
    if load_sidecar(path).get("table"):
        axis = str(identity(path, first=0.0)["axis"])
        if turns is not None and is_rotary(axis) != turns:
            raise CorruptFileError(
                path,
                f"the file is one of {'degrees' if turns else 'mm'}, its sidecar says axis {axis}",
                hint="use the sidecar that fits, or write the table again",
            )
        return axis
    if turns is None:
        turns = any(map(is_angle, options.values()))
    return "C" if turns else otherwise


def read_table(
    positions: FloatArray, forward: FloatArray, reverse: FloatArray | None = None, **fields: Any
) -> CompensationTable:
    """Return the table that a file holds: its corrections are looked up at the command.

    Where nothing states the reference of the axis, it is the entry without correction that is nearest to 0.
    """
    if "reference" not in fields:
        fields["reference"] = _without_correction(positions, forward)
    return CompensationTable(positions, forward, reverse, is_exact_inverse=True, **fields)


def _without_correction(positions: FloatArray, forward: FloatArray) -> float:
    """Return 0, or the entry nearest to it, without correction; else 0, or the first if 0 is beyond the table.

    A zero crossing between entries is no reference: an offset, which moves the zero of the machine, has some.
    """
    if positions[0] <= 0.0 <= positions[-1] and not np.interp(0.0, positions, forward):
        return 0.0
    places = positions[forward == 0.0]
    if places.size:
        return float(min(places, key=abs))
    return 0.0 if positions[0] <= 0.0 <= positions[-1] else float(positions[0])


# ---- comments -----------------------------------------------------------------------------------


def note(facts: Mapping[str, object], body: Iterable[str]) -> str:
    """Return the comment, without the characters that start one.

    Examples
    --------
    >>> note({"entry_sign": 1}, ["0 1"]).split(" check=")[0]
    'metrosep: entry_sign=1'
    """
    words = [f"{k}={v}" for k, v in facts.items()]
    return _MARK + " ".join([*words, f"{_CHECK}={_checksum(words, body)}"])


def is_note(comment: str) -> bool:
    """Return whether a comment is one of metrosep with facts."""
    return comment.strip().startswith(_MARK)


def read_notes(comments: Iterable[str], body: Sequence[str], path: Path) -> dict[str, str]:
    """Return the facts of a file, after a check of its lines."""
    stated: dict[str, str] = {}
    for comment in filter(is_note, comments):
        words = comment.strip().removeprefix(_MARK).split()
        pairs = [w.partition("=") for w in words]
        for key, _, value in pairs:
            _state(stated, key, value, path)
        checks = [value for key, _, value in pairs if key == _CHECK]
        facts = [w for w in words if not w.startswith(f"{_CHECK}=")]
        if checks and checks != [_checksum(facts, body)]:
            raise CorruptFileError(
                path,
                "its lines are not those that metrosep wrote: it was cut short, or a line was lost, "
                "doubled, exchanged or changed",
                field=_CHECK,
                expected=checks[0][:10],
                found=_checksum(facts, body),
                hint="write the table again; to read what you changed on purpose, remove the comment "
                "that starts with 'metrosep:' and give its facts as options",
            )
    stated.pop(_CHECK, None)
    return stated


def facts_of(comments: Sequence[str], path: Path) -> dict[str, str]:
    """Return the facts of comment lines ``name = value``, each stated once."""
    facts: dict[str, str] = {}
    for found in filter(None, (_FACT.fullmatch(c.strip()) for c in comments)):
        if found[1] in facts:
            _state(facts, found[1], f"{found[2].strip()} ", path)
        facts[found[1]] = found[2].strip()
    return facts


def _state(stated: dict[str, str], key: str, value: str, path: Path) -> None:
    """Add a fact, and refuse another one of that name."""
    if stated.setdefault(key, value) != value:
        raise CorruptFileError(
            path,
            f"two comments state {key}: {stated[key][:30]} and {value[:30].strip()}",
            hint="files were put together or edited: take them apart, or write the table again",
        )


def printable(text: str, what: str) -> str:
    """Return a text that may stand in a comment, and refuse others."""
    if not (text.isascii() and text.isprintable()) or "*" in text:
        raise TableError(
            f"{what} {text!r} cannot stand in a controller's file: use plain letters and digits"
        )
    return text


def _checksum(facts: Iterable[str], body: Iterable[str]) -> str:
    lines = [" ".join(facts), *(" ".join(line.split()) for line in body)]
    return str(zlib.crc32("\n".join(lines).encode("utf-8")))
