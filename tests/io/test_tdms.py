"""TDMS recordings: structure, scales, interrupted files, chunks in little memory, damage."""

import runpy
import struct
import sys
import time
import tracemalloc
from pathlib import Path

import numpy as np
import pytest

import metrosep as ms
from metrosep.io.containers import tdms
from metrosep.io.source import RawFile
from metrosep.io.stream import open_stream

TEXT = 1e-12  # relative; one factor


@pytest.fixture
def samples(repository):
    return repository / "data_formats" / "tdms" / "samples"


@pytest.fixture
def made(repository):
    """Functions of the script that makes the samples."""
    return runpy.run_path(str(repository / "data_formats" / "tdms" / "make_samples.py"))


@pytest.fixture
def peer():
    return pytest.importorskip("nptdms")


def by_peer(peer, path):
    """Return the samples of every channel of numbers as npTDMS reads them."""
    with path.open("rb") as handle:
        file = peer.TdmsFile.read(handle)
        return {
            (c.group_name, c.name): c[:]
            for g in file.groups()
            for c in g.channels()
            if len(c) and c[:].dtype.kind in "iufb"
        }


def own(path):
    """Return the same by metrosep, in the unit of the file."""
    file = RawFile(path)
    structure = tdms.read_structure(file)
    several = len({c.group for c in structure.objects.values() if c.extents}) > 1
    values = {}
    for c in structure.objects.values():
        if c.extents:
            name = f"{c.group}/{c.name}" if several else c.name
            part = next(tdms.iter_chunks(file, [name], c.n_values))
            values[c.group, c.name] = part[name]
    return values


@pytest.mark.parametrize("name", ["raw1.tdms", "big_endian.tdms", "Digital_Input.tdms"])
def test_real_files_of_labview_as_the_peer_reads_them(peer, name):
    path = Path(peer.__file__).parent / "test" / "data" / name
    truth = by_peer(peer, path)

    found = own(path)

    assert found.keys() == truth.keys()
    for key, values in truth.items():
        np.testing.assert_array_equal(found[key], values)


@pytest.mark.parametrize(
    "name", ["two-segments", "big-endian-rows", "daqmx", "interrupted", "time-channel"]
)
def test_samples_as_the_peer_reads_them(peer, samples, name):
    truth = by_peer(peer, samples / f"{name}.tdms")

    found = own(samples / f"{name}.tdms")

    assert found.keys() == truth.keys()
    for key, values in truth.items():
        np.testing.assert_allclose(found[key], values, rtol=TEXT)


def test_properties_scale_chain_and_start_are_kept(samples):
    recording = ms.read(samples / "two-segments.tdms")

    sensor = recording.metadata["header"]["objects"]["/'axis'/'sensor'"]
    assert sensor["NI_Scale[0]_Linear_Slope"] == 0.5
    assert recording.metadata["header"]["objects"]["/"]["name"] == "run 7"
    assert recording.metadata["start_utc"] == "2021-12-29T16:00:00.500000000Z"
    assert recording.units == {"probe": "m", "sensor": "V"}


def test_channel_that_starts_later_is_placed_later(made, put):
    first = {"wf_increment": 0.5, "wf_start_time": (made["START"], 0)}
    later = {"wf_increment": 0.5, "wf_start_time": (made["START"] + 1, 2**63)}
    entries = [
        made["entry"]("/'g'/'a'", made["index"]("f8", 2), first),
        made["entry"]("/'g'/'b'", made["index"]("f8", 2), later),
    ]
    path = put(made["segment"](entries, made["floats"](1, 2, 3, 4), 0))

    with pytest.raises(ms.errors.FormatMismatchError, match="different times"):
        ms.read(path)

    assert ms.read(path, channel="b").t.tolist() == [0.0, 0.5]


def test_groups_with_different_rates_need_a_group(made, put):
    entries = [
        made["entry"]("/'slow'/'a'", made["index"]("f8", 2), {"wf_increment": 0.5}),
        made["entry"]("/'fast'/'b'", made["index"]("f8", 2), {"wf_increment": 0.25}),
    ]
    path = put(made["segment"](entries, made["floats"](1, 2, 3, 4), 0))

    with pytest.raises(ms.errors.FormatMismatchError, match="different times"):
        ms.read(path)

    assert ms.read(path, group="fast").t.tolist() == [0.0, 0.25]
    assert list(ms.read(path, group="slow").channels) == ["slow/a"]


