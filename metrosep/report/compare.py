"""Two results side by side: values with the uncertainty of their difference, and what else differs.

The difference is b minus a. Its expanded uncertainty is the root sum of squares of both: right where
the two measurements are independent, too large where they share an artefact or a sensor.
"""

from __future__ import annotations

import difflib
import math
import tomllib
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from typing import Any

from metrosep.core.errors import DataError, RecipeError
from metrosep.core.readable import readable_unit
from metrosep.recipe.result import SCHEMA
from metrosep.report.comparison import (
    Comparison,
    Row,
    Tolerances,
    judged_row,
    known_number,
    largest_difference,
    table_rows,
)

Document = Mapping[str, Any]

_NM = 1e-9
_COVERAGE = 2.0
"""From a standard to an expanded uncertainty where the check states none and u has no degrees of freedom."""

_SPELLING = 1e-14
"""Relative difference of one limit in two units."""

_KINDS: Mapping[str, type] = {
    "characteristics": list, "inputs": list, "recipe": Mapping, "versions": Mapping,
    "plots": Mapping, "separation": Mapping, "table": Mapping, "verdict": str,
}  # fmt: skip

_MOST_LINES = 40
_COMPARED = ("characteristics", "recipe", "inputs", "versions", "verdict", "schema")


def compare_documents(
    a: Document, b: Document, *, tolerances: Mapping[str, float | str] | None = None
) -> Comparison:
    """Return two results side by side.

    Parameters
    ----------
    a, b : mapping
        Content of two result.json (schema ``metrosep.result/1``).
    tolerances : mapping of str to (float or str), optional
        Allowed magnitudes of differences by metric or name: numbers in SI, texts with a unit such as
        ``"5 nm"``, or ``"U"`` for the expanded uncertainty of the difference; ``"*"`` for every row
        without its own. Without a tolerance only the same number is equal.

    Returns
    -------
    Comparison
        A row for each characteristic of either side, for each curve and for the table.

    Raises
    ------
    DataError
        If one is not a result or is damaged, or a tolerance is wrong or belongs to no row.
    UnitError
        If the unit of a tolerance does not fit its row.

    Notes
    -----
    Rows are matched by metric and name, then by metric alone. U is the expanded uncertainty of the
    check, else twice the standard uncertainty; U of the difference is sqrt(U_a^2 + U_b^2), which
    holds for independent measurements. A value that is not known is equal only to one that is not
    known. Curves and tables are compared entry by entry at the same positions: two results of the
    same P-V and opposite sign differ; so are the maps and profiles of a measurement. A check that asks
    another thing is a difference: limits, guard factor, definition, and U where it changed by more
    than the tolerance of its row. Recipe, inputs and versions are listed but do not count.
    """
    for name, document in (("A", a), ("B", b)):
        _require_result(document, name)
        _require_parts(document, name)
    allowed = Tolerances(tolerances)
    rows = [_row(x, y, allowed) for x, y in _pairs(_entries(a, "A"), _entries(b, "B"))]
    rows += _curves(a, b, allowed)
    rows += chart_rows(a, b, tolerances=allowed)
    rows += _tables(a, b, allowed)
    allowed.require_used([r.metric for r in rows])
    messages = []
    verdicts = [d.get("verdict") for d in (a, b)]
    if verdicts[0] != verdicts[1]:
        messages.append(
            f"the verdict over all checks was {verdicts[0] or 'none'} and is {verdicts[1] or 'none'}"
        )
    if not rows:
        messages.append("neither result holds a value, a curve or a table that could be compared")
    return Comparison(
        "result",
        tuple(rows),
        recipe_diff(_recipe_text(a), _recipe_text(b)),
        tuple(_inputs(a, b)),
        tuple(_versions(a, b)),
        tuple(_limits(a, b)) + tuple(_other(a, b)),
        tuple(messages),
        bool(rows) and verdicts[0] == verdicts[1] and all(r.equal for r in rows),
    )


def _recipe_text(document: Document) -> str:
    return str((document.get("recipe") or {}).get("text") or "")


