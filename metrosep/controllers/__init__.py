"""Controllers' files: tables, maps, polynomials and paths, each with writer, reader and simulator.

A name loads its module on first use.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from metrosep.core._lazy import lazy_names

if TYPE_CHECKING:
    from metrosep.controllers.files import (
        dry_run_carried as dry_run_carried,
        read as read,
        simulate as simulate,
        write as write,
    )
    from metrosep.controllers.gcode.corrections import (
        PathCorrection as PathCorrection,
        as_path_correction as as_path_correction,
        error_correction as error_correction,
        nose_correction as nose_correction,
    )
    from metrosep.controllers.gcode.lists import (
        PointResult as PointResult,
        rewrite_points as rewrite_points,
    )
    from metrosep.controllers.gcode.paths import (
        PathResult as PathResult,
        rewrite_path as rewrite_path,
    )
    from metrosep.controllers.registry import (
        describe as describe,
        find as find,
        names as names,
    )

_HOMES = {
    "files": ["dry_run_carried", "read", "simulate", "write"],
    "gcode.corrections": [
        "PathCorrection",
        "as_path_correction",
        "error_correction",
        "nose_correction",
    ],
    "gcode.paths": ["PathResult", "rewrite_path"],
    "gcode.lists": ["PointResult", "rewrite_points"],
    "registry": ["describe", "find", "names"],
}

__all__ = sorted(name for names in _HOMES.values() for name in names)  # noqa: PLE0605

__getattr__ = lazy_names(__name__, _HOMES)


def __dir__() -> list[str]:
    return list(__all__)
