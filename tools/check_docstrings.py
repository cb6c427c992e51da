"""Validate the docstring of every public name with numpydoc; exit 1 when one is wrong.

Public is what stands in the ``__all__`` of a package or module of metrosep, and the public methods
and properties of public classes. Which checks apply is in pyproject.toml under
``tool.numpydoc_validation``.
"""

from __future__ import annotations

import enum
import importlib
import inspect
import pkgutil
import re
import sys
import tomllib
from collections.abc import Iterator
from pathlib import Path

from numpydoc.validate import ERROR_MSGS, validate

ROOT = Path(__file__).resolve().parents[1]

_PROPERTY_ALSO_OFF = frozenset({"RT01", "RT03", "SS05", "SS06"})
"""A property reads like an attribute: a noun phrase without a Returns section."""

_METHOD_ALSO_OFF = frozenset({"SS05"})
"""numpydoc takes nouns that end in s for verbs in the third person."""

_SHORT_METHOD_ALSO_OFF = _METHOD_ALSO_OFF | {"RT01"}
"""Without parameters, the first line says what is returned."""

_NOT_CONSTRUCTED_ALSO_OFF = frozenset({"PR01"})
"""Nobody calls an enumeration or a protocol."""


def enabled_checks() -> frozenset[str]:
    """Codes to report: ``all`` switches the listed ones off, as in numpydoc itself."""
    pyproject = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))
    listed = set(pyproject["tool"]["numpydoc_validation"]["checks"])
    return frozenset(set(ERROR_MSGS) - listed if "all" in listed else listed)


def module_names() -> Iterator[str]:
    """Dotted names of all public modules below metrosep; its own names are defined in them."""
    package = importlib.import_module("metrosep")
    for found in pkgutil.walk_packages(package.__path__, "metrosep."):
        if not any(part.startswith("_") for part in found.name.split(".")):
            yield found.name


def public_objects() -> dict[str, object]:
    """Every public function, class, method and property, by the dotted name of its definition."""
    found: dict[str, object] = {}
    for module_name in module_names():
        module = importlib.import_module(module_name)
        for name in getattr(module, "__all__", ()):
            value = getattr(module, name)
            if inspect.ismodule(value) or not callable(value):
                continue
            owner = getattr(value, "__module__", "") or ""
            if not owner.startswith("metrosep") or "<" in getattr(value, "__qualname__", "<"):
                continue
            path = f"{owner}.{value.__qualname__}"
            found[path] = value
            if inspect.isclass(value) and not getattr(value, "_is_protocol", False):
                found.update(_members(path, value))  # of a protocol: what implements it
    return dict(sorted(found.items()))


def _members(path: str, owner: type) -> Iterator[tuple[str, object]]:
    for name, value in vars(owner).items():
        is_method = inspect.isfunction(value) or isinstance(value, classmethod | staticmethod)
        if not name.startswith("_") and (is_method or isinstance(value, property)):
            yield f"{path}.{name}", value


def faults(path: str, value: object, checks: frozenset[str]) -> Iterator[str]:
    """One line per fault of one docstring."""
    off: frozenset[str] = frozenset()
    if isinstance(value, property):
        off = _PROPERTY_ALSO_OFF
    elif inspect.isclass(value):
        if issubclass(value, enum.Enum) or getattr(value, "_is_protocol", False):
            off = _NOT_CONSTRUCTED_ALSO_OFF
    elif path.rsplit(".", 2)[-2][:1].isupper():
        function = value.__func__ if isinstance(value, classmethod | staticmethod) else value
        only_self = set(inspect.signature(function).parameters) <= {"self", "cls"}
        off = _SHORT_METHOD_ALSO_OFF if only_self else _METHOD_ALSO_OFF
    result = validate(path)
    for code, message in result["errors"]:
        if code in checks and code not in off:
            where = re.sub(r"^.*/(?=metrosep/)", "", str(result["file"]))
            yield f"{where}:{result['file_line']}: {path}: {code} {message}"


def main() -> int:
    """Print the faults; 0 when there are none."""
    checks = enabled_checks()
    objects = public_objects()
    lines = [line for path, value in objects.items() for line in faults(path, value, checks)]
    for line in lines:
        print(line)
    print(f"numpydoc: {len(objects)} public names, {len(lines)} faults", file=sys.stderr)
    return 1 if lines else 0


if __name__ == "__main__":
    sys.exit(main())
