"""Write, read and simulate a controller's table; a file appears only after its dry-run."""

from __future__ import annotations

import contextlib
import hashlib
import json
import os
from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from dataclasses import asdict, replace
from pathlib import Path
from typing import Any

from metrosep._version import __version__
from metrosep.compensation.area_errors import AxisUnits
from metrosep.compensation.limits import Finding, Limits
from metrosep.compensation.map_verify import judged_map
from metrosep.compensation.maps import CompensationMap
from metrosep.compensation.measured import Folds
from metrosep.compensation.polynomial import PolynomialFit
from metrosep.compensation.table import CompensationTable
from metrosep.compensation.trial import TrialMap, TrialTable
from metrosep.compensation.verification import Unknown
from metrosep.compensation.verify import judged_table
from metrosep.controllers._grids import carry
from metrosep.controllers.active import Active, active_file, columns_beside, in_columns
from metrosep.controllers.base import (
    Dialect,
    DialectInfo,
    Encoded,
    Prepared,
    Simulator,
    columns_in,
    load_bytes,
    load_sidecar,
    refuse_existing,
    require_unchanged,
    sidecar_options,
    table_lookup,
)
from metrosep.controllers.options import checked_limits, checked_options, split_machine
from metrosep.controllers.registry import describe, find
from metrosep.controllers.safety import (
    carried_findings,
    file_findings,
    judged,
    require_read_back,
    table_findings,
    waived_names,
)
from metrosep.core.docs import described_by
from metrosep.core.errors import (
    DataError,
    MetrosepError,
    SignCheckFailedError,
    SignNotConfirmedError,
    TableError,
)
from metrosep.separation.positions.expansion import Expansion

PathLike = str | os.PathLike[str]

_TYPES = {"table": CompensationTable, "map": CompensationMap, "polynomial": PolynomialFit}
NONE = "none"
"""What `active` says where no table was active."""

_KINDS = {
    "table": "a CompensationTable (corrections over one axis)",
    "map": "a CompensationMap (corrections over two axes)",
    "polynomial": "a PolynomialFit",
}


def write(
    table: Any,
    path: PathLike,
    controller: str = "linuxcnc",
    *,
    verified_against: Any = None,
    allow_unverified: bool = False,
    overwrite: bool = False,
    sign_confirmed: bool = False,
    waive: Sequence[str] = (),
    folds: Folds | None = None,
    unknown: Unknown | None = None,
    heat: Expansion | None = None,
    active: PathLike | None = None,
    **machine: Any,
) -> Any:
    """Write a table for a controller, after a dry-run of the very bytes that are written.

    Parameters
    ----------
    table : CompensationTable, CompensationMap or PolynomialFit, or list of CompensationTable
        Corrections; which of them a controller takes is in `describe`. A `TrialTable` or
        `TrialMap` is written as what it holds, without a confirmed sign, and marked in the sidecar.
        Several tables over one axis, of different corrected axes and with the same positions, are
        the columns of one file where the controller has them (``heidenhain``); each is checked as if
        it were alone.
    path : str or path
        File to write; a sidecar ``<name>.json`` appears beside it.
    controller : str, optional
        One of `names`.
    verified_against : RunSet, Profile, Surface, ErrorEstimate or callable, optional
        Measured error for the dry-run. Without it the error that the table was made of serves,
        which proves sign, quantisation and interpolation, but not the separation; the sidecar
        says which it was. For a list of tables a list of as many.
    allow_unverified : bool, optional
        Write without a dry-run; recorded in the sidecar. The same as ``waive=("dry-run",)``.
    overwrite : bool, optional
        Replace an existing file by other bytes; the old one stays as ``<name>.1`` with its sidecar.
    sign_confirmed : bool, optional
        You tried the sign of this controller on the machine; needed where it is not documented.
    waive : sequence of str, optional
        Names of checks whose refusal you accept (`metrosep.controllers.safety.CHECKS`); recorded
        in the sidecar.
    folds, unknown, heat : optional
        As for `CompensationTable.verify`.
    active : str or path, optional
        File that was active in the controller while the readings were taken: what is written holds
        both, to be loaded instead of it. "none" says that no table was active.
    **machine
        Options of the dialect, and limits of the machine (fields of
        `metrosep.compensation.Limits`); numbers in SI, or texts with units. ``beside=`` names a file of
        this controller whose columns, of other corrected axes, the new file takes over.

    Returns
    -------
    Verification or None
        The dry-run, if there was one; of a list of tables a list of them.

    Raises
    ------
    SignCheckFailedError
        If the dry-run makes the error larger or the table is not covered by readings, or there is
        nothing to run it against and it is not waived.
    InconclusiveTableError, PointlessTableError
        If the readings do not show that the table helps, or less than 30 % of the RMS goes.
    SignNotConfirmedError
        If the controller's sign is not documented and `sign_confirmed` is not said.
    LimitError
        If a limit of controller or machine is exceeded, or another check refuses.
    TableError
        If the format cannot hold the table, or what was encoded does not read back.
    WriteError
        If the file exists, or the folder cannot be written.
    DataError
        If controller, option or limit is unknown or missing.

    Notes
    -----
    The bytes are parsed back before a file appears, the dry-run uses the controller's lookup of
    those bytes, and file and sidecar are renamed into place: nothing half-written is ever seen.
    """
    prepared = prepare(
        table,
        path,
        controller,
        verified_against=verified_against,
        sign_confirmed=sign_confirmed,
        waive=_names(waive, allow_unverified=allow_unverified),
        overwrite=overwrite,
        folds=folds,
        unknown=unknown,
        heat=heat,
        active=active,
        **machine,
    )
    prepared.write()
    return prepared.verification


