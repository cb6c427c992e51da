"""Write the samples of NanoFocus files with struct alone; metrosep is not imported.

Run ``python make_samples.py [FOLDER]``; without a folder the files beside this script are written.
"""

import json
import struct
import sys
from pathlib import Path

ROWS = [[900, 1, 2], [3, 65534, 0]]  # the top row first

LOW, HIGH = -4e-6, 61.534e-6
STEP = (HIGH - LOW) / 65534


def surface(factor=STEP, rows=ROWS, options=(), **more):
    """Return what a reader must give: the lowest row first; the caller states the order in the file."""
    z = [[None if v != v else LOW + v * factor for v in row] for row in reversed(rows)]
    return {"kind": "surface", "shape": [2, 3], "dx_m": 2e-6, "dy_m": 0.5e-6, "z_m": z,
            "options": {"row_order": "top row first", **dict(options)}, **more}  # fmt: skip


def nms(columns=3, rows=2, low=-4.0, high=61.534, step=2e-3):
    head = bytearray(3468)
    struct.pack_into("<2d", head, 16, low, high)
    struct.pack_into("<2I2d", head, 1368, columns, rows, step, 0.5e-3)
    return bytes(head) + b"".join(struct.pack("<3H", *row) for row in ROWS)


CASES = {
    "plain.nms": (nms(), surface()),
    "claims-more.nms": (nms(rows=3), {"error": "CorruptFileError", "match": "a map that fills", "options": {"format": "nms"}}),
    "no-step.nms": (nms(step=0.0), {"error": "CorruptFileError", "match": "a map that fills", "options": {"format": "nms"}}),
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
