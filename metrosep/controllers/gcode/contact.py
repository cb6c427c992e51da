"""Where a round nose touches a form, and whether a program is the path of that nose over that form.

Tip or centre of a nose of radius r stand at X = X_c - r sin t(X_c) while it touches at X_c; its centre is at
Z = z(X_c) + r cos t(X_c), the offset curve, and the tip r below. A program says so itself: its Z differ from
that curve by one constant in each pass (the zero of the part, tip or centre, an allowance). A form with
the opposite sign or of another part looks errors up at the wrong place, and nothing else would show it.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.typing import ArrayLike

from metrosep.core._arrays import BoolArray, FloatArray
from metrosep.core.errors import DataError
from metrosep.core.units import format_length

Lookup = Callable[[FloatArray, FloatArray], FloatArray]

_NOSE_STEPS, _NOSE_STEP, _NOSE_ROUNDING = 12, 1e-4, 1e-7
"""Newton's steps to the contact, and shares of the nose: of its difference step, and what may be missed."""

_SHARE = 0.01
"""Of the sag: a radius that is 1 % off moves the contact by 1 % of r sin t, less than a pixel of a map."""
_CORRECTED = 10e-6
"""m: more than a correction by other means, which bears no mark, leaves in a path that a nose still cuts."""
_LEAST = 3
"""Blocks of a pass: two do not say which of them leads in."""
_MOST = 4096
"""Places that are kept of a program, evenly."""


class RadialForm(Protocol):
    """A nominal form about the spindle axis."""

    def __call__(self, x: ArrayLike, y: ArrayLike = 0.0) -> FloatArray:
        """Return z, m."""
        ...

    def gradient(self, x: ArrayLike, y: ArrayLike = 0.0) -> tuple[FloatArray, FloatArray]:
        """Return dz/dx and dz/dy."""
        ...


@dataclass(frozen=True, slots=True)
class _Turned:
    """A form with the opposite sign."""

    form: RadialForm

    def __call__(self, x: ArrayLike, y: ArrayLike = 0.0) -> FloatArray:
        return -self.form(x, y)

    def gradient(self, x: ArrayLike, y: ArrayLike = 0.0) -> tuple[FloatArray, FloatArray]:
        along_x, along_y = self.form.gradient(x, y)
        return -along_x, -along_y


class PathPlaces:
    """Places of cutting moves, evenly thinned, with the pass that each belongs to."""

    def __init__(self) -> None:
        """Begin with no place."""
        self.rows = np.empty((0, 4))  # X, C, Z, pass
        self._every, self._count, self._pass = 1, 0, 0

    def add(self, x: FloatArray, c: FloatArray, z: FloatArray, cuts: BoolArray) -> None:
        """Take moves in order; those that do not cut end a pass."""
        parts = self._pass + np.cumsum(~cuts)
        self._pass = int(parts[-1]) if parts.size else self._pass
        found = np.column_stack([x, c, z, parts])[cuts]
        self.rows = np.vstack([self.rows, found[-self._count % self._every :: self._every]])
        self._count += len(found)
        while len(self.rows) > _MOST:
            self.rows = self.rows[::2]
            self._every *= 2


