"""Periodic error of an interferometer: the harmonics of the fringe in a reading."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np
from numpy.typing import ArrayLike, NDArray

from metrosep.core._arrays import ComplexArray, FloatArray
from metrosep.core.docs import described_by
from metrosep.core.errors import (
    DataError,
    InvalidSamplesError,
    NotSeparableError,
    TooFewSamplesError,
    UnitError,
)
from metrosep.core.methods import RoleColumns
from metrosep.core.numbers import real
from metrosep.core.options import Option, option
from metrosep.core.provenance import Step
from metrosep.core.quantity import Quantity
from metrosep.core.units import parse_unit
from metrosep.separation._readings import as_numbers, given_parts
from metrosep.separation.contract import History, Parts, RecordedMethod, Separation, Unobservable

_WORST_CONDITION = 1e4
"""Of the scaled design: beyond it a harmonic cannot be distinguished from the trend or from another."""

_NEIGHBOURS = np.array([-6, -5, -4, -3, -2, 2, 3, 4, 5, 6])
"""Lines beside a harmonic, in cycles over the travel, that show the noise there."""

_LEAST_PERIODS = 12
_CLEAR = 5.0
"""Times its uncertainty, and of the largest one: a harmonic that is there."""

_NOT_PART = (
    "what the part or the stage has at these wavelengths looks the same: measure again with the part "
    "moved by a fraction of the fringe"
)


@dataclass(frozen=True, slots=True)
class FringeError(RecordedMethod):
    """Harmonics of the fringe in readings at known positions.

    One row of readings, shape (1, n). Parts: ``corrected``, the reading without the error, and
    ``periodic``; ``harmonics["periodic"]``.

    Parameters
    ----------
    x : tuple of float, m
        Position of each reading, from the interferometer.
    unit : str, optional
        SI unit of the readings.

    Raises
    ------
    DataError
        If period, harmonics or degree cannot be used.
    UnitError
        If the unit is not one of SI.
    """

    x: tuple[float, ...]
    period: float = option(
        kind="size",
        help="length of one fringe: half the wavelength for single pass, a quarter for double pass",
    )
    harmonics: int = option(
        2,
        kind="integer",
        help="highest harmonic; 2 holds offset (1), and amplitude and quadrature (2)",
    )
    degree: int = option(
        1,
        kind="integer",
        help="degree of the polynomial that the reading follows without periodic error; it stays "
        "in it",
    )
    unit: str = "m"

    name = "periodic_error"
    what = "periodic error of an interferometer in a reading"
    reads = "table"
    roles: ClassVar[Mapping[str, str]] = {"position": "length", "reading": "position"}
    arguments: ClassVar[Mapping[str, Option]] = {
        "u_reading": Option(
            "limit", help="standard uncertainty of one reading; from the residual if omitted"
        )
    }
    truth_parts = ("corrected",)
    error_parts = ("periodic",)

    @property
    def _dimension(self) -> str | None:
        return {"m": "length", "rad": "angle"}.get(self.unit)

    @classmethod
    def from_inputs(cls, data: RoleColumns, options: Mapping[str, Any]) -> Separation:
        """Return the periodic share of the column of readings."""
        values, unit = data.values, data.units.get("reading", "m")
        return periodic_error(values["position"], values["reading"], unit=unit, **options)

    def __post_init__(self) -> None:
        period = real(self.period, "periodic_error: period", what="a length in m", finite=False)
        if not (math.isfinite(period) and period > 0.0):
            raise DataError(f"periodic_error: period is {self.period} m; it must be positive")
        for name, value in (("harmonics", self.harmonics), ("degree", self.degree)):
            number = real(value, f"periodic_error: {name}", what="a whole number")
            if number != int(number):
                raise DataError(f"periodic_error: {name} is {value}; it must be a whole number")
            object.__setattr__(self, name, int(number))
        if parse_unit(self.unit).factor != 1.0:
            raise UnitError(
                f"periodic_error: unit is {self.unit!r}; give readings in an SI unit (m, rad, V)"
            )
        if not 1 <= self.harmonics <= 50 or not 0 <= self.degree <= 9:
            raise DataError(
                f"periodic_error: harmonics is {self.harmonics} (1 to 50), degree {self.degree} "
                "(0 to 9)"
            )

    def simulate(self, truth: Parts, errors: Parts) -> FloatArray:
        parts = given_parts(self, truth, errors)
        return np.asarray(sum(parts.values()))[None, :]

    def null_space(self) -> tuple[Unobservable, ...]:
        return self._null_space(self._hidden(self._positions()))

    def _solved(self, readings: ArrayLike, stated: float | None, history: History) -> Separation:
        x, z = self._positions(), _row(readings, len(self.x))
        good = ~np.isnan(z)
        n_unknown = self.degree + 1 + 2 * self.harmonics
        if good.sum() < n_unknown + 1:
            raise TooFewSamplesError(
                f"periodic_error: {int(good.sum())} readings for {n_unknown} unknowns; at least "
                f"{n_unknown + 1} are needed"
            )
        hidden = self._hidden(x[good])
        shown = [k for k in range(1, self.harmonics + 1) if k not in hidden]
        if not shown:
            raise NotSeparableError(
                f"periodic_error: no harmonic of {self.period:.6g} m can be distinguished from a polynomial of "
                f"degree {self.degree} over {float(np.ptp(x[good])):.3g} m at these positions; measure "
                "over more fringes, with steps that are not multiple of one, or in other units "
                "(positions in m?)"
            )
        fit = _Fit(x, z, good, self.period, self.degree, shown)
        return self._result(fit, hidden, stated, history)

    def _positions(self) -> FloatArray:
        x = np.array(self.x, dtype=np.float64)
        if not np.isfinite(x).all():
            raise InvalidSamplesError("periodic_error: a position is not finite")
        return x

    def _hidden(self, x: FloatArray) -> list[int]:
        """Return harmonics that trend or lower harmonics imitate at these positions."""
        trend = _trend(x, self.degree)
        kept: list[FloatArray] = []
        hidden = []
        for k in range(1, self.harmonics + 1):
            pair = _pair(x, self.period, k)
            columns = np.column_stack([trend, *kept, pair])
            sizes = np.linalg.norm(columns, axis=0)
            singular = np.linalg.svd(columns / np.maximum(sizes, 1e-300), compute_uv=False)
            small = sizes[-2:].min() < 1e-6 * math.sqrt(max(x.size, 1))
            if small or singular[-1] * _WORST_CONDITION < singular[0] or x.size < columns.shape[1]:
                hidden.append(k)
            else:
                kept.append(pair)
        return hidden

    def _null_space(self, hidden: list[int]) -> tuple[Unobservable, ...]:
        waves = tuple(self.period / k for k in range(1, self.harmonics + 1))
        out = [
            Unobservable(
                "periodic",
                "harmonic",
                (0,),
                "a constant error of position is an offset of the zero",
            ),
            Unobservable("corrected", "wavelength", waves, _NOT_PART),
        ]
        if hidden:
            why = (
                "at these positions trend or a lower harmonic take the same values: too few fringes, or "
                "steps that are a multiple of the fringe"
            )
            out.append(Unobservable("periodic", "harmonic", tuple(hidden), why))
        return tuple(out)

    def _result(
        self, fit: _Fit, hidden: list[int], stated: float | None, history: tuple[Step, ...]
    ) -> Separation:
        spread = fit.spread if stated is None else stated
        coefficients = np.full(self.harmonics + 1, np.nan + 1j * np.nan)
        u = np.full(self.harmonics + 1, np.nan)
        excess = []
        for k in fit.harmonics:
            value, white = fit.coefficient(k)
            local = fit.noise_beside(k) if stated is None else math.nan
            coefficients[k] = value
            u[k] = max(spread * white, local if math.isfinite(local) else 0.0)
            if u[k] > 1.5 * spread * white:
                excess.append(k)
        messages = _period_doubts(coefficients, u, self.period)
        if fit.n_periods > fit.good.sum():
            messages.append(
                f"{fit.n_periods:.4g} fringes for {int(fit.good.sum())} readings: are positions and "
                "period both in m?"
            )
        if hidden:
            messages.append(
                f"harmonics {', '.join(map(str, hidden))} are hidden at these positions; NaN"
            )
        if excess:
            messages.append(
                f"the residual is not white: beside harmonics {', '.join(map(str, excess))} it is "
                "larger than its mean, and their u follows it"
            )
        if stated is None and not math.isfinite(fit.noise_beside(fit.harmonics[0])):
            messages.append(
                f"fewer than {_LEAST_PERIODS} fringes: the residual is taken as white, which may make u "
                "too small"
            )
        scale, suffix = (1e9, "nm") if self.unit == "m" else (1.0, self.unit)
        audit: dict[str, Any] = {
            "period_nm": 1e9 * self.period,
            "n_fringes": fit.n_periods,
            "degree": self.degree,
            "removed": "nothing: the polynomial stays in the corrected reading",
            f"amplitudes_{suffix}": [float(scale * abs(coefficients[k])) for k in fit.harmonics],
            f"u_amplitudes_{suffix}": [float(scale * u[k]) for k in fit.harmonics],
            "phases_rad": [float(np.angle(coefficients[k])) for k in fit.harmonics],
            "harmonics": list(fit.harmonics),
        }
        text = "standard uncertainty of one reading, as stated"
        if stated is None:
            text = f"standard deviation of the residual (type A, {fit.freedom} d.o.f.)"
        noise = Quantity(spread, self.unit, text, symbol="s")
        step = Step(self.name, {"period_m": self.period, "harmonics": self.harmonics})
        u_parts = {n: spread * np.sqrt(v) for n, v in fit.variances().items()}
        return Separation(
            self.name,
            {"corrected": fit.z - fit.periodic, "periodic": fit.periodic},
            {"corrected": u_parts["corrected"], "periodic": u_parts["periodic"]},
            {"corrected": self.unit, "periodic": self.unit},
            {"x": fit.x},
            self._null_space(hidden),
            noise=noise,
            harmonics={"periodic": coefficients},
            harmonics_u={"periodic": u},
            audit=audit,
            messages=tuple(messages),
            history=(*history, step),
        )


@described_by(FringeError, errors=False)
def periodic_error(
    position: ArrayLike,
    reading: ArrayLike,
    *,
    period: float,
    harmonics: int = 2,
    degree: int = 1,
    u_reading: float | None = None,
    unit: str = "m",
) -> Separation:
    """Return amplitude and phase of the fringe's harmonics in a reading, and the reading without.

    Parameters
    ----------
    position : array_like, shape (n,), m
        From the interferometer, in any order.
    reading : array_like, shape (n,)
        Its deviation from a reference, or from the commanded position; NaN = not measured.

    Returns
    -------
    Separation
        ``.corrected`` and ``.periodic`` at the positions; ``harmonics["periodic"]`` has complex c_k
        of ``Re(c_k exp(2 pi j k x / period))``, ``harmonics_u`` the uncertainty of real and
        imaginary part, the audit amplitudes and phases.

    Raises
    ------
    DataError, InvalidSamplesError, TooFewSamplesError, NotSeparableError, UnitError
        If lengths differ, the unit is not one of SI, values are not finite, or no harmonic can be distinguished from the polynomial.

    Notes
    -----
    Least squares of ``polynomial + sum Re(c_k exp(j k theta))``. An offset e of a quadrature signal
    of radius R gives a first harmonic of the phase with amplitude ``e/R`` rad, a ratio of
    amplitudes 1 + g a second one with ``g/2``, a quadrature error of b rad one with ``b/2``; in
    length each is multiplied by ``period / (2 pi)``.

    The uncertainty of a harmonic is that of white noise, or, where more than 12 fringes were
    passed, that of the residual's spectrum beside it, whichever is larger.

    References
    ----------
    P. L. M. Heydemann, Determination and correction of quadrature fringe measurement errors in
    interferometers, Applied Optics 20 (1981) 3382-3384.

    Examples
    --------
    >>> import numpy as np
    >>> x = np.linspace(0, 5e-6, 500)
    >>> error = 2e-9 * np.cos(2 * np.pi * x / 316.5e-9 - 0.5)
    >>> result = periodic_error(x, 1e-3 * x + error, period=316.5e-9)
    >>> [round(a, 6) for a in result.audit["amplitudes_nm"]], round(result.audit["phases_rad"][0], 6)
    ([2.0, 0.0], -0.5)
    """
    x = as_numbers(position, "periodic_error: positions must be numbers in m")
    z = as_numbers(reading, "periodic_error: readings must be real numbers")
    if x.ndim != 1 or z.shape != x.shape:
        raise DataError(
            f"periodic_error needs positions and readings of one length, got {x.shape} and {z.shape}"
        )
    length = real(period, "periodic_error: period", dimension="length", finite=False)
    method = FringeError(tuple(x.tolist()), length, harmonics, degree, unit)
    return method.separate(z[None, :], u_reading=u_reading)


class _Fit:
    """Least squares of polynomial and harmonics."""

    def __init__(
        self,
        x: FloatArray,
        z: FloatArray,
        good: NDArray[np.bool_],
        period: float,
        degree: int,
        harmonics: list[int],
    ) -> None:
        self.x, self.z, self.good, self.period, self.harmonics = x, z, good, period, harmonics
        self.waves = np.column_stack([_pair(x, period, k) for k in harmonics])
        trend = _trend(x, degree)
        self.n_trend = trend.shape[1]
        self.design = np.column_stack([trend, self.waves])
        used = self.design[good]
        self.covariance = np.linalg.inv(used.T @ used)
        self.found = np.linalg.lstsq(used, z[good], rcond=None)[0]
        self.residual = z - self.design @ self.found
        self.freedom = int(good.sum()) - self.design.shape[1]
        self.spread = math.sqrt(float(np.sum(self.residual[good] ** 2)) / self.freedom)
        self.periodic = self.waves @ self.found[self.n_trend :]
        self.n_periods = float(np.ptp(x[good])) / period

    def coefficient(self, k: int) -> tuple[complex, float]:
        """Return c_k and the uncertainty of its parts for noise of one."""
        at = self.n_trend + 2 * self.harmonics.index(k)
        a, b = self.found[at : at + 2]
        variance = np.diag(self.covariance)[at : at + 2].mean()
        return complex(a, -b), math.sqrt(float(variance))

    def noise_beside(self, k: int) -> float:
        """Return the RMS of the parts of the residual's lines beside a harmonic."""
        if self.n_periods < _LEAST_PERIODS:
            return math.nan
        x, r = self.x[self.good], self.residual[self.good]
        lines = (k + _NEIGHBOURS / self.n_periods) / self.period
        sums = 2.0 / r.size * (np.exp(-2j * np.pi * np.outer(lines, x - x.min())) @ r)
        return math.sqrt(float(np.mean(np.abs(sums) ** 2)) / 2.0)

    def variances(self) -> dict[str, FloatArray]:
        """Return the variance of both parts for noise of one; NaN where not measured."""
        block = self.covariance[self.n_trend :]
        periodic = np.einsum("ni,ij,nj->n", self.waves, block[:, self.n_trend :], self.waves)
        own = np.einsum("ni,ij,nj->n", self.waves, block, self.design)
        corrected = np.where(self.good, 1.0 - 2.0 * own + periodic, np.nan)
        return {"corrected": np.maximum(corrected, 0.0), "periodic": np.maximum(periodic, 0.0)}


