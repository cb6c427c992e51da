"""How far u of a calibration may be trusted: machines drawn anew for each seed, read with 1 um of noise.

Balls stand where nobody knows (30 um from where they should), lasers have unknown zeros. Readings come from `drawn_machines` (bodies, lines and points in space) or, for a circle in motion,
from two slides with delays and play. What is asked: is the truth within 2 u as often as 2 u says (95.45 %)?
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field

import numpy as np
from machine.drawn_machines import PIVOT, Machine

from metrosep.machine import (
    Angle,
    Ballbar,
    Displacement,
    Nest,
    ReadingSet,
    calibrate,
    circle_test,
    presets,
)
from metrosep.machine._bases import CurveTerm

NOISE = 1e-6
BALLS = [(0.07, -0.03, 0.045), (-0.05, 0.06, 0.05), (0.02, 0.08, 0.11), (-0.06, -0.05, 0.09)]
TOOL = (0.02, -0.01, -0.06)
PLACES = 101
"""Of a curve over its travel, at which it is compared."""


@dataclass
class Rate:
    """Of one row: by number or curve the errors of all seeds and their u."""

    numbers: dict[str, list[tuple[float, float]]] = field(default_factory=dict)
    curves: dict[str, list[tuple[np.ndarray, np.ndarray]]] = field(default_factory=dict)
    bare: dict[str, list[tuple[np.ndarray, np.ndarray]]] = field(default_factory=dict)

    def add(self, name, off, u):
        """Note an error, or the errors along a curve."""
        into = self.numbers if np.ndim(off) == 0 else self.curves
        into.setdefault(name, []).append((off, u))

    @classmethod
    def joined(cls, rates):
        """Return the errors of several machines as one."""
        found = cls()
        for rate in rates:
            for into, more in zip(
                (found.numbers, found.curves, found.bare),
                (rate.numbers, rate.curves, rate.bare),
                strict=True,
            ):
                for name, listed in more.items():
                    into.setdefault(name, []).extend(listed)
        return found

    @classmethod
    def doubt(cls, listed):
        """Return the standard deviation of a mean share: what one machine says of its curves is alike."""
        shares = np.array([cls.of(one)[0] for one in listed])
        return float(np.std(shares) / math.sqrt(max(shares.size, 1)))

    @staticmethod
    def of(listed):
        """Return the share within 2 u, the worst name and its share, and the RMS of u over that of the errors."""
        most = max(map(len, listed.values()), default=0)
        # orders that few seeds asked for say little
        listed = {n: v for n, v in listed.items() if len(v) > most / 2}
        if not listed:
            return math.nan, "", math.nan, math.nan
        share = {
            n: float(np.mean([np.mean(np.abs(off) <= 2.0 * np.asarray(u)) for off, u in v]))
            for n, v in listed.items()
        }
        ratio = [
            math.sqrt(
                np.mean([np.mean(np.square(u)) for _, u in v])
                / np.mean([np.mean(np.square(off)) for off, _ in v])
            )
            for v in listed.values()
        ]
        worst = min(share, key=share.__getitem__)
        return float(np.mean([*share.values()])), worst, share[worst], float(np.median(ratio))


# ---- set-ups ---------------------------------------------------------------------------------------


def only(machine, axes, terms="XYZABC"):
    """Leave the lines and the motions of some axes wrong; all else is right."""
    for term in machine.motions:
        if term[2:] not in axes or term[1] not in terms:
            machine.motions[term] = np.zeros_like
    return machine


def turned_over(machine, ball, t, places=(6, 12), away=None):
    """Poses of cradle and table at which the tool stands at a ball, or away from it in bed directions."""
    a, c = np.meshgrid(
        np.radians(np.linspace(-95, 30, places[0])),
        np.arange(places[1]) * 2 * np.pi / places[1],
        indexing="ij",
    )
    turns = {"A": a.ravel(), "C": c.ravel()}
    points = np.tile(ball, (a.size, 1)).astype(float)
    if away is not None:
        still = {axis: np.zeros(a.size) for axis in "XYZ"}
        away = np.broadcast_to(away, points.shape)
        points = points + machine.on_work({**still, **turns}, away, wrong=0.0, free=True)
    return machine.follow(points, t, turns)


def placed(ball, rng):
    """Where a ball really stands."""
    return np.add(ball, 30e-6 * rng.normal(size=3))


def missed_ball(machine, q, real):
    """By what the tool misses a ball, bed directions."""
    off = machine.tool_on_work(q, TOOL) - real
    return machine.place("work", q, off, wrong=0.0, free=True)


def wander(rng, n, size, length):
    """Drift of a size that forgets itself over a number of readings."""
    found, keep = np.zeros(n), math.exp(-1.0 / length)
    found[0] = rng.normal()
    for i in range(1, n):
        found[i] = keep * found[i - 1] + math.sqrt(1.0 - keep**2) * rng.normal()
    return size * found


def r_test(rng, *, endless=False, drift=0.0):
    """Three balls in a nest, 72 poses each: 11 lines, 6 motions of the table."""
    machine, sets = only(Machine("five_axis", rng, endless=endless), "C"), []
    for ball in BALLS[:3]:
        q = turned_over(machine, ball, TOOL)
        values = missed_ball(machine, q, placed(ball, rng))
        values = values + NOISE * rng.normal(size=values.shape)
        if drift:
            values += np.stack([wander(rng, len(values), drift, 40.0) for _ in range(3)], axis=1)
        sets.append(ReadingSet(Nest(ball=ball), q, values, tool=TOOL, unknown=("ball",)))
    return machine, sets, "C"


def probed(rng, *, endless=False):
    """Four balls, a probe touches each five times in 40 poses: its centre is that of least squares."""
    machine, sets = only(Machine("five_axis", rng, endless=endless), "C"), []
    ways = np.array([(1, 0, 0), (-1, 0, 0), (0, 1, 0), (0, -1, 0), (0, 0, 1.0)])
    # touches p = c + (r + noise) way: centre and radius by least squares of the distances
    solve = np.linalg.pinv(np.column_stack([ways, np.ones(5)]))[:3]
    for ball in BALLS:
        q = turned_over(machine, ball, TOOL, (5, 8))
        centre = -missed_ball(machine, q, placed(ball, rng))
        touches = centre @ ways.T + NOISE * rng.normal(size=(len(centre), 5))
        of = Nest(ball=ball, senses="workpiece")
        sets.append(ReadingSet(of, q, touches @ solve.T, tool=TOOL, unknown=("ball",)))
    return machine, sets, "C"


def ballbar(rng, *, endless=False):
    """Three balls, a bar of known length along X, Y and Z of the machine (ISO 230-4, ISO 10791-6) in 40 poses."""
    machine, sets = only(Machine("five_axis", rng, endless=endless), "C"), []
    bar = 0.1
    for ball in BALLS[:3]:
        real = placed(ball, rng)
        for way in np.eye(3):
            q = turned_over(machine, ball, TOOL, (5, 8), away=bar * way)
            long = np.linalg.norm(machine.tool_on_work(q, TOOL) - real, axis=1)
            long += NOISE * rng.normal(size=long.size)
            sets.append(
                ReadingSet(Ballbar(ball=ball), q, long - bar, tool=TOOL, unknown=("ball",))
            )
    return machine, sets, "C"


def slides(rng, *, endless=False):
    """Laser, straightness and angles of one slide of a mill, 41 places there and back, zeros unknown."""
    axis = "XYZ"[rng.integers(3)]
    machine, sets = only(Machine("mill_xyz", rng, endless=endless), axis), []
    for way in (body[2] for body in machine.bodies() if body[0] == axis):
        low, high = machine.drawing["travel"][axis]
        there = np.linspace(low, high, 41)
        q = {a: np.zeros(82) for a in "XYZ"} | {axis: np.r_[there, there[::-1]]}
        for u in np.eye(3):
            values = machine.missed(q, TOOL) @ u + 5e-6 * rng.normal()
            unknown = ("offset",) if abs(way @ u) > 0.5 else ("offset", "slope")
            if "slope" in unknown:
                values += 20e-6 * rng.normal() * q[axis]
            values += NOISE * rng.normal(size=82)
            sets.append(
                ReadingSet(Displacement(direction=u), q, values, tool=TOOL, unknown=unknown)
            )
            values = machine.turned(q) @ u + NOISE * rng.normal(size=82) + 5e-6 * rng.normal()
            sets.append(ReadingSet(Angle(direction=u), q, values, tool=TOOL, unknown=("offset",)))
    return machine, sets, axis


GO_ON = ", motions go on"
ROWS = {
    "R-test": r_test,
    f"R-test{GO_ON}": r_test,
    f"probed sphere{GO_ON}": probed,
    f"ballbar on rotary axes{GO_ON}": ballbar,
    "laser, straightness, angles of a slide": slides,
    f"laser, straightness, angles of a slide{GO_ON}": slides,
    "R-test, drift of 2 um over 40 readings": lambda rng, **k: r_test(rng, drift=2e-6, **k),
}


def calibrated(name, seed, rate):
    """Add to a rate what one calibration of a row missed, and by which u."""
    rng = np.random.default_rng([seed, 27, [*ROWS].index(name)])
    machine, sets, axes = ROWS[name](rng, endless=name.endswith(GO_ON))
    options = {"pivot_height": PIVOT} if machine.name == "five_axis" else {}
    wanted = [f"E{d}{a}" for a in axes for d in "XYZABC"]
    if machine.name == "five_axis":  # lines of unknown slope say nothing of squareness
        wanted += machine.lines
    found = calibrate(presets(machine.name, **options), sets, terms=wanted)
    for term, value in found.errors.items():
        if term in machine.lines:
            if math.isfinite(value.value):
                rate.add(term, value.value - machine.lines[term], value.u)
            continue
        x = np.linspace(*(machine.drawing["travel"][term[2:]] or (0.0, 2 * np.pi)), PLACES)
        truth = machine.motions[term](x)
        off, u = value.evaluate(x) - truth, value.sd(x)
        if not np.isfinite(off).all():
            continue
        known = u > 0.0  # home is zero by definition
        rate.add(term, off[known], u[known])
        n = len(found.bases[term].labels)  # without what the orders leave out
        noise = CurveTerm(value.coefficients[:n], value.cov[:n, :n], found.bases[term]).sd(x)
        rate.bare.setdefault(term, []).append((off[known], noise[known]))
        basis = found.bases[term]
        mine = [i for i, n in enumerate(found.names) if n.split(" ")[0] == term]
        for i, true in zip(mine, coefficients(basis, machine.motions[term]), strict=True):
            u = math.sqrt(found.covariance[i, i])
            rate.add(found.names[i], found.coefficients[i] - true, u)
    return found


def coefficients(basis, motion):
    """Return what a motion holds of the shapes of a curve, by its integrals over them."""
    if basis.kind == "fourier":
        x = np.arange(72) * np.pi / 36
        return [float(motion(x) @ f(n * x)) / 36 for n in basis.orders for f in (np.cos, np.sin)]
    x, w = np.polynomial.legendre.leggauss(40)
    y = w * motion(0.5 * (basis.low + basis.high + (basis.high - basis.low) * x))
    P = np.polynomial.legendre.legvander(x, max(basis.orders))
    return [float(y @ P[:, n]) * (n + 0.5) for n in basis.orders]


def circle(seed, rate):
    """One circular test in motion: two slides, not square, of different scale, late and with play."""
    rng = np.random.default_rng([seed, 230])
    radius, feed = 0.1, 1.5 / 60
    square, scales = 12e-6 * rng.normal(), 10e-6 * rng.normal(size=2)
    late, play = 0.4e-3 * rng.normal(size=2), 1.5e-6 * rng.normal(size=2)
    centre, longer = 30e-6 * rng.normal(size=2), 10e-6 * rng.normal()
    places, runs = np.arange(0.5, 360.0), []
    for sense in (1.0, -1.0):
        w = sense * feed / radius
        t = np.radians(places) / w
        x = radius * (1 + scales[0]) * np.cos(w * (t - late[0]))
        y = radius * (1 + scales[1]) * np.sin(w * (t - late[1]))
        # short by half the play in the sense of travel
        x -= 0.5 * play[0] * np.sign(-w * np.sin(w * t))
        y -= 0.5 * play[1] * np.sign(w * np.cos(w * t))
        r = np.hypot(x - square * y + centre[0], y + centre[1]) - radius + longer
        runs.append(r + NOISE * rng.normal(size=r.size))
    found = circle_test(np.radians(places), *runs, radius=radius, feed=feed)
    for name, value, true in (
        ("C0Y", found.squareness, square),
        ("servo_mismatch", found.servo_mismatch, late[0] - late[1]),
        ("scale_mismatch", found.scale_mismatch, scales[0] - scales[1]),
        ("lost_motion X", found.lost_motion["X"], play[0]),
        ("lost_motion Y", found.lost_motion["Y"], play[1]),
        ("centre X", found.centre[0], centre[0]),
        ("centre Y", found.centre[1], centre[1]),
    ):
        rate.add(name, value.value - true, value.u)
