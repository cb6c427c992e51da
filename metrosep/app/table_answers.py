"""Answers about a controller's table: which controllers there are, its preview, and its file."""

from __future__ import annotations

import hashlib
import json
import math
import os
import re
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from metrosep.app.documents import Edit, RecipeDocument
from metrosep.app.mends import mends_of_table
from metrosep.app.metrics_answers import as_far_as_it_goes, term_words
from metrosep.app.opening import Opened
from metrosep.app.separations import (
    MethodResults,
    Separations,
    described_controllers,
    machine_facts,
    sign_words,
)
from metrosep.app.sessions import Session, mark_of
from metrosep.app.wire import Answer, Arrays, Cancel, Message, Tell, page_words, plain
from metrosep.compensation.measured import Folds
from metrosep.compensation.sampling import USUAL_ENTRIES, rounded_spacing
from metrosep.compensation.table import CompensationTable
from metrosep.compensation.trial import TrialTable, trial_table
from metrosep.compensation.verification import Verification
from metrosep.controllers.base import columns_in, load_bytes, load_sidecar, own_part, sidecar_path
from metrosep.controllers.files import dry_run_bytes, read, simulate, write
from metrosep.controllers.options import split_machine
from metrosep.controllers.registry import find, names
from metrosep.controllers.safety import CHECKS
from metrosep.core._arrays import FloatArray
from metrosep.core.errors import (
    CorruptFileError,
    DataError,
    MetrosepError,
    RecipeError,
    SignCheckFailedError,
    SignNotConfirmedError,
    WriteError,
)
from metrosep.core.readable import said_value
from metrosep.core.runset import RunSet
from metrosep.core.units import parse_quantity
from metrosep.recipe.describe.describe_tests import curves_of
from metrosep.recipe.outputs import active_of, carried_of, machine_of, temporary_folder
from metrosep.recipe.pipeline import CancelledError
from metrosep.recipe.preflight import output_name
from metrosep.recipe.recipe import Recipe
from metrosep.recipe.step_help import in_table_words
from metrosep.separation import Separation
from metrosep.separation.runs.base import ErrorEstimate


def controllers(session: Session, message: Message, cancel: Cancel, tell: Tell) -> Answer:
    """Answer a request ``controllers``."""
    return {
        "controllers": described_controllers(),
        "machine": machine_facts(),
        "checks": dict(CHECKS),
    }, {}


def table(session: Session, message: Message, cancel: Cancel, tell: Tell) -> Answer:
    """Answer a request ``table``: the preview of a table, or its file."""
    opened, document = session.need()
    material = opened.material
    if not isinstance(material, Separations):
        raise DataError(
            f"a table over one axis is made of separated runs; what is open is a {opened.kind}"
        )
    _require_same(opened, document, message)
    stored = document.recipe
    found = _tables(stored)
    draft = message.get("draft")
    if not found and not isinstance(draft, Mapping):
        if message.get("write") is not None:
            raise DataError("the recipe has no table; add one first")
        return {"n_tables": 0, "suggested": _suggested(stored, material.runs(stored))}, {}
    recipe, refused = _with_draft(document, found, message)
    if refused is not None:
        return {"n_tables": len(found), "refused": refused}, {}
    wanted = _wanted(recipe, _number(message, len(_tables(recipe))))
    tell({"k": "progress", "text": "separating"})
    estimate = material.estimate(stored, cancel)
    if cancel():
        raise CancelledError("stopped before the table was made")
    basis = material.basis(recipe, cancel)
    if message.get("write") is not None:
        if isinstance(draft, Mapping):
            raise DataError("a draft is not written; put it into the recipe first")
        return _written(session, message, wanted, basis), {}
    view = view_table(wanted, estimate, basis)
    refusal = view.header.get("refused")
    if refusal is not None:
        hints = refusal.pop("hints")
        at = found[_number(message, len(found))] if draft is None else None
        refusal["mends"] = [] if at is None else mends_of_table(document, at, hints)
    header = {
        "n_tables": len(found),
        "name": wanted.output["path"],
        **view.header,
        **_trial_texts(message, wanted, basis),
    }
    return header, view.arrays


