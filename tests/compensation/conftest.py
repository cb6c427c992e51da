"""Errors with known shape, and an estimate of a simulated axis that runs both ways."""

import numpy as np
import pytest

from metrosep.compensation import CompensationTable
from metrosep.separation import machine_axis, separate

SHORTEST = 1.5e-3
"""The shortest wave of the axes is 3.3 mm; fewer harmonics cost a quarter of the time."""


def estimated(axis):
    return separate(axis.runs, start=axis.start, length=axis.stop - axis.start, shortest=SHORTEST)


@pytest.fixture(scope="session")
def lopsided():
    """Error of 3 um with a bump at 12 mm of 50 mm: nothing about it is symmetric."""
    return lambda x: (
        3e-6 * np.exp(-(((np.asarray(x) - 12e-3) / 4e-3) ** 2))
        + 0.4e-6 * np.sin(2 * np.pi * np.asarray(x) / 17e-3)
    )


@pytest.fixture(scope="session")
def both_ways():
    """Quiet axis with 0.4 um lost motion, run in both directions."""
    return machine_axis(
        seed=3,
        directions=(1, -1),
        n_repeats=2,
        lost_motion=0.4e-6,
        offset=2e-9,
        noise=5e-9,
        disturbance="none",
    )


@pytest.fixture(scope="session")
def both_ways_estimate(both_ways):
    """Its estimate over the required range."""
    return estimated(both_ways)


@pytest.fixture(scope="session")
def both_ways_table(both_ways_estimate):
    """A table of that estimate."""
    return CompensationTable.from_error(both_ways_estimate, positions="0.25 mm", axis="X")


@pytest.fixture(scope="session")
def both_ways_verified(both_ways, both_ways_table):
    """The table on the runs that made it: each is left out once, so two further estimates."""
    return both_ways_table.verify(both_ways.runs)


@pytest.fixture(scope="session")
def one_way():
    """Quiet axis that runs forward only."""
    return machine_axis(seed=5, noise=5e-9, disturbance="none", n_repeats=2)


@pytest.fixture(scope="session")
def one_way_estimate(one_way):
    """Its estimate over the required range."""
    return estimated(one_way)
