"""The two-dimensional sine grid, target of slow-tool-servo turning and of surface encoders."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal, Self

import numpy as np

from metrosep.core._arrays import FloatArray
from metrosep.core.errors import DegenerateFitError, TooFewSamplesError
from metrosep.core.numbers import positive
from metrosep.forms.base import Shape

Same = Literal["same"]


@dataclass(frozen=True, repr=False)
class SineGrid(Shape):
    """A sine along x plus a cosine along y.

    Parameters
    ----------
    amplitude : float or None, m
        Along x (and y): half the peak-to-valley height of a section. None: not known.
    wavelength : float or None, m
        Along x (and y), > 0. None: not known; a fit needs a starting value.
    amplitude_y : float, None or "same", m
        Along y; "same" ties it to `amplitude`.
    wavelength_y : float, None or "same", m
        Along y, > 0; "same" ties it to `wavelength`.
    phase_x, phase_y : float or None, rad
        Added to the arguments. ``phase_x=pi/2`` gives a cosine along x too.

    Raises
    ------
    DataError
        If a wavelength is not positive, or a value is not finite.

    Notes
    -----
    ``z = A_x sin(2 pi x / L_x + phase_x) + A_y cos(2 pi y / L_y + phase_y)``, Eq. (2) of [1]_ with
    the phases added. The peak-to-valley height of a map is ``2 (A_x + A_y)``: 200 nm for the 50 nm
    of [1]_. A shift by a wavelength changes nothing, and a phase acts like a shift: a fit of both
    is confounded. No domain.

    References
    ----------
    .. [1] Deterministic error compensation for slow tool servo-driven diamond turning, Eq. (2), with
       A = 50 nm and wavelength 100 um.

    Examples
    --------
    >>> SineGrid(amplitude=50e-9, wavelength=100e-6)(25e-6, 0.0).item()
    1e-07
    """

    amplitude: float | None = None
    wavelength: float | None = None
    amplitude_y: float | Same | None = "same"
    wavelength_y: float | Same | None = "same"
    phase_x: float | None = 0.0
    phase_y: float | None = 0.0

    name = "sine grid"
    has_centre = False

    def __post_init__(self) -> None:
        units = {"amplitude": "m", "wavelength": "m"}
        units |= {
            n: "m" for n in ("amplitude_y", "wavelength_y") if str(getattr(self, n)) != "same"
        }
        units |= {"phase_x": "rad", "phase_y": "rad"}
        self._set(units=units)
        super().__post_init__()
        for name, value in self.parameters.items():
            if value is not None and name.startswith("wavelength"):
                positive(value, name, dimension="length")

    @property
    def period(self) -> tuple[float, float]:
        # A shift by one of them changes nothing.
        (Lx,) = self._known("wavelength")
        return Lx, Lx if self.wavelength_y == "same" else self._known("wavelength_y")[0]

    def start(self, x: FloatArray, y: FloatArray, z: FloatArray) -> Self:
        # By linear regression with tilt and piston, whatever the lateral position.
        unknown = [k for k, v in self.parameters.items() if v is None]
        if not unknown or any(n.startswith("wavelength") for n in unknown):
            super().start(x, y, z)
            return self
        if z.size < 7:
            raise TooFewSamplesError(f"a sine grid needs at least 7 points to start, got {z.size}")
        spread = float(np.ptp(z))
        if spread == 0.0:
            raise DegenerateFitError("all heights are equal: there is no grid to find")
        Lx, Ly = self.period
        size = float(max(np.abs(x).max(), np.abs(y).max(), min(Lx, Ly)))
        a, b = (2.0 * math.pi / Lx) * x, (2.0 * math.pi / Ly) * y
        columns = [
            np.ones_like(x),
            x / size,
            y / size,
            np.sin(a),
            np.cos(a),
            np.cos(b),
            -np.sin(b),
        ]
        c = np.linalg.lstsq(np.stack(columns, axis=1), z / spread, rcond=1e-10)[0] * spread
        Ax, Ay = math.hypot(c[3], c[4]), math.hypot(c[5], c[6])
        guess = {
            "amplitude": 0.5 * (Ax + Ay) if self.amplitude_y == "same" else Ax,
            "amplitude_y": Ay,
            "phase_x": math.atan2(c[4], c[3]),
            "phase_y": math.atan2(c[6], c[5]),
        }
        return self.with_parameters(**{n: guess[n] for n in unknown})

    def _values(self) -> tuple[float, float, float, float]:
        """Return amplitude and wavelength along x, and along y."""
        Lx, Ly = self.period
        (Ax,) = self._known("amplitude")
        Ay = Ax if self.amplitude_y == "same" else self._known("amplitude_y")[0]
        return Ax, Lx, Ay, Ly

    def _angles(self, x: FloatArray, y: FloatArray) -> tuple[FloatArray, FloatArray]:
        _, Lx, _, Ly = self._values()
        phase_x, phase_y = self._known("phase_x", "phase_y")
        return (2.0 * math.pi / Lx) * x + phase_x, (2.0 * math.pi / Ly) * y + phase_y

    def height(self, x: FloatArray, y: FloatArray) -> FloatArray:
        Ax, _, Ay, _ = self._values()
        a, b = self._angles(x, y)
        return Ax * np.sin(a) + Ay * np.cos(b)

    def slopes(self, x: FloatArray, y: FloatArray) -> tuple[FloatArray, FloatArray]:
        Ax, Lx, Ay, Ly = self._values()
        a, b = self._angles(x, y)
        return (2.0 * math.pi * Ax / Lx) * np.cos(a), (-2.0 * math.pi * Ay / Ly) * np.sin(b)

    def _derivatives(self, x: FloatArray, y: FloatArray, names: Sequence[str]) -> list[FloatArray]:
        a, b = self._angles(x, y)
        found: list[FloatArray] = []
        for name in names:
            column = self._column(name, x, y, a, b)
            if name in ("amplitude", "wavelength") and getattr(self, f"{name}_y") == "same":
                column = column + self._column(f"{name}_y", x, y, a, b)
            found.append(column)
        return found

    def _column(
        self, name: str, x: FloatArray, y: FloatArray, a: FloatArray, b: FloatArray
    ) -> FloatArray:
        """Return the derivative by a parameter that acts along one axis only."""
        Ax, Lx, Ay, Ly = self._values()
        if name == "amplitude":
            return np.sin(a)
        if name == "amplitude_y":
            return np.cos(b)
        if name == "wavelength":
            return (-2.0 * math.pi * Ax / Lx**2) * x * np.cos(a)
        if name == "wavelength_y":
            return (2.0 * math.pi * Ay / Ly**2) * y * np.sin(b)
        return Ax * np.cos(a) if name == "phase_x" else -Ay * np.sin(b)
