"""Controllers' files: tables, maps, polynomials and paths, each with writer, reader and simulator.

A name loads its module on first use.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from metrosep.core._lazy import lazy_package

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
    from metrosep.controllers.gcode.lathe import (
        LatheAxes as LatheAxes,
        rounding_error as rounding_error,
    )
    from metrosep.controllers.gcode.lists import (
        PointResult as PointResult,
        rewrite_points as rewrite_points,
    )
    from metrosep.controllers.gcode.paths import (
        PathResult as PathResult,
        rewrite_path as rewrite_path,
    )
    from metrosep.controllers.gcode.turning import (
        ProgramCheck as ProgramCheck,
        WrittenProgram as WrittenProgram,
        check_program as check_program,
        write_program as write_program,
    )
    from metrosep.controllers.gcode.turning_reader import read_program as read_program
    from metrosep.controllers.registry import describe as describe, find as find, names as names

__getattr__, __dir__ = lazy_package(__name__)
