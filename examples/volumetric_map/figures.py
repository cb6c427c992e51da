"""Draw the error of the mill: without, with the map, and with two tables multiplied.

``python figures.py FOLDER FIGURE.png``; FOLDER holds what maps.py wrote.
"""

import runpy
import sys
from pathlib import Path

import numpy as np

from metrosep.compensation import rank_one
from metrosep.controllers import read
from metrosep.plot.style import house_style

HERE = Path(__file__).parent
TOOL_Z = runpy.run_path(str(HERE / "make_machine.py"))["tool_z"]


def parts(folder):
    """Return positions in mm and what is left in um for three states."""
    corrections = read(folder / "z_of_xy.csv", "csv-map")
    x, y = np.meshgrid(np.linspace(0.0, 400.0, 101), np.linspace(0.0, 300.0, 76))
    states = {
        "without": lambda x, y: np.zeros_like(x),
        "with the map": corrections.correction,
        "two tables multiplied": rank_one(corrections).correction,
    }
    zero = np.zeros(1)
    found = {}
    for name, lookup in states.items():
        c = np.array([lookup(1e-3 * a, 1e-3 * b) for a, b in zip(x, y, strict=True)])
        off = TOOL_Z(x, y, 1e3 * c) - TOOL_Z(zero, zero, zero)
        found[name] = 1e3 * (off - off.mean())
    return x, y, found


def figure(x, y, found):
    """Return the states side by side, on one scale."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    most = max(np.abs(um).max() for um in found.values())
    with house_style():
        drawn = Figure(figsize=(9.6, 3.0), layout="constrained")
        FigureCanvasAgg(drawn)
        panels = drawn.subplots(1, len(found), sharex=True, sharey=True)
        for axes, (name, um) in zip(panels, found.items(), strict=True):
            look = {"cmap": "RdBu_r", "vmin": -most, "vmax": most, "shading": "gouraud"}
            mesh = axes.pcolormesh(x, y, um, **look)
            axes.set_title(f"{name}: P-V {np.ptp(um):.2g} µm", fontsize=9.0)
            axes.set_aspect("equal")
            axes.grid(visible=False)
            axes.set_xlabel("X in mm")
        panels[0].set_ylabel("Y in mm")
        drawn.colorbar(mesh, ax=list(panels), label="Z, actual − nominal in µm", shrink=0.9)
    return drawn


if __name__ == "__main__":
    figure(*parts(Path(sys.argv[1]))).savefig(sys.argv[2], dpi=110)
