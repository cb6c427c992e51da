"""Plain text that controllers read: decimals without exponent, lines, facts in comments.

A fact is a comment line ``; name = value``: what the file's own grammar cannot say, such as the
length of one count. A reader takes what the user gives first, then the facts, then the sidecar.
"""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from decimal import Decimal
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from metrosep.controllers.base import Simulator, sidecar_options
from metrosep.controllers.options import Option
from metrosep.core.errors import CorruptFileError, DataError, TableError

__all__ = ["ascii_lines", "decimal", "facts_of", "one_way", "printable", "resolved", "scaled"]

FloatArray = NDArray[np.float64]

_FACT = re.compile(r"(\w+) = (.+)")


def decimal(value: float, digits: int = 17) -> str:
    """Return a number as a decimal without exponent, with the fewest digits up to `digits`.

    Parameters
    ----------
    value : float
        Finite.
    digits : int, optional
        Significant digits, 1 to 17; with 17 the text reads back as the very number.

    Returns
    -------
    str
        Such as ``"0.00000012"``; never ``"-0"``.

    Examples
    --------
    >>> decimal(1.2e-7), decimal(-0.0), decimal(4e6)
    ('0.00000012', '0', '4000000')
    """
    text = repr(float(value)) if digits >= 17 else f"{value:.{digits}g}"
    return _plain(Decimal(text))


def scaled(value: float, places: int) -> str:
    """Return a number times ten to a power as an exact decimal without exponent.

    Parameters
    ----------
    value : float
        Finite, such as a length in m.
    places : int
        Power of ten, such as 9 for nm.

    Returns
    -------
    str
        The decimal.

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
    """Return a text that may stand in a comment, and refuse others.

    Parameters
    ----------
    text : str
        Such as the name of an axis.
    what : str
        For the message.

    Returns
    -------
    str
        It, unchanged.

    Raises
    ------
    TableError
        If it holds other than printable ASCII, or what would end a comment.
    """
    if not (text.isascii() and text.isprintable()) or "*" in text:
        raise TableError(
            f"{what} {text!r} cannot stand in a controller's file: use plain letters and digits"
        )
    return text


def ascii_lines(data: bytes, path: Path, what: str) -> list[str]:
    """Return the lines of a file.

    Parameters
    ----------
    data : bytes
        Content.
    path : Path
        For the message.
    what : str
        What the file should be, for the message.

    Returns
    -------
    list of str
        Without line ends.

    Raises
    ------
    CorruptFileError
        If it is not ASCII text.
    """
    try:
        return data.decode("ascii").splitlines()
    except UnicodeDecodeError as exc:
        raise CorruptFileError(
            path, "not ASCII text", offset=exc.start, hint=f"this is no {what}"
        ) from None


def facts_of(comments: Sequence[str]) -> dict[str, str]:
    """Return the facts of comment lines.

    Parameters
    ----------
    comments : sequence of str
        Without their marks.

    Returns
    -------
    dict
        Value by name, as text.
    """
    found = (_FACT.fullmatch(c.strip()) for c in comments)
    return {m[1]: m[2].strip() for m in found if m is not None}


def resolved(
    given: Mapping[str, Any],
    facts: Mapping[str, str],
    path: Path,
    known: Sequence[Option],
    told: Sequence[str] = (),
) -> dict[str, Any]:
    """Return every option of a dialect: of the user, else of the file, its sidecar, its default.

    Parameters
    ----------
    given : mapping
        Options of the user.
    facts : mapping
        Of the file's comments.
    path : Path
        The file.
    known : sequence of Option
        Of the dialect.
    told : sequence of str, optional
        Names of options whose default is good for writing, but never assumed in reading.

    Returns
    -------
    dict
        By name.

    Raises
    ------
    CorruptFileError
        If a fact is no such value.
    DataError
        If a required one, or one that must be told, is told nowhere.
    """
    beside = sidecar_options(path, tuple(known))
    found: dict[str, Any] = {}
    for option in known:
        value = given.get(option.name)
        if value is None and option.name in facts:
            try:
                value = option.checked(facts[option.name], path.name)
            except DataError:
                raise CorruptFileError(
                    path,
                    "a comment states no such value",
                    field=option.name,
                    expected=option.help,
                    found=facts[option.name][:60],
                ) from None
        if value is None:
            value = beside.get(option.name, None if option.name in told else option.default)
        if value is None and (option.required or option.name in told):
            raise DataError(
                f"{path}: neither the file nor a sidecar tells {option.name} ({option.help}); give "
                f"{option.name}= as a keyword, or --set {option.name}=... on the command line"
            )
        found[option.name] = value
    return found


def one_way(function: Any, n_places: int = 1) -> Simulator:
    """Return a lookup that is the same in both directions of motion.

    Parameters
    ----------
    function : callable
        Of one or two arrays in m.
    n_places : int, optional
        How many it takes.

    Returns
    -------
    callable
        ``(position, direction=1)`` or ``(x, y, direction=1)``; arguments are broadcast. It raises
        DataError if the direction is neither 1 nor -1.
    """

    def looked_up(places: tuple[ArrayLike, ...], direction: ArrayLike) -> FloatArray:
        arrays = np.broadcast_arrays(
            *(np.asarray(p, dtype=np.float64) for p in places), np.asarray(direction)
        )
        if not np.isin(arrays[-1], (-1, 1)).all():
            raise DataError("direction is +1 or -1")
        return np.asarray(function(*arrays[:-1]))

    def along(position: ArrayLike, direction: ArrayLike = 1) -> FloatArray:
        return looked_up((position,), direction)

    def over(x: ArrayLike, y: ArrayLike, direction: ArrayLike = 1) -> FloatArray:
        return looked_up((x, y), direction)

    return along if n_places == 1 else over
