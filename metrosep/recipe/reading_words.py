"""What readers and separations say, in the words of a recipe: their arguments are its keys."""

from __future__ import annotations

import re
from collections.abc import Iterator
from contextlib import contextmanager
from typing import TYPE_CHECKING

from metrosep.core.errors import MetrosepError
from metrosep.core.readable import readable_text
from metrosep.core.text_options import TEXT_OPTIONS
from metrosep.recipe.step_help import StepKeys, in_words, keys_of_step, step_words

if TYPE_CHECKING:
    from metrosep.recipe.recipe import Recipe

__all__ = ["in_recipe_words", "reading_words", "recipe_words"]

_OF_READERS = frozenset(
    {
        *TEXT_OPTIONS, "group", "max_pixels", "names", "numbered", "overhang", "radius",
        "sampling_rate", "segment", "servo_period", "slope", "time",
    }
)  # fmt: skip
"""Arguments of readers that ``metrosep convert`` takes with ``--set``."""
_READ_RUNS = re.compile(r",? or read repeated runs with read_runs\([^()]*\)")
"""A way out that is a call of Python; a recipe of another step does it."""
_CONVERT = (
    "; what --set names is not a key of [input]: metrosep convert takes it, then run the recipe on the "
    "file that it writes"
)
_ARGUMENT = re.compile(r"(?<![\w.\-\"'])([a-z_]+)=(?!=)('[^']*'|\"[^\"]*\"|[-+]?[\w.]*\w)?")


def reading_words(message: str, op: str) -> str:
    """Return a message of a reader with its arguments as keys of ``[input]``.

    Examples
    --------
    >>> reading_words("give unit='nm'", "parameters")
    'give unit = "nm" in [input]'
    """
    from metrosep.recipe.written.overrides import input_fields_of

    keys, fields = keys_of_step(op), input_fields_of(op)
    if fields is None:
        return readable_text(message)
    if keys is None or keys.source != fields:  # a step that measures: readers of single files
        columns = frozenset(k for k, f in fields.items() if f.kind == "column")
        keys = StepKeys({}, fields, columns)
    message = in_words(_READ_RUNS.sub("", message), keys, command=False)

    def option(found: re.Match[str]) -> str:
        name, value = found.group(1), found.group(2)
        if name not in _OF_READERS or name in keys.source or name in keys.step:
            return found.group()
        text = "..." if value is None else value.strip("'\"")
        return f'--set "{name}={text}"'

    changed = _ARGUMENT.sub(option, message)
    return changed if changed == message else changed.rstrip(".") + _CONVERT


def recipe_words(recipe: Recipe, message: str) -> str:
    """Return a message of the library with its arguments as keys of a recipe."""
    if not message.startswith(f"{recipe.name}:"):  # of a line of the recipe, or already so
        message = reading_words(message, recipe.steps[0]["op"])
    for step in recipe.steps:
        message = step_words(message, step["op"])
    return message


@contextmanager
def in_recipe_words(recipe: Recipe) -> Iterator[None]:
    """Let errors name keys of the recipe that is carried out, as the command ``run`` prints them."""
    try:
        yield
    except MetrosepError as exc:
        exc.args = (recipe_words(recipe, str(exc)), *exc.args[1:])
        raise
