"""4Sight maps: scale, invalid marker, several measurements, stale pixel, damage."""

from pathlib import Path

import h5py
import numpy as np
import pytest

import metrosep as ms
from metrosep.io.containers.interferometers import fourd
from metrosep.io.declared import Match
from metrosep.io.source import RawFile

NOT_MEASURED = np.finfo(np.float32).max
RTOL = 1e-12  # one multiplication in double precision


@pytest.fixture
def make(tmp_path):
    """Write a file with one measurement and return its path."""

    def write(rows, name="map.h5", dtype="f4", **changes):
        path = tmp_path / name
        facts = {"wavelength": b"632.8 nm", "height_units": b"wv", "wedge": 0.5, "xpix": b"1 mm"}
        with h5py.File(path, "w") as handle:
            group = handle.create_group("measurement0/genraw")
            for key, value in {**facts, **changes}.items():
                group.attrs[key] = np.bytes_(value) if isinstance(value, bytes) else value
            group["data"] = np.array(rows, dtype=dtype)
            handle["measurement0"].create_group("analyzed/opts").attrs["fit"] = "tilt"
        return path

    return write


def test_height_is_data_times_wavelength_times_wedge(make):
    rows = np.random.default_rng(1).normal(size=(7, 5)).astype(np.float32).astype(float)

    obj = ms.read(make(rows))

    np.testing.assert_allclose(obj.z, rows[::-1] * 632.8e-9 * 0.5, rtol=RTOL, atol=0)
    assert obj.metadata["height_per_wave_m"] == pytest.approx(316.4e-9, rel=RTOL, abs=0.0)


def test_first_row_of_the_file_is_taken_as_the_top(make):
    obj = ms.read(make([[9.0, 0.0, 0.0], [0.0, 0.0, 1.0]]))

    assert np.unravel_index(obj.z.argmax(), obj.shape) == (1, 0)
    assert obj.metadata["row_order_in_file"] == "top row first"
    assert obj.metadata["orientation_evidence"] == "rotation"


@pytest.mark.parametrize("marker", [NOT_MEASURED, np.inf, np.nan, -NOT_MEASURED])
def test_marker_is_not_a_height(make, marker):
    obj = ms.read(make([[1.0, marker], [2.0, 3.0]]))

    np.testing.assert_array_equal(np.isnan(obj.z), [[False, False], [False, True]])


def test_attributes_of_all_groups_are_recorded(make):
    header = ms.read(make([[1.0, 2.0]], lut_type=b"opd")).metadata["header"]

    assert header["/measurement0/genraw"]["wavelength"] == "632.8 nm"
    assert header["/measurement0/genraw"]["lut_type"] == "opd"
    assert header["/measurement0/analyzed/opts"] == {"fit": "tilt"}


def test_measurements_are_in_the_order_of_their_numbers(tmp_path):
    path = tmp_path / "many.h5"
    with h5py.File(path, "w") as handle:
        for number in (10, 2, 0):
            group = handle.create_group(f"measurement{number}/genraw")
            group.attrs.update({"wavelength": "1 um", "height_units": "wv", "wedge": 1.0})
            group["data"] = np.array([[number, 1.0]], dtype="f4")

    assert ms.io.read.channels(path) == ("measurement0", "measurement2", "measurement10")
    assert ms.read(path, channel="measurement10").z[0, 0] == pytest.approx(
        10e-6, rel=1e-9, abs=0.0
    )
    with pytest.raises(ms.errors.UnsupportedFeatureError, match="measurement3"):
        ms.read(path, channel="measurement3")


def test_stale_pixel_is_warned_of_and_replaced(make):
    path = make([[1.0, 2.0]], xpix=b"0.009029999 mm")

    obj = ms.read(path, lateral_step="87.3 um")

    assert obj.dx == pytest.approx(87.3e-6, rel=1e-9, abs=0.0)
    assert any("lateral_step=" in w for w in obj.metadata["warnings"])
    assert obj.metadata["lateral_step_in_file_m"] == pytest.approx(
        (9.029999e-6, 9.029999e-6), rel=1e-9, abs=0.0
    )
    assert obj.metadata["lateral_step_override_m"] == pytest.approx(
        (87.3e-6, 87.3e-6), rel=1e-9, abs=0.0
    )


