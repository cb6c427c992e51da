"""What every controller's dialect provides: writer, reader, simulator, limits and its sign.

A dialect states what one entry of its file is, as a function of the error e = actual - nominal,
because half the controllers take +e and half -e. Bytes are built, parsed back and dry-run before a
file appears; the sidecar JSON beside the file carries what the file itself cannot.
"""

from __future__ import annotations

import contextlib
import filecmp
import glob
import hashlib
import json
import os
import shutil
from abc import ABC, abstractmethod
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, field
from itertools import count
from pathlib import Path
from typing import Any, BinaryIO, ClassVar, Literal, cast

import numpy as np
from numpy.typing import ArrayLike, NDArray

from metrosep.compensation.area_errors import is_rotary, numbers_of
from metrosep.compensation.limits import Finding, Limits
from metrosep.controllers.options import Option
from metrosep.core._arrays import FloatArray
from metrosep.core.atomic import atomic_stream, atomic_write, require_plain
from metrosep.core.errors import (
    CorruptFileError,
    DataError,
    FileAccessError,
    FileMissingError,
    ReadError,
    TableError,
    WriteError,
)

ALONE = "alone"
"""Check of a finding that holds only where a table is the only one in its file."""

_FARTHEST = 1e6
"""No axis is as long, in m."""

Sign = Literal["confirmed", "documented", "stated", "unconfirmed"]
"""Run on the real controller or by definition; read in its documents; the user states the polarity;
not known: to be tried on the machine."""


@dataclass(frozen=True, slots=True, kw_only=True)
class DialectInfo:
    """Facts about a dialect, for lists, pages and sidecars."""

    id: str  # name in commands
    title: str  # name for people
    entry: str  # what one entry is, for error e at position p
    units: str  # in the file
    max_points: int | None = None  # most entries
    outside: str  # what the controller does outside the table
    sign_status: str  # how the sign was confirmed
    activation: tuple[str, ...] = ()  # steps to load the file
    # the sign status in one word; an unconfirmed one is not written unless the user has tried it
    sign: Sign = "documented"
    # what the file holds: corrections over one axis, over two, or coefficients
    carries: Literal["table", "map", "polynomial"] = "table"
    spacing: Literal["free", "uniform"] = "free"  # of the entries
    directions: Literal["one", "two"] = "two"  # whether they may differ in one file
    resolution: str = ""  # smallest step of an entry
    reference_rule: str = ""  # where the entry must be zero
    proof: str = "own strict parser and simulated lookup"  # what the dialect was verified by
    suffix: str = ".txt"  # usual end of the file name
    # options for an example: every required one, in SI or as texts with units
    example: Mapping[str, Any] = field(default_factory=dict)
    page: str = ""  # name of its page in the documentation's controllers folder


@dataclass(frozen=True, slots=True)
class Encoded:
    """A file ready to be written."""

    data: bytes
    quantisation: float  # m: largest rounding of an entry
    notes: dict[str, Any] = field(default_factory=dict)  # more for the sidecar
    step: float = 0.0  # m: smallest difference of two entries; 0 where the digits are ample
    # what the bytes must read back as, where it is not the table itself but was resampled
    carried: Any = None
    resampling_error: float = 0.0  # m: largest deviation of it, between the entries too
    findings: tuple[Finding, ...] = ()  # what is doubtful about it
    options: dict[str, Any] = field(default_factory=dict)  # that the writer chose itself
    # dry-run that the dialect has judged itself, where the general one does not apply
    verification: dict[str, Any] | None = None


