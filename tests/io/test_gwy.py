"""Gwyddion files: the real one, units, channels, masks, and trees that lie."""

import struct
import time
from pathlib import Path

import numpy as np
import pytest

import metrosep as ms
from metrosep.io.maps import gwy
from metrosep.io.source import RawFile

NM = 1e-9
DOUBLE = 1e-12  # relative; a product of two doubles
MANIFEST = 1e-6  # relative; digits of the manifest
QUICK = 2.0  # seconds; what a damaged file may take at most


@pytest.fixture
def samples(repository):
    return repository / "data_formats" / "gwy" / "samples"


def test_real_file_as_the_manifest_gives_it(corpus):
    """It states no unit: metres, and a warning that says so."""
    path = corpus / "gwyfile" / "test.gwy"
    data = path.read_bytes()
    start = data.index(b"data\0D\0\x40\0\0") + 10
    truth = np.frombuffer(data, "<f8", 128 * 128, start).reshape(128, 128)

    surface = ms.read(path)

    assert sum("metres were taken" in w for w in surface.metadata["warnings"]) == 2
    assert surface.shape == (128, 128)
    assert surface.n_invalid == 0
    assert (surface.dx, surface.dy) == (1.0, 1.0)
    assert surface.peak_to_valley() == pytest.approx(1e6 * NM, rel=MANIFEST, abs=0.0)
    assert surface.rms() == pytest.approx(187711.3 * NM, rel=MANIFEST, abs=0.0)
    np.testing.assert_array_equal(surface.z[::-1], truth)
    assert not np.array_equal(surface.z, truth)


def test_top_row_of_the_file_has_the_largest_y(samples):
    surface = ms.read(samples / "plain.gwy")

    assert np.unravel_index(np.nanargmax(surface.z), surface.shape) == (1, 0)
    assert np.isnan(surface.z[0, 1])
    assert surface.metadata["title"] == "Height"
    assert surface.metadata["offset_in_file"] == (1e-6, 0.0)


def test_channels_are_in_the_order_of_their_numbers(samples):
    path = samples / "first-of-two.gwy"

    assert ms.io.read.channels(path) == ("/2/data", "/10/data")
    np.testing.assert_array_equal(
        ms.read(path, channel="/10/data").z, ms.read(path, channel="Other").z
    )
    with pytest.raises(ms.errors.UnsupportedFeatureError, match="'/2/data', '/10/data'"):
        ms.read(path, channel="/0/data")


def test_masked_pixels_stay_valid_and_are_counted(samples):
    path = samples / "first-of-two.gwy"

    surface = ms.read(path)

    assert surface.metadata["n_masked"] == 2
    assert surface.n_invalid == 1
    assert ms.read(path, channel="Other").metadata["n_masked"] is None


def test_header_holds_every_field_but_the_arrays(samples):
    header = ms.read(samples / "first-of-two.gwy").metadata["header"]

    assert header["/2/data"]["xreal"] == 6e-6
    assert header["/2/data"]["data"] == "6 items of type D"
    assert header["/2/data/log"]["strings"] == ["one", "two"]
    assert header["/2/data/visible"] is True


def test_units_by_axis(samples):
    surface = ms.read(samples / "no-units.gwy", unit={"xy": "um", "z": "nm"})

    assert (surface.dx, surface.dy) == pytest.approx((2e-6, 0.5e-6), rel=DOUBLE, abs=0.0)
    assert np.nanmax(surface.z) == pytest.approx(90e-18, rel=DOUBLE, abs=0.0)


@pytest.mark.parametrize("unit", ["nm", {"z": "nm"}, {"height": "nm"}])
def test_unit_contradicting_the_file_is_refused(samples, unit):
    with pytest.raises(ms.errors.FormatMismatchError, match="unit= was given"):
        ms.read(samples / "plain.gwy", unit=unit)


def test_step_override_is_recorded(samples):
    surface = ms.read(samples / "no-steps.gwy", lateral_step="1 um")

    assert (surface.dx, surface.dy) == (1e-6, 1e-6)
    assert surface.metadata["lateral_step_in_file_m"] == (None, None)


def test_max_pixels(samples):
    with pytest.raises(ms.errors.UnsupportedFeatureError, match="max_pixels"):
        ms.read(samples / "plain.gwy", max_pixels=5)


def test_bytes_after_the_container_are_a_warning(samples, put):
    surface = ms.read(put((samples / "plain.gwy").read_bytes() + b"\0" * 7, "a.gwy"))

    assert "7 bytes follow" in surface.metadata["warnings"][0]


@pytest.mark.parametrize(
    ("old", "new", "match"),
    [
        (b"xres\0i", b"xres\0d", "expected|does not fit|larger|unknown type"),
        (b"xres\0i\3\0\0\0", b"xres\0i\xfd\xff\xff\xff", "xres"),
        (b"yres\0i\2\0\0\0", b"yres\0i\0\0\0\x80", "yres"),
        (b"yres\0", b"zres\0", "yres"),
        (b"xres\0i\3\0\0\0", b"xres\0i\xff\xff\xff\x7f", "max_pixels"),
        (b"GwyContainer", b"GwyKontainer", "expected GwyContainer"),
        (b"data\0D\6\0\0\0", b"data\0D\xff\xff\xff\xff", "field data"),
        (b"data\0D\6\0\0\0", b"data\0S\xff\xff\xff\xff", "no end"),
        (struct.pack("<d", 6e-6), struct.pack("<d", float("inf")), "xreal"),
        (struct.pack("<d", 6e-6), struct.pack("<d", -6e-6), "xreal"),
    ],
)
def test_tree_that_lies_is_a_read_error(samples, put, old, new, match):
    data = (samples / "plain.gwy").read_bytes()
    assert old in data
    start = time.process_time()

    with pytest.raises(ms.errors.ReadError, match=match):
        ms.read(put(data.replace(old, new), "a.gwy"), format="gwy")

    assert time.process_time() - start < QUICK


def test_real_file_cut_to_64_bytes_does_not_loop(corpus, put):
    data = (corpus / "gwyfile" / "test.gwy").read_bytes()[:64]
    start = time.process_time()

    with pytest.raises(ms.errors.CorruptFileError, match="GwyContainer"):
        ms.read(put(data, "a.gwy"))

    assert time.process_time() - start < QUICK


def test_many_empty_texts_are_not_allocated(put):
    n = 1_000_000
    body = b"strings\0S" + struct.pack("<I", n) + bytes(n)
    data = b"GWYPGwyContainer\0" + struct.pack("<I", len(body)) + body

    with pytest.raises(ms.errors.CorruptFileError, match="too many components"):
        ms.read(put(data, "a.gwy"))


def test_magic_alone_is_maybe():
    assert gwy.sniff(RawFile(Path("a.gwy"), b"GWYPx")) is ms.io.registry.Match.MAYBE
    assert gwy.sniff(RawFile(Path("a.gwy"), b"GWYO")) is ms.io.registry.Match.NO


def test_damage(samples, survives_damage):
    survives_damage(gwy, samples / "plain.gwy")
    survives_damage(gwy, samples / "first-of-two.gwy")
