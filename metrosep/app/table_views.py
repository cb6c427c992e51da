"""What a recipe's table would be: its very bytes, what the controller makes of them, the dry-run.

The table is written into a temporary folder by the function that a run of the recipe uses, read
back, and looked up. What is refused is shown as far as it goes, but never as a file.
"""

from __future__ import annotations

import hashlib
import json
import os
import tempfile
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from metrosep.app.controller_lists import sign_words
from metrosep.app.messages import Arrays, plain
from metrosep.app.wanted_tables import Wanted
from metrosep.compensation.table import CompensationTable
from metrosep.compensation.verify import Verification
from metrosep.controllers.base import sidecar_path
from metrosep.controllers.files import dry_run_carried, read, simulate
from metrosep.controllers.options import checked_options, split_machine
from metrosep.controllers.registry import find
from metrosep.controllers.safety import CHECKS
from metrosep.core._arrays import FloatArray
from metrosep.core.errors import (
    MetrosepError,
    SignCheckFailedError,
    SignNotConfirmedError,
    WriteError,
)
from metrosep.core.runset import RunSet
from metrosep.separation.base import ErrorEstimate

__all__ = ["TableView", "view_table"]


_MOST_LINES = 60
_LINE = 300
"""Characters of a line that are shown."""

_CURVE = 2001
"""Places at which curves are drawn, besides the entries."""

_EXPANDED = 2.0
"""Coverage factor of the uncertainties that are shown."""


@dataclass(slots=True)
class TableView:
    """What the page is shown of a table."""

    header: dict[str, Any] = field(default_factory=dict)  # plain values
    arrays: Arrays = field(default_factory=dict)  # of ndarray: curves, in m


def view_table(wanted: Wanted, estimate: ErrorEstimate, runs: RunSet) -> TableView:
    """Return everything about a table before it is written; nothing stays on the disk.

    Notes
    -----
    Of a refused table the findings and curves are those of the same bytes with every check
    waived; where even that is refused, what can be computed is shown.
    """
    view = TableView()
    view.header["sign"] = _sign(wanted)
    _add_error(view, estimate)
    try:
        carried = wanted.carried(estimate, runs)
    except MetrosepError as exc:
        view.header["refused"] = _refusal(exc, wanted, [])
        return view
    name = Path(str(wanted.output["path"])).name
    with _temporary() as folder:
        path = Path(folder) / name
        try:
            wanted.write(carried, path, runs)
        except MetrosepError as exc:
            refused = exc
        else:
            _add_file(view, path, wanted, estimate)
            _add_preview(view, path)
            return view
        _add_all_the_same(view, Path(folder) / f"waived-{name}", wanted, (estimate, carried, runs))
        said = view.header.get("findings", [])
        view.header["refused"] = _refusal(refused, wanted, said, folder)
    return view


def _temporary() -> tempfile.TemporaryDirectory[str]:
    try:
        return tempfile.TemporaryDirectory(prefix="metrosep-table-", ignore_cleanup_errors=True)
    except OSError as exc:
        raise WriteError(
            f"the table cannot be tried in a temporary folder ({exc.strerror or exc}); make room, or "
            "set TMPDIR to another folder"
        ) from None


def _sign(wanted: Wanted) -> dict[str, Any]:
    info = find(wanted.controller).info
    return {
        "status": info.sign,
        "words": sign_words(info),
        "needs_trial": info.sign == "unconfirmed",
        "confirmed": bool(wanted.output.get("sign_confirmed", False)),
        "trial_possible": info.carries == "table",
    }


# ---- what is refused -------------------------------------------------------------------------