def test_true_pixel_gives_no_warning(make):
    assert ms.read(make([[1.0, 2.0]])).metadata["warnings"] == ()


@pytest.mark.parametrize(
    ("change", "match"),
    [
        ({"wavelength": b"0 nm"}, "wavelength"),
        ({"wavelength": 632.8}, "no unit"),
        ({"wedge": np.nan}, "wedge"),
        ({"wedge": b"half"}, "wedge"),
        ({"aspect": -1.0}, "aspect"),
        ({"xpix": b"-1 mm"}, "xpix"),
    ],
)
def test_unusable_scale_is_refused(make, change, match):
    with pytest.raises(ms.errors.CorruptFileError, match=match):
        ms.read(make([[1.0, 2.0]], **change))


def test_map_of_another_kind_is_refused(make):
    with pytest.raises(ms.errors.UnsupportedFeatureError, match=r"'intensity' .lut_type"):
        ms.read(make([[1.0, 2.0]], lut_type=b"intensity"))


def test_line_is_no_map(make):
    with pytest.raises(ms.errors.CorruptFileError, match="two dimensions"):
        ms.read(make([1.0, 2.0]))


def test_more_pixels_than_allowed_are_refused(make):
    with pytest.raises(ms.errors.UnsupportedFeatureError, match="max_pixels="):
        ms.read(make(np.ones((3, 3))), max_pixels=8)


def test_unit_is_refused(make):
    with pytest.raises(ms.errors.ReadError, match="takes no unit"):
        ms.read(make([[1.0, 2.0]]), unit="nm")


def test_other_hdf5_is_not_4d(tmp_path):
    path = tmp_path / "other.h5"
    with h5py.File(path, "w") as handle:
        handle["genraw"] = [1.0]

    assert fourd.sniff(RawFile(Path("x.4D"), path.read_bytes())) is Match.NO
    with pytest.raises(ms.errors.CorruptFileError, match="no map of 4Sight"):
        fourd.read(RawFile(path))


def test_damage_is_refused_or_harmless(make, survives_damage):
    survives_damage(fourd, make([[1.0, 2.0]]), every=211)


@pytest.mark.parametrize(("mirrored", "fits"), [(False, True), (True, False)])
def test_maps_of_a_part_that_was_turned_fit_together_unmirrored(corpus, mirrored, fits):
    """A grating at 0, 90 and 180 degrees, counterclockwise: d180 = R d90 + d90, errors cancel."""
    maps = [ms.read(corpus / "fourd" / f"m2g1_{k}_dec4.h5").z for k in (0, 90, 180)]
    if mirrored:
        maps = [z[::-1] for z in maps]
    v = np.linspace(-1.0, 1.0, maps[0].shape[0])
    y, x = np.meshgrid(v, v, indexing="ij")
    inside = x**2 + y**2 < 1.1  # of the half diagonal squared: 0.55

    def turned(z):  # counterclockwise where y grows with the row
        return np.rot90(z, -1)

    def relief(z):
        use = inside & np.isfinite(z)
        terms = np.stack([x**i * y**j for i in range(3) for j in range(3 - i)], axis=-1)
        left = z - terms @ np.linalg.lstsq(terms[use], z[use], rcond=None)[0]
        return left

    d90, d180 = maps[1] - maps[0], maps[2] - maps[0]
    found, wanted = relief(turned(d90) + d90), relief(d180)
    use = inside & np.isfinite(found) & np.isfinite(wanted)
    correlation = np.corrcoef(found[use], wanted[use])[0, 1]

    assert correlation > 0.97 if fits else correlation < 0.05  # 3.6 of 18.1 nm are not of the part
