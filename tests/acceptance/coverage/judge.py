"""What an estimate is worth, said by someone who knows the truth.

An estimate is anything with ``evaluate(x)``, ``sd(x)`` and, where there is one, ``covariance(x)``
(in m, at places in m, each with ``direction=``). Offset and line are removed from the error over the
judged range; where the covariance is known they are removed from it too.
"""

from __future__ import annotations

import math
import re
from dataclasses import asdict, dataclass, field

import numpy as np
from acceptance.coverage.machine import simulate
from acceptance.coverage.rows import ROWS
from scipy.signal import fftconvolve

__all__ = ["RowResult", "Score", "failures", "judge_row", "markdown", "score_set"]

POINTS = 451
EVERY = 3
"""Draws of the covariance are taken on every third place: 0.3 mm, and its factor is cheap."""
DRAWS = 200
FACTOR = 2.0

SAYS_LAG = re.compile(
    r"(readings?|reading) (lag|lead)|lag the position|lead the position", re.IGNORECASE
)
SAYS_SLIP = re.compile(r"another phase in each run", re.IGNORECASE)


@dataclass
class Score:
    """One set. Lengths in nm, times in s."""

    seed: int
    refused: str = ""
    error: float = math.nan
    sd: float = math.nan
    cover: float = math.nan
    thirds: tuple[float, ...] = (math.nan,) * 3
    ends: float = math.nan  # cover of the outer tenths
    unseen: float = 0.0  # share of the judged range without a finite estimate
    drawn: list[float] = field(default_factory=list)  # cover of draws of its own covariance
    sd_mismatch: float = math.nan  # greatest |sd(x) / sqrt(diag covariance) - 1|
    low_pass: dict[float, float] = field(default_factory=dict)  # cut-off mm: error nm
    seconds: float = math.nan
    lag_s: float = math.nan
    says_lag: bool = False
    suspects: tuple[str, ...] = ()
    says_slip: bool = False


# ---- pieces ----------------------------------------------------------------------------------------


def line_remover(x):
    """Matrix that removes offset and least-squares line."""
    basis = np.linalg.qr(np.column_stack([np.ones_like(x), x - x.mean()]))[0]
    return np.eye(x.size) - basis @ basis.T


def _weights_of_line(known):
    return known if known.any() else np.ones_like(known)


def without_line(x, z):
    """z less its line over the places where it is known; NaN stays."""
    known = _weights_of_line(np.isfinite(z))
    if known.sum() < 3:
        return z
    return z - np.polynomial.Polynomial.fit(x[known], z[known], 1)(x)


def drawn_covers(covariance, rng, n=DRAWS):
    """Covers of n errors drawn from a covariance whose line is removed."""
    size, turn = np.linalg.eigh((covariance + covariance.T) / 2.0)
    root = turn * np.sqrt(np.clip(size, 0.0, None))
    sd = np.sqrt(np.clip(np.diag(covariance), 0.0, None))
    errors = root @ rng.standard_normal((sd.size, n))
    return np.mean(np.abs(errors) < FACTOR * sd[:, None], axis=0)


def expected_worst(drawn, rng, n=4000):
    """Median and 5 % point of the least cover among sets, each with draws of its own."""
    drawn = [d for d in drawn if len(d)]
    if not drawn:
        return math.nan, math.nan
    picked = np.array([rng.choice(d, n) for d in drawn])
    low = picked.min(axis=0)
    return float(np.median(low)), float(np.quantile(low, 0.05))


CUTS_MM = (0.0, *np.geomspace(0.5, 40.0, 23))
"""Of the rival; 0 is the plain mean of the runs."""


def gaussian(x, z, cut):
    """Gaussian low-pass (ISO 16610-21 weighting, 50 % at `cut`), straight lines pass at the ends too."""
    if not cut:
        return z
    step = x[1] - x[0]
    width = math.sqrt(math.log(2.0) / math.pi) * cut
    half = min(int(3.0 * width / step) + 1, x.size - 1)
    u = np.arange(-half, half + 1) * step
    s = np.exp(-math.pi * (u / width) ** 2)

    def sums(kernel, values):
        return fftconvolve(values, kernel[::-1], mode="full")[half : half + x.size]

    one = np.ones_like(z)
    s0, s1, s2 = (sums(s * u**p, one) for p in range(3))
    t0, t1 = (sums(s * u**p, z) for p in range(2))
    return (s2 * t0 - s1 * t1) / (s2 * s0 - s1 * s1)


