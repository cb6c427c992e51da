"""What a turning job predicts: the error of each cause over the part, and the corrected program.

Errors are actual minus nominal along z, out of the material; a correction is the negative.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any, Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray

from metrosep.core._arrays import FloatArray, as_float
from metrosep.core.errors import DataError, TooFewSamplesError
from metrosep.core.quantity import Quantity
from metrosep.core.units import format_length
from metrosep.process._contributions import DRAWS, SEED, Contribution, checked_length, spread_of
from metrosep.process.arc_lengths import checked_count
from metrosep.process.follow_ups import drawn_pv

if TYPE_CHECKING:
    import pandas as pd

__all__ = [
    "BudgetTotal",
    "Contribution",
    "CorrectedProgram",
    "ErrorBudget",
    "Prediction",
    "pv_quantities",
]


@dataclass(frozen=True, slots=True, eq=False)
class Prediction:
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

    @property
    def x(self) -> FloatArray:
        """Positions along x, m."""
        return np.asarray(self.rho * np.cos(self.azimuth), dtype=np.float64)

    @property
    def y(self) -> FloatArray:
        """Positions along y, m."""
        return np.asarray(self.rho * np.sin(self.azimuth), dtype=np.float64)


@dataclass(frozen=True, slots=True, eq=False)
class CorrectedProgram:
    """A program with heights that make up for known errors: of the tip, or of points to be cut.

    Parameters
    ----------
    rho, azimuth : ndarray, shape (n,), m and rad
        Commanded points, lead-in first.
    nominal, z : ndarray, shape (n,), m
        Height without and with the correction.
    lead_in : int
        Points before the rim.
    residual_pv : mapping of str to float, m
        P-V of what an uncertainty of the tool setting of one u leaves, by factor.
    messages : tuple of str
        What to know.
    audit : mapping
        Settings, units in the keys.
    quantity : {"cut points", "tip"}
        What the points are. Cut points are points of the surface, which a tool with a nose must not
        be sent to as they are; "tip" are places of the tip, the lowest point of the edge.
    """

    rho: FloatArray
    azimuth: FloatArray
    nominal: FloatArray
    z: FloatArray
    lead_in: int
    residual_pv: Mapping[str, float]
    messages: tuple[str, ...]
    audit: Mapping[str, Any]
    quantity: Literal["cut points", "tip"] = "cut points"

    @property
    def change(self) -> FloatArray:
        """What was added to the nominal height, m: the negative of the predicted error."""
        return np.asarray(self.z - self.nominal, dtype=np.float64)

    def to_frame(self) -> pd.DataFrame:
        """Return the program as a table.

        Returns
        -------
        DataFrame
            Columns rho_um, azimuth_deg, z_nominal_nm, z_command_nm, the names of lengths with what
            they belong to in front: cut_point_rho_um, tip_z_command_nm.
        """
        import pandas as pd

        of = self.quantity.removesuffix("s").replace(" ", "_")
        return pd.DataFrame(
            {
                f"{of}_rho_um": 1e6 * self.rho,
                "azimuth_deg": np.degrees(self.azimuth),
                f"{of}_z_nominal_nm": 1e9 * self.nominal,
                f"{of}_z_command_nm": 1e9 * self.z,
            }
        )


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
        If there is none, one is no contribution, a name occurs twice, maps have different shapes,
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
            raise DataError(f"the contribution {twice[0]!r} is there twice; give each cause once")
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
            self._found["messages"] = (*self._missing(), *_doubts(self.contributions))
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
                    "an uncertainty; they are left out of the draws"
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
        if way not in WAYS:
            raise DataError(f"way must be one of {', '.join(WAYS)}, got {way!r}")
        count = checked_count(draws, "draws", least=1)
        if count > _MOST_DRAWS:
            raise DataError(f"draws must be at most {_MOST_DRAWS}, got {count}")
        seed = checked_count(seed, "seed", least=0)
        if way in ("sum", "rss"):
            return self._of_sizes(way)
        if count < 100:
            raise TooFewSamplesError(f"a Monte Carlo needs 100 draws or more, got {draws}")
        value = self._pointwise(f'"{way}"')
        if not self._is_known:
            interval = (value, value) if way == "monte-carlo" else None
            return BudgetTotal(
                way, value, float("nan"), _DEFINITIONS[way], interval, None, self.messages
            )
        median, expected, u, interval = self._drawn(count, seed)
        if way == "monte-carlo":
            value = median
        return BudgetTotal(way, value, u, _DEFINITIONS[way], interval, expected, self.messages)

    @property
    def _is_known(self) -> bool:
        return any(c.u is not None for c in self.contributions)

    def _of_sizes(self, way: str) -> BudgetTotal:
        sizes = self._sizes()
        u = np.array([0.0 if c.u is None else c.u for c in self.contributions])
        means = np.array(
            [
                s if c.expected is None else c.expected
                for c, s in zip(self.contributions, sizes, strict=True)
            ]
        )
        drawn = [c.expected is not None for c in self.contributions]
        worst = float(np.sqrt((u**2).sum()))
        if way == "sum":
            value, spread, mean = float(sizes.sum()), worst, float(means.sum())
        else:
            value = float(np.sqrt((sizes**2).sum()))
            size = max(value, worst)
            spread = (
                float(np.sqrt(((np.maximum(sizes, u) * u) ** 2).sum())) / size if size else 0.0
            )
            mean = float(np.sqrt((means**2 + np.where(drawn, u, 0.0) ** 2).sum()))
        return BudgetTotal(
            way,
            value,
            spread if self._is_known else float("nan"),
            _DEFINITIONS[way],
            None,
            mean if any(drawn) else None,
            self.messages,
        )

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
        loose = float(
            np.sqrt(sum(float(c.u or 0.0) ** 2 for c in self.contributions if c.is_shapeless))
        )
        self._found[draws, seed] = (
            float(np.median(values)),
            expected,
            float(np.hypot(u, loose)),
            (max(low - 2.0 * loose, 0.0), high + 2.0 * loose),
        )
        return self._drawn(draws, seed)

    def totals(self, *, draws: int = DRAWS, seed: int = SEED) -> dict[str, BudgetTotal]:
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
        DataError
            If a number cannot be used.
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
                *_nanometres(c.expected, c.interval),
            )
            for c in self.contributions
        ]
        rows += [
            (
                f"total, {way}",
                1e9 * t.pv,
                1e9 * t.u,
                nan,
                t.definition,
                *_nanometres(t.expected, t.interval),
            )
            for way, t in self.totals().items()
        ]
        if measured is not None:
            size = 1e9 * checked_length("measured", "P-V", measured)
            rows.append(("measured", size, nan, nan, "as cut", nan, nan, nan))
        columns = ["item", "pv_nm", "u_nm", "share", "definition"]
        return pd.DataFrame(rows, columns=[*columns, "expected_nm", "low_nm", "high_nm"])

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
                    **_spread(c),
                }
                for c in self.contributions
            ],
            "totals": {
                way: {
                    "pv_nm": 1e9 * t.pv,
                    "u_nm": _plain(1e9 * t.u),
                    "definition": t.definition,
                    **_spread(t),
                }
                for way, t in self.totals().items()
            },
            "messages": list(self.messages),
        }

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
    try:
        array = as_float(weights)
    except (TypeError, ValueError) as error:
        raise DataError(f"the weights must be real numbers, one for each point: {error}") from None
    if array.shape != shape:
        raise DataError(
            f"the weights have the shape {array.shape}, the maps {shape}: give the area of each "
            "point of the maps"
        )
    if not (np.isfinite(array) & (array >= 0.0)).all() or not array.any():
        raise DataError("the weights are areas: finite, from 0 on, and not all 0")
    array.setflags(write=False)
    return array


def _doubts(contributions: Sequence[Contribution]) -> list[str]:
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


def _nanometres(
    expected: float | None, interval: tuple[float, float] | None
) -> tuple[float, float, float]:
    nan = float("nan")
    low, high = (nan, nan) if interval is None else interval
    return 1e9 * (nan if expected is None else expected), 1e9 * low, 1e9 * high


def _spread(item: Contribution | BudgetTotal) -> dict[str, Any]:
    interval = item.interval
    return {
        "expected_nm": None if item.expected is None else 1e9 * item.expected,
        "interval_nm": None if interval is None else [1e9 * v for v in interval],
    }


def _plain(value: float) -> float | None:
    return None if np.isnan(value) else float(value)
