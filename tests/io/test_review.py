"""Defects of the readers found by a review: each test failed before its mend."""

import numpy as np
import pytest

import metrosep as ms
from metrosep.io.registry import get
from metrosep.io.source import RawFile
from metrosep.io.stream import open_stream
from metrosep.io.text.layout import LayoutReader

nptdms = pytest.importorskip("nptdms", reason="writes the TDMS files of these tests")


@pytest.fixture
def tdms(tmp_path):
    """Write channels with npTDMS; values are (samples, properties)."""

    def make(name="a.tdms", **channels):
        path = tmp_path / name
        with nptdms.TdmsWriter(path) as writer:
            writer.write_segment(
                [
                    nptdms.ChannelObject("g", key, np.asarray(samples, dtype=float), props)
                    for key, (samples, props) in channels.items()
                ]
            )
        return path

    return make


def test_one_unit_for_all_does_not_make_metres_of_degrees(corpus):
    recording = ms.read(corpus / "lvm" / "with_comments.lvm", unit={"Volume (ml)": "1"})

    assert recording.units["Volume (ml)"] == "1"
    with pytest.raises(ms.errors.FormatMismatchError, match=r"every channel states a unit"):
        ms.read(corpus / "lvm" / "short.lvm", unit="um")


def test_one_unit_for_all_reaches_only_channels_without_a_label(tdms):
    path = tdms(
        gap=([1.0, 2.0], {"wf_increment": 1e-3}),
        oven=([20.0, 21.0], {"wf_increment": 1e-3, "unit_string": "Deg C"}),
        drive=([0.5, 0.6], {"wf_increment": 1e-3, "unit_string": "V"}),
    )

    recording = ms.read(path, unit="um")
    with open_stream(path, unit="um") as stream:
        (chunk,) = stream.chunks()

    assert recording.units == {"gap": "m", "drive": "V"}
    np.testing.assert_array_equal(recording["oven"], [20.0, 21.0])
    for name, values in recording.channels.items():
        np.testing.assert_array_equal(chunk[name], values)


def test_stream_refuses_a_rate_against_the_file(tdms, tmp_path):
    text = tmp_path / "a.csv"
    text.write_text("t_s,gap_um\n0,1\n0.001,2\n0.002,3\n")

    for path in (tdms(gap=([1.0, 2.0], {"wf_increment": 1e-3})), text):
        with pytest.raises(ms.errors.FormatMismatchError, match=r"0\.001 s apart by the file"):
            open_stream(path, sampling_rate="5 kHz")
        with open_stream(path, sampling_rate="1 kHz") as stream:
            assert stream.time_step == pytest.approx(1e-3, rel=1e-9, abs=0.0)


def test_stream_refuses_channels_of_different_times(tdms):
    path = tdms(
        a=([1.0, 2.0], {"wf_increment": 1e-3, "wf_start_offset": 0.0}),
        b=([1.0, 2.0], {"wf_increment": 1e-3, "wf_start_offset": 0.5}),
    )

    with pytest.raises(ms.errors.FormatMismatchError, match="'a' and 'b' have different times"):
        open_stream(path)


def test_stream_takes_the_longest_channels_and_no_infinity(tdms):
    path = tdms(
        a=([1.0, np.inf, 3.0], {"wf_increment": 1e-3}), short=([1.0], {"wf_increment": 1e-3})
    )

    with open_stream(path) as stream:
        (chunk,) = stream.chunks()

    np.testing.assert_array_equal(chunk["a"], [1.0, np.nan, 3.0])
    assert list(chunk) == ["a"]


@pytest.mark.parametrize(
    "props",
    [
        {"wf_increment": 10.0, "wf_xname": "Frequency", "wf_xunit_string": "Hz"},
        {"wf_increment": 0.5, "wf_xname": "Time", "wf_xunit_string": "ms"},
    ],
    ids=["frequency", "ms"],
)
def test_waveform_over_another_axis_is_refused(tdms, props):
    path = tdms(a=([1.0, 2.0], props))

    with pytest.raises(ms.errors.UnsupportedFeatureError, match="only waveforms over time"):
        ms.read(path)
    with pytest.raises(ms.errors.UnsupportedFeatureError, match="only waveforms over time"):
        open_stream(path)


