"""`ReferenceLine`: runs along a reference separated into its alignment and straightness error.

``reading_r(x) = straightness(x) + reference(x) + a_r + b_r x``; error = actual - nominal, positive
away from the material. The line is how the reference lies (ISO 230-1).
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, ClassVar, Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray

from metrosep.core._arrays import FloatArray, frozen_float
from metrosep.core.errors import DataError, InvalidSamplesError
from metrosep.core.provenance import Step
from metrosep.separation._method_parts import known_parts, part_of
from metrosep.separation._readings import (
    as_numbers,
    average_repeats,
    checked_readings,
    left_share,
    line_basis,
    size_doubts,
)
from metrosep.separation.contract import Separation, SeparationMethod
from metrosep.separation.iso230_straightness import MotionStraightness, straightness_iso230_1
from metrosep.separation.null_space import Unobservable

__all__ = ["ReferenceLine"]


_LINE = "offset and slope are how the reference lies; measure the alignment otherwise"
_FORM = "the form of the reference reads like the axis: reverse it (straightedge_reversal)"


@dataclass(frozen=True, slots=True)
class ReferenceLine(SeparationMethod):
    """Runs along a straightedge, a wire or a beam, at the same positions.

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

    Examples
    --------
    >>> found = ReferenceLine((0.0, 0.1, 0.2, 0.3), "EP").separate([[0.0, 3e-6, 3e-6, 3e-6]])
    >>> (found.straightness * 1e6).round(6).tolist()
    [0.0, 2.0, 1.0, 0.0]
    """

    x: tuple[float, ...]
    line: Literal["LS", "EP"] = "LS"

    name: ClassVar[str] = "reference_line"
    truth_parts: ClassVar[tuple[str, ...]] = ("reference",)
    error_parts: ClassVar[tuple[str, ...]] = ("straightness",)

    def __post_init__(self) -> None:
        x = frozen_float(self.x, name="x", ndim=1, min_size=4)
        if not (np.isfinite(x).all() and (np.diff(x) > 0.0).all()):
            raise InvalidSamplesError(f"{self.name}: positions must be finite and rising, in m")
        if self.line not in ("LS", "EP"):
            raise DataError(f"line is 'LS' or 'EP', got {self.line!r}")

    def simulate(
        self, truth: Mapping[str, ArrayLike], errors: Mapping[str, ArrayLike]
    ) -> FloatArray:
        """Return one run, the reference aligned.

        Parameters
        ----------
        truth : mapping of str to array_like, shape (n,), m
            ``reference``: form of the reference, in the sense of the reading.
        errors : mapping of str to array_like, shape (n,), m
            ``straightness`` error of the axis.

        Returns
        -------
        ndarray, shape (1, n), m
            Reading.

        Raises
        ------
        DataError
            If a part is unknown, none is given, or of another shape.
        """
        parts = known_parts(self, truth, errors)
        shape = (len(self.x),)
        both = [part_of(parts, n, shape, self.name) for n in ("straightness", "reference")]
        return np.asarray(both[0] + both[1])[np.newaxis]

    def null_space(self) -> tuple[Unobservable, ...]:
        """Return what one reference cannot tell.

        Returns
        -------
        tuple of Unobservable
            Offset and slope, and the form of the reference.
        """
        return (
            Unobservable("straightness", "polynomial", (0, 1), _LINE),
            Unobservable("reference", "term", ("all of it",), _FORM),
        )

    def separate(
        self,
        readings: ArrayLike,
        *,
        u_reading: float | None = None,
        history: tuple[Step, ...] = (),
    ) -> Separation:
        """Return the straightness error at each position.

        Parameters
        ----------
        readings : array_like, shape (M, n), m
            Runs; NaN = not measured.
        u_reading : float, m, optional
            Standard uncertainty of one reading; the scatter of the runs about their lines if
            omitted.
        history : tuple of Step, optional
            Where they came from.

        Returns
        -------
        Separation
            Parts ``straightness`` (n,) and ``reference`` (n,) NaN: it is not seen. The values after
            ISO 230-1 (minimum zone, least squares, end points) are in the audit.

        Raises
        ------
        DataError
            If `u_reading` is negative or no number.
        InvalidSamplesError
            If the readings have another shape or are infinite.
        TooFewSamplesError
            If fewer than 4 positions were measured.

        Notes
        -----
        `straightness_iso230_1` does the work on the mean of the runs, and gives each value its
        uncertainty and bias. Noise s of M runs: ``u = s sqrt((1 - h)/M)``, h the leverage of the
        line; from end points ``s sqrt((1 + t^2 + (1 - t)^2)/M)``, t = 0 ... 1 between them, where u
        is 0 by definition.
        """
        array = as_numbers(readings, f"{self.name} needs runs (M, n) as numbers")
        if array.ndim != 2 or array.shape[1] != len(self.x):
            raise InvalidSamplesError(
                f"{self.name} needs runs at the {len(self.x)} positions, shape (M, {len(self.x)}), "
                f"got {array.shape}"
            )
        array = checked_readings(array[np.newaxis], names=("runs",), minimum=4, what=self.name)
        x = np.array(self.x)
        averaged = average_repeats(array, line_basis(x), u_reading=u_reading)
        mean, count = averaged.mean[0], averaged.counts[0]
        sheet = straightness_iso230_1(x, mean, reference=self.line)
        valid = ~np.isnan(mean)
        share = left_share(valid, line_basis(x))
        if self.line == "EP":
            share = _end_point_share(x, valid, count)
        else:
            share = share / np.maximum(count, 1.0)
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
                *size_doubts(array, self.name),
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
