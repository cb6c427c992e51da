"""What a file, its sidecar and the user say about a fact: all that speak must agree."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from metrosep.controllers.base import Dialect, load_sidecar, sidecar_options
from metrosep.core.errors import CorruptFileError, DataError

__all__ = ["fact", "named_axes", "own_axis", "require_agreement"]

_NEAR = 1e-9
"""Relative difference of two numbers that are one fact: rounding of a printed one."""


def named_axes(fields: dict[str, Any], axes: tuple[str, str], path: Path) -> dict[str, Any]:
    """Return the fields of a table whose file names its axes, and refuse another sidecar."""
    if load_sidecar(path).get("table"):
        said = (fields["axis"], fields["compensates"])
        require_agreement(path, "the axes", ("the file", axes), ("its sidecar", said))
    return {**fields, "axis": axes[0], "compensates": axes[1]}


def own_axis(fields: dict[str, Any], path: Path) -> dict[str, Any]:
    """Return the axes of a file that shifts the axis it looks up, and refuse a sidecar with two."""
    if fields["compensates"] != fields["axis"]:
        raise CorruptFileError(
            path,
            f"its sidecar says {fields['axis']} -> {fields['compensates']}, but this format shifts the "
            "axis that it looks up",
            hint="do not load it; write the table for a controller that corrects another axis",
        )
    return fields


def fact(
    dialect: Dialect,
    name: str,
    given: Mapping[str, Any],
    in_file: Mapping[str, Any],
    path: Path,
) -> Any:
    """Return an option that the user gave, the file states or its sidecar knows; all must agree."""
    told = {
        "the file": in_file.get(name),
        "its sidecar": sidecar_options(path, dialect.options).get(name),
        "you": given.get(name),
    }
    known = {who: value for who, value in told.items() if value is not None}
    for who, value in known.items():
        first, wanted = next(iter(known.items()))
        require_agreement(path, name, (first, wanted), (who, value))
    if known:
        return next(iter(known.values()))
    option = next(o for o in dialect.options if o.name == name)
    raise DataError(
        f"{path}: neither the file nor a sidecar tells {name} ({option.help}); give {name}=..."
    )


def require_agreement(path: Path, name: str, one: tuple[str, Any], other: tuple[str, Any]) -> None:
    """Refuse two statements about a fact that contradict each other."""
    a, b = one[1], other[1]
    if a is None or b is None or a == b:
        return
    near = isinstance(a, float) and isinstance(b, int | float)
    if near and abs(a - b) <= _NEAR * max(abs(a), abs(b)):
        return
    raise DataError(
        f"{path}: {one[0]} says {name}={a!r}, {other[0]} "
        f"{'say' if other[0] == 'you' else 'says'} {name}={b!r}; one is wrong: leave the option "
        "out, or take the file that fits"
    )
