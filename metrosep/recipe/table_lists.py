"""Arrays of tables in a recipe: ``[[step]]``, ``[[check]]``, ``[[output]]``."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from metrosep.core.provenance import freeze_mapping
from metrosep.recipe.schema import Field, Place, checked_table
from metrosep.recipe.written.extends import LayeredPlace

__all__ = ["several_tables"]


def several_tables(
    items: Any,
    kinds: Mapping[str, Mapping[str, Field]],
    selector: str,
    header: str,
    top: Place,
) -> tuple[Mapping[str, Any], ...]:
    """Return an array of tables, each checked by what its key `selector` says that it is."""
    if not isinstance(items, list) or not all(isinstance(i, dict) for i in items):
        raise top.error(f"write {header} with double brackets", header.strip("[]"))
    checked = []
    for number, item in enumerate(items):
        place = LayeredPlace(top.file, top.text, header, number, getattr(top, "bases", ()))
        kind = item.get(selector, "") if selector else ""
        if not isinstance(kind, str) or kind not in kinds:
            known = ", ".join(f'"{k}"' for k in kinds)
            raise place.error(
                f"{header} needs {selector} = one of {known}, found {kind!r}", selector
            )
        what = f"{header} {number + 1}" + (f" ({kind})" if kind else "")
        checked.append(freeze_mapping(checked_table(item, kinds[kind], place, what=what)))
    return tuple(checked)
