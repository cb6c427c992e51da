"""The wavefront that a surface makes of a plane wave: path differences, Zernike terms, image.

The path difference is positive where the material is high (see `metrosep.optics.rays`). Zernike
terms are fitted by least squares with the area of each point as weight, not by inner products.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from metrosep.core._arrays import FloatArray, position
from metrosep.core.errors import DataError, InvalidSamplesError, TooFewSamplesError
from metrosep.core.numbers import choice, positive, quantity
from metrosep.core.provenance import freeze_mapping
from metrosep.core.public import PublicObject, shortened
from metrosep.core.surface import Surface
from metrosep.core.units import format_length
from metrosep.forms.base import Form
from metrosep.forms.zernike import Zernike, ZernikeOrder, term_name, to_nm
from metrosep.forms.zernike_fit import RIM
from metrosep.optics.image_quality import PointSpread, point_spread, strehl_ratio
from metrosep.optics.rays import (
    Mode,
    Side,
    check_mode,
    freeze_fields,
    path_difference,
    path_sensitivity,
    wavelength_of,
)
from metrosep.optics.sampling import GRIDS, Grid, Sampled, form_points, map_points

if TYPE_CHECKING:
    import pandas as pd


@dataclass(frozen=True, slots=True, eq=False)
class ZernikeTable:
    """Zernike terms of a wavefront, normalised to rms (ANSI, Noll) or to the rim (Fringe).

    Parameters
    ----------
    coefficients : mapping of str to float, m
        By name, such as ``"Z4"``.
    u : mapping of str to float, m
        Standard uncertainty from the residual, as if it were independent from point to point. NaN,
        with a message, where there are no more points than terms.
    nm : tuple of (int, int)
        Radial and azimuthal order of each term.
    order : str
        How the terms are counted.
    radius : float, m
        Of the disc of the polynomials.
    residual_rms : float, m
        What the terms leave within the disc.
    messages : tuple of str
        What a reader should know, of the wavefront too.
    """

    coefficients: Mapping[str, float]
    u: Mapping[str, float]
    nm: tuple[tuple[int, int], ...]
    order: str
    radius: float
    residual_rms: float
    messages: tuple[str, ...] = ()

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
            "messages": list(self.messages),
        }


def fit_table(
    points: tuple[FloatArray, FloatArray, FloatArray, FloatArray],
    terms: int | Sequence[int],
    order: ZernikeOrder,
    radius: float,
    messages: tuple[str, ...] = (),
) -> ZernikeTable:
    """Return Zernike terms through points by least squares with the area as weight."""
    disc = positive(radius, "radius", dimension="length")
    form = Zernike(terms, order=order, radius=disc)
    x, y, path, area = points
    w = area / float(area.max())
    fit, left = form.fit_list(x, y, path, weights=w)
    names = list(fit.form.parameters)
    inside = ~np.isnan(left)
    notes = list(messages)
    if not inside.all():
        notes.append(
            f"{int((~inside).sum())} of {inside.size} points lie outside the disc of the terms, "
            f"radius {1e3 * disc:.6g} mm"
        )
    u = np.full(len(names), np.nan)
    if fit.n_valid > len(names):
        u = np.sqrt(np.maximum(np.diag(fit.covariance), 0.0))
    else:
        notes.append(f"{len(names)} terms of {fit.n_valid} points leave no uncertainty to tell")
    squares = float((w[inside] * left[inside] ** 2).sum() / w[inside].sum())
    return ZernikeTable(
        freeze_mapping({k: float(v or 0.0) for k, v in fit.form.parameters.items()}),
        freeze_mapping(dict(zip(names, (float(v) for v in u), strict=True))),
        tuple(to_nm(int(name[1:]), order) for name in names),
        order,
        disc,
        float(np.sqrt(squares)),
        tuple(notes),
    )


@dataclass(frozen=True, slots=True, eq=False, repr=False)
class Wavefront(PublicObject):
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
    side : {"inside", "outside"}, optional
        Where refracted light comes from; "inside" for a mirror.

    Raises
    ------
    DataError
        If mode, n and side do not fit together, or the radius or a step is not positive.
    InvalidSamplesError
        If an array does not hold finite real numbers, shapes differ, a weight is negative or NaN, or
        a point with a path has no position or lies beyond the radius.
    TooFewSamplesError
        If no point has both a path and a weight.

    Notes
    -----
    `opd` is positive where the material is high: the lead of a reflected wave and the lag of a
    refracted one. Images need the lag, and `point_spread` changes the sign of a mirror.
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
    side: str = "inside"

    def __post_init__(self) -> None:
        freeze_fields(self, "x", "y", "opd", "weights")
        object.__setattr__(self, "n", check_mode(self.mode, self.n, self.side))
        object.__setattr__(self, "radius", positive(self.radius, "radius", dimension="length"))
        if self.steps is not None:
            steps = position(self.steps, "steps")
            object.__setattr__(self, "steps", tuple(positive(v, "a step") for v in steps))
        object.__setattr__(self, "audit", freeze_mapping(self.audit))
        self._check_points()

    def _check_points(self) -> None:
        shapes = {self.x.shape, self.y.shape, self.opd.shape, self.weights.shape}
        if len(shapes) > 1:
            raise InvalidSamplesError(
                f"x, y, opd and weights must have one shape, got {self.x.shape}, {self.y.shape}, "
                f"{self.opd.shape} and {self.weights.shape}"
            )
        if not (self.weights >= 0.0).all():
            raise InvalidSamplesError("weights are areas, 0 or more and never NaN")
        used = self._used()
        if not used.any():
            raise TooFewSamplesError(
                "no point of the wavefront has both a known path difference and an area"
            )
        rho = np.hypot(self.x[used], self.y[used])
        if not (rho <= self.radius * (1.0 + RIM)).all():
            raise InvalidSamplesError(
                "x and y must be known at every point with a path difference and lie within the "
                f"radius {1e3 * self.radius:.6g} mm, found {1e3 * float(rho.max()):.6g} mm"
            )

    def _used(self) -> NDArray[np.bool_]:
        return ~np.isnan(self.opd) & (self.weights > 0.0)

    @property
    def rms(self) -> float:
        """Root mean square over the area in m; nothing removed but what `removed` lists."""
        good = self._used()
        w = self.weights[good]
        return float(np.sqrt((w * self.opd[good] ** 2).sum() / w.sum()))

    @property
    def peak_to_valley(self) -> float:
        """Largest minus smallest path difference in m."""
        return float(np.ptp(self.opd[self._used()]))

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
        radius : float (m) or str with unit, optional
            Of the disc of the polynomials; the aperture if omitted. Points beyond it have no part.

        Returns
        -------
        ZernikeTable
            ``table["Z4"]`` is the defocus of ANSI, in m.

        Raises
        ------
        DataError
            If a term or the order does not exist, or the radius is not positive.
        DegenerateFitError
            If the points do not determine the terms.
        """
        used = self._used()
        return fit_table(
            (self.x[used], self.y[used], self.opd[used], self.weights[used]),
            terms,
            order,
            self.radius if radius is None else radius,
            self.messages,
        )

    def remove(self, what: Sequence[str]) -> Wavefront:
        """Return the wavefront without the best-fit piston, tilt or defocus.

        Parameters
        ----------
        what : str or sequence of {"piston", "tilt", "tilt_x", "tilt_y", "defocus"}
            What to take off; tilt_x is the term that grows with x.

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

        Notes
        -----
        Piston is fitted along with tilt, and both along with defocus, but only what was asked for is
        taken off: on an annulus defocus has a mean, and alone it would eat some of the piston.
        """
        names = removal_names(what)
        if not names:
            return self
        fitted, asked = terms_to_fit(names)
        found = self.zernike(fitted)
        parts = [found[f"Z{j}"] if j in asked else 0.0 for j in fitted]
        taken = Zernike(fitted, coefficients=parts, radius=found.radius)
        left = self.opd - taken(self.x, self.y)
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
            If the points differ, or what the surface does, from which side the light comes, or what
            was removed.
        TooFewSamplesError
            If no point is known in both.
        """
        if not isinstance(other, Wavefront):
            raise DataError(f"the increment is against a Wavefront, got {type(other).__name__}")
        if self.opd.shape != other.opd.shape or not (
            np.abs(self.x - other.x).max() <= 1e-9 * self.radius
            and np.abs(self.y - other.y).max() <= 1e-9 * self.radius
        ):
            raise DataError(
                "the wavefronts were sampled at different points; use one grid for both"
            )
        if self._kind() != other._kind():
            raise DataError(
                f"one wavefront is {self._kind()}, the other {other._kind()}; compare like with like"
            )
        notes = tuple(dict.fromkeys((*self.messages, *other.messages)))
        return replace(self, opd=self.opd - other.opd, source=None, messages=notes)

    def _kind(self) -> str:
        glass = "" if self.n is None else f" from the {self.side} with n = {self.n}"
        return f"{self.mode}ed{glass}, without {what_is_gone(self.removed)}"

    def strehl(self, wavelength: float, *, removed: Sequence[str] = ("piston", "tilt")) -> float:
        """Return the Strehl ratio: intensity on the axis against that without error.

        Parameters
        ----------
        wavelength : float (m) or str with unit
            Of the light in vacuum, from 1e-8 to 1e-2.
        removed : sequence of str, optional
            Taken off first, as by `remove`; tilt only moves the image.

        Returns
        -------
        float
            0 to 1, exact for the sampled points.

        Raises
        ------
        DataError
            If the wavelength is not one of light, or a word is unknown.
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
        wavelength : float (m) or str with unit
            Of the light in vacuum, from 1e-8 to 1e-2.
        removed : sequence of str, optional
            Taken off first.
        samples : int, optional
            Points along a side, where the wavefront of a form has to be traced anew on squares.
        pad : int, optional
            Size of the field over that of the pupil, >= 2.

        Returns
        -------
        PointSpread
            Directions in rad and intensity. The peak of a tilted surface stands where its rays go,
            seen in the medium behind the surface: in air for a mirror, and in the material for light
            that enters it (`side="outside"`).

        Raises
        ------
        DataError
            If the points lie on rings and do not come straight from a form, or a number is wrong.
        TooFewSamplesError
            If the phase turns too fast for the grid.
        DegenerateFitError
            If the points do not determine what is removed.
        """
        wavelength_of(wavelength)  # before anything is traced
        here = self._on_squares(samples).remove(removed)
        assert here.steps is not None  # noqa: S101  # _on_squares refuses rings
        lag = -here.opd if here.mode == "reflect" else here.opd
        behind = float(here.n) if here.n is not None and here.side == "outside" else 1.0
        return point_spread(lag, *here.steps, wavelength=wavelength, pad=pad, index=behind)

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
            side=self.side,  # type: ignore[arg-type]
            radius=self.radius,
            inner_radius=1e-3 * float(self.audit["inner_radius_mm"]),
            grid="square",
            samples=samples,
        )

    def __repr__(self) -> str:
        without = f", {', '.join(self.removed)} removed" if self.removed else ""
        glass = "" if self.n is None else f", n = {self.n}"
        return shortened(
            f"Wavefront({self.mode}{glass}, radius {format_length(self.radius)}, rms "
            f"{format_length(self.rms)}, P-V {format_length(self.peak_to_valley)}{without})"
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
    vertex_height: float = 0.0,
) -> Wavefront:
    """Return the wavefront that a surface makes of a plane wave along its axis.

    Parameters
    ----------
    surface : Surface or Form
        A measured map, or an ideal form. Heights count from the vertex plane z = 0, or that of
        `vertex_height`.
    mode : {"reflect", "refract"}, optional
        Mirror, or boundary of a material.
    n : float, optional
        Refractive index of the material, to refract.
    side : {"inside", "outside"}, optional
        Whether refracted light leaves the material here, or enters it.
    radius : float (m) or str with unit, optional
        Of the aperture; needed for a form, all that was measured for a map.
    inner_radius : float (m) or str with unit, optional
        Of a central hole.
    centre : tuple of (float, float), m, optional
        Optical axis in the coordinates of a map. If omitted: (0, 0), but the middle of what was
        measured on a map whose origin was not declared, which is the same as declared (0, 0); a
        message says so.
    form : Form, optional
        Ideal surface of a map, about the centre: makes the slopes of a steep part exact.
    grid : {"polar", "square"}, optional
        Points of an ideal form.
    samples : int or tuple of int, optional
        Radii and azimuths on rings (300, 720), or points along the side of a square (256).
    vertex_height : float (m) or str with unit, optional
        Height of the vertex plane in a measured map, 0 if omitted: heights count as given. Slopes
        turn an offset into defocus, so it matters on a curved part.

    Returns
    -------
    Wavefront
        ``.opd``, ``.zernike()``, ``.rms``, ``.strehl()``, ``.point_spread()``.

    Raises
    ------
    DataError
        If an argument is not one that can be used, the form is not defined in the aperture, or the
        axis lies beside a map and no radius is given.
    InvalidSamplesError
        If a slope is so steep that its ray never comes back, or a height is a fill value.
    TooFewSamplesError
        If fewer than 3 pixels with slopes lie in the aperture.

    Notes
    -----
    Each ray keeps the position where it met the surface. NaN of a map stays NaN: a pixel without a
    measured neighbour in x or in y has no slope and is omitted, counted in `messages`. Slopes of a
    map are centred differences, three-point ones at its rim, exact on a parabola. The paper [1]_ states neither the kind of
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
    check_mode(mode, n, side)
    choice(grid, "grid", GRIDS)
    inner_radius = quantity(inner_radius, "inner_radius", "length")
    vertex_height = quantity(vertex_height, "vertex_height", "length")
    points = _points(surface, radius, inner_radius, centre, form, grid, samples, vertex_height)
    used = ~np.isnan(points.z)
    rays = tuple(np.where(used, v, np.nan) for v in (points.z, points.slope_x, points.slope_y))
    path = path_difference(*rays, mode=mode, n=n, side=side)
    is_map = points.centre is not None
    audit: dict[str, Any] = {
        "side": side,
        "inner_radius_mm": 1e3 * inner_radius,
        "grid": "map" if is_map else grid,
        "n_points": int(used.sum()),
    }
    if points.centre is not None:
        audit["centre_mm"] = (1e3 * points.centre[0], 1e3 * points.centre[1])
        audit["vertex_height_mm"] = 1e3 * vertex_height
    return Wavefront(
        points.x,
        points.y,
        path,
        points.weights,
        points.radius,
        points.steps,
        mode,
        n,
        messages=points.messages + (map_messages(points, rays, mode, n, side) if is_map else ()),
        source=surface if isinstance(surface, Form) else None,
        audit=audit,
        side=side,
    )


