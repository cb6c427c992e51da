"""One open measurement with its recipe: opening, editing, autosave, and what the steps give."""

from __future__ import annotations

import hashlib
import itertools
import threading
import time
import tomllib
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

from metrosep.app.documents import Edit, Places, RecipeDocument, refuse_changed, refuse_open
from metrosep.app.evaluations import Evaluations, Level, Outcome
from metrosep.app.mends import mends_of_edit, mends_of_refusal, mends_of_step
from metrosep.app.opening import Opened, open_files, open_with, read_again, session_text
from metrosep.app.view_tables import shown_view
from metrosep.app.wire import page_words
from metrosep.core.atomic import atomic_write
from metrosep.core.errors import DataError, MetrosepError, ReadError, WriteError
from metrosep.core.inside import carried
from metrosep.recipe.recipe import Recipe
from metrosep.recipe.step_help import step_words

_EXTREMES = ("PV", "PVr", "PVq", "Sz", "Sp", "Sv", "S10z", "Sxp")
"""Parameters of single points, besides all of a profile that end in t, z, p or v: they need all data."""

_LAST_WAIT = 10.0
"""Seconds that the end waits for a slow disk."""


class Session:
    """What one page works on."""

    def __init__(
        self,
        places: Places,
        read: Callable[..., Any] | None = None,
        keeper: Keeper | None = None,
    ) -> None:
        self.places = places
        self.keeper = keeper or Keeper()
        self._read = read
        self._changing = threading.Lock()  # one change at a time, however long it reads
        self.lock = threading.RLock()  # held for moments: pictures need it too
        self.opened: Opened | None = None
        self.document: RecipeDocument | None = None
        self.messages: list[str] = []
        self._openings = 0

    # ---- opening -----------------------------------------------------------------------------

    def open(
        self,
        paths: str | Sequence[str],
        reading: Mapping[str, Any] | None = None,
        *,
        keep_recipe: bool = False,
    ) -> None:
        """Open a measurement, several runs as a set, or a recipe with its files."""
        names = [paths] if isinstance(paths, str) else list(paths)
        with self._changing, self.places.guarding():
            self.keeper.retry()
            self.keeper.wait()  # what was changed last may be opened again
            if keep_recipe:
                document = self._need()
                opened = open_with(self.places, names, document, reading, self._read)
            else:
                opened = open_files(self.places, names, reading, self._read)
            if self.keeper.has_failed(opened.kept):  # the disk has an older one
                raise DataError(
                    f"{opened.home.name}: its latest session is not on the disk yet; make room, then "
                    "open it again"
                )
            with self.lock:
                self._openings += 1
                opened = replace(opened, serial=self._openings)
                self.opened, self.document = opened, opened.document
                self.messages = list(opened.messages)
                self.keeper.begin(opened.kept, opened.held)

    def target(self, path: str, *, recipe: bool = False) -> Path:
        """Return where a file that the user asks for may be written."""
        opened, _ = self.need()
        found = self.places.writable(path)
        refuse_open(found, opened, recipe=recipe)
        if not recipe:
            refuse_changed(opened.stamps)
        return found

    def saved(self, file: Path) -> None:
        """Take note that the recipe was saved, perhaps onto the one that was opened."""
        with self._changing, self.lock:
            if self.opened is not None and self.opened.base and file == self.opened.home:
                base = hashlib.sha256(file.read_bytes()).hexdigest()
                self.opened = replace(self.opened, base=base)

    # ---- editing -----------------------------------------------------------------------------

    def need(self) -> tuple[Opened, RecipeDocument]:
        """Return what is open."""
        with self.lock:
            if self.opened is None or self.document is None:
                raise DataError("no file is open; open one, or drop it onto the page")
            return self.opened, self.document

    def _need(self) -> RecipeDocument:
        return self.need()[1]

    def edit(self, edits: Sequence[Edit], label: str | None = None) -> None:
        """Carry edits of the recipe out, and keep it."""
        self._carry_out(lambda document: document.edit(edits, label))

    def undo(self) -> None:
        """Take the last edit back."""
        self._carry_out(RecipeDocument.undo)

    def redo(self) -> None:
        """Do the last edit again that was taken back."""
        self._carry_out(RecipeDocument.redo)

    def _carry_out(self, act: Callable[[RecipeDocument], None]) -> None:
        """Change the recipe, read again if it names other columns or units, and keep it.

        The change is tried on a copy: pictures go on meanwhile, and if the files cannot be read so,
        nothing has happened.
        """
        with self._changing, self.places.guarding():
            opened, document = self.need()
            tried, before = document.copy(), document.recipe.input
            act(tried)
            if tried.recipe.input != before:
                if tried.recipe.input.get("files") != before.get("files"):
                    raise DataError(
                        "the files of a session are those that were opened; open the other files"
                    )
                opened = read_again(opened, tried.recipe, self._read)
            self._adopt(opened, document, tried)

    def show(self, view: Mapping[str, Any]) -> None:
        """Keep what the page shows with the recipe: no edit, nothing to undo."""
        with self._changing:
            opened, document = self.need()
            tried = document.copy()
            tried.show(view)
            if tried.text == document.text:
                return
            self._adopt(opened, document, tried)

    def _adopt(self, opened: Opened, document: RecipeDocument, tried: RecipeDocument) -> None:
        """Go on with the copy that was tried, and keep it."""
        with self.lock:
            document.adopt(tried)
            self.opened = replace(opened, displaced=False)
        self.keeper.keep(opened.kept, session_text(opened, document), aside=opened.displaced)

    # ---- what it gives -----------------------------------------------------------------------

    @property
    def kind(self) -> str | None:
        """Kind of what is open: map, profile, runs, method, or None."""
        return None if self.opened is None else self.opened.kind

    @property
    def evaluations(self) -> Evaluations | None:
        """The stages of a map or profile; None where something else is open."""
        material = None if self.opened is None else self.opened.material
        return material if isinstance(material, Evaluations) else None

    def outcome(
        self,
        level: Level,
        *,
        cancel: Callable[[], bool] | None = None,
        tell: Callable[[str], None] | None = None,
    ) -> Outcome:
        """Return what the steps make of the data of a size."""
        return self.evaluated(level, cancel=cancel, tell=tell)[0]

    def evaluated(
        self,
        level: Level,
        *,
        cancel: Callable[[], bool] | None = None,
        tell: Callable[[str], None] | None = None,
    ) -> tuple[Outcome, Recipe, str]:
        """Return what the steps make of the data, with the recipe that holds these steps."""
        with self.lock:
            opened, document = self.need()
            recipe = document.recipe
        if not isinstance(opened.material, Evaluations):
            raise DataError(
                f"this is a recipe of {opened.kind}: it has no stages of one measurement"
            )
        steps = recipe.steps
        outcome = opened.material.outcome(steps, level, cancel=cancel, tell=tell)
        if outcome.error is not None and outcome.failed is not None:
            error, op = outcome.error, steps[outcome.failed]["op"]
            words = step_words(str(error), op)
            words = words.replace("nesting_index", "cutoff") if op == "filter" else words
            error.args = (words, *error.args[1:])
        return outcome, recipe, mark_of(opened, recipe)

    def failure(self, outcome: Outcome) -> dict[str, Any]:
        """Return the step that could not be run, why, and what may be done."""
        index, error = outcome.failed, outcome.error
        mends = [] if index is None or error is None else mends_of_step(self._need(), index, error)
        return {"index": index, "message": self.words(str(error), ()), "mends": mends}

    def mends(
        self, error: MetrosepError, edits: Sequence[Edit] | None = None
    ) -> list[dict[str, Any]]:
        """Return what may be done about edits that were refused, or steps and limits that do not fit."""
        if edits is None:
            return mends_of_refusal(self._need(), error)
        return mends_of_edit(self._need(), edits, error)

    def mends_of_runs(self, error: MetrosepError) -> list[dict[str, Any]]:
        """Return what may be done where runs cannot be separated."""
        with self.lock:
            document = self.document
        steps = () if document is None else document.recipe.steps
        at = next((i for i, step in enumerate(steps) if step["op"] == "separate"), None)
        return [] if document is None or at is None else mends_of_step(document, at, error)

    def state(self) -> dict[str, Any]:
        """Return everything that the page shows of the recipe."""
        with self.lock:
            document, opened = self.document, self.opened
            if document is None or opened is None:
                return {"recipe": None, "steps": [], "files": [], "kind": None, "can_undo": False,
                        "can_redo": False, "messages": self._said(), "view": {}}  # fmt: skip
            data = tomllib.loads(document.text)
            return {
                "recipe": document.text,
                "title": document.recipe.title,
                "name": document.name,
                "steps": _steps(data),
                "sections": data.get("section", []),
                "checks": data.get("check", []),
                "outputs": data.get("output", []),
                "input": data.get("input", {}),
                "op": document.recipe.steps[0]["op"],
                "files": [str(f) for f in opened.files],
                "home": str(opened.home),
                "target": str(self.places.target(opened.home)),
                "kind": self.kind,
                "can_undo": document.undo_label is not None,
                "can_redo": document.redo_label is not None,
                "undo_label": document.undo_label,
                "redo_label": document.redo_label,
                "saved_at": self.keeper.saved_at,
                "keeping": self._keeping(),
                "hash": mark_of(opened, document.recipe),
                "view": shown_view(data.get("view")),
                "messages": self._said(),
            }

    def _keeping(self) -> str:
        """How it stands with the session on disk: unchanged, kept, waiting or failed."""
        if self.keeper.is_waiting:
            return "waiting"
        if self.keeper.problem:
            return "failed"
        return "unchanged" if self.keeper.saved_at is None else "kept"

    def _said(self) -> list[str]:
        return [*self.messages, *filter(None, [self.keeper.notice, self.keeper.problem])]

    def words(
        self, message: str, ops: Iterable[str] | None = None, names: Iterable[object] = ()
    ) -> str:
        """Return a message of the library as the page says it; the names of its files, and those given, stay."""
        with self.lock:
            document, opened = self.document, self.opened
        if document is not None:
            names = [*names, document.name]
            ops = [step["op"] for step in document.recipe.steps] if ops is None else ops
        if opened is not None:
            names = [*names, *opened.files, opened.home, opened.kept]
        for op in ops or ():
            message = step_words(message, op)
        return page_words(message, names)

    def close(self) -> None:
        """Forget the measurement; the recipe was kept with each edit."""
        self.keeper.close(_LAST_WAIT)
        self.places.close()


