"""Recipes: TOML lists of steps, and the result document they produce."""

from __future__ import annotations

from typing import TYPE_CHECKING

from metrosep.core._lazy import lazy_names

if TYPE_CHECKING:
    from metrosep.recipe.recipe import Recipe as Recipe
    from metrosep.recipe.result import Result as Result

_HOMES = {"recipe": ("Recipe",), "result": ("Result",)}

__all__ = ["Recipe", "Result"]

__getattr__ = lazy_names(__name__, _HOMES)


def __dir__() -> list[str]:
    return __all__


METHODS = {
    "dual_servo": "methods:OLD/dual_servo",
    "gauge_study": "methods:OLD/gauge_study",
    "part_series": "methods:OLD/part_series",
    "plan_from_density": "methods:OLD/plan_from_density",
    "rank": "methods:OLD/rank",
    "identify": "methods:OLD/identify",
    "wavefront": "methods:OLD/wavefront",
    "tool_setting": "methods:OLD/tool_setting",
    "follow_up": "methods:OLD/follow_up",
    "flexure_calibration": "methods:OLD/flexure_calibration",
    "predict": "methods:OLD/predict",
}
