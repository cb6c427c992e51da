"""Private: from a start to the tool setting of the smallest residual, in the right period, with its noise."""

from __future__ import annotations

import itertools
import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from metrosep.core._arrays import FloatArray
from metrosep.core.blas import one_blas_thread
from metrosep.core.errors import (
    DegenerateFitError,
    MetrosepError,
    NotConvergedError,
    TooFewSamplesError,
)
from metrosep.core.units import format_length
from metrosep.forms.base import Form
from metrosep.forms.points import Points
from metrosep.process._setting_equations import (
    FACTORS,
    FREEDOMS,
    Choice,
    Equations,
    Region,
    choose,
    equations,
    levelled,
    modelled,
    solve,
    unit_gram,
)

# The sums of `_setting_equations` are solved again and again. A step that does not make the residual
# smaller is shortened along what the points show least (Levenberg and Marquardt), because there the
# valley is curved: a shift of a smooth part is a tilt to the first order.

_MOST_DAMPINGS = 11
_MOST_STEPS = 60
_SETTLED = ((15, 1e-3), (30, 1e-2), (60, 0.1))
"""Steps, and the share of its standard uncertainty that no freedom may still move by then.

A pixel that crosses the apex at the axis makes the valley rough, far below the uncertainty."""
_ROUNDING = 1e-16
"""m: steps below this are rounding of the heights."""
_FEW = 2e-3
_SINGLE = 4.0
"""Residual of a single point, in units of the RMS."""
_TILTED = {"shift_x": "tilt_x", "shift_y": "tilt_y"}
"""What a shift of a smooth part is to the first order."""
_CANCELLED = 1e-6
"""Share of a sum of squares below which its rounding shows: it is summed anew."""
_MOST_CHOICES = 5
_AROUND_CENTRE = 3.0
"""Radii below this many times hypot(dx, dy) are left out: the centre is cut twice or not at all."""


@dataclass(frozen=True, slots=True)
class Task:
    """What is fitted to what."""

    points: Points  # measured heights
    form: Form  # the nominal surface
    names: Sequence[str]  # freedoms wanted
    wanted: tuple[float, float]  # of (float, float), m: inner and outer radius that may be used
    noise: float | None  # m: stated standard deviation of one height
    extent: float  # m: largest distance from the axis


@dataclass(frozen=True, slots=True)
class Settled:
    """Where the steps ended."""

    values: Mapping[str, float]  # mapping of str to float: of all freedoms
    region: Region  # which points were used
    sums: Equations  # at the values
    choice: Choice  # freedoms that were solved for
    steps: int  # that it took


def settle(task: Task, start: Mapping[str, float]) -> Settled:
    """Return the least-squares values from a start; what the points do not determine stays there.

    Where the steps do not settle and a shift is less well known than the centre that is omitted
    around the apex, that shift is held too.
    """
    found, said = _settled(task, start)
    if said is None:
        return found
    u = _u(found)
    apex = _AROUND_CENTRE * math.hypot(found.values["dx"], found.values["dy"])
    loose = [n for n in _TILTED if n in u and u[n] > apex]
    if not loose:
        raise NotConvergedError(said)
    names = [n for n in task.names if n not in loose]
    found, said = _settled(replace(task, names=names), start)
    if said is not None:
        raise NotConvergedError(said)
    held = {**found.choice.given_up, **{n: (_TILTED[n],) for n in loose}}
    return replace(found, choice=Choice(found.choice.used, held))