def test_rate_must_be_declared_where_the_file_has_none(made, put):
    entries = [made["entry"]("/'g'/'a'", made["index"]("f8", 2), {})]
    path = put(made["segment"](entries, made["floats"](1.5, 2.5), 0))

    with pytest.raises(ms.errors.FormatMismatchError, match="sampling_rate"):
        ms.read(path)

    assert ms.read(path, sampling_rate="2 kHz").t[1] == pytest.approx(5e-4, rel=TEXT, abs=0.0)


def test_declared_rate_against_the_file_is_refused(samples):
    with pytest.raises(ms.errors.FormatMismatchError, match=r"0\.25 s by the file"):
        ms.read(samples / "two-segments.tdms", sampling_rate=5.0)


def test_index_file_is_refused_with_what_to_do(put, samples):
    content = b"TDSh" + (samples / "two-segments.tdms").read_bytes()[4:]

    with pytest.raises(ms.errors.UnsupportedFeatureError, match=r"read the \.tdms file"):
        ms.read(put(content))


def test_wrong_index_file_beside_is_not_used(put, samples):
    put(b"TDSh" + b"\xff" * 60, "run.tdms_index")
    path = put((samples / "two-segments.tdms").read_bytes(), "run.tdms")

    assert ms.read(path)["probe"][0] == pytest.approx(1.5e-6, rel=TEXT, abs=0.0)


def test_cut_copy_gives_a_warning_and_nan_at_the_end(put, samples):
    data = (samples / "two-segments.tdms").read_bytes()

    recording = ms.read(put(data[:-2]))

    assert np.isnan(recording["sensor"][5:]).all()
    assert "differ in length" in recording.metadata["warnings"][1]
    assert recording["probe"][5] == pytest.approx(6.5e-6, rel=TEXT, abs=0.0)


@pytest.mark.parametrize(
    ("change", "match"),
    [
        ({"wf_increment": 0.0}, "wf_increment"),
        ({"wf_increment": float("nan")}, "wf_increment"),
        ({"wf_start_offset": float("inf")}, "wf_start_offset"),
        ({"NI_Number_Of_Scales": 4_000_000_000}, "too many scales"),
        ({"NI_Scale[0]_Linear_Slope": 0.0}, "same value"),
        ({"NI_Scale[0]_Linear_Slope": float("nan")}, "Slope"),
        ({"NI_Scale[0]_Linear_Input_Source": 0}, "no input"),
    ],
)
def test_property_that_lies(made, put, change, match):
    props = {**made["TIMING"], **made["VOLTS"], **change}
    entries = [made["entry"]("/'g'/'a'", made["index"]("i2", 2), props)]

    with pytest.raises(ms.errors.ReadError, match=match):
        ms.read(put(made["segment"](entries, struct.pack("<2h", 1, 2), 0)))


@pytest.mark.usefixtures("peer")
@pytest.mark.parametrize(("kind", "match"), [("Unheard", "not read"), ("Table", "not usable")])
def test_sensor_scale_that_does_not_fit(made, put, kind, match):
    props = {**made["TIMING"], **made["VOLTS"], "NI_Scale[0]_Scale_Type": kind}
    entries = [made["entry"]("/'g'/'a'", made["index"]("i2", 2), props)]

    with pytest.raises(ms.errors.ReadError, match=match):
        ms.read(put(made["segment"](entries, struct.pack("<2h", 1, 2), 0)))


def test_sensor_scale_without_the_package_names_it(made, put, monkeypatch):
    monkeypatch.setitem(sys.modules, "nptdms.scaling", None)
    props = {**made["TIMING"], **made["VOLTS"], "NI_Scale[0]_Scale_Type": "Thermocouple"}
    entries = [made["entry"]("/'g'/'a'", made["index"]("i2", 2), props)]

    with pytest.raises(ms.errors.UnsupportedFeatureError, match=r"install metrosep\[formats\]"):
        ms.read(put(made["segment"](entries, struct.pack("<2h", 1, 2), 0)))


