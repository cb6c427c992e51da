"""Private helpers: arguments of the wrong type become a `DataError` that names them."""

from __future__ import annotations

from collections.abc import Sequence

from metrosep.core.errors import DataError
from metrosep.core.numbers import count, real


def whole_number(value: object, name: str, *, minimum: int = 1) -> int:
    """Return a whole number from `minimum`."""
    return count(value, name, least=minimum)


def real_number(value: object, name: str, what: str = "a number") -> float:
    """Return a float, NaN and infinities included."""
    return real(value, name, what=what, finite=False)


def finite_number(value: object, name: str, what: str = "a finite number") -> float:
    """Return a finite float."""
    return real(value, name, what=what)


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
