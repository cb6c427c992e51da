"""Opening what the workbench works on: a map, a profile, repeated runs, or a recipe with its files."""

from __future__ import annotations

import base64
import contextlib
import hashlib
import json
import os
import re
import sys
import tomllib
import zlib
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Literal, TypeAlias

from metrosep.app.asking import (
    ONE_FEED,
    Ask,
    answered,
    are_runs,
    ask_channel,
    ask_columns,
    ask_rows,
    ask_text,
    fewest_feeds,
    holds_columns,
)
from metrosep.app.documents import (
    Edit,
    Places,
    RecipeDocument,
    Stamp,
    stamps_of,
    start_runs_text,
    start_text,
    start_traces_text,
    with_digests,
)
from metrosep.app.evaluations import Evaluations
from metrosep.app.first_lines import text_options
from metrosep.app.separations import MethodResults, Separations
from metrosep.core.atomic import RECIPE_BYTES, read_plain
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
from metrosep.core.text_options import TEXT_OPTIONS
from metrosep.recipe.recipe import Recipe
from metrosep.recipe.run import input_files
from metrosep.recipe.schema import reading_options
from metrosep.recipe.steps import INPUT
from metrosep.recipe.written.extends import Admits

Kind: TypeAlias = Literal["map", "profile", "runs", "method"]
Material: TypeAlias = Evaluations | Separations | MethodResults
Read: TypeAlias = Callable[..., Any]

READING = (
    "unit", "lateral_step", "row_order", "channel", "format", "x", "z", "scale", *TEXT_OPTIONS,
)  # fmt: skip
"""Options of a reader that a recipe of a map or profile keeps in ``[input]``."""

_LONGEST_NAME = 100
"""Letters of a name that the name of a session takes up: 255 bytes are the most of many disks."""

_COLUMNS = tuple(key for key in INPUT if key != "files")
"""Those of repeated runs."""

_TRACES = ("angle", "radius", "height")
"""Those of roundness traces."""


@dataclass(frozen=True, slots=True)
class Opened:
    """What was opened."""

    kind: Kind  # {"map", "profile", "runs", "method"}: which pictures it has
    files: tuple[Path, ...]  # that are read; empty where a recipe reads nothing
    home: Path  # the recipe, or the first file
    document: RecipeDocument  # the recipe
    material: Material  # or MethodResults: what the recipe is carried out on
    messages: tuple[str, ...] = ()  # what the user should know
    kept: Path = Path()  # where the session is kept
    # whether what is kept there is not used: it is put aside before it is written over
    displaced: bool = False
    serial: int = 0  # number of the opening within its session
    stamps: tuple[Stamp, ...] = ()  # what tells the files from later ones of their names
    # bytes or None: what was kept there at opening; None where nothing was
    held: bytes | None = None
    base: str = ""  # SHA-256 of the recipe that was opened; empty where it was a measurement


def autosave_path(file: Path, others: Sequence[Path] = ()) -> Path:
    """Return where the session of a file is kept: in the user's folder of state, not beside the data."""
    names = "\0".join(sorted(os.path.realpath(f) for f in (file, *others)))
    which = hashlib.sha256(names.encode()).hexdigest()[:12]
    return state_folder() / f"{file.name[:_LONGEST_NAME]}.{which}.session.toml"


def state_folder() -> Path:
    """Return where this user's programs keep what they go on with."""
    if sys.platform == "win32":
        given = os.environ.get("LOCALAPPDATA")
        home = Path(given) if given else Path.home() / "AppData" / "Local"
    elif sys.platform == "darwin":
        home = Path.home() / "Library" / "Application Support"
    else:
        given = os.environ.get("XDG_STATE_HOME", "")  # relative ones are to be ignored (XDG)
        home = Path(given) if Path(given).is_absolute() else Path.home() / ".local" / "state"
    return home / "metrosep" / "sessions"


def _left_beside(kept: Path, file: Path) -> tuple[str, ...]:
    """Return a sentence on a session that an older version kept beside the file, if there is one."""
    older = file.with_name(f"{file.name}.session.toml")
    if older == kept or not older.is_file():
        return ()
    said = (
        f"{older.name}: an older version of metrosep kept a session here, which is not taken up; open "
        "it as a recipe to go on with it, or delete it"
    )
    return (said,)


def _kept(places: Places, file: Path, others: Sequence[Path] = ()) -> Path:
    """Return where a session is kept; that of an upload goes with it."""
    if places.is_upload(file):
        return file.with_name(f"{file.name}.session.toml")
    return autosave_path(file, others)


