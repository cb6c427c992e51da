"""Private: Gaussian weighting along one axis as two passes of small banded matrices.

The Gaussian is split into two of half the variance. The first pass brings the samples onto a
coarse grid (2.4 nodes per standard deviation), the second brings them back; the sum over the nodes
equals the one Gaussian to 1e-12. First and second moments about a sample are derivatives of the
zeroth one, so they cost only other weights in the second pass and nothing in the first. A narrow
Gaussian (less than two samples per node) is applied in one pass.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from metrosep.core._arrays import FloatArray, IntArray
from metrosep.filters._kernel import WINDOW, lattice_sum

_NODES_PER_SD = 2.4
"""Coarse nodes per standard deviation: 2 exp(-pi^2 2.4^2 / 2) = 9e-13 of aliasing."""


class Piece(NamedTuple):
    """A dense piece of a banded matrix: ``out[start:stop] += matrix @ in[first:last]``."""

    start: int
    stop: int
    first: int
    last: int
    matrix: FloatArray


@dataclass(frozen=True, slots=True)
class Axis:
    """The two passes along one axis of `n` pixels."""

    n: int
    n_nodes: int
    down: tuple[Piece, ...] | None
    up: tuple[Piece, ...]


def make_axis(n: int, sd: float, block: int) -> Axis:
    """Return the passes of a Gaussian of `sd` pixels along `n` pixels.

    The matrices of `up` hold three blocks of rows: the weights times 1, u and u^2, where u is the
    distance in standard deviations from the pixel to the datum.
    """
    pitch = int(sd / _NODES_PER_SD)
    if pitch < 2:
        u_max, scale = WINDOW * sd, 1.0 / lattice_sum(sd)

        def weights(u: FloatArray) -> FloatArray:
            v = u / sd
            g = scale * np.exp(-0.5 * v * v)
            return np.concatenate([g, v * g, v * v * g])

        return Axis(n, n, None, _pieces(np.arange(n), np.arange(n), u_max, block, weights))
    reach = math.ceil(WINDOW * sd / math.sqrt(2.0))
    nodes = pitch * np.arange(-(reach // pitch), (n - 1 + reach) // pitch + 1)
    norm = 1.0 / (sd * math.sqrt(math.pi))

    def narrow(u: FloatArray) -> FloatArray:
        v = u / sd
        return np.asarray(norm * np.exp(-v * v))

    def moments(u: FloatArray) -> FloatArray:
        v = u / sd
        g = (pitch * norm) * np.exp(-v * v)
        return np.concatenate([g, 2.0 * v * g, (4.0 * v * v - 1.0) * g])

    pixels = np.arange(n)
    return Axis(
        n,
        nodes.size,
        _pieces(nodes, pixels, reach, max(8, block // pitch), narrow),
        _pieces(pixels, nodes, reach, block, moments),
    )


def _pieces(
    targets: IntArray,
    sources: IntArray,
    reach: float,
    block: int,
    weights: Callable[[FloatArray], FloatArray],
) -> tuple[Piece, ...]:
    """Cut the matrix weights(source - target) into dense pieces of `block` targets."""
    pieces = []
    for start in range(0, targets.size, block):
        part = targets[start : start + block]
        first = int(np.searchsorted(sources, part[0] - reach))
        last = int(np.searchsorted(sources, part[-1] + reach, side="right"))
        u = (sources[None, first:last] - part[:, None]).astype(np.float64)
        pieces.append(Piece(start, start + part.size, first, last, weights(u)))
    return tuple(pieces)
