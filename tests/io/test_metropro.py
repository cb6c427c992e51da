"""MetroPro: real file, scale and sign by hand, orientation, and headers that lie."""

import struct
import time

import numpy as np
import pytest

import metrosep as ms
from metrosep.io.registry import structure

NM = 1e-9
PM = 1e-12
QUICK = 2.0  # seconds; what a damaged file may take at most


@pytest.fixture
def sample(repository):
    return repository / "data_formats" / "metropro" / "samples" / "format1.dat"


@pytest.fixture
def patched(sample, tmp_path):
    """Write the sample with one field changed and return its path."""
    codes = {name: (offset, code) for offset, code, name in structure("metropro").layout}

    def write(**fields):
        data = bytearray(sample.read_bytes())
        for name, value in fields.items():
            offset, code = codes[name]
            struct.pack_into(">" + code, data, offset, value)
        path = tmp_path / "patched.dat"
        path.write_bytes(data)
        return path

    return write


def test_real_file_as_independent_readers_give_it(corpus):
    """Manifest of the corpus: two independent programs agree on these numbers."""
    surface = ms.read(corpus / "st" / "metropro-1.dat")

    assert surface.shape == (480, 640)
    assert surface.n_invalid == 0
    assert surface.peak_to_valley() == pytest.approx(1363.056 * NM, abs=0.5e-3 * NM)
    assert surface.rms() == pytest.approx(75.28822 * NM, abs=0.5e-5 * NM)
    assert surface.dx == pytest.approx(1.0982520279867458e-06, rel=1e-9, abs=0.0)
    assert surface.dy == surface.dx


def test_rows_of_the_real_file_are_turned(corpus):
    path = corpus / "st" / "metropro-1.dat"
    raw = np.frombuffer(path.read_bytes(), dtype=">i4", offset=834 + 614400).reshape(480, 640)

    z = ms.read(path).z

    for row in (0, 100, 479):
        correlation = np.corrcoef(raw[479 - row], z[row])[0, 1]
        assert correlation > 1 - 1e-9
        assert abs(np.corrcoef(raw[row], z[row])[0, 1]) < 1 - 1e-6


def test_top_row_of_the_file_has_the_largest_y(sample):
    surface = ms.read(sample)

    assert np.unravel_index(np.nanargmax(surface.z), surface.shape) == (0, 3)
    assert np.isnan(surface.z[2, 3])
    assert surface.n_invalid == 1
    assert surface.metadata["row_order_in_file"] == "top row first"


def test_height_of_a_count_by_hand(sample):
    """One count is S * O * wavelength / R = 0.5 * 1 * 632.8 nm / 32768."""
    surface = ms.read(sample)

    assert surface.z[0, 3] == pytest.approx(32768 * 0.5 * 632.8e-9 / 32768, rel=1e-6, abs=0.0)


@pytest.mark.parametrize(("resolution", "counts"), [(0, 4096), (1, 32768), (2, 131072)])
def test_phase_resolution_divides_the_counts(patched, resolution, counts):
    surface = ms.read(patched(phase_resolution=resolution))

    assert surface.z[1, 3] == pytest.approx(4 * 0.5 * 632.8e-9 / counts, rel=1e-6, abs=0.0)


def test_sign_negates_and_is_recorded(patched, sample):
    plain, negated = ms.read(sample), ms.read(patched(sign=1))

    np.testing.assert_array_equal(negated.z, -plain.z)
    assert negated.metadata["sign"] == 1


def test_uncalibrated_is_none_never_zero(patched):
    surface = ms.read(patched(lateral_resolution=0.0))

    assert surface.dx is None
    assert surface.dy is None


def test_nan_lateral_resolution_is_uncalibrated_with_a_warning(patched):
    surface = ms.read(patched(lateral_resolution=float("nan")))

    assert surface.dx is None
    assert "NaN" in surface.metadata["warnings"][0]


def test_lateral_step_override_stands_beside_the_own_value(sample):
    surface = ms.read(sample, lateral_step=("10 um", 20e-6))

    assert (surface.dx, surface.dy) == pytest.approx((10e-6, 20e-6), abs=PM)
    assert surface.metadata["lateral_step_override_m"] == pytest.approx((10e-6, 20e-6), abs=PM)
    assert surface.metadata["lateral_step_in_file_m"] == pytest.approx((2.5e-6, 2.5e-6), abs=PM)


