"""Tasks with a promised time that no peer does: seconds beside what is promised.

Run with ``make bench``; printed, nothing is asserted about time.
"""

from __future__ import annotations

import time

import numpy as np

import metrosep as ms
from metrosep.compensation.knots import choose_knots
from metrosep.controllers.gcode.corrections import error_correction
from metrosep.controllers.gcode.paths import rewrite_path
from metrosep.machine import presets
from metrosep.parameters.deviation import flatness_deviation, roundness_deviation
from metrosep.process.path_points import SpiralPath
from metrosep.separation.circles.probe_angles import optimise_probe_angles
from metrosep.separation.circles.resampling import resample_by_encoder
from metrosep.separation.circles.spindle import iso230_7


def told(title, wanted, function, rounds=3):
    """Print the least time of some rounds beside what is wanted, seconds."""
    times = []
    for _ in range(rounds):
        started = time.perf_counter()
        function()
        times.append(time.perf_counter() - started)
    print(f"\n{title}: {min(times):.3g} s, wanted {wanted} s")


def test_form_deviations():
    rng = np.random.default_rng(1)
    y, x = np.mgrid[-1:1:1000j, -1:1:1000j]
    z = 1e-6 * (x * x + 0.3 * y**3 + np.sin(3 * x + y)) + 1e-9 * rng.normal(size=x.shape)
    surface = ms.Surface(z, dx=1e-5, dy=1e-5)
    told("flatness, 10^6 pixels", 2.0, lambda: flatness_deviation(surface))
    angle = 2 * np.pi * np.arange(10**5) / 10**5
    ring = ms.Profile(angle, 1e-6 * np.cos(2 * angle) + 1e-8 * rng.normal(size=angle.size))
    for reference in ("LS", "MZ", "MC", "MI"):
        told(
            f"roundness {reference}, 10^5 points",
            1.0,
            lambda reference=reference: roundness_deviation(ring, reference=reference),
        )


def test_spindle_and_probes():
    turns = np.random.default_rng(0).normal(size=(100, 4096)) * 1e-9
    told("spindle, 100 turns of 4096", 0.4, lambda: iso230_7(turns))
    angle = 2 * np.pi * np.arange(100 * 4096 + 5000) / 4096.7
    angle += 0.01 * np.sin(angle)
    told(
        "resampling by an encoder, 100 turns",
        1.5,
        lambda: resample_by_encoder(np.cos(3 * angle), angle, n=4096),
    )
    for n, kmax in ((3, 200), (24, 500)):
        told(
            f"angles of {n} probes, {kmax} undulations",
            10.0,
            lambda n=n, kmax=kmax: optimise_probe_angles(n, kmax),
            rounds=1,
        )


def test_machine_and_paths():
    chain = presets("fts_lathe", radius=0.02)
    n = 100_000
    states = {
        "C": np.linspace(0.0, 20.0, n),
        "X": np.linspace(0.0, 0.02, n),
        "FTS": np.zeros(n),
    }
    told("Jacobian of a lathe at 10^5 states", 0.5, lambda: chain.jacobian(states))
    path = SpiralPath.with_points(500e-6, 2e-6, 1_000_000)
    grid = ms.forms.SineGrid(amplitude=50e-9, wavelength=100e-6)
    told("errors at 10^7 points of a spiral", 2.0, lambda: path.error_map(grid))
    x = np.linspace(0, 1, 20_001)
    told(
        "40 knots out of 20 001 samples",
        15.0,
        lambda: choose_knots(x, 1e-6 * np.exp(3 * x), 40),
        1,
    )


def test_million_blocks(tmp_path, spiral_program):
    y, x = np.mgrid[-21e-3:21e-3:512j, -21e-3:21e-3:512j]
    step = 42e-3 / 511
    surface = ms.Surface(
        1e-6 * np.sin(x / 3e-3) * np.cos(y / 4e-3), dx=step, dy=step, origin=(-21e-3,) * 2
    )
    spiral_program(tmp_path / "in.nc", 1_000_000)
    told(
        "a million blocks rewritten",
        20.0,
        lambda: rewrite_path(tmp_path / "in.nc", tmp_path / "out.nc", error_correction(surface)),
        rounds=1,
    )
