"""Private helper: exact products of a chain with its errors, orthonormal or small-angle.

``orthonormal``: ``Trans(EX, EY, EZ) Rx(EA) Ry(EB) Rz(EC)``; another order of the three turns differs
by the second order. ``small-angle``: ``I + hat``, as papers write it; its inverse is the true
inverse of the matrix, ``(I - hat(w) + w w') / (1 + w'w)``.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from metrosep.machine import _mesh as ps
from metrosep.machine._responses import States, triple
from metrosep.machine.elements import DIRECTIONS, Element, error_sign

EXACT = ("orthonormal", "small-angle")

Values = Mapping[str, ps.Part]
Factor = tuple[ps.Pose, ps.Pose]  # a displacement and its inverse


def exact_pose(elements: Sequence[Element], states: States, values: Values, rule: str) -> ps.Pose:
    """Return the pose of the tool (its axes, its point) in the workpiece."""
    ends = {"tool": ps.Pose(), "workpiece": ps.Pose()}
    for e in elements:
        factors = [_nominal(ps.Pose(t=triple(e.location)))]
        if e.name in states.active:
            factors += _joint(e, states.moves[e.name], values, rule)
        for forth, back in factors:
            if e.branch == "tool":
                ends["tool"] = ps.compose(ends["tool"], forth)
            else:
                ends["workpiece"] = ps.compose(back, ends["workpiece"])
    whole = ps.compose(ends["workpiece"], ends["tool"])
    return ps.Pose(whole.r, ps.apply(whole, states.tool))


def linear_error(elements: Sequence[Element], states: States, values: Values) -> ps.Pose:
    """Return the first-order errors at the tool: turn as a skew matrix, shift of the point."""
    turn, shift = ps.ORIGIN, ps.ORIGIN
    for e in elements:
        if e.name not in states.active:
            continue
        sign = 1.0 if e.branch == "tool" else -1.0
        line = line_of(e, values)
        before, after = (states.levers[e.name, f] for f in ("before", "after"))
        parts = [
            (e.frame, states.read_lever(e), sign, six_of(e, values)),
            ("before", before, sign, line),
        ]
        if e.kind == "linear":
            parts.append(("after", after, -sign, line))
        for frame, lever, s, (d, w) in parts:
            if ps.is_zero(d) and ps.is_zero(w):
                continue
            axes = states.turned[e.name, frame]
            move = ps.turn(axes, ps.add(d, ps.cross(w, lever)))
            shift = ps.add(shift, ps.scale(move, s))
            turn = ps.add(turn, ps.scale(ps.turn(axes, w), s))
    return ps.Pose(ps.hat(turn), shift)


def linear_pose(elements: Sequence[Element], states: States, values: Values) -> ps.Pose:
    """Return the nominal pose of the tool plus its errors to first order."""
    skew, shift = linear_error(elements, states, values)
    turned = _sum(states.tool_turn, ps.matmul(skew, states.tool_turn))
    return ps.Pose(turned, ps.add(states.point, shift))


def six_of(element: Element, values: Values) -> tuple[ps.Vector, ps.Vector]:
    """Return shift and turn of an element's body by its error motions."""
    sign = error_sign(element)
    six = [ps.times(values.get(f"E{d}{element.name}", 0.0), sign) for d in DIRECTIONS]
    return (six[0], six[1], six[2]), (six[3], six[4], six[5])


def line_of(element: Element, values: Values) -> tuple[ps.Vector, ps.Vector]:
    """Return shift and turn of an element's line of motion."""
    total: list[ps.Part] = [0.0] * 6
    for name, weights in element.location_errors.items():
        for k, weight in enumerate(weights):
            total[k] = ps.plus(total[k], ps.times(weight, values.get(name, 0.0)))
    return (total[0], total[1], total[2]), (total[3], total[4], total[5])


def _joint(element: Element, move: ps.Pose, values: Values, rule: str) -> list[Factor]:
    """Return the factors of one element after its location."""
    errors = [_small(*six_of(element, values), rule)]
    if any(element.measured_at):  # a displacement about the point where it was read
        there = _nominal(ps.Pose(t=triple(element.measured_at)))
        errors = [there, *errors, there[::-1]]
    line = line_of(element, values)
    moves = [_nominal(move)]
    if not (ps.is_zero(line[0]) and ps.is_zero(line[1])):
        forth, back = _small(*line, rule)
        moves = [(forth, back), *moves]
        if element.kind == "linear":
            moves.append((back, forth))
    return [*errors, *moves] if element.frame == "before" else [*moves, *errors]


def _nominal(pose: ps.Pose) -> Factor:
    return pose, ps.inverse(pose)


def _small(shift: ps.Vector, turn: ps.Vector, rule: str) -> Factor:
    """Return the pose of a small displacement and its inverse."""
    if ps.is_zero(turn):
        return _nominal(ps.Pose(t=shift))
    if rule == "small-angle":
        skew = ps.hat(turn)
        outer: ps.Matrix = (
            ps.scale(turn, turn[0]),
            ps.scale(turn, turn[1]),
            ps.scale(turn, turn[2]),
        )
        norm = ps.as_part(np.asarray(1.0 / (1.0 + ps.dot(turn, turn))))
        back = _times(_sum(_sum(ps.UNIT, ps.transpose(skew)), outer), norm)
        return (
            ps.Pose(_sum(ps.UNIT, skew), shift),
            ps.Pose(back, ps.scale(ps.turn(back, shift), -1.0)),
        )
    r = ps.UNIT
    for axis, angle in zip(ps.UNIT, turn, strict=True):
        if not (isinstance(angle, float) and angle == 0.0):
            r = ps.matmul(r, ps.rotation(axis, angle))  # type: ignore[arg-type]
    return _nominal(ps.Pose(r, shift))


def _sum(a: ps.Matrix, b: ps.Matrix) -> ps.Matrix:
    return ps.add(a[0], b[0]), ps.add(a[1], b[1]), ps.add(a[2], b[2])


def _times(a: ps.Matrix, factor: ps.Part) -> ps.Matrix:
    return ps.scale(a[0], factor), ps.scale(a[1], factor), ps.scale(a[2], factor)
