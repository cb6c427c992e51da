"""Write the samples of the Etalon exchange format as plain text; metrosep is not imported.

Run ``python make_samples.py [FOLDER]``; without a folder the files beside this script are written.
"""

import json
import sys
from pathlib import Path

X = [-280.0, -270.0, -255.5, 10.0]  # mm
EXY = [-0.001358635132, -0.000240680764, 0.000877273605, 0.00125]  # mm
EAX = [0.000022355737, -0.0000125, 0.0, 0.000003]  # rad


def table(name, errors, end):
    rows = [f"          {x!r} {e:.12f}" for x, e in zip(X, errors, strict=True)]
    return [f"[{name}]", "Gridpoints = {", *rows, f"}}  // end of {name}{end}"]


def text(*parts):
    return "\r\n".join(["// machine 7, variant Vendor", *(s for p in parts for s in p)]) + "\r\n"


CONSTANT = ["[C0B]", "VALUE = 0.000022355737"]
ONE = text(CONSTANT, table("EXY", EXY, ""), table("EAX", EAX, ""))
TWO = text(table("EYX", EXY[::-1], ""), ["[INFO]", "Serial = 12"], table("EXY", EXY, " (again)"))
PROFILE = {
    "kind": "profile",
    "shape": [4],
    "x_m": [x * 1e-3 for x in X],
    "z_m": [e * 1e-3 for e in EXY],
}
CASES = {
    "one-length.txt": (ONE, PROFILE),
    "two-lengths.txt": (TWO, {**PROFILE, "options": {"channel": "EXY"}}),
    "several.txt": (TWO, {"error": "FormatMismatchError", "match": "EYX, EXY"}),
    "angles.txt": (
        text(CONSTANT, table("EAX", EAX, "")),
        {"error": "FormatMismatchError", "match": "no length term"},
    ),
    "cut-off.txt": (
        ONE[: ONE.index("}  // end of EXY")],
        {"error": "CorruptFileError", "match": "table of EXY has no end"},
    ),
    "half-row.txt": (
        ONE.replace(" 0.001250000000", ""),
        {"error": "CorruptFileError", "match": "a position and an error of EXY"},
    ),
}


def main(folder):
    for part in ("samples", "expected"):
        (folder / part).mkdir(parents=True, exist_ok=True)
    for name, (content, truth) in CASES.items():
        (folder / "samples" / name).write_bytes(content.encode())
        record = json.dumps(truth, indent=1, sort_keys=True) + "\n"
        (folder / "expected" / f"{name}.json").write_text(record, encoding="utf-8")


if __name__ == "__main__":
    main(Path(sys.argv[1]) if len(sys.argv) > 1 else Path(__file__).parent)
