"""Private to separation: the readings of one data set, their noise and weights, one pass at a time.

Heights are over their RMS about one line, positions in m. A pass whitens every run and makes its
`RunEquations`; what is learnt between two passes needs the readings no more. Columns: line, K
cosines, K sines, extra terms, one derivative for each unknown that is not linear.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from metrosep.core._arrays import BoolArray, FloatArray
from metrosep.core.errors import DegenerateFitError
from metrosep.core.runset import SAME_FEED
from metrosep.separation.runs.design import SAME_INTERVAL, PreparedRun
from metrosep.separation.runs.geometry import LINE_SD, Extension, Sensor, filtered
from metrosep.separation.runs.lines import Terms, Unknown
from metrosep.separation.runs.noise import (
    MAD,
    MissingSamples,
    NoiseModel,
    exact_rows,
    fit_noise,
    stretches,
    white,
)
from metrosep.separation.runs.posterior import Model, Posterior, RunEquations
from metrosep.separation.runs.weights import RowWeights
from metrosep.spectral.autoregressive import whiten

_MAX_HELD = 12_000_000
"""Numbers of the basis that are kept between two passes: 100 MB."""

_DRAWS = 6
"""Draws of the residual from which the noise is learnt (eq. 11)."""

_MAX_MARKINGS = 5
"""Rounds of fitting and marking before the first noise model."""

_SHORT_GAP = 8
"""Samples: a shorter gap is bridged by as many unknowns, at a longer one the filter starts anew."""


class System:
    """The readings of one data set with what they are read through; makes equations for a model."""

    def __init__(
        self,
        runs: Sequence[PreparedRun],
        *,
        extension: Extension,
        terms: Terms,
        robust: bool = False,
    ) -> None:
        self.runs, self.extension, self.terms = runs, extension, terms
        stacked = np.concatenate([r.z - np.nanmean(r.z) for r in runs])
        rms = float(np.sqrt(np.nanmean(stacked**2)))
        largest = max(float(np.nanmax(np.abs(r.z))) for r in runs)
        if rms <= 1e-14 * largest:  # the mean of equal numbers is theirs but for rounding
            raise DegenerateFitError(
                "the readings are constant in every run: there is no error and no noise to "
                "separate; check that the sensor moved with the axis"
            )
        # The prior is relative to this scale, so the alignment slope must not be in it.
        spread = mad_about_medians(runs) if robust else rms_about_line(runs)
        self.scale = max(spread, 1e-9 * rms)
        # m/m, taken out of the readings and added to the solution; probes of another sensitivity
        # see another slope, so with them it stays in
        self.slope = 0.0 if len({r.probe for r in runs}) > 1 else common_slope(runs)
        centre = extension.start + 0.5 * extension.travel
        self.z = [(r.z - self.slope * (r.x - centre)) / self.scale for r in runs]
        spread = float(np.sqrt(np.mean([np.nanmean((z - np.nanmean(z)) ** 2) for z in self.z])))
        self.line_sd = LINE_SD * max(spread, 1.0)
        self.groups = time_step_groups(runs)
        self.start_noise()
        self.gain = np.ones(len(runs))  # of the Fourier basis in each run
        self.slope_gain = np.ones(len(runs))
        self.unknowns: list[Unknown] = []
        self.n_marked_again = 0
        self._bases: dict[tuple[bytes, float], FloatArray] = {}
        self.passes = shared_passes(runs)
        self.sharing = (1.0, 0.0)  # growth of the variance of a row; correlation of two probes
        self.weights = RowWeights.gross(self.z, [r.x for r in runs]) if robust else None
        self.gaps = [_short_gaps(z) for z in self.z]
        speeds = sorted({abs(r.velocity) for r in runs})
        self.feeds = [feed_number(abs(r.velocity), speeds) for r in runs]
        # Of the readings themselves, so that the draws do not depend on the order of the runs.
        order = sorted(range(len(runs)), key=lambda i: (runs[i].velocity, runs[i].z.tobytes()))
        self.ranks = [order.index(i) for i in range(len(runs))]

    @property
    def n_basis(self) -> int:
        """Columns of line and waves."""
        return 1 + 2 * self.extension.n

    @property
    def size(self) -> int:
        """Columns in all."""
        return self.n_basis + self.terms.size + len(self.unknowns)

    @property
    def extra(self) -> slice:
        """Where the extra terms are."""
        return slice(self.n_basis, self.n_basis + self.terms.size)

    def extra_precision(self) -> FloatArray:
        """Return the prior precision of terms and unknowns."""
        return np.concatenate([self.terms.precision(), np.ones(len(self.unknowns))])

    def basis(self, index: int) -> FloatArray:
        """Return line, cosines and sines of one run, averaged as its samples are; no gain."""
        run = self.runs[index]
        place = run.x.tobytes(), run.block_length
        held = self._bases.get(place)
        if held is not None:
            return held
        basis = self.extension.basis(run.x, block_length=run.block_length)
        basis.setflags(write=False)
        if sum(r.x.size for r in self.runs) * basis.shape[1] <= _MAX_HELD:
            self._bases[place] = basis
        return basis

    def columns(self, index: int, model: Model) -> list[FloatArray]:
        """Return the columns of one run side by side; the sensor is applied to the equations, not here."""
        basis, line, gain = self.basis(index), self.slope_gain[index], self.gain[index]
        if line != 1.0 or gain != 1.0:
            basis = basis * np.append(line, np.full(basis.shape[1] - 1, gain))
        own = [(u.column(self, index, model) * u.prior_sd)[:, None] for u in self.unknowns]
        return [part for part in (basis, self.terms.columns(index), *own) if part.shape[1]]

    def curve(self, index: int, theta: FloatArray, sensor: Sensor) -> FloatArray:
        """Return the model of one run without its offset; theta of shape (N,) or (N, draws)."""
        run = self.runs[index]
        h = sensor.response(self.extension.wavenumbers, run.velocity)
        seen = filtered(theta[: self.n_basis], h)
        basis = self.basis(index)
        out = np.multiply.outer(basis[:, 0] * self.slope_gain[index], seen[0])
        out = out + self.gain[index] * (basis[:, 1:] @ seen[1:])
        if self.terms.size:
            out = out + self.terms.columns(index) @ theta[self.extra]
        return np.asarray(out)

    def shape(self, index: int, model: Model, *, with_slope: bool) -> FloatArray:
        """Return the error in one run, with or without its line, which a gain multiplies."""
        assert model.post is not None  # noqa: S101  (after a solution)
        theta = np.zeros(self.size)
        theta[: self.n_basis] = model.post.theta[: self.n_basis]
        if not with_slope:
            theta[0] = 0.0
        return self.curve(index, theta, model.sensor)

    # ---- one pass --------------------------------------------------------------------------

    def equations(self, model: Model) -> list[RunEquations]:
        """Return the equations of every run (eqs. 4, 5): one pass over the samples."""
        out: list[RunEquations | None] = [None] * len(self.runs)
        for number, (group, noise) in enumerate(zip(self.groups, self.noise, strict=True)):
            for same in self._at_one_place(group):
                i, k = same[0], len(same)
                rows = self.rows(same, noise, self.columns(i, model))
                products = rows.T @ rows  # of the columns, then the readings, then the offset
                n, oo = rows.shape[1] - k - 1, max(float(products[-1, -1]), 1e-300)
                own, ao = products[:n, :n], products[-1, :n]
                gram, level = own - np.outer(ao / oo, ao), ao / oo
                for j, y in zip(same, products[n:-1], strict=True):
                    oy = float(y[-1])
                    out[j] = RunEquations(
                        gram=gram,
                        right=y[:n] - ao * (oy / oo),
                        level=level,
                        level_right=oy / oo,
                        level_information=oo,
                        velocity=self.runs[j].velocity,
                        feed=self.feeds[j],
                        length=float(np.ptp(self.runs[j].x))
                        * float(np.mean(~np.isnan(self.z[j]))),
                        group=number,
                    )
        return [run for run in out if run is not None]

    def _at_one_place(self, group: Sequence[int]) -> list[list[int]]:
        """Return the runs of a group, together those that have all columns and rows in common."""
        if self.terms.size or self.unknowns or self.weights is not None:
            return [[i] for i in group]
        found: dict[tuple[Any, ...], list[int]] = {}
        for i in group:
            run, gains = self.runs[i], (self.gain[i], self.slope_gain[i])
            places = (run.x.tobytes(), np.isnan(self.z[i]).tobytes(), run.block_length)
            found.setdefault((*places, *gains), []).append(i)
        return list(found.values())

    def rescaled(
        self, runs: Sequence[RunEquations], before: Sequence[float]
    ) -> list[RunEquations]:
        """Return equations for white noise of another size: no pass over the samples."""
        out = list(runs)
        for group, noise, old in zip(self.groups, self.noise, before, strict=True):
            for i in group:
                c = old / noise.variance
                out[i] = replace(
                    out[i],
                    gram=c * out[i].gram,
                    right=c * out[i].right,
                    level_information=c * out[i].level_information,
                )
        return out

    def score(
        self, model: Model, columns_of: Callable[[int], FloatArray]
    ) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Return score, own information and cross information of extra columns at the solution."""
        assert model.post is not None  # noqa: S101  (after a solution)
        theta, q = model.post.theta, columns_of(0).shape[1]
        score, own, cross = np.zeros(q), np.zeros((q, q)), np.zeros((theta.size, q))
        for group, noise in zip(self.groups, self.noise, strict=True):
            for i in group:
                rows = self.rows([i], noise, [*self.columns(i, model), columns_of(i)])
                o = rows[:, -1]
                rows = rows[:, :-1] - np.outer(o, o @ rows[:, :-1]) / max(float(o @ o), 1e-300)
                h = model.sensor.response(self.extension.wavenumbers, self.runs[i].velocity)
                base, extra, y = rows[:, : theta.size], rows[:, theta.size : -1], rows[:, -1]
                rest = y - base @ filtered(theta, h)
                score += extra.T @ rest
                own += extra.T @ extra
                cross += filtered(base.T @ extra, np.conj(h))
        return score, own, cross

    def rows(
        self, same: Sequence[int], noise: NoiseModel, columns: Sequence[FloatArray]
    ) -> FloatArray:
        """Return whitened columns, readings and offset of runs at one place; unknown samples projected out."""
        index = same[0]
        parts = self._parts(index)
        readings = [np.nan_to_num(self.z[i]) for i in same]
        tables = [*columns, np.column_stack([*readings, np.ones(readings[0].size)])]
        rows = exact_rows(tables, noise, parts)
        root = None
        if self.weights is not None and self.weights.weight:
            w = np.concatenate([self.weights.weight[index][part] for part in parts])
            root = np.sqrt(w * self.weights.information(index))
            rows *= root[:, None]
        missing = self._missing(index)
        if missing.any():
            MissingSamples(missing, noise, parts, weight=root).take_out(rows)
        if self.sharing[0] != 1.0:
            rows /= math.sqrt(self.sharing[0])
        return rows

    def _missing(self, index: int) -> BoolArray:
        gaps = self.gaps[index]
        return gaps if self.weights is None else gaps | self.weights.marked[index]

    def _parts(self, index: int) -> list[slice]:
        return stretches(np.where(self.gaps[index], 0.0, self.z[index]))

    # ---- noise -----------------------------------------------------------------------------

    def draws(self, model: Model, *, seed: int = 1) -> list[FloatArray]:
        """Return draws of the noise of every run, shape (n, draws), NaN where not measured (11)."""
        assert model.post is not None  # noqa: S101  (after a solution)
        thetas = model.post.draws(_DRAWS, seed)
        out = []
        for i, run in enumerate(model.runs):
            rng = np.random.default_rng([seed, 1 + self.ranks[i]])
            h = model.sensor.response(self.extension.wavenumbers, run.velocity)
            seen = filtered(thetas, h)
            rest = self.z[i][:, None] - self.curve(i, thetas, model.sensor)
            level = run.level_right - run.level @ seen
            if model.slip:
                columns, own = model.slipping()
                inverse = np.linalg.inv(columns.T @ run.gram @ columns + own)
                side = columns.T @ (run.right[:, None] - run.gram @ seen)
                free = rng.standard_normal((len(own), _DRAWS))
                free -= free.mean(axis=1, keepdims=True)
                free *= math.sqrt(_DRAWS / (_DRAWS - 1.0))
                slip = columns @ (inverse @ side + np.linalg.cholesky(inverse) @ free)
                rest = rest - self.basis(i) @ slip[: self.n_basis]
                level = level - run.level @ slip
            free = rng.standard_normal(_DRAWS)
            free = (free - free.mean()) * math.sqrt(_DRAWS / (_DRAWS - 1.0))
            rest = rest - level - free / math.sqrt(run.level_information)
            out.append(self._filled(i, rest, self.noise[run.group], rng))
        return out

    def _filled(
        self, index: int, draws: FloatArray, noise: NoiseModel, rng: np.random.Generator
    ) -> FloatArray:
        """Return the draws with short gaps drawn as the noise at hand has them between their neighbours.

        A straight line would be smoother than the noise, and the density learnt of it too low.
        """
        gaps = self.gaps[index]
        if not gaps.any():
            return draws
        parts = self._parts(index)
        missing = MissingSamples(gaps, noise, parts)
        out = np.where(gaps[:, None], 0.0, draws)
        rows = exact_rows([out], noise, parts)
        out[missing.at] = missing.expected(rows) + missing.drawn(rng, draws.shape[1])
        return out

    def residuals(self, model: Model, post: Posterior | None = None) -> list[FloatArray]:
        """Return readings minus model, offset and slip removed; NaN where not measured."""
        post = post or model.post
        assert post is not None  # noqa: S101  (after a solution)
        return [
            self.z[i] - self.curve(i, post.theta, model.sensor) - level - slip
            for i, (level, slip) in enumerate(self.levels(model, post))
        ]

    def rest(self, index: int, model: Model, theta: FloatArray) -> FloatArray:
        """Return the readings of one run minus a geometry, offset removed."""
        run = model.runs[index]
        h = model.sensor.response(self.extension.wavenumbers, run.velocity)
        level = run.level_right - float(run.level @ filtered(theta, h))
        return self.z[index] - self.curve(index, theta, model.sensor) - level

    def levels(self, model: Model, post: Posterior) -> list[tuple[float, FloatArray]]:
        """Return offset and slipping part of every run."""
        out = []
        for i, run in enumerate(model.runs):
            h = model.sensor.response(self.extension.wavenumbers, run.velocity)
            seen = filtered(post.theta, h)
            level = run.level_right - float(run.level @ seen)
            slip = np.zeros(self.runs[i].x.size)
            if model.slip:
                columns, own = model.slipping()
                side = columns.T @ (run.right - run.gram @ seen)
                part = columns @ np.linalg.solve(columns.T @ run.gram @ columns + own, side)
                slip = self.basis(i) @ part[: self.n_basis]
                level -= float(run.level @ part)
            out.append((level, slip))
        return out

    def start_noise(self) -> None:
        """Take the noise for white, of half the RMS of the readings."""
        self.noise = [white(0.25, self.runs[g[0]].time_step) for g in self.groups]
        self._learnt_of: Sequence[FloatArray] = ()

    def update_noise(self, model: Model, *, most: int | None = None) -> None:
        """Fit the noise model of every group anew, to draws of the residual."""
        draws = self.draws(model)
        if self.weights is not None:
            residuals = [d.mean(axis=1) for d in draws]
            cleaned = residuals
            for _ in range(2):  # what is a spike depends on the noise model, and it on the spikes
                cleaned = self.weights.clean(residuals, self.groups, self.noise)
                own = [
                    d + (c - r)[:, None] for d, c, r in zip(draws, cleaned, residuals, strict=True)
                ]
                self._fit(own, most)
            self.weights.weigh(cleaned, self.groups, self.noise)
            draws = [
                d + (c - r)[:, None] for d, c, r in zip(draws, cleaned, residuals, strict=True)
            ]
        else:
            self._fit(draws, most)
        n_probes = len({r.probe for r in self.runs})
        means = [d.mean(axis=1) for d in draws]
        self.sharing = sharing(self.passes, means, self.groups, self.noise, n_probes)

    def mark_again(self, model: Model) -> bool:
        """Mark wrong samples with the noise model at hand; tell whether any changed."""
        if self.weights is None or self.n_marked_again >= _MAX_MARKINGS:
            return False
        self.n_marked_again += 1
        before = [m.copy() for m in self.weights.marked]
        self.weights.clean(self.residuals(model), self.groups, self.noise)
        return any((a != b).any() for a, b in zip(before, self.weights.marked, strict=True))

    def noise_and_of_others(self) -> list[tuple[NoiseModel, NoiseModel]]:
        """Return the noise of each run, and as the runs of other feedrates show it, if there are any."""
        out = [(self.noise[0], self.noise[0])] * len(self.runs)
        for group, noise in zip(self.groups, self.noise, strict=True):
            for feed in {self.feeds[i] for i in group}:
                others = [self._learnt_of[i] for i in group if self.feeds[i] != feed]
                model = fit_noise(others, time_step=noise.time_step) if others else noise
                for i in group:
                    out[i] = (noise, model) if self.feeds[i] == feed else out[i]
        return out

    def _fit(self, draws: Sequence[FloatArray], most: int | None) -> None:
        self._learnt_of = draws
        self.noise = [
            fit_noise(
                [draws[i] for i in group],
                time_step=old.time_step,
                **({} if most is None else {"most": most}),
            )
            for group, old in zip(self.groups, self.noise, strict=True)
        ]

    def set_terms(self, *, frequencies: Sequence[float], wavenumbers: FloatArray) -> None:
        """Change the lines and waves of the terms."""
        self.terms.frequencies = list(frequencies)
        self.terms.wavenumbers = wavenumbers


