"""The formulas of ISO 230-2 on columns by target; one function for the test and its simulations."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from metrosep.core._arrays import FloatArray
from metrosep.separation.repeatability import SpreadEstimate, likely_variances

__all__ = ["DEFINITIONS", "Columns", "by_target", "parameters", "uncertainties"]


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
    """Mean, standard deviation and count of one direction."""

    mean: FloatArray  # shape (..., m): naN where there are fewer than 2 readings
    sd: FloatArray
    count: NDArray[np.intp]  # shape (m,): valid readings

    @property
    def usable(self) -> NDArray[np.bool_]:
        """Targets with 2 readings and more."""
        return np.asarray(self.count >= 2)

    @classmethod
    def of(cls, errors: FloatArray | None, m: int, *, rounding: float = 0.0) -> Columns:
        """Return the columns of errors."""
        mean, sd = np.full(m, np.nan), np.full(m, np.nan)
        if errors is None:
            return cls(mean, sd, np.zeros(m, dtype=np.intp))
        count = np.asarray(np.count_nonzero(~np.isnan(errors), axis=1), dtype=np.intp)
        for i in np.flatnonzero(count >= 2):
            valid = errors[i][~np.isnan(errors[i])]
            mean[i], sd[i] = valid.mean(), valid.std(ddof=1)
            sd[i] = sd[i] if sd[i] > rounding else 0.0
        return cls(mean, sd, count)


def parameters(up: Columns, down: Columns) -> tuple[dict[str, FloatArray], dict[str, str]]:
    """Return the parameters and why some are missing."""
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
        found["R"] = _high(by_target(up, down))
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


def by_target(up: Columns, down: Columns) -> FloatArray:
    """Return the bidirectional repeatability of each target."""
    both = 2.0 * up.sd + 2.0 * down.sd + np.abs(up.mean - down.mean)
    return np.asarray(np.maximum(both, np.maximum(4.0 * up.sd, 4.0 * down.sd)))


def _high(values: FloatArray) -> FloatArray:
    return np.asarray(np.fmax.reduce(values, axis=-1))


def _low(values: FloatArray) -> FloatArray:
    return np.asarray(np.fmin.reduce(values, axis=-1))


def uncertainties(
    up: Columns, down: Columns, spread: Mapping[str, SpreadEstimate], *, seed: int
) -> dict[str, float]:
    """Return standard uncertainties of the parameters by simulated tests.

    Notes
    -----
    The means found scatter by their noise. A simulation about them would add the noise a second
    time, so they are first drawn together (James and Stein): what scatters no more than noise does
    is flat, what scatters far more stays. Middle and reversal error are drawn together separately.
    """
    rng = np.random.default_rng(seed)
    ways = (up, down)
    variances = [_likely(w, spread.get(k)) for w, k in zip(ways, ("R_fwd", "R_bwd"), strict=True)]
    means = _drawn_together(up, down, *variances)
    tests = [_again(w, m, v, rng) for w, m, v in zip(ways, means, variances, strict=True)]
    values, _ = parameters(*tests)
    return {k: float(v.std(ddof=1)) for k, v in values.items()}


def _likely(way: Columns, spread: SpreadEstimate | None) -> FloatArray:
    """Return the variance that each target probably has; NaN where it is not used."""
    use, likely = way.usable, np.full(way.count.size, np.nan)
    if spread is None:
        return likely
    freedom, found = (way.count[use] - 1).astype(np.float64), way.sd[use] ** 2
    likely[use] = float(freedom @ found) / float(freedom.sum())
    if not spread.homogeneous:
        likely[use] = likely_variances(found, freedom)
    return likely


def _drawn_together(
    up: Columns, down: Columns, var_up: FloatArray, var_down: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Return the means of both directions without the scatter that their noise gave them."""
    noise = [v / np.maximum(w.count, 1) for w, v in ((up, var_up), (down, var_down))]
    first, second = (_shrunk(w.mean, n) for w, n in zip((up, down), noise, strict=True))
    both = up.usable & down.usable
    if both.any():
        of_reversal = (noise[0] + noise[1])[both]
        middle = _shrunk((up.mean + down.mean)[both] / 2.0, of_reversal / 4.0)
        half = _shrunk((up.mean - down.mean)[both], of_reversal) / 2.0
        first[both], second[both] = middle + half, middle - half
    return first, second


def _shrunk(values: FloatArray, noise: FloatArray) -> FloatArray:
    use = ~np.isnan(values)
    shrunk = values.copy()
    if np.count_nonzero(use) > 1:
        level, scatter = float(values[use].mean()), float(values[use].var(ddof=1))
        share = float(noise[use].mean()) / scatter if scatter > 0.0 else 0.0
        shrunk[use] = level + max(1.0 - share, 0.0) * (values[use] - level)
    return shrunk


def _again(
    way: Columns, mean: FloatArray, variance: FloatArray, rng: np.random.Generator
) -> Columns:
    """Return means and standard deviations of many tests of an axis."""
    m = way.count.size
    if not way.usable.any():
        return Columns(np.full((1, m), np.nan), np.full((1, m), np.nan), way.count)
    nu = np.maximum(way.count - 1, 1).astype(np.float64)
    n = np.maximum(way.count, 1)
    means = mean + np.sqrt(variance / n) * rng.standard_normal((_N_TESTS, m))
    sd = np.sqrt(variance * rng.chisquare(nu, (_N_TESTS, m)) / nu)
    return Columns(means, sd, way.count)
