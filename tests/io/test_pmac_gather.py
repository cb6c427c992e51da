"""Columns of a PMAC gather: declared period, names and counts."""

from pathlib import Path

import numpy as np
import pytest

import metrosep as ms
from metrosep.io.declared import Match
from metrosep.io.source import RawFile
from metrosep.io.text.sampled import pmac_gather


@pytest.fixture
def sample(repository):
    return repository / "data_formats" / "pmac-gather" / "samples" / "counts.txt"


def gathered(path, **options):
    return ms.read(path, format="pmac-gather", **options)


def test_period_is_not_guessed(sample):
    with pytest.raises(ms.errors.ReadError, match="sampling_rate= or servo_period="):
        gathered(sample)


def test_period_twice_is_refused(sample):
    with pytest.raises(ms.errors.ReadError, match="both"):
        gathered(sample, sampling_rate=1e3, servo_period=1e-3)


def test_rate_or_period(sample):
    by_rate = gathered(sample, sampling_rate="2 kHz")
    by_period = gathered(sample, servo_period=0.125e-3, gather_period=4)

    np.testing.assert_allclose(by_rate.t, [0.0, 0.5e-3, 1e-3], rtol=1e-12)
    np.testing.assert_allclose(by_period.t, by_rate.t, rtol=1e-12)


def test_one_scale_for_all_and_one_for_each(sample):
    shared = gathered(sample, sampling_rate=1.0, scale="2 um", channel="column 1")
    each = gathered(sample, sampling_rate=1.0, scale=["1 nm", 2.0, "1 mV"])

    np.testing.assert_allclose(shared["column 1"], [-6e-6, 14e-6, -40e-6], rtol=1e-12)
    np.testing.assert_allclose(each["column 1"], [-6.0, 14.0, -40.0], rtol=1e-12)
    assert each.units == {"column 0": "m", "column 2": "V"}
    assert each.metadata["count_scale"]["column 0"] == "1.0 nm"


def test_names_of_the_channels(sample):
    assert pmac_gather.channels(RawFile(sample)) == ("column 0", "column 1", "column 2")


@pytest.mark.parametrize(
    ("text", "options", "match"),
    [
        ("1 2\n3\n", {}, "line 2"),
        ("1 $7FFF\n", {}, "line 1"),
        ("\n\n", {}, "no row of numbers"),
        ("1 2\n", {"gather_period": 0}, "gather_period"),
        ("1 2\n", {"gather_period": 1.5}, "gather_period"),
        ("1 2\n", {"scale": "1 parsec"}, "parsec"),
        ("1 2\n", {"scale": float("nan")}, "finite"),
    ],
)
def test_text_or_option_that_does_not_fit(put, text, options, match):
    with pytest.raises((ms.errors.ReadError, ms.errors.DataError), match=match):
        gathered(put(text), sampling_rate=1.0, **options)


def test_never_recognised(sample):
    assert pmac_gather.sniff(RawFile(Path("gather.gat"), sample.read_bytes())) is Match.NO


def test_damage_is_a_read_error_or_a_recording(sample, survives_damage):
    survives_damage(pmac_gather, sample, servo_period=1e-3, scale="0.5 nm")
