"""Tool settings, noses and corrected paths refuse what they cannot mean, in their own words."""

import copy
import pickle

import numpy as np
import pytest

from metrosep import Surface
from metrosep.core.errors import (
    DataError,
    InvalidSamplesError,
    MetrosepError,
    TooFewSamplesError,
    UnitError,
)
from metrosep.forms import SineGrid
from metrosep.process.chip import cusp_height, max_chip_thickness
from metrosep.process.feedforward import corrected_path, corrected_points
from metrosep.process.nose import RoundNose, rake_error
from metrosep.process.nose_checks import clearance_check, gouge_check, window_check
from metrosep.process.setting_maps import setting_tolerance
from metrosep.process.tool_settings import ToolSetting, identify_setting

GRID = SineGrid(amplitude=50e-9, wavelength=100e-6)
TOOL = ToolSetting(1e-6, 0.0, 1e-5)
AXIS = 4e-6 * np.arange(-25, 26)
MAP = Surface(GRID(*np.meshgrid(AXIS, AXIS)), 4e-6, 4e-6, origin=(AXIS[0], AXIS[0]))
NOSE = RoundNose(1e-3, clearance=0.2, window=1.0)
SMALL = {"radius": 1e-4, "n_rho": 5, "n_theta": 5}
NUMBERS = [None, "a", float("nan"), float("inf"), [1.0, 2.0], 1 + 0j, True]


class ComplexGrid(SineGrid):
    """A form that an optics programme wrote."""

    def height(self, x, y):
        return super().height(x, y) * (1 + 0j)


NOT_FORMS = [
    None,
    "grid",
    MAP,
    lambda x, y: x,
    SineGrid,
    ComplexGrid(amplitude=50e-9, wavelength=1e-4),
]


def zero(x, y, z):
    return 0.0, 0.0, 0.0


TAKE_FORM = {
    "error": lambda form: TOOL.error(form, 1e-4),
    "error_map": lambda form: TOOL.error_map(form, **SMALL),
    "identify": lambda form: identify_setting(MAP, form),
    "tolerance": lambda form: setting_tolerance(form, 1e-9),
    "path": lambda form: corrected_path(form, TOOL, [1e-4], [0.0]),
    "rake": lambda form: rake_error(form, 1e-4, nose=NOSE),
    "gouge": lambda form: gouge_check(form, NOSE, **SMALL),
    "clearance": lambda form: clearance_check(form, NOSE, **SMALL),
    "window": lambda form: window_check(form, NOSE, **SMALL),
}


@pytest.mark.parametrize("call", TAKE_FORM)
@pytest.mark.parametrize(
    "form", NOT_FORMS, ids=["none", "str", "map", "function", "class", "complex"]
)
def test_what_is_no_form_is_refused(call, form):
    with pytest.raises(DataError, match=r"form|complex"):
        TAKE_FORM[call](form)


TAKE_NUMBER = {
    "n_rho": lambda v: TOOL.error_map(GRID, radius=1e-4, n_rho=v),
    "n_theta": lambda v: TOOL.error_map(GRID, radius=1e-4, n_theta=v),
    "radius": lambda v: gouge_check(GRID, NOSE, radius=v if v is not None else "a"),
    "region": lambda v: TOOL.error_map(GRID, region=(0.0, v)),
    "to_surface": lambda v: TOOL.error_map(GRID, **SMALL).to_surface(v if v is not None else "a"),
    "step": lambda v: TOOL.error_map(
        GRID, radius=1e-4, mesh="square", step=v if v is not None else "a"
    ),
    "cov": lambda v: ToolSetting(cov=v if v is not None else "a"),
    "dx": lambda v: ToolSetting(dx=v),
    "noise": lambda v: identify_setting(MAP, GRID, noise=v if v is not None else "a"),
    "nose_radius": lambda v: identify_setting(MAP, GRID, nose_radius=v if v is not None else "a"),
    "start": lambda v: identify_setting(MAP, GRID, start=v if v is not None else (1e-6, 0.0, 0.0)),
    "free": lambda v: identify_setting(MAP, GRID, free=v if v is not None else 3),
    "nose": RoundNose,
    "rake": lambda v: RoundNose(1e-3, rake=v),
    "gouge nose": lambda v: gouge_check(GRID, v, **SMALL),
    "rake nose": lambda v: rake_error(GRID, 1e-4, nose=v),
    "chip": lambda v: max_chip_thickness(v, 1e-6, 1e-6),
    "path setting": lambda v: corrected_path(GRID, v, [1e-4], [0.0]),
    "points": lambda v: corrected_points(zero, v),
    "error": lambda v: corrected_points(v, [[0.0, 0.0, 0.0]]),
    "error value": lambda v: corrected_points(lambda x, y, z: v, [[0.0, 0.0, 0.0]]),
    "tolerance": lambda v: corrected_points(zero, [[0.0, 0.0, 0.0]], tolerance=v),
    "most_steps": lambda v: corrected_points(zero, [[0.0, 0.0, 0.0]], most_steps=v),
    "wanted": lambda v: setting_tolerance(GRID, v, n_rho=5, n_theta=5),
}


