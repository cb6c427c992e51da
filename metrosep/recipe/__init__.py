"""Recipes: TOML lists of steps, and the result document they produce."""

from __future__ import annotations

from metrosep.recipe.recipe import Recipe
from metrosep.recipe.result import Result

__all__ = ["Recipe", "Result"]
