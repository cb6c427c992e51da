"""Arrays without a meaning (plain HDF5, .npy): what the caller declares, and what is refused."""

import h5py
import numpy as np
import pytest

import metrosep as ms
from metrosep.io.source import RawFile

Z = np.array([[1.0, 2.0, -3.0], [4.0, np.nan, 60.0]])


@pytest.mark.parametrize("descr", ["<f8", ">f8", "<f4", "<f2", ">i4", "|i1", "<u8"])
@pytest.mark.parametrize("order", ["C", "F"])
def test_numpys_own_files_of_every_type(tmp_path, descr, order):
    values = np.array([[1, 2, 3], [4, 5, 60]]).astype(descr)
    np.save(tmp_path / "a.npy", np.asarray(values, order=order))

    surface = ms.read(tmp_path / "a.npy", unit="um")

    np.testing.assert_allclose(surface.z, values.astype(float) * 1e-6, rtol=1e-15)


def test_profile_from_columns_and_from_a_step(tmp_path):
    table = np.array([[0.0, 5.0], [1.0, -6.0], [2.5, 7.0]])
    np.save(tmp_path / "t.npy", table)
    np.save(tmp_path / "l.npy", table[:, 1])

    by_columns = ms.read(tmp_path / "t.npy", x="column1:mm", z="column2:nm")
    by_step = ms.read(tmp_path / "l.npy", unit="nm", lateral_step="0.5 um")

    np.testing.assert_allclose(by_columns.x, [0.0, 1e-3, 2.5e-3], rtol=1e-15)
    np.testing.assert_allclose(by_step.z, [5e-9, -6e-9, 7e-9], rtol=1e-15)
    assert by_step.dx == pytest.approx(0.5e-6, rel=1e-9, abs=0.0)


X, DEVIATION = np.arange(12) * 0.25, np.array([3.0, 1, -4, 1, 5, 9, -2, 6, 5, 3, 5, 8])


@pytest.mark.parametrize("kind", ["npy", "npz", "txt"])
@pytest.mark.parametrize(
    "options",
    [{"unit": "mm,um"}, {"x": "1:mm", "z": "2:um"}, {"z": "2:um", "lateral_step": "250 um"}],
)
def test_columns_of_an_array_take_the_options_of_a_text_without_names(tmp_path, kind, options):
    table = np.column_stack([X, DEVIATION])
    path = tmp_path / f"a.{kind}"
    {"npy": np.save, "npz": np.savez, "txt": np.savetxt}[kind](path, table)

    profile = ms.read(path, **options)

    np.testing.assert_allclose(profile.x, X * 1e-3, rtol=1e-15)
    np.testing.assert_allclose(profile.z, DEVIATION * 1e-6, rtol=1e-15)


@pytest.mark.parametrize("save", [np.save, np.savez])
@pytest.mark.parametrize("options", [{}, {"unit": "um"}])
def test_few_columns_of_many_rows_are_asked_for(tmp_path, save, options):
    path = tmp_path / ("a.npy" if save is np.save else "a.npz")
    save(path, np.column_stack([X, DEVIATION]))

    with pytest.raises(ms.errors.AmbiguousFormatError, match=r"12 x 2 .* unit='mm,um'.* lateral_"):
        ms.read(path, **options)
    assert ms.read(path, unit="um", lateral_step="1 um").shape == (12, 2)


def test_whole_numbers_of_a_clock_keep_their_digits(tmp_path):
    counts = np.array([0, 3, 5, 100_007])
    np.save(
        tmp_path / "a.npy", np.column_stack([1_772_719_629_500_000_001 + counts, [4, 1, 5, 2]])
    )

    read = ms.read(tmp_path / "a.npy", time="1:ns")

    np.testing.assert_allclose(read.t, counts * 1e-9, rtol=1e-15)


