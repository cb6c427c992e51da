"""Headers and arrays of the pictures of a map or profile, for the page and for notebooks alike."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, Literal, TypeAlias

from numpy.typing import NDArray

from metrosep.core.profile import Profile
from metrosep.core.surface import Surface

if TYPE_CHECKING:
    from metrosep.app.map_views import MapView
    from metrosep.app.profile_views import ProfileView
    from metrosep.app.section_views import SectionView
    from metrosep.app.spectrum_views import SpectrumView

__all__ = ["lateral_unit", "map_frame", "profile_arrays", "section_frame", "spectrum_frame"]

Arrays: TypeAlias = dict[str, NDArray[Any]]
Frame: TypeAlias = tuple[dict[str, Any], Arrays]
"""Header and arrays."""


def lateral_unit(obj: Surface | Profile) -> Literal["m", "px"]:
    """Return the unit of positions and wavelengths.

    Examples
    --------
    >>> lateral_unit(Surface([[0.0, 1e-9]])), lateral_unit(Surface([[0.0]], dx=1e-6, dy=1e-6))
    ('px', 'm')
    """
    return "px" if isinstance(obj, Surface) and None in (obj.dx, obj.dy) else "m"


def map_frame(view: MapView, extent: object, *, is_preview: bool = False) -> Frame:
    """Return the picture of a map."""
    header = {
        "range": view.range,
        "window": view.window,
        "scale": view.scale,
        "unit": view.unit,
        "coverage": view.coverage,
        "is_preview": is_preview or view.is_preview,
        "extent": extent,
    }
    shade = {} if view.shade is None else {"shade": view.shade}
    return header, {"index": view.index, **shade}


def section_frame(view: SectionView, *, is_preview: bool = False) -> Frame:
    """Return a section."""
    header = {
        "length": view.length,
        "pv": view.pv,
        "sq": view.sq,
        "share_valid": view.share_valid,
        "unit": view.unit,
        "is_preview": is_preview,
    }
    return header, {"distance": view.distance, "low": view.low, "high": view.high}


def profile_arrays(view: ProfileView, before: str = "") -> Arrays:
    """Return the lines of a profile."""
    return {f"{before}x": view.x, f"{before}low": view.low, f"{before}high": view.high}


def spectrum_frame(
    view: SpectrumView, *, unit: Literal["m", "px"] = "m", is_preview: bool = False
) -> Frame:
    """Return amplitude against wavelength."""
    header = {
        "inside": view.inside,
        "outside": view.outside,
        "messages": list(view.messages),
        "unit": unit,
        "is_preview": is_preview,
    }
    arrays: Arrays = {
        "wavelength": view.wavelength,
        "amplitude": view.amplitude,
        "in_band": view.in_band,
    }
    return header, arrays
