"""PI GCS arrays: header, separators, declared counts and intervals, damage."""

from pathlib import Path

import numpy as np
import pytest

import metrosep as ms
from metrosep.io.declared import Match
from metrosep.io.source import RawFile
from metrosep.io.text.controller_logs import pi_gcs_array

ACTUAL = "Actual Position of AXIS:1"


@pytest.fixture
def samples(repository):
    return repository / "data_formats" / "pi-gcs" / "samples"


def test_unit_is_none_of_the_file(samples):
    plain = ms.read(samples / "blank.dat")
    declared = ms.read(samples / "blank.dat", unit={ACTUAL: "um"})

    assert plain.units == {}
    assert declared.units == {ACTUAL: "m"}
    np.testing.assert_allclose(declared[ACTUAL], plain[ACTUAL] * 1e-6, rtol=1e-15)


def test_names_and_remarks(samples):
    path = samples / "blank.dat"

    assert pi_gcs_array.channels(RawFile(path))[1] == ACTUAL
    header = ms.read(path).metadata["header"]
    assert list(header["REM"]) == ["E-712", "data recorder"]
    assert header["VERSION"] == "1"


def test_column_without_a_name(samples, put):
    text = (samples / "tab.dat").read_text().replace("# NAME1", "# NAMED1")

    assert set(ms.read(put(text)).channels) == {"Target Position of AXIS:1", "column 1"}


def test_many_rows_as_numpy_reads_them(samples, put):
    rows = np.column_stack([np.arange(3000) * 0.1, np.cos(np.arange(3000))])
    head = (
        (samples / "blank.dat").read_text().split("0.0 ")[0].replace("NDATA = 4", "NDATA = 3000")
    )

    recording = ms.read(put(head + "".join(f"{a!r} {b!r} \n" for a, b in rows.tolist())))

    np.testing.assert_array_equal(recording[ACTUAL], rows[:, 1])
    assert recording.t[-1] == pytest.approx(2999 * 5e-5, rel=1e-12, abs=0.0)


def test_gap_changes_no_other_number(samples, put):
    recording = ms.read(put((samples / "tab.dat").read_text().replace("0.375", "nan")))

    np.testing.assert_array_equal(recording[ACTUAL], [0.125, np.nan, 1.25, -0.5])


def test_interval_is_not_guessed(samples):
    with pytest.raises(ms.errors.ReadError, match="sampling_rate="):
        ms.read(samples / "no-interval.dat")


@pytest.mark.parametrize(
    ("old", "new", "options", "match"),
    [
        ("DIM = 2", "DIM = 2000000000", {}, "DIM"),
        ("DIM = 2", "DIM = 0", {}, "DIM"),
        ("DIM = 2", "DIM = 3", {}, "expected 3 numbers"),
        ("NDATA = 4", "NDATA = 99999999999999999999", {}, "NDATA"),
        ("NDATA = 4", "NDATA = 3", {}, "NDATA"),
        ("SEPARATOR = 32", "SEPARATOR = 7", {}, "SEPARATOR"),
        ("SEPARATOR = 32", "SEPARATOR = 59", {}, "expected 2 numbers"),
        ("= 0.000050", "= 0", {}, "SAMPLE_TIME"),
        ("= 0.000050", "= nan", {}, "SAMPLE_TIME"),
        ("= 0.000050", "= 1e999", {}, "SAMPLE_TIME"),
        ("0.375", "1e999", {}, "not a number"),
        ("# TYPE = 1", "#", {}, "TYPE"),
        ("# END_HEADER", "#", {}, "END_HEADER"),
        ("# REM", "# REM", {"sampling_rate": 1.0}, "leave it out"),
        ("# REM", "# REM", {"lateral_step": 1.0}, "lateral_step"),
    ],
)
def test_header_or_row_that_lies(samples, put, old, new, options, match):
    text = (samples / "blank.dat").read_text()
    assert old in text

    with pytest.raises(ms.errors.ReadError, match=match):
        ms.read(put(text.replace(old, new, 1)), format="pi-gcs", **options)


@pytest.mark.parametrize(
    "head",
    [b"", b"# END_HEADER\n1 2\n", b"# DIM = 2\n# TYPE = 1\n# SEPARATOR = 32\n1 2\n", b"\xff\x00"],
)
def test_other_text_is_not_claimed(head):
    assert pi_gcs_array.sniff(RawFile(Path("a.dat"), head)) is Match.NO


@pytest.mark.parametrize("name", ["blank.dat", "tab.dat"])
def test_damage_is_a_read_error_or_a_recording(samples, survives_damage, name):
    survives_damage(pi_gcs_array, samples / name)
