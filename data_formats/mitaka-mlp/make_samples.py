"""Write the samples of MLP files as text; metrosep is not imported.

Run ``python make_samples.py [FOLDER]``; without a folder the files beside this script are written.
"""

import itertools
import json
import sys
from pathlib import Path

EDGE = [(-0.5, 1.0, -0.85), (-0.2, 1.625, -0.85), (0.125, 1.75, -0.85), (0.25, 1.5, -0.85)]
BACK = [*EDGE[:3], (0.0625, 1.7, -0.85), *EDGE[3:]]
AREA = [
    (x, y, 6.875 + step)
    for step, ys in ((0.0, (1.0, 2.0, 4.0)), (0.0009, (8.0, -16.0, 32.0)))
    for x, y in zip((-0.25, 0.0, 0.25), ys, strict=True)
]
RAGGED = [(x + 0.01 * (z > 6.8755), y, z) for x, y, z in AREA][:-1]


def row(point):
    return ",".join(f"{v:.6f}" for v in point)


def old(points, *, n_x, n_header=24):
    """Return a file of the old version, one line of points."""
    lines = [
        f"3D_003,{n_header}",
        r"FileName,C:\MLP_Data\edge.csv",
        "Type of measurement data,3D data in details.",
        f"Number of points in X direction,{n_x}",
        "Number of points in Y direction,1",
        "Max. in X direction,-1.000000",
        "Min. in X direction,1.750000",
        "Max. in Y direction,-0.850000",
        "Min. in Y direction,-0.850000",
        "Max. in Z direction,0.250000",
        "Min. in Z direction,-0.500000",
        "Ave. in Z direction,0.000000",
        "Data Name,made up",
        "Pitch,Tracing axis : ,0.001000,Stepping axis : ,0.000000",
        "Pitch(X Stage),Tracing axis : ,0.001000,Stepping axis : ,0.000000",
        "Range,Tracing axis : ,0.750000,Stepping axis : ,0.000000",
        "AF gain,2",
        "AF sensor,Wide",
        "Magnification,1.000000",
        "Objective lens,LM100X",
        "Laser offset,",
        "Divide code,NO",
        " ",
        "X,Y,Z",
    ]
    return "\n".join([*lines, *map(row, points)]) + "\n"


def new(points, *, shape):
    """Return a file of the new version."""
    lines = [
        "MLP-2 3D CSV",
        "Version,1.00",
        "Axis,Y,Z",
        "Pitch,0.250000,0.000900",
        "Range,0.500000,0.000900",
        f"Number of data,{shape[0]},{shape[1]}",
        f"Total number of data storage,{len(points)}    ",
        "AF gain,Standard",
        "AF sensor,Wide",
        "X,Y,Z",
    ]
    return "\n".join([*lines, *map(row, points)]) + "\n"


def mm(values):
    return [v * 1e-3 for v in values]


def profile(x, z, **more):
    return {"kind": "profile", "shape": [len(x)], "x_m": mm(x), "z_m": mm(z), **more}


def path(points):
    """Return the length along the points, and their heights."""
    s = [0.0]
    for (x0, y0, z0), (x1, y1, z1) in itertools.pairwise(points):
        s.append(s[-1] + ((x1 - x0) ** 2 + (y1 - y0) ** 2 + (z1 - z0) ** 2) ** 0.5)
    return s, [p[1] for p in points]


X, Z = [p[0] for p in EDGE], [p[1] for p in EDGE]
PLAIN = old(EDGE, n_x=6)
COUNTS = "declares 6 points and the file holds 4"
CASES = {
    "edge.csv": (PLAIN, profile(X, Z, warnings_match=COUNTS)),
    "falling.csv": (old(EDGE[::-1], n_x=4), profile(X, Z, warnings_match="Max. in X direction")),
    "columns.csv": (  # over Y the last point lies behind the one before it: three are left
        PLAIN,
        profile(Z[:3], X[:3], options={"x": "Y", "z": "X", "overhang": "drop"}),
    ),
    "turns-back.csv": (
        old(BACK, n_x=5),
        {
            "error": "FormatMismatchError",
            "match": "1 points turn back in X (the first near line 28)",
        },
    ),
    "dropped.csv": (old(BACK, n_x=5), profile(X, Z, options={"overhang": "drop"})),
    "path.csv": (old(BACK, n_x=5), profile(*path(BACK), options={"x": "path"})),
    "grid.csv": (
        new(AREA, shape=(3, 2)),
        {
            "kind": "surface",
            "shape": [2, 3],
            "dx_m": 0.25e-3,
            "dy_m": 0.9e-6,
            "z_m": [mm((1.0, 2.0, 4.0)), mm((8.0, -16.0, 32.0))],
            "origin_m": [-0.25e-3, 6.875e-3],
        },
    ),
    "lines.csv": (
        new(RAGGED, shape=(3, 2)),
        {"error": "FormatMismatchError", "match": "channel='line 1' ... channel='line 2'"},
    ),
    "second-line.csv": (
        new(RAGGED, shape=(3, 2)),
        profile(
            (-0.24, 0.01),
            (8.0, -16.0),
            options={"channel": "line 2"},
            warnings_match="declares 6 points and the file holds 5",
        ),
    ),
    "no-end-of-header.csv": (
        PLAIN.replace("X,Y,Z\n", ""),
        {"error": "CorruptFileError", "match": "the header has no end"},
    ),
    "cut-off.csv": (
        PLAIN[:-20],
        {"error": "CorruptFileError", "match": "line 28, expected 3 numbers, found 1"},
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