# ---- which table -----------------------------------------------------------------------------


def _require_same(opened: Opened, document: RecipeDocument, message: Message) -> None:
    shown = message.get("hash")
    if shown is not None and shown != mark_of(opened, document.recipe):
        raise DataError("the recipe has changed since what is shown; look at the new table first")


def _tables(recipe: Recipe) -> list[int]:
    """Return which of the outputs are tables."""
    return [i for i, o in enumerate(recipe.outputs) if o["kind"] == "table"]


def _number(message: Message, n: int) -> int:
    number = message.get("output", 0)
    if isinstance(number, bool) or not isinstance(number, int) or not 0 <= number < n:
        raise DataError(f"output is the number of a table, 0 to {n - 1}; got {said_value(number)}")
    return number


def _with_draft(
    document: RecipeDocument, found: list[int], message: Message
) -> tuple[Recipe, dict[str, Any] | None]:
    """Return the recipe with a draft in the place of a table, or why it would be none."""
    draft = message.get("draft")
    if draft is None:
        return document.recipe, None
    if not isinstance(draft, Mapping):
        raise DataError(f"draft is an output of a recipe, got {said_value(draft)}")
    at, old = len(document.recipe.outputs), None
    if found:
        at = found[_number(message, len(found))]
        old = _stored(document, at)
    trial = document.anew()
    try:
        trial.edit([Edit(("output", at), old, dict(draft))])
    except RecipeError as exc:
        missing = _missing(draft)
        words = {"message": page_words(str(exc)), "check": "", "checks": [], "waivable": False}
        return document.recipe, {**words, "option": missing}
    return trial.recipe, None


def _stored(document: RecipeDocument, at: int) -> Any:
    import tomllib

    return tomllib.loads(document.text)["output"][at]


def _missing(draft: Mapping[str, Any]) -> str | None:
    """Return the first required option that a draft does not state."""
    name, machine = draft.get("controller"), draft.get("machine", {})
    if name not in names() or not isinstance(machine, Mapping):
        return None
    asked = (o.name for o in find(str(name)).options if o.required and machine.get(o.name) is None)
    return next(asked, None)


def _wanted(recipe: Recipe, number: int) -> Wanted:
    at = _tables(recipe)[number]
    output, place = recipe.outputs[at], recipe.place("[[output]]", at)
    name = output_name(output["path"], place)
    return Wanted(
        {**output, "path": name}, machine_of(output, recipe, place), active_of(output, recipe)
    )


# ---- a table to begin with -------------------------------------------------------------------


def _suggested(recipe: Recipe, runs: RunSet) -> dict[str, Any]:
    """Return an output that can be added to a recipe without a table."""
    span = max(float(run.x.max()) for run in runs) - min(float(run.x.min()) for run in runs)
    axis = _axis_of(recipe.input.get("x")) or "X"
    compensates = _axis_of(recipe.input.get("z"))
    return {
        "kind": "table",
        "controller": "csv",
        "axis": axis,
        # which axis is corrected is never assumed: the form asks where no column says it
        **({} if compensates is None else {"compensates": compensates}),
        "spacing": rounded_spacing(span / USUAL_ENTRIES, axis),
        "path": f"{axis.lower()}-{(compensates or axis).lower()}.csv",
    }


def _axis_of(column: Any) -> str | None:
    """Return the axis that the name of a column tells: ``x_mm`` is X."""
    name = column.get("column", "") if isinstance(column, Mapping) else column
    found = re.match(r"([XYZABCUVW])[0-9]?(?![A-Za-z])", str(name).strip().upper())
    return found.group(1) if found else None


