"""Private helpers: arguments of the wrong type become a `DataError` that names them."""

from __future__ import annotations

import math
import operator
from collections.abc import Sequence

import numpy as np

from metrosep.core.errors import DataError


def whole_number(value: object, name: str, *, minimum: int = 1) -> int:
    """Return a whole number from `minimum`; a bool, a float or a text is none."""
    message = f"{name} must be a whole number from {minimum}, got {value!r}"
    if isinstance(value, bool | np.bool_):
        raise DataError(message)
    try:
        number = operator.index(value)  # type: ignore[arg-type]
    except TypeError:
        raise DataError(message) from None
    if number < minimum:
        raise DataError(message)
    return number


def real_number(value: object, name: str, what: str = "a number") -> float:
    """Return a float, NaN and infinities included; a text, a bool or None is none."""
    if not isinstance(value, bool | np.bool_ | str | bytes):
        try:
            return float(value)  # type: ignore[arg-type]
        except (TypeError, ValueError, OverflowError):
            pass
    raise DataError(f"{name} must be {what}, got {value!r}")


def finite_number(value: object, name: str, what: str = "a finite number") -> float:
    """Return a finite float."""
    number = real_number(value, name, what)
    if not math.isfinite(number):
        raise DataError(f"{name} must be {what}, got {value!r}")
    return number


def symbols(names: object) -> Sequence[str]:
    """Return symbols asked for by name: a sequence of texts, not one text."""
    if isinstance(names, str | bytes):
        raise DataError(f"names is a sequence of symbols, got the text {names!r}")
    try:
        found: tuple[object, ...] = tuple(names)  # type: ignore[arg-type]
    except TypeError:
        raise DataError(f"names is a sequence of symbols, got {names!r}") from None
    texts = [n for n in found if isinstance(n, str)]
    if len(texts) < len(found):
        wrong = next(n for n in found if not isinstance(n, str))
        raise DataError(f"names holds symbols as text, such as 'Ra', got {wrong!r}")
    return texts


def instance_of(obj: object, kinds: type | tuple[type, ...], what: str) -> None:
    """Refuse an object of another class, saying which one is needed."""
    allowed = kinds if isinstance(kinds, tuple) else (kinds,)
    if not isinstance(obj, allowed):
        names = " or ".join(k.__name__ for k in allowed)
        raise DataError(f"{what} needs a {names}, got {type(obj).__name__}")
