"""The closed loop on a simulated machine: measure, make a table, cut with it, measure again.

A dry-run subtracts a table from a measurement. The loop goes through everything between: the
controller's look-up, its servo period and counts, the error at the place the axis is driven to,
play and noise. A table with its sign reversed must make the part worse, or the loop says nothing.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from typing import Any, Literal

import numpy as np
from numpy.typing import ArrayLike

from metrosep.compensation.loop_machines import FaceMachine, LoopMachine
from metrosep.compensation.table import CompensationTable
from metrosep.compensation.verify import u_of_pv, u_of_rms
from metrosep.core._arrays import FloatArray
from metrosep.core.docs import described_by
from metrosep.core.errors import DataError, SignCheckFailedError, TooFewSamplesError
from metrosep.core.quantity import Quantity
from metrosep.core.units import format_length

Correction = Callable[..., FloatArray]
Removed = Literal["offset", "line", "plane"]
Measured = Mapping[int, FloatArray]
Correct = Callable[[FloatArray, Measured, Correction], Correction]

_REST = 0.25
"""Share of the RMS that a table may leave: x and y exchanged, or a shift, leave about half."""

_OFFSET = 0.05
"""Share of the RMS by which the offset between the directions may grow (lag, counts)."""

_NAMES = {1: "forward", -1: "reverse"}


@dataclass(frozen=True, slots=True, eq=False)
class LoopCut:
    """What one state leaves on the part, mean of the repeats; frozen.

    Parameters
    ----------
    left : ndarray, shape (n,), m
        Actual minus nominal, levelled.
    pv, rms : Quantity, m
        Of `left`; uncertainty from the scatter of the repeats, None for one.
    """

    left: FloatArray = field(repr=False)
    pv: Quantity
    rms: Quantity


@dataclass(frozen=True, slots=True, eq=False)
class LoopPass:
    """One direction before, after and with the sign reversed; frozen.

    Parameters
    ----------
    direction : int
        +1 forward, -1 reverse.
    before, after, wrong_sign : LoopCut
        Without, with and with the negated correction.
    rest : float
        Largest share of the RMS that may be left.
    noise : float, m
        Standard uncertainty that noise alone gives the mean of a pass.
    """

    direction: int
    before: LoopCut
    after: LoopCut
    wrong_sign: LoopCut
    rest: float = _REST
    noise: float = 0.0

    @property
    def passed(self) -> bool:
        """Whether P-V shrinks, RMS to `rest` of it, and the reversed sign raises the RMS."""
        return (
            self.after.pv.value < self.before.pv.value
            and self.after.rms.value < self.before.rms.value
            and self.after.rms.value <= self.rest * self.before.rms.value
            and self.wrong_sign.rms.value > self.before.rms.value
        )


@dataclass(frozen=True, slots=True, eq=False)
class LoopResult:
    """Outcome of a closed loop; frozen.

    Parameters
    ----------
    places : ndarray, shape (n,) or (n, 2), m
        Where the part was measured.
    passes : tuple of LoopPass
        One for each direction.
    removed : {"offset", "line", "plane"}
        What was taken from every pass before P-V and RMS.
    lost_motion : tuple of float or None, m
        Mean of reverse minus forward before, after, and with the sign reversed.
    machine : mapping
        Settings of the machine.
    messages : tuple of str
        What deserves attention.
    """

    places: FloatArray = field(repr=False)
    passes: tuple[LoopPass, ...]
    removed: Removed
    lost_motion: tuple[float, float, float] | None
    machine: Mapping[str, Any] = field(repr=False)
    messages: tuple[str, ...] = ()

    @property
    def passed(self) -> bool:
        """Whether every direction passes, and the offset between them does not grow."""
        return all(p.passed for p in self.passes) and not self.offset_grows

    @property
    def offset_grows(self) -> bool:
        """Whether reverse and forward end further apart than without the correction."""
        if self.lost_motion is None:
            return False
        before, after, _ = self.lost_motion
        room = _OFFSET * max(p.before.rms.value for p in self.passes)
        noise = 3.0 * max(p.noise for p in self.passes)
        return abs(after) > abs(before) + max(room, noise)

    @property
    def audit(self) -> dict[str, Any]:
        """Plain values with units in the keys, for sidecars and reports."""
        rows = []
        for p in self.passes:
            row: dict[str, Any] = {"direction": _NAMES[p.direction]}
            for name in ("before", "after", "wrong_sign"):
                cut: LoopCut = getattr(p, name)
                for key, q in (("pv", cut.pv), ("rms", cut.rms)):
                    row[f"{name}_{key}_nm"] = q.value * 1e9
                    row[f"{name}_{key}_u_nm"] = None if q.u is None else q.u * 1e9
            rows.append(row)
        lost = self.lost_motion
        return {
            "passed": self.passed,
            "removed": self.removed,
            "passes": rows,
            "lost_motion_nm": None if lost is None else [v * 1e9 for v in lost],
            **self.machine,
        }

    def require(self, what: str = "the table") -> None:
        """Refuse when the part does not get better.

        Parameters
        ----------
        what : str, optional
            Name for the message.

        Raises
        ------
        SignCheckFailedError
            If P-V or RMS does not shrink as it must in some direction, the reversed sign does no harm,
            or the offset between the directions grows.
        """
        if (
            self.offset_grows
            and self.lost_motion is not None
            and all(p.passed for p in self.passes)
        ):
            raise SignCheckFailedError(f"{what}: {_offset_message(self.lost_motion)}")
        for p in self.passes:
            if p.passed:
                continue
            better = p.wrong_sign.rms.value < p.before.rms.value
            some = p.after.rms.value < p.before.rms.value and p.after.pv.value < p.before.pv.value
            raise SignCheckFailedError(
                f"{what}: the simulated part does not get {'good enough' if some else 'better'} ({_NAMES[p.direction]}): P-V "
                f"{format_length(p.before.pv.value)} -> {format_length(p.after.pv.value)}, RMS "
                f"{format_length(p.before.rms.value)} -> {format_length(p.after.rms.value)}; "
                + (
                    "the reversed sign would improve it: the sign is wrong"
                    if better
                    else f"more than {p.rest:.0%} of it is left: axes exchanged, places shifted or mirrored, "
                    "entries too coarse, lag or noise; rest= allows more"
                    if some
                    else "neither sign improves it: another axis, lag, play or noise"
                )
            )


def run_closed_loop(
    machine: LoopMachine,
    correction: CompensationTable | Correction,
    *,
    n_repeats: int = 1,
    removed: Removed = "offset",
    rest: float = _REST,
    seed: int = 0,
) -> LoopResult:
    """Cut a part without, with and with the reversed correction, and measure each.

    Parameters
    ----------
    machine : AxisMachine or FaceMachine
        Simulated machine.
    correction : CompensationTable or callable
        A table, or a dialect's simulator ``(position, direction) -> correction`` in m; for a
        face-turned part ``(x, y) -> correction``.
    n_repeats : int, optional
        Passes of each state; with 2 or more the figures have uncertainties.
    removed : {"offset", "line", "plane"}, optional
        What is taken from every pass: a part has no absolute height.
    rest : float, optional
        Largest share of the RMS that may be left for the part to pass, from 0 to 1.
    seed : int, optional
        Of repeatability and noise.

    Returns
    -------
    LoopResult
        Before, after, wrong sign, for each direction.

    Raises
    ------
    DataError
        If `removed`, `rest` or the table does not fit the machine, or it is not a table or function.
    TooFewSamplesError
        If there is no repeat.
    InvalidSamplesError
        If correction or error are not finite.

    Notes
    -----
    Every state has noise of its own. P-V of a noisy mean is too large by that noise.

    Examples
    --------
    >>> import numpy as np
    >>> from metrosep.compensation.loop_machines import AxisMachine
    >>> axis = AxisMachine(lambda x, d: 1e-6 * np.sin(40 * x), (0.0, 0.1), on_axis=False)
    >>> done = run_closed_loop(axis, lambda x, d: -0.9e-6 * np.sin(40 * x))
    >>> done.passed, round(done.passes[0].after.rms.value / done.passes[0].before.rms.value, 6)
    (True, 0.1)
    """
    act = _as_function(correction, machine)
    if int(n_repeats) < 1:
        raise TooFewSamplesError(f"at least one repeat is needed, got n_repeats={n_repeats}")
    if not 0.0 < rest <= 1.0:
        raise DataError(f"rest={rest!r}; it is a share above 0, 1 at most")
    _check_removed(machine, removed)
    rng = np.random.default_rng(seed)
    raw = {
        d: tuple(
            _repeats(machine, _scaled(act, share), d, int(n_repeats), rng)
            for share in (0.0, 1.0, -1.0)
        )
        for d in machine.directions
    }
    passes = tuple(_pass(machine, d, three, removed, rest) for d, three in raw.items())
    lost = None
    if len(raw) == 2:
        before, after, wrong = (float(np.mean(raw[-1][i] - raw[1][i])) for i in range(3))
        lost = (before, after, wrong)
    result = LoopResult(machine.places, passes, removed, lost, machine.audit)
    return replace(result, messages=_messages(result, int(n_repeats)))


@dataclass(frozen=True, slots=True, eq=False)
class LoopHistory:
    """Cycles of measuring and correcting; frozen.

    Parameters
    ----------
    pv, rms : ndarray, shape (cycles + 1, directions), m
        Of the part before, and after each cycle.
    directions : tuple of int
        Columns of the two.
    correction : callable
        The last one.
    left : dict
        For each direction what the last part showed, levelled, m.
    places : ndarray, shape (n,) or (n, 2), m
        Where the part was measured.
    """

    pv: FloatArray
    rms: FloatArray
    directions: tuple[int, ...]
    correction: Correction
    left: dict[int, FloatArray]
    places: FloatArray

    @property
    def ratios(self) -> FloatArray:
        """RMS after each cycle over the RMS before it, shape (cycles, directions); NaN after 0."""
        before = self.rms[:-1]
        ratios = np.full(before.shape, np.nan)
        np.divide(self.rms[1:], before, out=ratios, where=before > 0.0)
        return ratios


@described_by(run_closed_loop, errors=False)
def iterate_loop(
    machine: LoopMachine,
    cycles: int,
    *,
    positions: ArrayLike | None = None,
    correct: Correct | None = None,
    gain: float = 1.0,
    combine: Literal["add", "replace"] = "add",
    n_repeats: int = 1,
    removed: Removed = "offset",
    seed: int = 0,
) -> LoopHistory:
    """Measure a part, correct, cut the next part, and so on.

    Parameters
    ----------
    cycles : int
        Corrections that are made, from 1.
    positions : array_like, shape (k,), m, optional
        Entries of the table of an axis; the measured points if omitted.
    correct : callable, optional
        ``(places, {direction: measured}, active) -> correction``, in place of the table that the
        other parameters describe; needed for a face-turned part.
    gain : float, optional
        Share of the measured error that a cycle corrects; a negative one is a wrong sign.
    combine : {"add", "replace"}, optional
        Whether what is measured with a table active is added to it. Replacing it is the classic
        mistake.
    n_repeats : int, optional
        Parts that are measured for each correction.
    removed : {"offset", "line", "plane"}, optional
        What is taken from every pass before P-V and RMS; from the table only the offset.

    Returns
    -------
    LoopHistory
        P-V and RMS of every part.

    Raises
    ------
    DataError
        If a parameter cannot be, or a face-turned part has no `correct`.
    TooFewSamplesError
        If there is no cycle or repeat.
    InvalidSamplesError
        If correction or error are not finite.

    Notes
    -----
    With "add" and gain 1 an on-axis table goes through the fixed point of the exact inverse,
    ``c -> -e(p + c)``: the rest falls by the slope e' in every cycle. With gain g and across the
    axis it falls by 1 - g; "replace" brings the whole error back in every second cycle.
    """
    if int(cycles) < 1 or int(n_repeats) < 1:
        raise TooFewSamplesError(
            f"at least one cycle and one repeat are needed, got {cycles} and {n_repeats}"
        )
    if combine not in ("add", "replace"):
        raise DataError(f"combine={combine!r}; use 'add' or 'replace'")
    if not np.isfinite(gain):
        raise DataError(f"the gain must be finite, got {gain!r}")
    _check_removed(machine, removed)
    step = correct or _table_step(machine, positions, gain, combine)
    rng = np.random.default_rng(seed)
    active: Correction = _scaled(_nothing, 0.0)
    cuts: list[list[LoopCut]] = []
    for cycle in range(int(cycles) + 1):
        raw = {d: _repeats(machine, active, d, int(n_repeats), rng) for d in machine.directions}
        cuts.append([_judged(r, machine.places, removed) for r in raw.values()])
        if cycle < int(cycles):
            means = {d: r.mean(axis=0) for d, r in raw.items()}
            active = step(machine.places, means, active)
    return LoopHistory(
        np.array([[c.pv.value for c in row] for row in cuts]),
        np.array([[c.rms.value for c in row] for row in cuts]),
        machine.directions,
        active,
        {d: c.left for d, c in zip(machine.directions, cuts[-1], strict=True)},
        machine.places,
    )


def _table_step(
    machine: LoopMachine, positions: ArrayLike | None, gain: float, combine: str
) -> Correct:
    if isinstance(machine, FaceMachine):
        raise DataError("a face-turned part needs correct=: how its map becomes a correction")
    p = machine.places if positions is None else np.array(positions, dtype=np.float64)
    if p.ndim != 1 or p.size < 2 or not (np.diff(p) > 0.0).all():
        raise DataError("positions of the table must rise strictly, two at least")

    def step(places: FloatArray, measured: Measured, active: Correction) -> Correction:
        zero = float(np.mean(measured[1]))
        entries = {
            d: (active(p, d) if combine == "add" else 0.0)
            - gain * (np.interp(p, places, m) - zero)
            for d, m in measured.items()
        }
        return lambda x, d: np.asarray(np.interp(x, p, entries[d]))

    return step


def _as_function(correction: CompensationTable | Correction, machine: LoopMachine) -> Correction:
    if isinstance(correction, CompensationTable):
        if isinstance(machine, FaceMachine):
            raise DataError(
                "a face-turned part needs a correction (x, y), not a table of one axis"
            )
        if correction.is_on_axis != machine.on_axis:
            raise DataError(
                f"the table {correction.axis} -> {correction.compensates} does not fit a machine with "
                f"on_axis={machine.on_axis}"
            )
        return correction.correction
    if not callable(correction):
        raise DataError(
            f"the correction is a {type(correction).__name__}; pass a CompensationTable or a function"
        )
    return correction


def _nothing(*places: Any) -> FloatArray:
    return np.zeros(np.shape(places[0]))


def _scaled(correction: Correction, share: float) -> Correction:
    if share == 0.0:
        return _nothing
    return lambda *places: share * np.asarray(correction(*places), dtype=np.float64)


def _check_removed(machine: LoopMachine, removed: str) -> None:
    fits = ("offset", "plane") if isinstance(machine, FaceMachine) else ("offset", "line")
    if removed not in fits:
        raise DataError(f"removed={removed!r}; for this machine use {fits[0]!r} or {fits[1]!r}")


def _repeats(
    machine: LoopMachine, correction: Correction, way: int, n: int, rng: np.random.Generator
) -> FloatArray:
    return np.stack([machine.cut(correction, way, rng) for _ in range(n)])


def _judged(repeats: FloatArray, places: FloatArray, removed: str) -> LoopCut:
    runs = _levelled(repeats, places, removed)
    mean = runs.mean(axis=0)
    rms, pv = float(np.sqrt(np.mean(mean**2))), float(np.ptp(mean))
    u_rms = u_of_rms(runs) if rms > 0.0 or len(runs) < 2 else 0.0
    what = f"of the mean of {len(runs)} passes, {removed} removed, no filter"
    mean.setflags(write=False)
    return LoopCut(
        mean,
        Quantity(pv, "m", f"P-V {what}", u_of_pv(runs), "PV"),
        Quantity(rms, "m", f"RMS {what}", u_rms, "Rq"),
    )


def _levelled(runs: FloatArray, places: FloatArray, removed: str) -> FloatArray:
    runs = np.asarray(runs - runs.mean(axis=1, keepdims=True))
    if removed == "offset":
        return runs
    axes = places.reshape(places.shape[0], -1)
    design = (axes - axes.mean(axis=0)) / max(float(np.ptp(axes)), 1e-300)
    design = np.c_[np.ones(len(design)), design]
    return np.asarray(runs - (design @ np.linalg.lstsq(design, runs.T, rcond=None)[0]).T)


def _pass(
    machine: LoopMachine, way: int, three: tuple[FloatArray, ...], removed: str, rest: float
) -> LoopPass:
    before, after, wrong = (_judged(runs, machine.places, removed) for runs in three)
    # by how much repeatability and noise scatter the mean of a pass
    sd = float(np.hypot(machine.repeatability, machine.measuring_noise))
    return LoopPass(way, before, after, wrong, rest=rest, noise=sd / float(np.sqrt(three[0].size)))


def _offset_message(lost: tuple[float, float, float]) -> str:
    return (
        f"the offset between the directions grows from {format_length(lost[0])} to "
        f"{format_length(lost[1])}: check the sign of the reverse column, or whether the columns are "
        "exchanged; do not load the table"
    )


def _messages(result: LoopResult, n_repeats: int) -> tuple[str, ...]:
    messages = [
        f"the {_NAMES[p.direction]} pass does not get better by enough, or not worse with the sign "
        "reversed: do not load the table"
        for p in result.passes
        if not p.passed
    ]
    if n_repeats == 1:
        messages.append("one pass of each state: the figures have no uncertainty")
    lost = result.lost_motion
    if lost is not None and result.offset_grows:
        messages.append(_offset_message(lost))
    return tuple(messages)
