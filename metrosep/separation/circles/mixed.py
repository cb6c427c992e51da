"""Orthogonal mixed method, a displacement probe and a slope probe; and methods combined per harmonic.

The displacement probe at 0 reads ``d = r(theta) + x``. The slope probe a quarter turn on reads the
angle of the surface, ``R s = r'(theta + pi/2) - x`` with R the radius: the part that moves by x
under it shows it a point of the circle that is steeper by -x/R. The sum is free of motion,
``d + R s = r(theta) + r'(theta + pi/2)``, and ``W_k = 1 + j k j^k``: its size is sqrt(1 + k^2) for
even k, k + 1 for k = 3 mod 4, k - 1 for k = 1 mod 4. Only k = 1 is lost.

Signs: as in `metrosep.separation.circles.probes`; the slope is > 0 where the surface rises with the count
of the probe angles. With the turn -1 the artefact is ``r(theta - phi)``.

Source (from memory): W. Gao, S. Kiyono, T. Sugawara, Precision Engineering 21 (1997) 123; W_k was
derived anew.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, ClassVar, Literal

import numpy as np
from numpy.typing import ArrayLike

from metrosep.core._arrays import ComplexArray, FloatArray
from metrosep.core.docs import described_by
from metrosep.core.errors import DataError, InvalidSamplesError
from metrosep.core.methods import Readings
from metrosep.core.numbers import count, not_negative
from metrosep.core.options import Option, option
from metrosep.core.profile import Profile
from metrosep.core.provenance import Step
from metrosep.core.quantity import Quantity
from metrosep.separation._readings import unit_message
from metrosep.separation.circles._circle import (
    CircleMethod,
    Revolutions,
    centred,
    check_radius,
    check_sign,
    check_small_angle,
    circle_readings,
    curve,
    harmonics_of,
    reading_noise,
    turn_option,
    unseen,
    variances,
)
from metrosep.separation.contract import (
    U_READING,
    Parts,
    Separation,
    Unobservable,
    over_turn,
    settle,
)


@dataclass(frozen=True)
class OrthogonalMixed(CircleMethod):
    """A displacement probe at 0 and a slope probe at 90 degrees round one section.

    Readings: displacement in m and slope in rad. Parts: ``artefact``; ``x``, motion towards the
    displacement probe. The uncertainty of a single revolution needs `u_reading` and `u_slope`.

    Parameters
    ----------
    u_slope : float, rad, optional
        Standard deviation of one reading of the slope; with `u_reading` it makes the uncertainty.
    u_angle : float, rad, optional
        Standard uncertainty of the quarter turn between the probes (type B). The motion across
        the displacement probe, which nobody reads, is taken to be as large as x.

    Raises
    ------
    DataError
        If a number is out of range.
    UnitError
        If `radius` looks like mm or `u_angle` like degrees.
    """

    kmax: int = option(
        kind="integer", help="highest undulation per revolution, >= 2 and below half the samples"
    )
    radius: float = option(kind="size", help="of the artefact where the slope is read")
    u_slope: float | None = option(
        None, kind="angle", help="standard deviation of one reading of the slope"
    )
    u_angle: float = option(
        0.0, kind="angle", help="standard uncertainty of the quarter turn between the probes"
    )
    u_radius: float = option(
        0.0, kind="uncertainty", help="standard uncertainty of the radius (type B)"
    )
    turn: Literal[1, -1] = turn_option()

    name = "orthogonal_mixed"
    what = "roundness and spindle motion from a displacement and a slope probe"
    readings = ("displacement",)
    over = "angle"
    roles: ClassVar[Mapping[str, str]] = {"slope": "angle"}
    arguments: ClassVar[Mapping[str, Option]] = U_READING
    truth_parts = ("artefact",)
    error_parts = ("x",)
    _sources: ClassVar[str] = "probes"
    _n_sources: ClassVar[int] = 2

    @classmethod
    def from_inputs(cls, data: Readings, options: Mapping[str, Any]) -> Separation:
        """Return the parts from the displacement and the column of the slope."""
        over_turn(data)
        if len(data.values) != 1:
            raise InvalidSamplesError(
                f"readings names one displacement probe, got {len(data.values)}; the slope probe is "
                'slope = "s_urad"'
            )
        displacement, slope = data.values[0], data.extra["slope"]
        if len(displacement) == 1:
            displacement, slope = displacement[0], slope[0]
        return orthogonal_mixed(displacement, slope, angle=data.position, **options)

    def __post_init__(self) -> None:
        slope = self.u_slope
        settle(
            self,
            kmax=count(self.kmax, "kmax", least=2),
            radius=check_radius(self.radius),
            u_slope=None if slope is None else not_negative(slope, "u_slope", dimension="angle"),
            u_angle=check_small_angle(self.u_angle, "u_angle"),
            u_radius=not_negative(self.u_radius, "u_radius", dimension="length"),
            turn=check_sign(self.turn, "turn"),
        )
        if self.u_radius > 0.5 * self.radius:
            raise DataError(f"u_radius of {self.u_radius} m does not fit a radius {self.radius} m")

    def simulate(self, truth: Parts, errors: Parts) -> FloatArray:
        parts = self._rows_of(truth, errors)
        n = parts["x"].size
        k = np.arange((n - 1) // 2 + 1)
        c = harmonics_of(parts["artefact"], int(k[-1]))
        rising = curve(1j * self.turn * k * np.exp(0.5j * np.pi * self.turn * k) * c, n)
        return np.stack([parts["artefact"] + parts["x"], (rising - parts["x"]) / self.radius])

    def null_space(self) -> tuple[Unobservable, ...]:
        return tuple(item for part in self._parts for item in unseen(part, (), ""))

    def _separated(
        self, given: Revolutions, stated: float | None, start: float, history: tuple[Step, ...]
    ) -> Separation:
        if stated is not None and self.u_slope is None:
            raise DataError("u_reading is given but u_slope is not; the result needs both noises")
        array = given.values
        messages = [*given.messages, *unit_message(centred(array[:1]), self.name)]
        slope_span = float(np.ptp(centred(array[1])))
        if slope_span > _LARGEST_SLOPE:
            messages.append(
                f"the slopes span {slope_span:.3g} rad; are they in rad? 5 urad is 5e-6"
            )
        each = harmonics_of(array, self.kmax) * np.array([1.0, self.radius])[:, None, None]
        mean, rows = each.mean(axis=1), _rows(self)
        found: ComplexArray = np.einsum("pik,ik->pk", rows, mean)
        noise, u_k = _noise(self, array, each, rows, stated)
        if math.isnan(noise.value):
            messages.append(_UNKNOWN)
        return self._result(
            given,
            found,
            noise,
            u_k,
            _type_b(self, rows, mean, found, array.shape[2]),
            start=start,
            settings={"kmax": self.kmax, "radius_mm": self.radius * 1e3, "turn": self.turn},
            audit={
                "transfer": [float(w) for w in np.abs(mixed_transfer(self.kmax))],
                "removed": "k = 0 and k = 1 of both parts, k > kmax",
                "not_read": _ACROSS,
                "noise_source": noise.definition,
            },
            messages=messages,
            step=Step(self.name, {"kmax": self.kmax, "radius_m": self.radius}),
            history=history,
        )


@described_by(OrthogonalMixed, OrthogonalMixed.separate)
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
    angle : array_like, shape (N,), rad, optional
        Angle of rotation at each sample of arrays; from 0 in equal steps if omitted.

    Returns
    -------
    Separation
        ``.artefact``, ``.x``; no harmonic from 2 to kmax is suppressed.

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
    return given.separated(method, u_reading)


# ---- transfer, noise and type B of `OrthogonalMixed` -------------------------------------------

_ACROSS = (
    "motion across the displacement probe (y) is not read by either probe; turn the set-up by 90 "
    "degrees for it"
)
_UNKNOWN = (
    "the noise is not known: give u_reading and u_slope, or repeated revolutions; no uncertainty "
    "is stated"
)

_PROBE = "displacement reading"

_LARGEST_SLOPE = 0.1
"""rad; no round part has a surface as steep, but urad given as rad do."""


def mixed_transfer(kmax: int, *, turn: Literal[1, -1] = 1) -> ComplexArray:
    """Return W_k of the orthogonal mixed method, ``1 + j k j^k``, for k = 0 ... kmax.

    Parameters
    ----------
    kmax : int
        Highest undulation per revolution, >= 2.
    turn : {1, -1}, optional
        -1 gives the complex conjugate.

    Returns
    -------
    ndarray of complex, shape (kmax + 1,)
        Zero at k = 1.

    Raises
    ------
    DataError
        If kmax is below 2.

    Examples
    --------
    >>> mixed_transfer(4)
    array([1.+0.j, 0.+0.j, 1.-2.j, 4.+0.j, 1.+4.j])
    """
    k = np.arange(count(kmax, "kmax", least=2) + 1)
    quarter = np.array([1, 1j, -1, -1j])[k % 4]
    w: ComplexArray = 1.0 + 1j * k * quarter
    return w if turn == 1 else w.conj()


def _rows(method: OrthogonalMixed) -> ComplexArray:
    """Return (part, reading, k): R = (D + S)/W, X = D - R, with S the slope times radius."""
    w = mixed_transfer(method.kmax, turn=method.turn)
    w[:2] = 1.0
    rows = np.stack([np.stack([1.0 / w, 1.0 / w]), np.stack([1.0 - 1.0 / w, -1.0 / w])])
    rows[:, :, :2] = np.nan
    return rows


def _noise(
    method: OrthogonalMixed,
    array: FloatArray,
    each: ComplexArray,
    rows: ComplexArray,
    stated: float | None,
) -> tuple[Quantity, FloatArray]:
    turns, n = array.shape[1:]
    if stated is not None and method.u_slope is not None:
        sd = np.array([stated, method.radius * method.u_slope])
        variance = np.einsum("pik,i->pk", np.abs(rows) ** 2, sd**2) * 2.0 / (n * turns)
        return reading_noise(stated, "as stated", of=_PROBE), np.sqrt(variance)
    if turns == 1:
        return reading_noise(math.nan, "not known", of=_PROBE), np.full(
            (2, method.kmax + 1), np.nan
        )
    about = each - each.mean(axis=1, keepdims=True)
    scatter = np.einsum("pik,imk->pmk", rows, about)
    variance = np.sum(np.abs(scatter) ** 2, axis=1) / (2.0 * (turns - 1) * turns)
    dof = (n - 3) * (turns - 1)
    value = math.sqrt(float(np.sum(centred(array[0] - array[0].mean(axis=0)) ** 2)) / dof)
    text = f"type A from {turns} revolutions, asynchronous motion included"
    u_k = np.sqrt(variance)
    return reading_noise(value, text, value / math.sqrt(2.0 * dof), of=_PROBE), u_k


def _type_b(
    method: OrthogonalMixed, rows: ComplexArray, mean: ComplexArray, found: ComplexArray, n: int
) -> dict[str, tuple[FloatArray, FloatArray]]:
    """Return variances of curves (2, N) and of harmonics (2, kmax + 1) of each term."""
    k = np.arange(method.kmax + 1)
    bent = -(k**2) * np.exp(0.5j * np.pi * method.turn * k) * found[0]
    across = 1j * found[1]
    out = {}
    for label, u, causes in (
        ("angle between the probes", method.u_angle, (bent, across)),
        ("radius", method.u_radius / method.radius, (mean[1],)),
    ):
        if u == 0.0:
            continue
        moved = np.stack([rows[:, 1] * cause * u for cause in causes], axis=1)
        out[label] = variances(moved, n)
    return out
