"""Donaldson's reversal: roundness of an artefact and radial error motion of a spindle."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import ClassVar

import numpy as np
from numpy.typing import ArrayLike, NDArray

from metrosep.core.errors import DataError
from metrosep.core.profile import Profile
from metrosep.core.provenance import Step
from metrosep.separation._inputs import curves, require_turn, stacked
from metrosep.separation._readings import (
    checked_readings,
    harmonics_of,
    low_harmonics,
    without_basis,
)
from metrosep.separation.contract import Separation, SeparationMethod
from metrosep.separation.null_space import Unobservable
from metrosep.separation.reversals import reverse_pair, simulated_pair, with_type_b_curve

__all__ = ["DonaldsonReversal", "donaldson"]

FloatArray = NDArray[np.float64]

_CENTRING = "the mean and the eccentricity are the centring of each set-up, not form"


@dataclass(frozen=True, slots=True)
class DonaldsonReversal(SeparationMethod):
    """Radial reversal of a roundness artefact on a spindle.

    Reading 1: ``m1 = P + S``. For reading 2 the artefact and the probe are both turned by half a
    revolution about the spindle axis: ``m2 = P - S``, over the same angle of the artefact.

    Parameters
    ----------
    u_index : float, rad, optional
        Standard uncertainty of the half turn of the artefact against the spindle. It adds
        ``u_index |P'| / 2`` to the uncertainty of both parts.
    """

    u_index: float = 0.0

    name: ClassVar[str] = "donaldson"
    truth_parts: ClassVar[tuple[str, ...]] = ("artefact",)
    error_parts: ClassVar[tuple[str, ...]] = ("spindle",)

    def simulate(
        self, truth: Mapping[str, ArrayLike], errors: Mapping[str, ArrayLike]
    ) -> FloatArray:
        """Return the two readings of given parts.

        Parameters
        ----------
        truth : mapping of str to array_like, shape (n,), m
            ``artefact``: radius deviation over the angle.
        errors : mapping of str to array_like, shape (n,), m
            ``spindle``: radial error motion towards the probe of reading 1.

        Returns
        -------
        ndarray, shape (2, n), m
            m1, m2.

        Raises
        ------
        DataError
            If a part is unknown or none is given.
        """
        return simulated_pair(self, truth, errors)

    def null_space(self) -> tuple[Unobservable, ...]:
        """Return offset and eccentricity of both parts.

        Returns
        -------
        tuple of Unobservable
            Harmonics 0 and 1.
        """
        return tuple(
            Unobservable(p, "harmonic", (0, 1), _CENTRING) for p in ("artefact", "spindle")
        )

    def separate(
        self,
        readings: ArrayLike,
        *,
        u_reading: float | None = None,
        history: tuple[Step, ...] = (),
    ) -> Separation:
        """Return artefact and spindle.

        Parameters
        ----------
        readings : array_like, shape (2, n) or (2, M, n), m
            m1 and m2 over equal angles of one revolution, or M revolutions of each.
        u_reading : float, m, optional
            Standard uncertainty of one reading; the scatter of the revolutions if omitted.
        history : tuple of Step, optional
            Where the readings came from.

        Returns
        -------
        Separation
            Parts ``artefact`` and ``spindle``, with harmonics.

        Raises
        ------
        InvalidSamplesError, TooFewSamplesError
            If the readings are no two curves of at least 8 samples.
        DataError
            If `u_reading` or `u_index` is negative.
        """
        if not (np.isfinite(self.u_index) and 0.0 <= self.u_index < np.pi):
            raise DataError(
                f"u_index is {self.u_index}; it is a standard uncertainty in rad, 0 to pi"
            )
        array = checked_readings(readings, names=("m1", "m2"), minimum=8, what=self.name)
        angle = 2.0 * np.pi * np.arange(array.shape[2]) / array.shape[2]
        result = reverse_pair(
            self, array, low_harmonics(angle), {"angle": angle}, "spindle", u_reading
        )
        return _finish_round(self, array, result, history)


def donaldson(
    m1: ArrayLike | Profile,
    m2: ArrayLike | Profile,
    *,
    u_reading: float | None = None,
    u_index: float = 0.0,
) -> Separation:
    """Return roundness of an artefact and radial error motion of a spindle from a reversal.

    Parameters
    ----------
    m1, m2 : array_like, shape (n,) or (M, n), m, or Profile over the angle in rad
        Readings before and after artefact and probe were turned by half a revolution, both over
        the same angles of the artefact, equally spaced over one revolution; or M revolutions.
    u_reading : float, m, optional
        Standard uncertainty of one reading; the scatter of the revolutions if omitted.
    u_index : float, rad, optional
        Standard uncertainty of the half turn.

    Returns
    -------
    Separation
        ``.artefact``, ``.spindle``: offset and eccentricity (k = 0, 1) removed; ``.harmonics``.

    Raises
    ------
    DataError, InvalidSamplesError, TooFewSamplesError
        If the readings have different lengths or positions, fewer than 8 samples, or are not
        finite; if the profiles are not over one revolution.

    Notes
    -----
    ``P = (m1 + m2)/2``, ``S = (m1 - m2)/2``, exact for k >= 2. White noise of one reading s gives
    ``s / sqrt(2 M)`` for each. Only the synchronous part of the error motion is found. A sample
    that is NaN in one reading is NaN in both parts.

    References
    ----------
    R. R. Donaldson, A simple method for separating spindle error from test ball roundness error,
    CIRP Annals 21 (1972) 125-126.

    Examples
    --------
    >>> import numpy as np
    >>> a = 2 * np.pi * np.arange(360) / 360
    >>> part, spindle = 50e-9 * np.cos(3 * a), 20e-9 * np.sin(2 * a)
    >>> result = donaldson(part + spindle, part - spindle)
    >>> bool(abs(result.spindle - spindle).max() < 1e-20)
    True
    """
    readings, angle, history = curves((m1, m2), what="donaldson", axis="angle")
    if angle is not None:
        require_turn(angle)
    array = stacked(readings, "donaldson")
    return DonaldsonReversal(u_index).separate(array, u_reading=u_reading, history=history)


def _finish_round(
    method: DonaldsonReversal, array: FloatArray, result: Separation, history: tuple[Step, ...]
) -> Separation:
    """Add harmonics, the share of the index angle, and what looks like a missing half turn."""
    harmonics, spread = {}, {}
    for name, values in result.parts.items():
        harmonics[name], spread[name] = harmonics_of(values, result.u[name], (0, 1))
    u_turn = _turn_uncertainty(harmonics["artefact"], spread["artefact"], array.shape[2])
    return with_type_b_curve(
        result,
        u_turn * method.u_index / 2.0,
        {"u_index_rad": method.u_index},
        history=(*history, Step(method.name, {"u_index_rad": method.u_index})),
        more_messages=_half_turn_doubts(array),
        harmonics=(harmonics, spread),
    )


def _turn_uncertainty(c: NDArray[np.complex128], spread: FloatArray, n: int) -> FloatArray:
    """Return |dP/dangle| of the harmonics that stand out of the noise."""
    k = np.arange(c.size)
    significant = np.isfinite(c) & ~(np.abs(c) < 3.0 * spread)
    rate = np.where(significant, 1j * k * np.where(np.isfinite(c), c, 0.0), 0.0)
    angle = 2.0 * np.pi * np.arange(n) / n
    return np.asarray(np.abs(np.real(np.exp(1j * np.outer(angle, k)) @ rate)))


def _half_turn_doubts(array: FloatArray) -> tuple[str, ...]:
    """Say it where the readings agree better after another half turn: it may be missing."""
    n = array.shape[2]
    if n % 2 or np.isnan(array).any():
        return ()
    basis = low_harmonics(2.0 * np.pi * np.arange(n) / n)
    m1, m2 = (without_basis(array[i].mean(axis=0), basis) for i in (0, 1))
    size = float(np.sqrt(np.sum(m1**2) * np.sum(m2**2)))
    if size == 0.0:
        return ()
    as_given, turned = (abs(float(m1 @ np.roll(m2, s))) / size for s in (0, n // 2))
    if as_given < 0.5 and turned > 0.95:
        text = (
            "the readings are alike only after a further half turn "
            f"(|correlation| {turned:.2f} against {as_given:.2f}): check that m2 is given over the "
            "angle of the artefact, not of the spindle"
        )
        return (text,)
    return ()
