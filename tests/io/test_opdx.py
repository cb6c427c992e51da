"""Vision64 files: real profile against the vendor's text, units, row order, trees that lie."""

import struct
import time
from pathlib import Path

import numpy as np
import pytest

import metrosep as ms
from metrosep.io.declared import Match
from metrosep.io.maps.vision import opdx
from metrosep.io.registry import identify
from metrosep.io.source import RawFile, open_file

NM = 1e-9
REL = 1e-6  # digits of the manifest of the corpus
TEXT_DIGITS = 5e-8  # half a unit of the eighth digit, which the vendor's text keeps
EXACT = 1e-12  # double precision after two multiplications
QUICK = 2.0  # seconds; what a damaged file may take at most
MODULATION = 0x25E0C2  # where the matrix of a real map begins in the .opd of the corpus


@pytest.fixture
def folder(repository):
    return repository / "data_formats" / "opdx" / "samples"


@pytest.fixture
def edited(folder, put):
    """Replace bytes that occur once in a sample, and return the path of the result."""

    def write(name, old, new):
        data = (folder / name).read_bytes()
        assert data.count(old) == 1
        assert len(old) == len(new)
        return put(data.replace(old, new), f"edited-{name}")

    return write


def test_real_file_as_independent_readers_give_it(corpus):
    path = corpus / "st" / "opdx-3.opdx"

    profile = ms.read(path)

    assert identify(path).id == "opdx"
    assert len(profile) == 3001
    assert profile.dx == pytest.approx(1.6655562954266104e-08, rel=REL, abs=0.0)
    assert profile.peak_to_valley() == pytest.approx(17.15182 * NM, rel=REL, abs=0.0)
    assert profile.rms() == pytest.approx(5.307509 * NM, rel=REL, abs=0.0)
    assert profile.metadata["warnings"] == ()


def test_real_file_is_the_text_of_the_vendor_sample_by_sample(corpus):
    x, z = np.loadtxt(corpus / "st" / "opdx-3.txt", usecols=(0, 1), unpack=True)

    profile = ms.read(corpus / "st" / "opdx-3.opdx")

    np.testing.assert_allclose(profile.x, x, rtol=TEXT_DIGITS, atol=0)
    np.testing.assert_allclose(profile.z, z, rtol=TEXT_DIGITS, atol=0)


def test_nominal_scale_of_the_settings_is_not_used(corpus):
    metadata = ms.read(corpus / "st" / "opdx-3.opdx").metadata
    header = metadata["header"]

    nominal = header["/MetaData/MeasurementSettings/DataScale"]["value"] * 1e-6
    own = header["/1D_Data/Raw/DataScale"]

    assert own["unit"] == "µm"
    assert metadata["height_per_count_m"] == pytest.approx(own["value"] * 1e-6, rel=EXACT, abs=0.0)
    assert metadata["height_per_count_m"] > 1.2 * nominal


def test_origin_1_of_a_real_map_is_the_smallest_y_first(corpus):
    """A map in the same tree: its dark pixels are the invalid heights, which the .opd reader orders."""
    path = corpus / "st" / "opd-1.opd"
    modulation = np.frombuffer(path.read_bytes(), "<f4", 480 * 640, MODULATION + 8)
    modulation = modulation.reshape(480, 640)

    holes = np.isnan(ms.read(path).z)

    assert modulation[holes].mean() < 0.1 * modulation.mean()
    assert modulation[::-1][holes].mean() > 0.5 * modulation.mean()


def test_first_row_has_the_smallest_y_where_origin_says_so(folder):
    surface = ms.read(folder / "lower-left.opdx")

    assert np.unravel_index(np.nanargmax(surface.z), surface.shape) == (0, 3)
    assert np.isnan(surface.z[2, 0])
    assert surface.z[0, 3] == pytest.approx(900 * 0.25 * NM, rel=EXACT, abs=0.0)
    assert surface.metadata["row_order_in_file"] == "smallest y first"


def test_first_row_is_the_top_where_origin_is_missing(folder):
    surface = ms.read(folder / "top-first.opdx")

    assert np.unravel_index(np.nanargmax(surface.z), surface.shape) == (2, 3)
    assert np.isnan(surface.z[0, 0])
    assert surface.metadata["row_order_in_file"] == "top row first"


