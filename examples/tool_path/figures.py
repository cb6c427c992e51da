"""Draw the part cut with the program as it was, corrected, and with C the wrong way round.

``python figures.py FIGURE.png``
"""

import math
import runpy
import sys
import tempfile
from pathlib import Path

import numpy as np

import metrosep as ms
from metrosep.controllers import error_correction, rewrite_path
from metrosep.plot.style import house_style

HERE = Path(__file__).parent
LEFT_OVER = runpy.run_path(str(HERE / "cut.py"))["left_over"]
PLACE = runpy.run_path(str(HERE / "make_part.py"))["place"]


def parts(folder):
    """Return what is left in nm for three programs."""
    error = ms.read(HERE / "measured.sdf")
    found = {"as it was": LEFT_OVER(HERE / "part.nc")}
    for name, sense in (("corrected", -1), ("C the wrong way", +1)):
        way = {"c_sense": sense, "c_zero": math.radians(30.0), "centre": "middle"}
        file = folder / f"sense{sense:+d}.nc"
        rewrite_path(HERE / "part.nc", file, error_correction(error, **way), tolerance=2e-9)
        found[name] = LEFT_OVER(file)
    return found


def figure(found):
    """Return the parts side by side, on one scale."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    c, radius, *_ = np.loadtxt(HERE / "truth.csv", delimiter=",", skiprows=1, unpack=True)
    x, y = PLACE(radius, c)
    most = max(np.abs(nm).max() for nm in found.values())
    with house_style():
        drawn = Figure(figsize=(9.0, 3.4), layout="constrained")
        FigureCanvasAgg(drawn)
        panels = drawn.subplots(1, len(found), sharex=True, sharey=True)
        for axes, (name, nm) in zip(panels, found.items(), strict=True):
            mesh = axes.tripcolor(
                x, y, nm, shading="gouraud", cmap="RdBu_r", vmin=-most, vmax=most
            )
            axes.set_title(f"{name}: P-V {np.ptp(nm):.0f} nm", fontsize=9.0)
            axes.set_aspect("equal")
            axes.grid(visible=False)
            axes.set_xlabel("x on the part in mm")
        panels[0].set_ylabel("y on the part in mm")
        drawn.colorbar(mesh, ax=list(panels), label="actual − nominal in nm", shrink=0.9)
    return drawn


if __name__ == "__main__":
    with tempfile.TemporaryDirectory() as made:
        figure(parts(Path(made))).savefig(sys.argv[1], dpi=110)
