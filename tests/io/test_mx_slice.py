"""Slices of Zygo Mx: real files, stacked slices, units that the file does not state."""

import csv
from pathlib import Path

import numpy as np
import pytest

import metrosep as ms
from metrosep.io.declared import Match
from metrosep.io.read import channels
from metrosep.io.registry import identify
from metrosep.io.source import RawFile
from metrosep.io.text.point_lists import mx_slice

NM = 1e-9
REL = 1e-6  # digits of the manifest of the corpus
PM = 1e-12
FM = 1e-15


@pytest.fixture
def folder(repository):
    return repository / "data_formats" / "mx-slice" / "samples"


@pytest.mark.parametrize(
    ("name", "shape", "dx", "n_invalid", "pv", "sq"),
    [
        ("1021-WLI-2D.csv", 1143, 8.711816145251079e-07, 144, 1258.895, 302.3574),
        ("1023-WLI-2D.csv", 1047, 8.711599197171619e-07, 52, 434.0051, 93.05667),
    ],
)
def test_real_files_as_the_manifest_gives_them(corpus, name, shape, dx, n_invalid, pv, sq):
    path = corpus / "upm" / name

    profile = ms.read(path)

    assert identify(path).id == "mx-slice"
    assert len(profile) == shape
    assert profile.n_invalid == n_invalid
    assert profile.dx == pytest.approx(dx, rel=REL, abs=0.0)
    assert profile.peak_to_valley() == pytest.approx(pv * NM, rel=REL, abs=0.0)
    assert profile.rms() == pytest.approx(sq * NM, rel=REL, abs=0.0)
    assert "taken as um" in profile.metadata["warnings"][0]


def test_real_file_point_by_point(corpus):
    """The csv module alone gives the same positions and heights."""
    path = corpus / "upm" / "1023-WLI-2D.csv"
    with path.open(newline="") as handle:
        rows = list(csv.reader(handle))[1:]

    profile = ms.read(path, unit="um")

    x = np.array([float(r[0]) for r in rows])
    z = np.array([float(r[1]) if r[1].strip() else np.nan for r in rows])
    np.testing.assert_allclose(profile.x, x * 1e-6, rtol=0, atol=FM)
    np.testing.assert_allclose(profile.z, z * 1e-6, rtol=0, atol=FM)
    assert profile.metadata["warnings"] == ()


def test_channels_are_the_slices_in_the_order_of_the_file(folder):
    assert channels(folder / "two-slices.csv") == ("Slice 1", "Slice 2")


def test_first_slice_is_read_with_a_warning_that_names_the_others(folder):
    profile = ms.read(folder / "two-slices.csv", unit="um")

    assert profile.metadata["slice"] == "Slice 1"
    assert profile.metadata["warnings"] == (
        "read slice 'Slice 1'; the file also holds 'Slice 2': choose with channel=",
    )


def test_slice_that_is_not_there_is_refused_with_those_that_are(folder):
    with pytest.raises(ms.errors.FormatMismatchError, match="'Slice 1', 'Slice 2'"):
        ms.read(folder / "two-slices.csv", channel="Slice 3")


def test_unit_of_one_column_leaves_the_other(folder):
    profile = ms.read(folder / "one-slice.csv", unit={"Y": "nm"})

    assert profile.x[0] == pytest.approx(0.871e-6, abs=FM)
    assert np.nanmin(profile.z) == pytest.approx(-0.5e-9, abs=FM)
    assert profile.metadata["units_from"] == "caller"


@pytest.mark.parametrize(
    ("unit", "error", "match"),
    [
        ("V", ms.errors.UnitError, "a length is needed"),
        ({"Z": "um"}, ms.errors.FormatMismatchError, "no column 'Z'"),
        (("um", "um", "um"), ms.errors.ReadError, "3 units"),
    ],
)
def test_unit_that_does_not_fit_is_refused(folder, unit, error, match):
    with pytest.raises(error, match=match):
        ms.read(folder / "one-slice.csv", unit=unit)


def test_lateral_step_override_is_recorded(folder):
    profile = ms.read(folder / "one-slice.csv", lateral_step="2 um")

    assert profile.dx == pytest.approx(2e-6, abs=PM)
    assert profile.x[0] == pytest.approx(0.871e-6, abs=PM)
    assert profile.metadata["lateral_step_in_file_m"] == pytest.approx(0.871e-6, abs=PM)
    assert profile.metadata["lateral_step_override_m"] == pytest.approx(2e-6, abs=PM)


def test_missing_line_end_is_a_warning(folder, put):
    data = (folder / "one-slice.csv").read_bytes().rstrip()

    profile = ms.read(put(data), unit="um")

    assert "does not end with a line end" in profile.metadata["warnings"][0]


@pytest.mark.parametrize(
    "text",
    ["X,Y,Slice\n1,2,Slice 1\n", "X ,Y ,Z\n1 ,2 ,3\n", "x ,y ,Slice\n1,2,Slice 1\n", "X "],
)
def test_other_tables_are_not_taken_for_slices(text):
    assert mx_slice.sniff(RawFile(Path("slice.csv"), text.encode())) is Match.NO


@pytest.mark.parametrize(
    ("old", "new", "match"),
    [
        (b"0.02 ", b"0.02x", "'0.02x"),
        (b"0.871", b"     ", "no position"),
        (b"1.742", b"9.742", "not strictly monotonic"),
        (b"Slice 1\n2.613", b"       \n2.613", "a row does not fit"),
    ],
)
def test_text_that_lies_is_a_corrupt_file(folder, put, old, new, match):
    data = (folder / "declared-units.csv").read_bytes()
    assert old in data

    with pytest.raises(ms.errors.CorruptFileError, match=match):
        ms.read(put(data.replace(old, new, 1)))


def test_other_header_is_a_mismatch(put):
    with pytest.raises(ms.errors.FormatMismatchError, match="not a slice export"):
        ms.read(put("A ,B ,Slice\n1 ,2 ,Slice 1\n"), format="mx-slice")


def test_damaged_files_are_refused_or_read(folder, survives_damage):
    survives_damage(mx_slice, folder / "two-slices.csv")