def test_extent_spans_the_points_less_one(folder):
    surface = ms.read(folder / "lower-left.opdx")

    assert (surface.dx, surface.dy) == pytest.approx((1.5e-6, 2.5e-6), rel=EXACT, abs=0.0)


def test_parser_of_the_test_gives_the_same_map(folder):
    data = (folder / "lower-left.opdx").read_bytes()
    start = data.index(b"WykoData.dll") + 12 + 2
    rows, columns = struct.unpack_from("<II", data, start)
    raw = np.frombuffer(data, "<f4", rows * columns, start + 8).reshape(rows, columns)

    surface = ms.read(folder / "lower-left.opdx")

    np.testing.assert_allclose(surface.z, raw * np.float64(0.25 * NM), rtol=EXACT, atol=0)


def test_channels_are_the_lengths_the_primary_one_first(folder):
    def of(name):
        return opdx.channels(open_file(folder / name))

    assert of("lower-left.opdx") == ("2D_Data/Raw",)
    assert of("primary.opdx") == ("2D_Data/Raw", "2D_Data/Second")
    assert of("both.opdx") == ("2D_Data/Raw", "1D_Data/Raw")
    assert of("profile.opdx") == ("1D_Data/Raw",)


def test_unknown_channel_is_refused_by_name(folder):
    with pytest.raises(ms.errors.UnsupportedFeatureError, match="'1D_Data/Raw'"):
        ms.read(folder / "both.opdx", channel="Intensity")


def test_lateral_step_override_stands_beside_the_own_value(folder):
    surface = ms.read(folder / "lower-left.opdx", lateral_step=("10 um", 20e-6))
    profile = ms.read(folder / "extent.opdx", lateral_step="1 um")

    assert (surface.dx, surface.dy) == pytest.approx((10e-6, 20e-6), rel=EXACT, abs=0.0)
    own = surface.metadata["lateral_step_in_file_m"]
    assert own == pytest.approx((1.5e-6, 2.5e-6), rel=EXACT, abs=0.0)
    assert profile.dx == pytest.approx(1e-6, rel=EXACT, abs=0.0)
    assert profile.metadata["lateral_step_in_file_m"] == pytest.approx(0.5e-6, rel=EXACT, abs=0.0)
    assert profile.metadata["lateral_step_override_m"] == pytest.approx(1e-6, rel=EXACT, abs=0.0)


def test_profile_without_positions_needs_a_step(edited):
    path = edited("extent.opdx", b"Extent", b"Umfang")

    with pytest.raises(ms.errors.UnitError, match="declare lateral_step="):
        ms.read(path)
    assert ms.read(path, lateral_step="1 um").dx == pytest.approx(1e-6, rel=EXACT, abs=0.0)


def test_unit_is_refused_since_the_format_has_one(folder):
    with pytest.raises(ms.errors.ReadError, match="takes no unit"):
        ms.read(folder / "profile.opdx", unit="um")


def test_settings_are_in_the_header(folder):
    header = ms.read(folder / "profile.opdx").metadata["header"]

    assert header["/MetaData/DataSetName"] == "planted bump, 5 µm"
    assert header["/MetaData/Offset"] == -7
    assert header["/MetaData/Valid"] is True
    assert header["/MetaData/TimeStamp"] == "000102030405060708"


def test_two_lists_of_positions_that_differ_are_a_warning(corpus, put):
    data = bytearray((corpus / "st" / "opdx-3.opdx").read_bytes())
    data[0x5EF4 + 5 + 8 * 1500] ^= 1  # last bit of one position in PositionArray

    profile = ms.read(put(bytes(data), "differs.opdx"))

    assert "two lists of positions differ" in profile.metadata["warnings"][0]


def test_bytes_after_the_tree_are_a_warning(folder, put):
    data = (folder / "profile.opdx").read_bytes()

    profile = ms.read(put(data + bytes(9), "longer.opdx"))

    assert "9 bytes follow" in profile.metadata["warnings"][0]


@pytest.mark.parametrize("left", [1, 2, 6, 7, 8])
def test_cut_terminator_is_refused(folder, put, left):
    data = (folder / "both.opdx").read_bytes()

    with pytest.raises(ms.errors.CorruptFileError):
        ms.read(put(data[:-left], "cut.opdx"))


