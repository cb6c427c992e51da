"""The hash of what a recipe means, whatever it looks like."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

from metrosep.core.provenance import hash_bytes
from metrosep.recipe.methods import METHODS
from metrosep.recipe.pipeline import STEPS as MEASURING, checked_step

if TYPE_CHECKING:
    from metrosep.recipe.recipe import Recipe

__all__ = ["recipe_hash"]


def recipe_hash(recipe: Recipe) -> str:
    """Return the SHA-256 of a recipe's canonical form.

    Notes
    -----
    Canonical form: JSON with sorted keys of ``[input]``, the steps, checks and outputs, in SI, with
    the defaults of steps that measure and of the guard factor filled in. Title, comments, order of
    keys, spelling of units (1 mm, 1000 um; numbers count to 14 digits), ``[view]`` and ``[batch]`` do not count: none of them
    changes a number of a result. Files that a step names count by their content. Steps that are
    switched off do not count.

    Examples
    --------
    >>> from metrosep.recipe import Recipe
    >>> text = '''metrosep = 1
    ... title = "one"
    ... [input]
    ... [[step]]
    ... op = "filter"
    ... cutoff = "1 mm"
    ... '''
    >>> other = text.replace("one", "two").replace("1 mm", "1000 um")
    >>> recipe_hash(Recipe.parse(text)) == recipe_hash(Recipe.parse(other))
    True
    """
    content = {
        "metrosep": 1,
        "input": recipe.input,
        "steps": [_filled(s) for s in recipe.steps if s.get("enabled", True)],
        "checks": [{"guard_factor": 1.0, **c} for c in recipe.checks],
        "outputs": list(recipe.outputs),
        "files": _files(recipe),
    }
    text = json.dumps(
        _plain(content), sort_keys=True, separators=(",", ":"), ensure_ascii=True, allow_nan=False
    )
    return hashlib.sha256(text.encode("ascii")).hexdigest()


def _filled(step: Mapping[str, Any]) -> dict[str, Any]:
    op = MEASURING.get(step["op"])
    if op is None:
        return dict(step)
    defaults = {k: key.default for k, key in op.keys.items() if key.default is not None}
    given = {k: v for k, v in step.items() if k != "enabled"}
    return {**{k: v for k, v in defaults.items() if _goes(step, k, v)}, **given}


def _goes(step: Mapping[str, Any], key: str, value: Any) -> bool:
    """Whether a default may be written out in this step: it goes with the other keys."""
    from metrosep.recipe.pipeline import StepError

    if key in step:
        return False
    try:
        checked_step({**step, key: value})
    except StepError:
        return False
    return True


def _files(recipe: Recipe) -> list[str]:
    """Return the hash of each file that a step names, in order."""
    found = []
    for step in recipe.steps:
        method = METHODS.get(step["op"])
        for key, field in sorted(method.fields.items()) if method is not None else ():
            if field.kind == "file" and key in step:
                target = recipe.folder / step[key]
                found.append(hash_bytes(target.read_bytes()) if target.is_file() else "")
    return found


def _plain(value: Any) -> Any:
    if isinstance(value, Mapping):
        return {str(k): _plain(v) for k, v in value.items()}
    if isinstance(value, list | tuple):
        return [_plain(v) for v in value]
    return float(f"{value:.14g}") if isinstance(value, float) else value
