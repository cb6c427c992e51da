"""Write the samples of BCR-STM files with struct and text; metrosep is not imported.

Run ``python make_samples.py [FOLDER]``; without a folder the files beside this script are written.
"""

import json
import struct
import sys
from pathlib import Path

LARGEST = struct.unpack("<f", b"\xff\xff\x7f\x7f")[0]
CHARACTERS = 600

# top row first, no symmetry; None = not measured
ROWS = [
    [900.0, 10.0, 20.0, None],
    [1.0, 2.0, 3.0, 4.0],
    [-5.0, -6.0, -7.0, 1000.0],
]


def bcr(kind, *, encoding="latin-1", order="<", characters=CHARACTERS, mark="", **more):
    fields = {
        "fileformat": kind,
        "headersize": characters,
        "xpixels": 4,
        "ypixels": 3,
        "xlength": 4000.0,
        "ylength": 6000.0,
        "voidpixels": 1,
        **more,
    }
    lines = [f"{k} = {v}" for k, v in fields.items() if v is not None]
    text = "\n".join([lines[0], "% a comment = 1", *lines[1:]]) + "\n"
    head = (mark + text).ljust(characters).encode(encoding)
    code, void = ("f", LARGEST) if "bcrf" in kind else ("h", 32767)
    raw = [void if v is None else v for row in ROWS for v in row]
    return head + struct.pack(f"{order}12{code}", *(raw if code == "f" else map(int, raw)))


def truth(scale, steps=(1e-6, 2e-6), **more):
    z = [[None if v is None else v * scale for v in row] for row in reversed(ROWS)]
    dx, dy = steps
    return {"kind": "surface", "shape": [3, 4], "dx_m": dx, "dy_m": dy, "z_m": z, **more}


def samples():
    """Yield name, bytes and expectation."""
    yield "integer.bcr", bcr("bcrstm", bit2nm=0.25), truth(0.25e-9)
    yield "old-header.bcr", bcr("bcrstm", characters=2048, headersize=None, bit2nm=2), truth(2e-9)
    big = bcr("bcrstm", order=">", bit2nm=0.25, intelmode=0)
    yield "big-endian.bcr", big, truth(0.25e-9)
    units = {"xunit": "um", "yunit": "nm", "zunit": "um", "xlength": 4.0}
    yield "float.bcrf", bcr("bcrf", **units), truth(1e-6)
    wide = bcr("bcrf_unicode", encoding="utf-16-le", zunit="nm")
    yield "unicode.bcrf", wide, truth(1e-9)
    none = truth(1e-9, (None, 2e-6), warnings_match="xlength is missing")
    yield "no-length.bcrf", bcr("bcrf", xlength=None), none
    both = bcr("bcrstm", bit2nm=0.25, zunit="um")
    yield "two-units.bcr", both, {"error": "UnitError", "match": "say which with unit="}
    yield "declared-unit.bcr", both, truth(0.25e-9, options={"unit": "nm"})
    corrupt = {"error": "CorruptFileError"}
    yield "cut-off.bcrf", bcr("bcrf")[:-3], {**corrupt, "match": "does not fit into the file"}
    yield "zero-scale.bcr", bcr("bcrstm", bit2nm=0), {**corrupt, "match": "bit2nm"}
    huge = {"error": "UnsupportedFeatureError", "match": "90000 x 90000"}
    yield "absurd-size.bcrf", bcr("bcrf", xpixels=90000, ypixels=90000), huge


def main(folder):
    for part in ("samples", "expected"):
        (folder / part).mkdir(parents=True, exist_ok=True)
    for name, data, expected in samples():
        (folder / "samples" / name).write_bytes(data)
        text = json.dumps(expected, indent=1, sort_keys=True, allow_nan=False) + "\n"
        (folder / "expected" / f"{name}.json").write_text(text, encoding="utf-8")


if __name__ == "__main__":
    main(Path(sys.argv[1]) if len(sys.argv) > 1 else Path(__file__).parent)
