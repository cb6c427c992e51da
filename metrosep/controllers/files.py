"""Write, read and simulate a controller's table; a file appears only after its dry-run."""

from __future__ import annotations

import contextlib
import hashlib
import json
import os
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from metrosep._version import __version__
from metrosep.compensation.table import CompensationTable
from metrosep.compensation.verify import Against, Verification, dry_run
from metrosep.controllers.base import Dialect, DialectInfo, Simulator, load_bytes, sidecar_path
from metrosep.controllers.linuxcnc import LinuxCNC
from metrosep.controllers.neutral import Neutral
from metrosep.core.atomic import atomic_write
from metrosep.core.errors import DataError, SignCheckFailedError, TableError, WriteError

__all__ = ["describe", "names", "read", "simulate", "write"]

FloatArray = NDArray[np.float64]
PathLike = str | os.PathLike[str]

_DIALECTS: dict[str, Dialect] = {d.info.id: d for d in (LinuxCNC(), Neutral())}


def names() -> tuple[str, ...]:
    """Return the names of the controllers that are supported.

    Returns
    -------
    tuple of str
        Values for ``controller=``.

    Examples
    --------
    >>> names()
    ('linuxcnc', 'csv')
    """
    return tuple(_DIALECTS)


def describe() -> tuple[DialectInfo, ...]:
    """Return what each dialect is: entry rule, units, limits, how its sign is known.

    Returns
    -------
    tuple of DialectInfo
        One for each name.
    """
    return tuple(d.info for d in _DIALECTS.values())


def _dialect(controller: str) -> Dialect:
    if controller not in _DIALECTS:
        raise DataError(
            f"unknown controller {controller!r}; there are {', '.join(map(repr, _DIALECTS))}"
        )
    return _DIALECTS[controller]


def write(
    table: CompensationTable,
    path: PathLike,
    controller: str = "linuxcnc",
    *,
    verified_against: Against | None = None,
    allow_unverified: bool = False,
    overwrite: bool = False,
    **machine: Any,
) -> Verification | None:
    """Write a table for a controller, after a dry-run of the very bytes that are written.

    Parameters
    ----------
    table : CompensationTable
        Corrections.
    path : str or path
        File to write; a sidecar ``<name>.json`` appears beside it.
    controller : str, optional
        One of `names`.
    verified_against : RunSet, Profile or ErrorEstimate, optional
        Measured error for the dry-run. Without it the error that the table was made of serves,
        which proves sign, quantisation and interpolation, but not the separation; the sidecar
        says which it was.
    allow_unverified : bool, optional
        Write without a dry-run; recorded in the sidecar.
    overwrite : bool, optional
        Replace an existing file.
    **machine
        Limits of the machine, fields of `metrosep.compensation.Limits`.

    Returns
    -------
    Verification or None
        The dry-run, if there was one.

    Raises
    ------
    SignCheckFailedError
        If the dry-run does not shrink the error, or there is nothing to run it against and it
        is not waived.
    LimitError
        If a limit of controller or machine is exceeded.
    TableError
        If the format cannot hold the table, or what was encoded does not read back.
    WriteError
        If the file exists, or the folder cannot be written.
    DataError
        If controller or limit is unknown.

    Notes
    -----
    The bytes are parsed back before a file appears, the dry-run uses the parsed table, and file
    and sidecar are renamed into place: nothing half-written is ever seen.
    """
    dialect = _dialect(controller)
    target = Path(path)
    if not overwrite:
        _refuse_existing(target)
    findings = table.require_limits(dialect.limits(**machine))
    encoded = dialect.encode(table, **machine)
    parsed = dialect.decode(encoded.data, Path(os.devnull))
    _check_read_back(table, parsed, encoded.quantisation)
    verification = _verification(table, parsed, verified_against, target, waived=allow_unverified)
    sidecar = {
        "schema": "metrosep.table/1",
        "metrosep": __version__,
        "controller": controller,
        "entry": dialect.info.entry,
        "units": dialect.info.units,
        "outside": dialect.info.outside,
        "sign_status": dialect.info.sign_status,
        "activation": list(dialect.info.activation),
        "file_sha256": hashlib.sha256(encoded.data).hexdigest(),
        "quantisation_m": encoded.quantisation,
        "findings": [{"level": f.level, "problem": f.problem, "fix": f.fix} for f in findings],
        "verification": _described(verification, own=verified_against is None),
        "table": table.to_dict(),
        **encoded.notes,
    }
    text = json.dumps(sidecar, indent=1, sort_keys=True, allow_nan=False, default=str)
    _write_pair(target, encoded.data, (text + "\n").encode("utf-8"))
    return verification


