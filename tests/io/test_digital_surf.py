"""Digital Surf files: real file, units, series, streams, orientation, writer, headers that lie."""

import struct
import zlib
from pathlib import Path

import numpy as np
import pytest

import metrosep as ms
from metrosep.io.declared import Match
from metrosep.io.maps import digital_surf
from metrosep.io.maps.digital_surf import sur_bytes
from metrosep.io.registry import identify, structure
from metrosep.io.source import RawFile, open_file

NM = 1e-9
REL = 1e-6  # digits of the manifest of the corpus
SINGLE = 1e-7  # a number that the file keeps in single precision
EXACT = 1e-12  # double precision after two multiplications
FM = 1e-15


@pytest.fixture
def folder(repository):
    return repository / "data_formats" / "digital-surf" / "samples"


@pytest.fixture
def patched(folder, put):
    """Write a sample with header fields changed and return its path."""
    codes = {name: (offset, code) for offset, code, name in structure("digital-surf").layout}

    def write(name="surface16.sur", **fields):
        data = bytearray((folder / name).read_bytes())
        for field, value in fields.items():
            offset, code = codes[field]
            struct.pack_into("<" + code, data, offset, value)
        return put(bytes(data), f"patched-{name}")

    return write


@pytest.fixture
def parsed():
    """Parse an uncompressed 32-bit surface without the reader: heights in mm, top row first."""

    def parse(data):
        assert data[:12] == b"DIGITAL SURF"
        assert struct.unpack_from("<h", data, 98) == (32,)
        low, _, columns, rows, total = struct.unpack_from("<5i", data, 100)
        n_comment, n_private = struct.unpack_from("<2H", data, 334)
        dz, z0 = struct.unpack_from("<f", data, 128)[0], struct.unpack_from("<f", data, 474)[0]
        assert total == rows * columns
        assert len(data) == 512 + n_comment + n_private + 4 * total
        values = struct.unpack_from(f"<{total}i", data, 512 + n_comment + n_private)
        special = struct.unpack_from("<h", data, 86)[0]
        z = [np.nan if special and v == low - 2 else (v - low) * dz + z0 for v in values]
        return np.array(z).reshape(rows, columns), struct.unpack_from("<2f", data, 120)

    return parse


def test_real_file_as_independent_readers_give_it(corpus):
    path = corpus / "st" / "sur-2.sur"

    surface = ms.read(path)

    assert identify(path).id == "digital-surf"
    assert surface.shape == (484, 563)
    assert surface.n_invalid == 117
    assert surface.dx == pytest.approx(3.4840002190321683e-06, rel=REL, abs=0.0)
    assert surface.dy == pytest.approx(3.4840002190321683e-06, rel=REL, abs=0.0)
    assert surface.peak_to_valley() == pytest.approx(1476.0 * NM, rel=REL, abs=0.0)
    assert surface.rms() == pytest.approx(17.51788 * NM, rel=REL, abs=0.0)


def test_rows_of_the_real_file_are_turned(corpus, parsed):
    path = corpus / "st" / "sur-2.sur"
    z_mm, steps = parsed(path.read_bytes())

    surface = ms.read(path)

    np.testing.assert_allclose(surface.z, z_mm[::-1] * 1e-3, rtol=0, atol=FM)
    assert surface.dx == pytest.approx(steps[0] * 1e-3, rel=EXACT, abs=0.0)
    assert not np.array_equal(surface.z, surface.z[::-1], equal_nan=True)


def test_top_line_has_the_largest_y(folder):
    surface = ms.read(folder / "surface16.sur")

    assert np.unravel_index(np.nanargmax(surface.z), surface.shape) == (2, 0)
    assert np.isnan(surface.z[2, 3])
    assert surface.metadata["row_order_in_file"] == "top row first"


def test_each_axis_has_its_own_unit(folder):
    """x in um, y in mm, z in m: 2.5 um, 4 um, 0.1 nm a count, lowest point at 30 nm."""
    surface = ms.read(folder / "surface16.sur")

    assert surface.dx == pytest.approx(2.5e-6, rel=SINGLE, abs=0.0)
    assert surface.dy == pytest.approx(4e-6, rel=SINGLE, abs=0.0)
    assert surface.z[2, 0] == pytest.approx((900 + 7) * 1e-10 + 3e-8, rel=SINGLE, abs=0.0)
    assert surface.origin == pytest.approx((0.5e-6, -0.25e-3), rel=SINGLE, abs=0.0)
    assert surface.metadata["height_per_count_m"] == pytest.approx(1e-10, rel=SINGLE, abs=0.0)


def test_comment_and_every_field_are_in_the_header(folder):
    header = ms.read(folder / "surface32.sur").metadata["header"]

    assert header["comment"] == "5 µm"
    assert header["object_name"] == "planted bump"
    assert set(header) == {name for _, _, name in structure("digital-surf").layout} | {"comment"}


def test_fields_of_the_table_do_not_overlap():
    ends = [
        offset + struct.calcsize("<" + code)
        for offset, code, _ in structure("digital-surf").layout
    ]

    assert all(
        end <= structure("digital-surf").layout[i + 1][0] for i, end in enumerate(ends[:-1])
    )
    assert ends[-1] == 512


