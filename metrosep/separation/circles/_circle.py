"""Readings round a circle: checked, and as harmonics ``sum_k Re(c_k exp(j k theta))`` and back.

The samples stand at ``theta_j = theta_0 + 2 pi j / N``, theta_0 = 0 unless the readings say
otherwise; revolutions are whole. Harmonics go up to kmax < N/2,
so the sample at the Nyquist frequency, whose phase no reading tells, never enters.
"""

from __future__ import annotations

import math
from abc import abstractmethod
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, ClassVar, Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray

from metrosep.core._arrays import ComplexArray, FloatArray
from metrosep.core.errors import (
    DataError,
    InvalidSamplesError,
    NotSeparableError,
    TooFewSamplesError,
    UnitError,
)
from metrosep.core.numbers import is_real, not_negative, positive, real
from metrosep.core.options import option
from metrosep.core.profile import Profile
from metrosep.core.provenance import Step
from metrosep.core.quantity import Quantity
from metrosep.core.recording import Recording
from metrosep.separation._readings import (
    as_numbers,
    curves,
    first_angle,
    known_parts,
    part_of,
    require_turn,
)
from metrosep.separation.contract import Parts, Separation, SeparationMethod, Unobservable

_LARGEST_RADIUS = 10.0
"""m; no artefact on a spindle is larger, but 20 mm given as 20 is."""

_LARGEST_NOISE = 0.1
"""m or rad; a larger standard deviation of one reading is um, nm or degrees by mistake."""


def grid(n: int) -> FloatArray:
    """Return the angles in rad of n samples of one revolution."""
    return 2.0 * np.pi * np.arange(n) / n


def check_radius(radius: Any) -> float:
    """Return a radius in m, refused where it can only be mm."""
    value = positive(radius, "radius", dimension="length")
    if value > _LARGEST_RADIUS:
        raise UnitError(
            f"radius of {value:g} m is above {_LARGEST_RADIUS:g} m; mm? divide by 1000"
        )
    return value


def numbers(values: Any, needs: str) -> FloatArray:
    """Return an array of floats, refused where rows differ in length or are not numbers."""
    try:
        np.shape(values)
    except ValueError:
        raise InvalidSamplesError(f"{needs}, got rows of different lengths") from None
    return as_numbers(values, needs)


def angle_tuple(angles: ArrayLike, *, least: int, what: str) -> tuple[float, ...]:
    """Return angles in rad as floats, refused when they look like degrees."""
    array = numbers(angles, f"the {what} angles must be numbers in rad")
    if array.ndim != 1 or array.size < least:
        raise TooFewSamplesError(
            f"need >= {least} {what} angles in one row, got an array of shape {array.shape}"
        )
    if not np.isfinite(array).all():
        raise InvalidSamplesError(f"the {what} angles must be finite, got {array.tolist()} rad")
    if np.abs(array).max(initial=0.0) > 2.0 * np.pi * (1.0 + 1e-9):
        raise UnitError(
            f"the {what} angles reach {np.abs(array).max():.6g} rad, more than one turn; these "
            "look like degrees: give numpy.deg2rad(angles)"
        )
    return tuple(array.tolist())


def check_sign(value: Any, name: str) -> Literal[1, -1]:
    """Return +1 or -1, such as the turn."""
    if not is_real(value) or value not in (1, -1):
        raise DataError(f"{name} must be +1 or -1, got {value!r}")
    return 1 if value == 1 else -1


def check_small_angle(angle: Any, name: str) -> float:
    """Return the standard uncertainty of an angle in rad, refused where it can only be degrees."""
    value = not_negative(angle, name, dimension="angle")
    if value > 0.2:
        raise UnitError(f"{name} of {value} rad is too large; degrees? give numpy.deg2rad")
    return value


def check_u_reading(u_reading: Any, unit: Literal["m", "rad"] = "m") -> float | None:
    """Return the standard deviation of one reading, refused if negative, not finite or huge."""
    if u_reading is None:
        return None
    value = not_negative(u_reading, "u_reading", dimension="length" if unit == "m" else "angle")
    if value > _LARGEST_NOISE:
        raise UnitError(
            f"u_reading of {value:g} {unit} is above {_LARGEST_NOISE:g} {unit}; um or nm? give "
            f"u_reading in {unit}"
        )
    return value


