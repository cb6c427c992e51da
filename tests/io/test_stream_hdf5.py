"""HDF5 recordings in chunks: contiguous and packed, units, two files at once, bounded memory."""

import subprocess
import sys
import textwrap

import h5py
import numpy as np
import pytest

import metrosep as ms
from metrosep.io.stream import open_stream

MEMORY = 200  # MB, the goal for any length


@pytest.fixture
def long_file(tmp_path):
    """Write channels as plain HDF5; return the path and the numbers."""

    def make(n=5000, name="long.h5", **storage):
        rng = np.random.default_rng(n)
        truth = {
            "gap": rng.standard_normal(n).astype(np.float32),
            "angle": rng.integers(0, 4096, n).astype(">i4"),
        }
        path = tmp_path / name
        with h5py.File(path, "w") as handle:
            handle["daq/gap"] = 0
            del handle["daq/gap"]
            for key, values in truth.items():
                handle.create_dataset(f"daq/{key}", data=values, **storage)
            handle["daq/gap"].attrs["units"] = "um"
            handle["daq/time"] = np.arange(n) * 2.0
            handle["daq/time"].attrs["unit"] = "ms"
            handle["calibration"] = np.arange(7.0)
            handle["note"] = "text"
        return path, truth

    return make


def gathered(stream, size):
    parts = list(stream.chunks(size))
    return {n: np.concatenate([p[n] for p in parts]) for n in parts[0]}


@pytest.mark.parametrize(
    "storage",
    [{}, {"chunks": (64,)}, {"chunks": (700,), "compression": "gzip", "shuffle": True}],
    ids=["contiguous", "chunks", "gzip"],
)
def test_chunks_are_the_whole(long_file, storage):
    path, truth = long_file(**storage)

    with open_stream(path) as stream:
        assert stream.n_samples == 5000
        assert stream.time_step == pytest.approx(2e-3, rel=1e-9, abs=0.0)
        assert set(stream.channels) == {"/daq/gap", "/daq/angle", "/daq/time"}
        found = gathered(stream, 999)

    np.testing.assert_allclose(found["/daq/gap"], truth["gap"] * 1e-6, rtol=1e-7)
    np.testing.assert_array_equal(found["/daq/angle"], truth["angle"])
    assert found["/daq/time"][-1] == pytest.approx(9.998, rel=1e-9, abs=0.0)


def test_two_files_at_once_do_not_mix(long_file):
    storage = {"chunks": (50,), "compression": "gzip"}
    first, a = long_file(300, "a.h5", **storage)
    second, b = long_file(400, "b.h5", **storage)

    with open_stream(first) as one, open_stream(second) as two:
        pairs = zip(one.chunks(100), two.chunks(100), strict=False)
        for i, (x, y) in enumerate(pairs):
            part = slice(100 * i, 100 * i + 100)
            np.testing.assert_array_equal(x["/daq/angle"], a["angle"][part])
            np.testing.assert_array_equal(y["/daq/angle"], b["angle"][part])


def test_recording_of_our_own_by_its_names(tmp_path):
    t = np.arange(100) * 1e-3
    recording = ms.Recording(t, {"gap/left": t * 1e-3}, units={"gap/left": "m"})

    with open_stream(ms.write(recording, tmp_path / "own.h5")) as stream:
        found = gathered(stream, 30)

    np.testing.assert_array_equal(found["gap/left"], recording["gap/left"])
    assert stream.time_step == pytest.approx(1e-3, rel=1e-9, abs=0.0)


def test_file_without_lines_is_refused(tmp_path):
    path = tmp_path / "map.h5"
    with h5py.File(path, "w") as handle:
        handle["z"] = np.zeros((4, 4))

    with pytest.raises(ms.errors.ReadError, match="nothing to stream"):
        open_stream(path, format="hdf5")


def test_a_part_that_is_damaged_is_named(long_file):
    path, _ = long_file(chunks=(100,), compression="gzip")
    with h5py.File(path) as handle:
        info = handle["daq/gap"].id.get_chunk_info(30)
    data = bytearray(path.read_bytes())
    data[info.byte_offset : info.byte_offset + info.size] = b"\xa5" * info.size
    path.write_bytes(bytes(data))

    with open_stream(path, channels=["/daq/gap"]) as stream:
        chunks = stream.chunks(500)
        assert len(next(chunks)["/daq/gap"]) == 500
        with pytest.raises(ms.errors.CorruptFileError, match="/daq/gap"):
            list(chunks)


def job(path, code):
    """Run code on a file in a process of its own; return the peak memory of it and its worker in MB.

    VmHWM begins at zero in a new program; ``ru_maxrss`` would begin at the size of this one.
    """
    head = f"""
        import os
        import numpy as np
        from pathlib import Path
        from metrosep.io.stream import open_stream
        from metrosep.spectral import BinnedMean, StreamedPsd
        path = {str(path)!r}

        def high(pid):
            status = Path(f"/proc/{{pid}}/status").read_text()
            return int(status.split("VmHWM:")[1].split()[0]) / 1e3
    """
    tail = """
        worker = Path(f"/proc/self/task/{os.getpid()}/children").read_text().split()
        print(high("self") + sum(high(pid) for pid in worker))
    """
    source = "\n".join(textwrap.dedent(part) for part in (head, code, tail))
    done = subprocess.run(
        [sys.executable, "-c", source], capture_output=True, text=True, check=True
    )
    return float(done.stdout.split()[-1])


