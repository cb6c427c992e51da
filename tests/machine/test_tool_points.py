"""Multilateration whose stations nobody knows: a wrong tool length hides in them; few places hide a curve."""

from __future__ import annotations

import numpy as np
import pytest
from machine.drawn_machines import Machine

from metrosep.machine import Length, ReadingSet, calibrate, presets

NOISE = 0.1e-6
STATIONS = [(-0.35, -0.3, -0.2), (0.8, -0.25, -0.15), (0.15, 0.75, -0.25), (0.2, 0.1, 0.9), (-0.3, 0.6, 0.5), (0.75, 0.6, 0.4)]  # fmt: skip
TOOLS = [(0, 0, -0.12), (0.09, 0, -0.12), (0, 0.08, -0.2)] * 2
LOUD = 8.0
"""Times the motions of a drawn machine: 8 um, 16 urad, so that 20 mm of lever are some 0.3 um."""


def tracked(seed, longer=0.0, *, places=5, endless=False):
    """Six set-ups over a grid; the second with a tool that is longer than it says."""
    rng = np.random.default_rng([seed, 77])
    machine = Machine("mill_xyz", rng, endless=endless)
    for term, motion in list(machine.motions.items()):
        machine.motions[term] = lambda q, motion=motion: LOUD * motion(q)
    grid = [np.linspace(*machine.drawing["travel"][a], places) for a in "XYZ"]
    q = {a: v.ravel() for a, v in zip("XYZ", np.meshgrid(*grid, indexing="ij"), strict=True)}
    sets = []
    for k, (station, tool) in enumerate(zip(STATIONS, TOOLS, strict=True)):
        real = np.add(station, 1e-3 * rng.normal(size=3))
        true = np.add(tool, (0, 0, longer if k == 1 else 0.0))
        long = np.linalg.norm(machine.tool_on_work(q, true) - real, axis=1) + 1e-3 * rng.normal()
        long += NOISE * rng.normal(size=long.size)
        free = ("station", "dead_path")
        sets.append(
            ReadingSet(
                Length(station=station), q, long, tool=tool, unknown=free, total=True, name=f"set {k + 1}"
            )
        )  # fmt: skip
    return sets


def said_of(sets, what, **options):
    found = calibrate(presets("mill_xyz"), sets, **options)
    return [m for m in found.messages if what in m]


@pytest.mark.parametrize("seed", [1, 2])
@pytest.mark.parametrize("longer", [0.02, -0.05])
def test_a_wrong_tool_length_that_a_free_station_hides_is_named(seed, longer):
    (said,) = said_of(tracked(seed, longer), "tool point near", degrees=4)
    assert said.startswith("set 2: ")


@pytest.mark.parametrize("seed", [1, 2, 3])
def test_right_tool_lengths_are_not_doubted(seed):
    assert said_of(tracked(seed), "tool point near", degrees=4) == []


@pytest.mark.parametrize(("places", "n"), [(5, 3), (7, 0)])
def test_curves_through_all_places_are_named(places, n):
    """Motions of order 12 read at five places: what lies between them nobody can know."""
    said = said_of(tracked(1, places=places, endless=True), "nothing shows", degrees=4)
    assert len(said) == n
