"""Multi-step roundness: the artefact is indexed on the spindle, the probe stays.

Model: ``m_p(theta) = r(theta + t alpha_p) + s(theta)``: r the artefact over its own angle, s what
the spindle adds in the direction of the probe, alpha_p the index position, t the turn: +1 when an
index step brings points of larger artefact angle to the probe.

With N equal steps the mean over the steps keeps the spindle and, of the artefact, the undulations
that are multiples of N: those are not separable, exactly those, and are NaN. Two runs of coprime
N1 and N2 together separate all undulations up to N1 N2 - 1. The mean (k = 0) is never separable.

Source: D. J. Whitehouse, J. Phys. E 9 (1976) 531; C. J. Evans et al., CIRP Annals 45 (1996) 617.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, ClassVar, Literal, NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from metrosep.core._arrays import ComplexArray, FloatArray
from metrosep.core.docs import described_by
from metrosep.core.errors import DataError, NotSeparableError, TooFewSamplesError
from metrosep.core.numbers import choice, count, is_real, positive, real
from metrosep.core.options import Option, option
from metrosep.core.provenance import Step
from metrosep.core.quantity import Quantity
from metrosep.separation._readings import unit_message
from metrosep.separation.circles._circle import (
    CircleMethod,
    Revolutions,
    Terms,
    angle_tuple,
    centred,
    check_sign,
    check_small_angle,
    circle_readings,
    harmonics_of,
    hidden_message,
    hidden_of,
    reading_noise,
    turned,
    u_of_curves,
    unseen,
    variances,
)
from metrosep.separation.contract import (
    U_READING,
    Parts,
    Separation,
    Unobservable,
    settle,
    suppressed_harmonics,
)


@dataclass(frozen=True)
class MultistepRoundness(CircleMethod):
    """An artefact indexed to several angles on a spindle.

    Readings: one row for each index position, in m. Parts: ``artefact``, radius deviation over its
    own angle; ``spindle``, what the spindle adds, over its angle. Noise that is not stated comes
    from what more than two positions disagree by, else from the revolutions.

    Parameters
    ----------
    angles : sequence of float, shape (P,), P >= 2, rad
        Index positions, in the order of the readings.
    eccentricity : {"fixed", "free"}, optional
        ``"fixed"``: the artefact keeps its place on the index table, so k = 1 is separated like
        any other; ``"free"``: it was centred anew at each step, and k = 1 is omitted.
    drift : {"none", "linear"}, optional
        ``"linear"``: a drift of the level in proportion to time, found from the means of
        consecutive revolutions, is taken off first.
    max_gain : float, optional
        An undulation whose noise is magnified more than this is called suppressed.

    Raises
    ------
    TooFewSamplesError, InvalidSamplesError
        If there are fewer than 2 angles, or they are not finite.
    UnitError
        If the angles or `u_index` look like degrees.
    DataError
        If another setting is out of range.
    NotSeparableError
        If the positions separate no undulation.

    Examples
    --------
    >>> method = MultistepRoundness(2 * np.pi * np.arange(8) / 8, 30)
    >>> [item.indices for item in method.null_space() if item.part == "artefact"][1]
    (8, 16, 24)
    """

    angles: Any = option(
        kind="angles", required=False, help="index positions where they are not equal steps"
    )
    kmax: int = option(
        kind="integer",
        required=False,
        help="highest undulation per revolution, >= 2 and below half the samples",
    )
    u_index: float = option(
        0.0, kind="angle", help="standard uncertainty of each index position, independent (type B)"
    )
    eccentricity: Literal["fixed", "free"] = option(
        "fixed",
        kind="text",
        choices=("fixed", "free"),
        help="free: the artefact was centred anew at each step, and k = 1 is omitted",
    )
    drift: Literal["none", "linear"] = option(
        "none",
        kind="text",
        choices=("none", "linear"),
        help="linear: a drift of the level in proportion to time is taken off first",
    )
    step_revolutions: float | None = option(
        None,
        kind="number",
        help="time from one step to the next, in revolutions, for the drift; the number of "
        "revolutions that were recorded if omitted",
    )
    max_gain: float = 50.0
    turn: Literal[1, -1] = option(
        1,
        kind="integer",
        choices=(1, -1),
        help="1: a step brings points of larger artefact angle to the probe",
    )

    name = "multistep"
    what = "roundness of an artefact and error motion of a spindle from indexed set-ups"
    over = "angle"
    arguments: ClassVar[Mapping[str, Option]] = {
        **U_READING,
        "steps": Option(
            "integers",
            help="number of equal steps, several where runs follow one another; as many as there are "
            "readings if omitted",
        ),
    }
    truth_parts = ("artefact",)
    error_parts = ("spindle",)
    _sources: ClassVar[str] = "index positions"

    def __post_init__(self) -> None:
        steps = self.step_revolutions
        if steps is not None:
            steps = real(steps, "step_revolutions")
            if steps < 1.0:
                raise DataError(f"step_revolutions must be >= 1, got {steps}")
        settle(
            self,
            angles=angle_tuple(self.angles, least=2, what="index"),
            kmax=count(self.kmax, "kmax", least=2),
            u_index=check_small_angle(self.u_index, "u_index"),
            eccentricity=choice(self.eccentricity, "eccentricity", ("fixed", "free")),
            drift=choice(self.drift, "drift", ("none", "linear")),
            step_revolutions=steps,
            max_gain=positive(self.max_gain, "max_gain"),
            turn=check_sign(self.turn, "turn"),
        )
        if np.isinf(self.gain[2:]).all():
            raise NotSeparableError(
                f"these {len(self.angles)} index positions separate no undulation up to "
                f"{self.kmax}; are they all the same?"
            )

    @property
    def _n_sources(self) -> int:
        return len(self.angles)

    @property
    def gain(self) -> FloatArray:
        """Noise of the artefact harmonics 0 ... kmax over that of a reading's; inf: suppressed."""
        gain: FloatArray = _geometry(self).gain[0]
        return gain

    def simulate(self, truth: Parts, errors: Parts) -> FloatArray:
        parts = self._rows_of(truth, errors)
        out: FloatArray = turned(parts["artefact"], self.turn * np.array(self.angles))
        return out + parts["spindle"]

    def null_space(self) -> tuple[Unobservable, ...]:
        gain = self.gain
        terms: tuple[str, ...] = ("offset",)
        why = "the offset (k = 0) is the zero of the probe"
        if math.isinf(gain[1]):
            terms += ("eccentricity",)
            why += "; k = 1 is centring and spindle in one"
        alike = (
            "all index positions show these alike, so artefact and spindle cannot be separated; "
            "a second run with a coprime number of steps does it"
        )
        return tuple(
            item
            for part in self._parts
            for item in unseen(part, hidden_of(gain), alike, terms=terms, why=why)
        )

    def _separated(
        self, given: Revolutions, stated: float | None, start: float, history: tuple[Step, ...]
    ) -> Separation:
        array, rate, u_rate = _without_drift(self, given)
        positions, turns, n = array.shape
        geometry = _geometry(self)
        each = harmonics_of(array, self.kmax)
        mean = each.mean(axis=1)
        found: ComplexArray = np.einsum("akp,pk->ak", geometry.rows, mean)
        rest = mean - geometry.phase.T * found[0] - found[1]
        noise, u_k, from_steps = _noise(geometry, each, rest, stated, n)
        terms: Terms = {}
        if self.u_index > 0.0 and not from_steps:
            k = np.arange(self.kmax + 1)
            shown = 1j * self.turn * k * geometry.phase.T * found[0] * self.u_index
            moved = geometry.rows.transpose(0, 2, 1) * shown
            terms = {"index angles": variances(moved, n)}
        u_spindle = u_of_curves(u_k, terms, n)[1]
        hidden = suppressed_harmonics(self.null_space())
        seen = np.isfinite(found[0])
        angles_deg = np.rad2deg(self.angles).tolist()
        messages = [*given.messages, *unit_message(centred(given.values), self.name)]
        if math.isnan(noise.value):
            messages.append(
                "the noise is not known from two positions and one revolution: give u_reading or "
                "more steps or repeated revolutions; no uncertainty is stated"
            )
        messages += hidden_message(
            hidden, "alike at all index positions: NaN in harmonics, absent from the curves"
        )
        if from_steps and self.u_index > 0.0:
            messages.append(
                "the index errors show in what the positions disagree by, so u_index is not added "
                "to it"
            )
        messages += _drift_left(self, rate, u_rate, positions * turns - 2, u_spindle)
        messages += _wide_index(self)
        wrong = _other_turn(self, mean, rest)
        messages += wrong or _first_harmonic(self, rest, float(np.abs(mean).max()))
        power = np.sum(np.abs(rest[:, seen]) ** 2, axis=1)
        free = self.eccentricity == "free"
        return self._result(
            given,
            found,
            noise,
            u_k,
            terms,
            start=start,
            settings={"angles_deg": angles_deg, "turn": self.turn, "kmax": self.kmax},
            audit={
                "gain": [float(g) if math.isfinite(g) else None for g in geometry.gain[0]],
                "suppressed": hidden,
                "eccentricity": self.eccentricity,
                "removed": "k = 0 of both parts, k > kmax" + (", k = 1" if free else ""),
                "drift": self.drift,
                "drift_nm_per_revolution": rate * 1e9,
                "u_drift_nm_per_revolution": None if math.isnan(u_rate) else u_rate * 1e9,
                "residual_rms_nm": 1e9 * math.sqrt(float(np.mean(power) / 2.0)),
                "noise_source": noise.definition,
            },
            messages=messages,
            step=Step(self.name, {"kmax": self.kmax, "angles_deg": angles_deg}),
            history=history,
        )