def prepare(
    table: Any,
    path: PathLike,
    controller: str,
    *,
    verified_against: Any = None,
    sign_confirmed: bool = False,
    waive: Sequence[str] = (),
    overwrite: bool = False,
    folds: Folds | None = None,
    unknown: Unknown | None = None,
    heat: Expansion | None = None,
    active: PathLike | None = None,
    beside: PathLike | None = None,
    **machine: Any,
) -> Prepared:
    """Return what `write` writes, after all of its checks; nothing is written."""
    dialect = find(controller)
    dialect.require_target(Path(path))
    if isinstance(table, list | tuple):
        if active not in (None, NONE):
            raise DataError(
                "active= is for one table: add each with metrosep.compensation.combine_tables, then "
                "write them together"
            )
        against = _one_for_each(verified_against, len(table), "verified_against")
        judged_by = _one_for_each(folds, len(table), "folds")
        parts = [
            prepare(
                t, path, controller, verified_against=a, sign_confirmed=sign_confirmed, waive=waive,
                overwrite=overwrite, folds=f, unknown=unknown, heat=heat, active=active, **machine,
            )
            for t, a, f in zip(table, against, judged_by, strict=True)
        ]  # fmt: skip
        return in_columns(dialect, parts)
    trial = table if isinstance(table, TrialTable | TrialMap) else None
    table = table if trial is None else trial.table
    _require_kind(table, dialect.info)
    target = Path(path)
    others = None if beside is None else columns_beside(dialect, Path(beside), table)
    if others is not None and trial is not None:
        raise DataError("a trial is written alone: leave beside= out")
    given, limit_values = split_machine(machine, dialect.options, controller)
    options = checked_options(given, dialect.options, controller)
    _require_sign(dialect.info, sign_confirmed or trial is not None)
    waived = _names(waive, allow_unverified=False)
    axes = (getattr(table, "axis", "X"), getattr(table, "compensates", "X"))
    limit_values = checked_limits(limit_values, controller, axes)
    limits = dialect.limits(**limit_values)
    was = None if active in (None, NONE) else active_file(active, table, controller, options)
    if was is not None and trial is None:
        was.require_temperature(table)
    increment, whole, lost = table, table if was is None else was.added(table), 0.0
    table = whole
    if others is not None:
        table, lost = others.placed(whole)
    found = [*table_findings(table, limits, dialect.info), *dialect.doubts(table, limits)]
    kept = () if others is None or target.name != others.name else others.corrects
    found += _iteration(table, target, kept) if overwrite and active is None else []
    judged(found, waived)
    encoded = dialect.encode(table, **options)
    encoded = replace(encoded, resampling_error=encoded.resampling_error + lost)
    written = table if encoded.carried is None else encoded.carried
    found += _of_what_is_written(written, table, limits, dialect.info, found)
    cut = others is not None and others.nearly_holds(whole)
    found += carried_findings(written, table if cut else whole, limits, dialect.info)
    findings = judged([*found, *file_findings(table, encoded)], waived)
    known = {o.name: options[o.name] for o in dialect.options if options[o.name] is not None}
    known |= encoded.options
    nowhere = Path(os.devnull)
    parsed = dialect.decode(encoded.data, nowhere, **known)
    require_read_back(written, parsed, encoded)
    verification = None
    if encoded.verification is None and not (verified_against is None and "dry-run" in waived):
        acts = dialect.lookup(encoded.data, nowhere, **known)
        lookup = acts if was is None else was.increment(acts)
        of = lookup_of_folds(dialect, options, was, None if others is None else table.positions)
        with _of_a_part(encoded):
            verification = _verification(
                increment, lookup, verified_against, target, waived,
                of=of, folds=folds, unknown=unknown, heat=heat,
                travel=(limits.travel_low, limits.travel_high),
                free_zero="at_reference_m" in encoded.notes,
            )  # fmt: skip
        waived = tuple(w for w in waived if w != "dry-run")
        findings = (
            *findings,
            *getattr(verification, "findings", ()),
            *(Finding.error(r.text, "", r.check) for r in getattr(verification, "reasons", ())),
        )
    held = heat or getattr(increment, "heat", None)
    told = {} if was is None else was.described(verified_against, held)
    if was is not None:
        findings = (*findings, was.finding(told, is_trial=trial is not None))
        told["increment"] = increment.to_dict()
    sidecar = {
        "schema": "metrosep.table/1",
        "metrosep": __version__,
        "controller": controller,
        "options": {k: v for k, v in known.items() if _is_plain(v)},
        "limits": {k: v for k, v in limit_values.items() if _is_plain(v)},
        "entry": dialect.info.entry,
        "units": dialect.info.units,
        "outside": dialect.info.outside,
        "sign_status": dialect.info.sign_status,
        "sign_confirmed_by_user": bool(sign_confirmed),
        "trial": trial
        and {
            "note": "TRIAL: one bump that tells the sign; it corrects nothing and is not for cutting",
            **{k: getattr(trial, k) for k in ("instruction", "if_right", "if_wrong")},
        },
        "activation": list(dialect.info.activation),
        "file_sha256": hashlib.sha256(encoded.data).hexdigest(),
        "quantisation_m": encoded.quantisation,
        "entry_step_m": encoded.step,
        "resampling_error_m": encoded.resampling_error,
        "findings": [_described_finding(f, waived) for f in findings],
        "waived": list(waived),
        "active": NONE if active == NONE else told or None,
        "verification": encoded.verification
        or _described(verification, own=verified_against is None),
        "table": table.to_dict(),
        **encoded.notes,
    }
    named = AxisUnits.of(table).named(sidecar)
    text = json.dumps(named, indent=1, sort_keys=True, allow_nan=False, default=str)
    sidecar_bytes = (text + "\n").encode("utf-8")
    ready = Prepared(target, encoded.data, sidecar_bytes, verification, overwrite)
    return ready if others is None else others.joined(dialect, ready)


