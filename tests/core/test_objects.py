"""Profile, Surface, Recording, Quantity: frozen, SI, NaN kept, asymmetry kept."""

import dataclasses
import math

import numpy as np
import pytest

import metrosep as ms
from metrosep.core.quantity import Quantity
from metrosep.errors import (
    CorruptFileError,
    DataError,
    InvalidSamplesError,
    MetrosepError,
    NameNotFoundError,
    NotUniformError,
    TooFewSamplesError,
    UnitError,
)

PM = 1e-12


def test_objects_are_frozen_and_their_arrays_too():
    profile = ms.Profile([0, 1e-3], [0, 1e-9])

    with pytest.raises(dataclasses.FrozenInstanceError):
        profile.x = None
    with pytest.raises(ValueError, match="read-only"):
        profile.z[0] = 1.0
    with pytest.raises(TypeError):
        profile.metadata["a"] = 1


def test_input_is_copied_not_kept():
    z = np.zeros(3)
    profile = ms.Profile([0, 1, 2], z)
    z[0] = 5.0

    assert profile.z[0] == 0.0


def test_descending_positions_are_turned_with_their_heights():
    profile = ms.Profile([3e-3, 2e-3, 1e-3], [7e-9, 0, 0])

    assert profile.x[0] == 1e-3
    assert profile.z.tolist() == [0, 0, 7e-9]


def test_profile_refuses_positions_it_cannot_use():
    with pytest.raises(InvalidSamplesError, match=r"x\[1\] = 0.001 m, x\[2\] = 0.001"):
        ms.Profile([0, 1e-3, 1e-3], [0, 0, 0])
    with pytest.raises(InvalidSamplesError, match="NaN at index 1"):
        ms.Profile([0, np.nan, 1], [0, 0, 0])
    with pytest.raises(InvalidSamplesError, match="infinite"):
        ms.Profile([0, 1], [0, np.inf])
    with pytest.raises(InvalidSamplesError, match="equally long"):
        ms.Profile([0, 1], [0])
    with pytest.raises(TooFewSamplesError):
        ms.Profile([], [])


def test_step_of_a_uniform_profile_and_refusal_of_another():
    assert ms.Profile(np.arange(5) * 1e-4, np.zeros(5)).dx == pytest.approx(1e-4, abs=PM)
    with pytest.raises(NotUniformError, match="resample"):
        _ = ms.Profile([0, 1, 3], [0, 0, 0]).dx


def test_line_removal_takes_a_plane_tilt_to_zero_and_ignores_gaps():
    x = np.linspace(0, 1e-2, 11)
    z = 3e-6 + 2e-4 * x
    z[4] = np.nan

    flat = ms.Profile(x, z).remove_line()

    assert np.nanmax(np.abs(flat.z)) < PM
    assert flat.n_invalid == 1
    assert flat.history[-1].parameters["slope_rad"] == pytest.approx(2e-4, rel=1e-9, abs=0.0)


def test_crop_keeps_the_right_side():
    profile = ms.Profile(np.arange(5.0), [0, 1, 2, 3, 4]).crop(2.5, 10)

    assert profile.z.tolist() == [3, 4]
    with pytest.raises(TooFewSamplesError, match="no sample between"):
        profile.crop(100, 200)


def test_peak_to_valley_and_rms_of_a_sine():
    x = np.linspace(0, 1, 1000, endpoint=False)
    profile = ms.Profile(x, 2e-9 * np.sin(2 * np.pi * 5 * x) + 1e-6)

    assert profile.peak_to_valley() == pytest.approx(4e-9, rel=1e-4, abs=0.0)
    assert profile.rms() == pytest.approx(2e-9 / np.sqrt(2), rel=1e-9, abs=0.0)


def test_all_invalid_gives_nan_not_zero():
    assert np.isnan(ms.Profile([0, 1], [np.nan, np.nan]).peak_to_valley())
    assert np.isnan(ms.Surface([[np.nan]]).rms())


@pytest.mark.parametrize("step", [0.0, -1e-6, np.nan, np.inf])
def test_surface_step_is_positive_or_none(step):
    with pytest.raises(InvalidSamplesError, match="lateral step"):
        ms.Surface([[0.0]], dx=step)
    assert ms.Surface([[0.0]]).dx is None


def test_surface_keeps_rows_and_columns_apart():
    z = np.zeros((2, 3))
    z[0, 2] = 1e-9
    surface = ms.Surface(z, dx=1e-6, dy=2e-6)

    assert surface.shape == (2, 3)
    assert surface.z[0, 2] == 1e-9
    assert "1 um x 2 um" in repr(surface)


