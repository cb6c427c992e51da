"""The virtual part against foreign reference cuts, and against an envelope in another frame."""

import math

import numpy as np
import pytest

from metrosep.core.errors import DataError
from metrosep.forms import Expression, Sphere, Toric
from metrosep.process import (
    EdgeProfile,
    RoundNose,
    ToolSetting,
    TurningProgram,
    tip_path,
    virtual_cut,
)

NM, UM, MM = 1e-9, 1e-6, 1e-3
R = 0.6e-3
TORUS = Toric(Rb=110e-3, Rd=70e-3)
WAVES = Expression("3e-6*(sin(2*pi*x/7e-4)+cos(2*pi*y/7e-4))")
SET = ToolSetting(dx=0.3e-6, dy=-0.2e-6, dR=3e-6)
PLACES = np.array([[1.0, 0.3], [1.5, -2.0], [2.0, 1.4], [2.5, 3.0]])


def spiral(
    form, nose, sense, *, outer=3e-3, feed=10e-6, per_turn=120, first=-10, inner=0.6e-3, **words
):
    """Tips at constant angle, from `first` turns before `outer` on."""
    turns = (outer - inner) / feed - first
    T = 2 * np.pi * (first + np.arange(round(turns * per_turn)) / per_turn)
    X = outer - feed * T / (2 * np.pi)
    azimuth = -T if sense == "clockwise" else T
    Z = tip_path(form, X, azimuth, nose=nose, sense=sense).z
    return TurningProgram(X, azimuth, Z, (T - T[0]) / (2 * np.pi), "tip", **words)


@pytest.mark.parametrize(
    ("form", "degrees", "sense", "spline", "linear", "off"),
    [
        (TORUS, 0, "counterclockwise", (18.9207, 19.1247, 18.8578, 0.8123),
         (20.0800, 17.5190, 13.6737, 9.7462), (13.6193, 10.2436, 10.6399, -7.7338)),
        (TORUS, -30, "counterclockwise", (10.8144, 6.0498, 5.0216, 0.9351),
         (11.9785, 4.4314, -0.1491, 9.8722), (6.2666, -1.5476, -5.9136, -6.5229)),
        (TORUS, -30, "clockwise", (6.1819, 0.3614, 2.3480, 0.3730),
         (7.3487, -1.2410, -2.7976, 9.3263), (2.1041, -5.2999, -6.0425, -7.3126)),
        (WAVES, 0, "counterclockwise", (6.6659, 5.0301, 1.7873, 14.7513),
         (59.4603, -64.0157, -0.1067, 389.5285), (9.6827, 11.1592, 1.2772, 7.2471)),
        (WAVES, -30, "clockwise", (10.2810, 9.2041, 14.5443, 19.7556),
         (63.1474, -61.1307, 11.4039, 396.0224), (13.0061, 12.3716, 11.7759, 13.0749)),
    ],
)  # fmt: skip
def test_reference_cuts(form, degrees, sense, spline, linear, off):
    """specs/cutting-path.md, table 6.3, foreign code."""
    nose = RoundNose(R, math.radians(degrees))
    rho, theta = PLACES[:, 0] * MM, PLACES[:, 1]
    x, y = rho * np.cos(theta), rho * np.sin(theta)
    made = {w: spiral(form, nose, sense, interpolation=w) for w in ("spline", "linear")}
    for words, setting, expected in (
        ("spline", None, spline),
        ("linear", None, linear),
        ("spline", SET, off),
    ):
        found = virtual_cut(made[words], nose, x, y, form=form, setting=setting)
        assert found.error / NM == pytest.approx(expected, abs=1e-3)
