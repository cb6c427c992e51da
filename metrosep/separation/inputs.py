"""What `separate` is given in Python, as the inputs of a method that has a name.

Arrays, profiles, maps, results and columns by their role become what files would have become, so that
the function, the recipe and the command line make the same of them.
"""

from __future__ import annotations

import os
import sys
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from metrosep.core.errors import DataError, InvalidSamplesError, OptionError
from metrosep.core.methods import METHODS, Method, NamedFiles, Readings, Results, RoleColumns
from metrosep.core.numbers import is_real
from metrosep.core.options import KINDS, Option, checked
from metrosep.core.profile import Profile
from metrosep.core.readable import did_you_mean
from metrosep.core.surface import Surface
from metrosep.separation.contract import Separation
from metrosep.separation.runs.base import ErrorEstimate

_RUNS = ("joint", "kono", "mean")


def method_of_results(name: str) -> str:
    """Return the method that makes of stored results what the function of this name does, else the name."""
    found = (n for n, cls in METHODS.items() if cls.reads == "results")
    return next((n for n in found if getattr(METHODS[n], "function", "") == name), name)


def separate_named(data: Any, method: str, options: Mapping[str, Any]) -> Any:
    """Return what the method of a name makes of data, as a recipe with these keys does."""
    if method not in METHODS:
        raise DataError(
            f"unknown method {method!r}; there are 'joint', 'kono' and 'mean' for repeated runs, and "
            f"the methods that 'metrosep ops' lists.{did_you_mean(method, [*_RUNS, *METHODS])}"
        )
    if isinstance(data, list | tuple) and data and all(isinstance(d, ErrorEstimate) for d in data):
        method = method_of_results(method)
    cls, rest = METHODS[method], {k.removesuffix("_"): v for k, v in options.items()}
    known = {k: o for k, o in cls.fields.items() if k != "op"}
    own = {
        k: rest.pop(k) for k in ("x", "angle", "unit", *cls.roles) if k in rest and k not in known
    }
    values = _options(cls, known, rest)
    if not isinstance(
        data, Readings | RoleColumns | NamedFiles | Mapping | Sequence | np.ndarray | Surface
    ):
        if data is None and cls.reads == "nothing":
            return cls.from_inputs((), values)
        if not hasattr(data, "columns"):  # what only the plain function takes, such as a Recording
            return getattr(sys.modules[cls.__module__], cls.name)(data, **own, **values)
    inputs = _inputs(cls, data, own)
    found = cls.from_inputs(inputs, values)
    history = getattr(inputs, "history", ())
    if history and isinstance(found, Separation):
        found = replace(found, history=(*history, *found.history))
    return found


def _options(
    cls: type[Method], known: Mapping[str, Option], given: Mapping[str, Any]
) -> dict[str, Any]:
    """Return the options in SI: texts with a unit are converted, the rest is for the method to check."""
    for key in given:
        if key not in known:
            listed = ", ".join(known) or "none"
            raise OptionError(
                f"method {cls.name!r} has no option {key!r}; it knows {listed}.{did_you_mean(key, known)}"
            )
    given = {k: v for k, v in given.items() if v is not None}
    for key, declared in known.items():
        if declared.required and key not in given:
            raise OptionError(f"method {cls.name!r} needs the option {key!r}: {declared.help}")
    return {k: _value(known[k], v, k) for k, v in given.items()}


def _value(declared: Option, value: Any, name: str) -> Any:
    if KINDS[declared.kind].is_list and is_real(value):
        value = (value,)
    if declared.choices or isinstance(value, str):
        return checked(declared, value, name)
    if isinstance(value, list | tuple) and any(isinstance(v, str | list | tuple) for v in value):
        return checked(declared, value, name)
    return tuple(value) if isinstance(value, list) else value


def _inputs(cls: type[Method], data: Any, own: Mapping[str, Any]) -> Any:
    """Return data as what the method reads."""
    if isinstance(data, Readings | RoleColumns | NamedFiles):
        return data
    if cls.reads in ("maps", "results"):
        items = (data,) if isinstance(data, Surface | Profile) else tuple(data)
        require_count(cls, len(items), [f"number {i + 1}" for i in range(len(items))])
        return Results(items) if cls.reads == "results" else items
    if cls.reads == "files":
        paths = (data,) if isinstance(data, str | os.PathLike) else data
        if not all(isinstance(p, str | os.PathLike) for p in paths):
            raise DataError(
                f"method {cls.name!r} reads files: give their paths; arrays go to "
                "metrosep.machine.calibrate, circle_test and fit_thermal"
            )
        return NamedFiles(tuple(map(Path, paths)), dict(own))
    if cls.reads == "table" and not hasattr(data, "keys"):
        raise DataError(
            f"method {cls.name!r} reads columns by their role: give a mapping of "
            f"{', '.join(cls.roles)} to arrays, got {type(data).__name__}"
        )
    if cls.reads == "table":
        return _columns(cls, {**dict(data), **own}, "data")
    if cls.reads == "tables":
        named = data.items() if isinstance(data, Mapping) else enumerate(data, start=1)
        return tuple(
            v if isinstance(v, RoleColumns) else _columns(cls, {**dict(v), **own}, str(k))
            for k, v in named
        )
    return _curves(cls, data, own)


