"""Estimates whose covariance is known from outside: plain numpy on a dense grid."""

from dataclasses import replace

import numpy as np

from metrosep.separation import machine_axis, separate
from metrosep.separation.covariance import CovarianceModes
from metrosep.separation.runs.base import DirectionEstimate, SampledCurve

NM = 1e-9
LENGTH = 45e-3
X = np.linspace(0.0, LENGTH, 1201)
DRAWS = 4000
OF_DRAWS = 4.0 / np.sqrt(2.0 * DRAWS)
"""A standard deviation of so many draws is known to this share, at four of its sigmas."""


def waves(x, longest=60e-3, n=12):
    """Columns of sines and cosines, longest first: as different from the package's as possible."""
    k = np.arange(1, n + 1)
    angle = 2 * np.pi * np.outer(x, k) / longest
    return np.hstack([np.sin(angle), np.cos(angle)])


def some_covariance(n, seed=1):
    """A full covariance of coefficients whose size falls with the wavelength, m^2."""
    rng = np.random.default_rng(seed)
    root = rng.normal(size=(n, n)) / np.sqrt(n) * NM * 5 / (1 + np.tile(np.arange(n // 2), 2))
    return root.T @ root


def an_estimate(u, modes, error=None):
    """An estimate around a band and modes, as a method would fill it."""
    axis = machine_axis(seed=1, disturbance="none")
    made = separate(axis.runs, method="mean", start=0.0, length=LENGTH)
    z = 100 * NM * np.sin(2 * np.pi * X / 21e-3) if error is None else error
    part = DirectionEstimate(SampledCurve(X, z), SampledCurve(X, u), modes=modes)
    return replace(made, start=0.0, stop=LENGTH, directions_data={1: part}, history=())


def known(n=12, error=None, seed=1):
    """An estimate of known covariance, and that covariance on X."""
    basis, c = waves(X, n=n), some_covariance(2 * n, seed)
    whole = basis @ c @ basis.T
    u = np.sqrt(np.diag(whole))
    return an_estimate(u, CovarianceModes.of(X, basis, c), error), whole
