"""X3P: real files, an independent reader and writer, orientation, and archives that attack."""

import hashlib
import io
import struct
import time
import zipfile

import numpy as np
import pytest
import x3pio

import metrosep as ms
from metrosep.io.maps import x3p

NM = 1e-9
AM = 1e-18
QUICK = 2.0  # seconds; what a hostile archive may take at most


def repack(sample, target, changes):
    """Write the sample with members replaced (None removes one); checksums are left as they are."""
    with zipfile.ZipFile(sample) as source:
        members = {n: source.read(n) for n in source.namelist()}
    members.update(changes)
    with zipfile.ZipFile(target, "w", zipfile.ZIP_DEFLATED) as archive:
        for name, data in members.items():
            if data is not None:
                archive.writestr(name, data)
    return target


@pytest.fixture
def sample(repository):
    return repository / "data_formats" / "x3p" / "samples" / "double.x3p"


@pytest.fixture
def edited(sample, tmp_path):
    """Write the sample with text of its main.xml replaced."""

    def write(old, new):
        with zipfile.ZipFile(sample) as source:
            main = source.read("main.xml").decode()
        assert old in main
        path = tmp_path / "edited.x3p"
        return repack(sample, path, {"main.xml": main.replace(old, new).encode()})

    return write


def test_real_file_as_independent_readers_give_it(corpus):
    """Manifest of the corpus: three independent programs agree on these numbers."""
    surface = ms.read(corpus / "st" / "x3p-2.x3p")

    assert surface.shape == (650, 650)
    assert surface.dx == pytest.approx(1.27656509837346e-07, rel=1e-12, abs=0.0)
    assert surface.dy == pytest.approx(3.14582113527746e-07, rel=1e-12, abs=0.0)
    assert surface.peak_to_valley() == pytest.approx(554.3362 * NM, abs=0.5e-4 * NM)
    assert surface.rms() == pytest.approx(77.28033 * NM, abs=0.5e-5 * NM)
    assert surface.metadata["warnings"] == ()


@pytest.mark.parametrize(
    "name", ["x3ptools/testing.x3p", "x3ptools/csafe-logo.x3p", "st/x3p-2.x3p"]
)
def test_real_file_as_x3pio_reads_it(corpus, name):
    """x3pio shares no code with us; values, orientation and steps must agree exactly."""
    surface = ms.read(corpus / name)

    other = x3pio.read(corpus / name, verify=False)

    np.testing.assert_array_equal(surface.z, other.layers[0].z)
    assert (surface.dx, surface.dy) == (other.header.x.increment, other.header.y.increment)


def test_wrong_md5_of_a_real_file_is_a_warning(corpus):
    warnings = ms.read(corpus / "x3ptools" / "csafe-logo.x3p").metadata["warnings"]

    assert any("MD5 of main.xml is wrong" in w for w in warnings)
    assert any("folder" in w for w in warnings)


@pytest.mark.parametrize(
    "name",
    [
        "double",
        "float",
        "integer-I-mask",
        "integer-L-mask",
        "profile",
        "profile-positions",
        "in-a-folder",
    ],
)
def test_samples_as_x3pio_reads_them(repository, name):
    path = repository / "data_formats" / "x3p" / "samples" / f"{name}.x3p"

    obj = ms.read(path)
    other = x3pio.read(path, verify=False)

    offset = float(other.placement.offset[2])
    theirs = np.asarray(other.layers[0].z).reshape(obj.z.shape) + offset
    np.testing.assert_allclose(obj.z, theirs, rtol=1e-12, atol=AM)


def test_first_row_has_the_smallest_y(sample):
    surface = ms.read(sample)

    assert np.unravel_index(np.nanargmax(surface.z), surface.shape) == (0, 2)
    assert np.isnan(surface.z[2, 0])
    assert surface.origin == pytest.approx((1e-3, 2e-3), abs=AM)


def test_negative_increment_mirrors_the_map(edited, sample):
    plain = ms.read(sample)

    turned = ms.read(edited("<Increment>2.5e-06</Increment>", "<Increment>-2.5e-06</Increment>"))

    np.testing.assert_array_equal(turned.z, plain.z[::-1])
    assert turned.dy == plain.dy
    assert turned.origin[1] == pytest.approx(2e-3 - 3 * 2.5e-6, abs=AM)
    assert turned.metadata["row_order_in_file"] == "largest y first"


