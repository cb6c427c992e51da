"""The separations that a recipe can ask for by name: what each reads, its keys, and its call.

Every entry is data (`Method`): the kind of its inputs, the keys of its step, and a function of the
toolbox that is loaded when it is used.
"""

from __future__ import annotations

from collections.abc import Mapping

from metrosep.recipe.deviations import with_values
from metrosep.recipe.method import CURVES, MAPS, Method, input_fields
from metrosep.recipe.ops_checks import CHECKS
from metrosep.recipe.ops_circle import CIRCLE
from metrosep.recipe.ops_dual_servo import DUAL_SERVO
from metrosep.recipe.ops_lines import LINES
from metrosep.recipe.ops_machine import MACHINES
from metrosep.recipe.ops_maps import MAPS_OF
from metrosep.recipe.ops_planes import PLANES
from metrosep.recipe.ops_positions import POSITIONS
from metrosep.recipe.ops_process import PROCESSES
from metrosep.recipe.ops_quality import QUALITY
from metrosep.recipe.ops_results import RESULTS
from metrosep.recipe.plan import PLANS

__all__ = ["CURVES", "MAPS", "METHODS", "Method", "input_fields"]

METHODS: Mapping[str, Method] = {
    **CIRCLE,
    **LINES,
    **{name: with_values(method) for name, method in POSITIONS.items()},
    **MAPS_OF,
    **PLANES,
    **RESULTS,
    **PLANS,
    **CHECKS,
    **MACHINES,
    **PROCESSES,
    **DUAL_SERVO,
    **QUALITY,
}