def mean_of_runs(runs):
    """Places in mm and the mean of the runs of one direction, offsets removed."""
    low = min(r.x_mm.min() for r in runs)
    high = max(r.x_mm.max() for r in runs)
    x = np.arange(low, high, 0.05)
    rows = []
    for r in runs:
        good = np.isfinite(r.z_nm)
        order = np.argsort(r.x_mm[good])
        z = np.interp(x, r.x_mm[good][order], r.z_nm[good][order], left=np.nan, right=np.nan)
        rows.append(z)
    rows = np.array(rows)
    common = np.isfinite(rows).all(axis=0)
    rows -= rows[:, common].mean(axis=1, keepdims=True)
    return x, np.nanmean(rows, axis=0)


def rival_errors(measured, judged_mm):
    """Error in nm of the Gaussian low-pass of the mean of the runs, for each cut-off."""
    at = np.linspace(0.0, judged_mm, POINTS)
    squares = dict.fromkeys(CUTS_MM, 0.0)
    for way, truth in measured.truths.items():
        x, z = mean_of_runs([r for r in measured.runs if r.direction == way])
        for cut in CUTS_MM:
            error = np.interp(at, x, gaussian(x, z, cut)) - truth(at)
            squares[cut] += float(np.mean(without_line(at, error) ** 2)) / len(measured.truths)
    return {cut: math.sqrt(s) for cut, s in squares.items()}


# ---- one set, one row ------------------------------------------------------------------------------


def _curve(estimate, name, x, way, ways):
    """A curve of the estimate; directions are asked for only where there are two."""
    call = getattr(estimate, name)
    return np.asarray(call(x, direction=way) if len(ways) > 1 else call(x), dtype=float)


def score_estimate(score, estimate, measured, judged_mm):
    """Fill what one estimate shows against the truth."""
    at = np.linspace(0.0, judged_mm, POINTS)
    ways = list(measured.truths)
    errors, bands, drawn = [], [], []
    for way in ways:
        value = _curve(estimate, "evaluate", at * 1e-3, way, ways) * 1e9
        sd = _curve(estimate, "sd", at * 1e-3, way, ways) * 1e9
        errors.append(without_line(at, value - measured.truths[way](at)))
        bands.append(sd)
        if hasattr(estimate, "covariance"):
            known = np.isfinite(value) & np.isfinite(sd)
            full = _curve(estimate, "covariance", at[known] * 1e-3, way, ways) * 1e18
            raw = np.sqrt(np.clip(np.diag(full), 1e-300, None))
            score.sd_mismatch = float(np.nanmax(np.abs(sd[known] / raw - 1.0)))
            full = full[::EVERY, ::EVERY]
            remove = line_remover(at[known][::EVERY])
            full = remove @ full @ remove.T
            drawn.append(drawn_covers(full, np.random.default_rng([measured.seed, 9, way + 1])))
    error, sd = np.array(errors), np.array(bands)
    known = np.isfinite(error) & np.isfinite(sd)
    inside = (np.abs(error) < FACTOR * sd) & known
    score.unseen = 1.0 - float(known.mean())
    score.error = math.sqrt(float(np.mean(error[known] ** 2)))
    score.sd = math.sqrt(float(np.mean(sd[known] ** 2)))
    score.cover = float(inside.sum() / known.sum())

    def part(low, high):
        where = (at >= low * judged_mm) & (at <= high * judged_mm)
        n = known[:, where].sum()
        return float(inside[:, where].sum() / n) if n else math.nan

    score.thirds = tuple(part(i / 3.0, (i + 1) / 3.0) for i in range(3))
    score.ends = (part(0.0, 0.1) + part(0.9, 1.0)) / 2.0
    if drawn:
        score.drawn = [float(v) for v in np.mean(drawn, axis=0)]


def said(score, estimate):
    """Fill what the estimate says in words."""
    text = " | ".join(getattr(estimate, "messages", ()))
    score.says_lag = bool(SAYS_LAG.search(text))
    score.says_slip = bool(SAYS_SLIP.search(text))
    score.lag_s = float(getattr(estimate, "lag", math.nan))
    table = getattr(estimate, "runs_data", None) or {}
    found = zip(table.get("run", ()), table.get("finding", ()), strict=True)
    score.suspects = tuple(f"{name}: {finding}" for name, finding in found if finding)


