r"""Private to separation: the geometry as a random function with a learnt spectrum, and its sensor.

.. math:: g(x) = s\,u(x) + \sum_k a_k \cos w_k (x - x_0) + b_k \sin w_k (x - x_0),
          \quad w_k = 2 \pi k / P, \quad a_k, b_k \sim N(0, s_k^2)

u is the straight line, -1 ... 1 over the travel L, and P = 1.4 L. ln s_k^2 is piecewise linear in
ln k with a knot about each octave, ``ln s^2 = B phi``; its slope is drawn to -2.5 +- 1.5 in every
octave, and to that of its neighbours. A wave of any wavelength is a column of the same basis (Fourier
extension, eq. 9). Equation numbers are those of separation-2.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import lru_cache

import numpy as np

from metrosep.core._arrays import ComplexArray, FloatArray

PERIOD_SHARE = 1.4
"""Period of the basis over the travel; greater than 1, so that the error need not close."""

_BEYOND = 0.25 * (PERIOD_SHARE - 1.0)
"""Part of the travel by which a wave goes on as itself at each end: a late reading at the start of
a run shows the error before it. A basis that is fitted on the travel alone falls away there."""

HELD_SHARE = 0.9
"""Share of the highest wavenumber up to which the basis holds a wave of any wavelength."""

LINE_SD = 30.0
"""Prior standard deviation of the line over the RMS of the readings."""

SLOPE, SLOPE_SD = -2.5, 1.5
"""Prior of the power law of the spectrum: rough and smooth surfaces lie within two of these."""

_BEND_SD = 1.0
"""Prior standard deviation of the second difference of ln s^2, over octaves."""

_RIDGE = 1e-9

_PER_CELL = 6
"""Wavenumbers that are looked at in one over the travel."""


class Extension:
    """Functions on the travel as columns of the basis: line, cosines, sines."""

    def __init__(
        self, start: float, travel: float, n_harmonics: int, *, origin: float | None = None
    ) -> None:
        self.start, self.travel, self.n = start, travel, n_harmonics
        self.origin = start if origin is None else origin  # of the phases
        self.period = PERIOD_SHARE * travel
        n_grid = int(np.ceil(4 * n_harmonics * (1.0 + 2.0 * _BEYOND))) + 1
        beyond = _BEYOND * travel
        self.grid = np.linspace(start - beyond, start + travel + beyond, n_grid)
        e = self.basis(self.grid)
        normal = e.T @ e + _RIDGE * self.grid.size * np.eye(e.shape[1])
        self._pseudo = np.linalg.solve(normal, e.T)
        for shared in (self.grid, self._pseudo):
            shared.setflags(write=False)
        self._scan: tuple[FloatArray, FloatArray] | None = None

    @property
    def wavenumbers(self) -> FloatArray:
        """w_k in rad/m."""
        return np.asarray(2.0 * np.pi * np.arange(1, self.n + 1) / self.period)

    def line(self, x: FloatArray) -> FloatArray:
        """Return u(x)."""
        return 2.0 * (x - self.start) / self.travel - 1.0

    def basis(self, x: FloatArray, *, block_length: float = 0.0) -> FloatArray:
        """Return line, cosines and sines at positions; samples may be averages over a length."""
        from metrosep.spectral.dft import fourier_basis

        waves = fourier_basis(x, origin=self.origin, period=self.period, n_harmonics=self.n)
        if block_length:
            k = np.arange(1, self.n + 1)
            waves = waves * np.tile(np.sinc(k * block_length / self.period), 2)
        return np.column_stack([self.line(x), waves])

    def coefficients(self, values: FloatArray) -> FloatArray:
        """Return the columns of functions that are given on `grid` (eq. 9)."""
        return np.asarray(self._pseudo @ values)

    def wave(self, wavenumber: float | FloatArray) -> FloatArray:
        """Return cosine and sine of each wavenumber in 1/m, shape (1 + 2 K, 2 m), pair by pair."""
        phase = 2.0 * np.pi * np.outer(self.grid - self.origin, wavenumber)
        pairs = np.stack([np.cos(phase), np.sin(phase)], axis=-1)
        return self.coefficients(pairs.reshape(self.grid.size, -1))

    def scan(self) -> tuple[FloatArray, FloatArray]:
        """Return the wavenumbers at which waves are looked for, and their columns."""
        if self._scan is None:
            most = HELD_SHARE * self.n / self.period
            grid = np.arange(1.0 / self.travel, most, 1.0 / (_PER_CELL * self.travel))
            self._scan = grid, self.wave(grid)
            for shared in self._scan:
                shared.setflags(write=False)
        return self._scan

    def wave_change(self, wavenumber: float, pair: FloatArray) -> FloatArray:
        """Return the derivative of a wave with its wavenumber, shape (1 + 2 K,)."""
        along = 2.0 * np.pi * (self.grid - self.origin)
        phase = wavenumber * along
        return self.coefficients(along * (pair[1] * np.cos(phase) - pair[0] * np.sin(phase)))


@lru_cache(maxsize=2)
def extension(start: float, travel: float, n_harmonics: int, origin: float) -> Extension:
    """Return the functions on a travel; both directions, and fits without a run, mostly have the same."""
    return Extension(start, travel, n_harmonics, origin=origin)


@dataclass(slots=True, eq=False)
class Spectrum:
    """Prior variances of the coefficients, ``s^2 = exp(B phi)``."""

    n_harmonics: int
    phi: FloatArray = field(init=False)
    hats: FloatArray = field(init=False)  # B, shape (K, knots)
    precision: FloatArray = field(init=False)
    pull: FloatArray = field(init=False)

    def __post_init__(self) -> None:
        k = np.log(np.arange(1, self.n_harmonics + 1))
        n = max(2, int(np.rint(k[-1] / np.log(2.0))) + 1)
        knots = np.linspace(0.0, k[-1], n)
        self.hats = np.array([np.interp(k, knots, row) for row in np.eye(n)]).T
        # The slope over each step is N(-2.5, 1.5^2), and from one octave to the next it changes by
        # N(0, 1): a stationary process, so octaves that are not seen go back to the power law and
        # do not go on as steeply as the last that is.
        octaves = float(knots[1] - knots[0]) / np.log(2.0)
        kept = (1.0 - 0.5 * (_BEND_SD / np.log(2.0) / SLOPE_SD) ** 2) ** octaves
        slopes = np.diff(np.eye(n), axis=0) / (knots[1] - knots[0])
        free = np.vstack([slopes[:1], (slopes[1:] - kept * slopes[:-1]) / np.sqrt(1.0 - kept**2)])
        mean = SLOPE * np.append(1.0, np.full(n - 2, (1.0 - kept) / np.sqrt(1.0 - kept**2)))
        self.precision = free.T @ free / SLOPE_SD**2
        self.pull = free.T @ mean / SLOPE_SD**2
        # The level, that of the longest wave, has a prior that is flat in s, not in ln s: where no
        # geometry is seen, ln s would run away to nothing and take the band with it. As the mean
        # level of all octaves it would lift, through the bends, those that the readings do not show.
        self.pull[0] += 0.5
        self.phi = SLOPE * knots

    @property
    def variance(self) -> FloatArray:
        """s_k^2, shape (K,)."""
        return np.asarray(np.exp(self.hats @ self.phi))

    def step(self, score: FloatArray, information: FloatArray, *, largest: float = 1.5) -> float:
        """Take a step of Fisher scoring from the sums over each pair; return the largest change."""
        gradient = self.hats.T @ score + self.pull - self.precision @ self.phi
        matrix = self.information(information)
        change = np.clip(np.linalg.solve(matrix, gradient), -largest, largest)
        self.phi = self.phi + change
        return float(np.abs(change).max())

    def information(self, per_pair: FloatArray) -> FloatArray:
        """Return the precision of phi."""
        ridge = 1e-9 * np.eye(self.phi.size)
        return np.asarray((self.hats.T * per_pair) @ self.hats + self.precision + ridge)


@dataclass(frozen=True, slots=True)
class Sensor:
    """Total lag l of the reading in s and its spread q in s^2: delay l - T, time constant T = sqrt q."""

    lag: float = 0.0
    spread: float = 0.0

    def response(self, wavenumbers: FloatArray, velocity: float) -> ComplexArray:
        """Return H(w, v) (eq. 3); a wave a - i b is read as H (a - i b)."""
        constant = np.sqrt(self.spread)
        wv = wavenumbers * velocity
        return np.asarray(np.exp(-1j * wv * (self.lag - constant)) / (1.0 + 1j * wv * constant))

    def log_changes(
        self, wavenumbers: FloatArray, velocity: float
    ) -> tuple[ComplexArray, ComplexArray]:
        """Return d ln H / d l and d ln H / d q (eq. 20)."""
        wv = wavenumbers * velocity
        constant = np.sqrt(self.spread)
        return np.asarray(-1j * wv), np.asarray(-(wv**2) / (2.0 * (1.0 + 1j * wv * constant)))


def filtered(columns: FloatArray, factors: ComplexArray) -> FloatArray:
    """Return coefficients (line, a, b) as read through complex factors on a - i b."""
    out = np.array(columns, dtype=np.float64)
    _turn(out, factors)
    return out


def seen_through(gram: FloatArray, factors: ComplexArray) -> FloatArray:
    """Return normal equations of coefficients of which each is read through a complex factor."""
    out = np.array(gram, dtype=np.float64)
    _turn(out, factors)
    _turn(out.T, factors)
    return out


def _turn(columns: FloatArray, factors: ComplexArray) -> None:
    # (a - i b)(c + i s) = (a c + b s) - i (b c - a s), in real numbers: half of the work
    n = factors.size
    shape = (n, *[1] * (columns.ndim - 1))
    c, s = (np.ascontiguousarray(p).reshape(shape) for p in (factors.real, factors.imag))
    a, b = columns[1 : n + 1], columns[n + 1 : 2 * n + 1]
    taken = a * s
    a *= c
    a += b * s
    b *= c
    b -= taken
