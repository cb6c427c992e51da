"""Profiles as .pro, .sdf and .smd: read back by parsers written here from the descriptions alone."""

import struct

import numpy as np
import pytest

import metrosep as ms
from metrosep.io.write import write

NM = 1e-9
PM = 1e-12
STEP = 0.25e-6
Z = np.array([3.5, -12.25, 0.125, 90.0, -7.0, 1.0 / 3.0]) * NM  # no symmetry


@pytest.fixture
def profile():
    return ms.Profile(2e-3 + STEP * np.arange(Z.size), Z)


def parse_pro(data):
    """Object of type 1: points, counts, and heights in the step unit (offsets of the format)."""
    kind, special, bits = (struct.unpack_from("<h", data, at)[0] for at in (18, 86, 98))
    zmin, zmax, columns, rows, total = struct.unpack_from("<5i", data, 100)
    dx, _, dz = struct.unpack_from("<3f", data, 120)
    step_units = [data[at : at + 16].strip() for at in (180, 212)]
    raw = np.frombuffer(data, "<i4", total, offset=len(data) - 4 * total)
    assert (kind, bits, rows, total) == (1, 32, 1, columns)
    assert step_units == [b"mm", b"mm"]
    assert 512 + struct.unpack_from("<H", data, 334)[0] == len(data) - 4 * total
    assert raw[raw >= zmin].max() == zmax
    (z0,) = struct.unpack_from("<f", data, 474)
    heights = np.where((raw == zmin - 2) & (special != 0), np.nan, (raw - zmin) * float(dz) + z0)
    return dx * 1e-3, heights * 1e-3, dz * 1e-3


def parse_sdf(text):
    """The lines of the three parts between asterisks."""
    head, body, _ = text.split("\n*\n")[:3]
    fields = dict(part.split("=") for part in head.replace(" ", "").split("\n")[1:])
    values = [np.nan if word == "BAD" else float(word) for word in body.split()]
    assert (int(fields["NumProfiles"]), int(fields["NumPoints"])) == (1, len(values))
    return float(fields["Xscale"]), np.array(values) * float(fields["Zscale"])


def parse_smd(data):
    """Records closed by ETX; the sum of all bytes before the last one, modulo 65536."""
    axes, about, heights, total = data.split(b"\x03\r\n")[:4]
    lines = axes.replace(b"\0", b" ").decode().split("\r\n")
    x, z = lines[2].split(), lines[3].split()
    assert x[:2] == ["CX", "I"]
    assert z[:2] == ["CZ", "A"]
    assert x[3] == z[3] == "m"
    values = np.array([float(v) for v in heights.split()])
    assert int(x[2]) == int(z[2]) == values.size
    body = data[: data.index(heights) + len(heights) + 3]
    assert int(total) == sum(body) % 65536
    assert b"metrosep" in about
    return float(x[-1]) * float(x[4]), values * float(z[4])


def test_pro_holds_the_heights_to_half_a_step(profile, tmp_path):
    data = write(profile, tmp_path / "line.pro").read_bytes()

    dx, z, count = parse_pro(data)

    assert dx == pytest.approx(STEP, rel=1e-7, abs=0.0)  # single precision by the format
    assert count < np.ptp(Z) / 2e9
    np.testing.assert_allclose(z, Z, rtol=0, atol=PM * 1e-3)
    back = ms.read(tmp_path / "line.pro")
    np.testing.assert_allclose(back.z, Z, rtol=0, atol=count)
    assert back.x[0] == pytest.approx(2e-3, rel=1e-7, abs=0.0)


def test_pro_marks_what_was_not_measured(profile, tmp_path):
    gap = ms.Profile(profile.x, np.where(np.arange(Z.size) == 1, np.nan, Z))

    _, z, _ = parse_pro(write(gap, tmp_path / "gap.pro").read_bytes())

    assert np.flatnonzero(np.isnan(z)).tolist() == [1]
    assert np.flatnonzero(np.isnan(ms.read(tmp_path / "gap.pro").z)).tolist() == [1]


