"""Continuous runs of an axis that turns: no model along a length, the mean of each direction."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from typing import Any, ClassVar

from metrosep.compensation.area_errors import is_rotary
from metrosep.core.errors import DataError
from metrosep.core.methods import Method
from metrosep.core.options import Option
from metrosep.core.runset import RunSet
from metrosep.core.units import parse_quantity
from metrosep.separation.positions.expansion import Expansion
from metrosep.separation.positions.pitch import (
    PitchErrors,
    celled_runs,
    pitch_errors_of,
    require_read,
)

AVERAGED = (
    'over an angle the runs are averaged: leave the key out; method = "mean" is all that is needed'
)


def turning_axis(outputs: Iterable[Mapping[str, Any]]) -> str | None:
    """Return the axis that turns, over which a recipe makes a table; None where there is none."""
    axes = (o.get("axis") for o in outputs if o.get("kind") == "table")
    return next((a for a in axes if isinstance(a, str) and is_rotary(a)), None)


def cell_of(spacing: float) -> float:
    """Return the width of the cells that runs are averaged in, for a table of a spacing."""
    return spacing / 4.0


def cycles_of(runs: RunSet, spacing: float) -> RunSet:
    """Return runs of an axis that turns as the cycles that a table of a spacing is made of."""
    cycles = celled_runs(runs, cell_of(spacing))
    require_read(cycles, spacing)
    return cycles


def lengths_only(axis: str) -> DataError:
    """Return the error of an axis that turns where the positions are lengths."""
    return DataError(
        f"{axis} turns, and the runs are lengths over lengths: name axes that move along (X, Y, Z, U, "
        "V, W); runs over an angle have their angle as x, and axis C"
    )


@dataclass(frozen=True, slots=True)
class TurnedError:
    """The mean error over an angle.

    Parameters
    ----------
    errors : PitchErrors
        Of each direction, zero at the reference of the first table.
    cycles : RunSet
        The runs, averaged in cells of a quarter of the spacing, or at the positions that were read.
    """

    errors: PitchErrors
    cycles: RunSet

    @property
    def messages(self) -> tuple[str, ...]:
        """What the user should know."""
        return self.errors.messages


class TurnedRuns(Method):
    """The step ``separate`` of a recipe that makes a table over an axis that turns."""

    name: ClassVar[str] = "runs_over_angle"
    what: ClassVar[str] = "mean error of an axis that turns, from repeated runs"
    reads: ClassVar = "runs"
    arguments: ClassVar[Mapping[str, Option]] = {"method": Option("text", choices=("mean",))}

    @classmethod
    def from_inputs(cls, data: RunSet, options: Mapping[str, Any]) -> TurnedError:
        """Return the mean over cells; `options` are the tables that are to be made of it."""
        tables = options["tables"]
        if data.metadata.get("unit") != "rad":
            raise lengths_only(turning_axis(tables) or "C")
        spacing = min(parse_quantity(t["spacing"], dimension="angle") for t in tables)
        cycles = cycles_of(data, spacing)
        errors = pitch_errors_of(
            cycles,
            reference=float(tables[0].get("reference", 0.0)),
            reference_direction=tables[0].get("reference_direction", "forward"),
            unit="rad",
            heat=Expansion.of_options(tables[0]),
        )
        return TurnedError(errors, cycles)
