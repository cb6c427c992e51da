"""Text of halsampler: declared names and rate, lost samples, numbers of samples, damage."""

from pathlib import Path

import numpy as np
import pytest

import metrosep as ms
from metrosep.io.declared import Match
from metrosep.io.source import RawFile
from metrosep.io.text.sampled import halsampler


@pytest.fixture
def samples(repository):
    return repository / "data_formats" / "halsampler" / "samples"


def sampled(path, **options):
    return ms.read(path, format="halsampler", **{"sampling_rate": "1 kHz", **options})


def test_rate_is_not_guessed(samples):
    with pytest.raises(ms.errors.ReadError, match="sampling_rate="):
        ms.read(samples / "numbered.txt", format="halsampler", numbered=True)


def test_lost_samples_are_a_gap(samples):
    recording = sampled(samples / "numbered.txt", numbered=True)

    np.testing.assert_allclose(recording.t, [0.0, 1e-3, 5e-3, 6e-3], rtol=1e-12)
    np.testing.assert_array_equal(recording["pin 1"], [-0.25, 0.75, -1.75, 3.25])
    assert "3 samples are lost" in recording.metadata["warnings"][0]


def test_lost_samples_without_numbers_need_a_part(samples):
    with pytest.raises(ms.errors.FormatMismatchError, match=r"segment=0 \.\.\. segment=1"):
        sampled(samples / "second-part.txt")

    np.testing.assert_array_equal(
        sampled(samples / "second-part.txt", segment=0)["pin 0"], [1.5, 2.5]
    )


def test_part_that_is_not_there(samples):
    with pytest.raises(ms.errors.FormatMismatchError, match="no segment 2"):
        sampled(samples / "second-part.txt", segment=2)


def test_forgotten_numbers_are_pointed_out(put):
    recording = sampled(put("5 0.5 \n6 1.5 \n7 2.5 \n"))

    assert "numbered=True" in recording.metadata["warnings"][0]


def test_scale_of_counts(put):
    path = put("100 1\n-200 2\n")

    recording = sampled(path, names=["x", "y"], scale={"x": "0.5 nm"})

    np.testing.assert_allclose(recording["x"], [50e-9, -100e-9], rtol=1e-12)
    np.testing.assert_array_equal(recording["y"], [1.0, 2.0])
    assert recording.units == {"x": "m"}


def test_many_rows_as_numpy_reads_them(put):
    rows = np.column_stack([np.arange(4000) * 0.5, np.sin(np.arange(4000)).round(6)])
    path = put("".join(f"{a:f} {b:f} \n" for a, b in rows))

    recording = sampled(path)

    np.testing.assert_array_equal(recording["pin 1"], rows[:, 1])
    assert recording.t[-1] == pytest.approx(3.999, rel=1e-12, abs=0.0)


def test_names_of_the_channels(samples):
    names = halsampler.channels(RawFile(samples / "second-part.txt"))

    assert names == ("pin 0", "pin 1", "pin 2")


@pytest.mark.parametrize(
    ("text", "options", "match"),
    [
        ("1 2\n3\n", {}, "line 2"),
        ("1 2\n3 4 5\n", {}, "line 2"),
        ("1 2\n3 x\n", {}, "line 2"),
        ("1 2\n3 1e999\n", {}, "line 2"),
        ("overrun\n", {}, "no row of numbers"),
        ("5 1\n5 2\n", {"numbered": True}, "do not rise"),
        ("5.5 1\n6.5 2\n", {"numbered": True}, "no sample numbers"),
        ("5\n6\n", {"numbered": True}, "no sample numbers"),
        ("1 2\n3 4\n", {"names": ["x"]}, "names="),
        ("1 2\n3 4\n", {"names": ["x", "x"]}, "names="),
        ("1 2\n3 4\n", {"sampling_rate": -1.0}, "positive"),
        ("1 2\n3 4\n", {"sampling_rate": "0 Hz"}, "positive"),
        ("1 2\n3 4\n", {"scale": 0.0}, "not zero"),
        ("1 2\n3 4\n", {"scale": "nm"}, "number with a unit"),
        ("1 2\n3 4\n", {"scale": [1.0]}, "1 entries"),
        ("1 2\n3 4\n", {"scale": {"z": 1.0}}, "no channel 'z'"),
        ("1 2\n3 4\n", {"lateral_step": 1.0}, "lateral_step"),
    ],
)
def test_text_or_option_that_does_not_fit(put, text, options, match):
    with pytest.raises((ms.errors.ReadError, ms.errors.DataError), match=match):
        sampled(put(text), **options)


@pytest.mark.parametrize(
    ("head", "sure"),
    [
        (b"1 2\n3 4\n", Match.NO),
        (b"1 2\noverrun\n3 4\n", Match.YES),
        (b"overrun\n", Match.NO),
        (b"a b\noverrun\n", Match.NO),
        (b"\x00\xff", Match.NO),
        (b"", Match.NO),
    ],
)
def test_sure_only_where_samples_were_lost(head, sure):
    assert halsampler.sniff(RawFile(Path("a.txt"), head)) is sure


@pytest.mark.parametrize("options", [{"numbered": True}, {"segment": 0}])
def test_damage_is_a_read_error_or_a_recording(samples, survives_damage, options):
    survives_damage(halsampler, samples / "numbered.txt", sampling_rate=1e3, **options)
