"""``extends``: a recipe that builds on another one; keys of the nearer recipe win.

Tables such as ``[input]`` are merged key by key; ``[[step]]``, ``[[check]]`` and ``[[output]]`` are
replaced whole, never merged. The recipes built on are kept as comments behind the own text, so that
the recipe in a result document stands alone.
"""

from __future__ import annotations

import os
import re
import tomllib
from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, TypeAlias

from metrosep.core.atomic import RECIPE_BYTES, read_plain_text
from metrosep.core.errors import RecipeError
from metrosep.recipe.schema import Place

_MARK = "# ==== built on (recorded when it ran; delete from here on to read the files again) ===="
_NAME, _LINE = "#: ", "#| "
_FILE, _SEEN = "#> ", "#@ "
"""A file that a step of a recipe in another folder names, and its name from the nearest recipe."""

_BYTE_ORDER_MARK = "\ufeff"
"""Some editors write it in front of a text in UTF-8."""

_MOST = 8

Admits: TypeAlias = Callable[[Path], bool]
"""Whether a path may be read."""

_TABLES = ("input", "batch", "view")


@dataclass(frozen=True, slots=True)
class LayeredPlace(Place):
    """Where a table stands in a recipe or in one that it builds on."""

    # of (str, str): name and text of each recipe below, the nearest first
    bases: tuple[tuple[str, str], ...] = ()

    def error(self, problem: str, key: str | None = None) -> RecipeError:
        """Return the error for a problem at a key, with file and line."""
        each = [Place(n, t, self.header, self.number) for n, t in self._all()]
        holding = [p for p in each if p.line_of(None) is not None] if self.header else each
        having = [p for p in holding if key is not None and p.line_of(key) != p.line_of(None)]
        place = (having or holding or each)[0]
        return as_given(place.error(problem, key), place.file, place.text, problem)

    def _all(self) -> tuple[tuple[str, str], ...]:
        return ((self.file, self.text), *self.bases)


@dataclass(frozen=True, slots=True)
class _Base:
    """A recipe below: where it lies and which texts of its steps are files there."""

    name: str
    text: str
    files: Mapping[str, str] = field(default_factory=dict)

    def record(self) -> list[str]:
        """Return the lines of the record; every line of the text as it stands."""
        lines = [f"{_NAME}{self.name}"]
        for name, seen in self.files.items():
            lines += [f"{_FILE}{name}", f"{_SEEN}{seen}"]
        text = self.text.removesuffix("\n").split("\n")
        return lines + [f"{_LINE}{line}" if line else _LINE.rstrip() for line in text]

    def data(self) -> dict[str, Any]:
        """Return what TOML holds, names of files starting at the folder of the nearest recipe."""
        parsed = _parsed(self.text, self.name)
        for step, key in _file_keys(parsed):
            step[key] = self.files.get(step[key], step[key])
        return parsed


@dataclass(frozen=True, slots=True)
class Layers:
    """A recipe with what it builds on."""

    data: Mapping[str, Any]  # mapping: what TOML holds, merged
    text: str  # the own text, and behind it the others as comments
    # of (str, str): name and text of each recipe below, the nearest first
    bases: tuple[tuple[str, str], ...]


def split_record(text: str) -> tuple[str, tuple[tuple[str, str], ...]]:
    """Return the own text of a recipe, and what it recorded of those it builds on."""
    own, bases = _split(text)
    return own, tuple((b.name, b.text) for b in bases)


def before_record(text: str) -> int:
    """Return where the own text of a recipe ends."""
    found = text.find("\n" + _MARK + "\n")
    return len(text) if found < 0 else found


def texts_of(text: str) -> list[str]:
    """Return the text of a recipe, and of each that it builds on, from one with its record."""
    own, bases = _split(text)
    return [own, *(b.text for b in bases)]


def with_texts(text: str, texts: Sequence[str], here: Collection[tuple[int, str]] = ()) -> str:
    """Return a recipe with other texts in place of its own and of those that it builds on."""
    _, bases = _split(text)
    made = [
        replace(b, text=t, files={n: s for n, s in b.files.items() if (k, n) not in here})
        for k, (b, t) in enumerate(zip(bases, texts[1:], strict=True), 1)
    ]
    return texts[0] + _record(made)


def _split(text: str) -> tuple[str, tuple[_Base, ...]]:
    own, mark, record = text.partition("\n" + _MARK + "\n")
    if not mark:
        return text, ()
    found: list[tuple[str, dict[str, list[str]]]] = []
    for line in record.split("\n"):
        start = line[: len(_LINE)]
        if start == _NAME:
            found.append((line.removeprefix(_NAME), {_LINE: [], _FILE: [], _SEEN: []}))
        elif found and line == _LINE.rstrip():
            found[-1][1][_LINE].append("")
        elif found and start in found[-1][1]:
            found[-1][1][start].append(line.removeprefix(start))
    return own, tuple(
        _Base(
            name, "\n".join(kept[_LINE]) + "\n", dict(zip(kept[_FILE], kept[_SEEN], strict=False))
        )
        for name, kept in found
    )


