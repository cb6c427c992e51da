"""Hysteresis of a piezo stage: the Prandtl-Ishlinskii model, its exact inverse, and what other ways leave.

    play:  y_i = max(x_i - r, min(x_i + r, y_(i-1))),   displacement = offset + sum of w_j play_(r_j)(V)

with thresholds 0 = r_0 < r_1 < ..., weights w_0 > 0, w_j >= 0. The inverse is of the same kind:

    r'_i = sum_(j<=i) w_j (r_i - r_j),  w'_0 = 1 / w_0,  w'_i = -w_i / (W_i W_(i-1)),  W_i = w_0 + ... + w_i.

A loop that is not symmetric has a growing curve in front of the plays (of the voltage) or behind them (of
the displacement), a table of straight pieces; the inverse runs through it the other way.

A stage remembers its turning points: every question needs the voltages that it has seen. Replay them
(`history`), from a stage at rest that was never driven; a cycle over the full stroke wipes out what
was before. Turning points of a course must be samples. After Kuhnen, Eur. J. Control 9 (2003) 407.
Creep and rate are not in the model.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any, Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray

from metrosep.core import numbers
from metrosep.core._arrays import FloatArray, frozen_float, same_length
from metrosep.core.docs import described_by
from metrosep.core.errors import (
    DataError,
    DegenerateFitError,
    InvalidSamplesError,
    LimitError,
    TooFewSamplesError,
)
from metrosep.core.recording import Recording
from metrosep.core.units import format_ends, format_length
from metrosep.process._plain import Frozen, complete, frozen
from metrosep.process.flexure import FlexureCalibration, samples

_FINEST, _COARSEST = 40, 20
"""Thresholds over the range of the voltage."""
_TURN, _FULL = 0.02, 0.95
"""Of the range: a return by less is noise; a sweep of more is a full stroke."""
_BETTER = 0.9
"""Of what the plays alone leave of a log: a curve must leave less."""
_NODES, _FEW, _TRIES = 513, 600, 80
"""Points of a curve; samples and trials by which one in front of the plays is sought."""
_RATES, _MATTERS = 1.5, 3.0
"""Sweeps whose rates differ by that factor are compared; standard errors from which it is said."""


@dataclass(frozen=True, slots=True, eq=False)
class PrandtlIshlinskii:
    """A stage whose displacement is a sum of plays of its voltage.

    Parameters
    ----------
    thresholds : array_like, shape (n,), V
        From 0, strictly growing.
    weights : array_like, shape (n,), m/V
        The first above zero, the others not below.
    offset : float, m, optional
        Displacement of the stage that was never driven.
    front : array_like, shape (2, k), V, optional
        Growing voltages and what the plays get of them, growing from 0 at 0 V; straight between the points
        and beyond. The voltage itself if omitted.
    behind : array_like, shape (2, k), m, optional
        Growing sums of the plays and the displacements they make, likewise.

    Raises
    ------
    DataError
        If lengths differ, thresholds do not grow from 0, a weight cannot be used, or a curve does not grow.
    InvalidSamplesError
        If a value is NaN.

    Examples
    --------
    >>> um = 1e-6
    >>> stage = PrandtlIshlinskii([0.0, 0.6, 1.5, 3.0], np.array([1.5, 0.09, 0.05, 0.04]) * um)
    >>> (stage.displacement([0.0, 2.0, 1.0, -1.0, 3.0], history=()) / um).round(9).tolist()
    [0.0, 3.151, 1.651, -1.511, 4.791]
    """

    thresholds: FloatArray
    weights: FloatArray
    offset: float = 0.0
    front: FloatArray | None = None
    behind: FloatArray | None = None

    def __post_init__(self) -> None:
        for name in ("front", "behind"):
            if getattr(self, name) is not None:
                object.__setattr__(self, name, _checked_curve(getattr(self, name), name))
        r = complete(self.thresholds, "thresholds", "state every threshold")
        w = complete(self.weights, "weights", "state every weight")
        same_length(thresholds=r, weights=w)
        if r[0] != 0.0 or (np.diff(r) <= 0.0).any():
            raise DataError(f"thresholds must grow from 0 V, got {r.tolist()}")
        if w[0] <= 0.0 or (w < 0.0).any():
            raise DataError(
                "the first weight must be above zero and no other below: the displacement must grow "
                f"with the voltage, got {w.tolist()} m/V"
            )
        object.__setattr__(self, "thresholds", r)
        object.__setattr__(self, "weights", w)
        object.__setattr__(self, "offset", numbers.quantity(self.offset, "offset", "length"))

    def displacement(self, voltage: ArrayLike, *, history: ArrayLike) -> FloatArray:
        """Return the displacements that a course of voltages makes.

        Parameters
        ----------
        voltage : array_like, shape (n,), V
            In order of time; turning points must be samples.
        history : array_like, shape (m,), V
            What the stage has seen before, from never driven on; ``()`` for a stage never driven.

        Returns
        -------
        ndarray, shape (n,), m
            Exact at the samples.

        Raises
        ------
        InvalidSamplesError
            If a voltage is NaN.

        Examples
        --------
        >>> stage = PrandtlIshlinskii([0.0, 0.5], [1e-6, 1e-7])
        >>> (1e6 * stage.displacement([2.0], history=[0.0, 5.0, 0.0])).round(9).tolist()
        [2.15]
        """
        course = complete(
            np.atleast_1d(np.asarray(voltage)), "voltage", "a course cannot have gaps"
        )
        before = _history(history)
        made = self._sums(np.concatenate([before, course]))
        return frozen(_through(self.behind, self.offset + made[before.size :]))

    @described_by(displacement, errors=False)
    def voltage_for(self, displacement: ArrayLike, *, history: ArrayLike) -> FloatArray:
        """Return the voltages that make a course of displacements: the exact inverse.

        Parameters
        ----------
        displacement : array_like, shape (n,), m
            In order of time; turning points must be samples.

        Returns
        -------
        ndarray, shape (n,), V
            `displacement` of them gives the course back.

        Raises
        ------
        InvalidSamplesError
            If a displacement is NaN.

        Notes
        -----
        The history is replayed through the model, and its displacements through the inverse: without
        it the inverse stands in another state than the stage.
        """
        wanted = complete(displacement, "displacement", "a course cannot have gaps")
        before = _history(history)
        seen = self._sums(before) if before.size else before
        r, w = self._inverse()
        sums = _through(self.behind, wanted, back=True) - self.offset
        made = _plays(np.concatenate([seen, sums]), r, w)
        return frozen(_through(self.front, made[before.size :], back=True))

    def _sums(self, voltage: FloatArray) -> FloatArray:
        """Return the sums of the plays for a course of voltages, without the offset."""
        return _plays(_through(self.front, voltage), self.thresholds, self.weights)

    def _inverse(self) -> tuple[FloatArray, FloatArray]:
        """Return thresholds in m and weights in V/m of the inverse, equation (27)."""
        r, w = self.thresholds, self.weights
        total = np.cumsum(w)
        turned = np.array([float(w[: i + 1] @ (r[i] - r[: i + 1])) for i in range(r.size)])
        weights = np.concatenate([[1.0 / w[0]], -w[1:] / (total[1:] * total[:-1])])
        return turned, weights

    @classmethod
    def identify(
        cls,
        recording: Recording,
        *,
        voltage: str = "voltage",
        displacement: str = "displacement",
        spacing: float | None = None,
    ) -> HysteresisFit:
        """Return the model that explains a log of voltage and displacement.

        Parameters
        ----------
        recording : Recording
            From a stage that was never driven or just conditioned over its full stroke: a cycle over the
            full stroke, the full loop twice, and two nested minor loops.
        voltage, displacement : str, optional
            Names of the channels; the channel in V and the one in m if these do not exist.
        spacing : float, V, optional
            Between thresholds; a fortieth of the range if omitted.

        Returns
        -------
        HysteresisFit
            Model, residuals, also on the last minor loop, which is omitted from the fit.

        Raises
        ------
        DegenerateFitError
            If the voltage does not change, or the displacement does not follow it.
        TooFewSamplesError
            If there are fewer samples than thresholds.

        Notes
        -----
        Non-negative least squares on plays at fixed thresholds, plus a constant. Where a minor loop can be left
        out, a curve behind the plays and one in front of them are tried too (of third order, growing); the
        one is taken that leaves least of the log (RMS), if that is at most nine tenths of what the plays alone
        leave, and no more than that on the loop that is omitted. The first rise from
        rest is explained as one of a stage never driven; a log that starts elsewhere tells nothing of
        thresholds before the voltage first turns.
        """
        return _identified(recording, voltage, displacement, spacing)


@dataclass(frozen=True, slots=True, eq=False)
class HysteresisFit(Frozen):
    """A model of a stage, and how well it explains its log.

    Parameters
    ----------
    model : PrandtlIshlinskii
        Thresholds with a weight above zero, and the first.
    u_weights : ndarray, shape (n,), m/V
        Standard uncertainty of each weight, from the scatter of the fit.
    rms : float, m
        Of what the model leaves of the samples it was fitted to.
    worst_left_out : float, m
        Largest residual on the minor loop that was omitted; NaN where there was none.
    curve : {"none", "front", "behind"}
        Which curve the model has: none, of the voltage, or of the displacement.
    messages : tuple of str
        What to know.
    """

    model: PrandtlIshlinskii
    u_weights: FloatArray
    rms: float
    worst_left_out: float
    curve: Literal["none", "front", "behind"] = "none"
    messages: tuple[str, ...] = ()


@dataclass(frozen=True, slots=True, eq=False)
class DriveResiduals(Frozen):
    """What each way to choose the voltages leaves on a course of displacements.

    Parameters
    ----------
    voltage : mapping of str to ndarray, V
        By "mean curve", "branches" and "prandtl-ishlinskii".
    residual : mapping of str to ndarray, m
        Reached minus wanted.
    messages : tuple of str
        What to know.
    """

    voltage: Mapping[str, FloatArray]
    residual: Mapping[str, FloatArray]
    messages: tuple[str, ...] = field(default=())

    def largest(self, way: str) -> float:
        """Return the largest residual of a way.

        Parameters
        ----------
        way : str
            Its name.

        Returns
        -------
        float, m
            Absolute value.

        Raises
        ------
        DataError
            If the name is none.
        """
        return float(np.abs(self.residual[numbers.choice(way, "way", tuple(self.residual))]).max())


@described_by(PrandtlIshlinskii.displacement, errors=False)
def compare_drives(
    displacement: ArrayLike,
    stage: PrandtlIshlinskii,
    calibration: FlexureCalibration,
    *,
    history: ArrayLike,
) -> DriveResiduals:
    """Return what the mean curve, the branches and the inverse leave on the strokes to be driven.

    Parameters
    ----------
    displacement : array_like, shape (n,), m
        Wanted, in order of time; turning points must be samples.
    stage : PrandtlIshlinskii
        The stage, as identified.
    calibration : FlexureCalibration
        Its curves over the full stroke, up and down.

    Returns
    -------
    DriveResiduals
        Voltages and residuals of the three ways.

    Raises
    ------
    LimitError
        If a displacement is beyond the curves.
    DataError
        If a direction was not run.

    Notes
    -----
    Branches serve full strokes: after a partial one they may be worse than the mean curve, and a message
    says so.
    """
    wanted = complete(displacement, "displacement", "a course cannot have gaps")
    before = _history(history)
    mean = calibration.voltage_for(_within(wanted, calibration.mean))
    last = (
        float(stage.displacement(before[-1:], history=before[:-1])[0])
        if before.size
        else stage.offset
    )
    rises = np.diff(wanted, prepend=last) >= 0.0
    up, down = (
        calibration.voltage_for(_within(wanted, getattr(calibration, way)), direction=way)
        for way in ("up", "down")
    )
    ways = {
        "mean curve": mean,
        "branches": np.where(rises, up, down),
        "prandtl-ishlinskii": stage.voltage_for(wanted, history=before),
    }
    left = {n: stage.displacement(v, history=before) - wanted for n, v in ways.items()}
    one, other = (float(np.abs(left[n]).max()) for n in ("mean curve", "branches"))
    said = []
    if other > one:
        said.append(
            f"branches leave {format_length(other)}, the mean curve {format_length(one)}: branches serve "
            "full strokes, and this course turns before their ends"
        )
    return DriveResiduals(
        {n: frozen(v) for n, v in ways.items()},
        {n: frozen(v) for n, v in left.items()},
        tuple(said),
    )


def _within(wanted: FloatArray, curve: FloatArray) -> FloatArray:
    """Return displacements clipped to a branch by the width of the loop at most."""
    low, high = float(curve.min()), float(curve.max())
    slack = 0.1 * (high - low)
    if float(wanted.min()) < low - slack or float(wanted.max()) > high + slack:
        raise LimitError(
            f"displacements from {format_ends(float(wanted.min()), float(wanted.max()), between=' to ')} "
            f"leave the calibrated stroke {format_ends(low, high, between=' to ')}"
        )
    return np.clip(wanted, low, high)


def _history(history: ArrayLike) -> FloatArray:
    given = np.atleast_1d(np.asarray(history))
    if not given.size:
        return np.empty(0)
    before = frozen_float(given, name="history", ndim=1)
    if np.isnan(before).any():
        raise InvalidSamplesError("history holds NaN: state what the stage has seen")
    return before


def _plays(x: FloatArray, thresholds: FloatArray, weights: FloatArray) -> FloatArray:
    """Return the weighted sum of plays of a course, from rest at 0."""
    return np.asarray(_each_play(x, thresholds) @ weights)


def _each_play(x: FloatArray, thresholds: FloatArray) -> FloatArray:
    """Return every play of a course, shape (n, thresholds)."""
    made = np.empty((x.size, thresholds.size))
    y = np.zeros(thresholds.size)
    low, high = x[:, None] - thresholds, x[:, None] + thresholds
    for i in range(x.size):
        y = np.maximum(low[i], np.minimum(high[i], y))
        made[i] = y
    return made


def _identified(
    recording: Recording, voltage: str, displacement: str, spacing: float | None
) -> HysteresisFit:
    v, d, lost = samples(recording, voltage, displacement)
    extent = float(np.ptp(v))
    if not extent > 0.0:
        raise DegenerateFitError(f"the voltage stays at {v[0]:.6g} V; sweep it up and down")
    step = extent / _FINEST if spacing is None else numbers.positive(spacing, "spacing")
    thresholds = np.arange(0.0, 0.5 * extent + 0.5 * step, step)
    if v.size < 3 * thresholds.size:
        raise TooFewSamplesError(
            f"{v.size} samples for {thresholds.size} thresholds: log more of them, or take a wider spacing"
        )
    turns = _turning_points(v, _TURN * extent)
    fitted, partial = _left_out(v, turns, extent)
    left_out = ~fitted
    tried = {"none": _fitted(v, d, thresholds, fitted)}
    if not tried["none"].weights[0] > 0.0:
        raise DegenerateFitError(
            "the displacement does not grow with the voltage: name the channels, and look at the sign"
        )
    if left_out.any():
        tried["behind"] = _fitted(v, d, thresholds, fitted, behind=True)
        front = _found_front(v, d, thresholds, fitted, turns)
        tried["front"] = _fitted(v, d, thresholds, fitted, front=front)
    left = {n: _rms((f.made - d)[left_out]) for n, f in tried.items()} if len(tried) > 1 else {}
    whole = {n: _rms(f.made - d) for n, f in tried.items() if f.is_usable}
    curve = min(whole, key=lambda n: whole[n])
    if curve != "none" and (whole[curve] > _BETTER * whole["none"] or left[curve] > left["none"]):
        curve = "none"
    own = tried[curve]
    rest = d - own.made
    weights, rms = own.weights, _rms(rest[fitted])
    used = np.flatnonzero((weights > 0.0) | (thresholds == 0.0))
    basis = np.column_stack([own.plays[fitted][:, used], np.ones(int(fitted.sum()))])
    freedom = max(1, int(fitted.sum()) - basis.shape[1])
    spread = math.sqrt(float((rest[fitted] ** 2).sum()) / freedom)
    cov = np.linalg.pinv(basis.T @ basis)
    u = spread * np.sqrt(np.diag(cov))[:-1]
    said = []
    if curve != "none":
        of = (
            "voltage, in front of the plays"
            if curve == "front"
            else "displacement, behind the plays"
        )
        said.append(
            f"the loops are not symmetric: with a curve of the {of}, {format_length(whole[curve])} RMS is left "
            f"of the log, without it {format_length(whole['none'])}; on the loop that was not used "
            f"{format_length(left[curve])} and {format_length(left['none'])}"
        )
    if not partial:
        said.append(
            "the log holds full strokes only: nothing tells how the stage answers smaller ones; add two nested "
            "minor loops"
        )
    if step > extent / _COARSEST * (1.0 + 1e-9):
        said.append(f"thresholds {step:.3g} V apart are coarse for a range of {extent:.3g} V")
    if lost:
        said.append(f"{lost} samples without a value were omitted")
    said += _rates(recording, v, rest, turns, extent)
    worst = float(np.abs(rest[left_out]).max()) if left_out.any() else math.nan
    model = PrandtlIshlinskii(thresholds[used], weights[used], own.offset, own.front, own.behind)
    return HysteresisFit(model, frozen(u), rms, worst, curve, tuple(said))  # type: ignore[arg-type]


def _rms(values: FloatArray) -> float:
    return float(np.sqrt(np.mean(values**2)))


@dataclass(frozen=True, slots=True, eq=False)
class _Fitted:
    """Plays with weights, an offset and a curve, and what they make of the voltages of a log."""

    weights: FloatArray
    offset: float
    plays: FloatArray
    made: FloatArray  # m
    front: FloatArray | None = None
    behind: FloatArray | None = None
    is_usable: bool = True  # whether its curve grows


def _fitted(
    v: FloatArray,
    d: FloatArray,
    thresholds: FloatArray,
    fitted: NDArray[np.bool_],
    *,
    front: FloatArray | None = None,
    behind: bool = False,
) -> _Fitted:
    """Return the plays that explain displacements, with a curve in front that is given, or one behind."""
    from scipy.optimize import nnls

    plays = _each_play(_through(front, v), thresholds)
    scale = float(np.abs(d).max()) or 1.0
    free = [np.ones(v.size)]
    low, high = float(d.min()), float(d.max())
    if behind:
        # sums of the plays = d + a b1(d) + b b2(d): linear in the coefficients, of either sign
        free += [-b for b in _bends(d, low, high)]
    extra = np.column_stack([*free, *(-c for c in free)])
    columns = np.column_stack([plays, extra])
    found, _ = nnls(columns[fitted], d[fitted] / scale)
    weights = scale * found[: thresholds.size]
    both = scale * found[thresholds.size :]
    signed = both[: len(free)] - both[len(free) :]
    offset, sums = float(signed[0]), plays @ weights + float(signed[0])
    if not behind:
        return _Fitted(weights, offset, plays, sums, front, None)
    at = np.linspace(low, high, _NODES)
    curve = np.stack(
        [at + sum(c * b for c, b in zip(signed[1:], _bends(at, low, high), strict=True)), at]
    )
    grows = bool((np.diff(curve[0]) > 0.0).all())
    made = _through(curve, sums) if grows else sums
    return _Fitted(weights, offset, plays, made, None, curve, grows)


def _bends(x: FloatArray, low: float, high: float) -> list[FloatArray]:
    """Return two curves that vanish at both ends of a range: of second and of third order."""
    s = (x - low) / (high - low)
    return [s * (1.0 - s), s * (1.0 - s) * (1.0 - 2.0 * s)]


def _found_front(
    v: FloatArray,
    d: FloatArray,
    thresholds: FloatArray,
    fitted: NDArray[np.bool_],
    turns: list[int],
) -> FloatArray:
    """Return the curve in front of the plays that leaves least of the samples that are fitted."""
    from scipy.optimize import minimize

    low, high = float(v.min()), float(v.max())
    at = np.linspace(low, high, _NODES)
    # plays are exact at samples, and the turns are among them: fewer samples do
    few = np.unique(np.append(np.arange(0, v.size, max(1, v.size // _FEW)), turns))
    zero = float(np.clip(0.0, low, high))

    def curve(c: FloatArray) -> FloatArray:
        def bent(x: FloatArray) -> FloatArray:
            ends = _bends(np.clip(x, low, high), low, high)
            return np.asarray(x + (high - low) * (c[0] * ends[0] + c[1] * ends[1]))

        return np.stack([at, bent(at) - (bent(np.array([zero]))[0] - zero)])

    def left(c: FloatArray) -> float:
        made = curve(c)
        if not (np.diff(made[1]) > 0.0).all():
            return math.inf
        own = _fitted(v[few], d[few], thresholds, fitted[few], front=made)
        return _rms((own.made - d[few])[fitted[few]])

    options: Any = {"maxfev": _TRIES, "initial_simplex": [[0.0, 0.0], [0.1, 0.0], [0.0, 0.1]]}
    return curve(minimize(left, np.zeros(2), method="Nelder-Mead", options=options).x)


def _checked_curve(values: ArrayLike, name: str) -> FloatArray:
    """Return a curve of two growing rows, or refuse it."""
    curve = frozen_float(values, name=name, ndim=2)
    if curve.shape[0] != 2 or curve.shape[1] < 2 or not (np.diff(curve, axis=1) > 0.0).all():
        raise DataError(
            f"{name} must have two rows that grow from point to point, got the shape {curve.shape}"
        )
    return curve


def _through(curve: FloatArray | None, x: FloatArray, *, back: bool = False) -> FloatArray:
    """Return what a curve makes of values, straight beyond its ends; or what made them."""
    if curve is None:
        return x
    a, b = (curve[1], curve[0]) if back else (curve[0], curve[1])
    found = np.interp(x, a, b)
    for end, inner in ((0, 1), (-1, -2)):
        beyond = x < a[0] if end == 0 else x > a[-1]
        slope = (b[inner] - b[end]) / (a[inner] - a[end])
        found = np.where(beyond, b[end] + (x - a[end]) * slope, found)
    return np.asarray(found)


def _turning_points(v: FloatArray, band: float) -> list[int]:
    """Return the first sample, those where the voltage turns by more than a band, and the last."""
    found, way, best = [0], 0, 0
    for i in range(1, v.size):
        if way == 0:
            if abs(v[i] - v[0]) > band:
                way, best = (1 if v[i] > v[0] else -1), i
        elif way * (v[i] - v[best]) >= 0.0:
            best = i
        elif way * (v[best] - v[i]) > band:
            found.append(best)
            way, best = -way, i
    return [*found, v.size - 1]


def _left_out(v: FloatArray, turns: list[int], extent: float) -> tuple[NDArray[np.bool_], bool]:
    """Return which samples are fitted: all but the last minor loop; and whether there is any."""
    fitted = np.ones(v.size, dtype=bool)
    partial = [
        k
        for k in range(len(turns) - 1)
        if abs(float(v[turns[k + 1]] - v[turns[k]])) < _FULL * extent
    ]
    if len(partial) < 3:
        return fitted, bool(partial)
    loop = partial[-2:]
    fitted[turns[loop[0]] + 1 : turns[loop[-1] + 1] + 1] = False
    return fitted, True


def _rates(
    recording: Recording, v: FloatArray, rest: FloatArray, turns: list[int], extent: float
) -> list[str]:
    """Return what is said of full sweeps that were run at different rates."""
    t = recording.t
    if t.size != v.size:
        return []
    rows = []
    for a, b in itertools.pairwise(turns):
        if abs(float(v[b] - v[a])) >= _FULL * extent and b - a > 4:
            sign = math.copysign(1.0, float(v[b] - v[a]))
            own = sign * rest[a : b + 1]
            rows.append(
                (
                    abs(float(v[b] - v[a])) / float(t[b] - t[a]),
                    float(own.mean()),
                    float(own.std()) / math.sqrt(b - a),
                )
            )
    if len(rows) < 4:
        return []
    slow, fast = min(r[0] for r in rows), max(r[0] for r in rows)
    if fast < _RATES * slow:
        return []
    middle = math.sqrt(slow * fast)
    groups = [[r for r in rows if (r[0] > middle) is way] for way in (False, True)]
    means = [np.mean([r[1] for r in g]) for g in groups]
    error = math.hypot(*(float(np.sqrt(np.sum([r[2] ** 2 for r in g]))) / len(g) for g in groups))
    off = abs(float(means[1] - means[0]))
    if off <= _MATTERS * error:
        return []
    return [
        (
            f"rate matters: sweeps at {slow:.3g} and {fast:.3g} V/s lag by {format_length(off)} more or less; "
            "identify at the rate of use"
        )
    ]
