"""Inputs of the separations that recipes name: curves and columns from tables, maps from files."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from metrosep.core.errors import FormatMismatchError, InvalidSamplesError
from metrosep.core.profile import Profile
from metrosep.core.provenance import Step
from metrosep.core.surface import Surface
from metrosep.io.readings import Readings, read_readings
from metrosep.io.role_columns import Role, RoleColumns, read_roles
from metrosep.recipe.method import Method
from metrosep.recipe.ops_results import StoredResults, load_results

__all__ = ["load_inputs", "require_count", "sources"]

Inputs = (
    Readings
    | RoleColumns
    | StoredResults
    | tuple[RoleColumns, ...]
    | tuple[Surface | Profile, ...]
)

_POSITIONS = ("target", "direction", "readings")


def load_inputs(method: Method, files: Sequence[Path], options: Mapping[str, Any]) -> Inputs:
    """Return what a method reads."""
    if method.reads == "nothing":
        return ()
    if method.reads == "results":
        return load_results(files)
    if method.reads == "maps":
        return _maps(method, files, options)
    roles, rest = _roles(method, options)
    if method.reads == "curves":
        data = read_readings(files, dimension=method.dimension, extra=roles, **rest)
        require_count(method, len(data.values), data.names)
        return data
    if "direction" in method.roles and not set(_POSITIONS) & set(roles):
        tests = tuple(_listed_test(file, rest) for file in files)
        if method.reads == "tables":
            return tests
        if len(tests) == 1:
            return tests[0]
        raise InvalidSamplesError(
            f"one list of a positioning test is needed, got {len(files)} files; evaluate each alone"
        )
    _require_all(method, roles)
    if method.reads == "tables":
        return tuple(read_roles(file, roles, **rest) for file in files)
    return read_roles(files, roles, **rest)


def _roles(method: Method, options: Mapping[str, Any]) -> tuple[dict[str, Role], dict[str, Any]]:
    """Return the columns by role, and the other options of the reader."""
    roles = {
        name: Role(options[name], kind.strip("*?"))
        for name, kind in method.roles.items()
        if name in options
    }
    return roles, {k: v for k, v in options.items() if k not in roles}


def _require_all(method: Method, roles: Mapping[str, Role]) -> None:
    """Refuse a positioning test without one of its columns."""
    if "direction" not in method.roles:
        return
    for name in _POSITIONS:
        if name not in roles:
            raise FormatMismatchError(
                f"the column of {name} is not named; a positioning test has target, direction and "
                'readings: target = "target_mm", direction = "direction", readings = ["run1_mm"]'
            )


def _listed_test(file: Path, layout: Mapping[str, Any]) -> RoleColumns:
    """Return targets and positions of a list of a positioning test (format iso230-2)."""
    from metrosep.io.iso230_2_list import FORMAT, read_targets, sniff
    from metrosep.io.registry import Match
    from metrosep.io.source import open_file

    source = open_file(file)
    if sniff(source) is Match.NO:
        raise FormatMismatchError(
            f"{file}: is no list of a positioning test; for a table name its columns: "
            'target = "target_mm", direction = "direction", readings = ["run1_mm", "run2_mm"]'
        )
    target, forward, backward = read_targets(source)
    values = {"target": target, "forward": forward, "backward": backward}
    return RoleColumns(values, file.stem, tuple(source.history(FORMAT, {})))


def _maps(
    method: Method, files: Sequence[Path], options: Mapping[str, Any]
) -> tuple[Surface | Profile, ...]:
    from metrosep.io.read import read

    objects: list[Surface | Profile] = []
    for file in files:
        obj = read(file, **options)
        if type(obj).__name__ not in method.accepts or not isinstance(obj, Surface | Profile):
            raise FormatMismatchError(
                f"{file}: holds a {type(obj).__name__.lower()}, this method needs maps of heights"
            )
        objects.append(obj)
    require_count(method, len(objects), [f.name for f in files])
    return tuple(objects)


def require_count(method: Method, n: int, names: Sequence[str]) -> None:
    """Refuse another number of readings than the method has."""
    most = len(method.names) + method.spare
    if method.reads == "curves" and method.names and n > most:
        raise InvalidSamplesError(
            f"{most} readings are read ({', '.join(method.names)}), got {n} ({', '.join(names)}); "
            "leave the others out"
        )
    if method.names and n < len(method.names):
        raise InvalidSamplesError(
            f"{len(method.names)} readings are needed ({', '.join(method.names)}), got {n} "
            f"({', '.join(names)}); name their columns in this order, or give one file for each"
        )


def sources(inputs: Inputs) -> tuple[tuple[Step, ...], tuple[str, ...]]:
    """Return the steps that led to inputs, and what was odd about their files."""
    each: tuple[Any, ...] = inputs if isinstance(inputs, tuple) else (inputs,)
    history: list[Step] = []
    warnings: list[str] = []
    for item in each:
        history += item.history
        own = (
            item.metadata.get("warnings", ())
            if isinstance(item, Surface | Profile)
            else item.warnings
        )
        warnings += [str(w) for w in own]
    return tuple(history), tuple(dict.fromkeys(warnings))
