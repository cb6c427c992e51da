"""The recipe of a session as text: edits, undo and redo, autosave. It is the only state there is.

Comments and the order of keys stay as they were (tomlkit). An edit says what it found and what it
puts there; one that found something else came from an outdated page and is refused.
"""

from __future__ import annotations

import glob
import hashlib
import json
import os
import re
import secrets
import shutil
import tempfile
import threading
import tomllib
from collections.abc import Callable, Iterable, Mapping, Sequence
from contextlib import AbstractContextManager
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Generic, TypeVar, cast

from metrosep.app.view_tables import view_of, with_view
from metrosep.core.atomic import atomic_write
from metrosep.core.errors import DataError, MetrosepError, ReadError, WriteError
from metrosep.core.inside import reading_inside
from metrosep.core.readable import said_value
from metrosep.core.units import with_px
from metrosep.recipe.recipe import Recipe
from metrosep.recipe.written.extends import Admits

_DEEPEST = 200
"""Edits that can be undone."""

_FEWEST_FEEDS = 2
"""Feedrates that the joint separation needs."""


@dataclass(frozen=True, slots=True)
class Edit:
    """One change of a recipe."""

    # of (str or int): keys and indices that lead to the value, such as ``("step", 1, "cutoff")``.
    # An index one beyond the end of a list adds to it
    path: tuple[str | int, ...]
    old: Any  # what was there and what shall be: plain values; None where there is nothing
    new: Any

    @classmethod
    def from_message(cls, message: Mapping[str, Any]) -> Edit:
        """Return the edit that a page sends."""
        path = message.get("path")
        if (
            not isinstance(path, list)
            or not path
            or not all(
                isinstance(p, str | int) and not isinstance(p, bool) and (p != "" and p != -1)
                for p in path
            )
            or not isinstance(path[0], str)
        ):
            raise DataError(f"an edit needs a path of keys and indices, got {said_value(path)}")
        return cls(tuple(path), message.get("old"), message.get("new"))


def start_text(file: str, kind: str, reading: Mapping[str, Any] | None = None) -> str:
    """Return the recipe that a session starts with for a file.

    Examples
    --------
    >>> "[[step]]" in start_text("part.sdf", "map")
    True
    """
    form = "plane" if kind == "map" else "polynomial: degree=1"
    steps = ({"op": "form", "form": form}, {"op": "parameters"})
    return _started([file], reading or {}, steps)


def start_runs_text(
    files: Sequence[str], reading: Mapping[str, Any], feeds: int | None = None
) -> str:
    """Return the recipe that a session starts with for repeated runs.

    Notes
    -----
    The joint separation tells vibration from geometry by at least two feedrates, of a column or
    from time. Without feed and time, or with one feed for all runs, the mean is what can be had.

    Examples
    --------
    >>> reading = {"x": "x_mm", "z": "z_um"}
    >>> "joint" in start_runs_text(["runs.csv"], {**reading, "feed": "feed_mm_min"})
    True
    >>> "joint" in start_runs_text(["runs.csv"], reading)
    False
    """
    several = _may_tell_feeds(reading) if feeds is None else feeds >= _FEWEST_FEEDS
    step = {"op": "separate", "method": "joint" if several else "mean"}
    return _started(list(files), reading, (step,))


def start_traces_text(files: Sequence[str], reading: Mapping[str, Any]) -> str:
    """Return the recipe that a session starts with for roundness traces.

    Examples
    --------
    >>> 'op = "roundness"' in start_traces_text(["t.csv"], {"angle": "a_deg", "radius": "r_um"})
    True
    """
    return _started(list(files), reading, ({"op": "roundness"},))


def _may_tell_feeds(reading: Mapping[str, Any]) -> bool:
    """Whether runs read so may have several feedrates: one value for all is one."""
    feed = reading.get("feed")
    if isinstance(feed, list):
        return len({str(one) for one in feed}) >= _FEWEST_FEEDS
    if isinstance(feed, str):
        return feed.strip()[:1] not in "0123456789.+-"
    if isinstance(feed, int | float):
        return False
    return feed is not None or "time" in reading or "sampling_rate" in reading


def _started(
    files: list[str], reading: Mapping[str, Any], chosen: Sequence[Mapping[str, Any]]
) -> str:
    import tomlkit

    made = tomlkit.document()
    made.add("metrosep", tomlkit.item(1))
    made.add("title", tomlkit.item(Path(files[0]).stem))
    table = tomlkit.table()
    table.add("files", files)
    for key, value in reading.items():
        table.add(key, value)
    made.add("input", table)
    steps = tomlkit.aot()
    for step in chosen:
        entry = tomlkit.table()
        for key, value in step.items():
            entry.add(key, value)
        steps.append(entry)
    made.add("step", steps)
    return str(tomlkit.dumps(made))


