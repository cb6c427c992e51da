"""Write the samples of Zygo XYZ files with plain text; metrosep is not imported.

Run ``python make_samples.py [FOLDER]``; without a folder the files beside this script are written.
"""

import json
import sys
from pathlib import Path

X0, Y0 = 340, 638  # window in the frame of the camera
LATERAL = 2.5e-06

# camera rows from the top, in um; None = No Data: no mirror image looks the same
ROWS = [
    [0.9, 0.01, 0.02, None],
    [0.001, 0.002, 0.003, 0.004],
    [-0.005, -0.006, -0.007, 0.8],
]


def points(rows):
    return [(X0 + c, Y0 + r, v) for r, row in enumerate(rows) for c, v in enumerate(row)]


def zygo(listed, *, size=(4, 3), lateral=0, end="\r\n", closing=True, extra=("0",), version=1):
    lines = [
        f"Zygo XYZ Data File - Format {version}",
        '3 9 0 10 "Sat Jan  3 00:00:00 2026"',
        "0 0 0 0 0 0",
        f"{X0} {Y0} {size[0]} {size[1]}",
        '"planted bump, top left"',
        '"S1"',
        '"P1"',
        f"0 0.5 6.328e-07 0.5 1 0 {lateral:g} 1767398400",
        '1200 1200 3 2 0 666666 0 "2.5X"',
        "0 0 1 33 0 0 0.1 60.4318 2 50",
        "1 1 100 0 0 0 0 0 0 0",
        '0 ""',
        "1 5 0",
        *extra,
        "#",
    ]
    lines += [f"{x} {y} {'No Data' if v is None else v}" for x, y, v in listed]
    lines += ["#"] if closing else []
    return (end.join(lines) + end).encode("latin-1")


def truth(rows, *, lateral=None, factor=1e-6, options=(), **more):
    z = [[None if v is None else v * factor for v in row] for row in reversed(rows)]
    shape = [len(rows), len(rows[0])]
    return {"kind": "surface", "shape": shape, "dx_m": lateral, "dy_m": lateral, "z_m": z,
            "options": {"row_order": "top row first", **dict(options)}, **more}  # fmt: skip


def samples():
    """Yield name, bytes and expectation."""
    whole = points(ROWS)
    assumed = {"warnings_match": "taken as um"}
    yield "uncalibrated.xyz", zygo(whole), truth(ROWS, **assumed)
    yield "calibrated.xyz", zygo(whole, lateral=LATERAL, end="\n"), truth(ROWS, lateral=LATERAL)
    yield "rows-from-below.xyz", zygo(whole[8:] + whole[4:8] + whole[:4]), truth(ROWS)
    yield "thirteen-lines.xyz", zygo(whole, extra=()), truth(ROWS)
    metres = truth(ROWS, factor=1e-9, options={"unit": "nm"})
    yield "declared-nm.xyz", zygo(whole), metres
    gap = [
        [None if (r, c) == (1, 2) else v for c, v in enumerate(row)] for r, row in enumerate(ROWS)
    ]
    listed = [p for p in whole if p[:2] != (X0 + 2, Y0 + 1)]
    yield "not-all-listed.xyz", zygo(listed), truth(gap, warnings_match="1 pixels of the window")
    corrupt = {"error": "CorruptFileError"}
    yield "cut-off.xyz", zygo(whole)[:-25], {**corrupt, "match": "cut off"}
    twice = [*whole[:-1], whole[0]]
    yield "twice.xyz", zygo(twice), {**corrupt, "match": "same pixel"}
    outside = [*whole[:-1], (X0 + 4, Y0, 0.1)]
    yield "outside.xyz", zygo(outside), {**corrupt, "match": "outside of the window"}
    nothing = [(x, y, None) for x, y, _ in whole]
    yield "no-valid-pixel.xyz", zygo(nothing), {**corrupt, "match": "no point was measured"}
    wide = zygo(whole, size=(40000, 40000))
    claim = {"error": "UnsupportedFeatureError", "match": "40000 x 40000"}
    yield "absurd-size.xyz", wide, claim


def main(folder):
    for part in ("samples", "expected"):
        (folder / part).mkdir(parents=True, exist_ok=True)
    for name, data, expected in samples():
        (folder / "samples" / name).write_bytes(data)
        text = json.dumps(expected, indent=1, sort_keys=True, allow_nan=False) + "\n"
        (folder / "expected" / f"{name}.json").write_text(text, encoding="utf-8")


if __name__ == "__main__":
    main(Path(sys.argv[1]) if len(sys.argv) > 1 else Path(__file__).parent)
