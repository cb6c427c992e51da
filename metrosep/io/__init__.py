"""Files: recognise, read and write measurements; the functions load on first use.

`metrosep.read`, `metrosep.read_runs` and `metrosep.write` are the short names. A reader never
levels, fills, crops or guesses a unit.
"""

from __future__ import annotations

from metrosep.io.registry import formats, identify

__all__ = ["formats", "identify"]
