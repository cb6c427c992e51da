"""`Parameter` and `ParameterTable`: numbers with everything that is needed to repeat them.

A bare number is the fault of all peers: here each carries unit, definition with clause, edition,
the steps before it (form, filters), the share of valid samples, the version of the code and, where
it is known, a standard uncertainty.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from operator import attrgetter
from types import MappingProxyType
from typing import TYPE_CHECKING, Any, Self

import numpy as np
from numpy.typing import NDArray

from metrosep._version import __version__
from metrosep.core._arrays import FloatArray
from metrosep.core.docs import documented
from metrosep.core.errors import (
    DataError,
    FitError,
    InvalidSamplesError,
    NameNotFoundError,
    TooFewSamplesError,
)
from metrosep.core.numbers import LEAST
from metrosep.core.profile import Profile
from metrosep.core.provenance import Step, history_as_dicts
from metrosep.core.public import PublicObject, shortened
from metrosep.core.quantity import Quantity
from metrosep.core.surface import Surface
from metrosep.parameters.arguments import Call, Function, call_of, is_call, unknown
from metrosep.spectral.dft import symbols

if TYPE_CHECKING:
    import pandas as pd


@dataclass(frozen=True, slots=True)
class Context:
    """What all the numbers of a table have in common.

    Parameters
    ----------
    edition : str
        Standard and edition, such as ``"ISO 25178-2:2021"``.
    n_valid, n_total : int
        Samples or pixels that were measured, and all of them.
    history : tuple of Step
        From the file through form removal and filters.
    settings : mapping
        Choices of the evaluation (sections, centring, line, ...), plain values, SI.
    notes : tuple of str
        What a reader must know, one sentence each.
    """

    edition: str
    n_valid: int
    n_total: int
    history: tuple[Step, ...] = ()
    settings: Mapping[str, Any] = field(default_factory=dict)
    notes: tuple[str, ...] = ()

    @property
    def valid_share(self) -> float:
        """Share of valid samples, 0 to 1."""
        return self.n_valid / self.n_total if self.n_total else math.nan

    @property
    def chain(self) -> str:
        """The steps before the evaluation in one line, without the reading."""
        steps = [s for s in self.history if s.name not in ("read", "convert")]
        if not steps:
            return "nothing removed, no filter"
        return " -> ".join(_step_text(s) for s in steps)

    def to_dict(self) -> dict[str, Any]:
        """Return plain values for JSON.

        Returns
        -------
        dict
            Keys ``edition``, ``n_valid``, ``n_total``, ``chain``, ``settings``, ``notes``,
            ``history``, ``version``.
        """
        return {
            "edition": self.edition,
            "n_valid": self.n_valid,
            "n_total": self.n_total,
            "chain": self.chain,
            "settings": dict(self.settings),
            "notes": list(self.notes),
            "history": history_as_dicts(self.history),
            "version": __version__,
        }


def _step_text(step: Step) -> str:
    inside = ", ".join(
        f"{k}={v:.6g}" if isinstance(v, float) else f"{k}={v}"
        for k, v in step.parameters.items()
        if isinstance(v, str | int | float) and not isinstance(v, bool)
    )
    return f"{step.name}({inside})"


TABLE = """
    quantities : sequence of Quantity
        Each with its symbol.
    context : Context
        Edition, filter chain, valid share, settings.
    unavailable : mapping of str to str, optional
        Symbols that could not be evaluated, each with the reason and what to do.
    """


@documented(table=TABLE)
class ParameterTable(PublicObject, Mapping[str, Quantity]):
    """Parameters by symbol, in the order in which the standard lists them.

    Parameters
    ----------
    $table

    Raises
    ------
    DataError
        If a symbol is missing or occurs twice.

    Examples
    --------
    >>> table = ParameterTable([Quantity(2e-9, "m", "root mean square height", symbol="Sq")],
    ...                        Context("ISO 25178-2:2021", n_valid=4, n_total=4))
    >>> table["Sq"].value, table["Sq"].unit
    (2e-09, 'm')
    """

    __slots__ = ("_quantities", "context", "unavailable")

    def __init__(
        self,
        quantities: Sequence[Quantity],
        context: Context,
        *,
        unavailable: Mapping[str, str] | None = None,
    ) -> None:
        found: dict[str, Quantity] = {}
        for quantity in quantities:
            if not quantity.symbol or quantity.symbol in found:
                raise DataError(
                    f"a parameter needs a symbol of its own, got {quantity.symbol!r} for "
                    f"{quantity.definition}"
                )
            found[quantity.symbol] = quantity
        self._quantities = found
        self.context = context
        self.unavailable = MappingProxyType(dict(unavailable or {}))

    def own_symbol(self, symbol: str) -> str:
        """Return the symbol under which the table holds a parameter.

        Parameters
        ----------
        symbol : str
            In any spelling that the table understands; a subclass may know several.

        Returns
        -------
        str
            The symbol itself where nothing else is meant.
        """
        return symbol

    def __getitem__(self, symbol: str) -> Quantity:
        own = self.own_symbol(symbol)
        try:
            return self._quantities[own]
        except KeyError:
            pass
        if own in self.unavailable:
            raise DataError(f"{own} cannot be given: {self.unavailable[own]}")
        raise NameNotFoundError(f"{own!r} is not among {', '.join(self._quantities)}")

    def __iter__(self) -> Iterator[str]:
        return iter(self._quantities)

    def __len__(self) -> int:
        return len(self._quantities)

    def __contains__(self, symbol: object) -> bool:
        return isinstance(symbol, str) and self.own_symbol(symbol) in self._quantities

    def with_uncertainties(self, u: Mapping[str, float]) -> Self:
        """Return the table with standard uncertainties.

        Parameters
        ----------
        u : mapping of str to float
            Standard uncertainty by symbol, in the unit of the parameter.

        Returns
        -------
        ParameterTable
            Of the same class; other parameters are as they were.

        Raises
        ------
        DataError
            If a symbol is not in the table.
        """
        own = {self.own_symbol(s): value for s, value in u.items()}
        unknown = sorted(set(own) - set(self._quantities))
        if unknown:
            raise DataError(f"no parameter {', '.join(unknown)} in this table")
        quantities = [
            replace(q, u=float(own[s])) if s in own else q for s, q in self._quantities.items()
        ]
        return type(self)(quantities, self.context, unavailable=self.unavailable)

    def to_dict(self) -> dict[str, Any]:
        """Return plain values for JSON, SI.

        Returns
        -------
        dict
            ``parameters`` (symbol to value, unit, u, definition), ``unavailable``, and the keys
            of the context.
        """
        return {
            "parameters": {s: q.to_dict() for s, q in self._quantities.items()},
            "unavailable": dict(self.unavailable),
            **self.context.to_dict(),
        }

    def to_frame(self) -> pd.DataFrame:
        """Return a data frame, one row per parameter.

        Returns
        -------
        pandas.DataFrame
            Index ``symbol``; columns ``value``, ``unit``, ``u``, ``definition``, ``edition``.
        """
        import pandas as pd

        rows = [
            {
                "symbol": s,
                "value": q.value,
                "unit": q.unit,
                "u": math.nan if q.u is None else q.u,
                "definition": q.definition,
                "edition": self.context.edition,
            }
            for s, q in self._quantities.items()
        ]
        columns = ["symbol", "value", "unit", "u", "definition", "edition"]
        return pd.DataFrame(rows, columns=columns).set_index("symbol")

    def __sub__(self, other: Any) -> ParameterTable:
        """Return the differences of the parameters that both tables hold, u added in squares.

        The two are taken as independent; ratios and angles are subtracted like lengths.
        """
        if not isinstance(other, ParameterTable):
            return NotImplemented
        both = [s for s in self._quantities if s in other]
        if not both:
            raise DataError("the two tables have no parameter in common")
        found = [
            replace(self[s] - other[s], symbol=s, definition=f"difference of {self[s].definition}")
            for s in both
        ]
        missing = dict.fromkeys({*self, *other} - {*both}, "only one of the two tables has it")
        return ParameterTable(found, self.context, unavailable=dict(sorted(missing.items())))

    def __repr__(self) -> str:
        shown = ", ".join(f"{s} {q}" for s, q in self._quantities.items())
        return shortened(
            f"ParameterTable({self.context.edition}, {len(self)} parameters: {shown})"
        )

    def __str__(self) -> str:
        head = f"ParameterTable, {self.context.edition}, {self.context.chain}"
        share = f"{self.context.n_valid} of {self.context.n_total} valid"
        lines = [f"  {s:<6} {q}" for s, q in self._quantities.items()]
        lines += [f"  {s:<6} not available: {why}" for s, why in self.unavailable.items()]
        lines += [f"  note: {n}" for n in self.context.notes]
        return "\n".join([f"{head}, {share}", *lines])

    def _repr_html_(self) -> str:
        """Return a table for notebooks."""
        from metrosep.core.profile import html_table

        rows = {s: f"{q} — {q.definition}" for s, q in self._quantities.items()}
        rows["chain"] = self.context.chain
        rows["valid"] = f"{self.context.n_valid} of {self.context.n_total}"
        return html_table(self.context.edition, rows)


# ---- private helpers: the rows of a parameter table, chosen by symbol and evaluated one by one ----


@dataclass(frozen=True, slots=True)
class Row:
    """One parameter of a table; `value` takes what the parameters share, or names its attribute."""

    symbol: str
    unit: str
    text: str
    value: Callable[[Any], float] | str


def chosen_rows(
    rows: Sequence[Row],
    names: Sequence[str] | None,
    what: str,
    aliases: Mapping[str, str] | None = None,
    functions: Sequence[Function] = (),
) -> list[Row]:
    """Return the rows of the wanted symbols in the order of the table; all without names.

    Those with arguments, such as ``Smr(0.5 um)``, follow in the order of the names.
    """
    if names is None:
        return list(rows)
    other = aliases or {}
    plain, called = with_and_without_arguments(names)
    wanted = {other.get(n, n) for n in plain}
    if strange := sorted(wanted - {r.symbol for r in rows}):
        raise unknown(strange, [r.symbol for r in rows], what)
    calls = [call_of(n, functions) for n in called]
    return [*(r for r in rows if r.symbol in wanted), *rows_of_calls(calls)]


def with_and_without_arguments(names: Sequence[str]) -> tuple[list[str], list[str]]:
    """Return the plain symbols, and the names with arguments."""
    given = symbols(names)
    return [n for n in given if not is_call(n)], [n for n in given if is_call(n)]


def rows_of_calls(calls: Iterable[Call]) -> list[Row]:
    """Return a row for each parameter with arguments, once."""
    return [
        Row(name, c.function.unit, c.text, c.value)
        for name, c in {c.name: c for c in calls}.items()
    ]


def evaluated(rows: Iterable[Row], work: object) -> tuple[list[Quantity], dict[str, str]]:
    """Return the parameters that can be given, and why the others cannot."""
    quantities: list[Quantity] = []
    unavailable: dict[str, str] = {}
    failed: dict[str, DataError | FitError] = {}  # a cached property that raises is not cached
    for row in rows:
        try:
            value = float(
                _shared(work, row.value, failed) if isinstance(row.value, str) else row.value(work)
            )
        except (DataError, FitError) as reason:
            unavailable[row.symbol] = str(reason)
        else:
            quantities.append(Quantity(value, row.unit, row.text, symbol=row.symbol))
    return quantities, unavailable


def _shared(work: object, path: str, failed: dict[str, DataError | FitError]) -> Any:
    """Return an attribute of what several rows share; what failed for one of them is not tried again."""
    owner, _, name = path.rpartition(".")
    if owner in failed:
        raise failed[owner]
    try:
        found = attrgetter(owner)(work) if owner else work
    except (DataError, FitError) as reason:
        failed[owner] = reason
        raise
    return getattr(found, name)


# ---- parameters by name, evaluated on many drawings at once: rows of valid heights -------------

Evaluate = str | Callable[[Profile | Surface], float | Quantity]

PEAK_TO_VALLEY = frozenset({"PV", "Pt", "Rt", "Wt", "Sz"})
MEAN_SQUARE = frozenset({"RMS", "Pq", "Rq", "Wq", "Sq"})
MEAN_ABSOLUTE = frozenset({"Pa", "Ra", "Wa", "Sa"})
PEAK = frozenset({"Sp"})
VALLEY = frozenset({"Sv"})
NORMALISED = frozenset({"Psk", "Rsk", "Wsk", "Ssk", "Pku", "Rku", "Wku", "Sku"})
NAMES = PEAK_TO_VALLEY | MEAN_SQUARE | MEAN_ABSOLUTE | PEAK | VALLEY | NORMALISED | {"mean"}
EXTREMES = PEAK_TO_VALLEY | PEAK | VALLEY


def check_name(name: str) -> str:
    """Return a known name."""
    if name not in NAMES:
        raise DataError(
            f"{name!r} is not one of {', '.join(sorted(NAMES))}; give a function of the object "
            "for any other parameter"
        )
    return name


def is_centred(name: str, centre: bool | None) -> bool:
    """Return whether the mean is removed: areal and RMS always, profile families on request."""
    if centre is None:
        return name[0] == "S" or name == "RMS"
    return centre


def rows(name: str, block: FloatArray, *, centred: bool) -> FloatArray:
    """Return the parameter of each row of complete heights; the block may be overwritten."""
    if name in PEAK_TO_VALLEY:
        return np.asarray(block.max(axis=1) - block.min(axis=1))
    mean: FloatArray = block.mean(axis=1)
    if name == "mean":
        return mean
    if name in PEAK:
        return np.asarray(block.max(axis=1) - (mean if centred else 0.0))
    if name in VALLEY:
        return np.asarray((mean if centred else 0.0) - block.min(axis=1))
    if centred:
        block -= mean[:, None]
    if name in MEAN_ABSOLUTE:
        return np.asarray(np.abs(block, out=block).mean(axis=1))
    return _moments(name, block)


def _moments(name: str, block: FloatArray) -> FloatArray:
    # Heights of 1e-9 m have fourth powers of 1e-36: scaled first, nothing underflows.
    scale = np.abs(block).max(axis=1)
    scale[scale == 0.0] = 1.0
    block /= scale[:, None]
    squares = np.square(block)
    q = np.sqrt(squares.mean(axis=1))
    if name in MEAN_SQUARE:
        return np.asarray(q * scale)
    if (q == 0.0).any():
        raise DataError(f"{name} of constant heights is not defined")
    if name.endswith("sk"):
        return np.asarray((squares * block).mean(axis=1) / q**3)
    return np.asarray(np.square(squares).mean(axis=1) / q**4)


def valid_heights(obj: Profile | Surface) -> tuple[FloatArray, NDArray[np.bool_]]:
    """Return the valid heights in a row, and the mask."""
    mask = ~np.isnan(obj.z)
    if int(mask.sum()) < 2:
        raise TooFewSamplesError(f"{int(mask.sum())} valid height(s), at least 2 are needed")
    return obj.z[mask], mask


def with_heights(obj: Profile | Surface, z: FloatArray) -> Profile | Surface:
    """Return the object with other heights."""
    if isinstance(obj, Profile):
        return Profile(obj.x, z, metadata=obj.metadata, history=obj.history)
    return Surface(
        z, obj.dx, obj.dy, origin=obj.origin, metadata=obj.metadata, history=obj.history
    )


def value_of(evaluate: Evaluate, obj: Profile | Surface, *, centre: bool | None = None) -> float:
    """Return the parameter of one object as a finite number."""
    if isinstance(evaluate, str):
        name = check_name(evaluate)
        z, _ = valid_heights(obj)
        value = float(rows(name, z[None, :].copy(), centred=is_centred(name, centre))[0])
    else:
        result = evaluate(obj)
        value = float(result.value if isinstance(result, Quantity) else result)
    if not np.isfinite(value):
        raise DataError(
            "the evaluation gave NaN or an infinite value; it needs an answer for each drawing"
        )
    return value


# ---- private: refuse heights whose powers leave double precision -------------------------------

LARGEST = 1e60
"""m, as `LEAST`; the fourth power of 1e-77 is 0 and that of 1e77 infinite, and heights vary."""


def check_range(low: float, high: float) -> None:
    """Refuse infinite heights, too large ones, and a range that is tiny but not zero."""
    if math.isinf(low) or math.isinf(high):
        raise InvalidSamplesError("z is infinite somewhere; write NaN where nothing was measured")
    largest = max(abs(low), abs(high))
    if largest > LARGEST:
        raise DataError(
            f"the heights reach {largest:.3g} m, beyond {LARGEST:g} m, where their powers are not "
            "numbers any more; is the unit m, and is a code for missing samples among them?"
        )
    if 0.0 < high - low < LEAST:
        raise DataError(
            f"the range of the heights is {high - low:.3g} m, below {LEAST:g} m, where their "
            "powers vanish; is the unit m?"
        )
