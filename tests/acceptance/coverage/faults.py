"""Sets in which one thing is wrong, what is expected to be said, and how often it is.

A fault changes readings as a logger or a person would have spoilt them. It is *named* if the right
run is named with the right kind (and, where there is one, the right size within `SIZES` of its own
u or a stated floor), *found* if that run is named in other words, *refused* if no estimate is made
for this reason, *missed* if neither.
"""

from __future__ import annotations

import re
from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from acceptance.coverage.machine import simulate
from acceptance.coverage.rows import BASE, ROWS

__all__ = ["FAULTS", "Fault", "false_alarms", "fault_table", "try_fault"]

SIZES = 4.0
"""Of its own u that a stated size may be off."""

NAME = "120-2"
"""The run that is spoilt: not the first, not the last, not of the slowest feed."""

CLEAN_ROWS = [
    n
    for n, r in ROWS.items()
    if r.clean
    and not r.slip
    and n not in ("drift", "unequal 12 mm", "jitter 30 %", "runs displaced .1 mm")
]


def _with(runs, name, **changes):
    return [replace(r, **changes) if r.name == name else r for r in runs]


def _run(runs, name=NAME):
    return next(r for r in runs if r.name == name)


def gain(factor, name=NAME):
    return lambda runs, rng: _with(runs, name, z_nm=factor * _run(runs, name).z_nm)


def displaced(mm, name=NAME):
    """The encoder of this run reads so much too far: the error stands at a greater x."""
    return lambda runs, rng: _with(runs, name, x_mm=_run(runs, name).x_mm + mm)


def displaced_feed(mm, feed=120.0):
    return lambda runs, rng: [
        replace(r, x_mm=r.x_mm + mm) if r.feed_mm_s == feed else r for r in runs
    ]


def all_displaced(mm):
    """Each run starts at its own place: a trigger or a home position that scatters."""
    return lambda runs, rng: [replace(r, x_mm=r.x_mm + mm * rng.standard_normal()) for r in runs]


def stuck(share):
    def spoil(runs, rng):
        z = _run(runs).z_nm.copy()
        n = int(share * z.size)
        first = int(rng.uniform(0.2, 0.6) * (z.size - n))
        z[first : first + n] = z[first]
        return _with(runs, NAME, z_nm=z)

    return spoil


def clipped(share):
    """The sensor's limit lies so low that this share of the readings reaches it."""

    def spoil(runs, rng):
        z = _run(runs).z_nm
        return _with(runs, NAME, z_nm=np.minimum(z, np.quantile(z, 1.0 - share)))

    return spoil


def twice(runs, rng):
    other = _run(runs, "120-1")
    return _with(runs, NAME, z_nm=other.z_nm.copy(), x_mm=other.x_mm.copy(), t_s=other.t_s.copy())


def quantised(step_nm):
    return lambda runs, rng: [replace(r, z_nm=step_nm * np.round(r.z_nm / step_nm)) for r in runs]


def spikes(count, size_nm):
    def spoil(runs, rng):
        z = _run(runs).z_nm.copy()
        z[rng.choice(z.size, count, replace=False)] += size_nm * rng.choice([-1, 1], count)
        return _with(runs, NAME, z_nm=z)

    return spoil


def dropouts(count):
    """The logger writes 0 where it lost a reading; the probe stands at 20 um."""

    def spoil(runs, rng):
        runs = [replace(r, z_nm=r.z_nm + 20_000.0) for r in runs]
        z = _run(runs).z_nm.copy()
        z[rng.choice(z.size, count, replace=False)] = 0.0
        return _with(runs, NAME, z_nm=z)

    return spoil


def drift_step(size_nm):
    def spoil(runs, rng):
        z = _run(runs).z_nm.copy()
        z[int(rng.uniform(0.3, 0.7) * z.size) :] += size_nm
        return _with(runs, NAME, z_nm=z)

    return spoil


def of_another_machine(runs, rng):
    other = simulate(BASE, int(rng.integers(10**6, 10**7)))
    return _with(runs, NAME, z_nm=_run(other.runs).z_nm)


def twice_the_noise(runs, rng):
    """Not a fault: nothing may be named that is not there."""
    other = simulate(replace(BASE, waves=()), int(rng.integers(10**6, 10**7)))
    return _with(runs, NAME, z_nm=_run(runs).z_nm + np.sqrt(3.0) * _run(other.runs).z_nm)


def mirrored(runs, rng):
    """The readings of one run in the order of falling positions, the positions not."""
    return _with(runs, NAME, z_nm=_run(runs).z_nm[::-1].copy())


