"""OPD files: real file, scale by hand, orientation, unknown blocks, and directories that lie."""

import struct
from pathlib import Path

import numpy as np
import pytest

import metrosep as ms
from metrosep.io.declared import Match
from metrosep.io.maps.vision import opd
from metrosep.io.registry import identify
from metrosep.io.source import RawFile

NM = 1e-9
REL = 1e-6  # digits of the manifest of the corpus
EXACT = 1e-12  # double precision after two multiplications


@pytest.fixture
def folder(repository):
    return repository / "data_formats" / "opd" / "samples"


@pytest.fixture
def blocks_of():
    """Parse a directory without the reader: name to (entry's offset, content's offset, size)."""

    def parse(data):
        size = struct.unpack_from("<i", data, 20)[0]
        place, found = 2 + size, {}
        for entry in range(26, 2 + size, 24):
            name, _, length, _ = struct.unpack_from("<16shiH", data, entry)
            found.setdefault(name.rstrip(b"\0").decode("latin-1"), (entry, place, length))
            place += length
        return found

    return parse


@pytest.fixture
def patched(folder, put, blocks_of):
    """Write a sample with the content of one block changed and return its path."""

    def write(block, code, value, *, at=0, name="int16.opd", entry=False):
        data = bytearray((folder / name).read_bytes())
        struct.pack_into("<" + code, data, blocks_of(data)[block][0 if entry else 1] + at, value)
        return put(bytes(data), "patched.opd")

    return write


def test_real_file_as_independent_readers_give_it(corpus):
    path = corpus / "st" / "opd-1.opd"

    surface = ms.read(path)

    assert identify(path).id == "opd"
    assert surface.shape == (480, 640)
    assert surface.n_invalid == 116
    assert surface.dx == pytest.approx(1.9673303177114576e-07, rel=REL, abs=0.0)
    assert surface.dy == pytest.approx(surface.dx, rel=REL, abs=0.0)  # Aspect is 1 in this file
    assert surface.peak_to_valley() == pytest.approx(129.1542 * NM, rel=REL, abs=0.0)
    assert surface.rms() == pytest.approx(8.356451 * NM, rel=REL, abs=0.0)


def test_columns_of_the_real_file_become_columns(corpus, blocks_of):
    path = corpus / "st" / "opd-1.opd"
    data = path.read_bytes()
    _, offset, size = blocks_of(data)["Raw"]
    wavelength = struct.unpack_from("<f", data, blocks_of(data)["Wavelength"][1])[0]
    assert size == 6 + 4 * 480 * 640

    z = ms.read(path).z

    for column in (0, 100, 639):
        raw = np.frombuffer(data, "<f4", count=480, offset=offset + 6 + 4 * 480 * column)
        heights = np.where(raw < 1e38, raw.astype(float), np.nan) * wavelength * NM
        np.testing.assert_allclose(z[:, column], heights, rtol=EXACT, atol=0)


def test_real_file_tells_of_the_blocks_that_are_not_read(corpus):
    metadata = ms.read(corpus / "st" / "opd-1.opd").metadata

    assert metadata["header"]["Date"] == "7/7/2015"
    assert metadata["header"]["Image"] == {"columns": 640, "rows": 480, "item_bytes": 1}
    assert metadata["header"]["PixelSize"] == {"type": 15, "bytes": 52, "skipped": True}
    assert metadata["header"]["Magnification"] == pytest.approx(50.3, abs=0.1)
    assert metadata["wavelength_m"] == pytest.approx(577.3 * NM, abs=0.1 * NM)


def test_height_of_a_count_by_hand(folder):
    """577.25 nm / 4 a count; the largest value is the last of row 0, the hole the first of row 2."""
    surface = ms.read(folder / "int16.opd")

    assert surface.z[0, 3] == pytest.approx(30000 * 577.25 * NM / 4, rel=EXACT, abs=0.0)
    assert surface.z[0, 0] == pytest.approx(-5 * 577.25 * NM / 4, rel=EXACT, abs=0.0)
    assert np.isnan(surface.z[2, 0])
    assert surface.n_invalid == 1
    assert surface.metadata["row_order_in_file"] == "smallest y first"


def test_pixels_are_not_square(folder):
    surface = ms.read(folder / "float.opd")

    assert surface.dx == pytest.approx(1.5e-6, rel=REL, abs=0.0)
    assert surface.dy == pytest.approx(1.875e-6, rel=REL, abs=0.0)


def test_both_maps_are_channels_and_the_first_is_the_default(folder):
    path = folder / "two-maps.opd"
    file = ms.io.source.open_file(path)

    assert opd.channels(file) == ("RAW_DATA", "SAMPLE_DATA")
    assert ms.read(path).shape == (3, 4)
    assert ms.read(path, channel="SAMPLE_DATA").shape == (2, 4)


def test_image_is_not_a_height(folder):
    with pytest.raises(ms.errors.UnsupportedFeatureError, match="'Image'"):
        ms.read(folder / "float.opd", channel="Image")


