"""How high the curves of a calibration must go, and what no order of them follows.

A degree is raised where the readings, with the drift that each model leaves, are likelier by more than
the new coefficients cost (BIC): what a curve of too low an order misses looks like drift otherwise.
Waves shorter than a third of the way, and jumps, are looked for in what is left, by a score test under
its noise.
"""

from __future__ import annotations

import math
from collections.abc import Collection, Iterable, Mapping, Sequence
from itertools import permutations, product
from typing import Any

import numpy as np

from metrosep.core._arrays import FloatArray
from metrosep.core.errors import TooFewSamplesError
from metrosep.core.units import format_engineering, format_length
from metrosep.machine._drift_noise import Fit, Gls, degrees_of, inverse_times
from metrosep.machine._lack_of_fit import sentence
from metrosep.machine._reading_problem import (
    NULL,
    Problem,
    ReadingSet,
    System,
    axis_of_term,
    places_of,
    places_seen,
    with_order,
)
from metrosep.machine.elements import element_terms
from metrosep.machine.instruments import Instrument

_MORE = (2, 4, 8, 16)
"""Orders or harmonics beyond the present ones that are tried together."""
_WORTH = 10.0
"""Twice the logarithm of the likelihood by which more orders must win beyond their cost."""
_CHANCE = 1e-4
_FEWEST, _MOST = 12, 1000
"""Places of an axis in a set below which no wave is looked for, and waves that are tried."""
_AT_ONCE = 200
"""Jumps whose columns are in memory together."""
_FOLLOWS, _FACTOR = 0.7, 3.0
"""Share of the readings of a set that others foretell but for a factor, and a factor that is none of noise."""
_LINE = (
    0.9  # share of a residual that is a straight line: noise in six places has it once in 250 sets
)
_EXCHANGED = 2.0
"""By how much what is left of a set must fall with its channels in another order."""
_SHOWN = 5.0
"""Standard deviations by which other sets must show what they foretell."""
_PASTED = 5
"""Readings in a row that agree with others in every digit."""
_ROUNDING = 1e-9
_ASIDE, _LONGEST = 1e-4, 0.5
"""m: by which a tool point is moved for a derivative, and by which one may be wrong."""
_DRAWN = 0.5
"""Share of the readings, repeats at one place counted once, that coefficients may take."""


def raised_degrees(
    problem: Problem,
    current: list[Instrument],
    good: list[Any],
    system: System,
    fit: Fit,
    axes: Iterable[str],
    homes: Mapping[str, float],
) -> dict[str, int]:
    """Return the axes, of those whose degree is free, whose curves must be of a higher degree."""
    raised = {}
    floors = problem.steps / math.sqrt(12.0)
    most = _DRAWN * min(system.y.size, places_seen(problem.sets))
    here = _cost(system, fit, floors)
    for axis in axes:
        best, at = _plain(system, fit, floors), 0
        wider = {}
        for top in _tops(problem, axis):
            bases = {n: with_order(problem, n, {axis: top}, homes) for n in problem.wanted}
            if bases == problem.wanted:
                continue
            trial = Problem(problem.chain, bases, problem.sets)
            if trial.n_terms > most:
                break
            try:
                wider[top] = trial.assembled(current, good)
            except TooFewSamplesError:
                break
            cost = _plain(wider[top], fit, floors)
            if cost < best - _WORTH:
                best, at = cost, top
        if not at:
            continue
        found = wider[at]
        better = Gls(found.design, found.y, found.streams, problem.stated).best()
        if _cost(found, better, floors) < here - _WORTH:
            raised[axis] = at
    return raised


def _tops(problem: Problem, axis: str) -> list[int]:
    mine = [
        max(b.orders)
        for n, b in problem.bases.items()
        if b.kind != "constant" and axis_of_term(problem.chain, n) == axis
    ]
    return [max(mine) + more for more in _MORE] if mine else []


