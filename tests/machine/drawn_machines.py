"""Machines as drawings: bodies that quaternions turn, from the bed to the tool and from the bed to the work.

The numbers of each machine are written here by hand, without its chain. An instrument is two points or two
directions on the last bodies, and a bar is as long as the points are apart.
"""

from __future__ import annotations

import math

import numpy as np

E = dict(zip("xyz", np.eye(3), strict=True))
PIVOT, RADIUS = 0.08, 0.02

# Bodies from the bed outwards: axis, kind, way of the body, where its errors are read (a point of the
# body before it, or "rides": of the body itself), sense (+1: the errors are those of the body, -1: of the
# tool against the work, so the body does the opposite), and for each lean of a slide the way the tool goes
# against the work for a positive travel.
DRAWINGS = {
    "mill_xyz": {
        "tool": [("Z", "slide", E["z"], "rides", 1, {"A0Z": -E["y"], "B0Z": E["x"]})],
        "work": [
            ("Y", "slide", -E["y"], (0, 0, 0), -1, {"C0Y": -E["x"]}),
            ("X", "slide", -E["x"], (0, 0, 0), -1, {}),
        ],
        "travel": {"X": (-0.1, 0.4), "Y": (-0.05, 0.35), "Z": (0.0, 0.3)},
    },
    "five_axis": {
        "tool": [
            ("X", "slide", E["x"], "rides", 1, {}),
            ("Z", "slide", E["z"], "rides", 1, {"A0Z": -E["y"], "B0Z": E["x"]}),
        ],
        "work": [
            ("Y", "slide", -E["y"], (0, 0, 0), -1, {"C0Y": -E["x"]}),
            ("A", "turn", -E["x"], (0, 0, 0), -1, {"Y0A": E["y"], "Z0A": E["z"], "B0A": E["y"], "C0A": E["z"]}),
            ("C", "turn", -E["z"], (0, 0, PIVOT), -1, {"X0C": E["x"], "Y0C": E["y"], "A0C": E["x"], "B0C": E["y"]}),
        ],
        "travel": {"X": (-0.2, 0.2), "Y": (-0.2, 0.2), "Z": (-0.1, 0.35), "A": (math.radians(-95), math.radians(30)), "C": None},
    },
    "sts_lathe": {
        "tool": [("Z", "slide", E["z"], "rides", 1, {})],
        "work": [
            ("X", "slide", -E["x"], (0, 0, 0), -1, {"B0Z": E["z"]}),
            ("C", "turn", E["z"], (0, 0, 0), 1, {"A0C": E["x"], "B0C": E["y"]}),
        ],
        "travel": {"X": (-0.05, 0.1), "Z": (-0.02, 0.08), "C": None},
    },
    "fts_lathe": {  # the paper's X runs to the centre; its spindle errors turn with the spindle
        "tool": [
            ("Z", "slide", E["z"], "rides", 1, {}),
            ("X", "slide", -E["x"], "rides", 1, {"B0Z": -E["z"]}),
            ("FTS", "slide", E["z"], "rides", 1, {}),
        ],
        "work": [("C", "turn", E["z"], "rides", 1, {})],
        "travel": {"X": (-0.01, 0.03), "Z": (-0.02, 0.05), "FTS": (-2e-3, 3e-3), "C": None},
    },
}  # fmt: skip
STARTS = {("fts_lathe", "X"): RADIUS * E["x"], ("five_axis", "C"): PIVOT * E["z"]}


# ---- bodies ----------------------------------------------------------------------------------------


def turn(v, w):
    """Turn points v by rotation vectors w, by quaternions."""
    v, w = np.broadcast_arrays(np.asarray(v, dtype=float), np.asarray(w, dtype=float))
    angle = np.linalg.norm(w, axis=-1, keepdims=True)
    s = np.where(angle > 0, np.sin(angle / 2) / np.where(angle > 0, angle, 1.0), 0.5)
    c, r = np.cos(angle / 2), s * w
    return v + 2.0 * np.cross(r, np.cross(r, v) + c * v)


