"""Inverse kinematics, and a path corrected for the errors of the machine, in position and orientation.

The linear axes move the tool point in the workpiece by directions that do not depend on where they
stand, so one linear solve puts it anywhere; rotary axes are found by Newton's method on the direction
of the tool. A correction is what is added to the command: ``actual(q + dq) = nominal(q)``.
"""

from __future__ import annotations

import math
from collections.abc import Collection, Mapping
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike

from metrosep.core import numbers
from metrosep.core._arrays import FloatArray
from metrosep.core.errors import DataError, InvalidSamplesError, NotConvergedError
from metrosep.core.provenance import freeze_mapping
from metrosep.core.units import format_length
from metrosep.machine._poses import tool_point
from metrosep.machine.elements import require_travel
from metrosep.machine.terms import positions_array

if TYPE_CHECKING:
    from metrosep.machine.chains import Chain, Errors, Positions

_ROUNDS = 6
_SETTLED = 1e-12
_SINGULAR = math.sin(math.radians(2.0))
"""Below this share an axis of rotation hardly turns the tool: its correction goes to zero at half of it."""
_SAME = 1e-9
_NO_ANGLE, _NO_LENGTH = 1e-12, 1e-14
"""Rad and m: less is rounding, and no message."""
AT_ONCE = 20_000
_STEP = 1e-6


def inverse_kinematics(
    chain: Chain, points: ArrayLike, *, tool: ArrayLike = (0.0, 0.0, 0.0), **axes: ArrayLike
) -> dict[str, FloatArray]:
    """Return positions of the linear axes that put the tool point at points of the workpiece.

    Parameters
    ----------
    chain : Chain
        The machine, without errors.
    points : array_like, shape (3,) or (n, 3), m
        In the coordinates of the workpiece.
    tool : array_like, shape (3,), m, optional
        Tool point in the frame of the tool.
    **axes : array_like, m or rad
        Positions of the rotary axes, and of linear ones beyond three.

    Returns
    -------
    dict of str to ndarray, m or rad
        Positions of all axes.

    Raises
    ------
    DataError
        An axis is unknown, a rotary one is missing, or the linear axes do not reach all three
        directions.
    InvalidSamplesError
        Points are not three coordinates, or do not broadcast with the axes.
    LimitError
        A pose is outside the stated travel of an axis.

    References
    ----------
    .. [1] machines.md, eq. 13 is this for the preset five_axis.

    Examples
    --------
    >>> from metrosep.machine import presets
    >>> machine = presets("five_axis", pivot_height=0.08)
    >>> q = inverse_kinematics(machine, (0.07, -0.03, 0.045), A=0.0, C=np.radians(30.0))
    >>> [round(float(q[a]) * 1e3, 6) for a in "XYZ"]
    [45.621778, -60.980762, 125.0]
    """
    wanted = tool_point(points)
    free = _linear_axes(chain, axes)
    given = {a: positions_array(v, f"position of axis {a!r}") for a, v in axes.items()}
    try:
        shape = np.broadcast_shapes(wanted.shape[:-1], *(v.shape for v in given.values()))
    except ValueError:
        raise InvalidSamplesError("points and positions of the axes do not broadcast") from None
    q = {
        **{a: np.zeros(shape) for a in free},
        **{a: np.broadcast_to(v, shape) for a, v in given.items()},
    }
    from_zero = np.broadcast_to(wanted, (*shape, 3)) - chain.transform(q, tool=tool)[..., :3, 3]
    moves = _solved(chain, q, free, from_zero)
    found = {**{a: moves[..., i] for i, a in enumerate(free)}, **{a: q[a] for a in given}}
    require_travel(chain.elements, found)
    return found