def _columns(cls: type[Method], given: dict[str, Any], name: str) -> RoleColumns:
    """Return columns by their role; several columns of one role by their names, or as rows."""
    unit = given.pop("unit", "m")
    values: dict[str, Any] = {}
    names: dict[str, tuple[str, ...]] = {}
    listed = ("forward", "backward") if "direction" in cls.roles else ()
    for role, column in given.items():
        kind = cls.roles.get(role, "position" if role in listed else None)
        if kind is None:
            raise OptionError(
                f"method {cls.name!r} has no column {role!r}; it reads {', '.join(cls.roles)}"
            )
        if "*" in kind:
            rows = column if isinstance(column, Mapping) else dict(enumerate(column, start=1))
            names[role] = tuple(str(k) for k in rows)
            column = list(rows.values())  # noqa: PLW2901
        else:
            names[role] = (role,)
        values[role] = np.array(column, dtype=str if "label" in kind else np.float64)
    for role, kind in cls.roles.items():
        if "?" not in kind and role not in values:
            raise OptionError(f"method {cls.name!r} needs the column {role!r}")
    units = {r: unit for r, kind in cls.roles.items() if kind.startswith("position")}
    return RoleColumns(values, name, (), columns=names, units=units)


def _curves(cls: type[Method], data: Any, own: Mapping[str, Any]) -> Readings:
    """Return curves over common positions, of arrays, of profiles or of columns by their role."""
    position, extra, names = own.get("x", own.get("angle")), dict(own), list(cls.readings)
    history: tuple[Any, ...] = ()
    if isinstance(data, Mapping) or hasattr(data, "columns"):
        columns = dict(data)
        position = columns.pop("x", columns.pop("angle", position))
        extra |= {role: columns.pop(role) for role in cls.roles if role in columns}
        given = columns.pop("readings", None)
        names = list(columns) if given is None else names
        if given is None and set(cls.readings) <= set(columns):
            names = [*cls.readings, *(n for n in columns if n not in cls.readings)]
        curves = [columns[n] for n in names] if given is None else list(given)
    else:
        curves = list(data)
    if curves and all(isinstance(c, Profile) for c in curves):
        for curve in curves:
            curve.require_metres()
        position = curves[0].x
        if any(c.x.shape != position.shape or np.any(c.x != position) for c in curves):
            raise InvalidSamplesError(f"{cls.name}: the profiles have different positions")
        steps = [step for c in curves for step in c.history]
        history = tuple(s for i, s in enumerate(steps) if s not in steps[:i])
        curves = [c.z for c in curves]
    try:
        values = np.array([np.atleast_2d(np.asarray(c, dtype=np.float64)) for c in curves])
    except (TypeError, ValueError) as exc:
        raise InvalidSamplesError(
            f"{cls.name}: the readings are not curves of the same length ({exc})"
        ) from None
    if values.ndim != 3:
        raise InvalidSamplesError(
            f"{cls.name}: readings have the shape (readings, samples) or (readings, repeats, "
            f"samples), got {np.shape(curves)}"
        )
    n = values.shape[2]
    names += [f"reading {i + 1}" for i in range(len(names), len(values))]
    require_count(cls, len(values), names)
    if position is None and cls.over == "angle" and "index" not in extra:
        position = None if cls.name == "iso230_7" else 2.0 * np.pi * np.arange(n) / n
    return Readings(
        values,
        tuple(names[: len(values)]),
        None if position is None else np.asarray(position, dtype=np.float64),
        history,
        extra={
            role: np.atleast_2d(np.asarray(extra[role], None if "label" in kind else np.float64))
            for role, kind in cls.roles.items()
            if role in extra
        },
        position_unit="rad" if cls.over == "angle" else "m",
    )


def require_count(method: type[Method], n: int, names: Sequence[str]) -> None:
    """Refuse another number of readings than the method has."""
    known = ", ".join(method.readings)
    most = len(method.readings) + method.spare
    if method.readings and n > most:
        raise InvalidSamplesError(
            f"{most} readings are read ({known}), got {n} ({', '.join(names)}); leave the others out"
        )
    if method.readings and n < len(method.readings):
        raise InvalidSamplesError(
            f"{len(method.readings)} readings are needed ({known}), got {n} ({', '.join(names)}); "
            "name their columns in this order, or give one file for each"
        )
