"""One recipe over a folder: crash-safe, resumable, on processes, threads or a cluster."""

from __future__ import annotations

from typing import TYPE_CHECKING

from metrosep.core._lazy import lazy_names

if TYPE_CHECKING:
    from metrosep.batch.index import BatchReport as BatchReport, build_index as build_index
    from metrosep.batch.run import run_batch as run_batch
    from metrosep.batch.units import Unit as Unit, find_units as find_units

_HOMES = {
    "index": (
        "BatchReport",
        "build_index",
    ),
    "run": ("run_batch",),
    "units": (
        "Unit",
        "find_units",
    ),
}

__all__ = ["BatchReport", "Unit", "build_index", "find_units", "run_batch"]

__getattr__ = lazy_names(__name__, _HOMES)


def __dir__() -> list[str]:
    return __all__
