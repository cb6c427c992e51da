"""Every sample with flipped bytes and cut short: a valid object or a ReadError, quickly.

The bytes are flipped one at a time: every byte of a MetroPro header that is read, and evenly
spread ones of the other samples; three patterns each.
"""

import json
import time

import numpy as np
import pytest

import metrosep as ms
from metrosep.io import registry
from metrosep.io.source import RawFile

PATTERNS = (0xFF, 0x80, 0x01)
SLOWEST = 2.0  # seconds for one damaged file
LONGEST = 700  # characters of one message with a long path
REFUSED = (ms.errors.ReadError, ms.errors.UnitError)
CASES = [
    ("metropro", "format1.dat", 1),
    ("metropro", "format3-fine.dat", 7),
    ("x3p", "double.x3p", 1),
    ("x3p", "integer-L-mask.x3p", 3),
    ("x3p", "ascii-offset.x3p", 3),
    ("x3p", "profile-positions.x3p", 3),
    ("delimited", "semicolon-decimal-comma.csv", 1),
    ("delimited", "points.xyz", 1),
    ("delimited", "quoted-decimal-comma.csv", 1),
    ("delimited", "utf16-micro.csv", 1),
    ("delimited", "recording.csv", 1),
]


def outcome(reader, path, data, options):
    """Read bytes as one format and check whatever comes out."""
    start = time.perf_counter()
    message = None
    try:
        obj = reader.read(RawFile(path, data), **options)
    except REFUSED as exc:
        message = str(exc)
    assert time.perf_counter() - start < SLOWEST
    if message is not None:
        assert path.name in message
        assert len(message) < LONGEST
        return "refused"
    if isinstance(obj, ms.Surface):
        assert np.isfinite(obj.z).any()
        assert all(s is None or 0 < s < np.inf for s in (obj.dx, obj.dy))
    elif isinstance(obj, ms.Profile):
        assert np.isfinite(obj.x).all()
        assert np.isfinite(obj.z).any()
    return "read"


def sample_of(repository, format_id, name):
    folder = repository / "data_formats" / format_id
    truth = json.loads((folder / "expected" / f"{name}.json").read_text(encoding="utf-8"))
    path = folder / "samples" / name
    return path, path.read_bytes(), truth.get("options", {})


@pytest.mark.parametrize(("format_id", "name", "every"), CASES)
def test_flipped_bytes(repository, format_id, name, every):
    path, data, options = sample_of(repository, format_id, name)
    reader = registry.get(format_id).load_reader()
    results = set()

    for i in range(0, len(data), every):
        for pattern in PATTERNS:
            damaged = bytearray(data)
            damaged[i] ^= pattern
            results.add(outcome(reader, path, bytes(damaged), options))
            reader.sniff(bytes(damaged), name)

    assert results == {"read", "refused"}


@pytest.mark.parametrize(("format_id", "name", "every"), CASES)
def test_truncation(repository, format_id, name, every):
    path, data, options = sample_of(repository, format_id, name)
    reader = registry.get(format_id).load_reader()
    step = 1 if len(data) < 1500 else 64

    for end in range(1, len(data), step):
        result = outcome(reader, path, data[:end], options)
        if format_id != "delimited":  # text may end after any row
            assert result == "refused"


@pytest.mark.parametrize("seed", range(5))
def test_noise_is_never_a_measurement(tmp_path, seed):
    path = tmp_path / "noise.dat"
    path.write_bytes(np.random.default_rng(seed).bytes(5000))

    with pytest.raises(ms.errors.UnknownFormatError):
        ms.read(path)