@dataclass(frozen=True, slots=True)
class NosePath:
    """The path of a nose of radius r, m, over a form; without a sense of C the form is cut at angle 0."""

    form: RadialForm
    nose: float
    c_sense: int
    c_zero: float

    def at(self, found: Lookup, measured: Lookup | None = None) -> Lookup:
        """Return a lookup at the contact; where the form has none, a measured value is a gap, a held one stays."""

        def at(x: FloatArray, c: FloatArray) -> FloatArray:
            place = self.touched(x, c)
            none = np.isnan(place)
            at_place = np.where(none, x, place)
            values = np.asarray(found(at_place, c))
            own = values if measured is None else np.asarray(measured(at_place, c))
            return np.where(none & np.isfinite(own), np.nan, values)

        return at

    def touched(self, x: FloatArray, c: FloatArray) -> FloatArray:
        """Return X_c of X_c - r sin t(X_c) = X by Newton's steps; NaN where the form does not reach."""
        nose, angle = self.nose, self._angle(c)
        step, place = _NOSE_STEP * nose, np.array(x)
        reached = np.isfinite(self._sine(place, angle))
        off = np.zeros(x.shape)
        for _ in range(_NOSE_STEPS):
            low, high = self._sine(place - step, angle), self._sine(place + step, angle)
            rise = 1.0 - nose * (high - low) / (2.0 * step)
            if (rise[reached] <= 0.0).any():
                raise DataError(
                    f"a nose of {1e3 * nose:.4g} mm does not fit into the form: its hollows are narrower; check "
                    "nose and form"
                )
            off = place - nose * self._sine(place, angle) - x
            go = np.isfinite(off) & np.isfinite(rise)
            reached &= go
            place[go] -= off[go] / rise[go]
        missed = reached & (np.abs(off) > _NOSE_ROUNDING * nose)
        if missed.any():
            where = 1e3 * float(x[np.flatnonzero(missed)[0]])
            raise DataError(
                f"the place where the nose touches the form is not found at X = {where:.6g} mm; the form is too "
                "rough for this nose"
            )
        return np.where(reached, place, np.nan)

    def require(self, places: FloatArray, where: object, *, held: float = 0.0) -> None:
        """Refuse a path (rows X, C, Z in m and rad, pass) that is not that of this nose over this form.

        `held`, m: how much of a former correction the path may hold.
        """
        off, sag = self._beside(places)
        allowed = max(_SHARE * sag, _CORRECTED, held)
        if not off > allowed:
            return
        try:
            turned = NosePath(_Turned(self.form), self.nose, self.c_sense, self.c_zero)
            fits = turned._beside(places)[0] <= allowed
        except DataError:  # the nose does not fit into the other side
            fits = False
        raise DataError(
            f"{where}: half of its blocks stand more than {format_length(off, digits=3)} beside the path of a nose "
            f"of {format_length(self.nose, digits=4)} over the form, further than a correction "
            f"moves them ({format_length(allowed, digits=3)}): "
            + (
                "the form with the opposite sign fits (a bowl has R > 0, a dome R < 0); turn its sign"
                if fits
                else "check form and nose, or whether the program is that of another part"
            )
        )

    def _beside(self, places: FloatArray) -> tuple[float, float]:
        """Return the medians of how far Z, and the path itself, are from their own medians in each pass."""
        x, c, z, part = places.T
        path = self._centre(x, c)
        known = np.isfinite(path)
        off, sag = [np.zeros(1)], [np.zeros(1)]
        _, parts, sizes = np.unique(part[known], return_inverse=True, return_counts=True)
        order = np.argsort(parts, kind="stable")
        for rows in np.split(order, np.cumsum(sizes)[:-1]):
            if rows.size < _LEAST:
                continue
            held, left = path[known][rows], (z - path)[known][rows]
            off.append(np.abs(left - np.median(left)))
            sag.append(np.abs(held - np.median(held)))
        return float(np.median(np.concatenate(off))), float(np.median(np.concatenate(sag)))

    def _centre(self, x: FloatArray, c: FloatArray) -> FloatArray:
        """Return Z of the centre of the nose where its X is given."""
        place, angle = self.touched(x, c), self._angle(c)
        sine = self._sine(place, angle)
        height = self.form(place * np.cos(angle), place * np.sin(angle))
        return np.asarray(height + self.nose * np.sqrt(1.0 - sine**2))

    def _angle(self, c: FloatArray) -> FloatArray:
        return self.c_sense * c + self.c_zero if self.c_sense else np.zeros(c.shape)

    def _sine(self, x: FloatArray, angle: FloatArray) -> FloatArray:
        """Return the sine of the slope along X."""
        along_x, along_y = self.form.gradient(x * np.cos(angle), x * np.sin(angle))
        steep = along_x * np.cos(angle) + along_y * np.sin(angle)
        return np.asarray(steep / np.hypot(1.0, steep))