def test_option_of_another_format_is_refused_by_name(tdms):
    path = tdms(a=([1.0, 2.0], {"wf_increment": 1e-3}))

    with open_stream(path, group="g") as stream:
        assert stream.channels == ("a",)
    with pytest.raises(
        ms.errors.FormatMismatchError, match="no option 'separator' here; it takes"
    ):
        open_stream(path, separator=";")


def described(**layout):
    base = {
        "recognise": ["T"],
        "table_after": "[data]",
        "key_separator": ":",
        "columns": [{"name": "gap", "unit": "V"}],
    }
    return LayoutReader("t", "T", {**base, **layout}, "t.toml")


def raw(text, tmp_path):
    return RawFile(tmp_path / "run.log", text.encode())


def test_rate_with_the_other_decimal_mark_is_refused(tmp_path):
    reader = described(decimal=".", sampling_rate_key="rate")
    comma = described(decimal=",", separator=";", sampling_rate_key="rate")

    with pytest.raises(ms.errors.CorruptFileError, match="how fast"):
        reader.read(raw("T\nrate (Hz): 1,000\n[data]\n1\n2\n", tmp_path))
    with pytest.raises(ms.errors.CorruptFileError, match="how fast"):
        comma.read(raw("T\nrate (Hz): 1.000\n[data]\n1\n2\n", tmp_path))
    assert comma.read(raw("T\nrate (Hz): 2,5\n[data]\n1\n2\n", tmp_path)).t[1] == 0.4


def test_rate_is_that_of_its_key_and_of_no_longer_one(tmp_path):
    reader = described(sampling_rate_key="rate")

    recording = reader.read(
        raw("T\nrated range (Hz): 5\nrate (Hz): 1000\n[data]\n1\n2\n", tmp_path)
    )

    assert recording.t[1] == pytest.approx(1e-3, rel=1e-9, abs=0.0)
    with pytest.raises(ms.errors.CorruptFileError, match="twice"):
        reader.read(raw("T\nrate (Hz): 5\nRate (kHz): 1\n[data]\n1\n2\n", tmp_path))


def test_sensitivity_on_a_column_that_is_no_voltage_is_refused(tmp_path):
    column = {"name": "gap", "sensitivity": "2 um/V"}
    by_header = described(columns=[column], sampling_rate="1 kHz")
    by_toml = described(columns=[{**column, "unit": "mm"}], sampling_rate="1 kHz")

    for reader, head in ((by_header, "gap [mm]\n"), (by_toml, "")):
        with pytest.raises(ms.errors.UnitError, match="'gap' has a sensitivity, but is in mm"):
            reader.read(raw(f"T\n[data]\n{head}1.0\n2.0\n", tmp_path))


def test_unit_of_the_description_against_the_header_is_refused(tmp_path):
    reader = described(columns=[{"name": "gap", "unit": "um"}], sampling_rate="1 kHz")

    with pytest.raises(ms.errors.FormatMismatchError, match="is in mm by its header"):
        reader.read(raw("T\n[data]\ngap [mm]\n1.0\n2.0\n", tmp_path))


@pytest.mark.parametrize(
    ("layout", "match"),
    [
        ({"columns": [{"name": "a"}, {"name": "a"}]}, "two columns have the name 'a'"),
        (
            {"columns": [{"name": "a", "role": "z"}, {"name": "b", "role": "z"}]},
            "two columns have the role 'z'",
        ),
        ({"sampling_rate": 5}, r"t.toml: \[layout\] sampling_rate must be a text"),
        ({"sampling_rate": "5"}, r"t.toml: \[layout\] sampling_rate must be a frequency"),
        ({"separator": 3}, "separator must be a text"),
        ({"sampling_rate_key": "rate", "key_separator": ""}, "key_separator"),
    ],
)
def test_description_that_cannot_be_is_refused(layout, match):
    with pytest.raises(ms.errors.ReadError, match=match):
        described(**layout)


