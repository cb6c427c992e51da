"""BCR-STM files: real file, encodings, units, byte order, and headers that lie."""

import struct
from pathlib import Path

import numpy as np
import pytest

import metrosep as ms
from metrosep.io.declared import Match
from metrosep.io.maps import bcr_stm
from metrosep.io.registry import identify
from metrosep.io.source import RawFile

NM = 1e-9
REL = 1e-6  # digits of the manifest of the corpus
PM = 1e-12
FM = 1e-15


@pytest.fixture
def folder(repository):
    return repository / "data_formats" / "bcr-stm" / "samples"


@pytest.fixture
def edited(folder, put):
    """Write a sample with one text of its header replaced, its size kept, and return its path."""

    def write(old, new, name="integer.bcr"):
        data = (folder / name).read_bytes()
        old_bytes, new_bytes = (f"{t}\n".encode("latin-1") for t in (old, new))
        assert old_bytes in data
        head = data[:600].replace(old_bytes, new_bytes, 1).rstrip(b" ").ljust(600)
        return put(head + data[600:], "edited.bcr")

    return write


def test_real_file_as_the_manifest_gives_it(corpus):
    path = corpus / "st" / "bcrf-1.bcrf"

    surface = ms.read(path)

    assert identify(path).id == "bcr-stm"
    assert surface.shape == (600, 960)
    assert surface.n_invalid == 0
    assert surface.dx == pytest.approx(1.8514625e-06, rel=REL, abs=0.0)
    assert surface.dy == pytest.approx(1110878e-9 / 600, rel=REL, abs=0.0)
    assert surface.peak_to_valley() == pytest.approx(2223.759 * NM, rel=REL, abs=0.0)
    assert surface.rms() == pytest.approx(24.56021 * NM, rel=REL, abs=0.0)


def test_rows_of_the_real_file_are_turned(corpus):
    path = corpus / "st" / "bcrf-1.bcrf"
    raw = np.frombuffer(path.read_bytes(), "<f4", offset=4096).reshape(600, 960)

    z = ms.read(path).z

    np.testing.assert_allclose(z[::-1], raw.astype(float) * 1e-6, rtol=0, atol=FM)
    assert not np.array_equal(z, z[::-1])


@pytest.mark.parametrize("name", ["integer.bcr", "float.bcrf", "unicode.bcrf", "big-endian.bcr"])
def test_first_row_of_the_file_has_the_largest_y(folder, name):
    surface = ms.read(folder / name)

    assert np.unravel_index(np.nanargmax(surface.z), surface.shape) == (0, 3)
    assert np.isnan(surface.z[2, 3])
    assert (surface.dx, surface.dy) == pytest.approx((1e-6, 2e-6), abs=PM)
    assert surface.metadata["row_order_in_file"] == "top row first"


@pytest.mark.parametrize(
    ("encoding", "mark"), [("utf-16-le", "\ufeff"), ("utf-16-be", "\ufeff"), ("utf-16-be", "")]
)
def test_headers_in_utf16_with_and_without_a_mark(put, encoding, mark):
    text = mark + "fileformat = bcrf_unicode\nxpixels = 2\nypixels = 1\nxlength = 2\nylength = 1\n"
    path = put(text.ljust(2048).encode(encoding) + struct.pack("<2f", 1.5, 2.5), "wide.bcrf")

    surface = ms.read(path)

    np.testing.assert_allclose(surface.z, [[1.5e-9, 2.5e-9]], rtol=0, atol=FM)
    assert surface.dx == pytest.approx(1e-9, abs=FM)


def test_lateral_step_override_stands_beside_the_own_value(folder):
    surface = ms.read(folder / "integer.bcr", lateral_step=("10 um", 20e-6))

    assert (surface.dx, surface.dy) == pytest.approx((10e-6, 20e-6), abs=PM)
    assert surface.metadata["lateral_step_in_file_m"] == pytest.approx((1e-6, 2e-6), abs=PM)


def test_unit_that_contradicts_the_file_is_refused(folder):
    with pytest.raises(ms.errors.FormatMismatchError, match="in um by the file"):
        ms.read(folder / "float.bcrf", unit="nm")


def test_length_of_zero_is_uncalibrated(edited):
    surface = ms.read(edited("xlength = 4000.0", "xlength = 0"))

    assert surface.dx is None
    assert surface.dy == pytest.approx(2e-6, abs=PM)


def test_bytes_after_the_map_are_a_warning(folder, put):
    path = put((folder / "integer.bcr").read_bytes() + b"12", "longer.bcr")

    assert "2 bytes follow" in ms.read(path).metadata["warnings"][0]


@pytest.mark.parametrize(
    ("old", "new", "match"),
    [
        ("bit2nm = 0.25", "bit2nm = nan", "bit2nm"),
        ("bit2nm = 0.25", "bit2nm = -1", "bit2nm"),
        ("bit2nm = 0.25", "bit2nm = x", "bit2nm is not a number"),
        ("bit2nm = 0.25", "gain = 0.25", "bit2nm is missing"),
        ("xlength = 4000.0", "xlength = -1", "xlength"),
        ("xlength = 4000.0", "xlength = inf", "xlength"),
        ("xpixels = 4", "xpixels = 0", "xpixels"),
        ("xpixels = 4", "xpixels = -4", "xpixels"),
        ("xpixels = 4", "xpixels = 5", "does not fit into the file"),
        ("xpixels = 4", "xpixels = 4e2", "xpixels is not a number"),
        ("headersize = 600", "headersize = 60", "size of the header"),
        ("headersize = 600", "headersize = 99999999", "size of the header"),
        ("headersize = 600", "headersize = 700", "does not fit into the file"),
    ],
)
def test_header_that_lies_is_a_corrupt_file(edited, old, new, match):
    with pytest.raises(ms.errors.CorruptFileError, match=match):
        ms.read(edited(old, new))


def test_force_curves_are_unsupported(edited):
    with pytest.raises(ms.errors.UnsupportedFeatureError, match="force curves"):
        ms.read(edited("voidpixels = 1", "forcecurve = 1"))


def test_height_that_is_no_length_is_a_unit_error(edited):
    with pytest.raises(ms.errors.UnitError, match="zunit"):
        ms.read(edited("voidpixels = 1", "zunit = V"))


@pytest.mark.parametrize(
    "head", [b"fileformat = bcrx\n", b"fileformat=tiff\n", b"xpixels = 4\n", b""]
)
def test_other_text_is_not_recognised(put, head):
    assert bcr_stm.sniff(RawFile(Path("surface.bcr"), head)) is Match.NO
    with pytest.raises(ms.errors.FormatMismatchError, match="is not a BCR-STM file"):
        ms.read(put(head + b"1"), format="bcr-stm")


@pytest.mark.parametrize("name", ["integer.bcr", "float.bcrf"])
def test_damaged_files_are_refused_or_read(folder, survives_damage, name):
    survives_damage(bcr_stm, folder / name)
