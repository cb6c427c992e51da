"""Figures take what a user holds in hand: the object itself, a `Result`, or the document of one."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from functools import wraps
from typing import Any, TypeVar, cast

from metrosep.core.errors import OptionError
from metrosep.separation.contract import Separation

Draw = TypeVar("Draw", bound=Callable[..., Any])

_KEYS = {"ErrorEstimate": "estimate", "Separation": "separation", "CompensationTable": "table"}
"""Where the document of a result holds an object."""


def takes_documents(draw: Draw) -> Draw:
    """Let a function of the document of a result take the object that it draws, too."""

    @wraps(draw)
    def wrapped(document: Any, *args: Any, **options: Any) -> Any:
        return draw(document_of(document), *args, **options)

    return cast("Draw", wrapped)


def takes_separations(draw: Draw) -> Draw:
    """Let a function of a separation take the result that holds one, or its document, too."""

    @wraps(draw)
    def wrapped(result: Any, *args: Any, **options: Any) -> Any:
        content = result if isinstance(result, Mapping) else getattr(result, "document", None)
        held = content.get("separation") if isinstance(content, Mapping) else None
        given = Separation.from_dict(held) if isinstance(held, Mapping) else result
        return draw(given, *args, **options)

    return cast("Draw", wrapped)


def document_of(obj: Any) -> Mapping[str, Any]:
    """Return the document of a result, or the part of one that an object would be."""
    content = obj if isinstance(obj, Mapping) else getattr(obj, "document", None)
    if isinstance(content, Mapping):
        return content
    key = next((_KEYS[c.__name__] for c in type(obj).__mro__ if c.__name__ in _KEYS), None)
    if key is None:
        raise OptionError(
            f"a figure is drawn of a result, its document, or an object in it, got {type(obj).__name__}"
        )
    return {key: obj.to_dict()}
