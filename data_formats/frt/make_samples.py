"""Write the samples of FRT files with struct alone; metrosep is not imported.

Run ``python make_samples.py [FOLDER]``; without a folder the files beside this script are written.
"""

import json
import struct
import sys
from pathlib import Path

ROWS = [[900, 1, 2], [3, 60000, 7]]  # the lowest row first; 1 is not measured
STEP = 0.25e-9


def block(tag, data, wide):
    return struct.pack("<H" + ("Q" if wide else "I"), tag, len(data)) + data


def frt(*, version=b"1.01", bits=16, images=False, rows=ROWS, columns=3, scale=STEP, tail=b""):
    """Return a file; with `images` the heights lie in a block of several images."""
    wide = version != b"1.00"
    data = b"".join(struct.pack("<3" + {16: "H", 32: "i"}[bits], *row) for row in rows)
    parts = [
        (0x65, b"a comment"),
        (0x66, struct.pack("<3I", columns, 2, bits)),
        (0x67, struct.pack("<5dI", 6e-6, 1e-6, 0.0, 0.0, 1.0, 0)),
        (0x6C, struct.pack("<Id", 2, scale)),
    ]
    if images:
        other = struct.pack("<4I", 1, 3, 2, 16) + bytes(12)
        parts.append((0x7D, bytes(8) + other + struct.pack("<4I", 4, 3, 2, bits) + data))
    else:
        parts.append((0x0B, data))
    body = b"".join(block(tag, content, wide) for tag, content in parts)
    return b"FRTM_GLIDERV" + version + struct.pack("<H", len(parts)) + body + tail


def surface(factor=STEP):
    z = [[None if v == 1 else v * factor for v in row] for row in ROWS]
    return {"kind": "surface", "shape": [2, 3], "dx_m": 2e-6, "dy_m": 0.5e-6, "z_m": z}


CASES = {
    "plain.frt": (frt(), surface()),
    "version-1.00.frt": (frt(version=b"1.00", bits=32), surface()),
    "images.frt": (frt(images=True), surface()),
    "version-2.frt": (frt(version=b"2.00"), {"error": "UnsupportedFeatureError", "match": "1.00 and 1.01"}),
    "too-wide.frt": (frt(columns=4), {"error": "CorruptFileError", "match": "larger than what encloses it"}),
    "no-scale.frt": (frt(scale=0.0), {"error": "CorruptFileError", "match": "height per count"}),
    "cut-off.frt": (frt()[:-3], {"error": "CorruptFileError", "match": "block 0xb"}),
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
