"""Draw what the files leave on the simulated part: ``python figures.py FOLDER FIGURE.png``.

FOLDER holds what tables.py wrote.
"""

import runpy
import sys
from pathlib import Path

from metrosep.plot.servo_chart import closed_loop_plot
from metrosep.plot.style import COLOURS, DASHED, DOTTED, house_style

CUTS = runpy.run_path(str(Path(__file__).parent / "cut_parts.py"))["cuts"]
SHOWN = {
    "linuxcnc": ("after", "-", 1.6),
    "mitsubishi": ("estimate", DASHED, 1.2),
    "heidenhain": ("reverse", DOTTED, 1.4),
}


def figure(found):
    """Return the part before, after and flipped, and what three files leave."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    with house_style():
        drawn = Figure(figsize=(7.2, 6.6), layout="constrained")
        FigureCanvasAgg(drawn)
        above, below = drawn.subplots(2, 1, sharex=True)
        closed_loop_plot(found["linuxcnc"], above)
        above.set_title("the part, controller linuxcnc", fontsize=9.5, loc="left")
        above.set_xlabel("")
        for name, (colour, dashes, width) in SHOWN.items():
            cut = found[name].passes[0].after
            label = f"{name}: RMS {cut.rms.value * 1e9:.1f} nm"
            places = found[name].places * 1e3
            left = cut.left * 1e9
            below.plot(places, left, ls=dashes, color=COLOURS[colour], lw=width, label=label)
        below.set_title(
            "with the table: entries of 0.1 pm, 50 nm, 0.1 µm", fontsize=9.5, loc="left"
        )
        below.set_xlabel("position in mm")
        below.set_ylabel("actual − nominal in nm")
        below.legend(loc="upper center", bbox_to_anchor=(0.5, -0.2), ncols=3)
    return drawn


if __name__ == "__main__":
    figure(CUTS(sys.argv[1])).savefig(sys.argv[2], dpi=110)