def open_files(
    places: Places,
    paths: Sequence[str],
    reading: Mapping[str, Any] | None = None,
    read: Read | None = None,
) -> Opened:
    """Open a measurement, several runs as a set, or a recipe with its files."""
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
    kept, stamps = _kept(places, files[0], files[1:]), stamps_of(files)
    opened, messages = _taken_up(places, kept, files, given, read)
    if opened is not None:
        return _stamped(opened, stamps)
    if set(_TRACES) & set(given):
        fresh = _traces(places, files, given)
    elif are_runs(files, given):
        fresh = _runs(places, files, given)
    else:
        fresh = _one(places, files[0], given, read)
    said, displaced = (*messages, *fresh.messages), kept.is_file() and bool(messages)
    return _stamped(replace(fresh, kept=kept, messages=said, displaced=displaced), stamps)


def _stamped(opened: Opened, stamps: tuple[Stamp, ...]) -> Opened:
    """Return what was opened with what tells its files from later ones."""
    return replace(opened, stamps=with_digests(stamps, getattr(opened.material, "obj", None)))


def open_with(
    places: Places,
    paths: Sequence[str],
    document: RecipeDocument,
    reading: Mapping[str, Any] | None = None,
    read: Read | None = None,
) -> Opened:
    """Open other files with the recipe that is at hand."""
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
    made = RecipeDocument(
        document.text, opened.document.folder, opened.document.name, places.admits
    )
    return replace(opened, document=_with_input(made, new), displaced=opened.kept.is_file())


def _checked(given: dict[str, Any]) -> dict[str, Any]:
    unknown = sorted(set(given) - {*READING, *_COLUMNS, *_TRACES})
    if unknown:
        known = ", ".join(sorted({*READING, *_COLUMNS, *_TRACES}))
        raise DataError(f"there is no option {unknown[0]!r} of reading; there are {known}")
    return given


def _one(places: Places, file: Path, given: Mapping[str, Any], read: Read | None) -> Opened:
    """Open a file that has no session yet: a map or a profile."""
    chosen = {k: v for k, v in given.items() if k in READING}
    obj = _obj(file, reading_options(chosen), read)
    left = sorted(set(given) - set(chosen))
    said = (
        f"{file.name}: is one profile; {' and '.join(left)} not used: they belong to repeated runs"
    )
    kind = _kind(obj)
    text = start_text(file.name, kind, chosen)
    document = RecipeDocument(text, file.parent, _name(file), places.admits)
    return Opened(kind, (file,), file, document, Evaluations(obj), (said,) if left else ())


def _taken_up(
    places: Places, kept: Path, files: Sequence[Path], given: Mapping[str, Any], read: Read | None
) -> tuple[Opened | None, tuple[str, ...]]:
    """Return the session that was kept for files; or why it is not used, where there is one."""
    if not kept.is_file():
        return None, _left_beside(kept, files[0])
    try:
        held = kept.read_bytes()
        document = session_of(held, files[0].parent, _name(files[0]), places.admits)
        document = _with_input(document, given)
        names = [files[0].parent / n for n in document.recipe.input.get("files") or ()]
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
    return Opened(kind, tuple(files), files[0], document, material, (said,), kept, held=held), ()


def _with_input(document: RecipeDocument, given: Mapping[str, Any]) -> RecipeDocument:
    """Return a recipe with values of ``[input]``: there is nothing to undo in it."""
    if not given:
        return document
    held = tomllib.loads(document.text).get("input", {})
    edits = [Edit(("input", k), held.get(k), v) for k, v in given.items() if held.get(k) != v]
    made = document.anew()
    if edits:
        made.edit(edits)
    return made.anew()


def read_again(opened: Opened, recipe: Recipe, read: Read | None = None) -> Opened:
    """Return what is open, read anew as its recipe says now."""
    if isinstance(opened.material, Separations):
        opened.material.runs(recipe)
        return opened
    if isinstance(opened.material, MethodResults):
        return opened
    stamps = stamps_of(opened.files)
    obj = _obj(opened.files[0], reading_options(recipe.input), read)
    return _stamped(replace(opened, kind=_kind(obj), material=Evaluations(obj)), stamps)


def _runs(places: Places, files: list[Path], given: Mapping[str, Any]) -> Opened:
    for file in files:
        if not holds_columns(file, given=given):
            _ask_of_text(file, given)
            raise DataError(
                f"{file.name}: is not a table of positions and readings; several files are one set of "
                "repeated runs, open a map or a profile by itself"
            )
    if "x" not in given or "z" not in given:
        raise ask_columns(files, given, "several files are one set of repeated runs")
    folder = _common_folder(files)
    chosen = {k: v for k, v in given.items() if k in _COLUMNS}
    names, name = [f.name for f in files], _name(files[0])
    document = RecipeDocument(start_runs_text(names, chosen), folder, name, places.admits)
    separations = Separations(files)
    try:
        feeds = fewest_feeds(separations.runs(document.recipe))  # a wrong column shows now
    except UnitError as exc:
        raise ask_columns(files, given, _why(exc)) from None
    text = start_runs_text(names, chosen, feeds)
    document = RecipeDocument(text, folder, name, places.admits)
    said = () if feeds > 1 else (ONE_FEED,)
    return Opened("runs", tuple(files), files[0], document, separations, said)