def test_compressed_points_are_the_plain_ones(folder):
    plain, packed = ms.read(folder / "surface32.sur"), ms.read(folder / "streams.sur")

    np.testing.assert_array_equal(packed.z, plain.z)


def test_objects_of_a_series_are_channels(folder):
    path = folder / "series.sur"

    assert digital_surf.channels(open_file(path)) == ("object 1", "object 2")
    assert ms.read(path).metadata["object_name"] == "planted bump"
    assert ms.read(path, channel="object 2").metadata["object_name"] == "second"


def test_missing_object_of_a_series_is_refused(patched):
    with pytest.raises(ms.errors.CorruptFileError, match="n_objects"):
        ms.read(patched("series.sur", n_objects=3))


def test_unknown_channel_is_refused(folder):
    with pytest.raises(ms.errors.UnsupportedFeatureError, match="'object 1', 'object 2'"):
        ms.read(folder / "series.sur", channel="height")


def test_profile_with_override(folder):
    profile = ms.read(folder / "profile.pro", lateral_step="1 um")

    assert profile.dx == pytest.approx(1e-6, rel=EXACT, abs=0.0)
    assert profile.metadata["lateral_step_in_file_m"] == pytest.approx(2.5e-6, rel=SINGLE, abs=0.0)
    assert profile.metadata["lateral_step_override_m"] == pytest.approx(1e-6, rel=EXACT, abs=0.0)


def test_profile_without_step_needs_one(patched):
    path = patched("profile.pro", x_spacing=0.0)

    with pytest.raises(ms.errors.UnitError, match="lateral_step="):
        ms.read(path)
    assert ms.read(path, lateral_step="1 um").dx == pytest.approx(1e-6, rel=EXACT, abs=0.0)


def test_profile_of_several_lines_is_a_surface(patched):
    surface = ms.read(patched(object_type=1))

    assert surface.shape == (3, 4)
    assert "says profile" in surface.metadata["warnings"][0]


def test_without_the_flag_every_value_is_a_height(patched):
    surface = ms.read(patched(special_points=0))

    assert surface.n_invalid == 0
    assert "1 values are outside" in surface.metadata["warnings"][0]


def test_lateral_step_override_stands_beside_the_own_value(folder):
    surface = ms.read(folder / "surface16.sur", lateral_step=("10 um", 20e-6))

    assert (surface.dx, surface.dy) == pytest.approx((10e-6, 20e-6), rel=EXACT, abs=0.0)
    own = surface.metadata["lateral_step_in_file_m"]
    assert own == pytest.approx((2.5e-6, 4e-6), rel=SINGLE, abs=0.0)


def test_unit_is_refused_since_the_format_has_one(folder):
    with pytest.raises(ms.errors.ReadError, match="takes no unit"):
        ms.read(folder / "surface16.sur", unit="um")


@pytest.mark.parametrize(
    ("fields", "match"),
    [
        ({"points_per_line": 100000, "lines": 100000}, "more than 268435456"),
        ({"points_per_line": -4}, "points_per_line"),
        ({"lines": 0}, "lines"),
        ({"total_points": 2**31 - 1}, "does not fit"),
        ({"total_points": 0}, "total_points"),
        ({"total_points": 11}, "total_points"),
        ({"bits_per_point": 0}, "bits_per_point"),
        ({"z_spacing": 0.0}, "z_spacing"),
        ({"z_spacing": float("nan")}, "z_spacing"),
        ({"z_spacing": -1.0}, "z_spacing"),
        ({"x_spacing": -1.0}, "x_spacing"),
        ({"y_spacing": float("inf")}, "y_spacing"),
        ({"z_offset": float("nan")}, "z_offset"),
        ({"x_offset": float("inf")}, "x_offset"),
        ({"comment_bytes": 65535}, "comment"),
        ({"private_bytes": 65535}, "private"),
        ({"format": 257}, "big-endian"),
        ({"w_size": 7}, "total_points|w_size"),
        ({"object_type": 20}, "a spectrum"),
        ({"z_step_unit": b"V"}, "z_step_unit"),
    ],
)
def test_header_that_lies_is_a_read_error(patched, fields, match):
    with pytest.raises((ms.errors.ReadError, ms.errors.UnitError), match=match):
        ms.read(patched(**fields))


@pytest.mark.parametrize(
    ("offset", "value", "match"),
    [
        (0, 0, "number of compressed streams"),
        (0, 2**32 - 1, "number of compressed streams"),
        (4, 2**32 - 1, "do not make the map"),
        (8, 2**32 - 1, "does not fit"),
    ],
)
def test_list_of_streams_that_lies_is_refused(folder, put, offset, value, match):
    data = bytearray((folder / "streams.sur").read_bytes())
    struct.pack_into("<I", data, 512 + offset, value)

    with pytest.raises(ms.errors.CorruptFileError, match=match):
        ms.read(put(bytes(data), "streams.sur"))


