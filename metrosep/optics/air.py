"""Refractive index of air: Ciddor 1996, and Edlen's equation as Boensch and Potulski revised it in 1998.

Inside, temperatures are in K, pressures in Pa, humidity and CO2 are shares of 1. Every coefficient
stands as in the papers and in at least two public texts that were compared (docs/explanation/
laser-setup.md). Phase index, for narrow-band light; pulses and modulated light need the group index.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Any, Literal

import numpy as np
from numpy.typing import ArrayLike

from metrosep.core._arrays import FloatArray
from metrosep.core.errors import DataError, OptionError, OptionRangeError
from metrosep.core.numbers import choice, is_real
from metrosep.core.options import checked
from metrosep.core.readable import typed_number
from metrosep.core.units import parse_quantity
from metrosep.optics.air_options import AIR, U_AIR, WET

Equation = Literal["ciddor", "edlen"]

_STANDARD_CO2 = 450e-6

_RANGES: Mapping[str, tuple[float, float, str]] = {
    "wavelength": (300e-9, 1700e-9, "a bare number is in m: 633 nm is '633 nm' or 633e-9"),
    "temperature": (233.15, 373.15, "a bare number is in K: 20 degC is '20 degC' or 293.15"),
    "pressure": (10e3, 140e3, "a bare number is in Pa: 1013 hPa is '1013 hPa' or 101300"),
    "humidity": (0.0, 1.0, "a bare number is a share of 1: 45 % is '45 %' or 0.45"),
    "dew_point": (273.15, 373.15, "a bare number is in K: 9 degC is '9 degC' or 282.15"),
    "vapour_pressure": (0.0, 20e3, "a bare number is in Pa: 10 hPa is '10 hPa' or 1000"),
    "co2": (0.0, 2000e-6, "a bare number is a share of 1: 450 ppm is '450 ppm' or 450e-6"),
}
"""Beyond these both equations have no meaning (NIST takes the same); the third says what was meant."""

_HELD: Mapping[str, Mapping[str, tuple[float, float]]] = {
    "ciddor": {
        "wavelength": (350e-9, 1600e-9), "temperature": (273.15, 313.15), "pressure": (60e3, 120e3),
    },
    "edlen": {
        "wavelength": (350e-9, 650e-9), "temperature": (288.15, 303.15), "pressure": (80e3, 120e3),
    },
}  # fmt: skip
_OWN_U: Mapping[str, tuple[float, float]] = {"ciddor": (2e-8, 5e-8), "edlen": (1e-8, 5e-8)}
"""Standard uncertainty of each equation, within and outside `_HELD`: Ciddor claims 2e-8 to 5e-8,
Boensch and Potulski 1e-8."""

_UNITS = {
    "wavelength": "length", "temperature": "temperature", "pressure": "pressure",
    "humidity": "share", "dew_point": "temperature", "vapour_pressure": "pressure", "co2": "share",
}  # fmt: skip


@dataclass(frozen=True, slots=True, eq=False)
class AirIndex:
    """Refractive index of air with its uncertainty and what it comes from.

    Parameters
    ----------
    n : float or ndarray, shape (k,)
        Phase index, NaN where an input is.
    u : float or ndarray, shape (k,)
        Standard uncertainty of `n`.
    terms : mapping of str to (float or ndarray)
        Contribution of each source to `u`, with the sign of its sensitivity: ``"equation"`` and
        what has a stated uncertainty. `u` is the root of the sum of their squares.
    equation : {"ciddor", "edlen"}
        Which one.
    wavelength : float, m
        In vacuum.
    messages : tuple of str
        What the user should know.
    """

    n: Any
    u: Any
    terms: Mapping[str, Any]
    equation: str
    wavelength: float
    messages: tuple[str, ...] = field(default=())

    @property
    def wavelength_in_air(self) -> Any:
        """Wavelength in air, m."""
        return self.wavelength / self.n

    def __repr__(self) -> str:
        n, u = np.ravel(self.n), np.ravel(self.u)
        more = f" ... {n[-1]:.9f}" if n.size > 1 else ""
        return f"AirIndex({self.equation}: n = {n[0]:.9f}{more}, u = {float(u.max()):.2g})"


def refractive_index(
    wavelength: float | str,
    temperature: ArrayLike | str,
    pressure: ArrayLike | str,
    *,
    equation: Equation = "ciddor",
    **water: ArrayLike | str,
) -> Any:
    """Return the phase refractive index of moist air.

    Parameters
    ----------
    wavelength : float or str, m
        In vacuum, 300 to 1700 nm.
    temperature : array_like or str, K
        Of the air, -40 to 100 degC.
    pressure : array_like or str, Pa
        Of the air, 10 to 140 kPa.
    equation : {"ciddor", "edlen"}, optional
        Ciddor 1996, or Edlen revised by Boensch and Potulski 1998.
    **water : array_like or str
        Exactly one of ``humidity`` (relative, over water, 0 to 1), ``dew_point`` (K) and
        ``vapour_pressure`` (Pa); the first two need 0 degC or more. And ``co2``, a mole fraction, 450
        ppm if omitted.

    Returns
    -------
    float or ndarray
        n, of the common shape of the inputs; NaN where one of them is.

    Raises
    ------
    OptionError
        If a value is not a number or text with a unit, or not one measure of the water is given.
    OptionRangeError
        If a value is out of its range; the message says which unit may have been meant.
    DataError
        If the air would hold more water than it can.

    Notes
    -----
    Equations: docs/explanation/laser-setup.md. Saturation is that of IAPWS-IF97, region 4; the mole
    fraction of water has the enhancement factor of NIST's page (dew point: at the dew point).

    References
    ----------
    .. [1] P. E. Ciddor, Appl. Opt. 35 (1996) 1566, eq. 1 to 5 and appendices A, B.
    .. [2] G. Boensch, E. Potulski, Metrologia 35 (1998) 133, eq. 6a, 7, 8, 9a.
    .. [3] J. A. Stone, J. H. Zimmerman, NIST Engineering Metrology Toolbox, Index of refraction of air.

    Examples
    --------
    >>> n = refractive_index("633 nm", "20 degC", "101.325 kPa", humidity="0 %")
    >>> f"{n:.9f}"
    '1.000271800'
    """
    given = {"wavelength": wavelength, "temperature": temperature, "pressure": pressure, **water}
    return _index(_values(given, equation), equation)


def air_index(
    wavelength: float | str, *, equation: Equation = "ciddor", **given: ArrayLike | str | None
) -> AirIndex:
    """Return the refractive index of air with its standard uncertainty.

    Parameters
    ----------
    wavelength : float or str, m
        In vacuum.
    equation : {"ciddor", "edlen"}, optional
        As for `refractive_index`.
    **given : array_like or str
        ``temperature``, ``pressure``, one of ``humidity``, ``dew_point``, ``vapour_pressure``,
        ``co2``, and their standard uncertainties ``u_temperature``, ``u_pressure``, ... (K, Pa, 1).

    Returns
    -------
    AirIndex
        n, u, the contribution of each source, messages.

    Raises
    ------
    OptionError
        As for `refractive_index`; also if a name is unknown, or an uncertainty has no value.
    OptionRangeError
        As for `refractive_index`; also if an uncertainty is negative.
    DataError
        As for `refractive_index`.

    Notes
    -----
    Sensitivities are central differences over the stated uncertainty (JCGM 100, 5.1.3 note 2). The
    equation itself: Ciddor 2e-8 (5e-8 outside 0 to 40 degC, 60 to 120 kPa, 350 to 1600 nm), Edlen
    1e-8 (5e-8 outside 15 to 30 degC, 80 to 120 kPa, 350 to 650 nm). What has no stated uncertainty
    is not in `u`; a message says so.

    Examples
    --------
    >>> air = air_index("633 nm", temperature="20 degC", pressure="1013.25 hPa", humidity="50 %",
    ...                 u_temperature="0.1 K", u_pressure="20 Pa", u_humidity="2 %")
    >>> f"{air.n:.8f}", f"{air.u:.2g}", f"{air.terms['temperature']:.2g}"
    ('1.00027137', '1.1e-07', '-9.5e-08')
    """
    stated = {k: v for k, v in given.items() if k in U_AIR and v is not None}
    values = _values(
        {"wavelength": wavelength, **{k: v for k, v in given.items() if k not in U_AIR}}, equation
    )
    for name in (k.removeprefix("u_") for k in stated):
        if name not in values:
            raise OptionError(f"u_{name} is given, but {name} is not; give both or none")
    n = _index(values, equation)
    terms = {"equation": _own_u(values, equation) + 0.0 * np.asarray(n)}
    for key, value in stated.items():
        u, name = checked(U_AIR[key], value, key), key.removeprefix("u_")
        terms[name] = _slope(values, equation, name, u) * u
    silent = [f"u_{k}" for k in AIR if k in values and k not in terms]
    total = np.sqrt(sum(np.square(t) for t in terms.values()))
    return AirIndex(
        n,
        total if np.ndim(total) else float(total),
        {k: t if np.ndim(t) else float(t) for k, t in terms.items()},
        equation,
        float(values["wavelength"]),
        _messages(values, equation, silent),
    )


def saturation_pressure(temperature: ArrayLike) -> Any:
    """Return the saturation pressure of water vapour over water.

    Parameters
    ----------
    temperature : array_like, K
        273.15 to 647 K.

    Returns
    -------
    float or ndarray, Pa
        IAPWS-IF97, region 4, equation 30.

    Examples
    --------
    >>> round(float(saturation_pressure(300.0)), 3)  # IF97, table 35
    3536.589
    """
    t = np.asarray(temperature, dtype=np.float64)
    k = _IF97
    v = t + k[8] / (t - k[9])
    a = v**2 + k[0] * v + k[1]
    b = k[2] * v**2 + k[3] * v + k[4]
    c = k[5] * v**2 + k[6] * v + k[7]
    return 1e6 * (2.0 * c / (-b + np.sqrt(b**2 - 4.0 * a * c))) ** 4


_IF97 = (
    0.11670521452767e4, -0.72421316703206e6, -0.17073846940092e2, 0.12020824702470e5,
    -0.32325550322333e7, 0.14915108613530e2, -0.48232657361591e4, 0.40511340542057e6,
    -0.23855557567849, 0.65017534844798e3,
)  # fmt: skip

_ZERO = 273.15


def _values(given: Mapping[str, Any], equation: str) -> dict[str, FloatArray]:
    """Return what is known of light and air in SI, within its ranges."""
    choice(equation, "equation", ("ciddor", "edlen"))
    unknown = [k for k in given if k not in _RANGES]
    if unknown:
        raise OptionError(f"air has no {unknown[0]!r}; known are {', '.join([*AIR, *U_AIR])}")
    known = {"co2": _STANDARD_CO2} | {k: v for k, v in given.items() if v is not None}
    missing = [name for name in ("temperature", "pressure") if name not in known]
    if missing:
        if not known.keys() & {"humidity", "dew_point", "vapour_pressure"}:
            missing.append("humidity (or dew_point, vapour_pressure)")
        are = "are" if len(missing) > 1 else "is"
        raise OptionError(f"{' and '.join(missing)} of the air {are} needed; see metrosep ops air")
    return {k: _checked(k, v) for k, v in known.items()}


def _checked(name: str, value: Any) -> FloatArray:
    """Return an input in SI, NaN where it is NaN, within its range."""
    dimension = _UNITS[name]
    if isinstance(value, str):
        value = parse_quantity(value, dimension=dimension, name=name)
    elif not is_real(value) and isinstance(value, bool | np.bool_ | complex):
        raise OptionError(f"{name} must be a number or a text with its unit, got {value!r}")
    try:
        array = np.array(value, dtype=np.float64)
    except (TypeError, ValueError):
        raise OptionError(
            f"{name} must be numbers or a text with its unit, got {value!r}"
        ) from None
    low, high, meant = _RANGES[name]
    slack = 1e-12 * high  # -40 + 273.15 is less than 233.15
    outside = array[(array < low - slack) | (array > high + slack)]
    if outside.size or np.isinf(array).any():
        found = float(outside.flat[0]) if outside.size else np.inf
        ends = f"{typed_number(low, dimension)} to {typed_number(high, dimension)}"
        bare = {"temperature": " K", "pressure": " Pa", "length": " m", "share": ""}[dimension]
        raise OptionRangeError(
            f"{name} is {found:.6g}{bare}, out of the range of air, {ends}; {meant}"
        )
    return array


def _index(values: Mapping[str, FloatArray], equation: str) -> Any:
    t_k, p = values["temperature"], values["pressure"]
    wet = [k for k in WET if k in values]
    if len(wet) != 1:
        said = " and ".join(wet) if wet else "none"
        raise OptionError(
            f"one of humidity, dew_point and vapour_pressure is needed, got {said}; "
            "humidity = '50 %' with u_humidity = '10 %' where it was not measured"
        )
    name, t = wet[0], t_k - _ZERO
    water = values[name]
    _require_wettable(name, water, t_k)
    if name == "humidity":
        wet_pressure = np.where(
            water == 0.0, 0.0, water * saturation_pressure(np.maximum(t_k, _ZERO))
        )
        at = t
    else:
        wet_pressure = saturation_pressure(water) if name == "dew_point" else water
        at = water - _ZERO if name == "dew_point" else t
    s = 1e-12 / values["wavelength"] ** 2  # square of the wave number, 1/um^2
    make: Callable[..., Any] = _ciddor if equation == "ciddor" else _edlen
    n = make(s, t, p, wet_pressure, at, values["co2"])
    return n if np.ndim(n) else float(n)


def _require_wettable(name: str, water: FloatArray, t_k: FloatArray) -> None:
    """Refuse humidity below the freezing point, and more water than the air can hold."""
    frozen = np.any((t_k < _ZERO) & (water > 0.0))
    if frozen and name == "humidity":
        raise OptionRangeError(
            "relative humidity is over water here and needs air of 0 degC or more; below it give "
            "vapour_pressure"
        )
    most = saturation_pressure(np.maximum(t_k, _ZERO))
    if name == "dew_point" and np.any(water > t_k):
        raise DataError("dew_point is above the temperature of the air: the water would condense")
    if name == "vapour_pressure" and np.any(water > most):
        raise DataError(
            f"vapour_pressure is above that of saturated air, {float(np.min(most)):.0f} Pa; the "
            "water would condense: check the unit (10 hPa are 1000 Pa)"
        )


def _ciddor(s: Any, t: Any, p: Any, wet: Any, at: Any, co2: Any) -> Any:
    """Return n after Ciddor: s in 1/um^2, t and at in degC, p and wet in Pa, co2 a share."""
    factor = 1.00062 + 3.14e-8 * p + 5.6e-7 * at**2
    x = factor * wet / p  # mole fraction of water
    n_as = 1e-8 * (5792105.0 / (238.0185 - s) + 167917.0 / (57.362 - s))  # eq. 1, n - 1
    n_axs = n_as * (1.0 + 0.534 * (co2 - 450e-6))  # eq. 2
    n_ws = 1.022e-8 * (295.235 + 2.6422 * s - 0.032380 * s**2 + 0.004028 * s**3)  # eq. 3
    # densities as ratios (eq. 4): the molar masses and the gas constant cancel
    dry = _molar(t, p, x) * (1.0 - x) / _molar(15.0, 101325.0, 0.0)
    water = _molar(t, p, x) * x / _molar(20.0, 1333.0, 1.0)
    return 1.0 + dry * n_axs + water * n_ws  # eq. 5


def _molar(t: Any, p: Any, x: Any) -> Any:
    """Return p / (Z T), the density in moles times R; Z is eq. 12 of the appendix, t in degC."""
    k = t + _ZERO
    first = 1.58123e-6 - 2.9331e-8 * t + 1.1043e-10 * t**2
    second = (5.707e-6 - 2.051e-8 * t) * x + (1.9898e-4 - 2.376e-6 * t) * x**2
    z = 1.0 - p / k * (first + second) + (p / k) ** 2 * (1.83e-11 - 0.765e-8 * x**2)
    return p / (z * k)


def _edlen(s: Any, t: Any, p: Any, wet: Any, at: Any, co2: Any) -> Any:
    """Return n after Boensch and Potulski; units as for `_ciddor`."""
    n_n = 1e-8 * (8091.37 + 2333983.0 / (130.0 - s) + 15518.0 / (38.9 - s))  # eq. 6a, n - 1
    n_x = n_n * (1.0 + 0.5327 * (co2 - 400e-6))  # eq. 7
    n_tp = n_x * p / 93214.60 * (1.0 + 1e-8 * (0.5953 - 0.009876 * t) * p) / (1.0 + 0.0036610 * t)
    return 1.0 + n_tp - 1e-10 * (3.8020 - 0.0384 * s) * wet  # eq. 8, 9a


def _slope(values: Mapping[str, FloatArray], equation: str, name: str, u: float) -> Any:
    """Return the sensitivity of n to one input, by differences over its uncertainty."""
    low, high, _ = _RANGES[name]
    step = max(u, 1e-6 * (high - low))
    up = np.minimum(values[name] + step, high)
    if name == "dew_point":
        up = np.minimum(up, values["temperature"])
    down = np.maximum(values[name] - step, low)
    if name == "vapour_pressure":
        up = np.minimum(up, saturation_pressure(np.maximum(values["temperature"], _ZERO)))
    if name == "temperature" and "humidity" not in values:
        down = values[name]  # colder air could not hold the water that was measured
    ends = [_index({**values, name: v}, equation) for v in (up, down)]
    width = up - down
    return np.where(width == 0.0, 0.0, (ends[0] - ends[1]) / np.where(width == 0.0, 1.0, width))


def _own_u(values: Mapping[str, FloatArray], equation: str) -> Any:
    """Return the standard uncertainty of an equation, larger where it was not tested."""
    inside, outside = _OWN_U[equation]
    within: Any = True
    for name, (low, high) in _HELD[equation].items():
        within = within & (values[name] >= low) & (values[name] <= high)
    return np.where(within, inside, outside)


def _messages(
    values: Mapping[str, FloatArray], equation: str, silent: list[str]
) -> tuple[str, ...]:
    told = []
    for name, (low, high) in _HELD[equation].items():
        if np.any((values[name] < low) | (values[name] > high)):
            ends = " to ".join(typed_number(v, _UNITS[name]) for v in (low, high))
            other = "; the equation of Ciddor reaches further" if equation == "edlen" else ""
            told.append(
                f"{name} is outside {ends}, where the equation of {equation.capitalize()} was tested: "
                f"its own standard uncertainty is taken as {_OWN_U[equation][1]:g}{other}"
            )
    if silent:
        told.append(f"not stated: {', '.join(silent)}: not in the uncertainty of the index")
    return tuple(told)