class RecipeDocument:
    """The text of a recipe with its history of edits."""

    def __init__(
        self,
        text: str,
        folder: Path | str = ".",
        name: str = "recipe.toml",
        admits: Admits | None = None,
    ) -> None:
        self.folder = Path(folder)
        self.name = name
        self.admits = admits
        self._recipe = Recipe.parse(text, name=name, folder=self.folder, admits=admits)
        self._text = text
        self._undone: list[tuple[str, str]] = []
        self._done: list[tuple[str, str]] = []

    @property
    def text(self) -> str:
        """The recipe as it is."""
        return self._text

    @property
    def recipe(self) -> Recipe:
        """It, checked."""
        return self._recipe

    @property
    def undo_label(self) -> str | None:
        """What undo would take back."""
        return self._done[-1][0] if self._done else None

    @property
    def redo_label(self) -> str | None:
        """What redo would do again."""
        return self._undone[-1][0] if self._undone else None

    @property
    def history(self) -> tuple[list[tuple[str, str]], list[tuple[str, str]]]:
        """What can be undone and redone: labels, and the recipes before and after."""
        return list(self._done), list(self._undone)

    def remember(self, history: Sequence[Sequence[Sequence[str]]]) -> None:
        """Take a history up again; each recipe in it is checked when it is gone back to."""
        self._done, self._undone = ([(str(a), str(b)) for a, b in part] for part in history)

    def edit(self, edits: Sequence[Edit], label: str | None = None) -> None:
        """Carry edits out, as one that can be undone."""
        import tomlkit

        if not edits:
            raise DataError("nothing to edit")
        made = tomlkit.parse(self._text)
        for edit in edits:
            _apply(made, edit)
        text = str(tomlkit.dumps(made))
        if text == self._text:
            return
        before = self._text
        self._replace(text)
        self._done.append((label or _label(edits[0]), before))
        del self._done[:-_DEEPEST]
        self._undone.clear()

    def _replace(self, text: str) -> None:
        recipe = Recipe.parse(text, name=self.name, folder=self.folder, admits=self.admits)
        self._text, self._recipe = text, recipe

    def undo(self) -> None:
        """Take the last edit back."""
        self._swap(self._done, self._undone, "undo")

    def copy(self) -> RecipeDocument:
        """Return a document of its own with the same text and history."""
        made = object.__new__(RecipeDocument)
        made.folder, made.name, made.admits = self.folder, self.name, self.admits
        made._take(self)
        return made

    def anew(self) -> RecipeDocument:
        """Return a document of its own with the same text and nothing to undo."""
        return RecipeDocument(self._text, self.folder, self.name, self.admits)

    def adopt(self, other: RecipeDocument) -> None:
        """Take over text and history of a copy."""
        self._take(other)

    def _take(self, other: RecipeDocument) -> None:
        self._text, self._recipe = other._text, other._recipe
        self._done, self._undone = list(other._done), list(other._undone)

    def rename(self, name: str) -> None:
        """Give the recipe the name of the file that it was saved as."""
        self.name = name
        self._replace(self._text)

    def show(self, view: Mapping[str, Any]) -> None:
        """Keep what the page shows in ``[view]``; it is not an edit and cannot be undone."""
        self._replace(with_view(self._text, view))

    def redo(self) -> None:
        """Do the last edit again that was taken back."""
        self._swap(self._undone, self._done, "redo")

    def _swap(
        self, source: list[tuple[str, str]], target: list[tuple[str, str]], verb: str
    ) -> None:
        if not source:
            raise DataError(f"there is nothing to {verb}")
        label, text = source[-1]
        now = self._text
        self._replace(with_view(text, view_of(now)))  # what is shown is not an edit
        source.pop()  # not before: what the recipe builds on may be gone, and come back
        target.append((label, now))

    def save(self, path: Path, *, write: Callable[[Path, bytes], Any] = atomic_write) -> Path:
        """Write the recipe, whole or not at all."""
        write(path, self._text.encode("utf-8"))
        return path


def _apply(made: Any, edit: Edit) -> None:
    holder = made
    for i, key in enumerate(edit.path[:-1]):
        holder = _inside(holder, key, edit, create=_fresh(edit.path[i + 1]))
    key = edit.path[-1]
    found = _plain(holder, key)
    if found != edit.old:
        raise DataError(
            f"{_words(edit.path)} is {_stored(found)}, the page took it for {_stored(edit.old)}: reload the page"
        )
    if edit.new is None:
        _remove(holder, key)
    elif isinstance(key, int) and key == len(holder):
        holder.append(_item(edit.new, in_tables=hasattr(holder, "body") or _holds_tables(holder)))
    else:
        holder[key] = _item(edit.new, in_tables=isinstance(key, int) and _holds_tables(holder))


