"""Multi-step roundness: the artefact is indexed on the spindle, the probe stays.

Model: ``m_p(theta) = r(theta + t alpha_p) + s(theta)``: r the artefact over its own angle, s what
the spindle adds in the direction of the probe, alpha_p the index position, t the turn: +1 when an
index step brings points of larger artefact angle to the probe.

With N equal steps the mean over the steps keeps the spindle and, of the artefact, the undulations
that are multiples of N: those are not separable, exactly those, and are NaN. Two runs of coprime
N1 and N2 together separate all undulations up to N1 N2 - 1. The mean (k = 0) is never separable.

Source: D. J. Whitehouse, J. Phys. E 9 (1976) 531; C. J. Evans et al., CIRP Annals 45 (1996) 617.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, ClassVar, Literal

import numpy as np
from numpy.typing import ArrayLike

from metrosep.core._arrays import FloatArray
from metrosep.core.errors import DataError, NotSeparableError, TooFewSamplesError, UnitError
from metrosep.core.provenance import Step
from metrosep.separation._circle import (
    angle_tuple,
    check_kmax,
    check_number,
    check_start,
    check_turn,
    check_u_reading,
    part_arrays,
    turned,
)
from metrosep.separation._circle_input import circle_readings, with_messages
from metrosep.separation._step_positions import index_positions
from metrosep.separation._step_solution import separate_steps, step_geometry
from metrosep.separation.contract import Separation, SeparationMethod
from metrosep.separation.null_space import Unobservable

__all__ = ["MultistepRoundness", "multistep"]


_PARTS = ("artefact", "spindle")


@dataclass(frozen=True)
class MultistepRoundness(SeparationMethod):
    """An artefact indexed to several angles on a spindle.

    Parameters
    ----------
    angles : sequence of float, shape (P,), P >= 2, rad
        Index positions, in the order of the readings.
    kmax : int
        Highest undulation per revolution, >= 2 and below half the samples.
    u_index : float, rad, optional
        Standard uncertainty of each index position, independent (type B).
    eccentricity : {"fixed", "free"}, optional
        ``"fixed"``: the artefact keeps its place on the index table, so k = 1 is separated like
        any other; ``"free"``: it was centred anew at each step, and k = 1 is left out.
    drift : {"none", "linear"}, optional
        ``"linear"``: a drift of the level in proportion to time, found from the means of
        consecutive revolutions, is taken off first.
    step_revolutions : float, optional
        Time from one step to the next, in revolutions, for the drift; the number of revolutions
        that were recorded if omitted.
    max_gain : float, optional
        An undulation whose noise is magnified more than this is called suppressed.
    turn : {1, -1}, optional
        +1: a step brings points of larger artefact angle to the probe.

    Raises
    ------
    TooFewSamplesError, InvalidSamplesError
        If there are fewer than 2 angles, or they are not finite.
    UnitError
        If the angles or `u_index` look like degrees.
    DataError
        If another setting is out of range.
    NotSeparableError
        If the positions separate no undulation.

    Examples
    --------
    >>> method = MultistepRoundness(2 * np.pi * np.arange(8) / 8, 30)
    >>> [item.indices for item in method.null_space() if item.part == "artefact"][1]
    (8, 16, 24)
    """

    angles: Any
    kmax: int
    u_index: float = 0.0
    eccentricity: Literal["fixed", "free"] = "fixed"
    drift: Literal["none", "linear"] = "none"
    step_revolutions: float | None = None
    max_gain: float = 50.0
    turn: Literal[1, -1] = 1

    name: ClassVar[str] = "multistep"
    truth_parts: ClassVar[tuple[str, ...]] = ("artefact",)
    error_parts: ClassVar[tuple[str, ...]] = ("spindle",)

    def __post_init__(self) -> None:
        object.__setattr__(self, "angles", angle_tuple(self.angles, least=2, what="index"))
        object.__setattr__(self, "kmax", check_kmax(self.kmax))
        object.__setattr__(self, "u_index", check_number(self.u_index, "u_index", unit="rad"))
        if self.u_index > 0.2:
            raise UnitError(f"u_index of {self.u_index} rad; degrees? give numpy.deg2rad")
        object.__setattr__(self, "turn", check_turn(self.turn))
        for name, known in (("eccentricity", ("fixed", "free")), ("drift", ("none", "linear"))):
            if getattr(self, name) not in known:
                raise DataError(f"{name} must be one of {known}, got {getattr(self, name)!r}")
        if self.step_revolutions is not None:
            steps = check_number(self.step_revolutions, "step_revolutions")
            if steps < 1.0:
                raise DataError(f"step_revolutions must be >= 1, got {steps}")
            object.__setattr__(self, "step_revolutions", steps)
        object.__setattr__(self, "max_gain", check_number(self.max_gain, "max_gain", above=0.0))
        if np.isinf(self.gain[2:]).all():
            raise NotSeparableError(
                f"these {len(self.angles)} index positions separate no undulation up to "
                f"{self.kmax}; are they all the same?"
            )

    @property
    def gain(self) -> FloatArray:
        """Noise of the artefact harmonics 0 ... kmax over that of a reading's; inf: suppressed."""
        gain: FloatArray = step_geometry(self).gain[0]
        return gain

    def simulate(
        self, truth: Mapping[str, ArrayLike], errors: Mapping[str, ArrayLike]
    ) -> FloatArray:
        """Return what the probe reads at each index position.

        Parameters
        ----------
        truth : mapping of str to array_like, shape (N,), m
            ``artefact``: radius deviation over its own angle.
        errors : mapping of str to array_like, shape (N,), m
            ``spindle``: what the spindle adds, over its angle.

        Returns
        -------
        ndarray, shape (P, N), m
            One row for each index position.

        Raises
        ------
        DataError
            If a part is unknown, none is given, or their lengths differ.
        """
        parts, _ = part_arrays(_PARTS, truth, errors)
        out: FloatArray = turned(parts["artefact"], self.turn * np.array(self.angles))
        return out + parts["spindle"]

    def null_space(self) -> tuple[Unobservable, ...]:
        """Return the mean, the undulations that all positions show alike, and a free eccentricity.

        Returns
        -------
        tuple of Unobservable
            The same for both parts: their sum is known there, not their shares.
        """
        hidden = tuple(int(k) for k in np.flatnonzero(np.isinf(self.gain)) if k > 1)
        terms: tuple[str, ...] = ("offset",)
        why = "the offset (k = 0) is the zero of the probe"
        if math.isinf(self.gain[1]):
            terms += ("eccentricity",)
            why += "; k = 1 is centring and spindle in one"
        found = []
        for part in _PARTS:
            found.append(Unobservable(part, "term", terms, why))
            if hidden:
                found.append(
                    Unobservable(
                        part,
                        "harmonic",
                        hidden,
                        "all index positions show these alike, so artefact and spindle are not "
                        "told apart; a second run with a coprime number of steps does it",
                    )
                )
        return tuple(found)

    def separate(
        self,
        readings: ArrayLike,
        *,
        u_reading: float | None = None,
        start_angle: float = 0.0,
        history: tuple[Step, ...] = (),
    ) -> Separation:
        """Return artefact and spindle.

        Parameters
        ----------
        readings : array_like, shape (P, N) or (P, M, N), m
            At each index position over one revolution of N equal steps, or M revolutions.
        u_reading : float, m, optional
            Standard deviation of one reading. If omitted: what the positions disagree by (P > 2),
            else the scatter of the revolutions.
        start_angle : float, rad, optional
            Angle of the spindle at the first sample; ``harmonics`` are referred to the angle 0.
        history : tuple of Step, optional
            Where the readings came from.

        Returns
        -------
        Separation
            Parts ``artefact`` and ``spindle`` over ``angle``, with ``harmonics``.

        Raises
        ------
        InvalidSamplesError
            If the readings have another shape, are infinite, or no revolution is complete.
        TooFewSamplesError
            If kmax is not below half the samples.
        DataError
            If `u_reading` is negative or not finite.
        """
        return separate_steps(
            self, readings, check_u_reading(u_reading), check_start(start_angle), history
        )


