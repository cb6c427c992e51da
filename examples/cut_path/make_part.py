"""Cut the off-axis asphere with a tool that is set wrongly, and measure it: `measured.x3p`.

``python make_part.py [FOLDER]``
"""

import sys
from pathlib import Path

import numpy as np

import metrosep as ms
from metrosep.process import RoundNose, ToolSetting, TurningJob, virtual_cut

FORM = ms.forms.Expression(
    "((x+d)**2+y**2)/(R*(1+sqrt(1-(1+k)*((x+d)**2+y**2)/R**2))) - t*x",
    R=0.12, k=-0.6, d=0.02, t=0.1676003808,
)  # fmt: skip
NOSE = RoundNose(0.5e-3, np.radians(-25.0), radius_in="projection")
TRUTH = ToolSetting(dx=1.8e-6, dy=-1.1e-6, dR=6e-6)
NOISE, STEP, HALF = 1e-9, 40e-6, 3e-3


def program():
    """Return the program of the nominal tool."""
    job = TurningJob(FORM, 3e-3, 5e-6, rpm=120, core=0.6e-3, sense="counterclockwise", nose=NOSE)
    return job.program(job.path(step=2.0 * np.pi / 120))


def measured():
    """Return the map of the part: cut with the tool as it stands, tilted, with noise."""
    axis = np.arange(-HALF, HALF + 0.5 * STEP, STEP)
    x, y = np.meshgrid(axis, axis)
    on = (np.hypot(x, y) > 0.65e-3) & (np.hypot(x, y) < 2.97e-3)
    z = np.full(x.shape, np.nan)
    z[on] = virtual_cut(program(), NOSE, x[on], y[on], setting=TRUTH).z
    z += np.random.default_rng(28).normal(0.0, NOISE, z.shape)
    return ms.Surface(z + 3e-6 * x - 2e-6 * y + 0.4e-6, dx=STEP, dy=STEP, origin=(-HALF, -HALF))


if __name__ == "__main__":
    folder = Path(sys.argv[1]) if len(sys.argv) > 1 else Path(__file__).parent
    ms.write(measured(), folder / "measured.x3p")
