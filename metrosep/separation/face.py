"""Estler's face reversal: tilt and axial error motion of a spindle, and flatness of a plate."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import ClassVar

import numpy as np
from numpy.typing import ArrayLike, NDArray

from metrosep.core.errors import DataError
from metrosep.core.profile import Profile
from metrosep.core.provenance import Step
from metrosep.separation._inputs import curves, given_parts, stacked
from metrosep.separation._readings import (
    average_repeats,
    checked_readings,
    harmonics_of,
    left_share,
    low_harmonics,
    without_basis,
)
from metrosep.separation.contract import Separation, SeparationMethod
from metrosep.separation.null_space import Unobservable

__all__ = ["FaceReversal", "face_reversal"]

FloatArray = NDArray[np.float64]

_SQUARENESS = "mean and once-per-revolution are how square the plate sits on the spindle"
_ZERO = "the zero of the probe is arbitrary"


@dataclass(frozen=True, slots=True)
class FaceReversal(SeparationMethod):
    """Face reversal of a plate on a spindle with probes at the centre and at a radius.

    Centre probe: ``A(theta)``. Face probe at the radius r: ``F1 = A + r T + P``; with plate and
    face probe turned by half a revolution ``F2 = A - r T + P``, over the same angle of the plate.

    Parameters
    ----------
    radius : float, m
        Distance r of the face probe from the axis, > 0.

    Raises
    ------
    DataError
        If the radius is not positive or above 100 m.
    """

    radius: float

    name: ClassVar[str] = "face_reversal"
    truth_parts: ClassVar[tuple[str, ...]] = ("artefact",)
    error_parts: ClassVar[tuple[str, ...]] = ("axial", "tilt")

    def __post_init__(self) -> None:
        if not (math.isfinite(self.radius) and 0.0 < self.radius < 100.0):
            raise DataError(
                f"radius is {self.radius} m; the distance of the face probe from the axis must be "
                "positive and below 100 m: 25 mm is 25e-3"
            )

    def simulate(
        self, truth: Mapping[str, ArrayLike], errors: Mapping[str, ArrayLike]
    ) -> FloatArray:
        """Return the three readings of given parts.

        Parameters
        ----------
        truth : mapping of str to array_like, shape (n,), m
            ``artefact``: height of the plate on the circle of the face probe.
        errors : mapping of str to array_like, shape (n,)
            ``axial`` in m, towards the probes; ``tilt`` in rad, positive where it lifts the face
            probe of set-up 1.

        Returns
        -------
        ndarray, shape (3, n), m
            F1, F2, A.

        Raises
        ------
        DataError
            If a part is unknown or none is given.
        """
        plate, axial, tilt = given_parts(
            self.name,
            truth,
            errors,
            truth_parts=self.truth_parts,
            error_parts=self.error_parts,
        ).values()
        lift = self.radius * tilt
        return np.stack([axial + lift + plate, axial - lift + plate, axial])

    def null_space(self) -> tuple[Unobservable, ...]:
        """Return squareness of the plate and zero of the probe.

        Returns
        -------
        tuple of Unobservable
            Harmonics 0 and 1 of plate and tilt, 0 of the axial motion.
        """
        return (
            Unobservable("artefact", "harmonic", (0, 1), _SQUARENESS),
            Unobservable("axial", "harmonic", (0,), _ZERO),
            Unobservable("tilt", "harmonic", (0, 1), _SQUARENESS),
        )

    def separate(
        self,
        readings: ArrayLike,
        *,
        u_reading: float | None = None,
        history: tuple[Step, ...] = (),
    ) -> Separation:
        """Return plate, axial and tilt error motion.

        Parameters
        ----------
        readings : array_like, shape (3 or 4, n) or (3 or 4, M, n), m
            F1, F2 and A; a fourth one is A measured again in set-up 2, and the third is then that
            of set-up 1.
        u_reading : float, m, optional
            Standard uncertainty of one reading; the scatter of the revolutions if omitted.
        history : tuple of Step, optional
            Where the readings came from.

        Returns
        -------
        Separation
            Parts ``artefact`` (m), ``axial`` (m, its fundamental kept), ``tilt`` (rad).

        Raises
        ------
        DataError
            If `u_reading` is negative.
        InvalidSamplesError, TooFewSamplesError
            If the readings are no curves of at least 8 samples.
        """
        array = checked_readings(readings, names=_names(readings), minimum=8, what="face_reversal")
        n = array.shape[2]
        angle = 2.0 * np.pi * np.arange(n) / n
        both, mean = low_harmonics(angle), low_harmonics(angle, highest=0)
        averaged = average_repeats(array, both, u_reading=u_reading)
        weights = _weights(self.radius, array.shape[0])
        parts, u = {}, {}
        for name, w in weights.items():
            basis = mean if name == "axial" else both
            used = w != 0.0
            parts[name] = without_basis(w[used] @ averaged.mean[used], basis)
            valid = ~np.isnan(parts[name])
            with np.errstate(divide="ignore"):
                variance = averaged.noise.value**2 * (
                    (w[used] ** 2) @ (1.0 / averaged.counts[used])
                )
            u[name] = np.sqrt(np.where(valid, variance, np.nan) * left_share(valid, basis))
        hidden = {"artefact": (0, 1), "axial": (0,), "tilt": (0, 1)}
        series = {k: harmonics_of(v, u[k], hidden[k]) for k, v in parts.items()}
        return Separation(
            self.name,
            parts,
            u,
            {"artefact": "m", "axial": "m", "tilt": "rad"},
            {"angle": angle},
            self.null_space(),
            noise=averaged.noise,
            harmonics={k: s[0] for k, s in series.items()},
            harmonics_u={k: s[1] for k, s in series.items()},
            audit={
                "radius_mm": self.radius * 1e3,
                "n_repeats": averaged.n_repeats,
                "n_samples": n,
                "axial_readings": array.shape[0] - 2,
                "removed": "least squares: mean of all, once-per-revolution of plate and tilt",
            },
            messages=averaged.messages,
            history=(*history, Step(self.name, {"radius_m": self.radius})),
        )


def face_reversal(
    f1: ArrayLike | Profile,
    f2: ArrayLike | Profile,
    axial: ArrayLike | Profile,
    radius: float,
    *,
    axial2: ArrayLike | Profile | None = None,
    u_reading: float | None = None,
) -> Separation:
    """Return flatness of a plate, axial and tilt error motion of a spindle from a face reversal.

    Parameters
    ----------
    f1, f2 : array_like, shape (n,) or (M, n), m, or Profile over the angle in rad
        Face readings before and after plate and face probe were turned by half a revolution,
        over the same angles of the plate, equally spaced over one revolution.
    axial : array_like, shape (n,) or (M, n), m, or Profile
        Reading at the centre.
    radius : float, m
        Distance of the face probe from the axis.
    axial2 : array_like, shape (n,) or (M, n), m, or Profile, optional
        Reading at the centre in the second set-up.
    u_reading : float, m, optional
        Standard uncertainty of one reading; the scatter of the revolutions if omitted.

    Returns
    -------
    Separation
        ``.artefact`` (m), ``.axial`` (m), ``.tilt`` (rad).

    Raises
    ------
    DataError, InvalidSamplesError, TooFewSamplesError
        If the readings have different lengths or positions, fewer than 8 samples, or are not
        finite; if the radius is not positive.

    Notes
    -----
    ``T = (F1 - F2)/(2 r)``, ``P = (F1 + F2)/2 - A``. White noise s of one reading gives
    ``s/(r sqrt2)`` for T and ``s sqrt(3/2)`` for P. With a second axial reading
    ``T = (F1 - A1 - F2 + A2)/(2 r)`` and ``P = (F1 - A1 + F2 - A2)/2``, each with the variance of
    four readings; axial motion that differs between the set-ups then cancels.

    References
    ----------
    C. J. Evans, R. J. Hocken, W. T. Estler, CIRP Annals 45 (1996) 617-634, section 3.

    Examples
    --------
    >>> import numpy as np
    >>> a = 2 * np.pi * np.arange(64) / 64
    >>> axial, tilt, plate = 20e-9 * np.cos(a), 1e-6 * np.sin(2 * a), 50e-9 * np.cos(3 * a)
    >>> r = 25e-3
    >>> result = face_reversal(axial + r * tilt + plate, axial - r * tilt + plate, axial, r)
    >>> bool(abs(result.tilt - tilt).max() < 1e-18)
    True
    """
    items = [f1, f2, axial] if axial2 is None else [f1, f2, axial, axial2]
    readings, _, history = curves(items, what="face_reversal", axis="angle")
    array = stacked(readings, "face_reversal")
    return FaceReversal(radius).separate(array, u_reading=u_reading, history=history)


def _names(readings: ArrayLike) -> tuple[str, ...]:
    try:
        four = np.asarray(readings).shape[0] == 4
    except (ValueError, IndexError):
        four = False
    return ("F1", "F2", "A1", "A2") if four else ("F1", "F2", "A")


def _weights(radius: float, n_readings: int) -> dict[str, FloatArray]:
    """Return how each part is combined from the readings."""
    half = 1.0 / (2.0 * radius)
    if n_readings == 4:
        return {
            "artefact": np.array([0.5, 0.5, -0.5, -0.5]),
            "axial": np.array([0.0, 0.0, 0.5, 0.5]),
            "tilt": half * np.array([1.0, -1.0, -1.0, 1.0]),
        }
    return {
        "artefact": np.array([0.5, 0.5, -1.0]),
        "axial": np.array([0.0, 0.0, 1.0]),
        "tilt": half * np.array([1.0, -1.0, 0.0]),
    }
