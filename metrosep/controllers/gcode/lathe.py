"""A lathe with a C axis as its control sees it: signs, units and words of X, C and Z.

The azimuth of the tool on the part, counter-clockwise seen from +z, and the word C belong together by

    azimuth = C0 - C   where C+ turns the workpiece counter-clockwise ("workpiece ccw"),
    azimuth = C0 + C   where C+ is the way of the tool round the work, ISO 841 ("tool ccw"),

both with the tool on +X of the spindle axis; half a turn more with the tool on -X, whose X words are
negative. A wrong choice cuts a mirrored part, and a symmetric part cannot tell.
specs/cutting-path.md, equation (28) with section 0a.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any, Literal, get_args

import numpy as np

from metrosep.controllers.gcode.state import INCH, MM
from metrosep.core import numbers
from metrosep.core._arrays import FloatArray
from metrosep.core.errors import DataError
from metrosep.core.options import option
from metrosep.core.units import format_length
from metrosep.forms.base import Form

CPositive = Literal["workpiece ccw", "tool ccw"]
ToolSide = Literal["+X", "-X"]
XWords = Literal["radius", "diameter"]
Unit = Literal["mm", "inch"]
Feed = Literal["G93", "G94", "G94 deg"]
InverseTime = Literal["1/min", "s", "1/s"]

UNITS = {"mm": MM, "inch": INCH}
_OVERSHOOT = 1.25
"""A spline through rounded points swings beyond them by that much; found by trial, see the page."""
_MOST_DECIMALS = 12


@dataclass(frozen=True, slots=True)
class LatheAxes:
    """What the words of a lathe mean; a fact of the machine, the same for every program.

    Parameters
    ----------
    c_positive : {"workpiece ccw", "tool ccw"}
        What turns counter-clockwise, seen from +z (out of the workpiece), as C grows. No default.
    tool_side : {"+X", "-X"}, optional
        On which side of the spindle axis the tool stands.
    c_zero : float, rad, optional
        Azimuth of the part under a tool on +X at C = 0.
    x_words : {"radius", "diameter"}, optional
        What an X word is.
    unit : {"mm", "inch"}, optional
        Of X and Z.
    feed : {"G93", "G94", "G94 deg"}, optional
        How time is written: inverse time, along X and Z per minute (RS274/NGC leaves turning axes out),
        or degrees of C per minute.
    inverse_time : {"1/min", "s", "1/s"}, optional
        What an F word of G93 is; no default, controls differ.
    c_wraps : bool, optional
        Whether C words stay from 0 to below 360 degrees.
    spline_word : str, optional
        Word of this control that joins the points by a C2 cubic spline, such as "CSPLINE".
    x_decimals, c_decimals, z_decimals : int, optional
        Digits after the point.

    Raises
    ------
    DataError
        If a choice is not known, or G93 has no unit of its F.

    Examples
    --------
    >>> axes = LatheAxes("workpiece ccw", inverse_time="1/min")
    >>> np.degrees(axes.c_of(np.radians([0.0, 30.0]))).round(9).tolist()
    [0.0, -30.0]
    """

    c_positive: CPositive = option(
        kind="text",
        choices=get_args(CPositive),
        help="what turns counter-clockwise, seen from +z, as C grows; a wrong choice cuts a mirrored part",
    )
    tool_side: ToolSide = option(
        "+X",
        kind="text",
        choices=get_args(ToolSide),
        help="side of the spindle axis with the tool",
    )
    c_zero: float = option(
        0.0, kind="angle", help="azimuth of the part under a tool on +X at C = 0"
    )
    x_words: XWords = option(
        "radius", kind="text", choices=get_args(XWords), help="what an X word is"
    )
    unit: Unit = option("mm", kind="text", choices=get_args(Unit), help="unit of X and Z words")
    feed: Feed = option(
        "G93",
        kind="text",
        choices=get_args(Feed),
        help="how time is written: inverse time, X and Z per minute, or degrees of C per minute",
    )
    inverse_time: InverseTime | None = option(
        None,
        kind="text",
        choices=get_args(InverseTime),
        help="what an F word of G93 is; controls differ",
    )
    c_wraps: bool = option(False, kind="flag", help="true: C words stay below 360 degrees")
    spline_word: str | None = option(
        None, kind="text", help='word of the control for a cubic spline, "CSPLINE"'
    )
    x_decimals: int = option(6, kind="integer", low=0, high=12, help="digits of X words")
    c_decimals: int = option(5, kind="integer", low=0, high=12, help="digits of C words")
    z_decimals: int = option(7, kind="integer", low=0, high=12, help="digits of Z words")

    def __post_init__(self) -> None:
        if self.c_positive not in get_args(CPositive):
            raise DataError(
                f"c_positive is {self.c_positive!r}; say what turns counter-clockwise, seen from +z, as C "
                'grows: "workpiece ccw" or "tool ccw" (ISO 841). Turn C by hand and look: a wrong choice '
                "cuts a mirrored part"
            )
        for name, kind in (
            ("tool_side", ToolSide),
            ("x_words", XWords),
            ("unit", Unit),
            ("feed", Feed),
        ):
            numbers.choice(getattr(self, name), name, get_args(kind))
        object.__setattr__(self, "c_zero", numbers.quantity(self.c_zero, "c_zero", "angle"))
        if self.inverse_time is not None:
            numbers.choice(self.inverse_time, "inverse_time", get_args(InverseTime))
        for name in ("x_decimals", "c_decimals", "z_decimals"):
            digits = numbers.count(getattr(self, name), name, least=0, most=_MOST_DECIMALS)
            object.__setattr__(self, name, digits)

    def require_inverse_time(self) -> InverseTime:
        """Return what an F word of G93 is, or refuse.

        Returns
        -------
        str
            One of "1/min", "s" and "1/s".

        Raises
        ------
        DataError
            If nobody said.
        """
        if self.inverse_time is None:
            raise DataError(
                'G93 is three different things: say inverse_time="1/min" (RS274/NGC and its kin), "s" '
                '(seconds of the block, Beckhoff/ISG) or "1/s"'
            )
        return self.inverse_time

    @property
    def way(self) -> float:
        """Sign of the azimuth of the tool on the part as C grows."""
        return -1.0 if self.c_positive == "workpiece ccw" else 1.0

    @property
    def _at_zero(self) -> float:
        return self.c_zero + (math.pi if self.tool_side == "-X" else 0.0)

    def c_of(self, azimuth: FloatArray) -> FloatArray:
        """Return C in rad for azimuths of the tool on the part.

        Parameters
        ----------
        azimuth : ndarray, rad
            Counter-clockwise, seen from +z.

        Returns
        -------
        ndarray, rad
            Not wrapped.
        """
        return np.asarray(self.way * (azimuth - self._at_zero) + 0.0)  # no minus zero

    def azimuth_of(self, c: FloatArray) -> FloatArray:
        """Return azimuths of the tool on the part for C, the inverse of `c_of`.

        Parameters
        ----------
        c : ndarray, rad
            Of the control.

        Returns
        -------
        ndarray, rad
            Counter-clockwise, seen from +z.
        """
        return np.asarray(self._at_zero + self.way * c)

    @property
    def x_scale(self) -> float:
        """Metres of radius for each unit of an X word; negative with the tool on -X."""
        size = UNITS[self.unit] * (0.5 if self.x_words == "diameter" else 1.0)
        return -size if self.tool_side == "-X" else size

    @property
    def z_scale(self) -> float:
        """Metres for each unit of a Z word."""
        return UNITS[self.unit]

    @property
    def steps(self) -> tuple[float, float, float]:
        """Last digit of X, C and Z: m, rad, m."""
        x = abs(self.x_scale) * 10.0**-self.x_decimals
        return x, math.radians(10.0**-self.c_decimals), self.z_scale * 10.0**-self.z_decimals

    def describe(self) -> list[str]:
        """Return what the words mean, a line each, for the head of a program.

        Returns
        -------
        list of str
            In plain words.
        """
        turns = (
            "the workpiece"
            if self.c_positive == "workpiece ccw"
            else "the tool round the workpiece"
        )
        zero = math.degrees(self.c_zero)
        return [
            f"X {self.unit} {self.x_words}, C deg, Z {self.unit} out of the material, absolute",
            f"C+ turns {turns} counter-clockwise seen from +Z, tool on {self.tool_side}",
            f"azimuth {zero:.9g} deg of the part under a tool on +X at C0",
        ]

    def to_dict(self) -> dict[str, Any]:
        """Return all fields as plain values.

        Returns
        -------
        dict
            Angles in degrees.
        """
        found = {n: getattr(self, n) for n in self.__dataclass_fields__ if n != "c_zero"}
        return found | {"c_zero_deg": math.degrees(self.c_zero)}


def rounding_error(axes: LatheAxes, form: Form, radius: float) -> float:
    """Return the largest error that the digits of the words can leave on a part.

    Parameters
    ----------
    axes : LatheAxes
        With its digits.
    form : Form
        The surface wanted.
    radius : float, m
        Of the part.

    Returns
    -------
    float, m
        Bound of the height error, either sign.

    Raises
    ------
    DataError
        If the form is not defined anywhere on the part.

    Notes
    -----
    ``1.25 (qZ/2 + |sX| qX/2 + |sY| rho qC/2)`` with the last digits q, the largest over a mesh of the
    part; a spline through rounded points swings beyond them, hence 1.25.

    Examples
    --------
    >>> from metrosep.forms import Toric
    >>> axes = LatheAxes("tool ccw", inverse_time="s", x_decimals=5, z_decimals=6, c_decimals=4)
    >>> round(rounding_error(axes, Toric(Rb=110e-3, Rd=70e-3), 2.8e-3) * 1e9, 2)
    0.88
    """
    rho, theta = np.meshgrid(
        np.linspace(0.0, radius, 61)[1:], np.linspace(0.0, 2.0 * math.pi, 90, endpoint=False)
    )
    c, s = np.cos(theta), np.sin(theta)
    gx, gy = form.gradient(rho * c, rho * s)
    along, across = np.abs(c * gx + s * gy), np.abs(c * gy - s * gx)
    qx, qc, qz = axes.steps
    errors = 0.5 * _OVERSHOOT * (qz + along * qx + across * rho * qc)
    if np.isnan(errors).all():
        raise DataError(f"the {form.name} is not defined anywhere within {format_length(radius)}")
    return float(np.nanmax(errors))
