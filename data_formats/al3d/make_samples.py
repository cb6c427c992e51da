"""Write the samples of Alicona files with struct alone; metrosep is not imported.

Run ``python make_samples.py [FOLDER]``; without a folder the files beside this script are written.
"""

import json
import math
import struct
import sys
from pathlib import Path

MARKER = 3e15


def single(value):
    """Return a number as single precision keeps it."""
    return struct.unpack("<f", struct.pack("<f", value))[0]


def tag(key, value):
    return key.encode().ljust(20, b"\0") + str(value).encode().ljust(30, b"\0") + b"\r\n"


def al3d(rows, *, comment="", leave_out=(), **changed):
    """Return a file with the given heights in m, top row first; None is not measured."""
    lines, points = len(rows), len(rows[0])
    tags = {
        "Cols": points,
        "IconOffset": 0,
        "DepthImageResPtr": 3,
        "DepthImageOffset": 0,
        "CreatingApplication": "MeasureSuite 5.3",
        "InvalidPixelValue": "3.000000028082e+15",
        "PixelSizeYMeter": "6.5e-07",
        "PixelSizeXMeter": "4.38027e-07",
        "NumberOfPlanes": 1,
        "Rows": lines,
        "TextureImageOffset": 0,
    }
    tags = {k: v for k, v in tags.items() if k not in leave_out}
    start = 17 + 52 * (2 + len(tags)) + 256
    tags["DepthImageOffset"] = start
    tags.update(changed)
    head = b"AliconaImaging\0\r\n" + tag("Version", 1) + tag("TagCount", len(tags))
    head += b"".join(tag(k, v) for k, v in tags.items())
    head += comment.encode("latin-1").ljust(254, b"\0") + b"\r\n"
    body = b""
    for row in rows:
        line = b"".join(struct.pack("<f", MARKER if v is None else v) for v in row)
        body += line + b"\x7f" * (-len(line) % 8)
    return head + body


def expected(rows, *, dx=4.38027e-07, dy=6.5e-07, **more):
    z = [[None if v is None or v != v else single(v) for v in row] for row in reversed(rows)]
    return {
        "kind": "surface",
        "shape": [len(z), len(z[0])],
        "dx_m": dx,
        "dy_m": dy,
        "z_m": z,
        **more,
    }


# the top row holds the largest value, the right column the hole; three columns need padding
ODD = [[90e-6, 1e-6, None], [1.5e-6, 2e-6, 3e-6], [-5e-6, -6e-6, -7e-6], [0.5e-6, 0.25e-6, 8e-6]]
EVEN = [[*row, 4e-6] for row in ODD]
WITH_NAN = [[90e-6, math.nan], [1e-6, None], [-2e-6, 5e-6]]


def main(folder):
    for part in ("samples", "expected"):
        (folder / part).mkdir(parents=True, exist_ok=True)
    whole = al3d(EVEN)
    files = {
        "padded.al3d": (al3d(ODD, comment="planted bump, 5 \xb5m"), expected(ODD)),
        "even.al3d": (whole, expected(EVEN)),
        "nan.al3d": (al3d(WITH_NAN), expected(WITH_NAN)),
        "no-marker.al3d": (
            al3d([[1e-6, math.nan], [2e-6, 4e-6]], leave_out=("InvalidPixelValue",)),
            expected([[1e-6, math.nan], [2e-6, 4e-6]]),
        ),
        "uncalibrated.al3d": (
            al3d(ODD, PixelSizeXMeter=0, leave_out=("PixelSizeYMeter",)),
            expected(ODD, dx=None, dy=None),
        ),
    }
    damaged = {
        "cut-off.al3d": (whole[:-5], "CorruptFileError", "does not fit"),
        "no-number.al3d": (al3d(ODD, Rows="4.5"), "CorruptFileError", "Rows"),
        "no-depth.al3d": (
            al3d(ODD, DepthImageOffset=0),
            "UnsupportedFeatureError",
            "no depth image",
        ),
    }
    for name, (data, error, match) in damaged.items():
        files[name] = (data, {"error": error, "match": match})
    for name, (data, truth) in files.items():
        (folder / "samples" / name).write_bytes(data)
        text = json.dumps(truth, indent=1, sort_keys=True) + "\n"
        (folder / "expected" / f"{name}.json").write_text(text, encoding="utf-8")


if __name__ == "__main__":
    main(Path(sys.argv[1]) if len(sys.argv) > 1 else Path(__file__).parent)