def test_wrong_md5_of_the_data_is_a_warning(sample, tmp_path):
    data = struct.pack("<12d", *range(12))

    surface = ms.read(repack(sample, tmp_path / "a.x3p", {"bindata/data.bin": data}))

    assert surface.z[0, 1] == 1.0
    assert any("data.bin is wrong" in w for w in surface.metadata["warnings"])


def test_wrong_md5_of_the_mask_is_a_warning(repository, tmp_path):
    source = repository / "data_formats" / "x3p" / "samples" / "integer-I-mask.x3p"
    bits = bytearray(zipfile.ZipFile(source).read("bindata/valid.bin"))
    bits[0] ^= 1
    path = repack(source, tmp_path / "mask.x3p", {"bindata/valid.bin": bytes(bits)})

    surface = ms.read(path)

    assert np.isnan(surface.z[0, 0])
    assert any("MD5 of bindata/valid.bin" in w for w in surface.metadata["warnings"])


def test_every_field_of_the_description_is_kept(sample):
    header = ms.read(sample).metadata["header"]

    assert header["Record1/Axes/CX/Increment"] == "1.5e-06"
    assert header["Record2/Instrument/Model"] == "made by hand"
    assert header["Record3/MatrixDimension/SizeY"] == "4"


def test_lateral_step_override(sample):
    surface = ms.read(sample, lateral_step="3 um")

    assert (surface.dx, surface.dy) == pytest.approx((3e-6, 3e-6), abs=AM)
    assert surface.metadata["lateral_step_in_file_m"] == (1.5e-6, 2.5e-6)


@pytest.mark.parametrize(
    ("old", "new", "match"),
    [
        ("<SizeX>3<", "<SizeX>-3<", "SizeX"),
        ("<SizeX>3<", "<SizeX>" + "9" * 5000 + "<", "SizeX"),
        ("<SizeZ>1<", "<SizeZ>2<", "2 layers"),
        ("<SizeY>4<", "<SizeY>5<", "do not fill"),
        ("<Increment>1.5e-06<", "<Increment>0<", "CX/Increment"),
        ("<Increment>1.5e-06<", "<Increment>inf<", "CX/Increment"),
        ("<Increment>1.5e-06<", "<Increment><", "CX/Increment"),
        ("<Offset>0.001<", "<Offset>nan<", "CX/Offset"),
        ("<FeatureType>SUR<", "<FeatureType>PCL<", "needs absolute axes"),
        ("<FeatureType>SUR<", "<FeatureType>ABC<", "'ABC'"),
        ("<FeatureType>SUR<", "<FeatureType>PRF<", "one row"),
        ("<AxisType>A<", "<AxisType>I<", "CZ"),
        ("<CX><AxisType>I<", "<CX><AxisType>A<", "do not fill"),
        ("<DataType>D<", "<DataType>Q<", "unknown type"),
        ("bindata/data.bin<", "bindata/other.bin<", "no member"),
        ("bindata/data.bin<", "/etc/passwd<", "outside of itself"),
        ("bindata/data.bin<", "..\\..\\secret<", "outside of itself"),
        ("bindata/data.bin<", "file:///etc/passwd<", "outside of itself"),
        ("<PointDataLink>bindata/data.bin</PointDataLink>", "", "names no data"),
        ("ISO5436_2", "OTHER", "something else"),
        ("<Record1>", "<Record1", "not well-formed"),
        ('encoding="UTF-8"', 'encoding="nonsense-7"', "main.xml"),
    ],
)
def test_description_that_lies_is_a_read_error(edited, old, new, match):
    path = edited(old, new)
    start = time.process_time()

    with pytest.raises(ms.errors.ReadError, match=match):
        ms.read(path)

    assert time.process_time() - start < QUICK


def test_zip_bomb_is_refused_from_the_directory(sample, tmp_path):
    """64 MB of zeros in 64 kB where 96 bytes belong: refused before anything is inflated."""
    stream = io.BytesIO()
    with (
        zipfile.ZipFile(stream, "w", zipfile.ZIP_DEFLATED) as archive,
        archive.open("bindata/data.bin", "w", force_zip64=True) as member,
    ):
        for _ in range(64):
            member.write(bytes(2**20))
    with zipfile.ZipFile(stream, "a") as archive, zipfile.ZipFile(sample) as source:
        archive.writestr("main.xml", source.read("main.xml"))
    path = tmp_path / "bomb.x3p"
    path.write_bytes(stream.getvalue())
    start = time.process_time()

    with pytest.raises(ms.errors.CorruptFileError, match="larger than it may be"):
        ms.read(path)

    assert time.process_time() - start < 0.5


