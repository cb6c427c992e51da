"""Private to separation: the linear system of one data set, with its noise and its weights.

Dimensionless: heights over their RMS, positions over half the travel. Columns: offsets of the
runs, slope, extra terms, one derivative for each unknown that is not linear, cosines, sines.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from metrosep.core._arrays import FloatArray
from metrosep.core.errors import DegenerateFitError
from metrosep.separation._run_scales import (
    mad_about_medians,
    rms_about_line,
    time_step_groups,
)
from metrosep.separation._unknowns import Unknown
from metrosep.separation._whitening import whitened
from metrosep.separation.design import PreparedRun
from metrosep.separation.passes import shared_passes, sharing
from metrosep.separation.terms import Terms
from metrosep.separation.weights import RowWeights
from metrosep.spectral.autoregressive import AutoregressiveModel, fit_autoregressive
from metrosep.spectral.dft import fourier_basis

__all__ = ["System", "whitened"]


_MAX_MARKINGS = 5
"""Rounds of fitting and marking before the first noise model."""

_MAX_HELD = 12_000_000
"""Numbers of the Fourier basis that are kept between two solutions: 100 MB."""


class System:
    """The linear system of one data set; grows columns and loses short wavelengths."""

    def __init__(
        self,
        runs: Sequence[PreparedRun],
        *,
        origin: float,
        period: float,
        n_harmonics: int,
        terms: Terms,
        robust: bool = False,
    ) -> None:
        self.runs = runs
        self.origin, self.period, self.n_harmonics = origin, period, n_harmonics
        stacked = np.concatenate([r.z - np.nanmean(r.z) for r in runs])
        rms = float(np.sqrt(np.nanmean(stacked**2)))
        if rms == 0.0:
            raise DegenerateFitError(
                "the readings are constant in every run: there is no error and no noise to "
                "separate; check that the sensor moved with the axis"
            )
        self.centre = float(np.mean([r.x.mean() for r in runs]))
        self.half = max(float(np.ptp(r.x)) for r in runs) / 2.0
        # The prior is relative to this scale, so the alignment slope must not be in it.
        spread = mad_about_medians(runs) if robust else rms_about_line(runs)
        self.scale = max(spread, 1e-9 * rms)
        self.z = [r.z / self.scale for r in runs]
        self.groups = time_step_groups(runs)
        self.noise = [
            AutoregressiveModel(np.empty(0), 0.25, runs[g[0]].time_step) for g in self.groups
        ]
        self.lag = 0.0
        self.gain = np.ones(len(runs))  # of the Fourier basis in each run
        self.slope_gain = np.ones(len(runs))
        self.terms = terms
        self.unknowns: list[Unknown] = []
        self.n_marked_again = 0
        self._bases: dict[int, tuple[tuple[float, int], FloatArray]] = {}
        self.passes = shared_passes(runs)
        self.sharing = (1.0, 0.0)  # growth of the variance of a row; correlation of two probes
        self.weights = RowWeights.gross(self.z, [r.x for r in runs]) if robust else None
        self.solution = np.zeros(len(runs) + 1 + terms.size + 2 * n_harmonics)

    @property
    def n_fixed(self) -> int:
        """Columns before the Fourier basis."""
        return len(self.runs) + 1 + self.terms.size + len(self.unknowns)

    @property
    def extra(self) -> slice:
        """Where the extra terms are."""
        first = len(self.runs) + 1
        return slice(first, first + self.terms.size)

    def fixed_precision(self) -> FloatArray:
        """Return the prior precision of the columns before the basis."""
        out = np.zeros(self.n_fixed)
        out[self.extra] = self.terms.precision()
        out[self.extra.stop :] = 1.0
        return out

    def basis(self, index: int) -> FloatArray:
        """Return cosines and sines of one run, averaged as its samples are; no gain."""
        held = self._bases.get(index)
        if held is not None and held[0] == (self.lag, self.n_harmonics):
            return held[1]
        run = self.runs[index]
        x = run.x - run.velocity * self.lag
        k = np.arange(1, self.n_harmonics + 1)
        basis = fourier_basis(x, origin=self.origin, period=self.period, n_harmonics=k.size)
        if run.block_length:
            basis *= np.tile(np.sinc(k * run.block_length / self.period), 2)
        basis.setflags(write=False)
        if sum(r.x.size for r in self.runs) * basis.shape[1] <= _MAX_HELD:
            self._bases[index] = ((self.lag, self.n_harmonics), basis)
        return basis

    def design(self, index: int) -> FloatArray:
        """Return the columns of one run."""
        run = self.runs[index]
        basis = self.basis(index)
        fixed = np.zeros((run.x.size, self.n_fixed))
        fixed[:, index] = 1.0
        x = run.x - run.velocity * self.lag
        fixed[:, len(self.runs)] = self.slope_gain[index] * (x - self.centre) / self.half
        if self.terms.size:
            fixed[:, self.extra] = self.terms.columns(index)
        for j, unknown in enumerate(self.unknowns):
            fixed[:, self.extra.stop + j] = unknown.column(self, index, basis) * unknown.prior_sd
        if self.gain[index] != 1.0:
            basis = basis * self.gain[index]
        return np.hstack([fixed, basis])

    def rows(self, index: int, model: AutoregressiveModel) -> tuple[FloatArray, FloatArray, float]:
        """Return the whitened rows of one run and the variance of one."""
        design, z = self.design(index), self.z[index]
        if self.weights is None:
            rows, values = whitened(design, z, model.coefficients)
            return rows, values, model.variance
        marks = self.weights.marks(index)
        rows, values = whitened(np.hstack([design, marks]), z, model.coefficients)
        rows, values = self.weights.apply(index, rows, values, design.shape[1])
        return rows, values, model.variance / self.weights.information(index)

    def normal_equations(self) -> tuple[FloatArray, FloatArray]:
        """Return the whitened system in units of the noise."""
        size = self.n_fixed + 2 * self.n_harmonics
        gram, right = np.zeros((size, size)), np.zeros(size)
        for group, model in zip(self.groups, self.noise, strict=True):
            for i in group:
                rows, values, variance = self.rows(i, model)
                variance *= self.sharing[0]
                gram += rows.T @ rows / variance
                right += values @ rows / variance
        return gram, right

    def residuals(self) -> list[FloatArray]:
        """Return readings minus model."""
        return [z - self.design(i) @ self.solution for i, z in enumerate(self.z)]

    def update_noise(self, freedom: float, orders: Sequence[int]) -> None:
        """Fit the noise model of every group anew; its variance pays for the parameters."""
        residuals = self.residuals()
        if self.weights is None:
            self.noise = self._fitted_noise(residuals, freedom, orders)
        else:
            cleaned = residuals
            for _ in range(2):  # what is a spike depends on the noise model, and it on the spikes
                cleaned = self.weights.clean(residuals, self.groups, self.noise)
                self.noise = self._fitted_noise(cleaned, freedom, orders)
            self.weights.weigh(cleaned, self.groups, self.noise)
            residuals = cleaned
        n_probes = len({r.probe for r in self.runs})
        self.sharing = sharing(self.passes, residuals, self.groups, self.noise, n_probes)

    def mark_again(self) -> bool:
        """Mark wrong samples with the noise model at hand."""
        if self.weights is None or self.n_marked_again >= _MAX_MARKINGS:
            return False
        self.n_marked_again += 1
        before = [m.copy() for m in self.weights.marked]
        self.weights.clean(self.residuals(), self.groups, self.noise)
        return any((a != b).any() for a, b in zip(before, self.weights.marked, strict=True))

    def _fitted_noise(
        self, residuals: Sequence[FloatArray], freedom: float, orders: Sequence[int]
    ) -> list[AutoregressiveModel]:
        total = sum(int((~np.isnan(r)).sum()) for r in residuals)
        models = []
        for group, old in zip(self.groups, self.noise, strict=True):
            own = [residuals[i] for i in group]
            shortest = min(r.size for r in own)
            allowed = [p for p in orders if p <= max(1, shortest // 8)]
            model, n_rows, _ = fit_autoregressive(
                own, orders=allowed or [1], time_step=old.time_step
            )
            share = freedom * n_rows / total
            if self.weights is not None:
                share += self.weights.n_marked(group)
            factor = n_rows / max(n_rows - share - model.order, 1.0)
            models.append(
                AutoregressiveModel(model.coefficients, model.variance * factor, model.time_step)
            )
        return models

    def truncate(self, n_harmonics: int) -> None:
        """Drop the harmonics beyond `n_harmonics`."""
        fixed = self.solution[: self.n_fixed]
        cosine, sine = np.split(self.solution[self.n_fixed :], 2)
        self.solution = np.concatenate([fixed, cosine[:n_harmonics], sine[:n_harmonics]])
        self.n_harmonics = n_harmonics

    def set_terms(self, *, frequencies: Sequence[float], wavenumbers: FloatArray) -> None:
        """Change the lines and waves; their coefficients start at zero."""
        kept = self.terms.n_drift
        before, drift = self.solution[: self.extra.start], self.solution[self.extra][:kept]
        after = self.solution[self.extra.stop :]
        self.terms.frequencies = list(frequencies)
        self.terms.wavenumbers = wavenumbers
        fresh = np.zeros(self.terms.size - kept)
        self.solution = np.concatenate([before, drift, fresh, after])

    def add_unknowns(self, unknowns: Sequence[Unknown]) -> None:
        """Give the next solution the derivatives of unknowns that are not linear."""
        self.solution = np.insert(self.solution, [self.n_fixed] * len(unknowns), 0.0)
        self.unknowns += unknowns
