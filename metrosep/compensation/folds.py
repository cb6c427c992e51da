"""Leave one run out: what a table would be without each of the runs that made it.

A table that is judged on its own runs is judged with the noise that it holds, so it always seems to
help. Run k is therefore judged with the table made without it, by the same method and settings; the
steps of its history say how it was made.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, Literal

from metrosep.compensation.measured import paired
from metrosep.core.errors import MetrosepError, TableError
from metrosep.core.provenance import Step
from metrosep.core.runset import RunSet
from metrosep.separation.runs.base import ErrorEstimate

__all__ = ["Folds", "Own", "fold_estimates", "folds_of", "made_of", "own_runs", "used_runs"]

Folds = Sequence[tuple[Sequence[int], Any]]
"""Indices of the runs that were left out, and what is made (or looked up) without them."""

_MOST_FITS = 5
"""A joint estimate takes about a second: more than these fits are not made for a verification."""

_KEPT = 4
"""Sets of folds that are remembered: several tables of one result, or one that is being shaped."""

_MADE: dict[Any, list[tuple[tuple[int, ...], ErrorEstimate]]] = {}


def made_of(
    history: Sequence[Step], runs: RunSet
) -> tuple[Literal["all", "none", "file"], list[int]]:
    """Return whether runs made a table, and which of them did not."""
    stated = {h for s in history for h in s.parameters.get("runs_sha256", ())}
    mine = [str(r.metadata.get("cells_of_sha256", r.sha256)) for r in runs]
    others = [i for i, h in enumerate(mine) if h not in stated]
    if stated and stated == set(mine):
        return "all", []
    if stated and len(others) == len(mine):
        return (
            "file" if set(source_hashes(history)) & set(source_hashes(runs.history)) else "none"
        ), others
    if stated:
        return ("none" if others else "file"), others
    return (
        "all" if set(source_hashes(history)) & set(source_hashes(runs.history)) else "none"
    ), others


def used_runs(history: Sequence[Step], runs: RunSet) -> RunSet:
    """Return the runs without those that a separation left out (``exclude=``)."""
    out = {h for s in history for h in s.parameters.get("left_out_sha256", ())}
    kept = [r for r in runs if r.metadata.get("cells_of_sha256", r.sha256) not in out]
    if not kept or len(kept) == len(runs):
        return runs
    return RunSet(kept, metadata=runs.metadata, history=runs.history)


def source_hashes(history: Sequence[Step]) -> tuple[str, ...]:
    """Return the hashes of the files that a history begins with."""
    found: list[str] = []
    for step in history:
        value = step.parameters.get("sha256", ())
        found.extend([value] if isinstance(value, str) else map(str, value))
    return tuple(found)


def _groups(runs: RunSet, most: int | None) -> list[tuple[int, ...]]:
    """Return which runs are left out together: pairs of directions, and round robin above `most`."""
    rows, left = paired(runs)
    rows = [*rows, *((i,) for i in left)]
    if most is None or len(rows) <= most:
        return rows
    return [tuple(sorted(i for row in rows[k::most] for i in row)) for k in range(most)]


def fold_estimates(
    runs: RunSet, history: Sequence[Step], span: tuple[float, float]
) -> list[tuple[tuple[int, ...], ErrorEstimate]]:
    """Return the estimates made without each run, as the history of one from all runs says."""
    step = next((s for s in reversed(history) if s.name == "separate"), None)
    if step is None:
        raise TableError("its history does not say how it was made")
    most = _MOST_FITS if step.parameters.get("method") == "joint" else None
    groups = _groups(runs, most)
    if len(groups) < 2:
        raise TableError("one run made it: nothing is left without it")
    key = (
        tuple((r.sha256, r.feed, None if r.t is None else r.t.tobytes()) for r in runs),
        repr(sorted(step.parameters.items())),
        span,
    )
    if key not in _MADE:
        while len(_MADE) >= _KEPT:
            _MADE.pop(next(iter(_MADE)))
        _MADE[key] = [(out, _without(runs, out, step.parameters, span)) for out in groups]
    return _MADE[key]


def _without(
    runs: RunSet, out: tuple[int, ...], stated: Mapping[str, Any], span: tuple[float, float]
) -> ErrorEstimate:
    from metrosep.separation.runs.entry import separate_runs

    kept = [i for i in range(len(runs)) if i not in out]
    rest = RunSet([runs[i] for i in kept], metadata=runs.metadata, history=runs.history)
    options = {k: v for k, v in stated.items() if not k.endswith("_sha256") and k != "exclude"}
    options["accept"] = "suspect"  # a run was settled once, with all the others beside it
    start, length = options.pop("start_m", None), options.pop("length_m", None)
    if options["method"] != "kono":  # its range depends on its window
        start, length = span[0], span[1] - span[0]
    if options.get("probes") is not None:
        options["probes"] = [options["probes"][i] for i in kept]
    if options["method"] == "joint" and rest.feeds:
        wanted = options.get("min_feeds", 2)
        options["min_feeds"] = min(wanted, len(rest.feeds))
    # What is wrong with a run was said once, with all the others beside it.
    return separate_runs(
        rest,
        options.pop("method"),
        length,
        start,
        options.pop("shortest_m", None),
        options.pop("lag_s", 0.0),
        exclude=None,
        accept=options.pop("accept"),
        options=options,
        compare=False,
    )


def folds_of(carried: Any, runs: RunSet) -> list[tuple[tuple[int, ...], Any]]:
    """Return what a table or polynomial would be without each of the runs that made it."""
    if any(s.name == "separate" for s in carried.history):
        return [
            (out, carried.remade(estimate))
            for out, estimate in fold_estimates(runs, carried.history, carried.made_over)
        ]
    groups = _groups(runs, None)
    if len(groups) < 2:
        raise TableError("one run made it: nothing is left without it")
    kept = ([r for i, r in enumerate(runs) if i not in out] for out in groups)
    return [(out, carried.remade(RunSet(rest))) for out, rest in zip(groups, kept, strict=True)]


@dataclass(frozen=True, slots=True, eq=False)
class Own:
    """Readings that a table is judged with, and whether they made it."""

    runs: RunSet  # those that are compared
    made_it: bool  # whether the table was made of them
    # of (tuple of int, object) or None: what the controller does with the table made without some
    # of them; None where not known
    folds: Folds | None = None
    why: str = ""  # why a table that was made of them cannot be made without them
    warning: str = ""  # what else to know


def own_runs(
    carried: Any, runs: RunSet, lookup: Callable[[Any], Any], folds: Folds | None = None
) -> Own:
    """Return how runs are to be used to judge a table, with the folds of those that made it."""
    used = used_runs(carried.history, runs)
    if len(used) < len(runs):
        n = len(runs) - len(used)
        own = own_runs(carried, used, lookup, folds)
        excluded = (
            f"{n} of the runs were left out of the separation (exclude=) and are not judged with"
        )
        return replace(own, warning="; ".join(w for w in (excluded, own.warning) if w))
    if folds is None:
        kind, others = made_of(carried.history, runs)
        if kind == "none":
            if len(others) in (0, len(runs)):
                return Own(runs, made_it=False)
            alone = RunSet([runs[i] for i in others], metadata=runs.metadata, history=runs.history)
            left = len(runs) - len(others)
            return Own(
                alone, made_it=False, warning=f"{left} of the runs made it and are not used"
            )
        if kind == "file":
            return Own(
                runs,
                made_it=True,
                why="the readings come from files that made it, but are not the ones that did",
            )
    if folds is None and any("cells_of_sha256" in r.metadata for r in runs):
        return Own(
            runs, made_it=True, why="the result holds means of cells of the runs and no folds"
        )
    try:
        made = folds_of(carried, runs) if folds is None else folds
        return Own(runs, made_it=True, folds=tuple((tuple(o), lookup(t)) for o, t in made))
    except MetrosepError as exc:
        return Own(runs, made_it=True, why=str(exc))