# ---- files -----------------------------------------------------------------------------------


def _trial_texts(message: Message, wanted: Wanted, basis: Mapping[str, Any]) -> dict[str, Any]:
    """Return what a trial with a bump of a height would tell to do; nothing is written."""
    if message.get("trial") is None:
        return {}
    try:
        return {"trial": trial_words(make_trial(wanted, basis, message["trial"]))}
    except MetrosepError as exc:
        return {"trial": {"refused": str(exc)}}


def _written(
    session: Session,
    message: Message,
    wanted: Wanted,
    basis: Mapping[str, Any],
) -> dict[str, Any]:
    given = message["write"]
    if not isinstance(given, str):
        raise DataError(f"write is the path of a file, got {said_value(given)}")
    target: Path = session.target(given)
    overwrite = message.get("overwrite") is True
    if message.get("trial") is not None:
        trial = make_trial(wanted, basis, message["trial"])
        return write_trial(wanted, trial, target, overwrite=overwrite)
    return write_file(wanted, basis, target, overwrite=overwrite)


# ---- what a recipe's table would be: its very bytes, what the controller makes of them, the dry-run ----
# The table is written into a temporary folder by the function that a run of the recipe uses, read
# back, and looked up. What is refused is shown as far as it goes, but never as a file.

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


def view_table(wanted: Wanted, estimate: ErrorEstimate, basis: Mapping[str, Any]) -> TableView:
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
        carried, *against = wanted.carried(basis)
    except MetrosepError as exc:
        view.header["refused"] = _refusal(exc, wanted, [])
        return view
    name = Path(str(wanted.output["path"])).name
    with temporary_folder("table") as folder:
        path = folder / name
        try:
            wanted.write(carried, path, against)
        except MetrosepError as exc:
            refused = exc
        else:
            _add_file(view, path, wanted, estimate)
            _add_preview(view, path)
            return view
        _add_all_the_same(view, folder / f"waived-{name}", wanted, estimate, (carried, against))
        said = view.header.get("findings", [])
        view.header["refused"] = _refusal(refused, wanted, said, str(folder))
    return view


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
    words = page_words(str(exc).replace(f"{folder}{os.sep}", "") if folder else str(exc))
    open_ones = [f for f in findings if f["level"] == "error" and f["check"] not in wanted.waive]
    checks = list(dict.fromkeys(f["check"] for f in open_ones))
    if isinstance(exc, SignNotConfirmedError):
        said = _said(words, "sign", waivable=False, option="sign_confirmed")
    elif isinstance(exc, SignCheckFailedError):
        said = _said(words, "dry-run", waivable=False)
    elif checks:
        waivable = all(c in CHECKS for c in checks)
        said = {**_said(words, checks[0], waivable=waivable), "checks": checks}
    else:
        said = _said(words, "", waivable=False)
    return {**said, "hints": exc.hints}


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
    view: TableView, path: Path, wanted: Wanted, estimate: ErrorEstimate, of: tuple[Any, list[Any]]
) -> None:
    """Add what can be known of a table that is refused."""
    carried, against = of
    try:
        wanted.write(carried, path, against, waive=tuple(CHECKS), sign_confirmed=True)
    except MetrosepError as exc:
        is_dry_run = isinstance(exc, SignCheckFailedError)
        words = str(exc).replace(f"{path.parent}{os.sep}waived-", "")
        check = "dry-run" if is_dry_run else "format"
        found = {"level": "error", "problem": words, "fix": "", "check": check}
        view.header["findings"] = [_finding(found, wanted)]
        if is_dry_run:
            _add_bytes(view, wanted, estimate, of)
        else:
            _add_entries(view, carried, estimate)
    else:
        _add_file(view, path, wanted, estimate)


