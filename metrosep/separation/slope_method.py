"""`SlopeIntegration`: slopes along an artefact separated into its heights and the zero of the sensor.

``slope_r(x) = dz/dx + zero_r``; for a sledge on two feet ``(z(x + step) - z(x)) / step + zero_r``.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import ClassVar

import numpy as np
from numpy.typing import ArrayLike

from metrosep.core._arrays import FloatArray, frozen_float
from metrosep.core.errors import DataError, InvalidSamplesError
from metrosep.core.provenance import Step
from metrosep.separation._line_request import method_named
from metrosep.separation._method_parts import known_parts, stated_u
from metrosep.separation._readings import as_numbers
from metrosep.separation._slope_rules import heights_at
from metrosep.separation.contract import Separation, SeparationMethod
from metrosep.separation.null_space import Unobservable
from metrosep.separation.slope_integration import RULES, integrate_slopes

__all__ = ["SlopeIntegration"]


_HEIGHT = "slopes do not tell the height"
_LINE = "; the zero of the angle sensor is a line: calibrate it, then say zero_known=True"
_ZERO = "the zero of the sensor and the line of the artefact read alike"
_KNOWN = "the zero is taken as known: what is wrong with it tilts the heights"


@dataclass(frozen=True, slots=True)
class SlopeIntegration(SeparationMethod):
    """An angle sensor that is moved along an artefact.

    Parameters
    ----------
    x : tuple of float, m
        At least 4 positions of the slopes, rising; for "feet" of the rear foot.
    method : {"spline", "trapezoid", "simpson", "fourier", "feet"}, optional
        As for `integrate_slopes`; "feet" is exact.
    zero_known : bool, optional
        Whether the zero of the sensor is known. If not, the line is left out.

    Raises
    ------
    DataError
        If the rule is unknown.
    InvalidSamplesError
        If the positions are not finite and rising.
    TooFewSamplesError
        If there are fewer than 4.

    Examples
    --------
    >>> method = SlopeIntegration((0.0, 0.1, 0.2, 0.3), "feet", zero_known=True)
    >>> slopes = method.simulate({"height": [2e-6, 1e-6, -4e-6, 3e-6, -2e-6]}, {})
    >>> (method.separate(slopes).height * 1e6).round(6).tolist()
    [2.0, 1.0, -4.0, 3.0, -2.0]
    """

    x: tuple[float, ...]
    method: str = "spline"
    zero_known: bool = False

    name: ClassVar[str] = "integrate_slopes"
    truth_parts: ClassVar[tuple[str, ...]] = ("height",)
    error_parts: ClassVar[tuple[str, ...]] = ("zero",)

    def __post_init__(self) -> None:
        object.__setattr__(self, "method", method_named(self.method, RULES, self.name))
        x = frozen_float(self.x, name="x", ndim=1, min_size=4)
        if not (np.isfinite(x).all() and (np.diff(x) > 0.0).all()):
            raise InvalidSamplesError(f"{self.name}: positions must be finite and rising, in m")

    def simulate(
        self, truth: Mapping[str, ArrayLike], errors: Mapping[str, ArrayLike]
    ) -> FloatArray:
        """Return the slopes of one pass.

        Parameters
        ----------
        truth : mapping of str to array_like, shape (n,), m
            ``height`` at the positions, (n + 1,) for "feet": one step beyond the last.
        errors : mapping of str to array_like, scalar, rad
            ``zero`` of the sensor; NaN is not known and adds nothing.

        Returns
        -------
        ndarray, shape (1, n), rad
            Slopes.

        Raises
        ------
        DataError
            If a part is unknown, none is given, or of another shape.

        Notes
        -----
        But for "feet" the slope is that of the cubic spline through the heights: exact for cubics,
        good for waves above some ten steps.
        """
        parts = known_parts(self, truth, errors)
        x = np.array(self.x)
        zero = parts.get("zero", np.zeros(()))
        if zero.ndim:
            raise DataError(f"{self.name}: the zero of the sensor is one number, got {zero.shape}")
        slopes = np.full(x.size, float(np.nan_to_num(zero, nan=0.0)))
        if "height" in parts:
            at = heights_at(x, self.method)
            height = parts["height"]
            if height.shape != at.shape or not np.isfinite(height).all():
                raise DataError(
                    f"{self.name}: the height must hold {at.size} finite values, got the shape "
                    f"{height.shape}"
                )
            slopes += self._slopes(at, height)
        return slopes[np.newaxis]

    def _slopes(self, at: FloatArray, height: FloatArray) -> FloatArray:
        if self.method == "feet":
            return np.asarray(np.diff(height) / np.diff(at))
        from scipy.interpolate import CubicSpline

        return np.asarray(CubicSpline(at, height)(at, 1))

    def null_space(self) -> tuple[Unobservable, ...]:
        """Return what slopes cannot tell.

        Returns
        -------
        tuple of Unobservable
            The height, with an unknown zero the line; the zero itself.
        """
        degrees, more = ((0,), "") if self.zero_known else ((0, 1), _LINE)
        return (
            Unobservable("height", "polynomial", degrees, _HEIGHT + more),
            Unobservable("zero", "term", ("all of it",), _KNOWN if self.zero_known else _ZERO),
        )

    def separate(
        self,
        readings: ArrayLike,
        *,
        u_reading: float | None = None,
        history: tuple[Step, ...] = (),
    ) -> Separation:
        """Return the heights.

        Parameters
        ----------
        readings : array_like, shape (M, n), rad
            Slopes of M passes, positive where the surface rises with x; NaN = not measured.
        u_reading : float, rad, optional
            Standard uncertainty of one slope; the scatter of the passes if omitted.
        history : tuple of Step, optional
            Where they came from.

        Returns
        -------
        Separation
            Parts ``height`` and ``zero`` (NaN: it is not seen).

        Raises
        ------
        DataError
            If `u_reading` is negative or no number.
        InvalidSamplesError
            If the slopes are no numbers, infinite or of another shape.
        NotUniformError
            If the rule needs equal steps.
        TooFewSamplesError
            If fewer than 4 slopes in a row were measured.
        UnitError
            If the slopes are beyond 0.5 rad.

        Notes
        -----
        `integrate_slopes` does the work: its u is that of white noise.
        """
        stated = stated_u(u_reading, "rad")
        array = as_numbers(readings, f"{self.name} needs slopes (M, n) as numbers")
        if array.ndim != 2 or array.shape[1] != len(self.x):
            raise InvalidSamplesError(
                f"{self.name} needs slopes at the {len(self.x)} positions, shape (M, {len(self.x)}), "
                f"got {array.shape}"
            )
        found = integrate_slopes(
            array, self.x, method=self.method, u_slope=stated, zero_known=self.zero_known
        )
        unknown = np.array(np.nan)
        cut = tuple(item for item in found.null_space if item.kind == "samples")
        return replace(
            found,
            parts={**found.parts, "zero": unknown},
            u={**found.u, "zero": unknown},
            units={**found.units, "zero": "rad"},
            null_space=(*self.null_space(), *cut),
            messages=tuple(m.replace("u_slope", "u_reading") for m in found.messages),
            history=(*history, *found.history),
        )