@dataclass(frozen=True, slots=True)
class Revolutions:
    """Complete revolutions of all readings."""

    values: FloatArray  # shape (n, M, N): readings
    kept: NDArray[np.intp]  # shape (M,): which revolutions these were, from 0
    n_given: int  # revolutions before the incomplete ones were left out

    @property
    def n_left_out(self) -> int:
        """Revolutions that were incomplete."""
        return self.n_given - self.kept.size

    @property
    def messages(self) -> list[str]:
        """Messages about gaps."""
        if self.n_left_out == 0:
            return []
        text = (
            f"{self.n_left_out} of {self.n_given} revolutions have readings that are not measured "
            "and were omitted"
        )
        return [text]


def revolutions(readings: Any, n: int, *, what: str, n_min: int) -> Revolutions:
    """Return readings as (n, M, N) without incomplete revolutions.

    A revolution in which any reading is missing is omitted whole: an FFT would have to fill it.
    """
    array = numbers(
        readings, f"readings of {n} {what} must be a regular array ({n}, N) or ({n}, M, N)"
    )
    if array.ndim not in (2, 3) or array.shape[0] != n:
        raise InvalidSamplesError(
            f"readings of {n} {what} need the shape ({n}, N) or ({n}, M revolutions, N samples), "
            f"got {array.shape}"
        )
    array = array[:, np.newaxis, :] if array.ndim == 2 else array
    if array.shape[2] < n_min or array.shape[1] == 0:
        raise TooFewSamplesError(
            f"need >= 1 revolution of >= {n_min} samples (kmax < N/2), got {array.shape[1]} of "
            f"{array.shape[2]}; sample finer or lower kmax"
        )
    if np.isinf(array).any():
        i, r, j = (int(v) for v in np.argwhere(np.isinf(array))[0])
        raise InvalidSamplesError(
            f"reading {j} of revolution {r} of {what} {i} is infinite; drop that revolution"
        )
    complete = ~np.isnan(array).any(axis=(0, 2))
    if not complete.any():
        raise InvalidSamplesError(
            "no revolution is complete: in each at least one reading is not measured (NaN); "
            "measure again, missing readings are not filled"
        )
    return Revolutions(array[:, complete], np.flatnonzero(complete), complete.size)


def centred(values: FloatArray) -> FloatArray:
    """Return curves without their mean and their once-per-revolution share, along the last axis."""
    n = values.shape[-1]
    out: FloatArray = values - curve(harmonics_of(values, 1), n)
    return out


def harmonics_of(samples: FloatArray, kmax: int) -> ComplexArray:
    """Return c_k, k = 0 ... kmax, along the last axis."""
    n = samples.shape[-1]
    c: ComplexArray = np.fft.rfft(samples, axis=-1)[..., : kmax + 1] * (2.0 / n)
    c[..., 0] *= 0.5
    return c


def referred_to_zero(c: ComplexArray, start_angle: float) -> ComplexArray:
    """Return harmonics about the angle 0, from those about the first sample at `start_angle`."""
    out: ComplexArray = c * np.exp(-1j * start_angle * np.arange(c.shape[-1]))
    return out


def curve(c: ComplexArray, n: int) -> FloatArray:
    """Return the sum of the harmonics that are known (not NaN) at n samples of a revolution."""
    half = np.where(np.isnan(c), 0.0, c) * (0.5 * n)
    half[..., 0] *= 2.0
    out: FloatArray = np.fft.irfft(half, n=n, axis=-1)
    return out


def turned(samples: FloatArray, angles: FloatArray) -> FloatArray:
    """Return ``samples(theta + angle)`` for each angle: exact for what is below Nyquist."""
    n = samples.shape[-1]
    c = np.fft.rfft(samples)
    k = np.arange(c.size)
    shift = np.exp(1j * k * angles[:, np.newaxis])
    if n % 2 == 0:
        shift[:, -1] = np.cos(0.5 * n * angles)
    out: FloatArray = np.fft.irfft(c * shift, n=n, axis=-1)
    return out


