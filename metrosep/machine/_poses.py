"""Private: poses of a chain as components that are skipped where they are 0 or 1, exact or to first order."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from metrosep.core._arrays import FloatArray
from metrosep.core.errors import DataError, InvalidSamplesError
from metrosep.machine.elements import DIRECTIONS, Element, error_sign
from metrosep.machine.terms import positions_array

# ---- private helpers: rigid poses as components, each a number or an array of states -----------
# A pose maps a point of its own frame into its parent: ``p_parent = R p + t``. `R` is kept as nine and
# `t` as three components; a component is a float where it is the same in every state, otherwise an
# array that broadcasts. Products with 0 and 1 are skipped, so that the 25 columns of a lathe cost a
# few passes over the states and no matrix per state.

Part = float | FloatArray
Vector = tuple[Part, Part, Part]
Matrix = tuple[Vector, Vector, Vector]

UNIT: Matrix = ((1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0))
ORIGIN: Vector = (0.0, 0.0, 0.0)


class Pose(NamedTuple):
    """Rotation and translation of one frame in another."""

    r: Matrix = UNIT
    t: Vector = ORIGIN


def as_part(value: FloatArray) -> Part:
    """Return a number where the array holds but one, so that zeros can be skipped."""
    return float(value) if value.ndim == 0 else value


def times(a: Part, b: Part) -> Part:
    """Return a*b; a plain 0 or 1 costs nothing."""
    if isinstance(a, float):
        if a == 0.0:
            return 0.0
        if a == 1.0:
            return b
    if isinstance(b, float):
        if b == 0.0:
            return 0.0
        if b == 1.0:
            return a
    return a * b


def plus(a: Part, b: Part) -> Part:
    """Return a+b; a plain 0 costs nothing."""
    if isinstance(a, float) and a == 0.0:
        return b
    if isinstance(b, float) and b == 0.0:
        return a
    return a + b


def minus(a: Part, b: Part) -> Part:
    """Return a-b; a plain 0 costs nothing."""
    if isinstance(b, float) and b == 0.0:
        return a
    if isinstance(a, float) and a == 0.0:
        return -b
    return a - b


def is_zero(a: Vector) -> bool:
    """Return whether all three components are plain zeros."""
    return all(isinstance(part, float) and part == 0.0 for part in a)


def dot(a: Vector, b: Vector) -> Part:
    """Return the scalar product."""
    return plus(plus(times(a[0], b[0]), times(a[1], b[1])), times(a[2], b[2]))


def cross(a: Vector, b: Vector) -> Vector:
    """Return the vector product a x b."""
    return (
        minus(times(a[1], b[2]), times(a[2], b[1])),
        minus(times(a[2], b[0]), times(a[0], b[2])),
        minus(times(a[0], b[1]), times(a[1], b[0])),
    )


def add(a: Vector, b: Vector) -> Vector:
    """Return a + b."""
    return plus(a[0], b[0]), plus(a[1], b[1]), plus(a[2], b[2])


def subtract(a: Vector, b: Vector) -> Vector:
    """Return a - b."""
    return minus(a[0], b[0]), minus(a[1], b[1]), minus(a[2], b[2])


def scale(a: Vector, factor: Part) -> Vector:
    """Return factor * a."""
    return times(a[0], factor), times(a[1], factor), times(a[2], factor)


def turn(r: Matrix, v: Vector) -> Vector:
    """Return R v."""
    return dot(r[0], v), dot(r[1], v), dot(r[2], v)


def transpose(r: Matrix) -> Matrix:
    """Return the transpose, which is the inverse of a rotation."""
    if r is UNIT:
        return UNIT
    x, y, z = zip(*r, strict=True)
    return x, y, z


def matmul(a: Matrix, b: Matrix) -> Matrix:
    """Return the product of two matrices; that with the unit matrix costs nothing."""
    if a is UNIT or b is UNIT:
        return b if a is UNIT else a
    x, y, z = (turn(a, column) for column in transpose(b))
    return transpose((x, y, z))


def compose(a: Pose, b: Pose) -> Pose:
    """Return the pose ``a b``: first b, then a."""
    return Pose(matmul(a.r, b.r), add(a.t, turn(a.r, b.t)))


def apply(a: Pose, point: Vector) -> Vector:
    """Return the point in the parent's frame."""
    return add(a.t, turn(a.r, point))


