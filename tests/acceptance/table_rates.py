"""How often a table that harms a machine is accepted, and a right one refused: drawn machines.

A machine is a formula: two to five waves, and a line for positioning. Its runs are the formula with
one of six kinds of noise. A table comes from elsewhere as the bytes of a LinuxCNC file that are
printed here (nominal, nominal minus correction), right or spoilt; or it is made of the runs and
written by `metrosep.controllers.write`. metrosep judges; whether the machine is worse is computed here
from the bytes and the formula, by numpy alone.

Harmful: RMS or P-V of the true error up by more than 5 %. The moved zero counts (RMS: added in
quadrature; P-V: the value 0 belongs to the set); of straightness the line is alignment.
"""

from __future__ import annotations

import dataclasses
import re
import tempfile
from collections import Counter, defaultdict
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from metrosep import Run, RunSet, controllers
from metrosep.compensation import CompensationTable
from metrosep.errors import InconclusiveTableError, PointlessTableError, SignCheckFailedError

NOISES = ("tuned", "slope", "AR(1)", "t, 3", "one sine", "fixed sine")
RUNS = (1, 2, 3, 5, 10)
MADE_OF = (2, 3, 5, 10)
RATIOS = (0.05, 0.4, 2.5, 20.0)
"""Amplitude over noise of the cells of true tables."""
CORRUPTIONS = (
    "tilt", "gain", "shift", "offset", "another axis", "unit", "sign", "stale", "spike"
)  # fmt: skip
WORSE = 1.05
AMPLITUDE, RMS = 0.7e-6, 0.5e-6
READINGS, DENSE = 401, 1601
WRONG_SIGN = re.compile(r"(wrong|reversed) sign|sign\b.*\bwrong")


@dataclass(frozen=True)
class Geometry:
    """Travel in m and entries of the tables; the readings are 401."""

    travel: float = 0.160
    entries: int = 81

    @property
    def x(self):
        return np.linspace(0.0, self.travel, READINGS)

    @property
    def places(self):
        return np.linspace(0.0, self.travel, self.entries)


SPEC = Geometry()


# ---- the machine -----------------------------------------------------------------------------------


def drawn_error(rng, geometry, *, on_axis):
    """Return an error as a function of position: waves of 0.5 um RMS, and a line of um for pitch."""
    n = int(rng.integers(2, 6))
    # the shortest wave has eight entries: linear pieces then miss less than 8 % of it
    shortest = max(geometry.travel / 16.0, 8.0 * geometry.travel / (geometry.entries - 1))
    lengths = np.exp(rng.uniform(np.log(shortest), np.log(geometry.travel), n))
    sizes, phases = rng.normal(0.0, 1.0, n), rng.uniform(0.0, 2.0 * np.pi, n)
    slope = rng.normal(0.0, 1.5e-6) / geometry.travel if on_axis else 0.0

    def waves(p):
        return np.sin(2.0 * np.pi * np.divide.outer(p, lengths) + phases) @ sizes

    size = RMS / np.std(waves(np.linspace(0.0, geometry.travel, DENSE)))
    return lambda p: size * waves(np.asarray(p)) + slope * np.asarray(p)


