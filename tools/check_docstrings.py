"""Validate the docstring of every public name with numpydoc; exit 1 when one is wrong.

What is public says `public_names`; which checks apply is in pyproject.toml under
``tool.numpydoc_validation``.
"""

from __future__ import annotations

import enum
import inspect
import re
import sys
import tomllib
from collections.abc import Iterator
from pathlib import Path

from numpydoc.validate import ERROR_MSGS, validate
from public_names import public_objects

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


def faults(path: str, value: object, checks: frozenset[str]) -> Iterator[str]:
    """One line per fault of one docstring."""
    function = value.__func__ if isinstance(value, classmethod | staticmethod) else value
    if not inspect.isclass(value) and not function.__doc__ and inspect.getdoc(function):
        return  # inherited: it is checked where it stands
    off: frozenset[str] = frozenset()
    if isinstance(value, property):
        off = _PROPERTY_ALSO_OFF
    elif inspect.isclass(value):
        if issubclass(value, enum.Enum) or getattr(value, "_is_protocol", False):
            off = _NOT_CONSTRUCTED_ALSO_OFF
    elif path.rsplit(".", 2)[-2][:1].isupper():
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