def test_many_empty_segments_take_no_time(made, put):
    entries = [made["entry"](f"/'g'/'{k}'", made["index"]("f8", 1), {}) for k in range(500)]
    data = made["segment"](entries, made["floats"](*range(500)), 0)
    data += made["segment"]([], b"", 0) * 20_000
    start = time.process_time()

    recording = ms.read(put(data), sampling_rate=1.0, channel="499")

    assert recording["499"].tolist() == [499.0]
    assert time.process_time() - start < 2.0


def test_sensor_scale_is_left_to_the_peer(peer, made, put):
    props = {
        "wf_increment": 1.0,
        "NI_Number_Of_Scales": 1,
        "NI_Scale[0]_Scale_Type": "Table",
        "NI_Scale[0]_Table_Scaled_Values_Size": 2,
        "NI_Scale[0]_Table_Scaled_Values[0]": 0.0,
        "NI_Scale[0]_Table_Scaled_Values[1]": 2.0,
        "NI_Scale[0]_Table_Pre_Scaled_Values_Size": 2,
        "NI_Scale[0]_Table_Pre_Scaled_Values[0]": 0.0,
        "NI_Scale[0]_Table_Pre_Scaled_Values[1]": 10.0,
        "NI_Scale[0]_Table_Input_Source": 0xFFFFFFFF,
    }
    entries = [made["entry"]("/'g'/'a'", made["index"]("f8", 2), props)]
    path = put(made["segment"](entries, made["floats"](5.0, 10.0), 0))

    np.testing.assert_allclose(ms.read(path)["a"], by_peer(peer, path)["g", "a"], rtol=TEXT)


@pytest.mark.parametrize("size", [1, 2, 4, 5, 100])
@pytest.mark.parametrize("name", ["two-segments", "daqmx", "interrupted"])
def test_chunks_join_to_the_whole(samples, name, size):
    file = RawFile(samples / f"{name}.tdms")
    whole = next(tdms.iter_chunks(file, ["probe", "sensor"], 10**6))

    parts = list(tdms.iter_chunks(file, ["probe", "sensor"], size))

    for channel, values in whole.items():
        np.testing.assert_array_equal(np.concatenate([p[channel] for p in parts]), values)


def test_one_long_chunk_is_read_in_little_memory(made, tmp_path):
    """A defragmented file has a single chunk; two channels of 16 MB each are read in 8 kB steps."""
    n = 2_000_000
    entries = [
        made["entry"](f"/'g'/'{name}'", made["index"]("f8", n), {"wf_increment": 1e-3})
        for name in ("a", "b")
    ]
    path = tmp_path / "long.tdms"
    raw = np.concatenate([np.arange(n), -np.arange(n)]).astype("<f8").tobytes()
    path.write_bytes(made["segment"](entries, raw, 0))
    del raw
    tracemalloc.start()

    total = sum(float(p["b"].sum()) for p in tdms.iter_chunks(RawFile(path), ["a", "b"], 1000))

    assert tracemalloc.get_traced_memory()[1] < 20e6
    tracemalloc.stop()
    assert total == -n * (n - 1) / 2


def test_structure_for_streams(samples):
    file = RawFile(samples / "two-segments.tdms")

    assert tdms.channels(file) == ("probe", "sensor")
    source = tdms.open_source(file)
    assert (source.n_samples, source.time_step) == (6, 0.25)
    assert source.labels == {"probe": "um", "sensor": "mV"}


@pytest.mark.parametrize("name", ["two-segments.tdms", "daqmx.tdms", "interrupted.tdms"])
def test_damage_is_a_read_error_or_a_recording(samples, survives_damage, name):
    survives_damage(tdms, samples / name, every=3)


def test_stream_gives_what_read_gives(samples):
    path = samples / "two-segments.tdms"

    with open_stream(path) as stream:
        parts = list(stream.chunks(4))

    assert (stream.n_samples, stream.time_step) == (6, 0.25)
    for name, values in ms.read(path).channels.items():
        np.testing.assert_array_equal(np.concatenate([p[name] for p in parts]), values)