def test_bomb_that_claims_a_matching_map_needs_consent(edited, monkeypatch):
    from metrosep.io.maps import x3p

    monkeypatch.setattr(x3p.Container, "suspect_bytes", 1000)
    stream = io.BytesIO()
    with zipfile.ZipFile(edited("<SizeY>4<", "<SizeY>40000<")) as source:
        main = source.read("main.xml")
    with zipfile.ZipFile(stream, "w", zipfile.ZIP_DEFLATED) as archive:
        archive.writestr("main.xml", main)
        archive.writestr("bindata/data.bin", bytes(3 * 40000 * 8))
    path = edited("SUR", "SUR").with_name("large.x3p")
    path.write_bytes(stream.getvalue())

    with pytest.raises(ms.errors.UnsupportedFeatureError, match="zip bomb"):
        ms.read(path)
    assert ms.read(path, max_pixels=120000).shape == (40000, 3)


def test_large_description_is_refused(sample, tmp_path):
    path = repack(sample, tmp_path / "a.x3p", {"main.xml": b" " * (2**25 + 1)})

    with pytest.raises(ms.errors.CorruptFileError, match="larger than it may be"):
        ms.read(path)


def test_missing_checksum_file_is_a_warning(sample, tmp_path):
    surface = ms.read(repack(sample, tmp_path / "a.x3p", {"md5checksum.hex": None}))

    assert "md5checksum.hex is missing" in surface.metadata["warnings"]


def test_map_without_a_valid_point_is_refused(sample, tmp_path):
    data = struct.pack("<12d", *[float("nan")] * 12)

    with pytest.raises(ms.errors.CorruptFileError, match="no point was measured"):
        ms.read(repack(sample, tmp_path / "a.x3p", {"bindata/data.bin": data}))


def test_encrypted_member_is_refused(sample, tmp_path):
    data = bytearray(sample.read_bytes())
    for mark, offset in ((b"PK\x03\x04", 6), (b"PK\x01\x02", 8)):
        start = data.find(mark)
        while start >= 0:
            data[start + offset] |= 1
            start = data.find(mark, start + 4)
    path = tmp_path / "locked.x3p"
    path.write_bytes(data)

    with pytest.raises(ms.errors.UnsupportedFeatureError, match="encrypted"):
        ms.read(path)


def test_written_surface_reads_back_exactly(bump, tmp_path):
    back = ms.read(ms.write(bump, tmp_path / "a.x3p"))

    np.testing.assert_array_equal(back.z, bump.z)
    assert (back.dx, back.dy, back.origin) == (bump.dx, bump.dy, bump.origin)
    assert back.metadata["warnings"] == ()


def test_written_surface_as_x3pio_reads_it(bump, tmp_path):
    """x3pio verifies both checksums and refuses what does not fit the standard."""
    path = ms.write(bump, tmp_path / "a.x3p")

    other = x3pio.read(path, verify=True)

    np.testing.assert_array_equal(other.layers[0].z, bump.z)
    assert other.layers[0].spacing == (bump.dx, bump.dy)
    assert tuple(other.placement.offset[:2]) == bump.origin


@pytest.mark.parametrize("uniform", [True, False])
def test_written_profile_reads_back_exactly_and_in_x3pio(tmp_path, uniform):
    x = 0.125 * np.arange(6) if uniform else np.array([0.0, 0.1, 0.25, 0.5, 0.75, 1.0])
    profile = ms.Profile(x * 1e-3, [1 / 3, np.nan, 3, -4, 5, 6])

    path = ms.write(profile, tmp_path / "p.x3p")
    back, other = ms.read(path), x3pio.read(path, verify=True)

    np.testing.assert_array_equal(back.x, profile.x)
    np.testing.assert_array_equal(back.z, profile.z)
    np.testing.assert_array_equal(other.layers[0].z.ravel(), profile.z)


def test_what_x3pio_writes_is_read(tmp_path):
    z = np.array([[0.0, 1e-9, np.nan], [5e-9, 4e-9, -3e-9]])
    path = tmp_path / "other.x3p"
    x3pio.write(path, z, x_scale=1e-6, y_scale=3e-6)

    surface = ms.read(path)

    np.testing.assert_array_equal(surface.z, z)
    assert (surface.dx, surface.dy) == (1e-6, 3e-6)
    assert surface.metadata["warnings"] == ()