def _plain(system: System, fit: Fit, floors: FloatArray) -> float:
    """Return the cost of a model by ordinary least squares with the weights of a fit."""
    weights, least = np.empty(system.y.size), 0.0
    for stream in system.streams:
        s = max(fit.scales[stream.group], floors[stream.which])
        weights[stream.rows] = 1.0 / s
        least += stream.rows.size * float(floors[stream.which] / s) ** 2  # steps are no form
    Z = np.linalg.qr(system.design * weights[:, None])[0]
    y = system.y * weights
    rest = y - Z @ (Z.T @ y)
    square = max(float(rest @ rest), least, 1e-20 * float(y @ y), np.finfo(np.float64).tiny)
    return float(y.size * math.log(square) + Z.shape[1] * math.log(y.size))


def _cost(system: System, fit: Fit, floors: FloatArray) -> float:
    """Return -2 log likelihood, and the cost of the coefficients (BIC)."""
    rest = system.y - system.design @ fit.beta
    total = fit.beta.size * math.log(max(system.y.size, 2))
    for stream in system.streams:
        solved, logdet = inverse_times(rest[stream.rows][:, None], stream.index, fit.a, fit.tau)
        s = float(max(fit.scales[stream.group], floors[stream.which]))
        total += logdet + 2.0 * stream.rows.size * math.log(s)
        total += float(rest[stream.rows] @ solved[:, 0]) / s**2
    return float(total)


