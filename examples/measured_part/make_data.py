"""Make `measured.sdf` and `truth.csv` again, byte for byte, with numpy only.

A part from a slow tool servo lathe: a concave sphere of 40 mm radius, an astigmatism of 60 nm from
the chuck, feed marks of 4 nm amplitude and 0.8 mm pitch, noise of 1 nm, twelve spikes of dust. The
interferometer saw a disc of 10.6 mm; the part is good inside 10 mm.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np

HERE = Path(__file__).resolve().parent
N, STEP = 128, 85e-6
RADIUS = 40e-3
ASTIGMATISM = 60e-9
FEED_MARKS, PITCH = 4e-9, 0.8e-3
NOISE = 1e-9
TILT_X, TILT_Y = 2e-5, -1e-5
MIDDLE = (5.45e-3, 5.35e-3)
SPIKES = 12


def heights() -> tuple[np.ndarray, np.ndarray]:
    """Return the map in m, NaN where nothing was seen, and where the spikes are."""
    rng = np.random.default_rng(20261121)
    x = np.arange(N) * STEP - MIDDLE[0]
    X, Y = np.meshgrid(x, np.arange(N) * STEP - MIDDLE[1])
    r, angle = np.hypot(X, Y), np.arctan2(Y, X)
    z = RADIUS - np.sqrt(RADIUS**2 - r**2)
    z += ASTIGMATISM * (r / 5e-3) ** 2 * np.cos(2 * angle)
    z += FEED_MARKS * np.cos(2 * np.pi * r / PITCH)
    z += TILT_X * X + TILT_Y * Y + NOISE * rng.standard_normal(z.shape)
    good = np.argwhere(r < 4.5e-3)
    spikes = good[rng.choice(len(good), SPIKES, replace=False)]
    z[spikes[:, 0], spikes[:, 1]] += 0.4e-6 * np.where(rng.random(SPIKES) < 0.7, 1.0, -1.0)
    z[r > 5.3e-3] = np.nan
    return z, spikes


def write_sdf(path: Path, z: np.ndarray) -> None:
    """Write a map as text after ISO 25178-71; 0.1 nm is one count."""
    scale = 1e-10
    counts = np.where(np.isnan(z), np.nan, np.rint(z / scale))
    lines = [
        "aISO-1.0",
        "ManufacID   = made here",
        "CreateDate  = 211120260000",
        "ModDate     = 211120260000",
        f"NumPoints   = {z.shape[1]}",
        f"NumProfiles = {z.shape[0]}",
        f"Xscale      = {STEP:.6E}",
        f"Yscale      = {STEP:.6E}",
        f"Zscale      = {scale:.6E}",
        "Zresolution = -1",
        "Compression = 0",
        "DataType    = 6",
        "CheckType   = 0",
        "*",
    ]
    rows = [" ".join("BAD" if np.isnan(v) else str(int(v)) for v in row) for row in counts]
    path.write_text("\n".join([*lines, *rows, "*", ""]), encoding="ascii", newline="\r\n")


def main() -> None:
    """Write both files."""
    z, spikes = heights()
    write_sdf(HERE / "measured.sdf", z)
    lines = ["quantity,value,unit"]
    lines += [f"radius,{RADIUS * 1e3:g},mm", f"astigmatism,{ASTIGMATISM * 1e9:g},nm"]
    lines += [f"feed_marks,{FEED_MARKS * 1e9:g},nm", f"pitch,{PITCH * 1e3:g},mm"]
    lines += [f"noise,{NOISE * 1e9:g},nm", f"spikes,{len(spikes)},1"]
    (HERE / "truth.csv").write_text("\n".join(lines) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
