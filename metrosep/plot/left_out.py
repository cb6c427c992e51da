"""Each run against what the other runs predict of it: one row of a table, one strip a run.

`run_rows` and `lag_words` read what a separation found about its runs from an estimate or a stored
one, for every page that shows it.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from metrosep.core.errors import DataError
from metrosep.plot.style import COLOURS, house_style, length_scale, new_figure, values

if TYPE_CHECKING:
    from matplotlib.figure import Figure

_MARK = "▸ "
"""Before the finding of a run, so that it is not told by colour alone."""

_LONGEST_NAME = 30
"""Characters of the name of a run in a table or above a strip."""

_LONGEST_FINDING = 58
"""Characters of a finding above a strip; the table has all of it."""


def left_out_plot(source: Any, *, direction: str | None = None) -> Figure:
    """Return a figure with a strip for each run: its readings minus what the others predict.

    Parameters
    ----------
    source : ErrorEstimate or mapping
        What `separate` returned with ``method="joint"`` from three or more runs, or a result (schema
        ``metrosep.result/1``).
    direction : {"forward", "reverse"}, optional
        Which one, where both were run; forward if omitted.

    Returns
    -------
    matplotlib Figure
        Position in mm; every strip in nm (or µm) on the same scale, averaged over 1/60 of the
        travel, offset removed. Beside each: the run, its feedrate in mm/min, its misfit
        (chi-square per degree of freedom, 1 where the noise explains the strip), and what was found.

    Raises
    ------
    DataError
        If nothing was predicted: another method, fewer than three runs, or an old result.

    Notes
    -----
    The prediction is the estimate without the run (leave one out, eq. 15 of separation-2), so a run
    cannot explain its own fault. A displaced run shows the slope of the error, a run of another
    gain the error itself.

    Examples
    --------
    >>> from metrosep.separation import machine_axis, separate
    >>> axis = machine_axis(seed=1, length=15e-3, n_repeats=2)
    >>> figure = left_out_plot(separate(axis.runs, start=axis.start, length=axis.stop - axis.start))
    >>> len(figure.axes)
    6
    """
    found = run_rows(source)
    rows = [r for r in found if r["strip_nm"] is not None]
    if len({r["direction"] for r in found}) > 1:
        predicted = {r["direction"] for r in rows}
        wanted = direction or ("forward" if "forward" in predicted else "reverse")
        rows = [r for r in rows if r["direction"] == wanted]
    if not rows:
        raise DataError(
            "no run was predicted from the others: that needs method='joint', three runs of a "
            "direction, and a result of this version; run the separation again"
        )
    names = short_names([r["run"] for r in rows])
    strips = [values(r["strip_nm"]) for r in rows]
    x = values(rows[0]["x_mm"])
    scale, unit = length_scale(*strips)
    limit = 1.1 * max(
        (float(np.nanmax(np.abs(s))) for s in strips if np.isfinite(s).any()), default=1.0
    )
    with house_style():
        figure = new_figure((7.6, 0.62 * len(strips) + 0.7))
        panels = np.atleast_1d(figure.subplots(len(strips), 1, sharex=True, sharey=True))
        tick = _half_of(limit * scale)
        for axes, strip, row, name in zip(panels, strips, rows, names, strict=True):
            odd = bool(row["finding"])
            colour = COLOURS["after" if odd else "estimate"]
            axes.axhline(0.0, color=COLOURS["line"], linewidth=0.6)
            axes.plot(x, strip * scale, color=colour, linewidth=1.6 if odd else 1.0)
            axes.set_ylim(-limit * scale, limit * scale)
            axes.set_yticks([-tick, 0.0, tick])
            axes.set_title(
                _caption(name, row),
                loc="left",
                fontsize="small",
                color=COLOURS["text"],
                pad=2,
            )
        panels[-1].set_xlabel("position / mm")
        figure.supylabel(f"run minus what the others predict / {unit}", fontsize="small")
    return figure


def was_predicted(estimate: Mapping[str, Any]) -> bool:
    """Return whether a stored estimate holds runs that were predicted from the others."""
    terms = estimate.get("terms") or {}
    ways = [terms, terms.get("forward") or {}, terms.get("reverse") or {}]
    return any("leave_one_out" in way for way in ways)


def _parts(source: Any) -> tuple[Mapping[str, Any], Mapping[str, Any]]:
    """Return the terms of an estimate or of a stored one, and the table of its runs."""
    if hasattr(source, "runs_data"):
        return source.terms, source.runs_data
    if isinstance(source, Mapping):
        stored = source.get("estimate") or source
        return stored.get("terms") or {}, stored.get("runs") or {}
    raise DataError(
        f"left_out_plot draws an ErrorEstimate or a result, got {type(source).__name__}"
    )


def _caption(name: str, row: Mapping[str, Any]) -> str:
    parts = [f"run {name}"]
    if row["feed_mm_min"] is not None:
        parts.append(f"{row['feed_mm_min']:.6g} mm/min")
    if row["misfit"] is not None:
        parts.append(f"misfit {row['misfit']:.2f}")
    said = row["finding"]
    if len(said) > _LONGEST_FINDING:
        said = said[: _LONGEST_FINDING - 1].rstrip() + "…"
    return ", ".join(parts) + (f" {_MARK}{said}" if said else "")


def _half_of(limit: float) -> float:
    """Return about half of an axis as a round number: nearer to its end labels of two strips meet."""
    power = 10.0 ** np.floor(np.log10(0.6 * limit))
    return float(power * max(m for m in (1.0, 2.0, 3.0, 5.0) if m * power <= 0.6 * limit))


def short_names(names: Sequence[str], most: int = _LONGEST_NAME) -> list[str]:
    """Return names of at most so many characters that still differ: without what all have in common.

    Examples
    --------
    >>> short_names(["2026-11-23 spindle off, pass 1 of 3", "2026-11-23 spindle off, pass 2 of 3"], 12)
    ['…1 of 3', '…2 of 3']
    """
    if all(len(n) <= most for n in names):
        return list(names)
    kept = list(names)
    if len(set(names)) > 1:
        # whole words: what differs begins after a blank and ends before one
        start = _common(names).rpartition(" ")
        end = _common([n[::-1] for n in names]).rpartition(" ")
        first, last = (len(a) + len(blank) for a, blank, _ in (start, end))
        kept = [("…" if first else "") + n[first:] for n in names]
        if max(map(len, kept)) > most and last:
            kept = [k[: max(len(k) - last, 1)].rstrip(" ,;") + "…" for k in kept]
    half = (most - 1) // 2
    kept = [k if len(k) <= most else f"{k[: most - 1 - half]}…{k[-half:]}" for k in kept]
    if len(set(kept)) < len(set(names)):
        kept = [f"{k[: most - 6]}… #{i + 1}" for i, k in enumerate(kept)]
    return kept


def _common(names: Sequence[str]) -> str:
    """Return what all names begin with."""
    low, high = min(names), max(names)
    n = next((i for i, (a, b) in enumerate(zip(low, high, strict=False)) if a != b), len(low))
    return low[:n]


# ---- what was found about the runs ---------------------------------------------------------------

_WAYS = {1: "forward", -1: "reverse", "forward": "forward", "reverse": "reverse"}


def run_rows(source: Any) -> list[dict[str, Any]]:
    """Return what was found about each run: a row of numbers, and its strip where it was predicted."""
    terms, table = _parts(source)
    names = [str(n) for n in table.get("run") or []]
    short = short_names(names)
    strips = _strips(terms, table)
    rows = []
    for i, name in enumerate(names):
        own = {k: _number(v[i]) for k, v in table.items() if len(v) == len(names)}
        predicted = own.get("predicted_gain") is not None
        by = "predicted_" if predicted else ""
        x, strip = strips.get(i, (None, None))
        rows.append(
            {
                "run": name,
                "short": short[i],
                "direction": _WAYS.get(own.get("direction") or 0, ""),
                "feed_mm_min": own.get("feed_mm_min"),
                "used": own.get("used") is not False,
                "misfit": own.get("misfit"),
                "gain": own.get(f"{by}gain"),
                "u_gain": own.get(f"u_{by}gain"),
                "shift_mm": own.get(f"{by}shift_mm"),
                "u_shift_mm": own.get(f"u_{by}shift_mm"),
                "predicted": predicted,
                "offset_mm": own.get("position_offset_mm"),
                "u_offset_mm": own.get("u_position_offset_mm"),
                "finding": str(own.get("finding") or ""),
                "x_mm": x,
                "strip_nm": strip,
            }
        )
    return rows


def _number(value: Any) -> Any:
    """Return a value of a table; None where it is NaN."""
    return None if isinstance(value, float) and value != value else value


def _strips(
    terms: Mapping[str, Any], table: Mapping[str, Any]
) -> dict[int, tuple[list[float | None], list[float | None]]]:
    """Return positions and strip of each run of the table that was predicted, by its place in it."""
    used = table.get("used") or [True] * len(table.get("run") or [])
    found = {}
    for way, part in (("", terms), *((w, terms.get(w) or {}) for w in ("forward", "reverse"))):
        left = part.get("leave_one_out")
        if not left:
            continue
        mine = [
            i
            for i, d in enumerate(table.get("direction") or [])
            if used[i] and (not way or _WAYS.get(d, "") == way)
        ]
        if len(mine) != len(left["run"]):  # a run without a prediction: then by name
            mine = [i for i in mine if str(table["run"][i]) in map(str, left["run"])]
        for at, rest in zip(mine, left["rest_nm"], strict=False):
            found[at] = ([_number(v) for v in left["x_mm"]], [_number(v) for v in rest])
    return found


def lag_words(source: Any) -> list[tuple[str, str]]:
    """Return what a joint separation found and did about a delay of the reading, by direction."""
    if hasattr(source, "runs_data"):
        steps = [s.parameters for s in source.history if s.name == "separate"]
        method, audit = source.method, source.audit
        whole = (source.lag, source.lag_sd)
    else:
        stored = source.get("estimate") or source
        told = [s for s in stored.get("history") or [] if s.get("step") == "separate"]
        steps = [s.get("parameters") or {} for s in told]
        method, audit = stored.get("method"), stored.get("audit") or {}
        whole = (stored.get("lag_s"), stored.get("lag_sd_s"))
    if method != "joint":
        return []
    ways = [w for w in ("forward", "reverse") if isinstance(audit.get(w), Mapping)]
    stated = steps[-1].get("lag_s", "auto") if steps else "auto"
    found = []
    for way, own in [(w, audit[w]) for w in ways] or [("", audit)]:
        test = own.get("lag_test") or {}
        if (own.get("options") or {}).get("position_offsets"):
            found.append((way, "not looked for: the position offsets of the runs hold it"))
            continue
        found.append((way, _lag_phrase(test, stated, *map(_ms, whole))))
    return found


def _ms(seconds: float | None) -> float | None:
    return None if seconds is None else seconds * 1e3


def _lag_phrase(test: Mapping[str, Any], stated: Any, taken: float | None, u: float | None) -> str:
    """Return what the readings show, and what was corrected."""
    corrected = "none" if taken is None else f"{taken:.2g} ms"
    if u is not None and u == u:  # NaN
        corrected += f" (u {u:.2g} ms)"
    if not test or test.get("lag_ms") is None:
        return f"corrected: {corrected}; not tested, that needs two feedrates and short waves"
    shown = f"the readings show {test['lag_ms']:.2g} ms (u {test['u_ms']:.2g} ms)"
    if isinstance(stated, str) and stated == "auto" and not test.get("fitted", True):
        return f"{shown}: too little is known of a delay, so none was corrected"
    if isinstance(stated, str) and stated == "auto" and test.get("probability") is not None:
        return (
            f"{shown}; weight of a delay {test['probability']:.2f}, so corrected: {corrected}, the "
            "average over delay and none"
        )
    beside = "" if isinstance(stated, str) else " beside what was stated"
    return f"{shown}{beside}; corrected: {corrected}"
