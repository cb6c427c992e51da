"""`SpindleSplit`: revolutions of a spindle split into setting, synchronous and asynchronous motion.

``reading_m(theta) = setting(theta) + synchronous(theta) + asynchronous_m(theta)`` of one sensor that
stands still. The setting of the artefact is its distance and, in radial motion, its eccentricity.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import ArrayLike

from metrosep.core._arrays import FloatArray
from metrosep.core.errors import DataError, InvalidSamplesError
from metrosep.core.numbers import choice, real
from metrosep.core.provenance import Step
from metrosep.separation._methods import History, Parts, RecordedMethod, as_stated, settle, type_a
from metrosep.separation._readings import (
    as_numbers,
    checked_readings,
    harmonics_of,
    harmonics_u,
    known_parts,
    part_of,
)
from metrosep.separation.circles.spindle import iso230_7
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

    name = "spindle_split"
    truth_parts = ("setting",)
    error_parts = ("synchronous", "asynchronous")

    def __post_init__(self) -> None:
        choice(self.direction, "direction", ("radial", "axial", "face"))
        settle(self, start=real(self.start, "start", dimension="angle"))

    @property
    def _hidden(self) -> tuple[int, ...]:
        return (0, 1) if self.direction == "radial" else (0,)

    def simulate(self, truth: Parts, errors: Parts) -> FloatArray:
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

    def _solved(self, readings: ArrayLike, stated: float | None, history: History) -> Separation:
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
        m, p = motion.n_revolutions, 2 * len(self._hidden) - 1
        freedom = (m - 1) * n
        if stated is None:
            value = math.sqrt(float(np.nansum(rest**2)) / freedom)
            text = (
                f"standard deviation of one reading over {m} revolutions, asynchronous motion "
                "included"
            )
            noise = type_a(value, "m", text, freedom)
        else:
            noise = as_stated(stated, "m")
        s = noise.value
        u = {
            "setting": np.full(n, s * math.sqrt(p / (n * m))),
            "synchronous": np.full(n, s * math.sqrt((1.0 - p / n) / m)),
            "asynchronous": np.where(np.isnan(rest), np.nan, s * math.sqrt(1.0 - 1.0 / m)),
        }
        whole = array[:, motion.revolutions]
        coefficients = harmonics_of(curve, start=self.start, hidden=self._hidden)
        spread = np.where(
            np.isfinite(coefficients), harmonics_u(whole, np.ones(1), noise.value), np.nan
        )
        return Separation(
            self.name,
            parts,
            u,
            dict.fromkeys(parts, "m"),
            {"angle": angle},
            self.null_space(),
            noise=noise,
            harmonics={"synchronous": coefficients},
            harmonics_u={"synchronous": spread},
            audit={
                "direction": motion.direction,
                "center": motion.center,
                "revolutions_used": m,
                "n_angles": n,
                "removed": motion.audit["removed"],
                **{
                    f"{k}_nm": motion[k].value * 1e9
                    for k in ("synchronous", "asynchronous", "total")
                },
            },
            messages=motion.messages,
            history=(*history, Step(self.name, {"direction": self.direction})),
        )
