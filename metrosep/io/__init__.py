"""Files: recognise, read and write measurements; the functions load on first use.

`metrosep.read`, `metrosep.read_runs` and `metrosep.write` are the short names. A reader never
levels, fills, crops or guesses a unit.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from metrosep.core._lazy import lazy_package

if TYPE_CHECKING:
    from metrosep.io.check import check_file as check_file
    from metrosep.io.readings import read_readings as read_readings
    from metrosep.io.registry import formats as formats, identify as identify
    from metrosep.io.runs import read_runs as read_runs
    from metrosep.io.stream import open_stream as open_stream

__getattr__, __dir__ = lazy_package(__name__)