def inverse(a: Pose) -> Pose:
    """Return the inverse of a rigid pose (orthonormal rotation)."""
    r = transpose(a.r)
    return Pose(r, scale(turn(r, a.t), -1.0))


def hat(w: Vector) -> Matrix:
    """Return the skew matrix with ``hat(w) v = w x v``."""
    x, y, z = w
    return (0.0, minus(0.0, z), y), (z, 0.0, minus(0.0, x)), (minus(0.0, y), x, 0.0)


def rotation(axis: Sequence[float], angle: Part) -> Matrix:
    """Return the right-handed rotation by `angle` about a unit axis (Rodrigues)."""
    x, y, z = (float(c) for c in axis)
    c: Part = math.cos(angle) if isinstance(angle, float) else np.cos(angle)
    s: Part = math.sin(angle) if isinstance(angle, float) else np.sin(angle)
    v = minus(1.0, c)

    def own(n: float) -> Part:
        return 1.0 if n * n == 1.0 else plus(c, times(n * n, v))

    def mixed(ab: float, n: float) -> Part:
        return plus(times(ab, v), times(n, s))

    return (
        (own(x), mixed(x * y, -z), mixed(x * z, y)),
        (mixed(x * y, z), own(y), mixed(y * z, -x)),
        (mixed(x * z, -y), mixed(y * z, x), own(z)),
    )


# ---- private helper: where the frames of a chain stand at given positions, seen from the workpiece ----
# Of each frame only two things are needed: the directions of its axes in workpiece coordinates, and
# the lever, the tool point in the frame itself. Either is gathered from its own end of the chain, so
# that a lever that is zero by construction is a plain 0 and costs nothing.

Frame = tuple[str, str]  # element, "before" or "after" its motion


class States:
    """Frames and levers of a chain at the states asked for."""

    def __init__(
        self, elements: Sequence[Element], positions: Mapping[str, FloatArray], tool: FloatArray
    ) -> None:
        inputs = {**positions, **{f"tool {'xyz'[k]}": tool[..., k] for k in range(3)}}
        self.shape = _shape(inputs)
        self._with_nan = [values for values in inputs.values() if np.isnan(np.sum(values))]
        self.active = set(positions) | {e.name for e in elements if e.kind == "fixed"}
        self.moves = {
            e.name: motion(e, as_part(positions.get(e.name, np.zeros(())))) for e in elements
        }
        tools = [e for e in elements if e.branch == "tool"]
        works = [e for e in elements if e.branch == "workpiece"]
        self.levers: dict[Frame, Vector] = {}
        self.turned: dict[Frame, Matrix] = {}
        x, y, z = (as_part(np.asarray(tool[..., k])) for k in range(3))
        self.tool: Vector = x, y, z
        point = self.tool
        for e in reversed(tools):  # levers: from the tool to the bed, then on to the workpiece
            self.levers[e.name, "after"] = point
            point = apply(self.moves[e.name], point)
            self.levers[e.name, "before"] = point
            point = add(point, triple(e.location))
        for e in works:
            point = subtract(point, triple(e.location))
            self.levers[e.name, "before"] = point
            point = apply(inverse(self.moves[e.name]), point)
            self.levers[e.name, "after"] = point
        self.point = point
        turned = UNIT
        for e in reversed(works):  # directions: from the workpiece to the bed, then on to the tool
            self.turned[e.name, "after"] = turned
            turned = matmul(turned, transpose(self.moves[e.name].r))
            self.turned[e.name, "before"] = turned
        self.bed_turn = turned
        for e in tools:
            self.turned[e.name, "before"] = turned
            turned = matmul(turned, self.moves[e.name].r)
            self.turned[e.name, "after"] = turned
        self.tool_turn = turned

    def read_lever(self, element: Element) -> Vector:
        """Return the tool point from where the error motions of an element were read."""
        return subtract(self.levers[element.name, element.frame], triple(element.measured_at))

    def six(self, element: Element, frame: str, lever: Vector) -> list[Vector]:
        """Return ``sign W^-1 A hat(e_j) A^-1 p`` for the six directions of one frame A."""
        turned = self.turned[element.name, frame]
        sign = 1.0 if element.branch == "tool" else -1.0
        turns = [turn(turned, cross(axis, lever)) for axis in UNIT]
        return [scale(column, sign) for column in (*transpose(turned), *turns)]

    def six_turns(self, element: Element, frame: str) -> list[Vector]:
        """Return by how much the six directions of one frame turn the tool against the workpiece."""
        sign = 1.0 if element.branch == "tool" else -1.0
        axes = [scale(axis, sign) for axis in transpose(self.turned[element.name, frame])]
        return [ORIGIN, ORIGIN, ORIGIN, *axes]

    def poison(self, out: FloatArray) -> None:
        """Write NaN in every state in which a position or the tool point is NaN."""
        if self._with_nan:
            bad = np.zeros(self.shape, dtype=bool)
            for values in self._with_nan:
                bad |= np.isnan(values)
            out[..., bad] = np.nan