def _add_bytes(
    view: TableView, wanted: Wanted, estimate: ErrorEstimate, of: tuple[Any, list[Any]]
) -> None:
    """Add curves and dry-run of bytes that no file may hold: they do not shrink the error."""
    carried, (runs, folds) = of
    held, lookup, verification = dry_run_bytes(
        carried, wanted.controller, runs, folds=folds, active=wanted.active, **wanted.machine
    )
    _add_curves(view, held, lookup, estimate)
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
    if columns_in(sidecar):
        options["column"] = wanted.output["compensates"]
        sidecar = own_part(sidecar, wanted.output["compensates"])
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


# ---- files of a table that the user asks for: the table, or a trial of its sign ----------------

_SCHEMA = "metrosep.table/1"


def write_file(
    wanted: Wanted, basis: Mapping[str, Any], target: Path, *, overwrite: bool
) -> dict[str, Any]:
    """Write a table and its sidecar, as a run of the recipe does."""
    carried, *against = wanted.carried(basis)
    verification = _put(wanted, carried, target, against, overwrite=overwrite)
    said = None if verification is None else verification.to_dict()
    return {**_files(target), "verification": plain(said)}


def make_trial(wanted: Wanted, basis: Mapping[str, Any], height: object) -> TrialTable:
    """Return one bump that tells the sign on the machine, as ``metrosep table --trial`` has it."""
    if not isinstance(height, str):
        raise DataError(f"trial is a height with its unit, such as 2 um; got {said_value(height)}")
    size = parse_quantity(height, dimension="length", name="trial")
    made, _, _ = wanted.carried(basis)
    if not isinstance(made, CompensationTable):
        raise DataError("a trial has no meaning for a polynomial: its sign is stated")
    return trial_table(made, size)


def trial_words(trial: TrialTable) -> dict[str, Any]:
    """Return what a trial of the sign asks for."""
    return {
        "instruction": trial.instruction,
        "if_right": trial.if_right,
        "if_wrong": trial.if_wrong,
    }


def write_trial(
    wanted: Wanted, trial: TrialTable, target: Path, *, overwrite: bool
) -> dict[str, Any]:
    """Write a trial of the sign."""
    _put(wanted, trial, target, None, overwrite=overwrite)
    return {**_files(target), "trial": trial_words(trial)}


def _put(
    wanted: Wanted, carried: Any, target: Path, against: list[Any] | None, *, overwrite: bool
) -> Any:
    """Write a table; other bytes of metrosep are replaced if that was said, the same ones stay."""
    replaces = _replaces(target, overwrite=overwrite)
    try:
        return wanted.write(carried, target, against, overwrite=replaces)
    except WriteError as exc:
        exc.args = (str(exc).replace("or say overwrite", "or overwrite it"),)
        raise


def _replaces(target: Path, *, overwrite: bool) -> bool:
    """Return whether a table of metrosep may be replaced; refuse any other file."""
    if not target.exists():
        return False
    if target.is_dir():
        raise WriteError(f"{target}: is a folder; name a file")
    if not _is_ours(target):
        raise WriteError(
            f"{target}: exists already, not written by metrosep or changed since, and a machine may be "
            "using it; choose another name"
        )
    return overwrite


def _is_ours(target: Path) -> bool:
    try:
        beside = load_sidecar(target)
    except CorruptFileError:
        return False
    if beside.get("schema") != _SCHEMA:
        return False
    return beside.get("file_sha256") == hashlib.sha256(load_bytes(target)).hexdigest()


def _files(target: Path) -> dict[str, Any]:
    return {
        "files": [str(target), str(sidecar_path(target))],
        "sha256": hashlib.sha256(target.read_bytes()).hexdigest(),
    }


# ---- A table of a recipe, ready to be made and written as a run of the recipe does -------------