def recipe_diff(a: str, b: str, names: tuple[str, str] = ("A", "B")) -> tuple[str, ...]:
    """Return the lines of a unified diff.

    Examples
    --------
    >>> recipe_diff('upper = "5 nm"', 'upper = "6 nm"')[-2:]
    ('-upper = "5 nm"', '+upper = "6 nm"')
    """
    lines = difflib.unified_diff(a.splitlines(), b.splitlines(), *names, lineterm="", n=2)
    return tuple(lines)


def _require_result(document: Any, name: str) -> None:
    if isinstance(document, Mapping) and document.get("schema") == SCHEMA:
        return
    found = document.get("schema") if isinstance(document, Mapping) else type(document).__name__
    raise DataError(
        f"{name} is not a result of metrosep (schema {found!r}, expected {SCHEMA!r}); give the "
        "content of a result.json"
    )


def _require_parts(document: Document, name: str) -> None:
    for key, kind in _KINDS.items():
        if document.get(key) is not None and not isinstance(document[key], kind):
            raise DataError(
                f"the part {key!r} of {name} is a {type(document[key]).__name__}, not what a result "
                "holds there; it is damaged, so run the recipe again"
            )


def _entries(document: Document, side: str) -> list[Document]:
    entries = document.get("characteristics") or []
    if not isinstance(entries, Sequence) or not all(isinstance(e, Mapping) for e in entries):
        raise DataError(f"the characteristics of {side} are not a list of values; it is damaged")
    return list(entries)


def _metric(entry: Document) -> str:
    from metrosep.parameters.symbol_units import current_symbol

    return current_symbol(
        str(entry.get("metric") or entry.get("symbol") or entry.get("name") or "?")
    )


def _pairs(
    a: Sequence[Document], b: Sequence[Document]
) -> Iterator[tuple[Document | None, Document | None]]:
    """Give what belongs together: same metric and name first, then the same metric in order."""
    partner: dict[int, int] = {}
    free = list(range(len(b)))
    for key in (lambda e: (_metric(e), e.get("name")), _metric):
        for i, entry in enumerate(a):
            if i in partner:
                continue
            match = next((j for j in free if key(b[j]) == key(entry)), None)
            if match is not None:
                partner[i] = match
                free.remove(match)
    for i, entry in enumerate(a):
        yield entry, b[partner[i]] if i in partner else None
    for j in free:
        yield None, b[j]


def _row(a: Document | None, b: Document | None, tolerances: Tolerances) -> Row:
    one = a if a is not None else b or {}
    metric, name = _metric(one), str(one.get("name") or _metric(one))
    sides = [{} if e is None else e for e in (a, b)]
    values = [known_number(e.get("value"), f"the value of {metric}") for e in sides]
    spreads = [_expanded(e, metric) for e in sides]
    units = [None if e is None else str(e.get("unit") or "1") for e in (a, b)]
    difference = expanded = None
    message = ""
    if None in units:
        message = f"only in {'B' if a is None else 'A'}"
    elif units[0] != units[1]:
        message = f"the units differ: {units[0]} and {units[1]}"
    elif values[0] is not None and values[1] is not None:
        difference = values[1] - values[0]
        if spreads[0] is not None and spreads[1] is not None:
            expanded = math.hypot(spreads[0], spreads[1])
    row = judged_row(
        metric,
        name,
        next(u for u in units if u is not None),
        (values[0], values[1]),
        difference,
        expanded=expanded,
        verdicts=(sides[0].get("verdict"), sides[1].get("verdict")),
        tolerances=tolerances,
        message=message,
    )
    asked = [] if a is None or b is None else list(_asked_otherwise(a, b, row.unit, row.tolerance))
    if not asked:
        return row
    return replace(row, equal=False, message="; ".join(t for t in (row.message, *asked) if t))


def _asked_otherwise(a: Document, b: Document, unit: str, allowed: float | None) -> Iterator[str]:
    """Give what the two checks ask differently: the same value means another thing then."""
    for key, words in (("lower", "lower limit"), ("upper", "upper limit"), ("U", "U")):
        one, two = (known_number(e.get(key), f"{words} of {_metric(e)}") for e in (a, b))
        if not _is_near(one, two, allowed or 0.0 if key == "U" else 0.0):
            scale, factor = readable_unit([one, two], unit)
            shown = ["none" if v is None else f"{v / factor:.6g} {scale}" for v in (one, two)]
            yield f"{words} {shown[0]} became {shown[1]}"
    one, two = (known_number(e.get("guard_factor"), "the guard factor") for e in (a, b))
    if not _is_near(one, two, 0.0):
        yield f"guard factor {'none' if one is None else one} became {'none' if two is None else two}"
    if a.get("definition") != b.get("definition"):
        yield f"the definition was {a.get('definition')!r} and is {b.get('definition')!r}"


