"""Cut a part with each file of tables.py on a simulated slide: ``python cut_parts.py FOLDER``.

The slide has the true error of ``../straightness/truth.csv``; it runs at 600 mm/min, its controller
looks the file up every millisecond, and a count of Z is 1 nm. FOLDER holds what tables.py wrote.
"""

import json
import sys
from pathlib import Path

import numpy as np

from metrosep import controllers
from metrosep.compensation import AxisMachine, Servo, run_closed_loop

TRUTH = Path(__file__).parents[1] / "straightness" / "truth.csv"
X_MM, E_UM = np.loadtxt(TRUTH, delimiter=",", skiprows=1, unpack=True)


def slide():
    """Return the machine: the true error of Z over X, and how its controller applies a table."""
    return AxisMachine(
        lambda x, _: np.interp(x, X_MM * 1e-3, E_UM * 1e-6),
        travel=(0.0, 45e-3),
        on_axis=False,
        feed=10e-3,
        servo=Servo(period=1e-3, between="linear", count=1e-9),
    )


def cuts(folder):
    """Return for each controller the part before, after, and with the sign flipped."""
    found = {}
    for beside in sorted(Path(folder).glob("*.json")):
        name = json.loads(beside.read_text("utf-8"))["controller"]
        lookup = controllers.simulate(beside.with_suffix(""), name)
        found[name] = run_closed_loop(slide(), lookup, removed="line")
    return found


if __name__ == "__main__":
    print("RMS in nm          before   after  flipped")
    for name, loop in cuts(sys.argv[1]).items():
        loop.require(name)
        way = loop.passes[0]
        rms = (1e9 * cut.rms.value for cut in (way.before, way.after, way.wrong_sign))
        print(f"{name:17s}", *(f"{v:8.1f}" for v in rms))
