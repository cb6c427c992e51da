"""Write the samples of Mountains documents with struct alone; metrosep is not imported.

Run ``python make_samples.py [FOLDER]``; without a folder the files beside this script are written.
"""

import json
import struct
import sys
import zlib
from pathlib import Path

ROWS = [[900, -1, 2], [3, 60000, 7]]  # the top row first
VOID = [[900, None, 2], [3, 60000, 7]]
MARKS = [[9, 22, 9], [9, 9, 9]]


def entry(tag, data):
    return struct.pack("<HQ", tag, len(data)) + data


def number(tag, value, code="I"):
    return entry(tag, struct.pack(f"<{code}", value))


def text(tag, value):
    return entry(tag, b"\x04" + value.encode("utf-16-le"))


def kind(value):
    return entry(1, number(1, value))


def array(data, count, *, lie=0):
    """Return an array in two deflated pieces, the second one first."""
    half = count // 2
    width = len(data) // count
    pieces = b"".join(
        struct.pack("<QII", first, n, len(zlib.compress(part))) + zlib.compress(part)
        for first, n, part in (
            (half, count - half, data[half * width :]),
            (0, half, data[: half * width]),
        )
    )
    return number(1, count) + entry(2, struct.pack("<Q", len(data) + lie) + pieces)


def scale(step, unit, shown, origin=0.0):
    return number(1, step, "d") + text(2, unit) + text(3, shown) + number(5, origin, "d")


def axis(tag, step, n):
    inner = entry(0xFFFF, scale(step, "mm", "um")) + number(1, n) + number(2, 0) + number(3, n - 1)
    return entry(tag, entry(0xFFFF, inner))


def surface_object(name="map", rows=ROWS, marks=None, unit="nm", lie=0):
    """Return an object of class 9012 with its measurement."""
    counts = b"".join(struct.pack("<3i", *row) for row in rows)
    grid = entry(0xFFFF, entry(0xFFFF, text(1, name))) + axis(1, 2e-3, 3) + axis(2, 0.5e-3, 2)
    if marks:
        framed = bytes(5) + b"".join(b"\0" + bytes(row) + b"\0" for row in marks) + bytes(5)
        grid += entry(
            3,
            kind(9056)
            + entry(
                2, number(1, 3) + number(2, 2) + entry(5, kind(9048) + entry(2, array(framed, 20)))
            ),
        )
    heights = entry(1, kind(9049) + entry(2, array(counts, 6, lie=lie)))
    z = entry(
        2,
        entry(0xFFFF, scale(0.5, unit, "um" if unit == "nm" else unit, -0.25))
        + number(1, -1, "i")
        + number(2, 60000, "i"),
    )
    measurement = entry(0xFFFF, entry(0xFFFF, grid) + heights + z)
    inner = entry(1, kind(9062) + entry(2, measurement))
    return kind(9012) + entry(2, entry(0xFFFF, text(4, name)) + inner)


def document(*objects):
    """Return the stream ScopedContents; every object has a size of its own before it."""
    listed = b"".join(struct.pack("<Q", len(o) + 10) + entry(1, o) for o in objects)
    main = entry(0xC8, number(1, 9)) + entry(
        0x02BD, number(1, len(objects), "B") + entry(2, entry(1, listed))
    )
    body = entry(1, main)
    return struct.pack("<Q", len(body)) + body


def ole(name, content):
    """Return an OLE file with one stream in sectors of 512 bytes: table, directory, stream."""
    end, free, table = 0xFFFFFFFE, 0xFFFFFFFF, 0xFFFFFFFD
    content = content.ljust(4096, b"\0") if len(content) < 4096 else content
    n = -(-len(content) // 512)
    links = [table, end, *range(3, 2 + n), end]
    sectors = [struct.pack("<128I", *links, *[free] * (128 - len(links)))]

    def directory(title, code, start, size, child=free):
        raw = title.encode("utf-16-le") + b"\0\0"
        return (raw.ljust(64, b"\0") + struct.pack("<HBB3I", len(raw), code, 1, free, free, child)
                + bytes(36) + struct.pack("<IQ", start, size))  # fmt: skip

    sectors.append(
        (directory("Root Entry", 5, end, 0, 1) + directory(name, 2, 2, len(content))).ljust(
            512, b"\0"
        )
    )
    head = (
        b"\xd0\xcf\x11\xe0\xa1\xb1\x1a\xe1"
        + bytes(16)
        + struct.pack("<5H", 0x3E, 3, 0xFFFE, 9, 6)
        + bytes(6)
    )
    head += struct.pack("<10I", 0, 1, 1, 0, 4096, end, 0, end, 0, 0)
    head += struct.pack("<108I", *[free] * 108)
    return head + b"".join(sectors) + content.ljust(512 * n, b"\0")


def surface(rows=ROWS, **more):
    z = [[None if v is None else v * 0.5e-9 - 0.25e-6 for v in row] for row in reversed(rows)]
    return {"kind": "surface", "shape": [2, 3], "dx_m": 2e-6, "dy_m": 0.5e-6, "z_m": z, **more}


OTHER = [[5, 6, 7], [8, 0, 9]]
STREAM = "ScopedContents"
TWO = ole(
    STREAM,
    document(
        kind(9000) + entry(2, b""),
        surface_object("first", marks=MARKS),
        surface_object("second", OTHER),
    ),
)
CASES = {
    "plain.mnt": (ole(STREAM, document(surface_object())), surface()),
    "masked.mnt": (TWO, surface(VOID)),
    "second.mnt": (TWO, surface(OTHER, options={"channel": "second"})),
    "intensity.mnt": (ole(STREAM, document(surface_object(unit="V"))),
                      {"error": "UnsupportedFeatureError", "match": "no measured surface"}),
    "wrong-array.mnt": (ole(STREAM, document(surface_object(lie=24))),
                        {"error": "CorruptFileError", "match": "element has a size of its own"}),
}  # fmt: skip


def main(folder):
    for part in ("samples", "expected"):
        (folder / part).mkdir(parents=True, exist_ok=True)
    for name, (data, truth) in CASES.items():
        (folder / "samples" / name).write_bytes(data)
        (folder / "expected" / f"{name}.json").write_text(
            json.dumps(truth, indent=1, sort_keys=True) + "\n", encoding="utf-8"
        )


if __name__ == "__main__":
    main(Path(sys.argv[1]) if len(sys.argv) > 1 else Path(__file__).parent)
