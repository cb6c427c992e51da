"""What a caller gives for one number: the same answer at every door that was sent through one check."""

import copy
import errno
import pickle

import numpy as np
import pytest

import metrosep as ms
from metrosep.core import numbers
from metrosep.errors import DataError, InvalidSamplesError, ReadError, UnitError
from metrosep.forms import (
    Asphere,
    Biconic,
    Conic,
    Cylinder,
    GridForm,
    QForbes,
    SineGrid,
    Sphere,
    Toric,
    Zernike,
)

Z = np.zeros((4, 4))
LINE = ms.Profile(np.linspace(0.0, 10e-3, 100), np.zeros(100))

LENGTHS = {
    "Surface dx": lambda v: ms.Surface(Z, v, 1e-6).dx,
    "Surface dy": lambda v: ms.Surface(Z, 1e-6, v).dy,
    "Surface origin": lambda v: ms.Surface(Z, 1e-6, 1e-6, origin=(0.0, v)).origin[1],
    "Sphere": lambda v: Sphere(R=v).R,
    "Conic": lambda v: Conic(R=v, k=0.0).R,
    "Cylinder": lambda v: Cylinder(R=v).R,
    "Toric": lambda v: Toric(Rb=1.0, Rd=v).Rd,
    "Biconic": lambda v: Biconic(Rx=v).Rx,
    "Asphere": lambda v: Asphere(R=v).R,
    "QForbes": lambda v: QForbes(R=v, radius=1e-3).R,
    "SineGrid": lambda v: SineGrid(amplitude=v, wavelength=1e-4).amplitude,
    "Zernike": lambda v: Zernike(4, radius=v).radius,
}
OTHERS = {
    "Run feed": lambda v: ms.Run(np.arange(4.0), np.zeros(4), feed=v),
    "RunSet.select feed": lambda v: ms.RunSet([ms.Run(np.arange(4.0), np.zeros(4))]).select(
        feed=v
    ),
    "Conic k": lambda v: Conic(R=1.0, k=v),
    "Cylinder angle": lambda v: Cylinder(R=1.0, angle=v),
    "Asphere a4": lambda v: Asphere(R=1.0, coefficients=[v]),
    "GridForm scale": lambda v: GridForm(ms.Surface(Z, 1e-6, 1e-6), scale=v),
    "gaussian": lambda v: ms.filters.gaussian(LINE, cutoff=v),
    "spline": lambda v: ms.filters.spline(LINE, cutoff=v),
    "Quantity": lambda v: ms.Quantity(v, "m", "height"),
}
DOORS = LENGTHS | OTHERS


@pytest.mark.parametrize("door", DOORS)
@pytest.mark.parametrize(
    "value", [True, np.True_, 1j, np.complex64(1.0), [1.0], np.array([2.0]), b"1", {"a": 1}]
)
def test_what_is_no_number_is_a_type_error_that_names_it(door, value):
    with pytest.raises(TypeError, match=r"must be .*, got") as caught:
        DOORS[door](value)
    assert isinstance(caught.value, DataError)


@pytest.mark.parametrize("door", DOORS)
def test_a_text_without_a_unit_is_never_metres(door):
    """``Surface(z, "3", 1e-6)`` was 3 m."""
    for text in ("3", "1e-6", ""):
        with pytest.raises(DataError, match=r"unit|must be"):
            DOORS[door](text)


@pytest.mark.parametrize("door", LENGTHS)
def test_a_length_with_its_unit_is_taken(door):
    assert LENGTHS[door]("0.35 mm") == 0.35e-3
    assert LENGTHS[door](np.float32(0.5)) == 0.5
    assert LENGTHS[door](np.array(0.25)) == 0.25
    for text in ("0.35 deg", "1,5 mm", "3 furlong"):
        with pytest.raises(UnitError):
            LENGTHS[door](text)


@pytest.mark.parametrize("door", [d for d in DOORS if d != "Quantity"])  # NaN: not determined
@pytest.mark.parametrize("value", [np.nan, np.inf, -np.inf])
def test_what_is_not_finite_is_refused_everywhere(door, value):
    with pytest.raises(DataError, match="finite"):
        DOORS[door](value)


