"""Chains of common machines, by name.

The files in ``presets_data`` hold them in the form that `Chain.from_toml` reads: `preset_table`
returns one as a table, to start the description of another machine from.

==========  ========================================  =======================================
name        positions (SI)                            kinematics
==========  ========================================  =======================================
fts_lathe   C theta, X x, FTS s; Z parked             tool on FTS on X on Z; spindle C
sts_lathe   X x, Z z, C theta                         tool on Z; spindle C on X
mill_xyz    X x, Y y, Z z                             tool on Z; table X on Y
five_axis   X x, Y y, Z z, A a, C c                   tool on Z on X; table C on A on Y
==========  ========================================  =======================================
"""

from __future__ import annotations

import tomllib
from importlib.resources import files
from typing import Any, overload

from metrosep.core.errors import DataError, UnitError
from metrosep.machine.chains import Chain

__all__ = ["preset_table", "presets"]

_FOLDER = "presets_data"
_LATHES = ("fts_lathe", "sts_lathe")
_LARGEST = 5.0  # m; a radius or a height above it was typed in mm
_SPINDLE_ERRORS = {"co-rotating": "after", "fixed": "before"}


@overload
def presets() -> tuple[str, ...]: ...
@overload
def presets(name: None) -> tuple[str, ...]: ...
@overload
def presets(name: str, *, spindle_errors: str = ..., **parameters: float) -> Chain: ...
def presets(
    name: str | None = None, *, spindle_errors: str | None = None, **parameters: float
) -> Chain | tuple[str, ...]:
    """Return the chain of a common machine, or the names of all of them.

    Parameters
    ----------
    name : str, optional
        ``"fts_lathe"``, ``"sts_lathe"``, ``"mill_xyz"`` or ``"five_axis"``; without it, the names.
    spindle_errors : str, optional
        Of the lathes: ``"co-rotating"`` (eq 3 of [1]_: the errors turn with the workpiece; default
        of fts_lathe) or ``"fixed"`` (they stay in the machine, ISO 230-7; default of sts_lathe).
    **parameters : float, m
        ``radius`` of the workpiece (fts_lathe, > 0), ``pivot_height`` of the C table's datum above
        the axis of A (five_axis).

    Returns
    -------
    Chain or tuple of str
        The machine, or the names.

    Raises
    ------
    DataError
        The name, a parameter or the choice of the spindle errors is unknown, missing or out of
        range.
    UnitError
        A length is above 5 m: it was given in mm.

    Notes
    -----
    fts_lathe: 25 terms. Position X is the paper's x, 0 at the rim: the tool stands at the radius
    R - x; FTS is its current height s = S - z_f. **EXX runs along the workpiece's +X, against x**:
    a slide that stands 1 um too far along its own x has EXX = -1 um. Of every other axis of every
    preset the positioning error (EXX, EYY, EZZ, EZFTS, EAA, ECC) is that of its position. The spindle angle theta puts the cut point at the
    workpiece azimuth -theta. Z may be left out: it is then no joint, and its errors do nothing.
    B0Z is the paper's eta_zx with the sign of its eq 1 (eq 9 has the other one).

    Error motions are those that an instrument reads at the tool point (0, 0, 0) with the other axes
    at zero: an indicator there on its own line returns EYX, EZX and so on, own travel is no lever
    of an angle. For another point put ``measured_at_mm`` into `preset_table`. `Chain.describe` says
    for each axis where, in which directions and with which sign.

    References
    ----------
    .. [1] Micromachines 11 (2020) 331, eq 1-11 and Table 1.

    Examples
    --------
    >>> presets()
    ('five_axis', 'fts_lathe', 'mill_xyz', 'sts_lathe')
    >>> len(presets("fts_lathe", radius=20e-3).terms)
    25
    """
    if name is None:
        return _names()
    table = preset_table(name)
    if spindle_errors is not None:
        _choose_spindle(table, name, spindle_errors)
    chain = Chain.from_dict(table, **parameters)
    for key, value in parameters.items():
        if abs(value) > _LARGEST:
            raise UnitError(
                f"{key} of {name} is {value} m, more than {_LARGEST:g} m; lengths are in m, "
                "20 mm are 0.02"
            )
    if parameters.get("radius", 1.0) <= 0.0:
        raise DataError(f"radius of {name} is {parameters['radius']} m; it must be positive")
    return chain


def preset_table(name: str) -> dict[str, Any]:
    """Return the table of a preset, as its TOML file holds it.

    Parameters
    ----------
    name : str
        Name of the preset.

    Returns
    -------
    dict
        What `Chain.from_dict` takes; a new one each time.

    Raises
    ------
    DataError
        There is no such preset.

    Examples
    --------
    >>> [element["name"] for element in preset_table("mill_xyz")["element"]]
    ['Z', 'Y', 'X']
    """
    if name not in _names():
        raise DataError(f"there is no preset chain {name!r}; there are {', '.join(_names())}")
    file = files("metrosep.machine") / _FOLDER / f"{name}.toml"
    return tomllib.loads(file.read_text(encoding="utf-8"))


def _names() -> tuple[str, ...]:
    folder = files("metrosep.machine") / _FOLDER
    found = (f.name.removesuffix(".toml") for f in folder.iterdir() if f.name.endswith(".toml"))
    return tuple(sorted(found))


def _choose_spindle(table: dict[str, Any], name: str, choice: str) -> None:
    """Write the error frame of the spindle into the table."""
    if name not in _LATHES:
        raise DataError(f"{name} has no spindle errors to choose; {', '.join(_LATHES)} have")
    if choice not in tuple(_SPINDLE_ERRORS):
        known = ", ".join(_SPINDLE_ERRORS)
        raise DataError(f"spindle_errors is {choice!r}; known are {known}")
    for element in table["element"]:
        if element["name"] == "C":
            element["error_frame"] = _SPINDLE_ERRORS[choice]
