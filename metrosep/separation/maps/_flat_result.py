"""From the readings of three flats to parts, uncertainties and null space, by each method."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from metrosep.core._arrays import FloatArray
from metrosep.core.errors import DataError, DegenerateFitError
from metrosep.core.quantity import Quantity
from metrosep.forms.zernike import ZernikeOrder, nm_to_ansi, term_indices, term_name, to_nm
from metrosep.forms.zernike_fit import zernike_values
from metrosep.separation.contract import Unobservable
from metrosep.separation.maps._map_input import (
    RIGID,
    MapGrid,
    TurnedNoise,
    class_share,
    coarse,
    combined,
    mirror,
    mirrored_trials,
    noise_of,
    orders_of,
    residual_warnings,
    smoothness,
    solve_order,
    turned,
    without_plane,
)
from metrosep.separation.maps.registration import (
    extended,
    map_gradient,
    registration_spread,
)

_BETTER = 0.5
_COARSE = 64
_UNDESCRIBED = 1.3
_ROUND_OFF = 1e-6

ODD_REASON = (
    "its share that changes sign under the mirror ({axis} -> -{axis}) is the same to all readings "
    "when all three flats have it; {what}"
)


@dataclass(frozen=True, slots=True)
class FlatResult:
    """What one method found."""

    parts: dict[str, FloatArray]  # to ndarray: maps and more
    u: dict[str, FloatArray]
    noise: Quantity  # of one pixel
    coordinates: dict[str, FloatArray] = field(default_factory=dict)  # to ndarray: beside x and y
    messages: tuple[str, ...] = ()  # what is to be said
    audit: dict[str, object] = field(default_factory=dict)  # plain values
    # that the residual is not noise; said where nothing explains it better
    unexplained: tuple[str, ...] = ()


def by_pixels(
    solver: FlatPixelSolver,
    stack: FloatArray,
    grid: MapGrid,
    *,
    removed: Sequence[str],
    u_reading: float | None,
    u_shift: FloatArray,
) -> FlatResult:
    """Return full maps, or those of the diameter where nothing was turned."""
    found, variance, residual, freedom, smooth = solver.solve(stack, grid, removed)
    if not np.isfinite(found).any():
        raise DataError(
            "three_flat: no pixel has its mirrored and turned counterparts in all maps; give maps "
            "with a common round aperture about the centre"
        )
    noise = noise_of(residual, freedom, u_reading)

    def linear(one: FloatArray) -> FloatArray:
        return without_plane(solver.parts(one, grid), grid, removed=removed)

    share = registration_of_flats(linear, found, solver.setups, grid, solver.flip, u_shift)
    u = np.sqrt(noise.value**2 * variance + share**2)
    u = np.where(np.isfinite(found), u, np.nan)
    odd = residual_warnings(residual, stack, expected=smooth)
    if solver.n > 1:
        return FlatResult(dict(zip(FLATS, found, strict=True)),
                          dict(zip(FLATS, u, strict=True)), noise, unexplained=odd)  # fmt: skip
    return replace(_diameter(found, u, noise, solver.flip), unexplained=odd)


def by_terms(
    solver: FlatZernikeSolver,
    basis: DiscBasis,
    stack: FloatArray,
    grid: MapGrid,
    *,
    u_reading: float | None,
    u_shift: FloatArray,
) -> FlatResult:
    """Return coefficients and maps of Zernike terms on the pixels that all readings have."""
    p, s = len(basis.nm), stack.shape[0]
    read = basis.fit(stack)
    least = solver.operator @ read.ravel()
    aligned_or_fitted = (solver.model @ least).reshape(s, p)
    hidden_rows = [i for i, nm in enumerate(basis.nm) if nm in ((0, 0), (1, 1), (1, -1))]
    aligned_or_fitted[:, hidden_rows] = read[:, hidden_rows]
    residual = np.where(basis.mask, stack, np.nan) - basis.maps(aligned_or_fitted)
    blocks = solver.operator.reshape(3, p, s, p) * solver.seen[:, :, None, None]
    covariance = np.einsum("aisk,kl,ajsl->aij", blocks, basis.inverse, blocks, optimize=True)

    def coefficients(one: FloatArray) -> FloatArray:
        return np.asarray(solver.operator @ basis.fit(one).ravel())

    return of_terms(
        solver, basis, stack, grid, least, solver.seen, covariance, coefficients, residual,
        solver.rank, u_reading, u_shift,
    )  # fmt: skip


def of_terms(
    solver: FlatZernikeSolver,
    basis: DiscBasis,
    stack: FloatArray,
    grid: MapGrid,
    found: FloatArray,
    seen: NDArray[np.bool_],
    covariance: FloatArray,
    coefficients: Callable[[FloatArray], FloatArray],
    residual: FloatArray,
    rank: int,
    u_reading: float | None,
    u_shift: FloatArray,
) -> FlatResult:
    """Return maps of coefficients with their uncertainty, NaN for terms that are not seen."""
    known = residual[np.isfinite(residual)]
    noise = noise_of(known[None], float(known.size - rank), u_reading)
    kept = np.where(seen, found.reshape(seen.shape), 0.0)
    maps = basis.maps(kept)

    def linear(one: FloatArray) -> FloatArray:
        return basis.maps(np.where(seen, coefficients(one).reshape(seen.shape), 0.0))

    share = registration_of_flats(linear, maps, solver.setups, grid, solver.flip, u_shift)
    u = np.sqrt((noise.value * basis.deviations(covariance)) ** 2 + share**2)
    spread = noise.value * np.sqrt(np.einsum("aii->ai", covariance))
    parts, u_parts = dict(zip(FLATS, maps, strict=True)), dict(zip(FLATS, u, strict=True))
    for k, flat in enumerate(FLATS):
        parts[f"zernike_{flat}"] = np.where(seen[k], kept[k], np.nan)
        u_parts[f"zernike_{flat}"] = np.where(seen[k], spread[k], np.nan)
    audit: dict[str, object] = {
        "terms": len(basis.nm),
        "radius_mm": basis.radius * 1e3,
        "residual_rms_nm": float(np.sqrt(np.mean(known**2))) * 1e9,
    }
    coordinates = basis.coordinates
    return FlatResult(
        parts, u_parts, noise, coordinates, audit=audit, unexplained=undescribed(residual, stack)
    )


def registration_of_flats(
    linear: Callable[[FloatArray], FloatArray],
    found: FloatArray,
    setups: Sequence[FlatSetup],
    grid: MapGrid,
    flip: str,
    u_shift: FloatArray,
) -> FloatArray | float:
    """Return the standard uncertainty of A, B, C from the registration of the readings."""

    def effects() -> Iterator[tuple[int, FloatArray]]:
        for i, item in enumerate(setups):
            if u_shift[i].any():
                first, second = facing(found, item, grid, flip)
                slopes = map_gradient(first if item.turn_first else second, grid)
                yield from ((i, extended(s) * u) for s, u in zip(slopes, u_shift[i], strict=True))

    return registration_spread(linear, len(setups), effects())


def warnings_of_flats(
    solver: FlatPixelSolver, stack: FloatArray, grid: MapGrid
) -> tuple[str, ...]:
    """Return which reading would fit much better if it were mirrored or turned the other way."""
    small, small_grid = coarse(stack, grid, _COARSE)

    def left(one: FlatPixelSolver, maps: FloatArray) -> float:
        residual = one.residual(maps, small_grid, RIGID)
        known = residual[np.isfinite(residual)]
        return float(np.sqrt(np.mean(known**2))) if known.size else np.inf

    given = left(solver, small)
    if not given > 1e-6 * float(np.sqrt(np.nanmean(small**2))):
        return ()
    trials = []
    for rest, i, axis in mirrored_trials(small, lambda maps: left(solver, maps)):
        name = solver.setups[i].pair + (" turned" if i > 2 else "")
        trials.append((rest, f"reading {i + 1} ({name}) looks mirrored: with {axis} reversed"))
    other = "y" if solver.flip == "x" else "x"
    across = FlatPixelSolver(solver.setups, solver.n, other, 50.0)
    trials.append(
        (left(across, small), f"flip={other!r} fits better than {solver.flip!r}: with it")
    )
    if solver.n > 2:
        back = [FlatSetup(s.first, s.second, -s.turn_first, -s.turn_second) for s in solver.setups]
        opposite = FlatPixelSolver(back, solver.n, solver.flip, 50.0)
        text = "angles of the opposite sign fit better (counter-clockwise is positive): with them"
        trials.append((left(opposite, small), text))
    best, text = min(trials)
    if best > _BETTER * given:
        return ()
    return (f"{text} {best * 1e9:.3g} nm are left instead of {given * 1e9:.3g} nm",)


def hidden_orders(solver: FlatPixelSolver) -> tuple[Unobservable, ...]:
    """Return the angular orders that a pixel method leaves unknown."""
    what = (
        "nothing was turned, so it is known on the diameter only; measure a turned flat"
        if solver.n == 1
        else f"turns by multiples of {360.0 / solver.n:.6g} deg do not change it; further orders follow in "
        f"steps of {solver.n}; add another angle"
    )
    reason = ODD_REASON.format(axis=solver.flip, what=what)
    both = ((solver.odd_lost, reason), (solver.even_lost, "the set-ups do not determine them"))
    return tuple(
        Unobservable(flat, "angular order", lost[k], why)
        for lost, why in both
        for k, flat in enumerate(FLATS)
        if lost[k]
    )


def _diameter(found: FloatArray, u: FloatArray, noise: Quantity, flip: str) -> FlatResult:
    """Return the mirror-even shares, and maps of the diameter alone."""
    along = found if flip == "x" else np.swapaxes(found, 1, 2)
    spread = u if flip == "x" else np.swapaxes(u, 1, 2)
    n = along.shape[2]
    parts, u_parts, messages = {}, {}, []
    for k, flat in enumerate(FLATS):
        full, u_full = np.full(along[k].shape, np.nan), np.full(along[k].shape, np.nan)
        if n % 2:
            line = along[k, :, n // 2]
            u_line = spread[k, :, n // 2]
            full[:, n // 2], u_full[:, n // 2] = line, u_line
        else:  # even in the mirrored coordinate: three columns stand for six
            weights = np.array([150.0, -25.0, 3.0]) / 128.0
            columns = slice(n // 2, n // 2 + 3)
            line = along[k, :, columns] @ weights
            u_line = np.sqrt(spread[k, :, columns] ** 2 @ weights**2)
        parts[flat] = full if flip == "x" else full.T
        u_parts[flat] = u_full if flip == "x" else u_full.T
        for name, values, uncertainty in (
            ("diameter", line, u_line), ("even", found[k], u[k]),
        ):  # fmt: skip
            parts[f"{name}_{flat}"], u_parts[f"{name}_{flat}"] = values, uncertainty
    messages.append(
        "no flat was turned: A, B and C are known on the diameter only and NaN beside it; "
        "even_A, even_B, even_C are their mirror-even shares on the whole aperture"
    )
    if n % 2 == 0:
        messages.append(
            f"the diameter lies between two pixels of {n}, so no pixel of A, B, C is on it; it is "
            "interpolated in diameter_A, diameter_B, diameter_C"
        )
    return FlatResult(parts, u_parts, noise, messages=tuple(messages))


def undescribed(residual: FloatArray, stack: FloatArray) -> tuple[str, ...]:
    """Say that the residual is not white: neighbours resemble each other."""
    known, read = residual[np.isfinite(residual)], stack[np.isfinite(stack)]
    if known.size == 0:
        return ()
    whole = float(np.sqrt(np.mean(known**2)))
    if whole <= _ROUND_OFF * float(np.sqrt(np.mean(read**2))):
        return ()
    if smoothness(residual) <= _UNDESCRIBED:
        return ()
    text = (
        f"the readings hold {whole * 1e9:.3g} nm RMS that these Zernike terms do not describe and "
        "that is not noise; it counts as noise here, and method='pixel' would keep it. If the flats "
        "have no such waves, check the set-up: which flat was turned, angles, order of the readings"
    )
    return (text,)


# ---- set-ups of a three-flat test: which flats face each other, how they are turned and mirrored ----

FLATS = ("A", "B", "C")


@dataclass(frozen=True, slots=True)
class FlatSetup:
    """One reading: ``R(turn_first) first + R(turn_second) F second``, F the mirror."""

    first: str  # "A", "B" or "C"
    second: str  # faces the first and is seen mirrored
    turn_first: float = 0.0  # rad, counter-clockwise in the map
    turn_second: float = 0.0

    @property
    def pair(self) -> str:
        """Names of both flats."""
        return self.first + self.second


def order_design(setups: Sequence[FlatSetup], order: int, mirror_sign: FloatArray) -> FloatArray:
    """Return the design of one angular order (or class of orders)."""
    out = np.zeros((2 * len(setups), 6))
    for s, item in enumerate(setups):
        rows = slice(2 * s, 2 * s + 2)
        a, b = 2 * FLATS.index(item.first), 2 * FLATS.index(item.second)
        out[rows, a : a + 2] += _turn(order * item.turn_first)
        out[rows, b : b + 2] += _turn(order * item.turn_second) * mirror_sign
    return out


def facing(
    maps: FloatArray, item: FlatSetup, grid: MapGrid, flip: str
) -> tuple[FloatArray, FloatArray]:
    """Return what the first and the second flat contribute to a reading."""
    first = maps[FLATS.index(item.first)][None]
    second = mirror(maps[FLATS.index(item.second)], flip)[None]
    return (
        turned(first, item.turn_first, grid)[0][0],
        turned(second, item.turn_second, grid)[0][0],
    )


def _turn(angle: float) -> FloatArray:
    c, s = np.cos(angle), np.sin(angle)
    return np.array([[c, -s], [s, c]])


# ---- three flats pixel by pixel: even and odd shares of classes of angular orders --------------

_SEED = 20260727
_PIXELS_COARSE = 128


class FlatPixelSolver:
    """The linear operation from readings to A, B, C by sums of turned and mirrored readings."""

    def __init__(
        self, setups: Sequence[FlatSetup], n: int, flip: str, largest_gain: float
    ) -> None:
        self.setups, self.n, self.flip = setups, n, flip
        shape = (3, len(setups), n)
        self.direct, self.mirrored = np.zeros(shape), np.zeros(shape)
        self.all_direct, self.all_mirrored = np.zeros(shape), np.zeros(shape)
        self.freedom = 0.0
        even_lost: dict[int, list[int]] = {0: [], 1: [], 2: []}
        odd_lost: dict[int, list[int]] = {0: [], 1: [], 2: []}
        turns = 2.0 * np.pi * np.arange(n) / n
        sign = np.array([1.0, -1.0])
        for q in range(n // 2 + 1):
            # a turn mixes the even share e and the odd one's quadrature o' the other way round
            solved = solve_order(order_design(setups, -q, sign))
            share = class_share(q, n) / n
            self.freedom += share * (2 * len(setups) - solved.rank) / 2.0
            seen = solved.seen & (solved.gain <= largest_gain)
            for p in range(3):
                w = np.real(solved.weights[2 * p : 2 * p + 2])
                self._add(self.all_direct[p], self.all_mirrored[p], w, q * turns, share)
                kept = w * seen[2 * p : 2 * p + 2, None]
                self._add(self.direct[p], self.mirrored[p], kept, q * turns, share)
                if not seen[2 * p]:
                    even_lost[p].append(q)
                if not seen[2 * p + 1]:
                    odd_lost[p].append(q)
        self.even_lost = {p: orders_of(v, n) if v else () for p, v in even_lost.items()}
        self.odd_lost = {
            p: tuple(m for m in orders_of(v, n) if m > 0) if v else () for p, v in odd_lost.items()
        }

    @staticmethod
    def _add(
        direct: FloatArray, mirrored: FloatArray, w: FloatArray, angle: FloatArray, share: float
    ) -> None:
        w1, w2, w3, w4 = w[0, 0::2], w[0, 1::2], w[1, 0::2], w[1, 1::2]
        c, s = np.cos(angle), np.sin(angle)
        direct += share / 2.0 * (np.outer(w1 + w4, c) + np.outer(w2 - w3, s))
        mirrored += share / 2.0 * (np.outer(w1 - w4, c) + np.outer(w2 + w3, s))

    def parts(self, stack: FloatArray, grid: MapGrid) -> FloatArray:
        """Return A, B, C without what is not observable."""
        return combined(stack, grid, self.direct, self.mirrored, flip=self.flip)

    def solve(
        self, stack: FloatArray, grid: MapGrid, removed: Sequence[str]
    ) -> tuple[FloatArray, FloatArray, FloatArray, float, float]:
        """Return parts, their variance, the residual of the readings, its freedom and smoothness."""
        parts = self.parts(stack, grid)
        variance = TurnedNoise(grid, self.n, self.flip).variance(self.direct, self.mirrored)
        parts = without_plane(parts, grid, removed=removed)
        residual = self.residual(stack, grid, removed)
        measured = float(np.isfinite(residual).all(axis=0).sum())
        if self.n in (1, 2, 4):
            return parts, variance, residual, self.freedom * measured, 1.0
        rng = np.random.default_rng(_SEED)
        small, small_grid = coarse(stack, grid, _PIXELS_COARSE)
        unit = np.where(np.isfinite(small), rng.standard_normal(small.shape), np.nan)
        left = self.residual(unit, small_grid, removed)
        known = np.isfinite(left).all(axis=0)
        freedom = float((left[:, known] ** 2).sum(axis=0).mean()) if known.any() else 0.0
        return parts, variance, residual, freedom * measured, smoothness(left)

    def residual(self, stack: FloatArray, grid: MapGrid, removed: Sequence[str]) -> FloatArray:
        """Return what the model leaves of the readings."""
        least = combined(stack, grid, self.all_direct, self.all_mirrored, flip=self.flip)
        out = []
        for z, item in zip(stack, self.setups, strict=True):
            first, second = facing(least, item, grid, self.flip)
            out.append(z - first - second)
        return without_plane(np.stack(out), grid, removed=removed)


# ---- three flats in a Zernike basis: one least-squares system for each angular order -----------

_BLOCK = 16384
_WORST_CONDITION = 1e6
MOST_TERMS = 1000
"""Beyond, the systems of equations grow out of all memory."""


def zernike_terms_of(
    terms: int | Sequence[int], order: ZernikeOrder
) -> tuple[tuple[int, int], ...]:
    """Return (n, m) of the terms and of their partners (n, -m), by ANSI number."""
    indices = () if isinstance(terms, int) else tuple(terms)
    many = terms if isinstance(terms, int) else max([len(indices), *indices], default=0)
    if many > MOST_TERMS:
        raise DataError(f"terms go up to {MOST_TERMS}, got {many}; use fewer, or method='pixel'")
    chosen = {to_nm(i, order) for i in term_indices(terms, order)} | {(0, 0), (1, 1)}
    both = chosen | {(n, -m) for n, m in chosen}
    return tuple(sorted(both, key=lambda nm: nm_to_ansi(*nm)))


class DiscBasis:
    """Zernike terms on the measured pixels of a disc, and their normal matrix."""

    def __init__(
        self,
        grid: MapGrid,
        mask: NDArray[np.bool_],
        nm: Sequence[tuple[int, int]],
        radius: float | None = None,
    ) -> None:
        self.nm, self.mask, self.shape = tuple(nm), mask, grid.shape
        rows, columns = np.nonzero(mask)
        x, y = grid.x[columns], grid.y[rows]
        self.radius = float(np.hypot(x, y).max()) if radius is None else float(radius)
        if not (np.isfinite(self.radius) and self.radius > 0.0):
            raise DataError(f"radius is {radius} m; the disc needs a positive one")
        self.x, self.y = x / self.radius, y / self.radius
        if x.size < 3 * len(self.nm):
            raise DegenerateFitError(self._undetermined())
        normal = np.zeros((len(self.nm), len(self.nm)))
        for block, _ in self.blocks():
            normal += block @ block.T
        self.normal = normal
        if np.linalg.cond(normal) > _WORST_CONDITION:
            raise DegenerateFitError(self._undetermined())
        self.inverse = np.linalg.inv(normal)

    @property
    def coordinates(self) -> dict[str, FloatArray]:
        """Orders n and m of the terms."""
        n, m = np.array(self.nm, dtype=np.float64).T
        return {"zernike_n": n, "zernike_m": m}

    def _undetermined(self) -> str:
        return (
            f"{len(self.nm)} Zernike terms are not determined by the {self.x.size} pixels of the "
            "common mask; use fewer terms, state the radius and the centre, or method='pixel'"
        )

    def blocks(self) -> Iterator[tuple[FloatArray, slice]]:
        """Yield the terms, shape (p, k), at pieces of the pixels."""
        for start in range(0, self.x.size, _BLOCK):
            piece = slice(start, start + _BLOCK)
            yield zernike_values(self.x[piece], self.y[piece], self.nm), piece

    def fit(self, stack: FloatArray) -> FloatArray:
        """Return the coefficients of maps."""
        z = stack[:, self.mask]
        sums = np.zeros((stack.shape[0], len(self.nm)))
        for block, piece in self.blocks():
            sums += z[:, piece] @ block.T
        return np.asarray(sums @ self.inverse)

    def maps(self, coefficients: FloatArray) -> FloatArray:
        """Return maps of coefficients, NaN beside the mask."""
        out = np.full((coefficients.shape[0], *self.shape), np.nan)
        found = np.empty((coefficients.shape[0], self.x.size))
        for block, piece in self.blocks():
            found[:, piece] = coefficients @ block
        out[:, self.mask] = found
        return out

    def deviations(self, covariances: FloatArray) -> FloatArray:
        """Return standard deviations of maps whose coefficients have given covariances."""
        out = np.full((covariances.shape[0], *self.shape), np.nan)
        found = np.empty((covariances.shape[0], self.x.size))
        for block, piece in self.blocks():
            for k, c in enumerate(covariances):
                found[k, piece] = np.einsum("ij,ij->j", block, c @ block)
        out[:, self.mask] = np.sqrt(np.maximum(found, 0.0))
        return out


class FlatZernikeSolver:
    """The linear operation from coefficients of readings to those of A, B, C."""

    def __init__(
        self,
        setups: Sequence[FlatSetup],
        nm: Sequence[tuple[int, int]],
        flip: str,
        aligned: Sequence[tuple[int, int]],
        largest_gain: float,
    ) -> None:
        self.nm, self.setups, self.flip, self.aligned = tuple(nm), setups, flip, aligned
        place = {term: i for i, term in enumerate(self.nm)}
        p, s = len(self.nm), len(setups)
        self.seen = np.zeros((3, p), dtype=bool)
        self.operator = np.zeros((3 * p, s * p))
        self.model = np.zeros((s * p, 3 * p))
        self.rank = 0
        for n, m in self.nm:
            if m < 0:
                continue
            both = [place[n, m]] + ([place[n, -m]] if m else [])
            design = order_design(setups, m, _mirror_signs(m, flip))
            if m == 0:
                design = design[0::2, 0::2]
            solved = solve_order(design)
            rows = np.array([part * p + i for part in range(3) for i in both])
            columns = np.array([reading * p + i for reading in range(s) for i in both])
            self.operator[np.ix_(rows, columns)] = np.real(solved.weights)
            self.model[np.ix_(columns, rows)] = design
            if (n, m) in aligned:
                self.rank += s * len(both)
                continue
            self.rank += solved.rank
            self.seen[rows // p, rows % p] = solved.seen & (solved.gain <= largest_gain)

    def hidden_terms(self, part: int) -> tuple[str, ...]:
        """Return the names of the terms of one flat that turns and mirror leave unknown."""
        return tuple(
            f"{term_name(n, m)} [Z({n}, {m})]"
            for i, (n, m) in enumerate(self.nm)
            if not self.seen[part, i] and (n, m) not in self.aligned
        )


def _mirror_signs(m: int, flip: str) -> FloatArray:
    """Return the signs of cos(m t) and sin(m t) under x -> -x (t -> pi - t) or y -> -y (t -> -t)."""
    if flip == "y":
        return np.array([1.0, -1.0])
    even = 1.0 if m % 2 == 0 else -1.0
    return np.array([even, -even])
