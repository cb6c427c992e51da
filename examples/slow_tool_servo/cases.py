"""Cases 1 to 4 of the paper: four ways to combine P-Vs of three causes, the paper's figure beside them."""

import numpy as np

from metrosep.forms import SineGrid
from metrosep.process import ErrorBudget, SpiralPath, ToolSetting

GRID = SineGrid(amplitude=50e-9, wavelength=100e-6)
FOLLOW_UP = (13e-9, 5e-9)  # m P-V, measured by the paper: nothing here can predict it
PAPER_NM = {"1 none": 40, "2 tool": 20, "3 tool, program": None, "4 tool, program, servo": 8}
BEFORE, AFTER = ToolSetting(-3.5e-6, -3.5e-6, 100e-6), ToolSetting(-0.25e-6, -0.25e-6, 10e-6)


def causes():
    """Return P-V in m, before and after: of dx on the line theta = 0, and of the block program."""
    rho = np.linspace(50e-6, 500e-6, 4501)
    tool = [np.ptp(s.error(GRID, rho, exact=False, factor="dx")) for s in (BEFORE, AFTER)]
    old = SpiralPath(500e-6, 2e-6, distribution="CAL", step=30e-6).error_map(GRID)
    new = SpiralPath(500e-6, 2e-6, distribution="CA", step=np.radians(2.0)).error_map(GRID)
    return tool, [old.peak_to_valley(annulus=(200e-6, 300e-6)), new.peak_to_valley()]


def budgets():
    """Return the budget of each case."""
    tool, program = causes()
    chosen = dict(zip(PAPER_NM, [(0, 0, 0), (1, 0, 0), (1, 1, 0), (1, 1, 1)], strict=True))
    return {
        name: ErrorBudget(
            [("tool setting", tool[i]), ("program", program[j]), ("follow-up", FOLLOW_UP[k])]
        )
        for name, (i, j, k) in chosen.items()
    }


if __name__ == "__main__":
    for name, budget in budgets().items():
        pv = [1e9 * c.pv for c in budget.contributions]
        total = [1e9 * budget.combine(way).pv for way in ("sum", "rss")]
        paper = f"{PAPER_NM[name]} nm" if PAPER_NM[name] else '"slightly decreased"'
        shares = " / ".join(f"{100 * s:.0f}" for s in budget.shares.values())
        print(
            f"{name:24s} tool {pv[0]:5.2f}, program {pv[1]:4.2f}, follow-up {pv[2]:2.0f} nm: "
            f"sum {total[0]:4.1f}, rss {total[1]:4.1f} nm ({shares} %); paper {paper}"
        )