def test_whole_numbers_and_choices():
    assert numbers.count(np.int8(3), "n") == 3
    for wrong in (True, 2.0, "2", None, [2]):
        with pytest.raises(TypeError, match="n must be a whole number from 1, got"):
            numbers.count(wrong, "n")
    with pytest.raises(InvalidSamplesError, match="whole number from 1, got 0"):
        numbers.count(0, "n")
    assert numbers.choice("a", "way", ("a", "b")) == "a"
    for wrong in ("c", True, None, ["a"]):
        with pytest.raises(TypeError, match="way is one of a, b, got"):
            numbers.choice(wrong, "way", ("a", "b"))


def test_a_surface_is_an_array_of_its_heights():
    """``np.asarray(surface)`` had the shape ()."""
    z = np.arange(12.0).reshape(3, 4) * 1e-9
    z[1, 2] = np.nan
    surface = ms.Surface(z, 1e-6, 1e-6)
    seen = np.asarray(surface)
    assert seen.shape == surface.shape == (3, 4)
    assert np.array_equal(seen, z, equal_nan=True)
    assert not seen.flags.writeable
    assert np.nanmax(surface) == z[2, 3]
    own = np.array(surface)
    own[0, 0] = 1.0
    assert surface.z[0, 0] == 0.0
    assert np.asarray(surface, dtype=np.float32).dtype == np.float32
    with pytest.raises(ValueError, match="needs a copy"):
        surface.__array__(np.float32, copy=False)
    assert np.asarray(LINE).shape == LINE.z.shape


def test_a_missing_file_is_a_file_not_found_error(tmp_path):
    for name in ("part.x3p", "runs.csv", "nothing"):
        with pytest.raises(FileNotFoundError, match="no such file") as caught:
            ms.read(tmp_path / name)
        for error in (
            caught.value,
            pickle.loads(pickle.dumps(caught.value)),  # noqa: S301
            copy.copy(caught.value),
        ):
            assert isinstance(error, ReadError)
            assert str(error) == str(caught.value) == caught.value.args[0]
            assert error.errno == errno.ENOENT
            assert error.filename == str(tmp_path / name)


@pytest.mark.parametrize(
    "door",
    [
        ms.Recipe.load,
        lambda path: ms.controllers.read(path, controller="csv"),
        ms.machine.Chain.from_toml,
        lambda path: ms.read_runs(path, x="x_mm", z="z_um"),
    ],
    ids=["recipe", "table", "machine", "runs"],
)
def test_what_is_not_there_is_a_file_not_found_error_at_every_door(tmp_path, door):
    with pytest.raises(FileNotFoundError, match=r"absent\.txt"):
        door(tmp_path / "absent.txt")


def test_a_wrong_keyword_is_a_type_error(tmp_path):
    path = tmp_path / "line.csv"
    path.write_text("x_mm,z_um\n0,0\n1,1\n2,1\n3,3\n")
    runs = ms.RunSet([ms.Run(np.linspace(0, 0.1, 50), np.zeros(50), feed=0.01)])
    for call in (
        lambda: ms.read(path, decimals=","),
        lambda: ms.read_runs(path, x="x_mm", z="z_um", bogus=1),
        lambda: ms.write(LINE, tmp_path / "o.csv", bogus=1),
        lambda: ms.separation.separate(runs, bogus=1),
        lambda: ms.filters.gaussian(LINE, cutoff=1e-3, bogus=1),
    ):
        with pytest.raises(TypeError, match=r"bogus|decimals"):
            call()


def test_a_range_takes_its_ends_and_nothing_beyond_nor_nan():
    assert numbers.between(0.5, "share", 0.0, 0.5) == 0.5
    assert numbers.not_negative("0 nm", "u_reading", dimension="length") == 0.0
    assert numbers.count(9, "degree", least=0, most=9) == 9
    for refused in (
        lambda: numbers.between(0.5000001, "share", 0.0, 0.5),
        lambda: numbers.between(float("nan"), "share", 0.0, 0.5),
        lambda: numbers.not_negative(-1e-300, "u_reading"),
        lambda: numbers.not_negative(float("inf"), "u_reading"),
        lambda: numbers.count(10, "degree", least=0, most=9),
    ):
        with pytest.raises(InvalidSamplesError, match=r"share|u_reading|degree"):
            refused()


@pytest.mark.parametrize("value", [0, 1, "true", None, np.ones(1, dtype=bool)])
def test_a_number_or_a_text_is_no_truth_value(value):
    with pytest.raises(DataError, match="robust is True or False"):
        numbers.flag(value, "robust")
    assert numbers.flag(np.True_, "robust") is True
