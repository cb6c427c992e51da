"""Titles of results that were done before: a new title alone does nothing again."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping
from functools import lru_cache
from pathlib import Path
from typing import Any

from metrosep.core.errors import RecipeError

__all__ = ["former_title", "title_notes"]


def former_title(document: Mapping[str, Any], text: str) -> dict[str, str]:
    """Return the title of a result, where the recipe has another one now."""
    recipe = document.get("recipe")
    before = recipe.get("text") if isinstance(recipe, Mapping) else None
    title = _title(before) if isinstance(before, str) else None
    return {} if title is None or title == _title(text) else {"former_title": title}


@lru_cache(maxsize=64)
def _title(text: str) -> str | None:
    """Return the title that a recipe with its record gives, None where it cannot be read."""
    from metrosep.recipe.extends import layers_of

    try:
        return str(layers_of(text, "", Path()).data.get("title", ""))
    except RecipeError:
        return None


def title_notes(rows: Iterable[Mapping[str, Any]]) -> Iterator[str]:
    """Give the message that results have a former title."""
    titles = [r["former_title"] for r in rows if "former_title" in r]
    if titles:
        each = dict.fromkeys(f'"{t}"' if t else "none" for t in titles)
        shown = ", ".join(sorted(each)[:3]) + (", ..." if len(each) > 3 else "")
        yield (
            f"{len(titles)} result(s) were done before the title was changed and keep the former one "
            f"({shown}) in result.json and their reports; --fresh does them again with the new one"
        )
