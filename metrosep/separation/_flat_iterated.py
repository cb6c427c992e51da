"""From the readings of three flats to maps by iterated Zernike terms, each reading with its mask."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from metrosep.core._arrays import FloatArray
from metrosep.separation._flat_iteration import OwnMasks
from metrosep.separation._flat_result import FlatResult, registration_of_flats, undescribed
from metrosep.separation._flat_setups import FLATS, FlatSetup
from metrosep.separation._flat_zernike import DiscBasis, FlatZernikeSolver
from metrosep.separation._map_input import MapGrid
from metrosep.separation._map_orders import mirror
from metrosep.separation._map_results import noise_of


def by_iteration(
    solver: FlatZernikeSolver,
    stack: FloatArray,
    grid: MapGrid,
    setups: Sequence[FlatSetup],
    flip: str,
    *,
    radius: float | None,
    aligned: Sequence[tuple[int, int]],
    u_reading: float | None,
    u_shift: FloatArray,
) -> FlatResult:
    """Return coefficients and maps of Zernike terms from all pixels that each reading has."""
    measured = np.isfinite(stack)
    anywhere = np.logical_or.reduce(measured, axis=0)
    basis = DiscBasis(grid, anywhere | mirror(anywhere, flip), solver.nm, radius)
    system = OwnMasks(basis, solver, measured, aligned)
    p = len(basis.nm)
    iterated = system.iterate(system.right_side(stack))
    residual = system.residual(stack, iterated.coefficients)
    known = residual[np.isfinite(residual)]
    freedom = float(known.size - system.rank - len(setups) * system.rigid.size)
    noise = noise_of(known[None], freedom, u_reading)
    seen = solver.seen & np.isin(np.arange(p), system.free)
    kept = np.where(seen, iterated.coefficients.reshape(3, p), 0.0)
    shown = _faces(measured, setups, flip)
    blocks = system.inverse.reshape(3, p, 3, p)
    covariance = np.stack(
        [blocks[k, :, k, :] * np.outer(seen[k], seen[k]) for k in range(3)]
    )  # of the pixels' least squares, to which the steps converge

    def linear(one: FloatArray) -> FloatArray:
        found = (system.inverse @ system.right_side(one)).reshape(3, p)
        return basis.maps(np.where(seen, found, 0.0))

    share = registration_of_flats(
        linear, basis.maps(kept), setups, grid, flip, u_shift
    )  # fmt: skip
    u = np.sqrt((noise.value * basis.deviations(covariance)) ** 2 + share**2)
    spread = noise.value * np.sqrt(np.einsum("aii->ai", covariance))
    maps = np.where(shown, basis.maps(kept), np.nan)
    parts = dict(zip(FLATS, maps, strict=True))
    u_parts = dict(zip(FLATS, np.where(shown, u, np.nan), strict=True))
    for k, flat in enumerate(FLATS):
        parts[f"zernike_{flat}"] = np.where(seen[k], kept[k], np.nan)
        u_parts[f"zernike_{flat}"] = np.where(seen[k], spread[k], np.nan)
    coordinates = {
        "zernike_n": np.array([n for n, _ in basis.nm], dtype=np.float64),
        "zernike_m": np.array([m for _, m in basis.nm], dtype=np.float64),
    }
    audit: dict[str, object] = {
        "terms": p,
        "radius_mm": basis.radius * 1e3,
        "residual_rms_nm": float(np.sqrt(np.mean(known**2))) * 1e9,
        "iterations": len(iterated.left),
        "left_of_the_difference": iterated.left[-1] if iterated.left else 0.0,
        "n_pixels_of_all_readings": int(known.size),
    }
    messages = () if iterated.settled else (_unsettled(iterated.left),)
    return FlatResult(
        parts, u_parts, noise, coordinates, messages, audit, undescribed(residual, stack)
    )


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
