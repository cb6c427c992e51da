"""The wavefront that a surface makes of a plane wave: path differences, Zernike terms, image.

The path difference is positive where the material is high (see `metrosep.optics.rays`). Zernike
terms are fitted by least squares with the area of each point as weight, not by inner products.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, Any

import numpy as np

from metrosep.core._arrays import FloatArray
from metrosep.core.errors import DataError
from metrosep.core.provenance import freeze_mapping
from metrosep.core.surface import Surface
from metrosep.forms.base import Form
from metrosep.forms.zernike import Zernike
from metrosep.forms.zernike_index import ZernikeOrder, term_name, to_nm
from metrosep.optics.image_quality import PointSpread, point_spread, strehl_ratio
from metrosep.optics.rays import Mode, Side, path_difference
from metrosep.optics.sampling import Grid, form_points, map_points

if TYPE_CHECKING:
    import pandas as pd

__all__ = ["Wavefront", "ZernikeTable", "wavefront"]

_TERMS = {"piston": (0,), "tilt": (1, 2), "tilt_y": (1,), "tilt_x": (2,), "defocus": (4,)}
"""ANSI numbers of what can be removed."""


@dataclass(frozen=True, slots=True, eq=False)
class ZernikeTable:
    """Zernike terms of a wavefront, normalised to rms (ANSI, Noll) or to the rim (Fringe).

    Parameters
    ----------
    coefficients : mapping of str to float, m
        By name, such as ``"Z4"``.
    u : mapping of str to float, m
        Standard uncertainty from the residual, as if it were independent from point to point.
    nm : tuple of (int, int)
        Radial and azimuthal order of each term.
    order : str
        How the terms are counted.
    radius : float, m
        Of the disc of the polynomials.
    residual_rms : float, m
        What the terms leave.
    """

    coefficients: Mapping[str, float]
    u: Mapping[str, float]
    nm: tuple[tuple[int, int], ...]
    order: str
    radius: float
    residual_rms: float

    def __getitem__(self, name: str) -> float:
        """Return the coefficient of a term in m, by its name."""
        if name not in self.coefficients:
            raise DataError(
                f"no term {name!r} was fitted; there are {', '.join(self.coefficients)}"
            )
        return self.coefficients[name]

    def values(self) -> FloatArray:
        """Return the coefficients in their order.

        Returns
        -------
        ndarray, m
            One for each term.
        """
        return np.array(list(self.coefficients.values()))

    def to_frame(self) -> pd.DataFrame:
        """Return the table.

        Returns
        -------
        DataFrame
            Columns term, n, m, name, coefficient_nm, u_nm.
        """
        import pandas as pd

        return pd.DataFrame(
            {
                "term": list(self.coefficients),
                "n": [n for n, _ in self.nm],
                "m": [m for _, m in self.nm],
                "name": [term_name(n, m) for n, m in self.nm],
                "coefficient_nm": [1e9 * v for v in self.coefficients.values()],
                "u_nm": [1e9 * v for v in self.u.values()],
            }
        )

    def to_dict(self) -> dict[str, Any]:
        """Return the table as plain values.

        Returns
        -------
        dict
            Keys with units.
        """
        return {
            "order": self.order,
            "radius_mm": 1e3 * self.radius,
            "residual_rms_nm": 1e9 * self.residual_rms,
            "coefficients_nm": {k: 1e9 * v for k, v in self.coefficients.items()},
            "u_nm": {k: 1e9 * v for k, v in self.u.items()},
        }


@dataclass(frozen=True, slots=True, eq=False, repr=False)
class Wavefront:
    """Optical path difference over an aperture.

    Parameters
    ----------
    x, y : ndarray, m
        Positions from the optical axis.
    opd : ndarray, m
        Optical path difference; NaN outside the aperture and where nothing was measured.
    weights : ndarray
        Area of each point, 0 outside.
    radius : float, m
        Of the aperture.
    steps : tuple of (float, float) or None, m
        Of a rectangular grid; None on rings.
    mode : {"reflect", "refract"}
        What the surface does.
    n : float or None
        Refractive index of the material.
    removed : tuple of str
        What was taken off.
    messages : tuple of str
        What a reader should know.
    source : Form or None
        The ideal form it was traced from, if it was.
    audit : mapping
        Settings, keys with units.
    """

    x: FloatArray
    y: FloatArray
    opd: FloatArray
    weights: FloatArray
    radius: float
    steps: tuple[float, float] | None
    mode: str
    n: float | None = None
    removed: tuple[str, ...] = ()
    messages: tuple[str, ...] = ()
    source: Form | None = None
    audit: Mapping[str, Any] = field(default_factory=dict)

    def __post_init__(self) -> None:
        for name in ("x", "y", "opd", "weights"):
            array = np.ascontiguousarray(getattr(self, name), dtype=np.float64)
            array = array.copy() if array.flags.writeable else array
            array.setflags(write=False)
            object.__setattr__(self, name, array)
        object.__setattr__(self, "audit", freeze_mapping(self.audit))

    @property
    def rms(self) -> float:
        """Root mean square over the area in m; nothing removed but what `removed` lists."""
        good = ~np.isnan(self.opd)
        w = self.weights[good]
        return float(np.sqrt((w * self.opd[good] ** 2).sum() / w.sum()))

    @property
    def peak_to_valley(self) -> float:
        """Largest minus smallest path difference in m."""
        return float(np.nanmax(self.opd) - np.nanmin(self.opd))

    def zernike(
        self,
        terms: int | Sequence[int] = 37,
        *,
        order: ZernikeOrder = "ansi",
        radius: float | None = None,
    ) -> ZernikeTable:
        """Return Zernike terms by least squares with the area as weight.

        Parameters
        ----------
        terms : int or sequence of int, optional
            How many first terms, or their numbers.
        order : {"ansi", "noll", "fringe"}, optional
            How terms are counted: ANSI from 0, the others from 1.
        radius : float, m, optional
            Of the disc of the polynomials; the aperture if omitted.

        Returns
        -------
        ZernikeTable
            ``table["Z4"]`` is the defocus of ANSI, in m.

        Raises
        ------
        DataError
            If a term or the order does not exist.
        DegenerateFitError
            If the points do not determine the terms.
        """
        form = Zernike(terms, order=order, radius=self.radius if radius is None else radius)
        good = ~np.isnan(self.opd) & (self.weights > 0.0)
        w = self.weights[good] / float(self.weights[good].max())
        fit, left = form.fit_list(self.x[good], self.y[good], self.opd[good], weights=w)
        names = list(fit.form.parameters)
        found = {k: float(v or 0.0) for k, v in fit.form.parameters.items()}
        u = np.full(len(names), np.nan)
        if fit.n_valid > len(names):
            u = np.sqrt(np.maximum(np.diag(fit.covariance), 0.0))
        inside = ~np.isnan(left)
        squares = float((w[inside] * left[inside] ** 2).sum() / w[inside].sum())
        numbers = tuple(int(name[1:]) for name in names)
        return ZernikeTable(
            freeze_mapping(found),
            freeze_mapping(dict(zip(names, (float(v) for v in u), strict=True))),
            tuple(to_nm(j, order) for j in numbers),
            order,
            float(form.radius or self.radius),
            float(np.sqrt(squares)),
        )

    def remove(self, what: Sequence[str]) -> Wavefront:
        """Return the wavefront without the best-fit piston, tilt or defocus.

        Parameters
        ----------
        what : sequence of {"piston", "tilt", "tilt_x", "tilt_y", "defocus"}
            What to take off, fitted together; tilt_x is the term that grows with x.

        Returns
        -------
        Wavefront
            The rest.

        Raises
        ------
        DataError
            If a word is not one of those above.
        DegenerateFitError
            If the points do not determine what is removed.
        """
        names = (what,) if isinstance(what, str) else tuple(what)
        unknown = [name for name in names if name not in _TERMS]
        if unknown:
            raise DataError(f"removed must be of {', '.join(_TERMS)}, got {unknown[0]!r}")
        if not names:
            return self
        terms = sorted({j for name in names for j in _TERMS[name]})
        table = self.zernike(terms)
        fitted = Zernike(terms, coefficients=table.values(), radius=table.radius * (1.0 + 1e-9))
        left = self.opd - fitted(self.x, self.y)
        return replace(self, opd=left, removed=(*self.removed, *names), source=None)

    def minus(self, other: Wavefront) -> Wavefront:
        """Return the increment of the path difference against another wavefront.

        Parameters
        ----------
        other : Wavefront
            Such as that of the ideal form, at the same points.

        Returns
        -------
        Wavefront
            The difference; NaN where either is.

        Raises
        ------
        DataError
            If the points or the modes differ.
        """
        if self.opd.shape != other.opd.shape or not (
            np.abs(self.x - other.x).max() <= 1e-9 * self.radius
            and np.abs(self.y - other.y).max() <= 1e-9 * self.radius
        ):
            raise DataError(
                "the wavefronts were sampled at different points; use one grid for both"
            )
        if (self.mode, self.n) != (other.mode, other.n):
            raise DataError(
                f"one wavefront is {self.mode} with n={self.n}, the other {other.mode} with "
                f"n={other.n}; compare like with like"
            )
        return replace(self, opd=self.opd - other.opd, source=None)

    def strehl(self, wavelength: float, *, removed: Sequence[str] = ("piston", "tilt")) -> float:
        """Return the Strehl ratio: intensity on the axis against that without error.

        Parameters
        ----------
        wavelength : float, m
            Of the light.
        removed : sequence of str, optional
            Taken off first; tilt only moves the image.

        Returns
        -------
        float
            0 to 1, exact for the sampled points.

        Raises
        ------
        DataError
            If the wavelength is not positive, or a word is unknown.
        DegenerateFitError
            If the points do not determine what is removed.
        """
        left = self.remove(removed)
        return strehl_ratio(left.opd, left.weights, wavelength=wavelength)

    def point_spread(
        self,
        wavelength: float,
        *,
        removed: Sequence[str] = ("piston", "tilt"),
        samples: int = 256,
        pad: int = 4,
    ) -> PointSpread:
        """Return the point spread function; its ``modulation_transfer()`` is the contrast.

        Parameters
        ----------
        wavelength : float, m
            Of the light.
        removed : sequence of str, optional
            Taken off first.
        samples : int, optional
            Points along a side, where the wavefront of a form has to be traced anew on squares.
        pad : int, optional
            Size of the field over that of the pupil, >= 2.

        Returns
        -------
        PointSpread
            Directions in rad and intensity.

        Raises
        ------
        DataError
            If the points lie on rings and do not come straight from a form, or a number is wrong.
        TooFewSamplesError
            If the phase turns too fast for the grid.
        DegenerateFitError
            If the points do not determine what is removed.
        """
        here = self._on_squares(samples).remove(removed)
        assert here.steps is not None  # noqa: S101  # _on_squares refuses rings
        return point_spread(here.opd, *here.steps, wavelength=wavelength, pad=pad)

    def to_surface(self) -> Surface:
        """Return the path difference as a map.

        Returns
        -------
        Surface
            Path difference in place of heights.

        Raises
        ------
        DataError
            If the points lie on rings.
        """
        if self.steps is None:
            raise DataError(_NEEDS_SQUARES)
        origin = (float(self.x[0, 0]), float(self.y[0, 0]))
        return Surface(self.opd, *self.steps, origin=origin)

    def _on_squares(self, samples: int) -> Wavefront:
        if self.steps is not None:
            return self
        if self.source is None:
            raise DataError(_NEEDS_SQUARES)
        return wavefront(
            self.source,
            mode=self.mode,  # type: ignore[arg-type]
            n=self.n,
            side=self.audit["side"],
            radius=self.radius,
            inner_radius=1e-3 * float(self.audit["inner_radius_mm"]),
            grid="square",
            samples=samples,
        )

    def __repr__(self) -> str:
        without = f", {', '.join(self.removed)} removed" if self.removed else ""
        glass = "" if self.n is None else f", n = {self.n}"
        return (
            f"Wavefront({self.mode}{glass}, radius {1e3 * self.radius:.6g} mm, rms "
            f"{1e9 * self.rms:.6g} nm, P-V {1e9 * self.peak_to_valley:.6g} nm{without})"
        )


_NEEDS_SQUARES = (
    "the points of this wavefront lie on rings; make it with grid='square', from which images and "
    "maps can be computed"
)


def wavefront(
    surface: Surface | Form,
    *,
    mode: Mode = "reflect",
    n: float | None = None,
    side: Side = "inside",
    radius: float | None = None,
    inner_radius: float = 0.0,
    centre: tuple[float, float] | None = None,
    form: Form | None = None,
    grid: Grid = "polar",
    samples: int | tuple[int, int] | None = None,
) -> Wavefront:
    """Return the wavefront that a surface makes of a plane wave along its axis.

    Parameters
    ----------
    surface : Surface or Form
        A measured map, or an ideal form. Heights count from the vertex plane z = 0.
    mode : {"reflect", "refract"}, optional
        Mirror, or boundary of a material.
    n : float, optional
        Refractive index of the material, to refract.
    side : {"inside", "outside"}, optional
        Whether refracted light leaves the material here, or enters it.
    radius : float, m, optional
        Of the aperture; needed for a form, all that was measured for a map.
    inner_radius : float, m, optional
        Of a central hole.
    centre : tuple of (float, float), m, optional
        Optical axis in the coordinates of a map; the middle of a map without declared origin.
    form : Form, optional
        Ideal surface of a map, about the centre: makes the slopes of a steep part exact.
    grid : {"polar", "square"}, optional
        Points of an ideal form.
    samples : int or tuple of int, optional
        Radii and azimuths on rings (300, 720), or points along the side of a square (256).

    Returns
    -------
    Wavefront
        ``.opd``, ``.zernike()``, ``.rms``, ``.strehl()``, ``.point_spread()``.

    Raises
    ------
    DataError
        If an argument is not one that can be used, or the form is not defined in the aperture.
    InvalidSamplesError
        If a slope is so steep that its ray never comes back.
    TooFewSamplesError
        If fewer than 3 pixels with slopes lie in the aperture.

    Notes
    -----
    Each ray keeps the position where it met the surface. The paper [1]_ states neither the kind of
    wavefront nor the aperture; reflection of a plane wave fits its Table 4 best.

    References
    ----------
    .. [1] Micromachines 11 (2020) 331, section 3.2 and Table 4.

    Examples
    --------
    >>> from metrosep.forms import Toric
    >>> bowl = wavefront(Toric(Rb=265e-3, Rd=132.5e-3), radius=13.74e-3)
    >>> table = bowl.zernike(9)
    >>> round(table["Z4"] * 1e3, 4), round(table["Z5"] * 1e3, 4)  # q5 and q6 of the paper, in mm
    (0.3113, -0.148)
    """
    if isinstance(surface, Form):
        if form is not None or centre is not None:
            raise DataError("form and centre belong to a measured map; an ideal form has its own")
        points = form_points(surface, radius, inner_radius, grid, samples)
    elif isinstance(surface, Surface):
        if samples is not None:
            raise DataError("a measured map has its own points; drop samples")
        points = map_points(surface, radius, inner_radius, centre, form)
    else:
        raise DataError(
            f"the wavefront is that of a Surface or an ideal form, got {type(surface).__name__}"
        )
    used = ~np.isnan(points.z)
    path = path_difference(
        points.z,
        np.where(used, points.slope_x, np.nan),
        np.where(used, points.slope_y, np.nan),
        mode=mode,
        n=n,
        side=side,
    )
    audit = {
        "side": side,
        "inner_radius_mm": 1e3 * inner_radius,
        "grid": "map" if isinstance(surface, Surface) else grid,
        "n_points": int(used.sum()),
    }
    return Wavefront(
        points.x,
        points.y,
        path,
        points.weights,
        points.radius,
        points.steps,
        mode,
        None if n is None else float(n),
        messages=points.messages,
        source=surface if isinstance(surface, Form) else None,
        audit=audit,
    )
