"""Private: options that are yes or no. A text such as "no" counts as true in Python."""

from __future__ import annotations

import numpy as np

from metrosep.core.errors import DataError


def true_or_false(value: object, name: str) -> bool:
    """Return a bool; a text, a number or None is none."""
    if not isinstance(value, bool | np.bool_):
        raise DataError(f"{name} is True or False, got {value!r}")
    return bool(value)


def true_false_or_none(value: object, name: str) -> bool | None:
    """Return a bool or None, which leaves the choice to the parameter."""
    if value is None:
        return None
    if not isinstance(value, bool | np.bool_):
        raise DataError(f"{name} is True, False or None, got {value!r}")
    return bool(value)