def _settled(task: Task, start: Mapping[str, float]) -> tuple[Settled, str | None]:
    """Return where the steps end, and what failed.

    What is determined depends on the values (an apex at the centre shows a shift), so the choice is
    made anew at each solution until it stays.
    """
    values = dict(start)
    region = outside(task.wanted, values)
    sums, choice = chosen(task, values, region)
    values, sums, steps, _ = _settle(task, values, region, choice, sums, n_settle=1)
    said: str | None = None
    failed = 0
    for _ in range(_MOST_CHOICES):
        region = outside(task.wanted, values)
        sums, choice = chosen(task, values, region)
        if any(values[n] != start[n] for n in choice.given_up):
            values |= {n: start[n] for n in choice.given_up}
            sums = equations(task.points, task.form, values, region)
        values, sums, more, said = _settle(
            task, values, region, choice, sums, n_settle=_MOST_STEPS
        )
        steps += more
        failed += said is not None
        if failed > 1:
            break
        again = choose(sums, task.names, noise=_level(task, sums, choice), extent=task.extent)
        grown = outside(task.wanted, values).inner > region.inner * (1.0 + 1e-3)
        if said is None and not grown and again.used == choice.used:
            break
    return Settled(values, region, sums, choice, steps), said


def chosen(task: Task, values: Mapping[str, float], region: Region) -> tuple[Equations, Choice]:
    """Return the sums and the freedoms they determine; refuse what determines no setting."""
    sums = equations(task.points, task.form, values, region)
    names, form = task.names, task.form
    if sums.n <= len(names) and region.inner > task.wanted[0]:
        raise NotConvergedError(
            f"the setting runs away to {_shown(values)}, where {sums.n} points of the map are left "
            "outside the centre that such a tool spoils: the map may be of another surface or "
            "mirrored; check form and centre, free less, or give start="
        )
    if sums.n <= len(names):
        raise TooFewSamplesError(
            f"{sums.n} measured points lie within rho = {format_length(region.inner)} ... "
            f"{format_length(region.outer) if math.isfinite(region.outer) else 'the rim'} and on the "
            f"{form.name}, and {len(names)} freedoms need more; check centre and region"
        )
    level = _level(task, sums, choose(sums, names, noise=0.0, extent=task.extent))
    choice = choose(sums, names, noise=level, extent=task.extent)
    wanted = [n for n in FACTORS if n in names]
    if wanted and not any(n in choice.used for n in wanted):
        raise DegenerateFitError(
            f"{', '.join(wanted)} leave no trace of their own on this {form.name} over the "
            "measured points: no tool setting can be found; measure a larger or steeper "
            "part, and check the unit of the heights"
        )
    return sums, choice


def outside(wanted: tuple[float, float], values: Mapping[str, float]) -> Region:
    """Return the region without the centre that is cut twice or not at all."""
    inner = _AROUND_CENTRE * math.hypot(values["dx"], values["dy"])
    return Region(max(wanted[0], inner), wanted[1], values["shift_x"], values["shift_y"])


def _level(task: Task, sums: Equations, choice: Choice) -> float:
    """Return the stated noise, or the RMS that a linear solution would leave, m."""
    if task.noise is not None:
        return task.noise
    return math.sqrt(max(_after(sums, choice), 0.0) / sums.n)


def _after(sums: Equations, choice: Choice) -> float:
    """Return the sum of squares that the linear solution leaves, m^2."""
    return sums.square - float(solve(sums, choice)[0] @ sums.right[choice.rows])


def _moved(values: Mapping[str, float], choice: Choice, step: FloatArray) -> dict[str, float]:
    """Return the values after a step of the used freedoms."""
    moved = dict(values)
    for name, change in zip(choice.used, step.tolist(), strict=True):
        moved[name] += change
    return moved


def _settle(
    task: Task,
    start: Mapping[str, float],
    region: Region,
    choice: Choice,
    sums: Equations,
    *,
    n_settle: int,
) -> tuple[dict[str, float], Equations, int, str | None]:
    """Return values and sums after at most `n_settle` damped steps, their number, and what failed."""
    values, damping = dict(start), 0.0
    for count in range(1, n_settle + 1):
        left = _left(sums, choice)
        last = left <= next(share for most, share in _SETTLED if count <= most)
        for _ in range(_MOST_DAMPINGS):
            step, _ = solve(sums, choice, damping=damping)
            tried, new = _tried(task, _moved(values, choice, step), region, choice)
            if new.n > len(choice.used) and new.mean_square <= _allowed(sums, new):
                break
            if last:
                return values, sums, count, None
            damping = max(10.0 * damping, 1e-8)
        else:
            said = (
                f"no step of the setting makes the residual of {format_length(math.sqrt(sums.mean_square))} "
                f"RMS smaller, at {_shown(values)}: the map may be of another surface or mirrored; "
                "check form and centre, or give start="
            )
            return values, sums, count, None if left <= _SETTLED[-1][1] else said
        values, sums = tried, new
        damping = 0.1 * damping if damping > 1e-9 else 0.0
        if last:
            return values, sums, count, None
    said = (
        f"the setting still moves after {n_settle} steps (now {_shown(values)}): the map may be of "
        "another surface or mirrored; check form and centre, free less, or give start="
    )
    return values, sums, n_settle, said


