"""What the server answers to each kind of request: a header and arrays, from one session."""

from __future__ import annotations

from collections.abc import Mapping
from importlib import import_module

from metrosep._version import __version__
from metrosep.app.documents import Edit
from metrosep.app.messages import Answer, Cancel, Message, Tell
from metrosep.app.picture_answers import PictureAnswers
from metrosep.app.sessions import Session
from metrosep.app.view_tables import checked_view
from metrosep.core.errors import DataError

__all__ = ["CHANGING", "KINDS", "Answers"]

CHANGING = ("open", "edit", "undo", "redo")
"""Requests after which every page shows another recipe."""

_OWN = ("hello", "view", *CHANGING)
_PICTURES = ("map", "section", "profile", "spectrum")
_ELSEWHERE = {
    "metrics": "metrics_answers:metrics",
    "export": "export_answers:export",
    "curves": "run_answers:curves",
    "waves": "run_answers:waves",
    "table": "table_answers:table",
    "controllers": "table_answers:controllers",
    "ranking": "ranking_answers:ranking",
    "report": "report_answers:report",
    "compare": "compare_answers:compare",
    "run_folder": "folder_answers:run_folder",
}
"""Functions ``f(session, message, cancel, tell)`` in modules of their own, loaded when asked."""

KINDS = (*_OWN, *_PICTURES, *_ELSEWHERE)


def _never() -> bool:
    return False


def _nobody(news: Mapping[str, object]) -> None:
    """Tell nobody."""


class Answers:
    """Answers for one session."""

    def __init__(self, session: Session) -> None:
        self.session = session
        self.pictures = PictureAnswers(session)

    def answer(self, message: Message, cancel: Cancel = _never, tell: Tell = _nobody) -> Answer:
        """Return the answer to a request."""
        kind = message.get("k")
        if not isinstance(kind, str) or kind not in KINDS:
            raise DataError(f"there is no request {kind!r}; there are {', '.join(KINDS)}")
        if kind in _OWN:
            header, arrays = getattr(self, f"_{kind}")(message)
        elif kind in _PICTURES:
            header, arrays = getattr(self.pictures, kind)(message, cancel)
        else:
            module, _, name = _ELSEWHERE[kind].partition(":")
            function = getattr(import_module(f"metrosep.app.{module}"), name)
            header, arrays = function(self.session, message, cancel, tell)
        return {"k": kind, "ok": True, **header}, arrays

    def _hello(self, message: Message) -> Answer:
        from metrosep.recipe.described_steps import described_steps

        session = self.session.state()
        return {"version": __version__, "session": session, "schema": described_steps()}, {}

    def _open(self, message: Message) -> Answer:
        reading = message.get("reading") or {}
        if not isinstance(reading, Mapping):
            raise DataError("reading is an object of options")
        paths = message.get("paths") or [message.get("path")]
        if not isinstance(paths, list) or not all(isinstance(p, str) and p for p in paths):
            raise DataError(f"path is a text, or paths a list of them; got {paths!r}")
        self.session.open(paths, reading, keep_recipe=message.get("keep_recipe") is True)
        self.pictures.forget()
        return {"session": self.session.state()}, {}

    def _edit(self, message: Message) -> Answer:
        given = message.get("edits", [message])
        if not isinstance(given, list) or not all(isinstance(e, Mapping) for e in given):
            raise DataError("edits is a list of objects with path, old and new")
        label = message.get("label")
        self.session.edit(
            [Edit.from_message(e) for e in given], label if isinstance(label, str) else None
        )
        return {"session": self.session.state()}, {}

    def _view(self, message: Message) -> Answer:
        self.session.show(checked_view(message.get("view")))
        return {}, {}

    def _undo(self, message: Message) -> Answer:
        self.session.undo()
        return {"session": self.session.state()}, {}

    def _redo(self, message: Message) -> Answer:
        self.session.redo()
        return {"session": self.session.state()}, {}