@dataclass(frozen=True, slots=True, eq=False, repr=False)
class CorrectedPath:
    """Commands that make a machine with errors go where the nominal path goes.

    Parameters
    ----------
    q : mapping of str to ndarray, shape (n,), m or rad
        Corrected commands.
    correction : mapping of str to ndarray, shape (n,), m or rad
        What was added to the nominal ones.
    before, left : ndarray, shape (n, 3), m
        Error of the tool point without and with the correction, workpiece X, Y, Z.
    turn_before, turn_left : ndarray, shape (n,), rad
        Angle between actual and nominal tool axis, without and with.
    held : mapping of str to ndarray of bool, shape (n,)
        Poses at which a rotary axis could not correct the orientation (near the singular pose).
    messages : tuple of str
        What stays and why.
    audit : mapping
        Tool point, units in the keys.
    """

    q: Mapping[str, FloatArray]
    correction: Mapping[str, FloatArray]
    before: FloatArray
    left: FloatArray
    turn_before: FloatArray
    turn_left: FloatArray
    held: Mapping[str, Any]
    messages: tuple[str, ...] = ()
    audit: Mapping[str, Any] = field(default_factory=dict)

    def __repr__(self) -> str:
        sizes = [format_length(_rms(v)) for v in (self.before, self.left)]
        return f"CorrectedPath({self.left.shape[0]} poses, RMS {sizes[0]} -> {sizes[1]})"


def correct_path(
    chain: Chain,
    errors: Errors,
    q: Positions,
    *,
    tool: ArrayLike = (0.0, 0.0, 0.0),
    tool_axis: ArrayLike = (0.0, 0.0, 1.0),
    max_step: float | str | None = None,
) -> CorrectedPath:
    """Return a path whose actual poses are the nominal ones of a path.

    Parameters
    ----------
    chain : Chain
        The machine.
    errors : ErrorSet or mapping of str to float, callable or ErrorTerm
        Its errors, actual minus nominal.
    q : mapping of str to array_like, shape (n,), m or rad
        Nominal commands of all axes.
    tool : array_like, shape (3,), m, optional
        Tool point in the frame of the tool.
    tool_axis : array_like, shape (3,), optional
        Axis of the tool in its frame; its direction is corrected where rotary axes can.
    max_step : float or str, rad, optional
        Largest correction of a rotary axis that is allowed between neighbouring poses.

    Returns
    -------
    CorrectedPath
        Commands and what stays; errors of the result are verified with exact rotations.

    Raises
    ------
    DataError
        An axis is missing or unknown, the linear axes reach fewer than two directions, or a correction
        jumps by more than `max_step`; the message names the poses.
    LimitError
        A pose, nominal or corrected, is outside the stated travel of an axis.
    NotConvergedError
        The errors are so steep that the corrections do not settle.

    Notes
    -----
    Orientation first: least squares of the direction of the tool by the rotary axes; an axis that
    turns the tool by less than sin 2 deg of its own turn is corrected less and less there (singular pose:
    dC = e / sin A), and within 1 deg not at all. Then the linear axes take the tool point to its place;
    those of a lathe (two) as near as they can, and what stays across them is said.

    References
    ----------
    .. [1] machines.md, section 8.

    Examples
    --------
    >>> from metrosep.machine import presets
    >>> mill = presets("mill_xyz")
    >>> path = {"X": np.array([0.0, 0.1, 0.2]), "Y": 0.1, "Z": 0.0}
    >>> correct_path(mill, {"EXX": lambda x: 1e-5 * x}, path).correction["X"].round(9).tolist()
    [0.0, -1e-06, -2e-06]
    """
    at = {a: positions_array(v, f"position of axis {a!r}") for a, v in q.items()}
    shape = np.broadcast_shapes((1,), *(v.shape for v in at.values()))
    nominal = {a: np.broadcast_to(v, shape).astype(np.float64) for a, v in at.items()}
    course = Course(chain, errors, nominal, tool, tool_axis, max_step)
    require_travel(chain.elements, nominal)
    # in parts: the poses of a path of a million blocks would take gigabytes
    parts = [
        course.corrected({a: v[i : i + AT_ONCE] for a, v in nominal.items()})
        for i in range(0, shape[0], AT_ONCE)
    ]
    moved = {a: np.concatenate([p.moved[a] for p in parts]) for a in nominal}
    held = {a: np.concatenate([p.held[a] for p in parts]) for a in course.turning}
    before, turned, off, away = (
        np.concatenate([getattr(p, name) for p in parts])
        for name in ("before", "turn_before", "left", "turn_left")
    )
    correction = {a: moved[a] - nominal[a] for a in moved}
    return CorrectedPath(
        q=freeze_mapping(moved),
        correction=freeze_mapping(correction),
        before=before,
        left=off,
        turn_before=turned,
        turn_left=away,
        held=freeze_mapping(held),
        messages=course.messages(),
        audit=freeze_mapping(
            {"tool_mm": [float(v) * 1e3 for v in np.ravel(tool_point(tool))[:3]]}
        ),
    )


