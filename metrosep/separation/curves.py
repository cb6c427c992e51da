"""Curves that an estimate consists of: a Fourier series with a line, or samples.

Both evaluate to NaN outside the travel that was measured: an error is never extrapolated.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from metrosep.core._arrays import FloatArray
from metrosep.core.errors import DataError
from metrosep.spectral.dft import fourier_sum

__all__ = [
    "LINE_POINTS",
    "Curve",
    "FeedTerm",
    "FourierCurve",
    "SampledCurve",
    "curve_from_dict",
]


LINE_POINTS = 4001
"""Uniform positions over the evaluation range from which its least-squares line is taken."""

_EDGE_RTOL = 1e-9
"""Positions this far outside the travel, relative to it, count as its end (rounding)."""


def _inside(x: FloatArray, travel: tuple[float, float]) -> NDArray[np.bool_]:
    margin = _EDGE_RTOL * (travel[1] - travel[0])
    return np.asarray((x >= travel[0] - margin) & (x <= travel[1] + margin))


@dataclass(frozen=True, slots=True, eq=False)
class FourierCurve:
    """``offset + slope (x - origin) + sum a_k cos + b_k sin`` of ``2 pi k (x - origin)/period``."""

    origin: float  # m: zero of phase; longest wavelength
    period: float
    cosine: FloatArray  # shape (K,), m: coefficients a_k, b_k
    sine: FloatArray
    offset: float  # m: constant part
    slope: float  # rad: linear part
    travel: tuple[float, float]  # of (float, float), m: where the curve is defined

    def __call__(self, x: ArrayLike) -> FloatArray:
        """Return the values at positions in m; NaN outside the travel."""
        xs = np.atleast_1d(np.asarray(x, dtype=np.float64))
        both = np.concatenate([self.cosine, self.sine])
        z = self.offset + self.slope * (xs - self.origin)
        z += fourier_sum(xs.ravel(), both, origin=self.origin, period=self.period).reshape(
            xs.shape
        )
        return np.where(_inside(xs, self.travel), z, np.nan)

    def to_dict(self) -> dict[str, Any]:
        """Return plain values for JSON; see `curve_from_dict`."""
        return {
            "kind": "fourier",
            "origin_m": self.origin,
            "period_m": self.period,
            "cosine_m": self.cosine.tolist(),
            "sine_m": self.sine.tolist(),
            "offset_m": self.offset,
            "slope_rad": self.slope,
            "travel_m": list(self.travel),
        }


@dataclass(frozen=True, slots=True, eq=False)
class SampledCurve:
    """Samples joined by straight lines.

    Parameters
    ----------
    x : ndarray, shape (n,), m
        Rising positions.
    z : ndarray, shape (n,), m
        Values; NaN = not known there.
    """

    x: FloatArray
    z: FloatArray

    def __call__(self, x: ArrayLike) -> FloatArray:
        """Return the values at positions in m; NaN outside the travel."""
        xs = np.atleast_1d(np.asarray(x, dtype=np.float64))
        travel = (float(self.x[0]), float(self.x[-1]))
        return np.where(_inside(xs, travel), np.interp(xs, self.x, self.z), np.nan)

    def to_dict(self) -> dict[str, Any]:
        """Return plain values for JSON; see `curve_from_dict`."""
        z = [None if np.isnan(v) else float(v) for v in self.z]
        return {"kind": "sampled", "x_m": self.x.tolist(), "z_m": z}


Curve = FourierCurve | SampledCurve


@dataclass(frozen=True, slots=True, eq=False)
class FeedTerm:
    """How an error changes with the feedrate: ``e(x, v) = e(x) + (v - reference) change(x)``.

    Parameters
    ----------
    reference : float, m/s
        Feedrate for which the error itself stands.
    change : SampledCurve
        Change of the error in m for each m/s, line removed over the evaluation range.
    covariance : SampledCurve
        Of error and change, m^2 s/m.
    variance : SampledCurve
        Of the change, (m s/m)^2.
    """

    reference: float
    change: SampledCurve
    covariance: SampledCurve
    variance: SampledCurve

    def to_dict(self) -> dict[str, Any]:
        """Return plain values for JSON; see `FeedTerm.from_dict`."""
        return {
            "reference_m_per_s": self.reference,
            "change": self.change.to_dict(),
            "covariance": self.covariance.to_dict(),
            "variance": self.variance.to_dict(),
        }

    @classmethod
    def from_dict(cls, data: dict[str, Any]) -> FeedTerm:
        """Return the term that `to_dict` wrote.

        Parameters
        ----------
        data : dict
            As stored.

        Returns
        -------
        FeedTerm
            The same term.

        Raises
        ------
        DataError
            If a curve is damaged or not sampled.
        KeyError
            If a key is missing.
        """
        curves = [curve_from_dict(data[k]) for k in ("change", "covariance", "variance")]
        if not all(isinstance(c, SampledCurve) for c in curves):
            raise DataError("the curves of a feed-dependent term must be sampled")
        change, covariance, variance = (c for c in curves if isinstance(c, SampledCurve))
        return cls(float(data["reference_m_per_s"]), change, covariance, variance)


def curve_from_dict(data: dict[str, Any]) -> Curve:
    """Return the curve that `to_dict` wrote."""
    try:
        if data["kind"] == "fourier":
            low, high = data["travel_m"]
            return FourierCurve(
                origin=float(data["origin_m"]),
                period=float(data["period_m"]),
                cosine=np.array(data["cosine_m"], dtype=np.float64),
                sine=np.array(data["sine_m"], dtype=np.float64),
                offset=float(data["offset_m"]),
                slope=float(data["slope_rad"]),
                travel=(float(low), float(high)),
            )
        if data["kind"] == "sampled":
            return SampledCurve(
                np.array(data["x_m"], dtype=np.float64), np.array(data["z_m"], dtype=np.float64)
            )
    except (KeyError, TypeError, ValueError) as exc:
        raise DataError(
            f"a stored curve is damaged or incomplete ({exc!r}); run the separation again"
        ) from exc
    raise DataError(f"unknown kind of curve {data.get('kind')!r}; expected 'fourier' or 'sampled'")
