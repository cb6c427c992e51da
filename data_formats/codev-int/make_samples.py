"""Write the samples of Code V interferograms with plain text; metrosep is not imported.

Run ``python make_samples.py [FOLDER]``; without a folder the files beside this script are written.
"""

import json
import sys
from pathlib import Path

NDA = -32768
# top row first, no symmetry
ROWS = [
    [9000, 10, 20, NDA],
    [1, 2, 3, 4],
    [-50, -60, -70, 32767],
]


def grid(rows, header, *, comments=("planted bump",), per_line=5, end="\n"):
    counts = [str(v) for row in rows for v in row]
    lines = [*(f"! {c}" for c in comments), "a title with GRD 2 2 in it", header]
    lines += [" " + " ".join(counts[i : i + per_line]) for i in range(0, len(counts), per_line)]
    return (end.join(lines) + end).encode("ascii")


def truth(rows, *, wavelength=0.6328, counts=65536.0, missing=NDA, **more):
    unit = wavelength * 1e-6 / counts
    z = [[None if v == missing else v * unit for v in row] for row in reversed(rows)]
    shape = [len(rows), len(rows[0])]
    return {"kind": "surface", "shape": shape, "dx_m": None, "dy_m": None, "z_m": z, **more}


def samples():
    """Yield name, bytes and expectation."""
    usual = "GRD 4 3 SUR WVL 0.6328 SSZ 65536.000000 NDA -32768"
    yield "surface.int", grid(ROWS, usual), truth(ROWS)
    mixed = "grd 4 3 nda -32768 ssz 1000 wfr nnb wvl 1.55"
    yield (
        "wavefront-lower-case.int",
        grid(ROWS, mixed, comments=(), per_line=12, end="\r\n"),
        truth(ROWS, wavelength=1.55, counts=1000.0),
    )
    inside = grid(ROWS, usual).replace(b" 2 3 4 ", b" 2 3 4\n! 99 in a comment\n")
    yield "comment-in-data.int", inside, truth(ROWS)
    no_marker = {"warnings_match": "declares no NDA", "missing": None}
    yield "no-nda.int", grid(ROWS, usual.replace(" NDA -32768", "")), truth(ROWS, **no_marker)
    steps = truth(ROWS, options={"lateral_step": [1e-5, 2e-5]}) | {"dx_m": 1e-5, "dy_m": 2e-5}
    yield "declared-step.int", grid(ROWS, usual), steps
    corrupt = {"error": "CorruptFileError"}
    zero = grid(ROWS, usual.replace("65536.000000", "0"))
    yield "ssz-zero.int", zero, {**corrupt, "match": "SSZ is not usable"}
    yield "wvl-zero.int", grid(ROWS, usual.replace("0.6328", "0")), {**corrupt, "match": "WVL"}
    yield "cut-off.int", grid(ROWS, usual)[:-12], {**corrupt, "match": "do not fill the grid"}
    nothing = grid([[NDA] * 4] * 3, usual)
    yield "no-valid-count.int", nothing, {**corrupt, "match": "no point was measured"}
    unsupported = {"error": "UnsupportedFeatureError"}
    yield "filter.int", grid(ROWS, usual.replace("SUR", "FIL")), {**unsupported, "match": "filter"}
    wide = grid(ROWS, usual.replace("4 3", "70000 70000"))
    yield "absurd-size.int", wide, {**unsupported, "match": "70000 x 70000"}


def main(folder):
    for part in ("samples", "expected"):
        (folder / part).mkdir(parents=True, exist_ok=True)
    for name, data, expected in samples():
        (folder / "samples" / name).write_bytes(data)
        text = json.dumps(expected, indent=1, sort_keys=True, allow_nan=False) + "\n"
        (folder / "expected" / f"{name}.json").write_text(text, encoding="utf-8")


if __name__ == "__main__":
    main(Path(sys.argv[1]) if len(sys.argv) > 1 else Path(__file__).parent)
