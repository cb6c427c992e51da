"""Tolerances of a setting: the paper's number put right, closed forms, the worst of all signs."""

import itertools
import math

import numpy as np
import pytest

from metrosep.core.errors import DataError, UnitError
from metrosep.forms import SineGrid, Sphere
from metrosep.process.setting_maps import setting_tolerance
from metrosep.process.tool_settings import ToolSetting

NM, UM = 1e-9, 1e-6
A, WAVE = 50e-9, 100e-6
K = 2 * np.pi / WAVE
GRID = SineGrid(amplitude=A, wavelength=WAVE)
REGION = (5e-6, 500e-6)


def test_one_nanometre_on_the_line_of_the_paper():
    found = setting_tolerance(GRID, NM, region=REGION, azimuths=0.0)
    assert found.alone["dx"] / UM == pytest.approx(0.159, abs=0.0005)
    # exact: 4 A sin(k dx / 2) = 1 nm
    assert found.alone["dx"] == pytest.approx(2 / K * math.asin(NM / (4 * A)), rel=1e-3, abs=0)
    # dR phi^2 / 2 with phi = A k
    assert found.alone["dR"] == pytest.approx(2 * NM / (A * K) ** 2, rel=1e-3, abs=0)
    assert found.sensitivity["dx"] * 1e3 == pytest.approx(6.283, abs=0.001)
    assert found.limiting == "dx"


def test_the_map_allows_less_than_the_line_and_dy_as_much_as_dx():
    found = setting_tolerance(GRID, NM, region=REGION)
    assert found.alone["dx"] / UM == pytest.approx(1.0 / (31.06 / 3.5), abs=0.001)
    assert found.alone["dy"] == pytest.approx(found.alone["dx"], rel=0.01, abs=0)
    for name, value in found.alone.items():
        pv = ToolSetting(**{name: value}).error_map(GRID, region=REGION)
        assert pv.peak_to_valley() == pytest.approx(NM, rel=0.01, abs=0)


def test_together_is_the_worst_of_eight_sign_combinations():
    found = setting_tolerance(GRID, NM, region=REGION)
    worst = max(
        ToolSetting(
            *(s * found.together[n] for s, n in zip(signs, ("dx", "dy", "dR"), strict=True))
        )
        .error_map(GRID, region=REGION, n_rho=201, n_theta=180)
        .peak_to_valley()
        for signs in itertools.product((1, -1), repeat=3)
    )
    assert worst == pytest.approx(NM, rel=0.01, abs=0)
    assert all(found.together[n] < found.alone[n] for n in found.alone)


def test_a_sphere_has_closed_forms():
    """dx cuts a cone of slope rho / R, dR a paraboloid; dy acts to the second order only."""
    R, outer = 20e-3, 2e-3
    found = setting_tolerance(Sphere(R=R), 100 * NM, radius=outer)
    steepest = outer / math.sqrt(R**2 - outer**2)
    assert found.alone["dx"] == pytest.approx(100 * NM / steepest, rel=2e-3, abs=0)
    # exactly a sphere of radius R + dR
    bow = R - math.sqrt(R**2 - outer**2)
    wider = found.alone["dR"]
    changed = abs(R - wider - math.sqrt((R - wider) ** 2 - outer**2) - bow)
    assert changed == pytest.approx(100 * NM, rel=2e-3, abs=0)
    assert found.alone["dy"] > 50 * found.alone["dx"]
    assert any("core" in m for m in found.messages)


def test_what_leaves_no_trace_is_unlimited_and_said():
    flat = SineGrid(amplitude=0.0, wavelength=1e-4)
    found = setting_tolerance(flat, NM, radius=500e-6)
    assert set(found.alone.values()) == {math.inf}
    assert sum("leaves less than" in m for m in found.messages) == 3
    assert "any" in repr(found)


def test_bad_input_is_named():
    with pytest.raises(DataError, match="must be positive"):
        setting_tolerance(GRID, 0.0)
    with pytest.raises(DataError, match="must be positive"):
        setting_tolerance(GRID, math.nan)
    with pytest.raises(UnitError, match=r"limit 1 mm.* 1 um is 1e-06"):
        setting_tolerance(GRID, 1.0)
    with pytest.raises(UnitError, match="has no unit"):
        setting_tolerance(GRID, "1")
    with pytest.raises(DataError, match="azimuths is empty"):
        setting_tolerance(GRID, NM, azimuths=[])
    with pytest.raises(DataError, match="no value for R"):
        setting_tolerance(Sphere(), NM)
    with pytest.raises(DataError, match="anywhere"):
        setting_tolerance(Sphere(R=1e-3), NM, region=(2e-3, 3e-3))
    with pytest.raises(DataError, match="n_rho"):
        setting_tolerance(GRID, NM, n_rho=0)
