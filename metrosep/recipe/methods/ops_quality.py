"""Steps of recipes about many parts: gauge study, series of parts."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, ClassVar

import numpy as np
from numpy.typing import NDArray

from metrosep.core.errors import DataError, InvalidSamplesError
from metrosep.core.methods import Method, RoleColumns
from metrosep.core.options import Option


class GaugeStudied(Method):
    """`gauge_study` by its name."""

    name: ClassVar[str] = "gauge_study"
    what: ClassVar[str] = (
        "repeatability and reproducibility of a measuring process (analysis of variance)"
    )
    reads: ClassVar = "table"
    roles: ClassVar[Mapping[str, str]] = {
        "part": "label",
        "condition": "label?",
        "value": "position",
    }
    arguments: ClassVar[Mapping[str, Option]] = {
        "tolerance": Option("limit", help="width of the tolerance that the process must judge"),
        "pool": Option(
            "number",
            help="significance above which the interaction is pooled with the repeatability",
        ),
        "coverage": Option(
            "number", help="standard deviations that the spread of the process counts"
        ),
    }

    @classmethod
    def from_inputs(cls, data: RoleColumns, options: Mapping[str, Any]) -> Any:
        """Return what the step makes."""
        from metrosep.parameters import gauge_study

        values = data.values
        parts = values["part"]
        n = np.asarray(parts).size
        conditions = values.get("condition", np.full(n, "all"))
        readings = _cells(parts, conditions, values["value"])
        return gauge_study(
            readings,
            unit=data.units.get("value", "m"),
            name=data.columns["value"][0],
            **options,
        )


def _cells(
    parts: NDArray[Any], conditions: NDArray[Any], values: NDArray[Any]
) -> NDArray[np.float64]:
    """Return readings as parts by conditions by trials, trials in the order of the rows."""
    rows: dict[tuple[str, str], list[float]] = {}
    for part, condition, value in zip(parts, conditions, values, strict=True):
        rows.setdefault((str(part), str(condition)), []).append(float(value))
    first = list(dict.fromkeys(p for p, _ in rows))
    second = list(dict.fromkeys(c for _, c in rows))
    missing = [(p, c) for p in first for c in second if (p, c) not in rows]
    if missing:
        p, c = missing[0]
        raise InvalidSamplesError(
            f"part {p} has no reading in condition {c} ({len(missing)} such pairs); every part is "
            "measured in every condition, or omitted"
        )
    counts = {k: len(v) for k, v in rows.items()}
    if len(set(counts.values())) > 1:
        least, most = (pick(counts, key=lambda k: counts[k]) for pick in (min, max))
        raise InvalidSamplesError(
            f"part {least[0]} in condition {least[1]} has {counts[least]} readings, part {most[0]} "
            f"in {most[1]} has {counts[most]}; the same number is needed everywhere"
        )
    return np.array([[rows[p, c] for c in second] for p in first], dtype=np.float64)


class SeriesOfParts(Method):
    """`part_series` by its name."""

    name: ClassVar[str] = "part_series"
    what: ClassVar[str] = "drift and correlation of terms over a series of parts, control limits"
    reads: ClassVar = "table"
    roles: ClassVar[Mapping[str, str]] = {"terms": "position*"}
    arguments: ClassVar[Mapping[str, Option]] = {
        "rate": Option("number", help="accepted share of false findings among the pairs of terms"),
    }

    @classmethod
    def from_inputs(cls, data: RoleColumns, options: Mapping[str, Any]) -> Any:
        """Return what the step makes."""
        from metrosep.parameters import part_series

        names = data.columns["terms"]
        if len(set(names)) != len(names):
            raise DataError(f"a term is named twice in {', '.join(names)}; give each its own name")
        table = dict(zip(names, np.atleast_2d(data.values["terms"]), strict=True))
        unit = data.units.get("terms", "m")
        return part_series(table, units=dict.fromkeys(names, unit), **options)
