"""What every controller's dialect provides: writer, reader, simulator, limits and its sign.

A dialect states what one entry of its file is, as a function of the error e = actual - nominal,
because half the controllers take +e and half -e. Bytes are built, parsed back and dry-run before a
file appears; the sidecar JSON beside the file carries what the file itself cannot.
"""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from metrosep.compensation.limits import Limits
from metrosep.compensation.table import CompensationTable
from metrosep.core.errors import CorruptFileError, ReadError

__all__ = [
    "Dialect",
    "DialectInfo",
    "Encoded",
    "Simulator",
    "identity",
    "load_bytes",
    "load_sidecar",
    "sidecar_path",
]

FloatArray = NDArray[np.float64]
Simulator = Callable[..., FloatArray]


@dataclass(frozen=True, slots=True)
class DialectInfo:
    """Facts about a dialect, for lists and sidecars.

    Parameters
    ----------
    id, title : str
        Name in commands; name for people.
    entry : str
        What one entry is, for error e at position p.
    units : str
        Units in the file.
    max_points : int or None
        Most entries.
    outside : str
        What the controller does outside the table.
    sign_status : str
        How the sign was confirmed.
    activation : tuple of str
        Steps to load the file.
    """

    id: str
    title: str
    entry: str
    units: str
    max_points: int | None
    outside: str
    sign_status: str
    activation: tuple[str, ...] = ()


@dataclass(frozen=True, slots=True)
class Encoded:
    """A file ready to be written.

    Parameters
    ----------
    data : bytes
        Its content.
    quantisation : float, m
        Largest rounding of an entry.
    notes : dict
        More for the sidecar.
    """

    data: bytes
    quantisation: float
    notes: dict[str, Any] = field(default_factory=dict)


class Dialect(Protocol):
    """A controller's table format."""

    info: DialectInfo

    def encode(self, table: CompensationTable, **machine: Any) -> Encoded:
        """Return the bytes of the file for a table."""

    def decode(self, data: bytes, path: Path) -> CompensationTable:
        """Return the table that the bytes hold; strict."""

    def limits(self, **machine: Any) -> Limits:
        """Return the limits of controller and machine."""


def sidecar_path(path: Path) -> Path:
    """Return where the sidecar of a table lies: the same name with ``.json`` after it.

    Parameters
    ----------
    path : Path
        The table.

    Returns
    -------
    Path
        The sidecar.
    """
    return path.with_name(path.name + ".json")


def load_bytes(path: Path, *, max_bytes: int = 50_000_000) -> bytes:
    """Return the content of a table file.

    Parameters
    ----------
    path : Path
        The file.
    max_bytes : int, optional
        Larger files are refused.

    Returns
    -------
    bytes
        Content.

    Raises
    ------
    ReadError
        If it is missing, a folder, not readable, empty or too large.
    """
    try:
        if path.is_dir():
            raise ReadError(f"{path}: is a folder, a table file is needed")
        size = path.stat().st_size
        if size > max_bytes:
            raise ReadError(f"{path}: {size} bytes is too large for a compensation table")
        data = path.read_bytes()
    except OSError as exc:
        raise ReadError(
            f"{path}: cannot be read ({exc.strerror or exc}); check the name and the permissions"
        ) from None
    if not data.strip():
        raise ReadError(f"{path}: the file is empty; write the table again")
    return data


def load_sidecar(path: Path) -> dict[str, Any]:
    """Return the sidecar of a table, empty if there is none.

    Parameters
    ----------
    path : Path
        The table.

    Returns
    -------
    dict
        Content of the JSON file beside it.

    Raises
    ------
    CorruptFileError
        If the sidecar is not a JSON object.
    """
    beside = sidecar_path(path)
    if not beside.is_file():
        return {}
    try:
        content = json.loads(beside.read_text(encoding="utf-8"))
    except (OSError, ValueError) as exc:
        raise CorruptFileError(beside, f"the sidecar cannot be read ({exc})") from None
    if not isinstance(content, dict):
        raise CorruptFileError(beside, "the sidecar is not a JSON object")
    return content


def identity(path: Path, *, first: float) -> dict[str, Any]:
    """Return what a table's file cannot hold: axes, reference, what is not in it.

    Parameters
    ----------
    path : Path
        The table.
    first : float, m
        Its first position, the reference where there is no sidecar.

    Returns
    -------
    dict
        Fields of `CompensationTable`.

    Raises
    ------
    CorruptFileError
        If there is a sidecar that is not one of metrosep.
    """
    beside = load_sidecar(path)
    table = beside.get("table", {})
    if not isinstance(table, dict):
        raise _not_ours(path, "table", "an object", table)
    axis = table.get("axis", "X")
    reference = table.get("reference_m", first)
    if not isinstance(axis, str):
        raise _not_ours(path, "axis", "a name", axis)
    if isinstance(reference, bool) or not isinstance(reference, int | float):
        raise _not_ours(path, "reference_m", "a number", reference)
    return {
        "axis": axis,
        "compensates": str(table.get("compensates", axis)),
        "reference": float(reference),
        "removed": "line" if table.get("not_in_table") == "line" else "offset",
    }


def _not_ours(path: Path, field: str, expected: str, found: object) -> CorruptFileError:
    return CorruptFileError(
        sidecar_path(path),
        "this is not the sidecar of a table",
        field=field,
        expected=expected,
        found=repr(found)[:40],
        hint="move it away or write the table again",
    )
