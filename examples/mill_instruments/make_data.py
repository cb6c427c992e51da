"""What six instruments read on the mill of mill.py, one file for each set-up. No library code.

Run ``python make_data.py [FOLDER]``; without a folder the files beside this script are written.
"""

import sys
from pathlib import Path

import numpy as np
from mill import SPAN, SQUARE, Mill, motions

STATIONS = [(-0.35, -0.3, -0.2), (0.75, -0.25, -0.15), (0.15, 0.65, -0.25), (0.2, 0.1, 0.85)]
TOOLS = [(0.0, 0.0, -0.12), (0.09, 0.0, -0.12), (0.0, 0.08, -0.2), (0.0, 0.0, -0.12)]
PITCH = 0.03  # m, between both retroreflectors of the angular optics


def edge(x):
    """Height of the straightedge out of its surface, m: bent, with a dent."""
    return 1.8e-6 * np.cos(np.pi * x / 0.4) - 1.2e-6 * np.exp(-(((x - 0.31) / 0.03) ** 2))


def table(path, head, columns, rows):
    """Write the set-up as comments, the columns and the rows."""
    lines = [*(f"# {h}" for h in head), columns]
    lines += [",".join(f"{v:.4f}" for v in row) for row in rows]
    path.write_text("\n".join(lines) + "\n", "utf-8")


def indicator(folder, rng, mill):
    """Read a straightedge on the table from one side, and turned over from the other."""
    x = np.linspace(0.0, SPAN[0], 21)
    for name, side, askew in (("indicator_front", 1.0, 12e-6), ("indicator_back", -1.0, -7e-6)):
        gap = [side * mill.point((p, 0.0, 0.0))[1] for p in x]
        read = np.array(gap) + edge(x) + askew * x + 0.04e-6 * rng.normal(size=x.size)
        head = [
            'instrument = "displacement"', f'direction = "{"+" if side > 0 else "-"}Y"',
            'unknown = ["offset", "slope", "form"]', 'artefact = "straightedge"',
            'at = { Y = "0 mm", Z = "0 mm" }', f'name = "{name}"',
        ]  # fmt: skip
        table(
            folder / f"{name}.csv", head, "X_mm,reading_um", zip(x * 1e3, read * 1e6, strict=True)
        )


def level(folder, rng, mill):
    """Read two levels, on the spindle and on the table: the pitch of Y as their difference."""
    y = np.linspace(0.0, SPAN[1], 16)
    # a level shows how far its base has sunk at one end: the slope of a line that lay along Y
    slope = [np.arcsin((mill.pose(0.0, p, 0.0)[0] @ [0.0, 1.0, 0.0])[2]) for p in y]
    read = np.array(slope) + 0.15e-6 * rng.normal(size=y.size) + 3e-6
    head = [
        'instrument = "angle"', 'direction = "X"', 'unknown = ["offset"]',
        'at = { X = "0 mm", Z = "0 mm" }', 'name = "levels"',
    ]  # fmt: skip
    table(folder / "level.csv", head, "Y_mm,reading_urad", zip(y * 1e3, read * 1e6, strict=True))


def laser(folder, rng, mill):
    """Read linear optics at the tool point, and angular optics: two lengths, one above the other."""
    x = np.linspace(0.0, SPAN[0], 41)
    read = np.array([mill.point((p, 0.0, 0.0))[0] - p for p in x])
    read += 0.03e-6 * rng.normal(size=x.size)
    head = [
        'instrument = "displacement"', 'direction = "X"', 'unknown = ["offset"]',
        'at = { Y = "0 mm", Z = "0 mm" }', 'name = "laser, linear"',
    ]  # fmt: skip
    table(
        folder / "laser_linear.csv", head, "X_mm,reading_um", zip(x * 1e3, read * 1e6, strict=True)
    )
    both = [
        mill.point((p, 0.0, 0.0), (0.0, 0.0, PITCH))[0] - mill.point((p, 0.0, 0.0))[0] for p in x
    ]
    pitch = np.array(both) / PITCH + 0.2e-6 * rng.normal(size=x.size)
    head = [
        'instrument = "angle"', 'direction = "Y"', 'unknown = ["offset"]',
        'at = { Y = "0 mm", Z = "0 mm" }', 'name = "laser, angular"',
    ]  # fmt: skip
    table(
        folder / "laser_angular.csv",
        head,
        "X_mm,reading_urad",
        zip(x * 1e3, pitch * 1e6, strict=True),
    )


