"""What is stated of air, declared once; free of numpy for the command line."""

from __future__ import annotations

from collections.abc import Mapping

from metrosep.core.options import Option

WET = ("humidity", "dew_point", "vapour_pressure")
"""Measures of the water in air; one of them is stated."""

AIR: Mapping[str, Option] = {
    "temperature": Option("temperature", help="of the air, mean over the beam"),
    "pressure": Option("pressure", help="of the air at the beam (not reduced to sea level)"),
    "humidity": Option(
        "share", help='relative humidity, "45 %"; or dew_point, or vapour_pressure'
    ),
    "dew_point": Option("temperature", help="in place of humidity"),
    "vapour_pressure": Option("pressure", help="of water, in place of humidity"),
    "co2": Option("share", help="carbon dioxide in the air", default="450 ppm"),
}
"""What the index of air depends on, beside the light."""

U_AIR: Mapping[str, Option] = {
    "u_temperature": Option(
        "temperature difference", help="standard uncertainty of temperature", high=20.0
    ),
    "u_pressure": Option("pressure", help="standard uncertainty of pressure", high=2e4),
    "u_humidity": Option(
        "share", help='standard uncertainty of humidity, "2 %" of saturation', high=0.5
    ),
    "u_dew_point": Option(
        "temperature difference", help="standard uncertainty of dew_point", high=20.0
    ),
    "u_vapour_pressure": Option(
        "pressure", help="standard uncertainty of vapour_pressure", high=2e3
    ),
    "u_co2": Option("share", help='standard uncertainty of co2, "50 ppm"', high=2e-3),
}
"""Standard uncertainties of what is measured of the air."""