def _points(
    surface: object,
    radius: float | None,
    inner_radius: float,
    centre: tuple[float, float] | None,
    form: Form | None,
    grid: Grid,
    samples: int | tuple[int, int] | None,
    vertex_height: float,
) -> Sampled:
    """Return the points of a form or of a map, whose arguments differ."""
    if isinstance(surface, Form):
        if form is not None or centre is not None or vertex_height != 0.0:
            raise DataError(
                "form, centre and vertex_height belong to a measured map; an ideal form has its own"
            )
        return form_points(surface, radius, inner_radius, grid, samples)
    if isinstance(surface, Surface):
        if samples is not None:
            raise DataError("a measured map has its own points; drop samples")
        return map_points(surface, radius, inner_radius, centre, form, vertex_height)
    raise DataError(
        f"the wavefront is that of a Surface or an ideal form, got {type(surface).__name__}"
    )


# ---- what a reader should know of the wavefront of a measured map: slopes at gaps, and its height ----

_WORTH = 1e-9
"""m of path: an error below it is not worth a word."""

_MISPLACED = 1e-6
"""m: a height that nobody would notice, to say what it would do where no height is known."""


def map_messages(
    points: Sampled,
    rays: tuple[FloatArray, ...],
    mode: Mode,
    n: float | None,
    side: Side,
) -> tuple[str, ...]:
    """Return messages; rays are heights and both slopes, NaN where nothing is used."""
    notes = (
        ""
        if points.slope_errors is None
        else _single_neighbours(points.slope_errors, rays, mode, n, side),
        _misplaced_height(points.on_axis, rays, mode, n, side),
    )
    return tuple(note for note in notes if note)


