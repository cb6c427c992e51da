"""Steps of recipes that go on from results: the plane of two axes, methods combined."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from metrosep.core.errors import DataError
from metrosep.core.provenance import Step
from metrosep.core.quantity import Quantity
from metrosep.recipe.method import OP, Method, toolbox
from metrosep.recipe.schema import Field

__all__ = ["RESULTS", "StoredResults", "load_results"]


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