def layers_of(text: str, name: str, folder: Path, admits: Admits | None = None) -> Layers:
    """Return a recipe merged with those that it extends."""
    own, recorded = _split(text.removeprefix(_BYTE_ORDER_MARK))
    chain: list[tuple[str, str, dict[str, Any]]] = [(name, own, _parsed(own, name))]
    below: list[_Base] = []
    seen = {(folder / name).resolve()}
    place_of = folder
    while "extends" in chain[-1][2]:
        above, above_text, above_data = chain[-1]
        place = Place(above, above_text)
        wanted = above_data["extends"]
        if not isinstance(wanted, str) or not wanted:
            raise place.error('extends = "other.toml": the name of a recipe is needed', "extends")
        if len(chain) > _MOST:
            raise place.error(f"more than {_MOST} recipes build on one another", "extends")
        if recorded:
            if len(chain) > len(recorded):
                raise place.error(f'extends = "{wanted}": the record lacks it', "extends")
            base = recorded[len(chain) - 1]
            below.append(base)
            chain.append((base.name, base.text, base.data()))
            continue
        target = place_of / wanted
        if "\0" in wanted:
            raise place.error('extends = "...": the name of a recipe has no NUL in it', "extends")
        if admits is not None and not admits(target):
            raise place.error(
                f'extends = "{wanted}": it lies outside the folders that were opened; open its folder '
                "too (--folder), or copy the recipe beside this one",
                "extends",
            )
        if target.resolve() in seen:
            raise place.error(
                f'extends = "{wanted}": the recipes extend one another in a circle; remove this key, or name another',
                "extends",
            )
        seen.add(target.resolve())
        place_of = target.parent
        text_there = _read(target, wanted, place).removesuffix("\n") + "\n"
        base = _base_of(target, text_there, folder)
        below.append(base)
        chain.append((base.name, base.text, base.data()))
    merged = dict(chain[-1][2])
    for _, _, nearer in reversed(chain[:-1]):
        merged = _merged(merged, nearer)
    merged.pop("extends", None)
    bases = tuple((b.name, b.text) for b in below)
    return Layers(merged, own + _record(below), bases)


def _merged(base: Mapping[str, Any], nearer: Mapping[str, Any]) -> dict[str, Any]:
    result = {**base, **nearer}
    for table in _TABLES:
        below, above = base.get(table), nearer.get(table)
        if isinstance(below, dict) and isinstance(above, dict):
            result[table] = {**below, **above}
    return result


def _record(bases: Sequence[_Base]) -> str:
    if not bases:
        return ""
    lines = ["", _MARK, *(line for base in bases for line in base.record())]
    return "\n".join(lines) + "\n"


def _parsed(text: str, name: str) -> dict[str, Any]:
    try:
        return tomllib.loads(text)
    except (ValueError, RecursionError) as exc:
        raise RecipeError(f"{name}: not valid TOML: {toml_problem(exc)}") from None


def _read(target: Path, wanted: str, place: Place) -> str:
    try:
        return read_plain_text(target, RECIPE_BYTES).removeprefix(_BYTE_ORDER_MARK)
    except OSError as exc:
        reason = exc.strerror or exc
        raise place.error(
            f'extends = "{wanted}": that recipe cannot be read ({reason}); its name starts at the '
            "folder of this one",
            "extends",
        ) from None


def _base_of(target: Path, text: str, folder: Path) -> _Base:
    """Return a recipe below with the files in its folder, where that is not the nearest one's."""
    home = target.parent
    if home.resolve() == folder.resolve():
        return _Base(target.name, text)
    named = (str(step[key]) for step, key in _file_keys(_parsed(text, target.name)))
    near = [n for n in named if not Path(n).is_absolute() and (home / n).exists()]
    seen = {n: Path(os.path.relpath(home / n, folder)).as_posix() for n in near}
    return _Base(target.name, text, seen)


def _file_keys(data: Mapping[str, Any]) -> Iterator[tuple[dict[str, Any], str]]:
    """Give each step and key that may name a file."""
    from metrosep.core.methods import METHODS

    steps = data.get("step")
    for step in steps if isinstance(steps, list) else ():
        method = METHODS.get(str(step.get("op"))) if isinstance(step, dict) else None
        for key, known in method.fields.items() if method is not None else ():
            if known.kind == "file" and isinstance(step.get(key), str):
                yield step, key


# ---- what a line says of the override that made it: ``# set by -s step.2.degree=5`` ------------
# A line that is new says ``added`` in place of ``set``. So each line is still called by its number in
# the file, and a result knows from the text alone what was overridden.

