"""`SpindleMotion` and `SpindleHarmonics`: what a spindle test gives back."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from metrosep.core._arrays import ComplexArray, FloatArray, frozen_float
from metrosep.core.errors import (
    DataError,
    InvalidSamplesError,
    NotUniformError,
    TooFewSamplesError,
    UnitError,
)
from metrosep.core.profile import html_table
from metrosep.core.provenance import Step
from metrosep.core.quantity import Quantity
from metrosep.core.recording import Recording
from metrosep.parameters.circle import CirclePoints, best_circle
from metrosep.parameters.table import ParameterTable
from metrosep.separation._readings import plain, real_numbers
from metrosep.separation.circles.resampling import AngleSynchronous, resample_by_encoder
from metrosep.separation.contract import StoredResult

if TYPE_CHECKING:
    import pandas as pd


@dataclass(frozen=True, slots=True, eq=False, repr=False)
class SpindleHarmonics(StoredResult):
    """Harmonics of the mean revolution and of the scatter; arrays over k = 1 .. n // 2.

    Parameters
    ----------
    k : ndarray of int, shape (h,)
        Undulations per revolution.
    amplitude : ndarray, shape (h,), m or rad
        Of the mean revolution: ``amplitude cos(k t - phase)``.
    phase : ndarray, shape (h,), rad
        Angle k t at which the harmonic is highest, -pi to pi.
    u : ndarray, shape (h,), m or rad
        Standard uncertainty of the amplitude, from the scatter between revolutions.
    nrr : ndarray, shape (h,), m or rad
        Non-repeatable: root mean square deviation of the complex amplitude of one revolution from
        the mean.
    significant : ndarray of bool, shape (h,)
        Whether the harmonic repeats (F test, 1 % of those named are expected to be noise).
    removed : tuple of int
        Harmonics that are not in the synchronous motion, such as the eccentricity k = 1.
    """

    k: NDArray[np.intp]
    amplitude: FloatArray
    phase: FloatArray
    u: FloatArray
    nrr: FloatArray
    significant: NDArray[np.bool_]
    removed: tuple[int, ...]

    def __repr__(self) -> str:
        found = [int(k) for k in self.k[self.significant]]
        named = ", ".join(str(k) for k in found[:8]) + (", ..." if len(found) > 8 else "")
        return f"SpindleHarmonics(k = 1 .. {int(self.k[-1])}, repeating: {named or 'none'})"

    def to_frame(self) -> pd.DataFrame:
        """Return a row per k: ``amplitude``, ``phase_rad``, ``u``, ``nrr``, ``significant``, ``removed``."""
        import pandas as pd

        return pd.DataFrame(
            {
                "amplitude": self.amplitude,
                "phase_rad": self.phase,
                "u": self.u,
                "nrr": self.nrr,
                "significant": self.significant,
                "removed": np.isin(self.k, self.removed),
            },
            index=pd.Index(self.k, name="k"),
        )


@dataclass(frozen=True, slots=True, eq=False, repr=False)
class SpindleMotion(StoredResult):
    """Result of a spindle test after ISO 230-7; frozen, SI.

    Parameters
    ----------
    direction : {"radial", "axial", "tilt", "face"}
        What was measured.
    sensitive : {"fixed", "rotating"}
        Sensitive direction.
    center : {"LSC", "MZC", "MIC", "MCC", "PC"}
        Centre that widths are counted about; PC (polar chart) for axial and face motion.
    table : ParameterTable
        ``synchronous``, ``asynchronous``, ``total`` and more, each with unit, definition and u.
    angle : ndarray, shape (n,), rad
        Of the columns.
    motion : ndarray, shape (m, n), m or rad
        Error motion of each revolution about the centre, mean level removed.
    synchronous_motion : ndarray, shape (n,), m or rad
        Mean over revolutions about the centre, only k <= kmax where that was asked.
    asynchronous_range : ndarray, shape (n,), m or rad
        Largest minus smallest reading at each angle.
    asynchronous_sd : ndarray, shape (n,), m or rad
        Standard deviation over revolutions (ddof 1) at each angle.
    harmonics : SpindleHarmonics
        Of the readings before the centre was removed.
    centre : tuple of (float, float), m or rad
        What was removed as ``a cos t + b sin t``; zeros where k = 1 is kept.
    revolutions : ndarray of int, shape (m,)
        Numbers of the revolutions used, in the record.
    audit : mapping
        Settings and what was removed, plain values.
    messages : tuple of str
        Warnings.
    """

    direction: str
    sensitive: str
    center: str
    table: ParameterTable
    angle: FloatArray
    motion: FloatArray
    synchronous_motion: FloatArray
    asynchronous_range: FloatArray
    asynchronous_sd: FloatArray
    harmonics: SpindleHarmonics
    centre: tuple[float, float]
    revolutions: NDArray[np.intp]
    audit: Mapping[str, Any]
    messages: tuple[str, ...]

    @property
    def synchronous(self) -> Quantity:
        """Synchronous error motion value."""
        return self.table["synchronous"]

    @property
    def asynchronous(self) -> Quantity:
        """Asynchronous error motion value."""
        return self.table["asynchronous"]

    @property
    def total(self) -> Quantity:
        """Total error motion value."""
        return self.table["total"]

    @property
    def n_revolutions(self) -> int:
        """Revolutions used."""
        return int(self.motion.shape[0])

    @property
    def unit(self) -> str:
        """Unit of the motion: m, or rad for tilt."""
        return self.synchronous.unit

    def __getitem__(self, symbol: str) -> Quantity:
        return self.table[symbol]

    def to_dict(self) -> dict[str, Any]:
        """Return plain values for JSON, SI: keys of the table and settings, no arrays over angle."""
        head = {n: getattr(self, n) for n in ("direction", "sensitive", "center", "centre")}
        tail = {"audit": self.audit, "messages": self.messages}
        found: dict[str, Any] = plain({**head, **self.table.to_dict(), **tail})
        return found

    def _repr_html_(self) -> str:
        """Return a small table for notebooks."""
        rows = {s: f"{q} \N{EM DASH} {q.definition}" for s, q in self.table.items()}
        rows.update({f"message {i + 1}": m for i, m in enumerate(self.messages)})
        title = f"{self.direction} error motion, {self.center}, {self.n_revolutions} revolutions"
        return html_table(title, rows)

    def __repr__(self) -> str:
        head = f"SpindleMotion({self.direction}, {self.sensitive} sensitive direction"
        return (
            f"{head}, {self.center}, {self.n_revolutions} revolutions: synchronous "
            f"{self.synchronous}, asynchronous {self.asynchronous}, total {self.total})"
        )


# ---- the many shapes in which spindle readings come, as one table ----------------------------

_TURN = 2.0 * math.pi
_UNEVEN = 1e-3
"""Largest relative departure of time or angle steps from their mean."""


def readings_of(
    signals: Any,
    angle: Any,
    *,
    names: Sequence[str],
    channels: Sequence[str] | str | None,
    n: int | None,
) -> tuple[AngleSynchronous, tuple[Step, ...]]:
    """Return channels (c, m, n) at the same angles of each revolution, without NaN, and their history.

    The channels are those that a direction needs, in the order of `names`.
    """
    history: tuple[Step, ...] = ()
    units: Mapping[str, str] = {}
    if isinstance(signals, Recording):
        steps = np.diff(signals.t)
        if steps.size and np.ptp(steps) > _UNEVEN * float(steps.mean()):
            raise NotUniformError(
                "the recording is not sampled uniformly in time: resample it, or give arrays at "
                "fixed angles"
            )
        history = signals.history
        units = signals.units
        signals = signals.channels
    if isinstance(signals, Mapping):
        if isinstance(angle, str):
            if angle not in signals:
                raise DataError(f"no channel {angle!r} among {', '.join(signals)}")
            _check_unit(units, angle, "rad")
            name, angle = angle, signals[angle]
            signals = {k: v for k, v in signals.items() if k != name}
        signals = _named(signals, names, channels, units)
    elif isinstance(angle, str):
        raise DataError("angle= names a channel only where the signals have names")
    elif channels is not None:
        raise DataError("channels= names signals of a mapping or Recording: leave it out")
    return _complete(_arranged(signals, angle, names, n)), history


def _check_unit(units: Mapping[str, str], name: str, expected: str) -> None:
    unit = units.get(name, expected)
    if unit != expected:
        raise UnitError(f"channel {name!r} is in {unit}, not in {expected}: convert it")


def _named(
    signals: Mapping[str, Any],
    names: Sequence[str],
    channels: Sequence[str] | str | None,
    units: Mapping[str, str],
) -> FloatArray:
    chosen = (
        [channels] if isinstance(channels, str) else list(names if channels is None else channels)
    )
    if channels is None and len(names) == len(signals) == 1:
        chosen = list(signals)
    if len(chosen) != len(names):
        raise DataError(f"channels= must name {len(names)} signals ({', '.join(names)})")
    missing = [c for c in chosen if c not in signals]
    if missing:
        raise DataError(
            f"no channel {', '.join(missing)} among {', '.join(signals)}: name the signals for "
            f"{', '.join(names)} with channels="
        )
    for name in chosen:
        _check_unit(units, name, "m")
    arrays = [real_numbers(signals[c], f"channel {c!r}") for c in chosen]
    if len({a.shape for a in arrays}) > 1:
        text = ", ".join(f"{c} {a.shape}" for c, a in zip(chosen, arrays, strict=True))
        raise InvalidSamplesError(f"channels must have one shape: {text}")
    return arrays[0] if len(arrays) == 1 else np.stack(arrays)


def _arranged(signals: Any, angle: Any, names: Sequence[str], n: int | None) -> AngleSynchronous:
    """Return signals as revolutions, resampled where they come with an angle at each sample."""
    resampled = isinstance(signals, AngleSynchronous)
    if resampled and angle is not None:
        raise DataError("resampled signals carry their angle: leave angle out")
    values = signals.table if resampled else real_numbers(signals, "the signals")
    axes = 0 if len(names) == 1 else 1  # before the revolutions: channels
    theta = None
    if angle is not None:
        theta = np.asarray(real_numbers(angle, "the angle"), dtype=np.float64)
        if theta.ndim == values.ndim > 1 and theta.shape == values.shape and not axes:
            values, theta = values.ravel(), theta.ravel()
    columns = theta is None or (
        theta.ndim == 1 and values.ndim == 2 + axes and theta.size == values.shape[-1]
    )
    if columns and n is not None:
        raise DataError("n= resamples a record; these signals have their angles: leave it out")
    if columns and not resampled and values.ndim == 1:
        raise DataError(
            "one row of samples needs angle= (rad at each sample); or give (revolutions, angles)"
        )
    wanted = (2 if columns else 1) + axes
    given = resampled and values.ndim == 3 and not axes  # one channel with its axis
    if (values.ndim != wanted and not given) or (
        values.shape[0] != len(names) and (axes or given)
    ):
        lead = f"{len(names)}, " if axes else ""
        raise InvalidSamplesError(
            f"signals of shape {values.shape} do not fit: need ({lead}n_samples) with angle=, or "
            f"({lead}revolutions, angles) without, for {', '.join(names)}"
        )
    if columns and not resampled:
        return _synchronous(
            frozen_float(values if axes else values[None], name="the signals", ndim=3), theta
        )
    found = signals if resampled else resample_by_encoder(values, np.asarray(theta), n=n)
    return replace(found, table=found.table if found.table.ndim == 3 else found.table[None])


def _synchronous(table: FloatArray, theta: FloatArray | None) -> AngleSynchronous:
    """Return channels (c, m, n) at the angles of a grid, from 0 if none is given."""
    size = table.shape[2]
    grid = _TURN * np.arange(size) / size
    rotation = 1
    if theta is not None:
        grid = _one_turn(theta)
        rotation = 1 if grid[1] > grid[0] else -1
        if rotation < 0:
            grid, table = grid[::-1], table[..., ::-1]
    turns = int(table.shape[1])
    return AngleSynchronous(
        table=table,
        angle=grid,
        start=0 if rotation > 0 else size - 1,
        revolutions=np.arange(turns),
        speed=np.full(turns, np.nan),
        speed_unit="rev/s",
        rotation=rotation,
        noise_gain=1.0,
        audit={
            "source": "angle-synchronous",
            "n_revolutions": turns,
            "n_angles": size,
            "interpolation": "none",
            "rotation": rotation,
        },
        messages=(),
    )


def _one_turn(theta: FloatArray) -> FloatArray:
    """Return a grid over one turn; refuse any other."""
    at = frozen_float(theta, name="the angle", ndim=1, min_size=2)
    step = _TURN / at.size
    found = np.diff(np.unwrap(at))
    if np.isnan(found).any() or not (
        np.abs(found - step).max() < _UNEVEN * step or np.abs(found + step).max() < _UNEVEN * step
    ):
        raise NotUniformError(
            f"the angle of {at.size} columns must be one turn in equal steps of 2 pi / {at.size} = "
            f"{step:.4g} rad, without its end twice; got {float(found[0]):.4g} first: give rad, or "
            "one row of samples with an accumulated angle"
        )
    return np.asarray(np.unwrap(at))


def _complete(readings: AngleSynchronous) -> AngleSynchronous:
    """Leave out revolutions with NaN, and say so."""
    table = readings.table
    whole = ~np.isnan(table).any(axis=(0, 2))
    messages = list(readings.messages)
    dropped = readings.revolutions[~whole].tolist()
    if dropped:
        named = ", ".join(str(d) for d in dropped[:10]) + (" ..." if len(dropped) > 10 else "")
        messages = [m for m in messages if "not measured" not in m]
        messages.append(
            f"omitted {len(dropped)} revolution(s) with samples that were not measured: {named}"
        )
        table = table[:, whole]
    if table.shape[1] < 2:
        raise TooFewSamplesError(
            f"{table.shape[1]} whole revolution(s): need 2 to tell what repeats, and 20 by the "
            "standard"
        )
    if table.shape[2] < 8:
        raise TooFewSamplesError(f"{table.shape[2]} angles per revolution, need 8")
    return replace(
        readings,
        table=table,
        revolutions=readings.revolutions[whole],
        audit={**readings.audit, "revolutions_with_nan": dropped},
        messages=tuple(messages),
    )


# ---- private helpers: what the scatter between revolutions does to the numbers of a spindle test ----
# The deviations of the revolutions from their mean are taken as stationary, Gaussian and independent
# from revolution to revolution; their power per harmonic is estimated from the data, so noise that
# is correlated over angle is counted right.

_FALSE_SHARE = 0.01
"""Expected share of harmonics called significant that are noise (Benjamini and Hochberg)."""

_NEGLIGIBLE = 1e-6
"""Noise over real motion below which no circle is worth its time."""

_TAIL = 8.0
"""Standard deviations of noise at which its probability is rounding."""

_LEVELS = 800
_OFFSETS = 401
_LEAST_WITHIN = 0.0025
"""Least share of the variance within revolutions, so that the levels resolve it."""

_MOST_ANGLES = 256
"""Groups of like height into which the angles of the mean curve are put."""

_GUMBEL_SD = math.pi / math.sqrt(6.0)


@dataclass(frozen=True, slots=True, eq=False)
class Spectrum:
    """Mean and scatter of the harmonics of the revolutions.

    `mean` (k = 0 .. n // 2) in amplitudes, ``sum mean_k exp(i k t)`` real part; `power` is the
    variance of the complex amplitude of one revolution, ``E |A - mean|^2``.
    """

    mean: ComplexArray
    power: FloatArray
    significant: NDArray[np.bool_]
    n_revolutions: int
    n_angles: int


def spectrum_of(table: FloatArray, first_angle: float) -> Spectrum:
    """Return harmonics of a table (m, n) without NaN, phases counted from the physical angle 0."""
    m, n = table.shape
    lines = np.fft.rfft(table, axis=1)
    lines *= 2.0 / n
    lines[:, 0] *= 0.5
    if n % 2 == 0:
        lines[:, -1] *= 0.5
    mean = lines.mean(axis=0)
    deviation = lines - mean
    power = (deviation.real**2 + deviation.imag**2).sum(axis=0) / (m - 1)
    size = mean.real**2 + mean.imag**2
    k = np.arange(mean.size)
    return Spectrum(
        mean * np.exp(-1j * k * first_angle), power, _significant(size, power, m), m, n
    )


def _significant(size: FloatArray, power: FloatArray, m: int) -> NDArray[np.bool_]:
    """F test of each harmonic on (2, 2 (m - 1)) degrees of freedom, false share limited."""
    some = power > 0.0
    ratio = np.where(size > 0.0, np.inf, 0.0)
    np.divide(m * size, power, out=ratio, where=some)
    p = (1.0 + ratio / (m - 1)) ** -(m - 1.0)
    order = np.argsort(p[1:])
    limit = _FALSE_SHARE * np.arange(1, order.size + 1) / max(order.size, 1)
    passed = np.flatnonzero(p[1:][order] <= limit)
    found = np.zeros(size.size, dtype=bool)
    if passed.size:
        found[1 + order[: passed[-1] + 1]] = True
    return found


class NoiseEffect(NamedTuple):
    """Peak to valley of pure noise, its mean effect on the real curve, and the scatter there."""

    floor: float
    bias: float
    sd: float


def noise_effect(
    spectrum: Spectrum,
    kept: NDArray[np.bool_],
    width: Callable[[FloatArray], float],
    *,
    n_draws: int,
    seed: int,
) -> NoiseEffect:
    """Return what noise does to the peak-to-valley width of the mean revolution.

    `kept` are the harmonics of the curve; `width` takes it. Noise of the power found is drawn, and
    added to the curve of the significant harmonics. The floor is peak to valley without a centre.
    """
    n = spectrum.n_angles
    rng = np.random.default_rng(seed)
    noise = rng.normal(size=(n_draws, 2, kept.size))
    scale = np.sqrt(0.5 * np.where(kept, spectrum.power, 0.0) / spectrum.n_revolutions)
    curves = _curves((noise[:, 0] + 1j * noise[:, 1]) * scale, n)
    real = _curves(np.where(kept & spectrum.significant, spectrum.mean, 0.0)[None], n)[0]
    alone = np.ptp(curves, axis=1)
    if float(alone.max(initial=0.0)) <= _NEGLIGIBLE * float(np.ptp(real)):
        width = _peak_to_valley
    both = np.array([width(real + c) for c in curves])
    return NoiseEffect(
        float(alone.mean()), float(both.mean()) - width(real), float(both.std(ddof=1))
    )


def _peak_to_valley(curve: FloatArray) -> float:
    return float(curve.max() - curve.min())


def _curves(amplitudes: ComplexArray, n: int) -> FloatArray:
    lines = amplitudes * (0.5 * n)
    lines[:, 0] *= 2.0
    if n % 2 == 0:
        lines[:, -1] *= 2.0
    return np.fft.irfft(lines, n, axis=1)


def _variances(spectrum: Spectrum) -> tuple[FloatArray, FloatArray]:
    """Return the variance of a reading by harmonics, and their share of the power: 1/2 of most."""
    share = np.full(spectrum.power.size, 0.5)
    share[[0, -1] if spectrum.n_angles % 2 == 0 else [0]] = 1.0
    return share * spectrum.power, share


def u_of_sd(spectrum: Spectrum) -> float:
    """Return the standard uncertainty of the pooled standard deviation.

    The variance is the sum over harmonics of half the power (all of it for the mean and the last
    one), each with 2 (m - 1) degrees of freedom (m - 1).
    """
    part, share = _variances(spectrum)
    total = float(part.sum())
    if total == 0.0:
        return 0.0
    variance = float((2.0 * share * part**2).sum()) / (spectrum.n_revolutions - 1)
    return 0.5 * math.sqrt(variance / total)


def _hazard(z: float) -> float:
    """Return density over survival of the standard normal distribution."""
    if z > 30.0:
        return z + 1.0 / z
    survival = 0.5 * math.erfc(z / math.sqrt(2.0))
    return math.exp(-0.5 * z * z) / math.sqrt(2.0 * math.pi) / survival


def u_of_range(value: float, sd: float) -> float:
    """Return the standard uncertainty of the largest range over angles, from extreme values.

    The tail of a range r is that of a difference of two readings, sd sqrt 2; the largest of many is
    of Gumbel's form with the inverse hazard at r as its scale, however many are independent.
    """
    if sd == 0.0:
        return 0.0
    wide = sd * math.sqrt(2.0)
    return _GUMBEL_SD * wide / _hazard(value / wide)


def u_of_total(motion: FloatArray, spectrum: Spectrum) -> float:
    """Return the standard uncertainty of the width of all data (m, n), from extreme values.

    Highest and lowest reading each have the distribution of the largest of m n Gaussian values
    about the mean curve: an offset of each revolution, and noise of which successive values are as
    alike as its power says. Harmonics of the mean that do not repeat are noise, not curve.
    """
    m, n = motion.shape
    part, _ = _variances(spectrum)
    total = float(part.sum())
    lines = np.fft.rfft(motion.mean(axis=0))
    lines[np.flatnonzero(~spectrum.significant[2:]) + 2] = 0.0
    curve = np.fft.irfft(lines, n)
    if math.sqrt(total) <= _NEGLIGIBLE**2 * float(np.ptp(curve)):
        return math.sqrt(total)
    within = max(total - float(part[0]), _LEAST_WITHIN * total)
    step = 2.0 * math.pi / n * np.arange(1, part.size)
    alike = float((part[1:] * np.cos(step)).sum()) / within
    sd = math.sqrt(within)
    offset = math.sqrt(float(part[0])) / sd
    ends = [_variance_of_highest(c / sd, m, alike, offset) for c in (curve, -curve)]
    return sd * math.sqrt(sum(ends))


def _variance_of_highest(curve: FloatArray, m: int, alike: float, offset: float) -> float:
    """Return the variance of the highest of m revolutions ``curve + noise``, noise of sd 1.

    One revolution stays below x with probability ``exp(-sum_j g(x - curve_j))``. Independent values
    have ``g = -log Phi``. Values correlated by `alike` with the one before cross x upwards with
    probability 2 T(x, a) (T of Owen), which is Phi Q where they are independent.
    """
    from scipy.special import log_ndtr, ndtr, owens_t

    n = curve.size
    z = np.linspace(-_TAIL, _TAIL, _LEVELS)
    a = math.sqrt(max(1.0 - alike, 0.0) / max(1.0 + alike, 0.01))
    crossing = 2.0 * owens_t(z, a) / (ndtr(z) * ndtr(-z))
    g = -log_ndtr(z) * ((1.0 - 1.0 / n) * crossing + 1.0 / n)
    ordered = np.sort(curve)
    if n > _MOST_ANGLES:
        ordered = np.array([part.mean() for part in np.array_split(ordered, _MOST_ANGLES)])
    rate = np.interp(z[:, np.newaxis] + ordered[-1] - ordered, z, g).mean(axis=1) * n
    x = z * (1.0 + offset)
    shift = np.linspace(-_TAIL, _TAIL, _OFFSETS)
    weight = np.exp(-0.5 * shift * shift)
    below = np.interp(x[:, np.newaxis] - offset * shift, z, np.exp(-rate))
    steps = np.diff((below @ weight / weight.sum()) ** m, prepend=0.0)
    steps /= steps.sum()
    mean = float(steps @ x)
    return float(steps @ (x - mean) ** 2)


def revolution_correlation(deviation: FloatArray) -> float:
    """Return the correlation of successive revolutions' deviations, 0 where they do not deviate."""
    power = float((deviation * deviation).sum())
    if power == 0.0:
        return 0.0
    m = deviation.shape[0]
    return float((deviation[1:] * deviation[:-1]).sum()) / power * float(m / (m - 1))


# ---- private helpers of `iso230_7`: sensed motion, drift, centre, harmonics --------------------

_REFERENCES = {"MZC": "MZ", "MIC": "MI", "MCC": "MC"}


def sensed_motion(
    readings: AngleSynchronous, direction: str, sensitive: str, distance: float | None
) -> FloatArray:
    """Return the motion in the sensitive direction, shape (m, n)."""
    channels = readings.table
    if direction == "tilt":
        half = channels.shape[0] // 2
        channels = (channels[:half] - channels[half:]) / (distance or math.nan)
    if sensitive == "fixed":
        return np.asarray(channels[0])
    # r = X cos t + Y sin t
    return np.asarray(channels[0] * np.cos(readings.angle) + channels[1] * np.sin(readings.angle))


class Trend(NamedTuple):
    """Straight line over the record: rise per revolution, its standard uncertainty, the line."""

    slope: float
    u: float
    line: FloatArray


def trend_of(raw: FloatArray, readings: AngleSynchronous) -> Trend:
    """Return the drift, from differences between revolutions at the same angle only.

    Within a revolution a drift looks like a saw tooth of the synchronous motion, so the line is
    evaluated at the place of each sample in time.
    """
    m, n = raw.shape
    place = readings.rotation * (np.arange(n) - readings.start) % n / n
    turns = readings.revolutions.astype(np.float64)
    turns = turns - turns.mean()
    level = raw.mean(axis=1)
    spread = float(turns @ turns)
    slope = float(turns @ level) / spread
    rest = level - level.mean() - slope * turns
    u = math.sqrt(float(rest @ rest) / (m - 2) / spread) if m > 2 else math.nan
    line = slope * (turns[:, None] + place - place.mean())
    return Trend(slope, u, line)


class Circles(NamedTuple):
    """Circles of X + iY = sum c_m exp(i m t): m = 0, 1, 2 and their standard uncertainties."""

    size: tuple[float, float, float]
    u: tuple[float, float, float]

    def to_audit(self) -> dict[str, Any]:
        """Return plain values."""
        names = ("sensor_offset", "forward_once", "forward_twice")
        return dict(zip(names, self.size, strict=True))


def circles_of(readings: AngleSynchronous, distance: float | None) -> Circles:
    """Return the circles that vanish or become k = 1 in a rotating sensitive direction."""
    channels = readings.table
    if channels.shape[0] == 4:
        channels = (channels[:2] - channels[2:]) / (distance or math.nan)
    plane = channels[0] + 1j * channels[1]
    size, u = [], []
    for m in (0, 1, 2):
        each = (plane * np.exp(-1j * m * readings.angle)).mean(axis=1)
        mean = complex(each.mean())
        power = float((np.abs(each - mean) ** 2).sum()) / (each.size - 1)
        size.append(abs(mean))
        u.append(math.sqrt(0.5 * power / each.size))
    return Circles((size[0], size[1], size[2]), (u[0], u[1], u[2]))


def kept_harmonics(spectrum: Spectrum, kmax: int | None, *, centred: bool) -> NDArray[np.bool_]:
    """Return which harmonics are in the synchronous motion."""
    k = np.arange(spectrum.mean.size)
    kept: NDArray[np.bool_] = k >= (2 if centred else 1)
    return kept if kmax is None else kept & (k <= kmax)


def limited(curve: FloatArray, kmax: int) -> FloatArray:
    """Return a curve without harmonics above `kmax`."""
    lines = np.fft.rfft(curve)
    lines[kmax + 1 :] = 0.0
    return np.fft.irfft(lines, curve.size)


def centre_of(
    angle: FloatArray, curve: FloatArray, center: str
) -> tuple[tuple[float, float], float]:
    """Return the centre (a, b) and the mean level of a curve."""
    level = float(curve.mean())
    if center == "PC":
        return (0.0, 0.0), level
    flat = curve - level
    share = 2.0 / angle.size
    a, b = share * float(flat @ np.cos(angle)), share * float(flat @ np.sin(angle))
    if center == "LSC":
        return (a, b), level
    # the circle is sought from the least-squares centre: its size does not matter to the limacon
    flat = flat - a * np.cos(angle) - b * np.sin(angle)
    more = _circle(angle, flat, center)
    return (a + more[0], b + more[1]), level


def _circle(angle: FloatArray, flat: FloatArray, center: str) -> tuple[float, float]:
    if not np.ptp(flat) > 0.0:
        return 0.0, 0.0
    turned = angle - angle[0]
    points = CirclePoints(turned, flat, np.ones(angle.size))
    a, b = best_circle(points, _REFERENCES[center]).centre
    c, s = math.cos(float(angle[0])), math.sin(float(angle[0]))
    return a * c - b * s, a * s + b * c


def width_about(angle: FloatArray, center: str) -> Callable[[FloatArray], float]:
    """Return the function that gives the width of a curve about the centre.

    For "LSC" the curve must hold no k = 1.
    """
    if center in ("LSC", "PC"):
        return _peak_to_valley

    def width(curve: FloatArray) -> float:
        a, b = _circle(angle, curve, center)
        return _peak_to_valley(curve - a * np.cos(angle) - b * np.sin(angle))

    return width


def harmonics_of_spectrum(spectrum: Spectrum, *, centred: bool) -> SpindleHarmonics:
    """Return the harmonics k = 1 .. n // 2."""
    mean, power = spectrum.mean[1:], spectrum.power[1:]
    arrays = (
        np.arange(1, mean.size + 1),
        np.abs(mean),
        -np.angle(mean),
        np.sqrt(0.5 * power / spectrum.n_revolutions),
        np.sqrt(power),
        spectrum.significant[1:],
    )
    for array in arrays:
        array.setflags(write=False)
    return SpindleHarmonics(*arrays, removed=(1,) if centred else ())
