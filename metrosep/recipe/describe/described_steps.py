"""Everything from which a form for the steps of any recipe can be made."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from metrosep.core.methods import METHODS
from metrosep.recipe.key_values import DIMENSIONS
from metrosep.recipe.pipeline import schema
from metrosep.recipe.schema import Field
from metrosep.recipe.step_help import kind_words
from metrosep.recipe.steps import STEPS, WHAT

__all__ = ["described_steps"]

_OF_RUNS = ("separate", "polynomial", "plan_feedrates")


def described_steps() -> dict[str, Any]:
    """Return the steps of all recipes with their keys.

    Examples
    --------
    >>> [s["op"] for s in described_steps()["steps"] if "runs" in s["applies"]]
    ['separate', 'polynomial', 'plan_feedrates']
    """
    steps = list(schema()["steps"])
    steps += [_described(op, WHAT[op], STEPS[op], "runs") for op in _OF_RUNS]
    steps += [
        _described(op, method.what, method.fields, "method") for op, method in METHODS.items()
    ]
    return {"steps": steps}


def _described(op: str, what: str, fields: Mapping[str, Field], applies: str) -> dict[str, Any]:
    return {
        "op": op,
        "what": what,
        "applies": [applies],
        "keys": [
            {
                "name": name,
                "kind": field.kind,
                "required": field.required,
                "choices": list(field.choices),
                "default": field.default,
                "dimension": DIMENSIONS.get(field.kind),
                "help": field.about or kind_words(field.kind),
                "keys": [],
            }
            for name, field in fields.items()
            if name != "op"
        ],
    }
