"""Private to separation: the linear system of one data set, with its noise and its weights.

Dimensionless: heights over their RMS, positions over half the travel. Columns: offsets of the
runs, slope, extra terms, one derivative for each unknown that is not linear, cosines, sines.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from metrosep.core._arrays import FloatArray
from metrosep.core.errors import DegenerateFitError
from metrosep.separation.runs._unknowns import Unknown
from metrosep.separation.runs.design import PreparedRun
from metrosep.separation.runs.lines import Terms
from metrosep.separation.runs.weights import MAD, RowWeights
from metrosep.spectral.autoregressive import AutoregressiveModel, fit_autoregressive, whiten
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


# ---- private to separation: the height scale of a set of runs, and which runs share a noise model ----


def rms_about_line(runs: Sequence[PreparedRun]) -> float:
    """Return the RMS of the readings about one slope and an offset for each run."""
    pairs = [
        (r.x[v] - r.x[v].mean(), r.z[v] - r.z[v].mean()) for r in runs for v in [~np.isnan(r.z)]
    ]
    x, z = (np.concatenate(part) for part in zip(*pairs, strict=True))
    return float(np.sqrt(np.mean((z - (x @ z) / (x @ x) * x) ** 2)))


def mad_about_medians(runs: Sequence[PreparedRun]) -> float:
    """Return a robust spread of the readings about the median slope and an offset for each run."""
    steps = [np.nanmedian(np.diff(r.z[:: max(1, r.x.size // 20)])) for r in runs]
    pitches = [float(np.median(np.diff(r.x[:: max(1, r.x.size // 20)]))) for r in runs]
    slope = float(np.median(np.array(steps) / np.array(pitches)))
    flat = [r.z - slope * r.x for r in runs]
    pooled = np.abs(np.concatenate([f - np.nanmedian(f) for f in flat]))
    return MAD * float(np.nanmedian(pooled))


def time_step_groups(runs: Sequence[PreparedRun]) -> list[list[int]]:
    """Group the runs that share a noise model: sampling interval and probe."""
    groups: list[list[int]] = []
    for i in sorted(range(len(runs)), key=lambda j: -runs[j].time_step):
        for group in reversed(groups):
            first = runs[group[0]]
            if runs[i].time_step > 0.99 * first.time_step and runs[i].probe == first.probe:
                group.append(i)
                break
        else:
            groups.append([i])
    return groups


# ---- private to separation: rows of a design filtered by an autoregressive model ---------------

_BLOCK = 128


def whitened(
    design: FloatArray, values: FloatArray, coefficients: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Filter rows by blocks of a banded Toeplitz matrix; rows that touch a NaN are dropped."""
    p = coefficients.size
    invalid = np.isnan(values)
    table = np.hstack([design, np.where(invalid, 0.0, values)[:, None]])
    n_out = values.size - p
    if p:
        taps = np.concatenate([-coefficients[::-1], [1.0]])
        band = np.zeros((_BLOCK, _BLOCK + p))
        for row in range(_BLOCK):
            band[row, row : row + p + 1] = taps
        out = np.empty((n_out, table.shape[1]))
        for first in range(0, n_out, _BLOCK):
            size = min(_BLOCK, n_out - first)
            np.matmul(
                band[:size, : size + p],
                table[first : first + size + p],
                out=out[first : first + size],
            )
    else:
        out = table
    if invalid.any():
        touched = np.convolve(invalid.astype(np.float64), np.ones(p + 1))[p : p + n_out] > 0.5
        out = out[~touched]
    return out[:, :-1], out[:, -1]


# ---- private to separation: probes that read the same pass share the vibration of the machine ----
# Their readings are then not independent: n probes with correlation rho of the innovations hold the
# information of n / (1 + rho (n - 1)) probes. Taken as independent, chance would pass as evidence.


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
