"""Orthogonal mixed method, a displacement probe and a slope probe; and methods combined per harmonic.

The displacement probe at 0 reads ``d = r(theta) + x``. The slope probe a quarter turn on reads the
angle of the surface, ``R s = r'(theta + pi/2) - x`` with R the radius: the part that moves by x
under it shows it a point of the circle that is steeper by -x/R. The sum is free of motion,
``d + R s = r(theta) + r'(theta + pi/2)``, and ``W_k = 1 + j k j^k``: its size is sqrt(1 + k^2) for
even k, k + 1 for k = 3 mod 4, k - 1 for k = 1 mod 4. Only k = 1 is lost.

Signs: as in `metrosep.separation.probes`; the slope is > 0 where the surface rises with the count
of the probe angles. With the turn -1 the artefact is ``r(theta - phi)``.

Source (from memory): W. Gao, S. Kiyono, T. Sugawara, Precision Engineering 21 (1997) 123; W_k was
derived anew.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import ClassVar, Literal

import numpy as np
from numpy.typing import ArrayLike

from metrosep.core._arrays import FloatArray
from metrosep.core.errors import DataError, UnitError
from metrosep.core.profile import Profile
from metrosep.core.provenance import Step
from metrosep.separation._circle import (
    centring,
    check_kmax,
    check_number,
    check_radius,
    check_start,
    check_turn,
    check_u_reading,
    curve,
    harmonics_of,
    part_arrays,
)
from metrosep.separation._circle_input import circle_readings, with_messages
from metrosep.separation._mixed_solution import PARTS, mixed_transfer, separate_mixed
from metrosep.separation.contract import Separation, SeparationMethod
from metrosep.separation.null_space import Unobservable

__all__ = ["OrthogonalMixed", "mixed_transfer", "orthogonal_mixed"]


@dataclass(frozen=True)
class OrthogonalMixed(SeparationMethod):
    """A displacement probe at 0 and a slope probe at 90 degrees round one section.

    Parameters
    ----------
    kmax : int
        Highest undulation per revolution, >= 2 and below half the samples.
    radius : float, m
        Of the artefact where the slope is read.
    u_slope : float, rad, optional
        Standard deviation of one reading of the slope; with `u_reading` it makes the uncertainty.
    u_angle : float, rad, optional
        Standard uncertainty of the quarter turn between the probes (type B). The motion across
        the displacement probe, which nobody reads, is taken to be as large as x.
    u_radius : float, m, optional
        Standard uncertainty of the radius (type B).
    turn : {1, -1}, optional
        +1: the part turns against the count of the probe angles.

    Raises
    ------
    DataError
        If a number is out of range.
    UnitError
        If `radius` looks like mm or `u_angle` like degrees.
    """

    kmax: int
    radius: float
    u_slope: float | None = None
    u_angle: float = 0.0
    u_radius: float = 0.0
    turn: Literal[1, -1] = 1

    name: ClassVar[str] = "orthogonal_mixed"
    truth_parts: ClassVar[tuple[str, ...]] = ("artefact",)
    error_parts: ClassVar[tuple[str, ...]] = ("x",)

    def __post_init__(self) -> None:
        object.__setattr__(self, "kmax", check_kmax(self.kmax))
        object.__setattr__(self, "radius", check_radius(self.radius))
        object.__setattr__(self, "turn", check_turn(self.turn))
        units = {"u_angle": "rad", "u_radius": "m", "u_slope": "rad"}
        for name, unit in units.items():
            value = getattr(self, name)
            if value is not None or name != "u_slope":
                object.__setattr__(self, name, check_number(value, name, unit=unit))
        if self.u_angle > 0.2:
            raise UnitError(f"u_angle of {self.u_angle} rad is too large; degrees? numpy.deg2rad")
        if self.u_radius > 0.5 * self.radius:
            raise DataError(f"u_radius of {self.u_radius} m does not fit a radius {self.radius} m")

    def simulate(
        self, truth: Mapping[str, ArrayLike], errors: Mapping[str, ArrayLike]
    ) -> FloatArray:
        """Return displacement and slope of given parts.

        Parameters
        ----------
        truth : mapping of str to array_like, shape (N,), m
            ``artefact``.
        errors : mapping of str to array_like, shape (N,), m
            ``x``: motion towards the displacement probe.

        Returns
        -------
        ndarray, shape (2, N)
            Displacement in m, slope in rad.

        Raises
        ------
        DataError
            If a part is unknown, none is given, or their lengths differ.
        """
        parts, n = part_arrays(PARTS, truth, errors)
        k = np.arange((n - 1) // 2 + 1)
        c = harmonics_of(parts["artefact"], int(k[-1]))
        rising = curve(1j * self.turn * k * np.exp(0.5j * np.pi * self.turn * k) * c, n)
        return np.stack([parts["artefact"] + parts["x"], (rising - parts["x"]) / self.radius])

    def null_space(self) -> tuple[Unobservable, ...]:
        """Return mean and eccentricity of both parts.

        Returns
        -------
        tuple of Unobservable
            Terms k = 0 and k = 1; no harmonic is suppressed.
        """
        return tuple(centring(part) for part in PARTS)

    def separate(
        self,
        readings: ArrayLike,
        *,
        u_reading: float | None = None,
        start_angle: float = 0.0,
        history: tuple[Step, ...] = (),
    ) -> Separation:
        """Return artefact and motion towards the displacement probe.

        Parameters
        ----------
        readings : array_like, shape (2, N) or (2, M, N)
            Displacement in m and slope in rad, over one revolution or M.
        u_reading : float, m, optional
            Standard deviation of one displacement reading; `u_slope` must be set too. The scatter
            of the revolutions if omitted.
        start_angle : float, rad, optional
            Angle of the first sample; ``harmonics`` are referred to the angle 0.
        history : tuple of Step, optional
            Where the readings came from.

        Returns
        -------
        Separation
            Parts ``artefact`` and ``x`` over ``angle``, with ``harmonics``.

        Raises
        ------
        InvalidSamplesError
            If the readings have another shape, are infinite, or no revolution is complete.
        TooFewSamplesError
            If kmax is not below half the samples.
        DataError
            If `u_reading` is negative, or given without `u_slope`.
        """
        stated = check_u_reading(u_reading)
        if stated is not None and self.u_slope is None:
            raise DataError("u_reading is given but u_slope is not; the result needs both noises")
        return separate_mixed(self, readings, stated, check_start(start_angle), history)


def orthogonal_mixed(
    displacement: ArrayLike | Profile,
    slope: ArrayLike | Profile,
    kmax: int,
    *,
    radius: float,
    u_reading: float | None = None,
    u_slope: float | None = None,
    u_angle: float = 0.0,
    u_radius: float = 0.0,
    turn: Literal[1, -1] = 1,
    angle: ArrayLike | None = None,
) -> Separation:
    """Return roundness and motion from a displacement probe and a slope probe at 90 degrees.

    Parameters
    ----------
    displacement : array_like, shape (N,) or (M, N), or Profile, m
        Readings of the probe at 0, over one revolution of N equal steps or M revolutions. The
        position of a profile is the angle of rotation in rad.
    slope : array_like, shape (N,) or (M, N), or Profile, rad
        Readings of the slope probe at 90 degrees, at the same angles of rotation.
    kmax : int
        Highest undulation per revolution, 2 <= kmax < N/2.
    radius : float, m
        Of the artefact.
    u_reading : float, m, optional
        Standard deviation of one displacement reading.
    u_slope : float, rad, optional
        Standard deviation of one slope reading.
    u_angle : float, rad, optional
        Standard uncertainty of the 90 degrees.
    u_radius : float, m, optional
        Standard uncertainty of the radius.
    turn : {1, -1}, optional
        +1: the part turns against the count of the probe angles; -1: with it.
    angle : array_like, shape (N,), rad, optional
        Angle of rotation at each sample of arrays; from 0 in equal steps if omitted.

    Returns
    -------
    Separation
        ``.artefact``, ``.x``; no harmonic from 2 to kmax is suppressed.

    Raises
    ------
    InvalidSamplesError
        If the readings differ in shape or are not finite.
    TooFewSamplesError
        If kmax is not below N/2.
    DataError
        If a setting is out of range.
    UnitError
        If `radius` looks like mm or `u_angle` like degrees.

    Notes
    -----
    ``R_k = (D_k + radius S_k) / W_k``, ``X_k = D_k - R_k``, ``W_k = 1 + j k j^k``: the noise of the
    artefact falls with k. Each of the harmonics k >= 2 has ``|W_k| >= sqrt(5)``.

    Examples
    --------
    >>> a = 2 * np.pi * np.arange(64) / 64
    >>> x = 20e-9 * np.cos(2 * a)
    >>> d, s = 50e-9 * np.cos(3 * a) + x, (-150e-9 * np.sin(3 * (a + np.pi / 2)) - x) / 0.02
    >>> found = orthogonal_mixed(d, s, 10, radius=0.02)
    >>> bool(np.abs(found.x - x).max() < 1e-20)
    True
    """
    method = OrthogonalMixed(kmax, radius, u_slope, u_angle, u_radius, turn)
    given = circle_readings([displacement, slope], what="orthogonal_mixed", angle=angle)
    found = method.separate(
        given.values, u_reading=u_reading, start_angle=given.start_angle, history=given.history
    )
    return with_messages(found, given.messages)
