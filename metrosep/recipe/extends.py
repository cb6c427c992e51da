"""``extends``: a recipe that builds on another one; keys of the nearer recipe win.

Tables such as ``[input]`` are merged key by key; ``[[step]]``, ``[[check]]`` and ``[[output]]`` are
replaced whole, never merged. The recipes built on are kept as comments behind the own text, so that
the recipe in a result document stands alone.
"""

from __future__ import annotations

import os
import tomllib
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from metrosep.core.errors import RecipeError
from metrosep.recipe.schema import Place

__all__ = ["LayeredPlace", "Layers", "layers_of", "split_record"]

_MARK = "# ==== built on (recorded when it ran; delete from here on to read the files again) ===="
_NAME, _LINE = "#: ", "#| "
_MOST = 8
_TABLES = ("input", "batch", "view")


@dataclass(frozen=True, slots=True)
class LayeredPlace(Place):
    """Where a table stands in a recipe or in one that it builds on.

    Parameters
    ----------
    file, text : str
        Name and text of the nearest recipe.
    header : str
        Header such as ``[input]``; empty for the top.
    number : int
        Which of the equal headers, from 0.
    bases : tuple of (str, str)
        Name and text of each recipe below, the nearest first.
    """

    bases: tuple[tuple[str, str], ...] = ()

    def error(self, problem: str, key: str | None = None) -> RecipeError:
        """Return the error for a problem at a key, with file and line.

        Parameters
        ----------
        problem : str
            What is wrong and what would be right.
        key : str, optional
            The key.

        Returns
        -------
        RecipeError
            To be raised; it names the nearest recipe that holds the key.
        """
        each = [Place(n, t, self.header, self.number) for n, t in self._all()]
        holding = [p for p in each if p.line_of(None) is not None] if self.header else each
        having = [p for p in holding if key is not None and p.line_of(key) != p.line_of(None)]
        return (having or holding or each)[0].error(problem, key)

    def _all(self) -> tuple[tuple[str, str], ...]:
        return ((self.file, self.text), *self.bases)


@dataclass(frozen=True, slots=True)
class Layers:
    """A recipe with what it builds on.

    Parameters
    ----------
    data : mapping
        What TOML holds, merged.
    text : str
        The own text, and behind it the others as comments.
    bases : tuple of (str, str)
        Name and text of each recipe below, the nearest first.
    """

    data: Mapping[str, Any]
    text: str
    bases: tuple[tuple[str, str], ...]


def split_record(text: str) -> tuple[str, tuple[tuple[str, str], ...]]:
    """Return the own text of a recipe, and what it recorded of those it builds on.

    Parameters
    ----------
    text : str
        Of a recipe, perhaps from a result document.

    Returns
    -------
    own : str
        Without the record.
    bases : tuple of (str, str)
        Name and text; empty where nothing is recorded.
    """
    own, mark, record = text.partition("\n" + _MARK + "\n")
    if not mark:
        return text, ()
    found: list[tuple[str, list[str]]] = []
    for line in record.splitlines():
        if line.startswith(_NAME):
            found.append((line.removeprefix(_NAME), []))
        elif line.startswith(_LINE.rstrip()) and found:
            found[-1][1].append(line.removeprefix(_LINE) if line != _LINE.rstrip() else "")
    return own, tuple((name, "\n".join(lines) + "\n") for name, lines in found)


def layers_of(text: str, name: str, folder: Path) -> Layers:
    """Return a recipe merged with those that it extends.

    Parameters
    ----------
    text : str
        TOML of the recipe.
    name : str
        Its name, for messages.
    folder : Path
        Where names of recipes start.

    Returns
    -------
    Layers
        Merged data, full text, what it builds on.

    Raises
    ------
    RecipeError
        If a text is not TOML, a recipe that is named cannot be read, or one extends itself.
    """
    own, recorded = split_record(text)
    data = _parsed(own, name)
    chain: list[tuple[str, str, dict[str, Any]]] = [(name, own, data)]
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
            base_name, base = recorded[len(chain) - 1]
            chain.append((base_name, base, _parsed(base, base_name)))
            continue
        target = place_of / wanted
        if target.resolve() in seen:
            raise place.error(f'extends = "{wanted}": it comes back to itself', "extends")
        seen.add(target.resolve())
        base = _read(target, wanted, place)
        place_of = target.parent
        below = _parsed(base, target.name)
        _move_files(below, place_of, folder)
        chain.append((target.name, base, below))
    bases = tuple((n, t) for n, t, _ in chain[1:])
    merged = dict(chain[-1][2])
    for _, _, nearer in reversed(chain[:-1]):
        merged = _merged(merged, nearer)
    merged.pop("extends", None)
    return Layers(merged, own + _record(bases), bases)


def _merged(base: Mapping[str, Any], nearer: Mapping[str, Any]) -> dict[str, Any]:
    result = {**base, **nearer}
    for table in _TABLES:
        below, above = base.get(table), nearer.get(table)
        if isinstance(below, dict) and isinstance(above, dict):
            result[table] = {**below, **above}
    return result


def _record(bases: tuple[tuple[str, str], ...]) -> str:
    if not bases:
        return ""
    lines = ["", _MARK]
    for name, text in bases:
        lines.append(f"{_NAME}{name}")
        lines += [f"{_LINE}{line}".rstrip() for line in text.splitlines()]
    return "\n".join(lines) + "\n"


def _parsed(text: str, name: str) -> dict[str, Any]:
    try:
        return tomllib.loads(text)
    except tomllib.TOMLDecodeError as exc:
        raise RecipeError(f"{name}: not valid TOML: {exc}") from None


def _read(target: Path, wanted: str, place: Place) -> str:
    try:
        return target.read_text(encoding="utf-8")
    except (OSError, UnicodeDecodeError) as exc:
        reason = getattr(exc, "strerror", None) or exc
        raise place.error(
            f'extends = "{wanted}": that recipe cannot be read ({reason}); its name starts at the '
            "folder of this one",
            "extends",
        ) from None


def _move_files(data: dict[str, Any], home: Path, folder: Path) -> None:
    """Let names of files in steps of a recipe in another folder start where the nearest one lies."""
    from metrosep.recipe.methods import METHODS

    if home.resolve() == folder.resolve() or not isinstance(data.get("step"), list):
        return
    for step in data["step"]:
        method = METHODS.get(str(step.get("op"))) if isinstance(step, dict) else None
        for key, field in method.fields.items() if method is not None else ():
            value = step.get(key)
            if field.kind == "file" and isinstance(value, str) and (home / value).exists():
                step[key] = Path(os.path.relpath(home / value, folder)).as_posix()