def all_mirrored(runs, rng):
    """Every run in another coordinate, x to L - x and way back: nothing is wrong."""
    return [replace(r, x_mm=56.0 - r.x_mm, direction=-r.direction) for r in runs]


@dataclass(frozen=True)
class Fault:
    """What is done to a clean set, and what must be said of it."""

    name: str
    spoil: Callable
    kind: str  # pattern of the words that name it; "" if nothing may be named
    run: str = NAME  # "": the set as a whole
    size: float | None = None  # of the gain, or in mm
    floor: float = 0.0  # error of the size that is allowed beside its u
    must_refuse: bool = False
    may_pass: bool = False  # below five of its u: saying nothing is right too


SHIFT_KIND = r"displaced"
FAULTS = [
    Fault("sign", gain(-1.0), r"opposite sign", size=-1.0, floor=0.1),
    Fault("gain 0.5", gain(0.5), r"gain", size=0.5, floor=0.1),
    Fault("gain 2", gain(2.0), r"gain", size=2.0, floor=0.2),
    Fault("gain 10", gain(10.0), r"has the gain (9|10)\.", must_refuse=True),
    Fault("gain 1000 (unit)", gain(1000.0), r"gain|unit", must_refuse=True),
    Fault("all but one in another unit", lambda runs, rng: [replace(r, z_nm=r.z_nm * 1000.0) if r.name != NAME else r for r in runs], r"gain|unit", run="", must_refuse=True),
    *(
        Fault(f"run displaced {mm} mm", displaced(mm), SHIFT_KIND, size=mm, floor=0.01, may_pass=mm <= 0.1 and mm > 0)
        for mm in (0.05, 0.1, 0.2, 0.5, -0.5, 1.0, 2.0)
    ),
    *(
        Fault(f"feed displaced {mm} mm", displaced_feed(mm), SHIFT_KIND, run="7200 mm/min", size=mm, floor=0.01)
        for mm in (0.2, 0.5, -1.0)
    ),
    Fault("every run displaced, sd 0.15 mm", all_displaced(0.15), r"lie apart along the axis", run=""),
    Fault("stuck 3 %", stuck(0.03), r"repeats|stuck|stand"),
    Fault("stuck 20 %", stuck(0.2), r"repeats|stuck|stand", must_refuse=True),
    Fault("stuck wholly", lambda runs, rng: _with(runs, NAME, z_nm=np.full_like(_run(runs).z_nm, 77.0)), r"stuck|everywhere", must_refuse=True),
    Fault("clipped 2 %", clipped(0.02), r"limit|largest"),
    Fault("clipped 22 %", clipped(0.22), r"limit|largest", must_refuse=True),
    Fault("given twice", twice, r"identical|same readings|holds readings", must_refuse=True),
    Fault("steps of 800 nm", quantised(800.0), r"steps of", run=""),
    Fault("steps of 20 nm", quantised(20.0), "", run=""),
    Fault("5 spikes of 3 um", spikes(5, 3000.0), r"spike"),
    Fault("8 dropouts to 0 of 20 um", dropouts(8), r"dropouts"),
    Fault("step of drift 1 um", drift_step(1000.0), r"jumps by -?(9\d\d(\.\d)? nm|1(\.0\d*)? um)"),
    Fault("of another machine", of_another_machine, r"differs|gain|displaced|others|not agree"),
    Fault("twice the noise", twice_the_noise, ""),
    Fault("readings reversed in one run", mirrored, r"mirrored"),
    Fault("all mirrored", all_mirrored, "", run=""),
]  # fmt: skip


UNITS_MM = {"mm": 1.0, "um": 1e-3, "\N{GREEK SMALL LETTER MU}m": 1e-3, "nm": 1e-6, "m": 1e3}
NUMBER = r"(-?[\d.]+(?:e-?\d+)?)"


def stated_size(text):
    """A gain or a displacement in mm, and its u, as a sentence states them; None if it does not."""
    found = re.search(rf"gain {NUMBER} \(u {NUMBER}", text)
    if found:
        return float(found[1]), float(found[2])
    unit = r"(mm|um|\u03bcm|nm|m)\b"
    found = re.search(rf"displaced by {NUMBER} {unit} \(u {NUMBER} {unit}", text)
    if found:
        return float(found[1]) * UNITS_MM[found[2]], float(found[3]) * UNITS_MM[found[4]]
    return None


