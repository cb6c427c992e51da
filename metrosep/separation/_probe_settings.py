"""What `MultiprobeRoundness` checks of its settings, and its null space."""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from metrosep.core._arrays import FloatArray
from metrosep.core.errors import DataError, InvalidSamplesError, UnitError
from metrosep.separation._circle import centring, numbers
from metrosep.separation.null_space import Unobservable

__all__ = ["PARTS", "checked_covariance", "each_probe", "probe_null_space"]


PARTS = ("artefact", "x", "y")


def probe_null_space(gain: FloatArray, max_gain: float) -> tuple[Unobservable, ...]:
    """Return offset, eccentricity and the undulations of infinite gain, part by part."""
    found = []
    for part, row in zip(PARTS, gain, strict=True):
        found.append(centring(part))
        hidden = tuple(int(k) for k in np.flatnonzero(np.isinf(row)) if k > 1)
        if hidden:
            found.append(
                Unobservable(
                    part,
                    "harmonic",
                    hidden,
                    "suppressed by these probe angles (noise gain of the artefact above "
                    f"{max_gain:g}); other angles or one more probe show them",
                )
            )
    return tuple(found)


def each_probe(values: Any, n: int, name: str, unit: str, most: float) -> tuple[float, ...]:
    """Return one uncertainty for each probe, refused beyond what can be meant."""
    array = np.atleast_1d(numbers(values, f"{name} must be one number or {n}"))
    if array.shape not in ((1,), (n,)):
        raise DataError(f"{name} must be one number or {n}, got the shape {array.shape}")
    if not ((array >= 0.0).all() and np.isfinite(array).all()):
        raise DataError(f"{name} must be >= 0 and finite, got {array.tolist()} {unit}".rstrip())
    if array.max() > most:
        hint = "; degrees? give numpy.deg2rad" if unit else "; percent? divide by 100"
        raise UnitError(f"{name} of {array.max():.6g} {unit} is above {most:g}{hint}")
    return tuple(np.broadcast_to(array, n).tolist())


def checked_covariance(cov: Any, n: int) -> tuple[tuple[float, ...], ...] | None:
    """Return the covariance of the probes as rows, refused where it is none."""
    if cov is None:
        return None
    array = numbers(cov, f"cov must hold {n} variances or {n} x {n} covariances in m^2")
    if array.shape == (n,):
        array = np.diag(array)
    if array.shape != (n, n):
        raise InvalidSamplesError(
            f"cov must hold {n} variances or {n} x {n} covariances in m^2, got {array.shape}"
        )
    size = float(np.abs(array).max()) if np.isfinite(array).all() else math.nan
    if (
        not size > 0.0
        or np.abs(array - array.T).max() > 1e-9 * size
        or (np.diag(array) <= 0).any()
    ):
        raise InvalidSamplesError(
            "cov must be finite and symmetric with variances > 0, in m^2; a probe of no use is "
            "better left out"
        )
    return tuple(tuple(row) for row in array.tolist())
