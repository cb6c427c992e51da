"""Draw a program: where the tip goes, where the edge touches, and the error of the part cut from the file.

``python figures.py FOLDER``: for each job the path, the contacts and the virtual part.
"""

import sys
import tempfile
from pathlib import Path

import numpy as np

import metrosep as ms
from metrosep.controllers import LatheAxes, read_program
from metrosep.plot.style import house_style
from metrosep.process import tip_path, virtual_cut

HERE = Path(__file__).parent
JOBS = {
    "torus": ("torus.nc", LatheAxes("workpiece ccw", inverse_time="1/min"), {}),
    "grid": ("grid.pmc", LatheAxes("workpiece ccw"), {"velocity_time": 1.0}),
    "toric": ("toric.csv", LatheAxes("workpiece ccw"), {}),
    "asphere": ("asphere.mpf", LatheAxes("tool ccw", inverse_time="s", spline_word="CSPLINE"), {}),
}


def cut(name, folder, places=60_000):
    """Write the program of a job, read it back, and return tips of a turn, part and cusps."""
    file, axes, words = JOBS[name]
    result = ms.Recipe.load(HERE / f"{name}.toml").run(out=folder / name)
    made = result.produced
    program = read_program(folder / name / file, axes, **words)
    turned = np.abs(program.azimuth - program.azimuth[0])
    turn = (turned > 4 * np.pi) & (turned <= 6 * np.pi)
    tips = tip_path(
        made.form, program.X[turn], program.azimuth[turn], nose=made.nose, sense=program.sense
    )
    rng = np.random.default_rng(0)
    low, high = program.X.min(), program.X.max()
    rho, theta = np.sqrt(rng.uniform(low**2, high**2, places)), rng.uniform(-np.pi, np.pi, places)
    part = virtual_cut(
        program, made.nose, rho * np.cos(theta), rho * np.sin(theta), form=made.form
    )
    # a feed along one direction, point by point: the cusps
    middle, feed = 0.5 * (low + high), (high - low) / program.turns
    line = middle + feed * np.linspace(0.0, 4.0, 801)
    cusps = virtual_cut(program, made.nose, line * np.cos(0.4), line * np.sin(0.4), form=made.form)
    return tips, part, cusps


def figure(name, found):
    """Return path and contacts of a turn, cusps, and the error map of a job."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    tips, part, cusps = found
    with house_style():
        drawn = Figure(figsize=(10.5, 3.4), layout="constrained")
        FigureCanvasAgg(drawn)
        path, contact, line, whole = drawn.subplots(1, 4, width_ratios=(1.0, 1.0, 1.0, 1.3))
        angle = np.degrees(np.abs(tips.azimuth - tips.azimuth[0]))
        path.plot(angle, 1e6 * tips.z)
        path.set(
            xlabel="angle travelled in deg", ylabel="Z of the tip in um", title="path, one turn"
        )
        contact.plot(angle, 1e6 * (tips.rho - tips.X))
        contact.set(
            xlabel="angle travelled in deg",
            ylabel="contact beside the tip in um",
            title="where it touches",
        )
        line.plot(1e6 * (cusps.rho - cusps.rho[0]), 1e9 * cusps.error)
        line.set(xlabel="way along rho in um", ylabel="material left in nm", title="four turns")
        on = np.isfinite(part.error)
        most = 1e9 * np.nanmax(np.abs(part.error))
        x, y = (
            1e3 * v[on] for v in (part.rho * np.cos(part.theta), part.rho * np.sin(part.theta))
        )
        dots = whole.scatter(
            x, y, c=1e9 * part.error[on], s=0.4, cmap="RdBu_r", vmin=-most, vmax=most
        )
        whole.set(xlabel="x in mm", ylabel="y in mm", aspect="equal", title="cut from the file")
        drawn.colorbar(dots, ax=whole, label="actual - nominal in nm", shrink=0.9)
        drawn.suptitle(f"{name}: P-V {1e9 * part.peak_to_valley:.3g} nm, cusps included")
    return drawn


if __name__ == "__main__":
    target = Path(sys.argv[1])
    target.mkdir(parents=True, exist_ok=True)
    with tempfile.TemporaryDirectory() as scratch:
        for job in JOBS:
            figure(job, cut(job, Path(scratch))).savefig(target / f"{job}.png", dpi=110)