class Dialect(ABC):
    """A controller's table format: facts, options, writer, reader and simulator.

    `encode` gets every declared option, checked, as keywords. `decode` and `lookup` get those the
    user gave; what is missing is looked for in the file (comments) and in its sidecar
    (`sidecar_options`), else refused.
    """

    info: ClassVar[DialectInfo]
    options: ClassVar[tuple[Option, ...]] = ()
    needs_zero: ClassVar[bool] = False
    """Whether the axis jumps by a correction at its reference, so that a file that has one is refused."""

    @abstractmethod
    def encode(self, table: Any, **options: Any) -> Encoded:
        """Return bytes and what they cost of a CompensationTable, CompensationMap or PolynomialFit."""

    def filled(self, options: Mapping[str, Any]) -> dict[str, Any]:
        """Return options, those that nobody gave with their defaults."""
        return {**{o.name: o.default for o in self.options}, **options}

    @abstractmethod
    def decode(self, data: bytes, path: Path, **options: Any) -> Any:
        """Return what the bytes hold, strict: corrections c = -e; the path is for messages and the sidecar."""

    def require_target(self, path: Path) -> None:  # noqa: B027
        """Refuse a name that a table of this controller must not have."""

    def doubts(self, table: Any, limits: Limits) -> list[Finding]:
        """Return what is wrong or uncertain about a table on this machine, besides what all are asked."""
        del table, limits
        return []

    def in_columns(self, parts: list[bytes]) -> bytes:
        """Return several tables over one axis as columns of one file."""
        raise TableError(f"{self.info.id} holds one table in a file; write {len(parts)} files")

    @property
    def has_columns(self) -> bool:
        """Whether a file holds several corrected axes over one, of which one file is active."""
        return type(self).in_columns is not Dialect.in_columns

    def columns_of(self, data: bytes, path: Path) -> dict[str, bytes]:
        """Return the columns of a file by the axis that they correct, each as a file of its own."""
        raise TableError(
            f"{path}: {self.info.id} holds one table in a file: beside= has no meaning"
        )

    def lookup(self, data: bytes, path: Path, **options: Any) -> Simulator:
        """Return what the controller adds, in m: ``(position, direction=1)``, of a map ``(x, y, direction=1)``.

        Here linear between the entries and constant outside.
        """
        return table_lookup(self.decode(data, path, **options))

    def facts(self, data: bytes, path: Path, **options: Any) -> dict[str, Any]:
        """Return what a file says of its machine; here nothing."""
        return {}

    def limits(self, **machine: Any) -> Limits:
        """Return the limits of controller and machine, of fields of `Limits`."""
        try:
            return Limits(**{"max_points": self.info.max_points, **machine})
        except TypeError as exc:
            raise DataError(f"unknown machine limit: {exc}") from None


def table_lookup(table: Any) -> Simulator:
    """Return a lookup that is linear between entries and constant outside, over one axis or two."""

    def both_ways(places: tuple[FloatArray, ...], d: NDArray[Any]) -> FloatArray:
        flat = [a.ravel() for a in places]
        forward = np.asarray(table.correction(*flat, 1)).reshape(d.shape)
        if (d > 0).all():
            return forward
        reverse = np.asarray(table.correction(*flat, -1)).reshape(d.shape)
        return np.asarray(np.where(d > 0, forward, reverse))

    return _simulator(both_ways, 2 if hasattr(table, "values") else 1)


def sidecar_path(path: Path) -> Path:
    """Return where the sidecar of a table lies: the same name with ``.json`` after it."""
    return path.with_name(path.name + ".json")


def load_bytes(path: Path, *, max_bytes: int = 50_000_000) -> bytes:
    """Return the content of a table file, refused if it is missing, empty or too large."""
    try:
        if path.is_dir():
            raise ReadError(f"{path}: is a folder, a table file is needed")
        require_plain(path)
        size = path.stat().st_size
        if size > max_bytes:
            raise ReadError(f"{path}: {size} bytes is too large for a compensation table")
        data = path.read_bytes()
    except FileNotFoundError:
        raise FileMissingError(
            f"{path}: no such file; check the name and the folder", str(path)
        ) from None
    except PermissionError:
        raise FileAccessError(
            f"{path}: you may not read this file; ask for permission", str(path)
        ) from None
    except OSError as exc:
        raise ReadError(
            f"{path}: cannot be read ({exc.strerror or exc}); check the name and the permissions"
        ) from None
    if not data.strip():
        raise ReadError(f"{path}: the file is empty; write the table again")
    return data


def load_sidecar(path: Path) -> dict[str, Any]:
    """Return the sidecar of a table, empty if there is none, refused if it is not a JSON object."""
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
    raise ValueError(f"{name} is not a number")


def sidecar_options(path: Path, known: tuple[Option, ...]) -> dict[str, Any]:
    """Return the options a file was written with, by name and checked, as its sidecar states them."""
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
    """Refuse a file that is not the one its sidecar describes: cut short, edited or mixed up."""
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


def columns_in(sidecar: Mapping[str, Any]) -> dict[str, Any]:
    """Return the parts of a sidecar of several columns by corrected axis; empty of any other."""
    columns = sidecar.get("columns")  # of a table over a plane their number
    return columns if isinstance(columns, dict) else {}


def own_part(sidecar: Mapping[str, Any], column: str | None) -> Any:
    """Return what a sidecar says of one table: of a file of several columns that of one of them."""
    columns = columns_in(sidecar)
    return columns.get(column, {}) if columns and column else sidecar


