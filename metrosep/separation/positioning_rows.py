"""The formulas of ISO 230-2 on columns by target; one function for the test and its simulations."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from metrosep.separation.repeatability import SpreadEstimate

__all__ = ["DEFINITIONS", "Columns", "parameters", "uncertainties"]

FloatArray = NDArray[np.float64]

_N_TESTS = 2000

DEFINITIONS: Mapping[str, str] = {
    "A": "bidirectional accuracy of positioning (2 standard deviations)",
    "A_fwd": "accuracy of positioning, forward",
    "A_bwd": "accuracy of positioning, backward",
    "R": "bidirectional repeatability of positioning, largest R_i",
    "R_fwd": "repeatability of positioning, forward, largest 4 s_i",
    "R_bwd": "repeatability of positioning, backward, largest 4 s_i",
    "E": "bidirectional systematic positioning error",
    "E_fwd": "systematic positioning error, forward",
    "E_bwd": "systematic positioning error, backward",
    "B": "reversal error of the axis, largest |B_i|",
    "B_mean": "mean reversal error, mean of B_i = forward - backward",
    "M": "range of the mean bidirectional positioning error",
}


@dataclass(frozen=True, slots=True, eq=False)
class Columns:
    """Mean, standard deviation and count of one direction.

    Parameters
    ----------
    mean, sd : ndarray, shape (..., m)
        NaN where there are fewer than 2 readings.
    count : ndarray of int, shape (m,)
        Valid readings.
    """

    mean: FloatArray
    sd: FloatArray
    count: NDArray[np.intp]

    @property
    def usable(self) -> NDArray[np.bool_]:
        """Targets with 2 readings and more."""
        return np.asarray(self.count >= 2)

    @classmethod
    def of(cls, errors: FloatArray | None, m: int) -> Columns:
        """Return the columns of errors.

        Parameters
        ----------
        errors : ndarray, shape (m, n), or None
            NaN where not measured.
        m : int
            Number of targets.

        Returns
        -------
        Columns
            All NaN where there are no errors.
        """
        mean, sd = np.full(m, np.nan), np.full(m, np.nan)
        if errors is None:
            return cls(mean, sd, np.zeros(m, dtype=np.intp))
        count = np.asarray(np.count_nonzero(~np.isnan(errors), axis=1), dtype=np.intp)
        for i in np.flatnonzero(count >= 2):
            valid = errors[i][~np.isnan(errors[i])]
            mean[i], sd[i] = valid.mean(), valid.std(ddof=1)
        return cls(mean, sd, count)


def parameters(up: Columns, down: Columns) -> tuple[dict[str, FloatArray], dict[str, str]]:
    """Return the parameters and why some are missing.

    Parameters
    ----------
    up, down : Columns
        Forward and backward; leading dimensions of mean and sd are kept.

    Returns
    -------
    tuple of (dict, dict)
        Values by symbol, shape (...), in the order of `DEFINITIONS`; symbol to reason.
    """
    found: dict[str, FloatArray] = {}
    for name, way in (("fwd", up), ("bwd", down)):
        if way.usable.any():
            found[f"A_{name}"] = _high(way.mean + 2 * way.sd) - _low(way.mean - 2 * way.sd)
            found[f"R_{name}"] = _high(4.0 * way.sd)
            found[f"E_{name}"] = _high(way.mean) - _low(way.mean)
    if (up.usable & down.usable).any():
        b = up.mean - down.mean
        middle = (up.mean + down.mean) / 2.0
        found["B"] = _high(np.abs(b))
        found["B_mean"] = np.asarray(np.nanmean(b, axis=-1))
        found["M"] = _high(middle) - _low(middle)
        both = 2.0 * up.sd + 2.0 * down.sd + np.abs(b)
        found["R"] = _high(np.fmax(both, np.fmax(4.0 * up.sd, 4.0 * down.sd)))
        found["E"] = np.fmax(_high(up.mean), _high(down.mean)) - np.fmin(
            _low(up.mean), _low(down.mean)
        )
        found["A"] = np.fmax(_high(up.mean + 2 * up.sd), _high(down.mean + 2 * down.sd)) - np.fmin(
            _low(up.mean - 2 * up.sd), _low(down.mean - 2 * down.sd)
        )
    order = [k for k in DEFINITIONS if k in found]
    reasons = {
        k: "the direction has no target with 2 readings; measure it"
        if k.endswith(("_fwd", "_bwd"))
        else "it needs both directions; measure the other one too"
        for k in DEFINITIONS
        if k not in found
    }
    return {k: found[k] for k in order}, reasons


def _high(values: FloatArray) -> FloatArray:
    return np.asarray(np.fmax.reduce(values, axis=-1))


def _low(values: FloatArray) -> FloatArray:
    return np.asarray(np.fmin.reduce(values, axis=-1))


def uncertainties(
    up: Columns, down: Columns, spread: Mapping[str, SpreadEstimate], *, seed: int
) -> dict[str, float]:
    """Return standard uncertainties of the parameters by simulated tests.

    Parameters
    ----------
    up, down : Columns
        Of the test.
    spread : mapping of str to SpreadEstimate
        Whether the targets of a direction have one spread.
    seed : int
        Of the simulation.

    Returns
    -------
    dict of str to float
        Standard deviation over 2000 tests with the means and the spread found.
    """
    rng = np.random.default_rng(seed)
    ways = [_again(way, spread.get(key), rng) for way, key in ((up, "R_fwd"), (down, "R_bwd"))]
    values, _ = parameters(*ways)
    return {k: float(v.std(ddof=1)) for k, v in values.items()}


def _again(way: Columns, spread: SpreadEstimate | None, rng: np.random.Generator) -> Columns:
    """Return means and standard deviations of many tests like this one."""
    m = way.count.size
    if spread is None:
        return Columns(np.full((1, m), np.nan), np.full((1, m), np.nan), way.count)
    use = way.usable
    nu = np.where(use, way.count - 1, 1).astype(np.float64)
    variance = way.sd**2
    if spread.homogeneous:
        variance = np.where(use, float(nu[use] @ variance[use]) / float(nu[use].sum()), np.nan)
    n = np.where(use, way.count, 1)
    mean = way.mean + np.sqrt(variance / n) * rng.standard_normal((_N_TESTS, m))
    sd = np.sqrt(variance * rng.chisquare(nu, (_N_TESTS, m)) / nu)
    return Columns(mean, sd, way.count)