def _allowed(sums: Equations, new: Equations) -> float:
    """Return the mean square that a step may leave, m^2.

    No more than before; where a few points came in from the uncut core or went there, no more than
    they can make of it, because nothing else compares sums over different points.
    """
    changed = abs(new.n - sums.n)
    few = changed if changed <= _FEW * sums.n else 0
    return sums.mean_square * (1.0 + 1e-12 + _SINGLE**2 * few / sums.n)


def _left(sums: Equations, choice: Choice) -> float:
    """Return how far the full step goes in standard uncertainties; 0 where it is rounding."""
    step, _ = solve(sums, choice)
    moved = math.sqrt(max(float(step @ sums.right[choice.rows]), 0.0))
    if moved <= _ROUNDING * math.sqrt(sums.n):
        return 0.0
    return moved / math.sqrt(sums.mean_square) if sums.mean_square > 0.0 else math.inf


def _tried(
    task: Task, values: dict[str, float], region: Region, choice: Choice
) -> tuple[dict[str, float], Equations]:
    """Return the values with the best piston and tilts, and the sums; none where no part is cut so.

    Levelling straightens the valley: a shift changes the piston by its square.
    """
    try:
        sums = equations(task.points, task.form, values, region)
        if sums.n <= len(choice.used):
            return values, sums
        left, change = levelled(sums, choice)
        values = {n: v + change.get(n, 0.0) for n, v in values.items()}
        if left.square < _CANCELLED * sums.square:
            left = equations(task.points, task.form, values, region)
    except NotConvergedError:
        size = len(FREEDOMS)
        return values, Equations(np.zeros((size, size)), np.zeros(size), math.inf, 0)
    return values, left


def _shown(values: Mapping[str, float]) -> str:
    return ", ".join(f"{n} = {format_length(values[n])}" for n in ("dx", "dy", "dR"))


# ---- whether the map belongs to another period of the form than the first fit took --------------
# A periodic form one period on is the same form, but the setting shows where the spindle axis is. The
# first fit goes to the nearest period; its neighbours are tried by their linear solution on a sample,
# and by a whole fit where they promise more or another setting.

_SAMPLE = 4000
_PARTS = 4
"""Of a period, in the coarse grid of shifts."""
_FORM_LEFT = 0.3
"""Correlation of the residuals of neighbours in the sample, where noise leaves none."""
_PERIODS = 4
"""Periods tried to each side where the nearest do not explain the map."""
_MOST_MOVES = 4
_TOLD_APART = 9.0
"""Of chi-square: a period that fits worse by less cannot be distinguished from the best."""
_OTHER = 2.0
"""Standard uncertainties by which a setting is another one."""


@dataclass(frozen=True, slots=True)
class Guess:
    """What a neighbouring period promises from its linear solution on the sample."""

    shifted: Mapping[str, float]  # mapping of str to float: the shifts to start from
    square: float  # m^2: mean squared residual it would leave
    setting: FloatArray  # shape (3,), m: the setting it would give


def settle_in_period(task: Task, start: Mapping[str, float]) -> tuple[Settled, tuple[str, ...]]:
    """Return the fit in the period that explains the map best, and what stays uncertain."""
    found, failed = None, None
    try:
        found = settle(task, start)
    except NotConvergedError as error:
        failed = error
    if found is None or _is_unexplained(task, found):
        shifted = _coarse_start(task, start)
        if found is None and shifted is None and failed is not None:
            raise failed
        found = _better(task, found, shifted)
    return _in_best_period(task, found)


