"""`Parameter` and `ParameterTable`: numbers with everything that is needed to repeat them.

A bare number is the fault of all peers: here each carries unit, definition with clause, edition,
the steps before it (form, filters), the share of valid samples, the version of the code and, where
it is known, a standard uncertainty.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from types import MappingProxyType
from typing import TYPE_CHECKING, Any, Self

from metrosep._version import __version__
from metrosep.core.errors import DataError
from metrosep.core.provenance import Step, history_as_dicts
from metrosep.core.quantity import Quantity

if TYPE_CHECKING:
    import pandas as pd

__all__ = ["Context", "ParameterTable"]


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


class ParameterTable(Mapping[str, Quantity]):
    """Parameters by symbol, in the order in which the standard lists them.

    Parameters
    ----------
    quantities : sequence of Quantity
        Each with its symbol.
    context : Context
        Edition, filter chain, valid share, settings.
    unavailable : mapping of str to str, optional
        Symbols that could not be evaluated, each with the reason and what to do.

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
        raise KeyError(f"{own!r} is not among {', '.join(self._quantities)}")

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

    def __repr__(self) -> str:
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
