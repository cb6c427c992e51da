"""Any machine, also mirrored, skew and left-handed ones: bodies moved by screws, without chain columns.

A pose is a product of exponentials of twists (v, w) in the frame of the body that carries the next one;
an error motion is one more twist about the point at which it was read. Instruments are points and
lines on those bodies. First order leaves products of two errors: 1 um times 2 urad times 1 m.
"""

from __future__ import annotations

import numpy as np
import pytest
from scipy.linalg import expm

from metrosep.machine import Angle, Ballbar, Chain, Displacement, Element, Length, Nest
from metrosep.machine.elements import element_terms

SECOND = 0.1e-9
"""m or rad: some products of errors of 1 um and 2 urad over levers below 1 m, 12 terms at work."""


def cross(w):
    return np.array([[0, -w[2], w[1]], [w[2], 0, -w[0]], [-w[1], w[0], 0]])


def screw(w, point=(0, 0, 0), shift=(0, 0, 0)):
    """Turn about a line through a point by the rotation vector w, then shift."""
    w = np.asarray(w, dtype=float)
    twist = np.zeros((4, 4))
    twist[:3, :3], twist[:3, 3] = cross(w), -np.cross(w, point)
    moved = np.eye(4)
    moved[:3, 3] = shift
    return moved @ expm(twist)


def random_machine(rng):
    """Return five axes in a row from the bed, some of them skew, and which way round is drawn."""
    elements = []
    kinds = ["linear", "rotary", "linear", "rotary", "linear"]
    for i, name in enumerate("XAYCZ"):
        n = rng.normal(size=3) if i % 2 else np.eye(3)[i // 2] * rng.choice([-1, 1])
        n = n / np.linalg.norm(n)
        branch = (
            "tool"
            if i in (0, 3)
            else "workpiece"
            if i in (1, 4)
            else rng.choice(["tool", "workpiece"])
        )
        across = "AB"[i % 2]
        line = {} if kinds[i] == "linear" and abs(n["AB".index(across)]) > 0.99 else {
            f"{across}0{name}": (0, 0, 0, *(float(across == d) * (-1.0) ** i for d in "ABC"))}  # fmt: skip
        elements.append(
            Element(
                name, str(branch), kinds[i], tuple(n), tuple(rng.uniform(-0.3, 0.3, 3)),
                error_frame=rng.choice(["before", "after", None]), errors_of=str(rng.choice(["body", "tool"])),
                measured_at=tuple(rng.uniform(-0.2, 0.2, 3)), location_errors=line,
            )
        )  # fmt: skip
    return Chain(elements, name="drawn")


def pose(e, q, at):
    """Return the pose of the body of an axis in the frame before it."""
    n, c, r = (np.asarray(v, dtype=float) for v in (e.direction, e.location, e.measured_at))
    against = e.errors_of == "tool" and e.branch == "workpiece"
    six = np.array([at.get(f"E{d}{e.name}", 0.0) for d in "XYZABC"]) * (-1.0 if against else 1.0)
    frame = e.error_frame or ("before" if against else "after")
    line = np.zeros(3)
    for name, weights in e.location_errors.items():
        line = line + at.get(name, 0.0) * np.array(weights[3:])
    if e.kind == "linear":
        move = screw((0, 0, 0), shift=q * (n + np.cross(line, n)))
    else:
        move = screw(line) @ screw(q * n)
    error = screw(six[3:], r, six[:3])
    return screw((0, 0, 0), shift=c) @ (error @ move if frame == "before" else move @ error)


def bodies(chain, q, at):
    found = {"tool": np.eye(4), "workpiece": np.eye(4)}
    for e in chain.elements:
        found[e.branch] = found[e.branch] @ pose(e, q[e.name], at)
    return found["tool"], found["workpiece"]


@pytest.mark.parametrize("seed", range(12))
def test_every_instrument_reads_what_bodies_moved_by_screws_do(seed):
    rng = np.random.default_rng(seed)
    chain = random_machine(rng)
    errors = {
        t: rng.normal() * (1e-6 if t[0] == "E" and t[1] in "XYZ" else 2e-6)
        for e in chain.elements
        for t in element_terms(e)
        if rng.random() < 0.5
    }
    q = {a: rng.uniform(-0.3, 0.3) if a in "XYZ" else rng.uniform(-4, 4) for a in chain.axes}
    tip, mark, station = (rng.uniform(-0.2, 0.2, 3) for _ in range(3))
    T, W = bodies(chain, q, errors)
    T0, W0 = bodies(chain, q, {})
    p, p0 = (np.linalg.inv(w) @ t @ (*tip, 1) for t, w in ((T, W), (T0, W0)))
    on_bed, on_bed0 = (T @ (*tip, 1))[:3], (T0 @ (*tip, 1))[:3]
    E = W0[:3, :3] @ (p - p0)[:3]
    turn = (T[:3, :3] @ T0[:3, :3].T) @ (W[:3, :3] @ W0[:3, :3].T).T
    w = 0.5 * np.array([turn[2, 1] - turn[1, 2], turn[0, 2] - turn[2, 0], turn[1, 0] - turn[0, 1]])
    u = rng.normal(size=3)
    u = u / np.linalg.norm(u)
    own = W0[:3, :3].T @ E
    expected = {
        Displacement(direction=u): u @ E,
        Displacement(direction=u, frame="workpiece"): u @ own,
        Displacement(direction=u, end="bed"): u @ (on_bed - on_bed0),
        Angle(direction=u): u @ w,
        Nest(): E,
        Nest(senses="workpiece", frame="workpiece"): -own,
        Ballbar(ball=mark): np.linalg.norm(p[:3] - mark) - np.linalg.norm(p0[:3] - mark),
        Length(station=station, end="bed"): np.linalg.norm(on_bed - station)
        - np.linalg.norm(on_bed0 - station),
    }
    largest = max(np.abs(np.asarray(v)).max() for v in expected.values())
    assert largest > 0.5e-6
    for instrument, value in expected.items():
        found = chain.read(instrument, q, errors, tool=tip)
        assert np.abs(found - value).max() < SECOND, (instrument, found, value)
