"""Thermal expansion of an axis and of the instrument that measured it: the slope that it explains.

No numpy here: the command line makes its options of this.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, fields, replace
from typing import Any, SupportsFloat

from metrosep.core.errors import DataError
from metrosep.core.options import option
from metrosep.core.units import parse_quantity

_STANDARD = 293.15
"""Temperature at which lengths hold, K (ISO 1)."""
_U_EXPANSION, _U_TEMPERATURE = 1e-6, 0.5
"""Standard uncertainties where nobody states them, 1/K and K."""
_TEMPERATURES, _EXPANSIONS = (273.15, 323.15), (-1e-6, 40e-6)
"""Range of a workshop, K, and of materials, 1/K: beyond it a unit is mistaken."""
_COEFFICIENT = "coefficient of expansion"
_DIMENSIONS = {
    "expansion": _COEFFICIENT, "instrument_expansion": _COEFFICIENT,
    "workpiece_expansion": _COEFFICIENT, "u_expansion": _COEFFICIENT,
    "temperature": "temperature", "instrument_temperature": "temperature",
    "temperature_use": "temperature", "u_temperature": "temperature difference",
}  # fmt: skip


@dataclass(frozen=True, slots=True)
class Expansion:
    """What is stated of temperatures while a length was measured; nothing is assumed but u.

    Parameters
    ----------
    expansion : float or str, 1/K, optional
        Coefficient of the scale, or of the part that holds the work: ``"11.5 ppm/K"``.
    temperature : float or str, K, optional
        Of the axis while it was measured: ``"22.4 degC"``.
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

    Raises
    ------
    DataError
        If what is stated is incomplete, contradictory or unusual.

    Notes
    -----
    e_20 = e - [a_m (T_m - 20) - a_r (T_r - 20)] (p - p_ref); for use at another temperature
    e_T = e_20 + (a_m - a_w)(T_use - 20)(p - p_ref); u(slope)^2 = (a_m u(T_m))^2 +
    ((T_m - T_use) u(a_m))^2 + ((T_use - 20) u(a_w))^2, and the same of the instrument; T_use is 20
    if it is not stated.

    References
    ----------
    .. [1] ISO 230-2:2014; ISO 1:2022.
    .. [2] D. A. Swyt, Uncertainties in dimensional measurements made at nonstandard temperatures,
       J. Res. NIST 99 (1994) 31.

    Examples
    --------
    >>> warm = Expansion(expansion="11.5 ppm/K", temperature="22.4 degC")
    >>> f"{warm.slope * 1e6:.1f} um/m, u {warm.u_slope * 1e6:.1f}"
    '27.6 um/m, u 6.2'
    """

    expansion: float | str | None = option(
        None, kind="expansion", help="of the scale, or of the part that holds the work"
    )
    temperature: float | str | None = option(
        None, kind="temperature", help="of the axis while it was measured"
    )
    instrument_expansion: float | str | None = option(
        None, kind="expansion", help="of the instrument; a laser corrected for air has none"
    )
    instrument_temperature: float | str | None = option(
        None, kind="temperature", help="of the instrument while it measured"
    )
    u_expansion: float | str | None = option(
        None,
        kind="expansion",
        help="standard uncertainty of the coefficients; 1 ppm/K by default",
    )
    u_temperature: float | str | None = option(
        None,
        kind="temperature difference",
        help="standard uncertainty of the temperatures; 0.5 K by default",
    )
    temperature_use: float | str | None = option(
        None, kind="temperature", help="at which the table will be used, if it is not 20 degC"
    )
    workpiece_expansion: float | str | None = option(
        None,
        kind="expansion",
        help="of what is made at temperature_use; 0 ppm/K is right in metres there",
    )
    already_corrected: bool = option(
        False, kind="flag", help="the instrument has reduced its readings to 20 degC"
    )
    unusual: bool = option(
        False, kind="flag", help="take temperatures outside 0 to 50 degC and unusual coefficients"
    )

    def __post_init__(self) -> None:
        for name, dimension in _DIMENSIONS.items():
            value = getattr(self, name)
            if value is not None:
                object.__setattr__(self, name, self._checked(value, name, dimension))
        for name in ("already_corrected", "unusual"):
            if not isinstance(getattr(self, name), bool):
                raise DataError(f"{name} is True or False, got {getattr(self, name)!r}")
        given = [n for n in _DIMENSIONS if getattr(self, n) is not None]
        if self.already_corrected and given:
            raise DataError(
                f"already_corrected says that the readings hold at 20 degC, and {given[0]} asks for "
                "the same correction again: give one of the two"
            )
        if given and (self.expansion is None or self.temperature is None):
            raise DataError(
                'expansion and temperature are needed together: state expansion="11.5 ppm/K" and '
                'temperature="22.4 degC"'
            )
        if (self.temperature_use is None) != (self.workpiece_expansion is None):
            raise DataError(
                "temperature_use and workpiece_expansion are needed together; a workpiece_expansion "
                "of 0 means right in metres at that temperature"
            )
        if self.instrument_expansion and self.instrument_temperature is None:
            raise DataError(
                "an instrument that expands needs its temperature: state instrument_temperature"
            )

    def _checked(self, value: Any, name: str, dimension: str) -> float:
        """Return a value in SI, refused where its unit must be mistaken."""
        text = isinstance(value, str)
        if not text and (isinstance(value, bool) or not isinstance(value, SupportsFloat)):
            raise DataError(f"{name} must be a number, or a text with a unit, got {value!r}")
        found = float(parse_quantity(value, dimension=dimension, name=name) if text else value)
        if not math.isfinite(found):
            raise DataError(f"{name} must be finite, got {value!r}")
        if name.startswith("u_"):
            if found < 0.0:
                raise DataError(f"{name} is a standard uncertainty, from zero on; got {value!r}")
            return found
        low, high = _TEMPERATURES if dimension == "temperature" else _EXPANSIONS
        if not self.unusual and not low <= found <= high:
            shown = "0 ... 50 degC" if dimension == "temperature" else "-1e-6 ... 40e-6 / K"
            raise DataError(
                f"{name}={value!r} lies outside {shown}: check its unit (a number without one is in "
                f"{'K' if dimension == 'temperature' else '1/K'}), or say that it is unusual"
            )
        return found

    @classmethod
    def of_options(cls, given: Mapping[str, Any]) -> Expansion | None:
        """Return what the options of a table state of temperatures.

        Parameters
        ----------
        given : mapping
            Options; what is not a field of `Expansion` is left alone.

        Returns
        -------
        Expansion or None
            None where they state nothing.
        """
        known: dict[str, Any] = {f.name: given.get(f.name) for f in fields(cls)}
        known = {k: v for k, v in known.items() if v is not None and v is not False}
        return cls(**known) if known else None

    def used_as(self, other: Expansion) -> Expansion:
        """Return what is stated of readings, for the temperature of use of a table if none is stated here.

        Parameters
        ----------
        other : Expansion
            What the table states.

        Returns
        -------
        Expansion
            Readings of a table for 30 degC are compared at 30 degC, whenever they were taken.
        """
        if self.temperature_use is not None or other.temperature_use is None:
            return self
        return replace(
            self,
            temperature_use=other.temperature_use,
            workpiece_expansion=other.workpiece_expansion,
            unusual=self.unusual or other.unusual,
        )

    @property
    def is_stated(self) -> bool:
        """Whether anything is said of the temperature of the readings."""
        return self.already_corrected or self.temperature is not None

    def _over(self, name: str) -> float:
        """Return a temperature above 20 degC, K; that itself where it is not stated."""
        value = getattr(self, name)
        return 0.0 if value is None else value - _STANDARD

    @property
    def slope(self) -> float:
        """What (23) and (24) take off the error over position, m/m."""
        alpha, other = float(self.expansion or 0.0), float(self.instrument_expansion or 0.0)
        use = (alpha - float(self.workpiece_expansion or 0.0)) * self._over("temperature_use")
        return (
            alpha * self._over("temperature") - other * self._over("instrument_temperature") - use
        )

    @property
    def u_slope(self) -> float | None:
        """Standard uncertainty (25) of that slope, m/m; None if no temperature is stated."""
        if self.temperature is None:
            return None
        u_a, u_t = self._u
        # d(slope)/d(a_m) = (T_m - 20) - (T_use - 20): used as warm as measured, a_m does not matter
        use = self._over("temperature_use")
        parts = [float(self.expansion or 0.0) * u_t, (self._over("temperature") - use) * u_a]
        if self.workpiece_expansion:
            parts.append(use * u_a)
        if self.instrument_expansion:  # one without expansion has no thermal length of its own
            other = float(self.instrument_expansion)
            parts += [other * u_t, self._over("instrument_temperature") * u_a]
        return math.hypot(*parts)

    @property
    def _u(self) -> tuple[float, float]:
        u_a, u_t = self.u_expansion, self.u_temperature
        return (
            _U_EXPANSION if u_a is None else float(u_a),
            _U_TEMPERATURE if u_t is None else float(u_t),
        )

    @property
    def messages(self) -> tuple[str, ...]:
        """What was applied, and what was assumed for it."""
        if self.already_corrected:
            return ("the instrument has corrected the expansion; nothing more was",)
        if self.temperature is None:
            return ("no temperature is stated: 1 K is 11.5 um/m for steel",)
        told = (
            f"{self.slope * 1e6:.4g} um/m of the slope were taken off as thermal expansion "
            f"(u {(self.u_slope or 0.0) * 1e6:.2g} um/m)"
        )
        assumed = [
            f"{name} {value} is assumed"
            for name, value in (("u_expansion", "1e-6 / K"), ("u_temperature", "0.5 K"))
            if getattr(self, name) is None
        ]
        return (told, *assumed)

    def to_dict(self) -> dict[str, Any]:
        """Return what is stated, in SI, and the slope; ``Expansion.of_options`` makes it again."""
        stated = {f.name: getattr(self, f.name) for f in fields(self)}
        kept = {k: v for k, v in stated.items() if v is not None and v is not False}
        return {**kept, "slope_removed": self.slope, "u_slope": self.u_slope}