def stored_table(path: Path, column: str | None = None) -> dict[str, Any]:
    """Return the table of a sidecar, of a file of several columns that of one of them; empty if unknown."""
    beside = own_part(load_sidecar(path), column)
    table = beside.get("table", {}) if isinstance(beside, dict) else beside
    if not isinstance(table, dict):
        raise _not_ours(path, "table", "an object", table)
    return cast("dict[str, Any]", numbers_of(table))


def identity(
    path: Path, *, first: float | None = None, column: str | None = None
) -> dict[str, Any]:
    """Return what a table's file cannot hold: axes, reference (m, else `first`, if any), what is not in it."""
    table = stored_table(path, column)
    axis = table.get("axis", "X")
    reference = table.get("reference_m", first)
    if not isinstance(axis, str):
        raise _not_ours(path, "axis", "a name", axis)
    held: dict[str, Any] = {}
    if "reference_m" in table or first is not None:
        if (
            isinstance(reference, bool)
            or not isinstance(reference, int | float)
            or not abs(reference) < _FARTHEST
        ):
            raise _not_ours(path, "reference_m", "a position in m", reference)
        held["reference"] = float(reference)
    return {
        "axis": axis,
        "compensates": str(table.get("compensates", axis)),
        **held,
        "removed": "line" if table.get("not_in_table") == "line" else "offset",
    }


def map_identity(
    path: Path,
    *,
    axes: tuple[str, str],
    compensates: str,
    first: tuple[float, float],
    turns: tuple[bool, bool] | None = None,
) -> dict[str, Any]:
    """Return what a map's file cannot hold, of its sidecar, or these axes and this reference (m or rad)."""
    beside = load_sidecar(path)
    if "table" not in beside:
        return {"axes": axes, "compensates": compensates, "reference": first}
    known = beside["table"] if isinstance(beside["table"], dict) else {"axes": None}
    names, place = known.get("axes", list(axes)), known.get("reference_si", list(first))
    if not (
        isinstance(names, list)
        and isinstance(place, list)
        and len(names) == len(place) == len({str(n).strip() for n in names} - {""}) == 2
        and all(isinstance(v, int | float) and not isinstance(v, bool) for v in place)
        and all(abs(v) < _FARTHEST for v in place)
        and (turns is None or tuple(is_rotary(str(n)) for n in names) == turns)
    ):
        raise _not_ours(path, "axes, reference_si", "those of two axes", (names, place), "map")
    return {
        "axes": (str(names[0]), str(names[1])),
        "compensates": str(known.get("compensates", compensates)),
        "reference": (float(place[0]), float(place[1])),
        "removed": "plane" if known.get("not_in_map") == "plane" else "offset",
        "border": "zero" if known.get("border") == "zero" else None,
        "source_sha256": tuple(map(str, known.get("source_sha256") or ())),
    }


def nearest_zero(x: FloatArray, y: FloatArray) -> tuple[float, float]:
    """Return zero for each axis that holds it, else its first position."""
    first, second = (0.0 if p[0] <= 0.0 <= p[-1] else float(p[0]) for p in (x, y))
    return first, second