def dry_run_bytes(
    table: Any,
    controller: str,
    against: Any,
    *,
    folds: Folds | None = None,
    active: PathLike | None = None,
    beside: PathLike | None = None,
    **machine: Any,
) -> tuple[Any, Simulator, Any]:
    """Return what bytes that no file may hold would be: the table, its lookup, and the dry-run."""
    dialect = find(controller)
    given, limits = split_machine(machine, dialect.options, controller)
    options = checked_options(given, dialect.options, controller)
    was = None if active in (None, NONE) else active_file(active, table, controller, options)
    whole, positions = table if was is None else was.added(table), None
    if beside is not None:
        whole, _ = columns_beside(dialect, Path(beside), table).placed(whole)
        positions = whole.positions
    encoded = dialect.encode(whole, **options)
    known = {k: v for k, v in options.items() if v is not None} | encoded.options
    nowhere = Path(os.devnull)
    acts = dialect.lookup(encoded.data, nowhere, **known)
    axes = (getattr(table, "axis", "X"), getattr(table, "compensates", "X"))
    stated = checked_limits(limits, controller, axes)
    found = dry_run_carried(
        table,
        acts if was is None else was.increment(acts),
        against,
        of=lookup_of_folds(dialect, options, was, positions),
        folds=folds,
        travel=(stated.get("travel_low"), stated.get("travel_high")),
    )
    return dialect.decode(encoded.data, nowhere, **known), acts, found


def lookup_of_folds(
    dialect: Dialect, options: Mapping[str, Any], was: Active | None, positions: Any = None
) -> Callable[[Any], Simulator]:
    """Return what the controller does with a table made without some of the runs, as a function of it.

    With a file that was active: what the new one changes then. `positions` are those of a file that the
    table is put into.
    """

    def of(made: Any) -> Simulator:
        made = made if was is None else was.added(made)
        made = made if positions is None else carry(made, positions).table
        data = dialect.encode(made, **options)
        more = {k: v for k, v in options.items() if v is not None} | data.options
        then = dialect.lookup(data.data, Path(os.devnull), **more)
        return then if was is None else was.increment(then)

    return of


