"""``metrosep check RECIPE``: every mistake of a recipe that shows without reading data."""

from __future__ import annotations

import json
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

if TYPE_CHECKING:
    from metrosep.recipe.recipe import Recipe
    from metrosep.recipe.schema import Field, Place

__all__ = ["are_recipes", "check_recipes", "recipe_errors"]


def are_recipes(files: Sequence[str]) -> bool:
    """Return whether `check` is given recipes, and not data.

    Examples
    --------
    >>> are_recipes(["ring.toml"]), are_recipes(["ring.x3p"])
    (True, False)
    """
    return bool(files) and all(Path(f).suffix.lower() == ".toml" for f in files)


def check_recipes(
    files: Sequence[str], *, as_json: bool, explain: bool, overrides: Sequence[str] = ()
) -> int:
    """Print what is wrong in recipes."""
    from metrosep.recipe.guard_room import guard_notes

    found = {name: _checked(name, overrides) for name in files}
    warned = {name: list(guard_notes(r)) if r else [] for name, (r, _) in found.items()}
    if as_json:
        items = [
            {
                "file": n,
                "errors": errors,
                "warnings": warned[n],
                **({"defaults": _defaults(r)} if explain and r else {}),
            }
            for n, (r, errors) in found.items()
        ]
        content = items[0] if len(items) == 1 else {"files": items}
        click.echo(json.dumps(content, sort_keys=True, allow_nan=False))
    for name, (recipe, errors) in {} if as_json else found.items():
        for error in errors:
            click.echo(f"error: {error}")
        for warning in warned[name]:
            click.echo(f"warning: {warning}")
        if not errors and not warned[name]:
            click.echo(f"{name}: nothing wrong")
        if explain and recipe is not None:
            for line in _explained(recipe):
                click.echo(line)
    return 2 if any(errors for _, errors in found.values()) else 0


def _checked(name: str, overrides: Sequence[str]) -> tuple[Recipe | None, list[str]]:
    """Return the recipe, if it can be had, and what is wrong."""
    from metrosep.core.errors import RecipeError
    from metrosep.core.plain_files import RECIPE_BYTES, read_plain_text
    from metrosep.recipe.overrides import with_overrides
    from metrosep.recipe.recipe import Recipe

    target = Path(name)
    try:
        text = read_plain_text(target, RECIPE_BYTES)
    except (OSError, UnicodeDecodeError) as exc:
        reason = getattr(exc, "strerror", None) or exc
        return None, [f"{name}: the recipe cannot be read ({reason})"]
    folder = target.resolve().parent
    errors = []
    try:
        text = with_overrides(text, target.name, folder, overrides) if overrides else text
    except RecipeError as exc:
        errors.append(str(exc))
    errors += [e for e in recipe_errors(text, name=target.name, folder=folder) if e not in errors]
    try:
        return Recipe.parse(text, name=target.name, folder=folder), errors
    except RecipeError:
        return None, errors


def recipe_errors(text: str, *, name: str, folder: Path) -> list[str]:
    """Return every mistake in the text of a recipe that shows without data.

    Notes
    -----
    Each key is checked by itself: unknown, missing, of the wrong kind or unit. What the parts make
    together is checked only when each is right, and tells its first mistake.

    Examples
    --------
    >>> text = '''metrosep = 1
    ... [input]
    ... [[step]]
    ... op = "form"
    ... fom = "plane"
    ... '''
    >>> for error in recipe_errors(text, name="r.toml", folder=Path(".")):
    ...     print(error[:36])
    r.toml:5: unknown key "fom" in [[ste
    r.toml:3: [[step]] 1 (form) needs th
    """
    from metrosep.core.errors import RecipeError
    from metrosep.recipe.extends import layers_of
    from metrosep.recipe.preflight import limit_errors
    from metrosep.recipe.recipe import Recipe

    try:
        layers = layers_of(text, name, folder)
    except RecipeError as exc:
        return [str(exc)]
    errors = list(dict.fromkeys(str(e) for e in _of_tables(layers, name)))
    try:
        recipe = Recipe.parse(text, name=name, folder=folder)
    except RecipeError as exc:
        return errors or [str(exc)]
    return errors + [str(e) for e in (*limit_errors(recipe), *_of_plugins(recipe))]


