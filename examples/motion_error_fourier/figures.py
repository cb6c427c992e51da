"""Draw figures 3, 9, 10, 12 and 13 of the paper: ``python figures.py FOLDER``."""

import sys
from pathlib import Path

import numpy as np

import metrosep as ms
from metrosep.plot.style import COLOURS, DASHED, axes_or_new, house_style, label_decades
from metrosep.plot.wavefront_chart import disc_map
from metrosep.separation.planes.plane_model import plane_map

HERE = Path(__file__).parent
LENGTH = {"x": 45e-3, "y": 70e-3}
SIGMA_T, P_T = 0.05, 0.01  # um


def estimate(axis, **how):
    """Return the error of one slide."""
    names = {"z": "z_um", "feed": "feed_mm_min", "time": "t_ms", "run": "run"}
    runs = ms.read_runs(HERE / f"runs_{axis}.csv", x=f"{axis}_mm", **names)
    return ms.separation.separate(runs, start=0.0, length=LENGTH[axis], **how)


def mean_and_sigma():
    """Draw Fig. 3: mean and standard deviation of the spectra of three feeds, with thresholds."""
    table = estimate("y", method="kono").spectrum
    with house_style():
        axes = axes_or_new(None, size=(7.2, 4.0))
        for key, name, colour, level in (
            ("mean_power_si", "mean", "estimate", P_T),
            ("sigma_si", "σ over the feeds", "after", SIGMA_T),
        ):
            value = np.maximum(1e6 * table[key].to_numpy(), 1e-5)
            axes.semilogy(table["wavelength_mm"], value, color=COLOURS[colour], label=name)
            axes.axhline(level, color=COLOURS[colour], lw=0.9, ls=DASHED)
        axes.axvline(4.0, color=COLOURS["line"], lw=0.9, label="4 mm, as the paper chose")
        for feed in (4800, 7200, 9600):
            axes.axvline(feed / 60.0 / 150.0, color=COLOURS["before"], lw=0.7, ls=":")
        label_decades(axes)
        axes.set_xlabel("wavelength / mm   (dotted: 150 Hz at the three feeds)")
        axes.set_ylabel("amplitude / µm")
        axes.legend(loc="lower right", bbox_to_anchor=(1.0, 1.0), ncols=3)
    return axes


def planes():
    """Return x, y and the plane as measured and with the estimate taken off, alignment removed."""
    x, y, z = np.loadtxt(HERE / "plane.csv", delimiter=",", skiprows=1).T * [
        [1e-3],
        [1e-3],
        [1e-6],
    ]
    axes = [estimate(a, method="kono", shortest=4e-3) for a in "xy"]
    error = plane_map(*axes, dx=3e-3, dy=0.5e-3).surface.z.T.ravel()
    line = np.c_[x, y, np.ones(x.size)]
    shape = (np.unique(x).size, -1)
    both = [v - line @ np.linalg.lstsq(line, v)[0] for v in (z, z - error)]
    return [v.reshape(shape) for v in (x, y, *both)]


def profiles(compensated):
    """Draw Fig. 12 or 13: relative displacement and cut profile on one line."""
    y, moved, cut = np.loadtxt(HERE / "profile.csv", delimiter=",", skiprows=1).T
    if compensated:
        command = 1e6 * estimate("y", method="kono", shortest=4e-3).evaluate(1e-3 * y)
        moved, cut = moved - command, cut - command
    with house_style():
        axes = axes_or_new(None, size=(7.2, 3.6))
        for z, name, colour in (
            (moved, "relative displacement", "before"),
            (cut, "cut profile", "after"),
        ):
            left = z - np.polyval(np.polyfit(y, z, 1), y)
            label = f"{name}: P-V {np.ptp(left):.2f} µm"
            axes.plot(y, left, color=COLOURS[colour], lw=0.9, label=label)
        axes.set_ylim(-1.1, 1.1)
        axes.set_xlabel("y / mm")
        axes.set_ylabel("z without its line / µm")
        axes.legend(loc="lower right", bbox_to_anchor=(1.0, 1.0), ncols=2)
    return axes


def main(folder):
    folder.mkdir(parents=True, exist_ok=True)
    x, y, before, after = planes()
    limit = float(np.abs(before).max())
    drawn = {
        "fig03_mean_and_sigma": mean_and_sigma(),
        "fig09_plane_without": disc_map(x, y, before, title="without compensation", limit=limit),
        "fig10_plane_with": disc_map(x, y, after, title="with compensation", limit=limit),
        "fig12_profile_without": profiles(False),
        "fig13_profile_with": profiles(True),
    }
    for name, item in drawn.items():
        item.figure.savefig(folder / f"{name}.png", dpi=110)


if __name__ == "__main__":
    main(Path(sys.argv[1]))
