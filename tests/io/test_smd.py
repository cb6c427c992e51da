"""ISO 5436-2 profiles: units and scale by hand, checksums, and records that lie."""

from pathlib import Path

import numpy as np
import pytest

import metrosep as ms
from metrosep.io.declared import Match
from metrosep.io.source import RawFile
from metrosep.io.text import smd

PM = 1e-12
FM = 1e-15


@pytest.fixture
def folder(repository):
    return repository / "data_formats" / "smd" / "samples"


@pytest.fixture
def edited(folder, put):
    """Write the plain sample with one text replaced and return its path."""

    def write(old, new):
        data = (folder / "profile.smd").read_bytes()
        assert old in data
        return put(data.replace(old, new, 1), "edited.smd")

    return write


def test_step_is_in_the_unit_of_x_and_heights_in_that_of_z(folder):
    profile = ms.read(folder / "profile.smd")

    assert profile.dx == pytest.approx(0.25e-6, abs=PM * 1e-3)
    assert profile.z[2] == pytest.approx(0.5e-6, abs=FM)
    assert np.argmax(profile.z) == 2
    assert profile.metadata["warnings"] == (profile.metadata["unproven"],)


def test_header_and_information_are_kept(folder):
    header = ms.read(folder / "profile.smd").metadata["header"]

    assert header["revision"] == "ISO 5436 - 2000"
    assert header["file_identifier"] == "bump"
    assert header["axes"][0].startswith("CX  I  5 mm")
    assert "DATE 03-Jan-2026" in header["information"]


@pytest.mark.parametrize("modulus", [65536, 65535])
def test_checksum_of_either_modulus_is_accepted(put, folder, modulus):
    """Long enough that the two differ; summed here byte by byte."""
    text = (folder / "profile.smd").read_bytes().split(b"\x03")
    head = text[0].replace(b" 5 ", b" 400 ")
    data = head + b"\x03" + text[1] + b"\x03\r\n" + b"-0.296539\r\n" * 399 + b"1.5\r\n\x03\r\n"
    total = 0
    for byte in data:
        total = (total + byte) % modulus

    profile = ms.read(put(data + f"{total}\r\n".encode() + b"\x03\r\n\x1a", "long.smd"))

    assert len(profile) == 400
    assert profile.metadata["warnings"] == (profile.metadata["unproven"],)


def test_missing_checksum_is_a_warning(folder, put):
    data = (folder / "profile.smd").read_bytes()
    start = data.rindex(b"\x03", 0, data.rindex(b"\x03")) + 1

    profile = ms.read(put(data[:start], "open.smd"))

    assert profile.metadata["warnings"][0] == "the checksum is missing"


def test_lateral_step_override_is_recorded(folder):
    profile = ms.read(folder / "profile.smd", lateral_step="1 um")

    assert profile.dx == pytest.approx(1e-6, abs=PM)
    assert profile.metadata["lateral_step_in_file_m"] == pytest.approx(0.25e-6, abs=PM)
    assert profile.metadata["lateral_step_override_m"] == pytest.approx(1e-6, abs=PM)


@pytest.mark.parametrize(
    ("old", "new", "match"),
    [
        (b"2.5e-4", b"0", "the step"),
        (b"2.5e-4", b"nan", "the step"),
        (b"2.5e-4", b"-1", "the step"),
        (b" 2.5e-4", b"", "the step"),
        (b"um\0 1.0e0", b"um\0 0", "CZ scale"),
        (b"um\0 1.0e0", b"um\0 1e400", "scale"),
        (b"CX\0 I", b"CX\0 Q", "unknown type"),
        (b"CZ\0 A", b"CZ\0 I", "must be absolute"),
        (b"CZ\0 A", b"CY\0 A", "field CZ"),
        (b"I\0 5 mm", b"I\0 6 mm", "do not fill the profile"),
        (b"I\0 5 mm", b"I\0 0 mm", "CX points"),
        (b"0.5\r\n", b"0.5x\r\n", "'0.5x'"),
        (b"0.5\r\n", b"\r\n", "do not fill the profile"),
    ],
)
def test_text_that_lies_is_a_corrupt_file(edited, old, new, match):
    with pytest.raises(ms.errors.CorruptFileError, match=match):
        ms.read(edited(old, new))


def test_unit_that_is_no_length_is_refused(edited):
    with pytest.raises(ms.errors.UnitError, match="line 4"):
        ms.read(edited(b"um\0", b"V\0"))


def test_scale_of_an_incremental_axis_is_not_guessed(edited):
    with pytest.raises(ms.errors.UnsupportedFeatureError, match="not certain"):
        ms.read(edited(b"mm\0 1.0e0", b"mm\0 2.0e0"))


def test_absurd_number_of_points_is_refused(edited):
    with pytest.raises(ms.errors.UnsupportedFeatureError, match="max_pixels"):
        ms.read(edited(b"I\0 5 mm", b"I\0 999999999 mm"))


@pytest.mark.parametrize(
    "head", [b"ISO 5437\r\nPRF 1 a\r\n", b"ISO 5436\r\nXYZ 1\r\n", b"<ISO5436_2>"]
)
def test_other_text_is_not_recognised(put, head):
    assert smd.sniff(RawFile(Path("profile.smd"), head)) is Match.NO
    with pytest.raises(ms.errors.FormatMismatchError, match="is not an ISO 5436-2 file"):
        ms.read(put(head), format="smd")


@pytest.mark.parametrize("name", ["profile.smd", "integers.smd"])
def test_damaged_files_are_refused_or_read(folder, survives_damage, name):
    survives_damage(smd, folder / name)
