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
from typing import Any, ClassVar, Literal

import numpy as np
from numpy.typing import ArrayLike

from metrosep.core._arrays import FloatArray
from metrosep.core.errors import DataError, FormatMismatchError, InvalidSamplesError
from metrosep.core.methods import Readings
from metrosep.core.numbers import choice, count, positive, real
from metrosep.core.options import Option
from metrosep.core.provenance import Step
from metrosep.core.quantity import Quantity
from metrosep.core.recording import Recording
from metrosep.core.units import format_engineering
from metrosep.parameters.table import Context, ParameterTable
from metrosep.separation._readings import (
    as_numbers,
    checked_readings,
    harmonics_of,
    harmonics_u,
    known_parts,
    part_of,
)
from metrosep.separation.circles.resampling import (
    AngleSynchronous,
    index_pulses,
    resample_by_index,
)
from metrosep.separation.circles.spindle_result import (
    SpindleMotion,
    centre_of,
    circles_of,
    harmonics_of_spectrum,
    kept_harmonics,
    limited,
    noise_effect,
    readings_of,
    revolution_correlation,
    sensed_motion,
    spectrum_of,
    trend_of,
    u_of_range,
    u_of_sd,
    u_of_total,
    width_about,
)
from metrosep.separation.contract import (
    History,
    NamedMethod,
    Parts,
    RecordedMethod,
    Separation,
    Unobservable,
    as_stated,
    over_turn,
    settle,
    type_a,
)

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
    sensitive : {"fixed", "rotating"}, optional
        Fixed as on a lathe; rotating as on a boring mill: ``r = X cos t + Y sin t``.
    channels : sequence of str, optional
        Names in a mapping or Recording, in the order above.

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
    k = 2 and is kept. Revolutions with NaN are omitted and named.

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
    options = _Options(
        choice(direction, "direction", ("radial", "axial", "tilt", "face")),
        choice(sensitive, "the sensitive direction", ("fixed", "rotating")),
        _CENTERS[choice(center, "center", _CENTERS)],
        None if distance is None else positive(distance, "distance", dimension="length"),
        None if kmax is None else count(kmax, "kmax", least=2),
        choice(drift, "drift", ("keep", "linear")),
        None
        if artefact_radius is None
        else positive(artefact_radius, "artefact_radius", dimension="length"),
        count(seed, "seed", least=0),
    )
    if (direction, sensitive) not in _CHANNELS:
        raise DataError(
            f"{direction} motion is along the axis: it has no rotating sensitive direction"
        )
    if (direction == "tilt") != (distance is not None):
        raise DataError(
            "tilt needs distance= of its two sensors along the axis, in m"
            if direction == "tilt"
            else f"distance= belongs to tilt, not to {direction}: leave it out"
        )
    names = _CHANNELS[direction, sensitive]
    readings, history = readings_of(signals, angle, names=names, channels=channels, n=n)
    if kmax is not None and kmax > readings.angle.size // 2:
        raise DataError(
            f"kmax={kmax} with {readings.angle.size} angles: at most {readings.angle.size // 2}"
        )
    return _Evaluation(readings, options).result(history)


