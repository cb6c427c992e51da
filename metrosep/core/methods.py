"""What recipes, the command line and `separate` know by name: each method says itself what it reads.

A method is a class with `metrosep.core.options.option` fields: how its set-up is built. Its class
variables say what it reads. Packages list theirs in ``METHODS`` of their ``__init__``; the module of
a method is loaded when the method is asked for.
"""

from __future__ import annotations

import importlib
import sys
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, ClassVar, Literal

from numpy.typing import NDArray

from metrosep.core._arrays import FloatArray
from metrosep.core.attached import attached
from metrosep.core.docs import describe_options
from metrosep.core.options import Option, options_of
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


Reads = Literal["curves", "runs", "table", "tables", "maps", "results", "files", "nothing"]


class _Keys:
    """The keys of the step of a recipe, made from the options of the class."""

    def __get__(self, obj: object, cls: type[Method]) -> dict[str, Option]:
        return {"op": Option("text", required=True), **cls.arguments, **options_of(cls)}


class Method:
    """Something that makes a result of readings and has a name."""

    def __init_subclass__(cls, **keywords: Any) -> None:
        super().__init_subclass__(**keywords)
        describe_options(cls, vars(sys.modules[cls.__module__]).get(cls.__dict__.get("name", "")))

    name: ClassVar[str]
    """Name of the method in results and recipes."""

    what: ClassVar[str]
    """What it separates, for the list of methods."""

    verb: ClassVar[Literal["separate", "geometry"]] = "separate"
    """Command that carries it out."""

    reads: ClassVar[Reads] = "curves"
    """Columns over positions; repeated runs; columns by their role, of all files together or file by file; maps;
    documents of results; nothing where the options say all."""

    readings: ClassVar[tuple[str, ...]] = ()
    """What the readings are, in their order; empty where their number is free."""

    spare: ClassVar[int] = 0
    """How many further readings of curves may follow the named ones."""

    over: ClassVar[Literal["any", "x", "angle"]] = "any"
    """Which position curves may have."""

    dimension: ClassVar[Literal["length", "angle"]] = "length"
    """What the readings of curves are."""

    roles: ClassVar[Mapping[str, str]] = {}
    """Further columns and their dimension: ``"time"``, ``"angle"``, ``"position"`` (a length or an
    angle), ``"any"``, ``"label"``; a ``*`` after it: several columns; a ``?``: may be left out."""

    accepts: ClassVar[tuple[str, ...]] = ("Surface",)
    """Objects that files of maps may hold, or that results are."""

    arguments: ClassVar[Mapping[str, Option]] = {}
    """Options of the call, beside the fields: what is known of the readings."""

    fields: ClassVar[Mapping[str, Option]] = _Keys()  # type: ignore[assignment]
    """Keys of its step in a recipe, ``op`` first."""

    @classmethod
    def from_inputs(cls, data: Any, options: Mapping[str, Any]) -> Any:
        """Return the result of what was read, with the options that were given, in SI.

        Parameters
        ----------
        data : Readings, RoleColumns, NamedFiles, tuple of these, of maps or of results
            As `reads` says.
        options : mapping
            By name, without those that were omitted.

        Returns
        -------
        object
            Of the kind that the method makes.

        Raises
        ------
        MetrosepError
            If the columns, their number or the options do not go together.
        """
        raise NotImplementedError


class Methods(Mapping[str, type[Method]]):
    """The methods of some packages by name; a module is loaded when one of its methods is asked for."""

    def _places(self) -> dict[str, tuple[str, str]]:
        return {
            name: (package, place)
            for package in attached.method_packages  # names to "module:Class"
            for name, place in importlib.import_module(package).METHODS.items()
        }

    def __getitem__(self, name: str) -> type[Method]:
        """Return a method by its name."""
        package, place = self._places()[name]
        module, _, own = place.partition(":")
        found: type[Method] = getattr(importlib.import_module(f"{package}.{module}"), own)
        return found

    def __contains__(self, name: object) -> bool:
        """Whether there is a method of that name; nothing is loaded."""
        return name in self._places()

    def __iter__(self) -> Iterator[str]:
        """Names, in the order in which they are listed."""
        return iter(self._places())

    def __len__(self) -> int:
        """How many there are."""
        return len(self._places())


METHODS = Methods()
