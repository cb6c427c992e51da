"""Draw figures 6, 7, 9, 10, 12 and 14 of the dual-servo paper: ``python figures.py FOLDER``."""

import sys
from pathlib import Path

import numpy as np

import metrosep as ms
from metrosep.plot.servo_chart import (
    before_after_chart,
    calibration_chart,
    static_error_chart,
    straightness_chart,
)
from metrosep.plot.style import COLOURS, axes_or_new, house_style

HERE = Path(__file__).parent


def read(name):
    return np.loadtxt(HERE / name, delimiter=",", skiprows=1).T


def table_line():
    """Draw Fig. 9: sensor 2 against the granite, and what a line leaves of it."""
    x, z = read("table.csv")
    line = np.polyval(np.polyfit(x, z, 1), x)
    with house_style():
        axes = axes_or_new(None)
        axes.plot(x, z, color=COLOURS["before"], label=f"against the table: {np.ptp(z):.1f} µm")
        left = f"without its line: {np.ptp(z - line):.2f} µm"
        axes.plot(x, z - line, color=COLOURS["after"], label=left)
        axes.set_xlabel("position x (mm)")
        axes.set_ylabel("deviation (µm)")
        axes.legend()
    return axes


def driven():
    """Draw Fig. 12: sensor 1 along the slide without and with the stage driven."""
    x, without, with_stage = read("driven.csv")
    with house_style():
        axes = axes_or_new(None)
        for z, name, words in ((without, "before", "without"), (with_stage, "after", "with")):
            label = f"{words} compensation: P-V {np.ptp(z):.2g} µm"
            axes.plot(x, z, color=COLOURS[name], label=label)
        axes.set_xlabel("position x (mm)")
        axes.set_ylabel("error (µm)")
        axes.legend()
    return axes


def main(folder):
    folder.mkdir(parents=True, exist_ok=True)
    made = ms.Recipe.load(HERE / "recipe.toml").run().produced
    drawn = {
        "fig06_calibration": calibration_chart(made.calibration),
        "fig07_at_rest": static_error_chart(made.static),
        "fig09_against_table": table_line(),
        "fig10_against_face": straightness_chart(made.runs, made.polynomial),
        "fig12_driven": driven(),
        "fig14_part": before_after_chart(made.parts),
    }
    for name, item in drawn.items():
        figure = item if hasattr(item, "savefig") else item.figure
        figure.savefig(folder / f"{name}.png", dpi=110)


if __name__ == "__main__":
    main(Path(sys.argv[1]))