def test_stream_that_is_larger_than_it_says_is_not_inflated(folder, put):
    """A stream of 30 MB behind a claim of 48 bytes: 49 bytes are inflated, and the file refused."""
    head = bytearray((folder / "streams.sur").read_bytes()[:512])
    bomb = zlib.compress(bytes(30_000_000), 9)
    data = bytes(head) + struct.pack("<III", 1, 48, len(bomb)) + bomb

    with pytest.raises(ms.errors.CorruptFileError, match="stream is damaged"):
        ms.read(put(data, "bomb.sur"))


def test_stream_that_cannot_grow_to_its_claim_is_refused_at_once(patched, put):
    head = patched("streams.sur", points_per_line=16000, lines=16000, total_points=256000000)
    data = head.read_bytes()[:512] + struct.pack("<III", 1, 1024000000, 8) + bytes(8)

    with pytest.raises(ms.errors.CorruptFileError, match="a larger stream"):
        ms.read(put(data, "claim.sur"))


def test_signature_decides_not_the_suffix(folder, put):
    head = (folder / "surface16.sur").read_bytes()

    assert digital_surf.sniff(RawFile(Path("x.csv"), head)) is Match.YES
    assert digital_surf.sniff(RawFile(Path("x.sur"), b"DIGITAL SURF notes")) is Match.MAYBE
    assert digital_surf.sniff(RawFile(Path("x.sur"), b"digital surf")) is Match.NO
    with pytest.raises(ms.errors.FormatMismatchError, match="DSCOMPRESSED"):
        ms.read(put("x,y\n1,2\n", "a.sur"), format="digital-surf")


@pytest.mark.parametrize("name", ["surface16.sur", "streams.sur", "profile.pro"])
def test_damage_is_a_measurement_or_a_read_error(folder, survives_damage, name):
    survives_damage(digital_surf, folder / name)


def test_written_file_is_read_alike_by_an_independent_parser(bump, parsed):
    z_mm, steps = parsed(sur_bytes(bump))

    step = (90 + 1 / 3) * NM / (2**31 - 1)  # quantisation: P-V over the counts of 31 bits
    np.testing.assert_allclose(z_mm[::-1] * 1e-3, bump.z, rtol=0, atol=0.51 * step)
    assert steps == pytest.approx((1.5e-3, 2.5e-3), rel=SINGLE, abs=0.0)


def test_written_file_reads_back_within_half_a_step(bump, tmp_path):
    path = ms.write(bump, tmp_path / "bump.sur")

    back = ms.read(path)

    step = back.metadata["height_per_count_m"]
    assert step == pytest.approx((90 + 1 / 3) * NM / (2**31 - 1), rel=1e-6, abs=0.0)
    np.testing.assert_allclose(back.z, bump.z, rtol=0, atol=0.51 * step)
    assert (back.dx, back.dy) == pytest.approx((bump.dx, bump.dy), rel=SINGLE, abs=0.0)
    assert back.origin == pytest.approx(bump.origin, rel=SINGLE, abs=0.0)
    assert repr(step / 1e-3)[:6] in back.metadata["header"]["comment"]
    assert back.metadata["warnings"] == ()


@pytest.mark.parametrize("offset", [0.0, 0.1, -0.3, 1e-6])
@pytest.mark.parametrize("scale", [1e-12, 1e-9, 1e-3])
def test_heights_far_from_zero_are_not_stretched(tmp_path, offset, scale):
    z = np.array([[0.0, 1.0, 2.0], [-1.0, 0.5, 7.0]]) * scale + offset

    back = ms.read(ms.write(ms.Surface(z, 1e-6, 1e-6), tmp_path / "far.sur"))

    step = back.metadata["height_per_count_m"]
    rounding = 4 * np.finfo(float).eps * max(abs(offset), 8 * scale)  # sums in double precision
    np.testing.assert_allclose(back.z, z, rtol=0, atol=0.51 * step + rounding)
    assert step <= (np.ptp(z) + 1.2e-7 * abs(offset)) / (2**31 - 1) * 1.001


def test_flat_surface_is_written_exactly(tmp_path):
    back = ms.read(ms.write(ms.Surface(np.full((2, 3), 0.5), 1e-6, 1e-6), tmp_path / "flat.sur"))

    assert np.abs(back.z - 0.5).max() == 0.0
    assert "every valid height is the same" in back.metadata["warnings"][0]


def test_same_surface_gives_the_same_bytes(bump):
    assert sur_bytes(bump) == sur_bytes(bump)


@pytest.mark.parametrize(
    ("surface", "match"),
    [
        (ms.Surface(np.zeros((2, 2)), None, None), "not calibrated"),
        (ms.Surface(np.full((2, 2), np.nan), 1e-6, 1e-6), "nothing was measured"),
        (ms.Surface(np.full((2, 2), 1e9), 1e-6, 1e-6), "up to"),
    ],
)
def test_surface_that_the_format_cannot_hold_is_refused(surface, match):
    with pytest.raises(ms.errors.WriteError, match=match):
        sur_bytes(surface)
