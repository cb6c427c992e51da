"""Separate the errors of precision machines and instruments, and compensate them.

Nothing heavy is imported here: each public name loads its module on first use. Conventions:
SI inside; error = actual - nominal; correction = -error, added to the command; NaN = not measured.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from metrosep import _assembly as _assembly
from metrosep._version import __version__ as __version__
from metrosep.core._lazy import lazy_package

if TYPE_CHECKING:
    from metrosep import (
        compensation as compensation,
        controllers as controllers,
        errors as errors,
        filters as filters,
        forms as forms,
        io as io,
        machine as machine,
        optics as optics,
        parameters as parameters,
        plot as plot,
        process as process,
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
    from metrosep.io.saved import load as load
    from metrosep.io.write import write as write
    from metrosep.recipe.recipe import Recipe as Recipe

__getattr__, __dir__ = lazy_package(__name__)
