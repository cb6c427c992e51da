"""What a comparison says: rows of values, what else differs, and whether all of it is equal."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from metrosep.compensation.area_errors import numbers_of
from metrosep.core.errors import DataError, UnitError
from metrosep.core.units import parse_quantity, parse_unit

_EVERY = "*"
_DIMENSIONS = {"m": "length", "rad": "angle", "s": "time", "V": "voltage"}


@dataclass(frozen=True, slots=True)
class Row:
    """One value on both sides.

    Parameters
    ----------
    metric, name : str
        What it is: the metric of a check, and its words.
    unit : str
        SI unit of all numbers of the row; ``"1"`` for pure numbers.
    value_a, value_b : float or None
        ``None`` where it is not known, or where the row is a largest difference of many entries.
    difference : float or None
        b minus a; for entries the largest magnitude. ``None`` where one side is not known.
    U : float or None
        Expanded uncertainty of the difference, the root sum of squares of both; ``None`` where
        one of them is not known.
    exceeds : bool or None
        Whether the magnitude of the difference is larger than `U`.
    tolerance : float or None
        Allowed magnitude of the difference; ``None`` where equality was asked for.
    verdict_a, verdict_b : str or None
        Of the checks.
    equal : bool
        Whether the difference is within the tolerance and the verdicts are the same.
    message : str
        Why it is not equal, or why nothing could be subtracted; empty otherwise.
    """

    metric: str
    name: str
    unit: str
    value_a: float | None
    value_b: float | None
    difference: float | None
    U: float | None
    exceeds: bool | None
    tolerance: float | None
    verdict_a: str | None
    verdict_b: str | None
    equal: bool
    message: str = ""

    def to_dict(self) -> dict[str, Any]:
        """Return the fields as plain values.

        Returns
        -------
        dict
            By name of the field.
        """
        return {name: getattr(self, name) for name in self.__slots__}


@dataclass(frozen=True, slots=True)
class Comparison:
    """Two results, recipes or tables side by side.

    Parameters
    ----------
    kind : {"result", "recipe", "table"}
        What was compared.
    rows : tuple of Row
        Values.
    recipe : tuple of str
        Lines of a unified diff of the recipes; empty where they are the same.
    inputs, versions, other : tuple of str
        What else differs, a line each: input files, versions of programs, further parts.
    messages : tuple of str
        What could not be compared, and why.
    equal : bool
        Whether every row is equal and, for recipes, no key differs.
    """

    kind: str
    rows: tuple[Row, ...]
    recipe: tuple[str, ...] = ()
    inputs: tuple[str, ...] = ()
    versions: tuple[str, ...] = ()
    other: tuple[str, ...] = ()
    messages: tuple[str, ...] = ()
    equal: bool = True

    def to_dict(self) -> dict[str, Any]:
        """Return plain values.

        Returns
        -------
        dict
            Schema ``metrosep.comparison/1``.
        """
        lists = {
            k: list(getattr(self, k))
            for k in ("recipe", "inputs", "versions", "other", "messages")
        }
        rows = [row.to_dict() for row in self.rows]
        return {"schema": "metrosep.comparison/1", "kind": self.kind, "equal": self.equal} | (
            {"rows": rows} | lists
        )


class Tolerances:
    """Allowed differences by metric or name; ``"*"`` stands for every row without its own."""

    def __init__(self, given: Mapping[str, float | str] | None = None) -> None:
        from metrosep.parameters.symbol_units import current_symbol

        self._given = {current_symbol(name): value for name, value in (given or {}).items()}
        self._used: set[str] = set()
        for name, value in self._given.items():
            if isinstance(value, bool) or not isinstance(value, int | float | str):
                raise DataError(
                    f'the tolerance of {name} is {value!r}; give a number in SI, "5 nm", or "U"'
                )

    def of(self, metric: str, name: str, unit: str, expanded: float | None) -> float | None:
        """Return the tolerance of a row."""
        key = next((k for k in (metric, name, _EVERY) if k in self._given), None)
        if key is None:
            return None
        value = self._given[key]
        if value == "U":
            self._used.add(key)
            return expanded
        if key == _EVERY and isinstance(value, str) and not _has_dimension(value, unit):
            return None
        self._used.add(key)
        number = _in_si(value, unit, f"the tolerance of {key}")
        if not math.isfinite(number) or number < 0.0:
            raise DataError(f"the tolerance of {key} is {value}; give a finite one, not below 0")
        return number

    def asks_for_u(self, metric: str, name: str) -> bool:
        """Return whether the tolerance of a row is its expanded uncertainty."""
        return (
            next((self._given[k] for k in (metric, name, _EVERY) if k in self._given), "") == "U"
        )

    def require_used(self, names: list[str]) -> None:
        """Refuse a tolerance that belongs to no row."""
        left = sorted(set(self._given) - self._used - {_EVERY})
        if left:
            raise DataError(
                f"a tolerance is given for {left[0]!r}, and no value has that name; the names are "
                + (", ".join(dict.fromkeys(names)) or "none")
            )


def judged_row(
    metric: str,
    name: str,
    unit: str,
    values: tuple[float | None, float | None],
    difference: float | None,
    *,
    expanded: float | None,
    verdicts: tuple[str | None, str | None],
    tolerances: Tolerances,
    message: str = "",
) -> Row:
    """Return a row with its judgement."""
    tolerance = tolerances.of(metric, name, unit, expanded)
    reasons = [message] if message else []
    exceeds = None if difference is None or expanded is None else abs(difference) > expanded
    if not message and difference is None and (values[0] is None) != (values[1] is None):
        reasons.append(f"not known in {'A' if values[0] is None else 'B'}")
    if difference is not None and not abs(difference) <= (tolerance or 0.0):
        reasons.append("differs by more than the tolerance" if tolerance else "differs")
        if tolerance is None and tolerances.asks_for_u(metric, name):
            reasons.append("its U is not known on both sides")
    if verdicts[0] != verdicts[1]:
        reasons.append(f"verdict {verdicts[0] or 'none'} became {verdicts[1] or 'none'}")
    return Row(
        metric, name, unit, *values, difference, expanded, exceeds, tolerance, *verdicts,
        equal=not reasons, message="; ".join(reasons),
    )  # fmt: skip


def known_number(value: Any, where: str) -> float | None:
    """Return a number of a document; NaN and infinities are not known."""
    if value is None:
        return None
    if isinstance(value, bool) or not isinstance(value, int | float):
        raise DataError(f"{where} is {value!r}, not a number; the document is damaged")
    return float(value) if math.isfinite(value) else None


def largest_difference(
    a: Sequence[float | None], b: Sequence[float | None]
) -> tuple[float | None, str]:
    """Return the largest magnitude of b - a where both are known, and what is known on one side only."""
    pairs = list(zip(a, b, strict=True))
    known = [abs(y - x) for x, y in pairs if x is not None and y is not None]
    one_sided = sum((x is None) != (y is None) for x, y in pairs)
    gaps = f"{one_sided} entries are known on one side only" if one_sided else ""
    return max(known, default=None), gaps


def _has_dimension(text: str, unit: str) -> bool:
    unit_text = text.strip().lstrip("+-.0123456789eE").strip()
    dimension = _DIMENSIONS.get(unit)
    if dimension is None or not unit_text:
        return unit == "1" and not unit_text
    return parse_unit(unit_text).dimension == dimension


def _in_si(value: float | str, unit: str, name: str) -> float:
    if not isinstance(value, str):
        return float(value)
    dimension = _DIMENSIONS.get(unit)
    if dimension is not None:
        try:
            return parse_quantity(value, dimension=dimension, name=name)
        except UnitError as exc:
            raise UnitError(f"{name}: {exc}") from None
    try:
        return float(value.removesuffix(unit).strip())
    except ValueError:
        raise DataError(f"{name} is {value!r}; write a number in {unit!r}") from None


# ---- two compensation tables side by side, from what metrosep wrote beside them ----------------

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
    "limits", "waived", "trial", "file_sha256", "quantisation_m", "quantisation_rad",
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
    turns = any("forward_rad" in t for t in (a, b))
    a, b = numbers_of(a), numbers_of(b)
    meaning = next((k for k in _MEANING if a.get(k) != b.get(k)), None)
    grid = next((k for k in _GRIDS if a.get(k) != b.get(k)), None)
    for key, name in _ENTRIES.items():
        one, two = (_listed(t.get(key)) for t in (a, b))
        if one is None and two is None:
            continue
        unit = "1" if key == "coefficients_si" else "rad" if turns else "m"
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
