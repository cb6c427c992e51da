"""Zygo XYZ text: window in the camera frame, unit of z, order of the lines, and files that lie."""

from functools import partial
from pathlib import Path

import numpy as np
import pytest

import metrosep as ms
from metrosep.io.declared import Match
from metrosep.io.source import RawFile
from metrosep.io.text import zygo_xyz

PM = 1e-12
FM = 1e-15

read = partial(ms.read, row_order="top row first")


@pytest.fixture
def folder(repository):
    return repository / "data_formats" / "zygo-xyz" / "samples"


@pytest.fixture
def edited(folder, put):
    """Write the calibrated sample with one text replaced and return its path."""

    def write(old, new):
        text = (folder / "calibrated.xyz").read_text(encoding="latin-1")
        assert old in text
        return put(text.replace(old, new, 1), "edited.xyz")

    return write


def test_top_row_of_the_camera_has_the_largest_y(folder):
    surface = read(folder / "calibrated.xyz")

    assert np.unravel_index(np.nanargmax(surface.z), surface.shape) == (2, 0)
    assert np.isnan(surface.z[2, 3])
    assert surface.metadata["row_order_in_file"] == "top row first"


def test_points_are_placed_by_their_indices_whatever_their_order(folder, put):
    lines = (folder / "calibrated.xyz").read_text(encoding="latin-1").splitlines()
    first = lines.index("#") + 1
    body = lines[first:-1]
    order = np.random.default_rng(3).permutation(len(body))
    mixed = put("\n".join([*lines[:first], *(body[i] for i in order), "#"]), "mixed.xyz")

    shuffled = read(mixed)

    np.testing.assert_array_equal(shuffled.z, read(folder / "calibrated.xyz").z)


def test_random_window_against_a_parser_of_its_own(put):
    rng = np.random.default_rng(11)
    z = rng.normal(0.0, 0.05, (7, 5)).round(6)
    lines = ["Zygo XYZ Data File - Format 1", "0 0 0 0", "0 0 0 0 0 0", "20 30 5 7", "", "", ""]
    lines += ["0 0.5 6.3e-07 0.5 1 0 1e-05 0", "640 480", "#"]
    lines += [f"{20 + c} {30 + r} {z[r, c]}" for r in range(7) for c in range(5)]
    path = put("\r\n".join([*lines, "#", ""]), "random.xyz")

    surface = read(path)

    assert surface.shape == (7, 5)
    np.testing.assert_allclose(surface.z[::-1], z * 1e-6, rtol=0, atol=FM)
    assert (surface.dx, surface.dy) == pytest.approx((1e-5, 1e-5), abs=PM)
    assert surface.metadata["window_origin_px"] == (20, 30)
    assert surface.metadata["camera_px"] == (640, 480)


def test_assumed_micrometres_are_a_warning_with_the_peak_to_valley(folder):
    surface = read(folder / "uncalibrated.xyz")

    assert "taken as um, so that P-V is 907 nm" in surface.metadata["warnings"][0]
    assert surface.metadata["height_unit_from"] == "description of the format"


def test_declared_unit_replaces_the_assumption_and_is_recorded(folder):
    surface = read(folder / "uncalibrated.xyz", unit="m")

    assert surface.peak_to_valley() == pytest.approx(0.907, abs=PM)
    assert surface.metadata["height_unit"] == "m"
    assert surface.metadata["height_unit_from"] == "caller"
    assert surface.metadata["warnings"] == (surface.metadata["unproven"],)


def test_unit_that_is_no_length_is_refused(folder):
    with pytest.raises(ms.errors.UnitError, match="a length is needed"):
        read(folder / "uncalibrated.xyz", unit="V")


def test_uncalibrated_is_none_and_an_override_is_recorded(folder):
    plain = read(folder / "uncalibrated.xyz")
    declared = read(folder / "uncalibrated.xyz", lateral_step=("10 um", "20 um"))

    assert (plain.dx, plain.dy) == (None, None)
    assert (declared.dx, declared.dy) == pytest.approx((10e-6, 20e-6), abs=PM)
    assert declared.metadata["lateral_step_in_file_m"] == (None, None)
    assert declared.metadata["lateral_step_override_m"] == pytest.approx((10e-6, 20e-6), abs=PM)


def test_header_fields_are_kept_as_they_stand(folder):
    header = read(folder / "calibrated.xyz").metadata["header"]

    assert header["comment"] == "planted bump, top left"
    assert header["software_date"] == "Sat Jan  3 00:00:00 2026"
    assert header["wavelength"] == "6.328e-07"
    assert header["line_10_field_8"] == "60.4318"


@pytest.mark.parametrize(
    ("old", "new", "match"),
    [
        ("340 638 4 3", "340 638 -4 3", "phase_width"),
        ("340 638 4 3", "340 638 4", "phase_height"),
        ("340 638 4 3", "340 638 4 3000", "do not fill the window"),
        ("340 638 4 3", "340 638 3 4", "outside of the window"),
        ("341 638 0.01", "341.5 638 0.01", "outside of the window"),
        ("341 638 0.01", "341 638 0.01x", "'0.01x'"),
        ("341 638 0.01", "341 638", "cut off"),
        ("341 638 0.01", "nan 638 0.01", "outside of the window"),
        ("2.5e-06", "-1", "lateral_resolution"),
        ("2.5e-06", "nan", "lateral_resolution"),
        ("2.5e-06", "1e400", "lateral_resolution"),
        ("\n#\n340", "\n340", "the list of points is cut off"),
        ('"P1"', '"P1"\n#', "the header is cut off"),
    ],
)
def test_text_that_lies_is_a_corrupt_file(edited, old, new, match):
    with pytest.raises(ms.errors.CorruptFileError, match=match):
        ms.read(edited(old, new))


def test_error_names_the_offset_of_the_field(edited):
    path = edited("342 640 -0.007", "342 64O -0.007")

    with pytest.raises(ms.errors.CorruptFileError) as caught:
        ms.read(path)

    assert caught.value.offset == path.read_bytes().index(b"64O")


def test_other_format_number_is_unsupported(edited):
    with pytest.raises(ms.errors.UnsupportedFeatureError, match="Format 2"):
        ms.read(edited("Format 1", "Format 2"))


def test_text_without_the_title_is_not_recognised(edited):
    path = edited("Zygo XYZ", "Some XYZ")

    assert zygo_xyz.sniff(RawFile(Path("surface.xyz"), path.read_bytes())) is Match.NO
    with pytest.raises(ms.errors.FormatMismatchError, match="is not a Zygo XYZ file"):
        ms.read(path, format="zygo-xyz")


def test_quarter_of_a_million_points_are_not_read_one_by_one(put, calls):
    n = 500
    lines = ["Zygo XYZ Data File - Format 1", "0", "0", f"0 0 {n} {n}", "", "", "", "0", "0", "#"]
    lines += [f"{c} {r} {0.001 * c + 1e-6 * r:.6f}" for r in range(n) for c in range(n)]
    path = put("\n".join([*lines, "#\n"]), "large.xyz")

    steps, surface = calls(lambda: read(path))

    assert steps < n * n / 2  # a fifth of them, to tell the format
    assert surface.z[0, 1] == pytest.approx(1e-9 + 0.499e-9, abs=FM)


@pytest.mark.parametrize("name", ["calibrated.xyz", "not-all-listed.xyz"])
def test_damaged_files_are_refused_or_read(folder, survives_damage, name):
    survives_damage(zygo_xyz, folder / name)
