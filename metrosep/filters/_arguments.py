"""Private helpers: checks of what a filter is asked to do, before it does it."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from metrosep.core.errors import DataError, InvalidSamplesError, TooFewSamplesError
from metrosep.core.profile import Profile
from metrosep.core.provenance import Step
from metrosep.core.surface import Surface
from metrosep.core.units import format_length
from metrosep.filters.kind import DoubleFilterError, filtered_profile, profile_kind

FloatArray = NDArray[np.float64]
FilterBand = Literal["long", "short"]

_ON_LIMIT = 1e-9
"""A wavelength this close to a limit, relative, lies on it: decimals are not exact in binary."""


@dataclass(frozen=True, slots=True)
class Task:
    """What a filter works on; tuples are per axis, in the order of the array.

    `inside` is the smallest box around what was measured: a filter sees ``obj.z[inside]`` only, so
    that rows which were not measured change nothing.
    """

    z: FloatArray
    inside: tuple[slice, ...]
    steps: tuple[float, ...]
    wavelengths: tuple[float, ...]

    def place(self, low: FloatArray, shape: tuple[int, ...]) -> FloatArray:
        """Return a result on the grid of the object, NaN outside the box."""
        whole = np.full(shape, np.nan)
        whole[self.inside] = low
        return whole


def check_band(band: str) -> None:
    """Refuse a band that is neither long nor short."""
    if band not in ("long", "short"):
        raise DataError(
            f'band must be "long" (the mean line) or "short" (what it leaves), got {band!r}'
        )


def check_single_filtering(profile: Profile, refilter: bool) -> None:
    """Refuse a roughness profile unless the caller insists."""
    if profile_kind(profile) == "R" and not refilter:
        raise DoubleFilterError(
            "the profile is a roughness profile already: filtering it again makes its parameters "
            "too small; start from the primary profile, or say refilter=True"
        )


def surface_steps(surface: Surface) -> tuple[float, float]:
    """Return ``(dy, dx)`` of a laterally calibrated surface."""
    if surface.dx is None or surface.dy is None:
        missing = " and ".join(n for n in ("dx", "dy") if getattr(surface, n) is None)
        raise DataError(
            f"the surface has no lateral step {missing}, so a wavelength in m means nothing; "
            "give the steps: Surface(z, dx, dy)"
        )
    return surface.dy, surface.dx


def require_valid(z: FloatArray, minimum: int, what: str) -> None:
    """Refuse data with fewer valid samples than a method needs."""
    n_valid = int(np.count_nonzero(~np.isnan(z)))
    if n_valid < minimum:
        raise TooFewSamplesError(
            f"{what} needs at least {minimum} measured samples, got {n_valid} of {z.size}"
        )


def profile_task(
    profile: Profile,
    *,
    cutoff: object,
    nesting_index: object,
    what: str,
    minimum: int,
    closed: bool = False,
) -> Task:
    """Return the checked task of a profile filter; the length of a closed one is ``n dx``."""
    if nesting_index is not None:
        raise DataError("nesting_index is for surfaces; a profile takes cutoff=, in m")
    if cutoff is None:
        raise DataError("a profile filter needs cutoff=, a wavelength in m")
    require_valid(profile.z, minimum, what)
    dx = profile.dx
    inside = (slice(0, len(profile)),) if closed else _measured_box(profile.z)
    z = profile.z[inside]
    wavelength = _wavelength(cutoff, "cutoff", dx, dx * (z.size if closed else z.size - 1))
    return Task(z, inside, (dx,), (wavelength,))


def surface_task(
    surface: Surface,
    *,
    cutoff: object,
    nesting_index: object,
    what: str,
    minimum: int,
    closed: bool = False,
) -> Task:
    """Return the checked task of an areal filter; one index serves both axes."""
    if cutoff is not None:
        raise DataError("cutoff is for profiles; a surface takes nesting_index=, in m")
    if nesting_index is None:
        raise DataError("an areal filter needs nesting_index=, a wavelength in m or a pair (x, y)")
    dy, dx = surface_steps(surface)
    if isinstance(nesting_index, tuple | list | np.ndarray):
        if len(nesting_index) != 2:
            raise DataError(
                f"nesting_index must be one number or a pair (x, y), got {len(nesting_index)}"
            )
        index_x, index_y = nesting_index
    else:
        index_x = index_y = nesting_index
    require_valid(surface.z, minimum, what)
    inside = _measured_box(surface.z)
    if closed:
        inside = (slice(0, surface.shape[0]), slice(0, surface.shape[1]))
    z = surface.z[inside]
    n_y, n_x = z.shape
    if min(n_x, n_y) < 3:
        raise TooFewSamplesError(
            f"{what} needs at least 3 measured rows and 3 columns, got {n_y} x {n_x}"
        )
    ends = 0 if closed else 1
    wavelengths = (
        _wavelength(index_y, "nesting_index in y", dy, dy * (n_y - ends)),
        _wavelength(index_x, "nesting_index in x", dx, dx * (n_x - ends)),
    )
    return Task(z, inside, (dy, dx), wavelengths)


def _measured_box(z: FloatArray) -> tuple[slice, ...]:
    valid = ~np.isnan(z)
    box = []
    for axis in range(z.ndim):
        others = tuple(a for a in range(z.ndim) if a != axis)
        index = np.flatnonzero(valid.any(axis=others))
        box.append(slice(int(index[0]), int(index[-1]) + 1))
    return tuple(box)


def finish(
    obj: Profile | Surface, low: FloatArray, *, band: FilterBand, step: Step
) -> Profile | Surface:
    """Return the asked side of a filter as the kind of object that came in."""
    z = low if band == "long" else obj.z - low
    if isinstance(obj, Profile):
        kind = "R" if band == "short" else profile_kind(obj)
        return filtered_profile(obj, z, step=step, kind=kind)
    return Surface(
        z, obj.dx, obj.dy, origin=obj.origin, metadata=obj.metadata, history=(*obj.history, step)
    )


def _wavelength(value: object, name: str, step: float, length: float) -> float:
    try:
        wavelength = float(value)  # type: ignore[arg-type]
    except (TypeError, ValueError):
        raise DataError(f"{name} must be a wavelength in m, got {value!r}") from None
    if not (math.isfinite(wavelength) and wavelength > 0.0):
        raise InvalidSamplesError(f"{name} must be positive and finite, got {wavelength} m")
    if wavelength < 2.0 * step * (1.0 - _ON_LIMIT):
        raise DataError(
            f"{name} {format_length(wavelength)} lies below the sampling limit of two steps, "
            f"{format_length(2.0 * step)}: such waves are not in the data; is the unit m?"
        )
    if wavelength > length * (1.0 + _ON_LIMIT):
        raise DataError(
            f"{name} {format_length(wavelength)} is longer than the data, "
            f"{format_length(length)}: remove a form instead, or measure a longer piece"
        )
    return wavelength