def ballbar(folder, rng, mill):
    """Run a bar of 100 mm round a ball on the table, in three planes: its length against nominal."""
    ball, tool, radius = np.array([0.2, 0.15, 0.0]), np.array([0.0, 0.0, -0.12]), 0.1
    off = np.array([5e-6, -3e-6, 2e-6])  # the ball does not stand where it should
    for plane, (i, j) in {"xy": (0, 1), "yz": (1, 2), "zx": (2, 0)}.items():
        a = np.radians(np.arange(0.0, 360.0 if plane == "xy" else 181.0, 6.0))
        if plane == "zx":
            a = a - np.pi / 2  # above the table only
        rows = []
        for angle in a:
            place = ball.copy()
            place[i] += radius * np.cos(angle)
            place[j] += radius * np.sin(angle)
            state = place - tool
            length = np.linalg.norm(mill.point(state, tool) - ball - off)
            rows.append([*(state * 1e3), (length - radius) * 1e6 + 0.05 * rng.normal()])
        head = [
            'instrument = "ballbar"', 'ball = "200 mm, 150 mm, 0 mm"', 'tool = "0 mm, 0 mm, -120 mm"',
            'unknown = ["ball", "length"]', f'name = "ballbar {plane}"',
        ]  # fmt: skip
        table(folder / f"ballbar_{plane}.csv", head, "X_mm,Y_mm,Z_mm,reading_um", rows)


def tracker(folder, rng, mill):
    """Read lengths from four stations to a reflector at three places of the tool, in the whole volume."""
    grid = [np.linspace(0.0, s, 5) for s in SPAN]
    places = [(x, y, z) for x in grid[0] for y in grid[1] for z in grid[2]]
    for n, (station, tool) in enumerate(zip(STATIONS, TOOLS, strict=True), 1):
        stands = np.array(station) + 1e-3 * rng.normal(size=3)  # known to a millimetre
        dead = 0.2 + 1e-4 * rng.normal()
        rows = []
        for place in places:
            length = np.linalg.norm(mill.point(place, tool) - stands) + dead
            rows.append([*(v * 1e3 for v in place), length * 1e3 + 0.15e-3 * rng.normal()])
        where, point = (", ".join(f"{v * 1e3:g} mm" for v in p) for p in (station, tool))
        head = [
            'instrument = "length"', f'station = "{where}"', 'dead_path = "200 mm"', f'tool = "{point}"',
            'unknown = ["station", "dead_path"]', "total = true", f'name = "station {n}"',
        ]  # fmt: skip
        lines = [*(f"# {h}" for h in head), "X_mm,Y_mm,Z_mm,reading_mm"]
        lines += [f"{x:g},{y:g},{z:g},{r:.6f}" for x, y, z, r in rows]
        (folder / f"tracker_{n}.csv").write_text("\n".join(lines) + "\n", "utf-8")


def main(folder):
    """Write all files."""
    rng, mill = np.random.default_rng(20261129), Mill()
    for make in (indicator, level, laser, ballbar, tracker):
        make(folder, rng, mill)
    rows = ["term,at_mm,um_or_urad", *(f"{n},,{v * 1e6:.3f}" for n, v in SQUARE.items())]
    for axis, span in zip("XYZ", SPAN, strict=True):
        for share in (0.25, 0.5, 0.75, 1.0):
            shift, turns = motions(axis, share * span)
            for letters, values in (("XYZ", shift), ("ABC", turns)):
                rows += [
                    f"E{d}{axis},{share * span * 1e3:g},{v * 1e6:.6f}"
                    for d, v in zip(letters, values, strict=True)
                ]
    (folder / "truth.csv").write_text("\n".join(rows) + "\n", "utf-8")


if __name__ == "__main__":
    main(Path(sys.argv[1]) if len(sys.argv) > 1 else Path(__file__).parent)
