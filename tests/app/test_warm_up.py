"""After the warm-up the first picture loads nothing large any more."""

import subprocess
import sys

from metrosep.app.server import warm_up

SCRIPT = """
import sys
import numpy as np
from metrosep import Profile, Surface
from metrosep.app.server import warm_up
warm_up()
before = set(sys.modules)
from metrosep.app.evaluations import Evaluations
from metrosep.recipe.pipeline import checked_step
x = np.arange(2000) * 1e-6
z = 1e-8 * np.cos(1e4 * x)
for obj, form in ((Profile(x, z), "polynomial: degree=1"),
                  (Surface(np.add.outer(z[:50], z[:60]), 1e-6, 1e-6), "plane")):
    steps = [checked_step({"op": "form", "form": form}), checked_step({"op": "parameters"})]
    assert Evaluations(obj).outcome(steps, "full").error is None
print(sorted(set(sys.modules) - before))
"""


def test_the_first_picture_loads_nothing_more():
    ran = subprocess.run(
        [sys.executable, "-c", SCRIPT], capture_output=True, text=True, check=False
    )
    assert ran.returncode == 0, ran.stderr
    assert ran.stdout.strip() == "[]"


def test_it_stops_when_asked():
    asked = []

    def stop():
        asked.append(1)
        return len(asked) > 1

    warm_up(stop)
    assert len(asked) == 2
