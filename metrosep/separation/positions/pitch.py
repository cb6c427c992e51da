"""Errors of an axis along itself for a pitch table: slope kept, zero at the reference, held at 20 degC."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from metrosep.core._arrays import FloatArray
from metrosep.core.errors import DataError
from metrosep.core.numbers import choice, flag, not_negative, quantity

__all__ = ["PitchErrors", "pitch_errors"]

_STANDARD = 293.15
"""Temperature at which lengths hold, K (ISO 1)."""
_U_EXPANSION, _U_TEMPERATURE = 1e-6, 0.5
"""Standard uncertainties where nobody states them, 1/K and K."""
_TEMPERATURES, _EXPANSIONS = (273.15, 323.15), (-1e-6, 40e-6)
"""Range of a workshop, K, and of materials, 1/K: beyond it a unit is mistaken."""
_SPLIT = 2.0
"""Lost motion goes into the table if it exceeds so many standard uncertainties of its mean."""


@dataclass(frozen=True, repr=False)
class PitchErrors:
    """Errors of an axis at its targets, zero at the reference; frozen, SI.

    Parameters
    ----------
    positions : ndarray, shape (m,), m or rad
        Targets, rising.
    forward, reverse : ndarray or None, shape (m,), m or rad
        Mean error actual - nominal of each direction; one zero for both.
    reference : float, m or rad
        Where the error of the reference direction is zero.
    zero_removed : float, m or rad
        What was taken off both directions for that.
    expansion_removed : float
        Slope taken off as expansion, m/m; 0 if none was stated.
    u_slope : float or None
        Standard uncertainty of that slope, m/m; None if no temperature was stated.
    lost_motion, u_lost_motion : float or None, m or rad
        Mean of forward - reverse over the targets, and its standard uncertainty from the cycles;
        None in one direction, or of one cycle.
    messages : tuple of str
        What was assumed, and what is not known.
    """

    positions: FloatArray
    forward: FloatArray | None
    reverse: FloatArray | None
    reference: float
    zero_removed: float
    expansion_removed: float = 0.0
    u_slope: float | None = None
    lost_motion: float | None = None
    u_lost_motion: float | None = None
    messages: tuple[str, ...] = ()

    @property
    def has_lost_motion(self) -> bool:
        """Whether the lost motion exceeds two standard uncertainties, so that a table has two columns."""
        if self.lost_motion is None or self.u_lost_motion is None:
            return False
        return abs(self.lost_motion) > _SPLIT * self.u_lost_motion

    @property
    def slope(self) -> float:
        """Slope of the least-squares line through the errors of both directions, m/m."""
        ways = [v for v in (self.forward, self.reverse) if v is not None]
        return float(np.polyfit(np.tile(self.positions, len(ways)), np.concatenate(ways), 1)[0])

    def curve(self, direction: int = 1) -> Callable[[ArrayLike], FloatArray]:
        """Return the error of a direction as a function, linear between targets and held beyond them.

        Parameters
        ----------
        direction : {1, -1, 0}, optional
            0 is the mean of both, for a control with one column.

        Returns
        -------
        callable
            Error in m over position in m, for `CompensationTable.from_error`.

        Raises
        ------
        DataError
            If that direction was not measured.
        """
        columns = {1: (self.forward,), -1: (self.reverse,), 0: (self.forward, self.reverse)}
        if direction not in columns:
            raise DataError(f"direction is +1, -1 or 0 (the mean of both), got {direction!r}")
        found = [v for v in columns[direction] if v is not None]
        if len(found) < len(columns[direction]):
            raise DataError(
                f"direction {direction:+d} was not measured: take the direction that was, or measure "
                "both in one cycle"
            )
        values = np.mean(found, axis=0)

        def error(position: ArrayLike) -> FloatArray:
            return np.asarray(np.interp(np.asarray(position, float), self.positions, values))

        return error

    def u(self, u_shape: float = 0.0) -> FloatArray:
        """Return the standard uncertainty at the targets, the unknown expansion included.

        Parameters
        ----------
        u_shape : float, m, optional
            Of the readings themselves.

        Returns
        -------
        ndarray, shape (m,), m
            sqrt(u_shape^2 + (p - p_ref)^2 u(slope)^2).
        """
        away = (self.positions - self.reference) * (self.u_slope or 0.0)
        return np.asarray(np.hypot(u_shape, away))

    def __repr__(self) -> str:
        ways = " and ".join(n for n in ("forward", "reverse") if getattr(self, n) is not None)
        return f"<PitchErrors: {self.positions.size} targets, {ways}, slope {self.slope:.6g}>"


def pitch_errors(
    targets: ArrayLike,
    forward: ArrayLike | None,
    reverse: ArrayLike | None = None,
    *,
    values: str = "reached",
    deviation: str = "reached-minus-target",
    reference: float = 0.0,
    reference_direction: str = "forward",
    unit: str = "m",
    expansion: float | str | None = None,
    temperature: float | str | None = None,
    instrument_expansion: float | str = 0.0,
    instrument_temperature: float | str = _STANDARD,
    u_expansion: float | str | None = None,
    u_temperature: float | str | None = None,
    temperature_use: float | str | None = None,
    workpiece_expansion: float | str | None = None,
    already_corrected: bool = False,
    unusual: bool = False,
) -> PitchErrors:
    """Return the errors of an axis along itself, as a pitch table needs them.

    Parameters
    ----------
    targets : array_like, shape (m,), m or rad
        Target positions in any order, each once; m >= 3.
    forward, reverse : array_like, shape (m, n), m or rad, or None
        Readings of each direction, one column per cycle; NaN where not measured. One may be None.
    values : {"reached", "deviation"}, optional
        What the readings are.
    deviation : {"reached-minus-target", "target-minus-reached"}, optional
        Sense of deviations.
    reference : float, m or rad, optional
        Position at which the error is zero: the home position, within the targets.
    reference_direction : {"forward", "reverse", "middle"}, optional
        Direction in which the reference is reached.
    unit : {"m", "rad"}, optional
        Linear or rotary axis; a rotary axis takes no expansion.
    expansion, temperature : float or str, 1/K and K, optional
        Of the scale or of the part that holds the work, ``"11.5 ppm/K"``, ``"22.4 degC"``.
    instrument_expansion, instrument_temperature : float or str, 1/K and K, optional
        Of the instrument; a laser corrected for air has no expansion.
    u_expansion, u_temperature : float or str, 1/K and K, optional
        Standard uncertainties; 1e-6 / K and 0.5 K are assumed, and said, if omitted.
    temperature_use, workpiece_expansion : float or str, K and 1/K, optional
        Temperature at which the table will be used, and the expansion of what is made there; a
        workpiece expansion of 0 means right in metres at that temperature.
    already_corrected : bool, optional
        The instrument has reduced its readings to 20 degC.
    unusual : bool, optional
        Take temperatures outside 0 to 50 degC and coefficients outside -1e-6 to 40e-6 / K.

    Returns
    -------
    PitchErrors
        Slope kept, zero at the reference.

    Raises
    ------
    DataError
        If targets or readings do not fit, the reference lies outside the targets, or what is
        stated of the temperature is incomplete, contradictory or unusual.

    Notes
    -----
    e_20 = e - [a_m (T_m - 20) - a_r (T_r - 20)] (p - p_ref); for use at another temperature
    e_T = e_20 + (a_m - a_w)(T_use - 20)(p - p_ref); u(slope)^2 = (a_m u(T_m))^2 +
    ((T_m - 20) u(a_m))^2, and the same of the instrument.

    References
    ----------
    .. [1] ISO 230-2:2014; ISO 1:2022.
    .. [2] D. A. Swyt, Uncertainties in dimensional measurements made at nonstandard temperatures,
       J. Res. NIST 99 (1994) 31.

    Examples
    --------
    >>> found = pitch_errors([0.0, 0.1, 0.2], [[0.0], [2e-6], [4e-6]], values="deviation",
    ...                      expansion="10 ppm/K", temperature="21 degC")
    >>> (found.forward * 1e6).round(9).tolist()
    [0.0, 1.0, 2.0]
    """
    choice(values, "values", ("reached", "deviation"))
    choice(deviation, "deviation", ("reached-minus-target", "target-minus-reached"))
    choice(reference_direction, "reference_direction", ("forward", "reverse", "middle"))
    choice(unit, "unit", ("m", "rad"))
    p = np.asarray(targets, dtype=np.float64)
    if p.ndim != 1 or p.size < 3 or not np.isfinite(p).all():
        raise DataError(
            f"targets must be at least 3 finite positions in one list, got shape {p.shape}: fewer do "
            "not show an error between them"
        )
    order = np.argsort(p, kind="stable")
    p = p[order]
    twice = np.flatnonzero(np.diff(p) == 0)
    if twice.size:
        raise DataError(
            f"the target {p[twice[0]]:.9g} {unit} occurs more than once: give its readings as further "
            "columns (cycles) of one target"
        )
    sign = 1.0 if deviation == "reached-minus-target" or values == "reached" else -1.0
    off = p if values == "reached" else np.zeros(p.size)
    cycles = {
        name: None if v is None else sign * (_readings(v, name, p.size)[order] - off[:, None])
        for name, v in (("forward", forward), ("reverse", reverse))
    }
    means = {n: None if v is None else _mean(v, p, n, unit) for n, v in cycles.items()}
    step = float(np.median(np.diff(p)))
    for name, mean in means.items():
        if mean is not None and values == "reached" and np.abs(mean + p).max() < 0.01 * step:
            raise DataError(
                f"the {name} readings all lie within 1 % of a step of 0: they are deviations, not "
                'positions reached; say values="deviation"'
            )
    stated = _Expansion.of(
        unit, expansion, temperature, instrument_expansion, instrument_temperature, u_expansion,
        u_temperature, temperature_use, workpiece_expansion, flag(already_corrected, "already_corrected"),
        flag(unusual, "unusual"),
    )  # fmt: skip
    zero = quantity(reference, "reference", "length" if unit == "m" else "angle")
    if not p[0] <= zero <= p[-1]:
        raise DataError(
            f"the reference {zero:.9g} {unit} lies outside the targets {p[0]:.9g} ... {p[-1]:.9g} "
            f"{unit}: the error there is not known; state the home position, or measure there"
        )
    errors = {n: None if v is None else v - stated.slope * (p - zero) for n, v in means.items()}
    wanted = ("forward", "reverse") if reference_direction == "middle" else (reference_direction,)
    if any(errors[n] is None for n in wanted):
        raise DataError(
            f"reference_direction={reference_direction!r} needs readings of {' and '.join(wanted)}; "
            "take the direction that was measured"
        )
    offset = float(np.mean([np.interp(zero, p, errors[n]) for n in wanted]))  # type: ignore[arg-type]
    lost, u_lost, messages = _lost_motion(cycles["forward"], cycles["reverse"])
    return PitchErrors(
        p,
        *_zeroed(errors, offset),
        reference=zero,
        zero_removed=offset,
        expansion_removed=stated.slope,
        u_slope=stated.u,
        lost_motion=lost,
        u_lost_motion=u_lost,
        messages=(*stated.messages, *messages),
    )


def _zeroed(
    errors: dict[str, FloatArray | None], offset: float
) -> tuple[FloatArray | None, FloatArray | None]:
    """Return the errors of both directions less one zero."""
    up, down = errors["forward"], errors["reverse"]
    return None if up is None else up - offset, None if down is None else down - offset


@dataclass(frozen=True)
class _Expansion:
    slope: float  # what (23) and (24) take off, m/m
    u: float | None  # (25), m/m
    messages: tuple[str, ...]

    @classmethod
    def of(
        cls, unit: str, alpha: Any, warm: Any, alpha_r: Any, warm_r: Any, u_alpha: Any, u_warm: Any,
        use: Any, alpha_w: Any, done: bool, unusual: bool,
    ) -> _Expansion:  # fmt: skip
        """Return the slope that expansion explains, refused where it is half stated or unusual."""
        given = [v for v in (alpha, warm, use, alpha_w, u_alpha, u_warm) if v is not None]
        if unit == "rad":
            if given or done:
                raise DataError(
                    "a rotary axis has no expansion: leave temperatures and coefficients out"
                )
            return cls(0.0, None, ())
        if done and given:
            raise DataError(
                "already_corrected says that the readings hold at 20 degC, and a temperature or "
                "coefficient asks for the same correction again: give one of the two"
            )
        if done:
            return cls(
                0.0, None, ("the instrument has corrected the expansion; nothing more was",)
            )
        if not given:
            return cls(0.0, None, ("no temperature is stated: 1 K is 11.5 um/m for steel",))
        if alpha is None or warm is None:
            raise DataError(
                'expansion and temperature are needed together: state expansion="11.5 ppm/K" and '
                'temperature="22.4 degC"'
            )
        if (use is None) != (alpha_w is None):
            raise DataError(
                "temperature_use and workpiece_expansion are needed together; a workpiece_expansion "
                "of 0 means right in metres at that temperature"
            )
        a, a_r, a_w = (
            _within(v, n, "coefficient of expansion", _EXPANSIONS, unusual)
            for v, n in ((alpha, "expansion"), (alpha_r, "instrument_expansion"),
                         (alpha_w or 0.0, "workpiece_expansion"))
        )  # fmt: skip
        t, t_r, t_use = (
            _within(v, n, "temperature", _TEMPERATURES, unusual) - _STANDARD
            for v, n in ((warm, "temperature"), (warm_r, "instrument_temperature"),
                         (_STANDARD if use is None else use, "temperature_use"))
        )  # fmt: skip
        u_a = not_negative(
            _U_EXPANSION if u_alpha is None else u_alpha,
            "u_expansion",
            dimension="coefficient of expansion",
        )
        u_t = not_negative(
            _U_TEMPERATURE if u_warm is None else u_warm,
            "u_temperature",
            dimension="temperature difference",
        )
        told = [
            f"{name} {value} is assumed"
            for name, v, value in (
                ("u_expansion", u_alpha, "1e-6 / K"),
                ("u_temperature", u_warm, "0.5 K"),
            )
            if v is None
        ]
        slope = a * t - a_r * t_r - (a - a_w) * t_use
        # an instrument without expansion (a laser corrected for air) has no thermal length of its own
        other = (a_r * u_t, t_r * u_a) if a_r else ()
        return cls(slope, math.hypot(a * u_t, t * u_a, *other), tuple(told))


def _within(
    value: Any, name: str, dimension: str, span: tuple[float, float], unusual: bool
) -> float:
    found = quantity(value, name, dimension)
    if not unusual and not span[0] <= found <= span[1]:
        shown = "0 ... 50 degC" if dimension == "temperature" else "-1e-6 ... 40e-6 / K"
        raise DataError(
            f"{name}={value!r} lies outside {shown}: check its unit (a number without one is in "
            f"{'K' if dimension == 'temperature' else '1/K'}), or say that it is unusual"
        )
    return found


def _readings(values: ArrayLike, name: str, m: int) -> FloatArray:
    """Return the cycles as columns."""
    found = np.asarray(values, dtype=np.float64)
    found = found[:, None] if found.ndim == 1 else found
    if found.ndim != 2 or found.shape[0] != m or found.shape[1] < 1 or np.isinf(found).any():
        raise DataError(
            f"{name} must hold a finite row for each of the {m} targets and a column for each cycle, "
            f"got shape {found.shape}"
        )
    return found


def _mean(cycles: FloatArray, p: FloatArray, name: str, unit: str) -> FloatArray:
    """Return the mean of the cycles, refused where a target has none."""
    empty = np.flatnonzero(np.isnan(cycles).all(axis=1))
    if empty.size:
        raise DataError(
            f"the target {p[empty[0]]:.9g} {unit} has no {name} reading: leave the target out of both "
            "directions, or measure it"
        )
    return np.asarray(np.nanmean(cycles, axis=1))


def _lost_motion(
    up: FloatArray | None, down: FloatArray | None
) -> tuple[float | None, float | None, tuple[str, ...]]:
    """Return mean and u of forward - reverse, the cycles being what repeats."""
    if up is None or down is None:
        return None, None, ("one direction: lost motion is not known",)
    lost = float(np.mean(np.nanmean(up, axis=1) - np.nanmean(down, axis=1)))
    n = min(up.shape[1], down.shape[1])
    each = np.array(
        [np.mean(d[~np.isnan(d)]) for d in (up[:, :n] - down[:, :n]).T if not np.isnan(d).all()]
    )
    if each.size < 2:
        return lost, None, ("one cycle: whether the lost motion repeats is not known",)
    return lost, float(each.std(ddof=1) / math.sqrt(each.size)), ()