class Machine:
    """A drawing with errors, and where a point of its last bodies is on the bed."""

    def __init__(self, name, rng, *, endless=False):
        self.name, self.drawing, self.endless = name, DRAWINGS[name], endless
        self.motions, self.lines = {}, {}
        for axis, kind, way, _, _, lines in self.bodies():
            for d in "XYZABC":
                self.motions[f"E{d}{axis}"] = self.motion(d, axis, kind, way, rng)
            self.lines |= {n: rng.normal() * 4e-6 for n in lines}

    def bodies(self):
        return [*self.drawing["tool"], *self.drawing["work"]]

    def motion(self, d, axis, kind, way, rng):
        """A motion of 1 um or 2 urad that no place and no lean of its axis could be.

        It ends at order 4 or harmonic 3, or goes on, smaller with the square of the order.
        """
        along = "XYZ"[int(np.argmax(np.abs(way)))]
        own = d in (along, dict(zip("XYZ", "ABC", strict=True))[along])
        size = 1e-6 if d in "XYZ" else 2e-6
        if self.drawing["travel"][axis] is None:  # a full turn
            n = np.arange(1 if own else 2, 13 if self.endless else 4)
            a, b = size * rng.normal(size=(2, n.size)) * (self.fall(n) if self.endless else 1.0)
            return lambda q: (
                np.cos(np.multiply.outer(q, n)) @ a + np.sin(np.multiply.outer(q, n)) @ b
            )
        low, high = self.drawing["travel"][axis]
        first = {"slide": 2 if d in "XYZ" and not own else 1, "turn": 1 if own else 3}[kind]
        c = np.zeros(13 if self.endless else 5)
        c[first:] = size * rng.normal(size=c.size - first)
        if self.endless:
            c[first:] *= self.fall(np.arange(first, c.size))
        bow = np.polynomial.Legendre(c, domain=(low, high))
        if kind == "slide":
            return lambda q: bow(q) - bow(0.0)
        # part of a turn: free of what an axis does that stands, or points, elsewhere
        x, w = np.polynomial.legendre.leggauss(40)
        x = (low + high + (high - low) * x) / 2

        def still(q):
            return np.stack([np.ones_like(q)] + ([] if own else [np.cos(q), np.sin(q)]), axis=-1)

        M = still(x)
        part = np.linalg.solve(M.T @ (w[:, None] * M), M.T @ (w * bow(x)))
        return lambda q: bow(q) - still(q) @ part

    @staticmethod
    def fall(n):
        """Sizes over the orders of a motion that goes on: bends of a guide, lobes of a bearing."""
        return (n[0] / n) ** 2.0

    def outwards(self, side, q, wrong):
        """Return what takes a point of the last body of a side to the bed: steps from the outside in."""
        n = next(iter(q.values())).size
        steps = []
        for axis, kind, way, where, sense, lines in self.drawing[side]:
            s = q[axis][:, None]
            e = np.stack([self.motions[f"E{d}{axis}"](q[axis]) for d in "XYZABC"], axis=1)
            e = sense * e * wrong
            start = np.asarray(STARTS.get((self.name, axis), np.zeros(3)))
            lean = sum((wrong * self.lines[t] * v for t, v in lines.items()), np.zeros(3))
            if kind == "slide":
                # the leans are those of the tool against the work; a body of the work goes the other way
                move = (None, start + s * (way + (lean if side == "tool" else -lean)))
            else:
                shift = sum(
                    (wrong * self.lines[t] * v for t, v in lines.items() if t[0] in "XYZ"),
                    np.zeros(3),
                )
                tilt = sum(
                    (wrong * self.lines[t] * v for t, v in lines.items() if t[0] in "ABC"),
                    np.zeros(3),
                )
                move = (s * way, start + shift, tilt)
            error = (e[:, 3:], e[:, :3])
            steps.append((kind, where, move, error, n))
        return steps[::-1]

    def place(self, side, q, v, *, wrong=1.0, free=False):
        """Where a point of the last body (or, with `free`, a direction) is on the bed."""
        v = np.broadcast_to(np.asarray(v, dtype=float), (next(iter(q.values())).size, 3))
        for kind, where, move, (w, d), _ in self.outwards(side, q, wrong):
            if isinstance(where, str):  # read on the body itself, at its own zero
                v = turn(v, w) if free else turn(v, w) + d
            if kind == "slide":
                v = v if free else v + move[1]
            else:
                about, start, tilt = move
                v = turn(turn(v, about), np.broadcast_to(tilt, v.shape))
                v = v if free else v + start
            if not isinstance(where, str):
                at = np.asarray(where, dtype=float)
                v = turn(v, w) if free else at + turn(v - at, w) + d
        return v

    def on_work(self, q, p, *, wrong=1.0, free=False):
        """Where a point (or direction) of the bed is for one who stands on the work: the way back."""
        axes = [self.place("work", q, e, wrong=wrong, free=True) for e in np.eye(3)]
        p = p if free else p - self.place("work", q, np.zeros(3), wrong=wrong)
        return np.stack([np.sum(a * p, axis=1) for a in axes], axis=1)

    def tool_on_work(self, q, t, *, wrong=1.0):
        return self.on_work(q, self.place("tool", q, t, wrong=wrong), wrong=wrong)

    def missed(self, q, t):
        """By what the tool misses the work, in the directions of the bed."""
        off = self.tool_on_work(q, t) - self.tool_on_work(q, t, wrong=0.0)
        return self.place("work", q, off, wrong=0.0, free=True)

    def turned(self, q):
        """By which small turn the tool misses the work, in the directions of the bed."""
        found = np.zeros((next(iter(q.values())).size, 3))
        for e in np.eye(3):
            was, now = (
                self.on_work(q, self.place("tool", q, e, wrong=k, free=True), wrong=k, free=True)
                for k in (0.0, 1.0)
            )
            found += 0.5 * np.cross(was, now)
        return self.place("work", q, found, wrong=0.0, free=True)

    def follow(self, point, t, q):
        """Move the slides until the nominal tool stands at points of the work (linear in them)."""
        slides = [a for a in "XYZ" if a in self.drawing["travel"]]
        here = {a: q.get(a, np.zeros(len(point))) for a in self.drawing["travel"]}
        base = self.tool_on_work(here, t, wrong=0.0)
        J = np.stack(
            [self.tool_on_work({**here, a: here[a] + 1.0}, t, wrong=0.0) - base for a in slides],
            axis=2,
        )
        steps = [
            np.linalg.lstsq(j, r, rcond=None)[0] for j, r in zip(J, point - base, strict=True)
        ]
        return here | {a: here[a] + v for a, v in zip(slides, np.transpose(steps), strict=True)}


def draw(machine, axis, n, rng):
    """Places of one axis, ends and zero among them."""
    travel = machine.drawing["travel"][axis]
    if travel is None:
        return np.arange(n) * 2 * np.pi / n
    low, high = travel
    return np.sort(np.r_[0.0, low, high, rng.uniform(low, high, n - 3)])


def unit(rng):
    v = rng.normal(size=3)
    return v / np.linalg.norm(v)
