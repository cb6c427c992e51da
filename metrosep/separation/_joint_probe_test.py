"""Private to separation: whether probes that were taken as equal have the same sensitivity.

A score test: one step of the gain from 1, at the solution without it, with its uncertainty.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from metrosep.core._arrays import FloatArray
from metrosep.separation.feed_test import whitened_rows
from metrosep.separation.system import System

__all__ = ["ProbeDifference", "probe_differences"]


_UNSEEN = 1e-6
"""Share of its information that must be left beside the other columns."""


@dataclass(frozen=True, slots=True)
class ProbeDifference:
    """Sensitivity of a probe against the first, as one step from equality shows it."""

    probe: str  # names
    first: str
    gain: float  # excess of the sensitivity: 0.05 reads 5 % more
    sd: float  # its standard uncertainty if the probes are equal


def probe_differences(system: System, covariance: FloatArray) -> tuple[ProbeDifference, ...]:
    """Return the difference of each probe from the first."""
    names = list(dict.fromkeys(r.probe for r in system.runs))
    if len(names) < 2:
        return ()
    n = system.n_fixed + 2 * system.n_harmonics
    score, own = np.zeros(len(names)), np.zeros(len(names))
    cross = np.zeros((n, len(names)))
    for group, model in zip(system.groups, system.noise, strict=True):
        for i in group:
            at = names.index(system.runs[i].probe)
            column = _shape(system, i)[:, None]
            rows, extra, rest, variance = whitened_rows(system, i, model, column)
            variance *= system.sharing[0]
            score[at] += float(extra[:, 0] @ rest) / variance
            own[at] += float(extra[:, 0] @ extra[:, 0]) / variance
            cross[:, at] += rows.T @ extra[:, 0] / variance
    information = own - np.einsum("ij,ik,kj->j", cross, covariance, cross)
    return tuple(
        ProbeDifference(
            names[j],
            names[0],
            float(score[j] / information[j]),
            float(1.0 / np.sqrt(information[j])),
        )
        for j in range(1, len(names))
        if information[j] > _UNSEEN * own[j] > 0.0
    )


def _shape(system: System, index: int) -> FloatArray:
    """Return the error with its slope in one run, which a gain multiplies."""
    run = system.runs[index]
    curve = system.basis(index) @ system.solution[system.n_fixed :]
    x = run.x - run.velocity * system.lag
    slope = system.solution[len(system.runs)] * (x - system.centre) / system.half
    return np.asarray(curve * system.gain[index] + slope * system.slope_gain[index])
