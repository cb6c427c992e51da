"""Private to separation: unknowns of the joint model that are not linear, solved by Gauss-Newton.

The lag, the frequency of a line, the growth of the error with the feedrate and the sensitivity of
a probe: each gives a column, its derivative over the runs, and takes the step that is solved for.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import TYPE_CHECKING

import numpy as np

from metrosep.core._arrays import FloatArray

if TYPE_CHECKING:
    from metrosep.separation.runs.system import System

__all__ = ["Frequency", "Gain", "Lag", "Unknown"]


_LAG_PRIOR = 0.05
"""Standard deviation in s of a weak prior on the lag: a machine does not lag by seconds."""

_LAG_DONE = 1e-7
"""Change of the lag in s below which it has converged."""

_LAG_STEP = 2e-3
"""Largest change of the lag in s in one step: the model is linear in it over such a time."""


@dataclass(slots=True)
class Unknown:
    """One number that the model depends on in a curved way."""

    prior_sd: float  # scale of its column, which has a prior of unit variance
    largest_step: float  # the model counts as linear over such a change
    done: float  # A smaller change means that it has converged
    sd: float = float("nan")  # standard uncertainty after the last solution

    def column(self, system: System, index: int, basis: FloatArray) -> FloatArray:
        """Return the derivative of the readings of one run."""
        raise NotImplementedError

    def shift(self, system: System, step: float) -> None:
        """Change the number in the system."""
        raise NotImplementedError


@dataclass(slots=True)
class Lag(Unknown):
    """Delay of the reading against the position, s."""

    prior_sd: float = _LAG_PRIOR
    largest_step: float = _LAG_STEP
    done: float = _LAG_DONE

    def column(self, system: System, index: int, basis: FloatArray) -> FloatArray:
        """Return minus the velocity times the slope of the error; see `Unknown`."""
        cosine, sine = np.split(system.solution[system.n_fixed :], 2)
        wave = 2.0 * np.pi * np.arange(1, system.n_harmonics + 1) / system.period
        change = basis @ np.concatenate([wave * sine, -wave * cosine]) * system.gain[index]
        slope = system.slope_gain[index] * system.solution[len(system.runs)] / system.half
        return np.asarray(-system.runs[index].velocity * (change + slope))

    def shift(self, system: System, step: float) -> None:
        """Add to the lag; see `Unknown`."""
        system.lag += step


@dataclass(slots=True)
class Frequency(Unknown):
    """Frequency of a line, Hz."""

    line: int = 0  # which line

    def column(self, system: System, index: int, basis: FloatArray) -> FloatArray:
        """Return the change of the line with its frequency; see `Unknown`."""
        del basis
        return system.terms.line_change(index, self.line, system.solution[system.extra])

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

    def column(self, system: System, index: int, basis: FloatArray) -> FloatArray:
        """Return the error in the runs with a lever; see `Unknown`."""
        if self.lever[index] == 0.0:
            return np.zeros(basis.shape[0])
        out = basis @ system.solution[system.n_fixed :] * (system.gain[index] / self._own(index))
        if self.with_slope:
            x = system.runs[index].x - system.runs[index].velocity * system.lag
            share = system.slope_gain[index] / self._own(index)
            out = out + share * system.solution[len(system.runs)] * (x - system.centre) / (
                system.half
            )
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
