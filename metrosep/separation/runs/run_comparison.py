r"""Each run against the others of its direction and probe: gain, place, delay, steps and spikes.

With g the median of the others, :math:`z_r(x) = c + s x + a_r g(x - \delta_r) + n_r`, :math:`n_r`
autoregressive: gain and shift by generalised least squares, g and the shifts in turn, so that a
run of the other sign or a displaced one does not blur what it is compared with. A delay of the
reading shifts every run by velocity times delay, so that line is taken out of the shifts before a
run is called displaced.

Source: the project's notes on separation, sections 4.1, 4.4 and 6.4.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Collection, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from metrosep.core._arrays import BoolArray, FloatArray
from metrosep.core.errors import InvalidSamplesError, TooFewSamplesError
from metrosep.core.runset import SAME_FEED, Run, RunSet
from metrosep.core.units import format_length
from metrosep.separation.runs.design import block_means, measured_pitch
from metrosep.separation.runs.displaced import (
    SURE,
    Displaced,
    find_displaced,
    needed,
    scatter_of,
)
from metrosep.separation.runs.noise import MAD
from metrosep.spectral.autoregressive import AutoregressiveModel, fit_autoregressive

_GAIN, _GAIN_REFUSED = 0.1, 3.0
"""Excess of a gain that is named; factor from which the run is refused."""

_LEAST_FREEDOM = 4
"""Fewer runs than five hardly know their scatter, but u bounds it from below."""

_SEEN = 10.0
"""Gain over its u of the median run from which there is an error whose place can be compared."""

_STEPS = 1.5
"""Steps of the readings beyond which one is a spike."""

SPIKE = 6.0
"""Robust standard deviations of a spike; in 1,000,000 normal readings there is none."""

_SPIKE_TAIL = 3.0
"""And so many times the size that 5 % of the readings exceed: 5.9 sd if normal, more if not."""

_SHIFT_RANGE = 0.1
"""Shifts are looked for up to this share of the travel."""

_GRID, _LEAST_GRID = 2048, 24
"""Most and fewest positions on which runs are compared."""

_BLOCKS = 8
"""Most parts of which one is left out when it is asked what a shift owes to the other runs."""

_FITTINGS, _ROUNDS, _SETTLED, _MARGIN = 2, 16, 0.1, 0.01
"""Noise models one after the other; rounds with each at most; the share of its u by which a shift
still moves when it has settled; and the share of the travel at each end into which it may move."""

_ORDERS = (0, 1, 2, 4, 8, 16, 24)
_REPEATS = 1e-3
"""Chance by which noise would repeat as much as a wave that counts as one of the error."""

_FAR_MORE = 2.0
"""Power that repeats with shifts that are not sure one by one, over that without, from which they are taken."""

_LEAST_WAVES = 6.0
"""Independent waves in which two runs are compared, at least."""

_MEDOIDS = 20
"""Runs among which the one that resembles the others most is looked for."""


@dataclass(slots=True)
class Findings:
    """What is found, while it is looked for."""

    labels: list[str]
    said: list[list[str]]
    refused: list[bool]
    common: list[str] = field(default_factory=list)
    gain: FloatArray = field(default_factory=lambda: np.empty((0, 2)))
    shift: FloatArray = field(default_factory=lambda: np.empty((0, 2)))
    place: dict[int, tuple[float, float]] = field(default_factory=dict)  # m, m: where, how large
    held: tuple[float, str] = (0.0, "")  # samples for which a reading stays, and the run
    steps: FloatArray = field(default_factory=lambda: np.empty(0))  # m: of each run, 0 if fine
    apart: bool = False  # whether all runs of a feedrate are displaced
    unsure: dict[int, tuple[str, str]] = field(default_factory=dict)  # kind and text
    by_size: dict[int, str] = field(default_factory=dict)  # said of runs of another RMS
    lost: dict[int, NDArray[np.bool_]] = field(default_factory=dict)  # readings that are markers

    def say(
        self,
        run: int,
        text: str,
        *,
        refused: bool = False,
        at: float = math.nan,
        size: float = math.nan,
    ) -> None:
        """Note a finding of a run; the first one gives its place and size."""
        self.said[run].append(text)
        self.refused[run] |= refused
        if not math.isnan(size):
            self.place.setdefault(run, (at, size))


@dataclass(slots=True)
class RunTable:
    """Runs of one direction and probe on common positions, their lines removed."""

    members: list[int]
    x: FloatArray
    z: FloatArray
    compared: NDArray[np.bool_]
    reference: NDArray[np.bool_]

    @classmethod
    def of(cls, runs: RunSet, members: Sequence[int]) -> RunTable | None:
        """Return the table, or None where the runs share too few positions."""
        own = RunSet([runs[i] for i in members])
        try:
            low, high = own.common_travel
        except InvalidSamplesError:
            return None
        pitch = max(measured_pitch(r) for r in own)
        n = int(min((high - low) / pitch, _GRID)) + 1
        if n < _LEAST_GRID:
            return None
        x = np.linspace(low, high, n)
        rows = [_resampled(r, x) for r in own]
        everything = np.ones(len(members), dtype=bool)
        flat = np.array([_flat(x, z) for z in rows])
        return cls(list(members), x, flat, everything, everything.copy())


def _resampled(run: Run, x: FloatArray) -> FloatArray:
    """Return a run on positions, averaged over as many samples as lie between them."""
    block = max(1, int((x[1] - x[0]) / abs(float(np.mean(np.diff(run.x)))) * (1.0 + 1e-9)))
    n = len(run) // block * block
    xs, zs = block_means(run.x[:n].reshape(-1, block), run.z[:n].reshape(-1, block))
    order = np.argsort(xs)
    xs, zs = xs[order], zs[order]
    values = np.interp(x, xs, zs)  # NaN spreads to its neighbours: a gap stays a gap
    values[(x < xs[0] - (x[1] - x[0])) | (x > xs[-1] + (x[1] - x[0]))] = np.nan
    return np.asarray(values, dtype=np.float64)


def _flat(x: FloatArray, z: FloatArray) -> FloatArray:
    """Return readings without their line; single wrong ones do not tilt it."""
    valid = ~np.isnan(z)
    if valid.sum() < 3:
        return np.full_like(z, np.nan)
    keep = valid
    while True:
        xs, zs = x[keep], z[keep]
        at = xs - xs.mean()
        slope = float(at @ (zs - zs.mean())) / max(float(at @ at), 1e-300)
        rest = z - zs.mean() - slope * (x - xs.mean())
        size = np.abs(rest)
        near = valid & (size <= 2.0 * SPIKE * MAD * float(np.median(size[valid])))
        if keep is not valid or near.sum() < 3 or near.sum() == valid.sum():
            return np.asarray(rest)
        keep = near


def compare_runs(runs: RunSet, table: RunTable, found: Findings) -> tuple[float, float] | None:
    """Name runs of another sign, gain or place; return the delay that the shifts show."""
    for i, run in enumerate(table.members):
        known = not np.isnan(table.z[i]).all() and np.nanstd(table.z[i]) > 0.0
        table.compared[i] = known and not found.refused[run]
    by_size = [i for i, run in enumerate(table.members) if run in found.by_size]
    coarse = float(found.steps[table.members].max())
    table.reference = table.compared.copy()
    table.reference[by_size] = False
    if table.reference.sum() < 2:
        table.compared = table.reference.copy()
        return None
    gain, shift, unlike = _gains_and_shifts(runs, table, coarse)
    own = gain[table.compared & np.isfinite(gain).all(axis=1)]
    if len(own) < 2 or np.median(np.abs(own[:, 0]) / own[:, 1]) < _SEEN:
        return None  # no error is seen by which runs could be compared
    bad = _suspects(runs, table, gain)
    places = _displaced(runs, table, shift, {*bad, *by_size})
    suspects = {*bad, *places.runs, *(i for rows in places.feeds.values() for i in rows)}
    n_compared = int(table.compared.sum())
    odd = next((o for o in (suspects, set(bad)) if o and n_compared - len(o) >= 2), None)
    if odd is not None:
        table.reference[list(odd)] = False  # compare again with those that agree
        gain, shift, unlike = _gains_and_shifts(runs, table, coarse)
        bad = _suspects(runs, table, gain)
        places = _displaced(runs, table, shift, {*bad, *by_size})
    for i, run in enumerate(table.members):
        if table.compared[i]:
            found.gain[run] = gain[i]
            found.shift[run] = shift[i, 0], math.hypot(shift[i, 1], shift[i, 2])
    texts = {i: (text, False) for i, text in places.runs.items()} | bad
    n = int(table.compared.sum()) - len({*texts, *by_size})
    for i in np.flatnonzero(table.compared).tolist():
        run, accused = table.members[i], i in texts or i in by_size
        shape = ""
        if n > 1:
            shape = _odd_shape(runs, table, i, unlike, accused=accused, coarse=coarse > 0.0)
        if i in by_size and (shape or i not in texts):
            continue  # its size is named, and nothing explains it better
        if run in found.by_size:
            found.said[run].remove(found.by_size[run])
        text, refused = texts.get(i, ("", False))
        others = f"the other {n - (not accused)} runs" if n > 1 else "the other run"
        change = None
        if shape.startswith("differs") or (
            n > 1 and not accused and _stands_out(runs, table, i, unlike)
        ):
            change = _change(table, i)
        if change is not None:
            place, size = change
            text = f"jumps by {format_length(size)} at {format_length(place)} against {others}"
            if math.isnan(place):
                text = (
                    f"bends by {format_length(size)} from end to end against {others}, as a drift "
                    "does (drift=2, command line: --drift 2, takes a bend of each run out)"
                )
            found.say(run, text, at=place, size=size)
        elif shape:
            found.say(run, shape + others)
            found.unsure[run] = "shape", shape + others
        elif text:
            size = float(shift[i, 0]) if i in places.runs else math.nan
            found.say(run, text + others, refused=refused, size=size)
            if not refused:
                found.unsure[run] = "shift" if i in places.runs else "gain", text + others
    found.common += list(places.feeds)
    found.apart |= bool(places.feeds)
    return places.lag


_OTHER_SHAPE, _TIMES_OTHERS = (0.05, 0.15), (5.0, 10.0)
"""Share of the power of the error that neither gain nor shift explains, and how many times that of
the other runs, from which a run shows something else: of a run of another gain or place, and where
that is all that is odd."""


_MIRRORED = "is mirrored, its readings are in the order of the opposite direction, against "


def _odd_shape(
    runs: RunSet,
    table: RunTable,
    row: int,
    unlike: FloatArray,
    *,
    accused: bool,
    coarse: bool,
) -> str:
    """Return what to say of a run that no gain and no shift makes like the others; empty if one does."""
    from scipy.stats import f as f_distribution

    feeds = np.array([runs[i].feed or 0.0 for i in table.members])
    others = table.reference.copy()
    others[row] = False
    alike = others & _same_feed(feeds, row)
    if not others.any() or (not accused and (alike.sum() < 2 or coarse)):
        return ""
    typical = _typical(others, alike, unlike)
    aligned, mirrored, n_waves = (float(v) for v in unlike[row])
    if accused and aligned > f_distribution.isf(_REPEATS, n_waves, n_waves) * mirrored:
        return _MIRRORED  # few waves: a shift of half of the longest is nearly as good
    share, times = (v[0 if accused else 1] for v in (_OTHER_SHAPE, _TIMES_OTHERS))
    if not aligned > times * typical or (aligned < share and not accused):
        return ""
    if _TIMES_OTHERS[0] * mirrored < aligned:
        return _MIRRORED
    if aligned < share:
        return ""
    return f"differs, whatever its gain and place, in {100 * aligned:.2g} % of the power of the error from "


def _typical(others: BoolArray, alike: BoolArray, unlike: FloatArray) -> float:
    """Return the share of the error that other runs do not show, of all or of those of the feedrate."""
    # A vibration at a wavelength of the error is in all runs of a feedrate.
    return max(float(np.median(unlike[rows, 0])) for rows in (others, alike) if rows.any())


def _stands_out(runs: RunSet, table: RunTable, row: int, unlike: FloatArray) -> bool:
    """Return whether a run differs by many times what the others do, however little that is."""
    feeds = np.array([runs[i].feed or 0.0 for i in table.members])
    others = table.reference.copy()
    others[row] = False
    alike = others & _same_feed(feeds, row)
    if alike.sum() < 2:
        return False
    return bool(unlike[row, 0] > _TIMES_OTHERS[1] * _typical(others, alike, unlike))


_JUMP, _JUMP_TIMES = 0.3, 10.0
"""Share of the squares that a level from one place on, or a bend, takes off, and over that of the
other runs."""


def _change(table: RunTable, row: int) -> tuple[float, float] | None:
    """Return place and size of the jump of a run against the others, NaN and size of a bend; or None."""
    found = []
    rows = [row, *(i for i in np.flatnonzero(table.reference).tolist() if i != row)]
    for i in rows:
        others = table.reference.copy()
        others[[i, row]] = False
        rest = table.z[i] - _median(table.z[others])
        known = ~np.isnan(rest)
        x, z = table.x[known], rest[known]
        found.append(max(_best_level(x, z), _bend(x, z)))
    gain, place, size = found[0]
    if gain > max(_JUMP, _JUMP_TIMES * max(f[0] for f in found[1:])):
        return place, size
    return None


def _bend(x: FloatArray, z: FloatArray) -> tuple[float, float, float]:
    """Return how much of the squares a parabola takes off, NaN, and its height over the chord."""
    u = 2.0 * (x - x[0]) / (x[-1] - x[0]) - 1.0
    q = np.linalg.qr(np.polynomial.legendre.legvander(u, 2))[0]
    along = q.T @ z
    bend = q[:, 2] * along[2]
    left = float(z @ z) - float(along @ along)
    height = float(bend[0] - bend[bend.size // 2])
    return float(along[2] ** 2) / max(left, 1e-300), math.nan, height


def _best_level(x: FloatArray, z: FloatArray) -> tuple[float, float, float]:
    """Return how much of the squares a level from one place on takes off, the place and the level."""
    n = x.size
    line = np.linalg.qr(np.column_stack([np.ones(n), x - x.mean()]))[0]
    z = z - line @ (line.T @ z)
    # Of each column 0 ... 0 1 ... 1 less its line: product with z and square, by sums from the end.
    along = np.cumsum(z[::-1])[::-1]
    own = np.arange(n, 0, -1.0) - (np.cumsum(line[::-1], axis=0)[::-1] ** 2).sum(axis=1)
    inner = slice(max(n // 50, 2), n - max(n // 50, 2))
    gain = along[inner] ** 2 / own[inner]
    at = int(np.argmax(gain)) + inner.start
    left = float(z @ z) - float(gain.max())
    return float(gain.max()) / max(left, 1e-300), float(x[at]), float(along[at] / own[at])


def _gains_and_shifts(
    runs: RunSet, table: RunTable, coarse: float
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return gain and shift of every run against the median of the others, each with its u.

    Steps of the readings are tied to the place: no number of samples takes them out of a run.
    And the share of the error that each run does not show, in its place and mirrored, and the number
    of waves that it is known from.
    """
    x, z = table.x, np.where(np.isnan(table.z) | ~table.compared[:, None], 0.0, table.z)
    rows = np.flatnonzero(table.compared).tolist()
    reach = int(_SHIFT_RANGE * x.size)
    pitch, splines = float(x[1] - x[0]), [_spline(x, row) for row in table.z]
    sign, shift = _first_alignment(z, table.reference, reach, pitch)
    likeliest = _first_alignment(z, table.reference, reach, pitch, sure=0.0)
    both = [
        _repeated_power(_aligned(splines, x, d, a)[table.reference])
        for a, d in ((sign, shift), likeliest)
    ]
    if both[1] > _FAR_MORE * both[0]:  # the few waves of a short travel are never sure one by one
        sign, shift = likeliest
    size = np.sqrt(np.mean(z**2, axis=1)) + 1e-300
    gain = sign * size / float(np.median(size[table.reference]))
    gain[~table.compared] = 1.0
    feeds = np.array([runs[i].feed or 0.0 for i in table.members])
    others = [_others(feeds, table.reference, i) for i in range(len(z))]
    # Against runs that are themselves to be moved, whole steps swing; by the share that the others
    # have in the mean of all, they are the steps of Gauss and Newton against the common curve.
    share = np.array([_share_of_others(feeds, table.reference, i) for i in range(len(z))])
    white = AutoregressiveModel(np.empty(0), 1.0, 1.0)
    models = dict.fromkeys(rows, white)
    out_gain, out_shift = np.full((len(z), 2), np.nan), np.full((len(z), 3), np.nan)
    unlike = np.full((len(z), 3), np.nan)
    aligned, keep, inside = z, np.ones(x.size), x
    shared = _Columns(inside, aligned, keep)
    for fitting in range(_FITTINGS):  # white noise first: a model of a misfit would hide it
        # One range that every run covers wherever it is moved: no run drops out at an end.
        first = x[0] + max(0.0, -float(shift[rows].min())) + _MARGIN * np.ptp(x)
        last = x[-1] - max(0.0, float(shift[rows].max())) - _MARGIN * np.ptp(x)
        inside = x[(x >= first) & (x <= last)]
        for _ in range(_ROUNDS):
            aligned = _aligned(splines, inside, shift, gain)
            keep = _repeating(aligned[table.reference])
            step = np.zeros(len(z))
            shared = _Columns(inside, aligned, keep)
            for i in rows:
                out_gain[i], change = _solve(shared.of(others[i]), aligned[i] * gain[i], models[i])
                if math.isfinite(change[0]):
                    out_shift[i, :2] = shift[i] + change[0], change[1]
                    step[i] = share[i] * change[0]
            own_gain = out_gain[table.reference, 0]
            sign_of_most = 1.0 if np.sign(own_gain).sum() >= 0.0 else -1.0
            middle = sign_of_most * float(np.median(np.abs(own_gain)))
            if math.isfinite(middle) and abs(middle) > 1e-6:
                out_gain *= np.array([1 / middle, 1 / abs(middle)])
            known = np.isfinite(out_gain[:, 0]) & (np.abs(out_gain[:, 0]) > 1e-6)
            grows = np.where(known, share * (out_gain[:, 0] - gain), 0.0)
            gain += grows
            gain[np.abs(gain) < 1e-6] = 1e-6
            step[rows] -= float(np.median(step[table.reference]))
            limit = reach * pitch
            shift = np.clip(shift + step, -limit, limit)
            moved = np.abs(np.column_stack([step, grows]))[rows]
            if not (
                moved > _SETTLED * np.column_stack([out_shift[:, 1], out_gain[:, 1]])[rows]
            ).any():
                break
        if fitting == _FITTINGS - 1:
            break
        rests = {i: gain[i] * _rest(shared.of(others[i]), aligned[i]) for i in rows}
        for i in rows:
            models[i] = _noise(
                [
                    rests[j]
                    for j in rows
                    if _same_feed(feeds, i)[j]
                    and (j == i or (table.reference[j] and table.reference[i]))
                ]
            )
    means = _Columns(inside, aligned, keep, middle=np.nanmean)
    for i in rows:
        out_shift[i, 2] = _by_reference(means, others[i], aligned[i] * gain[i], models[i])
        error = shared.of(others[i])[:, 0]
        mirrored = _flat(inside, splines[i](x[0] + x[-1] - inside))
        unlike[i, :2] = [_unlike(row, error, keep) for row in (aligned[i], mirrored)]
        unlike[i, 2] = max(float(keep.sum()), _LEAST_WAVES)
    few = [i for i in rows if others[i].sum() < _LEAST_FREEDOM]
    if few:  # two others hardly know by what they differ: what all the runs show of it is pooled
        out_shift[few, 2] = math.sqrt(float(np.mean(out_shift[few, 2] ** 2)))
    out_shift[:, 0] -= float(np.median(out_shift[table.reference, 0]))
    size_of_error, slope = _sizes(table)
    out_gain[:, 1] = np.hypot(out_gain[:, 1], coarse / math.sqrt(12.0) / size_of_error)
    out_shift[:, 1] = np.hypot(out_shift[:, 1], coarse / math.sqrt(12.0) / slope)
    return out_gain, out_shift, unlike


