"""Rotations of a part in front of an instrument: what turns with the part and what stays."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import ClassVar

import numpy as np
from numpy.typing import ArrayLike, NDArray

from metrosep.core._arrays import FloatArray
from metrosep.core.blas import one_blas_thread
from metrosep.core.errors import DataError, NotSeparableError
from metrosep.core.provenance import Step
from metrosep.core.surface import Surface
from metrosep.separation._inputs import given_parts
from metrosep.separation._map_input import (
    PIXELS,
    MapGrid,
    checked_angles,
    checked_u,
    map_stack,
    require_overlap,
    require_scale,
)
from metrosep.separation._map_orders import (
    LISTED_ORDERS,
    coarse,
    common_step,
    mirror,
    without_plane,
)
from metrosep.separation._map_results import REMOVABLE, noise_of, rigid_terms
from metrosep.separation._map_whiteness import residual_doubts, unit_doubts
from metrosep.separation._registration_terms import registration_share
from metrosep.separation._rotation_solution import RotationSolver
from metrosep.separation.contract import Separation, SeparationMethod
from metrosep.separation.map_turning import turned
from metrosep.separation.null_space import Unobservable

__all__ = ["RotationTest", "rotation_average"]


@dataclass(frozen=True, slots=True)
class RotationTest(SeparationMethod):
    """Part measured in several rotations: ``M_i(p) = I(p) + P(R(-angle_i) p)`` and a plane each.

    Parameters
    ----------
    angles : sequence of float, rad
        Turn of the part in each reading, counter-clockwise in the map (from +x towards +y).
    dx, dy : float, m, optional
        Lateral steps; pixels if omitted.
    centre : tuple of (float, float), m, optional
        Axis of rotation (x, y) from pixel [0, 0]; the middle of the map if omitted.
    removed : tuple of str, optional
        What alignment decides in each reading: ``"piston"``, ``"tilt"``, also ``"power"``.
    u_registration : float, m, optional
        Standard uncertainty of the centring of each rotated reading along x and along y.
    u_angle : float, rad, optional
        Standard uncertainty of each angle.
    largest_gain : float, optional
        Orders whose noise would grow by more than this factor are taken as not observable.

    Raises
    ------
    DataError
        If a setting cannot be used: its type, sign, unit or number.
    NotSeparableError
        If the set-up turns or shifts nothing.
    """

    angles: Sequence[float]
    dx: float | None = None
    dy: float | None = None
    centre: tuple[float, float] | None = None
    removed: tuple[str, ...] = ("piston", "tilt")
    u_registration: float = 0.0
    u_angle: float = 0.0
    largest_gain: float = 20.0

    name: ClassVar[str] = "rotation_average"
    truth_parts: ClassVar[tuple[str, ...]] = ("part",)
    error_parts: ClassVar[tuple[str, ...]] = ("instrument",)

    def __post_init__(self) -> None:
        given = np.atleast_1d(np.asarray(self.angles, dtype=object))
        angles = checked_angles(self.angles, given.size, self.name)
        object.__setattr__(self, "angles", tuple(angles.tolist()))
        away = np.abs(np.exp(1j * (angles - angles[0])) - 1.0).max()
        if angles.size < 2 or away < 1e-6:
            raise NotSeparableError(
                f"{self.name}: the part was not turned ({angles.size} readings at one angle), so "
                "part and instrument cannot be told apart; measure at two angles or more"
            )
        for item in self.removed:
            if item not in REMOVABLE:
                raise DataError(f"removed may hold {', '.join(REMOVABLE)}, got {item!r}")
        for label, unit in (("u_registration", "m"), ("u_angle", "rad")):
            checked_u(getattr(self, label), label, unit)

    def simulate(
        self, truth: Mapping[str, ArrayLike], errors: Mapping[str, ArrayLike]
    ) -> FloatArray:
        """Return the readings of given parts.

        Parameters
        ----------
        truth : mapping of str to array_like, shape (n_y, n_x), m
            ``part``, as it lies at angle 0.
        errors : mapping of str to array_like, shape (n_y, n_x), m
            ``instrument``.

        Returns
        -------
        ndarray, shape (n, n_y, n_x), m
            One for each angle; NaN where a turned map would need pixels that are missing.

        Raises
        ------
        DataError
            If a part is unknown or none is given.
        """
        part, instrument = given_parts(
            self.name, truth, errors, truth_parts=self.truth_parts, error_parts=self.error_parts
        ).values()
        stack, grid, _ = map_stack(
            [part], what=self.name, dx=self.dx, dy=self.dy, centre=self.centre
        )
        return np.stack([instrument + turned(stack, a, grid)[0][0] for a in self.angles])

    def null_space(self) -> tuple[Unobservable, ...]:
        """Return the angular orders that look the same at all angles, and the alignment.

        Returns
        -------
        tuple of Unobservable
            Angular orders (up to 60) and terms of part and instrument.
        """
        hidden = RotationSolver(np.array(self.angles), self.largest_gain).hidden
        n = common_step(np.array(self.angles) - self.angles[0])
        further = (
            f"; further orders follow in steps of {n}"
            if n is not None and n <= LISTED_ORDERS
            else ""
        )
        reason = (
            "the turned part looks the same at all these angles, so only the sum of part and "
            f"instrument is known (part 'unseparated'){further}; an angle between would tell more of them"
        )
        orders = tuple(
            Unobservable(p, "angular order", hidden, reason) for p in ("part", "instrument")
        )
        return orders + rigid_terms(("part", "instrument"), self.removed)

    def separate(
        self,
        readings: ArrayLike,
        *,
        u_reading: float | None = None,
        history: tuple[Step, ...] = (),
    ) -> Separation:
        """Return part and instrument without the angular orders that cannot be told apart.

        Parameters
        ----------
        readings : array_like, shape (n, n_y, n_x), m
            One map for each angle.
        u_reading : float, m, optional
            Standard uncertainty of one pixel of one reading; found from redundancy if omitted.
        history : tuple of Step, optional
            Where the readings came from.

        Returns
        -------
        Separation
            Parts ``part``, ``instrument`` and ``unseparated``, each (n_y, n_x) in m.

        Raises
        ------
        DataError
            If the maps do not fit, or the masks do not overlap.
        InvalidSamplesError, TooFewSamplesError
            If the maps hold no numbers, or are too few or too small.
        """
        n = len(self.angles)
        stack, grid, _ = map_stack(
            readings,
            what=self.name,
            names=[f"map {i + 1}" for i in range(n)],
            one_frame=True,
            dx=self.dx,
            dy=self.dy,
            centre=self.centre,
        )
        u_reading = checked_u(u_reading, "u_reading")
        require_scale(grid, self.u_registration, self.name)
        common = require_overlap(stack, self.name)
        stack = np.stack(
            [without_plane(z, grid, removed=self.removed, mask=common) for z in stack]
        )
        with one_blas_thread():
            return self._separated(stack, grid, u_reading, history)

    def _separated(
        self,
        stack: FloatArray,
        grid: MapGrid,
        u_reading: float | None,
        history: tuple[Step, ...],
    ) -> Separation:
        angles = np.array(self.angles)
        solver = RotationSolver(angles, self.largest_gain)
        solution = solver.solve(stack, grid, removed=self.removed)
        instrument, part, _ = solution.parts
        if not np.isfinite(part).any():
            raise DataError(
                f"{self.name}: no pixel has its turned counterparts in all maps; give maps with a "
                "common round aperture about the centre of rotation"
            )
        noise = noise_of(solution.residual, solution.freedom, u_reading)
        u = noise.value * np.sqrt(solution.variance)
        named = {"part": part, "instrument": instrument, "unseparated": solution.parts[2]}
        u_maps = {
            name: np.where(np.isfinite(named[name]), s, np.nan)
            for name, s in zip(named, (u[1], u[0], u[2]), strict=True)
        }
        if self.u_registration > 0.0 or self.u_angle > 0.0:
            # the unseparated sum may be the part's: its slopes count wholly, an upper bound
            shares = registration_share(
                solver, part, angles, grid, self.u_registration, self.u_angle,
                unseparated=solution.parts[2], removed=self.removed,
            )  # fmt: skip
            for name, share in zip(("instrument", "part", "unseparated"), shares, strict=True):
                both = np.hypot(u_maps[name], share)
                u_maps[name] = np.where(np.isfinite(named[name]), both, np.nan)
        messages = doubts_of_rotations(stack, angles, grid, self.largest_gain)
        if not messages:
            messages = residual_doubts(solution.residual, stack, expected=solution.smoothness)
        messages = (*unit_doubts(stack, grid, angles), *messages, *lost_pixels(stack, part))
        if not grid.calibrated:
            messages = (*messages, PIXELS)
        return Separation(
            self.name,
            named,
            u_maps,
            dict.fromkeys(named, "m"),
            {"x": grid.x, "y": grid.y},
            self.null_space(),
            noise=noise,
            audit=self._audit(solver, stack, part),
            messages=messages,
            history=(*history, Step(self.name, {"angles_rad": list(self.angles)})),
        )

    def _audit(
        self, solver: RotationSolver, stack: FloatArray, part: FloatArray
    ) -> dict[str, object]:
        measured = int(np.isfinite(stack).all(axis=0).sum())
        return {
            "angles_deg": [math.degrees(a) for a in self.angles],
            "method": "pixels, classes of angular orders" if solver.n else "circles",
            "positions_in_a_turn": solver.n,
            "removed": ", ".join(self.removed),
            "n_pixels_common": measured,
            "n_pixels_result": int(np.isfinite(part).sum()),
            "u_registration_um": self.u_registration * 1e6,
            "u_angle_mrad": self.u_angle * 1e3,
        }


def rotation_average(
    surfaces: Sequence[ArrayLike | Surface],
    angles: ArrayLike,
    *,
    dx: float | None = None,
    dy: float | None = None,
    centre: tuple[float, float] | None = None,
    removed: tuple[str, ...] = ("piston", "tilt"),
    u_reading: float | None = None,
    u_registration: float = 0.0,
    u_angle: float = 0.0,
) -> Separation:
    """Return part and instrument from maps of the part in several rotations (N-position test).

    Parameters
    ----------
    surfaces : sequence of Surface or array_like, shape (n_y, n_x), m
        One map for each angle; NaN = not measured.
    angles : array_like, shape (n,), rad
        Turn of the part, counter-clockwise in the map (from +x, columns, towards +y, rows).
    dx, dy : float, m, optional
        Steps of plain arrays; pixels if omitted.
    centre : tuple of (float, float), m, optional
        Axis of rotation from pixel [0, 0]; the middle of the map if omitted.
    removed : tuple of str, optional
        What alignment decides in each map: ``"piston"``, ``"tilt"``, also ``"power"``.
    u_reading : float, m, optional
        Standard uncertainty of one pixel; found from redundancy if omitted.
    u_registration : float, m, optional
        Standard uncertainty of the centring of each map along x and along y. It enters by the slopes
        of ``part + unseparated``: an upper bound, as if the unseparated sum were all of the part.
    u_angle : float, rad, optional
        Standard uncertainty of each angle.

    Returns
    -------
    Separation
        ``.part`` (as it lies at angle 0) and ``.instrument`` without the orders of the null space;
        ``.unseparated``, the sum of both in those orders.

    Raises
    ------
    DataError, InvalidSamplesError, TooFewSamplesError
        If maps or angles cannot be used: other shapes or steps, degrees, no common pixels.
    NotSeparableError
        If the part was not turned.

    Notes
    -----
    Model: ``M_i(r, t) = I(r, t) + P(r, t - angle_i)`` and a plane for each map. For each angular
    order m the readings are ``I_m + exp(-j m angle_i) P_m``: least squares with the determinant
    ``n**2 - |sum exp(j m angle_i)|**2``. It is zero for m = 0 and, with n equal steps, for m = k n:
    there only the sum is known. The rotationally symmetric share is never separable by turns.
    n equal steps give ``I = mean M_i - U``, ``P = mean R(-angle_i) M_i - U``, with the variance
    ``s**2 (1 - 1/n)/n``. Angles that are multiples of one step 2 pi/N, N <= 24, are worked pixel by
    pixel; a result pixel needs its N turned counterparts. Other angles go by Fourier series on
    circles; a circle with a gap is lost. Turns by 90 degrees are exact, others interpolate
    (`turn_map`) and lose about three pixels at the rim, circles about six.

    References
    ----------
    C. J. Evans, R. N. Kestner, Appl. Opt. 35 (1996) 1015-1021.

    Examples
    --------
    >>> import numpy as np
    >>> x = np.linspace(-1, 1, 65)
    >>> part = 20e-9 * (x**3 - x) * x[:, None]
    >>> maps = [np.rot90(part, -k) + 5e-9 * x * x[:, None] for k in range(4)]
    >>> result = rotation_average(maps, np.radians([0, 90, 180, 270]))
    >>> result.null_space[0].indices[:3]
    (0, 4, 8)
    """
    items, grid, history = map_stack(
        surfaces, what="rotation_average", least=2, one_frame=True, dx=dx, dy=dy, centre=centre
    )
    method = RotationTest(
        tuple(checked_angles(angles, items.shape[0], "rotation_average").tolist()),
        grid.dx if grid.calibrated else None,
        grid.dy if grid.calibrated else None,
        centre,
        tuple(removed),
        u_registration,
        u_angle,
    )
    return method.separate(items, u_reading=u_reading, history=history)


# ---- doubts about maps that a separation can raise itself: mirrored maps, angles of the other sign ----

_COARSE = 64
_BETTER = 0.5
_ROUND_OFF = 1e-6
_RIM = 9.0
_MUCH = 0.02


def doubts_of_rotations(
    stack: FloatArray, angles: FloatArray, grid: MapGrid, largest_gain: float
) -> tuple[str, ...]:
    """Return what would explain the readings much better: other signs, a mirrored map."""
    small, small_grid = coarse(stack, grid, _COARSE)
    solver = RotationSolver(angles, largest_gain)
    if solver.n is None:
        return ()
    as_given = _left(solver, small, small_grid)
    size = math.sqrt(float(np.nanmean(small**2)))
    if not as_given > _ROUND_OFF * size:
        return ()
    other = _left(RotationSolver(-angles, largest_gain), small, small_grid)
    if other < _BETTER * as_given:
        text = (
            "the readings fit angles of the opposite sign much better "
            f"({other * 1e9:.3g} nm left instead of {as_given * 1e9:.3g} nm): angles count "
            "counter-clockwise from +x (columns) towards +y (rows); check rows and sign"
        )
        return (text,)
    found = []
    for i in range(stack.shape[0]):
        for axis in ("x", "y"):
            flipped = small.copy()
            flipped[i] = mirror(small[i], axis)
            left = _left(solver, flipped, small_grid)
            if left < _BETTER * as_given:
                found.append((left, i, axis))
    if not found:
        return ()
    left, i, axis = min(found)
    text = (
        f"map {i + 1} looks mirrored: with {axis} reversed the readings fit much better "
        f"({left * 1e9:.3g} nm left instead of {as_given * 1e9:.3g} nm)"
    )
    return (text,)


def lost_pixels(stack: FloatArray, part: FloatArray) -> tuple[str, ...]:
    """Say that gaps cost much more than themselves: their turned counterparts, or whole circles."""
    from scipy import ndimage

    common: NDArray[np.bool_] = np.logical_and.reduce(np.isfinite(stack), axis=0)
    field = np.pad(ndimage.binary_fill_holes(common), 1)
    inner = ndimage.distance_transform_edt(field)[1:-1, 1:-1] > _RIM
    lost = int((inner & common & ~np.isfinite(part)).sum())
    if lost <= _MUCH * inner.sum():
        return ()
    text = (
        f"{lost} pixels that all maps have measured, away from the rim, have no result: a gap or a corner costs its "
        "turned counterparts, and its whole circle where the angles are no multiples of one step"
    )
    return (text,)


def _left(solver: RotationSolver, stack: FloatArray, grid: MapGrid) -> float:
    if not np.isfinite(solver.parts(stack, grid)).all(axis=0).any():
        return math.nan
    residual = solver.solve(stack, grid).residual
    known = residual[np.isfinite(residual)]
    return math.sqrt(float(np.mean(known**2))) if known.size else math.nan