def _not_ours(
    path: Path, field: str, expected: str, found: object, what: str = "table"
) -> CorruptFileError:
    return CorruptFileError(
        sidecar_path(path),
        f"this is not the sidecar of a {what}",
        field=field,
        expected=expected,
        found=repr(found)[:40],
        hint=f"move it away or write the {what} again",
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
    return _simulator(lambda places, _: np.asarray(function(*places)), n_places)


def _simulator(function: Callable[..., FloatArray], n_places: int) -> Simulator:
    """Return a lookup over one axis or two of a function of places and directions of one shape."""

    def along(position: ArrayLike, direction: ArrayLike = 1) -> FloatArray:
        return function(*looked_up((position,), direction))

    def over(x: ArrayLike, y: ArrayLike, direction: ArrayLike = 1) -> FloatArray:
        return function(*looked_up((x, y), direction))

    return along if n_places == 1 else over


# ---- a file and its sidecar on the disk ---------------------------------------------------------
# A file and its sidecar: never replaced unasked, written both or neither, the old pair kept.


def refuse_existing(target: Path) -> None:
    """Refuse if a file or its sidecar is there already."""
    for path in (target, sidecar_path(target)):
        if _exists(path):
            raise WriteError(
                f"{path}: exists already and a machine may be using it; choose another name or say "
                "overwrite"
            )


def is_written(target: Path, data: bytes, sidecar: bytes, *, overwrite: bool) -> bool:
    """Return whether just these bytes are there; other ones are refused without `overwrite`."""
    pair = ((target, data), (sidecar_path(target), sidecar))
    if all(_exists(p) and p.is_file() and load_bytes(p) == wanted for p, wanted in pair):
        return True
    if not overwrite:
        refuse_existing(target)
    return False


def is_copy(new: Path, there: Path) -> bool:
    """Return whether a file and its sidecar are there as they are elsewhere, however large."""
    pairs = ((new, there), (sidecar_path(new), sidecar_path(there)))
    return all(p.is_file() and filecmp.cmp(n, p, shallow=False) for n, p in pairs)


def _exists(path: Path) -> bool:
    try:
        return path.exists()
    except OSError as exc:
        raise WriteError(
            f"{path}: cannot be written ({exc.strerror or exc}); choose another name or folder",
            exc,
        ) from None


def keep_old(target: Path) -> list[Path]:
    """Keep a file and its sidecar beside them as NAME.1, NAME.1.json, or the next free number."""
    pair = [p for p in (target, sidecar_path(target)) if p.is_file()]
    if not pair:
        return []
    names = (target.with_name(f"{target.name}.{k}") for k in count(1))
    name = next(n for n in names if not (_exists(n) or _exists(sidecar_path(n))))
    kept = []
    for old in pair:
        new = name if old == target else sidecar_path(name)
        try:
            try:
                os.link(old, new)
            except OSError:  # a disk without links
                shutil.copy2(old, new)
        except OSError as exc:
            raise WriteError(
                f"{new}: the old file cannot be kept there ({exc.strerror or exc}); choose another "
                "name or folder",
                exc,
            ) from None
        kept.append(new)
    return kept


def kept_files(target: Path) -> list[Path]:
    """Return the files that `keep_old` kept of a file, the first one first."""
    found = target.parent.glob(f"{glob.escape(target.name)}.*")
    return sorted((p for p in found if p.suffix[1:].isdecimal()), key=lambda p: int(p.suffix[1:]))


@contextlib.contextmanager
def paired_stream(
    end: Path, text: Callable[[Path], str], *, overwrite: bool
) -> Iterator[BinaryIO]:
    """Give a binary file to write into; file and sidecar appear together or not at all.

    The same bytes stay; others are refused, or with `overwrite` kept under another name (`keep_old`).

    Notes
    -----
    The sidecar is written first and put back if the file does not get its name. Between the two only
    a killed process can stop; the sidecar then holds the hash of another file.
    """
    beside = sidecar_path(end)
    before = load_bytes(beside) if beside.is_file() else None
    wrote = False
    kept: list[Path] = []

    def check(written: Path) -> None:
        nonlocal wrote
        said = text(written)
        same = end.is_file() and filecmp.cmp(end, written, shallow=False)
        if same and before == said.encode("utf-8"):
            return
        if not overwrite:
            refuse_existing(end)
        kept.extend(keep_old(end))
        wrote = True
        atomic_write(beside, said.encode("utf-8"))

    try:
        with atomic_stream(end, check=check) as out:
            yield out
    except BaseException:
        for file in kept:
            file.unlink(missing_ok=True)
        if wrote:
            with contextlib.suppress(WriteError, OSError):
                if before is None:
                    beside.unlink(missing_ok=True)
                else:
                    atomic_write(beside, before)
        raise


def write_pair(target: Path, data: bytes, sidecar: bytes, *, overwrite: bool) -> None:
    """Write a file and its sidecar; both appear, or what was there before stays."""
    said = sidecar.decode("utf-8")
    with paired_stream(target, lambda _written: said, overwrite=overwrite) as out:
        out.write(data)


@dataclass(frozen=True, slots=True)
class Prepared:
    """A table that passed its checks, ready to be written: bytes, sidecar and dry-run."""

    target: Path
    data: bytes
    sidecar: bytes
    verification: Any
    overwrite: bool

    def require_free(self) -> bool:
        """Return whether these bytes are there; refuse other ones that may not be replaced."""
        return is_written(self.target, self.data, self.sidecar, overwrite=self.overwrite)

    def write(self, stage: Path | None = None) -> None:
        """Write file and sidecar, into `stage` if given; replace other bytes only if that was said."""
        if self.require_free() and stage is None:
            return
        place = self.target if stage is None else stage / self.target.name
        write_pair(place, self.data, self.sidecar, overwrite=self.overwrite)