def _is_near(a: float | None, b: float | None, allowed: float) -> bool:
    """Whether two numbers are the same; 0.1 um and 100 nm are, though not to the last digit."""
    if a is None or b is None:
        return a is b
    return abs(a - b) <= allowed + _SPELLING * max(abs(a), abs(b))


def _expanded(entry: Document, metric: str) -> float | None:
    stated = known_number(entry.get("U"), f"U of {metric}")
    if stated is not None:
        return stated
    u = known_number(entry.get("u"), f"u of {metric}")
    if u is None:
        return None
    dof = known_number(entry.get("dof"), f"the degrees of freedom of {metric}")
    if dof is None:
        return _COVERAGE * u
    from metrosep.forms._correlated import expanding_factor

    return expanding_factor(dof) * u if dof > 0.0 else None


def _curves(a: Document, b: Document, tolerances: Tolerances) -> Iterator[Row]:
    """Give the separated curves, entry by entry: the same P-V may hide a turned sign."""
    first, second = dict(_curves_of(a)), dict(_curves_of(b))
    for name in dict.fromkeys([*first, *second]):
        one, two = first.get(name), second.get(name)
        metric = f"curve.{name}"
        if one is None or two is None:
            side, unit = ("B" if one is None else "A", (one or two or ("m",))[-1])
            yield _whole(metric, name, str(unit), None, f"only in {side}", tolerances)
            continue
        (x, y, unit_a), (x_b, y_b, unit_b) = one, two
        message = ""
        if unit_a != unit_b:
            message = f"the units differ: {unit_a} and {unit_b}"
        elif x != x_b or len(y) != len(y_b):
            message = "the positions differ, so nothing was subtracted"
        largest, gaps = (None, "") if message else largest_difference(y, y_b)
        yield _whole(metric, name, unit_a, largest, message or gaps, tolerances)


def _curves_of(document: Document) -> Iterator[tuple[str, tuple[list[Any], list[Any], str]]]:
    plots = document.get("plots") or {}
    if plots.get("x_mm"):
        lines = plots.get("directions") or [plots]
        for line in lines:
            values = _flat(line.get("estimate_nm") or [])
            name = "error" if len(lines) < 2 else f"error, {line.get('direction')}"
            yield name, (plots["x_mm"], [None if v is None else v * _NM for v in values], "m")
    separation = document.get("separation") or {}
    units = separation.get("units") or {}
    coordinates = [separation.get("coordinates") or {}]
    for name, values in (separation.get("parts") or {}).items():
        yield str(name), (coordinates, _flat(values), str(units.get(name) or "m"))


def _flat(values: Any) -> list[float | None]:
    if isinstance(values, list | tuple):
        return [v for part in values for v in _flat(part)]
    return [known_number(values, "an entry of a curve")]


def _whole(
    metric: str,
    name: str,
    unit: str,
    largest: float | None,
    message: str,
    tolerances: Tolerances,
) -> Row:
    return judged_row(
        metric,
        f"{name}, largest difference of its entries",
        unit,
        (None, None),
        largest,
        expanded=None,
        verdicts=(None, None),
        tolerances=tolerances,
        message=message,
    )


def _tables(a: Document, b: Document, tolerances: Tolerances) -> Iterator[Row]:
    one, two = a.get("table"), b.get("table")
    if one and two:
        yield from table_rows(one, two, tolerances=tolerances)
    elif one or two:
        side = "A" if one else "B"
        yield _whole("table", "compensation table", "m", None, f"only in {side}", tolerances)


def _inputs(a: Document, b: Document) -> Iterator[str]:
    both = [
        [(str(i.get("name")), str(i.get("sha256"))) for i in d.get("inputs") or []] for d in (a, b)
    ]
    if both[0] == both[1]:
        return
    for side, own, other in (("A", both[0], both[1]), ("B", both[1], both[0])):
        hashes = {h for _, h in other}
        for name, digest in own:
            if digest not in hashes:
                yield f"only in {side}: {name} (SHA-256 {digest[:12]})"
    if {h for _, h in both[0]} == {h for _, h in both[1]}:
        yield "the same content under other names, or in another order"


