"""Runs as the columns of a table that metrosep writes, and back: nothing is lost on the way.

Position and reading are in m, or in rad for an axis that turns, and the names of the columns say so.
An empty feed or time is that of a run without one.
"""

from __future__ import annotations

from collections import Counter

import numpy as np

from metrosep.core.runset import Run, RunSet
from metrosep.core.units import parse_unit
from metrosep.io.own_notes import header_notes
from metrosep.io.source import RawFile
from metrosep.io.text.table import Column, Table

_NAMES = ("run", "feed_m_s", "t_s")


def run_table(runs: RunSet) -> Table:
    """Return runs as the columns run, feed_m_s, t_s, x_m (x_rad) and z_m (z_rad)."""
    units = [str(runs.metadata.get(key, "m")) for key in ("unit", "z_unit")]
    labels = _labels(runs)
    parts = {
        "feed_m_s": [np.full(len(r), np.nan if r.feed is None else r.feed) for r in runs],
        "t_s": [np.full(len(r), np.nan) if r.t is None else r.t for r in runs],
        f"x_{units[0]}": [r.x for r in runs],
        f"z_{units[1]}": [r.z for r in runs],
    }
    held = {"feed_m_s": any(r.feed for r in runs), "t_s": any(r.t is not None for r in runs)}
    numbers = [
        Column(name, parse_unit(name.split("_", 1)[1].replace("_", "/")), np.concatenate(values))
        for name, values in parts.items()
        if held.get(name, True)
    ]
    texts = tuple(label for label, r in zip(labels, runs, strict=True) for _ in range(len(r)))
    lines = np.arange(1, len(texts) + 1, dtype=np.int64)
    return Table((Column("run", None, None, texts), *numbers), lines, {"named": True})


def _labels(runs: RunSet) -> list[str]:
    """Return a name of its own for each run."""
    names = [run.run_id or str(k) for k, run in enumerate(runs)]
    counts: Counter[str] = Counter()
    made: list[str] = []
    for name in names:
        counts[name] += 1
        unique = name if counts[name] == 1 else f"{name} ({counts[name]})"
        made.append(unique if unique not in made else f"{unique} [{len(made)}]")
    return made


def own_columns(table: Table) -> dict[str, str]:
    """Return the columns by their role where a table has those of `run_table`, else nothing."""
    *first, x, z = table.names if len(table.names) > 2 else ("", "", "")
    known = first[:1] == ["run"] and [n for n in _NAMES if n in first] == first
    units = {name.partition("_")[2] for name in (x, z)}
    if not (known and (x[:2], z[:2]) == ("x_", "z_") and units <= {"m", "rad"}):
        return {}
    beside = {"run": "run", "feed": "feed_m_s", "time": "t_s"}
    return {"x": x, "z": z, **{k: n for k, n in beside.items() if n in first}}


def own_runs(file: RawFile, table: Table) -> RunSet | None:
    """Return the runs of a table that metrosep wrote with runs, ``None`` for its other tables."""
    columns_of_runs = own_columns(table)
    if not columns_of_runs:
        return None
    x, z = columns_of_runs["x"], columns_of_runs["z"]
    units = [name.partition("_")[2] for name in (x, z)]
    notes = header_notes(file, table.header.get("comments", ()))
    by_name = {c.name: c.values for c in table.columns}
    names = np.array(table["run"].labels or (), dtype=object)
    order = dict.fromkeys(names.tolist())
    columns = [by_name.get(name) for name in (x, z, "t_s", "feed_m_s")]
    runs = []
    for name in order:
        rows = names == name
        own_x, own_z, t, feed = (None if c is None else c[rows] for c in columns)
        other = (
            np.empty(0, dtype=np.intp)
            if feed is None
            else np.flatnonzero(np.nan_to_num(feed, nan=-1.0) != np.nan_to_num(feed[0], nan=-1.0))
        )
        if other.size:
            raise file.corrupt(
                f"the feed changes within run {name!r}",
                field=f"line {int(table.lines[rows][other[0]])}",
                hint="give each run a name of its own in column 'run'",
            )
        runs.append(
            Run(
                own_x if own_x is not None else (),
                own_z if own_z is not None else (),
                t=None if t is None or np.isnan(t).all() else t,
                feed=None if feed is None or np.isnan(feed[0]) else float(feed[0]),
                run_id=name,
            )
        )
    metadata = {
        **({} if units == ["m", "m"] else {"unit": units[0], "z_unit": units[1]}),
        "files": ({"file": file.name, "sha256": file.sha256, "lines": table.ledger},),
        "warnings": (*table.warnings, *notes.warnings),
    }
    return RunSet(runs, metadata=metadata, history=(*notes.history, *file.history("delimited")))
