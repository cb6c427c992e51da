"""Estler's face reversal: tilt and axial error motion of a spindle, and flatness of a plate."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import ClassVar

import numpy as np
from numpy.typing import ArrayLike

from metrosep.core._arrays import FloatArray
from metrosep.core.errors import DataError
from metrosep.core.profile import Profile
from metrosep.core.provenance import Step
from metrosep.separation._inputs import curves, first_angle, given_parts, stacked
from metrosep.separation._readings import (
    average_repeats,
    checked_readings,
    gap_message,
    harmonics_of,
    harmonics_u,
    left_share,
    low_harmonics,
    require_common,
    size_doubts,
    without_basis,
)
from metrosep.separation.contract import Separation, SeparationMethod
from metrosep.separation.null_space import Unobservable
from metrosep.spectral._checks import finite_number, real_number

__all__ = ["FaceReversal", "face_reversal"]


_SQUARENESS = "mean and once-per-revolution are how square the plate sits on the spindle"
_ZERO = "the zero of the probe is arbitrary"

_LARGEST_RADIUS = 5.0
"""The largest vertical lathes; a larger radius was given in mm."""


@dataclass(frozen=True, slots=True)
class FaceReversal(SeparationMethod):
    """Face reversal of a plate on a spindle with probes at the centre and at a radius.

    Centre probe: ``A(theta)``. Face probe at the radius r: ``F1 = A + r T + P``; with plate and
    face probe turned by half a revolution ``F2 = A - r T + P``, over the same angle of the plate.

    Parameters
    ----------
    radius : float, m
        Distance r of the face probe from the axis, > 0.
    start : float, rad, optional
        Angle of the first sample.

    Raises
    ------
    DataError
        If the radius is not positive or above 5 m.
    """

    radius: float
    start: float = 0.0

    name: ClassVar[str] = "face_reversal"
    truth_parts: ClassVar[tuple[str, ...]] = ("artefact",)
    error_parts: ClassVar[tuple[str, ...]] = ("axial", "tilt")

    def __post_init__(self) -> None:
        radius = real_number(self.radius, "radius", "a distance in m, 25 mm is 25e-3")
        if not (math.isfinite(radius) and 0.0 < radius <= _LARGEST_RADIUS):
            raise DataError(
                f"radius is {radius} m; the distance of the face probe from the axis must be "
                f"positive and at most {_LARGEST_RADIUS} m: 25 mm is 25e-3"
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
            k = 0 and 1 of plate and tilt, 0 of the axial motion.
        """
        return (
            Unobservable("artefact", "term", ("offset", "once per revolution"), _SQUARENESS),
            Unobservable("axial", "term", ("offset",), _ZERO),
            Unobservable("tilt", "term", ("offset", "once per revolution"), _SQUARENESS),
        )

    def _like_readings(self, model: FloatArray, readings: FloatArray) -> FloatArray:
        """Return the axial motion for a fourth reading, as for the third, and for repeats."""
        if readings.shape[0] == model.shape[0] + 1:
            model = np.concatenate([model, model[2:]])
        return model[:, None] if readings.ndim == model.ndim + 1 else model

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
        NotSeparableError
            If too few angles were measured in every set-up.
        """
        array = checked_readings(readings, names=_names(readings), minimum=8, what="face_reversal")
        n = array.shape[2]
        start = finite_number(self.start, "start", "an angle in rad")
        angle = start + 2.0 * np.pi * np.arange(n) / n
        both, mean = low_harmonics(angle), low_harmonics(angle, highest=0)
        averaged = average_repeats(array, both, u_reading=u_reading)
        weights = _weights(self.radius, array.shape[0])
        parts, u, harmonics, spread = {}, {}, {}, {}
        for name, w in weights.items():
            basis = mean if name == "axial" else both
            used = w != 0.0
            curve = w[used] @ averaged.mean[used]
            valid = ~np.isnan(curve)
            require_common(valid, basis, self.name)
            parts[name] = without_basis(curve, basis)
            with np.errstate(divide="ignore"):
                variance = averaged.noise.value**2 * (
                    (w[used] ** 2) @ (1.0 / averaged.counts[used])
                )
            u[name] = np.sqrt(np.where(valid, variance, np.nan) * left_share(valid, basis))
            hidden = (0,) if name == "axial" else (0, 1)
            harmonics[name] = harmonics_of(parts[name], start=start, hidden=hidden)
            spread[name] = np.where(
                np.isfinite(harmonics[name]), harmonics_u(array, w, averaged.noise.value), np.nan
            )
        return Separation(
            self.name,
            parts,
            u,
            {"artefact": "m", "axial": "m", "tilt": "rad"},
            {"angle": angle},
            self.null_space(),
            noise=averaged.noise,
            harmonics=harmonics,
            harmonics_u=spread,
            audit={
                "radius_mm": self.radius * 1e3,
                "n_repeats": averaged.n_repeats,
                "n_samples": n,
                "axial_readings": array.shape[0] - 2,
                "removed": "least squares: mean of all, once-per-revolution of plate and tilt",
            },
            messages=(
                *averaged.messages,
                *size_doubts(array, self.name),
                *gap_message(parts["artefact"]),
            ),
            history=(*history, Step(self.name, {"radius_m": self.radius})),
        )


def face_reversal(
    f1: ArrayLike | Profile,
    f2: ArrayLike | Profile,
    axial: ArrayLike | Profile,
    radius: float,
    *,
    axial2: ArrayLike | Profile | None = None,
    angle: ArrayLike | None = None,
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
    angle : array_like, shape (n,), rad, optional
        Angles of the samples, if the readings are arrays; from 0 if omitted.
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
        finite; if the radius is not positive, or the angles do not close one revolution.
    NotSeparableError
        If too few angles were measured in every set-up.

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
    readings, positions, history = curves(items, what="face_reversal", axis="angle")
    array = stacked(readings, "face_reversal")
    start = first_angle(positions, angle, array.shape[2], "face_reversal")
    method = FaceReversal(radius, start)
    return method.separate(array, u_reading=u_reading, history=history)


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
