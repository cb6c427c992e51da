"""Characteristics over a series of parts: control limits, which of them drift, which move together.

One table, a row for each part in the order of making: terms such as parameters, Zernike
coefficients or amplitudes of wavelengths. The question is not whether a part is good, but whether
the process that makes the parts stays what it was.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from metrosep.core._arrays import FloatArray, benjamini_hochberg, frozen_float
from metrosep.core.errors import DataError, InvalidSamplesError, TooFewSamplesError
from metrosep.parameters.gauge import control_limits
from metrosep.parameters.repeats import constant, term_floors

_FEWEST = 5
"""Parts below which a slope, its scatter and a correlation without it are not determined."""

_RUN = 9
"""So many values in a row on one side of the centre line are a signal (1 in 256 by chance)."""


@dataclass(frozen=True, slots=True, eq=False)
class TermSeries:
    """One term over the parts; values in its own unit.

    Parameters
    ----------
    name, unit : str
        Of the term.
    values : ndarray, shape (n_parts,)
        NaN where it is missing.
    mean, lower, upper : float
        Centre line and control limits of single values, mean -+ 2.66 times the mean moving range.
    range_upper : float
        Upper control limit of the moving range.
    beyond : tuple of int
        Parts outside the limits, from 0.
    runs : tuple of int
        Parts that complete a run of nine or more on one side of the centre line.
    slope, u_slope : float
        Change per part and its standard uncertainty, from the scatter about the line.
    drift, u_drift : float
        Change from the first to the last part.
    p : float
        Probability of so large a slope by chance.
    drifts : bool
        Whether it is beyond chance among all terms (false discovery rate).
    constant : bool
        Whether the values differ by rounding only (`metrosep.parameters.repeats`): slope and
        drift with their u are zero then, limits and p NaN.
    """

    name: str
    unit: str
    values: FloatArray
    mean: float
    lower: float
    upper: float
    range_upper: float
    beyond: tuple[int, ...]
    runs: tuple[int, ...]
    slope: float
    u_slope: float
    drift: float
    u_drift: float
    p: float
    drifts: bool = False
    constant: bool = False


@dataclass(frozen=True, slots=True, eq=False)
class PartSeries:
    """What a series of parts tells of its process.

    Parameters
    ----------
    terms : tuple of TermSeries
        In the order they were given.
    correlation : ndarray, shape (n_terms, n_terms)
        Of the terms without their slopes, so that two drifts alone are not correlation; NaN where
        fewer than five parts have both.
    correlated : tuple of (str, str, float)
        Pairs beyond chance, the strongest first; of terms that say the same the first stands for all.
    n_parts : int
        Length of the series.
    rate : float
        False discovery rate of both lists.
    messages : tuple of str
        In plain words.
    same : tuple of tuple of str
        Groups of terms that say the same: correlation of size 0.9999 or more from one to the next.
    """

    terms: tuple[TermSeries, ...]
    correlation: FloatArray
    correlated: tuple[tuple[str, str, float], ...]
    n_parts: int
    rate: float
    messages: tuple[str, ...] = field(default=())
    same: tuple[tuple[str, ...], ...] = ()

    @property
    def drifting(self) -> tuple[TermSeries, ...]:
        """Terms that drift, the surest first."""
        return tuple(sorted((t for t in self.terms if t.drifts), key=lambda t: t.p))

    def to_dict(self) -> dict[str, Any]:
        """Return everything as plain values.

        Returns
        -------
        dict
            For JSON; NaN stays NaN.
        """
        return {
            "n_parts": self.n_parts,
            "rate": self.rate,
            "terms": [
                {
                    **{k: getattr(t, k) for k in TermSeries.__dataclass_fields__ if k != "values"},
                    "values": t.values.tolist(),
                    "beyond": list(t.beyond),
                    "runs": list(t.runs),
                }
                for t in self.terms
            ],
            "correlation": self.correlation.tolist(),
            "correlated": [list(c) for c in self.correlated],
            "same": [list(s) for s in self.same],
            "messages": list(self.messages),
        }


def part_series(
    table: Mapping[str, ArrayLike],
    *,
    units: Mapping[str, str] | None = None,
    rate: float = 0.05,
    sizes: Mapping[str, float] | None = None,
) -> PartSeries:
    """Return control limits, drifts and correlations of terms over a series of parts.

    Parameters
    ----------
    table : mapping of str to array_like, shape (n_parts,)
        Values of each term in the order of making; NaN where a part has none.
    units : mapping of str to str, optional
        SI unit by term; ``"m"`` where it is not named.
    rate : float, optional
        False discovery rate, 0 < rate < 1.
    sizes : mapping of str to float, optional
        Largest value by SI unit of what else was measured, limits too: beside it, values may be
        rounding that would be a trend alone.

    Returns
    -------
    PartSeries
        Terms with fewer than five values are omitted, which a message says.

    Raises
    ------
    DataError
        If there is no term, or `rate` is out of range.
    InvalidSamplesError
        If terms differ in length, or a value is infinite.
    TooFewSamplesError
        If there are fewer than five parts.

    Notes
    -----
    Control limits are those of single values with moving ranges (ISO 7870-2): mean -+ 2.660 times
    the mean range of neighbours, 3.267 times it for the range. A range across a missing part is
    not counted. The slope is that of the least-squares line over the number of the part; its test
    takes the scatter about the line as independent from part to part. Correlation is that of the
    remainders about both lines, tested with n - 3 degrees of freedom; over all pairs the false
    discovery rate is held (Benjamini and Hochberg).

    A term whose values have a range of at most 1e-12 of the largest value of its unit (m and rad;
    at most 1e-15 there), or of its own largest, is constant: neither test counts it. Pairs with a
    correlation of size 0.9999 or more are identities, such as Sq and the RMS of the residual; they are named in `same`
    and not tested, and the first term of each group takes part in the other tests alone.

    References
    ----------
    .. [1] ISO 7870-2:2013, Control charts - Shewhart control charts, 5.3.
    .. [2] Benjamini and Hochberg, J. R. Stat. Soc. B 57 (1995) 289-300.

    Examples
    --------
    >>> rng = np.random.default_rng(1)
    >>> wear = 2e-9 * np.arange(30) + 3e-9 * rng.standard_normal(30)
    >>> found = part_series({"Z8": wear, "Z9": 3e-9 * rng.standard_normal(30)})
    >>> [t.name for t in found.drifting]
    ['Z8']
    """
    if not 0.0 < rate < 1.0:
        raise DataError(f"the false discovery rate lies between 0 and 1, got {rate}")
    columns = _columns(table)
    known = {k: v for k, v in columns.items() if int((~np.isnan(v)).sum()) >= _FEWEST}
    messages = [
        f"{k}: only {int((~np.isnan(v)).sum())} parts have it; omitted, {_FEWEST} are needed"
        for k, v in columns.items()
        if k not in known
    ]
    if not known:
        raise TooFewSamplesError(f"no term has {_FEWEST} values; {'; '.join(messages)}")
    floors = term_floors(known, units or {}, sizes)
    terms = [_term(k, (units or {}).get(k, "m"), v, floors[k]) for k, v in known.items()]
    messages += [
        f"{t.name}: the same in all parts to within rounding" for t in terms if t.constant
    ]
    tested = np.array([t.p for t in terms])
    sure = np.zeros(len(terms), dtype=bool)
    fine = ~np.isnan(tested)
    sure[fine] = benjamini_hochberg(tested[fine], rate=rate)
    terms = [replace(t, drifts=bool(s)) for t, s in zip(terms, sure, strict=True)]
    moving = {t.name: None if t.constant else t.values for t in terms}
    correlation, pairs, same = correlations(moving, fewest=_FEWEST, rate=rate)
    n = len(next(iter(columns.values())))
    return PartSeries(tuple(terms), correlation, pairs, n, rate, tuple(messages), same)


def _columns(table: Mapping[str, ArrayLike]) -> dict[str, FloatArray]:
    if not table:
        raise DataError("there is no term; give a value of each part by the name of the term")
    columns = {name: np.asarray(v, dtype=np.float64) for name, v in table.items()}
    first = next(iter(columns))
    n = columns[first].size
    for name, v in columns.items():
        if v.ndim != 1 or v.size != n:
            raise InvalidSamplesError(
                f"{name} has shape {v.shape}, {first} has ({n},): one value of each part is needed"
            )
        if np.isinf(v).any():
            raise InvalidSamplesError(
                f"{name}: part {int(np.flatnonzero(np.isinf(v))[0]) + 1} is infinite; write NaN "
                "where it is missing"
            )
    if n < _FEWEST:
        raise TooFewSamplesError(f"the series has {n} parts; at least {_FEWEST} are needed")
    return columns


def _term(name: str, unit: str, values: FloatArray, floor: float) -> TermSeries:
    from scipy.special import stdtr

    index = np.flatnonzero(~np.isnan(values))
    v = values[index]
    mean = float(v.mean())
    if constant(v, floor):
        none = math.nan
        kept = frozen_float(values, name=name, ndim=1)
        return TermSeries(
            name, unit, kept, mean, none, none, none, (), (), 0.0, 0.0, 0.0, 0.0, none,
            constant=True,
        )  # fmt: skip
    chart = control_limits(values)
    lower, upper, range_upper = (
        (math.nan, math.nan, math.nan)
        if chart is None
        else (chart.lower, chart.upper, chart.upper_range)
    )
    x = index - index.mean()
    slope = float(x @ v / (x @ x))
    left = v - mean - slope * x
    scatter = float(left @ left) / (v.size - 2)
    u = math.sqrt(scatter / float(x @ x))
    scale = float(np.abs(v).max()) * np.finfo(float).eps * v.size
    if u * float(np.abs(x).max()) <= scale:  # on the line to within rounding
        p = 1.0 if abs(slope) * float(np.abs(x).max()) <= scale else 0.0
    else:
        p = 2.0 * float(stdtr(v.size - 2, -abs(slope) / u))
    span = float(index[-1] - index[0])
    outside = (v < lower) | (v > upper)
    return TermSeries(
        name,
        unit,
        frozen_float(values, name=name, ndim=1),
        mean,
        lower,
        upper,
        range_upper,
        tuple(index[outside].tolist()),
        _runs(v > mean, v < mean, index),
        slope,
        u,
        slope * span,
        u * span,
        p,
    )


def _runs(
    above: NDArray[np.bool_], below: NDArray[np.bool_], index: NDArray[Any]
) -> tuple[int, ...]:
    """Return the parts at which nine or more in a row lie on one side."""
    found = []
    length, side = 0, 0
    for k, (up, down) in enumerate(zip(above, below, strict=True)):
        now = int(up) - int(down)
        length = length + 1 if now == side and now else int(now != 0)
        side = now
        if length >= _RUN:
            found.append(int(index[k]))
    return tuple(found)


# ---- which terms of a series of parts move together, and which say the same --------------------

IDENTITY = 0.9999
"""From this size of r on two terms are one: less than 1.5 % of the scatter of one is not in the other."""

_Pairs = tuple[tuple[str, str, float], ...]


def correlations(
    columns: Mapping[str, FloatArray | None], *, fewest: int, rate: float
) -> tuple[FloatArray, _Pairs, tuple[tuple[str, ...], ...]]:
    """Return the correlation of terms about their lines, the pairs beyond chance, and what is the same."""
    names = list(columns)
    matrix = np.full((len(names), len(names)), np.nan)
    counts: dict[tuple[int, int], int] = {}
    for i, a in enumerate(columns.values()):
        matrix[i, i] = 1.0
        for j, b in enumerate(columns.values()):
            if j <= i or a is None or b is None:
                continue
            both = ~(np.isnan(a) | np.isnan(b))
            r = _about_lines(a, b, both) if int(both.sum()) >= fewest else None
            if r is not None:
                matrix[i, j] = matrix[j, i] = r
                counts[i, j] = int(both.sum())
    matrix.setflags(write=False)
    groups = _groups(matrix)
    first = {group[0] for group in groups}
    tested = [pair for pair in counts if first.issuperset(pair)]
    same = tuple(tuple(names[i] for i in g) for g in groups if len(g) > 1)
    if not tested:
        return matrix, (), same
    chance = np.array([_chance(float(matrix[p]), counts[p]) for p in tested])
    sure = benjamini_hochberg(chance, rate=rate)
    kept = sorted(
        (pair for pair, s in zip(tested, sure, strict=True) if s), key=lambda p: -abs(matrix[p])
    )
    return matrix, tuple((names[i], names[j], float(matrix[i, j])) for i, j in kept), same


def _about_lines(a: FloatArray, b: FloatArray, both: NDArray[np.bool_]) -> float | None:
    left, right = (_without_line(v, both) for v in (a, b))
    size = math.sqrt(float(left @ left)) * math.sqrt(float(right @ right))
    return None if size == 0.0 else max(-1.0, min(1.0, float(left @ right) / size))


def _chance(r: float, n: int) -> float:
    """Return the probability of so large a correlation of n parts about two lines by chance."""
    from scipy.special import stdtr

    left = 1.0 - r * r
    return 2.0 * float(stdtr(n - 3, -abs(r) * math.sqrt((n - 3) / left))) if left > 0.0 else 0.0


def _groups(matrix: FloatArray) -> list[list[int]]:
    """Return the terms, those that say the same together, in their order."""
    groups: list[list[int]] = []
    for i in range(len(matrix)):
        linked = [g for g in groups if any(abs(matrix[i, k]) >= IDENTITY for k in g)]
        groups = [g for g in groups if g not in linked]
        groups.append(sorted([i, *(k for g in linked for k in g)]))
    return sorted(groups)


def _without_line(values: FloatArray, both: NDArray[np.bool_]) -> FloatArray:
    """Return values less their line, zero where rounding is all that is left."""
    index = np.flatnonzero(both)
    v = values[index]
    x = index - index.mean()
    left = v - v.mean() - (float(x @ v) / float(x @ x)) * x
    rounding = float(np.abs(v).max()) * np.finfo(float).eps * v.size
    return np.zeros_like(left) if float(np.abs(left).max()) <= rounding else np.asarray(left)