@pytest.mark.parametrize("call", TAKE_NUMBER)
@pytest.mark.parametrize("value", NUMBERS, ids=str)
def test_what_is_no_number_is_refused_without_a_raw_error(call, value):
    with pytest.raises(MetrosepError):
        TAKE_NUMBER[call](value)


TAKE_ARRAY = {
    "x": lambda v: TOOL.error(GRID, v),
    "rake x": lambda v: rake_error(GRID, v, nose=NOSE),
    "slope": NOSE.contact,
    "azimuths": lambda v: setting_tolerance(GRID, 1e-9, azimuths=v, n_rho=5, n_theta=5),
    "rho": lambda v: corrected_path(GRID, TOOL, v, [0.0]),
    "theta": lambda v: corrected_path(GRID, TOOL, [1e-4], v),
    "cusp": lambda v: cusp_height(1e-3, v),
}


@pytest.mark.parametrize("call", TAKE_ARRAY)
@pytest.mark.parametrize(
    "value", ["a", [[1.0], [1.0, 2.0]], 1 + 0j, float("nan"), [None]], ids=str
)
def test_what_is_no_array_of_numbers_is_refused_without_a_raw_error(call, value):
    with pytest.raises(MetrosepError):
        TAKE_ARRAY[call](value)


def test_unequal_lengths_and_nothing_at_all():
    with pytest.raises(InvalidSamplesError, match=r"x.*\(2,\).*y.*\(3,\)"):
        TOOL.error(GRID, [1e-4, 2e-4], [1e-4, 1e-4, 1e-4])
    with pytest.raises(InvalidSamplesError, match="broadcast"):
        rake_error(GRID, [1e-4, 2e-4], [1e-4, 1e-4, 1e-4], nose=NOSE)
    for tool in (TOOL, ToolSetting(1e-6)):
        with pytest.raises(TooFewSamplesError, match="no point"):
            corrected_path(GRID, tool, [], [])


IN_OTHER_UNITS = {
    "map": lambda: TOOL.error_map(GRID, radius=500),
    "region": lambda: TOOL.error_map(GRID, region=(5, 500)),
    "place": lambda: TOOL.error(GRID, 100.0),
    "tolerance": lambda: setting_tolerance(GRID, 1e-9, radius=500),
    "gouge": lambda: gouge_check(GRID, NOSE, radius=500),
    "path": lambda: corrected_path(GRID, TOOL, [100.0], [0.0]),
    "rake": lambda: rake_error(GRID, 100.0, nose=NOSE),
    "nose": lambda: RoundNose(0.5),
    "chip": lambda: max_chip_thickness(0.5, 1e-6, 1e-6),
    "nose_radius": lambda: identify_setting(MAP, GRID, nose_radius=0.5),
    "noise": lambda: identify_setting(MAP, GRID, noise=1.0),
}


@pytest.mark.parametrize("call", IN_OTHER_UNITS)
def test_micrometres_and_millimetres_taken_for_metres_are_refused(call):
    with pytest.raises(UnitError, match="metres"):
        IN_OTHER_UNITS[call]()


def test_the_largest_turned_part_passes():
    assert TOOL.error_map(GRID, radius=1.0, n_rho=3, n_theta=3).z.shape == (3, 3)
    assert RoundNose(50e-3).radius == 50e-3


def stored(made):
    return pickle.loads(pickle.dumps(made))  # noqa: S301 - what this test wrote


def test_an_error_map_can_be_stored_and_copied():
    made = TOOL.error_map(GRID, **SMALL)
    for kept in (stored(made), copy.deepcopy(made)):
        np.testing.assert_array_equal(kept.z, made.z)
        np.testing.assert_array_equal(kept.to_surface(1e-5).z, made.to_surface(1e-5).z)
        assert dict(kept.audit) == dict(made.audit)
    paper = stored(TOOL.error_map(GRID, **SMALL, exact=False))
    expected = TOOL.error_map(GRID, radius=1e-4, mesh="square", step=1e-5, exact=False).z
    np.testing.assert_array_equal(paper.to_surface(1e-5).z, expected)