def test_rate_beside_a_column_of_time_is_refused(tmp_path):
    columns = [{"name": "t", "unit": "s", "role": "time"}, {"name": "gap", "unit": "V"}]
    reader = described(columns=columns)

    with pytest.raises(ms.errors.ReadError, match="takes no sampling_rate"):
        reader.read(raw("T\n[data]\n0 1\n1 2\n", tmp_path), sampling_rate="5 kHz")


def test_filetime_with_a_decimal_point_does_not_become_milliseconds(repository):
    path = repository / "data_formats" / "twincat-scope" / "samples" / "filetime.csv"
    text = path.read_text(encoding="latin-1")
    row = text.rstrip("\n").rsplit("\n", 2)[1]
    stamp = row.split(";")[0]
    damaged = text.replace(row, row.replace(stamp, f"{stamp}.0", 1))
    reader = get("twincat-scope").load_reader()

    with pytest.raises(ms.errors.CorruptFileError, match="FILETIME"):
        reader.read(RawFile(path, damaged.encode("latin-1")))


def test_fewer_rows_than_declared_are_called_missing(corpus):
    recording = ms.read(corpus / "lvm" / "multi_time_column.lvm")

    assert "samples may be missing" in recording.metadata["warnings"][0]


@pytest.mark.parametrize("options", [{"sampling_rate": [1]}, {"sampling_rate": None}])
def test_rate_of_a_wrong_kind_is_one_sentence(tmp_path, options):
    path = tmp_path / "a.txt"
    path.write_text("1 2\n3 4\n")

    with pytest.raises((ms.errors.DataError, ms.errors.ReadError)):
        ms.read(path, format="pmac-gather", **options)


def test_clocks_of_two_variables_that_differ_are_said(tmp_path):
    path = tmp_path / "log.txt"
    path.write_text(
        "A 2026-10-25 02:59:59.000000 1\nB 2026-10-25 02:00:01.000000 5\n"
        "A 2026-10-25 03:00:00.000000 2\nB 2026-10-25 02:00:02.000000 6\n"
    )

    sentence, _ = ms.read(path).metadata["warnings"]

    assert sentence.startswith("2 line(s) are more than 5 s older")
    assert "B at 2026-10-25T02:00:01" in sentence


def test_blank_line_between_rows_without_times_is_a_sample_not_measured(repository, tmp_path):
    head = "LabVIEW Measurement\t\nX_Columns\tNo\nSeparator\tTab\n***End_of_Header***\t\n"
    segment = "Channels\t1\nSamples\t4\nX0\t0\nDelta_X\t0.001\n***End_of_Header***\t\nX_Value\ta\n"
    path = tmp_path / "a.lvm"
    path.write_text(head + segment + "\t1\n\t2\n\n\t3\n\n\n")

    recording = ms.read(path)

    np.testing.assert_array_equal(recording["a"], [1.0, 2.0, np.nan, 3.0])
    assert recording.t[-1] == pytest.approx(3e-3, rel=1e-9, abs=0.0)


def test_channels_started_at_different_moments_are_said(tmp_path):
    head = "LabVIEW Measurement\t\nX_Columns\tNo\nSeparator\tTab\n***End_of_Header***\t\n"
    segment = (
        "Channels\t2\nSamples\t2\t2\nTime\t10:00:00\t10:00:05\nX0\t0\t0\nDelta_X\t1\t1\n"
        "***End_of_Header***\t\nX_Value\ta\tb\n"
    )
    path = tmp_path / "a.lvm"
    path.write_text(head + segment + "\t1\t5\n\t2\t6\n")

    (sentence,) = ms.read(path).metadata["warnings"]

    assert "different moments" in sentence
