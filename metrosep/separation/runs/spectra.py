"""Spectra of the mean run of each feedrate at common wavelengths.

Geometry keeps its wavelength when the feedrate changes, a vibration slides with it: that is the
first step of Kono's method and the picture of every report.

Source: Kono et al. 2008, section 2.3.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from metrosep.core._arrays import ComplexArray, FloatArray
from metrosep.core.errors import DataError, InvalidSamplesError, TooFewSamplesError
from metrosep.core.numbers import positive
from metrosep.core.runset import Run, RunSet
from metrosep.core.units import format_length
from metrosep.separation.runs.design import (
    lines_of_runs,
    measured_pitch,
    on_common_grid,
    travel_of,
)
from metrosep.spectral.dft import fourier_basis, fourier_coefficients
from metrosep.spectral.window import kono_weights, tukey_weights

Norm = Literal["amplitude", "power", "psd"]
Taper = Literal["kono", "tukey"]
Averaging = Literal["coherent", "power"]

_MM, _NM = 1e-3, 1e-9
_SPACE_SHARE = 2.5

_GAP_SHARE = 0.02
"""Widest gap in a run, as a share of the modelled length, that a Fourier sum may pass over."""


@dataclass(frozen=True, slots=True, eq=False)
class FeedSpectra:
    """Spectra of the mean run of each feedrate at the wavelengths l_x/k.

    Parameters
    ----------
    feeds : tuple of float, m/s
        Feedrates, slowest first.
    wavelength : ndarray, shape (K,), m
        ``l_x/k``, k = 1 ... K.
    coefficients : ndarray of complex, shape (n_feeds, K), m
        ``a_k + i b_k`` of the weighted mean run, weight not divided out.
    per_run : list of ndarray of complex, shape (n_runs_of_feed, K)
        The same of each run.
    mean_weight, mean_square_weight : float
        Mean of the weights and of their squares.
    slopes : list of float, rad
        Slope of the line removed from each run.
    """

    feeds: tuple[float, ...]
    wavelength: FloatArray
    coefficients: ComplexArray
    per_run: list[ComplexArray]
    mean_weight: float
    mean_square_weight: float
    slopes: list[float]

    @property
    def coherence(self) -> FloatArray:
        """Coherence over feedrates: 1 where all agree in amplitude and phase, about 1/n in noise."""
        sums = np.abs(self.coefficients.sum(axis=0)) ** 2
        total = (np.abs(self.coefficients) ** 2).sum(axis=0) * self.coefficients.shape[0]
        return np.asarray(np.divide(sums, total, out=np.zeros_like(total), where=total > 0.0))

    def power(
        self, norm: Norm, length: float | str, *, averaging: Averaging = "coherent"
    ) -> FloatArray:
        """Return P(lambda) of each feedrate in one of three normalisations.

        Parameters
        ----------
        norm : {"amplitude", "power", "psd"}
            Amplitude ``|c|/mean(f)`` in m, its square in m^2, or one-sided density in m^3.
        length : float, m
            Length of the modelling l_x.
        averaging : {"coherent", "power"}, optional
            Spectrum of the mean run (the paper), or mean of the spectra of the runs.

        Returns
        -------
        ndarray, shape (n_feeds, K)
            Spectrum of each feedrate.
        """
        length = positive(length, "length", dimension="length")
        size = np.abs(self.coefficients)
        if averaging == "power":
            size = np.sqrt([(np.abs(rows) ** 2).mean(axis=0) for rows in self.per_run])
        if norm == "amplitude":
            return np.asarray(size / self.mean_weight)
        if norm == "power":
            return np.asarray((size / self.mean_weight) ** 2)
        return np.asarray(0.5 * size**2 * length / self.mean_square_weight)


def feed_spectra(
    runs: RunSet,
    *,
    origin: float,
    length: float,
    n_harmonics: int,
    taper_fraction: float = 0.1,
    taper: Taper = "kono",
) -> FeedSpectra:
    """Return the spectrum of the coherent mean of the runs at each feedrate.

    Parameters
    ----------
    runs : RunSet
        Runs of one direction that cover ``origin ... origin + length``.
    origin, length : float, m
        x_st and l_x of eq. 4.
    n_harmonics : int
        Number of wavelengths.
    taper_fraction : float, optional
        N over the number of sampling points, 0 < fraction <= 0.5; 0.1 in the paper.
    taper : {"kono", "tukey"}, optional
        Eq. 5 to the letter, or its symmetric relative.

    Returns
    -------
    FeedSpectra
        Complex coefficients of every feedrate and run.

    Raises
    ------
    DataError
        If `taper_fraction` is out of range.
    TooFewSamplesError
        If a run has too few valid samples in the range.
    InvalidSamplesError
        If a run has a gap wider than 2 % of the length.
    """
    if not 0.0 < taper_fraction <= 0.5:
        raise DataError(f"taper_fraction must be in (0, 0.5], got {taper_fraction}")
    groups = runs.by_feed() or [(math.nan, runs.runs)]
    joints = _joints(runs, origin, length)
    per_run: list[ComplexArray] = []
    slopes: list[float] = []
    weights: list[FloatArray] = []
    for _, members in groups:
        rows = []
        for run in members:
            x, z, slope, weight = _tapered(
                run, origin, length, taper_fraction, taper, joints.get(id(run))
            )
            slopes.append(slope)
            weights.append(weight)
            rows.append(
                fourier_coefficients(
                    x,
                    z,
                    origin=origin,
                    period=length,
                    n_harmonics=n_harmonics,
                    weights=weight,
                )
            )
        per_run.append(np.array(rows))
    joined = np.concatenate(weights)
    return FeedSpectra(
        feeds=tuple(feed for feed, _ in groups),
        wavelength=length / np.arange(1, n_harmonics + 1),
        coefficients=np.array([rows.mean(axis=0) for rows in per_run]),
        per_run=per_run,
        mean_weight=float(joined.mean()),
        mean_square_weight=float((joined**2).mean()),
        slopes=slopes,
    )


def _tapered(
    run: Run,
    origin: float,
    length: float,
    taper_fraction: float,
    taper: Taper,
    joint: _Joint | None = None,
) -> tuple[FloatArray, FloatArray, float, FloatArray]:
    """Return positions, heights without mean and line, the slope removed, and the weights."""
    x, z = _inside(run, origin, length)
    slope, level = np.polyfit(x - origin, z, 1)
    if joint is not None:
        slope, level = joint.slope, joint.level
        order = np.argsort(np.concatenate([x, joint.x]), kind="stable")
        x = np.concatenate([x, joint.x])[order]
        z = np.concatenate([z, joint.z])[order]
    window = kono_weights if taper == "kono" else tukey_weights
    weight = window(x.size, max(1, round(taper_fraction * x.size)))
    return x, z - (slope * (x - origin) + level), float(slope), weight


@dataclass(frozen=True, slots=True, eq=False)
class _Joint:
    """What runs with holes in different places say of one of them."""

    slope: float  # rad: of its line, fitted together with those of all runs
    level: float  # m: of that line at the origin
    x: FloatArray  # m: places in its holes that other runs of its feedrate have measured
    z: FloatArray  # m: their mean there, on its line


def _joints(runs: RunSet, origin: float, length: float) -> dict[int, _Joint]:
    """Return what joins runs with holes, by the identity of each run; nothing where there are none.

    The paper averages the runs of one feedrate in space before it transforms: where one was not
    measured that mean is the mean of the others.
    """
    grid, table, _ = on_common_grid(runs, origin, origin + length)
    inner = np.ones(grid.size, dtype=bool)
    inner[[0, -1]] = False  # a run may end short of them by rounding
    holes = np.isnan(table) & inner
    if (holes == holes[0]).all():
        return {}
    for run in runs:
        _inside(run, origin, length)  # refuses what no Fourier sum bridges
    line = np.column_stack([np.ones(grid.size), (grid - origin) / length])
    shares, _ = lines_of_runs(runs, table, line, inner)
    # The shares leave the line of the curve in it: it is taken out with them.
    rest = table - shares @ line.T
    seen = inner & ~holes.all(axis=0)
    common = np.linalg.lstsq(line[seen], np.nanmean(rest[:, seen], axis=0), rcond=None)[0]
    shares = shares + common
    rest = rest - line @ common
    row = {id(run): i for i, run in enumerate(runs)}
    out = {}
    for members in [group for _, group in runs.by_feed()] or [runs.runs]:
        of_feed = rest[[row[id(run)] for run in members]]
        for run in members:
            i = row[id(run)]
            take = holes[i] & ~np.isnan(of_feed).all(axis=0)
            z = np.nanmean(of_feed[:, take], axis=0) + line[take] @ shares[i]
            out[id(run)] = _Joint(float(shares[i, 1] / length), float(shares[i, 0]), grid[take], z)
    return out


def _inside(run: Run, origin: float, length: float) -> tuple[FloatArray, FloatArray]:
    """Return rising positions and valid heights within half a pitch of the modelled length."""
    order = slice(None) if run.direction > 0 else slice(None, None, -1)
    x, z = run.x[order], run.z[order]
    margin = 0.5 * abs(float(x[-1] - x[0])) / (x.size - 1)
    keep = (x >= origin - margin) & (x <= origin + length + margin) & ~np.isnan(z)
    if keep.sum() < 16:
        raise TooFewSamplesError(
            f"run {run.run_id!r} has {int(keep.sum())} valid samples between {format_length(origin)} "
            f"and {format_length(origin + length)}; 16 are needed"
        )
    gaps = np.diff(np.concatenate([[origin], x[keep], [origin + length]]))
    widest = float(gaps.max())
    if widest > max(_GAP_SHARE * length, 4.0 * margin):
        raise InvalidSamplesError(
            f"run {run.run_id!r} was not measured over {format_length(widest)} within the modelled "
            f"{format_length(length)}; a Fourier sum cannot bridge that: use method='joint', or a range "
            "without the gap"
        ).hinting(method="joint")
    return np.asarray(x[keep]), np.asarray(z[keep])


def _has_spectrum(run: Run, origin: float, length: float) -> bool:
    try:
        _inside(run, origin, length)
    except (InvalidSamplesError, TooFewSamplesError):
        return False
    return True


def least_squares_coefficients(
    runs: RunSet,
    kept: NDArray[np.bool_],
    *,
    origin: float,
    length: float,
    taper_fraction: float,
    taper: Taper,
) -> ComplexArray:
    """Return the kept coefficients of each run by weighted least squares."""
    rows = np.zeros((len(runs), kept.size), dtype=np.complex128)
    joints = _joints(runs, origin, length)
    k = np.flatnonzero(kept)
    columns = np.concatenate([k, k + kept.size])
    for i, run in enumerate(runs):
        x, z, _, weight = _tapered(run, origin, length, taper_fraction, taper, joints.get(id(run)))
        basis = fourier_basis(x, origin=origin, period=length, n_harmonics=kept.size)[:, columns]
        root = np.sqrt(weight)
        scale = float(np.abs(z).max()) or 1.0
        solution = np.linalg.lstsq(basis * root[:, None], z * root / scale, rcond=None)[0] * scale
        rows[i, k] = solution[: k.size] + 1j * solution[k.size :]
    return rows


def feed_spectra_columns(runs: RunSet) -> dict[str, list[Any]]:
    """Return amplitude against wavelength for each feedrate over the common travel."""
    low, high = travel_of(runs)
    whole = [r for r in runs if _has_spectrum(r, low, high - low)]
    if not whole:
        return {"feed_mm_min": [], "wavelength_mm": [], "amplitude_nm": []}
    runs = RunSet(whole)
    n = n_wavelengths(runs, high - low)
    spectra = feed_spectra(runs, origin=low, length=high - low, n_harmonics=n)
    amplitude = spectra.power("amplitude", high - low)
    return {
        "feed_mm_min": np.repeat(np.array(spectra.feeds) * 6e4, n).tolist(),
        "wavelength_mm": np.tile(spectra.wavelength / _MM, len(spectra.feeds)).tolist(),
        "amplitude_nm": (amplitude / _NM).ravel().tolist(),
    }


def n_wavelengths(runs: RunSet, length: float) -> int:
    """Return how many harmonics of a length the coarsest run can show."""
    pitch = max(measured_pitch(r) for r in runs)
    return int(np.clip(length / (_SPACE_SHARE * pitch), 1, 1000))