def mark_of(opened: Opened, recipe: Recipe) -> str:
    """Return what tells a recipe on a file from all others: numbers of another are outdated."""
    return f"{opened.serial}-{recipe.recorded['sha256']}"


def _steps(data: Mapping[str, Any]) -> list[dict[str, Any]]:
    return [
        {
            "index": i,
            "op": step["op"],
            "enabled": step.get("enabled", True),
            "keys": {k: v for k, v in step.items() if k not in ("op", "enabled")},
            "stored": step,
        }
        for i, step in enumerate(data.get("step", []))
    ]


def is_extreme(symbol: str) -> bool:
    """Return whether a parameter is that of single points, which a preview averages away.

    Examples
    --------
    >>> is_extreme("Sz"), is_extreme("Rt"), is_extreme("Sq"), is_extreme("residual.pv")
    (True, True, False, True)
    """
    plain = symbol.partition("#")[0]
    if plain in _EXTREMES or plain.endswith(".pv") or "PV" in plain:
        return True
    return len(plain) >= 2 and plain[0] in "PWR" and plain[1] in "tzpv"


# ---- the session on disk: written beside the work, so that a slow disk stops nobody ------------

_PATIENCE = 0.25
"""Seconds that an edit waits for the disk: most are kept before the page hears of them."""