def _of_tables(layers: Any, name: str) -> Iterator[Exception]:
    """Yield the mistakes of each table, key by key."""
    from metrosep.core.errors import RecipeError
    from metrosep.recipe.extends import LayeredPlace
    from metrosep.recipe.overrides import input_fields_of
    from metrosep.recipe.schema import batch_table
    from metrosep.recipe.steps import (
        ALL_STEPS,
        CHECK,
        METHOD_CHECK,
        METHOD_OUTPUTS,
        OUTPUTS,
        TOP,
    )

    def place(header: str = "", number: int = 0) -> Place:
        return LayeredPlace(name, layers.text, header, number, layers.bases)

    data = layers.data
    yield from _of_table(data, TOP, place(), "the recipe")
    ops = ALL_STEPS
    first = next((s.get("op") for s in _tables(data, "step")), None)
    fields = input_fields_of(first)
    if fields is not None and isinstance(data.get("input"), Mapping):
        yield from _of_table(data["input"], fields, place("[input]"), "[input]")
    plain = first in ("separate", "polynomial", "plan_feedrates")
    outputs = OUTPUTS if plain else METHOD_OUTPUTS
    for key, kinds, selector in (
        ("step", ops, "op"),
        ("check", {"": CHECK if plain else METHOD_CHECK}, ""),
        ("output", outputs, "kind"),
    ):
        if key in ("check", "output") and fields is None:
            continue  # which keys there are depends on the steps
        for number, item in enumerate(_tables(data, key)):
            where = place(f"[[{key}]]", number)
            yield from _of_item(item, kinds, selector, where, f"[[{key}]] {number + 1}")
    if isinstance(data.get("batch"), Mapping):
        try:
            batch_table(data["batch"], place("[batch]"))
        except RecipeError as exc:
            yield exc


def _tables(data: Mapping[str, Any], key: str) -> list[Mapping[str, Any]]:
    found = data.get(key, [])
    return [t for t in found if isinstance(t, Mapping)] if isinstance(found, list) else []


def _of_item(
    item: Mapping[str, Any],
    kinds: Mapping[str, Mapping[str, Field]],
    selector: str,
    place: Place,
    what: str,
) -> Iterator[Exception]:
    import difflib

    from metrosep.core.errors import DataError
    from metrosep.recipe.pipeline import checked_step
    from metrosep.recipe.schema import checked_table
    from metrosep.recipe.steps import MEASURING

    kind = item.get(selector, "") if selector else ""
    if not isinstance(kind, str) or kind not in kinds:
        near = difflib.get_close_matches(str(kind), list(kinds), n=1)
        hint = f'; did you mean "{near[0]}"?' if near else ""
        known = ", ".join(f'"{k}"' for k in kinds)
        yield place.error(
            f"{what} needs {selector} = one of {known}, found {kind!r}{hint}", selector
        )
        return
    title = what + (f" ({kind})" if kind else "")
    errors = list(_of_table(item, kinds[kind], place, title))
    yield from errors
    if selector == "op" and kind in MEASURING and not errors:
        try:
            checked_step(checked_table(item, kinds[kind], place, what=title))
        except DataError as exc:
            yield place.error(f"{title}: {exc}", getattr(exc, "key", None))


def _of_table(
    data: Mapping[str, Any], fields: Mapping[str, Field], place: Place, what: str
) -> Iterator[Exception]:
    """Yield what is wrong with each key of a table, and with each that is missing."""
    from dataclasses import replace

    from metrosep.core.errors import RecipeError
    from metrosep.recipe.schema import checked_table

    free = {k: replace(f, required=False) for k, f in fields.items()}
    for key, value in data.items():
        try:
            checked_table({key: value}, free, place, what=what)
        except RecipeError as exc:
            yield exc
    for key, field in fields.items():
        if field.required and key not in data:
            try:
                checked_table({}, {key: field}, place, what=what)
            except RecipeError as exc:
                yield exc


def _of_plugins(recipe: Recipe) -> Iterator[Exception]:
    """Yield the first format that nothing installed writes; reports and controllers were checked before."""
    from metrosep.batch.index import format_error

    wrong = format_error(recipe)
    if wrong is not None:
        yield wrong


def _defaults(recipe: Recipe) -> list[dict[str, Any]]:
    """Return for each step the keys that the recipe leaves out."""
    from metrosep.recipe.described_steps import described_steps

    known = {s["op"]: s for s in described_steps()["steps"]}
    return [
        {
            "op": step["op"],
            "what": known[step["op"]]["what"],
            "keys": [
                {k: key[k] for k in ("name", "default", "help")}
                for key in known[step["op"]]["keys"]
                if key["name"] not in step
            ],
        }
        for step in recipe.steps
        if step["op"] in known
    ]


def _explained(recipe: Recipe) -> Iterator[str]:
    for step in _defaults(recipe):
        yield f"{step['op']}: {step['what']}; left out, so that this holds:"
        for key in step["keys"]:
            value = "none" if key["default"] is None else json.dumps(key["default"])
            yield f"  {key['name']:16} {value:12} {key['help']}"
