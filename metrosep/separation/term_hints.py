"""Private to separation: sentences that say which option would help, where the readings show it.

Slopes in time: the residual of each run is written in orthogonal polynomials of time. Noise that
is smooth over frequency gives each low degree the same variance, so the first degree is compared
with the next ones by an F test; a drift of the runs raises the first alone.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from metrosep.core._arrays import FloatArray
from metrosep.separation.design import PreparedRun
from metrosep.separation.options import JointOptions
from metrosep.separation.solver import Solution

__all__ = ["hint_options"]


_DEGREES = 7
"""Highest degree in time; those above the first show what noise alone does."""

_RARE = 1e-3
"""A drift is named where chance alone would show as much less often than this."""

_SURE = 4.5
"""A gain is named beyond so many uncertainties: these scatter by up to 1.3 times what the noise
model says, since the noise model is itself an estimate."""

_NM = 1e-9


def hint_options(
    solution: Solution, prepared: Sequence[PreparedRun], options: JointOptions
) -> list[str]:
    """Name the options that these readings ask for."""
    sentences = [] if options.drift else _drift_hint(solution, prepared)
    if options.probe_gain == "equal":
        sentences += _gain_hint(solution)
    return sentences


def _drift_hint(solution: Solution, prepared: Sequence[PreparedRun]) -> list[str]:
    from scipy.stats import f as f_distribution

    marked = None if solution.weights is None else solution.weights.marked
    powers = []
    for i, (run, residual) in enumerate(zip(prepared, solution.residuals, strict=True)):
        z = residual if marked is None else np.where(marked[i], np.nan, residual)
        powers.append(_power_by_degree(run.t, z))
    power = np.array(powers)
    n_free = (len(prepared) - 1.0) / solution.sharing[0]  # what all share is slope of the axis
    noise = float(power[:, 1:].mean())
    if n_free < 1.0 or noise <= 0.0:
        return []
    ratio = float(power[:, 0].mean()) / noise
    p = float(f_distribution.sf(ratio, n_free, n_free * (_DEGREES - 1)))
    if p >= _RARE:
        return []
    slopes = np.array([_rise(r.t, z) for r, z in zip(prepared, solution.residuals, strict=True)])
    sentence = (
        f"the residuals rise or fall in time, by up to {np.abs(slopes).max() / _NM:.3g} nm in a run, "
        f"{math.sqrt(ratio):.2g} times what their noise explains (p = {max(p, 1e-99):.0e}): the sensor "
        "or the temperature drifts and the uncertainty is too small; drift=1 takes it out"
    )
    return [sentence]


def _power_by_degree(t: FloatArray, z: FloatArray) -> FloatArray:
    """Return the squares of the coefficients of degree 1 and higher, polynomials of unit power."""
    valid = ~np.isnan(z)
    u = (t - 0.5 * (t[0] + t[-1])) / (0.5 * float(np.ptp(t)))
    columns = np.polynomial.legendre.legvander(u[valid], _DEGREES)
    q = np.linalg.qr(columns)[0]
    return np.asarray((q.T @ z[valid])[1:] ** 2)


def _rise(t: FloatArray, z: FloatArray) -> float:
    """Return the change of the fitted line over one run."""
    valid = ~np.isnan(z)
    u = t[valid] - float(t[valid].mean())
    return float(u @ z[valid] / (u @ u)) * float(np.ptp(t))


def _gain_hint(solution: Solution) -> list[str]:
    return [
        f"the readings of probe {d.probe!r} differ by {100 * d.gain:+.2g} % (u {100 * d.sd:.1g} %) "
        f"from those of {d.first!r}; probe_gain='fit' gives each probe its own sensitivity"
        for d in solution.probe_differences
        if abs(d.gain) > _SURE * d.sd
    ]
