"""Sub-aperture stitching: one surface from overlapping measurements, with a shared reference."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import ClassVar, Literal

import numpy as np
from numpy.typing import ArrayLike

from metrosep.core._arrays import FloatArray
from metrosep.core.errors import DataError
from metrosep.core.profile import Profile
from metrosep.core.surface import Surface
from metrosep.separation._map_input import checked_u
from metrosep.separation._readings import as_numbers
from metrosep.separation._stitch_grid import layout_of
from metrosep.separation._stitch_input import Pieces, pieces_of
from metrosep.separation._stitch_models import Settings
from metrosep.separation._stitch_registration import registered
from metrosep.separation._stitch_run import run
from metrosep.separation.contract import Separation, SeparationMethod
from metrosep.separation.null_space import Unobservable
from metrosep.spectral._checks import finite_number, real_number

__all__ = ["Stitching", "stitch"]


_FREEDOMS = ("piston", "tilt", "power")


def stitch(
    maps: Sequence[ArrayLike | Surface | Profile],
    positions: ArrayLike | None = None,
    *,
    dx: float | None = None,
    dy: float | None = None,
    rotations: ArrayLike | None = None,
    freedoms: Sequence[str] = ("piston", "tilt"),
    reference: Literal["none", "fit"] | ArrayLike | Surface | Profile = "none",
    reference_degree: int | None = None,
    ambiguous: Literal["remove", "surface"] = "remove",
    registration: Literal["trust", "fit"] = "trust",
    u_reading: float | None = None,
    draws: int = 16,
) -> Separation:
    """Return one surface from overlapping sub-apertures.

    Parameters
    ----------
    maps : sequence of Surface, Profile or array_like, m
        Sub-apertures; NaN = not measured. Surfaces bring their ``origin``, profiles their ``x``.
    positions : array_like, shape (n, 2) or (n,), m, optional
        x and y of the first pixel of each map, x of the first sample of each profile; needed for
        arrays, and instead of the origins where given.
    dx, dy : float, m, optional
        Steps of arrays; pixels if omitted.
    rotations : array_like, shape (n,), rad, optional
        By which the frame of each map lies turned on the part, counter-clockwise about its centre.
    freedoms : sequence of {"piston", "tilt", "power"}, optional
        What differs from one sub-aperture to the next.
    reference : {"none", "fit"} or array_like or Surface or Profile, m, optional
        Error of the instrument in its own pixels, common to all: none, unknown, or known (it is
        subtracted).
    reference_degree : int, optional
        Fit the reference as a polynomial of this total degree, 2 to 12; a map of pixels if
        omitted, which needs two step sizes.
    ambiguous : {"remove", "surface"}, optional
        What reference and surface can exchange unseen (power, ...): removed from both, or given to
        the surface as if the reference were free of it.
    registration : {"trust", "fit"}, optional
        Take the positions as they are, or find lateral offsets by least squares of gradients.
    u_reading : float, m, optional
        Standard uncertainty of one reading; from the overlaps if omitted.
    draws : int, optional
        Simulated measurements behind the uncertainty of a fitted map of pixels; 0 for none.

    Returns
    -------
    Separation
        ``.surface`` on the pixels of the first map, extended; ``.reference`` where fitted, in the
        instrument's pixels. ``coordinates`` hold x and y. The audit has the freedoms of each
        sub-aperture in nm at the edge of its longer half side, and the mismatch of each overlap.

    Raises
    ------
    DataError, InvalidSamplesError, TooFewSamplesError, NotUniformError
        If the sub-apertures or settings cannot be used, or one is mirrored.
    NotSeparableError
        If they fall into groups without overlap, or one step size leaves the reference open.
    DegenerateFitError
        If an overlap is too thin for the freedoms.
    NotConvergedError
        If the map of the reference or the registration does not settle.

    Notes
    -----
    Least squares of ``m_i(x) - s(x) - p_i(x) - r(x - x_i)`` over all pixels of all sub-apertures
    with one unknown s for each pixel: the sum over overlaps of the squared differences, each
    weighted by one over the number of sub-apertures at the pixel. The surface is their mean, the
    best one for equal noise; there is no feathering. Positions between pixels are interpolated by
    cubic convolution; a pixel is NaN where one of its 4 x 4 neighbours was not measured.

    Null space: the freedoms of the whole; with a fitted reference all parabolas, as
    ``r(x - x_i) - r(x)`` is then a plane. A reference error of curvature c gives the stitched
    length L a false sag ``c L^2 / 8``: with ``delta = c d^2`` that is ``delta (L/d)^2 / 8``.

    References
    ----------
    J. Fleig, P. Dumas, P. E. Murphy, G. W. Forbes, An automated subaperture stitching
    interferometer workstation for spherical and aspherical surfaces, Proc. SPIE 5188 (2003).

    Examples
    --------
    >>> import numpy as np
    >>> part = 50e-9 * np.sin(np.arange(60) / 7.0)[None, :] * np.cos(np.arange(20) / 5.0)[:, None]
    >>> pieces = [part[:, :30], part[:, 15:45] + 1e-6, part[:, 30:] - 2e-6]
    >>> result = stitch(pieces, [(0.0, 0.0), (15e-3, 0.0), (30e-3, 0.0)], dx=1e-3)
    >>> result.surface.shape
    (20, 60)
    """
    kinds = checked_freedoms(freedoms)
    if ambiguous not in ("remove", "surface") or registration not in ("trust", "fit"):
        raise DataError(
            f"stitch: ambiguous is {ambiguous!r} (remove or surface), registration {registration!r} "
            "(trust or fit)"
        )
    degree = None if reference_degree is None else _degree(reference_degree)
    fit = isinstance(reference, str) and reference == "fit"
    if isinstance(reference, str) and reference not in ("none", "fit"):
        raise DataError(f"stitch: reference is {reference!r}; give none, fit or a map")
    if degree is not None and not fit:
        raise DataError('stitch: reference_degree needs reference="fit"')
    n_draws = finite_number(draws, "stitch: draws", "a whole number")
    if n_draws < 0 or n_draws != int(n_draws):
        raise DataError(f"stitch: draws is {draws}; it must be a whole number, 0 or more")
    stated = u_reading
    if stated is not None:
        stated = real_number(stated, "u_reading", "a standard uncertainty in m")
    settings = Settings(
        kinds, fit, degree, ambiguous, int(n_draws), checked_u(stated, "u_reading")
    )
    pieces = pieces_of(maps, positions, rotations, dx, dy)
    extra: dict[str, object] = {"reference": "fitted" if fit else "none"}
    if not isinstance(reference, str):
        pieces = _without_known(pieces, reference)
        extra["reference"] = "known, subtracted"
    if registration == "fit":
        pieces, found = registered(pieces, kinds)
        extra.update(found)
    if not pieces.calibrated:
        extra["messages"] = (
            *tuple(extra.get("messages", ())),  # type: ignore[arg-type]
            "no lateral step is known: positions are in pixels",
        )
    return run(pieces, settings, extra)


@dataclass(frozen=True, slots=True)
class Stitching(SeparationMethod):
    """Sub-apertures of one shape at known positions.

    Parameters
    ----------
    positions : tuple of tuple of (float, float), m
        x and y of the first pixel of each sub-aperture.
    shape : tuple of int
        Rows and columns of each.
    dx, dy : float, m, optional
        Lateral steps; `dx` for both if `dy` is omitted.
    freedoms : tuple of str, optional
        As for `stitch`.
    fit_reference : bool, optional
        Whether the instrument's reference is unknown.
    reference_degree : int or None, optional
        Its polynomial; a map of pixels if None.
    draws : int, optional
        As for `stitch`.
    """

    positions: tuple[tuple[float, float], ...]
    shape: tuple[int, int]
    dx: float = 1.0
    dy: float | None = None
    freedoms: tuple[str, ...] = ("piston", "tilt")
    fit_reference: bool = False
    reference_degree: int | None = None
    draws: int = 16

    name: ClassVar[str] = "stitch"
    truth_parts: ClassVar[tuple[str, ...]] = ("surface",)
    error_parts: ClassVar[tuple[str, ...]] = ("reference",)

    def simulate(
        self, truth: Mapping[str, ArrayLike], errors: Mapping[str, ArrayLike]
    ) -> FloatArray:
        """Return what each sub-aperture reads, without noise and with freedoms of zero.

        Parameters
        ----------
        truth : mapping of str to array_like, shape (grid), m
            ``surface`` on the stitched grid.
        errors : mapping of str to array_like, shape (n_y, n_x), m
            ``reference`` in the instrument's pixels.

        Returns
        -------
        ndarray, shape (n, n_y, n_x), m
            Readings.

        Raises
        ------
        DataError
            If a part is unknown, none is given, of another shape, or a position lies between
            pixels.
        """
        unknown = [n for n in truth if n != "surface"] + [n for n in errors if n != "reference"]
        if unknown or not (truth or errors):
            raise DataError(
                "stitch simulates the truth part 'surface' and the error part 'reference', got "
                f"{[*truth, *errors]}"
            )
        layout = layout_of(self._pieces(np.zeros((len(self.positions), *self.shape))))
        surface = np.asarray(truth.get("surface", np.zeros(layout.shape)), dtype=np.float64)
        reference = np.asarray(errors.get("reference", np.zeros(self.shape)), dtype=np.float64)
        if surface.shape != layout.shape or reference.shape != self.shape:
            raise DataError(
                f"stitch: the surface has the shape {surface.shape}, the stitched grid "
                f"{layout.shape}; the reference {reference.shape}, the maps {self.shape}"
            )
        out = []
        for p in layout.placed:
            if p.valid.shape != self.shape:
                raise DataError("stitch simulates sub-apertures that lie on whole pixels only")
            out.append(surface[p.rows, p.columns] + reference)
        return np.stack(out)

    def null_space(self) -> tuple[Unobservable, ...]:
        """Return what these positions leave open.

        Returns
        -------
        tuple of Unobservable
            The freedoms of the whole, and what a fitted reference exchanges with the surface.

        Raises
        ------
        NotSeparableError
            If the positions do not connect.
        """
        readings = np.zeros((len(self.positions), *self.shape))
        return replace(self, draws=0).separate(readings, u_reading=0.0).null_space

    def separate(self, readings: ArrayLike, *, u_reading: float | None = None) -> Separation:
        """Return surface and reference.

        Parameters
        ----------
        readings : array_like, shape (n, n_y, n_x), m
            One map for each position; NaN = not measured.
        u_reading : float, m, optional
            Standard uncertainty of one reading; from the overlaps if omitted.

        Returns
        -------
        Separation
            As `stitch` returns it.

        Raises
        ------
        DataError, InvalidSamplesError, NotSeparableError
            If the readings cannot be stitched.
        """
        maps = _numbers(readings)
        if maps.ndim != 3 or maps.shape != (len(self.positions), *self.shape):
            raise DataError(
                f"stitch needs readings of the shape {(len(self.positions), *self.shape)}, got "
                f"{maps.shape}"
            )
        return stitch(
            list(maps),
            self.positions,
            dx=self.dx,
            dy=self.dy,
            freedoms=self.freedoms,
            reference="fit" if self.fit_reference else "none",
            reference_degree=self.reference_degree,
            u_reading=u_reading,
            draws=self.draws,
        )

    def correct(self, readings: ArrayLike) -> FloatArray:
        """Return the readings without the instrument's reference, where it is fitted.

        Parameters
        ----------
        readings : array_like, shape (n, n_y, n_x), m
            As for `separate`.

        Returns
        -------
        ndarray, shape (n, n_y, n_x), m
            NaN where the reference is not determined.

        Raises
        ------
        DataError, InvalidSamplesError, NotSeparableError
            If the readings cannot be stitched.
        """
        maps = _numbers(readings)
        if not self.fit_reference:
            return maps
        return np.asarray(maps - self.separate(maps).reference)

    def _pieces(self, readings: FloatArray) -> Pieces:
        return pieces_of(list(readings), self.positions, None, self.dx, self.dy)


def checked_freedoms(freedoms: Sequence[str]) -> tuple[str, ...]:
    """Return the freedoms in their order, or refuse them."""
    try:
        names = (freedoms,) if isinstance(freedoms, str) else tuple(freedoms)
    except TypeError:
        raise DataError(
            f"stitch: freedoms are {freedoms!r}; give names out of {', '.join(_FREEDOMS)}"
        ) from None
    unknown = [n for n in names if n not in _FREEDOMS]
    if unknown or "piston" not in names:
        raise DataError(
            f"stitch: freedoms are {list(names)}; possible are piston (always), tilt, power"
        )
    return tuple(n for n in _FREEDOMS if n in names)


def _degree(value: object) -> int:
    degree = finite_number(value, "stitch: reference_degree", "a whole number from 2 to 12")
    if degree != int(degree) or not 2 <= degree <= 12:
        raise DataError(f"stitch: reference_degree is {value}; it must be 2 to 12, and whole")
    return int(degree)


def _numbers(readings: ArrayLike) -> FloatArray:
    return as_numbers(readings, "stitch: the readings must be numbers in m")


def _without_known(pieces: Pieces, reference: ArrayLike | Surface | Profile) -> Pieces:
    z = reference.z if isinstance(reference, Surface | Profile) else reference
    known = np.atleast_2d(
        as_numbers(z, "stitch: reference must be none, fit or a map of heights in m")
    )
    for k, v in enumerate(pieces.values):
        if v.shape != known.shape:
            raise DataError(
                f"stitch: the reference has the shape {known.shape}, sub-aperture {k + 1} "
                f"{v.shape}; it is given in the pixels of the instrument"
            )
    if not math.isfinite(float(np.nansum(known))) or np.isnan(known).all():
        raise DataError("stitch: the reference holds no usable heights")
    return replace(pieces, values=tuple(v - known for v in pieces.values), known=known)
