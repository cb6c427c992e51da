"""What the errors of a table's entries have in common, and of what lies between and beyond them.

A table adds straight lines between its entries, so its error at p is ``w_a d_a + w_b d_b``, with d
the errors of the two entries beside p. Their covariance C gives the variance
``w_a^2 C_aa + w_b^2 C_bb + 2 w_a w_b C_ab``: that of independent entries is too small where they
err alike, that of the interpolated u is too large where they do not.

Two tables in one (`metrosep.compensation.combine`): at the entries of the new one the errors of the
old one are in its measurement and cancel. Elsewhere ``d_old(p) - L d_old(p)`` is left of them, with
L the lookup of the new table: what bends between its entries, and beyond its end, where it is held,
the change from there.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from metrosep.core._arrays import FloatArray

Covariance = Callable[[FloatArray], FloatArray]
"""Covariance in m^2, shape (n, n), of what a table adds at positions in m, shape (n,)."""

_BLOCK = 256
"""Positions of which the covariance is looked at together: 30 000 entries have no square of their number."""


def variance(covariance: Covariance, p: FloatArray) -> FloatArray:
    """Return the variance at positions, shape (n,), m^2."""
    blocks = [p[i : i + _BLOCK] for i in range(0, p.size, _BLOCK)]
    found = [np.diag(covariance(block)) for block in blocks]
    return np.asarray(np.maximum(np.concatenate([np.empty(0), *found]), 0.0))


@dataclass(frozen=True, slots=True, eq=False)
class EntryCovariance:
    """Covariance of a table that was made of an estimate."""

    positions: FloatArray  # shape (n,), m: of the entries, rising
    of_error: Covariance  # of the error minus that at the reference

    def __call__(self, p: FloatArray) -> FloatArray:
        """Return the covariance at positions, the ends held as the table holds them, (k, k), m^2."""
        nodes, weights = _looked_up(self.positions, p)
        return np.asarray(weights @ self.of_error(self.positions[nodes]) @ weights.T)


@dataclass(frozen=True, slots=True, eq=False)
class RestOfOld:
    """Covariance of what a new table, measured on top of an old one, leaves of the old one's errors."""

    old: Covariance
    entries: FloatArray  # shape (n,), m: positions of the new one

    def __call__(self, p: FloatArray) -> FloatArray:
        """Return the covariance at positions, shape (k, k), m^2; exactly 0 at the entries."""
        nodes, weights = _looked_up(self.entries, p)
        rest = np.hstack([np.eye(p.size), -weights])
        out = rest @ self.old(np.concatenate([p, self.entries[nodes]])) @ rest.T
        at = np.isin(p, self.entries)
        out[at], out[:, at] = 0.0, 0.0
        return np.asarray(out)


@dataclass(frozen=True, slots=True, eq=False)
class JoinedCovariance:
    """Covariance of a new table on top of an old one, which were measured independently."""

    rest: RestOfOld
    new: Covariance

    def __call__(self, p: FloatArray) -> FloatArray:
        """Return the covariance at positions, shape (n, n), m^2."""
        return np.asarray(self.new(p) + self.rest(p))


def _looked_up(positions: FloatArray, p: FloatArray) -> tuple[NDArray[np.intp], FloatArray]:
    """Return which entries a lookup at p takes, (m,), and their weights, (k, m); the ends are held."""
    at = np.clip(p, positions[0], positions[-1])
    right = np.clip(np.searchsorted(positions, at), 1, positions.size - 1)
    share = (at - positions[right - 1]) / (positions[right] - positions[right - 1])
    nodes, back = np.unique(np.concatenate([right - 1, right]), return_inverse=True)
    weights: FloatArray = np.zeros((at.size, nodes.size))
    rows = np.arange(at.size)
    weights[rows, back[: at.size]] = 1.0 - share
    weights[rows, back[at.size :]] += share
    return nodes, weights