class Course:
    """A path that is corrected part by part, and what the parts so far leave."""

    def __init__(
        self,
        chain: Chain,
        errors: Errors,
        axes: Collection[str],
        tool: ArrayLike,
        tool_axis: ArrayLike,
        max_step: float | str | None,
    ) -> None:
        axis = tool_point(tool_axis)
        size = float(np.linalg.norm(axis))
        if axis.shape != (3,) or size == 0.0:
            raise InvalidSamplesError(
                f"tool_axis is a direction of three numbers, got {tool_axis!r}"
            )
        self.chain, self.errors, self.tool, self.axis = chain, errors, tool, axis / size
        self.free = _linear_axes(chain, dict.fromkeys(a for a in axes if a not in _three(chain)))
        self.turning = [e.name for e in chain.elements if e.kind == "rotary" and e.name in axes]
        self.max_step = (
            math.inf if max_step is None else numbers.quantity(max_step, "max_step", "angle")
        )
        self.n = 0
        self.squares = np.zeros(2)  # of the error that linear axes can move, before and left
        self.across = 0.0
        self.held = {a: np.zeros(2) for a in self.turning}  # poses, squares of what stays there
        self.largest = dict.fromkeys(self.turning, 0.0)
        self.last: dict[str, FloatArray] = {}

    def corrected(self, nominal: Mapping[str, FloatArray]) -> Settled:
        """Return the commands of the next poses, which must be within the travel and settle."""
        require_travel(self.chain.elements, nominal, self.n)
        part = _settled(
            self.chain, self.errors, nominal, self.tool, self.axis, self.turning, self.free
        )
        require_travel(self.chain.elements, part.moved, self.n)
        self.squares += np.sum(part.reached**2, axis=0)
        self.across = max(self.across, float(part.across.max()))
        begin, self.n = self.n, self.n + part.across.size
        sizes = np.sqrt(self.squares / self.n).tolist()
        if not np.isfinite(part.left).all() or sizes[1] > max(0.5 * sizes[0], 1e-9):
            raise NotConvergedError(
                f"the corrected path does not settle: {format_length(sizes[0])} -> "
                f"{format_length(sizes[1])}; are the errors in m and rad?"
            )
        for a in self.turning:
            by = part.moved[a] - nominal[a]
            self.largest[a] = max(self.largest[a], float(np.abs(by).max()))
            self.held[a] += (
                np.count_nonzero(part.held[a]),
                np.sum(part.turn_left[part.held[a]] ** 2),
            )
            jumps = np.abs(np.diff(np.append(self.last.get(a, by[:1]), by)))
            self.last[a] = by[-1:]
            if jumps.max() > self.max_step:
                i = int(np.argmax(jumps))
                raise DataError(
                    f"the correction of {a} jumps by {math.degrees(jumps[i]):.4g} deg between poses "
                    f"{begin + i - 1} and {begin + i}, max_step is {math.degrees(self.max_step):.4g} deg; the "
                    "path passes close to the singular pose: hold the orientation there, or tilt the part"
                )
        return part

    def messages(self) -> tuple[str, ...]:
        """Return what stays of the orientation and across the plane of two linear axes, and why."""
        said = []
        for a in self.turning:
            n, squares = self.held[a].tolist()
            size = math.sqrt(squares / n) if n else 0.0
            if size > _NO_ANGLE:
                said.append(
                    f"{a} hardly turns the tool at {n:.0f} of {self.n} poses and was not or hardly corrected "
                    f"there: {size * 1e6:.3g} urad RMS of orientation stay"
                )
            if self.largest[a] > _NO_ANGLE:
                said.append(f"the largest correction of {a} is {self.largest[a] * 1e6:.4g} urad")
        if len(self.free) < 3 and self.across > _NO_LENGTH:
            stays = f"up to {format_length(self.across)} of error stay there"
            said.append(
                f"{' and '.join(self.free)} do not move the tool across their plane: {stays}"
            )
        return tuple(said)


