"""Opening what the workbench works on: a map, a profile, repeated runs, or a recipe with its files."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Literal, TypeAlias

from metrosep.app.asking import COLUMNS, Ask, ask_columns, holds_columns
from metrosep.app.documents import RecipeDocument, start_runs_text, start_text
from metrosep.app.evaluations import Evaluations
from metrosep.app.places import Places
from metrosep.app.separations import MethodResults, Separations
from metrosep.core.errors import DataError, FormatMismatchError, ReadError, RecipeError, UnitError
from metrosep.core.profile import Profile
from metrosep.core.surface import Surface
from metrosep.recipe.input_options import reading_options
from metrosep.recipe.recipe import Recipe
from metrosep.recipe.run import input_files

__all__ = ["Kind", "Material", "Opened", "autosave_path", "open_files", "read_again"]

Kind: TypeAlias = Literal["map", "profile", "runs", "method"]
Material: TypeAlias = Evaluations | Separations | MethodResults
Read: TypeAlias = Callable[..., Any]

READING = ("unit", "lateral_step", "channel", "format", "x", "z", "scale")
"""Options of a reader that a recipe of a map or profile keeps in ``[input]``."""


@dataclass(frozen=True, slots=True)
class Opened:
    """What was opened.

    Parameters
    ----------
    kind : {"map", "profile", "runs", "method"}
        Which pictures it has.
    files : tuple of Path
        That are read; empty where a recipe reads nothing.
    home : Path
        File beside which the session is kept.
    document : RecipeDocument
        The recipe.
    material : Evaluations, Separations or MethodResults
        What the recipe is carried out on.
    messages : tuple of str
        What the user should know.
    """

    kind: Kind
    files: tuple[Path, ...]
    home: Path
    document: RecipeDocument
    material: Material
    messages: tuple[str, ...] = ()


def autosave_path(file: Path) -> Path:
    """Return where the session of a file is kept: beside it.

    Parameters
    ----------
    file : Path
        Measurement.

    Returns
    -------
    Path
        ``<name>.session.toml``.

    Examples
    --------
    >>> autosave_path(Path("part.sdf")).name
    'part.sdf.session.toml'
    """
    return file.with_name(f"{file.name}.session.toml")


def open_files(
    places: Places,
    paths: Sequence[str],
    reading: Mapping[str, Any] | None = None,
    read: Read | None = None,
) -> Opened:
    """Open a measurement, several runs as a set, or a recipe with its files.

    Parameters
    ----------
    places : Places
        Files that may be touched.
    paths : sequence of str
        As the page names them.
    reading : mapping, optional
        Options of the reader: what the files do not say.
    read : callable, optional
        Reads one file; `metrosep.io.read.read` if omitted.

    Returns
    -------
    Opened
        With the session that was kept beside it, if any.

    Raises
    ------
    ReadError
        If a file cannot be read, or lies outside the opened folders.
    Ask
        If the files do not say their unit or columns.
    DataError
        If they hold something else.
    RecipeError
        If a recipe is wrong.
    """
    if not paths:
        raise DataError("name a file to open")
    files = [places.readable(p) for p in paths]
    given = {k: v for k, v in (reading or {}).items() if v not in (None, "")}
    if files[0].suffix == ".toml":
        if len(files) > 1:
            raise DataError("open a recipe by itself; it names its files")
        return _of_recipe(places, files[0], given, read)
    kept, messages = _kept(files[0])
    if kept is not None:
        names = [files[0].parent / n for n in kept.recipe.input.get("files") or ()]
        if {f.resolve() for f in names} == set(files):
            kind, material = _with(kept, files, {}, read)
            return Opened(kind, tuple(files), files[0], kept, material, messages)
        messages = (f"{autosave_path(files[0]).name}: is of other files, not used",)
        kept = None
    if len(files) > 1 or COLUMNS & set(given) > {"x", "z"}:
        return _runs(files, given, messages)
    obj = _obj(files[0], _of_reader(given), read)
    kind = _kind(obj)
    document = RecipeDocument(
        start_text(files[0].name, kind, _of_reader(given)), files[0].parent, _name(files[0])
    )
    return Opened(kind, tuple(files), files[0], document, Evaluations(obj), messages)


def read_again(opened: Opened, recipe: Recipe, read: Read | None = None) -> Opened:
    """Return what is open, read anew as its recipe says now.

    Parameters
    ----------
    opened : Opened
        What is open.
    recipe : Recipe
        Which names other columns, units or channels than before.
    read : callable, optional
        See `open_files`.

    Returns
    -------
    Opened
        The same files.

    Raises
    ------
    MetrosepError
        If they cannot be read so.
    """
    if isinstance(opened.material, Separations):
        opened.material.runs(recipe)
        return opened
    if isinstance(opened.material, MethodResults):
        return opened
    obj = _obj(opened.files[0], reading_options(recipe.input), read)
    return replace(opened, kind=_kind(obj), material=Evaluations(obj))


def _runs(files: list[Path], given: Mapping[str, Any], messages: tuple[str, ...]) -> Opened:
    if "x" not in given or "z" not in given:
        raise ask_columns(files, given, "several files are one set of repeated runs")
    folder = files[0].parent
    if any(f.parent != folder for f in files):
        raise DataError(
            "the files of a set of runs lie in one folder; copy them together, the recipe names them "
            "beside itself"
        )
    text = start_runs_text([f.name for f in files], given)
    document = RecipeDocument(text, folder, _name(files[0]))
    separations = Separations(files)
    separations.runs(document.recipe)  # a wrong column shows now
    return Opened("runs", tuple(files), files[0], document, separations, messages)


def _of_recipe(places: Places, file: Path, given: Mapping[str, Any], read: Read | None) -> Opened:
    try:
        text = file.read_text(encoding="utf-8")
    except (OSError, UnicodeDecodeError) as exc:
        raise RecipeError(f"{file.name}: the recipe cannot be read ({exc})") from None
    document = RecipeDocument(text, file.parent, file.name)
    recipe = document.recipe
    if recipe.reads_nothing:
        kept, messages = _kept(file)
        return Opened("method", (), file, kept or document, MethodResults(()), messages)
    if not recipe.input.get("files"):
        raise ReadError(f"{file.name}: its [input] names no file; open a measurement")
    found = [places.readable(str(f)) for f in input_files(recipe, None)]
    if recipe.is_pipeline:
        found = found[:1]
    kind, material = _with(document, found, given, read)
    return Opened(kind, tuple(found), found[0], document, material)


def _with(
    document: RecipeDocument, files: Sequence[Path], given: Mapping[str, Any], read: Read | None
) -> tuple[Kind, Material]:
    """Return what the recipe of a document works on."""
    recipe: Recipe = document.recipe
    if recipe.is_pipeline:
        obj = _obj(files[0], _of_reader(given) or reading_options(recipe.input), read)
        return _kind(obj), Evaluations(obj)
    if recipe.is_method:
        return "method", MethodResults(files)
    separations = Separations(files)
    separations.runs(recipe)
    return "runs", separations


def _kept(file: Path) -> tuple[RecipeDocument | None, tuple[str, ...]]:
    """Return the session that is kept beside a file."""
    kept = autosave_path(file)
    if not kept.is_file():
        return None, ()
    try:
        made = RecipeDocument(kept.read_text(encoding="utf-8"), file.parent, _name(file))
    except (OSError, UnicodeDecodeError, RecipeError) as exc:
        return None, (f"{kept.name}: the session kept there is not used ({exc})",)
    return made, (f"the session of this file was taken up again ({kept.name})",)


def _obj(file: Path, reading: Mapping[str, Any], read: Read | None) -> Surface | Profile:
    from metrosep.io.read import read as usual

    try:
        obj = (read or usual)(file, **reading)
    except MemoryError:
        raise ReadError(
            f"{file.name}: too large for the memory of this computer; cut it, or open it elsewhere"
        ) from None
    except UnitError as exc:
        if "x" not in reading and holds_columns(file, fewest=3):
            raise ask_columns([file], reading, str(exc)) from None
        raise Ask(str(exc), "unit", str(file)) from None
    except FormatMismatchError as exc:
        if "x" in reading or not holds_columns(file):
            raise
        raise ask_columns([file], reading, str(exc)) from None
    if isinstance(obj, Surface | Profile):
        return obj
    if "x" not in reading and holds_columns(file):
        raise ask_columns([file], reading, f"{file.name}: holds several columns of numbers")
    raise DataError(
        f"{file.name}: holds a {type(obj).__name__}; the workbench works on maps, profiles and "
        "repeated runs"
    )


def _of_reader(given: Mapping[str, Any]) -> dict[str, Any]:
    return {k: v for k, v in given.items() if k in READING}


def _kind(obj: Surface | Profile) -> Literal["map", "profile"]:
    return "map" if isinstance(obj, Surface) else "profile"


def _name(file: Path) -> str:
    return f"{file.stem}.toml"