def motion(element: Element, position: Part) -> Pose:
    """Return the nominal motion M of an element at its position."""
    if element.kind == "linear":
        return Pose(t=scale(triple(element.direction), position))
    angle = element.angle if element.kind == "fixed" else position
    if isinstance(angle, float) and angle == 0.0:
        return Pose()
    return Pose(r=rotation(element.direction, angle))


def positions_of(
    elements: Sequence[Element], q: Mapping[str, ArrayLike], chain: str
) -> dict[str, FloatArray]:
    """Return the positions as arrays; a parked axis that is missing stays missing."""
    if not isinstance(q, Mapping):
        raise DataError(f"positions are a mapping of axis names, got {type(q).__name__}")
    moving = [e for e in elements if e.kind != "fixed"]
    for name in q:
        if name not in [e.name for e in moving]:
            known = ", ".join(e.name for e in moving)
            raise DataError(f"chain {chain!r} has no axis {name!r}; its axes are {known}")
    missing = [repr(e.name) for e in moving if e.name not in q and not e.parked]
    if missing:
        s, are = ("s", "are") if len(missing) > 1 else ("", "is")
        raise DataError(
            f"the position{s} of {', '.join(missing)} of chain {chain!r} {are} missing; "
            f"q holds {', '.join(q) or 'nothing'}"
        )
    given = (e.name for e in moving if e.name in q)
    return {name: positions_array(q[name], f"position of axis {name!r}") for name in given}


def tool_point(tool: ArrayLike) -> FloatArray:
    """Return the tool point as an array (..., 3)."""
    point = positions_array(tool, "tool point")
    if point.ndim == 0 or point.shape[-1] != 3:
        raise InvalidSamplesError(f"a tool point has 3 coordinates in m, got shape {point.shape}")
    return point


def triple(values: Sequence[float]) -> Vector:
    """Return three numbers as a vector."""
    return values[0], values[1], values[2]


def _shape(arrays: Mapping[str, FloatArray]) -> tuple[int, ...]:
    try:
        return np.broadcast_shapes(*(np.shape(a) for a in arrays.values()))
    except ValueError:
        shapes = ", ".join(f"{n} {np.shape(a)}" for n, a in arrays.items())
        raise InvalidSamplesError(f"positions and tool do not broadcast: {shapes}") from None


# ---- exact products of a chain with its errors, orthonormal or small-angle ----------------------
# ``orthonormal``: ``Trans(EX, EY, EZ) Rx(EA) Ry(EB) Rz(EC)``; another order of the three turns differs
# by the second order. ``small-angle``: ``I + hat``, as papers write it; its inverse is the true
# inverse of the matrix, ``(I - hat(w) + w w') / (1 + w'w)``.

EXACT = ("orthonormal", "small-angle")

Values = Mapping[str, Part]
Factor = tuple[Pose, Pose]  # a displacement and its inverse