def refuse_other(target: Path, controller: str, sources: Collection[str] | None = None) -> None:
    """Refuse a target that is not the table of this controller and version, made of these sources.

    Such a file cannot have the bytes that will be made, so nothing needs to be computed to know it.
    """
    try:
        beside = load_sidecar(target) if target.is_file() else {}
        same = (beside.get("schema"), beside.get("metrosep"), beside.get("controller")) == (
            "metrosep.table/1", __version__, controller,
        )  # fmt: skip
        same = same and beside["file_sha256"] == hashlib.sha256(load_bytes(target)).hexdigest()
        if same and sources is not None:
            same = set(beside["table"]["source_sha256"]) <= set(sources)
    except (MetrosepError, OSError, KeyError, TypeError):  # damaged, or of another program
        same = False
    if not same:
        refuse_existing(target)


def _one_for_each(given: Any, n: int, name: str) -> list[Any]:
    """Return a list of as many as there are tables."""
    if given is None:
        return [None] * n
    if not isinstance(given, list | tuple) or len(given) != n:
        raise DataError(f"{name}= must be a list of {n}, one for each table")
    return list(given)


def _names(waive: Sequence[str], *, allow_unverified: bool) -> tuple[str, ...]:
    return tuple(
        dict.fromkeys((*waived_names(waive), *(("dry-run",) if allow_unverified else ())))
    )


def _is_plain(value: object) -> bool:
    return isinstance(value, str | int | float | bool)


def _described_finding(finding: Finding, waived: Sequence[str]) -> dict[str, Any]:
    said = asdict(finding)
    del said["hint"]  # for who makes the table, not for who reads the file
    return {**said, **({"waived": True} if finding.check in waived else {})}


def _described(verification: Any, *, own: bool) -> dict[str, Any] | str:
    if verification is None:
        return "waived by the user"
    against = "the error the table was made of; no measured runs were given" if own else "measured"
    return {**verification.to_dict(), "against": against}


@contextlib.contextmanager
def _of_a_part(encoded: Encoded) -> Iterator[None]:
    """Let a refused dry-run of one of two files that act together name the other one."""
    try:
        yield
    except MetrosepError as exc:
        lacking = [
            f"{f.problem}: {f.fix}" for f in encoded.findings if f.check == "comp" and f.fix
        ]
        exc.args = ("; ".join([str(exc), *lacking]), *exc.args[1:])
        raise


def _require_kind(carried: Any, info: DialectInfo) -> None:
    if not isinstance(carried, _TYPES[info.carries]):
        others = (
            ", ".join(d.id for d in describe() if isinstance(carried, _TYPES[d.carries])) or "none"
        )
        raise TableError(
            f"{info.id} holds {_KINDS[info.carries]}, not {type(carried).__name__}; controllers that "
            f"hold that: {others}"
        )


def _require_sign(info: DialectInfo, confirmed: bool) -> None:
    if info.sign == "unconfirmed" and not confirmed:
        raise SignNotConfirmedError(
            f"the sign of {info.id} ({info.title}) is not known from its documents: {info.sign_status}; "
            "write a trial with one bump ('metrosep table' with --trial; in Python trial_table or trial_map "
            "of metrosep.compensation), see on the machine which way it moves, then say sign_confirmed=True"
        )


def _of_what_is_written(
    written: Any, table: Any, limits: Limits, info: DialectInfo, found: Sequence[Finding]
) -> list[Finding]:
    """Return what is wrong with what the file holds, where it is not the table itself."""
    if written is table:
        return []
    known = {(f.check, f.problem) for f in found}
    return [f for f in table_findings(written, limits, info) if (f.check, f.problem) not in known]


