"""What the errors of an estimate at different positions have in common.

An estimate that is too high here is, as a rule, too high a little further on: its errors are
correlated over the travel, and a difference, a mean or a polynomial of them has another uncertainty
than independent errors would give. The covariance is kept as few modes, curves of unit variance
that do not depend on each other,

    cov(x, x') = s(x) s(x') sum_r m_r(x) m_r(x') + sqrt(d(x) d(x')) max(0, 1 - |x - x'| / h),

with straight lines between nodes that are h apart. ``d = u^2 - s^2 sum_r m_r^2`` is what the modes
lack of the stated variance: waves shorter than the nodes tell apart, modes that were dropped, and
what a method adds to its uncertainty without a form (step of coarse readings, waves that were cut
off). It is common to neighbours nearer than h only, so neither differences nor means of positions
profit from it. ``s <= 1`` sees to it that the diagonal is ``u^2`` everywhere.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from metrosep.core._arrays import FloatArray
from metrosep.core.errors import DataError

_MAX_NODES = 241
"""Nodes over the travel: with so many modes a stored result grows by less than 100 kB."""

_MAX_MODES = 60

_LEFT_OUT = 1e-4
"""Share of the variance, summed over the travel, that modes which are not kept may hold."""

_STEPS = 9999
"""Of the greatest value of a mode: digits beyond are neither kept nor stored."""


@dataclass(frozen=True, slots=True, eq=False)
class CovarianceModes:
    """Modes of the covariance of a curve, on equally spaced nodes."""

    travel: tuple[float, float]  # m: first and last node
    scale: FloatArray  # shape (r,), m: size of one step of each mode
    steps: NDArray[np.int16]  # shape (g, r): modes in their steps

    @property
    def nodes(self) -> FloatArray:
        """Positions of the nodes, shape (g,), m."""
        return np.linspace(*self.travel, self.steps.shape[0])

    @property
    def values(self) -> FloatArray:
        """Modes at the nodes, shape (g, r), m."""
        return np.asarray(self.steps * self.scale)

    def __call__(self, x: ArrayLike) -> FloatArray:
        """Return the modes at positions in m, shape (n, r), with straight lines between nodes."""
        left, share = _between(np.atleast_1d(np.asarray(x, dtype=np.float64)), self.nodes)
        values = self.values
        return np.asarray(
            values[left] * (1.0 - share)[:, None] + values[left + 1] * share[:, None]
        )

    def covariance(self, x: FloatArray, u: FloatArray) -> FloatArray:
        """Return the covariance (n, n), m^2, at positions x with ``u**2`` as its diagonal.

        It is symmetric, positive semidefinite, and NaN in rows and columns where u is NaN.
        """
        modes = self(x)
        size = np.sqrt((modes**2).sum(axis=1))
        modes = modes * np.minimum(1.0, u / np.maximum(size, np.finfo(float).tiny))[:, None]
        rest = np.sqrt(np.maximum(u**2 - (modes**2).sum(axis=1), 0.0))
        step = (self.travel[1] - self.travel[0]) / (self.steps.shape[0] - 1)
        near = np.maximum(1.0 - np.abs(x[:, None] - x) / step, 0.0)
        out = modes @ modes.T + np.outer(rest, rest) * near
        np.fill_diagonal(out, u**2)
        return np.asarray(0.5 * (out + out.T))

    @classmethod
    def of(
        cls, x: FloatArray, functions: FloatArray, covariance: FloatArray | None = None
    ) -> CovarianceModes:
        """Return the greatest modes of ``functions @ coefficients``, until 1e-4 of the variance is left.

        x rises; functions are (n, m); coefficients are independent, of unit variance, unless their
        covariance (m, m) is given.
        """
        nodes = np.linspace(x[0], x[-1], min(x.size, _MAX_NODES))
        held = _to_nodes(x, functions, nodes)
        whole = held @ (held if covariance is None else held @ covariance).T
        power, vectors = np.linalg.eigh(0.5 * (whole + whole.T))
        power, vectors = np.maximum(power[::-1], 0.0), vectors[:, ::-1]
        missing = float(power.sum()) - np.cumsum(power)
        n = int(np.searchsorted(-missing, -_LEFT_OUT * float(power.sum()))) + 1
        n = min(n, _MAX_MODES, int((power > 0.0).sum()))
        modes = vectors[:, :n] * np.sqrt(power[:n])
        scale = np.abs(modes).max(axis=0, initial=0.0) / _STEPS
        steps = np.rint(modes / scale).astype(np.int16)
        return cls((float(x[0]), float(x[-1])), scale, steps)

    def to_dict(self) -> dict[str, Any]:
        """Return plain values for JSON; see `from_dict`."""
        return {
            "travel_m": list(self.travel),
            "scale_m": self.scale.tolist(),
            "steps": self.steps.tolist(),
        }

    @classmethod
    def from_dict(cls, data: Mapping[str, Any]) -> CovarianceModes:
        """Return the modes that `to_dict` wrote; refuse a part that is missing or damaged."""
        try:
            low, high = (float(v) for v in data["travel_m"])
            scale = np.array(data["scale_m"], dtype=np.float64)
            steps = np.array(data["steps"], dtype=np.int16)
        except (KeyError, TypeError, ValueError, OverflowError) as exc:
            raise DataError(_DAMAGED.format(repr(exc))) from exc
        if not (np.isfinite(scale).all() and np.isfinite([low, high]).all() and low < high):
            raise DataError(_DAMAGED.format("a number is not finite, or the travel has no length"))
        if steps.ndim != 2 or steps.shape[0] < 2 or scale.shape != steps.shape[1:]:
            raise DataError(_DAMAGED.format(f"{scale.size} scales, steps {steps.shape}"))
        return cls((low, high), scale, steps)


_DAMAGED = "the stored covariance is damaged or incomplete ({}); run the separation again"


def _between(x: FloatArray, nodes: FloatArray) -> tuple[NDArray[np.intp], FloatArray]:
    """Return the node left of each position and the share of the way to the next one."""
    left = np.clip(np.searchsorted(nodes, x, side="right") - 1, 0, nodes.size - 2)
    share = (x - nodes[left]) / (nodes[left + 1] - nodes[left])
    return left, np.clip(share, 0.0, 1.0)


def _to_nodes(x: FloatArray, functions: FloatArray, nodes: FloatArray) -> FloatArray:
    """Return the polygons over the nodes that are nearest to functions in least squares.

    Values at the nodes alone would turn waves that are shorter than two steps into long ones.
    """
    if nodes.size == x.size:
        return np.array([np.interp(nodes, x, f) for f in functions.T]).reshape(-1, nodes.size).T
    from scipy.linalg import solveh_banded
    from scipy.sparse import csr_array

    left, share = _between(x, nodes)
    rows = np.arange(x.size)
    hats = csr_array(
        (
            np.concatenate([1.0 - share, share]),
            (np.concatenate([rows, rows]), np.concatenate([left, left + 1])),
        ),
        shape=(x.size, nodes.size),
    )
    normal = (hats.T @ hats).toarray()
    band = np.vstack([np.append(0.0, np.diag(normal, 1)), np.diag(normal)])
    return np.asarray(solveh_banded(band, hats.T @ functions))
