"""Opening what the workbench works on: a map, a profile, repeated runs, or a recipe with its files."""

from __future__ import annotations

import hashlib
import tomllib
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Literal, TypeAlias

from metrosep.app.asking import Ask, answered, ask_columns, holds_columns
from metrosep.app.documents import Edit, RecipeDocument, start_runs_text, start_text
from metrosep.app.evaluations import Evaluations
from metrosep.app.places import Places
from metrosep.app.separations import MethodResults, Separations
from metrosep.app.targets import Stamp, stamps_of, with_digests
from metrosep.core.errors import (
    DataError,
    FormatMismatchError,
    MetrosepError,
    ReadError,
    RecipeError,
    UnitError,
)
from metrosep.core.profile import Profile
from metrosep.core.surface import Surface
from metrosep.recipe.input_options import reading_options
from metrosep.recipe.recipe import Recipe
from metrosep.recipe.run import input_files
from metrosep.recipe.steps import INPUT

__all__ = ["Kind", "Material", "Opened", "autosave_path", "open_files", "open_with", "read_again"]

Kind: TypeAlias = Literal["map", "profile", "runs", "method"]
Material: TypeAlias = Evaluations | Separations | MethodResults
Read: TypeAlias = Callable[..., Any]

READING = ("unit", "lateral_step", "channel", "format", "x", "z", "scale")
"""Options of a reader that a recipe of a map or profile keeps in ``[input]``."""

_COLUMNS = tuple(key for key in INPUT if key != "files")
"""Those of repeated runs."""