@pytest.mark.parametrize("binary", [False, True])
def test_sdf_keeps_every_digit_of_a_profile(profile, tmp_path, binary):
    gap = ms.Profile(profile.x, np.where(np.arange(Z.size) == 3, np.nan, Z))
    path = write(gap, tmp_path / "line.sdf", binary=binary)

    if not binary:
        dx, z = parse_sdf(path.read_text())
        np.testing.assert_array_equal(z, gap.z)
        assert dx == gap.dx
    back = ms.read(path)
    assert isinstance(back, ms.Profile)
    np.testing.assert_array_equal(back.z, gap.z)


def test_smd_keeps_every_digit_and_its_sum_is_right(profile, tmp_path):
    dx, z = parse_smd(write(profile, tmp_path / "line.smd").read_bytes())

    np.testing.assert_array_equal(z, Z)
    assert dx == profile.dx
    back = ms.read(tmp_path / "line.smd")
    np.testing.assert_array_equal(back.z, Z)
    assert back.metadata["warnings"] == (back.metadata["unproven"],)


UNTIDY = {
    "far from 0": (12.5e-3, 0.25e-6, 1e-9),
    "negative": (-3.75e-3, 1e-3, 1e-6),
    "falling": (5e-3, -1e-6, 1e-9),
    "tiny": (0.0, 1e-9, 1e-15),
    "huge": (0.0, 0.5, 0.1),
    "kilometres away": (1e3, 1e-3, 1e-6),
    "no round step": (1e-3, np.pi * 1e-7, 1e-9),
    "flat": (0.0, 1e-6, 0.0),
}


@pytest.mark.parametrize("suffix", [".pro", ".sdf", ".smd", ".csv"])
@pytest.mark.parametrize("name", UNTIDY)
def test_untidy_profiles_come_back_where_they_began(tmp_path, name, suffix):
    start, step, scale = UNTIDY[name]
    x, z = start + step * np.arange(Z.size), 1e-7 * (scale == 0.0) + Z / NM * scale
    order = slice(None, None, 1 if step > 0 else -1)
    line = ms.Profile(x[order], z[order])

    back = ms.read(write(line, tmp_path / f"line{suffix}"))

    single = suffix == ".pro"  # start and step in single precision by the format
    far = np.abs(line.x).max()
    np.testing.assert_allclose(back.x, line.x, rtol=0, atol=far * (2e-7 if single else 1e-15))
    half_step = np.ptp(line.z) * 2.0**-31 + np.abs(line.z).max() * 2.0**-24
    np.testing.assert_allclose(back.z, line.z, rtol=0, atol=half_step * single)


@pytest.mark.parametrize("suffix", [".sdf", ".smd"])
def test_the_start_that_another_program_states_in_a_remark_is_none(tmp_path, suffix):
    line = ms.Profile(2e-3 + STEP * np.arange(Z.size), Z)
    path = write(line, tmp_path / f"line{suffix}")
    path.write_bytes(path.read_bytes().replace(b"metrosep", b"somebody"))

    assert ms.read(path).x[0] == 0.0


@pytest.mark.parametrize("suffix", [".pro", ".sdf", ".smd"])
def test_unequal_steps_are_refused_and_no_file_is_left(tmp_path, suffix):
    uneven = ms.Profile([0.0, 1e-6, 3e-6], [0.0, 1e-9, 2e-9])

    with pytest.raises(ms.errors.WriteError, match="not equally spaced"):
        write(uneven, tmp_path / f"line{suffix}")
    assert list(tmp_path.iterdir()) == []


def test_a_gap_cannot_be_written_as_smd(profile, tmp_path):
    gap = ms.Profile(profile.x, np.where(np.arange(Z.size) == 1, np.nan, Z))

    with pytest.raises(ms.errors.WriteError, match=r"1 points .* write X3P"):
        write(gap, tmp_path / "line.smd")


def test_a_surface_is_no_profile(tmp_path):
    with pytest.raises(ms.errors.UnsupportedFeatureError, match="does not hold a Surface"):
        write(ms.Surface(np.ones((2, 3)) * np.arange(3), 1e-6, 1e-6), tmp_path / "map.pro")
