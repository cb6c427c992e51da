"""`SettingError`: the error that a tool setting leaves on a part, on a polar or a square mesh.

error = actual - nominal along z, z out of the material: positive is material left high. NaN is not
cut (the core), outside the region, or where the nominal surface is not defined; the messages say
how many points and why.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from metrosep.core._arrays import FloatArray, frozen_float
from metrosep.core.errors import DataError, InvalidSamplesError, TooFewSamplesError, UnitError
from metrosep.core.provenance import freeze_mapping
from metrosep.core.surface import Surface
from metrosep.core.units import format_length

__all__ = ["SettingError"]

Mesh = Literal["polar", "square"]

DEFAULT_RADIUS = 500e-6
"""m: the workpiece of the slow-tool-servo paper, taken where the caller names none."""

_MOST_POINTS = 20_000_000
_LARGEST_PART = 2.0
"""m: no turned part has a larger radius; from here on a number is in mm or um."""


@dataclass(frozen=True, slots=True, eq=False, repr=False)
class SettingError:
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
            given = getattr(self, name)
            if given is not None:
                array = frozen_float(given, name=name, ndim=2)
                object.__setattr__(self, name, array)
                if array.shape != self.rho.shape:
                    raise InvalidSamplesError(
                        f"{name} has the shape {array.shape}, rho {self.rho.shape}"
                    )
        object.__setattr__(self, "messages", tuple(self.messages))
        object.__setattr__(self, "audit", freeze_mapping(self.audit))

    @property
    def x(self) -> FloatArray:
        """Workpiece x of each point, m."""
        return self.rho * np.cos(self.theta)

    @property
    def y(self) -> FloatArray:
        """Workpiece y of each point, m."""
        return self.rho * np.sin(self.theta)

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

    def rms(self, region: tuple[float, float] | None = None) -> float:
        """Return the area-weighted root mean square about the area-weighted mean.

        Parameters
        ----------
        region : tuple of (float, float), m, optional
            Inner and outer radius; the whole map if omitted.

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


def checked_region(region: object) -> tuple[float, float]:
    """Return inner and outer radius in m, 0 <= inner < outer; refuse anything else."""
    try:
        inner, outer = (_no_flag(v) for v in region)  # type: ignore[attr-defined]
    except (TypeError, ValueError):
        raise DataError(
            f"a region is a pair (inner radius, outer radius) in m, got {region!r}"
        ) from None
    if not (math.isfinite(inner) and math.isfinite(outer) and 0.0 <= inner < outer):
        raise DataError(
            f"a region needs 0 <= inner < outer radius in m, got ({inner}, {outer}); "
            "a radius may be 500e-6 for 500 um"
        )
    plausible_length(outer, "the radius")
    return inner, outer


def _no_flag(value: Any) -> float:
    if isinstance(value, bool | np.bool_):
        raise TypeError("a flag is no length")
    return float(value)


def plausible_length(length: float, name: str) -> None:
    """Refuse a place on a workpiece that can only be in um or mm."""
    if abs(length) > _LARGEST_PART:
        raise UnitError(
            f"{name} is {length:g} m, and no part is that large: lengths are in metres, so {length:g} "
            f"mm is {length * 1e-3:g} and {length:g} um is {length * 1e-6:g}"
        )


def _is_whole(n: object) -> bool:
    return (isinstance(n, int | np.integer) and not isinstance(n, bool)) or (
        isinstance(n, float) and n.is_integer()
    )


def polar_axes(
    region: tuple[float, float], n_rho: int, n_theta: int
) -> tuple[FloatArray, FloatArray]:
    """Return rho and theta of a polar mesh, rows radii from inner to outer, both included."""
    for name, n, least in (("n_rho", n_rho, 2), ("n_theta", n_theta, 1)):
        if not _is_whole(n) or n < least:
            raise TooFewSamplesError(f"{name} must be a whole number >= {least}, got {n!r}")
    _affordable(n_rho * n_theta)
    rho = np.linspace(*region, int(n_rho))
    theta = 2.0 * math.pi * np.arange(int(n_theta)) / int(n_theta)
    shape = (rho.size, theta.size)
    return np.broadcast_to(rho[:, None], shape).copy(), np.broadcast_to(theta, shape).copy()


def square_axes(outer: float, step: float | None) -> tuple[FloatArray, FloatArray, float]:
    """Return x and y of square pixels that hold (0, 0) and reach the rim, and their step."""
    try:
        step = outer / 200.0 if step is None else _no_flag(step)
    except (TypeError, ValueError):
        raise DataError(f"the step must be a length in m, got {step!r}") from None
    if not (math.isfinite(step) and 0.0 < step <= outer):
        raise DataError(
            f"the step must be positive and at most the radius {format_length(outer)}, "
            f"got {step} m"
        )
    n = math.floor(outer / step * (1.0 + 1e-12))
    _affordable((2 * n + 1) ** 2)
    axis = step * np.arange(-n, n + 1, dtype=np.float64)
    x, y = np.meshgrid(axis, axis)
    return x, y, step


def _affordable(n: int) -> None:
    if n > _MOST_POINTS:
        raise DataError(f"the mesh has {n} points, more than {_MOST_POINTS}: take a coarser one")
