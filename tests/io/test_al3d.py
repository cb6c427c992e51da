"""Alicona files: real file, padding of rows, the marker, orientation, and tags that lie."""

import struct
from pathlib import Path

import numpy as np
import pytest

import metrosep as ms
from metrosep.io.declared import Match
from metrosep.io.maps.profilers import al3d
from metrosep.io.registry import identify
from metrosep.io.source import RawFile

NM = 1e-9
REL = 1e-6  # digits of the manifest of the corpus
EXACT = 1e-12  # double precision
SINGLE = 1e-7  # a number that the file keeps in single precision


@pytest.fixture
def folder(repository):
    return repository / "data_formats" / "al3d" / "samples"


@pytest.fixture
def retagged(folder, put):
    """Write a sample with the value of one tag changed and return its path."""

    def write(key, value, name="padded.al3d"):
        data = bytearray((folder / name).read_bytes())
        place = data.index(key.encode().ljust(20, b"\0")) + 20
        data[place : place + 30] = str(value).encode("latin-1").ljust(30, b"\0")
        return put(bytes(data), "retagged.al3d")

    return write


def test_real_file_as_independent_readers_give_it(corpus):
    path = corpus / "st" / "al3d-1.al3d"

    surface = ms.read(path)

    assert identify(path).id == "al3d"
    assert surface.shape == (296, 200)
    assert surface.n_invalid == 0
    assert surface.dx == pytest.approx(4.38027e-07, rel=REL, abs=0.0)
    assert surface.dy == pytest.approx(4.38027e-07, rel=REL, abs=0.0)
    assert surface.peak_to_valley() == pytest.approx(34950.67 * NM, rel=REL, abs=0.0)
    assert surface.rms() == pytest.approx(7688.266 * NM, rel=REL, abs=0.0)


def test_rows_of_the_real_file_are_turned(corpus):
    path = corpus / "st" / "al3d-1.al3d"
    raw = np.array(struct.unpack_from("<59200f", path.read_bytes(), 1261)).reshape(296, 200)

    z = ms.read(path).z

    np.testing.assert_array_equal(z[::-1], raw)
    assert not np.array_equal(z, raw)


def test_real_file_says_how_coarse_its_floats_are(corpus):
    """Floats at 76 mm come in steps of 2^-27 m: no height of the file differs by less."""
    surface = ms.read(corpus / "st" / "al3d-1.al3d")

    rounding = surface.metadata["height_rounding_m"]
    steps = np.diff(np.unique(surface.z))
    assert rounding == 2.0**-27
    assert steps.min() == rounding


def test_top_row_of_the_file_has_the_largest_y(folder):
    surface = ms.read(folder / "padded.al3d")

    assert np.unravel_index(np.nanargmax(surface.z), surface.shape) == (3, 0)
    assert surface.z[3, 0] == pytest.approx(90e-6, rel=SINGLE, abs=0.0)
    assert np.isnan(surface.z[3, 2])
    assert surface.n_invalid == 1
    assert surface.metadata["row_order_in_file"] == "top row first"


def test_padding_of_odd_rows_is_no_height(folder):
    padded, even = ms.read(folder / "padded.al3d"), ms.read(folder / "even.al3d")

    np.testing.assert_array_equal(padded.z, even.z[:, :3])
    assert (folder / "padded.al3d").stat().st_size == (folder / "even.al3d").stat().st_size


def test_steps_differ(folder):
    surface = ms.read(folder / "padded.al3d")

    assert (surface.dx, surface.dy) == pytest.approx((4.38027e-07, 6.5e-07), rel=EXACT, abs=0.0)


def test_comment_and_tags_are_in_the_header(folder):
    metadata = ms.read(folder / "padded.al3d").metadata

    assert metadata["header"]["Comment"] == "planted bump, 5 µm"
    assert metadata["header"]["CreatingApplication"] == "MeasureSuite 5.3"
    assert metadata["invalid_value_m"] == pytest.approx(3.000000028082e15, rel=EXACT, abs=0.0)


@pytest.mark.parametrize("marker", ["3e15", "3.000000028082e+15", "2.9999999e15"])
def test_marker_is_compared_as_a_float_holds_it(retagged, marker):
    assert ms.read(retagged("InvalidPixelValue", marker)).n_invalid == 1