def _short_gaps(z: FloatArray) -> BoolArray:
    """Return which missing samples are bridged: those of short gaps inside the record."""
    missing = np.isnan(z)
    out = np.zeros(z.size, dtype=bool)
    edges = np.flatnonzero(np.diff(np.concatenate([[0], missing.astype(np.int8), [0]])))
    for a, b in zip(edges[::2].tolist(), edges[1::2].tolist(), strict=True):
        out[a:b] = a > 0 and b < z.size and b - a <= _SHORT_GAP
    return out


def feed_number(speed: float, speeds: Sequence[float]) -> int:
    """Return the number of a feedrate; those as near to the one below as `SAME_FEED` are one."""
    number, last = 0, speeds[0]
    for value in speeds:
        if value > last * (1.0 + SAME_FEED):
            number += 1
        last = value
        if value >= speed:
            break
    return number


# ---- private to separation: the height scale of a set of runs, and which runs share a noise model ----


def common_slope(runs: Sequence[PreparedRun]) -> float:
    """Return the slope that all runs share, each with its own offset."""
    top = bottom = 0.0
    for run in runs:
        valid = ~np.isnan(run.z)
        x, z = run.x[valid] - run.x[valid].mean(), run.z[valid] - run.z[valid].mean()
        top, bottom = top + float(x @ z), bottom + float(x @ x)
    return top / bottom if bottom else 0.0


