"""Answers that are pictures of one map or profile: map, section, profile, spectrum."""

from __future__ import annotations

from typing import Any

from metrosep.app.evaluations import Outcome
from metrosep.app.map_views import map_view
from metrosep.app.messages import Answer, Arrays, Cancel, Message, level_of
from metrosep.app.picture_frames import (
    lateral_unit,
    map_frame,
    profile_arrays,
    section_frame,
    spectrum_frame,
)
from metrosep.app.profile_views import Extremes, profile_view
from metrosep.app.pyramid import MapPyramid, build_pyramid
from metrosep.app.remembered import Remembered
from metrosep.app.section_views import section_profile, section_view
from metrosep.app.sessions import Session
from metrosep.core.errors import DataError
from metrosep.core.profile import Profile
from metrosep.core.surface import Surface

__all__ = ["PictureAnswers"]


class PictureAnswers:
    """Pictures of what one session evaluates."""

    def __init__(self, session: Session) -> None:
        self.session = session
        self._pyramids = Remembered(build_pyramid)
        self._extremes = Remembered(Extremes)
        self._moved = Remembered(_moved, most=17)
        self._transform: Any = None

    def _stage(self, message: Message, cancel: Cancel) -> tuple[Outcome, Surface | Profile]:
        outcome = self.session.outcome(level_of(message), cancel=cancel)
        stage = message.get("stage", -1)
        if isinstance(stage, bool) or not isinstance(stage, int):
            raise DataError(f"stage is the number of a step, got {stage!r}")
        obj = outcome.after(stage)
        if isinstance(obj, Surface) and outcome.shift != (0.0, 0.0):
            obj = self._moved.of(obj, outcome.shift)
        return outcome, obj

    def _surface(self, message: Message, cancel: Cancel, what: str) -> tuple[Outcome, Surface]:
        """Return a stage of a map; a profile has no picture of the kind `what`."""
        outcome, obj = self._stage(message, cancel)
        if not isinstance(obj, Surface):
            raise DataError(f"this measurement is a profile, it has no {what}")
        return outcome, obj

    def forget(self) -> None:
        """Forget what was made of the file that was open before."""
        for kept in (self._pyramids, self._extremes, self._moved):
            kept.clear()
        self._transform = None

    def map(self, message: Message, cancel: Cancel) -> Answer:
        """Answer a request ``map``."""
        outcome, obj = self._surface(message, cancel, "map")
        view = map_view(
            self._pyramid(obj),
            window=message.get("window"),
            pixels=message.get("pixels") or (512, 512),
            level=level_of(message),
            limits=message.get("range"),
            shade=bool(message.get("shade")),
        )
        extent = self._pyramid(obj).window
        return map_frame(view, extent, is_preview=outcome.is_preview)

    def _pyramid(self, obj: Surface) -> MapPyramid:
        evaluations = self.session.evaluations
        if evaluations is not None and obj is evaluations.obj and evaluations.pyramid is not None:
            return evaluations.pyramid
        return self._pyramids.of(obj)

    def section(self, message: Message, cancel: Cancel) -> Answer:
        """Answer a request ``section``."""
        outcome, obj = self._surface(message, cancel, "sections")
        view = section_view(
            obj, message["a"], message["b"], columns=message.get("columns") or 1000
        )
        return section_frame(view, is_preview=outcome.is_preview)

    def profile(self, message: Message, cancel: Cancel) -> Answer:
        """Answer a request ``profile``."""
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
            arrays |= profile_arrays(view, f"{name}_")
        return {"is_preview": outcome.is_preview}, arrays

    def spectrum(self, message: Message, cancel: Cancel) -> Answer:
        """Answer a request ``spectrum``."""
        from metrosep.app.spectrum_views import profile_spectrum, spectrum_view
        from metrosep.spectral.band import Band

        outcome, obj = self._stage(message, cancel)
        unit = lateral_unit(obj)
        place = (tuple(message["a"]), tuple(message["b"])) if isinstance(obj, Surface) else ()
        kept = self._transform
        if kept is None or kept[0] is not obj or kept[1] != place:
            line = section_profile(obj, *place) if isinstance(obj, Surface) else obj
            kept = self._transform = (obj, place, profile_spectrum(line, unit=unit))
        shortest, longest = message.get("band") or (None, None)
        band = Band(
            None if shortest is None else float(shortest),
            None if longest is None else float(longest),
        )
        view = spectrum_view(kept[2], band=band)
        return spectrum_frame(view, unit=unit, is_preview=outcome.is_preview)


def _moved(obj: Surface, shift: tuple[float, float]) -> Surface:
    """Return a preview where the map itself lies: its cells begin half a cell later."""
    place = (obj.origin[0] + shift[0], obj.origin[1] + shift[1])
    return Surface(obj.z, obj.dx, obj.dy, origin=place)