def _versions(a: Document, b: Document) -> Iterator[str]:
    both = [{"metrosep": d.get("metrosep")} | dict(d.get("versions") or {}) for d in (a, b)]
    for name in sorted({*both[0], *both[1]}):
        one, two = (v.get(name) for v in both)
        if one != two:
            yield f"{name}: {one or 'none'} and {two or 'none'}"


def _limits(a: Document, b: Document) -> Iterator[str]:
    for x, y in _pairs(_entries(a, "A"), _entries(b, "B")):
        for key, words in (("lower", "lower limit"), ("upper", "upper limit"), ("U", "U")):
            if x is not None and y is not None and x.get(key) != y.get(key):
                yield f"{words} of {_metric(x)}: {x.get(key)} and {y.get(key)}"


def _other(a: Document, b: Document) -> Iterator[str]:
    """Give the places of a document that differ beside what the rows tell."""
    found = [
        line
        for key in sorted({*a, *b} - set(_COMPARED) - {"metrosep"})
        for line in _differing(a.get(key), b.get(key), key)
    ]
    yield from found[:_MOST_LINES]
    if len(found) > _MOST_LINES:
        yield f"and {len(found) - _MOST_LINES} further places"


def _differing(a: Any, b: Any, path: str) -> Iterator[str]:
    if a == b:
        return
    if isinstance(a, Mapping) and isinstance(b, Mapping):
        for key in sorted({*a, *b}, key=str):
            yield from _differing(a.get(key), b.get(key), f"{path}.{key}")
    elif isinstance(a, list) and isinstance(b, list) and len(a) == len(b) and _has_tables(a):
        for i, (x, y) in enumerate(zip(a, b, strict=True)):
            yield from _differing(x, y, f"{path}[{i}]")
    else:
        yield path


def _has_tables(items: list[Any]) -> bool:
    return any(isinstance(i, Mapping) for i in items)


# ---- maps and profiles of two measurements entry by entry: Sq and Sz do not see a turned sign ----

_STEPS = ("dx_m", "dy_m", "origin_m", "step")
Chart = Mapping[str, Any]
Part = tuple[Any, list[float | None], str, bool]
"""Positions, values, unit, and whether only some of the samples are there."""


def chart_rows(
    a: Mapping[str, Any], b: Mapping[str, Any], *, tolerances: Tolerances
) -> Iterator[Row]:
    """Give the largest difference of the entries of each map and profile of two measurements.

    Notes
    -----
    Entries are those that the result holds: large maps and long profiles are thinned out there. Of a
    thinned profile the positions that both hold are compared.
    """
    both = [d.get("separation") or {} for d in (a, b)]
    if any(s.get("op") != "measure" for s in both):
        return
    first, second = (dict(_parts_of(s.get("charts") or [])) for s in both)
    for k, key in enumerate(dict.fromkeys([*first, *second]), start=1):
        one, two = first.get(key), second.get(key)
        largest, message = None, f"only in {'B' if one is None else 'A'}"
        if one is not None and two is not None:
            largest, message = _difference(one, two)
        yield judged_row(
            f"chart.{k}",
            f"{key[0]}, largest difference of its entries",
            (one or two or (None, [], "m", False))[2],
            (None, None),
            largest,
            expanded=None,
            verdicts=(None, None),
            tolerances=tolerances,
            message=message,
        )


def _difference(a: Part, b: Part) -> tuple[float | None, str]:
    """Return the largest magnitude of b - a, and why the two are not alike."""
    (x, y, unit, some), (x_b, y_b, unit_b, some_b) = a, b
    if unit != unit_b:
        return None, f"the units differ: {unit} and {unit_b}"
    if some and some_b and x != x_b:
        one, two = dict(zip(x, y, strict=True)), dict(zip(x_b, y_b, strict=True))
        shared = [p for p in one if p in two]
        y, y_b = [one[p] for p in shared], [two[p] for p in shared]
        if not shared:
            return None, "the positions differ, so nothing was subtracted"
    elif x != x_b or len(y) != len(y_b):
        return None, "the positions differ, so nothing was subtracted"
    return largest_difference(y, y_b)


