"""Private to separation: what repeatability alone says, beside the joint estimate.

The joint method tests a wavelength against its model of the noise; the table of evidence asks only
whether the runs of different feedrates agree. Where the feedrates move a vibration by less than
the resolution, the second question has no answer.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from metrosep.core.errors import InvalidSamplesError, NotSeparableError, TooFewSamplesError
from metrosep.core.runset import RunSet
from metrosep.separation.evidence import evidence_table

__all__ = ["evidence_of"]

_LEAST_RUNS = 2
"""Runs of each feedrate: fewer leave hardly any degrees of freedom."""


def evidence_of(
    runs: RunSet, probes: Sequence[str], *, start: float, stop: float, rate: float
) -> tuple[dict[str, list[Any]], Mapping[str, Any]]:
    """Return the columns of the evidence and what was done, or why there are none.

    Parameters
    ----------
    runs : RunSet
        Runs of one direction.
    probes : sequence of str
        Name of the probe of each run. Only the runs of the first one are used: probes that read
        the same pass see the same vibration and would count it twice.
    start, stop : float, m
        Evaluation range.
    rate : float
        False discovery rate.

    Returns
    -------
    columns : dict of str to list
        Of `evidence_table`; empty with fewer than two feedrates, two runs of each, or with gaps.
    audit : mapping
        Of the table, or ``not_taken`` with the reason.
    """
    used = RunSet([r for r, name in zip(runs, probes, strict=True) if name == probes[0]])
    groups = used.by_feed()
    if len(groups) < 2 or any(r.feed is None for r in used):
        return {}, {"not_taken": "fewer than 2 feedrates"}
    if min(len(members) for _, members in groups) < _LEAST_RUNS:
        return {}, {"not_taken": f"fewer than {_LEAST_RUNS} runs at a feedrate"}
    try:
        table = evidence_table(used, start=start, length=stop - start, false_discovery_rate=rate)
    except (InvalidSamplesError, TooFewSamplesError, NotSeparableError) as exc:
        return {}, {"not_taken": str(exc)}
    return dict(table.columns), table.audit
