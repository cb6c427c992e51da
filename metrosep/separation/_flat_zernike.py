"""Three flats in a Zernike basis: one least-squares system for each angular order."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np
from numpy.typing import NDArray

from metrosep.core._arrays import FloatArray
from metrosep.core.errors import DataError, DegenerateFitError
from metrosep.forms.zernike import ZernikeOrder, nm_to_ansi, term_indices, term_name, to_nm
from metrosep.forms.zernike_fit import zernike_values
from metrosep.separation._flat_setups import FlatSetup, order_design
from metrosep.separation._map_input import MapGrid
from metrosep.separation._map_orders import solve_order

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
        self.nm = tuple(nm)
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

    def hidden_terms(self, aligned: Sequence[tuple[int, int]]) -> dict[int, tuple[str, ...]]:
        """Return the names of the terms that turns and mirror leave unknown, for each flat."""
        return {
            part: tuple(
                f"{term_name(n, m)} [Z({n}, {m})]"
                for i, (n, m) in enumerate(self.nm)
                if not self.seen[part, i] and (n, m) not in aligned
            )
            for part in range(3)
        }


def _mirror_signs(m: int, flip: str) -> FloatArray:
    """Return the signs of cos(m t) and sin(m t) under x -> -x (t -> pi - t) or y -> -y (t -> -t)."""
    if flip == "y":
        return np.array([1.0, -1.0])
    even = 1.0 if m % 2 == 0 else -1.0
    return np.array([even, -even])
