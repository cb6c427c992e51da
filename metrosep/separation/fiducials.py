"""Registration by fiducials: shift and turn of one map against another from marked points."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from types import MappingProxyType
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from metrosep.core._arrays import FloatArray
from metrosep.core.errors import (
    DataError,
    DegenerateFitError,
    TooFewSamplesError,
)

__all__ = ["Registration", "register_points"]


@dataclass(frozen=True, slots=True)
class Registration:
    """Where a map lies against another one: turned about the centre, then shifted.

    ``moved(p) = fixed(R(-angle) (p - shift))`` with p from the centre: a feature at q in the fixed
    map is at ``R(angle) q + shift`` in the moved one.

    Parameters
    ----------
    shift_x, shift_y : float, m
        Shift along x and y.
    angle : float, rad
        Turn, counter-clockwise (from +x towards +y).
    cov : ndarray, shape (3, 3)
        Covariance of shift_x, shift_y, angle; NaN where it is not known.
    rms : float, m
        Of what is left of the difference (of the distance of points).
    centre : tuple of (float, float), m
        Centre of turn, from pixel [0, 0].
    messages : tuple of str, optional
        What the user should know.
    audit : mapping, optional
        Plain values.
    """

    shift_x: float
    shift_y: float
    angle: float
    cov: FloatArray
    rms: float
    centre: tuple[float, float]
    messages: tuple[str, ...] = ()
    audit: Mapping[str, Any] = field(default_factory=lambda: MappingProxyType({}))

    @property
    def u_shift(self) -> tuple[float, float]:
        """Standard uncertainty of the shift along x and y, in m."""
        return math.sqrt(self.cov[0, 0]), math.sqrt(self.cov[1, 1])

    @property
    def u_angle(self) -> float:
        """Standard uncertainty of the angle, in rad."""
        return math.sqrt(self.cov[2, 2])


def register_points(fixed: ArrayLike, moved: ArrayLike) -> Registration:
    """Return shift and turn that bring fiducials of one map onto those of another.

    Parameters
    ----------
    fixed, moved : array_like, shape (n, 2), m
        Positions (x, y) of the same fiducials from the same centre, in the same order; n >= 2.

    Returns
    -------
    Registration
        Least squares of the distances; covariance from the residual, NaN for two points.

    Raises
    ------
    DataError
        If the positions are not finite, or not as many.
    TooFewSamplesError
        If there are fewer than two.
    DegenerateFitError
        If all fiducials are one point.

    Notes
    -----
    ``angle = atan2(sum (p x q), sum (p . q))`` about the means; ``u(angle) = s / sqrt(sum r**2)``
    with the scatter s of one coordinate and the distances r from the mean. A mirrored map is found
    by its determinant, and said.

    References
    ----------
    P. H. Schoenemann, Psychometrika 31 (1966) 1-10.

    Examples
    --------
    >>> found = register_points([[0, 0], [1, 0], [0, 2]], [[1, 0], [1, 1], [-1, 0]])
    >>> round(found.angle, 6), found.shift_x
    (1.570796, 1.0)
    """
    p, q = (_points(v, name) for v, name in ((fixed, "fixed"), (moved, "moved")))
    if p.shape != q.shape:
        raise DataError(f"register_points: {len(p)} fixed points and {len(q)} moved points")
    if len(p) < 2:
        raise TooFewSamplesError("register_points needs at least two fiducials")
    mean_p, mean_q = p.mean(axis=0), q.mean(axis=0)
    a, b = p - mean_p, q - mean_q
    spread = float((a**2).sum())
    if spread == 0.0 or float((b**2).sum()) == 0.0:
        raise DegenerateFitError("register_points: all fiducials are at one point; no angle shows")
    angle = math.atan2(float((a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0]).sum()), float((a * b).sum()))
    rotation = _rotation(angle)
    shift = mean_q - rotation @ mean_p
    rest = b - a @ rotation.T
    freedom = 2 * len(p) - 3
    variance = float((rest**2).sum()) / freedom if freedom > 1 else math.nan
    lever = _rotation(angle + np.pi / 2) @ mean_p  # of the shift against the angle
    design = np.array([[1.0, 0.0, -lever[0]], [0.0, 1.0, -lever[1]], [0.0, 0.0, 1.0]])
    own = np.diag([1.0 / len(p), 1.0 / len(p), 1.0 / spread])
    messages = []
    if math.isnan(variance):
        messages.append("two fiducials leave no redundancy, so no uncertainty; give three or more")
    if len(p) > 2 and np.linalg.det(a.T @ b) < 0.0 and _mirrored_fits(a, b, rest):
        messages.append("the moved fiducials look mirrored: with x reversed they fit much better")
    rms = math.sqrt(float((rest**2).sum()) / len(p))
    audit = MappingProxyType({"n_fiducials": len(p), "rms_um": rms * 1e6})
    cov = design @ own @ design.T * variance
    return Registration(
        float(shift[0]), float(shift[1]), angle, cov, rms, (0.0, 0.0), tuple(messages), audit
    )


def _rotation(angle: float) -> FloatArray:
    c, s = math.cos(angle), math.sin(angle)
    return np.array([[c, -s], [s, c]])


def _points(values: ArrayLike, name: str) -> FloatArray:
    try:
        points = np.array(values, dtype=np.float64)
    except (TypeError, ValueError) as exc:
        raise DataError(f"register_points: {name} holds no numbers ({exc})") from None
    if points.ndim != 2 or points.shape[1] != 2 or not np.isfinite(points).all():
        raise DataError(
            f"register_points: {name} must be finite positions (x, y), shape (n, 2), got "
            f"{points.shape}"
        )
    return points


def _mirrored_fits(a: FloatArray, b: FloatArray, rest: FloatArray) -> bool:
    flipped = a * np.array([-1.0, 1.0])
    angle = math.atan2(
        float((flipped[:, 0] * b[:, 1] - flipped[:, 1] * b[:, 0]).sum()),
        float((flipped * b).sum()),
    )
    other = b - flipped @ _rotation(angle).T
    return bool((other**2).sum() < 0.25 * (rest**2).sum())
