"""The report of the present result: shown in the page, and written where the user says."""

from __future__ import annotations

from typing import Any

import numpy as np

from metrosep.app.full_results import made_of, result_of
from metrosep.app.messages import Answer, Cancel, Message, Tell, text_of
from metrosep.app.sessions import Session, mark_of
from metrosep.core.errors import DataError
from metrosep.recipe.pipeline import CancelledError

__all__ = ["report"]


def report(session: Session, message: Message, cancel: Cancel, tell: Tell) -> Answer:
    """Answer a request ``report``."""
    from metrosep.recipe.preflight import report_formats

    opened, document = session.need()
    writers = report_formats()
    target, name = None, str(message.get("format") or "html")
    if "write" in message:
        target = session.target(text_of(message, "write"))
        if name not in writers:
            raise DataError(
                f"there is no report format {name!r}; there are {', '.join(sorted(writers))}"
            )
        if target.is_dir():
            raise DataError(f"{target.name}: is a folder; name a file in it")
        if target.exists() and not message.get("overwrite"):
            raise DataError(f"{target.name}: exists already; choose another name or overwrite it")
    recipe = document.recipe
    result = result_of(opened, recipe, cancel, tell)
    header: dict[str, Any] = {
        "formats": sorted(writers, key=lambda f: (f != "html", f)),
        "verdict": result.verdict,
        "title": result.document["title"],
        "hash": mark_of(opened, recipe),
    }
    if cancel():
        raise CancelledError("stopped before the report was made")
    tell({"k": "progress", "words": "making the report"})
    if target is not None:
        writers[name].load()(dict(result.document), target)
        return {**header, "files": [str(target)]}, {}

    def make() -> bytes:
        from metrosep.report import render_html

        return render_html(result.document).encode("utf-8")

    page = made_of(opened.material, "report", recipe.recorded["text"], make)
    return header, {"html": np.frombuffer(page, dtype=np.uint8)}
