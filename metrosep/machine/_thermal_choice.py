"""Private: which thermometers, behind which lags, foretell a reading, and the fit of those.

A choice is judged by blocks of time that are left out and foretold from the others.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from metrosep.core import numbers
from metrosep.core._arrays import FloatArray, frozen_float
from metrosep.core.errors import DataError, InvalidSamplesError, TooFewSamplesError, UnitError
from metrosep.machine._drift_noise import Fit, Gls, Stream, inverse_times

BLOCKS = 6
_FEWEST_BLOCKS = 3
_RATIO = math.sqrt(2.0)  # from one time constant that is tried to the next
_LONGEST = 0.5  # of the record: a longer lag is not told from a drift
_ALIKE = 1e-6  # determinant of correlations below which no reading tells inputs apart
_ROUNDING = 1e-14  # of the sum of squares, of which what is left is a small difference
_WINDOW, _STANDS_OUT = (
    7,
    10.0,
)  # samples; by how many times the noise, and the spread about it, a spike does
_TURNS = 3  # of drift and lags in turn: the third moves a lag by less than a tenth of its u
_UNSETTLED = 4.0  # standard deviations of what the first minutes hold of an earlier history


def lagged(t: FloatArray, temperature: FloatArray, lag: float) -> FloatArray:
    """Return x of ``lag x' = T - x``, settled at the start, exact for parabolas between the samples.

    The parabola of an interval passes its two ends and the next sample on the side where it bends less,
    so that none reaches over a switching of the power, where T has a corner.
    """
    if lag == 0.0:
        return temperature
    h = np.diff(t)
    slope = np.diff(temperature) / h
    bend = np.zeros_like(slope)
    if h.size > 1:
        inner = np.diff(slope) / (h[1:] + h[:-1])
        before, after = np.append(inner[0], inner), np.append(inner, inner[-1])
        bend = np.where(np.abs(before) < np.abs(after), before, after)
    decay = np.exp(-h / lag)
    # T = T0 + m s + c s (s - h): x - (A + B s + c s^2) dies away with the lag
    B = slope - bend * (h + 2.0 * lag)
    A = temperature[:-1] - lag * B
    added = A * (1.0 - decay) + (B + bend * h) * h
    x = [float(temperature[0])]
    for factor, more in zip(decay.tolist(), added.tolist(), strict=True):
        x.append(x[-1] * factor + more)
    return np.array(x)


def _smoothed(t: FloatArray, values: FloatArray) -> FloatArray:
    """Return the smoothest history within the noise of a sensor: RMS change is that noise.

    Least ``sum (z - T)^2 + w sum (D2 z)^2``, the largest w that allows it (Whittaker; Morozov's rule).
    Where drift makes the fit look at changes only, noise from sample to sample would hide the gain.
    """
    from scipy.linalg import solveh_banded

    noise = noise_of(values)
    if noise <= _ROUNDING * float(np.abs(values).max()) or values.size < 5:
        return values
    h = np.diff(t) / float(np.median(np.diff(t)))
    left, right = 1.0 / h[:-1], 1.0 / h[1:]
    rows = np.stack([left, -left - right, right])  # of the second difference, three samples each
    band = np.zeros((3, values.size))
    for i in range(3):
        for j in range(i, 3):
            at = slice(i, values.size - 2 + i)
            band[j - i, at] += rows[i] * rows[j]
    rest = values - values.mean()

    def smooth(log: float) -> FloatArray:
        whole = math.exp(log) * band
        whole[0] += 1.0
        return np.asarray(solveh_banded(whole, rest, lower=True))

    low, high = -10.0, 25.0  # of the logarithm of w: nothing smoothed, and a straight line
    for _ in range(25):
        middle = 0.5 * (low + high)
        near = float(np.sqrt(np.mean((smooth(middle) - rest) ** 2))) <= noise
        low, high = (middle, high) if near else (low, middle)
    return np.asarray(smooth(low) + values.mean())


def by_log_lag(t: FloatArray, temperature: FloatArray, lag: float) -> FloatArray:
    """Return the derivative of `lagged` by the natural logarithm of the lag: central difference."""
    if lag == 0.0:
        return np.zeros_like(temperature)
    step = 1e-3  # of the lag; the third derivative leaves 1e-6 of the change
    up, down = (lagged(t, temperature, lag * math.exp(s)) for s in (step, -step))
    return np.asarray((up - down) / (2.0 * step))


_COLDEST, _HOTTEST = 200.0, 600.0  # K, of any machine: outside it is another unit


def kelvins(values: Any, name: str) -> FloatArray:
    """Return temperatures in K, NaN kept; a text is a temperature with its unit."""
    if isinstance(values, str):
        values = numbers.quantity(values, f"temperature of {name}", "temperature")
    found = np.array(values, dtype=np.float64)
    known = found[np.isfinite(found)]
    if known.size and not (known.min() > _COLDEST and known.max() < _HOTTEST):
        odd = float(known.min() if known.min() <= _COLDEST else known.max())
        raise UnitError(
            f"temperature of {name} is {odd:.6g} K; temperatures are in K (20 degC are 293.15), or one text "
            'with its unit, "20 degC"'
        )
    return found


def celsius(kelvin: float) -> str:
    """Return a temperature as a person reads it."""
    return f"{kelvin - 273.15:.2f} degC"


def times_of(t: ArrayLike) -> FloatArray:
    times = frozen_float(t, name="the time", ndim=1, min_size=2)
    lost = np.flatnonzero(~np.isfinite(times))
    if lost.size:
        raise InvalidSamplesError(
            f"the time is missing (NaN) at reading {lost[0] + 1}; leave that row out"
        )
    falls = np.flatnonzero(np.diff(times) <= 0.0)
    if falls.size:
        i = int(falls[0])
        raise InvalidSamplesError(
            f"the time must rise from reading to reading: it goes from {times[i]:.6g} s to {times[i + 1]:.6g} s "
            f"at reading {i + 2}, and does not rise at {falls.size} places; sort the rows by time, or give "
            "records that begin anew one by one"
        )
    return times


class Record:
    """Times, temperatures without gaps, readings, and the block of each row."""

    def __init__(
        self,
        t: ArrayLike,
        temperatures: Mapping[str, ArrayLike],
        readings: Mapping[str, ArrayLike],
        blocks: int,
    ) -> None:
        self.t = times_of(t)
        self.messages: list[str] = []
        if not temperatures:
            raise DataError("no temperature is given")
        if not readings:
            raise DataError("no reading is given")
        n = self.t.size
        given = {
            k: _column(kelvins(v, k), f"temperature {k!r}", n) for k, v in temperatures.items()
        }
        self.readings = {k: _column(v, f"reading {k!r}", n) for k, v in readings.items()}
        for kind in (given, self.readings):
            for name, values in kind.items():
                spikes = _spikes(values)
                if spikes.any():
                    kind[name] = np.where(spikes, np.nan, values)
                    n_out = int(spikes.sum())
                    words = "1 value stands" if n_out == 1 else f"{n_out} values stand"
                    self.messages.append(f"{name}: {words} out of the neighbours; omitted")
        self.known = np.ones(n, dtype=bool)
        self.temperatures = {k: self._without_gaps(k, v) for k, v in given.items()}
        numbers.count(blocks, "blocks", least=_FEWEST_BLOCKS)
        share = (self.t - self.t[0]) / (self.t[-1] - self.t[0])
        self.block = np.minimum((share * blocks).astype(int), blocks - 1)
        self.blocks = blocks

    def _without_gaps(self, name: str, values: FloatArray) -> FloatArray:
        known = np.flatnonzero(np.isfinite(values))
        if known.size < 2:
            raise InvalidSamplesError(f"temperature {name!r} has fewer than two known values")
        self.known[: known[0]] = self.known[known[-1] + 1 :] = False
        if known[0] > 0:
            self.messages.append(
                f"{name} begins {self.t[known[0]] - self.t[0]:.0f} s late; what was read before is not used"
            )
        if known.size < known[-1] - known[0] + 1:
            longest = float(np.diff(self.t[known]).max())
            self.messages.append(
                f"{name} lacks {known[-1] - known[0] + 1 - known.size} readings; straight lines stand "
                f"between its neighbours, over {longest:.0f} s at most"
            )
        return np.interp(self.t, self.t[known], values[known])

    def lags_to_try(self, lags: Sequence[float] | None) -> tuple[float, ...]:
        if lags is not None:
            return tuple(
                sorted({0.0, *(numbers.not_negative(v, "lag", dimension="time") for v in lags)})
            )
        least = 2.0 * float(np.median(np.diff(self.t)))
        most = _LONGEST * float(np.ptp(self.t))
        n = max(math.floor(math.log(most / least) / math.log(_RATIO)), 0) if most > least else 0
        return (0.0, *(least * _RATIO**k for k in range(n + 1)))


def _spikes(values: FloatArray) -> NDArray[np.bool_]:
    """Return which values, one or two in a row, stand far out of the six about them; heat does not."""
    known = np.flatnonzero(np.isfinite(values))
    found = np.zeros(values.size, dtype=bool)
    if known.size < 2 * _WINDOW:
        return found
    own = values[known]
    half = _WINDOW // 2
    about = np.lib.stride_tricks.sliding_window_view(np.pad(own, half, mode="reflect"), _WINDOW)
    others = np.sort(np.delete(about, half, axis=1), axis=1)[:, 1:-1]
    out = np.maximum(others[:, 0] - own, own - others[:, -1])
    second = np.abs(np.diff(own, 2))
    noise = 1.4826 * float(np.median(second)) / math.sqrt(6.0)
    steps = np.abs(np.diff(own))
    finest = float(steps[steps > 0.0].min(initial=np.inf))  # the last digit of a display
    least = max(noise, min(finest, float(np.ptp(own))))
    found[known] = out > _STANDS_OUT * least + _STANDS_OUT * np.ptp(others, axis=1)
    return found


def _column(values: ArrayLike, name: str, n: int) -> FloatArray:
    found = frozen_float(values, name=name, ndim=1)
    if found.size != n:
        raise InvalidSamplesError(f"{name} has {found.size} values, t has {n}")
    if np.isinf(found).any():
        raise InvalidSamplesError(f"{name} is infinite; write NaN where nothing was measured")
    return found


_ALIKE = 1e-3
"""Of the changes of a sensor: two that differ by less are one, since no gain is known to a thousandth."""


class Inputs:
    """Columns of all sensors behind lags, made when they are asked for."""

    def __init__(self, record: Record, lags: Sequence[float]) -> None:
        self.record, self.lags = record, tuple(lags)
        self._made: dict[tuple[str, float], FloatArray] = {}
        still = [n for n, v in record.temperatures.items() if np.ptp(v[record.known]) <= 0.0]
        record.messages += [f"{name} did not change and takes no part" for name in still]
        self.sensors = self._told_apart([n for n in record.temperatures if n not in still])
        self.smooth = {n: _smoothed(record.t, record.temperatures[n]) for n in self.sensors}
        if not self.sensors:
            raise DataError("no temperature changed: nothing can be learnt of what it does")

    def _told_apart(self, names: Sequence[str]) -> list[str]:
        """Return sensors without those that change as an earlier one does, which are named."""
        found: list[str] = []
        for name in names:
            mine = self.record.temperatures[name][self.record.known]
            for first in found:
                other = self.record.temperatures[first][self.record.known]
                if np.std(mine - other) <= _ALIKE * np.std(other):
                    self.record.messages.append(
                        f"{name} changes as {first} does and takes no part: the gain of {first} may be that of either; "
                        "check the wiring and the columns"
                    )
                    break
            else:
                found.append(name)
        return found

    def __getitem__(self, key: tuple[str, float]) -> FloatArray:
        if key not in self._made:
            sensor, lag = key
            self._made[key] = lagged(self.record.t, self.smooth[sensor], lag)
        return self._made[key]


@dataclass(frozen=True, slots=True, eq=False)
class Settled:
    """What was found of one reading."""

    sensors: tuple[str, ...]
    lags: tuple[float, ...]
    gains: FloatArray
    covariance: FloatArray
    left: float
    predicted: float
    residual: FloatArray
    messages: tuple[str, ...]


class Reading:
    """The choice of sensors and lags of one reading, and its fit."""

    def __init__(self, record: Record, inputs: Inputs, name: str, most: int) -> None:
        self.record, self.inputs, self.name = record, inputs, name
        y = record.readings[name]
        self.used = np.isfinite(y) & record.known
        counts = np.bincount(record.block[self.used], minlength=record.blocks)
        if int(counts.min()) < most + 2:
            raise TooFewSamplesError(
                f"{name}: block {int(np.argmin(counts)) + 1} of {record.blocks} holds {int(counts.min())} "
                f"readings, {most + 2} are needed; take fewer blocks or a longer record"
            )
        self.y = y[self.used] - float(y[self.used].mean())
        self.n = counts
        self.starts = np.concatenate([[0], np.cumsum(counts)[:-1]])
        self.chosen, self.scores = self._chosen(most)

    def _errors(self, keys: Sequence[tuple[str, float]]) -> FloatArray:
        """Return the sum of squares that is left of each block, foretold from the others."""
        columns = [self.inputs[k][self.used] for k in keys]
        scaled = [(c - c.mean()) / max(float(np.std(c)), 1e-300) for c in columns]
        Z = np.column_stack([np.ones(self.y.size), *scaled, self.y])
        products = np.add.reduceat(Z[:, :, None] * Z[:, None, :], self.starts)
        G, g, yy = products[:, :-1, :-1], products[:, :-1, -1], products[:, -1, -1]
        rest = G.sum(axis=0) - G
        size = np.sqrt(np.einsum("bii->bi", rest))
        unit = rest / size[:, :, None] / size[:, None, :]
        if keys and np.abs(np.linalg.det(unit)).min() < _ALIKE:
            return np.full(yy.size, np.inf)
        beta = np.linalg.solve(rest, (g.sum(axis=0) - g)[..., None])[..., 0]
        left = yy - 2.0 * np.einsum("bi,bi->b", beta, g)
        left += np.einsum("bi,bij,bj->b", beta, G, beta)
        return np.asarray(np.maximum(left, _ROUNDING * yy.sum()))

    def _score(self, keys: Sequence[tuple[str, float]]) -> float:
        return float(self._errors(keys).sum())

    def _chosen(self, most: int) -> tuple[list[tuple[str, float]], tuple[float, ...]]:
        """Return sensors with their lags, and the RMS of what is foretold with 0, 1, 2 ... of them."""
        best: list[list[tuple[str, float]]] = [[]]
        for _ in range(min(most, len(self.inputs.sensors))):
            taken = [k[0] for k in best[-1]]
            trials = [
                [*best[-1], (sensor, lag)]
                for sensor in self.inputs.sensors
                if sensor not in taken
                for lag in self.inputs.lags
            ]
            pick = min(trials, key=self._score)
            for _ in range(2):  # the lags of all sensors again, now that one more takes part
                for i in range(len(pick)):
                    pick = self._with_best_lag(pick, i)
            best.append(pick)
        errors = [self._errors(k) for k in best]
        total = [float(e.sum()) for e in errors]
        scores = tuple(math.sqrt(v / float(self.n.sum())) for v in total)
        least = int(np.argmin(total))
        for k, e in enumerate(errors[: least + 1]):
            difference = e - errors[least]
            spread = math.sqrt(float(np.var(difference, ddof=1)) * difference.size)
            if float(difference.sum()) <= spread:
                return best[k], scores
        return best[least], scores

    def _with_best_lag(self, pick: list[tuple[str, float]], i: int) -> list[tuple[str, float]]:
        """Return the choice with the lag of one sensor that foretells best, between those to try too."""
        from scipy.optimize import minimize_scalar

        sensor = pick[i][0]

        def with_lag(lag: float) -> list[tuple[str, float]]:
            return [*pick[:i], (sensor, lag), *pick[i + 1 :]]

        grid = min((with_lag(lag) for lag in self.inputs.lags), key=self._score)
        lag = grid[i][1]
        if lag == 0.0:
            return grid
        reach = math.log(_RATIO)
        found = minimize_scalar(
            lambda v: self._score(with_lag(math.exp(v))) / max(self._score(grid), 1e-300),
            bounds=(math.log(lag) - reach, math.log(lag) + reach),
            method="bounded",
            options={"xatol": 1e-3},
        )
        polished = with_lag(math.exp(float(found.x)))
        return polished if self._score(polished) < self._score(grid) else grid

    def settled(self) -> Settled:
        """Return the fit of the chosen sensors with refined lags; those that show nothing are omitted."""
        keys, messages = list(self.chosen), []
        trials = max(len(self.inputs.sensors) * len(self.inputs.lags), 1)
        while True:
            model = self._fitted(keys)
            z = model.significance()
            if not z.size or float(z.min()) >= _surprise(trials):
                break
            i = int(np.argmin(z))
            messages.append(
                f"{keys[i][0]} takes no part: its gain is {z[i]:.2g} u, and of {trials} trials (sensors "
                f"times time constants) one reaches {_surprise(trials):.2g} u by chance in 20 records"
            )
            keys.pop(i)
        record, fit = self.record, model.fit
        cov, s = model.covariance(), float(fit.scales[0])
        ratio, predicted = self._foretold(model)
        if not keys:
            messages.append("no temperature foretells it better than its mean does")
        if ratio > 1.0:
            cov, s = cov * ratio, s * math.sqrt(ratio)
            messages.append(
                "left-out blocks are foretold worse than u said, which is raised by "
                f"{100.0 * (math.sqrt(ratio) - 1.0):.2g} %"
            )
        if model.turned and self._unsettled(model):
            messages.append(
                "the beginning holds an earlier history: the machine had not settled; begin the record "
                "after a rest, or leave its first hours out"
            )
        if not fit.judged:
            messages.append("too few readings to judge drift: u is that of independent readings")
        k = len(keys)
        kept = slice(1, 1 + k + len(model.turned))
        residual = np.full(record.t.size, np.nan)
        residual[self.used] = self.y - model.X @ model.beta
        return Settled(
            tuple(key[0] for key in keys),
            tuple(model.lags.tolist()),
            model.beta[1:],
            cov[kept, kept],
            s * fit.a,
            predicted,
            residual,
            tuple(messages),
        )

    def _fitted(self, keys: Sequence[tuple[str, float]]) -> _Model:
        """Return the model of these sensors: drift, lags and gains in turn, until they agree."""
        record = self.record
        sensors = tuple(k[0] for k in keys)
        lags = np.array([k[1] for k in keys])
        index = (record.t - record.t[0]) / float(np.median(np.diff(record.t)))
        stream = Stream(np.arange(self.y.size), index[self.used], 0)
        X = self._design(sensors, lags)
        fit = Gls(X, self.y, [stream], [None]).best()
        model = _Model(self.y, X, np.zeros((self.y.size, 0)), np.zeros((self.y.size, 0)), (), lags, fit, fit.beta, stream)  # fmt: skip
        for _ in range(_TURNS if np.any(lags > 0.0) else 1):
            if np.any(lags > 0.0):
                lags = self._refined(sensors, lags, model)
            model = self._around(sensors, lags, model)
        return model

    def _around(self, sensors: Sequence[str], lags: FloatArray, last: _Model) -> _Model:
        """Return the model at these lags: their uncertainty and that of the start are of the fit."""
        X = self._design(sensors, lags)
        starts, turned = (
            self._starts(sensors, lags, last.beta),
            tuple(np.flatnonzero(lags > 0.0).tolist()),
        )
        # what a lag and a start have taken up of the readings is not noise: the likelihood counts them
        more = self._turns(sensors, lags, last.beta)
        s, m = float(last.fit.scales[0]) * math.hypot(1.0, last.fit.a), starts.shape[1]
        known = np.zeros((m, X.shape[1] + more.shape[1] + m))
        known[:, X.shape[1] + more.shape[1] :] = s * np.eye(m)  # start = 0 +- 1, in its own units
        n = self.y.size
        streams = [last.stream, *(Stream(np.array([n + i]), np.zeros(1), 0) for i in range(m))]
        wide = np.vstack([np.column_stack([X, more, starts]), known])
        problem = Gls(wide, np.concatenate([self.y, np.zeros(m)]), streams, [None])
        fit = problem.best()
        model = _Model(self.y, X, more, starts, turned, lags, fit, last.beta, last.stream)
        beta, k = model.solved(), X.shape[1]
        at = np.concatenate([beta[:k], np.zeros(more.shape[1]), beta[k:]])
        spread = problem.spread(at) if fit.judged else None
        return _Model(self.y, X, more, starts, turned, lags, fit, beta[:k], last.stream, spread)

    def _turns(self, sensors: Sequence[str], lags: FloatArray, beta: FloatArray) -> FloatArray:
        """Return the derivatives of the reading by the logarithms of its lags."""
        t, T = self.record.t, self.inputs.smooth
        columns = [
            beta[1 + i] * by_log_lag(t, T[sensors[i]], float(lags[i]))[self.used]
            for i in np.flatnonzero(lags > 0.0).tolist()
        ]
        return np.column_stack(columns) if columns else np.zeros((self.y.size, 0))

    def _starts(self, sensors: Sequence[str], lags: FloatArray, beta: FloatArray) -> FloatArray:
        """Return what one standard deviation does to the reading, of what a lagged sensor leaves starts.: its start."""
        t = self.record.t - self.record.t[0]
        columns = []
        for i in np.flatnonzero(lags > 0.0).tolist():
            T, lag = self.record.temperatures[sensors[i]], float(lags[i])
            columns.append(beta[1 + i] * noise_of(T) * np.exp(-t / lag))
        columns = [c[self.used] for c in columns if np.any(c)]
        return np.column_stack(columns) if columns else np.zeros((self.y.size, 0))

    def _design(self, sensors: Sequence[str], lags: FloatArray) -> FloatArray:
        record = self.record
        columns = [np.ones(record.t.size)]
        for sensor, lag in zip(sensors, lags, strict=True):
            x = lagged(record.t, self.inputs.smooth[sensor], float(lag))
            columns.append(x - x[self.used].mean())
        return np.column_stack(columns)[self.used]

    def _refined(self, sensors: Sequence[str], lags: FloatArray, last: _Model) -> FloatArray:
        """Return the lags of smallest weighted residual, by the noise that was found."""
        from scipy.optimize import minimize

        free = np.flatnonzero(lags > 0.0)
        low, high = min(self._limits()), max(self._limits())

        def with_lags(logs: FloatArray) -> FloatArray:
            new = lags.copy()
            new[free] = np.clip(np.exp(logs), low, high)
            return new

        def left(logs: FloatArray) -> float:
            new = with_lags(logs)
            starts = self._starts(sensors, new, last.beta)
            N, g, yy = last.normal(
                np.column_stack([self._design(sensors, new), starts]), starts.shape[1]
            )
            return yy - float(np.linalg.lstsq(N, g, rcond=None)[0] @ g)

        start = np.log(lags[free])
        whole = max(left(start), 1e-300)

        def share(logs: FloatArray) -> float:
            return left(logs) / whole

        found = minimize(
            share,
            start,
            method="Nelder-Mead",
            options={"xatol": 1e-5, "fatol": 1e-9, "maxfev": 80 * int(free.size)},
        )
        return with_lags(found.x)

    def _limits(self) -> tuple[float, float]:
        span = float(np.ptp(self.record.t))
        return 0.5 * float(np.median(np.diff(self.record.t))), span

    def _foretold(self, model: _Model) -> tuple[float, float]:
        """Return squared prediction errors of left-out blocks over what u says, and their RMS."""
        block, fit = self.record.block[self.used], model.fit
        wide, m = model.wide, model.starts.shape[1]
        P = np.column_stack([model.X, model.starts])
        s = float(fit.scales[0])
        expected = s**2 * (1.0 + fit.a**2)
        squares = variances = 0.0
        for b in range(self.record.blocks):
            inside, others = block == b, block != b
            N, g, _ = model.normal(P, m, others)
            beta = np.linalg.lstsq(N, g, rcond=None)[0]
            cov = _inverse(model.normal(wide, m, others)[0]) * s**2
            squares += float(np.sum((self.y[inside] - P[inside] @ beta) ** 2))
            variances += float(np.einsum("ni,ij,nj->", wide[inside], cov, wide[inside]))
            variances += expected * float(inside.sum())
        return squares / max(variances, 1e-300), math.sqrt(squares / self.y.size)

    def _unsettled(self, model: _Model) -> bool:
        """Return whether a decay from the beginning on is in the residuals."""
        t = self.record.t[self.used]
        lag = float(model.lags[list(model.turned)].min())
        decay = np.exp(-(t - t[0]) / lag)[:, None]
        N, g, _ = model.normal(np.column_stack([decay, model.wide]), model.starts.shape[1])
        inverse = _inverse(N)
        u = math.sqrt(max(float(inverse[0, 0]), 1e-300)) * float(model.fit.scales[0])
        return abs(float(inverse[0] @ g)) > _UNSETTLED * u


@dataclass(frozen=True, slots=True, eq=False)
class _Model:
    """One reading at given lags: design, derivatives by the logarithms of the lags, starts, noise."""

    y: FloatArray
    X: FloatArray
    more: FloatArray
    starts: FloatArray
    turned: tuple[int, ...]
    lags: FloatArray
    fit: Fit
    beta: FloatArray
    stream: Stream
    spread: FloatArray | None = None  # joint covariance over the drifts that the readings allow

    @property
    def wide(self) -> FloatArray:
        return np.column_stack([self.X, self.more, self.starts])

    def normal(
        self, P: FloatArray, starts: int, rows: NDArray[np.bool_] | None = None
    ) -> tuple[FloatArray, FloatArray, float]:
        """Return ``P^T V^-1 P``, ``P^T V^-1 y`` and ``y^T V^-1 y``; the last columns are known 0 +- 1."""
        both, index = np.column_stack([P, self.y]), self.stream.index
        if rows is not None:
            both, index = both[rows], index[rows]
        solved, _ = inverse_times(both, index, self.fit.a, max(self.fit.tau, 1e-9))
        N = both.T @ solved
        end = P.shape[1]
        known = np.arange(end - starts, end)
        N[known, known] += float(self.fit.scales[0]) ** 2
        return N[:-1, :-1], N[:-1, -1], float(N[-1, -1])

    def solved(self) -> FloatArray:
        """Return offset, gains and starts at these lags."""
        P = np.column_stack([self.X, self.starts])
        N, g, _ = self.normal(P, self.starts.shape[1])
        return np.asarray(np.linalg.lstsq(N, g, rcond=None)[0])

    def covariance(self) -> FloatArray:
        """Return the covariance of offset, gains, logarithms of lags, and starts, jointly."""
        if self.spread is not None:
            return self.spread
        N, _, _ = self.normal(self.wide, self.starts.shape[1])
        return _inverse(N) * float(self.fit.scales[0]) ** 2

    def significance(self) -> FloatArray:
        """Return gains over their standard uncertainty, that of lags and drift included."""
        k = self.X.shape[1]
        u = np.sqrt(np.maximum(np.diag(self.covariance())[1:k], 0.0))
        return np.asarray(np.abs(self.beta[1:]) / np.maximum(u, 1e-300))


def _inverse(N: FloatArray) -> FloatArray:
    size = np.maximum(np.sqrt(np.diag(N)), 1e-300)
    unit = np.outer(size, size)
    return np.asarray(np.linalg.pinv(N / unit, hermitian=True) / unit)


def _surprise(trials: int) -> float:
    """Return the standard deviations that one of so many trials exceeds in 5 % of records (Bonferroni)."""
    from scipy.special import ndtri

    return float(-ndtri(0.025 / trials))


def noise_of(values: FloatArray) -> float:
    """Return the noise from one sample to the next: median of second differences, or a display's digit."""
    second = np.abs(np.diff(values, 2))
    noise = 1.4826 * float(np.median(second)) / math.sqrt(6.0) if second.size else 0.0
    steps = np.abs(np.diff(values))
    if float(np.mean(steps == 0.0)) < 0.1:
        return noise
    finest = float(steps[steps > _ROUNDING * np.abs(values).max()].min(initial=np.inf))
    return max(noise, finest / math.sqrt(12.0)) if math.isfinite(finest) else noise
