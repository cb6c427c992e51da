"""The dialects by name, found in the modules of this package; each is loaded when it is asked for."""

from __future__ import annotations

import functools
import importlib.util
import pkgutil
import re

from metrosep.controllers.base import Dialect, DialectInfo
from metrosep.core.errors import DataError
from metrosep.core.readable import did_you_mean

_DIALECT = re.compile(
    r"^class (\w+)\([\w, ]+\):(?:(?!^class ).)*?info = \w+\(\s*(?:\w+\.info,\s*)?id=\"([\w-]+)\"",
    re.MULTILINE | re.DOTALL,
)
"""A class with its facts, as the text of a module states them."""

_FIRST = ("linuxcnc", "csv", "csv-map", "linuxcnc-lincurve", "linuxcnc-eoffset", "pmac")
"""Dialects that are listed first; the others follow by the name of their module."""


@functools.cache
def _places() -> dict[str, tuple[str, str]]:
    """Return module and class of each dialect: of every module of this package that has one."""
    package = "metrosep.controllers"
    found = [m.name for m in pkgutil.iter_modules(importlib.import_module(package).__path__)]
    places: dict[str, tuple[str, str]] = {}
    for module in sorted(found):
        spec = importlib.util.find_spec(f"{package}.{module}")
        source = getattr(spec and spec.loader, "get_source", lambda _: None)(f"{package}.{module}")
        for name, known in _DIALECT.findall(source or ""):
            if known in places:
                raise RuntimeError(
                    f"two classes are the controller {known!r}: {name} and {places[known][1]}"
                )
            places[known] = (f"{package}.{module}", name)
    return {known: places[known] for known in dict.fromkeys((*_FIRST, *places))}


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
    return tuple(_places())


def describe() -> tuple[DialectInfo, ...]:
    """Return what each dialect is: entry rule, units, limits, how its sign is known.

    Returns
    -------
    tuple of DialectInfo
        One for each name.
    """
    return tuple(find(name).info for name in _places())


@functools.cache
def find(controller: str) -> Dialect:
    """Return a dialect."""
    if controller not in _places():
        raise DataError(
            f"unknown controller {controller!r}; there are {', '.join(map(repr, _places()))}."
            f"{did_you_mean(controller, _places())}"
        )
    module, name = _places()[controller]
    made: Dialect = getattr(importlib.import_module(module), name)()
    return made