class SpindleTest(NamedMethod):
    """`iso230_7` by its name: by revolution at fixed angles, with an angle, or with an index."""

    name = "iso230_7"
    what = "synchronous, asynchronous and total error motion of a spindle, ISO 230-7"
    over = "angle"
    roles: ClassVar[Mapping[str, str]] = {"index": "any?", "time": "time?"}
    arguments: ClassVar[Mapping[str, Option]] = {
        "direction": Option(
            "text", choices=("radial", "axial", "tilt", "face"), help="what the sensors measure"
        ),
        "sensitive": Option(
            "text",
            choices=("fixed", "rotating"),
            help="sensitive direction: fixed as of a lathe, rotating as of a boring head",
        ),
        "center": Option(
            "text",
            choices=("LSC", "MZC", "MRS", "MIC", "MCC"),
            help='least squares, minimum zone (B89.3.4 calls it minimum radial separation, "MRS"), '
            "maximum inscribed, minimum circumscribed: centre of the synchronous curve for radial"
            " and tilt motion; total motion takes the same",
        ),
        "distance": Option(
            "size", help="distance of the two sensors of a tilt along the axis, needed for tilt"
        ),
        "kmax": Option(
            "integer",
            help="keep harmonics 2 .. kmax only in the synchronous motion; all by default, as the "
            "standard",
        ),
        "drift": Option(
            "text",
            choices=("keep", "linear"),
            help="linear: a straight line over the record is removed first",
        ),
        "artefact_radius": Option(
            "size", help="radius of the ball, to tell the false k = 2 of its eccentricity"
        ),
        "n": Option(
            "integer", help="samples per revolution after resampling by an index or an angle"
        ),
        "seed": Option(
            "integer", help="of the noise drawn for the uncertainty of the synchronous value"
        ),
        "sampling_rate": Option("frequency", help="of the signals beside an index channel"),
        "threshold": Option("number", help="level of the index channel at which a pulse begins"),
        "edge": Option(
            "text", choices=("rising", "falling"), help="edge of the index pulse that counts"
        ),
        "faults": Option(
            "text",
            choices=("refuse", "drop"),
            help="drop: revolutions between missing or extra pulses are omitted",
        ),
    }

    @classmethod
    def from_inputs(cls, data: Readings, options: Mapping[str, Any]) -> SpindleMotion:
        """Return the error motion of signals by revolution, over an angle, or with an index."""
        rest = dict(options)
        resampling: dict[str, Any] = {
            k: rest.pop(k) for k in ("threshold", "edge", "faults") if k in rest
        }
        index = data.extra.get("index")
        if index is not None:
            return iso230_7(_by_index(data, index[0], rest, resampling), **rest)
        if resampling:
            key = next(iter(resampling))
            raise DataError(f'{key} is for an index channel; name its column, index = "index_V"')
        if "sampling_rate" in rest:
            raise DataError(
                "sampling_rate is for an index channel; with an angle it is not needed"
            )
        fixed = data.values.shape[1] > 1  # revolutions at fixed angles
        if data.position is None and not fixed:
            raise FormatMismatchError(
                'the angle of the spindle is needed: angle = "angle_deg" (accumulated or wrapped), '
                'index = "index_V" with time or sampling_rate, or repeat = "revolution" at fixed '
                "angles"
            )
        if data.position is not None and fixed:
            over_turn(data)
        signals = data.values if fixed else data.values[:, 0]
        return iso230_7(signals[0] if len(signals) == 1 else signals, data.position, **rest)


def _by_index(
    data: Readings, index: FloatArray, options: dict[str, Any], resampling: dict[str, Any]
) -> AngleSynchronous:
    """Return signals at equal angles between the pulses of an index channel."""
    if data.position is not None or data.values.shape[1] > 1:
        raise FormatMismatchError(
            "an index channel gives the angle: leave angle, x and repeat out, or leave index out"
        )
    faults = resampling.pop("faults", "refuse")
    signals = data.values[:, 0]
    return resample_by_index(
        signals[0] if len(signals) == 1 else signals,
        index_pulses(index, **resampling),
        n=options.pop("n", None),
        faults=faults,
        sampling_rate=_rate(data, options.pop("sampling_rate", None)),
    )


def _rate(data: Readings, given: float | None) -> float | None:
    """Return the sampling rate: as given, or from a column of time, which must be uniform."""
    time = data.extra.get("time")
    if time is None or given is not None:
        return given
    steps = np.diff(time[0])
    middle = float(np.median(steps)) if steps.size else 0.0
    if middle <= 0.0 or float(np.abs(steps - middle).max()) > 0.01 * middle:
        raise InvalidSamplesError(
            "the samples are not uniform in time; an index channel needs uniform sampling: record "
            "so, or use an encoder angle"
        )
    return (len(time[0]) - 1) / float(time[0][-1] - time[0][0])


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


# ---- the evaluation: motion about its centre, table of values with uncertainties, warnings -----

_EDITION = "ISO 230-7:2015"
_CENTRES = {
    "LSC": "least-squares centre",
    "MZC": "minimum-zone centre",
    "MIC": "centre of the maximum inscribed circle",
    "MCC": "centre of the minimum circumscribed circle",
    "PC": "mean level",
}
_USUAL_REVOLUTIONS = 20
_BIAS = 0.01
"""Share of the synchronous value from which noise in it is reported."""