def _single_neighbours(
    errors: tuple[FloatArray, FloatArray],
    rays: tuple[FloatArray, ...],
    mode: Mode,
    n: float | None,
    side: Side,
) -> str:
    there = (errors[0] != 0.0) | (errors[1] != 0.0)  # NaN counts
    count = int(there.sum())
    if not count:
        return ""
    _, by_x, by_y = path_sensitivity(*(v[there] for v in rays), mode=mode, n=n, side=side)
    size = float((np.abs(by_x) * errors[0][there] + np.abs(by_y) * errors[1][there]).max())
    amount = (
        "by an amount that this map cannot tell"
        if np.isnan(size)
        else f"by half a step times the curvature, about {1e9 * size:.2g} nm of path at most"
    )
    return (
        f"{count} pixels have a single measured neighbour in x or y: their slope is one-sided and "
        f"may be off {amount}; give form=, whose slopes are exact, or a smaller radius"
    )


def _misplaced_height(
    height: float,
    rays: tuple[FloatArray, ...],
    mode: Mode,
    n: float | None,
    side: Side,
) -> str:
    known = not np.isnan(height)
    at = np.full_like(rays[0], height if known else _MISPLACED)
    flat = np.zeros_like(at)
    extra = path_difference(at, rays[1], rays[2], mode=mode, n=n, side=side) - path_difference(
        at, flat, flat, mode=mode, n=n, side=side
    )
    size = float(np.nanmax(np.abs(extra)))
    if size <= _WORTH:
        return ""
    if known:
        return (
            f"on its axis the map stands about {1e6 * abs(height):.4g} um "
            f"{'above' if height > 0.0 else 'below'} the vertex plane z = 0, which is "
            f"more than a piston: by the slopes up to {1e9 * size:.4g} nm of path come from it, mostly "
            f"defocus; if the vertex lies there, pass vertex_height={height:.4g} (in m)"
        )
    return (
        "nothing was measured on the axis, so heights count from z = 0 as given: were the vertex "
        f"1 um off it, up to {1e9 * size:.4g} nm of path would come from the slopes; see "
        "vertex_height"
    )


