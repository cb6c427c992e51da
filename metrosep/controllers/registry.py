"""The dialects by name; each is loaded when it is asked for."""

from __future__ import annotations

import functools
import importlib

from metrosep.controllers.base import Dialect, DialectInfo
from metrosep.core.errors import DataError

__all__ = ["describe", "find", "names"]

_PLACES = {
    "linuxcnc": "linuxcnc:LinuxCNC",
    "csv": "neutral:Neutral",
}
"""Module and class of each dialect, in the order in which they are listed."""


def names() -> tuple[str, ...]:
    """Return the names of the controllers that are supported.

    Returns
    -------
    tuple of str
        Values for ``controller=``.

    Examples
    --------
    >>> names()[:2]
    ('linuxcnc', 'csv')
    """
    return tuple(_PLACES)


def describe() -> tuple[DialectInfo, ...]:
    """Return what each dialect is: entry rule, units, limits, how its sign is known.

    Returns
    -------
    tuple of DialectInfo
        One for each name.
    """
    return tuple(find(name).info for name in _PLACES)


@functools.cache
def find(controller: str) -> Dialect:
    """Return a dialect.

    Parameters
    ----------
    controller : str
        Its name.

    Returns
    -------
    Dialect
        Without state.

    Raises
    ------
    DataError
        If there is none of that name.
    """
    if controller not in _PLACES:
        raise DataError(
            f"unknown controller {controller!r}; there are {', '.join(map(repr, _PLACES))}"
        )
    module, _, name = _PLACES[controller].partition(":")
    made: Dialect = getattr(importlib.import_module(f"metrosep.controllers.{module}"), name)()
    return made