@dataclass(frozen=True, slots=True, eq=False)
class Settled:
    """Commands of some poses, and what they leave."""

    moved: Mapping[str, FloatArray]
    held: Mapping[str, Any]
    before: FloatArray  # (n, 3), m
    left: FloatArray
    turn_before: FloatArray  # (n,), rad
    turn_left: FloatArray
    reached: FloatArray  # (n, 2), m: of before and left what linear axes can move
    across: FloatArray  # (n,), m: of left what they cannot


def _settled(
    chain: Chain,
    errors: Errors,
    nominal: Mapping[str, FloatArray],
    tool: ArrayLike,
    axis: FloatArray,
    turning: list[str],
    free: tuple[str, ...],
) -> Settled:
    """Return the commands whose actual poses are the nominal ones."""
    reach = reach_of(chain, nominal)
    goal = chain.transform(nominal, tool=tool)
    place, along = goal[..., :3, 3], goal[..., :3, :3] @ axis
    moved = {a: v.copy() for a, v in nominal.items()}
    held: dict[str, Any] = {}

    def errors_at(commands: Mapping[str, FloatArray]) -> tuple[FloatArray, FloatArray]:
        actual = chain.transform(commands, errors, tool=tool, exact=True)
        return actual[..., :3, 3] - place, actual[..., :3, :3] @ axis - along

    first = errors_at(moved)
    off, away = first
    for _ in range(_ROUNDS):
        before = dict(moved)
        if turning:
            turned, held = _turns(chain, nominal, turning, axis, away, first[1])
            moved |= {a: moved[a] - change for a, change in turned.items()}
            off, _ = errors_at(moved)
        shifts = _solved(chain, nominal, free, -off, least=2)
        moved |= {a: moved[a] + shifts[..., i] for i, a in enumerate(free)}
        off, away = errors_at(moved)
        if max(float(np.abs(moved[a] - before[a]).max()) for a in moved) < _SETTLED:
            break
    of_axes = [v if reach is None else (reach @ v[..., None])[..., 0] for v in (first[0], off)]
    return Settled(
        moved,
        held,
        first[0],
        off,
        np.linalg.norm(first[1], axis=-1),
        np.linalg.norm(away, axis=-1),
        np.stack([np.linalg.norm(v, axis=-1) for v in of_axes], axis=-1),
        np.linalg.norm(off - of_axes[1], axis=-1),
    )


def _three(chain: Chain) -> tuple[str, ...]:
    """Return the linear axes that place the tool: those that repeat another on purpose stay."""
    return tuple(
        e.name
        for e in chain.elements
        if e.kind == "linear" and e.parallel_to is None and not e.parked
    )


