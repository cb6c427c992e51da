"""Monte Carlo for parameters of whole profiles and maps (JCGM 101), bias included.

Noise changes a P-V by its extremes: on the average it grows, and first-order propagation is wrong
in value and in spread. So each result gives, beside the spread, what noise adds on the average.
"""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from types import MappingProxyType
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from metrosep.core._arrays import FloatArray
from metrosep.core.errors import DataError, FitError, TooFewSamplesError
from metrosep.core.limits import FORM_OF_SYMBOL
from metrosep.core.numbers import count, flag, real
from metrosep.core.profile import Profile
from metrosep.core.quantity import Quantity
from metrosep.core.surface import Surface
from metrosep.parameters.budget import Contribution, Distribution
from metrosep.parameters.noise import Noise, StationaryNoise, sampling_of
from metrosep.parameters.symbol_units import unit_of_symbol
from metrosep.parameters.table import (
    EXTREMES,
    NAMES,
    PEAK_TO_VALLEY,
    is_centred,
    rows,
    valid_heights,
    value_of,
    with_heights,
)
from metrosep.parameters.uncertainty import expected_range
from metrosep.spectral.dft import instance_of, symbols

_SEQUENCE = 10_000
"""Draws of one sequence of the adaptive procedure (JCGM 101, 7.9.4)."""

_COPIES = 3
"""Arrays of the size of a block that are alive at once: noise, effect, squares."""

_NOTABLE = 0.1
"""A bias of this share of u is worth a sentence."""


def shortest_interval(values: ArrayLike, coverage: float = 0.95) -> tuple[float, float]:
    """Return the shortest interval that holds a share of the values.

    Parameters
    ----------
    values : array_like, shape (n,)
        Draws, n >= 2, finite.
    coverage : float, optional
        Share, between 0 and 1.

    Returns
    -------
    tuple of (float, float)
        Ends; the first of equally short ones.

    Raises
    ------
    TooFewSamplesError
        If there are too few values for this coverage.
    DataError
        If the coverage is not between 0 and 1.

    References
    ----------
    .. [1] JCGM 101:2008, 7.7.

    Examples
    --------
    >>> shortest_interval([0.0, 1.0, 1.1, 1.2, 1.3, 9.0], 0.5)
    (1.0, 1.3)
    """
    y = np.sort(np.asarray(values, dtype=np.float64).ravel())
    q = _draws_inside(y.size, coverage)
    r = int(np.argmin(y[q:] - y[:-q]))
    return float(y[r]), float(y[r + q])


def _draws_inside(n: int, coverage: float) -> int:
    if not 0.0 < real(coverage, "coverage", what="a probability", finite=False) < 1.0:
        raise DataError(f"a coverage probability lies between 0 and 1, got {coverage}")
    q = int(coverage * n + 0.5)
    if q < 1 or q >= n:
        raise TooFewSamplesError(
            f"{n} draws do not resolve an interval of {100 * coverage:g} %; take at least "
            f"{math.ceil(100 / (1.0 - coverage))}"
        )
    return q


@dataclass(frozen=True, slots=True, eq=False)
class MonteCarloResult:
    """A parameter under noise.

    Parameters
    ----------
    value : float
        Of the object as it is, without added noise.
    mean, u : float
        Mean and standard deviation of the draws.
    interval : tuple of (float, float)
        Shortest interval that holds the share `coverage` of the draws.
    coverage : float
        Its probability.
    bias : float
        Mean of the draws less `value`: what this noise adds on the average.
    u_bias : float
        Standard error of `mean` and `bias` from the finite number of draws.
    draws : ndarray, shape (n,)
        All draws.
    stable : bool or None
        Whether the adaptive procedure reached two significant digits; None if it was not asked.
    notes : tuple of str
        What a reader must know.
    """

    value: float
    mean: float
    u: float
    interval: tuple[float, float]
    coverage: float
    bias: float
    u_bias: float
    draws: FloatArray
    stable: bool | None
    notes: tuple[str, ...]

    def to_quantity(self, unit: str, definition: str, *, symbol: str = "") -> Quantity:
        """Return the value with the standard uncertainty of the draws; the bias stays in.

        Parameters
        ----------
        unit, definition : str
            As in `Quantity`.
        symbol : str, optional
            Its symbol.

        Returns
        -------
        Quantity
            `value` with u.
        """
        return Quantity(self.value, unit, definition, u=self.u, symbol=symbol)

    def __repr__(self) -> str:
        low, high = self.interval
        head = (
            f"MonteCarloResult({self.value:.6g} without added noise; {self.draws.size} draws: mean "
            f"{self.mean:.6g}, u = {self.u:.2g}, bias {self.bias:+.3g} +- {self.u_bias:.1g}, "
            f"{100 * self.coverage:g} % in {low:.6g} ... {high:.6g})"
        )
        return "\n".join([head, *(f"  note: {n}" for n in self.notes)])


