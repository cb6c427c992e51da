"""Inputs of the separations that recipes name: curves from columns, maps from files."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from metrosep.core.errors import FormatMismatchError, InvalidSamplesError
from metrosep.core.provenance import Step
from metrosep.core.surface import Surface
from metrosep.io.readings import Readings, read_readings
from metrosep.recipe.methods import Method

__all__ = ["load_inputs", "require_count", "sources"]

Inputs = Readings | tuple[Surface, ...]


def load_inputs(method: Method, files: Sequence[Path], options: Mapping[str, Any]) -> Inputs:
    """Return what a method reads.

    Parameters
    ----------
    method : Method
        Which says of which kind it is.
    files : sequence of Path
        The files, in order.
    options : mapping
        Keys of ``[input]`` without ``files``.

    Returns
    -------
    Readings or tuple of Surface
        Curves over common positions, or maps.

    Raises
    ------
    ReadError
        If a file cannot be read or holds something else.
    DataError
        If readings do not fit together, or their number is wrong.
    """
    if method.reads == "curves":
        data = read_readings(files, dimension=method.dimension, **options)
        require_count(method, len(data.values), data.names)
        return data
    from metrosep.io.read import read

    surfaces = []
    for file in files:
        obj = read(file, **options)
        if not isinstance(obj, Surface):
            raise FormatMismatchError(
                f"{file}: holds a {type(obj).__name__.lower()}, this method needs maps of heights"
            )
        surfaces.append(obj)
    return tuple(surfaces)


def require_count(method: Method, n: int, names: Sequence[str]) -> None:
    """Refuse another number of readings than the method has.

    Parameters
    ----------
    method : Method
        With the names of its readings; any number if it has none.
    n : int
        How many there are.
    names : sequence of str
        What they are called in the files.

    Raises
    ------
    InvalidSamplesError
        If the number is wrong.
    """
    if method.names and n < len(method.names):
        raise InvalidSamplesError(
            f"{len(method.names)} readings are needed ({', '.join(method.names)}), got {n} "
            f"({', '.join(names)}); name their columns in this order, or give one file for each"
        )


def sources(inputs: Inputs) -> tuple[tuple[Step, ...], tuple[str, ...]]:
    """Return the steps that led to inputs, and what was odd about their files.

    Parameters
    ----------
    inputs : Readings or tuple of Surface
        As loaded.

    Returns
    -------
    history : tuple of Step
        Of all files.
    warnings : tuple of str
        Of all files.
    """
    if isinstance(inputs, Readings):
        return inputs.history, inputs.warnings
    history = tuple(step for s in inputs for step in s.history)
    warnings = tuple(str(w) for s in inputs for w in s.metadata.get("warnings", ()))
    return history, warnings