def _refusal(
    exc: MetrosepError, wanted: Wanted, findings: list[dict[str, Any]], folder: str = ""
) -> dict[str, Any]:
    """Return why a table is refused, by which check, and what would help."""
    words = str(exc).replace(f"{folder}{os.sep}", "") if folder else str(exc)
    open_ones = [f for f in findings if f["level"] == "error" and f["check"] not in wanted.waive]
    checks = list(dict.fromkeys(f["check"] for f in open_ones))
    if isinstance(exc, SignNotConfirmedError):
        return _said(words, "sign", waivable=False, option="sign_confirmed")
    if isinstance(exc, SignCheckFailedError):
        return _said(words, "dry-run", waivable=False)
    if checks:
        waivable = all(c in CHECKS for c in checks)
        return {**_said(words, checks[0], waivable=waivable), "checks": checks}
    return _said(words, "", waivable=False)


def _said(words: str, check: str, *, waivable: bool, option: str | None = None) -> dict[str, Any]:
    checks = [check] if check else []
    return {
        "message": words,
        "check": check,
        "checks": checks,
        "waivable": waivable,
        "option": option,
    }


def _add_all_the_same(
    view: TableView, path: Path, wanted: Wanted, of: tuple[ErrorEstimate, Any, RunSet]
) -> None:
    """Add what can be known of a table that is refused."""
    estimate, carried, runs = of
    try:
        wanted.write(carried, path, runs, waive=tuple(CHECKS), sign_confirmed=True)
    except MetrosepError as exc:
        is_dry_run = isinstance(exc, SignCheckFailedError)
        words = str(exc).replace(f"{path.parent}{os.sep}waived-", "")
        check = "dry-run" if is_dry_run else "format"
        found = {"level": "error", "problem": words, "fix": "", "check": check}
        view.header["findings"] = [_finding(found, wanted)]
        if is_dry_run:
            _add_bytes(view, wanted, of)
        else:
            _add_entries(view, carried, estimate)
    else:
        _add_file(view, path, wanted, estimate)


def _add_bytes(view: TableView, wanted: Wanted, of: tuple[ErrorEstimate, Any, RunSet]) -> None:
    """Add curves and dry-run of bytes that no file may hold: they do not shrink the error."""
    estimate, carried, runs = of
    dialect = find(wanted.controller)
    given, _ = split_machine(wanted.machine, dialect.options, wanted.controller)
    options = checked_options(given, dialect.options, wanted.controller)
    encoded = dialect.encode(carried, **options)
    known = {k: v for k, v in options.items() if v is not None} | encoded.options
    nowhere = Path(os.devnull)
    held = dialect.decode(encoded.data, nowhere, **known)
    lookup = dialect.lookup(encoded.data, nowhere, **known)
    _add_curves(view, held, lookup, estimate)
    verification = dry_run_carried(carried, lookup, runs)
    if isinstance(verification, Verification):
        _add_verification(view, verification.to_dict())


# ---- what is shown ---------------------------------------------------------------------------


def _add_error(view: TableView, estimate: ErrorEstimate, x: FloatArray | None = None) -> None:
    """Add the error that the table shall cancel; NaN where it was not measured."""
    start, stop, known = estimate.start, estimate.stop, estimate.directions
    x = np.linspace(start, stop, _CURVE) if x is None else x
    view.header["span_m"] = [start, stop]
    view.header["directions"] = [d for d in (1, -1) if d in known]
    view.arrays["x"] = x
    inside = (x >= start) & (x <= stop)
    for name, direction in (("error_forward", 1), ("error_reverse", -1)):
        if direction in known or (direction == 1 and known == (0,)):
            values = np.full(x.shape, np.nan)
            which = direction if direction in known else None
            values[inside] = estimate.evaluate(x[inside], direction=which)
            view.arrays[name] = values


def _add_file(view: TableView, path: Path, wanted: Wanted, estimate: ErrorEstimate) -> None:
    """Add what a written file holds, what its controller makes of it, and its sidecar."""
    sidecar = json.loads(sidecar_path(path).read_text(encoding="utf-8"))
    options, _ = split_machine(wanted.machine, find(wanted.controller).options, wanted.controller)
    held = read(path, wanted.controller, **options)
    _add_curves(view, held, simulate(path, wanted.controller, **options), estimate)
    view.header["findings"] = [_finding(f, wanted) for f in sidecar["findings"]]
    verification = sidecar.get("verification")
    if isinstance(verification, Mapping):
        _add_verification(view, verification)
    facts = {k: v for k, v in sidecar.items() if k not in ("table", "verification", "findings")}
    table = sidecar.get("table")
    if isinstance(table, Mapping):
        facts["made_of"] = {k: v for k, v in table.items() if _is_short(v)}
    facts.pop("file_sha256")
    view.header["facts"] = plain(facts)
    view.header["activation"] = list(sidecar.get("activation", ()))


