"""One open measurement with its recipe: opening, editing, autosave, and what the steps give."""

from __future__ import annotations

import hashlib
import threading
import time
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

from metrosep.app.documents import Edit, RecipeDocument, start_text
from metrosep.app.evaluations import Evaluations, Level, Outcome
from metrosep.app.places import Places
from metrosep.core.errors import (
    DataError,
    ReadError,
    RecipeError,
    UnitError,
    WriteError,
)
from metrosep.core.profile import Profile
from metrosep.core.surface import Surface

__all__ = ["Ask", "Session", "autosave_path", "is_extreme"]

_READING = ("unit", "lateral_step", "channel", "format")
"""Options of a reader that a recipe keeps in ``[input]``."""

_EXTREMES = ("PV", "PVr", "PVq", "Sz", "Sp", "Sv", "S10z", "Sxp")
"""Parameters of single points, besides all of a profile that end in t, z, p or v: they need all data."""


class Ask(DataError):  # noqa: N818
    """The file does not say something that the user must.

    Parameters
    ----------
    message : str
        As the command line would say it.
    name : str
        Option of the reader.
    path : str
        The file.
    """

    def __init__(self, message: str, name: str, path: str) -> None:
        super().__init__(message)
        self.name, self.path = name, path


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


class Session:
    """What one page works on.

    Parameters
    ----------
    places : Places
        Files it may touch.
    read : callable, optional
        Reads a file; `metrosep.io.read.read` if omitted.
    """

    def __init__(self, places: Places, read: Callable[..., Any] | None = None) -> None:
        self.places = places
        self._read = read
        self.lock = threading.RLock()
        self.file: Path | None = None
        self.document: RecipeDocument | None = None
        self.evaluations: Evaluations | None = None
        self.view: dict[str, Any] = {}
        self.saved_at: float | None = None
        self.messages: list[str] = []

    # ---- opening -----------------------------------------------------------------------------

    def open(self, path: str, reading: Mapping[str, Any] | None = None) -> None:
        """Open a measurement, or a recipe with its measurement.

        Parameters
        ----------
        path : str
            As the page names it.
        reading : mapping, optional
            Options of the reader.

        Raises
        ------
        ReadError
            If it cannot be read, or lies outside the opened folders.
        Ask
            If the file does not say its unit.
        DataError
            If it holds something else than a map or profile.
        RecipeError
            If a recipe is wrong.
        """
        file = self.places.readable(path)
        given = {k: v for k, v in (reading or {}).items() if k in _READING and v not in (None, "")}
        messages: list[str] = []
        document = None
        if file.suffix == ".toml":
            document, file = self._of_recipe(file)
        obj = self._obj(file, given or self._stored(document))
        if document is None:
            document = self._restored(file, messages) or RecipeDocument(
                start_text(file.name, _kind(obj), given), file.parent
            )
        with self.lock:
            self.file, self.document, self.evaluations = file, document, Evaluations(obj)
            self.messages, self.view, self.saved_at = messages, {}, None

    def _of_recipe(self, file: Path) -> tuple[RecipeDocument, Path]:
        try:
            text = file.read_text(encoding="utf-8")
        except (OSError, UnicodeDecodeError) as exc:
            raise RecipeError(f"{file.name}: the recipe cannot be read ({exc})") from None
        document = RecipeDocument(text, file.parent, file.name)
        names = document.recipe.input.get("files") or ()
        found = sorted(p for name in names for p in file.parent.glob(name))
        if not found:
            raise ReadError(
                f"{file.name}: its [input] names no file that is there; open a measurement"
            )
        return document, self.places.readable(str(found[0]))

    def _restored(self, file: Path, messages: list[str]) -> RecipeDocument | None:
        kept = autosave_path(file)
        if not kept.is_file():
            return None
        try:
            made = RecipeDocument(kept.read_text(encoding="utf-8"), file.parent)
        except (OSError, UnicodeDecodeError, RecipeError) as exc:
            messages.append(f"{kept.name}: the session kept there is not used ({exc})")
            return None
        messages.append(f"the session of this file was taken up again ({kept.name})")
        return made

    def _stored(self, document: RecipeDocument | None) -> dict[str, Any]:
        if document is None:
            return {}
        kept = document.recipe.input
        return {k: kept[k] for k in _READING if k in kept}

    def _obj(self, file: Path, reading: Mapping[str, Any]) -> Surface | Profile:
        from metrosep.io.read import read

        try:
            obj = (self._read or read)(file, **reading)
        except MemoryError:
            raise ReadError(
                f"{file.name}: too large for the memory of this computer; cut it, or open it elsewhere"
            ) from None
        except UnitError as exc:
            raise Ask(str(exc), "unit", str(file)) from None
        if isinstance(obj, Surface | Profile):
            return obj
        raise DataError(
            f"{file.name}: holds a {type(obj).__name__}; the workbench works on maps and profiles, runs "
            "are separated with 'metrosep separate'"
        )

    # ---- editing -----------------------------------------------------------------------------

    def _need(self) -> RecipeDocument:
        if self.document is None or self.evaluations is None or self.file is None:
            raise DataError("no file is open; open one, or drop it onto the page")
        return self.document

    def edit(self, edits: Sequence[Edit], label: str | None = None) -> None:
        """Carry edits of the recipe out, and keep it.

        Parameters
        ----------
        edits : sequence of Edit
            As one step of undo.
        label : str, optional
            For undo.

        Raises
        ------
        DataError
            If nothing is open, or an edit does not fit.
        RecipeError
            If the recipe would no longer be one.
        """
        with self.lock:
            self._need().edit(edits, label)
            self._keep()

    def undo(self) -> None:
        """Take the last edit back.

        Raises
        ------
        DataError
            If there is none, or nothing is open.
        """
        with self.lock:
            self._need().undo()
            self._keep()

    def redo(self) -> None:
        """Do the last edit again that was taken back.

        Raises
        ------
        DataError
            If there is none, or nothing is open.
        """
        with self.lock:
            self._need().redo()
            self._keep()

    def _keep(self) -> None:
        document, file = self.document, self.file
        if document is None or file is None:
            return
        try:
            document.save(autosave_path(file))
            self.saved_at = time.time()
        except WriteError as exc:
            words = f"the session is not kept: {exc}"
            if words not in self.messages:
                self.messages.append(words)

    # ---- what it gives -----------------------------------------------------------------------

    @property
    def kind(self) -> str | None:
        """Kind of what is open: map, profile, or None."""
        return None if self.evaluations is None else _kind(self.evaluations.obj)

    def outcome(
        self,
        level: Level,
        *,
        cancel: Callable[[], bool] | None = None,
        tell: Callable[[str], None] | None = None,
    ) -> Outcome:
        """Return what the steps make of the data of a size.

        Parameters
        ----------
        level : {"drag", "idle", "full"}
            Size.
        cancel, tell : callable, optional
            See `Evaluations.outcome`.

        Returns
        -------
        Outcome
            Up to the first step that fails.

        Raises
        ------
        DataError
            If nothing is open.
        CancelledError
            If `cancel` says so.
        """
        with self.lock:
            steps = self._need().recipe.steps
            evaluations = self.evaluations
        if evaluations is None:
            raise DataError("no file is open; open one, or drop it onto the page")
        return evaluations.outcome(steps, level, cancel=cancel, tell=tell)

    def state(self) -> dict[str, Any]:
        """Return everything that the page shows of the recipe.

        Returns
        -------
        dict
            ``session`` of the protocol; plain values.
        """
        with self.lock:
            document = self.document
            if document is None or self.file is None:
                return {"recipe": None, "steps": [], "files": [], "kind": None, "can_undo": False,
                        "can_redo": False, "messages": list(self.messages), "view": {}}  # fmt: skip
            return {
                "recipe": document.text,
                "title": document.recipe.title,
                "steps": _steps(document),
                "checks": _tables(document, "check"),
                "files": [str(self.file)],
                "kind": self.kind,
                "can_undo": document.undo_label is not None,
                "can_redo": document.redo_label is not None,
                "undo_label": document.undo_label,
                "redo_label": document.redo_label,
                "saved_at": self.saved_at,
                "hash": hashlib.sha256(document.text.encode()).hexdigest(),
                "view": dict(self.view),
                "messages": list(self.messages),
            }

    def close(self) -> None:
        """Forget the measurement; the recipe was kept with each edit."""
        self.places.close()


