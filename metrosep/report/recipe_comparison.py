"""Two recipes side by side: their texts, and the keys whose values differ."""

from __future__ import annotations

import tomllib
from collections.abc import Iterator, Mapping
from typing import Any

from metrosep.core.errors import RecipeError
from metrosep.report.compare import recipe_diff
from metrosep.report.comparison import Comparison

__all__ = ["compare_recipes"]


def compare_recipes(a: str, b: str, *, names: tuple[str, str] = ("A", "B")) -> Comparison:
    """Return two recipes side by side.

    Parameters
    ----------
    a, b : str
        Texts (TOML).
    names : tuple of str, optional
        Of both, for messages and the diff.

    Returns
    -------
    Comparison
        Without rows: `recipe` holds the unified diff, `other` the keys that differ. Equal where no
        key outside ``[view]`` differs; comments and order of keys do not count.

    Raises
    ------
    RecipeError
        If a text is not TOML.

    Examples
    --------
    >>> compare_recipes("metrosep = 1  # first", "metrosep = 1").equal
    True
    """
    tables = []
    for name, text in zip(names, (a, b), strict=True):
        try:
            tables.append(tomllib.loads(text))
        except (tomllib.TOMLDecodeError, RecursionError) as exc:
            raise RecipeError(f"{name} is not TOML ({exc}); correct it there") from None
    lines = list(_keys(tables[0], tables[1]))
    kept = [line for line in lines if not line.startswith(("view.", "view:"))]
    messages = []
    if not lines and a != b:
        messages.append("the texts differ in comments, spaces or order only")
    if lines and not kept:
        messages.append("only [view] differs, which no run heeds")
    return Comparison(
        "recipe",
        (),
        recipe=recipe_diff(a, b, names),
        other=tuple(lines),
        messages=tuple(messages),
        equal=not kept,
    )


def _keys(a: Mapping[str, Any], b: Mapping[str, Any], path: str = "") -> Iterator[str]:
    for key in dict.fromkeys([*a, *b]):
        here = f"{path}{key}"
        if key not in a or key not in b:
            side, value = ("B", b[key]) if key not in a else ("A", a[key])
            yield f"{here}: {value!r} only in {side}"
            continue
        yield from _values(a[key], b[key], here)


def _values(a: Any, b: Any, here: str) -> Iterator[str]:
    if isinstance(a, dict) and isinstance(b, dict):
        yield from _keys(a, b, f"{here}.")
    elif isinstance(a, list) and isinstance(b, list) and _of_tables(a) and _of_tables(b):
        for i in range(max(len(a), len(b))):
            if i >= len(a) or i >= len(b):
                side, value = ("A", a[i]) if i < len(a) else ("B", b[i])
                yield f"{here}[{i + 1}]: {value!r} only in {side}"
            else:
                yield from _keys(a[i], b[i], f"{here}[{i + 1}].")
    elif type(a) is not type(b) or a != b:
        yield f"{here}: {a!r} and {b!r}"


def _of_tables(values: list[Any]) -> bool:
    return bool(values) and all(isinstance(v, dict) for v in values)
