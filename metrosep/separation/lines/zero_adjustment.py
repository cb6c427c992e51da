"""The zero difference of three probes: from a reversal, a known flat, or an angle sensor.

``delta = e1 - 2 e2 + e3`` (``e1 - (1 + r) e2 + r e3`` at distances d1 = r d2) stays in the second
differences at every position and bends the artefact into a parabola of sag ``delta (L/d)^2 / 8``.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np
from numpy.typing import ArrayLike

from metrosep.core._arrays import FloatArray, as_float
from metrosep.core.errors import DataError, InvalidSamplesError, TooFewSamplesError
from metrosep.core.methods import Readings
from metrosep.core.numbers import flag, not_negative
from metrosep.core.options import Option
from metrosep.core.provenance import Step, freeze_mapping
from metrosep.separation._readings import checked_readings, known_parts
from metrosep.separation.contract import (
    U_READING,
    History,
    NamedMethod,
    Parts,
    RecordedMethod,
    Separation,
    Unobservable,
    as_rows,
    as_stated,
    settle,
    type_a,
)
from metrosep.separation.lines._line_problem import ZeroCalibration, distances

_PROBES = ("trailing probe", "middle probe", "leading probe")


def zero_calibration(
    m: ArrayLike,
    distance: float | tuple[float, float],
    *,
    reversed_m: ArrayLike | None = None,
    flat: ArrayLike | None = None,
    u_flat: float = 0.0,
    pitch: ArrayLike | None = None,
    u_pitch: float | None = None,
    step: float | None = None,
    u_reading: float | None = None,
) -> ZeroCalibration:
    """Return the zero difference of three probes from one of three calibrations.

    Parameters
    ----------
    m : array_like, shape (3, n) or (3, R, n), m
        Readings of the trailing, middle and leading probe.
    distance : float or tuple of (float, float), m
        Between neighbouring probes.
    reversed_m : array_like, like `m`, m, optional
        The same artefact, turned about its long axis, at the same positions, the probes set to
        its other side without a new adjustment.
    flat : array_like, shape (3, n) or (3,), or 0.0, m, optional
        Known form of a flat under each probe at each reading; 0.0 for a perfect flat. Its flatness
        is `u_flat`, not a height.
    pitch : array_like, shape (n,), rad, optional
        Readings of an angle sensor, positive where the leading end reads more; with `u_pitch`,
        `step` and `u_reading` (or repeats).
    u_pitch, step, u_reading : float, rad, m, m, optional
        Standard uncertainty of one angle; step between the positions; standard uncertainty of one
        reading.

    Returns
    -------
    ZeroCalibration
        For `three_point`, as ``zero_cal``.

    Raises
    ------
    DataError
        If not exactly one of `reversed_m`, `flat`, `pitch` is given, or they do not fit.
    TooFewSamplesError
        If one reading leaves no scatter and `u_reading` is not given.
    NotSeparableError
        If the pitch runs opposite to that of the probes.

    Notes
    -----
    Reversal: the second differences are ``f'' + delta`` and ``-f'' + delta``; delta is the mean of
    their half sums, noise ``s sqrt(6 / (2 n))``. Flat: the mean of ``m1 - 2 m2 + m3`` minus that of
    the flat, ``s sqrt(6 / n)`` and `u_flat`. Positions
    count by their passes. Pitch: `three_point` by generalised least squares with
    free zeros. NaN positions are omitted.

    References
    ----------
    W. Gao, J. Yokoyama, H. Kojima, S. Kiyono, Precision measurement of cylinder straightness using
    a scanning multi-probe system, Precis. Eng. 26 (2002) 279-288.

    Examples
    --------
    >>> import numpy as np
    >>> form = 1e-9 * np.array([[3.0, 1.0], [1.0, -4.0], [-4.0, 0.0]])
    >>> zeros = 1e-9 * np.array([[2.0], [0.0], [3.0]])
    >>> found = zero_calibration(form + zeros, 10e-3, reversed_m=-form + zeros)
    >>> round(found.zero * 1e9, 9)
    5.0
    """
    for value, name, dimension in (
        (step, "step", "length"),
        (u_pitch, "u_pitch", "angle"),
        (u_flat, "u_flat", "length"),
    ):
        if value is not None:
            not_negative(value, name, dimension=dimension)
    given = [reversed_m is not None, flat is not None, pitch is not None]
    if sum(given) != 1:
        raise DataError(
            "zero_calibration needs exactly one of reversed_m (a reversal), flat (a known form) and "
            f"pitch (an angle sensor), got {sum(given)}"
        )
    if pitch is not None:
        from metrosep.separation.lines.three_points import three_point

        found = three_point(
            m,
            distance,
            step=step,
            method="least_squares",
            u_reading=u_reading,
            pitch=pitch,
            u_pitch=u_pitch,
        )
        zero, u = float(found.parts["zero"]), float(found.u["zero"])
        return ZeroCalibration(zero, u, distances(distance), "pitch", found.audit, found.messages)
    d, w = distances(distance), _weights(distance)
    first, count = _differences(m, w)
    if reversed_m is not None:
        second, other = _differences(reversed_m, w)
        if second.shape != first.shape:
            raise DataError(
                f"the two readings of the reversal have {first.size} and {second.size} values; they "
                "must lie at the same positions of the artefact"
            )
        both = count * other / np.maximum(count + other, 1.0)
        return _mean((first + second) / 2.0, both, d, "reversal", w, u_reading, 2.0, 0.0)
    known = np.broadcast_to(_flat_differences(flat, w, first.size), first.shape)
    u_known = not_negative(u_flat, "u_flat", dimension="length")
    return _mean(first - known, count, d, "flat", w, u_reading, 1.0, u_known)


def _weights(distance: float | tuple[float, float]) -> FloatArray:
    """Return the combination of three readings that cancels straightness and pitch."""
    first, second = distances(distance)
    ratio = first / second
    return np.array([1.0, -(1.0 + ratio), ratio])


class ZeroTest(NamedMethod):
    """`zero_calibration` by its name: three probes over a flat, or before and after a reversal."""

    name = "zero_calibration"
    what = "zero difference of three probes, from a flat, a reversal or an angle sensor"
    over = "x"
    roles: ClassVar[Mapping[str, str]] = {"pitch": "angle?"}
    arguments: ClassVar[Mapping[str, Option]] = {
        **U_READING,
        "distance": Option(
            "lengths",
            required=True,
            help="between neighbouring probes, two values where they differ",
        ),
        "u_flat": Option(
            "uncertainty",
            help="standard uncertainty of the known second difference of the flat; it does not average"
            " out",
        ),
        "step": Option("size", help="between the positions of the carriage"),
        "u_pitch": Option("angle", help="standard uncertainty of one reading of the pitch"),
    }

    @classmethod
    def from_inputs(cls, data: Readings, options: Mapping[str, Any]) -> ZeroCalibration:
        """Return the zero difference; readings 4 to 6 are those of the reversed probes."""
        from metrosep.separation.lines._line_result import one_or_two

        rest = {**options, "distance": one_or_two(options["distance"])}
        if "pitch" in data.extra:
            rest["pitch"] = data.extra["pitch"].mean(axis=0)
        readings = as_rows(data.values)
        if len(readings) == 6:
            rest["reversed_m"] = readings[3:]
        elif len(readings) == 3 and "pitch" not in rest:
            rest["flat"] = 0.0
        elif len(readings) != 3:
            raise InvalidSamplesError(
                "3 readings over a flat are needed, or 6: 3 as they are and 3 reversed; got "
                f"{len(readings)}"
            )
        return zero_calibration(readings[:3], **rest)


def _differences(m: ArrayLike, weights: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return the second difference at each position, mean over the passes, and how many they are.

    A pass in which a probe is missing does not count there: its carriage would not cancel.
    """
    array = checked_readings(m, names=_PROBES, minimum=1, what="zero_calibration")
    d = np.tensordot(weights, array, axes=1)
    count = (~np.isnan(d)).sum(axis=0).astype(np.float64)
    total = np.where(np.isnan(d), 0.0, d).sum(axis=0)
    return np.where(count > 0, total / np.maximum(count, 1.0), np.nan), count


