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
from numpy.typing import ArrayLike

from metrosep.core._arrays import FloatArray, frozen_float
from metrosep.core.errors import DataError, InvalidSamplesError
from metrosep.core.profile import Profile
from metrosep.core.provenance import freeze_mapping
from metrosep.core.quantity import Quantity
from metrosep.parameters.deviation import form_deviation
from metrosep.parameters.form_result import FormDeviation
from metrosep.separation._checked_numbers import checked_sd, checked_seed
from metrosep.separation._result_values import plain, reduced

if TYPE_CHECKING:
    import pandas as pd

__all__ = ["MotionStraightness", "straightness_iso230_1"]

Line = Literal["MZ", "LS", "EP"]

_MOST_DRAWS, _FEWEST_DRAWS, _CHUNK, _BUDGET = 1000, 100, 100, 2e6
"""Of the simulation; the budget is samples times draws."""

_NOTABLE = 0.25
"""A bias of this share of u is worth a sentence; the simulation finds it to 0.03 u."""

_GOLDEN = (math.sqrt(5.0) - 1.0) / 2.0
_SECTIONS = 34
"""Golden sections: the slope to 1e-7 of its range."""

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
    bias : mapping of str to float, m
        How much noise of `sd` raises the value of each line on the average; NaN without `sd`.
    """

    reference: Line
    deviations: Mapping[str, FormDeviation]
    values: Mapping[str, Quantity]
    slopes: Mapping[str, Quantity]
    audit: Mapping[str, Any] = field(default_factory=dict)
    messages: tuple[str, ...] = ()
    bias: Mapping[str, float] = field(default_factory=dict)

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

    def to_dict(self) -> dict[str, Any]:
        """Return plain values for JSON, SI, NaN as None.

        Returns
        -------
        dict
            ``reference``, ``values``, ``slopes``, ``bias``, ``deviations`` by line; ``x`` and
            ``residual`` of the chosen one; ``audit``, ``messages``.
        """
        lines = {key: d.to_dict() for key, d in self.deviations.items()}
        names = ("reference", "values", "slopes", "bias", "x", "residual", "audit", "messages")
        found: dict[str, Any] = plain({name: getattr(self, name) for name in names})
        return {**found, "deviations": plain(lines)}

    def __reduce__(self) -> tuple[Any, ...]:
        return reduced(self)

    def __repr__(self) -> str:
        each = ", ".join(f"{key} {q}" for key, q in self.values.items())
        return f"MotionStraightness({self.reference}: {self.quantity}; {each})"


def straightness_iso230_1(
    profile: Profile | ArrayLike,
    z: ArrayLike | None = None,
    *,
    reference: Line = "MZ",
    sd: float | None = None,
    seed: int = 0,
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
    seed : int, optional
        Of the simulation behind u and bias.

    Returns
    -------
    MotionStraightness
        ``value``, ``u``, ``residual`` of the chosen line; ``values["MZ"]``, ``["LS"]``, ``["EP"]``.

    Raises
    ------
    DataError
        If `reference` is none of the three, `sd` is no number or negative, `seed` is no whole
        number, or `z` is missing or superfluous.
    InvalidSamplesError
        If positions and deviations differ in length or are no numbers.
    TooFewSamplesError
        If fewer than three samples are valid.

    Notes
    -----
    The zone is measured along z, as ISO 230-1 does. The minimum zone is exact: two parallel lines
    through an edge of the convex hull and the point opposite to it; never larger than the others.
    u and `bias`: up to 1000 simulated copies with a second dose of the noise. As the largest of
    many noisy points the value is too large; `bias` is what a second dose adds, the first one has
    added as much or more. It is not taken off: average runs or filter first.

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
    known = {key.lower(): key for key in _LINES}
    if str(reference).lower() not in known:
        raise DataError(f"reference is 'MZ', 'LS' or 'EP', got {reference!r}")
    reference = known[str(reference).lower()]
    sd, seed = checked_sd(sd, "m"), checked_seed(seed)
    curve = _as_profile(profile, z)
    deviations: dict[str, FormDeviation] = {
        key: form_deviation(curve, kind="straightness", reference=key) for key in _LINES
    }
    noise = _simulated(curve, deviations, sd, seed)
    values: dict[str, Quantity] = {
        key: Quantity(
            d.value,
            "m",
            f"{d.quantity.definition}, straightness of a motion, ISO 230-1:2012",
            u=None if sd is None else noise[key][0],
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
                "bias_nm": None if sd is None else {k: b * 1e9 for k, (_, b) in noise.items()},
            }
        ),
        messages=_messages(curve, sd, noise, reference),
        bias=freeze_mapping({k: b for k, (_, b) in noise.items()}),
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


def _simulated(
    curve: Profile, deviations: Mapping[str, FormDeviation], sd: float | None, seed: int
) -> dict[str, tuple[float, float]]:
    """Return standard uncertainty and bias of each line by a second dose of noise."""
    if sd is None:
        return dict.fromkeys(deviations, (math.nan, math.nan))
    if sd == 0.0:
        return dict.fromkeys(deviations, (0.0, 0.0))
    valid = ~np.isnan(curve.z)
    x = curve.x[valid] - curve.x[valid].mean()
    rng = np.random.default_rng(seed)
    draws = int(min(max(_BUDGET / x.size, _FEWEST_DRAWS), _MOST_DRAWS))
    values: dict[str, list[FloatArray]] = {key: [] for key in deviations}
    for start in range(0, draws, _CHUNK):
        noise = sd * rng.standard_normal((min(_CHUNK, draws - start), x.size))
        for key, deviation in deviations.items():
            residual = cast(Profile, deviation.residual).z[valid]
            values[key].append(_RANGES[key](x, residual + noise))
    found = {}
    for key, parts in values.items():
        every = np.concatenate(parts)
        bias = float(every.mean()) - deviations[key].value
        found[key] = (float(every.std(ddof=1)), bias)
    return found


def _width(z: FloatArray) -> FloatArray:
    return np.asarray(z.max(axis=1) - z.min(axis=1))


def _least_squares_range(x: FloatArray, z: FloatArray) -> FloatArray:
    slope = z @ x / float(x @ x)
    return _width(z - slope[:, None] * x)


def _end_point_range(x: FloatArray, z: FloatArray) -> FloatArray:
    slope = (z[:, -1] - z[:, 0]) / (x[-1] - x[0])
    return _width(z - slope[:, None] * x)


def _minimum_zone_range(x: FloatArray, z: FloatArray) -> FloatArray:
    """Return the least width over the slope, which is a convex function of it: golden section."""
    reach = 2.0 * _width(z) / float(np.ptp(x))
    low, high = -reach, reach
    inner, outer = high - _GOLDEN * (high - low), low + _GOLDEN * (high - low)
    at_inner, at_outer = (_width(z - s[:, None] * x) for s in (inner, outer))
    for _ in range(_SECTIONS):
        left = at_inner < at_outer
        low, high = np.where(left, low, inner), np.where(left, outer, high)
        fresh = np.where(left, high - _GOLDEN * (high - low), low + _GOLDEN * (high - low))
        width = _width(z - fresh[:, None] * x)
        inner, outer = np.where(left, fresh, outer), np.where(left, inner, fresh)
        at_inner, at_outer = np.where(left, width, at_outer), np.where(left, at_inner, width)
    return np.minimum(at_inner, at_outer)


_RANGES = {"MZ": _minimum_zone_range, "LS": _least_squares_range, "EP": _end_point_range}


def _messages(
    curve: Profile,
    sd: float | None,
    noise: Mapping[str, tuple[float, float]],
    reference: str,
) -> tuple[str, ...]:
    said = []
    if curve.n_invalid:
        said.append(f"{curve.n_invalid} of {len(curve)} samples were not measured: left out")
    u, bias = noise[reference]
    if bias > _NOTABLE * u:
        said.append(
            f"{reference} is a largest minus smallest value, which noise pushes outwards: it is too "
            f"large by about {bias * 1e9:.2g} nm or more; u does not hold that. Average runs or "
            "filter before"
        )
    if sd is None:
        said.append("no standard uncertainty: pass sd= of one deviation (from repeated runs)")
    said.append("the form of the reference artefact is in the value: reverse it or subtract it")
    return tuple(said)