@described_by(MultistepRoundness, MultistepRoundness.separate)
def multistep(
    m: Any,
    steps: int | Sequence[int] | None = None,
    *,
    angles: ArrayLike | None = None,
    kmax: int | None = None,
    u_reading: float | None = None,
    u_index: float = 0.0,
    eccentricity: Literal["fixed", "free"] = "fixed",
    drift: Literal["none", "linear"] = "none",
    step_revolutions: float | None = None,
    turn: Literal[1, -1] = 1,
    angle: ArrayLike | None = None,
) -> Separation:
    """Return roundness of an artefact and error of a spindle from indexed revolutions.

    Parameters
    ----------
    m : array_like, shape (P, N) or (P, M, N), m, or Recording, or sequence of Profile
        One row for each index position, over equal angles of the spindle. The position of a
        profile is the angle of the spindle in rad, the same in each. A `Recording` is cut into
        revolutions by its channel ``angle`` (or of unit rad); without it, it must be one.
    steps : int or sequence of int, optional
        Number of equal steps; several numbers for several runs one after the other in `m`, such
        as ``(7, 8)`` for 15 rows. As many as `m` has rows if neither this nor `angles` is given.
    angles : array_like, shape (P,), rad, optional
        Index positions where they are not equal steps.
    angle : array_like, shape (N,), rad, optional
        Angle of the spindle at each sample of `m` given as arrays; from 0 in equal steps if
        omitted.

    Returns
    -------
    Separation
        ``.artefact``, ``.spindle``; ``.suppressed`` are the multiples of the number of steps.

    Raises
    ------
    DataError
        If `steps` and `angles` are both given or do not fit the rows, or a setting is out of range.

    Notes
    -----
    Least squares per undulation: ``M_p = R exp(j k t alpha_p) + S``. N equal steps give the noise
    ``s / sqrt(N)`` of each part. The spindle must repeat from step to step: what does not is noise,
    and shows in ``audit["residual_rms_nm"]``.

    Examples
    --------
    >>> a = 2 * np.pi * np.arange(120) / 120
    >>> part, spindle = (lambda t: 50e-9 * np.cos(3 * t)), 20e-9 * np.sin(2 * a)
    >>> found = multistep([part(a + p * np.pi / 4) + spindle for p in range(8)], steps=8)
    >>> found.suppressed[:3], bool(np.abs(found.spindle - spindle).max() < 1e-20)
    ([8, 16, 24], True)
    """
    given = circle_readings(m, what="multistep", angle=angle)
    try:
        shape = np.shape(given.values)
    except ValueError:
        shape = ()
    if len(shape) not in (2, 3):
        raise DataError(
            f"multistep needs readings (P, N) or (P, M, N) of equal length, got the shape {shape}"
        )
    if kmax is None and shape[-1] < 5:
        raise TooFewSamplesError(
            f"multistep needs at least 5 samples in a revolution, got {shape[-1]}"
        )
    method = MultistepRoundness(
        _index_positions(steps, angles, shape[0]),
        (shape[-1] - 1) // 2 if kmax is None else kmax,
        u_index,
        eccentricity,
        drift,
        step_revolutions,
        turn=turn,
    )
    return given.separated(method, u_reading)


