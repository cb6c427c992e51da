"""What a file does not say and the user must: its unit, or which of its columns is what."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from metrosep.core.errors import DataError, MetrosepError, ReadError

__all__ = ["COLUMNS", "Ask", "ask_columns", "holds_columns"]

COLUMNS = frozenset({"x", "z", "feed", "run", "direction", "time", "scale", "sampling_rate"})
"""Options that choose columns of text; x and z alone choose those of one profile."""

_LABELS = {
    "x": "Position",
    "z": "Reading (+: towards + of the compensated axis)",
    "feed": "Feedrate: a column, or a value such as 7200 mm/min; empty where there is none",
    "run": "Column that tells the runs apart; empty where each file is one run",
    "time": "Time; empty where there is none",
    "scale": "Sensitivity where the reading is a voltage, such as 2.5 um/V",
}
_NAMES = {
    "x": r"(x|y|z|pos(ition)?|encoder|distance|travel)",
    "z": r"(z|e|err(or)?|probe\w*|reading|height|straightness|dev(iation)?|sensor\w*|cap\w*)",
    "feed": r"(feed\w*|f|speed|velocity)",
    "run": r"(run|repeat|pass|trace|no)",
    "time": r"(t|time|clock)",
}
_FEWEST = 2


class Ask(DataError):  # noqa: N818
    """The file does not say something that the user must.

    Parameters
    ----------
    message : str
        As the command line would say it.
    name : str
        Option of the reader, or ``"columns"``.
    path : str
        The file.
    fields : sequence of mapping, optional
        What is asked for, where it is more than the one option: ``name``, ``label``, ``value``,
        ``choices``, ``hint``.
    """

    def __init__(
        self, message: str, name: str, path: str, fields: Sequence[Mapping[str, Any]] = ()
    ) -> None:
        super().__init__(message)
        self.name, self.path, self.fields = name, path, tuple(dict(f) for f in fields)


def holds_columns(file: Path, fewest: int = _FEWEST) -> bool:
    """Return whether a file holds several columns of numbers, of text or of a recording.

    Parameters
    ----------
    file : Path
        Any file.
    fewest : int, optional
        How many are meant.

    Returns
    -------
    bool
        False where it is a map, one column, or cannot be read as columns.
    """
    try:
        return len(_numbers(file)) >= fewest
    except MetrosepError:
        return False


def ask_columns(files: Sequence[Path], given: Mapping[str, Any], why: str) -> Ask:
    """Return the question which column is what, with guesses that the user confirms.

    Parameters
    ----------
    files : sequence of Path
        Of one set; the first tells the columns.
    given : mapping
        What was answered already.
    why : str
        Why it is asked.

    Returns
    -------
    Ask
        To be raised.

    Raises
    ------
    ReadError
        If the first file does not hold two columns of numbers.
    """
    columns = _numbers(files[0])
    if len(columns) < _FEWEST:
        raise ReadError(
            f"{files[0].name}: holds {len(columns)} column of numbers; a run needs a position and a "
            "reading"
        )
    names = [name for name, _ in columns]
    guessed: dict[str, str] = {}
    for role in ("time", "feed", "x", "z", "run"):
        guessed[role] = _guess(role, columns, taken=set(guessed.values()))
    fields = [
        {
            "name": role,
            "label": label,
            "value": str(given.get(role, guessed.get(role, ""))),
            "choices": [] if role == "scale" else names,
            "hint": "name, or name:unit where the header does not say it"
            if role in ("x", "z")
            else "",
        }
        for role, label in _LABELS.items()
    ]
    names_words = ", ".join(names)
    message = f"{why}; which column is what? {files[0].name} holds {names_words}"
    return Ask(message, "columns", str(files[0]), fields)


def _numbers(file: Path) -> list[tuple[str, str | None]]:
    """Return name and dimension of the columns of numbers."""
    from metrosep.io.run_tables import columns_of
    from metrosep.io.source import open_file

    table, _ = columns_of(open_file(file), {})
    return [(c.name, None if c.unit is None else c.unit.dimension) for c in table.numbers]


_DIMENSIONS = {"x": ("length",), "z": ("length", "voltage"), "feed": ("speed",), "time": ("time",)}


def _guess(role: str, columns: Sequence[tuple[str, str | None]], *, taken: set[str]) -> str:
    """Return the column that is likely meant: by its unit first, then by its name."""
    free = [(name, dimension) for name, dimension in columns if name not in taken]
    named = [name for name, _ in free if re.fullmatch(_NAMES[role], _bare(name), re.IGNORECASE)]
    if role == "run":
        return named[0] if named else ""
    fits = [name for name, dimension in free if dimension in _DIMENSIONS[role]]
    both = [name for name in named if name in fits]
    if both:
        return both[0]
    if role in ("x", "z"):
        return (fits or named or [""])[0]
    return (fits or [n for n in named if dict(free)[n] is None] or [""])[0]


def _bare(name: str) -> str:
    """Return a name without its unit: ``x_mm`` is x, ``feed_mm_min`` is feed."""
    return re.sub(r"[_ ]*[\[(_].*$", "", name.strip()) or name.strip()