def drawn_noise(kind, rng, x, n, s):
    """Return the noise of n runs, shape (n, x.size); each run has a zero of its own."""
    travel = x[-1] - x[0]
    white = rng.normal(0.0, s, (n, x.size))
    zeros = rng.normal(0.0, 3.0 * s, (n, 1))
    walk = rng.uniform(0.0, 0.7) * s * np.cumsum(rng.normal(size=white.shape), axis=1)
    walk /= np.sqrt(x.size)
    if kind == "tuned":
        return zeros + white + walk
    if kind == "slope":  # temperature: the first that runs of one axis differ by
        line = (x - x.mean()) / x.std()
        size = s * np.exp(rng.uniform(np.log(0.3), np.log(3.0)))
        return zeros + white + walk + np.multiply.outer(rng.normal(0.0, size, n), line)
    if kind == "AR(1)":
        from scipy.signal import lfilter

        start = rng.normal(0.0, s, (n, 1))
        driven = np.concatenate([start, np.sqrt(1.0 - 0.95**2) * white[:, 1:]], axis=1)
        return zeros + lfilter([1.0], [1.0, -0.95], driven, axis=1)
    if kind == "t, 3":
        return zeros + s * rng.standard_t(3, white.shape)
    lengths = np.exp(rng.uniform(np.log(travel / 80.0), np.log(travel), (n, 1)))
    if kind == "fixed sine":  # a vibration at one feed: its place differs from run to run
        lengths = np.full((n, 1), lengths[0, 0])
    phases = rng.uniform(0.0, 2.0 * np.pi, (n, 1))
    return zeros + 0.3 * white + np.sqrt(2.0) * s * np.sin(2.0 * np.pi * x / lengths + phases)


@dataclass
class Machine:
    """A drawn machine with its runs."""

    error: object
    rows: np.ndarray
    on_axis: bool
    geometry: Geometry

    @property
    def runs(self):
        x = self.geometry.x
        return RunSet([Run(x, z, run_id=f"run{k}") for k, z in enumerate(self.rows)])


def drawn_machine(rng, noise, *, runs, ratio, on_axis, geometry=SPEC):
    error = drawn_error(rng, geometry, on_axis=on_axis)
    x = geometry.x
    rows = error(x) + drawn_noise(noise, rng, x, runs, AMPLITUDE / ratio)
    return Machine(error, rows, on_axis, geometry)


# ---- the truth -------------------------------------------------------------------------------------


def without_line(e, x):
    return e - np.polyval(np.polyfit(x - x.mean(), e, 1), x - x.mean())


def harm(machine, places, corrections):
    """Return true RMS and P-V with the table over those without it."""
    x = np.linspace(0.0, machine.geometry.travel, DENSE)
    c = np.interp(x, places, corrections)
    zero = float(np.interp(0.0, places, corrections))
    before = machine.error(x)
    off = before.mean() if machine.on_axis else before - without_line(before, x)
    stands = x + c if machine.on_axis else x
    after = machine.error(stands) - off + c - c.mean()
    before = before - off
    rms = np.sqrt(np.mean(after**2) + zero**2) / np.sqrt(np.mean(before**2))
    # rounding of the file to 1e-9 mm is no moved zero
    high = np.ptp(np.append(after + zero, 0.0)) if abs(zero) > 2e-12 else np.ptp(after)
    return float(rms), float(high / np.ptp(before))


def right_table(machine):
    """Return the corrections that the true error asks for, zero at 0."""
    x, p = machine.geometry.x, machine.geometry.places
    e = machine.error(x)
    if not machine.on_axis:
        e = without_line(e, x)
    c = -np.interp(p, x, e)
    return c - c[0]


def spoilt_table(kind, machine, rng):
    """Return corrections that are wrong in a way that happens."""
    geometry, c = machine.geometry, right_table(machine)
    p, sign = geometry.places, rng.choice([-1.0, 1.0])

    def spread(low, high):
        return float(np.exp(rng.uniform(np.log(low), np.log(high))))

    def other():
        drawn = Machine(
            drawn_error(rng, geometry, on_axis=machine.on_axis), machine.rows, machine.on_axis, geometry
        )  # fmt: skip
        return right_table(drawn)

    if kind == "tilt":
        return c + sign * spread(1.5e-6, 2e-3) * p / geometry.travel
    if kind == "gain":
        return c * (rng.uniform(2.1, 10.0) if sign > 0 else rng.uniform(-3.0, -0.2))
    if kind == "shift":
        late = np.interp(p - sign * rng.uniform(0.2, 0.9) * geometry.travel, p, c)
        return late - late[0]
    if kind == "offset":
        return c + sign * spread(0.8e-6, 100e-6)
    if kind == "unit":
        return c * rng.choice([1000.0, 25.4, 57.3, 2.0]) ** sign
    if kind == "sign":
        return -c
    if kind == "stale":  # the machine has changed since
        return c + rng.uniform(0.5, 2.5) * other()
    return other()


