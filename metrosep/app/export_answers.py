"""Files that the user asks for: the recipe, its result."""

from __future__ import annotations

from metrosep.app.messages import Answer, Cancel, Message, Tell, text_of
from metrosep.app.sessions import Session
from metrosep.core.errors import DataError, UnsupportedFeatureError

__all__ = ["export"]


def export(session: Session, message: Message, cancel: Cancel, tell: Tell) -> Answer:
    """Answer a request ``export``.

    Parameters
    ----------
    session : Session
        What the page works on.
    message : mapping
        ``what`` (recipe or result), ``path``, and for the recipe ``overwrite``.
    cancel : callable
        Asked while the result is made.
    tell : callable
        Told what is being done.

    Returns
    -------
    header : dict
        ``files`` that were written, and the ``verdict`` of a result.
    arrays : dict
        None.

    Raises
    ------
    DataError
        If nothing is open, or the file is there already.
    WriteError
        If it lies outside the opened folders, or cannot be written.
    UnsupportedFeatureError
        If something else than a recipe or a result is asked for.
    MetrosepError
        Of the recipe.
    """
    opened, document = session.need()
    what = message.get("what")
    target = session.places.writable(text_of(message, "path"))
    if what == "recipe":
        if target.exists() and not message.get("overwrite"):
            raise DataError(f"{target.name}: exists already; choose another name or overwrite it")
        document.save(target)
        document.rename(target.name)
        return {"files": [str(target)], "session": session.state()}, {}
    if what == "result":
        inputs = None if document.recipe.reads_nothing else list(opened.files)
        result = document.recipe.run(
            inputs, out=target, progress=lambda text: tell({"k": "progress", "text": text})
        )
        return {"files": [str(f) for f in result.files], "verdict": result.verdict}, {}
    raise UnsupportedFeatureError(
        f"export of {what!r} is not in this version: recipe or result; a table is exported by 'table'"
    )
