"""What every controller's dialect provides: writer, reader, simulator, limits and its sign.

A dialect states what one entry of its file is, as a function of the error e = actual - nominal,
because half the controllers take +e and half -e. Bytes are built, parsed back and dry-run before a
file appears; the sidecar JSON beside the file carries what the file itself cannot.
"""

from __future__ import annotations

import hashlib
import json
from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, ClassVar, Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray

from metrosep.compensation.limits import Finding, Limits
from metrosep.controllers.options import Option
from metrosep.core._arrays import FloatArray
from metrosep.core.errors import CorruptFileError, DataError, ReadError

__all__ = [
    "Dialect",
    "DialectInfo",
    "Encoded",
    "Simulator",
    "identity",
    "load_bytes",
    "load_sidecar",
    "looked_up",
    "one_way",
    "require_unchanged",
    "sidecar_options",
    "sidecar_path",
    "table_lookup",
]

_FARTHEST = 1e6
"""No axis is as long, in m."""

Sign = Literal["confirmed", "documented", "stated", "unconfirmed"]
"""Run on the real controller or by definition; read in its documents; the user states the polarity;
not known: to be tried on the machine."""


@dataclass(frozen=True, slots=True)
class DialectInfo:
    """Facts about a dialect, for lists, pages and sidecars.

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
    sign : {"confirmed", "documented", "stated", "unconfirmed"}, optional
        The same in one word; an unconfirmed one is not written unless the user has tried it.
    carries : {"table", "map", "polynomial"}, optional
        What the file holds: corrections over one axis, over two, or coefficients.
    spacing : {"free", "uniform"}, optional
        Of the entries.
    directions : {"one", "two"}, optional
        Whether forward and reverse may differ in one file.
    resolution : str, optional
        Smallest step of an entry.
    reference_rule : str, optional
        Where the entry must be zero.
    proof : str, optional
        What the dialect was verified by.
    suffix : str, optional
        Usual end of the file name.
    example : mapping, optional
        Options for an example: every required one, in SI or as texts with units.
    page : str, optional
        Name of its page in the documentation's controllers folder.
    """

    id: str
    title: str
    entry: str
    units: str
    max_points: int | None
    outside: str
    sign_status: str
    activation: tuple[str, ...] = ()
    sign: Sign = "documented"
    carries: Literal["table", "map", "polynomial"] = "table"
    spacing: Literal["free", "uniform"] = "free"
    directions: Literal["one", "two"] = "two"
    resolution: str = ""
    reference_rule: str = ""
    proof: str = "own strict parser and simulated lookup"
    suffix: str = ".txt"
    example: Mapping[str, Any] = field(default_factory=dict)
    page: str = ""


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
    step : float, m, optional
        Smallest difference that two entries can have; 0 where the digits are ample.
    carried : object, optional
        What the bytes must read back as, where it is not the table itself but was resampled.
    resampling_error : float, m, optional
        Largest deviation of what is carried from the table, between the entries too.
    findings : tuple of Finding, optional
        What is doubtful about it.
    options : dict, optional
        Options that the writer chose itself, to be read back with.
    verification : dict or None, optional
        Dry-run that the dialect has judged itself, where the general one does not apply.
    """

    data: bytes
    quantisation: float
    notes: dict[str, Any] = field(default_factory=dict)
    step: float = 0.0
    carried: Any = None
    resampling_error: float = 0.0
    findings: tuple[Finding, ...] = ()
    options: dict[str, Any] = field(default_factory=dict)
    verification: dict[str, Any] | None = None


class Dialect(ABC):
    """A controller's table format: facts, options, writer, reader and simulator.

    `encode` gets every declared option, checked, as keywords. `decode` and `lookup` get those the
    user gave; what is missing is looked for in the file (comments) and in its sidecar
    (`sidecar_options`), else refused.
    """

    info: ClassVar[DialectInfo]
    options: ClassVar[tuple[Option, ...]] = ()

    @abstractmethod
    def encode(self, table: Any, **options: Any) -> Encoded:
        """Return the bytes of the file for a table, map or polynomial.

        Parameters
        ----------
        table : CompensationTable, CompensationMap or PolynomialFit
            As `info.carries` says.
        **options
            Every declared option, checked.

        Returns
        -------
        Encoded
            Bytes and what they cost.
        """

    @abstractmethod
    def decode(self, data: bytes, path: Path, **options: Any) -> Any:
        """Return what the bytes hold; strict.

        Parameters
        ----------
        data : bytes
            Content of the file.
        path : Path
            Its name, for messages and the sidecar.
        **options
            Declared options that the user gave.

        Returns
        -------
        CompensationTable, CompensationMap or PolynomialFit
            Corrections c = -e that are added to the command.
        """

    def lookup(self, data: bytes, path: Path, **options: Any) -> Simulator:
        """Return what the controller adds to the command, as a function.

        Parameters
        ----------
        data : bytes
            Content of the file.
        path : Path
            Its name, for messages and the sidecar.
        **options
            Declared options that the user gave.

        Returns
        -------
        callable
            ``(position, direction=1)``, or ``(x, y, direction=1)`` of a map, to the correction in
            m; here linear between the entries and constant outside.
        """
        return table_lookup(self.decode(data, path, **options))

    def limits(self, **machine: Any) -> Limits:
        """Return the limits of controller and machine.

        Parameters
        ----------
        **machine
            Fields of `metrosep.compensation.limits.Limits`.

        Returns
        -------
        Limits
            With the controller's number of points.

        Raises
        ------
        DataError
            If a keyword is unknown.
        """
        try:
            return Limits(**{"max_points": self.info.max_points, **machine})
        except TypeError as exc:
            raise DataError(f"unknown machine limit: {exc}") from None


def table_lookup(table: Any) -> Simulator:
    """Return a lookup that is linear between entries and constant outside.

    Parameters
    ----------
    table : CompensationTable or CompensationMap
        Anything with ``correction(position, direction)`` or ``correction(x, y, direction)``.

    Returns
    -------
    callable
        ``(position, direction=1)`` or ``(x, y, direction=1)`` to the correction in m; arguments
        are broadcast. It raises DataError if the direction is neither 1 nor -1.
    """

    def along(position: ArrayLike, direction: ArrayLike = 1) -> FloatArray:
        return _both_ways(table, (position,), direction)

    def over(x: ArrayLike, y: ArrayLike, direction: ArrayLike = 1) -> FloatArray:
        return _both_ways(table, (x, y), direction)

    return over if hasattr(table, "values") else along


def _both_ways(table: Any, places: tuple[ArrayLike, ...], direction: ArrayLike) -> FloatArray:
    arrays, d = looked_up(places, direction)
    flat = [a.ravel() for a in arrays]
    forward = np.asarray(table.correction(*flat, 1)).reshape(d.shape)
    if (d > 0).all():
        return forward
    reverse = np.asarray(table.correction(*flat, -1)).reshape(d.shape)
    return np.asarray(np.where(d > 0, forward, reverse))


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
        text = load_bytes(beside).decode("utf-8")
        content = json.loads(text, parse_constant=_no_constant)
    except (OSError, ValueError, RecursionError) as exc:
        raise CorruptFileError(
            beside,
            f"the sidecar cannot be read ({exc})",
            hint="move it away, or write the table again",
        ) from None
    if not isinstance(content, dict):
        raise CorruptFileError(
            beside,
            "the sidecar is not a JSON object",
            hint="move it away, or write the table again",
        )
    return content


def _no_constant(name: str) -> float:
    raise ValueError(f"{name} is no number")


def sidecar_options(path: Path, known: tuple[Option, ...]) -> dict[str, Any]:
    """Return the options a file was written with, as its sidecar states them.

    Parameters
    ----------
    path : Path
        The table.
    known : tuple of Option
        Of the dialect; others are not returned.

    Returns
    -------
    dict
        By name, checked; empty if there is no sidecar.

    Raises
    ------
    CorruptFileError
        If there is a sidecar that is not one of metrosep.
    """
    stored = load_sidecar(path).get("options", {})
    if not isinstance(stored, dict):
        raise _not_ours(path, "options", "an object", stored)
    found = {}
    for option in known:
        if stored.get(option.name) is not None:
            try:
                found[option.name] = option.checked(stored[option.name], path.name)
            except DataError:
                raise _not_ours(path, option.name, option.help, stored[option.name]) from None
    return found


def require_unchanged(path: Path, data: bytes) -> None:
    """Refuse a file that is not the one its sidecar describes.

    Parameters
    ----------
    path : Path
        The table.
    data : bytes
        Its content.

    Raises
    ------
    CorruptFileError
        If the hash in the sidecar is another: the file was cut short, edited or mixed up.
    """
    wanted = load_sidecar(path).get("file_sha256")
    found = hashlib.sha256(data).hexdigest()
    if wanted is not None and found != wanted:
        raise CorruptFileError(
            path,
            "it is not the table that its sidecar describes: it was cut short, edited or mixed up",
            field="SHA-256",
            expected=str(wanted)[:16],
            found=found[:16],
            hint="write the table again; to judge the file as it is, move its sidecar away",
        )


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
    if (
        isinstance(reference, bool)
        or not isinstance(reference, int | float)
        or not abs(reference) < _FARTHEST
    ):
        raise _not_ours(path, "reference_m", "a position in m", reference)
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


# ---- what every simulated look-up starts with: places and directions of one shape, checked -----

Simulator = Callable[..., FloatArray]


def looked_up(
    places: tuple[ArrayLike, ...], direction: ArrayLike
) -> tuple[tuple[FloatArray, ...], NDArray[Any]]:
    """Return places and directions, broadcast."""
    arrays = np.broadcast_arrays(
        *(np.asarray(p, dtype=np.float64) for p in places), np.asarray(direction)
    )
    if not np.isin(arrays[-1], (-1, 1)).all():
        raise DataError("direction is +1 or -1")
    return tuple(arrays[:-1]), arrays[-1]


def one_way(function: Any, n_places: int = 1) -> Simulator:
    """Return a lookup that is the same in both directions of motion."""

    def along(position: ArrayLike, direction: ArrayLike = 1) -> FloatArray:
        return np.asarray(function(*looked_up((position,), direction)[0]))

    def over(x: ArrayLike, y: ArrayLike, direction: ArrayLike = 1) -> FloatArray:
        return np.asarray(function(*looked_up((x, y), direction)[0]))

    return along if n_places == 1 else over
