"""Private to separation: each run, and the runs of each feedrate, predicted from the others.

The geometry without a run predicts it; what its readings say beside the prediction is a gain, a
shift in position, or a misfit. Equation numbers: separation-2.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from metrosep.core._arrays import FloatArray
from metrosep.separation.runs.geometry import filtered
from metrosep.separation.runs.posterior import Model

__all__ = ["RunScore", "feed_scores", "run_scores"]

_FAR = 3e-3
"""m; shifts are looked for so far on each side."""

_EDGE = 1e-9
"""Directions of the prediction's variance below this share of the largest are not tested."""


@dataclass(frozen=True, slots=True)
class RunScore:
    """What some runs are beside what the others predict of them (eq. 15)."""

    runs: tuple[int, ...]
    chi2: float  # per degree of freedom
    gain: float  # 1: as predicted; below 0: the opposite sign
    u_gain: float
    shift: float  # m: the readings show the error of the place x - shift
    u_shift: float


def run_scores(model: Model) -> list[RunScore]:
    """Return the score of each run against all others; none for fewer than 3 runs."""
    if len(model.seen) < 3:
        return []
    return [_score(model, (i,)) for i in range(len(model.seen))]


def feed_scores(model: Model) -> list[RunScore]:
    """Return the score of the runs of each feedrate; none for fewer than 3 feedrates."""
    feeds = sorted({r.feed for r in model.seen})
    if len(feeds) < 3:
        return []
    return [
        _score(model, tuple(i for i, r in enumerate(model.seen) if r.feed == feed))
        for feed in feeds
    ]


def _score(model: Model, chosen: Sequence[int]) -> RunScore:
    gram: FloatArray = sum(model.seen[i].gram for i in chosen)  # type: ignore[assignment]
    right: FloatArray = sum(model.seen[i].right for i in chosen)  # type: ignore[assignment]
    rest = model.solution(model.total[0] - gram, model.total[1] - right)
    curve = rest.theta.copy()
    curve[0] = 0.0  # the line is alignment: neither gain nor shift show in it
    curve[1 + 2 * model.extension.n :] = 0.0
    side = right - gram @ rest.theta
    root = rest.columns @ rest.root

    def step(along: FloatArray) -> tuple[float, float]:
        seen = gram @ along
        own = max(float(along @ seen), 1e-300)
        variance = own + float(np.sum((root.T @ seen) ** 2))
        return float(along @ side) / own, math.sqrt(variance) / own

    gain, u_gain = step(curve)
    shift = _shift(model, gram, right, curve, rest.theta)
    w = model.extension.wavenumbers
    _, u_shift = step(_waves_only(filtered(curve, -1j * w * np.exp(-1j * w * shift)), w.size))
    return RunScore(
        tuple(chosen), _misfit(rest.columns, gram, side, root), 1.0 + gain, u_gain, shift, u_shift
    )


def _misfit(columns: FloatArray, gram: FloatArray, side: FloatArray, root: FloatArray) -> float:
    """Return chi-square per degree of freedom on the columns in use (eq. 15)."""
    across = columns.T @ gram
    half = across @ root
    variance = across @ columns + half @ half.T
    values, vectors = np.linalg.eigh(0.5 * (variance + variance.T))
    seen = values > _EDGE * values[-1]
    along = vectors[:, seen].T @ (columns.T @ side)
    return float(np.mean(along**2 / values[seen]))


def _shift(
    model: Model, gram: FloatArray, right: FloatArray, curve: FloatArray, theta: FloatArray
) -> float:
    """Return the shift of greatest likelihood: the best of a scan, then Gauss-Newton."""
    w, n = model.extension.wavenumbers, model.extension.n
    right = right - gram @ (theta - curve)
    pitch = model.extension.period / max(model.kept, 8) / 8.0
    far = min(_FAR, 0.25 * model.extension.travel)
    shifts = np.arange(-far, far + pitch, pitch)
    wave = (curve[1 : n + 1] - 1j * curve[n + 1 : 2 * n + 1])[:, None]
    wave = wave * np.exp(-1j * np.outer(w, shifts))
    moved = np.zeros((curve.size, shifts.size))
    moved[1 : n + 1], moved[n + 1 : 2 * n + 1] = wave.real, -wave.imag
    misfit = np.einsum("ij,ij->j", moved, gram @ moved) - 2.0 * right @ moved
    shift = float(shifts[np.argmin(misfit)])
    for _ in range(4):
        at = filtered(curve, np.exp(-1j * w * shift))
        along = _waves_only(filtered(at, -1j * w), n)
        own = max(float(along @ gram @ along), 1e-300)
        shift += float(np.clip(along @ (right - gram @ at) / own, -pitch, pitch))
    return shift


def _waves_only(theta: FloatArray, n: int) -> FloatArray:
    theta[0] = 0.0
    theta[2 * n + 1 :] = 0.0
    return theta