@dataclass(frozen=True, slots=True)
class Wanted:
    """A table of a recipe, ready to be written."""

    output: Mapping[str, Any]  # mapping: as the recipe has it, checked
    # mapping: options and limits in SI, for `metrosep.controllers.write`
    machine: Mapping[str, Any]
    active: str | None = None  # file that was active during the measurement

    @property
    def controller(self) -> str:
        """Name of the dialect."""
        return str(self.output["controller"])

    @property
    def waive(self) -> tuple[str, ...]:
        """Checks whose refusal the recipe accepts."""
        return tuple(self.output.get("waive", ()))

    def carried(
        self, basis: Mapping[str, Any]
    ) -> tuple[Any, RunSet | ErrorEstimate, Folds | None]:
        """Return what the controller will hold, the runs for its dry-run, and what it is without each."""
        with in_table_words(self.controller):
            return carried_of(basis, self.output)

    def write(self, carried: Any, path: Path, against: list[Any] | None, **more: Any) -> Any:
        """Write it as a run of the recipe does, after a dry-run against runs and folds."""
        said: dict[str, Any] = {
            "waive": self.waive,
            "sign_confirmed": bool(self.output.get("sign_confirmed", False)),
            "active": self.active,
            **more,
        }
        runs, folds = (None, None) if against is None else against
        with in_table_words(self.controller):
            return write(
                carried,
                path,
                self.controller,
                verified_against=runs,
                folds=folds,
                **said,
                **self.machine,
            )


def machine(session: Session, message: Message, cancel: Cancel, tell: Tell) -> Answer:
    """Answer a request ``machine``."""
    with session.lock:
        opened, document = session.need()
        recipe, op = document.recipe, str(document.recipe.steps[0]["op"])
    if op == "rank" or not isinstance(opened.material, MethodResults):
        raise DataError(f"there are pictures of a method, and a ranking has its own; this is {op}")
    tell({"k": "progress", "words": "computing"})
    result, refused = as_far_as_it_goes(opened.material, recipe, cancel)
    charts = list(result.document["separation"]["charts"])
    if isinstance(result.produced, Separation) and not any(c["kind"] == "curves" for c in charts):
        charts = [*curves_of(result.produced), *charts]  # the report draws these from the parts
    header = {
        "op": op,
        "rows": _terms(result.produced) if op == "calibrate" else [],
        "null": list(result.produced.found.null) if op == "calibrate" else [],
        "charts": charts,
        "messages": [
            session.words(str(m))
            for m in [refused] * (refused is not None)
            + (_messages(result) if op == "calibrate" else list(result.document["messages"]))
        ],
        "verdict": None if refused is not None else result.verdict,
    }
    return plain(header), {}


def _messages(result: Any) -> list[str]:
    """Return what a calibration says beside what it does not determine, which has a list of its own."""
    of_null = set(result.produced.messages) - set(result.produced.found.messages)
    return [str(m) for m in result.document["messages"] if m not in of_null]


def _terms(produced: Any) -> list[dict[str, Any]]:
    """Return every term: its value or its P-V with u, or that the readings do not determine it."""
    import numpy as np

    from metrosep.machine._bases import UnseenTerm
    from metrosep.machine.elements import axis_of, term_unit
    from metrosep.machine.terms import ConstantTerm

    found = produced.found
    rows: list[dict[str, Any]] = []
    for name, term in found.errors.items():
        row: dict[str, Any] = {
            "term": name,
            "words": term_words(name),
            "axis": axis_of(name) or "",
            "unit": term_unit(found.chain, name),
            "kind": "value",
            "value": None,
            "u": None,
        }
        if isinstance(term, ConstantTerm):
            row |= {"value": term.value, "u": term.u}
        elif not isinstance(term, UnseenTerm):
            basis = found.bases[name]
            low, high = (
                (0.0, 2.0 * math.pi) if basis.kind == "fourier" else (basis.low, basis.high)
            )
            x = np.linspace(low, high, 181)
            row |= {
                "kind": "P-V",
                "value": float(np.ptp(term.evaluate(x))),
                "u": float(np.max(term.sd(x))),
            }
        rows.append(row)
    return rows