def test_lateral_step_without_unit_is_refused(sample):
    with pytest.raises(ms.errors.UnitError, match="no unit"):
        ms.read(sample, lateral_step="10")


def test_negative_lateral_step_is_refused(sample):
    with pytest.raises(ms.errors.DataError, match="positive"):
        ms.read(sample, lateral_step=-1e-6)


def test_unit_is_refused_since_the_format_has_one(sample):
    with pytest.raises(ms.errors.ReadError, match="takes no unit"):
        ms.read(sample, unit="um")


def test_window_and_header_are_recorded(sample):
    metadata = ms.read(sample).metadata

    assert metadata["window_origin_px"] == (139, 38)
    assert metadata["camera_px"] == (640, 480)
    assert metadata["header"]["comment"] == "planted bump, 1"
    assert metadata["header"]["time_stamp"] == 1767398400
    assert set(metadata["header"]) == {name for _, _, name in structure("metropro").layout}


def test_fields_of_the_table_do_not_overlap():
    ends = [
        offset + struct.calcsize(">" + code) for offset, code, _ in structure("metropro").layout
    ]

    assert all(end <= structure("metropro").layout[i + 1][0] for i, end in enumerate(ends[:-1]))


@pytest.mark.parametrize(
    ("fields", "match"),
    [
        ({"phase_width": 32767, "phase_height": 32767}, "more than 268435456"),
        ({"phase_width": -4}, "phase_width"),
        ({"phase_height": 0}, "phase_height"),
        ({"header_size": 2**31 - 1}, "header_size"),
        ({"header_format": 2}, "header_format"),
        ({"phase_bytes": 44}, "phase_bytes"),
        ({"intensity_bytes": -4}, "do not add up"),
        ({"intensity_bytes": 2**31 - 1}, "do not add up"),
        ({"intensity_bytes": 20}, "do not add up"),
        ({"phase_resolution": 7}, "phase_resolution"),
        ({"interferometric_scale_factor": float("nan")}, "interferometric_scale_factor"),
        ({"interferometric_scale_factor": 0.0}, "interferometric_scale_factor"),
        ({"wavelength": float("inf")}, "wavelength"),
        ({"wavelength": 0.0}, "wavelength"),
        ({"obliquity_factor": 0.0}, "obliquity_factor"),
        ({"obliquity_factor": -1.0}, "obliquity_factor"),
        ({"lateral_resolution": -1e-6}, "lateral_resolution"),
        ({"lateral_resolution": float("inf")}, "lateral_resolution"),
        (
            {"phase_width": 0, "phase_height": 0, "phase_bytes": 0},
            "intensity image only",
        ),
    ],
)
def test_header_that_lies_is_a_read_error(patched, fields, match):
    start = time.process_time()

    with pytest.raises(ms.errors.ReadError, match=match):
        ms.read(patched(**fields))

    assert time.process_time() - start < QUICK


def test_zeroed_magic_is_not_recognised(patched):
    with pytest.raises(ms.errors.UnknownFormatError):
        ms.read(patched(magic_number=0))


def test_declared_format_with_another_magic_is_a_mismatch(patched):
    with pytest.raises(ms.errors.FormatMismatchError, match="88 1b 03 6f"):
        ms.read(patched(magic_number=0), format="metropro")


def test_bytes_after_the_map_are_a_warning(sample, tmp_path):
    path = tmp_path / "longer.dat"
    path.write_bytes(sample.read_bytes() + b"\0" * 10)

    surface = ms.read(path)

    assert "10 bytes follow" in surface.metadata["warnings"][0]
    np.testing.assert_array_equal(surface.z, ms.read(sample).z)


def test_max_pixels_can_be_lowered_by_the_caller(sample):
    with pytest.raises(ms.errors.UnsupportedFeatureError, match="max_pixels"):
        ms.read(sample, max_pixels=11)


def test_intensity_channel_is_refused(sample):
    with pytest.raises(ms.errors.UnsupportedFeatureError, match="'height'"):
        ms.read(sample, channel="intensity")


def test_flat_map_is_not_silent(patched):
    path = patched()
    data = bytearray(path.read_bytes())
    data[-48:] = bytes(48)
    path.write_bytes(data)

    surface = ms.read(path)

    assert "every valid height is the same" in surface.metadata["warnings"][0]
