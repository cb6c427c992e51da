"""`ZeroAdjustment`: the zero difference of three probes separated from the bend of an artefact.

``d(x) = m1 - (1 + r) m2 + r m3 = bend(x) + zero``; in the reversal ``-bend(x) + zero``. Straightness and
pitch of the carriage drop out of d.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import ClassVar

import numpy as np
from numpy.typing import ArrayLike

from metrosep.core._arrays import FloatArray
from metrosep.core.provenance import Step
from metrosep.core.quantity import Quantity
from metrosep.separation._method_parts import known_parts, stated_u
from metrosep.separation._readings import checked_readings
from metrosep.separation.contract import Separation, SeparationMethod
from metrosep.separation.null_space import Unobservable
from metrosep.separation.zero_adjustment import distances, zero_calibration

__all__ = ["ZeroAdjustment"]


_PROBES = ("trailing", "middle", "leading")
_CHANGES = (
    "a zero that changes with the reversal looks like bend: turn back and repeat the first set-up"
)
_FLAT = "the mean bend is taken as that of a perfect flat: reverse it to see its own"


@dataclass(frozen=True, slots=True)
class ZeroAdjustment(SeparationMethod):
    """Three probes on an artefact and on its reversal, or on a flat.

    Parameters
    ----------
    distance : float or tuple of (float, float), m
        Between neighbouring probes.
    flat : bool, optional
        Whether the artefact counts as flat; if not, it is measured again turned about its long
        axis. A form that is known, and a calibration by an angle sensor: `zero_calibration`.
    u_flat : float, m, optional
        Standard uncertainty of the mean second difference of the flat.

    Raises
    ------
    DataError
        If a distance is not above zero or `u_flat` negative.

    Examples
    --------
    >>> method = ZeroAdjustment(10e-3)
    >>> readings = method.simulate({"bend": [1e-9, -2e-9]}, {"zero": 5e-9})
    >>> found = method.separate(readings)
    >>> round(float(found.zero) * 1e9, 6), (found.bend * 1e9).round(6).tolist()
    (5.0, [1.0, -2.0])
    """

    distance: float | tuple[float, float]
    flat: bool = False
    u_flat: float = 0.0

    name: ClassVar[str] = "zero_adjustment"
    truth_parts: ClassVar[tuple[str, ...]] = ("bend",)
    error_parts: ClassVar[tuple[str, ...]] = ("zero",)

    def __post_init__(self) -> None:
        distances(self.distance)
        stated_u(self.u_flat, "m", "u_flat")

    @property
    def _weights(self) -> FloatArray:
        first, second = distances(self.distance)
        ratio = first / second
        return np.array([1.0, -(1.0 + ratio), ratio])

    @property
    def _names(self) -> tuple[str, ...]:
        again = () if self.flat else tuple(f"{p} probe reversed" for p in _PROBES)
        return (*(f"{p} probe" for p in _PROBES), *again)

    def simulate(
        self, truth: Mapping[str, ArrayLike], errors: Mapping[str, ArrayLike]
    ) -> FloatArray:
        """Return the readings of given parts, the carriage straight.

        Parameters
        ----------
        truth : mapping of str to array_like, shape (n,), m
            ``bend``: second difference of the artefact at each position.
        errors : mapping of str to array_like, scalar, m
            ``zero`` difference of the probes.

        Returns
        -------
        ndarray, shape (6, n), (3, n) on a flat, m
            The probes, then the probes on the reversed artefact; n = 1 without bend. Both parts
            are spread over the probes in proportion to their weights.

        Raises
        ------
        DataError
            If a part is unknown or none is given.
        """
        parts = known_parts(self, truth, errors)
        zero, bend = parts.get("zero", np.zeros(())), parts.get("bend", np.zeros(1))
        w = self._weights / float(self._weights @ self._weights)
        first = np.multiply.outer(w, bend + zero)
        return first if self.flat else np.concatenate([first, np.multiply.outer(w, zero - bend)])

    def null_space(self) -> tuple[Unobservable, ...]:
        """Return what the set-up cannot tell.

        Returns
        -------
        tuple of Unobservable
            A zero that changes between the readings, or the mean bend of the flat.
        """
        if self.flat:
            return (Unobservable("bend", "term", ("mean",), _FLAT),)
        return (Unobservable("bend", "term", ("change of the zero",), _CHANGES),)

    def separate(
        self,
        readings: ArrayLike,
        *,
        u_reading: float | None = None,
        history: tuple[Step, ...] = (),
    ) -> Separation:
        """Return the zero difference and the bend of the artefact.

        Parameters
        ----------
        readings : array_like, shape (6, n) or (6, M, n), of a flat (3, n) or (3, M, n), m
            As `simulate` returns them; NaN = not measured.
        u_reading : float, m, optional
            Standard uncertainty of one reading; the scatter over the positions if omitted.
        history : tuple of Step, optional
            Where they came from.

        Returns
        -------
        Separation
            Parts ``zero`` (scalar) and ``bend`` (n,).

        Raises
        ------
        DataError
            If `u_reading` is negative or no number.
        InvalidSamplesError
            If the readings are no curves of equal length.
        TooFewSamplesError
            If at no position all probes were measured, or at one only without `u_reading`.

        Notes
        -----
        `zero_calibration` does the work. With noise s of a reading and equal distances:
        ``s sqrt(6/(2 n M))`` for the zero from a reversal, ``s sqrt(6/(n M))`` and `u_flat` from a
        flat.
        """
        stated = stated_u(u_reading, "m")
        array = checked_readings(readings, names=self._names, minimum=1, what=self.name)
        turned = None if self.flat else array[3:]
        found = zero_calibration(
            array[:3],
            self.distance,
            reversed_m=turned,
            flat=0.0 if self.flat else None,
            u_flat=self.u_flat,
            u_reading=stated,
        )
        first, count = self._differences(array[:3])
        if turned is None:
            bend, own = first - found.zero, count
            inverse = 1.0 / np.maximum(count, 1.0) - 1.0 / count.sum()
        else:
            second, other = self._differences(turned)
            bend = (first - second) / 2.0
            own = np.where(
                (count > 0) & (other > 0), count * other / (count + other + 1e-300), 0.0
            )
            inverse = 0.25 / np.where(own > 0, own, np.nan)
        w = float(np.linalg.norm(self._weights))
        n_sets = 1.0 if self.flat else 2.0
        random = math.sqrt(max(found.u**2 - (self.u_flat**2 if self.flat else 0.0), 0.0))
        s = random * math.sqrt(float(own.sum())) * n_sets / w if stated is None else stated
        u_bend = np.where(np.isnan(bend), np.nan, s * w * np.sqrt(inverse))
        return Separation(
            self.name,
            {"zero": np.array(found.zero), "bend": bend},
            {"zero": np.array(found.u), "bend": u_bend},
            {"zero": "m", "bend": "m"},
            {},
            self.null_space(),
            noise=_noise(s, int(found.audit["n_positions"]), stated),
            audit={**found.audit, "source": found.source, "n_repeats": int(array.shape[1])},
            messages=found.messages,
            history=(*history, Step(self.name, {"distance_m": list(distances(self.distance))})),
        )

    def _differences(self, array: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return the second difference at each position, mean over the passes, and their number."""
        d = np.tensordot(self._weights, array, axes=1)
        count = (~np.isnan(d)).sum(axis=0).astype(np.float64)
        return np.where(count > 0, np.nansum(d, axis=0) / np.maximum(count, 1.0), np.nan), count


def _noise(s: float, n_positions: int, stated: float | None) -> Quantity:
    if stated is not None:
        return Quantity(stated, "m", "standard uncertainty of one reading, as stated", symbol="s")
    text = f"standard deviation of one reading, from {n_positions} positions (type A)"
    return Quantity(s, "m", text, u=s / math.sqrt(2.0 * (n_positions - 1)), symbol="s")
