"""Straightness of a motion after ISO 230-1: minimum zone, least squares and end points together.

error = actual - nominal, positive away from the material; the slope is the alignment of the
reference and no straightness error.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any, ClassVar, Literal, cast

import numpy as np
from numpy.typing import ArrayLike, NDArray

from metrosep.core._arrays import FloatArray, frozen_float
from metrosep.core.errors import DataError, InvalidSamplesError
from metrosep.core.methods import Readings
from metrosep.core.numbers import choice, count, not_negative
from metrosep.core.options import Option
from metrosep.core.profile import Profile
from metrosep.core.provenance import Step
from metrosep.core.quantity import Quantity
from metrosep.parameters.deviation import form_deviation
from metrosep.parameters.form_result import FormDeviation
from metrosep.separation._readings import (
    as_numbers,
    average_repeats,
    checked_readings,
    known_parts,
    left_share,
    line_basis,
    part_of,
    unit_message,
)
from metrosep.separation.contract import (
    History,
    NamedMethod,
    Parts,
    RecordedMethod,
    Separation,
    StoredResult,
    Unobservable,
    over_line,
)

if TYPE_CHECKING:
    import pandas as pd

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
class MotionStraightness(StoredResult):
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

    _stored: ClassVar[tuple[str, ...]] = (
        "reference", "values", "slopes", "bias", "x", "residual", "audit", "messages", "deviations",
    )  # fmt: skip

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
        """Return a row per line: ``straightness_um``, ``u_um``, ``slope_urad``, ``chosen``."""
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
    seed : int, optional
        Of the simulation behind u and bias.

    Returns
    -------
    MotionStraightness
        ``value``, ``u``, ``residual`` of the chosen line; ``values["MZ"]``, ``["LS"]``, ``["EP"]``.

    Raises
    ------
    DataError
        If `reference` is none of the three, `sd` is not a number or negative, `seed` is not a whole
        number, or `z` is missing or superfluous.
    InvalidSamplesError
        If positions and deviations differ in length or are not numbers.
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
    sd = None if sd is None else not_negative(sd, "sd", dimension="length")
    seed = count(seed, "seed", least=0)
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
        deviations=deviations,
        values=values,
        slopes={k: d.reference_parameters["slope"] for k, d in deviations.items()},
        audit={
            "reference": reference,
            "n_samples": len(curve),
            "n_not_measured": curve.n_invalid,
            "travel_mm": float(np.ptp(curve.x)) * 1e3,
            "sd_nm": None if sd is None else sd * 1e9,
            "bias_nm": None if sd is None else {k: b * 1e9 for k, (_, b) in noise.items()},
        },
        messages=_messages(curve, sd, noise, reference),
        bias={k: b for k, (_, b) in noise.items()},
    )


def _as_profile(profile: Profile | ArrayLike, z: ArrayLike | None) -> Profile:
    if isinstance(profile, Profile):
        if z is not None:
            raise DataError("a Profile holds its own deviations: leave z out")
        profile.require_metres()
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
            values[key].append(_range(key, x, residual + noise))
    found = {}
    for key, parts in values.items():
        every = np.concatenate(parts)
        bias = float(every.mean()) - deviations[key].value
        found[key] = (float(every.std(ddof=1)), bias)
    return found


def _width(z: FloatArray) -> FloatArray:
    return np.asarray(z.max(axis=1) - z.min(axis=1))


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


def _range(key: str, x: FloatArray, z: FloatArray) -> FloatArray:
    """Return the straightness of rows from a reference line."""
    if key == "MZ":
        return _minimum_zone_range(x, z)
    slope = z @ x / float(x @ x) if key == "LS" else (z[:, -1] - z[:, 0]) / (x[-1] - x[0])
    return _width(z - slope[:, None] * x)


def _messages(
    curve: Profile,
    sd: float | None,
    noise: Mapping[str, tuple[float, float]],
    reference: str,
) -> tuple[str, ...]:
    said = []
    if curve.n_invalid:
        said.append(f"{curve.n_invalid} of {len(curve)} samples were not measured: omitted")
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


# ---- `ReferenceLine`: runs along a reference separated into its alignment and straightness error ----
# ``reading_r(x) = straightness(x) + reference(x) + a_r + b_r x``; error = actual - nominal, positive
# away from the material. The line is how the reference lies (ISO 230-1).

_LINE = "offset and slope are how the reference lies; measure the alignment otherwise"
_FORM = "the form of the reference reads like the axis: reverse it (straightedge_reversal)"


class StraightnessTest(NamedMethod):
    """`straightness_iso230_1` by its name."""

    name = "straightness_iso230_1"
    what = "straightness of a motion from three reference lines, ISO 230-1"
    readings = ("deviation",)
    over = "x"
    arguments: ClassVar[Mapping[str, Option]] = {
        "reference": Option(
            "text",
            choices=("MZ", "LS", "EP"),
            help="line that is judged: minimum zone, least squares, end points",
        ),
        "sd": Option(
            "uncertainty",
            help="standard uncertainty of one deviation, independent from point to point: the standard"
            " deviation of one reading over the root of the number of runs averaged",
        ),
    }

    @classmethod
    def from_inputs(cls, data: Readings, options: Mapping[str, Any]) -> MotionStraightness:
        """Return the straightness of one reading over x; the scatter of repeats gives the sd of the mean.

        A run that lies higher or askew adds a line to the mean, and lines are not straightness: the
        scatter is that about a line of its own for each run.
        """
        x, repeats = over_line(data), data.values[0]
        if len(data.values) != 1:
            raise InvalidSamplesError(
                f"one reading over x is needed, got {len(data.values)} ({', '.join(data.names)})"
            )
        rest, mean = dict(options), repeats[0]
        if len(repeats) > 1:
            mean = repeats.mean(axis=0)
            common = np.isfinite(mean)
            freedom = (len(repeats) - 1) * (int(common.sum()) - 2)
            if freedom > 0:
                line = np.vander(x[common] - x[common].mean(), 2)
                left = (repeats - mean)[:, common].T
                left = left - line @ np.linalg.lstsq(line, left, rcond=None)[0]
                scatter = float(np.sum(left**2)) / freedom
                rest.setdefault("sd", math.sqrt(scatter / len(repeats)))
        return straightness_iso230_1(x, mean, **rest)


@dataclass(frozen=True, slots=True)
class ReferenceLine(RecordedMethod):
    """Runs along a straightedge, a wire or a beam, at the same positions.

    Readings (M, n) in m: runs. Parts (n,): ``straightness`` error of the axis; ``reference``, form
    of the reference in the sense of the reading, NaN: it is not seen.

    Parameters
    ----------
    x : tuple of float, m
        At least 4 positions, rising.
    line : {"LS", "EP"}, optional
        From which line: least squares or end points. The minimum zone gives one number, not a
        curve that is linear in the readings: it is in the audit.

    Raises
    ------
    DataError
        If the line is neither.
    InvalidSamplesError
        If the positions are not finite and rising.
    TooFewSamplesError
        If there are fewer than 4.

    Notes
    -----
    `straightness_iso230_1` does the work on the mean of the runs, and gives each value its
    uncertainty and bias; the values of all three lines are in the audit. Noise s of M runs:
    ``u = s sqrt((1 - h)/M)``, h the leverage of the line; from end points
    ``s sqrt((1 + t^2 + (1 - t)^2)/M)``, t = 0 ... 1 between them, where u is 0 by definition.

    Examples
    --------
    >>> found = ReferenceLine((0.0, 0.1, 0.2, 0.3), "EP").separate([[0.0, 3e-6, 3e-6, 3e-6]])
    >>> (found.straightness * 1e6).round(6).tolist()
    [0.0, 2.0, 1.0, 0.0]
    """

    x: tuple[float, ...]
    line: Literal["LS", "EP"] = "LS"

    name = "reference_line"
    truth_parts = ("reference",)
    error_parts = ("straightness",)

    def __post_init__(self) -> None:
        x = frozen_float(self.x, name="x", ndim=1, min_size=4)
        if not (np.isfinite(x).all() and (np.diff(x) > 0.0).all()):
            raise InvalidSamplesError(f"{self.name}: positions must be finite and rising, in m")
        choice(self.line, "line", ("LS", "EP"))

    def simulate(self, truth: Parts, errors: Parts) -> FloatArray:
        parts = known_parts(self, truth, errors)
        shape = (len(self.x),)
        both = [part_of(parts, n, shape, self.name) for n in ("straightness", "reference")]
        return np.asarray(both[0] + both[1])[np.newaxis]

    def null_space(self) -> tuple[Unobservable, ...]:
        return (
            Unobservable("straightness", "polynomial", (0, 1), _LINE),
            Unobservable("reference", "term", ("all of it",), _FORM),
        )

    def _solved(self, readings: ArrayLike, stated: float | None, history: History) -> Separation:
        array = as_numbers(readings, f"{self.name} needs runs (M, n) as numbers")
        if array.ndim != 2 or array.shape[1] != len(self.x):
            raise InvalidSamplesError(
                f"{self.name} needs runs at the {len(self.x)} positions, shape (M, {len(self.x)}), "
                f"got {array.shape}"
            )
        array = checked_readings(array[np.newaxis], names=("runs",), minimum=4, what=self.name)
        x = np.array(self.x)
        averaged = average_repeats(array, line_basis(x), u_reading=stated)
        mean, runs = averaged.mean[0], averaged.counts[0]
        sheet = straightness_iso230_1(x, mean, reference=self.line)
        valid = ~np.isnan(mean)
        share = left_share(valid, line_basis(x))
        if self.line == "EP":
            share = _end_point_share(x, valid, runs)
        else:
            share = share / np.maximum(runs, 1.0)
        unknown = np.full(x.size, np.nan)
        return Separation(
            self.name,
            {"straightness": sheet.residual, "reference": unknown},
            {"straightness": averaged.noise.value * np.sqrt(share), "reference": unknown},
            {"straightness": "m", "reference": "m"},
            {"x": x},
            self.null_space(),
            noise=averaged.noise,
            audit=_audit(sheet, averaged.n_repeats),
            messages=(
                *averaged.messages,
                *unit_message(array, self.name),
                *(m for m in sheet.messages if "sd=" not in m),
            ),
            history=(*history, Step(self.name, {"line": self.line})),
        )


def _end_point_share(x: FloatArray, valid: NDArray[np.bool_], count: FloatArray) -> FloatArray:
    """Return the variance of each deviation from the line through both ends, per unit noise."""
    first, last = np.flatnonzero(valid)[[0, -1]]
    t = (x - x[first]) / (x[last] - x[first])
    own = 1.0 / np.maximum(count, 1.0)
    share = own + (1.0 - t) ** 2 * own[first] + t**2 * own[last]
    share[[first, last]] = 0.0
    return np.where(valid, share, np.nan)


def _audit(sheet: MotionStraightness, n_runs: int) -> dict[str, Any]:
    return {
        "n_repeats": n_runs,
        "line": sheet.reference,
        "travel_mm": sheet.audit["travel_mm"],
        "n_not_measured": sheet.audit["n_not_measured"],
        **{f"STR_{key}_um": q.value * 1e6 for key, q in sheet.values.items()},
        "slope_urad": sheet.slopes[sheet.reference].value * 1e6,
    }
