"""Limits whose guard bands leave no room: a part between them can never be accepted."""

from __future__ import annotations

from collections.abc import Iterator
from typing import TYPE_CHECKING, Any

from metrosep.core.errors import RecipeError
from metrosep.core.limits import Limit
from metrosep.core.readable import typed_number
from metrosep.parameters.decision import decide

if TYPE_CHECKING:
    from metrosep.recipe.recipe import Recipe

__all__ = ["guard_notes"]

_DIGITS = 6
_TYPED = {"m": "length", "rad": "angle", "s": "time"}
"""Dimensions of limits that are shown in a unit that a person would type."""


def guard_notes(recipe: Recipe) -> Iterator[str]:
    """Return which checks can accept nothing, whatever is measured.

    Examples
    --------
    >>> from metrosep.recipe import Recipe
    >>> text = '''metrosep = 1
    ... [input]
    ... [[step]]
    ... op = "parameters"
    ... names = ["Sa"]
    ... [[check]]
    ... metric = "Sa"
    ... lower = "9 nm"
    ... upper = "12 nm"
    ... U = "2 nm"
    ... '''
    >>> print(*guard_notes(Recipe.parse(text, name="r.toml")))
    r.toml:10: nothing can be accepted: with U = 2 nm a value must be at least 11 nm and at most 10 nm
    """
    for i, check in enumerate(recipe.checks):
        if not all(isinstance(check.get(k), float | int) for k in ("lower", "upper", "U")):
            continue
        lower, upper, U = check["lower"], check["upper"], check["U"]
        factor = check.get("guard_factor", 1.0)
        guard = factor * U
        middle = lower + 0.5 * (upper - lower)
        limits = {"lower": lower, "upper": upper, "U": U, "guard_factor": factor}
        if decide(float(middle), **limits) == "accept":
            continue
        shown = [_shown(v, lower) for v in (U, lower + guard, upper - guard)]
        times = "" if factor == 1.0 else f" and guard_factor = {factor:g}"
        yield str(
            _error(
                recipe,
                i,
                f"nothing can be accepted: with U = {shown[0]}{times} a value must be at least "
                f"{shown[1]} and at most {shown[2]}",
            )
        )


def _error(recipe: Recipe, number: int, text: str) -> RecipeError:
    return recipe.place("[[check]]", number).error(text, "U")


def _shown(value: float, like: Any) -> str:
    """Return a value as the limits are given: lengths with their unit."""
    dimension = like.dimension if isinstance(like, Limit) else ""
    if dimension in _TYPED:
        return typed_number(float(value), _TYPED[dimension], digits=_DIGITS)
    return f"{float(value):.{_DIGITS}g} {dimension}".strip()