def _sizes(table: RunTable) -> tuple[float, float]:
    """Return the RMS of the error and of its slope."""
    g = _median(table.z[table.reference])
    slope = float(np.sqrt(np.nanmean(np.gradient(g, table.x) ** 2)))
    return max(float(np.sqrt(np.nanmean(g**2))), 1e-300), max(slope, 1e-300)


def _unlike(row: FloatArray, error: FloatArray, keep: FloatArray) -> float:
    """Return the share of the power of a row, in the waves of the error, that the error is not."""
    from scipy.fft import dct

    away = np.abs(row - error)
    known = away <= SPIKE * MAD * float(np.nanmedian(away))  # a gap or a spike says nothing
    own = keep * dct(np.where(known, row, error), norm="ortho")
    both = keep * dct(error, norm="ortho")
    size = float(own @ own) * float(both @ both)
    return 1.0 - float(own @ both) ** 2 / size if size > 0.0 else 1.0


def _rest(columns: FloatArray, z: FloatArray) -> FloatArray:
    """Return what columns leave of a row, NaN where it has no reading."""
    known = ~np.isnan(z)
    fit = np.linalg.lstsq(columns[known], z[known], rcond=None)[0]
    return np.asarray(z - columns @ fit)


def _spline(x: FloatArray, row: FloatArray) -> Callable[[FloatArray], FloatArray]:
    """Return a row as a function of the place, NaN where it has no reading."""
    from scipy.interpolate import CubicSpline

    known = ~np.isnan(row)
    if known.sum() < 4:
        return lambda at: np.full_like(at, np.nan)
    curve, gone = CubicSpline(x[known], row[known]), np.where(known, 0.0, np.nan)
    return lambda at: np.asarray(curve(at) + np.interp(at, x, gone, left=np.nan, right=np.nan))