def score_set(estimator, row, seed, *, rival=True, clock=None):
    """The score of one set; a refusal is one too. Nothing is timed without a clock."""
    measured = simulate(row.machine, seed)
    score = Score(seed)
    began = clock() if clock else math.nan
    try:
        estimate = estimator(measured.runs, row.judged_mm)
    except Exception as problem:
        if not type(problem).__module__.startswith("metrosep"):
            raise
        score.refused = f"{type(problem).__name__}: {problem}"
        return score
    score.seconds = clock() - began if clock else math.nan
    score_estimate(score, estimate, measured, row.judged_mm)
    said(score, estimate)
    if rival:
        score.low_pass = rival_errors(measured, row.judged_mm)
    return score


def metrosep_joint(runs, judged_mm=None, **options):
    """The public door, with readings in the units of the logger; the range is the judged one."""
    from metrosep import Run, RunSet
    from metrosep.separation import separate

    set_ = RunSet(
        [
            Run(r.x_mm * 1e-3, r.z_nm * 1e-9, t=r.t_s, feed=r.feed_mm_s * 1e-3, run_id=r.name)
            for r in runs
        ]
    )
    if judged_mm is not None:
        options = {"start": 0.0, "length": judged_mm * 1e-3, **options}
    return separate(set_, method="joint", **options)


@dataclass
class RowResult:
    """A row over its sets."""

    name: str
    scores: list[Score]

    @property
    def done(self):
        return [s for s in self.scores if not s.refused]

    def summary(self):
        """The numbers of one line, in nm and s."""
        done = self.done
        if not done:
            return {"n": 0, "refused": len(self.scores), "why": self.scores[0].refused}
        row = ROWS[self.name]
        worst = min(done, key=lambda s: s.cover)
        median, five = expected_worst([s.drawn for s in done], np.random.default_rng(7))
        error = _rms(s.error for s in done)
        sd = _rms(s.sd for s in done)
        rivals = {c: _rms(s.low_pass[c] for s in done) for c in done[0].low_pass}
        cut = min(rivals, key=rivals.get) if rivals else math.nan
        return {
            "n": len(done),
            "refused": len(self.scores) - len(done),
            "why": next((s.refused for s in self.scores if s.refused), ""),
            "error_nm": error,
            "sd_nm": sd,
            "ratio": sd / error if error else math.inf,
            "greatest_sd_nm": max(s.sd for s in done),
            "cover": float(np.mean([s.cover for s in done])),
            "thirds": [float(np.nanmean([s.thirds[i] for s in done])) for i in range(3)],
            "ends": float(np.mean([s.ends for s in done])),
            "worst": worst.cover,
            "worst_seed": worst.seed,
            "expected_worst": median,
            "expected_worst_5": five,
            "unseen": float(np.mean([s.unseen for s in done])),
            "sd_mismatch": float(np.nanmax([0.0, *(s.sd_mismatch for s in done)])),
            "low_pass_nm": rivals.get(cut, math.nan),
            "low_pass_cut_mm": cut,
            "over_low_pass": error / rivals[cut] if rivals and rivals[cut] else math.nan,
            "seconds": float(np.mean([s.seconds for s in done])),
            "seconds_max": max(s.seconds for s in done),
            "lag_ms": float(np.mean([s.lag_s for s in done])) * 1e3,
            "lag_spread_ms": float(np.std([s.lag_s for s in done])) * 1e3,
            "lag_true_ms": row.lag_s * 1e3,
            "lag_said": sum(s.says_lag for s in done),
            "slip_said": sum(s.says_slip for s in done),
            "suspect_sets": sum(bool(s.suspects) for s in done),
            "suspects": sorted({x for s in done for x in s.suspects})[:5],
        }

    def as_dict(self):
        return {"row": self.name, **self.summary(), "sets": [asdict(s) for s in self.scores]}


def _rms(values):
    return math.sqrt(float(np.mean(np.square(list(values)))))


def judge_row(
    name, estimator=metrosep_joint, *, sets=24, seed, rival=True, clock=None, mapper=map
):
    """A row over consecutive seeds."""
    jobs = [(estimator, ROWS[name], seed + i, rival, clock) for i in range(sets)]
    return RowResult(name, list(mapper(_job, jobs)))


def _job(job):
    estimator, row, seed, rival, clock = job
    return score_set(estimator, row, seed, rival=rival, clock=clock)


# ---- the limits of the acceptance table --------------------------------------------------------------


