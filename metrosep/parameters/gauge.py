"""Gauge study: how much of the spread of readings comes from the measuring process itself.

Every part is measured several times in every condition (operator, set-up, day, instrument). A
two-way analysis of variance with random effects splits the variance into repeatability (same part,
same condition), reproducibility (between conditions, and how conditions treat parts differently),
and the parts themselves.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from metrosep.core._arrays import FloatArray
from metrosep.core.errors import DataError, InvalidSamplesError, TooFewSamplesError
from metrosep.core.numbers import between, positive
from metrosep.core.quantity import Quantity
from metrosep.parameters.decision import limits_error
from metrosep.parameters.repeats import RELATIVE_FLOOR

_NDC = math.sqrt(2.0)
"""Number of distinct categories is sqrt(2) times parts over gauge, both standard deviations."""

_POOL = 0.25
"""Interaction that is less significant than this is pooled with the repeatability (AIAG)."""


@dataclass(frozen=True, slots=True)
class VarianceRow:
    """One line of the analysis of variance.

    Parameters
    ----------
    source : str
        ``"parts"``, ``"conditions"``, ``"interaction"``, ``"repeatability"`` or ``"total"``.
    squares : float
        Sum of squares.
    dof : int
        Degrees of freedom.
    mean_square : float
        Quotient of both; NaN for the total.
    f : float
        F statistic; NaN where there is none.
    p : float
        Probability of so large an F by chance; NaN where there is none.
    """

    source: str
    squares: float
    dof: int
    mean_square: float = math.nan
    f: float = math.nan
    p: float = math.nan


@dataclass(frozen=True, slots=True)
class GaugeStudy:
    """What a gauge study found; standard deviations in the unit of the readings.

    Parameters
    ----------
    repeatability, reproducibility, interaction, gauge, parts, total : Quantity
        Standard deviations: of one reading in one condition; of the conditions, with how they
        treat parts differently; of that alone; of repeatability and reproducibility together; of
        the parts; of everything. ``u`` from the covariance of the mean squares.
    interval : mapping of str to (float, float)
        Confidence interval of ``repeatability`` (exact) and ``gauge`` (modified large sample).
    rows : tuple of VarianceRow
        Analysis of variance.
    n_parts, n_conditions, n_trials : int
        Size of the study.
    pooled : bool
        Whether the interaction was taken as repeatability.
    distinct_categories : int
        How many groups of parts the gauge can tell apart; at least 5 are wanted.
    tolerance : float or None
        Width of the tolerance that the shares refer to.
    coverage : float
        Of the intervals.
    messages : tuple of str
        In plain words.
    """

    repeatability: Quantity
    reproducibility: Quantity
    interaction: Quantity
    gauge: Quantity
    parts: Quantity
    total: Quantity
    interval: Mapping[str, tuple[float, float]]
    rows: tuple[VarianceRow, ...]
    n_parts: int
    n_conditions: int
    n_trials: int
    pooled: bool
    distinct_categories: int
    tolerance: float | None = None
    coverage: float = 0.95
    messages: tuple[str, ...] = field(default=())

    def shares(self) -> dict[str, float]:
        """Return each standard deviation as a share of the total one.

        Returns
        -------
        dict of str to float
            They do not add up to one: their squares do.
        """
        total = self.total.value
        return {
            name: getattr(self, name).value / total if total > 0.0 else math.nan
            for name in ("repeatability", "reproducibility", "gauge", "parts")
        }

    @property
    def share_of_tolerance(self) -> float:
        """Six standard deviations of the gauge over the width of the tolerance; NaN without one."""
        return math.nan if self.tolerance is None else 6.0 * self.gauge.value / self.tolerance

    def to_dict(self) -> dict[str, Any]:
        """Return everything as plain values.

        Returns
        -------
        dict
            For JSON; NaN stays NaN.
        """
        names = ("repeatability", "reproducibility", "interaction", "gauge", "parts", "total")
        return {
            **{name: getattr(self, name).to_dict() for name in names},
            "interval": {k: list(v) for k, v in self.interval.items()},
            "rows": [
                {k: getattr(row, k) for k in ("source", "squares", "dof", "mean_square", "f", "p")}
                for row in self.rows
            ],
            "n_parts": self.n_parts,
            "n_conditions": self.n_conditions,
            "n_trials": self.n_trials,
            "pooled": self.pooled,
            "distinct_categories": self.distinct_categories,
            "share_of_tolerance": self.share_of_tolerance,
            "messages": list(self.messages),
        }


def gauge_study(
    readings: ArrayLike,
    *,
    unit: str = "m",
    tolerance: float | None = None,
    pool: float = _POOL,
    coverage: float = 0.95,
    name: str = "readings",
) -> GaugeStudy:
    """Return how the spread of readings divides between gauge and parts.

    Parameters
    ----------
    readings : array_like, shape (n_parts, n_conditions, n_trials)
        Values of one characteristic; every part in every condition as often as every other.
    unit : str, optional
        SI unit of the readings.
    tolerance : float, optional
        Upper minus lower limit, in the unit of the readings.
    pool : float, optional
        The interaction is pooled with the repeatability where its p exceeds this; 1 never pools,
        0 always does.
    coverage : float, optional
        Of the confidence intervals.
    name : str, optional
        Of the characteristic, for messages.

    Returns
    -------
    GaugeStudy
        Standard deviations, intervals, analysis of variance.

    Raises
    ------
    InvalidSamplesError
        If a reading is missing or infinite, or the shape is another.
    TooFewSamplesError
        If there are fewer than two parts, or fewer than two trials.
    DataError
        If `tolerance`, `pool` or `coverage` is out of range.

    Notes
    -----
    With p parts, k conditions, r trials and random effects the mean squares estimate
    ``E(MS_P) = s_E^2 + r s_I^2 + k r s_P^2``, ``E(MS_O) = s_E^2 + r s_I^2 + p r s_O^2``,
    ``E(MS_I) = s_E^2 + r s_I^2``, ``E(MS_E) = s_E^2``. A variance that comes out below zero is taken
    as zero, and a message says so. One condition gives the one-way analysis: reproducibility is not
    determined then (NaN). The interval of the gauge is that of modified large sample (Burdick,
    Borror and Montgomery 2003, 2005). Missing readings are refused: the shares of an unbalanced study
    depend on the order of the terms.

    References
    ----------
    .. [1] AIAG, Measurement Systems Analysis, 4th ed., 2010, chapter III B, ANOVA method.
    .. [2] R. K. Burdick, C. M. Borror and D. C. Montgomery, J. Quality Technology 35 (2003) 342-354.

    Examples
    --------
    >>> study = gauge_study([[[1.0, 1.2], [1.1, 1.3]], [[3.0, 3.2], [3.1, 3.3]], [[5.1, 5.0], [5.2, 5.1]]])
    >>> round(study.repeatability.value, 3), study.n_parts
    (0.106, 3)
    """
    values = _checked(readings, name)
    _check_options(tolerance, pool, coverage)
    p, k, r = values.shape
    rows = _analysis(values)
    messages: list[str] = []
    pooled = k > 1 and bool(rows["interaction"].p > pool)
    if pooled:
        a, b = rows["repeatability"], rows["interaction"]
        rows["repeatability"] = _row("repeatability", a.squares + b.squares, a.dof + b.dof)
        rows["conditions"] = _tested(rows["conditions"], rows["repeatability"])
        rows["parts"] = _tested(rows["parts"], rows["repeatability"])
        messages.append(
            f"the interaction is not significant (p = {rows['interaction'].p:.2f} > {pool:g}) and "
            "counts as repeatability"
        )
    weights = _weights(p, k, r, pooled=pooled)
    found = {
        part: _component(part, weight, rows, unit, messages) for part, weight in weights.items()
    }
    gauge = found["gauge"].value
    categories = int(_NDC * found["parts"].value / gauge) if gauge > 0.0 else 0
    if k == 1:
        messages.append(
            "one condition only: reproducibility is not determined, and not in the gauge"
        )
    if categories < 5:
        messages.append(
            f"the gauge tells {categories} groups of these parts apart; 5 are wanted to control a process"
        )
    return GaugeStudy(
        **found,
        interval=_intervals(rows, weights["gauge"], coverage),
        rows=tuple(rows.values()),
        n_parts=p,
        n_conditions=k,
        n_trials=r,
        pooled=pooled,
        distinct_categories=categories,
        tolerance=tolerance,
        coverage=coverage,
        messages=tuple(messages),
    )


def _checked(readings: ArrayLike, name: str) -> FloatArray:
    try:
        values = np.asarray(readings, dtype=np.float64)
    except (TypeError, ValueError):
        raise InvalidSamplesError(
            f"{name}: every part needs the same number of trials in every condition"
        ) from None
    if values.ndim != 3:
        raise InvalidSamplesError(
            f"{name} must have shape (parts, conditions, trials), got {values.shape}"
        )
    bad = ~np.isfinite(values)
    if bad.any():
        i, j, t = np.argwhere(bad)[0] + 1
        raise InvalidSamplesError(
            f"{name}: {int(bad.sum())} readings are missing or infinite, the first of part {i}, "
            f"condition {j}, trial {t}; measure it again, or leave the part out"
        )
    p, k, r = values.shape
    if p < 2 or k < 1 or r < 2:
        raise TooFewSamplesError(
            f"{name}: {p} parts, {k} conditions and {r} trials; at least 2 parts and 2 trials are "
            "needed (10 parts, 3 conditions and 3 trials are usual)"
        )
    return values


def _check_options(tolerance: float | None, pool: float, coverage: float) -> None:
    if tolerance is not None:
        positive(tolerance, "the width of the tolerance")
    between(pool, "pool", 0.0, 1.0)
    if not 0.0 < coverage < 1.0:
        raise DataError(f"coverage lies between 0 and 1, got {coverage}")


def _analysis(values: FloatArray) -> dict[str, VarianceRow]:
    """Return the lines of the analysis of variance by source."""
    p, k, r = values.shape
    centred = values - values.mean()
    cells = centred.mean(axis=2)
    parts, conditions = centred.mean(axis=(1, 2)), centred.mean(axis=(0, 2))
    between = cells - parts[:, None] - conditions[None, :]
    within = centred - cells[:, :, None]
    rows = {"parts": _row("parts", k * r * float(parts @ parts), p - 1)}
    if k > 1:
        rows["conditions"] = _row("conditions", p * r * float(conditions @ conditions), k - 1)
        rows["interaction"] = _row("interaction", r * float((between**2).sum()), (p - 1) * (k - 1))
    rows["repeatability"] = _row("repeatability", float((within**2).sum()), p * k * (r - 1))
    rows["total"] = VarianceRow("total", float((centred**2).sum()), p * k * r - 1)
    against = rows["interaction"] if k > 1 else rows["repeatability"]
    rows["parts"] = _tested(rows["parts"], against)
    if k > 1:
        rows["conditions"] = _tested(rows["conditions"], against)
        rows["interaction"] = _tested(rows["interaction"], rows["repeatability"])
    return rows


def _row(source: str, squares: float, dof: int) -> VarianceRow:
    return VarianceRow(source, squares, dof, squares / dof)


def _tested(row: VarianceRow, against: VarianceRow) -> VarianceRow:
    """Return a line with its F test against another."""
    from scipy.special import fdtrc

    if against.mean_square > 0.0:
        f = row.mean_square / against.mean_square
        probability = float(fdtrc(row.dof, against.dof, f))
    else:
        f, probability = (math.inf, 0.0) if row.mean_square > 0.0 else (math.nan, math.nan)
    return VarianceRow(row.source, row.squares, row.dof, row.mean_square, f, probability)


def _weights(p: int, k: int, r: int, *, pooled: bool) -> dict[str, dict[str, float]]:
    """Return each variance as a weighted sum of mean squares."""
    if k == 1:
        own = {"repeatability": 1.0}
        part = {"parts": 1.0 / r, "repeatability": -1.0 / r}
        return {
            "repeatability": own,
            "reproducibility": {},
            "interaction": {},
            "gauge": own,
            "parts": part,
            "total": _sum(own, part),
        }
    rest = "repeatability" if pooled else "interaction"
    repeatability = {"repeatability": 1.0}
    interaction = {} if pooled else {"interaction": 1.0 / r, "repeatability": -1.0 / r}
    condition = {"conditions": 1.0 / (p * r), rest: -1.0 / (p * r)}
    part = {"parts": 1.0 / (k * r), rest: -1.0 / (k * r)}
    reproducibility = _sum(condition, interaction)
    gauge = _sum(repeatability, reproducibility)
    return {
        "repeatability": repeatability,
        "reproducibility": reproducibility,
        "interaction": interaction,
        "gauge": gauge,
        "parts": part,
        "total": _sum(gauge, part),
    }


def _sum(*weights: Mapping[str, float]) -> dict[str, float]:
    out: dict[str, float] = {}
    for one in weights:
        for source, value in one.items():
            out[source] = out.get(source, 0.0) + value
    return out


_DEFINITIONS = {
    "repeatability": "standard deviation of one reading of one part in one condition",
    "reproducibility": "standard deviation between conditions, with their interaction with parts",
    "interaction": "standard deviation of how conditions treat parts differently",
    "gauge": "standard deviation of repeatability and reproducibility together (GRR)",
    "parts": "standard deviation of the parts",
    "total": "standard deviation of a reading of any part in any condition",
}


def _component(
    part: str,
    weights: Mapping[str, float],
    rows: Mapping[str, VarianceRow],
    unit: str,
    messages: list[str],
) -> Quantity:
    """Return a standard deviation with its standard uncertainty."""
    if not weights:
        known = part == "interaction" and "interaction" in rows
        return Quantity(0.0 if known else math.nan, unit, _DEFINITIONS[part], symbol=part)
    terms = [(w, rows[s].mean_square, rows[s].dof) for s, w in weights.items()]
    variance = math.fsum(w * ms for w, ms, _ in terms)
    spread = math.sqrt(math.fsum(2.0 * (w * ms) ** 2 / dof for w, ms, dof in terms))
    if variance < 0.0:
        messages.append(
            f"the variance of {part} comes out below zero and is taken as zero: it is lost in the "
            "repeatability"
        )
        variance = 0.0
    sd = math.sqrt(variance)
    u = spread / (2.0 * sd) if sd > 0.0 else None
    return Quantity(sd, unit, _DEFINITIONS[part], u, symbol=part)


def _intervals(
    rows: Mapping[str, VarianceRow], gauge: Mapping[str, float], coverage: float
) -> dict[str, tuple[float, float]]:
    """Return confidence intervals: exact of the repeatability, modified large sample of the gauge."""
    from scipy.special import fdtri

    tail = 0.5 * (1.0 - coverage)

    def lower(dof: int) -> float:  # 1 - 1 / F at infinitely many denominators
        return 1.0 - 1.0 / float(fdtri(dof, 1e9, 1.0 - tail))

    def upper(dof: int) -> float:
        return 1.0 / float(fdtri(dof, 1e9, tail)) - 1.0

    own = rows["repeatability"]
    exact = (
        math.sqrt(own.mean_square * (1.0 - lower(own.dof))),
        math.sqrt(own.mean_square * (1.0 + upper(own.dof))),
    )
    if set(gauge) == {"repeatability"}:
        return {"repeatability": exact, "gauge": exact}
    terms = [(w, rows[s].mean_square, rows[s].dof) for s, w in gauge.items()]
    variance = math.fsum(w * ms for w, ms, _ in terms)
    # positive weights widen their own side, negative ones the other
    down = math.fsum(((lower if w > 0 else upper)(d) * w * ms) ** 2 for w, ms, d in terms)
    up = math.fsum(((upper if w > 0 else lower)(d) * w * ms) ** 2 for w, ms, d in terms)
    bounds = (variance - math.sqrt(down), variance + math.sqrt(up))
    low, high = (math.sqrt(max(b, 0.0)) for b in bounds)
    return {"repeatability": exact, "gauge": (low, high)}


# ---- capability of a process from single values, and control limits of a chart of individuals ----
# Cp = (upper - lower) / (6 s), Cpk = min(upper - mean, mean - lower) / (3 s) with the standard deviation s of
# all values about their mean. Where the chart shows no stable process these are the indices of
# performance Pp and Ppk of ISO 22514-2. s holds the scatter of the measurement too.

LEAST_VALUES = 20
"""With fewer values the interval of Cpk is wider than a third of it: no index is given."""

_LEVEL = 0.95
_INDIVIDUALS, _RANGES = 2.66, 3.267
"""3 / d2 and D4 for ranges of two values (d2 = 1.128)."""


@dataclass(frozen=True, slots=True)
class Capability:
    """Indices of a process with 95 % confidence intervals.

    Parameters
    ----------
    n : int
        Number of values.
    mean, sd : float
        Mean, and standard deviation with n - 1.
    cp, cp_low, cp_high : float or None
        Cp with its interval; ``None`` with one limit only.
    cpk, cpk_low, cpk_high : float
        Cpk with its interval.
    """

    n: int
    mean: float
    sd: float
    cp: float | None
    cp_low: float | None
    cp_high: float | None
    cpk: float
    cpk_low: float
    cpk_high: float


@dataclass(frozen=True, slots=True)
class ControlLimits:
    """Limits of a chart of individuals and of its moving ranges.

    Parameters
    ----------
    mean, lower, upper : float
        Centre line and limits of the values.
    mean_range, upper_range : float
        Centre line and upper limit of the moving ranges; the lower one is 0.
    """

    mean: float
    lower: float
    upper: float
    mean_range: float
    upper_range: float


def capability_of(
    values: Sequence[float | None], *, lower: float | None = None, upper: float | None = None
) -> Capability | None:
    """Return the capability of a process.

    Parameters
    ----------
    values : sequence of (float or None)
        One of each part; ``None`` and NaN were not measured and do not count.
    lower, upper : float, optional
        Limits in the same unit.

    Returns
    -------
    Capability or None
        ``None`` with fewer than 20 values, without a limit, or without any scatter: at most 1e-12 of
        the mean or a limit is rounding.

    Raises
    ------
    DataError
        If the limits are not in order or not finite.

    Notes
    -----
    The interval of Cp is exact for normal values: Cp sqrt(chi2(0.025, n-1) / (n-1)) to
    Cp sqrt(chi2(0.975, n-1) / (n-1)) [1]_. That of Cpk is the approximation of Bissell [2]_:
    Cpk (1 ± 1.96 sqrt(1 / (9 n Cpk^2) + 1 / (2 (n - 1)))), which is written here so that Cpk = 0 has
    one too.

    References
    ----------
    .. [1] D. C. Montgomery, Introduction to Statistical Quality Control, section on confidence
       intervals of process capability ratios.
    .. [2] A. F. Bissell, How reliable is your capability index?, Applied Statistics 39 (1990) 331.

    Examples
    --------
    >>> found = capability_of([1.0, 3.0] * 10, lower=-4.0, upper=8.0)
    >>> f"{found.cp:.3f} {found.cpk:.3f}"
    '1.949 1.949'
    """
    limits = [v for v in (lower, upper) if v is not None]
    if any(not math.isfinite(v) for v in limits) or (len(limits) == 2 and limits[0] >= limits[1]):
        raise limits_error(lower, upper)
    known = [v for v in values if v is not None and math.isfinite(v)]
    if len(known) < LEAST_VALUES or not limits:
        return None
    mean, sd = float(np.mean(known)), float(np.std(known, ddof=1))
    if not sd > RELATIVE_FLOOR * max(abs(mean), *(abs(v) for v in limits)):  # rounding only
        return None
    n = len(known)
    below = math.inf if lower is None else mean - lower
    above = math.inf if upper is None else upper - mean
    cpk = min(below, above) / (3.0 * sd)
    cp = (limits[1] - limits[0]) / (6.0 * sd) if len(limits) == 2 else None
    half = 1.959963984540054 * math.sqrt(1.0 / (9.0 * n) + cpk**2 / (2.0 * (n - 1)))
    low, high = _cp_factors(n)
    return Capability(
        n, mean, sd, cp,
        None if cp is None else cp * low,
        None if cp is None else cp * high,
        cpk, cpk - half, cpk + half,
    )  # fmt: skip


def control_limits(values: Sequence[float | None] | FloatArray) -> ControlLimits | None:
    """Return the control limits of a chart of individuals.

    Parameters
    ----------
    values : sequence of (float or None), or ndarray, shape (n,)
        In their order; ``None`` and NaN were not measured.

    Returns
    -------
    ControlLimits or None
        ``None`` where no two neighbours are known.

    Notes
    -----
    Limits are mean ± 2.66 times the mean moving range of two neighbours, the upper limit of the
    ranges 3.267 times it [1]_. A gap has no range to either side.

    References
    ----------
    .. [1] ISO 7870-2:2023 and D. C. Montgomery, Introduction to Statistical Quality Control, chart
       of individuals.

    Examples
    --------
    >>> control_limits([1.0, 3.0, 2.0]).mean_range
    1.5
    """
    numbers = np.array([math.nan if v is None else v for v in values], dtype=np.float64)
    numbers[~np.isfinite(numbers)] = math.nan
    ranges = np.abs(np.diff(numbers))
    ranges = ranges[~np.isnan(ranges)]
    if ranges.size == 0:
        return None
    mean, spread = float(np.nanmean(numbers)), float(np.mean(ranges))
    reach = _INDIVIDUALS * spread
    return ControlLimits(mean, mean - reach, mean + reach, spread, _RANGES * spread)


def _cp_factors(n: int) -> tuple[float, float]:
    from scipy.special import gammaincinv  # chi2(q, k) = 2 gammaincinv(k / 2, q)

    tail, k = 0.5 * (1.0 - _LEVEL), n - 1
    low, high = (math.sqrt(2.0 * float(gammaincinv(0.5 * k, q)) / k) for q in (tail, 1.0 - tail))
    return low, high