def monte_carlo(
    evaluate: str | Callable[[Profile | Surface], float | Quantity],
    obj: Profile | Surface,
    *,
    noise: Noise | None = None,
    effects: Sequence[Effect] = (),
    draws: int = 10_000,
    seed: int = 1,
    coverage: float = 0.95,
    adaptive: bool = False,
    max_draws: int = 1_000_000,
    centre: bool | None = None,
    max_bytes: int = 16_000_000,
    options: Mapping[str, Any] = MappingProxyType({}),
    prepare: Prepare | None = None,
) -> MonteCarloResult:
    """Return how a parameter scatters, and shifts, under noise and common effects.

    Parameters
    ----------
    evaluate : str or callable
        Name of a parameter. Heights over the whole length ("PV", "Pt", "Rt", "Sz", "Rq", "Sq", "RMS",
        "Ra", "Sa", "Sp", "Ssk", ...) are evaluated on many draws at once; every other symbol of the
        tables ("Rdq", "Rz", "Smr(0.5 um)", "Spd", "FLTt") and parameters of fits ("sphere.R",
        "conic.k", "plane.tilt_x") draw by draw. Or a function of an object that returns a number or
        a `Quantity`.
    obj : Profile or Surface
        Form removed and filtered; a function may do that itself.
    noise : Noise, optional
        What differs from point to point.
    effects : sequence of Effect, optional
        What is common to all points.
    draws : int, optional
        Number of draws, at least 100 / (1 - coverage) is wise.
    seed : int, optional
        Same seed, same numbers, whatever `max_bytes`.
    coverage : float, optional
        Probability of the interval.
    adaptive : bool, optional
        Whether sequences of 10 000 draws follow until mean, u and both ends are stable to two
        significant digits of u, or `max_draws` is reached; `draws` is not used.
    max_draws : int, optional
        See `adaptive`.
    centre : bool, optional
        For a name: whether the mean height is removed. By default for areal parameters and RMS,
        not for P, R and W.
    max_bytes : int, optional
        Bound of the memory for blocks of draws; one draw at least.
    options : mapping, optional
        Of the parameter table that a symbol is from: edition, sections, line, pruning.
    prepare : callable, optional
        Takes each drawn object to the one that is evaluated: form removal, filters.

    Returns
    -------
    MonteCarloResult
        Mean, u, shortest interval, bias with its standard error, notes.

    Raises
    ------
    DataError
        If there is neither noise nor effect, the name is not known, an evaluation is not finite,
        a number is out of range or not whole, or an argument is of the wrong type.
    TooFewSamplesError
        If fewer than 2 heights are valid, or draws < 2 or too few for the interval.
    NotUniformError
        If the noise is correlated and a step is not known or not uniform.

    Notes
    -----
    The object already holds the noise of its own measurement: `bias` is what a second dose adds.
    Where the first dose is as large (a map close to the noise floor), average repeats first
    (`from_repeats`) or use `noise_free_rms`. NaN stays NaN in every draw.

    References
    ----------
    .. [1] JCGM 101:2008, 7.3 to 7.9.

    Examples
    --------
    >>> from metrosep.parameters.noise import WhiteNoise
    >>> x = np.arange(500) * 1e-6
    >>> wave = Profile(x, 50e-9 * np.cos(2 * np.pi * x / 100e-6))
    >>> result = monte_carlo("PV", wave, noise=WhiteNoise(2e-9), draws=2000)
    >>> f"{result.value * 1e9:.1f} {result.mean * 1e9:.1f} {result.bias * 1e9:+.1f} nm"
    '100.0 107.9 +7.9 nm'
    """
    effects = _checked_causes(obj, noise, effects)
    adaptive = flag(adaptive, "adaptive")
    centre = centre if centre is None else flag(centre, "centre")
    count(draws, "draws", least=0)
    count(max_draws, "max_draws", least=0)
    count(seed, "seed", least=0)
    real(max_bytes, "max_bytes", finite=False)
    if not adaptive and draws < 2:
        raise TooFewSamplesError(f"a Monte Carlo needs at least 2 draws, got {draws}")
    _draws_inside(_SEQUENCE if adaptive else draws, coverage)
    if max_draws < 2 * _SEQUENCE and adaptive:
        raise DataError(f"max_draws must allow two sequences of {_SEQUENCE}, got {max_draws}")
    if isinstance(evaluate, str) and (evaluate not in NAMES or prepare or options):
        evaluate = _one_name(evaluate, obj, options, prepare)
    elif prepare is not None:
        raise DataError("prepare= goes with a name; a function prepares for itself")
    value = value_of(evaluate, obj, centre=centre)
    source = _Draws(evaluate, obj, noise, effects, seed, centre, max_bytes)
    stable: bool | None = None
    if adaptive:
        results, stable = _adaptive(source, coverage, max_draws)
    else:
        results = source.take(draws)
    results.setflags(write=False)
    mean, u = float(results.mean()), float(results.std(ddof=1))
    bias, u_bias = mean - value, u / math.sqrt(results.size)
    return MonteCarloResult(
        value,
        mean,
        u,
        shortest_interval(results, coverage),
        coverage,
        bias,
        u_bias,
        results,
        stable,
        tuple(_notes(evaluate, obj, noise, (value, bias, u, u_bias), stable)),
    )


