"""Write the samples of ``.npy`` with struct alone; neither metrosep nor NumPy is imported.

Run ``python make_samples.py [FOLDER]``; without a folder the files beside this script are written.
"""

import json
import struct
import sys
from pathlib import Path

NAN = float("nan")
ROWS = [[1.0, 2.0, -3.0], [4.0, NAN, 60.0]]


def npy(values, *, code="d", descr="<f8", shape=(2, 3), fortran=False, version=1):
    text = repr({"descr": descr, "fortran_order": fortran, "shape": shape})
    start = 10 if version == 1 else 12
    text += " " * (-(start + len(text) + 1) % 64) + "\n"
    size = struct.pack("<H" if version == 1 else "<I", len(text))
    order = descr[0].replace("|", "<")
    body = struct.pack(order + code * len(values), *values)
    return b"\x93NUMPY" + bytes([version, 0]) + size + text.encode("latin-1") + body


def surface(factor, **more):
    z = [[None if v != v else v * factor for v in row] for row in ROWS]
    return {"kind": "surface", "shape": [2, 3], "dx_m": None, "dy_m": None, "z_m": z, **more}


BY_ROW = [v for row in ROWS for v in row]
BY_COLUMN = [row[i] for i in range(3) for row in ROWS]
CASES = {
    "rows.npy": (
        npy(BY_ROW),
        surface(1e-9, options={"unit": "nm"}, warnings_match="which row is on top"),
    ),
    "columns-big-endian.npy": (
        npy(BY_COLUMN, code="f", descr=">f4", fortran=True, version=2),
        surface(1e-6, options={"unit": "um"}),
    ),
    "recording.npy": (
        npy([5, -6, 7], code="h", descr="<i2", shape=(3,)),
        {
            "kind": "recording",
            "options": {"sampling_rate": "2 Hz", "unit": "um"},
            "t_s": [0.0, 0.5, 1.0],
            "channels": {"column1": [5e-6, -6e-6, 7e-6]},
        },
    ),
    "no-unit.npy": (npy(BY_ROW), {"error": "UnitError", "match": "declares no unit"}),
    "objects.npy": (
        npy([], descr="|O", shape=(0,)),
        {"error": "UnsupportedFeatureError", "match": "never, since that would run code"},
    ),
    "claims-more.npy": (
        npy(BY_ROW, shape=(20000, 3000)),
        {"error": "CorruptFileError", "match": "do not agree"},
    ),
}


def main(folder):
    for part in ("samples", "expected"):
        (folder / part).mkdir(parents=True, exist_ok=True)
    for name, (content, truth) in CASES.items():
        (folder / "samples" / name).write_bytes(content)
        encoded = json.dumps(truth, indent=1, sort_keys=True) + "\n"
        (folder / "expected" / f"{name}.json").write_text(encoded, encoding="utf-8", newline="\n")


if __name__ == "__main__":
    main(Path(sys.argv[1]) if len(sys.argv) > 1 else Path(__file__).parent)