_RUNS = {"feed", "run", "direction"}
"""Options that make a set of runs of a single file."""


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
        The recipe, or the first file.
    document : RecipeDocument
        The recipe.
    material : Evaluations, Separations or MethodResults
        What the recipe is carried out on.
    messages : tuple of str
        What the user should know.
    kept : Path
        Where the session is kept.
    displaced : bool
        Whether what is kept there is not used: it is put aside before it is written over.
    serial : int
        Number of the opening within its session.
    """

    kind: Kind
    files: tuple[Path, ...]
    home: Path
    document: RecipeDocument
    material: Material
    messages: tuple[str, ...] = ()
    kept: Path = Path()
    displaced: bool = False
    serial: int = 0


def autosave_path(file: Path, others: Sequence[Path] = ()) -> Path:
    """Return where the session of a file is kept: beside it.

    Parameters
    ----------
    file : Path
        Measurement or recipe.
    others : sequence of Path, optional
        Further files of the same set of runs: each set has a session of its own.

    Returns
    -------
    Path
        ``<name>.session.toml``; of a set with letters that tell it from other sets.

    Examples
    --------
    >>> autosave_path(Path("part.sdf")).name
    'part.sdf.session.toml'
    """
    which = ""
    if others:
        names = "\0".join(sorted(str(f) for f in (file, *others)))
        which = f".set-{hashlib.sha256(names.encode()).hexdigest()[:8]}"
    return file.with_name(f"{file.name}{which}.session.toml")


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
    files = sorted(dict.fromkeys(places.readable(p) for p in paths))
    given = _checked(answered(reading or {}))
    recipes = [f for f in files if f.suffix == ".toml"]
    if len(recipes) > 1:
        raise DataError("open one recipe at a time; it names its files")
    if recipes:
        others = [f for f in files if f not in recipes]
        return _of_recipe(places, recipes[0], others, given, read)
    kept = autosave_path(files[0], files[1:])
    opened, messages = _taken_up(kept, files, given, read)
    if opened is not None:
        return opened
    fresh = (
        _runs(files, given)
        if len(files) > 1 or _RUNS & set(given)
        else _one(files[0], given, read)
    )
    return replace(
        fresh, kept=kept, messages=(*messages, *fresh.messages), displaced=bool(messages)
    )


def open_with(
    places: Places,
    paths: Sequence[str],
    document: RecipeDocument,
    reading: Mapping[str, Any] | None = None,
    read: Read | None = None,
) -> Opened:
    """Open other files with the recipe that is at hand.

    Parameters
    ----------
    places : Places
        Files that may be touched.
    paths : sequence of str
        A map, a profile, or runs: of the kind that the recipe is of.
    document : RecipeDocument
        Recipe; its ``[input]`` says how the files are read.
    reading : mapping, optional
        What these files need beside it.
    read : callable, optional
        See `open_files`.

    Returns
    -------
    Opened
        With a recipe of its own that names these files; a session that is kept beside them is put
        aside.

    Raises
    ------
    DataError
        If they hold something else than the recipe is of, or one of them is a recipe.
    ReadError
        If a file cannot be read, or lies outside the opened folders.
    Ask
        If the files do not say their unit or columns.
    """
    if any(str(p).endswith(".toml") for p in paths):
        raise DataError("a recipe is opened by itself; the present one is kept for measurements")
    held = tomllib.loads(document.text).get("input", {})
    options = {k: v for k, v in held.items() if k != "files"}
    opened = open_files(places, paths, {**options, **(reading or {})}, read)
    recipe = document.recipe
    fits = {"map": recipe.is_pipeline, "profile": recipe.is_pipeline}
    fits["runs"] = not recipe.is_method
    if not fits.get(opened.kind, False):
        raise DataError(
            f"{opened.home.name}: is a {opened.kind}, and the present recipe ({recipe.steps[0]['op']}) "
            "is not for that; open it without keeping the recipe"
        )
    new = tomllib.loads(opened.document.text)["input"]
    made = RecipeDocument(document.text, opened.document.folder, opened.document.name)
    edits = [Edit(("input", k), held.get(k), v) for k, v in new.items() if held.get(k) != v]
    if edits:
        made.edit(edits)
    fresh = RecipeDocument(made.text, made.folder, made.name)
    return replace(opened, document=fresh, displaced=opened.kept.is_file())


def _checked(given: dict[str, Any]) -> dict[str, Any]:
    unknown = sorted(set(given) - set(READING) - set(_COLUMNS))
    if unknown:
        known = ", ".join(sorted({*READING, *_COLUMNS}))
        raise DataError(f"there is no option {unknown[0]!r} of reading; there are {known}")
    return given


def _one(file: Path, given: Mapping[str, Any], read: Read | None) -> Opened:
    """Open a file that has no session yet: a map or a profile."""
    chosen = {k: v for k, v in given.items() if k in READING}
    obj = _obj(file, reading_options(chosen), read)
    left = sorted(set(given) - set(chosen))
    said = (
        f"{file.name}: is one profile; {' and '.join(left)} not used: they belong to repeated runs"
    )
    kind = _kind(obj)
    document = RecipeDocument(start_text(file.name, kind, chosen), file.parent, _name(file))
    return Opened(kind, (file,), file, document, Evaluations(obj), (said,) if left else ())


def _taken_up(
    kept: Path, files: Sequence[Path], given: Mapping[str, Any], read: Read | None
) -> tuple[Opened | None, tuple[str, ...]]:
    """Return the session that was kept for files; or why it is not used, where there is one."""
    if not kept.is_file():
        return None, ()
    try:
        text = kept.read_text(encoding="utf-8")
        document = _answering(RecipeDocument(text, kept.parent, _name(files[0])), given)
        names = [kept.parent / n for n in document.recipe.input.get("files") or ()]
        if {f.resolve() for f in names} != set(files):
            return None, (
                f"{kept.name}: the session kept there is of other files, and is not used",
            )
        kind, material = _with(document, files, read)
    except Ask:
        raise
    except (OSError, UnicodeDecodeError, MetrosepError) as exc:
        return None, (f"{kept.name}: the session kept there is not used ({exc})",)
    said = f"the session of this file was taken up again ({kept.name})"
    return Opened(kind, tuple(files), files[0], document, material, (said,), kept), ()


def _answering(document: RecipeDocument, given: Mapping[str, Any]) -> RecipeDocument:
    """Return a recipe whose ``[input]`` has what the user answered."""
    if not given:
        return document
    held = tomllib.loads(document.text).get("input", {})
    edits = [Edit(("input", k), held.get(k), v) for k, v in given.items() if held.get(k) != v]
    made = RecipeDocument(document.text, document.folder, document.name)
    if edits:
        made.edit(edits)
    return RecipeDocument(made.text, document.folder, document.name)


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


def _runs(files: list[Path], given: Mapping[str, Any]) -> Opened:
    for file in files:
        if not holds_columns(file):
            raise DataError(
                f"{file.name}: is no table of positions and readings; several files are one set of "
                "repeated runs, open a map or a profile by itself"
            )
    if "x" not in given or "z" not in given:
        raise ask_columns(files, given, "several files are one set of repeated runs")
    folder = files[0].parent
    if any(f.parent != folder for f in files):
        raise DataError(
            "the files of a set of runs lie in one folder; copy them together, the recipe names them "
            "beside itself"
        )
    chosen = {k: v for k, v in given.items() if k in _COLUMNS}
    text = start_runs_text([f.name for f in files], chosen)
    document = RecipeDocument(text, folder, _name(files[0]))
    separations = Separations(files)
    separations.runs(document.recipe)  # a wrong column shows now
    return Opened("runs", tuple(files), files[0], document, separations)


def _of_recipe(
    places: Places, file: Path, others: Sequence[Path], given: Mapping[str, Any], read: Read | None
) -> Opened:
    """Open a recipe: as it was left, unless it was changed by other hands since."""
    try:
        text = file.read_text(encoding="utf-8")
    except (OSError, UnicodeDecodeError) as exc:
        raise RecipeError(f"{file.name}: the recipe cannot be read ({exc})") from None
    kept = autosave_path(file)
    messages: tuple[str, ...] = ()
    document, displaced = RecipeDocument(text, file.parent, file.name), False
    if kept.is_file():
        document, messages, displaced = _left(kept, file, document)
    document = _answering(document, given)
    recipe = document.recipe
    found: list[Path] = []
    if not recipe.reads_nothing:
        if not recipe.input.get("files"):
            raise ReadError(f"{file.name}: its [input] names no file; open a measurement")
        found = [places.readable(str(f)) for f in input_files(recipe, None)]
    if recipe.is_pipeline and len(found) > 1:
        messages = (*messages, f"{file.name} names {len(found)} files; {found[0].name} is shown")
        found = found[:1]
    unused = [f.name for f in others if f not in found]
    if unused:
        messages = (*messages, f"{file.name} does not name {', '.join(unused)}: not opened")
    kind, material = _with(document, found, read)
    return Opened(kind, tuple(found), file, document, material, messages, kept, displaced)


def _left(
    kept: Path, file: Path, document: RecipeDocument
) -> tuple[RecipeDocument, tuple[str, ...], bool]:
    """Return the session of a recipe, or the recipe itself where it is younger."""
    try:
        left = RecipeDocument(kept.read_text(encoding="utf-8"), file.parent, file.name)
        older = kept.stat().st_mtime_ns < file.stat().st_mtime_ns
    except (OSError, UnicodeDecodeError, RecipeError) as exc:
        return document, (f"{kept.name}: the session kept there is not used ({exc})",), True
    if left.text == document.text:
        return document, (), False
    if older:
        said = f"{kept.name}: {file.name} was changed after this session was kept; it is not used"
        return document, (said,), True
    return left, (f"the session of this recipe was taken up again ({kept.name})",), False


def _with(
    document: RecipeDocument, files: Sequence[Path], read: Read | None
) -> tuple[Kind, Material]:
    """Return what the recipe of a document works on."""
    recipe: Recipe = document.recipe
    if recipe.is_pipeline:
        obj = _obj(files[0], reading_options(recipe.input), read)
        return _kind(obj), Evaluations(obj)
    if recipe.is_method:
        return "method", MethodResults(files)
    separations = Separations(files)
    separations.runs(recipe)
    return "runs", separations


def _obj(file: Path, reading: Mapping[str, Any], read: Read | None) -> Surface | Profile:
    from metrosep.io.read import read as usual

    try:
        obj = (read or usual)(file, **reading)
    except MemoryError:
        raise ReadError(
            f"{file.name}: too large for the memory of this computer; cut it, or open it elsewhere"
        ) from None
    except (UnitError, FormatMismatchError) as exc:
        raise _question(file, reading, exc) from None
    if isinstance(obj, Surface | Profile):
        return obj
    if "x" not in reading and holds_columns(file):
        raise ask_columns([file], reading, f"{file.name}: holds several columns of numbers")
    raise DataError(
        f"{file.name}: holds a {type(obj).__name__}; the workbench works on maps, profiles and "
        "repeated runs"
    )


def _question(file: Path, reading: Mapping[str, Any], why: MetrosepError) -> MetrosepError:
    """Return what is to be asked, or the error itself where no answer would help."""
    several, words = holds_columns(file), str(why).partition(";")[0]
    if several and not (isinstance(why, FormatMismatchError) and "x" in reading):
        given = {k: v for k, v in reading.items() if isinstance(v, str)}
        return ask_columns([file], given, words)
    if isinstance(why, UnitError):
        return Ask(words, "unit", str(file))
    if holds_columns(file, fewest=1) and "lateral_step" not in reading:
        return Ask(words, "lateral_step", str(file))
    return why


def _kind(obj: Surface | Profile) -> Literal["map", "profile"]:
    return "map" if isinstance(obj, Surface) else "profile"


def _name(file: Path) -> str:
    return f"{file.stem}.toml"
