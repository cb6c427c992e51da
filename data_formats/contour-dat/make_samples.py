"""Write the samples of contour files as text; metrosep is not imported.

Run ``python make_samples.py [FOLDER]``; without a folder the files beside this script are written.
"""

import json
import sys
from pathlib import Path

POINTS = [(0.75, 5.5), (0.5, 5.25), (0.25, -1.0), (0.0, 8.0), (-0.25, 0.125)]


def contour(points, *, unit="mm", count=None, end="\n"):
    """Return a file with the given rows."""
    rows = [f"{x:23.15f},{z:23.15f}" for x, z in points]
    return end.join([unit, str(len(points) if count is None else count), *rows]) + end


def profile(points, factor, **more):
    """Return what a reader must give: positions rising."""
    rising = sorted(points)
    x, z = ([p[i] * factor for p in rising] for i in (0, 1))
    return {"kind": "profile", "shape": [len(rising)], "x_m": x, "z_m": z, **more}


WHOLE = contour(POINTS)
CASES = {
    "falling.dat": (WHOLE, profile(POINTS, 1e-3)),
    "rising-um.dat": (contour(POINTS[::-1], unit="um", end="\r\n"), profile(POINTS, 1e-6)),
    "count.dat": (
        contour(POINTS, count=12001),
        profile(POINTS, 1e-3, warnings_match="declares 12001 points and the file holds 5"),
    ),
    "cut-off.dat": (
        WHOLE[:-25],
        {"error": "CorruptFileError", "match": "line 7, expected 2 numbers, found 1"},
    ),
    "turns-back.dat": (
        contour([*POINTS, (0.3, 1.0)]),
        {"error": "CorruptFileError", "match": "not strictly monotonic"},
    ),
}


def main(folder):
    for part in ("samples", "expected"):
        (folder / part).mkdir(parents=True, exist_ok=True)
    for name, (text, truth) in CASES.items():
        (folder / "samples" / name).write_bytes(text.encode())
        (folder / "expected" / f"{name}.json").write_text(
            json.dumps(truth, indent=1, sort_keys=True) + "\n", encoding="utf-8"
        )


if __name__ == "__main__":
    main(Path(sys.argv[1]) if len(sys.argv) > 1 else Path(__file__).parent)
