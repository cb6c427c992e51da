"""One recipe over a folder: crash-safe, resumable, on processes, threads or a cluster."""

from __future__ import annotations

from typing import TYPE_CHECKING

from metrosep.core._lazy import lazy_package

if TYPE_CHECKING:
    from metrosep.batch.index import BatchReport as BatchReport, build_index as build_index
    from metrosep.batch.run import run_batch as run_batch
    from metrosep.batch.units import Unit as Unit, find_units as find_units

__getattr__, __dir__ = lazy_package(__name__)
