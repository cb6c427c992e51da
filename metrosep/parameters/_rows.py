"""Private helpers: the rows of a parameter table, chosen by symbol and evaluated one by one."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from metrosep.core.errors import DataError, FitError
from metrosep.core.quantity import Quantity
from metrosep.spectral._checks import symbols


@dataclass(frozen=True, slots=True)
class Row:
    """One parameter of a table; `value` takes what the parameters share."""

    symbol: str
    unit: str
    text: str
    value: Callable[[Any], float]


def chosen_rows(
    rows: Sequence[Row],
    names: Sequence[str] | None,
    what: str,
    aliases: Mapping[str, str] | None = None,
) -> list[Row]:
    """Return the rows of the wanted symbols in the order of the table; all without names."""
    if names is None:
        return list(rows)
    other = aliases or {}
    wanted = {other.get(n, n) for n in symbols(names)}
    unknown = sorted(wanted - {r.symbol for r in rows})
    if unknown:
        raise DataError(
            f"{', '.join(unknown)}: not offered as {what}; offered are "
            + ", ".join(r.symbol for r in rows)
        )
    return [r for r in rows if r.symbol in wanted]


def evaluated(rows: Iterable[Row], work: object) -> tuple[list[Quantity], dict[str, str]]:
    """Return the parameters that can be given, and why the others cannot."""
    quantities: list[Quantity] = []
    unavailable: dict[str, str] = {}
    for row in rows:
        try:
            value = float(row.value(work))
        except (DataError, FitError) as reason:
            unavailable[row.symbol] = str(reason)
        else:
            quantities.append(Quantity(value, row.unit, row.text, symbol=row.symbol))
    return quantities, unavailable
