"""Write the samples of Mx slice exports with plain text; metrosep is not imported.

Run ``python make_samples.py [FOLDER]``; without a folder the files beside this script are written.
"""

import json
import sys
from pathlib import Path

# x and y in um, no symmetry; None = not measured
FIRST = [(0.871, None), (1.742, 0.01), (2.613, -0.5), (3.484, 0.02), (4.355, None)]
SECOND = [(0.5, 0.3), (1.0, None), (1.5, -0.25)]


def rows(points, name, end):
    return "".join(f"{x!r:<17},{'' if y is None else repr(y):<21},{name}{end}" for x, y in points)


def export(slices, end="\n"):
    head = f"{'X':<17},{'Y':<21},Slice{end}"
    return (head + "".join(rows(points, name, end) for name, points in slices)).encode("ascii")


def truth(points, fx=1e-6, fz=1e-6, **more):
    x = [p[0] * fx for p in points]
    z = [None if p[1] is None else p[1] * fz for p in points]
    return {"kind": "profile", "shape": [len(x)], "x_m": x, "z_m": z, **more}


def samples():
    """Yield name, bytes and expectation."""
    assumed = {"warnings_match": "taken as um"}
    yield "one-slice.csv", export([("Slice 2", FIRST)]), truth(FIRST, **assumed)
    both = export([("Slice 1", FIRST), ("Slice 2", SECOND)], end="\r\n")
    yield "two-slices.csv", both, truth(FIRST, warnings_match="also holds 'Slice 2'")
    chosen = {"options": {"channel": "slice 2"}}
    yield "second-slice.csv", both, truth(SECOND, **chosen)
    units = {"options": {"unit": ["mm", "nm"]}}
    yield "declared-units.csv", export([("Slice 1", FIRST)]), truth(FIRST, 1e-3, 1e-9, **units)
    corrupt = {"error": "CorruptFileError"}
    cut = export([("Slice 1", FIRST)])[:-20]
    yield "cut-off.csv", cut, {**corrupt, "match": "a row does not fit"}
    nothing = [(x, None) for x, _ in FIRST]
    empty = export([("Slice 1", nothing)])
    yield "nothing-measured.csv", empty, {**corrupt, "match": "no point was measured"}
    odd = export([("Slice 1", FIRST)]).replace(b"-0.5", b"-0,5")
    yield "decimal-comma.csv", odd, {**corrupt, "match": "a row does not fit"}


def main(folder):
    for part in ("samples", "expected"):
        (folder / part).mkdir(parents=True, exist_ok=True)
    for name, data, expected in samples():
        (folder / "samples" / name).write_bytes(data)
        text = json.dumps(expected, indent=1, sort_keys=True, allow_nan=False) + "\n"
        (folder / "expected" / f"{name}.json").write_text(text, encoding="utf-8")


if __name__ == "__main__":
    main(Path(sys.argv[1]) if len(sys.argv) > 1 else Path(__file__).parent)
