"""A table of a recipe, ready to be made and written as a run of the recipe does."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from metrosep.controllers.files import write
from metrosep.core.runset import RunSet
from metrosep.recipe.outputs import make_carried
from metrosep.recipe.result import as_stored
from metrosep.separation.base import ErrorEstimate

__all__ = ["Wanted"]


@dataclass(frozen=True, slots=True)
class Wanted:
    """A table of a recipe, ready to be written."""

    output: Mapping[str, Any]  # mapping: as the recipe has it, checked
    # mapping: options and limits in SI, for `metrosep.controllers.write`
    machine: Mapping[str, Any]
    degree: Any = "aicc"  # of a polynomial where the output states none

    @property
    def controller(self) -> str:
        """Name of the dialect."""
        return str(self.output["controller"])

    @property
    def waive(self) -> tuple[str, ...]:
        """Checks whose refusal the recipe accepts."""
        return tuple(self.output.get("waive", ()))

    def carried(self, estimate: ErrorEstimate, runs: RunSet) -> Any:
        """Return what the controller will hold."""
        return make_carried(estimate, self.output, as_stored(runs), degree=self.degree)

    def write(self, carried: Any, path: Path, against: RunSet | None, **more: Any) -> Any:
        """Write it as a run of the recipe does."""
        said: dict[str, Any] = {
            "waive": self.waive,
            "sign_confirmed": bool(self.output.get("sign_confirmed", False)),
            **more,
        }
        stored = None if against is None else as_stored(against)
        return write(
            carried, path, self.controller, verified_against=stored, **said, **self.machine
        )