def _iteration(carried: Any, target: Path, kept: Collection[str] = ()) -> list[Finding]:
    """Refuse to replace a table by one made of other readings, perhaps taken with it active.

    The columns of `kept` axes stay in the new file.
    """
    if not target.is_file():
        return []
    beside, way = (
        load_sidecar(target),
        f"say active={str(target)!r}, or active={NONE!r} if no table was",
    )
    held = [beside, *columns_in(beside).values()]
    if beside.get("file_sha256") != hashlib.sha256(target.read_bytes()).hexdigest():
        return [
            Finding.warning(
                f"{target} was not written by metrosep or was changed since, and a machine may be using it: "
                "if it was active while the readings were taken, the new table is what is left and must be "
                "added to it",
                way,
                "active",
            )
        ]
    if not hasattr(carried, "source_sha256"):
        return []
    tables = [b["table"] for b in held if isinstance(b, dict) and isinstance(b.get("table"), dict)]
    tables = [t for t in tables if t.get("compensates") not in kept]
    sources = {h for t in tables for h in t.get("source_sha256", ())}
    if not sources or not carried.source_sha256 or sources <= set(carried.source_sha256):
        return []
    if any(step.name == "combine" for step in carried.history):
        return []
    return [
        Finding.error(
            f"{target} holds a table made of other readings: if it was active while these were "
            "taken, the new table is what is left and must be added to it, not replace it",
            way,
            "active",
        )
    ]


def _verification(
    table: Any, lookup: Simulator, against: Any, target: Path, waived: Sequence[str], **more: Any
) -> Any:
    measured = getattr(table, "source", None) if against is None else against
    if measured is None:
        raise SignCheckFailedError(
            f"{target}: nothing to dry-run the table against, so its sign is not proven; give "
            "verified_against= the measured runs (or waive it with allow_unverified)"
        )
    result = dry_run_carried(table, lookup, measured, **more)
    result.require(str(target), waived=waived)
    return result


def dry_run_carried(
    carried: Any,
    lookup: Simulator,
    measured: Any,
    *,
    of: Callable[[Any], Simulator] | None = None,
    folds: Folds | None = None,
    unknown: Unknown | None = None,
    travel: tuple[float | None, float | None] = (None, None),
    free_zero: bool = False,
    heat: Expansion | None = None,
) -> Any:
    """Return the dry-run of what a file carries, through the controller's lookup.

    Parameters
    ----------
    carried : CompensationTable, CompensationMap or PolynomialFit
        What the file holds.
    lookup : callable
        Of `simulate`.
    measured : RunSet, Profile, Surface, estimate or callable
        Measured error.
    of : callable, optional
        Returns the controller's lookup of a table made without some of the runs; what that table
        holds itself if omitted.
    folds, unknown, travel, heat : optional
        As for `CompensationTable.verify`.
    free_zero : bool, optional
        Whether the file cannot be zero at the reference of a map (a product of two tables), so that
        what it adds there is reported and not counted.

    Returns
    -------
    Verification or MapVerification
        Grade, and before, after and with the sign reversed.

    Raises
    ------
    TableError
        If file and measurement do not overlap.
    DataError
        If nothing was measured there.
    """
    if isinstance(carried, CompensationMap):
        return judged_map(carried, measured, applied=lookup, free_zero=free_zero)
    return judged_table(
        carried,
        of or table_lookup,
        measured,
        applied=lookup,
        folds=folds,
        unknown=unknown,
        travel=travel,
        heat=heat,
    )


def read(path: PathLike, controller: str = "linuxcnc", **options: Any) -> Any:
    """Return the table that a controller's file holds.

    Parameters
    ----------
    path : str or path
        The file.
    controller : str, optional
        One of `names`.
    **options
        Options of the dialect that neither the file nor its sidecar tells.

    Returns
    -------
    CompensationTable, CompensationMap or PolynomialFit
        Corrections c that are added to the command; axis and reference from the sidecar where
        there is one.

    Raises
    ------
    ReadError
        If the file cannot be read or is damaged, or its sidecar describes another file.
    DataError
        If controller or option is unknown, or one is needed that nothing states.
    LimitError
        If it has more entries than the controller takes.
    """
    dialect, data, given = _opened(path, controller, options)
    return dialect.decode(data, Path(path), **given)


@described_by(read)
def simulate(path: PathLike, controller: str = "linuxcnc", **options: Any) -> Simulator:
    """Return the controller's lookup of a file, as a function.

    Returns
    -------
    callable
        ``(position, direction=1) -> correction`` in m, of a map ``(x, y, direction=1)``; arrays
        in, arrays out; what the controller adds to the command at that position, moving in that
        direction, with its own roll-over, end values and rounding.
    """
    dialect, data, given = _opened(path, controller, options)
    return dialect.lookup(data, Path(path), **given)


def _opened(
    path: PathLike, controller: str, options: dict[str, Any]
) -> tuple[Dialect, bytes, dict[str, Any]]:
    dialect = find(controller)
    given = checked_options(options, dialect.options, controller, partial=True)
    target = Path(path)
    data = load_bytes(target)
    require_unchanged(target, data)
    return dialect, data, {**sidecar_options(target, dialect.options), **given}