Prepare = Callable[[Profile | Surface], Profile | Surface]


def _one_name(
    name: str, obj: Profile | Surface, options: Mapping[str, Any], prepare: Prepare | None
) -> Callable[[Profile | Surface], float]:
    """Return the evaluation of one name, after the preparation of each draw."""
    ready = obj if prepare is None else prepare(obj)
    named = evaluated_names([name], ready, options)
    return lambda drawn: named(drawn if prepare is None else prepare(drawn))[name]


@dataclass(frozen=True, slots=True, eq=False)
class MonteCarloTable:
    """Several parameters on the same draws.

    Parameters
    ----------
    results : mapping of str to MonteCarloResult
        By name.
    correlation : ndarray, shape (n, n)
        Of the draws, in the order of the names.
    n_failed : int
        Draws that could not be evaluated and are omitted.
    notes : tuple of str
        What a reader must know.
    """

    results: Mapping[str, MonteCarloResult]
    correlation: FloatArray
    n_failed: int
    notes: tuple[str, ...]

    def __getitem__(self, name: str) -> MonteCarloResult:
        return self.results[name]


_FORECAST = 5
"""Draws after which the time of all of them is told."""
_MOST_FAILED = 0.01


def monte_carlo_table(
    names: Sequence[str],
    obj: Profile | Surface,
    *,
    noise: Noise | None = None,
    effects: Sequence[Effect] = (),
    draws: int = 1000,
    seed: int = 1,
    coverage: float = 0.95,
    options: Mapping[str, Any] = MappingProxyType({}),
    prepare: Prepare | None = None,
    tell: Callable[[str], None] | None = None,
) -> MonteCarloTable:
    """Return how several parameters scatter, and hang together, under the same noise.

    Parameters
    ----------
    names : sequence of str
        Symbols of the tables and parameters of fits, as for `monte_carlo`.
    obj : Profile or Surface
        Measurement.
    noise : Noise, optional
        What differs from point to point.
    effects : sequence of Effect, optional
        What is common to all points.
    draws : int, optional
        Number of draws, >= 2.
    seed : int, optional
        Same seed, same numbers.
    coverage : float, optional
        Probability of the intervals.
    options : mapping, optional
        Of the parameter tables: edition, sections, line, pruning.
    prepare : callable, optional
        Takes each drawn object to the one that is evaluated: form removal, filters.
    tell : callable, optional
        Takes a sentence with the expected time after five draws.

    Returns
    -------
    MonteCarloTable
        A result for each name, and their correlation.

    Raises
    ------
    DataError
        If there is neither noise nor effect, a name is unknown, or more than 1 % of the draws could
        not be evaluated.
    TooFewSamplesError
        If there are too few draws or heights.

    References
    ----------
    .. [1] JCGM 101:2008; JCGM 102:2011 for several quantities.

    Examples
    --------
    >>> from metrosep.parameters.noise import WhiteNoise
    >>> x = np.arange(400) * 1e-6
    >>> wave = Profile(x, 50e-9 * np.cos(2 * np.pi * x / 100e-6))
    >>> found = monte_carlo_table(["Pdq", "Pq"], wave, noise=WhiteNoise(1e-9), draws=100)
    >>> sorted(found.results), found.n_failed
    (['Pdq', 'Pq'], 0)
    """
    effects = _checked_causes(obj, noise, effects)
    count(draws, "draws", least=2)
    count(seed, "seed", least=0)
    _draws_inside(draws, coverage)
    ready = obj if prepare is None else prepare(obj)
    evaluate = evaluated_names(names, ready, options)
    nominal = evaluate(ready)
    source = _Draws("mean", obj, noise, effects, seed, None, 16_000_000)
    rows_of: list[list[float]] = []
    failed: list[str] = []
    began = time.perf_counter()
    for n, drawn in enumerate(source.objects(draws), start=1):
        try:
            values = list(evaluate(drawn if prepare is None else prepare(drawn)).values())
        except (DataError, FitError) as reason:
            failed.append(str(reason))
        else:
            rows_of.append(values)
        if n == _FORECAST and tell is not None:
            each = (time.perf_counter() - began) / n
            tell(f"{draws} draws take about {each * draws:.2g} s")
    if len(failed) > _MOST_FAILED * draws or len(rows_of) < 2:
        raise DataError(
            f"{len(failed)} of {draws} draws could not be evaluated, more than 1 %; the first: "
            f"{failed[0]}"
        )
    drawn_values = np.array(rows_of)
    results = {
        name: _result_of(column, nominal[name], coverage)
        for name, column in zip(nominal, drawn_values.T, strict=True)
    }
    with np.errstate(invalid="ignore", divide="ignore"):
        correlation = np.atleast_2d(np.corrcoef(drawn_values.T))
    notes = (
        [f"{len(failed)} of {draws} draws could not be evaluated and are omitted: {failed[0]}"]
        if failed
        else []
    )
    return MonteCarloTable(results, correlation, len(failed), tuple(notes))


