"""Write the samples of OmniSurf3D files with struct alone; metrosep is not imported.

Run ``python make_samples.py [FOLDER]``; without a folder the files beside this script are written.
"""

import json
import struct
import sys
from pathlib import Path

ROWS = [[0.5, -0.25, 3.5], [1.0, -3.4e38, -2.0]]  # the top row first, in um
VOID = [[0.5, -0.25, 3.5], [1.0, float("nan"), -2.0]]


def surface(factor, rows=VOID, options=(), **more):
    """Return what a reader must give: the lowest row first; the caller states the order in the file."""
    z = [[None if v != v else v * factor for v in row] for row in reversed(rows)]
    return {"kind": "surface", "shape": [2, 3], "dx_m": 2e-6, "dy_m": 0.5e-6, "z_m": z,
            "options": {"row_order": "top row first", **dict(options)}, **more}  # fmt: skip


def text(value):
    return struct.pack("<i", len(value)) + value.encode()


def os3d(columns=3, rows=2, steps=(2.0, 0.5), origin=(4.0, -8.0)):
    head = b"OmniSurf3D" + struct.pack("<2i", 1, 0) + text("a part") + text("2026-03-04 10:20:30")
    head += struct.pack("<2i4d", columns, rows, *steps, *origin)
    return head + b"".join(struct.pack("<3f", *row) for row in ROWS)


CASES = {
    "plain.os3d": (os3d(), surface(1e-6, origin_m=[4e-6, -8e-6])),
    "no-steps.os3d": (os3d(steps=(0.0, 0.0)), surface(1e-6) | {"dx_m": None, "dy_m": None}),
    "no-size.os3d": (os3d(columns=-3), {"error": "CorruptFileError", "match": "no size"}),
    "claims-more.os3d": (os3d(rows=3), {"error": "CorruptFileError", "match": "does not fit"}),
    "origin-nan.os3d": (os3d(origin=(float("nan"), 0.0)), {"error": "CorruptFileError", "match": "not usable"}),
    "cut-off.os3d": (os3d()[:40], {"error": "CorruptFileError", "match": "larger than what encloses it"}),
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
