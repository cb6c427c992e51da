"""Simulated machines that move with a correction as a controller applies it.

The controller looks the correction up at the command, once a servo period, some periods late,
holds it or draws a line to the next one, and rounds it to counts. The error of the machine acts
where the axis then is. What the part shows is actual minus nominal.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any, Literal

import numpy as np

from metrosep.core import numbers
from metrosep.core._arrays import FloatArray
from metrosep.core.errors import DataError, InvalidSamplesError

AxisFunction = Callable[[FloatArray, int], FloatArray]
MapFunction = Callable[[FloatArray, FloatArray], FloatArray]
Lookup = Callable[[FloatArray, int], FloatArray]
"""Places, of shape (n,) or (n, 2), and direction to a value at each."""


@dataclass(frozen=True, slots=True)
class Servo:
    """How a controller applies a correction over time; frozen, SI.

    Parameters
    ----------
    period : float, s, optional
        Time between two look-ups; 0 looks up all the time.
    latency : int, optional
        Periods from look-up to output.
    between : {"hold", "linear"}, optional
        Output between two periods: the last value, or a line to the next.
    count : float, m, optional
        Step of the corrected axis; 0 does not round.

    Raises
    ------
    DataError
        If a value is negative or not finite, or `between` is unknown.

    Notes
    -----
    At feed v and slope c' of the correction the rest of "hold" is up to ``|c'| v T (1 + latency)``,
    that of "linear" ``|c'| v T latency`` and ``|c''| (v T)^2 / 8``.
    """

    period: float = 0.0
    latency: int = 0
    between: Literal["hold", "linear"] = "hold"
    count: float = 0.0

    def __post_init__(self) -> None:
        _settle(self, {"period": "time", "count": "length"})
        numbers.count(self.latency, "latency", least=0)
        numbers.choice(self.between, "between", ("hold", "linear"))

    def output(
        self, lookup: Lookup, place: Callable[[FloatArray], FloatArray], t: FloatArray, way: int
    ) -> FloatArray:
        """Return the correction that is out at given times.

        Parameters
        ----------
        lookup : callable
            Correction in m at places, in a direction.
        place : callable
            Commanded place at a time in s.
        t : ndarray, shape (n,), s
            Times.
        way : {1, -1}
            Direction of motion.

        Returns
        -------
        ndarray, shape (n,), m
            Before it is rounded to counts.
        """
        if self.period == 0.0:
            return lookup(place(t), way)
        tick = np.floor(t / self.period + 1e-9)
        last = lookup(place((tick - self.latency) * self.period), way)
        if self.between == "hold":
            return last
        share = np.clip(t / self.period - tick, 0.0, 1.0)
        following = lookup(place((tick + 1.0 - self.latency) * self.period), way)
        return np.asarray(last + share * (following - last))

    def rounded(self, values: FloatArray) -> FloatArray:
        """Return positions in whole counts.

        Parameters
        ----------
        values : ndarray, m
            Positions.

        Returns
        -------
        ndarray, m
            The nearest counts; the positions themselves if `count` is 0.
        """
        return (
            values if self.count == 0.0 else np.asarray(np.rint(values / self.count) * self.count)
        )


class _Driven:
    """What both machines do: cut, stand with play, be measured with noise."""

    __slots__ = ()
    servo: Servo
    lost_motion: float
    repeatability: float
    measuring_noise: float

    if TYPE_CHECKING:

        @property
        def places(self) -> FloatArray: ...

    def cut(
        self, correction: Callable[..., Any], direction: int, rng: np.random.Generator
    ) -> FloatArray:
        """Return what one pass leaves, measured.

        Parameters
        ----------
        correction : callable
            ``(position, direction) -> correction`` in m, added to the command; of a face-turned part
            ``(x, y) -> correction`` along z.
        direction : {1, -1}
            Direction of the pass; a face-turned part has one, 1.
        rng : numpy.random.Generator
            For repeatability and noise.

        Returns
        -------
        ndarray, shape (n,), m
            Actual minus nominal at `places`.

        Raises
        ------
        InvalidSamplesError
            If correction or error are not finite, or of another shape.
        """
        raise NotImplementedError

    def _noisy(self, left: FloatArray, rng: np.random.Generator) -> FloatArray:
        sd = math.hypot(self.repeatability, self.measuring_noise)
        return left + rng.normal(0.0, sd, left.shape) if sd > 0.0 else np.array(left)

    def _audited(self, what: str, **own: Any) -> dict[str, Any]:
        """Return what the machine is, its servo and its noise."""
        servo = self.servo
        return {
            "machine": what,
            **own,
            "lost_motion_nm": self.lost_motion * 1e9,
            "servo_period_ms": servo.period * 1e3,
            "latency_periods": int(servo.latency),
            "between_periods": servo.between,
            "count_nm": servo.count * 1e9,
            "repeatability_nm": self.repeatability * 1e9,
            "measuring_noise_nm": self.measuring_noise * 1e9,
            "n_points": int(self.places.shape[0]),
        }


@dataclass(frozen=True, slots=True)
class AxisMachine(_Driven):
    """A linear axis that is driven through its travel, and what it leaves; frozen, SI.

    Parameters
    ----------
    error : callable
        True error ``e(position, direction)`` in m, actual - nominal, at the place the axis is.
    travel : tuple of (float, float), m
        First and last commanded position.
    on_axis : bool
        The correction moves the axis itself (positions reached) or another (profile of a turned
        or flycut part).
    feed : float, m/s, optional
        Of the looked-up axis; 0 stops at every point.
    servo : Servo, optional
        How the correction is applied.
    lost_motion : float, m, optional
        Play of the corrected axis: in - direction it stands so much further in +.
    repeatability : float, m, optional
        Standard deviation of what is new at every point of every pass.
    measuring_noise : float, m, optional
        Standard deviation of the measurement of the part or position.
    n_points : int, optional
        Points that are measured.

    Raises
    ------
    DataError
        If travel is not rising, a length is negative, or there are fewer than 2 points.

    Notes
    -----
    The error of the looked-up axis is taken where the axis is: at p + c if the correction moves
    it, at p if it moves another. Play is that of the corrected axis; across the looked-up axis
    it acts wherever the correction turns.
    """

    error: AxisFunction
    travel: tuple[float, float]
    on_axis: bool
    feed: float = 0.0
    servo: Servo = field(default_factory=Servo)
    lost_motion: float = 0.0
    repeatability: float = 0.0
    measuring_noise: float = 0.0
    n_points: int = 1001

    def __post_init__(self) -> None:
        low, high = (
            numbers.quantity(end, "an end of the travel", "length") for end in self.travel
        )
        if not high > low:
            raise DataError(f"the travel must rise from first to last, got {self.travel!r} m")
        object.__setattr__(self, "travel", (low, high))
        _settle(self, {"feed": "speed", **dict.fromkeys(_NOISE, "length")})
        numbers.count(self.n_points, "n_points", least=2)

    @property
    def directions(self) -> tuple[int, ...]:
        """Directions in which it is driven."""
        return (1, -1)

    @property
    def places(self) -> FloatArray:
        """Commanded positions of the points, shape (n,), m."""
        return np.linspace(*self.travel, int(self.n_points))

    @property
    def audit(self) -> dict[str, Any]:
        """Plain values with units in the keys."""
        return self._audited(
            "positions reached" if self.on_axis else "profile of a part",
            travel_mm=[1e3 * p for p in self.travel],
            feed_mm_min=self.feed * 6e4,
        )

    def cut(
        self, correction: AxisFunction, direction: int, rng: np.random.Generator
    ) -> FloatArray:
        p = self.places[::direction]  # in the order of time
        start = p[0]

        def place(t: FloatArray) -> FloatArray:
            return np.asarray(start + direction * self.feed * t)

        def lookup(x: FloatArray, way: int) -> FloatArray:
            return _finite(correction(x, way), x, "correction")

        if self.feed == 0.0:
            c = lookup(p, direction)
        else:
            c = self.servo.output(lookup, place, np.abs(p - start) / self.feed, direction)
        if self.on_axis:
            motor = _play(self.servo.rounded(p + c), self.lost_motion, direction)
            actual = motor + _finite(self.error(motor, direction), p, "error")
            left = actual - p
        else:
            left = _play(self.servo.rounded(c), self.lost_motion, 0)
            left = left + _finite(self.error(p, direction), p, "error")
        return self._noisy(left, rng)[::direction]


@dataclass(frozen=True, slots=True)
class FaceMachine(_Driven):
    """A face-turned part: the tool goes inwards while the part turns; frozen, SI.

    Parameters
    ----------
    error : callable
        True error ``e(x, y)`` along z in m at places of the part.
    radius : float, m
        Of the part; the tool begins there.
    inner_radius : float, m, optional
        Where it ends.
    speed : float, 1/s, optional
        Revolutions per second of the spindle; 0 stops at every point.
    revolutions : int, optional
        Turns of the spiral.
    points_per_turn : int, optional
        Points of a turn that are measured.
    servo : Servo, optional
        How the correction is applied.
    lost_motion, repeatability, measuring_noise : float, m, optional
        As for `AxisMachine`.

    Raises
    ------
    DataError
        If a length or number is out of range.

    Notes
    -----
    At angular speed w a held correction is late by up to an angle w T: the rest grows with the
    radius. Directions are one: a spiral is not turned backwards.
    """

    error: MapFunction
    radius: float
    inner_radius: float = 0.0
    speed: float = 0.0
    revolutions: int = 20
    points_per_turn: int = 120
    servo: Servo = field(default_factory=Servo)
    lost_motion: float = 0.0
    repeatability: float = 0.0
    measuring_noise: float = 0.0

    def __post_init__(self) -> None:
        _settle(self, {"radius": "length"}, numbers.positive)
        lengths = dict.fromkeys(("inner_radius", *_NOISE), "length")
        _settle(self, {"speed": "frequency", **lengths})
        if self.inner_radius >= self.radius:
            raise DataError(
                f"the inner radius {self.inner_radius!r} m must be below the radius {self.radius!r} m"
            )
        numbers.count(self.revolutions, "revolutions")
        numbers.count(self.points_per_turn, "points_per_turn", least=3)

    @property
    def on_axis(self) -> bool:
        """Whether the correction moves the looked-up axis; never."""
        return False

    @property
    def directions(self) -> tuple[int, ...]:
        """Directions in which it is driven."""
        return (1,)

    @property
    def places(self) -> FloatArray:
        """Places of the points on the part, shape (n, 2), m."""
        n = int(self.revolutions) * int(self.points_per_turn)
        return self._spiral(np.arange(n + 1) / self.points_per_turn)

    @property
    def audit(self) -> dict[str, Any]:
        """Plain values with units in the keys."""
        return self._audited(
            "face-turned part",
            radius_mm=self.radius * 1e3,
            speed_per_min=self.speed * 60.0,
            revolutions=int(self.revolutions),
        )

    def _spiral(self, turns: FloatArray) -> FloatArray:
        share = np.clip(turns / self.revolutions, 0.0, 1.0)
        r = self.radius + share * (self.inner_radius - self.radius)
        return np.stack([r * np.cos(2 * np.pi * turns), r * np.sin(2 * np.pi * turns)], axis=-1)

    def cut(self, correction: MapFunction, direction: int, rng: np.random.Generator) -> FloatArray:
        def lookup(at: FloatArray, _way: int) -> FloatArray:
            return _finite(correction(at[:, 0], at[:, 1]), at[:, 0], "correction")

        p = self.places
        if self.speed == 0.0:
            c = lookup(p, direction)
        else:
            turns = np.arange(p.shape[0]) / self.points_per_turn
            c = self.servo.output(
                lookup, lambda t: self._spiral(t * self.speed), turns / self.speed, direction
            )
        left = _play(self.servo.rounded(c), self.lost_motion, 0)
        left = left + _finite(self.error(p[:, 0], p[:, 1]), p[:, 0], "error")
        return self._noisy(left, rng)


LoopMachine = AxisMachine | FaceMachine


_NOISE = ("lost_motion", "repeatability", "measuring_noise")


def _settle(
    machine: Any, quantities: Mapping[str, str], check: Callable[..., float] = numbers.not_negative
) -> None:
    """Store quantities of a frozen object in SI, by their dimensions."""
    for name, dimension in quantities.items():
        object.__setattr__(machine, name, check(getattr(machine, name), name, dimension=dimension))


def _finite(values: Any, places: FloatArray, name: str) -> FloatArray:
    array = np.asarray(values, dtype=np.float64)
    if array.shape not in (places.shape, ()):
        raise InvalidSamplesError(
            f"the {name} gives shape {array.shape} for {places.size} places; one value a place"
        )
    array = np.broadcast_to(array, places.shape)
    bad = np.flatnonzero(~np.isfinite(array))
    if bad.size:
        raise InvalidSamplesError(
            f"the {name} is not finite at {places[int(bad[0])] * 1e3:.9g} mm ({bad.size} of "
            f"{places.size} places): narrow the travel to what is known"
        )
    return array


def _play(motor: FloatArray, play: float, direction: int) -> FloatArray:
    """Return where an axis with play stands; direction 0 begins in the middle of the play."""
    if play == 0.0:
        return motor
    half = 0.5 * play
    stands = np.empty_like(motor)
    at = float(motor[0]) - direction * half
    for i, m in enumerate(motor.tolist()):
        at = min(max(at, m - half), m + half)
        stands[i] = at
    return stands