def test_point_cloud_of_x3pio_on_a_grid_is_a_surface(tmp_path):
    """Points in random order, two of twenty missing; unequal steps and an origin."""
    rng = np.random.default_rng(5)
    row, column = np.divmod(rng.permutation(20)[:18], 5)
    points = np.column_stack([1e-3 + 2e-6 * column, -3e-3 + 5e-6 * row, rng.normal(0, 1e-7, 18)])
    path = tmp_path / "cloud.x3p"
    x3pio.write_points(path, points)

    surface = ms.read(path)

    assert surface.shape == (4, 5)
    assert surface.n_invalid == 2
    assert (surface.dx, surface.dy) == pytest.approx((2e-6, 5e-6), rel=1e-9, abs=0.0)
    assert surface.origin == pytest.approx((1e-3, -3e-3), abs=AM)
    np.testing.assert_array_equal(surface.z[row, column], points[:, 2])
    assert surface.metadata["row_order_in_file"] == "points placed by their positions"
    assert surface.metadata["n_points"] == 18


@pytest.mark.parametrize(
    "points",
    [
        np.random.default_rng(9).normal(size=(40, 3)),
        [(0.0, 0.0, 1e-9), (1e-6, 1e-6, 2e-9), (1.0, 1.0, 3e-9)],
        [(0.0, 0.0, 1e-9), (1e-6, 0.0, 2e-9), (2e-6, 0.0, 3e-9)],
        [(0.0, 0.0, 1e-9), (1e-6, 1e-6, 2e-9), (1e-6, 1e-6, 3e-9)],
    ],
    ids=["random", "far apart", "one line", "repeated"],
)
def test_scattered_points_are_unsupported(tmp_path, points):
    path = tmp_path / "cloud.x3p"
    x3pio.write_points(path, np.asarray(points))
    start = time.process_time()

    with pytest.raises(ms.errors.UnsupportedFeatureError, match="are scattered, not on a regular"):
        ms.read(path)

    assert time.process_time() - start < QUICK


def test_points_take_no_lateral_step_and_count_as_pixels(repository):
    path = repository / "data_formats" / "x3p" / "samples" / "points.x3p"

    with pytest.raises(ms.errors.ReadError, match="takes no lateral_step"):
        ms.read(path, lateral_step=1e-6)
    with pytest.raises(ms.errors.UnsupportedFeatureError, match="max_pixels"):
        ms.read(path, max_pixels=10)


def test_points_without_a_position_are_left_out_with_a_warning(tmp_path, repository):
    source = repository / "data_formats" / "x3p" / "samples" / "points.x3p"
    data = bytearray(zipfile.ZipFile(source).read("bindata/data.bin"))
    data[:8] = struct.pack("<d", float("nan"))
    path = repack(source, tmp_path / "nan.x3p", {"bindata/data.bin": bytes(data)})

    surface = ms.read(path)

    assert surface.n_invalid == 2
    assert any("1 points without a position" in w for w in surface.metadata["warnings"])


@pytest.mark.parametrize("name", ["points.x3p", "surface-positions.x3p"])
def test_damaged_points_are_refused_or_read(repository, survives_damage, name):
    survives_damage(x3p, repository / "data_formats" / "x3p" / "samples" / name, every=13)


def test_same_object_gives_same_bytes(bump, tmp_path):
    first = ms.write(bump, tmp_path / "a.x3p").read_bytes()
    second = ms.write(bump, tmp_path / "b.x3p").read_bytes()

    assert hashlib.sha256(first).digest() == hashlib.sha256(second).digest()


def test_history_travels_in_the_comment(sample, tmp_path):
    surface = ms.read(sample)

    back = ms.read(ms.write(surface, tmp_path / "a.x3p"))

    comment = back.metadata["header"]["Record2/Comment"]
    assert surface.history[0].parameters["sha256"] in comment


def test_uncalibrated_surface_is_not_written(tmp_path):
    with pytest.raises(ms.errors.WriteError, match="lateral_step"):
        ms.write(ms.Surface([[0.0, 1e-9]]), tmp_path / "a.x3p")

    assert list(tmp_path.iterdir()) == []
