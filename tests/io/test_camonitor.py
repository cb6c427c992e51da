"""Text of camonitor: the union of irregular times, alarms, silent variables, damage."""

from pathlib import Path

import numpy as np
import pytest

import metrosep as ms
from metrosep.io.declared import Match
from metrosep.io.source import RawFile
from metrosep.io.text.controller_logs import camonitor


@pytest.fixture
def samples(repository):
    return repository / "data_formats" / "camonitor" / "samples"


def line(name, time, value):
    return f"{name:30} 2024-03-01 {time} {value}\n"


def test_start_is_absolute_and_times_cross_midnight(samples):
    recording = ms.read(samples / "interleaved.txt")

    assert recording.metadata["start_local"] == "2024-03-01T23:59:59.750000000"
    np.testing.assert_array_equal(recording.t, [0.0, 0.125, 0.5, 1.25])


def test_one_variable_has_its_own_times(samples):
    recording = ms.read(samples / "interleaved.txt", channel="stage:y")

    np.testing.assert_array_equal(recording.t, [0.125, 0.5])
    np.testing.assert_array_equal(recording["stage:y"], [-2.25, -2.5])


def test_alarm_is_not_part_of_the_value(samples):
    assert ms.read(samples / "interleaved.txt", channel="stage:y")["stage:y"][1] == -2.5


def test_what_was_left_out_is_said(samples):
    notes = " ".join(ms.read(samples / "odd-lines.txt").metadata["warnings"])

    for part in ("gone reported nothing", "mode holds", "1 values with severity INVALID", "old "):
        assert part in notes


def test_microseconds_of_many_days_are_exact(put):
    text = line("a", "00:00:00.000001", 1) + line("a", "23:59:59.999999", 2)

    recording = ms.read(put(text + text.replace("03-01", "12-31")))

    assert recording.t[1] == pytest.approx(86399.999998, abs=1e-9)
    assert recording.t[3] - recording.t[2] == pytest.approx(86399.999998, abs=1e-8)


def test_same_time_twice_keeps_the_last(put):
    text = line("a", "10:00:00.5", 1) + line("a", "10:00:00.5", "2 HIGH MINOR")

    recording = ms.read(put(text + line("a", "10:00:01.0", 3)))

    np.testing.assert_array_equal(recording["a"], [2.0, 3.0])
    assert "a has 1 lines" in recording.metadata["warnings"][0]


@pytest.mark.parametrize(
    ("text", "match"),
    [
        (line("a", "25:00:00.0", 1), "no time"),
        (line("a", "10:00:00.0", 1) + "a 10:00:01 2\n", "line 2"),
        (line("a", "10:00:00.0", 1) + line("a", "09:00:00.0", 2), "goes back"),
        (line("a", "10:00:00.0", 1) + line("a", "10:00:01.0", "1e999"), "not a number"),
        (line("a", "10:00:00.0", "On") + line("a", "10:00:01.0", "Off"), "no variable holds"),
        (line("a", "10:00:00.0", "3 1 2 3"), "no variable holds"),
        (line("a", "10:00:00.0", "1 UDF INVALID"), "no variable holds"),
    ],
)
def test_lines_that_do_not_fit(put, text, match):
    with pytest.raises(ms.errors.ReadError, match=match):
        ms.read(put(text), format="camonitor")


@pytest.mark.parametrize(
    "head",
    [b"", b"2024-03-01 10:00:00 1.5\n", b"t,x\n0,1\n", b"a b c\n", b"\xff\x00\x01", b"1 2 3 4\n"],
)
def test_other_text_is_not_claimed(head):
    assert camonitor.sniff(RawFile(Path("a.txt"), head)) is Match.NO


@pytest.mark.parametrize("name", ["interleaved.txt", "odd-lines.txt"])
def test_damage_is_a_read_error_or_a_recording(samples, survives_damage, name):
    survives_damage(camonitor, samples / name)