def _traces(places: Places, files: list[Path], given: Mapping[str, Any]) -> Opened:
    """Open roundness traces: one file, or several sections of a feature."""
    missing = [key for key in ("angle", "radius") if key not in given]
    if missing:
        raise ask_columns(
            files, given, f"the {' and the '.join(missing)} of the trace is not named"
        )
    if {"x", "z"} & set(given):
        why = "name the angle and the radius of a trace, or a position and a reading, not both"
        raise ask_columns(files, given, why)
    folder = _common_folder(files)
    chosen = {k: v for k, v in given.items() if k in (*_TRACES, *TEXT_OPTIONS)}
    text = start_traces_text([f.name for f in files], chosen)
    document = RecipeDocument(text, folder, _name(files[0]), places.admits)
    material = MethodResults(files)
    try:
        material.result(document.recipe)  # a wrong column shows now
    except MetrosepError as exc:
        raise ask_columns(files, given, _why(exc)) from None
    return Opened("method", tuple(files), files[0], document, material)


def _common_folder(files: Sequence[Path]) -> Path:
    folder = files[0].parent
    if any(f.parent != folder for f in files):
        raise DataError(
            "the files of a set lie in one folder; copy them together, the recipe names them beside itself"
        )
    return folder


def _of_recipe(
    places: Places, file: Path, others: Sequence[Path], given: Mapping[str, Any], read: Read | None
) -> Opened:
    """Open a recipe: as it was left, unless it was changed by other hands since."""
    try:
        content = read_plain(file, RECIPE_BYTES)
        text = _decoded(content)
    except (OSError, UnicodeDecodeError) as exc:
        raise RecipeError(f"{file.name}: the recipe cannot be read ({exc})") from None
    base = hashlib.sha256(content).hexdigest()
    kept = _kept(places, file)
    left = _Left(RecipeDocument(text, file.parent, file.name, places.admits))
    if kept.is_file():
        left = _left(kept, file, left.document, base)
    document = _with_input(left.document, given)
    messages = left.messages if kept.is_file() else _left_beside(kept, file)
    recipe = document.recipe
    found: list[Path] = []
    if not recipe.reads_nothing:
        if not recipe.input.get("files"):
            raise ReadError(f"{file.name}: its [input] names no file; open a measurement")
        for pattern in recipe.input["files"]:  # before a folder outside is looked into
            places.require_inside(str(file.parent / pattern))
        found = [places.readable(str(f)) for f in input_files(recipe, None)]
    if recipe.is_pipeline and len(found) > 1:
        messages = (*messages, f"{file.name} names {len(found)} files; {found[0].name} is shown")
        found = found[:1]
    unused = [f.name for f in others if f not in found]
    if unused:
        messages = (*messages, f"{file.name} does not name {', '.join(unused)}: not opened")
    stamps = stamps_of(found)
    kind, material = _with(document, found, read)
    opened = Opened(kind, tuple(found), file, document, material, messages, kept, left.displaced)
    return _stamped(replace(opened, held=left.held, base=base), stamps)


@dataclass(frozen=True, slots=True)
class _Left:
    """What is gone on with: a recipe or its session, and what was found kept."""

    document: RecipeDocument
    messages: tuple[str, ...] = ()
    displaced: bool = False
    held: bytes | None = None


def _left(kept: Path, file: Path, document: RecipeDocument, base: str) -> _Left:
    """Return the session of a recipe, or the recipe itself where it was changed since.

    The session says of which recipe it is; where it does not (older versions), the times tell.
    """
    try:
        held = kept.read_bytes()
        of = text_of_session(held)[1]
        left = session_of(held, file.parent, file.name, document.admits)
        changed = of != base if of else kept.stat().st_mtime_ns < file.stat().st_mtime_ns
    except (OSError, UnicodeDecodeError, RecipeError) as exc:
        said = f"{kept.name}: the session kept there is not used ({exc})"
        return _Left(document, (said,), displaced=True)
    if left.text == document.text:
        return _Left(left, held=held)
    if changed:
        said = (
            f"{kept.name}: {file.name} was changed after this session was kept; it is not used, and "
            "put aside (.old) with your next change"
        )
        return _Left(document, (said,), displaced=True)
    said = f"the session of this recipe was taken up again ({kept.name})"
    return _Left(left, (said,), held=held)


