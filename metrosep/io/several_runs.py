"""Several runs in one table: what is known of them, and the error that says how to read them."""

from __future__ import annotations

import shlex
from collections import Counter
from collections.abc import Collection, Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from metrosep.core.errors import FormatMismatchError
from metrosep.core.runset import Run, RunSet
from metrosep.core.units import parse_unit
from metrosep.io.own_notes import header_notes
from metrosep.io.source import RawFile
from metrosep.io.text.table import Column, Table

_NAMES = ("run", "feed_m_s", "t_s")


def run_table(runs: RunSet) -> Table:
    """Return runs as the columns run, feed_m_s, t_s, x_m (x_rad) and z_m (z_rad)."""
    units = [str(runs.metadata.get(key, "m")) for key in ("unit", "z_unit")]
    labels = _labels(runs)
    parts = {
        "feed_m_s": [np.full(len(r), np.nan if r.feed is None else r.feed) for r in runs],
        "t_s": [np.full(len(r), np.nan) if r.t is None else r.t for r in runs],
        f"x_{units[0]}": [r.x for r in runs],
        f"z_{units[1]}": [r.z for r in runs],
    }
    held = {"feed_m_s": any(r.feed for r in runs), "t_s": any(r.t is not None for r in runs)}
    numbers = [
        Column(name, parse_unit(name.split("_", 1)[1].replace("_", "/")), np.concatenate(values))
        for name, values in parts.items()
        if held.get(name, True)
    ]
    texts = tuple(label for label, r in zip(labels, runs, strict=True) for _ in range(len(r)))
    lines = np.arange(1, len(texts) + 1, dtype=np.int64)
    return Table((Column("run", None, None, texts), *numbers), lines, {"named": True})


def _labels(runs: RunSet) -> list[str]:
    """Return a name of its own for each run."""
    names = [run.run_id or str(k) for k, run in enumerate(runs)]
    counts: Counter[str] = Counter()
    made: list[str] = []
    for name in names:
        counts[name] += 1
        unique = name if counts[name] == 1 else f"{name} ({counts[name]})"
        made.append(unique if unique not in made else f"{unique} [{len(made)}]")
    return made


def own_columns(table: Table) -> dict[str, str]:
    """Return the columns by their role where a table has those of `run_table`, else nothing."""
    *first, x, z = table.names if len(table.names) > 2 else ("", "", "")
    known = first[:1] == ["run"] and [n for n in _NAMES if n in first] == first
    units = {name.partition("_")[2] for name in (x, z)}
    if not (known and (x[:2], z[:2]) == ("x_", "z_") and units <= {"m", "rad"}):
        return {}
    beside = {"run": "run", "feed": "feed_m_s", "time": "t_s"}
    return {"x": x, "z": z, **{k: n for k, n in beside.items() if n in first}}


def own_runs(file: RawFile, table: Table) -> RunSet | None:
    """Return the runs of a table that metrosep wrote with runs, ``None`` for its other tables."""
    columns_of_runs = own_columns(table)
    if not columns_of_runs:
        return None
    x, z = columns_of_runs["x"], columns_of_runs["z"]
    units = [name.partition("_")[2] for name in (x, z)]
    notes = header_notes(file, table.header.get("comments", ()))
    by_name = {c.name: c.values for c in table.columns}
    names = np.array(table["run"].labels or (), dtype=object)
    order = dict.fromkeys(names.tolist())
    columns = [by_name.get(name) for name in (x, z, "t_s", "feed_m_s")]
    runs = []
    for name in order:
        rows = names == name
        own_x, own_z, t, feed = (None if c is None else c[rows] for c in columns)
        other = (
            np.empty(0, dtype=np.intp)
            if feed is None
            else np.flatnonzero(np.nan_to_num(feed, nan=-1.0) != np.nan_to_num(feed[0], nan=-1.0))
        )
        if other.size:
            raise file.corrupt(
                f"the feed changes within run {name!r}",
                field=f"line {int(table.lines[rows][other[0]])}",
                hint="give each run a name of its own in column 'run'",
            )
        runs.append(
            Run(
                own_x if own_x is not None else (),
                own_z if own_z is not None else (),
                t=None if t is None or np.isnan(t).all() else t,
                feed=None if feed is None or np.isnan(feed[0]) else float(feed[0]),
                run_id=name,
            )
        )
    metadata = {
        **({} if units == ["m", "m"] else {"unit": units[0], "z_unit": units[1]}),
        "files": ({"file": file.name, "sha256": file.sha256, "lines": table.ledger},),
        "warnings": (*table.warnings, *notes.warnings),
    }
    return RunSet(runs, metadata=metadata, history=(*notes.history, *file.history("delimited")))


BLOCKS = "blocks"
"""What ``run=`` takes where no column numbers the runs: they begin where the position jumps back."""

COLUMNS = "columns"
"""What ``run=`` takes where the runs are columns beside each other, over one column of positions."""


