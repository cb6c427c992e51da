"""Steps of recipes about many parts: gauge study, series of parts."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from metrosep.core.errors import DataError, InvalidSamplesError
from metrosep.core.provenance import Step
from metrosep.core.quantity import Quantity
from metrosep.io.runs import RoleColumns
from metrosep.recipe.method import OP, Method, toolbox
from metrosep.recipe.schema import Field

__all__ = ["QUALITY", "RESULTS", "StoredResults", "load_results"]


def _gauge(data: RoleColumns, options: Mapping[str, Any]) -> Any:
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
            "measured in every condition, or left out"
        )
    counts = {k: len(v) for k, v in rows.items()}
    if len(set(counts.values())) > 1:
        least, most = (pick(counts, key=lambda k: counts[k]) for pick in (min, max))
        raise InvalidSamplesError(
            f"part {least[0]} in condition {least[1]} has {counts[least]} readings, part {most[0]} "
            f"in {most[1]} has {counts[most]}; the same number is needed everywhere"
        )
    return np.array([[rows[p, c] for c in second] for p in first], dtype=np.float64)


def _series(data: RoleColumns, options: Mapping[str, Any]) -> Any:
    from metrosep.parameters import part_series

    names = data.columns["terms"]
    if len(set(names)) != len(names):
        raise DataError(f"a term is named twice in {', '.join(names)}; give each its own name")
    table = dict(zip(names, np.atleast_2d(data.values["terms"]), strict=True))
    unit = data.units.get("terms", "m")
    return part_series(table, units=dict.fromkeys(names, unit), **options)


QUALITY: Mapping[str, Method] = {
    "gauge_study": Method(
        "repeatability and reproducibility of a measuring process (analysis of variance)",
        "table",
        (),
        {
            **OP,
            "tolerance": Field("limit"),
            "pool": Field("number"),
            "coverage": Field("number"),
        },
        _gauge,
        roles={"part": "label", "condition": "label?", "value": "position"},
    ),
    "part_series": Method(
        "drift and correlation of terms over a series of parts, control limits",
        "table",
        (),
        {**OP, "rate": Field("number")},
        _series,
        roles={"terms": "position*"},
    ),
}


# ---- steps of recipes that go on from results: the plane of two axes, methods combined ---------


@dataclass(frozen=True, slots=True, eq=False)
class StoredResults:
    """Result documents that a step goes on from."""

    documents: tuple[Mapping[str, Any], ...]  # of mapping: in the order of the files
    history: tuple[Step, ...]  # one step ``read`` for each file
    warnings: tuple[str, ...] = ()  # always empty


def load_results(files: Sequence[Path]) -> StoredResults:
    """Read result documents."""
    from metrosep.io.source import open_file
    from metrosep.recipe.result import load_document

    documents = tuple(load_document(file) for file in files)
    history: list[Step] = []
    for file in files:
        history += open_file(file).history("metrosep-result", {})
    return StoredResults(documents, tuple(history))


def _plane(data: StoredResults, options: Mapping[str, Any]) -> Any:
    from metrosep.recipe.result import stored_estimate

    if len(data.documents) != 2:
        raise DataError(
            f"two results are needed, of the axis along x and of that along y; got "
            f"{len(data.documents)}"
        )
    rest = dict(options)
    for name in ("alpha", "beta"):
        u = rest.pop(f"u_{name}", None)
        if u is not None:
            value = rest.get(name, 0.0)
            rest[name] = Quantity(value, "rad", f"{name}, as stated", u=u, symbol=name)
    if "origin" in rest and len(rest["origin"]) != 2:
        raise DataError('origin is x and y: origin = ["0 mm", "0 mm"]')
    return toolbox("plane_map")(*(stored_estimate(d) for d in data.documents), **rest)


def _combine(data: StoredResults, options: Mapping[str, Any]) -> Any:
    from metrosep.separation.contract import Separation

    found = []
    for step, document in zip(data.history, data.documents, strict=True):
        stored = document.get("separation") or {}
        if not stored.get("parts"):
            raise DataError(
                f"{step.parameters.get('file')}: holds no parts over a revolution; give results of "
                "donaldson, multiprobe, multistep or another separation of roundness"
            )
        found.append(Separation.from_dict(stored))
    return toolbox("combine_harmonics")(*found, **options)


RESULTS: Mapping[str, Method] = {
    "plane_map": Method(
        "error of an XY plane from the results of its two axes (result.json of X, of Y)",
        "results",
        ("along x", "along y"),
        {
            **OP,
            "dx": Field("size", required=True),
            "dy": Field("size", required=True),
            "alpha": Field("angle"),
            "beta": Field("angle"),
            "u_alpha": Field("angle"),
            "u_beta": Field("angle"),
            "origin": Field("lengths"),
        },
        _plane,
    ),
    "combine_harmonics": Method(
        "one artefact from the results of several methods, harmonic by harmonic",
        "results",
        (),
        {**OP, "parts": Field("texts"), "kmax": Field("integer")},
        _combine,
    ),
}
