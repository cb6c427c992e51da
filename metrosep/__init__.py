"""Separate the errors of precision machines and instruments, and compensate them.

Nothing heavy is imported here: each public name loads its module on first use. Conventions:
SI inside; error = actual - nominal; correction = -error, added to the command; NaN = not measured.
"""

from __future__ import annotations

import importlib
from typing import TYPE_CHECKING, Any

from metrosep._version import __version__

if TYPE_CHECKING:
    from metrosep import (
        compensation as compensation,
        controllers as controllers,
        errors as errors,
        filters as filters,
        forms as forms,
        io as io,
        parameters as parameters,
        plot as plot,
        report as report,
        separation as separation,
        spectral as spectral,
    )
    from metrosep.core.profile import Profile as Profile
    from metrosep.core.quantity import Quantity as Quantity
    from metrosep.core.recording import Recording as Recording
    from metrosep.core.runset import Run as Run, RunSet as RunSet
    from metrosep.core.surface import Surface as Surface
    from metrosep.io.read import read as read
    from metrosep.io.runs import read_runs as read_runs
    from metrosep.io.write import write as write
    from metrosep.recipe.recipe import Recipe as Recipe

_OBJECTS = {
    "Profile": "metrosep.core.profile",
    "Quantity": "metrosep.core.quantity",
    "Recording": "metrosep.core.recording",
    "Recipe": "metrosep.recipe.recipe",
    "Run": "metrosep.core.runset",
    "RunSet": "metrosep.core.runset",
    "Surface": "metrosep.core.surface",
    "read": "metrosep.io.read",
    "read_runs": "metrosep.io.runs",
    "write": "metrosep.io.write",
}

_PACKAGES = (
    "compensation",
    "controllers",
    "errors",
    "filters",
    "forms",
    "io",
    "parameters",
    "plot",
    "report",
    "separation",
    "spectral",
)

__all__ = ["__version__", *sorted((*_OBJECTS, *_PACKAGES))]  # noqa: PLE0604


def __getattr__(name: str) -> Any:
    if name in _PACKAGES:
        return importlib.import_module(f"metrosep.{name}")
    if name in _OBJECTS:
        module = importlib.import_module(_OBJECTS[name])
        value = getattr(module, name)
        globals()[name] = value
        return value
    raise AttributeError(f"module 'metrosep' has no attribute {name!r}")


def __dir__() -> list[str]:
    return __all__
