"""Calibration of a piezo-driven flexure: voltage up and down against displacement.

Displacement is positive in the direction in which the sensor reads it; which way that moves the
tool is for the drive table to say.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, Literal, get_args

import numpy as np
from numpy.typing import ArrayLike, NDArray

from metrosep.core import numbers
from metrosep.core._arrays import FloatArray, frozen_float
from metrosep.core.docs import described_by
from metrosep.core.errors import (
    DataError,
    DegenerateFitError,
    InvalidSamplesError,
    LimitError,
    TooFewSamplesError,
    UnitError,
)
from metrosep.core.provenance import Step
from metrosep.core.quantity import Quantity
from metrosep.core.recording import Recording
from metrosep.process._plain import Frozen, known

Direction = Literal["mean", "up", "down"]

_NEARLY = 0.99
"""Of the range of the log: curves that cover less are reported."""


@dataclass(frozen=True, slots=True, eq=False)
class FlexureCalibration(Frozen):
    """Displacement of a flexure over voltage.

    Parameters
    ----------
    voltage : ndarray, shape (n,), V
        Rising.
    up, down, mean : ndarray, shape (n,), m
        Mean displacement of the rising and of the falling sweeps, and of both; NaN for a
        direction that was not run.
    scatter : ndarray, shape (n,), m
        Standard deviation between sweeps of one direction; NaN with one sweep of each.
    quantities : mapping of str to Quantity
        ``sensitivity`` m/V, ``intercept`` m, ``full_scale`` m, and ``nonlinearity``,
        ``hysteresis``, ``repeatability`` as shares of full scale.
    line : {"end-point", "least-squares"}
        What sensitivity and nonlinearity refer to.
    audit : mapping
        Counts and settings, shares in percent of full scale; None where not known.
    messages : tuple of str
        In plain words.
    history : tuple of Step
        From the log on.
    """

    voltage: FloatArray
    up: FloatArray
    down: FloatArray
    mean: FloatArray
    scatter: FloatArray
    quantities: Mapping[str, Quantity]
    line: str
    audit: Mapping[str, Any]
    messages: tuple[str, ...]
    history: tuple[Step, ...] = ()

    @property
    def sensitivity(self) -> float:
        """Slope of the line in m/V."""
        return self.quantities["sensitivity"].value

    @property
    def intercept(self) -> float:
        """Displacement of the line at 0 V in m."""
        return self.quantities["intercept"].value

    @property
    def full_scale(self) -> float:
        """Range of the mean curve in m."""
        return self.quantities["full_scale"].value

    @property
    def nonlinearity(self) -> float:
        """Largest distance of the mean curve from the line over full scale."""
        return self.quantities["nonlinearity"].value

    @property
    def hysteresis(self) -> float:
        """Largest distance of the two directions over full scale."""
        return self.quantities["hysteresis"].value

    @property
    def repeatability(self) -> float:
        """Largest standard deviation between sweeps over full scale."""
        return self.quantities["repeatability"].value

    def evaluate(self, voltage: ArrayLike, *, direction: Direction = "mean") -> FloatArray:
        """Return displacements at voltages.

        Parameters
        ----------
        voltage : array_like, shape (n,), V
            Within the calibrated range.
        direction : {"mean", "up", "down"}, optional
            Curve to use.

        Returns
        -------
        ndarray, shape (n,), m
            By a monotone cubic through the curve; NaN stays NaN.

        Raises
        ------
        LimitError
            If a voltage was not calibrated.
        DataError
            If the direction is unknown or was not run.
        """
        v = frozen_float(np.atleast_1d(np.asarray(voltage)), name="voltage", ndim=1)
        return _through(self.voltage, self._curve(direction), v, "voltage", "V")

    @described_by(evaluate)
    def voltage_for(self, displacement: ArrayLike, *, direction: Direction = "mean") -> FloatArray:
        """Return the voltages that give displacements: the monotone inverse.

        Parameters
        ----------
        displacement : array_like, shape (n,), m
            Within the calibrated range.

        Returns
        -------
        ndarray, shape (n,), V
            `evaluate` of them gives the displacements back to 1e-12 of full scale; NaN stays NaN.

        Raises
        ------
        LimitError
            If a displacement is beyond the calibrated stroke.
        DataError
            If the curve is not monotone, or as of `evaluate`.
        """
        d = frozen_float(np.atleast_1d(np.asarray(displacement)), name="displacement", ndim=1)
        curve = self._curve(direction)
        _require_monotone(self.voltage, curve, direction)
        return _inverse(self.voltage, curve, d)

    def u_displacement(self, *, direction: Direction = "mean") -> float:
        """Return the standard uncertainty of a displacement that is set by voltage alone.

        Parameters
        ----------
        direction : {"mean", "up", "down"}, optional
            Curve that is used; the mean one carries half of the hysteresis as a limit.

        Returns
        -------
        float, m
            Scatter between sweeps, sensor and hysteresis; NaN if nothing tells it.
        """
        parts = [self.audit["resolution_nm"] * 1e-9 / math.sqrt(12.0)]
        if not math.isnan(self.repeatability):
            parts.append(self.repeatability * self.full_scale)
        if direction == "mean" and not math.isnan(self.hysteresis):
            parts.append(0.5 * self.hysteresis * self.full_scale / math.sqrt(3.0))
        known = [p for p in parts if p > 0.0]
        return math.sqrt(sum(p * p for p in known)) if known else math.nan

    def _curve(self, direction: str) -> FloatArray:
        numbers.choice(direction, "direction", get_args(Direction))
        curve: FloatArray = getattr(self, direction)
        if np.isnan(curve).any():
            raise DataError(f"the calibration holds no sweep {direction}; use direction='mean'")
        return curve


def flexure_calibration(
    recording: Recording,
    *,
    voltage: str = "voltage",
    displacement: str = "displacement",
    line: Literal["end-point", "least-squares"] = "end-point",
    resolution: float = 0.0,
) -> FlexureCalibration:
    """Return the calibration of a flexure from sweeps of its voltage.

    Parameters
    ----------
    recording : Recording
        Log of voltage in V and displacement in m, in order of time: up, down, as often as wanted.
    voltage, displacement : str, optional
        Names of the channels; the channel in V and the one in m if these do not exist.
    line : {"end-point", "least-squares"}, optional
        What sensitivity and nonlinearity refer to.
    resolution : float, m, optional
        Of the sensor, for the uncertainty.

    Returns
    -------
    FlexureCalibration
        Curves, sensitivity, nonlinearity, hysteresis, repeatability, inverse.

    Raises
    ------
    InvalidSamplesError
        If the mean curve is not monotone (the voltage is named) or a channel is missing.
    TooFewSamplesError
        If a sweep has fewer than 3 voltages.
    UnitError
        If a channel states another unit.
    DegenerateFitError
        If the voltage does not change, or the sweeps do not overlap.
    DataError
        If an option is not one of its choices.

    Notes
    -----
    Samples where either channel is NaN are omitted and counted. Dwells on one voltage are
    averaged, also of a noisy voltage that jumps between levels; samples on the way are counted. Sweeps are cut at the turning points. Whole sweeps count (95 % of the range); parts of
    one are omitted and named. Where a direction has no whole sweep, the first and the last part
    of a log that started inside the stroke are joined; failing that, parts of more than half stand
    in and the range is cut to what all sweeps share. They are compared on common voltages: the levels of
    the log where all sweeps share them, else 101 voltages by linear interpolation.
    Nonlinearity: largest distance of the mean curve from the line; hysteresis: largest
    distance of up and down; repeatability: largest standard deviation between sweeps of one
    direction; each over full scale, the range of the mean curve. Creep and rate are not separated:
    sweep at the speed of use.

    References
    ----------
    .. [1] Dual-servo paper, section 4.1: 16.6 um at 10 V, sensor 5 nm.

    Examples
    --------
    >>> v = np.concatenate([np.arange(11.0), np.arange(10.0)[::-1]])
    >>> log = Recording(np.arange(21.0), {"voltage": v, "displacement": 1.66e-6 * v})
    >>> result = flexure_calibration(log)
    >>> round(result.sensitivity * 1e6, 9), round(result.nonlinearity, 9)
    (1.66, 0.0)
    """
    numbers.choice(line, "line", ("end-point", "least-squares"))
    resolution = numbers.not_negative(resolution, "resolution", dimension="length")
    v, d, lost = samples(recording, voltage, displacement)
    if not float(np.ptp(v)) > 0.0:
        raise DegenerateFitError(f"the voltage stays at {v[0]:.6g} V; sweep it up and down")
    v, d, between = levels(v, d)
    # one point for each dwell: only exact repeats are dwells, a slow ramp must not be taken for one
    start = np.concatenate([[0], np.flatnonzero(np.diff(v) != 0.0) + 1])
    size = np.diff(np.append(start, v.size))
    v, d = v[start], np.asarray(np.add.reduceat(d, start) / size)
    cut = sweeps(v, d)
    runs = cut.runs
    grid, curves = on_common_voltages(runs)
    rising = np.array([s[0][-1] > s[0][0] for s in runs])
    up, down, mean, scatter = branches(curves, rising)
    _require_monotone(grid, mean, "mean")
    slope, height = _line(grid, mean, line)
    scale = abs(float(mean[-1] - mean[0]))
    quantities = {
        "sensitivity": Quantity(
            slope, "m/V", f"{line} slope of displacement over voltage",
            _u_slope(grid, curves, rising, resolution, line), "S",
        ),
        "intercept": Quantity(height, "m", f"displacement of the {line} line at 0 V"),
        "full_scale": Quantity(scale, "m", "range of the mean displacement"),
        "nonlinearity": Quantity(
            float(np.abs(mean - slope * grid - height).max()) / scale, "1",
            f"largest distance from the {line} line over full scale",
        ),
        "hysteresis": Quantity(
            float(np.abs(up - down).max()) / scale, "1", "largest distance of up and down over full scale"
        ),
        "repeatability": Quantity(
            float(np.nanmax(scatter)) / scale if not np.isnan(scatter).all() else math.nan, "1",
            "largest standard deviation between sweeps over full scale",
        ),
    }  # fmt: skip
    percent = {
        f"{n}_percent_fs": known(100.0 * quantities[n].value)
        for n in ("nonlinearity", "hysteresis", "repeatability")
    }
    audit = {
        "sweeps_up": int(rising.sum()),
        "sweeps_down": int((~rising).sum()),
        "sweeps_left_out": cut.left_out,
        "join_jump_nm": tuple(1e9 * j for j in cut.jumps),
        "samples_not_measured": lost,
        "samples_between_levels": between,
        "voltages": int(grid.size),
        "range_V": (float(grid[0]), float(grid[-1])),
        "resolution_nm": resolution * 1e9,
        **percent,
    }
    messages = (*cut.messages, *_messages(v, grid, rising, scale, quantities, resolution))
    history = (*recording.history, Step("flexure_calibration", {"line": line}))
    return FlexureCalibration(
        grid, up, down, mean, scatter, quantities, line, audit, messages, history
    )


def _line(v: FloatArray, d: FloatArray, line: str) -> tuple[float, float]:
    if line == "end-point":
        slope = float(d[-1] - d[0]) / float(v[-1] - v[0])
        return slope, float(d[0]) - slope * float(v[0])
    centre, level = float(v.mean()), float(d.mean())
    slope = float((v - centre) @ (d - level)) / float((v - centre) @ (v - centre))
    return slope, level - slope * centre


def _u_slope(
    grid: FloatArray, curves: FloatArray, rising: NDArray[np.bool_], resolution: float, line: str
) -> float | None:
    slopes = np.array([_line(grid, c, line)[0] for c in curves])
    squares, freedom = 0.0, 0
    for own in (slopes[rising], slopes[~rising]):
        if own.size > 1:
            squares += float(((own - own.mean()) ** 2).sum())
            freedom += own.size - 1
    sensor = math.sqrt(2.0 / 12.0) * resolution / float(grid[-1] - grid[0])
    if freedom:
        return math.hypot(math.sqrt(squares / freedom / slopes.size), sensor)
    return sensor if resolution > 0.0 else None


def _require_monotone(v: FloatArray, d: FloatArray, which: str) -> None:
    steps = np.diff(d)
    sign = math.copysign(1.0, float(d[-1] - d[0]))
    wrong = np.flatnonzero(sign * steps <= 0.0)
    if wrong.size:
        i = int(wrong[0])
        raise InvalidSamplesError(
            f"the {which} curve is not monotone at {v[i + 1]:.6g} V: displacement goes from "
            f"{d[i]:.6g} m at {v[i]:.6g} V to {d[i + 1]:.6g} m; it has no inverse there: look for "
            "saturation or noise, or sweep fewer voltages"
        )


def _through(x: FloatArray, y: FloatArray, at: FloatArray, name: str, unit: str) -> FloatArray:
    from scipy.interpolate import PchipInterpolator

    low, high = float(x[0]), float(x[-1])
    slack = 1e-9 * (high - low)
    outside = (at < low - slack) | (at > high + slack)
    if outside.any():
        worst = float(at[int(np.argmax(np.where(outside, np.abs(at - 0.5 * (low + high)), 0.0)))])
        raise LimitError(
            f"{name} {worst:.6g} {unit} lies outside the calibrated {low:.6g} ... {high:.6g} {unit} "
            f"by {max(low - worst, worst - high):.3g} {unit}; reduce it or calibrate further"
        )
    result = np.full(at.size, np.nan)
    valid = ~np.isnan(at)
    result[valid] = PchipInterpolator(x, y)(np.clip(at[valid], low, high))
    return result


def _inverse(v: FloatArray, d: FloatArray, at: FloatArray) -> FloatArray:
    """Return the voltages by bracketed Newton steps on the monotone cubic."""
    from scipy.interpolate import PchipInterpolator

    turned = d[-1] < d[0]
    x, y = (v[::-1], d[::-1]) if turned else (v, d)
    guess = _through(y, x, at, "displacement", "m")
    valid = ~np.isnan(guess)
    curve = PchipInterpolator(v, d)
    slope = curve.derivative()
    target, point = at[valid], guess[valid]
    cell = np.clip(np.searchsorted(y, target, side="right") - 1, 0, y.size - 2)
    low, high = np.minimum(x[cell], x[cell + 1]), np.maximum(x[cell], x[cell + 1])
    rise = -1.0 if turned else 1.0
    for _ in range(60):
        rest = rise * (curve(point) - target)
        low, high = np.where(rest <= 0.0, point, low), np.where(rest > 0.0, point, high)
        steep = rise * slope(point)
        with np.errstate(divide="ignore", invalid="ignore"):
            following = point - rest / steep
        inside = (following > low) & (following < high) & (steep > 0.0)
        following = np.where(
            inside | (rest == 0.0), np.where(rest == 0.0, point, following), 0.5 * (low + high)
        )
        if float(np.abs(following - point).max(initial=0.0)) <= 1e-15 * float(np.abs(v).max()):
            break
        point = following
    guess[valid] = np.clip(point, v[0], v[-1])
    return guess


def _messages(
    v: FloatArray,
    grid: FloatArray,
    rising: NDArray[np.bool_],
    scale: float,
    quantities: Mapping[str, Quantity],
    resolution: float,
) -> list[str]:
    messages = []
    if float(np.ptp(grid)) < _NEARLY * float(np.ptp(v)):
        messages.append(
            f"the curves cover {grid[0]:.4g} ... {grid[-1]:.4g} V of the {v.min():.4g} ... "
            f"{v.max():.4g} V of the log, what all sweeps share: full scale is of that part; sweep "
            "from one end to the other and back"
        )
    if rising.all() or not rising.any():
        which = "up" if rising.all() else "down"
        messages.append(
            f"one direction only (sweeps {which}): hysteresis is not known; sweep up and down"
        )
    if math.isnan(quantities["repeatability"].value):
        messages.append(
            "one sweep of each direction: repeatability is not known; repeat the sweeps"
        )
    if quantities["hysteresis"].value > 0.05:
        messages.append(
            f"hysteresis is {100 * quantities['hysteresis'].value:.1f} % of full scale: drive the "
            "stage closed loop, or use the curve of the direction"
        )
    if resolution > 0.01 * scale:
        messages.append(f"the sensor resolves {100 * resolution / scale:.1f} % of full scale only")
    return messages


# ---- a log of voltage and displacement cut into sweeps on common voltages -----------------------

_TURN = 0.02
"""A turning point is a return by this share of the voltage range; less is noise."""

_WHOLE = 0.95
"""Share of the voltage range from which a sweep counts as whole."""

_NAMED = 4
"""Parts that a message names one by one."""

_LEVELS = 101
"""Voltages of the curves where the log has no levels of its own."""

_JUMP = 9.0
"""Times the usual step, about six standard deviations of noise: more is a jump to another level."""

_DRIFT = 0.1
"""Of all jumps: a log that moves by more of it between them is a ramp."""

_SAME = 1e-3
"""Voltages closer than this share of the range are one level."""


def samples(log: Recording, voltage: str, displacement: str) -> tuple[FloatArray, FloatArray, int]:
    """Return voltage and displacement where both were measured, and how many were not."""
    if not isinstance(log, Recording):
        raise DataError(f"pass a Recording, got {type(log).__name__}: sweeps need their order")
    names = [_channel(log, voltage, "V"), _channel(log, displacement, "m")]
    v, d = log[names[0]], log[names[1]]
    valid = ~(np.isnan(v) | np.isnan(d))
    if valid.sum() < 3:
        raise TooFewSamplesError(
            f"a calibration needs at least 3 samples of voltage and displacement, got "
            f"{int(valid.sum())} of {v.size}"
        )
    return v[valid], d[valid], int((~valid).sum())


def _channel(log: Recording, name: str, unit: str) -> str:
    if name not in log.channels:
        fitting = [n for n in log.channels if log.units.get(n) == unit]
        if len(fitting) == 1:
            return fitting[0]
    log[name]
    if log.units.get(name, unit) != unit:
        raise UnitError(f"channel {name!r} is in {log.units[name]!r}, it must be in {unit}")
    return name


def levels(v: FloatArray, d: FloatArray) -> tuple[FloatArray, FloatArray, int]:
    """Return one point for each dwell of a noisy voltage, and how many samples lie between dwells.

    A log is stairs where it jumps, stays for at least three samples and hardly drifts between the
    jumps; everything else is returned as it is.
    """
    steps = np.abs(np.diff(v))
    least = max(_JUMP * float(np.median(steps)), _SAME * float(np.ptp(v)))
    edges = np.concatenate([[0], np.flatnonzero(steps > least) + 1, [v.size]])
    sizes = np.diff(edges)
    usual = float(np.median(np.repeat(sizes, sizes)))  # of the stretch that a sample lies in
    parts = [slice(a, b) for a, b in itertools.pairwise(edges) if b - a >= max(2.0, 0.25 * usual)]
    if len(parts) < 3 or usual < 3.0:
        return v, d, 0
    halves = (np.array_split(v[p], [(p.stop - p.start) // 2]) for p in parts)
    drift = sum(abs(float(later.mean() - earlier.mean())) for earlier, later in halves)
    points = [(float(v[p].mean()), float(d[p].mean()), p.stop - p.start) for p in parts]
    if drift > _DRIFT * sum(abs(b[0] - a[0]) for a, b in itertools.pairwise(points)):
        return v, d, 0
    merged = points[:1]
    for level, place, size in points[1:]:
        before = merged[-1]
        if abs(level - before[0]) > least:
            merged.append((level, place, size))
            continue
        n = before[2] + size
        merged[-1] = (
            (before[0] * before[2] + level * size) / n, (before[1] * before[2] + place * size) / n, n
        )  # fmt: skip
    at, got, used = (np.array(column) for column in zip(*merged, strict=True))
    return at, got, int(v.size - used.sum())


Run = tuple[FloatArray, FloatArray]  # voltages and displacements of a sweep


@dataclass(frozen=True, slots=True)
class Sweeps:
    """Sweeps that are compared, each in the order of time, and what became of the others."""

    runs: list[Run]
    jumps: tuple[float, ...]
    left_out: int
    messages: tuple[str, ...]


def sweeps(v: FloatArray, d: FloatArray) -> Sweeps:
    """Return the sweeps of the whole range; halves of one are joined, other parts omitted.

    Where a direction has no whole sweep its longest parts stand in, and the range is theirs.
    """
    whole = (float(v.min()), float(v.max()))
    span = whole[1] - whole[0]
    parts = [(v[p], d[p]) for p in _between_turns(v)]
    runs: list[tuple[int, Run]] = []
    messages: list[str] = []
    jumps: list[float] = []
    lost: list[str] = []
    for rising, way in ((True, "up"), (False, "down")):
        own = [(i, p) for i, p in enumerate(parts) if (p[0][-1] > p[0][0]) == rising]
        used = [(i, p) for i, p in own if float(np.ptp(p[0])) >= _WHOLE * span]
        halves = own and own[0][0] == 0 and own[-1][0] == len(parts) - 1 and len(own) > 1
        taken = {i for i, _ in used}
        if not used and halves and _cover(own[-1][1], own[0][1], span):
            joined, jump = _joined(own[-1][1], own[0][1])
            used, taken = [(own[0][0], joined)], {own[0][0], own[-1][0]}
            jumps.append(jump)
            messages.append(
                f"the first and the last half of the sweep {way} are joined at "
                f"{own[0][1][0][0]:.4g} V, where they differ by {abs(jump) * 1e9:.3g} nm"
            )
        elif not used:
            used = [(i, p) for i, p in own if float(np.ptp(p[0])) > 0.5 * span]
            taken = {i for i, _ in used}
        lost += [f"{way} {p[0][0]:.4g} ... {p[0][-1]:.4g} V" for i, p in own if i not in taken]
        runs += used
    if not runs:
        raise DegenerateFitError("no sweep covers half of the voltage range; sweep it whole")
    if lost:
        messages.append(
            f"{len(lost)} part{'s' * (len(lost) > 1)} of a sweep omitted, the range is "
            f"{whole[0]:.4g} ... {whole[1]:.4g} V: {', '.join(lost[:_NAMED])}"
            + (" and more" if len(lost) > _NAMED else "")
        )
    runs.sort(key=lambda item: item[0])
    return Sweeps([r for _, r in runs], tuple(jumps), len(lost), tuple(messages))


def _between_turns(v: FloatArray) -> list[slice]:
    """Return the stretches between turning points; a turning point belongs to both."""
    threshold = _TURN * float(np.ptp(v))
    turns, direction = [0], 0
    extreme = 0
    low = high = 0
    for i in range(1, v.size):
        if direction == 0:
            low, high = (i if v[i] < v[low] else low), (i if v[i] > v[high] else high)
            if v[i] - v[low] > threshold:
                direction, extreme = 1, i
                if low:
                    turns.append(low)
            elif v[high] - v[i] > threshold:
                direction, extreme = -1, i
                if high:
                    turns.append(high)
        elif direction * (v[i] - v[extreme]) > 0.0:
            extreme = i
        elif direction * (v[extreme] - v[i]) > threshold:
            turns.append(extreme)
            direction, extreme = -direction, i
    turns.append(v.size - 1)
    return [slice(a, b + 1) for a, b in itertools.pairwise(turns) if b > a]


def _cover(last: Run, first: Run, span: float) -> bool:
    """Return whether the last part of a log goes on to where the first began, and all is swept."""
    both = np.concatenate([last[0], first[0]])
    way = 1.0 if first[0][-1] > first[0][0] else -1.0
    gap = way * float(first[0][0] - last[0][-1])
    return float(np.ptp(both)) >= _WHOLE * span and gap <= (1.0 - _WHOLE) * span


def _joined(last: Run, first: Run) -> tuple[Run, float]:
    """Return the two parts of a sweep as one, and by how much the first lies above the last."""
    way = 1.0 if first[0][-1] > first[0][0] else -1.0
    start = float(first[0][0])
    order = np.argsort(last[0], kind="stable")
    below = float(np.interp(start, last[0][order], last[1][order]))
    missing = way * (start - float(last[0][-1]))
    if missing > 0.0:
        slope = float(first[1][-1] - first[1][0]) / float(first[0][-1] - first[0][0])
        below += slope * way * missing
    before = way * (last[0] - start) < 0.0
    run = tuple(np.concatenate([a[before], b]) for a, b in zip(last, first, strict=True))
    return (run[0], run[1]), float(first[1][0]) - below


def on_common_voltages(runs: list[Run]) -> tuple[FloatArray, FloatArray]:
    """Return the voltages that all sweeps share and one curve for each sweep."""
    low = max(float(v.min()) for v, _ in runs)
    high = min(float(v.max()) for v, _ in runs)
    if not high > low:
        raise DegenerateFitError("the sweeps share no range of voltage")
    fewest = min(v.size for v, _ in runs)
    if fewest < 3:
        raise TooFewSamplesError(f"a sweep has {fewest} voltages; a curve needs at least 3")
    ordered = []
    for v, d in runs:  # by voltage, equal voltages averaged
        at, which = np.unique(v, return_inverse=True)
        ordered.append((at, np.asarray(np.bincount(which, weights=d) / np.bincount(which))))
    first = ordered[0][0]
    tolerance = _SAME * (high - low)
    shared = all(
        v.size == first.size and float(np.abs(v - first).max()) <= tolerance for v, _ in ordered
    )
    # a ramp of many samples is noise from one to the next: fewer voltages, each the mean around it
    if shared and first.size <= _LEVELS:
        grid = np.mean([v for v, _ in ordered], axis=0)
    else:
        grid = np.linspace(low, high, _LEVELS)
    return grid, np.array([_resampled(v, d, grid) for v, d in ordered])


def _resampled(v: FloatArray, d: FloatArray, grid: FloatArray) -> FloatArray:
    """Return a curve on the grid; of a fine ramp the local line through what lies around."""
    if v.size < 4 * grid.size:
        return _between(grid, v, d)
    half = 0.5 * float(grid[1] - grid[0])
    cells = [slice(*np.searchsorted(v, [g - half, g + half])) for g in grid]
    filled = [c for c in cells if c.stop > c.start]
    # voltages that crowd on a spot of a cell tell no slope: straight lines between their means
    means = (np.array([x[c].mean() for c in filled]) for x in (v, d))
    result = _between(grid, *means)
    for i, (g, near) in enumerate(zip(grid, cells, strict=True)):
        if near.stop - near.start >= 3 and float(v[near.stop - 1] - v[near.start]) > half:
            result[i] = np.polynomial.polynomial.polyfit(v[near] - g, d[near], 1)[0]
    return result


def _between(at: FloatArray, v: FloatArray, d: FloatArray) -> FloatArray:
    """Return a curve by straight lines; the first and the last one go on where a level is missed."""
    result = np.interp(at, v, d)
    for out, i, j in ((at < v[0], 0, 1), (at > v[-1], -1, -2)):
        if out.any() and v.size > 1:
            slope = float(d[i] - d[j]) / float(v[i] - v[j])
            result[out] = d[i] + slope * (at[out] - v[i])
    return np.asarray(result)


def branches(
    curves: FloatArray, rising: NDArray[np.bool_]
) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:
    """Return the mean up, down and of both, and the scatter between sweeps."""
    n = curves.shape[1]
    missing: FloatArray = np.full(n, np.nan)
    up = curves[rising].mean(axis=0) if rising.any() else missing
    down = curves[~rising].mean(axis=0) if not rising.all() else missing
    mean = 0.5 * (up + down)
    if rising.all() or not rising.any():
        mean = up if rising.all() else down
    squares, freedom = np.zeros(n), 0
    for own in (curves[rising], curves[~rising]):
        if len(own) > 1:
            squares += ((own - own.mean(axis=0)) ** 2).sum(axis=0)
            freedom += len(own) - 1
    return up, down, mean, np.sqrt(squares / freedom) if freedom else missing.copy()
