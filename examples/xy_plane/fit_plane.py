"""Three maps of a plane in; errors of both axes, the coupling and the corrected plane out."""

from pathlib import Path

import numpy as np
import pandas as pd

from metrosep.separation.planes.plane_fit import fit_plane_model
from metrosep.separation.planes.plane_model import plane_map

folder = Path(__file__).parent
table = pd.read_csv(folder / "plane.csv")
truth = pd.read_csv(folder / "truth.csv")
x, y = (np.unique(table[c]) * 1e-3 for c in ("x_mm", "y_mm"))
maps = table["z_um"].to_numpy().reshape(-1, y.size, x.size) * 1e-6
maps = maps - maps.mean(axis=(1, 2), keepdims=True)  # each repeat has a zero of its own

fit = fit_plane_model(maps, dx=x[1] - x[0], dy=y[1] - y[0])
for name, found, u in (("x", fit.along_x, fit.u_x), ("y", fit.along_y, fit.u_y)):
    true = truth.loc[truth["axis"] == name, "e_um"].to_numpy() * 1e-6
    rest = (found.z - true) * 1e9
    print(f"{name}: RMS against truth {rest.std():.2f} nm (stated {u.z.mean() * 1e9:.2f} nm)")
print(f"alpha {fit.alpha} (true 4 urad), beta {fit.beta} (true -2.5 urad)")
print(*fit.messages, sep="\n")

plane = plane_map(
    fit.along_x, fit.along_y, dx=x[1] - x[0], dy=y[1] - y[0],
    alpha=fit.alpha, beta=fit.beta, u_x=fit.u_x, u_y=fit.u_y,
)  # fmt: skip
mean = maps.mean(axis=0)


def pv(z):
    return float(np.ptp(z)) * 1e6


print(f"plane P-V {pv(mean):.2f} um, after the correction {pv(mean - plane.surface.z):.2f} um")
print(f"with the sign flipped it would be {pv(mean + plane.surface.z):.2f} um")