def _stored(value: Any) -> str:
    """Return what a recipe holds at a place, as it stands there."""
    from metrosep.recipe.written.overrides import toml_text

    return "nothing" if value is None else toml_text(value)


def _fresh(next_key: str | int) -> Callable[[], Any]:
    import tomlkit

    return tomlkit.aot if isinstance(next_key, int) else tomlkit.table


def _inside(holder: Any, key: str | int, edit: Edit, *, create: Callable[[], Any]) -> Any:
    if isinstance(key, str) and isinstance(holder, Mapping):
        if key not in holder:
            if edit.new is None:
                raise DataError(f"there is no {_words(edit.path)} to remove: reload the page")
            cast("Any", holder)[key] = create()
        return holder[key]
    if isinstance(key, int) and isinstance(holder, Sequence) and 0 <= key < len(holder):
        return holder[key]
    raise DataError(f"{_words(edit.path)} leads nowhere in the recipe: reload the page")


def _plain(holder: Any, key: str | int) -> Any:
    if isinstance(key, str):
        if not isinstance(holder, Mapping):
            raise DataError(f"{key!r} leads nowhere in the recipe: reload the page")
        found = holder.get(key)
    else:
        if (
            not isinstance(holder, Sequence)
            or isinstance(holder, str)
            or not 0 <= key <= len(holder)
        ):
            raise DataError(f"index {key} leads nowhere in the recipe: reload the page")
        found = holder[key] if key < len(holder) else None
    return cast("Any", found).unwrap() if hasattr(found, "unwrap") else found


def _holds_tables(holder: Any) -> bool:
    return type(holder).__name__ == "AoT"


def _item(value: Any, *, in_tables: bool) -> Any:
    import tomlkit

    if isinstance(value, Mapping):
        made = tomlkit.table() if in_tables else tomlkit.inline_table()
        for key, inner in value.items():
            made[str(key)] = _item(inner, in_tables=False)
        return made
    try:
        tomllib.loads(f"x = {tomlkit.item(value).as_string()}")
    except (TypeError, ValueError) as exc:
        raise DataError(f"{value!r} is not a value of a recipe ({exc})") from None
    return tomlkit.item(value)


def _remove(holder: Any, key: str | int) -> None:
    try:
        del holder[key]
    except (KeyError, IndexError):
        raise DataError(f"there is no {key!r} to remove: reload the page") from None


def _words(path: tuple[str | int, ...]) -> str:
    return " > ".join(str(p + 1) if isinstance(p, int) else p for p in path)


def _label(edit: Edit) -> str:
    verb = "remove" if edit.new is None else "add" if edit.old is None else "change"
    return f"{verb} {_words(edit.path)}"


# ---- where results may be written: never onto what is open, never from files that changed meanwhile ----


@dataclass(frozen=True, slots=True)
class Stamp:
    """What tells that a file is the one that was opened."""

    file: Path  # the file
    size: int  # bytes
    mtime_ns: int  # nanoseconds: when it was written
    sha256: str = ""  # digest of what was read; empty where it is not known


def stamps_of(files: Iterable[Path]) -> tuple[Stamp, ...]:
    """Return what tells files from later ones of their names; taken before they are read."""
    made = []
    for file in files:
        try:
            found = file.stat()
        except OSError as exc:
            raise ReadError(f"{file.name}: cannot be read ({exc.strerror or exc})") from None
        made.append(Stamp(file, found.st_size, found.st_mtime_ns))
    return tuple(made)


def with_digests(stamps: Sequence[Stamp], obj: Any) -> tuple[Stamp, ...]:
    """Return stamps with the digest that the history of what was read from a file states."""
    read = [s for s in getattr(obj, "history", ()) if s.name == "read"]
    if len(stamps) != 1 or len(read) != 1:
        return tuple(stamps)
    one, known = stamps[0], read[0].parameters
    if known.get("file") != one.file.name or not known.get("sha256"):
        return tuple(stamps)
    return (Stamp(one.file, one.size, one.mtime_ns, str(known["sha256"])),)


