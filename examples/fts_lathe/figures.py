"""Draw figures 2 to 6 of the paper: ``python figures.py FOLDER``."""

import runpy
import sys
from pathlib import Path

import numpy as np

import metrosep as ms
from metrosep.optics import wavefront
from metrosep.plot.charts import draw_bars
from metrosep.plot.sensitivity_chart import sensitivity_bars, sensitivity_maps, sensitivity_pareto
from metrosep.plot.wavefront_chart import disc_map, wavefront_map, zernike_bars
from metrosep.recipe.describe.charts import bar_chart

CASES = runpy.run_path(str(Path(__file__).parent / "cases.py"))
TORIC, RADIUS, MAIN = CASES["TORIC"], CASES["RADIUS"], ("EZX", "EBC", "B0Z")


def surface(errors=None):
    """Return the part as a map of 161 x 161 points, cut with errors (SI) or none."""
    line = np.linspace(-RADIUS, RADIUS, 161)
    x, y = np.meshgrid(line, line)
    z = TORIC(x, y)
    if errors:
        rho, azimuth, before, _ = CASES["compensated"](errors, 160, 360)
        ring = np.rint(np.hypot(x, y) / (rho[1, 0] - rho[0, 0]) - 0.5).astype(int).clip(0, 159)
        spoke = np.rint(np.arctan2(y, x) / (azimuth[0, 1] - azimuth[0, 0])).astype(int) % 360
        z = z + before[ring, spoke]
    step = 2 * RADIUS / 160
    return ms.Surface(
        np.where(np.hypot(x, y) <= RADIUS, z, np.nan), step, step, origin=(-RADIUS, -RADIUS)
    )


def shape():
    """Draw Fig. 2a: the toric surface without its mean."""
    line = np.linspace(-RADIUS, RADIUS, 161)
    x, y = np.meshgrid(line, line)
    z = surface().z
    return disc_map(
        x, y, z - np.nanmean(z), title="toric surface, mean removed", quantity="height"
    )


def zernike_increments(tables):
    """Draw Fig. 5: what the three main terms, and dx, add to focus and astigmatism."""
    found = tables["wavefront"].zernike(6)
    terms = [*MAIN, "EXX"]
    series = {
        name: [1e-9 * found.loc[t, z] for t in terms]
        for name, z in (("focus Z4", "Z4_nm"), ("astigmatism Z5", "Z5_nm"))
    }
    return draw_bars(
        bar_chart("Increments", terms, series, unit="m", quantity="increment of the coefficient")
    )


def compensation(after):
    """Draw Fig. 6: case L before or after -Ez was added to the path."""
    rho, azimuth, *both = CASES["compensated"](CASES["magnitudes"](), 100, 180)
    x, y = rho * np.cos(azimuth), rho * np.sin(azimuth)
    name = "Ez compensated" if after else "nothing compensated"
    words = f"{name}: Sq {1e9 * CASES['sq'](rho, both[after]):.1f} nm"
    return disc_map(x, y, both[after], title=words)


def main(folder):
    folder.mkdir(parents=True, exist_ok=True)
    tables = CASES["tables"]()
    rank = {"nothing removed": tables["form"], "levelled": tables["levelled"]}
    wave = {"nothing removed": tables["wavefront"], "less piston": tables["less piston"]}
    ideal = wavefront(surface())
    with_hzx = wavefront(surface({"B0Z": np.radians(0.001)}))
    drawn = {
        "fig02a_surface": shape(),
        "fig02b_wavefront": wavefront_map(ideal.remove(("piston", "tilt"))),
        "fig03a_form": sensitivity_bars(rank),
        "fig03b_wavefront": sensitivity_bars(wave),
        "fig03c_pareto": sensitivity_pareto(tables["levelled"]),
        "fig04_maps": sensitivity_maps(tables["less piston"], [*MAIN, "EXX"]),
        "fig05_increments": zernike_increments(tables),
        "fig05_zernike": zernike_bars({"ideal": ideal.zernike(9), "Hzx": with_hzx.zernike(9)}),
        "fig06a_before": compensation(0),
        "fig06b_after": compensation(1),
    }
    for name, item in drawn.items():
        figure = item if hasattr(item, "savefig") else item.figure
        figure.savefig(folder / f"{name}.png", dpi=110)


if __name__ == "__main__":
    main(Path(sys.argv[1]))
