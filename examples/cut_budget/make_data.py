"""Make program, certificate, log and measured part of this example; nothing of metrosep is used.

``python make_data.py [FOLDER]``. The tool stands 1.5 um too far out, its nose is 4 um larger than
programmed and wavy; the log of the axes is of another day, and the part does not show it.
"""

import sys
from pathlib import Path

import numpy as np

R, FEED, RIM, CORE, POINTS = 0.6e-3, 10e-6, 1.5e-3, 1.1e-3, 90
DX, DR = 1.5e-6, 4e-6
TILT, NOISE = (4e-6, -2e-6), 1e-9


def surface(x, y):
    """Return the surface wanted, without any symmetry."""
    return 9.0 * x**2 + 14.0 * y**2 + 3.0 * x * y + 6e-3 * x


def waviness(psi):
    """Return the deviation of the radius, outward positive."""
    return 15e-9 * np.cos(2.0 * np.pi * psi / np.radians(3.0) + 0.5)


def spiral():
    """Return X and azimuth of the tips, clockwise, two turns further out than the rim."""
    turn = np.arange(0.0, (RIM - CORE) / FEED + 4.0, 1.0 / POINTS)
    return RIM + 2.0 * FEED - FEED * turn, -2.0 * np.pi * turn


def tips(X, azimuth):
    """Return the heights of the tip of a round nose without rake: it touches and cuts nothing."""
    psi = np.linspace(-0.12, 0.12, 4801)
    u, w = R * np.sin(psi), R * (1.0 - np.cos(psi))
    z = np.empty(X.size)
    for i, (x, a) in enumerate(zip(X, azimuth, strict=True)):
        z[i] = (surface((x + u) * np.cos(a), (x + u) * np.sin(a)) - w).max()
    return z


def cut(X, azimuth, Z, rho, theta):
    """Return what the tool as it stands leaves: the lowest passage of its edge, lines between blocks."""
    psi = np.linspace(-0.2, 0.2, 20001)
    radius = R + DR + waviness(psi)
    out, up = radius * np.sin(psi) + DX, R + DR - radius * np.cos(psi)
    lowest = np.full(rho.shape, np.inf)
    for k in range(int(azimuth[-1] // (2.0 * np.pi)), 1):
        at = theta + 2.0 * np.pi * k
        x, z = (np.interp(at, azimuth[::-1], v[::-1], np.nan, np.nan) for v in (X, Z))
        passed = z + np.interp(rho - x, out, up, np.inf, np.inf)
        lowest = np.fmin(lowest, passed)
    return lowest


def main(folder):
    """Write the files."""
    X, azimuth = spiral()
    Z = tips(X, azimuth)
    words = [f"X{1e3 * x:.7f} C{-np.degrees(a):.5f} Z{1e3 * z:.8f} F5400" for x, a, z in zip(X, azimuth, Z, strict=True)]  # fmt: skip
    words[0] = "G1 " + words[0].replace("F5400", "F6")  # 90 blocks in a turn of one second
    head = ["(quantity tip)", "G90 G21", "G93 G61"]
    (folder / "part.nc").write_text("\n".join([*head, *words, "M30", ""]))

    psi = np.linspace(-15.0, 15.0, 301)
    rows = [f"{p:.3f},{1e9 * d:.3f}" for p, d in zip(psi, waviness(np.radians(psi)), strict=True)]
    (folder / "edge.csv").write_text("\n".join(["psi_deg,deviation_nm", *rows, ""]))

    # from the approach of the first block to the end
    t = np.arange(-1.0, X.size / POINTS + 1.0, 1.0 / 20)
    z = 12.0 * np.sin(2.0 * np.pi * 3.0 * t + 0.4)
    rows = [f"{a:.4f},0,0,{1e-3 * b:.6f}" for a, b in zip(t, z, strict=True)]
    (folder / "log.csv").write_text("\n".join(["t_s,X_um,C_deg,Z_um", *rows, ""]))

    rng = np.random.default_rng(29)
    axis = np.arange(-1500, 1501, 40) * 1e-6
    x, y = np.meshgrid(axis, axis)
    rho, theta = np.hypot(x, y), np.arctan2(y, x)
    on = (rho > 1.13e-3) & (rho < 1.47e-3)
    z = np.full(x.shape, np.nan)
    z[on] = cut(X, azimuth, Z, rho[on], theta[on]) + TILT[0] * x[on] + TILT[1] * y[on]
    z[on] += rng.normal(0.0, NOISE, int(on.sum()))
    rows = [f"{1e3 * a:.3f},{1e3 * b:.3f},{1e9 * c:.2f}" for a, b, c in zip(x[on], y[on], z[on], strict=True)]  # fmt: skip
    (folder / "part.csv").write_text("\n".join(["x_mm,y_mm,z_nm", *rows, ""]))


if __name__ == "__main__":
    main(Path(sys.argv[1]) if len(sys.argv) > 1 else Path(__file__).parent)
