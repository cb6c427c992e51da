"""The dialects by name; each is loaded when it is asked for."""

from __future__ import annotations

import functools
import importlib

from metrosep.controllers.base import Dialect, DialectInfo
from metrosep.core.errors import DataError

__all__ = ["describe", "find", "names"]

_PLACES = {
    "linuxcnc": "linuxcnc:LinuxCNC",
    "csv": "neutral:Neutral",
    "csv-map": "neutral:NeutralMap",
    "linuxcnc-lincurve": "linuxcnc_lincurve:LinuxCNCLincurve",
    "linuxcnc-eoffset": "linuxcnc_eoffset:LinuxCNCEoffset",
    "pmac": "pmac:PMAC",
    "pmac-plane": "pmac_plane:PMACPlane",
    "pmac-backlash": "pmac_backlash:PMACBacklash",
    "plc-st": "plc:PLCStructuredText",
    "plc-pmac": "plc:PLCTurboPMAC",
    "aerotech": "aerotech:Aerotech",
    "aerotech-line": "aerotech:AerotechLine",
    "sinumerik-enc": "sinumerik_cec:SinumerikEnc",
    "sinumerik-cec": "sinumerik_cec:SinumerikCec",
    "sinumerik-cec-product": "sinumerik_cec:SinumerikCecProduct",
    "twincat": "twincat:TwinCAT",
    "isg-axis": "isg_cross:IsgAxis",
    "isg-cross": "isg_cross:IsgCross",
    "isg-plane": "isg_cross:IsgPlane",
    "heidenhain": "heidenhain:Heidenhain",
    "fanuc": "fanuc:Fanuc",
    "fanuc-straightness": "fanuc:FanucStraightness",
    "mitsubishi": "mitsubishi:Mitsubishi",
    "pi-gcs": "pi_gcs:PiGcs",
    "nv200": "pi_gcs:NV200",
    "voltage": "voltage:Voltage",
    "etalon": "etalon:Etalon",
    "klipper": "reprap:Klipper",
    "rrf": "reprap:RepRap",
}
"""Module and class of each dialect, in the order in which they are listed."""


def names() -> tuple[str, ...]:
    """Return the names of the controllers that are supported.

    Returns
    -------
    tuple of str
        Values for ``controller=``.

    Examples
    --------
    >>> names()[:2]
    ('linuxcnc', 'csv')
    """
    return tuple(_PLACES)


def describe() -> tuple[DialectInfo, ...]:
    """Return what each dialect is: entry rule, units, limits, how its sign is known.

    Returns
    -------
    tuple of DialectInfo
        One for each name.
    """
    return tuple(find(name).info for name in _PLACES)


@functools.cache
def find(controller: str) -> Dialect:
    """Return a dialect.

    Parameters
    ----------
    controller : str
        Its name.

    Returns
    -------
    Dialect
        Without state.

    Raises
    ------
    DataError
        If there is none of that name.
    """
    if controller not in _PLACES:
        raise DataError(
            f"unknown controller {controller!r}; there are {', '.join(map(repr, _PLACES))}"
        )
    module, _, name = _PLACES[controller].partition(":")
    made: Dialect = getattr(importlib.import_module(f"metrosep.controllers.{module}"), name)()
    return made
