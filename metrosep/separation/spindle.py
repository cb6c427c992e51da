"""Spindle error motion after ISO 230-7 / ASME B89.3.4: synchronous, asynchronous, total.

Readings at the same angles of each revolution are split into their mean (synchronous) and the
deviations from it (asynchronous). The eccentricity of the artefact looks like k = 1: it is removed
from radial motion, and its inclination from tilt. In axial motion k = 1 is real (a tool on the axis
moves by it) and kept; so it is in face motion, where the squareness of the plate mixes in.

Sign: a reading is positive where the sensor says so. Inscribed and circumscribed circles take
positive as outwards. Angle counter-clockwise seen from +Z.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from typing import Literal

import numpy as np
from numpy.typing import ArrayLike

from metrosep.core.errors import DataError
from metrosep.core.recording import Recording
from metrosep.separation._spindle_input import Readings, readings_of
from metrosep.separation._spindle_noise import noise_effect, revolution_correlation, spectrum_of
from metrosep.separation._spindle_steps import (
    centre_of,
    circles_of,
    harmonics_of,
    kept_harmonics,
    limited,
    sensed_motion,
    trend_of,
    width_about,
)
from metrosep.separation._spindle_table import motion_messages, motion_table
from metrosep.separation.resampling import AngleSynchronous
from metrosep.separation.spindle_result import SpindleMotion

__all__ = ["iso230_7"]

Direction = Literal["radial", "axial", "tilt", "face"]
Sensitive = Literal["fixed", "rotating"]
Center = Literal["LSC", "MZC", "MRS", "MIC", "MCC"]

_CENTERS = {"LSC": "LSC", "MZC": "MZC", "MRS": "MZC", "MIC": "MIC", "MCC": "MCC"}
_CHANNELS: Mapping[tuple[str, str], tuple[str, ...]] = {
    ("radial", "fixed"): ("radial",),
    ("radial", "rotating"): ("x", "y"),
    ("axial", "fixed"): ("axial",),
    ("face", "fixed"): ("face",),
    ("tilt", "fixed"): ("upper", "lower"),
    ("tilt", "rotating"): ("x_upper", "y_upper", "x_lower", "y_lower"),
}
_CENTRED = ("radial", "tilt")
"""Directions whose k = 1 is the setting of the artefact."""

_DRAWS = 200
_DRAWS_EXTREME = 32
"""Draws of noise where each width is a linear program of some milliseconds."""


def iso230_7(
    signals: ArrayLike | Mapping[str, ArrayLike] | Recording | AngleSynchronous,
    angle: ArrayLike | str | None = None,
    direction: Direction = "radial",
    *,
    sensitive: Sensitive = "fixed",
    center: Center = "LSC",
    distance: float | None = None,
    kmax: int | None = None,
    drift: Literal["keep", "linear"] = "keep",
    artefact_radius: float | None = None,
    channels: Sequence[str] | str | None = None,
    n: int | None = None,
    seed: int = 0,
) -> SpindleMotion:
    """Return synchronous, asynchronous and total error motion of a spindle.

    Parameters
    ----------
    signals : array_like, mapping, Recording or AngleSynchronous, m
        One sensor: (n_samples,) with an angle, or (m, n) revolutions at n fixed angles. Several:
        one more axis in front, in the order X, Y (radial, rotating); upper, lower (tilt); X upper,
        Y upper, X lower, Y lower (tilt, rotating). A mapping or Recording names them.
    angle : array_like or str, rad, optional
        Spindle angle at each sample, accumulated or wrapped; name of its channel; the grid (n,) of
        one turn; or None where the columns lie at 2 pi j / n.
    direction : {"radial", "axial", "tilt", "face"}, optional
        What the sensors measure.
    sensitive : {"fixed", "rotating"}, optional
        Fixed as on a lathe; rotating as on a boring mill: ``r = X cos t + Y sin t``.
    center : {"LSC", "MZC", "MRS", "MIC", "MCC"}, optional
        Least squares, minimum zone (B89.3.4 calls it minimum radial separation, "MRS"), maximum
        inscribed, minimum circumscribed: centre of the synchronous curve for radial and tilt motion; total motion takes the same.
    distance : float, m, optional
        Tilt: distance of the two sensors along the axis, needed.
    kmax : int, optional
        Keep harmonics 2 .. kmax only in the synchronous motion; all by default, as the standard.
    drift : {"keep", "linear"}, optional
        Whether a straight line over the record is removed first.
    artefact_radius : float, m, optional
        Radius of the ball, to tell the false k = 2 of its eccentricity.
    channels : sequence of str, optional
        Names in a mapping or Recording, in the order above.
    n : int, optional
        Angles per revolution of resampled signals.
    seed : int, optional
        Of the noise drawn for the uncertainty of the synchronous value.

    Returns
    -------
    SpindleMotion
        Values with u in `table`; curves, revolutions and harmonics as arrays; messages.

    Raises
    ------
    DataError
        If an option, a channel or the distance is missing or not usable.
    InvalidSamplesError
        If shapes do not fit, or the angle is not usable.
    NotUniformError
        If a grid of angles or the time of a Recording is not uniform.
    TooFewSamplesError
        If fewer than 2 whole revolutions or 8 angles are left.
    UnitError
        If the angle looks like degrees or turns.
    DegenerateFitError, NotConvergedError
        If a circle is not determined; never for LSC.

    Notes
    -----
    Synchronous: peak-to-valley width of the mean over revolutions about the centre (two
    concentric limacons: exact for small motion, the value does not depend on the base radius of
    the chart up to motion^2 / radius). Asynchronous: largest range over revolutions at one angle.
    Total: width of all readings about the same centre. u of the synchronous value: noise of the
    scatter found is drawn and added to the significant harmonics; of the others: extreme values of
    Gaussian scatter. All assume that revolutions are independent; a message says where they are
    not.

    Null space. Form of the artefact adds to synchronous motion: reversal or `multiprobe`. A fixed
    sensor cannot tell k = 1 of the axis from eccentricity. With rotating sensitive direction and
    ``X + iY = sum c_m exp(i m t)``, harmonic k of r holds c_(1+k) and conj c_(1-k): forward k = 1
    (eccentricity) becomes constant and vanishes, the zeros of the sensors (m = 0) become k = 1 and
    are removed, with them the real circle m = 2; backward m = -1 (an elliptical axis path) becomes
    k = 2 and is kept. Revolutions with NaN are left out and named.

    References
    ----------
    .. [1] ISO 230-7:2015, clauses 3 and 5 (from memory of the standard).
    .. [2] ASME B89.3.4-2010 (from memory of the standard).

    Examples
    --------
    >>> import numpy as np
    >>> t = np.arange(360) * np.pi / 180
    >>> once = 5e-6 * np.cos(t) + 1e-8 * np.cos(2 * t)
    >>> result = iso230_7(np.tile(once, (20, 1)))
    >>> print(f"{result.synchronous.value:.3g} m, {result['eccentricity'].value:.3g} m")
    2e-08 m, 5e-06 m
    """
    names = _channels_of(direction, sensitive)
    _check_options(direction, center, distance, kmax, drift, artefact_radius)
    readings = readings_of(signals, angle, names=names, channels=channels, n=n)
    if seed < 0:
        raise DataError(f"seed must not be negative, got {seed}")
    if kmax is not None and kmax > readings.angle.size // 2:
        raise DataError(
            f"kmax={kmax} with {readings.angle.size} angles: at most {readings.angle.size // 2}"
        )
    options = _Options(
        direction, sensitive, _CENTERS[center], distance, kmax, drift, artefact_radius, seed
    )
    return _evaluate(readings, options)


@dataclass(frozen=True, slots=True)
class _Options:
    direction: str
    sensitive: str
    center: str
    distance: float | None
    kmax: int | None
    drift: str
    artefact_radius: float | None
    seed: int

    @property
    def centred(self) -> bool:
        return self.direction in _CENTRED

    @property
    def reference(self) -> str:
        return self.center if self.centred else "PC"


def _evaluate(readings: Readings, options: _Options) -> SpindleMotion:
    raw = sensed_motion(readings, options.direction, options.sensitive, options.distance)
    trend = trend_of(raw, readings)
    if options.drift == "linear":
        raw = raw - trend.line
    rotating = options.sensitive == "rotating"
    circles = circles_of(readings, options.distance) if rotating else None
    spectrum = spectrum_of(raw, float(readings.angle[0]))
    mean = raw.mean(axis=0)
    curve = mean if options.kmax is None else limited(mean, options.kmax)
    reference = options.reference
    centre, level = centre_of(readings.angle, curve, reference)
    flat = centre[0] * np.cos(readings.angle) + centre[1] * np.sin(readings.angle) + level
    motion, curve = raw - flat, curve - flat
    deviation = raw - mean
    effect = noise_effect(
        spectrum,
        kept_harmonics(spectrum, options.kmax, centred=options.centred),
        width_about(readings.angle, reference),
        n_draws=_DRAWS if reference in ("LSC", "PC") else _DRAWS_EXTREME,
        seed=options.seed,
    )
    spread = raw.max(axis=0) - raw.min(axis=0)
    sd = np.sqrt((deviation * deviation).sum(axis=0) / (raw.shape[0] - 1))
    table = motion_table(
        direction=options.direction,
        center=reference,
        motion=motion,
        curve=curve,
        spread=spread,
        sd=sd,
        spectrum=spectrum,
        effect=effect,
        circles=circles,
        kmax=options.kmax,
        history=readings.history,
    )
    messages = motion_messages(
        direction=options.direction,
        table=table,
        spectrum=spectrum,
        effect=effect,
        correlation=revolution_correlation(deviation),
        trend=None if options.drift == "linear" else trend,
        circles=circles,
        kmax=options.kmax,
        artefact_radius=options.artefact_radius,
        noise_gain=readings.noise_gain,
    )
    if not options.centred and options.center != "LSC":
        messages.append(
            f"{options.direction} motion has no centre to choose: {options.center} changes nothing"
        )
    audit = {
        **readings.audit,
        **({} if circles is None else circles.to_audit()),
        **asdict(options),
        "center": reference,
        "removed": "mean and k=1 about the centre" if options.centred else "mean",
        "centre_cos": centre[0],
        "centre_sin": centre[1],
        "level": level,
        "drift_per_revolution": trend.slope,
        "u_drift_per_revolution": trend.u,
        "revolutions_used": int(raw.shape[0]),
    }
    for array in (motion, curve, spread, sd):
        array.setflags(write=False)
    return SpindleMotion(
        direction=options.direction,
        sensitive=options.sensitive,
        center=reference,
        table=table,
        angle=readings.angle,
        motion=motion,
        synchronous_motion=curve,
        asynchronous_range=spread,
        asynchronous_sd=sd,
        harmonics=harmonics_of(spectrum, centred=options.centred),
        centre=centre,
        revolutions=readings.revolutions,
        audit=audit,
        messages=(*readings.messages, *messages),
    )


def _channels_of(direction: str, sensitive: str) -> tuple[str, ...]:
    if sensitive not in ("fixed", "rotating"):
        raise DataError(f"the sensitive direction is 'fixed' or 'rotating', got {sensitive!r}")
    if direction not in ("radial", "axial", "tilt", "face"):
        raise DataError(f"direction is radial, axial, tilt or face, got {direction!r}")
    if (direction, sensitive) not in _CHANNELS:
        raise DataError(
            f"{direction} motion is along the axis: it has no rotating sensitive direction"
        )
    return _CHANNELS[direction, sensitive]


def _check_options(
    direction: str,
    center: str,
    distance: float | None,
    kmax: int | None,
    drift: str,
    artefact_radius: float | None,
) -> None:
    if center not in _CENTERS:
        raise DataError(f"center is one of {', '.join(_CENTERS)}, got {center!r}")
    if drift not in ("keep", "linear"):
        raise DataError(f"drift is 'keep' or 'linear', got {drift!r}")
    if (direction == "tilt") != (distance is not None):
        raise DataError(
            "tilt needs distance= of its two sensors along the axis, in m"
            if direction == "tilt"
            else f"distance= belongs to tilt, not to {direction}: leave it out"
        )
    for name, value in (("distance", distance), ("artefact_radius", artefact_radius)):
        if value is not None and not (math.isfinite(value) and value > 0.0):
            raise DataError(f"{name} must be positive, in m, got {value}")
    if kmax is not None and (not np.issubdtype(type(kmax), np.integer) or kmax < 2):
        raise DataError(f"kmax must be an integer of at least 2, got {kmax!r}")
