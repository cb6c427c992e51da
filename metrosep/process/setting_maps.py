"""`SettingError`: the error that a tool setting leaves on a part, on a polar or a square mesh.

error = actual - nominal along z, z out of the material: positive is material left high. NaN is not
cut (the core), outside the region, or where the nominal surface is not defined; the messages say
how many points and why.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Any, Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray

from metrosep.core import numbers
from metrosep.core._arrays import FloatArray, frozen_float
from metrosep.core.docs import described_by
from metrosep.core.errors import DataError, InvalidSamplesError, NotConvergedError
from metrosep.core.provenance import freeze_mapping
from metrosep.core.surface import Surface
from metrosep.core.units import format_length
from metrosep.forms.base import Form
from metrosep.process._plain import (
    Frozen,
    OnPart,
    finite_positions,
    length,
    not_above,
    real_array,
    same_places,
)
from metrosep.process._setting_equations import FACTORS, exact_cut, height_errors, known_form

Mesh = Literal["polar", "square"]

DEFAULT_RADIUS = 500e-6
"""m: the workpiece of the slow-tool-servo paper, taken where the caller names none."""

_MOST_POINTS = 20_000_000
LARGEST_PART = 2.0
"""m: no turned part has a larger radius; from here on a number is in mm or um."""


@dataclass(frozen=True, slots=True, eq=False, repr=False)
class SettingError(OnPart):
    """Error of a tool setting over the workpiece.

    Parameters
    ----------
    rho, theta : array_like, shape (n, m)
        Workpiece radius in m and azimuth in rad of each point.
    z : array_like, shape (n, m), m
        Actual - nominal height; NaN where not cut or not defined.
    mesh : {"polar", "square"}
        Rows are radii and columns azimuths, or rows are y and columns x.
    u : array_like, shape (n, m), m, optional
        Standard uncertainty from that of the setting.
    messages : tuple of str, optional
        What is not determined and what was assumed.
    audit : mapping, optional
        Region, mesh and setting, with units in the keys.
    at_points : callable, optional
        From x and y in m to the same error, for `to_surface`.

    Raises
    ------
    InvalidSamplesError
        If an array is not two-dimensional, is infinite, or shapes differ.
    TooFewSamplesError
        If there is no point.

    Examples
    --------
    >>> from metrosep.forms import SineGrid
    >>> from metrosep.process.tool_settings import ToolSetting
    >>> grid = SineGrid(amplitude=50e-9, wavelength=100e-6)
    >>> error = ToolSetting(dx=0.25e-6).error_map(grid, radius=500e-6, n_rho=101, n_theta=72)
    >>> error.z.shape, error.theta[0, 0].item()
    ((101, 72), 0.0)
    """

    rho: FloatArray
    theta: FloatArray
    z: FloatArray
    mesh: Mesh
    u: FloatArray | None = None
    messages: tuple[str, ...] = ()
    audit: Mapping[str, Any] = field(default_factory=dict)
    at_points: Callable[[FloatArray, FloatArray], FloatArray] | None = None

    def __post_init__(self) -> None:
        for name in ("rho", "theta", "z", "u"):
            if getattr(self, name) is not None:
                array = frozen_float(getattr(self, name), name=name, ndim=2)
                object.__setattr__(self, name, array)
                if array.shape != self.rho.shape:
                    raise InvalidSamplesError(
                        f"{name} has the shape {array.shape}, rho {self.rho.shape}"
                    )
        object.__setattr__(self, "messages", tuple(self.messages))
        object.__setattr__(self, "audit", freeze_mapping(self.audit))

    @property
    def area(self) -> FloatArray:
        """Weight of each point by the area it stands for; 1 on a square mesh."""
        return self.rho.copy() if self.mesh == "polar" else np.ones(self.rho.shape)

    @property
    def n_invalid(self) -> int:
        """Number of points without an error."""
        return int(np.count_nonzero(np.isnan(self.z)))

    def peak_to_valley(self, region: tuple[float, float] | None = None) -> float:
        """Return the largest minus the smallest error; nothing is removed or filtered.

        Parameters
        ----------
        region : tuple of (float, float), m, optional
            Inner and outer radius; the whole map if omitted.

        Returns
        -------
        float
            P-V in m; NaN when nothing in the region is valid.
        """
        valid = self._valid(region)
        return float(np.ptp(self.z[valid])) if valid.any() else math.nan

    @described_by(peak_to_valley)
    def rms(self, region: tuple[float, float] | None = None) -> float:
        """Return the area-weighted root mean square about the area-weighted mean.

        Returns
        -------
        float
            In m; NaN when nothing in the region is valid.
        """
        valid = self._valid(region)
        weights, z = self.area[valid], self.z[valid]
        if not z.size or weights.sum() == 0.0:
            return math.nan
        mean = float((weights * z).sum() / weights.sum())
        return math.sqrt(float((weights * (z - mean) ** 2).sum() / weights.sum()))

    def to_surface(self, step: float | None = None) -> Surface:
        """Return the error as a map on square pixels, with the spindle axis at (0, 0).

        Parameters
        ----------
        step : float, m, optional
            Pixel; that of a square mesh, or a 400th of the diameter, if omitted.

        Returns
        -------
        Surface
            Calculated anew at each pixel, nothing interpolated; NaN as here.

        Raises
        ------
        DataError
            If the step does not fit the region, or the map was made without its model.
        """
        if self.at_points is None:
            raise DataError(
                "this map holds no model to calculate pixels from: make it with "
                'ToolSetting.error_map(..., mesh="square")'
            )
        outer = float(self.rho.max() if self.mesh == "polar" else abs(self.x[0]).max())
        inner = float(self.audit.get("inner_um", 0.0)) * 1e-6
        outer = float(self.audit.get("outer_um", outer * 1e6)) * 1e-6
        x, y, dx = square_axes(outer, step)
        z = self.at_points(x, y)
        rho = np.hypot(x, y)
        z[(rho > outer * (1.0 + 1e-12)) | (rho < inner * (1.0 - 1e-12))] = np.nan
        return Surface(
            z,
            dx,
            dx,
            origin=(float(x[0, 0]), float(y[0, 0])),
            metadata={"quantity": "error = actual - nominal along z", "messages": self.messages},
        )

    def _valid(self, region: tuple[float, float] | None) -> NDArray[np.bool_]:
        valid = ~np.isnan(self.z)
        if region is None:
            return valid
        inner, outer = checked_region(region)
        slack = 1e-12 * outer
        return valid & (self.rho >= inner - slack) & (self.rho <= outer + slack)

    def __repr__(self) -> str:
        gaps = f", {self.n_invalid} not determined" if self.n_invalid else ""
        return (
            f"SettingError({self.mesh} {self.z.shape[0]} x {self.z.shape[1]}, "
            f"P-V {format_length(self.peak_to_valley())}{gaps})"
        )


def checked_region(region: Any) -> tuple[float, float]:
    """Return inner and outer radius in m, 0 <= inner < outer."""
    try:
        low, high = region
    except (TypeError, ValueError):
        raise DataError(
            f"a region is a pair (inner radius, outer radius) in m, got {region!r}"
        ) from None
    inner = numbers.quantity(low, "the inner radius of a region", "length")
    outer = numbers.quantity(high, "the outer radius of a region", "length")
    if not 0.0 <= inner < outer:
        raise DataError(
            f"a region needs 0 <= inner < outer radius in m, got ({inner}, {outer}); "
            "a radius may be 500e-6 for 500 um"
        )
    return inner, not_above(outer, "the radius", LARGEST_PART)


def polar_axes(
    region: tuple[float, float], n_rho: int, n_theta: int
) -> tuple[FloatArray, FloatArray]:
    """Return rho and theta of a polar mesh, rows radii from inner to outer, both included."""
    n_rho, n_theta = numbers.count(n_rho, "n_rho", least=2), numbers.count(n_theta, "n_theta")
    _affordable(n_rho * n_theta)
    rho = np.linspace(*region, n_rho)
    theta = 2.0 * math.pi * np.arange(n_theta) / n_theta
    shape = (rho.size, theta.size)
    return np.broadcast_to(rho[:, None], shape).copy(), np.broadcast_to(theta, shape).copy()


def square_axes(outer: float, step: float | None) -> tuple[FloatArray, FloatArray, float]:
    """Return x and y of square pixels that hold (0, 0) and reach the rim, and their step."""
    step = outer / 200.0 if step is None else length(step, "step")
    if step > outer:
        raise DataError(
            f"the step must be at most the radius {format_length(outer)}, got {step} m"
        )
    n = math.floor(outer / step * (1.0 + 1e-12))
    _affordable((2 * n + 1) ** 2)
    axis = step * np.arange(-n, n + 1, dtype=np.float64)
    x, y = np.meshgrid(axis, axis)
    return x, y, step


def _affordable(n: int) -> None:
    if n > _MOST_POINTS:
        raise DataError(f"the mesh has {n} points, more than {_MOST_POINTS}: take a coarser one")


# ---- how well a tool must be set so that the form error stays within what is wanted ------------
# Each factor alone, and all three together in the worst signs, from the exact model. P-V over the
# stated region with nothing removed; error = actual - nominal along z.

_GROWTH = 1.2
_LEAST_SHARE = 1e-12
_CLOSE = 2e-4
_LARGEST_WANTED = 1e-3


@dataclass(frozen=True, slots=True, repr=False)
class SettingTolerance(Frozen):
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
    wanted = length(wanted, "the wanted error", _LARGEST_WANTED)
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
            said.append(
                f"{name} leaves less than {format_length(wanted)} P-V here up to "
                f"{format_length(caps[name])}; no larger ones were tried"
            )
    thirds = {n: min(v, caps[n]) / 3.0 for n, v in alone.items()}
    together = _grown(form, x, y, thirds, wanted, caps)
    if alone["dy"] > inner:
        said.append(
            "dy also leaves an uncut core of its own size about the axis, which has no height and is "
            "not in these numbers"
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
    return SettingTolerance(wanted, alone, together, sensitivity, limiting, tuple(said), audit)


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
        dx, dy, dR = (signed.get(n, 0.0) for n in FACTORS)
        try:
            e = height_errors(form, x, y, (dx, dy, dR), exact=True)
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


# ---- private: what a tool setting, its uncertainty, a position and a region may be -------------

LARGEST_NOSE = 0.1
"""m: no round nose of a turning tool is larger; from here on a number is in mm."""
LARGEST_SETTING = {"dx": 1e-3, "dy": 1e-3, "dR": 10e-3}
"""m: more than this is a number in um or mm that lost its unit."""


def checked_uncertainty(value: Any, name: str) -> float | None:
    """Return a standard uncertainty in m, infinite where a factor is not determined; None stays."""
    if value is None:
        return None
    if not isinstance(value, str) and numbers.is_real(value) and float(value) == math.inf:
        return math.inf
    return not_above(numbers.not_negative(value, name, dimension="length"), name, 10e-3)


def checked_covariance(cov: ArrayLike) -> FloatArray:
    """Return the covariance of (dx, dy, dR), read-only; an infinite variance says "not measured"."""
    array = real_array(cov, "cov")
    if array.shape != (3, 3):
        raise InvalidSamplesError(f"cov must be 3 x 3 for (dx, dy, dR), got shape {array.shape}")
    diagonal = np.diag(array)
    if np.isnan(array).any() or (diagonal < 0.0).any():
        raise DataError("cov holds NaN or a negative variance; a covariance has neither")
    if np.isfinite(array).all():
        scale = np.sqrt(np.where(diagonal > 0.0, diagonal, 1.0))
        unit = array / np.outer(scale, scale)
        if np.abs(unit - unit.T).max() > 1e-9 or np.linalg.eigvalsh(unit).min() < -1e-9:
            raise DataError("cov is not symmetric and positive: it is not a covariance")
        return frozen_float(array, name="cov", ndim=2)
    array.setflags(write=False)
    return array


def positions(x: ArrayLike, y: ArrayLike) -> tuple[FloatArray, FloatArray]:
    """Return x and y on the workpiece, finite and of one shape."""
    found = {"x": finite_positions(x, "x"), "y": finite_positions(y, "y")}
    for name, array in found.items():
        plausible_places(array, name)
    xs, ys = same_places(**found)
    return xs, ys


def plausible_places(places: FloatArray, name: str) -> None:
    """Refuse places on a workpiece that can only be in um or mm."""
    not_above(float(np.abs(places).max(initial=0.0)), name, LARGEST_PART)


def map_extent(
    radius: float | None, region: tuple[float, float] | None
) -> tuple[float, float, list[str]]:
    """Return inner and outer radius in m, and what to say of them."""
    if region is not None and radius is not None:
        raise DataError("give either a radius or a region, not both")
    if region is None and radius is None:
        said = f"no radius was given: the map reaches to {format_length(DEFAULT_RADIUS)}"
        return 0.0, DEFAULT_RADIUS, [said]
    return *checked_region((0.0, radius) if region is None else region), []
