"""What the steps of a recipe make of a measurement, at three sizes, each step computed once.

Pictures come from a coarse copy while a hand moves and from a finer one when it rests; P-V,
verdicts and files come from the full data only. A change of a step keeps what the steps before it
gave.
"""

from __future__ import annotations

import threading
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, Literal

from metrosep.app.documents import text_key
from metrosep.app.pyramid import MapPyramid, build_pyramid
from metrosep.core.errors import DataError, MetrosepError
from metrosep.core.profile import Profile
from metrosep.core.readable import said_value
from metrosep.core.regions import counts_pixels
from metrosep.core.surface import Surface
from metrosep.recipe.pipeline import CancelledError, Stage, run_steps

Level = Literal["drag", "idle", "full"]
LEVELS: Mapping[str, int] = {"drag": 512, "idle": 1024}
"""Largest side of a preview in pixels."""

_SMALL = 200_000
"""Samples up to which a preview would save nothing: the full data serve for all sizes."""


@dataclass(frozen=True, slots=True)
class Outcome:
    """Stages of a recipe as far as it could be run."""

    source: Surface | Profile  # or Profile: what the first step got
    stages: tuple[Stage, ...]  # one for each step that was carried out
    failed: int | None = None  # number of the step that was not
    error: MetrosepError | None = None  # why
    is_preview: bool = False  # whether it is of a coarse copy
    # of (float, float), m: what is to be added to positions of a preview: the middle of its first
    # cell, where the map has no origin of its own
    shift: tuple[float, float] = (0.0, 0.0)
    is_partial: bool = False  # whether steps are still to come, which is no failure

    @property
    def done(self) -> int | None:
        """How many steps the picture is of, where the others are still to come; else None."""
        return len(self.stages) if self.is_partial else None

    def after(self, stage: int) -> Surface | Profile:
        """Return the measurement after a step; where it was not reached, before the one that failed."""
        if self.failed is not None and stage >= self.failed:
            stage = -1
        if self.is_partial and stage >= len(self.stages):
            stage = -1
        if stage == -2 or (stage == -1 and not self.stages):
            return self.source
        if stage == -1:
            return self.stages[-1].obj
        if 0 <= stage < len(self.stages):
            return self.stages[stage].obj
        raise DataError(f"there is no step {stage + 1}, the recipe has {len(self.stages)}")


@dataclass(slots=True)
class _Kept:
    keys: list[str] = field(default_factory=list)
    stages: list[Stage] = field(default_factory=list)


class Evaluations:
    """The stages of one measurement, remembered."""

    def __init__(self, obj: Surface | Profile) -> None:
        self.obj = obj
        self._pyramid: MapPyramid | None = None
        self._sources: dict[str, Surface | Profile] = {}
        self._kept: dict[str, _Kept] = {}
        self._lock = threading.Lock()
        self._busy = {level: threading.Lock() for level in ("drag", "idle", "full")}

    @property
    def pyramid(self) -> MapPyramid | None:
        """Coarser copies of a map; None of a profile."""
        if self._pyramid is None and isinstance(self.obj, Surface):
            with self._lock:
                if self._pyramid is None:
                    self._pyramid = build_pyramid(self.obj)
        return self._pyramid

    def source(self, level: Level) -> tuple[Surface | Profile, bool]:
        """Return the data of a size, and whether they are a preview."""
        if level not in ("drag", "idle", "full"):
            raise DataError(f"level is drag, idle or full, got {said_value(level)}")
        obj = self.obj
        if level == "full" or not isinstance(obj, Surface) or obj.z.size <= _SMALL:
            return obj, False
        if obj.dx is None or obj.dy is None:
            # lengths count in its own pixels: those of a coarse copy would be others
            return obj, False
        if level not in self._sources:
            self._sources[level] = _coarse(obj, self.pyramid, LEVELS[level])
        made = self._sources[level]
        return made, made is not obj

    def _shift(self, source: Surface | Profile) -> tuple[float, float]:
        obj = self.obj
        if (
            not isinstance(source, Surface)
            or not isinstance(obj, Surface)
            or obj.origin != (0.0, 0.0)
        ):
            return 0.0, 0.0
        steps = ((obj.dx, source.dx), (obj.dy, source.dy))
        x, y = (0.0 if a is None or b is None else (b - a) / 2.0 for a, b in steps)
        return x, y

    def outcome(
        self,
        steps: Sequence[Mapping[str, Any]],
        level: Level,
        *,
        cancel: Callable[[], bool] | None = None,
        tell: Callable[[str], None] | None = None,
    ) -> Outcome:
        """Return what the steps make of the data of a size."""
        at_hand = level == "drag"
        if counts_pixels(steps):  # of the map as it was read
            level = "full"
        source, is_preview = self.source(level)
        # a large map without a preview: a moving hand sees what is known already
        at_hand = (
            at_hand and not is_preview and isinstance(source, Surface) and source.z.size > _SMALL
        )
        shift = self._shift(source)  # of the map itself: none
        name = level if is_preview else "full"
        keys = [text_key(step) for step in steps]
        if at_hand:
            kept = self._kept.get(name, _Kept())
            known = list(zip(list(kept.keys), list(kept.stages), strict=False))
            same = 0
            while same < min(len(keys), len(known)) and keys[same] == known[same][0]:
                same += 1
            if same < len(keys):
                stages = tuple(stage for _, stage in known[:same])
                return Outcome(source, stages, is_preview=True, shift=shift, is_partial=True)
        with self._busy[name]:
            kept = self._kept.setdefault(name, _Kept())
            same = 0
            while same < min(len(keys), len(kept.keys)) and keys[same] == kept.keys[same]:
                same += 1
            del kept.keys[same:], kept.stages[same:]
            for i in range(same, len(keys)):
                obj = kept.stages[-1].obj if kept.stages else source
                try:
                    (stage,) = run_steps(
                        obj,
                        [steps[i]],
                        first=i,
                        before=steps[:i],
                        cancel=cancel,
                        tell=tell,
                        preview=is_preview,
                    )
                except CancelledError:
                    raise
                except MetrosepError as exc:
                    return Outcome(source, tuple(kept.stages), i, exc, is_preview, shift)
                kept.keys.append(keys[i])
                kept.stages.append(stage)
            return Outcome(source, tuple(kept.stages), is_preview=is_preview, shift=shift)


def _coarse(obj: Surface, pyramid: MapPyramid | None, side: int) -> Surface:
    """Return the finest level of a map that fits, as a map of its own with square corners."""
    if pyramid is None or max(obj.z.shape) <= side:
        return obj
    for level in pyramid.levels:
        if max(level.z.shape) <= side:
            rows, columns = _whole(level.pixels_y), _whole(level.pixels_x)
            return Surface(
                level.shown()[:rows, :columns],
                None if obj.dx is None else obj.dx * level.factor[1],
                None if obj.dy is None else obj.dy * level.factor[0],
                # a map without an origin has its forms about the middle: its preview too
                origin=(0.0, 0.0)
                if obj.origin == (0.0, 0.0)
                else (float(level.x[0]), float(level.y[0])),
            )
    return obj


def _whole(pixels: Any) -> int:
    """Return the number of whole cells: the last may be smaller, its centre off the grid."""
    return int(pixels.size if pixels[-1] == pixels[0] else pixels.size - 1)
