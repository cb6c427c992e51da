"""A public name stays what it is after every module of its package has been imported."""

from __future__ import annotations

import importlib
import pkgutil
from types import ModuleType

import pytest

import metrosep

PACKAGES = [
    info.name
    for info in pkgutil.iter_modules(metrosep.__path__, "metrosep.")
    if info.ispkg and hasattr(importlib.import_module(info.name), "__all__")
]


@pytest.mark.parametrize("name", PACKAGES)
def test_no_module_hides_a_public_name(name):
    package = importlib.import_module(name)
    for info in pkgutil.iter_modules(package.__path__, f"{name}."):
        importlib.import_module(info.name)

    hidden = [n for n in package.__all__ if isinstance(getattr(package, n), ModuleType)]

    assert not hidden, f"{name}: rename the modules {hidden}"


@pytest.mark.parametrize("name", PACKAGES)
def test_every_public_name_is_there(name):
    package = importlib.import_module(name)
    assert [n for n in package.__all__ if getattr(package, n, None) is None] == []
    assert sorted(set(package.__all__)) == sorted(package.__all__)