def _index_positions(steps: Any, angles: ArrayLike | None, rows: int) -> ArrayLike:
    """Return the index positions in rad of rows of readings, from numbers of steps or from angles."""
    if angles is not None:
        if steps is not None:
            raise DataError("give steps or angles, not both")
        if np.shape(angles) != (rows,):
            raise DataError(f"{np.shape(angles)} angles do not fit {rows} rows of readings")
        return angles
    if steps is None and rows < 2:
        raise TooFewSamplesError(
            f"multistep: at least 2 positions are needed, one row of readings each, got {rows}"
        )
    several = isinstance(steps, (Sequence, np.ndarray)) and np.ndim(steps) > 0
    given = [rows] if steps is None else list(steps) if several else [steps]
    # a whole float is a number of steps, as numpy makes it
    counts = [
        count(int(n) if is_real(n) and float(n).is_integer() else n, "steps", least=2)
        for n in given
    ]
    if sum(counts) != rows:
        raise DataError(
            f"steps = {steps} needs {sum(counts)} rows of readings, one each, got {rows}"
        )
    return np.concatenate([2.0 * np.pi * np.arange(n) / n for n in counts])


# ---- the work of `MultistepRoundness.separate`: estimators, drift, noise, audit ----------------

_EXCESS = 5.0
"""Chi-square this many of its standard deviations too large is reported."""

