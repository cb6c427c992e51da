"""The recipe of a session as text: edits, undo and redo, autosave. It is the only state there is.

Comments and the order of keys stay as they were (tomlkit). An edit says what it found and what it
puts there; one that found something else came from an outdated page and is refused.
"""

from __future__ import annotations

import tomllib
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, cast

from metrosep.app.view_tables import view_of, with_view
from metrosep.core.atomic import atomic_write
from metrosep.core.errors import DataError
from metrosep.recipe.extends import Admits
from metrosep.recipe.recipe import Recipe

__all__ = ["Edit", "RecipeDocument", "start_runs_text", "start_text"]

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
            raise DataError(f"an edit needs a path of keys and indices, got {path!r}")
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
        """Keep what the page shows in ``[view]``; it is no edit and cannot be undone."""
        self._replace(with_view(self._text, view))

    def redo(self) -> None:
        """Do the last edit again that was taken back."""
        self._swap(self._undone, self._done, "redo")

    def _swap(
        self, source: list[tuple[str, str]], target: list[tuple[str, str]], verb: str
    ) -> None:
        if not source:
            raise DataError(f"there is nothing to {verb}")
        label, text = source.pop()
        now = self._text
        self._replace(with_view(text, view_of(now)))  # what is shown is no edit
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
            f"{_words(edit.path)} is {found!r}, the page took it for {edit.old!r}: reload the page"
        )
    if edit.new is None:
        _remove(holder, key)
    elif isinstance(key, int) and key == len(holder):
        holder.append(_item(edit.new, in_tables=hasattr(holder, "body") or _holds_tables(holder)))
    else:
        holder[key] = _item(edit.new, in_tables=isinstance(key, int) and _holds_tables(holder))


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
        raise DataError(f"{value!r} is no value of a recipe ({exc})") from None
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