@dataclass(frozen=True, slots=True)
class FoundRuns:
    """Several runs in one table: how many, what tells them apart, and which columns they need."""

    n: int
    run: str
    lines: tuple[int, ...]
    columns: dict[str, str]
    units: dict[str, str] = field(default_factory=dict)  # of these columns, where there is one
    undeclared: tuple[str, ...] = ()
    in_volts: bool = False  # the reading is a voltage, and its sensitivity is not known
    assumed: frozenset[str] = frozenset()  # keys of columns that no name tells, only what is left
    is_own: bool = False  # metrosep wrote them, and knows their columns
    targets: Mapping[str, str] = field(
        default_factory=dict
    )  # options of `table`: a positioning test

    def __str__(self) -> str:
        if self.run == COLUMNS:
            return (
                f"holds {self.n} runs beside each other, in columns such as {self.columns['z']!r}"
            )
        if self.run != BLOCKS:
            return f"holds {self.n} runs, distinguished by column {self.run!r}"
        shown = ", ".join(map(str, self.lines[:8])) + (", ..." if len(self.lines) > 8 else "")
        return f"holds {self.n} runs one below the other, which begin at lines {shown}"

    def is_known(self, given: Collection[str] = ()) -> bool:
        """Whether names, units and what the caller gives tell all that is needed to read the runs."""
        open_units = {k for k, name in self.columns.items() if name in self.undeclared}
        open_units |= {"scale"} if self.in_volts and "z" not in given else set()
        unsure = open_units | ({"x", "z"} - self.columns.keys()) | self.assumed
        return unsure <= set(given)

    @property
    def turns(self) -> bool:
        """Whether the position is an angle: such runs are not separated."""
        unit = self.units.get("x")
        return unit is not None and parse_unit(unit).dimension == "angle"

    def specs(self) -> dict[str, Any]:
        """Return the columns with their units, and what tells the runs apart, as `read_runs` takes them."""
        units = self.units
        return {k: (n, units[k]) if k in units else n for k, n in self.columns.items()} | {
            "run": self.run
        }

    def advice(self, path: object, options: Mapping[str, Any] | None = None) -> str:
        """Return the calls that read them, with the options that the file was read with."""
        if self.is_own and not self.turns:
            return (
                f"read them with metrosep.read_runs({str(path)!r}), or separate them with: metrosep separate "
                f"{shlex.quote(str(path))}"
            )
        first = ""
        if self.targets:
            first = table_advice(path, self.targets)
            if not self.is_known():
                return first
            first += "; sampled runs: "
        columns = {k: f"{v}:UNIT" if v in self.undeclared else v for k, v in self.columns.items()}
        given = {"x": "COLUMN", "z": "COLUMN", **columns, "run": self.run}
        if self.in_volts:
            given["scale"] = "SENSITIVITY"
        given |= {k: _typed(v) for k, v in (options or {}).items() if v is not None}
        open_ = {
            "the columns (COLUMN)": "COLUMN" in given.values(),
            "the units (UNIT)": any(v.endswith(":UNIT") for v in given.values()),
            "the sensitivity of the sensor, such as 2.5 um/V": given.get("scale") == "SENSITIVITY",
            "the SPACING of the table, such as '15 deg', and its FILE": self.turns,
        }
        named = " and ".join(what for what, is_open in open_.items() if is_open)
        fill_in = f"fill in {named}, which the file does not tell: " if named else ""
        call = ", ".join(f"{k}={v!r}" for k, v in given.items())
        words = (w for k, v in given.items() for w in (f"--{k.replace('_', '-')}", v))
        if self.turns:
            return (
                f"{fill_in}read them with metrosep.read_runs({str(path)!r}, {call}, angles=True), or make a table of "
                f"their mean with: metrosep table {shlex.join([str(path), *words])} --axis C --compensates C --spacing SPACING -o FILE"
            )
        return (
            f"{first}{fill_in}read them with metrosep.read_runs({str(path)!r}, {call}), or separate them with: "
            f"metrosep separate {shlex.join([str(path), *words])}"
        )


def table_advice(path: object, targets: Mapping[str, str]) -> str:
    """Return the call that makes a pitch table of a list of targets."""
    words = [w for k, v in targets.items() for w in (f"--{k}", v)]
    return (
        "targets that were reached in both directions (a positioning test): fill in the axis (AXIS) and for SENSE "
        "reached-minus-target where a positive reading means that the axis went too far, else target-minus-reached "
        "(leave --deviation out where the readings are positions), and make its pitch table with: metrosep table "
        f"{shlex.join([str(path), *words])} --deviation SENSE --axis AXIS -o FILE"
    )


def _typed(value: Any) -> str:
    """Return the value of a text option as a person types it."""
    if isinstance(value, str):
        return value
    if isinstance(value, tuple) and len(value) == 2 and all(isinstance(v, str) for v in value):
        return ":".join(value)  # a column and its unit
    if isinstance(value, list | tuple):
        return ",".join(map(str, value)) or "none"
    return str(value)


class SeveralRunsError(FormatMismatchError):
    """A table of several runs, where one profile or recording was asked for."""

    def __init__(
        self, path: object, found: FoundRuns, options: Mapping[str, Any] | None = None
    ) -> None:
        self.path, self.found = path, found
        super().__init__(f"{path}: {found}; {found.advice(path, options)}")
