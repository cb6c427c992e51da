"""Same data, same bits; another order of the runs, the same estimate."""

import numpy as np
import pytest
from acceptance.coverage.judge import metrosep_joint
from acceptance.coverage.machine import simulate
from acceptance.coverage.rows import ROWS

RTOL = 1e-9
"""Of the acceptance table, relative to the error itself."""


@pytest.mark.slow
@pytest.mark.timeout(900)
@pytest.mark.parametrize("name", ["base", "lag 1 ms", "slip 8 mm"])
def test_order_of_runs_and_repetition_do_not_matter(name):
    runs = simulate(ROWS[name].machine, 434_000).runs
    other = [runs[i] for i in np.random.default_rng(3).permutation(len(runs))]
    assert [r.name for r in other] != [r.name for r in runs]
    x = np.linspace(0.0, 45e-3, 451)
    first, again, shuffled = (metrosep_joint(r, 45.0) for r in (runs, runs, other))

    for curve in ("evaluate", "sd"):
        a, b, c = (getattr(e, curve)(x) for e in (first, again, shuffled))
        assert (a == b).all()
        assert np.abs(a - c).max() <= RTOL * np.abs(first.evaluate(x)).max()