_OVERRIDE = re.compile(r"  # (set|added) by -s (.*?)(?=  # (?:set|added) by -s |$)")
_BEGIN = re.compile(r"  # (set|added) by -s")
_PIECE = re.compile(r'"[^"]*"|\'[^\']*\'|[^."\']+')


@dataclass(frozen=True, slots=True)
class Mark:
    """What a line says of the override that made it."""

    line: int  # its number in the text, from 1
    is_added: bool  # whether the file has no such line
    given: str  # the override, as it was given


def split_override(given: str) -> tuple[str, str] | None:
    """Return key and value of an override.

    Examples
    --------
    >>> split_override('check."a=b".upper = 12 nm')
    ('check."a=b".upper', '12 nm')
    """
    found = re.match(r'((?:"[^"]*"|\'[^\']*\'|[^="\'])+)=(.*)', given, re.DOTALL)
    if found is None or not found[1].strip():
        return None
    return found[1].strip(), found[2].strip()


def key_parts(key: str) -> list[str] | None:
    """Return the parts of a dotted key; a part that holds a dot is written in quotes.

    Examples
    --------
    >>> key_parts('check."P-V 1.5".upper'), key_parts("step..degree")
    (['check', 'P-V 1.5', 'upper'], None)
    """
    pieces = _PIECE.findall(key)
    parts = [p[1:-1] if p[0] in "\"'" else p.strip() for p in pieces]
    return parts if all(parts) and ".".join(pieces) == key else None


def marks_after(comment: str, given: str) -> str:
    """Return the marks of a line that was changed: one for each key."""
    key = (split_override(given) or ("",))[0]
    kept, kind = [], "set"
    for found in _OVERRIDE.finditer(comment):
        if (split_override(found[2]) or ("",))[0] == key:
            kind = found[1]
        else:
            kept.append(found[0])
    return "".join([*kept, f"  # {kind} by -s {given}"])


def parsed(text: str) -> dict[str, Any] | None:
    """Return what TOML holds."""
    try:
        return tomllib.loads(text)
    except (ValueError, RecursionError):  # also numbers of thousands of digits
        return None


def toml_problem(error: Exception) -> str:
    """Return why `tomllib` could not read a text.

    Examples
    --------
    >>> toml_problem(RecursionError())
    'it is nested too deeply'
    """
    if isinstance(error, RecursionError):
        return "it is nested too deeply"
    if isinstance(error, tomllib.TOMLDecodeError):
        return str(error)
    return "a whole number has thousands of digits"


def holds_mark(given: str) -> bool:
    """Return whether an override holds the words that begin a mark, and could not be distinguished from it.

    Examples
    --------
    >>> holds_mark("title=a  # set by -s title=b"), holds_mark("title=a # set by -s title=b")
    (True, False)
    """
    return _BEGIN.search(given) is not None


def without_marks(comment: str) -> str:
    """Return the comment of a line without marks."""
    return _OVERRIDE.sub("", comment)


def marks_of(text: str) -> list[Mark]:
    """Return the marks of a text."""
    return [
        Mark(i + 1, found[1] == "added", found[2])
        for i, line in enumerate(text.split("\n"))
        for found in _OVERRIDE.finditer(line.rstrip("\r"))
    ]


def as_given(error: RecipeError, file: str, text: str, problem: str) -> RecipeError:
    """Return the error of a line as a person finds it, who has the file and gave the overrides."""
    line = error.line
    marks = [] if line is None else marks_of(text)
    if line is None or not marks:
        return error
    given = " -s ".join(m.given for m in marks if m.line == line)
    if given:
        return RecipeError(f"{file}, -s {given}: {problem}", key=error.key, table=error.table)
    line -= sum(m.is_added and m.line < line for m in marks)
    return RecipeError(f"{file}:{line}: {problem}", key=error.key, line=line, table=error.table)


def overrides_in(text: str) -> tuple[str, ...]:
    """Return what was overridden in a recipe.

    Examples
    --------
    >>> overrides_in("metrosep = 1  # set by -s metrosep=1")
    ('metrosep=1',)
    >>> overrides_in("metrosep = 3  # set by -s metrosep=1")
    ()
    """
    lines = text.split("\n")
    found = [m.given for m in marks_of(text) if _holds(lines[m.line - 1], m.given)]
    return tuple(dict.fromkeys(found))


def _holds(line: str, given: str) -> bool:
    pair, data = split_override(given), parsed(line.removeprefix(_LINE))
    parts = None if pair is None else key_parts(pair[0])
    if pair is None or parts is None or not data:
        return False
    read = parsed(f"v = {pair[1]}")
    for start in range(len(parts)):
        held: Any = data
        for key in parts[start:]:
            held = held.get(key) if isinstance(held, Mapping) else None
        if held is not None:
            return held == pair[1] or (read is not None and held == read["v"])
    return any(isinstance(v, list) for v in data.values())  # steps in one line