def _result_of(values: FloatArray, value: float, coverage: float) -> MonteCarloResult:
    values = values.copy()
    values.setflags(write=False)
    mean, u = float(values.mean()), float(values.std(ddof=1))
    interval = shortest_interval(values, coverage)
    error = u / math.sqrt(values.size)
    notes = []
    if abs(mean - value) > max(3.0 * error, _NOTABLE * u):
        notes.append(f"this noise moves the parameter by {mean - value:+.3g} on the average")
    return MonteCarloResult(
        value, mean, u, interval, coverage, mean - value, error, values, None, tuple(notes)
    )


def _checked_causes(obj: object, noise: object, effects: object) -> tuple[Effect, ...]:
    """Return the effects; a bare number as noise or effect is refused with what it should be."""
    instance_of(obj, (Profile, Surface), "a Monte Carlo")
    if noise is not None and not isinstance(noise, Noise):
        example = (
            f"WhiteNoise({noise!r})" if isinstance(noise, int | float) else "WhiteNoise(2e-9)"
        )
        raise DataError(f"noise must be a noise model, such as {example}, got {noise!r}")
    try:
        given: tuple[object, ...] = tuple(effects)  # type: ignore[arg-type]
    except TypeError:
        raise DataError(f"effects is a sequence of Effect, got {effects!r}") from None
    found = tuple(e for e in given if isinstance(e, Effect))
    if len(found) < len(given):
        wrong = next(e for e in given if not isinstance(e, Effect))
        raise DataError(f"an effect must be an Effect, such as scale_effect(1e-6), got {wrong!r}")
    if noise is None and not found:
        raise DataError("a Monte Carlo needs noise= or at least one effect")
    return found


