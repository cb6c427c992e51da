"""Write the samples of MetroPro files with struct alone; metrosep is not imported.

Run ``python make_samples.py [FOLDER]``; without a folder the files beside this script are written.
"""

import json
import struct
import sys
from pathlib import Path

MAGIC = {1: 0x881B036F, 2: 0x881B0370, 3: 0x881B0371}
HEADER = {1: 834, 2: 834, 3: 4096}
COUNTS = {0: 4096, 1: 32768, 2: 131072}
NOT_MEASURED = 2147483640
WAVELENGTH = struct.unpack(">f", struct.pack(">f", 632.8e-9))[0]
LATERAL = struct.unpack(">f", struct.pack(">f", 2.5e-6))[0]


def metropro(
    rows, *, version=1, resolution=1, sign=0, lateral=LATERAL, scale=0.5, intensity=False
):
    """Return a file with the given raw heights, top row first."""
    height, width = len(rows), len(rows[0])
    header = bytearray(HEADER[version])
    n_image = 2 * width * height if intensity else 0
    struct.pack_into(">Ihi", header, 0, MAGIC[version], version, HEADER[version])
    header[12:36] = b"Sat Jan  3 00:00:00 2026"
    struct.pack_into(">hhh", header, 42, 9, 0, 1)
    if intensity:
        struct.pack_into(">hhhhhh", header, 48, 0, 0, width, height, 1, 255)
        struct.pack_into(">i", header, 60, n_image)
    struct.pack_into(">hhhhi", header, 64, 139, 38, width, height, 4 * width * height)
    struct.pack_into(">i", header, 76, 1767398400)
    header[80:95] = b"planted bump, 1"
    struct.pack_into(">fffff", header, 164, scale, WAVELENGTH, 0.0, 1.0, 0.0)
    struct.pack_into(">f", header, 184, lateral)
    struct.pack_into(">h", header, 218, resolution)
    struct.pack_into(">hhh", header, 232, sign, 640, 480)
    header[246:250] = b"2.5X"
    image = b"".join(struct.pack(">H", 100 + i) for i in range(n_image // 2))
    phase = b"".join(struct.pack(">i", value) for row in rows for value in row)
    return bytes(header) + image + phase


def expected(rows, *, resolution=1, sign=0, lateral=LATERAL, scale=0.5):
    """Return what a reader must give: the lowest row first."""
    factor = scale * WAVELENGTH / COUNTS[resolution] * (-1 if sign else 1)
    z = [[None if v >= NOT_MEASURED else v * factor for v in row] for row in reversed(rows)]
    step = lateral or None
    return {"kind": "surface", "shape": [len(z), len(z[0])], "dx_m": step, "dy_m": step, "z_m": z}


# the top row holds the largest count, the right column the hole: no mirror image looks the same
ROWS = [
    [900, 10, 20, NOT_MEASURED],
    [1, 2, 3, 4],
    [-5, -6, -7, 32768],
]
CASES = {
    "format1.dat": {"intensity": True},
    "format2-coarse.dat": {"version": 2, "resolution": 0},
    "format3-fine.dat": {"version": 3, "resolution": 2},
    "negated.dat": {"sign": 1},
    "uncalibrated.dat": {"lateral": 0.0},
    "wavefront.dat": {"scale": 1.0, "intensity": True},
}


def main(folder):
    for part in ("samples", "expected"):
        (folder / part).mkdir(parents=True, exist_ok=True)
    truths = {}
    for name, options in CASES.items():
        (folder / "samples" / name).write_bytes(metropro(ROWS, **options))
        facts = {
            k: v for k, v in options.items() if k in {"resolution", "sign", "lateral", "scale"}
        }
        truths[name] = expected(ROWS, **facts)
    whole = metropro(ROWS)
    damaged = {
        "no-valid-pixel.dat": (metropro([[NOT_MEASURED] * 2] * 2), "no point was measured"),
        "cut-off.dat": (whole[:-7], "do not add up"),
        "unknown-resolution.dat": (metropro(ROWS, resolution=7), "phase_resolution"),
    }
    for name, (data, match) in damaged.items():
        (folder / "samples" / name).write_bytes(data)
        truths[name] = {"error": "CorruptFileError", "match": match}
    for name, truth in truths.items():
        text = json.dumps(truth, indent=1, sort_keys=True) + "\n"
        (folder / "expected" / f"{name}.json").write_text(text, encoding="utf-8")


if __name__ == "__main__":
    main(Path(sys.argv[1]) if len(sys.argv) > 1 else Path(__file__).parent)
