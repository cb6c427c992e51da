"""Surface data files: real file, binary layout by struct, headers that lie, and the writer."""

import struct
from pathlib import Path

import numpy as np
import pytest

import metrosep as ms
from metrosep.io.declared import Match
from metrosep.io.maps import sdf
from metrosep.io.maps.sdf import sdf_bytes
from metrosep.io.registry import identify, structure
from metrosep.io.source import RawFile

NM = 1e-9
REL = 1e-6  # digits of the manifest of the corpus
PM = 1e-12
FM = 1e-15


@pytest.fixture
def folder(repository):
    return repository / "data_formats" / "sdf" / "samples"


@pytest.fixture
def edited(folder, put):
    """Write a text sample with one text replaced and return its path."""

    def write(old, new, name="text.sdf"):
        text = (folder / name).read_text(encoding="ascii")
        assert old in text
        return put(text.replace(old, new, 1), "edited.sdf")

    return write


@pytest.fixture
def patched(folder, put):
    """Write the binary sample of doubles with one field changed and return its path."""
    codes = {name: (offset, code) for offset, code, name in structure("sdf").layout}

    def write(**fields):
        data = bytearray((folder / "binary-type7.sdf").read_bytes())
        for name, value in fields.items():
            offset, code = codes[name]
            struct.pack_into("<" + code, data, offset, value)
        return put(bytes(data), "patched.sdf")

    return write


def test_real_file_as_the_manifest_gives_it(corpus):
    path = corpus / "st" / "sdf-1.sdf"

    surface = ms.read(path)

    assert identify(path).id == "sdf"
    assert surface.shape == (4, 7)
    assert surface.n_invalid == 0
    assert (surface.dx, surface.dy) == pytest.approx((1e-6, 1e-6), rel=REL, abs=0.0)
    assert surface.peak_to_valley() == pytest.approx(50.93 * NM, rel=REL, abs=0.0)
    assert surface.rms() == pytest.approx(13.6029 * NM, rel=REL, abs=0.0)
    assert surface.metadata["header"]["ManufacID"] == "ISOTC213"
    assert "Tom Jones" in surface.metadata["header"]["trailer"]


def test_real_file_number_by_number(corpus):
    path = corpus / "st" / "sdf-1.sdf"
    body = path.read_text().split("*")[1].split()

    z = ms.read(path).z

    np.testing.assert_allclose(z.ravel(), np.array(body, dtype=float) * 1e-6, rtol=0, atol=FM)


@pytest.mark.parametrize("name", ["text.sdf", "binary-type5.sdf", "binary-iso2.sdf"])
def test_first_profile_has_the_smallest_y(folder, name):
    surface = ms.read(folder / name)

    assert np.unravel_index(np.nanargmax(surface.z), surface.shape) == (2, 3)
    assert np.isnan(surface.z[0, 3])
    assert (surface.dx, surface.dy) == pytest.approx((1e-6, 2e-6), abs=PM)
    assert surface.metadata["row_order_in_file"] == "smallest y first"


@pytest.mark.parametrize(("kind", "code"), list(enumerate("BHIfbhid")))
def test_binary_types_by_struct(put, kind, code):
    head = struct.pack(
        "<8s10s12s12sHH4d3B", b"bBCR-1.0", *[b""] * 3, 3, 2, 1e-6, 2e-6, 1e-9, 0, 0, kind, 0
    )
    path = put(head + struct.pack("<6" + code, 1, 2, 3, 4, 5, 96), "typed.sdf")

    surface = ms.read(path)

    expected = np.array([[1, 2, 3], [4, 5, 96]]) * NM
    np.testing.assert_allclose(surface.z, expected, rtol=1e-12, atol=0)


def test_fields_of_the_table_follow_one_another():
    ends = [offset + struct.calcsize("<" + code) for offset, code, _ in structure("sdf").layout]

    assert [offset for offset, _, _ in structure("sdf").layout[1:]] == ends[:-1]
    assert ends[-1] == 81