_CENTRING = (
    "the offset (k = 0) is the zero of the probes; k = 1 is shared between the centring of the "
    "artefact and the motion, so both are omitted"
)


def unseen(
    part: str,
    hidden: Iterable[int],
    why_hidden: str,
    *,
    terms: tuple[str, ...] = ("offset", "eccentricity"),
    why: str = _CENTRING,
) -> tuple[Unobservable, ...]:
    """Return the terms of a part that are not seen, and the harmonics where there are any."""
    ks = tuple(int(k) for k in hidden)
    found = Unobservable(part, "term", terms, why)
    return (found, Unobservable(part, "harmonic", ks, why_hidden)) if ks else (found,)


def hidden_of(gain: FloatArray) -> list[int]:
    """Return the undulations from 2 on whose gain is infinite."""
    return [int(k) for k in np.flatnonzero(np.isinf(gain)) if k > 1]


def names_of_k(ks: Sequence[int], *, most: int = 12) -> str:
    """Return harmonics as a text for a message."""
    shown = ", ".join(str(k) for k in ks[:most])
    return shown + (f", ... ({len(ks)} in all)" if len(ks) > most else "")


def hidden_message(ks: Sequence[int], text: str, of: str = "") -> list[str]:
    """Return ``k=7, 9 are`` and the text, nothing without harmonics."""
    return [f"k={names_of_k(ks)}{of} {'is' if len(ks) == 1 else 'are'} {text}"] if ks else []


# ---- readings round a circle as callers give them: arrays, profiles, a recording with its angle ----

_REPEATED = 0.01
"""Share of the power off the multiples of M below which a curve is one of M equal revolutions."""

_MOST_TURNS = 64
"""Revolutions of a recording without its angle that are looked for."""


@dataclass(frozen=True, slots=True)
class CircleReadings:
    """Readings over whole revolutions."""

    # shape (n, N) or (n, M, N): as a method takes them; not yet checked where the caller gave an
    # array
    values: Any
    start_angle: float = 0.0  # rad: angle of the first sample
    history: tuple[Step, ...] = ()  # what happened to them before
    messages: tuple[str, ...] = ()  # warnings

    def separated(self, method: CircleMethod, u_reading: float | None) -> Separation:
        """Return what a method makes of them, with the warnings about them."""
        found = method.separate(
            self.values, u_reading=u_reading, start_angle=self.start_angle, history=self.history
        )
        return replace(found, messages=(*found.messages, *self.messages))


def circle_readings(m: Any, *, what: str, angle: ArrayLike | None = None) -> CircleReadings:
    """Return readings with the angle at which they begin."""
    if isinstance(m, Recording):
        if angle is not None:
            raise DataError(f"{what}: give the angle as a channel of the recording, not beside it")
        return _of_recording(m, what)
    if isinstance(m, Profile | Mapping):
        raise InvalidSamplesError(
            f"{what} needs several readings in a row, got one {type(m).__name__}"
        )
    if isinstance(m, Sequence) and any(isinstance(item, Profile) for item in m):
        values, positions, history = curves(m, what=what, axis="angle")
        start = first_angle(positions, angle, len(values[0]), what)
        return CircleReadings(np.stack(values), start, history)
    if angle is None:
        return CircleReadings(m)
    try:
        n = np.shape(m)[-1]
    except (ValueError, IndexError):
        raise DataError(f"{what}: angle needs readings of equal length") from None
    return CircleReadings(m, first_angle(None, angle, n, what))


