"""What is public: the names that the packages of metrosep export, and the members of their classes.

The checks of docstrings, the tests of habits and the reference all take it from here.
"""

from __future__ import annotations

import importlib
import inspect
import pkgutil
from collections.abc import Iterator
from functools import cache

import metrosep

__all__ = ["exported", "inherited", "packages", "public_objects"]


def packages() -> tuple[str, ...]:
    """Return the dotted names of metrosep and of its packages."""
    below = pkgutil.iter_modules(metrosep.__path__, "metrosep.")
    return ("metrosep", *(found.name for found in below if found.ispkg))


def exported(package_name: str) -> dict[str, object]:
    """Return what a package names in its ``__all__``, without modules, by name."""
    package = importlib.import_module(package_name)
    found = {name: getattr(package, name) for name in getattr(package, "__all__", ())}
    return {name: value for name, value in found.items() if not inspect.ismodule(value)}


def public_objects() -> dict[str, object]:
    """Return exported functions and classes, with their methods and properties, by dotted name."""
    found: dict[str, object] = {}
    for package_name in packages():
        for value in exported(package_name).values():
            owner = getattr(value, "__module__", None) or ""
            if not (inspect.isfunction(value) or inspect.isclass(value)):
                continue
            if owner.startswith("metrosep") and "<" not in value.__qualname__:
                path = f"{owner}.{value.__qualname__}"
                found[path] = value
                if inspect.isclass(value) and not getattr(value, "_is_protocol", False):
                    found.update(_members(path, value))  # of a protocol: what implements it
    return dict(sorted(found.items()))


_OF_THE_CONTRACT = {"from_inputs"}
"""Methods whose page stands once, at the base class."""


def _members(path: str, owner: type) -> Iterator[tuple[str, object]]:
    for name, value in {**vars(owner), **inherited(owner)}.items():
        is_member = isinstance(value, classmethod | staticmethod | property)
        if name in _OF_THE_CONTRACT:
            continue
        if not name.startswith("_") and (inspect.isfunction(value) or is_member):
            yield f"{path}.{name}", value


@cache
def _exported_classes() -> frozenset[type]:
    every = (v for package in packages() for v in exported(package).values())
    return frozenset(v for v in every if inspect.isclass(v))


def inherited(owner: type) -> dict[str, object]:
    """Return the public members that a class has from bases which no package exports, by name.

    What all objects do alike (`metrosep.core`) is checked at its own page.
    """
    found: dict[str, object] = {}
    for base in reversed(owner.__mro__[1:]):
        where, _, home = base.__module__.partition(".")
        is_private = base.__name__.startswith("_") or "._" in base.__module__
        is_of_all = home.startswith("core.") and not is_private
        if where == "metrosep" and not is_of_all and base not in _exported_classes():
            found |= {name: value for name, value in vars(base).items() if name[0] != "_"}
    return {name: value for name, value in found.items() if name not in vars(owner)}
