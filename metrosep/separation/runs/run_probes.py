"""Private to separation: which probe read which run."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from metrosep.core.errors import DataError
from metrosep.core.runset import RunSet

__all__ = ["probe_names"]


def probe_names(runs: RunSet, probes: Sequence[str] | None) -> list[str]:
    """Return the name of the probe of each run."""
    if probes is None:
        told = [run.metadata.get("probe") for run in runs]
        if all(name is None for name in told):
            return [""] * len(runs)
        missing = [r.run_id or str(i) for i, r in enumerate(runs) if told[i] is None]
        if missing:
            raise DataError(
                f"run {missing[0]!r} does not say which probe read it, others do; set "
                "metadata['probe'] in every run, or state probes=[...]"
            )
        return [str(name) for name in told]
    if isinstance(probes, str | bytes) or not np.iterable(probes):
        raise DataError(f"probes is a list with one name for each run, got {probes!r}")
    names = [str(p) for p in probes]
    if len(names) != len(runs):
        raise DataError(f"probes names {len(names)} runs, there are {len(runs)}; one for each run")
    return names
