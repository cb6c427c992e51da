"""Fixtures of the file tests."""

import numpy as np
import pytest

import metrosep as ms
from metrosep.io.source import RawFile


@pytest.fixture
def put(tmp_path):
    """Write text or bytes to a file and return its path."""

    def write(content, name="data.csv"):
        path = tmp_path / name
        path.write_bytes(content if isinstance(content, bytes) else content.encode())
        return path

    return write


@pytest.fixture
def bump():
    """Surface without any symmetry: a bump in one corner, a hole in another, steps unequal."""
    z = np.zeros((4, 5))
    z[0, 4] = 90e-9
    z[3, 0] = np.nan
    z[2, 1] = -1.0 / 3.0 * 1e-9
    return ms.Surface(z, 1.5e-6, 2.5e-6, origin=(1e-3, -2e-3))


@pytest.fixture
def survives_damage():
    """Flip every byte and cut at every 64th: a measurement with a number in it, or a ReadError."""

    def damaged(data, every):
        yield from (data[:end] for end in range(1, len(data), 7 if len(data) < 1500 else 64))
        for i in range(0, len(data), every):
            for pattern in (0xFF, 0x80, 0x01):
                yield data[:i] + bytes([data[i] ^ pattern]) + data[i + 1 :]

    def numbers(obj):
        return list(obj.channels.values()) if isinstance(obj, ms.Recording) else [obj.z]

    def check(reader, path, *, every=1, **options):
        outcomes = []
        for content in damaged(path.read_bytes(), every):
            try:
                obj = reader.read(RawFile(path, content), **options)
            except (ms.errors.ReadError, ms.errors.UnitError) as exc:
                outcomes.append(path.name in str(exc))
            else:
                outcomes.append(any(np.isfinite(v).any() for v in numbers(obj)))
            reader.sniff(RawFile(path, content))
        assert all(outcomes)

    return check
