"""Three-flat tests: absolute flatness of three flats from their sums, two by two; and the set-ups."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, ClassVar, Literal, get_args

import numpy as np
from numpy.typing import ArrayLike, NDArray

from metrosep.core._arrays import FloatArray
from metrosep.core.docs import described_by
from metrosep.core.errors import DataError, DegenerateFitError, NotSeparableError
from metrosep.core.numbers import choice, count, not_negative, positive
from metrosep.core.options import Option, option
from metrosep.core.surface import Surface
from metrosep.forms.zernike import ZernikeOrder
from metrosep.separation.contract import U_READING, Parts, Separation, Unobservable
from metrosep.separation.maps._flat_result import (
    FLATS,
    ODD_REASON,
    DiscBasis,
    FlatPixelSolver,
    FlatResult,
    FlatSetup,
    FlatZernikeSolver,
    by_pixels,
    by_terms,
    facing,
    hidden_orders,
    of_terms,
    warnings_of_flats,
    zernike_terms_of,
)
from metrosep.separation.maps._map_input import (
    MOST_POSITIONS,
    MapGrid,
    checked_angles,
    checked_removed,
    common_step,
    mirror,
    removed_option,
    require_scale,
    rigid_terms,
    stored_in_si,
    unit_warnings,
    without_plane,
)
from metrosep.separation.maps._map_method import MapMethod, MapReadings, map_separation

FlatMethod = Literal["auto", "pixel", "zernike", "iterative"]

_ALIGNED = {"piston": ((0, 0),), "tilt": ((1, 1), (1, -1)), "power": ((2, 0),)}


@described_by(MapMethod)
@dataclass(frozen=True, slots=True)
class ThreeFlat(MapMethod):
    """Three flats that face each other two by two, and again with one of them turned.

    ``AB = A(x, y) + B(-x, y)``, ``AC`` and ``BC`` likewise: each flat as seen from its front, the
    second of a pair mirrored because it faces the first (``flip="x"``; ``"y"``: ``B(x, -y)``). Maps:
    AB, AC, BC and the turned ones. Parts: ``A``, ``B``, ``C`` and more (see `three_flat`); there is no
    machine part, so `correct` returns the readings as they are.

    Parameters
    ----------
    pairs : str or sequence of str, optional
        Pair of each further reading: ``"AB"``, ``"AC"`` or ``"BC"``.
    method : {"auto", "pixel", "zernike", "iterative"}, optional
        ``"auto"``: by pixels where all angles are multiples of one step 2 pi/N with N <= 24.
        ``"zernike"``: terms on the common pixels; ``"iterative"``: on the pixels of each reading.
    terms, order : int or sequence of int, {"ansi", "noll", "fringe"}, optional
        Zernike terms of ``"zernike"`` and ``"iterative"``.
    u_registration : float or array_like, shape (3 + n,) or (3 + n, 2), m, optional
        Standard uncertainty of how the flats lie on each other: one for all readings, one for each
        (along x and along y), or one for each along x and one along y.
    largest_gain : float, optional
        Shares whose noise would grow by more are taken as not observable.
    """

    angles: Sequence[float] = option(
        (),
        kind="angles",
        help="turn of one flat in each further reading, counter-clockwise in the map (+x towards "
        "+y)",
    )
    pairs: str | Sequence[str] = option(
        "AB", kind="texts", help="flats of each of those readings: AB, AC, BC"
    )
    turned: Literal["first", "second"] = option(
        "first", kind="text", choices=("first", "second"), help="which flat of the pair was turned"
    )
    flip: Literal["x", "y"] = option(
        "x",
        kind="text",
        choices=("x", "y"),
        help="coordinate that changes its sign in the second flat",
    )
    method: FlatMethod = option(
        "auto",
        kind="text",
        choices=("auto", "pixel", "zernike", "iterative"),
        help="by pixels (even and odd shares) or by Zernike terms, at once on the pixels that all "
        "readings have, or iterated on the pixels of each; see Notes",
    )
    terms: int | tuple[int, ...] = option(
        66, kind="integer", help="number of Zernike terms that are fitted"
    )
    order: ZernikeOrder = option(
        "ansi", kind="text", choices=("ansi", "noll", "fringe"), help="of the Zernike terms"
    )
    dx: float | None = None
    dy: float | None = None
    centre: tuple[float, float] | None = None
    radius: float | None = option(
        None, kind="size", help="of the Zernike terms; of what was measured if omitted"
    )
    removed: tuple[str, ...] = removed_option()
    u_registration: ArrayLike = option(
        0.0, kind="uncertainty", help="standard uncertainty of the position of a map"
    )
    largest_gain: float = 20.0

    name = "three_flat"
    what = "absolute flatness of three flats; files AB, AC, BC, then those with a flat turned"
    reads = "maps"
    readings = ("AB", "AC", "BC")
    spare = 1000  # turned ones, as many as there are angles
    arguments: ClassVar[Mapping[str, Option]] = U_READING
    truth_parts = FLATS
    error_parts = ()

    @classmethod
    def from_inputs(cls, data: Sequence[Any], options: Mapping[str, Any]) -> Separation:
        """Return the flats of maps AB, AC, BC and of those with a flat turned."""
        rest, (ab, ac, bc, *turned) = dict(options), data
        angles = rest.pop("angles", ())
        if len(angles) != len(turned):
            raise DataError(
                f"{len(turned)} file(s) follow AB, AC, BC, but angles has {len(angles)}; give the "
                'turn of each further reading: angles = ["90 deg"]'
            )
        return three_flat(ab, ac, bc, turned, angles, **rest)

    def __post_init__(self) -> None:
        n = int(np.size(np.asarray(self.angles, dtype=object)))
        angles = checked_angles(self.angles, n, self.name) if n else np.zeros(0)
        if angles.size and np.abs(np.exp(1j * angles) - 1.0).min() < 1e-6:
            raise NotSeparableError(
                f"{self.name}: a turned reading has the angle 0, which adds nothing; give the "
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
        choice(self.turned, f"{self.name}: turned", ("first", "second"))
        choice(self.flip, f"{self.name}: flip", ("x", "y"))
        choice(self.method, f"{self.name}: method", get_args(FlatMethod))
        whole = not isinstance(self.terms, Iterable)
        terms = count(self.terms, f"{self.name}: terms") if whole else tuple(self.terms)  # type: ignore[arg-type]
        object.__setattr__(self, "terms", terms)
        checked_removed(self.removed)
        stored_in_si(self, positive, dx="length", dy="length", radius="length")
        self._shifts()
        self._chosen()

    def simulate(self, truth: Parts, errors: Parts) -> FloatArray:
        maps, grid = self._given(truth, errors)
        return np.stack([sum(facing(maps, s, grid, self.flip)) for s in self.setups()])

    def correct(self, readings: ArrayLike) -> FloatArray:
        stack, grid, _ = self._read(readings, self._names())
        self._require_middle(grid)
        return stack

    def setups(self) -> tuple[FlatSetup, ...]:
        """Return which flats face each other in each reading: AB, AC, BC and the turned ones."""
        pairs = ("AB", "AC", "BC", *self.pairs)
        first, second = (1.0, 0.0) if self.turned == "first" else (0.0, 1.0)
        return tuple(
            FlatSetup(pair[0], pair[1], first * angle, second * angle)
            for pair, angle in zip(pairs, (0.0, 0.0, 0.0, *self.angles), strict=True)
        )

    def null_space(self) -> tuple[Unobservable, ...]:
        aligned = rigid_terms(FLATS, self.removed)
        if self._chosen() == "pixel":
            return hidden_orders(self._pixels()) + aligned
        solver = self._zernike()
        hidden = {flat: solver.hidden_terms(k) for k, flat in enumerate(FLATS)}
        what = "turn a flat" if not self.angles else "the turns do not change it; add an angle"
        reason = ODD_REASON.format(axis=self.flip, what=what)
        terms = tuple(
            Unobservable(flat, "term", names, reason) for flat, names in hidden.items() if names
        )
        return terms + aligned

    def _separated(self, read: MapReadings) -> Separation:
        stack, grid, common, u_reading, history = read
        self._require_middle(grid)
        require_scale(grid, self._shifts(), self.name)
        planar = without_plane(stack, grid, removed=self.removed, mask=common)
        known: dict[str, Any] = {"u_reading": u_reading, "u_shift": self._shifts()}
        if self._chosen() == "pixel":
            found = by_pixels(self._pixels(), planar, grid, removed=self.removed, **known)
        elif self.method == "iterative":
            found = by_iteration(self._zernike(), planar, grid, radius=self.radius, **known)
        else:
            solver = self._zernike()
            basis = DiscBasis(grid, common, solver.nm, self.radius)
            found = by_terms(solver, basis, planar, grid, **known)
        on_pixels = self._n() is not None
        warnings = warnings_of_flats(self._pixels(), planar, grid) if on_pixels else ()
        audit = {
            "method": self._chosen(),
            "readings": [s.pair for s in self.setups()],
            "angles_deg": [math.degrees(a) for a in self.angles],
            "turned": self.turned,
            "mirrored_coordinate": self.flip,
            "removed": ", ".join(self.removed),
            "n_pixels_common": int(common.sum()),
            "u_registration_um": (self._shifts() * 1e6).tolist(),
            **found.audit,
        }
        units = unit_warnings(stack, grid, np.array(self.angles))
        return map_separation(
            self.name, grid, found.parts, found.u, self.null_space(), found.noise, audit,
            (*found.messages, *units, *(warnings or found.unexplained)), history,
            {"angles_rad": list(self.angles)}, found.coordinates,
        )  # fmt: skip

    def _names(self) -> list[str]:
        return [s.pair + " turned" * (i > 2) for i, s in enumerate(self.setups())]

    def _require_middle(self, grid: MapGrid) -> None:
        middle = (grid.x[0] + grid.x[-1], grid.y[0] + grid.y[-1])
        across, step = (middle[0], grid.dx) if self.flip == "x" else (middle[1], grid.dy)
        if abs(across) > 1e-6 * step:
            raise DataError(
                f"{self.name}: the centre must lie in the middle of the map along {self.flip}, the "
                f"mirrored coordinate; crop the maps by {abs(across) / step:.3g} pixels"
            )

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

    def _shifts(self) -> FloatArray:
        n = 3 + len(self.angles)
        given: Any = self.u_registration
        if isinstance(given, str) or np.ndim(given) == 0:
            return np.full((n, 2), not_negative(given, "u_registration", dimension="length"))
        try:
            shifts = np.array(given, dtype=np.float64)
        except (TypeError, ValueError):
            raise DataError(
                f"{self.name}: u_registration must be numbers in m, got {self.u_registration!r}"
            ) from None
        if shifts.shape not in ((n,), (n, 2)):
            raise DataError(
                f"{self.name}: u_registration needs one value, or one for each of {n} readings, or "
                f"({n}, 2) along x and y, got the shape {shifts.shape}"
            )
        for value in shifts.ravel():
            not_negative(value, "u_registration", dimension="length")
        return shifts if shifts.ndim == 2 else np.stack([shifts, shifts], axis=1)


@described_by(ThreeFlat, ThreeFlat.separate)
def three_flat(
    ab: ArrayLike | Surface,
    ac: ArrayLike | Surface,
    bc: ArrayLike | Surface,
    rotated: Sequence[ArrayLike | Surface] | ArrayLike | Surface = (),
    angles: ArrayLike = (),
    *,
    pairs: str | Sequence[str] = "AB",
    turned: Literal["first", "second"] = "first",
    flip: Literal["x", "y"] = "x",
    method: FlatMethod = "auto",
    terms: int | Sequence[int] = 66,
    order: ZernikeOrder = "ansi",
    dx: float | None = None,
    dy: float | None = None,
    centre: tuple[float, float] | None = None,
    radius: float | None = None,
    removed: tuple[str, ...] = ("piston", "tilt"),
    u_reading: float | None = None,
    u_registration: ArrayLike = 0.0,
) -> Separation:
    """Return three flats from their sums two by two, and from readings with one flat turned.

    Parameters
    ----------
    ab, ac, bc : Surface or array_like, shape (n_y, n_x), m
        Sum of two flats; the second one is seen mirrored. NaN = not measured.
    rotated : Surface or array_like, or sequence of them, optional
        Further readings with a flat turned.
    u_registration : float or array_like, shape (3 + n,) or (3 + n, 2), m, optional
        Standard uncertainty of the position of the flats to each other, for each reading, along x
        and y; it adds gradient times shift to `u`.

    Returns
    -------
    Separation
        ``.A``, ``.B``, ``.C``: maps as seen from the front of each flat, without what the null
        space lists. Nothing turned: NaN beside the diameter, with ``.diameter_A`` (n_y,) and the
        mirror-even shares ``.even_A``. By Zernike terms: ``.zernike_A`` with NaN for terms that
        are not determined, over ``coordinates["zernike_n"]`` and ``["zernike_m"]``.

    Notes
    -----
    The mirror-even shares e follow from three sums at every pixel, ``A_e = (AB + AC - BC)_e / 2``.
    Of the odd shares only differences show in AB, AC, BC: a common one is invisible, and A, B, C
    are known where it vanishes, on the diameter (x = 0), with ``u = s sqrt(3)/2``. A reading with A
    turned by t adds ``A_m (exp(-j m t) - 1)``: all angular orders but those with m t = 2 pi k.
    Of these only the odd share (sin m theta for even m, flip x) stays unknown; it is in the null
    space. Turns by 180 deg leave 2, 4, 6 ..., 90 deg 4, 8 ..., 54 deg 20, 40 ...

    Pixels: classes q = m mod N of orders are projected by turns of 2 pi/N and solved by least
    squares, which contains the even/odd method (180, 90, 45 deg) and N positions. A result pixel
    needs its turned and mirrored counterparts; turns other than 90 deg interpolate and lose about
    three pixels at the rim. Zernike: coefficients by least squares on the common pixels, all angles,
    one system for each order m. Iterative: readings are simulated from the terms, compared with the
    measured ones on the pixels of each, and the difference shared among the flats, until it is
    1e-13 of the start (conjugate gradients; the paper's fixed steps take hundreds). It needs no
    pixel in every reading beyond the 30 that align them; with one mask for all it is ``"zernike"``.

    References
    ----------
    Fritz, Opt. Eng. 23 (1984) 379-383. Ai and Wyant, Appl. Opt. 32 (1993) 4698-4705.
    Evans and Kestner, Appl. Opt. 35 (1996) 1015-1021. M. Vannoni, G. Molesini, Opt.
    Express 16 (2008) 340-354. U. Griesmann, Appl. Opt. 45 (2006) 5856-5865.

    Examples
    --------
    >>> import numpy as np
    >>> x = np.linspace(-1, 1, 65)
    >>> A, B, C = 9e-9 * x**3 * x[:, None], 5e-9 * (x**2 + x[:, None]), 7e-9 * x[:, None]**2 * x
    >>> F = np.fliplr
    >>> turned = np.rot90(A, -1) + F(B)
    >>> result = three_flat(A + F(B), A + F(C), B + F(C), turned, np.pi / 2)
    >>> result.null_space[0].indices[:3]
    (4, 8, 12)
    """
    turned_maps = _as_list(rotated)
    if not turned_maps and np.size(angles):
        raise DataError("three_flat: angles are given without rotated maps")
    setup = ThreeFlat(
        angles,  # type: ignore[arg-type]
        pairs,
        turned,
        flip,
        method,
        terms,  # type: ignore[arg-type]
        order,
        dx,
        dy,
        centre,
        radius,
        tuple(removed),
        u_registration,
    )
    maps: list[Any] = [ab, ac, bc, *turned_maps]
    return setup.separate(maps, u_reading=u_reading)


def _as_list(
    rotated: Sequence[ArrayLike | Surface] | ArrayLike | Surface,
) -> list[ArrayLike | Surface]:
    if isinstance(rotated, Surface) or (isinstance(rotated, np.ndarray) and rotated.ndim == 2):
        return [rotated]
    try:
        return list(rotated)  # type: ignore[arg-type]
    except TypeError:
        raise DataError(
            f"three_flat: rotated must be a map or a list of maps, got {type(rotated).__name__}"
        ) from None


# ---- from the readings of three flats to maps by iterated Zernike terms, each reading with its mask ----


def by_iteration(
    solver: FlatZernikeSolver,
    stack: FloatArray,
    grid: MapGrid,
    *,
    radius: float | None,
    u_reading: float | None,
    u_shift: FloatArray,
) -> FlatResult:
    """Return coefficients and maps of Zernike terms from all pixels that each reading has."""
    measured = np.isfinite(stack)
    anywhere = np.logical_or.reduce(measured, axis=0)
    basis = DiscBasis(grid, anywhere | mirror(anywhere, solver.flip), solver.nm, radius)
    system = OwnMasks(basis, solver, measured)
    p = len(basis.nm)
    coefficients, left = system.iterate(system.right_side(stack))
    seen = solver.seen & np.isin(np.arange(p), system.free)
    blocks = system.inverse.reshape(3, p, 3, p)
    covariance = np.stack(
        [blocks[k, :, k, :] * np.outer(seen[k], seen[k]) for k in range(3)]
    )  # of the pixels' least squares, to which the steps converge
    result = of_terms(
        solver, basis, stack, grid, coefficients, seen, covariance,
        lambda one: system.inverse @ system.right_side(one),
        system.residual(stack, coefficients),
        system.rank + len(solver.setups) * system.rigid.size, u_reading, u_shift,
    )  # fmt: skip
    shown = dict(zip(FLATS, _faces(measured, solver.setups, solver.flip), strict=True))
    parts, u = (
        {k: np.where(shown[k], v, np.nan) if k in shown else v for k, v in values.items()}
        for values in (result.parts, result.u)
    )
    audit = {
        **result.audit,
        "iterations": len(left),
        "left_of_the_difference": left[-1] if left else 0.0,
        "n_pixels_of_all_readings": int(measured[:, basis.mask].sum()),
    }
    messages = (_unsettled(left),) if left and left[-1] > _SETTLED else ()
    return replace(result, parts=parts, u=u, audit=audit, messages=messages)


def _faces(measured: NDArray[np.bool_], setups: Sequence[FlatSetup], flip: str) -> FloatArray:
    """Return where some reading of a flat that was not turned has measured it."""
    out = np.zeros((3, *measured.shape[1:]), dtype=bool)
    for mask, item in zip(measured, setups, strict=True):
        if item.turn_first == 0.0:
            out[FLATS.index(item.first)] |= mask
        if item.turn_second == 0.0:
            out[FLATS.index(item.second)] |= mirror(mask, flip)
    return out


def _unsettled(left: Sequence[float]) -> str:
    return (
        f"the iteration stopped after {len(left)} steps with {left[-1]:.2g} of the difference left; "
        "method='zernike' solves the same equations at once"
    )


# ---- three flats by iterated Zernike terms: simulate the readings, compare, share the difference ----
# Each reading is compared on its own measured pixels, so a gap in one of them costs nothing in the
# others. The steps are those of conjugate gradients on the pixels' least squares: the published
# iteration goes the same way with fixed steps and needs hundreds of them.

MOST_STEPS = 500
"""Steps after which an iteration ends and says that it did not settle."""

_SETTLED = 1e-13
_RANK_TOLERANCE = 1e-9
_LEAST_INFORMATION = 1e-6


class OwnMasks:
    """Least squares of all measured pixels of all readings over the terms of A, B, C."""

    def __init__(
        self, basis: DiscBasis, solver: FlatZernikeSolver, measured: NDArray[np.bool_]
    ) -> None:
        self.basis, self.solver = basis, solver
        self.measured = measured[:, basis.mask]
        p, s = len(basis.nm), measured.shape[0]
        free = np.array([nm not in solver.aligned for nm in basis.nm])
        self.free, self.rigid = np.flatnonzero(free), np.flatnonzero(~free)
        self.grams = np.repeat(basis.normal[None], s, axis=0)
        for block, piece in basis.blocks():
            for k in range(s):
                gap = block[:, ~self.measured[k, piece]]
                if gap.size:
                    self.grams[k] -= gap @ gap.T
        self.designs = [solver.model[k * p : (k + 1) * p][self.free] for k in range(s)]
        try:
            self.reduced = [self._without_rigid(g) for g in self.grams]
        except np.linalg.LinAlgError:
            raise DegenerateFitError(_TOO_FEW) from None
        self.normal = sum(
            (d.T @ g @ d for d, g in zip(self.designs, self.reduced, strict=True)),
            np.zeros((3 * p, 3 * p)),
        )
        self.inverse, self.rank = self._inverse()

    def _without_rigid(self, gram: FloatArray) -> FloatArray:
        own = gram[np.ix_(self.free, self.free)]
        if self.rigid.size == 0:
            return own
        shared = gram[np.ix_(self.free, self.rigid)]
        return own - shared @ np.linalg.solve(gram[np.ix_(self.rigid, self.rigid)], shared.T)

    def _inverse(self) -> tuple[FloatArray, int]:
        """Return the pseudo-inverse on what the set-ups show, and how much this is."""
        design = np.concatenate(self.designs)
        _, size, rows = np.linalg.svd(design, full_matrices=False)
        rank = int((size > _RANK_TOLERANCE * size[0]).sum())
        shown = rows[:rank].T
        here = shown.T @ self.normal @ shown
        whole = self._without_rigid(self.basis.normal)
        full = sum((d @ shown).T @ whole @ (d @ shown) for d in self.designs)
        root = np.linalg.inv(np.linalg.cholesky(full))
        if np.linalg.eigvalsh(root @ here @ root.T)[0] < _LEAST_INFORMATION:
            raise DegenerateFitError(_TOO_FEW)
        return shown @ np.linalg.inv(here) @ shown.T, rank

    def right_side(self, stack: FloatArray) -> FloatArray:
        """Return what the readings say of each coefficient, alignment removed."""
        z = np.where(self.measured, stack[:, self.basis.mask], 0.0)
        sums = np.zeros((len(self.designs), len(self.basis.nm)))
        for block, piece in self.basis.blocks():
            sums += z[:, piece] @ block.T
        out = np.zeros(self.normal.shape[0])
        for design, gram, row in zip(self.designs, self.grams, sums, strict=True):
            own = row[self.free]
            if self.rigid.size:
                shared = gram[np.ix_(self.free, self.rigid)]
                fitted = np.linalg.solve(gram[np.ix_(self.rigid, self.rigid)], row[self.rigid])
                own = own - shared @ fitted
            out += design.T @ own
        return out

    def iterate(self, right: FloatArray) -> tuple[FloatArray, list[float]]:
        """Return the coefficients of A, B, C, and what was left of the residual at each step."""
        found, rest = np.zeros_like(right), right.copy()
        start = float(np.sqrt(rest @ rest))
        left: list[float] = []
        along, size = rest.copy(), float(rest @ rest)
        while size > 0.0 and len(left) < MOST_STEPS:
            ahead = self.normal @ along
            step = size / float(along @ ahead)
            found, rest = found + step * along, rest - step * ahead
            new = float(rest @ rest)
            left.append(np.sqrt(new) / start)
            if left[-1] <= _SETTLED:
                break
            along, size = rest + new / size * along, new
        return found, left

    def residual(self, stack: FloatArray, coefficients: FloatArray) -> FloatArray:
        """Return what the model leaves of each reading on its own pixels, alignment removed."""
        terms = (self.solver.model @ coefficients).reshape(len(self.designs), -1).copy()
        terms[:, self.rigid] = 0.0
        rest = np.where(self.measured, stack[:, self.basis.mask] - self._values(terms), 0.0)
        sums = np.zeros_like(terms)
        for block, piece in self.basis.blocks():
            sums += rest[:, piece] @ block.T
        planes = np.zeros_like(terms)
        for k, gram in enumerate(self.grams):
            if self.rigid.size:
                own = gram[np.ix_(self.rigid, self.rigid)]
                planes[k, self.rigid] = np.linalg.solve(own, sums[k, self.rigid])
        out = np.full(stack.shape, np.nan)
        out[:, self.basis.mask] = np.where(self.measured, rest - self._values(planes), np.nan)
        return out

    def _values(self, coefficients: FloatArray) -> FloatArray:
        return np.asarray(self.basis.maps(coefficients)[:, self.basis.mask])


_TOO_FEW = (
    "the pixels that the readings have do not determine the Zernike terms of three flats; use fewer "
    "terms, or readings with smaller gaps"
)