def _by_reference(
    means: _Columns, others: NDArray[np.bool_], z: FloatArray, model: AutoregressiveModel
) -> float:
    """Return what a shift changes with the choice of the runs compared with (jackknife).

    A line of a vibration near a wave of the error moves that wave in the reference: all runs of
    a feedrate then seem displaced, and no residual shows it.
    """
    rows = np.flatnonzero(others)
    blocks = [b for b in np.array_split(rows, min(rows.size, _BLOCKS)) if b.size]
    if len(blocks) < 2:
        return 0.0
    found = []
    for block in blocks:
        left = others.copy()
        left[block] = False
        found.append(_solve(means.of(left), z, model)[1][0])
    n = len(blocks)
    return math.sqrt((n - 1) / n * float(((np.array(found) - np.mean(found)) ** 2).sum()))


def _aligned(
    splines: Sequence[Callable[[FloatArray], FloatArray]],
    x: FloatArray,
    shift: FloatArray,
    gain: FloatArray,
) -> FloatArray:
    """Return the rows moved back by their shifts and divided by their gains, lines removed."""
    rows = zip(splines, shift, gain, strict=True)
    return np.array([_flat(x, spline(x + d)) / a for spline, d, a in rows])


def _first_alignment(
    z: FloatArray,
    reference: NDArray[np.bool_],
    reach: int,
    pitch: float,
    *,
    sure: float = SURE,
) -> tuple[FloatArray, FloatArray]:
    """Return sign and shift of every run against the one that resembles the others most."""
    n = z.shape[1]
    size = 2 ** int(np.ceil(np.log2(2 * n)))
    spectra = np.fft.rfft(z, size, axis=1)
    norm = np.sqrt((z**2).sum(axis=1)) + 1e-300
    lags = np.arange(-reach, reach + 1)
    share = 1.0 - np.abs(lags) / n
    n_waves = max(float(_repeating(z[reference]).sum()), _LEAST_WAVES)
    best: tuple[float, FloatArray, FloatArray] | None = None
    candidates = np.flatnonzero(reference)
    for m in candidates[:: max(1, candidates.size // _MEDOIDS)]:
        cross = np.fft.irfft(spectra * spectra[m].conj(), size, axis=1)[:, lags % size]
        cross = cross / (norm[:, None] * norm[m]) / share
        cross = np.clip(cross, -0.999, 0.999)
        # A shift must be far more likely than none: noise of one wave resembles itself elsewhere.
        gain = (
            0.5 * n_waves * np.log((1.0 - cross[:, reach] ** 2) / (1.0 - cross.max(axis=1) ** 2))
        )
        at = np.where(gain > 0.5 * sure**2, np.argmax(cross, axis=1), reach)
        peak = np.take_along_axis(cross, at[:, None], axis=1)[:, 0]
        score = float(np.abs(peak[reference]).sum())
        if best is None or score > best[0]:
            sign = np.where(peak < 0.0, -1.0, 1.0)
            best = (score, sign, np.asarray(lags[at] * pitch, dtype=np.float64))
    assert best is not None  # noqa: S101  (there are at least two runs)
    sign = best[1] if best[1][reference].sum() >= 0 else -best[1]
    return sign, best[2]


def _repeating(rows: FloatArray) -> FloatArray:
    """Return the share of each cosine wave of the runs that repeats, 0 to 1 (Wiener's filter)."""
    from scipy.fft import dct
    from scipy.stats import f as f_distribution

    waves = dct(np.nan_to_num(rows), norm="ortho", axis=1)
    middle = np.median(waves, axis=0)
    near = np.ones(5) / 5.0
    own = np.convolve(((waves - middle) ** 2).sum(axis=0), near, mode="same")
    noise = own / (len(rows) - 1) * (math.pi / 2.0 if len(rows) > 2 else 1.0) / len(rows)
    both = np.convolve(middle**2, near, mode="same")
    share = np.clip(1.0 - noise / np.maximum(both, 1e-300), 0.0, 1.0)
    # By chance noise repeats a little; taken as a wave of the error it would seem to show a place.
    least = 1.0 - 1.0 / float(f_distribution.isf(_REPEATS, 5, 5 * (len(rows) - 1)))
    return np.asarray(np.where(share > least, share, 0.0))


def _repeated_power(rows: FloatArray) -> float:
    """Return the power of what repeats in rows."""
    from scipy.fft import dct

    waves = dct(np.nan_to_num(rows), norm="ortho", axis=1)
    return float(_repeating(rows) @ np.median(waves, axis=0) ** 2)


def _same_feed(feeds: FloatArray, index: int) -> NDArray[np.bool_]:
    """Return which runs have the feedrate of one, itself among them."""
    return np.asarray(np.abs(feeds - feeds[index]) <= SAME_FEED * feeds[index])


def _others(feeds: FloatArray, reference: NDArray[np.bool_], index: int) -> NDArray[np.bool_]:
    """Return the runs that one is compared with: of other feedrates where there are two.

    At its own feedrate a vibration has the same wavelength in every run, and could be taken for
    an error that is displaced.
    """
    others = reference.copy()
    others[index] = False
    apart = others & ~_same_feed(feeds, index)
    if int(apart.sum()) >= 2:
        return np.asarray(apart, dtype=np.bool_)
    return others if bool(others.any()) else reference


def _share_of_others(feeds: FloatArray, reference: NDArray[np.bool_], index: int) -> float:
    """Return the share of those a run is compared with in the mean of them and the run's like."""
    if not reference[index]:
        return 1.0
    own = reference & _same_feed(feeds, index)
    n = int(reference.sum())
    if n - int(own.sum()) >= 2:
        return 1.0 - int(own.sum()) / n
    return max(1.0 - 1.0 / n, 0.5)


def _medians(rows: FloatArray, axis: int = 0) -> FloatArray:
    """Return the median of the known values of each column, as `numpy.nanmedian` of few rows does.

    That of numpy goes through masked arrays, which here was a tenth of a separation.
    """
    known = np.sort(rows, axis=axis)  # NaN last
    n = rows.shape[axis] - np.isnan(rows).sum(axis=axis)
    low, high = (np.take_along_axis(known, k[None], axis=0)[0] for k in ((n - 1) // 2, n // 2))
    return np.asarray((low + high) / 2.0)


class _Columns:
    """What other runs read and its change with a shift, computed once where runs have the same others."""

    def __init__(
        self,
        x: FloatArray,
        aligned: FloatArray,
        keep: FloatArray,
        middle: Callable[..., Any] = _medians,
    ) -> None:
        self.x, self.aligned, self.keep, self.middle = x, aligned, keep, middle
        self.made: dict[bytes, FloatArray] = {}

    def of(self, others: NDArray[np.bool_]) -> FloatArray:
        """Return what the others read, its change with a shift, a constant and a line."""
        key = others.tobytes()
        if key not in self.made:
            self.made[key] = self._make(others)
        return self.made[key]

    def _make(self, others: NDArray[np.bool_]) -> FloatArray:
        from scipy.fft import dct, idct, idst

        x, rows = self.x, self.aligned[others]
        known = ~np.isnan(rows).all(axis=0)
        g = np.zeros(x.size)
        g[known] = self.middle(rows[:, known], axis=0)
        waves = self.keep * dct(g, norm="ortho")
        g = np.asarray(idct(waves, norm="ortho"))
        # d/dx of cos(w_k x) is -w_k sin(w_k x), at the same places, w_k = pi k / (n pitch)
        turned = np.append(waves[1:] * np.arange(1, x.size), 0.0)
        slope = -np.asarray(idst(turned * (np.pi / (x.size * (x[1] - x[0]))), norm="ortho"))
        return np.column_stack([g, -slope, np.ones(x.size), (x - x.mean()) / np.ptp(x)])


def _noise(rests: Sequence[FloatArray]) -> AutoregressiveModel:
    """Return the noise model of runs of one feedrate, the time step being one position."""
    orders = [p for p in _ORDERS if p <= max(1, rests[0].size // 10)]
    try:
        return fit_autoregressive(rests, orders=orders, time_step=1.0)[0]
    except TooFewSamplesError:
        pooled = np.concatenate(rests)
        return AutoregressiveModel(np.empty(0), float(np.nanmean(pooled**2)), 1.0)


def _solve(
    columns: FloatArray, z: FloatArray, model: AutoregressiveModel
) -> tuple[tuple[float, float], tuple[float, float]]:
    """Return gain and change of the shift, each with its u, by generalised least squares."""
    rows, values = whitened(columns, z, model.coefficients)
    unknown = (math.nan, math.nan)
    if rows.shape[0] < 2 * rows.shape[1]:
        return unknown, unknown
    scale = np.sqrt((rows**2).sum(axis=0))
    if not (
        scale > 1e-9 * math.sqrt(float(values @ values)) * np.array([1.0, 0.0, 0.0, 0.0])
    ).all():
        return unknown, unknown  # nothing repeats
    inverse = np.linalg.pinv((rows / scale).T @ (rows / scale)) / np.outer(scale, scale)
    fit = inverse @ (rows.T @ values)
    rest = values - rows @ fit
    variance = float(rest @ rest) / (rows.shape[0] - rows.shape[1])
    sd = np.sqrt(variance * np.maximum(np.diag(inverse), 0.0))
    if abs(fit[0]) < 1e-6:
        return (float(fit[0]), float(sd[0])), unknown
    return (float(fit[0]), float(sd[0])), (
        float(fit[1] / fit[0]),
        float(sd[1] / abs(fit[0])),
    )


def _suspects(runs: RunSet, table: RunTable, gain: FloatArray) -> dict[int, tuple[str, bool]]:
    """Return what to say of the gains, by row, and whether the run is refused."""
    feeds = np.array([runs[i].feed or 0.0 for i in table.members])
    off = np.where(table.reference, (gain[:, 0] - 1.0) / gain[:, 1], np.nan)
    bad: dict[int, tuple[str, bool]] = {}
    pair = np.flatnonzero(table.compared) if table.compared.sum() == 2 else None
    for i in np.flatnonzero(table.compared & np.isfinite(gain).all(axis=1)).tolist():
        if pair is not None and i == pair[0]:
            continue  # of two runs nothing says which is right: the second is named
        a, u = float(gain[i, 0]), float(gain[i, 1])
        others = np.delete(off, i)
        mates = _same_feed(feeds, i) & table.reference
        mates[i] = False
        enough = needed(max(u, scatter_of(gain[mates, 0] - 1.0)), others[~np.isnan(others)])
        if a < -enough:
            what = f"has the opposite sign: gain {a:.2f} (u {u:.2g}) against "
            bad[i] = what, pair is not None
        elif abs(a - 1.0) > max(_GAIN, enough) and pair is None:
            what = f"has the gain {a:.2f} (u {u:.2g}) against "
            bad[i] = what, not 1.0 / _GAIN_REFUSED <= a <= _GAIN_REFUSED
    return bad


_SHIFT_SHARE = 0.01
"""A shift is named where it changes the readings by more than this share of the error itself."""


def _displaced(
    runs: RunSet, table: RunTable, shift: FloatArray, left_out: Collection[int]
) -> Displaced:
    """Return what the shifts say, by the rows of the table."""
    known = table.compared & np.isfinite(shift).all(axis=1)
    rows = [int(i) for i in np.flatnonzero(known) if i not in left_out]
    if len(rows) < 2:
        return Displaced()
    error, slope = _sizes(table)
    least = _SHIFT_SHARE * error / slope
    feeds = [runs[table.members[i]].feed for i in rows]
    timed = [math.nan if feed is None else feed for feed in feeds]
    velocity = np.zeros(len(rows)) if None in feeds else np.array(timed)
    velocity = velocity * runs[table.members[0]].direction
    finest = 0.02 * float(table.x[1] - table.x[0])
    found = find_displaced(velocity, shift[rows], least=least, finest=finest)
    return Displaced(
        {rows[j]: text for j, text in found.runs.items()},
        {text: [rows[j] for j in own] for text, own in found.feeds.items()},
        found.lag,
    )


# --- steps and spikes ----------------------------------------------------------------------------


def check_steps(table: RunTable, steps: FloatArray, found: Findings) -> float:
    """Say the step of the readings where it exceeds what runs differ by; return it, else 0."""
    worst = 0.0
    for i, step in enumerate(steps):
        others = np.delete(table.z, i, axis=0)
        if others.shape[0] and step > 0.0:
            differ = table.z[i] - _median(others)
            noise = MAD * float(np.nanmedian(np.abs(differ - np.nanmedian(differ))))
            worst = max(worst, float(step)) if step > noise else worst
        else:
            worst = max(worst, float(step))
    text = (
        f"readings are steps of {format_length(worst)}, more than their noise: below them nothing "
        "is known, and their share is in the uncertainty; use a finer range of the sensor"
    )
    if worst > 0.0 and text not in found.common:
        found.common.append(text)
    return worst


def _median(rows: FloatArray) -> FloatArray:
    """Return the median over rows, NaN where none has a value."""
    out = np.full(rows.shape[1], np.nan)
    known = ~np.isnan(rows).all(axis=0)
    out[known] = _medians(rows[:, known])
    return out


def spikes(runs: RunSet, table: RunTable) -> list[tuple[Run, NDArray[np.intp], FloatArray]]:
    """Return each run of a table, its readings that stand out of the other runs, and by how much all do.

    Of the neighbours where there are fewer than three runs. What other runs show at the same place
    belongs to the place.
    """
    several = table.compared.sum() >= 3
    found: list[tuple[Run, NDArray[np.intp], FloatArray]] = []
    for i, index in enumerate(table.members):
        run = runs[index]
        away = run.z - _nearby(run.z)
        if several:
            others = table.compared.copy()
            others[i] = False
            own = np.interp(run.x, table.x, _median(table.z[others]), left=np.nan, right=np.nan)
            away = _flat(run.x, run.z - own)
        size = np.abs(away - np.nanmedian(away))
        limit = max(
            SPIKE * MAD * float(np.nanmedian(size)),
            _SPIKE_TAIL * float(np.nanquantile(size, 0.95)),
        )
        limit = max(limit * (1.0 if several else 2.0), 1e-6 * float(np.nanstd(run.z)))
        found.append((run, np.flatnonzero(np.nan_to_num(size, nan=0.0) > limit), away))
    near = 2.0 * (table.x[1] - table.x[0])
    places = [run.x[far] for run, far, _ in found]
    out = []
    for i, (run, far, away) in enumerate(found):
        others_x = np.concatenate([*places[:i], *places[i + 1 :], np.empty(0)])
        alone = [not (np.abs(others_x - at) <= near).any() for at in run.x[far]]
        out.append((run, far[np.array(alone, dtype=bool)], away))
    return out


def check_spikes(runs: RunSet, table: RunTable, found: Findings) -> None:
    """Name readings that stand out of the other runs, or of their neighbours where these are few."""
    odd = [
        not c or bool(found.said[m]) for c, m in zip(table.compared, table.members, strict=True)
    ]
    what = "the other runs" if table.compared.sum() >= 3 else "its neighbours"
    for index, other, (run, far, away) in zip(
        table.members, odd, spikes(runs, table), strict=True
    ):
        out = far[np.abs(away[far]) > _STEPS * found.steps[index]]
        if other or not out.size:
            continue
        at = int(out[np.argmax(np.abs(away[out]))])
        x, size, more = float(run.x[at]), float(away[at]), int(out.size) - 1
        text = f"has a spike at {format_length(x)}: {format_length(size)} from {what}"
        text += f" (and {more} more readings)" if more else ""
        found.say(index, text, at=x, size=size)


def _nearby(z: FloatArray) -> FloatArray:
    """Return the median of the two readings on each side."""
    padded = np.pad(z, 2, mode="reflect")
    sides = np.stack([padded[:-4], padded[1:-3], padded[3:-1], padded[4:]])
    return np.asarray(np.median(sides, axis=0))


# --- rows of a design filtered by an autoregressive model ------------------------------------------

_BLOCK = 128


def whitened(
    design: FloatArray, values: FloatArray, coefficients: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Filter rows by blocks of a banded Toeplitz matrix; rows that touch a NaN are dropped."""
    p = coefficients.size
    invalid = np.isnan(values)
    table = np.hstack([design, np.where(invalid, 0.0, values)[:, None]])
    n_out = values.size - p
    if p:
        taps = np.concatenate([-coefficients[::-1], [1.0]])
        band = np.zeros((_BLOCK, _BLOCK + p))
        for row in range(_BLOCK):
            band[row, row : row + p + 1] = taps
        out = np.empty((n_out, table.shape[1]))
        for first in range(0, n_out, _BLOCK):
            size = min(_BLOCK, n_out - first)
            np.matmul(
                band[:size, : size + p],
                table[first : first + size + p],
                out=out[first : first + size],
            )
    else:
        out = table
    if invalid.any():
        touched = np.convolve(invalid.astype(np.float64), np.ones(p + 1))[p : p + n_out] > 0.5
        out = out[~touched]
    return out[:, :-1], out[:, -1]