def test_one_profile_is_a_profile_and_takes_a_declared_step(folder):
    profile = ms.read(folder / "one-profile.sdf", lateral_step="1 um")

    assert isinstance(profile, ms.Profile)
    assert profile.dx == pytest.approx(1e-6, abs=PM)
    assert profile.metadata["lateral_step_in_file_m"] == pytest.approx(2.5e-7, abs=PM)
    assert profile.n_invalid == 1


def test_one_profile_without_a_step_asks_for_it(edited):
    path = edited("Xscale = 2.5e-07", "Xscale = 0", "one-profile.sdf")

    with pytest.raises(ms.errors.UnsupportedFeatureError, match="lateral_step="):
        ms.read(path)
    assert ms.read(path, lateral_step=1e-6).dx == pytest.approx(1e-6, abs=PM)


def test_uncalibrated_is_none_and_an_override_is_recorded(folder):
    plain = ms.read(folder / "uncalibrated.sdf")
    declared = ms.read(folder / "uncalibrated.sdf", lateral_step=("10 um", "20 um"))

    assert (plain.dx, plain.dy) == (None, None)
    assert declared.metadata["lateral_step_in_file_m"] == (None, None)
    assert declared.metadata["lateral_step_override_m"] == pytest.approx((10e-6, 20e-6), abs=PM)


def test_nan_is_read_as_bad_is(edited):
    surface = ms.read(edited("BAD", "nan"))

    assert surface.n_invalid == 1


@pytest.mark.parametrize(
    ("old", "new", "match"),
    [
        ("Zscale = 1e-09", "Zscale = 0", "Zscale"),
        ("Zscale = 1e-09", "Zscale = -1e-9", "Zscale"),
        ("Zscale = 1e-09", "Zscale = inf", "Zscale"),
        ("Zscale = 1e-09", "Zscale = x", "Zscale is not a number"),
        ("Zscale = 1e-09\n", "", "Zscale is missing"),
        ("Xscale = 1e-06", "Xscale = -1e-06", "Xscale"),
        ("Xscale = 1e-06", "Xscale = inf", "Xscale"),
        ("NumPoints = 4", "NumPoints = 0", "NumPoints"),
        ("NumPoints = 4", "NumPoints = -4", "NumPoints"),
        ("NumPoints = 4", "NumPoints = 4.5", "NumPoints is not a number"),
        ("NumPoints = 4", "NumPoints = 5", "do not fill the map"),
        ("NumPoints = 4", "NumPoints = 3", "do not fill the map"),
        ("NumPoints = 4", "NumPoints = 4000", "do not fill the map"),
        ("90 10", "90 1O", "'1O'"),
        ("\n*\n90", "\n90", "a height is not a number"),
    ],
)
def test_text_that_lies_is_a_corrupt_file(edited, old, new, match):
    with pytest.raises(ms.errors.CorruptFileError, match=match):
        ms.read(edited(old, new))


@pytest.mark.parametrize(
    ("fields", "match"),
    [
        ({"Zscale": float("nan")}, "Zscale"),
        ({"Zscale": 0.0}, "Zscale"),
        ({"Xscale": -1e-6}, "Xscale"),
        ({"NumPoints": 0}, "NumPoints"),
        ({"NumPoints": 60000, "NumProfiles": 4000}, "does not fit into the file"),
        ({"NumPoints": 2, "NumProfiles": 3}, "is not text"),
        ({"DataType": 6}, "is not text"),
    ],
)
def test_binary_header_that_lies_is_a_corrupt_file(patched, fields, match):
    with pytest.raises(ms.errors.CorruptFileError, match=match):
        ms.read(patched(**fields))