def sentences_about(fault, messages):
    """Sentences that name the run (or the whole set)."""
    whose = {"": ""}.get(fault.run, fault.run)
    return [
        m for m in messages if re.search(rf"(?<![\w-]){re.escape(whose)}(?![\w-])", m) or not whose
    ]


def runs_named(messages):
    """Runs, or feedrates, of the messages that begin with a finding about one."""
    pattern = r"run ([\w.-]+)(?!\S)(?! was omitted)|the runs at (\S+ mm/min) are displaced"
    found = (re.match(pattern, text) for text in messages)
    return {m[1] or m[2] for m in found if m}


def try_fault(fault, estimator, seed):
    """Verdict and the sentence behind it: named, found, refused, missed, false, quiet."""
    clean = simulate(BASE, seed).runs
    runs = fault.spoil(clean, np.random.default_rng([seed, 5]))
    try:
        messages = list(estimator(runs).messages)
        refused = ""
    except Exception as problem:
        if not type(problem).__module__.startswith("metrosep"):
            raise
        refused, messages = str(problem), []
    if not fault.kind:
        alarm = refused or next((m for m in messages if runs_named([m])), "")
        return ("false" if alarm else "quiet"), alarm
    if refused:
        fits = re.search(fault.kind, refused) and (not fault.run or fault.run in refused)
        return ("refused" if fits else "found"), refused
    about = sentences_about(fault, messages)
    right = [m for m in about if re.search(fault.kind, m)]
    if not right:
        named = [m for m in about if fault.run and runs_named([m])]
        return ("found", named[0]) if named else ("missed", " | ".join(messages)[:200])
    others = runs_named(messages) - {fault.run}
    if others:
        return "found", f"also {sorted(others)}: {right[0]}"
    if fault.size is not None:
        size = stated_size(right[0])
        if size is None or abs(size[0] - fault.size) > SIZES * size[1] + fault.floor:
            return "found", f"size {size}, true {fault.size}: {right[0]}"
    return "named", right[0]


HEAD = (
    "| fault | named | refused | found | missed | false | example |",
    "|---|---|---|---|---|---|---|",
)


def fault_table(estimator, *, sets, seed, faults=FAULTS, say=lambda line: None):
    """Lines of a Markdown table, each given to `say` as it comes, and the verdicts by fault."""
    lines = list(HEAD)
    counts = {}
    for line in lines:
        say(line)
    for fault in faults:
        got = [try_fault(fault, estimator, seed + i) for i in range(sets)]
        count = {
            v: sum(g[0] == v for g in got)
            for v in ("named", "refused", "found", "missed", "false", "quiet")
        }
        counts[fault.name] = count
        worst = next(
            (g[1] for v in ("missed", "false", "found") for g in got if g[0] == v), got[0][1]
        )
        cells = [str(count[v] or "") for v in ("named", "refused", "found", "missed", "false")]
        if not fault.kind:
            cells[0] = "nothing to name"
        lines.append(f"| {fault.name} | {' | '.join(cells)} | {worst[:150].replace('|', '/')} |")
        say(lines[-1])
    return lines, counts


def fault_failures(counts):
    """Sentences for what is missed, not refused, or named where nothing is."""
    bad = []
    for fault in FAULTS:
        count = counts.get(fault.name)
        if count is None:
            continue
        n = sum(count.values())
        if not fault.kind and count["false"]:
            bad.append(f"{fault.name}: named in {count['false']} of {n} sets, nothing is wrong")
        if fault.kind and fault.must_refuse and count["refused"] < n:
            bad.append(f"{fault.name}: refused in {count['refused']} of {n} sets")
        if fault.kind and not fault.must_refuse and not fault.may_pass and count["missed"]:
            bad.append(f"{fault.name}: missed in {count['missed']} of {n} sets")
    return bad


def false_alarms(estimator, *, sets, seed, say=lambda row, seed, text: None):
    """Sets of all clean rows in turn that are refused or in which a run is named: (row, seed, text)."""
    found = []
    for i in range(sets):
        name = CLEAN_ROWS[i % len(CLEAN_ROWS)]
        try:
            messages = list(estimator(simulate(ROWS[name].machine, seed + i).runs).messages)
        except Exception as problem:
            if not type(problem).__module__.startswith("metrosep"):
                raise
            found.append((name, seed + i, f"refused: {problem}"))
            say(*found[-1])
            continue
        alarm = [m for m in messages if runs_named([m])]
        if alarm:
            found.append((name, seed + i, alarm[0]))
            say(*found[-1])
    return found