def test_recording_finds_channels_by_name():
    recording = ms.Recording([0, 0.1, 0.2], {"gap": [1, 2, 3]}, units={"gap": "V"})

    assert recording["gap"].tolist() == [1, 2, 3]
    assert recording.duration == pytest.approx(0.2, abs=1e-15)
    with pytest.raises(NameNotFoundError, match="no channel 'gip'; the recording has gap"):
        recording["gip"]
    with pytest.raises(InvalidSamplesError, match="strictly increasing"):
        ms.Recording([0, 0], {"a": [1, 2]})
    with pytest.raises(InvalidSamplesError, match="has 1 samples"):
        ms.Recording([0, 1], {"a": [1]})


@pytest.mark.parametrize(
    "thing",
    [
        ms.Profile([0, 1e-3], [0, 1e-9]),
        ms.Surface([[0, 1e-9]], 1e-6, 1e-6),
        ms.Recording([0, 1], {"a<b": [1, 2]}),
        ms.RunSet([ms.Run([0, 1, 2], [0, 0, 0], feed=0.1)]),
    ],
)
def test_every_object_has_a_table_for_notebooks(thing):
    html = thing._repr_html_()

    assert "<table" in html
    assert "</table>" in html
    assert "a<b" not in html


def test_quantity_prints_value_unit_and_uncertainty():
    pv = ms.Quantity(1.25e-6, "m", "P-V, line removed", u=8e-9, symbol="PV")

    assert str(pv) == "1.25 um (u = 8 nm)"
    assert pv.to_dict()["u"] == 8e-9
    assert ms.Quantity(np.nan, "m", "x").to_dict()["value"] is None
    with pytest.raises(DataError, match="below zero"):
        ms.Quantity(1.0, "m", "x", u=-1.0)


@pytest.mark.parametrize("spec", [".3", ".3s", "12.3", ".<9.2", ".3f", "=9", "09"])
def test_digits_of_a_quantity_are_refused_and_its_unit_is_never_cut(spec):
    length = Quantity(2e-3, "m", "length")
    with pytest.raises(DataError, match=r"cannot be formatted.*float\(q\)"):
        format(length, spec)
    assert (f"{length}", f"{length:>6}", f"{length:.<6}", f"{length:s}") == (
        "2 mm", "  2 mm", "2 mm..", "2 mm",
    )  # fmt: skip


def test_one_tree_of_errors():
    assert issubclass(InvalidSamplesError, ValueError)
    assert issubclass(CorruptFileError, MetrosepError)
    error = CorruptFileError("a.dat", "too short", offset=12, field="width", expected=4, found=1)
    assert str(error) == (
        "a.dat: too short, field width, at offset 12, expected 4, found 1; re-export the file from "
        "the instrument or copy it again"
    )


def test_public_names_are_all_there_and_unknown_ones_are_not():
    for name in ms.__all__:
        assert getattr(ms, name) is not None
    with pytest.raises(AttributeError, match="no attribute 'nothing'"):
        _ = ms.nothing


@pytest.mark.parametrize(
    "heights",
    [
        [["1.0", "2.0"], ["3.0", "4.0"]],
        np.array([["1", "2"], ["3", "4"]], dtype=object),
        np.array([[True, False], [False, True]]),
        np.array([[1, 2], [3, 4]], dtype="timedelta64[ns]"),
    ],
    ids=["texts", "texts as objects", "a mask", "times"],
)
def test_heights_that_are_no_numbers_are_never_metres(heights):
    with pytest.raises(InvalidSamplesError, match="z must hold real numbers"):
        ms.Surface(heights, 1e-6, 1e-6)
    with pytest.raises(InvalidSamplesError, match="z must hold real numbers"):
        ms.Profile([0.0, 1e-6], np.asarray(heights)[0])


def test_quantities_compare_by_value_in_one_unit():
    small, large = Quantity(-4e-9, "m", "a"), Quantity(3e-9, "m", "b", u=1e-9)

    assert small < large <= large
    assert not small > large
    assert large > small
    assert sorted([large, small]) == [small, large]
    assert small < "-3 nm"
    assert large >= "0.003 um"
    assert abs(small) > large
    assert float(abs(small)) == 4e-9
    assert Quantity(2.0, "1", "Ssk") < 3
    assert not Quantity(math.nan, "m", "c") < large
    assert not Quantity(math.nan, "m", "c") > large


@pytest.mark.parametrize("other", ["5 deg", "5", 3e-9, None, Quantity(1.0, "rad", "tilt")])
def test_a_quantity_is_not_compared_with_another_dimension(other):
    with pytest.raises(UnitError):
        assert Quantity(3e-9, "m", "b") < other