def _linear_axes(chain: Chain, given: Mapping[str, Any]) -> tuple[str, ...]:
    """Return the axes that are solved for: the linear ones that are not given."""
    unknown = [a for a in given if a not in chain.axes]
    if unknown:
        raise DataError(
            f"{unknown[0]!r} is not an axis of the chain; its axes are {', '.join(chain.axes)}"
        )
    free = tuple(a for a in _three(chain) if a not in given)
    kinds = {e.name: e for e in chain.elements}
    missing = [a for a in chain.axes if a not in free and a not in given and not kinds[a].parked]
    if missing:
        raise DataError(f"the position of axis {missing[0]!r} is missing; give {missing[0]}=")
    return free


def reach_of(chain: Chain, q: Positions) -> FloatArray | None:
    """Return what takes a vector to its part that linear axes can move, (..., 3, 3); None if that is all."""
    at = {a: np.asarray(v, dtype=np.float64) for a, v in q.items()}
    M = _columns(chain, at, _three(chain))
    return None if M.shape[-1] > 2 else np.asarray(M @ np.linalg.pinv(M))


def _columns(chain: Chain, q: Mapping[str, FloatArray], free: tuple[str, ...]) -> FloatArray:
    """Return by how much the tool point moves in the workpiece when each linear axis does, (..., 3, k)."""
    here = chain.transform(q)[..., :3, 3]
    columns = [chain.transform({**q, a: q[a] + 1.0})[..., :3, 3] - here for a in free]
    return np.stack(columns, axis=-1) if columns else np.zeros((*here.shape, 0))


def _solved(
    chain: Chain,
    q: Mapping[str, FloatArray],
    free: tuple[str, ...],
    wanted: FloatArray,
    *,
    least: int = 3,
) -> FloatArray:
    """Return moves of the linear axes that shift the tool point by what is wanted, or nearest to it, (..., k)."""
    M = _columns(chain, q, free)
    k = M.shape[-1]
    if not least <= k <= 3 or np.linalg.svd(M.reshape(-1, 3, k)[0], compute_uv=False)[-1] < _SAME:
        raise DataError(
            f"the linear axes {', '.join(free) or '(none)'} do not move the tool in all three directions "
            "of the workpiece; a path can only be corrected where they do"
        )
    if k < 3:
        return np.asarray((np.linalg.pinv(M) @ wanted[..., None])[..., 0])
    return np.asarray(np.linalg.solve(M, wanted[..., None])[..., 0])


def _turns(
    chain: Chain,
    q: Mapping[str, FloatArray],
    turning: list[str],
    axis: FloatArray,
    away: FloatArray,
    first: FloatArray,
) -> tuple[dict[str, FloatArray], dict[str, Any]]:
    """Return by how much rotary axes turned too far, and where one of them cannot tell."""

    def direction(name: str, by: float) -> FloatArray:
        return np.asarray(chain.transform({**q, name: q[name] + by})[..., :3, :3] @ axis)

    columns = [(direction(a, _STEP) - direction(a, -_STEP)) / (2.0 * _STEP) for a in turning]
    M = np.stack(columns, axis=-1)
    weak = np.linalg.norm(M, axis=-2) < _SINGULAR
    U, s, Vt = np.linalg.svd(M, full_matrices=False)
    # without a step: a path through the singular pose would have to jump there
    share = np.clip((s - 0.5 * _SINGULAR) / (0.5 * _SINGULAR), 0.0, 1.0)
    weight = share**2 * (3.0 - 2.0 * share)
    goes = away - np.einsum("...jk,...k,...ik,...i->...j", U, 1.0 - weight, U, first)
    inverse = np.where(share > 0.0, 1.0 / np.where(share > 0.0, s, 1.0), 0.0)
    found = np.einsum("...ji,...j,...kj,...k->...i", Vt, inverse, U, goes)
    turned = {a: found[..., i] for i, a in enumerate(turning)}
    return turned, {a: weak[..., i] for i, a in enumerate(turning)}


def _rms(values: FloatArray) -> float:
    """Return the RMS length of vectors, or RMS of numbers."""
    squares = np.sum(values**2, axis=-1) if values.ndim > 1 else values**2
    return float(np.sqrt(np.mean(squares)))
