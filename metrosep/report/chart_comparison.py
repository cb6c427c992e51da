"""Maps and profiles of two measurements entry by entry: Sq and Sz do not see a turned sign."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from typing import Any

from metrosep.report.comparison import (
    Row,
    Tolerances,
    judged_row,
    known_number,
    largest_difference,
)

__all__ = ["chart_rows"]

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
