"""Write the samples of WSxM files with struct alone; metrosep is not imported.

Run ``python make_samples.py [FOLDER]``; without a folder the files beside this script are written.
"""

import json
import struct
import sys
from pathlib import Path

ROWS = [[0.5, -0.25, 3.5], [1.0, 0.0, -2.0]]  # the lowest row first, from left to right


def stp(code, rows, *, kind="double", amplitude="5.5 nm", extra="", wrong=0, columns=3):
    """Return a file: every row is stored from right to left."""
    body = (
        f"{extra}[Control]\r\n\r\n    X Amplitude: 6 nm\r\n    Y Amplitude: 10 Å\r\n\r\n[General Info]\r\n\r\n"
        f"    Image Data Type: {kind}\r\n    Number of columns: {columns}\r\n    Number of rows: 2\r\n"
        f"    Z Amplitude: {amplitude}\r\n\r\n[Header end]\r\n"
    )  # fmt: skip
    top = "WSxM file copyright UAM\r\nSxM Image file\r\nImage header size: %d\r\n"
    size = len(top % 999) + len(body.encode("latin-1"))
    data = b"".join(struct.pack(f"<3{code}", *reversed(row)) for row in rows)
    return (top % (size + wrong) + body).encode("latin-1") + data


def surface(factor, rows=ROWS):
    z = [[v * factor for v in row] for row in rows]
    return {"kind": "surface", "shape": [2, 3], "dx_m": 2e-9, "dy_m": 0.5e-9, "z_m": z}


COUNTS = [[0, -100, 900], [1, 2, 3]]
SPAN = "[Miscellaneous]\r\n    Maximum: 900\r\n    Minimum: -100\r\n"
LONG = "[A]\r\n" + "".join(f"    Remark {k}: x\r\n" for k in range(20))
CASES = {
    "double.stp": (stp("d", ROWS, extra=LONG), surface(1e-9)),
    "float-in-pm.stp": (stp("f", ROWS, kind="float", amplitude="5.5 pm", extra=LONG), surface(1e-12)),
    "counts.stp": (stp("h", COUNTS, kind="short", amplitude="2 nm", extra=LONG + SPAN),
                   surface(2e-9 / 1000, COUNTS)),
    "volts.stp": (stp("d", ROWS, amplitude="5.5 V", extra=LONG),
                  {"error": "CorruptFileError", "match": "Z Amplitude"}),
    "wrong-size.stp": (stp("d", ROWS, wrong=-9, extra=LONG),
                       {"error": "CorruptFileError", "match": "another length than it says"}),
    "cut-off.stp": (stp("d", ROWS, extra=LONG)[:-3],
                    {"error": "CorruptFileError", "match": "the map does not fit"}),
    "no-columns.stp": (stp("d", ROWS, columns=0, extra=LONG),
                       {"error": "CorruptFileError", "match": "Number of columns"}),
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