def _flat_differences(flat: Any, weights: FloatArray, n: int) -> FloatArray:
    try:
        form = as_float(flat)
    except (TypeError, ValueError):
        raise DataError("flat must be the known form in m") from None
    if np.isinf(form).any() or np.isnan(form).all():
        raise DataError("flat must be the known form in m: finite, NaN where it is not known")
    if form.ndim == 0:
        if float(form) != 0.0:
            raise DataError(
                f"flat is one height, {float(form):.6g} m, and a height has no second difference: "
                "flat=0.0 is a perfect flat, u_flat its flatness as a standard uncertainty"
            )
        return np.zeros(n)
    if form.shape not in ((3,), (3, n)):
        raise DataError(
            f"flat has the shape {form.shape}; give the known form under each probe, (3,) or (3, {n})"
        )
    known = np.asarray(weights @ (form[:, None] if form.ndim == 1 else form))
    if np.isnan(known).all():
        raise DataError(
            "flat is nowhere known under all three probes (NaN): nothing is calibrated"
        )
    return known


def _mean(
    values: FloatArray,
    count: FloatArray,
    d: tuple[float, float],
    source: str,
    weights: FloatArray,
    u_reading: float | None,
    n_sets: float,
    u_more: float,
) -> ZeroCalibration:
    """Return the mean over positions, weighed by the passes behind each."""
    used = ~np.isnan(values) & (count > 0)
    known, share = values[used], count[used]
    if known.size == 0:
        raise TooFewSamplesError(
            "zero_calibration: at no position were all probes measured in all readings"
        )
    zero = float(share @ known / share.sum())
    if u_reading is not None:
        stated = not_negative(u_reading, "u_reading", dimension="length")
        one, kind = stated * float(np.linalg.norm(weights)) / n_sets, "stated"
    elif known.size > 1:
        one = math.sqrt(float(share @ (known - zero) ** 2) / (known.size - 1))
        kind = "scatter of the positions (type A)"
    else:
        raise TooFewSamplesError(
            "zero_calibration: one position shows no scatter; measure at several, or give u_reading"
        )
    u = math.hypot(one / math.sqrt(float(share.sum())), u_more)
    messages: tuple[str, ...] = ()
    if source == "flat" and u_more == 0.0:
        messages = (
            "u_flat is 0: the flat counts as perfect; its own sag goes into every artefact measured",
        )
    audit = {"n_positions": int(known.size), "noise_from": kind, "u_flat_nm": u_more * 1e9}
    return ZeroCalibration(zero, u, d, source, freeze_mapping(audit), messages)


