"""Private to separation: the extra terms of a joint fit as curves over position and as a report."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

import numpy as np

from metrosep.core._arrays import FloatArray
from metrosep.core.errors import UnitError
from metrosep.core.runset import RunSet
from metrosep.separation._unknowns import Gain
from metrosep.separation.curves import LINE_POINTS, FeedTerm, SampledCurve
from metrosep.separation.design import PreparedRun
from metrosep.separation.feed_report import report_following, report_probes
from metrosep.separation.options import JointOptions
from metrosep.separation.solver import Solution
from metrosep.separation.term_report import Report, report_drift, report_lines, report_robust
from metrosep.spectral.dft import fourier_basis

__all__ = ["check_lines", "feed_curves", "report_terms"]


_POINTS_PER_WAVE = 32
"""Of the sampled curve of the feed-dependent part: straight lines between them miss 0.5 %."""


def check_lines(options: JointOptions, prepared: Sequence[PreparedRun]) -> None:
    """Refuse lines that these runs cannot hold."""
    if isinstance(options.lines, str):
        return
    low = 1.5 / min(float(np.ptp(r.t)) for r in prepared)
    high = 0.5 / max(r.time_step for r in prepared)
    for frequency in options.lines:
        if not low <= frequency <= high:
            raise UnitError(
                f"a line of {frequency:.6g} Hz cannot be fitted to these runs: they hold "
                f"{low:.3g} ... {high:.4g} Hz (1.5 periods in the shortest run, half the sampling "
                "rate after averaging); is it in Hz?"
            )


def report_terms(
    solution: Solution, prepared: Sequence[PreparedRun], runs: RunSet, options: JointOptions
) -> tuple[dict[str, Any], list[str]]:
    """Return what the extra terms came out as, and the sentences about it."""
    terms: dict[str, Any] = {}
    sentences: list[str] = []
    several = len({r.probe for r in prepared}) > 1
    reports: dict[str, tuple[bool, Callable[[], Report]]] = {
        "drift": (options.drift > 0, lambda: report_drift(solution, prepared)),
        "lines": (options.lines != (), lambda: report_lines(solution, prepared, runs)),
        "robust": (options.robust, lambda: report_robust(solution, prepared)),
        "following": (
            options.following != "off",
            lambda: report_following(
                solution, prepared, kind=options.following, n_feeds=len(runs.feeds)
            ),
        ),
        "probes": (several, lambda: report_probes(solution, prepared)),
    }
    for name, (wanted, report) in reports.items():
        if wanted:
            terms[name], told = report()
            sentences += told
    return terms, sentences


def feed_curves(
    solution: Solution,
    options: JointOptions,
    evaluation: tuple[float, float],
    travel: tuple[float, float],
) -> FeedTerm | None:
    """Return how the curve changes with the feedrate, line removed."""
    if options.following not in ("scale", "waves"):
        return None
    k, reference = solution.n_harmonics, solution.terms.reference
    highest = max(k / solution.period, float(solution.terms.wavenumbers.max(initial=0.0)))
    n_grid = int(np.clip((travel[1] - travel[0]) * highest * _POINTS_PER_WAVE, 200, 8000)) + 1
    grid = np.linspace(travel[0], travel[1], n_grid)
    inner = np.linspace(evaluation[0], evaluation[1], LINE_POINTS)
    mid, half = float(np.mean(evaluation)), (evaluation[1] - evaluation[0]) / 2.0
    line = np.column_stack([np.ones(inner.size), (inner - mid) / half])
    grid_line = np.column_stack([np.ones(n_grid), (grid - mid) / half])

    def projected(columns: FloatArray, at_inner: FloatArray) -> FloatArray:
        to_line = np.linalg.lstsq(line, at_inner, rcond=None)[0]
        return np.asarray(columns - grid_line @ to_line)

    error = projected(_error_columns(solution, grid), _error_columns(solution, inner))
    change = projected(
        _change_columns(solution, options, grid), _change_columns(solution, options, inner)
    )
    change = change / reference
    covariance = solution.joint_covariance
    if options.following == "waves":
        coefficients = np.zeros(covariance.shape[0])
        first = solution.coefficients.size
        coefficients[first : first + solution.extra.size] = solution.extra
        value = change @ coefficients
    else:
        value = _gain(solution).value * (error[:, 1 : 1 + 2 * k] @ solution.coefficients[1:])
        value = value / reference
    return FeedTerm(
        reference,
        SampledCurve(grid, value),
        SampledCurve(grid, np.einsum("ij,jk,ik->i", error, covariance, change)),
        SampledCurve(grid, np.maximum(np.einsum("ij,jk,ik->i", change, covariance, change), 0.0)),
    )


def _gain(solution: Solution) -> Gain:
    return next(u for u in solution.unknowns if isinstance(u, Gain) and u.name == "following")


def _error_columns(solution: Solution, x: FloatArray) -> FloatArray:
    """Return the derivative of the curve at the reference feed with all that is in the covariance."""
    out = np.zeros((x.size, solution.joint_covariance.shape[0]))
    k = solution.n_harmonics
    out[:, 0] = x - solution.centre
    out[:, 1 : 1 + 2 * k] = fourier_basis(
        x, origin=solution.origin, period=solution.period, n_harmonics=k
    )
    return out


def _change_columns(solution: Solution, options: JointOptions, x: FloatArray) -> FloatArray:
    """Return the derivative of the change for a relative speed of 1."""
    out = np.zeros((x.size, solution.joint_covariance.shape[0]))
    first, n_extra = solution.coefficients.size, solution.extra.size
    if options.following == "waves":
        n = solution.terms.wavenumbers.size
        phase = 2.0 * np.pi * np.outer(x - solution.origin, solution.terms.wavenumbers)
        stop = first + n_extra
        out[:, stop - 2 * n : stop] = np.hstack([np.cos(phase), np.sin(phase)])
        return out
    gain = _gain(solution)
    k = solution.n_harmonics
    basis = fourier_basis(x, origin=solution.origin, period=solution.period, n_harmonics=k)
    out[:, 1 : 1 + 2 * k] = gain.value * basis
    place = first + n_extra + next(i for i, u in enumerate(solution.unknowns) if u is gain)
    out[:, place] = basis @ solution.coefficients[1:]
    return out
