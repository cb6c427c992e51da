"""How a laser interferometer stands, declared once and checked; free of numpy for the command line.

Numbers are in SI or texts with a unit; temperatures in K.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import Any

from metrosep.core.errors import InvalidSamplesError, OptionError
from metrosep.core.options import Option, checked, option, options_of
from metrosep.optics.air_options import AIR, U_AIR, WET

__all__ = [
    "AIR_KEYS",
    "RESET",
    "SETUP",
    "SOFTWARE",
    "SURROUNDINGS",
    "LaserOptions",
    "require_small",
]

RESET: Mapping[str, Option] = {
    f"reset_{k}": replace(AIR[k], help=f"{k} where the reading was set to zero")
    for k in ("temperature", "pressure", *WET)
}
SOFTWARE: Mapping[str, Option] = {
    f"software_{k}": replace(AIR[k], help=f"{k} that the software of the laser assumed")
    for k in ("temperature", "pressure", *WET)
}
SURROUNDINGS: Mapping[str, Option] = {**AIR, **U_AIR, **SOFTWARE, **RESET}
"""What is stated of the air: now, by the software of the laser, where the reading was set to zero."""

_LARGEST_ANGLE = 20e-3
"""rad; a beam or a carriage that is further off is a wrong unit. Below, the cubes left out of the
algebra are under 1e-8 of the travel."""


@dataclass(frozen=True, slots=True)
class LaserOptions:
    """Options of a laser set-up, checked; `LaserSetup` does the algebra."""

    wavelength: Any = option(
        632.9908e-9, kind="size", help="of the laser in vacuum", typed="632.9908 nm"
    )
    u_wavelength: Any = option(
        None, kind="share", help='relative standard uncertainty of the wavelength, "0.02 ppm"'
    )
    equation: Any = option(
        "ciddor", kind="text", choices=("ciddor", "edlen"),
        help="Ciddor 1996, or Edlen after Boensch and Potulski 1998",
    )  # fmt: skip
    software: str | None = option(
        None, kind="text", choices=("vacuum", "same air"),
        help="vacuum: readings are not compensated; same air: with the air that is stated here; else "
        "software_index, or software_temperature, _pressure and _humidity",
    )  # fmt: skip
    software_index: float | None = option(
        None, kind="number", help="refractive index that the software used, 1.0002714"
    )
    positive: str | None = option(
        None, kind="text", choices=("away", "towards"),
        help="where the reflector goes while the reading rises, seen from the interferometer",
    )  # fmt: skip
    zero: Any = option(0.0, kind="length", help="position at which the reading was set to zero")
    dead_path: Any = option(
        None, kind="uncertainty",
        help="from the interferometer to the reflector where the reading was set to zero",
    )  # fmt: skip
    u_dead_path: Any = option(None, kind="uncertainty", help="standard uncertainty of dead_path")
    air_change: Any = option(
        None, kind="share",
        help='largest change of the index of air since the reading was set to zero, "1 ppm", where '
        "the air of that moment is not known",
    )  # fmt: skip
    beam_angle: Any = option(
        None, kind="angle", help="between the beam and the motion; or spot_walk"
    )
    u_beam_angle: Any = option(None, kind="angle", help="standard uncertainty of beam_angle")
    spot_walk: Any = option(
        None, kind="uncertainty",
        help="how far the returned spot walks over walk_travel: twice the offset of the reflector",
    )  # fmt: skip
    u_spot_walk: Any = option(None, kind="uncertainty", help="standard uncertainty of spot_walk")
    walk_travel: Any = option(
        None,
        kind="size",
        help="travel over which the spot walks; that of the readings if left out",
    )
    misalignment: str = option(
        "limit", kind="text", choices=("limit", "measured"),
        help="whether beam_angle or spot_walk is only known to be no larger, or was measured",
    )  # fmt: skip
    pitch_offset: Any = option(
        None, kind="length",
        help="from the beam to the point of interest, positive to the side that a positive pitch moves "
        "forwards",
    )  # fmt: skip
    u_pitch_offset: Any = option(
        None, kind="uncertainty", help="standard uncertainty of pitch_offset"
    )
    u_pitch: Any = option(
        None, kind="angle", help="standard uncertainty of the change of pitch since zero"
    )
    pitch_limit: Any = option(
        None, kind="angle", help="largest pitch, where it was not measured: uncertainty only"
    )
    yaw_offset: Any = option(None, kind="length", help="as pitch_offset, for the yaw")
    u_yaw_offset: Any = option(None, kind="uncertainty", help="standard uncertainty of yaw_offset")
    u_yaw: Any = option(
        None, kind="angle", help="standard uncertainty of the change of yaw since zero"
    )
    yaw_limit: Any = option(
        None, kind="angle", help="largest yaw, where it was not measured: uncertainty only"
    )
    expansion: Any = option(
        None, kind="expansion", help="of part or scale: the reading is brought to 20 degC"
    )
    u_expansion: Any = option(None, kind="expansion", help="standard uncertainty of expansion")
    part_temperature: Any = option(None, kind="temperature", help="of part or scale")
    u_part_temperature: Any = option(
        None, kind="temperature difference", help="standard uncertainty of part_temperature"
    )
    u_reading: Any = option(
        None, kind="uncertainty", help="standard uncertainty of one reading (noise, resolution)"
    )
    air: Mapping[str, Any] = field(default_factory=dict)

    def __post_init__(self) -> None:
        for name, known in options_of(LaserOptions).items():
            value = getattr(self, name)
            if value is not None:
                object.__setattr__(self, name, checked(known, value, name))
        unknown = [k for k in self.air if k not in SURROUNDINGS]
        if unknown:
            raise OptionError(f"air has no {unknown[0]!r}; known are {', '.join(SURROUNDINGS)}")
        for name in (
            "u_beam_angle",
            "u_pitch",
            "u_yaw",
            "u_expansion",
            "pitch_limit",
            "yaw_limit",
        ):
            if (getattr(self, name) or 0.0) < 0.0:
                raise InvalidSamplesError(f"{name} must be zero or more")
        for name in ("beam_angle", "pitch_limit", "yaw_limit"):
            require_small(name, getattr(self, name) or 0.0)
        if self.beam_angle is not None and self.spot_walk is not None:
            raise OptionError("beam_angle and spot_walk say the same; give one of them")
        if self.software_index is not None and not 1.0 <= self.software_index < 1.001:
            raise InvalidSamplesError(
                f"software_index = {self.software_index:g} is not the index of air, such as 1.0002714 "
                "(1 for a reading that is not compensated)"
            )
        if (self.expansion or 0.0) > 1e-4:
            raise InvalidSamplesError(
                f"expansion = {self.expansion:g} 1/K is more than any solid has; steel is '11.5 ppm/K' "
                "or 11.5e-6"
            )


def require_small(name: str, angle: float) -> None:
    """Refuse an angle that no set-up has."""
    if abs(angle) > _LARGEST_ANGLE:
        raise InvalidSamplesError(
            f"{name} is {angle:.4g} rad, more than {_LARGEST_ANGLE:g} rad; check its unit "
            "(a bare number is in rad)"
        )


SETUP: Mapping[str, Option] = {**SURROUNDINGS, **options_of(LaserOptions)}
"""All that can be stated of a set-up."""

AIR_KEYS: Mapping[str, Option] = {
    "reading": Option("length", help="displacement since zero, as displayed; none: the air alone"),
    "pitch": Option("angle", help="change of pitch since zero"),
    "yaw": Option("angle", help="change of yaw since zero"),
    **SETUP,
}
"""Keys of the step ``air``: the set-up, and the one reading that it acts on."""