def _better(task: Task, found: Settled | None, shifted: Mapping[str, float] | None) -> Settled:
    """Return the better of a fit and that from another start."""
    if found is None:
        return settle(task, shifted or {})
    try:
        other = settle(task, shifted or found.values)
    except MetrosepError:
        return found
    return min(found, other, key=lambda fit: fit.sums.mean_square)


def _is_unexplained(task: Task, found: Settled) -> bool:
    """Return whether form is left in the residual of a periodic form, as a wrong phase leaves."""
    if task.form.period is None or not {"shift_x", "shift_y"} & set(task.names):
        return False
    x, y, z = task.points.sample(_SAMPLE)
    inside = found.region.holds(x, y)
    off = z[inside] - modelled(task.form, x[inside], y[inside], found.values)[0]
    return neighbours_of_scattered(x[inside], y[inside], off) > _FORM_LEFT


def _coarse_start(task: Task, start: Mapping[str, float]) -> dict[str, float] | None:
    """Return the start with the shift of a coarse grid over one period that promises most."""
    names = [n for n in ("shift_x", "shift_y") if n in task.names]
    if task.form.period is None or not names:
        return None
    few = _thinned(task)
    best: tuple[float, dict[str, float] | None] = (math.inf, None)
    shares = np.arange(-_PARTS // 2 + 1, _PARTS // 2 + 1) / _PARTS
    for i, j in itertools.product(shares, shares):
        moved = {"shift_x": i * task.form.period[0], "shift_y": j * task.form.period[1]}
        if any(v and n not in names for n, v in moved.items()):
            continue
        values = {n: v + moved.get(n, 0.0) for n, v in start.items()}
        try:
            sums, choice = chosen(few, values, outside(few.wanted, values))
        except MetrosepError:
            continue
        left = _after(sums, choice) / sums.n
        if left < best[0]:
            best = left, values
    return best[1]


def _thinned(task: Task) -> Task:
    x, y, z = task.points.sample(_SAMPLE)
    points = Points(x, y, z[None, :], task.points.centre, is_scattered=True)
    return replace(task, points=points)


def _in_best_period(task: Task, found: Settled) -> tuple[Settled, tuple[str, ...]]:
    """Return the best of a fit and those one or more periods on, and what stays uncertain."""
    free = [n for n in ("shift_x", "shift_y") if n in found.choice.used]
    if task.form.period is None or not free:
        return found, ()
    few = _thinned(task)
    first = found
    rivals: list[Settled] = []
    for _ in range(_MOST_MOVES):
        far = _PERIODS if _is_unexplained(task, found) else 1
        guesses = _worth_trying(few, found, free, far)
        tried = (_fitted(task, found, guess) for guess in guesses)
        ranked = sorted(
            [found, *(t for t in tried if t is not None)], key=lambda fit: fit.sums.mean_square
        )
        rivals = ranked[1:]
        if ranked[0] is found:
            break
        found = ranked[0]
    said = []
    if found is not first:
        said.append(
            f"another period of the {task.form.name} than the nearest explains the map: the part "
            f"is taken to be shifted by {_shift(found)} instead of {_shift(first)}"
        )
    for rival in rivals:  # another period that fits as well and gives another setting
        worse = found.sums.n * (rival.sums.mean_square / found.sums.mean_square - 1.0)
        gap = np.array([rival.values[n] - found.values[n] for n in FACTORS])
        if worse < _TOLD_APART and (np.abs(gap) > _OTHER * _u_setting(found)).any():
            given = ", ".join(f"{n} = {format_length(rival.values[n])}" for n in FACTORS)
            said.append(
                f"another period of the {task.form.name} fits as well: a part shifted by "
                f"{_shift(rival)} instead of {_shift(found)} gives {given}; measure where the spindle "
                "axis is on the map"
            )
    return found, tuple(said)


def _worth_trying(few: Task, found: Settled, free: Sequence[str], far: int) -> list[Guess]:
    """Return the neighbours that may fit better, or as well with another setting, best first."""
    here = _guess(few, found, found.values)
    if here is None:
        return []
    u = _u_setting(found)
    worth = []
    for shifted in _neighbours(few, found, free, far):
        there = _guess(few, found, shifted)
        if there is None:
            continue
        worse = few.points.z.size * (there.square / here.square - 1.0) if here.square else math.inf
        other = bool((np.abs(there.setting - here.setting) > _OTHER * u).any())
        if worse < -_TOLD_APART or (worse < _TOLD_APART and other):
            worth.append(there)
    return sorted(worth, key=lambda guess: guess.square)[:3]


def _neighbours(
    few: Task, found: Settled, free: Sequence[str], far: int
) -> Iterator[dict[str, float]]:
    """Yield the values some periods on, as far as the map reaches."""
    assert few.form.period is not None  # noqa: S101 - asked before
    period = dict(zip(("shift_x", "shift_y"), few.form.period, strict=True))
    steps = {}
    for name, length in period.items():
        most = min(far, max(1, math.ceil(few.extent / length))) if name in free else 0
        steps[name] = range(-most, most + 1)
    for i in steps["shift_x"]:
        for j in steps["shift_y"]:
            if i or j:
                moved = {"shift_x": i * period["shift_x"], "shift_y": j * period["shift_y"]}
                yield {n: v + moved.get(n, 0.0) for n, v in found.values.items()}


def _guess(few: Task, found: Settled, values: Mapping[str, float]) -> Guess | None:
    """Return what the linear solution from some values leaves; None where it has none."""
    try:
        sums = equations(few.points, few.form, values, outside(few.wanted, values))
        if sums.n <= 2 * len(found.choice.used):
            return None
        step, _ = solve(sums, found.choice)
    except (MetrosepError, np.linalg.LinAlgError):
        return None
    left = max(sums.square - float(step @ sums.right[found.choice.rows]), 0.0)
    moved = _moved(values, found.choice, step)
    return Guess(values, left / sums.n, np.array([moved[n] for n in FACTORS]))


def _fitted(task: Task, found: Settled, guess: Guess) -> Settled | None:
    """Return the whole fit from a guess; None where it fails or gives up what was free."""
    try:
        there = settle(task, guess.shifted)
    except MetrosepError:
        return None
    return there if set(found.choice.used) <= set(there.choice.used) else None


def _u(found: Settled) -> dict[str, float]:
    """Return the standard uncertainties of the used freedoms."""
    _, inverse = solve(found.sums, found.choice)
    u = np.sqrt(np.diag(inverse) * found.sums.mean_square)
    return dict(zip(found.choice.used, u.tolist(), strict=True))


def _u_setting(found: Settled) -> FloatArray:
    """Return the standard uncertainties of the three factors; infinite where not determined."""
    known = _u(found)
    return np.array([known.get(n, math.inf) for n in FACTORS])


def _shift(found: Settled) -> str:
    parts = (format_length(found.values[n]) for n in ("shift_x", "shift_y"))
    return f"({', '.join(parts)})"


# ---- covariance of a tool setting when the noise of neighbouring points is not independent ----
# The correlation of the residual at every lag along x and y is taken where it stands out of its own
# scatter around lag zero. With C the matrix of these correlations and J the derivatives, the covariance
# is ``s^2 G^-1 (J^T C J) G^-1``, ``G = J^T J``: that of the estimate actually made, white or not. For
# derivatives that change slowly it is the plain one times the sum of the correlations over all lags.

_TILE = 1024
"""Pixels a side that are transformed at once."""
_FARTHEST = 3
"""Lags beyond this part of the map hold too few pairs."""
_SURE = 3.0
"""Standard errors by which a correlation must stand out of its scatter."""
_LEAST = 1e-15
"""m: a residual below this is rounding."""


@dataclass(frozen=True, slots=True)
class Correlation:
    """How the residuals of points near one another correlate."""

    # shape (2 n_y + 1, 2 n_x + 1): correlation by lag, 1 in the middle, 0 where it does not stand
    # out
    kernel: FloatArray
    along_x: float = 0.0  # of next neighbours; 0 where there are none
    along_y: float = 0.0

    @property
    def is_white(self) -> bool:
        """Whether no neighbours correlate."""
        return self.kernel.size == 1

    @property
    def alike(self) -> float:
        """Points that say the same together: the sum over all lags."""
        return float(self.kernel.sum())


WHITE = Correlation(np.ones((1, 1)))


def correlation(task: Task, residual: FloatArray) -> Correlation:
    """Return the correlation of the residuals on a map or profile; white for scattered points."""
    if task.points.is_scattered:
        return WHITE
    z = np.atleast_2d(residual)
    lags = tuple(min(n // _FARTHEST, _TILE // _FARTHEST) for n in z.shape)
    products, pairs = _lagged(z, (lags[0], lags[1]))
    middle = lags[0], lags[1]
    if pairs[middle] < 10 or products[middle] <= _LEAST**2 * pairs[middle]:
        return WHITE
    with np.errstate(divide="ignore", invalid="ignore"):
        r = products / pairs * (pairs[middle] / products[middle])
    r[pairs < 0.5] = np.nan
    kernel = np.nan_to_num(np.where(_standing_out(r, pairs), r, 0.0))
    rows, columns = np.flatnonzero(kernel.any(axis=1)), np.flatnonzero(kernel.any(axis=0))
    r = np.nan_to_num(r)
    along_x = float(r[lags[0], lags[1] + 1]) if lags[1] else 0.0
    along_y = float(r[lags[0] + 1, lags[1]]) if lags[0] else 0.0
    cropped = kernel[rows[0] : rows[-1] + 1, columns[0] : columns[-1] + 1]
    return Correlation(cropped, along_x, along_y)


def covariance(
    task: Task, settled: Settled, square: float, found: Correlation
) -> tuple[FloatArray, float]:
    """Return the covariance of the used freedoms, and the variance of one height.

    The variance is `square`, if stated (> 0), or from the residual, less what the fit takes up of
    correlated noise.
    """
    sums, choice = settled.sums, settled.choice
    _, inverse = solve(sums, choice)
    if found.is_white:
        variance = square or sums.square / (sums.n - len(choice.used))
        return variance * inverse, variance
    rows = choice.rows
    norms, gram = unit_gram(sums.gram, rows)
    lagged = _lagged_gram(task, settled, found.kernel)[np.ix_(rows, rows)] / np.outer(norms, norms)
    size, turn = np.linalg.eigh(gram)
    root = turn / np.sqrt(size)
    raised, axes = np.linalg.eigh(root.T @ lagged @ root)
    raised = np.maximum(raised, 1.0)
    taken = min(float(raised.sum()), 0.5 * sums.n)
    variance = square or sums.square / (sums.n - taken)
    half = root @ axes * np.sqrt(raised) / norms[:, None]
    return variance * (half @ half.T), variance


def _lagged(z: FloatArray, lags: tuple[int, int]) -> tuple[FloatArray, FloatArray]:
    """Return sums of products and numbers of pairs by lag, both (2 n_y + 1, 2 n_x + 1)."""
    from scipy.fft import irfft2, next_fast_len, rfft2

    shape = (2 * lags[0] + 1, 2 * lags[1] + 1)
    products, pairs = np.zeros(shape), np.zeros(shape)
    for i in range(0, z.shape[0], _TILE):
        for j in range(0, z.shape[1], _TILE):
            tile = z[i : i + _TILE, j : j + _TILE]
            known = ~np.isnan(tile)
            size = [
                next_fast_len(max(n, lag + 1) + lag, real=True)
                for n, lag in zip(tile.shape, lags, strict=True)
            ]
            for values, sums in ((np.where(known, tile, 0.0), products), (known * 1.0, pairs)):
                power = np.abs(rfft2(values, s=size)) ** 2
                around = np.fft.fftshift(irfft2(power, s=size))
                y, x = size[0] // 2, size[1] // 2
                sums[...] += around[y - lags[0] : y + lags[0] + 1, x - lags[1] : x + lags[1] + 1]
    return products, pairs


def _standing_out(r: FloatArray, pairs: FloatArray) -> NDArray[np.bool_]:
    """Return where the correlation around lag zero stands out of its scatter, as one region."""
    from scipy.ndimage import label

    middle = r.shape[0] // 2, r.shape[1] // 2
    region = np.zeros(r.shape, dtype=bool)
    region[middle] = True
    for _ in range(2):
        # Bartlett: the scatter of far lags grows with the sum of squares of the near ones
        scatter = np.sqrt(float(np.nansum(r[region] ** 2)) / np.maximum(pairs, 1.0))
        # lags without a pair join what lies on both sides of them, and add nothing
        marks = np.asarray(
            label(np.isnan(r) | (r > _SURE * scatter), structure=np.ones((3, 3)))[0]
        )
        region = marks == marks[middle]
    return region


def _lagged_gram(task: Task, settled: Settled, kernel: FloatArray) -> FloatArray:
    """Return ``J^T C J`` over the used points: one derivative against the correlated others."""
    from scipy.fft import irfft2, next_fast_len, rfft2

    points, reach = task.points, (kernel.shape[0] // 2, kernel.shape[1] // 2)
    total = np.zeros((len(FREEDOMS), len(FREEDOMS)))
    core = max(64, _TILE // 4)
    n_y, n_x = points.z.shape
    with one_blas_thread():
        for i in range(0, n_y, core):
            for j in range(0, n_x, core):
                top, left = max(i - reach[0], 0), max(j - reach[1], 0)
                rows = slice(top, min(i + core + reach[0], n_y))
                columns = slice(left, min(j + core + reach[1], n_x))
                wide = _derivatives(task, settled, rows, columns)
                size = [
                    next_fast_len(n + 2 * lag, real=True)
                    for n, lag in zip(wide.shape[1:], reach, strict=True)
                ]
                spread = rfft2(kernel, s=size)
                inside = (
                    slice(i - top, min(i + core, n_y) - top),
                    slice(j - left, min(j + core, n_x) - left),
                )
                near = np.stack(
                    [
                        irfft2(rfft2(column, s=size) * spread, s=size)[
                            reach[0] : reach[0] + wide.shape[1],
                            reach[1] : reach[1] + wide.shape[2],
                        ][inside]
                        for column in wide
                    ]
                )
                own = wide[:, inside[0], inside[1]]
                total += own.reshape(len(own), -1) @ near.reshape(len(near), -1).T
    return 0.5 * (total + total.T)


def _derivatives(task: Task, settled: Settled, rows: slice, columns: slice) -> FloatArray:
    """Return the derivatives on part of the map, 0 at points that are not used."""
    z = task.points.z[rows, columns]
    x = np.broadcast_to(task.points.x[columns], z.shape)
    y = np.broadcast_to(task.points.y[rows, None], z.shape)
    model, found = modelled(task.form, x.ravel(), y.ravel(), settled.values)
    used = ~np.isnan(z.ravel()) & ~np.isnan(model) & np.isfinite(found).all(axis=0)
    used &= settled.region.holds(x.ravel(), y.ravel())
    return np.where(used, found, 0.0).reshape(len(found), *z.shape)


def neighbours_of_scattered(x: FloatArray, y: FloatArray, z: FloatArray) -> float:
    """Return the correlation of residuals with that of the nearest other point."""
    from scipy.spatial import cKDTree

    known = ~np.isnan(z)
    if np.count_nonzero(known) < 10:
        return 0.0
    places, values = np.column_stack([x[known], y[known]]), z[known]
    nearest = np.asarray(cKDTree(places).query(places, k=2)[1])
    first, second = values, values[nearest[:, 1]]
    first, second = first - first.mean(), second - second.mean()
    size = float(first @ first) * float(second @ second)
    return float(first @ second) / math.sqrt(size) if size > 0.0 else 0.0