def _period_doubts(coefficients: ComplexArray, u: FloatArray, period: float) -> list[str]:
    """Say it where only multiples of one harmonic are there: the fringe may be that much shorter."""
    sizes = np.abs(np.nan_to_num(coefficients))
    seen = np.flatnonzero((sizes > _CLEAR * np.nan_to_num(u)) & (sizes > sizes.max() / _CLEAR))
    common = int(np.gcd.reduce(seen)) if seen.size else 1
    if common < 2:
        return []
    text = (
        f"harmonic {common} dominates those below it: if the period given ({1e9 * period:.6g} nm) is "
        f"the wavelength or another multiple of the fringe, give period={period / common:.6g} (half "
        "the wavelength for single pass, a quarter for double pass); else unequal amplitudes or a "
        "wrong phase of the signals make it"
    )
    return [text]


def _row(readings: ArrayLike, n: int) -> FloatArray:
    z = as_numbers(readings, "periodic_error: the readings must be real numbers")
    if z.shape != (1, n):
        raise DataError(f"periodic_error needs readings of the shape (1, {n}), got {z.shape}")
    if np.isinf(z).any():
        raise InvalidSamplesError("periodic_error: a reading is infinite; mark it as NaN")
    return np.asarray(z[0])


def _trend(x: FloatArray, degree: int) -> FloatArray:
    from numpy.polynomial.legendre import legvander

    half = max(float(np.ptp(x)) / 2.0, np.finfo(np.float64).tiny) if x.size else 1.0
    middle = (float(x.max()) + float(x.min())) / 2.0 if x.size else 0.0
    return np.asarray(legvander((x - middle) / half, degree))


def _pair(x: FloatArray, period: float, k: int) -> FloatArray:
    theta = 2.0 * np.pi * k * (x / period)
    return np.column_stack([np.cos(theta), np.sin(theta)])