# ---- judged by metrosep ----------------------------------------------------------------------------


def printed(path, places, corrections):
    """Write a file as the manual of LinuxCNC describes it, in mm."""
    path.write_text(
        "".join(
            f"{1e3 * a:.6f} {1e3 * (a - c):.9f} {1e3 * (a - c):.9f}\n"
            for a, c in zip(places, corrections, strict=True)
        )
    )


def looked_up(path):
    """Return what a file adds, by the same manual."""
    nominal, column, _ = np.loadtxt(path).T
    return 1e-3 * nominal, 1e-3 * (nominal - column)


@dataclass
class Said:
    """What metrosep said of one table."""

    grade: str
    text: str
    is_reversed: bool = False


def judge_file(path, machine):
    """Return what is said of a file against runs that did not make it."""
    table = controllers.read(path, "linuxcnc", linear_units="mm")
    if not machine.on_axis:
        table = dataclasses.replace(table, compensates="Z", removed="line")
    found = controllers.dry_run_carried(
        table, controllers.simulate(path, "linuxcnc", linear_units="mm"), machine.runs
    )
    text = " ".join((*found.sentences, found.diagnosis, *(f.problem for f in found.findings)))
    return Said(found.grade, text, found.is_reversed)


REFUSALS = {
    SignCheckFailedError: "refused",
    InconclusiveTableError: "inconclusive",
    PointlessTableError: "pointless",
}


def write_made(path, machine):
    """Write the table of the mean of the runs, each left out once; return what is said."""
    x, p = machine.geometry.x, machine.geometry.places

    def table_of(rows):
        mean = rows.mean(axis=0)
        mean = mean - mean.mean() if machine.on_axis else without_line(mean, x)
        return CompensationTable.from_error(
            lambda q: np.interp(q, x, mean), positions=p, axis="X", exact=False,
            compensates="X" if machine.on_axis else "Z",
        )  # fmt: skip

    n = len(machine.rows)
    folds = [((k,), table_of(np.delete(machine.rows, k, axis=0))) for k in range(n)]
    for old in (path, path.with_name(path.name + ".json")):
        old.unlink(missing_ok=True)
    try:
        controllers.write(
            table_of(machine.rows), path, "linuxcnc",
            verified_against=machine.runs, folds=folds, cross_axis="hal",
        )  # fmt: skip
    except tuple(REFUSALS) as refusal:
        return Said(REFUSALS[type(refusal)], str(refusal))
    return Said("accepted", "")


# ---- the three populations -------------------------------------------------------------------------


@dataclass(frozen=True)
class Outcome:
    """One table."""

    population: str  # "corrupted", "true" or "made"
    noise: str
    kind: str  # which corruption, or ""
    on_axis: bool
    runs: int
    ratio: float
    grade: str
    rms: float  # true RMS and P-V with the table over those without
    pv: float
    says_wrong_sign: bool

    @property
    def harmful(self):
        return self.rms > WORSE or self.pv > WORSE


