"""Positioning accuracy and repeatability of an axis after ISO 230-2.

error = position reached minus target, so a positive error went too far; the correction is its
negative. forward is the approach in the positive direction (the arrow up of the standard). The
reversal error is ``B_i = mean forward - mean backward``: with play the axis stays behind on both
sides, and B_i is negative.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, ClassVar, Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray

from metrosep.core._arrays import FloatArray, frozen_float
from metrosep.core.errors import DataError, InvalidSamplesError, TooFewSamplesError, UnitError
from metrosep.core.methods import RoleColumns
from metrosep.core.numbers import real
from metrosep.core.options import Option
from metrosep.core.profile import Profile
from metrosep.core.provenance import Step
from metrosep.core.readable import typed_number
from metrosep.core.runset import FORWARD, REVERSE
from metrosep.separation._readings import (
    checked_readings,
    checked_seed,
    known_parts,
    part_of,
)
from metrosep.separation.contract import (
    History,
    NamedMethod,
    Parts,
    RecordedMethod,
    Separation,
    Unobservable,
    pooled,
)
from metrosep.separation.positions.positioning_result import PositioningTest, build_result

_LONGEST = 1000.0
"""m; no axis is longer, but one in mm passed as m is."""

_SAME_TARGET = 1e-9
"""Of the range of the targets; those of a table that lie closer are one."""


def iso230_2(
    targets: ArrayLike,
    forward: ArrayLike | None,
    backward: ArrayLike | None = None,
    *,
    unit: str = "m",
    confidence: float = 0.95,
    seed: int = 0,
) -> PositioningTest:
    """Return A, R, E, B and M of a positioning test, with uncertainties.

    Parameters
    ----------
    targets : array_like, shape (m,), m
        Target positions in any order, each once; m >= 2.
    forward : array_like, shape (m, n), m, or None
        Positions reached (not deviations) in the positive direction, one column per run; NaN where
        not measured; n >= 2.
    backward : array_like, shape (m, n), m, or None, optional
        The same in the negative direction. One of the two may be None: a unidirectional test.
    unit : {"m", "rad"}, optional
        Linear or rotary axis.
    seed : int, optional
        Of the simulations behind standard uncertainties and the interval of R.

    Returns
    -------
    PositioningTest
        A mapping from A, A_fwd, A_bwd, R, R_fwd, R_bwd, E, E_fwd, E_bwd, B, B_mean, M (and
        R_unbiased, R_fwd_unbiased, R_bwd_unbiased) to quantities with ``value``, ``unit``, ``u``;
        ``.intervals``, ``.targets_frame()``, ``.messages``, ``.audit``.

    Raises
    ------
    TooFewSamplesError
        If there are fewer than 2 targets, or no direction has 2 targets with 2 readings.
    InvalidSamplesError
        If shapes do not fit, targets repeat or are NaN, or an error is as large as a step between
        targets.
    DataError
        If both directions are missing, or unit, confidence or seed is not one of those allowed.
    UnitError
        If the targets span more than 1000 m.

    Notes
    -----
    With ``x_ij = P_ij - P_i``, means ``x_i`` and standard deviations ``s_i`` (ddof 1) of each
    direction (up ``^``, down ``_``)::

        B_i = x_i^ - x_i_          B = max |B_i|        B_mean = mean B_i
        R_i^ = 4 s_i^              R_i = max(2 s_i^ + 2 s_i_ + |B_i|, R_i^, R_i_)    R = max R_i
        E = max(x^, x_) - min(x^, x_)        M = max - min of (x_i^ + x_i_) / 2
        A = max(x^ + 2 s^, x_ + 2 s_) - min(x^ - 2 s^, x_ - 2 s_)

    E_fwd, A_fwd, ... take one direction. B_i, R_i and the middle need both directions of a target;
    E and A take all that was measured. Standard uncertainties are type A: 2000 simulated tests with
    the spread and the means that the axis probably has (drawn together where they scatter no more
    than by noise). They hold scatter only; the reference instrument, temperature and alignment are
    the budget of the user. What is below 1e-15 of the largest position is rounding and taken as 0.

    Not seen: what is common to all runs of one thermal state, and errors between the targets
    (equal steps that match the pitch of the screw hide its periodic error: a message says so).
    NaN (and masked): a target with fewer than 2 readings in a direction takes no part in it, with a
    message.

    References
    ----------
    .. [1] ISO 230-2:2014, clause 3 and 6 (definitions as in the specification of this package).

    Examples
    --------
    >>> import numpy as np
    >>> reached = np.array([[0.0, 2e-6, 1e-6], [0.1, 0.1 + 2e-6, 0.1 + 4e-6]])
    >>> test = iso230_2([0.0, 0.1], reached, reached - 3e-6)
    >>> round(test["B"].value * 1e6, 6), round(test["E"].value * 1e6, 6)
    (3.0, 4.0)
    """
    if unit not in ("m", "rad"):
        raise DataError(f"unit is 'm' (linear axis) or 'rad' (rotary axis), got {unit!r}")
    if not 0.5 <= real(confidence, "confidence", what="a number, 0.95 for 95 %") < 1.0:
        raise DataError(f"confidence must lie in 0.5 to 1 (0.95 is usual), got {confidence}")
    seed = checked_seed(seed)
    goals = frozen_float(targets, name="targets", ndim=1)
    if goals.size < 2:
        raise TooFewSamplesError(f"a positioning test needs 2 or more targets, got {goals.size}")
    if np.isnan(goals).any():
        raise InvalidSamplesError("a target is NaN; a target is a command and must be known")
    order = np.argsort(goals, kind="stable")
    goals = goals[order]
    if (np.diff(goals) <= 0.0).any():
        i = int(np.flatnonzero(np.diff(goals) <= 0.0)[0])
        raise InvalidSamplesError(
            f"target {_shown(goals[i], unit)} occurs twice; put all runs of one target in one row"
        )
    travel = float(goals[-1] - goals[0])
    if unit == "m" and travel > _LONGEST:
        raise UnitError(
            f"the targets span {travel:.6g} m; pass targets and positions in m (divide mm by 1000)"
        )
    if forward is None and backward is None:
        raise DataError("neither forward nor backward positions were given; give one at least")
    up = _errors(forward, goals, order, "forward", unit)
    down = _errors(backward, goals, order, "backward", unit)
    return build_result(goals, up, down, unit=unit, confidence=confidence, seed=seed)


def _errors(
    reached: ArrayLike | None, goals: FloatArray, order: NDArray[np.intp], name: str, unit: str
) -> FloatArray | None:
    """Return position minus target, rows in the order of rising targets."""
    if reached is None or np.size(np.asarray(reached, dtype=object)) == 0:
        return None
    positions = frozen_float(reached, name=f"{name} positions", ndim=2)
    m = goals.size
    if positions.shape[0] != m:
        turned = positions.shape[1] == m
        hint = "transpose it" if turned else "give one row for each target"
        raise InvalidSamplesError(
            f"{name} has shape {positions.shape} for {m} targets: rows are targets, columns are "
            f"runs; {hint}"
        )
    if positions.shape[1] < 2:
        raise TooFewSamplesError(
            f"{name} has 1 run; the standard deviation needs 2, ISO 230-2 asks for 5"
        )
    errors = positions[order] - goals[:, None]
    if np.isnan(errors).all():
        raise InvalidSamplesError(f"{name} holds no reading; pass None for a unidirectional test")
    largest = float(np.nanmax(np.abs(errors)))
    step = float(np.diff(goals).min())
    if largest >= step:
        raise InvalidSamplesError(
            f"{name}: the largest deviation is {largest:.4g} {unit}, the smallest step between "
            f"targets {step:.4g} {unit}; pass positions reached (not deviations), in the unit and "
            "the order of the targets"
        )
    return errors


def positions_from_profiles(
    forward: Sequence[Profile], backward: Sequence[Profile] = ()
) -> tuple[FloatArray, FloatArray | None, FloatArray | None]:
    """Return targets and positions of runs that were read as profiles of the deviation.

    Parameters
    ----------
    forward, backward : sequence of Profile
        One profile per run, x = target, z = position minus target: what ``metrosep.read`` gives
        of a list of a positioning test with ``channel="forward 1"`` and so on.

    Returns
    -------
    tuple of (ndarray, ndarray or None, ndarray or None)
        targets (m,), forward and backward (m, n), all in m: the arguments of `iso230_2`.

    Raises
    ------
    TooFewSamplesError
        If there is no run at all.
    InvalidSamplesError
        If an element is not a profile, or the targets of two runs differ.

    Examples
    --------
    >>> runs = [Profile([0.0, 0.1], [0.0, z]) for z in (1e-6, 2e-6)]
    >>> targets, up, down = positions_from_profiles(runs)
    >>> up.shape, down is None
    ((2, 2), True)
    """
    runs = [*forward, *backward]
    if not runs:
        raise TooFewSamplesError("a positioning test needs runs, got none")
    for i, run in enumerate(runs):
        if not isinstance(run, Profile):
            raise InvalidSamplesError(f"run {i} is a {type(run).__name__}; pass profiles")
        run.require_metres()
        same = run.x.shape == runs[0].x.shape
        if not same or float(np.abs(run.x - runs[0].x).max()) > 1e-9 * float(np.ptp(run.x)):
            raise InvalidSamplesError(
                f"run {i} has other targets than run 0; pass runs of one test"
            )
    targets = np.array(runs[0].x)
    both = [
        np.column_stack([targets + run.z for run in way]) if way else None
        for way in (forward, backward)
    ]
    return targets, both[0], both[1]


def positions_from_columns(
    target: ArrayLike,
    direction: Sequence[Any] | NDArray[Any],
    readings: ArrayLike,
    cycle: Sequence[Any] | NDArray[Any] | None = None,
    *,
    unit: str | None = None,
) -> tuple[FloatArray, FloatArray | None, FloatArray | None]:
    """Return targets and positions of a table with one row per target and direction, or per reading.

    Parameters
    ----------
    target : array_like, shape (rows,), m
        Target of each row.
    direction : sequence, shape (rows,)
        ``"fwd"``, ``"forward"``, ``"up"``, ``"+"``, 1 or ``"bwd"``, ``"backward"``, ``"down"``,
        ``"-"``, -1 of each row.
    readings : array_like, shape (rows, n), m
        Positions reached, one column per run.
    cycle : sequence, shape (rows,), optional
        Number or name of the cycle of each row, where a target has a row for each cycle. If it is
        omitted and every target of a direction occurs equally often, the occurrences are its
        cycles, in the order of the rows.
    unit : {"m", "rad"}, optional
        Of the targets, for messages: they are printed in mm or deg.

    Returns
    -------
    tuple of (ndarray, ndarray or None, ndarray or None)
        targets (m,), forward and backward (m, n): the arguments of `iso230_2`. A target that one
        direction or cycle lacks is NaN there.

    Raises
    ------
    InvalidSamplesError
        If the columns differ in length, a direction is not known, a target is NaN, occurs twice in
        a cycle, or its occurrences do not tell the cycles.

    Notes
    -----
    Targets that differ by less than 1e-9 of their range are one (the first is returned).

    Which column is which direction cannot be distinguished from the numbers; B and B_mean change sign when
    they are exchanged, R, A, E and M do not.

    Examples
    --------
    >>> targets, up, down = positions_from_columns([0, 1, 0], ["fwd", "fwd", "bwd"],
    ...                                            [[0.0, 0.1], [1.0, 1.1], [0.2, 0.3]])
    >>> targets.tolist(), down[0].tolist(), bool(np.isnan(down[1]).all())
    ([0.0, 1.0], [0.2, 0.3], True)
    """
    rows = frozen_float(target, name="target", ndim=1)
    values = frozen_float(readings, name="readings", ndim=2)
    try:
        words = [str(d).strip().casefold() for d in direction]
    except TypeError:
        raise InvalidSamplesError(
            f"direction must be words 'fwd' or 'bwd', one for each row, got {direction!r}"
        ) from None
    if not rows.size == len(words) == values.shape[0]:
        raise InvalidSamplesError(
            f"rows must be equally many: target has {rows.size}, direction {len(words)}, readings "
            f"{values.shape[0]}"
        )
    unknown = sorted(set(words) - FORWARD - REVERSE)
    if unknown:
        raise InvalidSamplesError(f"direction {unknown[0]!r} is not known; write 'fwd' or 'rev'")
    if np.isnan(rows).any():
        raise InvalidSamplesError("a target is NaN; a target is a command and must be known")
    goals = np.unique(rows)
    goals = goals[np.append(True, np.diff(goals) > _SAME_TARGET * float(np.ptp(goals)))]
    ways: list[FloatArray | None] = []
    for names in (FORWARD, REVERSE):
        mine = np.array([w in names for w in words])
        if not mine.any():
            ways.append(None)
            continue
        at = np.abs(rows[mine][:, None] - goals).argmin(axis=1)
        turn = _turns(at, None if cycle is None else np.asarray(cycle)[mine], goals, unit)
        n = values.shape[1]
        table = np.full((goals.size, (int(turn.max()) + 1) * n), math.nan)
        for i in range(n):
            table[at, turn * n + i] = values[mine, i]
        ways.append(table)
    return goals, ways[0], ways[1]


def _shown(target: float, unit: str | None) -> str:
    """Return a target as a person reads it; a plain number where nobody says its unit."""
    if unit is None:
        return f"{target:.9g}"
    return f"{math.degrees(target):.9g} deg" if unit == "rad" else f"{target * 1e3:.9g} mm"


def _turns(
    at: NDArray[np.intp], cycle: NDArray[Any] | None, goals: FloatArray, unit: str | None
) -> NDArray[np.intp]:
    """Return the number of the cycle of each row of a direction, from 0."""
    if cycle is not None:
        names = list(dict.fromkeys(str(c).strip() for c in cycle))
        turn = np.array([names.index(str(c).strip()) for c in cycle], dtype=np.intp)
        pairs = list(zip(at.tolist(), turn.tolist(), strict=True))
        for i, pair in enumerate(pairs):
            if pair in pairs[:i]:
                raise InvalidSamplesError(
                    f"the target {_shown(goals[pair[0]], unit)} occurs twice in cycle {names[pair[1]]} of one "
                    "direction: each reading is one row"
                )
        return turn
    counts = np.bincount(at)
    often = counts[counts > 0]
    if often.min() < often.max():
        raise InvalidSamplesError(
            f"the target {_shown(goals[int(counts.argmax())], unit)} occurs {often.max()} times in one "
            f"direction, others {often.min()} times: name the column of the cycle, so that no reading "
            "is taken for one of another cycle"
        )
    seen = np.zeros(goals.size, dtype=np.intp)
    turn = np.empty(at.size, dtype=np.intp)
    for i, place in enumerate(at):
        turn[i] = seen[place]
        seen[place] += 1
    return turn


# ---- `PositioningSheet`: the runs of an ISO 230-2 test separated into mean deviations and scatter ----
# ``deviation_r(x_i) = forward_i or backward_i + reference_i + scatter``; deviation = position reached
# minus target, as the reference instrument reads it.

_REFERENCE = (
    "what the reference instrument reads wrong (dead path, cosine, its own temperature) reads like "
    "the axis: calibrate it, or measure with another one"
)
_THERMAL = (
    "what all runs of one thermal state share, and errors between the targets, count as the axis or "
    "are not sampled: warm up otherwise, add a random part to each target"
)


POSITION_OPTIONS: Mapping[str, Option] = {
    "confidence": Option("number", help="of the uncertainties, 0.95 is 95 %"),
    "seed": Option("integer", help="of the draws that tell the uncertainty"),
    "values": Option(
        "text",
        choices=("position", "deviation"),
        help="what the readings are: positions reached, or actual minus target",
    ),
}


class PositioningOfAxis(NamedMethod):
    """`iso230_2` by its name, from a table or from a list of a positioning test."""

    name = "iso230_2"
    what = "positioning accuracy and repeatability of an axis, ISO 230-2"
    reads = "table"
    roles: ClassVar[Mapping[str, str]] = {
        "target": "position?", "direction": "label?", "readings": "position*?", "cycle": "label?",
    }  # fmt: skip
    arguments: ClassVar[Mapping[str, Option]] = POSITION_OPTIONS

    @classmethod
    def from_inputs(cls, data: RoleColumns, options: Mapping[str, Any]) -> PositioningTest:
        """Return the evaluation of one axis."""
        rest = dict(options)
        data = as_positions(data, rest.pop("values", "position"))
        return iso230_2(*reached(data), unit=target_unit(data), **rest)


def target_unit(data: RoleColumns) -> str:
    """Return the unit of the targets, m or rad; refuse readings of the other."""
    unit: str = data.units.get("target", "m")
    if data.units.get("readings", unit) != unit:
        raise UnitError("targets and positions must both be lengths, or both angles")
    return unit


def reached(data: RoleColumns, rows: Any = slice(None)) -> tuple[Any, Any, Any]:
    """Return targets, forward and backward of some rows of a table, or of a whole list."""
    values = data.values
    if "forward" in values:  # from a list of a positioning test
        both = [v if v.size else None for v in (values["forward"], values["backward"])]
        return values["target"], both[0], both[1]
    found: tuple[Any, Any, Any] = positions_from_columns(
        values["target"][rows],
        [str(d) for d in values["direction"][rows]],
        values["readings"].T[rows],
        None if values.get("cycle") is None else values["cycle"][rows],
        unit=data.units.get("target"),
    )
    return found


# Many measuring programs write ``actual - target``; the evaluation takes positions. A table that is
# taken for the other kind gives a nonsensical result or none, so the data decide whether what was
# said about them can be true.

_SMALL, _LARGE = 0.1, 0.5
"""Readings that span less of the targets than the first are deviations, more than the second are
positions: an axis that is wrong by a tenth of its travel is broken, not measured."""


def as_positions(data: RoleColumns, values: str) -> RoleColumns:
    """Return the readings of a positioning test as positions reached.

    Notes
    -----
    NaN stays NaN. Without a range of targets nothing is judged; the evaluation refuses that.
    """
    target = np.asarray(data.values["target"], dtype=np.float64)
    found = {k: data.values[k] for k in ("readings", "forward", "backward") if k in data.values}
    angle = data.units.get("target") == "rad"
    _require_units(target, found)
    for name, readings in found.items():
        _require_kind(target, np.asarray(readings, dtype=np.float64), values, name, angle=angle)
    if values == "position":
        return data
    reached: dict[str, Any] = {}
    for name, readings in found.items():
        column = target if name == "readings" else target[:, None]  # a row a run, a row a target
        reached[name] = readings + column if readings.size else readings
    return replace(data, values={**data.values, **reached})


def are_deviations(data: RoleColumns) -> bool:
    """Return whether readings span far less than their targets, so that they are not positions."""
    target = np.asarray(data.values["target"], dtype=np.float64)
    found = {k: data.values[k] for k in ("readings", "forward", "backward") if k in data.values}
    _require_units(target, found)
    together = np.concatenate([np.ravel(v) for v in found.values()])
    return _range(together) < _SMALL * _range(target)


def _require_kind(
    target: FloatArray, readings: FloatArray, values: str, name: str, *, angle: bool
) -> None:
    span, reach = _range(target), _range(readings)
    if span == 0.0 or not np.isfinite(readings).any():
        return
    dimension = "angle" if angle else "length"
    sizes = (
        f"they span {typed_number(reach, dimension)} where the targets span "
        f"{typed_number(span, dimension)}"
    )
    if values == "position" and reach < _SMALL * span:
        raise InvalidSamplesError(
            f"the {name} look like deviations, not like positions reached: {sizes}; if they are "
            'actual minus target, say values = "deviation", else name the columns of positions'
        ).hinting(values="deviation")
    if values == "deviation" and reach > _LARGE * span:
        raise InvalidSamplesError(
            f"the {name} look like positions reached, not like deviations: {sizes}; leave "
            'values = "deviation" out'
        ).hinting(values=None)


_MISTAKEN = {
    1e-3: "mm and um, or m and mm",
    1e3: "mm and um, or m and mm",
    1 / 25.4: "inches and mm",
    25.4: "inches and mm",
    1 / 60: "degrees and minutes of arc",
    1 / 3600: "degrees and seconds of arc",
}
"""Readings over targets, where the numbers are those of the targets and a unit is not."""
_ALIKE = 1e-3
"""Of the targets: an axis that is wrong by a thousandth of its travel is not proportional to it so well."""


def _require_units(target: FloatArray, found: Mapping[str, Any]) -> None:
    """Refuse readings that are the targets in number but not in unit: a table would be made of the targets."""
    for name, readings in found.items():
        values = np.asarray(readings, dtype=np.float64)
        if values.size:  # of a direction that was not measured there are none
            goals = (
                target if name == "readings" else target[:, None]
            )  # a row a run, a row a target
            _require_other_numbers(goals, values, name)


def _require_other_numbers(target: FloatArray, readings: FloatArray, name: str) -> None:
    known = np.isfinite(target + readings)
    t, r = (np.broadcast_to(v, readings.shape)[known] for v in (target, readings))
    size = float(np.abs(t).max(initial=0.0))
    if t.size < 3 or size == 0.0:
        return
    ratio = float(t @ r) / float(t @ t)
    for factor, units in _MISTAKEN.items():
        if abs(ratio / factor - 1.0) < _ALIKE and np.abs(r / factor - t).max() < _ALIKE * size:
            raise InvalidSamplesError(
                f"the {name} have the numbers of the targets, but {factor:.3g} times their size: the unit "
                f"of a column is wrong ({units}); correct it in the names of the columns"
            )


def _range(values: FloatArray) -> float:
    known = values[np.isfinite(values)]
    return float(known.max() - known.min()) if known.size else 0.0


@dataclass(frozen=True, slots=True)
class PositioningSheet(RecordedMethod):
    """Runs over targets in one direction or both.

    Readings are deviations (position reached minus target) of M >= 2 runs, shape (n_directions, M, n), in
    m or rad. Parts: ``forward``, ``backward`` (n,), the means, and ``reference`` (n,), what the instrument
    reads too much: NaN, it is not seen. The values of the standard (A, E, R, B, M) are in the audit.

    Parameters
    ----------
    targets : tuple of float, m or rad
        At least 2, rising.
    directions : tuple of {"forward", "backward"}, optional
        What the readings hold, in this order.
    unit : {"m", "rad"}, optional
        Of targets and deviations.

    Raises
    ------
    DataError
        If a direction is unknown or occurs twice, there is none, or the unit is unknown.
    InvalidSamplesError
        If the targets are not finite and rising.

    Notes
    -----
    `iso230_2` does the work; a target with fewer than 2 readings in a direction is NaN there.
    ``u = s_i / sqrt(M)`` with the standard deviation s_i of each target, as the standard has it;
    with `u_reading` that instead. It holds the scatter of the runs only.

    Examples
    --------
    >>> method = PositioningSheet((0.0, 0.1))
    >>> runs = [[[1e-6, 3e-6], [2e-6, 3e-6]], [[0.0, 1e-6], [0.0, 2e-6]]]
    >>> found = method.separate(runs)
    >>> (found.forward * 1e6).round(6).tolist(), (found.backward * 1e6).round(6).tolist()
    ([1.5, 3.0], [0.0, 1.5])
    """

    targets: tuple[float, ...]
    directions: tuple[Literal["forward", "backward"], ...] = ("forward", "backward")
    unit: Literal["m", "rad"] = "m"

    name = "positioning_sheet"
    truth_parts = ("reference",)
    error_parts = ("forward", "backward")

    @property
    def _dimension(self) -> str:
        return "length" if self.unit == "m" else "angle"

    def __post_init__(self) -> None:
        goals = frozen_float(self.targets, name="targets", ndim=1, min_size=2)
        if not (np.isfinite(goals).all() and (np.diff(goals) > 0.0).all()):
            raise InvalidSamplesError(f"{self.name}: targets must be finite and rising")
        if not self.directions or tuple(self.directions) not in _DIRECTIONS:
            raise DataError(
                f"directions are 'forward' and 'backward', each once, got {self.directions!r}"
            )
        if self.unit not in ("m", "rad"):
            raise DataError(f"unit is 'm' or 'rad', got {self.unit!r}")

    def simulate(self, truth: Parts, errors: Parts) -> FloatArray:
        parts = known_parts(self, truth, errors)
        missing = [n for n in errors if n not in self.directions]
        if missing:
            raise DataError(f"{self.name}: the direction {missing[0]!r} is not measured here")
        shape = (len(self.targets),)
        read = part_of(parts, "reference", shape, self.name)
        return np.stack([part_of(parts, way, shape, self.name) + read for way in self.directions])

    def null_space(self) -> tuple[Unobservable, ...]:
        return (
            Unobservable("reference", "term", ("all of it",), _REFERENCE),
            *(Unobservable(w, "term", ("common to all runs",), _THERMAL) for w in self.directions),
        )

    def _solved(self, readings: ArrayLike, stated: float | None, history: History) -> Separation:
        array = checked_readings(readings, names=self.directions, minimum=2, what=self.name)
        goals = np.array(self.targets)
        if array.shape[2] != goals.size:
            raise InvalidSamplesError(
                f"{self.name}: there are {goals.size} targets and readings at {array.shape[2]}"
            )
        if array.shape[1] < 2:
            raise TooFewSamplesError(
                f"{self.name}: one run shows no repeatability; 2 are needed, ISO 230-2 asks for 5"
            )
        runs = dict(zip(self.directions, array, strict=True))
        reached = {way: (goals + rows).T for way, rows in runs.items()}
        sheet = iso230_2(goals, reached.get("forward"), reached.get("backward"), unit=self.unit)
        parts: dict[str, FloatArray] = {"reference": np.full(goals.size, np.nan)}
        u = {"reference": np.full(goals.size, np.nan)}
        squares, freedom = 0.0, 0.0
        for way, rows in runs.items():
            count = (~np.isnan(rows)).sum(axis=0)
            used = count > 1
            mean = np.where(used, np.nansum(rows, axis=0) / np.maximum(count, 1), np.nan)
            rest = np.nansum((rows - mean) ** 2, axis=0)
            sd = np.sqrt(rest / np.maximum(count - 1, 1)) if stated is None else stated
            parts[way] = mean
            u[way] = np.where(used, sd / np.sqrt(np.maximum(count, 1)), np.nan)
            squares += float(rest[used].sum())
            freedom += float((count[used] - 1).sum())
        return Separation(
            self.name,
            parts,
            u,
            dict.fromkeys(parts, self.unit),
            {"x" if self.unit == "m" else "angle": goals},
            self.null_space(),
            noise=pooled(squares, freedom, stated, _POOLED, self.unit),
            audit=_audit(sheet, self.unit),
            messages=sheet.messages,
            history=(*history, Step(self.name, {"n_targets": int(goals.size), "unit": self.unit})),
        )


_POOLED = "standard deviation of one reading, pooled over targets and directions (type A)"
_DIRECTIONS = (
    ("forward",),
    ("backward",),
    ("forward", "backward"),
    ("backward", "forward"),
)


def _audit(sheet: PositioningTest, unit: str) -> dict[str, Any]:
    suffix = "um" if unit == "m" else "urad"
    shown = {
        f"{key}_{suffix}": sheet[key].value * 1e6
        for key in ("A", "E", "R", "B", "M", "A_fwd", "E_fwd", "R_fwd", "A_bwd", "E_bwd", "R_bwd")
        if key in sheet
    }
    kept = ("n_targets", "n_runs_forward", "n_runs_backward")
    return {**{key: sheet.audit[key] for key in kept}, **shown}