_CORRELATED = 0.3
_ROUNDING = 1e-9
"""Scatter over total motion below which it is rounding, no finding."""

_ROUNDING_READ = 1e-3
"""The same for offset and eccentricity of the readings, which were removed: 1e-12 of them."""

_FAR = 1e-3
"""Motion in m beyond which a message asks for the unit."""


class _Evaluation:
    """One spindle test: motion about the centre, scatter, and what noise does to the values."""

    def __init__(self, readings: AngleSynchronous, options: _Options) -> None:
        raw = sensed_motion(readings, options.direction, options.sensitive, options.distance)
        self.readings, self.options = readings, options
        self.trend = trend_of(raw, readings)
        if options.drift == "linear":
            raw = raw - self.trend.line
        rotating = options.sensitive == "rotating"
        self.circles = circles_of(readings, options.distance) if rotating else None
        self.spectrum = spectrum_of(raw, float(readings.angle[0]))
        mean = raw.mean(axis=0)
        curve = mean if options.kmax is None else limited(mean, options.kmax)
        self.centre, self.level = centre_of(readings.angle, curve, options.reference)
        a, b = self.centre
        flat = a * np.cos(readings.angle) + b * np.sin(readings.angle) + self.level
        self.motion, self.curve = raw - flat, curve - flat
        deviation = raw - mean
        self.correlation = revolution_correlation(deviation)
        self.effect = noise_effect(
            self.spectrum,
            kept_harmonics(self.spectrum, options.kmax, centred=options.centred),
            width_about(readings.angle, options.reference),
            n_draws=_DRAWS if options.reference in ("LSC", "PC") else _DRAWS_EXTREME,
            seed=options.seed,
        )
        self.spread = raw.max(axis=0) - raw.min(axis=0)
        self.sd = np.sqrt((deviation * deviation).sum(axis=0) / (raw.shape[0] - 1))

    def result(self, history: tuple[Step, ...]) -> SpindleMotion:
        """Return all that was found."""
        options, readings = self.options, self.readings
        table = self._table(history)
        for array in (self.motion, self.curve, self.spread, self.sd):
            array.setflags(write=False)
        return SpindleMotion(
            direction=options.direction,
            sensitive=options.sensitive,
            center=options.reference,
            table=table,
            angle=readings.angle,
            motion=self.motion,
            synchronous_motion=self.curve,
            asynchronous_range=self.spread,
            asynchronous_sd=self.sd,
            harmonics=harmonics_of_spectrum(self.spectrum, centred=options.centred),
            centre=self.centre,
            revolutions=readings.revolutions,
            audit={
                **readings.audit,
                **({} if self.circles is None else self.circles.to_audit()),
                **asdict(options),
                "center": options.reference,
                "removed": "mean and k=1 about the centre" if options.centred else "mean",
                "centre_cos": self.centre[0],
                "centre_sin": self.centre[1],
                "level": self.level,
                "drift_per_revolution": self.trend.slope,
                "u_drift_per_revolution": self.trend.u,
                "revolutions_used": int(self.motion.shape[0]),
            },
            messages=(*readings.messages, *self._messages(table)),
        )

    def _table(self, history: tuple[Step, ...]) -> ParameterTable:
        """Return all values with unit, definition and standard uncertainty."""
        direction, center, kmax = self.options.direction, self.options.reference, self.options.kmax
        effect, (m, n) = self.effect, self.motion.shape
        name, about = f"{direction} error motion", f"about the {_CENTRES[center]}"
        band = "" if kmax is None else f", harmonics up to {kmax}"
        value, largest = float(np.ptp(self.curve)), float(self.spread.max())
        pooled = math.sqrt(float((self.sd * self.sd).mean()))
        u_pooled = u_of_sd(self.spectrum)
        width, over = f"peak-to-valley width of the mean of {m} turns", f"of {m} revolutions"
        spread = "standard deviation over revolutions (ddof 1), root mean square over the angles"
        spread_4 = "4 standard deviations over revolutions; does not grow with their number"
        corrected = "synchronous value less the mean effect of noise on it"
        floor = f"synchronous value that the scatter alone gives with {m} revolutions"
        total, u_total = float(np.ptp(self.motion)), u_of_total(self.motion, self.spectrum)
        u_largest = u_of_range(largest, pooled)
        rows: list[tuple[str, float, float | None, str]] = [
            ("synchronous", value, effect.sd, f"synchronous {name}: {width} {about}{band}"),
            (
                "asynchronous",
                largest,
                u_largest,
                f"asynchronous {name}: largest range {over} at one angle",
            ),
            ("total", total, u_total, f"total {name}: width of all readings {over} {about}"),
            ("asynchronous_sd", pooled, u_pooled, spread),
            ("asynchronous_4s", 4.0 * pooled, 4.0 * u_pooled, spread_4),
            ("synchronous_corrected", max(value - effect.bias, 0.0), effect.sd, corrected),
            ("noise_floor", effect.floor, None, floor),
            *self._once_rows(),
        ]
        unit = "rad" if direction == "tilt" else "m"
        settings = {"direction": direction, "center": center, "revolutions": m, "kmax": kmax}
        return ParameterTable(
            [Quantity(v, unit, text, u=u, symbol=s) for s, v, u, text in rows],
            Context(
                edition=_EDITION,
                n_valid=m * n,
                n_total=m * n,
                history=history,
                settings=settings,
                notes=("u holds the scatter between revolutions, not the form of the artefact",),
            ),
        )

    def _once_rows(self) -> list[tuple[str, float, float | None, str]]:
        """Return what becomes of k = 1."""
        direction, circles = self.options.direction, self.circles
        once = float(np.abs(self.spectrum.mean[1]))
        u = math.sqrt(0.5 * float(self.spectrum.power[1]) / self.spectrum.n_revolutions)
        if circles is not None:
            once, u = circles.size[1], circles.u[1]
        if self.options.centred:
            what = "eccentricity" if direction == "radial" else "inclination"
            how = "removed" if circles is None else "constant in a rotating sensitive direction"
            symbol = "eccentricity" if direction == "radial" else "artefact_tilt"
            return [(symbol, once, u, f"amplitude of k=1, {what} of the artefact: {how}")]
        lines = np.fft.rfft(self.curve)
        lines[1] = 0.0
        rest = np.fft.irfft(lines, self.curve.size)
        return [
            (
                "fundamental",
                2.0 * once,
                2.0 * u,
                f"fundamental {direction} motion: twice k=1, kept",
            ),
            (
                "residual_synchronous",
                float(np.ptp(rest)),
                self.effect.sd,
                f"residual synchronous {direction} motion: peak to valley without k=1",
            ),
        ]

    def _messages(self, table: ParameterTable) -> list[str]:
        """Return the warnings, one sentence each."""
        m, options = self.spectrum.n_revolutions, self.options
        value, unit = table["synchronous"].value, table["synchronous"].unit
        said = [
            f"asynchronous is the largest range of {m} revolutions and grows with their number"
        ]
        if m < _USUAL_REVOLUTIONS:
            said.append(
                f"{m} revolutions: ISO 230-7 asks for {_USUAL_REVOLUTIONS} or more, and the "
                "asynchronous value is too small for comparison"
            )
        if unit == "m" and value > _FAR:
            said.append(
                f"the synchronous motion is {value:.3g} m: signals must be in metres (1e-6 times "
                "micrometres)"
            )
        said += self._noise_messages(value, unit)
        # revolutions that differ by the rounding of their numbers only say nothing
        scale = max(table["total"].value, _ROUNDING_READ * float(np.abs(self.spectrum.mean).max()))
        if table["asynchronous"].value > _ROUNDING * scale:
            if m >= 5 and self.correlation > _CORRELATED:
                said.append(
                    f"successive revolutions deviate alike (correlation {self.correlation:.2f}): a "
                    "slow motion or a drift; the uncertainties, made for independent revolutions, "
                    "are too small"
                )
            rise = abs(self.trend.slope) * (m - 1)
            clear = abs(self.trend.slope) >= 4.0 * self.trend.u
            if options.drift == "keep" and clear and rise >= 0.1 * table["asynchronous"].value:
                said.append(
                    f"the readings drift by {format_engineering(rise, unit)} over the record: it "
                    "is in the asynchronous and total values; drift='linear' removes a straight line"
                )
        said += self._circle_messages(table)
        if options.direction == "face":
            said.append(
                "k=1 of face motion holds the squareness of the plate: quote residual_synchronous, "
                "or separate them by face_reversal"
            )
        if math.isnan(self.readings.noise_gain):
            said.append(
                "cubic interpolation lowers broadband scatter: asynchronous values are low"
            )
        if not options.centred and options.center != "LSC":
            said.append(
                f"{options.direction} motion has no centre to choose: {options.center} changes "
                "nothing"
            )
        return said

    def _noise_messages(self, value: float, unit: str) -> list[str]:
        said, effect, spectrum, kmax = [], self.effect, self.spectrum, self.options.kmax
        if not spectrum.significant.any():
            said.append(
                "no harmonic repeats: the synchronous value is noise, about "
                f"{format_engineering(effect.floor, unit)} for this scatter"
            )
        elif effect.bias > _BIAS * value:
            said.append(
                f"noise adds about {format_engineering(effect.bias, unit)} to the synchronous "
                "value: synchronous_corrected is without it; kmax= or more revolutions lower it"
            )
        if kmax is not None:
            beyond = np.flatnonzero(spectrum.significant[kmax + 1 :]) + kmax + 1
            strong = [int(k) for k in beyond if abs(spectrum.mean[k]) > _BIAS * value]
            if strong:
                named = ", ".join(str(k) for k in strong[:8])
                said.append(f"harmonics that repeat are omitted by kmax={kmax}: k={named}")
        return said

    def _circle_messages(self, table: ParameterTable) -> list[str]:
        said, circles, radius = [], self.circles, self.options.artefact_radius
        value = table["synchronous"].value
        if radius is not None and self.options.direction == "radial":
            size = table["eccentricity"].value
            false = size**2 / (4.0 * radius)
            if false > _BIAS * value:
                said.append(
                    f"an eccentricity of {format_engineering(size, 'm')} on this radius gives a "
                    f"false k=2 of {format_engineering(false, 'm')}: centre the artefact better"
                )
        if circles is not None and circles.size[2] > max(5.0 * circles.u[2], _BIAS * value):
            said.append(
                "the axis also circles forward twice per revolution by "
                f"{format_engineering(circles.size[2], table['total'].unit)}: in a rotating "
                "sensitive direction that is k=1 and is removed with the zeros of the sensors"
            )
        return said