@pytest.mark.parametrize(
    ("array", "match"),
    [
        (np.array([object()]), "objects never"),
        (np.array(["text"]), "only real numbers"),
        (np.zeros(3, dtype=complex), "only real numbers"),
        (np.zeros((2, 2, 2)), "one or two dimensions"),
        (np.float64(3.0), "one or two dimensions"),
    ],
    ids=["object", "text", "complex", "3-D", "0-D"],
)
def test_other_arrays_are_refused(tmp_path, array, match):
    np.save(tmp_path / "a.npy", array, allow_pickle=True)

    with pytest.raises(ms.errors.UnsupportedFeatureError, match=match):
        ms.read(tmp_path / "a.npy", unit="nm")


def test_a_claim_is_refused_before_it_is_allocated(tmp_path):
    np.save(tmp_path / "a.npy", Z)
    data = (tmp_path / "a.npy").read_bytes().replace(b"(2, 3)", b"(9" + b"9" * 6 + b", 3)")
    file = RawFile(tmp_path / "a.npy", data)

    with pytest.raises(ms.errors.ReadError, match=r"claims 29999997 values|do not agree"):
        ms.io.registry.get("npy").load_reader().read(file, unit="nm")


@pytest.fixture
def plain(tmp_path):
    path = tmp_path / "plain.h5"
    with h5py.File(path, "w") as handle:
        handle["map"] = Z
        handle["probe"] = np.array([1.0, -2.0, 4.0])
        handle["probe"].attrs["unit"] = "V"
        handle["stage/x"] = np.array([0.0, 1.0, 3.0])
        handle["label"] = "text"
    return path


def test_channels_are_the_arrays(plain):
    from metrosep.io.read import channels

    assert channels(plain) == ("/map", "/probe", "/stage/x")


def test_map_in_volts_needs_a_sensitivity(plain):
    surface = ms.read(plain, channel="/map", unit="V", scale="-2 um/V", lateral_step="1 um")

    np.testing.assert_allclose(surface.z, Z * -2e-6, rtol=1e-15)
    with pytest.raises(ms.errors.UnitError, match="scale="):
        ms.read(plain, channel="/map", unit="V")
    with pytest.raises(ms.errors.UnitError, match="a surface needs a length"):
        ms.read(plain, channel="/map", unit="s")


def test_profile_of_two_datasets(plain):
    profile = ms.read(plain, x="/stage/x:mm", z="/probe", scale="2.5 um/V")

    np.testing.assert_allclose(profile.x, [0.0, 1e-3, 3e-3], rtol=1e-15)
    np.testing.assert_allclose(profile.z, [2.5e-6, -5e-6, 10e-6], rtol=1e-15)


def test_recording_with_a_rate(plain):
    recording = ms.read(plain, sampling_rate="2 kHz")

    assert recording.t[-1] == pytest.approx(1e-3, rel=1e-9, abs=0.0)
    assert set(recording.channels) == {"/probe", "/stage/x"}
    assert recording.units == {"/probe": "V"}


@pytest.mark.parametrize(
    ("options", "error", "match"),
    [
        ({"channel": "/nothing"}, "FormatMismatchError", "there is '/map', '/probe'"),
        ({"channel": "/map"}, "UnitError", "declares no unit"),
        ({"x": "/stage/x", "z": "/probe"}, "UnitError", "sensitivity|no unit"),
        ({"sampling_rate": "0 Hz"}, "ReadError", "must be positive"),
    ],
)
def test_what_nobody_declared_is_refused(plain, options, error, match):
    with pytest.raises(getattr(ms.errors, error), match=match):
        ms.read(plain, **options)


def test_unit_of_the_file_cannot_be_overruled(tmp_path):
    path = tmp_path / "a.h5"
    with h5py.File(path, "w") as handle:
        handle["z"] = Z
        handle["z"].attrs["units"] = "nm"

    with pytest.raises(ms.errors.FormatMismatchError, match="is in nm by the file, but um"):
        ms.read(path, unit="um")
