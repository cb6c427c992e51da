"""`Exploration`: pictures of one map or profile in memory, as frames for a notebook.

The same numbers as the page of the workbench gets from its server, from the same drawing modules,
in the same frames (see `metrosep.app.wire`). It knows no notebook.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from typing import Any, NoReturn

from metrosep.app.map_views import map_view
from metrosep.app.picture_frames import (
    Arrays,
    lateral_unit,
    map_frame,
    profile_arrays,
    section_frame,
    spectrum_frame,
)
from metrosep.app.profile_views import Extremes, profile_view
from metrosep.app.pyramid import build_pyramid
from metrosep.app.section_views import section_profile, section_view
from metrosep.app.spectrum_views import ProfileSpectrum, profile_spectrum, spectrum_view
from metrosep.app.wire import error_header, pack
from metrosep.core.errors import DataError, MetrosepError
from metrosep.core.profile import Profile
from metrosep.core.surface import Surface
from metrosep.spectral.band import Band

__all__ = ["Exploration"]

Pair = tuple[float, float]

_MARGIN = 0.08
"""Part of the width between the rim of the map and the ends of the first section."""

_COLUMNS = 1000
"""Pixel columns of a line in a notebook; screens have no more there."""

_REFUSED = 2
"""Exit code of the command line for a request that cannot be met."""


class Exploration:
    """One map or profile with what its pictures are made of.

    Notes
    -----
    Each method gives one frame. What a picture refuses is a frame too, with the message: the other
    pictures go on. The number ``n`` of a header rises, so no two frames are alike.

    Examples
    --------
    >>> import numpy as np
    >>> from metrosep.app.wire import unpack
    >>> shown = Exploration(Surface([[0.0, 1.0], [np.nan, 2.0]], dx=1e-3, dy=1e-3))
    >>> header, arrays = unpack(shown.map({"pixels": [2, 2]}, (0.0, 2.0)))
    >>> header["extent"], arrays["index"].tolist()
    ([-0.0005, -0.0005, 0.0015, 0.0015], [[0, 255], [1, 128]])
    """

    def __init__(self, obj: Surface | Profile) -> None:
        if not isinstance(obj, Surface | Profile):
            raise DataError(
                f"a Surface or a Profile can be explored, got {type(obj).__name__}; "
                "make one of it first"
            )
        self.obj = obj
        self._pyramid = build_pyramid(obj) if isinstance(obj, Surface) else None
        self._extremes = Extremes(obj) if isinstance(obj, Profile) else None
        self._transform: tuple[tuple[Pair, ...], ProfileSpectrum] | None = None
        self._n = 0

    @property
    def kind(self) -> str:
        """``"map"`` or ``"profile"``."""
        return "map" if isinstance(self.obj, Surface) else "profile"

    @property
    def first_section(self) -> tuple[Pair, Pair] | None:
        """Ends of the section that is shown first, m: a row through the middle of a map."""
        if self._pyramid is None:
            return None
        x0, y0, x1, y1 = self._pyramid.window
        room, y = _MARGIN * (x1 - x0), (y0 + y1) / 2.0
        return (x0 + room, y), (x1 - room, y)

    def line(self, a: Pair | None = None, b: Pair | None = None) -> Profile:
        """Return the profile itself, or the section of the map."""
        if isinstance(self.obj, Profile):
            return self.obj
        if a is None or b is None:
            raise DataError("a section of a map needs both of its ends, a and b")
        return section_profile(self.obj, a, b)

    def first_band(self, a: Pair | None = None, b: Pair | None = None) -> Pair | None:
        """Return the middle third of the wavelengths, on a logarithmic scale."""
        try:
            waves = 1.0 / self._transformed(a, b).frequency[1:]
        except MetrosepError:
            return None
        if waves.size < 2:
            return None
        long, short = math.log(waves[0]), math.log(waves[-1])
        third = (long - short) / 3.0
        return math.exp(short + third), math.exp(short + 2.0 * third)

    # ---- frames --------------------------------------------------------------------------------

    def map(self, view: Mapping[str, Any] | None = None, limits: Pair | None = None) -> bytes:
        """Return the picture of a window of the map."""
        wanted = view or {}

        def drawn() -> tuple[dict[str, Any], Arrays]:
            if self._pyramid is None:
                _refuse("this measurement is a profile, it has no map")
            found = map_view(
                self._pyramid,
                window=wanted.get("window"),
                pixels=wanted.get("pixels") or (512, 512),
                level=wanted.get("level") or "idle",
                limits=limits,
            )
            header, arrays = map_frame(found, self._pyramid.window)
            return {**header, "auto_range": self._pyramid.robust_range}, arrays

        return self._frame("map", drawn)

    def section(self, a: Pair, b: Pair) -> bytes:
        """Return the section from a to b, read from the map at full resolution."""

        def drawn() -> tuple[dict[str, Any], Arrays]:
            if not isinstance(self.obj, Surface):
                _refuse("this measurement is a profile, it has no sections")
            return section_frame(section_view(self.obj, a, b, columns=_COLUMNS))

        return self._frame("section", drawn)

    def profile(self, window: Sequence[float] | None = None) -> bytes:
        """Return a window of the profile."""

        def drawn() -> tuple[dict[str, Any], Arrays]:
            if self._extremes is None:
                _refuse("this measurement is a map: ask for a section")
            found = profile_view(self._extremes, window=window, columns=_COLUMNS)
            return {"is_preview": False}, profile_arrays(found)

        return self._frame("profile", drawn)

    def spectrum(
        self, a: Pair | None = None, b: Pair | None = None, band: Pair | None = None
    ) -> bytes:
        """Return amplitude against wavelength, of the profile or of the section."""

        def drawn() -> tuple[dict[str, Any], Arrays]:
            found = spectrum_view(
                self._transformed(a, b), band=Band(*band) if band else None, columns=_COLUMNS
            )
            return spectrum_frame(found, unit=lateral_unit(self.obj))

        return self._frame("spectrum", drawn)

    def _transformed(self, a: Pair | None, b: Pair | None) -> ProfileSpectrum:
        """Return the transform of a line; that of the last line is kept while limits move."""
        place = () if a is None or b is None else (a, b)
        if self._transform is None or self._transform[0] != place:
            line = self.line(a, b)
            self._transform = place, profile_spectrum(line, unit=lateral_unit(self.obj))
        return self._transform[1]

    def _frame(self, kind: str, drawn: Callable[[], tuple[dict[str, Any], Arrays]]) -> bytes:
        self._n += 1
        try:
            header, arrays = drawn()
        except MetrosepError as error:
            return pack({"n": self._n, **error_header(str(error), code=_REFUSED, k=kind)})
        return pack({"n": self._n, "k": kind, "ok": True, **header}, arrays)


def _refuse(words: str) -> NoReturn:
    """Refuse a picture: the frame tells why."""
    raise DataError(words)