@pytest.mark.parametrize(
    ("fields", "match"),
    [
        ({"Compression": 1}, "Compression 1"),
        ({"CheckType": 2}, "CheckType 2"),
        ({"DataType": 9}, "DataType 9"),
        ({"NumPoints": 65535, "NumProfiles": 65535}, "65535 x 65535"),
    ],
)
def test_what_is_not_read_is_named(patched, fields, match):
    with pytest.raises(ms.errors.UnsupportedFeatureError, match=match):
        ms.read(patched(**fields))


def test_nan_step_is_uncalibrated_with_a_warning(patched):
    surface = ms.read(patched(Yscale=float("nan")))

    assert surface.dy is None
    assert "Yscale is NaN" in surface.metadata["warnings"][0]


def test_version_with_blanks_is_read(edited):
    """As a program of a metrology institute writes it."""
    surface = ms.read(edited("aISO-1.0", "aBCR - 1.0"))

    assert surface.metadata["header"]["version"] == "aBCR-1.0"


@pytest.mark.parametrize("head", [b"aISO-3.0\n", b"bISO-9.0", b"ISO-1.0", b"aISO-1.0x"])
def test_other_versions_are_not_recognised(put, head):
    assert sdf.sniff(RawFile(Path("surface.sdf"), head)) is Match.NO
    with pytest.raises(ms.errors.FormatMismatchError, match="is not a surface data file"):
        ms.read(put(head + b"\n*\n1\n*\n"), format="sdf")


@pytest.mark.parametrize(
    "name", ["text.sdf", "binary-type5.sdf", "binary-type7.sdf", "one-profile.sdf"]
)
def test_damaged_files_are_refused_or_read(folder, survives_damage, name):
    survives_damage(sdf, folder / name)


@pytest.mark.parametrize("binary", [False, True])
def test_written_surface_is_read_back_exactly(bump, put, binary):
    data = sdf_bytes(bump, binary=binary)

    back = ms.read(put(data, "bump.sdf"))

    np.testing.assert_array_equal(back.z, bump.z)
    assert (back.dx, back.dy) == (bump.dx, bump.dy)
    assert back.metadata["header"]["trailer"] == "<Origin> 0.001 -0.002 </Origin>"
    assert data == sdf_bytes(bump, binary=binary)


def test_written_binary_is_what_struct_reads(bump):
    data = sdf_bytes(bump, binary=True)

    size = struct.unpack_from("<HH", data, 42)
    heights = np.array(struct.unpack_from("<20d", data, 81)).reshape(4, 5)
    assert data.startswith(b"bISO-1.0metrosep  010119700000")
    assert size == (5, 4)
    np.testing.assert_array_equal(heights, bump.z)


def test_written_text_is_what_split_reads(bump):
    text = sdf_bytes(bump).decode("ascii")

    fields = dict(
        line.split(" = ") for line in text.replace("  ", "").split("\n")[1:13] if " = " in line
    )
    tokens = text.split("\n*\n")[1].split()
    heights = [np.nan if t == "BAD" else float(t) for t in tokens]
    assert text.startswith("aISO-1.0\nManufacID")
    np.testing.assert_array_equal(np.reshape(heights, (4, 5)), bump.z)
    assert fields["NumPoints"] == "5"


@pytest.mark.parametrize(
    ("surface", "match"),
    [
        (ms.Surface(np.full((2, 2), np.nan), 1e-6, 1e-6), "nothing was measured"),
        (ms.Surface(np.zeros((2, 2)), 1e-6), "not calibrated"),
        (ms.Surface(np.zeros((1, 65536)), 1e-6, 1e-6), "at most 65535"),
    ],
)
def test_what_does_not_fit_the_format_is_not_written(surface, match):
    with pytest.raises(ms.errors.WriteError, match=match):
        sdf_bytes(surface)


def test_header_without_an_end_is_a_corrupt_file(folder, put):
    data = (folder / "text.sdf").read_bytes()

    with pytest.raises(ms.errors.CorruptFileError, match="has no end"):
        ms.read(put(data[: data.index(b"*")]))
