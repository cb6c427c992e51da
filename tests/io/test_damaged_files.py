"""Damaged files of every format: a measurement with a number in it, or one refusal; soon and small.

`damaged` draws a sample of data_formats and one accident: cut, flipped bits, a field that claims an
absurd count, a block repeated, moved or filled, a tail of a stranger, members of an archive that
swell. The ordinary run takes a part of the seeds; ``-m slow`` takes 10,000 files.
"""

import io
import random
import struct
import time
import tracemalloc
import zipfile
from pathlib import Path

import numpy as np
import pytest

import metrosep as ms

SAMPLES = sorted(
    p
    for p in Path(__file__).parents[2].glob("data_formats/*/samples/*")
    if p.parents[1].name not in ("linuxcnc-comp", "neutral-table")
)
SLOWEST = 2.0  # seconds of processor time
LARGEST = 200 * 2**20  # bytes: the samples are small
REFUSED = (ms.errors.ReadError, ms.errors.UnitError)
ABSURD = (
    b"\xff\xff\xff\xff", b"\xff\xff\xff\x7f", b"\x00\x00\x00\x80", b"\x7f\xff\xff\xff", b"\x00\x00\xc0\x7f",
    b"\x00\x00\x01\x00", b"\xff\xff\xff\xff\xff\xff\xff\xff", b"\x00\x00\x00\x00\x00\x00\xf0\x7f",
    b"\x00\x00\x00\x00\x01\x00\x00\x00", struct.pack("<d", 1e300), struct.pack(">d", -1e-300),
    struct.pack("<q", -1), b"99999999", b"1e999999", b"-1", b"\x00",
)  # fmt: skip


def cut(data, draw):
    return data[: draw.randrange(1, len(data) + 1)]


def flip(data, draw):
    changed = bytearray(data)
    for _ in range(draw.choice((1, 1, 2, 8, 64))):
        changed[draw.randrange(len(data))] ^= 1 << draw.randrange(8)
    return bytes(changed)


def claim(data, draw):
    """Put an absurd number over some bytes, more often in the head, where counts stand."""
    value = draw.choice(ABSURD)
    most = max(min(len(data), draw.choice((64, 512, 4096, len(data)))) - len(value), 1)
    at = draw.randrange(most)
    return data[:at] + value + data[at + len(value) :]


def move(data, draw):
    a, b = sorted(draw.randrange(len(data) + 1) for _ in range(2))
    how = draw.randrange(4)
    if how == 0:
        return data[:a] + data[b:]
    if how == 1:
        return data[:b] + data[a:]
    if how == 2:
        return data[:a] + bytes([draw.choice((0, 255, 32))]) * (b - a) + data[b:]
    return data[b:] + data[a:b] + data[:a]


def stranger(data, draw):
    """Go on as another format does, or begin as one."""
    other = draw.choice(SAMPLES).read_bytes()
    a, b = draw.randrange(len(data)), draw.randrange(len(other))
    return data[:a] + other[b:] if draw.random() < 0.5 else other[: min(b, 64)] + data[a:]


def swell(data, draw):
    """Write the members of an archive anew, one of them a few hundred times larger or of zeros."""
    if not data.startswith(b"PK"):
        return claim(data, draw)
    memory = io.BytesIO()
    try:
        with zipfile.ZipFile(io.BytesIO(data)) as old, zipfile.ZipFile(memory, "w", 8) as new:
            names = old.namelist()
            chosen = draw.choice(names)
            for name in names:
                body = old.read(name)
                new.writestr(name, bytes(2**24) + body if name == chosen else body)
    except (zipfile.BadZipFile, KeyError):
        return data
    return memory.getvalue()


ACCIDENTS = (cut, flip, flip, claim, claim, claim, move, stranger, swell)


def damaged(seed):
    """Return name and content of a damaged file."""
    draw = random.Random(seed)  # noqa: S311  (not a secret)
    sample = draw.choice(SAMPLES)
    accident = draw.choice(ACCIDENTS)
    return f"{sample.parents[1].name}-{accident.__name__}-{seed}{sample.suffix}", accident(
        sample.read_bytes(), draw
    )


def outcome(path, content):
    """Return what reading a file gave: nothing if it was right or refused, else a sentence."""
    path.write_bytes(content)
    started = time.process_time()
    try:
        obj = ms.read(path)
    except REFUSED as exc:
        found = None if path.name in str(exc) else f"does not name the file: {exc}"
    except Exception as exc:
        found = f"{type(exc).__name__}: {exc}"
    else:
        values = obj.channels.values() if isinstance(obj, ms.Recording) else [obj.z]
        found = None if any(np.isfinite(v).any() for v in values) else "holds no number"
    took = time.process_time() - started
    path.unlink()
    return f"took {took:.1f} s" if took > SLOWEST else found


def run(seeds, folder):
    """Return what went wrong, by file."""
    faults = {}
    for seed in seeds:
        name, content = damaged(seed)
        if content and (found := outcome(folder / name, content)):
            faults[name] = found
    return faults


@pytest.mark.parametrize("part", range(4))
def test_damaged_files_are_read_or_refused(tmp_path, part):
    assert run(range(100 * part, 100 * part + 100), tmp_path) == {}


@pytest.mark.slow
@pytest.mark.parametrize("part", range(20))
def test_ten_thousand_damaged_files(tmp_path, part):
    assert run(range(1000 + 500 * part, 1500 + 500 * part), tmp_path) == {}


def test_no_damaged_file_takes_much_memory(tmp_path):
    outcome(tmp_path / "first.bin", SAMPLES[0].read_bytes())  # imports are not counted
    peaks = {}
    for seed in range(5000, 5060):
        name, content = damaged(seed)
        if len(content) > 2**22 or not content:
            continue
        tracemalloc.start()
        outcome(tmp_path / name, content)
        peaks[name] = tracemalloc.get_traced_memory()[1]
        tracemalloc.stop()

    assert {name: peak for name, peak in peaks.items() if peak > LARGEST} == {}


def test_every_reader_refuses_the_files_of_the_others(repository):
    """format= names another format: it is refused, within the time of any other file."""
    from metrosep.io import registry

    known = [f for f in registry.formats() if f.is_measurement]
    accepted = []
    for described in known:
        sample = min((repository / "data_formats" / described.id / "samples").iterdir())
        for other in known:
            if other.id == described.id:
                continue
            started = time.process_time()
            try:
                ms.read(sample, format=other.id)
            except REFUSED:
                pass
            else:
                accepted.append((described.id, other.id))
            assert time.process_time() - started < SLOWEST, (sample, other.id)

    assert accepted == [
        ("contour-dat", "delimited")
    ]  # rows x, z with their unit: the same profile


def test_a_long_line_of_numbers_with_one_odd_byte_is_looked_through_once(tmp_path):
    """The page of a text was sought by a pattern that took the square of the length of a line."""
    row = b" ".join(b"-1.0000000000000%d" % k for k in range(3000))

    assert outcome(tmp_path / "long.dat", row + b"\n\x85\x01 1 2\n") is None


def test_an_archive_with_a_member_without_a_name_is_refused(tmp_path):
    name, content = damaged(908308)

    assert outcome(tmp_path / name, content) is None
