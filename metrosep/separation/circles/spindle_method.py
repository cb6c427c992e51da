"""`SpindleSplit`: revolutions of a spindle split into setting, synchronous and asynchronous motion.

``reading_m(theta) = setting(theta) + synchronous(theta) + asynchronous_m(theta)`` of one sensor that
stands still. The setting of the artefact is its distance and, in radial motion, its eccentricity.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import ClassVar, Literal

import numpy as np
from numpy.typing import ArrayLike

from metrosep.core._arrays import FloatArray
from metrosep.core.errors import DataError, InvalidSamplesError
from metrosep.core.numbers import choice, not_negative, real
from metrosep.core.provenance import Step
from metrosep.core.quantity import Quantity
from metrosep.separation._methods import RecordedMethod, settle
from metrosep.separation._readings import (
    as_numbers,
    checked_readings,
    harmonics_of,
    harmonics_u,
    known_parts,
    part_of,
)
from metrosep.separation.circles.spindle import iso230_7
from metrosep.separation.circles.spindle_result import SpindleMotion
from metrosep.separation.contract import Separation, Unobservable

__all__ = ["SpindleSplit"]


_ECCENTRIC = "mean and once-per-revolution are how the artefact is set: a fixed sensor cannot tell"
_ZERO = "the zero of the sensor is arbitrary"
_FORM = (
    "the form of the artefact is in every revolution alike: reverse it (donaldson) or use several "
    "probes (multiprobe)"
)
_MEAN = "what all revolutions share is synchronous by definition"


@dataclass(frozen=True, slots=True)
class SpindleSplit(RecordedMethod):
    """One fixed sensor over whole revolutions, after ISO 230-7, about the least-squares centre.

    Readings (M, n) in m: at least 2 revolutions at the same n angles; one with a NaN is left out.
    Parts: ``setting`` and ``synchronous``, (n,), over the angle; ``asynchronous``, (M, n), of each
    revolution (two revolutions are simulated where it is not given).

    Parameters
    ----------
    direction : {"radial", "axial", "face"}, optional
        What the sensor measures. Radial: once-per-revolution is the setting of the artefact. Tilt
        is radial motion of the two sensors' difference over their distance.
    start : float, rad, optional
        Angle of the first sample.

    Raises
    ------
    DataError
        If the direction is unknown or the start no finite number.

    Notes
    -----
    `iso230_7` does the work; values after the standard (widths, with their u) are there. With
    white scatter s: ``s sqrt((1 - p/n)/M)`` for the synchronous motion, p = 3 functions of the
    setting (1 in axial motion), ``s sqrt(1 - 1/M)`` for the asynchronous.

    Examples
    --------
    >>> t = 2 * np.pi * np.arange(64) / 64
    >>> found = SpindleSplit().separate(np.tile(5e-6 * np.cos(t) + 1e-8 * np.cos(2 * t), (4, 1)))
    >>> bool(abs(found.synchronous - 1e-8 * np.cos(2 * t)).max() < 1e-18), found.suppressed
    (True, [0, 1])
    """

    direction: Literal["radial", "axial", "face"] = "radial"
    start: float = 0.0

    name: ClassVar[str] = "spindle_split"
    truth_parts: ClassVar[tuple[str, ...]] = ("setting",)
    error_parts: ClassVar[tuple[str, ...]] = ("synchronous", "asynchronous")

    def __post_init__(self) -> None:
        choice(self.direction, "direction", ("radial", "axial", "face"))
        settle(self, start=real(self.start, "start", dimension="angle"))

    @property
    def _hidden(self) -> tuple[int, ...]:
        return (0, 1) if self.direction == "radial" else (0,)

    def simulate(
        self, truth: Mapping[str, ArrayLike], errors: Mapping[str, ArrayLike]
    ) -> FloatArray:
        parts = known_parts(self, truth, errors)
        shape = parts["asynchronous"].shape if "asynchronous" in parts else None
        if shape is None:
            shape = (2, next(iter(parts.values())).size)
        if len(shape) != 2:
            raise DataError(
                f"{self.name}: asynchronous has the shape (revolutions, n), got {shape}"
            )
        setting, synchronous = (
            part_of(parts, n, shape[1:], self.name) for n in ("setting", "synchronous")
        )
        return setting + synchronous + part_of(parts, "asynchronous", shape, self.name)

    def null_space(self) -> tuple[Unobservable, ...]:
        reason = _ECCENTRIC if self.direction == "radial" else _ZERO
        return (
            Unobservable("synchronous", "harmonic", self._hidden, reason),
            Unobservable("synchronous", "term", ("form of the artefact",), _FORM),
            Unobservable("asynchronous", "term", ("mean revolution",), _MEAN),
        )

    def separate(
        self,
        readings: ArrayLike,
        *,
        u_reading: float | None = None,
        history: tuple[Step, ...] = (),
    ) -> Separation:
        sd = u_reading
        if sd is not None:
            sd = not_negative(sd, "u_reading", dimension="length")
        array = as_numbers(readings, f"{self.name} needs revolutions (M, n) as numbers")
        if array.ndim != 2:
            raise InvalidSamplesError(
                f"{self.name} needs revolutions at the same angles, shape (M, n), got {array.shape}"
            )
        array = checked_readings(array[None], names=("sensor",), minimum=8, what=self.name)
        _, count, n = array.shape
        angle = self.start + 2 * np.pi * np.arange(n) / n
        motion = iso230_7(array[0], angle, self.direction)
        mean = array[0, motion.revolutions].mean(axis=0)
        rest = np.full((count, n), np.nan)
        rest[motion.revolutions] = array[0, motion.revolutions] - mean
        curve = motion.synchronous_motion
        parts = {"setting": mean - curve, "synchronous": curve, "asynchronous": rest}
        noise = _noise(rest, motion.n_revolutions, sd)
        whole = array[:, motion.revolutions]
        coefficients = harmonics_of(curve, start=self.start, hidden=self._hidden)
        spread = np.where(
            np.isfinite(coefficients), harmonics_u(whole, np.ones(1), noise.value), np.nan
        )
        return Separation(
            self.name,
            parts,
            _uncertainties(rest, motion.n_revolutions, 2 * len(self._hidden) - 1, noise.value),
            dict.fromkeys(parts, "m"),
            {"angle": angle},
            self.null_space(),
            noise=noise,
            harmonics={"synchronous": coefficients},
            harmonics_u={"synchronous": spread},
            audit=_audit(motion),
            messages=motion.messages,
            history=(*history, Step(self.name, {"direction": self.direction})),
        )


def _noise(rest: FloatArray, n_revolutions: int, sd: float | None) -> Quantity:
    if sd is not None:
        return Quantity(sd, "m", "standard uncertainty of one reading, as stated", symbol="s")
    freedom = (n_revolutions - 1) * rest.shape[1]
    value = math.sqrt(float(np.nansum(rest**2)) / freedom)
    text = (
        f"standard deviation of one reading over {n_revolutions} revolutions, asynchronous motion "
        "included"
    )
    return Quantity(value, "m", text, u=value / math.sqrt(2.0 * freedom), symbol="s")


def _uncertainties(rest: FloatArray, m: int, p: int, s: float) -> dict[str, FloatArray]:
    n = rest.shape[1]
    return {
        "setting": np.full(n, s * math.sqrt(p / (n * m))),
        "synchronous": np.full(n, s * math.sqrt((1.0 - p / n) / m)),
        "asynchronous": np.where(np.isnan(rest), np.nan, s * math.sqrt(1.0 - 1.0 / m)),
    }


def _audit(motion: SpindleMotion) -> dict[str, object]:
    shown = {
        f"{key}_nm": motion[key].value * 1e9 for key in ("synchronous", "asynchronous", "total")
    }
    return {
        "direction": motion.direction,
        "center": motion.center,
        "revolutions_used": motion.n_revolutions,
        "n_angles": int(motion.angle.size),
        "removed": motion.audit["removed"],
        **shown,
    }
