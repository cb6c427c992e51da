"""Private to separation: probes that read the same pass share the vibration of the machine.

Their readings are then not independent: n probes with correlation rho of the innovations hold the
information of n / (1 + rho (n - 1)) probes. Taken as independent, chance would pass as evidence.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from metrosep.core._arrays import FloatArray
from metrosep.separation.design import PreparedRun
from metrosep.spectral.autoregressive import AutoregressiveModel, whiten

__all__ = ["shared_passes", "sharing"]


def shared_passes(runs: Sequence[PreparedRun]) -> list[tuple[int, int]]:
    """Return pairs of runs of two probes with the same samples in time and place."""
    taken: set[tuple[int, str]] = set()
    pairs = []
    for j, b in enumerate(runs):
        for i, a in enumerate(runs[:j]):
            if a.probe == b.probe or (i, b.probe) in taken or (j, a.probe) in taken:
                continue
            if a.x.size == b.x.size and np.array_equal(a.t, b.t) and np.array_equal(a.x, b.x):
                pairs.append((i, j))
                taken |= {(i, b.probe), (j, a.probe)}
    return pairs


def sharing(
    pairs: Sequence[tuple[int, int]],
    residuals: Sequence[FloatArray],
    groups: Sequence[Sequence[int]],
    noise: Sequence[AutoregressiveModel],
    n_probes: int,
) -> tuple[float, float]:
    """Return by how much the variance of a row grows, and the correlation behind it."""
    if not pairs:
        return 1.0, 0.0
    owner = {i: g for g, group in enumerate(groups) for i in group}
    total, size = 0.0, 0
    for i, j in pairs:
        both = [whiten(residuals[r], noise[owner[r]].coefficients) for r in (i, j)]
        n = min(e.size for e in both)
        table = np.stack([e[-n:] for e in both])
        table = table[:, ~np.isnan(table).any(axis=0)]
        total += float(np.asarray(np.corrcoef(table))[0, 1])
        size += table.shape[1]
    rho = total / len(pairs)
    if rho < 3.0 / math.sqrt(max(size, 1)):
        return 1.0, rho
    return 1.0 + rho * (n_probes - 1), rho