def refuse_changed(stamps: Iterable[Stamp]) -> None:
    """Refuse to write what was made of files that are others now.

    Notes
    -----
    Where the digest is known it decides: a copy with the same content is the same file.
    """
    for stamp in stamps:
        try:
            found = stamp.file.stat()
            same = (found.st_size, found.st_mtime_ns) == (stamp.size, stamp.mtime_ns)
            if stamp.sha256:
                with stamp.file.open("rb") as file:
                    same = hashlib.file_digest(file, "sha256").hexdigest() == stamp.sha256
        except OSError:
            same = False
        if not same:
            raise WriteError(f"{stamp.file.name} changed since it was opened; open it again")


def refuse_open(target: Path, opened: Any, *, recipe: bool = False) -> None:
    """Refuse to write onto what is open: its files, its recipe, its session."""
    if target in opened.files or any(_same(target, f) for f in opened.files):
        raise WriteError(
            f"{target.name}: is the measurement that is open, and stays as it is; choose another name"
        )
    if _same(target, opened.kept):
        raise WriteError(
            f"{target.name}: is the session that is kept for what is open; choose another name"
        )
    if not _same(target, opened.home):
        return
    if not recipe:
        raise WriteError(f"{target.name}: is the recipe that is open; choose another name")
    if opened.base and hashlib.sha256(target.read_bytes()).hexdigest() != opened.base:
        raise WriteError(
            f"{target.name} changed since it was opened; choose another name, or open it again"
        )


def _same(target: Path, other: Path) -> bool:
    """Whether two names are of one file, be it by a link."""
    if target == other:
        return True
    try:
        return target.samefile(other)
    except OSError:
        return False


def refuse_other_result(folder: Path) -> None:
    """Refuse a folder whose result.json is not of metrosep: it would be replaced."""
    from metrosep.recipe.preflight import RESULT_NAME
    from metrosep.recipe.result import load_document

    there = folder / RESULT_NAME
    if not there.exists():
        return
    try:
        load_document(there)
    except MetrosepError:
        raise WriteError(
            f"{folder.name}: holds a {RESULT_NAME} that is not of metrosep, and it would be replaced; "
            "choose another folder"
        ) from None


# ---- which files the workbench may touch: those under folders that the user opened, and uploads ----

_SET = re.compile(r"[A-Za-z0-9]{1,40}")
_NAME = re.compile(r"[^/\\\0]{1,200}")


