"""Plain HDF5: marks of missing values, scales of netCDF, and layouts that have their own reader."""

from pathlib import Path

import h5py
import numpy as np
import pytest

import metrosep as ms

SAMPLES = Path(__file__).parents[2] / "data_formats"


@pytest.fixture
def make(tmp_path):
    """Write one dataset with attributes and return the path of the file."""

    def write(values, dtype="f8", name="z", **attributes):
        path = tmp_path / "plain.h5"
        with h5py.File(path, "w") as handle:
            data = handle.create_dataset(name, data=np.array(values, dtype=dtype))
            data.attrs.update({"units": "um", **attributes})
        return path

    return write


@pytest.mark.parametrize("dtype", ["f4", "f8"])
def test_largest_float_is_not_a_height(make, dtype):
    obj = ms.read(make([[1.0, np.finfo("f4").max], [-np.inf, 2.0]], dtype))

    np.testing.assert_array_equal(np.isnan(obj.z), [[False, True], [True, False]])


@pytest.mark.parametrize("key", ["_FillValue", "missing_value"])
def test_declared_mark_is_not_a_height(make, key):
    obj = ms.read(make([[1, 2, -9999]], "i2", **{key: np.int16(-9999)}))

    np.testing.assert_allclose(obj.z, [[1e-6, 2e-6, np.nan]], rtol=1e-12, atol=0)


def test_scale_and_offset_of_netcdf_are_applied(make):
    path = make(
        [[1, 2, -9999]], "i2", scale_factor=0.5, add_offset=3.0, _FillValue=np.int16(-9999)
    )

    obj = ms.read(path)

    np.testing.assert_allclose(obj.z, [[3.5e-6, 4e-6, np.nan]], rtol=1e-12, atol=0)


@pytest.mark.parametrize("change", [{"scale_factor": 0.0}, {"add_offset": np.nan}])
def test_unusable_scale_is_refused(make, change):
    with pytest.raises(ms.errors.CorruptFileError, match="scale_factor or add_offset"):
        ms.read(make([[1.0, 2.0]], **change))


def test_scale_of_a_recording_is_applied(make):
    obj = ms.read(make([1.0, 2.0, 3.0], name="gap", scale_factor=2.0), sampling_rate="10 Hz")

    np.testing.assert_allclose(obj["/gap"], [2e-6, 4e-6, 6e-6], rtol=1e-12, atol=0)


def test_map_of_missing_values_is_refused(make):
    with pytest.raises(ms.errors.CorruptFileError, match="no point was measured"):
        ms.read(make([[np.finfo("f4").max] * 2]))


@pytest.mark.parametrize(
    ("sample", "own"),
    [
        ("fourd/samples/one.h5", "fourd"),
        ("datx/samples/fringes.datx", "datx"),
        ("metrosep-h5/samples/surface.h5", "metrosep-h5"),
    ],
)
def test_special_layout_names_its_reader(sample, own):
    with pytest.raises(ms.errors.FormatMismatchError, match=f"format='{own}'"):
        ms.read(SAMPLES / sample, format="hdf5", unit="nm")


def test_dataset_of_a_special_layout_may_be_named():
    path = SAMPLES / "fourd/samples/one.h5"

    obj = ms.read(path, format="hdf5", channel="/measurement0/genraw/data", unit="um")

    assert np.isnan(obj.z).sum() == 1


def test_special_names_far_behind_still_lead_to_the_reader(tmp_path):
    path = tmp_path / "late.4D"
    with h5py.File(path, "w") as handle:
        handle["padding"] = np.zeros(20000)
        for i in range(300):
            handle.create_group(f"a{i}/b")
        group = handle.create_group("measurement0/genraw")
        group.attrs.update({"wavelength": "1 um", "height_units": "wv", "wedge": 0.5})
        group["data"] = np.array([[1.0, 2.0]], dtype="f4")

    with pytest.raises(ms.errors.FormatMismatchError, match="format='fourd'"):
        ms.read(path, format="hdf5")

    assert ms.read(path).z[0, 1] == pytest.approx(1e-6, rel=1e-9, abs=0.0)