def failures(result: RowResult):
    """Sentences with numbers, one for each limit that the row misses."""
    row, found = ROWS[result.name], result.summary()
    if not found["n"]:
        return [f"refused in all {found['refused']} sets: {found['why'][:160]}"]
    bad = []
    n, cover = found["n"], found["cover"]
    if found["refused"]:
        bad.append(f"refused in {found['refused']} sets: {found['why'][:160]}")
    if found["unseen"] > 0.0:
        bad.append(f"no estimate on {found['unseen']:.1%} of the judged range")
    if found["sd_mismatch"] > 0.01:
        bad.append(f"sd and covariance disagree by {found['sd_mismatch']:.1%}")
    if row.ends_only and found["ends"] < 0.90:
        bad.append(f"cover of the ends {found['ends']:.3f}, asked 0.90")
    most = 1.0 if row.no_geometry else 0.99
    if not row.least_cover <= cover <= most:
        bad.append(f"mean cover {cover:.3f}, asked {row.least_cover:.2f} to {most:.2f}")
    if min(found["thirds"]) < row.least_third:
        bad.append(f"cover of a third {min(found['thirds']):.3f}, asked {row.least_third:.2f}")
    five = found["expected_worst_5"]
    if math.isfinite(five) and found["worst"] < five - 0.10:
        bad.append(
            f"worst set {found['worst']:.2f} (seed {found['worst_seed']}), asked {five - 0.10:.2f}: "
            "5 % point of the expected worst less 0.10"
        )
    told = row.no_geometry or row.ratio_told_only
    if not told and not 0.85 <= found["ratio"] <= 1.4:
        bad.append(f"RMS sd over RMS error {found['ratio']:.2f}, asked 0.85 to 1.4")
    if row.greatest_sd_nm and found["greatest_sd_nm"] > row.greatest_sd_nm:
        bad.append(f"sd {found['greatest_sd_nm']:.3g} nm in a set, asked {row.greatest_sd_nm} nm")
    if row.lag_s >= 0.99e-3:
        chance = 2.0 * found["lag_spread_ms"] / math.sqrt(n)  # of a mean over these sets
        if not abs(found["lag_ms"] - found["lag_true_ms"]) <= 0.05 * found["lag_true_ms"] + chance:
            bad.append(
                f"lag {found['lag_ms']:.3f} ms on average, true {found['lag_true_ms']:.3f}, asked "
                f"5 % and {chance:.3f} ms for chance"
            )
    if not row.no_geometry and found["over_low_pass"] > 1.1:
        bad.append(
            f"error {found['over_low_pass']:.2f} times that of the best Gaussian low-pass "
            f"({found['low_pass_nm']:.3g} nm at {found['low_pass_cut_mm']:.2g} mm), asked 1.1"
        )
    allowed = max(1, n // 50)
    if row.clean and found["lag_said"] > allowed:
        bad.append(f"false lag message in {found['lag_said']} of {n} sets")
    if not row.slip and found["slip_said"] > allowed:
        bad.append(f"false slip in {found['slip_said']} of {n} sets")
    if row.slip and found["slip_said"] < n:
        bad.append(f"slip found in {found['slip_said']} of {n} sets")
    if row.clean and found["suspect_sets"] > allowed:
        bad.append(
            f"false suspects in {found['suspect_sets']} of {n} sets: {found['suspects'][:2]}"
        )
    return bad


HEAD = (
    "| truth / noise | n | error (sd) nm | sd/error | cover of thirds | mean | worst; expected (5 %) "
    "| low-pass nm, mm | ratio | time, max, s of one core | lag ms | lag, slip, suspect said | fails |\n"
    "|---|---|---|---|---|---|---|---|---|---|---|---|---|\n"
)


def markdown(result: RowResult):
    """The line of a row."""
    s = result.summary()
    bad = "; ".join(failures(result)) or "-"
    if not s["n"]:
        return f"| {result.name} | 0 | | | | | | | | | | | FAIL: {bad} |"
    thirds = " ".join(f"{v:.2f}" for v in s["thirds"])
    return (
        f"| {result.name} | {s['n']} | {s['error_nm']:.3g} ({s['sd_nm']:.3g}) | {s['ratio']:.2f} "
        f"| {thirds} | {s['cover']:.3f} "
        f"| {s['worst']:.2f}; {s['expected_worst']:.2f} ({s['expected_worst_5']:.2f}) "
        f"| {s['low_pass_nm']:.3g}, {s['low_pass_cut_mm']:.2g} | {s['over_low_pass']:.2f} "
        f"| {s['seconds']:.2f}, {s['seconds_max']:.2f} "
        f"| {s['lag_ms']:.3f} +- {s['lag_spread_ms']:.3f} "
        f"| {s['lag_said']}, {s['slip_said']}, {s['suspect_sets']} "
        f"| {'FAIL: ' if bad != '-' else ''}{bad} |"
    )
