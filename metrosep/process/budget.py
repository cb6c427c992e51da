"""Error budgets: contributions to the form error, put together in four ways side by side.

Errors are actual minus nominal along z. A contribution is a map, or only a P-V somebody states.
Peak to valley does not add: the maps do. What a sum of P-Vs, their root sum of squares and a Monte
Carlo say about the same part differs by factors, so a budget prints all that can be computed.

Source: the budget of slow-tool-servo (Figs 14, 16 and 18), which adds P-Vs.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Literal

import numpy as np
from numpy.typing import ArrayLike

from metrosep.core._arrays import FloatArray, as_float
from metrosep.core.errors import DataError, InvalidSamplesError, TooFewSamplesError
from metrosep.core.units import format_length

if TYPE_CHECKING:
    import pandas as pd

__all__ = ["BudgetTotal", "Contribution", "ErrorBudget"]

Combination = Literal["pointwise", "sum", "rss", "monte-carlo"]

WAYS: tuple[Combination, ...] = ("pointwise", "sum", "rss", "monte-carlo")

_DEFINITIONS = {
    "pointwise": "P-V of the sum of the maps",
    "sum": "sum of the P-Vs: the worst case",
    "rss": "root of the sum of squared P-Vs: for independent causes of one kind",
    "monte-carlo": "P-V of the sum with each cause drawn within its uncertainty, median of the draws",
}

_LIKELY = (0.025, 0.975)
"""Quantiles of the interval of a Monte Carlo."""


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

    Raises
    ------
    DataError
        If there is neither a map nor a P-V, both disagree, or a number cannot be used.
    InvalidSamplesError
        If the map is infinite somewhere.
    TooFewSamplesError
        If the map is NaN everywhere.

    Examples
    --------
    >>> Contribution("tool setting", map=[-1e-9, 2e-9]).pv
    3e-09
    """

    name: str
    pv: float | None = None
    map: FloatArray | None = None
    u: float | None = None

    def __init__(
        self,
        name: str,
        pv: float | None = None,
        *,
        map: ArrayLike | None = None,  # noqa: A002  # the word of the field
        u: float | None = None,
    ) -> None:
        array = None if map is None else _map(name, map)
        given = None if pv is None else _size(name, "P-V", pv)
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
        object.__setattr__(self, "name", str(name))
        object.__setattr__(self, "pv", given)
        object.__setattr__(self, "map", array)
        object.__setattr__(self, "u", None if u is None else _size(name, "uncertainty", u))


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
        Between 2.5 and 97.5 % of the draws of a Monte Carlo.
    """

    way: str
    pv: float
    u: float
    definition: str
    interval: tuple[float, float] | None = None


@dataclass(frozen=True, slots=True, eq=False, init=False)
class ErrorBudget:
    """Contributions to the form error of a part.

    Parameters
    ----------
    contributions : sequence of Contribution or of tuple (name, P-V in m)
        Causes, each once.

    Raises
    ------
    DataError
        If there is none, a name occurs twice, or maps have different shapes.

    Notes
    -----
    Only maps that lie on the same points add pointwise. A P-V without a map has an unknown shape:
    "pointwise" and "monte-carlo" refuse it by name, rather than to assume one.

    Examples
    --------
    >>> budget = ErrorBudget([("tool", 22.0e-9), ("program", 7.6e-9), ("follow-up", 13e-9)])
    >>> round(budget.combine("sum").pv * 1e9, 1), round(budget.combine("rss").pv * 1e9, 1)
    (42.6, 26.7)
    """

    contributions: tuple[Contribution, ...]

    def __init__(self, contributions: Sequence[Contribution | tuple[str, float]]) -> None:
        items = tuple(
            c if isinstance(c, Contribution) else Contribution(str(c[0]), float(c[1]))
            for c in contributions
        )
        if not items:
            raise DataError("a budget needs at least one contribution")
        names = [c.name for c in items]
        twice = sorted({n for n in names if names.count(n) > 1})
        if twice:
            raise DataError(f"the contribution {twice[0]!r} is there twice; give each cause once")
        shapes = {c.name: c.map.shape for c in items if c.map is not None}
        if len(set(shapes.values())) > 1:
            text = ", ".join(f"{n} {s}" for n, s in shapes.items())
            raise DataError(
                f"the maps of a budget share their points; their shapes differ: {text}"
            )
        object.__setattr__(self, "contributions", items)

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
        """Share of each map in the mean square of their sum; negative where it takes from the rest.

        Raises
        ------
        DataError
            If a contribution has no map.
        """
        maps = self._maps("a share of the mean square")
        centred = maps - maps.mean(axis=1, keepdims=True)
        total = centred.sum(axis=0)
        square = float(total @ total)
        return {
            c.name: float(m @ total) / square if square else float("nan")
            for c, m in zip(self.contributions, centred, strict=True)
        }

    def combine(self, way: Combination, *, draws: int = 4000, seed: int = 20080415) -> BudgetTotal:
        """Return the combined P-V.

        Parameters
        ----------
        way : {"pointwise", "sum", "rss", "monte-carlo"}
            Sum of maps, sum of P-Vs, root sum of squares, or draws within the uncertainties.
        draws : int, optional
            Of a Monte Carlo.
        seed : int, optional
            Of a Monte Carlo.

        Returns
        -------
        BudgetTotal
            P-V, standard uncertainty, definition.

        Raises
        ------
        DataError
            If the way is not one of those above, or needs maps that are not there.
        TooFewSamplesError
            If no point has all maps, or fewer than 100 draws are wanted.

        Notes
        -----
        u of the sum and of the root sum of squares by first order from the contributions'. The
        Monte Carlo multiplies each map by ``1 + xi u / P-V``, xi normal: a cause keeps its shape
        and varies in size.
        """
        if way not in WAYS:
            raise DataError(f"way must be one of {', '.join(WAYS)}, got {way!r}")
        sizes = self._sizes()
        u = np.array([0.0 if c.u is None else c.u for c in self.contributions])
        known = any(c.u is not None for c in self.contributions)
        if way == "sum":
            value, spread = float(sizes.sum()), float(np.sqrt((u**2).sum()))
            return BudgetTotal(way, value, spread if known else float("nan"), _DEFINITIONS[way])
        if way == "rss":
            value = float(np.sqrt((sizes**2).sum()))
            spread = float(np.sqrt(((sizes * u) ** 2).sum())) / value if value else 0.0
            return BudgetTotal(way, value, spread if known else float("nan"), _DEFINITIONS[way])
        maps = self._maps(f'"{way}"')
        if way == "pointwise":
            value = float(np.ptp(maps.sum(axis=0)))
            spread = (
                float(_drawn(maps, sizes, u, 2000, seed).std(ddof=1)) if known else float("nan")
            )
            return BudgetTotal(way, value, spread, _DEFINITIONS[way])
        if draws < 100:
            raise TooFewSamplesError(f"a Monte Carlo needs 100 draws or more, got {draws}")
        found = _drawn(maps, sizes, u, draws, seed)
        low, high = (float(v) for v in np.quantile(found, _LIKELY))
        return BudgetTotal(
            way,
            float(np.median(found)),
            float(found.std(ddof=1)) if known else float("nan"),
            _DEFINITIONS[way],
            (low, high),
        )

    def totals(self, *, draws: int = 4000, seed: int = 20080415) -> dict[str, BudgetTotal]:
        """Return the combined errors of all ways that these contributions allow.

        Parameters
        ----------
        draws : int, optional
            Of the Monte Carlo.
        seed : int, optional
            Of the Monte Carlo.

        Returns
        -------
        dict of str to BudgetTotal
            Without "pointwise" and "monte-carlo" where a contribution has no map.

        Raises
        ------
        TooFewSamplesError
            If no point has all maps, or fewer than 100 draws are wanted.
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
            Columns item, pv_nm, u_nm, share, definition; share of the sum of the P-Vs.

        Raises
        ------
        DataError
            If the measured value is negative or not finite.
        TooFewSamplesError
            If no point has all maps.
        """
        import pandas as pd

        shares = self.shares
        nan = float("nan")
        rows = [
            (
                c.name,
                1e9 * float(c.pv or 0.0),
                nan if c.u is None else 1e9 * c.u,
                shares[c.name],
                "P-V of its map" if c.map is not None else "P-V as stated",
            )
            for c in self.contributions
        ]
        rows += [
            (f"total, {way}", 1e9 * t.pv, 1e9 * t.u, nan, t.definition)
            for way, t in self.totals().items()
        ]
        if measured is not None:
            rows.append(("measured", 1e9 * _size("measured", "P-V", measured), nan, nan, "as cut"))
        return pd.DataFrame(rows, columns=["item", "pv_nm", "u_nm", "share", "definition"])

    def to_dict(self) -> dict[str, Any]:
        """Return contributions and totals as plain values.

        Returns
        -------
        dict
            Keys with units; None where not known.

        Raises
        ------
        TooFewSamplesError
            If no point has all maps.
        """
        shares = self.shares
        return {
            "contributions": [
                {
                    "name": c.name,
                    "pv_nm": 1e9 * float(c.pv or 0.0),
                    "u_nm": None if c.u is None else 1e9 * c.u,
                    "share": _plain(shares[c.name]),
                    "has_map": c.map is not None,
                }
                for c in self.contributions
            ],
            "totals": {
                way: {"pv_nm": 1e9 * t.pv, "u_nm": _plain(1e9 * t.u), "definition": t.definition}
                for way, t in self.totals().items()
            },
        }

    def _sizes(self) -> FloatArray:
        return np.array([float(c.pv or 0.0) for c in self.contributions])

    def _maps(self, what: str) -> FloatArray:
        """Return the maps at the points where all are known, one row for each."""
        if self.without_map:
            raise DataError(
                f"{what} needs the map of each contribution; {', '.join(self.without_map)} is a "
                'P-V only: give its map, or combine by "sum" or "rss"'
            )
        maps = np.array([np.ravel(c.map) for c in self.contributions])  # type: ignore[arg-type]
        good = ~np.isnan(maps).any(axis=0)
        if not good.any():
            raise TooFewSamplesError("no point has a value in every map of the budget")
        out: FloatArray = maps[:, good]
        return out


def _drawn(
    maps: FloatArray, sizes: FloatArray, u: FloatArray, draws: int, seed: int
) -> FloatArray:
    """Return the P-V of each draw; only points that can be extreme are looked at."""
    rng = np.random.default_rng(seed)
    relative = np.divide(u, sizes, out=np.zeros_like(u), where=sizes > 0.0)
    factors = 1.0 + relative * rng.standard_normal((draws, len(u)))
    out = np.empty(draws)
    block = max(1, (1 << 22) // maps.shape[1])
    for start in range(0, draws, block):
        total = factors[start : start + block] @ maps
        out[start : start + block] = total.max(axis=1) - total.min(axis=1)
    return out


def _map(name: str, values: ArrayLike) -> FloatArray:
    try:
        array = as_float(values)
    except (TypeError, ValueError) as error:
        raise DataError(f"the map of {name!r} must hold real numbers in m: {error}") from None
    if np.isinf(array).any():
        raise InvalidSamplesError(
            f"the map of {name!r} is infinite somewhere; write NaN where it is not known"
        )
    if not array.size or np.isnan(array).all():
        raise TooFewSamplesError(f"the map of {name!r} holds no value")
    array.setflags(write=False)
    return array


def _size(name: str, what: str, value: float) -> float:
    try:
        size = float(value)
    except (TypeError, ValueError):
        size = float("nan")
    if not (np.isfinite(size) and size >= 0.0):
        raise DataError(f"the {what} of {name!r} must be a length from 0 on, in m, got {value!r}")
    return size


def _plain(value: float) -> float | None:
    return None if np.isnan(value) else float(value)
