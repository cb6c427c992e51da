"""From the readings of three flats to parts, uncertainties and null space, by each method."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from metrosep.core._arrays import FloatArray
from metrosep.core.errors import DataError
from metrosep.core.quantity import Quantity
from metrosep.separation._flat_pixels import FlatPixelSolver
from metrosep.separation._flat_setups import FLATS, FlatSetup, facing
from metrosep.separation._flat_zernike import DiscBasis, FlatZernikeSolver
from metrosep.separation._map_input import MapGrid
from metrosep.separation._map_orders import RIGID, coarse, mirror, without_plane
from metrosep.separation._map_results import noise_of
from metrosep.separation._map_whiteness import residual_doubts, smoothness
from metrosep.separation.contract import Unobservable
from metrosep.separation.registration import extended, map_gradient

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
    # that the residual is no noise; said where nothing explains it better
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
        return np.stack([without_plane(z, grid, removed=removed) for z in solver.parts(one, grid)])

    share = registration_of_flats(linear, found, solver.setups, grid, solver.flip, u_shift)
    u = np.sqrt(noise.value**2 * variance + share**2)
    u = np.where(np.isfinite(found), u, np.nan)
    odd = residual_doubts(residual, stack, expected=smooth)
    if solver.n > 1:
        return FlatResult(dict(zip(FLATS, found, strict=True)),
                          dict(zip(FLATS, u, strict=True)), noise, unexplained=odd)  # fmt: skip
    return replace(_diameter(found, u, noise, solver.flip), unexplained=odd)


def by_terms(
    solver: FlatZernikeSolver,
    basis: DiscBasis,
    stack: FloatArray,
    grid: MapGrid,
    setups: Sequence[FlatSetup],
    flip: str,
    *,
    u_reading: float | None,
    u_shift: FloatArray,
) -> FlatResult:
    """Return coefficients and maps of Zernike terms."""
    p, s = len(basis.nm), stack.shape[0]
    shown = solver.seen.ravel()

    def coefficients(maps: FloatArray) -> FloatArray:
        return np.asarray((solver.operator @ basis.fit(maps).ravel()).reshape(3, p))

    read = basis.fit(stack)
    least = solver.operator @ read.ravel()
    aligned_or_fitted = (solver.model @ least).reshape(s, p)
    hidden_rows = [i for i, nm in enumerate(basis.nm) if nm in ((0, 0), (1, 1), (1, -1))]
    aligned_or_fitted[:, hidden_rows] = read[:, hidden_rows]
    residual = stack[:, basis.mask] - basis.maps(aligned_or_fitted)[:, basis.mask]
    noise = noise_of(residual, float(residual.size - solver.rank), u_reading)
    kept = np.where(shown, least, 0.0).reshape(3, p)
    found = basis.maps(kept)
    blocks = solver.operator.reshape(3, p, s, p) * solver.seen[:, :, None, None]
    covariance = np.einsum("aisk,kl,ajsl->aij", blocks, basis.inverse, blocks, optimize=True)

    def linear(one: FloatArray) -> FloatArray:
        return basis.maps(coefficients(one) * solver.seen)

    share = registration_of_flats(linear, found, setups, grid, flip, u_shift)
    u = np.sqrt((noise.value * basis.deviations(covariance)) ** 2 + share**2)
    spread = noise.value * np.sqrt(np.einsum("aii->ai", covariance))
    parts = dict(zip(FLATS, found, strict=True))
    u_parts = dict(zip(FLATS, u, strict=True))
    for k, flat in enumerate(FLATS):
        parts[f"zernike_{flat}"] = np.where(solver.seen[k], kept[k], np.nan)
        u_parts[f"zernike_{flat}"] = np.where(solver.seen[k], spread[k], np.nan)
    coordinates = {
        "zernike_n": np.array([n for n, _ in basis.nm], dtype=np.float64),
        "zernike_m": np.array([m for _, m in basis.nm], dtype=np.float64),
    }
    audit: dict[str, object] = {
        "terms": p,
        "radius_mm": basis.radius * 1e3,
        "residual_rms_nm": float(np.sqrt(np.mean(residual**2))) * 1e9,
    }
    left = np.full(stack.shape, np.nan)
    left[:, basis.mask] = residual
    return FlatResult(parts, u_parts, noise, coordinates, undescribed(left, stack), audit)


def registration_of_flats(
    linear: Callable[[FloatArray], FloatArray],
    found: FloatArray,
    setups: Sequence[FlatSetup],
    grid: MapGrid,
    flip: str,
    u_shift: FloatArray,
) -> FloatArray:
    """Return the standard uncertainty of A, B, C from the registration of the readings."""
    total = np.zeros(found.shape)
    for i, item in enumerate(setups):
        if not u_shift[i].any():
            continue
        first, second = facing(found, item, grid, flip)
        slopes = map_gradient(first if item.turn_first else second, grid)
        for slope, u in zip(slopes, u_shift[i], strict=True):
            one = np.zeros((len(setups), *grid.shape))
            one[i] = extended(slope) * u
            total = total + linear(one) ** 2
    return np.sqrt(total)


def doubts_of_flats(solver: FlatPixelSolver, stack: FloatArray, grid: MapGrid) -> tuple[str, ...]:
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
    for i, item in enumerate(solver.setups):
        name = f"{item.first}{item.second}" + (" turned" if i > 2 else "")
        for axis in ("x", "y"):
            flipped = small.copy()
            flipped[i] = mirror(small[i], axis)
            text = f"reading {i + 1} ({name}) looks mirrored: with {axis} reversed"
            trials.append((left(solver, flipped), text))
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
    out = [
        Unobservable(flat, "angular order", solver.odd_lost[k], reason)
        for k, flat in enumerate(FLATS)
        if solver.odd_lost[k]
    ]
    out += [
        Unobservable(
            flat, "angular order", solver.even_lost[k], "the set-ups do not determine them"
        )
        for k, flat in enumerate(FLATS)
        if solver.even_lost[k]
    ]
    return tuple(out)


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
        "that is no noise; it counts as noise here, and method='pixel' would keep it. If the flats "
        "have no such waves, check the set-up: which flat was turned, angles, order of the readings"
    )
    return (text,)
