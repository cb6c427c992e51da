"""`PositioningSheet`: the runs of an ISO 230-2 test separated into mean deviations and scatter.

``deviation_r(x_i) = forward_i or backward_i + reference_i + scatter``; deviation = position reached
minus target, as the reference instrument reads it.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, ClassVar, Literal

import numpy as np
from numpy.typing import ArrayLike

from metrosep.core._arrays import FloatArray, frozen_float
from metrosep.core.errors import DataError, InvalidSamplesError, TooFewSamplesError
from metrosep.core.provenance import Step
from metrosep.core.quantity import Quantity
from metrosep.separation._method_parts import known_parts, part_of, stated_u
from metrosep.separation._readings import checked_readings
from metrosep.separation.contract import Separation, SeparationMethod
from metrosep.separation.null_space import Unobservable
from metrosep.separation.positioning import iso230_2
from metrosep.separation.positioning_result import PositioningTest

__all__ = ["PositioningSheet"]


_REFERENCE = (
    "what the reference instrument reads wrong (dead path, cosine, its own temperature) reads like "
    "the axis: calibrate it, or measure with another one"
)
_THERMAL = (
    "what all runs of one thermal state share, and errors between the targets, count as the axis or "
    "are not sampled: warm up otherwise, add a random part to each target"
)


@dataclass(frozen=True, slots=True)
class PositioningSheet(SeparationMethod):
    """Runs over targets in one direction or both.

    Parameters
    ----------
    targets : tuple of float, m or rad
        At least 2, rising.
    directions : tuple of {"forward", "backward"}, optional
        What the readings hold, in this order.
    unit : {"m", "rad"}, optional
        Of targets and deviations.

    Raises
    ------
    DataError
        If a direction is unknown or stands twice, there is none, or the unit is unknown.
    InvalidSamplesError
        If the targets are not finite and rising.

    Examples
    --------
    >>> method = PositioningSheet((0.0, 0.1))
    >>> runs = [[[1e-6, 3e-6], [2e-6, 3e-6]], [[0.0, 1e-6], [0.0, 2e-6]]]
    >>> found = method.separate(runs)
    >>> (found.forward * 1e6).round(6).tolist(), (found.backward * 1e6).round(6).tolist()
    ([1.5, 3.0], [0.0, 1.5])
    """

    targets: tuple[float, ...]
    directions: tuple[Literal["forward", "backward"], ...] = ("forward", "backward")
    unit: Literal["m", "rad"] = "m"

    name: ClassVar[str] = "positioning_sheet"
    truth_parts: ClassVar[tuple[str, ...]] = ("reference",)
    error_parts: ClassVar[tuple[str, ...]] = ("forward", "backward")

    def __post_init__(self) -> None:
        goals = frozen_float(self.targets, name="targets", ndim=1, min_size=2)
        if not (np.isfinite(goals).all() and (np.diff(goals) > 0.0).all()):
            raise InvalidSamplesError(f"{self.name}: targets must be finite and rising")
        if not self.directions or tuple(self.directions) not in _DIRECTIONS:
            raise DataError(
                f"directions are 'forward' and 'backward', each once, got {self.directions!r}"
            )
        if self.unit not in ("m", "rad"):
            raise DataError(f"unit is 'm' or 'rad', got {self.unit!r}")

    def simulate(
        self, truth: Mapping[str, ArrayLike], errors: Mapping[str, ArrayLike]
    ) -> FloatArray:
        """Return the deviations of one run in each direction.

        Parameters
        ----------
        truth : mapping of str to array_like, shape (n,), m or rad
            ``reference``: what the instrument reads too much at each target.
        errors : mapping of str to array_like, shape (n,), m or rad
            ``forward`` and ``backward``: systematic deviations of the axis.

        Returns
        -------
        ndarray, shape (n_directions, n), m or rad
            Position reached minus target.

        Raises
        ------
        DataError
            If a part is unknown, none is given, of another shape, or of a direction that is not
            measured.
        """
        parts = known_parts(self, truth, errors)
        missing = [n for n in errors if n not in self.directions]
        if missing:
            raise DataError(f"{self.name}: the direction {missing[0]!r} is not measured here")
        shape = (len(self.targets),)
        read = part_of(parts, "reference", shape, self.name)
        return np.stack([part_of(parts, way, shape, self.name) + read for way in self.directions])

    def null_space(self) -> tuple[Unobservable, ...]:
        """Return what the sheet cannot tell.

        Returns
        -------
        tuple of Unobservable
            The reference instrument, and what all runs share.
        """
        return (
            Unobservable("reference", "term", ("all of it",), _REFERENCE),
            *(Unobservable(w, "term", ("common to all runs",), _THERMAL) for w in self.directions),
        )

    def separate(
        self,
        readings: ArrayLike,
        *,
        u_reading: float | None = None,
        history: tuple[Step, ...] = (),
    ) -> Separation:
        """Return the mean deviation of each direction.

        Parameters
        ----------
        readings : array_like, shape (n_directions, M, n), m or rad
            Deviations of M >= 2 runs; NaN = not measured.
        u_reading : float, m or rad, optional
            Standard uncertainty of one reading; the scatter of the runs at each target if omitted.
        history : tuple of Step, optional
            Where they came from.

        Returns
        -------
        Separation
            Parts ``forward``, ``backward`` (n,), ``reference`` (n,) NaN: it is not seen. The values
            of the standard (A, E, R, B, M) are in the audit.

        Raises
        ------
        DataError
            If `u_reading` is negative or no number.
        InvalidSamplesError
            If the readings have another shape, are infinite, or larger than the step of the targets.
        TooFewSamplesError
            If there is one run only, or a direction was not measured.

        Notes
        -----
        `iso230_2` does the work; a target with fewer than 2 readings in a direction is NaN there.
        ``u = s_i / sqrt(M)`` with the standard deviation s_i of each target, as the standard has it;
        with `u_reading` that instead. It holds the scatter of the runs only.
        """
        stated = stated_u(u_reading, self.unit)
        array = checked_readings(readings, names=self.directions, minimum=2, what=self.name)
        goals = np.array(self.targets)
        if array.shape[2] != goals.size:
            raise InvalidSamplesError(
                f"{self.name}: there are {goals.size} targets and readings at {array.shape[2]}"
            )
        if array.shape[1] < 2:
            raise TooFewSamplesError(
                f"{self.name}: one run shows no repeatability; 2 are needed, ISO 230-2 asks for 5"
            )
        runs = dict(zip(self.directions, array, strict=True))
        reached = {way: (goals + rows).T for way, rows in runs.items()}
        sheet = iso230_2(goals, reached.get("forward"), reached.get("backward"), unit=self.unit)
        parts: dict[str, FloatArray] = {"reference": np.full(goals.size, np.nan)}
        u = {"reference": np.full(goals.size, np.nan)}
        squares, freedom = 0.0, 0.0
        for way, rows in runs.items():
            count = (~np.isnan(rows)).sum(axis=0)
            used = count > 1
            mean = np.where(used, np.nansum(rows, axis=0) / np.maximum(count, 1), np.nan)
            rest = np.nansum((rows - mean) ** 2, axis=0)
            sd = np.sqrt(rest / np.maximum(count - 1, 1)) if stated is None else stated
            parts[way] = mean
            u[way] = np.where(used, sd / np.sqrt(np.maximum(count, 1)), np.nan)
            squares += float(rest[used].sum())
            freedom += float((count[used] - 1).sum())
        return Separation(
            self.name,
            parts,
            u,
            dict.fromkeys(parts, self.unit),
            {"x" if self.unit == "m" else "angle": goals},
            self.null_space(),
            noise=_noise(squares, freedom, stated, self.unit),
            audit=_audit(sheet, self.unit),
            messages=sheet.messages,
            history=(*history, Step(self.name, {"n_targets": int(goals.size), "unit": self.unit})),
        )


_DIRECTIONS = (
    ("forward",),
    ("backward",),
    ("forward", "backward"),
    ("backward", "forward"),
)


def _noise(squares: float, freedom: float, stated: float | None, unit: str) -> Quantity:
    if stated is not None:
        return Quantity(stated, unit, "standard uncertainty of one reading, as stated", symbol="s")
    value = math.sqrt(squares / freedom)
    text = "standard deviation of one reading, pooled over targets and directions (type A)"
    return Quantity(value, unit, text, u=value / math.sqrt(2.0 * freedom), symbol="s")


def _audit(sheet: PositioningTest, unit: str) -> dict[str, Any]:
    suffix = "um" if unit == "m" else "urad"
    shown = {
        f"{key}_{suffix}": sheet[key].value * 1e6
        for key in ("A", "E", "R", "B", "M", "A_fwd", "E_fwd", "R_fwd", "A_bwd", "E_bwd", "R_bwd")
        if key in sheet
    }
    kept = ("n_targets", "n_runs_forward", "n_runs_backward")
    return {**{key: sheet.audit[key] for key in kept}, **shown}