def one(population, noise, i, seed, geometry, folder):
    """Return what becomes of the i-th table of a population."""
    rng = np.random.default_rng(
        [seed, NOISES.index(noise), ("corrupted", "true", "made").index(population), i]
    )
    ratio = float(np.exp(rng.uniform(np.log(0.25), np.log(40.0))))
    runs, on_axis, kind = int(rng.choice(RUNS)), bool(rng.integers(2)), ""
    if population == "corrupted":
        kind = CORRUPTIONS[i % len(CORRUPTIONS)]
    elif population == "made":
        runs, on_axis = MADE_OF[i % len(MADE_OF)], bool(i // len(MADE_OF) % 2)
    else:
        cell, ratio = i // len(RATIOS), RATIOS[i % len(RATIOS)]
        runs, on_axis = RUNS[cell % len(RUNS)], bool(cell // len(RUNS) % 2)
    if kind == "spike" and runs == 1:
        runs = int(rng.choice(MADE_OF))
    machine = drawn_machine(rng, noise, runs=runs, ratio=ratio, on_axis=on_axis, geometry=geometry)
    path = Path(folder) / "x.comp"
    if kind == "spike":
        wide, first = int(rng.integers(1, 9)), int(rng.integers(0, READINGS - 9))
        height = rng.choice([-1.0, 1.0]) * np.exp(rng.uniform(np.log(3e-6), np.log(30e-6)))
        machine.rows[int(rng.integers(runs)), first : first + wide] += height
    if kind == "spike" or population == "made":
        said = write_made(path, machine)
        rms = pv = np.nan
        if said.grade == "accepted":
            rms, pv = harm(machine, *looked_up(path))
        elif kind:  # of the table that was not written, made by the same arithmetic here
            rms, pv = harm(machine, *mean_table(machine))
    else:
        c = right_table(machine) if population == "true" else spoilt_table(kind, machine, rng)
        path.with_name("x.comp.json").unlink(missing_ok=True)
        printed(path, machine.geometry.places, c)
        said = judge_file(path, machine)
        rms, pv = harm(machine, *looked_up(path))
    wrong = said.is_reversed or bool(WRONG_SIGN.search(said.text))
    return Outcome(population, noise, kind, on_axis, runs, ratio, said.grade, rms, pv, wrong)


def mean_table(machine):
    x, p = machine.geometry.x, machine.geometry.places
    mean = machine.rows.mean(axis=0)
    c = -np.interp(p, x, mean if machine.on_axis else without_line(mean, x))
    return p, c - c[0]


CELLS = 2 * len(RUNS) * len(RATIOS)
"""Cells of true tables: pitch and straightness, runs, amplitude over noise."""


def outcomes(job):
    """Return the outcomes of one job: (population, noise, first, last, seed, geometry)."""
    population, noise, first, last, seed, geometry = job
    with tempfile.TemporaryDirectory() as folder:
        return [one(population, noise, i, seed, geometry, folder) for i in range(first, last)]


def jobs(counts, noises, seed, geometry=SPEC, chunk=40):
    """Return the jobs of populations, {name: number for each noise}."""
    return [
        (population, noise, first, min(first + chunk, n), seed, geometry)
        for population, n in counts.items()
        for noise in noises
        for first in range(0, n, chunk)
    ]


# ---- the table -------------------------------------------------------------------------------------


def worst_cell(found, least=1):
    """Return refused and size of the worst cell of true tables, of those with `least` runs and more."""
    cells = defaultdict(list)
    for o in found:
        if o.runs < least:
            continue
        cells[o.on_axis, o.runs, o.ratio].append(o.grade == "refused")
    return max(((sum(c), len(c)) for c in cells.values()), key=lambda c: c[0] / c[1])


def summary(found):
    """Return the numbers of one kind of noise."""
    spoilt = [o for o in found if o.population == "corrupted"]
    true = [o for o in found if o.population == "true"]
    made = [o for o in found if o.population == "made"]
    written = [o for o in made if o.grade == "accepted"]
    result = {
        "corrupted": len(spoilt),
        "harmful": sum(o.harmful for o in spoilt),
        "harmful_accepted": sum(o.harmful and o.grade == "accepted" for o in spoilt),
        "harmful_accepted_kinds": dict(
            Counter(o.kind for o in spoilt if o.harmful and o.grade == "accepted")
        ),
        # a negative gain is a wrong sign of another size: the words are right there
        "wrong_sign_of_another": sum(
            o.says_wrong_sign and o.kind not in ("sign", "gain") for o in spoilt
        ),
        "sign": sum(o.kind == "sign" for o in spoilt),
        "wrong_sign_of_sign": sum(o.says_wrong_sign and o.kind == "sign" for o in spoilt),
        "true": len(true),
        "true_refused": sum(o.grade == "refused" for o in true),
        "true_worst_cell": list(worst_cell(true)) if true else [0, 0],
        "true_worst_cell_5": list(worst_cell(true, 5)) if true else [0, 0],
        "true_wrong_sign": sum(o.says_wrong_sign for o in true),
        "true_grades": dict(Counter(o.grade for o in true)),
        "made": len(made),
    }
    for n in MADE_OF:
        of = [o for o in written if o.runs == n]
        result[f"made_{n}"] = [
            len(of), sum(o.rms > WORSE for o in of), sum(o.pv > WORSE for o in of),
            sum(o.harmful for o in of),
        ]  # fmt: skip
    return result


def markdown(summaries):
    """Return the table of the rates, a column for each kind of noise."""
    rows = {
        "corrupted / harmful / harmful and accepted": lambda s: (
            f"{s['corrupted']} / {s['harmful']} / **{s['harmful_accepted']}**"
        ),
        '"wrong sign" said of another corruption': lambda s: f"{s['wrong_sign_of_another']}",
        '"wrong sign" said of a wrong sign': lambda s: f"{s['wrong_sign_of_sign']} of {s['sign']}",
        "true tables: refused / worst cell": lambda s: (
            f"{s['true_refused']} of {s['true']} / {s['true_worst_cell'][0]} of "
            f"{s['true_worst_cell'][1]}"
        ),
        "the same, worst cell of 5 runs and more": lambda s: (
            f"{s['true_worst_cell_5'][0]} of {s['true_worst_cell_5'][1]}"
        ),
        "true tables called wrong sign": lambda s: f"{s['true_wrong_sign']}",
    }
    for n in MADE_OF:
        rows[f"made of {n} runs: accepted / RMS up / P-V up"] = lambda s, n=n: " / ".join(
            map(str, s[f"made_{n}"][:3])
        )
    lines = ["| quantity | " + " | ".join(summaries) + " |", "|---" * (len(summaries) + 1) + "|"]
    lines += [
        f"| {name} | " + " | ".join(text(s) for s in summaries.values()) + " |"
        for name, text in rows.items()
    ]
    return "\n".join(lines)


def missed(summaries):
    """Return the figures that are not reached, as sentences.

    Of a disturbance of fixed wavelength only what 5 runs and more show counts: with fewer it cannot be
    told from geometry, and the report says so. Of tables from elsewhere it may let 2 of 1000 pass.
    """
    found = []
    for noise, s in summaries.items():
        # one run under a sine as large as the error confirms whatever has its wavelength and phase
        if s["harmful_accepted"] > (
            max(1.0, 0.002 * s["harmful"]) if noise == "fixed sine" else 0.0
        ):
            kinds = s["harmful_accepted_kinds"]
            found.append(f"{noise}: {s['harmful_accepted']} harmful tables accepted ({kinds})")
        if s["true_wrong_sign"]:
            found.append(f"{noise}: {s['true_wrong_sign']} true tables called wrong sign")
        least = 5 if noise == "fixed sine" else 3
        refused, size = s["true_worst_cell_5" if least == 5 else "true_worst_cell"]
        limit = 0.03 if noise == "t, 3" else 0.02
        # two refusals in a cell are not a rate
        if refused > max(2.0, limit * size):
            found.append(f"{noise}: {refused} of {size} true tables of one cell refused")
        accepted = sum(s[f"made_{n}"][0] for n in MADE_OF if n >= least)
        harmful = sum(s[f"made_{n}"][3] for n in MADE_OF if n >= least)
        if harmful > max(1.0, 0.005 * accepted):
            found.append(
                f"{noise}: {harmful} of {accepted} tables made of {least} runs and more harm"
            )
        if s["made_2"][0]:
            found.append(f"{noise}: {s['made_2'][0]} tables made of 2 runs accepted")
    return found
