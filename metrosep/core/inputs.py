"""What a method reads: curves over common positions, columns by their role, results."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from numpy.typing import NDArray

from metrosep.core._arrays import FloatArray
from metrosep.core.provenance import Step


@dataclass(frozen=True, slots=True, eq=False)
class Readings:
    """Curves over common positions.

    Parameters
    ----------
    values : ndarray, shape (n_readings, n_repeats, n)
        SI, NaN = not measured.
    names : tuple of str
        Column (and file, where there are several) of each reading.
    position : ndarray, shape (n,), or None
        In m or rad; None where no column was named.
    history : tuple of Step
        One step ``read`` for each file.
    warnings : tuple of str
        What is unusual about the files.
    extra : mapping of str to ndarray, shape (n_repeats, n)
        Further columns by their role: numbers in SI, or texts.
    position_unit : {"m", "rad"}
        Of `position`.
    """

    values: FloatArray
    names: tuple[str, ...]
    position: FloatArray | None
    history: tuple[Step, ...]
    warnings: tuple[str, ...] = ()
    extra: Mapping[str, NDArray[Any]] = field(default_factory=dict)
    position_unit: str = "m"


@dataclass(frozen=True, slots=True, eq=False)
class NamedFiles:
    """Files that a method reads itself, because what they hold depends on its options."""

    paths: tuple[Path, ...]
    # mapping: columns by their role and the layout of the text, as they were given
    options: Mapping[str, Any] = field(default_factory=dict)
    history: tuple[Step, ...] = ()  # one step ``read`` for each file
    warnings: tuple[str, ...] = ()


@dataclass(frozen=True, slots=True, eq=False)
class RoleColumns:
    """Columns of one or more files by their role."""

    # mapping of str to ndarray: each role: shape (n,), or (k, n) where it is a list of columns
    values: Mapping[str, NDArray[Any]]
    name: str  # of the file, without its extension; of the first where there are several
    history: tuple[Step, ...]  # one step ``read`` for each file
    warnings: tuple[str, ...] = ()  # what is odd about the files
    # mapping of str to tuple of str: names of the columns of each role, without their unit
    columns: Mapping[str, tuple[str, ...]] = field(default_factory=dict)
    # mapping of str to str: ``"m"`` or ``"rad"`` of each role that may be either
    units: Mapping[str, str] = field(default_factory=dict)


@dataclass(frozen=True, slots=True, eq=False)
class Results:
    """Results that a method goes on from."""

    items: tuple[Any, ...]  # as the method accepts them, in the order of the files
    history: tuple[Step, ...] = ()  # one step ``read`` for each file
    warnings: tuple[str, ...] = ()  # always empty