def test_file_cut_between_two_containers_is_refused(folder, put):
    """Without MetaData the primary channel would be another one."""
    data = (folder / "primary.opdx").read_bytes()
    end = data.index(b"MetaData") - 4

    with pytest.raises(ms.errors.CorruptFileError, match="terminator"):
        ms.read(put(data[:end], "cut.opdx"))


@pytest.mark.parametrize(
    ("old", "new", "match"),
    [
        (struct.pack("<II", 3, 4), struct.pack("<II", 4, 3), "Dimension2Points"),
        (struct.pack("<II", 3, 4), struct.pack("<II", 2**31, 2**31), "more than 268435456"),
        (struct.pack("<II", 3, 4), struct.pack("<II", 0, 4), "rows"),
        (struct.pack("<II", 3, 4), struct.pack("<II", 3, 5), "another size"),
        (b"\x06\0\0\0Matrix\0", b"\x06\0\0\0Matrox\0", "unit of length"),
        (b"Dimension2Extent", b"Dimension9Extent", "Dimension2Extent"),
        (b"VisionDataMatrix<float>", b"VisionDataMatrix<int32>", "not of singles"),
        (struct.pack("<d", 0.25), struct.pack("<d", 0.0), "DataScale"),
        (struct.pack("<d", 0.25), struct.pack("<d", float("nan")), "DataScale"),
        (struct.pack("<d", 4.5), struct.pack("<d", -4.5), "Dimension2Extent"),
        (struct.pack("<d", 4.5), struct.pack("<d", float("inf")), "Dimension2Extent"),
    ],
)
def test_map_that_lies_is_a_read_error(folder, put, old, new, match):
    data = (folder / "lower-left.opdx").read_bytes()
    start = time.perf_counter()

    with pytest.raises((ms.errors.ReadError, ms.errors.UnitError), match=match):
        ms.read(put(data.replace(old, new, 1), "lies.opdx"))

    assert time.perf_counter() - start < QUICK


@pytest.mark.parametrize(
    ("old", "new", "match"),
    [
        (b"NumPoints\x0b\x06", b"NumPoints\x0b\x07", "NumPoints"),
        (
            b"Array\x40\x10\0\0\0double * __ptr64",
            b"Arrow\x40\x10\0\0\0double * __ptr64",
            "only settings",
        ),
        (b"DataScale\x13", b"DataScule\x13", "unit of length"),
    ],
)
def test_profile_that_lies_is_a_read_error(folder, put, old, new, match):
    data = (folder / "extent.opdx").read_bytes()
    assert old in data

    with pytest.raises((ms.errors.ReadError, ms.errors.UnitError), match=match):
        ms.read(put(data.replace(old, new, 1), "lies.opdx"))


def test_array_of_other_numbers_is_refused(folder, put):
    data = (folder / "extent.opdx").read_bytes()
    head = b"\x0d\x08\0\0\0"

    with pytest.raises(ms.errors.UnsupportedFeatureError, match="06 04 00 00 00"):
        ms.read(put(data.replace(head, b"\x06\x04\0\0\0", 1), "integers.opdx"))


def test_zero_extent_is_not_calibrated(folder, put):
    data = (folder / "lower-left.opdx").read_bytes()
    path = put(data.replace(struct.pack("<d", 4.5), bytes(8), 1), "zero.opdx")

    surface = ms.read(path)

    assert surface.dx is None
    assert surface.dy == pytest.approx(2.5e-6, rel=EXACT, abs=0.0)


def test_content_decides_not_the_suffix(folder, put):
    head = (folder / "profile.opdx").read_bytes()

    assert opdx.sniff(RawFile(Path("x.csv"), head)) is Match.YES
    assert opdx.sniff(RawFile(Path("x.opdx"), b"VCA DATA sheet\n")) is not Match.YES
    assert opdx.sniff(RawFile(Path("x.opdx"), b"")) is Match.NO
    with pytest.raises(ms.errors.FormatMismatchError, match="VCA DATA"):
        ms.read(put("x,y\n1,2\n", "a.opdx"), format="opdx")


@pytest.mark.parametrize("name", ["top-first.opdx", "extent.opdx"])
def test_damage_is_a_measurement_or_a_read_error(folder, survives_damage, name):
    survives_damage(opdx, folder / name)
