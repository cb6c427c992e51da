"""Write the samples of Keyence files with struct alone; metrosep is not imported.

Run ``python make_samples.py [FOLDER]``; without a folder the files beside this script are written.
"""

import io
import json
import struct
import sys
import zipfile
from pathlib import Path

ROWS = [[900, 1, 2], [3, 65535, 7]]  # the top row first


def surface(factor, rows=ROWS, options=(), **more):
    """Return what a reader must give: the lowest row first; the caller states the order in the file."""
    z = [[None if v != v else v * factor for v in row] for row in reversed(rows)]
    return {"kind": "surface", "shape": [2, 3], "dx_m": 2e-6, "dy_m": 0.5e-6, "z_m": z,
            "options": {"row_order": "top row first", **dict(options)}, **more}  # fmt: skip


def image(rows, *, bits=16, packing=0, size=None):
    code = {8: "B", 16: "H", 32: "I"}[bits]
    data = b"".join(struct.pack(f"<3{code}", *row) for row in rows)
    return struct.pack("<7I", 3, 2, bits, packing, size or len(data), 0, 65535) + bytes(768) + data


def stream(first, second=b"", *, magic=b"VK4_", step=100):
    """Return the content of version 3 or 4."""
    at = {b"VK3_": 80, b"VK4_": 84}[magic]
    start = at + 240
    offsets = [0] * 17
    offsets[6] = start if first else 0
    offsets[7] = start + len(first) if second else 0
    conditions = [0] * 60
    conditions[1:8] = [2026, 3, 4, 10, 20, 30, 60]
    conditions[42:45] = [2_000_000, 500_000, step]
    head = magic + bytes(8) + struct.pack("<17I", *offsets)
    return head.ljust(at, b"\0") + struct.pack("<60I", *conditions) + first + second


def packed(content, magic=b"VK6\0"):
    """Return a file of version 6: a picture, then an archive."""
    memory = io.BytesIO()
    with zipfile.ZipFile(memory, "w", zipfile.ZIP_DEFLATED) as archive:
        entry = zipfile.ZipInfo("Vk4File")
        archive.writestr(entry, content)
    return magic + b"BM" + bytes(range(200)) + memory.getvalue()


OTHER = [[5, 6, 7], [8, 0, 9]]
CASES = {
    "plain.vk4": (stream(image(ROWS)), surface(100e-12)),
    "version-3.vk3": (stream(image(ROWS), magic=b"VK3_"), surface(100e-12)),
    "wide.vk4": (stream(image(ROWS, bits=32)), surface(100e-12)),
    "second.vk4": (stream(image(ROWS), image(OTHER)),
                   surface(100e-12, OTHER, options={"channel": "height 2"}, warnings_match="digit 0")),
    "packed.vk6": (packed(stream(image(ROWS))), surface(100e-12)),
    "lowest-row-first.vk4": (stream(image(ROWS[::-1])),
        surface(100e-12, options={"row_order": "smallest y first"})),
    "rows-not-stated.vk4": (stream(image(ROWS)), {"error": "AmbiguousFormatError", "match": "row_order="}),
    "wrong-size.vk4": (stream(image(ROWS, size=9)), {"error": "CorruptFileError", "match": "bytes"}),
    "compressed.vk4": (stream(image(ROWS, packing=1)), {"error": "CorruptFileError", "match": "not compressed"}),
    "pictures-only.vk4": (stream(b""), {"error": "UnsupportedFeatureError", "match": "only pictures"}),
    "cut-off.vk4": (stream(image(ROWS))[:-3], {"error": "CorruptFileError", "match": "does not fit"}),
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