class _Draws:
    """A stream of values of the parameter; each cause has a generator of its own."""

    def __init__(
        self,
        evaluate: str | Callable[[Profile | Surface], float | Quantity],
        obj: Profile | Surface,
        noise: Noise | None,
        effects: tuple[Effect, ...],
        seed: int,
        centre: bool | None,
        max_bytes: int,
    ) -> None:
        self.evaluate, self.obj, self.noise, self.centre = evaluate, obj, noise, centre
        self.heights, self.mask = valid_heights(obj)
        self.changes = [(e, _change(e, obj)[self.mask]) for e in effects]
        streams = np.random.SeedSequence(seed).spawn(1 + len(effects))
        self.rngs = [np.random.default_rng(s) for s in streams]
        self.block = max(1, int(max_bytes) // (8 * _COPIES * obj.z.size))

    def take(self, count: int) -> FloatArray:
        return np.concatenate([self._values(k) for k in self._sizes(count)])

    def objects(self, count: int) -> Iterator[Profile | Surface]:
        """Give drawn objects one by one."""
        for size in self._sizes(count):
            for heights in self._heights(size):
                yield self._object(heights)

    def _sizes(self, count: int) -> Iterator[int]:
        for start in range(0, count, self.block):
            yield min(self.block, count - start)

    def _values(self, size: int) -> FloatArray:
        block = self._heights(size)
        if isinstance(self.evaluate, str):
            centred = is_centred(self.evaluate, self.centre)
            return rows(self.evaluate, block, centred=centred)
        return np.array([value_of(self.evaluate, self._object(row)) for row in block])

    def _heights(self, size: int) -> FloatArray:
        if self.noise is None:
            block = np.zeros((size, self.heights.size))
        else:
            fields = self.noise.draw(sampling_of(self.obj), self.rngs[0], size)
            block = fields.reshape(size, -1)
            if not self.mask.all():
                block = block[:, self.mask.ravel()]
        block += self.heights
        for (effect, change), rng in zip(self.changes, self.rngs[1:], strict=True):
            block += effect.draw(rng, size)[:, None] * change
        return block

    def _object(self, heights: FloatArray) -> Profile | Surface:
        z = np.full(self.obj.z.shape, np.nan)
        z[self.mask] = heights
        return with_heights(self.obj, z)


def _change(effect: Effect, obj: Profile | Surface) -> FloatArray:
    change = np.asarray(effect.change(obj.z), dtype=np.float64)
    if change.shape != obj.z.shape or not np.isfinite(change[~np.isnan(obj.z)]).all():
        raise DataError(
            f"the effect {effect.line.name} must give one finite change for each valid height"
        )
    return change


def _adaptive(source: _Draws, coverage: float, max_draws: int) -> tuple[FloatArray, bool]:
    """Return draws by JCGM 101, 7.9.4, and whether they are stable."""
    sequences: list[FloatArray] = []
    figures: list[tuple[float, float, float, float]] = []
    while (len(sequences) + 1) * _SEQUENCE <= max_draws:
        values = source.take(_SEQUENCE)
        sequences.append(values)
        low, high = shortest_interval(values, coverage)
        figures.append((float(values.mean()), float(values.std(ddof=1)), low, high))
        if len(sequences) < 2:
            continue
        u = float(np.concatenate(sequences).std(ddof=1))
        errors = np.std(figures, axis=0, ddof=1) / math.sqrt(len(figures))
        if u == 0.0 or (2.0 * errors < _numerical_tolerance(u)).all():
            return np.concatenate(sequences), True
    return np.concatenate(sequences), False


def _numerical_tolerance(u: float) -> float:
    """Return half a unit of the second significant digit (JCGM 101, 7.9.2)."""
    return float(0.5 * 10.0 ** (math.floor(math.log10(u)) - 1))


def _notes(
    evaluate: str | Callable[[Profile | Surface], float | Quantity],
    obj: Profile | Surface,
    noise: Noise | None,
    figures: tuple[float, float, float, float],
    stable: bool | None,
) -> Iterator[str]:
    value, bias, u, u_bias = figures
    if stable is False:
        yield "not stable to two digits after the largest number of draws"
    if abs(bias) > max(3.0 * u_bias, _NOTABLE * u):
        kind = "an extreme, which noise pushes outwards" if evaluate in EXTREMES else "not linear"
        yield (
            f"the parameter is {kind}: this noise moves it by {bias:+.3g} on the average "
            f"({bias / u:+.1f} u); u alone does not say so. Average repeats or filter, and report "
            "raw and averaged values"
        )
    if evaluate in PEAK_TO_VALLEY and isinstance(noise, StationaryNoise):
        sigma = noise.standard_deviation(obj)
        n = int(np.isfinite(obj.z).sum())
        floor = expected_range(n) * sigma
        if floor > 0.0:
            yield (
                f"noise alone has a P-V of {floor:.3g} on {n} independent points (less if "
                f"neighbours share noise), {100 * floor / value:.3g} % of the value"
                if value > 0.0
                else f"noise alone has a P-V of {floor:.3g} on {n} independent points"
            )


# ---- effects that a Monte Carlo draws once per measurement: scale, drift, nonlinearity, or your own ----
# Noise differs from point to point; an effect is one unknown number that acts on all points.


@dataclass(frozen=True, slots=True, eq=False)
class Effect:
    """An unknown number of zero mean and what it does to the heights.

    Parameters
    ----------
    line : Contribution
        Name, size and distribution of the number; its sensitivity is not used.
    change : callable
        From the heights, shape (n_y, n_x) or (n,), NaN kept, to the change per unit of the
        number, same shape. The change is linear in the number.

    Examples
    --------
    >>> tilt = Effect(Contribution("tilt", 1e-9), lambda z: np.linspace(-0.5, 0.5, z.size))
    """

    line: Contribution
    change: Callable[[FloatArray], FloatArray]

    def draw(self, rng: np.random.Generator, size: int) -> FloatArray:
        """Return draws of the number.

        Parameters
        ----------
        rng : numpy.random.Generator
            Used draw by draw.
        size : int
            How many.

        Returns
        -------
        ndarray, shape (size,)
            From the distribution of the line, by inversion.
        """
        from scipy.special import ndtri, stdtrit

        line = self.line
        chance = np.maximum(rng.random(size), np.finfo(float).tiny)
        if line.distribution == "normal":
            unit = ndtri(chance) if math.isinf(line.dof) else stdtrit(line.dof, chance)
            return np.asarray(unit * line.u_input)
        width = line.u_input * _HALF_WIDTH[line.distribution]
        if line.distribution == "rectangular":
            return np.asarray(width * (2.0 * chance - 1.0))
        if line.distribution == "arcsine":
            return np.asarray(-width * np.cos(np.pi * chance))
        low = chance < 0.5
        root = np.sqrt(2.0 * np.where(low, chance, 1.0 - chance))
        return np.asarray(width * np.where(low, root - 1.0, 1.0 - root))


_HALF_WIDTH: dict[Distribution, float] = {
    "rectangular": math.sqrt(3.0),
    "arcsine": math.sqrt(2.0),
    "triangular": math.sqrt(6.0),
}


def scale_effect(u_relative: float, *, distribution: Distribution = "normal") -> Effect:
    """Return a common error of the z scale.

    Parameters
    ----------
    u_relative : float
        Standard uncertainty (normal) or half-width of the scale factor, 100 ppm = 1e-4.
    distribution : {"normal", "rectangular", "triangular", "arcsine"}, optional
        Of the factor.

    Returns
    -------
    Effect
        z grows by k z.

    Raises
    ------
    DataError
        If the number is negative or not finite, or the distribution is not known.

    Notes
    -----
    P-V, Ra, Rq are homogeneous of degree 1: this adds u_relative times their value.
    """
    return Effect(Contribution("z scale", u_relative, distribution), lambda z: z)


def drift_effect(
    value: float, *, distribution: Distribution = "rectangular", axis: int = 0
) -> Effect:
    """Return a thermal drift that grows linearly along the scan.

    Parameters
    ----------
    value : float, m
        Half-width (or standard uncertainty, if normal) of the drift from first to last row or
        sample.
    distribution : {"normal", "rectangular", "triangular", "arcsine"}, optional
        Of the drift.
    axis : int, optional
        Axis of the array along which time runs.

    Returns
    -------
    Effect
        A ramp of zero mean. It vanishes where a line or plane is removed in the evaluation.

    Raises
    ------
    DataError
        If the number is negative or not finite, or the distribution is not known.
    """

    def ramp(z: FloatArray) -> FloatArray:
        if not -z.ndim <= axis < z.ndim:
            raise DataError(f"drift along axis {axis} of heights with {z.ndim} axes")
        n = z.shape[axis]
        shape = [1] * z.ndim
        shape[axis] = n
        line = np.linspace(-0.5, 0.5, n).reshape(shape)
        return np.asarray(np.broadcast_to(line, z.shape))

    return Effect(Contribution("drift", value, distribution), ramp)


def nonlinearity_effect(value: float, *, distribution: Distribution = "rectangular") -> Effect:
    """Return the quadratic error of a sensor over the range of the heights.

    Parameters
    ----------
    value : float, m
        Half-width (or standard uncertainty, if normal) of the error at the ends of the range
        relative to its middle, such as the gap^2 term of a capacitance probe.
    distribution : {"normal", "rectangular", "triangular", "arcsine"}, optional
        Of the error.

    Returns
    -------
    Effect
        z grows by q t^2, where t runs from -1 to 1 over the valid heights.

    Raises
    ------
    DataError
        If the number is negative or not finite, or the distribution is not known.
    """

    def square(z: FloatArray) -> FloatArray:
        low, high = float(np.nanmin(z)), float(np.nanmax(z))
        half = 0.5 * (high - low)
        if half == 0.0:
            return np.zeros(z.shape)
        t = (z - 0.5 * (high + low)) / half
        return np.asarray(t * t)

    return Effect(Contribution("sensor nonlinearity", value, distribution), square)


# ---- values by name of a drawn profile or map: every symbol of the tables, parameters of fits -------
# Names of several families go together, so that one draw serves all of them and their correlation is
# that of the measurement.

Evaluated = Callable[[Profile | Surface], dict[str, float]]

_INTERFEROMETRIC = ("PV", "RMS", "PVr", "PVq", "PV20")


def evaluated_names(
    names: Sequence[str], obj: Profile | Surface, options: Mapping[str, Any]
) -> Evaluated:
    """Return what evaluates names such as ``Rdq``, ``Smr(0.5 um)``, ``FLTt`` or ``sphere.R``.

    `options` are those of the parameter tables (edition, sections, ...). Names are checked against
    the object here, before anything is drawn.
    """
    groups: dict[str, list[str]] = {}
    for name in symbols(names):
        groups.setdefault(_family(name, obj), []).append(name)
    evaluators = [_evaluator(family, of, options) for family, of in groups.items()]

    def evaluate(drawn: Profile | Surface) -> dict[str, float]:
        found: dict[str, float] = {}
        for one in evaluators:
            found |= one(drawn)
        return {name: found[name] for name in names}

    return evaluate


def _family(name: str, obj: Profile | Surface) -> str:
    form, dot, _ = name.partition(".")
    if dot and "(" not in form:
        return f"form:{form}"
    if name[:3] in FORM_OF_SYMBOL and unit_of_symbol(name) is not None:
        return name[:3]
    if isinstance(obj, Surface):
        return "interferometric" if name in _INTERFEROMETRIC else "S"
    plain = name in ("Mr1", "Mr2", "A1", "A2") or name.startswith("tp(")
    if not plain and name[:1] not in ("P", "W", "R"):
        raise DataError(f"a profile has no parameter {name!r}")
    return "R" if plain else name[0]


def _evaluator(family: str, names: Sequence[str], options: Mapping[str, Any]) -> Evaluated:
    if family.startswith("form:"):
        return partial(_of_form, form=family[5:], names=names)
    return partial(_of_table, family=family, names=names, options=options)


def _of_form(obj: Profile | Surface, *, form: str, names: Sequence[str]) -> dict[str, float]:
    from metrosep.forms import fit
    from metrosep.forms.catalogue import form_from_text

    found = fit(obj, form_from_text(form))
    known: dict[str, float] = {**found.params, "rms": found.rms, "pv": found.peak_to_valley}
    values = {}
    for name in names:
        parameter = name.partition(".")[2]
        if parameter not in known:
            raise DataError(f"{name}: a fit of the {form} gives {', '.join(known)}")
        values[name] = float(known[parameter])
    return values


def _of_table(
    obj: Profile | Surface, *, family: str, names: Sequence[str], options: Mapping[str, Any]
) -> dict[str, float]:
    from metrosep.parameters import (
        areal_parameters,
        form_deviation,
        interferometric_parameters,
        profile_parameters,
    )

    given: dict[str, Any] = dict(options)
    table: Any
    if family in FORM_OF_SYMBOL:
        kind: Any = FORM_OF_SYMBOL[family]
        table = form_deviation(obj, kind=kind).table
    elif family == "interferometric" and isinstance(obj, Surface):
        table = interferometric_parameters(obj, names=names)
    elif isinstance(obj, Surface):
        table = areal_parameters(obj, names=names, **given)
    else:
        letter: Any = family
        table = profile_parameters(obj, kind=letter, names=names, **given)
    return {name: float(table[name].value) for name in names}
