"""Spindle error motion against speed: polynomial fits with bands, and resonances made visible.

Synchronous motion below the first resonance follows a + b n^2 (unbalance, dynamic stiffness) or is
constant; near a resonance it leaves any low polynomial. `fit_speed_sweep` says both, with the order
of rotation that a hinted natural frequency would excite.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, ClassVar, Literal

import numpy as np
from numpy.typing import ArrayLike

from metrosep.core._arrays import FloatArray, frozen_float
from metrosep.core.docs import described_by
from metrosep.core.errors import (
    DataError,
    DegenerateFitError,
    InvalidSamplesError,
    OptionError,
    TooFewSamplesError,
    UnitError,
)
from metrosep.core.methods import RoleColumns
from metrosep.core.numbers import choice, count, positive
from metrosep.core.options import Option
from metrosep.core.profile import html_table
from metrosep.core.provenance import Step
from metrosep.core.quantity import Quantity
from metrosep.core.units import format_engineering
from metrosep.separation._readings import as_numbers, known_parts, part_of, real_numbers
from metrosep.separation.circles.spindle_result import SpindleMotion
from metrosep.separation.contract import (
    History,
    NamedMethod,
    Parts,
    RecordedMethod,
    Separation,
    StoredResult,
    Unobservable,
    as_stated,
    type_a,
)

_FASTEST = 2e3
"""rev/s beyond which a speed is refused: 120 000 rev/min. Air turbines above are rare, speeds typed
in rev/min are not."""

_DOUBT = 0.01
"""p of the lack of fit below which a message reports it."""


@dataclass(frozen=True, slots=True, eq=False, repr=False)
class SpeedSweep(StoredResult):
    """Spindle values against speed; frozen.

    Parameters
    ----------
    speed : ndarray, shape (n,), rev/s
        Rising, repeats allowed.
    fits : mapping of str to SpeedFit
        By symbol.
    natural_frequency : float or None, Hz
        As hinted.
    critical : mapping of int to float
        Order k to the speed in rev/s where k times the speed meets the natural frequency.
    audit : mapping
        Settings, plain values.
    messages : tuple of str
        What a reader must know.
    """

    speed: FloatArray
    fits: Mapping[str, SpeedFit]
    natural_frequency: float | None
    critical: Mapping[int, float]
    audit: Mapping[str, Any]
    messages: tuple[str, ...]

    def __getitem__(self, symbol: str) -> SpeedFit:
        return self.fits[symbol]

    def __repr__(self) -> str:
        rows = "; ".join(f"{name}: {fit}" for name, fit in self.fits.items())
        return f"SpeedSweep({self._range()}; {rows})"

    def _range(self) -> str:
        low, high = float(self.speed[0]), float(self.speed[-1])
        return f"{self.speed.size} recordings, {low:.4g} to {high:.4g} rev/s"

    def _repr_html_(self) -> str:
        """Return a small table for notebooks."""
        rows = {name: str(fit) for name, fit in self.fits.items()}
        rows.update({f"message {i + 1}": m for i, m in enumerate(self.messages)})
        return html_table(f"Speed sweep: {self._range()}", rows)


def fit_speed_sweep(
    speed: ArrayLike,
    results: Sequence[SpindleMotion] | Mapping[str, ArrayLike],
    *,
    u: Mapping[str, ArrayLike] | None = None,
    powers: Sequence[int] = (0, 2),
    symbols: Sequence[str] = ("synchronous", "asynchronous_sd"),
    natural_frequency: float | None = None,
    orders: Sequence[int] = (1, 2, 3, 4, 5, 6),
) -> SpeedSweep:
    """Return how spindle error motion depends on speed.

    Parameters
    ----------
    speed : array_like, shape (n,), rev/s
        Of each recording; at least one more than there are powers.
    results : sequence of SpindleMotion, or mapping of str to array_like, shape (n,)
        One per recording; or values by symbol, in m or rad.
    u : mapping of str to array_like, shape (n,), optional
        Standard uncertainty of values that come as arrays.
    symbols : sequence of str, optional
        Values of the table to fit, where results are given.

    Returns
    -------
    SpeedSweep
        Fits with confidence intervals, critical speeds, messages.

    Raises
    ------
    TooFewSamplesError
        If there are not more recordings than powers.
    InvalidSamplesError
        If values or speeds are NaN, negative or of another number.
    DegenerateFitError
        If there are fewer different speeds than powers.
    UnitError
        If a speed is beyond 2000 rev/s: it was given in rev/min.
    DataError
        If results, powers, orders or the natural frequency are not usable.

    Notes
    -----
    Weighted least squares with weights 1/u^2 where all u are known and positive, else equal. The
    covariance is multiplied by chi^2 / degrees where that exceeds 1, so a wrong u never makes the
    interval too narrow; Student's t with the degrees of freedom of the fit. A speed is a peak if
    its value lies above the fit through all others by more than 4 standard deviations of its
    prediction. A polynomial does not describe a resonance: p_fit says where it fails.

    Examples
    --------
    >>> import numpy as np
    >>> n = np.array([10.0, 20.0, 30.0, 40.0, 50.0])
    >>> sweep = fit_speed_sweep(n, {"synchronous": 20e-9 + 1e-11 * n**2})
    >>> c = sweep["synchronous"].coefficients
    >>> print(f"{c[0]:.3g} m, {c[1]:.3g} m s^2")
    2e-08 m, 1e-11 m s^2
    """
    at = _speeds(speed)
    exponents = _powers(powers)
    if natural_frequency is not None:
        natural_frequency = positive(
            natural_frequency, "the natural frequency", dimension="frequency"
        )
    tried = _whole(orders, "orders", least=1)
    columns = _columns(results, u, symbols, at.size)
    order = np.argsort(at, kind="stable")
    at = at[order]
    fits = {
        name: fit_values(name, at, values[order], sd[order], exponents, unit)
        for name, (values, sd, unit) in columns.items()
    }
    critical = {} if natural_frequency is None else {k: natural_frequency / k for k in tried}
    at.setflags(write=False)
    return SpeedSweep(
        speed=at,
        fits=fits,
        natural_frequency=natural_frequency,
        critical=critical,
        audit={
            "n_recordings": int(at.size),
            "powers": list(exponents),
            "symbols": list(fits),
            "natural_frequency_hz": natural_frequency,
        },
        messages=tuple(_messages(at, fits, natural_frequency, critical)),
    )


def _speeds(speed: ArrayLike) -> FloatArray:
    at = _real(speed, "the speed")
    if np.isnan(at).any() or (at < 0.0).any():
        raise InvalidSamplesError("speeds must be finite and not negative, in rev/s")
    if at.max() > _FASTEST:
        raise UnitError(
            f"a speed of {at.max():.6g} rev/s is {60 * at.max():.6g} rev/min: speeds are in rev/s, "
            "divide rev/min by 60"
        )
    return at


def _real(values: ArrayLike, name: str) -> FloatArray:
    return np.array(frozen_float(real_numbers(values, name), name=name, ndim=1))


def _whole(values: Any, name: str, *, least: int) -> tuple[int, ...]:
    if isinstance(values, str) or not np.iterable(values):
        raise OptionError(
            f"{name} must be a sequence of whole numbers from {least}, got {values!r}"
        )
    return tuple(count(v, name, least=least) for v in values)


def _powers(powers: Sequence[int]) -> tuple[int, ...]:
    exponents = _whole(powers, "powers", least=0)
    if not exponents:
        raise DataError("powers is empty: give whole numbers from 0, such as (0, 2)")
    if len(set(exponents)) < len(exponents):
        raise DataError(f"a power occurs twice in {exponents}")
    return exponents


def _columns(
    results: Sequence[SpindleMotion] | Mapping[str, ArrayLike],
    u: Mapping[str, ArrayLike] | None,
    symbols: Sequence[str],
    size: int,
) -> dict[str, tuple[FloatArray, FloatArray, str]]:
    given: dict[str, tuple[ArrayLike, ArrayLike, str]]
    if isinstance(results, Mapping):
        if u is not None and not isinstance(u, Mapping):
            raise DataError(
                f"u= must be a mapping such as {{{next(iter(results), 'synchronous')!r}: [...]}}, got {type(u).__name__}"
            )
        spread = u or {}
        unknown = sorted(set(spread) - set(results))
        if unknown:
            raise DataError(f"u= names {', '.join(unknown)}, which has no values")
        given = {k: (v, spread.get(k, np.full(size, np.nan)), "m") for k, v in results.items()}
    else:
        if u is not None:
            raise DataError("u= belongs to arrays; results carry theirs")
        if not isinstance(results, list | tuple) or not all(
            isinstance(r, SpindleMotion) for r in results
        ):
            raise DataError(
                f"results must be SpindleMotion objects, or values by symbol such as "
                f"{{'synchronous': [...]}}; got {type(results).__name__}"
            )
        unknown = [str(name) for name in symbols if any(name not in r.table for r in results)]
        if unknown:
            raise DataError(f"the results hold no value {', '.join(unknown)}")
        if len({(r.direction, r.sensitive) for r in results}) > 1:
            raise DataError("the recordings are of different directions: fit them apart")
        rows = {name: [r.table[name] for r in results] for name in symbols}
        given = {
            k: (
                [q.value for q in row],
                [math.nan if q.u is None else q.u for q in row],
                row[0].unit if row else "m",
            )
            for k, row in rows.items()
        }
    columns = {
        name: (_column(values, name, size), _column(sd, f"u of {name}", size), unit)
        for name, (values, sd, unit) in given.items()
    }
    missing = [name for name, (values, _, _) in columns.items() if np.isnan(values).any()]
    if missing:
        raise InvalidSamplesError(f"{', '.join(missing)} is NaN: leave those recordings out")
    return columns


def _column(values: ArrayLike, name: str, size: int) -> FloatArray:
    numbers = real_numbers(values, name)
    if numbers.size != size:
        raise InvalidSamplesError(f"{name} has {numbers.size} values, there are {size} speeds")
    column = _real(numbers, name)
    if (column < 0.0).any():
        raise InvalidSamplesError(f"{name} is negative: widths and standard deviations are not")
    return column


def _messages(
    speed: FloatArray,
    fits: Mapping[str, SpeedFit],
    natural_frequency: float | None,
    critical: Mapping[int, float],
) -> list[str]:
    said = []
    for name, fit in fits.items():
        if fit.p_fit < _DOUBT:
            said.append(
                f"the polynomial does not describe {name} (p = {fit.p_fit:.1g}): a resonance, or "
                "u holds too little; the interval was widened"
            )
        if fit.peaks:
            at = ", ".join(f"{s:.4g}" for s in fit.peaks)
            said.append(f"{name} stands out at {at} rev/s")
        spacing = float(np.median(np.diff(np.unique(speed)))) if fit.peaks else 0.0
        for peak in fit.peaks:
            near = [f"k={k}" for k, s in critical.items() if abs(s - peak) <= spacing]
            if near:
                said.append(
                    f"at {peak:.4g} rev/s the natural frequency is met by {' or '.join(near)}"
                )
        if math.isnan(fit.p_fit):
            said.append(
                f"{name} has no uncertainty of its own: the interval is from the residuals"
            )
    if natural_frequency is not None:
        inside = [k for k, s in critical.items() if speed[0] <= s <= speed[-1]]
        if inside:
            text = ", ".join(f"k={k} at {critical[k]:.4g} rev/s" for k in inside)
            said.append(f"{natural_frequency:.6g} Hz is met within the sweep by {text}")
    return said


# ---- `SpeedGrowth`: values of spindle tests at several speeds: what stays at rest, what grows ----
# ``reading_i = at_rest + growth(n_i)`` with ``growth(n) = sum_p c_p n^p`` over the powers p > 0.

_LEVEL = "what is the same at every speed is counted as at_rest: growth is zero at standstill"
_ARTEFACT = "the form of the artefact is the same at every speed; take it out by a reversal"
_LAW = "a law of other powers, or a resonance, is shared out over the powers of the fit"
_NO_LEVEL = "the powers have no 0: nothing is taken to stay at rest; add 0 to the powers"


_PER_SECOND = {"rev/s": 1.0, "Hz": 1.0, "rev/min": 1.0 / 60.0}


class SpeedTest(NamedMethod):
    """`fit_speed_sweep` by its name."""

    name = "fit_speed_sweep"
    what = "how values of spindle tests depend on speed, and which speeds stand out"
    reads = "table"
    roles: ClassVar[Mapping[str, str]] = {"speed": "any", "readings": "length*", "u": "length*?"}
    arguments: ClassVar[Mapping[str, Option]] = {
        "speed_unit": Option(
            "text", required=True, choices=tuple(_PER_SECOND), help="of the column of speeds"
        ),
        "powers": Option("integers", help="of the speed: 0,2 is a constant and unbalance"),
        "names": Option("texts", help="of the values; those of the columns if omitted"),
        "natural_frequency": Option(
            "frequency", help="of spindle or mount, to name the speeds whose orders excite it"
        ),
        "orders": Option("integers", help="multiples of the speed that may meet it"),
    }

    @classmethod
    def from_inputs(cls, data: RoleColumns, options: Mapping[str, Any]) -> SpeedSweep:
        """Return the fits of the columns of values over the speed."""
        rest, values = dict(options), data.values
        names = rest.pop("names", None) or data.columns["readings"]
        columns, u = values["readings"], values.get("u")
        if len(names) != len(columns) or len(set(names)) != len(names):
            raise DataError(
                f"{len(columns)} columns of values need as many different names, got "
                f"{', '.join(names)}"
            )
        if u is not None and len(u) != len(names):
            raise DataError(
                f"{len(u)} columns of uncertainties for {len(names)} of values; name one for each, "
                "in the same order"
            )
        spread = None if u is None else dict(zip(names, u, strict=True))
        per_second = values["speed"] * _PER_SECOND[rest.pop("speed_unit")]
        return fit_speed_sweep(
            per_second, dict(zip(names, columns, strict=True)), u=spread, **rest
        )


@described_by(fit_speed_sweep)
@dataclass(frozen=True, slots=True)
class SpeedGrowth(RecordedMethod):
    """Values at stated speeds, as a polynomial in speed.

    Readings (n_speeds, n_values) in m or rad: one row for each speed, one column for each value:
    synchronous, asynchronous, or the cosine and the sine of one order with their signs; NaN = not
    measured. Parts: ``at_rest`` (n_values,); ``growth`` (n_speeds, n_values), zero at standstill.
    Values with fewer readings or speeds than the powers need are NaN; so is the growth where
    nothing was measured, and `at_rest` where the powers have no 0.

    Parameters
    ----------
    speeds : tuple of float, rev/s
        Of each recording, in any order; repeats allowed.
    powers : tuple of int, optional
        Of the speed; (0, 2) is a constant and unbalance.
    unit : {"m", "rad"}, optional
        Of the readings.

    Notes
    -----
    `fit_speed_sweep` has the same fit (`fit_values`) with confidence intervals, critical speeds and
    weights of each recording; it refuses negative widths, which are allowed here because components
    have signs. With `u_reading` the covariance is widened where the residuals exceed it, never
    narrowed. The noise is pooled over the values, u is that of each.

    Examples
    --------
    >>> method = SpeedGrowth((10.0, 20.0, 30.0, 40.0))
    >>> readings = method.simulate({"at_rest": [2e-8]}, {"growth": [[1e-9], [4e-9], [9e-9], [16e-9]]})
    >>> found = method.separate(readings)
    >>> (found.at_rest * 1e9).round(6).tolist(), (found.growth * 1e9).round(6).ravel().tolist()
    ([20.0], [1.0, 4.0, 9.0, 16.0])
    """

    speeds: tuple[float, ...]
    powers: tuple[int, ...] = (0, 2)
    unit: Literal["m", "rad"] = "m"

    name = "speed_sweep"
    truth_parts = ("at_rest",)
    error_parts = ("growth",)

    def __post_init__(self) -> None:
        choice(self.unit, f"{self.name}: unit", ("m", "rad"))
        fit_speed_sweep(self.speeds, {"none": np.zeros(np.size(self.speeds))}, powers=self.powers)

    @property
    def _dimension(self) -> str:
        return "length" if self.unit == "m" else "angle"

    def simulate(self, truth: Parts, errors: Parts) -> FloatArray:
        parts = known_parts(self, truth, errors)
        points = parts["at_rest"].shape if "at_rest" in parts else parts["growth"].shape[1:]
        growth = part_of(parts, "growth", (len(self.speeds), *points), self.name)
        return np.asarray(part_of(parts, "at_rest", points, self.name) + growth)

    def null_space(self) -> tuple[Unobservable, ...]:
        found = [
            Unobservable("growth", "term", ("level",), _LEVEL),
            Unobservable("growth", "term", ("other powers",), _LAW),
            Unobservable("at_rest", "term", ("form of the artefact",), _ARTEFACT),
        ]
        if 0 not in self.powers:
            found.append(Unobservable("at_rest", "term", ("all of it",), _NO_LEVEL))
        return tuple(found)

    def _solved(self, readings: ArrayLike, stated: float | None, history: History) -> Separation:
        array = self._checked(readings)
        fits = self._fits(array, math.nan if stated is None else stated)
        parts, u = self._parts(array, fits)
        return Separation(
            self.name,
            parts,
            u,
            dict.fromkeys(parts, self.unit),
            {"speed": np.array(self.speeds, dtype=np.float64)},
            self.null_space(),
            noise=self._noise([f for f in fits if f], stated),
            audit=self._audit(fits),
            messages=tuple(_growth_messages(fits)),
            history=(*history, Step(self.name, {"powers": list(self.powers)})),
        )

    def _like_readings(self, model: FloatArray, readings: FloatArray) -> FloatArray:
        """Return the model as it is: repeats are further speeds."""
        return model

    def _checked(self, readings: ArrayLike) -> FloatArray:
        array = as_numbers(readings, f"{self.name} needs readings as numbers")
        if array.ndim != 2 or array.shape[0] != len(self.speeds) or 0 in array.shape:
            raise InvalidSamplesError(
                f"{self.name}: there are {len(self.speeds)} speeds; the readings need the shape "
                f"({len(self.speeds)}, values), got {array.shape}"
            )
        if np.isinf(array).any():
            row, column = np.argwhere(np.isinf(array))[0]
            raise InvalidSamplesError(
                f"{self.name}: the reading of value {column} at {self.speeds[row]:.6g} rev/s is "
                "infinite; what was not measured is NaN"
            )
        return array

    def _fits(self, array: FloatArray, u: float) -> list[SpeedFit | None]:
        """Return the fit of each value; None where too few readings or speeds are left."""
        speeds, powers = np.array(self.speeds, dtype=np.float64), tuple(self.powers)
        order = np.argsort(speeds, kind="stable")
        fits: list[SpeedFit | None] = []
        for k, column in enumerate(array.T):
            used = order[~np.isnan(column[order])]
            at, sd = speeds[used], np.full(used.size, u)
            enough = used.size > len(powers) and np.unique(at).size >= len(powers)
            fit = (
                fit_values(f"value {k}", at, column[used], sd, powers, self.unit)
                if enough
                else None
            )
            fits.append(fit)
        if not any(fits):
            raise TooFewSamplesError(
                f"{self.name}: no value has readings at enough speeds: {len(powers)} powers need "
                f"{len(powers) + 1} readings at {len(powers)} speeds"
            )
        return fits

    def _parts(
        self, array: FloatArray, fits: list[SpeedFit | None]
    ) -> tuple[dict[str, FloatArray], dict[str, FloatArray]]:
        """Return both parts and their uncertainties."""
        speeds = np.array(self.speeds, dtype=np.float64)
        growing = np.array([p > 0 for p in self.powers])
        basis = speeds[:, np.newaxis] ** np.array(self.powers, dtype=np.float64)[growing]
        at_rest, u_rest = np.full((2, array.shape[1]), np.nan)
        growth, u_growth = np.full((2, *array.shape), np.nan)
        for k, fit in enumerate(fits):
            if fit is None:
                continue
            block = fit.covariance[np.ix_(growing, growing)]
            variance = np.einsum("ij,jk,ik->i", basis, block, basis)
            measured = ~np.isnan(array[:, k])
            growth[measured, k] = (basis @ fit.coefficients[growing])[measured]
            u_growth[measured, k] = np.sqrt(np.maximum(variance, 0.0))[measured]
            if not growing.all():
                zero = int(np.argmin(growing))
                at_rest[k] = fit.coefficients[zero]
                u_rest[k] = math.sqrt(max(float(fit.covariance[zero, zero]), 0.0))
        return {"at_rest": at_rest, "growth": growth}, {"at_rest": u_rest, "growth": u_growth}

    def _noise(self, fits: list[SpeedFit], stated: float | None) -> Quantity:
        if stated is not None:
            return as_stated(stated, self.unit)
        degrees = sum(f.degrees for f in fits)
        value = math.sqrt(sum(float(f.residual @ f.residual) for f in fits) / degrees)
        text = "standard deviation of one reading, from the residuals (type A)"
        return type_a(value, self.unit, text, degrees)

    def _audit(self, fits: list[SpeedFit | None]) -> dict[str, object]:
        audit: dict[str, object] = {
            "n_recordings": len(self.speeds),
            "powers": list(self.powers),
            "degrees_of_freedom": [None if f is None else f.degrees for f in fits],
            "p_fit": [None if f is None or math.isnan(f.p_fit) else f.p_fit for f in fits],
            "peaks_rev_per_s": [[] if f is None else list(f.peaks) for f in fits],
        }
        for power in self.powers:
            unit = self.unit if power == 0 else f"{self.unit}_s{power}"
            terms = [None if f is None else f.coefficient(power) for f in fits]
            audit[f"c{power}_{unit}"] = [None if q is None else q.value for q in terms]
            audit[f"u_c{power}_{unit}"] = [None if q is None else q.u for q in terms]
        return audit


def _growth_messages(fits: list[SpeedFit | None]) -> list[str]:
    said = []
    for k, fit in enumerate(fits):
        if fit is None:
            said.append(f"value {k} has readings at too few speeds: it is NaN")
            continue
        if fit.p_fit < _DOUBT:
            said.append(
                f"the polynomial does not describe value {k} (p = {fit.p_fit:.1g}): a resonance, "
                "or u_reading holds too little; u was widened"
            )
        if fit.peaks:
            at = ", ".join(f"{s:.4g}" for s in fit.peaks)
            said.append(f"value {k} stands out at {at} rev/s: a resonance is not in the powers")
    return said


# ---- `SpeedFit`: a polynomial in speed through one value of spindle tests, with confidence and peaks ----

_PEAK = 4.0
"""Residual in its standard deviations from which a speed is called a peak."""


@dataclass(frozen=True, slots=True, eq=False, repr=False)
class SpeedFit(StoredResult):
    """Polynomial in speed through one value; frozen.

    Parameters
    ----------
    symbol : str
        Which value of the table.
    values, u : ndarray, shape (n,), m or rad
        The value at each speed and its standard uncertainty (NaN where not known).
    powers : tuple of int
        Powers of the speed.
    coefficients : ndarray, shape (p,), unit per (rev/s)^power
        Of the powers.
    covariance : ndarray, shape (p, p)
        Of the coefficients, scaled by the residuals where these exceed the uncertainties.
    residual : ndarray, shape (n,), m or rad
        Value minus fit.
    degrees : int
        Degrees of freedom of the residuals.
    chi_squared : float
        Sum of squared residuals over their uncertainties; NaN where these are not known.
    p_fit : float
        Probability of a larger one if the polynomial is right; NaN where not known.
    peaks : tuple of float, rev/s
        Speeds whose value lies above the fit through the others by more than 4 standard
        deviations.
    unit : str
        Of the values.
    """

    symbol: str
    values: FloatArray
    u: FloatArray
    powers: tuple[int, ...]
    coefficients: FloatArray
    covariance: FloatArray
    residual: FloatArray
    degrees: int
    chi_squared: float
    p_fit: float
    peaks: tuple[float, ...]
    unit: str

    def __str__(self) -> str:
        terms = [self.coefficient(p) for p in self.powers]
        text = " + ".join(
            format_engineering(q.value, self.unit)
            if p == 0
            else f"({q.value:.4g} \u00b1 {q.u:.2g}) {self.unit} n^{p}"
            for p, q in zip(self.powers, terms, strict=True)
        )
        fit = "" if math.isnan(self.p_fit) else f", p of the fit {self.p_fit:.2g}"
        return f"{text}{fit}"

    def __repr__(self) -> str:
        return f"SpeedFit({self.symbol}, {self.values.size} values: {self})"

    def evaluate(self, speed: ArrayLike) -> FloatArray:
        """Return the fit.

        Parameters
        ----------
        speed : array_like, rev/s
            Where.

        Returns
        -------
        ndarray
            Of the shape of `speed`, in the unit of the values.
        """
        return _basis(np.asarray(speed, dtype=np.float64), self.powers) @ self.coefficients

    @described_by(evaluate)
    def half_width(self, speed: ArrayLike, *, confidence: float = 0.95) -> FloatArray:
        """Return the half width of the confidence interval of the fit.

        Parameters
        ----------
        confidence : float, 0 to 1, optional
            Two-sided.

        Returns
        -------
        ndarray
            Of the shape of `speed`; pointwise, Student's t.

        Raises
        ------
        DataError
            If the confidence does not lie between 0 and 1.
        """
        if not 0.0 < confidence < 1.0:
            raise DataError(f"confidence must lie between 0 and 1, got {confidence}")
        from scipy.special import stdtrit

        rows = _basis(np.asarray(speed, dtype=np.float64), self.powers)
        variance = np.einsum("...i,ij,...j->...", rows, self.covariance, rows)
        factor = float(stdtrit(self.degrees, 0.5 + 0.5 * confidence))
        return np.asarray(factor * np.sqrt(variance))

    def coefficient(self, power: int) -> Quantity:
        """Return one coefficient with its uncertainty.

        Parameters
        ----------
        power : int
            Power of the speed.

        Returns
        -------
        Quantity
            In the unit of the values times s^power.

        Raises
        ------
        DataError
            If the power is not in the fit.
        """
        if power not in self.powers:
            raise DataError(f"power {power} is not among {self.powers}")
        i = self.powers.index(power)
        unit = self.unit if power == 0 else f"{self.unit} s^{power}"
        return Quantity(
            float(self.coefficients[i]),
            unit,
            f"coefficient of speed^{power} (rev/s) of the {self.symbol} value",
            u=math.sqrt(float(self.covariance[i, i])),
            symbol=f"c{power}",
        )


def _basis(speed: FloatArray, powers: tuple[int, ...]) -> FloatArray:
    return np.stack([speed**p for p in powers], axis=-1)


def fit_values(
    name: str,
    speed: FloatArray,
    values: FloatArray,
    u: FloatArray,
    powers: tuple[int, ...],
    unit: str,
) -> SpeedFit:
    """Return the weighted least-squares polynomial through values of one kind.

    Parameters
    ----------
    name : str
        Symbol of the value.
    speed : ndarray, shape (n,), rev/s
        Rising.
    values, u : ndarray, shape (n,), m or rad
        Values and standard uncertainties; equal weights unless all u are positive.
    powers : tuple of int
        Of the speed.
    unit : str
        Of the values.

    Returns
    -------
    SpeedFit
        Coefficients, covariance, lack of fit, peaks.

    Raises
    ------
    TooFewSamplesError
        If there are not more values than powers.
    DegenerateFitError
        If there are fewer different speeds than powers.
    """
    degrees = values.size - len(powers)
    if degrees < 1:
        raise TooFewSamplesError(
            f"{values.size} recordings for {len(powers)} powers: need at least {len(powers) + 1}"
        )
    if np.unique(speed).size < len(powers):
        raise DegenerateFitError(
            f"{np.unique(speed).size} different speeds do not determine {len(powers)} powers"
        )
    known = bool((u > 0.0).all())
    weight = 1.0 / u if known else np.ones(values.size)
    scale = max(float(speed.max()), np.finfo(float).tiny) ** np.array(powers, dtype=np.float64)
    rows = weight[:, None] * _basis(speed, powers) / scale
    inverse = np.asarray(np.linalg.pinv(rows.T @ rows), dtype=np.float64)
    coefficients = inverse @ (rows.T @ (weight * values))
    rest: FloatArray = weight * values - rows @ coefficients
    rounding = 1e3 * float(np.finfo(float).eps) * float(np.abs(weight * values).max())
    squares = float(rest @ rest)
    factor = squares / degrees
    if known:
        factor = max(factor, 1.0)
    floor = max(1.0, rounding) if known else rounding
    peaks = _peaks(speed, rows, rest, inverse, degrees, floor=floor)
    p_fit = math.nan
    if known:
        from scipy.special import chdtrc

        p_fit = float(chdtrc(degrees, squares))
    for array in (values, u):
        array.setflags(write=False)
    return SpeedFit(
        symbol=name,
        values=values,
        u=u,
        powers=powers,
        coefficients=coefficients / scale,
        covariance=factor * inverse / np.outer(scale, scale),
        residual=rest / weight,
        degrees=degrees,
        chi_squared=squares if known else math.nan,
        p_fit=p_fit,
        peaks=peaks,
        unit=unit,
    )


def _peaks(
    speed: FloatArray,
    rows: FloatArray,
    rest: FloatArray,
    inverse: FloatArray,
    degrees: int,
    *,
    floor: float,
) -> tuple[float, ...]:
    """Return speeds whose residual, studentised without themselves, is beyond the limit.

    `floor` is the least standard deviation of a weighted residual.
    """
    if degrees < 3:
        return ()
    lever = np.einsum("ij,jk,ik->i", rows, inverse, rows)
    free = np.maximum(1.0 - lever, 1e-12)
    others = np.maximum(float(rest @ rest) - rest**2 / free, 0.0) / (degrees - 1)
    sd = np.maximum(np.sqrt(others), max(floor, np.finfo(float).tiny))
    return tuple(float(s) for s in speed[rest > _PEAK * sd * np.sqrt(free)])