# ---- `ZeroAdjustment`: the zero difference of three probes separated from the bend of an artefact ----
# ``d(x) = m1 - (1 + r) m2 + r m3 = bend(x) + zero``; in the reversal ``-bend(x) + zero``. Straightness and
# pitch of the carriage drop out of d.

_CHANGES = (
    "a zero that changes with the reversal looks like bend: turn back and repeat the first set-up"
)
_FLAT = "the mean bend is taken as that of a perfect flat: reverse it to see its own"


@dataclass(frozen=True, slots=True)
class ZeroAdjustment(RecordedMethod):
    """Three probes on an artefact and on its reversal, or on a flat.

    Readings (6, n) in m: the probes, then the probes on the reversed artefact; (3, n) on a flat.
    Parts: ``bend``, (n,), second difference of the artefact at each position; ``zero``, one number,
    the difference of the probes. Where parts are simulated, both are spread over the probes in
    proportion to their weights, and the carriage is straight.

    Parameters
    ----------
    distance : float or tuple of (float, float), m
        Between neighbouring probes.
    flat : bool, optional
        Whether the artefact counts as flat; if not, it is measured again turned about its long
        axis. A form that is known, and a calibration by an angle sensor: `zero_calibration`.
    u_flat : float, m, optional
        Standard uncertainty of the mean second difference of the flat.

    Raises
    ------
    DataError
        If a distance is not above zero or `u_flat` negative.

    Notes
    -----
    `zero_calibration` does the work. With noise s of a reading and equal distances:
    ``s sqrt(6/(2 n M))`` for the zero from a reversal, ``s sqrt(6/(n M))`` and `u_flat` from a flat.

    Examples
    --------
    >>> method = ZeroAdjustment(10e-3)
    >>> readings = method.simulate({"bend": [1e-9, -2e-9]}, {"zero": 5e-9})
    >>> found = method.separate(readings)
    >>> round(float(found.zero) * 1e9, 6), (found.bend * 1e9).round(6).tolist()
    (5.0, [1.0, -2.0])
    """

    distance: float | tuple[float, float]
    flat: bool = False
    u_flat: float = 0.0

    name = "zero_adjustment"
    truth_parts = ("bend",)
    error_parts = ("zero",)

    def __post_init__(self) -> None:
        d = distances(self.distance)
        settle(
            self,
            distance=d if np.ndim(self.distance) else d[0],
            flat=flag(self.flat, "flat"),
            u_flat=not_negative(self.u_flat, "u_flat", dimension="length"),
        )

    def simulate(self, truth: Parts, errors: Parts) -> FloatArray:
        parts = known_parts(self, truth, errors)
        zero, bend = parts.get("zero", np.zeros(())), parts.get("bend", np.zeros(1))
        w = _weights(self.distance)
        w = w / float(w @ w)
        first = np.multiply.outer(w, bend + zero)
        return first if self.flat else np.concatenate([first, np.multiply.outer(w, zero - bend)])

    def null_space(self) -> tuple[Unobservable, ...]:
        if self.flat:
            return (Unobservable("bend", "term", ("mean",), _FLAT),)
        return (Unobservable("bend", "term", ("change of the zero",), _CHANGES),)

    def _solved(self, readings: ArrayLike, stated: float | None, history: History) -> Separation:
        again = () if self.flat else tuple(f"{p} reversed" for p in _PROBES)
        array = checked_readings(readings, names=(*_PROBES, *again), minimum=1, what=self.name)
        turned = None if self.flat else array[3:]
        found = zero_calibration(
            array[:3],
            self.distance,
            reversed_m=turned,
            flat=0.0 if self.flat else None,
            u_flat=self.u_flat,
            u_reading=stated,
        )
        weights = _weights(self.distance)
        first, count = _differences(array[:3], weights)
        if turned is None:
            bend, own = first - found.zero, count
            inverse = 1.0 / np.maximum(count, 1.0) - 1.0 / count.sum()
        else:
            second, other = _differences(turned, weights)
            bend = (first - second) / 2.0
            own = np.where(
                (count > 0) & (other > 0), count * other / (count + other + 1e-300), 0.0
            )
            inverse = 0.25 / np.where(own > 0, own, np.nan)
        w = float(np.linalg.norm(weights))
        n_sets = 1.0 if self.flat else 2.0
        random = math.sqrt(max(found.u**2 - (self.u_flat**2 if self.flat else 0.0), 0.0))
        s = random * math.sqrt(float(own.sum())) * n_sets / w if stated is None else stated
        n = found.audit["n_positions"]
        text = f"standard deviation of one reading, from {n} positions (type A)"
        noise = type_a(s, "m", text, n - 1) if stated is None else as_stated(stated, "m")
        u_bend = np.where(np.isnan(bend), np.nan, s * w * np.sqrt(inverse))
        return Separation(
            self.name,
            {"zero": np.array(found.zero), "bend": bend},
            {"zero": np.array(found.u), "bend": u_bend},
            {"zero": "m", "bend": "m"},
            {},
            self.null_space(),
            noise=noise,
            audit={**found.audit, "source": found.source, "n_repeats": int(array.shape[1])},
            messages=found.messages,
            history=(*history, Step(self.name, {"distance_m": list(distances(self.distance))})),
        )