def _kind(obj: Surface | Profile) -> str:
    return "map" if isinstance(obj, Surface) else "profile"


def _tables(document: RecipeDocument, name: str) -> list[dict[str, Any]]:
    import tomllib

    return list(tomllib.loads(document.text).get(name, []))


def _steps(document: RecipeDocument) -> list[dict[str, Any]]:
    return [
        {
            "index": i,
            "op": step["op"],
            "enabled": step.get("enabled", True),
            "keys": {k: v for k, v in step.items() if k not in ("op", "enabled")},
            "stored": step,
        }
        for i, step in enumerate(_tables(document, "step"))
    ]


def is_extreme(symbol: str) -> bool:
    """Return whether a parameter is that of single points, which a preview averages away.

    Parameters
    ----------
    symbol : str
        Such as ``"Sz"``.

    Returns
    -------
    bool
        True for peaks, valleys and heights between them.

    Examples
    --------
    >>> is_extreme("Sz"), is_extreme("Rt"), is_extreme("Sq"), is_extreme("residual.pv")
    (True, True, False, True)
    """
    plain = symbol.partition("#")[0]
    if plain in _EXTREMES or plain.endswith(".pv") or "PV" in plain:
        return True
    return len(plain) >= 2 and plain[0] in "PWR" and plain[1] in "tzpv"