# ---- names of what can be taken off a wavefront, and the Zernike terms behind them -------------

TERMS = {"piston": (0,), "tilt": (1, 2), "tilt_y": (1,), "tilt_x": (2,), "defocus": (4,)}
"""ANSI numbers of what can be removed."""

_RANK = {0: 0, 1: 1, 2: 1, 4: 2}
"""Of those terms: what ranks below a term that is removed is fitted along."""


def removal_names(what: object) -> tuple[str, ...]:
    """Return names of what can be removed, each once, from a name or several."""
    several = isinstance(what, Iterable) and not isinstance(what, str)
    given = tuple(what) if several else (what,)  # type: ignore[arg-type]
    return tuple(dict.fromkeys(choice(name, "removed", TERMS) for name in given))


def terms_to_fit(names: Iterable[str]) -> tuple[list[int], set[int]]:
    """Return the ANSI numbers to fit together, and those of them to take off."""
    asked = {j for name in names for j in TERMS[name]}
    highest = max(_RANK[j] for j in asked)
    return [j for j, rank in _RANK.items() if rank <= highest], asked


def what_is_gone(names: Iterable[str]) -> str:
    """Return what was removed in one order of words, whatever the order it was done in."""
    gone = {j for name in names for j in TERMS.get(name, ())}
    words = [name for name, terms in TERMS.items() if name != "tilt" and {*terms} <= gone]
    return ", ".join(words) or "anything removed"