_ROUNDING = 1e-9
"""Differences of this share of the readings are rounding, not reported."""


class _Geometry(NamedTuple):
    """Estimators of R and S from the P positions, for k = 0 ... kmax."""

    rows: ComplexArray  # shape (2, kmax + 1, P): NaN where not observable
    gain: FloatArray  # shape (2, kmax + 1): noise of R, S over that of a reading; inf: not seen
    phase: ComplexArray  # shape (kmax + 1, P): ``exp(j k t alpha_p)``


def _geometry(method: MultistepRoundness) -> _Geometry:
    """Return the least-squares estimators of an arrangement of steps."""
    alpha = method.turn * np.array(method.angles)
    k = np.arange(method.kmax + 1)
    phase = np.exp(1j * np.outer(k, alpha))
    common = phase.mean(axis=1)
    seen = phase - common[:, np.newaxis]
    size2 = np.sum(np.abs(seen) ** 2, axis=1)
    hidden = size2 * method.max_gain**2 < 1.0
    hidden[0] = True
    hidden[1] |= method.eccentricity == "free"
    size2[hidden] = 1.0
    row_r = seen.conj() / size2[:, np.newaxis]
    rows = np.stack([row_r, 1.0 / alpha.size - common[:, np.newaxis] * row_r])
    rows[:, hidden] = np.nan
    gain = np.sqrt(np.sum(np.abs(rows) ** 2, axis=2))
    return _Geometry(rows, np.where(np.isnan(gain), np.inf, gain), phase)


def _without_drift(
    method: MultistepRoundness, given: Revolutions
) -> tuple[FloatArray, float, float]:
    """Return readings without linear drift, the drift per revolution and its uncertainty.

    Revolutions keep their number when another is left out: time went on.
    """
    positions, _, n = given.values.shape
    between = float(given.n_given if method.step_revolutions is None else method.step_revolutions)
    start = between * np.arange(positions)[:, np.newaxis] + given.kept
    level = given.values.mean(axis=2)
    time, about = start - start.mean(), level - level.mean()
    size2 = float(np.sum(time**2))
    rate = float(np.sum(time * about)) / size2
    dof = level.size - 2
    square = float(np.sum((about - rate * time) ** 2))
    u_rate = math.sqrt(square / dof / size2) if dof > 0 else math.nan
    if method.drift == "none":
        return given.values, rate, u_rate
    drift = rate * (start[:, :, np.newaxis] + np.arange(n) / n)
    return given.values - drift, rate, u_rate


def _drift_left(
    method: MultistepRoundness, rate: float, u_rate: float, dof: int, u_spindle: FloatArray
) -> list[str]:
    """Warn where a drift that is not taken off stands out and matters to the spindle."""
    if method.drift == "linear" or dof < 1:
        return []
    # Student's t has long tails where few levels stand behind the line
    limit = _EXCESS * (1.0 + (3.0 / dof) ** 2)
    matters = float(np.sqrt(np.mean(u_spindle**2)))
    if not abs(rate) > limit * u_rate or abs(rate) <= matters:
        return []
    text = (
        f"the level drifts by {rate * 1e9:.3g} nm per revolution (u {u_rate * 1e9:.2g} nm), which "
        "is a step of that height in the spindle at the start of the revolution: give "
        "drift='linear' if the steps followed each other in time"
    )
    return [text]


