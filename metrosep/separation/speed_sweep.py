"""Spindle error motion against speed: polynomial fits with bands, and resonances made visible.

Synchronous motion below the first resonance follows a + b n^2 (unbalance, dynamic stiffness) or is
constant; near a resonance it leaves any low polynomial. `fit_speed_sweep` says both, with the order
of rotation that a hinted natural frequency would excite.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from metrosep.core._arrays import FloatArray, frozen_float
from metrosep.core.errors import (
    DataError,
    InvalidSamplesError,
    UnitError,
)
from metrosep.core.profile import html_table
from metrosep.separation._real_numbers import real_numbers
from metrosep.separation._result_values import plain, reduced
from metrosep.separation.planner_checks import positive
from metrosep.separation.speed_fit import SpeedFit, fit_values
from metrosep.separation.spindle_result import SpindleMotion

__all__ = ["SpeedSweep", "fit_speed_sweep"]


_FASTEST = 2e3
"""rev/s beyond which the speed is doubted: 120 000 rev/min. Air turbines above are rare, speeds typed
in rev/min are not."""

_DOUBT = 0.01
"""p of the lack of fit below which it is told."""


@dataclass(frozen=True, slots=True, eq=False, repr=False)
class SpeedSweep:
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

    def __reduce__(self) -> tuple[Any, ...]:
        return reduced(self)

    def to_dict(self) -> dict[str, Any]:
        """Return plain values for JSON, SI, NaN as None.

        Returns
        -------
        dict
            ``speed`` in rev/s, ``fits`` by symbol, ``natural_frequency``, ``critical``, ``audit``,
            ``messages``.
        """
        return {
            "speed": plain(self.speed),
            "fits": {name: fit.to_dict() for name, fit in self.fits.items()},
            "natural_frequency": plain(self.natural_frequency),
            "critical": plain(self.critical),
            "audit": plain(self.audit),
            "messages": list(self.messages),
        }

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
    powers : sequence of int, optional
        Of the polynomial; (0, 2) by default.
    symbols : sequence of str, optional
        Values of the table to fit, where results are given.
    natural_frequency : float, Hz, optional
        Of spindle or mount, to name the speeds whose orders excite it.
    orders : sequence of int, optional
        Orders k tried against the natural frequency.

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
        natural_frequency = positive(natural_frequency, "the natural frequency", "Hz")
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


def _whole(values: Sequence[int], name: str, *, least: int) -> tuple[int, ...]:
    try:
        found = tuple(values)
        numbers = tuple(int(v) for v in found)
    except (TypeError, ValueError, OverflowError):
        raise DataError(
            f"{name} must be a sequence of whole numbers from {least}, got {values!r}"
        ) from None
    if numbers != found or (numbers and min(numbers) < least):
        raise DataError(f"{name} must be whole numbers from {least}, got {found}")
    return numbers


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
    columns: dict[str, tuple[FloatArray, FloatArray, str]] = {}
    if isinstance(results, Mapping):
        if u is not None and not isinstance(u, Mapping):
            raise DataError(
                f"u= must be a mapping such as {{{next(iter(results), 'synchronous')!r}: [...]}}, got {type(u).__name__}"
            )
        given = u or {}
        unknown = sorted(set(given) - set(results))
        if unknown:
            raise DataError(f"u= names {', '.join(unknown)}, which has no values")
        for name, values in results.items():
            sd = given.get(name, np.full(size, np.nan))
            columns[name] = (_column(values, name, size), _column(sd, f"u of {name}", size), "m")
        missing = [name for name, (values, _, _) in columns.items() if np.isnan(values).any()]
        if missing:
            raise InvalidSamplesError(f"{', '.join(missing)} is NaN: leave those recordings out")
        return columns
    if u is not None:
        raise DataError("u= belongs to arrays; results carry theirs")
    listed: Any = results
    if not isinstance(listed, list | tuple) or not all(
        isinstance(r, SpindleMotion) for r in listed
    ):
        raise DataError(
            f"results must be SpindleMotion objects, or values by symbol such as "
            f"{{'synchronous': [...]}}; got {type(results).__name__}"
        )
    unknown = [name for name in symbols if any(name not in r.table for r in results)]
    if unknown:
        raise DataError(f"the results hold no value {', '.join(map(str, unknown))}")
    if len({(r.direction, r.sensitive) for r in results}) > 1:
        raise DataError("the recordings are of different directions: fit them apart")
    for name in symbols:
        rows = [r.table[name] for r in results]
        sd = [math.nan if q.u is None else q.u for q in rows]
        unit = rows[0].unit if rows else "m"
        columns[name] = (
            _column([q.value for q in rows], name, size),
            _column(sd, f"u of {name}", size),
            unit,
        )
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
            said += _orders_near(fit.peaks, speed, critical)
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


def _orders_near(
    peaks: tuple[float, ...], speed: FloatArray, critical: Mapping[int, float]
) -> list[str]:
    said = []
    spacing = float(np.median(np.diff(np.unique(speed))))
    for peak in peaks:
        near = [k for k, s in critical.items() if abs(s - peak) <= spacing]
        if near:
            orders = " or ".join(f"k={k}" for k in near)
            said.append(f"at {peak:.4g} rev/s the natural frequency is met by {orders}")
    return said
