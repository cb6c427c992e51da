"""Shift-rotation test: part and instrument from lateral shifts and turns, jointly in Zernike terms."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, ClassVar, cast

import numpy as np
from numpy.typing import ArrayLike, NDArray

from metrosep.core._arrays import FloatArray
from metrosep.core.docs import described_by
from metrosep.core.errors import DataError, DegenerateFitError, NotSeparableError
from metrosep.core.numbers import count, not_negative, positive, real
from metrosep.core.options import Option, option
from metrosep.core.surface import Surface
from metrosep.forms.zernike import term_name
from metrosep.forms.zernike_fit import zernike_values
from metrosep.separation.contract import U_READING, Parts, Separation, Unobservable
from metrosep.separation.maps._flat_result import DiscBasis, zernike_terms_of
from metrosep.separation.maps._map_input import (
    MapGrid,
    checked_angles,
    noise_of,
    require_overlap,
    rigid_terms,
    stored_in_si,
    unit_warnings,
)
from metrosep.separation.maps._map_method import MapMethod, MapReadings, map_separation

_NULL = 1e-11
_TOUCHED = 1e-5
_BLOCK = 16384
_RIGID = ((0, 0), (1, -1), (1, 1))


@described_by(MapMethod)
@dataclass(frozen=True, slots=True)
class ShiftRotation(MapMethod):
    """Part turned and shifted: ``M_i(p) = I(p) + P(R(-angle_i)(p - shift_i))`` and a plane each.

    One map for each position. Parts: ``part``, as it lies unturned and not shifted, and
    ``instrument``, with their coefficients ``zernike_part`` and ``zernike_instrument``, NaN for
    terms that are not determined. Parts are simulated as sums of the Zernike terms. The null space
    of a result also lists what its own shifts and turns leave unknown.

    Parameters
    ----------
    power : tuple of (float, float), m, optional
        Known power of the part, its coefficient of ``2 r**2 - 1`` with r = 1 at the farthest common
        pixel, and its standard uncertainty, from another test.
    largest_gain : float, optional
        Terms whose noise would grow by more than this, against the fit of one map, are not given.
    """

    angles: Sequence[float] = option(
        kind="angles", help="turn of the part in each map, counter-clockwise, in their order"
    )
    shifts: Sequence[tuple[float, float]] = option(
        kind="places", help="shift of the part along x and y in each reading, after the turn"
    )
    terms: int = option(
        28,
        kind="integer",
        help="ANSI Zernike terms of each part; 28 hold all up to the radial order 6",
    )
    dx: float | None = None
    dy: float | None = None
    centre: tuple[float, float] | None = None
    power: tuple[float, float] | None = None
    largest_gain: float = 100.0

    name = "shift_rotation"
    what = "part and instrument from maps of the part shifted and turned"
    reads = "maps"
    arguments: ClassVar[Mapping[str, Option]] = {
        **U_READING,
        "power": Option("length", help="sag of the part that is known, since no shift shows it"),
        "u_power": Option("uncertainty", help="standard uncertainty of power"),
    }
    truth_parts = ("part",)
    error_parts = ("instrument",)

    @classmethod
    def from_inputs(cls, data: Sequence[Any], options: Mapping[str, Any]) -> Separation:
        """Return the parts of maps; a known power comes with its uncertainty."""
        rest = dict(options)
        u_power = rest.pop("u_power", 0.0)
        if "power" in rest:
            rest["power"] = (rest["power"], u_power)
        return shift_rotation(list(data), **rest)

    def __post_init__(self) -> None:
        angles = checked_angles(self.angles, int(np.size(self.angles)), self.name)
        try:
            shifts = np.array(self.shifts, dtype=np.float64)
        except (TypeError, ValueError) as exc:
            raise DataError(f"{self.name}: shifts hold no numbers ({exc})") from None
        if shifts.shape != (angles.size, 2) or not np.isfinite(shifts).all():
            raise DataError(
                f"{self.name}: one finite shift (x, y) is needed for each of {angles.size} angles, "
                f"got the shape {shifts.shape}"
            )
        object.__setattr__(self, "angles", tuple(angles.tolist()))
        object.__setattr__(self, "shifts", tuple((float(a), float(b)) for a, b in shifts))
        turned = np.abs(np.exp(1j * (angles - angles[:1])) - 1.0).max(initial=0.0) > 1e-9
        if angles.size < 2 or not (turned or np.ptp(shifts, axis=0).any()):
            raise NotSeparableError(
                f"{self.name}: the part was neither turned nor shifted, so part and instrument "
                "cannot be distinguished"
            )
        object.__setattr__(self, "terms", count(self.terms, f"{self.name}: terms"))
        stored_in_si(self, positive, dx="length", dy="length")
        if self.power is not None:
            try:
                value, u_value = self.power
            except (TypeError, ValueError):
                raise DataError(
                    f"{self.name}: power must be the known value and its standard uncertainty, both "
                    f"in m, got {self.power!r}"
                ) from None
            value = real(value, f"{self.name}: the known power", dimension="length")
            u_value = not_negative(u_value, "power[1]", dimension="length")
            object.__setattr__(self, "power", (value, u_value))

    def simulate(self, truth: Parts, errors: Parts) -> FloatArray:
        stack, grid = self._given(truth, errors)
        basis = self._basis(grid, require_overlap(stack, self.name))
        part, instrument = basis.fit(stack)
        out = np.full((len(self.angles), *grid.shape), np.nan)
        for i in range(len(self.angles)):
            z = np.empty(basis.x.size)
            for block, piece in basis.blocks():
                z[piece] = instrument @ block + part @ self._moved(basis, piece, i)
            out[i][basis.mask] = z
        return out

    def null_space(self) -> tuple[Unobservable, ...]:
        aligned = rigid_terms(("part", "instrument"), ("piston", "tilt"))
        if self.power is not None:
            return aligned
        power = (Unobservable(p, "term", ("defocus",), _POWER) for p in ("part", "instrument"))
        return (*aligned, *power)

    def _names(self) -> list[str]:
        return [f"map {i + 1}" for i in range(len(self.angles))]

    def _basis(self, grid: MapGrid, mask: NDArray[np.bool_]) -> DiscBasis:
        return DiscBasis(grid, mask, zernike_terms_of(self.terms, "ansi"))

    def _moved(self, basis: DiscBasis, piece: slice, i: int) -> FloatArray:
        """Return the terms of the part where it lies in reading i."""
        x = basis.x[piece] - self.shifts[i][0] / basis.radius
        y = basis.y[piece] - self.shifts[i][1] / basis.radius
        c, s = math.cos(self.angles[i]), math.sin(self.angles[i])
        return zernike_values(c * x + s * y, -s * x + c * y, basis.nm)

    def _rows(self, basis: DiscBasis, block: FloatArray, piece: slice, i: int) -> FloatArray:
        """Return the design of one reading at some pixels, shape (unknowns, k)."""
        free = [k for k, nm in enumerate(basis.nm) if nm not in _RIGID]
        n = len(self.angles)
        planes = np.zeros((3 * n, block.shape[1]))
        planes[3 * i : 3 * i + 3] = np.stack([block[basis.nm.index(nm)] for nm in _RIGID])
        return np.concatenate([self._moved(basis, piece, i)[free], block[free], planes])

    def _separated(self, read: MapReadings) -> Separation:
        stack, grid, common, u_reading, history = read
        basis = self._basis(grid, common)
        n, p = len(self.angles), len(basis.nm)
        free = [k for k, nm in enumerate(basis.nm) if nm not in _RIGID]
        size = 2 * len(free) + 3 * n
        normal, right = np.zeros((size, size)), np.zeros(size)
        z = stack[:, basis.mask]
        for block, piece in basis.blocks():
            for i in range(n):
                rows = self._rows(basis, block, piece, i)
                normal += rows @ rows.T
                right += rows @ z[i, piece]
        known = free.index(basis.nm.index((2, 0))) if self.power is not None else None
        value, u_value = self.power if self.power is not None else (0.0, 0.0)
        solution = _Solution(normal, right, known, value)
        squares = 0.0
        for block, piece in basis.blocks():
            for i in range(n):
                left = z[i, piece] - solution.found @ self._rows(basis, block, piece, i)
                squares += float(left @ left)
        freedom = float(z.size - solution.rank)
        residual = np.array([[math.sqrt(squares)]])
        noise = noise_of(residual, freedom, u_reading)
        single = np.sqrt(np.diag(basis.inverse))[free]
        covariance = noise.value**2 * solution.inverse
        covariance = covariance + np.outer(solution.by_known, solution.by_known) * u_value**2
        parts, u, hidden = {}, {}, {}
        for k, name in enumerate(("part", "instrument")):
            own = slice(k * len(free), (k + 1) * len(free))
            gain = np.sqrt(np.maximum(np.diag(solution.inverse)[own], 0.0)) / single
            seen = solution.seen[own] & (gain <= self.largest_gain)
            full = np.zeros(p)
            full[free] = np.where(seen, solution.found[own], 0.0)
            spread = np.zeros((p, p))
            spread[np.ix_(free, free)] = covariance[own, own] * np.outer(seen, seen)
            parts[name] = basis.maps(full[None])[0]
            u[name] = basis.deviations(spread[None])[0]
            shown = np.zeros(p, dtype=bool)
            shown[free] = seen
            parts[f"zernike_{name}"] = np.where(shown, full, np.nan)
            u[f"zernike_{name}"] = np.where(
                shown, np.sqrt(np.maximum(np.diag(spread), 0.0)), np.nan
            )
            hidden[name] = [
                (term_name(*basis.nm[j]), float(g))
                for j, ok, g in zip(free, seen, gain, strict=True)
                if not ok
            ]
        messages = unit_warnings(stack, grid, np.array(self.angles))
        weak = {k: [t for t, _ in v if t != "defocus"] for k, v in hidden.items()}
        if any(weak.values()):
            text = "; ".join(f"{k}: {', '.join(v)}" for k, v in weak.items() if v)
            messages = (f"these shifts and turns do not determine {text}", *messages)
        null = rigid_terms(("part", "instrument"), ("piston", "tilt")) + tuple(
            Unobservable(name, "term", tuple(t for t, _ in terms), _REASON)
            for name, terms in hidden.items()
            if terms
        )
        audit = {
            "angles_deg": [math.degrees(a) for a in self.angles],
            "shifts_mm": [[a * 1e3, b * 1e3] for a, b in self.shifts],
            "terms": p,
            "radius_mm": basis.radius * 1e3,
            "condition": solution.condition,
            "power_nm": None if self.power is None else self.power[0] * 1e9,
        }
        return map_separation(
            self.name, grid, parts, u,
            self.null_space() if _same(null, self.null_space()) else null,
            noise, audit, messages, history, {"terms": self.terms}, basis.coordinates,
        )  # fmt: skip


@described_by(ShiftRotation, ShiftRotation.separate)
def shift_rotation(
    surfaces: Sequence[ArrayLike | Surface],
    angles: ArrayLike,
    shifts: ArrayLike,
    *,
    terms: int = 28,
    dx: float | None = None,
    dy: float | None = None,
    centre: tuple[float, float] | None = None,
    power: tuple[float, float] | None = None,
    u_reading: float | None = None,
) -> Separation:
    """Return part and instrument from maps of the part shifted and turned.

    Parameters
    ----------
    surfaces : sequence of Surface or array_like, shape (n_y, n_x), m
        One map for each position.

    Returns
    -------
    Separation
        ``.part``, ``.instrument`` over the common pixels without the terms of the null space, and
        ``.zernike_part``, ``.zernike_instrument`` with NaN for those.

    Notes
    -----
    All terms of part and instrument and a plane for each reading are fitted at once. Tilt is free in
    each reading, so all second-order terms of a merely shifted part are seen by nothing but planes:
    power and astigmatism are lost with shifts alone; turns bring back the astigmatism (unless all
    are by 180 degrees), power never: state it. Noise grows as radius/shift for third order, and its
    square for higher ones that turns do not show; ``audit["condition"]`` and `u` show it.

    References
    ----------
    D. Su, E. Miyashiro, R. E. Parks, Opt. Eng. 51 (2012) 013604 (shift-rotation absolute testing).

    Examples
    --------
    >>> import numpy as np
    >>> x = np.linspace(-1, 1, 41)
    >>> P, I = (lambda x, y: 9e-9 * x**3), (lambda x, y: 5e-9 * x * y**2)
    >>> y = x[:, None]
    >>> maps = [I(x, y) + P(x, y), I(x, y) + P(x - 0.2, y), I(x, y) + P(y, -x)]
    >>> result = shift_rotation(maps, [0, 0, np.pi / 2], [[0, 0], [0.2, 0], [0, 0]], dx=0.05)
    >>> [i.indices for i in result.null_space if "defocus" in i.indices]
    [('defocus',), ('defocus',)]
    """
    turns, moves, maps = cast(Any, angles), cast(Any, shifts), cast(Any, surfaces)
    method = ShiftRotation(turns, moves, terms, dx, dy, centre, power)
    return method.separate(maps, u_reading=u_reading)


class _Solution:
    """Scaled normal equations with their null space; one unknown may be known."""

    def __init__(
        self, normal: FloatArray, right: FloatArray, known: int | None, value: float
    ) -> None:
        scale = np.sqrt(np.diag(normal))
        if not (scale > 0.0).all():
            raise DegenerateFitError(
                "shift_rotation: a Zernike term vanishes on the common pixels"
            )
        keep = np.array([i for i in range(right.size) if i != known])
        scaled = normal / np.outer(scale, scale)
        values, vectors = np.linalg.eigh(scaled[np.ix_(keep, keep)])
        good = values > _NULL * values[-1]
        root = vectors[:, good] / np.sqrt(values[good])
        pseudo = root @ root.T
        free = right / scale
        if known is not None:
            free = free - scaled[:, known] * (value * scale[known])
        self.found = np.zeros(right.size)
        self.found[keep] = (pseudo @ free[keep]) / scale[keep]
        self.inverse = np.zeros(normal.shape)
        self.inverse[np.ix_(keep, keep)] = pseudo / np.outer(scale[keep], scale[keep])
        self.by_known = np.zeros(right.size)
        self.seen = np.ones(right.size, dtype=bool)
        self.seen[keep] = np.sqrt((vectors[:, ~good] ** 2).sum(axis=1)) < _TOUCHED
        if known is not None:
            self.found[known], self.by_known[known] = value, 1.0
            self.by_known[keep] = -(pseudo @ scaled[keep, known]) * scale[known] / scale[keep]
        self.rank = int(good.sum())
        self.condition = float(math.sqrt(values[-1] / values[good][0]))


_POWER = (
    "a shifted paraboloid differs from itself by a tilt, which is free: only the sum of the powers is "
    "seen; give power= from another test"
)

_REASON = (
    "a part shifted or turned like this changes by a plane there, or hardly at all; larger shifts, "
    "more angles, or power= from another test"
)


def _same(found: Sequence[Unobservable], expected: Sequence[Unobservable]) -> bool:
    return {(i.part, i.indices) for i in found} == {(i.part, i.indices) for i in expected}