def _is_short(value: Any) -> bool:
    return value is None or isinstance(value, str | int | float | bool)


def _finding(found: Mapping[str, Any], wanted: Wanted) -> dict[str, Any]:
    check = str(found["check"])
    return {
        **{k: found[k] for k in ("level", "problem", "fix", "check")},
        "about": CHECKS.get(check, ""),
        "waivable": found["level"] == "error" and check in CHECKS and check != "dry-run",
        "waived": check in wanted.waive,
    }


def _add_preview(view: TableView, path: Path) -> None:
    """Add the first and last lines of the very bytes."""
    data = path.read_bytes()
    lines = data.decode("utf-8", errors="backslashreplace").splitlines()
    left_out = max(0, len(lines) - _MOST_LINES)
    shown = lines
    if left_out:
        half = _MOST_LINES // 2
        shown = [*lines[:half], *lines[-half:]]
    view.header["preview"] = {
        "lines": [line if len(line) <= _LINE else f"{line[:_LINE]}\u2026" for line in shown],
        "left_out": left_out,
        "after": _MOST_LINES // 2 if left_out else None,
        "n_lines": len(lines),
        "n_bytes": len(data),
    }
    view.header["sha256"] = hashlib.sha256(data).hexdigest()


def _add_entries(view: TableView, held: Any, estimate: ErrorEstimate) -> None:
    """Add the entries of a table at their places, or the coefficients of a polynomial."""
    if not isinstance(held, CompensationTable):
        view.header |= {"n_points": None, "spacing_m": None, "degree": held.degree,
                        "coefficients": held.coefficients.tolist(), "held_m": list(held.domain)}  # fmt: skip
        return
    p = held.positions
    low, high = min(estimate.start, p[0]), max(estimate.stop, p[-1])
    _add_error(view, estimate, np.union1d(np.linspace(low, high, _CURVE), p))
    view.arrays["entries_at"] = np.searchsorted(view.arrays["x"], p).astype(np.int32)
    view.arrays["positions"] = np.array(p)
    view.arrays["forward"] = np.array(held.forward)
    reverse = held.forward if held.reverse is None else held.reverse
    view.arrays["reverse"] = np.array(reverse)
    steps = np.diff(p)
    view.header |= {
        "n_points": int(p.size),
        "spacing_m": float(np.median(steps)),
        "is_uniform": float(np.ptp(steps)) <= 1e-9 * float(steps.max()),
        "one_column": held.reverse is None,
        "largest_m": held.stroke,
        "reference_m": held.reference,
        "held_m": list(held.span),
    }


def _add_curves(view: TableView, held: Any, lookup: Any, estimate: ErrorEstimate) -> None:
    """Add the entries, and what the controller looks up at, between and outside them."""
    _add_entries(view, held, estimate)
    x = view.arrays["x"]
    view.arrays["applied_forward"] = np.array(lookup(x, 1), dtype=np.float64)
    view.arrays["applied_reverse"] = np.array(lookup(x, -1), dtype=np.float64)


def _add_verification(view: TableView, verification: Mapping[str, Any]) -> None:
    """Add the dry-run, with expanded uncertainties where scatter tells them."""
    rows = [dict(r) for r in verification.get("residuals", ())]
    for row in rows:
        for key in [k for k in row if k.startswith("u_")]:
            value = row.pop(key)
            row[f"U_{key[2:]}"] = None if value is None else _EXPANDED * value
    view.header["verification"] = plain({**verification, "residuals": rows, "k": _EXPANDED})
