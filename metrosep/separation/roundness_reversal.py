"""Donaldson's reversal: roundness of an artefact and radial error motion of a spindle."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import ClassVar

import numpy as np
from numpy.typing import ArrayLike, NDArray

from metrosep.core._arrays import FloatArray
from metrosep.core.errors import DataError
from metrosep.core.profile import Profile
from metrosep.core.provenance import Step
from metrosep.separation._inputs import curves, first_angle, stacked
from metrosep.separation._readings import (
    checked_readings,
    gap_message,
    harmonics_of,
    harmonics_u,
    low_harmonics,
    without_basis,
)
from metrosep.separation.contract import Separation, SeparationMethod
from metrosep.separation.null_space import Unobservable
from metrosep.separation.reversals import reverse_pair, simulated_pair, with_type_b_curve
from metrosep.spectral._checks import finite_number, real_number

__all__ = ["DonaldsonReversal", "donaldson"]


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
    start : float, rad, optional
        Angle of the first sample.
    """

    u_index: float = 0.0
    start: float = 0.0

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
            Mean and eccentricity, k = 0 and 1.
        """
        return tuple(
            Unobservable(p, "term", ("offset", "eccentricity"), _CENTRING)
            for p in ("artefact", "spindle")
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
        NotSeparableError
            If too few angles were measured in both set-ups.
        DataError
            If `u_reading` or `u_index` is negative or out of range.
        """
        u_index = real_number(self.u_index, "u_index", "a standard uncertainty in rad")
        if not 0.0 <= u_index <= _LARGEST_INDEX:
            raise DataError(
                f"u_index is {u_index} rad; it must lie between 0 and {_LARGEST_INDEX}: "
                "0.1 deg is 1.7e-3"
            )
        array = checked_readings(readings, names=("m1", "m2"), minimum=8, what=self.name)
        start = finite_number(self.start, "start", "an angle in rad")
        angle = start + 2.0 * np.pi * np.arange(array.shape[2]) / array.shape[2]
        result = reverse_pair(
            self, array, low_harmonics(angle), {"angle": angle}, "spindle", u_reading
        )
        return _finish_round(self, array, result, history)


def donaldson(
    m1: ArrayLike | Profile,
    m2: ArrayLike | Profile,
    *,
    angle: ArrayLike | None = None,
    u_reading: float | None = None,
    u_index: float = 0.0,
) -> Separation:
    """Return roundness of an artefact and radial error motion of a spindle from a reversal.

    Parameters
    ----------
    m1, m2 : array_like, shape (n,) or (M, n), m, or Profile over the angle in rad
        Readings before and after artefact and probe were turned by half a revolution, both over
        the same angles of the artefact, equally spaced over one revolution; or M revolutions.
    angle : array_like, shape (n,), rad, optional
        Angles of the samples, if the readings are arrays; from 0 if omitted.
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
        finite; if the angles are not equally spaced over one revolution.
    NotSeparableError
        If too few angles were measured in both set-ups.

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
    readings, positions, history = curves((m1, m2), what="donaldson", axis="angle")
    array = stacked(readings, "donaldson")
    start = first_angle(positions, angle, array.shape[2], "donaldson")
    method = DonaldsonReversal(u_index, start)
    return method.separate(array, u_reading=u_reading, history=history)


def _finish_round(
    method: DonaldsonReversal, array: FloatArray, result: Separation, history: tuple[Step, ...]
) -> Separation:
    """Add harmonics, the share of the index angle, and what looks like a missing half turn."""
    weights = {"artefact": (0.5, 0.5), "spindle": (0.5, -0.5)}
    harmonics = {
        name: harmonics_of(values, start=method.start, hidden=(0, 1))
        for name, values in result.parts.items()
    }
    spread = {
        name: harmonics_u(array, np.array(w), result.noise.value) for name, w in weights.items()
    }
    k = np.arange(harmonics["artefact"].size)
    slope = _significant_slope(harmonics["artefact"], spread["artefact"])
    turned = np.abs(slope) * method.u_index / 2.0 / np.sqrt(2.0)
    angle = result.coordinates["angle"]
    along = np.abs(np.real(np.exp(1j * np.outer(angle, k)) @ slope)) * method.u_index / 2.0
    for name, values in spread.items():
        combined = np.sqrt(values**2 + turned**2)
        combined[:2] = np.nan
        spread[name] = np.where(np.isfinite(harmonics[name]), combined, np.nan)
    return with_type_b_curve(
        result,
        along,
        {"u_index_rad": method.u_index},
        history=(*history, Step(method.name, {"u_index_rad": method.u_index})),
        more_messages=(*gap_message(result.parts["artefact"]), *_set_up_doubts(array)),
        harmonics=(harmonics, spread),
    )


def _significant_slope(c: NDArray[np.complex128], spread: FloatArray) -> NDArray[np.complex128]:
    """Return the coefficients of dP/dangle of the harmonics that stand out of the noise."""
    known = np.where(np.isfinite(c), c, 0.0)
    out = np.isfinite(c) & ~(np.abs(known) < 3.0 * spread)
    return np.asarray(np.where(out, 1j * np.arange(c.size) * known, 0.0))


def _set_up_doubts(array: FloatArray) -> tuple[str, ...]:
    """Say it where the second set-up looks as if it was not what a reversal asks for."""
    n = array.shape[2]
    if n % 2 or np.isnan(array).any():
        return ()
    basis = low_harmonics(2.0 * np.pi * np.arange(n) / n)
    m1, m2 = (without_basis(array[i].mean(axis=0), basis) for i in (0, 1))
    size = float(np.sqrt(np.sum(m1**2) * np.sum(m2**2)))
    if size == 0.0:
        return ()
    if float(np.max(np.abs(m1 - m2))) <= 1e-12 * float(np.max(np.abs(m1))):
        text = "both readings are the same: was anything turned for the second set-up?"
        return (text,)
    mirrored = np.roll(m2[::-1], 1)
    as_given, turned, back = (
        abs(float(m1 @ v)) / size for v in (m2, np.roll(m2, n // 2), mirrored)
    )
    if as_given < 0.5 and max(turned, back) > 0.95:
        way, ask = (
            (
                "after a further half turn",
                "was the artefact turned, was the probe turned, and was the index left alone?",
            )
            if turned >= back
            else ("when the second is mirrored", "did the spindle turn the other way round?")
        )
        text = (
            f"the readings are alike only {way} (|correlation| {max(turned, back):.2f} against "
            f"{as_given:.2f}): {ask}"
        )
        return (text,)
    return ()


_LARGEST_INDEX = 0.2
"""An index that is uncertain by more than 11 degrees was given in degrees."""
