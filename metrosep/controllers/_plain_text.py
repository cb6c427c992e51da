"""Plain text that controllers read: decimals without exponent, lines, facts in comments.

A fact is a comment line ``; name = value``: what the file's own grammar cannot say, such as the
length of one count. A reader takes the facts first, then what the user and the sidecar say; where
they contradict each other, it refuses.
"""

from __future__ import annotations

import os
import re
from collections.abc import Mapping, Sequence
from decimal import Decimal
from pathlib import Path
from typing import Any

from metrosep.controllers.base import load_sidecar, sidecar_options
from metrosep.controllers.options import Option
from metrosep.core.errors import CorruptFileError, DataError, TableError

__all__ = [
    "agreed",
    "ascii_lines",
    "decimal",
    "facts_of",
    "is_described",
    "is_same",
    "known_options",
    "printable",
    "resolved",
    "scaled",
]


_FACT = re.compile(r"(\w+) = (.+)")

_ROUNDED = 1e-12
"""Share by which two decimals of one number differ through binary."""

_FEMTOMETRE = 1e-15
"""Positions in comments are rounded to it."""


def decimal(value: float, digits: int = 17) -> str:
    """Return a number as a decimal without exponent, with the fewest digits up to `digits`.

    Examples
    --------
    >>> decimal(1.2e-7), decimal(-0.0), decimal(4e6)
    ('0.00000012', '0', '4000000')
    """
    text = repr(float(value)) if digits >= 17 else f"{value:.{digits}g}"
    return _plain(Decimal(text))


def scaled(value: float, places: int) -> str:
    """Return a number times ten to a power as an exact decimal without exponent.

    Examples
    --------
    >>> scaled(1e-8, 9)
    '10'
    """
    return _plain(Decimal(repr(float(value))).scaleb(places))


def _plain(number: Decimal) -> str:
    text = format(number, "f")
    if "." in text:
        text = text.rstrip("0").rstrip(".")
    return "0" if text in ("-0", "") else text


def printable(text: str, what: str) -> str:
    """Return a text that may stand in a comment, and refuse others."""
    if not (text.isascii() and text.isprintable()) or "*" in text:
        raise TableError(
            f"{what} {text!r} cannot stand in a controller's file: use plain letters and digits"
        )
    return text


def ascii_lines(data: bytes, path: Path, what: str) -> list[str]:
    """Return the lines of a file."""
    try:
        return data.decode("ascii").splitlines()
    except UnicodeDecodeError as exc:
        raise CorruptFileError(
            path, "not ASCII text", offset=exc.start, hint=f"this is no {what}"
        ) from None


def facts_of(comments: Sequence[str], path: Path) -> dict[str, str]:
    """Return the facts of comment lines."""
    facts: dict[str, str] = {}
    for found in filter(None, (_FACT.fullmatch(c.strip()) for c in comments)):
        name, value = found[1], found[2].strip()
        if name in facts:
            raise CorruptFileError(
                path,
                f"two comments state {name}: {facts[name][:30]} and {value[:30]}",
                hint="the file was edited or put together of two: write it again",
            )
        facts[name] = value
    return facts


def resolved(
    given: Mapping[str, Any],
    facts: Mapping[str, str],
    path: Path,
    known: Sequence[Option],
    told: Sequence[str] = (),
) -> dict[str, Any]:
    """Return every option of a dialect: of the file's comments, the user, its sidecar, its default."""
    beside = sidecar_options(path, tuple(known))
    found: dict[str, Any] = {}
    for option in known:
        name = option.name
        sources = {
            "a comment in the file": _of_comment(option, facts, path),
            "the user (or the sidecar)": given.get(name),
            "the sidecar": beside.get(name),
        }
        value = agreed(name, sources, path)
        if value is None and name not in told:
            value = option.default
        if value is None and (option.required or name in told):
            raise DataError(
                f"{path}: neither the file nor a sidecar tells {name} ({option.help}); give "
                f"{name}= as a keyword, or --machine {name}=... on the command line"
            )
        found[name] = value
    return found


def known_options(
    given: Mapping[str, Any], path: Path, known: Sequence[Option], told: Sequence[str]
) -> dict[str, Any]:
    """Return every option of a dialect whose file holds no comments: of the user, the sidecar."""
    beside = sidecar_options(path, tuple(known))
    has_defaults = is_described(path)
    found: dict[str, Any] = {}
    for option in known:
        name = option.name
        value = given.get(name)
        if option.kind != "object":
            value = agreed(name, {"the user": value, "the sidecar": beside.get(name)}, path)
        if value is None and (option.required or not has_defaults) and name in told:
            raise DataError(
                f"{path}: the file does not say {name} ({option.help}) and has no sidecar that does; "
                f"give {name}="
            )
        found[name] = option.default if value is None else value
    return found


def is_described(path: Path) -> bool:
    """Return whether all options of a file are known, so that those not named have their defaults."""
    return path == Path(os.devnull) or bool(load_sidecar(path))


def _of_comment(option: Option, facts: Mapping[str, str], path: Path) -> Any:
    if option.name not in facts:
        return None
    try:
        return option.checked(facts[option.name], path.name)
    except DataError:
        raise CorruptFileError(
            path,
            "a comment states no such value",
            field=option.name,
            expected=option.help,
            found=facts[option.name][:60],
            hint="the file was edited: write it again",
        ) from None


def agreed(name: str, sources: Mapping[str, Any], path: Path) -> Any:
    """Return the one value that all who state it state."""
    stated = [(who, v) for who, v in sources.items() if v is not None]
    for who, value in stated[1:]:
        if not is_same(stated[0][1], value, exact="count" in name):
            raise DataError(
                f"{path}: {stated[0][0]} says {name}={stated[0][1]}, {who} says {name}={value} (SI "
                "units); leave the option out, or look for the file that fits"
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
