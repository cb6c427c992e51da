"""Private helper: a package whose public names load their modules when they are first used.

The names stand once, in the package's ``if TYPE_CHECKING`` block as ``from home import name as name``,
where type checkers, editors and the import linter see them.
"""

from __future__ import annotations

import importlib
import sys
from collections.abc import Callable
from functools import cache
from typing import Any

GetAttribute = Callable[[str], Any]


def lazy_package(package: str) -> tuple[GetAttribute, Callable[[], list[str]]]:
    """Return the ``__getattr__`` and the ``__dir__`` of a package; ``__all__`` comes from the former."""

    @cache
    def homes() -> dict[str, str]:
        import ast

        loader: Any = sys.modules[package].__spec__.loader  # type: ignore[union-attr]
        source = loader.get_source(package)  # a package that has no source has no names
        blocks = (b for b in ast.parse(source).body if isinstance(b, ast.If))
        found = (line for block in blocks for line in block.body)
        lines = [line for line in found if isinstance(line, ast.ImportFrom)]
        return {n.name: line.module or package for line in lines for n in line.names}

    def public() -> list[str]:
        own = ["__version__"] if hasattr(sys.modules[package], "__version__") else []
        return [*own, *sorted(homes())]

    def load(name: str) -> Any:
        if name == "__all__":
            return public()
        home = homes().get(name) if not name.startswith("_") else None
        if home is not None and home != package:
            value = getattr(importlib.import_module(home), name)
            setattr(sys.modules[package], name, value)
            return value
        return _submodule(package, name)

    return load, public


def _submodule(package: str, name: str) -> Any:
    """Return a module of a package: they are attributes too, as of a package that imports them all."""
    missing = AttributeError(f"module {package!r} has no attribute {name!r}")
    if name.startswith("_"):
        raise missing
    try:
        return importlib.import_module(f"{package}.{name}")
    except ModuleNotFoundError as error:
        if error.name != f"{package}.{name}":
            raise
        raise missing from None