# ---- `SpindleSplit`: revolutions split into setting, synchronous and asynchronous motion -----

_ECCENTRIC = "mean and once-per-revolution are how the artefact is set: a fixed sensor cannot tell"
_ZERO = "the zero of the sensor is arbitrary"
_FORM = (
    "the form of the artefact is in every revolution alike: reverse it (donaldson) or use several "
    "probes (multiprobe)"
)
_MEAN = "what all revolutions share is synchronous by definition"


@dataclass(frozen=True, slots=True)
class SpindleSplit(RecordedMethod):
    """One fixed sensor over whole revolutions, after ISO 230-7, about the least-squares centre.

    Readings (M, n) in m: at least 2 revolutions at the same n angles; one with a NaN is omitted.
    Parts: ``setting`` and ``synchronous``, (n,), over the angle; ``asynchronous``, (M, n), of each
    revolution (two revolutions are simulated where it is not given).

    Parameters
    ----------
    direction : {"radial", "axial", "face"}, optional
        What the sensor measures. Radial: once-per-revolution is the setting of the artefact. Tilt
        is radial motion of the two sensors' difference over their distance.
    start : float, rad, optional
        Angle of the first sample.

    Raises
    ------
    DataError
        If the direction is unknown or the start no finite number.

    Notes
    -----
    `iso230_7` does the work; values after the standard (widths, with their u) are there. With
    white scatter s: ``s sqrt((1 - p/n)/M)`` for the synchronous motion, p = 3 functions of the
    setting (1 in axial motion), ``s sqrt(1 - 1/M)`` for the asynchronous.

    Examples
    --------
    >>> t = 2 * np.pi * np.arange(64) / 64
    >>> found = SpindleSplit().separate(np.tile(5e-6 * np.cos(t) + 1e-8 * np.cos(2 * t), (4, 1)))
    >>> bool(abs(found.synchronous - 1e-8 * np.cos(2 * t)).max() < 1e-18), found.suppressed
    (True, [0, 1])
    """

    direction: Literal["radial", "axial", "face"] = "radial"
    start: float = 0.0

    name = "spindle_split"
    truth_parts = ("setting",)
    error_parts = ("synchronous", "asynchronous")

    def __post_init__(self) -> None:
        choice(self.direction, "direction", ("radial", "axial", "face"))
        settle(self, start=real(self.start, "start", dimension="angle"))

    @property
    def _hidden(self) -> tuple[int, ...]:
        return (0, 1) if self.direction == "radial" else (0,)

    def simulate(self, truth: Parts, errors: Parts) -> FloatArray:
        parts = known_parts(self, truth, errors)
        shape = parts["asynchronous"].shape if "asynchronous" in parts else None
        if shape is None:
            shape = (2, next(iter(parts.values())).size)
        if len(shape) != 2:
            raise DataError(
                f"{self.name}: asynchronous has the shape (revolutions, n), got {shape}"
            )
        setting, synchronous = (
            part_of(parts, n, shape[1:], self.name) for n in ("setting", "synchronous")
        )
        return setting + synchronous + part_of(parts, "asynchronous", shape, self.name)

    def null_space(self) -> tuple[Unobservable, ...]:
        reason = _ECCENTRIC if self.direction == "radial" else _ZERO
        return (
            Unobservable("synchronous", "harmonic", self._hidden, reason),
            Unobservable("synchronous", "term", ("form of the artefact",), _FORM),
            Unobservable("asynchronous", "term", ("mean revolution",), _MEAN),
        )

    def _solved(self, readings: ArrayLike, stated: float | None, history: History) -> Separation:
        array = as_numbers(readings, f"{self.name} needs revolutions (M, n) as numbers")
        if array.ndim != 2:
            raise InvalidSamplesError(
                f"{self.name} needs revolutions at the same angles, shape (M, n), got {array.shape}"
            )
        array = checked_readings(array[None], names=("sensor",), minimum=8, what=self.name)
        _, count, n = array.shape
        angle = self.start + 2 * np.pi * np.arange(n) / n
        motion = iso230_7(array[0], angle, self.direction)
        mean = array[0, motion.revolutions].mean(axis=0)
        rest = np.full((count, n), np.nan)
        rest[motion.revolutions] = array[0, motion.revolutions] - mean
        curve = motion.synchronous_motion
        parts = {"setting": mean - curve, "synchronous": curve, "asynchronous": rest}
        m, p = motion.n_revolutions, 2 * len(self._hidden) - 1
        freedom = (m - 1) * n
        if stated is None:
            value = math.sqrt(float(np.nansum(rest**2)) / freedom)
            text = (
                f"standard deviation of one reading over {m} revolutions, asynchronous motion "
                "included"
            )
            noise = type_a(value, "m", text, freedom)
        else:
            noise = as_stated(stated, "m")
        s = noise.value
        u = {
            "setting": np.full(n, s * math.sqrt(p / (n * m))),
            "synchronous": np.full(n, s * math.sqrt((1.0 - p / n) / m)),
            "asynchronous": np.where(np.isnan(rest), np.nan, s * math.sqrt(1.0 - 1.0 / m)),
        }
        whole = array[:, motion.revolutions]
        coefficients = harmonics_of(curve, start=self.start, hidden=self._hidden)
        spread = np.where(
            np.isfinite(coefficients), harmonics_u(whole, np.ones(1), noise.value), np.nan
        )
        return Separation(
            self.name,
            parts,
            u,
            dict.fromkeys(parts, "m"),
            {"angle": angle},
            self.null_space(),
            noise=noise,
            harmonics={"synchronous": coefficients},
            harmonics_u={"synchronous": spread},
            audit={
                "direction": motion.direction,
                "center": motion.center,
                "revolutions_used": m,
                "n_angles": n,
                "removed": motion.audit["removed"],
                **{
                    f"{k}_nm": motion[k].value * 1e9
                    for k in ("synchronous", "asynchronous", "total")
                },
            },
            messages=motion.messages,
            history=(*history, Step(self.name, {"direction": self.direction})),
        )