def _of_recording(m: Recording, what: str) -> CircleReadings:
    """Return the channels of a recording, cut into revolutions where it holds its angle."""
    names = [k for k in m.channels if m.units.get(k) == "rad" or k.lower().startswith("angle")]
    if len(names) > 1:
        raise DataError(f"{what}: the recording has several angles: {', '.join(names)}; keep one")
    rows = [v for k, v in m.channels.items() if k not in names]
    if not rows:
        raise DataError(f"{what}: the recording holds no readings beside {names}")
    values = np.stack(rows)
    if not names:
        return CircleReadings(values, 0.0, m.history, _repeats(values, what))
    angle = m.channels[names[0]]
    if np.isnan(angle).any() or angle.size < 3:
        raise InvalidSamplesError(
            f"{what}: channel {names[0]!r} must hold an angle at each sample"
        )
    angle = np.unwrap(angle)
    turns = abs(float(angle[-1] - angle[0])) / (2.0 * np.pi) * angle.size / (angle.size - 1)
    whole = max(1, round(turns))
    if angle.size % whole:
        raise InvalidSamplesError(
            f"{what}: channel {names[0]!r} runs over {turns:.4g} revolutions, {angle.size} samples; "
            "crop to whole revolutions of equal steps, or resample by angle"
        )
    n = angle.size // whole
    for i, one in enumerate(angle.reshape(whole, n)):
        require_turn(one)
        if abs(float(one[0] - angle[0]) - 2.0 * np.pi * i) > 1e-6 * 2.0 * np.pi / n:
            raise InvalidSamplesError(
                f"{what}: revolution {i} of channel {names[0]!r} does not begin where the first "
                "does; resample by angle"
            )
    shape = (values.shape[0], n) if whole == 1 else (values.shape[0], whole, n)
    return CircleReadings(values.reshape(shape), float(angle[0]), m.history)


