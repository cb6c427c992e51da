"""Private helpers: rigid poses as components, each a number or an array of states.

A pose maps a point of its own frame into its parent: ``p_parent = R p + t``. `R` is kept as nine and
`t` as three components; a component is a float where it is the same in every state, otherwise an
array that broadcasts. Products with 0 and 1 are skipped, so that the 25 columns of a lathe cost a
few passes over the states and no matrix per state.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from metrosep.core._arrays import FloatArray

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
    return (
        (r[0][0], r[1][0], r[2][0]),
        (r[0][1], r[1][1], r[2][1]),
        (r[0][2], r[1][2], r[2][2]),
    )


def matmul(a: Matrix, b: Matrix) -> Matrix:
    """Return the product of two matrices; that with the unit matrix costs nothing."""
    if a is UNIT or b is UNIT:
        return b if a is UNIT else a
    columns = transpose(b)
    return (
        (dot(a[0], columns[0]), dot(a[0], columns[1]), dot(a[0], columns[2])),
        (dot(a[1], columns[0]), dot(a[1], columns[1]), dot(a[1], columns[2])),
        (dot(a[2], columns[0]), dot(a[2], columns[1]), dot(a[2], columns[2])),
    )


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
