"""Write the samples of Wyko OPD files with struct alone; metrosep is not imported.

Run ``python make_samples.py [FOLDER]``; without a folder the files beside this script are written.
"""

import json
import struct
import sys
from pathlib import Path

ARRAY, TEXT, SHORT, FLOAT, TREE = 3, 5, 6, 7, 15
HOLE = {2: 32766, 4: 2.0e38}
CODE = {1: "B", 2: "h", 4: "f"}


def single(value):
    """Return a number as single precision keeps it."""
    return struct.unpack("<f", struct.pack("<f", value))[0]


WAVELENGTH_NM = single(577.25)
PIXEL_MM = single(0.0015)
ASPECT = single(1.25)


def array(rows, n_bytes):
    """Return an array block of rows with the smallest y first: one column after the other."""
    flat = [
        HOLE.get(n_bytes) if row[i] is None else row[i]
        for i in range(len(rows[0]))
        for row in rows
    ]
    return struct.pack("<HHH", len(rows[0]), len(rows), n_bytes) + b"".join(
        struct.pack("<" + CODE[n_bytes], v) for v in flat
    )


def number(code, value):
    return struct.pack("<" + code, value)


def opd(blocks, *, spare=2):
    """Return a file with the given blocks (name, type, content) and some void entries."""
    n_entries = len(blocks) + 1 + spare
    head = struct.pack("<16shiH", b"Directory", 1, 24 * n_entries, 0xFFFF)
    head += b"".join(
        struct.pack("<16shiH", name, kind, len(content), 8) for name, kind, content in blocks
    )
    head += bytes(24 * spare)
    return b"\x01\0" + head + b"".join(content for _, _, content in blocks)


def scales(*, mult=None, aspect=ASPECT, pixel=PIXEL_MM, wavelength=WAVELENGTH_NM):
    """Return the blocks with scales; None leaves one out."""
    blocks = [
        (b"Wavelength", FLOAT, "f", wavelength),
        (b"Mult", SHORT, "h", mult),
        (b"Aspect", FLOAT, "f", aspect),
        (b"Pixel_size", FLOAT, "f", pixel),
    ]
    return [(n, kind, number(code, v)) for n, kind, code, v in blocks if v is not None]


def expected(rows, *, mult=1, aspect=ASPECT, pixel=PIXEL_MM, **more):
    factor = WAVELENGTH_NM * 1e-9 / mult
    z = [[None if v is None else v * factor for v in row] for row in rows]
    dx = pixel and pixel * 1e-3
    return {
        "kind": "surface",
        "shape": [len(z), len(z[0])],
        "dx_m": dx,
        "dy_m": dx and dx * aspect,
        "z_m": z,
        **more,
    }


# smallest y first; the largest value in the last column of row 0: no mirror image looks the same
COUNTS = [[-5, 6, 7, 30000], [1, 2, -3, 4], [None, 10, 20, 900]]
WAVES = [[None if v is None else v / 64 for v in row] for row in COUNTS]
OTHER = [[2 * v if v else 1 for v in row] for row in COUNTS[:2]]
OTHER[0][3] = 11
NOTES = [
    (b"Title", TEXT, b"planted bump 5 \xb5m\0"),
    (b"DataKind", TREE, b"\x12\x01\x0eSurface Height"),
    (b"Time", TEXT, b"16:19:48"),
]


def main(folder):
    for part in ("samples", "expected"):
        (folder / part).mkdir(parents=True, exist_ok=True)
    image = (b"Image", ARRAY, array([[1, 2, 3, 4]] * 3, 1))
    raw = (b"RAW_DATA", ARRAY, array(COUNTS, 2))
    files = {
        "int16.opd": (opd([*scales(mult=4), raw, *NOTES]), expected(COUNTS, mult=4)),
        "float.opd": (
            opd([*NOTES, (b"Raw", ARRAY, array(WAVES, 4)), image, *scales()]),
            expected(WAVES),
        ),
        "two-maps.opd": (
            opd([*scales(mult=4), raw, (b"SAMPLE_DATA", ARRAY, array(OTHER, 2))]),
            expected(OTHER, mult=4, options={"channel": "SAMPLE_DATA"}),
        ),
        "uncalibrated.opd": (
            opd([*scales(mult=4, pixel=0.0), raw]),
            expected(COUNTS, mult=4, pixel=None),
        ),
        "no-aspect.opd": (
            opd([*scales(mult=4, aspect=None), raw]),
            expected(COUNTS, mult=4, aspect=1.0, warnings_match="Aspect is missing"),
        ),
    }
    whole = files["int16.opd"][0]
    damaged = {
        "cut-off.opd": (whole[:-9], "does not fit"),
        "no-wavelength.opd": (opd([*scales(wavelength=None), raw]), "Wavelength"),
        "image-only.opd": (opd([*scales(), image]), "no map of heights"),
    }
    for name, (data, match) in damaged.items():
        files[name] = (data, {"error": "CorruptFileError", "match": match})
    files["image-only.opd"][1]["error"] = "UnsupportedFeatureError"
    for name, (data, truth) in files.items():
        (folder / "samples" / name).write_bytes(data)
        text = json.dumps(truth, indent=1, sort_keys=True) + "\n"
        (folder / "expected" / f"{name}.json").write_text(text, encoding="utf-8")


if __name__ == "__main__":
    main(Path(sys.argv[1]) if len(sys.argv) > 1 else Path(__file__).parent)