_AGAIN = 5.0
"""Seconds after which what could not be kept is tried again."""

Write = Callable[[Path, bytes], object]


class Keeper:
    """Writes the latest text of a session in a thread of its own.

    Notes
    -----
    A file that another program wrote since it was read or written here is left alone: the text goes
    beside it (``.other-1``), and `notice` says so.
    """

    def __init__(
        self,
        write: Write = atomic_write,
        told: Callable[[], None] | None = None,
        again: float = _AGAIN,
    ) -> None:
        self.write, self.told, self.again = write, told, again
        self.saved_at: float | None = None
        self.problem = ""
        self.notice = ""
        self._changed = threading.Condition()
        self._wanted: dict[Path, tuple[str, bool]] = {}
        self._failed: dict[Path, tuple[str, bool, str]] = {}
        self._known: dict[Path, bytes | None] = {}
        self._beside: dict[Path, Path] = {}
        self._current: Path | None = None
        self._timer: threading.Timer | None = None
        self._works = False
        self._given_up = False
        self._heard: str | None = None

    def keep(self, path: Path, text: str, *, aside: bool = False) -> None:
        """Keep a text; an older one of the same file that still waits is omitted."""
        with self._changed:
            self._current = path
            self._take_failed()
            self._wanted[path] = (text, aside or self._wanted.get(path, ("", False))[1])
            self._start()
            self._given_up, self._heard = not self.wait(_PATIENCE), None

    def retry(self) -> None:
        """Begin to write again what could not be kept."""
        with self._changed:
            self._take_failed()
            if self._wanted:
                self._start()

    def has_failed(self, path: Path) -> bool:
        """Return whether the latest text of a file is not on the disk since that failed."""
        return path in self._failed

    @property
    def is_waiting(self) -> bool:
        """Whether a text is not on the disk yet."""
        return self._works

    def wait(self, seconds: float | None = None) -> bool:
        """Wait until everything is kept, or could not be."""
        with self._changed:
            return self._changed.wait_for(lambda: not self._works, seconds)

    def begin(self, path: Path, held: bytes | None) -> None:
        """Begin anew, for another file: nothing of it was kept yet."""
        with self._changed:
            self.saved_at, self.problem, self.notice, self._current = None, "", "", path
            self._known[path] = held
            self._beside.pop(path, None)

    def close(self, seconds: float) -> bool:
        """Try a last time to keep what could not be."""
        self.retry()
        done = self.wait(seconds)
        with self._changed:
            if self._timer is not None:
                self._timer.cancel()
            self._timer = None
            return done and not self._failed

    def _take_failed(self) -> None:
        """Want again what failed, unless a newer text of the same file is wanted."""
        for path, (text, aside, _) in self._failed.items():
            newer, too = self._wanted.get(path, (text, False))
            self._wanted[path] = (newer, aside or too)
        self._failed.clear()

    def _start(self) -> None:
        if not self._works:
            self._works = True
            threading.Thread(target=carried(self._work), daemon=True, name="keeper").start()

    def _try_again(self) -> None:
        """Try again after a while; who shows the problem hears if it is solved."""
        with self._changed:
            self._timer = None
            if self._failed:
                self._given_up, self._heard = True, self.problem
                self.retry()

    def _work(self) -> None:
        while (job := self._next()) is not None:
            path, text, aside = job
            problem, aside = self._written(path, text, aside=aside)
            with self._changed:
                if problem:
                    self._failed[path] = (text, aside, problem)
                else:
                    self._failed.pop(path, None)
                    if path == self._current:
                        self.saved_at = time.time()
                self.problem = next((words for *_, words in self._failed.values()), "")

    def _next(self) -> tuple[Path, str, bool] | None:
        """Return what is to be written next; at the end tell who stopped waiting."""
        with self._changed:
            if self._wanted:
                path = next(iter(self._wanted))
                return path, *self._wanted.pop(path)
            late = self._given_up and self._heard != self.problem
            self._given_up, self._works, self._heard = False, False, None
            if self._failed and self._timer is None:
                self._timer = threading.Timer(self.again, carried(self._try_again))
                self._timer.daemon = True
                self._timer.start()
            self._changed.notify_all()
        if late and self.told is not None:
            self.told()
        return None

    def _written(self, path: Path, text: str, *, aside: bool) -> tuple[str, bool]:
        """Write a text; return why it could not be, and whether a file is still to be put aside."""
        content = text.encode("utf-8")
        try:
            if aside and path.exists():
                path.replace(_free(path, ".old", ".old."))
                self._known[path] = None
            aside = False
            target = self._own(path)
            target.parent.mkdir(parents=True, exist_ok=True)
            self.write(target, content)
            self._known[target] = content
        except (ReadError, WriteError, OSError) as exc:
            return f"the session is not kept: {exc}", aside
        return "", False

    def _own(self, path: Path) -> Path:
        """Return where a text may be written: beside what another program wrote."""
        if path in self._beside:
            return self._beside[path]
        if path not in self._known or not path.exists() or path.read_bytes() == self._known[path]:
            return path
        other = _free(path, ".other-1", ".other-")
        self._beside[path] = other
        self.notice = (
            f"{path.name}: another metrosep works on this file and keeps its session there; this one is "
            f"kept in {other.name}"
        )
        return other


def _free(path: Path, first: str, further: str) -> Path:
    """Return a name beside a file that is not taken yet."""
    found = path.with_name(f"{path.name}{first}")
    start = 2 if first.startswith(further) else 1
    for number in itertools.count(start):
        if not found.exists():
            break
        found = path.with_name(f"{path.name}{further}{number}")
    return found