def _parts_of(charts: Sequence[Any]) -> Iterator[tuple[tuple[str, int], Part]]:
    """Give each map and curve by its words, and how often these were there before."""
    seen: dict[str, int] = {}
    for chart in charts:
        if not isinstance(chart, Mapping):
            continue
        for words, part in _parts(chart):
            seen[words] = seen.get(words, 0) + 1
            yield (words, seen[words]), part


def _parts(chart: Chart) -> Iterator[tuple[str, Part]]:
    title = str(chart.get("title") or "")
    if chart.get("kind") == "maps":
        for name, rows in (chart.get("parts") or {}).items():
            place = [chart.get(k) for k in _STEPS] + [[len(r) for r in rows]]
            words = ", ".join(t for t in (title, str(name)) if t)
            yield words, (place, _numbers(rows, words), str(chart.get("unit") or "m"), False)
    elif chart.get("kind") == "curves":
        for panel in chart.get("panels") or []:
            for line in panel.get("curves") or []:
                words = ", ".join(
                    str(t) for t in (title, panel.get("title"), line.get("label")) if t
                )
                x, y = (_numbers(line.get(k) or [], words) for k in ("x", "y"))
                some = int(line.get("n") or 0) > len(x)
                yield words, (x, y, str(panel.get("unit") or "m"), some)


def _numbers(values: Any, words: str) -> list[float | None]:
    if isinstance(values, list | tuple):
        return [v for part in values for v in _numbers(part, words)]
    return [known_number(values, f"an entry of {words}")]


# ---- two recipes side by side: their texts, and the keys whose values differ -------------------


def compare_recipes(a: str, b: str, *, names: tuple[str, str] = ("A", "B")) -> Comparison:
    """Return two recipes side by side.

    Parameters
    ----------
    a, b : str
        Texts (TOML).
    names : tuple of str, optional
        Of both, for messages and the diff.

    Returns
    -------
    Comparison
        Without rows: `recipe` holds the unified diff, `other` the keys that differ. Equal where no
        key outside ``[view]`` differs; comments and order of keys do not count.

    Raises
    ------
    RecipeError
        If a text is not TOML.

    Examples
    --------
    >>> compare_recipes("metrosep = 1  # first", "metrosep = 1").equal
    True
    """
    tables = []
    for name, text in zip(names, (a, b), strict=True):
        try:
            tables.append(tomllib.loads(text))
        except (tomllib.TOMLDecodeError, RecursionError) as exc:
            raise RecipeError(f"{name} is not TOML ({exc}); correct it there") from None
    lines = list(_keys(tables[0], tables[1]))
    kept = [line for line in lines if not line.startswith(("view.", "view:"))]
    messages = []
    if not lines and a != b:
        messages.append("the texts differ in comments, spaces or order only")
    if lines and not kept:
        messages.append("only [view] differs, which no run heeds")
    return Comparison(
        "recipe",
        (),
        recipe=recipe_diff(a, b, names),
        other=tuple(lines),
        messages=tuple(messages),
        equal=not kept,
    )


def _keys(a: Mapping[str, Any], b: Mapping[str, Any], path: str = "") -> Iterator[str]:
    for key in dict.fromkeys([*a, *b]):
        here = f"{path}{key}"
        if key not in a or key not in b:
            side, value = ("B", b[key]) if key not in a else ("A", a[key])
            yield f"{here}: {value!r} only in {side}"
            continue
        yield from _values(a[key], b[key], here)


def _values(a: Any, b: Any, here: str) -> Iterator[str]:
    if isinstance(a, dict) and isinstance(b, dict):
        yield from _keys(a, b, f"{here}.")
    elif isinstance(a, list) and isinstance(b, list) and _of_tables(a) and _of_tables(b):
        for i in range(max(len(a), len(b))):
            if i >= len(a) or i >= len(b):
                side, value = ("A", a[i]) if i < len(a) else ("B", b[i])
                yield f"{here}[{i + 1}]: {value!r} only in {side}"
            else:
                yield from _keys(a[i], b[i], f"{here}[{i + 1}].")
    elif type(a) is not type(b) or a != b:
        yield f"{here}: {a!r} and {b!r}"


def _of_tables(values: list[Any]) -> bool:
    return bool(values) and all(isinstance(v, dict) for v in values)
