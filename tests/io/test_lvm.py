"""LabVIEW measurement files: real ones, decimal marks, ragged channels, segments, damage."""

import numpy as np
import pytest

import metrosep as ms
from metrosep.io.text import lvm

TEXT = 1e-12  # relative; text to double and one factor


@pytest.fixture
def samples(repository):
    return repository / "data_formats" / "lvm" / "samples"


@pytest.mark.parametrize(
    ("name", "shape"),
    [
        ("long_single_header_multi_ch.lvm", (16384, 3)),
        ("short.lvm", (10, 2)),
        ("multi_time_column.lvm", (3, 2)),
        ("no_decimal_separator.lvm", (4, 3)),
        ("with_comments.lvm", (9, 3)),
    ],
)
def test_shape_of_the_real_files(corpus, name, shape):
    recording = ms.read(corpus / "lvm" / name)

    assert (len(recording), len(recording.channels)) == shape
    assert all(np.isfinite(v).all() for v in recording.channels.values())


def test_real_long_file_as_numpy_reads_it(corpus):
    """Independent: numpy.loadtxt of the rows below the header."""
    path = corpus / "lvm" / "long_single_header_multi_ch.lvm"
    truth = np.loadtxt(path, skiprows=22, usecols=(0, 1, 2))

    recording = ms.read(path)

    np.testing.assert_array_equal(recording["F"], truth[:, 0])
    np.testing.assert_array_equal(recording["m_2"], truth[:, 2])
    np.testing.assert_allclose(recording.t[-1], 16383 * 0.000977, rtol=TEXT)
    assert "8192" in recording.metadata["warnings"][0]


def test_real_decimal_comma(corpus):
    recording = ms.read(corpus / "lvm" / "short.lvm")

    assert recording["Excitation (Trigger)"][[0, -1]] == pytest.approx(
        [0.914018, 0.680572], rel=1e-9, abs=0.0
    )
    assert recording.t[1] == pytest.approx(3.90625e-5, rel=TEXT, abs=0.0)
    assert recording.units == {"Response (Trigger)": "m/s^2"}
    assert recording.metadata["units_in_file"]["Excitation (Trigger)"] == "Newtons"


def test_real_comments_keep_their_times(corpus):
    comments = ms.read(corpus / "lvm" / "with_comments.lvm").metadata["comments"]

    assert comments[0] == (0.0, "LOST COMMUNICATION")
    assert comments[1] == (0.328878, "OK")
    assert len(comments) == 9


def test_several_segments_must_be_chosen(samples):
    with pytest.raises(ms.errors.FormatMismatchError, match="2 segments"):
        ms.read(samples / "two-segments.lvm")


def test_segment_that_is_not_there(samples):
    with pytest.raises(ms.errors.FormatMismatchError, match="no segment 2"):
        ms.read(samples / "two-segments.lvm", segment=2)


def test_different_times_need_a_channel(samples, put):
    text = (samples / "ragged-multi.lvm").read_text().replace("2.5\t0.5", "2.5\t0.6")

    with pytest.raises(ms.errors.FormatMismatchError, match="channel='sensor'"):
        ms.read(put(text))

    assert ms.read(put(text), channel="sensor").t[1] == pytest.approx(0.6, rel=TEXT, abs=0.0)


@pytest.mark.parametrize("name", ["comma.lvm", "comma-separated.lvm"])
def test_one_empty_field_changes_no_other_number(samples, put, name):
    """Clean rows go through the C parser, a row with a gap through the parser by fields."""
    text = (samples / name).read_text().replace("-0.5", "").replace("-0,5", "")

    recording = ms.read(put(text))

    np.testing.assert_array_equal(recording["probe"], [0.25, np.nan, 1.75])
    np.testing.assert_array_equal(recording["sensor"], ms.read(samples / name)["sensor"])


def test_empty_row_keeps_its_place_in_time(samples, put):
    text = (samples / "comma.lvm").read_text().replace("\t-0,5\t2,0", "\t\t") + "\t\t\n\n"

    recording = ms.read(put(text))

    np.testing.assert_array_equal(recording["probe"], [0.25, np.nan, 1.75])
    np.testing.assert_array_equal(recording.t, [0.5, 0.75, 1.0])


def test_unit_for_an_unknown_label(samples):
    recording = ms.read(samples / "one-x-gap.lvm", unit={"sensor": "um"})

    assert recording["sensor"][1] == pytest.approx(6.5e-6, rel=TEXT, abs=0.0)
    assert recording.units["sensor"] == "m"


def test_unit_against_the_file_is_refused(samples):
    with pytest.raises(ms.errors.FormatMismatchError, match="mV by the file"):
        ms.read(samples / "comma.lvm", unit={"sensor": "um"})


@pytest.mark.parametrize(
    ("old", "new", "match"),
    [
        ("Delta_X\t0.25", "Delta_X\t0.0", "Delta_X"),
        ("Delta_X\t0.25", "Delta_X\tnan", "Delta_X"),
        ("X0\t0.5", "X0\tinf", "X0"),
        ("Channels\t2", "Channels\t3000000000", "Channels"),
        ("X_Dimension\tTime", "X_Dimension\tFrequency", "not time"),
        ("\t0.25\t1000.5", "\t0.25x\t1000.5", "probe is no number"),
        ("\t0.25\t1000.5", "\t1e999\t1000.5", "probe is no number"),
        ("\t0.25\t1000.5", "\t0.25\t1000.5\ta\tb", "too many"),
        ("X_Columns\tNo", "X_Columns\tMany", "X_Columns"),
    ],
)
def test_header_or_row_that_lies(samples, put, old, new, match):
    text = (samples / "two-segments.lvm").read_text()
    assert old in text

    with pytest.raises(ms.errors.ReadError, match=match):
        ms.read(put(text.replace(old, new, 1)), segment=0)


@pytest.mark.parametrize("name", ["comma.lvm", "ragged-multi.lvm"])
def test_damage_is_a_read_error_or_a_recording(samples, survives_damage, name):
    survives_damage(lvm, samples / name)
