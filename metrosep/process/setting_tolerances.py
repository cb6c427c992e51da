"""How well a tool must be set so that the form error stays within what is wanted.

Each factor alone, and all three together in the worst signs, from the exact model. P-V over the
stated region with nothing removed; error = actual - nominal along z.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from metrosep.core._arrays import FloatArray
from metrosep.core.errors import DataError, NotConvergedError, UnitError
from metrosep.core.provenance import freeze_mapping
from metrosep.core.units import format_length
from metrosep.forms.base import Form
from metrosep.process._setting_checks import (
    LARGEST_SETTING,
    finite_positions,
    map_extent,
    real_number,
)
from metrosep.process._setting_model import FACTORS, exact_cut, height_errors, known_form
from metrosep.process.setting_maps import polar_axes

__all__ = ["SettingTolerance", "setting_tolerance"]

_GROWTH = 1.2
_LEAST_SHARE = 1e-12
_CLOSE = 2e-4
_LARGEST_WANTED = 1e-3


@dataclass(frozen=True, slots=True, repr=False)
class SettingTolerance:
    """Largest errors of the setting that a wanted form error allows.

    Parameters
    ----------
    wanted : float, m
        Peak-to-valley height.
    alone : mapping of str to float
        For dx, dy and dR: the largest magnitude when the other two are right, m; infinite where it
        reaches it nowhere.
    together : mapping of str to float
        Magnitudes that may occur at once, with any signs, m: in proportion to a third of each alone.
    sensitivity : mapping of str to float
        P-V per setting for small settings, m/m.
    limiting : str
        The factor that needs most care.
    messages : tuple of str, optional
        In plain words.
    audit : mapping, optional
        Region and mesh.

    Examples
    --------
    >>> from metrosep.forms import SineGrid
    >>> grid = SineGrid(amplitude=50e-9, wavelength=100e-6)
    >>> setting_tolerance(grid, 1e-9, radius=500e-6, azimuths=0.0).limiting
    'dx'
    """

    wanted: float
    alone: Mapping[str, float]
    together: Mapping[str, float]
    sensitivity: Mapping[str, float]
    limiting: str
    messages: tuple[str, ...] = ()
    audit: Mapping[str, Any] = field(default_factory=dict)

    def __repr__(self) -> str:
        inside = ", ".join(
            f"|{n}| <= {format_length(v, digits=3) if math.isfinite(v) else 'any'}"
            for n, v in self.alone.items()
        )
        return f"SettingTolerance({format_length(self.wanted)} P-V: {inside}, each alone)"


def setting_tolerance(
    form: Form,
    wanted: float,
    *,
    radius: float | None = None,
    region: tuple[float, float] | None = None,
    azimuths: ArrayLike | None = None,
    n_rho: int = 201,
    n_theta: int = 72,
) -> SettingTolerance:
    """Return how well the tool must be set for a wanted peak-to-valley form error.

    Parameters
    ----------
    form : Form
        The nominal surface, with the spindle axis at its origin.
    wanted : float, m
        Peak-to-valley error, 0 < wanted <= 1 mm.
    radius : float, m, optional
        Of the workpiece; 500 um with a message if neither it nor a region is given.
    region : tuple of (float, float), m, optional
        Inner and outer radius instead.
    azimuths : array_like, rad, optional
        Lines on which P-V is taken, all together; the whole map if omitted.
    n_rho, n_theta : int, optional
        Of the mesh.

    Returns
    -------
    SettingTolerance
        Each factor alone, and together.

    Raises
    ------
    DataError
        If the form, the region, the azimuths or the wanted error is not usable, or nothing is
        defined.
    InvalidSamplesError
        If an azimuth is not finite.
    UnitError
        If the wanted error or the radius cannot be in metres.
    TooFewSamplesError
        If the mesh has too few points.

    Notes
    -----
    From the linear limit ``wanted / sensitivity`` the setting grows or shrinks to where the exact
    P-V of one of both signs, or of the eight sign combinations, first reaches `wanted`. dx and dy
    are followed up to a tenth of the radius. The core that dy leaves has no height and does not
    count. The paper's "0.25 um gives 1 nm" is an amplitude; 1 nm P-V asks for 0.159 um.

    References
    ----------
    .. [1] Deterministic error compensation for slow tool servo-driven diamond turning,
       section on tool setting.

    Examples
    --------
    >>> from metrosep.forms import SineGrid
    >>> grid = SineGrid(amplitude=50e-9, wavelength=100e-6)
    >>> found = setting_tolerance(grid, 1e-9, radius=500e-6, azimuths=0.0)
    >>> round(found.alone["dx"] * 1e6, 3)
    0.159
    """
    form = known_form(form)
    wanted = _checked_wanted(wanted)
    inner, outer, said = map_extent(radius, region)
    x, y, lines = _points(inner, outer, azimuths, n_rho, n_theta)
    cut = exact_cut(form, np.hypot(x, y), np.arctan2(y, x), 0.0, 0.0, 0.0)
    sensitivity: dict[str, float] = {}
    for name, effect in (("dx", cut.by_dx), ("dy", cut.by_dy), ("dR", cut.by_dR)):
        known = effect[~np.isnan(effect)]
        if not known.size:
            raise DataError(f"the {form.name} is not defined anywhere on the region")
        sensitivity[name] = float(np.ptp(known))
    caps = {n: min(v, outer / 10.0) if n != "dR" else v for n, v in LARGEST_SETTING.items()}
    alone: dict[str, float] = {}
    for name in FACTORS:
        start = min(wanted / max(sensitivity[name], 1e-300), caps[name])
        found = _grown(form, x, y, {name: start}, wanted, caps)[name]
        alone[name] = math.inf if found >= caps[name] else found
        if not math.isfinite(alone[name]):
            said += (
                (
                    f"{name} leaves less than {format_length(wanted)} P-V here up to "
                    f"{format_length(caps[name])}; no larger ones were tried"
                ),
            )
    thirds = {n: min(v, caps[n]) / 3.0 for n, v in alone.items()}
    together = _grown(form, x, y, thirds, wanted, caps)
    if alone["dy"] > inner:
        said += (
            (
                "dy also leaves an uncut core of its own size about the axis, which has no height "
                "and is not in these numbers"
            ),
        )
    limiting = min(alone, key=lambda n: alone[n] / LARGEST_SETTING[n])
    audit = {
        "form": repr(form),
        "wanted_nm": wanted * 1e9,
        "inner_um": inner * 1e6,
        "outer_um": outer * 1e6,
        "where": lines,
        "removed": "nothing",
    }
    return SettingTolerance(
        wanted,
        freeze_mapping(alone),
        freeze_mapping(together),
        freeze_mapping(sensitivity),
        limiting,
        said,
        freeze_mapping(audit),
    )


def _grown(
    form: Form,
    x: FloatArray,
    y: FloatArray,
    sizes: Mapping[str, float],
    wanted: float,
    caps: Mapping[str, float],
) -> dict[str, float]:
    """Return sizes scaled together to the first place where some signs reach the wanted P-V."""

    def reached(share: float) -> float:
        return _worst(form, x, y, {n: share * v for n, v in sizes.items()}) - wanted

    most = min(caps[n] / v for n, v in sizes.items())
    low = min(0.95, most)
    below = reached(low)
    while below > 0.0 and low > _LEAST_SHARE:
        low *= 0.5
        below = reached(low)
    high, above = low, below
    while high < most:
        high = min(high * _GROWTH, most)
        above = reached(high)
        if above > 0.0:
            break
        low, below = high, above
    while high - low > _CLOSE * low:
        share = min(max(below / (below - above), 0.02), 0.98) if math.isfinite(above) else 0.5
        middle = low + share * (high - low)
        left = reached(middle)
        if left <= 0.0:
            low, below = middle, left
        else:
            high, above = middle, left
        if -below <= _CLOSE * wanted:
            break
    return {n: low * v for n, v in sizes.items()}


def _worst(form: Form, x: FloatArray, y: FloatArray, sizes: Mapping[str, float]) -> float:
    """Return the largest exact P-V over all signs; infinite where the nose would gouge."""
    largest = 0.0
    for signs in itertools.product((1.0, -1.0), repeat=len(sizes)):
        signed = {n: s * v for s, (n, v) in zip(signs, sizes.items(), strict=True)}
        values = (signed.get("dx", 0.0), signed.get("dy", 0.0), signed.get("dR", 0.0))
        try:
            e = height_errors(form, x, y, values, exact=True)
        except NotConvergedError:
            return math.inf
        known = e[~np.isnan(e)]
        largest = max(largest, float(np.ptp(known)) if known.size else 0.0)
    return largest


def _points(
    inner: float, outer: float, azimuths: ArrayLike | None, n_rho: int, n_theta: int
) -> tuple[FloatArray, FloatArray, str]:
    if azimuths is None:
        rho, theta = polar_axes((inner, outer), n_rho, n_theta)
        lines = f"polar map of {n_rho} x {n_theta} points"
    else:
        wanted = np.atleast_1d(finite_positions(azimuths, "azimuths")).ravel()
        if not wanted.size:
            raise DataError("azimuths is empty: give at least one line, or None for the whole map")
        rho, _ = polar_axes((inner, outer), n_rho, wanted.size)
        theta = np.broadcast_to(wanted, rho.shape)
        shown = ", ".join(f"{math.degrees(v):.4g}" for v in wanted[:8])
        lines = f"lines at {shown}{' and more' if wanted.size > 8 else ''} degrees"
    return (rho * np.cos(theta)).ravel(), (rho * np.sin(theta)).ravel(), lines


def _checked_wanted(wanted: float) -> float:
    try:
        number = real_number(wanted)
    except (TypeError, ValueError):
        raise DataError(f"the wanted error must be a number in m, got {wanted!r}") from None
    if not (math.isfinite(number) and number > 0.0):
        raise DataError(f"the wanted error must be positive and finite, in m, got {number}")
    if number > _LARGEST_WANTED:
        raise UnitError(
            f"the wanted error is {number:g} m: it is in metres, so {number:g} nm is "
            f"{number * 1e-9:g}"
        )
    return number
