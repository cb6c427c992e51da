"""`PositioningTest`: the parameters of ISO 230-2 with their tables, intervals and messages.

The reversal error is mean forward minus mean backward. Arrays have one row per target, targets
rising.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from metrosep.core._arrays import FloatArray
from metrosep.core.errors import TooFewSamplesError
from metrosep.core.quantity import Quantity
from metrosep.core.runset import RunSet
from metrosep.core.units import format_engineering
from metrosep.parameters.table import Context, ParameterTable
from metrosep.separation._readings import plain
from metrosep.separation.contract import StoredResult
from metrosep.separation.positions.pitch import cycle_runs
from metrosep.separation.positions.repeatability import (
    SpreadEstimate,
    bidirectional_estimate,
    likely_variances,
    spread_estimate,
)

if TYPE_CHECKING:
    import pandas as pd

_ROUNDING = 1e-15
"""Of the largest target: about four steps of a double."""

_LONG = 10.0
"""m; axes are seldom longer: a hint that mm were passed."""

_MANY_TURNS = 2.0 * math.tau
"""rad; tests go over one turn, seldom over more than two."""

_WIDE = 1e-3
"""m; an axis that deviates by more is not under control, or the unit is wrong."""

_EDITION = "ISO 230-2:2014"


@dataclass(frozen=True, slots=True, eq=False, repr=False)
class PositioningTest(StoredResult, Mapping[str, Quantity]):
    """Result of a positioning test: a mapping from symbol to quantity, and columns by target.

    Parameters
    ----------
    table : ParameterTable
        The parameters; those that need both directions are refused by name where one is missing.
    targets : ndarray, shape (m,), m or rad
        Targets, rising.
    forward, backward : ndarray, shape (m, n), or None
        Errors (position minus target) of each run, NaN where not measured.
    mean_forward, mean_backward, sd_forward, sd_backward : ndarray, shape (m,)
        Mean error and standard deviation (ddof 1); NaN where there are fewer than 2 readings.
    reversal : ndarray, shape (m,)
        B_i; NaN where a direction is missing.
    repeatability : ndarray, shape (m,)
        R_i bidirectional; NaN where a direction is missing.
    intervals : mapping of str to tuple of (float, float)
        For ``"R"``, ``"R_fwd"``, ``"R_bwd"``: interval of the value that R stands for, which is
        that of an infinite number of runs, whatever the spread of each target is.
    confidence : float
        Of the intervals.
    spread : mapping of str to SpreadEstimate
        What stands behind the intervals.
    audit : mapping
        Settings and counts, plain values.
    messages : tuple of str
        What the user should know, in plain words.
    """

    table: ParameterTable
    targets: FloatArray
    forward: FloatArray | None
    backward: FloatArray | None
    mean_forward: FloatArray
    mean_backward: FloatArray
    sd_forward: FloatArray
    sd_backward: FloatArray
    reversal: FloatArray
    repeatability: FloatArray
    intervals: Mapping[str, tuple[float, float]]
    confidence: float
    spread: Mapping[str, SpreadEstimate] = field(default_factory=dict)
    audit: Mapping[str, Any] = field(default_factory=dict)
    messages: tuple[str, ...] = ()

    @property
    def cycles(self) -> RunSet:
        """The errors of each cycle as runs over the targets, of which a table can be made."""
        return cycle_runs(self.targets, self.forward, self.backward, unit=self.audit["unit"])

    def __getitem__(self, symbol: str) -> Quantity:
        return self.table[symbol]

    def __iter__(self) -> Iterator[str]:
        return iter(self.table)

    def __len__(self) -> int:
        return len(self.table)

    def __contains__(self, symbol: object) -> bool:
        return symbol in self.table

    @property
    def R_unbiased(self) -> float:  # noqa: N802
        """What R estimates, without the bias of the largest of few: of both directions, or the one."""
        return self.table["R_unbiased" if "R_unbiased" in self.table else self._only()].value

    @property
    def R_interval(self) -> tuple[float, float]:  # noqa: N802
        """Interval of `R_unbiased` at `confidence`."""
        key = "R" if "R" in self.intervals else next(iter(self.intervals))
        return self.intervals[key]

    @property
    def intervals_alike(self) -> Mapping[str, tuple[float, float]]:
        """Narrower intervals that hold where all targets scatter alike, or differ by chance."""
        return {k: (s.low_alike, s.high_alike) for k, s in self.spread.items()}

    def _only(self) -> str:
        return next(k for k in self.table if k.endswith("_unbiased"))

    def to_frame(self) -> pd.DataFrame:
        """Return a row per symbol: ``value``, ``unit``, ``u``, ``definition``, ``edition``."""
        return self.table.to_frame()

    def targets_frame(self) -> pd.DataFrame:
        """Return the columns by target, as the test sheet of the standard has them.

        ``target_mm``, then in um: ``mean_fwd``, ``mean_bwd``, ``mean``, ``reversal``, ``sd_fwd``,
        ``sd_bwd``, ``four_sd_fwd``, ``four_sd_bwd``, ``repeatability`` (rotary axes: ``target_deg``
        and arcsec); and ``n_fwd``, ``n_bwd``.
        """
        import pandas as pd

        rotary = self.audit.get("unit") == "rad"
        coarse, fine = (180.0 / math.pi, 648000.0 / math.pi) if rotary else (1e3, 1e6)
        coarse_name, name = ("deg", "arcsec") if rotary else ("mm", "um")
        both = (self.mean_forward + self.mean_backward) / 2.0
        columns = {
            "mean_fwd": self.mean_forward,
            "mean_bwd": self.mean_backward,
            "mean": both,
            "reversal": self.reversal,
            "sd_fwd": self.sd_forward,
            "sd_bwd": self.sd_backward,
            "four_sd_fwd": 4.0 * self.sd_forward,
            "four_sd_bwd": 4.0 * self.sd_backward,
            "repeatability": self.repeatability,
        }
        data = {f"target_{coarse_name}": self.targets * coarse}
        data |= {f"{key}_{name}": column * fine for key, column in columns.items()}
        counts = {
            f"n_{key}": _counts(errors, self.targets.size)
            for key, errors in (("fwd", self.forward), ("bwd", self.backward))
        }
        return pd.DataFrame(data | counts)

    def to_dict(self) -> dict[str, Any]:
        curves = ("mean_forward", "mean_backward", "sd_forward", "sd_backward")
        columns = {n: getattr(self, n) for n in (*curves, "reversal", "repeatability")}
        rest = {
            "intervals": self.intervals,
            "intervals_alike": self.intervals_alike,
            "confidence": self.confidence,
            "by_target": {"target": self.targets, **columns},
            "messages": self.messages,
        }
        return {**self.table.to_dict(), **plain(rest)}

    def __repr__(self) -> str:
        return repr(self.table).replace("ParameterTable", "PositioningTest", 1)

    def __str__(self) -> str:
        unit = str(self.audit.get("unit", "m"))
        low, high = (format_engineering(v, unit) for v in self.R_interval)
        tail = [f"  {100 * self.confidence:g} % interval of R_unbiased: {low} ... {high}"]
        tail += [f"  {m}" for m in self.messages]
        return "\n".join([repr(self), *tail])


def _counts(errors: FloatArray | None, m: int) -> NDArray[np.intp]:
    if errors is None:
        return np.zeros(m, dtype=np.intp)
    return np.asarray(np.count_nonzero(~np.isnan(errors), axis=1), dtype=np.intp)


def build_result(
    targets: FloatArray,
    forward: FloatArray | None,
    backward: FloatArray | None,
    *,
    unit: str,
    confidence: float,
    seed: int,
) -> PositioningTest:
    """Return the result of checked errors."""
    rounding = _ROUNDING * float(np.abs(targets).max())
    up = Columns.of(forward, targets.size, rounding=rounding)
    down = Columns.of(backward, targets.size, rounding=rounding)
    if max(up.usable.sum(), down.usable.sum()) < 2:
        raise TooFewSamplesError(
            "a positioning test needs 2 targets with 2 or more readings each in one direction"
        )
    spread = _spreads(up, down, confidence, seed)
    values, missing = parameters(up, down)
    values = {k: v if abs(float(v)) > rounding else np.zeros(()) for k, v in values.items()}
    found = uncertainties(up, down, spread, seed=seed)
    u = {k: v if v > rounding else 0.0 for k, v in found.items()}
    quantities = [
        Quantity(float(v), unit, f"{DEFINITIONS[k]}, {_EDITION}", u=u.get(k), symbol=k)
        for k, v in values.items()
    ]
    quantities += [
        Quantity(
            s.value,
            unit,
            f"what {k} is with infinitely many runs, estimated",
            s.u,
            f"{k}_unbiased",
        )
        for k, s in spread.items()
    ]
    given = [e for e in (forward, backward) if e is not None]
    largest = max(float(np.nanmax(np.abs(e))) for e in given)
    messages = tuple(_messages(targets, up, down, spread, values, unit, largest))
    context = Context(
        _EDITION,
        n_valid=int(sum(np.count_nonzero(~np.isnan(e)) for e in given)),
        n_total=int(sum(e.size for e in given)),
        settings={"confidence": confidence, "seed": seed},
        notes=("u holds the scatter of the runs only",),
    )
    return PositioningTest(
        table=ParameterTable(quantities, context, unavailable=missing),
        targets=targets,
        forward=forward,
        backward=backward,
        mean_forward=up.mean,
        mean_backward=down.mean,
        sd_forward=up.sd,
        sd_backward=down.sd,
        reversal=up.mean - down.mean,
        repeatability=by_target(up, down),
        intervals={k: (s.low, s.high) for k, s in spread.items()},
        confidence=confidence,
        spread=spread,
        audit=_audit(targets, up, down, unit, confidence, seed),
        messages=messages,
    )


def _spreads(
    up: Columns, down: Columns, confidence: float, seed: int
) -> dict[str, SpreadEstimate]:
    found: dict[str, SpreadEstimate] = {}
    ways = {"R_fwd": up, "R_bwd": down}
    both = up.usable & down.usable
    if both.any():
        found["R"] = bidirectional_estimate(
            (up.sd[both] ** 2, down.sd[both] ** 2),
            (up.count[both], down.count[both]),
            up.mean[both] - down.mean[both],
            confidence=confidence,
            seed=seed,
        )
    for key, way in ways.items():
        if way.usable.any():
            found[key] = spread_estimate(
                way.sd[way.usable] ** 2, way.count[way.usable], confidence=confidence, seed=seed
            )
    return found


def _audit(
    targets: FloatArray, up: Columns, down: Columns, unit: str, confidence: float, seed: int
) -> dict[str, Any]:
    return {
        "unit": unit,
        "n_targets": int(targets.size),
        "travel": float(np.ptp(targets)),
        "n_runs_forward": int(up.count.max(initial=0)),
        "n_runs_backward": int(down.count.max(initial=0)),
        "confidence": confidence,
        "seed": seed,
    }


def _messages(
    targets: FloatArray,
    up: Columns,
    down: Columns,
    spread: Mapping[str, SpreadEstimate],
    values: Mapping[str, FloatArray],
    unit: str,
    largest: float,
) -> Iterator[str]:
    travel, steps = float(np.ptp(targets)), np.diff(targets)
    if unit == "m" and travel > _LONG:
        yield f"the targets span {travel:.4g} m: are targets and positions in m, not mm?"
    if unit == "rad" and travel > _MANY_TURNS:
        yield f"the targets span {travel:.4g} rad: are targets and positions in rad, not degrees?"
    if unit == "m" and largest > _WIDE:
        yield (
            f"deviations reach {format_engineering(largest, unit)}: are targets and positions in the "
            "same unit, m?"
        )
    for way, name in ((up, "forward"), (down, "backward")):
        if not way.usable.any():
            yield f"no {name} runs: a unidirectional test, without reversal error"
            continue
        for i in np.flatnonzero(~way.usable):
            yield (
                f"{name}: target {format_engineering(float(targets[i]), unit)} has fewer than 2 "
                "readings and takes no part"
            )
        if way.count[way.usable].min() < 5:
            yield f"{name}: fewer than 5 runs, ISO 230-2 asks for 5 up to 2 m"
    if up.usable.any() and down.usable.any():
        for i in np.flatnonzero(up.usable != down.usable):
            key, name = ("R_fwd", "forward") if up.usable[i] else ("R_bwd", "backward")
            yield (
                f"target {format_engineering(float(targets[i]), unit)} was measured {name} only: B, "
                f"M, R and R_unbiased leave it out; {key}, E and A hold it"
            )
    if unit == "m" and travel <= 2.0 and (targets.size < 5 or targets.size < 5.0 * travel):
        yield "fewer than 5 targets per metre (and at least 5), as ISO 230-2 asks for up to 2 m"
    if targets.size > 2 and float(np.ptp(steps)) <= 1e-6 * float(steps.mean()):
        yield (
            "the targets are equally spaced: a periodic error that fits the step is not seen; add "
            "a random part to each target"
        )
    for key, s in spread.items():
        if not s.homogeneous:
            yield (
                f"{key}: the spread differs from target to target (p = {s.p:.1g}); "
                "intervals_alike is that of the largest of spreads that differ, and approximate"
            )
        if s.value > 0.0 and float(values[key]) > 1.15 * s.value:
            yield (
                f"{key} is the largest of few: {float(values[key]) / s.value:.2f} times what it would be "
                f"with many runs (interval {format_engineering(s.low, unit)} to "
                f"{format_engineering(s.high, unit)})"
            )


# ---- the formulas of ISO 230-2 on columns by target; one function for the test and its simulations ----

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
