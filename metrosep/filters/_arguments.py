"""Private helpers: checks of what a filter is asked to do, before it does it."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any, Literal, TypeVar

import numpy as np

from metrosep.core._arrays import FloatArray
from metrosep.core.errors import (
    DataError,
    Example,
    InvalidSamplesError,
    TooFewSamplesError,
)
from metrosep.core.numbers import choice, positive
from metrosep.core.profile import Profile
from metrosep.core.provenance import Step
from metrosep.core.surface import Surface
from metrosep.core.units import format_length
from metrosep.spectral.dft import instance_of

FilterBand = Literal["long", "short"]

Measured = TypeVar("Measured", bound=Profile | Surface)

Wavelength = float | str | None
"""Of a profile, in m or a text with its unit."""

Wavelengths = float | str | tuple[float | str, float | str] | None
"""Of a surface, one for both axes or ``(x, y)``."""

DOCS = {
    "obj": """
        obj : Profile or Surface
            Uniform; NaN = not measured.
        """,
    "cutoff": """
        cutoff : float (m) or str with unit
            Cut-off wavelength of a profile: more than two steps, at most its measured length
            ``n dx``.
        nesting_index : float (m), str with unit, or a pair of them
            Cut-off of a surface, one for both axes or ``(x, y)``; limits as of `cutoff`.
        """,
    "refilter": """
        refilter : bool, optional
            Filter a roughness profile, or take the short band of a surface, once more.
        """,
    "element": """
        radius : float (m) or str with unit, optional
            Radius of the disc (profile) or ball (surface), at least one step.
        length : float (m) or str with unit, optional
            Length of the flat segment (profile) or side of the square (surface), from two steps up
            to the measured length ``n dx``. Give one of the two.
        """,
    "twice": """
        DoubleFilterError
            If the profile is a roughness profile, or the short band of a surface is asked that has
            passed a filter with the short band already, and `refilter` is false.
        """,
    "uniform": """
        NotUniformError
            If the positions of the profile are not uniform.
        """,
    "element_raises": """
        InvalidSamplesError
            If `radius` or `length` is not positive and finite.
        NotUniformError
            If the positions of the profile are not uniform.
        TooFewSamplesError
            If nothing was measured, or there is one sample only.
        """,
}
"""Parts of the docstrings of the filters."""

SHORTFALL = 0.1
"""Of one section: a length that lacks no more than this of n cut-offs holds n sections.

