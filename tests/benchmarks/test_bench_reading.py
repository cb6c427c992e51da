"""Cost of reading a map of 4096 x 4096 against reading its bytes, in one run.

Run with ``make bench``; ratios are printed, nothing is asserted about time. Each is the best of
several rounds, since pages that are new to the process cost more than the work itself.
"""

import struct
import time

import numpy as np
import pytest

import metrosep as ms
from metrosep.io.maps import metropro
from metrosep.io.source import RawFile
from metrosep.io.stream import open_stream

N = 4096


def best(function, rounds=7):
    times = []
    for _ in range(rounds):
        started = time.perf_counter()
        result = function()
        times.append(time.perf_counter() - started)
        del result
    return min(times)


@pytest.fixture(scope="module")
def map_file(tmp_path_factory):
    rng = np.random.default_rng(1)
    header = bytearray(834)
    struct.pack_into(">Ihi", header, 0, 0x881B036F, 1, 834)
    struct.pack_into(">hhhhi", header, 64, 0, 0, N, N, 4 * N * N)
    struct.pack_into(">fffff", header, 164, 0.5, 632.8e-9, 0.0, 1.0, 0.0)
    struct.pack_into(">f", header, 184, 1e-6)
    struct.pack_into(">h", header, 218, 1)
    struct.pack_into(">hhh", header, 232, 0, N, N)
    raw = rng.integers(-(10**6), 10**6, size=(N, N)).astype(">i4")
    raw[rng.random((N, N)) < 0.01] = 2147483640
    path = tmp_path_factory.mktemp("bench") / "map.dat"
    path.write_bytes(bytes(header) + raw.tobytes())
    return path


def test_decoding_of_big_endian_int32(map_file):
    raw = best(map_file.read_bytes)
    file = RawFile(map_file, map_file.read_bytes())
    _ = file.sha256
    decode = best(lambda: metropro.read(file))
    whole = best(lambda: ms.read(map_file))

    print(
        f"\nMetroPro 4096^2: raw bytes {raw * 1e3:.0f} ms, decoded {decode * 1e3:.0f} ms "
        f"({decode / raw:.1f}x), read with SHA-256 {whole * 1e3:.0f} ms ({whole / raw:.1f}x)"
    )


def test_own_hdf5(map_file, tmp_path):
    path = ms.write(ms.read(map_file), tmp_path / "map.h5")
    ms.read(path)

    raw, whole = best(path.read_bytes), best(lambda: ms.read(path))

    print(
        f"\nown HDF5 4096^2: raw {raw * 1e3:.0f} ms, read {whole * 1e3:.0f} ms ({whole / raw:.1f}x)"
    )


def test_streamed_text(tmp_path):
    rng = np.random.default_rng(1)
    rows = np.column_stack([np.arange(10**6) * 1e-5, rng.standard_normal(10**6)])
    path = tmp_path / "long.csv"
    np.savetxt(path, rows, delimiter=",", header="t_s,gap_um", comments="", fmt="%.7g")

    def stream():
        with open_stream(path) as source:
            return sum(len(c["gap_um"]) for c in source.chunks())

    plain = best(lambda: np.loadtxt(path, delimiter=",", skiprows=1), 3)
    ours = best(stream, 3)

    print(
        f"\nCSV 1e6 x 2: numpy.loadtxt {plain:.2f} s, checked stream {ours:.2f} s ({ours / plain:.1f}x)"
    )
