"""Readings of a nest and of a ballbar on a five-axis mill, drawn as bodies and lines in space.

No library code: a ball is turned about the lines of C and A as they really stand, the spindle
travels on axes that are not square, and the readings are the distances between both. Noise, drift
and a few bad readings are added. What was planted is in truth.csv.
"""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np

PIVOT = 0.08  # m, table above the axis of A
ERRORS_UM = {
    "Y0A": 9.0, "Z0A": -4.5, "B0A": 16.0, "C0A": -11.0, "X0C": 6.0, "Y0C": -7.0, "A0C": 12.0,
    "B0C": -14.0, "C0Y": 10.0, "B0Z": -6.0, "A0Z": 4.0,
}  # fmt: skip
BALLS = [(0.065, -0.02, 0.05), (-0.055, 0.05, 0.06), (0.01, 0.075, 0.11)]


def turned(axis, angle, v):
    """Turn v about an axis through the origin."""
    k = np.asarray(axis, dtype=float)
    k = k / np.linalg.norm(k)
    return v * np.cos(angle) + np.cross(k, v) * np.sin(angle) + k * (k @ v) * (1 - np.cos(angle))


def nest(rng, ball):
    """Places of all axes and three readings at each, tool against ball, m."""
    n = {name: value * 1e-6 for name, value in ERRORS_UM.items()}
    placed = np.add(ball, 40e-6 * rng.normal(size=3))  # a ball never stands where it should
    c_line = np.array([n["X0C"], n["Y0C"], PIVOT]), np.array([n["B0C"], -n["A0C"], 1.0])
    a_line = np.array([0.0, n["Y0A"], n["Z0A"]]), np.array([1.0, n["C0A"], -n["B0A"]])
    rows = []
    for a in np.radians(np.linspace(-90.0, 30.0, 5)):
        for c in np.radians(np.arange(0.0, 360.0, 30.0)):
            goal = turned((0, 0, 1), -c, np.array(ball)) + np.array([0, 0, PIVOT])
            x, y, z = turned((1, 0, 0), -a, goal)
            p = placed + np.array([n["X0C"], n["Y0C"], PIVOT])
            p = p + np.cross([n["A0C"], n["B0C"], 0.0], placed)
            p = c_line[0] + turned(c_line[1], -c, p - c_line[0])
            p = p - np.array([1.5e-6 * np.cos(3 * c), 0.0, 0.8e-6 * np.sin(c)])  # EXC, EZC
            p = p + np.array([0.0, n["Y0A"], n["Z0A"]]) + np.cross([0.0, n["B0A"], n["C0A"]], p)
            p = a_line[0] + turned(a_line[1], -a, p - a_line[0])
            p = p - y * np.array([-n["C0Y"], 1.0, 0.0])
            tool = np.array([x, 0.0, 0.0]) + z * np.array([n["B0Z"], -n["A0Z"], 1.0])
            rows.append([x, y, z, a, c, *(tool - p)])
    table = np.array(rows)
    drift = np.cumsum(rng.normal(size=(len(rows), 3)), axis=0) * 0.03e-6
    table[:, 5:] += 0.15e-6 * rng.normal(size=(len(rows), 3)) + drift
    bad = rng.choice(len(rows), 2, replace=False)
    table[bad, 5] += [7e-6, -9e-6]
    return table


def circle(rng):
    """Place, and deviation of a bar's length in both senses, from two slides with lags and play."""
    radius, feed = 0.1, 1.5 / 60
    places = np.arange(0.5, 360.0)
    runs = []
    for sense in (1.0, -1.0):
        w = sense * feed / radius
        t = np.radians(places) / w
        x = (
            radius * (1 + 15e-6) * np.cos(w * (t - 0.7e-3))
            + 0.5 * 1.4e-6 * np.sign(np.sin(w * t)) * sense
        )
        y = (
            radius * (1 - 5e-6) * np.sin(w * (t - 0.5e-3))
            - 0.5 * 0.8e-6 * np.sign(np.cos(w * t)) * sense
        )
        r = np.hypot(x - 10e-6 * y + 8e-6, y - 3e-6) - radius
        behind = np.mod(sense * np.radians(places), 2 * np.pi)
        r += 1.8e-6 * np.exp(-behind / np.radians(2.5)) + 0.1e-6 * rng.normal(size=places.size)
        runs.append(r)
    return places, *runs


def main(folder: Path) -> None:
    """Write all files."""
    rng = np.random.default_rng(20261128)
    for number, ball in enumerate(BALLS, 1):
        place = ", ".join(f"{v * 1e3:g} mm" for v in ball)
        head = [
            '# instrument = "nest"', f'# ball = "{place}"', '# unknown = ["ball"]',
            f'# name = "ball {number}"',
            "X_mm,Y_mm,Z_mm,A_deg,C_deg,reading_x_um,reading_y_um,reading_z_um",
        ]  # fmt: skip
        rows = [
            ",".join([*(f"{v * 1e3:.6f}" for v in r[:3]), *(f"{np.degrees(v):.4f}" for v in r[3:5]), *(f"{v * 1e6:.3f}" for v in r[5:])])
            for r in nest(rng, ball)
        ]  # fmt: skip
        (folder / f"ball_{number}.csv").write_text("\n".join([*head, *rows]) + "\n", "utf-8")
    rows = [f"{a:.1f},{f * 1e6:.3f},{b * 1e6:.3f}" for a, f, b in zip(*circle(rng), strict=True)]
    (folder / "circle.csv").write_text(
        "\n".join(["angle_deg,ccw_um,cw_um", *rows]) + "\n", "utf-8"
    )
    rows = [f"{name},{value}" for name, value in ERRORS_UM.items()]
    (folder / "truth.csv").write_text("\n".join(["term,um_or_urad", *rows]) + "\n", "utf-8")


if __name__ == "__main__":
    main(Path(sys.argv[1]) if len(sys.argv) > 1 else Path(__file__).parent)
