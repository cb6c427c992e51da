"""Several runs in one table: what is known of them, and the error that says how to read them."""

from __future__ import annotations

import shlex
from collections.abc import Collection, Mapping
from dataclasses import dataclass, field
from typing import Any

from metrosep.core.errors import FormatMismatchError
from metrosep.core.units import parse_unit

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