def _described(verification: Verification | None, *, own: bool) -> dict[str, Any] | str:
    if verification is None:
        return "waived by the user"
    against = "the error the table was made of; no measured runs were given" if own else "measured"
    return {**verification.to_dict(), "against": against}


def _refuse_existing(target: Path) -> None:
    for path in (target, sidecar_path(target)):
        try:
            exists = path.exists()
        except OSError as exc:
            raise WriteError(
                f"{path}: cannot be written ({exc.strerror or exc}); choose another name or folder"
            ) from None
        if exists:
            raise WriteError(
                f"{path}: exists already and a machine may be using it; choose another name or say "
                "overwrite"
            )


def _write_pair(target: Path, data: bytes, sidecar: bytes) -> None:
    """Write a table and its sidecar; if the table fails, the sidecar is what it was before."""
    beside = sidecar_path(target)
    before = load_bytes(beside) if beside.is_file() else None
    atomic_write(beside, sidecar)
    try:
        atomic_write(target, data)
    except WriteError:
        beside.unlink(missing_ok=True)
        if before is not None:
            with contextlib.suppress(WriteError):
                atomic_write(beside, before)
        raise


def _check_read_back(
    table: CompensationTable, parsed: CompensationTable, quantisation: float
) -> None:
    both = [(table.forward, parsed.forward)]
    reverse = table.forward if table.reverse is None else table.reverse
    both.append((reverse, parsed.forward if parsed.reverse is None else parsed.reverse))
    margin = quantisation + 1e-15
    for wanted, found in both:
        if wanted.shape != found.shape or float(np.abs(wanted - found).max()) > margin:
            raise TableError(
                "what was encoded does not read back as the table; this is a bug in metrosep, nothing "
                "was written"
            )


def _verification(
    table: CompensationTable,
    parsed: CompensationTable,
    against: Against | None,
    target: Path,
    *,
    waived: bool,
) -> Verification | None:
    measured = table.source if against is None else against
    if waived and against is None:
        return None
    if measured is None:
        raise SignCheckFailedError(
            f"{target}: nothing to dry-run the table against, so its sign is not proven; give "
            "verified_against= the measured runs (or waive it with allow_unverified)"
        )
    result = dry_run(
        parsed.correction,
        measured,
        span=table.span,
        on_axis=table.is_on_axis,
        removed=table.removed,
    )
    result.require(str(target))
    return result


def read(path: PathLike, controller: str = "linuxcnc") -> CompensationTable:
    """Return the table that a controller's file holds.

    Parameters
    ----------
    path : str or path
        The file.
    controller : str, optional
        One of `names`.

    Returns
    -------
    CompensationTable
        Corrections c that are added to the command; axis and reference from the sidecar where
        there is one.

    Raises
    ------
    ReadError
        If the file cannot be read or is damaged.
    DataError
        If the controller is unknown.
    LimitError
        If it has more entries than the controller takes.
    """
    dialect = _dialect(controller)
    target = Path(path)
    return dialect.decode(load_bytes(target), target)


def simulate(path: PathLike, controller: str = "linuxcnc") -> Simulator:
    """Return the controller's lookup of a file, as a function.

    Parameters
    ----------
    path : str or path
        The file.
    controller : str, optional
        One of `names`.

    Returns
    -------
    callable
        ``(position, direction=1) -> correction`` in m; arrays in, arrays out; what the controller
        adds to the command at that position, moving in that direction.

    Raises
    ------
    ReadError
        If the file cannot be read or is damaged.
    DataError
        If the controller is unknown.
    """
    table = read(path, controller)

    def lookup(position: ArrayLike, direction: int | ArrayLike = 1) -> FloatArray:
        p, d = np.broadcast_arrays(np.asarray(position, dtype=np.float64), np.asarray(direction))
        if not np.isin(d, (-1, 1)).all():
            raise DataError("direction is +1 or -1")
        forward = table.correction(p.ravel(), 1).reshape(p.shape)
        reverse = table.correction(p.ravel(), -1).reshape(p.shape)
        return np.asarray(np.where(d > 0, forward, reverse))

    return lookup
