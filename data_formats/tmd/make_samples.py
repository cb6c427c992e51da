"""Write the samples of TrueMap files with struct alone; metrosep is not imported.

Run ``python make_samples.py [FOLDER]``; without a folder the files beside this script are written.
"""

import json
import struct
import sys
from pathlib import Path

ROWS = [[0.5, -0.25, 3.5], [1.0, 0.125, -2.0]]  # the top row first


def surface(factor, rows=ROWS, options=(), **more):
    """Return what a reader must give: the lowest row first; the caller states the order in the file."""
    z = [[None if v != v else v * factor for v in row] for row in reversed(rows)]
    return {"kind": "surface", "shape": [2, 3], "dx_m": 2e-6, "dy_m": 0.5e-6, "z_m": z,
            "options": {"row_order": "top row first", **dict(options)}, **more}  # fmt: skip


def tmd(columns=3, rows=2, lengths=(6e-3, 1e-3), version=b"2.0"):
    head = b"Binary TrueMap Data File v" + version + b"\r\n\0" + b"Created by TrueMap v6\r\n\0"
    head = head[:32].ljust(32, b"\0") + b"Created by TrueMap v6\r\n\0"[:24].ljust(24, b"\0")
    head += struct.pack("<2I4f", columns, rows, *lengths, 0.0, 0.0)
    return head + b"".join(struct.pack("<3f", *row) for row in ROWS)


CASES = {
    "millimetres.tmd": (tmd(lengths=(6.0, 1.0)),
        surface(1e-3, options={"unit": "mm"}) | {"dx_m": 2e-3, "dy_m": 0.5e-3}),
    "unit-asked-for.tmd": (tmd(), {"error": "UnitError", "match": "states no unit"}),
    "claims-more.tmd": (tmd(rows=3), {"error": "CorruptFileError", "match": "does not fit",
                                      "options": {"unit": "mm"}}),
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