Instruments round a section to whole samples, and a lambda_s filter with cut ends takes one lambda_s
at each end: 1/15 of a section where lambda_c / lambda_s is 30, the smallest standard ratio.
"""

ON_LIMIT = 1e-9
"""A wavelength this close to a limit, relative, lies on it: decimals are not exact in binary."""

ALL_THE_SAME = "(refilter=True in Python does it all the same)"
"""How a refusal to filter twice ends; a recipe gets its own words (`metrosep.recipe.step_help`)."""

_L_FILTERS = ("gaussian", "spline", "robust_gaussian")
"""Names in the history of filters by cut-off."""


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

    @property
    def named(self) -> dict[str, float]:
        """The cut-offs under the names that people use."""
        if len(self.wavelengths) == 1:
            return {"cutoff_m": self.wavelengths[0]}
        return {"nesting_index_x_m": self.wavelengths[1], "nesting_index_y_m": self.wavelengths[0]}

    def place(self, low: FloatArray, shape: tuple[int, ...]) -> FloatArray:
        """Return a result on the grid of the object, NaN outside the box."""
        whole = np.full(shape, np.nan)
        whole[self.inside] = low
        return whole


def check_band(band: str) -> None:
    """Refuse a band that is neither long nor short."""
    choice(band, "band", ("long", "short"))


def check_object(obj: object) -> None:
    """Refuse what is neither a profile nor a surface, such as a bare array."""
    instance_of(obj, (Profile, Surface), "a filter")


def check_single_filtering(obj: Profile | Surface, refilter: bool, *, band: str = "long") -> None:
    """Refuse a roughness profile, or a surface whose long waves are out, unless told otherwise.

    A surface has no kind, so its history is asked: its long waves may be taken off only once. What
    is long may still be taken, as by an S-filter after the L-filter.
    """
    if refilter:
        return
    if isinstance(obj, Profile):
        if profile_kind(obj) == "R":
            raise DoubleFilterError(
                "the profile is a roughness profile already: filtering it again makes its "
                f"parameters too small; start from the primary profile {ALL_THE_SAME}"
            )
        return
    before = [
        s.name for s in obj.history if s.name in _L_FILTERS and s.parameters.get("band") == "short"
    ]
    if band == "short" and before:
        raise DoubleFilterError(
            f"the surface has passed the filter {before[-1]} with band short already: filtering it "
            "again makes its parameters too small; start from the surface before that filter "
            f"{ALL_THE_SAME}"
        )


def check_not_repeated(profile: Profile) -> None:
    """Refuse a closed profile over one turn whose last sample repeats the first."""
    if len(profile) < 2:
        raise TooFewSamplesError("a closed profile needs at least 2 samples, got 1")
    span = float(profile.x[-1] - profile.x[0])
    if abs(span - 2.0 * math.pi) < 0.1 * profile.dx:
        raise InvalidSamplesError(
            "x spans one whole turn of 2 pi including both ends, so the last sample repeats the "
            "first; a closed profile has the period n dx: drop the last sample"
        )


def surface_steps(surface: Surface) -> tuple[float, float]:
    """Return ``(dy, dx)`` of a laterally calibrated surface."""
    if surface.dx is None or surface.dy is None:
        missing = " and ".join(n for n in ("dx", "dy") if getattr(surface, n) is None)
        raise DataError(
            f"the surface has no lateral step {missing}, so a wavelength in m means nothing; "
            "read the file with lateral_step=..."
        ).hinting(lateral_step=Example("3 um"))
    return surface.dy, surface.dx


def require_valid(z: FloatArray, minimum: int, what: str) -> None:
    """Refuse data with fewer valid samples than a method needs."""
    n_valid = int(np.count_nonzero(~np.isnan(z)))
    if n_valid < minimum:
        raise TooFewSamplesError(
            f"{what} needs at least {counted(minimum, 'measured sample')}, "
            f"got {n_valid} of {z.size}"
        )


def task_of(
    obj: Profile | Surface,
    cutoff: object,
    nesting_index: object,
    *,
    what: str,
    areal: str,
    minimum: tuple[int, int],
    closed: bool = False,
    name: str = "cutoff",
) -> Task:
    """Return the checked task of a filter; what it is called, and its least samples, of each kind."""
    if isinstance(obj, Surface):
        return surface_task(obj, cutoff, nesting_index, areal, minimum[1], closed=closed)
    if closed:
        check_not_repeated(obj)
    return profile_task(obj, cutoff, nesting_index, what, minimum[0], closed=closed, name=name)


def profile_task(
    profile: Profile,
    cutoff: object,
    nesting_index: object,
    what: str,
    minimum: int,
    *,
    closed: bool = False,
    name: str = "cutoff",
) -> Task:
    """Return the checked task of a profile filter; all of a closed one lies inside."""
    if nesting_index is not None:
        raise DataError("nesting_index is for surfaces; a profile takes cutoff=, in m")
    if cutoff is None:
        raise DataError("a profile filter needs cutoff=, a wavelength in m")
    require_valid(profile.z, minimum, what)
    dx = profile.dx
    inside = (slice(0, len(profile)),) if closed else measured_box(profile.z)
    z = profile.z[inside]
    wavelength = checked_wavelength(cutoff, name, dx, dx * z.size)
    return Task(z, inside, (dx,), (wavelength,))


def surface_task(
    surface: Surface,
    cutoff: object,
    nesting_index: object,
    what: str,
    minimum: int,
    *,
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
    whole = (slice(0, surface.shape[0]), slice(0, surface.shape[1]))
    inside = whole if closed else measured_box(surface.z)
    z = surface.z[inside]
    n_y, n_x = z.shape
    if min(n_x, n_y) < 3:
        raise TooFewSamplesError(
            f"{what} needs at least 3 measured rows and 3 columns, got {n_y} x {n_x}"
        )
    wavelengths = (
        checked_wavelength(index_y, "nesting_index in y", dy, dy * n_y),
        checked_wavelength(index_x, "nesting_index in x", dx, dx * n_x),
    )
    return Task(z, inside, (dy, dx), wavelengths)


def measured_box(z: FloatArray) -> tuple[slice, ...]:
    """Return the smallest box around the valid samples; there is at least one."""
    valid = ~np.isnan(z)
    box = []
    for axis in range(z.ndim):
        others = tuple(a for a in range(z.ndim) if a != axis)
        index = np.flatnonzero(valid.any(axis=others))
        box.append(slice(int(index[0]), int(index[-1]) + 1))
    return tuple(box)


def finish(obj: Measured, low: FloatArray, *, band: FilterBand, step: Step) -> Measured:
    """Return the asked side of a filter as the kind of object that came in."""
    z = low if band == "long" else obj.z - low
    return like(obj, z, step=step, short=band == "short")


def like(
    obj: Measured,
    z: FloatArray,
    *,
    step: Step,
    short: bool,
    kept: tuple[slice, ...] | None = None,
) -> Measured:
    """Return heights as the kind of object that came in, with one step more; `kept` cuts the grid."""
    if isinstance(obj, Profile):
        x = obj.x if kept is None else obj.x[kept]
        return filtered_profile(obj, z, step=step, kind=kind_of_band(obj, short=short), x=x)  # type: ignore[return-value]
    return Surface(  # type: ignore[return-value]
        z,
        obj.dx,
        obj.dy,
        origin=obj.origin if kept is None else cut_origin(obj, kept),
        metadata=obj.metadata,
        history=(*obj.history, step),
    )


def cut_origin(surface: Surface, kept: tuple[slice, ...]) -> tuple[float, float]:
    """Return the position of the first pixel that is kept."""
    return (
        surface.origin[0] + kept[1].start * (surface.dx or 0.0),
        surface.origin[1] + kept[0].start * (surface.dy or 0.0),
    )


def kind_of_band(profile: Profile, *, short: bool) -> ProfileKind | None:
    """Return the kind of a side of a filter: what lies below a wave of waviness is waviness."""
    before = profile_kind(profile)
    return "R" if short and before != "W" else before


def checked_wavelength(value: object, name: str, step: float, length: float) -> float:
    """Return a cut-off that exceeds two steps and is at most the length ``n dx``, whoever filters."""
    wavelength = positive(value, name, dimension="length")
    limit = 2.0 * step
    if wavelength <= limit * (1.0 + ON_LIMIT):
        given, least = _told_apart(wavelength, limit)
        raise DataError(
            f"{name} {given} does not exceed the sampling limit of two steps, {least}: shorter "
            "waves are not in the data; is the unit m?"
        )
    check_not_longer(wavelength, name, length)
    return wavelength


def check_not_longer(size: float, name: str, length: float) -> None:
    """Refuse a cut-off or an element longer than what was measured: n steps of n samples."""
    if size > length * (1.0 + ON_LIMIT):
        given, longest = _told_apart(size, length)
        raise DataError(
            f"{name} {given} is longer than what was measured, {longest}: remove a form instead, or "
            "measure a longer piece"
        )


def counted(n: int, noun: str) -> str:
    """Return a number with its noun, such as ``1 sample`` and ``2 samples``."""
    return f"{n} {noun}" if n == 1 else f"{n} {noun}s"


def _told_apart(a: float, b: float) -> tuple[str, str]:
    """Return two lengths with as many digits, from four on, as tell them apart; equal ones with 4."""
    for digits in range(4, 10):
        texts = format_length(a, digits=digits), format_length(b, digits=digits)
        if texts[0] != texts[1]:
            return texts
    return format_length(a), format_length(b)


# ---- which profile a profile is: primary (P), waviness (W) or roughness (R), and who said so ----
# A roughness profile that is filtered again gives too small numbers without any sign of it. So the
# kind travels with the object: readers take it from the file (``metadata["profile_kind"]``), filters
# set it, parameters look at it.

ProfileKind = Literal["P", "W", "R"]


class DoubleFilterError(DataError):
    """A profile that was filtered already would be filtered the same way again."""


def profile_kind(profile: Profile) -> ProfileKind | None:
    """Return the kind of a profile as its file or the last filter declares it.

    Parameters
    ----------
    profile : Profile
        Any.

    Returns
    -------
    {"P", "W", "R"} or None
        None where nobody has said it.

    Examples
    --------
    >>> profile_kind(Profile([0, 1e-6], [0, 0], metadata={"profile_kind": "R"}))
    'R'
    """
    kind = profile.metadata.get("profile_kind")
    return kind if kind in ("P", "W", "R") else None


def filtered_profile(
    profile: Profile, z: Any, *, step: Step, kind: ProfileKind | None, x: Any = None
) -> Profile:
    """Return a profile with filtered heights, its kind and one more step of history."""
    metadata = {**profile.metadata, "profile_kind": kind}
    return Profile(
        profile.x if x is None else x, z, metadata=metadata, history=(*profile.history, step)
    )
