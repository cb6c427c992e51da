"""`ThreeFlat`: the set-ups of a three-flat test and what they determine."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import ClassVar, Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray

from metrosep.core._arrays import FloatArray
from metrosep.core.blas import one_blas_thread
from metrosep.core.errors import DataError, NotSeparableError
from metrosep.core.provenance import Step
from metrosep.forms.zernike_index import ZernikeOrder
from metrosep.separation._flat_iterated import by_iteration
from metrosep.separation._flat_pixels import FlatPixelSolver
from metrosep.separation._flat_result import (
    ODD_REASON,
    FlatResult,
    by_pixels,
    by_terms,
    doubts_of_flats,
    hidden_orders,
)
from metrosep.separation._flat_setups import FLATS, FlatSetup, facing, flat_setups
from metrosep.separation._flat_zernike import DiscBasis, FlatZernikeSolver, zernike_terms_of
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
from metrosep.separation._map_orders import MOST_POSITIONS, common_step, without_plane
from metrosep.separation._map_results import REMOVABLE, rigid_terms
from metrosep.separation._map_whiteness import unit_doubts
from metrosep.separation.contract import Separation, SeparationMethod
from metrosep.separation.null_space import Unobservable

__all__ = ["ThreeFlat"]

FlatMethod = Literal["auto", "pixel", "zernike", "iterative"]

_ALIGNED = {"piston": ((0, 0),), "tilt": ((1, 1), (1, -1)), "power": ((2, 0),)}


@dataclass(frozen=True, slots=True)
class ThreeFlat(SeparationMethod):
    """Three flats that face each other two by two, and again with one of them turned.

    ``AB = A(x, y) + B(-x, y)``, ``AC`` and ``BC`` likewise: each flat as seen from its front, the
    second of a pair mirrored because it faces the first (``flip="x"``; ``"y"``: ``B(x, -y)``).

    Parameters
    ----------
    angles : sequence of float, rad, optional
        Turn of one flat in each further reading, counter-clockwise in the map (+x towards +y).
    pairs : str or sequence of str, optional
        Pair of each further reading: ``"AB"``, ``"AC"`` or ``"BC"``.
    turned : {"first", "second"}, optional
        Which flat of the pair was turned.
    flip : {"x", "y"}, optional
        Coordinate that the mirror reverses.
    method : {"auto", "pixel", "zernike", "iterative"}, optional
        ``"auto"``: by pixels where all angles are multiples of one step 2 pi/N with N <= 24.
        ``"zernike"``: terms on the common pixels; ``"iterative"``: on the pixels of each reading.
    terms, order : int or sequence of int, {"ansi", "noll", "fringe"}, optional
        Zernike terms of ``"zernike"`` and ``"iterative"``.
    dx, dy : float, m, optional
        Lateral steps; pixels if omitted.
    centre : tuple of (float, float), m, optional
        Axis of turn and mirror (x, y) from pixel [0, 0]; the middle of the map if omitted.
    radius : float, m, optional
        Of the Zernike disc; the farthest common pixel if omitted.
    removed : tuple of str, optional
        What alignment decides in each reading: ``"piston"``, ``"tilt"``, also ``"power"``.
    u_registration : float or array_like, shape (3 + n,) or (3 + n, 2), m, optional
        Standard uncertainty of how the flats lie on each other: one for all readings, one for each
        (along x and along y), or one for each along x and one along y.
    largest_gain : float, optional
        Shares whose noise would grow by more are taken as not observable.

    Raises
    ------
    DataError
        If a setting cannot be used: its type, sign, unit or number.
    NotSeparableError
        If the set-up turns or shifts nothing.
    """

    angles: Sequence[float] = ()
    pairs: str | Sequence[str] = "AB"
    turned: Literal["first", "second"] = "first"
    flip: Literal["x", "y"] = "x"
    method: FlatMethod = "auto"
    terms: int | tuple[int, ...] = 66
    order: ZernikeOrder = "ansi"
    dx: float | None = None
    dy: float | None = None
    centre: tuple[float, float] | None = None
    radius: float | None = None
    removed: tuple[str, ...] = ("piston", "tilt")
    u_registration: ArrayLike = 0.0
    largest_gain: float = 20.0

    name: ClassVar[str] = "three_flat"
    truth_parts: ClassVar[tuple[str, ...]] = FLATS
    error_parts: ClassVar[tuple[str, ...]] = ()

    def __post_init__(self) -> None:
        n = int(np.size(np.asarray(self.angles, dtype=object)))
        angles = checked_angles(self.angles, n, self.name) if n else np.zeros(0)
        if angles.size and np.abs(np.exp(1j * angles) - 1.0).min() < 1e-6:
            raise NotSeparableError(
                f"{self.name}: a turned reading has the angle 0, which says nothing new; give the "
                "angle by which the flat was turned"
            )
        object.__setattr__(self, "angles", tuple(angles.tolist()))
        if self.pairs is None:
            raise DataError(f"{self.name}: pairs must be 'AB', 'AC' or 'BC', got None")
        pairs = [self.pairs] * angles.size if isinstance(self.pairs, str) else list(self.pairs)
        if len(pairs) != angles.size or any(p not in ("AB", "AC", "BC") for p in pairs):
            raise DataError(
                f"{self.name}: pairs must be 'AB', 'AC' or 'BC', one for each of {angles.size} "
                f"angles, got {self.pairs!r}"
            )
        object.__setattr__(self, "pairs", tuple(pairs))
        for label, value, known in (
            ("turned", self.turned, ("first", "second")),
            ("flip", self.flip, ("x", "y")),
            ("method", self.method, ("auto", "pixel", "zernike", "iterative")),
            *(("removed", item, tuple(REMOVABLE)) for item in self.removed),
        ):
            if value not in known:
                raise DataError(f"{self.name}: {label} must be of {known}, got {value!r}")
        self._shifts()
        self._chosen()

    def simulate(
        self, truth: Mapping[str, ArrayLike], errors: Mapping[str, ArrayLike]
    ) -> FloatArray:
        """Return the readings of given flats.

        Parameters
        ----------
        truth : mapping of str to array_like, shape (n_y, n_x), m
            ``A``, ``B``, ``C``, each as seen from its front.
        errors : mapping of str to array_like
            Empty: there is no machine part.

        Returns
        -------
        ndarray, shape (3 + n, n_y, n_x), m
            AB, AC, BC and the turned ones.

        Raises
        ------
        DataError
            If a part is unknown or none is given.
        """
        flats = given_parts(
            self.name, truth, errors, truth_parts=self.truth_parts, error_parts=self.error_parts
        )
        maps, grid, _ = map_stack(
            list(flats.values()), what=self.name, dx=self.dx, dy=self.dy, centre=self.centre
        )
        return np.stack([sum(facing(maps, s, grid, self.flip)) for s in self.setups()])

    def correct(self, readings: ArrayLike) -> FloatArray:
        """Return the readings as they are: all their parts are flats, there is no machine part.

        Parameters
        ----------
        readings : array_like, shape (3 + n, n_y, n_x), m
            As for `separate`.

        Returns
        -------
        ndarray, shape (3 + n, n_y, n_x), m
            A copy.

        Raises
        ------
        DataError
            If the maps cannot be used.
        """
        return self._stack(readings)[0]

    def setups(self) -> tuple[FlatSetup, ...]:
        """Return which flats face each other in each reading.

        Returns
        -------
        tuple of FlatSetup
            AB, AC, BC and the turned ones.
        """
        return flat_setups(self.angles, list(self.pairs), self.turned)

    def null_space(self) -> tuple[Unobservable, ...]:
        """Return what the set-ups leave unknown of each flat.

        Returns
        -------
        tuple of Unobservable
            Angular orders (pixels) or terms (Zernike), and the alignment.
        """
        aligned = rigid_terms(FLATS, self.removed)
        if self._chosen() == "pixel":
            return hidden_orders(self._pixels()) + aligned
        hidden = self._zernike().hidden_terms(self._aligned())
        what = "turn a flat" if not self.angles else "the turns do not change it; add an angle"
        reason = ODD_REASON.format(axis=self.flip, what=what)
        terms = tuple(
            Unobservable(FLATS[k], "term", names, reason) for k, names in hidden.items() if names
        )
        return terms + aligned

    def separate(
        self,
        readings: ArrayLike,
        *,
        u_reading: float | None = None,
        history: tuple[Step, ...] = (),
    ) -> Separation:
        """Return the three flats as far as the set-ups determine them.

        Parameters
        ----------
        readings : array_like, shape (3 + n, n_y, n_x), m
            AB, AC, BC and the turned readings.
        u_reading : float, m, optional
            Standard uncertainty of one pixel of one reading; from redundancy if omitted.
        history : tuple of Step, optional
            Where the readings came from.

        Returns
        -------
        Separation
            Parts ``A``, ``B``, ``C``, each (n_y, n_x) in m, and more (see `three_flat`).

        Raises
        ------
        DataError
            If the maps do not fit or their masks do not overlap.
        InvalidSamplesError, TooFewSamplesError
            If the maps hold no numbers, or are too few or too small.
        DegenerateFitError
            If the pixels do not determine the Zernike terms.
        """
        stack, grid = self._stack(readings)
        u_reading = checked_u(u_reading, "u_reading")
        require_scale(grid, self._shifts(), self.name)
        common = require_overlap(stack, self.name)
        planar = np.stack(
            [without_plane(z, grid, removed=self.removed, mask=common) for z in stack]
        )
        with one_blas_thread():
            if self._chosen() == "pixel":
                result = by_pixels(
                    self._pixels(), planar, grid, removed=self.removed, u_reading=u_reading,
                    u_shift=self._shifts(),
                )  # fmt: skip
            else:
                result = self._by_terms(planar, grid, common, u_reading)
            doubts = self._doubts(planar, grid) or result.unexplained
            doubts = (*unit_doubts(stack, grid, np.array(self.angles)), *doubts)
        return self._result(result, grid, common, doubts, history)

    def _result(
        self,
        found: FlatResult,
        grid: MapGrid,
        common: NDArray[np.bool_],
        doubts: tuple[str, ...],
        history: tuple[Step, ...],
    ) -> Separation:
        audit = {
            "method": self._chosen(),
            "readings": [f"{s.first}{s.second}" for s in self.setups()],
            "angles_deg": [math.degrees(a) for a in self.angles],
            "turned": self.turned,
            "mirrored_coordinate": self.flip,
            "removed": ", ".join(self.removed),
            "n_pixels_common": int(common.sum()),
            "u_registration_um": (self._shifts() * 1e6).tolist(),
            **found.audit,
        }
        messages = (*found.messages, *doubts, *(() if grid.calibrated else (PIXELS,)))
        return Separation(
            self.name,
            found.parts,
            found.u,
            dict.fromkeys(found.parts, "m"),
            {"x": grid.x, "y": grid.y, **found.coordinates},
            self.null_space(),
            noise=found.noise,
            audit=audit,
            messages=messages,
            history=(*history, Step(self.name, {"angles_rad": list(self.angles)})),
        )

    def _stack(self, readings: ArrayLike) -> tuple[FloatArray, MapGrid]:
        names = [f"{s.first}{s.second}" for s in self.setups()]
        stack, grid, _ = map_stack(
            readings,
            what=self.name,
            names=names[:3] + [f"{n} turned" for n in names[3:]],
            one_frame=True,
            dx=self.dx,
            dy=self.dy,
            centre=self.centre,
        )
        middle = (grid.x[0] + grid.x[-1], grid.y[0] + grid.y[-1])
        across, step = (middle[0], grid.dx) if self.flip == "x" else (middle[1], grid.dy)
        if abs(across) > 1e-6 * step:
            raise DataError(
                f"{self.name}: the centre must lie in the middle of the map along {self.flip}, the "
                f"mirrored coordinate; crop the maps by {abs(across) / step:.3g} pixels"
            )
        return stack, grid

    def _n(self) -> int | None:
        return common_step(np.array([0.0, *self.angles]))

    def _chosen(self) -> str:
        n = self._n()
        if self.method == "pixel" and n is None:
            raise DataError(
                f"{self.name}: method='pixel' needs angles that are multiples of one step 2 pi/N, "
                f"N <= {MOST_POSITIONS}, got {[round(math.degrees(a), 4) for a in self.angles]} "
                "deg; use method='zernike'"
            )
        if self.method == "auto":
            return "zernike" if n is None else "pixel"
        return self.method

    def _pixels(self) -> FlatPixelSolver:
        return FlatPixelSolver(self.setups(), self._n() or 1, self.flip, self.largest_gain)

    def _aligned(self) -> tuple[tuple[int, int], ...]:
        return tuple(nm for item in self.removed for nm in _ALIGNED[item])

    def _zernike(self) -> FlatZernikeSolver:
        nm = zernike_terms_of(self.terms, self.order)
        return FlatZernikeSolver(self.setups(), nm, self.flip, self._aligned(), self.largest_gain)

    def _by_terms(
        self,
        stack: FloatArray,
        grid: MapGrid,
        common: NDArray[np.bool_],
        u_reading: float | None,
    ) -> FlatResult:
        solver = self._zernike()
        if self.method == "iterative":
            return by_iteration(
                solver, stack, grid, self.setups(), self.flip, radius=self.radius,
                aligned=self._aligned(), u_reading=u_reading, u_shift=self._shifts(),
            )  # fmt: skip
        basis = DiscBasis(grid, common, solver.nm, self.radius)
        return by_terms(
            solver, basis, stack, grid, self.setups(), self.flip,
            u_reading=u_reading, u_shift=self._shifts(),
        )  # fmt: skip

    def _doubts(self, stack: FloatArray, grid: MapGrid) -> tuple[str, ...]:
        return () if self._n() is None else doubts_of_flats(self._pixels(), stack, grid)

    def _shifts(self) -> FloatArray:
        n = 3 + len(self.angles)
        try:
            shifts = np.array(self.u_registration, dtype=np.float64)
        except (TypeError, ValueError):
            raise DataError(
                f"{self.name}: u_registration must be numbers in m, got {self.u_registration!r}"
            ) from None
        if shifts.ndim == 0:
            shifts = np.full(n, float(shifts))
        if shifts.shape not in ((n,), (n, 2)):
            raise DataError(
                f"{self.name}: u_registration needs one value, or one for each of {n} readings, or "
                f"({n}, 2) along x and y, got the shape {shifts.shape}"
            )
        for value in shifts.ravel():
            checked_u(float(value), "u_registration")
        return shifts if shifts.ndim == 2 else np.stack([shifts, shifts], axis=1)