def test_lateral_step_override_stands_beside_the_own_value(folder):
    surface = ms.read(folder / "int16.opd", lateral_step=("10 um", 20e-6))

    assert (surface.dx, surface.dy) == pytest.approx((10e-6, 20e-6), rel=EXACT, abs=0.0)
    assert surface.metadata["lateral_step_override_m"] == pytest.approx(
        (10e-6, 20e-6), rel=EXACT, abs=0.0
    )
    assert surface.metadata["lateral_step_in_file_m"] == pytest.approx(
        (1.5e-6, 1.875e-6), rel=REL, abs=0.0
    )


def test_unit_is_refused_since_the_format_has_one(folder):
    with pytest.raises(ms.errors.ReadError, match="takes no unit"):
        ms.read(folder / "int16.opd", unit="um")


def test_values_without_rule_are_marked_as_not_measured(patched):
    surface = ms.read(patched("Raw", "f", float("nan"), at=6, name="float.opd"))

    assert np.isnan(surface.z[0, 0])
    assert surface.n_invalid == 2


@pytest.mark.parametrize(
    ("change", "match"),
    [
        (("Wavelength", "f", 0.0), "Wavelength"),
        (("Wavelength", "f", float("nan")), "Wavelength"),
        (("Mult", "h", 0), "Mult"),
        (("Mult", "h", -4), "Mult"),
        (("Aspect", "f", 0.0), "Aspect"),
        (("Pixel_size", "f", -1.0), "Pixel_size"),
        (("Pixel_size", "f", float("inf")), "Pixel_size"),
        (("RAW_DATA", "H", 65535), "does not fit into its block"),
        (("RAW_DATA", "H", 0), "columns"),
    ],
)
def test_block_that_lies_is_a_read_error(patched, change, match):
    with pytest.raises(ms.errors.ReadError, match=match):
        ms.read(patched(*change))


@pytest.mark.parametrize(
    ("item", "match"), [(1, "8 bits"), (3, "does not fit"), (4, "does not fit")]
)
def test_size_of_a_point_is_checked(patched, item, match):
    with pytest.raises(ms.errors.ReadError, match=match):
        ms.read(patched("RAW_DATA", "H", item, at=4))


@pytest.mark.parametrize("block", ["Wavelength", "Mult", "Aspect", "Pixel_size"])
@pytest.mark.parametrize("kind", [3, 5, 15, 99])
def test_scale_of_an_unknown_type_is_never_skipped(patched, block, kind):
    """Without its Mult this file would be read four times too high."""
    with pytest.raises(ms.errors.CorruptFileError, match=rf"not stored as a number.*{block}"):
        ms.read(patched(block, "h", kind, at=16, entry=True))


def test_counts_without_their_divisor_are_refused(folder, put):
    data = (folder / "int16.opd").read_bytes().replace(b"Mult\0", b"Mulu\0")

    with pytest.raises(ms.errors.CorruptFileError, match=r"RAW_DATA is missing.*Mult"):
        ms.read(put(data, "renamed.opd"))


def test_length_decides_where_a_float_has_two_bytes(folder, patched):
    """Open readers report such files: Mult declared as a float, stored as a short."""
    surface = ms.read(patched("Mult", "h", 7, at=16, entry=True))

    np.testing.assert_array_equal(surface.z, ms.read(folder / "int16.opd").z)


@pytest.mark.parametrize("size", [-1, 2**31 - 1, 100000])
def test_block_beyond_the_file_is_named(patched, size):
    with pytest.raises(ms.errors.CorruptFileError, match="bytes of 'RAW_DATA'"):
        ms.read(patched("RAW_DATA", "i", size, at=18, entry=True))


@pytest.mark.parametrize("size", [0, 24, 25, -24, 2**31 - 8, 24000])
def test_directory_that_lies_is_a_read_error(folder, put, size):
    data = bytearray((folder / "int16.opd").read_bytes())
    struct.pack_into("<i", data, 20, size)

    with pytest.raises(ms.errors.CorruptFileError, match="Directory"):
        ms.read(put(bytes(data), "patched.opd"))


def test_more_points_than_allowed_are_refused(folder):
    with pytest.raises(ms.errors.UnsupportedFeatureError, match="max_pixels"):
        ms.read(folder / "int16.opd", max_pixels=11)


def test_bytes_after_the_last_block_are_a_warning(folder, put):
    data = (folder / "int16.opd").read_bytes() + b"\0" * 10

    surface = ms.read(put(data, "longer.opd"))

    assert "10 bytes follow" in surface.metadata["warnings"][0]


def test_directory_of_another_type_is_only_possible():
    head = b"\x01\0" + b"Directory".ljust(16, b"\0")

    assert opd.sniff(RawFile(Path("a.opd"), head + b"\x01\0")) is Match.YES
    assert opd.sniff(RawFile(Path("a.opd"), head + b"\x09\0")) is Match.MAYBE
    assert opd.sniff(RawFile(Path("a.opd"), b"Directory of results\n")) is Match.NO


def test_declared_format_with_other_content_is_a_mismatch(put):
    with pytest.raises(ms.errors.FormatMismatchError, match="Directory"):
        ms.read(put(b"x,y\n1,2\n", "a.opd"), format="opd")


@pytest.mark.parametrize("name", ["int16.opd", "float.opd"])
def test_damage_is_a_surface_or_a_read_error(folder, survives_damage, name):
    survives_damage(opd, folder / name)