@pytest.mark.parametrize("marker", ["nan", "inf", "-3e15", "0", "3.1e15", "1e999"])
def test_marker_that_names_no_point_never_leaves_a_height_of_3e15_m(retagged, marker):
    with pytest.raises(ms.errors.CorruptFileError, match=r"InvalidPixelValue.*3e\+15 m"):
        ms.read(retagged("InvalidPixelValue", marker))


def test_map_that_does_not_end_at_the_next_part_is_a_warning(retagged):
    warnings = ms.read(retagged("Rows", 3)).metadata["warnings"]

    assert "ends at 997, but the next part begins at 1013" in warnings[0]


def test_map_that_runs_into_the_texture_is_a_warning(retagged):
    warnings = ms.read(retagged("TextureImageOffset", 1000)).metadata["warnings"]

    assert "the next part begins at 1000" in warnings[0]


def test_real_file_fits_without_a_gap(corpus):
    assert ms.read(corpus / "st" / "al3d-1.al3d").metadata["warnings"] == ()


def test_negative_marker_marks(folder, retagged, put):
    data = retagged("InvalidPixelValue", "-7e-06").read_bytes()
    data = data.replace(struct.pack("<f", 3e15), struct.pack("<f", 2e-6))

    surface = ms.read(put(data, "negative.al3d"))

    assert np.isnan(surface.z[1, 2])
    assert surface.n_invalid == 1


def test_lateral_step_override_stands_beside_the_own_value(folder):
    surface = ms.read(folder / "padded.al3d", lateral_step=("10 um", 20e-6))

    assert (surface.dx, surface.dy) == pytest.approx((10e-6, 20e-6), rel=EXACT, abs=0.0)
    own = surface.metadata["lateral_step_in_file_m"]
    assert own == pytest.approx((4.38027e-07, 6.5e-07), rel=EXACT, abs=0.0)


def test_unit_is_refused_since_the_format_has_one(folder):
    with pytest.raises(ms.errors.ReadError, match="takes no unit"):
        ms.read(folder / "padded.al3d", unit="um")


@pytest.mark.parametrize(
    ("key", "value", "match"),
    [
        ("Rows", 0, "Rows"),
        ("Cols", -4, "Cols"),
        ("Cols", "", "Cols"),
        ("Cols", "1e3", "a whole number"),
        ("Rows", 10**9, "more than 268435456"),
        ("Rows", 10**13, "a whole number"),
        ("Rows", 5, "does not fit"),
        ("Cols", 50, "does not fit"),
        ("DepthImageOffset", 10**6, "DepthImageOffset"),
        ("DepthImageOffset", 900, "after the tags"),
        ("TagCount", 10001, "TagCount"),
        ("TagCount", 200, "a tag"),
        ("PixelSizeXMeter", "inf", "PixelSizeXMeter"),
        ("PixelSizeYMeter", "-1e-6", "PixelSizeYMeter"),
        ("PixelSizeYMeter", "1 um", "a number"),
        ("InvalidPixelValue", "none", "InvalidPixelValue"),
    ],
)
def test_tag_that_lies_is_a_read_error(retagged, key, value, match):
    with pytest.raises(ms.errors.ReadError, match=match):
        ms.read(retagged(key, value))


@pytest.mark.parametrize("key", ["Rows", "Cols", "DepthImageOffset", "TagCount"])
def test_missing_tag_is_named(folder, put, key):
    data = (
        (folder / "padded.al3d")
        .read_bytes()
        .replace(key.encode() + b"\0", b"x" * len(key) + b"\0")
    )

    with pytest.raises(ms.errors.CorruptFileError, match=f"the tag {key} is missing"):
        ms.read(put(data, "missing.al3d"))


def test_magic_decides_not_the_suffix(folder, put):
    head = (folder / "even.al3d").read_bytes()

    assert al3d.sniff(RawFile(Path("x.csv"), head)) is Match.YES
    assert al3d.sniff(RawFile(Path("x.al3d"), head[:17] + b"Rows")) is Match.MAYBE
    assert al3d.sniff(RawFile(Path("x.al3d"), b"AliconaImaging results\n")) is Match.NO
    with pytest.raises(ms.errors.FormatMismatchError, match="AliconaImaging"):
        ms.read(put("x,y\n1,2\n", "a.al3d"), format="al3d")


@pytest.mark.parametrize("name", ["padded.al3d", "nan.al3d"])
def test_damage_is_a_surface_or_a_read_error(folder, survives_damage, name):
    survives_damage(al3d, folder / name)
