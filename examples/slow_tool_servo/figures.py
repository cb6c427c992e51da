"""Draw figures 9 to 13 and 15 to 18 of the paper: ``python figures.py FOLDER``."""

import runpy
import sys
from pathlib import Path

import numpy as np

import metrosep as ms
from metrosep.plot.charts import draw_bars
from metrosep.plot.servo_chart import follow_up_chart, setting_map, setting_profiles
from metrosep.plot.style import COLOURS, axes_or_new, house_style
from metrosep.plot.toolpath_chart import path_error_counts, path_error_figure, path_error_line
from metrosep.process import SpiralPath, errors_by_count, follow_up, identify_setting
from metrosep.recipe.describe.charts import bar_chart

HERE = Path(__file__).parent
CASES = runpy.run_path(str(HERE / "cases.py"))
GRID, BEFORE, AFTER = CASES["GRID"], CASES["BEFORE"], CASES["AFTER"]
COUNTS = (13_090, 18_000, 22_500, 30_000, 45_000, 60_000, 90_000)


def spirals(distribution, steps, interpolation="spline"):
    """Return the error map of a path for each step in rad or m."""
    options = {"distribution": distribution, "interpolation": interpolation, "lead_in": 3}
    return [SpiralPath(500e-6, 2e-6, step=s, **options).error_map(GRID) for s in steps]


def error_lines():
    """Draw Fig. 15a: both programs between 200 and 300 um, on a line half a step beside the points."""
    with house_style():
        axes = axes_or_new(None)
        for made, name in (
            *((m, "before") for m in spirals("CAL", [30e-6])),
            *((m, "after") for m in spirals("CA", [np.radians(2.0)])),
        ):
            line = made.line(np.radians(1.0))
            shown = (line.x >= 200e-6) & (line.x <= 300e-6)
            x, z = 1e6 * line.x[shown], 1e9 * line.z[shown]
            axes.plot(x, z, color=COLOURS[name], label=f"{name}: P-V {np.ptp(z):.2g} nm")
        axes.set_xlabel("radius on the part at 1° / µm")
        axes.set_ylabel("path − ideal / nm")
        axes.legend(loc="lower right", bbox_to_anchor=(1.0, 1.0), ncols=2)
    return axes


def budget_bars():
    """Draw Figs. 16 and 18: P-V of the causes stacked, the paper's measurement beside them."""
    budgets, paper = CASES["budgets"](), CASES["PAPER_NM"]
    labels = [text for name in budgets for text in (f"case {name[0]}", f"paper {name[0]}")]
    series = {
        cause: [v for b in budgets.values() for v in (b.contributions[i].pv, np.nan)]
        for i, cause in enumerate(["tool setting", "program", "follow-up"])
    }
    series["measured by the paper"] = [
        v for p in paper.values() for v in (np.nan, np.nan if p is None else 1e-9 * p)
    ]
    title = "Sum of P-Vs, and what the paper measured (case 3: no number)"
    axes = draw_bars(bar_chart(title, labels, series, unit="m", quantity="P-V", stacked=True))
    axes.set_ylim(0.0, 46.0)
    axes.legend(loc="upper right")
    return axes


def profiles():
    """Draw Fig. 17: measured, ideal and error on one line of the map, piston and tilts removed."""
    surface = ms.read(HERE / "measured.sdf")
    fit = identify_setting(surface, GRID, region=(20e-6, 220e-6))
    n = surface.z.shape[0] // 2
    x = surface.dx * (np.arange(surface.z.shape[1]) - n)
    level = fit.values["piston"] + fit.values["tilt_x"] * x
    ideal = GRID(x - fit.values["shift_x"], np.full_like(x, -fit.values["shift_y"]))
    with house_style():
        axes = axes_or_new(None, size=(7.2, 4.0))
        for z, name, colour in (
            (surface.z[n] - level, "measured", "before"),
            (ideal, "ideal", "reverse"),
            (surface.z[n] - level - ideal, "error = measured − ideal", "after"),
        ):
            label = f"{name}: P-V {1e9 * np.ptp(z):.3g} nm"
            axes.plot(1e6 * x, 1e9 * z, color=COLOURS[colour], label=label)
        axes.set_xlabel("x at y = 0 / µm")
        axes.set_ylabel("height / nm")
        axes.legend(loc="lower right", bbox_to_anchor=(1.0, 1.0), ncols=3)
    return axes


def figures():
    """Return a function that draws for each name of a file."""
    angles = np.radians([5.0, 4.0, 3.0, 2.0])
    lengths = [30e-6, 20e-6, 10e-6, 5e-6]
    whole = ms.process.ToolSetting.error_map
    log = ms.read(HERE / "dry_run.csv")
    names = {"command": "command_nm", "actual": "actual_nm"}
    return {
        "fig09_constant_angle": lambda: path_error_figure(spirals("CA", angles)),
        "fig10_constant_length": lambda: path_error_figure(spirals("CAL", lengths)),
        "fig10e_line": lambda: path_error_line(spirals("CAL", [30e-6])[0]),
        "fig11_counts": lambda: path_error_counts(
            errors_by_count(GRID, 500e-6, 2e-6, COUNTS, lead_in=3), tolerance=1e-9
        ),
        "fig12_factors": lambda: setting_profiles(BEFORE, GRID, after=AFTER, inner=50e-6),
        "fig12_map": lambda: setting_map(whole(BEFORE, GRID, radius=500e-6), title="before"),
        "fig13_follow_up": lambda: follow_up_chart(follow_up(log, **names)),
        "fig15_before_after": error_lines,
        "fig16_18_budget": budget_bars,
        "fig17_profiles": profiles,
    }


def main(folder):
    folder.mkdir(parents=True, exist_ok=True)
    for name, draw in figures().items():
        drawn = draw()
        figure = drawn if hasattr(drawn, "savefig") else drawn.figure
        figure.savefig(folder / f"{name}.png", dpi=110)


if __name__ == "__main__":
    main(Path(sys.argv[1]))
