"""Private helpers of result classes: plain values for JSON, and copies by copy and pickle."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from types import MappingProxyType
from typing import Any

import numpy as np

from metrosep.core.profile import Profile
from metrosep.core.provenance import Step, history_as_dicts
from metrosep.core.quantity import Quantity
from metrosep.core.surface import Surface

__all__ = ["plain", "reduced"]


def plain(value: Any) -> Any:
    """Return a value as lists, dicts, numbers and text; what is not finite becomes None."""
    if value is None or isinstance(value, str | bool | int):
        return value
    if isinstance(value, np.ndarray):
        return plain(value.tolist())
    if isinstance(value, np.generic):
        return plain(value.item())
    if isinstance(value, float):
        return value if math.isfinite(value) else None
    if isinstance(value, Mapping):
        return {str(k): plain(v) for k, v in value.items()}
    if isinstance(value, list | tuple):
        return [plain(v) for v in value]
    if isinstance(value, Quantity):
        return plain(value.to_dict())
    if isinstance(value, Step):
        return plain(history_as_dicts((value,))[0])
    if isinstance(value, Profile):
        return {"x": plain(value.x), "z": plain(value.z)}
    if isinstance(value, Surface):
        steps = {"dx": plain(value.dx), "dy": plain(value.dy), "origin": plain(value.origin)}
        return {**steps, "z": plain(value.z)}
    return str(value)


def reduced(result: Any) -> tuple[Callable[..., Any], tuple[Any, ...]]:
    """Return what ``__reduce__`` of a result with read-only mappings and arrays must return."""
    parts = {name: _stored(getattr(result, name)) for name in _slots(type(result))}
    return _restored, (type(result), parts)


class _Stored:
    """Stands for an object while it is copied; the copy is what ``make(*args)`` returns."""

    def __init__(self, make: Callable[..., Any], *args: Any) -> None:
        self.recipe = (make, args)

    def __reduce__(self) -> tuple[Callable[..., Any], tuple[Any, ...]]:
        return self.recipe


def _stored(value: Any) -> Any:
    if isinstance(value, MappingProxyType):
        return _Stored(_read_only_view, {k: _stored(v) for k, v in value.items()})
    if isinstance(value, dict):
        return {k: _stored(v) for k, v in value.items()}
    if type(value) in (tuple, list):
        return type(value)(_stored(v) for v in value)
    if isinstance(value, np.ndarray):
        return value if value.flags.writeable else _Stored(_read_only, np.array(value))
    if type(value).__module__.startswith("metrosep.") and _slots(type(value)):
        make, args = reduced(value)
        return _Stored(make, *args)
    return value


def _read_only_view(items: dict[Any, Any]) -> MappingProxyType[Any, Any]:
    """Return a read-only view."""
    return MappingProxyType(items)


def _read_only(values: Any) -> Any:
    array = np.asarray(values)
    array.setflags(write=False)
    return array


def _slots(kind: type) -> list[str]:
    own = [getattr(base, "__slots__", ()) for base in kind.__mro__]
    return [n for names in own for n in ((names,) if isinstance(names, str) else names)]


def _restored(kind: type, parts: Mapping[str, Any]) -> Any:
    made: Any = object.__new__(kind)
    for name, value in parts.items():
        object.__setattr__(made, name, _live(value))
    return made


def _live(value: Any) -> Any:
    """Return the object that a shallow copy was given the recipe of."""
    if isinstance(value, _Stored):
        make, args = value.recipe
        return make(*(_live(a) for a in args))
    if isinstance(value, dict):
        return {k: _live(v) for k, v in value.items()}
    if type(value) in (tuple, list):
        return type(value)(_live(v) for v in value)
    return value