ANALYSIS = """
    turn, spectrum = BinnedMean(0.0, 4096.0, 4096), StreamedPsd(1e-5, 8192)
    n = 0
    with open_stream(path) as stream:
        for chunk in stream.chunks():
            turn.add(chunk["/angle"], chunk["/gap"])
            spectrum.add(chunk["/gap"])
            n += len(chunk["/gap"])
    assert n == stream.n_samples
    assert np.abs(turn.mean - np.cos(turn.centres * 2 * np.pi / 4096)).max() < 0.01 * (1e8 / n) ** 0.5
    assert abs(spectrum.frequency[spectrum.density.argmax()] - 1e5 / 4096) < 20.0
"""


def write_spindle(path, n):
    """A wave of one per turn, in blocks so that this process stays small as well."""
    rng = np.random.default_rng(7)
    with h5py.File(path, "w") as handle:
        gap = handle.create_dataset("gap", (n,), dtype="f4")
        angle = handle.create_dataset("angle", (n,), dtype="i2")
        for start in range(0, n, 2**21):
            k = np.arange(start, min(start + 2**21, n))
            count = (k % 4096).astype(np.int16)
            noise = 0.1 * rng.standard_normal(k.size, dtype=np.float32)
            gap[start : start + k.size] = np.cos((count + 0.5) * (2 * np.pi / 4096)) + noise
            angle[start : start + k.size] = count


@pytest.mark.parametrize(
    "n", [3_000_000, pytest.param(100_000_000, marks=pytest.mark.slow)], ids=["3e6", "1e8"]
)
def test_memory_is_bounded_whatever_the_length(tmp_path, n):
    write_spindle(tmp_path / "spindle.h5", n)

    peak = job(tmp_path / "spindle.h5", ANALYSIS)

    print(f"\n{n} samples: peak {peak:.0f} MB")
    assert peak < MEMORY


@pytest.mark.slow
def test_memory_of_text_is_bounded(tmp_path):
    """2e7 rows, 0.4 GB; memory does not depend on the length."""
    path = tmp_path / "long.csv"
    block = "".join(f"{k % 4096},{np.cos(k * 2 * np.pi / 4096):.6f}\n" for k in range(4096 * 49))
    with path.open("w", encoding="utf-8") as handle:
        handle.write("angle,gap_um\n")
        for _ in range(100):
            handle.write(block)

    peak = job(
        path,
        """
        n, total = 0, 0.0
        with open_stream(path) as stream:
            for chunk in stream.chunks():
                n += len(chunk["gap_um"])
                total += chunk["gap_um"].sum()
        assert n == 100 * 49 * 4096
        assert abs(total) < 1e-9 * n
        """,
    )

    print(f"\n2e7 rows: peak {peak:.0f} MB")
    assert peak < MEMORY


def test_a_unit_in_the_name_counts_as_for_the_whole_file(tmp_path):
    path = tmp_path / "named.h5"
    with h5py.File(path, "w") as handle:
        handle["t_ms"] = np.arange(50) * 2.0
        handle["gap_um"] = np.arange(50.0) % 7
        handle["force_N"] = np.ones(50)

    whole = ms.read(path)
    with open_stream(path) as stream:
        found = gathered(stream, 20)
        assert stream.time_step == pytest.approx(2e-3, abs=1e-12)

    assert found["/gap_um"].max() == pytest.approx(6e-6, abs=1e-15)
    assert found["/t_ms"].tolist() == whole.t.tolist()
    for name in whole.channels:
        np.testing.assert_array_equal(found[name], whole.channels[name])


def test_a_unit_in_the_name_that_is_shown_counts_in_a_stream_and_in_the_whole_file(tmp_path):
    """A logger numbers its datasets and writes what they are into an attribute: 2 um are 2e-6 m."""
    path = tmp_path / "shown.h5"
    with h5py.File(path, "w") as handle:
        handle["t_ms"] = np.arange(50) * 2.0
        for name, shown in (("c1", "gap_um"), ("c2", "load"), ("c3", "load")):
            handle[name] = np.full(50, 2.0)
            handle[name].attrs["name"] = shown

    with open_stream(path) as stream:
        assert set(stream.channels) == {"/t_ms", "gap_um", "/c2", "/c3"}
        found = gathered(stream, 20)
    assert found["gap_um"].tolist() == pytest.approx([2e-6] * 50, abs=1e-15)
    assert found["/c2"].tolist() == [2.0] * 50
    assert ms.read(path).channels["/c1"].tolist() == found["gap_um"].tolist()

    with h5py.File(path, "a") as handle:
        handle["t_ms"].attrs["name"] = "t_s"
    with pytest.raises(ms.errors.UnitError, match=r"in ms by its name, but in s by its attribute"):
        open_stream(path)
