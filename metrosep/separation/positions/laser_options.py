"""What is stated of a laser interferometer, declared once; free of numpy for the command line."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

from metrosep.core.options import Option
from metrosep.optics.air_options import AIR, U_AIR, WET

READ_AS = Option(
    "text", choices=("position", "deviation"), default="deviation",
    help="what the readings are: positions, or positions minus nominal",
)  # fmt: skip

_ONCE = ("temperature", "pressure", *WET)

SETUP: Mapping[str, Option] = {
    **AIR,
    **U_AIR,
    "wavelength": Option("size", help="of the laser in vacuum", default="632.9908 nm"),
    "u_wavelength": Option(
        "share", help='relative standard uncertainty of the wavelength, "0.02 ppm"'
    ),
    "equation": Option(
        "text", choices=("ciddor", "edlen"), default="ciddor",
        help="Ciddor 1996, or Edlen after Boensch and Potulski 1998",
    ),
    "software": Option(
        "text", choices=("vacuum", "same air"),
        help="vacuum: readings are not compensated; same air: compensated with the air that is stated "
        "here; else software_index, or software_temperature, _pressure and _humidity",
    ),
    "software_index": Option(
        "number", help="refractive index that the software used, 1.0002714", low=1.0, high=1.001
    ),
    **{f"software_{k}": replace(AIR[k], help=f"{k} that the software assumed") for k in _ONCE},
    "positive": Option(
        "text", choices=("away", "towards"),
        help="where the reflector goes while the reading rises, seen from the interferometer",
    ),
    "zero": Option("length", help="position at which the reading was set to zero", default="0 mm"),
    "dead_path": Option(
        "uncertainty", help="from the interferometer to the reflector where the reading was zero"
    ),
    "u_dead_path": Option("uncertainty", help="standard uncertainty of dead_path"),
    **{f"reset_{k}": replace(AIR[k], help=f"{k} where the reading was set to zero") for k in _ONCE},
    "air_change": Option(
        "share",
        help='largest change of the index of air since zero, "1 ppm", where its air is not known',
    ),
    "beam_angle": Option("angle", help="between the beam and the motion; or spot_walk"),
    "u_beam_angle": Option("angle", help="standard uncertainty of beam_angle", low=0.0),
    "spot_walk": Option(
        "uncertainty",
        help="how far the returned spot walks over walk_travel: twice the offset of the reflector",
    ),
    "u_spot_walk": Option("uncertainty", help="standard uncertainty of spot_walk"),
    "walk_travel": Option(
        "size", help="travel over which the spot walks; that of the readings by default"
    ),
    "misalignment": Option(
        "text", choices=("limit", "measured"), default="limit",
        help="whether beam_angle or spot_walk is only known to be no larger, or was measured",
    ),
    "pitch_offset": Option(
        "length",
        help="from the beam to the point of interest, positive to the side that a positive pitch moves "
        "forwards",
    ),
    "u_pitch_offset": Option("uncertainty", help="standard uncertainty of pitch_offset"),
    "u_pitch": Option("angle", help="standard uncertainty of the pitch since zero", low=0.0),
    "pitch_limit": Option(
        "angle", help="largest pitch, where it was not measured: uncertainty only", low=0.0
    ),
    "yaw_offset": Option("length", help="as pitch_offset, for the yaw"),
    "u_yaw_offset": Option("uncertainty", help="standard uncertainty of yaw_offset"),
    "u_yaw": Option("angle", help="standard uncertainty of the yaw since zero", low=0.0),
    "yaw_limit": Option("angle", help="largest yaw, where it was not measured", low=0.0),
    "expansion": Option(
        "expansion", help="of part or scale: the reading is brought to 20 degC", low=-1e-4, high=1e-4
    ),
    "u_expansion": Option("expansion", help="standard uncertainty of expansion", low=0.0),
    "part_temperature": Option("temperature", help="of part or scale"),
    "u_part_temperature": Option(
        "temperature difference", help="standard uncertainty of part_temperature"
    ),
    "u_reading": Option(
        "uncertainty", help="standard uncertainty of one reading (noise, resolution)"
    ),
}  # fmt: skip
"""All that can be stated of a set-up: air now, in the software, at zero; light, geometry, part."""

AIR_KEYS: Mapping[str, Option] = {
    "reading": Option("length", help="displacement since zero, as displayed; none: the air alone"),
    "pitch": Option("angle", help="change of pitch since zero"),
    "yaw": Option("angle", help="change of yaw since zero"),
    **SETUP,
}
"""Keys of the step ``air``: the set-up, and the one reading that it acts on."""
