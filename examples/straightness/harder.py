"""The same slide on a bad day: RMS against the truth without and with the options."""

import numpy as np

import metrosep as ms

SEED = 2026
OPTIONS = {
    "none": {},
    "drift": {"drift": 1},
    "drift, lines": {"drift": 1, "lines": "auto"},
    "drift, lines, robust": {"drift": 1, "lines": "auto", "robust": True},
}


def bad_day(seed=SEED):
    """Nine runs with known error; each has its own drift, phase of the tone, and spikes."""
    axis = ms.separation.machine_axis(seed=seed, disturbance="modal")
    rng = np.random.default_rng(seed)
    runs = []
    for run in axis.runs:
        drift = 0.6e-6 * rng.standard_normal() * run.t  # sensor warms up, m/s times s
        tone = 0.15e-6 * np.sin(2 * np.pi * 12.0 * run.t + rng.uniform(0, 2 * np.pi))  # pump
        spike = np.where(rng.random(run.t.size) < 0.01, rng.uniform(-5e-6, 5e-6, run.t.size), 0.0)
        z = run.z + drift + tone + spike
        runs.append(ms.Run(run.x, z, t=run.t, feed=run.feed, run_id=run.run_id))
    return ms.RunSet(runs), axis


def scores(seed=SEED, names=tuple(OPTIONS)):
    """RMS of estimate minus truth in nm, offset and line removed, for each set of options."""
    runs, axis = bad_day(seed)
    x = np.linspace(axis.start, axis.stop, 451)
    found = {}
    for name in names:
        estimate = ms.separation.separate(
            runs, start=axis.start, length=axis.stop - axis.start, **OPTIONS[name]
        )
        rest = estimate.evaluate(x) - axis.truth(x)
        rest -= np.polyval(np.polyfit(x, rest, 1), x)
        found[name] = rest.std() * 1e9, estimate
    return found


if __name__ == "__main__":
    results = scores()
    for name, (rms, _) in results.items():
        print(f"{name:22s} RMS against truth {rms:5.1f} nm")
    for sentence in results["drift, lines, robust"][1].messages:
        print("-", sentence)