_OF_RECIPE = re.compile(r"\n# of [^\n]* sha256 ([0-9a-f]{64})\n\Z")
_UNDO = re.compile(r"\n# undo ([A-Za-z0-9+/=]+)\n?\Z")
"""Last lines of a session: of which recipe it is, and what can be undone; no part of the recipe."""

_MOST_UNDO = 16 << 20
"""Bytes of a history; what is longer was not written here."""


def session_text(opened: Opened, document: RecipeDocument) -> str:
    """Return what is kept of a session: its recipe, what can be undone, and of which recipe it is."""
    lines = [document.text]
    if any(document.history):
        packed = zlib.compress(json.dumps(document.history).encode(), 1)
        lines.append(f"# undo {base64.b64encode(packed).decode()}")
    if opened.base:
        lines.append(f"# of {opened.home.name} sha256 {opened.base}")
    return "\n".join([*lines, ""]) if len(lines) > 1 else document.text


def session_of(held: bytes, folder: Path, name: str, admits: Admits | None) -> RecipeDocument:
    """Return the document of a kept session with its history, or without one that cannot be read."""
    text, _, history = _parts(held)
    document = RecipeDocument(text, folder, name, admits)
    with contextlib.suppress(ValueError, TypeError, RecursionError, zlib.error):
        unpacked = zlib.decompressobj().decompress(base64.b64decode(history), _MOST_UNDO)
        document.remember(json.loads(unpacked))
    return document


def text_of_session(held: bytes) -> tuple[str, str]:
    """Return the recipe of a kept session, and the digest of the recipe that it began with.

    Examples
    --------
    >>> text_of_session(b'metrosep = 1')
    ('metrosep = 1', '')
    """
    return _parts(held)[:2]


def _parts(held: bytes) -> tuple[str, str, str]:
    """Return the recipe of a session, the digest of the recipe that it began with, and its history as written."""
    text, digest, history = _decoded(held), "", ""
    if (of := _OF_RECIPE.search(text)) is not None:
        text, digest = text[: of.start()], of[1]
    if (undo := _UNDO.search(text)) is not None:
        text, history = text[: undo.start()], undo[1]
    return text, digest, history


def _decoded(content: bytes) -> str:
    """Return text with one kind of line ends, as files are read."""
    return content.decode("utf-8").replace("\r\n", "\n").replace("\r", "\n")


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
    from metrosep.io.read import read_for_recipe as usual

    try:
        obj = (read or usual)(file, **reading)
    except MemoryError:
        raise ReadError(
            f"{file.name}: too large for the memory of this computer; cut it, or open it elsewhere"
        ) from None
    except (UnitError, FormatMismatchError) as exc:
        raise _question(file, reading, exc) from None
    except ReadError as exc:
        raise ask_rows(file, reading, exc) or ask_text(file, reading, exc) or exc from None
    if isinstance(obj, Surface | Profile):
        return obj
    if "x" not in reading and holds_columns(file, given=reading):
        raise ask_columns([file], reading, f"{file.name}: holds several columns of numbers")
    raise DataError(
        f"{file.name}: holds a {type(obj).__name__}; the workbench works on maps, profiles and "
        "repeated runs"
    )


def _ask_of_text(file: Path, given: Mapping[str, Any]) -> None:
    """Raise the question about a text that cannot be read as it stands, if there is one."""
    from metrosep.io.runs import columns_of
    from metrosep.io.source import open_file

    try:
        columns_of(open_file(file), text_options(given))
    except ReadError as exc:
        if (asked := ask_text(file, given, exc)) is not None:
            raise asked from None


def _question(file: Path, reading: Mapping[str, Any], why: MetrosepError) -> MetrosepError:
    """Return what is to be asked, or the error itself where no answer would help."""
    asked = ask_channel(file, reading, why)
    if asked is not None:
        return asked
    several, words = holds_columns(file, given=reading), str(why).partition(";")[0]
    if not several and (asked := ask_text(file, reading, why)) is not None:
        return asked
    if several and not (isinstance(why, FormatMismatchError) and "x" in reading):
        return ask_columns([file], reading, words)
    if isinstance(why, UnitError):
        return Ask(words, "unit", str(file))
    if holds_columns(file, 1, reading) and "lateral_step" not in reading:
        return Ask(words, "lateral_step", str(file))
    return why


def _why(error: MetrosepError) -> str:
    """Return why something is asked for, without how a call gives a unit: here it has a field."""
    return re.split(r"; (?=[^;]*\w=\()", str(error))[0]


def _kind(obj: Surface | Profile) -> Literal["map", "profile"]:
    return "map" if isinstance(obj, Surface) else "profile"


def _name(file: Path) -> str:
    return f"{file.stem}.toml"
