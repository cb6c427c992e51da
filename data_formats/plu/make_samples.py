"""Write the samples of Sensofar PLu files with struct alone; metrosep is not imported.

Run ``python make_samples.py [FOLDER]``; without a folder the files beside this script are written.
"""

import json
import struct
import sys
from pathlib import Path

IMAGE, PROFILE, TOPOGRAPHY = 0, 1, 3
NOT_MEASURED = 1000001.0


def single(value):
    """Return a number as single precision keeps it."""
    return struct.unpack("<f", struct.pack("<f", value))[0]


DX_UM, DY_UM = single(1.66), single(2.5)


def plu(layers, *, kind=TOPOGRAPHY, steps=(DX_UM, DY_UM), n_images=1, limits=True):
    """Return a file with the given layers in um, top row first; None is not measured."""
    lines, points = len(layers[0]), len(layers[0][0])
    head = b"Sat Jan  3 09:15:30 2026".ljust(128, b"\0") + struct.pack("<I", 1767431730)
    head += "planted bump, 5 \xb5m".encode("latin-1").ljust(256, b"\0")
    head += struct.pack("<III", lines, points, points)
    head += struct.pack("<7f", 28.25, *steps, -52.5, -6042.5, 1.625, 142.5)
    head += struct.pack("<5I", kind, 3, 0, 14, 3) + struct.pack(
        "<5I", lines, points, lines, points, 1
    )
    head += struct.pack("<dfII", 0.0625, 55.5, 23, 0)
    head += struct.pack("<5B3xI", 0, len(layers), 0xFB, 6, n_images, 1)
    body = b""
    for rows in layers:
        body += struct.pack("<II", len(rows), len(rows[0]))
        body += b"".join(
            struct.pack("<f", NOT_MEASURED if v is None else v) for row in rows for v in row
        )
        if limits:
            body += struct.pack("<ff", -NOT_MEASURED, NOT_MEASURED)
            body += bytes(range(3 * len(rows) * len(rows[0]))) * n_images
    return head + body


def expected(rows, *, steps=(DX_UM, DY_UM), **more):
    z = [[None if v is None else single(v) * 1e-6 for v in row] for row in reversed(rows)]
    dx, dy = (s * 1e-6 if s else None for s in steps)
    return {
        "kind": "surface",
        "shape": [len(z), len(z[0])],
        "dx_m": dx,
        "dy_m": dy,
        "z_m": z,
        **more,
    }


# the top row holds the largest value, the right column the hole: no mirror image looks the same
ROWS = [[90.5, 1.25, 0.5, None], [0.1, 0.2, 0.3, 0.4], [-0.5, -0.6, -0.7, 3.5]]
OTHER = [[7.5, 1.0], [-2.5, None], [0.25, 0.125]]
LINE = [0.5, 0.75, None, 11.0, -3.0, 0.2]


def main(folder):
    for part in ("samples", "expected"):
        (folder / part).mkdir(parents=True, exist_ok=True)
    line = {
        "kind": "profile",
        "shape": [len(LINE)],
        "x_m": [i * (DX_UM * 1e-6) for i in range(len(LINE))],
        "z_m": [None if v is None else single(v) * 1e-6 for v in LINE],
    }
    whole = plu([ROWS])
    files = {
        "topography.plu": (whole, expected(ROWS)),
        "bare.plu": (plu([ROWS], n_images=0, limits=False), expected(ROWS)),
        "layers.plu": (
            plu([ROWS, OTHER]),
            expected(OTHER, options={"channel": "layer 2"}, warnings_match="3 x 2 points"),
        ),
        "profile.plu": (plu([[LINE]], kind=PROFILE, n_images=0), line),
        "uncalibrated.plu": (plu([ROWS], steps=(0.0, 0.0)), expected(ROWS, steps=(0.0, 0.0))),
    }
    damaged = {
        "cut-off.plu": (whole[:550], "CorruptFileError", "does not fit"),
        "nothing.plu": (plu([[[None] * 4] * 3]), "CorruptFileError", "no point was measured"),
        "image.plu": (plu([ROWS], kind=IMAGE), "UnsupportedFeatureError", "holds an image"),
    }
    for name, (data, error, match) in damaged.items():
        files[name] = (data, {"error": error, "match": match})
    for name, (data, truth) in files.items():
        (folder / "samples" / name).write_bytes(data)
        text = json.dumps(truth, indent=1, sort_keys=True) + "\n"
        (folder / "expected" / f"{name}.json").write_text(text, encoding="utf-8")


if __name__ == "__main__":
    main(Path(sys.argv[1]) if len(sys.argv) > 1 else Path(__file__).parent)
