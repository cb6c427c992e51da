"""A mill with a table that moves along X and Y, and a spindle along Z, as bodies that turn and shift.

No library code. `Mill.point` returns where a point of the tool really stands against the work: the tool on
the slide of Z, the slide against the saddle of Y, the saddle against the table of X, each a body with three
shifts and three turns (true rotations). Errors are actual minus nominal, of the tool against the work.
"""

import numpy as np

SPAN = (0.4, 0.3, 0.25)  # m
SQUARE = {"C0Y": 14e-6, "B0Z": -9e-6, "A0Z": 6e-6}


def turn(a, b, c):
    """Rotation by a vector of small turns about X, Y and Z, exact."""
    v = np.array([a, b, c])
    angle = np.linalg.norm(v)
    if angle == 0.0:
        return np.eye(3)
    k = np.array([[0, -v[2], v[1]], [v[2], 0, -v[0]], [-v[1], v[0], 0]]) / angle
    return np.eye(3) + np.sin(angle) * k + (1 - np.cos(angle)) * k @ k


def motions(axis, q):
    """Shifts and turns of one axis at a position, zero at home: no polynomials."""
    s = q / SPAN["XYZ".index(axis)]
    pi = np.pi
    if axis == "X":
        shift = (
            7e-6 * s + 0.8e-6 * np.sin(2 * pi * s),
            2e-6 * np.sin(pi * s),
            -1.5e-6 * np.sin(pi * s) ** 2,
        )
        turns = -6e-6 * s**2, 9e-6 * np.sin(0.5 * pi * s), 5e-6 * np.sin(pi * s)
    elif axis == "Y":
        shift = -1.2e-6 * np.sin(pi * s), -5e-6 * s, 2.2e-6 * np.sin(pi * s)
        turns = 7e-6 * s, -3e-6 * s**2, 4e-6 * np.sin(0.5 * pi * s)
    else:
        shift = 0.9e-6 * np.sin(pi * s), -1.1e-6 * np.sin(pi * s), 4e-6 * s**2
        turns = 3e-6 * s, -8e-6 * s, 2e-6 * s**2
    return np.array(shift), np.array(turns)


class Mill:
    """The machine; its squarenesses are those of the ways at home."""

    def __init__(self):
        self.ways = {
            "X": np.array([1.0, 0.0, 0.0]),
            "Y": np.array([-SQUARE["C0Y"], 1.0, 0.0]),
            "Z": np.array([SQUARE["B0Z"], -SQUARE["A0Z"], 1.0]),
        }

    def pose(self, x, y, z):
        """Turn and shift of the tool against the work: a point t of the tool stands at turn @ t + shift."""
        whole, place = np.eye(3), np.zeros(3)
        for axis, q in (("Z", z), ("Y", y), ("X", x)):
            shift, turns = motions(axis, q)
            body = turn(*turns)
            whole, place = body @ whole, body @ place + q * self.ways[axis] + shift
        return whole, place

    def point(self, place, tool=(0.0, 0.0, 0.0)):
        """Where a point of the tool stands in the coordinates of the work, m."""
        whole, shift = self.pose(*place)
        return whole @ np.asarray(tool) + shift
