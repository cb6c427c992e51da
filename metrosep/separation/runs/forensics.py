"""What runs show before they are separated: the run that misbehaves is named.

Two kinds of checks, both without a model of the geometry and for every method of `separate`: the
readings of a run by themselves (stuck, at the limit of the sensor, in steps, given twice), here;
and each run against the others of its direction and probe (`run_comparison`).

A finding is named and the run is kept; where no estimate can come of a run it is *refused* until
``exclude=`` leaves it out or ``accept=`` keeps it.

Source: the project's notes on separation, sections 4.1, 4.4 and 6.4.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from metrosep.core._arrays import FloatArray
from metrosep.core.blas import one_blas_thread
from metrosep.core.errors import DataError, InvalidSamplesError, NotUniformError
from metrosep.core.runset import Run, RunSet
from metrosep.core.units import format_length
from metrosep.separation.runs.clock import Clock, clock_messages, fit_clock
from metrosep.separation.runs.displaced import SURE
from metrosep.separation.runs.noise import MAD
from metrosep.separation.runs.run_comparison import (
    SPIKE,
    Findings,
    RunTable,
    check_spikes,
    check_steps,
    compare_runs,
)

Named = str | Sequence[str]

_STREAK = 20
"""Equal readings in a row of two runs that noise never makes: one was given twice."""

_STILL = 1e-6
"""Chance of so many equal readings in a row, as neighbours are equal elsewhere, from which they are named."""

_SAME = 1e-13
"""m; rises from sample to sample that agree so closely are the same ones."""

_LIMIT_SHARE, _LIMIT_PEAK = 0.01, 6.0
"""Share of readings at the extreme, and how much more often it comes than the values next to it
(a sine in steps has up to 3.4 times as many at its top)."""

_REFUSED_SHARE = 0.05
"""Share of a run at the limit of the sensor, stuck or lost, beyond which no estimate can come of it."""

_MARKED, _LEAST_VALUES = 3, 10
"""Equal readings far from all others that are markers, and different readings from which far is known."""

_ZERO_STEPS = 0.3
"""Share of equal neighbours from which readings count as steps; white noise of one step has 0.28."""

_COARSE = 2.0
"""Standard deviations of the noise beyond which a step of the readings is seen although none repeat."""

_MULTIPLE = 0.1
"""How far a difference of readings is from a multiple of their step, in steps: figures are rounded."""

_EXACT = 1e-3
"""The same where the readings rise or fall by a step with every sample: there noise hides below `_MULTIPLE`."""

_STUCK = "stuck"

_ROUNDING = 1e-12
"""RMS of a run over its largest reading below which it is a line and rounding."""

_RMS_NAMED, _RMS_REFUSED = 5.0, 50.0
"""RMS of a run over that of the median run: another unit or gain; the model breaks down."""

_SHOWN, _ALIKE = 3.0, 1.5
"""Standard uncertainties of gain and shift, and chi-square per degree of freedom, below which the
prediction of a run from the others shows no fault."""

_MOST_NAMED = 4
"""Runs whose faults an error message spells out."""


@dataclass(frozen=True, slots=True, eq=False)
class RunChecks:
    """Table of run checks: one row a run, in the order of the runs."""

    # mapping of str to list: ``run direction feed_mm_min rms_nm gain u_gain shift_mm u_shift_mm
    # jitter_percent n_lost at_mm size_nm finding refused used``; gain and shift against the other
    # runs, NaN where they cannot be compared; place and size of the first finding that has one
    columns: Mapping[str, list[Any]]
    common: tuple[str, ...] = ()  # what is wrong with the set as a whole
    step: float = 0.0  # m: step of the readings where it exceeds their noise, else 0
    # mapping of int to (float, float), s: by direction: delay that the shifts show beyond chance,
    # and its uncertainty
    lag: Mapping[int, tuple[float, float]] = field(default_factory=dict)
    # mapping of int to (str, str): by row: kind and text of a finding that a better comparison may
    # withdraw, since a vibration at a wavelength of the error looks like it
    unsure: Mapping[int, tuple[str, str]] = field(default_factory=dict)
    apart: bool = False  # whether all runs of a feedrate are displaced: no run is then to blame

    def withdrawn(self, scores: Mapping[str, list[Any]], rows: Sequence[int]) -> RunChecks:
        """Return the checks less what the prediction of each run from the others does not show."""
        if "misfit" not in scores:
            return self
        findings = list(self.columns["finding"])
        for at, row in enumerate(rows):
            kind, text = self.unsure.get(row, ("", ""))
            if not kind or not scores["misfit"][at] < _ALIKE:
                continue  # what the others predict does not hold either
            if not scores["predicted_gain"][at] > SURE * scores["u_predicted_gain"][at]:
                continue  # the fit does not see that this run shows the error of the others
            alike = kind == "shape"
            for name, column, sound in (("shift", "shift_mm", 0.0), ("gain", "gain", 1.0)):
                value, u = scores[f"predicted_{column}"][at], scores[f"u_predicted_{column}"][at]
                excluded = abs(self.columns[column][row] - value) > SURE * u
                alike |= kind == name and abs(value - sound) < _SHOWN * u and excluded
            if alike:
                findings[row] = "; ".join(p for p in findings[row].split("; ") if p != text)
        return replace(self, columns={**self.columns, "finding": findings})

    @property
    def messages(self) -> tuple[str, ...]:
        """One sentence for each finding, the runs by name."""
        rows = zip(self.columns["run"], self.columns["finding"], strict=True)
        found = [f"run {name} {part}" for name, text in rows if text for part in text.split("; ")]
        return (*found, *self.common)

    def settle(
        self, runs: RunSet, *, exclude: Named | None = None, accept: Named | None = None
    ) -> tuple[RunSet, RunChecks]:
        """Return the runs that are used, and the table with what was omitted."""
        out, kept = self._named(exclude, "exclude"), self._named(accept, "accept")
        names, findings = self.columns["run"], self.columns["finding"]
        open_ = [i for i, bad in enumerate(self.columns["refused"]) if bad and i not in out | kept]
        if open_:
            which = ", ".join(names[i] for i in open_)
            why = "; ".join(f"run {names[i]} {findings[i]}" for i in open_[:_MOST_NAMED])
            more = len(open_) - _MOST_NAMED
            why += f"; and {more} more runs: {which}" if more > 0 else ""
            raise InvalidSamplesError(
                f"no estimate can come of these readings: {why}. Leave such runs out with "
                f"exclude={which!r}, or keep them with accept={which!r}"
            ).hinting(exclude=which)
        used = [i for i in range(len(runs)) if i not in out]
        if not used:
            raise DataError(f"exclude={exclude!r} leaves no run of {len(runs)}")
        columns = {**self.columns, "used": [i not in out for i in range(len(runs))]}
        left = [f"run {names[i]} was omitted (exclude={exclude!r})" for i in sorted(out)]
        selected = (
            runs
            if not out
            else RunSet([runs[i] for i in used], metadata=runs.metadata, history=runs.history)
        )
        return selected, replace(self, columns=columns, common=(*self.common, *left))

    def _named(self, names: Named | None, option: str) -> set[int]:
        """Return the rows that an option names."""
        if names is None:
            return set()
        if isinstance(names, str):
            names = [part.strip() for part in names.split(",")]
        if not isinstance(names, Sequence):
            raise DataError(f"{option} is the name of a run, or a list of names, got {names!r}")
        found: set[int] = set()
        for name in names:
            if name == "suspect":
                found |= {i for i, text in enumerate(self.columns["finding"]) if text}
            elif str(name) in self.columns["run"]:
                found.add(self.columns["run"].index(str(name)))
            else:
                known = ", ".join(self.columns["run"])
                raise DataError(
                    f"{option}={name!r} is not a run; there are {known}, and 'suspect'"
                )
        return found


def check_runs(
    runs: RunSet,
    *,
    probes: Sequence[str] | None = None,
    spikes: bool = True,
    clocks: bool = False,
    compare: bool = True,
) -> RunChecks:
    """Return what is wrong with runs, by themselves and (`compare`) each other; with `clocks` in time.

    Notes
    -----
    Refused: a run that is stuck or at the limit of its sensor for more than 5 % of its readings,
    whose gain is off by more than a factor of 3 or RMS by more than 50, or that was given twice.
    A run of the other sign, a displaced one or a single spike is named and kept. With two runs
    that contradict each other both are refused: nothing says which is right.

    Examples
    --------
    >>> from metrosep.separation import machine_axis
    >>> check_runs(machine_axis(seed=1).runs).messages
    ()
    """
    names = list(probes) if probes is not None else [""] * len(runs)
    given = runs
    found = Findings(_labels(runs), [[] for _ in runs], [False] * len(runs))
    found.gain = np.full((len(runs), 2), np.nan)
    found.shift = np.full((len(runs), 2), np.nan)
    steps = found.steps = np.array([_check_alone(i, run, found) for i, run in enumerate(runs)])
    if all(any(text.endswith(_STUCK) for text in said) for said in found.said):
        found.said, found.refused = [[] for _ in runs], [False] * len(runs)
        found.place.clear()
        found.common.append(
            "every run reads one value only: no error and no noise, or a sensor that is not connected"
        )
    if found.lost:
        runs = RunSet(
            [
                _with_readings(run, np.where(found.lost[i], np.nan, run.z))
                if i in found.lost
                else run
                for i, run in enumerate(runs)
            ]
        )
    for probe in dict.fromkeys(names):
        _check_twice(runs, [i for i, p in enumerate(names) if p == probe], steps, found)
    rms = np.array([_rms(run) for run in runs])
    for probe in dict.fromkeys(names):
        _check_sizes(
            np.hypot(rms, steps / math.sqrt(12.0)),
            [i for i, p in enumerate(names) if p == probe],
            found,
        )
    own_clock = _check_clocks(given, found) if clocks else {}
    if found.held[0]:
        found.common.append(
            f"each reading is held for about {round(found.held[0])} samples (run {found.held[1]}): the "
            "sensor is slower than the logger, and the noise model of method='joint' takes each as "
            "measured; keep one row of each"
        )
    step, lag = 0.0, {}
    groups: dict[tuple[int, str], list[int]] = {}
    for i, run in enumerate(runs):
        groups.setdefault((run.direction, names[i]), []).append(i)
    with one_blas_thread():
        for (direction, _), members in groups.items():
            table = RunTable.of(runs, members)
            if table is None:
                continue
            own = compare_runs(runs, table, found) if compare else None
            if own is not None:
                lag[direction] = own
            step = max(step, check_steps(table, steps[members], found))
            if spikes and compare:
                check_spikes(runs, table, found)
    nowhere = (math.nan, math.nan)
    columns: dict[str, list[Any]] = {
        "run": found.labels,
        "direction": [r.direction for r in runs],
        "feed_mm_min": [math.nan if r.feed is None else r.feed * 6e4 for r in runs],
        "rms_nm": (rms * 1e9).tolist(),
        "gain": found.gain[:, 0].tolist(),
        "u_gain": found.gain[:, 1].tolist(),
        "shift_mm": (found.shift[:, 0] * 1e3).tolist(),
        "u_shift_mm": (found.shift[:, 1] * 1e3).tolist(),
        "jitter_percent": [
            100.0 * own_clock[i].jitter if i in own_clock else math.nan for i in range(len(runs))
        ],
        "n_lost": [
            own_clock[i].size - len(run) if i in own_clock else 0 for i, run in enumerate(runs)
        ],
        "at_mm": [found.place.get(i, nowhere)[0] * 1e3 for i in range(len(runs))],
        "size_nm": [found.place.get(i, nowhere)[1] * 1e9 for i in range(len(runs))],
        "finding": ["; ".join(said) for said in found.said],
        "refused": found.refused,
        "used": [True] * len(runs),
    }
    return RunChecks(columns, tuple(found.common), step, lag, found.unsure, found.apart)


def _labels(runs: RunSet) -> list[str]:
    """Return the names of the runs, or their places from 1 where names are missing or shared."""
    names = [r.run_id for r in runs]
    if all(names) and len(set(names)) == len(names):
        return names
    return [str(i + 1) for i in range(len(runs))]


def _rms(run: Run) -> float:
    """Return the RMS of a run about its line, single wrong readings cut off."""
    valid = ~np.isnan(run.z)
    x = (run.x[valid] - run.x[0]) / (run.x[-1] - run.x[0])
    flat = run.z[valid] - np.median(run.z[valid])
    line = np.column_stack([np.ones(x.size), x])
    keep = np.ones(x.size, dtype=bool)
    rest = flat
    for _ in range(2):
        rest = flat - line @ np.linalg.lstsq(line[keep], flat[keep], rcond=None)[0]
        keep = np.abs(rest) <= 2.0 * SPIKE * MAD * float(np.median(np.abs(rest)))
        if keep.sum() < 3:
            return float(np.sqrt(np.mean(rest**2)))
    rms = float(np.sqrt(np.mean(rest[keep] ** 2)))
    return rms if rms > _ROUNDING * float(np.abs(run.z[valid]).max()) else 0.0


def _check_clocks(runs: RunSet, found: Findings) -> dict[int, Clock]:
    """Return the clocks of the runs with time; refuse those that follow none."""
    clocks: dict[int, Clock] = {}
    for i, run in enumerate(runs):
        if run.t is None:
            continue
        try:
            clocks[i] = fit_clock(run)
        except NotUniformError as exc:
            found.say(i, f"cannot be used in time: {exc}", refused=True)
    found.common += clock_messages([(found.labels[i], c) for i, c in clocks.items()])
    return clocks


# --- readings of one run -------------------------------------------------------------------------


def _check_alone(index: int, run: Run, found: Findings) -> float:
    """Look for a stuck sensor and its limits; return the step of readings in steps, else 0."""
    z = run.z[~np.isnan(run.z)]
    n = z.size
    values, counts = np.unique(z, return_counts=True)
    if values.size == 1:
        found.say(index, f"reads {format_length(float(z[0]))} everywhere: {_STUCK}", refused=True)
        return 0.0
    if n < _STREAK:
        return 0.0
    lost = _markers(z, values, counts)
    if lost.any():
        valid = np.flatnonzero(~np.isnan(run.z))
        found.lost[index] = np.zeros(len(run), dtype=bool)
        found.lost[index][valid[lost]] = True
        place, value = float(run.x[valid[np.argmax(lost)]]), float(z[np.argmax(lost)])
        found.say(
            index,
            f"has {int(lost.sum())} readings of {format_length(value)}, far from all others, the first "
            f"at {format_length(place)}: dropouts or a marker of lost readings, not measured values: "
            "name the marker where the file is read (missing=, command line: --missing)",
            refused=lost.mean() > _REFUSED_SHARE,
            at=place,
            size=value,
        )
        kept = run.z.copy()
        kept[found.lost[index]] = np.nan
        return _check_alone(index, _with_readings(run, kept), found)
    streaks = _streaks(z)
    longest = int(np.argmax(streaks[:, 1]))
    first, size = (int(v) for v in streaks[longest])
    outside = np.ones(n, dtype=bool)
    outside[first : first + size] = False
    valid = np.flatnonzero(~np.isnan(run.z))
    limit = None
    for at, side in ((values.size - 1, "largest"), (0, "smallest")):
        near = counts[max(at - 3, 0) : at] if at else counts[1:4]
        same = z == values[at]
        row = int(streaks[same[streaks[:, 0]], 1].max(initial=0))
        often = counts[at] >= max(3, _LIMIT_SHARE * n) and (row >= 3 or counts[at] > 4)
        often = often and near.size == 3  # fewer values are a coarse step, not a limit
        if often and counts[at] > _LIMIT_PEAK * float(near.mean()):
            limit = limit or (side, float(values[at]), counts[at] / n)
            outside &= ~same
    step, held = _step(z, values, outside)
    if limit is not None:
        side, value, share = limit
        found.say(
            index,
            f"has {100 * share:.2g} % of its readings at the {side}, {format_length(value)}: the "
            "limit of the sensor, where no estimate is usable",
            refused=share > _REFUSED_SHARE,
            at=float(run.x[valid[np.argmax(z == value)]]),
            size=value,
        )
    elif not step and not held and _stands(z, size):
        place = float(run.x[valid[first]])
        found.say(
            index,
            f"repeats {format_length(float(z[first]))} {size} times from {format_length(place)} on: "
            "stuck there",
            refused=size > _REFUSED_SHARE * n,
            at=place,
            size=float(z[first]),
        )
    if held:
        found.held = max(found.held, (held, found.labels[index]))
    return step


def _markers(z: FloatArray, values: FloatArray, counts: NDArray[np.intp]) -> NDArray[np.bool_]:
    """Return the readings that are equal and farther from all others than these are apart."""
    if values.size > _LEAST_VALUES:
        for at, rest in ((0, values[1:]), (-1, values[:-1])):
            near = rest[0] if at == 0 else rest[-1]
            if counts[at] >= _MARKED and abs(values[at] - near) > rest[-1] - rest[0]:
                return np.asarray(z == values[at])
    return np.zeros(z.size, dtype=bool)


def _with_readings(run: Run, z: FloatArray) -> Run:
    """Return a run with other readings, for the checks."""
    return Run(run.x, z, t=run.t, feed=run.feed, run_id=run.run_id)


def _step(z: FloatArray, values: FloatArray, used: NDArray[np.bool_]) -> tuple[float, float]:
    """Return the step of readings that are multiples of one, and how long others are held, else 0."""
    same = (np.diff(z) == 0.0)[used[1:] & used[:-1]]
    repeat = float(np.mean(same)) if same.size else 0.0
    gaps = np.diff(values)
    gaps = gaps[gaps > 1e-9 * (values[-1] - values[0])]
    often = repeat > _ZERO_STEPS
    ramp = abs(float(np.median(np.diff(z))))
    for step in (float(np.median(gaps)), float(gaps.min())) if gaps.size else ():
        # A steep line alone sets the values about equally far apart.
        near = _MULTIPLE if ramp < 0.5 * step else _EXACT
        whole = np.mean(np.abs(gaps / step - np.round(gaps / step)) < near) > 0.99
        noise = MAD * float(np.median(np.abs(np.diff(z, 4)))) / math.sqrt(70.0)
        if whole and (often or step > _COARSE * noise):
            return step, 0.0
    return 0.0, 1.0 / (1.0 - repeat) if often and repeat < 1.0 else 0.0


def _stands(z: FloatArray, size: int) -> bool:
    """Return whether so many equal readings in a row are more than chance: n p^(size - 1) is rare.

    p is the share of equal neighbours beside them, one more counted: coarse readings repeat now and then.
    """
    elsewhere = int((np.diff(z) == 0.0).sum()) - (size - 1)
    p = (elsewhere + 1.0) / (z.size - size + 1.0)
    return math.log(z.size) + (size - 1) * math.log(p) < math.log(_STILL)


def _streaks(z: FloatArray) -> NDArray[np.intp]:
    """Return where stretches of equal readings begin, and their sizes."""
    edges = np.concatenate([[0], np.flatnonzero(np.diff(z) != 0.0) + 1, [z.size]])
    return np.column_stack([edges[:-1], np.diff(edges)])


def _check_twice(runs: RunSet, members: Sequence[int], steps: FloatArray, found: Findings) -> None:
    """Name runs whose readings are those of an earlier one, whole or for 20 in a row."""
    seen: dict[bytes, int] = {}
    where: dict[tuple[float, ...], tuple[int, int]] = {}
    # the same for a copy with another zero
    all_rises = {i: np.round(np.diff(runs[i].z) / _SAME) + 0.0 for i in members}
    patterns: dict[int, set[bytes]] = {}
    for rises in all_rises.values():
        patterns.setdefault(rises.size, set()).add(rises.tobytes())
    for i in members:
        run, rises = runs[i], all_rises[i]
        if np.ptp(run.z[~np.isnan(run.z)]) == 0.0:
            continue
        key, made_up = rises.tobytes(), False
        twin = seen.get(key)
        if twin is None:
            seen[key] = i
            noisy = steps[i] == 0.0 and _is_noisy(run.z)
            twin = _copied(rises, where, i) if noisy else None
            if twin is None:
                continue
            text = f"holds readings of run {found.labels[twin]}"
        else:
            text = f"is identical to run {found.labels[twin]}"
            if not np.array_equal(run.z, runs[twin].z, equal_nan=True):
                text += " but for its zero"
                # where no run differs from another, they are readings without noise, made up
                made_up = len(patterns[rises.size]) == 1
        if _is_noisy(run.z) and steps[i] == 0.0 and not made_up:
            found.say(i, f"{text}: the same readings are not a second measurement", refused=True)
        else:
            found.common.append(
                f"run {found.labels[i]} {text}: readings without noise, or copied; the "
                "uncertainty does not hold"
            )


def _copied(
    rises: FloatArray, where: dict[tuple[float, ...], tuple[int, int]], index: int
) -> int | None:
    """Return the earlier run that shares 20 rises in a row; remember those of this one."""
    # Each block of 20 of an earlier run is remembered, every start of this one is looked up: a
    # copy of 39 readings or more is found wherever it begins.
    twin = None
    if where:
        firsts = {block[0] for block in where}
        for at in np.flatnonzero(
            np.isin(rises[: rises.size - _STREAK + 1], list(firsts))
        ).tolist():
            hit = where.get(tuple(rises[at : at + _STREAK].tolist()))
            if hit is not None:
                twin = hit[0]
                break
    for at in range(0, rises.size - _STREAK + 1, _STREAK):
        block = rises[at : at + _STREAK]
        if not np.isnan(block).any() and np.ptp(block) > 0.0:
            where.setdefault(tuple(block.tolist()), (index, at))
    return twin


def _is_noisy(z: FloatArray) -> bool:
    """Whether two measurements could not agree to the last digit: fourth differences of noise."""
    fourth = np.diff(z[~np.isnan(z)], 4) / math.sqrt(70.0)
    if not fourth.size:
        return False
    # A smooth wave of 25 samples leaves 5e-4 of its RMS.
    return bool(MAD * np.median(np.abs(fourth)) > 1e-3 * float(np.nanstd(z)))


def _check_sizes(rms: FloatArray, members: Sequence[int], found: Findings) -> None:
    """Name runs whose RMS is far from that of the median run of their probe."""
    alive = [i for i in members if not found.refused[i]]
    if len(alive) < 2:
        return
    if len(alive) == 2:
        low, high = sorted(alive, key=lambda i: rms[i])
        ratio = float(rms[high] / rms[low]) if rms[low] > 0.0 else math.inf
        if rms[low] > 0.0 and ratio > _RMS_NAMED:
            text = f"reads {_factor(ratio)} times as much as run {found.labels[low]}: unit or gain"
            found.by_size[high] = f"{text} of one of them"
            found.say(high, found.by_size[high], refused=ratio > _RMS_REFUSED)
        return
    middle = float(np.median(rms[alive]))
    for i in alive if middle > 0.0 else ():
        ratio = float(rms[i]) / middle
        if not 1.0 / _RMS_NAMED <= ratio <= _RMS_NAMED:
            found.by_size[i] = (
                f"reads {_factor(ratio)} times as much as the median run: its unit, its gain or its "
                "vibration"
            )
            found.say(
                i,
                found.by_size[i],
                refused=not 1.0 / _RMS_REFUSED <= ratio <= _RMS_REFUSED,
            )


def _factor(ratio: float) -> str:
    """Return a ratio of sizes as a person writes it: 936, 1,000, 0.021."""
    return f"{ratio:,.0f}" if ratio >= 99.5 else f"{ratio:.2g}"