def shapes_left(problem: Problem, system: System, fit: Fit, judged: Collection[int]) -> list[str]:
    """Return a sentence for each set, but those judged by repeats, whose residuals repeat, or jump, with an axis."""
    rest = system.y - system.design @ fit.beta
    found: dict[str, tuple[float, str]] = {}
    tried, kinds = 0, problem.chain.dimensions
    rest_of = {e.name: set(element_terms(e)) - set(problem.wanted) for e in problem.chain.elements}
    for stream in system.streams:
        if not stream.rows.size or stream.which in judged:
            continue
        reading, label = problem.sets[stream.which], problem.labels[stream.which]
        n = np.asarray(reading.values).shape[0]
        read = "rad" if reading.instrument.is_angle else "m"
        for axis, place in reading.q.items():
            x = np.broadcast_to(np.ravel(np.asarray(place)), (n,))[stream.index.astype(int)]
            span, own = float(np.ptp(x)), np.unique(np.round(x, 9))
            if own.size < _FEWEST or axis not in kinds:
                continue
            low, unit = float(x.min()), "rad" if kinds[axis] == "angle" else "m"
            if unit == "rad":
                low, span = 0.0, 2.0 * math.pi  # harmonics of the turn
                twice = 2 * np.arange(3, min(own.size // 2, _MOST) + 1)
            else:  # places of a fine grid show half as many waves as there are of them, at most
                most = min(own.size - 6, _MOST)
                twice = np.unique(np.linspace(6, own.size - 1, most).astype(int))
            turns = math.pi * twice / span * (x - low)[:, None]
            stat, size = _scores(turns, rest[stream.rows], stream, fit)
            # the steps of the display are smaller
            stat = np.where(size > 0.5 * problem.steps[stream.which], stat, 0.0)
            k = int(np.argmax(stat))
            if stat[k] > found.get(label, (0.0, ""))[0]:
                length = 2.0 * span / float(twice[k])
                of = ", or a term that was not asked for" if rest_of[axis] else ""
                text = sentence(
                    label, "waves", axis, unit, read, (length, length), float(size[k]), of
                )
                found[label] = (float(stat[k]), text)
            # two places on either side at least: one that stands out alone is no jump
            edges = 0.5 * (own[1:-2] + own[2:-1])
            tried += twice.size + edges.size
            parts = [
                _jumps(x[:, None] > some, rest[stream.rows], system, stream, fit)
                for some in np.split(edges, range(_AT_ONCE, edges.size, _AT_ONCE))
            ]
            stat, size = (np.concatenate(v) for v in zip(*parts, strict=True))
            k = int(np.argmax(stat))
            if stat[k] > found.get(label, (0.0, ""))[0]:
                ends = (float(own[k + 1]), float(own[k + 2]))
                text = sentence(label, "jumps", axis, unit, read, ends, float(size[k]))
                found[label] = (float(stat[k]), text)
    return [text for stat, text in found.values() if math.exp(-0.5 * stat) * tried < _CHANCE]


def factors_of_sets(problem: Problem, system: System, fit: Fit) -> list[str]:
    """Return a sentence for each set that follows what the others foretell of it by a factor that is not 1."""
    if len(problem.sets) < 2:
        return []
    said, begin = [], 0
    weights = np.empty(system.y.size)
    for stream in system.streams:
        weights[stream.rows] = 1.0 / fit.scales[stream.group]
    X = system.X / system.sizes * weights[:, None]
    y = system.y * weights
    for k, end in enumerate(system.ends):
        mine = np.arange(begin, end)
        begin = end
        rest = np.delete(np.arange(y.size), mine)
        listed = [np.arange(at.start, at.stop) for at in problem.unknown_at[k].values()]
        own = np.concatenate([np.zeros(0, dtype=np.intp), *listed])
        if mine.size < own.size + _FEWEST or not rest.size or _stands(problem.sets[k]):
            continue
        # what the others show beyond their noise (weighted: 1) foretells; all else is fitted, so left out
        U, singular, W = np.linalg.svd(X[rest], full_matrices=True)
        part = U.T[: singular.size] @ y[rest]
        sure = (singular > 1e-5 * singular[0]) & (np.abs(part) > _SHOWN)
        if not sure.any():
            continue
        found = W[: singular.size][sure].T @ (part[sure] / singular[sure])
        found[own] = 0.0
        free = X[mine] @ np.delete(W, np.flatnonzero(sure), axis=0).T
        Q, size, _ = np.linalg.svd(np.column_stack([free, X[mine][:, own]]), full_matrices=False)
        Q = Q[:, size > 1e-9 * size.max(initial=0.0)]
        if mine.size < Q.shape[1] + _FEWEST:
            continue
        told, read = (v - Q @ (Q.T @ v) for v in (X[mine] @ found, y[mine]))
        sizes = float(told @ told), float(read @ read), float(told @ read)
        if min(sizes[:2]) <= 0.0 or sizes[2] ** 2 < _FOLLOWS * sizes[0] * sizes[1]:
            continue
        factor = sizes[2] / sizes[0]
        if not 1.0 / _FACTOR < factor < _FACTOR:
            said.append(
                f"{problem.labels[k]}: its readings are {factor:.3g} times what the other sets foretell of "
                f"them; check its {'senses or direction' if factor < 0.0 else 'unit'}"
            )
    return said


def exchanged_channels(problem: Problem, current: Sequence[Instrument]) -> list[str]:
    """Return a sentence for nests that fit far better with channels exchanged or turned in sign.

    Least squares of all nests, with the 48 orders and signs of three channels tried for each set and for all
    of them alike, one change after another while the mean residual falls.
    """
    blocks, values, at, begin = [], {}, {}, 0
    for k, reading in enumerate(problem.sets):
        whole = np.isfinite(np.asarray(reading.values)).all(axis=1)
        if reading.instrument.n_readings == 3 and whole.any():
            block, rest = problem.block(k, current[k])
            blocks.append(block[whole].reshape(-1, block.shape[-1]))
            values[k] = rest[whole]
            at[k] = slice(begin, begin + rest[whole].size)
            begin = at[k].stop
    if not blocks:
        return []
    X = np.concatenate(blocks)
    size = np.linalg.norm(X, axis=0)
    U, singular, _ = np.linalg.svd(X / np.where(size > 0.0, size, 1.0), full_matrices=False)
    Q = U[:, singular > NULL * singular[0]]
    free = X.shape[0] - Q.shape[1]
    orders = [(p, s) for p in permutations(range(3)) for s in product((1.0, -1.0), repeat=3)]

    def left(chosen: Mapping[int, tuple[Sequence[int], Sequence[float]]]) -> FloatArray:
        y = np.concatenate([(values[k][:, list(p)] * s).ravel() for k, (p, s) in chosen.items()])
        return np.asarray(np.abs(y - Q @ (Q.T @ y)))

    given = dict.fromkeys(values, orders[0])
    chosen, before = given, left(given)
    best = float(before.mean())
    sure = 1.0 + 2.0 / math.sqrt(2.0 * max(free, 1))  # two standard deviations of a scatter
    for _ in range(len(values) + 1):
        targets = [tuple(values), *((k,) for k in values if len(values) > 1)]
        trials = [chosen | dict.fromkeys(t, order) for t in targets for order in orders]
        means = np.array([float(left(trial).mean()) for trial in trials])
        if means.min() * sure > best:
            break
        # orders that differ by what no reading tells fit alike: the one with the fewest changes is meant
        alike = np.flatnonzero(means <= sure * means.min())
        chosen = trials[min(alike, key=lambda i: (_changes(trials[i]), means[i]))]
        best = float(left(chosen).mean())
    after, trials_made = left(chosen), 48 * (len(values) + 1)
    by_order: dict[Any, list[int]] = {}
    for k, order in chosen.items():
        ratio = float(before[at[k]].mean() / max(after[at[k]].mean(), np.finfo(np.float64).tiny))
        if order != orders[0] and ratio > _EXCHANGED:
            by_order.setdefault(order, []).append(k)
    if free * math.log(max(float(before.mean()) / max(best, 1e-300), 1.0)) < math.log(
        trials_made / _CHANCE
    ):
        return []
    sizes = f"{format_length(float(before.mean()), digits=2)} to {format_length(best, digits=2)}"
    return [
        f"{', '.join(problem.labels[k] for k in mine)}: with {_in_words(order)} what the errors leave of the readings "
        f"would fall from {sizes}; check which sensor each column is and which way raises it, mend the columns, and "
        "calibrate again; do not use these errors"
        for order, mine in by_order.items()
    ]


def _changes(chosen: Mapping[int, tuple[Sequence[int], Sequence[float]]]) -> tuple[int, int]:
    """Return how many channels changed places and how many signs, over all sets."""
    moved = sum(p[i] != i for p, _ in chosen.values() for i in range(3))
    turned = sum(v < 0.0 for _, s in chosen.values() for v in s)
    return moved + turned, turned


def _in_words(order: tuple[Sequence[int], Sequence[float]]) -> str:
    """Return which columns are exchanged and which change sign."""
    places, signs = order
    names = [f"reading_{d}" for d in "xyz"]
    moved = [i for i in range(3) if places[i] != i]
    turned = [names[i] for i in range(3) if signs[i] < 0.0]
    if len(moved) == 3:
        parts = [", ".join(f"{names[i]} taken from {names[places[i]]}" for i in range(3))]
    else:
        parts = [" and ".join(names[i] for i in moved) + " exchanged"] if moved else []
    if turned:
        after = ", then " if moved else ""
        what = " and ".join(filter(None, (", ".join(turned[:-1]), turned[-1])))
        parts.append(f"{after}the sign of {what} turned")
    return "".join(parts)


def lines_left(problem: Problem, system: System, fit: Fit) -> list[str]:
    """Return a sentence for each set whose residual is a straight line: the slope of a straightness is a convention."""
    rest, said = system.y - system.design @ fit.beta, []
    for stream in system.streams:
        reading = problem.sets[stream.which]
        if "slope" not in reading.instrument.unknowns or "slope" in reading.unknown:
            continue
        n = np.asarray(reading.values).shape[0]
        for axis, place in reading.q.items():
            x = np.broadcast_to(np.ravel(np.asarray(place)), (n,))[stream.index.astype(int)]
            if problem.chain.dimensions.get(axis) != "length" or np.unique(x).size < _FEWEST // 2:
                continue
            y, x = rest[stream.rows] - rest[stream.rows].mean(), x - x.mean()
            slope = float(x @ y) / float(x @ x)
            is_rounding = abs(slope) * float(np.ptp(x)) <= _ROUNDING * float(
                np.abs(system.y).max()
            )
            if not is_rounding and slope * float(x @ y) > _LINE * float(y @ y):
                said.append(
                    f"{problem.labels[stream.which]}: what is left of it is a straight line over {axis}, "
                    f"{slope * 1e6:.3g} urad; by convention a straightness has no slope: add slope to its unknown "
                    "(the artefact lies askew), or ask for the squareness that holds it"
                )
                break
    return said


def _stands(reading: ReadingSet) -> bool:
    """Return whether all readings of a set are of one pose."""
    return all(float(np.ptp(np.asarray(v))) <= 1e-9 for v in reading.q.values())


def channels_that_stand(sets: Sequence[ReadingSet], labels: Sequence[str]) -> list[str]:
    """Return a sentence for each channel that reads one value at many poses, where other readings vary."""
    said, varies = [], False
    for reading, label in zip(sets, labels, strict=True):
        values = np.asarray(reading.values)
        if _stands(reading) or values.shape[0] < _PASTED:
            continue
        for c, column in enumerate(values.T):
            seen = column[np.isfinite(column)]
            if seen.size < _PASTED or np.ptp(seen) > 0.0:
                varies |= seen.size > 1
                continue
            channel = f" in {'xyz'[c]}" if values.shape[1] > 1 else ""
            unit = "rad" if reading.instrument.is_angle else "m"
            said.append(
                f"{label}: its readings{channel} are {format_engineering(float(seen[0]), unit)} at all poses, others "
                "vary; check the column and the probe: a display that stands tells no noise, so u does not contain it"
            )
    return said if varies else []


def sets_that_add_nothing(problem: Problem, system: System) -> list[str]:
    """Return a sentence for each set whose own unknowns take all of it, or which stands at one pose."""
    said, begin = [], 0
    for k, end in enumerate(system.ends):
        X, begin, label = system.X[begin:end], end, problem.labels[k]
        taken = [np.arange(at.start, at.stop) for at in problem.unknown_at[k].values()]
        A = X[:, : problem.n_terms] / system.sizes[: problem.n_terms]
        if taken:
            own = np.concatenate(taken)
            U, singular, _ = np.linalg.svd(X[:, own] / system.sizes[own], full_matrices=False)
            U = U[:, singular > _ROUNDING * singular.max(initial=0.0)]
            A = A - U @ (U.T @ A)
        n, alone = np.asarray(problem.sets[k].values).shape[0], _stands(problem.sets[k])
        where = "its only pose" if n == 1 else f"all its {n} readings at one pose"
        if float(np.linalg.norm(A)) <= _ROUNDING * float(np.linalg.norm(X / system.sizes)):
            names = " and ".join(problem.sets[k].unknown) or "nothing"
            said.append(
                f"{label}: it adds nothing, its own unknown {names} takes "
                + (where if alone else "all its readings")
                + "; read it at further poses, or state its set-up"
            )
        elif alone:
            said.append(
                f"{label}: {where}: no error motion shows by itself there, and nothing checks the reading; "
                "read it at further poses"
            )
    return said


def tools_else(
    problem: Problem, current: Sequence[Instrument], system: System, fit: Fit
) -> list[str]:
    """Return a sentence for each set that fits better beyond chance with its tool point elsewhere (score test).

    A place of the set-up that is free takes what a wrong tool length shifts alike everywhere; what is left is
    the turn of the tool times the length.
    """
    from scipy.stats import chi2

    beta = system.V @ fit.beta / system.sizes
    rest, Z = system.y - system.design @ fit.beta, system.design
    said = []
    for k, reading in enumerate(problem.sets):
        if reading.instrument.is_angle or not problem.unknown_at[k] or _stands(reading):
            continue
        at = [
            problem.with_tool(k, current[k], beta, way * _ASIDE * e)
            for e in np.eye(3)
            for way in (1, -1)
        ]
        moved = np.stack(
            [(a - b) / (2.0 * _ASIDE) for a, b in zip(at[::2], at[1::2], strict=True)], axis=-1
        )
        rows = moved.reshape(-1, 3)[system.rows[k]]
        begin = system.ends[k] - rows.shape[0]
        across, own, score = np.zeros((Z.shape[1], 3)), np.zeros((3, 3)), np.zeros(3)
        for stream in (s for s in system.streams if s.which == k):
            D = rows[stream.rows - begin]
            both = np.column_stack([D, rest[stream.rows]])
            solved = inverse_times(both, stream.index, fit.a, fit.tau)[0]
            solved /= fit.scales[stream.group] ** 2
            across += Z[stream.rows].T @ solved[:, :3]
            own, score = own + D.T @ solved[:, :3], score + D.T @ solved[:, 3]
        values, vectors = np.linalg.eigh(own - across.T @ fit.cov @ across)
        seen = values > (_SHOWN / _LONGEST) ** 2  # what a length of any tool would show
        parts = vectors[:, seen].T @ score
        if not seen.any() or chi2.sf(
            np.sum(parts**2 / values[seen]), int(seen.sum())
        ) > _CHANCE / len(problem.sets):
            continue
        by = vectors[:, seen] @ (parts / values[seen])
        where = ", ".join(format_length(float(v), digits=2) for v in np.asarray(reading.tool) + by)
        said.append(
            f"{problem.labels[k]}: it would fit better with the tool point near {where} than at the one that is stated; "
            "check the length of its tool, because the free place of its set-up hides it and u does not contain it"
        )
    return said


def harmonics_alike(problem: Problem) -> list[str]:
    """Return a sentence for each axis with so few places that the next orders look like those fitted."""
    said = []
    for element in problem.chain.elements:
        own = set(element_terms(element))
        lines = [
            max(b.orders)
            for n, b in problem.bases.items()
            if b.kind in ("legendre", "arc") and n in own
        ]
        if lines and (places := places_of(element, problem.sets)) is not None:
            n = np.unique(np.round(places, 9)).size
            if n <= max(lines) + 1:
                said.append(
                    f"{element.name} was read at {n} places, which curves of order {max(lines)} pass through whatever "
                    "they are: nothing shows what lies between, and u does not contain it; read more places"
                )
        tops = [
            max(b.orders) for n, b in problem.bases.items() if b.kind == "fourier" and n in own
        ]
        places = places_of(element, problem.sets)
        if not tops or places is None:
            continue
        n = np.unique(np.round(np.mod(places, 2.0 * math.pi), 9)).size
        top = max(tops)
        if n - top > 2 * top:
            continue
        said.append(
            f"{element.name} was read at {n} places: there harmonics from {n - top} on look like those from "
            f"{top} down; u takes their size from what harmonics between them show: read {3 * top + 1} places "
            "or more"
        )
    return said


def repeated_rows(
    sets: Sequence[ReadingSet], labels: Sequence[str], scales: Sequence[float]
) -> list[str]:
    """Return a sentence for each set with readings that are others digit for digit, beyond chance.

    Two readings of one place with noise s agree in a display of step q by chance q/(2 s sqrt(pi)).
    """
    said: list[str] = []
    first: dict[bytes, tuple[str, int]] = {}
    for reading, label, s in zip(sets, labels, scales, strict=True):
        values = np.asarray(reading.values)
        step = reading.step
        alike = min(
            1.0, step / (2.0 * math.sqrt(math.pi) * max(float(s), step / math.sqrt(12.0), 1e-30))
        )
        n = values.shape[0]
        places = [np.broadcast_to(reading.q[a], (n,)) for a in sorted(reading.q)]
        rows = np.column_stack([*places, values])
        mine: list[tuple[str, int] | None] = []
        for i, row in enumerate(rows):
            mine.append(first.setdefault(row.tobytes(), (label, i)))
        run = best = last = 0
        for i, where in enumerate(mine):
            again = where is not None and where != (label, i)
            follows = again and run and where == (mine[i - 1][0], mine[i - 1][1] + 1)  # type: ignore[index]
            run = run + 1 if follows else int(again)
            if run > best:
                best, last = run, i
        if best >= _PASTED and alike**best < _CHANCE:
            owner, end = mine[last]  # type: ignore[misc]
            said.append(
                f"{label}: readings {last - best + 2} to {last + 1} are readings {end - best + 2} to "
                f"{end + 1} of {owner} digit for digit; if they were pasted twice, u is too small: take them "
                "out"
            )
    return said


def unequal_noise(problem: Problem, system: System, fit: Fit) -> list[str]:
    """Return a sentence for each set whose three readings have noises that differ by more than chance."""
    from scipy.stats import f

    degrees = degrees_of(system.design, system.streams, fit, problem.stated)
    said = []
    for k, label in enumerate(problem.labels):
        mine = [i for i, (which, _) in enumerate(problem.groups) if which == k]
        if len(mine) < 2:
            continue
        order = sorted(mine, key=lambda i: float(fit.scales[i]))
        low, high = order[0], order[-1]
        ratio = float(fit.scales[high] / fit.scales[low]) ** 2
        if f.sf(ratio, max(degrees[high], 1.0), max(degrees[low], 1.0)) < _CHANCE:
            sizes = [format_engineering(float(fit.scales[i]), "m", digits=2) for i in mine]
            said.append(
                f"{label}: its readings in x, y and z have a white noise of {sizes[0]}, {sizes[1]} and {sizes[2]}; "
                "each counts by its own"
            )
    return said


def _jumps(
    steps: Any, rest: FloatArray, system: System, stream: Any, fit: Fit
) -> tuple[FloatArray, FloatArray]:
    """Return of each step the statistic (chi-square of 1), and its height, beside the model."""
    if not steps.shape[1]:
        return np.zeros(1), np.zeros(1)
    columns = steps.astype(np.float64)
    Z = system.design[stream.rows]
    both = np.column_stack([Z, columns, rest])
    solved = inverse_times(both, stream.index, fit.a, fit.tau)[0] / fit.scales[stream.group] ** 2
    m = Z.shape[1]
    N = Z.T @ solved[:, :m]
    across = Z.T @ solved[:, m:-1]
    # the model bends towards the step: what it leaves of the step is what the residuals show
    inverse = np.linalg.pinv(N, hermitian=True)
    left = np.sum(columns * solved[:, m:-1], axis=0)
    own = left - np.sum(across * (inverse @ across), axis=0)
    score = columns.T @ solved[:, -1] - across.T @ (inverse @ (Z.T @ solved[:, -1]))
    good = own > 1e-3 * left
    own = np.where(good, own, 1.0)
    return np.where(good, score**2 / own, 0.0), np.where(good, score / own, 0.0)


def _scores(turns: FloatArray, rest: FloatArray, stream: Any, fit: Fit) -> tuple[Any, Any]:
    """Return of each wave the statistic (chi-square of 2 degrees of freedom), and its amplitude."""
    m = turns.shape[1]
    waves = np.concatenate([np.cos(turns), np.sin(turns)], axis=1)
    both = np.concatenate([waves, rest[:, None]], axis=1)
    solved = inverse_times(both, stream.index, fit.a, fit.tau)[0] / fit.scales[stream.group] ** 2
    c, s = waves[:, :m], waves[:, m:]
    cc, ss = np.sum(c * solved[:, :m], axis=0), np.sum(s * solved[:, m : 2 * m], axis=0)
    cs = np.sum(c * solved[:, m : 2 * m], axis=0)
    a, b = c.T @ solved[:, -1], s.T @ solved[:, -1]
    det = cc * ss - cs**2
    good = det > 1e-3 * cc * ss  # the shortest wave of equal places has no sine
    det = np.where(good, det, 1.0)
    p, q = (ss * a - cs * b) / det, (cc * b - cs * a) / det
    return np.where(good, a * p + b * q, 0.0), np.where(good, np.hypot(p, q), 0.0)