def exact_pose(elements: Sequence[Element], states: States, values: Values, rule: str) -> Pose:
    """Return the pose of the tool (its axes, its point) in the workpiece."""
    ends = {"tool": Pose(), "workpiece": Pose()}
    for e in elements:
        factors = [_nominal(Pose(t=triple(e.location)))]
        if e.name in states.active:
            factors += _joint(e, states.moves[e.name], values, rule)
        for forth, back in factors:
            if e.branch == "tool":
                ends["tool"] = compose(ends["tool"], forth)
            else:
                ends["workpiece"] = compose(back, ends["workpiece"])
    whole = compose(ends["workpiece"], ends["tool"])
    return Pose(whole.r, apply(whole, states.tool))


def linear_error(elements: Sequence[Element], states: States, values: Values) -> Pose:
    """Return the first-order errors at the tool: turn as a skew matrix, shift of the point."""
    turned, shift = ORIGIN, ORIGIN
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
            if is_zero(d) and is_zero(w):
                continue
            axes = states.turned[e.name, frame]
            move = turn(axes, add(d, cross(w, lever)))
            shift = add(shift, scale(move, s))
            turned = add(turned, scale(turn(axes, w), s))
    return Pose(hat(turned), shift)


def linear_pose(elements: Sequence[Element], states: States, values: Values) -> Pose:
    """Return the nominal pose of the tool plus its errors to first order."""
    skew, shift = linear_error(elements, states, values)
    turned = _map(add, states.tool_turn, matmul(skew, states.tool_turn))
    return Pose(turned, add(states.point, shift))


def six_of(element: Element, values: Values) -> tuple[Vector, Vector]:
    """Return shift and turn of an element's body by its error motions."""
    sign = error_sign(element)
    six = [times(values.get(f"E{d}{element.name}", 0.0), sign) for d in DIRECTIONS]
    return (six[0], six[1], six[2]), (six[3], six[4], six[5])


def line_of(element: Element, values: Values) -> tuple[Vector, Vector]:
    """Return shift and turn of an element's line of motion."""
    total: list[Part] = [0.0] * 6
    for name, weights in element.location_errors.items():
        for k, weight in enumerate(weights):
            total[k] = plus(total[k], times(weight, values.get(name, 0.0)))
    return (total[0], total[1], total[2]), (total[3], total[4], total[5])


def _joint(element: Element, move: Pose, values: Values, rule: str) -> list[Factor]:
    """Return the factors of one element after its location."""
    errors = [_small(*six_of(element, values), rule)]
    if any(element.measured_at):  # a displacement about the point where it was read
        there = _nominal(Pose(t=triple(element.measured_at)))
        errors = [there, *errors, there[::-1]]
    line = line_of(element, values)
    moves = [_nominal(move)]
    if not (is_zero(line[0]) and is_zero(line[1])):
        forth, back = _small(*line, rule)
        moves = [(forth, back), *moves]
        if element.kind == "linear":
            moves.append((back, forth))
    return [*errors, *moves] if element.frame == "before" else [*moves, *errors]


def _nominal(pose: Pose) -> Factor:
    return pose, inverse(pose)


def _small(shift: Vector, w: Vector, rule: str) -> Factor:
    """Return the pose of a small displacement and its inverse."""
    if is_zero(w):
        return _nominal(Pose(t=shift))
    if rule == "small-angle":
        skew = hat(w)
        outer = _map(scale, (w, w, w), w)
        norm = as_part(np.asarray(1.0 / (1.0 + dot(w, w))))
        whole = _map(add, _map(add, UNIT, transpose(skew)), outer)
        back = _map(scale, whole, (norm, norm, norm))
        return Pose(_map(add, UNIT, skew), shift), Pose(back, scale(turn(back, shift), -1.0))
    r = UNIT
    for axis, angle in zip(UNIT, w, strict=True):
        if not (isinstance(angle, float) and angle == 0.0):
            r = matmul(r, rotation(axis, angle))  # type: ignore[arg-type]
    return _nominal(Pose(r, shift))


def _map(function: Any, a: Matrix, b: Any) -> Matrix:
    """Return what a function makes of each row of a matrix and its partner."""
    return function(a[0], b[0]), function(a[1], b[1]), function(a[2], b[2])
