"""What a turning job predicts: the error of each cause over the part, and the corrected program.

Errors are actual minus nominal along z, out of the material; a correction is the negative.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any, Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray

from metrosep.core import numbers
from metrosep.core._arrays import FloatArray
from metrosep.core.errors import DataError, InvalidSamplesError, TooFewSamplesError
from metrosep.core.quantity import Quantity
from metrosep.core.units import format_length
from metrosep.process._plain import Frozen, OnPart, frozen, known, real_array
from metrosep.process.follow_ups import drawn_pv, square_root

if TYPE_CHECKING:
    import pandas as pd

DRAWS, SEED = 4000, 20080415
LIKELY = (0.025, 0.975)
"""Quantiles of the interval of a Monte Carlo."""


@dataclass(frozen=True, slots=True, eq=False)
class Prediction(Frozen, OnPart):
    """Form error before the part is cut.

    Parameters
    ----------
    budget : ErrorBudget
        Causes as maps over the same points, or as a P-V.
    rho, azimuth : ndarray, shape (n,), m and rad
        Points on the part.
    removed : tuple of str
        What was taken off each map.
    messages : tuple of str
        What to know.
    audit : mapping
        Settings, units in the keys.
    """

    budget: ErrorBudget
    rho: FloatArray
    azimuth: FloatArray
    removed: tuple[str, ...]
    messages: tuple[str, ...]
    audit: Mapping[str, Any] = field(default_factory=dict)

    @property
    def maps(self) -> dict[str, FloatArray]:
        """Error of each cause that has a map, m."""
        return {c.name: c.map for c in self.budget.contributions if c.map is not None}

    @property
    def total(self) -> FloatArray:
        """Sum of the maps, m; NaN where one is not known."""
        return np.asarray(np.sum(list(self.maps.values()), axis=0), dtype=np.float64)


def pv_quantities(budget: ErrorBudget) -> dict[str, Quantity]:
    """Return the P-V of each cause and of each total with unit and definition."""
    found = {
        f"{c.name}.pv": Quantity(float(c.pv or 0.0), "m", f"P-V of the error by {c.name}", u=c.u)
        for c in budget.contributions
    }
    for way, total in budget.totals().items():
        u = None if np.isnan(total.u) else total.u
        found[way] = Quantity(total.pv, "m", total.definition, u=u, symbol=f"PV {way}")
    return found


# ---- error budgets: contributions to the form error, put together in four ways side by side ----
# Errors are actual minus nominal along z. A contribution is a map, or only a P-V somebody states.
# Peak to valley does not add: the maps do. What a sum of P-Vs, their root sum of squares and a Monte
# Carlo say about the same part differs by factors, so a budget prints all that can be computed.
#
# Source: the budget of slow-tool-servo (Figs 14, 16 and 18), which adds P-Vs.

Combination = Literal["pointwise", "sum", "rss", "monte-carlo"]

WAYS: tuple[Combination, ...] = ("pointwise", "sum", "rss", "monte-carlo")

_DEFINITIONS = {
    "pointwise": "P-V of the sum of the maps",
    "sum": "sum of the P-Vs: the worst case",
    "rss": "root of the sum of squared P-Vs: for independent causes of one kind",
    "monte-carlo": "P-V of the sum with each cause drawn within its uncertainty, median of the draws",
}

_MOST_DRAWS = 1_000_000
_FOLDED = 0.2
"""Of u: an expected P-V that is off the stated one by more is worth a message."""


@dataclass(frozen=True, slots=True)
class BudgetTotal:
    """A combined error.

    Parameters
    ----------
    way : str
        How the contributions were put together.
    pv : float, m
        Peak to valley.
    u : float, m
        Standard uncertainty; NaN where no contribution has one.
    definition : str
        What the number is.
    interval : tuple of (float, float) or None, m
        Between 2.5 and 97.5 % of the draws within the uncertainties.
    expected : float or None, m
        Mean of the draws; for a sum that of the expected P-Vs, for a root sum of squares the root
        of their mean square. None where nothing is drawn.
    messages : tuple of str
        What to know, in plain words.
    """

    way: str
    pv: float
    u: float
    definition: str
    interval: tuple[float, float] | None = None
    expected: float | None = None
    messages: tuple[str, ...] = ()


@dataclass(frozen=True, slots=True, eq=False, init=False, repr=False)
class ErrorBudget:
    """Contributions to the form error of a part.

    Parameters
    ----------
    contributions : sequence of Contribution or of tuple (name, P-V in m[, u in m])
        Causes, each once.
    weights : array_like, optional
        Area that each point of the maps stands for, in any unit; equal areas if omitted. For
        `variance_shares` only: a P-V has no weights.

    Raises
    ------
    DataError
        If there is none, one is not a contribution, a name occurs twice, maps have different shapes,
        or the weights do not fit them.

    Notes
    -----
    Only maps that lie on the same points add pointwise. A P-V without a map has an unknown shape:
    "pointwise" and "monte-carlo" refuse it by name, rather than to assume one. Points that are NaN
    in one map count in no total of maps; `messages` counts them.

    Examples
    --------
    >>> budget = ErrorBudget([("tool", 22.0e-9), ("program", 7.6e-9), ("follow-up", 13e-9)])
    >>> round(budget.combine("sum").pv * 1e9, 1), round(budget.combine("rss").pv * 1e9, 1)
    (42.6, 26.7)
    """

    contributions: tuple[Contribution, ...]
    weights: FloatArray | None
    _found: dict[Any, Any]

    def __init__(
        self,
        contributions: Sequence[Contribution | tuple[str, float] | tuple[str, float, float]],
        *,
        weights: ArrayLike | None = None,
    ) -> None:
        if isinstance(contributions, str | bytes | dict) or not hasattr(contributions, "__iter__"):
            raise DataError(
                "a budget takes a sequence of contributions or of (name, P-V in m, u in m), got "
                f"{type(contributions).__name__}"
            )
        items = tuple(_contribution(i, c) for i, c in enumerate(contributions))
        if not items:
            raise DataError("a budget needs at least one contribution")
        names = [c.name for c in items]
        twice = sorted({n for n in names if names.count(n) > 1})
        if twice:
            raise DataError(f"the contribution {twice[0]!r} is given twice; give each cause once")
        shapes = {c.name: c.map.shape for c in items if c.map is not None}
        if len(set(shapes.values())) > 1:
            text = ", ".join(f"{n} {s}" for n, s in shapes.items())
            raise DataError(
                f"the maps of a budget share their points; their shapes differ: {text}"
            )
        object.__setattr__(self, "contributions", items)
        shape = next(iter(shapes.values()), None)
        object.__setattr__(self, "weights", _checked_weights(weights, shape))
        object.__setattr__(self, "_found", {})

    def __repr__(self) -> str:
        parts = (f"{c.name} {format_length(float(c.pv or 0.0))}" for c in self.contributions)
        return f"ErrorBudget({', '.join(parts)})"

    @property
    def messages(self) -> tuple[str, ...]:
        """What to know about the totals, in plain words."""
        if "messages" not in self._found:
            self._found["messages"] = (*self._missing(), *_warnings(self.contributions))
        found: tuple[str, ...] = self._found["messages"]
        return found

    def _missing(self) -> list[str]:
        """Return what is said about points that a map or a mode lacks."""
        mapped = [c for c in self.contributions if c.map is not None]
        if len(mapped) < len(self.contributions):
            mapped = []
        said = []
        lost = {c.name: np.isnan(np.ravel(c.map)) for c in mapped}  # type: ignore[arg-type]
        gone = np.any(list(lost.values()), axis=0) if lost else np.zeros(1, dtype=bool)
        if gone.any():
            each = ", ".join(f"{n!r} {int(b.sum())}" for n, b in lost.items() if b.any())
            said.append(
                f"{int(gone.sum())} of {gone.size} points have no value in every map ({each}) and "
                "count in no total of maps"
            )
        for c in mapped:
            if c.modes is None:
                continue
            vague = np.isnan(c.deviations()).any(axis=0) & ~gone
            if vague.any():
                said.append(
                    f"{int(vague.sum())} of {vague.size} points of {c.name!r} have an error without "
                    "an uncertainty; they are omitted from the draws"
                )
        return said

    @property
    def shares(self) -> dict[str, float]:
        """Share of each P-V in their sum."""
        sizes = self._sizes()
        total = float(sizes.sum())
        return {
            c.name: float(s / total) if total else float("nan")
            for c, s in zip(self.contributions, sizes, strict=True)
        }

    @property
    def variance_shares(self) -> dict[str, float]:
        """Share of each map in the mean square over the area; negative where it takes from the rest.

        Raises
        ------
        DataError
            If a contribution has no map.
        """
        maps, good = self._maps("a share of the mean square")
        area = np.ones(maps.shape[1]) if self.weights is None else np.ravel(self.weights)[good]
        if not area.any():
            raise DataError("no point with a value in every map has a weight above 0")
        centred = maps - (maps @ area / area.sum())[:, None]
        total = centred.sum(axis=0)
        square = float((total * area) @ total)
        return {
            c.name: float((m * area) @ total) / square if square else float("nan")
            for c, m in zip(self.contributions, centred, strict=True)
        }

    def combine(self, way: Combination, *, draws: int = DRAWS, seed: int = SEED) -> BudgetTotal:
        """Return the combined P-V.

        Parameters
        ----------
        way : {"pointwise", "sum", "rss", "monte-carlo"}
            Sum of maps, sum of P-Vs, root sum of squares, or draws within the uncertainties.
        draws : int, optional
            Of a Monte Carlo, 100 to 1,000,000; "pointwise" takes its u from it.
        seed : int, optional
            Of a Monte Carlo, >= 0.

        Returns
        -------
        BudgetTotal
            P-V, standard uncertainty, definition.

        Raises
        ------
        DataError
            If the way is not one of those above, needs maps that are not there, or a number cannot
            be used.
        TooFewSamplesError
            If no point has all maps, or fewer than 100 draws are wanted.

        Notes
        -----
        u of the sum and of the root sum of squares by first order from the contributions', which
        keeps a P-V below its u at its u. The Monte Carlo multiplies a map with u by ``1 + xi u /
        P-V``, xi normal: it keeps its shape and varies in size; to one with modes it adds them,
        drawn with their covariance. u is the standard deviation of the P-V. Where a map of P-V 0
        has a u, its shape is not known and the u is added in full. Draws are made once and kept.
        """
        numbers.choice(way, "way", WAYS)
        count = numbers.count(draws, "draws", most=_MOST_DRAWS)
        seed = numbers.count(seed, "seed", least=0)
        if way in ("sum", "rss"):
            return self._of_sizes(way)
        if count < 100:
            raise TooFewSamplesError(f"a Monte Carlo needs 100 draws or more, got {draws}")
        value = self._pointwise(f'"{way}"')
        interval, expected, u = (value, value) if way == "monte-carlo" else None, None, math.nan
        if self._is_known:
            median, expected, u, interval = self._drawn(count, seed)
            value = median if way == "monte-carlo" else value
        return BudgetTotal(way, value, u, _DEFINITIONS[way], interval, expected, self.messages)

    @property
    def _is_known(self) -> bool:
        return any(c.u is not None for c in self.contributions)

    def _of_sizes(self, way: str) -> BudgetTotal:
        sizes = self._sizes()
        u = np.array([0.0 if c.u is None else c.u for c in self.contributions])
        found = [c.expected for c in self.contributions]
        means = np.array([s if e is None else e for e, s in zip(found, sizes, strict=True)])
        drawn = [e is not None for e in found]
        worst = float(np.sqrt((u**2).sum()))
        if way == "sum":
            value, spread, mean = float(sizes.sum()), worst, float(means.sum())
        else:
            value = float(np.sqrt((sizes**2).sum()))
            size = max(value, worst) or 1.0
            spread = float(np.sqrt(((np.maximum(sizes, u) * u) ** 2).sum())) / size
            mean = float(np.sqrt((means**2 + np.where(drawn, u, 0.0) ** 2).sum()))
        u_total, expected = spread if self._is_known else math.nan, mean if any(drawn) else None
        return BudgetTotal(way, value, u_total, _DEFINITIONS[way], None, expected, self.messages)

    def _pointwise(self, what: str) -> float:
        if "pointwise" not in self._found:
            self._found["pointwise"] = float(np.ptp(self._maps(what)[0].sum(axis=0)))
        return float(self._found["pointwise"])

    def _drawn(self, draws: int, seed: int) -> tuple[float, float, float, tuple[float, float]]:
        """Return median, mean, u and interval of the draws; made once."""
        if (draws, seed) in self._found:
            found: tuple[float, float, float, tuple[float, float]] = self._found[draws, seed]
            return found
        maps, good = self._maps('"monte-carlo"')
        rows = np.concatenate([c.deviations()[:, good] for c in self.contributions])
        known = ~np.isnan(rows).any(axis=0)
        if not known.any():
            raise TooFewSamplesError("no point has every map and every mode of the budget")
        base = maps.sum(axis=0)
        if not known.all():
            base, rows = base[known], rows[:, known]
        xi = np.random.default_rng(seed).standard_normal((draws, rows.shape[0]))
        values = drawn_pv(base, rows, xi)
        expected, u, (low, high) = spread_of(values)
        loose = math.hypot(*(float(c.u or 0.0) for c in self.contributions if c.is_shapeless))
        interval = max(low - 2.0 * loose, 0.0), high + 2.0 * loose
        made = float(np.median(values)), expected, float(np.hypot(u, loose)), interval
        self._found[draws, seed] = made
        return made

    def totals(self, *, draws: int = DRAWS, seed: int = SEED) -> dict[str, BudgetTotal]:
        """Return the combined errors of all ways that these contributions allow.

        Parameters
        ----------
        draws, seed : int, optional
            As of `combine`.

        Returns
        -------
        dict of str to BudgetTotal
            Without "pointwise" and "monte-carlo" where a contribution has no map.

        Raises
        ------
        DataError
            As of `combine`.
        """
        whole = all(c.map is not None for c in self.contributions)
        ways = WAYS if whole else WAYS[1:3]
        return {way: self.combine(way, draws=draws, seed=seed) for way in ways}

    @property
    def without_map(self) -> tuple[str, ...]:
        """Names of the contributions that are a P-V only."""
        return tuple(c.name for c in self.contributions if c.map is None)

    def to_frame(self, *, measured: float | None = None) -> pd.DataFrame:
        """Return contributions and totals, and the measured P-V beside them.

        Parameters
        ----------
        measured : float, m, optional
            P-V of the part as it was cut.

        Returns
        -------
        DataFrame
            Columns item, pv_nm, u_nm, share, definition, expected_nm, low_nm, high_nm; share of
            the sum of the P-Vs, mean and 95 % of the draws.

        Raises
        ------
        DataError
            If the measured value is negative or not finite, or as of `combine`.
        """
        import pandas as pd

        nan = float("nan")
        rows: list[tuple[Any, ...]] = []
        for c in self.contributions:
            what = "P-V of its map" if c.map is not None else "P-V as stated"
            rows.append((c.name, c.pv or 0.0, c.u, self.shares[c.name], what, *_drawn_of(c)))
        for way, t in self.totals().items():
            rows.append((f"total, {way}", t.pv, t.u, nan, t.definition, *_drawn_of(t)))
        if measured is not None:
            size = checked_size("measured", "P-V", measured)
            rows.append(("measured", size, nan, nan, "as cut", nan, nan, nan))
        columns = ["item", "pv_nm", "u_nm", "share", "definition"]
        table = pd.DataFrame(rows, columns=[*columns, "expected_nm", "low_nm", "high_nm"])
        lengths = [n for n in table.columns if n.endswith("_nm")]
        table[lengths] = 1e9 * table[lengths].astype(float)
        return table

    def to_dict(self) -> dict[str, Any]:
        """Return contributions and totals as plain values.

        Returns
        -------
        dict
            Keys with units; None where not known.

        Raises
        ------
        DataError
            As of `combine`.
        """
        rows = []
        for c in self.contributions:
            row = {"name": c.name, **_sizes_of(c), "share": known(self.shares[c.name])}
            rows.append(row | {"has_map": c.map is not None, **_spread(c)})
        totals = {
            way: {**_sizes_of(t), "definition": t.definition, **_spread(t)}
            for way, t in self.totals().items()
        }
        return {"contributions": rows, "totals": totals, "messages": list(self.messages)}

    def _sizes(self) -> FloatArray:
        return np.array([float(c.pv or 0.0) for c in self.contributions])

    def _maps(self, what: str) -> tuple[FloatArray, NDArray[np.bool_]]:
        """Return the maps at the points where all are known, one row for each, and these points."""
        if self.without_map:
            raise DataError(
                f"{what} needs the map of each contribution; {', '.join(self.without_map)} is a "
                'P-V only: give its map, or combine by "sum" or "rss"'
            )
        maps = np.array([np.ravel(c.map) for c in self.contributions])  # type: ignore[arg-type]
        good = ~np.isnan(maps).any(axis=0)
        if not good.any():
            raise TooFewSamplesError("no point has a value in every map of the budget")
        return (maps if good.all() else maps[:, good]), good


def _contribution(number: int, item: object) -> Contribution:
    if isinstance(item, Contribution):
        return item
    if not isinstance(item, tuple | list) or len(item) not in (2, 3):
        raise DataError(
            f"contribution {number} must be a Contribution or (name, P-V in m) or (name, P-V in m, "
            f"u in m), got {item!r}"
        )
    return Contribution(str(item[0]), *item[1:2], u=item[2] if len(item) == 3 else None)


def _checked_weights(
    weights: ArrayLike | None, shape: tuple[int, ...] | None
) -> FloatArray | None:
    if weights is None:
        return None
    array = real_array(weights, "weights")
    if array.shape != shape:
        raise DataError(
            f"the weights have the shape {array.shape}, the maps {shape}: give the area of each "
            "point of the maps"
        )
    if not (np.isfinite(array) & (array >= 0.0)).all() or not array.any():
        raise DataError("the weights are areas: finite, from 0 on, and not all 0")
    return frozen(array)


def _warnings(contributions: Sequence[Contribution]) -> list[str]:
    """Return what is said about uncertainties that have no shape, or fold a P-V at zero."""
    said = []
    for c in contributions:
        if c.is_shapeless:
            said.append(
                f"{c.name!r} has the P-V 0 and the u {format_length(float(c.u or 0.0))}, whose shape "
                "is not known: its u is added in full; give modes and cov"
            )
        if c.expected is None or c.interval is None or c.u is None or c.pv is None:
            continue
        if abs(c.expected - c.pv) > _FOLDED * c.u:
            low, high = (format_length(v) for v in c.interval)
            said.append(
                f"{c.name!r}: a P-V of {format_length(round(c.pv, 15))} as stated, but {format_length(c.expected)} "
                f"is expected within its uncertainty (95 %: {low} to {high}); its sign is not known"
            )
    return said


def _drawn_of(item: Contribution | BudgetTotal) -> tuple[float | None, float | None, float | None]:
    """Return mean and 95 % of the draws, m."""
    return item.expected, *(item.interval or (None, None))


def _sizes_of(item: Contribution | BudgetTotal) -> dict[str, float | None]:
    return {
        "pv_nm": 1e9 * float(item.pv or 0.0),
        "u_nm": None if item.u is None else known(1e9 * item.u),
    }


def _spread(item: Contribution | BudgetTotal) -> dict[str, Any]:
    interval = item.interval
    return {
        "expected_nm": None if item.expected is None else 1e9 * item.expected,
        "interval_nm": None if interval is None else [1e9 * v for v in interval],
    }


# ---- one cause of form error: a map or a P-V, and how it may vary --------------------------------


@dataclass(frozen=True, slots=True, eq=False)
class Contribution:
    """One cause of form error.

    Parameters
    ----------
    name : str
        Such as "tool setting".
    pv : float, optional, m
        Peak to valley; that of the map if omitted.
    map : array_like, optional, m
        Error along z at the points that all maps of a budget share; NaN = not known there.
    u : float, optional, m
        Standard uncertainty of the P-V; scales the map as a whole in a Monte Carlo.
    modes : array_like, shape (k, ...), optional
        Change of the map with each of k uncertain numbers, at the points of the map; NaN = not
        known there. Instead of `u`, which then follows.
    cov : array_like, shape (k, k), optional
        Covariance of these numbers; modes times its root are in m.

    Attributes
    ----------
    expected : float or None, m
        Mean P-V of the draws, with `modes`. A P-V is never negative: near zero it is above `pv`.
    interval : tuple of (float, float) or None, m
        Between 2.5 and 97.5 % of these draws.

    Raises
    ------
    DataError
        If there is neither a map nor a P-V, both disagree, a number cannot be used, modes and
        covariance do not fit, or `u` is given beside them.
    InvalidSamplesError
        If the map or a mode is infinite somewhere.
    TooFewSamplesError
        If the map is NaN everywhere, or no point has map and modes.

    Notes
    -----
    With modes the map of a draw is ``map + xi @ modes``, xi normal with the covariance: its size,
    its sign and its shape vary. `u` is the standard deviation of the P-V of 4000 draws, at the
    points that have map and modes.

    Examples
    --------
    >>> Contribution("tool setting", map=[-1e-9, 3e-9]).pv
    4e-09
    >>> unset = Contribution("tool setting", map=[0, 0], modes=[[-1, 1]], cov=[[1e-18]])
    >>> round(unset.expected * 1e9, 1), round(unset.u * 1e9, 1)  # half normal, 2 nm times 0.8, 0.6
    (1.6, 1.2)
    """

    name: str
    pv: float | None = None
    map: FloatArray | None = None
    u: float | None = None
    modes: FloatArray | None = None
    cov: FloatArray | None = None
    expected: float | None = None
    interval: tuple[float, float] | None = None

    def __init__(
        self,
        name: str,
        pv: float | None = None,
        *,
        map: ArrayLike | None = None,  # noqa: A002  # the word of the field
        u: float | None = None,
        modes: ArrayLike | None = None,
        cov: ArrayLike | None = None,
    ) -> None:
        array = None if map is None else _values(f"the map of {name!r}", map)
        given = None if pv is None else checked_size(name, "P-V", pv)
        if array is None and given is None:
            raise DataError(f"the contribution {name!r} needs a map or a P-V, in m")
        if array is not None:
            own = float(np.nanmax(array) - np.nanmin(array))
            if given is not None and abs(given - own) > 1e-6 * max(given, own):
                raise DataError(
                    f"the contribution {name!r} has the P-V {format_length(own)} in its map, not "
                    f"{format_length(given)}; give one of the two"
                )
            given = own
        size = None if u is None else checked_size(name, "uncertainty", u)
        made: dict[str, object] = {"name": str(name), "pv": given, "map": array, "u": size}
        made |= {"modes": None, "cov": None, "expected": None, "interval": None}
        if modes is not None or cov is not None:
            if size is not None:
                raise DataError(
                    f"the contribution {name!r} has u and modes; give one of the two: u follows "
                    "from modes and cov"
                )
            made["modes"], made["cov"] = _checked_modes(name, array, modes, cov)
        for key, value in made.items():
            object.__setattr__(self, key, value)
        if self.modes is not None:
            self._draw()

    def _draw(self) -> None:
        base, rows = np.ravel(self.map), self.deviations()  # type: ignore[arg-type]
        good = ~(np.isnan(base) | np.isnan(rows).any(axis=0))
        if not good.any():
            raise TooFewSamplesError(f"no point of {self.name!r} has a map and all modes")
        if not good.all():
            base, rows = base[good], rows[:, good]
        xi = np.random.default_rng(SEED).standard_normal((DRAWS, rows.shape[0]))
        expected, u, interval = spread_of(drawn_pv(base, rows, xi))
        for key, value in (("expected", expected), ("u", u), ("interval", interval)):
            object.__setattr__(self, key, value)

    def deviations(self) -> FloatArray:
        """Return the change of the map with each of some independent standard normal numbers.

        Returns
        -------
        ndarray, shape (r, n), m
            Map points in one row; none where nothing is known to vary, or a P-V has no shape.
        """
        if self.map is None or (not self.u and self.modes is None):
            return np.empty((0, 0 if self.map is None else self.map.size))
        if self.modes is not None and self.cov is not None:
            flat = self.modes.reshape(self.modes.shape[0], -1)
            root = square_root(self.cov)
            # a mode without weight may be NaN
            used = root.any(axis=1)
            return np.asarray(root[used].T @ flat[used], dtype=np.float64)
        if not self.pv:
            return np.empty((0, self.map.size))
        return np.ravel(self.map)[None, :] * (float(self.u or 0.0) / self.pv)

    @property
    def is_shapeless(self) -> bool:
        """Whether it has an uncertainty, and a map of P-V 0 that does not tell its shape."""
        return self.map is not None and self.modes is None and bool(self.u) and not self.pv


def spread_of(found: FloatArray) -> tuple[float, float, tuple[float, float]]:
    """Return mean, standard deviation and likely interval of draws."""
    low, high = (float(v) for v in np.quantile(found, LIKELY))
    return float(found.mean()), float(found.std(ddof=1)), (low, high)


def checked_size(name: str, what: str, value: Any) -> float:
    """Return a length from 0 on, m."""
    return numbers.not_negative(value, f"the {what} of {name!r}", dimension="length")


def _values(what: str, values: ArrayLike) -> FloatArray:
    array = real_array(values, what)
    if np.isinf(array).any():
        raise InvalidSamplesError(f"{what} is infinite somewhere; write NaN where it is not known")
    if not array.size or np.isnan(array).all():
        raise TooFewSamplesError(f"{what} holds no value")
    return frozen(array)


def _checked_modes(
    name: str, array: FloatArray | None, modes: ArrayLike | None, cov: ArrayLike | None
) -> tuple[FloatArray, FloatArray]:
    if array is None:
        raise DataError(f"the modes of {name!r} need the map that they change")
    if modes is None or cov is None:
        raise DataError(f"the contribution {name!r} needs both modes and cov, or none of them")
    rows = _values(f"a mode of {name!r}", modes)
    if rows.shape[1:] != array.shape or rows.ndim != array.ndim + 1:
        raise DataError(
            f"the modes of {name!r} have the shape {rows.shape}; it must be (k, *{array.shape}), "
            "one map for each uncertain number"
        )
    square = real_array(cov, f"the covariance of {name!r}")
    k = rows.shape[0]
    if square.shape != (k, k) or not np.isfinite(square).all():
        raise DataError(
            f"the covariance of {name!r} must be finite and have the shape ({k}, {k}) of its "
            f"{k} mode(s), got the shape {square.shape}"
        )
    size = np.sqrt(np.abs(np.diag(square)))
    scale = np.where(size > 0.0, size, 1.0)
    correlation = square / np.outer(scale, scale)
    skew = float(np.abs(correlation - correlation.T).max())
    if skew > 1e-6 or float(np.linalg.eigvalsh(correlation).min()) < -1e-6:
        raise DataError(f"the covariance of {name!r} is not symmetric and positive")
    return rows, frozen(0.5 * (square + square.T))
