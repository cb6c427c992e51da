"""Private to separation: unknowns of the joint model that are not linear, solved by Gauss-Newton.

The frequency of a line, the growth of the error with the feedrate and the sensitivity of
a probe: each gives a column, its derivative over the runs, and takes the step that is solved for.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import TYPE_CHECKING

import numpy as np

from metrosep.core._arrays import FloatArray

if TYPE_CHECKING:
    from metrosep.separation.runs.posterior import Model
    from metrosep.separation.runs.system import System

__all__ = ["Frequency", "Gain", "Unknown"]


@dataclass(slots=True)
class Unknown:
    """One number that the model depends on in a curved way."""

    prior_sd: float  # scale of its column, which has a prior of unit variance
    largest_step: float  # the model counts as linear over such a change
    done: float  # A smaller change means that it has converged
    sd: float = float("nan")  # standard uncertainty after the last solution

    def column(self, system: System, index: int, model: Model) -> FloatArray:
        """Return the derivative of the readings of one run."""
        raise NotImplementedError

    def shift(self, system: System, step: float) -> None:
        """Change the number in the system."""
        raise NotImplementedError


@dataclass(slots=True)
class Frequency(Unknown):
    """Frequency of a line, Hz."""

    line: int = 0  # which line

    def column(self, system: System, index: int, model: Model) -> FloatArray:
        """Return the change of the line with its frequency; see `Unknown`."""
        assert model.post is not None  # noqa: S101  (after a solution)
        return system.terms.line_change(index, self.line, model.post.theta[system.extra])

    def shift(self, system: System, step: float) -> None:
        """Add to the frequency; see `Unknown`."""
        system.terms.frequencies[self.line] += step


@dataclass(slots=True, eq=False)
class Gain(Unknown):
    """Factor on the error in some runs: ``1 + value * lever`` in each."""

    # shape (n_runs,): relative speed for growth with the feedrate; 1 in the runs of a probe
    lever: FloatArray = field(default_factory=lambda: np.empty(0))
    with_slope: bool = False  # whether the alignment slope is multiplied too, as a probe does
    name: str = ""  # of the probe, or "following"
    value: float = 0.0  # the factor's excess

    def column(self, system: System, index: int, model: Model) -> FloatArray:
        """Return the error in the runs with a lever; see `Unknown`."""
        if self.lever[index] == 0.0:
            return np.zeros(system.runs[index].x.size)
        out = system.shape(index, model, with_slope=self.with_slope) / self._own(index)
        return np.asarray(self.lever[index] * out)

    def _own(self, index: int) -> float:
        return 1.0 + self.value * float(self.lever[index])

    def shift(self, system: System, step: float) -> None:
        """Add to the factor; see `Unknown`."""
        before = 1.0 + self.value * self.lever
        self.value += step
        change = (1.0 + self.value * self.lever) / before
        system.gain = system.gain * change
        if self.with_slope:
            system.slope_gain = system.slope_gain * change
