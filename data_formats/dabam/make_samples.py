"""Write the samples of DABAM entries as text; metrosep is not imported.

Run ``python make_samples.py [FOLDER]``; without a folder the files beside this script are written.
Whole entries are two files, so they stand in ``pairs/``; ``samples/`` holds those that are refused.
"""

import json
import sys
from pathlib import Path

HEIGHTS = [(-2.0, 5.0, 0.5), (-1.0, 7.0, -1.5), (0.0, -3.0, 2.0), (1.0, 11.0, 4.0)]
TITLES = {"PLOT_TITLE_Y1": "Height (um)", "PLOT_TITLE_Y2": "Slope (urad)"}


def entry(kind, *, n_header=1, x_factor=1e-3, factors=(1e-9,), **more):
    """Return the JSON of an entry."""
    keys = {"FILE_FORMAT": kind, "FILE_HEADER_LINES": n_header, "X1_FACTOR": x_factor}
    keys |= {f"Y{i}_FACTOR": f for i, f in enumerate(factors, start=1)}
    return json.dumps({**keys, "FACILITY": "none", **more}, indent=2) + "\n"


def columns(rows, header="x y", separator="\t", end="\n"):
    """Return the rows as text below a header."""
    lines = [header, *(separator.join(f"{v:g}" for v in row) for row in rows)]
    return end.join(lines) + end


def integrated(x, slopes):
    """Return heights by the trapezoid rule, one interval after the other."""
    z = [0.0]
    for k in range(1, len(x)):
        z.append(z[-1] + (slopes[k] + slopes[k - 1]) / 2 * (x[k] - x[k - 1]))
    return z


def profile(x, z, **options):
    return {"kind": "profile", "shape": [len(x)], "x_m": x, "z_m": z, "options": options}


X = [row[0] * 1e-3 for row in HEIGHTS]
Z = [row[1] * 1e-9 for row in HEIGHTS]
S = [row[2] * 1e-6 for row in HEIGHTS]
TWO = entry(2, factors=(1e-9, 1e-6), **TITLES)
FALLING = entry(1, n_header=3, factors=(1e-6,))
FALLING_ROWS = [(row[0], row[2]) for row in reversed(HEIGHTS)]
PAIRS = {
    "heights": (TWO, columns(HEIGHTS, "x(mm) height(nm) slope"), profile(X, Z)),
    "slopes-of-heights": (
        TWO,
        columns(HEIGHTS, separator=" "),
        profile(X, integrated(X, S), channel="Y2", slope="integrate"),
    ),
    "slopes": (
        FALLING,
        columns(FALLING_ROWS, "\nmade up\n4", end="\r\n"),
        profile(X, integrated(X[::-1], S[::-1])[::-1], slope="integrate"),
    ),
    "slopes-refused": (
        FALLING,
        columns(FALLING_ROWS, "\nmade up\n4"),
        {"error": "UnsupportedFeatureError", "match": "Y1 holds slopes (P-V 5.5 urad"},
    ),
    "ragged": (
        TWO,
        columns(HEIGHTS[:2]) + "0\t-3\n",
        {"error": "CorruptFileError", "match": "line 4, expected 3 numbers, found 2"},
    ),
}
ALONE = {
    "alone.txt": (TWO, "ReadError", "alone.dat, which does not lie beside it"),
    "cut-off.txt": (TWO[:-30], "CorruptFileError", "the JSON is damaged"),
    "other-format.txt": (entry(4), "UnsupportedFeatureError", "FILE_FORMAT is 4"),
    "zero-factor.txt": (entry(2, factors=(0.0,)), "CorruptFileError", "Y1_FACTOR"),
}


def main(folder):
    for part in ("samples", "expected", "pairs"):
        (folder / part).mkdir(parents=True, exist_ok=True)
    for name, (text, error, match) in ALONE.items():
        (folder / "samples" / name).write_bytes(text.encode())
        truth = json.dumps({"error": error, "match": match}, indent=1, sort_keys=True) + "\n"
        (folder / "expected" / f"{name}.json").write_text(truth, encoding="utf-8")
    for name, (text, rows, truth) in PAIRS.items():
        (folder / "pairs" / f"{name}.txt").write_bytes(text.encode())
        (folder / "pairs" / f"{name}.dat").write_bytes(rows.encode())
        (folder / "pairs" / f"{name}.json").write_text(
            json.dumps(truth, indent=1, sort_keys=True) + "\n", encoding="utf-8"
        )


if __name__ == "__main__":
    main(Path(sys.argv[1]) if len(sys.argv) > 1 else Path(__file__).parent)