def rms_about_line(runs: Sequence[PreparedRun]) -> float:
    """Return the RMS of the readings about one slope and an offset for each run."""
    pairs = [
        (r.x[v] - r.x[v].mean(), r.z[v] - r.z[v].mean()) for r in runs for v in [~np.isnan(r.z)]
    ]
    x, z = (np.concatenate(part) for part in zip(*pairs, strict=True))
    return float(np.sqrt(np.mean((z - (x @ z) / (x @ x) * x) ** 2)))


def mad_about_medians(runs: Sequence[PreparedRun]) -> float:
    """Return a robust spread of the readings about the median slope and an offset for each run."""
    slopes = []
    for run in runs:
        known = np.flatnonzero(~np.isnan(run.z))
        few = known[:: max(1, known.size // 20)]
        slopes.append(float(np.median(np.diff(run.z[few]) / np.diff(run.x[few]))))
    slope = float(np.median(slopes))
    flat = [r.z - slope * r.x for r in runs]
    pooled = np.abs(np.concatenate([f - np.nanmedian(f) for f in flat]))
    return MAD * float(np.nanmedian(pooled))


def time_step_groups(runs: Sequence[PreparedRun]) -> list[list[int]]:
    """Group the runs that share a noise model: sampling interval and probe."""
    groups: list[list[int]] = []
    for i in sorted(range(len(runs)), key=lambda j: -runs[j].time_step):
        for group in reversed(groups):
            first = runs[group[0]]
            if (
                runs[i].time_step > (1.0 - SAME_INTERVAL) * first.time_step
                and runs[i].probe == first.probe
            ):
                group.append(i)
                break
        else:
            groups.append([i])
    return groups


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
    noise: Sequence[NoiseModel],
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
