"""What the server answers to each kind of request: a header and arrays, from one session."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any, cast

import numpy as np
from numpy.typing import NDArray

from metrosep._version import __version__
from metrosep.app.documents import Edit
from metrosep.app.evaluations import Level, Outcome
from metrosep.app.map_views import map_view
from metrosep.app.profile_views import Extremes, profile_view
from metrosep.app.pyramid import MapPyramid, build_pyramid
from metrosep.app.remembered import Remembered
from metrosep.app.section_views import section_profile, section_view
from metrosep.app.sessions import Session, is_extreme
from metrosep.core.errors import DataError, MetrosepError, UnsupportedFeatureError
from metrosep.core.profile import Profile
from metrosep.core.surface import Surface

__all__ = ["Answer", "Answers"]

Arrays = dict[str, NDArray[Any]]
Answer = tuple[dict[str, Any], Arrays]
Message = Mapping[str, Any]
Cancel = Callable[[], bool]


_KINDS = (
    "hello",
    "open",
    "edit",
    "undo",
    "redo",
    "map",
    "section",
    "profile",
    "spectrum",
    "metrics",
    "export",
)
"""Each is a method of `Answers` with an underscore before it."""


def _never() -> bool:
    return False


class Answers:
    """Answers for one session.

    Parameters
    ----------
    session : Session
        What the page works on.
    """

    def __init__(self, session: Session) -> None:
        self.session = session
        self._pyramids = Remembered(build_pyramid)
        self._extremes = Remembered(Extremes)
        self._moved = Remembered(_moved, most=17)
        self._transform: Any = None

    def answer(self, message: Message, cancel: Cancel = _never) -> Answer:
        """Return the answer to a request.

        Parameters
        ----------
        message : mapping
            With ``k``, its kind; see the page on messages of the workbench.
        cancel : callable, optional
            Asked between steps; true stops with `CancelledError`.

        Returns
        -------
        header : dict
            Without ``id``.
        arrays : dict
            By name.

        Raises
        ------
        DataError
            If there is no such kind, or a value of it is wrong.
        MetrosepError
            What reading, editing or a step raises.
        """
        kind = message.get("k")
        if kind not in _KINDS:
            raise DataError(f"there is no request {kind!r}; there are {', '.join(_KINDS)}")
        header, arrays = getattr(self, f"_{kind}")(message, cancel)
        return {"k": kind, "ok": True, **header}, arrays

    # ---- recipe --------------------------------------------------------------------------------

    def _hello(self, message: Message, cancel: Cancel) -> Answer:
        from metrosep.recipe.pipeline import schema

        return {"version": __version__, "session": self.session.state(), "schema": schema()}, {}

    def _open(self, message: Message, cancel: Cancel) -> Answer:
        reading = message.get("reading") or {}
        if not isinstance(reading, Mapping):
            raise DataError("reading is an object of options")
        self.session.open(_text(message, "path"), reading)
        self._forget()
        return {"session": self.session.state()}, {}

    def _edit(self, message: Message, cancel: Cancel) -> Answer:
        given = message.get("edits", [message])
        if not isinstance(given, list) or not all(isinstance(e, Mapping) for e in given):
            raise DataError("edits is a list of objects with path, old and new")
        label = message.get("label")
        self.session.edit(
            [Edit.from_message(e) for e in given], label if isinstance(label, str) else None
        )
        return {"session": self.session.state()}, {}

    def _undo(self, message: Message, cancel: Cancel) -> Answer:
        self.session.undo()
        return {"session": self.session.state()}, {}

    def _redo(self, message: Message, cancel: Cancel) -> Answer:
        self.session.redo()
        return {"session": self.session.state()}, {}

    # ---- pictures ------------------------------------------------------------------------------

    def _stage(self, message: Message, cancel: Cancel) -> tuple[Outcome, Surface | Profile]:
        outcome = self.session.outcome(_level(message), cancel=cancel)
        stage = message.get("stage", -1)
        if isinstance(stage, bool) or not isinstance(stage, int):
            raise DataError(f"stage is the number of a step, got {stage!r}")
        obj = outcome.after(stage)
        if isinstance(obj, Surface) and outcome.shift != (0.0, 0.0):
            obj = self._moved.of(obj, outcome.shift)
        return outcome, obj

    def _forget(self) -> None:
        for kept in (self._pyramids, self._extremes, self._moved):
            kept.clear()
        self._transform = None

    def _map(self, message: Message, cancel: Cancel) -> Answer:
        outcome, obj = self._stage(message, cancel)
        if not isinstance(obj, Surface):
            raise DataError("this measurement is a profile, it has no map")
        view = map_view(
            self._pyramid(obj),
            window=message.get("window"),
            pixels=message.get("pixels") or (512, 512),
            level=_level(message),
            limits=message.get("range"),
            shade=bool(message.get("shade")),
        )
        arrays: Arrays = {"index": view.index}
        if view.shade is not None:
            arrays["shade"] = view.shade
        header = {
            "range": view.range,
            "window": view.window,
            "scale": view.scale,
            "unit": view.unit,
            "coverage": view.coverage,
            "is_preview": outcome.is_preview or view.is_preview,
            "extent": self._pyramid(obj).window,
        }
        return header, arrays

    def _pyramid(self, obj: Surface) -> MapPyramid:
        evaluations = self.session.evaluations
        if evaluations is not None and obj is evaluations.obj and evaluations.pyramid is not None:
            return evaluations.pyramid
        return self._pyramids.of(obj)

    def _section(self, message: Message, cancel: Cancel) -> Answer:
        outcome, obj = self._stage(message, cancel)
        if not isinstance(obj, Surface):
            raise DataError("this measurement is a profile, it has no sections")
        view = section_view(
            obj, message["a"], message["b"], columns=message.get("columns") or 1000
        )
        header = {
            "length": view.length,
            "pv": view.pv,
            "sq": view.sq,
            "share_valid": view.share_valid,
            "unit": view.unit,
            "is_preview": outcome.is_preview,
        }
        return header, {
            "distance": view.distance,
            "low": view.low,
            "high": view.high,
        }

    def _profile(self, message: Message, cancel: Cancel) -> Answer:
        outcome, obj = self._stage(message, cancel)
        if not isinstance(obj, Profile):
            raise DataError("this measurement is a map: ask for a section")
        arrays: Arrays = {}
        for name, shown in (("measured", outcome.source), ("residual", obj)):
            if name not in (message.get("series") or ["residual"]):
                continue
            view = profile_view(
                self._extremes.of(shown),
                window=message.get("window"),
                columns=message.get("columns") or 1000,
            )
            arrays |= {
                f"{name}_x": view.x,
                f"{name}_low": view.low,
                f"{name}_high": view.high,
            }
        return {"is_preview": outcome.is_preview}, arrays

    def _spectrum(self, message: Message, cancel: Cancel) -> Answer:
        from metrosep.app.spectrum_views import profile_spectrum, spectrum_view
        from metrosep.spectral.band import Band

        outcome, obj = self._stage(message, cancel)
        place = (tuple(message["a"]), tuple(message["b"])) if isinstance(obj, Surface) else ()
        kept = self._transform
        if kept is None or kept[0] is not obj or kept[1] != place:
            line = section_profile(obj, *place) if isinstance(obj, Surface) else obj
            kept = self._transform = (obj, place, profile_spectrum(line))
        shortest, longest = message.get("band") or (None, None)
        band = Band(
            None if shortest is None else float(shortest),
            None if longest is None else float(longest),
        )
        view = spectrum_view(kept[2], band=band)
        header = {
            "inside": view.inside,
            "outside": view.outside,
            "messages": list(view.messages),
            "is_preview": outcome.is_preview,
        }
        return header, {
            "wavelength": view.wavelength,
            "amplitude": view.amplitude,
            "in_band": view.in_band,
        }

    # ---- numbers -------------------------------------------------------------------------------

    def _metrics(self, message: Message, cancel: Cancel) -> Answer:
        from metrosep.recipe.pipeline_run import Measurement, judge_measurement

        outcome = self.session.outcome(_level(message), cancel=cancel)
        document = self.session.document
        if document is None:
            raise DataError("no file is open")
        measured = Measurement(outcome.source, outcome.stages)
        found = measured.found
        header: dict[str, Any] = {
            "is_preview": outcome.is_preview,
            "verdict": None,
            "rows": [_row(k, q, preview=outcome.is_preview) for k, q in found.items()],
            "messages": list(measured.messages),
            "stages": [
                {"index": s.index, "seconds": s.seconds, "messages": list(s.messages)}
                for s in outcome.stages
            ],
        }
        if outcome.error is not None:
            header["failed"] = {"index": outcome.failed, "message": str(outcome.error)}
        elif not outcome.is_preview and document.recipe.checks:
            try:
                judged = judge_measurement(document.recipe, measured)
            except MetrosepError as exc:
                # a limit of what is not there: the numbers are still shown
                header["refused"] = str(exc)
            else:
                header["verdict"] = judged["verdict"]
                header["checks"] = _plain(judged["characteristics"])
        return header, {}

    def _export(self, message: Message, cancel: Cancel) -> Answer:
        what = message.get("what")
        session, document = self.session, self.session.document
        if document is None or session.file is None:
            raise DataError("no file is open; open one, or drop it onto the page")
        target = session.places.writable(_text(message, "path"))
        if what == "recipe":
            if target.exists() and not message.get("overwrite"):
                raise DataError(
                    f"{target.name}: exists already; choose another name or overwrite it"
                )
            document.save(target)
            return {"files": [str(target)]}, {}
        if what == "result":
            result = document.recipe.run([session.file], out=target)
            return {"files": [str(f) for f in result.files], "verdict": result.verdict}, {}
        raise UnsupportedFeatureError(
            f"export of {what!r} is not in this version: recipe or result"
        )


def _moved(obj: Surface, shift: tuple[float, float]) -> Surface:
    """Return a preview where the map itself lies: its cells begin half a cell later."""
    place = (obj.origin[0] + shift[0], obj.origin[1] + shift[1])
    return Surface(obj.z, obj.dx, obj.dy, origin=place)


def _level(message: Message) -> Level:
    level = message.get("level", "idle")
    if level not in ("drag", "idle", "full"):
        raise DataError(f"level is drag, idle or full, got {level!r}")
    return cast(Level, level)


def _text(message: Message, name: str) -> str:
    value = message.get(name)
    if not isinstance(value, str) or not value:
        raise DataError(f"{name} is a text, got {value!r}")
    return value


def _row(symbol: str, quantity: Any, *, preview: bool) -> dict[str, Any]:
    hidden = preview and is_extreme(symbol)
    return {
        "symbol": symbol,
        "value": None if hidden else _number(quantity.value),
        "unit": quantity.unit,
        "u": None if hidden else _number(quantity.u),
        "definition": quantity.definition,
        "waits": hidden,
    }


def _number(value: float | None) -> float | None:
    return None if value is None or not np.isfinite(value) else float(value)


def _plain(value: Any) -> Any:
    if isinstance(value, Mapping):
        return {str(k): _plain(v) for k, v in value.items()}
    if isinstance(value, list | tuple):
        return [_plain(v) for v in value]
    if isinstance(value, float) and not np.isfinite(value):
        return None
    return str(value) if isinstance(value, Path) else value
