"""Straightness of a motion after ISO 230-1: minimum zone, least squares and end points together.

error = actual - nominal, positive away from the material; the slope is the alignment of the
reference and no straightness error.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any, Literal, cast

import numpy as np
from numpy.typing import ArrayLike, NDArray

from metrosep.core._arrays import frozen_float
from metrosep.core.errors import DataError, InvalidSamplesError
from metrosep.core.profile import Profile
from metrosep.core.provenance import freeze_mapping
from metrosep.core.quantity import Quantity
from metrosep.parameters.deviation import form_deviation
from metrosep.parameters.form_result import FormDeviation

if TYPE_CHECKING:
    import pandas as pd

__all__ = ["MotionStraightness", "straightness_iso230_1"]

FloatArray = NDArray[np.float64]
Line = Literal["MZ", "LS", "EP"]

_LINES: tuple[Line, ...] = ("MZ", "LS", "EP")


@dataclass(frozen=True, slots=True, eq=False, repr=False)
class MotionStraightness:
    """Straightness from three reference lines, one of them chosen.

    Parameters
    ----------
    reference : {"MZ", "LS", "EP"}
        The line whose value is `value`.
    deviations : mapping of str to FormDeviation
        Of each line: value, residual, support points, proof of the minimum zone.
    values : mapping of str to Quantity
        Straightness in m of each line, with standard uncertainty where it is known.
    slopes : mapping of str to Quantity
        Slope of each line in rad, relative to the instrument's own line.
    audit : mapping
        Settings and counts, plain values.
    messages : tuple of str
        What the user should know.
    """

    reference: Line
    deviations: Mapping[str, FormDeviation]
    values: Mapping[str, Quantity]
    slopes: Mapping[str, Quantity]
    audit: Mapping[str, Any] = field(default_factory=dict)
    messages: tuple[str, ...] = ()

    @property
    def quantity(self) -> Quantity:
        """Straightness from the chosen line."""
        return self.values[self.reference]

    @property
    def value(self) -> float:
        """Straightness from the chosen line in m."""
        return self.quantity.value

    @property
    def u(self) -> float | None:
        """Standard uncertainty of `value` in m; None where nothing tells it."""
        return self.quantity.u

    @property
    def residual(self) -> FloatArray:
        """Local deviations from the chosen line in m, NaN where not measured, shape (n,)."""
        return cast(Profile, self.deviations[self.reference].residual).z

    @property
    def x(self) -> FloatArray:
        """Positions in m, rising, shape (n,)."""
        return cast(Profile, self.deviations[self.reference].residual).x

    def to_frame(self) -> pd.DataFrame:
        """Return the three lines as a data frame.

        Returns
        -------
        pandas.DataFrame
            Index ``reference``; columns ``straightness_um``, ``u_um``, ``slope_urad``, ``chosen``.
        """
        import pandas as pd

        rows = {
            key: {
                "straightness_um": q.value * 1e6,
                "u_um": math.nan if q.u is None else q.u * 1e6,
                "slope_urad": self.slopes[key].value * 1e6,
                "chosen": key == self.reference,
            }
            for key, q in self.values.items()
        }
        return pd.DataFrame.from_dict(rows, orient="index").rename_axis("reference")

    def __repr__(self) -> str:
        each = ", ".join(f"{key} {q}" for key, q in self.values.items())
        return f"MotionStraightness({self.reference}: {self.quantity}; {each})"


def straightness_iso230_1(
    profile: Profile | ArrayLike,
    z: ArrayLike | None = None,
    *,
    reference: Line = "MZ",
    sd: float | None = None,
) -> MotionStraightness:
    """Return the straightness of a motion from all three reference lines.

    Parameters
    ----------
    profile : Profile, or array_like of shape (n,), m
        Deviation over position; or the positions alone, with `z`.
    z : array_like, shape (n,), m, optional
        Deviations where `profile` holds positions; NaN where not measured.
    reference : {"MZ", "LS", "EP"}, optional
        Minimum zone (the reference method), least squares or end points: which is `value`.
    sd : float, m, optional
        Standard uncertainty of one deviation, independent from point to point: the standard
        deviation of one reading over the root of the number of runs averaged.

    Returns
    -------
    MotionStraightness
        ``value``, ``u``, ``residual`` of the chosen line; ``values["MZ"]``, ``["LS"]``, ``["EP"]``.

    Raises
    ------
    DataError
        If `reference` is none of the three, `sd` is negative, or `z` is missing or superfluous.
    InvalidSamplesError
        If positions and deviations differ in length.
    TooFewSamplesError
        If fewer than three samples are valid.

    Notes
    -----
    The zone is measured along z, as ISO 230-1 does. The minimum zone is exact: two parallel lines
    through an edge of the convex hull and the point opposite to it; never larger than the others.
    u: the value is a sum of the touching points with the weights that the line gives them, so
    ``u = sd sqrt(sum w^2)`` with the points held. As the largest of many noisy points, the value
    itself is too large by about the noise; smooth or average first.

    Null space: offset and slope (alignment), and the form of the reference artefact.

    References
    ----------
    .. [1] ISO 230-1:2012, straightness error of linear motion (clause numbers from memory: 3.4).

    Examples
    --------
    >>> result = straightness_iso230_1([0, 1, 2, 3, 4], [0, 2e-6, 1e-6, 3e-6, 0])
    >>> {key: round(q.value * 1e6, 3) for key, q in result.values.items()}
    {'MZ': 3.0, 'LS': 3.1, 'EP': 3.0}
    """
    if reference not in _LINES:
        raise DataError(f"reference is 'MZ', 'LS' or 'EP', got {reference!r}")
    if sd is not None and not (math.isfinite(sd) and sd >= 0.0):
        raise DataError(f"sd must be zero or positive, in m, got {sd}")
    curve = _as_profile(profile, z)
    deviations: dict[str, FormDeviation] = {
        key: form_deviation(curve, kind="straightness", reference=key) for key in _LINES
    }
    weights: dict[str, FloatArray] = {key: _weights(curve, deviations[key]) for key in _LINES}
    values: dict[str, Quantity] = {
        key: Quantity(
            d.value,
            "m",
            f"{d.quantity.definition}, straightness of a motion, ISO 230-1:2012",
            u=None if sd is None else sd * float(np.sqrt(np.sum(weights[key] ** 2))),
            symbol=f"STR_{key}",
        )
        for key, d in deviations.items()
    }
    return MotionStraightness(
        reference=reference,
        deviations=freeze_mapping(deviations),
        values=freeze_mapping(values),
        slopes=freeze_mapping({k: d.reference_parameters["slope"] for k, d in deviations.items()}),
        audit=freeze_mapping(
            {
                "reference": reference,
                "n_samples": len(curve),
                "n_not_measured": curve.n_invalid,
                "travel_mm": float(np.ptp(curve.x)) * 1e3,
                "sd_nm": None if sd is None else sd * 1e9,
            }
        ),
        messages=_messages(curve, sd),
    )


def _as_profile(profile: Profile | ArrayLike, z: ArrayLike | None) -> Profile:
    if isinstance(profile, Profile):
        if z is not None:
            raise DataError("a Profile holds its own deviations: leave z out")
        return profile
    if z is None:
        raise DataError("positions alone were given; pass z, or a Profile")
    x = frozen_float(profile, name="x", ndim=1)
    if x.size != np.size(z):
        raise InvalidSamplesError(f"x has {x.size} samples, z has {np.size(z)}")
    return Profile(x, z)


def _weights(curve: Profile, deviation: FormDeviation) -> FloatArray:
    """Return the weights of the samples in highest minus lowest deviation, points held."""
    valid = np.flatnonzero(~np.isnan(curve.z))
    weights = np.zeros(len(curve))
    if deviation.reference == "MZ":
        np.add.at(
            weights,
            deviation.support.indices,
            deviation.support.sides * deviation.support.weights,
        )
        return weights
    residual = cast(Profile, deviation.residual).z
    high, low = int(np.nanargmax(residual)), int(np.nanargmin(residual))
    weights[high] += 1.0
    weights[low] -= 1.0
    run = float(curve.x[high] - curve.x[low])
    if deviation.reference == "EP":
        first, last = valid[0], valid[-1]
        share = run / float(curve.x[last] - curve.x[first])
        weights[last] -= share
        weights[first] += share
        return weights
    centred = curve.x[valid] - curve.x[valid].mean()
    weights[valid] -= run * centred / float(centred @ centred)
    return weights


def _messages(curve: Profile, sd: float | None) -> tuple[str, ...]:
    said = []
    if curve.n_invalid:
        said.append(f"{curve.n_invalid} of {len(curve)} samples were not measured: left out")
    if sd is None:
        said.append("no standard uncertainty: pass sd= of one deviation (from repeated runs)")
    said.append("the form of the reference artefact is in the value: reverse it or subtract it")
    return tuple(said)
