"""TwinCAT Scope exports: FILETIME without loss, groups that end early, decimal marks, damage."""

from pathlib import Path

import numpy as np
import pytest

import metrosep as ms
from metrosep.io.declared import Match
from metrosep.io.source import RawFile
from metrosep.io.text import twincat_scope

START = 132959733843760000
HEADER = (
    "Name;scope;\nFile;scope.csv;\nStarttime of export;{start};Montag;15:56:24.376\n"
    "Endtime of export;{end};Montag;15:56:25.375\n\n\n"
    "Name;x;y\nSymbolComment;;\nData-Type;REAL64;REAL64\nSampleTime[ms];0,0001;0,0001\n"
    "Unit;um (Length);(None)\n\n"
)


def export(rows, end=START):
    return HEADER.format(start=START, end=end) + "\n".join(rows) + "\n"


@pytest.fixture
def samples(repository):
    return repository / "data_formats" / "twincat-scope" / "samples"


def test_ticks_of_100_ns_survive(put):
    """In float64 the stamps would be rounded to multiples of 16 ticks."""
    ticks = START + 3 + np.arange(20) * 1
    rows = [f"{t};{k};{-k}" for k, t in enumerate(ticks)]

    recording = ms.read(put(export(rows, end=int(ticks[-1]))))

    np.testing.assert_array_equal(recording.t, np.arange(20) * 1e-7)
    assert recording.metadata["start_filetime"] == START + 3
    assert recording.metadata["start_utc"] == "2022-05-02T13:56:24.3760003Z"


def test_wrapped_angle_is_left_as_it_is(samples):
    recording = ms.read(samples / "filetime.csv")

    degrees = np.rad2deg(recording["Axis C"])
    np.testing.assert_allclose(degrees, [359.5, 0.25, 1.5], rtol=1e-12)
    assert recording.units == {"Axis 1.ActPos": "m", "Axis C": "rad"}


def test_channel_called_name_is_no_column_of_time(samples):
    assert "Name" in ms.read(samples / "filetime.csv").channels


def test_groups_with_different_times_need_a_channel(samples):
    with pytest.raises(ms.errors.FormatMismatchError, match="channel="):
        ms.read(samples / "comma-slow-group.csv")

    fast = ms.read(samples / "comma-slow-group.csv", channel="Axis 1.ActPos")

    np.testing.assert_allclose(fast.t, [0.0, 2e-4, 4e-4, 6e-4], rtol=1e-12)
    np.testing.assert_allclose(
        fast["Axis 1.ActPos"], [10.5e-3, -11.5e-3, 12.5e-3, -13.5e-3], rtol=1e-12
    )


def test_many_rows_as_an_independent_parse(put):
    rows = [f"{k * 0.25};{float(np.sin(k))!r};{k}" for k in range(5000)]

    recording = ms.read(put(export(rows)))

    np.testing.assert_array_equal(recording["x"], np.sin(np.arange(5000)) * 1e-6)
    np.testing.assert_allclose(recording.t, np.arange(5000) * 0.25e-3, rtol=1e-12)


def test_gap_changes_no_other_number(put):
    rows = ["0;1.5;2.5", "1;;3.5", "2;4.5;5.5"]

    recording = ms.read(put(export(rows)))

    np.testing.assert_allclose(recording["x"], [1.5e-6, np.nan, 4.5e-6], rtol=1e-12)
    np.testing.assert_array_equal(recording["y"], [2.5, 3.5, 5.5])


@pytest.mark.parametrize("separator", [";", "\t"])
def test_gap_at_the_end_of_a_row(put, separator):
    text = export(["0;1.5;2.5", "1;2.5;", "2;4.5;5.5"]).replace("0,0001", "0.0001")

    recording = ms.read(put(text.replace(";", separator)))

    np.testing.assert_array_equal(recording["y"], [2.5, np.nan, 5.5])


def test_unit_for_a_channel_without_one(put):
    recording = ms.read(put(export(["0;1;2", "1;3;4"])), unit={"y": "arcsec"})

    assert recording.units["y"] == "rad"


@pytest.mark.parametrize(
    ("rows", "match"),
    [
        (["0;1;2", "1;3"], "does not end with a group"),
        (["0;1;2", "1;3;4;5"], "does not end with a group"),
        (["0;1;2", ";3;4"], "no time"),
        (["1;1;2", "1;3;4"], "do not fit"),
        (["0;1;2", "1;1e999;4"], "x is not a number"),
        (["0;1;2", "1;1,5;4.5"], "not a number"),
        (["0;;", "1;;"], "no channel holds a number"),
        ([], "no row of numbers"),
    ],
)
def test_rows_that_do_not_fit(put, rows, match):
    with pytest.raises(ms.errors.CorruptFileError, match=match):
        ms.read(put(export(rows)))


def test_separator_inside_a_name_is_refused(put):
    text = export(["0;1;2"]).replace("Name;x;y", "Name;x;y;z")

    with pytest.raises(ms.errors.UnsupportedFeatureError, match="part of a name"):
        ms.read(put(text))


@pytest.mark.parametrize("head", [b"", b"Name;x;y\n0;1;2\n", b"\x00\xff", b"Data-Type;REAL64\n"])
def test_other_text_is_not_claimed(head):
    assert twincat_scope.sniff(RawFile(Path("scope.csv"), head)) is Match.NO


@pytest.mark.parametrize("name", ["filetime.csv", "comma-slow-group.csv"])
def test_damage_is_a_read_error_or_a_recording(samples, survives_damage, name):
    options = {"channel": "probe"} if "slow" in name else {}
    survives_damage(twincat_scope, samples / name, **options)
