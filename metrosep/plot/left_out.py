"""Each run against what the other runs predict of it, one strip a run."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

import numpy as np

from metrosep.core.errors import DataError
from metrosep.plot.style import COLOURS, house_style, length_scale, new_figure, values

if TYPE_CHECKING:
    from matplotlib.figure import Figure

__all__ = ["left_out_plot", "was_predicted"]

_MARK = "▸ "
"""Before the finding of a run, so that it is not told by colour alone."""


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
        travel, offset taken out. Beside each: the run, its feedrate in mm/min, its misfit
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
    >>> axis = machine_axis(seed=1)
    >>> figure = left_out_plot(separate(axis.runs, start=axis.start, length=axis.stop - axis.start))
    >>> len(figure.axes)
    9
    """
    terms, table = _parts(source)
    wanted = direction or ("forward" if "forward" in terms else "reverse")
    left = (terms if "leave_one_out" in terms else terms.get(wanted) or {}).get("leave_one_out")
    if not left:
        raise DataError(
            "no run was predicted from the others: that needs method='joint', three runs of a "
            "direction, and a result of this version; run the separation again"
        )
    rows = [_row(table, str(name), wanted, i) for i, name in enumerate(left["run"])]
    strips = [values(rest) for rest in left["rest_nm"]]
    x = values(left["x_mm"])
    scale, unit = length_scale(*strips)
    limit = 1.1 * max(
        (float(np.nanmax(np.abs(s))) for s in strips if np.isfinite(s).any()), default=1.0
    )
    with house_style():
        figure = new_figure((7.6, 0.62 * len(strips) + 0.7))
        panels = np.atleast_1d(figure.subplots(len(strips), 1, sharex=True, sharey=True))
        for axes, strip, row, name in zip(panels, strips, rows, left["run"], strict=True):
            odd = bool(row.get("finding"))
            colour = COLOURS["after" if odd else "estimate"]
            axes.axhline(0.0, color=COLOURS["line"], linewidth=0.6)
            axes.plot(x, strip * scale, color=colour, linewidth=1.6 if odd else 1.0)
            axes.set_ylim(-limit * scale, limit * scale)
            axes.set_title(
                _caption(str(name), row),
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


def _row(table: Mapping[str, Any], name: str, way: str, place: int) -> dict[str, Any]:
    """Return the row of a run in the table of run checks; the one at its place among equal names."""
    sign = {"forward": 1, "reverse": -1}[way] if way in ("forward", "reverse") else 0
    ways = table.get("direction") or []
    used = table.get("used") or [True] * len(ways)
    own = [i for i, d in enumerate(ways) if used[i] and d in (sign, way)]
    if not own:  # one direction only: all that were used
        own = [i for i, u in enumerate(used) if u]
    named = [i for i in own if str(table["run"][i]) == name]
    at = place if len(named) != 1 else own.index(named[0])
    return {k: v[own[at]] for k, v in table.items()} if at < len(own) else {}


def _caption(name: str, row: Mapping[str, Any]) -> str:
    parts = [f"run {name}"]
    if row.get("feed_mm_min") is not None:
        parts.append(f"{row['feed_mm_min']:.6g} mm/min")
    if row.get("misfit") is not None:
        parts.append(f"misfit {row['misfit']:.2f}")
    said = f" {_MARK}{row['finding']}" if row.get("finding") else ""
    return ", ".join(parts) + said
