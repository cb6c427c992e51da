"""Two compensation tables side by side, from what metrosep wrote beside them."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from typing import Any

from metrosep.core.errors import DataError
from metrosep.report.comparison import (
    Comparison,
    Row,
    Tolerances,
    judged_row,
    known_number,
    largest_difference,
)

__all__ = ["TABLE_SCHEMA", "compare_tables", "table_rows"]

Document = Mapping[str, Any]

TABLE_SCHEMA = "metrosep.table/1"
_GRIDS = ("positions_m", "positions_rad", "x_si", "y_si")
_ENTRIES = {
    "forward_m": "correction",
    "reverse_m": "correction, reverse",
    "values_m": "correction",
    "coefficients_si": "coefficients",
}
_MEANING = ("axis", "axes", "compensates", "sign", "quantity", "axis_units")
_BESIDE = (
    "controller", "entry", "units", "outside", "sign_status", "sign_confirmed_by_user", "options",
    "limits", "waived", "trial", "file_sha256", "quantisation_m",
)  # fmt: skip


def compare_tables(
    a: Document, b: Document, *, tolerances: Mapping[str, float | str] | None = None
) -> Comparison:
    """Return two tables side by side.

    Parameters
    ----------
    a, b : mapping
        Sidecars of two tables (schema ``metrosep.table/1``).
    tolerances : mapping of str to (float or str), optional
        As in `compare_documents`; the metrics are ``table`` and ``table.reverse``.

    Returns
    -------
    Comparison
        One row for each column of corrections; `other` tells what differs around them.

    Raises
    ------
    DataError
        If one is not a sidecar of a table, axis, corrected axis or sign are not the same, or a
        tolerance is wrong or belongs to no row.
    UnitError
        If the unit of a tolerance does not fit.

    Notes
    -----
    Corrections are compared at the same positions only; nothing is interpolated. Controllers may
    differ: the corrections are those before the entries of a dialect are made of them.
    """
    both: tuple[tuple[str, Any], ...] = (("A", a), ("B", b))
    for name, sidecar in both:
        found = sidecar.get("schema") if isinstance(sidecar, Mapping) else type(sidecar).__name__
        if found != TABLE_SCHEMA or not isinstance(sidecar.get("table"), Mapping):
            raise DataError(
                f"{name} is not the sidecar of a table of metrosep (schema {found!r}, expected "
                f"{TABLE_SCHEMA!r}); give the table that 'metrosep table' wrote, its .json beside it"
            )
    one, two = a["table"], b["table"]
    for key in _MEANING:
        if one.get(key) != two.get(key):
            raise DataError(
                f"the {key} of the tables is not the same ({one.get(key)!r} and "
                f"{two.get(key)!r}); entries of such tables have no difference"
            )
    allowed = Tolerances(tolerances)
    rows = tuple(table_rows(one, two, tolerances=allowed))
    allowed.require_used([r.metric for r in rows])
    other = [f"{k}: {a.get(k)!r} and {b.get(k)!r}" for k in _BESIDE if a.get(k) != b.get(k)]
    if not rows:
        raise DataError("the tables hold no entries that could be compared; write them again")
    return Comparison(
        "table",
        rows,
        other=tuple(other),
        versions=tuple(
            f"metrosep: {x} and {y}" for x, y in [(a.get("metrosep"), b.get("metrosep"))] if x != y
        ),
        equal=all(r.equal for r in rows),
    )


def table_rows(a: Document, b: Document, *, tolerances: Tolerances) -> Iterator[Row]:
    """Give a row for each column of corrections."""
    meaning = next((k for k in _MEANING if a.get(k) != b.get(k)), None)
    grid = next((k for k in _GRIDS if a.get(k) != b.get(k)), None)
    for key, name in _ENTRIES.items():
        one, two = (_listed(t.get(key)) for t in (a, b))
        if one is None and two is None:
            continue
        unit = "1" if key == "coefficients_si" else "m"
        metric = "table.reverse" if key == "reverse_m" else "table"
        largest, message = None, ""
        if meaning is not None:
            message = f"the {meaning} is not the same: {a.get(meaning)} and {b.get(meaning)}"
        elif one is None or two is None:
            message = f"only in {'A' if two is None else 'B'}"
        elif grid is not None or len(one) != len(two):
            message = f"the positions differ ({len(one)} and {len(two)} entries)"
        else:
            largest, message = largest_difference(one, two)
        yield judged_row(
            metric,
            f"{name}, largest difference of the entries",
            unit,
            (None, None),
            largest,
            expanded=None,
            verdicts=(None, None),
            tolerances=tolerances,
            message=message,
        )


def _listed(values: Any) -> list[float | None] | None:
    if values is None:
        return None
    if not isinstance(values, Sequence) or isinstance(values, str):
        raise DataError(f"the entries of a table are {values!r}, not a list; it is damaged")
    found: list[float | None] = []
    for value in values:
        if isinstance(value, list):
            found += _listed(value) or []
        else:
            found.append(known_number(value, "an entry of a table"))
    return found