def multistep(
    m: Any,
    steps: int | Sequence[int] | None = None,
    *,
    angles: ArrayLike | None = None,
    kmax: int | None = None,
    u_reading: float | None = None,
    u_index: float = 0.0,
    eccentricity: Literal["fixed", "free"] = "fixed",
    drift: Literal["none", "linear"] = "none",
    step_revolutions: float | None = None,
    turn: Literal[1, -1] = 1,
    angle: ArrayLike | None = None,
) -> Separation:
    """Return roundness of an artefact and error of a spindle from indexed revolutions.

    Parameters
    ----------
    m : array_like, shape (P, N) or (P, M, N), m, or Recording, or sequence of Profile
        One row for each index position, over equal angles of the spindle. The position of a
        profile is the angle of the spindle in rad, the same in each. A `Recording` is cut into
        revolutions by its channel ``angle`` (or of unit rad); without it, it must be one.
    steps : int or sequence of int, optional
        Number of equal steps; several numbers for several runs one after the other in `m`, such
        as ``(7, 8)`` for 15 rows. As many as `m` has rows if neither this nor `angles` is given.
    angles : array_like, shape (P,), rad, optional
        Index positions where they are not equal steps.
    kmax : int, optional
        Highest undulation; all below N/2 if omitted.
    u_reading : float, m, optional
        Standard deviation of one reading; from the data if omitted.
    u_index : float, rad, optional
        Standard uncertainty of each index position.
    eccentricity : {"fixed", "free"}, optional
        ``"free"`` if the artefact was centred anew at each step: k = 1 is then left out.
    drift : {"none", "linear"}, optional
        Whether a linear drift of the level is taken off first.
    step_revolutions : float, optional
        Time from step to step in revolutions, for the drift.
    turn : {1, -1}, optional
        +1: a step brings points of larger artefact angle to the probe.
    angle : array_like, shape (N,), rad, optional
        Angle of the spindle at each sample of `m` given as arrays; from 0 in equal steps if
        omitted.

    Returns
    -------
    Separation
        ``.artefact``, ``.spindle``; ``.suppressed`` are the multiples of the number of steps.

    Raises
    ------
    TooFewSamplesError
        If there are fewer than 2 positions or too few samples for kmax.
    InvalidSamplesError
        If readings or angles are not finite or of the wrong shape, or the angle of the spindle is
        not in equal steps over whole revolutions.
    UnitError
        If the angles look like degrees.
    NotSeparableError
        If the positions separate nothing.
    DataError
        If `steps` and `angles` are both given or do not fit the rows, or a setting is out of range.

    Notes
    -----
    Least squares per undulation: ``M_p = R exp(j k t alpha_p) + S``. N equal steps give the noise
    ``s / sqrt(N)`` of each part. The spindle must repeat from step to step: what does not is noise,
    and shows in ``audit["residual_rms_nm"]``.

    Examples
    --------
    >>> a = 2 * np.pi * np.arange(120) / 120
    >>> part, spindle = (lambda t: 50e-9 * np.cos(3 * t)), 20e-9 * np.sin(2 * a)
    >>> found = multistep([part(a + p * np.pi / 4) + spindle for p in range(8)], steps=8)
    >>> found.suppressed[:3], bool(np.abs(found.spindle - spindle).max() < 1e-20)
    ([8, 16, 24], True)
    """
    given = circle_readings(m, what="multistep", angle=angle)
    try:
        shape = np.shape(given.values)
    except ValueError:
        shape = ()
    if len(shape) not in (2, 3):
        raise DataError(
            f"multistep needs readings (P, N) or (P, M, N) of equal length, got the shape {shape}"
        )
    if kmax is None and shape[-1] < 5:
        raise TooFewSamplesError(
            f"multistep needs at least 5 samples in a revolution, got {shape[-1]}"
        )
    method = MultistepRoundness(
        index_positions(steps, angles, shape[0]),
        (shape[-1] - 1) // 2 if kmax is None else kmax,
        u_index=u_index,
        eccentricity=eccentricity,
        drift=drift,
        step_revolutions=step_revolutions,
        turn=turn,
    )
    found = method.separate(
        given.values, u_reading=u_reading, start_angle=given.start_angle, history=given.history
    )
    return with_messages(found, given.messages)