def _repeats(values: FloatArray, what: str) -> tuple[str, ...]:
    """Warn where a recording without its angle looks like several revolutions."""
    n = values.shape[1]
    if n < 6 or not np.isfinite(values).all():
        return ()
    power = np.sum(np.abs(np.fft.rfft(values - values.mean(axis=1, keepdims=True))) ** 2, axis=0)
    total = float(power.sum())
    for turns in range(min(_MOST_TURNS, n // 3), 1, -1):
        if n % turns == 0 and float(power[::turns].sum()) > (1.0 - _REPEATED) * total > 0.0:
            text = (
                f"{what}: the recording is taken as one revolution, but its readings repeat "
                f"{turns} times: if it holds {turns} revolutions, add the channel 'angle' in rad "
                f"or give an array ({values.shape[0]}, {turns}, {n // turns})"
            )
            return (text,)
    return ()


# ---- what an arrangement of probes sees of each harmonic: least squares, noise gain, residual ----
# For undulation k the readings are ``M_i = R e_i + X cos(phi_i) + Y sin(phi_i)`` with
# ``e_i = exp(j k t phi_i)``, t = +1 or -1 the turn. What cos and sin cannot explain of e is what
# shows R: with C the covariance of the readings, V its inverse and P the projector on what V finds
# orthogonal to cos and sin, ``R = (P e)* V M / (e* V P e)``.

_COLLINEAR = 1e-6
"""Smallest ratio of the singular values of (cos, sin): probes on a line see one direction."""

_NO_COUPLING = 1e-9
"""A motion that a hidden artefact harmonic moves by less than this is still observable."""


@dataclass(frozen=True, slots=True)
class ProbeGeometry:
    """Estimators of all harmonics 0 ... kmax."""

    # of complex, shape (3, kmax + 1, n): what R, X and Y are made of; NaN where not observable
    rows: ComplexArray
    # shape (3, kmax + 1): noise of R, X, Y over the root mean square noise of the probes; inf
    # where not observable
    gain: FloatArray
    # of complex, shape (kmax + 1, n, n): whitened part of the readings that no artefact and no
    # motion explains
    residual: ComplexArray
    # shape (kmax + 1,): complex degrees of freedom of that part; 0 for k = 0 and 1
    freedom: NDArray[np.int64]
    whitener: FloatArray  # shape (n, n): makes readings of unit root mean square noise white


def probe_geometry(
    angles: FloatArray, kmax: int, *, covariance: FloatArray | None, max_gain: float, turn: int
) -> ProbeGeometry:
    """Return the estimators of an arrangement; harmonics with a larger gain are not observable."""
    n = angles.size
    relative = np.eye(n) if covariance is None else covariance * (n / np.trace(covariance))
    whitener = _whitener(relative)
    motion = whitener @ np.column_stack([np.cos(angles), np.sin(angles)])
    left, size, right = np.linalg.svd(motion, full_matrices=False)
    if size[1] < _COLLINEAR * size[0]:
        raise NotSeparableError(
            "the probes stand on one line through the axis, so they see one direction of the "
            "motion only; spread the angles"
        )
    to_motion = right.T @ (left / size).T
    k = np.arange(kmax + 1)
    artefact = np.exp(1j * turn * np.outer(k, angles)) @ whitener.T
    seen = artefact - (artefact @ left) @ left.T
    size2 = np.sum(np.abs(seen) ** 2, axis=1)
    hidden = size2 * max_gain**2 < 1.0
    hidden[:2] = True
    seen[hidden] = 0.0
    size2[hidden] = 1.0
    row_r = seen.conj() / size2[:, np.newaxis]
    coupling = artefact @ to_motion.T
    rows = np.empty((3, k.size, n), dtype=np.complex128)
    rows[0] = row_r
    rows[0, hidden] = np.nan
    for part in (0, 1):
        share = coupling[:, part]
        rows[1 + part] = to_motion[part] - share[:, np.newaxis] * row_r
        rows[1 + part, hidden & (np.abs(share) > _NO_COUPLING)] = np.nan
    rows[:, :2] = np.nan
    gain = np.sqrt(np.sum(np.abs(rows) ** 2, axis=2))
    gain = np.where(np.isnan(gain), np.inf, gain)
    unit = seen / np.sqrt(size2)[:, np.newaxis]
    residual = (np.eye(n) - left @ left.T) - unit[:, :, np.newaxis] * unit[:, np.newaxis].conj()
    residual[hidden] = 0.0
    freedom = np.where(hidden, 0, n - 3).astype(np.int64)
    return ProbeGeometry(rows @ whitener, gain, residual, freedom, whitener)


def _whitener(covariance: FloatArray) -> FloatArray:
    try:
        lower = np.linalg.cholesky(covariance)
    except np.linalg.LinAlgError as exc:
        raise InvalidSamplesError(
            "cov is not positive definite; give variances > 0 in m^2, and correlations below 1"
        ) from exc
    out: FloatArray = np.linalg.inv(lower)
    return out


# ---- what the methods over whole revolutions share: contract, variances, result ----------------

Terms = Mapping[str, tuple[FloatArray, FloatArray]]
"""Type B terms by name: variances of the curves (p, N) and of the harmonics (p, kmax + 1)."""


def turn_option() -> Any:
    """Return the option of the sense of turning against the probe angles."""
    return option(
        1,
        kind="integer",
        choices=(1, -1),
        help="1: the part turns against the count of the probe angles; -1: with it",
    )


class CircleMethod(SeparationMethod):
    """Whole revolutions, separated harmonic by harmonic; methods say with which estimators."""

    kmax: int
    turn: Literal[1, -1]
    _sources: ClassVar[str]  # what the rows of readings are, for messages

    @property
    @abstractmethod
    def _n_sources(self) -> int:
        """Rows of readings."""

    @property
    def _parts(self) -> tuple[str, ...]:
        return (*self.truth_parts, *self.error_parts)

    def _rows_of(self, truth: Parts, errors: Parts) -> dict[str, FloatArray]:
        """Return all parts as rows of one length, zero where not given."""
        found = known_parts(self, truth, errors)
        shape = next(iter(found.values())).shape
        if len(shape) != 1 or shape[0] < 3:
            raise InvalidSamplesError(f"parts need one row of >= 3 samples each, got {shape}")
        return {name: part_of(found, name, shape, self.name) for name in self._parts}

    def separate(
        self,
        readings: ArrayLike,
        *,
        u_reading: float | None = None,
        start_angle: float = 0.0,
        history: tuple[Step, ...] = (),
    ) -> Separation:
        """Return the parts over the angle, with their harmonics.

        Parameters
        ----------
        readings : array_like, shape (n, N) or (n, M, N)
            As `simulate` returns them: one revolution of N equal steps, or M revolutions. One in
            which a reading is NaN is omitted whole.
        u_reading : float, m, optional
            Standard deviation of one reading; from the readings if omitted, as far as they show it.
        start_angle : float, rad, optional
            Angle of the first sample; ``harmonics`` are referred to the angle 0.
        history : tuple of Step, optional
            Where the readings came from.

        Returns
        -------
        Separation
            The parts over ``angle``, with ``harmonics``.

        Raises
        ------
        InvalidSamplesError
            If the readings have another shape, are infinite, or no revolution is complete.
        TooFewSamplesError
            If kmax is not below half the samples.
        UnitError
            If `u_reading` looks like um or nm.
        DataError
            If `u_reading` is negative or not finite.
        """
        start = real(start_angle, "start_angle", dimension="angle")
        stated = check_u_reading(u_reading)
        n_min = 2 * self.kmax + 1
        given = revolutions(readings, self._n_sources, what=self._sources, n_min=n_min)
        return self._separated(given, stated, start, history)

    @abstractmethod
    def _separated(
        self, given: Revolutions, stated: float | None, start: float, history: tuple[Step, ...]
    ) -> Separation:
        """Return the result of checked readings."""

    def _result(
        self,
        given: Revolutions,
        found: ComplexArray,
        noise: Quantity,
        u_k: FloatArray,
        terms: Terms,
        *,
        start: float,
        settings: Mapping[str, Any],
        audit: Mapping[str, Any],
        messages: Sequence[str],
        step: Step,
        history: tuple[Step, ...],
    ) -> Separation:
        """Return parts and u (p, kmax + 1) of type A `u_k` and the type B terms as a result."""
        parts, (turns, n) = self._parts, given.values.shape[1:]

        def named(rows: Any) -> dict[str, Any]:
            return dict(zip(parts, rows, strict=True))

        return Separation(
            self.name,
            named(curve(found, n)),
            named(u_of_curves(u_k, terms, n) * (math.nan if math.isnan(noise.value) else 1.0)),
            dict.fromkeys(parts, "m"),
            {"angle": start + grid(n)},
            self.null_space(),
            noise,
            named(referred_to_zero(found, start)),
            named(
                np.where(
                    np.isnan(found), np.nan, np.sqrt(sum((s for _, s in terms.values()), u_k**2))
                )
            ),
            {
                **settings,
                "n_samples": n,
                "n_revolutions": turns,
                "n_revolutions_left_out": given.n_left_out,
                "start_angle_deg": math.degrees(start),
                **audit,
                "type_b": {
                    part: {
                        f"{t} / m": math.sqrt(square[i].mean()) for t, (square, _) in terms.items()
                    }
                    for i, part in enumerate(parts)
                },
            },
            tuple(messages),
            (*history, step),
        )


def u_of_curves(u_k: FloatArray, terms: Terms, n: int) -> FloatArray:
    """Return u (p, n) of curves from that of their harmonics, and the type B terms."""
    square = np.nansum(u_k**2, axis=1)[:, np.newaxis] + np.zeros(n)
    out: FloatArray = np.sqrt(sum((s for s, _ in terms.values()), square))
    return out


def variances(moved: ComplexArray, n: int) -> tuple[FloatArray, FloatArray]:
    """Return the variances of curves and harmonics that independent causes (p, cause, k) make."""
    return np.sum(curve(moved, n) ** 2, axis=1), np.sum(np.abs(moved) ** 2, axis=1) / 2.0


def reading_noise(
    value: float, source: str, u: float | None = None, *, unit: str = "m", of: str = "reading"
) -> Quantity:
    """Return the standard deviation of one reading, and where it comes from."""
    return Quantity(value, unit, f"standard deviation of one {of}; {source}", u, "s")