class Places:
    """Folders that were opened, and a folder for uploads that goes with the session."""

    def __init__(self, folders: list[Path], largest_upload: int = 4_000_000_000) -> None:
        self._roots = [Path(os.path.realpath(f)) for f in folders]
        self.largest_upload = largest_upload
        self._uploads: Path | None = None

    @property
    def roots(self) -> tuple[Path, ...]:
        """Folders that may be read and written."""
        own = () if self._uploads is None else (self._uploads,)
        return (*self._roots, *own)

    def guarding(self) -> AbstractContextManager[None]:
        """Refuse meanwhile to read through links that lead out of the opened folders."""
        return reading_inside(self.roots)

    def add(self, folder: Path) -> None:
        """Open another folder."""
        self._roots.append(Path(os.path.realpath(folder)))

    def readable(self, path: str) -> Path:
        """Return a file inside the opened folders, as is all that may be read beside it."""
        found = self.require_inside(path)
        if not found.is_file():
            other = "this is not a regular file" if found.exists() else "there is no such file"
            raise ReadError(f"{path}: {other}")
        self.require_own(_beside(found))
        return found

    def require_inside(self, path: str) -> Path:
        """Return a path, or a pattern of paths, inside the opened folders."""
        found = self.inside(path)
        if found is None:
            raise ReadError(
                f"{path}: lies outside the folders that were opened ({self._words()}); open it with "
                "'metrosep ui FILE', add its folder with --folder, or drop it onto the page"
            )
        return found

    def require_own(self, files: Iterable[Path]) -> None:
        """Refuse files that are links out of the opened folders."""
        for file in files:
            if file.is_symlink() and self.inside(str(file)) is None:
                raise ReadError(
                    f"{file.name}: is a link that leads out of the folders that were opened; add the "
                    "folder that it leads to with --folder, or put a copy in its place"
                )

    def writable(self, path: str) -> Path:
        """Return where a file may be written."""
        found = self.inside(path)
        if found is None:
            raise WriteError(
                f"{path}: lies outside the folders that were opened ({self._words()}); choose a name "
                "inside them"
            )
        if self.is_upload(found):
            where = f"choose a name in {self._roots[0]}" if self._roots else "start with --folder"
            raise WriteError(
                f"{found.name}: the folder of dropped files goes when metrosep ends, and this with it; "
                f"{where}"
            )
        if not found.parent.is_dir():
            raise WriteError(f"{path}: its folder does not exist; make it first")
        return found

    def is_upload(self, file: Path) -> bool:
        """Return whether a file lies in the folder of uploads, which goes with the session."""
        return self._uploads is not None and file.is_relative_to(self._uploads)

    def target(self, home: Path) -> Path:
        """Return the folder where results of a file go unless the user says otherwise."""
        return self._roots[0] if self.is_upload(home) and self._roots else home.parent

    def inside(self, path: str) -> Path | None:
        """Return a path without symbolic links, if it lies inside the opened folders."""
        if not path or "\0" in path or not self.roots:
            return None
        try:
            found = Path(os.path.realpath(self.roots[0] / path))
            found.exists()
        except (OSError, UnicodeError) as exc:
            why = getattr(exc, "strerror", "") or "its letters are not text"
            raise ReadError(f"{ascii(path[:60])[1:-1]}: cannot be a file here ({why})") from None
        return found if any(found.is_relative_to(root) for root in self.roots) else None

    def admits(self, path: Path) -> bool:
        """Return whether a path that a recipe names lies inside the opened folders."""
        found = self.inside(str(Path.cwd() / path))
        if found is not None:
            self.require_own(_beside(found))
        return found is not None

    def _words(self) -> str:
        return ", ".join(map(str, self.roots)) or "none"

    def upload(self, name: str, together: str = "") -> Path:
        """Return a new place for an uploaded file."""
        last = name.replace("\\", "/").rpartition("/")[2].strip()
        if not _NAME.fullmatch(last) or last in (".", "..") or not last.isprintable():
            raise WriteError(f"{name[:60]!r} is not a file name")
        if self._uploads is None:
            try:
                made = tempfile.mkdtemp(prefix="metrosep-ui-")
            except OSError as exc:
                raise WriteError(
                    f"{last}: there is no room for a copy ({exc.strerror})", exc
                ) from None
            self._uploads = Path(os.path.realpath(made))
        if together and not _SET.fullmatch(together):
            raise WriteError(
                f"{together[:60]!r} is not a name of a set; it has letters and digits only"
            )
        folder = self._uploads / (f"set-{together}" if together else secrets.token_hex(4))
        try:
            folder.mkdir(exist_ok=bool(together))
        except OSError as exc:
            raise WriteError(
                f"{last}: there is no room for a copy ({exc.strerror})", exc
            ) from None
        if (folder / last).exists():
            raise WriteError(
                f"{last}: the set has a file of this name already; rename one of them"
            )
        return folder / last

    def close(self) -> None:
        """Remove the uploads."""
        if self._uploads is not None:
            shutil.rmtree(self._uploads, ignore_errors=True)
            self._uploads = None


def _beside(file: Path) -> Iterable[Path]:
    """Return what may be read with a file: heads of formats, the report, the facts of a table."""
    return file.parent.glob(f"{glob.escape(file.stem)}.*") if file.parent.is_dir() else ()


# ---- what was made of the latest objects, so that it is not made again for the next picture ----

Made = TypeVar("Made")


class Remembered(Generic[Made]):
    """A function of objects that keeps its latest results."""

    def __init__(self, make: Callable[..., Made], most: int = 9) -> None:
        self._make, self._most = make, most
        self._kept: dict[int, tuple[Any, Made]] = {}
        self._lock = threading.Lock()

    def of(self, obj: Any, *rest: Any) -> Made:
        """Return what is made of an object, made once.

        Examples
        --------
        >>> calls = []
        >>> lengths = Remembered(lambda text: calls.append(text) or len(text))
        >>> word = "step"
        >>> lengths.of(word), lengths.of(word), calls
        (4, 4, ['step'])
        """
        with self._lock:
            if id(obj) not in self._kept:
                if len(self._kept) >= self._most:
                    self._kept.clear()
                self._kept[id(obj)] = (obj, self._make(obj, *rest))
            return self._kept[id(obj)][1]

    def clear(self) -> None:
        """Forget everything."""
        with self._lock:
            self._kept.clear()


def text_key(value: Any) -> str:
    """Return what tells values of a recipe apart, as text.

    Examples
    --------
    >>> text_key({"op": "crop", "x": (0.0, 1.0)}) == text_key({"x": [0.0, 1.0], "op": "crop"})
    True
    """
    return json.dumps(_remembered_plain(with_px(value)), sort_keys=True, default=str)


def _remembered_plain(value: Any) -> Any:
    if isinstance(value, Mapping):
        return {str(k): _remembered_plain(v) for k, v in value.items()}
    return [_remembered_plain(v) for v in value] if isinstance(value, list | tuple) else value