def _wide_index(method: MultistepRoundness) -> list[str]:
    """Warn where the uncertainty of the positions is not a small angle for the highest undulation."""
    if method.kmax * method.u_index <= 1.0:
        return []
    text = (
        f"u_index of {math.degrees(method.u_index):.3g} deg is not a small angle for k above "
        f"{int(1.0 / method.u_index)}, where its share of u is too small a guess; was it in rad?"
    )
    return [text]


def _noise(
    geometry: _Geometry,
    each: ComplexArray,
    rest: ComplexArray,
    u_reading: float | None,
    n: int,
) -> tuple[Quantity, FloatArray, bool]:
    """Return noise of one reading, u of harmonics, and whether it came from the steps."""
    positions, turns = each.shape[:2]
    gain = np.where(np.isinf(geometry.gain), np.nan, geometry.gain)
    if u_reading is not None:
        u_k = gain * u_reading * math.sqrt(2.0 / (n * turns))
        return reading_noise(u_reading, "as stated"), u_k, False
    seen = np.isfinite(rest[0])
    if positions > 2:
        per_k = np.sum(np.abs(rest) ** 2, axis=0) / (2.0 * (positions - 2))
        dof = 2 * (positions - 2) * int(seen.sum())
        value = math.sqrt(float(per_k[seen].mean()) * n * turns / 2.0)
        text = (
            f"type A from what {positions} positions disagree by, spindle not repeating included"
        )
        u_k = gain * np.sqrt(per_k)
    elif turns > 1:
        about = each - each.mean(axis=1, keepdims=True)
        per_k = np.sum(np.abs(about) ** 2, axis=(0, 1)) / (2.0 * positions * (turns - 1))
        dof = 2 * positions * (turns - 1) * int(seen.sum())
        value = math.sqrt(float(per_k[seen].mean()) * n / 2.0)
        text = f"type A from {turns} revolutions"
        u_k = gain * np.sqrt(per_k / turns)
    else:
        return reading_noise(math.nan, "not known"), gain * math.nan, False
    return reading_noise(value, text, value / math.sqrt(2.0 * dof)), u_k, positions > 2


def _first_harmonic(method: MultistepRoundness, rest: ComplexArray, size: float) -> list[str]:
    """Warn where k = 1 disagrees far more between steps than the other undulations do."""
    positions = rest.shape[0]
    if method.eccentricity == "free" or positions < 4 or method.kmax < 6:
        return []
    power = np.sum(np.abs(rest) ** 2, axis=0)
    others = power[2:][np.isfinite(power[2:])]
    level = float(np.median(others)) if others.size else math.nan
    limit = 1.0 + _EXCESS * math.sqrt(1.0 / (positions - 2)) * 2.0
    if not power[1] > max(limit * level, (_ROUNDING * size) ** 2):
        return []
    text = (
        "k = 1 differs from step to step far more than other undulations: if the artefact was "
        "centred anew, give eccentricity='free'"
    )
    return [text]


def _other_turn(method: MultistepRoundness, mean: ComplexArray, rest: ComplexArray) -> list[str]:
    """Warn where steps of the other sense leave less than a third of what the positions disagree by."""
    other = _geometry(replace(method, turn=-1 if method.turn == 1 else 1))
    r, s = np.einsum("akp,pk->ak", other.rows, mean)
    left = math.sqrt(float(np.nansum(np.abs(mean - other.phase.T * r - s) ** 2)))
    given = math.sqrt(float(np.nansum(np.abs(rest) ** 2)))
    if len(mean) < 3 or not 3.0 * max(left, _ROUNDING * float(np.abs(mean).max())) < given:
        return []
    text = (
        f"the readings fit turn={-method.turn} much better ({left / given:.2g} of what the positions "
        f"disagree by is left): turn={method.turn} says that a step brings points of "
        f"{'larger' if method.turn == 1 else 'smaller'} artefact angle to the probe, and a wrong "
        "turn spoils the artefact"
    )
    return [text]
